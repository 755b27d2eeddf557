/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where photons start. */
#include "field/scatter/photon_source.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"

/* W, mean of the channels. */
static double batch_power(const PhotonSource *source, const PhotonBatch *batch) {
    if (batch->emission.light != NULL)
        return (double)light_power_towards(&batch->emission);
    const double radius = (double)batch->emission.target_radius;
    const double pi = (double)AMB_PI;
    return (double)rgb_mean(source->world) * 4.0 * pi * pi * radius * radius;
}

static void add_batch(PhotonSource *source, const PhotonBatch *batch) {
    if (batch_power(source, batch) > 0.0)
        source->batches[source->batch_count++] = *batch;
}

static void list_batches(const AmbScene *scene, bool has_world, uint32_t seed,
                         PhotonSource *source) {
    const uint32_t world = scene->light_count; /* comes after the lamps */
    for (uint32_t l = 0; l < scene->light_count + (has_world ? 1u : 0u); ++l) {
        const SceneLight *light = l < world ? &scene->lights[l] : NULL;
        MediumStack start = {0};
        if (light != NULL && light->kind != AMB_LIGHT_SUN)
            start = scene_media_at(scene, light->position);
        for (uint32_t o = 0; o < scene->object_count; ++o) {
            const SceneObject *object = &scene->objects[o];
            /* Light that starts inside begins with the outermost object around it. */
            if (!object->is_boundary || (start.count > 0 && start.objects[0] != o))
                continue;
            const Rng rng = rng_create(seed, RNG_STAGE_PHOTON, l);
            PhotonBatch batch = {.emission = {.light = light,
                                              .target = object->center,
                                              /* A little larger: rounding must not cut the rim. */
                                              .target_radius = object->radius * 1.0001f,
                                              .distance = 2.1f * scene->radius,
                                              .count = 1,
                                              .shift_u = rng_float(rng, 0),
                                              .shift_v = rng_float(rng, 1)},
                                 .start = start,
                                 .target = o};
            if (start.count > 0)
                batch.emission.target_radius = INFINITY; /* every direction */
            add_batch(source, &batch);
        }
    }
}

/* Half by the flux, half alike: by flux alone a bead beside a statue would get none. */
static void share_photons(PhotonSource *source) {
    double total = 0.0;
    for (uint64_t b = 0; b < source->batch_count; ++b)
        total += batch_power(source, &source->batches[b]);
    double running = 0.0;
    uint64_t first = 0;
    for (uint64_t b = 0; b < source->batch_count; ++b) {
        PhotonBatch *batch = &source->batches[b];
        running += 0.5 * batch_power(source, batch) / total + 0.5 / (double)source->batch_count;
        uint64_t end = (uint64_t)((double)source->photon_count * running);
        if (b + 1 == source->batch_count)
            end = source->photon_count;
        batch->first = first;
        batch->emission.count = end > first ? end - first : 0;
        first += batch->emission.count;
    }
}

AmbStatus photon_source_create(const AmbScene *scene, uint64_t photon_count, bool has_world,
                               uint32_t seed, PhotonSource *out_source) {
    *out_source = (PhotonSource){.photon_count = photon_count, .world = scene->world};
    out_source->batches = memory_zero_array(
        ((uint64_t)scene->light_count + 1) * scene->object_count, sizeof(PhotonBatch));
    if (out_source->batches == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the plan of photons");
    list_batches(scene, has_world, seed, out_source);
    share_photons(out_source);
    if (out_source->batch_count == 0)
        out_source->photon_count = 0;
    return AMB_OK;
}

void photon_source_clear(PhotonSource *source) {
    memory_free(source->batches);
    memset(source, 0, sizeof *source);
}

static Photon emit_world(const PhotonSource *source, const PhotonBatch *batch, uint64_t i) {
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
    photon.flux = rgb_scale(source->world, share);
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
    const PhotonBatch *batch = &source->batches[low];
    if (batch->emission.light == NULL)
        return emit_world(source, batch, i - batch->first);
    const LightRay ray = light_emit(&batch->emission, i - batch->first);
    return (Photon){.o = ray.o, .d = ray.d, .flux = ray.flux, .batch = batch};
}

float photon_falloff(const Photon *photon, float t) {
    const SceneLight *light = photon->batch->emission.light;
    if (light == NULL || !(light->radius > 0.0f))
        return 1.0f;
    return t * t / (t * t + light->radius * light->radius);
}
