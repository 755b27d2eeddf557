/* SPDX-License-Identifier: GPL-3.0-or-later
 * A target error instead of budgets. */
#include "render/accuracy.h"

#include <string.h>

#include "base/memory.h"
#include "film/film_error.h"
#include "render/render.h"

/* Share of the aim that the field may take: its squares leave half to the noise. */
static const double FIELD_SHARE = 0.7;
/* Bytes of the largest light field that is built without being asked for. */
static const uint64_t FIELD_BYTES_MAX = 2ull << 30;
/* Volume samples from a 64th of those set to 16 times as many; three levels at least. */
enum { POINTS_FIRST_SHIFT = 6, POINTS_LAST_SHIFT = 4, POINTS_FIRST_MIN = 1 << 12 };
enum { POINTS_LEVELS_MIN = 3 };
enum { TUBES_LEVELS_MIN = 2 };

/* Measured on the scenes of docs/accuracy.md. */
static const FieldPrior TUBES_PRIOR = {{2.8, 0.3}, 1.5, 4.5, 0.85};
static const FieldPrior POINTS_PRIOR = {{1.75, 0.7}, 1.4, 4.0, 0.85};

/* A pixel that an edge or a fold crosses, under a low-discrepancy sequence, has the variance
 * c n^-3/2 after n samples; a sum of c n^-3/2 over pixels is least for n ~ c^(1 / (1 + 3/2)). */
static const double NOISE_ORDER = 1.5;
enum { SAMPLES_FIRST = 4, SAMPLES_MEAN_MAX = 4096 };
/* Each pixel's samples at most double from round to round: what is planned from few of them is
 * itself noisy. */
static const double NOISE_MARGIN = 0.97;
/* Where the field's error alone exceeds the target, noise of this part of it is good enough. */
static const double NOISE_OF_FIELD = 0.5;
/* One sequence is more even than its halves tell: its error is about this part of theirs, 1 for
 * noise without order, 0.6 where n^-3/2 holds ([Owen97] for scrambled nets; measured in
 * docs/accuracy.md). */
static const double FIXED_NOISE = 0.8;

/* What the field and photons of later orders cost. */
static double light_square(const Accuracy *accuracy, const AccuracySet *set) {
    const double square = accuracy->field * accuracy->field + accuracy->scatter * accuracy->scatter;
    return set->objects * set->objects * square + set->caustics * set->caustics;
}

static double omitted_square(const Accuracy *accuracy, const AccuracySet *set) {
    const double omitted = set->objects * accuracy->omitted;
    return omitted * omitted;
}

double accuracy_stated_of(const Accuracy *accuracy, const AccuracySet *set) {
    return sqrt(set->noise * set->noise + light_square(accuracy, set) +
                omitted_square(accuracy, set));
}

const AccuracySet *accuracy_worst_set(const Accuracy *accuracy) {
    const AccuracySet *worst = &accuracy->sets[0];
    for (uint32_t s = 1; s < accuracy->set_count; ++s)
        if (accuracy_stated_of(accuracy, &accuracy->sets[s]) > accuracy_stated_of(accuracy, worst))
            worst = &accuracy->sets[s];
    return worst;
}

double accuracy_stated(const Accuracy *accuracy) {
    return accuracy_stated_of(accuracy, accuracy_worst_set(accuracy));
}

/* ---- Field ----------------------------------------------------------------------------------- */

/* What has to be known of a part of the field to choose its level. */
typedef struct Climb {
    AmbRender *render;
    uint32_t part; /* FIELD_PART_* */
    uint32_t levels_min;
    const FieldPrior *prior;
    double limit; /* of its error */
} Climb;

static bool has_tubes(const AmbRender *render) {
    return render->plan.estimator == AMB_ESTIMATOR_TUBES;
}

/* Makes the plan that of a level; false if there is none so fine. */
static bool set_level(const Climb *climb, uint32_t level, uint64_t bytes_before) {
    AmbRender *render = climb->render;
    const bool is_too_large = level > 0 && 4 * bytes_before > FIELD_BYTES_MAX;
    if (is_too_large || level >= FIELD_LEVEL_MAX)
        return false;
    if (climb->part == FIELD_PART_TUBES) {
        /* So that there is one finer. Below 0 a fine mesh's tubes stay the same, and neighbouring
         * levels would not tell each other's error. */
        const int32_t asked = render->params.tube_refinement;
        const int32_t first = asked < 0                     ? 0
                              : asked < TUBE_REFINEMENT_MAX ? asked
                                                            : TUBE_REFINEMENT_MAX - 1;
        const int32_t refinement = first + (int32_t)level;
        if (refinement > TUBE_REFINEMENT_MAX)
            return false;
        render->plan.field.tube_refinement = refinement;
        return true;
    }
    const uint64_t set = render->plan.light_samples;
    const uint64_t shifted = set >> POINTS_FIRST_SHIFT;
    const uint64_t first = shifted > POINTS_FIRST_MIN ? shifted : POINTS_FIRST_MIN;
    const uint64_t samples = first << (2 * level);
    if (level >= POINTS_LEVELS_MIN && samples > set << POINTS_LAST_SHIFT)
        return false;
    plan_set_light_samples(&render->plan, samples);
    return true;
}

/* The two newest levels. */
typedef struct Ladder {
    Field *fields[2]; /* older, newer */
    FieldAccount accounts[2];
} Ladder;

/* The first level may come out coarser than wanted; the others are refinements of it, or are left
 * out where they go beyond the limit of memory. */
static AmbStatus add_level(const Climb *climb, Ladder *ladder, bool *out_is_left_out) {
    AmbRender *render = climb->render;
    Field *field = NULL;
    if (ladder->fields[1] == NULL) {
        AMB_TRY(render_build_fitting_field(render, &field));
    } else {
        const AmbStatus status = render_build_field(render, &field);
        *out_is_left_out = render_forgive_memory(render, status);
        if (*out_is_left_out)
            return AMB_OK;
        AMB_TRY(status);
    }
    field_destroy(ladder->fields[0]);
    ladder->fields[0] = ladder->fields[1];
    ladder->accounts[0] = ladder->accounts[1];
    ladder->fields[1] = field;
    ladder->accounts[1] = render->account;
    const Field *const fields[2] = {ladder->fields[0], field};
    const Scatter *scatter = render->plan.camera.scatter;
    return render_probe(render, &render->accuracy.parts[climb->part].probe, fields,
                        (const Scatter *const[2]){scatter, scatter}, true);
}

static double level_error(const Probe *probe, uint32_t level, const FieldPrior *prior) {
    const double square = field_error_square(&probe->differences, level, prior);
    return probe->radiance > 0.0 ? sqrt(square) / probe->radiance : 0.0;
}

static AmbStatus climb_until_fine(const Climb *climb, Ladder *ladder) {
    AmbRender *render = climb->render;
    Accuracy *accuracy = &render->accuracy;
    FieldMeasure *part = &accuracy->parts[climb->part];
    for (uint32_t top = 0;; ++top) {
        /* The first is built, as coarse as it must be, even if caustics or photons gave way. */
        bool is_left_out = top > 0 && render->is_reduced;
        if (!is_left_out && !set_level(climb, top, ladder->accounts[1].size.bytes))
            break;
        if (!is_left_out)
            AMB_TRY(add_level(climb, ladder, &is_left_out));
        if (is_left_out) {
            accuracy->limit = "light field: a finer one goes beyond memory_limit";
            break;
        }
        part->level = top;
        if (top > 0) {
            accuracy->has_field = true;
            part->companion = top - 1;
            part->error = level_error(&part->probe, top, climb->prior);
            const double coarser = level_error(&part->probe, top - 1, climb->prior);
            const bool is_enough = top + 1 >= climb->levels_min;
            if (is_enough && coarser <= climb->limit) {
                part->level = top - 1;
                part->companion = top;
                part->error = coarser;
            }
            accuracy->convergence =
                field_convergence(&part->probe.differences, top, climb->prior).ratio;
            /* A coarser level of tubes tells too little of the finest one's error. */
            const bool is_points = climb->part == FIELD_PART_POINTS;
            if (is_enough &&
                (coarser <= climb->limit || (is_points && part->error <= climb->limit)))
                break;
        }
    }
    return AMB_OK;
}

/* Replaces *field, if there is one, by one in which a part is fine enough. */
static AmbStatus choose_part(const Climb *climb, Field **field) {
    AmbRender *render = climb->render;
    FieldMeasure *part = &render->accuracy.parts[climb->part];
    field_destroy(*field);
    *field = NULL;
    AMB_TRY(probe_create(render->film.width, render->film.height, ACCURACY_SMALL * climb->limit,
                         &part->probe));
    Ladder ladder = {.fields = {NULL, NULL}};
    const AmbStatus status = climb_until_fine(climb, &ladder);
    if (status != AMB_OK) {
        field_destroy(ladder.fields[0]);
        field_destroy(ladder.fields[1]);
        return status;
    }
    const bool is_older = part->level + 1 < part->probe.level_count;
    *field = ladder.fields[is_older ? 0 : 1];
    render->account = ladder.accounts[is_older ? 0 : 1];
    field_destroy(ladder.fields[is_older ? 1 : 0]);
    /* The plan, and the report with it, again as the chosen level has it. */
    if (!render->is_reduced)
        set_level(climb, part->level, 0);
    return AMB_OK;
}

AmbStatus accuracy_choose_field(AmbRender *render, Field **out_field) {
    Accuracy *accuracy = &render->accuracy;
    if (render->plan.estimator == AMB_ESTIMATOR_SPECULAR) {
        /* Its light paths are solved, not sampled. */
        accuracy->has_field = true;
        return render_build_field(render, out_field);
    }
    const bool has_both = has_tubes(render) && render->plan.has_points;
    const double aim = accuracy_aim(accuracy);
    const double limit = FIELD_SHARE * sqrt(aim * aim - accuracy->omitted * accuracy->omitted) /
                         (has_both ? sqrt(2.0) : 1.0);
    const Climb tubes = {render, FIELD_PART_TUBES, TUBES_LEVELS_MIN, &TUBES_PRIOR, limit};
    const Climb points = {render, FIELD_PART_POINTS, POINTS_LEVELS_MIN, &POINTS_PRIOR, limit};
    Field *field = NULL;
    if (has_both)
        set_level(&points, 0, 0);
    AmbStatus status = has_tubes(render) ? choose_part(&tubes, &field) : AMB_OK;
    const bool has_tube_error = accuracy->has_field;
    if (status == AMB_OK && render->plan.has_points) {
        accuracy->has_field = false;
        status = choose_part(&points, &field);
        accuracy->has_field = accuracy->has_field && (has_tube_error || !has_both);
    }
    if (status != AMB_OK)
        field_destroy(field);
    else
        *out_field = field;
    accuracy->field =
        hypot(accuracy->parts[FIELD_PART_TUBES].error, accuracy->parts[FIELD_PART_POINTS].error);
    return status;
}

/* ---- Noise ----------------------------------------------------------------------------------- */

/* What two levels of a probe say of the picture's squared error, by place. */
typedef struct BlockErrors {
    const Probe *probe;
    double scale;   /* squared error in units of the probe's squared differences */
    float *squares; /* by block of the probe: smoothed squared differences, or NULL */
    uint32_t set;   /* of the accuracy's sets: whose pixels have this error */
} BlockErrors;

enum {
    BLOCKS_OF_FIELD, /* by part */
    BLOCKS_OF_PHOTONS = BLOCKS_OF_FIELD + FIELD_PART_COUNT,
    BLOCKS_OF_CAUSTICS,
    BLOCK_ERROR_COUNT
};

/* Numbers of each pixel and each row between two rounds. */
typedef struct Survey {
    AmbRender *render;
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
    float *shares;  /* by pixel: variance handed to each of the neighbours */
    BlockErrors blocks[BLOCK_ERROR_COUNT];
    const BlockErrors *measured; /* of sum_blocks */
} Survey;

static void survey_clear(Survey *survey) {
    memory_free(survey->costs);
    memory_free(survey->quotas);
    memory_free(survey->rows);
    memory_free(survey->sums);
    memory_free(survey->counts);
    memory_free(survey->weights);
    memory_free(survey->shares);
    for (int i = 0; i < BLOCK_ERROR_COUNT; ++i)
        memory_free(survey->blocks[i].squares);
}

static AmbStatus survey_create(AmbRender *render, Survey *out_survey) {
    const uint64_t rows = render->film.height, pixels = rows * render->film.width;
    *out_survey = (Survey){.render = render,
                           .costs = memory_alloc_array(pixels, sizeof(float)),
                           .quotas = memory_zero_array(pixels, sizeof(uint32_t)),
                           .rows = memory_alloc_array(rows, sizeof(FilmSum)),
                           .sums = memory_zero_array(rows, sizeof(double)),
                           .counts = memory_zero_array(rows, sizeof(uint64_t)),
                           .weights = memory_alloc_array(pixels, sizeof(float)),
                           .shares = memory_alloc_array(pixels, sizeof(float))};
    if (out_survey->costs == NULL || out_survey->quotas == NULL || out_survey->rows == NULL ||
        out_survey->sums == NULL || out_survey->counts == NULL || out_survey->weights == NULL ||
        out_survey->shares == NULL) {
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
        out_sum->radiance += survey->rows[y].radiance;
        out_sum->count += survey->rows[y].count;
    }
    return AMB_OK;
}

/* The noise as it is now. */
static AmbStatus measure_noise(Survey *survey) {
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
        sets[s].noise = is_lit ? sqrt(totals[s].variance / count) / sets[s].radiance : 0.0;
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

static bool is_in(const Survey *survey, uint32_t set, uint64_t pixel) {
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
            film_pixel_variance(pixel) * powf((float)pixel->count, (float)NOISE_ORDER);
    }
    return AMB_OK;
}

/* Pixels within a distance of one: x0, x1, y0, y1, inclusive. */
static void neighbourhood(const Film *film, uint32_t x, uint32_t y, uint32_t distance,
                          uint32_t out[4]) {
    out[0] = x > distance ? x - distance : 0;
    out[1] = film->width - 1 - x > distance ? x + distance : film->width - 1;
    out[2] = y > distance ? y - distance : 0;
    out[3] = film->height - 1 - y > distance ? y + distance : film->height - 1;
}

/* A pixel's own samples tell little of its noise, and to choose pixels by it passes over those
 * whose halves agree by chance, so that the estimate of the whole falls short. With 5 x 5 pixels
 * it does by 6 %, with 3 x 3 by 15 %, for a fifth fewer samples (bumpy, slab and sphere, 64 x
 * 64). */
static double weight(const Survey *survey, uint32_t x, uint32_t y) {
    const Film *film = &survey->render->film;
    uint32_t range[4];
    neighbourhood(film, x, y, 2, range);
    double sum = 0.0;
    for (uint64_t v = range[2]; v <= range[3]; ++v)
        for (uint32_t u = range[0]; u <= range[1]; ++u)
            sum += (double)survey->costs[v * film->width + u];
    const double count = (double)(range[1] - range[0] + 1) * (range[3] - range[2] + 1);
    return pow(sum / count, 1.0 / (1.0 + NOISE_ORDER));
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
            if (is_in(survey, survey->set, i))
                sum += w;
        }
        survey->sums[y] = sum;
    }
    return AMB_OK;
}

/* Samples of the next round, an even number, and in the rows' sums how many are still missing. */
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

/* Plans the next round, which leads towards that noise of each set. */
static AmbStatus plan_round(Survey *survey, const double noise[], uint64_t *out_given,
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

/* ---- Error pass ------------------------------------------------------------------------------ */

/* Each pixel hands its variance to those of its neighbours and itself that are alike, in equal
 * parts: smoother, and the sum stays. */
static AmbStatus find_shares(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Survey *survey = user;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y)
        for (uint32_t x = 0; x < film->width; ++x) {
            const FilmPixel *pixel = &film->pixels[y * film->width + x];
            uint32_t range[4], alike = 0;
            neighbourhood(film, x, (uint32_t)y, 1, range);
            const bool is_object = is_in(survey, 0, y * film->width + x);
            for (uint64_t v = range[2]; v <= range[3]; ++v)
                for (uint32_t u = range[0]; u <= range[1]; ++u)
                    alike += is_in(survey, 0, v * film->width + u) == is_object;
            survey->shares[y * film->width + x] = film_pixel_variance(pixel) / (float)alike;
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
    const Survey *survey = user;
    const Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        double sum = 0.0;
        for (uint32_t x = 0; x < film->width; ++x)
            if (is_in(survey, survey->measured->set, y * film->width + x))
                sum += block_square(survey->measured, x, (uint32_t)y);
        survey->sums[y] = sum;
    }
    return AMB_OK;
}

static AmbStatus write_errors(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Survey *survey = user;
    Film *film = &survey->render->film;
    for (uint64_t y = begin; y < end; ++y) {
        /* In place of the costs, which the next round finds again. */
        float *row = survey->costs + y * film->width;
        for (uint32_t x = 0; x < film->width; ++x) {
            const bool is_object = is_in(survey, 0, y * film->width + x);
            uint32_t range[4];
            neighbourhood(film, x, (uint32_t)y, 1, range);
            double square = 0.0;
            for (int i = 0; i < BLOCK_ERROR_COUNT; ++i)
                if (is_in(survey, survey->blocks[i].set, y * film->width + x))
                    square += block_square(&survey->blocks[i], x, (uint32_t)y);
            for (uint64_t v = range[2]; v <= range[3]; ++v)
                for (uint32_t u = range[0]; u <= range[1]; ++u)
                    if (is_in(survey, 0, v * film->width + u) == is_object)
                        square += (double)survey->shares[v * film->width + u];
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
static AmbStatus scale_blocks(Survey *survey, BlockErrors *errors, double error) {
    AmbRender *render = survey->render;
    errors->scale = 1.0;
    survey->measured = errors;
    AMB_TRY(parallel_for(&render->job, render->film.height, 16, sum_blocks, survey));
    double sum = 0.0;
    for (uint32_t y = 0; y < render->film.height; ++y)
        sum += survey->sums[y];
    error *= render->accuracy.sets[errors->set].radiance;
    const double count = (double)survey->totals[errors->set].count;
    errors->scale = sum > 0.0 ? error * error * count / sum : 0.0;
    return AMB_OK;
}

/* What the last two levels of photons differ by. */
static AmbStatus use_newest(Survey *survey, BlockErrors *errors, const Probe *probe, uint32_t set,
                            double error) {
    errors->probe = probe;
    errors->set = set;
    const uint32_t top = probe->level_count - 1;
    if (errors->squares == NULL)
        AMB_TRY(find_blocks(errors, top, top - 1));
    return scale_blocks(survey, errors, error);
}

/* The Error pass: over the pixels of a set, the mean of its square is (stated * radiance)^2. */
static AmbStatus write_error_pass(Survey *survey, double noise_factor) {
    AmbRender *render = survey->render;
    const Accuracy *accuracy = &render->accuracy;
    const uint32_t rows = render->film.height;
    AMB_TRY(parallel_for(&render->job, rows, 16, find_shares, survey));
    if (noise_factor != 1.0)
        for (uint64_t i = 0; i < (uint64_t)rows * render->film.width; ++i)
            survey->shares[i] *= (float)(noise_factor * noise_factor);
    for (int i = 0; i < FIELD_PART_COUNT; ++i) {
        const FieldMeasure *part = &accuracy->parts[i];
        BlockErrors *field = &survey->blocks[BLOCKS_OF_FIELD + i];
        if (!accuracy->has_field || !(part->error > 0.0))
            continue;
        field->probe = &part->probe;
        if (field->squares == NULL)
            AMB_TRY(find_blocks(field, part->level, part->companion));
        AMB_TRY(scale_blocks(survey, field, part->error));
    }
    if (accuracy->has_scatter && accuracy->scatter > 0.0)
        AMB_TRY(use_newest(survey, &survey->blocks[BLOCKS_OF_PHOTONS], &accuracy->scatter_probe, 0,
                           accuracy->scatter));
    const uint32_t last = accuracy->set_count - 1;
    if (accuracy->has_caustics && accuracy->sets[last].caustics > 0.0)
        AMB_TRY(use_newest(survey, &survey->blocks[BLOCKS_OF_CAUSTICS], &accuracy->caustic_probe,
                           last, accuracy->sets[last].caustics));
    return parallel_for(&render->job, rows, 16, write_errors, survey);
}

/* ---- Rounds ---------------------------------------------------------------------------------- */

static void count_samples(AmbRender *render) {
    const Film *film = &render->film;
    const uint64_t pixels = (uint64_t)film->width * film->height;
    uint64_t sum = 0;
    uint32_t least = UINT32_MAX, most = 0;
    for (uint64_t i = 0; i < pixels; ++i) {
        const uint32_t count = film->pixels[i].count;
        sum += count;
        least = count < least ? count : least;
        most = count > most ? count : most;
    }
    pthread_mutex_lock(&render->lock);
    render->accuracy.samples_mean = (double)sum / (double)pixels;
    render->accuracy.samples_min = least;
    render->accuracy.samples_max = most;
    render->samples_done = least;
    render->pixel_step = least > 0 ? 1 : 0;
    pthread_mutex_unlock(&render->lock);
}

/* Noise to aim at: what the field and photons leave. */
static double noise_target(const Accuracy *accuracy, const AccuracySet *set) {
    const double light = light_square(accuracy, set);
    const double aim = accuracy_aim(accuracy);
    const double room = aim * aim - light - omitted_square(accuracy, set);
    const double least = NOISE_OF_FIELD * sqrt(light);
    return sqrt(fmax(room, least * least));
}

/* The noise to aim at of each set; whether all have it. */
static bool is_calm(const Accuracy *accuracy, double out_targets[ACCURACY_SET_MAX]) {
    bool is_calm = true;
    for (uint32_t s = 0; s < accuracy->set_count; ++s) {
        out_targets[s] = noise_target(accuracy, &accuracy->sets[s]);
        is_calm = is_calm && accuracy->sets[s].noise <= out_targets[s];
    }
    return is_calm;
}

static AmbStatus run_rounds(AmbRender *render, const Field *field, Survey *survey) {
    Accuracy *accuracy = &render->accuracy;
    const uint64_t pixels = (uint64_t)render->film.width * render->film.height;
    for (uint64_t i = 0; i < pixels; ++i)
        survey->quotas[i] = SAMPLES_FIRST;
    uint64_t given = SAMPLES_FIRST * pixels;
    double done = 0.0, missing = (double)given;
    for (;;) {
        render_expect(render, done + missing);
        AMB_TRY(render_round(render, field, survey->quotas));
        done += (double)given;
        count_samples(render);
        AMB_TRY(measure_noise(survey));
        AMB_TRY(write_error_pass(survey, 1.0));
        double aims[ACCURACY_SET_MAX] = {0.0};
        if (is_calm(accuracy, aims))
            break;
        /* The plan may find enough where the measure does not: then it aims lower. */
        do {
            for (uint32_t s = 0; s < accuracy->set_count; ++s)
                aims[s] *= NOISE_MARGIN;
            AMB_TRY(plan_round(survey, aims, &given, &missing));
        } while (given == 0);
        if (done + (double)given > (double)SAMPLES_MEAN_MAX * (double)pixels) {
            accuracy->limit = "noise: 4096 samples per pixel are the most";
            break;
        }
    }
    return AMB_OK;
}

AmbStatus accuracy_run_camera(AmbRender *render, const Field *field) {
    Accuracy *accuracy = &render->accuracy;
    Survey survey;
    AMB_TRY(survey_create(render, &survey));
    const AmbStatus status = run_rounds(render, field, &survey);
    survey_clear(&survey);
    accuracy->is_reached = status == AMB_OK && accuracy->has_field && accuracy->has_scatter &&
                           accuracy->has_caustics &&
                           accuracy_stated(accuracy) <= (double)accuracy->target;
    if (!accuracy->has_field && accuracy->limit[0] == '\0')
        accuracy->limit = "light field: two levels of it exceed 2 GiB, its error is unknown";
    else if (!accuracy->has_caustics && accuracy->limit[0] == '\0')
        accuracy->limit = "caustics: a second map goes beyond memory_limit";
    else if (!accuracy->has_scatter && accuracy->limit[0] == '\0')
        accuracy->limit = "later orders: the error of a tree cut is unknown";
    else if (accuracy->limit[0] == '\0' && !accuracy->is_reached)
        accuracy->limit = has_tubes(render) && accuracy->parts[FIELD_PART_TUBES].error >=
                                                   accuracy->parts[FIELD_PART_POINTS].error
                              ? "light field: tubes are refined no further"
                              : "light field: 16 times light_samples are the most";
    return status;
}

AmbStatus accuracy_measure_fixed(AmbRender *render) {
    Accuracy *accuracy = &render->accuracy;
    count_samples(render);
    if (accuracy->samples_min < 2)
        return AMB_OK;
    Survey survey;
    AMB_TRY(survey_create(render, &survey));
    AmbStatus status = measure_noise(&survey);
    if (status == AMB_OK)
        status = write_error_pass(&survey, FIXED_NOISE);
    accuracy->sets[0].noise *= FIXED_NOISE;
    survey_clear(&survey);
    return status;
}
