/* SPDX-License-Identifier: GPL-3.0-or-later
 * The image while it grows. */
#include "film/film.h"

#include <string.h>

#include "base/memory.h"

enum {
    PASS_COMBINED,
    PASS_DEPTH,
    PASS_SINGLE,
    PASS_DOUBLE,
    PASS_MULTIPLE,
    PASS_SURFACE,
    PASS_FREQUENCY,
    PASS_ERROR,
    PASS_ALBEDO,
    PASS_NORMAL
};

const FilmPass FILM_PASSES[FILM_PASS_COUNT] = {
    [PASS_COMBINED] = {"Combined", 4, {"R", "G", "B", "A"}},
    [PASS_DEPTH] = {"Depth", 1, {"Z"}},
    [PASS_SINGLE] = {"Single Scattering", 3, {"R", "G", "B"}},
    [PASS_DOUBLE] = {"Double Scattering", 3, {"R", "G", "B"}},
    [PASS_MULTIPLE] = {"Multiple Scattering", 3, {"R", "G", "B"}},
    [PASS_SURFACE] = {"Surface", 3, {"R", "G", "B"}},
    [PASS_FREQUENCY] = {"Frequency", 1, {"X"}},
    [PASS_ERROR] = {"Error", 1, {"X"}},
    [PASS_ALBEDO] = {"Denoising Albedo", 3, {"R", "G", "B"}},
    [PASS_NORMAL] = {"Denoising Normal", 3, {"X", "Y", "Z"}},
};

AmbStatus film_create(uint32_t width, uint32_t height, Film *out_film) {
    memset(out_film, 0, sizeof *out_film);
    out_film->pixels = memory_alloc_array((uint64_t)width * height, sizeof(FilmPixel));
    out_film->errors = memory_alloc_array((uint64_t)width * height, sizeof(float));
    if (out_film->pixels == NULL || out_film->errors == NULL) {
        memory_free(out_film->pixels);
        memory_free(out_film->errors);
        out_film->pixels = NULL;
        return status_fail(AMB_OUT_OF_MEMORY, "no memory for an image of %u x %u pixels", width,
                           height);
    }
    out_film->width = width;
    out_film->height = height;
    for (int i = 0; i < FILM_LOCK_COUNT; ++i)
        pthread_mutex_init(&out_film->locks[i], NULL);
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        atomic_init(&out_film->nonfinite_orders[k], 0);
    atomic_init(&out_film->nonfinite_surface, 0);
    return AMB_OK;
}

void film_clear(Film *film) {
    if (film->pixels == NULL)
        return;
    for (int i = 0; i < FILM_LOCK_COUNT; ++i)
        pthread_mutex_destroy(&film->locks[i]);
    memory_free(film->pixels);
    memory_free(film->errors);
    film->pixels = NULL;
}

void film_add(Film *film, uint32_t x, uint32_t y, const FilmPixel *sum) {
    FilmPixel add = *sum;
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        if (!rgb_is_finite(add.orders[k])) {
            atomic_fetch_add(&film->nonfinite_orders[k], 1);
            add.orders[k] = rgb(0, 0, 0);
        }
    if (!isfinite(add.frequency) || !isfinite(add.contribution)) {
        atomic_fetch_add(&film->nonfinite_orders[0], 1);
        add.frequency = add.contribution = 0.0f;
    }
    if (!rgb_is_finite(add.surface)) {
        atomic_fetch_add(&film->nonfinite_surface, 1);
        add.surface = rgb(0, 0, 0);
    }
    if (!rgb_is_finite(add.lamps)) {
        atomic_fetch_add(&film->nonfinite_surface, 1);
        add.lamps = rgb(0, 0, 0);
    }
    if (!rgb_is_finite(add.albedo) || !vec3_is_finite(add.normal)) {
        atomic_fetch_add(&film->nonfinite_surface, 1);
        add.albedo = rgb(0, 0, 0);
        add.normal = vec3(0, 0, 0);
    }
    for (int k = 0; k < FILM_PART_COUNT; ++k)
        if (!isfinite(add.parts[k]))
            add.parts[k] = 0.0f;
    /* Refused with its parts. */
    if (!rgb_is_finite(add.half))
        add.half = rgb(0, 0, 0);
    const uint64_t index = (uint64_t)y * film->width + x;
    FilmPixel *pixel = &film->pixels[index];
    pthread_mutex_t *lock = &film->locks[y % FILM_LOCK_COUNT];
    pthread_mutex_lock(lock);
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        pixel->orders[k] = rgb_add(pixel->orders[k], add.orders[k]);
    pixel->surface = rgb_add(pixel->surface, add.surface);
    pixel->lamps = rgb_add(pixel->lamps, add.lamps);
    pixel->albedo = rgb_add(pixel->albedo, add.albedo);
    pixel->normal = vec3_add(pixel->normal, add.normal);
    for (int k = 0; k < FILM_PART_COUNT; ++k)
        pixel->parts[k] += add.parts[k];
    pixel->alpha += add.alpha;
    pixel->frequency += add.frequency;
    pixel->contribution += add.contribution;
    if (pixel->count == 0)
        pixel->depth = add.depth;
    pixel->count += add.count;
    pixel->half = rgb_add(pixel->half, add.half);
    pixel->half_count += add.half_count;
    pixel->object_count += add.object_count;
    pthread_mutex_unlock(lock);
}

void film_set_error_row(Film *film, uint32_t y, const float *errors) {
    pthread_mutex_t *lock = &film->locks[y % FILM_LOCK_COUNT];
    pthread_mutex_lock(lock);
    memcpy(film->errors + (uint64_t)y * film->width, errors, film->width * sizeof(float));
    pthread_mutex_unlock(lock);
}

uint32_t film_pass_find(const char *name) {
    for (uint32_t i = 0; i < FILM_PASS_COUNT; ++i)
        if (strcmp(FILM_PASSES[i].name, name) == 0)
            return i;
    return UINT32_MAX;
}

uint32_t film_pass_channels(const char *name) {
    const uint32_t pass = film_pass_find(name);
    return pass != UINT32_MAX ? FILM_PASSES[pass].channels : 0;
}

static void put_rgb(float *out, Rgb value) {
    out[0] = value.r;
    out[1] = value.g;
    out[2] = value.b;
}

Rgb film_pixel_sum(const FilmPixel *pixel) {
    Rgb sum = pixel->surface;
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        sum = rgb_add(sum, pixel->orders[k]);
    return sum;
}

static void read_pixel(const FilmPixel *pixel, uint32_t pass, float *out) {
    const float scale = pixel->count > 0 ? 1.0f / (float)pixel->count : 0.0f;
    switch (pass) {
    case PASS_COMBINED:
        put_rgb(out, rgb_scale(rgb_add(film_pixel_sum(pixel), pixel->lamps), scale));
        out[3] = pixel->alpha * scale;
        break;
    case PASS_DEPTH:
        out[0] = pixel->depth;
        break;
    case PASS_SINGLE:
    case PASS_DOUBLE:
    case PASS_MULTIPLE:
        put_rgb(out, rgb_scale(pixel->orders[pass - PASS_SINGLE], scale));
        break;
    case PASS_SURFACE:
        put_rgb(out, rgb_scale(rgb_add(pixel->surface, pixel->lamps), scale));
        break;
    case PASS_ALBEDO:
        put_rgb(out, rgb_scale(pixel->albedo, scale));
        break;
    case PASS_NORMAL: {
        const Vec3 normal = vec3_scale(pixel->normal, scale);
        put_rgb(out, rgb(normal.x, normal.y, normal.z));
        break;
    }
    default:
        out[0] = pixel->contribution > 0.0f ? pixel->frequency / pixel->contribution : 0.0f;
        break;
    }
}

void film_read_row(Film *film, uint32_t pass, uint32_t y, float *out_row) {
    const uint32_t channels = FILM_PASSES[pass].channels;
    const FilmPixel *row = film->pixels + (uint64_t)y * film->width;
    pthread_mutex_t *lock = &film->locks[y % FILM_LOCK_COUNT];
    pthread_mutex_lock(lock);
    if (pass == PASS_ERROR)
        memcpy(out_row, film->errors + (uint64_t)y * film->width, film->width * sizeof(float));
    else
        for (uint32_t x = 0; x < film->width; ++x)
            read_pixel(&row[x], pass, out_row + (uint64_t)x * channels);
    pthread_mutex_unlock(lock);
}

void film_zero_rows(Film *film, uint32_t begin, uint32_t end) {
    memset(film->pixels + (uint64_t)begin * film->width, 0,
           (uint64_t)(end - begin) * film->width * sizeof(FilmPixel));
    memset(film->errors + (uint64_t)begin * film->width, 0,
           (uint64_t)(end - begin) * film->width * sizeof(float));
}

uint64_t film_bytes(const Film *film) {
    return (uint64_t)film->width * film->height * (sizeof(FilmPixel) + sizeof(float));
}
