/* SPDX-License-Identifier: GPL-3.0-or-later
 * What a choice of effects costs a camera sample. */
#include "plan/effect_cost.h"

/* By reports of the planner's scenes, in units of a gather of light straight from a lamp: a stretch
 * of a path or a walk with what is met at its end; */
static const double RAY = 0.2;
/* what light that was reflected inside adds to each gather, 1.4 to 5 where it is reflected once,
 * and more for each further reflection; and light that has come through other objects. */
static const double FIRST_REFLECTION = 2.0, NEXT_REFLECTION = 0.25, PASSED = 1.0;

void effect_work_add(EffectWork *sum, double weight, const EffectWork *work) {
    for (uint32_t i = 0; i < CAMERA_STEP_COUNT; ++i) {
        sum->stretches[i] += weight * work->stretches[i];
        sum->arrivals[i] += weight * work->arrivals[i];
    }
    sum->mirrored += weight * work->mirrored;
    sum->behind += weight * work->behind;
    sum->second += weight * work->second;
    sum->later += weight * work->later;
    sum->escapes += weight * work->escapes;
}

static double gather_cost(const EffectChoice *choice) {
    double cost = 1.0;
    if (choice->light_step > 0)
        cost += FIRST_REFLECTION + NEXT_REFLECTION * (BOUNCE_STEPS[choice->light_step] - 1);
    return choice->is_on[PLAN_TRANSMITTED_LIGHT] ? cost + PASSED : cost;
}

double effect_cost(const EffectWork *work, const EffectChoice *choice) {
    const bool *is_on = choice->is_on;
    const double gather = gather_cost(choice);
    /* The primary ray, and the boundary that it meets. */
    double cost = 2.0 * RAY;
    for (uint32_t i = 0; i <= choice->camera_step; ++i) {
        cost += is_on[PLAN_SINGLE_SCATTERING] ? gather * work->stretches[i] : 0.0;
        cost += i > 0 ? RAY * (work->stretches[i] + work->arrivals[i]) : 0.0;
    }
    cost += is_on[PLAN_SURFACE_REFLECTION] ? RAY * work->mirrored : 0.0;
    cost += is_on[PLAN_BACKGROUND] ? RAY * work->behind : 0.0;
    /* A walk of more scatterings has been through those before. */
    const bool goes_on = is_on[PLAN_MULTIPLE_SCATTERING];
    if (is_on[PLAN_DOUBLE_SCATTERING] || is_on[PLAN_WORLD_LIGHT] || goes_on)
        cost += RAY * work->second;
    cost += is_on[PLAN_DOUBLE_SCATTERING] ? gather * work->second : 0.0;
    cost += goes_on ? (gather + RAY) * work->later : 0.0;
    return cost + (is_on[PLAN_WORLD_LIGHT] ? RAY * work->escapes : 0.0);
}
