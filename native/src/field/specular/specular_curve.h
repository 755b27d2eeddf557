/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where the light lines of a face meet a camera segment: the curve f(u, v) = 0 in the face. */
#ifndef AMB_FIELD_SPECULAR_SPECULAR_CURVE_H
#define AMB_FIELD_SPECULAR_SPECULAR_CURVE_H

#include "field/specular/specular_face.h"

/* A stretch of a camera path, o + t d. */
typedef struct SpecularSegment {
    Vec3d o, d; /* d unit */
    double length;
} SpecularSegment;

/* A point of the curve: the light line meets the camera's line s from the face and t from o. */
typedef struct CurvePoint {
    double u, v;
    double f, f_u, f_v; /* (p - o) . (w x d) and derivatives */
    SpecularLine line;
    double s, t;
    Vec3d normal, turn; /* w x d, d x (p - o): parallel on the curve */
} CurvePoint;

/* A corner or a middle of a cell, and f there. */
typedef struct CurveNode {
    double u, v, f;
} CurveNode;

/* A piece of the curve from one edge of a cell to another: points c(x) = a + x chord + y across
 * with f = 0, one y for each x in [0, 1]. */
typedef struct CurvePiece {
    const SpecularFace *face;
    const SpecularSegment *segment;
    double chord[2], across[2]; /* in u and v */
    double turn[2];             /* dy/dx at both ends */
    bool is_straight;           /* Newton's method did not follow it: y = 0, f is small */
    CurvePoint a, middle, b;    /* at x = 0, 1/2, 1 */
} CurvePiece;

/* Takes up one piece. */
typedef void (*CurveVisitor)(void *user, const CurvePiece *piece);

/* f where the light line p + s w starts. */
static inline double specular_side(const SpecularSegment *segment, Vec3d p, Vec3d w) {
    return vec3d_dot(vec3d_sub(p, segment->o), vec3d_cross(w, segment->d));
}

/* False where no curve can pass between these corners and middles of the edges 01, 12, 20. */
bool specular_may_cross(const CurveNode corners[3], const CurveNode middles[3]);

/* All pieces of the curve inside a cell: its corners, and the middles of the edges 01, 12, 20. */
void specular_curve(const SpecularFace *face, const SpecularSegment *segment,
                    const CurveNode corners[3], const CurveNode middles[3], CurveVisitor visit,
                    void *user);

/* The curve's point at x; false where Newton's method does not converge. */
bool specular_curve_at(const CurvePiece *piece, double x, CurvePoint *out_point);

/* Measure of the curve at a point: int dA delta(f) g over the face = int_0^1 density g dx, m^2. */
double specular_density(const CurvePiece *piece, const CurvePoint *point);

#endif
