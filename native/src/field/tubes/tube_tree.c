/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over light tubes. */
#include "field/tubes/tube_tree.h"

#include <string.h>

#include "base/memory.h"

typedef struct Builder {
    const Tube *tubes;
    TubePatches patches;
    LineItem *items; /* patches in the order of the tree */
    float radius;
    TubeTree *tree;
    Job *job;
    uint32_t level;
} Builder;

typedef struct Bounds {
    float low[LINE_AXES], high[LINE_AXES];
    float box_low[TUBE_QUARTERS][3], box_high[TUBE_QUARTERS][3];
} Bounds;

/* Rounding of f in the gather must not reject what is there. */
static const float SLACK = 2e-6f;
static Bounds no_bounds(void) {
    Bounds bounds;
    for (int a = 0; a < LINE_AXES; ++a) {
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

/* p and everything within reach of it. */
static void add_point(Bounds *bounds, int quarter, Vec3 p, float reach) {
    const float v[3] = {p.x, p.y, p.z};
    for (int a = 0; a < 3; ++a) {
        bounds->box_low[quarter][a] = fminf(bounds->box_low[quarter][a], v[a] - reach);
        bounds->box_high[quarter][a] = fmaxf(bounds->box_high[quarter][a], v[a] + reach);
    }
}

static void add_tube(Bounds *bounds, const Tube *tube) {
    const float stray = tube->bulge + tube->blur;
    for (int k = 0; k < 3; ++k) {
        float line[LINE_AXES];
        line_of(tube->x[k], tube->w[k], line);
        for (int a = 0; a < LINE_AXES; ++a) {
            const float reach = a < 3 ? stray * vec3_length(tube->x[k]) : stray;
            bounds->low[a] = fminf(bounds->low[a], line[a] - reach);
            bounds->high[a] = fmaxf(bounds->high[a], line[a] + reach);
        }
        for (int q = 0; q < TUBE_QUARTERS; ++q) {
            const float step = fminf(tube->limit[k], tube->far) / TUBE_QUARTERS;
            add_point(bounds, q, vec3_madd(tube->x[k], step * (float)q, tube->w[k]),
                      stray * step * (float)q);
            add_point(bounds, q, vec3_madd(tube->x[k], step * (float)(q + 1), tube->w[k]),
                      stray * step * (float)(q + 1));
        }
    }
}

/* Union with child `lane` of a node, whose bounds have their slack already. */
static void add_child(Bounds *bounds, const TubeNode *node, int lane) {
    if (node->extent[0][lane] < 0.0f)
        return;
    for (int a = 0; a < LINE_AXES; ++a) {
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
    for (int a = 0; a < LINE_AXES; ++a) {
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
    for (int a = 0; a < LINE_AXES; ++a) {
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
    const uint64_t child_count = level > 0 ? level_size(tree, level - 1) : tree->patch_count;
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
                const uint32_t patch = builder->items[child].index;
                tree->patches[child] = builder->patches.patches[patch];
                for (uint64_t k = builder->patches.first[patch];
                     k < builder->patches.first[patch + 1]; ++k)
                    add_tube(&bounds, &builder->tubes[builder->patches.order[k]]);
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
    uint64_t size = tree->patch_count;
    do {
        size = (size + TUBE_LANES - 1) / TUBE_LANES;
        sizes[tree->level_count++] = size;
    } while (size > 1);
    for (uint32_t level = tree->level_count; level-- > 0;) {
        tree->first[level] = tree->node_count;
        tree->node_count += sizes[level];
    }
}

/* The middle of each patch's corners, a sum suffices. */
static void place_patches(const Builder *builder) {
    const TubePatches *patches = &builder->patches;
    for (uint64_t p = 0; p < patches->count; ++p) {
        LineItem *item = &builder->items[p];
        *item = (LineItem){.index = (uint32_t)p};
        const uint64_t begin = patches->first[p], end = patches->first[p + 1];
        const float share = 1.0f / (3.0f * (float)(end - begin));
        for (uint64_t i = begin; i < end; ++i)
            for (int k = 0; k < 3; ++k) {
                const Tube *tube = &builder->tubes[patches->order[i]];
                float line[LINE_AXES];
                line_of(tube->x[k], tube->w[k], line);
                for (int a = 0; a < LINE_AXES; ++a)
                    item->place[a] += share * (a < 3 ? line[a] / builder->radius : line[a]);
            }
    }
}

static AmbStatus build(Builder *builder) {
    TubeTree *tree = builder->tree;
    AMB_TRY(line_items_sort(builder->items, tree->patch_count, TUBE_LANES, builder->job));
    for (; builder->level < tree->level_count; ++builder->level)
        AMB_TRY(
            parallel_for(builder->job, level_size(tree, builder->level), 16, fill_level, builder));
    return AMB_OK;
}

static float tube_edge(const Tube *tube) {
    float longest = 0.0f;
    for (int k = 0; k < 3; ++k)
        longest = fmaxf(longest, vec3_length(vec3_sub(tube->x[k], tube->x[(k + 1) % 3])));
    return longest;
}

AmbStatus tube_tree_build(const Tube *tubes, uint64_t tube_count, const TubeLight *light,
                          Vec3 center, float radius, Job *job, TubeTree *out_tree) {
    memset(out_tree, 0, sizeof *out_tree);
    Builder builder = {.tubes = tubes, .radius = radius, .tree = out_tree, .job = job};
    AMB_TRY(tube_patches_build(tubes, tube_count, radius, job, &builder.patches));
    out_tree->light = *light;
    out_tree->center = center;
    out_tree->slack = SLACK * radius;
    out_tree->patch_count = builder.patches.count;
    lay_out(out_tree);
    out_tree->patches = memory_alloc_array(out_tree->patch_count, sizeof(TubePatch));
    out_tree->nodes = memory_alloc_array(out_tree->node_count, sizeof(TubeNode));
    builder.items = memory_alloc_array(out_tree->patch_count, sizeof(LineItem));
    AmbStatus status;
    if (out_tree->patches == NULL || out_tree->nodes == NULL || builder.items == NULL) {
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of light tubes");
    } else {
        for (uint64_t i = 0; i < tube_count; ++i) {
            out_tree->blur = fmaxf(out_tree->blur, tubes[i].blur);
            out_tree->edge = fmaxf(out_tree->edge, tube_edge(&tubes[i]));
        }
        place_patches(&builder);
        status = build(&builder);
    }
    memory_free(builder.items);
    tube_patches_clear(&builder.patches);
    if (status != AMB_OK)
        tube_tree_clear(out_tree);
    return status;
}

void tube_tree_clear(TubeTree *tree) {
    memory_free(tree->nodes);
    memory_free(tree->patches);
    memset(tree, 0, sizeof *tree);
}

uint64_t tube_tree_bytes(const TubeTree *tree) {
    return tree->node_count * sizeof(TubeNode) + tree->patch_count * sizeof(TubePatch);
}
