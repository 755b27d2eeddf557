/* SPDX-License-Identifier: GPL-3.0-or-later
 * Public functions: rendering a scene and reading the result. */
#include <math.h>
#include <string.h>

#include "api/api_check.h"
#include "base/memory.h"
#include "render/render.h"
#include "render/report.h"

enum { IMAGE_SIZE_MAX = 1 << 16 };

void amb_render_params_init(AmbRenderParams *params) {
    if (params != NULL)
        *params = (AmbRenderParams){
            .struct_size = sizeof *params,
            .width = 512,
            .height = 512,
            .samples = 16,
            .estimator = AMB_ESTIMATOR_AUTO,
            .effects = AMB_EFFECT_SINGLE_SCATTERING | AMB_EFFECT_SURFACE_REFLECTION |
                       AMB_EFFECT_BACKGROUND | AMB_EFFECT_TRANSMITTED_LIGHT | AMB_EFFECT_CAUSTICS |
                       AMB_EFFECT_INTERREFLECTION | AMB_EFFECT_LAMP_IMAGES,
            .light_samples = 1000000,
            .kernel_size = 4.0f,
            .adjoint_normals = 1};
}

static AmbStatus check_params(const AmbRenderParams *p) {
    if (p->width == 0 || p->height == 0 || p->width > IMAGE_SIZE_MAX || p->height > IMAGE_SIZE_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "the image is %u x %u, must be 1 .. %d", p->width,
                           p->height, IMAGE_SIZE_MAX);
    if (p->crop_width > 0 &&
        (p->crop_height == 0 || p->crop_width > p->width || p->crop_height > p->height ||
         p->crop_x > p->width - p->crop_width || p->crop_y > p->height - p->crop_height))
        return status_fail(AMB_INVALID_ARGUMENT, "the crop is not inside the image");
    if (p->samples == 0 || p->light_samples == 0)
        return status_fail(AMB_INVALID_ARGUMENT, "samples and light_samples must be at least 1");
    if (p->light_samples > 1ull << 31)
        return status_fail(AMB_INVALID_ARGUMENT, "light_samples must be at most 2^31");
    if (p->tube_refinement < TUBE_REFINEMENT_MIN || p->tube_refinement > TUBE_REFINEMENT_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "tube_refinement is %d, must be %d .. %d",
                           p->tube_refinement, TUBE_REFINEMENT_MIN, TUBE_REFINEMENT_MAX);
    if (p->scatter_estimator > AMB_SCATTER_TREE_CUT)
        return status_fail(AMB_INVALID_ARGUMENT, "scatter_estimator is %u, must be 0 .. %d",
                           p->scatter_estimator, AMB_SCATTER_TREE_CUT);
    AMB_TRY(check_range(&p->accuracy, 1, 0.0f, 1.0f, "accuracy", "params"));
    return check_range(&p->kernel_size, 1, 1e-6f, 1e6f, "kernel_size", "params");
}

AmbStatus amb_render_start(AmbScene *scene, const AmbRenderParams *params, AmbRender **out_render) {
    status_enter("amb_render_start");
    AMB_TRY(check_pointer(out_render, "out_render"));
    *out_render = NULL;
    AMB_TRY(check_pointer(scene, "scene"));
    if (!scene->is_committed)
        return status_fail(AMB_INVALID_STATE, "the scene is not committed");
    AmbRenderParams given;
    amb_render_params_init(&given);
    AMB_TRY(check_struct(params, sizeof given, "params", &given));
    AMB_TRY(check_params(&given));
    return render_start(scene, &given, out_render);
}

AmbStatus amb_plan_explain(AmbScene *scene, const AmbRenderParams *params, char *buffer,
                           uint64_t size, uint64_t *out_size) {
    status_enter("amb_plan_explain");
    AMB_TRY(check_pointer(out_size, "out_size"));
    *out_size = 0;
    AMB_TRY(check_pointer(scene, "scene"));
    if (!scene->is_committed)
        return status_fail(AMB_INVALID_STATE, "the scene is not committed");
    AmbRenderParams given;
    amb_render_params_init(&given);
    AMB_TRY(check_struct(params, sizeof given, "params", &given));
    AMB_TRY(check_params(&given));
    atomic_fetch_add(&scene->render_count, 1);
    const AmbStatus status = render_explain(scene, &given, buffer, size, out_size);
    atomic_fetch_sub(&scene->render_count, 1);
    return status;
}

void amb_progress_init(AmbProgress *progress) {
    if (progress != NULL)
        *progress = (AmbProgress){.struct_size = sizeof *progress};
}

AmbStatus amb_render_progress(AmbRender *render, AmbProgress *out_progress) {
    status_enter("amb_render_progress");
    AmbProgress progress;
    amb_progress_init(&progress);
    AMB_TRY(check_struct(out_progress, sizeof progress, "progress", &progress));
    /* An older caller's struct ends here. */
    const uint32_t size = progress.struct_size;
    amb_progress_init(&progress);
    progress.struct_size = size;
    AmbStatus status = check_pointer(render, "render");
    if (status == AMB_OK)
        render_progress(render, &progress);
    memcpy(out_progress, &progress, size);
    return status;
}

void amb_render_cancel(AmbRender *render) {
    if (render != NULL)
        render_cancel(render);
}

AmbStatus amb_render_wait(AmbRender *render, double timeout, int32_t *out_ended) {
    status_enter("amb_render_wait");
    AMB_TRY(check_pointer(out_ended, "out_ended"));
    *out_ended = 0;
    AMB_TRY(check_pointer(render, "render"));
    if (isnan(timeout))
        return status_fail(AMB_INVALID_ARGUMENT, "timeout is not a number");
    bool is_ended = false;
    const AmbStatus status = render_wait(render, timeout, &is_ended);
    *out_ended = is_ended ? 1 : 0;
    return status;
}

static bool has_ended(AmbRender *render) {
    pthread_mutex_lock(&render->lock);
    const bool ended = render->state != AMB_STATE_RUNNING;
    pthread_mutex_unlock(&render->lock);
    return ended;
}

static AmbStatus check_ended(AmbRender *render) {
    AMB_TRY(check_pointer(render, "render"));
    if (!has_ended(render))
        return status_fail(AMB_INVALID_STATE, "the render is still running");
    return AMB_OK;
}

AmbStatus amb_render_pass_channels(AmbRender *render, const char *name, uint32_t *out_channels) {
    status_enter("amb_render_pass_channels");
    AMB_TRY(check_pointer(out_channels, "out_channels"));
    *out_channels = 0;
    AMB_TRY(check_pointer(render, "render"));
    AMB_TRY(check_pointer(name, "name"));
    *out_channels = film_pass_channels(name);
    if (*out_channels == 0)
        return status_fail(AMB_INVALID_ARGUMENT, "there is no pass \"%.60s\"", name);
    return AMB_OK;
}

AmbStatus amb_render_read_pass(AmbRender *render, const char *name, float *out_pixels,
                               uint64_t count) {
    status_enter("amb_render_read_pass");
    AMB_TRY(check_pointer(render, "render"));
    AMB_TRY(check_pointer(name, "name"));
    AMB_TRY(check_pointer(out_pixels, "out_pixels"));
    const uint32_t pass = film_pass_find(name);
    if (pass == UINT32_MAX)
        return status_fail(AMB_INVALID_ARGUMENT, "there is no pass \"%.60s\"", name);
    Film *film = &render->film;
    const uint64_t row = (uint64_t)film->width * FILM_PASSES[pass].channels;
    if (count != row * film->height)
        return status_fail(AMB_INVALID_ARGUMENT, "pass \"%s\" has %llu floats, the buffer has %llu",
                           name, (unsigned long long)(row * film->height),
                           (unsigned long long)count);
    pthread_mutex_lock(&render->lock);
    const bool has_samples = render->pixel_step > 0;
    pthread_mutex_unlock(&render->lock);
    if (!has_samples) {
        memset(out_pixels, 0, count * sizeof(float));
        return status_fail(AMB_INVALID_STATE, "no pixel has a sample yet");
    }
    for (uint32_t y = 0; y < film->height; ++y)
        film_read_row(film, pass, y, out_pixels + y * row);
    return AMB_OK;
}

AmbStatus amb_render_report(AmbRender *render, char *buffer, uint64_t size, uint64_t *out_size) {
    status_enter("amb_render_report");
    AMB_TRY(check_pointer(out_size, "out_size"));
    *out_size = 0;
    AMB_TRY(check_ended(render));
    report_write(render, buffer, size, out_size);
    return AMB_OK;
}

AmbStatus amb_render_write_exr(AmbRender *render, const char *path, const char *layer) {
    status_enter("amb_render_write_exr");
    AMB_TRY(check_ended(render));
    AMB_TRY(check_pointer(path, "path"));
    AMB_TRY(check_pointer(layer, "layer"));
    uint64_t size = 0;
    report_write(render, NULL, 0, &size);
    char *report = memory_alloc_array(size, 1);
    if (report == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the report");
    report_write(render, report, size, &size);
    const AmbStatus status =
        film_write_exr(&render->film, path, layer, "amberlight:report", report);
    memory_free(report);
    return status;
}

void amb_render_destroy(AmbRender *render) {
    if (render != NULL)
        render_destroy(render);
}
