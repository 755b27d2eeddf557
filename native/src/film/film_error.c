/* SPDX-License-Identifier: GPL-3.0-or-later
 * What two halves of each pixel's samples tell about the error of the picture. */
#include "film/film_error.h"

float film_pixel_variance(const FilmPixel *pixel) {
    const uint32_t a = pixel->half_count, n = pixel->count, b = n - a;
    if (a == 0 || b == 0)
        return 0.0f;
    const Rgb all = film_pixel_sum(pixel);
    const Rgb first = rgb_scale(pixel->half, 1.0f / (float)a);
    const Rgb second = rgb_scale(rgb_add(all, rgb_scale(pixel->half, -1.0f)), 1.0f / (float)b);
    const Rgb difference = rgb_add(first, rgb_scale(second, -1.0f));
    const float share = (float)a / (float)n * ((float)b / (float)n);
    return share * rgb_mean(rgb_mul(difference, difference));
}

FilmSum film_sum_row(const Film *film, uint32_t y, bool is_objects_only) {
    FilmSum sum = {.count = 0};
    for (uint32_t x = 0; x < film->width; ++x) {
        const FilmPixel *pixel = &film->pixels[(uint64_t)y * film->width + x];
        if (pixel->count == 0 || (is_objects_only && pixel->object_count == 0))
            continue;
        sum.variance += (double)film_pixel_variance(pixel);
        sum.radiance += (double)(rgb_mean(film_pixel_sum(pixel)) / (float)pixel->count);
        ++sum.count;
    }
    return sum;
}

FilmShares film_shares(const Film *film) {
    FilmShares shares = {.is_known = false};
    double radiance = 0.0;
    uint64_t count = 0;
    for (uint64_t i = 0; i < (uint64_t)film->width * film->height; ++i) {
        const FilmPixel *pixel = &film->pixels[i];
        if (pixel->object_count == 0)
            continue;
        const double n = (double)pixel->count;
        for (int k = 0; k < FILM_ORDER_COUNT; ++k)
            shares.orders[k] +=
                (double)rgb_mean(rgb_mul(pixel->orders[k], pixel->orders[k])) / (n * n);
        for (int k = 0; k < FILM_PART_COUNT; ++k)
            shares.parts[k] += (double)pixel->parts[k] * (double)pixel->parts[k] / (n * n);
        radiance += (double)rgb_mean(film_pixel_sum(pixel)) / n;
        ++count;
    }
    shares.is_known = radiance > 0.0;
    for (int k = 0; k < FILM_ORDER_COUNT && shares.is_known; ++k)
        shares.orders[k] = sqrt(shares.orders[k] * (double)count) / radiance;
    for (int k = 0; k < FILM_PART_COUNT && shares.is_known; ++k)
        shares.parts[k] = sqrt(shares.parts[k] * (double)count) / radiance;
    return shares;
}
