/* SPDX-License-Identifier: GPL-3.0-or-later
 * Vectors in space, several side by side. */
#ifndef AMB_MATH_LANES3_H
#define AMB_MATH_LANES3_H

#include "math/lanes.h"
#include "math/vec3.h"

typedef struct Lanes3 {
    Lanes x, y, z;
} Lanes3;

static inline Lanes3 set3(Vec3 v) {
    return (Lanes3){lanes_set(v.x), lanes_set(v.y), lanes_set(v.z)};
}

static inline Lanes3 sub3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline Lanes3 scale3(Lanes3 a, Lanes s) {
    return (Lanes3){a.x * s, a.y * s, a.z * s};
}

static inline Lanes3 add3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.x + b.x, a.y + b.y, a.z + b.z};
}

static inline Lanes3 lerp3(Lanes3 a, Lanes3 b, Lanes q) {
    return (Lanes3){a.x + q * (b.x - a.x), a.y + q * (b.y - a.y), a.z + q * (b.z - a.z)};
}

static inline Lanes dot3(Lanes3 a, Lanes3 b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline Lanes3 cross3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

/* Not a number for the zero vector. */
static inline Lanes3 normalize3(Lanes3 a) {
    return scale3(a, 1.0f / lanes_sqrt(dot3(a, a)));
}

#endif
