/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over caustic photons. */
#include "field/caustics/caustic_tree.h"

#include <string.h>

#include "base/memory.h"
#include "base/order.h"

enum {
    TOP_LEVELS = 6, /* divided level by level, side by side; below, whole subtrees are */
    AXIS_SIZE = 3
};

/* Of the half-axes of photons that are divided by place. */
static const float SIZE_RANGE = 4.0f;

/* How far off its plane a photon counts, in half-axes: surfaces may bend. */
static const float HEIGHT_MAX = 0.5f;

typedef struct Box {
    Vec3 low, high;
} Box;

/* A subtree to build. Node i over `count` blocks has its left child, over half of them (rounded
 * up), at i + 1, and its right one at i + 2 * that half. */
typedef struct Task {
    uint64_t node, first, count; /* blocks first .. first + count - 1 */
} Task;

typedef struct Builder {
    CausticTree *tree;
    CausticPhoton *photons;
    Box *boxes; /* by node of the binary tree, 2 * blocks - 1 */
    Job *job;
    Task tasks[1 << TOP_LEVELS];
    bool is_top; /* tasks are halved only */
} Builder;

static float component(Vec3 a, int axis) {
    return axis == 0 ? a.x : axis == 1 ? a.y : a.z;
}

/* By place, or by size: the longer half-axis is the shorter covector's. */
static float photon_key(const CausticPhoton *photon, int axis) {
    if (axis < AXIS_SIZE)
        return component(photon->p, axis);
    return 1.0f / fminf(vec3_dot(photon->u, photon->u), vec3_dot(photon->v, photon->v));
}

static bool photon_before(const void *a, const void *b, const void *user) {
    const int axis = *(const int *)user;
    return photon_key(a, axis) < photon_key(b, axis);
}

static uint64_t block_end(const CausticTree *tree, uint64_t block) {
    const uint64_t end = block * CAUSTIC_LANES;
    return end < tree->photon_count ? end : tree->photon_count;
}

/* What photons are halved by. A few wide kernels would widen the boxes of all narrow ones around
 * them: sizes are told apart first. */
static int longest_axis(const CausticPhoton *photons, uint64_t count) {
    Vec3 low = photons[0].p, high = low;
    float least = photon_key(&photons[0], AXIS_SIZE), most = least;
    for (uint64_t i = 1; i < count; ++i) {
        low = vec3_min(low, photons[i].p);
        high = vec3_max(high, photons[i].p);
        const float size = photon_key(&photons[i], AXIS_SIZE);
        least = fminf(least, size);
        most = fmaxf(most, size);
    }
    if (most > SIZE_RANGE * SIZE_RANGE * least)
        return AXIS_SIZE;
    const Vec3 side = vec3_sub(high, low);
    const int axis = side.y > side.x ? 1 : 0;
    return side.z > component(side, axis) ? 2 : axis;
}

static uint64_t left_count(const Task *task) {
    return task->count - task->count / 2;
}

static Task left_task(const Task *task) {
    return (Task){task->node + 1, task->first, left_count(task)};
}

static Task right_task(const Task *task) {
    const uint64_t left = left_count(task);
    return (Task){task->node + 2 * left, task->first + left, task->count - left};
}

static void halve(const Builder *builder, const Task *task) {
    const uint64_t begin = task->first * CAUSTIC_LANES;
    const uint64_t count = block_end(builder->tree, task->first + task->count) - begin;
    CausticPhoton *photons = builder->photons + begin;
    const int axis = longest_axis(photons, count);
    order_select(photons, sizeof *photons, count, left_count(task) * CAUSTIC_LANES, photon_before,
                 &axis);
}

/* Semi-axis vectors of the ellipse from the covectors u, v: the dual basis in the plane. */
static void photon_axes(const CausticPhoton *photon, Vec3 *out_a, Vec3 *out_b) {
    const Vec3 n = photon->n;
    const float scale = 1.0f / vec3_dot(n, vec3_cross(photon->u, photon->v));
    *out_a = vec3_scale(vec3_cross(photon->v, n), scale);
    *out_b = vec3_scale(vec3_cross(n, photon->u), scale);
}

static float photon_height(Vec3 a, Vec3 b) {
    return HEIGHT_MAX * sqrtf(fmaxf(vec3_dot(a, a), vec3_dot(b, b)));
}

static Box photon_box(const CausticPhoton *photon) {
    Vec3 a, b;
    photon_axes(photon, &a, &b);
    const Vec3 n = photon->n;
    const float height = photon_height(a, b);
    /* A little more: rounding must not cut a kernel's edge. */
    const Vec3 reach = vec3(1.0001f * sqrtf(a.x * a.x + b.x * b.x) + height * fabsf(n.x),
                            1.0001f * sqrtf(a.y * a.y + b.y * b.y) + height * fabsf(n.y),
                            1.0001f * sqrtf(a.z * a.z + b.z * b.z) + height * fabsf(n.z));
    return (Box){vec3_sub(photon->p, reach), vec3_add(photon->p, reach)};
}

static Box box_union(Box a, Box b) {
    return (Box){vec3_min(a.low, b.low), vec3_max(a.high, b.high)};
}

static void fill_lane(CausticBlock *block, uint64_t lane, const CausticPhoton *photon) {
    const Vec3 vectors[] = {photon->p, photon->n, photon->u, photon->v};
    float(*rows[])[CAUSTIC_LANES] = {block->p, block->n, block->u, block->v};
    for (int i = 0; i < 4; ++i)
        for (int axis = 0; axis < AXIS_SIZE; ++axis)
            rows[i][axis][lane] = component(vectors[i], axis);
    block->peak[0][lane] = photon->peak.r;
    block->peak[1][lane] = photon->peak.g;
    block->peak[2][lane] = photon->peak.b;
    Vec3 a, b;
    photon_axes(photon, &a, &b);
    const float height = photon_height(a, b);
    block->height2[lane] = height * height;
}

static Box fill_block(const Builder *builder, uint64_t block) {
    CausticTree *tree = builder->tree;
    const CausticPhoton *photons = builder->photons + block * CAUSTIC_LANES;
    const uint64_t count = block_end(tree, block + 1) - block * CAUSTIC_LANES;
    memset(&tree->blocks[block], 0, sizeof tree->blocks[block]);
    Box box = photon_box(&photons[0]);
    for (uint64_t i = 0; i < count; ++i) {
        fill_lane(&tree->blocks[block], i, &photons[i]);
        box = box_union(box, photon_box(&photons[i]));
    }
    return box;
}

static void join(const Builder *builder, const Task *task) {
    builder->boxes[task->node] =
        box_union(builder->boxes[left_task(task).node], builder->boxes[right_task(task).node]);
}

static AmbStatus build_subtree(const Builder *builder, const Task *task) {
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    if (task->count == 1) {
        builder->boxes[task->node] = fill_block(builder, task->first);
        return AMB_OK;
    }
    halve(builder, task);
    const Task left = left_task(task), right = right_task(task);
    AMB_TRY(build_subtree(builder, &left));
    AMB_TRY(build_subtree(builder, &right));
    join(builder, task);
    return AMB_OK;
}

static AmbStatus build_tasks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Builder *builder = user;
    for (uint64_t i = begin; i < end; ++i) {
        const Task *task = &builder->tasks[i];
        if (!builder->is_top)
            AMB_TRY(build_subtree(builder, task));
        else if (task->count > 1)
            halve(builder, task);
    }
    return AMB_OK;
}

static AmbStatus build_all(Builder *builder) {
    Task divided[1 << TOP_LEVELS];
    uint32_t divided_count = 0, count = 1;
    builder->tasks[0] = (Task){0, 0, builder->tree->block_count};
    for (int level = 0; level < TOP_LEVELS; ++level) {
        builder->is_top = true;
        AMB_TRY(parallel_for(builder->job, count, 1, build_tasks, builder));
        Task next[1 << TOP_LEVELS];
        uint32_t next_count = 0;
        for (uint32_t i = 0; i < count; ++i) {
            const Task *task = &builder->tasks[i];
            if (task->count == 1) {
                next[next_count++] = *task;
                continue;
            }
            divided[divided_count++] = *task;
            next[next_count++] = left_task(task);
            next[next_count++] = right_task(task);
        }
        memcpy(builder->tasks, next, next_count * sizeof next[0]);
        count = next_count;
    }
    builder->is_top = false;
    AMB_TRY(parallel_for(builder->job, count, 1, build_tasks, builder));
    while (divided_count > 0)
        join(builder, &divided[--divided_count]);
    return AMB_OK;
}

/* ---- Eight children a node ------------------------------------------------------------------- */

/* What three halvings leave of a subtree. */
static uint32_t child_tasks(const Task *task, Task out[CAUSTIC_LANES]) {
    uint32_t count = 1;
    out[0] = *task;
    for (int level = 0; level < 3; ++level) {
        Task halves[CAUSTIC_LANES];
        uint32_t half_count = 0;
        for (uint32_t i = 0; i < count; ++i) {
            halves[half_count++] = out[i].count > 1 ? left_task(&out[i]) : out[i];
            if (out[i].count > 1)
                halves[half_count++] = right_task(&out[i]);
        }
        memcpy(out, halves, half_count * sizeof halves[0]);
        count = half_count;
    }
    return count;
}

static uint64_t count_nodes(const Task *task) {
    Task children[CAUSTIC_LANES];
    const uint32_t count = child_tasks(task, children);
    uint64_t nodes = 1;
    for (uint32_t i = 0; i < count; ++i)
        nodes += children[i].count > 1 ? count_nodes(&children[i]) : 0;
    return nodes;
}

static void set_box(CausticNode *node, uint32_t lane, const Box *box) {
    for (int axis = 0; axis < AXIS_SIZE; ++axis) {
        node->low[axis][lane] = component(box->low, axis);
        node->high[axis][lane] = component(box->high, axis);
    }
}

static int32_t widen(const Builder *builder, const Task *task) {
    static const Box nowhere = {{INFINITY, INFINITY, INFINITY}, {-INFINITY, -INFINITY, -INFINITY}};
    Task children[CAUSTIC_LANES];
    const uint32_t count = child_tasks(task, children);
    const int32_t index = (int32_t)builder->tree->node_count++;
    CausticNode *node = &builder->tree->nodes[index];
    for (uint32_t i = 0; i < CAUSTIC_LANES; ++i) {
        set_box(node, i, i < count ? &builder->boxes[children[i].node] : &nowhere);
        node->child[i] = i >= count               ? 0
                         : children[i].count == 1 ? ~(int32_t)children[i].first
                                                  : widen(builder, &children[i]);
    }
    return index;
}

static AmbStatus build_wide(const Builder *builder) {
    CausticTree *tree = builder->tree;
    const Task all = {0, 0, tree->block_count};
    tree->nodes = memory_alloc_array(count_nodes(&all), sizeof *tree->nodes);
    if (tree->nodes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of caustic photons");
    widen(builder, &all);
    return AMB_OK;
}

static Rgb photon_flux(const CausticPhoton *photon) {
    const float inverse = vec3_dot(photon->n, vec3_cross(photon->u, photon->v));
    return rgb_scale(photon->peak, 0.5f * AMB_PI / fabsf(inverse));
}

static void sum_flux(const Builder *builder) {
    CausticTree *tree = builder->tree;
    double sum = 0.0;
    for (uint64_t block = 0; block < tree->block_count; ++block) {
        tree->flux[block] = sum;
        for (uint64_t i = block * CAUSTIC_LANES; i < block_end(tree, block + 1); ++i)
            sum += (double)rgb_mean(photon_flux(&builder->photons[i]));
    }
    tree->flux[tree->block_count] = sum;
}

AmbStatus caustic_tree_build(CausticPhoton *photons, uint64_t photon_count, Job *job,
                             CausticTree *out_tree) {
    *out_tree = (CausticTree){.photon_count = photon_count,
                              .block_count = (photon_count + CAUSTIC_LANES - 1) / CAUSTIC_LANES};
    out_tree->blocks = memory_alloc_array(out_tree->block_count, sizeof *out_tree->blocks);
    out_tree->flux = memory_alloc_array(out_tree->block_count + 1, sizeof *out_tree->flux);
    Builder builder = {.tree = out_tree,
                       .photons = photons,
                       .boxes = memory_alloc_array(2 * out_tree->block_count - 1, sizeof(Box)),
                       .job = job};
    AmbStatus status = AMB_OK;
    if (out_tree->blocks == NULL || builder.boxes == NULL || out_tree->flux == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of caustic photons");
    if (status == AMB_OK)
        status = build_all(&builder);
    if (status == AMB_OK)
        status = build_wide(&builder);
    if (status == AMB_OK)
        sum_flux(&builder);
    memory_free(builder.boxes);
    if (status != AMB_OK)
        caustic_tree_clear(out_tree);
    return status;
}

void caustic_tree_clear(CausticTree *tree) {
    memory_free(tree->blocks);
    memory_free(tree->nodes);
    memory_free(tree->flux);
    *tree = (CausticTree){.blocks = NULL};
}

/* The last block whose photons begin no later. */
static uint64_t find_block(const CausticTree *tree, double flux) {
    uint64_t low = 0, high = tree->block_count;
    while (high - low > 1) {
        const uint64_t middle = low + (high - low) / 2;
        if (tree->flux[middle] <= flux)
            low = middle;
        else
            high = middle;
    }
    return low;
}

static CausticPhoton photon_at(const CausticTree *tree, uint64_t i) {
    const CausticBlock *block = &tree->blocks[i / CAUSTIC_LANES];
    const uint64_t k = i % CAUSTIC_LANES;
    return (CausticPhoton){
        .p = vec3(block->p[0][k], block->p[1][k], block->p[2][k]),
        .n = vec3(block->n[0][k], block->n[1][k], block->n[2][k]),
        .u = vec3(block->u[0][k], block->u[1][k], block->u[2][k]),
        .v = vec3(block->v[0][k], block->v[1][k], block->v[2][k]),
        .peak = rgb(block->peak[0][k], block->peak[1][k], block->peak[2][k]),
    };
}

CausticPoint caustic_tree_choose(const CausticTree *tree, double flux, Sample2 place) {
    const uint64_t block = find_block(tree, flux);
    const uint64_t end = block_end(tree, block + 1);
    uint64_t i = block * CAUSTIC_LANES;
    double sum = tree->flux[block];
    CausticPhoton photon = photon_at(tree, i);
    while (flux >= (sum += (double)rgb_mean(photon_flux(&photon))) && i + 1 < end)
        photon = photon_at(tree, ++i);
    Vec3 a, b;
    photon_axes(&photon, &a, &b);
    const Sample2 s = sample_dome(place);
    const Rgb of_photon = photon_flux(&photon);
    const float mean = rgb_mean(of_photon);
    const float weight = mean > 0.0f ? (float)(caustic_tree_flux(tree) / (double)mean) : 0.0f;
    return (CausticPoint){.p = vec3_madd(vec3_madd(photon.p, s.u, a), s.v, b),
                          .n = photon.n,
                          .height = photon_height(a, b),
                          .flux = rgb_scale(of_photon, weight),
                          .density = rgb_mean(photon.peak)};
}
