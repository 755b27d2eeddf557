/* SPDX-License-Identifier: GPL-3.0-or-later
 * Phase functions as sums of a few Legendre polynomials that are nowhere negative.
 *
 *   p(x) = 1/(4 pi) sum over l <= degree of (2 l + 1) c_l P_l(x)
 *
 * Of a lobe of mean cosine g the true c_l are g^l. Cut off at a degree such a sum has ripples,
 * which from g = 0.57 at degree 4 and from 0.67 at degree 8 on go below zero: pictures of few
 * photons would have negative radiance. A product of positive kernels' coefficients is that of a
 * positive kernel (they convolve), so a^l J_l,   a = g / J_1, is one of the same mean cosine, with
 * J the polynomial that has the largest mean cosine of all that are nowhere negative: the square of
 * P_(n+1)(x) / (x - z), z the largest zero of P_(n+1), n half the degree, and J_1 = z. Lobes are as
 * much of the first as is nowhere negative, and the rest of the second. Flux and mean cosine are
 * exact; what is lost are parts of higher moments, none below g = 0.67. Lobes beyond g = J_1 =
 * 0.906 have that mean cosine. */
#ifndef AMB_FIELD_SCATTER_LOBE_H
#define AMB_FIELD_SCATTER_LOBE_H

#include <stdint.h>

/* Even, at most HARMONIC_DEGREE_MAX. */
uint32_t lobe_degree(float g);

/* c_0 .. c_degree of a lobe of mean cosine g. */
void lobe_coefficients(float g, uint32_t degree, float *out);

#endif
