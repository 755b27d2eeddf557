/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over the cells of a lit boundary that bounds where they are and where their refracted
 * light goes.
 *
 * [Walter09] prune triangles by the normals that could send light from the lamp to the eye: the
 * cone of half vectors, the spindle of places at which refraction can bend light far enough, and
 * the side of the face. All three say whether refracted light can have the direction that is
 * needed. Here lamps do not move between queries, so that cones of the refracted directions
 * themselves are stored; they bound the same more tightly, and whole segments instead of points. */
#ifndef AMB_FIELD_SPECULAR_SPECULAR_TREE_H
#define AMB_FIELD_SPECULAR_SPECULAR_TREE_H

#include "base/parallel.h"
#include "math/vec3.h"

/* Light lines that start within a ball and go into a cone. */
typedef struct LineBound {
    Vec3 center;  /* m, world */
    float radius; /* m */
    Vec3 w;       /* middle of the directions, not unit */
    float spread; /* |direction - w| is at most this */
} LineBound;

/* A triangle under one light, or a part of it. */
typedef struct SpecularCell {
    LineBound bound;
    float corners[3][2]; /* u, v */
    float reach;         /* m, the least distance from a corner, along its light, to a surface */
    uint32_t triangle, light;
    uint8_t lit_corners; /* how many of them light reaches */
} SpecularCell;

typedef struct SpecularNode {
    LineBound bound;
    uint32_t first, count; /* cells of a leaf; count 0: children are the next node and `second` */
    uint32_t second;
} SpecularNode;

typedef struct SpecularTree {
    SpecularCell *cells;
    SpecularNode *nodes;
    uint64_t cell_count, node_count;
} SpecularTree;

enum { SPECULAR_DEPTH_MAX = 64 };

/* A camera segment and what its tests share. */
typedef struct BoundQuery {
    Vec3 o, d; /* d unit */
    float length;
} BoundQuery;

/* Whether a light line of the bound may meet the segment; never false where one does. */
bool specular_bound_meets(const LineBound *bound, const BoundQuery *query);

/* Takes the cells over (also on failure), and sorts them; scale: of the object, m. At most 2^31
 * cells. */
AmbStatus specular_tree_build(SpecularCell *cells, uint64_t cell_count, float scale, Job *job,
                              SpecularTree *out_tree);
void specular_tree_clear(SpecularTree *tree);

#endif
