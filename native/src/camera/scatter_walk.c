/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light of two and more scatterings. method.md sec. 4's walk: the last scattering before the lamp
 * is never sampled but gathered, so lamps without extent behind refractive walls are no matter. */
#include "camera/scatter_walk.h"

#include "camera/shade.h"
#include "optics/phase_sample.h"

/* Of what it began with; walks with less survive by chance in proportion. */
static const float ROULETTE_SHARE = 0.25f;
/* How much less a walk tries to leave where there is nothing to be seen outside: it may still come
 * back into an object. */
static const float DARK_OUTSIDE = 0.1f;

/* A guard; roulette ends walks long before, but in white media whose free paths are a thousandth of
 * the object and less. There all light has scattered often, and probes see so after fewer. */
enum { EVENT_MAX = 1 << 20, PROBE_EVENT_MAX = 1 << 13 };

typedef struct Walk {
    Walker *walker;
    Vec3 o, d;
    MediumStack stack;
    Rgb throughput;
    float begin;      /* rgb_max of the throughput at the start */
    uint32_t order;   /* scatterings so far, */
    uint32_t first;   /* and those before the walk began */
    uint32_t still;   /* flights until now that moved nothing */
    Rgb forward;      /* optical depth so far of what scatters straight on; see scatter_gather */
    uint32_t bounces; /* internal reflections before the first scattering */
    bool is_seen;     /* branches of the camera path see this stretch, too */
    bool is_its_own;  /* false: branches of the camera path go where this one refracts */
} Walk;

/* The end of a segment. */
typedef struct Target {
    float length;
    bool is_hit;
    bool is_boundary;  /* dielectric, with a crossing */
    bool has_passed;   /* boundaries that change no medium */
    MediumStack stack; /* there, with what was passed */
    SurfacePoint surface;
    BoundaryCrossing crossing;
} Target;

static uint32_t order_limit(const CameraParams *params) {
    const bool has_world = (params->effects & AMB_EFFECT_WORLD_LIGHT) != 0 &&
                           (params->effects & AMB_EFFECT_SINGLE_SCATTERING) != 0;
    uint32_t last = has_world ? 1 : 0;
    if ((params->effects & AMB_EFFECT_DOUBLE_SCATTERING) != 0)
        last = 2;
    if ((params->effects & AMB_EFFECT_MULTIPLE_SCATTERING) != 0)
        last = UINT32_MAX;
    if (params->order_max > 0 && params->order_max < last)
        last = params->order_max;
    return last;
}

/* Light of that order is to be seen. */
static bool has_order(const CameraParams *params, uint32_t order) {
    static const uint32_t bits[CAMERA_ORDER_COUNT] = {
        AMB_EFFECT_SINGLE_SCATTERING, AMB_EFFECT_DOUBLE_SCATTERING, AMB_EFFECT_MULTIPLE_SCATTERING};
    const uint32_t index = order < CAMERA_ORDER_COUNT ? order : CAMERA_ORDER_COUNT;
    const bool is_past = params->order_max > 0 && order > params->order_max;
    return order >= 1 && !is_past && (params->effects & bits[index - 1]) != 0;
}

/* Of walks' own orders: the first is of the surroundings alone. */
static bool wants_order(const CameraParams *params, uint32_t order) {
    return order <= order_limit(params) && has_order(params, order);
}

bool walk_is_wanted(const CameraParams *params) {
    const uint32_t last = order_limit(params);
    return last > 1 || (last == 1 && (params->effects & AMB_EFFECT_WORLD_LIGHT) != 0);
}

void walk_add(Walker *walker, uint32_t order, Rgb light) {
    if (!has_order(walker->params, order))
        return;
    const uint32_t index = order < CAMERA_ORDER_COUNT ? order : CAMERA_ORDER_COUNT;
    Rgb *orders = walker->out->orders;
    orders[index - 1] = rgb_add(orders[index - 1], light);
    walker_note(walker, &walker->way, light);
}

static void add(const Walk *walk, uint32_t order, Rgb throughput, Rgb radiance) {
    walk_add(walk->walker, order, rgb_mul(throughput, radiance));
}

/* Light of the surroundings, which has scattered as often as the walk. */
static void add_surroundings(const Walk *walk, Rgb radiance) {
    const Walker *walker = walk->walker;
    if (walker->observer != NULL)
        walker->observer->see_light(walker->observer->user, &walker->way, walk->order,
                                    rgb_mul(walk->throughput, radiance));
    else
        add(walk, walk->order, walk->throughput, radiance);
    walker->out->parts[CAMERA_PART_WORLD_LIGHT] += rgb_mean(rgb_mul(walk->throughput, radiance));
}

static bool wants_surroundings(const Walk *walk) {
    return (walk->walker->params->effects & AMB_EFFECT_WORLD_LIGHT) != 0 &&
           walk->order > walk->first && wants_order(walk->walker->params, walk->order);
}

static Target find_target(const Walk *walk) {
    const AmbScene *scene = walk->walker->scene;
    Target target = {.is_hit = false, .stack = walk->stack};
    BoundaryArrival arrival;
    const bool is_hit = boundary_find(scene, &target.stack, walk->o, walk->d, INFINITY, &arrival);
    target.has_passed = arrival.passed_count > 0;
    if (!is_hit) {
        target.length = scene_end(scene, walk->o);
        return target;
    }
    target.is_hit = true;
    target.length = arrival.t;
    target.surface = arrival.crossing.surface;
    target.is_boundary = !arrival.is_opaque;
    target.crossing = arrival.crossing;
    return target;
}

/* What a walk may do next, and what each is worth to the picture, about. */
typedef struct Choice {
    float scatter, reflect, pass;
} Choice;

static float weigh(Rgb throughput, Rgb factor) {
    return rgb_mean(rgb_mul(throughput, factor));
}

static Choice weigh_boundary(const Walk *walk, const Target *target, Rgb transmittance) {
    Choice choice = {0, 0, 0};
    if (!target->is_boundary)
        return choice;
    const BoundaryCrossing *crossing = &target->crossing;
    const SceneMaterial *material = target->surface.material;
    const float reflectance = crossing->split.reflectance;
    choice.reflect =
        reflectance * weigh(walk->throughput, rgb_mul(transmittance, material->reflect_color));
    if (walk->is_its_own) {
        /* Without the eta^2 of pass(): what is to be seen in the denser medium is as much more. */
        choice.pass = (1.0f - reflectance) *
                      weigh(walk->throughput, rgb_mul(transmittance, material->transmit_color));
        const AmbScene *scene = walk->walker->scene;
        const bool is_dark = crossing->beyond.count == 0 && scene->object_count == 1 &&
                             (scene->world.is_black || !wants_surroundings(walk));
        if (is_dark)
            choice.pass *= DARK_OUTSIDE;
    }
    return choice;
}

/* Distance to a collision inside the segment: a mixture over the channels of what each would take
 * (one-sample multiple importance sampling with the balance heuristic, [Wilkie14]). The throughput
 * becomes that just before the scattering, per unit of sigma_s. */
static void collide(Walk *walk, const Medium *medium, float length, bool has_passed) {
    const float sigma_t[3] = {medium->sigma_t.r, medium->sigma_t.g, medium->sigma_t.b};
    const Rgb scattered = rgb_mul(walk->throughput, medium_scattered(medium, length));
    const float share[3] = {scattered.r, scattered.g, scattered.b};
    const float sum = share[0] + share[1] + share[2];
    int channel = 0;
    float u = walker_random(walk->walker) * sum;
    while (channel < 2 && (u >= share[channel] || !(share[channel] > 0.0f))) {
        u -= share[channel];
        ++channel;
    }
    while (channel > 0 && !(share[channel] > 0.0f))
        --channel; /* rounding went past the last one */
    const float inside = -expm1f(-sigma_t[channel] * length);
    const float t =
        fminf(-log1pf(-walker_random(walk->walker) * inside) / sigma_t[channel], length);
    float pdf = 0.0f;
    for (int c = 0; c < 3; ++c)
        if (share[c] > 0.0f)
            pdf +=
                share[c] / sum * sigma_t[c] * expf(-sigma_t[c] * t) / -expm1f(-sigma_t[c] * length);
    /* Of the boundaries that the segment passes only those before the place count. */
    if (has_passed) {
        BoundaryArrival arrival;
        boundary_find(walk->walker->scene, &walk->stack, walk->o, walk->d, t, &arrival);
    }
    const Vec3 from = walk->o;
    walk->o = vec3_madd(from, t, walk->d);
    walk->still = vec3_is_equal(from, walk->o) ? walk->still + 1 : 0;
    walk->throughput =
        rgb_scale(rgb_mul(walk->throughput, medium_transmittance(medium, t)), 1.0f / pdf);
}

/* A new direction: a mixture of the lobes. */
static void scatter(Walk *walk, const Medium *medium) {
    float weight[AMB_PHASE_LOBE_MAX], sum = 0.0f;
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        weight[l] = weigh(walk->throughput, medium->lobes[l].sigma_s);
        sum += weight[l];
    }
    uint32_t lobe = 0;
    float u = walker_random(walk->walker) * sum;
    while (lobe + 1 < medium->lobe_count && u >= weight[lobe])
        u -= weight[lobe++];
    const Sample2 s = walker_random2(walk->walker);
    const float cosine = phase_hg_sample(s.u, medium->lobes[lobe].g);
    walk->d = phase_direction(walk->d, cosine, s.v);
    Rgb value = rgb(0, 0, 0);
    float pdf = 0.0f;
    for (uint32_t l = 0; l < medium->lobe_count; ++l) {
        const float p = phase_hg(cosine, medium->lobes[l].g);
        value = rgb_add(value, rgb_scale(medium->lobes[l].sigma_s, p));
        pdf += weight[l] / sum * p;
    }
    walk->throughput = rgb_scale(rgb_mul(walk->throughput, value), 1.0f / pdf);
    ++walk->order;
    walk->is_its_own = true;
}

static void reflect(Walk *walk, const Target *target, float probability) {
    const float weight = target->crossing.split.reflectance / probability;
    walk->throughput =
        rgb_scale(rgb_mul(walk->throughput, target->surface.material->reflect_color), weight);
    walk->d = target->crossing.reflected;
    const CameraParams *params = walk->walker->params;
    if (walk->stack.count == 0)
        walk->is_seen &= (params->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0;
    else
        walk->is_seen &= walk->bounces++ < params->bounces;
    walk->stack = target->stack;
    walk->o = scene_leave(&target->surface, walk->d);
    walk->is_its_own = true;
}

static void pass(Walk *walk, const Target *target, float probability) {
    const BoundaryCrossing *crossing = &target->crossing;
    /* Radiance grows by n^2 on entering a denser medium; see follow_boundary. */
    const float weight =
        (1.0f - crossing->split.reflectance) * crossing->eta * crossing->eta / probability;
    walk->throughput =
        rgb_scale(rgb_mul(walk->throughput, target->surface.material->transmit_color), weight);
    walk->d = crossing->refracted;
    walk->stack = crossing->beyond;
    if (walk->stack.count == 0)
        walk->is_seen &= (walk->walker->params->effects & AMB_EFFECT_BACKGROUND) != 0;
    walk->o = scene_leave(&target->surface, walk->d);
}

static FieldSegment walk_segment(const Walk *walk, float length) {
    return (FieldSegment){.o = walk->o,
                          .d = walk->d,
                          .length = length,
                          .object = medium_stack_top(&walk->stack),
                          .part = walk->walker->part};
}

/* A walk gathers at all of its first events and at EVERY of n at the n-th: EVERY (1 + ln n / EVERY)
 * in all, where n is a million in dense white media. What light comes to an event far along a walk
 * differs little from what came to those before it; the relative variance that this adds to one
 * walk, 1 / (2 EVERY) at most, is far below that among walks. */
static const uint32_t EVERY = 64;

static void gather(Walk *walk, float length) {
    Walker *walker = walk->walker;
    if (walk->order == walk->first || !wants_order(walker->params, walk->order + 1))
        return;
    Rgb throughput = walk->throughput;
    if (walk->order > EVERY) {
        const float chance = (float)EVERY / (float)walk->order;
        if (!(walker_random(walker) < chance))
            return;
        throughput = rgb_scale(throughput, 1.0f / chance);
    }
    const FieldSegment segment = walk_segment(walk, length);
    if (walker->observer != NULL)
        walker->observer->see_medium(walker->observer->user, &walker->way, &segment, walk->order,
                                     throughput);
    if (walker->field == NULL)
        return;
    add(walk, walk->order + 1, throughput, walker_gather(walker, segment, throughput).radiance);
}

/* (exp(x) - 1, exp(x) - 1 - x) by channel: light that goes straight on once and more, and twice and
 * more. */
static Rgb forward_some(Rgb x) {
    return rgb(expm1f(x.r), expm1f(x.g), expm1f(x.b));
}

static float several(float x) {
    return x < 0.05f ? x * x * (0.5f + x / 6.0f) : expm1f(x) - x;
}

static Rgb forward_several(Rgb x) {
    return rgb(several(x.r), several(x.g), several(x.b));
}

Rgb walk_straight(const CameraParams *params, uint32_t object) {
    const bool is_wanted =
        params->scatter != NULL && (wants_order(params, 2) || wants_order(params, 3));
    return is_wanted ? scatter_forward(params->scatter, object) : rgb(0, 0, 0);
}

/* With tau = forward before the segment and x along it, tau + x = tau + (x), and
 * exp(tau + x) - 1 - (tau + x) = several(tau) + some(tau) (x) + exp(tau) (exp(x) - 1 - x). */
void walk_add_straight(const CameraParams *params, CameraSample *sample, const CameraWay *way,
                       Rgb forward, Rgb throughput, const FieldRadiance *gathered) {
    const Rgb some = forward_some(forward);
    const Rgb later[2] = {
        rgb_madd(gathered->straight_once, forward, gathered->radiance),
        rgb_add(rgb_madd(rgb_mul(forward_several(forward), gathered->radiance), some,
                         gathered->straight_once),
                rgb_madd(gathered->straight_more, some, gathered->straight_more))};
    /* Later orders need no reflections of the camera's: walks bring what these leave out. */
    CameraWay first = *way;
    first.bounces = 0;
    for (uint32_t k = 0; k < 2; ++k)
        if (wants_order(params, k + 2)) {
            const Rgb light = rgb_mul(throughput, later[k]);
            sample->orders[k + 1] = rgb_add(sample->orders[k + 1], light);
            sample_note(sample, &first, light);
        }
}

/* What scattered once and then goes straight on, where no branch of the camera path gathers it. */
static void gather_straight(Walk *walk, FieldSegment segment) {
    Walker *walker = walk->walker;
    segment.straight = walk_straight(walker->params, segment.object);
    if (walker->field == NULL || !(rgb_max(rgb_add(walk->forward, segment.straight)) > 0.0f))
        return;
    const Rgb grown = rgb_madd(walk->throughput, walk->throughput, forward_some(walk->forward));
    const float gathers = walker_gathers(walker, grown);
    if (!(gathers > 0.0f))
        return;
    const Rgb throughput = rgb_scale(walk->throughput, gathers);
    const FieldRadiance gathered = walker_gather(walker, segment, rgb(0, 0, 0));
    walk_add_straight(walker->params, walker->out, &walker->way, walk->forward, throughput,
                      &gathered);
}

/* The same for all that has scattered before, where it is known: then nothing is left to a walk
 * but what the walls reflect. */
static void gather_later(Walk *walk, float length) {
    const CameraParams *params = walk->walker->params;
    const FieldSegment segment = walk_segment(walk, length);
    const Sample2 u = walker_random2(walk->walker);
    const ScatterRadiance radiance = scatter_gather(params->scatter, &segment, walk->forward, &u);
    if ((params->effects & AMB_EFFECT_WORLD_LIGHT) != 0 && wants_order(params, 1))
        add(walk, 1, walk->throughput, radiance.once);
    if (wants_order(params, 2))
        add(walk, 2, walk->throughput, radiance.twice);
    if (wants_order(params, 3))
        add(walk, 3, walk->throughput, radiance.more);
    if (!walk->is_seen)
        gather_straight(walk, segment);
    walk->forward = scatter_forward_depth(walk->forward,
                                          scatter_forward(params->scatter, segment.object), length);
}

void walk_see_straight(Walker *walker, const CameraWay *way, Rgb forward, Rgb light) {
    const CameraParams *params = walker->params;
    if (params->scatter == NULL || (params->effects & AMB_EFFECT_WORLD_LIGHT) == 0 ||
        !(rgb_max(forward) > 0.0f))
        return;
    const Rgb twice = rgb_scale(rgb_mul(forward, forward), 0.5f);
    const Rgb more = rgb_add(forward_several(forward), rgb_scale(twice, -1.0f));
    const Rgb orders[CAMERA_ORDER_COUNT] = {forward, twice, more};
    for (uint32_t k = 0; k < CAMERA_ORDER_COUNT; ++k)
        if (wants_order(params, k + 1)) {
            const Rgb radiance = rgb_mul(light, orders[k]);
            walker->out->orders[k] = rgb_add(walker->out->orders[k], radiance);
            walker_note(walker, way, radiance);
        }
}

/* So many flights in a row that moved nothing, as in photon_walk.c. */
enum { STILL_MAX = 64 };

/* A path comes this far from an object's middle, in its radii, through a hole of the mesh alone: it
 * has left, as light has that photons carry out there. To follow it further costs without end where
 * the medium does not absorb, and tells nothing: no boundary is there. More than 1 by rounding. */
static const float LOST_RADII = 1.01f;

static bool is_lost(const Walk *walk) {
    if (walk->still > STILL_MAX)
        return true;
    const SceneObject *object = &walk->walker->scene->objects[medium_stack_top(&walk->stack)];
    const float reach = LOST_RADII * object->radius;
    const Vec3 from = vec3_sub(walk->o, object->center);
    return vec3_dot(from, from) > reach * reach;
}

/* Whose time the walk takes. */
static LedgerEntry walk_entry(const Walk *walk) {
    const CameraParams *params = walk->walker->params;
    /* Photons bring all later orders at once. */
    if (params->scatter == NULL && walk->order <= 1 && wants_order(params, 2))
        return LEDGER_DOUBLE;
    if (wants_order(params, 3))
        return LEDGER_MULTIPLE;
    return wants_order(params, 2) ? LEDGER_DOUBLE : LEDGER_WORLD_LIGHT;
}

/* Whether what a surface has from others and from media is asked for, and as how much. That is a
 * path of its own, which may end in a walk: a walk inside a medium with a surface in it, which sees
 * this at each of its events, begins one of them on average. */
static float weigh_returns(const Walk *walk, Rgb transmittance) {
    Walker *walker = walk->walker;
    if (!walker->params->has_returns)
        return 0.0f;
    const float arriving = rgb_max(rgb_mul(walk->throughput, transmittance));
    const float chance =
        fminf(arriving / walk->begin, 1.0f) * fminf(arriving / WALKER_ROULETTE_THROUGHPUT, 1.0f);
    return walker_random(walker) < chance ? 1.0f / chance : 0.0f;
}

/* Light of the opaque surface where a segment ends. */
static void see_surface(const Walk *walk, const Target *target, Rgb transmittance) {
    Walker *walker = walk->walker;
    const float returns = weigh_returns(walk, transmittance);
    const uint32_t scattered = walker->scattered;
    const CameraWay way = walker->way;
    const Rgb glow = rgb_scale(rgb_mul(walk->throughput, transmittance), returns);
    walker->scattered = walk->order;
    walker->way.returns = returns > 0.0f;
    const DiffuseLight seen =
        shade_diffuse(walker, &target->surface, walk->d, &target->stack, glow, returns > 0.0f);
    walker->scattered = scattered;
    walker->way = way;
    add_surroundings(walk, rgb_mul(transmittance, seen.radiance));
    walker->out->parts[CAMERA_PART_CAUSTICS] +=
        rgb_mean(rgb_mul(walk->throughput, rgb_mul(transmittance, seen.caustics)));
    if (rgb_max(seen.interreflected) > 0.0f) {
        walker->way.returns = true;
        add_surroundings(walk, rgb_scale(rgb_mul(transmittance, seen.interreflected), returns));
        walker->way = way;
    }
}

/* One segment and what follows it. False: the walk has ended. */
static bool step(Walk *walk) {
    const Walker *walker = walk->walker;
    const SceneMaterial *material = medium_stack_material(walker->scene, &walk->stack);
    const Target target = find_target(walk);
    const float length = target.length;
    Rgb transmittance = rgb(1, 1, 1);
    Choice choice = {0, 0, 0};
    if (material != NULL) {
        transmittance = medium_transmittance(&material->medium, length);
        if (medium_scatters(&material->medium) && walker->params->scatter != NULL) {
            gather_later(walk, length);
        } else if (medium_scatters(&material->medium)) {
            gather(walk, length);
            /* One more is of use if it can be seen from outside, or lit by a gather after it. */
            const uint32_t next = walk->order + 1;
            const uint32_t limit = order_limit(walker->params);
            const bool has_world = (walker->params->effects & AMB_EFFECT_WORLD_LIGHT) != 0;
            if (next < limit || (next == limit && has_world))
                choice.scatter = rgb_mean(
                    rgb_mul(walk->throughput, medium_scattered(&material->medium, length)));
        }
        if (!target.is_hit)
            scene_leaks_add(&walker->out->leaks, 1, medium_stack_top(&walk->stack));
    }
    const Choice at_boundary = weigh_boundary(walk, &target, transmittance);
    choice.reflect = at_boundary.reflect;
    choice.pass = at_boundary.pass;

    /* Certain where it ends: no need to choose it by chance. */
    if (wants_surroundings(walk)) {
        const LedgerEntry before = ledger_open(&walk->walker->clock, LEDGER_WORLD_LIGHT);
        if (!target.is_hit && material == NULL)
            add_surroundings(walk, world_radiance_but_lamps(&walker->scene->world, walk->d));
        if (target.is_hit && !target.is_boundary)
            see_surface(walk, &target, transmittance);
        ledger_close(&walk->walker->clock, before);
    }
    const float sum = choice.scatter + choice.reflect + choice.pass;
    if (!(sum > 0.0f))
        return false;
    const float u = walker_random(walk->walker) * sum;
    if (material != NULL && u < choice.scatter) {
        collide(walk, &material->medium, length, target.has_passed);
        if (is_lost(walk))
            return false;
        walk->throughput = rgb_scale(walk->throughput, sum / choice.scatter);
        scatter(walk, &material->medium);
        return true;
    }
    walk->throughput = rgb_mul(walk->throughput, transmittance);
    if (choice.reflect > 0.0f && (u < choice.scatter + choice.reflect || !(choice.pass > 0.0f)))
        reflect(walk, &target, choice.reflect / sum);
    else if (choice.pass > 0.0f)
        pass(walk, &target, choice.pass / sum);
    else
        return false; /* rounding: u is at the very end of choice.scatter, the only one */
    return true;
}

static bool survives(Walk *walk) {
    const float share = rgb_max(walk->throughput) / walk->begin;
    if (share >= ROULETTE_SHARE)
        return true;
    const float survival = share / ROULETTE_SHARE;
    if (!(walker_random(walk->walker) < survival))
        return false;
    walk->throughput = rgb_scale(walk->throughput, 1.0f / survival);
    return true;
}

void walk_scatter(Walker *walker, Vec3 o, Vec3 d, const MediumStack *stack, Rgb throughput,
                  Rgb forward, bool is_seen) {
    Walk walk = {.walker = walker,
                 .o = o,
                 .d = d,
                 .stack = *stack,
                 .throughput = throughput,
                 .begin = rgb_max(throughput),
                 .order = walker->scattered,
                 .first = walker->scattered,
                 .forward = forward,
                 .is_seen = is_seen};
    if (!(walk.begin > 0.0f))
        return;
    const LedgerEntry before = walker->clock.entry;
    const int event_max = walker->observer != NULL ? PROBE_EVENT_MAX : EVENT_MAX;
    for (int event = 0; event < event_max; ++event) {
        if (walker->params->job != NULL && job_is_cancelled(walker->params->job))
            break;
        ledger_open(&walker->clock, walk_entry(&walk));
        if (!step(&walk) || !survives(&walk))
            break;
    }
    ledger_close(&walker->clock, before);
}
