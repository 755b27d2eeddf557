/* SPDX-License-Identifier: GPL-3.0-or-later
 * The random walk of photons. */
#include "field/scatter/photon_walk.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"
#include "field/scatter/smooth_wall.h"

enum { BOUNDARY_MAX = 4096 }; /* boundaries of one photon, a guard against endless reflection */

/* So many flights in a row that moved nothing: where free paths are far below what coordinates can
 * tell apart, light that is not absorbed would stay for ever. */
enum { STILL_MAX = 64 };

/* Photons with less than this share of the flux they had survive by chance: few of low weight
 * are not worth their time, and none is lost on average. */
static const float ROULETTE_SHARE = 0.25f;

/* From so many scatterings on half the photons go on with twice the flux, and again wherever the
 * number doubles: the share of light that a dense white medium still holds after n scatterings
 * falls as the root of n, so that its few longest walks would take nearly all the time, as many
 * scatterings on average as the object is free paths wide. */
static const uint32_t ORDER_LONG = 1 << 12;

/* With more than so many times the flux they had, photons are divided into equal parts, at most so
 * many: what follows of a heavy one averages out. And into so many in all. */
static const float DIVIDE_SHARE = 2.0f;
enum { PARTS_MAX = 16, PARTS_OF_PHOTON_MAX = 4096 };

typedef struct Walker {
    const PhotonWalk *walk;
    float *const *moments;
    PhotonLandings *landings; /* NULL: none is kept */
    ScatterTally *tally;
    Rng rng;
    float rank; /* of its landings */
    uint32_t dimension;
    Vec3 o, d;
    float way;   /* m, since it last turned; to o */
    float depth; /* of o; 0 where it may be on a surface */
    Rgb flux;
    float worth; /* largest channel of the flux when roulette was last played */
    MediumStack stack;
    uint32_t order;       /* scatterings so far */
    uint32_t still;       /* flights until now that moved nothing */
    uint32_t reflections; /* internal ones, before the first scattering */
    uint32_t *parts;      /* into which its photon may still be divided */
    bool is_of_surroundings;
    bool is_straight;   /* from a lamp, nothing met yet */
    bool has_left;      /* an object */
    bool has_turned;    /* off an opaque surface, or off the outside of an object; */
    bool comes_from_it; /* that surface, with nothing met since; */
    bool has_scattered; /* since then */
    bool has_grown;     /* in flux, at the last boundary */
} Walker;

static void follow(Walker *walker, const Hit *first);

static float next_random(Walker *walker) {
    return rng_float(walker->rng, walker->dimension++);
}

static void tally_add(double sum[3], Rgb flux) {
    sum[0] += (double)flux.r;
    sum[1] += (double)flux.g;
    sum[2] += (double)flux.b;
}

static float channel(Rgb c, int k) {
    return k == 0 ? c.r : k == 1 ? c.g : c.b;
}

/* Direction of travel after a scattering of mean cosine g. */
static Vec3 scatter_direction(Vec3 d, float g, float u, float v) {
    float cos_theta = 1.0f - 2.0f * u;
    if (fabsf(g) > 1e-3f) {
        const float s = (1.0f - g * g) / (1.0f - g + 2.0f * g * u);
        cos_theta = clampf((1.0f + g * g - s * s) / (2.0f * g), -1.0f, 1.0f);
    }
    const float sin_theta = safe_sqrtf(1.0f - cos_theta * cos_theta);
    const float phi = 2.0f * AMB_PI * v;
    Vec3 x, y;
    vec3_frame(d, &x, &y);
    return vec3_normalize(
        frame_to_world(x, y, d, vec3(sin_theta * cosf(phi), sin_theta * sinf(phi), cos_theta)));
}

/* A flight in a medium: one distance for three channels, drawn from the channels' densities in
 * proportion to the flux that they carry, and weighed with their sum (one-sample balance
 * heuristic). Where all channels are alike every weight is 1. */
typedef struct Flight {
    Rgb share; /* of the channels, sums to 1 */
    float distance;
} Flight;

static bool is_grey(const Medium *medium) {
    return medium->sigma_t.r == medium->sigma_t.g && medium->sigma_t.g == medium->sigma_t.b;
}

static Flight draw_flight(Walker *walker, const Medium *medium) {
    const Rgb flux = walker->flux;
    const float total = flux.r + flux.g + flux.b;
    Flight flight = {.share = rgb_scale(flux, 1.0f / total)};
    const float u = next_random(walker), v = next_random(walker);
    const int k = u < flight.share.r ? 0 : u < flight.share.r + flight.share.g ? 1 : 2;
    flight.distance = -logf(1.0f - v) / channel(medium->sigma_t, k);
    return flight;
}

/* exp(-sigma_t t) over the probability (density) of not (of just) having collided at t. */
static Rgb flight_weight(const Flight *flight, const Medium *medium, float t, bool collides) {
    if (is_grey(medium)) {
        const float weight = collides ? 1.0f / medium->sigma_t.r : 1.0f;
        return rgb(weight, weight, weight);
    }
    const Rgb passed = medium_transmittance(medium, t);
    const Rgb s = collides ? medium->sigma_t : rgb(1, 1, 1);
    const float pdf = flight->share.r * passed.r * s.r + flight->share.g * passed.g * s.g +
                      flight->share.b * passed.b * s.b;
    return rgb_scale(passed, 1.0f / pdf);
}

/* Meshes with holes let light out into a medium without end. */
static bool is_in_object(const Walker *walker, uint32_t object) {
    const SceneObject *shape = &walker->walk->scene->objects[object];
    const Vec3 from = vec3_sub(walker->o, shape->center);
    return vec3_dot(from, from) <= 1.01f * shape->radius * shape->radius;
}

/* The depth of a collision; false: out of the object through a hole of its mesh. */
static bool find_depth(Walker *walker, uint32_t object) {
    const DepthGrid *grid = &walker->walk->cells[object].depth;
    walker->depth = 0.0f;
    if (grid->nodes == NULL)
        return is_in_object(walker, object);
    DepthCell place;
    if (!depth_grid_find(grid, walker->o, &place))
        return false;
    walker->depth = fmaxf(depth_cell_value(&place), 0.0f);
    return true;
}

/* Whether a walk that has become twice as long goes on. */
static bool outlasts(Walker *walker) {
    const bool has_doubled = (walker->order & (walker->order - 1)) == 0;
    if (walker->order < ORDER_LONG || !has_doubled)
        return true;
    walker->flux = rgb_scale(walker->flux, 2.0f);
    walker->worth *= 2.0f;
    return next_random(walker) < 0.5f;
}

/* Flux per collision coefficient arrives at a collision: adds it to the cells, then scatters. */
static bool collide(Walker *walker, const Medium *medium, uint32_t object, Rgb stretch) {
    const ScatterCells *cells = &walker->walk->cells[object];
    ScatterTally *tally = walker->tally;
    const float u[5] = {next_random(walker), next_random(walker), next_random(walker),
                        next_random(walker), next_random(walker)};
    if (!find_depth(walker, object)) {
        tally_add(tally->lost, rgb_mul(stretch, medium->sigma_t));
        return false;
    }
    ++walker->order;
    walker->is_straight = false;
    walker->has_scattered = true;
    walker->comes_from_it = false;
    ++tally->collision_count;
    /* The first scattering of a lamp's light is the light field's. */
    if (cells->layer_count > 0 && (walker->order > 1 || walker->is_of_surroundings)) {
        const uint32_t layer = scatter_layer_at(cells, walker->depth);
        if (layer < cells->layer_count) {
            float harmonics[HARMONIC_COUNT_MAX];
            harmonics_evaluate(&cells->harmonics, walker->d, harmonics);
            const uint32_t slot = walker->order == 1 ? 2 : walker->order == 2 ? 0 : 1;
            scatter_cells_add(cells, walker->moments[object], slot, walker->o, layer, stretch,
                              harmonics, u);
        }
    }
    /* One lobe, in proportion to what it scatters. */
    Rgb scattered = {0, 0, 0};
    for (uint32_t j = 0; j < medium->lobe_count; ++j)
        scattered = rgb_add(scattered, rgb_mul(stretch, medium->lobes[j].sigma_s));
    tally_add(tally->absorbed, rgb_mul(stretch, medium->sigma_t));
    tally_add(tally->absorbed, rgb_scale(scattered, -1.0f));
    const float total = scattered.r + scattered.g + scattered.b;
    if (!(total > 0.0f))
        return false;
    float pick = next_random(walker) * total;
    uint32_t lobe = 0;
    for (;; ++lobe) {
        const Rgb part = rgb_mul(stretch, medium->lobes[lobe].sigma_s);
        const float weight = part.r + part.g + part.b;
        if (pick < weight || lobe + 1 == medium->lobe_count) {
            walker->flux = rgb_scale(part, total / weight);
            break;
        }
        pick -= weight;
    }
    walker->d = scatter_direction(walker->d, medium->lobes[lobe].g, u[3], u[4]);
    walker->way = 0.0f;
    return outlasts(walker);
}

/* Whether light that scatters once more would be left out. */
static bool has_last_order(const Walker *walker) {
    const uint32_t order_max = walker->walk->params->order_max;
    return order_max > 0 && walker->order >= order_max;
}

/* Goes on to the next collision or boundary; true, at a boundary, which *out_hit is. */
static bool fly(Walker *walker, Hit *out_hit, bool *out_ends) {
    const AmbScene *scene = walker->walk->scene;
    *out_ends = false;
    const SceneMaterial *material = medium_stack_material(scene, &walker->stack);
    if (material == NULL || !medium_scatters(&material->medium) || has_last_order(walker)) {
        if (!scene_intersect(scene, walker->o, walker->d, INFINITY, out_hit)) {
            if (walker->stack.count > 0)
                tally_add(walker->tally->lost, walker->flux);
            *out_ends = true;
            return false;
        }
        if (material != NULL) {
            const Rgb before = walker->flux;
            walker->flux = rgb_mul(before, medium_transmittance(&material->medium, out_hit->t));
            tally_add(walker->tally->absorbed, before);
            tally_add(walker->tally->absorbed, rgb_scale(walker->flux, -1.0f));
        }
        return true;
    }
    const Medium *medium = &material->medium;
    const uint32_t object = medium_stack_top(&walker->stack);
    const DepthGrid *depth = &walker->walk->cells[object].depth;
    const Flight flight = draw_flight(walker, medium);
    const float free = depth_grid_free(depth, walker->depth);
    const bool is_hit = flight.distance > free &&
                        scene_intersect(scene, walker->o, walker->d, flight.distance, out_hit);
    if (is_hit) {
        walker->flux = rgb_mul(walker->flux, flight_weight(&flight, medium, out_hit->t, false));
        return true;
    }
    const Vec3 from = walker->o;
    walker->o = vec3_madd(from, flight.distance, walker->d);
    walker->still = vec3_is_equal(from, walker->o) ? walker->still + 1 : 0;
    if (walker->still > STILL_MAX) {
        tally_add(walker->tally->lost, walker->flux);
        *out_ends = true;
        return false;
    }
    const Rgb weight = flight_weight(&flight, medium, flight.distance, true);
    *out_ends = !isfinite(flight.distance) ||
                !collide(walker, medium, object, rgb_mul(walker->flux, weight));
    return false;
}

static void keep_landing(PhotonLandings *landings, const PhotonLanding *landing) {
    if (landings->count == landings->room) {
        const uint64_t room = landings->room > 0 ? 2 * landings->room : 256;
        PhotonLanding *list = memory_alloc_array(room, sizeof *list);
        if (list == NULL) {
            landings->is_cut_short = true;
            return;
        }
        if (landings->count > 0)
            memcpy(list, landings->list, landings->count * sizeof *list);
        memory_free(landings->list);
        landings->list = list;
        landings->room = room;
    }
    landings->list[landings->count++] = *landing;
}

/* Below 1, whatever a division rounds to. */
static const float RANK_LAST = 0x1.fffffep-1f;
/* Below this cosine of incidence light is dropped, as in light_trace.c. */
static const float GRAZING_COS = 1e-4f;

static void land(const Walker *walker, const SurfacePoint *surface) {
    const float cos_face = -vec3_dot(walker->d, surface->ng);
    const float side = cos_face > 0.0f ? 1.0f : -1.0f;
    const float cos_shading = -side * vec3_dot(walker->d, surface->ns);
    if (fabsf(cos_face) < GRAZING_COS || !(cos_shading > 0.0f))
        return;
    const float part = walker->walk->landing_part;
    const float weight = cos_shading / (part * fabsf(cos_face));
    const PhotonLanding landing = {.p = surface->p,
                                   .n = vec3_scale(surface->ng, side),
                                   .flux = rgb_scale(walker->flux, weight),
                                   .distance = walker->way,
                                   .rank = fminf(walker->rank / part, RANK_LAST),
                                   .order = walker->order};
    keep_landing(walker->landings, &landing);
}

/* Whether light goes on from an opaque surface: it is of the surroundings from then on. What lines
 * from there bring has met no object yet. */
static bool goes_on(const Walker *walker) {
    const ScatterParams *params = walker->walk->params;
    if (!params->has_world || has_last_order(walker))
        return false;
    /* A lamp in a medium lights what is opaque there. */
    if (walker->stack.count > 0 && walker->is_straight)
        return true;
    return params->returns && (params->interreflects || !walker->comes_from_it);
}

static bool meet_opaque(Walker *walker, const SurfacePoint *surface) {
    /* What went on from another surface is found by the ray that asks for it here. */
    if (walker->landings != NULL && walker->has_scattered)
        land(walker, surface);
    const Rgb albedo = scene_albedo(walker->walk->scene, surface);
    const float survival = photon_survival(albedo);
    const bool survives = goes_on(walker) && next_random(walker) < survival;
    const Rgb before = walker->flux;
    walker->flux = rgb_scale(rgb_mul(before, albedo), survives ? 1.0f / survival : 0.0f);
    if (walker->stack.count > 0) {
        tally_add(walker->tally->absorbed, before);
        tally_add(walker->tally->absorbed, rgb_scale(walker->flux, -1.0f));
    }
    if (!survives)
        return false;
    const float side = vec3_dot(walker->d, surface->ng) < 0.0f ? 1.0f : -1.0f;
    const Vec3 n = vec3_scale(surface->ns, side);
    Vec3 x, y;
    vec3_frame(n, &x, &y);
    const float u = next_random(walker);
    const Sample2 s = {u, next_random(walker)};
    walker->d = frame_to_world(x, y, n, sample_cosine_hemisphere(s));
    walker->o = scene_leave(surface, vec3_scale(surface->ng, side));
    walker->depth = 0.0f;
    walker->way = 0.0f;
    walker->is_straight = false;
    walker->has_turned = true;
    walker->comes_from_it = true;
    walker->has_scattered = false;
    walker->is_of_surroundings = true;
    return vec3_dot(walker->d, surface->ng) * side > 0.0f;
}

/* Light that comes from outside for the first time enters; what the boundary reflects of it goes
 * its own way, to opaque surfaces. Of a lamp's light nothing else sees it. */
static void reflect_outside(Walker *walker, const BoundaryCrossing *crossing) {
    Walker part = *walker;
    part.rng.key = rng_mix(walker->rng.key + rng_mix(walker->dimension++));
    part.dimension = 0;
    if (!crossing->can_reflect || !(next_random(&part) < crossing->split.reflectance))
        return;
    part.d = crossing->split.reflected;
    part.flux = rgb_mul(part.flux, crossing->surface.material->reflect_color);
    if (walker->walk->params->adjoint_normals)
        part.flux = rgb_scale(part.flux, crossing->adjoint_reflect);
    part.o = scene_leave(&crossing->surface, part.d);
    part.way = 0.0f;
    part.has_turned = true;
    Hit hit;
    if (!scene_intersect(part.walk->scene, part.o, part.d, INFINITY, &hit))
        return;
    const SurfacePoint surface = scene_surface(part.walk->scene, &hit);
    if (part.is_of_surroundings || surface.material->surface != AMB_SURFACE_DIELECTRIC)
        follow(&part, &hit);
}

/* Light from outside enters by its transmittance; inside, and once it has scattered, one of both
 * ways is drawn. Where Veach's correction leaves no light on that way, it ends. */
static WallTurn turn_at(Walker *walker, const BoundaryCrossing *crossing) {
    const bool corrects = walker->walk->params->adjoint_normals;
    const float reflectance = crossing->split.reflectance;
    const bool enters = walker->order == 0 && walker->stack.count == 0 && !walker->has_turned;
    if (corrects && walker->order > 0 && smooth_wall_is_bent(crossing)) {
        const float u = next_random(walker);
        return smooth_wall_turn(crossing, walker->d, (Sample2){u, next_random(walker)});
    }
    WallTurn turn = {.d = crossing->refracted, .weight = enters ? 1.0f - reflectance : 1.0f};
    turn.is_refracted = enters || (reflectance < 1.0f && next_random(walker) >= reflectance);
    if (!turn.is_refracted)
        turn.d = crossing->reflected;
    if (corrects && turn.is_refracted)
        turn.weight *= crossing->can_refract ? crossing->adjoint_refract : 0.0f;
    else if (corrects)
        turn.weight *= crossing->can_reflect ? crossing->adjoint_reflect : 0.0f;
    else if (enters && !crossing->can_refract)
        turn.weight = 0.0f;
    return turn;
}

/* Light goes on beyond a boundary, or back from it. False: it ends there. */
static bool meet(Walker *walker, const Hit *hit) {
    const AmbScene *scene = walker->walk->scene;
    const ScatterParams *params = walker->walk->params;
    const SurfacePoint surface = scene_surface(scene, hit);
    const bool is_outside = walker->stack.count == 0;
    walker->way += hit->t;
    if (surface.material->surface != AMB_SURFACE_DIELECTRIC)
        return meet_opaque(walker, &surface);
    const BoundaryCrossing crossing = boundary_cross(scene, &walker->stack, &surface, walker->d);
    if (crossing.is_opaque)
        return meet_opaque(walker, &crossing.surface);
    if (crossing.is_ignored) {
        walker->stack = crossing.beyond;
        walker->o = scene_leave(&surface, walker->d);
        walker->depth = 0.0f;
        return true;
    }
    walker->is_straight = false;
    walker->comes_from_it = false;
    /* Straight through one object into another: where that is left out, the rest lands. */
    if (walker->has_left && is_outside && walker->order == 0 && !walker->is_of_surroundings &&
        !params->follows_through)
        return false;
    if (is_outside && walker->order == 0 && !walker->has_turned && params->returns)
        reflect_outside(walker, &crossing);
    const WallTurn turn = turn_at(walker, &crossing);
    if (!(turn.weight > 0.0f))
        return false;
    const SceneMaterial *material = crossing.surface.material;
    const Rgb color = turn.is_refracted ? material->transmit_color : material->reflect_color;
    if (!turn.is_refracted && walker->order == 0 && !walker->is_of_surroundings &&
        ++walker->reflections > params->light_bounces)
        return false;
    walker->d = turn.d;
    walker->flux = rgb_scale(rgb_mul(walker->flux, color), turn.weight);
    walker->has_grown = walker->order > 0 && turn.weight > 1.0f;
    walker->o = scene_leave(&crossing.surface, walker->d);
    walker->way = 0.0f;
    walker->depth = 0.0f;
    if (turn.is_refracted) {
        walker->stack = crossing.beyond;
        if (is_outside)
            tally_add(walker->tally->entered, walker->flux);
        if (walker->stack.count == 0) {
            tally_add(walker->tally->escaped, walker->flux);
            walker->has_left = true;
            return walker->order > 0 || walker->is_of_surroundings || params->follows_through ||
                   params->returns;
        }
    }
    return true;
}

static bool survives(Walker *walker) {
    const float worth = rgb_max(walker->flux);
    if (!(worth > 0.0f))
        return false;
    if (worth >= ROULETTE_SHARE * walker->worth)
        return true;
    const float survival = worth / walker->worth;
    if (next_random(walker) >= survival)
        return false;
    walker->flux = rgb_scale(walker->flux, 1.0f / survival);
    walker->worth = rgb_max(walker->flux);
    return true;
}

/* A distance below `length`, from the channels' densities there in proportion to what collides of
 * each (one-sample balance heuristic, as in draw_flight); *out_stretch: what arrives there per
 * collision coefficient. False: nothing collides. */
static bool draw_collision(Walker *walker, const Medium *medium, float length, float *out_t,
                           Rgb *out_stretch) {
    const Rgb sigma_t = medium->sigma_t;
    const float sigma[3] = {sigma_t.r, sigma_t.g, sigma_t.b};
    const float flux[3] = {walker->flux.r, walker->flux.g, walker->flux.b};
    float inside[3], share[3], sum = 0.0f;
    for (int k = 0; k < 3; ++k) {
        inside[k] = -expm1f(-sigma[k] * length);
        share[k] = flux[k] * inside[k];
        sum += share[k];
    }
    const float u = next_random(walker) * sum, v = next_random(walker);
    if (!(sum > 0.0f))
        return false;
    int k = u < share[0] ? 0 : u < share[0] + share[1] ? 1 : 2;
    while (k > 0 && !(share[k] > 0.0f))
        --k; /* rounding went past the last one */
    if (!(share[k] > 0.0f))
        return false;
    const float t = fminf(-log1pf(-v * inside[k]) / sigma[k], length);
    float pdf = 0.0f;
    for (int c = 0; c < 3; ++c)
        if (share[c] > 0.0f)
            pdf += share[c] / sum * sigma[c] * expf(-sigma[c] * t) / inside[c];
    *out_t = t;
    *out_stretch = rgb_scale(rgb_mul(walker->flux, medium_transmittance(medium, t)), 1.0f / pdf);
    return true;
}

/* The share that does not collide where parts of it do with a chance. */
static Rgb rgb_left(Rgb collided, float chance) {
    return rgb(fmaxf(1.0f - collided.r / chance, 0.0f), fmaxf(1.0f - collided.g / chance, 0.0f),
               fmaxf(1.0f - collided.b / chance, 0.0f));
}

/* A flight that is divided: what collides goes its own way to the end, the rest to the boundary.
 * False: there is none. */
static bool fly_divided(Walker *walker, const Medium *medium, Hit *out_hit) {
    const AmbScene *scene = walker->walk->scene;
    if (!scene_intersect(scene, walker->o, walker->d, INFINITY, out_hit)) {
        tally_add(walker->tally->lost, walker->flux);
        return false;
    }
    Walker part = *walker;
    /* Random numbers of its own. */
    part.rng.key = rng_mix(walker->rng.key + rng_mix(walker->dimension++));
    part.dimension = 0;
    const Rgb passed = medium_transmittance(medium, out_hit->t);
    const Rgb collided = rgb(1.0f - passed.r, 1.0f - passed.g, 1.0f - passed.b);
    /* Light that walls reflect again and again would be divided as often, into parts of next to
     * nothing: then some of the time, into larger ones. No flux is made or lost. */
    const float least = ROULETTE_SHARE * walker->worth, analog = rgb_max(collided);
    float chance = 1.0f;
    if (!(analog > 0.0f))
        return true;
    if (walker->order > 0)
        chance = clampf(rgb_max(rgb_mul(walker->flux, collided)) / least, analog, 1.0f);
    if (rgb_max(rgb_mul(walker->flux, rgb_left(collided, chance))) < least)
        chance = analog;
    float t = 0.0f;
    Rgb stretch;
    if ((chance < 1.0f && next_random(&part) >= chance) ||
        !draw_collision(&part, medium, out_hit->t, &t, &stretch))
        return true;
    walker->flux = rgb_mul(walker->flux, rgb_left(collided, chance));
    part.o = vec3_madd(part.o, t, part.d);
    if (collide(&part, medium, medium_stack_top(&part.stack), rgb_scale(stretch, 1.0f / chance)))
        follow(&part, NULL);
    return true;
}

/* Follows all parts but one of a photon that has grown. */
static void divide(Walker *walker) {
    const float share = rgb_max(walker->flux) / walker->worth;
    if (!(share > DIVIDE_SHARE))
        return;
    const uint32_t wanted = share < (float)PARTS_MAX ? (uint32_t)ceilf(share) : PARTS_MAX;
    const uint32_t more = wanted - 1 < *walker->parts ? wanted - 1 : *walker->parts;
    *walker->parts -= more;
    walker->flux = rgb_scale(walker->flux, 1.0f / (float)(more + 1));
    for (uint32_t i = 0; i < more; ++i) {
        Walker part = *walker;
        part.rng.key = rng_mix(walker->rng.key + rng_mix(walker->dimension++));
        part.dimension = 0;
        follow(&part, NULL);
    }
}

/* Follows a photon that meets a boundary, or is in a medium (hit NULL). */
static void follow(Walker *walker, const Hit *first) {
    if (first != NULL && !meet(walker, first))
        return;
    walker->worth = rgb_max(walker->flux);
    for (uint32_t boundaries = 0; boundaries < BOUNDARY_MAX;) {
        Hit hit;
        bool ends = false, arrives;
        const SceneMaterial *material = medium_stack_material(walker->walk->scene, &walker->stack);
        if (walker->order < walker->walk->forced_count && material != NULL &&
            medium_scatters(&material->medium)) {
            arrives = fly_divided(walker, &material->medium, &hit);
            ends = !arrives;
        } else {
            arrives = fly(walker, &hit, &ends);
        }
        if (arrives) {
            ++boundaries;
            if (!meet(walker, &hit))
                return;
            if (walker->has_grown && walker->stack.count > 0)
                divide(walker);
        }
        /* Light of the last order goes on to where it lands. */
        if (ends || (walker->landings == NULL && has_last_order(walker)) || !survives(walker))
            return;
    }
    tally_add(walker->tally->lost, walker->flux);
}

/* A line from far away through the object: wherever it comes to the boundary, light of what is
 * behind it enters, of the world or of an opaque surface. What is behind another translucent
 * object comes through that one. */
static void follow_line(Walker *walker, const Photon *line) {
    const AmbScene *scene = walker->walk->scene;
    Rgb radiance = world_radiance_but_lamps(&scene->world, vec3_negate(line->d));
    MediumStack stack = {0};
    Vec3 o = line->o;
    for (uint32_t boundaries = 0; boundaries < BOUNDARY_MAX; ++boundaries) {
        Hit hit;
        if (!scene_intersect(scene, o, line->d, INFINITY, &hit))
            return;
        const SurfacePoint surface = scene_surface(scene, &hit);
        o = scene_leave(&surface, line->d);
        if (surface.material->surface != AMB_SURFACE_DIELECTRIC) {
            if (stack.count == 0)
                radiance = photon_surface_radiance(scene, &surface, line->d,
                                                   walker->walk->params->interreflects, walker->rng,
                                                   &walker->dimension);
            continue;
        }
        const BoundaryCrossing crossing = boundary_cross(scene, &stack, &surface, line->d);
        if (crossing.is_ignored) {
            stack = crossing.beyond;
            continue;
        }
        if (stack.count == 0 && surface.object == line->batch->target && rgb_max(radiance) > 0.0f) {
            walker->d = line->d;
            walker->stack = stack;
            walker->flux = rgb_mul(line->flux, radiance);
            walker->order = 0;
            Walker part = *walker;
            follow(&part, &hit);
            walker->dimension = part.dimension;
        }
        if (crossing.beyond.count == 0)
            radiance = rgb(0, 0, 0);
        stack = crossing.beyond;
    }
}

void photon_walk(const PhotonWalk *walk, uint64_t i, float *const *moments,
                 PhotonLandings *landings, ScatterTally *tally) {
    const Photon photon = photon_emit(walk->source, i);
    if (!(rgb_max(photon.flux) > 0.0f))
        return;
    const bool is_of_lamp = photon.batch->emission.light != NULL;
    MediumStack start;
    if (!light_batch_start(walk->scene, photon.batch, photon.o, &start))
        return;
    const float rank = sample_fibonacci_rank(i - photon.batch->first, photon.batch->shift);
    uint32_t parts = PARTS_OF_PHOTON_MAX;
    Walker walker = {.walk = walk,
                     .moments = moments,
                     .parts = &parts,
                     .landings = rank < walk->landing_part ? landings : NULL,
                     .tally = tally,
                     .rank = rank,
                     .rng = rng_create(walk->params->seed, RNG_STAGE_PHOTON, i + (1u << 16)),
                     .o = photon.o,
                     .d = photon.d,
                     .flux = photon.flux,
                     .stack = start,
                     .is_of_surroundings = !is_of_lamp,
                     .is_straight = is_of_lamp};
    ++tally->photon_count;
    if (!is_of_lamp) {
        follow_line(&walker, &photon);
    } else if (walker.stack.count > 0) {
        tally_add(tally->entered, photon.flux);
        follow(&walker, NULL);
    } else {
        /* Each object that a light reaches first has photons of its own. */
        Hit hit;
        if (!scene_intersect(walk->scene, walker.o, walker.d, INFINITY, &hit) ||
            hit.geometry != photon.batch->target)
            return;
        walker.flux = rgb_scale(walker.flux, photon_falloff(&photon, hit.t));
        follow(&walker, &hit);
    }
}
