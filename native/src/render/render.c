/* SPDX-License-Identifier: GPL-3.0-or-later
 * The session. */
#include "render/render.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

#include "base/memory.h"

const char *const STAGE_NAMES[STAGE_COUNT] = {"scene", "light", "field", "camera"};

/* Share of the progress bar: what stages cost in an ordinary render. */
static const float STAGE_BEGIN[STAGE_COUNT + 1] = {0.0f, 0.02f, 0.08f, 0.15f, 1.0f};

enum { TILE = 8, ROUND_MAX = 16 };

/* One pass over all pixels. */
typedef struct Round {
    AmbRender *render;
    const Field *field;
    uint32_t first, count; /* samples */
    uint32_t tiles_x;
} Round;

static void set_stage(AmbRender *render, uint32_t stage) {
    /* First, so that no reader takes the last stage's count for the new one's. */
    atomic_store(&render->job.work_total, 0);
    atomic_store(&render->job.work_done, 0);
    pthread_mutex_lock(&render->lock);
    render->stage = stage;
    pthread_mutex_unlock(&render->lock);
}

static AmbStatus zero_rows(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    film_zero_rows(user, (uint32_t)begin, (uint32_t)end);
    return AMB_OK;
}

static AmbStatus render_pixel(const Round *round, uint32_t x, uint32_t y) {
    AmbRender *render = round->render;
    FilmPixel sum = {.count = round->count};
    for (uint32_t i = 0; i < round->count; ++i) {
        if (job_is_cancelled(&render->job))
            return AMB_CANCELLED;
        const CameraSample sample =
            camera_sample(render->scene, round->field, &render->plan.camera, render->crop_x + x,
                          render->crop_y + y, round->first + i);
        sum.single = rgb_add(sum.single, sample.single);
        sum.surface = rgb_add(sum.surface, sample.surface);
        sum.alpha += sample.alpha;
        sum.frequency += sample.frequency;
        sum.contribution += sample.contribution;
        if (i == 0)
            sum.depth = sample.depth;
        if (sample.leak_count > 0)
            atomic_fetch_add(&render->camera_leak_count, sample.leak_count);
    }
    film_add(&render->film, x, y, &sum);
    return AMB_OK;
}

static AmbStatus render_tiles(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Round *round = user;
    const Film *film = &round->render->film;
    for (uint64_t tile = begin; tile < end; ++tile) {
        const uint32_t x0 = (uint32_t)(tile % round->tiles_x) * TILE;
        const uint32_t y0 = (uint32_t)(tile / round->tiles_x) * TILE;
        for (uint32_t y = y0; y < y0 + TILE && y < film->height; ++y)
            for (uint32_t x = x0; x < x0 + TILE && x < film->width; ++x)
                AMB_TRY(render_pixel(round, x, y));
        atomic_fetch_add(&round->render->job.work_done, round->count);
    }
    return AMB_OK;
}

/* All pixels get a few samples, then more of them: there is soon a whole picture to look at. The
 * division into rounds depends on the number of samples alone. */
static AmbStatus run_camera(AmbRender *render, const Field *field) {
    const Film *film = &render->film;
    Round round = {.render = render, .field = field, .tiles_x = (film->width + TILE - 1) / TILE};
    const uint64_t tiles = (uint64_t)round.tiles_x * ((film->height + TILE - 1) / TILE);
    atomic_store(&render->job.work_total, tiles * render->params.samples);
    while (round.first < render->params.samples) {
        const uint32_t rest = render->params.samples - round.first;
        round.count = round.first > 1 ? round.first : 1;
        round.count = round.count < ROUND_MAX ? round.count : ROUND_MAX;
        round.count = round.count < rest ? round.count : rest;
        AMB_TRY(parallel_for(&render->job, tiles, 1, render_tiles, &round));
        round.first += round.count;
        pthread_mutex_lock(&render->lock);
        render->samples_done = round.first;
        pthread_mutex_unlock(&render->lock);
    }
    return AMB_OK;
}

static uint64_t light_bytes(const LightField *light) {
    uint64_t bytes = 0;
    for (uint32_t o = 0; o < light->object_count; ++o)
        bytes += light->objects[o].count * sizeof(LightBeam);
    return bytes;
}

typedef struct StageClock {
    double wall, cpu, helpers;
} StageClock;

static StageClock clock_stage(const AmbRender *render) {
    return (StageClock){clock_wall(), clock_thread_cpu(),
                        1e-9 * (double)atomic_load(&render->job.cpu_ns)};
}

static void charge_stage(AmbRender *render, uint32_t stage, StageClock begin) {
    const StageClock end = clock_stage(render);
    render->costs[stage].wall = end.wall - begin.wall;
    render->costs[stage].cpu = end.cpu - begin.cpu + end.helpers - begin.helpers;
}

static AmbStatus run_scene(AmbRender *render) {
    set_stage(render, STAGE_SCENE);
    const StageClock begin = clock_stage(render);
    const double process = clock_process_cpu();
    AmbStatus status = scene_build(render->scene, &render->job);
    if (status == AMB_OK)
        status = plan_create(render->scene, &render->params, &render->job, &render->plan);
    charge_stage(render, STAGE_SCENE, begin);
    /* Embree builds on threads of its own: the process's clock sees them. */
    render->costs[STAGE_SCENE].cpu = clock_process_cpu() - process;
    if (status == AMB_OK) {
        render->has_plan = true;
        render->scene_bytes = scene_bytes(render->scene);
    }
    return status;
}

static AmbStatus run_light(AmbRender *render, LightField *out_light) {
    set_stage(render, STAGE_LIGHT);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        light_trace(render->scene, &render->plan.light, &render->job, out_light);
    charge_stage(render, STAGE_LIGHT, begin);
    if (status == AMB_OK) {
        render->ray_count = out_light->ray_count;
        render->light_leak_count = out_light->leak_count;
        render->tally = out_light->tally;
        render->light_bytes = light_bytes(out_light);
    }
    return status;
}

static AmbStatus run_field(AmbRender *render, const LightField *light, Field **out_field) {
    set_stage(render, STAGE_FIELD);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        field_create(render->scene, light, &render->plan.field, &render->job, out_field);
    charge_stage(render, STAGE_FIELD, begin);
    if (status == AMB_OK) {
        render->light_sample_count = field_sample_count(*out_field);
        field_tally(*out_field, &render->tally, &render->light_leak_count);
        render->field_bytes = field_bytes(*out_field);
    }
    return status;
}

static AmbStatus run_stages(AmbRender *render) {
    AMB_TRY(parallel_for(&render->job, render->film.height, 16, zero_rows, &render->film));
    AMB_TRY(run_scene(render));
    Field *field = NULL;
    if (render->plan.effects[PLAN_SINGLE_SCATTERING].is_simulated) {
        LightField light = {.object_count = 0};
        /* The others refract at the mesh's own triangles: no light ray is traced for them. */
        if (render->plan.estimator == AMB_ESTIMATOR_POINTS_FIXED ||
            render->plan.estimator == AMB_ESTIMATOR_POINTS_COVARIANCE)
            AMB_TRY(run_light(render, &light));
        const AmbStatus status = run_field(render, &light, &field);
        light_field_clear(&light);
        AMB_TRY(status);
    }
    set_stage(render, STAGE_CAMERA);
    const StageClock begin = clock_stage(render);
    const AmbStatus status = run_camera(render, field);
    charge_stage(render, STAGE_CAMERA, begin);
    field_destroy(field);
    return status;
}

static void *render_main(void *user) {
    AmbRender *render = user;
    status_enter("amb_render_wait");
    const AmbStatus status = run_stages(render);
    pthread_mutex_lock(&render->lock);
    render->status = status;
    if (status == AMB_OK) {
        render->state = AMB_STATE_DONE;
    } else if (status == AMB_CANCELLED) {
        render->state = AMB_STATE_CANCELLED;
        status_record(AMB_CANCELLED, "the render was cancelled");
    } else {
        render->state = AMB_STATE_FAILED;
    }
    status_copy_record(&render->error);
    render->elapsed = clock_wall() - render->start;
    struct rusage usage;
    getrusage(RUSAGE_SELF, &usage);
    render->peak_rss_bytes = 1024 * (uint64_t)usage.ru_maxrss;
    pthread_cond_broadcast(&render->ended_changed);
    pthread_mutex_unlock(&render->lock);
    return NULL;
}

static void init_lock(AmbRender *render) {
    pthread_mutex_init(&render->lock, NULL);
    pthread_condattr_t attributes;
    pthread_condattr_init(&attributes);
    pthread_condattr_setclock(&attributes, CLOCK_MONOTONIC);
    pthread_cond_init(&render->ended_changed, &attributes);
    pthread_condattr_destroy(&attributes);
}

static void release(AmbRender *render) {
    film_clear(&render->film);
    pthread_cond_destroy(&render->ended_changed);
    pthread_mutex_destroy(&render->lock);
    memory_free(render);
}

AmbStatus render_start(AmbScene *scene, const AmbRenderParams *params, AmbRender **out_render) {
    AMB_TRY(plan_check(params));
    AmbRender *render = memory_zero_array(1, sizeof *render);
    if (render == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a render");
    init_lock(render);
    render->scene = scene;
    render->params = *params;
    uint32_t width = params->width, height = params->height;
    if (params->crop_width > 0) {
        render->crop_x = params->crop_x;
        render->crop_y = params->crop_y;
        width = params->crop_width;
        height = params->crop_height;
    }
    job_init(&render->job, params->threads);
    atomic_init(&render->camera_leak_count, 0);
    render->start = clock_wall();
    AmbStatus status = film_create(width, height, &render->film);
    if (status == AMB_OK && pthread_create(&render->thread, NULL, render_main, render) != 0)
        status = status_fail(AMB_OUT_OF_MEMORY, "no thread for a render");
    if (status != AMB_OK) {
        release(render);
        return status;
    }
    *out_render = render;
    return AMB_OK;
}

void render_progress(AmbRender *render, AmbProgress *out_progress) {
    const uint64_t done = atomic_load(&render->job.work_done);
    const uint64_t total = atomic_load(&render->job.work_total);
    pthread_mutex_lock(&render->lock);
    const uint32_t stage = render->stage;
    const float inside = total > 0 ? fminf((float)done / (float)total, 1.0f) : 0.0f;
    const float fraction =
        STAGE_BEGIN[stage] + inside * (STAGE_BEGIN[stage + 1] - STAGE_BEGIN[stage]);
    render->fraction = fmaxf(render->fraction, fraction);
    if (render->state == AMB_STATE_DONE)
        render->fraction = 1.0f;
    const bool is_running = render->state == AMB_STATE_RUNNING;
    out_progress->state = render->state;
    out_progress->fraction = render->fraction;
    out_progress->elapsed = (float)(is_running ? clock_wall() - render->start : render->elapsed);
    out_progress->samples_done = render->samples_done;
    pthread_mutex_unlock(&render->lock);

    static const char *const details[STAGE_COUNT] = {"Building the ray accelerator",
                                                     "Tracing light into the media",
                                                     "Placing volume samples", "Sample"};
    if (!is_running)
        snprintf(out_progress->stage, sizeof out_progress->stage, "done");
    else
        snprintf(out_progress->stage, sizeof out_progress->stage, "%s", STAGE_NAMES[stage]);
    if (stage == STAGE_CAMERA)
        snprintf(out_progress->detail, sizeof out_progress->detail, "Sample %u/%u",
                 out_progress->samples_done, render->params.samples);
    else
        snprintf(out_progress->detail, sizeof out_progress->detail, "%s", details[stage]);
}

void render_cancel(AmbRender *render) {
    atomic_store(&render->job.cancelled, true);
}

AmbStatus render_wait(AmbRender *render, double timeout, bool *out_ended) {
    struct timespec deadline;
    clock_gettime(CLOCK_MONOTONIC, &deadline);
    const double limit = fmax(0.0, timeout < 1e9 ? timeout : 1e9);
    const double nanoseconds = (limit - (double)(time_t)limit) * 1e9 + (double)deadline.tv_nsec;
    deadline.tv_sec += (time_t)limit + (time_t)(nanoseconds / 1e9);
    deadline.tv_nsec = (long)(nanoseconds - 1e9 * (double)(time_t)(nanoseconds / 1e9));

    pthread_mutex_lock(&render->lock);
    int waited = 0;
    while (render->state == AMB_STATE_RUNNING && waited != ETIMEDOUT) {
        if (timeout < 0.0)
            waited = pthread_cond_wait(&render->ended_changed, &render->lock);
        else
            waited = pthread_cond_timedwait(&render->ended_changed, &render->lock, &deadline);
    }
    *out_ended = render->state != AMB_STATE_RUNNING;
    const AmbStatus status = *out_ended ? render->status : AMB_OK;
    if (status != AMB_OK)
        status_set_record(&render->error);
    pthread_mutex_unlock(&render->lock);
    return status;
}

void render_destroy(AmbRender *render) {
    render_cancel(render);
    pthread_join(render->thread, NULL);
    release(render);
}
