/* SPDX-License-Identifier: GPL-3.0-or-later
 * Directions after a scattering, with the pdf beside them. */
#ifndef AMB_OPTICS_PHASE_SAMPLE_H
#define AMB_OPTICS_PHASE_SAMPLE_H

#include "optics/medium.h"

/* Cosine between the directions of travel before and after, distributed as the Henyey-Greenstein
 * lobe: the inverse of its cumulative distribution, [HenyeyGreenstein41], written without the
 * division by g, so that g = 0 is an ordinary value. u in [0, 1). */
static inline float phase_hg_sample(float u, float g) {
    const float x = 2.0f * u - 1.0f;
    const float stretch = 1.0f + g * x;
    const float numerator =
        x + g * (0.5f * (x * x + 3.0f) + g * (x + 0.5f * g * (x - 1.0f) * (x + 1.0f)));
    return clampf(numerator / (stretch * stretch), -1.0f, 1.0f);
}

/* Unit direction at a cosine from unit d, phi = 2 pi v. */
static inline Vec3 phase_direction(Vec3 d, float cosine, float v) {
    Vec3 x, y;
    vec3_frame(d, &x, &y);
    const float sine = safe_sqrtf((1.0f - cosine) * (1.0f + cosine));
    const float phi = 2.0f * AMB_PI * v;
    return vec3_normalize(
        frame_to_world(x, y, d, vec3(sine * cosf(phi), sine * sinf(phi), cosine)));
}

#endif
