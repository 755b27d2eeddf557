/* SPDX-License-Identifier: GPL-3.0-or-later
 * Suns in the world's image. */
#include "scene/world_lamps.h"

#include <string.h>

#include "base/memory.h"

enum {
    TRIES_MAX = 256, /* bright spots that are looked at */
    BINS = 1 << 12,  /* of luminance: exponent and four bits, a sixteenth of an octave */
    BIN_SHIFT = 31 - 12
};

/* A path that leaves the scene in any direction alike finds the light E of the image with the
 * relative variance V = 4 pi int L^2 dw / E^2 - 1: 1 for an even half of the sky. What is left in
 * the image after lamps are taken shall not have more than this. */
static const double VARIANCE_MAX = 3.0;
/* A spot that adds less to the variance than this is left where it is. */
static const double SPOT_VARIANCE_MIN = 0.01;
/* A spot is what is brighter than this share of its peak: the glow around it is another, larger
 * one, so that it does not widen the core. */
static const float PEAK_SHARE = 0.125f;
/* Larger ones are found by chance, and are no discs, rad. */
static const double ANGLE_MAX = 0.1;

typedef struct Spots {
    WorldImage *image;
    double *weights;      /* solid angle of a pixel, by row */
    uint8_t *marks;       /* by pixel: MARK_* */
    uint32_t *candidates; /* pixels brighter than the cap */
    uint64_t candidate_count;
    uint32_t *pixels;    /* of the spot that is looked at */
    uint32_t count;      /* of them */
    double total;        /* int L dw */
    float surroundings;  /* largest luminance beside the spot */
    int64_t left, right; /* columns of the spot, from that of its peak; may pass an edge */
    uint32_t bottom, top;
} Spots;

enum { MARK_NONE = 0, MARK_IN_SPOT = 1, MARK_LEFT = 2 };

static float luminance(const Spots *spots, uint64_t pixel) {
    return rgb_mean(spots->image->pixels[pixel]);
}

static uint32_t bin_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits >> BIN_SHIFT;
}

static float bin_begin(uint32_t bin) {
    const uint32_t bits = bin << BIN_SHIFT;
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

/* The largest luminance at which the image may be cut off without more variance than allowed;
 * infinite where nothing must be. Sets the total. */
static AmbStatus find_cap(Spots *spots, float *out_cap) {
    const WorldImage *image = spots->image;
    double *bins = memory_zero_array(2 * (uint64_t)BINS, sizeof *bins);
    if (bins == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    double *angles = bins, *squares = bins + BINS; /* sums of dw and of L^2 dw */
    spots->total = 0.0;
    for (uint32_t y = 0; y < image->height; ++y)
        for (uint32_t x = 0; x < image->width; ++x) {
            const float value = luminance(spots, (uint64_t)y * image->width + x);
            const uint32_t bin = bin_of(value);
            angles[bin] += spots->weights[y];
            squares[bin] += spots->weights[y] * (double)value * (double)value;
            spots->total += spots->weights[y] * (double)value;
        }
    const double allowed =
        (VARIANCE_MAX + 1.0) * spots->total * spots->total / (4.0 * (double)AMB_PI);
    double above = 0.0, below = 0.0;
    for (uint32_t i = 0; i < BINS; ++i)
        below += squares[i];
    *out_cap = INFINITY;
    for (uint32_t i = BINS; i-- > 0;) {
        const double cap = (double)bin_begin(i);
        if (below + (above > 0.0 ? cap * cap * above : 0.0) <= allowed)
            break;
        above += angles[i];
        below -= squares[i];
        *out_cap = bin_begin(i);
    }
    memory_free(bins);
    return AMB_OK;
}

static uint32_t wrap(int64_t x, uint32_t width) {
    const int64_t rest = x % (int64_t)width;
    return (uint32_t)(rest < 0 ? rest + (int64_t)width : rest);
}

/* Collects the pixels around a peak that are at least as bright as a threshold. */
static void grow(Spots *spots, uint32_t peak, float threshold) {
    const WorldImage *image = spots->image;
    const int64_t width = (int64_t)image->width, middle = peak % image->width;
    spots->surroundings = 0.0f;
    spots->left = spots->right = middle;
    spots->bottom = spots->top = peak / image->width;
    spots->pixels[0] = peak;
    spots->marks[peak] |= MARK_IN_SPOT;
    spots->count = 1;
    for (uint32_t i = 0; i < spots->count; ++i) {
        const int64_t x = spots->pixels[i] % image->width;
        const uint32_t y = spots->pixels[i] / image->width;
        /* The shorter way round from the peak. */
        int64_t from_middle = x - middle;
        if (2 * from_middle > width)
            from_middle -= width;
        if (2 * from_middle < -width)
            from_middle += width;
        if (middle + from_middle < spots->left)
            spots->left = middle + from_middle;
        if (middle + from_middle > spots->right)
            spots->right = middle + from_middle;
        spots->bottom = y < spots->bottom ? y : spots->bottom;
        spots->top = y > spots->top ? y : spots->top;
        for (int side = 0; side < 9; ++side) {
            const int64_t row = (int64_t)y + side / 3 - 1;
            if (row < 0 || row >= (int64_t)image->height)
                continue;
            const uint32_t pixel =
                (uint32_t)row * image->width + wrap(x + side % 3 - 1, image->width);
            if ((spots->marks[pixel] & MARK_IN_SPOT) != 0)
                continue;
            const float value = luminance(spots, pixel);
            if (value >= threshold) {
                spots->marks[pixel] |= MARK_IN_SPOT;
                spots->pixels[spots->count++] = pixel;
            } else if (value > spots->surroundings) {
                spots->surroundings = value;
            }
        }
    }
}

/* What a pixel of the spot has above the surroundings. */
static Rgb pixel_excess(const Spots *spots, uint32_t pixel) {
    const float value = luminance(spots, pixel);
    const Rgb radiance = spots->image->pixels[pixel];
    return value > spots->surroundings ? rgb_scale(radiance, 1.0f - spots->surroundings / value)
                                       : (Rgb){0, 0, 0};
}

static Vec3 pixel_direction(const WorldImage *image, uint32_t pixel) {
    const uint32_t x = pixel % image->width, y = pixel / image->width;
    return world_direction(image, (float)x + 0.5f, (float)y + 0.5f);
}

/* The lamp that the spot makes; false if it is better left in the image. */
static bool measure(const Spots *spots, WorldLamp *out_lamp) {
    const WorldImage *image = spots->image;
    double flux[3] = {0, 0, 0}, mean[3] = {0, 0, 0}, power = 0.0, square = 0.0;
    for (uint32_t i = 0; i < spots->count; ++i) {
        const uint32_t pixel = spots->pixels[i];
        const double weight = spots->weights[pixel / image->width];
        const Rgb excess = pixel_excess(spots, pixel);
        const double value = (double)rgb_mean(excess);
        const Vec3 d = pixel_direction(image, pixel);
        flux[0] += weight * (double)excess.r;
        flux[1] += weight * (double)excess.g;
        flux[2] += weight * (double)excess.b;
        mean[0] += weight * value * (double)d.x;
        mean[1] += weight * value * (double)d.y;
        mean[2] += weight * value * (double)d.z;
        power += weight * value;
        square += weight * value * value;
    }
    if (!(4.0 * (double)AMB_PI * square > SPOT_VARIANCE_MIN * spots->total * spots->total))
        return false;
    const Vec3 middle = vec3_normalize(
        vec3((float)(mean[0] / power), (float)(mean[1] / power), (float)(mean[2] / power)));
    double moment = 0.0;
    for (uint32_t i = 0; i < spots->count; ++i) {
        const uint32_t pixel = spots->pixels[i];
        const Vec3 off = vec3_sub(pixel_direction(image, pixel), middle);
        const double value = (double)rgb_mean(pixel_excess(spots, pixel));
        moment += spots->weights[pixel / image->width] * value * (double)vec3_dot(off, off);
    }
    /* A pixel is a tent of interpolation, of variance h^2/6 along either side. */
    const double v = (double)AMB_PI / (double)image->height;
    const double u = 2.0 * (double)AMB_PI / (double)image->width *
                     sin(v * (0.5 * (double)(spots->bottom + spots->top) + 0.5));
    const double angle = sqrt(2.0 * (moment / power + (u * u + v * v) / 6.0));
    if (!(angle < ANGLE_MAX))
        return false;
    *out_lamp = (WorldLamp){.direction = middle,
                            .angle = (float)angle,
                            .irradiance = {(float)flux[0], (float)flux[1], (float)flux[2]}};
    return true;
}

/* Moves the spot's excess from the image into a patch of its own. */
static AmbStatus take(const Spots *spots, WorldPatch *out_patch) {
    WorldImage *image = spots->image;
    WorldPatch patch = {.x = wrap(spots->left, image->width),
                        .y = spots->bottom,
                        .width = (uint32_t)(spots->right - spots->left + 1),
                        .height = spots->top - spots->bottom + 1};
    if (patch.width >= image->width) {
        patch.x = 0;
        patch.width = image->width;
    }
    patch.excess = memory_zero_array((uint64_t)patch.width * patch.height, sizeof(Rgb));
    if (patch.excess == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    for (uint32_t i = 0; i < spots->count; ++i) {
        const uint32_t pixel = spots->pixels[i];
        const uint32_t x = pixel % image->width, y = pixel / image->width;
        const uint32_t column = x >= patch.x ? x - patch.x : x + image->width - patch.x;
        const Rgb excess = pixel_excess(spots, pixel), before = image->pixels[pixel];
        patch.excess[(uint64_t)(y - patch.y) * patch.width + column] = excess;
        image->pixels[pixel] = rgb(before.r - excess.r, before.g - excess.g, before.b - excess.b);
    }
    *out_patch = patch;
    return AMB_OK;
}

/* The brightest pixel above the cap that has not been given up; false: none. */
static bool find_peak(const Spots *spots, float cap, uint32_t *out_pixel) {
    float most = cap;
    bool is_found = false;
    for (uint64_t i = 0; i < spots->candidate_count; ++i) {
        const uint32_t pixel = spots->candidates[i];
        if ((spots->marks[pixel] & MARK_LEFT) == 0 && luminance(spots, pixel) > most) {
            most = luminance(spots, pixel);
            *out_pixel = pixel;
            is_found = true;
        }
    }
    return is_found;
}

static AmbStatus list_candidates(Spots *spots, float cap) {
    const uint64_t count = (uint64_t)spots->image->width * spots->image->height;
    for (uint64_t i = 0; i < count; ++i)
        spots->candidate_count += luminance(spots, i) > cap;
    spots->marks = memory_zero_array(count, sizeof *spots->marks);
    spots->pixels = memory_alloc_array(count, sizeof *spots->pixels);
    spots->candidates = memory_alloc_array(spots->candidate_count, sizeof *spots->candidates);
    spots->image->patches = memory_zero_array(WORLD_LAMPS_MAX, sizeof(WorldPatch));
    if (spots->marks == NULL || spots->pixels == NULL || spots->candidates == NULL ||
        spots->image->patches == NULL)
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    uint64_t next = 0;
    for (uint64_t i = 0; i < count; ++i)
        if (luminance(spots, i) > cap)
            spots->candidates[next++] = (uint32_t)i;
    return AMB_OK;
}

static AmbStatus take_spots(Spots *spots, float cap, WorldLamp out_lamps[], uint32_t *out_count) {
    WorldImage *image = spots->image;
    uint32_t peak = 0;
    for (int i = 0; i < TRIES_MAX && *out_count < WORLD_LAMPS_MAX && find_peak(spots, cap, &peak);
         ++i) {
        grow(spots, peak, fmaxf(cap, PEAK_SHARE * luminance(spots, peak)));
        const bool is_lamp = measure(spots, &out_lamps[*out_count]);
        if (is_lamp) {
            AMB_TRY(take(spots, &image->patches[*out_count]));
            image->patch_count = ++*out_count;
        }
        for (uint32_t k = 0; k < spots->count; ++k)
            spots->marks[spots->pixels[k]] = is_lamp ? MARK_NONE : MARK_LEFT;
    }
    return AMB_OK;
}

AmbStatus world_take_lamps(World *world, WorldLamp out_lamps[WORLD_LAMPS_MAX],
                           uint32_t *out_count) {
    *out_count = 0;
    WorldImage *image = &world->image;
    if (image->width == 0)
        return AMB_OK;
    Spots spots = {.image = image};
    spots.weights = memory_alloc_array(image->height, sizeof *spots.weights);
    AmbStatus status = AMB_OK;
    if (spots.weights == NULL)
        status = status_fail(AMB_OUT_OF_MEMORY, "no memory for the world's image");
    float cap = INFINITY;
    if (status == AMB_OK) {
        for (uint32_t y = 0; y < image->height; ++y)
            spots.weights[y] = world_pixel_weight(image, y);
        status = find_cap(&spots, &cap);
    }
    if (status == AMB_OK && isfinite(cap)) {
        status = list_candidates(&spots, cap);
        if (status == AMB_OK)
            status = take_spots(&spots, cap, out_lamps, out_count);
    }
    memory_free(spots.weights);
    memory_free(spots.marks);
    memory_free(spots.candidates);
    memory_free(spots.pixels);
    return status;
}

void world_return_lamps(World *world) {
    WorldImage *image = &world->image;
    /* The last first: a later patch may lie on an earlier one. */
    while (image->patch_count > 0) {
        const WorldPatch *patch = &image->patches[--image->patch_count];
        for (uint32_t y = 0; y < patch->height; ++y)
            for (uint32_t x = 0; x < patch->width; ++x) {
                const uint64_t pixel = (uint64_t)(patch->y + y) * image->width +
                                       wrap((int64_t)patch->x + x, image->width);
                image->pixels[pixel] =
                    rgb_add(image->pixels[pixel], patch->excess[(uint64_t)y * patch->width + x]);
            }
        memory_free(patch->excess);
    }
    memory_free(image->patches);
    image->patches = NULL;
}
