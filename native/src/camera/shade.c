/* SPDX-License-Identifier: GPL-3.0-or-later
 * Opaque surfaces. */
#include "camera/shade.h"

#include "camera/caustic_lamp.h"
#include "camera/scatter_walk.h"
#include "camera/shadow.h"

enum { DEPTH_MAX = 256 }; /* boundaries on the way of light, a guard against endless paths */

/* Share of a lamp's light that arrives straight. */
static Rgb straight_share(const Walker *walker, const MediumStack *stack, Vec3 p,
                          const LightArrival *light) {
    const AmbScene *scene = walker->scene;
    if (!walker->params->shines_through) {
        if (scene_is_occluded(scene, p, light->wi, light->distance))
            return rgb(0, 0, 0);
        if (stack->count == 0)
            return rgb(1, 1, 1);
    }
    return shadow_transmittance(scene, stack, p, light->wi, light->distance);
}

/* Irradiance of the lamps along shadow rays. Meshes that are lamps may be met by rays in proportion
 * to the cosine, too: each has its share of both densities (the balance heuristic, [Veach97] 9.2).
 */
static Rgb lamp_irradiance(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                           Vec3 ng, Vec3 ns, bool meets_lamps) {
    const AmbScene *scene = walker->scene;
    const Vec3 p = scene_leave(surface, ng);
    Rgb irradiance = rgb(0, 0, 0);
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const LightArrival light =
            light_arrival(&scene->lights[l], surface->p, walker_random2(walker));
        const float cosine = vec3_dot(light.wi, ns);
        if (!(cosine > 0.0f) || !(vec3_dot(light.wi, ng) > 0.0f) ||
            !(rgb_max(light.irradiance) > 0.0f))
            continue;
        const Rgb share = straight_share(walker, stack, p, &light);
        const float weight =
            meets_lamps && light.pdf > 0.0f ? light.pdf / (light.pdf + cosine / AMB_PI) : 1.0f;
        irradiance = rgb_madd(irradiance, rgb_scale(light.irradiance, weight * cosine), share);
    }
    return irradiance;
}

/* Surfaces that are nearly white, in a closed room: the light goes on, but ends. */
static const float SURVIVAL_MAX = 0.95f;

/* A walk is tried, or left out, that often at least. */
static const float WALK_MIN = 0.1f;

/* The map's light on surfaces that light others is looked up that often: they spread it, and bright
 * photons are chosen as lamps, so that it hardly adds noise; lookups at every bounce were most of
 * the time in closed bright rooms. */
static const float LOOK_CHANCE = 0.25f;

/* The way back of light that arrives at an opaque surface. */
typedef struct LightPath {
    Vec3 o, d;
    Vec3 from;    /* where it began, */
    float pdf;    /* and with which density of d, 1/sr */
    bool is_bent; /* by a boundary so far: then the map of caustics has what lamps send that way */
    MediumStack stack;
    Rgb weight;
    float share;          /* of the world's light */
    float scattered;      /* weight of what scatters on the way; 0: it is left out */
    float interreflected; /* weight of other opaque surfaces' light; 0: they are black */
    uint32_t bounces;     /* internal reflections so far */
} LightPath;

/* What comes along it. */
typedef struct LightSum {
    Rgb world, surfaces;
    Rgb lamps; /* meshes met */
} LightSum;

/* Who asks for a surface's light, and how. */
typedef struct Asked {
    float interreflected; /* weight of other opaque surfaces' light; 0: they are black */
    float scattered;      /* of what scatters on the way that is asked for it */
    bool meets_lamps;     /* other surfaces are not black, or are so by chance */
    float density;        /* of caustics_irradiance_by_rays */
} Asked;

static DiffuseLight shade(Walker *walker, const SurfacePoint *surface, Vec3 d,
                          const MediumStack *stack, Rgb glow, Asked asked);

/* Whether walks bring what scatters on its way to opaque surfaces: of all light, or, where that of
 * lamps is in the map of caustics, of the surroundings. */
static bool walks_for_glow(const CameraParams *params) {
    const bool has_map = params->glow != 0;
    const bool is_known = has_map && ((params->glow & AMB_EFFECT_WORLD_LIGHT) != 0 ||
                                      (params->effects & AMB_EFFECT_WORLD_LIGHT) == 0);
    return !is_known && walk_is_wanted(params);
}

/* A way that a walk led to is one, whatever it passes: it would branch with each medium, without
 * end in white rooms. The weight of a walk into this one or, negative, of going straight on. */
static float choose_walk(Walker *walker, const Medium *medium, float length) {
    const float walks =
        clampf(1.0f - rgb_mean(medium_transmittance(medium, length)), WALK_MIN, 1.0f - WALK_MIN);
    return walker_random(walker) < walks ? 1.0f / walks : -1.0f / (1.0f - walks);
}

static FieldSegment path_segment(const Walker *walker, const LightPath *path, float length) {
    return (FieldSegment){.o = path->o,
                          .d = path->d,
                          .length = length,
                          .object = medium_stack_top(&path->stack),
                          .part = walker->part};
}

static void observe_medium(const Walker *walker, const LightPath *path, float length,
                           Rgb throughput) {
    const FieldSegment segment = path_segment(walker, path, length);
    walker->observer->see_medium(walker->observer->user, &walker->way, &segment, walker->scattered,
                                 throughput);
}

/* Attenuates the path, and adds what scatters into it. */
static void pass_medium(Walker *walker, LightPath *path, float length, Rgb glow) {
    const Medium *medium = &medium_stack_material(walker->scene, &path->stack)->medium;
    const Rgb throughput = rgb_mul(path->weight, glow);
    if (medium_scatters(medium) && rgb_max(throughput) > 0.0f) {
        if (walker->observer != NULL)
            observe_medium(walker, path, length, throughput);
        /* What the map of caustics has is not gathered again. */
        const Field *field = walker->field;
        if (walker->params->glow != 0)
            walker->field = NULL;
        const bool is_wanted = walker->field != NULL &&
                               (walker->scattered > 0 ||
                                (walker->params->effects & AMB_EFFECT_SINGLE_SCATTERING) != 0);
        const float gathers = is_wanted ? walker_gathers(walker, throughput) : 0.0f;
        if (gathers > 0.0f) {
            const FieldSegment segment = path_segment(walker, path, length);
            const Rgb weight = rgb_scale(throughput, gathers);
            const FieldRadiance gathered = walker_gather(walker, segment, weight);
            walk_add(walker, walker->scattered + 1, rgb_mul(weight, gathered.radiance));
        }
        /* As along the camera's path: what walls reflect goes on in the walk. */
        float straight = 1.0f;
        if (path->bounces == 0 && walks_for_glow(walker->params)) {
            const float walks = walker->scattered > 0 ? choose_walk(walker, medium, length) : 1.0f;
            straight = walker->scattered == 0 ? 1.0f : walks > 0.0f ? 0.0f : -walks;
            if (walks > 0.0f)
                walk_scatter(walker, path->o, path->d, &path->stack, rgb_scale(throughput, walks),
                             rgb(0, 0, 0), false);
        }
        walker->field = field;
        path->weight = rgb_scale(path->weight, straight);
    }
    path->weight = rgb_mul(path->weight, medium_transmittance(medium, length));
}

/* One of the two branches by chance, and all reflections. */
static void pass_boundary(Walker *walker, LightPath *path, const BoundaryCrossing *crossing) {
    const SceneMaterial *material = crossing->surface.material;
    path->is_bent |= crossing->eta != 1.0f;
    if (walker_random(walker) < crossing->split.reflectance) {
        path->weight = rgb_mul(path->weight, material->reflect_color);
        path->d = crossing->reflected;
        path->bounces += path->stack.count > 0 ? 1 : 0;
    } else {
        /* See follow_boundary in camera_path.c. */
        path->weight = rgb_mul(rgb_scale(path->weight, crossing->eta * crossing->eta),
                               material->transmit_color);
        path->d = crossing->refracted;
        path->stack = crossing->beyond;
    }
    path->o = scene_leave(&crossing->surface, path->d);
}

static bool survives(Walker *walker, LightPath *path) {
    const float strongest = rgb_max(path->weight);
    if (strongest >= WALKER_ROULETTE_THROUGHPUT)
        return true;
    const float survival = strongest / WALKER_ROULETTE_THROUGHPUT;
    if (!(walker_random(walker) < survival))
        return false;
    path->weight = rgb_scale(path->weight, 1.0f / survival);
    return true;
}

/* One more surface is asked by chance: the weight of its light. */
static float goes_on(Walker *walker, Rgb albedo) {
    const float survival = fminf(rgb_max(albedo), SURVIVAL_MAX);
    return survival > 0.0f && walker_random(walker) < survival ? 1.0f / survival : 0.0f;
}

/* With which the path was sent to the surface where it ends, 1/m^2; INFINITY: places of the map
 * cannot be chosen for it. */
static float path_density(const LightPath *path, const SurfacePoint *surface) {
    const Vec3 way = vec3_sub(surface->p, path->from);
    const float square = vec3_dot(way, way);
    if (path->is_bent || !(square > 0.0f))
        return INFINITY;
    return path->pdf * fabsf(vec3_dot(path->d, surface->ng)) / square;
}

/* Light of the opaque surface where the path ends. */
static void meet_surface(Walker *walker, const LightPath *path, const SurfacePoint *surface,
                         Rgb glow, LightSum *sum) {
    const float next = goes_on(walker, scene_albedo(walker->scene, surface));
    const Rgb weight = rgb_scale(path->weight, path->interreflected);
    const CameraWay way = walker->way;
    const LedgerEntry before =
        ledger_open(&walker->clock, way.returns ? LEDGER_RETURN : LEDGER_INTERREFLECTION);
    walker->way.effects |= way.returns ? 0u : AMB_EFFECT_INTERREFLECTION;
    const Asked asked = {.interreflected = next,
                         .scattered = next,
                         .meets_lamps = true,
                         .density = path_density(path, surface)};
    const DiffuseLight light =
        shade(walker, surface, path->d, &path->stack, rgb_mul(weight, glow), asked);
    walker->way = way;
    ledger_close(&walker->clock, before);
    sum->surfaces = rgb_mul(weight, rgb_add(light.radiance, light.interreflected));
    const SceneObject *object = &walker->scene->objects[surface->object];
    if (object->is_lamp && !path->is_bent) {
        const float share = path->pdf / (path->pdf + scene_lamp_pdf(surface, object, path->from));
        sum->lamps = rgb_mul(rgb_scale(weight, share), light.lamp);
    }
}

/* What the path leads to. */
static LightSum follow_light(Walker *walker, LightPath path, Rgb glow) {
    const AmbScene *scene = walker->scene;
    LightSum sum = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    for (int depth = 0; depth < DEPTH_MAX; ++depth) {
        BoundaryArrival arrival;
        MediumStack end = path.stack;
        const bool is_hit = boundary_find(scene, &end, path.o, path.d, INFINITY, &arrival);
        if (path.stack.count > 0) {
            if (!is_hit)
                scene_leaks_add(&walker->out->leaks, 1, medium_stack_top(&path.stack));
            pass_medium(walker, &path, is_hit ? arrival.t : scene_end(scene, path.o),
                        rgb_scale(glow, path.scattered));
            if (!(rgb_max(path.weight) > 0.0f))
                break;
        }
        path.stack = end;
        if (!is_hit) {
            const Rgb radiance = world_radiance_but_lamps(&scene->world, path.d);
            sum.world = rgb_mul(rgb_scale(path.weight, path.share), radiance);
            break;
        }
        if (arrival.is_opaque) {
            if (path.interreflected > 0.0f)
                meet_surface(walker, &path, &arrival.crossing.surface, glow, &sum);
            break;
        }
        if (!walker->params->shines_through)
            break;
        pass_boundary(walker, &path, &arrival.crossing);
        if (!survives(walker, &path))
            break;
    }
    return sum;
}

/* Mean radiance of the surroundings, weighted by the cosine: one direction in proportion to the
 * cosine and, where the world is an image, one to that, each by its share of both densities (the
 * balance heuristic, [Veach97] 9.2). Opaque surfaces are seen by the first alone. */
static LightSum light_of_surroundings(Walker *walker, const SurfacePoint *surface,
                                      const MediumStack *stack, Vec3 ng, Vec3 ns, Rgb glow,
                                      float interreflected, float asks) {
    const AmbScene *scene = walker->scene;
    const World *world = &scene->world;
    const bool shines_through = walker->params->shines_through;
    LightSum sum = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    const bool has_glow = shines_through && rgb_max(glow) > 0.0f && asks > 0.0f &&
                          (walks_for_glow(walker->params) || walker->observer != NULL ||
                           (walker->params->glow == 0 && walker->field != NULL));
    if (world->is_black && !has_glow && !(interreflected > 0.0f))
        return sum;
    Vec3 x, y;
    vec3_frame(ns, &x, &y);
    const Vec3 p = scene_leave(surface, ng);
    const bool has_image = world->image.width > 0 && !world->is_black;
    for (int i = 0; i < (has_image ? 2 : 1); ++i) {
        const Sample2 u = walker_random2(walker);
        const Vec3 d =
            i == 0 ? frame_to_world(x, y, ns, sample_cosine_hemisphere(u)) : world_sample(world, u);
        const float by_cosine = vec3_dot(d, ns) / AMB_PI;
        if (!(by_cosine > 0.0f) || !(vec3_dot(d, ng) > 0.0f))
            continue;
        const float share = by_cosine / (by_cosine + (has_image ? world_pdf(world, d) : 0.0f));
        const float by_surfaces = i == 0 ? interreflected : 0.0f;
        if (shines_through || by_surfaces > 0.0f) {
            const LightPath path = {.o = p,
                                    .d = d,
                                    .from = surface->p,
                                    .pdf = by_cosine,
                                    .stack = *stack,
                                    .weight = rgb(1, 1, 1),
                                    .share = share,
                                    .scattered = share * asks,
                                    .interreflected = by_surfaces};
            const LightSum found = follow_light(walker, path, glow);
            sum.world = rgb_add(sum.world, found.world);
            sum.surfaces = rgb_add(sum.surfaces, found.surfaces);
            sum.lamps = rgb_add(sum.lamps, found.lamps);
        } else if (!scene_is_occluded(scene, p, d, INFINITY)) {
            sum.world = rgb_add(sum.world, rgb_scale(world_radiance_but_lamps(world, d), share));
        }
    }
    return sum;
}

/* Adds light of the map that scattered on its way. */
static void add_glow(Walker *walker, const SurfacePoint *surface, Vec3 ng, Rgb weight) {
    static const uint32_t bits[CAMERA_ORDER_COUNT] = {
        AMB_EFFECT_SINGLE_SCATTERING, AMB_EFFECT_DOUBLE_SCATTERING, AMB_EFFECT_MULTIPLE_SCATTERING};
    const CameraParams *params = walker->params;
    if (params->glow == 0 || !(rgb_max(weight) > 0.0f))
        return;
    const CausticGlow glow = caustics_glow(params->caustics, surface->p, ng, walker->part);
    for (uint32_t k = 0; k < CAMERA_ORDER_COUNT; ++k) {
        if ((params->glow & bits[k]) == 0)
            continue;
        walk_add(walker, walker->scattered + k + 1,
                 rgb_scale(rgb_mul(weight, glow.orders[k]), 1.0f / AMB_PI));
    }
}

/* Weight of the map's light, 0 where it is left out. */
static float choose_look(Walker *walker, const Asked *asked) {
    if (walker->params->caustics == NULL)
        return 0.0f;
    if (asked->density == INFINITY)
        return 1.0f;
    return walker_random(walker) < LOOK_CHANCE ? 1.0f / LOOK_CHANCE : 0.0f;
}

static DiffuseLight shade(Walker *walker, const SurfacePoint *surface, Vec3 d,
                          const MediumStack *stack, Rgb glow, Asked asked) {
    const float side = vec3_dot(d, surface->ng) < 0.0f ? 1.0f : -1.0f;
    const Vec3 ng = vec3_scale(surface->ng, side);
    const Vec3 ns = vec3_scale(surface->ns, side);
    const Rgb albedo = scene_albedo(walker->scene, surface);
    const CausticMap *map = walker->params->caustics;
    const Rgb straight = lamp_irradiance(walker, surface, stack, ng, ns, asked.meets_lamps);
    LedgerClock *clock = &walker->clock;
    LedgerEntry before = ledger_open(clock, LEDGER_CAUSTICS);
    const float looks = choose_look(walker, &asked);
    Rgb bent = rgb(0, 0, 0);
    if (looks > 0.0f)
        bent = rgb_scale(
            caustics_irradiance_by_rays(map, surface->p, ng, walker->part, asked.density), looks);
    ledger_close(clock, before);
    const Rgb lamps = rgb_scale(rgb_add(straight, bent), 1.0f / AMB_PI);
    before = walker->way.returns              ? ledger_open(clock, LEDGER_RETURN)
             : walker->params->shines_through ? ledger_open(clock, LEDGER_SURFACES)
             : asked.interreflected > 0.0f    ? ledger_open(clock, LEDGER_INTERREFLECTION)
                                              : clock->entry;
    add_glow(walker, surface, ng, rgb_scale(rgb_mul(glow, albedo), looks));
    LightSum others = light_of_surroundings(walker, surface, stack, ng, ns, rgb_mul(glow, albedo),
                                            asked.interreflected, asked.scattered);
    if (asked.interreflected > 0.0f && map != NULL)
        others.surfaces =
            rgb_add(others.surfaces, rgb_scale(caustics_elsewhere(walker, surface, stack, ng, ns),
                                               asked.interreflected));
    ledger_close(clock, before);
    return (DiffuseLight){
        .radiance = rgb_madd(scene_chance_emission(walker->scene, surface), albedo,
                             rgb_add(lamps, rgb_add(others.world, others.lamps))),
        .lamp = walker->scene->objects[surface->object].is_lamp ? surface->material->emission
                                                                : rgb(0, 0, 0),
        .caustics = rgb_mul(albedo, rgb_scale(bent, 1.0f / AMB_PI)),
        .interreflected = rgb_mul(albedo, others.surfaces)};
}

DiffuseLight shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 d,
                           const MediumStack *stack, Rgb glow, bool interreflects) {
    if (walker->scattered > 0 && interreflects) {
        const float next = goes_on(walker, scene_albedo(walker->scene, surface));
        return shade(walker, surface, d, stack, glow,
                     (Asked){.interreflected = next,
                             .scattered = next,
                             .meets_lamps = true,
                             .density = INFINITY});
    }
    return shade(walker, surface, d, stack, glow,
                 (Asked){.interreflected = interreflects ? 1.0f : 0.0f,
                         .scattered = 1.0f,
                         .meets_lamps = interreflects,
                         .density = INFINITY});
}
