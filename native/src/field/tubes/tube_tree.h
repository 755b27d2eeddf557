/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over light tubes in the space of their lines: eight children a node, eight tubes a
 * leaf. */
#ifndef AMB_FIELD_TUBES_TUBE_TREE_H
#define AMB_FIELD_TUBES_TUBE_TREE_H

#include "base/parallel.h"
#include "math/vec3.h"

enum { TUBE_LANES = 8, TUBE_QUARTERS = 4, TUBE_LEVEL_MAX = 12 };

/* A lit piece of the boundary and the light that goes on from it: inside, the light lines are
 * x + s w, interpolated linearly between the corners, 0 < s < limit. */
typedef struct Tube {
    Vec3 x[3];       /* corners on the boundary, m, from the centre of the tree */
    Vec3 w[3];       /* unit, refracted direction of travel */
    float limit[3];  /* m, where the light ends */
    float far;       /* m, beyond which none of the light is inside the object: for boxes */
    float flux[3];   /* W of the whole piece if all of it were like this corner, without color */
    Rgb color;       /* of the light and of the surface's tint */
    float spread[2]; /* cross-section a(s) / a(0) = |1 + spread[0] s + spread[1] s^2| */
} Tube;

/* Eight tubes side by side; unused lanes are all zero and carry nothing. */
typedef struct TubeBlock {
    float x[3][3][TUBE_LANES]; /* corner, axis */
    float w[3][3][TUBE_LANES];
    float limit[3][TUBE_LANES];
    float flux[3][TUBE_LANES];
    float color[3][TUBE_LANES];
    float spread[2][TUBE_LANES];
} TubeBlock;

/* Bounds of eight children. A light line has the Pluecker coordinates (m, w), m = x x w; a camera
 * ray o + t d meets it where f = d.m + (o x d).w is zero. f is linear in (m, w), so over a box its
 * range is f(middle) +- |d|.half extents: one dot product rejects whole lines. Four boxes in the
 * ordinary space, for s in quarters of 0 .. far, reject by place what runs nearly parallel. */
typedef struct TubeNode {
    float middle[6][TUBE_LANES]; /* of m, in m, and of w */
    float extent[6][TUBE_LANES]; /* half, >= 0; negative: no child */
    float low[TUBE_QUARTERS][3][TUBE_LANES];
    float high[TUBE_QUARTERS][3][TUBE_LANES];
} TubeNode;

/* Node i of level l > 0 has the nodes 8i .. 8i+7 of level l-1 as children, of level 0 the blocks
 * 8i .. 8i+7. */
typedef struct TubeTree {
    TubeBlock *blocks;
    TubeNode *nodes;
    uint64_t block_count, node_count;
    uint64_t first[TUBE_LEVEL_MAX]; /* index of a level's first node in nodes */
    uint32_t level_count;
    Vec3 center; /* world */
} TubeTree;

/* Sorts tubes (their order is changed) into a tree around center, whose distance to every tube's
 * corners is at most radius. The shape depends on the tubes alone, never on threads. tube_count in
 * 1 .. 2^31. */
AmbStatus tube_tree_build(Tube *tubes, uint64_t tube_count, Vec3 center, float radius, Job *job,
                          TubeTree *out_tree);
void tube_tree_clear(TubeTree *tree);

#endif
