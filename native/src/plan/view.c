/* SPDX-License-Identifier: GPL-3.0-or-later
 * What the camera sees. */
#include "plan/view.h"

#include <string.h>

#include "base/memory.h"
#include "base/rng.h"

/* Vertices of an object that no ray met that are looked for in the picture. */
enum { SEARCH_VERTICES = 64 };

typedef struct Survey {
    const AmbScene *scene;
    const ViewParams *params;
    uint32_t cells_x, cells_y;
    bool has_corners; /* cells are pixels */
    ViewPixel *found; /* by cell; object UINT32_MAX: none */
    atomic_bool has_opaque;
} Survey;

/* The object that the ray through a place in a pixel meets first, UINT32_MAX if it is none that is
 * translucent. A camera inside of an object sees everything through that one. */
static uint32_t object_at(const AmbScene *scene, const ViewParams *params, uint32_t x, uint32_t y,
                          Sample2 place, bool *out_is_opaque) {
    const CameraRay ray =
        camera_ray(&scene->camera, ((float)x + place.u) / (float)params->full_width,
                   ((float)y + place.v) / (float)params->full_height, (Sample2){0.5f, 0.5f});
    Hit hit;
    *out_is_opaque = false;
    if (scene_intersect(scene, ray.o, ray.d, ray.t_max, &hit)) {
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (surface.material->surface == AMB_SURFACE_DIELECTRIC)
            return surface.object;
        *out_is_opaque = true;
    }
    if (!params->may_start_inside)
        return UINT32_MAX;
    const MediumStack stack = scene_media_at(scene, ray.o);
    return stack.count > 0 ? medium_stack_top(&stack) : UINT32_MAX;
}

/* Where a pixel is looked at: in its middle, and beside its corners. */
static const Sample2 MIDDLE = {0.5f, 0.5f};
static const Sample2 CORNERS[] = {{0.05f, 0.05f}, {0.95f, 0.05f}, {0.05f, 0.95f}, {0.95f, 0.95f}};

/* The object of a pixel; with its corners, of one that shows only the edge of an object, too. Such
 * pixels count among those that show it (film.h), and are many in a small picture. */
static uint32_t object_of(const Survey *survey, uint32_t x, uint32_t y, bool *out_is_opaque) {
    uint32_t object = object_at(survey->scene, survey->params, x, y, MIDDLE, out_is_opaque);
    for (uint32_t i = 0; object == UINT32_MAX && survey->has_corners && i < 4; ++i) {
        bool is_opaque;
        object = object_at(survey->scene, survey->params, x, y, CORNERS[i], &is_opaque);
        *out_is_opaque = *out_is_opaque || is_opaque;
    }
    return object;
}

static AmbStatus look(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)thread;
    Survey *survey = user;
    const ViewParams *params = survey->params;
    for (uint64_t i = begin; i < end; ++i) {
        const uint32_t cx = (uint32_t)(i % survey->cells_x), cy = (uint32_t)(i / survey->cells_x);
        const Rng rng = rng_create(params->seed, RNG_STAGE_PLAN, i);
        const float u = ((float)cx + rng_float(rng, 0)) / (float)survey->cells_x;
        const float v = ((float)cy + rng_float(rng, 1)) / (float)survey->cells_y;
        const uint32_t x = (uint32_t)(u * (float)params->width);
        const uint32_t y = (uint32_t)(v * (float)params->height);
        ViewPixel *pixel = &survey->found[i];
        pixel->x = params->x + (x < params->width ? x : params->width - 1);
        pixel->y = params->y + (y < params->height ? y : params->height - 1);
        bool is_opaque;
        pixel->object = object_of(survey, pixel->x, pixel->y, &is_opaque);
        if (is_opaque)
            atomic_store(&survey->has_opaque, true);
    }
    return AMB_OK;
}

/* The pixel that shows a point; false if none of the rectangle does. */
static bool project(const AmbScene *scene, const ViewParams *params, Vec3 p, uint32_t *out_x,
                    uint32_t *out_y) {
    const SceneCamera *camera = &scene->camera;
    const Vec3 v = vec3_sub(p, camera->position);
    float x = vec3_dot(v, camera->right), y = vec3_dot(v, camera->up);
    const float z = vec3_dot(v, camera->forward);
    if (camera->kind == AMB_CAMERA_PERSPECTIVE) {
        if (!(z > 0.0f))
            return false;
        x /= z;
        y /= z;
    }
    const float *w = camera->window;
    x = (x - w[0]) / (w[1] - w[0]) * (float)params->full_width;
    y = (y - w[2]) / (w[3] - w[2]) * (float)params->full_height;
    if (!(x >= (float)params->x && x < (float)(params->x + params->width) &&
          y >= (float)params->y && y < (float)(params->y + params->height)))
        return false;
    *out_x = (uint32_t)x;
    *out_y = (uint32_t)y;
    return true;
}

/* Looks for an object that the rays have missed: it may be smaller than their distance. */
static bool search(const AmbScene *scene, const ViewParams *params, uint32_t o,
                   ViewPixel *out_pixel) {
    const SceneObject *object = &scene->objects[o];
    const SceneMesh *mesh = &scene->meshes[object->mesh];
    if (!object->is_boundary || mesh->triangle_count == 0)
        return false;
    for (uint64_t i = 0; i < SEARCH_VERTICES; ++i) {
        const uint64_t triangle = i * mesh->triangle_count / SEARCH_VERTICES;
        bool is_opaque;
        if (project(scene, params, object->positions[mesh->triangles[3 * triangle]], &out_pixel->x,
                    &out_pixel->y) &&
            object_at(scene, params, out_pixel->x, out_pixel->y, MIDDLE, &is_opaque) == o) {
            out_pixel->object = o;
            return true;
        }
    }
    return false;
}

/* Groups what was found by object, and gives those that were searched for a pixel's area. */
static AmbStatus group(const Survey *survey, View *view) {
    const AmbScene *scene = survey->scene;
    const uint64_t cells = (uint64_t)survey->cells_x * survey->cells_y;
    view->object_count = scene->object_count;
    view->firsts = memory_zero_array((uint64_t)scene->object_count + 1, sizeof *view->firsts);
    view->areas = memory_zero_array(scene->object_count, sizeof *view->areas);
    view->pixels = memory_alloc_array(cells + scene->object_count, sizeof *view->pixels);
    if (view->firsts == NULL || view->areas == NULL || view->pixels == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    for (uint64_t i = 0; i < cells; ++i)
        if (survey->found[i].object != UINT32_MAX)
            view->areas[survey->found[i].object] += 1.0;
    const double pixel = (double)cells / ((double)survey->params->width * survey->params->height);
    double total = 0.0;
    for (uint32_t o = 0; o < scene->object_count; ++o) {
        view->firsts[o] = view->count;
        if (view->areas[o] > 0.0) {
            for (uint64_t i = 0; i < cells; ++i)
                if (survey->found[i].object == o)
                    view->pixels[view->count++] = survey->found[i];
        } else if (search(scene, survey->params, o, &view->pixels[view->count])) {
            view->areas[o] = pixel;
            ++view->count;
        }
        view->visible_count += view->areas[o] > 0.0 ? 1 : 0;
        total += view->areas[o];
    }
    view->firsts[scene->object_count] = view->count;
    view->part = total / (double)cells;
    for (uint32_t o = 0; o < scene->object_count && total > 0.0; ++o)
        view->areas[o] /= total;
    return AMB_OK;
}

AmbStatus view_create(const AmbScene *scene, const ViewParams *params, Job *job, View *out_view) {
    memset(out_view, 0, sizeof *out_view);
    Survey survey = {.scene = scene, .params = params};
    atomic_init(&survey.has_opaque, false);
    const double pixels = (double)params->width * params->height;
    const double edge = fmax(1.0, sqrt(pixels / (double)params->ray_count));
    survey.cells_x = (uint32_t)fmax(1.0, floor((double)params->width / edge));
    survey.cells_y = (uint32_t)fmax(1.0, floor((double)params->height / edge));
    survey.has_corners = survey.cells_x == params->width && survey.cells_y == params->height;
    const uint64_t cells = (uint64_t)survey.cells_x * survey.cells_y;
    survey.found = memory_alloc_array(cells, sizeof *survey.found);
    if (survey.found == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory to plan the render");
    AmbStatus status = parallel_for(job, cells, 256, look, &survey);
    if (status == AMB_OK)
        status = group(&survey, out_view);
    out_view->has_opaque = atomic_load(&survey.has_opaque);
    memory_free(survey.found);
    if (status != AMB_OK)
        view_clear(out_view);
    return status;
}

void view_clear(View *view) {
    memory_free(view->pixels);
    memory_free(view->firsts);
    memory_free(view->areas);
    memory_free(view->reflections);
    memset(view, 0, sizeof *view);
}

/* Of the probes where reflections are known. */
static const double REFLECTION_PART = 0.25;

static uint64_t scale_index(double u, uint64_t count) {
    const uint64_t i = (uint64_t)(u * (double)count);
    return i < count ? i : count - 1;
}

static uint64_t pick_by_object(const View *view, double u, double v) {
    const double alike = 0.5 / (double)view->visible_count;
    double running = 0.0;
    uint64_t pixel = 0;
    for (uint32_t o = 0; o < view->object_count; ++o) {
        if (!(view->areas[o] > 0.0))
            continue;
        const uint64_t first = view->firsts[o];
        pixel = first + scale_index(v, view->firsts[o + 1] - first);
        running += 0.5 * view->areas[o] + alike;
        if (u < running)
            break;
    }
    return pixel;
}

/* The first pixel whose running sum is beyond u of all. */
static uint64_t pick_by_reflections(const View *view, double u) {
    const double wanted = u * view->reflections[view->count - 1];
    uint64_t low = 0, high = view->count - 1;
    while (low < high) {
        const uint64_t middle = (low + high) / 2;
        if (view->reflections[middle] > wanted)
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

ViewProbe view_probe(const View *view, uint64_t i) {
    const Sample2 at = sample_r2(i, 0.5f, 0.5f);
    const double *sums = view->reflections;
    const double whole = sums != NULL ? sums[view->count - 1] : 0.0;
    const double part = whole > 0.0 ? REFLECTION_PART : 0.0;
    const double u = (double)at.u, v = (double)at.v;
    const uint64_t pick = sums != NULL && u < part
                              ? pick_by_reflections(view, v)
                              : pick_by_object(view, (u - part) / (1.0 - part), v);
    ViewProbe probe = {.pixel = view->pixels[pick]};
    const uint32_t o = probe.pixel.object;
    const double count = (double)(view->firsts[o + 1] - view->firsts[o]);
    double density = (1.0 - part) * (0.5 * view->areas[o] + 0.5 / (double)view->visible_count);
    density /= count;
    if (sums != NULL && whole > 0.0)
        density += part * (sums[pick] - (pick > 0 ? sums[pick - 1] : 0.0)) / whole;
    probe.weight = view->areas[o] / (count * density);
    return probe;
}
