/* SPDX-License-Identifier: GPL-3.0-or-later
 * The camera pass: one sample of a pixel, from the lens through boundaries and media. */
#ifndef AMB_CAMERA_CAMERA_PATH_H
#define AMB_CAMERA_CAMERA_PATH_H

#include "field/field.h"

typedef struct CameraParams {
    uint32_t width, height; /* of the full image, pixels */
    uint32_t effects;       /* AMB_EFFECT_* to simulate */
    uint32_t bounces;       /* internal reflections to follow */
    uint32_t seed;
    bool film_transparent;
    bool may_start_inside; /* a translucent object is near where camera rays begin */
    uint32_t replicas;     /* independent sequences that cover a pixel in turn, >= 1: one is more
                            * even, and between two the difference tells the error of their mean */
} CameraParams;

typedef struct CameraSample {
    Rgb single;  /* scattered once in a medium, W m^-2 sr^-1 */
    Rgb surface; /* everything else */
    float alpha;
    float depth;         /* along the view axis, m; CAMERA_DEPTH_NONE where nothing is seen */
    float frequency;     /* sum of contribution * frequency factor */
    float contribution;  /* sum of contributions (mean of channels) */
    uint32_t leak_count; /* segments that left an object through a hole of its mesh */
    bool is_object;      /* the primary ray hits a translucent object */
} CameraSample;

#define CAMERA_DEPTH_NONE 1e10f

/* Radiance of sample `index` of pixel (x, y), y = 0 at the bottom, box filter. field may be NULL:
 * nothing scatters. At each dielectric boundary both the reflected and the refracted branch are
 * followed; radiance is divided by the square of the index entered, so that L / n^2 is kept.
 * Deterministic in (seed, x, y, index). Any thread. */
CameraSample camera_sample(const AmbScene *scene, const Field *field, const CameraParams *params,
                           uint32_t x, uint32_t y, uint32_t index);

#endif
