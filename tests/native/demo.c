/* SPDX-License-Identifier: GPL-3.0-or-later
 * A small scene that tests bend, and the picture of it. */
#include "demo.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "test.h"

Demo demo_create(void) {
    Demo demo = {.shape = shape_sphere(16, 32),
                 .is_smooth = true,
                 .has_ground = true,
                 .has_light = true,
                 .scale = 1.0f,
                 .material = shape_resin(1.5f, 0.5f, 0.1f, 0.3f),
                 .camera_at = {0, -4, 0.5f},
                 .world = {0.2f, 0.3f, 0.4f}};
    amb_light_init(&demo.light, AMB_LIGHT_POINT);
    demo.light.name = "lamp";
    for (int k = 0; k < 3; ++k)
        demo.light.color[k] = 50.0f - 10.0f * (float)k;
    demo.light.position[0] = 2.0f;
    demo.light.position[1] = -2.0f;
    demo.light.position[2] = 4.0f;
    amb_camera_init(&demo.camera, AMB_CAMERA_PERSPECTIVE);
    amb_render_params_init(&demo.params);
    demo.params.width = demo.params.height = 16;
    demo.params.samples = 2;
    demo.params.light_samples = 20000;
    demo.params.threads = 2;
    return demo;
}

void demo_free(Demo *demo) {
    shape_free(&demo->shape);
}

static uint32_t add_material(AmbScene *scene, const AmbMaterial *material) {
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, material, &id), AMB_OK);
    return id;
}

static void add_object(AmbScene *scene, const Demo *demo) {
    AmbMaterial material = demo->material;
    for (int k = 0; k < 3; ++k) {
        material.sigma_a[k] /= demo->scale;
        for (uint32_t l = 0; l < material.lobe_count; ++l)
            material.lobes[l].sigma_s[k] /= demo->scale;
    }
    const AmbMesh mesh = shape_mesh(&demo->shape, "hero", demo->is_smooth);
    shape_add(scene, &mesh, add_material(scene, &material), demo->scale, demo->at[0], demo->at[1],
              demo->at[2]);
}

static void add_ground(AmbScene *scene, const Demo *demo) {
    Shape plane = shape_plane();
    AmbMaterial ground;
    amb_material_init(&ground);
    ground.name = "ground";
    for (int k = 0; k < 3; ++k)
        ground.emission[k] = demo->glow;
    const AmbMesh mesh = shape_mesh(&plane, "ground", false);
    shape_add(scene, &mesh, add_material(scene, &ground), 6.0f * demo->scale, demo->at[0],
              demo->at[1], demo->at[2] - 1.1f * demo->scale);
    shape_free(&plane);
}

static void add_light(AmbScene *scene, const Demo *demo) {
    AmbLight light = demo->light;
    const float s = demo->scale;
    for (int k = 0; k < 3; ++k) {
        light.position[k] = demo->at[k] + s * light.position[k];
        if (light.kind == AMB_LIGHT_POINT || light.kind == AMB_LIGHT_SPOT)
            light.color[k] *= s * s;
    }
    light.radius *= s;
    light.size[0] *= s;
    light.size[1] *= s;
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_light(scene, &light, &id), AMB_OK);
}

void demo_set_camera(AmbScene *scene, const Demo *demo) {
    AmbCamera camera = demo->camera;
    const float s = demo->scale;
    const float rows[12] = {1, 0, 0,  demo->at[0] + s * demo->camera_at[0],
                            0, 0, -1, demo->at[1] + s * demo->camera_at[1],
                            0, 1, 0,  demo->at[2] + s * demo->camera_at[2]};
    memcpy(camera.to_world, rows, sizeof rows);
    camera.clip_start *= s;
    camera.clip_end *= s;
    if (camera.kind == AMB_CAMERA_ORTHOGRAPHIC)
        for (int i = 0; i < 4; ++i)
            camera.window[i] *= 4.0f * s;
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
}

AmbScene *demo_scene(const Demo *demo) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    if (demo->shape.positions != NULL)
        add_object(scene, demo);
    if (demo->has_ground)
        add_ground(scene, demo);
    if (demo->has_light)
        add_light(scene, demo);
    ENSURE_STATUS(amb_scene_set_world(scene, demo->world), AMB_OK);
    demo_set_camera(scene, demo);
    return scene;
}

const char *const PASS_NAMES[PASS_COUNT] = {"Combined",
                                            "Depth",
                                            "Single Scattering",
                                            "Double Scattering",
                                            "Multiple Scattering",
                                            "Surface",
                                            "Frequency",
                                            "Error",
                                            "Denoising Albedo",
                                            "Denoising Normal"};
const uint32_t PASS_CHANNELS[PASS_COUNT] = {4, 1, 3, 3, 3, 3, 1, 1, 3, 3};

uint64_t picture_floats(const Picture *picture, int pass) {
    return (uint64_t)picture->width * picture->height * PASS_CHANNELS[pass];
}

static void read_picture(AmbRender *render, Picture *out) {
    for (int p = 0; p < PASS_COUNT; ++p) {
        const uint64_t count = picture_floats(out, p);
        out->passes[p] = malloc(count * sizeof(float));
        if (out->passes[p] == NULL)
            abort();
        ENSURE_STATUS(amb_render_read_pass(render, PASS_NAMES[p], out->passes[p], count), AMB_OK);
    }
    uint64_t size = 0;
    ENSURE_STATUS(amb_render_report(render, NULL, 0, &size), AMB_OK);
    out->report = malloc(size);
    if (out->report == NULL)
        abort();
    ENSURE_STATUS(amb_render_report(render, out->report, size, &size), AMB_OK);
}

AmbStatus picture_render(AmbScene *scene, const AmbRenderParams *params, Picture *out) {
    memset(out, 0, sizeof *out);
    AmbRender *render = NULL;
    AmbStatus status = amb_render_start(scene, params, &render);
    if (status != AMB_OK)
        return status;
    int32_t is_ended = 0;
    status = amb_render_wait(render, -1.0, &is_ended);
    ENSURE(is_ended == 1);
    if (status == AMB_OK) {
        out->width = params->crop_width > 0 ? params->crop_width : params->width;
        out->height = params->crop_width > 0 ? params->crop_height : params->height;
        read_picture(render, out);
    }
    amb_render_destroy(render);
    return status;
}

Picture demo_render(const Demo *demo) {
    AmbScene *scene = demo_scene(demo);
    Picture picture = {0};
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    ENSURE_STATUS(picture_render(scene, &demo->params, &picture), AMB_OK);
    amb_scene_destroy(scene);
    return picture;
}

void picture_free(Picture *picture) {
    for (int p = 0; p < PASS_COUNT; ++p)
        free(picture->passes[p]);
    free(picture->report);
    memset(picture, 0, sizeof *picture);
}

bool picture_is_same(const Picture *a, const Picture *b) {
    if (a->width != b->width || a->height != b->height || a->passes[0] == NULL ||
        b->passes[0] == NULL)
        return false;
    for (int p = 0; p < PASS_COUNT; ++p)
        if (memcmp(a->passes[p], b->passes[p], picture_floats(a, p) * sizeof(float)) != 0)
            return false;
    return true;
}

double picture_mean(const Picture *picture, int pass) {
    const uint64_t count = picture_floats(picture, pass);
    double sum = 0.0;
    for (uint64_t i = 0; i < count && picture->passes[pass] != NULL; ++i)
        sum += (double)picture->passes[pass][i];
    return sum / (double)count;
}

/* How many values are not as they must be. */
static uint64_t count_wrong(const Picture *picture, int pass) {
    uint64_t wrong = 0;
    const uint32_t channels = PASS_CHANNELS[pass];
    const float limit = pass == PASS_FREQUENCY ? 1.0f + 1e-5f : INFINITY;
    for (uint64_t i = 0; i < picture_floats(picture, pass); ++i) {
        const float v = picture->passes[pass][i];
        /* An orthographic camera sees behind itself. */
        const bool may_be_negative = pass == PASS_DEPTH || pass == PASS_NORMAL;
        const bool is_alpha = pass == PASS_COMBINED && i % channels == 3;
        wrong +=
            !isfinite(v) || (v < 0.0f && !may_be_negative) || v > limit || (is_alpha && v > 1.0f);
    }
    return wrong;
}

void picture_check(const Picture *picture, const char *what) {
    test_check(picture->passes[0] != NULL, __FILE__, __LINE__, "%s: no picture", what);
    if (picture->passes[0] == NULL)
        return;
    for (int p = 0; p < PASS_COUNT; ++p) {
        const uint64_t wrong = count_wrong(picture, p);
        test_check(wrong == 0, __FILE__, __LINE__, "%s: %llu wrong values in %s", what,
                   (unsigned long long)wrong, PASS_NAMES[p]);
    }
    const float *combined = picture->passes[PASS_COMBINED];
    uint64_t unequal = 0;
    for (uint64_t i = 0; i < (uint64_t)picture->width * picture->height; ++i)
        for (int k = 0; k < 3; ++k) {
            double sum = 0.0;
            for (int p = PASS_SINGLE; p <= PASS_SURFACE; ++p)
                sum += (double)picture->passes[p][3 * i + (uint64_t)k];
            unequal += fabs((double)combined[4 * i + (uint64_t)k] - sum) > 4e-7 * sum;
        }
    test_check(unequal == 0, __FILE__, __LINE__, "%s: Combined is not the sum of its parts in %llu",
               what, (unsigned long long)unequal);
    test_check(strstr(picture->report, "\"nonfinite\": 0,") != NULL, __FILE__, __LINE__,
               "%s: samples were refused", what);
}
