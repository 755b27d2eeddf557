/* SPDX-License-Identifier: GPL-3.0-or-later
 * Memory with checked sizes. */
#include "base/memory.h"

#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { ALIGNMENT = 64 };

/* Allocations until the first that fails; from there on it counts those that do. */
static const int64_t NONE_FAILS = INT64_MIN;
static atomic_int_least64_t fail_countdown = INT64_MIN;
static atomic_int_least64_t fail_count;

bool memory_must_fail(void) {
    if (atomic_load_explicit(&fail_countdown, memory_order_relaxed) == NONE_FAILS)
        return false;
    const int64_t left = atomic_fetch_sub(&fail_countdown, 1);
    return left <= 0 && -left < atomic_load(&fail_count);
}

void *memory_alloc_array(uint64_t count, uint64_t size) {
    if (memory_must_fail())
        return NULL;
    if (size != 0 && count > (SIZE_MAX - ALIGNMENT) / size)
        return NULL;
    uint64_t bytes = count * size;
    /* aligned_alloc wants a multiple of the alignment, and zero bytes must still be a pointer. */
    bytes = (bytes / ALIGNMENT + 1) * ALIGNMENT;
    return aligned_alloc(ALIGNMENT, (size_t)bytes);
}

void *memory_zero_array(uint64_t count, uint64_t size) {
    void *pointer = memory_alloc_array(count, size);
    if (pointer != NULL)
        memset(pointer, 0, (size_t)(count * size));
    return pointer;
}

void *memory_copy_array(const void *data, uint64_t count, uint64_t size) {
    void *pointer = memory_alloc_array(count, size);
    if (pointer != NULL && count != 0)
        memcpy(pointer, data, (size_t)(count * size));
    return pointer;
}

char *memory_copy_text(const char *text) {
    const char *source = text != NULL ? text : "";
    return memory_copy_array(source, strlen(source) + 1, 1);
}

void memory_free(void *pointer) {
    free(pointer);
}

void memory_fail_after(int64_t n, int64_t count) {
    atomic_store(&fail_count, count);
    atomic_store(&fail_countdown, n < 0 ? NONE_FAILS : n);
}
