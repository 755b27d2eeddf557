/* SPDX-License-Identifier: GPL-3.0-or-later
 * Tangent pairs against finite differences of an exact tracer, against the 4x4 covariance, and in
 * closed cases. */
#include "optics/tangent.h"

#include <stddef.h>

#include "optics/covariance.h"
#include "optics/dielectric.h"
#include "test.h"

static const double PI = 3.14159265358979323846;
static const double FOUR_PI_2 = 39.478417604357434;

enum { TRIALS = 2000 };

/* ---- An exact tracer in double --------------------------------------------------------------- */

typedef struct Vector {
    double x, y, z;
} Vector;

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector combined(double s, Vector a, double t, Vector b) {
    return (Vector){s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z};
}

static Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static double length(Vector a) {
    return sqrt(dot(a, a));
}

static Vector unit(Vector a) {
    return combined(1.0 / length(a), a, 0.0, a);
}

static Vector from_float(Vec3 a) {
    return (Vector){(double)a.x, (double)a.y, (double)a.z};
}

static Vec3 to_float(Vector a) {
    return vec3((float)a.x, (float)a.y, (float)a.z);
}

/* A ray that meets a surface through the origin with the normal n there: a sphere of the signed
 * curvature k (> 0 bulges towards the incident side; centre -n/k), or a plane. */
typedef struct Case {
    Vector o, d, n;
    double k, eta;
    bool is_mirror;
    double cos_i, cos_t, distance; /* of the central ray */
} Case;

typedef struct Ray {
    Vector p, d;
} Ray;

/* Traces o, d (need not be unit) to behind the event: the point of the surface and the new
 * direction. */
static Ray trace(const Case *c, Vector o, Vector d) {
    d = unit(d);
    /* F(p) = n.p + k/2 p.p = 0, with the gradient n + k p. */
    const double a = 0.5 * c->k;
    const double b = dot(c->n, d) + c->k * dot(o, d);
    const double f = dot(c->n, o) + 0.5 * c->k * dot(o, o);
    /* The root that goes to -f/b when k goes to 0 (b < 0 from outside of a convex surface). */
    const double t = -2.0 * f / (b - sqrt(b * b - 4.0 * a * f));
    Ray ray = {combined(1.0, o, t, d), d};
    const Vector n = unit(combined(1.0, c->n, c->k, ray.p));
    const double cos_i = -dot(d, n);
    if (c->is_mirror) {
        ray.d = combined(1.0, d, 2.0 * cos_i, n);
    } else {
        const double cos_t = sqrt(1.0 - c->eta * c->eta * (1.0 - cos_i * cos_i));
        ray.d = combined(c->eta, d, c->eta * cos_i - cos_t, n);
    }
    return ray;
}

static Vector random_direction(uint64_t *state) {
    const double z = test_uniform(state, -1.0, 1.0), phi = test_uniform(state, 0.0, 2.0 * PI);
    const double r = sqrt(1.0 - z * z);
    return (Vector){r * cos(phi), r * sin(phi), z};
}

static Vector perpendicular(uint64_t *state, Vector d) {
    return unit(cross(d, random_direction(state)));
}

static Case random_case(uint64_t *state) {
    Case c;
    for (;;) {
        c.n = random_direction(state);
        c.cos_i = test_uniform(state, 0.1, 1.0);
        const Vector side = perpendicular(state, c.n);
        c.d = combined(-c.cos_i, c.n, sqrt(1.0 - c.cos_i * c.cos_i), side);
        c.k = test_uniform(state, 0.0, 1.0) < 0.25 ? 0.0 : test_uniform(state, -1.0, 1.0);
        c.eta = exp(test_uniform(state, -0.6, 0.6));
        c.is_mirror = test_uniform(state, 0.0, 1.0) < 0.3;
        c.distance = test_uniform(state, 0.1, 0.8) * c.cos_i;
        c.o = combined(-c.distance, c.d, 0.0, c.d);
        const double cos2_t = 1.0 - c.eta * c.eta * (1.0 - c.cos_i * c.cos_i);
        c.cos_t = cos2_t > 0.0 ? sqrt(cos2_t) : 0.0;
        if (c.is_mirror || cos2_t > 0.01)
            return c;
    }
}

/* The library's way through the same event, in float. */
static TangentPair through(const Case *c, TangentPair pair) {
    const Vec3 d = to_float(c->d), n = to_float(c->n);
    pair = tangent_travel_to_surface(pair, (float)c->distance, d, n);
    const Vec3 dn = vec3_scale(pair.dp, (float)c->k);
    if (c->is_mirror)
        return tangent_reflect(pair, d, n, dn, (float)c->cos_i);
    return tangent_refract(pair, d, n, dn, (float)c->eta, (float)c->cos_i, (float)c->cos_t);
}

static void tangent_matches_finite_differences(void) {
    uint64_t state = 1;
    double worst_p = 0.0, worst_d = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Case c = random_case(&state);
        const Vector dp =
            combined(test_uniform(&state, 0.0, 1.0), random_direction(&state), 0, c.d);
        const Vector dd =
            combined(test_uniform(&state, 0.0, 1.0), perpendicular(&state, c.d), 0, c.d);
        /* A derivative of the unit direction: the part along d is none. */
        const TangentPair pair = through(&c, (TangentPair){to_float(dp), to_float(dd)});
        const double h = 1e-5;
        const Ray plus = trace(&c, combined(1.0, c.o, h, dp), combined(1.0, c.d, h, dd));
        const Ray minus = trace(&c, combined(1.0, c.o, -h, dp), combined(1.0, c.d, -h, dd));
        const Vector p = combined(0.5 / h, plus.p, -0.5 / h, minus.p);
        const Vector d = combined(0.5 / h, plus.d, -0.5 / h, minus.d);
        const double cos_min = c.is_mirror ? c.cos_i : fmin(c.cos_i, c.cos_t);
        const double size = 1.0 + length(p) + length(d);
        const Vector error_p = combined(1.0, from_float(pair.dp), -1.0, p);
        const Vector error_d = combined(1.0, from_float(pair.dd), -1.0, d);
        /* Beside the critical angle the rounding of cos_t grows as its inverse squared. */
        worst_p = test_worse(worst_p, length(error_p) / size);
        worst_d = test_worse(worst_d, length(error_d) * cos_min * cos_min / size);
    }
    ENSURE_NEAR(worst_p, 0.0, 1e-6);
    ENSURE_NEAR(worst_d, 0.0, 1e-6);
}

/* Derivatives of a unit vector stay perpendicular to it, whatever the event. */
static void tangent_keeps_directions_unit(void) {
    uint64_t state = 2;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Case c = random_case(&state);
        const Vector dd = perpendicular(&state, c.d);
        const TangentPair pair = through(&c, (TangentPair){{0, 0, 0}, to_float(dd)});
        const Vector out = trace(&c, c.o, c.d).d;
        const double size = length(from_float(pair.dd));
        worst = test_worse(worst, fabs(dot(from_float(pair.dd), out)) / (1.0 + size));
        /* After the travel, dp lies in the surface. */
        worst = test_worse(worst, fabs(dot(from_float(pair.dp), c.n)));
    }
    ENSURE_NEAR(worst, 0.0, 1e-6);
}

/* ---- Against the 4x4 covariance -------------------------------------------------------------- */

/* Coordinates (x, y, u, v) of a pair in the frame (x, y, d). */
static LocalTangent local(TangentPair pair, Vector x, Vector y) {
    const Vector dp = from_float(pair.dp), dd = from_float(pair.dd);
    return (LocalTangent){{dot(dp, x), dot(dp, y), dot(dd, x), dot(dd, y)}};
}

static bool covariance_of(const TangentPair pairs[TANGENT_COUNT], Vector x, Vector y,
                          Covariance *out) {
    LocalTangent tangents[TANGENT_COUNT];
    for (int k = 0; k < TANGENT_COUNT; ++k)
        tangents[k] = local(pairs[k], x, y);
    return covariance_from_tangents(tangents, TANGENT_COUNT, out);
}

static double covariance_difference(const Covariance *a, const Covariance *b) {
    static const int diagonal[4] = {COVARIANCE_XX, COVARIANCE_YY, COVARIANCE_UU, COVARIANCE_VV};
    double worst = 0.0;
    int i = 0;
    for (int column = 0; column < 4; ++column)
        for (int row = 0; row <= column; ++row, ++i)
            worst = test_worse(worst, fabs(a->c[i] - b->c[i]) /
                                          sqrt(b->c[diagonal[row]] * b->c[diagonal[column]]));
    return worst;
}

static void tangent_is_square_root_of_covariance(void) {
    uint64_t state = 3;
    double worst = 0.0, worst_area = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Case c = random_case(&state);
        /* ex normal to the plane of incidence, ey = d x ex. */
        const Vector ex = unit(cross(c.n, c.d)), ey = cross(c.d, ex);
        TangentPair pairs[TANGENT_COUNT];
        for (int k = 0; k < TANGENT_COUNT; ++k) {
            /* Near a diagonal, so that the array is far from singular. */
            double q[4];
            for (int i = 0; i < 4; ++i)
                q[i] = test_uniform(&state, -0.2, 0.2) + (i == k ? 1.0 : 0.0);
            pairs[k].dp = to_float(combined(q[0], ex, q[1], ey));
            pairs[k].dd = to_float(combined(q[2], ex, q[3], ey));
        }
        Covariance sigma, after;
        ENSURE(covariance_of(pairs, ex, ey, &sigma));
        covariance_travel(&sigma, c.distance);
        const SurfaceCurvature k = {c.k, 0.0, c.k};
        if (c.is_mirror)
            covariance_reflect(&sigma, c.cos_i, k);
        else
            ENSURE(covariance_refract(&sigma, c.eta, 1.0, c.cos_i, k));
        const Vector d = trace(&c, c.o, c.d).d;
        /* ex stays; the mirror's ey has the projection onto the surface that it had. */
        const Vector ey_after = combined(c.is_mirror ? -1.0 : 1.0, cross(d, ex), 0.0, d);
        for (int i = 0; i < TANGENT_COUNT; ++i)
            pairs[i] = through(&c, pairs[i]);
        ENSURE(covariance_of(pairs, ex, ey_after, &after));
        const double cos_min = c.is_mirror ? c.cos_i : fmin(c.cos_i, c.cos_t);
        const double scale = pow(cos_min, 3.0);
        worst = test_worse(worst, covariance_difference(&after, &sigma) * scale);

        /* The cross-section a(s) is the spatial spectrum: sqrt|S| = 1 / (4 pi^2 a). */
        const double s = test_uniform(&state, 0.0, 2.0);
        const TangentSpread spread = tangent_spread(pairs, to_float(d));
        covariance_travel(&sigma, s);
        const double root = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
        const double area = (double)tangent_cross_section(&spread, (float)s);
        worst_area = test_worse(worst_area, fabs(root * FOUR_PI_2 * area - 1.0) * scale);
    }
    ENSURE_NEAR(worst, 0.0, 2e-6);
    ENSURE_NEAR(worst_area, 0.0, 2e-6);
}

/* ---- Closed forms ---------------------------------------------------------------------------- */

/* A point light's pairs: a cell of directions. */
static void point_pairs(Vector d, float size, TangentPair out[TANGENT_COUNT]) {
    for (int k = 0; k < TANGENT_COUNT; ++k)
        out[k] = (TangentPair){{0, 0, 0}, {0, 0, 0}};
    Vec3 x, y;
    vec3_frame(to_float(d), &x, &y);
    out[0].dd = vec3_scale(x, size);
    out[1].dd = vec3_scale(y, size);
}

/* Point light at height h over a slab, depth s along the refracted ray:
 *   a = cell |B_sag B_mer|,  B_sag = h/c_i + s/n,  B_mer = (h/c_i)(c_t/c_i) + (s/n)(c_i/c_t). */
static void tangent_slab_matches_closed_form(void) {
    uint64_t state = 4;
    double worst = 0.0, worst_flux = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double n = test_uniform(&state, 1.1, 2.0), c_i = test_uniform(&state, 0.1, 1.0);
        const double h = test_uniform(&state, 0.1, 3.0), s = test_uniform(&state, 0.0, 3.0);
        const double c_t = sqrt(1.0 - (1.0 - c_i * c_i) / (n * n));
        Case c = {.n = {0, 0, 1},
                  .d = {sqrt(1.0 - c_i * c_i), 0, -c_i},
                  .eta = 1.0 / n,
                  .cos_i = c_i,
                  .cos_t = c_t,
                  .distance = h / c_i};
        TangentPair pairs[TANGENT_COUNT];
        point_pairs(c.d, 0.01f, pairs);
        for (int k = 0; k < TANGENT_COUNT; ++k)
            pairs[k] = through(&c, pairs[k]);
        c.o = combined(-c.distance, c.d, 0.0, c.d);
        const TangentSpread spread = tangent_spread(pairs, to_float(trace(&c, c.o, c.d).d));
        const double b_sag = h / c_i + s / n;
        const double b_mer = h / c_i * c_t / c_i + s / n * c_i / c_t;
        const double area = (double)tangent_cross_section(&spread, (float)s);
        worst = test_worse(worst, fabs(area / (1e-4 * b_sag * b_mer) - 1.0));
        /* Far light: the irradiance is E0 T c_i / c_t, so the tube at the surface widens from
         * the cell's h^2/c_i^2 by c_t / c_i. */
        const double entry = (double)tangent_cross_section(&spread, 0.0f);
        worst_flux =
            test_worse(worst_flux, fabs(entry / (1e-4 * h * h / (c_i * c_i)) * c_i / c_t - 1.0));
    }
    ENSURE_NEAR(worst, 0.0, 2e-6);
    ENSURE_NEAR(worst_flux, 0.0, 2e-6);
}

/* On the axis of a sphere: B(s) = L + s/n - s (n-1) L / (n R). */
static double sphere_b(double l, double r, double n, double s) {
    return l + s / n - s * (n - 1.0) * l / (n * r);
}

static void tangent_sphere_matches_closed_form(void) {
    uint64_t state = 5;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double n = test_uniform(&state, 1.1, 2.5), r = test_uniform(&state, 0.3, 2.0);
        const double l = test_uniform(&state, 0.5, 10.0), s = test_uniform(&state, 0.0, 2.0 * r);
        Case c = {.n = {0, 0, 1},
                  .d = {0, 0, -1},
                  .k = 1.0 / r,
                  .eta = 1.0 / n,
                  .cos_i = 1.0,
                  .cos_t = 1.0,
                  .distance = l};
        TangentPair pairs[TANGENT_COUNT];
        point_pairs(c.d, 0.01f, pairs);
        for (int k = 0; k < TANGENT_COUNT; ++k)
            pairs[k] = through(&c, pairs[k]);
        const TangentSpread spread = tangent_spread(pairs, to_float(c.d));
        const double b = sphere_b(l, r, n, s);
        const double area = (double)tangent_cross_section(&spread, (float)s);
        worst = test_worse(worst, fabs(area - 1e-4 * b * b) / (1e-4 * l * l));
    }
    /* Beside a focus the polynomial cancels: a is known to the root of its rounding, here of
     * terms up to (1 + s/R)^4, and 3e-4 to 1e-3 of the entry's is nothing to a frequency factor. */
    ENSURE_NEAR(worst, 0.0, 1e-3);
}

/* Parallel light on the axis: focus at s = n R / (n - 1), inside for n >= 2. */
static void tangent_focus_is_where_it_should_be(void) {
    static const double indices[] = {1.5, 2.0, 2.5};
    for (size_t i = 0; i < sizeof indices / sizeof indices[0]; ++i) {
        const double n = indices[i], r = 0.7;
        const Case c = {.n = {0, 0, 1},
                        .d = {0, 0, -1},
                        .k = 1.0 / r,
                        .eta = 1.0 / n,
                        .cos_i = 1.0,
                        .cos_t = 1.0,
                        .distance = 5.0};
        TangentPair pairs[TANGENT_COUNT] = {{{0.01f, 0, 0}, {0, 0, 0}}, {{0, 0.01f, 0}, {0, 0, 0}}};
        for (int k = 0; k < TANGENT_COUNT; ++k)
            pairs[k] = through(&c, pairs[k]);
        const TangentSpread spread = tangent_spread(pairs, to_float(c.d));
        const double focus = n * r / (n - 1.0);
        ENSURE_NEAR(tangent_cross_section(&spread, 0.0f), 1e-4, 1e-10);
        for (double s = 0.0; s < 3.0 * focus; s += 0.05) {
            const double width = 1.0 - s / focus;
            ENSURE_NEAR(tangent_cross_section(&spread, (float)s), 1e-4 * width * width, 2e-7);
        }
        /* The root of a difference of equal floats: a(focus)/a(0) is sqrt(1e-7), not 1e-7. */
        ENSURE(tangent_cross_section(&spread, (float)focus) < 1e-7f);
        /* A sun's disc is imaged there: its chief rays pass the vertex, bent to theta / n. */
        Case vertex = c;
        vertex.distance = 0.0;
        pairs[2] = through(&vertex, (TangentPair){{0, 0, 0}, {0.02f, 0, 0}});
        pairs[3] = through(&vertex, (TangentPair){{0, 0, 0}, {0, 0.02f, 0}});
        const TangentSpread disc = tangent_spread(pairs, to_float(c.d));
        const double image = 0.02 * focus / n;
        ENSURE_NEAR((double)tangent_cross_section(&disc, (float)focus) / (image * image), 1.0,
                    1e-5);
    }
}

/* The polynomial against the determinant it stands for. */
static void tangent_cross_section_is_the_determinant(void) {
    uint64_t state = 6;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Vector d = random_direction(&state);
        const Vector x = perpendicular(&state, d), y = cross(d, x);
        const bool has_source = trial % 2 == 0;
        TangentPair pairs[TANGENT_COUNT];
        for (int k = 0; k < TANGENT_COUNT; ++k) {
            const double size = k < TANGENT_LATTICE || has_source ? 1.0 : 0.0;
            pairs[k].dp = to_float(combined(size, random_direction(&state), 0.0, d));
            pairs[k].dd = to_float(combined(size, perpendicular(&state, d), 0.0, d));
        }
        const TangentSpread spread = tangent_spread(pairs, to_float(d));
        const double s = test_uniform(&state, 0.0, 3.0);
        double xx = 0.0, xy = 0.0, yy = 0.0;
        for (int k = 0; k < TANGENT_COUNT; ++k) {
            const Vector p = combined(1.0, from_float(pairs[k].dp), s, from_float(pairs[k].dd));
            xx += dot(p, x) * dot(p, x);
            xy += dot(p, x) * dot(p, y);
            yy += dot(p, y) * dot(p, y);
        }
        const double area2 = pow((double)tangent_cross_section(&spread, (float)s), 2.0);
        /* Rounding is that of the largest terms of the polynomial. */
        worst = test_worse(worst, fabs(area2 - (xx * yy - xy * xy)) / pow(1.0 + s, 4.0));
    }
    ENSURE_NEAR(worst, 0.0, 2e-6);
    const TangentSpread nothing = {{0}};
    ENSURE(tangent_cross_section(&nothing, 5.0f) == 0.0f);
}

void test_tangent(void);

void test_tangent(void) {
    RUN(tangent_matches_finite_differences);
    RUN(tangent_keeps_directions_unit);
    RUN(tangent_is_square_root_of_covariance);
    RUN(tangent_slab_matches_closed_form);
    RUN(tangent_sphere_matches_closed_form);
    RUN(tangent_focus_is_where_it_should_be);
    RUN(tangent_cross_section_is_the_determinant);
}
