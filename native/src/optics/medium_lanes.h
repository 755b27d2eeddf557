/* SPDX-License-Identifier: GPL-3.0-or-later
 * Scattering of eight light rays at once. */
#ifndef AMB_OPTICS_MEDIUM_LANES_H
#define AMB_OPTICS_MEDIUM_LANES_H

#include "math/lanes.h"
#include "optics/medium.h"

/* Sum over the lobes of sigma_s p, 1/(m sr), for each channel, where light that travels along w
 * turns to -d: cosine = d.w, sin2 = |d x w|^2, which need not be rounded from the cosine. */
static inline void medium_scattering_lanes(const Medium *medium, Lanes cosine, Lanes sin2,
                                           Lanes out[3]) {
    out[0] = out[1] = out[2] = lanes_set(0.0f);
    /* 1 + cos and 1 - cos from sin^2 where the difference would cancel. */
    const LaneMask is_negative = cosine < 0.0f;
    const Lanes magnitude = lanes_select(is_negative, -cosine, cosine);
    const Lanes large = 1.0f + magnitude, small = sin2 / large;
    const Lanes one_plus = lanes_select(is_negative, small, large);
    const Lanes one_minus = lanes_select(is_negative, large, small);
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        const MediumLobe *lobe = &medium->lobes[l];
        const float g = lobe->g;
        /* phase_hg, with the light turning from w to -d: 1 + g^2 + 2 g cos as a sum of terms that
         * are never negative, so that the peak of the sharpest lobe keeps its digits. */
        const Lanes denominator = g >= 0.0f ? (1.0f - g) * (1.0f - g) + 2.0f * g * one_plus
                                            : (1.0f + g) * (1.0f + g) - 2.0f * g * one_minus;
        const Lanes p =
            ((1.0f - g) * (1.0f + g) / (4.0f * AMB_PI)) / (denominator * lanes_sqrt(denominator));
        out[0] += lobe->sigma_s.r * p;
        out[1] += lobe->sigma_s.g * p;
        out[2] += lobe->sigma_s.b * p;
    }
}

#endif
