/* SPDX-License-Identifier: GPL-3.0-or-later
 * How light fades along a stretch of a chord. */
#ifndef AMB_FIELD_TUBES_TUBE_FADE_H
#define AMB_FIELD_TUBES_TUBE_FADE_H

#include "math/lanes.h"

/* The way of light and view through the medium along a stretch of a chord. */
typedef struct Way {
    Lanes middle; /* m, where everything else is taken */
    Lanes change; /* m, from one end to the other */
    Lanes ahead;  /* of the stretch, from its middle to there, towards the shorter way */
    /* Where the light is thick: */
    Lanes near;  /* m, at the end where it is shorter */
    Lanes ratio; /* of `over` (see Meeting) at the near end to that at the far one */
} Way;

/* Where the light fades along the stretch, most of it is not in the middle: flux that changes along
 * it, as where light grazes a wall, must not be taken from there. int u exp(-2 y u) du over that of
 * the exponential alone, -1/2 < u < 1/2, is -(coth y - 1/y) / 2. */
static inline Lanes ahead_of_middle(float sigma_t, const Way *way, bool may_be_thick) {
    const Lanes y = (0.5f * sigma_t) * lanes_abs(way->change);
    const Lanes y2 = y * y;
    const Lanes thin = y * (1.0f / 6.0f - y2 * (1.0f / 90.0f - y2 * (1.0f / 945.0f)));
    const LaneMask is_thick = y > 1.0f;
    if (!may_be_thick || lanes_bits(is_thick) == 0)
        return thin;
    const Lanes twice = 2.0f * lanes_max(y, lanes_set(1.0f));
    const Lanes left = lanes_exp_negative(-twice);
    const Lanes u = 1.0f / twice - left / (1.0f - left);
    return lanes_select(is_thick, 0.5f - way->ratio * u / (1.0f - u + u * way->ratio), thin);
}

/* Mean of exp(-sigma_t way) over the stretch. Thin: the value in the middle times sinh(y)/y, y =
 * sigma_t change / 2. Thick: the light is gone in the middle, and what counts is the near end. From
 * there, places on the chord follow the part u of the way as q = r u / (1 - u + r u), r the ratio,
 * since way is a quotient of linear functions; dq/du is taken in the middle of what fades. */
static inline Lanes fade_along(float sigma_t, const Way *way, bool may_be_thick) {
    const Lanes y = (0.5f * sigma_t) * lanes_abs(way->change);
    const Lanes y2 = y * y;
    /* Back to the middle: the way there is longer. */
    const Lanes thin = lanes_exp_negative(-sigma_t * way->middle - 2.0f * y * way->ahead) *
                       (1.0f + y2 * (1.0f / 6.0f + y2 * (1.0f / 120.0f + y2 * (1.0f / 5040.0f))));
    const LaneMask is_thick = y > 1.0f;
    if (!may_be_thick || lanes_bits(is_thick) == 0)
        return thin;
    const Lanes twice = 2.0f * lanes_max(y, lanes_set(1.0f));
    const Lanes left = lanes_exp_negative(-twice), lost = 1.0f - left;
    const Lanes u = 1.0f / twice - left / lost;
    const Lanes weight = 1.0f - u + u * way->ratio;
    const Lanes thick =
        lanes_exp_negative(-sigma_t * way->near) * lost / twice * way->ratio / (weight * weight);
    return lanes_select(is_thick, thick, thin);
}

#endif
