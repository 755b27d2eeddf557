/* SPDX-License-Identifier: GPL-3.0-or-later
 * The light pass: rays from the lights, refracted into the media, with the covariance of the
 * local light field along them. */
#ifndef AMB_LIGHT_LIGHT_TRACE_H
#define AMB_LIGHT_LIGHT_TRACE_H

#include "scene/boundary.h"

/* One straight stretch of a light ray inside a medium. At distance s from its origin it carries
 * flux * exp(-sigma_t s). */
typedef struct LightBeam {
    Vec3 origin, direction; /* m, unit */
    float length;           /* m, to the next surface or to where nothing is left */
    Rgb flux;               /* W at the origin; n^2 does not enter: flux needs only T */
    TangentSpread spread;   /* cross-section a(s) of cell and source together */
    float entry_area;       /* a(0) just after the first refraction, m^2; > 0 */
    float cell_area;        /* the same of the lattice's cell alone, m^2; > 0. A source is sampled
                             * by a point of its own for each ray: its extent must not widen what
                             * the ray stands for */
    float rank;             /* in [0, 1): beams of like rank are an even part of the lattice */
    uint16_t bounces;       /* internal reflections so far */
    bool has_passed; /* light that left one object and came into another, or the same again */
    float start_slope, end_slope; /* tan of the angle between the ray and the surface's normal at
                                   * either end; 0 where it does not end on a surface */
} LightBeam;

/* The beams inside one object. */
typedef struct LightBeams {
    LightBeam *beams;
    uint64_t count;
} LightBeams;

/* Where a light ray that a boundary has bent ends on an opaque surface. */
typedef struct LightLanding {
    Vec3 p, n;        /* m; unit geometric normal on the side that the light comes from */
    float rank;       /* as that of a beam */
    uint32_t bounces; /* internal reflections on the way */
    Rgb flux; /* W; times cos to the shading normal / cos to n: so that flux / area is what the
               * surface's own shading makes of light from there */
    Vec3 footprint[TANGENT_COUNT]; /* in the surface's plane, full extents, m: two span the cell
                                    * of the lattice, two the extent of the source */
} LightLanding;

/* Flux in W per channel, summed over all lights. */
typedef struct LightTally {
    double incident[3];    /* arriving at a boundary from a light */
    double entered[3];     /* into the medium */
    double interacting[3]; /* absorbed or scattered at least once along the traced beams */
    double landed[3];      /* on opaque surfaces, of the landings kept */
} LightTally;

/* What the light pass leaves behind; const afterwards. */
typedef struct LightField {
    LightBeams *objects;    /* by object, object_count; empty where landings are asked for */
    LightLanding *landings; /* empty where beams are */
    uint64_t landing_count;
    uint32_t object_count;
    uint64_t ray_count; /* rays emitted */
    SceneLeaks leaks;
    uint64_t irregular_count; /* faces met from outside by rays already inside of their object, or
                               * from inside by rays that never came in: meshes that cross
                               * themselves or are open */
    uint64_t nested_count;    /* faces that rays met inside of another object: objects that overlap,
                               * lie in one another or touch */
    LightTally tally;
} LightField;

typedef struct LightTraceParams {
    uint64_t ray_count;   /* to emit, over all lights and objects */
    uint32_t bounces;     /* internal reflections to follow */
    bool follows_through; /* go on with light that leaves an object, to others behind it */
    uint32_t carried;     /* stretches of light inside the first object that it comes into, before
                           * so many reflections, are followed but neither kept nor counted as
                           * interacting: tubes carry them. Not of meshes that emit light */
    const bool *targets;  /* by object: those that light is sent to; NULL: all */
    bool adjoint_normals; /* see BoundaryCrossing */
    bool lands;     /* keep landings instead of beams: light that boundaries refract, or reflect on
                     * their outside, onto opaque surfaces. Light that passed boundaries between
                     * equal indices alone goes straight on, and shadow rays know it */
    float roulette; /* branches with less than this share of their ray's flux at the light go on
                     * in part of the rays, in proportion, and stand for all; 0: all go on */
    uint32_t seed;
} LightTraceParams;

/* Traces params->ray_count rays, shared among lights and boundaries by the flux they exchange.
 *
 * Samples of the boundary are where a Fibonacci lattice of rays over the light's solid angle
 * meets it first, instead of points placed on each triangle ([Liang19] 4.2, [Wang16]): they are
 * stratified to the same degree, each carries the same flux before Fresnel (a uniform density
 * over the surface spends samples where light grazes), occlusion is decided by the same ray, and
 * the pdf is p_A = cos / (r^2 omega_cell), so that flux = I omega_cell T.
 *
 * Same result for any number of threads. out_field is cleared by light_field_clear. */
AmbStatus light_trace(const AmbScene *scene, const LightTraceParams *params, Job *job,
                      LightField *out_field);

void light_field_clear(LightField *field);

#endif
