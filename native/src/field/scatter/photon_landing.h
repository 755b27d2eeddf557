/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where photons that have scattered end on opaque surfaces. */
#ifndef AMB_FIELD_SCATTER_PHOTON_LANDING_H
#define AMB_FIELD_SCATTER_PHOTON_LANDING_H

#include <stdbool.h>
#include <stdint.h>

#include "math/vec3.h"

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

#endif
