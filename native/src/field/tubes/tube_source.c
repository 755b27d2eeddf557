/* SPDX-License-Identifier: GPL-3.0-or-later
 * Cutting lamps into cells. */
#include "field/tubes/tube_source.h"

#include "amberlight/amberlight.h"
#include "base/memory.h"

/* A cell is this large at most, rad, seen from the nearest point of the object: over so much the
 * refracted map is taken to be linear in the source. */
static const float CELL_ANGLE_MAX = 0.075f;
/* Half of the side of a square with the area of a disc of radius 1. */
static const float DISC_HALF = 0.886226925f;

static bool is_extended(const SceneLight *light) {
    return light->kind == AMB_LIGHT_AREA || light->radius > 0.0f || light->angle > 0.0f;
}

/* Half axes of the whole lamp, as of an ellipse or a rectangle. */
static void half_axes(const SceneLight *light, float out[2]) {
    if (light->kind == AMB_LIGHT_AREA) {
        out[0] = light->size[0];
        out[1] = light->size[1];
    } else {
        out[0] = out[1] = light->kind == AMB_LIGHT_SUN ? light->angle : light->radius;
    }
}

uint32_t tube_source_cells(const SceneLight *light, const SceneObject *object) {
    if (!(rgb_max(light->color) > 0.0f) || light->kind == LIGHT_MESH)
        return 0;
    if (!is_extended(light))
        return 1;
    float half[2];
    half_axes(light, half);
    float angle = 2.0f * fmaxf(half[0], half[1]);
    if (light->kind != AMB_LIGHT_SUN) {
        const float distance =
            vec3_length(vec3_sub(light->position, object->center)) - object->radius;
        angle = distance > 0.0f ? angle / distance : INFINITY;
    }
    const float cells = ceilf(angle / CELL_ANGLE_MAX);
    return cells < TUBE_CELLS_MAX + 1.0f ? (uint32_t)fmaxf(cells, 1.0f) : TUBE_CELLS_MAX + 1;
}

/* From the square [-1, 1]^2 to the disc of radius 1: equal areas stay equal, and squares about
 * square ([Shirley97]). */
static Sample2 disc_of_square(Sample2 s) {
    const bool is_wide = fabsf(s.u) > fabsf(s.v);
    const float r = is_wide ? s.u : s.v;
    if (r == 0.0f)
        return (Sample2){0.0f, 0.0f};
    const float angle = 0.25f * AMB_PI * (is_wide ? s.v / s.u : s.u / s.v);
    return is_wide ? (Sample2){r * cosf(angle), r * sinf(angle)}
                   : (Sample2){r * sinf(angle), r * cosf(angle)};
}

static void make_area_cell(SceneLight *cell, Sample2 s, const float half[2]) {
    cell->position = vec3_madd(vec3_madd(cell->position, s.u * cell->size[0], cell->x),
                               s.v * cell->size[1], cell->y);
    cell->size[0] = half[0];
    cell->size[1] = half[1];
    cell->area_shape = AMB_AREA_RECTANGLE;
}

static void make_sun_cell(SceneLight *cell, Sample2 s, float share) {
    /* Every direction of the disc stands for the same irradiance. */
    const LightArrival arrival = light_arrival(cell, cell->position, (Sample2){0.5f, 0.5f});
    cell->color = rgb_scale(arrival.irradiance, share * share);
    /* Equal parts of the disc are equal parts of 1 - cos. */
    const float r2 = s.u * s.u + s.v * s.v, sine = sinf(0.5f * cell->angle);
    const float versine = 2.0f * sine * sine * r2;
    const float scale = r2 > 0.0f ? sqrtf(versine * (2.0f - versine) / r2) : 0.0f;
    cell->direction = vec3_normalize(frame_to_world(
        cell->x, cell->y, cell->direction, vec3(scale * s.u, scale * s.v, 1.0f - versine)));
    cell->angle = 0.0f;
}

/* The disc that faces the object's middle instead of each point of it: the difference moves the
 * cell along the light, and by opposite amounts for opposite cells. */
static void make_disc_cell(SceneLight *cell, Sample2 s, float share, Vec3 target, Vec3 *out_x,
                           Vec3 *out_y) {
    const Vec3 axis = vec3_normalize(vec3_sub(target, cell->position));
    vec3_frame(axis, out_x, out_y);
    cell->position = vec3_madd(vec3_madd(cell->position, s.u * cell->radius, *out_x),
                               s.v * cell->radius, *out_y);
    const float cosine = vec3_dot(vec3_normalize(vec3_sub(target, cell->position)), axis);
    cell->color = rgb_scale(cell->color, share * share * cosine);
    cell->radius = 0.0f;
}

/* As if the object were its bounding sphere, and all of it saw the lamp as its middle does. */
static float flux_towards(const SceneLight *light, const SceneObject *object) {
    if (light->kind != AMB_LIGHT_SUN &&
        !(vec3_length(vec3_sub(object->center, light->position)) > 0.0f))
        return 0.0f;
    const float largest = rgb_max(light->color);
    if (!(largest > 0.0f))
        return 0.0f;
    const LightArrival arrival = light_arrival(light, object->center, (Sample2){0.5f, 0.5f});
    const float cross_section = AMB_PI * object->radius * object->radius;
    const float sphere = 4.0f * AMB_PI * arrival.distance * arrival.distance;
    const float flux = rgb_max(arrival.irradiance) / largest * fminf(cross_section, sphere);
    return isfinite(flux) ? flux : 0.0f;
}

/* The cell in the middle of which s is, in [-1, 1]^2, one of n x n. */
static TubeSource make_cell(const SceneLight *light, const SceneObject *object, Sample2 s,
                            uint32_t n) {
    TubeSource source = {.light = *light};
    if (!is_extended(light))
        return source;
    const float share = 1.0f / (float)n;
    float half[2];
    half_axes(light, half);
    const bool is_box = light->kind == AMB_LIGHT_AREA && light->area_shape == AMB_AREA_RECTANGLE;
    for (int k = 0; k < 2; ++k)
        half[k] *= is_box ? share : DISC_HALF * share;
    if (!is_box)
        s = disc_of_square(s);
    Vec3 x = light->x, y = light->y;
    if (light->kind == AMB_LIGHT_AREA)
        make_area_cell(&source.light, s, half);
    else if (light->kind == AMB_LIGHT_SUN)
        make_sun_cell(&source.light, s, share);
    else
        make_disc_cell(&source.light, s, share, object->center, &x, &y);
    source.extent[0] = vec3_scale(x, half[0]);
    source.extent[1] = vec3_scale(y, half[1]);
    return source;
}

AmbStatus tube_sources_create(const AmbScene *scene, uint32_t object, TubeSource **out_sources,
                              uint32_t *out_count) {
    const SceneObject *body = &scene->objects[object];
    uint64_t room = 0;
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const uint64_t n = tube_source_cells(&scene->lights[l], body);
        room += n < TUBE_CELLS_MAX ? n * n : TUBE_CELLS_MAX * TUBE_CELLS_MAX;
    }
    TubeSource *sources = memory_alloc_array(room > 0 ? room : 1, sizeof *sources);
    if (sources == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the cells of lamps");
    uint32_t count = 0;
    for (uint32_t l = 0; l < scene->light_count; ++l) {
        const SceneLight *light = &scene->lights[l];
        uint32_t n = tube_source_cells(light, body);
        n = n < TUBE_CELLS_MAX ? n : TUBE_CELLS_MAX;
        for (uint32_t i = 0; i < n * n; ++i) {
            const uint32_t column = i % n, row = i / n;
            const Sample2 s = {(float)(2 * column + 1) / (float)n - 1.0f,
                               (float)(2 * row + 1) / (float)n - 1.0f};
            sources[count] = make_cell(light, body, s, n);
            sources[count].flux = flux_towards(&sources[count].light, body);
            ++count;
        }
    }
    *out_sources = sources;
    *out_count = count;
    return AMB_OK;
}
