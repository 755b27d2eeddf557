/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that comes to opaque surfaces by way of translucent objects: what their boundaries throw
 * there, photons with the footprint that their tangent pairs give them, and what scattered in their
 * media (glow.h). */
#ifndef AMB_FIELD_CAUSTICS_CAUSTICS_H
#define AMB_FIELD_CAUSTICS_CAUSTICS_H

#include "field/caustics/caustic_tree.h"
#include "field/caustics/glow.h"
#include "light/light_trace.h"

typedef struct CausticMap CausticMap;

enum { CAUSTIC_PART_MAX = 8 };

typedef struct CausticParams {
    LightTraceParams light; /* lands; ray_count 0: nothing is bent */
    ScatterParams glow;     /* photon_count 0: nothing glows */
    Scatter *traced;        /* photons for cells whose landings glow takes; NULL: it has its own */
    float overlap;          /* photons that cover a point where light is even */
    uint32_t part_count;    /* 1 .. CAUSTIC_PART_MAX, as FieldParams'; 0: one */
} CausticParams;

typedef struct CausticAccount {
    uint64_t ray_count, photon_count, bytes;
    double landed[3];                           /* flux of all photons, W */
    uint64_t glow_ray_count, glow_photon_count; /* emitted, and landed after scattering */
    double glow_landed[3];
} CausticAccount;

/* Traces the light and builds the map, which may be empty. Same bits for any number of threads. */
AmbStatus caustics_create(const AmbScene *scene, const CausticParams *params, Job *job,
                          CausticMap **out_map);
void caustics_destroy(CausticMap *map);

/* Irradiance at a point of an opaque surface with unit geometric normal n, on n's side: what
 * boundaries refract there, or reflect. Light that goes straight on through boundaries between
 * equal indices is not in it. part: as FieldSegment's. Any thread. */
Rgb caustics_irradiance(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part);

/* The map as a lamp. A photon is chosen in proportion to its flux, and a place in proportion to its
 * irradiance; false: there is none. `choice` is one number, of two that are coarser. Any thread. */
bool caustics_choose(const CausticMap *map, uint32_t part, Sample2 choice, Sample2 place,
                     CausticPoint *out_point);

/* Places may be found by rays, too, which are sent there with some density, 1/m^2 of the surface's
 * area: of each photon's irradiance the share of these, density / (density + a CausticPoint's);
 * INFINITY: all of it. */
Rgb caustics_irradiance_by_rays(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part,
                                float density);

/* The same of light that scattered on its way, by order. */
typedef struct CausticGlow {
    Rgb orders[GLOW_ORDER_COUNT];
} CausticGlow;

CausticGlow caustics_glow(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part);

/* What a landing is spread out to; axis: the half-axis of the typical kernel, m. */
CausticPhoton caustics_kernel(const LightLanding *landing, float overlap, float axis);

CausticAccount caustics_account(const CausticMap *map);

#endif
