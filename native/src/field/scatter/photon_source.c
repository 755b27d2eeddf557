/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where photons start. */
#include "field/scatter/photon_source.h"

#include <math.h>
#include <string.h>

#include "base/memory.h"

enum {
    PROBE_LINES = 1024, /* that tell how bright an object's surroundings are */
    PROBE_SURFACES = 32 /* on the way of one */
};

static Photon emit_line(const LightBatch *batch, uint64_t i);

/* Whether a line meets its object, and the radiance that it brings there, of the world or of the
 * last opaque surface before; other translucent objects are left aside. */
static bool brings(const AmbScene *scene, const Photon *line, bool interreflects, Rng rng,
                   Rgb *out_radiance) {
    SurfacePoint last = {.material = NULL};
    Vec3 o = line->o;
    Hit hit;
    for (int i = 0; i < PROBE_SURFACES && scene_intersect(scene, o, line->d, INFINITY, &hit); ++i) {
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (surface.material->surface != AMB_SURFACE_DIELECTRIC) {
            last = surface;
        } else if (surface.object == line->batch->target) {
            uint32_t dimension = 0;
            *out_radiance = last.material == NULL
                                ? world_radiance_but_lamps(&scene->world, vec3_negate(line->d))
                                : photon_surface_radiance(scene, &last, line->d, interreflects, rng,
                                                          &dimension);
            return true;
        }
        o = scene_leave(&surface, line->d);
    }
    return false;
}

/* Flux from around an object towards it, W, about; infinite where it is so thin that no line meets
 * it: nothing is known then, and all lights get as many photons. */
static double surroundings_power(const AmbScene *scene, const LightBatch *batch,
                                 const ScatterParams *params) {
    LightBatch probe = *batch;
    probe.emission.count = PROBE_LINES;
    double power = 0.0;
    uint32_t met = 0;
    for (uint32_t i = 0; i < PROBE_LINES; ++i) {
        const Photon line = emit_line(&probe, i);
        const Rng rng = rng_create(params->seed, RNG_STAGE_PHOTON, i);
        Rgb radiance;
        if (!brings(scene, &line, params->interreflects, rng, &radiance))
            continue;
        power += (double)rgb_mean(rgb_mul(line.flux, radiance));
        ++met;
    }
    return met > 0 ? power : (double)INFINITY;
}

static void list_batches(const AmbScene *scene, const ScatterParams *params, PhotonSource *source) {
    const uint32_t last = scene->light_count; /* the surroundings come after the lamps */
    for (uint32_t l = 0; l < last + (params->has_world ? 1u : 0u); ++l) {
        const SceneLight *light = l < last ? &scene->lights[l] : NULL;
        for (uint32_t o = 0; o < scene->object_count; ++o) {
            const Rng rng = rng_create(params->seed, RNG_STAGE_PHOTON, l);
            LightBatch batch;
            if (!light_batch_aim(scene, light, o, rng, &batch))
                continue;
            batch.power = light != NULL ? (double)light_power_towards(&batch.emission)
                                        : surroundings_power(scene, &batch, params);
            if (batch.power > 0.0)
                source->batches[source->batch_count++] = batch;
        }
    }
}

AmbStatus photon_source_create(const AmbScene *scene, const ScatterParams *params,
                               PhotonSource *out_source) {
    *out_source = (PhotonSource){.photon_count = params->photon_count};
    out_source->batches = memory_zero_array(
        ((uint64_t)scene->light_count + 1) * scene->object_count, sizeof(LightBatch));
    if (out_source->batches == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the plan of photons");
    list_batches(scene, params, out_source);
    light_batches_share(out_source->batches, out_source->batch_count, params->photon_count);
    if (out_source->batch_count == 0)
        out_source->photon_count = 0;
    return AMB_OK;
}

void photon_source_clear(PhotonSource *source) {
    memory_free(source->batches);
    memset(source, 0, sizeof *source);
}

uint64_t photon_source_count(const PhotonSource *source, uint32_t object) {
    uint64_t count = 0;
    for (uint64_t b = 0; b < source->batch_count; ++b)
        if (source->batches[b].target == object)
            count += source->batches[b].emission.count;
    return count;
}

/* A line through the object's bounding sphere, and the flux along it of radiance 1. */
static Photon emit_line(const LightBatch *batch, uint64_t i) {
    const LightEmission *emission = &batch->emission;
    Photon photon = {.batch = batch};
    photon.d = sample_cap(sample_fibonacci(i, emission->count, emission->shift_v), 2.0f);
    Vec3 x, y;
    vec3_frame(photon.d, &x, &y);
    const float radius = emission->target_radius;
    const Sample2 disc = sample_disc(sample_r2(i, emission->shift_u, emission->shift_v));
    photon.o = vec3_madd(emission->target, -emission->distance, photon.d);
    photon.o = vec3_madd(vec3_madd(photon.o, radius * disc.u, x), radius * disc.v, y);
    const float share = 4.0f * AMB_PI * AMB_PI * radius * radius / (float)emission->count;
    photon.flux = rgb(share, share, share);
    return photon;
}

Photon photon_emit(const PhotonSource *source, uint64_t i) {
    uint64_t low = 0, high = source->batch_count; /* first of low <= i < first of high */
    while (high - low > 1) {
        const uint64_t middle = (low + high) / 2;
        if (source->batches[middle].first <= i)
            low = middle;
        else
            high = middle;
    }
    /* Of batches without photons, which begin where the next one does, the last was found. */
    const LightBatch *batch = &source->batches[low];
    if (batch->emission.light == NULL)
        return emit_line(batch, i - batch->first);
    const LightRay ray = light_emit(&batch->emission, i - batch->first);
    return (Photon){.o = ray.o, .d = ray.d, .way = ray.way, .flux = ray.flux, .batch = batch};
}

float photon_falloff(const Photon *photon, float t) {
    const SceneLight *light = photon->batch->emission.light;
    if (light == NULL || !(light->radius > 0.0f))
        return 1.0f;
    const float distance = photon->way + t;
    return distance * distance / (distance * distance + light->radius * light->radius);
}

/* Of the lamps, straight from there. */
static Rgb lamp_irradiance(const AmbScene *scene, const SurfacePoint *surface, Vec3 ng, Vec3 ns,
                           Rng rng, uint32_t *dimension) {
    const Vec3 p = scene_leave(surface, ng);
    Rgb irradiance = rgb(0, 0, 0);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const float u = rng_float(rng, (*dimension)++);
        const Sample2 at = {u, rng_float(rng, (*dimension)++)};
        const LightArrival light = light_arrival(&scene->lights[l], surface->p, at);
        const float cosine = vec3_dot(light.wi, ns);
        if (cosine > 0.0f && vec3_dot(light.wi, ng) > 0.0f && rgb_max(light.irradiance) > 0.0f &&
            !scene_is_occluded(scene, p, light.wi, light.distance))
            irradiance = rgb_add(irradiance, rgb_scale(light.irradiance, cosine));
    }
    return irradiance;
}

float photon_survival(Rgb albedo) {
    return fminf(rgb_max(albedo), 0.95f);
}

Rgb photon_surface_radiance(const AmbScene *scene, const SurfacePoint *surface, Vec3 d,
                            bool interreflects, Rng rng, uint32_t *dimension) {
    Rgb radiance = rgb(0, 0, 0), weight = rgb(1, 1, 1);
    SurfacePoint at = *surface;
    for (;;) {
        const float side = vec3_dot(d, at.ng) > 0.0f ? 1.0f : -1.0f;
        const Vec3 ng = vec3_scale(at.ng, side);
        const Vec3 ns = vec3_scale(at.ns, side);
        const Rgb lamps = lamp_irradiance(scene, &at, ng, ns, rng, dimension);
        const Rgb emission = scene_chance_emission(scene, &at);
        radiance = rgb_add(radiance, rgb_mul(weight, emission));
        const Rgb albedo = scene_albedo(scene, &at);
        weight = rgb_mul(weight, albedo);
        radiance = rgb_add(radiance, rgb_scale(rgb_mul(weight, lamps), 1.0f / AMB_PI));
        if (scene->world.is_black && !interreflects)
            break;
        Vec3 x, y;
        vec3_frame(ns, &x, &y);
        const float u = rng_float(rng, (*dimension)++);
        const Sample2 s = {u, rng_float(rng, (*dimension)++)};
        const Vec3 wi = frame_to_world(x, y, ns, sample_cosine_hemisphere(s));
        if (!(vec3_dot(wi, ng) > 0.0f))
            break;
        Hit hit;
        if (!scene_intersect(scene, scene_leave(&at, ng), wi, INFINITY, &hit)) {
            const Rgb world = world_radiance_but_lamps(&scene->world, wi);
            radiance = rgb_add(radiance, rgb_mul(weight, world));
            break;
        }
        const float survival = photon_survival(albedo);
        at = scene_surface(scene, &hit);
        if (!interreflects || at.material->surface == AMB_SURFACE_DIELECTRIC ||
            !(rng_float(rng, (*dimension)++) < survival))
            break;
        weight = rgb_scale(weight, 1.0f / survival);
        d = vec3_negate(wi);
    }
    return radiance;
}
