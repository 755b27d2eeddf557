/* SPDX-License-Identifier: GPL-3.0-or-later
 * Memory with checked sizes. */
#include "base/memory.h"

#include <malloc.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

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

static atomic_int_least64_t held;
static _Thread_local MemoryLimit *thread_limit;

void memory_set_limit(MemoryLimit *limit) {
    thread_limit = limit;
}

MemoryLimit *memory_get_limit(void) {
    return thread_limit;
}

uint64_t memory_held(void) {
    const int64_t bytes = atomic_load(&held);
    return bytes > 0 ? (uint64_t)bytes : 0;
}

static atomic_uint_least64_t pretended;

void memory_pretend_machine(uint64_t bytes) {
    atomic_store(&pretended, bytes);
}

uint64_t memory_of_machine(void) {
    if (atomic_load(&pretended) > 0)
        return atomic_load(&pretended);
    const long pages = sysconf(_SC_PHYS_PAGES), size = sysconf(_SC_PAGESIZE);
    return pages > 0 && size > 0 ? (uint64_t)pages * (uint64_t)size : UINT64_MAX;
}

/* Several threads that ask at once may together go beyond by what they ask for. */
static bool is_allowed(MemoryLimit *limit, uint64_t bytes) {
    const uint64_t total = memory_held() + bytes;
    if (limit == NULL || total <= limit->bytes)
        return true;
    atomic_store(&limit->refused, total);
    return false;
}

bool memory_reserve(MemoryLimit *limit, int64_t bytes) {
    if (bytes > 0 && !is_allowed(limit, (uint64_t)bytes))
        return false;
    atomic_fetch_add(&held, bytes);
    return true;
}

void *memory_alloc_array(uint64_t count, uint64_t size) {
    if (memory_must_fail())
        return NULL;
    if (size != 0 && count > (SIZE_MAX - ALIGNMENT) / size)
        return NULL;
    uint64_t bytes = count * size;
    /* aligned_alloc wants a multiple of the alignment, and zero bytes must still be a pointer. */
    bytes = (bytes / ALIGNMENT + 1) * ALIGNMENT;
    if (!is_allowed(thread_limit, bytes))
        return NULL;
    void *pointer = aligned_alloc(ALIGNMENT, (size_t)bytes);
    if (pointer != NULL)
        atomic_fetch_add(&held, (int64_t)malloc_usable_size(pointer));
    return pointer;
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
    if (pointer != NULL)
        atomic_fetch_sub(&held, (int64_t)malloc_usable_size(pointer));
    free(pointer);
}

static void fail(int64_t n, int64_t count) {
    atomic_store(&fail_count, count);
    atomic_store(&fail_countdown, n < 0 ? NONE_FAILS : n);
}

void memory_fail_after(int64_t n) {
    fail(n, 1);
}

void memory_fail_from(int64_t n) {
    fail(n, INT64_MAX);
}
