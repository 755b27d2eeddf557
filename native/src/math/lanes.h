/* SPDX-License-Identifier: GPL-3.0-or-later
 * Eight floats side by side. Arithmetic and comparisons are the compiler's vector extension; what
 * it lacks in C is written here, once with AVX2 and once in portable C with the same results bit
 * for bit. Sixteen with AVX-512, where the unit that includes this asks for AMB_LANES_16. */
#ifndef AMB_MATH_LANES_H
#define AMB_MATH_LANES_H

#include <math.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVX2__)
#include <immintrin.h>
#endif

#if defined(AMB_LANES_16)
enum { LANE_COUNT = 16, LANES_ALL = 0xFFFF };

typedef float Lanes __attribute__((vector_size(64)));
typedef int32_t LaneMask __attribute__((vector_size(64))); /* -1 where true */
#else
enum { LANE_COUNT = 8, LANES_ALL = 0xFF };

typedef float Lanes __attribute__((vector_size(32)));
typedef int32_t LaneMask __attribute__((vector_size(32))); /* -1 where true */
#endif

static inline Lanes lanes_load(const float v[LANE_COUNT]) {
    Lanes lanes;
    memcpy(&lanes, v, sizeof lanes);
    return lanes;
}

static inline void lanes_store(float out[LANE_COUNT], Lanes v) {
    memcpy(out, &v, sizeof v);
}

static inline Lanes lanes_set(float v) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_set1_ps(v);
#else
    return (Lanes){v, v, v, v, v, v, v, v};
#endif
}

/* Eight of a, and eight of b behind them where there is room. */
static inline Lanes lanes_load_two(const float a[8], const float b[8]) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_insertf32x8(_mm512_castps256_ps512(_mm256_loadu_ps(a)), _mm256_loadu_ps(b),
                                     1);
#else
    (void)b;
    return lanes_load(a);
#endif
}

/* a < b ? a : b, so b where either is not a number. */
static inline Lanes lanes_min(Lanes a, Lanes b) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_min_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
    return (Lanes)_mm256_min_ps((__m256)a, (__m256)b);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = a[i] < b[i] ? a[i] : b[i];
    return a;
#endif
}

/* a > b ? a : b, so b where either is not a number. */
static inline Lanes lanes_max(Lanes a, Lanes b) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_max_ps((__m512)a, (__m512)b);
#elif defined(__AVX2__)
    return (Lanes)_mm256_max_ps((__m256)a, (__m256)b);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = a[i] > b[i] ? a[i] : b[i];
    return a;
#endif
}

static inline Lanes lanes_abs(Lanes v) {
    return lanes_max(v, -v);
}

static inline Lanes lanes_lerp(Lanes a, Lanes b, Lanes q) {
    return a + q * (b - a);
}

static inline Lanes lanes_sqrt(Lanes a) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_sqrt_ps((__m512)a);
#elif defined(__AVX2__)
    return (Lanes)_mm256_sqrt_ps((__m256)a);
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        a[i] = sqrtf(a[i]);
    return a;
#endif
}

/* a where mask, else b. */
static inline Lanes lanes_select(LaneMask mask, Lanes a, Lanes b) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_mask_blend_ps(_mm512_movepi32_mask((__m512i)mask), (__m512)b, (__m512)a);
#elif defined(__AVX2__)
    return (Lanes)_mm256_blendv_ps((__m256)b, (__m256)a, (__m256)mask);
#else
    return (Lanes)(((LaneMask)a & mask) | ((LaneMask)b & ~mask));
#endif
}

/* 1 or -1. */
static inline Lanes lanes_sign(Lanes a) {
    return (Lanes)(((LaneMask)a & INT32_MIN) | (LaneMask)lanes_set(1.0f));
}

/* Bit i is set where lane i of the mask is. */
static inline uint32_t lanes_bits(LaneMask mask) {
#if defined(AMB_LANES_16)
    return (uint32_t)_mm512_movepi32_mask((__m512i)mask);
#elif defined(__AVX2__)
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
#if defined(__AVX2__) && !defined(AMB_LANES_16)
    __m256i order;
#endif
} LanePack;

static inline LanePack lanes_pack_for(uint32_t bits) {
    LanePack pack = {.bits = bits};
#if defined(__AVX2__) && !defined(AMB_LANES_16)
    pack.order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)LANES_ORDERS[bits]));
#endif
    return pack;
}

/* The kept lanes side by side, then zeros or others. */
static inline Lanes lanes_packed(Lanes v, const LanePack *pack) {
#if defined(AMB_LANES_16)
    return (Lanes)_mm512_maskz_compress_ps((__mmask16)pack->bits, (__m512)v);
#elif defined(__AVX2__)
    return (Lanes)_mm256_permutevar8x32_ps((__m256)v, pack->order);
#else
    Lanes out = lanes_set(0.0f);
    int count = 0;
    for (uint32_t bits = pack->bits; bits != 0; bits &= bits - 1)
        out[count++] = v[__builtin_ctz(bits)];
    return out;
#endif
}

/* Writes the kept lanes side by side; out must have room for all lanes, and what follows the kept
 * ones there is undefined. */
static inline void lanes_pack(float *out, Lanes v, const LanePack *pack) {
    lanes_store(out, lanes_packed(v, pack));
}

/* Element i of rows[k] becomes element k of vector i. */
static inline void lanes_load_rows(const float *const rows[LANE_COUNT], Lanes out[8]) {
#if defined(AMB_LANES_16)
    __m512 a[8], b[8];
    for (int i = 0; i < 8; i += 2) {
        const __m512 v = (__m512)lanes_load_two(rows[i], rows[i + 8]);
        const __m512 w = (__m512)lanes_load_two(rows[i + 1], rows[i + 9]);
        a[i] = _mm512_unpacklo_ps(v, w);
        a[i + 1] = _mm512_unpackhi_ps(v, w);
    }
    for (int i = 0; i < 8; i += 4)
        for (int k = 0; k < 2; ++k) {
            b[i + 2 * k] = _mm512_shuffle_ps(a[i + k], a[i + k + 2], 0x44);
            b[i + 2 * k + 1] = _mm512_shuffle_ps(a[i + k], a[i + k + 2], 0xEE);
        }
    /* Four numbers of rows 0, 8 and 4, 12 each; in halves of 64 bits. */
    const __m512i low = _mm512_setr_epi64(0, 1, 8, 9, 4, 5, 12, 13);
    const __m512i high = _mm512_setr_epi64(2, 3, 10, 11, 6, 7, 14, 15);
    for (int i = 0; i < 4; ++i) {
        const __m512d v = _mm512_castps_pd(b[i]), w = _mm512_castps_pd(b[i + 4]);
        out[i] = (Lanes)_mm512_castpd_ps(_mm512_permutex2var_pd(v, low, w));
        out[i + 4] = (Lanes)_mm512_castpd_ps(_mm512_permutex2var_pd(v, high, w));
    }
#elif defined(__AVX2__)
    __m256 a[8], b[8];
    for (int i = 0; i < 8; i += 2) {
        const __m256 v = _mm256_loadu_ps(rows[i]), w = _mm256_loadu_ps(rows[i + 1]);
        a[i] = _mm256_unpacklo_ps(v, w);
        a[i + 1] = _mm256_unpackhi_ps(v, w);
    }
    for (int i = 0; i < 8; i += 4)
        for (int k = 0; k < 2; ++k) {
            b[i + 2 * k] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0x44);
            b[i + 2 * k + 1] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0xEE);
        }
    for (int i = 0; i < 4; ++i) {
        out[i] = (Lanes)_mm256_permute2f128_ps(b[i], b[i + 4], 0x20);
        out[i + 4] = (Lanes)_mm256_permute2f128_ps(b[i], b[i + 4], 0x31);
    }
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        for (int k = 0; k < 8; ++k)
            out[k][i] = rows[i][k];
#endif
}

/* Bit i is set where word i has bits in common with a and with b. */
static inline uint32_t words_meeting(const uint16_t words[16], uint32_t a, uint32_t b) {
#if defined(AMB_LANES_16)
    const __m256i v = _mm256_loadu_si256((const __m256i *)words);
    return _mm256_test_epi16_mask(v, _mm256_set1_epi16((short)a)) &
           (uint32_t)_mm256_test_epi16_mask(v, _mm256_set1_epi16((short)b));
#elif defined(__AVX2__)
    const __m256i v = _mm256_loadu_si256((const __m256i *)words), zero = _mm256_setzero_si256();
    const __m256i no_a = _mm256_cmpeq_epi16(_mm256_and_si256(v, _mm256_set1_epi16((short)a)), zero);
    const __m256i no_b = _mm256_cmpeq_epi16(_mm256_and_si256(v, _mm256_set1_epi16((short)b)), zero);
    const __m256i none = _mm256_or_si256(no_a, no_b);
    const __m128i bytes =
        _mm_packs_epi16(_mm256_castsi256_si128(none), _mm256_extracti128_si256(none, 1));
    return ~(uint32_t)_mm_movemask_epi8(bytes) & 0xFFFFu;
#else
    uint32_t bits = 0;
    for (int i = 0; i < 16; ++i)
        bits |= (uint32_t)((words[i] & a) != 0 && (words[i] & b) != 0) << i;
    return bits;
#endif
}

static inline void lanes_pack_numbers(uint32_t *out, LaneMask v, const LanePack *pack) {
    const Lanes packed = lanes_packed((Lanes)v, pack);
    memcpy(out, &packed, sizeof packed);
}

/* True in lanes 0 .. count - 1. */
static inline LaneMask lanes_below(uint32_t count) {
#if defined(AMB_LANES_16)
    const LaneMask number = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
#else
    const LaneMask number = {0, 1, 2, 3, 4, 5, 6, 7};
#endif
    return number < (int32_t)count;
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
#if defined(AMB_LANES_16)
    return _mm512_reduce_add_ps((__m512)v);
#else
    return ((v[0] + v[1]) + (v[2] + v[3])) + ((v[4] + v[5]) + (v[6] + v[7]));
#endif
}

#endif
