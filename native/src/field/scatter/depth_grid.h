/* SPDX-License-Identifier: GPL-3.0-or-later
 * How deep points of a medium lie below its boundary. */
#ifndef AMB_FIELD_SCATTER_DEPTH_GRID_H
#define AMB_FIELD_SCATTER_DEPTH_GRID_H

#include "scene/boundary.h"

/* Distance to the nearest surface of any object, m, positive inside one object's medium, at the
 * nodes of a grid over its bounding box. */
typedef struct DepthGrid {
    Vec3 origin;
    float spacing; /* m */
    uint32_t count[3];
    float *nodes;
} DepthGrid;

/* For cubes of edge `size`, m. */
AmbStatus depth_grid_build(const AmbScene *scene, uint32_t object, float size, Job *job,
                           DepthGrid *out_grid);
void depth_grid_clear(DepthGrid *grid);
uint64_t depth_grid_bytes(const DepthGrid *grid);

/* Eight nodes around a point, and where between them it is. */
typedef struct DepthCell {
    const float *low, *high; /* node of least coordinates, and the one above it along z */
    uint32_t row;
    float u, v, w;
} DepthCell;

/* False outside of the grid. */
static inline bool depth_grid_find(const DepthGrid *grid, Vec3 p, DepthCell *out) {
    const float x = (p.x - grid->origin.x) / grid->spacing;
    const float y = (p.y - grid->origin.y) / grid->spacing;
    const float z = (p.z - grid->origin.z) / grid->spacing;
    const uint32_t nx = grid->count[0], ny = grid->count[1];
    /* Before they become integers, which hold less. */
    if (!(x >= 0.0f && y >= 0.0f && z >= 0.0f) ||
        !(x < (float)(nx - 1) && y < (float)(ny - 1) && z < (float)(grid->count[2] - 1)))
        return false;
    const uint32_t i = (uint32_t)x, j = (uint32_t)y, k = (uint32_t)z;
    const float *low = grid->nodes + ((uint64_t)k * ny + j) * nx + i;
    *out = (DepthCell){low, low + (uint64_t)ny * nx, nx, x - (float)i, y - (float)j, z - (float)k};
    return true;
}

/* Linear between nodes. */
static inline float depth_cell_value(const DepthCell *cell) {
    const float *low = cell->low, *high = cell->high;
    const uint32_t row = cell->row;
    const float a = low[0] + cell->u * (low[1] - low[0]);
    const float b = low[row] + cell->u * (low[row + 1] - low[row]);
    const float c = high[0] + cell->u * (high[1] - high[0]);
    const float d = high[row] + cell->u * (high[row + 1] - high[row]);
    const float near = a + cell->v * (b - a), far = c + cell->v * (d - c);
    return near + cell->w * (far - near);
}

/* 0 outside of the grid. */
static inline float depth_grid_at(const DepthGrid *grid, Vec3 p) {
    DepthCell cell;
    return depth_grid_find(grid, p, &cell) ? depth_cell_value(&cell) : 0.0f;
}

/* Unit vector along which depth grows; 0 where it is not known. */
Vec3 depth_grid_normal(const DepthGrid *grid, Vec3 p);

/* No surface is nearer than this to a point of that depth. Between nodes a distance differs from
 * the true one by no more than the way to them, half a cell's diagonal; and what a node takes for
 * the nearest point of the surface may be a spacing away from it, two spacings away or more. */
static inline float depth_grid_free(const DepthGrid *grid, float depth) {
    return depth - (0.867f + 0.25f) * grid->spacing;
}

#endif
