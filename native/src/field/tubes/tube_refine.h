/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tubes between whose corners light bends, quartered until it is as good as linear. */
#ifndef AMB_FIELD_TUBES_TUBE_REFINE_H
#define AMB_FIELD_TUBES_TUBE_REFINE_H

#include "field/tubes/tube_queue.h"
#include "field/tubes/tube_refract.h"

/* How often a tube is quartered at most: the gain of each level is a quarter of the last one's. */
enum { LEVEL_MAX = 7, TURN_LEVEL_MAX = 10 };
/* How far f may be from linear anywhere, in units of how far it is at most in the middle of an
 * edge: 4/3 in the triangle's middle if it is quadratic. */
static const float BULGE = 4.0f / 3.0f;

/* Where light is nearer to the view's direction than twice as far as it differs between corners, it
 * may turn over from one side of the view to the other. The whole segment is then lit through a
 * small part of a tube, and what is linear over all of the tube is not good enough. */
static const float TURN_SPREADS = 2.0f;

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
        bend = lanes_max(bend, lanes_abs(f[3 + k] - 0.5f * (f[k] + f[next])));
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

#endif
