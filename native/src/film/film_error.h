/* SPDX-License-Identifier: GPL-3.0-or-later
 * What two halves of each pixel's samples tell about the error of the picture. */
#ifndef AMB_FILM_FILM_ERROR_H
#define AMB_FILM_FILM_ERROR_H

#include "film/film.h"

/* Squared error of the mean of a pixel's samples, mean over channels, from the difference of its
 * halves A and B of a and b samples: (A - B)^2 ab / (a+b)^2. Unbiased where the halves are
 * independent; too large where they complement each other. 0 if one is empty. */
double film_pixel_variance(const FilmPixel *pixel);

typedef struct FilmSum {
    double variance;        /* sum of film_pixel_variance, */
    double variance_square; /* and of its square */
    double radiance;        /* sum of radiance, mean of channels */
    uint64_t count;         /* pixels */
} FilmSum;

/* Pixels that an error is stated for. */
typedef enum FilmSet {
    FILM_OBJECTS, /* those that show a translucent object */
    FILM_LIT,     /* and those that show the caustics of one */
    FILM_ALL,
} FilmSet;

bool film_pixel_is_in(const FilmPixel *pixel, FilmSet set);

/* Over the pixels of row y that are in the set. No samples may arrive meanwhile. */
FilmSum film_sum_row(const Film *film, uint32_t y, FilmSet set);

/* Shares of what the pixels of FILM_OBJECTS are made of: root of the mean square, relative to their
 * mean radiance. That of caustics is the same over FILM_LIT, that of light between opaque surfaces
 * over FILM_ALL. What noise there is adds to them. */
typedef struct FilmShares {
    bool is_known, has_caustics, has_any; /* there are such pixels, and they are not black */
    double orders[FILM_ORDER_COUNT], parts[FILM_PART_COUNT];
    double lamps; /* their images, over FILM_ALL, in units of all else there */
} FilmShares;

FilmShares film_shares(const Film *film);

#endif
