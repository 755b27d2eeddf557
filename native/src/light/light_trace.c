/* SPDX-License-Identifier: GPL-3.0-or-later
 * The light pass. */
#include "light/light_trace.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"
#include "light/light_batch.h"

enum {
    GRAIN = 1024,    /* rays of one unit of work */
    EVENT_MAX = 128, /* boundaries along one ray, a guard against endless reflection */
    ORDER_MAX = 64   /* branches of one ray that wait for their turn */
};

/* Beams end where exp(-OPTICAL_DEPTH_MAX) = 1e-8 of the flux is left in the clearest channel. */
static const float OPTICAL_DEPTH_MAX = 18.4f;
/* Below this cosine of incidence a ray is dropped: it carries less than 1e-7 of the flux of its
 * surroundings (flux per area and transmittance both vanish with the cosine) and its footprint
 * has no useful direction. */
static const float GRAZING_COS = 1e-4f;
/* Branches with less than this share of their ray's flux end: what all of them together would add
 * is below 1e-5 of the light, and a clear object with many bounces would fill memory with them. */
static const float FLUX_MIN = 1e-6f;
/* A cell that grows by more than this along its beam, because the lamp is so near, counts as if it
 * grew by this. */
static const float GROWTH_MAX = 16.0f;
/* The same for light on its way to opaque surfaces, where nothing magnifies the rest. */
static const float FLUX_MIN_LANDING = 1e-4f;

typedef struct Chunk {
    LightBeam *beams;
    uint32_t *owners; /* object of each beam */
    uint64_t count, room;
    LightLanding *landings;
    uint64_t landing_count, landing_room;
    SceneLeaks leaks;
    uint64_t irregular_count, nested_count;
    LightTally tally;
} Chunk;

typedef struct Tracer {
    const AmbScene *scene;
    const LightTraceParams *params;
    Job *job;
    LightBatch *batches;
    uint64_t batch_count;
    Chunk *chunks;
} Tracer;

/* A branch of a light ray: what is left to follow. */
typedef struct Branch {
    Vec3 o, d;
    Rgb flux;
    TangentPair pairs[TANGENT_COUNT];
    MediumStack stack;
    float entry_area, cell_area; /* 0: not inside yet */
    float lamp;                  /* m, from a lamp to where its light entered; 0: no matter */
    float start_slope;
    float emitted;    /* largest channel of the ray's flux at the light */
    float stands_for; /* rays, >= 1: more where others have ended in its favour */
    float rank;       /* see goes_on */
    uint32_t bounces;
    bool is_of_mesh; /* that emits: tubes know none of its light */
    bool is_direct;  /* has met no boundary yet */
    bool is_bent;    /* has been refracted or reflected */
    bool has_passed; /* has left an object */
} Branch;

static AmbStatus chunk_append(Chunk *chunk, const LightBeam *beam, uint32_t owner) {
    if (chunk->count == chunk->room) {
        const uint64_t room = chunk->room > 0 ? 2 * chunk->room : GRAIN;
        LightBeam *beams = memory_alloc_array(room, sizeof *beams);
        uint32_t *owners = memory_alloc_array(room, sizeof *owners);
        if (beams == NULL || owners == NULL) {
            memory_free(beams);
            memory_free(owners);
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for light rays");
        }
        if (chunk->count > 0) {
            memcpy(beams, chunk->beams, chunk->count * sizeof *beams);
            memcpy(owners, chunk->owners, chunk->count * sizeof *owners);
        }
        memory_free(chunk->beams);
        memory_free(chunk->owners);
        chunk->beams = beams;
        chunk->owners = owners;
        chunk->room = room;
    }
    chunk->beams[chunk->count] = *beam;
    chunk->owners[chunk->count++] = owner;
    return AMB_OK;
}

static AmbStatus chunk_land(Chunk *chunk, const LightLanding *landing) {
    if (chunk->landing_count == chunk->landing_room) {
        const uint64_t room = chunk->landing_room > 0 ? 2 * chunk->landing_room : GRAIN;
        LightLanding *landings = memory_alloc_array(room, sizeof *landings);
        if (landings == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for caustics");
        if (chunk->landing_count > 0)
            memcpy(landings, chunk->landings, chunk->landing_count * sizeof *landings);
        memory_free(chunk->landings);
        chunk->landings = landings;
        chunk->landing_room = room;
    }
    chunk->landings[chunk->landing_count++] = *landing;
    return AMB_OK;
}

static void tally_add(double sum[3], Rgb flux) {
    sum[0] += (double)flux.r;
    sum[1] += (double)flux.g;
    sum[2] += (double)flux.b;
}

static float slope(float cosine) {
    const float c = fmaxf(fabsf(cosine), GRAZING_COS);
    return safe_sqrtf(1.0f - c * c) / c;
}

/* The rank among the rays that a branch goes on in. */
static float rank_left(const Branch *branch) {
    return fminf(branch->rank * branch->stands_for, 1.0f - 0x1p-24f);
}

static bool is_carried(const LightTraceParams *params, const Branch *branch) {
    return !branch->has_passed && !branch->is_of_mesh && branch->bounces < params->carried;
}

/* Emits the stretch of a branch inside a medium and attenuates it to its end. */
static AmbStatus emit_beam(Chunk *chunk, const Tracer *tracer, Branch *branch, float length,
                           float end_slope) {
    const AmbScene *scene = tracer->scene;
    const bool is_kept = !is_carried(tracer->params, branch);
    const Medium *medium = &medium_stack_material(scene, &branch->stack)->medium;
    const float clearest = rgb_min(medium->sigma_t);
    float visible = length;
    if (clearest * length > OPTICAL_DEPTH_MAX) {
        visible = OPTICAL_DEPTH_MAX / clearest;
        end_slope = 0.0f;
    }
    const Rgb transmittance = medium_transmittance(medium, length);
    if (is_kept)
        tally_add(chunk->tally.interacting,
                  rgb_mul(branch->flux, rgb(1.0f - transmittance.r, 1.0f - transmittance.g,
                                            1.0f - transmittance.b)));
    AmbStatus status = AMB_OK;
    if (!tracer->params->lands && medium_scatters(medium)) {
        LightBeam beam = {.origin = branch->o,
                          .direction = branch->d,
                          .length = visible,
                          .flux = branch->flux,
                          .spread = tangent_spread(branch->pairs, branch->d),
                          .rank = rank_left(branch),
                          .bounces = (uint16_t)branch->bounces,
                          .has_passed = branch->has_passed,
                          .start_slope = branch->start_slope,
                          .end_slope = end_slope};
        if (branch->entry_area == 0.0f) {
            /* A light inside the medium spreads from a point: its largest cross-section takes
             * the place of the one at entry. */
            branch->entry_area = tangent_cross_section(&beam.spread, visible) / GROWTH_MAX;
            branch->cell_area = tangent_cell_area(branch->pairs, branch->d, visible) / GROWTH_MAX;
        }
        if (branch->lamp > 0.0f) {
            /* A lamp close to the surface: cells are points there, and rays part as from a lamp
             * inside. */
            const float growth = 1.0f + visible / branch->lamp;
            const float scale = fmaxf(growth * growth / GROWTH_MAX, 1.0f);
            branch->entry_area *= scale;
            branch->cell_area *= scale;
            branch->lamp = 0.0f;
        }
        beam.entry_area = branch->entry_area;
        beam.cell_area = branch->cell_area * branch->stands_for;
        if (is_kept && beam.cell_area > 0.0f)
            status = chunk_append(chunk, &beam, medium_stack_top(&branch->stack));
    }
    branch->flux = rgb_mul(branch->flux, transmittance);
    return status;
}

/* A branch arrives at a boundary. */
typedef struct Arrival {
    const Branch *branch; /* pairs and flux as they are there */
    const BoundaryCrossing *crossing;
} Arrival;

static Branch branch_on(const AmbScene *scene, const Arrival *arrival, bool is_refracted) {
    const DielectricSplit *split = &arrival->crossing->split;
    const SurfacePoint *surface = &arrival->crossing->surface;
    const Vec3 n = arrival->crossing->n;
    Branch next = *arrival->branch;
    for (int k = 0; k < TANGENT_COUNT; ++k) {
        const TangentPair pair = next.pairs[k];
        Vec3 dn = scene_normal_derivative(scene, &surface->hit, pair.dp);
        if (!arrival->crossing->is_entering)
            dn = vec3_negate(dn);
        next.pairs[k] = is_refracted ? tangent_refract(pair, next.d, n, dn, arrival->crossing->eta,
                                                       split->cos_i, split->cos_t)
                                     : tangent_reflect(pair, next.d, n, dn, split->cos_i);
    }
    next.d = is_refracted ? split->refracted : split->reflected;
    next.o = scene_leave(surface, next.d);
    next.start_slope = slope(vec3_dot(next.d, surface->ng));
    next.is_direct = false;
    next.is_bent = next.is_bent || !is_refracted || arrival->crossing->eta != 1.0f;
    return next;
}

/* Whether a branch is followed: not where nothing to speak of is left of its ray's flux, and in
 * part of the rays where that is little: the ranks of rays that go on are below the share left,
 * an even part of the lattice. Rays then lie where the light is; many beams of next to no light
 * would cost every gather what they cost, and add nothing. */
static bool goes_on(const Tracer *tracer, Branch *branch) {
    const float least = tracer->params->lands ? FLUX_MIN_LANDING : FLUX_MIN;
    const float share = rgb_max(branch->flux) / (branch->emitted * branch->stands_for);
    if (!(share > least))
        return false;
    if (share * branch->stands_for >= tracer->params->roulette)
        return true;
    const float survival = share / tracer->params->roulette;
    if (!(branch->rank < survival))
        return false;
    branch->flux = rgb_scale(branch->flux, 1.0f / (survival * branch->stands_for));
    branch->stands_for = 1.0f / survival;
    return true;
}

static Branch refract_branch(const Tracer *tracer, const Arrival *arrival) {
    const BoundaryCrossing *crossing = arrival->crossing;
    Branch next = branch_on(tracer->scene, arrival, true);
    float weight = 1.0f - crossing->split.reflectance;
    if (tracer->params->adjoint_normals)
        weight *= crossing->adjoint_refract;
    next.flux = rgb_mul(rgb_scale(next.flux, weight), crossing->surface.material->transmit_color);
    next.stack = crossing->beyond;
    next.has_passed = next.has_passed || next.stack.count == 0;
    if (arrival->branch->stack.count == 0) {
        const TangentSpread spread = tangent_spread(next.pairs, next.d);
        next.entry_area = tangent_cross_section(&spread, 0.0f);
        next.cell_area = tangent_cell_area(next.pairs, next.d, 0.0f);
    }
    return next;
}

static Branch reflect_branch(const Tracer *tracer, const Arrival *arrival) {
    const BoundaryCrossing *crossing = arrival->crossing;
    Branch next = branch_on(tracer->scene, arrival, false);
    float weight = crossing->split.reflectance;
    if (tracer->params->adjoint_normals)
        weight *= crossing->adjoint_reflect;
    next.flux = rgb_mul(rgb_scale(next.flux, weight), crossing->surface.material->reflect_color);
    ++next.bounces;
    return next;
}

/* The intensity of Cycles' discs falls as 1/(d^2 + r^2) where that of our emission falls as
 * 1/d^2. */
static float disc_falloff(const SceneLight *light, float distance) {
    const float d2 = distance * distance;
    return light->radius > 0.0f ? d2 / (d2 + light->radius * light->radius) : 1.0f;
}

/* A branch ends on an opaque surface. */
static AmbStatus land(Chunk *chunk, const Branch *branch, const SurfacePoint *surface) {
    const float cos_face = -vec3_dot(branch->d, surface->ng);
    const float side = cos_face > 0.0f ? 1.0f : -1.0f;
    const float cos_shading = -side * vec3_dot(branch->d, surface->ns);
    if (fabsf(cos_face) < GRAZING_COS || !(cos_shading > 0.0f))
        return AMB_OK;
    LightLanding landing = {.p = surface->p,
                            .n = vec3_scale(surface->ng, side),
                            .rank = rank_left(branch),
                            .bounces = branch->bounces,
                            .flux = rgb_scale(branch->flux, cos_shading / fabsf(cos_face))};
    const float width = sqrtf(branch->stands_for);
    for (int k = 0; k < TANGENT_COUNT; ++k)
        landing.footprint[k] = vec3_scale(branch->pairs[k].dp, k < TANGENT_LATTICE ? width : 1.0f);
    tally_add(chunk->tally.landed, landing.flux);
    return chunk_land(chunk, &landing);
}

static AmbStatus trace_ray(const Tracer *tracer, const LightBatch *batch, uint64_t index,
                           Chunk *chunk) {
    const AmbScene *scene = tracer->scene;
    const LightTraceParams *params = tracer->params;
    const LightRay ray = light_emit(&batch->emission, index);
    MediumStack start;
    if (!(rgb_max(ray.flux) > 0.0f) || !light_batch_start(scene, batch, ray.o, &start))
        return AMB_OK;
    Branch waiting[ORDER_MAX];
    uint32_t waiting_count = 1;
    waiting[0] = (Branch){.o = ray.o,
                          .d = ray.d,
                          .flux = ray.flux,
                          .emitted = rgb_max(ray.flux),
                          .stands_for = 1.0f,
                          .rank = sample_fibonacci_rank(index, batch->shift),
                          .stack = start,
                          .is_direct = true,
                          .is_of_mesh = batch->emission.light->kind == LIGHT_MESH};
    memcpy(waiting[0].pairs, ray.pairs, sizeof ray.pairs);

    for (int event = 0; waiting_count > 0 && event < EVENT_MAX; ++event) {
        Branch branch = waiting[--waiting_count];
        const bool is_outside = branch.stack.count == 0;
        BoundaryArrival next_surface;
        const bool is_hit =
            boundary_find(scene, &branch.stack, branch.o, branch.d, INFINITY, &next_surface);
        event += (int)next_surface.passed_count;
        /* Each object that a light reaches first has rays of its own. */
        const BoundaryCrossing *crossing = &next_surface.crossing;
        if (is_hit && is_outside && branch.is_direct && crossing->surface.object != batch->target)
            continue;
        chunk->irregular_count += next_surface.irregular_count;
        chunk->nested_count += next_surface.nested_count;
        if (!is_hit) {
            if (!is_outside) {
                scene_leaks_add(&chunk->leaks, 1, medium_stack_top(&branch.stack));
                AMB_TRY(emit_beam(chunk, tracer, &branch, scene_end(scene, branch.o), 0.0f));
            }
            continue;
        }
        const float length = next_surface.t;
        const Vec3 ng = crossing->surface.ng;
        if (branch.is_direct && is_outside)
            branch.flux =
                rgb_scale(branch.flux, disc_falloff(batch->emission.light, ray.way + length));
        const float cos_face = vec3_dot(branch.d, ng);
        if (!is_outside)
            AMB_TRY(emit_beam(chunk, tracer, &branch, length, slope(cos_face)));
        for (int k = 0; k < TANGENT_COUNT; ++k)
            branch.pairs[k] = tangent_travel_to_surface(branch.pairs[k], length, branch.d, ng);
        if (next_surface.is_opaque) {
            if (params->lands && branch.is_bent)
                AMB_TRY(land(chunk, &branch, &crossing->surface));
            continue;
        }
        if (is_outside && branch.is_direct)
            tally_add(chunk->tally.incident, branch.flux);
        if (fabsf(cos_face) < GRAZING_COS || crossing->split.cos_i < GRAZING_COS)
            continue;

        const Arrival arrival = {&branch, crossing};
        const bool is_followed = crossing->beyond.count > 0 || params->follows_through;
        if (crossing->can_refract && is_followed && waiting_count < ORDER_MAX) {
            Branch next = refract_branch(tracer, &arrival);
            if (is_outside && branch.is_direct && batch->emission.light->kind != AMB_LIGHT_SUN)
                next.lamp = ray.way + length;
            if (is_outside && branch.is_direct)
                tally_add(chunk->tally.entered, next.flux);
            if (goes_on(tracer, &next))
                waiting[waiting_count++] = next;
        }
        const bool reflects = is_outside ? params->lands : branch.bounces < params->bounces;
        if (crossing->can_reflect && reflects && waiting_count < ORDER_MAX) {
            Branch next = reflect_branch(tracer, &arrival);
            if (is_outside)
                next.bounces = branch.bounces;
            if (goes_on(tracer, &next))
                waiting[waiting_count++] = next;
        }
    }
    return AMB_OK;
}

static AmbStatus trace_chunk(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Tracer *tracer = user;
    for (uint64_t c = begin; c < end; ++c) {
        Chunk *chunk = &tracer->chunks[c];
        const uint64_t last = (c + 1) * GRAIN < tracer->params->ray_count
                                  ? (c + 1) * GRAIN
                                  : tracer->params->ray_count;
        uint64_t b = 0;
        for (uint64_t i = c * GRAIN; i < last; ++i) {
            while (b + 1 < tracer->batch_count && tracer->batches[b + 1].first <= i)
                ++b;
            AMB_TRY(trace_ray(tracer, &tracer->batches[b], i - tracer->batches[b].first, chunk));
        }
        atomic_fetch_add(&tracer->job->work_done, 1);
    }
    return AMB_OK;
}

/* Lists the pairs of a light and a boundary that can meet. */
static AmbStatus list_batches(Tracer *tracer) {
    const AmbScene *scene = tracer->scene;
    tracer->batches =
        memory_zero_array((uint64_t)scene->light_count * scene->object_count, sizeof(LightBatch));
    if (tracer->batches == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light plan");
    for (uint32_t l = 0; l < scene->light_count; ++l)
        for (uint32_t o = 0; o < scene->object_count; ++o) {
            const bool is_target = tracer->params->targets == NULL || tracer->params->targets[o];
            const Rng rng = rng_create(tracer->params->seed, RNG_STAGE_LIGHT, l);
            LightBatch batch;
            if (!is_target || !light_batch_aim(scene, &scene->lights[l], o, rng, &batch))
                continue;
            batch.power = (double)light_power_towards(&batch.emission);
            if (batch.power > 0.0)
                tracer->batches[tracer->batch_count++] = batch;
        }
    return AMB_OK;
}

static AmbStatus gather_chunks(const Tracer *tracer, uint64_t chunk_count, LightField *field) {
    for (uint64_t c = 0; c < chunk_count; ++c) {
        if (job_is_cancelled(tracer->job))
            return AMB_CANCELLED;
        const Chunk *chunk = &tracer->chunks[c];
        for (uint64_t i = 0; i < chunk->count; ++i)
            ++field->objects[chunk->owners[i]].count;
        field->landing_count += chunk->landing_count;
    }
    for (uint32_t o = 0; o < field->object_count; ++o) {
        LightBeams *beams = &field->objects[o];
        beams->beams = memory_alloc_array(beams->count, sizeof(LightBeam));
        if (beams->beams == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu light rays",
                               (unsigned long long)beams->count);
        beams->count = 0;
    }
    field->landings = memory_alloc_array(field->landing_count, sizeof *field->landings);
    if (field->landings == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu caustic photons",
                           (unsigned long long)field->landing_count);
    field->landing_count = 0;
    for (uint64_t c = 0; c < chunk_count; ++c) {
        if (job_is_cancelled(tracer->job))
            return AMB_CANCELLED;
        Chunk *chunk = &tracer->chunks[c];
        if (chunk->landing_count > 0)
            memcpy(field->landings + field->landing_count, chunk->landings,
                   chunk->landing_count * sizeof *chunk->landings);
        field->landing_count += chunk->landing_count;
        memory_free(chunk->landings); /* half of the memory, from here on */
        chunk->landings = NULL;
        for (uint64_t i = 0; i < chunk->count; ++i) {
            LightBeams *beams = &field->objects[chunk->owners[i]];
            beams->beams[beams->count++] = chunk->beams[i];
        }
        scene_leaks_add(&field->leaks, chunk->leaks.count, chunk->leaks.object);
        field->irregular_count += chunk->irregular_count;
        field->nested_count += chunk->nested_count;
        for (int k = 0; k < 3; ++k) {
            field->tally.incident[k] += chunk->tally.incident[k];
            field->tally.entered[k] += chunk->tally.entered[k];
            field->tally.interacting[k] += chunk->tally.interacting[k];
            field->tally.landed[k] += chunk->tally.landed[k];
        }
    }
    return AMB_OK;
}

AmbStatus light_trace(const AmbScene *scene, const LightTraceParams *params, Job *job,
                      LightField *out_field) {
    memset(out_field, 0, sizeof *out_field);
    Tracer tracer = {.scene = scene, .params = params, .job = job};
    const uint64_t chunk_count = params->ray_count / GRAIN + (params->ray_count % GRAIN != 0);
    tracer.chunks = memory_zero_array(chunk_count, sizeof(Chunk));
    out_field->objects = memory_zero_array(scene->object_count, sizeof(LightBeams));
    out_field->object_count = scene->object_count;
    AmbStatus status = AMB_OK;
    if (tracer.chunks == NULL || out_field->objects == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the light pass");
    if (status == AMB_OK)
        status = list_batches(&tracer);
    if (status == AMB_OK && tracer.batch_count > 0) {
        light_batches_share(tracer.batches, tracer.batch_count, params->ray_count);
        atomic_store(&job->work_done, 0);
        atomic_store(&job->work_total, chunk_count);
        status = parallel_for(job, chunk_count, 1, trace_chunk, &tracer);
        out_field->ray_count = params->ray_count;
    }
    if (status == AMB_OK)
        status = gather_chunks(&tracer, chunk_count, out_field);
    if (tracer.chunks != NULL)
        for (uint64_t c = 0; c < chunk_count; ++c) {
            memory_free(tracer.chunks[c].beams);
            memory_free(tracer.chunks[c].owners);
            memory_free(tracer.chunks[c].landings);
        }
    memory_free(tracer.chunks);
    memory_free(tracer.batches);
    if (status != AMB_OK)
        light_field_clear(out_field);
    return status;
}

void light_field_clear(LightField *field) {
    if (field->objects != NULL)
        for (uint32_t o = 0; o < field->object_count; ++o)
            memory_free(field->objects[o].beams);
    memory_free(field->objects);
    memory_free(field->landings);
    memset(field, 0, sizeof *field);
}
