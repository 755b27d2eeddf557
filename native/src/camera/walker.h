/* SPDX-License-Identifier: GPL-3.0-or-later
 * What all parts of one camera sample share. */
#ifndef AMB_CAMERA_WALKER_H
#define AMB_CAMERA_WALKER_H

#include "base/rng.h"
#include "camera/camera_path.h"

/* Branches with less throughput survive by chance in proportion: unbiased. */
#define WALKER_ROULETTE_THROUGHPUT 0.01f

typedef struct Walker {
    const AmbScene *scene;
    const Field *field; /* NULL: no lamp's light scatters */
    const CameraParams *params;
    Rng rng;
    uint32_t dimension; /* next unused random number */
    CameraSample *out;
    const CameraObserver *observer; /* NULL: what is seen is summed up in out */
    CameraWay way;                  /* of a walk's beginning */
    bool has_frequency;             /* see camera_sample */
} Walker;

/* Notes which effects radiance along a way owes itself to. */
static inline void walker_note(Walker *walker, const CameraWay *way, Rgb radiance) {
    const float mean = rgb_mean(radiance);
    float *parts = walker->out->parts;
    if ((way->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0)
        parts[CAMERA_PART_REFLECTION] += mean;
    if ((way->effects & AMB_EFFECT_BACKGROUND) != 0)
        parts[CAMERA_PART_BACKGROUND] += mean;
    if (way->bounces > 0)
        parts[CAMERA_PART_BOUNCES] += mean;
}

static inline float walker_random(Walker *walker) {
    return rng_float(walker->rng, walker->dimension++);
}

static inline Sample2 walker_random2(Walker *walker) {
    const float u = walker_random(walker);
    return (Sample2){u, walker_random(walker)};
}

static inline Rgb rgb_madd(Rgb a, Rgb b, Rgb c) {
    return rgb_add(a, rgb_mul(b, c));
}

#endif
