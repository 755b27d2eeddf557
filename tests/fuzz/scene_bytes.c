/* SPDX-License-Identifier: GPL-3.0-or-later
 * A scene decoded from bytes: any string of them is a sequence of calls of the public interface,
 * and every sequence ends in a picture or in one clear error. */
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "amberlight/amberlight.h"
#include "fuzz.h"

enum { STEP_MAX = 20, VERTEX_MAX = 64, TRIANGLE_MAX = 96, SIDE_MAX = 5, PASS_MAX = 10 };
/* Images come from so many of the last bytes, whatever else those say: seeds stay the stories that
 * they are. */
enum { IMAGE_BYTES = 64, IMAGE_SIDE_MAX = 5 };

typedef struct Story {
    Bytes bytes, images;
    AmbScene *scene;
    bool is_moderate; /* nothing taken so far could overflow a float by itself */
    bool is_small;    /* pictures of a millisecond */
    bool has_camera;
    uint32_t materials, meshes;
} Story;

static unsigned long long stories, pictures, refusals;

/* Mostly within the range, sometimes at its ends or 0, rarely anything at all. */
static float any_number(Bytes *bytes, float low, float high) {
    static const float specials[] = {0.0f,    -0.0f,   1.0f,   -1.0f,    1e-7f, 1e7f,
                                     FLT_MIN, FLT_MAX, 1e-42f, -FLT_MAX, 1e20f, 1e-20f};
    const uint32_t kind = bytes_u8(bytes);
    if (kind < 252)
        return (float)bytes_uniform(bytes, (double)low, (double)high);
    if (kind < 254)
        return kind == 252 ? low : high;
    if (kind < 255)
        return specials[bytes_below(bytes, sizeof specials / sizeof specials[0])];
    const uint32_t bits = bytes_u32(bytes);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static float any_float(Story *story, float low, float high) {
    const float value = any_number(&story->bytes, low, high);
    const float size = fabsf(value);
    story->is_moderate = story->is_moderate && (size == 0.0f || (size >= 1e-7f && size <= 1e7f));
    return value;
}

static void any_floats(Story *story, float *out, int count, float low, float high) {
    for (int i = 0; i < count; ++i)
        out[i] = any_float(story, low, high);
}

/* Most often one of those that there are. */
static uint32_t any_id(Story *story, uint32_t count) {
    const uint32_t id = bytes_u8(&story->bytes);
    return id < 250 && count > 0 ? id % count : id;
}

/* The status is one that a caller may get, and a failure has a sentence. */
static AmbStatus checked(AmbStatus status) {
    FUZZ_HOLDS(status >= AMB_OK && status < AMB_INTERNAL && status != AMB_IO, "status %d", status);
    if (status != AMB_OK) {
        ++refusals;
        AmbErrorInfo info;
        amb_last_error(&info);
        FUZZ_HOLDS(info.status == status && info.message[0] != '\0' && info.function[0] != '\0',
                   "%s without a message", amb_status_name(status));
    }
    return status;
}

/* Pixels of any image: even in the range, but for one that may be anything. */
static void any_pixels(Story *story, float *out, uint32_t count, float high) {
    Bytes *bytes = &story->images;
    for (uint32_t i = 0; i < count; ++i)
        out[i] = (float)bytes_uniform(bytes, 0.0, (double)high);
    if (count > 0)
        out[bytes_below(bytes, count)] = any_number(bytes, 0.0f, high);
}

/* An image on the material, somewhere. Whatever its numbers are, what is seen is in range. */
static void add_texture(Story *story, AmbMaterial *material) {
    Bytes *bytes = &story->images;
    if (bytes_below(bytes, 2) == 0)
        return;
    float pixels[IMAGE_SIDE_MAX * IMAGE_SIDE_MAX * 3];
    AmbTexture texture;
    amb_texture_init(&texture);
    texture.name = "picture";
    texture.width = bytes_below(bytes, IMAGE_SIDE_MAX + 1);
    texture.height = bytes_below(bytes, IMAGE_SIDE_MAX + 1);
    texture.extension = bytes_below(bytes, 5);
    texture.interpolation = bytes_below(bytes, 2);
    texture.color = bytes_below(bytes, 64) == 0 ? NULL : pixels;
    any_pixels(story, pixels, 3 * texture.width * texture.height, 1.0f);
    checked(amb_scene_add_texture(story->scene, &texture, &material->texture));
    if (bytes_below(bytes, 64) == 0)
        material->texture = bytes_u8(bytes);
    for (int i = 0; i < 6; ++i)
        material->uv_to_texture[i] = any_number(bytes, -2.0f, 2.0f);
}

static void add_material(Story *story) {
    AmbMaterial material;
    amb_material_init(&material);
    Bytes *bytes = &story->bytes;
    material.surface = bytes_below(bytes, 16) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 3) > 0;
    material.name = "matter";
    any_floats(story, material.albedo, 3, 0.0f, 1.0f);
    if (bytes_below(bytes, 4) == 0)
        any_floats(story, material.emission, 3, 0.0f, 10.0f);
    if (bytes_below(bytes, 4) == 0) {
        any_floats(story, material.transmit_color, 3, 0.0f, 1.0f);
        any_floats(story, material.reflect_color, 3, 0.0f, 1.0f);
    }
    material.ior = any_float(story, 0.6f, 2.6f);
    any_floats(story, material.sigma_a, 3, 0.0f, 2.0f);
    material.lobe_count = bytes_below(bytes, 32) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 3);
    for (uint32_t i = 0; i < 3; ++i) {
        any_floats(story, material.lobes[i].sigma_s, 3, 0.0f, 5.0f);
        material.lobes[i].g = any_float(story, -0.95f, 0.95f);
    }
    add_texture(story, &material);
    uint32_t id = 0;
    if (checked(amb_scene_add_material(story->scene, &material, &id)) == AMB_OK)
        story->materials = id + 1;
}

/* An octahedron with some of its faces divided, its vertices moved; or anything. */
static void add_mesh(Story *story) {
    static const float corners[6][3] = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                        {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
    static const uint32_t faces[8][3] = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4},
                                         {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
    float positions[VERTEX_MAX][3] = {{0}}, normals[3 * TRIANGLE_MAX][3];
    float uvs[3 * TRIANGLE_MAX][2];
    uint32_t triangles[TRIANGLE_MAX][3] = {{0}}, slots[TRIANGLE_MAX];
    Bytes *bytes = &story->bytes;
    AmbMesh mesh;
    amb_mesh_init(&mesh);
    mesh.name = "mesh";
    mesh.vertex_count = 6;
    mesh.triangle_count = 8;
    memcpy(positions, corners, sizeof corners);
    memcpy(triangles, faces, sizeof faces);
    const uint32_t parts = bytes_below(bytes, 16);
    for (uint32_t i = 0; i < parts; ++i) {
        /* One more vertex in the middle of a face, a little off its plane. */
        uint32_t *face = triangles[bytes_below(bytes, (uint32_t)mesh.triangle_count)];
        const uint32_t v = (uint32_t)mesh.vertex_count++;
        for (int k = 0; k < 3; ++k)
            positions[v][k] =
                (positions[face[0]][k] + positions[face[1]][k] + positions[face[2]][k]) / 3.0f *
                (float)bytes_uniform(bytes, 0.7, 1.9);
        uint32_t *second = triangles[mesh.triangle_count], *third = second + 3;
        const uint32_t a = face[0], b = face[1], c = face[2];
        second[0] = b, second[1] = c, second[2] = v;
        third[0] = c, third[1] = a, third[2] = v;
        face[0] = a, face[1] = b, face[2] = v;
        mesh.triangle_count += 2;
    }
    const uint32_t broken = bytes_below(bytes, 64);
    for (uint32_t i = 0; i < broken && i < 6; ++i) {
        if (broken >= 16)
            break;
        if (broken % 2 == 0)
            triangles[bytes_below(bytes, (uint32_t)mesh.triangle_count)][i % 3] =
                bytes_below(bytes, broken < 2 ? 255 : (uint32_t)mesh.vertex_count);
        else
            any_floats(story, positions[bytes_below(bytes, (uint32_t)mesh.vertex_count)], 3, -1.5f,
                       1.5f);
    }
    mesh.normal_domain = bytes_below(bytes, 32) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 3);
    const bool is_wild = bytes_below(bytes, 16) == 0;
    for (uint32_t i = 0; i < 3 * TRIANGLE_MAX; ++i) {
        const uint32_t v = mesh.normal_domain == AMB_NORMALS_CORNER ? triangles[i / 3][i % 3] : i;
        for (int k = 0; k < 3; ++k)
            normals[i][k] = v < VERTEX_MAX ? positions[v][k] : 1.0f;
        if (is_wild)
            any_floats(story, normals[i], 3, -1.0f, 1.0f);
    }
    for (uint32_t i = 0; i < TRIANGLE_MAX; ++i)
        slots[i] = bytes_below(bytes, 8) == 0;
    float corners_of_image[4][2];
    for (int i = 0; i < 8; ++i)
        corners_of_image[i / 2][i % 2] = any_number(&story->images, -2.0f, 2.0f);
    for (uint32_t i = 0; i < 3 * TRIANGLE_MAX; ++i)
        memcpy(uvs[i], corners_of_image[(i + i / 3) % 4], sizeof uvs[i]);
    mesh.uvs = bytes_below(&story->images, 4) == 0 ? NULL : uvs[0];
    mesh.positions = positions[0];
    mesh.triangles = triangles[0];
    mesh.normals = normals[0];
    mesh.slots = bytes_below(bytes, 4) == 0 ? slots : NULL;
    uint32_t id = 0;
    if (checked(amb_scene_add_mesh(story->scene, &mesh, &id)) == AMB_OK)
        story->meshes = id + 1;
}

static void add_object(Story *story) {
    AmbObject object;
    amb_object_init(&object);
    Bytes *bytes = &story->bytes;
    uint32_t materials[3];
    for (int i = 0; i < 3; ++i)
        materials[i] = any_id(story, story->materials);
    object.mesh = any_id(story, story->meshes);
    object.name = "thing";
    object.materials = materials;
    object.material_count = bytes_below(bytes, 64) == 0 ? 0 : 1 + bytes_below(bytes, 3);
    if (bytes_below(bytes, 2) == 0)
        for (int i = 0; i < 3; ++i) {
            object.to_world[4 * i + 3] = any_float(story, -2.0f, 2.0f);
            object.to_world[5 * i] = any_float(story, 0.2f, 2.0f);
        }
    if (bytes_below(bytes, 8) == 0)
        any_floats(story, object.to_world, 12, -2.0f, 2.0f);
    uint32_t id;
    checked(amb_scene_add_object(story->scene, &object, &id));
}

static void add_light(Story *story) {
    AmbLight light;
    Bytes *bytes = &story->bytes;
    amb_light_init(&light, bytes_below(bytes, 64) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 4));
    light.name = "lamp";
    any_floats(story, light.color, 3, 0.0f, 100.0f);
    any_floats(story, light.position, 3, -5.0f, 5.0f);
    any_floats(story, light.direction, 3, -1.0f, 1.0f);
    any_floats(story, light.tangent, 3, -1.0f, 1.0f);
    if (bytes_below(bytes, 2) == 0) {
        light.radius = any_float(story, 0.0f, 1.0f);
        light.angle = any_float(story, 0.0f, 1.0f);
    }
    light.spot_size = any_float(story, 0.01f, 3.1f);
    light.spot_blend = any_float(story, 0.0f, 1.0f);
    light.spot_cosine = (float)bytes_below(bytes, 2);
    any_floats(story, light.size, 2, 0.01f, 2.0f);
    light.area_shape = bytes_below(bytes, 2);
    uint32_t id;
    checked(amb_scene_add_light(story->scene, &light, &id));
}

static void set_world(Story *story) {
    float world[3];
    any_floats(story, world, 3, 0.0f, 2.0f);
    checked(amb_scene_set_world(story->scene, world));
    Bytes *bytes = &story->images;
    if (bytes_below(bytes, 2) == 0)
        return;
    /* Bright in one pixel, now and then: a lamp. */
    float pixels[IMAGE_SIDE_MAX * IMAGE_SIDE_MAX * 3];
    AmbWorldImage image;
    amb_world_image_init(&image);
    image.width = bytes_below(bytes, IMAGE_SIDE_MAX + 1);
    image.height = bytes_below(bytes, IMAGE_SIDE_MAX + 1);
    image.radiance = pixels;
    const uint32_t count = 3 * image.width * image.height;
    any_pixels(story, pixels, count, 2.0f);
    const float bright = any_number(bytes, 0.0f, 1e5f);
    if (count > 0)
        pixels[bytes_below(bytes, count)] = bright;
    for (uint32_t i = 0; i < count; ++i)
        story->is_moderate = story->is_moderate && pixels[i] <= 1e7f;
    checked(amb_scene_set_world_image(story->scene, &image));
}

static void set_camera(Story *story) {
    AmbCamera camera;
    Bytes *bytes = &story->bytes;
    amb_camera_init(&camera, bytes_below(bytes, 32) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 2));
    camera.to_world[11] = any_float(story, 0.0f, 6.0f);
    if (bytes_below(bytes, 4) == 0)
        any_floats(story, camera.to_world, 12, -2.0f, 2.0f);
    if (bytes_below(bytes, 4) == 0) {
        any_floats(story, camera.window, 4, -2.0f, 2.0f);
        camera.clip_start = any_float(story, 0.001f, 3.0f);
        camera.clip_end = any_float(story, 3.0f, 100.0f);
    }
    if (bytes_below(bytes, 4) == 0) {
        camera.lens_radius = any_float(story, 0.0f, 0.5f);
        camera.focus_distance = any_float(story, 0.1f, 6.0f);
    }
    story->has_camera =
        checked(amb_scene_set_camera(story->scene, &camera)) == AMB_OK || story->has_camera;
}

static AmbRenderParams any_params(Story *story) {
    AmbRenderParams params;
    amb_render_params_init(&params);
    Bytes *bytes = &story->bytes;
    params.width = 1 + bytes_below(bytes, SIDE_MAX);
    params.height = 1 + bytes_below(bytes, SIDE_MAX);
    params.samples = 1 + bytes_below(bytes, 2);
    params.estimator = bytes_below(bytes, 32) == 0 ? bytes_u8(bytes) : bytes_below(bytes, 5);
    params.effects = bytes_below(bytes, 2) == 0 ? params.effects : bytes_u8(bytes);
    params.light_samples = 1 + 2u * bytes_u8(bytes);
    params.kernel_size = any_float(story, 0.5f, 6.0f);
    params.light_bounces = bytes_below(bytes, 3);
    params.camera_bounces = bytes_below(bytes, 3);
    params.adjoint_normals = bytes_below(bytes, 2);
    params.seed = bytes_u8(bytes);
    /* The ninth and tenth effect, without a byte of their own: seeds stay the stories that they
     * are. */
    params.effects ^= params.seed / 16 % 4 << 8;
    params.threads = 1;
    params.film_transparent = bytes_below(bytes, 2);
    const int32_t refinement = (int32_t)bytes_below(bytes, 16);
    params.tube_refinement = refinement == 0  ? (int32_t)bytes_below(bytes, 6)
                             : refinement < 3 ? -refinement
                                              : 0;
    params.scatter_estimator =
        bytes_below(bytes, 16) == 0 ? bytes_below(bytes, 5) : bytes_below(bytes, 3);
    params.scatter_order_max = bytes_below(bytes, 4);
    params.effects_are_auto = bytes_below(bytes, 2);
    /* Tubes are cut until they meet it: what bounds the time of a story, mostly. One in eight may
     * have many. */
    params.memory_limit = (params.seed % 8 == 7 ? 24u : 8u) << 20;
    if (story->is_small) {
        params.light_samples = 1 + params.light_samples / 16;
        params.memory_limit = 3u << 20;
        params.width = 1 + params.width / 3;
        params.height = 1 + params.height / 3;
    }
    if (bytes_below(bytes, 8) == 0) {
        params.crop_x = bytes_below(bytes, SIDE_MAX);
        params.crop_y = bytes_below(bytes, SIDE_MAX);
        params.crop_width = bytes_below(bytes, SIDE_MAX);
        params.crop_height = bytes_below(bytes, SIDE_MAX);
    }
    if (bytes_below(bytes, 128) == 1)
        params.accuracy = any_float(story, 0.2f, 1.0f);
    return params;
}

/* Every value of every pass is a number, and where nothing was extreme none was refused. */
static void check_picture(const Story *story, AmbRender *render, const AmbRenderParams *params) {
    static const char *const passes[PASS_MAX] = {"Combined",          "Depth",
                                                 "Single Scattering", "Surface",
                                                 "Double Scattering", "Multiple Scattering",
                                                 "Frequency",         "Error",
                                                 "Denoising Albedo",  "Denoising Normal"};
    const uint64_t pixels = params->crop_width > 0
                                ? (uint64_t)params->crop_width * params->crop_height
                                : (uint64_t)params->width * params->height;
    float values[SIDE_MAX * SIDE_MAX * 4];
    for (int p = 0; p < PASS_MAX; ++p) {
        uint32_t channels = 0;
        checked(amb_render_pass_channels(render, passes[p], &channels));
        const uint64_t count = pixels * channels;
        FUZZ_HOLDS(checked(amb_render_read_pass(render, passes[p], values, count)) == AMB_OK,
                   "no pass %s", passes[p]);
        /* Depth and normals may be negative, and what a tree cut adds to second order. */
        const bool may_be_negative =
            p == 1 || p == 9 || params->scatter_estimator == AMB_SCATTER_TREE_CUT;
        for (uint64_t i = 0; i < count && story->is_moderate; ++i)
            FUZZ_HOLDS(isfinite(values[i]) && (may_be_negative || values[i] >= 0.0f), "%s has %g",
                       passes[p], (double)values[i]);
    }
    uint64_t size = 0;
    checked(amb_render_report(render, NULL, 0, &size));
    char *report = malloc(size);
    if (report == NULL)
        abort();
    checked(amb_render_report(render, report, size, &size));
    FUZZ_HOLDS(!story->is_moderate || strstr(report, "\"nonfinite\": 0,") != NULL,
               "samples were refused: %s", strstr(report, "\"nonfinite\""));
    static const char *const none[] = {": inf", ": -inf", ": nan", ": -nan", "[inf",  "[-inf",
                                       "[nan",  "[-nan",  ", inf", ", -inf", ", nan", ", -nan"};
    for (size_t i = 0; i < sizeof none / sizeof none[0]; ++i)
        FUZZ_HOLDS(strstr(report, none[i]) == NULL, "JSON has no%s", none[i] + 1);
    free(report);
}

/* What a render would do, in words. */
static void explain(const Story *story, const AmbRenderParams *params) {
    char text[1 << 14];
    uint64_t size = 0;
    checked(amb_plan_explain(story->scene, params, text, sizeof text, &size));
}

static void render(Story *story) {
    AmbRenderParams params = any_params(story);
    params.coarse_first = bytes_below(&story->images, 2);
    if (bytes_below(&story->images, 16) == 0)
        explain(story, &params);
    AmbRender *render = NULL;
    if (checked(amb_render_start(story->scene, &params, &render)) != AMB_OK)
        return;
    const uint32_t end = bytes_below(&story->bytes, 32);
    if (end == 0)
        amb_render_cancel(render);
    int32_t is_ended = 0;
    const AmbStatus status = end == 1 ? AMB_CANCELLED : amb_render_wait(render, -1.0, &is_ended);
    if (end != 1)
        checked(status);
    if (status == AMB_OK) {
        ++pictures;
        check_picture(story, render, &params);
    }
    amb_render_destroy(render);
}

void fuzz_scene_report(void) {
    printf("%llu stories, %llu pictures, %llu refused\n", stories, pictures, refusals);
}

unsigned long long fuzz_scene_pictures(void) {
    return pictures;
}

static void tell(const uint8_t *data, size_t size, bool is_small) {
    ++stories;
    const size_t image_bytes = size < IMAGE_BYTES ? size : IMAGE_BYTES;
    Story story = {.bytes = {data, size, 0},
                   .images = {data + size - image_bytes, image_bytes, 0},
                   .is_moderate = true,
                   .is_small = is_small};
    if (checked(amb_scene_create(&story.scene)) != AMB_OK)
        return;
    /* Something to see first, so that few stories are about nothing. */
    add_material(&story);
    add_mesh(&story);
    add_object(&story);
    const uint32_t steps = bytes_below(&story.bytes, STEP_MAX);
    for (uint32_t i = 0; i < steps; ++i) {
        static void (*const parts[])(Story *) = {add_material, add_mesh,  add_object, add_light,
                                                 add_light,    set_world, set_camera, render};
        parts[bytes_below(&story.bytes, sizeof parts / sizeof parts[0])](&story);
    }
    add_light(&story);
    if (!story.has_camera)
        set_camera(&story);
    if (checked(amb_scene_commit(story.scene)) == AMB_OK)
        render(&story);
    amb_scene_destroy(story.scene);
}

void fuzz_scene(const uint8_t *data, size_t size) {
    tell(data, size, false);
}

void fuzz_small(const uint8_t *data, size_t size) {
    tell(data, size, true);
}
