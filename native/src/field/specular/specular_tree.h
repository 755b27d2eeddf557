/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hierarchy over the cells of a lit boundary that bounds where they are and where their refracted
 * light goes.
 *
 * [Walter09] prune triangles by the normals that could send light from the lamp to the eye: the
 * cone of half vectors, the spindle of places at which refraction can bend light far enough, and
 * the side of the face. All three say whether refracted light can have the direction that is
 * needed. Here lamps do not move between queries, so that cones of the refracted directions
 * themselves are stored; they bound the same more tightly, and whole segments instead of points. */
#ifndef AMB_FIELD_SPECULAR_SPECULAR_TREE_H
#define AMB_FIELD_SPECULAR_SPECULAR_TREE_H

#include "base/parallel.h"
#include "math/vec3d.h"
#include "scene/scene.h"

/* Light lines that start within a ball and go into a cone. */
typedef struct LineBound {
    Vec3 center;  /* m, world */
    float radius; /* m */
    Vec3 w;       /* middle of the directions, not unit */
    float spread; /* |direction - w| is at most this */
} LineBound;

/* A triangle under one light, or a part of it. */
typedef struct SpecularCell {
    LineBound bound;
    Vec3d w[3];          /* directions at its corners */
    Vec3 bend[3];        /* of the directions at the middles of the edges 01, 12, 20, less the mean
                          * of the edge's ends */
    float corners[3][2]; /* u, v */
    float reach;         /* m, the least distance from a corner, along its light, to a surface */
    const SceneMaterial *material;
    uint32_t triangle, light;
    uint8_t lit_corners; /* how many of them light reaches */
} SpecularCell;

enum { SPECULAR_CHILDREN = 8, SPECULAR_LEVEL_MAX = 12 };

/* Bounds of eight children side by side. */
typedef struct SpecularNode {
    float center[3][SPECULAR_CHILDREN];
    float radius[SPECULAR_CHILDREN];
    float w[3][SPECULAR_CHILDREN];
    float spread[SPECULAR_CHILDREN];
} SpecularNode;

/* Node i of level l > 0 has the nodes 8i .. 8i+7 of level l-1 as children, as far as they are
 * there, of level 0 the cells 8i .. 8i+7. */
typedef struct SpecularTree {
    SpecularCell *cells;
    SpecularNode *nodes;
    uint64_t cell_count, node_count;
    uint64_t first[SPECULAR_LEVEL_MAX]; /* index of a level's first node in nodes */
    uint64_t child_count[SPECULAR_LEVEL_MAX];
    uint32_t level_count;
} SpecularTree;

/* A camera segment. */
typedef struct BoundQuery {
    Vec3 o, d; /* d unit */
    float length;
} BoundQuery;

/* Bit k is set where a light line of child k may meet the segment; never clear where one does. */
uint32_t specular_children_met(const SpecularNode *node, const BoundQuery *query);

/* Takes the cells over (also on failure), and sorts them; scale: of the object, m. At most 2^31
 * cells; none make an empty tree. */
AmbStatus specular_tree_build(SpecularCell *cells, uint64_t cell_count, float scale, Job *job,
                              SpecularTree *out_tree);
void specular_tree_clear(SpecularTree *tree);

#endif
