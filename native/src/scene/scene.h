/* SPDX-License-Identifier: GPL-3.0-or-later
 * What is rendered: meshes placed in the world, their materials, lights, a camera. Filled through
 * the public interface, frozen by scene_commit, const afterwards. */
#ifndef AMB_SCENE_SCENE_H
#define AMB_SCENE_SCENE_H

#include <pthread.h>
#include <stdatomic.h>

#include "base/parallel.h"
#include "math/vec3.h"
#include "math/vec3d.h"
#include "optics/medium.h"
#include "scene/camera.h"
#include "scene/intersect.h"
#include "scene/light.h"
#include "scene/texture.h"
#include "scene/world.h"

typedef struct SceneMaterial {
    char *name;
    uint32_t surface;     /* AMB_SURFACE_* */
    Rgb albedo, emission; /* albedo: see scene_albedo */
    Rgb transmit_color, reflect_color;
    float ior;
    int32_t priority; /* where objects overlap the medium of the highest one holds */
    Medium medium;
    uint32_t texture; /* id, from 1; 0: none */
    float uv_to_texture[6];
} SceneMaterial;

typedef struct SceneMesh {
    char *name;
    uint32_t normal_domain; /* AMB_NORMALS_* */
    uint32_t user_count;    /* objects that place it */
    uint64_t vertex_count, triangle_count;
    Vec3 *positions;     /* object space */
    uint32_t *triangles; /* (triangle_count, 3) */
    Vec3 *normals;       /* per vertex or corner, or NULL */
    uint32_t *slots;     /* per triangle, or NULL */
    Vec2 *uvs;           /* per corner, or NULL */
} SceneMesh;

typedef struct SceneObject {
    char *name;
    uint32_t mesh;
    float to_world[16];
    uint32_t *materials;
    uint32_t material_count;
    /* From here on set by scene_commit; world space. */
    Vec3 *positions;
    Vec3 *normals;      /* unit, per vertex or corner; NULL: flat */
    bool is_flipped;    /* triangles wind the other way round: their normal is negated */
    bool is_inside_out; /* is_flipped though the transform does not mirror */
    bool is_boundary;   /* a triangle is dielectric */
    bool has_two_media; /* triangles of different dielectrics, of which one fills it */
    uint32_t inside;    /* material whose medium fills it: the dielectric of most triangles */
    bool may_touch;     /* its box meets that of another object */
    bool is_lamp;       /* what it emits is one of the lights, */
    double lamp_power;  /* and that is the light_mesh_power of this light */
    Vec3 low, high;     /* bounding box; low > high: no triangle */
    Vec3 center;        /* bounding sphere */
    float radius;
} SceneObject;

struct AmbScene {
    SceneTexture *textures;
    SceneMaterial *materials;
    SceneMesh *meshes;
    SceneObject *objects;
    SceneLight *lights;
    uint32_t texture_count, material_count, mesh_count, object_count, light_count;
    uint32_t texture_room, material_room, mesh_room, object_room, light_room;
    World world;
    uint32_t world_lamp_count; /* of lights: the last ones, taken out of the world's image; */
    uint32_t mesh_lamp_count;  /* before these: objects that emit light */
    SceneCamera camera;
    bool has_camera;
    bool is_committed;
    /* Places in a committed scene are counted from an origin of its own: see scene_commit. */
    Vec3d origin;
    Vec3 center;  /* bounding sphere of all objects */
    float radius; /* 0: empty scene */
    /* Built by the first render, under the lock; const once is_built. */
    pthread_mutex_t build_lock;
    bool is_built;
    Intersector *intersector;
    atomic_uint render_count; /* renders that read it: while there are, nothing of it may change */
};

/* A point of a boundary, as needed to refract there. */
typedef struct SurfacePoint {
    Vec3 p;  /* world */
    Vec3 ng; /* unit geometric normal, outward */
    Vec3 ns; /* unit shading normal, same side as ng */
    const SceneMaterial *material;
    uint32_t object;
    Hit hit; /* where it is on the mesh */
} SurfacePoint;

/* Transforms meshes to the world and freezes the scene. Errors name the object. */
AmbStatus scene_commit(AmbScene *scene);

/* Builds the ray accelerator if no render has done so yet. Cancellable. */
AmbStatus scene_build(AmbScene *scene, Job *job);

/* A camera in world coordinates; places it where the scene is committed. */
void scene_set_camera(AmbScene *scene, const SceneCamera *camera);

void scene_clear(AmbScene *scene);

/* A place in the world, counted from the scene's origin. */
Vec3 scene_place(const AmbScene *scene, Vec3 p);

/* Bytes of geometry and accelerator. */
uint64_t scene_bytes(const AmbScene *scene);

/* The nearest surface along unit d from p in (0, t_max); false: none. */
bool scene_intersect(const AmbScene *scene, Vec3 p, Vec3 d, float t_max, Hit *out_hit);

/* Everything along unit d from p in (0, t_max), ordered by object and triangle, `room` hits at
 * most; only for scenes in which an object may touch another. */
uint32_t scene_intersect_all(const AmbScene *scene, Vec3 p, Vec3 d, float t_max, Hit *out_hits,
                             uint32_t room);

/* Whether anything lies between. */
bool scene_is_occluded(const AmbScene *scene, Vec3 p, Vec3 d, float t_max);

/* The point of any object's surface that is nearest to p; false: none is nearer than reach. */
bool scene_closest(const AmbScene *scene, Vec3 p, float reach, Vec3 *out_point);

/* The point is a millionth inside of the triangle's edges: a path that goes on from it does not
 * slip between two triangles. */
SurfacePoint scene_surface(const AmbScene *scene, const Hit *hit);

/* Emission of an opaque surface that is not one of the lights': found by chance, where paths end on
 * it. The rest is found as that of lamps is. */
static inline Rgb scene_chance_emission(const AmbScene *scene, const SurfacePoint *surface) {
    const bool is_lamp = scene->objects[surface->object].is_lamp;
    return is_lamp ? rgb(0, 0, 0) : surface->material->emission;
}

/* Density with which shadow rays from p are sent to that place of a mesh that is a lamp, 1/sr. */
float scene_lamp_pdf(const SurfacePoint *surface, const SceneObject *object, Vec3 p);

const SceneMaterial *scene_material(const AmbScene *scene, const SceneObject *object,
                                    uint64_t triangle);

/* Whether their boxes meet, but for rounding. */
bool scene_boxes_meet(const SceneObject *a, const SceneObject *b);

/* Reflectance of an opaque surface there, its texture included. */
Rgb scene_albedo(const AmbScene *scene, const SurfacePoint *surface);

/* Exactly at u, v: the same bits for neighbours that share a corner or the middle of an edge. */
Vec3 scene_position(const AmbScene *scene, const Hit *hit);

/* Derivative of the shading normal at a hit for a displacement dp in the triangle's plane. */
Vec3 scene_normal_derivative(const AmbScene *scene, const Hit *hit, Vec3 dp);

/* Lines that left an object through a hole of its mesh, and the first object in the scene's order
 * that lost one: the same whatever the order of additions. */
typedef struct SceneLeaks {
    uint64_t count;
    uint32_t object;
} SceneLeaks;

static inline void scene_leaks_add(SceneLeaks *leaks, uint64_t count, uint32_t object) {
    if (count > 0 && (leaks->count == 0 || object < leaks->object))
        leaks->object = object;
    leaks->count += count;
}

/* Length of a stretch from p that meets nothing: through a hole in the mesh the medium would go on
 * for ever; it ends where the scene does. */
static inline float scene_end(const AmbScene *scene, Vec3 p) {
    return scene->radius + vec3_length(vec3_sub(p, scene->center));
}

/* A ray origin just off the surface on the side that d leaves to. */
Vec3 scene_leave(const SurfacePoint *surface, Vec3 d);

#endif
