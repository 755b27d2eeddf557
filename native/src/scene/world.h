/* SPDX-License-Identifier: GPL-3.0-or-later
 * The surroundings: radiance by direction, constant or an equirectangular image, and directions
 * towards its bright parts. */
#ifndef AMB_SCENE_WORLD_H
#define AMB_SCENE_WORLD_H

#include <stdbool.h>
#include <stdint.h>

#include "base/status.h"
#include "math/sampling.h"

/* What a lamp has taken out of the image: a rectangle of pixels. */
typedef struct WorldPatch {
    uint32_t x, y, width, height; /* x + width may pass the right edge: columns go round */
    Rgb *excess;                  /* (height, width) */
} WorldPatch;

/* Pixels are the samples of radiance in their middles, bilinear between them; columns go round, and
 * beyond the middles of the first and last row radiance stays theirs up to the pole. */
typedef struct WorldImage {
    uint32_t width, height; /* 0: none, radiance is the constant */
    Rgb *pixels;            /* (height, width), row 0 = bottom, what lamps took left out */
    float to_world[9];      /* rotation, row-major, from the image's axes */
    float *row_sums;        /* (height + 1): chance of the rows below, 0 .. 1 */
    float *column_sums;     /* (height, width + 1): chance of the columns to the left, in a row */
    WorldPatch *patches;
    uint32_t patch_count;
} WorldImage;

typedef struct World {
    Rgb constant; /* where there is no image */
    WorldImage image;
    /* Set by world_prepare; without what lamps took. */
    Rgb mean; /* of all directions */
    bool is_black;
} World;

/* Takes over `pixels` (height, width). AMB_OUT_OF_MEMORY frees nothing and changes nothing. */
AmbStatus world_set_image(World *world, Rgb *pixels, uint32_t width, uint32_t height,
                          const float to_world[9]);

/* Once constant and pixels are final: finds where directions are sampled. */
AmbStatus world_prepare(World *world);

void world_clear(World *world);

uint64_t world_bytes(const World *world);

/* Radiance from unit direction d (pointing away from the scene), W m^-2 sr^-1, as the camera sees
 * it directly, mirrored and refracted. */
Rgb world_radiance(const World *world, Vec3 d);

/* The same without what lamps have taken over: for light that has scattered or been reflected
 * diffusely on its way to the camera, to which those lamps are added. */
Rgb world_radiance_but_lamps(const World *world, Vec3 d);

/* A direction with the pdf below; u in [0,1)^2. Only where the image is not black. */
Vec3 world_sample(const World *world, Sample2 u);

/* 1/sr, exactly that of world_sample: constant in each pixel, in proportion to what the image
 * sends from there. 0 where there is no image. */
float world_pdf(const World *world, Vec3 d);

/* Direction of a point of the image, x in pixels from the left, y from the bottom; unit, world. */
Vec3 world_direction(const WorldImage *image, float x, float y);

/* Solid angle that the value of a pixel of a row stands for, sr: the integral of its share of the
 * interpolation over the sphere. */
double world_pixel_weight(const WorldImage *image, uint32_t row);

#endif
