/* SPDX-License-Identifier: GPL-3.0-or-later
 * A smooth boundary between two dielectrics: Snell's law and unpolarised Fresnel reflectance. */
#ifndef AMB_OPTICS_DIELECTRIC_H
#define AMB_OPTICS_DIELECTRIC_H

#include "math/vec3.h"

typedef struct DielectricSplit {
    float cos_i, cos_t; /* cosines to the normal, >= 0; cos_t = 0 at total internal reflection */
    float reflectance;  /* F in [0,1]; transmittance of power is 1 - F */
    Vec3 reflected;     /* unit directions of travel */
    Vec3 refracted;     /* valid where reflectance < 1 */
} DielectricSplit;

/* Splits light travelling along unit d at a boundary with unit normal n on the incident side
 * (d.n < 0). eta = n_incident / n_transmitted > 0. Exact at eta = 1: F = 0, refracted = d.
 * Pure; any thread. */
static inline DielectricSplit dielectric_split(Vec3 d, Vec3 n, float eta) {
    DielectricSplit s;
    const float c = fminf(-vec3_dot(d, n), 1.0f);
    s.cos_i = c;
    s.reflected = vec3_madd(d, 2.0f * c, n);
    if (eta == 1.0f) {
        s.cos_t = c;
        s.reflectance = 0.0f;
        s.refracted = d;
        return s;
    }
    /* 1 - eta^2 (1 - c^2), which would lose a grazing cosine to rounding where eta is near 1, as
     * the other sum loses one along the normal where eta is large. */
    const float eta2 = eta * eta, c2 = c * c;
    const float cos2_t = c2 > 0.5f ? 1.0f - eta2 * ((1.0f - c) * (1.0f + c))
                                   : (1.0f - eta) * (1.0f + eta) + eta2 * c2;
    if (!(cos2_t > 0.0f)) {
        s.cos_t = 0.0f;
        s.reflectance = 1.0f;
        s.refracted = s.reflected;
        return s;
    }
    s.cos_t = sqrtf(cos2_t);
    const float parallel = (c - eta * s.cos_t) / (c + eta * s.cos_t);
    const float perpendicular = (eta * c - s.cos_t) / (eta * c + s.cos_t);
    s.reflectance = 0.5f * (parallel * parallel + perpendicular * perpendicular);
    s.refracted = vec3_normalize(vec3_madd(vec3_scale(d, eta), eta * c - s.cos_t, n));
    return s;
}

#endif
