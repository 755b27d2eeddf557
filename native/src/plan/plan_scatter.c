/* SPDX-License-Identifier: GPL-3.0-or-later
 * Who simulates light of later orders. */
#include "plan/plan_scatter.h"

#include "field/scatter/lobe.h"

const char *plan_scatter_estimator_name(uint32_t estimator) {
    static const char *const names[] = {"AUTO", "WALK", "PHOTONS", "TREE_CUT"};
    return estimator < sizeof names / sizeof names[0] ? names[estimator] : "UNKNOWN";
}

static bool has_later_orders(const Plan *plan) {
    return plan->effects[PLAN_DOUBLE_SCATTERING].is_simulated ||
           plan->effects[PLAN_MULTIPLE_SCATTERING].is_simulated;
}

/* One photon for so many volume samples: a path of the one and a place of the other cost about as
 * much. */
static const uint64_t SAMPLES_PER_PHOTON = 4;
/* Too few photons show as blotches, which the eye finds worse than noise from pixel to pixel: of a
 * fixed number of samples AUTO takes so many for each photon, which then cost a fifth or so of the
 * camera's. */
static const double CAMERA_SAMPLES_PER_PHOTON = 2.0;
/* Photons for an error of 3 % in a sphere lit all around; n of them leave an error in n^(-1/3). A
 * render to a target of 1 % begins with so many, and takes as many as what these leave asks for
 * (render/accuracy_scatter.h). */
static const double PHOTONS_FIRST_AT_PERCENT = 5e5;
static const double PHOTONS_FIRST_MIN = 2048.0;

uint64_t plan_photons_most(const AmbRenderParams *params) {
    return 16 * (params->light_samples / SAMPLES_PER_PHOTON);
}

/* Camera samples of a picture. With a target these are a few of each pixel. */
enum { SAMPLES_OF_TARGET = 8 };

static double samples_of_picture(const AmbRenderParams *params) {
    const bool is_crop = params->crop_width > 0;
    const double width = is_crop ? params->crop_width : params->width;
    const double height = is_crop ? params->crop_height : params->height;
    const bool has_target = params->accuracy > 0.0f;
    return width * height * (has_target ? SAMPLES_OF_TARGET : params->samples);
}

static uint64_t count_photons(const AmbRenderParams *params) {
    const uint64_t set = params->light_samples / SAMPLES_PER_PHOTON;
    if (!(params->accuracy > 0.0f) && params->scatter_estimator == AMB_SCATTER_AUTO) {
        const double fitting = samples_of_picture(params) / CAMERA_SAMPLES_PER_PHOTON;
        const double most = (double)plan_photons_most(params);
        return (uint64_t)fmax(1.0, fmax((double)set, fmin(fitting, most)));
    }
    /* The error of a tree cut is of another kind: more samples do not lessen it. */
    if (!(params->accuracy > 0.0f) || params->scatter_estimator == AMB_SCATTER_TREE_CUT)
        return set > 0 ? set : 1;
    const double percent = 100.0 * (double)params->accuracy;
    const double wanted = PHOTONS_FIRST_AT_PERCENT / (percent * percent * percent);
    const double most = (double)plan_photons_most(params), least = fmin(PHOTONS_FIRST_MIN, most);
    return (uint64_t)(wanted < least ? least : wanted > most ? most : wanted);
}

/* Where AUTO takes photons. tests/bench/bench_thick.py: at equal error they cost a hundredth to a
 * thousandth of walks from an optical radius of 1 on, whatever the albedo. In thinner media they
 * gain tens of times in large pictures, where what they cost once does not matter. */
static const float OPTICAL_RADIUS_MIN = 1.0f, THIN_RADIUS_MIN = 0.1f;
/* Sharper lobes than these harmonics cannot follow: a percent or two of the light is wrong up to
 * 0.9 (--means), where walks leave forty times as much in 16 samples. Where a target asks for an
 * error, walks reach it. */
static const float LOBE_G_MAX = 0.9f, LOBE_G_OF_TARGET = 0.8f;
static const double SAMPLES_LARGE = 1 << 17;
/* By reports of the planner's scenes, in gathers: what photons take of a target beside their paths,
 * of which come eight times as many as there are first. */
static const double PHOTONS_COST = 6e4, PHOTON_COST = 4.0, PHOTONS_OF_FIRST = 8.0;
/* Noise of walks and what the picture's grain brings fall together somewhat faster than walks' do
 * by themselves: n samples for a noise of 1 / n^(3/5). */
static const double WALK_ORDER = 5.0 / 3.0;
/* Walks that find no lamp's light gather nothing. */
static const double DARK_WALK_COST = 0.2;

typedef struct ScatterMedia {
    bool is_thick, is_thin, is_sharp;
} ScatterMedia;

static ScatterMedia look_at_media(const AmbScene *scene, const AmbRenderParams *params) {
    const float sharpest = params->accuracy > 0.0f ? LOBE_G_OF_TARGET : LOBE_G_MAX;
    ScatterMedia media = {false, true, false};
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const SceneObject *object = &scene->objects[o];
        const Medium *medium = &scene->materials[object->inside].medium;
        if (!object->is_boundary || !medium_scatters(medium))
            continue;
        const float optical_radius = object->radius * rgb_max(medium->sigma_t);
        media.is_thick = media.is_thick || optical_radius >= OPTICAL_RADIUS_MIN;
        media.is_thin = media.is_thin && optical_radius < THIN_RADIUS_MIN;
        for (uint32_t l = 0; l < medium->lobe_count; ++l)
            media.is_sharp = media.is_sharp || fabsf(medium->lobes[l].g) > sharpest ||
                             !lobe_keeps_mean(medium->lobes[l].g);
    }
    return media;
}

static void choose(Plan *plan, bool takes_photons, const char *reason) {
    plan->scatter_estimator = takes_photons ? AMB_SCATTER_PHOTONS : AMB_SCATTER_WALK;
    plan->scatter_estimator_reason = reason;
}

/* Of a target, with what probes have seen of walks. */
static void choose_by_cost(const AmbRenderParams *params, Plan *plan) {
    const double target = (double)params->accuracy, omitted = plan->omitted;
    const double room = sqrt(fmax(target * target - omitted * omitted, 0.0));
    const double samples =
        room > 0.0 ? pow(plan->walks.noise / room, WALK_ORDER) : (double)INFINITY;
    const double cost = (plan->has_field ? 1.0 : DARK_WALK_COST) * plan->walks.cost;
    /* Light of the surroundings that scatters once is even: the first are enough. */
    const double photons =
        (has_later_orders(plan) ? PHOTONS_OF_FIRST : 1.0) * (double)count_photons(params);
    const bool takes_photons =
        plan->walks.pixels * samples * cost > PHOTONS_COST + PHOTON_COST * photons;
    choose(plan, takes_photons,
           takes_photons ? "walks would cost more, by their noise in probes"
                         : "photons would cost more than walks, by their noise in probes");
}

static void choose_automatically(const AmbScene *scene, const AmbRenderParams *params, Plan *plan) {
    const ScatterMedia media = look_at_media(scene, params);
    const bool is_large =
        media.is_thick || (!media.is_thin && samples_of_picture(params) >= SAMPLES_LARGE);
    if (media.is_sharp)
        choose(plan, false, "a medium scatters too sharply for cells");
    else if (params->accuracy > 0.0f && plan->walks.is_known && !media.is_thin)
        choose_by_cost(params, plan);
    else if (!has_later_orders(plan))
        choose(plan, false, "nothing scatters more than once");
    else
        choose(plan, is_large,
               media.is_thick ? "a medium is an optical radius thick or more"
               : is_large     ? "the picture is large enough for photons to pay"
                              : "media are thin");
}

/* Fewer are not tried where memory ends. First of all few threads share it. */
static const uint64_t PHOTONS_MIN = 64;
enum { FEW_SUMS = 2 };

void plan_scatter(const AmbScene *scene, const AmbRenderParams *params, Plan *plan) {
    const bool is_left_to_us = params->scatter_estimator == AMB_SCATTER_AUTO;
    plan->scatter_estimator = params->scatter_estimator;
    plan->scatter_estimator_reason = "asked for";
    if (!has_later_orders(plan) && !plan->effects[PLAN_WORLD_LIGHT].is_simulated) {
        plan->scatter_estimator = AMB_SCATTER_WALK;
        plan->scatter_estimator_reason = "nothing scatters more than once";
    } else if (is_left_to_us) {
        choose_automatically(scene, params, plan);
    }
    const bool uses_tree_cut = plan->scatter_estimator == AMB_SCATTER_TREE_CUT;
    if (uses_tree_cut && plan->effects[PLAN_WORLD_LIGHT].is_simulated) {
        plan->effects[PLAN_WORLD_LIGHT].is_simulated = false;
        plan->effects[PLAN_WORLD_LIGHT].reason = "TREE_CUT has volume samples of lamps alone";
        plan->effects[PLAN_RETURN].is_simulated = false;
        plan->effects[PLAN_RETURN].reason = plan->effects[PLAN_WORLD_LIGHT].reason;
    }
    plan->scatter =
        (ScatterParams){.uses_tree_cut = uses_tree_cut,
                        .photon_count = count_photons(params),
                        .light_bounces = plan->light.bounces,
                        .order_max = plan_last_order(params, plan),
                        .follows_through = plan->light.follows_through,
                        .adjoint_normals = params->adjoint_normals != 0,
                        .has_world = plan->effects[PLAN_WORLD_LIGHT].is_simulated,
                        .interreflects = plan->camera.has_returns,
                        .returns = plan->camera.has_returns && plan->camera.shines_through,
                        .seed = params->seed};
}

uint32_t plan_last_order(const AmbRenderParams *params, const Plan *plan) {
    if (plan->effects[PLAN_MULTIPLE_SCATTERING].is_simulated)
        return params->scatter_order_max;
    const uint32_t last = plan->effects[PLAN_DOUBLE_SCATTERING].is_simulated ? 2 : 1;
    const uint32_t most = params->scatter_order_max;
    return most > 0 && most < last ? most : last;
}

bool plan_reduce_scatter(Plan *plan) {
    ScatterParams *params = &plan->scatter;
    if (!params->uses_tree_cut && params->sum_count != FEW_SUMS) {
        params->sum_count = FEW_SUMS;
        return true;
    }
    if (params->photon_count < 8 * PHOTONS_MIN)
        return false;
    params->photon_count /= 8;
    return true;
}
