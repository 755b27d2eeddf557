/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that opaque surfaces send one another. */
#include "plan/plan_interreflection.h"

#include "base/memory.h"
#include "plan/scene_rules.h"

/* A probe is a few rays: next to nothing beside those that measure light in media. */
enum { PROBES = 1024, REFLECTIONS_SEEN = 2 };
/* Another sequence than the picture's own. */
static const uint32_t PROBE_SEED = 0x0ddb;

PlanEffect plan_interreflection(const AmbScene *scene, const AmbRenderParams *params) {
    const char *name = "light between opaque surfaces";
    if ((params->effects & AMB_EFFECT_INTERREFLECTION) == 0)
        return plan_skipped(name, "switched off");
    if (!scene_has_opaque_surface(scene))
        return plan_skipped(name, "no opaque surface");
    return plan_simulated(name, "opaque surfaces are there");
}

/* Two samples of a pixel: all light that does not scatter, and what surfaces send one another. */
typedef struct Probe {
    Rgb all[2], between[2];
} Probe;

typedef struct Batch {
    const AmbScene *scene;
    const PlanCrop *crop;
    CameraParams camera;
    Probe *probes;
    Job *job;
} Batch;

typedef struct Look {
    Probe *probe;
    uint32_t half;
} Look;

static void see_light(void *user, const CameraWay *way, uint32_t order, Rgb radiance) {
    (void)order;
    const Look *look = user;
    if (!rgb_is_finite(radiance))
        return;
    Probe *probe = look->probe;
    probe->all[look->half] = rgb_add(probe->all[look->half], radiance);
    if ((way->effects & AMB_EFFECT_INTERREFLECTION) != 0)
        probe->between[look->half] = rgb_add(probe->between[look->half], radiance);
}

static void see_medium(void *user, const CameraWay *way, const FieldSegment *segment,
                       uint32_t order, Rgb throughput) {
    (void)user;
    (void)way;
    (void)segment;
    (void)order;
    (void)throughput;
}

static AmbStatus run_probes(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Batch *batch = user;
    const PlanCrop *crop = batch->crop;
    for (uint64_t i = begin; i < end; ++i) {
        if (job_is_cancelled(batch->job))
            return AMB_CANCELLED;
        const Sample2 at = sample_r2(i, 0.5f, 0.5f);
        const uint32_t x = (uint32_t)(at.u * (float)crop->width);
        const uint32_t y = (uint32_t)(at.v * (float)crop->height);
        Probe *probe = &batch->probes[i];
        *probe = (Probe){.all = {{0, 0, 0}, {0, 0, 0}}};
        for (uint32_t half = 0; half < 2; ++half) {
            Look look = {.probe = probe, .half = half};
            const CameraObserver observer = {
                .user = &look, .see_medium = see_medium, .see_light = see_light};
            camera_observe(batch->scene, &observer, &batch->camera,
                           crop->x + (x < crop->width ? x : crop->width - 1),
                           crop->y + (y < crop->height ? y : crop->height - 1),
                           (uint32_t)(2 * i + half));
        }
    }
    return AMB_OK;
}

/* In the order of the probes, so that sums have the same bits for any number of threads. */
static Share find_share(const Probe probes[], uint64_t count) {
    ShareSum sum = {.square = 0.0};
    double all = 0.0, all_square = 0.0;
    for (uint64_t i = 0; i < count; ++i) {
        const double mean =
            0.5 * ((double)rgb_mean(probes[i].all[0]) + (double)rgb_mean(probes[i].all[1]));
        all += mean;
        all_square += mean * mean;
        share_add(&sum, 1.0, probes[i].between[0], probes[i].between[1]);
    }
    const double n = (double)count;
    all /= n;
    const double variance = fmax(all_square / n - all * all, 0.0);
    return share_estimate(&sum, count, all, all > 0.0 ? sqrt(variance / (n - 1.0)) / all : 0.0);
}

AmbStatus plan_measure_interreflection(const AmbScene *scene, const AmbRenderParams *params,
                                       const PlanCrop *crop, Job *job, Plan *plan) {
    PlanEffect *effect = &plan->effects[PLAN_INTERREFLECTION];
    if (!effect->is_simulated || !plan->is_automatic)
        return AMB_OK;
    const uint32_t effects = AMB_EFFECT_SURFACE_REFLECTION | AMB_EFFECT_BACKGROUND |
                             AMB_EFFECT_CAUSTICS | AMB_EFFECT_INTERREFLECTION;
    Batch batch = {.scene = scene,
                   .crop = crop,
                   .camera = {.width = params->width,
                              .height = params->height,
                              .effects = params->effects & effects,
                              .bounces = REFLECTIONS_SEEN,
                              .shines_through = plan->effects[PLAN_LIGHT_ON_SURFACES].is_simulated,
                              .seed = params->seed ^ PROBE_SEED,
                              .film_transparent = params->film_transparent != 0,
                              .may_start_inside = scene_may_start_inside(scene),
                              .replicas = 2,
                              .job = job},
                   .job = job};
    batch.probes = memory_alloc_array(PROBES, sizeof *batch.probes);
    if (batch.probes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    const AmbStatus status = parallel_for(job, PROBES, 16, run_probes, &batch);
    if (status == AMB_OK) {
        effect->share = find_share(batch.probes, PROBES);
        effect->is_simulated = effect->share.is_known && effect->share.high > plan->share_min;
        effect->reason = effect->is_simulated ? "large enough to show" : "too small to show";
        effect->rest = effect->is_simulated ? (Share){.is_known = true} : effect->share;
    }
    memory_free(batch.probes);
    return status;
}
