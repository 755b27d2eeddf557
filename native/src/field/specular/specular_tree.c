/* SPDX-License-Identifier: GPL-3.0-or-later
 * Bounds of refracted light. */
#include "field/specular/specular_tree.h"

#include <string.h>

#include "base/memory.h"
#include "base/order.h"

/* Rounding of single precision in the sums below, in parts of what is summed. */
static const float ROUNDING = 4e-6f;

/* One child, as a loop over eight that compilers vectorise. */
static inline int is_met(const SpecularNode *node, int k, const BoundQuery *query) {
    const float r = node->radius[k], e = node->spread[k];
    const Vec3 w = vec3(node->w[0][k], node->w[1][k], node->w[2][k]), d = query->d;
    const Vec3 center = vec3(node->center[0][k], node->center[1][k], node->center[2][k]);
    const Vec3 a = vec3_sub(center, query->o);
    const float along = vec3_dot(a, d);
    const Vec3 off = vec3_madd(a, -along, d); /* from the camera's line */
    const float distance = sqrtf(vec3_dot(off, off));
    const Vec3 normal = vec3_cross(w, d);
    /* f = off . (w x d), with off known to r and w to e. */
    const float f = fabsf(vec3_dot(off, normal));
    const float f_slack = distance * e + r * (sqrtf(vec3_dot(normal, normal)) + e) +
                          ROUNDING * (distance + fabsf(along) + r);
    /* Light goes forward: (x - p) . w > 0 at one end of the segment at least. */
    const Vec3 to_start = vec3_negate(a), to_end = vec3_madd(to_start, query->length, d);
    const float start = sqrtf(vec3_dot(to_start, to_start));
    const float end = sqrtf(vec3_dot(to_end, to_end));
    const float start_slack = start * (e + ROUNDING) + r, end_slack = end * (e + ROUNDING) + r;
    const int is_ahead =
        (vec3_dot(to_start, w) + start_slack >= 0.0f) | (vec3_dot(to_end, w) + end_slack >= 0.0f);
    /* In the plane of the camera's line and the ball's centre, light passes between the ends: with
     * x = p + s w on the segment, ((start - p) x w) . m and ((end - p) x w) . m have opposite signs
     * for any m, here of length `distance`. */
    const Vec3 m = vec3_cross(a, d);
    const float first = vec3_dot(vec3_cross(to_start, w), m);
    const float last = vec3_dot(vec3_cross(to_end, w), m);
    const float first_slack = distance * start_slack, last_slack = distance * end_slack;
    const int is_beside = ((first > first_slack) & (last > last_slack)) |
                          ((first < -first_slack) & (last < -last_slack));
    return (f <= f_slack) & is_ahead & !is_beside;
}

uint32_t specular_children_met(const SpecularNode *node, const BoundQuery *query) {
    int met[SPECULAR_CHILDREN];
    for (int k = 0; k < SPECULAR_CHILDREN; ++k)
        met[k] = is_met(node, k, query);
    uint32_t bits = 0;
    for (int k = 0; k < SPECULAR_CHILDREN; ++k)
        bits |= (uint32_t)met[k] << k;
    return bits;
}

typedef struct Builder {
    SpecularTree *tree;
    Job *job;
    float scale;
} Builder;

/* Place in units of the object and direction, so that one is worth as much as the other. */
static float coordinate(const SpecularCell *cell, float scale, int axis) {
    const LineBound *b = &cell->bound;
    const float values[6] = {
        b->center.x / scale, b->center.y / scale, b->center.z / scale, b->w.x, b->w.y, b->w.z};
    return values[axis];
}

typedef struct Along {
    float scale;
    int axis;
} Along;

static bool cell_before(const void *a, const void *b, const void *user) {
    const Along *along = user;
    return coordinate(a, along->scale, along->axis) < coordinate(b, along->scale, along->axis);
}

static LineBound bound_of(const LineBound *parts, uint64_t count) {
    Vec3 low = parts[0].center, high = low, w_low = parts[0].w, w_high = w_low;
    for (uint64_t i = 1; i < count; ++i) {
        low = vec3_min(low, parts[i].center);
        high = vec3_max(high, parts[i].center);
        w_low = vec3_min(w_low, parts[i].w);
        w_high = vec3_max(w_high, parts[i].w);
    }
    LineBound bound = {.center = vec3_scale(vec3_add(low, high), 0.5f),
                       .w = vec3_scale(vec3_add(w_low, w_high), 0.5f)};
    for (uint64_t i = 0; i < count; ++i) {
        const float place = vec3_length(vec3_sub(parts[i].center, bound.center)) + parts[i].radius;
        const float turn = vec3_length(vec3_sub(parts[i].w, bound.w)) + parts[i].spread;
        bound.radius = fmaxf(bound.radius, place * (1.0f + ROUNDING));
        bound.spread = fmaxf(bound.spread, turn * (1.0f + ROUNDING));
    }
    return bound;
}

/* Axis along which the cells are spread most. */
static int widest_axis(const Builder *builder, uint64_t begin, uint64_t end) {
    int widest = 0;
    float most = -1.0f;
    for (int axis = 0; axis < 6; ++axis) {
        float low = INFINITY, high = -INFINITY;
        for (uint64_t i = begin; i < end; ++i) {
            const float x = coordinate(&builder->tree->cells[i], builder->scale, axis);
            low = fminf(low, x);
            high = fmaxf(high, x);
        }
        if (high - low > most) {
            most = high - low;
            widest = axis;
        }
    }
    return widest;
}

/* Sorts cells so that every aligned run of eight, 64, 512 .. lies close together: halves at powers
 * of two. */
static AmbStatus sort_cells(const Builder *builder, uint64_t begin, uint64_t end) {
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    const uint64_t count = end - begin;
    if (count <= SPECULAR_CHILDREN)
        return AMB_OK;
    uint64_t left = SPECULAR_CHILDREN;
    while (2 * left < count)
        left *= 2;
    const uint64_t middle = begin + left;
    const Along along = {builder->scale, widest_axis(builder, begin, end)};
    order_select(builder->tree->cells + begin, sizeof(SpecularCell), count, left, cell_before,
                 &along);
    AMB_TRY(sort_cells(builder, begin, middle));
    return sort_cells(builder, middle, end);
}

/* Fills one level from the bounds of its children; they become those of its nodes. */
static void build_level(SpecularTree *tree, uint32_t level, LineBound *bounds) {
    const uint64_t children = tree->child_count[level];
    SpecularNode *nodes = &tree->nodes[tree->first[level]];
    for (uint64_t i = 0; i * SPECULAR_CHILDREN < children; ++i) {
        const LineBound *parts = &bounds[i * SPECULAR_CHILDREN];
        const uint64_t left = children - i * SPECULAR_CHILDREN;
        const uint64_t count = left < SPECULAR_CHILDREN ? left : SPECULAR_CHILDREN;
        SpecularNode *node = &nodes[i];
        memset(node, 0, sizeof *node);
        for (uint64_t k = 0; k < count; ++k) {
            const float center[3] = {parts[k].center.x, parts[k].center.y, parts[k].center.z};
            const float w[3] = {parts[k].w.x, parts[k].w.y, parts[k].w.z};
            for (int axis = 0; axis < 3; ++axis) {
                node->center[axis][k] = center[axis];
                node->w[axis][k] = w[axis];
            }
            node->radius[k] = parts[k].radius;
            node->spread[k] = parts[k].spread;
        }
        bounds[i] = bound_of(parts, count);
    }
}

static AmbStatus build_nodes(SpecularTree *tree) {
    uint64_t children = tree->cell_count;
    do {
        tree->first[tree->level_count] = tree->node_count;
        tree->child_count[tree->level_count++] = children;
        children = (children + SPECULAR_CHILDREN - 1) / SPECULAR_CHILDREN;
        tree->node_count += children;
    } while (children > 1);
    tree->nodes = memory_alloc_array(tree->node_count, sizeof(SpecularNode));
    LineBound *bounds = memory_alloc_array(tree->cell_count, sizeof *bounds);
    if (tree->nodes == NULL || bounds == NULL) {
        memory_free(bounds);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of lit triangles");
    }
    for (uint64_t i = 0; i < tree->cell_count; ++i)
        bounds[i] = tree->cells[i].bound;
    for (uint32_t level = 0; level < tree->level_count; ++level)
        build_level(tree, level, bounds);
    memory_free(bounds);
    return AMB_OK;
}

AmbStatus specular_tree_build(SpecularCell *cells, uint64_t cell_count, float scale, Job *job,
                              SpecularTree *out_tree) {
    *out_tree = (SpecularTree){.cells = cells, .cell_count = cell_count};
    if (cell_count == 0)
        return AMB_OK;
    const Builder builder = {out_tree, job, scale};
    AmbStatus status = sort_cells(&builder, 0, cell_count);
    if (status == AMB_OK)
        status = build_nodes(out_tree);
    if (status != AMB_OK)
        specular_tree_clear(out_tree);
    return status;
}

void specular_tree_clear(SpecularTree *tree) {
    memory_free(tree->cells);
    memory_free(tree->nodes);
    memset(tree, 0, sizeof *tree);
}
