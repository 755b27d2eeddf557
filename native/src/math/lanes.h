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

enum { LANE_COUNT = 8, LANES_ALL = 0xFF };

typedef float Lanes __attribute__((vector_size(32)));
typedef int32_t LaneMask __attribute__((vector_size(32))); /* -1 where true */

static inline Lanes lanes_load(const float v[LANE_COUNT]) {
    Lanes lanes;
    memcpy(&lanes, v, sizeof lanes);
    return lanes;
}

static inline void lanes_store(float out[LANE_COUNT], Lanes v) {
    memcpy(out, &v, sizeof v);
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

/* 1 or -1. */
static inline Lanes lanes_sign(Lanes a) {
    return (Lanes)(((LaneMask)a & INT32_MIN) | (LaneMask)lanes_set(1.0f));
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

/* The kept lanes side by side, then zeros or others. */
static inline Lanes lanes_packed(Lanes v, const LanePack *pack) {
#if defined(__AVX2__)
    return (Lanes)_mm256_permutevar8x32_ps((__m256)v, pack->order);
#else
    Lanes out = lanes_set(0.0f);
    int count = 0;
    for (uint32_t bits = pack->bits; bits != 0; bits &= bits - 1)
        out[count++] = v[__builtin_ctz(bits)];
    return out;
#endif
}

/* Writes the kept lanes side by side; out must have room for eight floats, and what follows the
 * kept ones there is undefined. */
static inline void lanes_pack(float *out, Lanes v, const LanePack *pack) {
    lanes_store(out, lanes_packed(v, pack));
}

/* table[index[i]] for each lane, index in 0 .. 15. */
static inline Lanes lanes_lookup(const float table[2 * LANE_COUNT], LaneMask index) {
#if defined(__AVX512VL__)
    return (Lanes)_mm256_permutex2var_ps(_mm256_loadu_ps(table), (__m256i)index,
                                         _mm256_loadu_ps(table + LANE_COUNT));
#elif defined(__AVX2__)
    const __m256 low = _mm256_permutevar8x32_ps(_mm256_loadu_ps(table), (__m256i)index);
    const __m256 high =
        _mm256_permutevar8x32_ps(_mm256_loadu_ps(table + LANE_COUNT), (__m256i)index);
    return (Lanes)_mm256_blendv_ps(low, high, (__m256)(index << 28));
#else
    Lanes out;
    for (int i = 0; i < LANE_COUNT; ++i)
        out[i] = table[index[i]];
    return out;
#endif
}

/* Element i of vector k becomes element k of vector i. */
static inline void lanes_transpose(Lanes v[LANE_COUNT]) {
#if defined(__AVX2__)
    __m256 a[LANE_COUNT], b[LANE_COUNT];
    for (int i = 0; i < LANE_COUNT; i += 2) {
        a[i] = _mm256_unpacklo_ps((__m256)v[i], (__m256)v[i + 1]);
        a[i + 1] = _mm256_unpackhi_ps((__m256)v[i], (__m256)v[i + 1]);
    }
    for (int i = 0; i < LANE_COUNT; i += 4)
        for (int k = 0; k < 2; ++k) {
            b[i + 2 * k] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0x44);
            b[i + 2 * k + 1] = _mm256_shuffle_ps(a[i + k], a[i + k + 2], 0xEE);
        }
    for (int i = 0; i < 4; ++i) {
        v[i] = (Lanes)_mm256_permute2f128_ps(b[i], b[i + 4], 0x20);
        v[i + 4] = (Lanes)_mm256_permute2f128_ps(b[i], b[i + 4], 0x31);
    }
#else
    for (int i = 0; i < LANE_COUNT; ++i)
        for (int k = 0; k < i; ++k) {
            const float swap = v[i][k];
            v[i][k] = v[k][i];
            v[k][i] = swap;
        }
#endif
}

/* Bit i is set where word i has bits in common with a and with b. */
static inline uint32_t words_meeting(const uint16_t words[2 * LANE_COUNT], uint32_t a, uint32_t b) {
#if defined(__AVX2__)
    const __m256i v = _mm256_loadu_si256((const __m256i *)words), zero = _mm256_setzero_si256();
    const __m256i no_a = _mm256_cmpeq_epi16(_mm256_and_si256(v, _mm256_set1_epi16((short)a)), zero);
    const __m256i no_b = _mm256_cmpeq_epi16(_mm256_and_si256(v, _mm256_set1_epi16((short)b)), zero);
    const __m256i none = _mm256_or_si256(no_a, no_b);
    const __m128i bytes =
        _mm_packs_epi16(_mm256_castsi256_si128(none), _mm256_extracti128_si256(none, 1));
    return ~(uint32_t)_mm_movemask_epi8(bytes) & 0xFFFFu;
#else
    uint32_t bits = 0;
    for (int i = 0; i < 2 * LANE_COUNT; ++i)
        bits |= (uint32_t)((words[i] & a) != 0 && (words[i] & b) != 0) << i;
    return bits;
#endif
}

/* Sixteen numbers below 16, a byte each. In registers: what is read soon after it was written in
 * other pieces waits for memory. */
typedef struct ByteList {
    uint64_t bytes[2];
} ByteList;

/* The numbers of the bits set, 0 .. 15, in ascending order, then others. */
static inline ByteList list_bits(uint32_t bits) {
    ByteList list;
#if defined(__AVX2__)
    const uint64_t low = LANES_ORDERS[bits & 0xFF];
    const uint64_t high = LANES_ORDERS[bits >> 8] | UINT64_C(0x0808080808080808);
    /* The second half goes behind the first; two steps, because a shift by 64 is none. */
    const int used = 4 * __builtin_popcount(bits & 0xFF);
    list.bytes[0] = low | high << used << used;
    list.bytes[1] = high >> (32 - used) >> (32 - used);
#else
    uint8_t bytes[2 * LANE_COUNT] = {0};
    for (int count = 0; bits != 0; bits &= bits - 1)
        bytes[count++] = (uint8_t)__builtin_ctz(bits);
    memcpy(list.bytes, bytes, sizeof bytes);
#endif
    return list;
}

/* table[index] for each of eight indices, a byte each. */
static inline LaneMask lanes_lookup_bytes(const uint8_t table[2 * LANE_COUNT], uint64_t index) {
#if defined(__AVX2__)
    const __m128i found = _mm_shuffle_epi8(_mm_loadu_si128((const __m128i *)table),
                                           _mm_cvtsi64_si128((long long)index));
    return (LaneMask)_mm256_cvtepu8_epi32(found);
#else
    uint8_t bytes[LANE_COUNT];
    memcpy(bytes, &index, sizeof bytes);
    LaneMask out;
    for (int i = 0; i < LANE_COUNT; ++i)
        out[i] = table[bytes[i]];
    return out;
#endif
}

static inline void lanes_pack_numbers(uint32_t *out, LaneMask v, const LanePack *pack) {
    const Lanes packed = lanes_packed((Lanes)v, pack);
    memcpy(out, &packed, sizeof packed);
}

/* True in lanes 0 .. count - 1. */
static inline LaneMask lanes_below(uint32_t count) {
    const LaneMask number = {0, 1, 2, 3, 4, 5, 6, 7};
    return number < (int32_t)count;
}

/* Writes first + i for each bit i set, in ascending order; out must have room for eight, and what
 * follows those written is undefined. */
static inline void lanes_store_numbers(uint32_t out[LANE_COUNT], uint32_t first, uint32_t bits) {
#if defined(__AVX2__)
    const __m256i order = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128((long long)LANES_ORDERS[bits]));
    _mm256_storeu_si256((__m256i *)out, _mm256_add_epi32(order, _mm256_set1_epi32((int)first)));
#else
    for (; bits != 0; bits &= bits - 1)
        *out++ = first + (uint32_t)__builtin_ctz(bits);
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
