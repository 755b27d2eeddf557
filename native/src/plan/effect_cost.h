/* SPDX-License-Identifier: GPL-3.0-or-later
 * What a choice of effects costs a camera sample, by what probes did. */
#ifndef AMB_PLAN_EFFECT_COST_H
#define AMB_PLAN_EFFECT_COST_H

#include "plan/light_probe.h"
#include "plan/plan.h"

/* Numbers of things that one camera sample does with everything on: means over the pixels that show
 * an object, or sums of probes on the way to these. */
typedef struct EffectWork {
    double stretches[CAMERA_STEP_COUNT]; /* of the path in media that scatter, by bounce_step of the
                                          * reflections before */
    double arrivals[CAMERA_STEP_COUNT];  /* ends of the path on surroundings, likewise */
    double mirrored, behind; /* either of them, after a reflection outside, or through an object */
    double second, later;    /* stretches of walks after one scattering, after more */
    double escapes;          /* looks of walks at surroundings */
} EffectWork;

void effect_work_add(EffectWork *sum, double weight, const EffectWork *work);

typedef struct EffectChoice {
    bool is_on[PLAN_EFFECT_COUNT];
    uint32_t camera_step, light_step; /* of BOUNCE_STEPS */
} EffectChoice;

/* In units of a gather of light that comes straight from a lamp. */
double effect_cost(const EffectWork *work, const EffectChoice *choice);

#endif
