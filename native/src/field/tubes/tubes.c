/* SPDX-License-Identifier: GPL-3.0-or-later
 * The trees of light tubes in one object. */
#include "field/tubes/tubes.h"

#include <string.h>

#include "base/memory.h"
#include "field/tubes/tube_cut.h"
#include "field/tubes/tube_gather.h"
#include "field/tubes/tube_source.h"

/* Reflected tubes of an object, apart from four for each triangle. */
enum { REFLECTED_MAX = 1 << 17 };

/* Next to where the zero curve is tangent to a caustic's, f is small and flat: the chord of a
 * triangle means nothing there, and that is where most of the error is made. Where f is bent by
 * more than this part of its range over the corners, a tube is looked at more closely; every
 * refinement halves it. */
static const float BEND_MAX = 0.1f;

static void add_tallies(const Cutter *cutter, uint64_t chunk_count, TubeCount *count) {
    for (uint64_t c = 0; c < chunk_count; ++c) {
        const TubeCount *part = &cutter->chunks[c].tally;
        scene_leaks_add(&count->leaks, part->leaks.count, part->leaks.object);
        for (int k = 0; k < 3; ++k) {
            count->tally.incident[k] += part->tally.incident[k];
            count->tally.entered[k] += part->tally.entered[k];
            count->tally.interacting[k] += part->tally.interacting[k];
        }
    }
}

/* The tubes of one tree: of one source through one material, or reflected with one color. */
typedef struct TreeGroup {
    uint32_t source, material;
    Rgb color;
    uint64_t tube_count;
} TreeGroup;

static bool is_in_group(const TreeGroup *group, uint32_t source, const CutTube *tube) {
    if (group->source != source || group->material != tube->material)
        return false;
    return tube->material != TUBE_REFLECTED ||
           (group->color.r == tube->color.r && group->color.g == tube->color.g &&
            group->color.b == tube->color.b);
}

typedef struct TreeGroups {
    TreeGroup *groups;
    uint32_t count, room;
} TreeGroups;

static AmbStatus add_group(TreeGroups *list, uint32_t source, const CutTube *tube) {
    if (list->count == list->room) {
        const uint32_t room = 2 * list->room + 8;
        TreeGroup *groups = memory_alloc_array(room, sizeof *groups);
        if (groups == NULL)
            return status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
        if (list->count > 0)
            memcpy(groups, list->groups, list->count * sizeof *groups);
        memory_free(list->groups);
        list->groups = groups;
        list->room = room;
    }
    list->groups[list->count++] = (TreeGroup){source, tube->material, tube->color, 0};
    return AMB_OK;
}

/* In the order in which their first tubes come, which threads do not change. */
static AmbStatus list_groups(const Cutter *cutter, uint64_t chunk_count, TreeGroups *out) {
    for (uint64_t c = 0; c < chunk_count; ++c) {
        const TubeChunk *chunk = &cutter->chunks[c];
        const uint32_t source = (uint32_t)(c / cutter->triangle_chunks);
        for (uint64_t i = 0; i < chunk->count; ++i) {
            uint32_t g = out->count;
            while (g > 0 && !is_in_group(&out->groups[g - 1], source, &chunk->tubes[i]))
                --g;
            if (g == 0) {
                AMB_TRY(add_group(out, source, &chunk->tubes[i]));
                g = out->count;
            }
            ++out->groups[g - 1].tube_count;
        }
    }
    return AMB_OK;
}

static void select_tubes(const Cutter *cutter, const TreeGroup *group, Tube *tubes) {
    uint64_t count = 0;
    for (uint64_t c = 0; c < cutter->triangle_chunks; ++c) {
        const TubeChunk *chunk = &cutter->chunks[group->source * cutter->triangle_chunks + c];
        for (uint64_t i = 0; i < chunk->count; ++i)
            if (is_in_group(group, group->source, &chunk->tubes[i]))
                tubes[count++] = chunk->tubes[i].tube;
    }
}

static TubeLight tube_light(const Cutter *cutter, const TreeGroup *group) {
    if (group->material == TUBE_REFLECTED)
        return (TubeLight){.color = group->color, .value = TUBE_VALUE_IS_FLUX, .eta = 1.0f};
    const TubeSource *source = &cutter->sources[group->source];
    const SceneLight *light = &source->light;
    const SceneMaterial *material = &cutter->scene->materials[group->material];
    const Vec3 center = cutter->scene->objects[cutter->object].center;
    const bool is_sun = light->kind == AMB_LIGHT_SUN;
    return (TubeLight){.color = rgb_mul(light->color, material->transmit_color),
                       .value =
                           cutter->params->adjoint_normals ? TUBE_VALUE_LEAVES : TUBE_VALUE_ARRIVES,
                       .is_directional = is_sun,
                       .origin = is_sun ? light->direction : vec3_sub(light->position, center),
                       .extent = {source->extent[0], source->extent[1]},
                       .eta = 1.0f / material->ior};
}

static AmbStatus build_tree(const Cutter *cutter, const TreeGroup *group, TubeField *out_tubes) {
    const uint64_t count = group->tube_count;
    Tube *tubes = memory_alloc_array(count, sizeof *tubes);
    if (tubes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %llu light tubes",
                           (unsigned long long)count);
    select_tubes(cutter, group, tubes);
    const SceneObject *body = &cutter->scene->objects[cutter->object];
    const TubeLight properties = tube_light(cutter, group);
    TubeTree *tree = &out_tubes->trees[out_tubes->tree_count];
    const AmbStatus status =
        tube_tree_build(tubes, count, &properties, body->center, body->radius, cutter->job, tree);
    memory_free(tubes);
    AMB_TRY(status);
    tree->bend_max = ldexpf(BEND_MAX, -cutter->params->refinement);
    out_tubes->tube_count += count;
    ++out_tubes->tree_count;
    return AMB_OK;
}

static AmbStatus build_trees(const Cutter *cutter, uint64_t chunk_count, TubeField *out_tubes) {
    TreeGroups list = {.groups = NULL};
    AmbStatus status = list_groups(cutter, chunk_count, &list);
    if (status == AMB_OK && list.count > 0) {
        out_tubes->trees = memory_zero_array(list.count, sizeof(TubeTree));
        if (out_tubes->trees == NULL)
            status = status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
    }
    for (uint32_t g = 0; g < list.count && status == AMB_OK; ++g)
        status = build_tree(cutter, &list.groups[g], out_tubes);
    memory_free(list.groups);
    return status;
}

static void clear_chunks(const Cutter *cutter, uint64_t chunk_count) {
    for (uint64_t c = 0; c < chunk_count; ++c)
        memory_free(cutter->chunks[c].tubes);
    memset(cutter->chunks, 0, chunk_count * sizeof *cutter->chunks);
}

/* All tubes; again and coarser, as long as too many are reflected. */
static AmbStatus cut_all(Cutter *cutter, uint64_t chunk_count) {
    for (;; ++cutter->coarseness) {
        atomic_store(cutter->reflected_count, 0);
        const AmbStatus status = parallel_for(cutter->job, chunk_count, 1, tube_cut_chunks, cutter);
        if (atomic_load(cutter->reflected_count) <= cutter->reflected_max ||
            cutter->coarseness == TUBE_COARSENESS_MAX || job_is_cancelled(cutter->job))
            return status;
        clear_chunks(cutter, chunk_count);
    }
}

static AmbStatus cut_and_build(Cutter *cutter, TubeCount *count, TubeField *out_tubes) {
    const uint64_t chunk_count = cutter->triangle_chunks * cutter->source_count;
    cutter->chunks = memory_zero_array(chunk_count, sizeof(TubeChunk));
    if (cutter->chunks == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for light tubes");
    AmbStatus status = cut_all(cutter, chunk_count);
    if (status == AMB_OK) {
        add_tallies(cutter, chunk_count, count);
        status = build_trees(cutter, chunk_count, out_tubes);
    }
    clear_chunks(cutter, chunk_count);
    memory_free(cutter->chunks);
    return status;
}

AmbStatus tubes_build(const AmbScene *scene, uint32_t object, const TubeParams *params, Job *job,
                      TubeCount *count, TubeField *out_tubes) {
    memset(out_tubes, 0, sizeof *out_tubes);
    const SceneObject *body = &scene->objects[object];
    const uint64_t triangles = scene->meshes[body->mesh].triangle_count;
    TubeSource *sources = NULL;
    atomic_uint_least64_t reflected_count = 0;
    Cutter cutter = {.scene = scene,
                     .params = params,
                     .job = job,
                     .triangle_chunks = triangles / TUBE_CHUNK_TRIANGLES + 1,
                     .object = object,
                     .reflected_count = &reflected_count};
    AMB_TRY(tube_sources_create(scene, object, &sources, &cutter.source_count));
    cutter.sources = sources;
    cutter.reflected_max = REFLECTED_MAX + 4 * triangles * cutter.source_count;
    const AmbStatus status =
        cutter.source_count > 0 ? cut_and_build(&cutter, count, out_tubes) : AMB_OK;
    memory_free(sources);
    if (status != AMB_OK)
        tubes_clear(out_tubes);
    else
        out_tubes->medium = scene->materials[body->inside].medium;
    return status;
}

void tubes_clear(TubeField *tubes) {
    for (uint32_t i = 0; i < tubes->tree_count; ++i)
        tube_tree_clear(&tubes->trees[i]);
    memory_free(tubes->trees);
    memset(tubes, 0, sizeof *tubes);
}

uint64_t tubes_bytes(const TubeField *tubes) {
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < tubes->tree_count; ++i)
        bytes += tube_tree_bytes(&tubes->trees[i]);
    return bytes;
}

static bool is_reflected(const TubeTree *tree) {
    return tree->light.value == TUBE_VALUE_IS_FLUX;
}

uint64_t tubes_reflected_bytes(const TubeField *tubes) {
    uint64_t bytes = 0;
    for (uint32_t i = 0; i < tubes->tree_count; ++i)
        if (is_reflected(&tubes->trees[i]))
            bytes += tube_tree_bytes(&tubes->trees[i]);
    return bytes;
}

/* Adds what trees of one kind send, and what of it was reflected: of that the rays that want it.
 */
static void gather_kind(const TubeField *tubes, const TubeRay all[], uint32_t all_count,
                        bool reflected, FieldRadiance out[]) {
    const TubeGather gather = tube_gather_select();
    TubeRay rays[TUBE_PACKET];
    uint32_t owners[TUBE_PACKET], count = 0;
    for (uint32_t r = 0; r < all_count; ++r)
        if (!reflected || all[r].reflected > 0.0f) {
            rays[count] = all[r];
            owners[count++] = r;
        }
    if (count == 0)
        return;
    for (uint32_t i = 0; i < tubes->tree_count; ++i) {
        if (is_reflected(&tubes->trees[i]) != reflected)
            continue;
        FieldRadiance parts[TUBE_PACKET];
        gather(&tubes->trees[i], &tubes->medium, rays, count, parts);
        for (uint32_t r = 0; r < count; ++r) {
            if (reflected) {
                parts[r] = field_radiance_scale(parts[r], rays[r].reflected);
                parts[r].reflected = parts[r].radiance;
            }
            out[owners[r]] = field_radiance_add(out[owners[r]], parts[r]);
        }
    }
}

void tubes_gather(const TubeField *tubes, const TubeRay rays[], uint32_t count, FieldTimes *times,
                  FieldRadiance out[]) {
    memset(out, 0, count * sizeof *out);
    for (uint32_t begin = 0; begin < count; begin += TUBE_PACKET) {
        const uint32_t size = count - begin < TUBE_PACKET ? count - begin : TUBE_PACKET;
        gather_kind(tubes, rays + begin, size, false, out + begin);
        const double start = times != NULL ? clock_thread_cpu() : 0.0;
        gather_kind(tubes, rays + begin, size, true, out + begin);
        if (times != NULL)
            times->reflected += clock_thread_cpu() - start;
    }
}
