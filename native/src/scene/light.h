/* SPDX-License-Identifier: GPL-3.0-or-later
 * Lights, from both ends: what arrives at a point, and rays that carry the flux away. */
#ifndef AMB_SCENE_LIGHT_H
#define AMB_SCENE_LIGHT_H

#include <stdint.h>

#include "math/sampling.h"
#include "math/vec3.h"
#include "optics/tangent.h"
#include "scene/light_mesh.h"

enum { LIGHT_MESH = 0x100 }; /* a kind of its own: a mesh that emits light */

typedef struct SceneLight {
    char *name;
    uint32_t kind;  /* AMB_LIGHT_*, LIGHT_MESH */
    Rgb color;      /* MESH: mean radiance, grey */
    Vec3 position;  /* MESH: the middle of its places */
    Vec3 direction; /* unit, of travel */
    Vec3 x, y;      /* unit; with direction a frame. AREA: along its extents */
    float radius;   /* POINT, SPOT */
    float angle;    /* SUN: angular radius */
    float spot_cap; /* SPOT: 1 - cos of half its size, with the digits of a narrow one */
    float spot_blend, spot_cosine;
    float size[2]; /* AREA: half extents (half-axes of an ellipse) */
    uint32_t area_shape;
    LightMesh *mesh; /* MESH; else NULL */
} SceneLight;

/* Sets the colour of a sun from what its directions give together, each on a plane of its own;
 * angle must be set. */
void light_set_sun(SceneLight *light, Rgb irradiance);

typedef struct LightArrival {
    Vec3 wi;        /* unit, from the point to the light */
    float distance; /* m; infinite for a sun */
    Rgb irradiance; /* on a plane perpendicular to wi, W/m^2, without occlusion */
    float pdf;      /* MESH: of wi, 1/sr; else 0 */
} LightArrival;

/* One sample of what arrives at p, already divided by its pdf; u in [0,1)^2 picks the point of an
 * extended light. */
LightArrival light_arrival(const SceneLight *light, Vec3 p, Sample2 u);

/* Whether a camera can see it, and not only what it lights or, of a mesh, the surface. */
bool light_has_extent(const SceneLight *light);

/* Radiance of the light along o + t d, d unit, and where, with t in (0, t_max]; black where it is
 * not met. What light_arrival samples: discs that face o, planes, caps of directions. */
Rgb light_seen(const SceneLight *light, Vec3 o, Vec3 d, float t_max, float *out_t);

/* The family of rays that a light sends at a target sphere: `count` rays of equal solid angle (or
 * area, for a sun) on a Fibonacci lattice over the cap (or disc) that covers the target. */
typedef struct LightEmission {
    const SceneLight *light;
    Vec3 target;         /* centre of the sphere, world */
    float target_radius; /* m */
    float distance;      /* where rays of a sun and of far lights start, before the target */
    uint64_t count;
    float shift_u, shift_v; /* of the lattice and of the source samples, from the seed */
} LightEmission;

typedef struct LightRay {
    Vec3 o, d; /* d unit */
    float way; /* m, travelled before o: rays of far lights start near the target */
    Rgb flux;  /* W that the ray stands for; black: not emitted */
    TangentPair pairs[TANGENT_COUNT];
} LightRay;

/* Ray i < count. Sum over all rays of flux = flux of the light through the cap or disc. */
LightRay light_emit(const LightEmission *emission, uint64_t i);

/* Flux sent towards the target, W, mean of the channels: divides rays among lights and objects. */
float light_power_towards(const LightEmission *emission);

#endif
