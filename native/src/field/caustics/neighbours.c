/* SPDX-License-Identifier: GPL-3.0-or-later
 * A balanced tree of places, and its search. */
#include "field/caustics/neighbours.h"

#include "base/order.h"

/* As in caustic_tree.c. */
static const float NORMAL_COS_MIN = 0.5f;

static float component(Vec3 a, int axis) {
    return axis == 0 ? a.x : axis == 1 ? a.y : a.z;
}

static int longest_axis(const Place *places, uint64_t count) {
    Vec3 low = places[0].p, high = low;
    for (uint64_t i = 1; i < count; ++i) {
        low = vec3_min(low, places[i].p);
        high = vec3_max(high, places[i].p);
    }
    const Vec3 side = vec3_sub(high, low);
    const int axis = side.y > side.x ? 1 : 0;
    return side.z > component(side, axis) ? 2 : axis;
}

static bool place_before(const void *first, const void *second, const void *user) {
    const Place *a = first, *b = second;
    const int axis = *(const int *)user;
    return component(a->p, axis) < component(b->p, axis);
}

void neighbours_sort(Place *places, uint64_t count) {
    while (count > 1) {
        const uint64_t middle = count / 2;
        const int axis = longest_axis(places, count);
        order_select(places, sizeof *places, count, middle, place_before, &axis);
        places[middle].axis = (uint32_t)axis;
        neighbours_sort(places, middle);
        places += middle + 1;
        count -= middle + 1;
    }
}

typedef struct Search {
    const Place *from;
    uint32_t rank, count;
    float nearest[NEIGHBOURS_MAX]; /* squared distances so far, ascending */
} Search;

static void consider(Search *search, const Place *place) {
    const Place *from = search->from;
    if (place->id == from->id || vec3_dot(place->n, from->n) < NORMAL_COS_MIN)
        return;
    const Vec3 x = vec3_sub(place->p, from->p);
    const float square = vec3_dot(x, x);
    uint32_t i = search->count;
    if (i == search->rank) {
        if (!(square < search->nearest[i - 1]))
            return;
        --i;
    } else {
        ++search->count;
    }
    for (; i > 0 && search->nearest[i - 1] > square; --i)
        search->nearest[i] = search->nearest[i - 1];
    search->nearest[i] = square;
}

static void visit(Search *search, const Place *places, uint64_t count) {
    while (count > 0) {
        const uint64_t middle = count / 2;
        const Place *place = &places[middle];
        const int axis = (int)place->axis;
        const float offset = component(search->from->p, axis) - component(place->p, axis);
        const Place *right = place + 1;
        const uint64_t right_count = count - middle - 1;
        const bool is_left = offset < 0.0f;
        consider(search, place);
        visit(search, is_left ? places : right, is_left ? middle : right_count);
        if (search->count == search->rank && offset * offset > search->nearest[search->rank - 1])
            return;
        places = is_left ? right : places;
        count = is_left ? right_count : middle;
    }
}

float neighbours_distance(const Place *places, uint64_t count, const Place *from, uint32_t rank) {
    Search search = {.from = from, .rank = rank};
    visit(&search, places, count);
    return search.count == rank ? sqrtf(search.nearest[rank - 1]) : INFINITY;
}
