/* SPDX-License-Identifier: GPL-3.0-or-later
 * What is worth simulating. */
#include "plan/plan.h"

#include <string.h>

#include "base/memory.h"
#include "plan/decide.h"
#include "plan/plan_caustics.h"
#include "plan/plan_estimator.h"
#include "plan/plan_interreflection.h"
#include "plan/plan_scatter.h"
#include "plan/scene_rules.h"
#include "plan/view_reflections.h"

/* Volume samples along one light ray, on average. More of them follow a caustic more closely and
 * make tighter boxes, fewer leave more rays for the same memory. */
static const uint64_t SAMPLES_PER_RAY = 8;
/* Light that tubes leave to points has been spread by a few walls: its rays lie as if by chance.
 * More of them with fewer samples each, wider kernels, and fewer where little is left serve it at a
 * tenth of the cost (bench_orders.py full). */
static const uint64_t LATE_SAMPLES_PER_RAY = 4, LATE_SAMPLE_PART = 4;
static const float LATE_ROULETTE = 0.1f, LATE_KERNEL = 2.0f;

/* The beams of later reflections are most of a light field and next to none of its light. A first
 * reflection, 4 % and more before extinction, keeps the evenness of the lattice where it can: at
 * 0.1 gathers are a third cheaper, and what a slab's far side reflects has a noise of 5 %. */
static const float LIGHT_ROULETTE = 0.02f;

/* By tests/bench/bench_scenes.py: 4 parts at 16 samples add a hundredth to the error, 8 a
 * sixteenth. */
enum { PART_SAMPLES = 4, LATE_PART_SAMPLES = 2, PARTS_MAX = CAUSTIC_PART_MAX };
/* The least samples of a pixel see each part once, where maps of caustics, which have parts, too,
 * are not compared by them. By bench_orders.py full, a target of 32 %: 4.5 CPU s for 12.8 of the
 * camera, of samples that cost a third, for the same noise. */
enum { LATE_PARTS_OF_TARGET = 4 };

/* Fewer than these are no picture to speak of. */
static const uint64_t LIGHT_SAMPLES_MIN = 4096, CAUSTIC_RAYS_MIN = 1024;

const char *plan_estimator_name(uint32_t estimator) {
    static const char *const names[] = {"AUTO", "POINTS_FIXED", "POINTS_COVARIANCE", "TUBES",
                                        "SPECULAR"};
    return estimator < sizeof names / sizeof names[0] ? names[estimator] : "UNKNOWN";
}

AmbStatus plan_check(const AmbRenderParams *params) {
    if (params->estimator > AMB_ESTIMATOR_SPECULAR)
        return status_fail(AMB_UNSUPPORTED, "estimator %s is not available in this version",
                           plan_estimator_name(params->estimator));
    return AMB_OK;
}

/* Probe rays of the light, and camera paths that measure the shares. Both grow with the render so
 * that they stay a small part of it; a small one that chooses by itself takes the least. */
enum {
    LIGHT_RAYS_MIN = 1024,
    LIGHT_RAYS_MAX = 4096,
    SAMPLES_PER_LIGHT_RAY = 16,
    PROBES_MIN = 64,  /* at a time */
    PROBES_FEW = 256, /* where a share is not clear, however small the render */
    PROBES_MAX = 1024,
    SAMPLES_PER_PROBE = 64,
    SAMPLES_OF_TARGET = 8, /* of a pixel, where a target decides */
    VIEW_RAYS_MAX = 4096,
    /* The least render that tells shares on which nothing hangs: a probe follows walks through many
     * light fields, and costs what some hundred samples of a simple picture do. */
    SAMPLES_TO_TELL = 1 << 21
};
/* Where nothing scatters, shares have little noise and samples cost little: fewer probes are
 * enough. And what is left out saves little there, but narrows the room for noise, which costs
 * samples: less is. */
static const double CLEAR_EFFORT = 1.0 / 8.0, CLEAR_SHARE = 0.4;
/* Another sequence than the picture's own. */
static const uint32_t PROBE_SEED = 0x5eed;
/* Of the least share: all later orders together stay below half of it. */
static const double ALBEDO_PART = 0.5;
/* Of a picture whose effects are all chosen by hand the shares are told as if all were on. */
static const uint32_t EFFECTS_ALL = AMB_EFFECT_SINGLE_SCATTERING | AMB_EFFECT_DOUBLE_SCATTERING |
                                    AMB_EFFECT_MULTIPLE_SCATTERING | AMB_EFFECT_WORLD_LIGHT |
                                    AMB_EFFECT_SURFACE_REFLECTION | AMB_EFFECT_BACKGROUND;

static PlanEffect plan_single(const AmbScene *scene, const AmbRenderParams *params,
                              bool has_world) {
    const char *name = "single scattering";
    if ((params->effects & AMB_EFFECT_SINGLE_SCATTERING) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_scattering(scene))
        return plan_skipped(name, "no medium scatters");
    if (scene_has_lamp(scene))
        return plan_simulated(name, "a medium scatters the light of a lamp");
    if (has_world)
        return plan_simulated(name, "a medium scatters the light of its surroundings");
    return plan_skipped(name, "no lamp");
}

/* Light of later orders: from lamps, or from the surroundings. */
static PlanEffect plan_later_order(const AmbScene *scene, const AmbRenderParams *params,
                                   const char *name, uint32_t order, uint32_t effect,
                                   const Plan *plan) {
    if ((params->effects & effect) == 0)
        return plan_skipped(name, "switched off");
    if (params->scatter_order_max > 0 && params->scatter_order_max < order)
        return plan_skipped(name, "scatter_order_max set");
    if (!scene_has_scattering(scene))
        return plan_skipped(name, "no medium scatters");
    if (!scene_has_lamp(scene) && !plan->effects[PLAN_WORLD_LIGHT].is_simulated)
        return plan_skipped(name, "no light");
    /* All later orders together have at most albedo / (1 - albedo) of the light of the first. */
    const double albedo = (double)scene_albedo_max(scene);
    if (plan->is_automatic && albedo < ALBEDO_PART * plan->share_min)
        return plan_skipped(name, "every medium absorbs nearly all that it does not let through");
    return plan_simulated(name, "a medium scatters light");
}

static PlanEffect plan_bounces(const AmbScene *scene, const char *name, uint32_t bounces,
                               bool is_automatic, bool is_seen) {
    if (bounces == 0 && !is_automatic)
        return plan_skipped(name, "0 bounces set");
    if (!is_seen)
        return plan_skipped(name, "nothing scatters");
    if (!scene_has_refraction(scene))
        return plan_skipped(name, "no boundary reflects: every ior is 1");
    PlanEffect effect = plan_simulated(name, "bounces set and a boundary reflects");
    effect.count = bounces;
    return effect;
}

static PlanEffect plan_surface(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "surface reflection";
    if ((params->effects & AMB_EFFECT_SURFACE_REFLECTION) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_refraction(scene))
        return plan_skipped(name, "no boundary reflects: every ior is 1");
    return plan_simulated(name, "a boundary reflects");
}

static PlanEffect plan_background(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "background through objects";
    if ((params->effects & AMB_EFFECT_BACKGROUND) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_boundary(scene))
        return plan_skipped(name, "no translucent object");
    return plan_simulated(name, "a translucent object is there");
}

static PlanEffect plan_transmitted(const AmbRenderParams *params, bool has_field) {
    const char *name = "light through other objects";
    if ((params->effects & AMB_EFFECT_TRANSMITTED_LIGHT) == 0)
        return plan_skipped(name, "switched off");
    if (!has_field)
        return plan_skipped(name, "nothing scatters");
    return plan_simulated(name, "it adds to the light in media, by probe rays");
}

static PlanEffect plan_world(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "light of the surroundings in media";
    if ((params->effects & AMB_EFFECT_WORLD_LIGHT) == 0)
        return plan_skipped(name, "switched off");
    if (scene->world.is_black && !scene_has_opaque_surface(scene))
        return plan_skipped(name, "the world is black and no surface is opaque");
    if (!scene_has_scattering(scene))
        return plan_skipped(name, "no medium scatters");
    return plan_simulated(name, "a medium scatters, and there are surroundings");
}

static PlanEffect plan_return(const AmbScene *scene, const AmbRenderParams *params,
                              const Plan *plan) {
    const char *name = "light that surfaces have from others, in media";
    if ((params->effects & AMB_EFFECT_INTERREFLECTION) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_opaque_surface(scene))
        return plan_skipped(name, "no opaque surface");
    if (!plan->effects[PLAN_WORLD_LIGHT].is_simulated)
        return plan_skipped(name, "no medium sees the light of its surroundings");
    return plan_simulated(name, "media and opaque surfaces are there");
}

static PlanEffect plan_lamp_images(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "images of lamps";
    if ((params->effects & AMB_EFFECT_LAMP_IMAGES) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_boundary(scene))
        return plan_skipped(name, "no translucent object");
    if (!scene_has_wide_lamp(scene))
        return plan_skipped(name, "no lamp has an extent");
    return plan_simulated(name, "a lamp has an extent");
}

/* Whether the effects gather light of lamps in media. */
static bool needs_field(const AmbScene *scene, const Plan *plan) {
    const PlanEffect *effects = plan->effects;
    return scene_has_lamp(scene) && !plan->is_dark &&
           (effects[PLAN_SINGLE_SCATTERING].is_simulated ||
            effects[PLAN_DOUBLE_SCATTERING].is_simulated ||
            effects[PLAN_MULTIPLE_SCATTERING].is_simulated);
}

/* What the switches allow and the scene's description does not rule out. */
static void apply_rules(const AmbScene *scene, const AmbRenderParams *params, Plan *plan) {
    PlanEffect *effects = plan->effects;
    effects[PLAN_WORLD_LIGHT] = plan_world(scene, params);
    effects[PLAN_SINGLE_SCATTERING] =
        plan_single(scene, params, effects[PLAN_WORLD_LIGHT].is_simulated);
    effects[PLAN_DOUBLE_SCATTERING] =
        plan_later_order(scene, params, "double scattering", 2, AMB_EFFECT_DOUBLE_SCATTERING, plan);
    effects[PLAN_MULTIPLE_SCATTERING] = plan_later_order(scene, params, "multiple scattering", 3,
                                                         AMB_EFFECT_MULTIPLE_SCATTERING, plan);
    plan->has_field = needs_field(scene, plan);
    effects[PLAN_LIGHT_BOUNCES] =
        plan_bounces(scene, "light-side internal reflection", params->light_bounces,
                     plan->is_automatic, plan->has_field);
    /* On the camera side they also show the background again, so a boundary is reason enough. */
    effects[PLAN_CAMERA_BOUNCES] = plan_bounces(
        scene, "camera-side internal reflection", params->camera_bounces, plan->is_automatic,
        plan->has_field || (params->effects & AMB_EFFECT_BACKGROUND) != 0);
    effects[PLAN_SURFACE_REFLECTION] = plan_surface(scene, params);
    effects[PLAN_BACKGROUND] = plan_background(scene, params);
    effects[PLAN_TRANSMITTED_LIGHT] = plan_transmitted(params, plan->has_field);
    effects[PLAN_LIGHT_ON_SURFACES] = plan_light_on_surfaces(scene, params);
    effects[PLAN_CAUSTICS] = plan_caustics(scene, params, plan);
    effects[PLAN_INTERREFLECTION] = plan_interreflection(scene, params);
    effects[PLAN_RETURN] = plan_return(scene, params, plan);
    effects[PLAN_LAMP_IMAGES] = plan_lamp_images(scene, params);
}

static uint64_t clamp_count(double count, uint64_t least, uint64_t most) {
    return count < (double)least ? least : count > (double)most ? most : (uint64_t)count;
}

/* Camera samples of the whole render, about. */
static double expected_samples(const AmbRenderParams *params, const PlanCrop *crop) {
    return (double)crop->width * crop->height *
           (params->accuracy > 0.0f ? SAMPLES_OF_TARGET : params->samples);
}

static const struct {
    uint32_t effect, bit;
} ON_CAMERA[] = {{PLAN_SINGLE_SCATTERING, AMB_EFFECT_SINGLE_SCATTERING},
                 {PLAN_DOUBLE_SCATTERING, AMB_EFFECT_DOUBLE_SCATTERING},
                 {PLAN_MULTIPLE_SCATTERING, AMB_EFFECT_MULTIPLE_SCATTERING},
                 {PLAN_WORLD_LIGHT, AMB_EFFECT_WORLD_LIGHT},
                 {PLAN_SURFACE_REFLECTION, AMB_EFFECT_SURFACE_REFLECTION},
                 {PLAN_BACKGROUND, AMB_EFFECT_BACKGROUND},
                 {PLAN_INTERREFLECTION, AMB_EFFECT_INTERREFLECTION},
                 {PLAN_LAMP_IMAGES, AMB_EFFECT_LAMP_IMAGES}};

/* AMB_EFFECT_* of the effects that are to be simulated and that the camera's paths need to know. */
static uint32_t camera_effects(const Plan *plan) {
    uint32_t bits = 0;
    for (size_t i = 0; i < sizeof ON_CAMERA / sizeof ON_CAMERA[0]; ++i)
        if (plan->effects[ON_CAMERA[i].effect].is_simulated)
            bits |= ON_CAMERA[i].bit;
    return bits;
}

/* Batches of probes until every share is known well enough, and probes_min of them at least.
 * Without a decision that hangs on them one batch is enough. */
static AmbStatus measure(const AmbScene *scene, const AmbRenderParams *params, View *view,
                         const LightProbe *light, uint64_t probes_min, uint64_t probes_max,
                         Job *job, EffectShares *shares, const Plan *plan) {
    const EffectProbe probe = {
        .scene = scene,
        .view = view,
        .light = light,
        .share_min = plan->share_min,
        .camera = {.width = params->width,
                   .height = params->height,
                   .effects = plan->is_automatic ? camera_effects(plan) : EFFECTS_ALL,
                   .order_max = params->scatter_order_max,
                   .shines_through = plan->effects[PLAN_LIGHT_ON_SURFACES].is_simulated,
                   .has_returns = plan->effects[PLAN_RETURN].is_simulated,
                   .job = job,
                   .bounces = CAMERA_BOUNCES_MOST,
                   .seed = params->seed ^ PROBE_SEED,
                   .film_transparent = params->film_transparent != 0,
                   .may_start_inside = scene_may_start_inside(scene),
                   .replicas = 2}};
    /* Where nothing scatters a render costs little more than this would. */
    if (plan->is_automatic && plan->effects[PLAN_CAMERA_BOUNCES].is_simulated &&
        scene_has_scattering(scene))
        AMB_TRY(view_weigh_reflections(scene, &probe.camera, job, view));
    while (shares->probe_count < probes_max) {
        AMB_TRY(effect_shares_measure(shares, &probe, PROBES_MIN, job));
        if (!plan->is_automatic ||
            (shares->probe_count >= probes_min && decide_is_settled(shares, plan)))
            break;
    }
    return AMB_OK;
}

/* Nothing of the objects is seen: what makes them look as they do need not be, but for the light
 * that they throw on what is seen. */
static void skip_unseen(Plan *plan) {
    for (uint32_t i = 0; i < PLAN_EFFECT_COUNT; ++i)
        if (plan->effects[i].is_simulated && i != PLAN_LIGHT_ON_SURFACES && i != PLAN_CAUSTICS &&
            i != PLAN_INTERREFLECTION)
            plan->effects[i] =
                plan_skipped(plan->effects[i].name, "no translucent object is in sight");
}

static AmbStatus decide_by_shares(const AmbScene *scene, const AmbRenderParams *params,
                                  const PlanCrop *crop, const LightProbe *light, Job *job,
                                  Plan *plan) {
    const bool is_clear = !scene_has_scattering(scene);
    const double samples = (is_clear ? CLEAR_EFFORT : 1.0) * expected_samples(params, crop);
    const ViewParams view_params = {
        .x = crop->x,
        .y = crop->y,
        .width = crop->width,
        .height = crop->height,
        .full_width = params->width,
        .full_height = params->height,
        .ray_count = (uint32_t)clamp_count(samples / 4.0, PROBES_MIN, VIEW_RAYS_MAX),
        .seed = params->seed,
        .may_start_inside = scene_may_start_inside(scene)};
    View view;
    AMB_TRY(view_create(scene, &view_params, job, &view));
    EffectShares shares = {.probe_count = 0};
    AmbStatus status = AMB_OK;
    if (view.visible_count > 0) {
        status = effect_shares_create(scene, &shares);
        const uint64_t probes = clamp_count(samples / SAMPLES_PER_PROBE, PROBES_FEW, PROBES_MAX);
        /* What only a few pixels show many times reflected, few probes miss; where nothing scatters
         * those that cost next to nothing are not saved. */
        const uint64_t least =
            is_clear ? clamp_count(samples / SAMPLES_PER_PROBE, PROBES_MIN, PROBES_FEW)
                     : PROBES_MIN;
        if (status == AMB_OK)
            status = measure(scene, params, &view, light, least, probes, job, &shares, plan);
        if (status == AMB_OK) {
            decide_describe(&shares, plan);
            plan->walks.pixels = view.part * (double)crop->width * (double)crop->height;
            if (plan->is_automatic)
                decide(scene, &shares, (double)params->accuracy, is_clear ? CLEAR_SHARE : 1.0,
                       plan);
        }
    } else if (plan->is_automatic) {
        skip_unseen(plan);
    }
    effect_shares_clear(&shares);
    view_clear(&view);
    return status;
}

/* Light that is not traced is neither reflected nor passed on; light of the surroundings is seen
 * in the orders alone. */
static void skip_dependent(const AmbScene *scene, Plan *plan) {
    static const uint32_t of_field[] = {PLAN_LIGHT_BOUNCES, PLAN_TRANSMITTED_LIGHT};
    plan->has_field = needs_field(scene, plan);
    for (uint32_t i = 0; i < sizeof of_field / sizeof of_field[0] && !plan->has_field; ++i) {
        PlanEffect *effect = &plan->effects[of_field[i]];
        if (effect->is_simulated) {
            effect->is_simulated = false;
            effect->count = 0;
            effect->reason = "light that scatters is left out";
        }
    }
}

/* Lamps are turned away from all objects, or hidden from them. */
static void skip_dark(Plan *plan) {
    static const uint32_t of_lamps[] = {PLAN_LIGHT_BOUNCES, PLAN_TRANSMITTED_LIGHT};
    static const uint32_t of_all[] = {PLAN_SINGLE_SCATTERING, PLAN_DOUBLE_SCATTERING,
                                      PLAN_MULTIPLE_SCATTERING};
    plan->is_dark = true;
    for (uint32_t i = 0; i < sizeof of_lamps / sizeof of_lamps[0]; ++i) {
        PlanEffect *effect = &plan->effects[of_lamps[i]];
        if (effect->is_simulated)
            *effect = plan_skipped(effect->name, "no lamp lights an object");
    }
    for (uint32_t i = 0; i < sizeof of_all / sizeof of_all[0]; ++i) {
        PlanEffect *effect = &plan->effects[of_all[i]];
        if (effect->is_simulated && !plan->effects[PLAN_WORLD_LIGHT].is_simulated)
            *effect = plan_skipped(effect->name, "no lamp lights an object");
    }
}

static AmbStatus settle_effects(const AmbScene *scene, const AmbRenderParams *params,
                                const PlanCrop *crop, bool explains, Job *job, Plan *plan,
                                MeshProblems *out_problems) {
    const double samples = expected_samples(params, crop);
    /* Who decides alone is told the shares where that costs nothing to speak of. */
    const bool is_measured = scene_has_boundary(scene) &&
                             (plan->is_automatic || explains || samples >= (double)SAMPLES_TO_TELL);
    LightProbe light = {.fields = {NULL}};
    if (plan->has_field) {
        const LightProbeParams probe = {
            .ray_count = is_measured ? clamp_count(samples / SAMPLES_PER_LIGHT_RAY, LIGHT_RAYS_MIN,
                                                   LIGHT_RAYS_MAX)
                                     : LIGHT_RAYS_MAX,
            .bounces = is_measured ? LIGHT_BOUNCES_MOST : plan->effects[PLAN_LIGHT_BOUNCES].count,
            .has_fields = is_measured,
            .adjoint_normals = params->adjoint_normals != 0,
            .seed = params->seed};
        AMB_TRY(light_probe_create(scene, &probe, job, &light));
    }
    if (light.is_dark && plan->has_field && plan->is_automatic)
        skip_dark(plan);
    AmbStatus status = AMB_OK;
    if (is_measured)
        status = decide_by_shares(scene, params, crop, &light, job, plan);
    PlanEffect *transmitted = &plan->effects[PLAN_TRANSMITTED_LIGHT];
    if (transmitted->is_simulated && !(light.flux[LIGHT_CLASS_PASSED] > 0.0))
        *transmitted = (PlanEffect){.name = transmitted->name,
                                    .reason = "no light comes into media through other objects",
                                    .share = transmitted->share};
    *out_problems = light.problems;
    light_probe_clear(&light);
    return status;
}

void plan_set_light_samples(Plan *plan, uint64_t samples) {
    const uint64_t rays =
        samples / (plan->light.carried > 0 ? LATE_SAMPLES_PER_RAY : SAMPLES_PER_RAY);
    plan->light.ray_count = rays > 0 ? rays : 1;
    plan->field.sample_target = samples;
}

bool plan_reduce_caustics(Plan *plan) {
    uint64_t *const counts[] = {&plan->caustics.light.ray_count, &plan->caustics.glow.photon_count};
    bool is_reduced = false;
    for (int i = 0; i < 2; ++i)
        if (*counts[i] >= 4 * CAUSTIC_RAYS_MIN) {
            *counts[i] /= 4;
            is_reduced = true;
        }
    return is_reduced;
}

bool plan_reduce_field(Plan *plan) {
    const bool has_finer_tubes =
        plan->estimator == AMB_ESTIMATOR_TUBES && plan->field.tube_refinement > TUBE_REFINEMENT_MIN;
    const bool has_more_points =
        plan->has_points && plan->field.sample_target >= 4 * LIGHT_SAMPLES_MIN;
    if (has_finer_tubes)
        --plan->field.tube_refinement;
    if (has_more_points)
        plan_set_light_samples(plan, plan->field.sample_target / 4);
    return has_finer_tubes || has_more_points;
}

/* Into how many parts the light is divided, of which a camera sample sees one: a gather of all of
 * it is far more exact than one sample of a pixel can use. A pixel sees every part PART_SAMPLES
 * times, so that the parts' differences average out and show in the error that is stated. */
static uint32_t count_parts(const AmbRenderParams *params, const Plan *plan) {
    const bool is_late = plan->has_points && plan->light.carried > 0;
    if (params->accuracy > 0.0f)
        return is_late && !plan->effects[PLAN_CAUSTICS].is_simulated ? LATE_PARTS_OF_TARGET : 1;
    if (!plan->is_automatic && !is_late)
        return 1;
    const uint32_t parts = params->samples / (is_late ? LATE_PART_SAMPLES : PART_SAMPLES);
    return parts < 1 ? 1 : parts < PARTS_MAX ? parts : PARTS_MAX;
}

/* What the stages are told. */
static void set_parameters(const AmbScene *scene, const AmbRenderParams *params, Plan *plan) {
    const PlanEffect *effects = plan->effects;
    const bool follows_through = effects[PLAN_TRANSMITTED_LIGHT].is_simulated;
    const bool has_tubes = plan->estimator == AMB_ESTIMATOR_TUBES;
    const uint32_t bounces = effects[PLAN_LIGHT_BOUNCES].count;
    const uint32_t tube_bounces = has_tubes ? plan->tube_bounces : 0;
    plan->has_points =
        plan->has_field && plan->estimator != AMB_ESTIMATOR_SPECULAR &&
        (!has_tubes || bounces > tube_bounces || follows_through || scene->mesh_lamp_count > 0);
    const bool is_late = has_tubes && plan->has_points;
    plan->light =
        (LightTraceParams){.bounces = bounces,
                           .carried = is_late ? tube_bounces + 1 : 0,
                           .follows_through = follows_through,
                           /* Light through an object that is dark itself may matter in the next. */
                           .targets = follows_through ? NULL : plan->targets,
                           .adjoint_normals = params->adjoint_normals != 0,
                           .roulette = is_late ? LATE_ROULETTE : LIGHT_ROULETTE,
                           .seed = params->seed};
    plan->field = (FieldParams){.estimator = plan->estimator,
                                .kernel_size = (is_late ? LATE_KERNEL : 1.0f) * params->kernel_size,
                                .tube_refinement = params->tube_refinement,
                                .light_bounces = tube_bounces,
                                .targets = plan->targets,
                                .adjoint_normals = params->adjoint_normals != 0};
    plan->light_samples = params->light_samples;
    if (is_late && plan->light_samples > LATE_SAMPLE_PART)
        plan->light_samples /= LATE_SAMPLE_PART;
    plan_set_light_samples(plan, plan->light_samples);
    const uint32_t parts = count_parts(params, plan);
    plan->field.part_count = plan->caustics.part_count = parts;

    plan->camera = (CameraParams){.width = params->width,
                                  .height = params->height,
                                  .effects = camera_effects(plan),
                                  .bounces = effects[PLAN_CAMERA_BOUNCES].count,
                                  .order_max = params->scatter_order_max,
                                  .shines_through = effects[PLAN_LIGHT_ON_SURFACES].is_simulated,
                                  .seed = params->seed,
                                  .part_count = parts,
                                  .gathers_by_chance = plan->is_automatic && parts > 1,
                                  .film_transparent = params->film_transparent != 0,
                                  .may_start_inside = scene_may_start_inside(scene),
                                  .has_returns = effects[PLAN_RETURN].is_simulated,
                                  .replicas = params->accuracy > 0.0f ? 2 : 1};
}

/* What was decided for the whole picture, for each object. */
static void describe_objects(const AmbScene *scene, Plan *plan) {
    for (uint32_t o = 0; o < plan->object_count; ++o)
        for (uint32_t e = 0; e < PLAN_EFFECT_COUNT; ++e) {
            const bool needs_light = e == PLAN_SINGLE_SCATTERING || e == PLAN_LIGHT_BOUNCES ||
                                     e == PLAN_TRANSMITTED_LIGHT;
            plan->objects[(uint64_t)o * PLAN_EFFECT_COUNT + e].is_simulated =
                plan->effects[e].is_simulated && scene->objects[o].is_boundary &&
                (!needs_light || (plan->targets[o] && scene_object_scatters(scene, o)));
        }
}

AmbStatus plan_create(const AmbScene *scene, const AmbRenderParams *params, const PlanCrop *crop,
                      bool explains, Job *job, Plan *out_plan) {
    Plan plan = {.estimator = params->estimator,
                 .object_count = scene->object_count,
                 .is_automatic = params->effects_are_auto != 0,
                 .share_min = (scene_has_scattering(scene) ? 1.0 : CLEAR_SHARE) *
                              decide_share_min((double)params->accuracy)};
    plan.objects =
        memory_zero_array((uint64_t)plan.object_count * PLAN_EFFECT_COUNT, sizeof *plan.objects);
    plan.targets = memory_alloc_array(plan.object_count, sizeof *plan.targets);
    AmbStatus status = AMB_OK;
    if (plan.objects == NULL || plan.targets == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    MeshProblems problems = {.is_irregular = false};
    const double begin = clock_thread_cpu();
    const uint64_t helpers_begin = atomic_load(&job->cpu_ns);
    if (status == AMB_OK) {
        for (uint32_t o = 0; o < plan.object_count; ++o)
            plan.targets[o] = true;
        apply_rules(scene, params, &plan);
        status = plan_measure_interreflection(scene, params, crop, job, &plan);
    }
    if (status == AMB_OK)
        status = settle_effects(scene, params, crop, explains, job, &plan, &problems);
    if (status == AMB_OK) {
        plan.omitted += plan.effects[PLAN_INTERREFLECTION].rest.value;
        skip_dependent(scene, &plan);
        status = plan_measure_caustics(scene, params, job, &plan);
    }
    if (status == AMB_OK)
        status = plan_estimator(scene, params, &problems, &plan);
    plan.cpu =
        clock_thread_cpu() - begin + 1e-9 * (double)(atomic_load(&job->cpu_ns) - helpers_begin);
    if (status == AMB_OK) {
        set_parameters(scene, params, &plan);
        plan_scatter(scene, params, &plan);
        plan_glow(scene, params, &plan);
        describe_objects(scene, &plan);
        *out_plan = plan;
    } else {
        plan_clear(&plan);
    }
    return status;
}

void plan_clear(Plan *plan) {
    memory_free(plan->objects);
    memory_free(plan->targets);
    memset(plan, 0, sizeof *plan);
}
