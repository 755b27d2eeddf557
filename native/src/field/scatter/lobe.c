/* SPDX-License-Identifier: GPL-3.0-or-later
 * Lobes that are nowhere negative. */
#include "field/scatter/lobe.h"

#include <math.h>

#include "math/harmonics.h"

/* Degrees beyond would add g^l of something small. */
static const double REST = 0.02;
/* Places of [-1, 1] where lobes are looked at, and what they must not fall below there, so that
 * they do not fall below zero between: the mean is 1. */
enum { PLACES = 2048 };
static const double FLOOR = 1e-3;

/* Straight on, in units of g^(degree + 1), of which the first coefficient that is left out is. */
static const double FORWARD_MAX = 1.5;
/* No more: what goes straight on is e^tau times what does not, and depths at which that overflows
 * or is left to roulette have to be dark. From g = 0.92 on. */
static const double FORWARD_MOST = 0.5;
enum { THIRDS = 24 };

/* a at most: at 1 the kernel has zeros, where rounding would go below. */
static const double SHARPEST = 0.98;

/* P_0 .. P_degree. */
static void legendre(double x, uint32_t degree, double *out) {
    out[0] = 1.0;
    out[1] = x;
    for (uint32_t l = 2; l <= degree; ++l)
        out[l] = ((2.0 * l - 1.0) * x * out[l - 1] - (l - 1.0) * out[l - 2]) / l;
}

/* Cosine of angle i + 1/2 of PLACES, so that places lie closer where lobes are sharp. */
static double place(uint32_t i) {
    return cos((double)AMB_PI * (i + 0.5) / PLACES);
}

static double kernel_at(const double *c, double x, uint32_t degree) {
    double p[HARMONIC_DEGREE_MAX + 2], sum = 0.0;
    legendre(x, degree, p);
    for (uint32_t l = 0; l <= degree; ++l)
        sum += (2.0 * l + 1.0) * c[l] * p[l];
    return sum;
}

/* Of P_n: Newton's method comes down to it from 1, where all derivatives are positive. */
static double largest_zero(uint32_t n) {
    double x = 1.0, step = 1.0;
    while (step > 1e-14) {
        double p[HARMONIC_DEGREE_MAX + 2];
        legendre(x, n, p);
        const double slope =
            x < 1.0 ? n * (p[n - 1] - x * p[n]) / (1.0 - x * x) : 0.5 * n * (n + 1);
        step = p[n] / slope;
        x -= step;
    }
    return x;
}

/* J_0 .. J_degree. */
static void sharpest(uint32_t degree, double *out) {
    const uint32_t n = degree / 2 + 1;
    const double z = largest_zero(n);
    for (uint32_t l = 0; l <= degree; ++l)
        out[l] = 0.0;
    for (uint32_t i = 0; i < PLACES; ++i) {
        double p[HARMONIC_DEGREE_MAX + 2];
        const double x = place(i);
        legendre(x, degree > n ? degree : n, p);
        const double root = p[n] / (x - z);
        for (uint32_t l = 0; l <= degree; ++l)
            out[l] += root * root * p[l] * sqrt(1.0 - x * x);
    }
    for (uint32_t l = degree + 1; l-- > 0;)
        out[l] /= out[0];
}

uint32_t lobe_degree(float g) {
    uint32_t degree = 0;
    while (degree < 4 && pow(fabs((double)g), degree + 1) > REST)
        ++degree;
    /* At 4 and 6 the plain sum is nowhere negative up to here. */
    return fabsf(g) > 0.63f ? 8 : fabsf(g) > 0.57f ? 6 : degree;
}

/* As much of a sum as is nowhere negative, and of the smooth kernel of the same mean cosine. */
static void make_positive(double *c, uint32_t degree) {
    double j[HARMONIC_DEGREE_MAX + 1], smooth[HARMONIC_DEGREE_MAX + 1], share = 0.0;
    sharpest(degree, j);
    const double a = fmin(c[1] / j[1], SHARPEST);
    for (uint32_t l = 0; l <= degree; ++l)
        smooth[l] = pow(a, l) * j[l];
    for (uint32_t i = 0; i < PLACES; ++i) {
        const double x = place(i);
        const double low = kernel_at(c, x, degree), high = kernel_at(smooth, x, degree);
        if (low < FLOOR && high > low)
            share = fmax(share, (FLOOR - low) / (high - low));
    }
    share = fmin(share, 1.0);
    for (uint32_t l = 0; l <= degree; ++l)
        c[l] += share * (smooth[l] - c[l]);
}

/* What is left of a lobe without the part that goes straight on, made one again. */
static void leave(double g, double forward, uint32_t degree, double *out) {
    for (uint32_t l = 0; l <= degree; ++l)
        out[l] = (pow(g, l) - forward) / (1.0 - forward);
}

/* The lowest value of what is left, in units of the whole lobe's mean. */
static double lowest(double g, double forward, uint32_t degree) {
    double c[HARMONIC_DEGREE_MAX + 1], least = INFINITY;
    leave(g, forward, degree, c);
    for (uint32_t i = 0; i < PLACES; ++i)
        least = fmin(least, kernel_at(c, place(i), degree));
    return (1.0 - forward) * least;
}

/* The part that goes straight on: none where the plain sum will do, else that of the highest lowest
 * value, which is a concave function of it, being the least of linear ones. */
static double find_forward(double g, uint32_t degree) {
    if (lowest(g, 0.0, degree) >= FLOOR)
        return 0.0;
    double low = 0.0, high = fmin(FORWARD_MAX * pow(g, degree + 1), FORWARD_MOST);
    for (int i = 0; i < THIRDS; ++i) {
        const double a = low + (high - low) / 3.0, b = high - (high - low) / 3.0;
        if (lowest(g, a, degree) < lowest(g, b, degree))
            low = a;
        else
            high = b;
    }
    return 0.5 * (low + high);
}

float lobe_coefficients(float g, uint32_t degree, float *out) {
    const double cosine = fabs((double)g);
    const double forward = degree >= 4 && g > 0.0f ? find_forward(cosine, degree) : 0.0;
    double c[HARMONIC_DEGREE_MAX + 1];
    leave(cosine, forward, degree, c);
    if (degree >= 4)
        make_positive(c, degree);
    for (uint32_t l = 0; l <= degree; ++l)
        out[l] = (float)((1.0 - forward) * (g < 0.0f && l % 2 == 1 ? -c[l] : c[l]));
    return (float)forward;
}

bool lobe_keeps_mean(float g) {
    const uint32_t degree = lobe_degree(g);
    if (degree == 0)
        return true; /* REST at most */
    float c[HARMONIC_DEGREE_MAX + 1];
    const float forward = lobe_coefficients(g, degree, c);
    return fabsf(c[1] + forward - g) < 1e-5f;
}
