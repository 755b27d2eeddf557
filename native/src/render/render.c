/* SPDX-License-Identifier: GPL-3.0-or-later
 * The session. */
#include "render/render.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

#include "base/memory.h"
#include "render/accuracy_caustics.h"
#include "render/accuracy_field.h"
#include "render/accuracy_scatter.h"
#include "render/report.h"

const char *const STAGE_NAMES[STAGE_COUNT] = {"scene", "light", "field", "camera"};

/* Share of the progress bar: what stages cost in an ordinary render. */
static const float STAGE_BEGIN[STAGE_COUNT + 1] = {0.0f, 0.02f, 0.08f, 0.15f, 1.0f};

enum { TILE = 8, COARSE_STEP = TILE, ROUND_MAX = 16 };
_Static_assert((int)TILE == 8, "unzip takes three bits of each");
_Static_assert((int)CAMERA_ORDER_COUNT == (int)FILM_ORDER_COUNT, "a pass for each order");
_Static_assert((int)CAMERA_PART_COUNT == (int)FILM_PART_COUNT, "a sum for each part");
_Static_assert((int)CAMERA_PART_CAUSTICS == (int)FILM_PART_CAUSTICS, "film_error.h knows it");
_Static_assert((int)CAMERA_PART_INTERREFLECTION == (int)FILM_PART_INTERREFLECTION, "likewise");

/* One pass over all pixels. */
typedef struct Round {
    AmbRender *render;
    const Field *field;
    uint32_t total;         /* samples that each pixel has after it, */
    uint32_t step;          /* of every step-th pixel of a row and of a column; */
    const uint32_t *quotas; /* or if not NULL, samples to add by pixel */
    uint32_t tiles_x;
} Round;

static void set_stage(AmbRender *render, uint32_t stage) {
    /* First, so that no reader takes the last stage's count for the new one's. */
    atomic_store(&render->job.work_total, 0);
    atomic_store(&render->job.work_done, 0);
    pthread_mutex_lock(&render->lock);
    render->stage = stage;
    render->stage_start = clock_wall();
    pthread_mutex_unlock(&render->lock);
}

static AmbStatus zero_rows(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    film_zero_rows(user, (uint32_t)begin, (uint32_t)end);
    return AMB_OK;
}

/* Two halves of a pixel's samples tell their error. Under a target they are the two replicas of
 * its sequence, else what comes before and after the middle: the sequence is one. */
static bool is_first_half(const AmbRender *render, uint32_t sample) {
    return render->accuracy.target > 0.0f ? sample % 2 == 0 : sample < render->params.samples / 2;
}

/* As scene_leaks_add: the same for any order of threads. */
static void add_leaks(AmbRender *render, const SceneLeaks *leaks) {
    uint_least32_t first = atomic_load(&render->camera_leak_object);
    while (leaks->object < first &&
           !atomic_compare_exchange_weak(&render->camera_leak_object, &first, leaks->object))
        continue;
    /* Last: who reads a count reads an object after it. */
    atomic_fetch_add(&render->camera_leak_count, leaks->count);
}

static void add_sample(AmbRender *render, const CameraSample *sample, uint32_t index, bool is_first,
                       FilmPixel *sum) {
    for (int k = 0; k < CAMERA_ORDER_COUNT; ++k)
        sum->orders[k] = rgb_add(sum->orders[k], sample->orders[k]);
    sum->surface = rgb_add(sum->surface, sample->surface);
    sum->lamps = rgb_add(sum->lamps, sample->lamps);
    sum->albedo = rgb_add(sum->albedo, sample->albedo);
    sum->normal = vec3_add(sum->normal, sample->normal);
    for (int k = 0; k < CAMERA_PART_COUNT; ++k)
        sum->parts[k] += sample->parts[k];
    sum->alpha += sample->alpha;
    sum->frequency += sample->frequency;
    sum->contribution += sample->contribution;
    sum->object_count += sample->is_object ? 1 : 0;
    if (is_first_half(render, index)) {
        sum->half = rgb_add(sum->half, camera_sample_sum(sample));
        ++sum->half_count;
    }
    if (is_first)
        sum->depth = sample->depth;
    if (sample->leaks.count > 0)
        add_leaks(render, &sample->leaks);
}

static uint32_t samples_to_add(const Round *round, uint32_t x, uint32_t y) {
    const Film *film = &round->render->film;
    const uint64_t pixel = (uint64_t)y * film->width + x;
    if (round->quotas != NULL)
        return round->quotas[pixel];
    if (x % round->step != 0 || y % round->step != 0)
        return 0;
    return round->total - film->pixels[pixel].count;
}

/* Of one tile: what is asked for and not yet seen, and the sums so far. */
typedef struct TileWork {
    const Round *round;
    CameraRequest requests[CAMERA_BATCH]; /* in the full image */
    uint32_t owners[CAMERA_BATCH];        /* their pixels in the tile */
    uint32_t count;
    FilmPixel sums[TILE * TILE];
} TileWork;

static AmbStatus see_requests(TileWork *work) {
    AmbRender *render = work->round->render;
    CameraSample samples[CAMERA_BATCH];
    AMB_TRY(camera_samples(render->scene, work->round->field, &render->plan.camera, work->requests,
                           work->count, samples));
    for (uint32_t i = 0; i < work->count; ++i) {
        FilmPixel *sum = &work->sums[work->owners[i]];
        add_sample(render, &samples[i], work->requests[i].index, sum->count == 0, sum);
        ++sum->count;
    }
    work->count = 0;
    return AMB_OK;
}

static AmbStatus ask_for_pixel(TileWork *work, uint32_t x, uint32_t y, uint32_t owner,
                               uint32_t count) {
    const AmbRender *render = work->round->render;
    const FilmPixel *pixel = &render->film.pixels[(uint64_t)y * render->film.width + x];
    for (uint32_t i = 0; i < count; ++i) {
        /* The first that sees any light speaks for the pixel. */
        const bool is_told = pixel->contribution > 0.0f || work->sums[owner].contribution > 0.0f;
        work->requests[work->count] =
            (CameraRequest){render->crop_x + x, render->crop_y + y, pixel->count + i, !is_told};
        work->owners[work->count++] = owner;
        if (work->count == CAMERA_BATCH)
            AMB_TRY(see_requests(work));
    }
    return AMB_OK;
}

/* Every second bit. */
static uint32_t unzip(uint32_t v) {
    return (v & 1) | (v >> 1 & 2) | (v >> 2 & 4);
}

/* Pixels in the order of a quadtree: samples that follow one another are neighbours. */
static AmbStatus render_tile(const Round *round, uint32_t x0, uint32_t y0, uint64_t *out_samples) {
    AmbRender *render = round->render;
    const uint32_t width = render->film.width, height = render->film.height;
    TileWork work = {.round = round};
    for (uint32_t i = 0; i < TILE * TILE; ++i) {
        const uint32_t x = x0 + unzip(i), y = y0 + unzip(i >> 1);
        const uint32_t count = x < width && y < height ? samples_to_add(round, x, y) : 0;
        if (count > 0)
            AMB_TRY(ask_for_pixel(&work, x, y, i, count));
        *out_samples += count;
    }
    AMB_TRY(see_requests(&work));
    for (uint32_t i = 0; i < TILE * TILE; ++i)
        if (work.sums[i].count > 0)
            film_add(&render->film, x0 + unzip(i), y0 + unzip(i >> 1), &work.sums[i]);
    return AMB_OK;
}

static AmbStatus render_tiles(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Round *round = user;
    for (uint64_t tile = begin; tile < end; ++tile) {
        uint64_t samples = 0;
        AMB_TRY(render_tile(round, (uint32_t)(tile % round->tiles_x) * TILE,
                            (uint32_t)(tile / round->tiles_x) * TILE, &samples));
        atomic_fetch_add(&round->render->job.work_done, samples);
    }
    return AMB_OK;
}

static AmbStatus run_round(Round *round) {
    const Film *film = &round->render->film;
    round->tiles_x = (film->width + TILE - 1) / TILE;
    const uint64_t tiles = (uint64_t)round->tiles_x * ((film->height + TILE - 1) / TILE);
    return parallel_for(&round->render->job, tiles, 1, render_tiles, round);
}

AmbStatus render_round(AmbRender *render, const Field *field, const uint32_t *quotas) {
    Round round = {.render = render, .field = field, .quotas = quotas};
    return run_round(&round);
}

void render_expect(AmbRender *render, double samples) {
    atomic_store(&render->job.work_total, (uint64_t)samples);
}

static AmbStatus run_fixed_round(Round *round, uint32_t step, uint32_t total) {
    round->step = step;
    round->total = total;
    AMB_TRY(run_round(round));
    AmbRender *render = round->render;
    pthread_mutex_lock(&render->lock);
    render->samples_done = step == 1 ? total : 0;
    render->pixel_step = step;
    pthread_mutex_unlock(&render->lock);
    return AMB_OK;
}

/* All pixels get a few samples, then more of them: there is soon a whole picture to look at. The
 * division into rounds depends on the number of samples alone. */
static AmbStatus run_fixed(AmbRender *render, const Field *field) {
    Round round = {.render = render, .field = field};
    const uint32_t samples = render->params.samples;
    render_expect(render, (double)render->film.width * render->film.height * samples);
    for (uint32_t step = render->params.coarse_first ? COARSE_STEP : 1; step > 1; step /= 2)
        AMB_TRY(run_fixed_round(&round, step, 1));
    for (uint32_t done = 0; done < samples;) {
        const uint32_t more = done > 1 ? done : 1;
        done += more < ROUND_MAX ? more : ROUND_MAX;
        done = done < samples ? done : samples;
        AMB_TRY(run_fixed_round(&round, 1, done));
    }
    return accuracy_measure_fixed(render);
}

static AmbStatus run_camera(AmbRender *render, const Field *field) {
    if (render->accuracy.target > 0.0f)
        return accuracy_run_camera(render, field);
    return run_fixed(render, field);
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

/* The CPU seconds. */
static double charge_stage(AmbRender *render, uint32_t stage, StageClock begin) {
    const StageClock end = clock_stage(render);
    const double cpu = end.cpu - begin.cpu + end.helpers - begin.helpers;
    render->costs[stage].wall += end.wall - begin.wall;
    render->costs[stage].cpu += cpu;
    return cpu;
}

static PlanCrop crop_of(const AmbRenderParams *params) {
    if (params->crop_width > 0)
        return (PlanCrop){params->crop_x, params->crop_y, params->crop_width, params->crop_height};
    return (PlanCrop){0, 0, params->width, params->height};
}

static AmbStatus create_plan(AmbRender *render) {
    const PlanCrop crop = crop_of(&render->params);
    return plan_create(render->scene, &render->params, &crop, false, &render->job, &render->plan);
}

AmbStatus render_explain(AmbScene *scene, const AmbRenderParams *params, char *buffer,
                         uint64_t size, uint64_t *out_size) {
    AMB_TRY(plan_check(params));
    Job job;
    job_init(&job, params->threads);
    AMB_TRY(scene_build(scene, &job));
    const PlanCrop crop = crop_of(params);
    Plan plan;
    AMB_TRY(plan_create(scene, params, &crop, true, &job, &plan));
    report_write_plan(scene, &plan, buffer, size, out_size);
    plan_clear(&plan);
    return AMB_OK;
}

static AmbStatus run_scene(AmbRender *render) {
    set_stage(render, STAGE_SCENE);
    const StageClock begin = clock_stage(render);
    const double process = clock_process_cpu();
    AmbStatus status = scene_build(render->scene, &render->job);
    if (status == AMB_OK)
        status = create_plan(render);
    charge_stage(render, STAGE_SCENE, begin);
    /* Embree builds on threads of its own: the process's clock sees them. */
    render->costs[STAGE_SCENE].cpu = clock_process_cpu() - process;
    if (status == AMB_OK) {
        render->plan.camera.job = &render->job;
        render->has_plan = true;
        render->accuracy.omitted = render->plan.omitted;
        render->scene_bytes = scene_bytes(render->scene);
    }
    return status;
}

static AmbStatus run_light(AmbRender *render, LightField *out_light) {
    set_stage(render, STAGE_LIGHT);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        light_trace(render->scene, &render->plan.light, &render->job, out_light);
    render->light_costs[LIGHT_COST_FIELD] += charge_stage(render, STAGE_LIGHT, begin);
    if (status == AMB_OK) {
        render->account = (FieldAccount){.ray_count = out_light->ray_count,
                                         .leaks = out_light->leaks,
                                         .tally = out_light->tally,
                                         .light_bytes = light_bytes(out_light)};
    }
    return status;
}

static AmbStatus run_field(AmbRender *render, const LightField *light, Field **out_field) {
    set_stage(render, STAGE_FIELD);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        field_create(render->scene, light, &render->plan.field, &render->job, out_field);
    render->light_costs[LIGHT_COST_FIELD] += charge_stage(render, STAGE_FIELD, begin);
    if (status == AMB_OK) {
        FieldAccount *account = &render->account;
        account->size = field_size(*out_field);
        field_tally(*out_field, &account->tally, &account->leaks);
    }
    return status;
}

AmbStatus render_build_scatter(AmbRender *render, Scatter **out_scatter) {
    set_stage(render, STAGE_FIELD);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        scatter_create(render->scene, &render->plan.scatter, &render->job, out_scatter);
    render->light_costs[LIGHT_COST_SCATTER] += charge_stage(render, STAGE_FIELD, begin);
    if (status == AMB_OK) {
        render->plan.camera.scatter = *out_scatter;
        render->scatter = (ScatterAccount){.cell_count = scatter_cell_count(*out_scatter),
                                           .bytes = scatter_bytes(*out_scatter),
                                           .tally = *scatter_tally(*out_scatter)};
    }
    return status;
}

bool render_forgive_memory(AmbRender *render, AmbStatus status) {
    return status == AMB_OUT_OF_MEMORY && atomic_exchange(&render->memory.refused, 0) > 0;
}

AmbStatus render_build_field(AmbRender *render, Field **out_field) {
    LightField light = {.object_count = 0};
    render->account = (FieldAccount){.ray_count = 0};
    if (render->plan.has_points)
        AMB_TRY(run_light(render, &light));
    const AmbStatus status = run_field(render, &light, out_field);
    light_field_clear(&light);
    return status;
}

/* Whether a failure was the limit's of memory and there is a coarser plan to try instead. */
static bool try_coarser(AmbRender *render, AmbStatus status, bool (*reduce)(Plan *plan)) {
    const bool is_limit = status == AMB_OUT_OF_MEMORY && atomic_load(&render->memory.refused) > 0;
    if (!is_limit || !reduce(&render->plan))
        return false;
    atomic_store(&render->memory.refused, 0);
    pthread_mutex_lock(&render->lock);
    render->is_reduced = true;
    pthread_mutex_unlock(&render->lock);
    return true;
}

AmbStatus render_build_fitting_field(AmbRender *render, Field **out_field) {
    AmbStatus status;
    do
        status = render_build_field(render, out_field);
    while (try_coarser(render, status, plan_reduce_field));
    return status;
}

/* Light of later orders, unless walks bring it. */
static AmbStatus run_scatter(AmbRender *render, Scatter **out_scatter) {
    *out_scatter = NULL;
    if (render->plan.scatter_estimator == AMB_SCATTER_WALK)
        return AMB_OK;
    AMB_TRY(accuracy_fit_scatter(render));
    AmbStatus status;
    do
        status = render_build_scatter(render, out_scatter);
    while (try_coarser(render, status, plan_reduce_scatter));
    return status;
}

AmbStatus render_probe(AmbRender *render, Probe *probe, const Field *const fields[2],
                       const Scatter *const scatters[2], bool has_folds) {
    CameraParams cameras[2] = {render->plan.camera, render->plan.camera};
    ProbeSight sights[2];
    for (int i = 0; i < 2; ++i) {
        cameras[i].scatter = scatters[i];
        cameras[i].ledger = NULL;
        cameras[i].part_count = 1; /* all of a field is what is compared */
        sights[i] =
            (ProbeSight){render->scene, fields[i], &cameras[i], render->crop_x, render->crop_y};
    }
    const StageClock begin = clock_stage(render);
    AmbStatus status = probe_run(probe, &sights[1], &render->job);
    if (status == AMB_OK && probe->level_count == 2)
        status = probe_refine(probe, sights, has_folds, &render->job);
    const double cpu = charge_stage(render, STAGE_FIELD, begin);
    render->light_costs[probe == &render->accuracy.scatter_probe ? LIGHT_COST_SCATTER
                                                                 : LIGHT_COST_FIELD] += cpu;
    return status;
}

AmbStatus render_probe_trial(AmbRender *render, Probe *probe, const ProbeSight *sight) {
    const StageClock begin = clock_stage(render);
    const AmbStatus status = probe_run(probe, sight, &render->job);
    render->light_costs[LIGHT_COST_SCATTER] += charge_stage(render, STAGE_FIELD, begin);
    return status;
}

AmbStatus render_probe_caustics(AmbRender *render, const ProbeSight sights[]) {
    const StageClock begin = clock_stage(render);
    Probe *probe = &render->accuracy.caustic_probe;
    AmbStatus status = probe_run(probe, &sights[probe->level_count], &render->job);
    if (status == AMB_OK && probe->level_count > 1)
        status = probe_refine(probe, sights, true, &render->job);
    render->light_costs[LIGHT_COST_CAUSTICS] += charge_stage(render, STAGE_LIGHT, begin);
    return status;
}

AmbStatus render_build_caustics(AmbRender *render, CausticMap **out_map) {
    set_stage(render, STAGE_LIGHT);
    const StageClock begin = clock_stage(render);
    const AmbStatus status =
        caustics_create(render->scene, &render->plan.caustics, &render->job, out_map);
    render->plan.caustics.traced = NULL; /* once taken, what landed is gone */
    render->light_costs[LIGHT_COST_CAUSTICS] += charge_stage(render, STAGE_LIGHT, begin);
    if (status == AMB_OK)
        render->caustics = caustics_account(*out_map);
    return status;
}

static AmbStatus run_caustics(AmbRender *render, CausticMap **out_map) {
    render->accuracy.has_caustics =
        render->plan.caustics.light.ray_count == 0 && render->plan.caustics.glow.photon_count == 0;
    if (render->accuracy.has_caustics)
        return AMB_OK;
    if (render->accuracy.target > 0.0f)
        accuracy_plan_caustics(render);
    AmbStatus status;
    do
        status = render_build_caustics(render, out_map);
    while (try_coarser(render, status, plan_reduce_caustics));
    render->plan.camera.caustics = *out_map;
    return status;
}

static AmbStatus run_light_side(AmbRender *render, Field **out_field) {
    if (!render->plan.has_field)
        render->accuracy.has_field = true; /* and 0: there is none */
    else if (render->accuracy.target > 0.0f)
        return accuracy_choose_field(render, out_field);
    else
        return render_build_fitting_field(render, out_field);
    return AMB_OK;
}

/* After what the camera pass knows from its parameters. */
static AmbStatus run_field_and_camera(AmbRender *render, CausticMap **caustics, Scatter **scatter) {
    Field *field = NULL;
    AmbStatus status = run_light_side(render, &field);
    render->accuracy.has_scatter = *scatter == NULL;
    if (status == AMB_OK && render->accuracy.target > 0.0f)
        status = accuracy_refine_scatter(render, field, scatter);
    if (status == AMB_OK && render->accuracy.target > 0.0f && *caustics != NULL)
        status = accuracy_refine_caustics(render, field, caustics);
    if (status == AMB_OK) {
        set_stage(render, STAGE_CAMERA);
        const StageClock begin = clock_stage(render);
        status = run_camera(render, field);
        charge_stage(render, STAGE_CAMERA, begin);
    }
    for (uint32_t o = 0; field != NULL && o < render->scene->object_count; ++o)
        render->nonfinite_objects[o] = field_nonfinite(field, o);
    field_destroy(field);
    return status;
}

static AmbStatus run_stages(AmbRender *render) {
    AMB_TRY(parallel_for(&render->job, render->film.height, 16, zero_rows, &render->film));
    AMB_TRY(run_scene(render));
    render->nonfinite_objects =
        memory_zero_array(render->scene->object_count, sizeof *render->nonfinite_objects);
    if (render->nonfinite_objects == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a render");
    AMB_TRY(ledger_create(render->scene->object_count, &render->ledger));
    render->plan.camera.ledger = &render->ledger;
    CausticMap *caustics = NULL;
    Scatter *scatter = NULL;
    AmbStatus status = run_scatter(render, &scatter);
    if (scatter != NULL && render->plan.scatter.landing_part > 0.0f)
        render->plan.caustics.traced = scatter;
    if (status == AMB_OK)
        status = run_caustics(render, &caustics);
    if (status == AMB_OK)
        status = run_field_and_camera(render, &caustics, &scatter);
    render->plan.camera.caustics = NULL;
    render->plan.camera.scatter = NULL;
    caustics_destroy(caustics);
    scatter_destroy(scatter);
    return status;
}

/* Says of a failure that it was the limit's, and not the machine's. */
static AmbStatus explain_memory(const AmbRender *render, AmbStatus status) {
    const uint64_t wanted = atomic_load(&render->memory.refused);
    if (status != AMB_OUT_OF_MEMORY || wanted == 0)
        return status;
    AmbErrorInfo info;
    status_copy_record(&info);
    return status_fail(status, "%.130s: it makes %llu MiB in all, and memory_limit is %llu MiB",
                       info.message, (unsigned long long)(wanted >> 20),
                       (unsigned long long)(render->memory.bytes >> 20));
}

static void *render_main(void *user) {
    AmbRender *render = user;
    status_enter("amb_render_wait");
    memory_set_limit(&render->memory);
    const AmbStatus status = explain_memory(render, run_stages(render));
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
    atomic_fetch_sub(&render->scene->render_count, 1);
    for (int i = 0; i < FIELD_PART_COUNT; ++i)
        probe_clear(&render->accuracy.parts[i].probe);
    probe_clear(&render->accuracy.scatter_probe);
    probe_clear(&render->accuracy.caustic_probe);
    plan_clear(&render->plan);
    film_clear(&render->film);
    memory_free(render->nonfinite_objects);
    ledger_clear(&render->ledger);
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
    atomic_fetch_add(&scene->render_count, 1);
    render->params = *params;
    render->accuracy.target = params->accuracy;
    render->accuracy.limit = "";
    render->accuracy.sets[0].objects = 1.0;
    render->accuracy.set_count = 1;
    uint32_t width = params->width, height = params->height;
    if (params->crop_width > 0) {
        render->crop_x = params->crop_x;
        render->crop_y = params->crop_y;
        width = params->crop_width;
        height = params->crop_height;
    }
    job_init(&render->job, params->threads);
    atomic_init(&render->camera_leak_count, 0);
    atomic_init(&render->camera_leak_object, UINT32_MAX);
    render->start = clock_wall();
    const uint64_t machine = memory_of_machine();
    render->memory.bytes = params->memory_limit > 0 ? params->memory_limit : machine / 2;
    atomic_init(&render->memory.refused, 0);
    memory_set_limit(&render->memory);
    AmbStatus status = explain_memory(render, film_create(width, height, &render->film));
    memory_set_limit(NULL);
    if (status == AMB_OK && pthread_create(&render->thread, NULL, render_main, render) != 0)
        status = status_fail(AMB_OUT_OF_MEMORY, "no thread for a render");
    if (status != AMB_OK) {
        release(render);
        return status;
    }
    *out_render = render;
    return AMB_OK;
}

/* Seconds that the camera stage will still take at its pace so far; < 0: unknown. */
static float remaining_seconds(const AmbRender *render, float inside) {
    const double taken = clock_wall() - render->stage_start;
    if (render->stage != STAGE_CAMERA || !(inside > 0.0f) || taken < 0.2)
        return -1.0f;
    return (float)(taken * (1.0 - (double)inside) / (double)inside);
}

static void describe_camera(const AmbRender *render, AmbProgress *out) {
    char left[32] = "";
    if (render->state == AMB_STATE_RUNNING && out->remaining >= 0.0f)
        snprintf(left, sizeof left, ", %.0f s left", ceil((double)out->remaining));
    if (!(render->accuracy.target > 0.0f))
        snprintf(out->detail, sizeof out->detail, "Sample %u/%u%s", out->samples_done,
                 render->params.samples, left);
    else if (out->error > 0.0f)
        snprintf(out->detail, sizeof out->detail, "Error %.2g %% of %.2g %%%s",
                 100.0 * (double)out->error, 100.0 * (double)render->accuracy.target, left);
    else
        snprintf(out->detail, sizeof out->detail, "First samples");
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
    out_progress->pixel_step = render->pixel_step;
    if (render->accuracy.has_noise && render->accuracy.has_field)
        out_progress->error = (float)accuracy_stated(&render->accuracy);
    out_progress->remaining = is_running ? remaining_seconds(render, inside) : 0.0f;

    static const char *const details[STAGE_COUNT] = {"Building the ray accelerator",
                                                     "Tracing light into the media",
                                                     "Building the light field", "Sample"};
    snprintf(out_progress->stage, sizeof out_progress->stage, "%s",
             is_running ? STAGE_NAMES[stage] : "done");
    if (stage == STAGE_CAMERA)
        describe_camera(render, out_progress);
    else if (stage == STAGE_FIELD && render->is_reduced)
        snprintf(out_progress->detail, sizeof out_progress->detail,
                 "Building a coarser light field: the memory limit is reached");
    else
        snprintf(out_progress->detail, sizeof out_progress->detail, "%s", details[stage]);
    pthread_mutex_unlock(&render->lock);
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
