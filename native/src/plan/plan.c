/* SPDX-License-Identifier: GPL-3.0-or-later
 * What is worth simulating. */
#include "plan/plan.h"

#include "field/tubes/tube_source.h"
#include "plan/plan_scatter.h"

/* Volume samples along one light ray, on average. More of them follow a caustic more closely and
 * make tighter boxes, fewer leave more rays for the same memory. */
static const uint64_t SAMPLES_PER_RAY = 8;

/* Light rays for caustics, in volume samples: a map of a million samples' rays is finer than a
 * pixel of most pictures. */
static const uint64_t SAMPLES_PER_CAUSTIC_RAY = 4;
/* Photons that overlap a point of a surface, in units of kernel_size. */
static const float CAUSTIC_OVERLAP = 4.0f;
/* Fewer than these are no picture to speak of. */
static const uint64_t LIGHT_SAMPLES_MIN = 4096, LIGHT_RAYS_MIN = 1024;

const char *plan_estimator_name(uint32_t estimator) {
    static const char *const names[] = {"AUTO", "POINTS_FIXED", "POINTS_COVARIANCE", "TUBES",
                                        "SPECULAR"};
    return estimator < sizeof names / sizeof names[0] ? names[estimator] : "UNKNOWN";
}

AmbStatus plan_check(const AmbRenderParams *params) {
    if (params->estimator > AMB_ESTIMATOR_SPECULAR)
        return status_fail(AMB_UNSUPPORTED, "estimator %s is not available in this version",
                           plan_estimator_name(params->estimator));
    if (params->scatter_estimator > AMB_SCATTER_PHOTONS)
        return status_fail(AMB_UNSUPPORTED, "scatter estimator %s is not available in this version",
                           plan_scatter_estimator_name(params->scatter_estimator));
    return AMB_OK;
}

static PlanEffect simulated(const char *name, const char *reason) {
    return (PlanEffect){name, true, reason};
}

static PlanEffect skipped(const char *name, const char *reason) {
    return (PlanEffect){name, false, reason};
}

static bool has_boundary(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary)
            return true;
    return false;
}

static bool has_refraction(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary && scene->materials[scene->objects[o].inside].ior != 1.0f)
            return true;
    return false;
}

static bool has_scattering(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary &&
            medium_scatters(&scene->materials[scene->objects[o].inside].medium))
            return true;
    return false;
}

static bool has_light(const AmbScene *scene) {
    for (uint32_t l = 0; l < scene->light_count; ++l)
        if (rgb_max(scene->lights[l].color) > 0.0f)
            return true;
    return false;
}

static PlanEffect plan_single(const AmbScene *scene, const AmbRenderParams *params,
                              bool has_world) {
    const char *name = "single scattering";
    if ((params->effects & AMB_EFFECT_SINGLE_SCATTERING) == 0)
        return skipped(name, "switched off");
    if (!has_scattering(scene))
        return skipped(name, "no medium scatters");
    if (has_light(scene))
        return simulated(name, "a medium scatters the light of a lamp");
    if (has_world)
        return simulated(name, "a medium scatters the light of its surroundings");
    return skipped(name, "no lamp");
}

/* Light of later orders: from lamps, or from the surroundings. */
static PlanEffect plan_later_order(const AmbScene *scene, const AmbRenderParams *params,
                                   const char *name, uint32_t order, uint32_t effect,
                                   bool has_world) {
    if ((params->effects & effect) == 0)
        return skipped(name, "switched off");
    if (params->scatter_order_max > 0 && params->scatter_order_max < order)
        return skipped(name, "scatter_order_max set");
    if (!has_scattering(scene))
        return skipped(name, "no medium scatters");
    if (!has_light(scene) && !has_world)
        return skipped(name, "no light");
    return simulated(name, "a medium scatters light");
}

static PlanEffect plan_bounces(const AmbScene *scene, const char *name, uint32_t bounces,
                               bool is_single_simulated) {
    if (bounces == 0)
        return skipped(name, "0 bounces set");
    if (!is_single_simulated)
        return skipped(name, "nothing scatters");
    if (!has_refraction(scene))
        return skipped(name, "no boundary reflects: every ior is 1");
    return simulated(name, "bounces set and a boundary reflects");
}

static PlanEffect plan_surface(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "surface reflection";
    if ((params->effects & AMB_EFFECT_SURFACE_REFLECTION) == 0)
        return skipped(name, "switched off");
    if (!has_refraction(scene))
        return skipped(name, "no boundary reflects: every ior is 1");
    return simulated(name, "a boundary reflects");
}

static PlanEffect plan_background(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "background through objects";
    if ((params->effects & AMB_EFFECT_BACKGROUND) == 0)
        return skipped(name, "switched off");
    if (!has_boundary(scene))
        return skipped(name, "no translucent object");
    return simulated(name, "a translucent object is there");
}

/* Whether the bounding sphere of a translucent object reaches where camera rays begin: within the
 * near plane's part of the view, or for an orthographic camera the window pushed to it. */
static bool may_start_inside(const AmbScene *scene) {
    const SceneCamera *camera = &scene->camera;
    const float *w = camera->window;
    const float x = fmaxf(fabsf(w[0]), fabsf(w[1])), y = fmaxf(fabsf(w[2]), fabsf(w[3]));
    const float start = camera->clip_start;
    float reach = camera->kind == AMB_CAMERA_ORTHOGRAPHIC ? sqrtf(x * x + y * y + start * start)
                                                          : start * sqrtf(1.0f + x * x + y * y);
    reach += camera->lens_radius;
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const SceneObject *object = &scene->objects[o];
        const float distance = vec3_length(vec3_sub(object->center, camera->position));
        if (object->is_boundary && !(distance > object->radius + reach))
            return true;
    }
    return false;
}

/* What a few light rays tell before the render. */
typedef struct LightProbe {
    double flux; /* W, all channels, that media absorb or scatter of light that enters directly */
    double flux_through; /* the same with light through other objects */
    bool is_irregular;   /* one ray in a thousand or more found a mesh open or crossing itself */
    bool is_nested;      /* as many found an object inside of another, or touching it */
} LightProbe;

enum { PROBE_RAYS = 8192, PROBE_IRREGULAR_MAX = PROBE_RAYS / 1000 };
/* Light through other objects is left out where it adds less than this share. */
static const double TRANSMITTED_SHARE_MIN = 2e-3;

static AmbStatus probe_light(const AmbScene *scene, const AmbRenderParams *params, Job *job,
                             LightProbe *out_probe) {
    for (int follows_through = 0; follows_through < 2; ++follows_through) {
        const LightTraceParams probe = {
            .ray_count = PROBE_RAYS, .follows_through = follows_through == 1, .seed = params->seed};
        LightField field;
        AMB_TRY(light_trace(scene, &probe, job, &field));
        const double *flux = field.tally.interacting;
        *(follows_through ? &out_probe->flux_through : &out_probe->flux) =
            flux[0] + flux[1] + flux[2];
        out_probe->is_irregular = field.leak_count + field.irregular_count > PROBE_IRREGULAR_MAX;
        out_probe->is_nested = field.nested_count > PROBE_IRREGULAR_MAX;
        light_field_clear(&field);
    }
    return AMB_OK;
}

static PlanEffect plan_transmitted(const AmbRenderParams *params, bool is_single_simulated,
                                   const LightProbe *probe) {
    const char *name = "light through other objects";
    if ((params->effects & AMB_EFFECT_TRANSMITTED_LIGHT) == 0)
        return skipped(name, "switched off");
    if (!is_single_simulated)
        return skipped(name, "nothing scatters");
    if (!(probe->flux_through - probe->flux > TRANSMITTED_SHARE_MIN * probe->flux_through))
        return skipped(name, "adds less than 0.2 % of the light in media, by probe rays");
    return simulated(name, "it adds to the light in media, by probe rays");
}

static bool is_opaque(const AmbScene *scene, const SceneObject *object, uint32_t slot) {
    const uint32_t last = object->material_count - 1;
    const uint32_t material = object->materials[slot < last ? slot : last];
    return scene->materials[material].surface == AMB_SURFACE_DIFFUSE;
}

static bool has_opaque_surface(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const SceneObject *object = &scene->objects[o];
        const SceneMesh *mesh = &scene->meshes[object->mesh];
        const uint64_t looked_at = mesh->slots != NULL ? mesh->triangle_count : 1;
        for (uint64_t i = 0; i < looked_at; ++i)
            if (is_opaque(scene, object, mesh->slots != NULL ? mesh->slots[i] : 0))
                return true;
    }
    return false;
}

static PlanEffect plan_light_on_surfaces(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "light through objects onto opaque surfaces";
    if ((params->effects & AMB_EFFECT_CAUSTICS) == 0)
        return skipped(name, "switched off");
    if (!has_boundary(scene))
        return skipped(name, "no translucent object");
    if (!has_opaque_surface(scene))
        return skipped(name, "no opaque surface");
    if (!has_light(scene) && scene->world.is_black)
        return skipped(name, "no lamp, and the world is black");
    return simulated(name, "a translucent object is there and an opaque surface");
}

/* Caustics are left out where less than this share of the light that arrives at translucent objects
 * lands on opaque surfaces. */
static const double CAUSTIC_SHARE_MIN = 2e-3;

static AmbStatus plan_caustics(const AmbScene *scene, const AmbRenderParams *params, Job *job,
                               bool is_lit_through, PlanEffect *out_effect) {
    const char *name = "caustics on opaque surfaces";
    if (!is_lit_through)
        *out_effect = skipped(name, "no light through objects onto opaque surfaces");
    else if (!has_light(scene))
        *out_effect = skipped(name, "no lamp");
    else if (!has_refraction(scene))
        *out_effect = skipped(name, "no boundary refracts: every ior is 1");
    else {
        const LightTraceParams probe = {.ray_count = PROBE_RAYS,
                                        .bounces = params->light_bounces,
                                        .follows_through = true,
                                        .lands = true,
                                        .seed = params->seed};
        LightField light;
        AMB_TRY(light_trace(scene, &probe, job, &light));
        const LightTally *tally = &light.tally;
        const double landed = tally->landed[0] + tally->landed[1] + tally->landed[2];
        const double incident = tally->incident[0] + tally->incident[1] + tally->incident[2];
        light_field_clear(&light);
        *out_effect = landed > CAUSTIC_SHARE_MIN * incident
                          ? simulated(name, "light lands there, by probe rays")
                          : skipped(name, "less than 0.2 % of the light at translucent objects "
                                          "lands there, by probe rays");
    }
    return AMB_OK;
}

static PlanEffect plan_world(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "light of the surroundings in media";
    if ((params->effects & AMB_EFFECT_WORLD_LIGHT) == 0)
        return skipped(name, "switched off");
    if (scene->world.is_black && !has_opaque_surface(scene))
        return skipped(name, "the world is black and no surface is opaque");
    if (!has_scattering(scene))
        return skipped(name, "no medium scatters");
    return simulated(name, "a medium scatters, and there are surroundings");
}

/* What TUBES and SPECULAR cannot do: both refract each light at the mesh's own triangles. */
typedef struct Obstacle {
    const char *reason; /* one phrase, static storage; NULL: there is none */
    const char *name;   /* of what stands in the way, "" for nothing in particular */
} Obstacle;

enum {
    NESTING_PROBES = 64,
    TUBE_BOUNCES_AUTO = 2 /* most internal reflections of the light for which AUTO takes tubes */
};

/* Every cell of a lamp is gathered by itself, and reflects by itself: AUTO leaves lamps to points
 * that come to more cells than this together, 0 .. TUBE_BOUNCES_AUTO reflections. */
static const uint32_t AUTO_CELLS_MAX[TUBE_BOUNCES_AUTO + 1] = {16, 4, 1};

/* Cells of a lamp with an extent, for the object that sees it largest; 0 for a point. */
static uint32_t count_cells(const AmbScene *scene, const SceneLight *light) {
    uint32_t most = 0;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary) {
            const uint32_t cells = tube_source_cells(light, &scene->objects[o]);
            most = cells > most ? cells : most;
        }
    return most * most;
}

static Obstacle light_obstacle(const AmbScene *scene, uint32_t estimator, uint32_t bounces) {
    uint32_t cells = 0;
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const SceneLight *light = &scene->lights[l];
        if (!(rgb_max(light->color) > 0.0f))
            continue;
        const bool has_extent =
            light->kind == AMB_LIGHT_AREA || light->radius > 0.0f || light->angle > 0.0f;
        if (estimator == AMB_ESTIMATOR_SPECULAR && has_extent)
            return (Obstacle){"a lamp has an extent", light->name};
        if (estimator == AMB_ESTIMATOR_AUTO && has_extent && bounces <= TUBE_BOUNCES_AUTO) {
            cells += count_cells(scene, light);
            if (cells > AUTO_CELLS_MAX[bounces])
                return (Obstacle){"a lamp is large, seen from an object", light->name};
        }
        if (light->kind != AMB_LIGHT_SUN && scene_media_at(scene, light->position).count > 0)
            return (Obstacle){"a lamp is inside a translucent object", light->name};
    }
    return (Obstacle){NULL, ""};
}

static bool may_touch(const SceneObject *a, const SceneObject *b) {
    return vec3_length(vec3_sub(a->center, b->center)) < a->radius + b->radius;
}

/* Whether vertices of object o, some of them, are inside of another one. */
static bool is_nested(const AmbScene *scene, uint32_t o) {
    const SceneObject *object = &scene->objects[o];
    bool may_be = false;
    for (uint32_t other = 0; other < scene->object_count; ++other)
        may_be = may_be || (other != o && scene->objects[other].is_boundary &&
                            may_touch(object, &scene->objects[other]));
    const SceneMesh *mesh = &scene->meshes[object->mesh];
    if (!may_be || mesh->triangle_count == 0)
        return false;
    for (uint64_t i = 0; i < NESTING_PROBES; ++i) {
        const uint64_t triangle = i * mesh->triangle_count / NESTING_PROBES;
        const MediumStack media =
            scene_media_at(scene, object->positions[mesh->triangles[3 * triangle]]);
        for (uint32_t k = 0; k < media.count; ++k)
            if (media.objects[k] != o)
                return true;
    }
    return false;
}

static Obstacle triangles_obstacle(const AmbScene *scene, uint32_t estimator, uint32_t bounces) {
    if (estimator == AMB_ESTIMATOR_SPECULAR && bounces > 0)
        return (Obstacle){"light_bounces is not 0", ""};
    const Obstacle obstacle = light_obstacle(scene, estimator, bounces);
    if (obstacle.reason != NULL)
        return obstacle;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary && is_nested(scene, o))
            return (Obstacle){"translucent objects are inside one another", scene->objects[o].name};
    return (Obstacle){NULL, ""};
}

/* Resolves AUTO, and refuses what was asked for by name and cannot be. */
static AmbStatus plan_estimator(const AmbScene *scene, const AmbRenderParams *params,
                                const LightProbe *probe, Plan *plan) {
    plan->estimator = params->estimator;
    plan->estimator_reason = "asked for";
    if (!plan->has_field) {
        if (plan->estimator == AMB_ESTIMATOR_AUTO)
            plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "nothing scatters";
        return AMB_OK;
    }
    if (plan->estimator == AMB_ESTIMATOR_POINTS_FIXED ||
        plan->estimator == AMB_ESTIMATOR_POINTS_COVARIANCE)
        return AMB_OK;
    const uint32_t bounces =
        plan->effects[PLAN_LIGHT_BOUNCES].is_simulated ? params->light_bounces : 0;
    const Obstacle obstacle = triangles_obstacle(scene, plan->estimator, bounces);
    if (plan->estimator != AMB_ESTIMATOR_AUTO) {
        PlanEffect *transmitted = &plan->effects[PLAN_TRANSMITTED_LIGHT];
        if (transmitted->is_simulated)
            *transmitted = skipped(transmitted->name, "its light ends where it leaves its object");
        if (obstacle.reason == NULL)
            return AMB_OK;
        const bool is_named = obstacle.name[0] != '\0';
        return status_fail(AMB_UNSUPPORTED, "estimator %s cannot render this: %s%s%.60s%s",
                           plan_estimator_name(plan->estimator), obstacle.reason,
                           is_named ? " (\"" : "", obstacle.name, is_named ? "\")" : "");
    }
    plan->estimator = AMB_ESTIMATOR_TUBES;
    plan->estimator_reason = "lamps that are not large, outside of all objects";
    if (obstacle.reason != NULL) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = obstacle.reason;
    } else if (probe->is_irregular) {
        /* Tubes end at the first face that they meet; points know what they are inside of. */
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "a mesh is open or crosses itself";
    } else if (probe->is_nested) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "translucent objects overlap or touch, by probe rays";
    } else if (bounces > TUBE_BOUNCES_AUTO) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "light_bounces is more than 2: tubes would spread over everything";
    } else if (plan->effects[PLAN_TRANSMITTED_LIGHT].is_simulated) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "light through other objects is simulated";
    }
    return AMB_OK;
}

void plan_set_light_samples(Plan *plan, uint64_t samples) {
    const uint64_t rays = samples / SAMPLES_PER_RAY;
    plan->light.ray_count = rays > 0 ? rays : 1;
    plan->field.sample_target = samples;
}

bool plan_reduce_caustics(Plan *plan) {
    if (plan->caustics.light.ray_count < 4 * LIGHT_RAYS_MIN)
        return false;
    plan->caustics.light.ray_count /= 4;
    return true;
}

bool plan_reduce_field(Plan *plan) {
    if (plan->estimator == AMB_ESTIMATOR_TUBES && plan->field.tube_refinement > 0) {
        --plan->field.tube_refinement;
        return true;
    }
    const bool is_points = plan->estimator == AMB_ESTIMATOR_POINTS_FIXED ||
                           plan->estimator == AMB_ESTIMATOR_POINTS_COVARIANCE;
    if (!is_points || plan->field.sample_target < 4 * LIGHT_SAMPLES_MIN)
        return false;
    plan_set_light_samples(plan, plan->field.sample_target / 4);
    return true;
}

AmbStatus plan_create(const AmbScene *scene, const AmbRenderParams *params, Job *job,
                      Plan *out_plan) {
    Plan plan = {.estimator = params->estimator};
    PlanEffect *effects = plan.effects;
    effects[PLAN_WORLD_LIGHT] = plan_world(scene, params);
    const bool has_world = effects[PLAN_WORLD_LIGHT].is_simulated;
    effects[PLAN_SINGLE_SCATTERING] = plan_single(scene, params, has_world);
    effects[PLAN_DOUBLE_SCATTERING] = plan_later_order(scene, params, "double scattering", 2,
                                                       AMB_EFFECT_DOUBLE_SCATTERING, has_world);
    effects[PLAN_MULTIPLE_SCATTERING] = plan_later_order(scene, params, "multiple scattering", 3,
                                                         AMB_EFFECT_MULTIPLE_SCATTERING, has_world);
    plan.has_field = has_light(scene) && (effects[PLAN_SINGLE_SCATTERING].is_simulated ||
                                          effects[PLAN_DOUBLE_SCATTERING].is_simulated ||
                                          effects[PLAN_MULTIPLE_SCATTERING].is_simulated);
    effects[PLAN_LIGHT_BOUNCES] = plan_bounces(scene, "light-side internal reflection",
                                               params->light_bounces, plan.has_field);
    /* On the camera side they also show the background again, so a boundary is reason enough. */
    effects[PLAN_CAMERA_BOUNCES] =
        plan_bounces(scene, "camera-side internal reflection", params->camera_bounces,
                     plan.has_field || (params->effects & AMB_EFFECT_BACKGROUND) != 0);
    effects[PLAN_SURFACE_REFLECTION] = plan_surface(scene, params);
    effects[PLAN_BACKGROUND] = plan_background(scene, params);
    LightProbe probe = {.is_irregular = false};
    if (plan.has_field)
        AMB_TRY(probe_light(scene, params, job, &probe));
    effects[PLAN_TRANSMITTED_LIGHT] = plan_transmitted(params, plan.has_field, &probe);
    effects[PLAN_LIGHT_ON_SURFACES] = plan_light_on_surfaces(scene, params);
    const bool is_lit_through = effects[PLAN_LIGHT_ON_SURFACES].is_simulated;
    AMB_TRY(plan_caustics(scene, params, job, is_lit_through, &effects[PLAN_CAUSTICS]));
    AMB_TRY(plan_estimator(scene, params, &probe, &plan));

    plan.light = (LightTraceParams){
        .bounces = effects[PLAN_LIGHT_BOUNCES].is_simulated ? params->light_bounces : 0,
        .follows_through = effects[PLAN_TRANSMITTED_LIGHT].is_simulated,
        .adjoint_normals = params->adjoint_normals != 0,
        .seed = params->seed};
    plan.field = (FieldParams){.estimator = plan.estimator,
                               .kernel_size = params->kernel_size,
                               .tube_refinement = params->tube_refinement,
                               .light_bounces = plan.light.bounces,
                               .adjoint_normals = params->adjoint_normals != 0};

    plan_set_light_samples(&plan, params->light_samples);
    if (effects[PLAN_CAUSTICS].is_simulated)
        plan.caustics = (CausticParams){
            .light = {.ray_count = params->light_samples / SAMPLES_PER_CAUSTIC_RAY + 1,
                      .bounces = params->light_bounces,
                      .follows_through = true,
                      .adjoint_normals = params->adjoint_normals != 0,
                      .lands = true,
                      .seed = params->seed},
            .overlap = CAUSTIC_OVERLAP * params->kernel_size};
    plan_scatter(scene, params, &plan);

    static const struct {
        uint32_t effect, bit;
    } on_camera[] = {{PLAN_SINGLE_SCATTERING, AMB_EFFECT_SINGLE_SCATTERING},
                     {PLAN_DOUBLE_SCATTERING, AMB_EFFECT_DOUBLE_SCATTERING},
                     {PLAN_MULTIPLE_SCATTERING, AMB_EFFECT_MULTIPLE_SCATTERING},
                     {PLAN_WORLD_LIGHT, AMB_EFFECT_WORLD_LIGHT},
                     {PLAN_SURFACE_REFLECTION, AMB_EFFECT_SURFACE_REFLECTION},
                     {PLAN_BACKGROUND, AMB_EFFECT_BACKGROUND}};
    uint32_t camera_effects = 0;
    for (size_t i = 0; i < sizeof on_camera / sizeof on_camera[0]; ++i)
        if (effects[on_camera[i].effect].is_simulated)
            camera_effects |= on_camera[i].bit;
    plan.camera = (CameraParams){
        .width = params->width,
        .height = params->height,
        .effects = camera_effects,
        .bounces = effects[PLAN_CAMERA_BOUNCES].is_simulated ? params->camera_bounces : 0,
        .order_max = params->scatter_order_max,
        .seed = params->seed,
        .shines_through = is_lit_through,
        .film_transparent = params->film_transparent != 0,
        .may_start_inside = may_start_inside(scene),
        .replicas = params->accuracy > 0.0f ? 2 : 1};
    *out_plan = plan;
    return AMB_OK;
}
