/* SPDX-License-Identifier: GPL-3.0-or-later
 * What the scene alone says. */
#include "plan/scene_rules.h"

bool scene_has_boundary(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary)
            return true;
    return false;
}

bool scene_has_refraction(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary && scene->materials[scene->objects[o].inside].ior != 1.0f)
            return true;
    return false;
}

bool scene_object_scatters(const AmbScene *scene, uint32_t object) {
    return scene->objects[object].is_boundary &&
           medium_scatters(&scene->materials[scene->objects[object].inside].medium);
}

bool scene_has_scattering(const AmbScene *scene) {
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene_object_scatters(scene, o))
            return true;
    return false;
}

static bool is_opaque(const AmbScene *scene, const SceneObject *object, uint32_t slot) {
    const uint32_t last = object->material_count - 1;
    const uint32_t material = object->materials[slot < last ? slot : last];
    return scene->materials[material].surface == AMB_SURFACE_DIFFUSE;
}

bool scene_has_opaque_surface(const AmbScene *scene) {
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

float scene_albedo_max(const AmbScene *scene) {
    float most = 0.0f;
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const Medium *medium = &scene->materials[scene->objects[o].inside].medium;
        Rgb sigma_s = rgb(0, 0, 0);
        for (uint32_t l = 0; l < medium->lobe_count; ++l)
            sigma_s = rgb_add(sigma_s, medium->lobes[l].sigma_s);
        const Rgb t = medium->sigma_t;
        if (scene->objects[o].is_boundary)
            most = fmaxf(most,
                         rgb_max(rgb(sigma_s.r / fmaxf(t.r, 1e-30f), sigma_s.g / fmaxf(t.g, 1e-30f),
                                     sigma_s.b / fmaxf(t.b, 1e-30f))));
    }
    return most;
}

bool scene_has_lamp(const AmbScene *scene) {
    for (uint32_t l = 0; l < scene->light_count; ++l)
        if (rgb_max(scene->lights[l].color) > 0.0f)
            return true;
    return false;
}

bool scene_has_wide_lamp(const AmbScene *scene) {
    for (uint32_t l = 0; l < scene->light_count - scene->world_lamp_count; ++l)
        if (light_has_extent(&scene->lights[l]) && rgb_max(scene->lights[l].color) > 0.0f)
            return true;
    return false;
}

bool scene_may_touch(const SceneObject *a, const SceneObject *b) {
    return vec3_length(vec3_sub(a->center, b->center)) < a->radius + b->radius;
}

bool scene_may_start_inside(const AmbScene *scene) {
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
