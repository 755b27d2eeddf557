/* SPDX-License-Identifier: GPL-3.0-or-later
 * Caustics as lamps. */
#include "camera/caustic_lamp.h"

#include "camera/shadow.h"
#include "scene/light_mesh.h"

enum { SURFACE_MAX = 16 }; /* along a kernel's height, a guard */

/* What the surface sees of a photon's light at a place of another one. */
static Rgb radiance_from(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                         Vec3 ng, Vec3 ns, const CausticPoint *point, const SurfacePoint *other) {
    const Rgb none = rgb(0, 0, 0);
    const Vec3 way = vec3_sub(other->p, surface->p);
    const float square = vec3_dot(way, way);
    if (!(square > 0.0f) || !(vec3_dot(way, ng) > 0.0f))
        return none;
    const Vec3 d = vec3_scale(way, 1.0f / sqrtf(square));
    const Vec3 n = vec3_dot(d, other->ng) < 0.0f ? other->ng : vec3_negate(other->ng);
    const float cosines = -vec3_dot(d, ns) * vec3_dot(d, n);
    const float turn = vec3_dot(n, point->n);
    if (!(cosines > 0.0f) || !(turn >= CAUSTIC_NORMAL_COS_MIN))
        return none;
    const LightPlace place = {.p = other->p, .n = other->ng};
    const Vec3 p = scene_leave(surface, ng);
    const Vec3 straight = vec3_sub(light_place_towards(&place, surface->p), p);
    const float distance = vec3_length(straight);
    if (!(distance > 0.0f))
        return none;
    const Vec3 to = vec3_scale(straight, 1.0f / distance);
    if (!walker->params->shines_through && scene_is_occluded(walker->scene, p, to, distance))
        return none;
    const Rgb passes = shadow_transmittance(walker->scene, stack, p, to, distance);
    if (!(rgb_max(passes) > 0.0f))
        return none;
    const float by_rays = cosines / (AMB_PI * square);
    const float share = point->density / (point->density + by_rays);
    /* The kernel is the photon's irradiance and the place's density alike. */
    const Rgb radiance = rgb_mul(scene_albedo(walker->scene, other), rgb_mul(passes, point->flux));
    return rgb_scale(radiance, share * by_rays / (AMB_PI * turn));
}

Rgb caustics_elsewhere(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                       Vec3 ng, Vec3 ns) {
    CausticPoint point;
    Rgb sum = rgb(0, 0, 0);
    const Sample2 choice = walker_random2(walker), place = walker_random2(walker);
    if (!caustics_choose(walker->params->caustics, walker->part, choice, place, &point) ||
        !(vec3_dot(vec3_sub(point.p, surface->p), ng) > -point.height))
        return sum;
    /* The kernel lights what is near its plane: all that the line across it meets. */
    const Vec3 down = vec3_negate(point.n);
    Vec3 o = vec3_madd(point.p, point.height, point.n);
    float left = 2.0f * point.height;
    MediumStack media = *stack;
    Hit last = {.geometry = UINT32_MAX};
    for (int i = 0; i < SURFACE_MAX && left > 0.0f; ++i) {
        BoundaryArrival arrival;
        if (!boundary_find(walker->scene, &media, o, down, left, &arrival))
            break;
        const SurfacePoint *other = &arrival.crossing.surface;
        /* By rounding a line may leave a triangle and meet it again. */
        const bool is_again =
            other->hit.geometry == last.geometry && other->hit.triangle == last.triangle;
        if (arrival.is_opaque && !is_again)
            sum = rgb_add(sum, radiance_from(walker, surface, stack, ng, ns, &point, other));
        if (!arrival.is_opaque)
            media = arrival.crossing.beyond;
        last = other->hit;
        o = scene_leave(other, down);
        left -= arrival.t;
    }
    return sum;
}
