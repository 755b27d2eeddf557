/* SPDX-License-Identifier: GPL-3.0-or-later
 * Placing meshes in the world, and asking rays about them. */
#include "scene/scene.h"

#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "math/mat4.h"
#include "scene/mesh_lamps.h"
#include "scene/world_lamps.h"

static const uint32_t *corner_indices(const SceneMesh *mesh, uint64_t triangle) {
    return mesh->triangles + 3 * triangle;
}

static uint32_t triangle_material(const SceneMesh *mesh, const SceneObject *object,
                                  uint64_t triangle) {
    const uint32_t slot = mesh->slots != NULL ? mesh->slots[triangle] : 0;
    return object->materials[slot < object->material_count ? slot : object->material_count - 1];
}

const SceneMaterial *scene_material(const AmbScene *scene, const SceneObject *object,
                                    uint64_t triangle) {
    return &scene->materials[triangle_material(&scene->meshes[object->mesh], object, triangle)];
}

/* Whether the triangles wind clockwise seen from outside: the volume that they enclose is
 * negative. The sum is taken from the object's own centre, so that a mesh far from the origin
 * keeps its digits. An open mesh encloses next to nothing, and is left as it is. */
static bool is_wound_inward(const SceneMesh *mesh, const SceneObject *object) {
    double volume = 0.0, size = 0.0;
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        const uint32_t *i = corner_indices(mesh, t);
        const Vec3 a = vec3_sub(object->positions[i[0]], object->center);
        const Vec3 b = vec3_sub(object->positions[i[1]], object->center);
        const Vec3 c = vec3_sub(object->positions[i[2]], object->center);
        const double part = (double)vec3_dot(a, vec3_cross(b, c));
        volume += part;
        size += fabs(part);
    }
    return volume < -1e-4 * size;
}

/* Finds what fills an object. */
static AmbStatus choose_medium(const AmbScene *scene, SceneObject *object) {
    const SceneMesh *mesh = &scene->meshes[object->mesh];
    uint64_t *counts = memory_zero_array(scene->material_count, sizeof *counts);
    if (counts == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to place \"%s\"", object->name);
    for (uint64_t t = 0; t < mesh->triangle_count; ++t)
        ++counts[triangle_material(mesh, object, t)];
    uint64_t most = 0;
    for (uint32_t m = 0; m < scene->material_count; ++m) {
        if (scene->materials[m].surface != AMB_SURFACE_DIELECTRIC || counts[m] == 0)
            continue;
        object->has_two_media = object->is_boundary;
        object->is_boundary = true;
        if (counts[m] > most) {
            most = counts[m];
            object->inside = m;
        }
    }
    memory_free(counts);
    return AMB_OK;
}

/* Where the corners of a triangle are, beginning with the least: equal for triangles that lie on
 * each other and wind alike, whatever vertices they have. */
typedef struct Place {
    uint32_t words[9]; /* the bits of three points */
} Place;
_Static_assert(sizeof(Place) == 3 * sizeof(Vec3), "three points");

static Place place_of(const SceneMesh *mesh, uint64_t triangle) {
    const uint32_t *i = corner_indices(mesh, triangle);
    int least = 0;
    for (int k = 1; k < 3; ++k) {
        const Vec3 a = mesh->positions[i[k]], b = mesh->positions[i[least]];
        if (a.x < b.x || (a.x == b.x && (a.y < b.y || (a.y == b.y && a.z < b.z))))
            least = k;
    }
    Place place;
    for (int k = 0; k < 3; ++k) {
        const Vec3 p = mesh->positions[i[(least + k) % 3]];
        const Vec3 plain = vec3_add(p, vec3(0, 0, 0)); /* no -0: it has other bits than 0 */
        memcpy(place.words + 3 * k, &plain, sizeof plain);
    }
    return place;
}

static uint64_t hash_place(const Place *place) {
    uint64_t hash = 0;
    for (size_t i = 0; i < sizeof place->words / sizeof place->words[0]; ++i) {
        hash = (hash ^ place->words[i]) * UINT64_C(0x9E3779B97F4A7C15);
        hash ^= hash >> 29;
    }
    return hash;
}

/* Makes points of triangles that lie on another one: light would enter through each of them. */
static AmbStatus drop_duplicates(SceneMesh *mesh) {
    enum { NONE = UINT32_MAX };
    uint64_t room = 16;
    while (room < 2 * mesh->triangle_count)
        room *= 2;
    uint32_t *table = memory_alloc_array(room, sizeof *table);
    if (table == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to check the mesh \"%s\"", mesh->name);
    memset(table, 0xFF, room * sizeof *table);
    for (uint64_t t = 0; t < mesh->triangle_count; ++t) {
        const Place place = place_of(mesh, t);
        uint64_t slot = hash_place(&place) & (room - 1);
        bool is_duplicate = false;
        for (; table[slot] != (uint32_t)NONE && !is_duplicate; slot = (slot + 1) & (room - 1)) {
            const Place other = place_of(mesh, table[slot]);
            is_duplicate = memcmp(&place, &other, sizeof place) == 0;
        }
        uint32_t *corners = mesh->triangles + 3 * t;
        if (is_duplicate)
            corners[1] = corners[2] = corners[0];
        else
            table[slot] = (uint32_t)t;
    }
    memory_free(table);
    return AMB_OK;
}

static void bound_object(const SceneMesh *mesh, SceneObject *object) {
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY);
    Vec3 high = vec3_negate(low);
    for (uint64_t t = 0; t < 3 * mesh->triangle_count; ++t) {
        const Vec3 p = object->positions[mesh->triangles[t]];
        low = vec3_min(low, p);
        high = vec3_max(high, p);
    }
    object->low = low;
    object->high = high;
    object->center = vec3(0, 0, 0);
    object->radius = 0.0f;
    if (mesh->triangle_count == 0)
        return;
    object->center = vec3_scale(vec3_add(low, high), 0.5f);
    float radius2 = 0.0f;
    for (uint64_t t = 0; t < 3 * mesh->triangle_count; ++t) {
        const Vec3 d = vec3_sub(object->positions[mesh->triangles[t]], object->center);
        radius2 = fmaxf(radius2, vec3_dot(d, d));
    }
    object->radius = sqrtf(radius2);
}

/* Shading normals in the world; a normal that is no direction becomes zero, which scene_surface
 * replaces by the face's own. */
static AmbStatus place_normals(const SceneMesh *mesh, SceneObject *object) {
    const uint64_t count =
        mesh->normal_domain == AMB_NORMALS_VERTEX ? mesh->vertex_count : 3 * mesh->triangle_count;
    object->normals = memory_alloc_array(count, sizeof(Vec3));
    if (object->normals == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the normals of \"%s\"", object->name);
    for (uint64_t i = 0; i < count; ++i)
        object->normals[i] = mat4_normal(object->to_world, mesh->normals[i]);
    return AMB_OK;
}

/* Coordinates of objects: beyond, the squares of areas overflow and faces have no normals. */
static const float POSITION_MAX = 1e9f;

static bool is_within_range(Vec3 p) {
    return fabsf(p.x) <= POSITION_MAX && fabsf(p.y) <= POSITION_MAX && fabsf(p.z) <= POSITION_MAX;
}

static AmbStatus place_object(AmbScene *scene, SceneObject *object, Vec3d origin) {
    const SceneMesh *mesh = &scene->meshes[object->mesh];
    /* One more vertex: Embree reads 16 bytes at each. */
    object->positions = memory_alloc_array(mesh->vertex_count + 1, sizeof(Vec3));
    if (object->positions == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to place \"%s\"", object->name);
    for (uint64_t i = 0; i < mesh->vertex_count; ++i) {
        const Vec3d place = mat4_point(object->to_world, mesh->positions[i]);
        object->positions[i] = vec3d_round(vec3d_sub(place, origin));
        if (!vec3_is_finite(object->positions[i]))
            return status_fail(AMB_INVALID_ARGUMENT,
                               "vertex %llu of \"%s\" is not finite in world space",
                               (unsigned long long)i, object->name);
        if (!is_within_range(object->positions[i]))
            return status_fail(AMB_INVALID_ARGUMENT,
                               "vertex %llu of \"%s\" lies farther than %g away",
                               (unsigned long long)i, object->name, (double)POSITION_MAX);
    }
    object->positions[mesh->vertex_count] = vec3(0, 0, 0);
    if (mesh->normals != NULL)
        AMB_TRY(place_normals(mesh, object));
    bound_object(mesh, object);

    /* Shading normals follow the geometric side in scene_surface. */
    object->is_flipped = is_wound_inward(mesh, object);
    object->is_inside_out = object->is_flipped != (mat4_determinant(object->to_world) < 0.0);
    return choose_medium(scene, object);
}

static void release_placement(SceneObject *object) {
    memory_free(object->positions);
    memory_free(object->normals);
    object->positions = NULL;
    object->normals = NULL;
}

static void bound_scene(AmbScene *scene) {
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY);
    Vec3 high = vec3_negate(low);
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        const SceneObject *object = &scene->objects[i];
        if (scene->meshes[object->mesh].triangle_count == 0)
            continue;
        const Vec3 r = vec3(object->radius, object->radius, object->radius);
        low = vec3_min(low, vec3_sub(object->center, r));
        high = vec3_max(high, vec3_add(object->center, r));
    }
    scene->center = vec3(0, 0, 0);
    scene->radius = 0.0f;
    if (low.x <= high.x) {
        scene->center = vec3_scale(vec3_add(low, high), 0.5f);
        scene->radius = 0.5f * vec3_length(vec3_sub(high, low));
    }
}

/* What rounding moves and scene_leave skips, beside coordinates of this box. */
static float room_around(const SceneObject *object) {
    const Vec3 far = vec3_max(vec3_negate(object->low), object->high);
    return 1e-5f * fmaxf(fmaxf(far.x, far.y), far.z);
}

bool scene_boxes_meet(const SceneObject *a, const SceneObject *b) {
    const float room = fmaxf(room_around(a), room_around(b));
    return a->low.x <= b->high.x + room && b->low.x <= a->high.x + room &&
           a->low.y <= b->high.y + room && b->low.y <= a->high.y + room &&
           a->low.z <= b->high.z + room && b->low.z <= a->high.z + room;
}

/* An object by where it begins along an axis. */
typedef struct Beginning {
    float low, high;
    uint32_t object;
} Beginning;

static int compare_beginnings(const void *a, const void *b) {
    const float x = ((const Beginning *)a)->low, y = ((const Beginning *)b)->low;
    return (x > y) - (x < y);
}

/* Only boundaries ask what touches them. */
static AmbStatus find_neighbours(AmbScene *scene) {
    Beginning *order = memory_alloc_array(scene->object_count, sizeof *order);
    if (order == NULL && scene->object_count > 0)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for %u objects", scene->object_count);
    Vec3 low = vec3(INFINITY, INFINITY, INFINITY), high = vec3_negate(low);
    float room = 0.0f;
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        const SceneObject *object = &scene->objects[i];
        if (!(object->low.x <= object->high.x))
            continue;
        low = vec3_min(low, object->low);
        high = vec3_max(high, object->low);
        room = fmaxf(room, room_around(object));
    }
    /* Along the axis where they are spread most, few begin before another ends. */
    const Vec3 spread = vec3_sub(high, low);
    const bool is_x = spread.x >= spread.y && spread.x >= spread.z, is_y = spread.y >= spread.z;
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        const Vec3 a = scene->objects[i].low, b = scene->objects[i].high;
        order[i] = is_x   ? (Beginning){a.x, b.x, i}
                   : is_y ? (Beginning){a.y, b.y, i}
                          : (Beginning){a.z, b.z, i};
    }
    if (scene->object_count > 1)
        qsort(order, scene->object_count, sizeof *order, compare_beginnings);
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        SceneObject *a = &scene->objects[order[i].object];
        for (uint32_t k = i + 1; k < scene->object_count && order[k].low <= order[i].high + room;
             ++k) {
            SceneObject *b = &scene->objects[order[k].object];
            const bool asks_a = a->is_boundary && !a->may_touch;
            const bool asks_b = b->is_boundary && !b->may_touch;
            if ((asks_a || asks_b) && scene_boxes_meet(a, b)) {
                a->may_touch |= asks_a;
                b->may_touch |= asks_b;
            }
        }
    }
    memory_free(order);
    return AMB_OK;
}

static AmbStatus add_world_lamp(AmbScene *scene, const WorldLamp *lamp) {
    SceneLight light = {.name = memory_copy_text("sun of the world's image"),
                        .kind = AMB_LIGHT_SUN,
                        .direction = vec3_negate(lamp->direction),
                        .angle = lamp->angle};
    if (light.name == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a light");
    vec3_frame(light.direction, &light.x, &light.y);
    light_set_sun(&light, lamp->irradiance);
    scene->lights[scene->light_count++] = light;
    ++scene->world_lamp_count;
    return AMB_OK;
}

/* What light_from_world and light_from_meshes did. */
static void return_lamps(AmbScene *scene) {
    const uint32_t given = scene->light_count - scene->world_lamp_count - scene->mesh_lamp_count;
    if (scene->mesh_lamp_count > 0) {
        SceneLight *meshes = scene->lights + given;
        mesh_lamps_clear(meshes, scene->mesh_lamp_count);
        memmove(meshes, meshes + scene->mesh_lamp_count, scene->world_lamp_count * sizeof *meshes);
        scene->light_count -= scene->mesh_lamp_count;
        scene->mesh_lamp_count = 0;
    }
    for (uint32_t i = 0; i < scene->object_count; ++i)
        scene->objects[i].is_lamp = false;
    for (; scene->world_lamp_count > 0; --scene->world_lamp_count)
        memory_free(scene->lights[--scene->light_count].name);
    world_return_lamps(&scene->world);
}

static AmbStatus make_room_for_lights(AmbScene *scene, uint32_t count) {
    SceneLight *lights = memory_alloc_array((uint64_t)scene->light_count + count, sizeof *lights);
    if (lights == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for lights");
    if (scene->light_count > 0)
        memcpy(lights, scene->lights, scene->light_count * sizeof *lights);
    memory_free(scene->lights);
    scene->lights = lights;
    scene->light_room = scene->light_count + count;
    return AMB_OK;
}

/* Meshes that emit light become lamps, before those of the world's image. */
static AmbStatus light_from_meshes(AmbScene *scene) {
    SceneLight lamps[MESH_LAMPS_MAX];
    uint32_t count = 0;
    AMB_TRY(mesh_lamps_take(scene, lamps, &count));
    if (count == 0)
        return AMB_OK;
    const AmbStatus status = make_room_for_lights(scene, count);
    if (status != AMB_OK) {
        mesh_lamps_clear(lamps, count);
        return status;
    }
    SceneLight *place = scene->lights + scene->light_count - scene->world_lamp_count;
    memmove(place + count, place, scene->world_lamp_count * sizeof *place);
    memcpy(place, lamps, count * sizeof *place);
    scene->light_count += count;
    scene->mesh_lamp_count = count;
    return AMB_OK;
}

/* Suns in the world's image become lamps. */
static AmbStatus light_from_world(AmbScene *scene) {
    WorldLamp lamps[WORLD_LAMPS_MAX];
    uint32_t count = 0;
    AMB_TRY(world_take_lamps(&scene->world, lamps, &count));
    AMB_TRY(world_prepare(&scene->world));
    if (count == 0)
        return AMB_OK;
    AMB_TRY(make_room_for_lights(scene, count));
    for (uint32_t i = 0; i < count; ++i)
        AMB_TRY(add_world_lamp(scene, &lamps[i]));
    return AMB_OK;
}

/* How far from the origin of the world a scene may be, in units of its own extent, before it gets
 * an origin of its own: the last that costs single precision no more than two bits. */
static const double ORIGIN_EXTENTS = 4.0;

/* Where coordinates are counted from: 0 for scenes near the origin of the world, whose numbers then
 * stay as they are given, else a place near the objects. A multiple of a power of two above their
 * extent, so that differences of coordinates are exact. */
static Vec3d choose_origin(const AmbScene *scene) {
    Vec3d low = {(double)INFINITY, (double)INFINITY, (double)INFINITY};
    Vec3d high = vec3d_negate(low);
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        const SceneMesh *mesh = &scene->meshes[scene->objects[i].mesh];
        for (uint64_t v = 0; v < (mesh->triangle_count > 0 ? mesh->vertex_count : 0); ++v) {
            const Vec3d p = mat4_point(scene->objects[i].to_world, mesh->positions[v]);
            low = (Vec3d){fmin(low.x, p.x), fmin(low.y, p.y), fmin(low.z, p.z)};
            high = (Vec3d){fmax(high.x, p.x), fmax(high.y, p.y), fmax(high.z, p.z)};
        }
    }
    const Vec3d none = {0.0, 0.0, 0.0};
    const double extent = fmax(fmax(high.x - low.x, high.y - low.y), high.z - low.z);
    if (!(extent > 0.0) || !isfinite(extent))
        return none;
    int exponent;
    frexp(ORIGIN_EXTENTS * extent, &exponent);
    const double step = ldexp(1.0, exponent);
    const Vec3d middle = vec3d_scale(vec3d_add(low, high), 0.5 / step);
    return vec3d_scale((Vec3d){round(middle.x), round(middle.y), round(middle.z)}, step);
}

Vec3 scene_place(const AmbScene *scene, Vec3 p) {
    return vec3d_round(vec3d_sub(vec3d_from(p), scene->origin));
}

static void place_camera(AmbScene *scene) {
    scene->camera.position = scene_place(scene, scene->camera.position);
    scene->camera.target = scene->center;
    scene->camera.target_radius = scene->radius;
}

static AmbStatus place_all(AmbScene *scene) {
    AmbStatus status = AMB_OK;
    for (uint32_t i = 0; i < scene->mesh_count && status == AMB_OK; ++i)
        status = drop_duplicates(&scene->meshes[i]);
    const Vec3d origin = choose_origin(scene);
    scene->origin = origin;
    for (uint32_t i = 0; i < scene->object_count && status == AMB_OK; ++i)
        status = place_object(scene, &scene->objects[i], origin);
    if (status == AMB_OK)
        status = find_neighbours(scene);
    if (status == AMB_OK)
        status = light_from_world(scene);
    if (status == AMB_OK)
        status = light_from_meshes(scene);
    if (status != AMB_OK) {
        return_lamps(scene);
        for (uint32_t i = 0; i < scene->object_count; ++i)
            release_placement(&scene->objects[i]);
        return status;
    }
    bound_scene(scene);
    for (uint32_t i = 0; i < scene->light_count; ++i)
        if (scene->lights[i].kind != LIGHT_MESH) /* these are there */
            scene->lights[i].position = scene_place(scene, scene->lights[i].position);
    place_camera(scene);
    return AMB_OK;
}

AmbStatus scene_commit(AmbScene *scene) {
    if (!scene->has_camera)
        return status_fail(AMB_INVALID_ARGUMENT, "the scene has no camera");
    /* What a render may take is not known yet: nearly all that the machine has, so that it does not
     * begin to swap. */
    const uint64_t machine = memory_of_machine();
    MemoryLimit limit = {.bytes = machine - machine / 8};
    atomic_init(&limit.refused, 0);
    memory_set_limit(&limit);
    AmbStatus status = place_all(scene);
    memory_set_limit(NULL);
    const uint64_t wanted = atomic_load(&limit.refused);
    if (status == AMB_OUT_OF_MEMORY && wanted > 0) {
        AmbErrorInfo info;
        status_copy_record(&info);
        status = status_fail(
            status, "%.130s: it makes %llu MiB in all, and the machine has %llu MiB", info.message,
            (unsigned long long)(wanted >> 20), (unsigned long long)(machine >> 20));
    }
    scene->is_committed = status == AMB_OK;
    return status;
}

void scene_set_camera(AmbScene *scene, const SceneCamera *camera) {
    scene->camera = *camera;
    scene->has_camera = true;
    if (scene->is_committed)
        place_camera(scene);
}

static AmbStatus build_intersector(AmbScene *scene, Job *job) {
    Intersector *intersector = NULL;
    AMB_TRY(intersector_create(job->thread_count, &intersector));
    AmbStatus status = AMB_OK;
    bool may_touch = false;
    for (uint32_t i = 0; i < scene->object_count && status == AMB_OK; ++i) {
        const SceneMesh *mesh = &scene->meshes[scene->objects[i].mesh];
        may_touch = may_touch || scene->objects[i].may_touch;
        status = intersector_add(intersector, scene->objects[i].positions, mesh->vertex_count,
                                 mesh->triangles, mesh->triangle_count);
    }
    if (may_touch)
        intersector_enable_all(intersector);
    if (status == AMB_OK)
        status = intersector_commit(intersector, job);
    if (status != AMB_OK) {
        intersector_destroy(intersector);
        return status;
    }
    scene->intersector = intersector;
    return AMB_OK;
}

AmbStatus scene_build(AmbScene *scene, Job *job) {
    /* Another render may hold the lock for as long as a build takes; a cancel must not wait. */
    while (pthread_mutex_trylock(&scene->build_lock) != 0) {
        if (job_is_cancelled(job))
            return AMB_CANCELLED;
        clock_sleep(0.01);
    }
    AmbStatus status = AMB_OK;
    if (!scene->is_built) {
        status = build_intersector(scene, job);
        scene->is_built = status == AMB_OK;
    }
    pthread_mutex_unlock(&scene->build_lock);
    return status;
}

void scene_clear(AmbScene *scene) {
    intersector_destroy(scene->intersector);
    for (uint32_t i = 0; i < scene->texture_count; ++i) {
        memory_free(scene->textures[i].name);
        memory_free(scene->textures[i].pixels);
    }
    for (uint32_t i = 0; i < scene->material_count; ++i)
        memory_free(scene->materials[i].name);
    for (uint32_t i = 0; i < scene->mesh_count; ++i) {
        SceneMesh *mesh = &scene->meshes[i];
        memory_free(mesh->name);
        memory_free(mesh->positions);
        memory_free(mesh->triangles);
        memory_free(mesh->normals);
        memory_free(mesh->slots);
        memory_free(mesh->uvs);
    }
    for (uint32_t i = 0; i < scene->object_count; ++i) {
        release_placement(&scene->objects[i]);
        memory_free(scene->objects[i].name);
        memory_free(scene->objects[i].materials);
    }
    for (uint32_t i = 0; i < scene->light_count; ++i) {
        memory_free(scene->lights[i].name);
        light_mesh_destroy(scene->lights[i].mesh);
    }
    memory_free(scene->textures);
    memory_free(scene->materials);
    memory_free(scene->meshes);
    memory_free(scene->objects);
    memory_free(scene->lights);
    world_clear(&scene->world);
    memset(scene, 0, sizeof *scene);
}

uint64_t scene_bytes(const AmbScene *scene) {
    uint64_t bytes = scene->intersector != NULL ? intersector_bytes(scene->intersector) : 0;
    for (uint32_t i = 0; i < scene->mesh_count; ++i) {
        const SceneMesh *mesh = &scene->meshes[i];
        const uint64_t normals = mesh->normals == NULL ? 0
                                 : mesh->normal_domain == AMB_NORMALS_VERTEX
                                     ? mesh->vertex_count
                                     : 3 * mesh->triangle_count;
        bytes += (1 + mesh->user_count) * (mesh->vertex_count + normals) * sizeof(Vec3);
        bytes += mesh->triangle_count * sizeof(uint32_t) * (mesh->slots != NULL ? 4 : 3);
        bytes += mesh->uvs != NULL ? 3 * mesh->triangle_count * sizeof(Vec2) : 0;
    }
    for (uint32_t i = 0; i < scene->texture_count; ++i)
        bytes += (uint64_t)scene->textures[i].width * scene->textures[i].height * sizeof(Rgb);
    return bytes + world_bytes(&scene->world);
}

bool scene_intersect(const AmbScene *scene, Vec3 p, Vec3 d, float t_max, Hit *out_hit) {
    return intersector_nearest(scene->intersector, p, d, t_max, out_hit);
}

uint32_t scene_intersect_all(const AmbScene *scene, Vec3 p, Vec3 d, float t_max, Hit *out_hits,
                             uint32_t room) {
    return intersector_all(scene->intersector, p, d, t_max, out_hits, room);
}

bool scene_is_occluded(const AmbScene *scene, Vec3 p, Vec3 d, float t_max) {
    return intersector_any(scene->intersector, p, d, t_max);
}

bool scene_closest(const AmbScene *scene, Vec3 p, float reach, Vec3 *out_point) {
    return intersector_closest(scene->intersector, p, reach, out_point);
}

typedef struct Triangle {
    Vec3 p[3];
    Vec3 n[3]; /* shading normals */
    bool has_normals;
} Triangle;

static Triangle triangle_at(const AmbScene *scene, const Hit *hit) {
    const SceneObject *object = &scene->objects[hit->geometry];
    const SceneMesh *mesh = &scene->meshes[object->mesh];
    const uint32_t *i = corner_indices(mesh, hit->triangle);
    Triangle triangle;
    triangle.has_normals = object->normals != NULL;
    for (uint32_t k = 0; k < 3; ++k) {
        triangle.p[k] = object->positions[i[k]];
        if (triangle.has_normals)
            triangle.n[k] =
                object->normals[mesh->normal_domain == AMB_NORMALS_VERTEX ? i[k]
                                                                          : 3 * hit->triangle + k];
    }
    return triangle;
}

/* A hit on an edge is rounded to either side of it, and a path that goes on from the wrong side has
 * left its object without crossing the boundary. Points are therefore taken a millionth of the
 * way towards the triangle's middle. */
static Hit inside_edges(const Hit *hit) {
    static const float SHRINK = 1e-6f;
    Hit inner = *hit;
    inner.u += SHRINK * (1.0f / 3.0f - hit->u);
    inner.v += SHRINK * (1.0f / 3.0f - hit->v);
    return inner;
}

static Vec3 interpolate(const Vec3 v[3], const Hit *hit) {
    const float w = 1.0f - hit->u - hit->v;
    return vec3_madd(vec3_madd(vec3_scale(v[0], w), hit->u, v[1]), hit->v, v[2]);
}

Vec3 scene_position(const AmbScene *scene, const Hit *hit) {
    const Triangle triangle = triangle_at(scene, hit);
    return interpolate(triangle.p, hit);
}

SurfacePoint scene_surface(const AmbScene *scene, const Hit *hit) {
    const SceneObject *object = &scene->objects[hit->geometry];
    const Triangle triangle = triangle_at(scene, hit);
    SurfacePoint surface;
    const Hit inner = inside_edges(hit);
    surface.p = interpolate(triangle.p, &inner);
    /* A face without area has none, which vec3_is_finite tells; no ray meets it. */
    const Vec3d area = vec3d_area(triangle.p[0], triangle.p[1], triangle.p[2]);
    const double size = vec3d_length(area);
    surface.ng = vec3d_round(vec3d_scale(area, size > 0.0 ? 1.0 / size : (double)NAN));
    if (object->is_flipped)
        surface.ng = vec3_negate(surface.ng);
    surface.ns = surface.ng;
    if (triangle.has_normals) {
        const Vec3 n = interpolate(triangle.n, hit);
        const float length = vec3_length(n);
        const float side = vec3_dot(n, surface.ng);
        /* Opposed to the face by winding alone, a smooth normal is still a good one. */
        if (length > 0.0f && side != 0.0f)
            surface.ns = vec3_scale(n, copysignf(1.0f / length, side));
    }
    surface.material = scene_material(scene, object, hit->triangle);
    surface.object = hit->geometry;
    surface.hit = *hit;
    return surface;
}

Rgb scene_albedo(const AmbScene *scene, const SurfacePoint *surface) {
    const SceneMaterial *material = surface->material;
    if (material->texture == 0)
        return material->albedo;
    const SceneMesh *mesh = &scene->meshes[scene->objects[surface->object].mesh];
    Vec2 uv = {0.0f, 0.0f};
    if (mesh->uvs != NULL) {
        const Hit *hit = &surface->hit;
        const Vec2 *uvs = mesh->uvs + 3 * (uint64_t)hit->triangle;
        const float w = 1.0f - hit->u - hit->v;
        uv = (Vec2){w * uvs[0].x + hit->u * uvs[1].x + hit->v * uvs[2].x,
                    w * uvs[0].y + hit->u * uvs[1].y + hit->v * uvs[2].y};
    }
    const float *m = material->uv_to_texture;
    const Vec2 place = {m[0] * uv.x + m[1] * uv.y + m[2], m[3] * uv.x + m[4] * uv.y + m[5]};
    return rgb_mul(material->albedo, texture_color(&scene->textures[material->texture - 1], place));
}

Vec3 scene_normal_derivative(const AmbScene *scene, const Hit *hit, Vec3 dp) {
    const Triangle triangle = triangle_at(scene, hit);
    if (!triangle.has_normals)
        return vec3(0, 0, 0);
    const Vec3d from = vec3d_from(triangle.p[0]), d = vec3d_from(dp);
    const Vec3d e1 = vec3d_sub(vec3d_from(triangle.p[1]), from);
    const Vec3d e2 = vec3d_sub(vec3d_from(triangle.p[2]), from);
    const Vec3d area = vec3d_cross(e1, e2);
    const double scale = 1.0 / vec3d_dot(area, area);
    const float du = (float)(vec3d_dot(vec3d_cross(d, e2), area) * scale);
    const float dv = (float)(vec3d_dot(vec3d_cross(e1, d), area) * scale);
    const Vec3 n = interpolate(triangle.n, hit);
    const float length = vec3_length(n);
    if (!(length > 0.0f))
        return vec3(0, 0, 0);
    Vec3 dn = vec3_scale(vec3_sub(triangle.n[1], triangle.n[0]), du);
    dn = vec3_madd(dn, dv, vec3_sub(triangle.n[2], triangle.n[0]));
    /* Of the normalised normal: the part along it only changes its length. */
    const Vec3 unit = vec3_scale(n, 1.0f / length);
    dn = vec3_scale(vec3_madd(dn, -vec3_dot(dn, unit), unit), 1.0f / length);
    /* The sign that scene_surface gives the normal. */
    const double side = vec3d_dot(vec3d_from(n), area);
    const bool is_opposed = scene->objects[hit->geometry].is_flipped ? side > 0.0 : side < 0.0;
    return is_opposed ? vec3_negate(dn) : dn;
}

float scene_lamp_pdf(const SurfacePoint *surface, const SceneObject *object, Vec3 p) {
    const Vec3 way = vec3_sub(surface->p, p);
    const float distance = vec3_length(way);
    const float cosine = fabsf(vec3_dot(way, surface->ng)) / distance;
    const double density = (double)rgb_mean(surface->material->emission) / object->lamp_power;
    return cosine > 0.0f ? (float)density * distance * distance / cosine : 0.0f;
}

Vec3 scene_leave(const SurfacePoint *surface, Vec3 d) {
    /* A few units in the last place of the largest coordinate: the error of interpolated
     * positions [Waechter19], without their integer tricks. */
    const Vec3 p = surface->p;
    const float scale = fmaxf(fmaxf(fabsf(p.x), fabsf(p.y)), fabsf(p.z));
    const float offset = copysignf(2e-6f * scale + 1e-12f, vec3_dot(d, surface->ng));
    return vec3_madd(p, offset, surface->ng);
}
