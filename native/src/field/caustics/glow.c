/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons to opaque surfaces, and the width of their kernels. */
#include "field/caustics/glow.h"

#include <string.h>

#include "base/memory.h"
#include "field/caustics/neighbours.h"

enum {
    GRAIN = 256,       /* photons of one unit of work */
    PLACE_GRAIN = 1024 /* kernels */
};

/* n photons share OVERLAP n^(2/3) kernels at a point: the noise 1/sqrt(k) and the blur, which goes
 * with the square of the width, k/n, then fall alike, as n^(-1/3). By bench_glow.py. */
static const double OVERLAP = 0.5;
/* A kernel is no wider than the way that its light came without a turn: light from near by changes
 * within as much. But for this part of what the density says, so that no photon is a dot: with a
 * tenth, light below an object that all but touches the floor spread to where it is seen. */
static const float WIDTH_MIN = 0.01f;
/* Below this optical radius each flight casts a ray: few are far from the boundary. */
static const float DEEP_RADIUS = 4.0f;
/* Cubes of the grid of depths in a radius. */
static const float CUBES = 12.0f;

/* By chunk of GRAIN photons. */
typedef struct Trace {
    PhotonWalk walk;
    Job *job;
    PhotonLandings *landings;
    ScatterTally *tallies;
} Trace;

static AmbStatus trace_chunk(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    Trace *trace = user;
    const uint64_t photon_count = trace->walk.source->photon_count;
    for (uint64_t c = begin; c < end; ++c) {
        PhotonLandings *landings = &trace->landings[c];
        for (uint64_t i = c * GRAIN; i < (c + 1) * GRAIN && i < photon_count; ++i) {
            if (job_is_cancelled(trace->job))
                return AMB_CANCELLED;
            photon_walk(&trace->walk, i, NULL, landings, &trace->tallies[c]);
            if (landings->is_cut_short)
                return status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
        }
        atomic_fetch_add(&trace->job->work_done, 1);
    }
    return AMB_OK;
}

static void add_tally(ScatterTally *sum, const ScatterTally *tally) {
    sum->photon_count += tally->photon_count;
    sum->collision_count += tally->collision_count;
    for (int k = 0; k < 3; ++k) {
        sum->entered[k] += tally->entered[k];
        sum->absorbed[k] += tally->absorbed[k];
        sum->escaped[k] += tally->escaped[k];
        sum->lost[k] += tally->lost[k];
    }
}

static uint32_t order_index(const PhotonLanding *landing) {
    return (landing->order < GLOW_ORDER_COUNT ? landing->order : GLOW_ORDER_COUNT) - 1;
}

AmbStatus glow_sort(PhotonLandings *lists, uint64_t list_count, Job *job, GlowLandings *all) {
    for (uint64_t c = 0; c < list_count; ++c) {
        const PhotonLandings *some = &lists[c];
        for (uint64_t i = 0; i < some->count; ++i)
            ++all->orders[order_index(&some->list[i])].room;
    }
    for (uint32_t k = 0; k < GLOW_ORDER_COUNT; ++k) {
        PhotonLandings *landings = &all->orders[k];
        landings->list = memory_alloc_array(landings->room, sizeof *landings->list);
        if (landings->list == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    }
    for (uint64_t c = 0; c < list_count; ++c) {
        if (job_is_cancelled(job))
            return AMB_CANCELLED;
        for (uint64_t i = 0; i < lists[c].count; ++i) {
            const PhotonLanding *landing = &lists[c].list[i];
            PhotonLandings *landings = &all->orders[order_index(landing)];
            landings->list[landings->count++] = *landing;
        }
        memory_free(lists[c].list); /* half of the memory, from here on */
        lists[c] = (PhotonLandings){.list = NULL};
    }
    return AMB_OK;
}

static AmbStatus run_photons(Trace *trace, GlowLandings *all) {
    const uint64_t photon_count = trace->walk.source->photon_count;
    const uint64_t chunk_count = (photon_count + GRAIN - 1) / GRAIN;
    trace->landings = memory_zero_array(chunk_count, sizeof *trace->landings);
    trace->tallies = memory_zero_array(chunk_count, sizeof *trace->tallies);
    AmbStatus status = AMB_OK;
    if (trace->landings == NULL || trace->tallies == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    atomic_store(&trace->job->work_done, 0);
    atomic_store(&trace->job->work_total, chunk_count);
    if (status == AMB_OK)
        status = parallel_for(trace->job, chunk_count, 1, trace_chunk, trace);
    if (status == AMB_OK)
        status = glow_sort(trace->landings, chunk_count, trace->job, all);
    for (uint64_t c = 0; c < chunk_count && status == AMB_OK; ++c)
        add_tally(&all->tally, &trace->tallies[c]);
    for (uint64_t c = 0; trace->landings != NULL && c < chunk_count; ++c)
        memory_free(trace->landings[c].list);
    memory_free(trace->landings);
    memory_free(trace->tallies);
    return status;
}

/* Depths tell how far a photon may fly without meeting the boundary. */
static AmbStatus build_depths(const AmbScene *scene, Job *job, ScatterCells *cells) {
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const SceneObject *object = &scene->objects[o];
        const Medium *medium = &scene->materials[object->inside].medium;
        if (object->is_boundary && medium_scatters(medium) &&
            object->radius * rgb_max(medium->sigma_t) >= DEEP_RADIUS)
            AMB_TRY(depth_grid_build(scene, o, object->radius / CUBES, job, &cells[o].depth));
    }
    return AMB_OK;
}

AmbStatus glow_trace(const AmbScene *scene, const ScatterParams *params, Job *job,
                     GlowLandings *out_landings) {
    *out_landings = (GlowLandings){.tally = {.photon_count = 0}};
    ScatterCells *cells = memory_zero_array(scene->object_count, sizeof *cells);
    PhotonSource source = {.batches = NULL};
    AmbStatus status = AMB_OK;
    if (cells == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    if (status == AMB_OK)
        status = build_depths(scene, job, cells);
    if (status == AMB_OK)
        status = photon_source_create(scene, params, &source);
    if (status == AMB_OK) {
        Trace trace = {.walk = {.scene = scene,
                                .params = params,
                                .source = &source,
                                .cells = cells,
                                .forced_count = 1,
                                .landing_part = 1.0f},
                       .job = job};
        status = run_photons(&trace, out_landings);
    }
    photon_source_clear(&source);
    for (uint32_t o = 0; cells != NULL && o < scene->object_count; ++o)
        depth_grid_clear(&cells[o].depth);
    memory_free(cells);
    if (status != AMB_OK)
        glow_clear(out_landings);
    return status;
}

void glow_clear(GlowLandings *landings) {
    for (uint32_t k = 0; k < GLOW_ORDER_COUNT; ++k)
        memory_free(landings->orders[k].list);
    memset(landings, 0, sizeof *landings);
}

/* ---- Kernels --------------------------------------------------------------------------------- */

/* Of the landings one in `step` is looked for: 16 of them tell the density to a quarter, and a
 * kernel's width to an eighth. */
typedef struct Placement {
    const AmbScene *scene;
    const PhotonLandings *landings;
    Place *places;
    uint64_t place_count;
    uint32_t rank;
    float scale; /* of the distance to that neighbour */
    float least; /* width, m */
    CausticPhoton *photons;
} Placement;

/* Near an edge of a surface kernels are narrower, in proportion to the distance from it: points on
 * a ring of REACH half-axes must all be on the surface, or the kernel is halved. The narrowest are
 * as much brighter as of the ring that halves a kernel's flux is missing. */
enum { PROBES = 4 };
static const float REACH = 1.5f, HALF_FLUX = 0.54f;
/* Of the width that the density asks for. */
static const float EDGE_WIDTH_MIN = 0.2f;
/* Above the surface, and to both sides of it, in distances of the ring. */
static const float PROBE_HEIGHT = 0.2f;
static const float PROBE_COS_MIN = 0.5f;

static Place place_of(const PhotonLanding *landing, uint64_t i) {
    return (Place){.p = landing->p, .n = landing->n, .id = i};
}

/* Whether the surface goes on from a landing to the point at `offset`, with nothing between. */
static bool goes_on(const AmbScene *scene, const PhotonLanding *landing, Vec3 offset) {
    const float way = vec3_length(offset), height = PROBE_HEIGHT * way;
    const Vec3 from = vec3_madd(landing->p, height, landing->n);
    if (scene_is_occluded(scene, from, vec3_scale(offset, 1.0f / way), way))
        return false;
    const Vec3 down = vec3_negate(landing->n);
    Hit hit;
    if (!scene_intersect(scene, vec3_add(from, offset), down, 2.0f * height, &hit))
        return false;
    const SurfacePoint surface = scene_surface(scene, &hit);
    return fabsf(vec3_dot(surface.ng, down)) >= PROBE_COS_MIN;
}

/* How many points of the ring are on the surface. */
static int count_around(const AmbScene *scene, const PhotonLanding *landing, float turn,
                        float radius) {
    Vec3 x, y;
    vec3_frame(landing->n, &x, &y);
    int count = 0;
    for (int k = 0; k < PROBES; ++k) {
        const float angle = 2.0f * AMB_PI * (turn + (float)k / PROBES);
        const Vec3 along = vec3_madd(vec3_scale(x, cosf(angle)), sinf(angle), y);
        count += goes_on(scene, landing, vec3_scale(along, radius)) ? 1 : 0;
    }
    return count;
}

/* Narrows a kernel to the surface that it lies on; returns what part of it does, about. */
static float fit(const AmbScene *scene, const PhotonLanding *landing, float turn, float least,
                 float *width) {
    while (count_around(scene, landing, turn, REACH * *width) < PROBES) {
        if (0.5f * *width < least) {
            const int count = count_around(scene, landing, turn, HALF_FLUX * *width);
            return count > 0 ? (float)count / PROBES : 1.0f;
        }
        *width *= 0.5f;
    }
    return 1.0f;
}

static CausticPhoton place_photon(const Placement *placement, uint64_t i) {
    const PhotonLanding *landing = &placement->landings->list[i];
    const Place place = place_of(landing, i);
    const float wanted =
        placement->scale *
        neighbours_distance(placement->places, placement->place_count, &place, placement->rank);
    float width = landing->distance, least = 0.0f;
    if (isfinite(wanted)) {
        width = clampf(width, WIDTH_MIN * wanted, wanted);
        least = EDGE_WIDTH_MIN * wanted;
    }
    width = fmaxf(width, placement->least);
    const float turn = rng_float((Rng){rng_mix(i)}, 0);
    const float part = fit(placement->scene, landing, turn, fmaxf(least, placement->least), &width);
    Vec3 x, y;
    vec3_frame(landing->n, &x, &y);
    return (CausticPhoton){.p = landing->p,
                           .n = landing->n,
                           .u = vec3_scale(x, 1.0f / width),
                           .v = vec3_scale(y, 1.0f / width),
                           .peak =
                               rgb_scale(landing->flux, 2.0f / (AMB_PI * width * width * part))};
}

static AmbStatus place_photons(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Placement *placement = user;
    for (uint64_t i = begin; i < end; ++i)
        placement->photons[i] = place_photon(placement, i);
    return AMB_OK;
}

/* By chance: photons come in the order of a lattice. */
static bool is_chosen(uint64_t i, uint64_t step) {
    return rng_mix(i + 1) % step == 0;
}

/* Narrower kernels are points, in radii of the scene. */
static const float POINT = 1e-6f;

AmbStatus glow_place(const AmbScene *scene, const PhotonLandings *landings, Job *job,
                     CausticPhoton *photons) {
    const double count = (double)landings->count;
    const double wanted = fmax(OVERLAP * cbrt(count * count), 1.0);
    const uint64_t step = (uint64_t)fmax(wanted / NEIGHBOURS_MAX, 1.0);
    const double rank = fmin(round(wanted / (double)step), NEIGHBOURS_MAX);
    Placement placement = {.scene = scene,
                           .landings = landings,
                           .rank = (uint32_t)rank,
                           .scale = (float)sqrt(wanted / ((double)step * rank)),
                           .least = POINT * scene->radius,
                           .photons = photons};
    placement.places = memory_alloc_array(landings->count, sizeof *placement.places);
    if (placement.places == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
    for (uint64_t i = 0; i < landings->count; ++i)
        if (is_chosen(i, step))
            placement.places[placement.place_count++] = place_of(&landings->list[i], i);
    neighbours_sort(placement.places, placement.place_count);
    const AmbStatus status =
        parallel_for(job, landings->count, PLACE_GRAIN, place_photons, &placement);
    memory_free(placement.places);
    return status;
}
