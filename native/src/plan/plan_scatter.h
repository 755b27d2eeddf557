/* SPDX-License-Identifier: GPL-3.0-or-later
 * Who simulates light of later orders: walks from the camera or photons from the lamps. */
#ifndef AMB_PLAN_PLAN_SCATTER_H
#define AMB_PLAN_PLAN_SCATTER_H

#include "plan/plan.h"

/* Resolves AUTO and sets what photons need; the effects and the light pass are planned. */
void plan_scatter(const AmbScene *scene, const AmbRenderParams *params, Plan *plan);

/* The most photons that a render to a target takes. */
uint64_t plan_photons_most(const AmbRenderParams *params);

/* Scatterings after which no light is wanted; 0: no limit. */
uint32_t plan_last_order(const AmbRenderParams *params, const Plan *plan);

#endif
