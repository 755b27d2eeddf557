/* SPDX-License-Identifier: GPL-3.0-or-later
 * Choosing the meshes that shine as lamps. */
#include "scene/mesh_lamps.h"

#include <stdlib.h>
#include <string.h>

#include "amberlight/amberlight.h"
#include "base/memory.h"
#include "math/vec3d.h"

/* What a path from somewhere near finds by chance of a mesh has, relative to all light there, the
 * noise share sqrt(1/p - 1), p the mesh's part of the hemisphere. Meshes with less are left to
 * chance: large dim ones. */
static const double NOISE_MIN = 0.05;
/* Less of the light at every other object is of no matter, and neither is its noise. */
static const double SHARE_MIN = 1e-4;
/* Sums of products of radiance, area and solid angle stay numbers between these. */
static const double POWER_MIN = 1e-30, POWER_MAX = 1e30;
/* Pairs of meshes, or lights, and objects that are looked at: beyond, every so many an object. */
enum { PAIRS_MAX = 1 << 22 };

typedef struct Candidate {
    uint32_t object;
    uint64_t triangle_count;
    double area, power; /* power: area times mean radiance */
    Vec3 low, high;
    double noise; /* the largest at any object; 0: no lamp */
} Candidate;

typedef struct Candidates {
    Candidate *all;
    uint32_t count;
} Candidates;

static Rgb emission_of(const AmbScene *scene, const SceneObject *object, uint64_t triangle) {
    const SceneMaterial *material = scene_material(scene, object, triangle);
    return material->surface == AMB_SURFACE_DIFFUSE ? material->emission : rgb(0, 0, 0);
}

static LightTriangle triangle_of(const AmbScene *scene, const SceneObject *object,
                                 uint64_t triangle) {
    const uint32_t *i = scene->meshes[object->mesh].triangles + 3 * triangle;
    const Vec3 p = object->positions[i[0]];
    return (LightTriangle){.p = p,
                           .e1 = vec3_sub(object->positions[i[1]], p),
                           .e2 = vec3_sub(object->positions[i[2]], p),
                           .radiance = emission_of(scene, object, triangle)};
}

/* Area times radiance; 0 where that is no number to sum. Sets the normal. */
static double power_of(LightTriangle *triangle, double *out_area) {
    const double radiance = ((double)triangle->radiance.r + (double)triangle->radiance.g +
                             (double)triangle->radiance.b) /
                            3.0;
    *out_area = 0.0;
    if (!(radiance > POWER_MIN) || !(radiance < POWER_MAX))
        return 0.0;
    const Vec3d across = vec3d_cross(vec3d_from(triangle->e1), vec3d_from(triangle->e2));
    const double size = vec3d_length(across);
    if (!(size > POWER_MIN))
        return 0.0;
    triangle->n = vec3d_round(vec3d_scale(across, 1.0 / size));
    *out_area = 0.5 * size;
    return 0.5 * size * radiance;
}

static bool may_emit(const AmbScene *scene, const SceneObject *object) {
    for (uint32_t i = 0; i < object->material_count; ++i) {
        const SceneMaterial *material = &scene->materials[object->materials[i]];
        if (material->surface == AMB_SURFACE_DIFFUSE && rgb_max(material->emission) > 0.0f)
            return true;
    }
    return false;
}

static Candidate measure(const AmbScene *scene, uint32_t o) {
    const SceneObject *object = &scene->objects[o];
    Candidate candidate = {.object = o,
                           .low = vec3(INFINITY, INFINITY, INFINITY),
                           .high = vec3(-INFINITY, -INFINITY, -INFINITY)};
    for (uint64_t t = 0; t < scene->meshes[object->mesh].triangle_count; ++t) {
        LightTriangle triangle = triangle_of(scene, object, t);
        double area;
        const double power = power_of(&triangle, &area);
        if (!(power > 0.0))
            continue;
        ++candidate.triangle_count;
        candidate.area += area;
        candidate.power += power;
        const Vec3 corners[3] = {triangle.p, vec3_add(triangle.p, triangle.e1),
                                 vec3_add(triangle.p, triangle.e2)};
        for (int k = 0; k < 3; ++k) {
            candidate.low = vec3_min(candidate.low, corners[k]);
            candidate.high = vec3_max(candidate.high, corners[k]);
        }
    }
    return candidate;
}

static AmbStatus list_candidates(const AmbScene *scene, Candidates *candidates) {
    uint32_t room = 0;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        room += may_emit(scene, &scene->objects[o]) ? 1 : 0;
    candidates->all = memory_alloc_array(room, sizeof *candidates->all);
    if (candidates->all == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %u meshes that emit light", room);
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        if (!may_emit(scene, &scene->objects[o]))
            continue;
        const Candidate candidate = measure(scene, o);
        if (candidate.power > POWER_MIN && candidate.power < POWER_MAX)
            candidates->all[candidates->count++] = candidate;
    }
    return AMB_OK;
}

static float gap(float low_a, float high_a, float low_b, float high_b) {
    return fmaxf(fmaxf(low_a - high_b, low_b - high_a), 0.0f);
}

/* Solid angle of the mesh where the object is nearest to it, about: half of its area faces that. */
static double solid_angle(const Candidate *candidate, const SceneObject *object) {
    const Vec3 apart =
        vec3(gap(candidate->low.x, candidate->high.x, object->low.x, object->high.x),
             gap(candidate->low.y, candidate->high.y, object->low.y, object->high.y),
             gap(candidate->low.z, candidate->high.z, object->low.z, object->high.z));
    const double square = (double)vec3_dot(apart, apart);
    const double half_space = 2.0 * (double)AMB_PI;
    return square > 0.0 ? fmin(half_space, 0.5 * candidate->area / square) : half_space;
}

static double irradiance_of(const Candidate *candidate, double solid_angle) {
    return candidate->power / candidate->area * fmin(solid_angle, (double)AMB_PI);
}

/* Light of lamps and world at an object, W/m^2, about. */
static double irradiance_of_lamps(const AmbScene *scene, const SceneObject *object) {
    const double disc = (double)AMB_PI * (double)object->radius * (double)object->radius;
    double sum = (double)AMB_PI * (double)rgb_mean(scene->world.mean);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        SceneLight light = scene->lights[l];
        light.position = scene_place(scene, light.position);
        const LightEmission emission = {
            .light = &light, .target = object->center, .target_radius = object->radius, .count = 1};
        const double irradiance = disc > 0.0 ? (double)light_power_towards(&emission) / disc : 0.0;
        sum += isfinite(irradiance) ? irradiance : 0.0;
    }
    return sum;
}

/* What chance would make of the candidates' light at an object. */
static void look_from(const AmbScene *scene, uint32_t o, Candidates *candidates) {
    const SceneObject *object = &scene->objects[o];
    double all = irradiance_of_lamps(scene, object);
    for (uint32_t i = 0; i < candidates->count; ++i)
        if (candidates->all[i].object != o)
            all += irradiance_of(&candidates->all[i], solid_angle(&candidates->all[i], object));
    for (uint32_t i = 0; i < candidates->count; ++i) {
        Candidate *candidate = &candidates->all[i];
        if (candidate->object == o)
            continue;
        const double angle = solid_angle(candidate, object);
        if (!(angle > 0.0) || !(all > 0.0))
            continue;
        const double share = irradiance_of(candidate, angle) / all;
        const double noise = share * sqrt(2.0 * (double)AMB_PI / angle);
        if (share > SHARE_MIN && noise > NOISE_MIN)
            candidate->noise = fmax(candidate->noise, noise);
    }
}

static int compare_candidates(const void *a, const void *b) {
    const Candidate *x = a, *y = b;
    if (x->noise != y->noise)
        return x->noise < y->noise ? 1 : -1;
    return (x->object > y->object) - (x->object < y->object);
}

/* Those that are lamps come first, the noisiest one before all. */
static void choose(const AmbScene *scene, Candidates *candidates) {
    const uint64_t pairs =
        (uint64_t)scene->object_count * ((uint64_t)candidates->count + scene->light_count);
    const uint32_t stride = (uint32_t)(1 + pairs / PAIRS_MAX);
    for (uint32_t o = 0; o < scene->object_count; o += stride)
        if (scene->objects[o].low.x <= scene->objects[o].high.x)
            look_from(scene, o, candidates);
    qsort(candidates->all, candidates->count, sizeof *candidates->all, compare_candidates);
    uint32_t lamps = 0;
    while (lamps < candidates->count && candidates->all[lamps].noise > 0.0)
        ++lamps;
    candidates->count = lamps;
}

static void fill(const AmbScene *scene, const Candidate *candidate, LightMesh *mesh) {
    const SceneObject *object = &scene->objects[candidate->object];
    for (uint64_t t = 0; t < scene->meshes[object->mesh].triangle_count; ++t) {
        LightTriangle triangle = triangle_of(scene, object, t);
        double area;
        if (power_of(&triangle, &area) > 0.0)
            mesh->triangles[mesh->count++] = triangle;
    }
    for (uint32_t o = 0; o < scene->object_count; ++o)
        mesh->may_be_inside |=
            scene->objects[o].is_boundary && scene_boxes_meet(&scene->objects[o], object);
}

/* The light of some candidates together. */
static AmbStatus make_light(const AmbScene *scene, const Candidate candidates[], uint32_t count,
                            SceneLight *out_light) {
    const char *name = scene->objects[candidates[0].object].name;
    uint64_t triangle_count = 0;
    double area = 0.0;
    for (uint32_t i = 0; i < count; ++i) {
        triangle_count += candidates[i].triangle_count;
        area += candidates[i].area;
    }
    SceneLight light = {.name = memory_copy_text(name),
                        .kind = LIGHT_MESH,
                        .mesh = memory_zero_array(1, sizeof(LightMesh))};
    if (light.mesh != NULL) {
        light.mesh->triangles = memory_alloc_array(triangle_count, sizeof(LightTriangle));
        light.mesh->sums = memory_alloc_array(triangle_count, sizeof(double));
    }
    *out_light = light;
    if (light.name == NULL || light.mesh == NULL || light.mesh->triangles == NULL ||
        light.mesh->sums == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light of \"%s\"", name);
    for (uint32_t i = 0; i < count; ++i)
        fill(scene, &candidates[i], light.mesh);
    light_mesh_prepare(light.mesh, &out_light->position);
    const float radiance = (float)(light_mesh_power(light.mesh) / area);
    out_light->color = rgb(radiance, radiance, radiance);
    return AMB_OK;
}

AmbStatus mesh_lamps_take(AmbScene *scene, SceneLight out_lights[MESH_LAMPS_MAX],
                          uint32_t *out_count) {
    *out_count = 0;
    Candidates candidates = {.count = 0};
    AMB_TRY(list_candidates(scene, &candidates));
    choose(scene, &candidates);
    AmbStatus status = AMB_OK;
    for (uint32_t i = 0; i < candidates.count && status == AMB_OK; ++*out_count) {
        const uint32_t count = *out_count + 1 < MESH_LAMPS_MAX ? 1 : candidates.count - i;
        status = make_light(scene, candidates.all + i, count, &out_lights[*out_count]);
        for (uint32_t k = 0; k < count && status == AMB_OK; ++k) {
            SceneObject *object = &scene->objects[candidates.all[i + k].object];
            object->is_lamp = true;
            object->lamp_power = light_mesh_power(out_lights[*out_count].mesh);
        }
        i += count;
    }
    memory_free(candidates.all);
    if (status != AMB_OK) {
        mesh_lamps_clear(out_lights, *out_count);
        *out_count = 0;
    }
    return status;
}

void mesh_lamps_clear(SceneLight lights[], uint32_t count) {
    for (uint32_t i = 0; i < count; ++i) {
        memory_free(lights[i].name);
        light_mesh_destroy(lights[i].mesh);
    }
}
