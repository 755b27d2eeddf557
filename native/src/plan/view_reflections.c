/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where later reflections are seen. */
#include "plan/view_reflections.h"

#include "base/memory.h"

/* Pixels that are looked at, at most. One reflection is seen nearly everywhere, and what goes round
 * for longer is seen where sixteen are. */
enum { PIXELS_MAX = 1024, BOUNCES_MIN = 2, BOUNCES_MAX = 16 };

/* What a pixel's path sees after several reflections. */
typedef struct Reflected {
    float media;  /* throughputs at stretches in scattering media, more for more reflections */
    float around; /* radiance of the surroundings, likewise */
} Reflected;

typedef struct Weighing {
    const AmbScene *scene;
    const CameraParams *camera;
    const View *view;
    uint64_t stride;
    Reflected *found; /* by every stride-th pixel */
    Job *job;
} Weighing;

static void see_medium(void *user, const CameraWay *way, const FieldSegment *segment,
                       uint32_t order, Rgb throughput) {
    (void)segment;
    (void)order;
    Reflected *reflected = user;
    if (way->bounces >= BOUNCES_MIN)
        reflected->media += (float)way->bounces * rgb_mean(throughput);
}

static void see_light(void *user, const CameraWay *way, uint32_t order, Rgb radiance) {
    (void)order;
    Reflected *reflected = user;
    if (way->bounces >= BOUNCES_MIN && rgb_is_finite(radiance))
        reflected->around += (float)way->bounces * rgb_mean(radiance);
}

static AmbStatus look(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Weighing *weighing = user;
    for (uint64_t i = begin; i < end; ++i) {
        if (job_is_cancelled(weighing->job))
            return AMB_CANCELLED;
        const ViewPixel *pixel = &weighing->view->pixels[i * weighing->stride];
        const CameraObserver observer = {
            .user = &weighing->found[i], .see_medium = see_medium, .see_light = see_light};
        camera_observe(weighing->scene, &observer, weighing->camera, pixel->x, pixel->y, 0);
    }
    return AMB_OK;
}

/* Sums up to each pixel, of both parts alike. */
static void accumulate(const Weighing *weighing, uint64_t count, View *view) {
    double media = 0.0, around = 0.0;
    for (uint64_t i = 0; i < count; ++i) {
        media += (double)weighing->found[i].media;
        around += (double)weighing->found[i].around;
    }
    double sum = 0.0;
    for (uint64_t i = 0; i < view->count; ++i) {
        if (i % weighing->stride == 0) {
            const Reflected *reflected = &weighing->found[i / weighing->stride];
            sum += media > 0.0 ? (double)reflected->media / media : 0.0;
            sum += around > 0.0 ? (double)reflected->around / around : 0.0;
        }
        view->reflections[i] = sum;
    }
}

AmbStatus view_weigh_reflections(const AmbScene *scene, const CameraParams *camera, Job *job,
                                 View *view) {
    CameraParams params = *camera;
    params.effects = AMB_EFFECT_BACKGROUND;
    params.bounces = BOUNCES_MAX;
    Weighing weighing = {.scene = scene,
                         .camera = &params,
                         .view = view,
                         .stride = (view->count + PIXELS_MAX - 1) / PIXELS_MAX,
                         .job = job};
    if (view->count == 0)
        return AMB_OK;
    const uint64_t count = (view->count + weighing.stride - 1) / weighing.stride;
    weighing.found = memory_zero_array(count, sizeof *weighing.found);
    view->reflections = memory_alloc_array(view->count, sizeof *view->reflections);
    AmbStatus status = AMB_OK;
    if (weighing.found == NULL || view->reflections == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    if (status == AMB_OK)
        status = parallel_for(job, count, 16, look, &weighing);
    if (status == AMB_OK)
        accumulate(&weighing, count, view);
    memory_free(weighing.found);
    return status;
}
