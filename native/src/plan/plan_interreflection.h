/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that opaque surfaces send one another. */
#ifndef AMB_PLAN_PLAN_INTERREFLECTION_H
#define AMB_PLAN_PLAN_INTERREFLECTION_H

#include "plan/plan.h"

/* What switches allow and the scene's description does not rule out. */
PlanEffect plan_interreflection(const AmbScene *scene, const AmbRenderParams *params);

/* Asks camera paths for its share of the picture. Where shares decide, what is too small to show is
 * left out. */
AmbStatus plan_measure_interreflection(const AmbScene *scene, const AmbRenderParams *params,
                                       const PlanCrop *crop, Job *job, Plan *plan);

#endif
