/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons in cells add to a picture's error, and how many of them a target takes.
 *
 * All pixels share the photons, so no pixel's samples see their noise, nor what cells blur. Photons
 * a quarter as many with other random numbers make another picture along the same camera rays; both
 * parts of the error fall with n^(-1/3) (theory.md 16). */
#ifndef AMB_RENDER_ACCURACY_SCATTER_H
#define AMB_RENDER_ACCURACY_SCATTER_H

#include "field/scatter/scatter.h"

struct AmbRender;

/* After the light field: measures *scatter's error, and replaces it by ones of as many photons as
 * the law says until it leaves room for noise, within bounds of memory. Nothing without photons. */
AmbStatus accuracy_refine_scatter(struct AmbRender *render, const Field *field, Scatter **scatter);

/* Before photons of a fixed number of samples are traced: more of them where a few tell that they
 * would leave blotches beside the samples' noise. AUTO alone. */
AmbStatus accuracy_fit_scatter(struct AmbRender *render);

#endif
