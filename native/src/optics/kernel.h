/* SPDX-License-Identifier: GPL-3.0-or-later
 * The kernel of a volume sample: how far around its light ray it counts. */
#ifndef AMB_OPTICS_KERNEL_H
#define AMB_OPTICS_KERNEL_H

#include <math.h>

#include "math/sampling.h"

/* Frequency factor of a light ray, in [0,1]: 0 where its tube has spread without bound, 1/2 where
 * it is as wide as at entry, 1 at a focus.
 *   eta_hat = a_0 / (a_0 + a(s))
 * [Liang19] eq. 7 takes sqrt|Sigma|, which every lossless specular path leaves constant: it
 * cannot see a caustic. The spectrum's slice at zero angular frequency (the Schur complement)
 * has sqrt|S| ~ 1/a(s) and can; see docs/theory.md. */
static inline float kernel_frequency(float entry_area, float area) {
    return entry_area / (entry_area + area);
}

/* [Liang19] eq. 8, multiplier k of the kernel's cross-section: C_k at frequency 0 down to
 * C_k (1 - 2 alpha) at 1 (the text says (1 - alpha), its formula gives this). */
static inline float kernel_multiplier(float kernel_size, float frequency) {
    const float alpha = 0.4f;
    return kernel_size * (alpha * cosf(AMB_PI * frequency) + 1.0f - alpha);
}

/* Radius of the disc of a given cross-section, m. */
static inline float kernel_radius(float area) {
    return sqrtf(area / AMB_PI);
}

#endif
