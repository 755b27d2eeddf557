/* SPDX-License-Identifier: GPL-3.0-or-later
 * The curve of solutions in one cell: signs of f at corners bracket it, Newton's method finds it,
 * and cells in which that is not sure are cut in four. */
#include "field/specular/specular_curve.h"

enum {
    EDGE_STEPS = 50,
    LEVEL_MAX = 6,  /* halvings of a cell whose curve is not clear */
    NEWTON_MAX = 12 /* steps; a root on an edge is bracketed and found by halving at worst */
};
/* Steps of Newton's method below this part of an edge or chord are the last ones: the place is
 * moved by them, so that its error is their square, and the light is that of the place before.
 * Times the sine between light and view, by which t and s are divided. */
static const double EDGE_STEP_MIN = 1e-4;
static const double STEP_MIN = 1e-5;
/* Rounding of f, divided by that sine: no step needs to be smaller. */
static const double ROUNDING = 1e-15;
/* Differences of f from linear, measured at the middles of edges, count so many times. */
static const double SAFETY = 2.0;
/* The curve may leave its cell between its ends by this part of the cell. */
static const double OUTSIDE_MAX = 0.1;
/* Least sine of the angle between chord and gradient, in u and v. */
static const double SINE_MIN = 0.3;
/* A gradient this much smaller in the middle than at the ends: a fold may be inside. */
static const double GRADIENT_MIN = 0.05;

typedef struct Search {
    const SpecularFace *face;
    const SpecularSegment *segment;
    CurveVisitor visit;
    void *user;
} Search;

static CurveNode node_at(const Search *search, double u, double v) {
    const SpecularLine line = specular_line(search->face, u, v);
    return (CurveNode){u, v, specular_side(search->segment, line.p, line.w)};
}

static CurvePoint point_at(const SpecularFace *face, const SpecularSegment *segment, double u,
                           double v) {
    CurvePoint point = {.u = u, .v = v, .line = specular_line(face, u, v)};
    const SpecularLine *line = &point.line;
    const Vec3d to = vec3d_sub(line->p, segment->o);
    const Vec3d normal = vec3d_cross(line->w, segment->d);
    const Vec3d turn = vec3d_cross(segment->d, to); /* to . (w' x d) = w' . (d x to) */
    point.normal = normal;
    point.turn = turn;
    point.f = vec3d_dot(to, normal);
    point.f_u = vec3d_dot(face->p_u, normal) + vec3d_dot(line->w_u, turn);
    point.f_v = vec3d_dot(face->p_v, normal) + vec3d_dot(line->w_v, turn);
    /* The lines' points nearest to each other: where they meet, on the curve. */
    const double sine2 = vec3d_dot(normal, normal);
    const double cosine = vec3d_dot(line->w, segment->d);
    const double along = vec3d_dot(to, segment->d), ahead = vec3d_dot(to, line->w);
    point.t = (along - ahead * cosine) / sine2;
    point.s = (along * cosine - ahead) / sine2;
    return point;
}

static double least_step(double step, const CurvePoint *point) {
    const double sine = vec3d_length(point->normal);
    return step * sine + ROUNDING / sine;
}

bool specular_curve_at(const CurvePiece *piece, double x, CurvePoint *out_point) {
    const double u = piece->a.u + x * piece->chord[0], v = piece->a.v + x * piece->chord[1];
    /* The cubic with the slopes of both ends is nearly there. */
    double y = x * (1.0 - x) * ((1.0 - x) * piece->turn[0] - x * piece->turn[1]);
    for (int i = 0; i < NEWTON_MAX; ++i) {
        *out_point = point_at(piece->face, piece->segment, u + y * piece->across[0],
                              v + y * piece->across[1]);
        const double slope = out_point->f_u * piece->across[0] + out_point->f_v * piece->across[1];
        const double step = -out_point->f / slope;
        if (!(slope > 0.0) || (!(fabs(y + step) < 1.0) && !piece->is_straight))
            return false;
        if (piece->is_straight)
            return true;
        if (fabs(step) < least_step(STEP_MIN, out_point)) {
            out_point->u += step * piece->across[0];
            out_point->v += step * piece->across[1];
            return true;
        }
        y += step;
    }
    return false;
}

double specular_density(const CurvePiece *piece, const CurvePoint *point) {
    const double cell =
        fabs(piece->chord[0] * piece->across[1] - piece->chord[1] * piece->across[0]);
    const double slope = point->f_u * piece->across[0] + point->f_v * piece->across[1];
    return 2.0 * piece->face->area * cell / slope;
}

/* Root in [0, 1] of the parabola through f at both ends, of different sign, and the middle. */
static double parabola_root(double a, double middle, double b) {
    const double bend = 4.0 * (middle - 0.5 * (a + b)), slope = b - a + bend; /* at 0 */
    const double root = sqrt(slope * slope + 4.0 * a * bend);
    /* a + slope x - bend x^2 = 0, the root between ends without cancellation. */
    const double x = -2.0 * a / (slope + copysign(root, b - a));
    return x >= 0.0 && x <= 1.0 ? x : a / (a - b);
}

/* Root of f on the edge between two nodes of different sign. */
static CurvePoint edge_root(const Search *search, const CurveNode *a, const CurveNode *middle,
                            const CurveNode *b) {
    const double du = b->u - a->u, dv = b->v - a->v;
    double low = 0.0, high = 1.0, x = parabola_root(a->f, middle->f, b->f);
    CurvePoint point;
    for (int i = 0;; ++i) {
        point = point_at(search->face, search->segment, a->u + x * du, a->v + x * dv);
        if ((point.f < 0.0) == (a->f < 0.0))
            low = x;
        else
            high = x;
        const double slope = point.f_u * du + point.f_v * dv;
        double next = slope != 0.0 ? x - point.f / slope : low;
        if (!(next > low && next < high) || i >= NEWTON_MAX)
            next = 0.5 * (low + high);
        const double least = least_step(EDGE_STEP_MIN, &point);
        if (fabs(next - x) < least || high - low < least || i >= EDGE_STEPS) {
            point.u = a->u + next * du;
            point.v = a->v + next * dv;
            return point;
        }
        x = next;
    }
}

static double length_of(double x, double y) {
    return sqrt(x * x + y * y);
}

static double slope_along(const CurvePoint *point, const double direction[2]) {
    return point->f_u * direction[0] + point->f_v * direction[1];
}

/* Whether a point is inside the cell or nearly so. */
static bool is_near(const CurveNode c[3], const CurvePoint *p) {
    const double whole =
        (c[1].u - c[0].u) * (c[2].v - c[0].v) - (c[1].v - c[0].v) * (c[2].u - c[0].u);
    for (int k = 0; k < 3; ++k) {
        const CurveNode *a = &c[k], *b = &c[(k + 1) % 3];
        const double part = (b->u - a->u) * (p->v - a->v) - (b->v - a->v) * (p->u - a->u);
        if (part / whole < -OUTSIDE_MAX)
            return false;
    }
    return true;
}

/* The piece between roots on two edges; false: it is not one curve that Newton's method follows. */
static bool make_piece(const CurveNode corners[3], CurvePiece *piece) {
    const CurvePoint *a = &piece->a, *b = &piece->b;
    piece->chord[0] = b->u - a->u;
    piece->chord[1] = b->v - a->v;
    const double length = length_of(piece->chord[0], piece->chord[1]);
    const double g_u = a->f_u + b->f_u, g_v = a->f_v + b->f_v;
    const double scale = length / length_of(g_u, g_v);
    piece->across[0] = scale * g_u;
    piece->across[1] = scale * g_v;
    const double cross =
        fabs(piece->chord[0] * piece->across[1] - piece->chord[1] * piece->across[0]);
    if (!(cross >= SINE_MIN * length * length))
        return false;
    const double slope_a = slope_along(a, piece->across), slope_b = slope_along(b, piece->across);
    piece->turn[0] = -slope_along(a, piece->chord) / slope_a;
    piece->turn[1] = -slope_along(b, piece->chord) / slope_b;
    if (!(slope_a > 0.0) || !(slope_b > 0.0) || !specular_curve_at(piece, 0.5, &piece->middle))
        return false;
    return slope_along(&piece->middle, piece->across) > GRADIENT_MIN * fmax(slope_a, slope_b) &&
           fmin(slope_a, slope_b) > GRADIENT_MIN * fmax(slope_a, slope_b) &&
           is_near(corners, &piece->middle);
}

/* What is left at the last level, where Newton's method still does not follow the curve: the chord
 * itself. The cell is 4^-LEVEL_MAX of its triangle. */
static void take_chord(const Search *search, CurvePiece *piece) {
    const CurvePoint *a = &piece->a, *b = &piece->b;
    piece->middle =
        point_at(search->face, search->segment, 0.5 * (a->u + b->u), 0.5 * (a->v + b->v));
    const double g_u = piece->middle.f_u, g_v = piece->middle.f_v;
    const double length = length_of(piece->chord[0], piece->chord[1]);
    const double scale = length / length_of(g_u, g_v);
    if (!(length > 0.0) || !isfinite(scale))
        return;
    piece->across[0] = scale * g_u;
    piece->across[1] = scale * g_v;
    piece->is_straight = true;
    piece->turn[0] = piece->turn[1] = 0.0;
    const double least = GRADIENT_MIN * slope_along(&piece->middle, piece->across);
    if (slope_along(a, piece->across) > least && slope_along(b, piece->across) > least)
        search->visit(search->user, piece);
}

static void search_cell(const Search *search, const CurveNode corners[3],
                        const CurveNode middles[3], int level);

static void search_part(const Search *search, const CurveNode corners[3], int level) {
    CurveNode middles[3];
    for (int k = 0; k < 3; ++k) {
        const CurveNode *a = &corners[k], *b = &corners[(k + 1) % 3];
        middles[k] = node_at(search, 0.5 * (a->u + b->u), 0.5 * (a->v + b->v));
    }
    search_cell(search, corners, middles, level);
}

static void cut_cell(const Search *search, const CurveNode corners[3], const CurveNode middles[3],
                     int level) {
    for (int k = 0; k < 3; ++k) {
        const CurveNode part[3] = {corners[k], middles[k], middles[(k + 2) % 3]};
        search_part(search, part, level + 1);
    }
    search_part(search, middles, level + 1);
}

/* What the signs and sizes of f at six points say. */
typedef struct Signs {
    int negative;  /* of the corners */
    bool may_pass; /* a curve may be inside */
    bool is_clear; /* and is one only, from edge to edge, whose ends the signs show */
} Signs;

/* Whether f may cross zero twice between two nodes of one sign: by a parabola through the middle
 * whose bend counts SAFETY times. */
static bool may_cross_twice(double a, double b, double bend) {
    const double bulge = SAFETY * fabs(bend);
    return (fabs(a) < bulge || fabs(b) < bulge) && fabs(b - a) < 4.0 * bulge;
}

static double larger(double a, double b) {
    return a > b ? a : b;
}

static Signs signs_of(const CurveNode corners[3], const CurveNode middles[3]) {
    Signs signs = {.is_clear = true};
    double bend = 0.0, least = INFINITY, range = 0.0;
    for (int k = 0; k < 3; ++k) {
        const double a = corners[k].f, b = corners[(k + 1) % 3].f;
        const double difference = middles[k].f - 0.5 * (a + b);
        bend = larger(bend, fabs(difference));
        range = larger(range, fabs(b - a));
        least = fabs(a) < least ? fabs(a) : least;
        signs.negative += a < 0.0;
        if ((a < 0.0) == (b < 0.0) && may_cross_twice(a, b, difference))
            signs.is_clear = false;
    }
    signs.may_pass = true;
    if (signs.negative % 3 == 0) {
        /* A parabola through six nodes is within 4/3 of its largest bend of the plane through
         * three. Where no edge is crossed, only a closed curve would be missed, and for one the
         * gradient must vanish inside. */
        signs.may_pass = range > 0.0 && !(least > SAFETY * (4.0 / 3.0) * bend) &&
                         !(signs.is_clear && range > 4.0 * SAFETY * bend);
        signs.is_clear = false;
    }
    return signs;
}

bool specular_may_cross(const CurveNode corners[3], const CurveNode middles[3]) {
    return signs_of(corners, middles).may_pass;
}

static void search_cell(const Search *search, const CurveNode corners[3],
                        const CurveNode middles[3], int level) {
    const Signs signs = signs_of(corners, middles);
    const bool has_ends = signs.negative % 3 != 0;
    if (!signs.may_pass || (level == LEVEL_MAX && !has_ends))
        return;
    if (!signs.is_clear && level < LEVEL_MAX) {
        cut_cell(search, corners, middles, level);
        return;
    }
    /* The corner whose sign differs, and the two edges that meet there. */
    int apex = 0;
    while ((corners[apex].f < 0.0) != (signs.negative == 1))
        ++apex;
    CurvePiece piece = {.face = search->face, .segment = search->segment};
    const int next = (apex + 1) % 3, before = (apex + 2) % 3;
    piece.a = edge_root(search, &corners[apex], &middles[apex], &corners[next]);
    piece.b = edge_root(search, &corners[apex], &middles[before], &corners[before]);
    if (make_piece(corners, &piece))
        search->visit(search->user, &piece);
    else if (level < LEVEL_MAX)
        cut_cell(search, corners, middles, level);
    else
        take_chord(search, &piece);
}

void specular_curve(const SpecularFace *face, const SpecularSegment *segment,
                    const CurveNode corners[3], const CurveNode middles[3], CurveVisitor visit,
                    void *user) {
    const Search search = {face, segment, visit, user};
    search_cell(&search, corners, middles, 0);
}
