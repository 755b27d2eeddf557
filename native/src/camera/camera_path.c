/* SPDX-License-Identifier: GPL-3.0-or-later
 * The camera pass. */
#include "camera/camera_path.h"

#include "base/rng.h"

enum { DEPTH_MAX = 256 }; /* boundaries along one branch, a guard against endless paths */

/* Branches with less throughput survive by chance in proportion: unbiased. */
static const float ROULETTE_THROUGHPUT = 0.01f;

typedef struct Walker {
    const AmbScene *scene;
    const Field *field;
    const CameraParams *params;
    Rng rng;
    uint32_t dimension; /* next unused random number */
    CameraSample *out;
} Walker;

typedef struct Branch {
    Vec3 o, d;
    float t_max;
    Rgb throughput;
    MediumStack stack;
    uint32_t bounces; /* internal reflections so far */
    uint32_t depth;   /* boundaries so far */
} Branch;

static float next_random(Walker *walker) {
    return rng_float(walker->rng, walker->dimension++);
}

static Sample2 next_random2(Walker *walker) {
    const float u = next_random(walker);
    return (Sample2){u, next_random(walker)};
}

static Rgb rgb_madd(Rgb a, Rgb b, Rgb c) {
    return rgb_add(a, rgb_mul(b, c));
}

/* Medium along a shadow ray that starts inside one. */
static Rgb shadow_transmittance(const Walker *walker, const MediumStack *stack, float distance) {
    const SceneMaterial *material = medium_stack_material(walker->scene, stack);
    if (material == NULL)
        return rgb(1, 1, 1);
    return isfinite(distance) ? medium_transmittance(&material->medium, distance) : rgb(0, 0, 0);
}

/* Radiance that an opaque surface sends back along the branch: direct light and the world. A
 * translucent object between it and the light casts a black shadow. */
static Rgb shade_diffuse(Walker *walker, const SurfacePoint *surface, const Branch *branch) {
    const AmbScene *scene = walker->scene;
    const float side = vec3_dot(branch->d, surface->ng) < 0.0f ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(surface->ng, side);
    const Vec3 ns = vec3_scale(surface->ns, side);
    const Vec3 p = scene_leave(surface, ng);
    Rgb irradiance = rgb(0, 0, 0);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const LightArrival light =
            light_arrival(&scene->lights[l], surface->p, next_random2(walker));
        const float cosine = vec3_dot(light.wi, ns);
        if (!(cosine > 0.0f) || !(vec3_dot(light.wi, ng) > 0.0f) ||
            !(rgb_max(light.irradiance) > 0.0f))
            continue;
        if (scene_is_occluded(scene, p, light.wi, light.distance))
            continue;
        const Rgb arriving =
            rgb_mul(light.irradiance, shadow_transmittance(walker, &branch->stack, light.distance));
        irradiance = rgb_add(irradiance, rgb_scale(arriving, cosine));
    }
    Rgb radiance = rgb_scale(rgb_mul(surface->material->albedo, irradiance), 1.0f / AMB_PI);
    if (rgb_max(scene->world) > 0.0f) {
        Vec3 x, y;
        vec3_frame(ns, &x, &y);
        const Vec3 up = sample_cosine_hemisphere(next_random2(walker));
        const Vec3 d = frame_to_world(x, y, ns, up);
        if (vec3_dot(d, ng) > 0.0f && !scene_is_occluded(scene, p, d, INFINITY))
            radiance = rgb_madd(radiance, surface->material->albedo, scene->world);
    }
    return rgb_add(radiance, surface->material->emission);
}

/* Adds what scattered along the branch inside its medium, and attenuates the branch. */
static void pass_medium(Walker *walker, Branch *branch, float length) {
    const Medium *medium = &medium_stack_material(walker->scene, &branch->stack)->medium;
    if (walker->field != NULL && medium_scatters(medium)) {
        const FieldSegment segment = {branch->o, branch->d, length,
                                      medium_stack_top(&branch->stack)};
        const FieldRadiance gathered = field_gather(walker->field, &segment);
        CameraSample *out = walker->out;
        out->single = rgb_madd(out->single, branch->throughput, gathered.radiance);
        const float weight = rgb_mean(branch->throughput);
        out->frequency += weight * gathered.frequency;
        out->contribution += weight * gathered.contribution;
    }
    branch->throughput = rgb_mul(branch->throughput, medium_transmittance(medium, length));
}

static void follow(Walker *walker, Branch branch);

static void follow_next(Walker *walker, const Branch *from, const SurfacePoint *surface, Vec3 d,
                        const MediumStack *stack, Rgb throughput, uint32_t bounces) {
    if (from->depth + 1 >= DEPTH_MAX)
        return;
    const float strongest = rgb_max(throughput);
    if (strongest < ROULETTE_THROUGHPUT) {
        const float survival = strongest / ROULETTE_THROUGHPUT;
        if (next_random(walker) >= survival)
            return;
        throughput = rgb_scale(throughput, 1.0f / survival);
    }
    follow(walker, (Branch){.o = scene_leave(surface, d),
                            .d = d,
                            .t_max = INFINITY,
                            .throughput = throughput,
                            .stack = *stack,
                            .bounces = bounces,
                            .depth = from->depth + 1});
}

static void follow_boundary(Walker *walker, const Branch *branch, const SurfacePoint *surface) {
    const BoundaryCrossing crossing =
        boundary_cross(walker->scene, &branch->stack, surface, branch->d);
    if (crossing.is_ignored) {
        follow_next(walker, branch, surface, branch->d, &branch->stack, branch->throughput,
                    branch->bounces);
        return;
    }
    const bool is_outside = branch->stack.count == 0;
    const bool leaves = crossing.beyond.count == 0;
    const SceneMaterial *material = surface->material;
    const uint32_t effects = walker->params->effects;
    const float reflectance = crossing.split.reflectance;

    const bool wants_refraction = !leaves || (effects & AMB_EFFECT_BACKGROUND) != 0;
    if (crossing.can_refract && wants_refraction) {
        /* Radiance grows by n^2 on entering a denser medium; looking backwards, the branch's
         * throughput takes (n here / n beyond)^2 ([Veach97] 5.2). */
        const float weight = (1.0f - reflectance) * crossing.eta * crossing.eta;
        const Rgb throughput =
            rgb_mul(rgb_scale(branch->throughput, weight), material->transmit_color);
        follow_next(walker, branch, surface, crossing.split.refracted, &crossing.beyond, throughput,
                    branch->bounces);
    }
    const bool wants_reflection = is_outside ? (effects & AMB_EFFECT_SURFACE_REFLECTION) != 0
                                             : branch->bounces < walker->params->bounces;
    if (crossing.can_reflect && wants_reflection) {
        const Rgb throughput =
            rgb_mul(rgb_scale(branch->throughput, reflectance), material->reflect_color);
        follow_next(walker, branch, surface, crossing.split.reflected, &branch->stack, throughput,
                    branch->bounces + (is_outside ? 0u : 1u));
    }
}

static void follow(Walker *walker, Branch branch) {
    const AmbScene *scene = walker->scene;
    const bool is_inside = branch.stack.count > 0;
    Hit hit;
    const bool is_hit = scene_intersect(scene, branch.o, branch.d, branch.t_max, &hit);
    if (is_inside) {
        /* Through a hole in the mesh the medium would go on for ever: it ends where the scene
         * does. */
        const float length =
            is_hit ? hit.t
                   : fminf(branch.t_max,
                           scene->radius + vec3_length(vec3_sub(branch.o, scene->center)));
        if (!is_hit && !isfinite(branch.t_max))
            ++walker->out->leak_count;
        pass_medium(walker, &branch, length);
    }
    CameraSample *out = walker->out;
    if (!is_hit) {
        const bool is_seen_directly = branch.depth == 0;
        if (is_seen_directly && walker->params->film_transparent) {
            out->alpha = 0.0f;
            return;
        }
        out->surface = rgb_madd(out->surface, branch.throughput, scene->world);
        return;
    }
    if (branch.depth == 0)
        out->depth = hit.t;
    const SurfacePoint surface = scene_surface(scene, &hit);
    if (surface.material->surface == AMB_SURFACE_DIELECTRIC) {
        out->is_object = out->is_object || branch.depth == 0;
        follow_boundary(walker, &branch, &surface);
        return;
    }
    const Rgb radiance = shade_diffuse(walker, &surface, &branch);
    out->surface = rgb_madd(out->surface, branch.throughput, radiance);
}

CameraSample camera_sample(const AmbScene *scene, const Field *field, const CameraParams *params,
                           uint32_t x, uint32_t y, uint32_t index) {
    const uint64_t pixel = (uint64_t)y * params->width + x;
    /* A low-discrepancy sequence, turned for each pixel and replica, covers its area. */
    const Rng pixel_rng = rng_create(params->seed, RNG_STAGE_CAMERA, pixel);
    const uint32_t replica = index % params->replicas;
    const Sample2 jitter = sample_r2(index / params->replicas, rng_float(pixel_rng, 2 * replica),
                                     rng_float(pixel_rng, 2 * replica + 1));
    CameraSample sample = {.alpha = 1.0f, .depth = CAMERA_DEPTH_NONE};
    Walker walker = {.scene = scene,
                     .field = field,
                     .params = params,
                     .rng = {rng_mix(pixel_rng.key + index + 1)},
                     .out = &sample};
    const Sample2 lens = next_random2(&walker);
    const CameraRay ray = camera_ray(&scene->camera, ((float)x + jitter.u) / (float)params->width,
                                     ((float)y + jitter.v) / (float)params->height, lens);
    follow(&walker, (Branch){.o = ray.o,
                             .d = ray.d,
                             .t_max = ray.t_max,
                             .throughput = {1, 1, 1},
                             .stack = params->may_start_inside ? scene_media_at(scene, ray.o)
                                                               : (MediumStack){.count = 0}});
    if (sample.depth != CAMERA_DEPTH_NONE)
        sample.depth = ray.depth_o + sample.depth * ray.cos_axis;
    return sample;
}
