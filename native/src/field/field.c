/* SPDX-License-Identifier: GPL-3.0-or-later
 * Chooses the family of estimators. */
#include "field/field.h"

#include "base/memory.h"
#include "field/points/points.h"

struct Field {
    uint32_t object_count;
    PointCloud *clouds; /* by object; the point estimators */
};

AmbStatus field_create(const AmbScene *scene, const LightField *light, const FieldParams *params,
                       Job *job, Field **out_field) {
    Field *field = memory_zero_array(1, sizeof *field);
    if (field == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");
    field->clouds = memory_zero_array(scene->object_count, sizeof(PointCloud));
    field->object_count = scene->object_count;
    AmbStatus status = AMB_OK;
    if (field->clouds == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the light field");

    double total_length = 0.0;
    for (uint32_t o = 0; o < light->object_count; ++o)
        for (uint64_t i = 0; i < light->objects[o].count; ++i)
            total_length += (double)light->objects[o].beams[i].length;
    const PointParams point_params = {
        .follows_covariance = params->estimator == AMB_ESTIMATOR_POINTS_COVARIANCE,
        .kernel_size = params->kernel_size,
        .spacing = (float)(total_length / (double)params->sample_target)};

    for (uint32_t o = 0; o < scene->object_count && status == AMB_OK; ++o)
        if (light->objects[o].count > 0) {
            const Medium *medium = &scene->materials[scene->objects[o].inside].medium;
            status =
                points_build(&light->objects[o], medium, &point_params, job, &field->clouds[o]);
        }
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
    if (field->clouds != NULL)
        for (uint32_t o = 0; o < field->object_count; ++o)
            points_clear(&field->clouds[o]);
    memory_free(field->clouds);
    memory_free(field);
}

FieldRadiance field_gather(const Field *field, const FieldSegment *segment) {
    const PointCloud *cloud = &field->clouds[segment->object];
    if (cloud->sample_count == 0)
        return (FieldRadiance){.radiance = {0, 0, 0}};
    return points_gather(cloud, segment->o, segment->d, segment->length);
}

uint64_t field_bytes(const Field *field) {
    uint64_t bytes = 0;
    for (uint32_t o = 0; o < field->object_count; ++o)
        bytes += points_bytes(&field->clouds[o]);
    return bytes;
}

uint64_t field_sample_count(const Field *field) {
    uint64_t count = 0;
    for (uint32_t o = 0; o < field->object_count; ++o)
        count += field->clouds[o].sample_count;
    return count;
}
