/* SPDX-License-Identifier: GPL-3.0-or-later
 * The places from which meshes shine. */
#ifndef AMB_SCENE_LIGHT_MESH_H
#define AMB_SCENE_LIGHT_MESH_H

#include <stdbool.h>
#include <stdint.h>

#include "math/sampling.h"
#include "math/vec3.h"

/* Shines from both sides. */
typedef struct LightTriangle {
    Vec3 p, e1, e2; /* a corner, and the edges from there */
    Vec3 n;         /* unit */
    Rgb radiance;
} LightTriangle;

enum { LIGHT_MESH_PARTS = 16 };

typedef struct LightMesh {
    LightTriangle *triangles;
    double *sums;   /* (count): of area times mean radiance, up to and with each triangle */
    uint64_t count; /* > 0 */
    /* Covariance of the places of each part xx, yy, zz, xy, yz, zx, m^2, by light. A part has as
     * many triangles as any other: a ring is wide as a whole, and its light is not. */
    float spread[LIGHT_MESH_PARTS][6];
    bool may_be_inside; /* of a translucent object: its box meets that of one */
} LightMesh;

/* A place drawn in proportion to the mean radiance of the channels. */
typedef struct LightPlace {
    Vec3 p, n;
    Rgb weight;    /* radiance over the density of the place, W sr^-1 along n */
    float density; /* 1/m^2 */
    uint32_t part; /* of the mesh */
} LightPlace;

LightPlace light_mesh_place(const LightMesh *mesh, Sample2 u);

/* The place a little off the triangle, on the side of another place just off whose surface a shadow
 * ray starts: it does not meet the triangle. */
Vec3 light_place_towards(const LightPlace *place, Vec3 other);

/* The same for light that leaves along d. */
Vec3 light_place_leave(const LightPlace *place, Vec3 d);

/* Area times mean radiance of all triangles: what a place's density is relative to. */
static inline double light_mesh_power(const LightMesh *mesh) {
    return mesh->sums[mesh->count - 1];
}

/* Fills in the sums and the spread from the triangles; *out_middle is the middle of its places. */
void light_mesh_prepare(LightMesh *mesh, Vec3 *out_middle);

/* NULL is none. */
void light_mesh_destroy(LightMesh *mesh);

#endif
