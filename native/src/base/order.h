/* SPDX-License-Identifier: GPL-3.0-or-later
 * The halves of a list. */
#ifndef AMB_BASE_ORDER_H
#define AMB_BASE_ORDER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/* Largest item. */
enum { ORDER_SIZE_MAX = 256 };

/* Whether a comes before b; user: of order_select. */
typedef bool (*OrderBefore)(const void *a, const void *b, const void *user);

/* The item of that rank comes to its index, none after it to the left and none before it to the
 * right: Hoare's selection, median of three. What it leaves depends on the list alone. rank <
 * count; `size` bytes an item, a constant as `is_before` is, so that both are compiled in. */
static inline void order_select(void *items, size_t size, uint64_t count, uint64_t rank,
                                OrderBefore is_before, const void *user) {
    _Alignas(16) unsigned char pivot[ORDER_SIZE_MAX], swap[ORDER_SIZE_MAX];
    unsigned char *const list = items;
    uint64_t low = 0, high = count - 1;
    while (low < high) {
        const unsigned char *middle = list + (low + (high - low) / 2) * size;
        const unsigned char *first = list + low * size, *last = list + high * size;
        if (is_before(first, middle, user) != is_before(first, last, user))
            middle = first;
        else if (is_before(last, middle, user) != is_before(last, first, user))
            middle = last;
        memcpy(pivot, middle, size);
        uint64_t i = low, k = high;
        for (;;) {
            while (is_before(list + i * size, pivot, user))
                ++i;
            while (is_before(pivot, list + k * size, user))
                --k;
            if (i >= k)
                break;
            memcpy(swap, list + i * size, size);
            memcpy(list + i * size, list + k * size, size);
            memcpy(list + k * size, swap, size);
            ++i;
            --k;
        }
        /* Up to k nothing is after the pivot, from k + 1 on nothing before it. */
        if (rank <= k)
            high = k;
        else
            low = k + 1;
    }
}

#endif
