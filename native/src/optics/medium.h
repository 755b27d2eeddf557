/* SPDX-License-Identifier: GPL-3.0-or-later
 * Homogeneous participating medium: extinction, and scattering by Henyey-Greenstein lobes. */
#ifndef AMB_OPTICS_MEDIUM_H
#define AMB_OPTICS_MEDIUM_H

#include <stdint.h>

#include "amberlight/amberlight.h"
#include "math/sampling.h"
#include "math/vec3.h"

typedef struct MediumLobe {
    Rgb sigma_s; /* 1/m */
    float g;     /* mean cosine, (-1, 1) */
} MediumLobe;

typedef struct Medium {
    Rgb sigma_t; /* 1/m, absorption plus scattering of all lobes */
    uint32_t lobe_count;
    MediumLobe lobes[AMB_PHASE_LOBE_MAX];
} Medium;

/* Henyey-Greenstein phase function in 1/sr; its integral over the sphere is 1.
 *   p = (1 - g^2) / (4 pi (1 + g^2 - 2 g cos)^1.5)
 * cos_theta is between the directions of travel before and after (forward = +1), hence the minus
 * sign; the form with wi and wo both pointing away from the vertex has a plus. Pure. */
static inline float phase_hg(float cos_theta, float g) {
    /* 1 + g^2 - 2 g cos as a sum of squares: near the peak of a sharp lobe the plain form is a
     * difference of equal numbers, zero or less. */
    const float a = fabsf(g);
    const float away = fmaxf(1.0f - copysignf(cos_theta, g * cos_theta), 0.0f);
    const float d = (1.0f - a) * (1.0f - a) + 2.0f * a * away;
    return (1.0f - g) * (1.0f + g) / (4.0f * AMB_PI * d * sqrtf(d));
}

static inline bool medium_scatters(const Medium *medium) {
    for (uint32_t i = 0; i < medium->lobe_count; ++i)
        if (rgb_max(medium->lobes[i].sigma_s) > 0.0f)
            return true;
    return false;
}

/* Beer-Lambert transmittance over distance t >= 0 (m), per channel, in [0,1]. */
static inline Rgb medium_transmittance(const Medium *medium, float t) {
    return rgb(expf(-medium->sigma_t.r * t), expf(-medium->sigma_t.g * t),
               expf(-medium->sigma_t.b * t));
}

static inline float medium_scattered_share(float sigma_s, float sigma_t, float t) {
    return sigma_t > 0.0f ? sigma_s / sigma_t * -expm1f(-sigma_t * t) : 0.0f;
}

/* What of light is scattered, once at least, over distance t >= 0 (m), per channel, in [0,1]. */
static inline Rgb medium_scattered(const Medium *medium, float t) {
    Rgb sigma_s = rgb(0, 0, 0);
    for (uint32_t i = 0; i < medium->lobe_count; ++i)
        sigma_s = rgb_add(sigma_s, medium->lobes[i].sigma_s);
    return rgb(medium_scattered_share(sigma_s.r, medium->sigma_t.r, t),
               medium_scattered_share(sigma_s.g, medium->sigma_t.g, t),
               medium_scattered_share(sigma_s.b, medium->sigma_t.b, t));
}

#endif
