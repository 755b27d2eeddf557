/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over caustic photons. */
#include "field/caustics/caustic_tree.h"

#include <string.h>

#include "base/memory.h"

enum {
    LEAF = 8,       /* photons of a block */
    TOP_LEVELS = 6, /* divided level by level, side by side; below, whole subtrees are */
    DEPTH_MAX = 64,
    AXIS_SIZE = 3
};

/* Of the half-axes of photons that are divided by place. */
static const float SIZE_RANGE = 4.0f;

/* How far off its plane a photon counts, in half-axes: surfaces may bend. */
static const float HEIGHT_MAX = 0.5f;

/* A subtree to build. */
typedef struct Task {
    uint64_t node, first, count; /* blocks first .. first + count - 1 */
} Task;

typedef struct Builder {
    CausticTree *tree;
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

static bool photon_before(const CausticPhoton *a, const CausticPhoton *b, int axis) {
    return photon_key(a, axis) < photon_key(b, axis);
}

/* Moves the `rank` first photons along the axis to the front (Hoare's selection). */
static void select_photons(CausticPhoton *photons, uint64_t count, uint64_t rank, int axis) {
    uint64_t low = 0, high = count - 1;
    while (low < high) {
        const CausticPhoton pivot = photons[low + (high - low) / 2];
        uint64_t i = low, k = high;
        for (;;) {
            while (photon_before(&photons[i], &pivot, axis))
                ++i;
            while (photon_before(&pivot, &photons[k], axis))
                --k;
            if (i >= k)
                break;
            const CausticPhoton swap = photons[i];
            photons[i++] = photons[k];
            photons[k--] = swap;
        }
        if (rank <= k)
            high = k;
        else
            low = k + 1;
    }
}

static uint64_t block_end(const CausticTree *tree, uint64_t block) {
    const uint64_t end = block * LEAF;
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

static void halve(const CausticTree *tree, const Task *task) {
    const uint64_t begin = task->first * LEAF;
    const uint64_t count = block_end(tree, task->first + task->count) - begin;
    CausticPhoton *photons = tree->photons + begin;
    select_photons(photons, count, left_count(task) * LEAF, longest_axis(photons, count));
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

static CausticBox photon_box(const CausticPhoton *photon) {
    Vec3 a, b;
    photon_axes(photon, &a, &b);
    const Vec3 n = photon->n;
    const float height = photon_height(a, b);
    /* A little more: rounding must not cut a kernel's edge. */
    const Vec3 reach = vec3(1.0001f * sqrtf(a.x * a.x + b.x * b.x) + height * fabsf(n.x),
                            1.0001f * sqrtf(a.y * a.y + b.y * b.y) + height * fabsf(n.y),
                            1.0001f * sqrtf(a.z * a.z + b.z * b.z) + height * fabsf(n.z));
    return (CausticBox){vec3_sub(photon->p, reach), vec3_add(photon->p, reach)};
}

static CausticBox box_union(CausticBox a, CausticBox b) {
    return (CausticBox){vec3_min(a.low, b.low), vec3_max(a.high, b.high)};
}

static CausticBox block_box(const CausticTree *tree, uint64_t block) {
    uint64_t i = block * LEAF;
    CausticBox box = photon_box(&tree->photons[i]);
    while (++i < block_end(tree, block + 1))
        box = box_union(box, photon_box(&tree->photons[i]));
    return box;
}

static void join(CausticTree *tree, const Task *task) {
    tree->boxes[task->node] =
        box_union(tree->boxes[left_task(task).node], tree->boxes[right_task(task).node]);
}

static AmbStatus build_subtree(const Builder *builder, const Task *task) {
    CausticTree *tree = builder->tree;
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    if (task->count == 1) {
        tree->boxes[task->node] = block_box(tree, task->first);
        return AMB_OK;
    }
    halve(tree, task);
    const Task left = left_task(task), right = right_task(task);
    AMB_TRY(build_subtree(builder, &left));
    AMB_TRY(build_subtree(builder, &right));
    join(tree, task);
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
            halve(builder->tree, task);
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
        join(builder->tree, &divided[--divided_count]);
    return AMB_OK;
}

static Rgb photon_flux(const CausticPhoton *photon) {
    const float inverse = vec3_dot(photon->n, vec3_cross(photon->u, photon->v));
    return rgb_scale(photon->peak, 0.5f * AMB_PI / fabsf(inverse));
}

static void sum_flux(CausticTree *tree) {
    double sum = 0.0;
    for (uint64_t block = 0; block < tree->block_count; ++block) {
        tree->flux[block] = sum;
        for (uint64_t i = block * LEAF; i < block_end(tree, block + 1); ++i)
            sum += (double)rgb_mean(photon_flux(&tree->photons[i]));
    }
    tree->flux[tree->block_count] = sum;
}

AmbStatus caustic_tree_build(CausticPhoton *photons, uint64_t photon_count, Job *job,
                             CausticTree *out_tree) {
    *out_tree = (CausticTree){.photons = photons,
                              .photon_count = photon_count,
                              .block_count = (photon_count + LEAF - 1) / LEAF};
    out_tree->boxes = memory_alloc_array(2 * out_tree->block_count - 1, sizeof(CausticBox));
    out_tree->flux = memory_alloc_array(out_tree->block_count + 1, sizeof *out_tree->flux);
    AmbStatus status = AMB_OK;
    if (out_tree->boxes == NULL || out_tree->flux == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of caustic photons");
    Builder builder = {.tree = out_tree, .job = job};
    if (status == AMB_OK)
        status = build_all(&builder);
    if (status == AMB_OK)
        sum_flux(out_tree);
    if (status != AMB_OK)
        caustic_tree_clear(out_tree);
    return status;
}

void caustic_tree_clear(CausticTree *tree) {
    memory_free(tree->photons);
    memory_free(tree->boxes);
    memory_free(tree->flux);
    *tree = (CausticTree){.photons = NULL};
}

static bool is_inside(const CausticBox *box, Vec3 p) {
    return p.x >= box->low.x && p.x <= box->high.x && p.y >= box->low.y && p.y <= box->high.y &&
           p.z >= box->low.z && p.z <= box->high.z;
}

static Rgb block_irradiance(const CausticTree *tree, uint64_t block, Vec3 p, Vec3 n, float dimmed) {
    Rgb sum = rgb(0, 0, 0);
    const uint64_t end = block_end(tree, block + 1);
    for (uint64_t i = block * LEAF; i < end; ++i) {
        const CausticPhoton *photon = &tree->photons[i];
        const Vec3 x = vec3_sub(p, photon->p);
        const float a = vec3_dot(x, photon->u), b = vec3_dot(x, photon->v);
        const float inside = 1.0f - a * a - b * b;
        if (!(inside > 0.0f) || vec3_dot(n, photon->n) < CAUSTIC_NORMAL_COS_MIN)
            continue;
        /* The longer half-axis is the shorter covector's. */
        const float height = vec3_dot(x, photon->n);
        const float inverse = fminf(vec3_dot(photon->u, photon->u), vec3_dot(photon->v, photon->v));
        if (height * height * inverse <= HEIGHT_MAX * HEIGHT_MAX)
            sum = rgb_add(
                sum, rgb_scale(photon->peak, inside / (1.0f + dimmed * rgb_mean(photon->peak))));
    }
    return sum;
}

Rgb caustic_tree_irradiance(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed) {
    Rgb sum = rgb(0, 0, 0);
    Task waiting[DEPTH_MAX];
    uint32_t waiting_count = 1;
    waiting[0] = (Task){0, 0, tree->block_count};
    while (waiting_count > 0) {
        const Task task = waiting[--waiting_count];
        if (!is_inside(&tree->boxes[task.node], p))
            continue;
        if (task.count == 1) {
            sum = rgb_add(sum, block_irradiance(tree, task.first, p, n, dimmed));
            continue;
        }
        waiting[waiting_count++] = right_task(&task);
        waiting[waiting_count++] = left_task(&task);
    }
    return sum;
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

CausticPoint caustic_tree_choose(const CausticTree *tree, double flux, Sample2 place) {
    const uint64_t block = find_block(tree, flux);
    const uint64_t end = block_end(tree, block + 1);
    uint64_t i = block * LEAF;
    double sum = tree->flux[block];
    Rgb of_photon = photon_flux(&tree->photons[i]);
    while (flux >= (sum += (double)rgb_mean(of_photon)) && i + 1 < end)
        of_photon = photon_flux(&tree->photons[++i]);
    const CausticPhoton *photon = &tree->photons[i];
    Vec3 a, b;
    photon_axes(photon, &a, &b);
    const Sample2 s = sample_dome(place);
    const float mean = rgb_mean(of_photon);
    const float weight = mean > 0.0f ? (float)(caustic_tree_flux(tree) / (double)mean) : 0.0f;
    return (CausticPoint){.p = vec3_madd(vec3_madd(photon->p, s.u, a), s.v, b),
                          .n = photon->n,
                          .height = photon_height(a, b),
                          .flux = rgb_scale(of_photon, weight),
                          .density = rgb_mean(photon->peak)};
}
