/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over the volume samples of one object for connections from afar: each node says how
 * much light its samples carry, where it is and where it goes ([Wang16]: x_v, d_v, I_v). */
#ifndef AMB_FIELD_SCATTER_VOLUME_TREE_H
#define AMB_FIELD_SCATTER_VOLUME_TREE_H

#include "light/light_trace.h"

/* Samples under a node as one light: a ball of the same centre and variance whose light travels
 * along `axis` with a spread. */
typedef struct VolumeNode {
    Vec3 center;       /* mean place, weighted with the light */
    float ball;        /* m, radius of the uniform ball of the same variance */
    Vec3 axis;         /* unit, mean direction of travel */
    float mean_cosine; /* of directions to the axis: 1 where all are alike */
    Rgb stretch;       /* int flux ds along the samples, W m: times a coefficient, watts */
    uint32_t first;    /* children are nodes first .. first + count - 1 */
    uint32_t count;    /* 0: a sample */
} VolumeNode;

typedef struct VolumeTree {
    VolumeNode *nodes; /* nodes[0] is the root */
    uint64_t node_count;
    uint64_t sample_count; /* 0: no light */
} VolumeTree;

/* Of the ways of all beams, as far as they carry light, m. */
float volume_tree_length(const LightBeams *beams, const Medium *medium);

/* Cuts beams into samples `spacing` long on average. Same result for any number of threads. */
AmbStatus volume_tree_build(const LightBeams *beams, const Medium *medium, float spacing, Job *job,
                            VolumeTree *out_tree);
void volume_tree_clear(VolumeTree *tree);
uint64_t volume_tree_bytes(const VolumeTree *tree);

#endif
