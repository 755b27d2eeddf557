/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons on opaque surfaces add to a picture's error. */
#include "render/accuracy_caustics.h"

#include "render/render.h"

/* Share that caustics may take of what the field and photons leave of the aim. */
static const double CAUSTIC_SHARE = 0.7;
/* Where these alone exceed the target, caustics' of this part of it is good enough. */
static const double CAUSTIC_OF_LIGHT = 0.5;
/* Of the aim: an error of this part of it need not be known well. */
static const double CAUSTIC_SMALL = 0.2;
/* Rays from a 16th of what is planned to 16 times as many, at three levels at least. */
enum { FIRST_SHIFT = 4, LAST_SHIFT = 4, RAYS_FIRST_MIN = 1 << 12, LEVELS_MIN = 3 };
/* Between the seeds of levels: the lattices of their rays must have nothing in common. */
static const uint32_t SEED_STEP = 0x9e3779b9u;
/* Measured on the scenes of docs/accuracy.md. */
static const FieldPrior CAUSTIC_PRIOR = {{1.65, 0.85}, 1.5, 2.5, 0.85};

static const uint32_t SCATTERING = AMB_EFFECT_SINGLE_SCATTERING | AMB_EFFECT_DOUBLE_SCATTERING |
                                   AMB_EFFECT_MULTIPLE_SCATTERING | AMB_EFFECT_WORLD_LIGHT;

/* Of light that is bent, and that glows; one of both may be none. */
static uint64_t count_rays(const CausticParams *params) {
    const uint64_t rays = params->light.ray_count, photons = params->glow.photon_count;
    return rays > photons ? rays : photons;
}

static void begin_with_few(uint64_t *count) {
    const uint64_t first = *count >> FIRST_SHIFT;
    if (*count > 0)
        *count = first > RAYS_FIRST_MIN ? first : RAYS_FIRST_MIN;
}

void accuracy_plan_caustics(AmbRender *render) {
    CausticParams *params = &render->plan.caustics;
    render->caustic_rays_planned = count_rays(params);
    begin_with_few(&params->light.ray_count);
    begin_with_few(&params->glow.photon_count);
}

/* Maps from coarse to fine. All are kept until the last is fine enough: pixels where light is
 * focused are looked at again through each of them. */
typedef struct Ladder {
    CausticMap *maps[FIELD_LEVEL_MAX];
    CameraParams cameras[FIELD_LEVEL_MAX];
    ProbeSight sights[FIELD_LEVEL_MAX];
} Ladder;

/* The probe that has seen all light. */
static const Probe *bright_probe(const Accuracy *accuracy) {
    for (uint32_t i = FIELD_PART_COUNT; i-- > 0;)
        if (accuracy->parts[i].probe.level_count > 0)
            return &accuracy->parts[i].probe;
    return &accuracy->caustic_probe;
}

/* What scatters is the same through all maps: where the light field's probe has told how bright it
 * is, it is left out. */
static void add_sight(const AmbRender *render, const Field *field, Ladder *ladder, uint32_t level) {
    CameraParams *camera = &ladder->cameras[level];
    *camera = render->plan.camera;
    camera->caustics = ladder->maps[level];
    camera->ledger = NULL;
    if (bright_probe(&render->accuracy) != &render->accuracy.caustic_probe) {
        field = NULL;
        camera->effects &= ~SCATTERING;
        camera->scatter = NULL;
    }
    ladder->sights[level] =
        (ProbeSight){render->scene, field, camera, render->crop_x, render->crop_y};
}

static AmbStatus look(AmbRender *render, const Field *field, Ladder *ladder) {
    Accuracy *accuracy = &render->accuracy;
    Probe *probe = &accuracy->caustic_probe;
    add_sight(render, field, ladder, probe->level_count);
    const Probe *bright = bright_probe(accuracy);
    const double aim = accuracy_aim(accuracy);
    if (probe->radiance > 0.0)
        probe->small = CAUSTIC_SMALL * aim * bright->radiance / probe->radiance;
    return render_probe_caustics(render, ladder->sights);
}

/* The errors of the newest level, by set of pixels. */
static void take_error(Accuracy *accuracy) {
    const Probe *probe = &accuracy->caustic_probe;
    const Probe *bright = bright_probe(accuracy);
    static const uint8_t shows[ACCURACY_SET_MAX] = {PROBE_OBJECT, PROBE_OBJECT | PROBE_CAUSTICS};
    const bool has_objects = probe_mean(probe, PROBE_OBJECT).count > 0;
    accuracy->set_count = has_objects ? ACCURACY_SET_MAX : 1;
    ProbeMean first = {.count = 0};
    for (uint32_t s = 0; s < accuracy->set_count; ++s) {
        const uint8_t wanted = has_objects ? shows[s] : 0;
        const ProbeMean differences = probe_mean(probe, wanted);
        const ProbeMean light = probe_mean(bright, wanted);
        if (s == 0)
            first = light;
        const double square =
            field_error_square(&differences.differences, probe->level_count - 1, &CAUSTIC_PRIOR);
        const bool is_lit = light.radiance > 0.0;
        AccuracySet *set = &accuracy->sets[s];
        set->caustics = is_lit ? sqrt(square) / light.radiance : 0.0;
        set->objects = is_lit ? sqrt((double)first.count / (double)light.count) * first.radiance /
                                    light.radiance
                              : 0.0;
    }
}

static bool is_fine(const Accuracy *accuracy) {
    const double aim = accuracy_aim(accuracy);
    for (uint32_t s = 0; s < accuracy->set_count; ++s) {
        const AccuracySet *set = &accuracy->sets[s];
        const double field = set->objects * accuracy->field;
        const double scatter = set->objects * accuracy->scatter;
        const double omitted = set->objects * accuracy->omitted;
        const double light = field * field + scatter * scatter;
        const double room = aim * aim - omitted * omitted - light;
        const double limit =
            fmax(CAUSTIC_SHARE * sqrt(fmax(room, 0.0)), CAUSTIC_OF_LIGHT * sqrt(light));
        if (set->caustics > limit)
            return false;
    }
    return true;
}

/* Four times the rays; *out_is_left_out where they go beyond the limit of memory. */
static AmbStatus climb(AmbRender *render, const Field *field, Ladder *ladder,
                       bool *out_is_left_out) {
    CausticParams *params = &render->plan.caustics;
    const CausticParams kept = *params;
    params->light.ray_count *= 4;
    params->light.seed += SEED_STEP;
    params->glow.photon_count *= 4;
    params->glow.seed += SEED_STEP;
    const uint32_t level = render->accuracy.caustic_probe.level_count;
    const AmbStatus status = render_build_caustics(render, &ladder->maps[level]);
    *out_is_left_out = render_forgive_memory(render, status);
    if (*out_is_left_out)
        *params = kept;
    if (*out_is_left_out || status != AMB_OK)
        return *out_is_left_out ? AMB_OK : status;
    return look(render, field, ladder);
}

static AmbStatus climb_until_fine(AmbRender *render, const Field *field, Ladder *ladder) {
    Accuracy *accuracy = &render->accuracy;
    const Probe *probe = &accuracy->caustic_probe;
    AMB_TRY(look(render, field, ladder));
    while (probe->level_count < LEVELS_MIN || !is_fine(accuracy)) {
        const bool is_last = 4 * count_rays(&render->plan.caustics) > render->caustic_rays_planned
                                                                          << LAST_SHIFT;
        if (probe->level_count >= LEVELS_MIN && is_last) {
            accuracy->limit = "caustics: 16 times the rays of light_samples are the most";
            break;
        }
        bool is_left_out = probe->level_count > 1 && render->is_reduced;
        if (!is_left_out)
            AMB_TRY(climb(render, field, ladder, &is_left_out));
        if (is_left_out) {
            accuracy->limit = "caustics: more photons go beyond memory_limit";
            break;
        }
        take_error(accuracy);
        accuracy->has_caustics = true;
    }
    return AMB_OK;
}

AmbStatus accuracy_refine_caustics(AmbRender *render, const Field *field, CausticMap **map) {
    Probe *probe = &render->accuracy.caustic_probe;
    AMB_TRY(probe_create(render->film.width, render->film.height, PROBE_PIXELS, 0.0, probe));
    probe->wanted = PROBE_OBJECT | PROBE_CAUSTICS;
    Ladder ladder = {.maps = {*map}};
    const AmbStatus status = climb_until_fine(render, field, &ladder);
    uint32_t finest = 0;
    for (uint32_t i = 1; i < FIELD_LEVEL_MAX; ++i)
        if (ladder.maps[i] != NULL)
            finest = i;
    for (uint32_t i = 0; i < finest; ++i)
        caustics_destroy(ladder.maps[i]);
    *map = ladder.maps[finest];
    render->plan.camera.caustics = *map;
    return status;
}
