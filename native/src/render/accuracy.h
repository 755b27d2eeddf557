/* SPDX-License-Identifier: GPL-3.0-or-later
 * A target error instead of budgets: picks the light field, and spends camera samples where the
 * picture needs them until it is reached.
 *
 *   stated^2 = noise^2 + field^2 + scatter^2 + caustics^2 + omitted^2,
 *
 * in units of the mean radiance over all channels of the pixels that show a translucent object (all
 * pixels, if none does); with caustics also over those and the pixels that show caustics, and the
 * larger one is stated. noise is what the two halves of the samples of the pixels differ by
 * (survey.h); field is what the light's discretisation costs (accuracy_field.h), scatter the same
 * of photons in cells (accuracy_scatter.h) and caustics of photons on surfaces
 * (accuracy_caustics.h); omitted are the shares of effects that the plan left out. Decisions depend
 * on results alone, never on a clock or on threads. */
#ifndef AMB_RENDER_ACCURACY_H
#define AMB_RENDER_ACCURACY_H

#include "field/field.h"
#include "film/film_error.h"
#include "render/probe.h"

struct AmbRender;

/* Of each pixel, before anything is known of its noise. */
enum { ACCURACY_SAMPLES_FIRST = 4 };

/* What levels of a part of the field told of its error. */
typedef struct FieldMeasure {
    Probe probe; /* empty unless fields were compared */
    uint32_t level, companion;
    double error; /* relative to the mean radiance */
} FieldMeasure;

/* Parts of the field whose levels are chosen one after the other: their errors are those of
 * different light. */
enum { FIELD_PART_TUBES, FIELD_PART_POINTS, FIELD_PART_COUNT };

/* What is known of the pixels of a set; errors relative to their mean radiance. */
typedef struct AccuracySet {
    FilmSet pixels;
    double radiance;
    double noise, caustics;
    double noise_high; /* the picture's is below it in 19 of 20: few pixels may have most of it */
    double objects; /* the factor of errors that the pixels with objects have alone: 1 where these
                     * are the set, less where there are others as bright */
} AccuracySet;

enum { ACCURACY_SET_MAX = 2 };

typedef struct Accuracy {
    float target; /* 0: fixed budgets */
    bool has_noise, has_field, has_scatter, has_caustics;
    double field, scatter;              /* relative to the mean radiance of the first set */
    double omitted;                     /* the same, of effects that the plan left out */
    AccuracySet sets[ACCURACY_SET_MAX]; /* pixels with objects; those and with caustics */
    uint32_t set_count;
    bool is_in_reach; /* of more samples of the camera; else they end where noise is a small part */
    bool is_reached;
    const char *limit; /* what keeps the error above the target, one phrase; "" if nothing */
    double samples_mean;
    uint32_t samples_min, samples_max; /* of a pixel */
    double convergence;                /* factor between the errors of two levels; 0: unknown */

    FieldMeasure parts[FIELD_PART_COUNT];
    Probe scatter_probe; /* empty unless photons were; its last two levels count */
    Probe caustic_probe; /* the same of caustics */
} Accuracy;

/* What the stated error has to come to: less than the target, because it is known to a tenth or two
 * and the render ends where it is small enough for the first time. Aiming at the target itself
 * leaves the true error above it in a third of renders (docs/accuracy.md). */
static inline double accuracy_aim(const Accuracy *accuracy) {
    return 0.85 * (double)accuracy->target;
}

/* An error of this part of what it may be need not be known well: what it adds to the stated one is
 * an eighth of its square at most. */
static const double ACCURACY_SMALL = 0.5;

/* The set of the larger error. */
const AccuracySet *accuracy_worst_set(const Accuracy *accuracy);

/* Error as far as it is known: the set's, and the larger one of all sets. */
double accuracy_stated_of(const Accuracy *accuracy, const AccuracySet *set);
double accuracy_stated(const Accuracy *accuracy);

/* Camera samples until the target is reached, or cannot be. */
AmbStatus accuracy_run_camera(struct AmbRender *render, const Field *field);

/* What a render of fixed budgets can say of its error, after the last sample: the noise. */
AmbStatus accuracy_measure_fixed(struct AmbRender *render);

#endif
