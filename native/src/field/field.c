/* SPDX-License-Identifier: GPL-3.0-or-later
 * Chooses the family of estimators. */
#include "field/field.h"

#include <stdatomic.h>
#include <string.h>

#include "base/memory.h"
#include "field/points/points.h"
#include "field/specular/specular.h"
#include "field/tubes/tubes.h"

struct Field {
    uint32_t object_count;
    atomic_uint_least64_t *nonfinite; /* by object */
    PointCloud *clouds;               /* by object and part; of the light pass's beams, or NULL */
    uint32_t part_count;
    TubeField *tubes; /* by object; TUBES, else NULL */
    TubeCount tube_count;
    SpecularField *specular; /* by object; SPECULAR, else NULL */
    SpecularCount specular_count;
};

enum { BEAM_SAMPLES_MAX = 8 };

static bool is_target(const FieldParams *params, uint32_t object) {
    return params->targets == NULL || params->targets[object];
}

static AmbStatus create_points(const AmbScene *scene, const LightField *light,
                               const FieldParams *params, Job *job, Field *field) {
    field->part_count = params->part_count > 0 ? params->part_count : 1;
    field->clouds =
        memory_zero_array((uint64_t)scene->object_count * field->part_count, sizeof(PointCloud));
    if (field->clouds == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    double total_length = 0.0, target = (double)params->sample_target;
    uint64_t beam_count = 0;
    for (uint32_t o = 0; o < light->object_count; ++o) {
        beam_count += light->objects[o].count;
        for (uint64_t i = 0; i < light->objects[o].count; ++i)
            total_length += (double)light->objects[o].beams[i].length;
    }
    if (beam_count == 0)
        return AMB_OK;
    /* Of the light that tubes leave to points there may be next to nothing. */
    if (field->tubes != NULL)
        target = fmin(target, (double)(BEAM_SAMPLES_MAX * beam_count));
    PointParams point_params = {.follows_covariance =
                                    params->estimator != AMB_ESTIMATOR_POINTS_FIXED,
                                .kernel_size = params->kernel_size,
                                .spacing = (float)(total_length / target),
                                .part_count = field->part_count};
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (light->objects[o].count > 0 && is_target(params, o)) {
            const Medium *medium = &scene->materials[scene->objects[o].inside].medium;
            for (uint32_t k = 0; k < field->part_count; ++k) {
                point_params.part = k;
                AMB_TRY(points_build(&light->objects[o], medium, &point_params, job,
                                     &field->clouds[o * field->part_count + k]));
            }
        }
    return AMB_OK;
}

static AmbStatus create_tubes(const AmbScene *scene, const FieldParams *params, Job *job,
                              Field *field) {
    field->tubes = memory_zero_array(scene->object_count, sizeof(TubeField));
    if (field->tubes == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    const TubeParams tube_params = {.refinement = params->tube_refinement,
                                    .bounces = params->light_bounces,
                                    .adjoint_normals = params->adjoint_normals};
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary && is_target(params, o) &&
            medium_scatters(&scene->materials[scene->objects[o].inside].medium))
            AMB_TRY(tubes_build(scene, o, &tube_params, job, &field->tube_count, &field->tubes[o]));
    return AMB_OK;
}

static AmbStatus create_specular(const AmbScene *scene, const FieldParams *params, Job *job,
                                 Field *field) {
    field->specular = memory_zero_array(scene->object_count, sizeof(SpecularField));
    if (field->specular == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    for (uint32_t o = 0; o < scene->object_count; ++o)
        if (scene->objects[o].is_boundary && is_target(params, o) &&
            medium_scatters(&scene->materials[scene->objects[o].inside].medium))
            AMB_TRY(specular_build(scene, o, params->adjoint_normals, job, &field->specular_count,
                                   &field->specular[o]));
    return AMB_OK;
}

static AmbStatus create_by_estimator(const AmbScene *scene, const LightField *light,
                                     const FieldParams *params, Job *job, Field *field) {
    if (params->estimator == AMB_ESTIMATOR_SPECULAR)
        return create_specular(scene, params, job, field);
    if (params->estimator == AMB_ESTIMATOR_TUBES)
        AMB_TRY(create_tubes(scene, params, job, field));
    const bool has_beams = light != NULL && light->object_count > 0;
    return has_beams ? create_points(scene, light, params, job, field) : AMB_OK;
}

AmbStatus field_create(const AmbScene *scene, const LightField *light, const FieldParams *params,
                       Job *job, Field **out_field) {
    Field *field = memory_zero_array(1, sizeof *field);
    if (field == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    field->nonfinite = memory_zero_array(scene->object_count, sizeof *field->nonfinite);
    if (field->nonfinite == NULL) {
        memory_free(field);
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    }
    field->object_count = scene->object_count;
    const AmbStatus status = create_by_estimator(scene, light, params, job, field);
    if (status != AMB_OK) {
        field_destroy(field);
        return status;
    }
    *out_field = field;
    return AMB_OK;
}

void field_destroy(Field *field) {
    if (field == NULL)
        return;
    for (uint32_t o = 0; o < field->object_count; ++o) {
        for (uint32_t k = 0; field->clouds != NULL && k < field->part_count; ++k)
            points_clear(&field->clouds[o * field->part_count + k]);
        if (field->tubes != NULL)
            tubes_clear(&field->tubes[o]);
        if (field->specular != NULL)
            specular_clear(&field->specular[o]);
    }
    memory_free(field->nonfinite);
    memory_free(field->clouds);
    memory_free(field->tubes);
    memory_free(field->specular);
    memory_free(field);
}

static FieldRadiance gather_points(const Field *field, const FieldSegment *segment) {
    const PointCloud *clouds = &field->clouds[segment->object * field->part_count];
    const bool is_part = segment->part > 0 && field->part_count > 1;
    const float whole = is_part ? (float)field->part_count : 1.0f;
    FieldRadiance sum = {.radiance = {0, 0, 0}};
    PointCount met = {.all = 0};
    const double begin = segment->times != NULL ? clock_thread_cpu() : 0.0;
    for (uint32_t k = 0; k < field->part_count; ++k) {
        /* Beside tubes points may have nothing but what these leave of reflections. */
        const bool is_late =
            field->tubes != NULL && clouds[k].count.reflected == clouds[k].count.all;
        const float scale = is_late ? whole * (1.0f + segment->reflected_excess) : whole;
        if (clouds[k].count.all == 0 || (is_part && segment->part != k + 1) || !(scale > 0.0f))
            continue;
        const FieldRadiance part =
            points_gather(&clouds[k], segment, segment->times != NULL ? &met : NULL);
        sum = field_radiance_add(sum, field_radiance_scale(part, scale));
    }
    if (met.all > 0) {
        const double each = (clock_thread_cpu() - begin) / (double)met.all;
        segment->times->passed += each * (double)met.passed;
        segment->times->reflected += each * (double)met.reflected;
    }
    return sum;
}

/* From the tubes of one object after the other. */
static void gather_tubes(const Field *field, const FieldSegment segments[], uint32_t count,
                         uint64_t with_frequency, FieldRadiance out[]) {
    TubeRay rays[FIELD_GATHER_MAX];
    for (uint32_t begin = 0; begin < count;) {
        const uint32_t o = segments[begin].object;
        uint32_t end = begin;
        /* What is timed goes alone. */
        for (; end < count && segments[end].object == o &&
               (end == begin || (segments[end].times == NULL && segments[begin].times == NULL));
             ++end)
            rays[end - begin] = (TubeRay){segments[end].o,
                                          segments[end].d,
                                          segments[end].length,
                                          (with_frequency >> end & 1) != 0,
                                          1.0f + segments[end].reflected_excess,
                                          segments[end].straight};
        if (field->tubes[o].tube_count > 0)
            tubes_gather(&field->tubes[o], rays, end - begin, segments[begin].times, out + begin);
        begin = end;
    }
}

static FieldRadiance finite(const Field *field, const FieldSegment *segment, FieldRadiance sum) {
    if (rgb_is_finite(sum.radiance) && rgb_is_finite(sum.straight_more) &&
        isfinite(sum.frequency) && isfinite(sum.contribution))
        return sum;
    atomic_fetch_add(&field->nonfinite[segment->object], 1);
    return (FieldRadiance){.radiance = {0, 0, 0}};
}

void field_gather_many(const Field *field, const FieldSegment segments[], uint32_t count,
                       uint64_t with_frequency, FieldRadiance out[]) {
    memset(out, 0, count * sizeof *out);
    if (field->tubes != NULL)
        gather_tubes(field, segments, count, with_frequency, out);
    for (uint32_t i = 0; i < count; ++i) {
        const FieldSegment *segment = &segments[i];
        const uint32_t o = segment->object;
        if (field->specular != NULL && field->specular[o].tree.cell_count > 0)
            out[i] = specular_gather(&field->specular[o], segment);
        if (field->clouds != NULL)
            out[i] = field_radiance_add(out[i], gather_points(field, segment));
        out[i] = finite(field, segment, out[i]);
    }
}

FieldRadiance field_gather(const Field *field, const FieldSegment *segment) {
    FieldRadiance out;
    field_gather_many(field, segment, 1, 0, &out);
    return out;
}

uint64_t field_nonfinite(const Field *field, uint32_t object) {
    return atomic_load(&field->nonfinite[object]);
}

FieldSize field_size(const Field *field) {
    FieldSize size = {.bytes = 0};
    for (uint32_t o = 0; o < field->object_count; ++o) {
        if (field->tubes != NULL) {
            size.tubes += field->tubes[o].tube_count;
            size.bytes += tubes_bytes(&field->tubes[o]);
            size.reflected_bytes += tubes_reflected_bytes(&field->tubes[o]);
        }
        if (field->specular != NULL) {
            size.lit_triangles += field->specular[o].tree.cell_count;
            size.bytes += specular_bytes(&field->specular[o]);
        }
        for (uint32_t k = 0; field->clouds != NULL && k < field->part_count; ++k) {
            const PointCloud *cloud = &field->clouds[o * field->part_count + k];
            const uint64_t bytes = points_bytes(cloud);
            const double each = cloud->count.all > 0 ? (double)bytes / (double)cloud->count.all : 0;
            size.volume_samples += cloud->count.all;
            size.point_bytes += bytes;
            size.passed_bytes += (uint64_t)(each * (double)cloud->count.passed);
            size.reflected_bytes += (uint64_t)(each * (double)cloud->count.reflected);
        }
    }
    size.bytes += size.point_bytes;
    return size;
}

void field_tally(const Field *field, LightTally *tally, SceneLeaks *leaks) {
    const LightTally *own = field->tubes != NULL      ? &field->tube_count.tally
                            : field->specular != NULL ? &field->specular_count.tally
                                                      : NULL;
    if (own == NULL)
        return;
    for (int k = 0; k < 3; ++k) {
        tally->incident[k] = own->incident[k];
        tally->entered[k] = own->entered[k];
        tally->interacting[k] += own->interacting[k];
    }
    const SceneLeaks *more =
        field->tubes != NULL ? &field->tube_count.leaks : &field->specular_count.leaks;
    scene_leaks_add(leaks, more->count, more->object);
}
