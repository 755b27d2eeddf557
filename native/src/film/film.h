/* SPDX-License-Identifier: GPL-3.0-or-later
 * The image while it grows: sums of samples for each pixel, and passes made from them. */
#ifndef AMB_FILM_FILM_H
#define AMB_FILM_FILM_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "base/status.h"
#include "math/vec3.h"

enum { FILM_LOCK_COUNT = 64, FILM_ORDER_COUNT = 3 };
/* Of the parts by effect those that film_error.h knows. */
enum { FILM_PART_CAUSTICS = 4, FILM_PART_INTERREFLECTION = 7, FILM_PART_COUNT = 9 };

/* What samples add to one pixel. Sums over samples, but for depth: of the first sample. */
typedef struct FilmPixel {
    Rgb orders[FILM_ORDER_COUNT]; /* scattered once, twice, more often */
    Rgb surface;
    Rgb lamps;                    /* images of lamps: in no sum but that of the picture */
    Rgb albedo;                   /* what denoisers ask for: no radiance; */
    Vec3 normal;                  /* world */
    float parts[FILM_PART_COUNT]; /* of all this, by effect; mean of channels */
    float alpha;
    float frequency, contribution;
    float depth;
    uint32_t count;        /* samples */
    Rgb half;              /* orders + surface of those samples that make the first half, */
    uint32_t half_count;   /* and their number */
    uint32_t object_count; /* samples whose primary ray hits a translucent object */
} FilmPixel;

/* All radiance: orders and surface. */
Rgb film_pixel_sum(const FilmPixel *pixel);

typedef struct Film {
    uint32_t width, height;                 /* of the rendered rectangle, pixels */
    FilmPixel *pixels;                      /* row 0 = bottom */
    float *errors;                          /* the Error pass, 0 until it is set */
    pthread_mutex_t locks[FILM_LOCK_COUNT]; /* by row: a reader may look while samples arrive */
    /* Samples refused, by birthplace. */
    atomic_uint_least64_t nonfinite_orders[FILM_ORDER_COUNT], nonfinite_surface;
} Film;

/* Room for the pixels, not yet zeroed: on a large image that takes seconds. */
AmbStatus film_create(uint32_t width, uint32_t height, Film *out_film);
void film_clear(Film *film);

/* Before the first film_add, for every row. */
void film_zero_rows(Film *film, uint32_t begin, uint32_t end);

/* Adds the sum of some samples of a pixel. Values that are not finite are counted by where they
 * were born and left out: above zero the counts are a defect. */
void film_add(Film *film, uint32_t x, uint32_t y, const FilmPixel *sum);

/* Sets row y of the Error pass: (width) floats. */
void film_set_error_row(Film *film, uint32_t y, const float *errors);

/* Channels of a pass, 0 if there is none of that name. */
uint32_t film_pass_channels(const char *name);

/* Row y of a pass: (width, channels) floats, mean over the samples so far; y = 0 is the bottom. */
void film_read_row(Film *film, uint32_t pass, uint32_t y, float *out_row);

/* Pass number of a name, or UINT32_MAX. */
uint32_t film_pass_find(const char *name);

enum { FILM_PASS_COUNT = 10 };
typedef struct FilmPass {
    const char *name;
    uint32_t channels;
    const char *channel_names[4]; /* in a file */
} FilmPass;
extern const FilmPass FILM_PASSES[FILM_PASS_COUNT];

uint64_t film_bytes(const Film *film);

/* Writes all passes as one scan-line OpenEXR file with 32-bit float channels
 * "layer.Pass.channel" and a string attribute. There is never half a file under path. */
AmbStatus film_write_exr(Film *film, const char *path, const char *layer,
                         const char *attribute_name, const char *attribute_text);

/* Tests: as on a file system whose files all have names. */
void film_exr_avoid_nameless(bool is_avoided);

#endif
