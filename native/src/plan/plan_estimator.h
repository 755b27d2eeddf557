/* SPDX-License-Identifier: GPL-3.0-or-later
 * Which estimator renders the light that scatters once. */
#ifndef AMB_PLAN_PLAN_ESTIMATOR_H
#define AMB_PLAN_PLAN_ESTIMATOR_H

#include "plan/plan.h"

/* Resolves AUTO, and refuses what was asked for by name and cannot be. The plan's effects must be
 * settled. */
AmbStatus plan_estimator(const AmbScene *scene, const AmbRenderParams *params,
                         const MeshProblems *problems, Plan *plan);

#endif
