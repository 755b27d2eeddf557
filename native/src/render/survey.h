/* SPDX-License-Identifier: GPL-3.0-or-later
 * The noise of a film between two rounds of camera samples, by what the two halves of each pixel's
 * samples differ by, and which pixels get the samples of the next. */
#ifndef AMB_RENDER_SURVEY_H
#define AMB_RENDER_SURVEY_H

#include "film/film_error.h"
#include "render/accuracy.h"

/* Numbers of each pixel and each row between two rounds. */
typedef struct Survey {
    struct AmbRender *render;
    uint32_t set;                     /* of the accuracy's sets: the one that is summed up */
    FilmSet pixels;                   /* its pixels */
    float *costs;                     /* by pixel: c of c n^-3/2 */
    uint32_t *quotas;                 /* by pixel: samples of the next round */
    FilmSum *rows;                    /* what counts, by row, */
    FilmSum totals[ACCURACY_SET_MAX]; /* and of all rows */
    double *sums;                     /* by row */
    uint64_t *counts;                 /* by row */
    double scale;   /* samples wanted of a pixel = scale * (smoothed c)^(1 / (1 + 3/2)) */
    float *weights; /* by pixel: (smoothed c)^(1 / (1 + 3/2)) */
} Survey;

/* Fails with AMB_OUT_OF_MEMORY, and leaves nothing then. */
AmbStatus survey_create(struct AmbRender *render, Survey *out_survey);
void survey_clear(Survey *survey);

/* The noise as it is now, into the sets of the render's accuracy. */
AmbStatus survey_measure_noise(Survey *survey);

/* Plans the next round, which leads towards that noise of each set: quotas, their sum, and how many
 * samples are missing to get there. */
AmbStatus survey_plan_round(Survey *survey, const double noise[], uint64_t *out_given,
                            double *out_missing);

/* Whether a set of the accuracy's has a pixel. */
bool survey_set_has(const Survey *survey, uint32_t set, uint64_t pixel);

/* Pixels within a distance of one: x0, x1, y0, y1, inclusive. */
void survey_neighbourhood(const Film *film, uint32_t x, uint32_t y, uint32_t distance,
                          uint32_t out[4]);

#endif
