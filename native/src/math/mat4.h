/* SPDX-License-Identifier: GPL-3.0-or-later
 * Affine 4x4 matrices, row-major, applied to column vectors. */
#ifndef AMB_MATH_MAT4_H
#define AMB_MATH_MAT4_H

#include "math/vec3d.h"

static inline Vec3d mat4_point(const float m[16], Vec3 p) {
    const Vec3d q = vec3d_from(p);
    const double row[3] = {(double)m[0] * q.x + (double)m[1] * q.y + (double)m[2] * q.z,
                           (double)m[4] * q.x + (double)m[5] * q.y + (double)m[6] * q.z,
                           (double)m[8] * q.x + (double)m[9] * q.y + (double)m[10] * q.z};
    return (Vec3d){row[0] + (double)m[3], row[1] + (double)m[7], row[2] + (double)m[11]};
}

static inline Vec3 mat4_column(const float m[16], int column) {
    return vec3(m[column], m[4 + column], m[8 + column]);
}

/* In doubles, as below: products of scales of 1e20 or 1e-20 are numbers. */
static inline Vec3d mat4_column_d(const float m[16], int column) {
    return vec3d_from(mat4_column(m, column));
}

/* Unit, of a matrix that is invertible. */
static inline Vec3 mat4_axis(const float m[16], int column) {
    const Vec3d axis = mat4_column_d(m, column);
    return vec3d_round(vec3d_scale(axis, 1.0 / vec3d_length(axis)));
}

static inline double mat4_determinant(const float m[16]) {
    return vec3d_dot(mat4_column_d(m, 0), vec3d_cross(mat4_column_d(m, 1), mat4_column_d(m, 2)));
}

/* Unit normal by the cofactors of the linear part: the inverse transpose up to a factor, defined
 * for any invertible m, and pointing outward again when m mirrors. Zero where n is no direction. */
static inline Vec3 mat4_normal(const float m[16], Vec3 n) {
    const Vec3d x = mat4_column_d(m, 0), y = mat4_column_d(m, 1), z = mat4_column_d(m, 2);
    const Vec3d yz = vec3d_cross(y, z), zx = vec3d_cross(z, x), xy = vec3d_cross(x, y);
    const Vec3d sum =
        vec3d_madd(vec3d_madd(vec3d_scale(yz, (double)n.x), (double)n.y, zx), (double)n.z, xy);
    const double length = vec3d_length(sum);
    if (!isfinite(length) || length == 0.0)
        return vec3(0, 0, 0);
    return vec3d_round(vec3d_scale(sum, copysign(1.0, vec3d_dot(x, yz)) / length));
}

#endif
