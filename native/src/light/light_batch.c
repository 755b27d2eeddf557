/* SPDX-License-Identifier: GPL-3.0-or-later
 * Rays of one light towards one object. */
#include "light/light_batch.h"

#include <math.h>

bool light_batch_aim(const AmbScene *scene, const SceneLight *light, uint32_t object, Rng rng,
                     LightBatch *out_batch) {
    const SceneObject *shape = &scene->objects[object];
    MediumStack start = {0};
    if (!shape->is_boundary)
        return false;
    /* A mesh may begin in one medium and end in another: each ray asks where it is. */
    if (light != NULL && light->kind != AMB_LIGHT_SUN && light->kind != LIGHT_MESH)
        start = scene_media_at(scene, light->position);
    /* Light that starts inside begins with the outermost object around it. */
    if (start.count > 0 && start.objects[0] != object)
        return false;
    *out_batch = (LightBatch){.emission = {.light = light,
                                           .target = shape->center,
                                           /* A little larger: rounding must not cut the rim. */
                                           .target_radius = shape->radius * 1.0001f,
                                           .distance = 2.1f * scene->radius,
                                           .count = 1,
                                           .shift_u = rng_float(rng, 0),
                                           .shift_v = rng_float(rng, 1)},
                              .start = start,
                              .target = object,
                              .shift = rng_float(rng, 2)};
    if (start.count > 0)
        out_batch->emission.target_radius = INFINITY; /* every direction */
    return true;
}

bool light_batch_start(const AmbScene *scene, const LightBatch *batch, Vec3 o,
                       MediumStack *out_stack) {
    const SceneLight *light = batch->emission.light;
    *out_stack = batch->start;
    if (light == NULL || light->kind != LIGHT_MESH || !light->mesh->may_be_inside)
        return true;
    *out_stack = scene_media_at(scene, o);
    return out_stack->count == 0 || out_stack->objects[0] == batch->target;
}

void light_batches_share(LightBatch *batches, uint64_t batch_count, uint64_t ray_count) {
    double total = 0.0;
    for (uint64_t b = 0; b < batch_count; ++b)
        total += batches[b].power;
    double running = 0.0;
    uint64_t first = 0;
    for (uint64_t b = 0; b < batch_count; ++b) {
        LightBatch *batch = &batches[b];
        const double even = 1.0 / (double)batch_count;
        running += total > 0.0 && isfinite(total) ? 0.5 * batch->power / total + 0.5 * even : even;
        uint64_t end = (uint64_t)((double)ray_count * running);
        if (b + 1 == batch_count)
            end = ray_count;
        batch->first = first;
        batch->emission.count = end > first ? end - first : 0;
        first += batch->emission.count;
    }
}
