/* SPDX-License-Identifier: GPL-3.0-or-later
 * Memory with checked sizes, cache-line alignment, a limit, and a way for tests to make it fail. */
#ifndef AMB_BASE_MEMORY_H
#define AMB_BASE_MEMORY_H

#include <stdatomic.h>
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

/* What a render may take: the library's total in this process, by all renders and scenes, stays
 * below. */
typedef struct MemoryLimit {
    uint64_t bytes;
    atomic_uint_least64_t
        refused; /* the total that the last refused request would have made, or 0 */
} MemoryLimit;

/* From now on allocations of this thread, and of loops that it starts, keep to the limit; NULL:
 * to none. It must outlive them. */
void memory_set_limit(MemoryLimit *limit);
MemoryLimit *memory_get_limit(void);

/* Bytes that another library takes for us, or if negative gives back; false: too many. */
bool memory_reserve(MemoryLimit *limit, int64_t bytes);

uint64_t memory_held(void);       /* bytes, at present, of the whole process */
uint64_t memory_of_machine(void); /* bytes */

/* Counts one allocation that another library makes for us, and whether it has to fail. */
bool memory_must_fail(void);

/* Tests: what memory_of_machine says from now on; 0: the truth. */
void memory_pretend_machine(uint64_t bytes);

/* Tests: the n-th allocation from now on (0 = the next) fails, once; negative: none does. */
void memory_fail_after(int64_t n);
/* The same for the n-th and all that follow. */
void memory_fail_from(int64_t n);

#endif
