/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons in cells add to a picture's error. */
#include "render/accuracy_scatter.h"

#include "plan/plan_scatter.h"
#include "render/render.h"

/* Share that photons may take of what the field leaves of the aim. */
static const double SCATTER_SHARE = 0.7;
/* Where the field's error alone exceeds the target, photons' of this part of it is good enough. */
static const double SCATTER_OF_FIELD = 0.5;
/* n photons leave an error in n^(-1/3), a third of whose square is the same for neighbours. */
static const double ERROR_ORDER = 1.0 / 3.0, CORRELATION = 0.1;
/* The error is known from neighbours: the numbers asked for by it are for this part of the limit,
 * and what comes out a little above the limit is good enough. */
static const double LIMIT_AIM = 0.93, LIMIT_SLACK = 1.08;
/* Of one number and the next. The farther apart, the more hangs on the law above. */
static const double STEP_MIN = 1.5, STEP_MAX = 8.0, FIRST_STEP = 4.0;
/* What a few pixels tell of the noise of all may be less. */
static const double NOISE_MARGIN = 1.15;
/* Between the seeds of levels: their errors must have nothing in common but what cells blur. */
static const uint32_t SEED_STEP = 0x9e3779b9u;

/* The scatter's probe seen through photons, after coarser ones (NULL: none). */
static AmbStatus look(AmbRender *render, const Field *field, const Scatter *coarse,
                      const Scatter *scatter) {
    return render_probe(render, &render->accuracy.scatter_probe,
                        (const Field *const[2]){field, field},
                        (const Scatter *const[2]){coarse, scatter}, false);
}

/* Of the newest level, step times the photons of the level before; relative to the mean radiance.
 */
static double find_error(const Probe *probe, double step) {
    const uint32_t top = probe->level_count - 1;
    const double ratio = pow(step, ERROR_ORDER);
    const double both = 1.0 + ratio * ratio - 2.0 * CORRELATION * ratio;
    const double square = probe->differences.squares[top - 1][top] / both;
    return probe->radiance > 0.0 ? sqrt(square) / probe->radiance : 0.0;
}

static AmbStatus measure_first(AmbRender *render, const Field *field, const Scatter *fine) {
    ScatterParams *params = &render->plan.scatter;
    const ScatterParams kept = *params;
    const ScatterAccount account = render->scatter;
    params->photon_count = (uint64_t)fmax((double)kept.photon_count / FIRST_STEP, 1.0);
    params->seed = kept.seed - SEED_STEP;
    Scatter *coarse = NULL;
    AmbStatus status = render_build_scatter(render, &coarse);
    const double step = (double)kept.photon_count / (double)params->photon_count;
    *params = kept;
    render->scatter = account;
    render->plan.camera.scatter = fine;
    if (status == AMB_OK)
        status = look(render, field, NULL, coarse);
    if (status == AMB_OK)
        status = look(render, field, coarse, fine);
    scatter_destroy(coarse);
    if (status == AMB_OK)
        render->accuracy.scatter = find_error(&render->accuracy.scatter_probe, step);
    return status;
}

/* Where samples to begin with leave less noise than their share, and no caustics are to come, the
 * rest is photons'. */
static double scatter_limit(const Accuracy *accuracy) {
    const double aim = accuracy_aim(accuracy);
    const double room =
        aim * aim - accuracy->omitted * accuracy->omitted - accuracy->field * accuracy->field;
    const double least = SCATTER_OF_FIELD * accuracy->field;
    const double limit = fmax(SCATTER_SHARE * sqrt(fmax(room, 0.0)), least);
    const Probe *probe = &accuracy->scatter_probe;
    if (!accuracy->has_caustics || !(probe->radiance > 0.0))
        return limit;
    const double noise =
        NOISE_MARGIN * probe_noise(probe, ACCURACY_SAMPLES_FIRST) / probe->radiance;
    return fmax(limit, sqrt(fmax(room - noise * noise, 0.0)));
}

/* Times the photons so far that leave so much of the limit. */
static double find_step(const Accuracy *accuracy) {
    const double excess = accuracy->scatter / (LIMIT_AIM * scatter_limit(accuracy));
    return fmin(fmax(pow(excess, 1.0 / ERROR_ORDER), STEP_MIN), STEP_MAX);
}

/* More photons; *out_is_left_out where they go beyond the limit of memory. */
static AmbStatus climb(AmbRender *render, const Field *field, uint64_t count, Scatter **scatter,
                       bool *out_is_left_out) {
    ScatterParams *params = &render->plan.scatter;
    const ScatterParams kept = *params;
    params->photon_count = count;
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
    AMB_TRY(look(render, field, NULL, finer));
    const double step = (double)count / (double)kept.photon_count;
    render->accuracy.scatter = find_error(&render->accuracy.scatter_probe, step);
    return AMB_OK;
}

AmbStatus accuracy_refine_scatter(AmbRender *render, const Field *field, Scatter **scatter) {
    Accuracy *accuracy = &render->accuracy;
    const ScatterParams *params = &render->plan.scatter;
    if (*scatter == NULL || params->uses_tree_cut) /* of a tree cut nothing is known */
        return AMB_OK;
    AMB_TRY(probe_create(render->film.width, render->film.height, PROBE_PIXELS,
                         ACCURACY_SMALL * scatter_limit(accuracy), &accuracy->scatter_probe));
    const AmbStatus status = measure_first(render, field, *scatter);
    if (render_forgive_memory(render, status)) {
        accuracy->limit = "photons: a second set of them goes beyond memory_limit";
        return AMB_OK;
    }
    AMB_TRY(status);
    accuracy->has_scatter = true;
    const double most = (double)plan_photons_most(&render->params);
    while (accuracy->scatter > LIMIT_SLACK * scatter_limit(accuracy)) {
        const double have = (double)params->photon_count;
        const double count = floor(fmin(have * find_step(accuracy), most));
        bool is_left_out = render->is_reduced;
        if (!is_left_out &&
            (count < STEP_MIN * have || accuracy->scatter_probe.level_count == FIELD_LEVEL_MAX)) {
            accuracy->limit = "photons: 16 times those of light_samples are the most";
            break;
        }
        if (!is_left_out)
            AMB_TRY(climb(render, field, (uint64_t)count, scatter, &is_left_out));
        if (is_left_out) {
            accuracy->limit = "photons: more of them go beyond memory_limit";
            break;
        }
    }
    return AMB_OK;
}

/* ---- Of a fixed number of samples --------------------------------------------------------------
 */

/* Two sets of this part of the photons planned, and of FIRST_STEP times these, are looked at in few
 * pixels: a tenth of the time of what was planned. */
static const double TRIAL_PART = 1.0 / 64.0;
enum { TRIAL_PIXELS = 256 };
/* Blotches are worse to see than noise: their error shall be this part of the samples' noise, */
static const double BLOTCH_PART = 0.5;
/* for three times the photons planned at most, those beyond for half of the camera's time at most:
 * by what planned samples gather, and a photon takes what four gathers do. */
static const double FIT_MAX = 3.0, FIT_SHARE = 0.5, PHOTON_GATHERS = 4.0;

static AmbStatus look_at_trial(AmbRender *render, uint64_t count, uint32_t trial, Probe *probe) {
    ScatterParams *params = &render->plan.scatter;
    const ScatterParams kept = *params;
    params->photon_count = count;
    params->landing_part = 0.0f;
    params->seed += (trial + 1) * SEED_STEP;
    Scatter *scatter = NULL;
    AmbStatus status = render_build_scatter(render, &scatter);
    *params = kept;
    /* There is no field yet. What scatters once is missing in what errors are told by. */
    CameraParams camera = render->plan.camera;
    camera.effects &= ~(uint32_t)AMB_EFFECT_SINGLE_SCATTERING;
    camera.replicas = 2;
    camera.part_count = 1;
    camera.ledger = NULL;
    const ProbeSight sight = {render->scene, NULL, &camera, render->crop_x, render->crop_y};
    if (status == AMB_OK)
        status = render_probe_trial(render, probe, &sight);
    render->plan.camera.scatter = NULL;
    scatter_destroy(scatter);
    return status;
}

static AmbStatus fit_photons(AmbRender *render, Probe *probe) {
    ScatterParams *params = &render->plan.scatter;
    const double planned = (double)params->photon_count;
    const uint64_t first = (uint64_t)fmax(TRIAL_PART * planned, 1.0);
    const uint64_t second = (uint64_t)(FIRST_STEP * (double)first);
    AMB_TRY(look_at_trial(render, first, 0, probe));
    AMB_TRY(look_at_trial(render, second, 1, probe));
    const double noise = probe_noise(probe, render->params.samples);
    const double error = find_error(probe, FIRST_STEP) * probe->radiance;
    if (!(noise > 0.0))
        return AMB_OK;
    const double wanted = (double)second * pow(error / (BLOTCH_PART * noise), 1.0 / ERROR_ORDER);
    const PlanWalks *walks = &render->plan.walks;
    const double gathers = walks->pixels * render->params.samples * walks->without;
    const double affordable = planned + FIT_SHARE * gathers / PHOTON_GATHERS;
    const double most =
        fmin(fmin(FIT_MAX * planned, affordable), (double)plan_photons_most(&render->params));
    params->photon_count = (uint64_t)fmax(fmin(wanted, most), planned);
    params->landing_part *= (float)(planned / (double)params->photon_count);
    return AMB_OK;
}

AmbStatus accuracy_fit_scatter(AmbRender *render) {
    if (!render->plan.is_automatic || render->plan.scatter_estimator != AMB_SCATTER_PHOTONS ||
        render->params.scatter_estimator != AMB_SCATTER_AUTO || render->accuracy.target > 0.0f ||
        render->params.coarse_first) /* who looks on wants a first picture soon */
        return AMB_OK;
    Probe probe;
    AmbStatus status =
        probe_create(render->film.width, render->film.height, TRIAL_PIXELS, 0.0, &probe);
    if (status == AMB_OK)
        status = fit_photons(render, &probe);
    probe_clear(&probe);
    return render_forgive_memory(render, status) ? AMB_OK : status;
}
