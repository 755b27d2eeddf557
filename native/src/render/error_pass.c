/* SPDX-License-Identifier: GPL-3.0-or-later
 * The error of each pixel. */
#include "render/error_pass.h"

#include <math.h>

#include "base/memory.h"
#include "render/render.h"

AmbStatus error_pass_create(Survey *survey, ErrorPass *out_pass) {
    const Film *film = &survey->render->film;
    const uint64_t pixels = (uint64_t)film->width * film->height;
    *out_pass = (ErrorPass){.survey = survey, .shares = memory_alloc_array(pixels, sizeof(double))};
    return out_pass->shares != NULL
               ? AMB_OK
               : status_fail(AMB_OUT_OF_MEMORY, "no memory to measure the error");
}

void error_pass_clear(ErrorPass *pass) {
    memory_free(pass->shares);
    for (int i = 0; i < BLOCK_ERROR_COUNT; ++i)
        memory_free(pass->blocks[i].squares);
}

/* Each pixel hands its variance to those of its neighbours and itself that are alike, in equal
 * parts: smoother, and the sum stays. */
static AmbStatus find_shares(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const ErrorPass *pass = user;
    const Survey *survey = pass->survey;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y)
        for (uint32_t x = 0; x < film->width; ++x) {
            const FilmPixel *pixel = &film->pixels[y * film->width + x];
            uint32_t range[4], alike = 0;
            survey_neighbourhood(film, x, (uint32_t)y, 1, range);
            const bool is_object = survey_set_has(survey, 0, y * film->width + x);
            for (uint64_t v = range[2]; v <= range[3]; ++v)
                for (uint32_t u = range[0]; u <= range[1]; ++u)
                    alike += survey_set_has(survey, 0, v * film->width + u) == is_object;
            pass->shares[y * film->width + x] = film_pixel_variance(pixel) / alike;
        }
    return AMB_OK;
}

static double block_square(const BlockErrors *errors, uint32_t x, uint32_t y) {
    const Probe *probe = errors->probe;
    if (errors->squares == NULL)
        return 0.0;
    const uint64_t block = (uint64_t)(y / probe->block) * probe->blocks_x + x / probe->block;
    return errors->scale * (double)errors->squares[block];
}

static AmbStatus sum_blocks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const ErrorPass *pass = user;
    const Survey *survey = pass->survey;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        double sum = 0.0;
        for (uint32_t x = 0; x < film->width; ++x)
            if (survey_set_has(survey, pass->measured->set, y * film->width + x))
                sum += block_square(pass->measured, x, (uint32_t)y);
        survey->sums[y] = sum;
    }
    return AMB_OK;
}

static AmbStatus write_errors(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const ErrorPass *pass = user;
    const Survey *survey = pass->survey;
    Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        /* In place of the costs, which the next round finds again. */
        float *row = survey->costs + y * film->width;
        for (uint32_t x = 0; x < film->width; ++x) {
            const bool is_object = survey_set_has(survey, 0, y * film->width + x);
            uint32_t range[4];
            survey_neighbourhood(film, x, (uint32_t)y, 1, range);
            double square = 0.0;
            for (int i = 0; i < BLOCK_ERROR_COUNT; ++i)
                if (survey_set_has(survey, pass->blocks[i].set, y * film->width + x))
                    square += block_square(&pass->blocks[i], x, (uint32_t)y);
            for (uint64_t v = range[2]; v <= range[3]; ++v)
                for (uint32_t u = range[0]; u <= range[1]; ++u)
                    if (survey_set_has(survey, 0, v * film->width + u) == is_object)
                        square += pass->shares[v * film->width + u];
            row[x] = (float)sqrt(square);
        }
        film_set_error_row(film, (uint32_t)y, row);
    }
    return AMB_OK;
}

/* Squared differences of two levels, over the probes of 3 x 3 blocks. */
static AmbStatus find_blocks(BlockErrors *errors, uint32_t level, uint32_t companion) {
    const Probe *probe = errors->probe;
    errors->squares = memory_zero_array((uint64_t)probe->blocks_x * probe->blocks_y, sizeof(float));
    if (errors->squares == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to measure the error");
    for (uint32_t y = 0; y < probe->blocks_y; ++y)
        for (uint32_t x = 0; x < probe->blocks_x; ++x) {
            float sum = 0.0f;
            for (uint32_t v = y > 0 ? y - 1 : 0; v <= y + 1 && v < probe->blocks_y; ++v)
                for (uint32_t u = x > 0 ? x - 1 : 0; u <= x + 1 && u < probe->blocks_x; ++u)
                    sum += probe_block_square(probe, (uint64_t)v * probe->blocks_x + u, level,
                                              companion);
            errors->squares[(uint64_t)y * probe->blocks_x + x] = sum;
        }
    return AMB_OK;
}

/* Scales blocks so that over the pixels of their set the mean square is that of an error, relative
 * to the mean radiance. */
static AmbStatus scale_blocks(ErrorPass *pass, BlockErrors *errors, double error) {
    const Survey *survey = pass->survey;
    AmbRender *render = survey->render;
    errors->scale = 1.0;
    pass->measured = errors;
    AMB_TRY(parallel_for(&render->job, render->film.height, 16, sum_blocks, pass));
    double sum = 0.0;
    for (uint32_t y = 0; y < render->film.height; ++y)
        sum += survey->sums[y];
    error *= render->accuracy.sets[errors->set].radiance;
    const double count = (double)survey->totals[errors->set].count;
    errors->scale = sum > 0.0 ? error * error * count / sum : 0.0;
    return AMB_OK;
}

/* What the last two levels of photons differ by. */
static AmbStatus use_newest(ErrorPass *pass, BlockErrors *errors, const Probe *probe, uint32_t set,
                            double error) {
    errors->probe = probe;
    errors->set = set;
    const uint32_t top = probe->level_count - 1;
    if (errors->squares == NULL)
        AMB_TRY(find_blocks(errors, top, top - 1));
    return scale_blocks(pass, errors, error);
}

AmbStatus error_pass_write(ErrorPass *pass, double noise_factor) {
    AmbRender *render = pass->survey->render;
    const Accuracy *accuracy = &render->accuracy;
    const uint32_t rows = render->film.height;
    AMB_TRY(parallel_for(&render->job, rows, 16, find_shares, pass));
    if (noise_factor != 1.0)
        for (uint64_t i = 0; i < (uint64_t)rows * render->film.width; ++i)
            pass->shares[i] *= noise_factor * noise_factor;
    for (int i = 0; i < FIELD_PART_COUNT; ++i) {
        const FieldMeasure *part = &accuracy->parts[i];
        BlockErrors *field = &pass->blocks[BLOCKS_OF_FIELD + i];
        if (!accuracy->has_field || !(part->error > 0.0))
            continue;
        field->probe = &part->probe;
        if (field->squares == NULL)
            AMB_TRY(find_blocks(field, part->level, part->companion));
        AMB_TRY(scale_blocks(pass, field, part->error));
    }
    if (accuracy->has_scatter && accuracy->scatter > 0.0)
        AMB_TRY(use_newest(pass, &pass->blocks[BLOCKS_OF_PHOTONS], &accuracy->scatter_probe, 0,
                           accuracy->scatter));
    const uint32_t last = accuracy->set_count - 1;
    if (accuracy->has_caustics && accuracy->sets[last].caustics > 0.0)
        AMB_TRY(use_newest(pass, &pass->blocks[BLOCKS_OF_CAUSTICS], &accuracy->caustic_probe, last,
                           accuracy->sets[last].caustics));
    return parallel_for(&render->job, rows, 16, write_errors, pass);
}
