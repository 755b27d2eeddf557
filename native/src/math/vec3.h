/* SPDX-License-Identifier: GPL-3.0-or-later
 * Three floats: points, directions, and RGB. */
#ifndef AMB_MATH_VEC3_H
#define AMB_MATH_VEC3_H

#include <math.h>
#include <stdbool.h>

typedef struct Vec3 {
    float x, y, z;
} Vec3;

/* Scene-linear RGB. */
typedef struct Rgb {
    float r, g, b;
} Rgb;

static inline Vec3 vec3(float x, float y, float z) {
    return (Vec3){x, y, z};
}
static inline Vec3 vec3_from(const float v[3]) {
    return (Vec3){v[0], v[1], v[2]};
}
static inline Vec3 vec3_add(Vec3 a, Vec3 b) {
    return (Vec3){a.x + b.x, a.y + b.y, a.z + b.z};
}
static inline Vec3 vec3_sub(Vec3 a, Vec3 b) {
    return (Vec3){a.x - b.x, a.y - b.y, a.z - b.z};
}
static inline Vec3 vec3_scale(Vec3 a, float s) {
    return (Vec3){a.x * s, a.y * s, a.z * s};
}
static inline Vec3 vec3_negate(Vec3 a) {
    return (Vec3){-a.x, -a.y, -a.z};
}
/* a + s b */
static inline Vec3 vec3_madd(Vec3 a, float s, Vec3 b) {
    return (Vec3){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
static inline float vec3_dot(Vec3 a, Vec3 b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline Vec3 vec3_cross(Vec3 a, Vec3 b) {
    return (Vec3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline float vec3_length(Vec3 a) {
    return sqrtf(vec3_dot(a, a));
}
static inline Vec3 vec3_normalize(Vec3 a) {
    return vec3_scale(a, 1.0f / vec3_length(a));
}
static inline bool vec3_is_finite(Vec3 a) {
    return isfinite(a.x) && isfinite(a.y) && isfinite(a.z);
}
static inline bool vec3_is_equal(Vec3 a, Vec3 b) {
    return a.x == b.x && a.y == b.y && a.z == b.z;
}
static inline Vec3 vec3_min(Vec3 a, Vec3 b) {
    return (Vec3){fminf(a.x, b.x), fminf(a.y, b.y), fminf(a.z, b.z)};
}
static inline Vec3 vec3_max(Vec3 a, Vec3 b) {
    return (Vec3){fmaxf(a.x, b.x), fmaxf(a.y, b.y), fmaxf(a.z, b.z)};
}
static inline float vec3_max_component(Vec3 a) {
    return fmaxf(a.x, fmaxf(a.y, a.z));
}

/* Two unit vectors that complete unit n to a right-handed frame [Duff17]: no singular direction. */
static inline void vec3_frame(Vec3 n, Vec3 *out_x, Vec3 *out_y) {
    const float sign = copysignf(1.0f, n.z);
    const float a = -1.0f / (sign + n.z);
    const float b = n.x * n.y * a;
    *out_x = vec3(1.0f + sign * n.x * n.x * a, sign * b, -sign * n.x);
    *out_y = vec3(b, sign + n.y * n.y * a, -n.y);
}

static inline Rgb rgb(float r, float g, float b) {
    return (Rgb){r, g, b};
}
static inline Rgb rgb_from(const float v[3]) {
    return (Rgb){v[0], v[1], v[2]};
}
static inline Rgb rgb_add(Rgb a, Rgb b) {
    return (Rgb){a.r + b.r, a.g + b.g, a.b + b.b};
}
static inline Rgb rgb_mul(Rgb a, Rgb b) {
    return (Rgb){a.r * b.r, a.g * b.g, a.b * b.b};
}
static inline Rgb rgb_scale(Rgb a, float s) {
    return (Rgb){a.r * s, a.g * s, a.b * s};
}
static inline float rgb_max(Rgb a) {
    return fmaxf(a.r, fmaxf(a.g, a.b));
}
static inline float rgb_min(Rgb a) {
    return fminf(a.r, fminf(a.g, a.b));
}
static inline float rgb_mean(Rgb a) {
    return (a.r + a.g + a.b) / 3.0f;
}
static inline bool rgb_is_finite(Rgb a) {
    return isfinite(a.r) && isfinite(a.g) && isfinite(a.b);
}

static inline float safe_sqrtf(float x) {
    return x > 0.0f ? sqrtf(x) : 0.0f;
}
static inline float clampf(float x, float low, float high) {
    return fminf(fmaxf(x, low), high);
}

#endif
