/* SPDX-License-Identifier: GPL-3.0-or-later
 * How far apart places on surfaces lie. */
#ifndef AMB_FIELD_CAUSTICS_NEIGHBOURS_H
#define AMB_FIELD_CAUSTICS_NEIGHBOURS_H

#include <stdbool.h>
#include <stdint.h>

#include "math/vec3.h"

enum { NEIGHBOURS_MAX = 16 };

typedef struct Place {
    Vec3 p, n; /* m; unit normal: places whose normals differ much are no neighbours */
    uint64_t id;
    uint32_t axis; /* of neighbours_sort */
} Place;

/* Sorts places into a balanced tree: the middle of each range parts it along its longest side. */
void neighbours_sort(Place *places, uint64_t count);

/* Distance from p to the rank-th nearest of the sorted places, the one of that id left out, m;
 * 1 <= rank <= NEIGHBOURS_MAX. INFINITY where there are fewer. */
float neighbours_distance(const Place *places, uint64_t count, const Place *from, uint32_t rank);

#endif
