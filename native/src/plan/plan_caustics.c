/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that comes to opaque surfaces by way of translucent objects. */
#include "plan/plan_caustics.h"

#include "plan/light_probe.h"
#include "plan/plan_scatter.h"
#include "plan/scene_rules.h"

/* One light ray for caustics for so many volume samples: for a million of them a map is finer than
 * most pictures' pixels. */
static const uint64_t SAMPLES_PER_CAUSTIC_RAY = 4;
/* Photons that overlap a point of a surface, in units of kernel_size: fewer leave the pattern of
 * the light rays where light is even, more blur where it is focused
 * (tests/bench/bench_caustics.py). */
static const float CAUSTIC_OVERLAP = 2.0f;
/* Caustics are left out where less than this share of the light that arrives at translucent objects
 * lands on opaque surfaces, and so are reflections inside. */
static const double CAUSTIC_SHARE_MIN = 2e-3;
enum { PROBE_RAYS = 8192 };

PlanEffect plan_light_on_surfaces(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "light through objects onto opaque surfaces";
    if ((params->effects & AMB_EFFECT_CAUSTICS) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_boundary(scene))
        return plan_skipped(name, "no translucent object");
    if (!scene_has_opaque_surface(scene))
        return plan_skipped(name, "no opaque surface");
    const bool interreflects = (params->effects & AMB_EFFECT_INTERREFLECTION) != 0;
    if (!scene_has_lamp(scene) && scene->world.is_black && !interreflects)
        return plan_skipped(name, "no lamp, and the world is black");
    return plan_simulated(name, "a translucent object is there and an opaque surface");
}

PlanEffect plan_caustics(const AmbScene *scene, const AmbRenderParams *params, const Plan *plan) {
    const char *name = "caustics on opaque surfaces";
    if (!plan->effects[PLAN_LIGHT_ON_SURFACES].is_simulated)
        return plan_skipped(name, "no light through objects onto opaque surfaces");
    if (!scene_has_lamp(scene))
        return plan_skipped(name, "no lamp");
    if (!scene_has_refraction(scene))
        return plan_skipped(name, "no boundary refracts: every ior is 1");
    PlanEffect effect = plan_simulated(name, "light lands there, by probe rays");
    effect.count = params->light_bounces;
    return effect;
}

/* Watts, of probe rays. */
typedef struct Landing {
    double incident;                       /* at translucent objects */
    double landed[LIGHT_BOUNCES_MOST + 1]; /* after so many reflections at most */
} Landing;

static AmbStatus probe_landing(const AmbScene *scene, const AmbRenderParams *params,
                               uint32_t bounces, Job *job, Landing *out_landing) {
    const LightTraceParams probe = {.ray_count = PROBE_RAYS,
                                    .bounces = bounces,
                                    .follows_through = true,
                                    .lands = true,
                                    .seed = params->seed};
    LightField light;
    AMB_TRY(light_trace(scene, &probe, job, &light));
    *out_landing = (Landing){.incident = light.tally.incident[0] + light.tally.incident[1] +
                                         light.tally.incident[2]};
    double *landed = out_landing->landed;
    for (uint64_t i = 0; i < light.landing_count; ++i) {
        const LightLanding *landing = &light.landings[i];
        const uint32_t after =
            landing->bounces < LIGHT_BOUNCES_MOST ? landing->bounces : LIGHT_BOUNCES_MOST;
        landed[after] += 3.0 * (double)rgb_mean(landing->flux);
    }
    for (uint32_t i = 1; i <= LIGHT_BOUNCES_MOST; ++i)
        landed[i] += landed[i - 1];
    light_field_clear(&light);
    return AMB_OK;
}

/* The fewest reflections that land all but so little of the light. */
static uint32_t choose_bounces(const Landing *landing) {
    for (uint32_t i = 0; i < LIGHT_STEP_COUNT; ++i)
        if (landing->landed[LIGHT_BOUNCES_MOST] - landing->landed[BOUNCE_STEPS[i]] <=
            CAUSTIC_SHARE_MIN * landing->incident)
            return BOUNCE_STEPS[i];
    return LIGHT_BOUNCES_MOST;
}

AmbStatus plan_measure_caustics(const AmbScene *scene, const AmbRenderParams *params, Job *job,
                                Plan *plan) {
    PlanEffect *effect = &plan->effects[PLAN_CAUSTICS];
    if (!effect->is_simulated)
        return AMB_OK;
    Landing landing;
    AMB_TRY(probe_landing(scene, params, plan->is_automatic ? LIGHT_BOUNCES_MOST : effect->count,
                          job, &landing));
    if (plan->is_automatic)
        effect->count = choose_bounces(&landing);
    const uint32_t last = effect->count < LIGHT_BOUNCES_MOST ? effect->count : LIGHT_BOUNCES_MOST;
    if (!(landing.landed[last] >
          (plan->is_automatic ? CAUSTIC_SHARE_MIN * landing.incident : 0.0))) {
        *effect = plan_skipped(effect->name, "less than 0.2 % of the light at translucent objects "
                                             "lands there, by probe rays");
        return AMB_OK;
    }
    plan->caustics =
        (CausticParams){.light = {.ray_count = params->light_samples / SAMPLES_PER_CAUSTIC_RAY + 1,
                                  .bounces = effect->count,
                                  .follows_through = true,
                                  .adjoint_normals = params->adjoint_normals != 0,
                                  .lands = true,
                                  .seed = params->seed},
                        .overlap = CAUSTIC_OVERLAP * params->kernel_size};
    return AMB_OK;
}

void plan_glow(const AmbScene *scene, const AmbRenderParams *params, Plan *plan) {
    const uint32_t orders =
        plan->camera.effects & (AMB_EFFECT_SINGLE_SCATTERING | AMB_EFFECT_DOUBLE_SCATTERING |
                                AMB_EFFECT_MULTIPLE_SCATTERING);
    /* Walks have no variance to speak of where the surroundings are even; cells have their light
     * and that of lamps in one sum. */
    const bool has_world =
        plan->scatter.has_world && plan->scatter_estimator == AMB_SCATTER_PHOTONS;
    if (!plan->effects[PLAN_LIGHT_ON_SURFACES].is_simulated || orders == 0 ||
        params->scatter_estimator == AMB_SCATTER_TREE_CUT || !(scene_has_lamp(scene) || has_world))
        return;
    plan->caustics.glow = plan->scatter;
    plan->caustics.glow.photon_count = params->light_samples / SAMPLES_PER_CAUSTIC_RAY + 1;
    plan->caustics.glow.order_max = plan_last_order(params, plan);
    plan->caustics.glow.has_world = has_world;
    plan->caustics.glow.interreflects = has_world && plan->scatter.interreflects;
    plan->caustics.glow.returns = has_world && plan->scatter.returns;
    /* Photons for cells land as well. A target asks for numbers of either kind. */
    const ScatterParams *cells = &plan->scatter;
    if (plan->scatter_estimator == AMB_SCATTER_PHOTONS && !(params->accuracy > 0.0f) &&
        cells->order_max == plan->caustics.glow.order_max && cells->has_world == has_world)
        plan->scatter.landing_part = (float)fmin(
            (double)plan->caustics.glow.photon_count / (double)cells->photon_count, 1.0);
    plan->camera.glow = orders | (has_world ? (uint32_t)AMB_EFFECT_WORLD_LIGHT : 0u);
}
