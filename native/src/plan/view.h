/* SPDX-License-Identifier: GPL-3.0-or-later
 * What the camera sees: the pixels among which the planner picks its probes. */
#ifndef AMB_PLAN_VIEW_H
#define AMB_PLAN_VIEW_H

#include "camera/camera_path.h"

typedef struct ViewPixel {
    uint32_t x, y;   /* of the full image */
    uint32_t object; /* translucent, that its ray meets first */
} ViewPixel;

typedef struct View {
    ViewPixel *pixels; /* grouped by object */
    uint64_t count;
    uint64_t *firsts;    /* by object, object_count + 1: where its pixels begin */
    double *areas;       /* by object: its share of the pixels that show any */
    double *reflections; /* by pixel, running sums of what view_weigh_reflections found; or NULL */
    uint32_t object_count, visible_count;
    double part;     /* of the rectangle's pixels, those that show an object */
    bool has_opaque; /* an opaque surface is seen */
} View;

typedef struct ViewParams {
    uint32_t x, y, width, height; /* rectangle of the full image */
    uint32_t full_width, full_height;
    uint32_t ray_count; /* about, at most one a pixel */
    uint32_t seed;
    bool may_start_inside; /* as of CameraParams */
} ViewParams;

/* Primary rays over the rectangle; an object that they miss gets some of its own. */
AmbStatus view_create(const AmbScene *scene, const ViewParams *params, Job *job, View *out_view);
void view_clear(View *view);

typedef struct ViewProbe {
    ViewPixel pixel;
    double weight; /* of what is seen there in a mean over all pixels that show an object */
} ViewProbe;

/* Probe i of a sequence of which every beginning covers the pixels evenly; half of it goes to the
 * objects by their size in the picture, half to each alike, but for a quarter of all that goes to
 * reflections where these are known. view->visible_count must be > 0. */
ViewProbe view_probe(const View *view, uint64_t i);

#endif
