/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that scattered in media and lands on opaque surfaces: photons, and kernels as wide as so
 * smooth a light allows. */
#ifndef AMB_FIELD_CAUSTICS_GLOW_H
#define AMB_FIELD_CAUSTICS_GLOW_H

#include "field/caustics/caustic_tree.h"
#include "field/scatter/photon_walk.h"

/* Orders of scattering that are kept apart: once, twice, more often. */
enum { GLOW_ORDER_COUNT = 3 };

typedef struct GlowLandings {
    PhotonLandings orders[GLOW_ORDER_COUNT];
    ScatterTally tally;
} GlowLandings;

/* Photons walk; what lands is kept in their order, by order of scattering. params: of
 * scatter_create. The same for any number of threads. */
AmbStatus glow_trace(const AmbScene *scene, const ScatterParams *params, Job *job,
                     GlowLandings *out_landings);
void glow_clear(GlowLandings *landings);

/* The same of lists that other photons left, which end empty; on failure what is left of them, and
 * what *all has, is the caller's to free. *all must be empty. */
AmbStatus glow_sort(PhotonLandings *lists, uint64_t list_count, Job *job, GlowLandings *all);

/* Kernels of the landings of one order, photons[i] of landings->list[i]. */
AmbStatus glow_place(const AmbScene *scene, const PhotonLandings *landings, Job *job,
                     CausticPhoton *photons);

#endif
