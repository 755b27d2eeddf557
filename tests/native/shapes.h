/* SPDX-License-Identifier: GPL-3.0-or-later
 * Meshes and small scenes for tests, through the public interface alone. */
#ifndef AMB_TESTS_SHAPES_H
#define AMB_TESTS_SHAPES_H

#include <stdbool.h>

#include "amberlight/amberlight.h"

typedef struct Shape {
    float *positions; /* (vertex_count, 3) */
    float *normals;   /* the same, unit, smooth */
    uint32_t *triangles;
    uint64_t vertex_count, triangle_count;
} Shape;

/* Unit sphere of rings of latitude and segments of longitude, counter-clockwise from outside;
 * 2 segments (rings - 1) triangles. */
Shape shape_sphere(uint32_t rings, uint32_t segments);
Shape shape_box(void);   /* [-1, 1]^3, 12 triangles */
Shape shape_plane(void); /* [-1, 1]^2 at z = 0, facing up */
void shape_free(Shape *shape);

/* The shape as a mesh; smooth ones get their vertex normals. */
AmbMesh shape_mesh(const Shape *shape, const char *name, bool is_smooth);

/* Adds the mesh and one object of it, scaled and moved. Returns the object's id. */
uint32_t shape_add(AmbScene *scene, const AmbMesh *mesh, uint32_t material, float scale, float x,
                   float y, float z);

/* Commits the scene, with a camera that nobody looks through. */
void shape_commit(AmbScene *scene);

/* A grey medium with one lobe behind a dielectric boundary. */
AmbMaterial shape_resin(float ior, float sigma_s, float sigma_a, float g);

#endif
