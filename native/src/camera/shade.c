/* SPDX-License-Identifier: GPL-3.0-or-later
 * Opaque surfaces. */
#include "camera/shade.h"

/* Medium along a shadow ray that starts inside one. */
static Rgb shadow_transmittance(const AmbScene *scene, const MediumStack *stack, float distance) {
    const SceneMaterial *material = medium_stack_material(scene, stack);
    if (material == NULL)
        return rgb(1, 1, 1);
    return isfinite(distance) ? medium_transmittance(&material->medium, distance) : rgb(0, 0, 0);
}

Rgb shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 direction,
                  const MediumStack *stack) {
    const AmbScene *scene = walker->scene;
    const float side = vec3_dot(direction, surface->ng) < 0.0f ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(surface->ng, side);
    const Vec3 ns = vec3_scale(surface->ns, side);
    const Vec3 p = scene_leave(surface, ng);
    Rgb irradiance = rgb(0, 0, 0);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const LightArrival light =
            light_arrival(&scene->lights[l], surface->p, walker_random2(walker));
        const float cosine = vec3_dot(light.wi, ns);
        if (!(cosine > 0.0f) || !(vec3_dot(light.wi, ng) > 0.0f) ||
            !(rgb_max(light.irradiance) > 0.0f))
            continue;
        if (scene_is_occluded(scene, p, light.wi, light.distance))
            continue;
        const Rgb arriving =
            rgb_mul(light.irradiance, shadow_transmittance(scene, stack, light.distance));
        irradiance = rgb_add(irradiance, rgb_scale(arriving, cosine));
    }
    Rgb radiance = rgb_scale(rgb_mul(surface->material->albedo, irradiance), 1.0f / AMB_PI);
    if (rgb_max(scene->world) > 0.0f) {
        Vec3 x, y;
        vec3_frame(ns, &x, &y);
        const Vec3 up = sample_cosine_hemisphere(walker_random2(walker));
        const Vec3 d = frame_to_world(x, y, ns, up);
        if (vec3_dot(d, ng) > 0.0f && !scene_is_occluded(scene, p, d, INFINITY))
            radiance = rgb_madd(radiance, surface->material->albedo, scene->world);
    }
    return rgb_add(radiance, surface->material->emission);
}
