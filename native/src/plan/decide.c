/* SPDX-License-Identifier: GPL-3.0-or-later
 * From shares to decisions. */
#include "plan/decide.h"

#include "plan/scene_rules.h"

typedef struct Candidate {
    uint32_t effect; /* PLAN_* */
    uint32_t share;  /* SHARE_*; of a counted effect that of its first step */
    bool is_counted;
} Candidate;

static const Candidate CANDIDATES[] = {
    {PLAN_SINGLE_SCATTERING, SHARE_SINGLE, false},
    {PLAN_LIGHT_BOUNCES, SHARE_LIGHT_BOUNCES, true},
    {PLAN_CAMERA_BOUNCES, SHARE_CAMERA_BOUNCES, true},
    {PLAN_SURFACE_REFLECTION, SHARE_SURFACE_REFLECTION, false},
    {PLAN_BACKGROUND, SHARE_BACKGROUND, false},
    {PLAN_TRANSMITTED_LIGHT, SHARE_TRANSMITTED, false},
    {PLAN_WORLD_LIGHT, SHARE_WORLD_LIGHT, false},
    {PLAN_DOUBLE_SCATTERING, SHARE_DOUBLE, false},
    {PLAN_MULTIPLE_SCATTERING, SHARE_MULTIPLE, false},
};
enum { CANDIDATE_COUNT = sizeof CANDIDATES / sizeof CANDIDATES[0] };

static const double DEFAULT_ACCURACY = 0.01;
/* Noise and light field have the rest of 0.85 of the target, which is what a render aims at:
 * sqrt(0.85^2 - 0.6^2) = 0.6 at worst. */
static const double SHARE_PART = 0.5, OMITTED_PART = 0.6;
/* A share that the probes could not tell from the least one is taken as less where its estimate is
 * below this part of it: in the middle between half and the whole. */
static const double UNDECIDED_PART = 0.75;
/* Objects whose light is not traced have together at most this part of the least share. */
static const double DARK_OBJECTS_PART = 0.25;

double decide_share_min(double accuracy) {
    return SHARE_PART * (accuracy > 0.0 ? accuracy : DEFAULT_ACCURACY);
}

double decide_omitted_max(double accuracy) {
    return OMITTED_PART * (accuracy > 0.0 ? accuracy : DEFAULT_ACCURACY);
}

static bool is_less(const Share *share, double share_min) {
    return share->high <= share_min || share->value <= UNDECIDED_PART * share_min;
}

/* Less than the least, or more than half of it, or in between and known well enough. */
static bool is_clear(const Share *share, double share_min) {
    return !share->is_known || share->high <= share_min || share->low >= 0.5 * share_min ||
           share->high - share->low <= 0.5 * share_min;
}

bool decide_is_settled(const EffectShares *shares, const Plan *plan) {
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        const Candidate *candidate = &CANDIDATES[c];
        const uint32_t count = candidate->is_counted ? BOUNCE_STEP_COUNT - 1 : 1;
        for (uint32_t i = 0; i < count && plan->effects[candidate->effect].is_simulated; ++i) {
            const Share share = effect_share(shares, candidate->share + i);
            if (!is_clear(&share, plan->share_min))
                return false;
        }
    }
    return true;
}

void decide_describe(const EffectShares *shares, Plan *plan) {
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        const Candidate *candidate = &CANDIDATES[c];
        PlanEffect *effect = &plan->effects[candidate->effect];
        effect->share = effect_share(shares, candidate->share);
        for (uint32_t o = 0; o < plan->object_count; ++o)
            plan->objects[(uint64_t)o * PLAN_EFFECT_COUNT + candidate->effect].share =
                effect_share_of(shares, o, candidate->share);
    }
    plan->probe_count = shares->probe_count;
}

/* Reflections beyond a step; beyond the last one nothing is known. */
static Share beyond(const EffectShares *shares, const Candidate *candidate, uint32_t step) {
    if (step + 1 < BOUNCE_STEP_COUNT)
        return effect_share(shares, candidate->share + step);
    return (Share){.is_known = true};
}

static void skip(PlanEffect *effect) {
    effect->is_simulated = false;
    effect->reason = "too small to show";
    effect->count = 0;
}

/* Settles one effect by itself; step of a counted one. */
static uint32_t settle(const EffectShares *shares, const Candidate *candidate, double share_min,
                       PlanEffect *effect) {
    uint32_t step = 0;
    if (candidate->is_counted) {
        while (step + 1 < BOUNCE_STEP_COUNT) {
            const Share rest = beyond(shares, candidate, step);
            if (is_less(&rest, share_min))
                break;
            ++step;
        }
        effect->count = BOUNCE_STEPS[step];
        effect->rest = beyond(shares, candidate, step);
    } else if (is_less(&effect->share, share_min)) {
        effect->rest = effect->share;
    } else {
        effect->rest = (Share){.is_known = true};
        step = 1;
    }
    if (step == 0)
        skip(effect);
    else
        effect->reason = "large enough to show";
    return step;
}

/* One step more of the effect of which most is left out. */
static bool take_back(const EffectShares *shares, const bool *is_open, uint32_t *steps,
                      Plan *plan) {
    uint32_t worst = CANDIDATE_COUNT;
    double most = 0.0;
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        const Share *rest = &plan->effects[CANDIDATES[c].effect].rest;
        if (is_open[c] && rest->value > most) {
            most = rest->value;
            worst = c;
        }
    }
    if (worst == CANDIDATE_COUNT)
        return false;
    PlanEffect *effect = &plan->effects[CANDIDATES[worst].effect];
    ++steps[worst];
    effect->is_simulated = true;
    effect->reason = "what is left out would be too much together";
    effect->rest = (Share){.is_known = true};
    if (CANDIDATES[worst].is_counted) {
        effect->count = BOUNCE_STEPS[steps[worst]];
        effect->rest = beyond(shares, &CANDIDATES[worst], steps[worst]);
    }
    return true;
}

static double rest_of(const bool *is_open, const Plan *plan, uint32_t effect) {
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c)
        if (CANDIDATES[c].effect == effect && is_open[c])
            return plan->effects[effect].rest.value;
    return 0.0;
}

/* Light of the surroundings, of reflections and through objects is also part of the orders that it
 * scatters in: as much of it as goes with these, about, is not counted again. */
static double sum_omitted(const bool *is_open, const Plan *plan) {
    static const uint32_t orders[] = {PLAN_SINGLE_SCATTERING, PLAN_DOUBLE_SCATTERING,
                                      PLAN_MULTIPLE_SCATTERING};
    double all = 0.0, omitted = 0.0;
    for (uint32_t i = 0; i < sizeof orders / sizeof orders[0]; ++i) {
        all += plan->effects[orders[i]].share.value;
        omitted += rest_of(is_open, plan, orders[i]);
    }
    const double kinds = rest_of(is_open, plan, PLAN_WORLD_LIGHT) +
                         rest_of(is_open, plan, PLAN_LIGHT_BOUNCES) +
                         rest_of(is_open, plan, PLAN_TRANSMITTED_LIGHT);
    const double kept = all > 0.0 ? fmax(1.0 - omitted / all, 0.0) : 0.0;
    return omitted + kept * kinds + rest_of(is_open, plan, PLAN_CAMERA_BOUNCES) +
           rest_of(is_open, plan, PLAN_SURFACE_REFLECTION) +
           rest_of(is_open, plan, PLAN_BACKGROUND);
}

/* Whether an object stands alone: light enters nothing else by way of it. */
static bool stands_alone(const AmbScene *scene, uint32_t object) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (o != object && scene->objects[o].is_boundary &&
            scene_may_touch(&scene->objects[o], &scene->objects[object]))
            return false;
    return true;
}

/* Objects that scatter too little light into the picture for rays of their own, the least first. */
static void choose_targets(const AmbScene *scene, double limit, Plan *plan) {
    double sum = 0.0;
    bool *targets = plan->targets;
    for (;;) {
        uint32_t least = UINT32_MAX;
        double share = 0.0;
        for (uint32_t o = 0; o < plan->object_count; ++o) {
            const Share *single =
                &plan->objects[(uint64_t)o * PLAN_EFFECT_COUNT + PLAN_SINGLE_SCATTERING].share;
            if (targets[o] && scene->objects[o].is_boundary &&
                (least == UINT32_MAX || single->value < share) && stands_alone(scene, o)) {
                least = o;
                share = single->value;
            }
        }
        if (least == UINT32_MAX || sum + share > limit)
            break;
        targets[least] = false;
        sum += share;
    }
    plan->omitted += sum;
}

void decide(const AmbScene *scene, const EffectShares *shares, double omitted_max, Plan *plan) {
    bool is_open[CANDIDATE_COUNT] = {false};
    uint32_t steps[CANDIDATE_COUNT] = {0};
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        PlanEffect *effect = &plan->effects[CANDIDATES[c].effect];
        is_open[c] = effect->is_simulated;
        if (is_open[c])
            steps[c] = settle(shares, &CANDIDATES[c], plan->share_min, effect);
    }
    while (sum_omitted(is_open, plan) > omitted_max && take_back(shares, is_open, steps, plan)) {
    }
    plan->omitted = sum_omitted(is_open, plan);
    if (plan->effects[PLAN_SINGLE_SCATTERING].is_simulated)
        choose_targets(scene, DARK_OBJECTS_PART * plan->share_min, plan);
}
