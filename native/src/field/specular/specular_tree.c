/* SPDX-License-Identifier: GPL-3.0-or-later
 * Bounds of refracted light. */
#include "field/specular/specular_tree.h"

#include <string.h>

#include "base/memory.h"

enum { LEAF_MAX = 2 };

/* Rounding of single precision in the sums below, in parts of what is summed. */
static const float ROUNDING = 4e-6f;

bool specular_bound_meets(const LineBound *bound, const BoundQuery *query) {
    const float r = bound->radius, e = bound->spread;
    const Vec3 a = vec3_sub(bound->center, query->o);
    const Vec3 w = bound->w, d = query->d;
    const float along = vec3_dot(a, d);
    const Vec3 off = vec3_madd(a, -along, d); /* from the camera's line */
    const float distance = vec3_length(off);
    const Vec3 normal = vec3_cross(w, d);
    /* f = off . (w x d), with off known to r and w to e. */
    const float f = vec3_dot(off, normal);
    const float slack = ROUNDING * (distance + fabsf(along) + r);
    if (fabsf(f) > distance * e + r * (vec3_length(normal) + e) + slack)
        return false;
    /* Light goes forward: (x - p) . w > 0 at one end of the segment at least. */
    const Vec3 to_start = vec3_negate(a), to_end = vec3_madd(to_start, query->length, d);
    const float start = vec3_length(to_start), end = vec3_length(to_end);
    if (vec3_dot(to_start, w) + start * e + r + ROUNDING * start < 0.0f &&
        vec3_dot(to_end, w) + end * e + r + ROUNDING * end < 0.0f)
        return false;
    /* In the plane of the camera's line and the ball's centre, light passes between the ends: with
     * x = p + s w on the segment, ((start - p) x w) . m and ((end - p) x w) . m have opposite signs
     * for any m. */
    if (!(distance > 0.0f))
        return true;
    const Vec3 m = vec3_scale(vec3_cross(a, d), 1.0f / distance);
    const float size = vec3_length(w) + e;
    const float first = vec3_dot(vec3_cross(to_start, w), m);
    const float last = vec3_dot(vec3_cross(to_end, w), m);
    const float first_slack = start * e + r * size + ROUNDING * start;
    const float last_slack = end * e + r * size + ROUNDING * end;
    return !(first > first_slack && last > last_slack) &&
           !(first < -first_slack && last < -last_slack);
}

typedef struct Builder {
    SpecularTree *tree;
    Job *job;
    float scale;
} Builder;

/* Place in units of the object and direction, so that one is worth as much as the other. */
static float coordinate(const Builder *builder, uint64_t i, int axis) {
    const LineBound *b = &builder->tree->cells[i].bound;
    const float values[6] = {b->center.x / builder->scale,
                             b->center.y / builder->scale,
                             b->center.z / builder->scale,
                             b->w.x,
                             b->w.y,
                             b->w.z};
    return values[axis];
}

static void swap_cells(SpecularCell *cells, uint64_t i, uint64_t j) {
    const SpecularCell cell = cells[i];
    cells[i] = cells[j];
    cells[j] = cell;
}

/* Orders cells begin .. end-1 so that the one that belongs at `middle` is there, smaller ones
 * before it and larger ones after it (Hoare's selection). */
static void select_middle(const Builder *builder, uint64_t begin, uint64_t end, uint64_t middle,
                          int axis) {
    SpecularCell *cells = builder->tree->cells;
    while (end - begin > 1) {
        const float pivot = coordinate(builder, begin + (end - begin) / 2, axis);
        uint64_t i = begin, j = end - 1;
        for (;;) {
            while (coordinate(builder, i, axis) < pivot)
                ++i;
            while (coordinate(builder, j, axis) > pivot)
                --j;
            if (i >= j)
                break;
            swap_cells(cells, i++, j--);
        }
        /* Cells before i are at most the pivot, cells from i on at least. */
        if (i == begin)
            ++i;
        if (middle < i)
            end = i;
        else
            begin = i;
    }
}

static LineBound bound_of(const Builder *builder, uint64_t begin, uint64_t end) {
    const SpecularCell *cells = builder->tree->cells;
    Vec3 low = cells[begin].bound.center, high = low;
    Vec3 w_low = cells[begin].bound.w, w_high = w_low;
    for (uint64_t i = begin + 1; i < end; ++i) {
        low = vec3_min(low, cells[i].bound.center);
        high = vec3_max(high, cells[i].bound.center);
        w_low = vec3_min(w_low, cells[i].bound.w);
        w_high = vec3_max(w_high, cells[i].bound.w);
    }
    LineBound bound = {.center = vec3_scale(vec3_add(low, high), 0.5f),
                       .w = vec3_scale(vec3_add(w_low, w_high), 0.5f)};
    for (uint64_t i = begin; i < end; ++i) {
        const LineBound *part = &cells[i].bound;
        const float place = vec3_length(vec3_sub(part->center, bound.center)) + part->radius;
        const float turn = vec3_length(vec3_sub(part->w, bound.w)) + part->spread;
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
            const float x = coordinate(builder, i, axis);
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

static AmbStatus build_node(Builder *builder, uint64_t begin, uint64_t end) {
    if (job_is_cancelled(builder->job))
        return AMB_CANCELLED;
    SpecularTree *tree = builder->tree;
    SpecularNode *node = &tree->nodes[tree->node_count++];
    *node = (SpecularNode){.bound = bound_of(builder, begin, end),
                           .first = (uint32_t)begin,
                           .count = (uint32_t)(end - begin)};
    if (end - begin <= LEAF_MAX)
        return AMB_OK;
    const uint64_t middle = begin + (end - begin) / 2;
    select_middle(builder, begin, end, middle, widest_axis(builder, begin, end));
    node->count = 0;
    AMB_TRY(build_node(builder, begin, middle));
    node->second = (uint32_t)tree->node_count;
    return build_node(builder, middle, end);
}

AmbStatus specular_tree_build(SpecularCell *cells, uint64_t cell_count, float scale, Job *job,
                              SpecularTree *out_tree) {
    *out_tree = (SpecularTree){.cells = cells, .cell_count = cell_count};
    /* Halves of more than LEAF_MAX cells: no more leaves than cells. */
    out_tree->nodes = memory_alloc_array(2 * cell_count, sizeof(SpecularNode));
    AmbStatus status = AMB_OK;
    if (out_tree->nodes == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the tree of lit triangles");
    Builder builder = {out_tree, job, scale};
    if (status == AMB_OK && cell_count > 0)
        status = build_node(&builder, 0, cell_count);
    if (status != AMB_OK)
        specular_tree_clear(out_tree);
    return status;
}

void specular_tree_clear(SpecularTree *tree) {
    memory_free(tree->cells);
    memory_free(tree->nodes);
    memset(tree, 0, sizeof *tree);
}
