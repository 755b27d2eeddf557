/* SPDX-License-Identifier: GPL-3.0-or-later
 * Volume samples: stretches of light rays with a kernel around them, and the sum over those that
 * a camera segment passes through.
 *
 * A sample is a cylinder around a stretch of a light ray ([Liang19] fig. 7). Its light is spread
 * over the cross-section by K, int K dA = 1, so that inside it
 *   Q(x, -d) = sigma_s p(cos) Phi exp(-sigma_t s(x)) K(x_perp).
 * The camera's segment is not marched: K is integrated along the chord that lies inside the
 * cylinder, so that the result does not depend on a camera step, nor (with exp evaluated at x's
 * own s) on how a ray is divided into samples. */
#ifndef AMB_FIELD_POINTS_POINTS_H
#define AMB_FIELD_POINTS_POINTS_H

#include "field/field.h"
#include "field/points/point_tree.h"

typedef struct PointParams {
    bool follows_covariance; /* kernel by eq. 8 from each sample's own frequency factor; else one
                              * radius for all samples of an object ([Wang16]) */
    float kernel_size;
    float spacing;             /* length of a sample along its ray, m, about */
    uint32_t part, part_count; /* of the beams, by rank: 0 .. part_count - 1; 0, 0: all */
} PointParams;

typedef struct PointCloud {
    PointCount count;
    Medium medium;
    PointTree tree;
} PointCloud;

AmbStatus points_build(const LightBeams *beams, const Medium *medium, const PointParams *params,
                       Job *job, PointCloud *out_cloud);
void points_clear(PointCloud *cloud);
uint64_t points_bytes(const PointCloud *cloud);

/* See field_gather. met: counts the samples that send light, by kind; NULL: not asked for. */
FieldRadiance points_gather(const PointCloud *cloud, const FieldSegment *segment, PointCount *met);

#endif
