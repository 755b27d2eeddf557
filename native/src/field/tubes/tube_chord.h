/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light of tubes that meets a ray: along a chord of each triangle, where f is 0. */
#ifndef AMB_FIELD_TUBES_TUBE_CHORD_H
#define AMB_FIELD_TUBES_TUBE_CHORD_H

#include "field/straight_lanes.h"
#include "field/tubes/tube_fade.h"
#include "field/tubes/tube_lanes.h"
#include "optics/medium_lanes.h"

/* sin^2 between a light line and the camera ray below which they count as parallel: their meeting
 * point is then known to no digit, and a smaller number would overflow. */
static const float SIN2_MIN = 1e-12f;

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
        return lanes_abs(facing);
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
    const Lanes begin = lanes_abs(dot3(area, w));
    const Lanes here = lanes_abs(0.5f * dot3(cross3(edge[0], edge[1]), w));
    return begin / lanes_max(begin + here, lanes_set(1e-30f));
}

/* An end of a chord: its light line and what the tube has there. */
typedef struct End {
    Lanes3 from, w; /* from the camera ray's o */
    Lanes value;    /* or its root: see ChordGather */
    Lanes limit, start;
} End;

static inline End end_between(const End *b, const End *c, Lanes q) {
    return (End){.from = lerp3(b->from, c->from, q),
                 .w = lerp3(b->w, c->w, q),
                 .value = lanes_lerp(b->value, c->value, q),
                 .limit = lanes_lerp(b->limit, c->limit, q),
                 .start = lanes_lerp(b->start, c->start, q)};
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
    const Lanes over0 = lanes_lerp(meet_b.over, meet_c.over, q0);
    const Lanes over1 = lanes_lerp(meet_b.over, meet_c.over, q1);
    const Lanes path0 = lanes_lerp(path_b, path_c, q0), path1 = lanes_lerp(path_b, path_c, q1);
    const Lanes start0 = lanes_lerp(b->start, c->start, q0),
                start1 = lanes_lerp(b->start, c->start, q1);
    Way way = {.ahead = zero,
               .change = (path1 * over0 - path0 * over1) / (over0 * over1) + (start1 - start0)};
    const bool may_be_thick = lanes_bits((0.5f * matter->max) * lanes_abs(way.change) > 1.0f) != 0;
    if (may_be_thick) {
        /* Between corners directions are shorter than unit. */
        const Lanes3 mean = lerp3(b->w, c->w, half);
        const Lanes missing = lanes_sqrt(dot3(mean, mean)) - 1.0f;
        const Lanes depth0 = lanes_lerp(meet_b.depth, meet_c.depth, q0);
        const Lanes depth1 = lanes_lerp(meet_b.depth, meet_c.depth, q1);
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
    const Lanes inverse =
        1.0f / lanes_max(lanes_lerp(meet_b.over, meet_c.over, qm), lanes_set(SIN2_MIN));
    const Lanes unit2 = dot3(w, w);
    const Lanes unit = lanes_sqrt(unit2);
    const Lanes t = lanes_max(lanes_lerp(meet_b.along, meet_c.along, qm) * inverse - q->near, zero);
    const Lanes s = lanes_max(lanes_lerp(meet_b.depth, meet_c.depth, qm) * inverse, zero);
    way.middle = s * unit + t + lanes_lerp(b->start, c->start, qm);

    const TubeLight *light = gather->light;
    Lanes scatter[3];
    medium_scattering_lanes(matter->medium, dot3(w, d) / unit, dot3(normal, normal) / unit2,
                            scatter);
    const Lanes3 area = area_of(gather->tubes);
    const Lanes part = q1 - q0;
    Lanes value = lanes_lerp(b->value, c->value, qm);
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
        const Lanes along0 = lanes_lerp(meet_b.along, meet_c.along, q0);
        const Lanes along1 = lanes_lerp(meet_b.along, meet_c.along, q1);
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
            stretch.depth = lanes_select(is_hit, sigma_t[k] * lanes_abs(way.change), zero);
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
        const Lanes side = lanes_sign(lanes_lerp(over_b, over_c, 0.5f * (begin + end)));
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
    const Lanes density = soft != NULL ? *soft : 2.0f * cut_b / lanes_abs(gap_c);
    End b, c;
    const LaneMask is_root = chord_ends(tubes, &odd, cut_b, cut_c, light->value, o, &b, &c);
    const ChordGather gather = {is_root, tubes, light, matter, q, sums};
    const Lanes3 n = cross3(d, lerp3(b.w, c.w, half)), turned = cross3(n, d);
    const Lanes over_b = dot3(b.w, turned), over_c = dot3(c.w, turned);
    const LaneMask turns =
        lanes_min(over_b, over_c) < TURN_RATIO * lanes_max(lanes_abs(over_b), lanes_abs(over_c));
    if (lanes_bits(is_hit & ~turns) != 0)
        gather_chord(&gather, &b, &c, density, n, is_hit & ~turns);
    if (lanes_bits(is_hit & turns) == 0)
        return;
    /* The middle may be parallel to the view and have no normal; the difference of the ends has. */
    const Lanes3 across = cross3(d, sub3(b.w, c.w)), tilted = cross3(across, d);
    gather_turning(&gather, &b, &c, density, across, dot3(b.w, tilted), dot3(c.w, tilted),
                   is_hit & turns);
}

#endif
