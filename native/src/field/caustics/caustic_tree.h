/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over caustic photons: a balanced binary tree of boxes, eight photons a leaf. */
#ifndef AMB_FIELD_CAUSTICS_CAUSTIC_TREE_H
#define AMB_FIELD_CAUSTICS_CAUSTIC_TREE_H

#include "base/parallel.h"
#include "math/vec3.h"

/* Flux on an opaque surface, spread over an ellipse: with x the offset from p, r = |(u.x, v.x)|,
 * its irradiance is peak (1 - r^2) where r < 1. */
typedef struct CausticPhoton {
    Vec3 p, n; /* m; unit, on the side that the light comes from */
    Vec3 u, v; /* in the plane across n: inverse half-axes, 1/m */
    Rgb peak;  /* 2 flux / area of the ellipse, W/m^2 */
} CausticPhoton;

typedef struct CausticBox {
    Vec3 low, high;
} CausticBox;

/* Node i over `count` blocks has its left child, over half of them (rounded up), at i + 1, and its
 * right one at i + 2 * that half. A node over one block is a leaf. */
typedef struct CausticTree {
    CausticPhoton *photons;
    CausticBox *boxes; /* by node, 2 * blocks - 1 */
    uint64_t photon_count, block_count;
} CausticTree;

/* Sorts the photons in place: halves at the median of their size, as long as sizes differ by much,
 * then at the median along the longest side, on multiples of eight.
 * The tree takes them over; on failure they are freed. The order depends on them alone, never on
 * threads. photon_count >= 1. */
AmbStatus caustic_tree_build(CausticPhoton *photons, uint64_t photon_count, Job *job,
                             CausticTree *out_tree);
void caustic_tree_clear(CausticTree *tree);

/* Sum of irradiance at a point of a surface with unit normal n on the side that is asked for. */
Rgb caustic_tree_irradiance(const CausticTree *tree, Vec3 p, Vec3 n);

#endif
