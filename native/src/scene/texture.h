/* SPDX-License-Identifier: GPL-3.0-or-later
 * Images on opaque surfaces. */
#ifndef AMB_SCENE_TEXTURE_H
#define AMB_SCENE_TEXTURE_H

#include <stdbool.h>
#include <stdint.h>

#include "math/vec3.h"

typedef struct Vec2 {
    float x, y;
} Vec2;

/* Pixels are the values in their middles. */
typedef struct SceneTexture {
    char *name;
    uint32_t width, height; /* >= 1 */
    uint32_t extension;     /* AMB_EXTENSION_* */
    bool is_closest;        /* pixels have edges; else bilinear between them */
    Rgb *pixels;            /* (height, width), row 0 = bottom, in [0,1] */
} SceneTexture;

/* Colour at a place of the image, which covers [0,1]^2; what is not finite counts as 0. */
Rgb texture_color(const SceneTexture *texture, Vec2 place);

#endif
