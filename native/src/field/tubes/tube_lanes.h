/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tubes side by side, and the ray and the medium that they are gathered for. The headers of the
 * inner loop (tube_lanes, tube_queue, tube_refract, tube_refine, tube_fade, tube_chord, tube_soft)
 * are of tube_gather.c alone, which is built once for each instruction set. */
#ifndef AMB_FIELD_TUBES_TUBE_LANES_H
#define AMB_FIELD_TUBES_TUBE_LANES_H

#include "field/tubes/tube_tree.h"
#include "math/lanes3.h"
#include "optics/medium.h"

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

/* Eight tubes: what their corners hold, f there, and how often they were quartered. Normals are
 * interpolated before they are made unit, so parts need to know how long they were. */
enum { ROW_START = CORNER_SIZE, ROW_NORMAL_LENGTH, CORNER_ROWS };
typedef struct Tubes {
    Lanes rows[3][CORNER_ROWS];
    Lanes f[3];
    Lanes level;
} Tubes;

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

#endif
