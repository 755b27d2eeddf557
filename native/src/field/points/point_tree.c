/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over volume samples. */
#include "field/points/point_tree.h"

#include <string.h>

#include "base/memory.h"
#include "base/order.h"
#include "math/sampling.h"

typedef struct Item {
    float center[3];
    uint32_t sample;
} Item;

/* A node to build: blocks first .. first + count - 1 of the sorted order. */
typedef struct Task {
    uint64_t node;
    uint64_t first_block, block_count;
} Task;

typedef struct Builder {
    const PointSample *samples;
    uint64_t sample_count;
    Item *items;
    PointTree *tree;
    Job *job;
    Task *tasks;
    bool is_top; /* tasks are divided only, not built */
} Builder;

typedef struct Box {
    Vec3 low, high;
} Box;

static uint64_t block_end(const Builder *builder, uint64_t block) {
    const uint64_t end = block * POINT_LANES;
    return end < builder->sample_count ? end : builder->sample_count;
}

/* Sizes, in blocks, of the children of a node: three halvings. Returns how many are not empty. */
static uint32_t child_sizes(uint64_t block_count, uint64_t out_sizes[POINT_LANES]) {
    uint32_t count = 1;
    out_sizes[0] = block_count;
    while (count < POINT_LANES) {
        uint64_t halves[POINT_LANES];
        uint32_t half_count = 0;
        for (uint32_t i = 0; i < count; ++i) {
            const uint64_t right = out_sizes[i] / 2;
            halves[half_count++] = out_sizes[i] - right;
            if (right > 0)
                halves[half_count++] = right;
        }
        if (half_count == count)
            break; /* nothing but single blocks */
        memcpy(out_sizes, halves, half_count * sizeof halves[0]);
        count = half_count;
    }
    return count;
}

/* Nodes of the subtree over so many blocks: child k of node i comes after all subtrees of the
 * children before it. */
static uint64_t subtree_nodes(uint64_t block_count) {
    if (block_count <= POINT_LANES)
        return 1;
    uint64_t sizes[POINT_LANES];
    const uint32_t count = child_sizes(block_count, sizes);
    uint64_t nodes = 1;
    for (uint32_t i = 0; i < count; ++i)
        if (sizes[i] > 1)
            nodes += subtree_nodes(sizes[i]);
    return nodes;
}

static int longest_axis(const Item *items, uint64_t count) {
    float low[3] = {INFINITY, INFINITY, INFINITY};
    float high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint64_t i = 0; i < count; ++i)
        for (int a = 0; a < 3; ++a) {
            low[a] = fminf(low[a], items[i].center[a]);
            high[a] = fmaxf(high[a], items[i].center[a]);
        }
    int axis = 0;
    for (int a = 1; a < 3; ++a)
        if (high[a] - low[a] > high[axis] - low[axis])
            axis = a;
    return axis;
}

static bool item_before(const void *first, const void *second, const void *user) {
    const Item *a = first, *b = second;
    const int axis = *(const int *)user;
    /* The index breaks ties: equal centres must not leave the order to chance. */
    return a->center[axis] < b->center[axis] ||
           (a->center[axis] == b->center[axis] && a->sample < b->sample);
}

/* Halves a range of blocks as child_sizes does, `levels` times; stops when the job is cancelled. */
static void divide(const Builder *builder, uint64_t first, uint64_t blocks, int levels) {
    if (levels == 0 || blocks < 2 || job_is_cancelled(builder->job))
        return;
    const uint64_t left = blocks - blocks / 2;
    const uint64_t begin = first * POINT_LANES;
    const uint64_t end = block_end(builder, first + blocks);
    Item *items = builder->items + begin;
    const int axis = longest_axis(items, end - begin);
    order_select(items, sizeof *items, end - begin, left * POINT_LANES, item_before, &axis);
    divide(builder, first, left, levels - 1);
    divide(builder, first + left, blocks - left, levels - 1);
}

static Vec3 sample_middle(const PointSample *sample) {
    return vec3_madd(sample->origin, 0.5f * (sample->low + sample->high), sample->direction);
}

static Box sample_box(const PointSample *sample) {
    const float half = 0.5f * (sample->high - sample->low);
    const Vec3 d = sample->direction;
    const Vec3 middle = sample_middle(sample);
    const float r = sample->radius;
    const Vec3 reach = vec3(half * fabsf(d.x) + r * safe_sqrtf(1.0f - d.x * d.x),
                            half * fabsf(d.y) + r * safe_sqrtf(1.0f - d.y * d.y),
                            half * fabsf(d.z) + r * safe_sqrtf(1.0f - d.z * d.z));
    /* Rounding of the lines above must not cut a sample's edge. */
    const Vec3 padded = vec3_scale(reach, 1.00001f);
    return (Box){vec3_sub(middle, padded), vec3_add(middle, padded)};
}

static Box box_union(Box a, Box b) {
    return (Box){vec3_min(a.low, b.low), vec3_max(a.high, b.high)};
}

static Box empty_box(void) {
    return (Box){vec3(INFINITY, INFINITY, INFINITY), vec3(-INFINITY, -INFINITY, -INFINITY)};
}

/* At infinity on all axes: no segment meets it, whichever way its slabs are ordered. */
static Box unused_box(void) {
    return (Box){vec3(INFINITY, INFINITY, INFINITY), vec3(INFINITY, INFINITY, INFINITY)};
}

static Box fill_block(const Builder *builder, uint64_t block) {
    PointBlock *out = &builder->tree->blocks[block];
    memset(out, 0, sizeof *out);
    Box box = empty_box();
    const uint64_t end = block_end(builder, block + 1);
    for (uint64_t i = block * POINT_LANES; i < end; ++i) {
        const PointSample *s = &builder->samples[builder->items[i].sample];
        const uint64_t lane = i % POINT_LANES;
        out->origin[0][lane] = s->origin.x;
        out->origin[1][lane] = s->origin.y;
        out->origin[2][lane] = s->origin.z;
        out->direction[0][lane] = s->direction.x;
        out->direction[1][lane] = s->direction.y;
        out->direction[2][lane] = s->direction.z;
        out->low[lane] = s->low;
        out->high[lane] = s->high;
        const float radius2 = s->radius * s->radius;
        out->radius2[lane] = radius2;
        out->normalization[lane] = 2.0f / (AMB_PI * radius2 * radius2);
        out->flux[0][lane] = s->flux.r;
        out->flux[1][lane] = s->flux.g;
        out->flux[2][lane] = s->flux.b;
        out->frequency[lane] = s->frequency;
        out->reflected |= (uint8_t)((s->is_reflected ? 1u : 0u) << lane);
        out->passed |= (uint8_t)((s->has_passed ? 1u : 0u) << lane);
        box = box_union(box, sample_box(s));
    }
    return box;
}

static void set_child(PointNode *node, uint32_t lane, Box box, int32_t child) {
    node->low[0][lane] = box.low.x;
    node->low[1][lane] = box.low.y;
    node->low[2][lane] = box.low.z;
    node->high[0][lane] = box.high.x;
    node->high[1][lane] = box.high.y;
    node->high[2][lane] = box.high.z;
    node->child[lane] = child;
}

static Box node_box(const PointNode *node) {
    Box box = empty_box();
    for (int i = 0; i < POINT_LANES && node->child[i] != 0; ++i) {
        const Box child = {vec3(node->low[0][i], node->low[1][i], node->low[2][i]),
                           vec3(node->high[0][i], node->high[1][i], node->high[2][i])};
        box = box_union(box, child);
    }
    return box;
}

/* Lists the children of a task's node and links them; leaves' boxes are set by finish_node. */
static uint32_t child_tasks(const Builder *builder, const Task *task, Task out[POINT_LANES]) {
    uint64_t sizes[POINT_LANES];
    const uint32_t count = child_sizes(task->block_count, sizes);
    PointNode *node = &builder->tree->nodes[task->node];
    uint64_t next_node = task->node + 1;
    uint64_t block = task->first_block;
    for (uint32_t i = 0; i < POINT_LANES; ++i) {
        if (i >= count) {
            set_child(node, i, unused_box(), 0);
            continue;
        }
        out[i] = (Task){next_node, block, sizes[i]};
        node->child[i] = sizes[i] > 1 ? (int32_t)next_node : ~(int32_t)block;
        if (sizes[i] > 1)
            next_node += subtree_nodes(sizes[i]);
        block += sizes[i];
    }
    return count;
}

static void finish_node(const Builder *builder, uint64_t index) {
    PointNode *node = &builder->tree->nodes[index];
    for (uint32_t i = 0; i < POINT_LANES; ++i) {
        const int32_t child = node->child[i];
        if (child > 0)
            set_child(node, i, node_box(&builder->tree->nodes[child]), child);
        else if (child < 0)
            set_child(node, i, fill_block(builder, (uint64_t)~child), child);
    }
}

/* Builds a whole subtree. */
static AmbStatus build_subtree(const Builder *builder, const Task *task) {
    divide(builder, task->first_block, task->block_count, 3);
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED; /* before an unfinished order is used */
    Task children[POINT_LANES];
    const uint32_t count = child_tasks(builder, task, children);
    for (uint32_t i = 0; i < count; ++i)
        if (children[i].block_count > 1)
            AMB_TRY(build_subtree(builder, &children[i]));
    finish_node(builder, task->node);
    return AMB_OK;
}

static AmbStatus build_tasks(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Builder *builder = user;
    for (uint64_t i = begin; i < end; ++i) {
        if (builder->is_top)
            divide(builder, builder->tasks[i].first_block, builder->tasks[i].block_count, 3);
        else
            AMB_TRY(build_subtree(builder, &builder->tasks[i]));
    }
    return AMB_OK;
}

static AmbStatus fill_items(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Builder *builder = user;
    for (uint64_t i = begin; i < end; ++i) {
        const Vec3 c = sample_middle(&builder->samples[i]);
        builder->items[i] = (Item){{c.x, c.y, c.z}, (uint32_t)i};
    }
    return AMB_OK;
}

enum { TOP_LEVELS = 2, TOP_TASK_MAX = 1 + POINT_LANES + POINT_LANES * POINT_LANES };

/* The top levels are divided level by level, then whole subtrees are built side by side. */
static AmbStatus build_all(Builder *builder) {
    Task levels[TOP_TASK_MAX];
    uint32_t level_begin = 0, level_end = 1;
    levels[0] = (Task){0, 0, builder->tree->block_count};
    uint32_t tops[TOP_TASK_MAX];
    uint32_t top_count = 0;
    for (uint32_t level = 0; level < TOP_LEVELS; ++level) {
        builder->tasks = levels + level_begin;
        builder->is_top = true;
        AMB_TRY(parallel_for(builder->job, level_end - level_begin, 1, build_tasks, builder));
        uint32_t next_end = level_end;
        for (uint32_t i = level_begin; i < level_end; ++i) {
            Task children[POINT_LANES];
            const uint32_t count = child_tasks(builder, &levels[i], children);
            tops[top_count++] = (uint32_t)levels[i].node;
            for (uint32_t k = 0; k < count; ++k)
                if (children[k].block_count > 1)
                    levels[next_end++] = children[k];
        }
        level_begin = level_end;
        level_end = next_end;
    }
    builder->tasks = levels + level_begin;
    builder->is_top = false;
    AMB_TRY(parallel_for(builder->job, level_end - level_begin, 1, build_tasks, builder));
    while (top_count > 0)
        finish_node(builder, tops[--top_count]);
    return AMB_OK;
}

AmbStatus point_tree_build(const PointSample *samples, uint64_t sample_count, Job *job,
                           PointTree *out_tree) {
    memset(out_tree, 0, sizeof *out_tree);
    if (sample_count > INT32_MAX)
        return status_fail(AMB_OUT_OF_MEMORY, "%llu volume samples are too many",
                           (unsigned long long)sample_count);
    out_tree->block_count = (sample_count + POINT_LANES - 1) / POINT_LANES;
    out_tree->node_count = subtree_nodes(out_tree->block_count);
    out_tree->blocks = memory_alloc_array(out_tree->block_count, sizeof(PointBlock));
    out_tree->nodes = memory_zero_array(out_tree->node_count, sizeof(PointNode));
    Builder builder = {.samples = samples,
                       .sample_count = sample_count,
                       .items = memory_alloc_array(sample_count, sizeof(Item)),
                       .tree = out_tree,
                       .job = job};
    AmbStatus status = AMB_OK;
    if (out_tree->blocks == NULL || out_tree->nodes == NULL || builder.items == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of volume samples");
    if (status == AMB_OK) {
        status = parallel_for(job, sample_count, 1 << 16, fill_items, &builder);
    }
    if (status == AMB_OK) {
        status = build_all(&builder);
    }
    memory_free(builder.items);
    if (status != AMB_OK)
        point_tree_clear(out_tree);
    return status;
}

void point_tree_clear(PointTree *tree) {
    memory_free(tree->nodes);
    memory_free(tree->blocks);
    memset(tree, 0, sizeof *tree);
}
