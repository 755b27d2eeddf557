/* SPDX-License-Identifier: GPL-3.0-or-later
 * Eight floats side by side. Arithmetic and comparisons are the compiler's vector extension; what
 * it lacks in C is written here, once with AVX2 and once in portable C with the same results bit
 * for bit. */
#ifndef AMB_MATH_LANES_H
#define AMB_MATH_LANES_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

enum { LANE_COUNT = 8 };

typedef float Lanes __attribute__((vector_size(32)));
typedef int32_t LaneMask __attribute__((vector_size(32))); /* -1 where true */

static inline Lanes lanes_load(const float v[LANE_COUNT]) {
    Lanes lanes;
    memcpy(&lanes, v, sizeof lanes);
    return lanes;
}

static inline Lanes lanes_set(float v) {
    return (Lanes){v, v, v, v, v, v, v, v};
}

/* a < b ? a : b, so b where either is not a number. */
static inline Lanes lanes_min(Lanes a, Lanes b) {
#if defined(__AVX2__)
    return (Lanes)_mm256_min_ps((__m256)a, (__m256)b);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = a[i] < b[i] ? a[i] : b[i];
    return a;
#endif
}

/* a > b ? a : b, so b where either is not a number. */
static inline Lanes lanes_max(Lanes a, Lanes b) {
#if defined(__AVX2__)
    return (Lanes)_mm256_max_ps((__m256)a, (__m256)b);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = a[i] > b[i] ? a[i] : b[i];
    return a;
#endif
}

static inline Lanes lanes_sqrt(Lanes a) {
#if defined(__AVX2__)
    return (Lanes)_mm256_sqrt_ps((__m256)a);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = sqrtf(a[i]);
    return a;
#endif
}

/* a where mask, else b. */
static inline Lanes lanes_select(LaneMask mask, Lanes a, Lanes b) {
    return (Lanes)(((LaneMask)a & mask) | ((LaneMask)b & ~mask));
}

/* Bit i is set where lane i of the mask is. */
static inline uint32_t lanes_bits(LaneMask mask) {
#if defined(__AVX2__)
    return (uint32_t)_mm256_movemask_ps((__m256)mask);
#else
    uint32_t bits = 0;
    for (int i = 0; i < LANE_COUNT; ++i)
        bits |= (uint32_t)(mask[i] & 1) << i;
    return bits;
#endif
}

/* exp(x) for x <= 0 by 2^(n + f), relative error below 3e-7; 0 below -87. */
static inline Lanes lanes_exp_negative(Lanes x) {
    const LaneMask is_tiny = x < -87.0f;
    const Lanes y = lanes_max(x, lanes_set(-87.0f)) * 1.44269504f;
    const LaneMask n = __builtin_convertvector(y - 0.5f, LaneMask); /* nearest, for y <= 0 */
    const Lanes f = (y - __builtin_convertvector(n, Lanes)) * 0.693147181f; /* [-0.35, 0.35] */
    Lanes p = lanes_set(1.0f / 720.0f);
    p = p * f + 1.0f / 120.0f;
    p = p * f + 1.0f / 24.0f;
    p = p * f + 1.0f / 6.0f;
    p = p * f + 0.5f;
    p = p * f + 1.0f;
    p = p * f + 1.0f;
    const Lanes scale = (Lanes)((n + 127) << 23);
    return (Lanes)((LaneMask)(p * scale) & ~is_tiny);
}

/* Sum in a fixed order. */
static inline float lanes_sum(Lanes v) {
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]));
}

#endif
