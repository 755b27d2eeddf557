/* SPDX-License-Identifier: GPL-3.0-or-later
 * Looking up images. */
#include "scene/texture.h"

#include <math.h>

#include "amberlight/amberlight.h"

/* Of a coordinate, in [0,1] but for rounding: where it goes on beyond. */
static float within(float x, uint32_t extension) {
    switch (extension) {
    case AMB_EXTENSION_REPEAT:
        return x - floorf(x);
    case AMB_EXTENSION_MIRROR:
        return fabsf(x - 2.0f * roundf(0.5f * x));
    default:
        return clampf(x, 0.0f, 1.0f);
    }
}

/* Of a row or a column, at most one beyond the first or last. */
static uint32_t neighbour(int64_t i, uint32_t count, uint32_t extension) {
    if (i < 0)
        return extension == AMB_EXTENSION_REPEAT ? count - 1 : 0;
    if (i >= (int64_t)count)
        return extension == AMB_EXTENSION_REPEAT ? 0 : count - 1;
    return (uint32_t)i;
}

static Rgb pixel(const SceneTexture *texture, int64_t x, int64_t y) {
    const uint64_t column = neighbour(x, texture->width, texture->extension);
    const uint64_t row = neighbour(y, texture->height, texture->extension);
    return texture->pixels[row * texture->width + column];
}

static Rgb mix(Rgb a, Rgb b, float part) {
    return rgb_add(rgb_scale(a, 1.0f - part), rgb_scale(b, part));
}

Rgb texture_color(const SceneTexture *texture, Vec2 place) {
    const float u = isfinite(place.x) ? place.x : 0.0f, v = isfinite(place.y) ? place.y : 0.0f;
    if (texture->extension == AMB_EXTENSION_CLIP &&
        !(u >= 0.0f && u <= 1.0f && v >= 0.0f && v <= 1.0f))
        return rgb(0, 0, 0);
    const float x = within(u, texture->extension) * (float)texture->width;
    const float y = within(v, texture->extension) * (float)texture->height;
    if (texture->is_closest)
        return pixel(texture, (int64_t)x, (int64_t)y);
    const float left = floorf(x - 0.5f), below = floorf(y - 0.5f);
    const float across = x - 0.5f - left, up = y - 0.5f - below;
    const int64_t i = (int64_t)left, j = (int64_t)below;
    const Rgb low = mix(pixel(texture, i, j), pixel(texture, i + 1, j), across);
    const Rgb high = mix(pixel(texture, i, j + 1), pixel(texture, i + 1, j + 1), across);
    return mix(low, high, up);
}
