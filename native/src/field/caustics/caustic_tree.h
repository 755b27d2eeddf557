/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over caustic photons: eight boxes a node, eight photons a leaf. */
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

enum { CAUSTIC_LANES = 8 };

/* Eight photons side by side; unused lanes are all zero and light nothing. */
typedef struct CausticBlock {
    float p[3][CAUSTIC_LANES], n[3][CAUSTIC_LANES];
    float u[3][CAUSTIC_LANES], v[3][CAUSTIC_LANES];
    float peak[3][CAUSTIC_LANES];
    float height2[CAUSTIC_LANES]; /* square of how far off its plane it lights surfaces, m^2 */
} CausticBlock;

/* Boxes of eight children side by side. child > 0: node; child < 0: block ~child; 0: unused, and no
 * point is in its box. */
typedef struct CausticNode {
    float low[3][CAUSTIC_LANES], high[3][CAUSTIC_LANES];
    int32_t child[CAUSTIC_LANES];
} CausticNode;

typedef struct CausticTree {
    CausticNode *nodes; /* nodes[0] is the root */
    CausticBlock *blocks;
    double *flux; /* of the blocks before each, and of all: blocks + 1; mean of channels, W */
    uint64_t photon_count, block_count, node_count;
} CausticTree;

/* Sorts the photons in place: halves at the median of their size, as long as sizes differ by much,
 * then at the median along the longest side, on multiples of eight. The order depends on them
 * alone, never on threads. photon_count >= 1. */
AmbStatus caustic_tree_build(CausticPhoton *photons, uint64_t photon_count, Job *job,
                             CausticTree *out_tree);
void caustic_tree_clear(CausticTree *tree);

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
