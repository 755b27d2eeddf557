/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over volume samples: eight boxes a node, eight samples a leaf. */
#ifndef AMB_FIELD_POINTS_POINT_TREE_H
#define AMB_FIELD_POINTS_POINT_TREE_H

#include "base/parallel.h"
#include "math/vec3.h"

enum { POINT_LANES = 8 };

/* A volume sample: a cylinder around origin + s direction, low <= s < high. */
typedef struct PointSample {
    Vec3 origin, direction;        /* m, unit */
    float low, high;               /* m along direction */
    float radius;                  /* m */
    Rgb flux;                      /* W at the origin */
    float frequency;               /* factor in [0,1] */
    bool is_reflected, has_passed; /* see FieldRadiance */
} PointSample;

/* Samples by what their light did before. */
typedef struct PointCount {
    uint64_t all;
    uint64_t passed, reflected; /* of these; reflected: that have not passed */
} PointCount;

/* Eight samples side by side; unused lanes are all zero and never hit. */
typedef struct PointBlock {
    float origin[3][POINT_LANES];
    float direction[3][POINT_LANES];
    float low[POINT_LANES], high[POINT_LANES];
    float radius2[POINT_LANES];
    float normalization[POINT_LANES]; /* 2 / (pi R^4) of the kernel, m^-4 */
    float flux[3][POINT_LANES];
    float frequency[POINT_LANES];
    uint8_t reflected, passed; /* bit by lane */
} PointBlock;

/* child > 0: node; child < 0: block ~child; 0: unused, as are all after it. */
typedef struct PointNode {
    float low[3][POINT_LANES];
    float high[3][POINT_LANES];
    int32_t child[POINT_LANES];
} PointNode;

typedef struct PointTree {
    PointNode *nodes; /* nodes[0] is the root */
    PointBlock *blocks;
    uint64_t node_count, block_count;
} PointTree;

/* Sorts samples into a balanced tree: each node divides its samples in half three times, at the
 * median along the longest side, on a multiple of eight so that leaves are full. The shape
 * depends on the samples alone, never on threads. sample_count in 1 .. 2^31. */
AmbStatus point_tree_build(const PointSample *samples, uint64_t sample_count, Job *job,
                           PointTree *out_tree);
void point_tree_clear(PointTree *tree);

#endif
