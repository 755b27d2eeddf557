/* SPDX-License-Identifier: GPL-3.0-or-later
 * The public interface: what it refuses and how, whole renders, cancelling, files. */
#include <OpenEXR/openexr.h>
#include <errno.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "demo.h"
#include "test.h"

/* Sanitizers slow everything down; where a time is required, it is of the library as built for
 * use. */
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { IS_SANITIZED = 1 };
#else
enum { IS_SANITIZED = 0 };
#endif

/* ---- Refusals -------------------------------------------------------------------------------- */

/* The call fails with that status, its record names the function, and its message has the part. */
static void check_failure(const char *file, int line, AmbStatus status, AmbStatus expected,
                          const char *function, const char *part) {
    AmbErrorInfo info;
    amb_last_error(&info);
    test_check(status == expected, file, line, "%s: %s, expected %s", function,
               amb_status_name(status), amb_status_name(expected));
    test_check(info.status == status, file, line, "%s: record has status %d", function,
               info.status);
    test_check(strcmp(info.function, function) == 0, file, line, "%s: record has function %s",
               function, info.function);
    test_check(strstr(info.message, part) != NULL, file, line, "%s: \"%s\" lacks \"%s\"", function,
               info.message, part);
}

#define FAILS(function, arguments, expected, part)                                                 \
    check_failure(__FILE__, __LINE__, function arguments, expected, #function, part)

static AmbScene *empty_scene(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    return scene;
}

static void library_says_what_it_is(void) {
    ENSURE(amb_abi_version() == AMB_ABI_VERSION);
    ENSURE(strcmp(amb_version_string(), AMB_VERSION_STRING) == 0);
    ENSURE(amb_struct_size(AMB_STRUCT_ERROR_INFO) == sizeof(AmbErrorInfo));
    ENSURE(amb_struct_size(AMB_STRUCT_PHASE_LOBE) == sizeof(AmbPhaseLobe));
    ENSURE(amb_struct_size(AMB_STRUCT_MATERIAL) == sizeof(AmbMaterial));
    ENSURE(amb_struct_size(AMB_STRUCT_MESH) == sizeof(AmbMesh));
    ENSURE(amb_struct_size(AMB_STRUCT_OBJECT) == sizeof(AmbObject));
    ENSURE(amb_struct_size(AMB_STRUCT_LIGHT) == sizeof(AmbLight));
    ENSURE(amb_struct_size(AMB_STRUCT_CAMERA) == sizeof(AmbCamera));
    ENSURE(amb_struct_size(AMB_STRUCT_RENDER_PARAMS) == sizeof(AmbRenderParams));
    ENSURE(amb_struct_size(AMB_STRUCT_PROGRESS) == sizeof(AmbProgress));
    ENSURE(amb_struct_size(AMB_STRUCT_WORLD_IMAGE) == sizeof(AmbWorldImage));
    ENSURE(amb_struct_size(AMB_STRUCT_TEXTURE) == sizeof(AmbTexture));
    ENSURE(amb_struct_size(AMB_STRUCT_COUNT) == 0 && amb_struct_size(UINT32_MAX) == 0);
    ENSURE(strcmp(amb_status_name(AMB_OK), "OK") == 0);
    ENSURE(strcmp(amb_status_name(AMB_INTERNAL), "INTERNAL") == 0);
    ENSURE(strcmp(amb_status_name(8), "UNKNOWN") == 0);
    ENSURE(strcmp(amb_status_name(-1), "UNKNOWN") == 0);
    ENSURE_STATUS(amb_self_test(), AMB_OK);
    amb_last_error(NULL);
}

static void null_is_refused_or_harmless(void) {
    amb_material_init(NULL);
    amb_mesh_init(NULL);
    amb_object_init(NULL);
    amb_light_init(NULL, AMB_LIGHT_POINT);
    amb_camera_init(NULL, AMB_CAMERA_PERSPECTIVE);
    amb_render_params_init(NULL);
    amb_progress_init(NULL);
    amb_scene_destroy(NULL);
    amb_render_destroy(NULL);
    amb_render_cancel(NULL);

    AmbScene *scene = empty_scene();
    AmbMaterial material;
    amb_material_init(&material);
    AmbMesh mesh;
    amb_mesh_init(&mesh);
    AmbObject object;
    amb_object_init(&object);
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_POINT);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    AmbRenderParams params;
    amb_render_params_init(&params);
    uint32_t id = 77;
    const AmbStatus bad = AMB_INVALID_ARGUMENT;
    FAILS(amb_scene_create, (NULL), bad, "out_scene");
    FAILS(amb_scene_add_material, (NULL, &material, &id), bad, "scene");
    ENSURE(id == 0);
    id = 77;
    FAILS(amb_scene_add_material, (scene, NULL, &id), bad, "material");
    ENSURE(id == 0);
    FAILS(amb_scene_add_material, (scene, &material, NULL), bad, "out_id");
    FAILS(amb_scene_add_mesh, (NULL, &mesh, &id), bad, "scene");
    FAILS(amb_scene_add_mesh, (scene, NULL, &id), bad, "mesh");
    FAILS(amb_scene_add_mesh, (scene, &mesh, NULL), bad, "out_id");
    FAILS(amb_scene_add_object, (NULL, &object, &id), bad, "scene");
    FAILS(amb_scene_add_object, (scene, NULL, &id), bad, "object");
    FAILS(amb_scene_add_object, (scene, &object, NULL), bad, "out_id");
    FAILS(amb_scene_add_light, (NULL, &light, &id), bad, "scene");
    FAILS(amb_scene_add_light, (scene, NULL, &id), bad, "light");
    FAILS(amb_scene_add_light, (scene, &light, NULL), bad, "out_id");
    AmbTexture texture;
    amb_texture_init(&texture);
    FAILS(amb_scene_add_texture, (NULL, &texture, &id), bad, "scene");
    FAILS(amb_scene_add_texture, (scene, NULL, &id), bad, "texture");
    FAILS(amb_scene_add_texture, (scene, &texture, NULL), bad, "out_id");
    FAILS(amb_scene_set_world, (NULL, material.albedo), bad, "scene");
    FAILS(amb_scene_set_world, (scene, NULL), bad, "radiance");
    FAILS(amb_scene_set_world_image, (scene, NULL), bad, "image");
    FAILS(amb_scene_set_camera, (NULL, &camera), bad, "scene");
    FAILS(amb_scene_set_camera, (scene, NULL), bad, "camera");
    FAILS(amb_scene_commit, (NULL), bad, "scene");

    AmbRender *render = (AmbRender *)scene;
    FAILS(amb_render_start, (NULL, &params, &render), bad, "scene");
    ENSURE(render == NULL);
    FAILS(amb_render_start, (scene, &params, NULL), bad, "out_render");
    AmbProgress progress;
    amb_progress_init(&progress);
    progress.fraction = 77.0f;
    FAILS(amb_render_progress, (NULL, &progress), bad, "render");
    ENSURE(progress.fraction == 0.0f && progress.struct_size == sizeof progress);
    int32_t is_ended = 77;
    FAILS(amb_render_wait, (NULL, 0.0, &is_ended), bad, "render");
    ENSURE(is_ended == 0);
    id = 77;
    FAILS(amb_render_pass_channels, (NULL, "Combined", &id), bad, "render");
    ENSURE(id == 0);
    float pixel[4];
    FAILS(amb_render_read_pass, (NULL, "Combined", pixel, 4), bad, "render");
    uint64_t size = 77;
    FAILS(amb_render_report, (NULL, NULL, 0, &size), bad, "render");
    ENSURE(size == 0);
    FAILS(amb_render_write_exr, (NULL, "/tmp/x.exr", "layer"), bad, "render");
    amb_scene_destroy(scene);
}

static void bad_materials_are_refused(void) {
    AmbScene *scene = empty_scene();
    const AmbMaterial good = shape_resin(1.5f, 1.0f, 0.1f, 0.5f);
    AmbMaterial m;
    uint32_t id;
    const AmbStatus bad = AMB_INVALID_ARGUMENT;
#define MATERIAL_FAILS(change, part)                                                               \
    do {                                                                                           \
        m = good;                                                                                  \
        change;                                                                                    \
        FAILS(amb_scene_add_material, (scene, &m, &id), bad, part);                                \
        FAILS(amb_scene_add_material, (scene, &m, &id), bad, "resin");                             \
    } while (0)
    MATERIAL_FAILS(m.surface = 2, "surface 2");
    MATERIAL_FAILS(m.lobe_count = AMB_PHASE_LOBE_MAX + 1, "5 phase lobes");
    MATERIAL_FAILS(m.albedo[1] = 1.01f, "albedo");
    MATERIAL_FAILS(m.albedo[2] = -0.01f, "albedo");
    MATERIAL_FAILS(m.emission[0] = (float)NAN, "emission");
    MATERIAL_FAILS(m.emission[0] = 1e31f, "emission is 1e+31");
    MATERIAL_FAILS(m.transmit_color[0] = 2.0f, "transmit_color");
    MATERIAL_FAILS(m.reflect_color[0] = -1.0f, "reflect_color");
    MATERIAL_FAILS(m.texture = 1, "shows texture 1 of 0");
    MATERIAL_FAILS(m.uv_to_texture[5] = (float)NAN, "uv_to_texture");
    MATERIAL_FAILS(m.ior = 0.0f, "ior");
    MATERIAL_FAILS(m.ior = -1.5f, "ior");
    MATERIAL_FAILS(m.ior = INFINITY, "ior");
    MATERIAL_FAILS(m.sigma_a[2] = -1e-6f, "sigma_a");
    MATERIAL_FAILS(m.lobes[0].sigma_s[1] = (float)NAN, "sigma_s");
    MATERIAL_FAILS(m.lobes[0].g = 1.0f, "g is 1");
    MATERIAL_FAILS(m.lobes[0].g = -1.0f, "g is -1");
#undef MATERIAL_FAILS
    /* Lobes beyond the count are not looked at, a NULL name is an empty one. */
    m = good;
    m.lobes[3].g = (float)NAN;
    m.name = NULL;
    ENSURE_STATUS(amb_scene_add_material(scene, &m, &id), AMB_OK);
    ENSURE(id == 0);
    ENSURE_STATUS(amb_scene_add_material(scene, &good, &id), AMB_OK);
    ENSURE(id == 1);
    amb_scene_destroy(scene);
}

static void bad_meshes_are_refused(void) {
    AmbScene *scene = empty_scene();
    static const float positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    static const float broken[9] = {0, 0, 0, 1, (float)NAN, 0, 0, 1, 0};
    static const uint32_t triangles[3] = {0, 1, 2}, beyond[3] = {0, 1, 3};
    AmbMesh good;
    amb_mesh_init(&good);
    good.name = "Soap";
    good.positions = positions;
    good.triangles = triangles;
    good.vertex_count = 3;
    good.triangle_count = 1;
    AmbMesh m;
    uint32_t id;
    const AmbStatus bad = AMB_INVALID_ARGUMENT;
#define MESH_FAILS(change, part)                                                                   \
    do {                                                                                           \
        m = good;                                                                                  \
        change;                                                                                    \
        FAILS(amb_scene_add_mesh, (scene, &m, &id), bad, part);                                    \
    } while (0)
    MESH_FAILS(m.positions = NULL, "mesh.positions");
    MESH_FAILS(m.triangles = NULL, "mesh.triangles");
    MESH_FAILS(m.normal_domain = 3, "Soap");
    MESH_FAILS(m.normal_domain = AMB_NORMALS_VERTEX, "mesh.normals");
    MESH_FAILS(m.positions = broken, "vertex 1 of mesh \"Soap\" is not finite");
    MESH_FAILS(m.triangles = beyond, "index 3 of triangle 0");
    MESH_FAILS(m.triangles = beyond, "Soap");
    MESH_FAILS(m.vertex_count = 1ull << 40, "Soap");
    MESH_FAILS(m.triangle_count = UINT32_MAX / 3 + 1, "Soap");
    MESH_FAILS(m.triangle_count = UINT64_MAX, "Soap");
#undef MESH_FAILS
    /* Nothing at all is a mesh. */
    m = good;
    m.vertex_count = m.triangle_count = 0;
    m.positions = NULL;
    m.triangles = NULL;
    ENSURE_STATUS(amb_scene_add_mesh(scene, &m, &id), AMB_OK);
    ENSURE_STATUS(amb_scene_add_mesh(scene, &good, &id), AMB_OK);
    ENSURE(id == 1);

    AmbMaterial material;
    amb_material_init(&material);
    uint32_t material_id;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &material_id), AMB_OK);
    static const uint32_t materials[2] = {0, 1};
    AmbObject fine;
    amb_object_init(&fine);
    fine.name = "Dish";
    fine.mesh = 1;
    fine.materials = materials;
    fine.material_count = 1;
    AmbObject o;
#define OBJECT_FAILS(change, part)                                                                 \
    do {                                                                                           \
        o = fine;                                                                                  \
        change;                                                                                    \
        FAILS(amb_scene_add_object, (scene, &o, &id), bad, part);                                  \
    } while (0)
    OBJECT_FAILS(o.mesh = 2, "\"Dish\" places mesh 2 of 2");
    OBJECT_FAILS(o.material_count = 0, "\"Dish\" has no material");
    OBJECT_FAILS(o.material_count = 2, "\"Dish\" uses material 1 of 1");
    OBJECT_FAILS(o.materials = NULL, "object.materials");
    OBJECT_FAILS(o.to_world[5] = 0.0f, "\"Dish\" is not invertible");
    OBJECT_FAILS(o.to_world[0] = (float)NAN, "Dish");
    OBJECT_FAILS(o.to_world[3] = INFINITY, "Dish");
#undef OBJECT_FAILS
    ENSURE_STATUS(amb_scene_add_object(scene, &fine, &id), AMB_OK);
    ENSURE(id == 0);
    amb_scene_destroy(scene);
}

static void bad_lights_and_cameras_are_refused(void) {
    AmbScene *scene = empty_scene();
    AmbLight l;
    uint32_t id;
    const AmbStatus bad = AMB_INVALID_ARGUMENT;
#define LIGHT_FAILS(kind, change, part)                                                            \
    do {                                                                                           \
        amb_light_init(&l, kind);                                                                  \
        l.name = "Key";                                                                            \
        change;                                                                                    \
        FAILS(amb_scene_add_light, (scene, &l, &id), bad, part);                                   \
        FAILS(amb_scene_add_light, (scene, &l, &id), bad, "Key");                                  \
    } while (0)
    LIGHT_FAILS(4, (void)0, "kind 4");
    LIGHT_FAILS(AMB_LIGHT_POINT, l.color[0] = -1.0f, "color");
    LIGHT_FAILS(AMB_LIGHT_POINT, l.position[2] = (float)NAN, "position");
    LIGHT_FAILS(AMB_LIGHT_POINT, l.radius = -1.0f, "radius");
    LIGHT_FAILS(AMB_LIGHT_SUN, l.angle = 4.0f, "angle");
    LIGHT_FAILS(AMB_LIGHT_SUN, l.direction[2] = 0.0f, "direction");
    LIGHT_FAILS(AMB_LIGHT_SPOT, l.direction[0] = INFINITY, "direction");
    LIGHT_FAILS(AMB_LIGHT_SPOT, l.spot_size = 0.0f, "spot_size");
    LIGHT_FAILS(AMB_LIGHT_SPOT, l.spot_blend = 1.5f, "spot_blend");
    LIGHT_FAILS(AMB_LIGHT_SPOT, l.spot_cosine = 2.0f, "spot_cosine");
    LIGHT_FAILS(AMB_LIGHT_AREA, l.size[1] = 0.0f, "size");
    LIGHT_FAILS(AMB_LIGHT_AREA, l.area_shape = 2, "area_shape 2");
#undef LIGHT_FAILS
    /* A tangent along the direction is no axis, but the light has others. */
    amb_light_init(&l, AMB_LIGHT_AREA);
    l.tangent[0] = 0.0f;
    l.tangent[2] = 1.0f;
    ENSURE_STATUS(amb_scene_add_light(scene, &l, &id), AMB_OK);

    static const float negative[3] = {0, -1, 0};
    FAILS(amb_scene_set_world, (scene, negative), bad, "world");
    static const float brightest[3] = {1e31f, 1e31f, 1e31f};
    FAILS(amb_scene_set_world, (scene, brightest), bad, "radiance is 1e+31 in \"world\"");
    AmbWorldImage image;
    float pixels[2][3][3] = {{{0}}};
#define IMAGE_FAILS(change, part)                                                                  \
    do {                                                                                           \
        amb_world_image_init(&image);                                                              \
        image.width = 3;                                                                           \
        image.height = 2;                                                                          \
        image.radiance = &pixels[0][0][0];                                                         \
        change;                                                                                    \
        FAILS(amb_scene_set_world_image, (scene, &image), bad, part);                              \
    } while (0)
    IMAGE_FAILS(image.width = 0, "0 x 2 pixels");
    IMAGE_FAILS(image.width = image.height = UINT32_MAX, "pixels");
    IMAGE_FAILS(image.radiance = NULL, "radiance");
    IMAGE_FAILS(image.to_world[4] = 2.0f, "orthogonal");
    IMAGE_FAILS(image.to_world[1] = (float)NAN, "to_world");
    IMAGE_FAILS(pixels[1][2][0] = -1.0f, "pixel (2, 1)");
    IMAGE_FAILS(pixels[1][2][0] = (float)INFINITY, "pixel (2, 1)");
    IMAGE_FAILS(pixels[1][2][0] = 1e31f, "pixel (2, 1) of the world's image is 1e+31");
    pixels[1][2][0] = 1.0f;
    ENSURE_STATUS(amb_scene_set_world_image(scene, &image), AMB_OK);
#undef IMAGE_FAILS
    AmbTexture t;
    float colors[2][3][3] = {{{0}}};
#define TEXTURE_FAILS(change, part)                                                                \
    do {                                                                                           \
        amb_texture_init(&t);                                                                      \
        t.name = "Checks";                                                                         \
        t.width = 3;                                                                               \
        t.height = 2;                                                                              \
        t.color = &colors[0][0][0];                                                                \
        change;                                                                                    \
        FAILS(amb_scene_add_texture, (scene, &t, &id), bad, part);                                 \
    } while (0)
    TEXTURE_FAILS(t.height = 0, "\"Checks\" has 3 x 0 pixels");
    TEXTURE_FAILS(t.width = t.height = UINT32_MAX, "pixels");
    TEXTURE_FAILS(t.color = NULL, "color");
    TEXTURE_FAILS(t.extension = 4, "extension 4");
    TEXTURE_FAILS(t.interpolation = 2, "interpolation 2");
    TEXTURE_FAILS(colors[1][2][0] = 1.5f, "pixel (2, 1) of texture \"Checks\"");
    TEXTURE_FAILS(colors[1][2][0] = (float)NAN, "pixel (2, 1)");
    colors[1][2][0] = 1.0f;
    ENSURE_STATUS(amb_scene_add_texture(scene, &t, &id), AMB_OK);
    ENSURE(id == 1);
#undef TEXTURE_FAILS
    AmbCamera c;
#define CAMERA_FAILS(camera_kind, change, part)                                                    \
    do {                                                                                           \
        amb_camera_init(&c, camera_kind);                                                          \
        change;                                                                                    \
        FAILS(amb_scene_set_camera, (scene, &c), bad, part);                                       \
    } while (0)
    CAMERA_FAILS(2, (void)0, "kind 2");
    CAMERA_FAILS(0, c.to_world[0] = 0.0f, "invertible");
    CAMERA_FAILS(0, c.to_world[7] = (float)NAN, "to_world");
    CAMERA_FAILS(0, c.window[1] = -0.5f, "window is empty");
    CAMERA_FAILS(0, c.window[2] = (float)NAN, "window");
    CAMERA_FAILS(0, c.window[1] = 3e38f, "window");
    CAMERA_FAILS(0, c.clip_start = 0.0f, "clipping range");
    CAMERA_FAILS(0, c.clip_start = c.clip_end, "clipping range");
    CAMERA_FAILS(0, c.clip_end = -1.0f, "clip");
    CAMERA_FAILS(0, c.lens_radius = -1.0f, "lens_radius");
    CAMERA_FAILS(0, (c.lens_radius = 1.0f, c.focus_distance = 0.0f), "focus_distance");
#undef CAMERA_FAILS
    FAILS(amb_scene_commit, (scene), bad, "no camera");
    /* What has failed has changed nothing: the scene goes on. */
    amb_camera_init(&c, AMB_CAMERA_ORTHOGRAPHIC);
    c.clip_start = -1.0f;
    ENSURE_STATUS(amb_scene_set_camera(scene, &c), AMB_OK);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    amb_scene_destroy(scene);
}

static void bad_parameters_are_refused(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    AmbRender *render = NULL;
    FAILS(amb_render_start, (scene, &demo.params, &render), AMB_INVALID_STATE, "not committed");
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbRenderParams p;
#define PARAMS_FAIL(change, expected, part)                                                        \
    do {                                                                                           \
        p = demo.params;                                                                           \
        change;                                                                                    \
        render = (AmbRender *)scene;                                                               \
        FAILS(amb_render_start, (scene, &p, &render), expected, part);                             \
        ENSURE(render == NULL);                                                                    \
    } while (0)
    const AmbStatus bad = AMB_INVALID_ARGUMENT;
    PARAMS_FAIL(p.width = 0, bad, "0 x 16");
    PARAMS_FAIL(p.height = 0, bad, "16 x 0");
    PARAMS_FAIL(p.width = 1u << 17, bad, "131072");
    PARAMS_FAIL(p.samples = 0, bad, "samples");
    PARAMS_FAIL(p.light_samples = 0, bad, "light_samples");
    PARAMS_FAIL(p.light_samples = 1ull << 40, bad, "light_samples");
    PARAMS_FAIL(p.kernel_size = 0.0f, bad, "kernel_size");
    PARAMS_FAIL(p.kernel_size = (float)NAN, bad, "kernel_size");
    PARAMS_FAIL((p.crop_width = 17, p.crop_height = 1), bad, "crop");
    PARAMS_FAIL((p.crop_width = 1, p.crop_height = 0), bad, "crop");
    PARAMS_FAIL((p.crop_width = 1, p.crop_height = 1, p.crop_x = 16), bad, "crop");
    PARAMS_FAIL((p.crop_width = 2, p.crop_height = 2, p.crop_y = UINT32_MAX), bad, "crop");
    PARAMS_FAIL(p.tube_refinement = 5, AMB_INVALID_ARGUMENT, "tube_refinement");
    PARAMS_FAIL(p.tube_refinement = -3, AMB_INVALID_ARGUMENT, "tube_refinement");
    PARAMS_FAIL(p.estimator = AMB_ESTIMATOR_SPECULAR + 1, AMB_UNSUPPORTED, "estimator");
    PARAMS_FAIL(p.estimator = 99, AMB_UNSUPPORTED, "estimator");
    PARAMS_FAIL(p.scatter_estimator = 99, AMB_INVALID_ARGUMENT, "scatter_estimator");
#undef PARAMS_FAIL

    /* A committed scene is frozen. */
    const AmbStatus state = AMB_INVALID_STATE;
    uint32_t id;
    AmbMesh mesh = shape_mesh(&demo.shape, "late", false);
    AmbObject object;
    amb_object_init(&object);
    FAILS(amb_scene_add_material, (scene, &demo.material, &id), state, "committed");
    FAILS(amb_scene_add_mesh, (scene, &mesh, &id), state, "committed");
    FAILS(amb_scene_add_object, (scene, &object, &id), state, "committed");
    FAILS(amb_scene_add_light, (scene, &demo.light, &id), state, "committed");
    FAILS(amb_scene_set_world, (scene, demo.world), state, "committed");
    AmbWorldImage image;
    amb_world_image_init(&image);
    FAILS(amb_scene_set_world_image, (scene, &image), state, "committed");
    AmbTexture texture;
    amb_texture_init(&texture);
    FAILS(amb_scene_add_texture, (scene, &texture, &id), state, "committed");
    FAILS(amb_scene_commit, (scene), state, "committed");
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* A struct of an older header ends early; the rest keeps its defaults. One of a newer header, or
 * one that was never initialised, is refused. */
static void struct_sizes_tell_callers_apart(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    uint32_t id;
    static const uint32_t wrong[] = {0, 3, UINT32_MAX};
    AmbMaterial material = demo.material;
    AmbMesh mesh = shape_mesh(&demo.shape, "mesh", false);
    AmbObject object;
    amb_object_init(&object);
    AmbRender *render = NULL;
    AmbRenderParams params = demo.params;
    for (int i = 0; i < 4; ++i) {
        const bool is_larger = i == 3;
#define RESIZE(s) (s).struct_size = is_larger ? (uint32_t)sizeof(s) + 4 : wrong[i % 3]
        const AmbStatus bad = AMB_INVALID_ARGUMENT;
        RESIZE(material);
        FAILS(amb_scene_add_material, (scene, &material, &id), bad, "material.struct_size");
        RESIZE(mesh);
        FAILS(amb_scene_add_mesh, (scene, &mesh, &id), bad, "mesh.struct_size");
        RESIZE(object);
        FAILS(amb_scene_add_object, (scene, &object, &id), bad, "object.struct_size");
        RESIZE(demo.light);
        FAILS(amb_scene_add_light, (scene, &demo.light, &id), bad, "light.struct_size");
        RESIZE(demo.camera);
        FAILS(amb_scene_set_camera, (scene, &demo.camera), bad, "camera.struct_size");
    }
    /* Fields after the end are not read: they would be refused. */
    material = demo.material;
    material.struct_size = offsetof(AmbMaterial, ior);
    material.ior = -1.0f;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    amb_light_init(&demo.light, AMB_LIGHT_POINT);
    demo.light.struct_size = offsetof(AmbLight, radius);
    demo.light.radius = -1.0f;
    ENSURE_STATUS(amb_scene_add_light(scene, &demo.light, &id), AMB_OK);

    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    for (int i = 0; i < 4; ++i) {
        const bool is_larger = i == 3;
        RESIZE(params);
        FAILS(amb_render_start, (scene, &params, &render), AMB_INVALID_ARGUMENT,
              "params.struct_size");
    }
    params = demo.params;
    params.struct_size = offsetof(AmbRenderParams, kernel_size);
    params.kernel_size = -1.0f;
    ENSURE_STATUS(amb_render_start(scene, &params, &render), AMB_OK);
    int32_t is_ended;
    ENSURE_STATUS(amb_render_wait(render, -1.0, &is_ended), AMB_OK);

    /* Progress is written to: an older caller's smaller struct must not be overrun. */
    AmbProgress progress;
    memset(&progress, 0x55, sizeof progress);
    progress.struct_size = offsetof(AmbProgress, stage);
    ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    ENSURE(progress.state == AMB_STATE_DONE && progress.fraction == 1.0f);
    ENSURE(progress.struct_size == offsetof(AmbProgress, stage));
    ENSURE(progress.stage[0] == 0x55 && progress.detail[95] == 0x55);
    for (int i = 0; i < 4; ++i) {
        const bool is_larger = i == 3;
        RESIZE(progress);
        FAILS(amb_render_progress, (render, &progress), AMB_INVALID_ARGUMENT,
              "progress.struct_size");
    }
#undef RESIZE
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* ---- Renders --------------------------------------------------------------------------------- */

static void render_answers_while_it_runs_and_after(void) {
    Demo demo = demo_create();
    demo.params.width = demo.params.height = 64;
    demo.params.samples = 4096;
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_OK);
    uint64_t size = 0;
    FAILS(amb_render_report, (render, NULL, 0, &size), AMB_INVALID_STATE, "running");
    FAILS(amb_render_write_exr, (render, "/tmp/x.exr", "layer"), AMB_INVALID_STATE, "running");
    int32_t is_ended = 77;
    ENSURE_STATUS(amb_render_wait(render, 0.0, &is_ended), AMB_OK);
    ENSURE(is_ended == 0);
    FAILS(amb_render_wait, (render, (double)NAN, &is_ended), AMB_INVALID_ARGUMENT, "timeout");

    /* Before the first samples there is no picture, and then there is one that grows. */
    static float pixels[64 * 64 * 4];
    float fraction = 0.0f;
    AmbProgress progress;
    amb_progress_init(&progress);
    for (;;) {
        memset(pixels, 0x55, sizeof pixels);
        const AmbStatus status = amb_render_read_pass(render, "Combined", pixels, 64 * 64 * 4);
        ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
        ENSURE(progress.fraction >= fraction && progress.fraction <= 1.0f);
        ENSURE(progress.state == AMB_STATE_RUNNING && progress.elapsed >= 0.0f);
        fraction = progress.fraction;
        if (status == AMB_OK)
            break;
        ENSURE(status == AMB_INVALID_STATE);
        ENSURE(pixels[0] == 0.0f && pixels[64 * 64 * 4 - 1] == 0.0f);
        ENSURE_STATUS(amb_render_wait(render, 0.001, &is_ended), AMB_OK);
    }
    bool is_finite = true;
    for (int i = 0; i < 64 * 64 * 4; ++i)
        is_finite = is_finite && isfinite(pixels[i]);
    ENSURE(is_finite && pixels[3] == 1.0f);
    ENSURE(progress.samples_done >= 1 || strcmp(progress.stage, "camera") == 0);

    const AmbStatus bad = AMB_INVALID_ARGUMENT;
    FAILS(amb_render_read_pass, (render, "Beauty", pixels, 16384), bad, "Beauty");
    FAILS(amb_render_read_pass, (render, NULL, pixels, 16384), bad, "name");
    FAILS(amb_render_read_pass, (render, "Combined", NULL, 16384), bad, "out_pixels");
    FAILS(amb_render_read_pass, (render, "Combined", pixels, 16383), bad, "16384");
    FAILS(amb_render_read_pass, (render, "Combined", pixels, UINT64_MAX), bad, "16384");
    uint32_t channels = 77;
    FAILS(amb_render_pass_channels, (render, "Beauty", &channels), bad, "Beauty");
    ENSURE(channels == 0);
    FAILS(amb_render_pass_channels, (render, NULL, &channels), bad, "name");
    FAILS(amb_render_pass_channels, (render, "Depth", NULL), bad, "out_channels");
    for (int p = 0; p < PASS_COUNT; ++p) {
        ENSURE_STATUS(amb_render_pass_channels(render, PASS_NAMES[p], &channels), AMB_OK);
        ENSURE(channels == PASS_CHANNELS[p]);
    }

    amb_render_cancel(render);
    FAILS(amb_render_wait, (render, -1.0, &is_ended), AMB_CANCELLED, "cancelled");
    ENSURE(is_ended == 1);
    FAILS(amb_render_wait, (render, 0.0, &is_ended), AMB_CANCELLED, "cancelled");
    ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    ENSURE(progress.state == AMB_STATE_CANCELLED && strcmp(progress.stage, "done") == 0);
    ENSURE(progress.fraction < 1.0f);
    /* What was rendered can still be had. */
    ENSURE_STATUS(amb_render_read_pass(render, "Combined", pixels, 16384), AMB_OK);
    FAILS(amb_render_report, (render, NULL, 0, NULL), bad, "out_size");
    ENSURE_STATUS(amb_render_report(render, NULL, 0, &size), AMB_OK);
    ENSURE(size > 100);
    FAILS(amb_render_write_exr, (render, NULL, "layer"), bad, "path");
    FAILS(amb_render_write_exr, (render, "/tmp/x.exr", NULL), bad, "layer");
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

static void picture_is_the_same_on_any_number_of_threads(void) {
    Demo demo = demo_create();
    demo.params.samples = 5;
    demo.params.camera_bounces = 1;
    demo.params.effects &= ~(uint32_t)AMB_EFFECT_TRANSMITTED_LIGHT;
    static const struct {
        uint32_t estimator, bounces;
        float glow;
    } cases[] = {{AMB_ESTIMATOR_POINTS_FIXED, 3, 0.0f},
                 {AMB_ESTIMATOR_POINTS_FIXED, 1, 10.0f},
                 {AMB_ESTIMATOR_POINTS_COVARIANCE, 3, 0.0f},
                 {AMB_ESTIMATOR_TUBES, 1, 0.0f},
                 {AMB_ESTIMATOR_TUBES, 4, 0.0f}, /* the last two by points */
                 {AMB_ESTIMATOR_SPECULAR, 0, 0.0f}};
    for (size_t c = 0; c < sizeof cases / sizeof cases[0]; ++c) {
        demo.params.light_bounces = cases[c].bounces;
        demo.params.estimator = cases[c].estimator;
        demo.glow = cases[c].glow;
        demo.params.threads = 1;
        Picture one = demo_render(&demo);
        picture_check(&one, "one thread");
        ENSURE(picture_mean(&one, PASS_SINGLE) > 1e-3);
        ENSURE(picture_mean(&one, PASS_SURFACE) > 0.01);
        ENSURE(picture_mean(&one, PASS_FREQUENCY) > 0.01);
        static const uint32_t threads[] = {1, 2, 3, 7, 0};
        for (size_t i = 0; i < sizeof threads / sizeof threads[0]; ++i) {
            demo.params.threads = threads[i];
            Picture many = demo_render(&demo);
            ENSURE(picture_is_same(&one, &many));
            picture_free(&many);
        }
        /* AUTO is tubes where they can be. */
        demo.params.estimator = AMB_ESTIMATOR_AUTO;
        Picture other = demo_render(&demo);
        ENSURE(picture_is_same(&one, &other) == (cases[c].estimator == AMB_ESTIMATOR_TUBES));
        picture_free(&other);
        demo.params.seed = 9;
        other = demo_render(&demo);
        ENSURE(!picture_is_same(&one, &other));
        demo.params.seed = 0;
        picture_free(&other);
        picture_free(&one);
    }
    demo_free(&demo);
}

/* A crop is the same rectangle of the whole, bit for bit. */
static void crop_is_a_part_of_the_whole(void) {
    Demo demo = demo_create();
    Picture whole = demo_render(&demo);
    demo.params.crop_x = 5;
    demo.params.crop_y = 3;
    demo.params.crop_width = 9;
    demo.params.crop_height = 13;
    Picture part = demo_render(&demo);
    picture_check(&part, "crop");
    int wrong = 0;
    for (int p = 0; p < PASS_COUNT && part.passes[p] != NULL; ++p) {
        const uint32_t c = PASS_CHANNELS[p];
        /* A pixel shares its error with its neighbours, which the crop's edge lacks. */
        const uint32_t edge = p == PASS_ERROR ? 2 : 0;
        for (uint32_t y = edge; y < 13 - edge; ++y)
            wrong += memcmp(part.passes[p] + ((uint64_t)y * 9 + edge) * c,
                            whole.passes[p] + ((uint64_t)(y + 3) * 16 + 5 + edge) * c,
                            (9 - 2 * edge) * c * sizeof(float)) != 0;
    }
    ENSURE(wrong == 0);
    picture_free(&part);
    picture_free(&whole);
    demo_free(&demo);
}

static double largest_difference(const Picture *a, const Picture *b, int pass, float factor) {
    double worst = 0.0;
    for (uint64_t i = 0; i < picture_floats(a, pass); ++i)
        worst = test_worse(
            worst, fabs((double)a->passes[pass][i] * (double)factor - (double)b->passes[pass][i]));
    return worst;
}

static void radiance_is_linear_in_power(void) {
    Demo demo = demo_create();
    demo.params.light_bounces = demo.params.camera_bounces = 2;
    memset(demo.world, 0, sizeof demo.world);
    Picture base = demo_render(&demo);
    for (float factor = 0x1p-10f; factor < 0x1p11f; factor *= 0x1p20f) {
        Demo other = demo;
        for (int k = 0; k < 3; ++k)
            other.light.color[k] *= factor;
        Picture picture = demo_render(&other);
        ENSURE(largest_difference(&base, &picture, PASS_SINGLE, factor) == 0.0);
        ENSURE(largest_difference(&base, &picture, PASS_SURFACE, factor) == 0.0);
        ENSURE(largest_difference(&base, &picture, PASS_FREQUENCY, 1.0f) == 0.0);
        picture_free(&picture);
    }
    picture_free(&base);
    demo_free(&demo);
}

/* A metre is any length: the same scene in other units is the same picture. */
static void picture_does_not_depend_on_scale(void) {
    for (uint32_t kind = AMB_LIGHT_POINT; kind <= AMB_LIGHT_AREA; ++kind) {
        Demo demo = demo_create();
        const AmbLight lamp = demo.light;
        amb_light_init(&demo.light, kind);
        memcpy(demo.light.position, lamp.position, sizeof lamp.position);
        demo.light.spot_size = 1.5f;
        demo.light.radius = 0.1f;
        demo.light.angle = 0.05f;
        for (int k = 0; k < 3; ++k) {
            demo.light.direction[k] = -lamp.position[k];
            demo.light.color[k] = 10.0f;
        }
        Picture base = demo_render(&demo);
        picture_check(&base, "scale 1");
        ENSURE(picture_mean(&base, PASS_SINGLE) > 1e-4);
        const double single = picture_mean(&base, PASS_SINGLE);
        static const float scales[] = {1e-4f, 0x1p-6f, 1e4f};
        for (size_t i = 0; i < sizeof scales / sizeof scales[0]; ++i) {
            demo.scale = scales[i];
            Picture picture = demo_render(&demo);
            picture_check(&picture, "scale");
            ENSURE_NEAR(picture_mean(&picture, PASS_SINGLE) / single, 1.0, 1e-3);
            ENSURE_NEAR(picture_mean(&picture, PASS_SURFACE) / picture_mean(&base, PASS_SURFACE),
                        1.0, 1e-3);
            ENSURE_NEAR(picture_mean(&picture, PASS_FREQUENCY), picture_mean(&base, PASS_FREQUENCY),
                        1e-3);
            picture_free(&picture);
        }
        picture_free(&base);
        demo_free(&demo);
    }
}

/* A lamp with an extent is as bright as one without: where a ray of it starts is sampled, and must
 * not widen the kernel. */
static void soft_lights_keep_their_energy(void) {
    for (uint32_t kind = AMB_LIGHT_POINT; kind <= AMB_LIGHT_AREA; ++kind) {
        double hard = 0.0;
        for (int soft = 0; soft < 2; ++soft) {
            /* Small beside the distance of 5: the light of the extended lamps differs by its
             * square, 1 %, in angle and in distance. */
            const float size = soft ? 0.5f : 1e-4f;
            Demo demo = demo_create();
            const AmbLight lamp = demo.light;
            amb_light_init(&demo.light, kind);
            memcpy(demo.light.position, lamp.position, sizeof lamp.position);
            demo.light.spot_size = 1.0f;
            demo.light.radius = 0.5f * size;
            demo.light.angle = size / 5.0f;
            demo.light.size[0] = demo.light.size[1] = size;
            for (int k = 0; k < 3; ++k) {
                demo.light.direction[k] = -lamp.position[k];
                demo.light.color[k] = kind == AMB_LIGHT_AREA ? 50.0f / (size * size) : 50.0f;
            }
            demo.params.light_samples = 100000;
            demo.params.samples = 8;
            Picture picture = demo_render(&demo);
            const double mean = picture_mean(&picture, PASS_SINGLE);
            if (soft)
                ENSURE_NEAR(mean / hard, 1.0, 0.02);
            hard = mean;
            picture_free(&picture);
            demo_free(&demo);
        }
    }
}

static void two_renders_of_one_scene(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Picture alone;
    ENSURE_STATUS(picture_render(scene, &demo.params, &alone), AMB_OK);
    amb_scene_destroy(scene);
    /* At once from the start: both want to build the scene. */
    for (int round = 0; round < 5; ++round) {
        scene = demo_scene(&demo);
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        AmbRender *renders[3];
        for (int i = 0; i < 3; ++i)
            ENSURE_STATUS(amb_render_start(scene, &demo.params, &renders[i]), AMB_OK);
        /* One gives up; the others must not notice. */
        if (round > 0)
            amb_render_cancel(renders[round % 3]);
        for (int i = 0; i < 3; ++i) {
            int32_t is_ended = 0;
            const AmbStatus status = amb_render_wait(renders[i], -1.0, &is_ended);
            ENSURE(is_ended == 1);
            if (round > 0 && i == round % 3) {
                ENSURE(status == AMB_CANCELLED || status == AMB_OK);
                continue;
            }
            ENSURE(status == AMB_OK);
            static float pixels[16 * 16 * 4];
            ENSURE_STATUS(amb_render_read_pass(renders[i], "Combined", pixels, 1024), AMB_OK);
            ENSURE(memcmp(pixels, alone.passes[PASS_COMBINED], sizeof pixels) == 0);
        }
        for (int i = 0; i < 3; ++i)
            amb_render_destroy(renders[i]);
        amb_scene_destroy(scene);
    }
    picture_free(&alone);
    demo_free(&demo);
}

/* Far from the origin, where a committed scene has an origin of its own. */
static void camera_moves_between_renders(void) {
    Demo demo = demo_create();
    demo.at[0] = 3e5f;
    demo.at[1] = -1e5f;
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_OK);
    FAILS(amb_scene_set_camera, (scene, &demo.camera), AMB_INVALID_STATE, "being rendered");
    amb_render_destroy(render);
    demo.camera_at[0] = 0.5f;
    demo.camera_at[2] = 0.25f;
    demo_set_camera(scene, &demo);
    Picture moved;
    ENSURE_STATUS(picture_render(scene, &demo.params, &moved), AMB_OK);
    Picture fresh = demo_render(&demo);
    ENSURE(picture_is_same(&moved, &fresh));
    ENSURE(picture_mean(&fresh, PASS_SINGLE) > 1e-3);
    picture_free(&moved);
    picture_free(&fresh);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

static void coarse_picture_comes_first(void) {
    Demo demo = demo_create();
    demo.params.width = 21;
    demo.params.height = 13;
    demo.params.samples = 3;
    Picture plain = demo_render(&demo);
    demo.params.coarse_first = 1;
    Picture coarse = demo_render(&demo);
    ENSURE(picture_is_same(&plain, &coarse));
    picture_free(&plain);
    picture_free(&coarse);

    enum { SIZE = 150 };
    demo.params.width = demo.params.height = SIZE;
    demo.params.estimator = AMB_ESTIMATOR_SPECULAR;
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_OK);
    AmbProgress progress;
    amb_progress_init(&progress);
    int32_t is_ended = 0;
    while (progress.pixel_step == 0) {
        ENSURE_STATUS(amb_render_wait(render, 0.001, &is_ended), AMB_OK);
        ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    }
    const uint32_t step = progress.pixel_step;
    ENSURE(step == 8 || step == 4 || step == 2 || step == 1);
    ENSURE(step == 1 || progress.samples_done == 0);
    static float pixels[SIZE * SIZE * 4];
    ENSURE_STATUS(amb_render_read_pass(render, "Combined", pixels, SIZE * SIZE * 4), AMB_OK);
    bool all_there = true;
    for (uint32_t y = 0; y < SIZE; y += step)
        for (uint32_t x = 0; x < SIZE; x += step)
            all_there = all_there && pixels[4 * (y * SIZE + x) + 3] == 1.0f;
    ENSURE(all_there);
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

static void film_can_be_transparent(void) {
    Demo demo = demo_create();
    demo.has_ground = false;
    demo.params.film_transparent = 1;
    Picture picture = demo_render(&demo);
    picture_check(&picture, "transparent");
    const float *p = picture.passes[PASS_COMBINED];
    /* The corner sees past the sphere, the middle does not. */
    ENSURE(p[0] == 0.0f && p[3] == 0.0f && picture.passes[PASS_DEPTH][0] == 1e10f);
    const uint64_t middle = 8 * 16 + 8;
    ENSURE(p[4 * middle + 3] == 1.0f);
    ENSURE_NEAR(picture.passes[PASS_DEPTH][middle], 3.1, 0.2);
    picture_free(&picture);
    demo_free(&demo);
}

/* ---- Cancelling ------------------------------------------------------------------------------ */

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

static Demo heavy_demo(void) {
    Demo demo = demo_create();
    shape_free(&demo.shape);
    demo.shape = shape_sphere(390, 390);
    demo.params.width = demo.params.height = 512;
    demo.params.samples = 4096;
    demo.params.camera_bounces = 4;
    return demo;
}

/* Seconds from the cancel to the end, when cancelled `delay` seconds after that stage began. */
static double cancel_time(AmbScene *scene, const AmbRenderParams *params, const char *stage,
                          double delay) {
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(scene, params, &render), AMB_OK);
    AmbProgress progress;
    amb_progress_init(&progress);
    int32_t is_ended = 0;
    do
        ENSURE_STATUS(amb_render_progress(render, &progress), AMB_OK);
    while (strcmp(progress.stage, stage) != 0 && progress.state == AMB_STATE_RUNNING &&
           strcmp(progress.stage, "camera") != 0 &&
           amb_render_wait(render, 0.0005, &is_ended) == AMB_OK);
    ENSURE_STATUS(amb_render_wait(render, delay, &is_ended), AMB_OK);
    ENSURE(is_ended == 0);
    const double start = now();
    amb_render_cancel(render);
    ENSURE_STATUS(amb_render_wait(render, -1.0, &is_ended), AMB_CANCELLED);
    const double took = now() - start;
    amb_render_destroy(render);
    return took;
}

static void cancel_takes_a_fifth_of_a_second(void) {
    static const struct {
        const char *stage;
        double delay;
        uint64_t light_samples;
        bool needs_new_scene; /* it is built once */
    } moments[] = {{"scene", 0.0, 1000, true},     {"scene", 0.03, 1000, true},
                   {"scene", 0.08, 1000, true},    {"light", 0.0, 4000000, false},
                   {"light", 0.1, 4000000, false}, {"field", 0.0, 3000000, false},
                   {"field", 0.2, 3000000, false}, {"camera", 0.0, 1000, false},
                   {"camera", 0.1, 100000, false}};
    Demo demo = heavy_demo();
    AmbScene *built = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(built), AMB_OK);
    const double limit = IS_SANITIZED ? 2.0 : 0.2;
    for (size_t i = 0; i < sizeof moments / sizeof moments[0]; ++i) {
        /* The best of three: the processors are not ours alone. */
        double best = INFINITY;
        for (int attempt = 0; attempt < 3 && best > limit; ++attempt) {
            AmbScene *scene = built;
            if (moments[i].needs_new_scene) {
                scene = demo_scene(&demo);
                ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
            }
            demo.params.light_samples = moments[i].light_samples / (IS_SANITIZED ? 4 : 1);
            best = fmin(best, cancel_time(scene, &demo.params, moments[i].stage, moments[i].delay));
            if (scene != built)
                amb_scene_destroy(scene);
        }
        test_check(best <= limit, __FILE__, __LINE__, "cancel %.2f s into stage %s took %.3f s",
                   moments[i].delay, moments[i].stage, best);
    }
    /* Destroying a running render cancels it. */
    AmbRender *render = NULL;
    ENSURE_STATUS(amb_render_start(built, &demo.params, &render), AMB_OK);
    int32_t is_ended;
    ENSURE_STATUS(amb_render_wait(render, 0.05, &is_ended), AMB_OK);
    const double start = now();
    amb_render_destroy(render);
    ENSURE(now() - start < 5.0);
    amb_scene_destroy(built);
    demo_free(&demo);
}

/* ---- Files and reports ----------------------------------------------------------------------- */

static bool file_exists(const char *path) {
    return access(path, F_OK) == 0;
}

static void temporary_path(char out[64], const char *name) {
    snprintf(out, 64, "/tmp/amb_test_%ld_%s", (long)getpid(), name);
}

/* Skips one JSON value; NULL where there is none. */
static const char *skip_json(const char *p);

static const char *skip_space(const char *p) {
    while (*p == ' ' || *p == '\n')
        ++p;
    return p;
}

static const char *skip_string(const char *p) {
    if (*p++ != '"')
        return NULL;
    for (; *p != '"'; ++p)
        if (*p == '\0' || *p == '\\' || (unsigned char)*p < 0x20)
            return NULL; /* the report needs no escapes */
    return p + 1;
}

static const char *skip_list(const char *p, char close, bool has_keys) {
    p = skip_space(p + 1);
    if (*p == close)
        return p + 1;
    for (;;) {
        if (has_keys) {
            p = skip_string(skip_space(p));
            if (p == NULL || *p++ != ':')
                return NULL;
        }
        p = skip_json(p);
        if (p == NULL)
            return NULL;
        p = skip_space(p);
        if (*p == close)
            return p + 1;
        if (*p++ != ',')
            return NULL;
    }
}

static const char *skip_json(const char *p) {
    p = skip_space(p);
    if (*p == '{')
        return skip_list(p, '}', true);
    if (*p == '[')
        return skip_list(p, ']', false);
    if (*p == '"')
        return skip_string(p);
    if (strncmp(p, "true", 4) == 0)
        return p + 4;
    if (strncmp(p, "false", 5) == 0)
        return p + 5;
    if (strncmp(p, "null", 4) == 0)
        return p + 4;
    char *end;
    const double value = strtod(p, &end); /* accepts nan and inf, which JSON does not */
    return end != p && isfinite(value) ? end : NULL;
}

static void check_report(const char *report) {
    const char *end = skip_json(report);
    ENSURE(end != NULL && *skip_space(end) == '\0');
    static const char *const keys[] = {"version",  "estimator", "samples",  "threads",
                                       "effects",  "stages",    "memory",   "light",
                                       "accuracy", "warnings",  "nonfinite"};
    for (size_t i = 0; i < sizeof keys / sizeof keys[0]; ++i) {
        char key[32];
        snprintf(key, sizeof key, "\"%s\":", keys[i]);
        test_check(strstr(report, key) != NULL, __FILE__, __LINE__, "the report lacks %s", key);
    }
}

/* OpenEXR's initializer names as many members as its version wants and leaves out the others. */
static exr_decode_pipeline_t new_decoder(void) {
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wmissing-field-initializers"
    const exr_decode_pipeline_t decoder = EXR_DECODE_PIPELINE_INITIALIZER;
#pragma GCC diagnostic pop
    return decoder;
}

/* One float channel of the file, top row first; what is missing stays. */
static void read_channel(exr_context_t file, const char *name, uint32_t width, float *out) {
    exr_decode_pipeline_t decoder = new_decoder();
    exr_attr_box2i_t window;
    int32_t step = 0;
    ENSURE(exr_get_data_window(file, 0, &window) == EXR_ERR_SUCCESS);
    ENSURE(exr_get_scanlines_per_chunk(file, 0, &step) == EXR_ERR_SUCCESS);
    bool is_found = false;
    for (int32_t y = window.min.y; y <= window.max.y; y += step) {
        exr_chunk_info_t chunk;
        ENSURE(exr_read_scanline_chunk_info(file, 0, y, &chunk) == EXR_ERR_SUCCESS);
        if (y == window.min.y)
            ENSURE(exr_decoding_initialize(file, 0, &chunk, &decoder) == EXR_ERR_SUCCESS);
        else
            ENSURE(exr_decoding_update(file, 0, &chunk, &decoder) == EXR_ERR_SUCCESS);
        for (int c = 0; c < decoder.channel_count; ++c) {
            exr_coding_channel_info_t *channel = &decoder.channels[c];
            const bool is_it = strcmp(channel->channel_name, name) == 0;
            channel->decode_to_ptr =
                is_it ? (uint8_t *)(out + (uint64_t)(y - window.min.y) * width) : NULL;
            channel->user_bytes_per_element = 4;
            channel->user_data_type = EXR_PIXEL_FLOAT;
            channel->user_pixel_stride = 4;
            channel->user_line_stride = (int32_t)(4 * width);
            is_found = is_found || is_it;
        }
        if (y == window.min.y)
            ENSURE(exr_decoding_choose_default_routines(file, 0, &decoder) == EXR_ERR_SUCCESS);
        ENSURE(exr_decoding_run(file, 0, &decoder) == EXR_ERR_SUCCESS);
    }
    exr_decoding_destroy(file, &decoder);
    test_check(is_found, __FILE__, __LINE__, "no channel %s", name);
}

static AmbRender *finished_render(AmbScene *scene, const AmbRenderParams *params) {
    AmbRender *render = NULL;
    int32_t is_ended;
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    ENSURE_STATUS(amb_render_start(scene, params, &render), AMB_OK);
    ENSURE_STATUS(amb_render_wait(render, -1.0, &is_ended), AMB_OK);
    return render;
}

static void file_reads_back(void) {
    enum { WIDTH = 23, HEIGHT = 37 };
    Demo demo = demo_create();
    demo.params.width = WIDTH;
    demo.params.height = HEIGHT;
    AmbScene *scene = demo_scene(&demo);
    AmbRender *render = finished_render(scene, &demo.params);
    char path[64];
    temporary_path(path, "file.exr");
    ENSURE_STATUS(amb_render_write_exr(render, path, "View Layer"), AMB_OK);
    /* Over an existing file. */
    ENSURE_STATUS(amb_render_write_exr(render, path, "View Layer"), AMB_OK);

    uint64_t size = 0, again = 0;
    ENSURE_STATUS(amb_render_report(render, NULL, 0, &size), AMB_OK);
    char *report = malloc(size + 1);
    report[size] = 'x';
    ENSURE_STATUS(amb_render_report(render, report, size, &again), AMB_OK);
    ENSURE(again == size && strlen(report) == size - 1 && report[size] == 'x');
    check_report(report);
    /* A buffer that is too small is not overrun. */
    char small[10];
    memset(small, 'x', sizeof small);
    ENSURE_STATUS(amb_render_report(render, small, 9, &again), AMB_OK);
    ENSURE(again == size && small[9] == 'x');
    free(report);

    exr_context_t file = NULL;
    exr_context_initializer_t setup = EXR_DEFAULT_CONTEXT_INITIALIZER;
    ENSURE(exr_start_read(&file, path, &setup) == EXR_ERR_SUCCESS);
    if (file != NULL) {
        int32_t length = 0;
        const char *text = NULL;
        ENSURE(exr_attr_get_string(file, 0, "amberlight:report", &length, &text) ==
               EXR_ERR_SUCCESS);
        if (text != NULL)
            check_report(text);
        static const char *const letters[PASS_COUNT] = {"RGBA", "Z", "RGB", "RGB", "RGB",
                                                        "RGB",  "X", "X",   "RGB", "XYZ"};
        for (int p = 0; p < PASS_COUNT; ++p) {
            static float pass[WIDTH * HEIGHT * 4], channel[WIDTH * HEIGHT];
            const uint32_t n = PASS_CHANNELS[p];
            ENSURE_STATUS(amb_render_read_pass(render, PASS_NAMES[p], pass, WIDTH * HEIGHT * n),
                          AMB_OK);
            for (uint32_t c = 0; c < n; ++c) {
                char name[64];
                snprintf(name, sizeof name, "View Layer.%s.%c", PASS_NAMES[p], letters[p][c]);
                memset(channel, 0xff, sizeof channel);
                read_channel(file, name, WIDTH, channel);
                int wrong = 0;
                for (uint32_t y = 0; y < HEIGHT; ++y)
                    for (uint32_t x = 0; x < WIDTH; ++x)
                        wrong += !(channel[(HEIGHT - 1 - y) * WIDTH + x] ==
                                   pass[(y * WIDTH + x) * n + c]);
                test_check(wrong == 0, __FILE__, __LINE__, "%d pixels of %s differ", wrong, name);
            }
        }
        exr_finish(&file);
    }
    remove(path);
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* Light near the largest float has shares and sums beyond all numbers, which JSON has not. */
static void report_is_json_whatever_the_light(void) {
    Demo demo = demo_create();
    for (int k = 0; k < 3; ++k)
        demo.light.color[k] = 3e38f;
    demo.params.effects_are_auto = 1;
    demo.params.width = demo.params.height = 8;
    AmbScene *scene = demo_scene(&demo);
    AmbRender *render = finished_render(scene, &demo.params);
    uint64_t size = 0;
    ENSURE_STATUS(amb_render_report(render, NULL, 0, &size), AMB_OK);
    char *report = malloc(size);
    ENSURE_STATUS(amb_render_report(render, report, size, &size), AMB_OK);
    check_report(report);
    free(report);
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

static void file_that_cannot_be_written_leaves_nothing(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    AmbRender *render = finished_render(scene, &demo.params);
    FAILS(amb_render_write_exr, (render, "/nonexistent/folder/x.exr", "L"), AMB_IO,
          "/nonexistent/folder/x.exr");
    FAILS(amb_render_write_exr, (render, "", "L"), AMB_IO, "cannot write");
    /* The name of a folder: everything works but the last step. */
    char folder[64], part[80];
    temporary_path(folder, "folder.exr");
    snprintf(part, sizeof part, "%s.part", folder);
    char inside[80];
    snprintf(inside, sizeof inside, "%s/keep", folder);
    char command[200];
    snprintf(command, sizeof command, "mkdir -p %s && touch %s", folder, inside);
    ENSURE(system(command) == 0);
    FAILS(amb_render_write_exr, (render, folder, "L"), AMB_IO, folder);
    ENSURE(!file_exists(part) && file_exists(inside));
    remove(inside);
    rmdir(folder);
    /* A name of any length. */
    char *name = malloc(70000);
    memset(name, 'n', 70000);
    name[0] = '/';
    name[69999] = '\0';
    FAILS(amb_render_write_exr, (render, name, "L"), AMB_IO, "cannot write");
    memcpy(name, folder, strlen(folder));
    name[0] = 'L';
    char path[64];
    temporary_path(path, "layer.exr");
    ENSURE_STATUS(amb_render_write_exr(render, path, name), AMB_OK);
    ENSURE(file_exists(path));
    remove(path);
    free(name);
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* A few pixels by each way to gather light: what valgrind and others run too, to whom it is slow.
 */
static void every_estimator_renders(void) {
    for (uint32_t estimator = AMB_ESTIMATOR_POINTS_FIXED; estimator <= AMB_ESTIMATOR_SPECULAR;
         ++estimator)
        for (uint32_t scatter = AMB_SCATTER_WALK; scatter <= AMB_SCATTER_TREE_CUT; ++scatter) {
            Demo demo = demo_create();
            shape_free(&demo.shape);
            demo.shape = shape_sphere(6, 8);
            demo.params.estimator = estimator;
            demo.params.scatter_estimator = scatter;
            demo.params.scatter_order_max = 4;
            demo.params.effects = UINT32_MAX;
            demo.params.light_bounces = estimator == AMB_ESTIMATOR_SPECULAR ? 0 : 1;
            demo.params.camera_bounces = 1;
            demo.params.width = demo.params.height = 4;
            demo.params.samples = 1;
            demo.params.light_samples = 500;
            Picture picture = demo_render(&demo);
            picture_check(&picture, "every estimator");
            ENSURE(picture_mean(&picture, PASS_SINGLE) > 0.0);
            picture_free(&picture);
            demo_free(&demo);
        }
}

void test_api(void);

void test_api(void) {
    RUN(every_estimator_renders);
    RUN(library_says_what_it_is);
    RUN(null_is_refused_or_harmless);
    RUN(bad_materials_are_refused);
    RUN(bad_meshes_are_refused);
    RUN(bad_lights_and_cameras_are_refused);
    RUN(bad_parameters_are_refused);
    RUN(struct_sizes_tell_callers_apart);
    RUN(render_answers_while_it_runs_and_after);
    RUN(picture_is_the_same_on_any_number_of_threads);
    RUN(crop_is_a_part_of_the_whole);
    RUN(radiance_is_linear_in_power);
    RUN(picture_does_not_depend_on_scale);
    RUN(soft_lights_keep_their_energy);
    RUN(two_renders_of_one_scene);
    RUN(camera_moves_between_renders);
    RUN(coarse_picture_comes_first);
    RUN(film_can_be_transparent);
    RUN(cancel_takes_a_fifth_of_a_second);
    RUN(file_reads_back);
    RUN(report_is_json_whatever_the_light);
    RUN(file_that_cannot_be_written_leaves_nothing);
}
