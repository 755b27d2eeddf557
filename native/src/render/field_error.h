/* SPDX-License-Identifier: GPL-3.0-or-later
 * What fields of several levels, each four times as fine as the last, tell about their errors.
 *
 * Let e_k be the error of level k against the limit of infinitely many: an image, its length
 * |e_k|. From level to level it shrinks by a ratio r, and part of it stays what it was:
 *     |e_k| = r |e_k+1|,     e_j . e_k = c^|j-k| |e_j| |e_k|.
 * c = 0 is noise, each level's for itself; c = 1 is bias, the same picture smaller each time, as
 * Richardson's extrapolation supposes. The differences of three levels in a row determine both:
 *     |e_k - e_k+1|^2 = |e_k+1|^2 (1 + r^2 - 2 c r)
 *     |e_k-1 - e_k+1|^2 = |e_k+1|^2 (1 + r^4 - 2 c^2 r^2). */
#ifndef AMB_RENDER_FIELD_ERROR_H
#define AMB_RENDER_FIELD_ERROR_H

#include <stdint.h>

enum { FIELD_LEVEL_MAX = 16 };

typedef struct FieldConvergence {
    double ratio, correlation; /* r, c */
} FieldConvergence;

/* What is known of an estimator before its levels are measured, or if they show nothing. */
typedef struct FieldPrior {
    FieldConvergence usual;
    double ratio_min, ratio_max, correlation_max; /* beyond, a measured value is chance */
} FieldPrior;

/* Squared differences of pairs of levels, mean over pixels and channels. */
typedef struct FieldDifferences {
    uint32_t level_count;
    double squares[FIELD_LEVEL_MAX][FIELD_LEVEL_MAX]; /* symmetric */
} FieldDifferences;

/* r and c from levels top - 2 .. top. */
FieldConvergence field_convergence(const FieldDifferences *differences, uint32_t top,
                                   const FieldPrior *prior);

/* Squared error of a level, of at least two. */
double field_error_square(const FieldDifferences *differences, uint32_t level,
                          const FieldPrior *prior);

#endif
