/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, eight of them at a time, sixteen with AVX-512. Built once for each
 * instruction set, with AMB_TUBE_GATHER set to the name of the variant. */
#include "field/tubes/tube_gather.h"

#include <stddef.h>

#include "field/straight_lanes.h"
#include "math/lanes.h"
#include "optics/medium_lanes.h"

#if !defined(AMB_TUBE_GATHER)
#error "AMB_TUBE_GATHER names the variant"
#endif

enum {
    BOXES = LANE_COUNT / TUBE_LANES, /* of children looked at together */
    HALVES = PATCH_CORNERS / LANE_COUNT,
    /* Of each level wait the children of one node, at most. */
    STACK_MAX = (TUBE_LEVEL_MAX + 1) * TUBE_LANES
};

_Static_assert((int)TUBE_LANES == 8, "bits of children are taken by eight");
_Static_assert((int)PATCH_CORNERS == 16, "bits of corners are words");
_Static_assert((int)PATCH_TUBES == 16, "and so are those of tubes");
_Static_assert((int)TUBE_PACKET == (int)PATCH_CORNERS, "rays fill as many vectors as corners");

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
    float inverse[3];
    float near, far;
    float straight[3];
    bool has_frequency, has_straight;
} Query;

typedef struct Sums {
    Lanes radiance[3];
    Lanes straight_once[3], straight_more[3];
    Lanes frequency;
} Sums;

/* The medium that the light goes through. */
typedef struct Matter {
    const Medium *medium;
    float sigma_t[3], mean, max; /* 1/m */
    bool fades;                  /* see FADE_MIN */
} Matter;

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

/* Children of a node that the line of the ray meets, above which places are looked at, too: where
 * view and light are not near each other lines alone tell nearly all. */
enum { MANY_LINES = 4 };
/* So many rays are faster one after the other, through all children at once. */
enum { FEW_RAYS = 3 };

static inline LaneMask meets(Lanes middle, Lanes reach) {
    return abs_lanes(middle) <= reach;
}

/* Bit i is set where the line may meet light of child i. */
static inline uint32_t lines_hit(const TubeNode *node, const float line[LINE_AXES]) {
    Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
    for (int a = 0; a < LINE_AXES; ++a) {
        middle += line[a] * lanes_load_two(node->middle[a], node->middle[a]);
        reach += fabsf(line[a]) * lanes_load_two(node->extent[a], node->extent[a]);
    }
    return lanes_bits(meets(middle, reach)) & 0xFFu;
}

/* Of those children, the ones whose light may meet the segment. */
static inline uint32_t places_hit(const TubeNode *node, const Query *q, uint32_t lines) {
    uint32_t places = 0;
    const float o[3] = {q->o.x, q->o.y, q->o.z};
    for (int k = 0; k < TUBE_QUARTERS && (lines & ~places) != 0; k += BOXES) {
        Lanes near = lanes_set(q->near), far = lanes_set(q->far);
        for (int a = 0; a < 3; ++a) {
            const Lanes low = lanes_load_two(node->low[k][a], node->low[k + BOXES - 1][a]);
            const Lanes high = lanes_load_two(node->high[k][a], node->high[k + BOXES - 1][a]);
            const Lanes t0 = (low - o[a]) * q->inverse[a], t1 = (high - o[a]) * q->inverse[a];
            near = lanes_max(near, lanes_min(t0, t1));
            far = lanes_min(far, lanes_max(t0, t1));
        }
        const uint32_t bits = lanes_bits(near <= far);
        places |= (bits | bits >> TUBE_LANES) & 0xFFu;
    }
    return lines & places;
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
    Lanes middle; /* m, where everything else is taken */
    Lanes change; /* m, from one end to the other */
    Lanes ahead;  /* of the stretch, from its middle to there, towards the shorter way */
    /* Where the light is thick: */
    Lanes near;  /* m, at the end where it is shorter */
    Lanes ratio; /* of `over` (see Meeting) at the near end to that at the far one */
} Way;

/* Optical length of a tree's tubes along the boundary below which their light does not fade enough
 * for that: flux would have to double along a tube to be wrong by a two hundredth. */
static const float FADE_MIN = 0.03f;

/* Where the light fades along the stretch, most of it is not in the middle: flux that changes along
 * it, as where light grazes a wall, must not be taken from there. int u exp(-2 y u) du over that of
 * the exponential alone, -1/2 < u < 1/2, is -(coth y - 1/y) / 2. */
static inline Lanes ahead_of_middle(float sigma_t, const Way *way, bool may_be_thick) {
    const Lanes y = (0.5f * sigma_t) * abs_lanes(way->change);
    const Lanes y2 = y * y;
    const Lanes thin = y * (1.0f / 6.0f - y2 * (1.0f / 90.0f - y2 * (1.0f / 945.0f)));
    const LaneMask is_thick = y > 1.0f;
    if (!may_be_thick || lanes_bits(is_thick) == 0)
        return thin;
    const Lanes twice = 2.0f * lanes_max(y, lanes_set(1.0f));
    const Lanes left = lanes_exp_negative(-twice);
    const Lanes u = 1.0f / twice - left / (1.0f - left);
    return lanes_select(is_thick, 0.5f - way->ratio * u / (1.0f - u + u * way->ratio), thin);
}

/* Mean of exp(-sigma_t way) over the stretch. Thin: the value in the middle times sinh(y)/y, y =
 * sigma_t change / 2. Thick: the light is gone in the middle, and what counts is the near end. From
 * there, places on the chord follow the part u of the way as q = r u / (1 - u + r u), r the ratio,
 * since way is a quotient of linear functions; dq/du is taken in the middle of what fades. */
static inline Lanes fade_along(float sigma_t, const Way *way, bool may_be_thick) {
    const Lanes y = (0.5f * sigma_t) * abs_lanes(way->change);
    const Lanes y2 = y * y;
    /* Back to the middle: the way there is longer. */
    const Lanes thin = lanes_exp_negative(-sigma_t * way->middle - 2.0f * y * way->ahead) *
                       (1.0f + y2 * (1.0f / 6.0f + y2 * (1.0f / 120.0f + y2 * (1.0f / 5040.0f))));
    const LaneMask is_thick = y > 1.0f;
    if (!may_be_thick || lanes_bits(is_thick) == 0)
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
    WAITING_ROOM = QUEUE_FULL + PATCH_TUBES + LANE_COUNT, /* one patch more, written by vectors */
    /* Those that wait for one ray, then what quartering adds to each level (see empty_queues), and
     * the next four parts as they are written. */
    LOOSE_ROOM = QUEUE_FULL + 2 * PATCH_TUBES + 3 * LANE_COUNT * 10 + 5 * LANE_COUNT
};
/* Rows must not displace each other from the cache. */
_Static_assert(LOOSE_ROOM % 256 != 0, "rows lie a power of two apart");

/* Tubes of patches, for one ray: the patches, and the tubes' codes there. */
typedef struct Waiting {
    uint32_t patches[WAITING_ROOM];
    uint32_t codes[WAITING_ROOM];
    uint32_t count;
} Waiting;

/* Tubes by themselves. */
typedef struct LooseQueue {
    float rows[3 * CORNER_ROWS + 4][LOOSE_ROOM];
    uint32_t count;
} LooseQueue;

typedef struct Queues {
    LooseQueue parts; /* crossed, parts of quartered ones */
    LooseQueue bent;  /* to be looked at more closely */
} Queues;

/* Rays that go through the tree together. What one of them finds, and in which order, depends on
 * that ray alone. */
typedef struct Packet {
    _Alignas(64) float axes[LINE_AXES][TUBE_PACKET]; /* d and o x d, side by side */
    float o[3][TUBE_PACKET];
    float line[TUBE_PACKET][LINE_AXES]; /* the same, ray by ray */
    Query queries[TUBE_PACKET];
    Sums sums[TUBE_PACKET];
    Waiting touched[TUBE_PACKET]; /* the zero curve may touch them */
    Waiting bent[TUBE_PACKET];    /* it does, and they must be looked at more closely */
    uint32_t count;
    uint32_t parallel; /* bits: all light of a tube runs along the ray, which meets it everywhere */
} Packet;

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
    if (tree->light.value == TUBE_VALUE_IS_FLUX) { /* reflected: there is a way before */
        uint32_t patch[LANE_COUNT], corner[LANE_COUNT];
        memcpy(patch, &patches, sizeof patch);
        memcpy(corner, &corners, sizeof corner);
        __asm__("" : "+m"(patch), "+m"(corner));
        for (int i = 0; i < LANE_COUNT; ++i)
            rows[ROW_START][i] = tree->patches[patch[i]].starts[corner[i]];
    }
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

/* Values at the corners, that of the odd one first. */
typedef struct Turned {
    Lanes v, b, c;
} Turned;

static inline Turned turn(const Odd *odd, Lanes v0, Lanes v1, Lanes v2) {
    const Lanes later = lanes_select(odd->is_second, v1, v2);
    return (Turned){lanes_select(odd->is_first, v0, later), lanes_select(odd->is_first, v1, v0),
                    lanes_select(odd->is_first | odd->is_second, v2, v1)};
}

static inline LaneMask load_numbers(const uint32_t numbers[LANE_COUNT]) {
    LaneMask lanes;
    memcpy(&lanes, numbers, sizeof lanes);
    return lanes;
}

/* Corners of the last tubes of a list, a vector or what there is, and what they are; the count.
 * f is not set. */
static inline uint32_t take_waiting(const TubeTree *tree, Waiting *list, Tubes *out,
                                    LaneMask *out_patches, LaneMask *out_codes) {
    const uint32_t count = list->count < LANE_COUNT ? list->count : LANE_COUNT;
    list->count -= count;
    const LaneMask is_there = lanes_below(count);
    const LaneMask patches = load_numbers(list->patches + list->count) & is_there;
    const LaneMask codes = load_numbers(list->codes + list->count) & is_there;
    for (int k = 0; k < 3; ++k)
        load_corners(tree, patches, codes >> (4 * k) & 15, out->rows[k]);
    out->level = lanes_set(0.0f);
    *out_patches = patches;
    *out_codes = codes;
    return count;
}

/* Adds those of a patch whose bits are set. */
static inline void add_waiting(Waiting *list, LaneMask patches, LaneMask codes, uint32_t bits) {
    const LanePack pack = lanes_pack_for(bits);
    memcpy(list->patches + list->count, &patches, sizeof patches);
    lanes_pack_numbers(list->codes + list->count, codes, &pack);
    list->count += (uint32_t)__builtin_popcount(bits);
}

/* Sine between light and view below which single precision does not tell where they meet, and the
 * angle by which the view is then turned: less than a pixel. */
static const float PARALLEL_SINE = 5e-5f;
static const float NUDGE = 2e-4f;

/* Where light is nearer to the view's direction than twice as far as it differs between corners, it
 * may turn over from one side of the view to the other. The whole segment is then lit through a
 * small part of a tube, and what is linear over all of the tube is not good enough. */
static const float TURN_SPREADS = 2.0f;

/* f at the corners of a patch whose light runs nearly along the ray; whether all light of a tube is
 * parallel to it. */
static inline bool near_parallel_f(const TubePatch *patch, const Query *q, Lanes out[HALVES]) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
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
        const Lanes3 across = cross3(d, w);
        parallel |=
            lanes_bits((dot3(across, across) < PARALLEL_SINE * PARALLEL_SINE) & (dot3(w, w) > 0.0f))
            << (h * LANE_COUNT);
    }
    for (int k = 0; k < PATCH_TUBES && parallel != 0; ++k)
        if (patch->masks[k] != 0 && (patch->masks[k] & ~parallel) == 0)
            return true;
    return false;
}

/* Cosine between light and ray beyond which f is a difference of large numbers in Pluecker
 * coordinates. */
static const float PARALLEL_COS = 0.98f;

/* Adds to the lists of the rays the tubes of a patch that the zero curve may touch. */
static inline void touch_patch(const TubeTree *tree, uint32_t p, uint32_t rays, Packet *packet) {
    const TubePatch *patch = &tree->patches[p];
    float margins[TUBE_PACKET];
    uint32_t near_parallel = 0;
    for (uint32_t i = 0; i < packet->count; i += LANE_COUNT) {
        const Lanes3 d = {lanes_load(packet->axes[0] + i), lanes_load(packet->axes[1] + i),
                          lanes_load(packet->axes[2] + i)};
        const Lanes3 o = {lanes_load(packet->o[0] + i), lanes_load(packet->o[1] + i),
                          lanes_load(packet->o[2] + i)};
        const Lanes3 w = set3(vec3(patch->lines[3][0], patch->lines[4][0], patch->lines[5][0]));
        near_parallel |= lanes_bits(abs_lanes(dot3(w, d)) > PARALLEL_COS) << i;
        /* No corner is farther from the ray. */
        const Lanes3 across = cross3(sub3(set3(patch->center), o), d);
        const Lanes reach = lanes_sqrt(dot3(across, across)) + patch->radius;
        lanes_store(margins + i, (patch->bulge + tree->blur) * reach + tree->slack);
    }
    LaneMask codes[HALVES];
    for (int h = 0; h < HALVES; ++h)
        codes[h] = load_numbers(patch->codes + h * LANE_COUNT);
    const LaneMask patches = codes[0] * 0 + (int32_t)p;
    for (; rays != 0; rays &= rays - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(rays);
        Lanes values[HALVES];
        if ((near_parallel >> r & 1u) != 0) {
            if (near_parallel_f(patch, &packet->queries[r], values))
                packet->parallel |= 1u << r;
        } else {
            const float *line = packet->line[r];
            for (int h = 0; h < HALVES; ++h) {
                values[h] = lanes_set(0.0f);
                for (int a = 0; a < LINE_AXES; ++a)
                    values[h] += line[a] * lanes_load(patch->lines[a] + h * LANE_COUNT);
            }
        }
        const float margin = margins[r];
        uint32_t above = 0, below = 0;
        for (int h = 0; h < HALVES; ++h) {
            above |= lanes_bits(values[h] > -margin) << (h * LANE_COUNT);
            below |= lanes_bits(values[h] < margin) << (h * LANE_COUNT);
        }
        const uint32_t tubes = words_meeting(patch->masks, above, below);
        for (int h = 0; h < HALVES; ++h)
            add_waiting(&packet->touched[r], patches, codes[h],
                        tubes >> (h * LANE_COUNT) & LANES_ALL);
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

/* An end of a chord: its light line and what the tube has there. */
typedef struct End {
    Lanes3 from, w; /* from the camera ray's o */
    Lanes value;    /* or its root: see ChordGather */
    Lanes limit, start;
} End;

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
    LaneMask is_root; /* of values the ends have the roots */
    const Tubes *tubes;
    const TubeLight *light;
    const Matter *matter;
    const Query *q;
    Sums *sums;
} ChordGather;

/* Adds what a chord from b to c sends along the segment, density per part of the chord; n tells the
 * side, on all of the chord the same, from which light meets the segment. A call would pass all of
 * it through memory, for a twentieth of the render's time. */
__attribute__((always_inline)) static inline void gather_chord(const ChordGather *gather,
                                                               const End *b, const End *c,
                                                               Lanes density, Lanes3 n,
                                                               LaneMask is_hit) {
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

    /* The way to the ends of the chord's part. */
    const Matter *matter = gather->matter;
    const Lanes path_b = meet_b.along + meet_b.depth, path_c = meet_c.along + meet_c.depth;
    const Lanes over0 = lerp(meet_b.over, meet_c.over, q0);
    const Lanes over1 = lerp(meet_b.over, meet_c.over, q1);
    const Lanes path0 = lerp(path_b, path_c, q0), path1 = lerp(path_b, path_c, q1);
    const Lanes start0 = lerp(b->start, c->start, q0), start1 = lerp(b->start, c->start, q1);
    Way way = {.ahead = zero,
               .change = (path1 * over0 - path0 * over1) / (over0 * over1) + (start1 - start0)};
    const bool may_be_thick = lanes_bits((0.5f * matter->max) * abs_lanes(way.change) > 1.0f) != 0;
    if (may_be_thick) {
        /* Between corners directions are shorter than unit. */
        const Lanes3 mean = lerp3(b->w, c->w, half);
        const Lanes missing = lanes_sqrt(dot3(mean, mean)) - 1.0f;
        const Lanes depth0 = lerp(meet_b.depth, meet_c.depth, q0);
        const Lanes depth1 = lerp(meet_b.depth, meet_c.depth, q1);
        const Lanes way0 = (path0 + missing * depth0) / over0 + start0;
        const Lanes way1 = (path1 + missing * depth1) / over1 + start1;
        const LaneMask is_rising = way0 < way1;
        way.change = way1 - way0;
        way.near = lanes_max(lanes_min(way0, way1) - q->near, zero);
        way.ratio = lanes_select(is_rising, over0, over1) / lanes_select(is_rising, over1, over0);
    }

    /* Everything else where most of the light is: in the middle of that part, but for what fades
     * along it. */
    Lanes qm = half * (q0 + q1);
    if (matter->fades) {
        way.ahead = ahead_of_middle(matter->mean, &way, may_be_thick);
        qm -= lanes_select(way.change > 0.0f, way.ahead, -way.ahead) * (q1 - q0);
    }
    const Lanes3 w = lerp3(b->w, c->w, qm), normal = cross3(d, w);
    const Lanes inverse = 1.0f / lanes_max(lerp(meet_b.over, meet_c.over, qm), lanes_set(SIN2_MIN));
    const Lanes unit2 = dot3(w, w);
    const Lanes unit = lanes_sqrt(unit2);
    const Lanes t = lanes_max(lerp(meet_b.along, meet_c.along, qm) * inverse - q->near, zero);
    const Lanes s = lanes_max(lerp(meet_b.depth, meet_c.depth, qm) * inverse, zero);
    way.middle = s * unit + t + lerp(b->start, c->start, qm);

    const TubeLight *light = gather->light;
    Lanes scatter[3];
    medium_scattering_lanes(matter->medium, dot3(w, d) / unit, dot3(normal, normal) / unit2,
                            scatter);
    const Lanes3 area = area_of(gather->tubes);
    const Lanes part = q1 - q0;
    Lanes value = lerp(b->value, c->value, qm);
    if (light->value == TUBE_VALUE_LEAVES) {
        /* The mean of a square is that of the middle and the variance. */
        const Lanes change = (c->value - b->value) * part;
        const Lanes square = value * value + change * change * (1.0f / 12.0f);
        value = lanes_select(gather->is_root, square, value);
    }
    value *= flux_share(gather->tubes, light, area, w, unit) * density * part;
    const float *sigma_t = matter->sigma_t;
    const float color[3] = {light->color.r, light->color.g, light->color.b};
    StraightStretch stretch = {zero, zero, zero, zero};
    if (q->has_straight) {
        /* Rounding may take ends of the chord beyond those of the segment. */
        const Lanes length = lanes_set(q->far - q->near);
        const Lanes along0 = lerp(meet_b.along, meet_c.along, q0);
        const Lanes along1 = lerp(meet_b.along, meet_c.along, q1);
        const Lanes center = (along0 + along1) / (over0 + over1) - q->near;
        const Lanes first = lanes_min(lanes_max(along0 / over0 - q->near, zero), length);
        const Lanes last = lanes_min(lanes_max(along1 / over1 - q->near, zero), length);
        const LaneMask is_rising = way.change > 0.0f;
        stretch.near = lanes_select(is_rising, first, last);
        stretch.span = lanes_select(is_rising, last, first) - stretch.near;
        stretch.bend = lanes_min(lanes_max(center, zero), length) - half * (first + last);
    }
    Lanes total = zero, fade = zero;
    for (int k = 0; k < 3; ++k) {
        if (k == 0 || sigma_t[k] != sigma_t[k - 1])
            fade = fade_along(sigma_t[k], &way, may_be_thick);
        const Lanes arrives = lanes_select(is_hit, value * color[k] * scatter[k] * fade, zero);
        gather->sums->radiance[k] += arrives;
        total += arrives;
        if (q->has_straight) {
            stretch.depth = lanes_select(is_hit, sigma_t[k] * abs_lanes(way.change), zero);
            straight_along(&stretch, q->straight[k], arrives, &gather->sums->straight_once[k],
                           &gather->sums->straight_more[k]);
        }
    }
    if (q->has_frequency)
        gather->sums->frequency +=
            lanes_select(is_hit, total * frequency_of(gather->tubes, area, w, s), zero);
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

__attribute__((noinline)) static void gather_turning(const ChordGather *gather, const End *b,
                                                     const End *c, Lanes density, Lanes3 n,
                                                     Lanes over_b, Lanes over_c, LaneMask is_hit) {
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

/* The ends of the chord, on the edges from the odd corner, at parts cut_b and cut_c of them. Of
 * values the roots are linear over a tube, where its corners have them and all are lit: is_root. */
static inline LaneMask chord_ends(const Tubes *tubes, const Odd *odd, Lanes cut_b, Lanes cut_c,
                                  uint32_t value, Lanes3 o, End *b, End *c) {
    Lanes *const ends[2][CORNER_SIZE] = {
        {&b->from.x, &b->from.y, &b->from.z, &b->w.x, &b->w.y, &b->w.z, &b->value, &b->limit},
        {&c->from.x, &c->from.y, &c->from.z, &c->w.x, &c->w.y, &c->w.z, &c->value, &c->limit}};
    LaneMask is_root = {0};
#pragma GCC unroll 8
    for (int r = 0; r < CORNER_SIZE; ++r) {
        Turned t = turn(odd, tubes->rows[0][r], tubes->rows[1][r], tubes->rows[2][r]);
        if (r == CORNER_VALUE && value == TUBE_VALUE_LEAVES) {
            is_root = lanes_min(t.v, lanes_min(t.b, t.c)) > 0.0f;
            if (lanes_bits(is_root) != LANES_ALL) {
                t.v = lanes_select(is_root, t.v, t.v * t.v);
                t.b = lanes_select(is_root, t.b, t.b * t.b);
                t.c = lanes_select(is_root, t.c, t.c * t.c);
            }
        }
        *ends[0][r] = t.v + cut_b * (t.b - t.v);
        *ends[1][r] = t.v + cut_c * (t.c - t.v);
    }
    b->from = sub3(b->from, o);
    c->from = sub3(c->from, o);
    b->start = c->start = lanes_set(0.0f);
    if (value == TUBE_VALUE_IS_FLUX) {
        const Turned t = turn(odd, tubes->rows[0][ROW_START], tubes->rows[1][ROW_START],
                              tubes->rows[2][ROW_START]);
        b->start = t.v + cut_b * (t.b - t.v);
        c->start = t.v + cut_c * (t.c - t.v);
    }
    return is_root;
}

/* Adds what tubes that are crossed send along the segment. A lane whose f does not
 * change its sign counts for nothing. */
static inline void gather_tubes(const Tubes *tubes, const Lanes *soft, const TubeTree *tree,
                                const Matter *matter, const Query *q, Sums *sums) {
    const TubeLight *light = &tree->light;
    const Lanes one = lanes_set(1.0f), half = lanes_set(0.5f);
    const Lanes3 d = set3(q->d), o = set3(q->o);
    const Odd odd = odd_corner(tubes->f);
    const Turned f = turn(&odd, tubes->f[0], tubes->f[1], tubes->f[2]);
    const LaneMask is_hit = (f.v > 0.0f) != (f.b > 0.0f);
    const Lanes gap_b = lanes_select(is_hit, f.v - f.b, one);
    const Lanes gap_c = lanes_select(is_hit, f.v - f.c, one);
    /* Where the zero curve enters the triangle and where it leaves, on the edges from the odd
     * corner. */
    const Lanes cut_b = f.v / gap_b, cut_c = f.v / gap_c;
    const Lanes density = soft != NULL ? *soft : 2.0f * cut_b / abs_lanes(gap_c);
    End b, c;
    const LaneMask is_root = chord_ends(tubes, &odd, cut_b, cut_c, light->value, o, &b, &c);
    const ChordGather gather = {is_root, tubes, light, matter, q, sums};
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
 * what is covered, on which f becomes zero. */
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
    const Odd odd = odd_corner(tubes->f);
    const Turned f = turn(&odd, tubes->f[0], tubes->f[1], tubes->f[2]);
    const Lanes tiny = lanes_set(1e-30f);
    const Lanes gaps = (f.v - f.b) * (f.v - f.c);
    const Lanes sharp = 2.0f * abs_lanes(f.v) / lanes_max(abs_lanes(gaps), tiny);
    return lanes_select(is_sharp, sharp, covered / lanes_max(2.0f * half, tiny));
}

/* Adds what tubes send that are crossed, or nearly. */
static inline void gather_crossed(Tubes *tubes, const TubeTree *tree, const Matter *matter,
                                  const Query *q, Sums *sums) {
    if (tree->blur > 0.0f) {
        const Lanes density = soften_tubes(tubes, &tree->light, q, matter->mean);
        gather_tubes(tubes, &density, tree, matter, q, sums);
    } else {
        gather_tubes(tubes, NULL, tree, matter, q, sums);
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
    Lanes sine = lanes_set(1.0f), blur = lanes_set(0.0f); /* blur: as in gather_touched */
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
    if (crossed != 0)
        add_loose(tubes, crossed, &queues->parts);
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
        if (whole != 0)
            add_loose(&part, whole, &queues->parts);
        if (bent != 0)
            add_loose(&part, bent, &queues->bent);
    }
}

/* Takes all that there is, by vectors as long as they are full. Bent tubes are quartered last in,
 * first out, so that few wait: each level leaves at most three quarters of the parts of one vector
 * behind. */
static inline void empty_queues(const TubeTree *tree, const Matter *matter, const Query *q,
                                Queues *queues, Sums *sums) {
    Tubes tubes;
    while (queues->bent.count > 0 || queues->parts.count > 0) {
        while (queues->parts.count >= LANE_COUNT ||
               (queues->parts.count > 0 && queues->bent.count == 0)) {
            take_loose(&queues->parts, &tubes);
            gather_crossed(&tubes, tree, matter, q, sums);
        }
        if (queues->bent.count > 0) {
            const uint32_t count = take_loose(&queues->bent, &tubes);
            refine_tubes(&tubes, count, tree, q, queues);
        }
    }
}

/* f at the corners of tubes, and how far the farthest is from the ray. */
static inline Lanes see_corners(Tubes *tubes, const Query *q) {
    const Lanes3 d = set3(q->d), o = set3(q->o);
    Lanes reach2 = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        const Lanes3 across = cross3(d, sub3(row3(tubes, k, CORNER_X), o));
        tubes->f[k] = line_f(across, row3(tubes, k, CORNER_W), d);
        reach2 = lanes_max(reach2, dot3(across, across));
    }
    return lanes_sqrt(reach2);
}

/* Where light may turn over from one side of the view to the other inside a tube. */
static inline LaneMask may_turn(const Tubes *tubes, Lanes3 d) {
    Lanes sin2 = lanes_set(1.0f), spread2 = lanes_set(0.0f);
    for (int k = 0; k < 3; ++k) {
        const Lanes3 w = row3(tubes, k, CORNER_W), across = cross3(d, w);
        const Lanes3 change = sub3(row3(tubes, (k + 1) % 3, CORNER_W), w);
        sin2 = lanes_min(sin2, dot3(across, across));
        spread2 = lanes_max(spread2, dot3(change, change));
    }
    return sin2 < TURN_SPREADS * TURN_SPREADS * spread2;
}

/* See tube_code_bulge. */
static inline Lanes bulge_of(LaneMask codes) {
    const LaneMask number = codes >> CODE_BULGE;
    return (Lanes)((number + CODE_BULGE_BASE) << 20 & (number != 0));
}

/* Looks more closely at all tubes of a ray that wait for it. */
static inline void gather_bent(const TubeTree *tree, const Matter *matter, Packet *packet,
                               uint32_t r, Queues *queues) {
    const Query *q = &packet->queries[r];
    while (packet->bent[r].count > 0) {
        Tubes tubes;
        LaneMask patches, codes;
        const uint32_t count = take_waiting(tree, &packet->bent[r], &tubes, &patches, &codes);
        see_corners(&tubes, q);
        add_loose(&tubes, (1u << count) - 1u, &queues->bent);
    }
    empty_queues(tree, matter, q, queues, &packet->sums[r]);
}

/* Adds what touched tubes of a ray send, by vectors, as long as `least` of them wait. */
static inline void gather_touched(const TubeTree *tree, const Matter *matter, Packet *packet,
                                  uint32_t r, uint32_t least, Queues *queues) {
    const Query *q = &packet->queries[r];
    const Lanes3 d = set3(q->d);
    const Lanes zero = lanes_set(0.0f);
    Waiting *list = &packet->touched[r];
    while (list->count >= least) {
        Tubes tubes;
        LaneMask patches, codes;
        const uint32_t count = take_waiting(tree, list, &tubes, &patches, &codes);
        const Lanes reach = see_corners(&tubes, q);
        const LaneMask is_there = lanes_below(count);
        const Lanes blur = tree->blur * reach; /* f is averaged over so much to either side */
        const Lanes low = min_of(tubes.f), high = max_of(tubes.f);
        const Lanes margin = bulge_of(codes) * reach;
        Lanes bend_max = (BULGE * tree->bend_max) * (high - low + blur);
        const Lanes cosine = abs_lanes(dot3(row3(&tubes, 0, CORNER_W), d));
        const LaneMask is_near = cosine > PARALLEL_COS;
        if (lanes_bits(is_near) != 0)
            bend_max = lanes_select(is_near & may_turn(&tubes, d), zero, bend_max);
        const LaneMask is_bent =
            (margin > bend_max) & (low < margin + blur) & (high > -margin - blur) & is_there;
        const uint32_t bent = lanes_bits(is_bent);
        if (bent != 0) {
            const LanePack pack = lanes_pack_for(bent);
            Waiting *bends = &packet->bent[r];
            lanes_pack_numbers(bends->patches + bends->count, patches, &pack);
            lanes_pack_numbers(bends->codes + bends->count, codes, &pack);
            bends->count += (uint32_t)__builtin_popcount(bent);
            if (bends->count >= QUEUE_FULL)
                gather_bent(tree, matter, packet, r, queues);
        }
        const LaneMask is_crossed = (low <= blur) & (high > -blur) & is_there & ~is_bent;
        const uint32_t crossed = lanes_bits(is_crossed);
        if (crossed == 0)
            continue;
        if (count < LANE_COUNT) { /* the last ones, with what quartering will leave */
            add_loose(&tubes, crossed, &queues->parts);
            continue;
        }
        for (int k = 0; k < 3; ++k)
            tubes.f[k] = (Lanes)((LaneMask)tubes.f[k] & is_crossed);
        gather_crossed(&tubes, tree, matter, q, &packet->sums[r]);
    }
}

static inline void start_ray(const TubeTree *tree, const TubeRay *ray, uint32_t r, Packet *packet) {
    const Vec3 from = vec3_sub(ray->o, tree->center), d = ray->d;
    Query *q = &packet->queries[r];
    *q = (Query){.d = d,
                 .near = vec3_dot(from, d),
                 .straight = {ray->straight.r, ray->straight.g, ray->straight.b},
                 .has_frequency = ray->has_frequency,
                 .has_straight = rgb_max(ray->straight) > 0.0f};
    q->far = q->near + ray->length;
    q->o = vec3_madd(from, -q->near, d);
    const Vec3 moment = vec3_cross(q->o, d);
    const float axes[3] = {d.x, d.y, d.z}, o[3] = {q->o.x, q->o.y, q->o.z};
    const float moments[3] = {moment.x, moment.y, moment.z};
    for (int a = 0; a < 3; ++a) {
        /* 0 * infinity is not a number: a direction without this component gets a huge slope. */
        const float component = fabsf(axes[a]) < 1e-20f ? copysignf(1e-20f, axes[a]) : axes[a];
        q->inverse[a] = 1.0f / component;
        packet->o[a][r] = o[a];
        packet->line[r][a] = packet->axes[a][r] = axes[a];
        packet->line[r][3 + a] = packet->axes[3 + a][r] = moments[a];
    }
    const Lanes zero = lanes_set(0.0f);
    packet->sums[r] = (Sums){{zero, zero, zero}, {zero, zero, zero}, {zero, zero, zero}, zero};
    packet->touched[r].count = packet->bent[r].count = 0;
}

/* Which of the rays may meet light of each child of a node. */
static inline void children_hit(const TubeNode *node, uint32_t rays, const Packet *packet,
                                uint32_t out[TUBE_LANES]) {
    if (__builtin_popcount(rays) <= FEW_RAYS) {
        memset(out, 0, TUBE_LANES * sizeof *out);
        for (; rays != 0; rays &= rays - 1) {
            const uint32_t r = (uint32_t)__builtin_ctz(rays);
            uint32_t hit = lines_hit(node, packet->line[r]);
            if (__builtin_popcount(hit) > MANY_LINES)
                hit = places_hit(node, &packet->queries[r], hit);
            for (; hit != 0; hit &= hit - 1)
                out[__builtin_ctz(hit)] |= 1u << r;
        }
        return;
    }
    uint32_t many = 0;
    memset(out, 0, TUBE_LANES * sizeof *out);
    for (uint32_t i = 0; i < packet->count; i += LANE_COUNT) {
        Lanes line[LINE_AXES], size[LINE_AXES];
        for (int a = 0; a < LINE_AXES; ++a) {
            line[a] = lanes_load(packet->axes[a] + i);
            size[a] = abs_lanes(line[a]);
        }
        LaneMask total = (LaneMask)lanes_set(0.0f);
        for (int c = 0; c < TUBE_LANES; ++c) {
            Lanes middle = lanes_set(0.0f), reach = lanes_set(0.0f);
            for (int a = 0; a < LINE_AXES; ++a) {
                middle += line[a] * node->middle[a][c];
                reach += size[a] * node->extent[a][c];
            }
            const LaneMask hit = meets(middle, reach);
            total -= hit;
            out[c] |= lanes_bits(hit) << i;
        }
        many |= lanes_bits(total > MANY_LINES) << i;
    }
    for (int c = 0; c < TUBE_LANES; ++c)
        out[c] &= rays;
    for (many &= rays; many != 0; many &= many - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(many);
        uint32_t lines = 0;
        for (uint32_t c = 0; c < TUBE_LANES; ++c)
            lines |= (out[c] >> r & 1u) << c;
        const uint32_t hit = places_hit(node, &packet->queries[r], lines);
        for (uint32_t c = 0; c < TUBE_LANES; ++c)
            out[c] &= ~(((~hit >> c) & 1u) << r);
    }
}

static inline void gather_lists(const TubeTree *tree, const Matter *matter, uint32_t rays,
                                Packet *packet, Queues *queues) {
    for (; rays != 0; rays &= rays - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(rays);
        if (packet->touched[r].count >= QUEUE_FULL)
            gather_touched(tree, matter, packet, r, LANE_COUNT, queues);
    }
}

static inline void gather_packet(const TubeTree *tree, const Matter *matter, Packet *packet) {
    Queues queues;
    queues.parts.count = queues.bent.count = 0;
    uint32_t stack[STACK_MAX];
    uint16_t rays[STACK_MAX];
    uint8_t levels[STACK_MAX];
    uint32_t depth = 1;
    stack[0] = 0;
    rays[0] = (uint16_t)((1u << packet->count) - 1u);
    levels[0] = (uint8_t)(tree->level_count - 1);
    while (depth > 0) {
        --depth;
        const uint32_t level = levels[depth], first = stack[depth] * TUBE_LANES;
        uint32_t hit[TUBE_LANES];
        children_hit(&tree->nodes[tree->first[level] + stack[depth]], rays[depth], packet, hit);
        for (uint32_t c = 0; c < TUBE_LANES; ++c) {
            if (hit[c] == 0)
                continue;
            if (level > 0) {
                stack[depth] = first + c;
                rays[depth] = (uint16_t)hit[c];
                levels[depth++] = (uint8_t)(level - 1);
            } else {
                touch_patch(tree, first + c, hit[c], packet);
                gather_lists(tree, matter, hit[c], packet, &queues);
            }
        }
    }
    for (uint32_t r = 0; r < packet->count; ++r) {
        gather_touched(tree, matter, packet, r, 1, &queues);
        gather_bent(tree, matter, packet, r, &queues);
    }
}

static inline Rgb sum_lanes(const Lanes sums[3]) {
    return rgb(lanes_sum(sums[0]), lanes_sum(sums[1]), lanes_sum(sums[2]));
}

static inline FieldRadiance sum_up(const Sums *sums) {
    FieldRadiance out = {.radiance = sum_lanes(sums->radiance),
                         .straight_once = sum_lanes(sums->straight_once),
                         .straight_more = sum_lanes(sums->straight_more),
                         .frequency = lanes_sum(sums->frequency) / 3.0f};
    out.contribution = rgb_mean(out.radiance);
    return out;
}

static inline void gather_rays(const TubeTree *tree, const Matter *matter, const TubeRay rays[],
                               uint32_t count, Packet *packet, FieldRadiance out[]) {
    packet->count = count;
    packet->parallel = 0;
    for (uint32_t r = 0; r < count; ++r)
        start_ray(tree, &rays[r], r, packet);
    gather_packet(tree, matter, packet);
    for (uint32_t r = 0; r < count; ++r)
        out[r] = sum_up(&packet->sums[r]);
}

void AMB_TUBE_GATHER(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                     uint32_t count, FieldRadiance out[]) {
    Packet packet;
    const Rgb sigma_t = medium->sigma_t;
    const float max = rgb_max(sigma_t);
    const Matter matter = {.medium = medium,
                           .sigma_t = {sigma_t.r, sigma_t.g, sigma_t.b},
                           .mean = rgb_mean(sigma_t),
                           .max = max,
                           .fades = max * tree->edge > FADE_MIN};
    gather_rays(tree, &matter, rays, count, &packet, out);
    for (uint32_t left = packet.parallel; left != 0; left &= left - 1) {
        const uint32_t r = (uint32_t)__builtin_ctz(left);
        TubeRay turned = rays[r];
        Vec3 x, y;
        vec3_frame(turned.d, &x, &y);
        /* Turned out of one light's direction it may be in another's, which then loses some. */
        turned.d = vec3_normalize(vec3_madd(turned.d, NUDGE, x));
        gather_rays(tree, &matter, &turned, 1, &packet, &out[r]);
    }
}
