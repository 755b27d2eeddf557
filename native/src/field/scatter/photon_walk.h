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
    const ScatterCells *cells; /* by object; without layers where nothing is kept, without a grid of
                                * depths where each flight casts a ray */
    uint32_t forced_count;     /* light that scattered less often is divided, where it flies in a
                                * medium, into what collides there and what does not: all of it
                                * scatters, however thin the medium */
} PhotonWalk;

/* Where light that has scattered ends on an opaque surface. */
typedef struct PhotonLanding {
    Vec3 p, n;      /* m; unit geometric normal on the side that the light comes from */
    Rgb flux;       /* W; as that of a LightLanding */
    float distance; /* m, from the boundary or the scattering before */
    float rank;     /* in [0, 1): those of like rank come from an even part of the photons */
    uint32_t order; /* scatterings, >= 1 */
} PhotonLanding;

typedef struct PhotonLandings {
    PhotonLanding *list;
    uint64_t count, room;
    bool is_cut_short; /* there was no memory for more */
} PhotonLandings;

/* Follows photon i and adds it to the moments, by object as cells have them, to the landings where
 * these are not NULL, and to the tally. */
void photon_walk(const PhotonWalk *walk, uint64_t i, float *const *moments,
                 PhotonLandings *landings, ScatterTally *tally);

#endif
