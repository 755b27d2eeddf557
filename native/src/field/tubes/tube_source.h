/* SPDX-License-Identifier: GPL-3.0-or-later
 * Lamps with an extent as a few without one: cells, each with the extent that the gather of its
 * tubes averages over. */
#ifndef AMB_FIELD_TUBES_TUBE_SOURCE_H
#define AMB_FIELD_TUBES_TUBE_SOURCE_H

#include "scene/scene.h"

/* One cell of a lamp. */
typedef struct TubeSource {
    SceneLight light; /* with a point or direction of its own (an area light's is that of its
                       * middle); name is the scene's */
    Vec3 extent[2];   /* half of the cell along two axes: m, of a sun rad; 0: a point */
    float flux;       /* W of unit colour that reach the object, about; 0: not known */
} TubeSource;

enum { TUBE_CELLS_MAX = 6 }; /* along each axis */

/* Cells along each axis that a light is cut into for the object; 0 for a black one and a mesh. More
 * than TUBE_CELLS_MAX: the light is too large, seen from there, and gets that many. */
uint32_t tube_source_cells(const SceneLight *light, const SceneObject *object);

/* Cells of all lights for one object, in the order of lights. The caller frees *out_sources. */
AmbStatus tube_sources_create(const AmbScene *scene, uint32_t object, TubeSource **out_sources,
                              uint32_t *out_count);

#endif
