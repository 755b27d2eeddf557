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

/* D^2 as the mean of products of two independent samples of D: unbiased, however noisy they are.
 * Where few walks find anything, few products are not zero; the mean of D itself, which the root of
 * the mean square is never below, is known much better then. */
typedef struct ShareSum {
    double square, square_square;  /* sums over the probes of weight D_a D_b, and its square */
    double mean, mean_square;      /* the same of weight (D_a + D_b) / 2 */
    double square_most, mean_most; /* the largest of either */
    double variance;               /* sum of weight (D_a - D_b)^2 / 2: of one sample */
} ShareSum;

static inline void share_add(ShareSum *sum, double weight, Rgb a, Rgb b) {
    const double square = weight * (double)rgb_mean(rgb_mul(a, b));
    sum->square += square;
    sum->square_square += square * square;
    const double mean = weight * (double)rgb_mean(rgb_scale(rgb_add(a, b), 0.5f));
    sum->mean += mean;
    sum->mean_square += mean * mean;
    sum->square_most = fmax(sum->square_most, square);
    sum->mean_most = fmax(sum->mean_most, mean);
    const Rgb difference = rgb_add(a, rgb_scale(b, -1.0f));
    sum->variance += 0.5 * weight * (double)rgb_mean(rgb_mul(difference, difference));
}

typedef struct Share {
    bool is_known;
    double value;
    double low, high; /* the value lies between them, about nineteen times in twenty */
} Share;

/* Two standard errors; upwards also what one more probe would add that is like the largest so far:
 * of light that few pixels have, few probes know too little of its spread. */
static const double SHARE_SIGMAS = 2.0;

/* The spread of a mean of count numbers by their sums. */
static inline double share_spread(double sum, double square_sum, double count) {
    const double mean = sum / count;
    return SHARE_SIGMAS * sqrt(fmax(square_sum / count - mean * mean, 0.0) / (count - 1.0));
}

/* radiance: mean L, and its standard error in units of itself. */
static inline Share share_estimate(const ShareSum *sum, uint64_t count, double radiance,
                                   double radiance_error) {
    if (count < 2 || !(radiance > 0.0))
        return (Share){.is_known = false};
    const double n = (double)count, square = sum->square / n, mean = sum->mean / n;
    const double square_spread = share_spread(sum->square, sum->square_square, n);
    const double mean_spread = share_spread(sum->mean, sum->mean_square, n);
    const double factor = 1.0 + SHARE_SIGMAS * radiance_error;
    const double low = fmax(sqrt(fmax(square - square_spread, 0.0)), mean - mean_spread);
    const double high = fmax(sqrt(fmax(square + square_spread + sum->square_most / n, 0.0)),
                             mean + mean_spread + sum->mean_most / n);
    return (Share){.is_known = true,
                   .value = fmax(sqrt(fmax(square, 0.0)), mean) / radiance,
                   .low = low / (radiance * factor),
                   .high = high / radiance * factor};
}

#endif
