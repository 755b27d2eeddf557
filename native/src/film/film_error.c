/* SPDX-License-Identifier: GPL-3.0-or-later
 * What two halves of each pixel's samples tell about the error of the picture. */
#include "film/film_error.h"

/* Of the means of the halves, in doubles: squares of all that a pixel can hold are numbers. */
static double square_difference(float half, float all, uint32_t a, uint32_t b) {
    const double difference = (double)half / a - ((double)all - (double)half) / b;
    return difference * difference;
}

double film_pixel_variance(const FilmPixel *pixel) {
    const uint32_t a = pixel->half_count, n = pixel->count, b = n - a;
    if (a == 0 || b == 0)
        return 0.0;
    const Rgb all = film_pixel_sum(pixel), half = pixel->half;
    const double share = (double)a / n * ((double)b / n);
    return share / 3.0 *
           (square_difference(half.r, all.r, a, b) + square_difference(half.g, all.g, a, b) +
            square_difference(half.b, all.b, a, b));
}

bool film_pixel_is_in(const FilmPixel *pixel, FilmSet set) {
    return set == FILM_ALL || pixel->object_count > 0 ||
           (set == FILM_LIT && pixel->parts[FILM_PART_CAUSTICS] > 0.0f);
}

FilmSum film_sum_row(const Film *film, uint32_t y, FilmSet set) {
    FilmSum sum = {.count = 0};
    for (uint32_t x = 0; x < film->width; ++x) {
        const FilmPixel *pixel = &film->pixels[(uint64_t)y * film->width + x];
        if (pixel->count == 0 || !film_pixel_is_in(pixel, set))
            continue;
        const double variance = film_pixel_variance(pixel);
        sum.variance += variance;
        sum.variance_square += variance * variance;
        sum.radiance += (double)(rgb_mean(film_pixel_sum(pixel)) / (float)pixel->count);
        ++sum.count;
    }
    return sum;
}

/* Sums over the pixels of a set. */
typedef struct ShareSum {
    double orders[FILM_ORDER_COUNT], parts[FILM_PART_COUNT], lamps; /* squares */
    double radiance;
    uint64_t count;
} ShareSum;

static ShareSum sum_shares(const Film *film, FilmSet set) {
    ShareSum sum = {.count = 0};
    for (uint64_t i = 0; i < (uint64_t)film->width * film->height; ++i) {
        const FilmPixel *pixel = &film->pixels[i];
        if (pixel->count == 0 || !film_pixel_is_in(pixel, set))
            continue;
        const double n = (double)pixel->count;
        for (int k = 0; k < FILM_ORDER_COUNT; ++k)
            sum.orders[k] +=
                (double)rgb_mean(rgb_mul(pixel->orders[k], pixel->orders[k])) / (n * n);
        for (int k = 0; k < FILM_PART_COUNT; ++k)
            sum.parts[k] += (double)pixel->parts[k] * (double)pixel->parts[k] / (n * n);
        sum.lamps += (double)rgb_mean(rgb_mul(pixel->lamps, pixel->lamps)) / (n * n);
        sum.radiance += (double)rgb_mean(film_pixel_sum(pixel)) / n;
        ++sum.count;
    }
    return sum;
}

static double share(const ShareSum *sum, double squares) {
    return sum->radiance > 0.0 ? sqrt(squares * (double)sum->count) / sum->radiance : 0.0;
}

FilmShares film_shares(const Film *film) {
    const ShareSum objects = sum_shares(film, FILM_OBJECTS), lit = sum_shares(film, FILM_LIT);
    const ShareSum all = sum_shares(film, FILM_ALL);
    FilmShares shares = {.is_known = objects.radiance > 0.0,
                         .has_caustics = lit.radiance > 0.0,
                         .has_any = all.radiance > 0.0};
    for (int k = 0; k < FILM_ORDER_COUNT; ++k)
        shares.orders[k] = share(&objects, objects.orders[k]);
    for (int k = 0; k < FILM_PART_COUNT; ++k)
        shares.parts[k] = share(&objects, objects.parts[k]);
    shares.parts[FILM_PART_CAUSTICS] = share(&lit, lit.parts[FILM_PART_CAUSTICS]);
    shares.lamps = share(&all, all.lamps);
    shares.parts[FILM_PART_INTERREFLECTION] = share(&all, all.parts[FILM_PART_INTERREFLECTION]);
    return shares;
}
