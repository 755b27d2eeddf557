/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * The operators of optics/covariance.h against an exact ray tracer on a curved surface (Jacobians
 * by finite differences, moments of traced bundles), against slow twins, and in closed cases. */
#include "optics/covariance.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "test.h"

static const double PI = 3.14159265358979323846;
static const double FOUR_PI_2 = 39.478417604357434;

enum { AXES = 4, RAYS = 100000, TRIALS = 1000 };

/* ---- Random numbers (splitmix64) ------------------------------------------------------------- */

static double uniform(uint64_t *state, double from, double to) {
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    z ^= z >> 31;
    return from + (to - from) * ((double)(z >> 11) * 0x1p-53);
}

/* Four independent standard normals (Box-Muller). */
static void normals(uint64_t *state, double out[AXES]) {
    for (int i = 0; i < AXES; i += 2) {
        const double r = sqrt(-2.0 * log(1.0 - uniform(state, 0.0, 1.0)));
        const double phi = uniform(state, 0.0, 2.0 * PI);
        out[i] = r * cos(phi);
        out[i + 1] = r * sin(phi);
    }
}

/* The larger error; unlike fmax, not a number is the largest of all and stays. */
static double worse(double worst, double error) {
    return isnan(worst) || worst >= error ? worst : error;
}

/* ---- Matrices: slow twins -------------------------------------------------------------------- */

typedef struct Matrix {
    double m[AXES][AXES];
} Matrix;

static Matrix identity(void) {
    Matrix a = {{{0}}};
    for (int i = 0; i < AXES; ++i)
        a.m[i][i] = 1.0;
    return a;
}

static Matrix product(Matrix a, Matrix b) {
    Matrix c = {{{0}}};
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            for (int k = 0; k < AXES; ++k)
                c.m[i][j] += a.m[i][k] * b.m[k][j];
    return c;
}

static Matrix transposed(Matrix a) {
    Matrix b;
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            b.m[i][j] = a.m[j][i];
    return b;
}

static Matrix sum(Matrix a, Matrix b) {
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            a.m[i][j] += b.m[i][j];
    return a;
}

static Matrix scaled(Matrix a, double factor) {
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            a.m[i][j] *= factor;
    return a;
}

/* Gauss-Jordan with partial pivoting; *out_det is the determinant. */
static Matrix inverse_and_det(Matrix a, double *out_det) {
    Matrix b = identity();
    double det = 1.0;
    for (int k = 0; k < AXES; ++k) {
        int p = k;
        for (int i = k + 1; i < AXES; ++i)
            if (fabs(a.m[i][k]) > fabs(a.m[p][k]))
                p = i;
        for (int j = 0; j < AXES && p != k; ++j) {
            const double x = a.m[k][j], y = b.m[k][j];
            a.m[k][j] = a.m[p][j], a.m[p][j] = x;
            b.m[k][j] = b.m[p][j], b.m[p][j] = y;
        }
        det *= p == k ? a.m[k][k] : -a.m[k][k];
        const double pivot = a.m[k][k];
        for (int j = 0; j < AXES; ++j) {
            a.m[k][j] /= pivot;
            b.m[k][j] /= pivot;
        }
        for (int i = 0; i < AXES; ++i) {
            const double factor = a.m[i][k];
            for (int j = 0; j < AXES && i != k; ++j) {
                a.m[i][j] -= factor * a.m[k][j];
                b.m[i][j] -= factor * b.m[k][j];
            }
        }
    }
    *out_det = det;
    return b;
}

static Matrix inverse(Matrix a) {
    double det;
    return inverse_and_det(a, &det);
}

static double determinant(Matrix a) {
    double det;
    inverse_and_det(a, &det);
    return det;
}

/* a s a^T */
static Matrix congruence(Matrix a, Matrix s) {
    return product(product(a, s), transposed(a));
}

static Matrix unpacked(const Covariance *sigma) {
    static const int packed[AXES][AXES] = {{0, 1, 3, 6}, {1, 2, 4, 7}, {3, 4, 5, 8}, {6, 7, 8, 9}};
    Matrix a;
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            a.m[i][j] = sigma->c[packed[i][j]];
    return a;
}

static Covariance packed_from(Matrix a) {
    return (Covariance){{a.m[0][0], a.m[0][1], a.m[1][1], a.m[0][2], a.m[1][2], a.m[2][2],
                         a.m[0][3], a.m[1][3], a.m[2][3], a.m[3][3]}};
}

/* Largest difference of two symmetric matrices, each entry against sqrt of its diagonals in b. */
static double difference(Matrix a, Matrix b) {
    double worst = 0.0;
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            worst =
                worse(worst, fabs(a.m[i][j] - b.m[i][j]) / sqrt(fabs(b.m[i][i]) * fabs(b.m[j][j])));
    return worst;
}

static double covariance_difference(const Covariance *a, const Covariance *b) {
    return difference(unpacked(a), unpacked(b));
}

/* Largest difference of two maps, against the largest entry of b. */
static double map_difference(Matrix a, Matrix b) {
    double worst = 0.0, largest = 0.0;
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j) {
            worst = worse(worst, fabs(a.m[i][j] - b.m[i][j]));
            largest = worse(largest, fabs(b.m[i][j]));
        }
    return worst / largest;
}

/* Well-conditioned random Sigma or C: L L^T with a dominant diagonal. */
static Matrix random_spd(uint64_t *state, const double size[AXES]) {
    Matrix l = {{{0}}};
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j <= i; ++j)
            l.m[i][j] = size[i] * (i == j ? uniform(state, 0.7, 1.3) : uniform(state, -0.5, 0.5));
    return congruence(l, identity());
}

static const double SPECTRUM_SIZE[AXES] = {40.0, 30.0, 20.0, 50.0};

/* C = Sigma^-1 / (4 pi^2), and the same the other way round. */
static Matrix reciprocal(Matrix a) {
    return scaled(inverse(a), 1.0 / FOUR_PI_2);
}

/* ---- The exact tracer ------------------------------------------------------------------------ */

typedef struct Vector {
    double x, y, z;
} Vector;

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector combined(double s, Vector a, double t, Vector b) {
    return (Vector){s * a.x + t * b.x, s * a.y + t * b.y, s * a.z + t * b.z};
}

static Vector unit(Vector a) {
    const double length = sqrt(dot(a, a));
    return (Vector){a.x / length, a.y / length, a.z / length};
}

typedef struct Frame {
    Vector x, y, d;
} Frame;

typedef enum Event {
    TRAVEL,    /* to the plane normal to the ray at `distance` */
    TURN,      /* the frame, by `distance` radians */
    PROJECT,   /* onto the tangent plane */
    UNPROJECT, /* and back */
    CURVE,     /* slopes against the normal at (X, Y) = (x, y) */
    REFRACT,
    REFLECT,
    EVENT_COUNT
} Event;

/* One event at the origin, where the surface z = -1/2 (X, Y) K (X, Y)^T has the normal (0, 0, 1).
 * The central ray comes down at the cosine cos_i; ex = (0, 1, 0), so Y runs along (1, 0, 0). */
typedef struct Setup {
    Event event;
    double distance;
    double cos_i, n1, n2;
    SurfaceCurvature k;
} Setup;

static double sin_from(double cosine) {
    return sqrt((1.0 - cosine) * (1.0 + cosine));
}

static double cos_transmitted(const Setup *s) {
    return sin_from(s->n1 / s->n2 * sin_from(s->cos_i));
}

static double quadratic_form(SurfaceCurvature k, Vector a, Vector b) {
    return k.xx * a.y * b.y + k.xy * (a.y * b.x + a.x * b.y) + k.yy * a.x * b.x;
}

/* Down at cosine c (d.z = -c), right-handed; or up with the mirrored ey = ex x d. */
static Frame frame_of(double c, bool is_up) {
    const double s = sin_from(c);
    return (Frame){{0, 1, 0}, {c, 0, is_up ? -s : s}, {s, 0, is_up ? c : -c}};
}

/* Coordinates of the line p + t w in the plane through the origin normal to f.d. */
static void coordinates(Frame f, Vector p, Vector w, double out[AXES]) {
    const double along = dot(w, f.d);
    const Vector at = combined(1.0, p, -dot(p, f.d) / along, w);
    out[0] = dot(at, f.x);
    out[1] = dot(at, f.y);
    out[2] = dot(w, f.x) / along;
    out[3] = dot(w, f.y) / along;
}

/* Traces the ray with coordinates q, with no approximation. */
static void trace(const Setup *s, const double q[AXES], double out[AXES]) {
    const Frame f = frame_of(s->cos_i, false);
    Vector p = combined(q[0], f.x, q[1], f.y);
    Vector w = unit(combined(1.0, f.d, 1.0, combined(q[2], f.x, q[3], f.y)));
    switch (s->event) {
    case TRAVEL:
        coordinates(f, combined(1.0, p, -s->distance, f.d), w, out);
        return;
    case TURN: {
        const double c = cos(s->distance), n = sin(s->distance);
        const Frame turned = {combined(c, f.x, n, f.y), combined(-n, f.x, c, f.y), f.d};
        coordinates(turned, p, w, out);
        return;
    }
    case PROJECT:
        coordinates(f, p, w, out);
        p = combined(1.0, p, -p.z / w.z, w);
        out[0] = p.y;
        out[1] = p.x;
        return;
    case UNPROJECT:
        coordinates(f, (Vector){q[1], q[0], 0.0}, w, out);
        return;
    case CURVE: {
        const Vector n =
            unit((Vector){s->k.xy * q[0] + s->k.yy * q[1], s->k.xx * q[0] + s->k.xy * q[1], 1.0});
        /* The smallest turn that takes n back to (0, 0, 1), applied to w. */
        const Vector half = unit(combined(1.0, n, 1.0, (Vector){0, 0, 1}));
        const Vector once = combined(2.0 * dot(half, w), half, -1.0, w);
        coordinates(f, p, (Vector){-once.x, -once.y, once.z}, out);
        out[0] = q[0];
        out[1] = q[1];
        return;
    }
    default:
        break;
    }
    /* Intersect: a t^2 + b t + c = 0, the root next to zero. */
    const double a = 0.5 * quadratic_form(s->k, w, w);
    const double b = w.z + quadratic_form(s->k, p, w);
    const double c = p.z + 0.5 * quadratic_form(s->k, p, p);
    p = combined(1.0, p, -2.0 * c / (b - sqrt(b * b - 4.0 * a * c)), w);
    const Vector n =
        unit((Vector){s->k.xy * p.y + s->k.yy * p.x, s->k.xx * p.y + s->k.xy * p.x, 1.0});
    const double cos_i = -dot(w, n);
    if (s->event == REFLECT) {
        coordinates(frame_of(s->cos_i, true), p, combined(1.0, w, 2.0 * cos_i, n), out);
        return;
    }
    const double e = s->n1 / s->n2;
    const double cos_t = sqrt(1.0 - e * e * (1.0 - cos_i * cos_i));
    coordinates(frame_of(cos_transmitted(s), false), p, combined(e, w, e * cos_i - cos_t, n), out);
}

/* Derivative at zero of a map of coordinates, by differences of fourth order with step h. */
static Matrix differences(void (*map)(const void *, const double[AXES], double[AXES]),
                          const void *context, double h) {
    Matrix m;
    for (int j = 0; j < AXES; ++j) {
        double f[4][AXES];
        for (int k = 0; k < 4; ++k) {
            double q[AXES] = {0};
            q[j] = h * (double[]){-2.0, -1.0, 1.0, 2.0}[k];
            map(context, q, f[k]);
        }
        for (int i = 0; i < AXES; ++i)
            m.m[i][j] = (8.0 * (f[2][i] - f[1][i]) - (f[3][i] - f[0][i])) / (12.0 * h);
    }
    return m;
}

static void trace_setup(const void *setup, const double q[AXES], double out[AXES]) {
    trace(setup, q, out);
}

static Matrix jacobian(const Setup *s) {
    /* Grazing and critical incidence, where the map is singular, are about cos^2 away. */
    const double cos_min = s->event == REFRACT ? fmin(s->cos_i, cos_transmitted(s)) : s->cos_i;
    return differences(trace_setup, s, fmin(2e-4, 2e-3 * cos_min * cos_min));
}

/* The primal maps in closed form, the twins of the operators. */
static Matrix primal_map(const Setup *s) {
    Matrix m = identity();
    const double c = s->cos_i, d = s->distance;
    const SurfaceCurvature k = s->k;
    switch (s->event) {
    case TRAVEL:
        m.m[0][2] = m.m[1][3] = d;
        break;
    case TURN:
        m.m[0][0] = m.m[1][1] = m.m[2][2] = m.m[3][3] = cos(d);
        m.m[0][1] = m.m[2][3] = sin(d);
        m.m[1][0] = m.m[3][2] = -sin(d);
        break;
    case PROJECT:
        m.m[1][1] = 1.0 / c;
        break;
    case UNPROJECT:
        m.m[1][1] = c;
        break;
    case CURVE:
        m.m[2][0] = c * k.xx, m.m[2][1] = c * k.xy;
        m.m[3][0] = k.xy, m.m[3][1] = k.yy;
        break;
    case REFLECT:
        m.m[2][0] = 2.0 * c * k.xx, m.m[2][1] = 2.0 * k.xy;
        m.m[3][0] = 2.0 * k.xy, m.m[3][1] = 2.0 / c * k.yy;
        break;
    default: {
        const double c_t = cos_transmitted(s), e = s->n1 / s->n2;
        const double g = (s->n2 * c_t - s->n1 * c) / s->n2;
        m.m[1][1] = c_t / c;
        m.m[2][2] = e, m.m[3][3] = e * c / c_t;
        m.m[2][0] = -g * k.xx, m.m[2][1] = -g * k.xy / c;
        m.m[3][0] = -g / c_t * k.xy, m.m[3][1] = -g / c_t * k.yy / c;
    }
    }
    return m;
}

/* The operator under test. */
static bool apply(const Setup *s, Covariance *sigma) {
    switch (s->event) {
    case TRAVEL:
        covariance_travel(sigma, s->distance);
        return true;
    case TURN:
        covariance_rotate(sigma, s->distance);
        return true;
    case PROJECT:
        covariance_project(sigma, s->cos_i);
        return true;
    case UNPROJECT:
        covariance_unproject(sigma, s->cos_i);
        return true;
    case CURVE:
        covariance_curvature(sigma, s->cos_i, s->k);
        return true;
    case REFLECT:
        covariance_reflect(sigma, s->cos_i, s->k);
        return true;
    default:
        return covariance_refract(sigma, s->n1, s->n2, s->cos_i, s->k);
    }
}

/* Incidence up to 84 degrees, either index larger, at least 6 degrees from the critical angle. */
static Setup random_setup(uint64_t *state, Event event) {
    for (;;) {
        const Setup s = {
            .event = event,
            .distance = uniform(state, -3.0, 3.0),
            .cos_i = uniform(state, 0.1, 1.0),
            .n1 = uniform(state, 1.0, 2.0),
            .n2 = uniform(state, 1.0, 2.0),
            .k = {uniform(state, -1.5, 1.5), uniform(state, -1.5, 1.5), uniform(state, -1.5, 1.5)}};
        if (event != REFRACT || s.n1 / s.n2 * sin_from(s.cos_i) < 0.995)
            return s;
    }
}

/* ---- Operators against the tracer ------------------------------------------------------------ */

/* Tracer = closed form of M, and operator = M^-T Sigma M^-1, at random incidence and curvature. */
static void covariance_maps_match_finite_differences(void) {
    uint64_t state = 1;
    for (int event = 0; event < EVENT_COUNT; ++event) {
        double worst_map = 0.0, worst_sigma = 0.0;
        for (int trial = 0; trial < TRIALS; ++trial) {
            const Setup s = random_setup(&state, (Event)event);
            const Matrix m = primal_map(&s);
            worst_map = worse(worst_map, map_difference(jacobian(&s), m));
            const Matrix before = random_spd(&state, SPECTRUM_SIZE);
            const Matrix after = congruence(transposed(inverse(m)), before);
            Covariance sigma = packed_from(before);
            ENSURE(apply(&s, &sigma));
            worst_sigma = worse(worst_sigma, difference(unpacked(&sigma), after));
        }
        ENSURE_NEAR(worst_map, 0.0, 1e-7);
        ENSURE_NEAR(worst_sigma, 0.0, 1e-11);
    }
}

/* Coordinates (x, y, u, v) of one ray of a bundle. */
typedef struct Ray {
    double q[AXES];
} Ray;

static Matrix sample_covariance(const Ray *rays, const double *weight, int count) {
    double total = 0.0, mean[AXES] = {0};
    for (int r = 0; r < count; ++r) {
        total += weight ? weight[r] : 1.0;
        for (int i = 0; i < AXES; ++i)
            mean[i] += rays[r].q[i] * (weight ? weight[r] : 1.0);
    }
    Matrix c = {{{0}}};
    for (int r = 0; r < count; ++r)
        for (int i = 0; i < AXES; ++i)
            for (int j = 0; j < AXES; ++j)
                c.m[i][j] += (weight ? weight[r] : 1.0) * (rays[r].q[i] - mean[i] / total) *
                             (rays[r].q[j] - mean[j] / total);
    return scaled(c, 1.0 / total);
}

/* Largest difference in standard errors: var(C_ij) = (C_ii C_jj + C_ij^2) / count. */
static double standard_errors(Matrix sample, Matrix c, double count) {
    double worst = 0.0;
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j < AXES; ++j)
            worst = worse(worst, fabs(sample.m[i][j] - c.m[i][j]) /
                                     sqrt((c.m[i][i] * c.m[j][j] + c.m[i][j] * c.m[i][j]) / count));
    return worst;
}

static Ray in_rays[RAYS];
static Ray out_rays[RAYS];
static double ray_weight[RAYS];

/* A narrow Gaussian bundle, C from millimetres and milliradians; fills in_rays, returns C. */
static Matrix sample_bundle(uint64_t *state) {
    const double size[AXES] = {1e-3, 2e-3, 1.5e-3, 1e-3};
    Matrix l = {{{0}}};
    for (int i = 0; i < AXES; ++i)
        for (int j = 0; j <= i; ++j)
            l.m[i][j] = size[i] * (i == j ? uniform(state, 0.7, 1.3) : uniform(state, -0.5, 0.5));
    for (int r = 0; r < RAYS; ++r) {
        double z[AXES];
        normals(state, z);
        for (int i = 0; i < AXES; ++i) {
            in_rays[r].q[i] = 0.0;
            for (int j = 0; j <= i; ++j)
                in_rays[r].q[i] += l.m[i][j] * z[j];
        }
    }
    return congruence(l, identity());
}

/* The spectrum predicted from a bundle's true covariance against the moments of the bundle after
 * the event; and from the bundle's own moments, where no sampling error remains. */
static void check_moments(Covariance sigma, Covariance sigma_of_sample, const double *weight,
                          double count) {
    const Matrix c = sample_covariance(out_rays, weight, RAYS);
    ENSURE_NEAR(standard_errors(c, reciprocal(unpacked(&sigma)), count), 0.0, 5.0);
    ENSURE_NEAR(difference(c, reciprocal(unpacked(&sigma_of_sample))), 0.0, 1e-3);
}

static void covariance_maps_match_traced_moments(void) {
    uint64_t state = 2;
    for (int event = 0; event < EVENT_COUNT; ++event) {
        Setup s = random_setup(&state, (Event)event);
        s.cos_i = 0.6;
        s.n1 = 1.0, s.n2 = 1.5;
        const Matrix c = sample_bundle(&state);
        for (int r = 0; r < RAYS; ++r)
            trace(&s, in_rays[r].q, out_rays[r].q);
        Covariance sigma = packed_from(reciprocal(c));
        Covariance own = packed_from(reciprocal(sample_covariance(in_rays, NULL, RAYS)));
        ENSURE(apply(&s, &sigma) && apply(&s, &own));
        check_moments(sigma, own, NULL, RAYS);
    }
}

static void covariance_convolution_matches_moments(void) {
    uint64_t state = 3;
    const Matrix c = sample_bundle(&state);
    const double s_u = 2e-3, s_v = 0.7e-3;
    for (int r = 0; r < RAYS; ++r) {
        double z[AXES];
        normals(&state, z);
        for (int i = 0; i < AXES; ++i)
            out_rays[r].q[i] = in_rays[r].q[i];
        out_rays[r].q[2] += s_u * z[2];
        out_rays[r].q[3] += s_v * z[3];
    }
    Covariance sigma = packed_from(reciprocal(c));
    covariance_convolve_angle(&sigma, s_u * s_u, s_v * s_v);
    const Matrix sample = sample_covariance(out_rays, NULL, RAYS);
    ENSURE_NEAR(standard_errors(sample, reciprocal(unpacked(&sigma)), RAYS), 0.0, 5.0);
}

/* Rays weighted by exp(-(h.q)^2 / (2 s^2)). */
static void covariance_window_matches_weighted_moments(void) {
    uint64_t state = 4;
    const Matrix c = sample_bundle(&state);
    const double h[AXES] = {0.8, -0.3, 0.5, 1.0}, s = 1.5e-3;
    double total = 0.0, total2 = 0.0;
    for (int r = 0; r < RAYS; ++r) {
        double along = 0.0;
        for (int i = 0; i < AXES; ++i)
            along += h[i] * in_rays[r].q[i];
        ray_weight[r] = exp(-0.5 * along * along / (s * s));
        total += ray_weight[r];
        total2 += ray_weight[r] * ray_weight[r];
    }
    Covariance sigma = packed_from(reciprocal(c));
    covariance_window(&sigma, h, s);
    const Matrix sample = sample_covariance(in_rays, ray_weight, RAYS);
    ENSURE_NEAR(standard_errors(sample, reciprocal(unpacked(&sigma)), total * total / total2), 0.0,
                5.0);
}

/* The flux of a bundle falling as exp(-a y) moves its mean and nothing else: the operator's
 * addition is a bound, and small for fields narrower than 1/a. */
static void covariance_attenuation_is_a_bound(void) {
    uint64_t state = 5;
    const Matrix c = sample_bundle(&state);
    const double sigma_t = 300.0, tan_theta = 0.5;
    double total = 0.0, total2 = 0.0;
    for (int r = 0; r < RAYS; ++r) {
        ray_weight[r] = exp(-sigma_t * tan_theta * in_rays[r].q[1]);
        total += ray_weight[r];
        total2 += ray_weight[r] * ray_weight[r];
    }
    const Matrix sample = sample_covariance(in_rays, ray_weight, RAYS);
    ENSURE_NEAR(standard_errors(sample, c, total * total / total2), 0.0, 5.0);

    Covariance sigma = packed_from(reciprocal(c));
    const Covariance before = sigma;
    covariance_attenuate(&sigma, sigma_t, tan_theta);
    const double added = sigma.c[COVARIANCE_YY] - before.c[COVARIANCE_YY];
    ENSURE_NEAR(added * FOUR_PI_2 / (150.0 * 150.0), 1.0, 1e-12);
    sigma.c[COVARIANCE_YY] = before.c[COVARIANCE_YY];
    ENSURE(covariance_difference(&sigma, &before) == 0.0);
}

/* Second moments of a mixture of two spectra, drawn in proportion to their flux. */
static void covariance_sum_matches_moments_of_mixture(void) {
    uint64_t state = 6;
    const Matrix a = sample_bundle(&state);
    for (int r = 0; r < RAYS / 4; ++r)
        for (int i = 0; i < AXES; ++i)
            out_rays[r].q[i] = in_rays[r].q[i];
    const Matrix b = sample_bundle(&state);
    for (int r = RAYS / 4; r < RAYS; ++r)
        for (int i = 0; i < AXES; ++i)
            out_rays[r].q[i] = in_rays[r].q[i];
    Covariance mixed = packed_from(a);
    const Covariance other = packed_from(b);
    double flux = 2.0;
    covariance_add(&mixed, &flux, &other, 6.0);
    ENSURE(flux == 8.0);
    /* Kurtosis of the mixture: allow for twice the Gaussian's error. */
    const Matrix sample = sample_covariance(out_rays, NULL, RAYS);
    ENSURE_NEAR(standard_errors(sample, unpacked(&mixed), RAYS), 0.0, 10.0);

    covariance_add(&mixed, &flux, &other, 0.0);
    ENSURE(flux == 8.0);
    Covariance point = covariance_gaussian(0.0, 0.0, 1.0, 1.0);
    double none = 0.0;
    covariance_add(&point, &none, &other, 1.0);
    ENSURE(covariance_difference(&point, &other) == 0.0 && none == 1.0);
}

/* ---- A path through space -------------------------------------------------------------------- */

enum { BOUNCES = 4 };

/* Spheres met one after the other: radius > 0 when met from outside; e = n1/n2, 0 for a mirror.
 * Coordinates are taken at the origin in `start`, and at `end` in `last`. */
typedef struct Path {
    Vector centre[BOUNCES];
    double radius[BOUNCES], e[BOUNCES];
    Frame start, last;
    Vector end;
} Path;

static Vector bent(Vector w, Vector n, double e) {
    const double cos_i = -dot(w, n);
    if (e == 0.0)
        return combined(1.0, w, 2.0 * cos_i, n);
    return combined(e, w, e * cos_i - sqrt(1.0 - e * e * (1.0 - cos_i * cos_i)), n);
}

static void trace_path(const void *context, const double q[AXES], double out[AXES]) {
    const Path *path = context;
    const Frame f = path->start;
    Vector p = combined(q[0], f.x, q[1], f.y);
    Vector w = unit(combined(1.0, f.d, 1.0, combined(q[2], f.x, q[3], f.y)));
    for (int k = 0; k < BOUNCES; ++k) {
        const double r = path->radius[k];
        const Vector from = combined(1.0, p, -1.0, path->centre[k]);
        const double b = dot(from, w);
        p = combined(1.0, p, -b - copysign(sqrt(b * b - dot(from, from) + r * r), r), w);
        w = bent(w, combined(1.0 / r, p, -1.0 / r, path->centre[k]), path->e[k]);
    }
    coordinates(path->last, combined(1.0, p, -1.0, path->end), w, out);
}

/* Refractions and mirrors in planes of incidence that turn about the ray, in frames of either
 * handedness: the operators' chain against the Jacobian of the whole traced path. */
static void covariance_chain_matches_traced_path(void) {
    uint64_t state = 20;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        Path path = {.start = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
        const Matrix before = random_spd(&state, SPECTRUM_SIZE);
        Covariance sigma = packed_from(before);
        Frame f = path.start;
        Vector p = {0, 0, 0};
        for (int k = 0; k < BOUNCES; ++k) {
            const double t = uniform(&state, 0.1, 0.5), c = uniform(&state, 0.5, 0.95);
            const double phi = uniform(&state, -PI, PI), s = sin_from(c);
            const double n1 = uniform(&state, 1.0, 1.5), n2 = uniform(&state, 1.3, 1.8);
            const double r = uniform(&state, 1.0, 3.0) * (uniform(&state, -1.0, 1.0) < 0 ? -1 : 1);
            const SurfaceCurvature curvature = {1.0 / r, 0.0, 1.0 / r};
            const bool is_mirror = uniform(&state, 0.0, 1.0) < 0.5;
            p = combined(1.0, p, t, f.d);
            covariance_travel(&sigma, t);
            /* ex across the plane of incidence: the normal leans along the turned ey. */
            f = (Frame){combined(cos(phi), f.x, sin(phi), f.y),
                        combined(-sin(phi), f.x, cos(phi), f.y), f.d};
            covariance_rotate(&sigma, phi);
            const Vector n = combined(-c, f.d, s, f.y);
            path.radius[k] = r;
            path.e[k] = is_mirror ? 0.0 : n1 / n2;
            path.centre[k] = combined(1.0, p, -r, n);
            if (is_mirror)
                covariance_reflect(&sigma, c, curvature);
            else
                ENSURE(covariance_refract(&sigma, n1, n2, c, curvature));
            /* The new ey: same projection onto the surface. */
            const Vector d = bent(f.d, n, path.e[k]);
            const Vector tangent = combined(1.0, f.y, -dot(f.y, n), n);
            f = (Frame){f.x, unit(combined(1.0, tangent, -dot(tangent, d), d)), d};
        }
        path.last = f;
        path.end = p;
        const Matrix m = differences(trace_path, &path, 1e-4);
        const Matrix after = congruence(transposed(inverse(m)), before);
        worst = worse(worst, difference(unpacked(&sigma), after));
    }
    ENSURE_NEAR(worst, 0.0, 1e-6);
}

/* ---- Properties of the maps ------------------------------------------------------------------ */

/* Etendue: det M = (n1/n2)^2 and M^T Omega M = (n1/n2) Omega, here of the traced Jacobian. */
static void covariance_maps_conserve_etendue(void) {
    uint64_t state = 7;
    static const Event events[] = {TRAVEL, TURN, REFRACT, REFLECT};
    Matrix omega = {{{0}}};
    omega.m[0][2] = omega.m[1][3] = 1.0;
    omega.m[2][0] = omega.m[3][1] = -1.0;
    double worst_det = 0.0, worst_form = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Setup s = random_setup(&state, events[trial % 4]);
        const double e = s.event == REFRACT ? s.n1 / s.n2 : 1.0;
        const Matrix m = jacobian(&s);
        worst_det = worse(worst_det, fabs(determinant(m) / (e * e) - 1.0));
        worst_form =
            worse(worst_form, map_difference(congruence(transposed(m), omega), scaled(omega, e)));
    }
    ENSURE_NEAR(worst_det, 0.0, 1e-6);
    ENSURE_NEAR(worst_form, 0.0, 1e-6);
}

static void covariance_travel_and_rotation_compose(void) {
    uint64_t state = 8;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double a = uniform(&state, -2.0, 2.0), b = uniform(&state, -2.0, 2.0);
        Covariance two = packed_from(random_spd(&state, SPECTRUM_SIZE));
        Covariance one = two, turned = two, there = two;
        const Covariance start = two;
        covariance_travel(&two, a);
        covariance_travel(&two, b);
        covariance_travel(&one, a + b);
        worst = worse(worst, covariance_difference(&two, &one));
        covariance_rotate(&turned, 2.0 * PI);
        worst = worse(worst, covariance_difference(&turned, &start));
        covariance_rotate(&there, a);
        covariance_travel(&there, b);
        covariance_rotate(&there, -a);
        covariance_travel(&there, -b);
        worst = worse(worst, covariance_difference(&there, &start));
    }
    ENSURE_NEAR(worst, 0.0, 1e-11);
}

/* Turns the ray round: d -> -d, ex kept, so ey and u change sign. */
static void reverse(Covariance *sigma) {
    static const int odd[] = {COVARIANCE_XY, COVARIANCE_XU, COVARIANCE_YV, COVARIANCE_UV};
    for (int i = 0; i < 4; ++i)
        sigma->c[odd[i]] = -sigma->c[odd[i]];
}

static void covariance_refraction_and_reflection_reverse(void) {
    uint64_t state = 9;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Setup s = random_setup(&state, REFRACT);
        const Covariance start = packed_from(random_spd(&state, SPECTRUM_SIZE));
        Covariance sigma = start;
        const SurfaceCurvature behind = {-s.k.xx, s.k.xy, -s.k.yy};
        ENSURE(apply(&s, &sigma));
        reverse(&sigma);
        ENSURE(covariance_refract(&sigma, s.n2, s.n1, cos_transmitted(&s), behind));
        reverse(&sigma);
        worst = worse(worst, covariance_difference(&sigma, &start));

        /* A mirror seen from behind undoes itself. */
        const SurfaceCurvature opposite = {-s.k.xx, -s.k.xy, -s.k.yy};
        sigma = start;
        covariance_reflect(&sigma, s.cos_i, s.k);
        covariance_reflect(&sigma, s.cos_i, opposite);
        worst = worse(worst, covariance_difference(&sigma, &start));
    }
    ENSURE_NEAR(worst, 0.0, 1e-10);
}

/* The operator is the chain that [Liang19] and [Belcour13] describe, with the right curvature. */
static void covariance_refraction_is_its_chain(void) {
    uint64_t state = 10;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Setup s = random_setup(&state, REFRACT);
        const double e = s.n1 / s.n2, c_t = cos_transmitted(&s);
        Covariance sigma = packed_from(random_spd(&state, SPECTRUM_SIZE));
        Covariance chain = sigma;
        ENSURE(apply(&s, &sigma));
        covariance_project(&chain, s.cos_i);
        covariance_curvature(&chain, s.cos_i, s.k);
        Matrix angular = identity();
        angular.m[2][2] = 1.0 / e;
        angular.m[3][3] = c_t / (e * s.cos_i);
        chain = packed_from(congruence(angular, unpacked(&chain)));
        covariance_curvature(&chain, c_t, (SurfaceCurvature){-s.k.xx, -s.k.xy, -s.k.yy});
        covariance_unproject(&chain, c_t);
        worst = worse(worst, covariance_difference(&sigma, &chain));

        sigma = chain;
        covariance_reflect(&sigma, s.cos_i, s.k);
        covariance_project(&chain, s.cos_i);
        covariance_curvature(&chain, s.cos_i, s.k);
        covariance_curvature(&chain, s.cos_i, s.k);
        covariance_unproject(&chain, s.cos_i);
        worst = worse(worst, covariance_difference(&sigma, &chain));
    }
    ENSURE_NEAR(worst, 0.0, 1e-11);
}

/* docs/covariance.md quotes these numbers. */
static void covariance_printed_refraction_is_wrong(void) {
    const double c_i = cos(52.0 * PI / 180.0);
    const Setup s = {.event = REFRACT, .cos_i = c_i, .n1 = 1.0, .n2 = 1.5, .k = {0.7, 0.0, 0.7}};
    const double c_t = cos_transmitted(&s);
    const Matrix spectral = transposed(inverse(jacobian(&s)));
    /* [Liang19] eq. 4: (1, n1 c_i / (n2 c_t)) */
    ENSURE_NEAR(spectral.m[2][2], 1.5, 1e-9);
    ENSURE_NEAR(spectral.m[3][3], 2.073117, 1e-6);
    ENSURE_NEAR(c_i / (1.5 * c_t), 0.482365, 1e-6);
    /* The sagittal curvature: -(G/n2) K against Belcour's -(1 - n1/n2) K. */
    ENSURE_NEAR(jacobian(&s).m[2][0], -0.308316, 1e-6);
    ENSURE_NEAR(-(1.0 - 1.0 / 1.5) * 0.7, -0.233333, 1e-6);
}

static void covariance_stays_positive_semidefinite(void) {
    uint64_t state = 11;
    Covariance sigma = covariance_point(1e-4, 1.0);
    double flux = 1.0;
    int invalid = 0, refracted = 0;
    for (int op = 0; op < 10000; ++op) {
        const Setup s = random_setup(&state, (Event)(op % EVENT_COUNT));
        switch ((int)uniform(&state, 0.0, 8.0)) {
        case 0:
            covariance_convolve_angle(&sigma, uniform(&state, 0.0, 1e-2),
                                      uniform(&state, 0.0, 1.0));
            break;
        case 1: {
            const double h[AXES] = {uniform(&state, -1.0, 1.0), uniform(&state, -1.0, 1.0),
                                    uniform(&state, -1.0, 1.0), uniform(&state, -1.0, 1.0)};
            covariance_window(&sigma, h, uniform(&state, 1e-3, 1.0));
            break;
        }
        case 2:
            covariance_attenuate(&sigma, uniform(&state, 0.0, 10.0), uniform(&state, 0.0, 3.0));
            break;
        case 3: {
            const Covariance other = covariance_area(1e-3, 1e-2, 1.0);
            covariance_add(&sigma, &flux, &other, flux * uniform(&state, 0.0, 1.0));
            flux = 1.0;
            break;
        }
        case 4:
            covariance_scatter_hg(&sigma, uniform(&state, -0.99, 0.99), uniform(&state, -1.0, 1.0));
            break;
        default:
            /* A lone half of a projection is no event of light: pair them. */
            if (s.event == PROJECT || s.event == UNPROJECT) {
                covariance_project(&sigma, s.cos_i);
                covariance_curvature(&sigma, s.cos_i, s.k);
                covariance_unproject(&sigma, s.cos_i);
            } else {
                refracted += apply(&s, &sigma) && s.event == REFRACT;
            }
        }
        invalid += !covariance_is_valid(&sigma);
    }
    ENSURE(invalid == 0);
    ENSURE(refracted > 100);

    Covariance bad = covariance_gaussian(1.0, 1.0, 1.0, 1.0);
    bad.c[COVARIANCE_XU] = 1.001 * bad.c[COVARIANCE_XX];
    ENSURE(!covariance_is_valid(&bad));
    bad.c[COVARIANCE_XU] = (double)NAN;
    ENSURE(!covariance_is_valid(&bad));
    bad = covariance_gaussian(1.0, 1.0, 1.0, 1.0);
    bad.c[COVARIANCE_VV] = -1e-12;
    ENSURE(!covariance_is_valid(&bad));
}

/* ---- Convolution: every singular case -------------------------------------------------------- */

static void covariance_convolution_survives_singular_sigma(void) {
    uint64_t state = 12;
    double worst = 0.0, worst_singular = 0.0, worst_infinite = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        Matrix b = {{{0}}};
        b.m[2][2] = FOUR_PI_2 * uniform(&state, 0.0, 1e-3);
        b.m[3][3] = FOUR_PI_2 * uniform(&state, 0.0, 1e-3);
        const double var_u = b.m[2][2] / FOUR_PI_2, var_v = b.m[3][3] / FOUR_PI_2;
        const Matrix full = random_spd(&state, SPECTRUM_SIZE);
        Covariance sigma = packed_from(full);
        covariance_convolve_angle(&sigma, var_u, var_v);
        worst = worse(worst, difference(unpacked(&sigma), inverse(sum(inverse(full), b))));

        /* Rank two: an ideal point that has travelled. (1 + Sigma B)^-1 Sigma needs no inverse of
         * Sigma, unlike the formula. */
        Covariance point = covariance_gaussian(1e-2, 2e-2, (double)INFINITY, (double)INFINITY);
        covariance_travel(&point, 0.7);
        const Matrix rank2 = unpacked(&point);
        covariance_convolve_angle(&point, var_u, var_v);
        const Matrix expected = product(inverse(sum(identity(), product(rank2, b))), rank2);
        worst_singular = worse(worst_singular, difference(unpacked(&point), expected));

        /* A lobe of infinite width leaves S and kills the rest. */
        sigma = packed_from(full);
        const SpatialCovariance spatial = covariance_spatial(&sigma);
        covariance_convolve_angle(&sigma, (double)INFINITY, (double)INFINITY);
        worst_infinite = worse(worst_infinite, fabs(sigma.c[COVARIANCE_XX] / spatial.xx - 1.0));
        worst_infinite = worse(worst_infinite, fabs(sigma.c[COVARIANCE_YY] / spatial.yy - 1.0));
        worst_infinite =
            worse(worst_infinite, fabs(sigma.c[COVARIANCE_XY] - spatial.xy) / spatial.xx);
        for (int i = COVARIANCE_XU; i <= COVARIANCE_VV; ++i)
            ENSURE(sigma.c[i] == 0.0);
    }
    ENSURE_NEAR(worst, 0.0, 1e-11);
    ENSURE_NEAR(worst_singular, 0.0, 1e-11);
    ENSURE_NEAR(worst_infinite, 0.0, 1e-11);

    /* Parallel light takes the shape of the lobe; variance 0 changes nothing. */
    Covariance parallel = covariance_gaussian(0.1, 0.1, 0.0, 0.0);
    covariance_convolve_angle(&parallel, 1e-4, 4e-4);
    const Covariance expected = covariance_gaussian(0.1, 0.1, 1e-2, 2e-2);
    ENSURE_NEAR(covariance_difference(&parallel, &expected), 0.0, 1e-14);
    covariance_convolve_angle(&parallel, 0.0, 0.0);
    ENSURE_NEAR(covariance_difference(&parallel, &expected), 0.0, 1e-14);

    /* Nothing in the angles to kill. */
    Covariance uniform_directions = covariance_gaussian(0.1, 0.1, (double)INFINITY, 1.0);
    const Covariance same = uniform_directions;
    covariance_convolve_angle(&uniform_directions, (double)INFINITY, 0.0);
    for (int i = 0; i < 10; ++i)
        ENSURE(uniform_directions.c[i] == same.c[i]);

    /* Ideal point, travelled: uniform fluence, so nothing survives an infinitely wide lobe. */
    Covariance point = covariance_gaussian(1e-3, 1e-3, (double)INFINITY, (double)INFINITY);
    covariance_travel(&point, 1.3);
    covariance_convolve_angle(&point, (double)INFINITY, (double)INFINITY);
    for (int i = 0; i < 10; ++i)
        ENSURE(point.c[i] == 0.0);
}

static double hg(double g, double theta) {
    return pow(1.0 + g * g - 2.0 * g * cos(theta), -1.5);
}

static void covariance_hg_matches_curvature_of_phase_function(void) {
    uint64_t state = 13;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double g = uniform(&state, -0.95, 0.95), theta = uniform(&state, 0.05, 3.1);
        double in_plane, across;
        covariance_hg_variance(g, cos(theta), &in_plane, &across);
        const double h = 1e-3 * (1.0 - fabs(g)), p = hg(g, theta);
        const double d1 = (8.0 * (hg(g, theta + h) - hg(g, theta - h)) - hg(g, theta + 2.0 * h) +
                           hg(g, theta - 2.0 * h)) /
                          (12.0 * h);
        const double d2 = (16.0 * (hg(g, theta + h) + hg(g, theta - h)) - 30.0 * p -
                           hg(g, theta + 2.0 * h) - hg(g, theta - 2.0 * h)) /
                          (12.0 * h * h);
        /* Against the curvature of the peak: both pass through zero. */
        const double peak = 3.0 * fabs(g) / ((1.0 - fabs(g)) * (1.0 - fabs(g)));
        worst = worse(worst, fabs(1.0 / in_plane - fabs(d2 / p)) / peak);
        worst = worse(worst, fabs(1.0 / across - fabs(d1 / tan(theta) / p)) / peak);
    }
    ENSURE_NEAR(worst, 0.0, 1e-5);

    double in_plane, across;
    covariance_hg_variance(0.9, 1.0, &in_plane, &across);
    ENSURE_NEAR(in_plane / (0.01 / 2.7), 1.0, 1e-12);
    ENSURE_NEAR(across, in_plane, 1e-15);

    /* Across the plane of scattering lies u, in it v. */
    Covariance parallel = covariance_gaussian(1.0, 1.0, 0.0, 0.0);
    covariance_scatter_hg(&parallel, 0.5, 0.8);
    covariance_hg_variance(0.5, 0.8, &in_plane, &across);
    ENSURE_NEAR(parallel.c[COVARIANCE_UU] * FOUR_PI_2 * across, 1.0, 1e-14);
    ENSURE_NEAR(parallel.c[COVARIANCE_VV] * FOUR_PI_2 * in_plane, 1.0, 1e-14);
    ENSURE(fabs(in_plane / across - 1.0) > 0.1);

    Covariance sigma = packed_from(random_spd(&state, SPECTRUM_SIZE));
    const SpatialCovariance before = covariance_spatial(&sigma);
    covariance_scatter_hg(&sigma, 0.9, 1.0);
    const SpatialCovariance after = covariance_spatial(&sigma);
    ENSURE_NEAR(after.xx / before.xx, 1.0, 1e-12);
    ENSURE_NEAR(after.yy / before.yy, 1.0, 1e-12);
    ENSURE(sigma.c[COVARIANCE_UU] <= 2.7 / 0.01 / FOUR_PI_2);
    covariance_scatter_hg(&sigma, 0.0, 0.3);
    ENSURE(sigma.c[COVARIANCE_UU] == 0.0 && sigma.c[COVARIANCE_VV] == 0.0);
    ENSURE_NEAR(sigma.c[COVARIANCE_XX] / before.xx, 1.0, 1e-12);
}

/* ---- Determinant, slice, factor -------------------------------------------------------------- */

static void covariance_log_det_survives_all_pivots(void) {
    uint64_t state = 14;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Covariance sigma = packed_from(random_spd(&state, SPECTRUM_SIZE));
        const CovarianceLogDet det = covariance_log_det(&sigma);
        ENSURE(det.zero_count == 0 && det.infinite_count == 0);
        worst = worse(worst, fabs(det.log_finite - log(determinant(unpacked(&sigma)))));
    }
    ENSURE_NEAR(worst, 0.0, 1e-12);

    /* |Sigma| itself would overflow or underflow. */
    const Covariance tiny = covariance_gaussian(1e-120, 1e-120, 1e-50, 1e-50);
    ENSURE_NEAR(covariance_log_det(&tiny).log_finite, 680.0 * log(10.0) - 4.0 * log(FOUR_PI_2),
                1e-10);
    const double inf = (double)INFINITY;
    Covariance point = covariance_gaussian(0.0, 0.0, 1e-2, 1e-2);
    ENSURE(covariance_log_det(&point).infinite_count == 2);
    ENSURE_NEAR(covariance_log_det(&point).log_finite, 2.0 * log(1e4 / FOUR_PI_2), 1e-12);
    point = covariance_gaussian(1e-6, 1e-6, inf, inf);
    covariance_travel(&point, 2.0);
    covariance_rotate(&point, 0.4);
    ENSURE(covariance_log_det(&point).zero_count == 2);
    const Covariance nothing = covariance_gaussian(inf, inf, inf, inf);
    ENSURE(covariance_log_det(&nothing).zero_count == 4);
    ENSURE(covariance_log_det(&nothing).log_finite == 0.0);
    const Covariance both = covariance_gaussian(0.0, inf, 0.0, 1.0);
    ENSURE(covariance_log_det(&both).zero_count == 1);
    ENSURE(covariance_log_det(&both).infinite_count == 2);
}

static void covariance_spatial_is_marginal_of_position(void) {
    uint64_t state = 15;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Covariance sigma = packed_from(random_spd(&state, SPECTRUM_SIZE));
        const Matrix c = reciprocal(unpacked(&sigma));
        const double det = c.m[0][0] * c.m[1][1] - c.m[0][1] * c.m[1][0];
        const SpatialCovariance s = covariance_spatial(&sigma);
        worst = worse(worst, fabs(s.xx * FOUR_PI_2 * det / c.m[1][1] - 1.0));
        worst = worse(worst, fabs(s.yy * FOUR_PI_2 * det / c.m[0][0] - 1.0));
        worst = worse(worst, fabs(s.xy / s.xx + c.m[0][1] / c.m[1][1]));
        worst = worse(worst, fabs(spatial_covariance_sqrt_det(s) * FOUR_PI_2 * sqrt(det) - 1.0));
    }
    ENSURE_NEAR(worst, 0.0, 1e-12);
}

static void covariance_spatial_survives_singular_sources(void) {
    const double inf = (double)INFINITY;
    /* A point of uniform intensity, travelled: uniform fluence. */
    Covariance sigma = covariance_gaussian(1e-6, 1e-6, inf, inf);
    covariance_travel(&sigma, 3.0);
    covariance_rotate(&sigma, 1.0);
    SpatialCovariance s = covariance_spatial(&sigma);
    ENSURE(s.xx == 0.0 && s.xy == 0.0 && s.yy == 0.0);
    ENSURE(covariance_frequency_factor(&sigma, 1.0) == 0.0);
    /* At an ideal point: all frequencies. */
    sigma = covariance_gaussian(0.0, 0.0, 1e-2, 1e-2);
    ENSURE(isinf(spatial_covariance_sqrt_det(covariance_spatial(&sigma))));
    ENSURE(covariance_frequency_factor(&sigma, 1.0) == 1.0);
    ENSURE(covariance_spatial(&sigma).xy == 0.0);
    /* Ideally parallel light: the direction does not touch the fluence. */
    sigma = covariance_gaussian(0.1, 0.2, 0.0, 0.0);
    s = covariance_spatial(&sigma);
    ENSURE_NEAR(s.xx * FOUR_PI_2 * 0.01, 1.0, 1e-14);
    ENSURE_NEAR(s.yy * FOUR_PI_2 * 0.04, 1.0, 1e-14);
    /* Dirac one way, uniform the other: neither concentrated. */
    sigma = covariance_gaussian(0.0, inf, 1.0, 1.0);
    ENSURE(spatial_covariance_sqrt_det(covariance_spatial(&sigma)) == 0.0);

    /* The sun: after a distance the disc blurs the cell, C_xx = A/12 + d^2 theta^2/4. */
    sigma = covariance_directional(1e-6, 4.65e-3, 1.0);
    covariance_travel(&sigma, 1.0);
    const double c_xx = 1e-6 / 12.0 + 0.25 * 4.65e-3 * 4.65e-3;
    ENSURE_NEAR(covariance_spatial(&sigma).xx * FOUR_PI_2 * c_xx, 1.0, 1e-9);
    /* An ideal sun keeps the cell's own cross-section, factor 1/2 at every depth. */
    sigma = covariance_directional(1e-6, 0.0, 10.0);
    for (int i = 0; i < 10; ++i) {
        ENSURE_NEAR(covariance_frequency_factor(&sigma, 1e-6), 0.5, 1e-7);
        covariance_travel(&sigma, 1.0);
    }
    /* A laser: a cell of 1e-12 sr, read a millimetre and ten metres away. */
    for (int i = 0; i < 2; ++i) {
        const double d = i == 0 ? 1e-3 : 10.0;
        sigma = covariance_point(1e-12, d);
        covariance_travel(&sigma, d);
        ENSURE_NEAR(covariance_spatial(&sigma).xx * FOUR_PI_2 * d * d * 1e-12 / 12.0, 1.0, 1e-6);
    }
    /* Spot: in the blurred edge the window narrows u, so the fluence has more of Omega_x. */
    sigma = covariance_spot(1e-2, 0.02, 1.0);
    covariance_travel(&sigma, 1.0);
    const double var_u = 1.0 / (12.0 / 1e-2 + 12.0 / 4e-4);
    ENSURE_NEAR(covariance_spatial(&sigma).xx * FOUR_PI_2 * var_u, 1.0, 1e-6);
    ENSURE_NEAR(covariance_spatial(&sigma).yy * FOUR_PI_2 * 1e-2 / 12.0, 1.0, 1e-6);
    /* Area light: source and cell add. */
    sigma = covariance_area(1e-2, 1e-2, 1.0);
    covariance_travel(&sigma, 2.0);
    ENSURE_NEAR(covariance_spatial(&sigma).xx * FOUR_PI_2 * (1e-2 / 12.0 + 4e-2 / 12.0), 1.0,
                1e-12);
}

/* A point light at height h over a slab: B_sag = h/c_i + s/n, B_mer = (h/c_i)(c_t/c_i) +
 * (s/n)(c_i/c_t), and sqrt|S| = 1/(4 pi^2 s_u^2 |B_sag B_mer|). */
static void covariance_slab_matches_closed_form(void) {
    uint64_t state = 16;
    const SurfaceCurvature flat = {0, 0, 0};
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double n = uniform(&state, 1.1, 2.0), c_i = uniform(&state, 0.1, 1.0);
        const double h = uniform(&state, 0.1, 3.0), s = uniform(&state, 0.0, 3.0);
        const double c_t = sqrt(1.0 - (1.0 - c_i * c_i) / (n * n)), solid_angle = 1e-4;
        Covariance sigma = covariance_point(solid_angle, h / c_i);
        covariance_travel(&sigma, h / c_i);
        ENSURE(covariance_refract(&sigma, 1.0, n, c_i, flat));
        covariance_travel(&sigma, s);
        const double b_sag = h / c_i + s / n;
        const double b_mer = h / c_i * c_t / c_i + s / n * c_i / c_t;
        const SpatialCovariance spatial = covariance_spatial(&sigma);
        const double spread = FOUR_PI_2 * solid_angle / 12.0;
        worst = worse(worst, fabs(spatial.xx * spread * b_sag * b_sag - 1.0));
        worst = worse(worst, fabs(spatial.yy * spread * b_mer * b_mer - 1.0));
        worst =
            worse(worst, fabs(spatial_covariance_sqrt_det(spatial) * spread * b_sag * b_mer - 1.0));
    }
    ENSURE_NEAR(worst, 0.0, 2e-5);
}

/* On the axis of a sphere: B(s) = L + s/n - s (n-1) L / (n R). */
static double sphere_b(double l, double r, double n, double s) {
    return l + s / n - s * (n - 1.0) * l / (n * r);
}

static void covariance_sphere_matches_closed_form(void) {
    uint64_t state = 17;
    double worst = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const double n = uniform(&state, 1.1, 2.5), r = uniform(&state, 0.3, 2.0);
        const double l = uniform(&state, 0.5, 10.0), s = uniform(&state, 0.0, 2.0 * r);
        const double b = sphere_b(l, r, n, s), solid_angle = 1e-4;
        /* Nearer the focus the extent that a point is given shows. */
        if (fabs(b) < 0.3 * l)
            continue;
        Covariance sigma = covariance_point(solid_angle, l);
        covariance_travel(&sigma, l);
        ENSURE(covariance_refract(&sigma, 1.0, n, 1.0, (SurfaceCurvature){1.0 / r, 0.0, 1.0 / r}));
        covariance_travel(&sigma, s);
        const double root = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
        worst = worse(worst, fabs(root * FOUR_PI_2 * solid_angle / 12.0 * b * b - 1.0));
    }
    /* Rounding: a condition of 1e8 from the source, times (L/R)^2 up to 1e3 from the surface. */
    ENSURE_NEAR(worst, 0.0, 2e-4);

    /* Parallel light of n = 2.5 focuses inside, at s = n R / (n - 1): factor 1/2 to 1 and back. */
    const double n = 2.5, focus = n / (n - 1.0);
    Covariance sigma = covariance_directional(1e-4, 0.0, 1.0);
    ENSURE(covariance_refract(&sigma, 1.0, n, 1.0, (SurfaceCurvature){1.0, 0.0, 1.0}));
    ENSURE_NEAR(covariance_frequency_factor(&sigma, 1e-4), 0.5, 1e-7);
    covariance_travel(&sigma, focus);
    ENSURE(covariance_frequency_factor(&sigma, 1e-4) > 1.0 - 1e-6);
    covariance_travel(&sigma, focus);
    ENSURE_NEAR(covariance_frequency_factor(&sigma, 1e-4), 0.5, 1e-7);
    covariance_travel(&sigma, 100.0 * focus);
    ENSURE(covariance_frequency_factor(&sigma, 1e-4) < 1e-3);
}

/* [Liang19] eq. 7 cannot see a caustic: |Sigma| takes (n2/n1)^4 at each refraction and then stays,
 * while the irradiance changes with the depth. docs/covariance.md quotes the numbers. */
static void covariance_determinant_is_blind_to_focusing(void) {
    const double n = 1.5, l = 5.0;
    Covariance sigma = {{0}};
    sigma.c[COVARIANCE_XX] = sigma.c[COVARIANCE_YY] = 1e5;
    sigma.c[COVARIANCE_UU] = sigma.c[COVARIANCE_VV] = 1.0;
    covariance_travel(&sigma, l);
    ENSURE(covariance_refract(&sigma, 1.0, n, 1.0, (SurfaceCurvature){1.0, 0.0, 1.0}));
    const double root_at_entry = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
    double worst = 0.0;
    for (int i = 0; i < 10; ++i) {
        worst = worse(worst, fabs(exp(covariance_log_det(&sigma).log_finite) / 5.0625e10 - 1.0));
        covariance_travel(&sigma, 0.2);
    }
    ENSURE_NEAR(worst, 0.0, 1e-6);
    const double ratio = spatial_covariance_sqrt_det(covariance_spatial(&sigma)) / root_at_entry;
    const double b = l / sphere_b(l, 1.0, n, 2.0);
    ENSURE_NEAR(b * b, 2.7778, 1e-4);
    ENSURE_NEAR(ratio / (b * b), 1.0, 1e-5);

    /* The table of docs/covariance.md: the factor follows q = a_0/a. */
    sigma = covariance_point(1e-4, l);
    covariance_travel(&sigma, l);
    ENSURE(covariance_refract(&sigma, 1.0, n, 1.0, (SurfaceCurvature){1.0, 0.0, 1.0}));
    for (int i = 0; i < 5; ++i) {
        const double spread = l / sphere_b(l, 1.0, n, 0.5 * i), q = spread * spread;
        ENSURE_NEAR(covariance_log_det(&sigma).log_finite, 64.1034419, 1e-6);
        ENSURE_NEAR(covariance_frequency_factor(&sigma, 1e-4 * l * l), q / (1.0 + q), 1e-6);
        covariance_travel(&sigma, 0.5);
    }

    /* Any lossless path: random frames, curved refractions, mirrors, distances. Short ones: the
     * condition number grows with every event, and the digits left in the last pivot shrink. */
    uint64_t state = 18;
    double worst_path = 0.0;
    int kept = 0;
    for (int path = 0; path < TRIALS; ++path) {
        Covariance walk = packed_from(random_spd(&state, SPECTRUM_SIZE));
        double expected = covariance_log_det(&walk).log_finite;
        for (int event = 0; event < 4; ++event) {
            Setup s = random_setup(&state, event % 2 ? REFLECT : REFRACT);
            covariance_travel(&walk, 0.1 * fabs(s.distance));
            covariance_rotate(&walk, s.distance);
            ENSURE(apply(&s, &walk));
            expected += event % 2 ? 0.0 : 4.0 * log(s.n2 / s.n1);
        }
        const CovarianceLogDet det = covariance_log_det(&walk);
        kept += det.zero_count == 0;
        if (det.zero_count == 0)
            worst_path = worse(worst_path, fabs(det.log_finite - expected));
    }
    ENSURE(kept == TRIALS);
    ENSURE_NEAR(worst_path, 0.0, 1e-6);
}

/* ---- Limits ---------------------------------------------------------------------------------- */

static bool is_unchanged(const Covariance *a, const Covariance *b) {
    for (int i = 0; i < 10; ++i)
        if (a->c[i] != b->c[i])
            return false;
    return true;
}

static void covariance_total_reflection_has_two_sides(void) {
    const SurfaceCurvature k = {-1.0, 0.2, -1.0};
    const Covariance start = covariance_area(1e-2, 1e-3, 1.0);
    const double critical = sqrt(1.0 - 1.0 / 2.25);
    Covariance inside = start, outside = start, mirror_inside = start, mirror_outside = start;
    ENSURE(!covariance_refract(&inside, 1.5, 1.0, critical - 1e-9, k));
    ENSURE(is_unchanged(&inside, &start));
    ENSURE(covariance_refract(&outside, 1.5, 1.0, critical + 1e-9, k));
    ENSURE(covariance_is_valid(&outside));
    /* The guarded cosine bounds the derivative and conserves etendue all the same. */
    ENSURE_NEAR(covariance_log_det(&outside).log_finite - covariance_log_det(&start).log_finite,
                -4.0 * log(1.5), 1e-6);
    ENSURE_NEAR(outside.c[COVARIANCE_VV] * 2.25 * critical * critical / start.c[COVARIANCE_VV],
                COVARIANCE_COS_TRANSMITTED_MIN * COVARIANCE_COS_TRANSMITTED_MIN, 1e-14);
    /* The mirror does not know of the critical angle. */
    covariance_reflect(&mirror_inside, critical - 1e-9, k);
    covariance_reflect(&mirror_outside, critical + 1e-9, k);
    ENSURE_NEAR(covariance_difference(&mirror_inside, &mirror_outside), 0.0, 1e-7);
}

static void covariance_grazing_is_refused_or_finite(void) {
    const SurfaceCurvature k = {5.0, -1.0, 3.0};
    const Covariance start = covariance_area(1e-2, 1e-3, 1.0);
    Covariance sigma = start;
    ENSURE(!covariance_refract(&sigma, 1.0, 1.5, 0.99 * COVARIANCE_COS_INCIDENT_MIN, k));
    ENSURE(!covariance_refract(&sigma, 1.0, 1.5, 0.0, k));
    ENSURE(!covariance_refract(&sigma, 1.0, 1.5, (double)NAN, k));
    ENSURE(is_unchanged(&sigma, &start));
    ENSURE(covariance_refract(&sigma, 1.0, 1.5, 1.01 * COVARIANCE_COS_INCIDENT_MIN, k));
    ENSURE(covariance_is_valid(&sigma));
    sigma = start;
    covariance_reflect(&sigma, COVARIANCE_COS_INCIDENT_MIN, k);
    ENSURE(covariance_is_valid(&sigma));
    /* Equal indices: no boundary at all, whatever the curvature. */
    sigma = start;
    ENSURE(covariance_refract(&sigma, 1.3, 1.3, 0.2, k));
    ENSURE_NEAR(covariance_difference(&sigma, &start), 0.0, 1e-14);
}

/* ---- The square-root form -------------------------------------------------------------------- */

static void covariance_tangents_are_its_square_root(void) {
    uint64_t state = 19;
    double worst = 0.0, worst_back = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const int count = 4 + trial % 4;
        LocalTangent tangents[7];
        Matrix c = {{{0}}};
        for (int k = 0; k < count; ++k) {
            normals(&state, tangents[k].q);
            for (int i = 0; i < AXES; ++i)
                tangents[k].q[i] *= 1.0 / SPECTRUM_SIZE[i];
            for (int i = 0; i < AXES; ++i)
                for (int j = 0; j < AXES; ++j)
                    c.m[i][j] += tangents[k].q[i] * tangents[k].q[j];
        }
        Covariance sigma, again;
        ENSURE(covariance_from_tangents(tangents, count, &sigma));
        /* A random square array may be close to singular: weigh by what the twin's inverse keeps.
         */
        const Matrix identity_again = product(scaled(unpacked(&sigma), FOUR_PI_2), c);
        const double kept = map_difference(product(inverse(c), c), identity());
        worst = worse(worst, map_difference(identity_again, identity()) / (kept + 1e-13));
        LocalTangent roots[4];
        if (covariance_to_tangents(&sigma, roots)) {
            ENSURE(covariance_from_tangents(roots, 4, &again));
            if (kept < 1e-13)
                worst_back = worse(worst_back, covariance_difference(&again, &sigma));
        }
        const SpatialCovariance direct = spatial_covariance_from_tangents(tangents, count);
        const SpatialCovariance through = covariance_spatial(&sigma);
        if (kept < 1e-13)
            worst_back = worse(worst_back, fabs(through.xx / direct.xx - 1.0) +
                                               fabs(through.xy - direct.xy) / direct.xx);
    }
    ENSURE_NEAR(worst, 0.0, 100.0);
    ENSURE_NEAR(worst_back, 0.0, 1e-9);

    /* What one form maps by M, the other maps by M^-T: a source through a curved surface. */
    double worst_path = 0.0;
    for (int trial = 0; trial < TRIALS; ++trial) {
        const Setup s = random_setup(&state, REFRACT);
        const Matrix m = primal_map(&s);
        LocalTangent tangents[4] = {
            {{1e-2, 0, 0, 0}}, {{0, 2e-2, 0, 0}}, {{0, 0, 3e-2, 0}}, {{0, 0, 0, 1e-2}}};
        Covariance sigma = covariance_gaussian(1e-2, 2e-2, 3e-2, 1e-2), mapped;
        ENSURE(apply(&s, &sigma));
        for (int k = 0; k < 4; ++k) {
            LocalTangent out = {{0}};
            for (int i = 0; i < AXES; ++i)
                for (int j = 0; j < AXES; ++j)
                    out.q[i] += m.m[i][j] * tangents[k].q[j];
            tangents[k] = out;
        }
        ENSURE(covariance_from_tangents(tangents, 4, &mapped));
        worst_path = worse(worst_path, covariance_difference(&mapped, &sigma));
    }
    ENSURE_NEAR(worst_path, 0.0, 1e-11);

    /* An ideal point has two tangents: no Sigma, but S, and at a focus an infinite one. */
    const LocalTangent point[2] = {{{0.2, 0, 0.1, 0}}, {{0, 0.2, 0, 0.1}}};
    const LocalTangent focus[2] = {{{0, 0, 0.1, 0}}, {{0, 0, 0, 0.1}}};
    Covariance untouched = covariance_gaussian(1, 1, 1, 1), same = untouched;
    ENSURE(!covariance_from_tangents(point, 2, &untouched));
    ENSURE(!covariance_from_tangents(point, 0, &untouched));
    ENSURE(is_unchanged(&untouched, &same));
    ENSURE_NEAR(spatial_covariance_from_tangents(point, 2).xx * FOUR_PI_2 * 0.04, 1.0, 1e-14);
    const SpatialCovariance at_focus = spatial_covariance_from_tangents(focus, 2);
    ENSURE(isinf(spatial_covariance_sqrt_det(at_focus)));
    LocalTangent none[4];
    const Covariance dirac = covariance_gaussian(0, 1, 1, 1);
    const Covariance flat = covariance_gaussian((double)INFINITY, 1, 1, 1);
    ENSURE(!covariance_to_tangents(&dirac, none));
    ENSURE(!covariance_to_tangents(&flat, none));
}

void test_covariance(void);

void test_covariance(void) {
    RUN(covariance_maps_match_finite_differences);
    RUN(covariance_maps_match_traced_moments);
    RUN(covariance_convolution_matches_moments);
    RUN(covariance_window_matches_weighted_moments);
    RUN(covariance_attenuation_is_a_bound);
    RUN(covariance_sum_matches_moments_of_mixture);
    RUN(covariance_chain_matches_traced_path);
    RUN(covariance_maps_conserve_etendue);
    RUN(covariance_travel_and_rotation_compose);
    RUN(covariance_refraction_and_reflection_reverse);
    RUN(covariance_refraction_is_its_chain);
    RUN(covariance_printed_refraction_is_wrong);
    RUN(covariance_stays_positive_semidefinite);
    RUN(covariance_convolution_survives_singular_sigma);
    RUN(covariance_hg_matches_curvature_of_phase_function);
    RUN(covariance_log_det_survives_all_pivots);
    RUN(covariance_spatial_is_marginal_of_position);
    RUN(covariance_spatial_survives_singular_sources);
    RUN(covariance_slab_matches_closed_form);
    RUN(covariance_sphere_matches_closed_form);
    RUN(covariance_determinant_is_blind_to_focusing);
    RUN(covariance_total_reflection_has_two_sides);
    RUN(covariance_grazing_is_refused_or_finite);
    RUN(covariance_tangents_are_its_square_root);
}
