/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * A stand-in for the library that renders nothing: it keeps the state machine of amberlight.h and
 * counts what is alive, so that the binding can be tested for order, lifetimes and messages.
 * Compiled by conftest.py, with FAKE_* definitions for the broken variants.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "amberlight/amberlight.h"

#ifndef FAKE_ABI_VERSION
#define FAKE_ABI_VERSION AMB_ABI_VERSION
#endif

struct AmbScene {
    uint32_t counts[5];
    int has_camera, is_committed;
    uint64_t triangles;
};

struct AmbRender {
    AmbRenderParams params;
    uint32_t state;
    int polls;
};

static _Thread_local AmbErrorInfo last_error;
static int32_t scenes_alive, renders_alive;

/* Counts for the tests; not part of amberlight.h. */
AMB_API int32_t fake_scenes_alive(void);
AMB_API int32_t fake_renders_alive(void);
int32_t fake_scenes_alive(void) {
    return scenes_alive;
}
int32_t fake_renders_alive(void) {
    return renders_alive;
}

static AmbStatus fail(AmbStatus status, const char *function, const char *message) {
    last_error.status = status;
    snprintf(last_error.function, sizeof last_error.function, "%s", function);
    snprintf(last_error.message, sizeof last_error.message, "%s", message);
    return status;
}

void amb_last_error(AmbErrorInfo *out_info) {
    *out_info = last_error;
}
const char *amb_status_name(AmbStatus status) {
    static const char *const names[] = {
#define NAME(name, value, message) [value] = #name,
        AMB_STATUS_LIST(NAME)
#undef NAME
    };
    return status >= 0 && status <= AMB_INTERNAL ? names[status] : "UNKNOWN";
}
uint32_t amb_abi_version(void) {
    return FAKE_ABI_VERSION;
}
const char *amb_version_string(void) {
    return AMB_VERSION_STRING;
}

uint64_t amb_struct_size(uint32_t struct_id) {
    static const uint64_t sizes[AMB_STRUCT_COUNT] = {
        sizeof(AmbErrorInfo), sizeof(AmbPhaseLobe),  sizeof(AmbMaterial), sizeof(AmbMesh),
        sizeof(AmbObject),    sizeof(AmbLight),      sizeof(AmbCamera),   sizeof(AmbRenderParams),
        sizeof(AmbProgress),  sizeof(AmbWorldImage), sizeof(AmbTexture)};
#ifdef FAKE_STRUCT_SIZE
    if (struct_id == AMB_STRUCT_LIGHT)
        return FAKE_STRUCT_SIZE;
#endif
    return struct_id < AMB_STRUCT_COUNT ? sizes[struct_id] : 0;
}

#ifndef FAKE_LACKS_SELF_TEST
AmbStatus amb_self_test(void) {
#ifdef FAKE_SELF_TEST_FAILS
    return fail(AMB_INTERNAL, "amb_self_test", "Embree 3 was compiled in, Embree 4 answers");
#else
    return AMB_OK;
#endif
}
#endif

AmbStatus amb_scene_create(AmbScene **out_scene) {
    *out_scene = calloc(1, sizeof **out_scene);
    ++scenes_alive;
    return AMB_OK;
}
void amb_scene_destroy(AmbScene *scene) {
    if (!scene)
        return;
    /* The header's rule; a process that breaks it must not go on. */
    if (renders_alive > 0 && scenes_alive == 1)
        abort();
    --scenes_alive;
    free(scene);
}

static AmbStatus add(AmbScene *scene, int kind, const char *function, uint32_t *out_id) {
    if (scene->is_committed)
        return fail(AMB_INVALID_STATE, function, "the scene is committed");
    *out_id = scene->counts[kind]++;
    return AMB_OK;
}

#define INIT(type, name)                                                                           \
    void name(type *s) {                                                                           \
        memset(s, 0, sizeof *s);                                                                   \
        s->struct_size = (uint32_t)sizeof *s;                                                      \
    }
INIT(AmbMaterial, amb_material_init)
INIT(AmbMesh, amb_mesh_init)
INIT(AmbObject, amb_object_init)
INIT(AmbRenderParams, amb_render_params_init)
INIT(AmbProgress, amb_progress_init)
INIT(AmbWorldImage, amb_world_image_init)
INIT(AmbTexture, amb_texture_init)
void amb_light_init(AmbLight *light, uint32_t kind) {
    memset(light, 0, sizeof *light);
    light->struct_size = (uint32_t)sizeof *light;
    light->kind = kind;
}
void amb_camera_init(AmbCamera *camera, uint32_t kind) {
    memset(camera, 0, sizeof *camera);
    camera->struct_size = (uint32_t)sizeof *camera;
    camera->kind = kind;
}

AmbStatus amb_scene_add_texture(AmbScene *scene, const AmbTexture *texture, uint32_t *out_id) {
    if (texture->width == 0 || texture->height == 0 || texture->color == NULL)
        return fail(AMB_INVALID_ARGUMENT, "amb_scene_add_texture", "no pixels");
    const AmbStatus status = add(scene, 4, "amb_scene_add_texture", out_id);
    *out_id += status == AMB_OK;
    return status;
}
AmbStatus amb_scene_add_material(AmbScene *scene, const AmbMaterial *material, uint32_t *out_id) {
    if (material->lobe_count > AMB_PHASE_LOBE_MAX)
        return fail(AMB_INVALID_ARGUMENT, "amb_scene_add_material", "too many lobes");
    return add(scene, 0, "amb_scene_add_material", out_id);
}
AmbStatus amb_scene_add_mesh(AmbScene *scene, const AmbMesh *mesh, uint32_t *out_id) {
    for (uint64_t i = 0; i < 3 * mesh->vertex_count; ++i)
        if (!(mesh->positions[i] - mesh->positions[i] == 0.0f)) {
            char message[256];
            snprintf(message, sizeof message, "a position of mesh \"%s\" is not finite",
                     mesh->name);
            return fail(AMB_INVALID_ARGUMENT, "amb_scene_add_mesh", message);
        }
    scene->triangles += mesh->triangle_count;
    return add(scene, 1, "amb_scene_add_mesh", out_id);
}
AmbStatus amb_scene_add_object(AmbScene *scene, const AmbObject *object, uint32_t *out_id) {
    if (object->mesh >= scene->counts[1] || object->material_count < 1)
        return fail(AMB_INVALID_ARGUMENT, "amb_scene_add_object", "no such mesh");
    return add(scene, 2, "amb_scene_add_object", out_id);
}
AmbStatus amb_scene_add_light(AmbScene *scene, const AmbLight *light, uint32_t *out_id) {
    (void)light;
    return add(scene, 3, "amb_scene_add_light", out_id);
}
AmbStatus amb_scene_set_world(AmbScene *scene, const float radiance[3]) {
    (void)scene;
    (void)radiance;
    return AMB_OK;
}
AmbStatus amb_scene_set_world_image(AmbScene *scene, const AmbWorldImage *image) {
    (void)scene;
    return image->width > 0 && image->height > 0 && image->radiance != NULL
               ? AMB_OK
               : fail(AMB_INVALID_ARGUMENT, "amb_scene_set_world_image", "no pixels");
}
AmbStatus amb_scene_set_camera(AmbScene *scene, const AmbCamera *camera) {
    (void)camera;
    scene->has_camera = 1;
    return AMB_OK;
}
AmbStatus amb_scene_commit(AmbScene *scene) {
    if (!scene->has_camera)
        return fail(AMB_INVALID_ARGUMENT, "amb_scene_commit", "the scene has no camera");
    scene->is_committed = 1;
    return AMB_OK;
}

AmbStatus amb_render_start(AmbScene *scene, const AmbRenderParams *params, AmbRender **out_render) {
    *out_render = NULL;
    if (!scene->is_committed)
        return fail(AMB_INVALID_STATE, "amb_render_start", "the scene is not committed");
    if (params->estimator >= AMB_ESTIMATOR_SPECULAR)
        return fail(AMB_UNSUPPORTED, "amb_render_start",
                    "this estimator is not available in this version");
    *out_render = calloc(1, sizeof **out_render);
    (*out_render)->params = *params;
    ++renders_alive;
    return AMB_OK;
}

/* Samples above 1000 stand for a render that never ends by itself. */
static int is_endless(const AmbRender *render) {
    return render->params.samples > 1000;
}

AmbStatus amb_render_progress(AmbRender *render, AmbProgress *out_progress) {
    out_progress->state = render->state;
    out_progress->fraction = (float)(render->polls < 4 ? render->polls : 4) / 4.0f;
    out_progress->samples_done = out_progress->pixel_step = render->polls > 1;
    snprintf(out_progress->stage, sizeof out_progress->stage, "%s",
             render->state == AMB_STATE_DONE ? "done" : "camera");
    snprintf(out_progress->detail, sizeof out_progress->detail, "poll %d", render->polls);
    return AMB_OK;
}
void amb_render_cancel(AmbRender *render) {
    render->state = AMB_STATE_CANCELLED;
}
AmbStatus amb_render_wait(AmbRender *render, double timeout, int32_t *out_ended) {
    if (timeout > 0)
        usleep((useconds_t)(timeout * 1e6));
    *out_ended = 1;
    if (render->state == AMB_STATE_CANCELLED)
        return fail(AMB_CANCELLED, "amb_render_wait", "cancelled");
    if (++render->polls >= 4 && !is_endless(render))
        render->state = AMB_STATE_DONE;
    *out_ended = render->state == AMB_STATE_DONE;
    return AMB_OK;
}

static uint32_t channels_of(const char *name) {
    if (!strcmp(name, "Combined"))
        return 4;
    if (strstr(name, " Scattering") != NULL || !strcmp(name, "Surface") ||
        strstr(name, "Denoising ") == name)
        return 3;
    return !strcmp(name, "Depth") || !strcmp(name, "Frequency") || !strcmp(name, "Error");
}
AmbStatus amb_render_pass_channels(AmbRender *render, const char *name, uint32_t *out_channels) {
    (void)render;
    *out_channels = channels_of(name);
    if (!*out_channels)
        return fail(AMB_INVALID_ARGUMENT, "amb_render_pass_channels", "no such pass");
    return AMB_OK;
}
/* Every channel: x + 1000 y of the full image, so that a test sees where each pixel went. */
AmbStatus amb_render_read_pass(AmbRender *render, const char *name, float *out_pixels,
                               uint64_t count) {
    const AmbRenderParams *p = &render->params;
    const uint32_t width = p->crop_width ? p->crop_width : p->width;
    const uint32_t height = p->crop_width ? p->crop_height : p->height;
    const uint32_t channels = channels_of(name);
    if (count != (uint64_t)width * height * channels)
        return fail(AMB_INVALID_ARGUMENT, "amb_render_read_pass", "wrong size");
    for (uint64_t i = 0; i < count; ++i) {
        const uint64_t x = i / channels % width, y = i / channels / width;
        out_pixels[i] = (float)(p->crop_x + x + 1000 * (p->crop_y + y));
    }
    return AMB_OK;
}
AmbStatus amb_render_report(AmbRender *render, char *buffer, uint64_t size, uint64_t *out_size) {
    char text[1024];
    const int length = snprintf(
        text, sizeof text,
        "{\"version\": \"%s\", \"estimator\": \"POINTS_COVARIANCE\", \"samples\": %u, "
        "\"width\": %u, \"height\": %u, \"threads\": 1, "
        "\"effects\": [{\"name\": \"single scattering\", \"simulated\": true, \"reason\": \"\"}, "
        "{\"name\": \"background\", \"simulated\": false, \"reason\": \"the world is black\"}], "
        "\"stages\": [{\"name\": \"camera\", \"cpu_s\": 1.5, \"wall_s\": 0.75}], "
        "\"memory\": {\"scene_bytes\": 1048576, \"peak_rss_bytes\": 2097152}, "
        "\"light\": {\"rays\": 10, \"volume_samples\": 20}, "
        "\"warnings\": [{\"text\": \"mesh \\\"A\\\" is open\", \"count\": 2}], "
        "\"nonfinite\": 0}",
        AMB_VERSION_STRING, render->params.samples, render->params.width, render->params.height);
    *out_size = (uint64_t)length + 1;
    if (buffer && size >= *out_size)
        memcpy(buffer, text, *out_size);
    return AMB_OK;
}
AmbStatus amb_plan_explain(AmbScene *scene, const AmbRenderParams *params, char *buffer,
                           uint64_t size, uint64_t *out_size) {
    char text[512];
    if (!scene->is_committed)
        return fail(AMB_INVALID_STATE, "amb_plan_explain", "the scene is not committed");
    const int length = snprintf(
        text, sizeof text,
        "{\"plan\": {\"automatic\": %s}, \"estimator\": \"TUBES\", \"effects\": "
        "[{\"name\": \"single scattering\", \"simulated\": true, \"reason\": \"seed %u\"}]}",
        params->effects_are_auto ? "true" : "false", params->seed);
    *out_size = (uint64_t)length + 1;
    if (buffer && size >= *out_size)
        memcpy(buffer, text, *out_size);
    return AMB_OK;
}
AmbStatus amb_render_write_exr(AmbRender *render, const char *path, const char *layer) {
    (void)render;
    FILE *file = fopen(path, "w");
    if (!file)
        return fail(AMB_IO, "amb_render_write_exr", "the file cannot be written");
    fputs(layer, file);
    fclose(file);
    return AMB_OK;
}
void amb_render_destroy(AmbRender *render) {
    if (!render)
        return;
    --renders_alive;
    free(render);
}
