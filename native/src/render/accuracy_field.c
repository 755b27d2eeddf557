/* SPDX-License-Identifier: GPL-3.0-or-later
 * How fine a light field a target takes. */
#include "render/accuracy_field.h"

#include <math.h>

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
    AMB_TRY(probe_create(render->film.width, render->film.height, PROBE_PIXELS,
                         ACCURACY_SMALL * climb->limit, &part->probe));
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
