/* SPDX-License-Identifier: GPL-3.0-or-later
 * Opaque surfaces. */
#include "camera/shade.h"

#include "camera/scatter_walk.h"
#include "camera/shadow.h"

enum { DEPTH_MAX = 256 }; /* boundaries on the way of light, a guard against endless paths */

/* Share of a lamp's light that arrives straight. */
static Rgb straight_share(const Walker *walker, const MediumStack *stack, Vec3 p,
                          const LightArrival *light) {
    const AmbScene *scene = walker->scene;
    if (!walker->params->shines_through) {
        if (scene_is_occluded(scene, p, light->wi, light->distance))
            return rgb(0, 0, 0);
        if (stack->count == 0)
            return rgb(1, 1, 1);
    }
    return shadow_transmittance(scene, stack, p, light->wi, light->distance);
}

/* Irradiance of the lamps: along shadow rays, and what boundaries bend. */
static Rgb lamp_irradiance(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                           Vec3 ng, Vec3 ns) {
    const AmbScene *scene = walker->scene;
    const Vec3 p = scene_leave(surface, ng);
    Rgb irradiance = rgb(0, 0, 0);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const LightArrival light =
            light_arrival(&scene->lights[l], surface->p, walker_random2(walker));
        const float cosine = vec3_dot(light.wi, ns);
        if (!(cosine > 0.0f) || !(vec3_dot(light.wi, ng) > 0.0f) ||
            !(rgb_max(light.irradiance) > 0.0f))
            continue;
        const Rgb share = straight_share(walker, stack, p, &light);
        irradiance = rgb_madd(irradiance, rgb_scale(light.irradiance, cosine), share);
    }
    const CausticMap *caustics = walker->params->caustics;
    if (caustics != NULL)
        irradiance = rgb_add(irradiance, caustics_irradiance(caustics, surface->p, ng));
    return irradiance;
}

/* The way back of light that arrives at an opaque surface. */
typedef struct LightPath {
    Vec3 o, d;
    MediumStack stack;
    Rgb weight;
    uint32_t bounces; /* internal reflections so far */
} LightPath;

/* Attenuates the path, and adds what scatters into it. */
static void pass_medium(Walker *walker, LightPath *path, float length, Rgb glow) {
    const Medium *medium = &medium_stack_material(walker->scene, &path->stack)->medium;
    const Rgb throughput = rgb_mul(path->weight, glow);
    if (medium_scatters(medium) && rgb_max(throughput) > 0.0f) {
        if (walker->field != NULL &&
            (walker->params->effects & AMB_EFFECT_SINGLE_SCATTERING) != 0) {
            const FieldSegment segment = {path->o, path->d, length, medium_stack_top(&path->stack)};
            Rgb *single = &walker->out->orders[0];
            *single = rgb_madd(*single, throughput, field_gather(walker->field, &segment).radiance);
        }
        /* As along the camera's path: what walls reflect goes on in the walk. */
        if (path->bounces == 0 && walk_is_wanted(walker->params))
            walk_scatter(walker, path->o, path->d, &path->stack, throughput);
    }
    path->weight = rgb_mul(path->weight, medium_transmittance(medium, length));
}

/* One of the two branches by chance, and all reflections. False: neither goes on. */
static bool pass_boundary(Walker *walker, LightPath *path, const SurfacePoint *surface) {
    const BoundaryCrossing crossing = boundary_cross(walker->scene, &path->stack, surface, path->d);
    if (crossing.is_ignored) {
        path->o = scene_leave(surface, path->d);
        return true;
    }
    const SceneMaterial *material = surface->material;
    if (walker_random(walker) < crossing.split.reflectance) {
        if (!crossing.can_reflect)
            return false;
        path->weight = rgb_mul(path->weight, material->reflect_color);
        path->d = crossing.split.reflected;
        path->bounces += path->stack.count > 0 ? 1 : 0;
    } else {
        if (!crossing.can_refract)
            return false;
        /* See follow_boundary in camera_path.c. */
        path->weight =
            rgb_mul(rgb_scale(path->weight, crossing.eta * crossing.eta), material->transmit_color);
        path->d = crossing.split.refracted;
        path->stack = crossing.beyond;
    }
    path->o = scene_leave(surface, path->d);
    return true;
}

static bool survives(Walker *walker, LightPath *path) {
    const float strongest = rgb_max(path->weight);
    if (strongest >= WALKER_ROULETTE_THROUGHPUT)
        return true;
    const float survival = strongest / WALKER_ROULETTE_THROUGHPUT;
    if (!(walker_random(walker) < survival))
        return false;
    path->weight = rgb_scale(path->weight, 1.0f / survival);
    return true;
}

/* Radiance of the world from where the path leads to. Light that opaque surfaces pass to one
 * another is not simulated. */
static Rgb follow_light(Walker *walker, LightPath path, Rgb glow) {
    const AmbScene *scene = walker->scene;
    for (int depth = 0; depth < DEPTH_MAX; ++depth) {
        Hit hit;
        const bool is_hit = scene_intersect(scene, path.o, path.d, INFINITY, &hit);
        if (path.stack.count > 0) {
            if (!is_hit)
                ++walker->out->leak_count;
            pass_medium(walker, &path, is_hit ? hit.t : walker_end_of_scene(scene, path.o), glow);
        }
        if (!is_hit)
            return rgb_mul(path.weight, scene->world);
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (surface.material->surface != AMB_SURFACE_DIELECTRIC ||
            !pass_boundary(walker, &path, &surface) || !survives(walker, &path))
            break;
    }
    return rgb(0, 0, 0);
}

/* Radiance from a direction of the cosine distribution. */
static Rgb world_radiance(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                          Vec3 ng, Vec3 ns, Rgb glow) {
    const AmbScene *scene = walker->scene;
    const bool shines_through = walker->params->shines_through;
    if (!(rgb_max(scene->world) > 0.0f) &&
        !(shines_through && walker->field != NULL && rgb_max(glow) > 0.0f))
        return rgb(0, 0, 0);
    Vec3 x, y;
    vec3_frame(ns, &x, &y);
    const Vec3 d = frame_to_world(x, y, ns, sample_cosine_hemisphere(walker_random2(walker)));
    if (!(vec3_dot(d, ng) > 0.0f))
        return rgb(0, 0, 0);
    const Vec3 p = scene_leave(surface, ng);
    if (shines_through)
        return follow_light(walker, (LightPath){p, d, *stack, rgb(1, 1, 1), 0}, glow);
    return scene_is_occluded(scene, p, d, INFINITY) ? rgb(0, 0, 0) : scene->world;
}

Rgb shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 d, const MediumStack *stack,
                  Rgb glow) {
    const float side = vec3_dot(d, surface->ng) < 0.0f ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(surface->ng, side);
    const Vec3 ns = vec3_scale(surface->ns, side);
    const Rgb albedo = surface->material->albedo;
    const Rgb lamps = rgb_scale(lamp_irradiance(walker, surface, stack, ng, ns), 1.0f / AMB_PI);
    const Rgb world = world_radiance(walker, surface, stack, ng, ns, rgb_mul(glow, albedo));
    return rgb_madd(surface->material->emission, albedo, rgb_add(lamps, world));
}
