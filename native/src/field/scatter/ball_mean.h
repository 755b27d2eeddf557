/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inverse square law for light that comes from a ball instead of a point. */
#ifndef AMB_FIELD_SCATTER_BALL_MEAN_H
#define AMB_FIELD_SCATTER_BALL_MEAN_H

#include <math.h>

/* Means over a uniform ball seen from a distance d to its centre: of 1 / r^2, of 1 / r, and of
 * the cosine of the direction to the ball's points, weighted with 1 / r^2, to that of its centre.
 * The potential and the field (Gauss) of a ball of uniform charge, and an elementary integral. */
typedef struct BallMean {
    float inverse2, inverse, coherence;
} BallMean;

static inline BallMean ball_mean(float d, float ball) {
    BallMean mean = {1.0f / (d * d), 1.0f / d, 1.0f};
    if (d > 8.0f * ball) {
        const float x = ball / d;
        mean.inverse2 *= 1.0f + 0.2f * x * x; /* the next term is 3/35 x^4 */
        mean.coherence = 1.0f / (1.0f + 0.2f * x * x);
        return mean;
    }
    const float x = d / ball;
    float logarithm = 2.0f; /* (1 - x^2) / x ln |(1 + x) / (1 - x)| */
    if (fabsf(x - 1.0f) < 1e-4f)
        logarithm = 0.0f;
    else if (x > 1e-3f)
        logarithm = (1.0f - x * x) / x * logf((1.0f + x) / fabsf(1.0f - x));
    mean.inverse2 = 0.75f * (2.0f + logarithm) / (ball * ball);
    const float field = x < 1.0f ? x / (ball * ball) : 1.0f / (d * d);
    mean.coherence = fminf(field / mean.inverse2, 1.0f);
    if (x < 1.0f)
        mean.inverse = (1.5f - 0.5f * x * x) / ball;
    return mean;
}

#endif
