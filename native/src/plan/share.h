/* SPDX-License-Identifier: GPL-3.0-or-later
 * The share of an effect: the relative error that the picture has without it,
 *   sqrt(mean D^2) / mean L
 * over the pixels that count, D what the effect adds to a pixel and L its whole radiance. The same
 * measure as the accuracy of a render (rel_rmse), so that the two can be compared. */
#ifndef AMB_PLAN_SHARE_H
#define AMB_PLAN_SHARE_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

#include "math/vec3.h"

/* D^2 as the mean of products of two independent samples of D: unbiased, however noisy they are. */
typedef struct ShareSum {
    double square, square_square; /* sums over the probes of weight D_a D_b, and its square */
} ShareSum;

static inline void share_add(ShareSum *sum, double weight, Rgb a, Rgb b) {
    const double square = weight * (double)rgb_mean(rgb_mul(a, b));
    sum->square += square;
    sum->square_square += square * square;
}

typedef struct Share {
    bool is_known;
    double value;
    double low, high; /* the value lies between them, about nineteen times in twenty */
} Share;

/* Two standard errors. */
static const double SHARE_SIGMAS = 2.0;

/* radiance: mean L, and its standard error in units of itself. */
static inline Share share_estimate(const ShareSum *sum, uint64_t count, double radiance,
                                   double radiance_error) {
    if (count < 2 || !(radiance > 0.0))
        return (Share){.is_known = false};
    const double n = (double)count;
    const double mean = sum->square / n;
    const double variance = fmax(sum->square_square / n - mean * mean, 0.0) / (n - 1.0);
    const double spread = SHARE_SIGMAS * sqrt(variance);
    const double factor = 1.0 + SHARE_SIGMAS * radiance_error;
    return (Share){.is_known = true,
                   .value = sqrt(fmax(mean, 0.0)) / radiance,
                   .low = sqrt(fmax(mean - spread, 0.0)) / (radiance * factor),
                   .high = sqrt(fmax(mean + spread, 0.0)) / radiance * factor};
}

#endif
