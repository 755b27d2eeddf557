/* SPDX-License-Identifier: GPL-3.0-or-later
 * [Wang16]'s double and multiple scattering: volume samples connected to points of the camera's
 * segment by straight lines, far ones together, through a cut of their hierarchy. */
#ifndef AMB_FIELD_SCATTER_TREE_CUT_H
#define AMB_FIELD_SCATTER_TREE_CUT_H

#include "field/field.h"

typedef struct TreeCut TreeCut;

typedef struct TreeCutParams {
    LightTraceParams light; /* its ray_count is set from sample_count */
    uint64_t sample_count;  /* volume samples to place, about */
    uint32_t order_max;     /* scatterings after which light is left out; 0: no limit */
} TreeCutParams;

/* Radiance at the segment's start by the number of scatterings, W m^-2 sr^-1, inside the medium
 * (no n^2). */
typedef struct TreeCutRadiance {
    Rgb twice, more;
} TreeCutRadiance;

/* The scene must outlive it. Same result for any number of threads. */
AmbStatus tree_cut_create(const AmbScene *scene, const TreeCutParams *params, Job *job,
                          TreeCut **out_cut);
void tree_cut_destroy(TreeCut *cut);

/* Any thread; the cut is const. */
TreeCutRadiance tree_cut_gather(const TreeCut *cut, const FieldSegment *segment);

uint64_t tree_cut_bytes(const TreeCut *cut);
uint64_t tree_cut_sample_count(const TreeCut *cut);

#endif
