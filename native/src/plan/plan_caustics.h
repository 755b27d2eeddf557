/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that comes to opaque surfaces by way of translucent objects. */
#ifndef AMB_PLAN_PLAN_CAUSTICS_H
#define AMB_PLAN_PLAN_CAUSTICS_H

#include "plan/plan.h"

/* What switches allow and the scene's description does not rule out. */
PlanEffect plan_light_on_surfaces(const AmbScene *scene, const AmbRenderParams *params);
PlanEffect plan_caustics(const AmbScene *scene, const AmbRenderParams *params, const Plan *plan);

/* Asks probe rays whether caustics are worth it, and by how many reflections, and sets their
 * parameters. */
AmbStatus plan_measure_caustics(const AmbScene *scene, const AmbRenderParams *params, Job *job,
                                Plan *plan);

/* Whether light that scatters on its way to opaque surfaces is a part of the map of caustics; after
 * everything else that the map, later orders and the camera need to know. */
void plan_glow(const AmbScene *scene, const AmbRenderParams *params, Plan *plan);

#endif
