/* SPDX-License-Identifier: GPL-3.0-or-later
 * Meshes and small scenes for tests. */
#include "shapes.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "test.h"

static Shape shape_alloc(uint64_t vertex_count, uint64_t triangle_count) {
    Shape shape = {.vertex_count = vertex_count, .triangle_count = triangle_count};
    shape.positions = malloc(3 * vertex_count * sizeof(float));
    shape.normals = malloc(3 * vertex_count * sizeof(float));
    shape.triangles = malloc(3 * triangle_count * sizeof(uint32_t));
    if (shape.positions == NULL || shape.normals == NULL || shape.triangles == NULL)
        abort();
    return shape;
}

static void set3(float *out, double x, double y, double z) {
    out[0] = (float)x;
    out[1] = (float)y;
    out[2] = (float)z;
}

Shape shape_sphere(uint32_t rings, uint32_t segments) {
    const double pi = 3.14159265358979323846;
    /* Two poles, and rings - 1 circles between. */
    const uint32_t circles = rings - 1;
    Shape shape = shape_alloc(2 + circles * segments, 2 * (uint64_t)segments * circles);
    const uint32_t south = circles * segments, north = south + 1;
    for (uint32_t r = 0; r < circles; ++r)
        for (uint32_t s = 0; s < segments; ++s) {
            const double theta = pi * (r + 1.0) / rings, phi = 2.0 * pi * s / segments;
            set3(shape.positions + 3 * (r * segments + s), sin(theta) * cos(phi),
                 sin(theta) * sin(phi), -cos(theta));
        }
    set3(shape.positions + 3 * south, 0, 0, -1);
    set3(shape.positions + 3 * north, 0, 0, 1);
    memcpy(shape.normals, shape.positions, 3 * shape.vertex_count * sizeof(float));

    uint32_t *t = shape.triangles;
    for (uint32_t s = 0; s < segments; ++s) {
        const uint32_t n = (s + 1) % segments;
        *t++ = south, *t++ = n, *t++ = s;
        for (uint32_t r = 0; r + 1 < circles; ++r) {
            const uint32_t low = r * segments, high = low + segments;
            *t++ = low + s, *t++ = low + n, *t++ = high + n;
            *t++ = low + s, *t++ = high + n, *t++ = high + s;
        }
        const uint32_t top = (circles - 1) * segments;
        *t++ = north, *t++ = top + s, *t++ = top + n;
    }
    return shape;
}

Shape shape_box(void) {
    static const uint32_t triangles[36] = {0, 2, 3, 0, 3, 1, 4, 5, 7, 4, 7, 6, 0, 1, 5, 0, 5, 4,
                                           2, 6, 7, 2, 7, 3, 0, 4, 6, 0, 6, 2, 1, 3, 7, 1, 7, 5};
    Shape shape = shape_alloc(8, 12);
    for (int i = 0; i < 8; ++i) {
        const double x = i & 1 ? 1 : -1, y = i & 2 ? 1 : -1, z = i & 4 ? 1 : -1;
        set3(shape.positions + 3 * i, x, y, z);
        set3(shape.normals + 3 * i, x / sqrt(3.0), y / sqrt(3.0), z / sqrt(3.0));
    }
    memcpy(shape.triangles, triangles, sizeof triangles);
    return shape;
}

Shape shape_plane(void) {
    static const uint32_t triangles[6] = {0, 1, 3, 0, 3, 2};
    Shape shape = shape_alloc(4, 2);
    for (int i = 0; i < 4; ++i) {
        set3(shape.positions + 3 * i, i & 1 ? 1 : -1, i & 2 ? 1 : -1, 0);
        set3(shape.normals + 3 * i, 0, 0, 1);
    }
    memcpy(shape.triangles, triangles, sizeof triangles);
    return shape;
}

void shape_free(Shape *shape) {
    free(shape->positions);
    free(shape->normals);
    free(shape->triangles);
    memset(shape, 0, sizeof *shape);
}

AmbMesh shape_mesh(const Shape *shape, const char *name, bool is_smooth) {
    AmbMesh mesh;
    amb_mesh_init(&mesh);
    mesh.name = name;
    mesh.positions = shape->positions;
    mesh.triangles = shape->triangles;
    mesh.vertex_count = shape->vertex_count;
    mesh.triangle_count = shape->triangle_count;
    if (is_smooth) {
        mesh.normal_domain = AMB_NORMALS_VERTEX;
        mesh.normals = shape->normals;
    }
    return mesh;
}

uint32_t shape_add(AmbScene *scene, const AmbMesh *mesh, uint32_t material, float scale, float x,
                   float y, float z) {
    AmbObject object;
    amb_object_init(&object);
    object.name = mesh->name;
    object.materials = &material;
    object.material_count = 1;
    for (int i = 0; i < 3; ++i)
        object.to_world[5 * i] = scale;
    object.to_world[3] = x;
    object.to_world[7] = y;
    object.to_world[11] = z;
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_mesh(scene, mesh, &object.mesh), AMB_OK);
    ENSURE_STATUS(amb_scene_add_object(scene, &object, &id), AMB_OK);
    return id;
}

void shape_commit(AmbScene *scene) {
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
}

AmbMaterial shape_resin(float ior, float sigma_s, float sigma_a, float g) {
    AmbMaterial material;
    amb_material_init(&material);
    material.surface = AMB_SURFACE_DIELECTRIC;
    material.name = "resin";
    material.ior = ior;
    material.lobe_count = 1;
    material.lobes[0].g = g;
    for (int k = 0; k < 3; ++k) {
        material.sigma_a[k] = sigma_a;
        material.lobes[0].sigma_s[k] = sigma_s;
    }
    return material;
}
