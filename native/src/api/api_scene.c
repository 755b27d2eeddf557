/* SPDX-License-Identifier: GPL-3.0-or-later
 * Public functions: setting up a scene. */
#include <float.h>
#include <string.h>

#include "api/api_check.h"
#include "base/memory.h"
#include "math/mat4.h"
#include "scene/scene.h"

static const float COEFFICIENT_MAX = 1e9f; /* 1/m */
static const float G_MAX = 0.9999f;
/* Sizes of lamps, m, and windows: squares of sums of such numbers are finite. */
static const float LENGTH_MAX = 1e18f;
/* What surfaces and the world emit: sums over all samples of a pixel are finite. */
static const float RADIANCE_MAX = 1e30f;

static const char *name_or_empty(const char *name) {
    return name != NULL ? name : "";
}

static AmbStatus check_open(const AmbScene *scene) {
    AMB_TRY(check_pointer(scene, "scene"));
    if (scene->is_committed)
        return status_fail(AMB_INVALID_STATE, "the scene is committed and cannot change");
    return AMB_OK;
}

/* Makes room for one more element of an array that doubles. */
static AmbStatus reserve(void **array, uint32_t count, uint32_t *room, uint64_t size) {
    if (count < *room)
        return AMB_OK;
    const uint32_t wanted = *room > 0 ? 2 * *room : 8;
    void *larger = memory_zero_array(wanted, size);
    if (larger == NULL || wanted < *room) {
        memory_free(larger);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the scene");
    }
    if (count > 0)
        memcpy(larger, *array, count * size);
    memory_free(*array);
    *array = larger;
    *room = wanted;
    return AMB_OK;
}

AmbStatus amb_scene_create(AmbScene **out_scene) {
    status_enter("amb_scene_create");
    AMB_TRY(check_pointer(out_scene, "out_scene"));
    *out_scene = NULL;
    AmbScene *scene = memory_zero_array(1, sizeof *scene);
    if (scene == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a scene");
    pthread_mutex_init(&scene->build_lock, NULL);
    *out_scene = scene;
    return AMB_OK;
}

void amb_scene_destroy(AmbScene *scene) {
    if (scene == NULL)
        return;
    pthread_mutex_destroy(&scene->build_lock);
    scene_clear(scene);
    memory_free(scene);
}

void amb_texture_init(AmbTexture *texture) {
    if (texture != NULL)
        *texture = (AmbTexture){.struct_size = sizeof *texture};
}

static AmbStatus check_texture(const AmbTexture *texture) {
    const char *name = name_or_empty(texture->name);
    const uint64_t pixels = (uint64_t)texture->width * texture->height;
    if (pixels == 0 || pixels > UINT32_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "texture \"%.100s\" has %u x %u pixels", name,
                           texture->width, texture->height);
    if (texture->extension > AMB_EXTENSION_MIRROR)
        return status_fail(AMB_INVALID_ARGUMENT, "extension %u of texture \"%.100s\" is unknown",
                           texture->extension, name);
    if (texture->interpolation > AMB_INTERPOLATION_CLOSEST)
        return status_fail(AMB_INVALID_ARGUMENT,
                           "interpolation %u of texture \"%.100s\" is unknown",
                           texture->interpolation, name);
    AMB_TRY(check_pointer(texture->color, "texture.color"));
    for (uint64_t i = 0; i < 3 * pixels; ++i)
        if (!(texture->color[i] >= 0.0f && texture->color[i] <= 1.0f))
            return status_fail(AMB_INVALID_ARGUMENT,
                               "pixel (%llu, %llu) of texture \"%.100s\" is not in [0, 1]",
                               (unsigned long long)(i / 3 % texture->width),
                               (unsigned long long)(i / 3 / texture->width), name);
    return AMB_OK;
}

AmbStatus amb_scene_add_texture(AmbScene *scene, const AmbTexture *texture, uint32_t *out_id) {
    status_enter("amb_scene_add_texture");
    AMB_TRY(check_pointer(out_id, "out_id"));
    *out_id = 0;
    AMB_TRY(check_open(scene));
    AmbTexture given;
    amb_texture_init(&given);
    AMB_TRY(check_struct(texture, sizeof given, "texture", &given));
    AMB_TRY(check_texture(&given));
    AMB_TRY(reserve((void **)&scene->textures, scene->texture_count, &scene->texture_room,
                    sizeof *scene->textures));
    SceneTexture copy = {.name = memory_copy_text(given.name),
                         .width = given.width,
                         .height = given.height,
                         .extension = given.extension,
                         .is_closest = given.interpolation == AMB_INTERPOLATION_CLOSEST,
                         .pixels = memory_copy_array(
                             given.color, (uint64_t)given.width * given.height, sizeof(Rgb))};
    if (copy.name == NULL || copy.pixels == NULL) {
        memory_free(copy.name);
        memory_free(copy.pixels);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for texture \"%.100s\"",
                           name_or_empty(given.name));
    }
    scene->textures[scene->texture_count] = copy;
    *out_id = ++scene->texture_count;
    return AMB_OK;
}

void amb_material_init(AmbMaterial *material) {
    if (material == NULL)
        return;
    *material = (AmbMaterial){.struct_size = sizeof *material,
                              .surface = AMB_SURFACE_DIFFUSE,
                              .albedo = {0.8f, 0.8f, 0.8f},
                              .transmit_color = {1, 1, 1},
                              .reflect_color = {1, 1, 1},
                              .ior = 1.0f,
                              .uv_to_texture = {1, 0, 0, 0, 1, 0}};
}

static AmbStatus check_material(const AmbScene *scene, const AmbMaterial *m) {
    const char *name = name_or_empty(m->name);
    if (m->surface > AMB_SURFACE_DIELECTRIC)
        return status_fail(AMB_INVALID_ARGUMENT, "surface %u of \"%.100s\" is unknown", m->surface,
                           name);
    if (m->lobe_count > AMB_PHASE_LOBE_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" has %u phase lobes, at most %d", name,
                           m->lobe_count, AMB_PHASE_LOBE_MAX);
    AMB_TRY(check_range(m->albedo, 3, 0.0f, 1.0f, "albedo", name));
    AMB_TRY(check_range(m->emission, 3, 0.0f, RADIANCE_MAX, "emission", name));
    AMB_TRY(check_range(m->transmit_color, 3, 0.0f, 1.0f, "transmit_color", name));
    AMB_TRY(check_range(m->reflect_color, 3, 0.0f, 1.0f, "reflect_color", name));
    AMB_TRY(check_range(&m->ior, 1, 0.1f, 10.0f, "ior", name));
    if (m->texture > scene->texture_count)
        return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" shows texture %u of %u", name,
                           m->texture, scene->texture_count);
    AMB_TRY(check_range(m->uv_to_texture, 6, -FLT_MAX, FLT_MAX, "uv_to_texture", name));
    AMB_TRY(check_range(m->sigma_a, 3, 0.0f, COEFFICIENT_MAX, "sigma_a", name));
    for (uint32_t i = 0; i < m->lobe_count; ++i) {
        AMB_TRY(check_range(m->lobes[i].sigma_s, 3, 0.0f, COEFFICIENT_MAX, "sigma_s", name));
        AMB_TRY(check_range(&m->lobes[i].g, 1, -G_MAX, G_MAX, "g", name));
    }
    return AMB_OK;
}

static Medium make_medium(const AmbMaterial *m) {
    Medium medium = {.sigma_t = rgb_from(m->sigma_a), .lobe_count = m->lobe_count};
    for (uint32_t i = 0; i < m->lobe_count; ++i) {
        medium.lobes[i] = (MediumLobe){rgb_from(m->lobes[i].sigma_s), m->lobes[i].g};
        medium.sigma_t = rgb_add(medium.sigma_t, medium.lobes[i].sigma_s);
    }
    return medium;
}

AmbStatus amb_scene_add_material(AmbScene *scene, const AmbMaterial *material, uint32_t *out_id) {
    status_enter("amb_scene_add_material");
    AMB_TRY(check_pointer(out_id, "out_id"));
    *out_id = 0;
    AMB_TRY(check_open(scene));
    AmbMaterial m;
    amb_material_init(&m);
    AMB_TRY(check_struct(material, sizeof m, "material", &m));
    AMB_TRY(check_material(scene, &m));
    AMB_TRY(reserve((void **)&scene->materials, scene->material_count, &scene->material_room,
                    sizeof *scene->materials));
    char *name = memory_copy_text(m.name);
    if (name == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a material");
    SceneMaterial *copy = &scene->materials[scene->material_count];
    *copy = (SceneMaterial){.name = name,
                            .surface = m.surface,
                            .albedo = rgb_from(m.albedo),
                            .emission = rgb_from(m.emission),
                            .transmit_color = rgb_from(m.transmit_color),
                            .reflect_color = rgb_from(m.reflect_color),
                            .ior = m.ior,
                            .priority = m.priority,
                            .medium = make_medium(&m),
                            .texture = m.texture};
    memcpy(copy->uv_to_texture, m.uv_to_texture, sizeof copy->uv_to_texture);
    *out_id = scene->material_count++;
    return AMB_OK;
}

void amb_mesh_init(AmbMesh *mesh) {
    if (mesh != NULL)
        *mesh = (AmbMesh){.struct_size = sizeof *mesh};
}

static AmbStatus check_mesh(const AmbMesh *m) {
    const char *name = name_or_empty(m->name);
    if (m->vertex_count > 0)
        AMB_TRY(check_pointer(m->positions, "mesh.positions"));
    if (m->triangle_count > 0)
        AMB_TRY(check_pointer(m->triangles, "mesh.triangles"));
    if (m->vertex_count > UINT32_MAX || m->triangle_count > UINT32_MAX / 3)
        return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" has too many vertices or triangles",
                           name);
    if (m->normal_domain > AMB_NORMALS_CORNER)
        return status_fail(AMB_INVALID_ARGUMENT, "normal_domain %u of \"%.100s\" is unknown",
                           m->normal_domain, name);
    if (m->normal_domain != AMB_NORMALS_NONE && m->triangle_count > 0)
        AMB_TRY(check_pointer(m->normals, "mesh.normals"));
    for (uint64_t i = 0; i < 3 * m->vertex_count; ++i)
        if (!isfinite(m->positions[i]))
            return status_fail(AMB_INVALID_ARGUMENT, "vertex %llu of mesh \"%.100s\" is not finite",
                               (unsigned long long)(i / 3), name);
    for (uint64_t i = 0; i < 3 * m->triangle_count; ++i)
        if (m->triangles[i] >= m->vertex_count)
            return status_fail(
                AMB_INVALID_ARGUMENT,
                "index %u of triangle %llu is out of range (vertex_count %llu) in mesh \"%.100s\"",
                m->triangles[i], (unsigned long long)(i / 3), (unsigned long long)m->vertex_count,
                name);
    return AMB_OK;
}

AmbStatus amb_scene_add_mesh(AmbScene *scene, const AmbMesh *mesh, uint32_t *out_id) {
    status_enter("amb_scene_add_mesh");
    AMB_TRY(check_pointer(out_id, "out_id"));
    *out_id = 0;
    AMB_TRY(check_open(scene));
    AmbMesh m;
    amb_mesh_init(&m);
    AMB_TRY(check_struct(mesh, sizeof m, "mesh", &m));
    AMB_TRY(check_mesh(&m));
    AMB_TRY(reserve((void **)&scene->meshes, scene->mesh_count, &scene->mesh_room,
                    sizeof *scene->meshes));
    const bool has_normals = m.normal_domain != AMB_NORMALS_NONE && m.triangle_count > 0;
    const uint64_t normal_count =
        m.normal_domain == AMB_NORMALS_VERTEX ? m.vertex_count : 3 * m.triangle_count;
    SceneMesh copy = {
        .name = memory_copy_text(m.name),
        .normal_domain = m.normal_domain,
        .vertex_count = m.vertex_count,
        .triangle_count = m.triangle_count,
        .positions = memory_copy_array(m.positions, m.vertex_count, sizeof(Vec3)),
        .triangles = memory_copy_array(m.triangles, 3 * m.triangle_count, sizeof(uint32_t)),
        .normals = has_normals ? memory_copy_array(m.normals, normal_count, sizeof(Vec3)) : NULL,
        .slots =
            m.slots != NULL ? memory_copy_array(m.slots, m.triangle_count, sizeof(uint32_t)) : NULL,
        .uvs = m.uvs != NULL ? memory_copy_array(m.uvs, 3 * m.triangle_count, sizeof(Vec2)) : NULL};
    if (copy.name == NULL || copy.positions == NULL || copy.triangles == NULL ||
        (has_normals && copy.normals == NULL) || (m.slots != NULL && copy.slots == NULL) ||
        (m.uvs != NULL && copy.uvs == NULL)) {
        memory_free(copy.name);
        memory_free(copy.positions);
        memory_free(copy.triangles);
        memory_free(copy.normals);
        memory_free(copy.slots);
        memory_free(copy.uvs);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for mesh \"%.100s\"",
                           name_or_empty(m.name));
    }
    scene->meshes[scene->mesh_count] = copy;
    *out_id = scene->mesh_count++;
    return AMB_OK;
}

void amb_object_init(AmbObject *object) {
    if (object == NULL)
        return;
    *object = (AmbObject){.struct_size = sizeof *object};
    for (int i = 0; i < 4; ++i)
        object->to_world[5 * i] = 1.0f;
}

static AmbStatus check_object(const AmbScene *scene, const AmbObject *object) {
    const char *name = name_or_empty(object->name);
    AMB_TRY(check_range(object->to_world, 16, -FLT_MAX, FLT_MAX, "to_world", name));
    if (mat4_determinant(object->to_world) == 0.0)
        return status_fail(AMB_INVALID_ARGUMENT, "the transform of \"%.100s\" is not invertible",
                           name);
    if (object->mesh >= scene->mesh_count)
        return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" places mesh %u of %u", name,
                           object->mesh, scene->mesh_count);
    if (object->material_count == 0)
        return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" has no material", name);
    AMB_TRY(check_pointer(object->materials, "object.materials"));
    for (uint32_t i = 0; i < object->material_count; ++i)
        if (object->materials[i] >= scene->material_count)
            return status_fail(AMB_INVALID_ARGUMENT, "\"%.100s\" uses material %u of %u", name,
                               object->materials[i], scene->material_count);
    return AMB_OK;
}

AmbStatus amb_scene_add_object(AmbScene *scene, const AmbObject *object, uint32_t *out_id) {
    status_enter("amb_scene_add_object");
    AMB_TRY(check_pointer(out_id, "out_id"));
    *out_id = 0;
    AMB_TRY(check_open(scene));
    AmbObject given;
    amb_object_init(&given);
    AMB_TRY(check_struct(object, sizeof given, "object", &given));
    AMB_TRY(check_object(scene, &given));
    AMB_TRY(reserve((void **)&scene->objects, scene->object_count, &scene->object_room,
                    sizeof *scene->objects));
    SceneObject copy = {
        .name = memory_copy_text(given.name),
        .mesh = given.mesh,
        .materials = memory_copy_array(given.materials, given.material_count, sizeof(uint32_t)),
        .material_count = given.material_count};
    if (copy.name == NULL || copy.materials == NULL) {
        memory_free(copy.name);
        memory_free(copy.materials);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for object \"%.100s\"",
                           name_or_empty(given.name));
    }
    memcpy(copy.to_world, given.to_world, sizeof copy.to_world);
    ++scene->meshes[copy.mesh].user_count;
    scene->objects[scene->object_count] = copy;
    *out_id = scene->object_count++;
    return AMB_OK;
}

void amb_light_init(AmbLight *light, uint32_t kind) {
    if (light != NULL)
        *light = (AmbLight){.struct_size = sizeof *light,
                            .kind = kind,
                            .color = {1, 1, 1},
                            .direction = {0, 0, -1},
                            .tangent = {1, 0, 0},
                            .spot_size = 0.785398163f,
                            .size = {1, 1}};
}

static AmbStatus check_light(const AmbLight *light) {
    const char *name = name_or_empty(light->name);
    if (light->kind > AMB_LIGHT_AREA)
        return status_fail(AMB_INVALID_ARGUMENT, "kind %u of light \"%.100s\" is unknown",
                           light->kind, name);
    AMB_TRY(check_range(light->color, 3, 0.0f, FLT_MAX, "color", name));
    AMB_TRY(check_range(light->position, 3, -FLT_MAX, FLT_MAX, "position", name));
    AMB_TRY(check_range(light->direction, 3, -FLT_MAX, FLT_MAX, "direction", name));
    AMB_TRY(check_range(light->tangent, 3, -FLT_MAX, FLT_MAX, "tangent", name));
    AMB_TRY(check_range(&light->radius, 1, 0.0f, LENGTH_MAX, "radius", name));
    AMB_TRY(check_range(&light->angle, 1, 0.0f, AMB_PI, "angle", name));
    if (light->kind != AMB_LIGHT_POINT) {
        const float length = vec3_length(vec3_from(light->direction));
        if (!(length > 0.0f) || !isfinite(length))
            return status_fail(AMB_INVALID_ARGUMENT, "light \"%.100s\" has no direction", name);
    }
    if (light->kind == AMB_LIGHT_SPOT) {
        AMB_TRY(check_range(&light->spot_size, 1, FLT_MIN, AMB_PI, "spot_size", name));
        AMB_TRY(check_range(&light->spot_blend, 1, 0.0f, 1.0f, "spot_blend", name));
        AMB_TRY(check_range(&light->spot_cosine, 1, 0.0f, 1.0f, "spot_cosine", name));
    }
    if (light->kind == AMB_LIGHT_AREA) {
        AMB_TRY(check_range(light->size, 2, FLT_MIN, LENGTH_MAX, "size", name));
        if (light->area_shape > AMB_AREA_ELLIPSE)
            return status_fail(AMB_INVALID_ARGUMENT, "area_shape %u of \"%.100s\" is unknown",
                               light->area_shape, name);
    }
    return AMB_OK;
}

/* Axes of an area light: the tangent made perpendicular to the direction, where it is not along
 * it. */
static void set_frame(SceneLight *light, const AmbLight *given) {
    vec3_frame(light->direction, &light->x, &light->y);
    const Vec3 tangent = vec3_from(given->tangent);
    const Vec3 across = vec3_madd(tangent, -vec3_dot(tangent, light->direction), light->direction);
    const float length = vec3_length(across);
    if (length > 1e-6f * vec3_length(tangent)) {
        light->x = vec3_scale(across, 1.0f / length);
        light->y = vec3_cross(light->direction, light->x);
    }
}

AmbStatus amb_scene_add_light(AmbScene *scene, const AmbLight *light, uint32_t *out_id) {
    status_enter("amb_scene_add_light");
    AMB_TRY(check_pointer(out_id, "out_id"));
    *out_id = 0;
    AMB_TRY(check_open(scene));
    AmbLight given;
    amb_light_init(&given, AMB_LIGHT_POINT);
    AMB_TRY(check_struct(light, sizeof given, "light", &given));
    AMB_TRY(check_light(&given));
    AMB_TRY(reserve((void **)&scene->lights, scene->light_count, &scene->light_room,
                    sizeof *scene->lights));
    SceneLight copy = {.name = memory_copy_text(given.name),
                       .kind = given.kind,
                       .color = rgb_from(given.color),
                       .position = vec3_from(given.position),
                       .direction = vec3(0, 0, -1),
                       .radius = given.kind <= AMB_LIGHT_SPOT ? given.radius : 0.0f,
                       .angle = given.kind == AMB_LIGHT_SUN ? 0.5f * given.angle : 0.0f,
                       .spot_cap = 2.0f * powf(sinf(0.25f * given.spot_size), 2.0f),
                       .spot_blend = given.spot_blend,
                       .spot_cosine = given.spot_cosine,
                       .size = {0.5f * given.size[0], 0.5f * given.size[1]},
                       .area_shape = given.area_shape};
    if (copy.name == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for a light");
    if (given.kind != AMB_LIGHT_POINT)
        copy.direction = vec3_normalize(vec3_from(given.direction));
    set_frame(&copy, &given);
    scene->lights[scene->light_count] = copy;
    *out_id = scene->light_count++;
    return AMB_OK;
}

AmbStatus amb_scene_set_world(AmbScene *scene, const float radiance[3]) {
    status_enter("amb_scene_set_world");
    AMB_TRY(check_open(scene));
    AMB_TRY(check_pointer(radiance, "radiance"));
    AMB_TRY(check_range(radiance, 3, 0.0f, RADIANCE_MAX, "radiance", "world"));
    world_clear(&scene->world);
    scene->world.constant = rgb_from(radiance);
    return AMB_OK;
}

void amb_world_image_init(AmbWorldImage *image) {
    if (image != NULL)
        *image =
            (AmbWorldImage){.struct_size = sizeof *image, .to_world = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
}

static AmbStatus check_world_image(const AmbWorldImage *image) {
    const uint64_t pixels = (uint64_t)image->width * image->height;
    if (pixels == 0 || pixels > UINT32_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "the world's image has %u x %u pixels",
                           image->width, image->height);
    AMB_TRY(check_pointer(image->radiance, "world_image.radiance"));
    AMB_TRY(check_range(image->to_world, 9, -FLT_MAX, FLT_MAX, "to_world", "world"));
    for (int i = 0; i < 9; ++i) {
        const float *a = image->to_world + 3 * (i / 3), *b = image->to_world + 3 * (i % 3);
        const float product = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        if (!(fabsf(product - (i / 3 == i % 3 ? 1.0f : 0.0f)) < 1e-3f))
            return status_fail(AMB_INVALID_ARGUMENT, "to_world of the world is not orthogonal");
    }
    for (uint64_t i = 0; i < 3 * pixels; ++i)
        if (!(image->radiance[i] >= 0.0f && image->radiance[i] <= RADIANCE_MAX))
            return status_fail(AMB_INVALID_ARGUMENT,
                               "pixel (%llu, %llu) of the world's image is %g, must be in [0, %g]",
                               (unsigned long long)(i / 3 % image->width),
                               (unsigned long long)(i / 3 / image->width),
                               (double)image->radiance[i], (double)RADIANCE_MAX);
    return AMB_OK;
}

AmbStatus amb_scene_set_world_image(AmbScene *scene, const AmbWorldImage *image) {
    status_enter("amb_scene_set_world_image");
    AMB_TRY(check_open(scene));
    AmbWorldImage given;
    amb_world_image_init(&given);
    AMB_TRY(check_struct(image, sizeof given, "image", &given));
    AMB_TRY(check_world_image(&given));
    Rgb *pixels =
        memory_copy_array(given.radiance, (uint64_t)given.width * given.height, sizeof(Rgb));
    if (pixels == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    const AmbStatus status =
        world_set_image(&scene->world, pixels, given.width, given.height, given.to_world);
    if (status != AMB_OK)
        memory_free(pixels);
    return status;
}

void amb_camera_init(AmbCamera *camera, uint32_t kind) {
    if (camera == NULL)
        return;
    *camera = (AmbCamera){.struct_size = sizeof *camera,
                          .kind = kind,
                          .window = {-0.5f, 0.5f, -0.5f, 0.5f},
                          .clip_start = 1e-4f,
                          .clip_end = 1e8f,
                          .focus_distance = 1.0f};
    for (int i = 0; i < 4; ++i)
        camera->to_world[5 * i] = 1.0f;
}

static AmbStatus check_camera(const AmbCamera *camera) {
    static const char *const name = "camera";
    if (camera->kind > AMB_CAMERA_ORTHOGRAPHIC)
        return status_fail(AMB_INVALID_ARGUMENT, "camera kind %u is unknown", camera->kind);
    AMB_TRY(check_range(camera->to_world, 16, -FLT_MAX, FLT_MAX, "to_world", name));
    if (mat4_determinant(camera->to_world) == 0.0)
        return status_fail(AMB_INVALID_ARGUMENT, "the camera's transform is not invertible");
    AMB_TRY(check_range(camera->window, 4, -LENGTH_MAX, LENGTH_MAX, "window", name));
    if (!(camera->window[0] < camera->window[1]) || !(camera->window[2] < camera->window[3]))
        return status_fail(AMB_INVALID_ARGUMENT, "the camera's window is empty");
    AMB_TRY(check_range(&camera->clip_end, 1, -FLT_MAX, FLT_MAX, "clip_end", name));
    AMB_TRY(check_range(&camera->clip_start, 1, -FLT_MAX, camera->clip_end, "clip_start", name));
    if (camera->clip_start == camera->clip_end ||
        (camera->kind == AMB_CAMERA_PERSPECTIVE && !(camera->clip_start > 0.0f)))
        return status_fail(AMB_INVALID_ARGUMENT, "the camera's clipping range is empty");
    AMB_TRY(check_range(&camera->lens_radius, 1, 0.0f, FLT_MAX, "lens_radius", name));
    if (camera->lens_radius > 0.0f)
        AMB_TRY(check_range(&camera->focus_distance, 1, FLT_MIN, FLT_MAX, "focus_distance", name));
    return AMB_OK;
}

AmbStatus amb_scene_set_camera(AmbScene *scene, const AmbCamera *camera) {
    status_enter("amb_scene_set_camera");
    AMB_TRY(check_pointer(scene, "scene"));
    if (atomic_load(&scene->render_count) > 0)
        return status_fail(AMB_INVALID_STATE, "the scene is being rendered");
    AmbCamera given;
    amb_camera_init(&given, AMB_CAMERA_PERSPECTIVE);
    AMB_TRY(check_struct(camera, sizeof given, "camera", &given));
    AMB_TRY(check_camera(&given));
    const float *m = given.to_world;
    SceneCamera placed = {.kind = given.kind,
                          .position = vec3(m[3], m[7], m[11]),
                          .right = mat4_axis(m, 0),
                          .up = mat4_axis(m, 1),
                          .forward = vec3_negate(mat4_axis(m, 2)),
                          .clip_start = given.clip_start,
                          .clip_end = given.clip_end,
                          .lens_radius = given.lens_radius,
                          .focus_distance = given.focus_distance};
    memcpy(placed.window, given.window, sizeof given.window);
    scene_set_camera(scene, &placed);
    return AMB_OK;
}

AmbStatus amb_scene_commit(AmbScene *scene) {
    status_enter("amb_scene_commit");
    AMB_TRY(check_open(scene));
    return scene_commit(scene);
}
