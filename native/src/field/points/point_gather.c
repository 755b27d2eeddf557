/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the point estimators, eight samples at a time. Built once for each
 * instruction set, with AMB_POINT_GATHER set to the name of the variant. */
#include "field/points/point_gather.h"

#include "field/straight_lanes.h"
#include "math/lanes3.h"
#include "optics/medium_lanes.h"

#if !defined(AMB_POINT_GATHER)
#error "AMB_POINT_GATHER names the variant"
#endif

_Static_assert((int)POINT_LANES == (int)LANE_COUNT, "a block fills one vector");

/* Depth of the tree over 2^28 blocks is 10 nodes, each leaves at most 7 siblings waiting. */
enum { STACK_MAX = 128 };

/* sin^2 below which a ray and a sample count as parallel: the chord is then as long as the sample
 * anyway, and dividing by less would overflow. */
static const float SIN2_MIN = 1e-12f;

typedef struct Query {
    float o[3], d[3];
    float inverse[3];
    float length;
    float straight[3];
    bool has_straight;
} Query;

typedef struct Sums {
    Lanes radiance[3], reflected[3], passed[3];
    Lanes straight_once[3], straight_more[3];
    Lanes frequency;
    PointCount *met; /* or NULL */
} Sums;

static inline Lanes3 load3(const float v[3][LANE_COUNT]) {
    return (Lanes3){lanes_load(v[0]), lanes_load(v[1]), lanes_load(v[2])};
}

/* Bit i is set where child i's box meets the segment. */
static inline uint32_t boxes_hit(const PointNode *node, const Query *q) {
    Lanes near = lanes_set(0.0f), far = lanes_set(q->length);
    for (int a = 0; a < 3; ++a) {
        const Lanes t0 = (lanes_load(node->low[a]) - q->o[a]) * q->inverse[a];
        const Lanes t1 = (lanes_load(node->high[a]) - q->o[a]) * q->inverse[a];
        near = lanes_max(near, lanes_min(t0, t1));
        far = lanes_min(far, lanes_max(t0, t1));
    }
    return lanes_bits(near <= far);
}

/* Epanechnikov kernel K = 2/(pi R^4) (R^2 - r^2) along a chord: R^2 - r^2 = a + b u + c u^2 for u
 * in [-1, 1]. */
typedef struct Kernel {
    Lanes a, b, c;
} Kernel;

/* Integral over u of K(u) exp(-sigma_t path(u)), path linear from path0 to path1 >= path0:
 * with x = sigma_t (path1 - path0) / 2 and E(u) = exp(-sigma_t path(u)),
 *   I0 = int E = (E0 - E1)/x,  I1 = int u E = (I0 - E0 - E1)/x,  I2 = int u^2 E = (E0 - E1 + 2
 * I1)/x and their series about x = 0 (to 3e-6 at x = 1/2) where those would cancel. */
static inline Lanes attenuated(const Kernel *kernel, float sigma_t, Lanes path0, Lanes path1) {
    const Lanes x = (0.5f * sigma_t) * (path1 - path0);
    const Lanes y = x * x;
    const Lanes middle = lanes_exp_negative((-0.5f * sigma_t) * (path0 + path1));
    const Lanes i0 = 2.0f + y * (1.0f / 3.0f + y * (1.0f / 60.0f));
    const Lanes i1 = -x * (2.0f / 3.0f + y * (1.0f / 15.0f + y * (1.0f / 420.0f)));
    const Lanes i2 = 2.0f / 3.0f + y * (0.2f + y * (1.0f / 84.0f));
    const Lanes thin = middle * (kernel->a * i0 + kernel->b * i1 + kernel->c * i2);
    const LaneMask is_thick = x > 0.5f;
    if (lanes_bits(is_thick) == 0)
        return thin;
    const Lanes e0 = lanes_exp_negative(-sigma_t * path0);
    const Lanes e1 = lanes_exp_negative(-sigma_t * path1);
    const Lanes inverse = 1.0f / lanes_max(x, lanes_set(0.5f));
    const Lanes t0 = (e0 - e1) * inverse;
    const Lanes t1 = (t0 - (e0 + e1)) * inverse;
    const Lanes t2 = (e0 - e1 + 2.0f * t1) * inverse;
    return lanes_select(is_thick, kernel->a * t0 + kernel->b * t1 + kernel->c * t2, thin);
}

/* The part of a segment inside the cylinder of a sample, by tau = t - start. */
typedef struct Chord {
    Lanes begin, end;
    Lanes start, above;    /* t and s where tau = 0 */
    Lanes inside, B, sin2; /* R^2 - r^2 = inside - 2 B tau - sin2 tau^2 */
    Lanes c;               /* s = above + c tau */
} Chord;

/* Adds the integral along a chord on one side of s = 0. */
static inline void gather_chord(const Chord *chord, const Medium *medium, const Query *q,
                                const Lanes scale[3], Lanes radiance[3], Sums *sums) {
    const Lanes half = 0.5f * (chord->end - chord->begin);
    const Lanes middle = 0.5f * (chord->end + chord->begin);
    /* R^2 - r^2 by u = (tau - middle) / half. */
    const Kernel kernel = {chord->inside - middle * (2.0f * chord->B + middle * chord->sin2),
                           -2.0f * half * (chord->B + middle * chord->sin2),
                           -half * half * chord->sin2};
    /* From the sample's origin over the point back to the segment's start. */
    const Lanes zero = lanes_set(0.0f);
    const Lanes s0 = lanes_max(chord->above + chord->c * chord->begin, zero);
    const Lanes s1 = lanes_max(chord->above + chord->c * chord->end, zero);
    const Lanes path0 = chord->start + chord->begin + s0;
    const Lanes path1 = chord->start + chord->end + s1;
    const float sigma_t[3] = {medium->sigma_t.r, medium->sigma_t.g, medium->sigma_t.b};
    for (int a = 0; a < 3; ++a) {
        const Lanes arrives = half * scale[a] * attenuated(&kernel, sigma_t[a], path0, path1);
        radiance[a] += arrives;
        if (q->has_straight) {
            const StraightStretch stretch = {chord->start + chord->begin, chord->end - chord->begin,
                                             lanes_set(0.0f), sigma_t[a] * (path1 - path0)};
            straight_along(&stretch, q->straight[a], arrives, &sums->straight_once[a],
                           &sums->straight_more[a]);
        }
    }
}

static inline LaneMask lanes_of(uint32_t bits) {
    const LaneMask lanes = {1, 2, 4, 8, 16, 32, 64, 128};
    return (lanes & (int32_t)bits) != 0;
}

static inline void add_lanes(Lanes sums[3], const Lanes radiance[3], uint32_t bits) {
    const LaneMask mask = lanes_of(bits);
    for (int a = 0; a < 3; ++a)
        sums[a] += (Lanes)((LaneMask)radiance[a] & mask);
}

/* Adds what the samples of a block send, those that are hit. */
static inline void add_block(const PointBlock *block, const Lanes radiance[3], uint32_t hit,
                             Sums *sums) {
    for (int a = 0; a < 3; ++a)
        sums->radiance[a] += radiance[a];
    sums->frequency += (radiance[0] + radiance[1] + radiance[2]) * lanes_load(block->frequency);
    if ((hit & block->reflected) != 0)
        add_lanes(sums->reflected, radiance, block->reflected);
    if ((hit & block->passed) != 0)
        add_lanes(sums->passed, radiance, block->passed);
    if (sums->met == NULL)
        return;
    sums->met->all += (uint64_t)__builtin_popcount(hit);
    sums->met->passed += (uint64_t)__builtin_popcount(hit & block->passed);
    sums->met->reflected +=
        (uint64_t)__builtin_popcount(hit & block->reflected & ~(uint32_t)block->passed);
}

/* Adds what the samples of a block send along the segment. */
static inline void gather_block(const PointBlock *block, const Medium *medium, const Query *q,
                                Sums *sums) {
    const Lanes3 w = load3(block->direction);
    const Lanes3 d = {lanes_set(q->d[0]), lanes_set(q->d[1]), lanes_set(q->d[2])};
    const Lanes3 delta = {q->o[0] - lanes_load(block->origin[0]),
                          q->o[1] - lanes_load(block->origin[1]),
                          q->o[2] - lanes_load(block->origin[2])};
    const Lanes radius2 = lanes_load(block->radius2);
    /* Distance of the two lines is |delta . m| / |m| with m = d x w: no cancellation however far
     * the segment starts. */
    const Lanes3 m = {d.y * w.z - d.z * w.y, d.z * w.x - d.x * w.z, d.x * w.y - d.y * w.x};
    const Lanes sin2 = lanes_max(dot3(m, m), lanes_set(SIN2_MIN));
    const Lanes side = dot3(delta, m);
    if (lanes_bits(side * side < radius2 * sin2) == 0)
        return;

    /* Range of t between the end caps and inside the segment; s(t) = along + c t. */
    const Lanes c = dot3(d, w);
    const Lanes along = dot3(delta, w);
    const Lanes zero = lanes_set(0.0f);
    const Lanes steep =
        lanes_select(c < 0.0f, lanes_min(c, lanes_set(-1e-12f)), lanes_max(c, lanes_set(1e-12f)));
    const Lanes inverse_c = 1.0f / steep;
    const Lanes cap0 = (lanes_load(block->low) - along) * inverse_c;
    const Lanes cap1 = (lanes_load(block->high) - along) * inverse_c;
    const Lanes first = lanes_max(zero, lanes_min(cap0, cap1));
    const Lanes last = lanes_min(lanes_set(q->length), lanes_max(cap0, cap1));

    /* From the point of that range that is nearest to the axis (exactly or nearly), squared
     * distance is C + 2 B tau + sin2 tau^2 with small numbers only. */
    const Lanes inverse_sin2 = 1.0f / sin2;
    const Lanes closest = (along * c - dot3(delta, d)) * inverse_sin2;
    const Lanes start = lanes_max(first, lanes_min(last, closest));
    const Lanes3 e = {delta.x + start * d.x, delta.y + start * d.y, delta.z + start * d.z};
    const Lanes s = dot3(e, w);
    const Lanes3 b = {e.x - s * w.x, e.y - s * w.y, e.z - s * w.z};
    /* b is perpendicular to w up to rounding, which grows with s: take d's part across w only. */
    const Lanes3 across = {d.x - c * w.x, d.y - c * w.y, d.z - c * w.z};
    const Lanes B = dot3(b, across);
    const Lanes inside = radius2 - dot3(b, b);
    const Lanes discriminant = B * B + sin2 * inside;
    const Lanes root = lanes_sqrt(lanes_max(discriminant, zero));
    const Lanes begin = lanes_max((-B - root) * inverse_sin2, first - start);
    const Lanes end = lanes_min((root - B) * inverse_sin2, last - start);
    const LaneMask is_hit = (discriminant > 0.0f) & (end > begin);
    if (lanes_bits(is_hit) == 0)
        return;
    /* A lane that misses gets a chord of no length: its huge or undefined numbers must not meet a
     * zero later, infinity * 0 is not 0. */
    Chord chord = {.begin = lanes_select(is_hit, begin, zero),
                   .end = lanes_select(is_hit, end, zero),
                   .start = lanes_select(is_hit, start, zero),
                   .above = lanes_select(is_hit, s, zero),
                   .inside = lanes_select(is_hit, inside, zero),
                   .B = lanes_select(is_hit, B, zero),
                   .sin2 = sin2,
                   .c = c};
    Lanes scatter[3];
    medium_scattering_lanes(medium, c, sin2, scatter);
    for (int a = 0; a < 3; ++a)
        scatter[a] *= lanes_load(block->normalization) * lanes_load(block->flux[a]);

    /* What a kernel adds before the ray's entry, at s < 0 (see points.c), has travelled no
     * distance yet: a chord that crosses s = 0 has a kink there and is taken in two parts. */
    const LaneMask is_entry =
        (chord.above + c * chord.begin < 0.0f) != (chord.above + c * chord.end < 0.0f);
    const Lanes entry = lanes_select(is_entry, -chord.above / steep, chord.end);
    const Lanes end_of_all = chord.end;
    chord.end = lanes_max(chord.begin, lanes_min(entry, end_of_all));
    Lanes radiance[3] = {zero, zero, zero};
    gather_chord(&chord, medium, q, scatter, radiance, sums);
    if (lanes_bits(is_entry) != 0) {
        chord.begin = chord.end;
        chord.end = end_of_all;
        gather_chord(&chord, medium, q, scatter, radiance, sums);
    }
    add_block(block, radiance, lanes_bits(is_hit), sums);
}

enum { CACHE_LINE = 64 };

/* A field is larger than any cache, and what a segment meets lies all over it: waiting for memory
 * is most of a gather, unless several waits go on at once. */
static inline void prefetch_child(const PointTree *tree, int32_t child) {
    const char *begin =
        child < 0 ? (const char *)&tree->blocks[~child] : (const char *)&tree->nodes[child];
    const size_t size = child < 0 ? sizeof(PointBlock) : sizeof(PointNode);
    for (size_t at = 0; at < size; at += CACHE_LINE)
        __builtin_prefetch(begin + at);
}

static inline Rgb sum_lanes(const Lanes sums[3]) {
    return rgb(lanes_sum(sums[0]), lanes_sum(sums[1]), lanes_sum(sums[2]));
}

FieldRadiance AMB_POINT_GATHER(const PointTree *tree, const Medium *medium,
                               const FieldSegment *segment, PointCount *met) {
    const Vec3 o = segment->o, d = segment->d;
    const Rgb straight = segment->straight;
    Query q = {.o = {o.x, o.y, o.z},
               .d = {d.x, d.y, d.z},
               .length = segment->length,
               .straight = {straight.r, straight.g, straight.b},
               .has_straight = rgb_max(straight) > 0.0f};
    for (int a = 0; a < 3; ++a) {
        /* 0 * infinity is not a number: a direction without this component gets a huge slope. */
        const float component = fabsf(q.d[a]) < 1e-20f ? copysignf(1e-20f, q.d[a]) : q.d[a];
        q.inverse[a] = 1.0f / component;
    }
    const Lanes zero = lanes_set(0.0f);
    Sums sums = {.radiance = {zero, zero, zero},
                 .reflected = {zero, zero, zero},
                 .passed = {zero, zero, zero},
                 .straight_once = {zero, zero, zero},
                 .straight_more = {zero, zero, zero},
                 .frequency = zero,
                 .met = met};
    int32_t stack[STACK_MAX];
    int depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const PointNode *node = &tree->nodes[stack[--depth]];
        uint32_t mask = boxes_hit(node, &q);
        for (uint32_t rest = mask; rest != 0; rest &= rest - 1)
            prefetch_child(tree, node->child[__builtin_ctz(rest)]);
        while (mask != 0) {
            const int i = __builtin_ctz(mask);
            mask &= mask - 1;
            if (node->child[i] < 0)
                gather_block(&tree->blocks[~node->child[i]], medium, &q, &sums);
            else if (node->child[i] > 0) /* 0: an unused lane, which a ray of odd numbers may hit */
                stack[depth++] = node->child[i];
        }
    }
    FieldRadiance out;
    out.radiance = sum_lanes(sums.radiance);
    out.reflected = sum_lanes(sums.reflected);
    out.passed = sum_lanes(sums.passed);
    out.straight_once = sum_lanes(sums.straight_once);
    out.straight_more = sum_lanes(sums.straight_more);
    out.frequency = lanes_sum(sums.frequency) / 3.0f;
    out.contribution = rgb_mean(out.radiance);
    return out;
}
