/* SPDX-License-Identifier: GPL-3.0-or-later
 * Random numbers as a pure function of (seed, stage, path, dimension): whichever thread asks, and
 * in whichever order, the answer is the same. */
#ifndef AMB_BASE_RNG_H
#define AMB_BASE_RNG_H

#include <stdint.h>

enum {
    RNG_STAGE_LIGHT = 1,
    RNG_STAGE_CAMERA = 2,
    RNG_STAGE_PROBE = 3,
    RNG_STAGE_PLAN = 4,
    RNG_STAGE_PHOTON = 5,
    RNG_STAGE_PROPAGATOR = 7
};

typedef struct Rng {
    uint64_t key; /* of (seed, stage, path) */
} Rng;

/* Stafford's variant 13 of the 64-bit finaliser of MurmurHash3 (as in SplitMix64). */
static inline uint64_t rng_mix(uint64_t x) {
    x ^= x >> 30;
    x *= 0xbf58476d1ce4e5b9u;
    x ^= x >> 27;
    x *= 0x94d049bb133111ebu;
    x ^= x >> 31;
    return x;
}

static inline Rng rng_create(uint32_t seed, uint32_t stage, uint64_t path) {
    const uint64_t stream = rng_mix(((uint64_t)seed << 32 | stage) + 0x9e3779b97f4a7c15u);
    return (Rng){rng_mix(stream ^ rng_mix(path + 0x9e3779b97f4a7c15u))};
}

/* Uniform in [0, 1), 24 bits. */
static inline float rng_float(Rng rng, uint32_t dimension) {
    const uint64_t bits = rng_mix(rng.key + (dimension + 1u) * 0x9e3779b97f4a7c15u);
    return (float)(bits >> 40) * 0x1p-24f;
}

#endif
