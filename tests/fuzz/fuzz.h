/* SPDX-License-Identifier: GPL-3.0-or-later
 * Fuzzing: targets that take any string of bytes, and what they read it with. The same targets run
 * under libFuzzer (fuzz_entry.c) and alone (fuzz_main.c). */
#ifndef AMB_TESTS_FUZZ_H
#define AMB_TESTS_FUZZ_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/rng.h"

/* Bytes from the front; when they have run out, others that depend on their number and the last. */
typedef struct Bytes {
    const uint8_t *data;
    size_t size, at;
} Bytes;

static inline uint8_t bytes_u8(Bytes *bytes) {
    const size_t at = bytes->at++;
    if (at < bytes->size)
        return bytes->data[at];
    const uint64_t last = bytes->size > 0 ? bytes->data[bytes->size - 1] : 0;
    return (uint8_t)(rng_mix(256 * (uint64_t)bytes->size + last + rng_mix(at)) >> 32);
}

static inline uint32_t bytes_u32(Bytes *bytes) {
    uint32_t value = 0;
    for (int i = 0; i < 4; ++i)
        value |= (uint32_t)bytes_u8(bytes) << (8 * i);
    return value;
}

/* 0 .. count-1 */
static inline uint32_t bytes_below(Bytes *bytes, uint32_t count) {
    return bytes_u8(bytes) % count;
}

/* Uniform in [low, high], 65536 values. */
static inline double bytes_uniform(Bytes *bytes, double low, double high) {
    const uint32_t bits = bytes_u8(bytes) | (uint32_t)bytes_u8(bytes) << 8;
    return low + (high - low) * (double)bits / 65535.0;
}

/* In [10^low, 10^high], even in the exponent. */
static inline double bytes_log(Bytes *bytes, double low, double high) {
    return pow(10.0, bytes_uniform(bytes, low, high));
}

/* Ends the process unless the condition holds, and says what was not true: what fuzzers notice. */
#define FUZZ_HOLDS(condition, ...)                                                                 \
    do {                                                                                           \
        if (!(condition))                                                                          \
            fuzz_fail(__FILE__, __LINE__, __VA_ARGS__);                                            \
    } while (0)
_Noreturn void fuzz_fail(const char *file, int line, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

typedef void FuzzTarget(const uint8_t *data, size_t size);

/* A sequence of calls of the public interface, valid or not, and a small picture. */
FuzzTarget fuzz_scene;
FuzzTarget
    fuzz_small; /* the same with fewer samples and pixels, for fuzzers that learn by the run */
void fuzz_scene_report(void); /* what it has come to so far */
unsigned long long fuzz_scene_pictures(void);
/* Operators of optics/, each with what must be true of its result. */
FuzzTarget fuzz_dielectric, fuzz_tangent, fuzz_covariance, fuzz_kernel, fuzz_phase, fuzz_boundary;

#endif
