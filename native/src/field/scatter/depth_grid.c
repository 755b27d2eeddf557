/* SPDX-License-Identifier: GPL-3.0-or-later
 * Depth below the boundary. */
#include "field/scatter/depth_grid.h"

#include "base/memory.h"

/* Along the longest side of the box. */
enum { CELLS_MIN = 12, CELLS_MAX = 48 };

/* Spacing, in edges of the cubes that the depths are for: what few photons blur needs no depth that
 * is finer. */
static const float SPACING = 0.35f;

/* Nodes this near to a surface, in spacings, ask for its nearest point; others take the best of
 * what their neighbours have. */
static const float REACH = 2.0f;

typedef struct Build {
    const AmbScene *scene;
    uint32_t object;
    DepthGrid *grid;
    Vec3 *closest; /* by node; infinite: not known yet */
} Build;

static Vec3 node_position(const DepthGrid *grid, uint64_t i, uint64_t j, uint64_t k) {
    return vec3(grid->origin.x + (float)i * grid->spacing,
                grid->origin.y + (float)j * grid->spacing,
                grid->origin.z + (float)k * grid->spacing);
}

static uint64_t node_index(const DepthGrid *grid, uint64_t i, uint64_t j, uint64_t k) {
    return (k * grid->count[1] + j) * grid->count[0] + i;
}

/* No farther than what is nearest to the neighbour before, and a little more: the fewer triangles
 * lie within reach, the faster is the answer. */
static float reach_of(const Build *build, uint64_t node, uint64_t i, Vec3 p) {
    const float reach = REACH * build->grid->spacing;
    if (i == 0 || !isfinite(build->grid->nodes[node - 1]))
        return reach;
    return fminf(reach, 1.001f * vec3_length(vec3_sub(build->closest[node - 1], p)) +
                            1e-3f * build->grid->spacing);
}

/* One layer of nodes near surfaces. */
static AmbStatus find_closest(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Build *build = user;
    const DepthGrid *grid = build->grid;
    for (uint64_t k = begin; k < end; ++k)
        for (uint64_t j = 0; j < grid->count[1]; ++j)
            for (uint64_t i = 0; i < grid->count[0]; ++i) {
                const Vec3 p = node_position(grid, i, j, k);
                const uint64_t node = node_index(grid, i, j, k);
                const float reach = reach_of(build, node, i, p);
                grid->nodes[node] = INFINITY;
                if (scene_closest(build->scene, p, reach, &build->closest[node]))
                    grid->nodes[node] = vec3_length(vec3_sub(build->closest[node], p));
            }
    return AMB_OK;
}

static void take_closer(const Build *build, uint64_t node, uint64_t other, Vec3 p) {
    if (!isfinite(build->grid->nodes[other]))
        return;
    const float distance = vec3_length(vec3_sub(build->closest[other], p));
    if (distance < build->grid->nodes[node]) {
        build->grid->nodes[node] = distance;
        build->closest[node] = build->closest[other];
    }
}

/* Carries nearest points along one axis, there or back. */
static void sweep(const Build *build, int axis, bool back) {
    const DepthGrid *grid = build->grid;
    uint64_t at[3];
    for (at[2] = 0; at[2] < grid->count[2]; ++at[2])
        for (at[1] = 0; at[1] < grid->count[1]; ++at[1])
            for (at[0] = 0; at[0] < grid->count[0]; ++at[0]) {
                uint64_t here[3] = {at[0], at[1], at[2]};
                if (back)
                    here[axis] = grid->count[axis] - 1 - at[axis];
                if (at[axis] == 0)
                    continue;
                uint64_t other[3] = {here[0], here[1], here[2]};
                other[axis] += back ? 1u : (uint64_t)-1;
                take_closer(build, node_index(grid, here[0], here[1], here[2]),
                            node_index(grid, other[0], other[1], other[2]),
                            node_position(grid, here[0], here[1], here[2]));
            }
}

static bool is_inside(const Build *build, Vec3 p) {
    const MediumStack stack = scene_media_at(build->scene, p);
    return stack.count > 0 && medium_stack_top(&stack) == build->object;
}

/* Signs of one layer. While the distance is larger than the step, no boundary lies between
 * neighbours. */
static AmbStatus find_signs(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    const Build *build = user;
    DepthGrid *grid = build->grid;
    for (uint64_t k = begin; k < end; ++k)
        for (uint64_t j = 0; j < grid->count[1]; ++j) {
            bool inside = false;
            float last = 0.0f;
            for (uint64_t i = 0; i < grid->count[0]; ++i) {
                float *node = &grid->nodes[node_index(grid, i, j, k)];
                if (last <= 1.3f * grid->spacing)
                    inside = is_inside(build, node_position(grid, i, j, k));
                last = *node;
                *node = inside ? last : -last;
            }
        }
    return AMB_OK;
}

AmbStatus depth_grid_build(const AmbScene *scene, uint32_t object, float size, Job *job,
                           DepthGrid *out_grid) {
    const SceneObject *shape = &scene->objects[object];
    const SceneMesh *mesh = &scene->meshes[shape->mesh];
    Vec3 low = shape->positions[0], high = low;
    for (uint64_t v = 1; v < mesh->vertex_count; ++v) {
        low = vec3_min(low, shape->positions[v]);
        high = vec3_max(high, shape->positions[v]);
    }
    const Vec3 extent = vec3_sub(high, low);
    const float side = vec3_max_component(extent);
    const float spacing = clampf(SPACING * size, side / (float)CELLS_MAX, side / (float)CELLS_MIN);
    *out_grid = (DepthGrid){.origin = vec3_sub(low, vec3(spacing, spacing, spacing)),
                            .spacing = spacing,
                            .count = {(uint32_t)(extent.x / spacing) + 4,
                                      (uint32_t)(extent.y / spacing) + 4,
                                      (uint32_t)(extent.z / spacing) + 4}};
    const uint64_t layer = (uint64_t)out_grid->count[0] * out_grid->count[1];
    const uint64_t count = layer * out_grid->count[2];
    out_grid->nodes = memory_alloc_array(count, sizeof *out_grid->nodes);
    Build build = {scene, object, out_grid, memory_alloc_array(count, sizeof(Vec3))};
    AmbStatus status = AMB_OK;
    if (out_grid->nodes == NULL || build.closest == NULL)
        status =
            status_fail(AMB_OUT_OF_MEMORY, "no memory for depths inside of \"%.60s\"", shape->name);
    if (status == AMB_OK)
        status = parallel_for(job, out_grid->count[2], 1, find_closest, &build);
    for (int pass = 0; status == AMB_OK && pass < 2; ++pass)
        for (int axis = 0; axis < 3; ++axis)
            for (int back = 0; back < 2; ++back)
                sweep(&build, axis, back == 1);
    if (status == AMB_OK)
        status = parallel_for(job, out_grid->count[2], 1, find_signs, &build);
    memory_free(build.closest);
    return status;
}

Vec3 depth_grid_normal(const DepthGrid *grid, Vec3 p) {
    DepthCell cell;
    if (!depth_grid_find(grid, p, &cell))
        return vec3(0, 0, 0);
    const float *low = cell.low, *high = cell.high;
    const uint32_t row = cell.row;
    const float u = cell.u, v = cell.v, w = cell.w;
    const float x = (1.0f - w) * ((1.0f - v) * (low[1] - low[0]) + v * (low[row + 1] - low[row])) +
                    w * ((1.0f - v) * (high[1] - high[0]) + v * (high[row + 1] - high[row]));
    const float y = (1.0f - w) * ((1.0f - u) * (low[row] - low[0]) + u * (low[row + 1] - low[1])) +
                    w * ((1.0f - u) * (high[row] - high[0]) + u * (high[row + 1] - high[1]));
    const float z = (1.0f - v) * ((1.0f - u) * (high[0] - low[0]) + u * (high[1] - low[1])) +
                    v * ((1.0f - u) * (high[row] - low[row]) + u * (high[row + 1] - low[row + 1]));
    const float length = sqrtf(x * x + y * y + z * z);
    return length > 0.0f ? vec3_scale(vec3(x, y, z), 1.0f / length) : vec3(0, 0, 0);
}

void depth_grid_clear(DepthGrid *grid) {
    memory_free(grid->nodes);
    grid->nodes = NULL;
}

uint64_t depth_grid_bytes(const DepthGrid *grid) {
    return (uint64_t)grid->count[0] * grid->count[1] * grid->count[2] * sizeof *grid->nodes;
}
