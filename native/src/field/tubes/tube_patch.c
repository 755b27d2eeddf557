/* SPDX-License-Identifier: GPL-3.0-or-later
 * Gathering neighbouring tubes into patches. */
#include "field/tubes/tube_patch.h"

#include <string.h>

#include "base/memory.h"
#include "base/order.h"

enum {
    CHUNK = 4096,     /* tubes that are divided into patches together, at most */
    CELL = 16,        /* neighbours in the order of places that may fill a patch unconnected */
    CORNER_FILL = 13, /* corners beyond which no unconnected tube is added */
    NONE = UINT32_MAX
};

/* Ends of light that differ by less than this share are the same corner: each tube finds them by
 * rays of its own, and in the middle of a gap they may lie anywhere. */
static const float LIMIT_SHARE = 1.0f / 256.0f;

void line_of(Vec3 x, Vec3 w, float out[LINE_AXES]) {
    const Vec3 m = vec3_cross(x, w);
    const float line[LINE_AXES] = {m.x, m.y, m.z, w.x, w.y, w.z};
    memcpy(out, line, sizeof line);
}

static int longest_axis(const LineItem *items, uint64_t count) {
    float low[LINE_AXES], high[LINE_AXES];
    memcpy(low, items[0].place, sizeof low);
    memcpy(high, items[0].place, sizeof high);
    for (uint64_t i = 1; i < count; ++i)
        for (int a = 0; a < LINE_AXES; ++a) {
            low[a] = fminf(low[a], items[i].place[a]);
            high[a] = fmaxf(high[a], items[i].place[a]);
        }
    int axis = 0;
    for (int a = 1; a < LINE_AXES; ++a)
        if (high[a] - low[a] > high[axis] - low[axis])
            axis = a;
    return axis;
}

static bool item_before(const void *first, const void *second, const void *user) {
    const LineItem *a = first, *b = second;
    const int axis = *(const int *)user;
    /* The index breaks ties: equal places must not leave the order to chance. */
    return a->place[axis] < b->place[axis] ||
           (a->place[axis] == b->place[axis] && a->index < b->index);
}

void line_items_divide(LineItem *items, uint64_t count, uint64_t rank) {
    const int axis = longest_axis(items, count);
    order_select(items, sizeof *items, count, rank, item_before, &axis);
}

/* Halves are multiples of the largest full subtree that fits, so that nodes of eight are
 * consecutive and full. */
AmbStatus line_items_sort(LineItem *items, uint64_t count, uint64_t unit, const Job *job) {
    if (count <= unit)
        return AMB_OK;
    if (job_is_cancelled(job))
        return AMB_CANCELLED;
    uint64_t part = unit;
    while (part * 8 < count)
        part *= 8;
    const uint64_t parts = (count + part - 1) / part;
    const uint64_t left = (parts + 1) / 2 * part;
    line_items_divide(items, count, left);
    AMB_TRY(line_items_sort(items, left, unit, job));
    return line_items_sort(items + left, count - left, unit, job);
}

/* A corner of some tubes of a chunk. */
typedef struct ChunkCorner {
    float numbers[CORNER_SIZE];
    float start;
    uint32_t next; /* in its bucket */
} ChunkCorner;

/* A run of tubes near each other, and the patches that they become. */
typedef struct Chunk {
    TubePatch *patches;
    uint8_t *sizes; /* tubes of each patch */
    uint32_t patch_count;
} Chunk;

typedef struct Divider {
    const Tube *tubes;
    LineItem *items;
    uint64_t tube_count;
    uint32_t *order; /* out: tube of each rank */
    Chunk *chunks;
    uint64_t chunk_count; /* a power of two */
    uint64_t run_count;   /* of the level of halves in work */
    Job *job;
} Divider;

/* First tube of chunk c. */
static uint64_t chunk_begin(const Divider *divider, uint64_t c) {
    return divider->tube_count * c / divider->chunk_count;
}

/* What growing patches in one chunk needs, in arrays of the chunk's size. */
typedef struct Grower {
    const Tube *tubes;     /* all */
    const LineItem *items; /* of the chunk, sorted */
    uint32_t count;        /* items */
    uint32_t (*corners)[3];
    ChunkCorner *pool;
    uint32_t corner_count;
    uint32_t *first_of_corner, *tubes_of_corner; /* which items have a corner */
    bool *is_used;
} Grower;

static uint32_t hash_corner(const ChunkCorner *corner) {
    uint64_t hash = 0;
    for (int i = 0; i <= CORNER_VALUE; ++i) {
        uint32_t bits;
        memcpy(&bits, &corner->numbers[i], sizeof bits);
        hash = (hash ^ bits) * UINT64_C(0x9E3779B97F4A7C15);
        hash ^= hash >> 29;
    }
    return (uint32_t)hash;
}

static bool is_same_corner(const ChunkCorner *a, const ChunkCorner *b) {
    for (int i = 0; i <= CORNER_VALUE; ++i)
        if (a->numbers[i] != b->numbers[i])
            return false;
    const float limit = b->numbers[CORNER_LIMIT];
    return a->start == b->start && fabsf(a->numbers[CORNER_LIMIT] - limit) <= LIMIT_SHARE * limit;
}

static ChunkCorner corner_of(const Tube *tube, int k) {
    const Vec3 x = tube->x[k], w = tube->w[k];
    return (ChunkCorner){
        {x.x, x.y, x.z, w.x, w.y, w.z, tube->value[k], tube->limit[k]}, tube->start[k], NONE};
}

/* Numbers the corners of a chunk, equal ones alike. buckets: a power of two of them. */
static void number_corners(Grower *grower, uint32_t *buckets, uint32_t bucket_count) {
    memset(buckets, 0xFF, bucket_count * sizeof *buckets);
    for (uint32_t i = 0; i < grower->count; ++i)
        for (int k = 0; k < 3; ++k) {
            ChunkCorner corner = corner_of(&grower->tubes[grower->items[i].index], k);
            uint32_t *bucket = &buckets[hash_corner(&corner) & (bucket_count - 1)];
            uint32_t c = *bucket;
            while (c != NONE && !is_same_corner(&corner, &grower->pool[c]))
                c = grower->pool[c].next;
            if (c == NONE) {
                c = grower->corner_count++;
                corner.next = *bucket;
                grower->pool[c] = corner;
                *bucket = c;
            }
            grower->corners[i][k] = c;
        }
}

static void list_tubes_of_corners(Grower *grower) {
    uint32_t *first = grower->first_of_corner;
    memset(first, 0, (grower->corner_count + 1) * sizeof *first);
    for (uint32_t i = 0; i < grower->count; ++i)
        for (int k = 0; k < 3; ++k)
            ++first[grower->corners[i][k] + 1];
    for (uint32_t c = 0; c < grower->corner_count; ++c)
        first[c + 1] += first[c];
    for (uint32_t i = grower->count; i-- > 0;)
        for (int k = 0; k < 3; ++k)
            grower->tubes_of_corner[--first[grower->corners[i][k] + 1]] = i;
    /* Each entry but the first has moved back to where its corner's list begins. */
    memmove(first, first + 1, grower->corner_count * sizeof *first);
    first[grower->corner_count] = 3 * grower->count;
}

/* A patch while it grows. */
typedef struct Growth {
    uint32_t corners[PATCH_CORNERS], corner_count;
    uint32_t items[PATCH_TUBES], item_count;
} Growth;

static uint32_t find_corner(const Growth *growth, uint32_t corner) {
    uint32_t c = 0;
    while (c < growth->corner_count && growth->corners[c] != corner)
        ++c;
    return c;
}

static uint32_t missing_corners(const Grower *grower, const Growth *growth, uint32_t item) {
    uint32_t missing = 0;
    for (int k = 0; k < 3; ++k)
        missing += find_corner(growth, grower->corners[item][k]) == growth->corner_count;
    return missing;
}

static void add_item(Grower *grower, Growth *growth, uint32_t item) {
    for (int k = 0; k < 3; ++k) {
        const uint32_t c = find_corner(growth, grower->corners[item][k]);
        if (c == growth->corner_count)
            growth->corners[growth->corner_count++] = grower->corners[item][k];
    }
    growth->items[growth->item_count++] = item;
    grower->is_used[item] = true;
}

static float distance2(const LineItem *a, const LineItem *b) {
    float sum = 0.0f;
    for (int i = 0; i < LINE_AXES; ++i)
        sum += (a->place[i] - b->place[i]) * (a->place[i] - b->place[i]);
    return sum;
}

/* The unused tube that touches the patch, needs the fewest corners more, and is nearest to where
 * the patch began. */
static uint32_t best_neighbour(const Grower *grower, const Growth *growth) {
    uint32_t best = NONE, best_missing = 3;
    float best_distance = INFINITY;
    for (uint32_t c = 0; c < growth->corner_count; ++c) {
        const uint32_t corner = growth->corners[c];
        for (uint32_t i = grower->first_of_corner[corner]; i < grower->first_of_corner[corner + 1];
             ++i) {
            const uint32_t item = grower->tubes_of_corner[i];
            if (grower->is_used[item])
                continue;
            const uint32_t missing = missing_corners(grower, growth, item);
            const float distance =
                distance2(&grower->items[item], &grower->items[growth->items[0]]);
            if (missing < best_missing || (missing == best_missing && distance < best_distance)) {
                best = item;
                best_missing = missing;
                best_distance = distance;
            }
        }
    }
    return growth->corner_count + best_missing <= PATCH_CORNERS ? best : NONE;
}

static uint32_t next_in_cell(const Grower *grower, uint32_t seed) {
    const uint32_t end = seed / CELL * CELL + CELL;
    for (uint32_t i = seed + 1; i < end && i < grower->count; ++i)
        if (!grower->is_used[i])
            return i;
    return NONE;
}

/* The ball around the middle of the corners' box, made a little larger against rounding. */
static void bound_patch(TubePatch *patch, uint32_t corner_count) {
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY), high = vec3_negate(low);
    for (uint32_t c = 0; c < corner_count; ++c) {
        const Vec3 x = vec3_from(patch->corners[c] + CORNER_X);
        low = vec3_min(low, x);
        high = vec3_max(high, x);
    }
    patch->center = vec3_scale(vec3_add(low, high), 0.5f);
    patch->radius = 1.0001f * 0.5f * vec3_length(vec3_sub(high, low));
}

static void write_patch(const Grower *grower, const Growth *growth, TubePatch *patch) {
    memset(patch, 0, sizeof *patch);
    for (uint32_t c = 0; c < growth->corner_count; ++c) {
        const ChunkCorner *corner = &grower->pool[growth->corners[c]];
        memcpy(patch->corners[c], corner->numbers, sizeof corner->numbers);
        patch->starts[c] = corner->start;
        float line[LINE_AXES];
        line_of(vec3_from(corner->numbers + CORNER_X), vec3_from(corner->numbers + CORNER_W), line);
        for (int a = 0; a < LINE_AXES; ++a)
            patch->lines[a][c] = line[a];
    }
    bound_patch(patch, growth->corner_count);
    for (uint32_t i = 0; i < growth->item_count; ++i) {
        const uint32_t item = growth->items[i];
        uint32_t corners[3];
        for (int k = 0; k < 3; ++k) {
            corners[k] = find_corner(growth, grower->corners[item][k]);
            patch->masks[i] |= (uint16_t)(1u << corners[k]);
        }
        patch->codes[i] = tube_code(corners, grower->tubes[grower->items[item].index].bulge);
        patch->bulge = fmaxf(patch->bulge, tube_code_bulge(patch->codes[i]));
    }
}

static void grow_patches(Grower *grower, Chunk *chunk, uint32_t *order) {
    for (uint32_t seed = 0; seed < grower->count; ++seed) {
        if (grower->is_used[seed])
            continue;
        Growth growth = {.corner_count = 0};
        add_item(grower, &growth, seed);
        while (growth.item_count < PATCH_TUBES) {
            uint32_t item = best_neighbour(grower, &growth);
            if (item == NONE && growth.corner_count <= CORNER_FILL)
                item = next_in_cell(grower, seed);
            if (item == NONE)
                break;
            add_item(grower, &growth, item);
        }
        write_patch(grower, &growth, &chunk->patches[chunk->patch_count]);
        chunk->sizes[chunk->patch_count++] = (uint8_t)growth.item_count;
        for (uint32_t i = 0; i < growth.item_count; ++i)
            *order++ = grower->items[growth.items[i]].index;
    }
}

static AmbStatus no_memory(void) {
    return status_fail(AMB_OUT_OF_MEMORY, "no memory for patches of light tubes");
}

/* Keeps what is used of the room for one patch a tube. */
static AmbStatus shrink_chunk(Chunk *chunk) {
    TubePatch *patches = memory_alloc_array(chunk->patch_count, sizeof *patches);
    if (patches == NULL)
        return no_memory();
    memcpy(patches, chunk->patches, chunk->patch_count * sizeof *patches);
    memory_free(chunk->patches);
    chunk->patches = patches;
    return AMB_OK;
}

static AmbStatus divide_chunk(const Divider *divider, uint64_t c) {
    Chunk *chunk = &divider->chunks[c];
    const uint64_t begin = chunk_begin(divider, c);
    const uint32_t count = (uint32_t)(chunk_begin(divider, c + 1) - begin);
    AMB_TRY(line_items_sort(divider->items + begin, count, CELL, divider->job));
    uint32_t bucket_count = 8;
    while (bucket_count < 2 * count)
        bucket_count *= 2;
    Grower grower = {.tubes = divider->tubes,
                     .items = divider->items + begin,
                     .count = count,
                     .corners = memory_alloc_array(count, sizeof *grower.corners),
                     .pool = memory_alloc_array(3 * count, sizeof *grower.pool),
                     .first_of_corner = memory_alloc_array(3 * count + 1, sizeof(uint32_t)),
                     .tubes_of_corner = memory_alloc_array(3 * count, sizeof(uint32_t)),
                     .is_used = memory_zero_array(count, sizeof(bool))};
    uint32_t *buckets = memory_alloc_array(bucket_count, sizeof *buckets);
    chunk->patches = memory_alloc_array(count, sizeof *chunk->patches);
    chunk->sizes = memory_alloc_array(count, sizeof *chunk->sizes);
    AmbStatus status = AMB_OK;
    if (grower.corners == NULL || grower.pool == NULL || grower.first_of_corner == NULL ||
        grower.tubes_of_corner == NULL || grower.is_used == NULL || buckets == NULL ||
        chunk->patches == NULL || chunk->sizes == NULL) {
        status = no_memory();
    } else {
        number_corners(&grower, buckets, bucket_count);
        list_tubes_of_corners(&grower);
        grow_patches(&grower, chunk, divider->order + begin);
        status = shrink_chunk(chunk);
    }
    memory_free(grower.corners);
    memory_free(grower.pool);
    memory_free(grower.first_of_corner);
    memory_free(grower.tubes_of_corner);
    memory_free(grower.is_used);
    memory_free(buckets);
    return status;
}

static AmbStatus divide_chunks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Divider *divider = user;
    for (uint64_t c = begin; c < end; ++c)
        AMB_TRY(divide_chunk(divider, c));
    return AMB_OK;
}

static AmbStatus halve_runs(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Divider *divider = user;
    const uint64_t chunks = divider->chunk_count / divider->run_count; /* in a run, even */
    for (uint64_t run = begin; run < end; ++run) {
        if (job_is_cancelled(divider->job))
            return AMB_CANCELLED;
        const uint64_t first = chunk_begin(divider, run * chunks);
        const uint64_t middle = chunk_begin(divider, run * chunks + chunks / 2);
        const uint64_t last = chunk_begin(divider, (run + 1) * chunks);
        line_items_divide(divider->items + first, last - first, middle - first);
    }
    return AMB_OK;
}

static AmbStatus join_chunks(const Divider *divider, TubePatches *out) {
    for (uint64_t c = 0; c < divider->chunk_count; ++c)
        out->count += divider->chunks[c].patch_count;
    out->patches = memory_alloc_array(out->count, sizeof *out->patches);
    out->first = memory_alloc_array(out->count + 1, sizeof *out->first);
    if (out->patches == NULL || out->first == NULL)
        return no_memory();
    uint64_t p = 0, tube = 0;
    for (uint64_t c = 0; c < divider->chunk_count; ++c) {
        const Chunk *chunk = &divider->chunks[c];
        for (uint32_t i = 0; i < chunk->patch_count; ++i) {
            out->patches[p] = chunk->patches[i];
            out->first[p++] = tube;
            tube += chunk->sizes[i];
        }
    }
    out->first[p] = tube;
    return AMB_OK;
}

static AmbStatus divide(Divider *divider, float radius) {
    for (uint64_t i = 0; i < divider->tube_count; ++i) {
        LineItem *item = &divider->items[i];
        *item = (LineItem){.index = (uint32_t)i};
        for (int k = 0; k < 3; ++k) {
            float line[LINE_AXES];
            line_of(divider->tubes[i].x[k], divider->tubes[i].w[k], line);
            for (int a = 0; a < LINE_AXES; ++a)
                item->place[a] += a < 3 ? line[a] / radius : line[a];
        }
    }
    for (divider->run_count = 1; divider->run_count < divider->chunk_count; divider->run_count *= 2)
        AMB_TRY(parallel_for(divider->job, divider->run_count, 1, halve_runs, divider));
    return parallel_for(divider->job, divider->chunk_count, 1, divide_chunks, divider);
}

AmbStatus tube_patches_build(const Tube *tubes, uint64_t tube_count, float radius, Job *job,
                             TubePatches *out) {
    memset(out, 0, sizeof *out);
    if (tube_count > INT32_MAX)
        return status_fail(AMB_OUT_OF_MEMORY, "%llu light tubes are too many",
                           (unsigned long long)tube_count);
    Divider divider = {.tubes = tubes, .tube_count = tube_count, .chunk_count = 1, .job = job};
    while (divider.chunk_count * CHUNK < tube_count)
        divider.chunk_count *= 2;
    out->order = memory_alloc_array(tube_count, sizeof *out->order);
    divider.order = out->order;
    divider.items = memory_alloc_array(tube_count, sizeof *divider.items);
    divider.chunks = memory_zero_array(divider.chunk_count, sizeof *divider.chunks);
    AmbStatus status;
    if (divider.order != NULL && divider.items != NULL && divider.chunks != NULL) {
        status = divide(&divider, radius);
        if (status == AMB_OK)
            status = join_chunks(&divider, out);
    } else {
        status = no_memory();
    }
    for (uint64_t c = 0; divider.chunks != NULL && c < divider.chunk_count; ++c) {
        memory_free(divider.chunks[c].patches);
        memory_free(divider.chunks[c].sizes);
    }
    memory_free(divider.chunks);
    memory_free(divider.items);
    if (status != AMB_OK)
        tube_patches_clear(out);
    return status;
}

void tube_patches_clear(TubePatches *patches) {
    memory_free(patches->patches);
    memory_free(patches->first);
    memory_free(patches->order);
    memset(patches, 0, sizeof *patches);
}
