/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons on opaque surfaces add to a picture's error, and how many are enough. */
#ifndef AMB_RENDER_ACCURACY_CAUSTICS_H
#define AMB_RENDER_ACCURACY_CAUSTICS_H

#include "field/caustics/caustics.h"
#include "field/field.h"

struct AmbRender;

/* Rays for caustics under a target: as many as the coarsest map has. */
void accuracy_plan_caustics(struct AmbRender *render);

/* Under a target, after the light field and photons of later orders: finer maps take the place of
 * *map until their error leaves room for noise, within the limit of memory. */
AmbStatus accuracy_refine_caustics(struct AmbRender *render, const Field *field, CausticMap **map);

#endif
