/* SPDX-License-Identifier: GPL-3.0-or-later
 * A target error instead of budgets. */
#include "render/accuracy.h"

#include <math.h>

#include "film/film_error.h"
#include "render/error_pass.h"
#include "render/render.h"
#include "render/survey.h"

enum { SAMPLES_MEAN_MAX = 4096 };
/* A round aims at this part of the noise wanted. */
static const double NOISE_MARGIN = 0.97;
/* A round has this part of the samples so far at least: to measure the noise and to plan costs what
 * tens of samples of a simple picture do. */
static const double ROUND_MIN = 1.0 / 32.0;
/* Where what samples do not change leaves the noise less of the target's square than this, they do
 * not try: they would be ten times as many as a target has that is in reach. */
static const double SPARE_MIN = 0.1;
/* Then, and where it exceeds the target by itself, noise of a third of the stated error's square is
 * good enough: without any the error would be a fifth less. */
static const double HIDDEN_NOISE = 0.5;
/* The same where the target is in reach, if it is reached with it, */
static const double SMALL_NOISE = 0.25;
/* a little below. */
static const double SPARE_USED = 0.9;
/* See choose_reflected_chance; within a pixel and along a walk light varies more than the rms over
 * pixels. And samples to a noise go as this power of 1 / noise, of variances c n^-3/2. */
static const double REFLECTED_NOISE = 0.1, REFLECTED_SPREAD = 2.0, REFLECTED_CHANCE_MIN = 0.125;
static const double SAMPLES_ORDER = 4.0 / 3.0;
/* See choose_late_throughput. The variance of a sample in an even world by branches lost below
 * LATE_MOST, relative to the squared mean: 0.003 by balls in one another, 0.04 by a stack of panes.
 */
static const double LATE_NOISE = 0.1, LATE_VARIANCE = 0.04, LATE_MOST = 0.1, LATE_LEAST = 0.02;
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

/* What more samples of the camera do not change. */
static double fixed_square(const Accuracy *accuracy, const AccuracySet *set) {
    return light_square(accuracy, set) + omitted_square(accuracy, set);
}

/* The square of the stated error to aim at. The worst set's is stated: where that is out of reach
 * the others need not be better. */
static double aim_square(Accuracy *accuracy) {
    const double target = (double)accuracy->target, aim = accuracy_aim(accuracy);
    double most = 0.0;
    for (uint32_t s = 0; s < accuracy->set_count; ++s)
        most = fmax(most, fixed_square(accuracy, &accuracy->sets[s]));
    const double spare = target * target - most;
    accuracy->is_in_reach = spare >= SPARE_MIN * target * target;
    if (!accuracy->is_in_reach)
        return (1.0 + HIDDEN_NOISE) * most;
    return fmax(aim * aim, most + fmin(SMALL_NOISE * most, SPARE_USED * spare));
}

/* The noise to aim at of a set, which is what the rest leaves. Where few pixels have most of it,
 * their two halves may well agree by chance: then the target must have room for noise_high, too. A
 * small picture of a black sphere before a bright world had ended at 1.25 of what it stated. */
static double noise_target(const Accuracy *accuracy, const AccuracySet *set, double aim) {
    const double fixed = fixed_square(accuracy, set), target = (double)accuracy->target;
    const double noise = sqrt(aim - fixed);
    if (!accuracy->is_in_reach || !(set->noise > 0.0))
        return noise;
    return fmin(noise, sqrt(target * target - fixed) * set->noise / set->noise_high);
}

/* The noise to aim at of each set; whether all have it. */
static bool is_calm(Accuracy *accuracy, double out_targets[ACCURACY_SET_MAX]) {
    const double aim = aim_square(accuracy);
    bool is_calm = true;
    for (uint32_t s = 0; s < accuracy->set_count; ++s) {
        out_targets[s] = noise_target(accuracy, &accuracy->sets[s], aim);
        is_calm = is_calm && accuracy->sets[s].noise <= out_targets[s];
    }
    return is_calm;
}

/* Of each pixel on average, when the noise is that. */
static double samples_to_noise(const Accuracy *accuracy, double noise_aim) {
    const double fall = accuracy->sets[0].noise / noise_aim;
    return accuracy->samples_mean * pow(fmax(fall, 1.0), SAMPLES_ORDER);
}

/* Walls within walls split a camera's path in a hundred branches of a few hundredths. Where other
 * noise takes many samples anyway, few of the later branches need to be followed in each: as few as
 * leave this part of the squared noise aimed at. */
static void choose_late_throughput(AmbRender *render, double noise_aim) {
    if (!(noise_aim > 0.0))
        return;
    const double samples = samples_to_noise(&render->accuracy, noise_aim);
    const double room = LATE_NOISE * noise_aim * noise_aim * samples;
    const double throughput = LATE_MOST * fmin(room / LATE_VARIANCE, 1.0);
    render->plan.camera.late_throughput = throughput >= LATE_LEAST ? (float)throughput : 0.0f;
}

/* Where light that walls reflect is little of the picture, AUTO looks at it in a part of the
 * gathers: of what gathers take it may be most, and of the noise it is next to nothing. Each then
 * counts for 1/chance, which adds S^2 (1/chance - 1) to the squared noise of a sample, S being the
 * rms of that light: so much that of the noise aimed at it is this part of the square. */
static void choose_reflected_chance(AmbRender *render, double noise_aim) {
    const Accuracy *accuracy = &render->accuracy;
    const PlanEffect *effect = &render->plan.effects[PLAN_LIGHT_BOUNCES];
    if (!render->plan.is_automatic || !effect->is_simulated || !effect->share.is_known ||
        render->plan.estimator != AMB_ESTIMATOR_TUBES || !(noise_aim > 0.0))
        return;
    const double samples = samples_to_noise(accuracy, noise_aim);
    const double room = REFLECTED_NOISE * noise_aim * noise_aim * samples;
    const double square = REFLECTED_SPREAD * effect->share.value * effect->share.value;
    render->plan.camera.reflected_chance =
        (float)fmax(square / (square + room), REFLECTED_CHANCE_MIN);
}

static AmbStatus run_rounds(AmbRender *render, const Field *field, Survey *survey,
                            ErrorPass *pass) {
    Accuracy *accuracy = &render->accuracy;
    const uint64_t pixels = (uint64_t)render->film.width * render->film.height;
    for (uint64_t i = 0; i < pixels; ++i)
        survey->quotas[i] = ACCURACY_SAMPLES_FIRST;
    uint64_t given = ACCURACY_SAMPLES_FIRST * pixels;
    double done = 0.0, missing = (double)given;
    for (;;) {
        render_expect(render, done + missing);
        AMB_TRY(render_round(render, field, survey->quotas));
        done += (double)given;
        count_samples(render);
        AMB_TRY(survey_measure_noise(survey));
        AMB_TRY(error_pass_write(pass, 1.0));
        double aims[ACCURACY_SET_MAX] = {0.0};
        if (is_calm(accuracy, aims))
            break;
        choose_reflected_chance(render, aims[0]);
        choose_late_throughput(render, aims[0]);
        /* The plan may find enough, or nearly, where the measure does not: then it aims lower. */
        do {
            for (uint32_t s = 0; s < accuracy->set_count; ++s)
                aims[s] *= NOISE_MARGIN;
            AMB_TRY(survey_plan_round(survey, aims, &given, &missing));
        } while ((double)given < ROUND_MIN * done);
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
    ErrorPass pass;
    AmbStatus status = error_pass_create(&survey, &pass);
    if (status == AMB_OK)
        status = run_rounds(render, field, &survey, &pass);
    error_pass_clear(&pass);
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
        accuracy->limit = render->plan.estimator == AMB_ESTIMATOR_TUBES &&
                                  accuracy->parts[FIELD_PART_TUBES].error >=
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
    ErrorPass pass;
    AmbStatus status = error_pass_create(&survey, &pass);
    if (status == AMB_OK)
        status = survey_measure_noise(&survey);
    if (status == AMB_OK)
        status = error_pass_write(&pass, FIXED_NOISE);
    accuracy->sets[0].noise *= FIXED_NOISE;
    error_pass_clear(&pass);
    survey_clear(&survey);
    return status;
}
