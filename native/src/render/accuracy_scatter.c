/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons in cells add to a picture's error. */
#include "render/accuracy_scatter.h"

#include "plan/plan_scatter.h"
#include "render/render.h"

/* Share that photons may take of what the field leaves of the aim. */
static const double SCATTER_SHARE = 0.7;
/* Where the field's error alone exceeds the target, photons' of this part of it is good enough. */
static const double SCATTER_OF_FIELD = 0.5;
/* The error of four times as many photons is smaller by 4^(1/3), and a third of its square stays.
 */
static const FieldPrior PHOTON_PRIOR = {{1.587, 0.333}, 1.3, 2.5, 0.85};
/* Between the seeds of levels: their errors must have nothing in common but what cells blur. */
static const uint32_t SEED_STEP = 0x9e3779b9u;

/* The scatter's probe seen through photons, after coarser ones (NULL: none). */
static AmbStatus look(AmbRender *render, const Field *field, const Scatter *coarse,
                      const Scatter *scatter) {
    return render_probe(render, &render->accuracy.scatter_probe,
                        (const Field *const[2]){field, field},
                        (const Scatter *const[2]){coarse, scatter}, false);
}

static AmbStatus measure_first(AmbRender *render, const Field *field, const Scatter *fine) {
    ScatterParams *params = &render->plan.scatter;
    const ScatterParams kept = *params;
    const ScatterAccount account = render->scatter;
    params->photon_count = kept.photon_count > 4 ? kept.photon_count / 4 : 1;
    params->seed = kept.seed - SEED_STEP;
    Scatter *coarse = NULL;
    AmbStatus status = render_build_scatter(render, &coarse);
    *params = kept;
    render->scatter = account;
    render->plan.camera.scatter = fine;
    if (status == AMB_OK)
        status = look(render, field, NULL, coarse);
    if (status == AMB_OK)
        status = look(render, field, coarse, fine);
    scatter_destroy(coarse);
    return status;
}

static void take_error(Accuracy *accuracy) {
    const Probe *probe = &accuracy->scatter_probe;
    const uint32_t top = probe->level_count - 1;
    const double square = field_error_square(&probe->differences, top, &PHOTON_PRIOR);
    accuracy->scatter = probe->radiance > 0.0 ? sqrt(square) / probe->radiance : 0.0;
}

static double scatter_limit(const Accuracy *accuracy) {
    const double aim = accuracy_aim(accuracy);
    const double room =
        aim * aim - accuracy->omitted * accuracy->omitted - accuracy->field * accuracy->field;
    const double least = SCATTER_OF_FIELD * accuracy->field;
    return fmax(SCATTER_SHARE * sqrt(fmax(room, 0.0)), least);
}

/* Four times the photons; *out_is_left_out where they go beyond the limit of memory. */
static AmbStatus climb(AmbRender *render, const Field *field, Scatter **scatter,
                       bool *out_is_left_out) {
    ScatterParams *params = &render->plan.scatter;
    const ScatterParams kept = *params;
    params->photon_count *= 4;
    params->seed += SEED_STEP;
    Scatter *finer = NULL;
    const AmbStatus status = render_build_scatter(render, &finer);
    *out_is_left_out = render_forgive_memory(render, status);
    if (*out_is_left_out)
        *params = kept;
    if (*out_is_left_out || status != AMB_OK)
        return *out_is_left_out ? AMB_OK : status;
    scatter_destroy(*scatter);
    *scatter = finer;
    return look(render, field, NULL, finer);
}

AmbStatus accuracy_refine_scatter(AmbRender *render, const Field *field, Scatter **scatter) {
    Accuracy *accuracy = &render->accuracy;
    const ScatterParams *params = &render->plan.scatter;
    if (*scatter == NULL || params->uses_tree_cut) /* of a tree cut nothing is known */
        return AMB_OK;
    AMB_TRY(probe_create(render->film.width, render->film.height,
                         ACCURACY_SMALL * scatter_limit(accuracy), &accuracy->scatter_probe));
    const AmbStatus status = measure_first(render, field, *scatter);
    if (render_forgive_memory(render, status)) {
        accuracy->limit = "photons: a second set of them goes beyond memory_limit";
        return AMB_OK;
    }
    AMB_TRY(status);
    accuracy->has_scatter = true;
    take_error(accuracy);
    const uint64_t most = plan_photons_most(&render->params);
    while (accuracy->scatter > scatter_limit(accuracy)) {
        bool is_left_out = render->is_reduced;
        if (!is_left_out && 4 * params->photon_count > most) {
            accuracy->limit = "photons: 16 times those of light_samples are the most";
            break;
        }
        if (!is_left_out)
            AMB_TRY(climb(render, field, scatter, &is_left_out));
        if (is_left_out) {
            accuracy->limit = "photons: more of them go beyond memory_limit";
            break;
        }
        take_error(accuracy);
    }
    return AMB_OK;
}
