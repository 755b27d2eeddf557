/* SPDX-License-Identifier: GPL-3.0-or-later
 * Phase functions as sums of a few Legendre polynomials that are nowhere negative, and of light
 * that goes straight on.
 *
 *   p(x) = f delta(x = 1) + 1/(4 pi) sum over l <= degree of (2 l + 1) c_l P_l(x)
 *
 * Of a lobe of mean cosine g the true coefficients are g^l. Cut off at a degree such a sum has
 * ripples, which from g = 0.57 at degree 4 and from 0.67 at degree 8 on go below zero: pictures of
 * few photons would have negative radiance. Light that goes straight on has coefficients f of all
 * degrees, so that c_l = g^l - f leaves those up to the last one exact (delta-M, [Wiscombe77],
 * where f = g^(degree + 1)); f, near that, is such that the sum is highest where it is lowest, 0.05
 * at g = 0.7, 0.41 at 0.9 and 0.5 at the most. Beyond 0.905 that is below zero: then lobes are as
 * much of the sum as is nowhere negative, and the rest a kernel that is a square. A product of
 * positive kernels' coefficients is that of a positive kernel (they convolve), so a^l J_l is one, J
 * the polynomial that has the largest mean cosine of all that are nowhere negative: the square of
 * P_(n+1)(x) / (x
 * - z), z the largest zero of P_(n+1), n half the degree, and J_1 = z. Flux and mean cosine stay
 * exact as far as lobe_keeps_mean says. Lobes that scatter backwards have the kernel alone and no
 * f. */
#ifndef AMB_FIELD_SCATTER_LOBE_H
#define AMB_FIELD_SCATTER_LOBE_H

#include <stdbool.h>
#include <stdint.h>

/* Even, at most HARMONIC_DEGREE_MAX. */
uint32_t lobe_degree(float g);

/* c_0 .. c_degree of a lobe of mean cosine g; returns f. */
float lobe_coefficients(float g, uint32_t degree, float *out);

/* Whether they have the lobe's mean cosine: from -0.88 to 0.94, not beyond, where the sharpest
 * positive sum of these degrees is less sharp than the lobe. */
bool lobe_keeps_mean(float g);

#endif
