/* SPDX-License-Identifier: GPL-3.0-or-later
 * Real spherical harmonics, orthonormal: int Y_lm Y_l'm' = 1 where both indices agree, else 0, so
 * that P_l(a . b) = 4 pi / (2 l + 1) sum over m of Y_lm(a) Y_lm(b). */
#ifndef AMB_MATH_HARMONICS_H
#define AMB_MATH_HARMONICS_H

#include <stdint.h>

#include "math/sampling.h"

enum { HARMONIC_DEGREE_MAX = 8, HARMONIC_COUNT_MAX = 81 };

/* Factors of the recurrences up to a degree; const once made. */
typedef struct Harmonics {
    uint32_t degree;
    float diagonal[HARMONIC_DEGREE_MAX + 1]; /* of Y_mm, sqrt 2 for m > 0 in it */
    float along[HARMONIC_DEGREE_MAX + 1][HARMONIC_DEGREE_MAX + 1]; /* [l][m]: of z P_(l-1)m */
    float back[HARMONIC_DEGREE_MAX + 1][HARMONIC_DEGREE_MAX + 1];  /* [l][m]: of P_(l-2)m */
} Harmonics;

static inline uint32_t harmonic_count(uint32_t degree) {
    return (degree + 1) * (degree + 1);
}

static inline Harmonics harmonics_create(uint32_t degree) {
    Harmonics h = {.degree = degree};
    float diagonal = sqrtf(0.25f / AMB_PI);
    for (uint32_t m = 0; m <= degree; ++m) {
        const float fm = (float)m;
        if (m > 0)
            diagonal *= sqrtf((2.0f * fm + 1.0f) / (2.0f * fm));
        h.diagonal[m] = m > 0 ? sqrtf(2.0f) * diagonal : diagonal;
        for (uint32_t l = m + 1; l <= degree; ++l) {
            const float fl = (float)l;
            h.along[l][m] = sqrtf((4.0f * fl * fl - 1.0f) / (fl * fl - fm * fm));
            const float below = fl - 1.0f;
            h.back[l][m] =
                h.along[l][m] * sqrtf((below * below - fm * fm) / (4.0f * below * below - 1.0f));
        }
    }
    return h;
}

/* Y_lm(d) at out[l (l + 1) + m], harmonic_count(degree) values; d unit. Pure. */
static inline void harmonics_evaluate(const Harmonics *h, Vec3 d, float *out) {
    /* Re and Im of (x + i y)^m. */
    float re = 1.0f, im = 0.0f;
    for (uint32_t m = 0; m <= h->degree; ++m) {
        float below = 0.0f, p = h->diagonal[m];
        for (uint32_t l = m; l <= h->degree; ++l) {
            if (l > m) {
                const float next = h->along[l][m] * d.z * p - h->back[l][m] * below;
                below = p;
                p = next;
            }
            const uint32_t middle = l * (l + 1);
            out[middle + m] = p * re;
            if (m > 0)
                out[middle - m] = p * im;
        }
        const float turned = re * d.x - im * d.y;
        im = re * d.y + im * d.x;
        re = turned;
    }
}

#endif
