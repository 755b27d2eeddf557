/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over caustic photons: a balanced binary tree of boxes, eight photons a leaf. */
#ifndef AMB_FIELD_CAUSTICS_CAUSTIC_TREE_H
#define AMB_FIELD_CAUSTICS_CAUSTIC_TREE_H

#include "base/parallel.h"
#include "math/sampling.h"

/* Photons on faces that turn away from one another more than this do not mix. */
#define CAUSTIC_NORMAL_COS_MIN 0.5f

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
    double *flux;      /* of the blocks before each, and of all: blocks + 1; mean of channels, W */
    uint64_t photon_count, block_count;
} CausticTree;

/* Sorts the photons in place: halves at the median of their size, as long as sizes differ by much,
 * then at the median along the longest side, on multiples of eight.
 * The tree takes them over; on failure they are freed. The order depends on them alone, never on
 * threads. photon_count >= 1. */
AmbStatus caustic_tree_build(CausticPhoton *photons, uint64_t photon_count, Job *job,
                             CausticTree *out_tree);
void caustic_tree_clear(CausticTree *tree);

/* Sum of irradiance at a point of a surface with unit normal n on the side that is asked for. Of
 * each photon it is 1 / (1 + peak dimmed), peak the mean of its channels; dimmed 0: all, m^2/W. */
Rgb caustic_tree_irradiance(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed);

/* A place that a photon lights. */
typedef struct CausticPoint {
    Vec3 p, n;     /* on the photon's plane, and its normal */
    float height;  /* how far above and below it surfaces are lit, m */
    Rgb flux;      /* the photon's over the chance that it is chosen, W */
    float density; /* with which photons are chosen around, about: 1/m^2. Of the tree alone: the
                    * photon's peak, mean of channels, W/m^2 */
} CausticPoint;

static inline double caustic_tree_flux(const CausticTree *tree) {
    return tree->photon_count > 0 ? tree->flux[tree->block_count] : 0.0;
}

/* The photon that `flux` is of, from 0 to all of the tree, and a place in proportion to its
 * irradiance. */
CausticPoint caustic_tree_choose(const CausticTree *tree, double flux, Sample2 place);

#endif
