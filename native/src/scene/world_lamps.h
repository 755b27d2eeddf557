/* SPDX-License-Identifier: GPL-3.0-or-later
 * Suns in the world's image: what is small and far brighter than its surroundings becomes lamps,
 * which light is traced from; chance would not find it behind a refractive boundary. */
#ifndef AMB_SCENE_WORLD_LAMPS_H
#define AMB_SCENE_WORLD_LAMPS_H

#include "scene/world.h"

enum { WORLD_LAMPS_MAX = 32 };

/* A disc in the sky of even radiance. */
typedef struct WorldLamp {
    Vec3 direction; /* unit, from the scene to its middle */
    float angle;    /* angular radius of the disc with the second moment of what was taken, rad */
    Rgb irradiance; /* of all its directions together, each on a plane of its own, W/m^2 */
} WorldLamp;

/* Takes lamps out of the image, WORLD_LAMPS_MAX at most. Radiance lost there times solid angle is
 * their irradiance exactly. docs/theory.md says what is taken. */
AmbStatus world_take_lamps(World *world, WorldLamp out_lamps[WORLD_LAMPS_MAX], uint32_t *out_count);

/* Puts back what was taken. */
void world_return_lamps(World *world);

#endif
