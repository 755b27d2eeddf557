/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that scattered once and then goes straight on towards the eye, several lanes at once. */
#ifndef AMB_FIELD_STRAIGHT_LANES_H
#define AMB_FIELD_STRAIGHT_LANES_H

#include "math/lanes.h"

/* exp(x) - 1 - x for x >= 0. */
static inline Lanes straight_several(Lanes x) {
    const Lanes thin =
        x * x *
        (0.5f + x * (1.0f / 6.0f + x * (1.0f / 24.0f + x * (1.0f / 120.0f + x * (1.0f / 720.0f)))));
    const LaneMask is_thick = x > 0.5f;
    if (lanes_bits(is_thick) == 0)
        return thin;
    /* Where x is 60 nothing is left of the light: see scatter_forward_depth. */
    const Lanes grown = 1.0f / lanes_exp_negative(-lanes_min(x, lanes_set(60.0f)));
    return lanes_select(is_thick, grown - 1.0f - x, thin);
}

/* Where light reaches the segment: from t = near to near + span, fading by exp(-depth) on the way
 * from the one to the other; at the middle of its stretch t is `bend` above that of the ends. */
typedef struct StraightStretch {
    Lanes near, span, bend, depth;
} StraightStretch;

/* Of light the means of x and of exp(x) - 1 - x, x = forward t. By the mean of t and its variance:
 * stretches are short, or light is gone at their ends. */
static inline void straight_along(const StraightStretch *stretch, float forward, Lanes light,
                                  Lanes *once, Lanes *more) {
    const Lanes k = stretch->depth;
    Lanes mean = 0.5f - k * (1.0f / 12.0f - k * k * (1.0f / 720.0f));
    Lanes variance = 1.0f / 12.0f - k * k * (1.0f / 240.0f);
    const LaneMask is_thick = k > 0.5f;
    if (lanes_bits(is_thick) != 0) {
        const Lanes inverse = 1.0f / lanes_max(k, lanes_set(0.5f));
        const Lanes left = lanes_exp_negative(-lanes_max(k, lanes_set(0.5f)));
        const Lanes ratio = left / (1.0f - left);
        mean = lanes_select(is_thick, inverse - ratio, mean);
        variance = lanes_select(is_thick, inverse * inverse - ratio / (1.0f - left), variance);
    }
    /* Over all of an arc it is two thirds of its height. */
    const Lanes arc = (8.0f / 3.0f) * mean * (1.0f - mean) * stretch->bend;
    const Lanes x =
        lanes_max(forward * (stretch->near + mean * stretch->span + arc), lanes_set(0.0f));
    const Lanes width = forward * stretch->span, several = straight_several(x);
    *once += light * x;
    *more += light * (several + 0.5f * (1.0f + x + several) * variance * (width * width));
}

#endif
