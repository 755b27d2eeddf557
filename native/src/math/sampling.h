/* SPDX-License-Identifier: GPL-3.0-or-later
 * Point sets and the maps from the unit square onto discs, caps and hemispheres. Every map but
 * that onto a dome keeps area: its pdf is the inverse of the target's measure. */
#ifndef AMB_MATH_SAMPLING_H
#define AMB_MATH_SAMPLING_H

#include <stdint.h>

#include "math/vec3.h"

#define AMB_PI 3.14159265358979323846f

typedef struct Sample2 {
    float u, v; /* [0,1)^2 */
} Sample2;

/* Point i of the R2 sequence (additive recurrence of the plastic number, [Roberts18]), shifted
 * by (su, sv) modulo 1. Low discrepancy for any prefix. */
static inline Sample2 sample_r2(uint64_t i, float su, float sv) {
    /* 0.64 fixed point: exact wrap-around at any index. */
    const uint64_t u = i * 0xc13fa9a902a6328fu;
    const uint64_t v = i * 0x91e10da5c79e7b1du;
    const float fu = (float)(u >> 40) * 0x1p-24f + su;
    const float fv = (float)(v >> 40) * 0x1p-24f + sv;
    return (Sample2){fu - floorf(fu), fv - floorf(fv)};
}

/* Point i of n of a Fibonacci lattice on the unit square: u stratified, v by the golden ratio.
 * Mapped onto a disc or cap by the area-preserving polar maps below it is a spiral with cells of
 * equal area and nearly equal shape. */
static inline Sample2 sample_fibonacci(uint64_t i, uint64_t n, float shift) {
    const uint64_t turn = i * 0x9e3779b97f4a7c15u; /* 2^64 / golden ratio */
    const float v = (float)(turn >> 40) * 0x1p-24f + shift;
    /* Among more than 2^24 points the last ones would round to 1. */
    const float u = fminf((float)(((double)i + 0.5) / (double)n), 0x1.fffffep-1f);
    return (Sample2){u, v - floorf(v)};
}

/* A third coordinate of that point, in [0, 1): those below any value are nearly as even a set as
 * all of them (their number in a disc varies by a sixth of what it would by chance). */
static inline float sample_fibonacci_rank(uint64_t i, float shift) {
    const uint64_t u = i * 0x6a09e667f3bcc908u; /* sqrt(2) - 1 in 0.64 fixed point */
    const float fu = (float)(u >> 40) * 0x1p-24f + shift;
    return fu - floorf(fu);
}

/* Unit disc; pdf = 1/pi per unit area. */
static inline Sample2 sample_disc(Sample2 s) {
    const float r = sqrtf(s.u), phi = 2.0f * AMB_PI * s.v;
    return (Sample2){r * cosf(phi), r * sinf(phi)};
}

/* Unit disc; pdf = 2/pi (1 - r^2) per unit area. */
static inline Sample2 sample_dome(Sample2 s) {
    return sample_disc((Sample2){1.0f - sqrtf(1.0f - s.u), s.v});
}

/* Cap of directions around +z whose 1 - cos(half-angle) is given, in (0, 2]; pdf = 1 / (2 pi
 * one_minus_cos) per steradian. 1 - cos keeps its digits for thin caps. */
static inline Vec3 sample_cap(Sample2 s, float one_minus_cos) {
    const float h = one_minus_cos * s.u; /* 1 - cos theta */
    const float sin_theta = safe_sqrtf(h * (2.0f - h));
    const float phi = 2.0f * AMB_PI * s.v;
    return vec3(sin_theta * cosf(phi), sin_theta * sinf(phi), 1.0f - h);
}

/* Cosine-weighted hemisphere around +z; pdf = cos / pi per steradian. */
static inline Vec3 sample_cosine_hemisphere(Sample2 s) {
    const Sample2 d = sample_disc(s);
    return vec3(d.u, d.v, safe_sqrtf(1.0f - d.u * d.u - d.v * d.v));
}

/* v given in the frame (x, y, z). */
static inline Vec3 frame_to_world(Vec3 x, Vec3 y, Vec3 z, Vec3 v) {
    return vec3_madd(vec3_madd(vec3_scale(x, v.x), v.y, y), v.z, z);
}

#endif
