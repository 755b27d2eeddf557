/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, eight of them at a time, sixteen with AVX-512. Built once for each
 * instruction set, with AMB_TUBE_GATHER set to the name of the variant. */
#include "field/tubes/tube_gather.h"

#include <stddef.h>

#include "math/lanes.h"
#include "optics/medium_lanes.h"

#if !defined(AMB_TUBE_GATHER)
#error "AMB_TUBE_GATHER names the variant"
#endif

enum {
    NODES = LANE_COUNT / TUBE_LANES, /* looked at together */
    HALVES = PATCH_CORNERS / LANE_COUNT,
    /* Of each level wait, at most, the children of as many nodes as were looked at together. */
    STACK_MAX = (TUBE_LEVEL_MAX + 1) * NODES * TUBE_LANES
};

_Static_assert((int)TUBE_LANES == 8, "numbers of children are stored by eight");
_Static_assert((int)PATCH_CORNERS == 16, "lookups choose among sixteen");
_Static_assert((int)PATCH_TUBES == 16, "and so do lists of tubes");

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
    bool has_frequency;
} Query;

typedef struct Sums {
    Lanes radiance[3];
    Lanes frequency;
} Sums;

static inline Lanes3 set3(Vec3 v) {
    return (Lanes3){lanes_set(v.x), lanes_set(v.y), lanes_set(v.z)};
}

static inline Lanes3 sub3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.x - b.x, a.y - b.y, a.z - b.z};
}

static inline Lanes3 scale3(Lanes3 a, Lanes s) {
    return (Lanes3){a.x * s, a.y * s, a.z * s};
}

static inline Lanes3 add3(Lanes3 a, Lanes3 b) {
    return (Lanes3){a.x + b.x, a.y + b.y, a.z + b.z};
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

/* Not a number for the zero vector. */
static inline Lanes3 normalize3(Lanes3 a) {
    return scale3(a, 1.0f / lanes_sqrt(dot3(a, a)));
}

static inline Lanes abs_lanes(Lanes v) {
    return lanes_max(v, -v);
}

/* Children of a node that the line of the ray meets, above which places are looked at, too. */
enum { MANY_LINES = 4 };

/* Bit i is set where the segment may meet light of child i of node a, bit 8 + i of node b. */
static inline uint32_t children_hit(const TubeNode *a, const TubeNode *b, const Query *q) {
    const float line[6] = {q->d.x, q->d.y, q->d.z, q->moment[0], q->moment[1], q->moment[2]};
    Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
    for (int i = 0; i < 6; ++i) {
        middle += line[i] * lanes_load_two(a->middle[i], b->middle[i]);
        reach += fabsf(line[i]) * lanes_load_two(a->extent[i], b->extent[i]);
    }
    LaneMask lines = abs_lanes(middle) <= reach;
    if (lanes_bits(lines) == 0)
        return 0;
    /* Where view and light are not near each other lines alone tell nearly all. */
    if (__builtin_popcount(lanes_bits(lines)) <= NODES * MANY_LINES)
        return lanes_bits(lines);
    LaneMask places = lines ^ lines;
    for (int k = 0; k < TUBE_QUARTERS; ++k) {
        Lanes near = lanes_set(q->near), far = lanes_set(q->far);
        const float o[3] = {q->o.x, q->o.y, q->o.z};
        for (int i = 0; i < 3; ++i) {
            const Lanes low = lanes_load_two(a->low[k][i], b->low[k][i]);
            const Lanes high = lanes_load_two(a->high[k][i], b->high[k][i]);
            const Lanes t0 = (low - o[i]) * q->inverse[i], t1 = (high - o[i]) * q->inverse[i];
            near = lanes_max(near, lanes_min(t0, t1));
            far = lanes_min(far, lanes_max(t0, t1));
        }
        places |= near <= far;
        if (lanes_bits(lines & ~places) == 0)
            break;
    }
    return lanes_bits(lines & places);
}

/* A line from + s w (w about unit, from relative to the camera ray's o) and the place where it
 * meets the ray at
 *   t = along / over, s = depth / over,
 * as seen along n, with turned = n x d: divisions come last, so that all three stay linear along a
 * chord. */
typedef struct Meeting {
    Lanes3 from, w;
    Lanes along, depth, over;
} Meeting;

static inline void meet(Meeting *m, Lanes3 n, Lanes3 turned) {
    m->over = dot3(m->w, turned);
    m->along = dot3(cross3(m->from, m->w), n);
    m->depth = -dot3(m->from, turned);
}

/* Restricts [q0, q1] to where functions that are linear on [0, 1] and have values a and b at its
 * ends are all positive. */
enum { CLIP_COUNT = 4 };
static inline void clip(const Lanes a[CLIP_COUNT], const Lanes b[CLIP_COUNT], Lanes *q0,
                        Lanes *q1) {
    const Lanes zero = lanes_set(0.0f), one = lanes_set(1.0f);
    *q0 = zero;
    *q1 = one;
    Lanes least = lanes_min(a[0], b[0]);
    for (int i = 1; i < CLIP_COUNT; ++i)
        least = lanes_min(least, lanes_min(a[i], b[i]));
    if (lanes_bits(least > 0.0f) == LANES_ALL)
        return; /* inside at both ends, everywhere */
    for (int i = 0; i < CLIP_COUNT; ++i) {
        const LaneMask in_a = a[i] > 0.0f, in_b = b[i] > 0.0f;
        const Lanes cut = a[i] / lanes_select(in_a != in_b, a[i] - b[i], one);
        *q0 = lanes_max(*q0, lanes_select(in_a, zero, lanes_select(in_b, cut, one)));
        *q1 = lanes_min(*q1, lanes_select(in_b, one, lanes_select(in_a, cut, zero)));
    }
}

/* The way of light and view through the medium along a stretch of a chord. */
typedef struct Way {
    Lanes middle, near; /* m, in the middle and at the end where it is shorter */
    Lanes change;       /* m, from one end to the other */
    Lanes ratio;        /* of `over` (see Meeting) at the near end to that at the far one */
} Way;

/* Mean of exp(-sigma_t way) over the stretch. Thin: the value in the middle times sinh(y)/y, y =
 * sigma_t change / 2. Thick: the light is gone in the middle, and what counts is the near end. From
 * there, places on the chord follow the part u of the way as q = r u / (1 - u + r u), r the ratio,
 * since way is a quotient of linear functions; dq/du is taken in the middle of what fades. */
static inline Lanes fade_along(float sigma_t, const Way *way) {
    const Lanes y = (0.5f * sigma_t) * abs_lanes(way->change);
    const Lanes y2 = y * y;
    const Lanes thin = lanes_exp_negative(-sigma_t * way->middle) *
                       (1.0f + y2 * (1.0f / 6.0f + y2 * (1.0f / 120.0f + y2 * (1.0f / 5040.0f))));
    const LaneMask is_thick = y > 1.0f;
    if (lanes_bits(is_thick) == 0)
        return thin;
    const Lanes twice = 2.0f * lanes_max(y, lanes_set(1.0f));
    const Lanes left = lanes_exp_negative(-twice), lost = 1.0f - left;
    const Lanes u = 1.0f / twice - left / lost;
    const Lanes weight = 1.0f - u + u * way->ratio;
    const Lanes thick =
        lanes_exp_negative(-sigma_t * way->near) * lost / twice * way->ratio / (weight * weight);
    return lanes_select(is_thick, thick, thin);
}

/* Eight tubes: what their corners hold, f there, and how often they were quartered. Normals are
 * interpolated before they are made unit, so parts need to know how long they were. */
enum { ROW_START = CORNER_SIZE, ROW_NORMAL_LENGTH, CORNER_ROWS };
typedef struct Tubes {
    Lanes rows[3][CORNER_ROWS];
    Lanes f[3];
    Lanes level;
} Tubes;

/* Tubes wait for others, because vectors are best full. */
enum {
    QUEUE_FULL = 32,
    CROSSED_ROOM = QUEUE_FULL + PATCH_TUBES + LANE_COUNT, /* one patch more, written by vectors */
    /* One patch more, then what quartering adds to each level (see empty_queues), and the next four
     * parts as they are written. */
    LOOSE_ROOM = QUEUE_FULL + PATCH_TUBES + 3 * LANE_COUNT * 10 + 5 * LANE_COUNT
};
/* Rows must not displace each other from the cache. */
_Static_assert(LOOSE_ROOM % 256 != 0, "rows lie a power of two apart");

/* Tubes of patches that the zero curve crosses: their patches, the numbers of their corners there,
 * four bits each, and f at them. */
typedef struct CrossedQueue {
    uint32_t patches[CROSSED_ROOM];
    uint32_t corners[CROSSED_ROOM];
    float f[3][CROSSED_ROOM];
    uint32_t count;
} CrossedQueue;

/* Tubes by themselves. */
typedef struct LooseQueue {
    float rows[3 * CORNER_ROWS + 4][LOOSE_ROOM];
    uint32_t count;
} LooseQueue;

typedef struct Queues {
    CrossedQueue crossed;
    LooseQueue parts; /* crossed in the same sense, parts of quartered ones */
    LooseQueue bent;  /* to be looked at more closely */
} Queues;

/* How often a tube is quartered at most: the gain of each level is a quarter of the last one's. */
enum { LEVEL_MAX = 7, TURN_LEVEL_MAX = 10 };
/* How far f may be from linear anywhere, in units of how far it is at most in the middle of an
 * edge: 4/3 in the triangle's middle if it is quadratic. */
static const float BULGE = 4.0f / 3.0f;

/* From the end of the queue, a vector or what there is; other lanes are zero. */
static inline uint32_t take_loose(LooseQueue *queue, Tubes *out) {
    const uint32_t count = queue->count < LANE_COUNT ? queue->count : LANE_COUNT;
    queue->count -= count;
    const LaneMask is_there = lanes_below(count);
    const Lanes zero = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        for (int r = 0; r < CORNER_ROWS; ++r)
            out->rows[k][r] = lanes_select(
                is_there, lanes_load(queue->rows[k * CORNER_ROWS + r] + queue->count), zero);
        out->f[k] = lanes_select(is_there,
                                 lanes_load(queue->rows[3 * CORNER_ROWS + k] + queue->count), zero);
    }
    out->level =
        lanes_select(is_there, lanes_load(queue->rows[3 * CORNER_ROWS + 3] + queue->count), zero);
    return count;
}

static inline void add_loose(const Tubes *tubes, uint32_t bits, LooseQueue *queue) {
    const LanePack pack = lanes_pack_for(bits);
    const uint32_t end = queue->count;
    for (int k = 0; k < 3; ++k) {
        for (int r = 0; r < CORNER_ROWS; ++r)
            lanes_pack(queue->rows[k * CORNER_ROWS + r] + end, tubes->rows[k][r], &pack);
        lanes_pack(queue->rows[3 * CORNER_ROWS + k] + end, tubes->f[k], &pack);
    }
    lanes_pack(queue->rows[3 * CORNER_ROWS + 3] + end, tubes->level, &pack);
    queue->count = end + (uint32_t)__builtin_popcount(bits);
}

/* Patches as rows of eight numbers, of which a corner is one. */
enum {
    ROW_BYTES = CORNER_SIZE * sizeof(float),
    PATCH_ROWS = sizeof(TubePatch) / ROW_BYTES,
    FIRST_ROW = offsetof(TubePatch, corners) / ROW_BYTES
};
_Static_assert(sizeof(TubePatch) % ROW_BYTES == 0, "a patch is so many rows");
_Static_assert(offsetof(TubePatch, corners) % ROW_BYTES == 0, "and its corners are some of them");

/* A corner of each tube. */
static inline void load_corners(const TubeTree *tree, LaneMask patches, LaneMask corners,
                                Lanes rows[CORNER_ROWS]) {
    const LaneMask numbers = patches * PATCH_ROWS + FIRST_ROW + corners;
    uint32_t row[LANE_COUNT];
    memcpy(row, &numbers, sizeof row);
    /* Through memory: the compiler would take the vector apart, which costs more. */
    __asm__("" : "+m"(row));
    const float *from[LANE_COUNT];
    for (int i = 0; i < LANE_COUNT; ++i)
        from[i] = (const float *)tree->patches + (size_t)row[i] * CORNER_SIZE;
    lanes_load_rows(from, rows);
    rows[ROW_START] = lanes_set(0.0f);
    if (tree->light.value == TUBE_VALUE_IS_FLUX) /* reflected: there is a way before */
        for (int i = 0; i < LANE_COUNT; ++i)
            rows[ROW_START][i] = tree->patches[patches[i]].starts[corners[i]];
    rows[ROW_NORMAL_LENGTH] = lanes_set(1.0f);
}

static inline Lanes3 row3(const Tubes *tubes, int corner, int r) {
    const Lanes *rows = tubes->rows[corner] + r;
    return (Lanes3){rows[0], rows[1], rows[2]};
}

/* f of the light line from + s w, where across = d x from. */
static inline Lanes line_f(Lanes3 across, Lanes3 w, Lanes3 d) {
    /* w . (d x from) = (w - d) . (d x from) = (w + d) . (d x from): with the smaller of the two,
     * directions that are nearly parallel keep their digits. */
    const Lanes side = lanes_sign(dot3(w, d));
    return dot3(sub3(w, scale3(d, side)), across);
}

static inline Lanes min_of(const Lanes f[3]) {
    return lanes_min(lanes_min(f[0], f[1]), f[2]);
}

static inline Lanes max_of(const Lanes f[3]) {
    return lanes_max(lanes_max(f[0], f[1]), f[2]);
}

/* Which corner is on the other side of zero than the two others; corner 2 if none is. */
typedef struct Odd {
    LaneMask is_first, is_second;
} Odd;

static inline Odd odd_corner(const Lanes f[3]) {
    const LaneMask p0 = f[0] > 0.0f, p1 = f[1] > 0.0f, p2 = f[2] > 0.0f;
    return (Odd){(p0 != p1) & (p0 != p2), (p1 != p2) & (p1 != p0)};
}

/* The value of corner k, counted from the odd one. */
static inline Lanes turn(const Odd *odd, int k, Lanes v0, Lanes v1, Lanes v2) {
    const Lanes v[3] = {v0, v1, v2};
    return lanes_select(odd->is_first, v[k],
                        lanes_select(odd->is_second, v[(k + 1) % 3], v[(k + 2) % 3]));
}

static inline LaneMask load_numbers(const uint32_t numbers[LANE_COUNT]) {
    LaneMask lanes;
    memcpy(&lanes, numbers, sizeof lanes);
    return lanes;
}

/* From the end of the queue, a vector or what there is, odd corners first; f of other lanes is
 * zero. */
static inline void take_crossed(const TubeTree *tree, CrossedQueue *queue, Tubes *out) {
    const uint32_t count = queue->count < LANE_COUNT ? queue->count : LANE_COUNT;
    queue->count -= count;
    const LaneMask is_there = lanes_below(count);
    const LaneMask patches = load_numbers(queue->patches + queue->count) & is_there;
    const LaneMask packed = load_numbers(queue->corners + queue->count) & is_there;
    Lanes f[3];
    for (int k = 0; k < 3; ++k)
        f[k] = (Lanes)((LaneMask)lanes_load(queue->f[k] + queue->count) & is_there);
    const Odd odd = odd_corner(f);
    const Lanes corners[3] = {(Lanes)(packed & 15), (Lanes)(packed >> 4 & 15),
                              (Lanes)(packed >> 8)};
#pragma GCC unroll 3
    for (int k = 0; k < 3; ++k) {
        const Lanes corner = turn(&odd, k, corners[0], corners[1], corners[2]);
        load_corners(tree, patches, (LaneMask)corner, out->rows[k]);
        out->f[k] = turn(&odd, k, f[0], f[1], f[2]);
    }
}

/* Puts the odd corner first. */
static inline void turn_tubes(const Tubes *tubes, Tubes *out) {
    const Odd odd = odd_corner(tubes->f);
    for (int k = 0; k < 3; ++k) {
        for (int r = 0; r < CORNER_ROWS; ++r)
            out->rows[k][r] =
                turn(&odd, k, tubes->rows[0][r], tubes->rows[1][r], tubes->rows[2][r]);
        out->f[k] = turn(&odd, k, tubes->f[0], tubes->f[1], tubes->f[2]);
    }
    out->level = tubes->level;
}

/* Patches that the segment may meet, and those of them with tubes that the curve may touch. What
 * is found next depends on no branch: a wrong guess would cost more than the work. */
enum { PATCHES_FULL = 64, PATCHES_ROOM = PATCHES_FULL + (NODES + 1) * TUBE_LANES };
typedef struct Patches {
    uint32_t found[PATCHES_ROOM], found_count;
    uint32_t touched[PATCHES_ROOM], touched_count;
    uint32_t tubes[PATCHES_ROOM];         /* of those touched, bits */
    float reaches[PATCHES_ROOM];          /* m, from the ray to their farthest corner, at most */
    float f[PATCHES_ROOM][PATCH_CORNERS]; /* at their corners */
    bool may_turn[PATCHES_ROOM];          /* see may_turn */
    bool is_parallel; /* all light of a tube runs along the ray, which meets it everywhere */
} Patches;

/* Sine between light and view below which single precision does not tell where they meet, and the
 * angle by which the view is then turned: less than a pixel. */
static const float PARALLEL_SINE = 5e-5f;
static const float NUDGE = 2e-4f;

/* Where light is nearer to the view's direction than twice as far as it differs between corners, it
 * may turn over from one side of the view to the other. The whole segment is then lit through a
 * small part of a tube, and what is linear over all of the tube is not good enough. */
static const float TURN_SPREADS = 2.0f;

/* f at the corners of a patch whose light runs nearly along the ray, whether it may turn over, and
 * whether all light of a tube is parallel to the ray. */
static inline void near_parallel_f(const TubePatch *patch, const Query *q, Lanes out[HALVES],
                                   bool *out_may_turn, bool *is_parallel) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
    const Vec3 first = vec3_from(patch->corners[0] + CORNER_W);
    Lanes least = lanes_set(1.0f), most = lanes_set(0.0f);
    uint32_t parallel = 0;
    for (int h = 0; h < HALVES; ++h) {
        Lanes rows[CORNER_SIZE];
        const float *corners[LANE_COUNT];
        for (int i = 0; i < LANE_COUNT; ++i)
            corners[i] = patch->corners[h * LANE_COUNT + i];
        lanes_load_rows(corners, rows);
        const Lanes3 x = {rows[CORNER_X], rows[CORNER_X + 1], rows[CORNER_X + 2]};
        const Lanes3 w = {rows[CORNER_W], rows[CORNER_W + 1], rows[CORNER_W + 2]};
        out[h] = line_f(cross3(d, sub3(x, o)), w, d);
        const Lanes3 across = cross3(d, w), change = sub3(w, set3(first));
        const Lanes sin2 = dot3(across, across);
        const LaneMask is_corner = dot3(w, w) > 0.0f;
        least = lanes_select(is_corner, lanes_min(least, sin2), least);
        most = lanes_select(is_corner, lanes_max(most, dot3(change, change)), most);
        parallel |= lanes_bits((sin2 < PARALLEL_SINE * PARALLEL_SINE) & is_corner)
                    << (h * LANE_COUNT);
    }
    float sin2 = 1.0f, spread2 = 0.0f;
    for (int i = 0; i < LANE_COUNT; ++i) {
        sin2 = fminf(sin2, least[i]);
        spread2 = fmaxf(spread2, most[i]);
    }
    *out_may_turn = sin2 < TURN_SPREADS * TURN_SPREADS * spread2;
    for (int k = 0; k < PATCH_TUBES && parallel != 0; ++k)
        if (patch->masks[k] != 0 && (patch->masks[k] & ~parallel) == 0)
            *is_parallel = true;
}

/* Cosine between light and ray beyond which f is a difference of large numbers in Pluecker
 * coordinates. */
static const float PARALLEL_COS = 0.98f;

/* Keeps of the patches found those that are touched. */
static inline void touch_patches(const TubeTree *tree, const Query *q, Patches *patches) {
    const float line[LINE_AXES] = {q->d.x,       q->d.y,       q->d.z,
                                   q->moment[0], q->moment[1], q->moment[2]};
    uint32_t touched = 0;
    for (uint32_t i = 0; i < patches->found_count; ++i) {
        /* Set by lanes_store_numbers, for as many as are counted. */
        const uint32_t p = patches->found[i]; /* NOLINT(clang-analyzer-core.*) */
        const TubePatch *patch = &tree->patches[p];
        Lanes values[HALVES];
        patches->may_turn[touched] = false;
        if (fabsf(vec3_dot(vec3_from(patch->corners[0] + CORNER_W), q->d)) > PARALLEL_COS) {
            near_parallel_f(patch, q, values, &patches->may_turn[touched], &patches->is_parallel);
        } else {
            for (int h = 0; h < HALVES; ++h) {
                values[h] = lanes_set(0.0f);
                for (int a = 0; a < LINE_AXES; ++a)
                    values[h] += line[a] * lanes_load(patch->lines[a] + h * LANE_COUNT);
            }
        }
        /* No corner is farther from the ray. */
        const float reach =
            vec3_length(vec3_cross(vec3_sub(patch->center, q->o), q->d)) + patch->radius;
        const float margin = (patch->bulge + patch->blur) * reach;
        uint32_t above = 0, below = 0;
        for (int h = 0; h < HALVES; ++h) {
            lanes_store(patches->f[touched] + h * LANE_COUNT, values[h]);
            above |= lanes_bits(values[h] > -margin) << (h * LANE_COUNT);
            below |= lanes_bits(values[h] < margin) << (h * LANE_COUNT);
        }
        const uint32_t tubes = words_meeting(patch->masks, above, below);
        patches->touched[touched] = p;
        patches->tubes[touched] = tubes;
        patches->reaches[touched] = reach;
        touched += tubes != 0;
    }
    patches->touched_count = touched;
    patches->found_count = 0;
}

/* Adds the tubes of a touched patch that the zero curve crosses, and those that it may touch. */
static inline void find_crossings(const TubeTree *tree, uint32_t p, uint32_t tubes, float reach,
                                  const float f[PATCH_CORNERS], bool may_turn, Queues *queues) {
    const TubePatch *patch = &tree->patches[p];
    const float blur = patch->blur * reach; /* f is averaged over so much to either side, at most */
    const BitList list = list_bits(tubes);
    const uint32_t count = (uint32_t)__builtin_popcount(tubes);
    for (uint32_t i = 0; i < count; i += LANE_COUNT) {
        const uint32_t all = list_lanes(&list, count, i);
        const LaneMask pairs = list_lookup(&list, i, patch->pairs);
        const LaneMask thirds = list_lookup(&list, i, patch->thirds);
        const Lanes g[3] = {lanes_lookup(f, pairs), lanes_lookup(f, pairs >> 4),
                            lanes_lookup(f, thirds)};
        const Lanes low = min_of(g), high = max_of(g);
        const LaneMask bulges = list_lookup(&list, i, patch->bulges);
        const Lanes margin =
            (patch->bulge * reach / 255.0f) * __builtin_convertvector(bulges, Lanes);
        const Lanes bend_max =
            may_turn ? lanes_set(0.0f) : (BULGE * tree->bend_max) * (high - low + blur);
        const LaneMask is_bent =
            (margin > bend_max) & (low < margin + blur) & (high > -margin - blur);
        const uint32_t bent = lanes_bits(is_bent) & all;
        const uint32_t crossed = lanes_bits((low <= blur) & (high > -blur)) & all & ~bent;
        const LanePack pack = lanes_pack_for(crossed);
        CrossedQueue *queue = &queues->crossed;
        const uint32_t end = queue->count;
        const LaneMask patches = pairs * 0 + (int32_t)p;
        memcpy(queue->patches + end, &patches, sizeof patches);
        lanes_pack_numbers(queue->corners + end, pairs | thirds << 8, &pack);
        for (int k = 0; k < 3; ++k)
            lanes_pack(queue->f[k] + end, g[k], &pack);
        queue->count = end + (uint32_t)__builtin_popcount(crossed);
        if (bent != 0) {
            Tubes loose;
            loose.level = lanes_set(0.0f);
            const LaneMask corner[3] = {pairs & 15, pairs >> 4, thirds};
            for (int k = 0; k < 3; ++k) {
                loose.f[k] = g[k];
                load_corners(tree, patches, corner[k], loose.rows[k]);
            }
            add_loose(&loose, bent, &queues->bent);
        }
    }
}

/* Area vector of the tubes' pieces, on either side. */
static inline Lanes3 area_of(const Tubes *tubes) {
    const Lanes3 x = row3(tubes, 0, CORNER_X);
    const Lanes3 edge = sub3(row3(tubes, 1, CORNER_X), x),
                 other = sub3(row3(tubes, 2, CORNER_X), x);
    return scale3(cross3(edge, other), lanes_set(0.5f));
}

/* Flux of whole pieces per value at a point of them from which light goes on along w, as long as
 * `unit`. */
static inline Lanes flux_share(const Tubes *tubes, const TubeLight *light, Lanes3 area, Lanes3 w,
                               Lanes unit) {
    if (light->value == TUBE_VALUE_IS_FLUX)
        return lanes_set(1.0f);
    const Lanes3 origin = set3(light->origin);
    const Lanes facing = light->is_directional ? -dot3(origin, area)
                                               : dot3(sub3(origin, row3(tubes, 0, CORNER_X)), area);
    if (light->value == TUBE_VALUE_ARRIVES)
        return abs_lanes(facing);
    const Lanes leaving = dot3(w, area) / unit;
    return lanes_max(lanes_select(facing < 0.0f, leaving, -leaving), lanes_set(0.0f));
}

/* a / (a + b) of the tubes' cross-sections at the boundary and at s: see docs/theory.md 4. */
static inline Lanes frequency_of(const Tubes *tubes, Lanes3 area, Lanes3 w, Lanes s) {
    const Lanes3 x = row3(tubes, 0, CORNER_X), v = row3(tubes, 0, CORNER_W);
    Lanes3 edge[2];
    for (int k = 0; k < 2; ++k)
        edge[k] = add3(sub3(row3(tubes, k + 1, CORNER_X), x),
                       scale3(sub3(row3(tubes, k + 1, CORNER_W), v), s));
    const Lanes begin = abs_lanes(dot3(area, w));
    const Lanes here = abs_lanes(0.5f * dot3(cross3(edge[0], edge[1]), w));
    return begin / lanes_max(begin + here, lanes_set(1e-30f));
}

/* Between the first corner and corner k, at part q of the way. */
static inline Lanes between(const Tubes *tubes, int r, int k, Lanes q) {
    const Lanes v = tubes->rows[0][r];
    return v + q * (tubes->rows[k][r] - v);
}

static inline Lanes3 between3(const Tubes *tubes, int r, int k, Lanes q) {
    return (Lanes3){between(tubes, r, k, q), between(tubes, r + 1, k, q),
                    between(tubes, r + 2, k, q)};
}

/* An end of a chord: its light line and what the tube has there. */
typedef struct End {
    Lanes3 from, w; /* from the camera ray's o */
    Lanes value, limit, start;
} End;

/* On the edge from the first corner to corner k, at part q of the way. */
static inline End end_on_edge(const Tubes *tubes, int k, Lanes q, Lanes3 o) {
    return (End){.from = sub3(between3(tubes, CORNER_X, k, q), o),
                 .w = between3(tubes, CORNER_W, k, q),
                 .value = between(tubes, CORNER_VALUE, k, q),
                 .limit = between(tubes, CORNER_LIMIT, k, q),
                 .start = between(tubes, ROW_START, k, q)};
}

static inline Lanes lerp(Lanes a, Lanes b, Lanes q) {
    return a + q * (b - a);
}

static inline End end_between(const End *b, const End *c, Lanes q) {
    return (End){.from = lerp3(b->from, c->from, q),
                 .w = lerp3(b->w, c->w, q),
                 .value = lerp(b->value, c->value, q),
                 .limit = lerp(b->limit, c->limit, q),
                 .start = lerp(b->start, c->start, q)};
}

/* What the lanes of gather_chord have in common. */
typedef struct ChordGather {
    const Tubes *tubes;
    const TubeLight *light;
    const Medium *medium;
    const Query *q;
    Sums *sums;
} ChordGather;

/* Adds what a chord from b to c sends along the segment, density per part of the chord; n tells the
 * side, on all of the chord the same, from which light meets the segment. */
static inline void gather_chord(const ChordGather *gather, const End *b, const End *c,
                                Lanes density, Lanes3 n, LaneMask is_hit) {
    const Lanes zero = lanes_set(0.0f), half = lanes_set(0.5f);
    const Query *q = gather->q;
    const Lanes3 d = set3(q->d), turned = cross3(n, d);
    Meeting meet_b = {.from = b->from, .w = b->w}, meet_c = {.from = c->from, .w = c->w};
    meet(&meet_b, n, turned);
    meet(&meet_c, n, turned);

    /* The part of the chord that lies on the segment and in front of the light's end. */
    const Lanes inside_b[CLIP_COUNT] = {meet_b.along - q->near * meet_b.over,
                                        q->far * meet_b.over - meet_b.along, meet_b.depth,
                                        b->limit * meet_b.over - meet_b.depth};
    const Lanes inside_c[CLIP_COUNT] = {meet_c.along - q->near * meet_c.over,
                                        q->far * meet_c.over - meet_c.along, meet_c.depth,
                                        c->limit * meet_c.over - meet_c.depth};
    Lanes q0, q1;
    clip(inside_b, inside_c, &q0, &q1);
    is_hit &= q1 > q0;
    if (lanes_bits(is_hit) == 0)
        return;

    /* Everything else in the middle of that part. */
    const Lanes qm = half * (q0 + q1);
    const End middle = end_between(b, c, qm);
    Meeting m = {.from = middle.from, .w = middle.w};
    const Lanes3 normal = cross3(d, m.w);
    meet(&m, normal, cross3(normal, d));
    const Lanes inverse = 1.0f / lanes_max(m.over, lanes_set(SIN2_MIN));
    const Lanes unit2 = dot3(m.w, m.w);
    const Lanes unit = lanes_sqrt(unit2);
    const Lanes t = lanes_max(m.along * inverse - q->near, zero);
    const Lanes s = lanes_max(m.depth * inverse, zero);
    /* The way to here, and at the ends of the chord's part. */
    const Lanes path_b = meet_b.along + meet_b.depth, path_c = meet_c.along + meet_c.depth;
    const Lanes over0 = lerp(meet_b.over, meet_c.over, q0);
    const Lanes over1 = lerp(meet_b.over, meet_c.over, q1);
    const Lanes way0 = lerp(path_b, path_c, q0) / over0 + lerp(b->start, c->start, q0);
    const Lanes way1 = lerp(path_b, path_c, q1) / over1 + lerp(b->start, c->start, q1);
    const LaneMask is_rising = way0 < way1;
    const Way way = {.middle = s * unit + t + middle.start,
                     .near = lanes_max(lanes_min(way0, way1) - q->near, zero),
                     .change = way1 - way0,
                     .ratio = lanes_select(is_rising, over0, over1) /
                              lanes_select(is_rising, over1, over0)};

    const Medium *medium = gather->medium;
    const TubeLight *light = gather->light;
    Lanes scatter[3];
    medium_scattering_lanes(medium, dot3(m.w, d) / unit, m.over / unit2, scatter);
    const Lanes3 area = area_of(gather->tubes);
    const Lanes value =
        middle.value * flux_share(gather->tubes, light, area, m.w, unit) * density * (q1 - q0);
    const float sigma_t[3] = {medium->sigma_t.r, medium->sigma_t.g, medium->sigma_t.b};
    const float color[3] = {light->color.r, light->color.g, light->color.b};
    Lanes total = zero;
    for (int k = 0; k < 3; ++k) {
        const Lanes fade = fade_along(sigma_t[k], &way);
        const Lanes arrives = lanes_select(is_hit, value * color[k] * scatter[k] * fade, zero);
        gather->sums->radiance[k] += arrives;
        total += arrives;
    }
    if (q->has_frequency)
        gather->sums->frequency +=
            lanes_select(is_hit, total * frequency_of(gather->tubes, area, m.w, s), zero);
}

/* Where light turns over from one side of the view to the other, it meets the view at infinity, and
 * the whole segment is lit through a small part of the chord. Such a chord, or one that ends near
 * such a place, is taken in pieces that grow away from there: what gather_chord takes as linear is
 * so on each. */
static const float PIECE_ENDS[] = {-0x1p-3f, -0x1p-6f, -0x1p-9f, -0x1p-12f, -0x1p-15f, 0.0f,
                                   0x1p-15f, 0x1p-12f, 0x1p-9f,  0x1p-6f,   0x1p-3f};
enum { PIECE_COUNT = sizeof PIECE_ENDS / sizeof PIECE_ENDS[0] + 1 };
/* Ratio of `over` at the ends of a chord below which it is cut. */
static const float TURN_RATIO = 0.25f;

static inline void gather_turning(const ChordGather *gather, const End *b, const End *c,
                                  Lanes density, Lanes3 n, Lanes over_b, Lanes over_c,
                                  LaneMask is_hit) {
    const Lanes zero = lanes_set(0.0f), one = lanes_set(1.0f);
    const LaneMask is_level = over_b == over_c;
    const Lanes turn = over_b / lanes_select(is_level, one, over_b - over_c);
    End from = *b;
    Lanes begin = zero;
    for (int k = 0; k < PIECE_COUNT; ++k) {
        const Lanes cut = k + 1 < PIECE_COUNT ? turn + PIECE_ENDS[k] : one;
        const Lanes end = lanes_max(begin, lanes_min(cut, one));
        const End to = end_between(b, c, end);
        /* n points to the side of the piece's middle. */
        const Lanes side = lanes_sign(lerp(over_b, over_c, 0.5f * (begin + end)));
        gather_chord(gather, &from, &to, density * (end - begin), scale3(n, side),
                     is_hit & (end > begin));
        from = to;
        begin = end;
    }
}

/* Adds what tubes that are crossed send along the segment. A lane whose f does not
 * change its sign counts for nothing. */
static inline void gather_tubes(const Tubes *tubes, const Lanes *soft, const TubeLight *light,
                                const Medium *medium, const Query *q, Sums *sums) {
    const Lanes one = lanes_set(1.0f), half = lanes_set(0.5f);
    const Lanes3 d = set3(q->d), o = set3(q->o);
    const Lanes f = tubes->f[0];
    const LaneMask is_hit = (f > 0.0f) != (tubes->f[1] > 0.0f);
    const Lanes gap_b = lanes_select(is_hit, f - tubes->f[1], one);
    const Lanes gap_c = lanes_select(is_hit, f - tubes->f[2], one);
    /* Where the zero curve enters the triangle and where it leaves, on the edges from the first
     * corner. */
    const Lanes cut_b = f / gap_b, cut_c = f / gap_c;
    const Lanes density = soft != NULL ? *soft : 2.0f * cut_b / abs_lanes(gap_c);
    const End b = end_on_edge(tubes, 1, cut_b, o), c = end_on_edge(tubes, 2, cut_c, o);
    const ChordGather gather = {tubes, light, medium, q, sums};
    const Lanes3 n = cross3(d, lerp3(b.w, c.w, half)), turned = cross3(n, d);
    const Lanes over_b = dot3(b.w, turned), over_c = dot3(c.w, turned);
    const LaneMask turns =
        lanes_min(over_b, over_c) < TURN_RATIO * lanes_max(abs_lanes(over_b), abs_lanes(over_c));
    if (lanes_bits(is_hit & ~turns) != 0)
        gather_chord(&gather, &b, &c, density, n, is_hit & ~turns);
    if (lanes_bits(is_hit & turns) == 0)
        return;
    /* The middle may be parallel to the view and have no normal; the difference of the ends has. */
    const Lanes3 across = cross3(d, sub3(b.w, c.w)), tilted = cross3(across, d);
    gather_turning(&gather, &b, &c, density, across, dot3(b.w, tilted), dot3(c.w, tilted),
                   is_hit & turns);
}

/* The normals at the corners, found again from how light was refracted there:
 * w - eta d is along the normal. */
static inline Lanes3 normal_at(const TubeLight *light, Lanes3 d, Lanes3 w) {
    const Lanes3 n = sub3(w, scale3(d, lanes_set(light->eta)));
    const LaneMask is_back = dot3(n, d) > 0.0f;
    return normalize3(scale3(n, lanes_select(is_back, lanes_set(-1.0f), lanes_set(1.0f))));
}

static inline Lanes3 light_direction(const TubeLight *light, Lanes3 x) {
    const Lanes3 origin = set3(light->origin);
    return light->is_directional ? origin : normalize3(sub3(x, origin));
}

/* Light along unit d, refracted at normal n, which need not be unit: as make_corner of tubes.c. */
static inline Lanes3 refract(const TubeLight *light, Lanes3 d, Lanes3 n) {
    if (light->eta == 1.0f)
        return d;
    const Lanes zero = lanes_set(0.0f), eta = lanes_set(light->eta);
    n = normalize3(n);
    const Lanes missing = lanes_max(TUBE_GRAZING_COS + dot3(d, n), zero);
    n = normalize3(sub3(n, scale3(d, missing)));
    const Lanes cos_i = -dot3(d, n);
    const Lanes cos_t =
        lanes_sqrt(lanes_max((1.0f - eta) * (1.0f + eta) + eta * eta * (cos_i * cos_i), zero));
    return normalize3(add3(scale3(d, eta), scale3(n, eta * cos_i - cos_t)));
}

/* Part of a triangle's area where a function that is linear over it is below c; its values at the
 * corners in ascending order. */
static inline Lanes area_below(Lanes c, Lanes low, Lanes middle, Lanes high) {
    const Lanes tiny = lanes_set(1e-30f), one = lanes_set(1.0f);
    c = lanes_max(low, lanes_min(high, c));
    const Lanes range = high - low, up = c - low, down = high - c;
    const Lanes first = up * up / lanes_max(range * (middle - low), tiny);
    const Lanes last = one - down * down / lanes_max(range * (high - middle), tiny);
    return lanes_select(c < middle, first, last);
}

/* f is averaged over less than this part of its range: the chord is as good. */
static const float SOFT_MIN = 1e-3f;

/* How far light along w has come, about, where most of what the segment sees of the tubes meets it.
 * On the zero curve, whether or not it runs through the triangle: neighbours, of which each covers
 * a part of what light is averaged over, must agree on how wide that is. */
static inline Lanes way_in_sight(const Tubes *tubes, const Query *q, Lanes3 w, float sigma_t) {
    const Lanes one = lanes_set(1.0f), tiny = lanes_set(1e-30f);
    const Lanes3 d = set3(q->d), o = set3(q->o);
    const Lanes3 n = cross3(d, w), turned = cross3(n, d);
    const Lanes *f = tubes->f;
    const Lanes mean = (f[0] + f[1] + f[2]) * (1.0f / 3.0f);
    Lanes square = tiny, along2 = tiny;
    for (int k = 0; k < 3; ++k) {
        const Lanes off = f[k] - mean, along = f[(k + 1) % 3] - f[(k + 2) % 3];
        square += off * off;
        along2 += along * along;
    }
    /* s and t of the meeting, linear over the triangle: at the point of the zero curve nearest to
     * its middle, and their change along the curve. */
    Lanes s = lanes_set(0.0f), t = s, ds = s, dt = s, first = one / tiny, last = -first;
    for (int k = 0; k < 3; ++k) {
        Meeting m = {.from = sub3(row3(tubes, k, CORNER_X), o), .w = row3(tubes, k, CORNER_W)};
        meet(&m, n, turned);
        const Lanes inverse = 1.0f / lanes_max(m.over, lanes_set(SIN2_MIN));
        const Lanes part = 1.0f / 3.0f - mean * (f[k] - mean) / square;
        const Lanes step = (f[(k + 1) % 3] - f[(k + 2) % 3]) / along2;
        s += part * m.depth * inverse;
        t += part * m.along * inverse;
        ds += step * along2 * m.depth * inverse;
        dt += step * along2 * m.along * inverse;
        first = lanes_min(first, step);
        last = lanes_max(last, step);
    }
    const Lanes s0 = s + first * ds, s1 = s + last * ds;
    const Lanes t0 = t + first * dt, t1 = t + last * dt;
    const Lanes inside0[CLIP_COUNT] = {t0 - q->near, q->far - t0, s0, one};
    const Lanes inside1[CLIP_COUNT] = {t1 - q->near, q->far - t1, s1, one};
    Lanes q0, q1;
    clip(inside0, inside1, &q0, &q1);
    /* What fades by exp(-x) has its middle at this part of the way. */
    const Lanes change = sigma_t * (q1 - q0) * (s1 + t1 - s0 - t0);
    const Lanes x = lanes_max(abs_lanes(change), lanes_set(1e-3f));
    const Lanes left = lanes_exp_negative(-x);
    const Lanes near = lanes_select(x > 0.1f, 1.0f / x - left / (1.0f - left), 0.5f - x / 12.0f);
    const Lanes u = lanes_select(change > 0.0f, near, 1.0f - near);
    return lanes_max(lerp(s0, s1, q0 + u * (q1 - q0)), lanes_set(0.0f));
}

/* Averages delta(f) over a source with an extent. Where the source moves, f moves along by as much
 * as w does, so delta becomes a box of the half width that gives the same variance, and its mean
 * over a triangle a difference of areas. Everything else is taken on the chord in the middle of
 * what is covered, on which f becomes zero; turns the tubes for it. */
static inline Lanes soften_tubes(Tubes *tubes, const TubeLight *light, const Query *q,
                                 float sigma_t) {
    const Lanes third = lanes_set(1.0f / 3.0f), zero = lanes_set(0.0f);
    const Lanes3 x = scale3(
        add3(add3(row3(tubes, 0, CORNER_X), row3(tubes, 1, CORNER_X)), row3(tubes, 2, CORNER_X)),
        third);
    const Lanes3 w = normalize3(
        add3(add3(row3(tubes, 0, CORNER_W), row3(tubes, 1, CORNER_W)), row3(tubes, 2, CORNER_W)));
    const Lanes3 d = light_direction(light, x);
    /* From the ray to where light that meets it begins. */
    const Lanes3 across = scale3(cross3(w, set3(q->d)), way_in_sight(tubes, q, w, sigma_t));
    const Lanes3 from = sub3(x, set3(light->origin));
    const Lanes eta = lanes_set(light->eta);
    Lanes3 n = {zero, zero, zero};
    Lanes bend = zero;
    if (light->eta != 1.0f) {
        n = normal_at(light, d, w);
        const Lanes cos_t = lanes_max(-dot3(w, n), lanes_set(1e-4f));
        bend = eta + eta * eta * dot3(d, n) / cos_t;
    }
    Lanes half2 = zero;
    for (int k = 0; k < 2; ++k) {
        Lanes3 moved = set3(light->extent[k]);
        if (!light->is_directional)
            moved =
                scale3(sub3(scale3(d, dot3(moved, d)), moved), 1.0f / lanes_sqrt(dot3(from, from)));
        const Lanes3 dw = sub3(scale3(moved, eta), scale3(n, bend * dot3(moved, n)));
        const Lanes by = dot3(across, dw);
        half2 += by * by;
    }
    const Lanes low = min_of(tubes->f), high = max_of(tubes->f), range = high - low;
    const Lanes middle = tubes->f[0] + tubes->f[1] + tubes->f[2] - low - high;
    const LaneMask is_sharp = lanes_sqrt(half2) <= SOFT_MIN * range;
    const Lanes half = lanes_max(lanes_sqrt(half2), SOFT_MIN * range);
    const Lanes covered =
        area_below(half, low, middle, high) - area_below(-half, low, middle, high);
    const Lanes bottom = lanes_max(low, -half), top = lanes_min(high, half);
    const Lanes level = lanes_select(is_sharp, zero, 0.5f * (bottom + top));
    for (int k = 0; k < 3; ++k)
        tubes->f[k] -= level;
    const Tubes before = *tubes;
    turn_tubes(&before, tubes);
    const Lanes tiny = lanes_set(1e-30f);
    const Lanes gaps = (tubes->f[0] - tubes->f[1]) * (tubes->f[0] - tubes->f[2]);
    const Lanes sharp = 2.0f * abs_lanes(tubes->f[0]) / lanes_max(abs_lanes(gaps), tiny);
    return lanes_select(is_sharp, sharp, covered / lanes_max(2.0f * half, tiny));
}

/* Adds what tubes send that are crossed, or nearly. */
static inline void gather_crossed(Tubes *tubes, const TubeTree *tree, const Medium *medium,
                                  const Query *q, Sums *sums) {
    if (tree->blur > 0.0f) {
        const Lanes density = soften_tubes(tubes, &tree->light, q, rgb_mean(medium->sigma_t));
        gather_tubes(tubes, &density, &tree->light, medium, q, sums);
    } else {
        gather_tubes(tubes, NULL, &tree->light, medium, q, sums);
    }
}

/* How far from the line of the ray light begins, and the sine of its angle to it. */
typedef struct Aside {
    Lanes distance, sine;
} Aside;

static inline Aside aside_of(Lanes3 across, Lanes3 w, Lanes3 d) {
    const Lanes3 turned = cross3(d, w);
    return (Aside){lanes_sqrt(dot3(across, across)), lanes_sqrt(dot3(turned, turned))};
}

/* Whether light comes to the line before it ends, where it does not begin farther than size from
 * any corner, and does not run in a direction that is farther than spread from all of them. */
static inline LaneMask can_arrive(Aside a, Aside b, Aside c, Lanes size, Lanes spread,
                                  Lanes limit) {
    const Lanes distance = lanes_max(lanes_max(a.distance, b.distance), c.distance) - size;
    const Lanes sine = lanes_max(lanes_max(a.sine, b.sine), c.sine) + spread;
    return distance <= limit * sine;
}

/* One of the four parts of each tube: the corners are those of the tube (0, 1, 2) and the middles
 * of its edges 01, 12, 20 (3, 4, 5). */
static const uint8_t PARTS[4][3] = {{0, 3, 5}, {3, 1, 4}, {5, 4, 2}, {3, 4, 5}};

/* Looks at what is refracted in the middle of the edges of bent tubes. One that turns out to be as
 * good as linear is crossed or not, one that the curve does not touch is dropped, the rest are
 * quartered. */
static inline void refine_tubes(const Tubes *tubes, uint32_t count, const TubeTree *tree,
                                const Query *q, Queues *queues) {
    const TubeLight *light = &tree->light;
    const Lanes3 d = set3(q->d), o = set3(q->o);
    Lanes rows[6][CORNER_ROWS], f[6], bend = lanes_set(0.0f);
    Lanes3 normal[3];
    Aside aside[6];
    Lanes size2 = lanes_set(0.0f), spread2 = lanes_set(0.0f), limit = lanes_set(0.0f);
    Lanes sine = lanes_set(1.0f), blur = lanes_set(0.0f); /* blur: as in find_crossings */
    for (int k = 0; k < 3; ++k) {
        const Lanes3 x = row3(tubes, k, CORNER_X), w = row3(tubes, k, CORNER_W);
        const Lanes3 edge = sub3(row3(tubes, (k + 1) % 3, CORNER_X), x);
        const Lanes3 change = sub3(row3(tubes, (k + 1) % 3, CORNER_W), w);
        aside[k] = aside_of(cross3(d, sub3(x, o)), w, d);
        size2 = lanes_max(size2, dot3(edge, edge));
        spread2 = lanes_max(spread2, dot3(change, change));
        limit = lanes_max(limit, tubes->rows[k][CORNER_LIMIT]);
        sine = lanes_min(sine, aside[k].sine);
        blur = lanes_max(blur, tree->blur * aside[k].distance);
    }
    const Lanes size = lanes_sqrt(size2), spread = lanes_sqrt(spread2);
    const LaneMask is_near =
        can_arrive(aside[0], aside[1], aside[2], size, spread + tree->blur, limit);
    const uint32_t all = lanes_bits(is_near) & ((1u << count) - 1u);
    if (all == 0)
        return;
    memcpy(rows, tubes->rows, sizeof tubes->rows);
    memcpy(f, tubes->f, sizeof tubes->f);
    for (int k = 0; k < 3; ++k) {
        const Lanes3 x = row3(tubes, k, CORNER_X), w = row3(tubes, k, CORNER_W);
        normal[k] = scale3(normal_at(light, light_direction(light, x), w),
                           tubes->rows[k][ROW_NORMAL_LENGTH]);
    }
    for (int k = 0; k < 3; ++k) {
        const int next = (k + 1) % 3;
        Lanes *middle = rows[3 + k];
        for (int r = 0; r < CORNER_ROWS; ++r)
            middle[r] = 0.5f * (rows[k][r] + rows[next][r]);
        const Lanes3 x = {middle[CORNER_X], middle[CORNER_X + 1], middle[CORNER_X + 2]};
        const Lanes3 n = scale3(add3(normal[k], normal[next]), lanes_set(0.5f));
        const Lanes3 w = refract(light, light_direction(light, x), n);
        middle[ROW_NORMAL_LENGTH] = lanes_sqrt(dot3(n, n));
        middle[CORNER_W] = w.x;
        middle[CORNER_W + 1] = w.y;
        middle[CORNER_W + 2] = w.z;
        const Lanes3 across = cross3(d, sub3(x, o));
        aside[3 + k] = aside_of(across, w, d);
        f[3 + k] = line_f(across, w, d);
        bend = lanes_max(bend, abs_lanes(f[3 + k] - 0.5f * (f[k] + f[next])));
    }
    const Lanes low = min_of(f), high = max_of(f), level = tubes->level + 1.0f;
    const LaneMask turns = sine < TURN_SPREADS * spread;
    const LaneMask is_straight = (bend <= tree->bend_max * (high - low + blur)) & ~turns;
    const uint32_t crossed = lanes_bits(is_straight & (low <= blur) & (high > -blur)) & all;
    Tubes turned;
    if (crossed != 0) {
        turn_tubes(tubes, &turned);
        add_loose(&turned, crossed, &queues->parts);
    }
    const LaneMask is_split =
        ~is_straight & (low <= BULGE * bend + blur) & (high >= -BULGE * bend - blur);
    if ((lanes_bits(is_split) & all) == 0)
        return;
    /* Quadratic functions bend a quarter as much over half the length; half again for the rest. */
    const Lanes margin = (1.5f * 0.25f * BULGE) * bend;
    const LaneMask is_last =
        level >= lanes_select(turns, lanes_set((float)TURN_LEVEL_MAX), lanes_set((float)LEVEL_MAX));
    for (int p = 0; p < 4; ++p) {
        Tubes part;
        part.level = level;
        for (int k = 0; k < 3; ++k) {
            memcpy(part.rows[k], rows[PARTS[p][k]], sizeof part.rows[k]);
            part.f[k] = f[PARTS[p][k]];
        }
        const Lanes bottom = min_of(part.f), top = max_of(part.f);
        const LaneMask arrives =
            can_arrive(aside[PARTS[p][0]], aside[PARTS[p][1]], aside[PARTS[p][2]], 0.5f * size,
                       0.5f * spread + tree->blur, limit);
        const LaneMask is_bent =
            ((margin > (BULGE * tree->bend_max) * (top - bottom + blur)) | turns) &
            (bottom < margin + blur) & (top > -margin - blur) & ~is_last & arrives;
        const LaneMask is_crossed = (bottom <= blur) & (top > -blur) & ~is_bent & arrives;
        const uint32_t bent = lanes_bits(is_split & is_bent) & all;
        const uint32_t whole = lanes_bits(is_split & is_crossed) & all;
        if (whole != 0) {
            turn_tubes(&part, &turned);
            add_loose(&turned, whole, &queues->parts);
        }
        if (bent != 0)
            add_loose(&part, bent, &queues->bent);
    }
}

/* Takes what waits by vectors, or all that there is. Bent tubes are quartered last in, first out,
 * so that few wait: each level leaves at most three quarters of the parts of one vector behind. */
static inline void empty_queues(const TubeTree *tree, const Medium *medium, const Query *q,
                                Queues *queues, bool is_last, Sums *sums) {
    const uint32_t least = is_last ? 1 : LANE_COUNT;
    Tubes tubes;
    while (queues->crossed.count >= least) {
        take_crossed(tree, &queues->crossed, &tubes);
        gather_crossed(&tubes, tree, medium, q, sums);
    }
    while (queues->bent.count >= least || queues->parts.count >= least) {
        while (queues->parts.count >= LANE_COUNT ||
               (queues->parts.count >= least && queues->bent.count < least)) {
            take_loose(&queues->parts, &tubes);
            gather_crossed(&tubes, tree, medium, q, sums);
        }
        if (queues->bent.count >= least) {
            const uint32_t count = take_loose(&queues->bent, &tubes);
            refine_tubes(&tubes, count, tree, q, queues);
        }
    }
}

/* Everything of the patches found but what is left in the queues. */
static inline void gather_patches(const TubeTree *tree, const Medium *medium, const Query *q,
                                  Patches *patches, Queues *queues, Sums *sums) {
    touch_patches(tree, q, patches);
    for (uint32_t i = 0; i < patches->touched_count; ++i) {
        find_crossings(tree, patches->touched[i], patches->tubes[i], patches->reaches[i],
                       patches->f[i], patches->may_turn[i], queues);
        if (queues->crossed.count >= QUEUE_FULL || queues->bent.count >= QUEUE_FULL)
            empty_queues(tree, medium, q, queues, false, sums);
    }
}

/* False, and nothing is known, where a tube's light runs along the ray and that is not allowed. */
static inline bool gather_ray(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                              float length, bool has_frequency, bool may_be_parallel,
                              FieldRadiance *out) {
    const Vec3 from = vec3_sub(o, tree->center);
    Query q = {.d = d, .near = vec3_dot(from, d), .has_frequency = has_frequency};
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
    Patches patches;
    patches.found_count = 0;
    patches.is_parallel = false;
    Queues queues;
    queues.crossed.count = queues.parts.count = queues.bent.count = 0;
    uint32_t stack[STACK_MAX];
    uint8_t levels[STACK_MAX];
    uint32_t depth = 1;
    stack[0] = 0;
    levels[0] = (uint8_t)(tree->level_count - 1);
    while (depth > 0) {
        /* From the top; the ones below are of the same level, or of a higher one. */
        const uint32_t count = depth < NODES ? depth : NODES;
        depth -= count;
        uint32_t level[NODES], index[NODES];
        const TubeNode *nodes[NODES];
        for (uint32_t k = 0; k < NODES; ++k) {
            const uint32_t place = depth + (k < count ? k : 0);
            level[k] = levels[place];
            index[k] = stack[place];
            nodes[k] = &tree->nodes[tree->first[level[k]] + index[k]];
        }
        const uint32_t hit = children_hit(nodes[0], nodes[NODES - 1], &q);
        for (uint32_t k = 0; k < count; ++k) {
            const uint32_t bits = hit >> (k * TUBE_LANES) & 0xFFu;
            const uint32_t first = index[k] * TUBE_LANES;
            if (level[k] > 0) {
                lanes_store_numbers(stack + depth, first, bits);
                memset(levels + depth, (int)level[k] - 1, TUBE_LANES);
                depth += (uint32_t)__builtin_popcount(bits);
            } else {
                lanes_store_numbers(patches.found + patches.found_count, first, bits);
                patches.found_count += (uint32_t)__builtin_popcount(bits);
            }
        }
        if (patches.found_count >= PATCHES_FULL)
            gather_patches(tree, medium, &q, &patches, &queues, &sums);
    }
    gather_patches(tree, medium, &q, &patches, &queues, &sums);
    if (patches.is_parallel && !may_be_parallel)
        return false;
    empty_queues(tree, medium, &q, &queues, true, &sums);
    out->radiance =
        rgb(lanes_sum(sums.radiance[0]), lanes_sum(sums.radiance[1]), lanes_sum(sums.radiance[2]));
    out->frequency = lanes_sum(sums.frequency) / 3.0f;
    out->contribution = rgb_mean(out->radiance);
    out->reflected = out->passed = rgb(0, 0, 0);
    return true;
}

FieldRadiance AMB_TUBE_GATHER(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                              float length, bool has_frequency) {
    FieldRadiance out;
    if (gather_ray(tree, medium, o, d, length, has_frequency, false, &out))
        return out;
    Vec3 x, y;
    vec3_frame(d, &x, &y);
    /* Turned out of one light's direction it may be in another's, which then loses some. */
    gather_ray(tree, medium, o, vec3_normalize(vec3_madd(d, NUDGE, x)), length, has_frequency, true,
               &out);
    return out;
}
