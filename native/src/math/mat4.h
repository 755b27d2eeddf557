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

/* Normal by the cofactors of the linear part: the inverse transpose up to a factor, defined for
 * any invertible m, and pointing outward again when m mirrors. Not normalised. */
static inline Vec3 mat4_normal(const float m[16], Vec3 n) {
    const Vec3 x = mat4_column(m, 0), y = mat4_column(m, 1), z = mat4_column(m, 2);
    const Vec3 yz = vec3_cross(y, z), zx = vec3_cross(z, x), xy = vec3_cross(x, y);
    const float sign = copysignf(1.0f, vec3_dot(x, yz));
    return vec3_scale(vec3_madd(vec3_madd(vec3_scale(yz, n.x), n.y, zx), n.z, xy), sign);
}

static inline float mat4_determinant(const float m[16]) {
    return vec3_dot(mat4_column(m, 0), vec3_cross(mat4_column(m, 1), mat4_column(m, 2)));
}

#endif
