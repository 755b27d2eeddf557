/* SPDX-License-Identifier: GPL-3.0-or-later
 * A few pixels seen through one field after the other. */
#include "render/probe.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"

enum {
    PROBE_BLOCK_MAX = 8,
    PROBE_SAMPLES_FIRST = 4,  /* of a pixel; where they do not tell enough */
    PROBE_SAMPLES = 8,        /* so many, and more where there are few pixels, */
    PROBE_SAMPLES_MANY = 128, /* and of one where fields differ by the square more than */
    PROBE_FOCUS = 2,          /* times the mean */
};

/* A squared difference is known to a tenth of itself where more samples are asked for no longer: an
 * error that is stated from it to a twentieth. */
static const double PROBE_SPREAD = 0.1;
/* Standard errors to both sides. */
static const double PROBE_SIGMAS = 2.0;

typedef struct ProbePass {
    Probe *probe;
    const ProbeSight *sight;
    Job *job;
    uint32_t level;
} ProbePass;

AmbStatus probe_create(uint32_t width, uint32_t height, uint32_t pixels, double small,
                       Probe *out_probe) {
    const double edge = sqrt((double)width * height / pixels);
    const uint32_t block = edge < 1.0               ? 1
                           : edge > PROBE_BLOCK_MAX ? PROBE_BLOCK_MAX
                                                    : (uint32_t)edge;
    *out_probe = (Probe){.width = width,
                         .height = height,
                         .block = block,
                         .blocks_x = (width + block - 1) / block,
                         .blocks_y = (height + block - 1) / block,
                         .wanted = PROBE_OBJECT,
                         .small = small};
    const uint64_t blocks = (uint64_t)out_probe->blocks_x * out_probe->blocks_y;
    out_probe->shows = memory_zero_array(blocks, 1);
    out_probe->counts = memory_alloc_array(blocks, sizeof(uint32_t));
    if (out_probe->shows == NULL || out_probe->counts == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to measure the light field's error");
    for (uint64_t i = 0; i < blocks; ++i)
        out_probe->counts[i] = PROBE_SAMPLES_FIRST;
    return AMB_OK;
}

void probe_clear(Probe *probe) {
    memory_free(probe->shows);
    memory_free(probe->counts);
    for (uint32_t i = 0; i < FIELD_LEVEL_MAX; ++i)
        memory_free(probe->levels[i]);
    memset(probe, 0, sizeof *probe);
}

static void add_sample(Probe *probe, uint64_t index, const CameraSample *sample,
                       ProbePixel *pixel) {
    const Rgb radiance = camera_sample_sum(sample);
    Rgb *sum = &pixel->sums[pixel->count++ % 2];
    if (rgb_is_finite(radiance))
        *sum = rgb_add(*sum, radiance);
    if (sample->is_object)
        probe->shows[index] |= PROBE_OBJECT;
    if (sample->parts[CAMERA_PART_CAUSTICS] > 0.0f)
        probe->shows[index] |= PROBE_CAUSTICS;
}

/* A block's pixel: by chance, for a fixed one of each would see patterns. Goes on from the samples
 * that it has. */
static AmbStatus probe_block(const ProbePass *pass, uint64_t index, ProbePixel *pixel) {
    Probe *probe = pass->probe;
    const ProbeSight *sight = pass->sight;
    const uint32_t x0 = (uint32_t)(index % probe->blocks_x) * probe->block;
    const uint32_t y0 = (uint32_t)(index / probe->blocks_x) * probe->block;
    const uint32_t width = probe->width - x0, height = probe->height - y0;
    const Rng rng = rng_create(sight->camera->seed, RNG_STAGE_PROBE, index);
    const float u = rng_float(rng, 0), v = rng_float(rng, 1);
    const uint32_t x = x0 + (uint32_t)(u * (float)(width < probe->block ? width : probe->block));
    const uint32_t y = y0 + (uint32_t)(v * (float)(height < probe->block ? height : probe->block));
    while (pixel->count < probe->counts[index]) {
        CameraRequest requests[CAMERA_BATCH];
        CameraSample samples[CAMERA_BATCH];
        const uint32_t left = probe->counts[index] - pixel->count;
        const uint32_t count = left < CAMERA_BATCH ? left : CAMERA_BATCH;
        for (uint32_t i = 0; i < count; ++i)
            requests[i] = (CameraRequest){sight->x + x, sight->y + y, pixel->count + i, false};
        AMB_TRY(
            camera_samples(sight->scene, sight->field, sight->camera, requests, count, samples));
        for (uint32_t i = 0; i < count; ++i)
            add_sample(probe, index, &samples[i], pixel);
    }
    return AMB_OK;
}

static AmbStatus probe_blocks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const ProbePass *pass = user;
    ProbePixel *pixels = pass->probe->levels[pass->level];
    for (uint64_t i = begin; i < end; ++i)
        AMB_TRY(probe_block(pass, i, &pixels[i]));
    return AMB_OK;
}

static AmbStatus see_level(Probe *probe, uint32_t level, const ProbeSight *sight, Job *job) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    ProbePass pass = {probe, sight, job, level};
    return parallel_for(job, blocks, 16, probe_blocks, &pass);
}

static Rgb half_radiance(const Probe *probe, uint64_t block, uint32_t level, int half) {
    const ProbePixel *pixel = &probe->levels[level][block];
    return rgb_scale(pixel->sums[half], 2.0f / (float)pixel->count);
}

static Rgb difference(const Probe *probe, uint64_t block, uint32_t a, uint32_t b, int half) {
    return rgb_add(half_radiance(probe, block, a, half),
                   rgb_scale(half_radiance(probe, block, b, half), -1.0f));
}

float probe_block_square(const Probe *probe, uint64_t block, uint32_t a, uint32_t b) {
    const Rgb d = rgb_add(difference(probe, block, a, b, 0), difference(probe, block, a, b, 1));
    return 0.25f * rgb_mean(rgb_mul(d, d));
}

static bool is_in(const Probe *probe, uint64_t block, uint8_t shows) {
    return shows == 0 || (probe->shows[block] & shows) != 0;
}

/* Of the pixels that are compared; 0: all. */
static uint8_t compared(const Probe *probe) {
    for (uint64_t i = 0; i < (uint64_t)probe->blocks_x * probe->blocks_y; ++i)
        if (is_in(probe, i, probe->wanted))
            return probe->wanted;
    return 0;
}

/* Squared difference of two levels in a block's pixel. The halves are independent, so that the
 * product of their differences has the expectation that it has at infinitely many samples; of many
 * samples the square itself is near it, never negative, and rather too large. */
static double block_square(const Probe *probe, uint64_t block, uint32_t a, uint32_t b) {
    if (probe->counts[block] == PROBE_SAMPLES_MANY)
        return (double)probe_block_square(probe, block, a, b);
    return (double)rgb_mean(
        rgb_mul(difference(probe, block, a, b, 0), difference(probe, block, a, b, 1)));
}

static double mean_square(const Probe *probe, uint32_t a, uint32_t b, uint8_t shows) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    double sum = 0.0;
    uint64_t count = 0;
    for (uint64_t i = 0; i < blocks; ++i)
        if (is_in(probe, i, shows)) {
            sum += block_square(probe, i, a, b);
            ++count;
        }
    return count > 0 ? sum / (double)count : 0.0;
}

ProbeMean probe_mean(const Probe *probe, uint8_t shows) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    ProbeMean mean = {.differences = {.level_count = probe->level_count}};
    for (uint32_t b = 1; b < probe->level_count; ++b)
        for (uint32_t a = 0; a < b; ++a)
            mean.differences.squares[a][b] = mean.differences.squares[b][a] =
                fmax(mean_square(probe, a, b, shows), 0.0);
    const uint32_t newest = probe->level_count - 1;
    double sum = 0.0;
    for (uint64_t i = 0; i < blocks; ++i)
        if (is_in(probe, i, shows)) {
            sum += 0.5 * (double)rgb_mean(rgb_add(half_radiance(probe, i, newest, 0),
                                                  half_radiance(probe, i, newest, 1)));
            ++mean.count;
        }
    mean.radiance = mean.count > 0 ? sum / (double)mean.count : 0.0;
    return mean;
}

/* Noise of n samples falls as n^-3/4 at edges (survey.c). */
static const double NOISE_ORDER = 1.5;

double probe_noise(const Probe *probe, uint32_t samples) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    const uint32_t newest = probe->level_count - 1;
    const uint8_t shows = compared(probe);
    double sum = 0.0;
    uint64_t count = 0;
    for (uint64_t i = 0; i < blocks; ++i)
        if (is_in(probe, i, shows)) {
            const Rgb d = rgb_add(half_radiance(probe, i, newest, 0),
                                  rgb_scale(half_radiance(probe, i, newest, 1), -1.0f));
            const double more = (double)probe->levels[newest][i].count / samples;
            sum += 0.25 * (double)rgb_mean(rgb_mul(d, d)) * pow(more, NOISE_ORDER);
            ++count;
        }
    return count > 0 ? sqrt(sum / (double)count) : 0.0;
}

static void compare_levels(Probe *probe) {
    const ProbeMean mean = probe_mean(probe, compared(probe));
    probe->differences = mean.differences;
    probe->radiance = mean.radiance;
}

AmbStatus probe_run(Probe *probe, const ProbeSight *sight, Job *job) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    const uint32_t level = probe->level_count;
    probe->levels[level] = memory_zero_array(blocks, sizeof(ProbePixel));
    if (probe->levels[level] == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to measure the light field's error");
    AMB_TRY(see_level(probe, level, sight, job));
    probe->level_count = level + 1;
    compare_levels(probe);
    return AMB_OK;
}

typedef struct SquareSum {
    double sum, square_sum;
    uint64_t count;
} SquareSum;

static void add_square(SquareSum *sum, double square) {
    sum->sum += square;
    sum->square_sum += square * square;
    ++sum->count;
}

static double spread_of_mean(const SquareSum *sum) {
    const double n = (double)sum->count, mean = sum->sum / n;
    return sqrt(fmax(sum->square_sum / n - mean * mean, 0.0) / n);
}

typedef enum Knowledge { KNOWS_LITTLE, KNOWS_ENOUGH, IS_SETTLED } Knowledge;

/* What the samples tell of the newest two levels' difference. It is settled where the mean product
 * is known to what is small, or the squares themselves are, which noise makes larger. Asked for a
 * tenth of itself alone, a scene of glints took fifty times what its first passes do
 * (bench_orders.py full). */
static Knowledge judge(const Probe *probe) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    const uint32_t newest = probe->level_count - 1;
    const uint8_t shows = compared(probe);
    SquareSum products = {.count = 0}, squares = {.count = 0};
    for (uint64_t i = 0; i < blocks; ++i)
        if (is_in(probe, i, shows)) {
            add_square(&products, block_square(probe, i, newest - 1, newest));
            add_square(&squares, (double)probe_block_square(probe, i, newest - 1, newest));
        }
    const double n = (double)squares.count, small = probe->small * probe->radiance;
    const double spread = spread_of_mean(&products);
    if (spread <= small * small ||
        squares.sum / n + PROBE_SIGMAS * spread_of_mean(&squares) <= small * small)
        return IS_SETTLED;
    return spread <= PROBE_SPREAD * products.sum / n ? KNOWS_ENOUGH : KNOWS_LITTLE;
}

static AmbStatus see_all(Probe *probe, const ProbeSight sights[], Job *job) {
    for (uint32_t level = 0; level < probe->level_count; ++level)
        AMB_TRY(see_level(probe, level, &sights[level], job));
    compare_levels(probe);
    return AMB_OK;
}

static void raise_count(Probe *probe, uint64_t block, uint32_t count) {
    if (probe->counts[block] < count)
        probe->counts[block] = count;
}

AmbStatus probe_refine(Probe *probe, const ProbeSight sights[], bool has_folds, Job *job) {
    const uint64_t blocks = (uint64_t)probe->blocks_x * probe->blocks_y;
    const uint32_t newest = probe->level_count - 1;
    uint32_t samples = PROBE_SAMPLES_FIRST;
    Knowledge knowledge = judge(probe);
    while (knowledge == KNOWS_LITTLE && samples < PROBE_SAMPLES_MANY &&
           (samples < PROBE_SAMPLES || samples * blocks < (uint64_t)PROBE_SAMPLES * PROBE_PIXELS)) {
        samples *= 2;
        for (uint64_t i = 0; i < blocks; ++i)
            raise_count(probe, i, samples);
        AMB_TRY(see_all(probe, sights, job));
        knowledge = judge(probe);
    }
    if (!has_folds || knowledge == IS_SETTLED)
        return AMB_OK;
    double sum = 0.0;
    for (uint64_t i = 0; i < blocks; ++i)
        sum += (double)probe_block_square(probe, i, newest - 1, newest);
    for (uint64_t i = 0; i < blocks; ++i)
        if ((double)probe_block_square(probe, i, newest - 1, newest) * (double)blocks >
            PROBE_FOCUS * sum)
            raise_count(probe, i, PROBE_SAMPLES_MANY);
    return see_all(probe, sights, job);
}
