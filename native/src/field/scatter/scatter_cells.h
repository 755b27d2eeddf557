/* SPDX-License-Identifier: GPL-3.0-or-later
 * The light inside one object by place, depth below the boundary, direction and order.
 *
 * Under a boundary radiance changes within a mean free path in depth, and along the boundary as
 * slowly as the light that falls on it. So a cell is what a cube of a coarse grid and a thin layer
 * of equal depth have in common: few photons are enough, whatever the shape, and how the boundary
 * cuts through cubes is known from the layers' own volumes. */
#ifndef AMB_FIELD_SCATTER_SCATTER_CELLS_H
#define AMB_FIELD_SCATTER_SCATTER_CELLS_H

#include "field/scatter/depth_grid.h"
#include "field/scatter/scatter.h"
#include "math/harmonics.h"

enum { LAYER_MAX = 64, SLOT_MAX = 3 };

/* The layers at one node of the grid, all between the first and the last that have a volume. */
typedef struct CellColumn {
    uint32_t first;     /* number of the cell of layer `low` */
    uint16_t low, high; /* low <= layer < high */
} CellColumn;

typedef struct ScatterCells {
    DepthGrid depth;
    const Medium *medium;
    Harmonics harmonics;
    Rgb scattering[HARMONIC_DEGREE_MAX + 1]; /* 1/m, by degree: sum over lobes of sigma_s c_l */
    Rgb forward;          /* 1/m, scattered straight on: sum over lobes of sigma_s f (lobe.h) */
    uint32_t slot_count;  /* orders kept apart: twice, more and, with a world, once */
    uint32_t float_count; /* of a cell's moments */
    uint32_t layer_count;
    float layers[LAYER_MAX + 1];                 /* m, where layers begin and end */
    float uniform_depth, layer_width, log_scale; /* of layer_at */
    Vec3 origin;
    float size; /* m, edge of a cube */
    uint32_t count[3];
    CellColumn *columns; /* by node */
    uint64_t cell_count;
    float *volumes; /* m^3, by cell: of its layer, weighted by the node's hat function; may be 0 */
    float *moments; /* by cell, slot, harmonic and RGB_: int L Y_lm over directions and the
                     * weighted volume, W m */
} ScatterCells;

/* Places cells and measures their volumes; moments are NULL then. size: edge of a cube. */
AmbStatus scatter_cells_build(const AmbScene *scene, uint32_t object, float size,
                              uint32_t slot_count, Job *job, ScatterCells *out_cells);
void scatter_cells_clear(ScatterCells *cells);
uint64_t scatter_cells_bytes(const ScatterCells *cells);

/* The layer of a depth >= 0, or layer_count below the last. */
static inline uint32_t scatter_layer_at(const ScatterCells *cells, float depth) {
    float layer = depth / cells->layer_width;
    if (depth > cells->uniform_depth)
        layer = cells->uniform_depth / cells->layer_width +
                cells->log_scale * logf(depth / cells->uniform_depth);
    return layer < (float)cells->layer_count ? (uint32_t)layer : cells->layer_count;
}

/* Adds a stretch of a photon, the flux times its length in W m, at p and a depth to the moments of
 * one node around p; u in [0,1) chooses it, so that each gets what its hat function says. False
 * where there is no cell. */
bool scatter_cells_add(const ScatterCells *cells, float *moments, uint32_t slot, Vec3 p,
                       uint32_t layer, Rgb stretch, const float *harmonics, const float u[3]);

/* See scatter_gather. */
ScatterRadiance scatter_cells_gather(const ScatterCells *cells, Vec3 o, Vec3 d, float length,
                                     Rgb forward, const Sample2 *u);

#endif
