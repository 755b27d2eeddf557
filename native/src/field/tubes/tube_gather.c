/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, eight of them at a time. Built once for each instruction set, with
 * AMB_TUBE_GATHER set to the name of the variant. */
#include "field/tubes/tube_gather.h"

#include <stddef.h>

#include "math/lanes.h"
#include "optics/medium_lanes.h"

#if !defined(AMB_TUBE_GATHER)
#error "AMB_TUBE_GATHER names the variant"
#endif

_Static_assert((int)TUBE_LANES == (int)LANE_COUNT, "a block fills one vector");

enum { STACK_MAX = TUBE_LEVEL_MAX * (LANE_COUNT - 1) + 1 };

/* sin^2 between a light line and the camera ray below which they count as parallel: their meeting
 * point is then known to no digit, and a smaller number would overflow. */
static const float SIN2_MIN = 1e-12f;

typedef struct Lanes3 {
    Lanes x, y, z;
} Lanes3;

/* The camera ray o + t d, near <= t <= far, from the point nearest to the tree's centre: o is then
 * small, and so is what rounding does to distances from it. */
typedef struct Query {
    Vec3 o, d;
    float moment[3]; /* o x d */
    float inverse[3];
    float near, far;
} Query;

typedef struct Sums {
    Lanes radiance[3];
    Lanes frequency;
} Sums;

static inline Lanes3 load3(const float v[3][LANE_COUNT]) {
    return (Lanes3){lanes_load(v[0]), lanes_load(v[1]), lanes_load(v[2])};
}

static inline Lanes3 set3(Vec3 v) {
    return (Lanes3){lanes_set(v.x), lanes_set(v.y), lanes_set(v.z)};
}

static inline Lanes3 sub3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline Lanes3 scale3(Lanes3 a, Lanes s) {
    return (Lanes3){a.x * s, a.y * s, a.z * s};
}

static inline Lanes3 lerp3(Lanes3 a, Lanes3 b, Lanes q) {
    return (Lanes3){a.x + q * (b.x - a.x), a.y + q * (b.y - a.y), a.z + q * (b.z - a.z)};
}

static inline Lanes dot3(Lanes3 a, Lanes3 b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static inline Lanes3 cross3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static inline Lanes abs_lanes(Lanes v) {
    return lanes_max(v, -v);
}

/* Bit i is set where the segment may meet light of child i. */
static inline uint32_t children_hit(const TubeNode *node, const Query *q) {
    const float line[6] = {q->d.x, q->d.y, q->d.z, q->moment[0], q->moment[1], q->moment[2]};
    Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
    for (int a = 0; a < 6; ++a) {
        middle += line[a] * lanes_load(node->middle[a]);
        reach += fabsf(line[a]) * lanes_load(node->extent[a]);
    }
    LaneMask lines = abs_lanes(middle) <= reach;
    if (lanes_bits(lines) == 0)
        return 0;
    LaneMask places = lines ^ lines;
    for (int k = 0; k < TUBE_QUARTERS; ++k) {
        Lanes near = lanes_set(q->near), far = lanes_set(q->far);
        const float o[3] = {q->o.x, q->o.y, q->o.z};
        for (int a = 0; a < 3; ++a) {
            const Lanes t0 = (lanes_load(node->low[k][a]) - o[a]) * q->inverse[a];
            const Lanes t1 = (lanes_load(node->high[k][a]) - o[a]) * q->inverse[a];
            near = lanes_max(near, lanes_min(t0, t1));
            far = lanes_min(far, lanes_max(t0, t1));
        }
        places |= near <= far;
        if (lanes_bits(lines & ~places) == 0)
            break;
    }
    return lanes_bits(lines & places);
}

/* A line x + s w of a tube (w about unit) and the place where it meets the camera ray at
 *   t = along / over, s = depth / over,
 * as seen along n: divisions come last, so that all three stay linear along a chord. */
typedef struct Meeting {
    Lanes3 from, w; /* from = x - o */
    Lanes along, depth, over;
} Meeting;

static inline void meet(Meeting *m, Lanes3 d, Lanes3 n) {
    m->over = dot3(cross3(d, m->w), n);
    m->along = dot3(cross3(m->from, m->w), n);
    m->depth = dot3(cross3(m->from, d), n);
}

/* Restricts [q0, q1] to where a function that is linear on [0, 1] and has values a and b at its
 * ends is positive. */
static inline void clip(Lanes a, Lanes b, Lanes *q0, Lanes *q1) {
    const Lanes zero = lanes_set(0.0f), one = lanes_set(1.0f);
    const LaneMask in_a = a > 0.0f, in_b = b > 0.0f;
    const LaneMask changes = in_a != in_b;
    if (lanes_bits(changes | ~in_a) == 0)
        return; /* inside at both ends, everywhere */
    const Lanes cut = a / lanes_select(changes, a - b, one);
    *q0 = lanes_max(*q0, lanes_select(in_a, zero, lanes_select(in_b, cut, one)));
    *q1 = lanes_min(*q1, lanes_select(in_b, one, lanes_select(in_a, cut, zero)));
}

/* Mean of exp(-sigma_t path) over a stretch of a chord along which path changes by `change`, over
 * its value in the middle: sinh(y)/y, y = sigma_t change / 2. */
static inline Lanes swing(float sigma_t, Lanes change) {
    const Lanes y = (0.5f * sigma_t) * abs_lanes(change);
    const Lanes y2 = y * y;
    const Lanes thin = 1.0f + y2 * (1.0f / 6.0f + y2 * (1.0f / 120.0f + y2 * (1.0f / 5040.0f)));
    const LaneMask is_thick = y > 1.0f;
    if (lanes_bits(is_thick) == 0)
        return thin;
    /* exp(y) = 1/exp(-y); beyond y = 40 nothing is left of the light in the middle. */
    const Lanes fade = lanes_exp_negative(-lanes_min(y, lanes_set(40.0f)));
    const Lanes thick = 0.5f * (1.0f / fade - fade) / lanes_max(y, lanes_set(1.0f));
    return lanes_select(is_thick, thick, thin);
}

/* Tubes that the zero curve crosses, waiting for others: a block has about three, and vectors are
 * best full. Rows are those of TubeBlock, then f at the corners. Enough of them wait that what is
 * taken out has long been written. */
enum {
    BLOCK_ROWS = sizeof(TubeBlock) / (TUBE_LANES * sizeof(float)),
    ROWS = BLOCK_ROWS + 3,
    QUEUE_FULL = 4 * LANE_COUNT,
    QUEUE_ROOM = QUEUE_FULL + LANE_COUNT
};
typedef struct Queue {
    float rows[ROWS][QUEUE_ROOM];
    uint32_t count;
} Queue;

enum { /* rows of members of TubeBlock */
       ROW_X = offsetof(TubeBlock, x) / (TUBE_LANES * sizeof(float)),
       ROW_W = offsetof(TubeBlock, w) / (TUBE_LANES * sizeof(float)),
       ROW_LIMIT = offsetof(TubeBlock, limit) / (TUBE_LANES * sizeof(float)),
       ROW_FLUX = offsetof(TubeBlock, flux) / (TUBE_LANES * sizeof(float)),
       ROW_COLOR = offsetof(TubeBlock, color) / (TUBE_LANES * sizeof(float)),
       ROW_SPREAD = offsetof(TubeBlock, spread) / (TUBE_LANES * sizeof(float)),
       ROW_F = BLOCK_ROWS
};

/* Eight tubes of the queue. */
typedef struct Batch {
    const Queue *queue;
    uint32_t first;
} Batch;

static inline Lanes row(const Batch *batch, int r) {
    return lanes_load(batch->queue->rows[r] + batch->first);
}

/* Sum of a member's values at the corners with weights. */
static inline Lanes mix(const Batch *batch, int r, const Lanes weight[3]) {
    return weight[0] * row(batch, r) + weight[1] * row(batch, r + 1) +
           weight[2] * row(batch, r + 2);
}

static inline Lanes3 mix3(const Batch *batch, int r, const Lanes weight[3]) {
    Lanes out[3];
    for (int a = 0; a < 3; ++a)
        out[a] = weight[0] * row(batch, r + a) + weight[1] * row(batch, r + 3 + a) +
                 weight[2] * row(batch, r + 6 + a);
    return (Lanes3){out[0], out[1], out[2]};
}

/* Adds the tubes of a block that the zero curve crosses to the queue. */
static inline void find_crossings(const TubeBlock *block, const Query *q, Queue *queue) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
    Lanes f[3];
    LaneMask is_positive[3];
    for (int k = 0; k < 3; ++k) {
        const Lanes3 from = sub3(load3(block->x[k]), o);
        Lanes3 w = load3(block->w[k]);
        /* w x d = (w - d) x d = (w + d) x d: with the smaller of the two, directions that are
         * nearly parallel keep their digits. */
        const Lanes side = lanes_select(dot3(w, d) < 0.0f, lanes_set(-1.0f), lanes_set(1.0f));
        w = sub3(w, scale3(d, side));
        f[k] = dot3(from, cross3(w, d));
        is_positive[k] = f[k] > 0.0f;
    }
    const uint32_t bits =
        lanes_bits((is_positive[0] != is_positive[1]) | (is_positive[0] != is_positive[2]));
    if (bits == 0)
        return;
    const LanePack pack = lanes_pack_for(bits);
    const float(*rows)[LANE_COUNT] = (const float(*)[LANE_COUNT])block;
    float *out = queue->rows[0] + queue->count;
    for (int r = 0; r < BLOCK_ROWS; ++r)
        lanes_pack(out + r * QUEUE_ROOM, lanes_load(rows[r]), &pack);
    for (int k = 0; k < 3; ++k)
        lanes_pack(out + (ROW_F + k) * QUEUE_ROOM, f[k], &pack);
    queue->count += (uint32_t)__builtin_popcount(bits);
}

/* Adds what the tubes of a batch send along the segment. A lane whose f does not change its sign
 * counts for nothing. */
static inline void gather_batch(const Batch *batch, const Medium *medium, const Query *q,
                                Sums *sums) {
    const Lanes zero = lanes_set(0.0f), one = lanes_set(1.0f);
    const Lanes3 d = set3(q->d), o = set3(q->o);
    const Lanes f[3] = {row(batch, ROW_F), row(batch, ROW_F + 1), row(batch, ROW_F + 2)};
    const LaneMask is_positive[3] = {f[0] > 0.0f, f[1] > 0.0f, f[2] > 0.0f};
    /* The corner whose sign differs. */
    const LaneMask odd[3] = {
        (is_positive[0] != is_positive[1]) & (is_positive[0] != is_positive[2]),
        (is_positive[1] != is_positive[2]) & (is_positive[1] != is_positive[0]),
        (is_positive[2] != is_positive[0]) & (is_positive[2] != is_positive[1])};
    LaneMask is_hit = odd[0] | odd[1] | odd[2];
    Lanes ahead[3]; /* f of the odd corner and of the two after it */
    for (int k = 0; k < 3; ++k)
        ahead[k] = lanes_select(odd[0], f[k], lanes_select(odd[1], f[(k + 1) % 3], f[(k + 2) % 3]));
    const Lanes gap_b = lanes_select(is_hit, ahead[0] - ahead[1], one);
    const Lanes gap_c = lanes_select(is_hit, ahead[0] - ahead[2], one);
    const Lanes cut_b = ahead[0] / gap_b, cut_c = ahead[0] / gap_c;
    const Lanes density = 2.0f * cut_b / abs_lanes(gap_c);

    /* Where the zero curve enters the triangle and where it leaves, in barycentric weights. */
    Lanes weight_b[3], weight_c[3];
    for (int k = 0; k < 3; ++k) {
        const int before = (k + 2) % 3, after = (k + 1) % 3;
        weight_b[k] = lanes_select(odd[k], 1.0f - cut_b, lanes_select(odd[before], cut_b, zero));
        weight_c[k] = lanes_select(odd[k], 1.0f - cut_c, lanes_select(odd[after], cut_c, zero));
    }
    Meeting b = {.from = sub3(mix3(batch, ROW_X, weight_b), o), .w = mix3(batch, ROW_W, weight_b)};
    Meeting c = {.from = sub3(mix3(batch, ROW_X, weight_c), o), .w = mix3(batch, ROW_W, weight_c)};
    Lanes3 n = cross3(d, lerp3(b.w, c.w, lanes_set(0.5f)));
    meet(&b, d, n);
    meet(&c, d, n);

    /* The part of the chord that lies on the segment and in front of the light's end. */
    Lanes q0 = zero, q1 = one;
    clip(b.along - q->near * b.over, c.along - q->near * c.over, &q0, &q1);
    clip(q->far * b.over - b.along, q->far * c.over - c.along, &q0, &q1);
    clip(b.depth, c.depth, &q0, &q1);
    clip(mix(batch, ROW_LIMIT, weight_b) * b.over - b.depth,
         mix(batch, ROW_LIMIT, weight_c) * c.over - c.depth, &q0, &q1);
    is_hit &= (q1 > q0) & (b.over > 0.0f) & (c.over > 0.0f);
    if (lanes_bits(is_hit) == 0)
        return;

    /* Everything else in the middle of that part. */
    const Lanes half = lanes_set(0.5f);
    const Lanes qm = half * (q0 + q1);
    Meeting m = {.from = lerp3(b.from, c.from, qm), .w = lerp3(b.w, c.w, qm)};
    n = cross3(d, m.w);
    meet(&m, d, n);
    const Lanes inverse = 1.0f / lanes_max(m.over, lanes_set(SIN2_MIN));
    const Lanes unit2 = dot3(m.w, m.w);
    const Lanes unit = lanes_sqrt(unit2);
    const Lanes t = lanes_max(m.along * inverse - q->near, zero);
    const Lanes s = lanes_max(m.depth * inverse, zero) * unit;
    /* The path's change along it, from the ends. */
    const Lanes path_b = b.along + b.depth, path_c = c.along + c.depth;
    const Lanes over0 = b.over + q0 * (c.over - b.over), over1 = b.over + q1 * (c.over - b.over);
    const Lanes change =
        (path_b + q1 * (path_c - path_b)) / over1 - (path_b + q0 * (path_c - path_b)) / over0;

    Lanes scatter[3];
    const Lanes sin2 = m.over / unit2;
    medium_scattering_lanes(medium, dot3(m.w, d) / unit, sin2, scatter);
    Lanes weight[3];
    for (int k = 0; k < 3; ++k)
        weight[k] = weight_b[k] + qm * (weight_c[k] - weight_b[k]);
    const Lanes value = mix(batch, ROW_FLUX, weight) * density * (q1 - q0);
    const float sigma_t[3] = {medium->sigma_t.r, medium->sigma_t.g, medium->sigma_t.b};
    Lanes total = zero;
    for (int k = 0; k < 3; ++k) {
        const Lanes fade = lanes_exp_negative(-sigma_t[k] * (s + t)) * swing(sigma_t[k], change);
        const Lanes light =
            lanes_select(is_hit, value * row(batch, ROW_COLOR + k) * scatter[k] * fade, zero);
        sums->radiance[k] += light;
        total += light;
    }
    const Lanes area =
        abs_lanes(1.0f + s * (row(batch, ROW_SPREAD) + s * row(batch, ROW_SPREAD + 1)));
    sums->frequency += lanes_select(is_hit, total / (1.0f + area), zero);
}

/* Takes tubes from the end of the queue until fewer than `rest` are left. */
static inline void empty_queue(Queue *queue, uint32_t rest, const Medium *medium, const Query *q,
                               Sums *sums) {
    while (queue->count >= rest) {
        const uint32_t taken = queue->count < LANE_COUNT ? queue->count : LANE_COUNT;
        queue->count -= taken;
        if (taken < LANE_COUNT)
            for (int r = 0; r < ROWS; ++r)
                memset(queue->rows[r] + taken, 0, (LANE_COUNT - taken) * sizeof(float));
        const Batch batch = {queue, queue->count};
        gather_batch(&batch, medium, q, sums);
    }
}

FieldRadiance AMB_TUBE_GATHER(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                              float length) {
    const Vec3 from = vec3_sub(o, tree->center);
    Query q = {.d = d, .near = vec3_dot(from, d)};
    q.far = q.near + length;
    q.o = vec3_madd(from, -q.near, d);
    const Vec3 moment = vec3_cross(q.o, d);
    const float axes[3] = {d.x, d.y, d.z};
    for (int a = 0; a < 3; ++a) {
        /* 0 * infinity is not a number: a direction without this component gets a huge slope. */
        const float component = fabsf(axes[a]) < 1e-20f ? copysignf(1e-20f, axes[a]) : axes[a];
        q.inverse[a] = 1.0f / component;
    }
    q.moment[0] = moment.x;
    q.moment[1] = moment.y;
    q.moment[2] = moment.z;

    const Lanes zero = lanes_set(0.0f);
    Sums sums = {{zero, zero, zero}, zero};
    struct {
        uint32_t level, index;
    } stack[STACK_MAX];
    int depth = 0;
    Queue queue;
    queue.count = 0;
    stack[depth].level = tree->level_count - 1;
    stack[depth++].index = 0;
    while (depth > 0) {
        --depth;
        const uint32_t level = stack[depth].level, index = stack[depth].index;
        uint32_t mask = children_hit(&tree->nodes[tree->first[level] + index], &q);
        while (mask != 0) {
            const uint32_t child = index * LANE_COUNT + (uint32_t)__builtin_ctz(mask);
            mask &= mask - 1;
            if (level == 0) {
                find_crossings(&tree->blocks[child], &q, &queue);
                if (queue.count >= QUEUE_FULL)
                    empty_queue(&queue, LANE_COUNT, medium, &q, &sums);
            } else {
                stack[depth].level = level - 1;
                stack[depth++].index = child;
            }
        }
    }
    empty_queue(&queue, 1, medium, &q, &sums);
    FieldRadiance out;
    out.radiance =
        rgb(lanes_sum(sums.radiance[0]), lanes_sum(sums.radiance[1]), lanes_sum(sums.radiance[2]));
    out.frequency = lanes_sum(sums.frequency) / 3.0f;
    out.contribution = rgb_mean(out.radiance);
    return out;
}
