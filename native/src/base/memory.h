/* SPDX-License-Identifier: GPL-3.0-or-later
 * Memory with checked sizes, cache-line alignment, and a way for tests to make it fail. */
#ifndef AMB_BASE_MEMORY_H
#define AMB_BASE_MEMORY_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* Uninitialised array of count * size bytes, aligned to 64; NULL if the product overflows or
 * memory is exhausted. count 0 gives a valid pointer. Free with memory_free. Any thread. */
void *memory_alloc_array(uint64_t count, uint64_t size);

/* The same, zeroed. */
void *memory_zero_array(uint64_t count, uint64_t size);

/* Copy of count * size bytes, or NULL. data may be NULL when count is 0. */
void *memory_copy_array(const void *data, uint64_t count, uint64_t size);

/* Zero-terminated copy of text ("" for NULL), or NULL. */
char *memory_copy_text(const char *text);

void memory_free(void *pointer);

/* Counts one allocation that another library makes for us, and whether it has to fail. */
bool memory_must_fail(void);

/* Tests: the n-th allocation from now on (0 = the next) and those after it, `count` in all, fail;
 * n negative: none does. */
void memory_fail_after(int64_t n, int64_t count);

#endif
