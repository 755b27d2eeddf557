/* SPDX-License-Identifier: GPL-3.0-or-later
 * The square root of the covariance of the local light field: tangent pairs along a light ray.
 *
 * A pair (dp, dd) is the derivative of the ray's origin [m] and direction [rad] with respect to
 * one sampling parameter (Igehy 1999, ray differentials). With all pairs as the columns of a
 * 4 x k array J in the frame of optics/covariance.h, C = J J^T is the covariance of the light
 * field that the ray stands for, and Sigma = C^-1 / (4 pi^2) that of its spectrum: positive
 * semidefinite by construction, and no case is singular. The operators need no frame
 * (docs/theory.md 3; checked against optics/covariance.c by
 * unit.tangent). */
#ifndef AMB_OPTICS_TANGENT_H
#define AMB_OPTICS_TANGENT_H

#include "math/vec3.h"

typedef struct TangentPair {
    Vec3 dp; /* of the origin, m per unit of parameter */
    Vec3 dd; /* of the unit direction, rad per unit of parameter */
} TangentPair;

/* Two pairs span the cell of the sampling lattice, two the extent of the source. Full extents:
 * a parameter runs over [-1/2, 1/2], so the variance of a uniform cell is the square / 12. */
enum { TANGENT_LATTICE = 2, TANGENT_COUNT = 4 };

/* Along unit direction d by distance s to a plane with unit normal n: afterwards dp lies in it. */
static inline TangentPair tangent_travel_to_surface(TangentPair pair, float s, Vec3 d, Vec3 n) {
    const Vec3 dp = vec3_madd(pair.dp, s, pair.dd);
    return (TangentPair){vec3_madd(dp, -vec3_dot(dp, n) / vec3_dot(d, n), d), pair.dd};
}

/* Refraction of a ray along d at unit normal n (incident side), dn = derivative of n along dp.
 * eta = n_i / n_t, cos_i, cos_t of the crossing, cos_t > 0. */
static inline TangentPair tangent_refract(TangentPair pair, Vec3 d, Vec3 n, Vec3 dn, float eta,
                                          float cos_i, float cos_t) {
    const float dcos = -(vec3_dot(pair.dd, n) + vec3_dot(d, dn));
    const float mu = eta * cos_i - cos_t;
    /* Snell's law has an infinite derivative at the critical angle. The bound keeps the footprint
     * finite there; it acts on less than 1e-6 of the flux (which vanishes with cos_t). */
    const float dmu = eta - eta * eta * cos_i / fmaxf(cos_t, 1e-3f);
    Vec3 dd = vec3_scale(pair.dd, eta);
    dd = vec3_madd(dd, mu, dn);
    dd = vec3_madd(dd, dmu * dcos, n);
    return (TangentPair){pair.dp, dd};
}

/* Mirror reflection, including total internal reflection. */
static inline TangentPair tangent_reflect(TangentPair pair, Vec3 d, Vec3 n, Vec3 dn, float cos_i) {
    const float dcos = -(vec3_dot(pair.dd, n) + vec3_dot(d, dn));
    const Vec3 change = vec3_madd(vec3_scale(n, dcos), cos_i, dn);
    return (TangentPair){pair.dp, vec3_madd(pair.dd, 2.0f, change)};
}

/* Squared cross-section of the ray's footprint as a polynomial in the distance s from its origin,
 *   a(s)^2 = det C(s) = sum over pairs k<l of (w . (p_k + s q_k) x (p_l + s q_l))^2   (m^4)
 * by the Cauchy-Binet formula for the 2 x k array of offsets perpendicular to the unit direction
 * w. For two pairs a(s) = |det J(s)|: the geometric spread of a tube, zero at a focus. */
typedef struct TangentSpread {
    float coefficients[5];
} TangentSpread;

static inline TangentSpread tangent_spread(const TangentPair pairs[TANGENT_COUNT], Vec3 w) {
    TangentSpread spread = {{0}};
    for (int k = 0; k < TANGENT_COUNT; ++k)
        for (int l = k + 1; l < TANGENT_COUNT; ++l) {
            const float a = vec3_dot(w, vec3_cross(pairs[k].dp, pairs[l].dp));
            const float b = vec3_dot(w, vec3_add(vec3_cross(pairs[k].dp, pairs[l].dd),
                                                 vec3_cross(pairs[k].dd, pairs[l].dp)));
            const float c = vec3_dot(w, vec3_cross(pairs[k].dd, pairs[l].dd));
            spread.coefficients[0] += a * a;
            spread.coefficients[1] += 2.0f * a * b;
            spread.coefficients[2] += b * b + 2.0f * a * c;
            spread.coefficients[3] += 2.0f * b * c;
            spread.coefficients[4] += c * c;
        }
    return spread;
}

/* Cross-section of the lattice's cell alone at distance s, m^2: how far apart neighbouring rays
 * are, whatever the size of the source. */
static inline float tangent_cell_area(const TangentPair pairs[TANGENT_LATTICE], Vec3 w, float s) {
    const Vec3 u = vec3_madd(pairs[0].dp, s, pairs[0].dd);
    const Vec3 v = vec3_madd(pairs[1].dp, s, pairs[1].dd);
    return fabsf(vec3_dot(w, vec3_cross(u, v)));
}

/* a(s) in m^2, >= 0. */
static inline float tangent_cross_section(const TangentSpread *spread, float s) {
    const float *c = spread->coefficients;
    return safe_sqrtf(c[0] + s * (c[1] + s * (c[2] + s * (c[3] + s * c[4]))));
}

#endif
