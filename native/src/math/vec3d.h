/* SPDX-License-Identifier: GPL-3.0-or-later
 * Three doubles, where differences of nearly equal places and directions are what counts. */
#ifndef AMB_MATH_VEC3D_H
#define AMB_MATH_VEC3D_H

#include "math/vec3.h"

typedef struct Vec3d {
    double x, y, z;
} Vec3d;

static inline Vec3d vec3d_from(Vec3 v) {
    return (Vec3d){(double)v.x, (double)v.y, (double)v.z};
}
static inline Vec3 vec3d_round(Vec3d v) {
    return (Vec3){(float)v.x, (float)v.y, (float)v.z};
}
static inline Vec3d vec3d_add(Vec3d a, Vec3d b) {
    return (Vec3d){a.x + b.x, a.y + b.y, a.z + b.z};
}
static inline Vec3d vec3d_sub(Vec3d a, Vec3d b) {
    return (Vec3d){a.x - b.x, a.y - b.y, a.z - b.z};
}
static inline Vec3d vec3d_scale(Vec3d a, double s) {
    return (Vec3d){a.x * s, a.y * s, a.z * s};
}
static inline Vec3d vec3d_negate(Vec3d a) {
    return (Vec3d){-a.x, -a.y, -a.z};
}
/* a + s b */
static inline Vec3d vec3d_madd(Vec3d a, double s, Vec3d b) {
    return (Vec3d){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}
static inline double vec3d_dot(Vec3d a, Vec3d b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
static inline Vec3d vec3d_cross(Vec3d a, Vec3d b) {
    return (Vec3d){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
static inline double vec3d_length(Vec3d a) {
    return sqrt(vec3d_dot(a, a));
}

/* Twice the area of a triangle, along its normal. Rounded to floats, the edges of a sliver from a
 * corner far away may be one and the same. */
static inline Vec3d vec3d_area(Vec3 a, Vec3 b, Vec3 c) {
    const Vec3d from = vec3d_from(a);
    return vec3d_cross(vec3d_sub(vec3d_from(b), from), vec3d_sub(vec3d_from(c), from));
}

#endif
