/* SPDX-License-Identifier: GPL-3.0-or-later
 * Placing volume samples along light rays. */
#include "field/points/points.h"

#include <string.h>

#include "base/memory.h"
#include "field/points/point_gather.h"
#include "optics/kernel.h"

/* A kernel reaches past the end of its ray by radius * slope, where the boundary cuts the ray at
 * an angle, so that rays side by side cover the medium up to the boundary (camera segments end
 * there and never see the excess). Bounded, because at grazing angles it would grow without end. */
static const float SLOPE_MAX = 4.0f;
/* A tube that light opens at grazing incidence may be long and thin: a round kernel of its whole
 * cross-section would blur across it. */
static const float AREA_MAX = 4.0f; /* in units of the flux-weighted mean */

/* Mean cross-section of the cells of the object's rays at entry, weighted by flux, m^2. */
static double mean_cell_area(const LightBeams *beams) {
    double area = 0.0, weight = 0.0;
    for (uint64_t i = 0; i < beams->count; ++i) {
        const double flux = (double)rgb_mean(beams->beams[i].flux);
        area += flux * (double)beams->beams[i].cell_area;
        weight += flux;
    }
    return weight > 0.0 ? area / weight : 0.0;
}

/* None of a beam that is not in the part. */
static uint64_t samples_of(const LightBeam *beam, const PointParams *params) {
    const uint32_t parts = params->part_count;
    if (parts > 1 && (uint32_t)(beam->rank * (float)parts) != params->part)
        return 0;
    const float count = roundf(beam->length / params->spacing);
    return count > 1.0f ? (uint64_t)count : 1;
}

/* The stretch of a beam that is its sample k of count. */
static PointSample place_sample(const LightBeam *beam, const Medium *medium,
                                const PointParams *params, double mean_area, uint64_t k,
                                uint64_t count) {
    const float step = beam->length / (float)count;
    const float s = (float)k * step;
    const float frequency =
        kernel_frequency(beam->entry_area, tangent_cross_section(&beam->spread, s + 0.5f * step));
    float area = params->kernel_size * (float)mean_area;
    if (params->follows_covariance) {
        const float cell_area = fminf(beam->cell_area, AREA_MAX * (float)mean_area);
        area = cell_area * kernel_multiplier(params->kernel_size, frequency);
    }
    PointSample sample = {.origin = vec3_madd(beam->origin, s, beam->direction),
                          .direction = beam->direction,
                          .low = 0.0f,
                          .high = step,
                          .radius = kernel_radius(area),
                          .flux = rgb_mul(beam->flux, medium_transmittance(medium, s)),
                          .frequency = frequency,
                          .is_reflected = beam->bounces > 0,
                          .has_passed = beam->has_passed};
    if (k == 0)
        sample.low -= sample.radius * fminf(beam->start_slope, SLOPE_MAX);
    if (k == count - 1)
        sample.high += sample.radius * fminf(beam->end_slope, SLOPE_MAX);
    return sample;
}

enum { BEAM_GRAIN = 1024 }; /* beams of one unit of work */

typedef struct Placement {
    const LightBeams *beams;
    const Medium *medium;
    const PointParams *params;
    double mean_area;
    uint64_t *first; /* index of the first sample of each grain of beams */
    PointSample *samples;
} Placement;

static AmbStatus place_grain(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Placement *placement = user;
    uint64_t next = placement->first[begin / BEAM_GRAIN];
    for (uint64_t i = begin; i < end; ++i) {
        const LightBeam *beam = &placement->beams->beams[i];
        const uint64_t along = samples_of(beam, placement->params);
        for (uint64_t k = 0; k < along; ++k)
            placement->samples[next++] = place_sample(beam, placement->medium, placement->params,
                                                      placement->mean_area, k, along);
    }
    return AMB_OK;
}

/* Numbers the samples, so that every thread knows where its own go. */
static PointCount count_samples(const LightBeams *beams, const PointParams *params,
                                uint64_t *out_first) {
    PointCount count = {.all = 0};
    for (uint64_t i = 0; i < beams->count; ++i) {
        const LightBeam *beam = &beams->beams[i];
        if (i % BEAM_GRAIN == 0)
            out_first[i / BEAM_GRAIN] = count.all;
        const uint64_t samples = samples_of(beam, params);
        count.all += samples;
        if (beam->has_passed)
            count.passed += samples;
        else if (beam->bounces > 0)
            count.reflected += samples;
    }
    return count;
}

AmbStatus points_build(const LightBeams *beams, const Medium *medium, const PointParams *params,
                       Job *job, PointCloud *out_cloud) {
    memset(out_cloud, 0, sizeof *out_cloud);
    Placement placement = {
        .beams = beams,
        .medium = medium,
        .params = params,
        .mean_area = mean_cell_area(beams),
        .first = memory_alloc_array(beams->count / BEAM_GRAIN + 1, sizeof *placement.first)};
    if (placement.first == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for volume samples");
    const PointCount kinds = count_samples(beams, params, placement.first);
    const uint64_t count = kinds.all;
    placement.samples = memory_alloc_array(count, sizeof *placement.samples);
    AmbStatus status = AMB_OK;
    if (placement.samples == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu volume samples",
                             (unsigned long long)count);
    if (status == AMB_OK)
        status = parallel_for(job, beams->count, BEAM_GRAIN, place_grain, &placement);
    if (status == AMB_OK && count > 0)
        status = point_tree_build(placement.samples, count, job, &out_cloud->tree);
    memory_free(placement.samples);
    memory_free(placement.first);
    if (status == AMB_OK) {
        out_cloud->count = kinds;
        out_cloud->medium = *medium;
    }
    return status;
}

void points_clear(PointCloud *cloud) {
    point_tree_clear(&cloud->tree);
    memset(cloud, 0, sizeof *cloud);
}

uint64_t points_bytes(const PointCloud *cloud) {
    return cloud->tree.node_count * sizeof(PointNode) +
           cloud->tree.block_count * sizeof(PointBlock);
}

FieldRadiance points_gather(const PointCloud *cloud, const FieldSegment *segment, PointCount *met) {
    return point_gather_select()(&cloud->tree, &cloud->medium, segment, met);
}
