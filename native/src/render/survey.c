/* SPDX-License-Identifier: GPL-3.0-or-later
 * The noise of a film between two rounds. */
#include "render/survey.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "base/memory.h"
#include "render/render.h"

/* A pixel that an edge or a fold crosses, under a low-discrepancy sequence, has the variance
 * c n^-3/2 after n samples; a sum of c n^-3/2 over pixels is least for n ~ c^(1 / (1 + 3/2)). */
static const double NOISE_ORDER = 1.5;
/* Standard deviations to noise_high: it is exceeded by one in twenty. */
static const double NOISE_SIGMAS = 1.65;

void survey_clear(Survey *survey) {
    memory_free(survey->costs);
    memory_free(survey->quotas);
    memory_free(survey->rows);
    memory_free(survey->sums);
    memory_free(survey->counts);
    memory_free(survey->weights);
}

AmbStatus survey_create(AmbRender *render, Survey *out_survey) {
    const uint64_t rows = render->film.height, pixels = rows * render->film.width;
    *out_survey = (Survey){.render = render,
                           .costs = memory_alloc_array(pixels, sizeof(float)),
                           .quotas = memory_zero_array(pixels, sizeof(uint32_t)),
                           .rows = memory_alloc_array(rows, sizeof(FilmSum)),
                           .sums = memory_zero_array(rows, sizeof(double)),
                           .counts = memory_zero_array(rows, sizeof(uint64_t)),
                           .weights = memory_alloc_array(pixels, sizeof(float))};
    if (out_survey->costs == NULL || out_survey->quotas == NULL || out_survey->rows == NULL ||
        out_survey->sums == NULL || out_survey->counts == NULL || out_survey->weights == NULL) {
        survey_clear(out_survey);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to measure the error");
    }
    return AMB_OK;
}

static AmbStatus sum_rows(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    Survey *survey = user;
    for (uint64_t y = begin; y < end; ++y)
        survey->rows[y] = film_sum_row(&survey->render->film, (uint32_t)y, survey->pixels);
    return AMB_OK;
}

/* Sum over the film, row after row. */
static AmbStatus sum_film(Survey *survey, FilmSet pixels, FilmSum *out_sum) {
    AmbRender *render = survey->render;
    survey->pixels = pixels;
    AMB_TRY(parallel_for(&render->job, render->film.height, 16, sum_rows, survey));
    *out_sum = (FilmSum){.count = 0};
    for (uint32_t y = 0; y < render->film.height; ++y) {
        out_sum->variance += survey->rows[y].variance;
        out_sum->variance_square += survey->rows[y].variance_square;
        out_sum->radiance += survey->rows[y].radiance;
        out_sum->count += survey->rows[y].count;
    }
    return AMB_OK;
}

/* Standard deviation of a set's squared error from the sum of its pixels' variances. Both are sums
 * of squares of normal numbers, whose variance is two thirds of the mean of their own squares. */
static double variance_spread(const FilmSum *total) {
    return sqrt(2.0 * 2.0 / 3.0 * total->variance_square);
}

AmbStatus survey_measure_noise(Survey *survey) {
    AmbRender *render = survey->render;
    Accuracy *accuracy = &render->accuracy;
    AccuracySet sets[ACCURACY_SET_MAX];
    memcpy(sets, accuracy->sets, sizeof sets);
    FilmSum *totals = survey->totals;
    sets[0].pixels = FILM_OBJECTS;
    AMB_TRY(sum_film(survey, FILM_OBJECTS, &totals[0]));
    if (totals[0].count == 0) {
        sets[0].pixels = FILM_ALL;
        AMB_TRY(sum_film(survey, FILM_ALL, &totals[0]));
    }
    uint32_t set_count = 1;
    if (sets[0].pixels == FILM_OBJECTS && accuracy->caustic_probe.level_count > 0) {
        sets[set_count].pixels = FILM_LIT;
        AMB_TRY(sum_film(survey, FILM_LIT, &totals[set_count++]));
    }
    for (uint32_t s = 0; s < set_count; ++s) {
        const double count = (double)totals[s].count;
        sets[s].radiance = totals[s].radiance / count;
        const bool is_lit = totals[s].radiance > 0.0;
        const double variance = totals[s].variance;
        const double high = variance + NOISE_SIGMAS * variance_spread(&totals[s]);
        sets[s].noise = is_lit ? sqrt(variance / count) / sets[s].radiance : 0.0;
        sets[s].noise_high = is_lit ? sqrt(high / count) / sets[s].radiance : 0.0;
        sets[s].objects =
            is_lit ? sqrt((double)totals[0].count / count) * sets[0].radiance / sets[s].radiance
                   : 0.0;
    }
    pthread_mutex_lock(&render->lock);
    accuracy->has_noise = true;
    accuracy->set_count = set_count;
    memcpy(accuracy->sets, sets, sizeof sets);
    pthread_mutex_unlock(&render->lock);
    return AMB_OK;
}

bool survey_set_has(const Survey *survey, uint32_t set, uint64_t pixel) {
    const AmbRender *render = survey->render;
    return film_pixel_is_in(&render->film.pixels[pixel], render->accuracy.sets[set].pixels);
}

static AmbStatus find_costs(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Survey *survey = user;
    const Film *film = &survey->render->film;
    for (uint64_t i = begin * film->width; i < end * film->width; ++i) {
        const FilmPixel *pixel = &film->pixels[i];
        survey->costs[i] =
            (float)fmin(film_pixel_variance(pixel) * pow(pixel->count, NOISE_ORDER), FLT_MAX);
    }
    return AMB_OK;
}

void survey_neighbourhood(const Film *film, uint32_t x, uint32_t y, uint32_t distance,
                          uint32_t out[4]) {
    out[0] = x > distance ? x - distance : 0;
    out[1] = film->width - 1 - x > distance ? x + distance : film->width - 1;
    out[2] = y > distance ? y - distance : 0;
    out[3] = film->height - 1 - y > distance ? y + distance : film->height - 1;
}

/* What the 5 x 5 pixels around a pixel cost on average, itself left out: its samples are chosen by
 * what its own halves do not know of. To choose pixels by these passes over those whose halves
 * agree by chance, and the estimate of the whole falls short, by a fifth where an edge before a
 * bright world has most of the noise, even if they are but one of 25. They count where a pixel is
 * alone in being noisy. */
static double weight(const Survey *survey, uint32_t x, uint32_t y) {
    const Film *film = &survey->render->film;
    uint32_t range[4];
    survey_neighbourhood(film, x, y, 2, range);
    const double own = (double)survey->costs[(uint64_t)y * film->width + x];
    double sum = 0.0;
    for (uint64_t v = range[2]; v <= range[3]; ++v)
        for (uint32_t u = range[0]; u <= range[1]; ++u)
            if (u != x || v != y)
                sum += (double)survey->costs[v * film->width + u];
    const double all = (double)(range[1] - range[0] + 1) * (range[3] - range[2] + 1);
    const double others = all > 1.0 ? sum / (all - 1.0) : 0.0;
    return pow(fmax(others, own / (all * all)), 1.0 / (1.0 + NOISE_ORDER));
}

static AmbStatus sum_weights(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Survey *survey = user;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        double sum = 0.0;
        for (uint32_t x = 0; x < film->width; ++x) {
            const uint64_t i = y * film->width + x;
            const double w = weight(survey, x, (uint32_t)y);
            survey->weights[i] = (float)w;
            if (survey_set_has(survey, survey->set, i))
                sum += w;
        }
        survey->sums[y] = sum;
    }
    return AMB_OK;
}

/* Samples of the next round, an even number, and in the rows' sums how many are still missing.
 * Each pixel's at most double: what is planned from few of them is itself noisy. */
static AmbStatus share_out(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Survey *survey = user;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        double missing = 0.0;
        uint64_t given = 0;
        for (uint32_t x = 0; x < film->width; ++x) {
            const uint64_t i = y * film->width + x;
            const double have = film->pixels[i].count;
            const double want = survey->scale * (double)survey->weights[i] - have;
            uint32_t quota = 0;
            /* A few more are not worth a round. */
            if (want > have / 16.0) {
                missing += want;
                quota = 2 * (uint32_t)ceil(0.5 * fmin(want, have));
            }
            survey->quotas[i] = quota;
            given += quota;
        }
        survey->sums[y] = missing;
        survey->counts[y] = given;
    }
    return AMB_OK;
}

AmbStatus survey_plan_round(Survey *survey, const double noise[], uint64_t *out_given,
                            double *out_missing) {
    AmbRender *render = survey->render;
    const Accuracy *accuracy = &render->accuracy;
    const uint32_t rows = render->film.height;
    AMB_TRY(parallel_for(&render->job, rows, 16, find_costs, survey));
    survey->scale = 0.0;
    for (uint32_t s = 0; s < accuracy->set_count; ++s) {
        survey->set = s;
        AMB_TRY(parallel_for(&render->job, rows, 16, sum_weights, survey));
        double weights = 0.0;
        for (uint32_t y = 0; y < rows; ++y)
            weights += survey->sums[y];
        const double error = noise[s] * accuracy->sets[s].radiance;
        const double count = (double)survey->totals[s].count;
        if (weights > 0.0)
            survey->scale =
                fmax(survey->scale, pow(weights / (count * error * error), 1.0 / NOISE_ORDER));
    }
    AMB_TRY(parallel_for(&render->job, rows, 16, share_out, survey));
    *out_given = 0;
    *out_missing = 0.0;
    for (uint32_t y = 0; y < rows; ++y) {
        *out_given += survey->counts[y];
        *out_missing += survey->sums[y];
    }
    return AMB_OK;
}
