/* SPDX-License-Identifier: GPL-3.0-or-later
 * What all parts of one camera sample share. */
#ifndef AMB_CAMERA_WALKER_H
#define AMB_CAMERA_WALKER_H

#include "base/rng.h"
#include "camera/camera_path.h"

/* Branches with less throughput survive by chance in proportion: unbiased. */
#define WALKER_ROULETTE_THROUGHPUT 0.01f

/* The same for gathers from the light field, which cost what many rays do: what is gathered along
 * later branches is little beside what the first ones gather. */
#define WALKER_GATHER_THROUGHPUT 0.05f

/* A gather that is left for later. */
typedef struct WaitingGather {
    FieldSegment segment;
    CameraWay way;
    Rgb throughput, forward; /* see Branch */
    bool is_there;
} WaitingGather;

typedef struct Walker {
    const AmbScene *scene;
    const Field *field; /* NULL: no lamp's light scatters */
    const CameraParams *params;
    Rng rng;
    uint32_t dimension; /* next unused random number */
    CameraSample *out;
    const CameraObserver *observer; /* NULL: what is seen is summed up in out */
    CameraWay way;                  /* of a walk's beginning */
    uint32_t scattered;     /* how often the walk did whose end is an opaque surface; 0: none did */
    uint32_t part;          /* of the light field, as FieldSegment's */
    WaitingGather *waiting; /* room for one, that it may be made with others; or NULL */
    LedgerClock clock;
} Walker;

/* Notes which effects radiance along a way owes itself to. */
static inline void sample_note(CameraSample *sample, const CameraWay *way, Rgb radiance) {
    const float mean = rgb_mean(radiance);
    float *parts = sample->parts;
    if ((way->effects & AMB_EFFECT_SURFACE_REFLECTION) != 0)
        parts[CAMERA_PART_REFLECTION] += mean;
    if ((way->effects & AMB_EFFECT_BACKGROUND) != 0)
        parts[CAMERA_PART_BACKGROUND] += mean;
    if (way->bounces > 0)
        parts[CAMERA_PART_BOUNCES] += mean;
    if ((way->effects & AMB_EFFECT_INTERREFLECTION) != 0)
        parts[CAMERA_PART_INTERREFLECTION] += mean;
    if (way->returns)
        parts[CAMERA_PART_RETURN] += mean;
}

static inline void walker_note(Walker *walker, const CameraWay *way, Rgb radiance) {
    sample_note(walker->out, way, radiance);
}

/* Gathers from the light field along a stretch of this throughput. */
FieldRadiance walker_gather(Walker *walker, FieldSegment segment, Rgb throughput);

static inline float walker_random(Walker *walker) {
    return rng_float(walker->rng, walker->dimension++);
}

static inline Sample2 walker_random2(Walker *walker) {
    const float u = walker_random(walker);
    return (Sample2){u, walker_random(walker)};
}

/* Whether to gather for a path of this throughput, and as how much: 0 is never, by chance. */
static inline float walker_gathers(Walker *walker, Rgb throughput) {
    const float strongest = rgb_max(throughput);
    if (!walker->params->gathers_by_chance || strongest >= WALKER_GATHER_THROUGHPUT)
        return 1.0f;
    const float chance = strongest / WALKER_GATHER_THROUGHPUT;
    return walker_random(walker) < chance ? 1.0f / chance : 0.0f;
}

/* For a gather's FieldSegment: reflected light by chance. */
static inline float walker_reflected_excess(Walker *walker) {
    const float chance = walker->params->reflected_chance;
    if (!(chance > 0.0f))
        return 0.0f;
    return walker_random(walker) < chance ? 1.0f / chance - 1.0f : -1.0f;
}

static inline Rgb rgb_madd(Rgb a, Rgb b, Rgb c) {
    return rgb_add(a, rgb_mul(b, c));
}

#endif
