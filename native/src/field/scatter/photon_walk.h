/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons: light that walks from the lamps through media until it is absorbed or leaves. */
#ifndef AMB_FIELD_SCATTER_PHOTON_WALK_H
#define AMB_FIELD_SCATTER_PHOTON_WALK_H

#include "field/scatter/photon_source.h"
#include "field/scatter/scatter_cells.h"

typedef struct PhotonWalk {
    const AmbScene *scene;
    const ScatterParams *params;
    const PhotonSource *source;
    const ScatterCells *cells; /* by object; without layers where nothing scatters */
} PhotonWalk;

/* Follows photon i and adds it to the moments, by object as cells have them, and to the tally. */
void photon_walk(const PhotonWalk *walk, uint64_t i, float *const *moments, ScatterTally *tally);

#endif
