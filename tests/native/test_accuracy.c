/* SPDX-License-Identifier: GPL-3.0-or-later
 * The error that a render states: the noise of halves, the model of light fields of several
 * levels, and whole renders under a target. Whether it is true is tested on images. */
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include "demo.h"
#include "film/film_error.h"
#include "render/field_error.h"
#include "test.h"

/* ---- Noise ----------------------------------------------------------------------------------- */

/* A pixel of n samples, uniform in [0, 2) around their mean of 1 in every channel; *out_square is
 * the squared error of its mean. */
static FilmPixel random_pixel(uint64_t *state, uint32_t half_count, uint32_t n,
                              double *out_square) {
    FilmPixel pixel = {.count = n, .half_count = half_count};
    for (uint32_t i = 0; i < n; ++i) {
        float v[3];
        for (int k = 0; k < 3; ++k)
            v[k] = (float)test_uniform(state, 0.0, 2.0);
        const Rgb value = rgb(v[0], v[1], v[2]);
        if (i % 2 == 0)
            pixel.orders[0] = rgb_add(pixel.orders[0], value);
        else
            pixel.surface = rgb_add(pixel.surface, value);
        if (i < half_count)
            pixel.half = rgb_add(pixel.half, value);
    }
    const Rgb mean = rgb_scale(film_pixel_sum(&pixel), 1.0f / (float)n);
    const Rgb error = rgb_add(mean, rgb(-1, -1, -1));
    *out_square = (double)rgb_mean(rgb_mul(error, error));
    return pixel;
}

/* The variance of one sample is 1/3. */
static void halves_tell_the_variance_of_the_mean(void) {
    enum { PIXELS = 20000 };
    static const uint32_t counts[][2] = {{1, 2}, {1, 3}, {2, 4}, {8, 16}, {3, 16}};
    uint64_t state = 1;
    for (size_t c = 0; c < sizeof counts / sizeof counts[0]; ++c) {
        const uint32_t half = counts[c][0], n = counts[c][1];
        double stated = 0.0, squares = 0.0;
        for (int i = 0; i < PIXELS; ++i) {
            double square = 0.0;
            const FilmPixel pixel = random_pixel(&state, half, n, &square);
            stated += film_pixel_variance(&pixel) / PIXELS;
            squares += square / PIXELS;
        }
        const double variance = 1.0 / (3.0 * n);
        /* The mean of 60000 squares varies by sqrt(2 / 60000) = 0.6 % of itself. */
        ENSURE_NEAR(stated / variance, 1.0, 0.025);
        ENSURE_NEAR(squares / variance, 1.0, 0.025);
    }
    const FilmPixel one = {.count = 1, .orders = {{1, 2, 3}}};
    ENSURE(film_pixel_variance(&one) == 0.0);
    /* All that a pixel can hold: its square is no float. */
    const FilmPixel bright = {.surface = {1e38f, 2e38f, 3e38f}, .count = 2, .half_count = 1};
    ENSURE_NEAR(film_pixel_variance(&bright) / 1e76, 14.0 / 12.0, 1e-6);
}

static void only_objects_count(void) {
    Film film;
    ENSURE_STATUS(film_create(3, 2, &film), AMB_OK);
    film_zero_rows(&film, 0, 2);
    for (uint32_t x = 0; x < 3; ++x) {
        const FilmPixel pixel = {.orders = {{4.0f * (float)x, 4.0f * (float)x, 4.0f * (float)x}},
                                 .half = {1, 1, 1},
                                 .half_count = 2,
                                 .count = 4,
                                 .object_count = x == 1 ? 1 : 0};
        film_add(&film, x, 1, &pixel);
    }
    const FilmSum empty = film_sum_row(&film, 0, FILM_ALL);
    ENSURE(empty.count == 0);
    const FilmSum all = film_sum_row(&film, 1, FILM_ALL),
                  objects = film_sum_row(&film, 1, FILM_OBJECTS);
    ENSURE(all.count == 3 && objects.count == 1);
    ENSURE_NEAR(all.radiance, 0.0 + 1.0 + 2.0, 1e-6);
    ENSURE_NEAR(objects.radiance, 1.0, 1e-6);
    /* Halves of 1/2 and 3/2: a quarter of the square of 1. */
    ENSURE_NEAR(objects.variance, 0.25, 1e-6);
    film_clear(&film);
}

/* ---- Light field ----------------------------------------------------------------------------- */

static const FieldPrior PRIOR = {{2.0, 0.5}, 1.2, 6.0, 0.95};

/* Differences of levels whose errors obey the model exactly; the last one's is 1. */
static FieldDifferences model_differences(uint32_t levels, double r, double c) {
    FieldDifferences differences = {.level_count = levels};
    for (uint32_t i = 0; i < levels; ++i)
        for (uint32_t j = 0; j < levels; ++j) {
            const double a = pow(r, levels - 1 - i), b = pow(r, levels - 1 - j);
            const double together = i == j ? 1.0 : pow(c, fabs((double)i - (double)j));
            differences.squares[i][j] = a * a + b * b - 2.0 * together * a * b;
        }
    return differences;
}

static void three_levels_tell_ratio_correlation_and_error(void) {
    for (double r = 1.3; r < 5.0; r += 0.6)
        for (double c = 0.0; c < 0.95; c += 0.15) {
            const FieldDifferences d = model_differences(4, r, c);
            const FieldConvergence found = field_convergence(&d, 3, &PRIOR);
            ENSURE_NEAR(found.ratio, r, 1e-9);
            ENSURE_NEAR(found.correlation, c, 1e-6);
            for (uint32_t level = 1; level < 4; ++level)
                ENSURE_NEAR(sqrt(field_error_square(&d, level, &PRIOR)), pow(r, 3 - level),
                            1e-6 * pow(r, 3));
        }
}

static void two_levels_take_what_is_usual(void) {
    const FieldDifferences d = model_differences(2, 2.0, 0.5);
    ENSURE_NEAR(field_error_square(&d, 0, &PRIOR), 4.0, 1e-9);
    ENSURE_NEAR(field_error_square(&d, 1, &PRIOR), 1.0, 1e-9);
    /* Levels that do not differ have no error, and no ratio. */
    const FieldDifferences same = {.level_count = 3};
    ENSURE(field_convergence(&same, 2, &PRIOR).ratio == 2.0);
    ENSURE(field_error_square(&same, 2, &PRIOR) == 0.0);
}

/* ---- Renders --------------------------------------------------------------------------------- */

static double number_after(const char *report, const char *key) {
    const char *at = strstr(report, key);
    ENSURE(at != NULL);
    return at != NULL ? strtod(at + strlen(key), NULL) : (double)NAN;
}

static Demo resin_ball(uint32_t estimator, float accuracy) {
    Demo demo = demo_create();
    demo.params.width = demo.params.height = 32;
    demo.params.estimator = estimator;
    demo.params.effects = AMB_EFFECT_SINGLE_SCATTERING;
    demo.params.accuracy = accuracy;
    demo.has_ground = false;
    return demo;
}

/* Over the object's pixels the mean square of the pass is the stated error in units of their mean
 * radiance. The world is black and nothing else is there: what is not black is the object. */
static void check_error_pass(const Picture *picture) {
    const double stated = number_after(picture->report, "\"stated\": ");
    double squares = 0.0, radiance = 0.0, beside = 0.0;
    uint64_t count = 0;
    for (uint64_t i = 0; i < picture_floats(picture, PASS_ERROR); ++i) {
        const double error = (double)picture->passes[PASS_ERROR][i];
        const float *rgba = picture->passes[PASS_COMBINED] + 4 * i;
        const bool is_object = picture->passes[PASS_DEPTH][i] < 1e9f || rgba[1] > 0.0f;
        if (!is_object) {
            beside += error;
            continue;
        }
        squares += error * error;
        radiance += ((double)rgba[0] + (double)rgba[1] + (double)rgba[2]) / 3.0;
        ++count;
    }
    ENSURE(count > 100 && beside == 0.0);
    const double mean = radiance / (double)count;
    ENSURE_NEAR(sqrt(squares / (double)count) / mean / stated, 1.0, 1e-3);
}

static void target_is_reached_and_stated(void) {
    static const uint32_t estimators[] = {AMB_ESTIMATOR_TUBES, AMB_ESTIMATOR_POINTS_COVARIANCE,
                                          AMB_ESTIMATOR_POINTS_FIXED};
    for (size_t e = 0; e < sizeof estimators / sizeof estimators[0]; ++e) {
        double samples = 0.0;
        for (float target = 0.1f; target > 0.02f; target *= 0.5f) {
            Demo demo = resin_ball(estimators[e], target);
            memset(demo.world, 0, sizeof demo.world);
            Picture picture = demo_render(&demo);
            picture_check(&picture, "target");
            ENSURE(strstr(picture.report,
                          "\"reached\": true, \"in_reach\": true, \"limit\": \"\"") != NULL);
            const double stated = number_after(picture.report, "\"stated\": ");
            ENSURE(stated > 0.0 && stated <= (double)target);
            const double noise = number_after(picture.report, "\"noise\": ");
            const double field = number_after(picture.report, "\"field\": ");
            ENSURE_NEAR(hypot(noise, field), stated, 1e-6);
            const double mean = number_after(picture.report, "\"samples_mean\": ");
            ENSURE(mean >= samples);
            samples = mean;
            check_error_pass(&picture);
            picture_free(&picture);
            demo_free(&demo);
        }
        ENSURE(samples > 4.0);
    }
}

static void target_is_the_same_on_any_number_of_threads(void) {
    for (uint32_t estimator = AMB_ESTIMATOR_POINTS_FIXED; estimator <= AMB_ESTIMATOR_TUBES;
         ++estimator) {
        Demo demo = resin_ball(estimator, 0.08f);
        demo.params.threads = 1;
        Picture one = demo_render(&demo);
        static const uint32_t threads[] = {2, 7};
        for (size_t i = 0; i < sizeof threads / sizeof threads[0]; ++i) {
            demo.params.threads = threads[i];
            Picture many = demo_render(&demo);
            ENSURE(picture_is_same(&one, &many));
            picture_free(&many);
        }
        picture_free(&one);
        demo_free(&demo);
    }
}

/* No light, no object, nothing that scatters: an end, and no numbers that are not. */
static void nothing_to_measure_is_no_error(void) {
    for (int kind = 0; kind < 3; ++kind) {
        Demo demo = demo_create();
        demo.params.accuracy = 0.05f;
        demo.has_light = kind != 0;
        if (kind == 1)
            demo.material.lobe_count = 0;
        if (kind == 2)
            demo.at[0] = 1e3f; /* out of sight */
        if (kind != 1)
            memset(demo.world, 0, sizeof demo.world);
        Picture picture = demo_render(&demo);
        picture_check(&picture, "nothing");
        ENSURE(strstr(picture.report, "\"reached\": true") != NULL);
        picture_free(&picture);
        demo_free(&demo);
    }
}

/* The noise alone is known of a render of fixed budgets, and nothing of a single sample. */
static void fixed_budgets_state_their_noise(void) {
    Demo demo = resin_ball(AMB_ESTIMATOR_TUBES, 0.0f);
    demo.params.samples = 1;
    Picture picture = demo_render(&demo);
    ENSURE(strstr(picture.report, "\"stated\": null, \"noise\": null, \"field\": null") != NULL);
    picture_free(&picture);
    double last = (double)INFINITY;
    for (demo.params.samples = 2; demo.params.samples <= 32; demo.params.samples *= 4) {
        picture = demo_render(&demo);
        const double noise = number_after(picture.report, "\"noise\": ");
        ENSURE(noise > 0.0 && noise < 0.6 * last);
        last = noise;
        ENSURE(picture_mean(&picture, PASS_ERROR) > 0.0);
        picture_free(&picture);
    }
    demo_free(&demo);
}

static void progress_tells_the_error(void) {
    Demo demo = resin_ball(AMB_ESTIMATOR_TUBES, 0.01f);
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_OK);
    int32_t is_ended = 0;
    ENSURE_STATUS(amb_render_wait(render, -1.0, &is_ended), AMB_OK);
    AmbProgress progress;
    amb_progress_init(&progress);
    ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    ENSURE(progress.error > 0.0f && progress.error <= 0.01f);
    ENSURE(progress.remaining == 0.0f && progress.fraction == 1.0f);
    ENSURE(strncmp(progress.detail, "Error 0.", 8) == 0);
    ENSURE(strstr(progress.detail, " % of 1 %") != NULL);
    /* An older caller's struct ends before what is new, and stays as it is there. */
    progress.struct_size = (uint32_t)offsetof(AmbProgress, error);
    progress.error = 7.0f;
    ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    ENSURE(progress.error == 7.0f);
    amb_render_destroy(render);
    demo.params.accuracy = 1.5f;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_INVALID_ARGUMENT);
    demo.params.accuracy = NAN;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_INVALID_ARGUMENT);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

void test_accuracy(void);

void test_accuracy(void) {
    RUN(halves_tell_the_variance_of_the_mean);
    RUN(only_objects_count);
    RUN(three_levels_tell_ratio_correlation_and_error);
    RUN(two_levels_take_what_is_usual);
    RUN(target_is_reached_and_stated);
    RUN(target_is_the_same_on_any_number_of_threads);
    RUN(nothing_to_measure_is_no_error);
    RUN(fixed_budgets_state_their_noise);
    RUN(progress_tells_the_error);
}
