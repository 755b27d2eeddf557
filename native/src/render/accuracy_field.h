/* SPDX-License-Identifier: GPL-3.0-or-later
 * How fine a light field a target takes: fields of several levels are compared along the same
 * camera rays (field_error.h), from coarse to fine, tubes and points each on their own. */
#ifndef AMB_RENDER_ACCURACY_FIELD_H
#define AMB_RENDER_ACCURACY_FIELD_H

#include "field/field.h"

struct AmbRender;

/* Builds the coarsest field whose error leaves room for noise, within bounds of memory, and makes
 * the plan that of it. */
AmbStatus accuracy_choose_field(struct AmbRender *render, Field **out_field);

#endif
