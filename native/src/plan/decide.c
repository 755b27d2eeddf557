/* SPDX-License-Identifier: GPL-3.0-or-later
 * From shares to decisions. */
#include "plan/decide.h"

#include "plan/scene_rules.h"

typedef struct Candidate {
    uint32_t effect;    /* PLAN_* */
    uint32_t share;     /* SHARE_*; of a counted effect that of its first step */
    uint32_t last_step; /* of BOUNCE_STEPS; 1 of what is there or is not */
} Candidate;

static const Candidate CANDIDATES[] = {
    {PLAN_SINGLE_SCATTERING, SHARE_SINGLE, 1},
    {PLAN_LIGHT_BOUNCES, SHARE_LIGHT_BOUNCES, LIGHT_STEP_COUNT - 1},
    {PLAN_CAMERA_BOUNCES, SHARE_CAMERA_BOUNCES, CAMERA_STEP_COUNT - 1},
    {PLAN_SURFACE_REFLECTION, SHARE_SURFACE_REFLECTION, 1},
    {PLAN_BACKGROUND, SHARE_BACKGROUND, 1},
    {PLAN_TRANSMITTED_LIGHT, SHARE_TRANSMITTED, 1},
    {PLAN_WORLD_LIGHT, SHARE_WORLD_LIGHT, 1},
    {PLAN_DOUBLE_SCATTERING, SHARE_DOUBLE, 1},
    {PLAN_MULTIPLE_SCATTERING, SHARE_MULTIPLE, 1},
};
enum { CANDIDATE_COUNT = sizeof CANDIDATES / sizeof CANDIDATES[0] };

static const double DEFAULT_ACCURACY = 0.01;
/* Noise and light field have the rest of 0.85 of the target, which is what a render aims at:
 * sqrt(0.85^2 - 0.6^2) = 0.6 at worst. */
static const double SHARE_PART = 0.5, OMITTED_PART = 0.6;
/* Noise is c n^-3/4 of n samples (render/survey.c), so that n goes as the 2/3 power of 1 / square.
 */
static const double SAMPLES_ORDER = 2.0 / 3.0;
/* Of the target, what a render aims at (render/accuracy.h). */
static const double AIM_PART = 0.85;
/* A share that the probes could not tell from the least one is taken as less where its estimate is
 * below this part of it: in the middle between half and the whole. */
static const double UNDECIDED_PART = 0.75;
/* What may be left out for being dear, if its bounds are below: in units of the least share. */
static const double DEAR_MAX = 1.6;
/* What may be simulated for being cheap though it would not show, by its estimate in the same
 * units.
 */
static const double CHEAP_PART = 0.7;
/* Objects whose light is not traced have together at most this part of the least share. */
static const double DARK_OBJECTS_PART = 0.25;

double decide_share_min(double accuracy) {
    return SHARE_PART * (accuracy > 0.0 ? accuracy : DEFAULT_ACCURACY);
}

static double find_omitted_max(double accuracy) {
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
        const bool is_open = plan->effects[candidate->effect].is_simulated;
        for (uint32_t i = 0; i < candidate->last_step && is_open; ++i) {
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
    PlanEffect *returned = &plan->effects[PLAN_RETURN];
    returned->share = effect_share(shares, SHARE_RETURN);
    for (uint32_t o = 0; o < plan->object_count; ++o)
        plan->objects[(uint64_t)o * PLAN_EFFECT_COUNT + PLAN_RETURN].share =
            effect_share_of(shares, o, SHARE_RETURN);
    plan->probe_count = shares->probe_count;
}

/* Alone: it costs little beside the scattering that it comes to, and nothing without it. */
static void decide_return(Plan *plan) {
    PlanEffect *effect = &plan->effects[PLAN_RETURN];
    if (!effect->is_simulated)
        return;
    effect->is_simulated = plan->effects[PLAN_WORLD_LIGHT].is_simulated && effect->share.is_known &&
                           effect->share.high > plan->share_min;
    effect->reason = effect->is_simulated ? "large enough to show" : "too small to show";
    effect->rest = effect->is_simulated ? (Share){.is_known = true} : effect->share;
    /* Without light of the surroundings it is among what that leaves out. */
    if (!effect->is_simulated && plan->effects[PLAN_WORLD_LIGHT].is_simulated)
        plan->omitted += effect->share.value;
}

/* One choice for each candidate. */
typedef struct Choice {
    uint32_t steps[CANDIDATE_COUNT]; /* 0: left out; of counted ones of BOUNCE_STEPS, else 1 */
    double rests[CANDIDATE_COUNT];   /* shares of what is left out */
} Choice;

/* The search for the choice of least cost: all of them are looked at, some thousands at most. */
typedef struct Search {
    const Plan *plan;
    EffectWork work;
    /* What is left out of a candidate at a step: reflections beyond it, or all and nothing of the
     * others. Beyond the last step nothing is known. */
    Share rests[CANDIDATE_COUNT][CAMERA_STEP_COUNT];
    double aim, omitted_max;
    bool is_open[CANDIDATE_COUNT];
    Choice choice, best;
    double best_cost; /* infinite: none fits */
} Search;

static double rest_of(const Search *search, uint32_t effect) {
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c)
        if (CANDIDATES[c].effect == effect && search->is_open[c])
            return search->choice.rests[c];
    return 0.0;
}

/* Light of the surroundings, of reflections and through objects is also part of the orders that it
 * scatters in: as much of it as goes with these, about, is not counted again. */
static double sum_omitted(const Search *search) {
    static const uint32_t orders[] = {PLAN_SINGLE_SCATTERING, PLAN_DOUBLE_SCATTERING,
                                      PLAN_MULTIPLE_SCATTERING};
    double all = 0.0, omitted = 0.0;
    for (uint32_t i = 0; i < sizeof orders / sizeof orders[0]; ++i) {
        all += search->plan->effects[orders[i]].share.value;
        omitted += rest_of(search, orders[i]);
    }
    const double kinds = rest_of(search, PLAN_WORLD_LIGHT) + rest_of(search, PLAN_LIGHT_BOUNCES) +
                         rest_of(search, PLAN_TRANSMITTED_LIGHT);
    const double kept = all > 0.0 ? fmax(1.0 - omitted / all, 0.0) : 0.0;
    return omitted + kept * kinds + rest_of(search, PLAN_CAMERA_BOUNCES) +
           rest_of(search, PLAN_SURFACE_REFLECTION) + rest_of(search, PLAN_BACKGROUND);
}

/* Of a sample of the choice, in gathers. */
static double sample_cost(const Search *search, bool walks) {
    EffectChoice choice = {.camera_step = 0};
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        const uint32_t step = search->is_open[c] ? search->choice.steps[c] : 0;
        const uint32_t effect = CANDIDATES[c].effect;
        const bool is_later =
            effect == PLAN_DOUBLE_SCATTERING || effect == PLAN_MULTIPLE_SCATTERING;
        choice.is_on[effect] = step > 0 && (walks || !is_later);
        if (CANDIDATES[c].effect == PLAN_CAMERA_BOUNCES)
            choice.camera_step = step;
        if (CANDIDATES[c].effect == PLAN_LIGHT_BOUNCES)
            choice.light_step = step;
    }
    return effect_cost(&search->work, &choice);
}

/* What a render of the choice takes, but for a factor: what is left out takes room from noise. */
static double predict_cost(const Search *search, double omitted) {
    const double room = search->aim * search->aim - omitted * omitted;
    return sample_cost(search, true) * pow(room, -SAMPLES_ORDER);
}

/* Whether a candidate may be left at a step: what it leaves does not show, or what leaving it shows
 * is little and known. */
static bool may_be(const Search *search, uint32_t c, uint32_t step) {
    const double share_min = search->plan->share_min;
    const Share *rest = &search->rests[c][step];
    return is_less(rest, share_min) ||
           (rest->value <= search->omitted_max && rest->high <= DEAR_MAX * share_min);
}

/* Whether a step adds what shows, or nearly, and is known to. */
static bool is_worth(const Search *search, uint32_t c, uint32_t step) {
    const Share *before = &search->rests[c][step - 1];
    const double least = CHEAP_PART * search->plan->share_min;
    return !is_less(before, search->plan->share_min) ||
           (before->value > least && before->low >= 0.5 * least);
}

/* Whether each of the choice's last steps is worth it, or without it too much would be left out. */
static bool is_needed(Search *search) {
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        const uint32_t step = search->choice.steps[c];
        if (!search->is_open[c] || step == 0 || is_worth(search, c, step))
            continue;
        const double rest = search->choice.rests[c];
        search->choice.rests[c] = search->rests[c][step - 1].value;
        const double omitted = sum_omitted(search);
        search->choice.rests[c] = rest;
        if (omitted <= search->omitted_max)
            return false;
    }
    return true;
}

static void try_from(Search *search, uint32_t c) {
    if (c == CANDIDATE_COUNT) {
        const double omitted = sum_omitted(search);
        if (omitted > search->omitted_max)
            return;
        const double cost = predict_cost(search, omitted);
        if (cost < search->best_cost && is_needed(search)) {
            search->best_cost = cost;
            search->best = search->choice;
        }
        return;
    }
    if (!search->is_open[c]) {
        try_from(search, c + 1);
        return;
    }
    for (uint32_t step = 0; step <= CANDIDATES[c].last_step; ++step)
        if (may_be(search, c, step)) {
            search->choice.steps[c] = step;
            search->choice.rests[c] = search->rests[c][step].value;
            try_from(search, c + 1);
        }
}

/* The step of a candidate that stood alone: the first that leaves too little to show. */
static uint32_t step_alone(const Search *search, uint32_t c) {
    uint32_t step = 0;
    while (step < CANDIDATES[c].last_step) {
        const Share rest = search->rests[c][step];
        if (is_less(&rest, search->plan->share_min))
            break;
        ++step;
    }
    return step;
}

static void apply(const Search *search, uint32_t c, PlanEffect *effect) {
    const uint32_t step = search->best.steps[c], alone = step_alone(search, c);
    effect->is_simulated = step > 0;
    effect->count = CANDIDATES[c].last_step > 1 ? BOUNCE_STEPS[step] : 0;
    effect->rest = search->rests[c][step];
    if (step > alone)
        effect->reason = is_worth(search, c, step) ? "to leave it out would cost more in noise"
                                                   : "what is left out would be too much together";
    else if (step < alone)
        effect->reason = step > 0 ? "large enough to show; more would cost more than noise"
                                  : "it would cost more than noise in its place";
    else
        effect->reason = step > 0 ? "large enough to show" : "too small to show";
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

static void forecast_walks(const EffectShares *shares, const Search *search, Plan *plan) {
    static const uint32_t by_walks[][2] = {{PLAN_DOUBLE_SCATTERING, SHARE_DOUBLE},
                                           {PLAN_MULTIPLE_SCATTERING, SHARE_MULTIPLE},
                                           {PLAN_WORLD_LIGHT, SHARE_WORLD_LIGHT}};
    double square = 0.0;
    for (uint32_t i = 0; i < sizeof by_walks / sizeof by_walks[0]; ++i) {
        const double noise = effect_noise(shares, by_walks[i][1]);
        square += plan->effects[by_walks[i][0]].is_simulated ? noise * noise : 0.0;
    }
    plan->walks.is_known = true;
    plan->walks.noise = sqrt(square);
    plan->walks.cost = sample_cost(search, true);
    plan->walks.without = sample_cost(search, false);
}

void decide(const AmbScene *scene, const EffectShares *shares, double accuracy, double part,
            Plan *plan) {
    Search search = {.plan = plan,
                     .work = effect_work(shares),
                     .aim = AIM_PART * (accuracy > 0.0 ? accuracy : DEFAULT_ACCURACY),
                     .omitted_max = part * find_omitted_max(accuracy),
                     .best_cost = INFINITY};
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c) {
        search.is_open[c] = plan->effects[CANDIDATES[c].effect].is_simulated;
        for (uint32_t step = 0; step < CANDIDATES[c].last_step; ++step)
            search.rests[c][step] = effect_share(shares, CANDIDATES[c].share + step);
        search.rests[c][CANDIDATES[c].last_step] = (Share){.is_known = true};
    }
    try_from(&search, 0);
    search.choice = search.best;
    plan->omitted = sum_omitted(&search);
    for (uint32_t c = 0; c < CANDIDATE_COUNT; ++c)
        if (search.is_open[c])
            apply(&search, c, &plan->effects[CANDIDATES[c].effect]);
    forecast_walks(shares, &search, plan);
    decide_return(plan);
    if (plan->effects[PLAN_SINGLE_SCATTERING].is_simulated)
        choose_targets(scene, DARK_OBJECTS_PART * plan->share_min, plan);
}
