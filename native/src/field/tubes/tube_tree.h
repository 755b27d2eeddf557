/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over patches of light tubes in the space of their lines: eight children a node. */
#ifndef AMB_FIELD_TUBES_TUBE_TREE_H
#define AMB_FIELD_TUBES_TUBE_TREE_H

#include "field/tubes/tube_patch.h"

enum { TUBE_LANES = 8, TUBE_QUARTERS = 4, TUBE_LEVEL_MAX = 12 };

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

/* Node i of level l > 0 has the nodes 8i .. 8i+7 of level l-1 as children, of level 0 the patches
 * 8i .. 8i+7. */
typedef struct TubeTree {
    TubeLight light;
    TubePatch *patches;
    TubeNode *nodes;
    uint64_t patch_count, node_count;
    uint64_t first[TUBE_LEVEL_MAX]; /* index of a level's first node in nodes */
    uint32_t level_count;
    Vec3 center;    /* world */
    float slack;    /* m, by which f is wrong from rounding, at most */
    float blur;     /* largest of the tubes; 0: the source is a point */
    float edge;     /* m, the longest between corners on the boundary */
    float bend_max; /* the gather quarters tubes in which f is farther from linear, in units of its
                     * range over the corners */
} TubeTree;

/* Builds the tree of tubes around center, whose distance to every tube's corners is at most
 * radius; bend_max is left 0 for the caller to set. The shape depends on the tubes alone, never on
 * threads. tube_count in 1 .. 2^31. */
AmbStatus tube_tree_build(const Tube *tubes, uint64_t tube_count, const TubeLight *light,
                          Vec3 center, float radius, Job *job, TubeTree *out_tree);
void tube_tree_clear(TubeTree *tree);
uint64_t tube_tree_bytes(const TubeTree *tree);

#endif
