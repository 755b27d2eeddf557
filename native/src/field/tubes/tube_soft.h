/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tubes of a source that has an extent. */
#ifndef AMB_FIELD_TUBES_TUBE_SOFT_H
#define AMB_FIELD_TUBES_TUBE_SOFT_H

#include "field/tubes/tube_chord.h"
#include "field/tubes/tube_refract.h"

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
    const Lanes x = lanes_max(lanes_abs(change), lanes_set(1e-3f));
    const Lanes left = lanes_exp_negative(-x);
    const Lanes near = lanes_select(x > 0.1f, 1.0f / x - left / (1.0f - left), 0.5f - x / 12.0f);
    const Lanes u = lanes_select(change > 0.0f, near, 1.0f - near);
    return lanes_max(lanes_lerp(s0, s1, q0 + u * (q1 - q0)), lanes_set(0.0f));
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
    const Lanes sharp = 2.0f * lanes_abs(f.v) / lanes_max(lanes_abs(gaps), tiny);
    return lanes_select(is_sharp, sharp, covered / lanes_max(2.0f * half, tiny));
}

#endif
