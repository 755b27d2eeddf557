/* SPDX-License-Identifier: GPL-3.0-or-later
 * Which estimator renders the light that scatters once. */
#include "plan/plan_estimator.h"

#include "field/tubes/tube_source.h"
#include "plan/scene_rules.h"

/* What TUBES and SPECULAR cannot do: both refract each light at the mesh's own triangles. */
typedef struct Obstacle {
    const char *reason; /* one phrase, static storage; NULL: there is none */
    const char *name;   /* of what stands in the way, "" for nothing in particular */
} Obstacle;

enum {
    NESTING_PROBES = 64,
    TUBE_BOUNCES_MAX = 2 /* more internal reflections of the light are not left to tubes alone */
};

/* Every cell of a lamp is gathered by itself, and reflects by itself: AUTO leaves lamps to points
 * that come to more cells than this together, 0 .. TUBE_BOUNCES_MAX reflections by tubes. */
static const uint32_t AUTO_CELLS_MAX[TUBE_BOUNCES_MAX + 1] = {16, 4, 1};

/* Of the light's internal reflections, those that tubes follow; points carry the rest. Each one
 * multiplies and widens tubes, at bumpy walls most of all: where there are points and the count
 * comes from what shows, or walls trap the light or strew it, points are the cheaper ones from the
 * first on; where walls strew the light, they are worth having for one reflection.
 * Asked for by hand, reflections may be all that a picture is about. */
static uint32_t tube_bounces(const MeshProblems *problems, const Plan *plan) {
    const uint32_t bounces = plan->effects[PLAN_LIGHT_BOUNCES].count;
    const bool has_points =
        bounces > TUBE_BOUNCES_MAX || plan->effects[PLAN_TRANSMITTED_LIGHT].is_simulated;
    if (has_points && (plan->is_automatic || problems->is_trapped))
        return 0;
    if (problems->is_strewn && (plan->is_automatic || has_points))
        return 0;
    return bounces <= TUBE_BOUNCES_MAX ? bounces : TUBE_BOUNCES_MAX;
}

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

/* Beside tubes points carry the light of meshes, fewer of them and with wider kernels than alone:
 * AUTO leaves more than this share of the light to points altogether. */
static const float MESH_SHARE_MAX = 0.1f;

static bool is_lit_by_meshes(const AmbScene *scene) {
    float all = 0.0f, meshes = 0.0f;
    for (uint32_t l = 0; l < scene->light_count; ++l)
        for (uint32_t o = 0; o < scene->object_count; ++o) {
            const SceneLight *light = &scene->lights[l];
            const LightEmission emission = {.light = light,
                                            .target = scene->objects[o].center,
                                            .target_radius = scene->objects[o].radius,
                                            .count = 1};
            const float power =
                scene_object_scatters(scene, o) ? light_power_towards(&emission) : 0.0f;
            all += power;
            meshes += light->kind == LIGHT_MESH ? power : 0.0f;
        }
    return meshes > MESH_SHARE_MAX * all;
}

static Obstacle light_obstacle(const AmbScene *scene, uint32_t estimator, uint32_t bounces) {
    uint32_t cells = 0;
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const SceneLight *light = &scene->lights[l];
        if (!(rgb_max(light->color) > 0.0f))
            continue;
        const bool has_extent =
            light->kind == AMB_LIGHT_AREA || light->radius > 0.0f || light->angle > 0.0f;
        if (estimator == AMB_ESTIMATOR_SPECULAR && (has_extent || light->kind == LIGHT_MESH))
            return (Obstacle){"a lamp has an extent", light->name};
        if (light->kind == LIGHT_MESH) {
            if (estimator == AMB_ESTIMATOR_AUTO && is_lit_by_meshes(scene))
                return (Obstacle){"much of the light is that of a mesh", light->name};
            continue;
        }
        if (estimator == AMB_ESTIMATOR_AUTO && has_extent) {
            cells += count_cells(scene, light);
            if (cells > AUTO_CELLS_MAX[bounces])
                return (Obstacle){"a lamp is large, seen from an object", light->name};
        }
        if (light->kind != AMB_LIGHT_SUN && scene_media_at(scene, light->position).count > 0)
            return (Obstacle){"a lamp is inside a translucent object", light->name};
    }
    return (Obstacle){NULL, ""};
}

/* Whether vertices of object o, some of them, are inside of another one, or its faces lie on that.
 */
static bool is_nested(const AmbScene *scene, uint32_t o) {
    const SceneObject *object = &scene->objects[o];
    bool may_be = false;
    for (uint32_t other = 0; other < scene->object_count; ++other)
        may_be = may_be || (other != o && scene->objects[other].is_boundary &&
                            scene_may_touch(object, &scene->objects[other]));
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
        const Hit middle = {0.0f, 1.0f / 3.0f, 1.0f / 3.0f, o, (uint32_t)triangle};
        const SurfacePoint surface = scene_surface(scene, &middle);
        /* A face without area has no normal to look along. */
        if (vec3_is_finite(surface.ng) && boundary_is_touched(scene, &surface))
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
            return (Obstacle){"translucent objects are inside one another or touch",
                              scene->objects[o].name};
    return (Obstacle){NULL, ""};
}

/* Where light is totally reflected outside, tubes beside the critical angle are cut to the last: a
 * gather through them takes hundreds of times what points take (bench_planner.py). */
static bool has_low_index(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene_object_scatters(scene, o) &&
            scene->materials[scene->objects[o].inside].ior < 1.0f)
            return true;
    return false;
}

AmbStatus plan_estimator(const AmbScene *scene, const AmbRenderParams *params,
                         const MeshProblems *problems, Plan *plan) {
    plan->estimator = params->estimator;
    plan->estimator_reason = "asked for";
    if (!plan->has_field) {
        if (plan->estimator == AMB_ESTIMATOR_AUTO)
            plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = plan->is_dark ? "no lamp lights an object" : "nothing scatters";
        return AMB_OK;
    }
    if (plan->estimator == AMB_ESTIMATOR_POINTS_FIXED ||
        plan->estimator == AMB_ESTIMATOR_POINTS_COVARIANCE)
        return AMB_OK;
    const uint32_t bounces = plan->effects[PLAN_LIGHT_BOUNCES].count;
    plan->tube_bounces = tube_bounces(problems, plan);
    const Obstacle obstacle = triangles_obstacle(
        scene, plan->estimator,
        plan->estimator == AMB_ESTIMATOR_SPECULAR ? bounces : plan->tube_bounces);
    if (plan->estimator != AMB_ESTIMATOR_AUTO) {
        PlanEffect *transmitted = &plan->effects[PLAN_TRANSMITTED_LIGHT];
        if (transmitted->is_simulated && plan->estimator == AMB_ESTIMATOR_SPECULAR) {
            transmitted->is_simulated = false;
            transmitted->reason = "with this estimator light ends where it leaves its object";
        }
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
    } else if (problems->is_irregular) {
        /* Tubes end at the first face that they meet; points know what they are inside of. */
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "a mesh is open or crosses itself";
    } else if (problems->is_nested) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "translucent objects overlap or touch, by probe rays";
    } else if (has_low_index(scene)) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "an index is below 1: tubes are cut finely at the critical angle";
    } else if (plan->effects[PLAN_TRANSMITTED_LIGHT].is_simulated && problems->is_veiled) {
        plan->estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
        plan->estimator_reason = "much of the light comes through other objects";
    }
    return AMB_OK;
}
