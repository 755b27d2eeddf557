/* SPDX-License-Identifier: GPL-3.0-or-later
 * The camera pass. */
#include "camera/camera_path.h"

#include "camera/scatter_walk.h"
#include "camera/shade.h"

enum { DEPTH_MAX = 256 }; /* boundaries along one branch, a guard against endless paths */
/* Boundaries from which on late_throughput holds: before, where all is that a path sees of a single
 * object, a pixel's rays stay as even as their places in it. */
enum { LATE_DEPTH = 6 };

typedef struct Branch {
    Vec3 o, d;
    float before; /* m, from the boundary to o, which is just off it: medium, too */
    float t_max;
    Rgb throughput;
    MediumStack stack;
    CameraWay way;  /* so far */
    Rgb forward;    /* optical depth so far of what photons' media scatter straight on */
    uint32_t depth; /* boundaries so far */
} Branch;

/* Notes what light did before it scattered. */
static void note_light(CameraSample *sample, Rgb throughput, const FieldRadiance *gathered) {
    sample->parts[CAMERA_PART_LIGHT_BOUNCES] += rgb_mean(rgb_mul(throughput, gathered->reflected));
    sample->parts[CAMERA_PART_TRANSMITTED] += rgb_mean(rgb_mul(throughput, gathered->passed));
}

FieldRadiance walker_gather(Walker *walker, FieldSegment segment, Rgb throughput) {
    LedgerClock *clock = &walker->clock;
    FieldTimes times = {0.0, 0.0};
    segment.reflected_excess = walker_reflected_excess(walker);
    segment.times = clock->ledger != NULL ? &times : NULL;
    FieldRadiance gathered;
    /* Timed ones do not wait, and tell the frequency for that. */
    field_gather_many(walker->field, &segment, 1, clock->ledger != NULL, &gathered);
    if (clock->ledger != NULL) {
        ledger_take(clock, LEDGER_LIGHT_BOUNCES, times.reflected);
        ledger_take(clock, LEDGER_TRANSMITTED, times.passed);
    }
    note_light(walker->out, throughput, &gathered);
    return gathered;
}

/* Adds what was gathered along a branch: what scattered once, and what went straight on then. */
static void add_gathered(const CameraParams *params, CameraSample *sample,
                         const WaitingGather *gather, const FieldRadiance *gathered) {
    if ((params->effects & AMB_EFFECT_SINGLE_SCATTERING) != 0) {
        const Rgb single = rgb_mul(gather->throughput, gathered->radiance);
        sample->orders[0] = rgb_add(sample->orders[0], single);
        sample_note(sample, &gather->way, single);
    }
    if (params->scatter != NULL)
        walk_add_straight(params, sample, &gather->way, gather->forward, gather->throughput,
                          gathered);
}

static void add_frequency(CameraSample *sample, Rgb throughput, const FieldRadiance *gathered) {
    const float weight = rgb_mean(throughput);
    sample->frequency += weight * gathered->frequency;
    sample->contribution += weight * gathered->contribution;
}

/* The first of a sample waits for those of its neighbours, unless it is timed. */
static void gather_single(Walker *walker, const WaitingGather *gather) {
    if (walker->waiting != NULL && !walker->waiting->is_there && walker->clock.ledger == NULL) {
        *walker->waiting = *gather;
        walker->waiting->segment.reflected_excess = walker_reflected_excess(walker);
        return;
    }
    const LedgerEntry before = ledger_open(&walker->clock, LEDGER_SINGLE);
    const FieldRadiance gathered = walker_gather(walker, gather->segment, gather->throughput);
    ledger_close(&walker->clock, before);
    add_gathered(walker->params, walker->out, gather, &gathered);
    if (walker->clock.ledger != NULL)
        add_frequency(walker->out, gather->throughput, &gathered);
}

/* Throughput for light that goes straight on after it scattered, too. */
static Rgb grown(Rgb throughput, Rgb forward) {
    return rgb_mul(throughput, rgb(expf(forward.r), expf(forward.g), expf(forward.b)));
}

/* Adds to what denoisers tell things from light by. Throughputs lack the square of the index of
 * the medium that they are in, see follow_boundary. */
static void see_albedo(Walker *walker, const Branch *branch, Rgb albedo) {
    const float ior = medium_stack_ior(walker->scene, &branch->stack);
    const Rgb seen = rgb_mul(rgb_scale(branch->throughput, ior * ior), albedo);
    walker->out->albedo = rgb_add(walker->out->albedo, seen);
}

/* Of what shines the radiance, as far as an albedo goes. */
static Rgb up_to_one(Rgb radiance) {
    return rgb(fminf(radiance.r, 1.0f), fminf(radiance.g, 1.0f), fminf(radiance.b, 1.0f));
}

/* Adds what scattered along the branch inside its medium, and attenuates the branch. */
static void pass_medium(Walker *walker, Branch *branch, float length) {
    const Medium *medium = &medium_stack_material(walker->scene, &branch->stack)->medium;
    const uint32_t object = medium_stack_top(&branch->stack);
    const Rgb straight = walk_straight(walker->params, object);
    const FieldSegment segment = {.o = vec3_madd(branch->o, -branch->before, branch->d),
                                  .d = branch->d,
                                  .length = branch->before + length,
                                  .object = object,
                                  .part = walker->part,
                                  .straight = straight};
    if (walker->observer != NULL && medium_scatters(medium))
        walker->observer->see_medium(walker->observer->user, &branch->way, &segment, 0,
                                     branch->throughput);
    const bool is_wanted = walker->field != NULL && medium_scatters(medium) &&
                           ((walker->params->effects & AMB_EFFECT_SINGLE_SCATTERING) != 0 ||
                            rgb_max(rgb_add(branch->forward, straight)) > 0.0f);
    const float gathers =
        is_wanted ? walker_gathers(walker, grown(branch->throughput, branch->forward)) : 0.0f;
    if (gathers > 0.0f)
        gather_single(walker,
                      &(WaitingGather){segment, branch->way, rgb_scale(branch->throughput, gathers),
                                       branch->forward, true});
    /* What the walls reflect goes on in the walk of the first stretch. */
    if (branch->way.bounces == 0 && walk_is_wanted(walker->params) && medium_scatters(medium)) {
        walker->way = branch->way;
        walk_scatter(walker, branch->o, branch->d, &branch->stack, branch->throughput,
                     branch->forward, true);
    }
    see_albedo(walker, branch, medium_scattered(medium, segment.length));
    branch->throughput = rgb_mul(branch->throughput, medium_transmittance(medium, segment.length));
    if (walker->params->scatter != NULL)
        branch->forward = scatter_forward_depth(
            branch->forward, scatter_forward(walker->params->scatter, object), segment.length);
}

/* Adds light that arrives at the end of the branch; what scatters straight on of a lamp's is in the
 * light field. */
static void see_light(Walker *walker, const Branch *branch, Rgb radiance, bool is_of_lamp) {
    const Rgb arriving = rgb_mul(branch->throughput, radiance);
    if (walker->observer != NULL)
        walker->observer->see_light(walker->observer->user, &branch->way, 0, arriving);
    else
        walker->out->surface = rgb_add(walker->out->surface, arriving);
    walker_note(walker, &branch->way, arriving);
    if (walker->observer == NULL && !is_of_lamp)
        walk_see_straight(walker, &branch->way, branch->forward, arriving);
}

static void see_surface(Walker *walker, const Branch *branch, Rgb radiance) {
    see_light(walker, branch, radiance, false);
}

/* With what chance a branch goes on behind a boundary: surely, if it is 1 or more. */
static float survival(const Walker *walker, const Branch *from, const MediumStack *stack,
                      Rgb throughput) {
    const float strongest = rgb_max(grown(throughput, from->forward));
    const float late = walker->params->late_throughput;
    if (from->depth < LATE_DEPTH || !(late > 0.0f))
        return strongest / WALKER_ROULETTE_THROUGHPUT;
    /* Throughputs lack the square of the index, see follow_boundary: total reflection in glass is
     * of no less worth than outside. */
    const float ior = medium_stack_ior(walker->scene, stack);
    return ior * ior * strongest / late;
}

static void follow(Walker *walker, Branch branch);

static void follow_next(Walker *walker, const Branch *from, const SurfacePoint *surface, Vec3 d,
                        const MediumStack *stack, Rgb throughput, CameraWay way) {
    if (from->depth + 1 >= DEPTH_MAX)
        return;
    const float chance = survival(walker, from, stack, throughput);
    if (chance < 1.0f) {
        if (walker_random(walker) >= chance)
            return;
        throughput = rgb_scale(throughput, 1.0f / chance);
    }
    const Vec3 o = scene_leave(surface, d);
    follow(walker, (Branch){.o = o,
                            .d = d,
                            .before = fmaxf(vec3_dot(vec3_sub(o, surface->p), d), 0.0f),
                            .t_max = INFINITY,
                            .throughput = throughput,
                            .stack = *stack,
                            .way = way,
                            .forward = from->forward,
                            .depth = from->depth + 1});
}

static void follow_boundary(Walker *walker, const Branch *branch,
                            const BoundaryCrossing *crossing) {
    const bool is_outside = branch->stack.count == 0;
    const bool leaves = crossing->beyond.count == 0;
    const SurfacePoint *surface = &crossing->surface;
    const SceneMaterial *material = surface->material;
    const uint32_t effects = walker->params->effects;
    const float reflectance = crossing->split.reflectance;

    const bool wants_refraction = !leaves || (effects & AMB_EFFECT_BACKGROUND) != 0;
    if (reflectance < 1.0f && wants_refraction) {
        /* Radiance grows by n^2 on entering a denser medium; looking backwards, the branch's
         * throughput takes (n here / n beyond)^2 ([Veach97] 5.2). */
        const float weight = (1.0f - reflectance) * crossing->eta * crossing->eta;
        const Rgb throughput =
            rgb_mul(rgb_scale(branch->throughput, weight), material->transmit_color);
        CameraWay way = branch->way;
        way.object = surface->object;
        way.effects |= leaves ? AMB_EFFECT_BACKGROUND : 0u;
        follow_next(walker, branch, surface, crossing->refracted, &crossing->beyond, throughput,
                    way);
    }
    const bool wants_reflection = is_outside ? (effects & AMB_EFFECT_SURFACE_REFLECTION) != 0
                                             : branch->way.bounces < walker->params->bounces;
    if (reflectance > 0.0f && wants_reflection) {
        const Rgb throughput =
            rgb_mul(rgb_scale(branch->throughput, reflectance), material->reflect_color);
        CameraWay way = branch->way;
        way.object = surface->object;
        way.effects |= is_outside ? AMB_EFFECT_SURFACE_REFLECTION : 0u;
        way.bounces += is_outside ? 0u : 1u;
        follow_next(walker, branch, surface, crossing->reflected, &branch->stack, throughput, way);
    }
}

/* Whose time a branch takes. */
static LedgerEntry way_entry(const CameraWay *way) {
    if (way->bounces > 0)
        return LEDGER_BOUNCES;
    if ((way->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0)
        return LEDGER_REFLECTION;
    return (way->effects & AMB_EFFECT_BACKGROUND) != 0 ? LEDGER_BACKGROUND : LEDGER_RAYS;
}

static void follow_arrival(Walker *walker, Branch branch);

static void follow(Walker *walker, Branch branch) {
    LedgerClock *clock = &walker->clock;
    if (clock->ledger == NULL) {
        follow_arrival(walker, branch);
        return;
    }
    const LedgerEntry entry = clock->entry;
    const uint32_t object = clock->object;
    ledger_switch(clock, way_entry(&branch.way), branch.way.object);
    follow_arrival(walker, branch);
    ledger_switch(clock, entry, object);
}

/* Lamps on the way of a branch that has met a boundary; to the eye itself they are invisible, as in
 * Cycles. An observer does not see them, either: small and bright, they would be all that few
 * probes tell. Lamps of the world's image are seen there. The branch goes on for `length`, through
 * `inside` of it in its medium. */
static void see_lamps(Walker *walker, const Branch *branch, float length, float inside) {
    const AmbScene *scene = walker->scene;
    if (walker->observer != NULL || branch->depth == 0 ||
        (walker->params->effects & AMB_EFFECT_LAMP_IMAGES) == 0)
        return;
    for (uint32_t l = 0; l < scene->light_count - scene->world_lamp_count; ++l) {
        const SceneLight *light = &scene->lights[l];
        float t = 0.0f;
        const Rgb radiance = light_has_extent(light)
                                 ? light_seen(light, branch->o, branch->d, length, &t)
                                 : rgb(0, 0, 0);
        if (!(rgb_max(radiance) > 0.0f))
            continue;
        Rgb arriving = rgb_mul(branch->throughput, radiance);
        if (branch->stack.count > 0) {
            const SceneMaterial *material = medium_stack_material(scene, &branch->stack);
            arriving = rgb_mul(arriving, medium_transmittance(&material->medium, fminf(t, inside)));
        }
        walker->out->lamps = rgb_add(walker->out->lamps, arriving);
    }
}

static void follow_arrival(Walker *walker, Branch branch) {
    const AmbScene *scene = walker->scene;
    const bool is_inside = branch.stack.count > 0;
    BoundaryArrival arrival;
    MediumStack end = branch.stack;
    const bool is_hit = boundary_find(scene, &end, branch.o, branch.d, branch.t_max, &arrival);
    /* A medium that an open mesh does not end is as large as the scene. */
    const float length = is_hit ? arrival.t : fminf(branch.t_max, scene_end(scene, branch.o));
    see_lamps(walker, &branch, is_hit ? arrival.t : branch.t_max, length);
    if (is_inside) {
        if (!is_hit && !isfinite(branch.t_max))
            scene_leaks_add(&walker->out->leaks, 1, medium_stack_top(&branch.stack));
        pass_medium(walker, &branch, length);
    }
    branch.stack = end;
    CameraSample *out = walker->out;
    if (!is_hit) {
        const bool is_seen_directly = branch.depth == 0;
        if (is_seen_directly && walker->params->film_transparent) {
            out->alpha = 0.0f;
            return;
        }
        const Rgb radiance = world_radiance(&scene->world, branch.d);
        see_surface(walker, &branch, radiance);
        see_albedo(walker, &branch, up_to_one(radiance));
        return;
    }
    const SurfacePoint *surface = &arrival.crossing.surface;
    if (branch.depth == 0) {
        out->depth = arrival.t;
        const float side = vec3_dot(surface->ng, branch.d) < 0.0f ? 1.0f : -1.0f;
        out->normal = vec3_scale(surface->ns, side);
    }
    if (!arrival.is_opaque) {
        out->is_object = out->is_object || branch.depth == 0;
        branch.depth += arrival.passed_count;
        follow_boundary(walker, &branch, &arrival.crossing);
        return;
    }
    /* An observer's light has no orders to put what glows on the surface into. */
    walker->way = branch.way;
    const Rgb glow = walker->observer != NULL ? rgb(0, 0, 0) : branch.throughput;
    const DiffuseLight light =
        shade_diffuse(walker, surface, branch.d, &branch.stack, glow,
                      (walker->params->effects & AMB_EFFECT_INTERREFLECTION) != 0);
    see_albedo(walker, &branch,
               up_to_one(rgb_add(scene_albedo(scene, surface), surface->material->emission)));
    see_surface(walker, &branch, light.radiance);
    if (rgb_max(light.lamp) > 0.0f)
        see_light(walker, &branch, light.lamp, true);
    out->parts[CAMERA_PART_CAUSTICS] += rgb_mean(rgb_mul(branch.throughput, light.caustics));
    if (rgb_max(light.interreflected) > 0.0f) {
        branch.way.effects |= AMB_EFFECT_INTERREFLECTION;
        see_surface(walker, &branch, light.interreflected);
    }
}

/* Neighbouring pixels begin with different parts: then what one sample lacks is noise. */
static uint32_t choose_part(const CameraParams *params, Rng pixel_rng, uint32_t index) {
    if (params->part_count <= 1)
        return 0;
    const uint32_t replica = index % params->replicas;
    const float shift = rng_float(pixel_rng, 2 * params->replicas + replica);
    const uint32_t first = (uint32_t)(shift * (float)params->part_count);
    return 1 + (first + index / params->replicas) % params->part_count;
}

static CameraSample sample_pixel(const AmbScene *scene, const Field *field,
                                 const CameraObserver *observer, const CameraParams *params,
                                 uint32_t x, uint32_t y, uint32_t index, WaitingGather *waiting) {
    const uint64_t pixel = (uint64_t)y * params->width + x;
    /* A low-discrepancy sequence, turned for each pixel and replica, covers its area. */
    const Rng pixel_rng = rng_create(params->seed, RNG_STAGE_CAMERA, pixel);
    const uint32_t replica = index % params->replicas;
    const Sample2 jitter = sample_r2(index / params->replicas, rng_float(pixel_rng, 2 * replica),
                                     rng_float(pixel_rng, 2 * replica + 1));
    CameraSample sample = {.alpha = 1.0f, .depth = CAMERA_DEPTH_NONE};
    Walker walker = {.scene = scene,
                     .field = field,
                     .params = params,
                     .rng = {rng_mix(pixel_rng.key + index + 1)},
                     .out = &sample,
                     .observer = observer,
                     .part = choose_part(params, pixel_rng, index),
                     .waiting = waiting,
                     .clock = {.object = UINT32_MAX}};
    if (params->ledger != NULL && walker.rng.key % LEDGER_PERIOD == 0) {
        walker.clock.ledger = params->ledger;
        walker.clock.since = clock_thread_cpu();
    }
    const Sample2 lens = walker_random2(&walker);
    const CameraRay ray = camera_ray(&scene->camera, ((float)x + jitter.u) / (float)params->width,
                                     ((float)y + jitter.v) / (float)params->height, lens);
    const MediumStack stack =
        params->may_start_inside ? scene_media_at(scene, ray.o) : (MediumStack){.count = 0};
    const uint32_t object = stack.count > 0 ? medium_stack_top(&stack) : UINT32_MAX;
    follow(&walker, (Branch){.o = ray.o,
                             .d = ray.d,
                             .t_max = ray.t_max,
                             .throughput = {1, 1, 1},
                             .way = {.object = object},
                             .stack = stack});
    if (walker.clock.ledger != NULL)
        ledger_switch(&walker.clock, LEDGER_RAYS, UINT32_MAX);
    const float ior = medium_stack_ior(scene, &stack);
    sample.albedo = rgb_scale(sample.albedo, 1.0f / (ior * ior));
    if (sample.depth != CAMERA_DEPTH_NONE)
        sample.depth = ray.depth_o + sample.depth * ray.cos_axis;
    return sample;
}

/* Which gathers tell frequencies, bit by bit: see camera_samples. */
static uint64_t choose_frequencies(const CameraRequest requests[], const uint32_t owners[],
                                   uint32_t count) {
    uint64_t bits = 0;
    const CameraRequest *last = NULL;
    for (uint32_t k = 0; k < count; ++k) {
        const CameraRequest *request = &requests[owners[k]];
        if (!request->wants_frequency ||
            (last != NULL && last->x == request->x && last->y == request->y))
            continue;
        bits |= UINT64_C(1) << k;
        last = request;
    }
    return bits;
}

/* Adds what samples left for later. */
static void gather_waiting(const Field *field, const CameraParams *params,
                           const CameraRequest requests[], const WaitingGather waiting[],
                           uint32_t count, CameraSample out[]) {
    FieldSegment segments[CAMERA_BATCH];
    uint32_t owners[CAMERA_BATCH], size = 0;
    for (uint32_t i = 0; i < count; ++i)
        if (waiting[i].is_there) {
            segments[size] = waiting[i].segment;
            owners[size++] = i;
        }
    if (size == 0)
        return;
    const uint64_t with_frequency = choose_frequencies(requests, owners, size);
    FieldRadiance gathered[CAMERA_BATCH];
    field_gather_many(field, segments, size, with_frequency, gathered);
    for (uint32_t k = 0; k < size; ++k) {
        const WaitingGather *gather = &waiting[owners[k]];
        CameraSample *sample = &out[owners[k]];
        add_gathered(params, sample, gather, &gathered[k]);
        note_light(sample, gather->throughput, &gathered[k]);
        if ((with_frequency >> k & 1) != 0)
            add_frequency(sample, gather->throughput, &gathered[k]);
    }
}

AmbStatus camera_samples(const AmbScene *scene, const Field *field, const CameraParams *params,
                         const CameraRequest requests[], uint32_t count, CameraSample out[]) {
    WaitingGather waiting[CAMERA_BATCH];
    for (uint32_t i = 0; i < count; ++i) {
        if (params->job != NULL && job_is_cancelled(params->job))
            return AMB_CANCELLED;
        waiting[i].is_there = false;
        out[i] = sample_pixel(scene, field, NULL, params, requests[i].x, requests[i].y,
                              requests[i].index, &waiting[i]);
    }
    gather_waiting(field, params, requests, waiting, count, out);
    return AMB_OK;
}

CameraSample camera_observe(const AmbScene *scene, const CameraObserver *observer,
                            const CameraParams *params, uint32_t x, uint32_t y, uint32_t index) {
    return sample_pixel(scene, NULL, observer, params, x, y, index, NULL);
}
