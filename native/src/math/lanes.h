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

#if defined(__AVX2__)
/* For each set of lanes their numbers in ascending order, a byte each. */
#define LANES_RANK(b, i)                                                                           \
    (8 * (((i) > 0 ? (b)&1 : 0) + ((i) > 1 ? (b) >> 1 & 1 : 0) + ((i) > 2 ? (b) >> 2 & 1 : 0) +    \
          ((i) > 3 ? (b) >> 3 & 1 : 0) + ((i) > 4 ? (b) >> 4 & 1 : 0) +                            \
          ((i) > 5 ? (b) >> 5 & 1 : 0) + ((i) > 6 ? (b) >> 6 & 1 : 0)))
#define LANES_PLACE(b, i) ((UINT64_C(i) * ((b) >> (i)&1)) << LANES_RANK(b, i))
#define LANES_ORDER(b)                                                                             \
    (LANES_PLACE(b, 0) | LANES_PLACE(b, 1) | LANES_PLACE(b, 2) | LANES_PLACE(b, 3) |               \
     LANES_PLACE(b, 4) | LANES_PLACE(b, 5) | LANES_PLACE(b, 6) | LANES_PLACE(b, 7))
#define LANES_ORDER4(b)                                                                            \
    LANES_ORDER(b), LANES_ORDER((b) + 1), LANES_ORDER((b) + 2), LANES_ORDER((b) + 3)
#define LANES_ORDER16(b)                                                                           \
    LANES_ORDER4(b), LANES_ORDER4((b) + 4), LANES_ORDER4((b) + 8), LANES_ORDER4((b) + 12)
#define LANES_ORDER64(b)                                                                           \
    LANES_ORDER16(b), LANES_ORDER16((b) + 16), LANES_ORDER16((b) + 32), LANES_ORDER16((b) + 48)
static const uint64_t LANES_ORDERS[256] = {LANES_ORDER64(0), LANES_ORDER64(64), LANES_ORDER64(128),
                                           LANES_ORDER64(192)};
#endif

/* Which lanes to keep, prepared for lanes_pack. */
typedef struct LanePack {
    uint32_t bits;
#if defined(__AVX2__)
    __m256i order;
#endif
} LanePack;

static inline LanePack lanes_pack_for(uint32_t bits) {
    LanePack pack = {.bits = bits};
#if defined(__AVX2__)
    pack.order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)LANES_ORDERS[bits]));
#endif
    return pack;
}

/* Writes the kept lanes side by side; out must have room for eight floats, and what follows the
 * kept ones there is undefined. */
static inline void lanes_pack(float *out, Lanes v, const LanePack *pack) {
#if defined(__AVX2__)
    _mm256_storeu_ps(out, _mm256_permutevar8x32_ps((__m256)v, pack->order));
#else
    for (uint32_t bits = pack->bits; bits != 0; bits &= bits - 1)
        *out++ = v[__builtin_ctz(bits)];
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
