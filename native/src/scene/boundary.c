/* SPDX-License-Identifier: GPL-3.0-or-later
 * Boundaries between media. */
#include "scene/boundary.h"

enum { PROBE_MAX = 256 }; /* surfaces a probe ray may pass before it gives up */

static bool stack_remove(MediumStack *stack, uint32_t object) {
    for (uint32_t i = stack->count; i-- > 0;)
        if (stack->objects[i] == object) {
            for (uint32_t k = i + 1; k < stack->count; ++k)
                stack->objects[k - 1] = stack->objects[k];
            --stack->count;
            return true;
        }
    return false;
}

static bool stack_push(MediumStack *stack, uint32_t object) {
    if (stack->count == MEDIUM_STACK_MAX)
        return false;
    stack->objects[stack->count++] = object;
    return true;
}

static bool is_boundary_surface(const SurfacePoint *surface) {
    return surface->material->surface == AMB_SURFACE_DIELECTRIC;
}

MediumStack scene_media_at(const AmbScene *scene, Vec3 p) {
    MediumStack entered = {0}; /* by the probe, after p */
    MediumStack inner_first = {0};
    /* No direction of special meaning to modelled shapes. */
    const Vec3 d = vec3_normalize(vec3(0.41f, 0.27f, 0.87f));
    Vec3 o = p;
    for (int i = 0; i < PROBE_MAX; ++i) {
        Hit hit;
        if (!scene_intersect(scene, o, d, INFINITY, &hit))
            break;
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (is_boundary_surface(&surface)) {
            if (vec3_dot(d, surface.ng) < 0.0f)
                stack_push(&entered, surface.object);
            else if (!stack_remove(&entered, surface.object))
                stack_push(&inner_first, surface.object);
        }
        o = scene_leave(&surface, d);
    }
    MediumStack stack = {.count = inner_first.count};
    for (uint32_t i = 0; i < stack.count; ++i)
        stack.objects[i] = inner_first.objects[stack.count - 1 - i];
    return stack;
}

static float stack_ior(const AmbScene *scene, const MediumStack *stack) {
    const SceneMaterial *material = medium_stack_material(scene, stack);
    return material != NULL ? material->ior : 1.0f;
}

static float adjoint_factor(Vec3 d, Vec3 wt, Vec3 ns, Vec3 ng) {
    const float above = fabsf(vec3_dot(d, ns) * vec3_dot(wt, ng));
    const float below = fabsf(vec3_dot(d, ng) * vec3_dot(wt, ns));
    return below > 0.0f ? above / below : 0.0f;
}

BoundaryCrossing boundary_cross(const AmbScene *scene, const MediumStack *stack,
                                const SurfacePoint *surface, Vec3 d) {
    BoundaryCrossing crossing = {.is_entering = vec3_dot(d, surface->ng) < 0.0f, .beyond = *stack};
    if (crossing.is_entering)
        crossing.is_ignored = !stack_push(&crossing.beyond, surface->object);
    else
        crossing.is_ignored = !stack_remove(&crossing.beyond, surface->object);
    if (crossing.is_ignored)
        return crossing;
    crossing.eta = stack_ior(scene, stack) / stack_ior(scene, &crossing.beyond);

    const float side = crossing.is_entering ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(surface->ng, side);
    crossing.n = vec3_scale(surface->ns, side);
    /* Interpolation can turn the normal away from the ray near a silhouette. */
    if (vec3_dot(d, crossing.n) >= 0.0f)
        crossing.n = ng;
    crossing.split = dielectric_split(d, crossing.n, crossing.eta);
    crossing.can_refract =
        crossing.split.reflectance < 1.0f && vec3_dot(crossing.split.refracted, ng) < 0.0f;
    crossing.can_reflect =
        crossing.split.reflectance > 0.0f && vec3_dot(crossing.split.reflected, ng) > 0.0f;
    crossing.adjoint_refract = adjoint_factor(d, crossing.split.refracted, crossing.n, ng);
    crossing.adjoint_reflect = adjoint_factor(d, crossing.split.reflected, crossing.n, ng);
    return crossing;
}
