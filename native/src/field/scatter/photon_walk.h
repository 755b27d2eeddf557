/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons: light that walks from the lamps through media until it is absorbed or leaves. */
#ifndef AMB_FIELD_SCATTER_PHOTON_WALK_H
#define AMB_FIELD_SCATTER_PHOTON_WALK_H

#include "field/scatter/photon_landing.h"
#include "field/scatter/photon_source.h"
#include "field/scatter/scatter_cells.h"

typedef struct PhotonWalk {
    const AmbScene *scene;
    const ScatterParams *params;
    const PhotonSource *source;
    const ScatterCells *cells; /* by object; without layers where nothing is kept, without a grid of
                                * depths where each flight casts a ray */
    uint32_t forced_count;     /* light that scattered less often is divided, where it flies in a
                                * medium, into what collides there and what does not: all of it
                                * scatters, however thin the medium */
    float landing_part; /* of the photons, an even part: their landings stand for all; 0: none
                         * is kept */
} PhotonWalk;

/* Follows photon i and adds it to the moments, by object as cells have them, to the landings, which
 * may be NULL where none is kept, and to the tally. */
void photon_walk(const PhotonWalk *walk, uint64_t i, float *const *moments,
                 PhotonLandings *landings, ScatterTally *tally);

#endif
