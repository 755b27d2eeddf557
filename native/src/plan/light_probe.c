/* SPDX-License-Identifier: GPL-3.0-or-later
 * A few light rays before the render. */
#include "plan/light_probe.h"

#include <string.h>

#include "base/memory.h"

const uint32_t BOUNCE_STEPS[CAMERA_STEP_COUNT] = {
    0, 1, 2, 3, 4, 6, 8, 12, LIGHT_BOUNCES_MOST, CAMERA_BOUNCES_MOST};

/* Few rays need wide kernels, which keep the mean; the picture of the share may be soft. */
static const float PROBE_KERNEL_SIZE = 12.0f;
/* Of the light in media. */
static const double VEILED_PART = 0.25, TRAPPED_PART = 0.05;
/* Cross-sections at the end of the stretch after the first reflection, in units of those at entry,
 * by flux: 9 inside a bumpy sphere, where a first reflection by tubes takes four times what it
 * takes by points; 2 inside a ball and 1.6 in a cube, where it takes a half. */
static const double STREWN_GROWTH = 4.0;
/* As in the render (plan.c): else every reflection has as many beams as the first entry, up to one
 * in a million of the light, and each gather goes through all of them. */
static const float PROBE_ROULETTE = 0.05f;
enum { PROBE_SAMPLES_PER_BEAM = 3, PROBE_PROBLEM_SHARE = 1000 };

uint32_t bounce_step(uint32_t bounces, uint32_t step_count) {
    uint32_t step = 0;
    while (step + 1 < step_count && BOUNCE_STEPS[step] < bounces)
        ++step;
    return step;
}

static uint32_t beam_class(const LightBeam *beam) {
    return beam->has_passed ? LIGHT_CLASS_PASSED : bounce_step(beam->bounces, LIGHT_STEP_COUNT);
}

static void add_flux(const AmbScene *scene, const LightField *light, LightProbe *probe) {
    for (uint32_t o = 0; o < light->object_count; ++o) {
        const Medium *medium = &scene->materials[scene->objects[o].inside].medium;
        for (uint64_t i = 0; i < light->objects[o].count; ++i) {
            const LightBeam *beam = &light->objects[o].beams[i];
            const Rgb left = medium_transmittance(medium, beam->length);
            const Rgb taken = rgb_mul(beam->flux, rgb(1.0f - left.r, 1.0f - left.g, 1.0f - left.b));
            probe->flux[beam_class(beam)] += 3.0 * (double)rgb_mean(taken);
        }
    }
}

static bool is_strewn(const LightField *light) {
    double grown = 0.0, flux = 0.0;
    for (uint32_t o = 0; o < light->object_count; ++o)
        for (uint64_t i = 0; i < light->objects[o].count; ++i) {
            const LightBeam *beam = &light->objects[o].beams[i];
            if (beam->bounces != 1 || beam->has_passed)
                continue;
            const double weight = (double)rgb_mean(beam->flux);
            const float area = tangent_cross_section(&beam->spread, beam->length);
            grown += weight * (double)(area / beam->entry_area);
            flux += weight;
        }
    return grown > STREWN_GROWTH * flux;
}

/* Flux of classes from first to last. */
static double sum_flux(const LightProbe *probe, uint32_t first, uint32_t last) {
    double sum = 0.0;
    for (uint32_t c = first; c <= last; ++c)
        sum += probe->flux[c];
    return sum;
}

/* The field of the beams of one class. */
static AmbStatus create_field(const AmbScene *scene, const LightField *light, uint32_t class,
                              const LightProbeParams *params, Job *job, Field **out_field) {
    uint64_t total = 0;
    LightField part = {.object_count = light->object_count};
    part.objects = memory_zero_array(light->object_count, sizeof *part.objects);
    AmbStatus status = part.objects != NULL ? AMB_OK : AMB_OUT_OF_MEMORY;
    for (uint32_t o = 0; o < light->object_count && status == AMB_OK; ++o) {
        const LightBeams *all = &light->objects[o];
        LightBeams *some = &part.objects[o];
        some->beams = memory_alloc_array(all->count, sizeof *some->beams);
        if (some->beams == NULL) {
            status = AMB_OUT_OF_MEMORY;
            break;
        }
        for (uint64_t i = 0; i < all->count; ++i)
            if (beam_class(&all->beams[i]) == class)
                some->beams[some->count++] = all->beams[i];
        total += some->count;
    }
    if (status != AMB_OK)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    const FieldParams field = {.estimator = AMB_ESTIMATOR_POINTS_COVARIANCE,
                               .sample_target = PROBE_SAMPLES_PER_BEAM * total,
                               .kernel_size = PROBE_KERNEL_SIZE,
                               .adjoint_normals = params->adjoint_normals};
    if (status == AMB_OK && total > 0)
        status = field_create(scene, &part, &field, job, out_field);
    light_field_clear(&part);
    return status;
}

AmbStatus light_probe_create(const AmbScene *scene, const LightProbeParams *params, Job *job,
                             LightProbe *out_probe) {
    memset(out_probe, 0, sizeof *out_probe);
    const LightTraceParams trace = {.ray_count = params->ray_count,
                                    .bounces = params->bounces,
                                    .follows_through = true,
                                    .adjoint_normals = params->adjoint_normals,
                                    .roulette = PROBE_ROULETTE,
                                    .seed = params->seed};
    LightField light;
    AMB_TRY(light_trace(scene, &trace, job, &light));
    const uint64_t limit = params->ray_count / PROBE_PROBLEM_SHARE;
    out_probe->problems =
        (MeshProblems){.is_irregular = light.leaks.count + light.irregular_count > limit,
                       .is_nested = light.nested_count > limit,
                       .is_strewn = is_strewn(&light)};
    add_flux(scene, &light, out_probe);
    const double flux = sum_flux(out_probe, 0, LIGHT_CLASS_COUNT - 1);
    /* A lamp inside an object lights it without arriving. */
    const double *incident = light.tally.incident;
    out_probe->is_dark = !(incident[0] + incident[1] + incident[2] + flux > 0.0);
    out_probe->problems.is_veiled = out_probe->flux[LIGHT_CLASS_PASSED] > VEILED_PART * flux;
    out_probe->problems.is_trapped = sum_flux(out_probe, bounce_step(3, LIGHT_STEP_COUNT),
                                              LIGHT_STEP_COUNT - 1) > TRAPPED_PART * flux;
    AmbStatus status = AMB_OK;
    for (uint32_t c = 0; c < LIGHT_CLASS_COUNT && params->has_fields && status == AMB_OK; ++c)
        status = create_field(scene, &light, c, params, job, &out_probe->fields[c]);
    light_field_clear(&light);
    if (status != AMB_OK)
        light_probe_clear(out_probe);
    return status;
}

void light_probe_clear(LightProbe *probe) {
    for (uint32_t c = 0; c < LIGHT_CLASS_COUNT; ++c)
        field_destroy(probe->fields[c]);
    memset(probe, 0, sizeof *probe);
}
