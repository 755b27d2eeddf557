/* SPDX-License-Identifier: GPL-3.0-or-later
 * Rays or photons of one light towards one object, and how many of all each of these gets. */
#ifndef AMB_LIGHT_LIGHT_BATCH_H
#define AMB_LIGHT_LIGHT_BATCH_H

#include "base/rng.h"
#include "scene/boundary.h"

typedef struct LightBatch {
    LightEmission emission; /* light NULL: the surroundings */
    double power;           /* W, mean of the channels, about: divides rays among batches */
    MediumStack start;      /* media around the light */
    uint64_t first;         /* index of its first ray among all */
    uint32_t target;
    float shift; /* of the order of its rays, see sample_fibonacci_rank */
} LightBatch;

/* Aims a light (NULL: the surroundings) at an object, but for the power; false if none of its light
 * comes there first. */
bool light_batch_aim(const AmbScene *scene, const SceneLight *light, uint32_t object, Rng rng,
                     LightBatch *out_batch);

/* Media around a place where light of the batch starts. False: that light first comes into another
 * object, for which it has a batch of its own. */
bool light_batch_start(const AmbScene *scene, const LightBatch *batch, Vec3 o,
                       MediumStack *out_stack);

/* Shares rays, half by the power, half alike: by power alone a bead beside a statue would get none.
 */
void light_batches_share(LightBatch *batches, uint64_t batch_count, uint64_t ray_count);

#endif
