/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over light tubes. */
#include "field/tubes/tube_tree.h"

#include <string.h>

#include "base/memory.h"

enum { AXES = 6 };

/* A tube's place among the lines, scaled so that the axes are alike. */
typedef struct Item {
    float place[AXES];
    uint32_t tube;
} Item;

typedef struct Builder {
    const Tube *tubes;
    uint64_t tube_count;
    Item *items;
    float radius;
    TubeTree *tree;
    Job *job;
    uint32_t level;
} Builder;

typedef struct Bounds {
    float low[AXES], high[AXES];
    float box_low[TUBE_QUARTERS][3], box_high[TUBE_QUARTERS][3];
} Bounds;

/* Rounding of f in the gather must not reject what is there. */
static const float SLACK = 2e-6f;

static void line_of(const Tube *tube, int k, float out[AXES]) {
    const Vec3 m = vec3_cross(tube->x[k], tube->w[k]);
    const float line[AXES] = {m.x, m.y, m.z, tube->w[k].x, tube->w[k].y, tube->w[k].z};
    memcpy(out, line, sizeof line);
}

static int longest_axis(const Item *items, uint64_t count) {
    float low[AXES], high[AXES];
    memcpy(low, items[0].place, sizeof low);
    memcpy(high, items[0].place, sizeof high);
    for (uint64_t i = 1; i < count; ++i)
        for (int a = 0; a < AXES; ++a) {
            low[a] = fminf(low[a], items[i].place[a]);
            high[a] = fmaxf(high[a], items[i].place[a]);
        }
    int axis = 0;
    for (int a = 1; a < AXES; ++a)
        if (high[a] - low[a] > high[axis] - low[axis])
            axis = a;
    return axis;
}

static bool item_before(const Item *a, const Item *b, int axis) {
    /* The index breaks ties: equal places must not leave the order to chance. */
    return a->place[axis] < b->place[axis] ||
           (a->place[axis] == b->place[axis] && a->tube < b->tube);
}

/* Moves the `rank` first items along the axis to the front (Hoare's selection). */
static void select_items(Item *items, uint64_t count, uint64_t rank, int axis) {
    uint64_t low = 0, high = count - 1;
    while (low < high) {
        const Item pivot = items[low + (high - low) / 2];
        uint64_t i = low, k = high;
        for (;;) {
            while (item_before(&items[i], &pivot, axis))
                ++i;
            while (item_before(&pivot, &items[k], axis))
                --k;
            if (i >= k)
                break;
            const Item swap = items[i];
            items[i++] = items[k];
            items[k--] = swap;
        }
        /* Everything up to k is not after the pivot, everything from k + 1 not before it. */
        if (rank <= k)
            high = k;
        else
            low = k + 1;
    }
}

/* Halves at the median along the longest axis until single blocks are left. Halves are multiples
 * of the largest full subtree that fits, so that nodes of eight are consecutive and full. */
static AmbStatus sort_items(const Builder *builder, Item *items, uint64_t count) {
    if (count <= TUBE_LANES)
        return AMB_OK;
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    uint64_t unit = TUBE_LANES;
    while (unit * TUBE_LANES < count)
        unit *= TUBE_LANES;
    const uint64_t units = (count + unit - 1) / unit;
    const uint64_t left = (units + 1) / 2 * unit;
    select_items(items, count, left, longest_axis(items, count));
    AMB_TRY(sort_items(builder, items, left));
    return sort_items(builder, items + left, count - left);
}

static void set_lane3(float out[3][TUBE_LANES], uint64_t lane, Vec3 v) {
    out[0][lane] = v.x;
    out[1][lane] = v.y;
    out[2][lane] = v.z;
}

static void fill_block(const Builder *builder, uint64_t b) {
    TubeBlock *block = &builder->tree->blocks[b];
    memset(block, 0, sizeof *block);
    for (uint64_t lane = 0; lane < TUBE_LANES; ++lane) {
        const uint64_t i = b * TUBE_LANES + lane;
        if (i >= builder->tube_count)
            break;
        const Tube *tube = &builder->tubes[builder->items[i].tube];
        for (int k = 0; k < 3; ++k) {
            set_lane3(block->x[k], lane, tube->x[k]);
            set_lane3(block->w[k], lane, tube->w[k]);
            block->limit[k][lane] = tube->limit[k];
            block->flux[k][lane] = tube->flux[k];
        }
        block->color[0][lane] = tube->color.r;
        block->color[1][lane] = tube->color.g;
        block->color[2][lane] = tube->color.b;
        block->spread[0][lane] = tube->spread[0];
        block->spread[1][lane] = tube->spread[1];
    }
}

static Bounds no_bounds(void) {
    Bounds bounds;
    for (int a = 0; a < AXES; ++a) {
        bounds.low[a] = INFINITY;
        bounds.high[a] = -INFINITY;
    }
    for (int q = 0; q < TUBE_QUARTERS; ++q)
        for (int a = 0; a < 3; ++a) {
            bounds.box_low[q][a] = INFINITY;
            bounds.box_high[q][a] = -INFINITY;
        }
    return bounds;
}

static void add_point(Bounds *bounds, int quarter, Vec3 p) {
    const float v[3] = {p.x, p.y, p.z};
    for (int a = 0; a < 3; ++a) {
        bounds->box_low[quarter][a] = fminf(bounds->box_low[quarter][a], v[a]);
        bounds->box_high[quarter][a] = fmaxf(bounds->box_high[quarter][a], v[a]);
    }
}

static void add_tube(Bounds *bounds, const Tube *tube) {
    for (int k = 0; k < 3; ++k) {
        float line[AXES];
        line_of(tube, k, line);
        for (int a = 0; a < AXES; ++a) {
            bounds->low[a] = fminf(bounds->low[a], line[a]);
            bounds->high[a] = fmaxf(bounds->high[a], line[a]);
        }
        for (int q = 0; q < TUBE_QUARTERS; ++q) {
            const float step = fminf(tube->limit[k], tube->far) / TUBE_QUARTERS;
            add_point(bounds, q, vec3_madd(tube->x[k], step * (float)q, tube->w[k]));
            add_point(bounds, q, vec3_madd(tube->x[k], step * (float)(q + 1), tube->w[k]));
        }
    }
}

/* Union with child `lane` of a node, whose bounds have their slack already. */
static void add_child(Bounds *bounds, const TubeNode *node, int lane) {
    if (node->extent[0][lane] < 0.0f)
        return;
    for (int a = 0; a < AXES; ++a) {
        const float middle = node->middle[a][lane], extent = node->extent[a][lane];
        bounds->low[a] = fminf(bounds->low[a], middle - extent);
        bounds->high[a] = fmaxf(bounds->high[a], middle + extent);
    }
    for (int q = 0; q < TUBE_QUARTERS; ++q)
        for (int a = 0; a < 3; ++a) {
            bounds->box_low[q][a] = fminf(bounds->box_low[q][a], node->low[q][a][lane]);
            bounds->box_high[q][a] = fmaxf(bounds->box_high[q][a], node->high[q][a][lane]);
        }
}

static void set_child(TubeNode *node, int lane, const Bounds *bounds, float radius) {
    for (int a = 0; a < AXES; ++a) {
        const float scale = a < 3 ? radius : 1.0f;
        node->middle[a][lane] = 0.5f * (bounds->low[a] + bounds->high[a]);
        node->extent[a][lane] = 0.5f * (bounds->high[a] - bounds->low[a]) + SLACK * scale;
    }
    for (int q = 0; q < TUBE_QUARTERS; ++q)
        for (int a = 0; a < 3; ++a) {
            node->low[q][a][lane] = bounds->box_low[q][a] - SLACK * radius;
            node->high[q][a][lane] = bounds->box_high[q][a] + SLACK * radius;
        }
}

static void set_empty(TubeNode *node, int lane) {
    const Bounds bounds = no_bounds();
    for (int a = 0; a < AXES; ++a) {
        node->middle[a][lane] = 0.0f;
        node->extent[a][lane] = -1.0f;
    }
    for (int q = 0; q < TUBE_QUARTERS; ++q)
        for (int a = 0; a < 3; ++a) {
            node->low[q][a][lane] = bounds.box_low[q][a];
            node->high[q][a][lane] = bounds.box_high[q][a];
        }
}

static uint64_t level_size(const TubeTree *tree, uint32_t level) {
    const uint64_t end = level > 0 ? tree->first[level - 1] : tree->node_count;
    return end - tree->first[level];
}

static AmbStatus fill_level(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Builder *builder = user;
    TubeTree *tree = builder->tree;
    const uint32_t level = builder->level;
    const uint64_t child_count = level > 0 ? level_size(tree, level - 1) : tree->block_count;
    for (uint64_t i = begin; i < end; ++i) {
        TubeNode *node = &tree->nodes[tree->first[level] + i];
        for (int lane = 0; lane < TUBE_LANES; ++lane) {
            const uint64_t child = i * TUBE_LANES + (uint64_t)lane;
            if (child >= child_count) {
                set_empty(node, lane);
                continue;
            }
            Bounds bounds = no_bounds();
            if (level == 0) {
                fill_block(builder, child);
                for (uint64_t k = child * TUBE_LANES;
                     k < (child + 1) * TUBE_LANES && k < builder->tube_count; ++k)
                    add_tube(&bounds, &builder->tubes[builder->items[k].tube]);
            } else {
                const TubeNode *below = &tree->nodes[tree->first[level - 1] + child];
                for (int k = 0; k < TUBE_LANES; ++k)
                    add_child(&bounds, below, k);
            }
            set_child(node, lane, &bounds, builder->radius);
        }
    }
    return AMB_OK;
}

/* Numbers the levels, the root's first. */
static void lay_out(TubeTree *tree) {
    uint64_t sizes[TUBE_LEVEL_MAX];
    uint64_t size = tree->block_count;
    do {
        size = (size + TUBE_LANES - 1) / TUBE_LANES;
        sizes[tree->level_count++] = size;
    } while (size > 1);
    for (uint32_t level = tree->level_count; level-- > 0;) {
        tree->first[level] = tree->node_count;
        tree->node_count += sizes[level];
    }
}

AmbStatus tube_tree_build(Tube *tubes, uint64_t tube_count, Vec3 center, float radius, Job *job,
                          TubeTree *out_tree) {
    memset(out_tree, 0, sizeof *out_tree);
    if (tube_count > INT32_MAX)
        return status_fail(AMB_OUT_OF_MEMORY, "%llu light tubes are too many",
                           (unsigned long long)tube_count);
    out_tree->center = center;
    out_tree->block_count = (tube_count + TUBE_LANES - 1) / TUBE_LANES;
    lay_out(out_tree);
    out_tree->blocks = memory_alloc_array(out_tree->block_count, sizeof(TubeBlock));
    out_tree->nodes = memory_alloc_array(out_tree->node_count, sizeof(TubeNode));
    Builder builder = {.tubes = tubes,
                       .tube_count = tube_count,
                       .items = memory_alloc_array(tube_count, sizeof(Item)),
                       .radius = radius,
                       .tree = out_tree,
                       .job = job};
    AmbStatus status = AMB_OK;
    if (out_tree->blocks == NULL || out_tree->nodes == NULL || builder.items == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of light tubes");
    if (status == AMB_OK) {
        for (uint64_t i = 0; i < tube_count; ++i) {
            Item *item = &builder.items[i];
            *item = (Item){.tube = (uint32_t)i};
            for (int k = 0; k < 3; ++k) {
                float line[AXES];
                line_of(&tubes[i], k, line);
                for (int a = 0; a < AXES; ++a)
                    item->place[a] += a < 3 ? line[a] / radius : line[a];
            }
        }
        status = sort_items(&builder, builder.items, tube_count);
    }
    for (; builder.level < out_tree->level_count && status == AMB_OK; ++builder.level)
        status = parallel_for(job, level_size(out_tree, builder.level), 16, fill_level, &builder);
    memory_free(builder.items);
    if (status != AMB_OK)
        tube_tree_clear(out_tree);
    return status;
}

void tube_tree_clear(TubeTree *tree) {
    memory_free(tree->nodes);
    memory_free(tree->blocks);
    memset(tree, 0, sizeof *tree);
}
