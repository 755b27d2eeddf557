/* SPDX-License-Identifier: GPL-3.0-or-later
 * The account of an ended render. */
#include "render/report.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>

#include "field/scatter/lobe.h"
#include "film/film_error.h"

typedef struct Text {
    char *buffer;
    uint64_t size, length; /* length goes on counting when the buffer is full */
} Text;

static void add(Text *text, const char *format, ...) __attribute__((format(printf, 2, 3)));

static void add(Text *text, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    const uint64_t room = text->length < text->size ? text->size - text->length : 0;
    const int written =
        vsnprintf(room > 0 ? text->buffer + text->length : NULL, room, format, arguments);
    va_end(arguments);
    if (written > 0)
        text->length += (uint64_t)written;
}

/* JSON knows no number beyond all: light of lamps near the largest float has such sums. */
static void add_value(Text *text, double value) {
    if (isfinite(value))
        add(text, "%.9g", value);
    else
        add(text, "null");
}

static void add_rgb(Text *text, const char *name, const double v[3], const char *end) {
    add(text, "\"%s\": ", name);
    for (int k = 0; k < 3; ++k) {
        add(text, k > 0 ? ", " : "[");
        add_value(text, v[k]);
    }
    add(text, "]%s", end);
}

/* A string of the user's, as the inside of a JSON string. */
static void add_escaped(Text *text, const char *string) {
    for (const unsigned char *c = (const unsigned char *)string; *c != 0; ++c) {
        if (*c == '"' || *c == '\\' || *c < 0x20)
            add(text, "\\u%04x", *c);
        else
            add(text, "%c", *c);
    }
}

static void add_number(Text *text, const char *name, bool is_known, double value) {
    add(text, "\"%s\": ", name);
    add_value(text, is_known ? value : (double)NAN);
    add(text, ", ");
}

static void add_share(Text *text, const char *name, const Share *share) {
    const bool is_finite = isfinite(share->value) && isfinite(share->low) && isfinite(share->high);
    if (share->is_known && is_finite)
        add(text, "\"%s\": {\"value\": %.4g, \"low\": %.4g, \"high\": %.4g}", name, share->value,
            share->low, share->high);
    else
        add(text, "\"%s\": null", name);
}

/* CPU seconds of a render by effect. */
typedef struct Costs {
    const AmbRender *render; /* NULL: there was none */
    double per_ns;           /* seconds of the camera's stage for a timed nanosecond; 0: none is */
} Costs;

static Costs find_costs(const AmbRender *render) {
    Costs costs = {.render = render};
    double ns = 0.0;
    if (render == NULL || render->ledger.ns == NULL)
        return costs;
    for (uint32_t o = 0; o <= render->ledger.object_count; ++o)
        for (int e = 0; e < LEDGER_ENTRY_COUNT; ++e)
            ns += (double)ledger_ns(&render->ledger, o, (LedgerEntry)e);
    if (ns > 0.0)
        costs.per_ns = render->costs[STAGE_CAMERA].cpu / ns;
    return costs;
}

static double camera_cost(const Costs *costs, uint32_t object, LedgerEntry entry) {
    return costs->per_ns * (double)ledger_ns(&costs->render->ledger, object, entry);
}

/* Where the camera's time of an effect is booked; false where nothing is. */
static bool ledger_entry(uint32_t effect, LedgerEntry *out_entry) {
    static const struct {
        uint32_t effect;
        LedgerEntry entry;
    } known[] = {{PLAN_SINGLE_SCATTERING, LEDGER_SINGLE},
                 {PLAN_CAMERA_BOUNCES, LEDGER_BOUNCES},
                 {PLAN_SURFACE_REFLECTION, LEDGER_REFLECTION},
                 {PLAN_BACKGROUND, LEDGER_BACKGROUND},
                 {PLAN_WORLD_LIGHT, LEDGER_WORLD_LIGHT},
                 {PLAN_LIGHT_BOUNCES, LEDGER_LIGHT_BOUNCES},
                 {PLAN_TRANSMITTED_LIGHT, LEDGER_TRANSMITTED},
                 {PLAN_LIGHT_ON_SURFACES, LEDGER_SURFACES},
                 {PLAN_CAUSTICS, LEDGER_CAUSTICS},
                 {PLAN_INTERREFLECTION, LEDGER_INTERREFLECTION},
                 {PLAN_RETURN, LEDGER_RETURN},
                 {PLAN_DOUBLE_SCATTERING, LEDGER_DOUBLE},
                 {PLAN_MULTIPLE_SCATTERING, LEDGER_MULTIPLE}};
    for (uint32_t i = 0; i < sizeof known / sizeof known[0]; ++i)
        if (known[i].effect == effect) {
            *out_entry = known[i].entry;
            return true;
        }
    return false;
}

/* What is built before the camera's stage is the effect's that needs it first; the light field,
 * by the bytes that hold its light, also that of light that was reflected or has passed an object.
 */
static double light_cost(const AmbRender *render, uint32_t effect) {
    const PlanEffect *effects = render->plan.effects;
    const uint32_t of_scatter =
        effects[PLAN_MULTIPLE_SCATTERING].is_simulated ? PLAN_MULTIPLE_SCATTERING
        : effects[PLAN_DOUBLE_SCATTERING].is_simulated ? PLAN_DOUBLE_SCATTERING
                                                       : PLAN_WORLD_LIGHT;
    const FieldSize *size = &render->account.size;
    const double field = render->light_costs[LIGHT_COST_FIELD];
    const double each = size->bytes > 0 ? field / (double)size->bytes : 0.0;
    const double passed = each * (double)size->passed_bytes;
    const double reflected = each * (double)size->reflected_bytes;
    if (effect == PLAN_SINGLE_SCATTERING)
        return field - passed - reflected;
    if (effect == PLAN_LIGHT_BOUNCES)
        return reflected;
    if (effect == PLAN_TRANSMITTED_LIGHT)
        return passed;
    if (effect == of_scatter)
        return render->light_costs[LIGHT_COST_SCATTER];
    const bool has_caustics = render->plan.effects[PLAN_CAUSTICS].is_simulated;
    return effect == (has_caustics ? PLAN_CAUSTICS : PLAN_LIGHT_ON_SURFACES)
               ? render->light_costs[LIGHT_COST_CAUSTICS]
               : 0.0;
}

static void add_effect_cost(Text *text, const Costs *costs, uint32_t effect) {
    LedgerEntry entry = LEDGER_RAYS;
    const bool is_known = costs->render != NULL && costs->per_ns > 0.0 &&
                          costs->render->plan.effects[effect].is_simulated &&
                          ledger_entry(effect, &entry);
    double seconds = 0.0;
    if (is_known) {
        seconds = light_cost(costs->render, effect);
        for (uint32_t o = 0; o <= costs->render->ledger.object_count; ++o)
            seconds += camera_cost(costs, o, entry);
    }
    add_number(text, "cpu_s", is_known, seconds);
}

static void add_effect_objects(Text *text, const AmbScene *scene, const Plan *plan,
                               const Costs *costs, uint32_t e) {
    add(text, "     \"objects\": [");
    bool has_one = false;
    for (uint32_t o = 0; o < plan->object_count; ++o) {
        if (!scene->objects[o].is_boundary)
            continue;
        const PlanObject *object = &plan->objects[(uint64_t)o * PLAN_EFFECT_COUNT + e];
        add(text, "%s\n      {\"name\": \"", has_one ? "," : "");
        add_escaped(text, scene->objects[o].name);
        add(text, "\", \"simulated\": %s, ", object->is_simulated ? "true" : "false");
        LedgerEntry entry = LEDGER_RAYS;
        const bool is_known = costs->render != NULL && costs->per_ns > 0.0 &&
                              object->is_simulated && ledger_entry(e, &entry);
        add_number(text, "camera_cpu_s", is_known, is_known ? camera_cost(costs, o, entry) : 0.0);
        add_share(text, "share", &object->share);
        add(text, "}");
        has_one = true;
    }
    add(text, "]}");
}

/* What the picture shows of an effect; false where that cannot be told from the rest. */
static bool measured_share(const FilmShares *shares, uint32_t effect, double *out_share) {
    static const struct {
        uint32_t effect, index;
        bool is_order;
    } known[] = {{PLAN_SINGLE_SCATTERING, 0, true},
                 {PLAN_DOUBLE_SCATTERING, 1, true},
                 {PLAN_MULTIPLE_SCATTERING, 2, true},
                 {PLAN_SURFACE_REFLECTION, CAMERA_PART_REFLECTION, false},
                 {PLAN_BACKGROUND, CAMERA_PART_BACKGROUND, false},
                 {PLAN_CAMERA_BOUNCES, CAMERA_PART_BOUNCES, false},
                 {PLAN_WORLD_LIGHT, CAMERA_PART_WORLD_LIGHT, false},
                 {PLAN_LIGHT_BOUNCES, CAMERA_PART_LIGHT_BOUNCES, false},
                 {PLAN_TRANSMITTED_LIGHT, CAMERA_PART_TRANSMITTED, false},
                 {PLAN_CAUSTICS, CAMERA_PART_CAUSTICS, false},
                 {PLAN_INTERREFLECTION, CAMERA_PART_INTERREFLECTION, false},
                 {PLAN_RETURN, CAMERA_PART_RETURN, false}};
    if (effect == PLAN_LAMP_IMAGES) {
        *out_share = shares->lamps;
        return shares->has_any;
    }
    for (uint32_t i = 0; i < sizeof known / sizeof known[0]; ++i)
        if (known[i].effect == effect) {
            *out_share = (known[i].is_order ? shares->orders : shares->parts)[known[i].index];
            return effect == PLAN_CAUSTICS          ? shares->has_caustics
                   : effect == PLAN_INTERREFLECTION ? shares->has_any
                                                    : shares->is_known;
        }
    return false;
}

/* render: ended, or NULL. */
static void add_effects(Text *text, const AmbScene *scene, const Plan *plan,
                        const AmbRender *render) {
    const FilmShares shares =
        render != NULL ? film_shares(&render->film) : (FilmShares){.is_known = false};
    const Costs costs = find_costs(render);
    add(text, "  \"plan\": {\"automatic\": %s, \"share_min\": %.9g, ",
        plan->is_automatic ? "true" : "false", plan->share_min);
    add_number(text, "omitted", true, plan->omitted);
    add(text, "\"probes\": %llu, \"cpu_s\": %.6f},\n", (unsigned long long)plan->probe_count,
        plan->cpu);
    add(text, "  \"effects\": [\n");
    for (uint32_t i = 0; i < PLAN_EFFECT_COUNT; ++i) {
        const PlanEffect *effect = &plan->effects[i];
        add(text,
            "    {\"name\": \"%s\", \"simulated\": %s, \"count\": %u, \"reason\": \"%s\",\n     ",
            effect->name, effect->is_simulated ? "true" : "false", effect->count, effect->reason);
        add_share(text, "share", &effect->share);
        add(text, ", ");
        add_share(text, "omitted", &effect->rest);
        add(text, ", ");
        double measured = 0.0;
        /* Cells hold light of lamps and of the surroundings together. */
        const bool is_mixed = (i == PLAN_WORLD_LIGHT || i == PLAN_RETURN) &&
                              plan->scatter_estimator != AMB_SCATTER_WALK;
        const bool is_measured =
            effect->is_simulated && !is_mixed && measured_share(&shares, i, &measured);
        add_number(text, "measured", is_measured, measured);
        add_effect_cost(text, &costs, i);
        add(text, "\n");
        add_effect_objects(text, scene, plan, &costs, i);
        add(text, "%s\n", i + 1 < PLAN_EFFECT_COUNT ? "," : "");
    }
    add(text, "  ],\n");
}

static void add_stages(Text *text, const AmbRender *render) {
    add(text, "  \"stages\": [\n");
    for (int i = 0; i < STAGE_COUNT; ++i)
        add(text, "    {\"name\": \"%s\", \"cpu_s\": %.6f, \"wall_s\": %.6f}%s\n", STAGE_NAMES[i],
            render->costs[i].cpu, render->costs[i].wall, i + 1 < STAGE_COUNT ? "," : "");
    add(text, "  ],\n");
}

static void add_memory(Text *text, const AmbRender *render) {
    add(text,
        "  \"memory\": {\"scene_bytes\": %llu, \"light_bytes\": %llu, \"field_bytes\": %llu, "
        "\"film_bytes\": %llu, \"peak_rss_bytes\": %llu, \"limit_bytes\": %llu},\n",
        (unsigned long long)render->scene_bytes, (unsigned long long)render->account.light_bytes,
        (unsigned long long)render->account.size.bytes,
        (unsigned long long)film_bytes(&render->film), (unsigned long long)render->peak_rss_bytes,
        (unsigned long long)render->memory.bytes);
}

static void add_mesh_lamps(Text *text, const AmbScene *scene) {
    add(text, "\"mesh_lamps\": [");
    bool has_one = false;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_lamp) {
            add(text, "%s\"", has_one ? ", " : "");
            add_escaped(text, scene->objects[o].name);
            add(text, "\"");
            has_one = true;
        }
    add(text, "], ");
}

static void add_light(Text *text, const AmbRender *render) {
    const FieldSize *size = &render->account.size;
    add(text,
        "  \"light\": {\"rays\": %llu, \"volume_samples\": %llu, \"volume_sample_bytes\": %llu, "
        "\"tubes\": %llu, \"tube_bounces\": %u, \"lit_triangles\": %llu, \"world_suns\": %u, ",
        (unsigned long long)render->account.ray_count, (unsigned long long)size->volume_samples,
        (unsigned long long)size->point_bytes, (unsigned long long)size->tubes,
        size->tubes > 0 ? render->plan.tube_bounces : 0, (unsigned long long)size->lit_triangles,
        render->scene->world_lamp_count);
    add_mesh_lamps(text, render->scene);
    add_rgb(text, "flux_incident", render->account.tally.incident, ", ");
    add_rgb(text, "flux_entered", render->account.tally.entered, ", ");
    add_rgb(text, "flux_interacting", render->account.tally.interacting, "},\n");
}

static void add_caustics(Text *text, const AmbRender *render) {
    const CausticAccount *account = &render->caustics;
    add(text, "  \"caustics\": {\"rays\": %llu, \"photons\": %llu, \"bytes\": %llu, ",
        (unsigned long long)account->ray_count, (unsigned long long)account->photon_count,
        (unsigned long long)account->bytes);
    add_rgb(text, "flux_landed", account->landed, "},\n");
    add(text, "  \"glow\": {\"rays\": %llu, \"photons\": %llu, ",
        (unsigned long long)account->glow_ray_count,
        (unsigned long long)account->glow_photon_count);
    add_rgb(text, "flux_landed", account->glow_landed, "},\n");
}

static void add_scatter(Text *text, const AmbRender *render) {
    const ScatterAccount *scatter = &render->scatter;
    add(text, "  \"scatter\": {\"estimator\": \"%s\", \"reason\": \"%s\", ",
        plan_scatter_estimator_name(render->plan.scatter_estimator),
        render->plan.scatter_estimator_reason);
    /* Of TREE_CUT cells are volume samples, and there are no photons to tell about. */
    add(text, "\"photons\": %llu, \"collisions\": %llu, \"cells\": %llu, \"bytes\": %llu, ",
        (unsigned long long)scatter->tally.photon_count,
        (unsigned long long)scatter->tally.collision_count, (unsigned long long)scatter->cell_count,
        (unsigned long long)scatter->bytes);
    add_rgb(text, "flux_entered", scatter->tally.entered, ", ");
    add_rgb(text, "flux_absorbed", scatter->tally.absorbed, ", ");
    add_rgb(text, "flux_escaped", scatter->tally.escaped, ", ");
    add_rgb(text, "flux_lost", scatter->tally.lost, "},\n");
}

/* Relative errors; null where nothing was measured. */
static void add_accuracy(Text *text, const AmbRender *render) {
    const Accuracy *accuracy = &render->accuracy;
    const bool has_all = accuracy->has_noise && accuracy->has_field && accuracy->has_scatter &&
                         accuracy->has_caustics;
    const bool is_target = accuracy->target > 0.0f;
    const AccuracySet *set = accuracy_worst_set(accuracy);
    add(text, "  \"accuracy\": {\"target\": %.9g, \"pixels\": \"%s\", ", (double)accuracy->target,
        set->pixels == FILM_OBJECTS ? "objects"
        : set->pixels == FILM_LIT   ? "objects and caustics"
                                    : "all");
    add_number(text, "stated", has_all, accuracy_stated(accuracy));
    add_number(text, "noise", accuracy->has_noise, set->noise);
    add_number(text, "field", accuracy->has_field, set->objects * accuracy->field);
    add_number(text, "scatter", accuracy->has_scatter, set->objects * accuracy->scatter);
    add_number(text, "caustics", accuracy->has_caustics, set->caustics);
    add_number(text, "omitted", render->has_plan, set->objects * accuracy->omitted);
    add_number(text, "field_ratio", accuracy->convergence > 0.0, accuracy->convergence);
    add(text, "\"reached\": %s, \"in_reach\": %s, \"limit\": \"%s\", ",
        !is_target             ? "null"
        : accuracy->is_reached ? "true"
                               : "false",
        !is_target              ? "null"
        : accuracy->is_in_reach ? "true"
                                : "false",
        accuracy->limit);
    add(text, "\"samples_mean\": %.9g, \"samples_min\": %u, \"samples_max\": %u},\n",
        accuracy->samples_mean, accuracy->samples_min, accuracy->samples_max);
}

typedef struct Warnings {
    Text *text;
    bool has_one;
} Warnings;

/* name: the object, or NULL. */
static void warn(Warnings *warnings, const char *name, const char *what, uint64_t count) {
    if (count == 0)
        return;
    add(warnings->text, "%s\n    {\"text\": \"", warnings->has_one ? "," : "");
    if (name != NULL) {
        add_escaped(warnings->text, name);
        add(warnings->text, ": ");
    }
    add(warnings->text, "%s\", \"count\": %llu}", what, (unsigned long long)count);
    warnings->has_one = true;
}

/* Under a target they are what was needed, on average. */
static uint32_t used_samples(const AmbRender *render) {
    const bool is_target = render->accuracy.target > 0.0f;
    return is_target ? (uint32_t)lround(render->accuracy.samples_mean) : render->params.samples;
}

/* A path in a million slips between the faces of a closed mesh by rounding. What fewer rays find is
 * not seen in a picture. */
static const double HOLE_PART = 1e-4;

/* Of several objects with holes the first is named: once it is closed, the next. */
static void warn_of_holes(Warnings *warnings, const AmbRender *render, const SceneLeaks *leaks,
                          uint64_t rays, const char *what) {
    if ((double)leaks->count > HOLE_PART * (double)rays)
        warn(warnings, render->scene->objects[leaks->object].name, what, leaks->count);
}

/* Photons whose cells are too coarse for a medium's lobes. */
static bool is_too_sharp(const AmbRender *render, const SceneObject *object) {
    const AmbScene *scene = render->scene;
    if (render->plan.scatter_estimator != AMB_SCATTER_PHOTONS || !object->is_boundary)
        return false;
    const Medium *medium = &scene->materials[object->inside].medium;
    for (uint32_t l = 0; l < medium->lobe_count; ++l)
        if (!lobe_keeps_mean(medium->lobes[l].g))
            return true;
    return false;
}

static void add_warnings(Text *text, const AmbRender *render, uint64_t nonfinite) {
    Warnings warnings = {text, false};
    add(text, "  \"warnings\": [");
    for (uint32_t o = 0; o < render->scene->object_count; ++o) {
        const SceneObject *object = &render->scene->objects[o];
        warn(&warnings, object->name, "its faces point inward; they were taken the other way round",
             object->is_boundary && object->is_inside_out);
        warn(&warnings, object->name,
             "its faces have different media; the one of most faces fills all of it",
             object->has_two_media);
        warn(&warnings, object->name,
             "it scatters too sharply for photons: orders from the second on are some percent off",
             is_too_sharp(render, object));
    }
    warn_of_holes(&warnings, render, &render->account.leaks, render->account.ray_count,
                  "light rays left it through a hole in its mesh: close it for a right picture");
    SceneLeaks seen = {.count = atomic_load(&render->camera_leak_count)};
    seen.object = atomic_load(&render->camera_leak_object);
    const uint64_t pixels = (uint64_t)render->film.width * render->film.height;
    warn_of_holes(&warnings, render, &seen, pixels * used_samples(render),
                  "camera rays left it through a hole in its mesh: close it for a right picture");
    warn(&warnings, NULL,
         "memory_limit is reached: the light is traced and kept more coarsely than asked for",
         render->is_reduced);
    warn(&warnings, NULL, "samples were not finite and were left out: please report this scene",
         nonfinite);
    add(text, "],\n");
}

/* What was no number and was left out, by birthplace. */
typedef struct Births {
    Text *text;
    uint64_t total;
} Births;

static void add_birth(Births *births, const char *stage, const char *estimator, const char *object,
                      uint64_t count) {
    if (count == 0)
        return;
    if (births->text != NULL) {
        add(births->text, "%s\n    {\"stage\": \"%s\", \"estimator\": \"%s\", \"object\": \"",
            births->total > 0 ? "," : "", stage, estimator);
        add_escaped(births->text, object);
        add(births->text, "\", \"count\": %llu}", (unsigned long long)count);
    }
    births->total += count;
}

static uint64_t list_births(Text *text, const AmbRender *render) {
    Births births = {text, 0};
    const AmbScene *scene = render->scene;
    if (scene->intersector != NULL)
        add_birth(&births, "any", "rays", "", intersector_nonfinite(scene->intersector));
    const char *estimator = plan_estimator_name(render->plan.estimator);
    for (uint32_t o = 0; render->nonfinite_objects != NULL && o < scene->object_count; ++o)
        add_birth(&births, "camera", estimator, scene->objects[o].name,
                  render->nonfinite_objects[o]);
    static const char *const orders[FILM_ORDER_COUNT] = {"single scattering", "double scattering",
                                                         "multiple scattering"};
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        add_birth(&births, "camera", orders[k], "", atomic_load(&render->film.nonfinite_orders[k]));
    add_birth(&births, "camera", "surface", "", atomic_load(&render->film.nonfinite_surface));
    return births.total;
}

static uint64_t count_nonfinite(const AmbRender *render) {
    return list_births(NULL, render);
}

static void add_nonfinite(Text *text, const AmbRender *render) {
    add(text, "  \"nonfinite_by\": [");
    list_births(text, render);
    add(text, "]");
}

void report_write(const AmbRender *render, char *buffer, uint64_t size, uint64_t *out_size) {
    Text text = {buffer, buffer != NULL ? size : 0, 0};
    add(&text, "{\n  \"version\": \"%s\",\n", AMB_VERSION_STRING);
    add(&text, "  \"estimator\": \"%s\",\n", plan_estimator_name(render->plan.estimator));
    add(&text, "  \"samples\": %u,\n  \"width\": %u,\n  \"height\": %u,\n  \"threads\": %u,\n",
        used_samples(render), render->film.width, render->film.height, render->job.thread_count);
    add(&text,
        "  \"light_samples\": %llu,\n  \"kernel_size\": %.9g,\n  \"tube_refinement\": %d,\n  "
        "\"seed\": %u,\n",
        (unsigned long long)(render->has_plan ? render->plan.field.sample_target
                                              : render->params.light_samples),
        (double)render->params.kernel_size,
        render->has_plan ? render->plan.field.tube_refinement : render->params.tube_refinement,
        render->params.seed);
    add(&text, "  \"estimator_reason\": \"%s\",\n",
        render->has_plan ? render->plan.estimator_reason : "");
    if (render->has_plan)
        add_effects(&text, render->scene, &render->plan, render);
    add_stages(&text, render);
    add_memory(&text, render);
    add_light(&text, render);
    add_caustics(&text, render);
    if (render->has_plan)
        add_scatter(&text, render);
    add_accuracy(&text, render);
    const uint64_t nonfinite = count_nonfinite(render);
    add_warnings(&text, render, nonfinite);
    add(&text, "  \"nonfinite\": %llu,\n", (unsigned long long)nonfinite);
    add_nonfinite(&text, render);
    add(&text, "\n}\n");
    *out_size = text.length + 1;
}

void report_write_plan(const AmbScene *scene, const Plan *plan, char *buffer, uint64_t size,
                       uint64_t *out_size) {
    Text text = {buffer, buffer != NULL ? size : 0, 0};
    add(&text, "{\n  \"version\": \"%s\",\n", AMB_VERSION_STRING);
    add(&text, "  \"estimator\": \"%s\",\n  \"estimator_reason\": \"%s\",\n",
        plan_estimator_name(plan->estimator), plan->estimator_reason);
    add(&text, "  \"scatter_estimator\": \"%s\",\n  \"scatter_estimator_reason\": \"%s\",\n",
        plan_scatter_estimator_name(plan->scatter_estimator), plan->scatter_estimator_reason);
    add_effects(&text, scene, plan, NULL);
    add(&text, "  \"light_samples\": %llu\n}\n", (unsigned long long)plan->field.sample_target);
    *out_size = text.length + 1;
}
