/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons walk, cells keep what they bring. */
#include "field/scatter/scatter.h"

#include <string.h>

#include "base/memory.h"
#include "field/scatter/photon_walk.h"
#include "field/scatter/scatter_cells.h"
#include "field/scatter/tree_cut.h"

struct Scatter {
    uint32_t object_count;
    ScatterCells *cells;                       /* by object; photons */
    TreeCut *cut;                              /* [Wang16], else NULL */
    PhotonLandings landings[SCATTER_LIST_MAX]; /* by bank */
    ScatterTally tally;
};

/* Photons are divided among so many sums, whatever the number of threads, and these are added in
 * their order: the same bits. Fewer where cells are large. */
enum { BANK_COUNT_MAX = SCATTER_LIST_MAX, BANK_BYTES_MAX = 1 << 30 };

typedef struct Bank {
    float **moments; /* by object */
    ScatterTally tally;
} Bank;

/* The first scattering is the light field's: the second is the first that cells keep, and in thin
 * media the rarest. At an optical radius of 0.1 this leaves a twelfth of the variance for three
 * times the time, at 0.5 a third for 1.7 times. */
enum { FORCED = 2 };

typedef struct Trace {
    PhotonWalk walk;
    Job *job;
    Bank banks[BANK_COUNT_MAX];
    uint32_t bank_count;
    Scatter *scatter;
} Trace;

/* Moments between two looks at whether the job is cancelled: what a millisecond or two write. */
enum { PIECE = 1 << 20 };

/* Pages of a gigabyte take a second to come. */
static AmbStatus clear_bank(const Trace *trace, const Bank *bank) {
    for (uint32_t o = 0; o < trace->scatter->object_count; ++o) {
        const ScatterCells *cells = &trace->scatter->cells[o];
        const uint64_t count = cells->cell_count * cells->float_count;
        for (uint64_t i = 0; i < count; i += PIECE) {
            if (job_is_cancelled(trace->job))
                return AMB_CANCELLED;
            const uint64_t left = count - i;
            memset(bank->moments[o] + i, 0, (left < PIECE ? left : PIECE) * sizeof(float));
        }
    }
    return AMB_OK;
}

static AmbStatus trace_bank(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    Trace *trace = user;
    for (uint64_t b = begin; b < end; ++b) {
        Bank *bank = &trace->banks[b];
        uint32_t unreported = 0;
        AMB_TRY(clear_bank(trace, bank));
        for (uint64_t i = b; i < trace->walk.source->photon_count; i += trace->bank_count) {
            if (job_is_cancelled(trace->job))
                return AMB_CANCELLED;
            PhotonLandings *landings = &trace->scatter->landings[b];
            photon_walk(&trace->walk, i, bank->moments, landings, &bank->tally);
            if (landings->is_cut_short)
                return status_fail(AMB_OUT_OF_MEMORY, "no memory for light on opaque surfaces");
            if (++unreported == 256) {
                atomic_fetch_add(&trace->job->work_done, unreported);
                unreported = 0;
            }
        }
    }
    return AMB_OK;
}

/* ---- Cells ----------------------------------------------------------------------------------- */

/* Radius of the sphere of the object's area, m. */
static float area_radius(const AmbScene *scene, uint32_t object) {
    const SceneObject *shape = &scene->objects[object];
    const SceneMesh *mesh = &scene->meshes[shape->mesh];
    double area = 0.0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *i = mesh->triangles + 3 * t;
        const Vec3 a = shape->positions[i[0]];
        area += 0.5 * (double)vec3_length(vec3_cross(vec3_sub(shape->positions[i[1]], a),
                                                     vec3_sub(shape->positions[i[2]], a)));
    }
    return sqrtf((float)area / (4.0f * AMB_PI));
}

/* Edge of the cubes. n photons leave a variance of 1/(n size^2) and the size a bias of size^2: the
 * sum of squares is least for n^(-1/6), on the bumpy sphere with this factor. */
static float cube_size(const AmbScene *scene, uint32_t object, uint64_t photon_count) {
    return 0.7f * area_radius(scene, object) / powf((float)photon_count, 1.0f / 6.0f);
}

static AmbStatus build_cells(const AmbScene *scene, const ScatterParams *params,
                             const PhotonSource *source, Job *job, Scatter *scatter) {
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        const SceneObject *object = &scene->objects[o];
        const Medium *medium = &scene->materials[object->inside].medium;
        if (!object->is_boundary || !medium_scatters(medium))
            continue;
        const uint64_t own = photon_source_count(source, o);
        AMB_TRY(scatter_cells_build(scene, o, cube_size(scene, o, own > 0 ? own : 1),
                                    params->has_world ? 3 : 2, job, &scatter->cells[o]));
    }
    return AMB_OK;
}

static AmbStatus create_banks(const AmbScene *scene, Trace *trace) {
    uint64_t bytes = 0;
    for (uint32_t o = 0; o < scene->object_count; ++o)
        bytes += trace->scatter->cells[o].cell_count * trace->scatter->cells[o].float_count * 4;
    const uint64_t fitting = BANK_BYTES_MAX / (bytes + 1);
    const uint32_t wanted = trace->walk.params->sum_count;
    const uint32_t most = wanted > 0 && wanted < BANK_COUNT_MAX ? wanted : BANK_COUNT_MAX;
    trace->bank_count = fitting > most ? most : fitting > 1 ? (uint32_t)fitting : 1;
    for (uint32_t b = 0; b < trace->bank_count; ++b) {
        Bank *bank = &trace->banks[b];
        bank->moments = memory_zero_array(scene->object_count, sizeof *bank->moments);
        if (bank->moments == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
        for (uint32_t o = 0; o < scene->object_count; ++o) {
            const ScatterCells *cells = &trace->scatter->cells[o];
            bank->moments[o] =
                memory_alloc_array(cells->cell_count * cells->float_count, sizeof(float));
            if (bank->moments[o] == NULL)
                return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
        }
    }
    return AMB_OK;
}

static void destroy_banks(Trace *trace) {
    for (uint32_t b = 0; b < trace->bank_count; ++b) {
        float **moments = trace->banks[b].moments;
        for (uint32_t o = 0; moments != NULL && o < trace->scatter->object_count; ++o)
            memory_free(moments[o]);
        memory_free(moments);
    }
}

/* Of one object. */
typedef struct BankSum {
    const Trace *trace;
    uint32_t object;
} BankSum;

/* The first bank becomes the sum of all, in their order. */
static AmbStatus sum_moments(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const BankSum *sum = user;
    const Bank *banks = sum->trace->banks;
    float *first = banks[0].moments[sum->object];
    for (uint32_t b = 1; b < sum->trace->bank_count; ++b)
        for (uint64_t i = begin; i < end; ++i)
            first[i] += banks[b].moments[sum->object][i];
    return AMB_OK;
}

static AmbStatus sum_banks(Trace *trace) {
    Scatter *scatter = trace->scatter;
    for (uint32_t o = 0; o < scatter->object_count; ++o) {
        ScatterCells *cells = &scatter->cells[o];
        BankSum sum = {trace, o};
        AMB_TRY(parallel_for(trace->job, cells->cell_count * cells->float_count, PIECE, sum_moments,
                             &sum));
        cells->moments = trace->banks[0].moments[o];
        trace->banks[0].moments[o] = NULL;
    }
    for (uint32_t b = 0; b < trace->bank_count; ++b) {
        const ScatterTally *tally = &trace->banks[b].tally;
        scatter->tally.photon_count += tally->photon_count;
        scatter->tally.collision_count += tally->collision_count;
        for (int k = 0; k < 3; ++k) {
            scatter->tally.entered[k] += tally->entered[k];
            scatter->tally.absorbed[k] += tally->absorbed[k];
            scatter->tally.escaped[k] += tally->escaped[k];
            scatter->tally.lost[k] += tally->lost[k];
        }
    }
    return AMB_OK;
}

/* ---- The whole ------------------------------------------------------------------------------- */

static AmbStatus run(const AmbScene *scene, const ScatterParams *params, Job *job,
                     Scatter *scatter) {
    PhotonSource source;
    AMB_TRY(photon_source_create(scene, params, &source));
    AmbStatus status = build_cells(scene, params, &source, job, scatter);
    Trace *trace = memory_zero_array(1, sizeof *trace);
    if (status == AMB_OK && trace == NULL) {
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    } else if (status == AMB_OK) {
        trace->walk =
            (PhotonWalk){scene, params, &source, scatter->cells, FORCED, params->landing_part};
        trace->job = job;
        trace->scatter = scatter;
        status = create_banks(scene, trace);
        atomic_store(&job->work_done, 0);
        atomic_store(&job->work_total, source.photon_count);
        if (status == AMB_OK)
            status = parallel_for(job, trace->bank_count, 1, trace_bank, trace);
        if (status == AMB_OK)
            status = sum_banks(trace);
        destroy_banks(trace);
    }
    memory_free(trace);
    photon_source_clear(&source);
    return status;
}

static AmbStatus create_tree_cut(const AmbScene *scene, const ScatterParams *params, Job *job,
                                 Scatter *scatter) {
    const TreeCutParams cut_params = {.light = {.bounces = params->light_bounces,
                                                .follows_through = params->follows_through,
                                                .adjoint_normals = params->adjoint_normals,
                                                .seed = params->seed},
                                      .sample_count = params->photon_count,
                                      .order_max = params->order_max};
    return tree_cut_create(scene, &cut_params, job, &scatter->cut);
}

AmbStatus scatter_create(const AmbScene *scene, const ScatterParams *params, Job *job,
                         Scatter **out_scatter) {
    Scatter *scatter = memory_zero_array(1, sizeof *scatter);
    if (scatter == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    scatter->object_count = scene->object_count;
    scatter->cells = memory_zero_array(scene->object_count, sizeof *scatter->cells);
    AmbStatus status = AMB_OK;
    if (scatter->cells == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for scattered light");
    if (status == AMB_OK && params->uses_tree_cut)
        status = create_tree_cut(scene, params, job, scatter);
    else if (status == AMB_OK)
        status = run(scene, params, job, scatter);
    if (status != AMB_OK) {
        scatter_destroy(scatter);
        return status;
    }
    *out_scatter = scatter;
    return AMB_OK;
}

void scatter_destroy(Scatter *scatter) {
    if (scatter == NULL)
        return;
    for (uint32_t o = 0; scatter->cells != NULL && o < scatter->object_count; ++o)
        scatter_cells_clear(&scatter->cells[o]);
    for (uint32_t i = 0; i < SCATTER_LIST_MAX; ++i)
        memory_free(scatter->landings[i].list);
    memory_free(scatter->cells);
    tree_cut_destroy(scatter->cut);
    memory_free(scatter);
}

ScatterRadiance scatter_gather(const Scatter *scatter, const FieldSegment *segment, Rgb forward,
                               const Sample2 *u) {
    if (scatter->cut != NULL) {
        const TreeCutRadiance radiance = tree_cut_gather(scatter->cut, segment);
        return (ScatterRadiance){.twice = radiance.twice, .more = radiance.more};
    }
    const ScatterCells *cells = &scatter->cells[segment->object];
    if (cells->moments == NULL || cells->layer_count == 0)
        return (ScatterRadiance){.once = {0, 0, 0}};
    return scatter_cells_gather(cells, segment->o, segment->d, segment->length, forward, u);
}

Rgb scatter_forward(const Scatter *scatter, uint32_t object) {
    return scatter->cut == NULL ? scatter->cells[object].forward : rgb(0, 0, 0);
}

void scatter_take_landings(Scatter *scatter, PhotonLandings out_lists[SCATTER_LIST_MAX]) {
    memcpy(out_lists, scatter->landings, sizeof scatter->landings);
    memset(scatter->landings, 0, sizeof scatter->landings);
}

uint64_t scatter_bytes(const Scatter *scatter) {
    uint64_t bytes = scatter->cut != NULL ? tree_cut_bytes(scatter->cut) : 0;
    for (uint32_t o = 0; o < scatter->object_count; ++o)
        bytes += scatter_cells_bytes(&scatter->cells[o]);
    return bytes;
}

uint64_t scatter_cell_count(const Scatter *scatter) {
    uint64_t count = scatter->cut != NULL ? tree_cut_sample_count(scatter->cut) : 0;
    for (uint32_t o = 0; o < scatter->object_count; ++o)
        count += scatter->cells[o].cell_count;
    return count;
}

const ScatterTally *scatter_tally(const Scatter *scatter) {
    return &scatter->tally;
}
