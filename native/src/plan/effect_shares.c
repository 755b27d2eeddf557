/* SPDX-License-Identifier: GPL-3.0-or-later
 * The shares of the effects in the picture. */
#include "plan/effect_shares.h"

#include <string.h>

#include "base/memory.h"

/* Objects that one probe tells apart; the last one stands for all others. */
enum { TOUCHED_MAX = 8 };

/* Of the least share: light of less is gathered by chance. */
static const double GATHER_PART = 0.5;

/* What one probe finds of one object, by its two samples. */
typedef struct Touched {
    uint32_t object;
    Rgb halves[SHARE_COUNT][2];
} Touched;

typedef struct ProbeResult {
    double weight;
    Rgb radiance[2];
    EffectWork work; /* of both samples */
    uint32_t touched_count;
    Touched touched[TOUCHED_MAX];
} ProbeResult;

typedef struct Batch {
    const EffectProbe *probe;
    uint64_t first;
    ProbeResult *results;
    Job *job;
} Batch;

/* One sample of a probe on its way. */
typedef struct Look {
    const EffectProbe *probe;
    ProbeResult *result;
    double flux; /* of all light in media */
    Rng rng;     /* of gathers, */
    uint32_t dimension;
    uint32_t half;
} Look;

static Touched *touch(ProbeResult *result, uint32_t object) {
    for (uint32_t i = 0; i < result->touched_count; ++i)
        if (result->touched[i].object == object)
            return &result->touched[i];
    if (result->touched_count == TOUCHED_MAX)
        return &result->touched[TOUCHED_MAX - 1];
    Touched *touched = &result->touched[result->touched_count++];
    memset(touched, 0, sizeof *touched);
    touched->object = object;
    return touched;
}

static void add(Touched *touched, uint32_t half, uint32_t share, Rgb radiance) {
    Rgb *sum = &touched->halves[share][half];
    *sum = rgb_add(*sum, radiance);
}

static void add_way(const Look *look, Touched *touched, const CameraWay *way, Rgb radiance) {
    if (way->returns)
        add(touched, look->half, SHARE_RETURN, radiance);
    if ((way->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0)
        add(touched, look->half, SHARE_SURFACE_REFLECTION, radiance);
    if ((way->effects & AMB_EFFECT_BACKGROUND) != 0)
        add(touched, look->half, SHARE_BACKGROUND, radiance);
    const uint32_t step = bounce_step(way->bounces, CAMERA_STEP_COUNT);
    if (step > 0)
        add(touched, look->half, SHARE_CAMERA_BOUNCES + step - 1, radiance);
    Rgb *sum = &look->result->radiance[look->half];
    *sum = rgb_add(*sum, radiance);
}

/* Counts something that a path or a walk does after so many scatterings. */
static void count(EffectWork *work, const CameraWay *way, uint32_t order, bool is_stretch) {
    if (order > 0) {
        *(!is_stretch ? &work->escapes : order == 1 ? &work->second : &work->later) += 1.0;
        return;
    }
    (is_stretch ? work->stretches : work->arrivals)[bounce_step(way->bounces, CAMERA_STEP_COUNT)] +=
        1.0;
    work->mirrored += (way->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0 ? 1.0 : 0.0;
    work->behind += (way->effects & AMB_EFFECT_BACKGROUND) != 0 ? 1.0 : 0.0;
}

static uint32_t order_share(uint32_t order) {
    return order == 1 ? SHARE_SINGLE : order == 2 ? SHARE_DOUBLE : SHARE_MULTIPLE;
}

static void see_light(void *user, const CameraWay *way, uint32_t order, Rgb radiance) {
    const Look *look = user;
    /* The same arrival, once more. */
    if ((way->effects & AMB_EFFECT_INTERREFLECTION) == 0 && !way->returns)
        count(&look->result->work, way, order, false);
    if (!rgb_is_finite(radiance))
        return;
    if (way->object == UINT32_MAX) {
        Rgb *sum = &look->result->radiance[look->half];
        *sum = rgb_add(*sum, radiance);
        return;
    }
    Touched *touched = touch(look->result, way->object);
    if (order > 0) {
        add(touched, look->half, order_share(order), radiance);
        add(touched, look->half, SHARE_WORLD_LIGHT, radiance);
    }
    add_way(look, touched, way, radiance);
}

/* Gathers take most of a probe's time, and most of them find next to nothing: what is far too
 * little to show, by a path's throughput and the flux of a kind of light, is looked for by chance
 * in proportion, and counts for as much more. 0: it is not. */
static float gathers(Look *look, uint32_t class, Rgb throughput) {
    const double part =
        class > 0 && look->flux > 0.0 ? look->probe->light->flux[class] / look->flux : 1.0;
    const double least = GATHER_PART * look->probe->share_min;
    const double chance = part * (double)rgb_max(throughput) / least;
    if (chance >= 1.0)
        return 1.0f;
    return (double)rng_float(look->rng, look->dimension++) < chance ? (float)(1.0 / chance) : 0.0f;
}

static void see_medium(void *user, const CameraWay *way, const FieldSegment *segment,
                       uint32_t order, Rgb throughput) {
    Look *look = user;
    if (!way->returns)
        count(&look->result->work, way, order, true);
    Touched *touched = touch(look->result, segment->object);
    for (uint32_t c = 0; c < LIGHT_CLASS_COUNT; ++c) {
        const Field *field = look->probe->light->fields[c];
        const float weight = field != NULL ? gathers(look, c, throughput) : 0.0f;
        if (!(weight > 0.0f))
            continue;
        const Rgb radiance =
            rgb_scale(rgb_mul(throughput, field_gather(field, segment).radiance), weight);
        if (!rgb_is_finite(radiance))
            continue;
        add(touched, look->half, order_share(order + 1), radiance);
        if (c == LIGHT_CLASS_PASSED)
            add(touched, look->half, SHARE_TRANSMITTED, radiance);
        else if (c > 0)
            add(touched, look->half, SHARE_LIGHT_BOUNCES + c - 1, radiance);
        add_way(look, touched, way, radiance);
    }
}

/* From light of exactly one step to light of this step and all beyond. */
static void sum_steps(Touched *touched, uint32_t first, uint32_t step_count) {
    for (uint32_t half = 0; half < 2; ++half)
        for (uint32_t step = step_count - 2; step > 0; --step)
            add(touched, half, first + step - 1, touched->halves[first + step][half]);
}

static AmbStatus run_probes(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Batch *batch = user;
    const EffectProbe *probe = batch->probe;
    double flux = 0.0;
    for (uint32_t c = 0; c < LIGHT_CLASS_COUNT; ++c)
        flux += probe->light->flux[c];
    for (uint64_t i = begin; i < end; ++i) {
        if (job_is_cancelled(batch->job))
            return AMB_CANCELLED;
        ProbeResult *result = &batch->results[i];
        const ViewProbe at = view_probe(probe->view, batch->first + i);
        *result = (ProbeResult){.weight = at.weight};
        for (uint32_t half = 0; half < 2; ++half) {
            const uint64_t path = 2 * (batch->first + i) + half;
            Look look = {.probe = probe,
                         .result = result,
                         .flux = flux,
                         .rng = rng_create(probe->camera.seed, RNG_STAGE_PROBE, path),
                         .half = half};
            const CameraObserver observer = {
                .user = &look, .see_medium = see_medium, .see_light = see_light};
            camera_observe(probe->scene, &observer, &probe->camera, at.pixel.x, at.pixel.y,
                           (uint32_t)path);
        }
        for (uint32_t t = 0; t < result->touched_count; ++t) {
            sum_steps(&result->touched[t], SHARE_CAMERA_BOUNCES, CAMERA_STEP_COUNT);
            sum_steps(&result->touched[t], SHARE_LIGHT_BOUNCES, LIGHT_STEP_COUNT);
        }
    }
    return AMB_OK;
}

/* In the order of the probes, so that sums have the same bits for any number of threads. */
static void add_result(EffectShares *shares, const ProbeResult *result) {
    const double radiance =
        0.5 * result->weight *
        ((double)rgb_mean(result->radiance[0]) + (double)rgb_mean(result->radiance[1]));
    shares->radiance_sum += radiance;
    shares->radiance_square_sum += radiance * radiance;
    effect_work_add(&shares->work_sum, 0.5 * result->weight, &result->work);
    for (uint32_t e = 0; e < SHARE_COUNT; ++e) {
        Rgb all[2] = {{0, 0, 0}, {0, 0, 0}};
        for (uint32_t t = 0; t < result->touched_count; ++t) {
            const Touched *touched = &result->touched[t];
            for (uint32_t half = 0; half < 2; ++half)
                all[half] = rgb_add(all[half], touched->halves[e][half]);
            share_add(&shares->objects[(uint64_t)touched->object * SHARE_COUNT + e], result->weight,
                      touched->halves[e][0], touched->halves[e][1]);
        }
        share_add(&shares->image[e], result->weight, all[0], all[1]);
    }
    ++shares->probe_count;
}

AmbStatus effect_shares_create(const AmbScene *scene, EffectShares *out_shares) {
    *out_shares = (EffectShares){.object_count = scene->object_count};
    out_shares->objects =
        memory_zero_array((uint64_t)scene->object_count * SHARE_COUNT, sizeof(ShareSum));
    if (out_shares->objects == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    return AMB_OK;
}

void effect_shares_clear(EffectShares *shares) {
    memory_free(shares->objects);
    memset(shares, 0, sizeof *shares);
}

AmbStatus effect_shares_measure(EffectShares *shares, const EffectProbe *probe, uint64_t count,
                                Job *job) {
    Batch batch = {.probe = probe, .first = shares->probe_count, .job = job};
    batch.results = memory_alloc_array(count, sizeof *batch.results);
    if (batch.results == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    const AmbStatus status = parallel_for(job, count, 4, run_probes, &batch);
    if (status == AMB_OK) {
        for (uint64_t i = 0; i < count; ++i)
            add_result(shares, &batch.results[i]);
        const double n = (double)shares->probe_count;
        const double mean = shares->radiance_sum / n;
        const double variance = fmax(shares->radiance_square_sum / n - mean * mean, 0.0);
        shares->radiance = mean;
        shares->radiance_error = mean > 0.0 && n > 1.0 ? sqrt(variance / (n - 1.0)) / mean : 0.0;
    }
    memory_free(batch.results);
    return status;
}

EffectWork effect_work(const EffectShares *shares) {
    EffectWork work = {.second = 0.0};
    if (shares->probe_count > 0)
        effect_work_add(&work, 1.0 / (double)shares->probe_count, &shares->work_sum);
    return work;
}

double effect_noise(const EffectShares *shares, uint32_t share) {
    if (shares->probe_count == 0 || !(shares->radiance > 0.0))
        return 0.0;
    return sqrt(shares->image[share].variance / (double)shares->probe_count) / shares->radiance;
}

static Share estimate(const EffectShares *shares, const ShareSum *sums, uint32_t share) {
    return share_estimate(&sums[share], shares->probe_count, shares->radiance,
                          shares->radiance_error);
}

/* Few walks scatter three times, and those few bring much: 256 probes that miss them find a third
 * of their light and take that for all. The first two orders are known better, and from one to the
 * next light falls off no faster than between these two, for what scattered often is spread wider
 * and is lost less: over the scenes of tests/images/planner_scenes.py the third order and later
 * ones have 0.9 to 20 times the share that follows. */
static void raise_to_series(Share *share, const Share *once, const Share *twice) {
    if (!share->is_known || !(share->value > 0.0) || !(once->value > 0.0))
        return;
    const double least = twice->value * fmin(twice->value / once->value, 1.0);
    share->value = fmax(share->value, least);
    share->high = fmax(share->high, share->value);
}

static Share estimate_with_series(const EffectShares *shares, const ShareSum *sums,
                                  uint32_t share) {
    Share result = estimate(shares, sums, share);
    if (share == SHARE_MULTIPLE) {
        const Share once = estimate(shares, sums, SHARE_SINGLE);
        const Share twice = estimate(shares, sums, SHARE_DOUBLE);
        raise_to_series(&result, &once, &twice);
    }
    return result;
}

Share effect_share(const EffectShares *shares, uint32_t share) {
    return estimate_with_series(shares, shares->image, share);
}

Share effect_share_of(const EffectShares *shares, uint32_t object, uint32_t share) {
    return estimate_with_series(shares, shares->objects + (uint64_t)object * SHARE_COUNT, share);
}
