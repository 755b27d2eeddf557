/* SPDX-License-Identifier: GPL-3.0-or-later
 * Hard cases of the operators: where optics degenerates, what is true there, and by how much
 * single precision may miss it. One line of a table each; the errors are printed for
 * docs/stability.md, which tests/stability writes. */
#include <stddef.h>
#include <stdio.h>

#include "optics/covariance.h"
#include "optics/dielectric.h"
#include "optics/kernel.h"
#include "optics/medium.h"
#include "optics/tangent.h"
#include "test.h"

static const long double PI_L = 3.14159265358979323846264338327950288L;
static const double FOUR_PI_2 = 39.478417604357434;

typedef struct HardCase {
    const char *group, *name, *truth;
    double bound;
    double (*error)(double parameter);
    double parameter;
} HardCase;

static double relative(long double value, long double truth) {
    return value == truth ? 0.0 : (double)(fabsl(value - truth) / fabsl(truth));
}

/* ---- Dielectrics ----------------------------------------------------------------------------- */

/* Snell and Fresnel in long double, from the cosine that single precision was given. */
typedef struct ExactSplit {
    long double cos_t, reflectance;
} ExactSplit;

static ExactSplit exact_split(long double c, long double eta) {
    const long double square = (1.0L - eta) * (1.0L + eta) + eta * eta * c * c;
    if (square <= 0.0L)
        return (ExactSplit){0.0L, 1.0L};
    const long double t = sqrtl(square);
    const long double p = (c - eta * t) / (c + eta * t), s = (eta * c - t) / (eta * c + t);
    return (ExactSplit){t, 0.5L * (p * p + s * s)};
}

/* A ray at the cosine c from the normal (0, 0, 1): no rounding before the split itself. */
static DielectricSplit split_at(double cosine, double eta) {
    const float c = (float)cosine;
    return dielectric_split(vec3(sqrtf((1.0f - c) * (1.0f + c)), 0, -c), vec3(0, 0, 1), (float)eta);
}

/* Worst relative error of the transmittance and of the cosine behind, over cosines down to 1e-9,
 * where the answer is well conditioned in the cosine. */
static double split_error(double eta) {
    double worst = 0.0;
    for (double c = 1.0; c > 1e-9; c *= 0.7) {
        const DielectricSplit s = split_at(c, eta);
        const ExactSplit exact = exact_split((long double)(float)c, (long double)(float)eta);
        if (exact.reflectance >= 1.0L) {
            worst = test_worse(worst, s.reflectance == 1.0f ? 0.0 : 1.0);
            continue;
        }
        worst = test_worse(worst, relative((long double)s.cos_t, exact.cos_t));
        worst = test_worse(worst, fabs((double)((long double)s.reflectance - exact.reflectance)));
        worst = test_worse(worst, fabs((double)vec3_length(s.refracted) - 1.0));
        worst = test_worse(worst, fabs((double)vec3_length(s.reflected) - 1.0));
    }
    return worst;
}

/* Transmittance of rays that graze the surface, relative: it falls with the cosine. */
static double grazing_error(double cosine) {
    static const double etas[] = {1.0 / 4.0, 1.0 / 1.5, 1.0 / 1.0001, 1.0 / (1.0 + 0x1p-23)};
    double worst = 0.0;
    for (size_t i = 0; i < sizeof etas / sizeof etas[0]; ++i) {
        const DielectricSplit s = split_at(cosine, etas[i]);
        const ExactSplit e = exact_split((long double)(float)cosine, (long double)(float)etas[i]);
        worst = test_worse(
            worst, fabs((double)((1.0L - (long double)s.reflectance) - (1.0L - e.reflectance))));
        worst = test_worse(worst, fabs((double)(vec3_dot(s.refracted, s.refracted) - 1.0f)));
    }
    return worst;
}

/* From a dense medium, `offset` (of the sine, relative) to the critical angle: 1 beyond it, and
 * before it 1 - F falls as the root of the offset. */
static double critical_error(double offset) {
    double worst = 0.0;
    for (double n = 1.01; n < 4.0; n *= 1.2) {
        const double sine = (1.0 + offset) / n;
        const double c = sqrt((1.0 - sine) * (1.0 + sine));
        const DielectricSplit s = split_at(c, n);
        const ExactSplit e = exact_split((long double)(float)c, (long double)(float)n);
        worst = test_worse(worst, fabs((double)((long double)s.reflectance - e.reflectance)));
    }
    return worst;
}

/* The image must not jump where ior passes 1: F at eta = 1 + x and at 1. */
static double step_through_one(double x) {
    double worst = 0.0;
    for (double c = 1.0; c > 0.3; c *= 0.8) {
        const DielectricSplit a = split_at(c, 1.0 / (1.0 + x)), b = split_at(c, 1.0);
        worst = test_worse(worst, (double)vec3_length(vec3_sub(a.refracted, b.refracted)));
        worst = test_worse(worst, (double)fabsf(a.reflectance - b.reflectance));
    }
    return worst;
}

/* ---- Covariance ------------------------------------------------------------------------------ */

/* sqrt|S| of a point source after `distance` metres: 1 / (4 pi^2 s_u^2 distance^2). */
static double travel_from_point(double distance) {
    const double solid_angle = 1e-4, s_u2 = solid_angle / 12.0;
    Covariance sigma = covariance_point(solid_angle, distance);
    covariance_travel(&sigma, distance);
    const double found = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
    return covariance_is_valid(&sigma)
               ? relative((long double)found,
                          1.0L / (long double)(FOUR_PI_2 * s_u2 * distance * distance))
               : (double)INFINITY;
}

/* An ideal point (infinite entries): the same without a bias. */
static double travel_from_dirac(double distance) {
    Covariance sigma = covariance_gaussian(0.0, 0.0, 1e-3, 1e-3);
    (void)distance;
    const double before = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
    const LocalTangent tangents[2] = {{{1e-3 * distance, 0, 1e-3, 0}},
                                      {{0, 1e-3 * distance, 0, 1e-3}}};
    const double after = spatial_covariance_sqrt_det(spatial_covariance_from_tangents(tangents, 2));
    const long double truth = 1.0L / (long double)(FOUR_PI_2 * 1e-6 * distance * distance);
    return isinf(before) ? relative((long double)after, truth) : (double)INFINITY;
}

/* Parallel light: travel changes nothing but by its blur of 1e-4 in angle. */
static double travel_of_sun(double distance) {
    Covariance sigma = covariance_directional(1e-2, 0.0, distance);
    const double before = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
    covariance_travel(&sigma, 1e-3 * distance);
    return relative((long double)spatial_covariance_sqrt_det(covariance_spatial(&sigma)),
                    (long double)before);
}

/* A beam as thin as `width` with a divergence of a milliradian, travelled a metre. */
static double laser(double width) {
    Covariance sigma = covariance_gaussian(width, width, 1e-3, 1e-3);
    covariance_travel(&sigma, 1.0);
    const long double c = (long double)width * (long double)width + 1e-6L;
    const double found = spatial_covariance_sqrt_det(covariance_spatial(&sigma));
    return covariance_is_valid(&sigma)
               ? relative((long double)found, 1.0L / ((long double)FOUR_PI_2 * c))
               : (double)INFINITY;
}

/* `count` random operators in a row: the matrix must stay positive semidefinite up to 1e-9 of its
 * diagonal (it is symmetric by its storage). 0 if it does after each. */
static double random_operators(double count) {
    uint64_t state = 4;
    Covariance sigma = covariance_gaussian(1e-2, 2e-2, 1e-2, 3e-2);
    double bad = 0.0;
    for (int i = 0; i < (int)count; ++i) {
        const double a = test_uniform(&state, -1.0, 1.0);
        const double c = test_uniform(&state, 0.2, 1.0);
        const SurfaceCurvature k = {a, 0.3 * a, -a};
        const double window[4] = {a, 1.0, c, -a};
        switch ((int)test_uniform(&state, 0.0, 9.0)) {
        case 0:
            covariance_travel(&sigma, a);
            break;
        case 1:
            covariance_rotate(&sigma, a);
            break;
        case 2:
            covariance_refract(&sigma, 1.0, 1.5, c, k);
            break;
        case 3:
            covariance_refract(&sigma, 1.5, 1.0, c, k);
            break;
        case 4:
            covariance_reflect(&sigma, c, k);
            break;
        case 5:
            covariance_convolve_angle(&sigma, 1e-4 * (1.0 + a), 1e-4);
            break;
        case 6:
            covariance_window(&sigma, window, 10.0);
            break;
        case 7:
            covariance_attenuate(&sigma, 1.0, a);
            break;
        default:
            covariance_scatter_hg(&sigma, 0.9 * a, c);
            break;
        }
        bad += covariance_is_valid(&sigma) ? 0.0 : 1.0;
    }
    return bad;
}

/* A world `scale` times as large: the frequency factor is the same. */
static double covariance_scale(double scale) {
    double factor[2];
    for (int i = 0; i < 2; ++i) {
        const double m = i == 0 ? 1.0 : scale;
        Covariance sigma = covariance_point(1e-3, 3.0 * m);
        covariance_travel(&sigma, 3.0 * m);
        const SurfaceCurvature k = {1.0 / m, 0.0, 1.0 / m};
        if (!covariance_refract(&sigma, 1.0, 1.5, 0.8, k))
            return (double)INFINITY;
        covariance_travel(&sigma, 1.2 * m);
        factor[i] = covariance_frequency_factor(&sigma, 1e-3 * 9.0 * m * m);
    }
    return relative((long double)factor[1], (long double)factor[0]);
}

/* Refraction at a surface of this curvature, against the map of theory in long double: the spatial
 * spectrum of a Gaussian beam just behind, which curvature does not change, and a focus behind. */
static double curvature(double k) {
    const double eta = 1.0 / 1.5, s = 1e-3 / fmax(1.0, k), a = 1e-4;
    Covariance sigma = covariance_gaussian(s, s, a, a);
    const SurfaceCurvature curved = {k, 0.0, k};
    if (!covariance_refract(&sigma, 1.0, 1.5, 1.0, curved) || !covariance_is_valid(&sigma))
        return (double)INFINITY;
    /* u' = eta u - (1 - eta) K x; where the beam is narrowest C_xx = C C' / .. by lens formulas:
     * C_xx(z) = s^2 (1 - z (1 - eta) K)^2 + (z eta a)^2. */
    const double z = k > 0.0 ? 0.5 / ((1.0 - eta) * k) : 1.0;
    covariance_travel(&sigma, z);
    const long double bend = 1.0L - (long double)(z * (1.0 - eta) * k);
    const long double wide = (long double)(z * eta * a);
    const long double c = (long double)(s * s) * bend * bend + wide * wide;
    return relative((long double)spatial_covariance_sqrt_det(covariance_spatial(&sigma)),
                    1.0L / ((long double)FOUR_PI_2 * c));
}

/* ---- Tangent pairs --------------------------------------------------------------------------- */

/* The same pairs, surface and ray in float and in long double: what a chain of events costs in
 * digits. Rotationally symmetric about the normal, so one pair across the plane of incidence and
 * one in it tell all. */
typedef struct Twin {
    long double x, u; /* offset, m, and slope of the sagittal pair */
    long double y, v; /* of the meridional one */
} Twin;

static double chain_error(double radius) {
    /* Normal incidence at caps of this radius: travel, refract in, travel, reflect, travel. */
    const float r = (float)radius, eta = 1.0f / 1.5f;
    const Vec3 down = vec3(0, 0, -1), up = vec3(0, 0, 1);
    TangentPair pair = {vec3(0, 0, 0), vec3(1e-3f, 0, 0)};
    const float s = 3.0f * r;
    pair = tangent_travel_to_surface(pair, s, down, up);
    pair = tangent_refract(pair, down, up, vec3_scale(pair.dp, 1.0f / r), eta, 1.0f, 1.0f);
    pair = tangent_travel_to_surface(pair, 2.0f * r, down, up);
    pair = tangent_reflect(pair, down, up, vec3_scale(pair.dp, -1.0f / r), 1.0f);
    pair.dp = vec3_madd(pair.dp, 0.7f * r, pair.dd);
    /* Matrix optics. */
    const long double rl = (long double)r, e = (long double)eta;
    long double x = 0.0L, u = (long double)1e-3f;
    x += 3.0L * rl * u;
    u = e * u - (1.0L - e) * x / rl;
    x += 2.0L * rl * u;
    u = u - 2.0L * x / rl;
    x += (long double)(0.7f * r) * u;
    return test_worse(relative((long double)pair.dp.x, x), relative((long double)pair.dd.x, u));
}

/* The cross-section exactly at a focus, in units of that at entry; 0 in truth. */
static double focus_error(double distance) {
    const float s = (float)distance;
    const TangentPair pairs[TANGENT_COUNT] = {{vec3(1e-2f * s, 0, 0), vec3(-1e-2f, 0, 0)},
                                              {vec3(0, 1e-2f * s, 0), vec3(0, -1e-2f, 0)}};
    const TangentSpread spread = tangent_spread(pairs, vec3(0, 0, 1));
    const float at_focus = tangent_cross_section(&spread, s);
    const float at_entry = tangent_cross_section(&spread, 0.0f);
    const float factor = kernel_frequency(at_entry, at_focus);
    return test_worse((double)(at_focus / at_entry), 1.0 - (double)factor);
}

/* kernel_frequency and the spread do not know the unit of length. */
static double tangent_scale(double scale) {
    double factor[2];
    for (int i = 0; i < 2; ++i) {
        const float m = i == 0 ? 1.0f : (float)scale;
        const TangentPair pairs[TANGENT_COUNT] = {{vec3(1e-2f * m, 0, 0), vec3(3e-2f, 0, 0)},
                                                  {vec3(0, 2e-2f * m, 0), vec3(0, -1e-2f, 0)}};
        const TangentSpread spread = tangent_spread(pairs, vec3(0, 0, 1));
        factor[i] = (double)kernel_frequency(tangent_cross_section(&spread, 0.0f),
                                             tangent_cross_section(&spread, 0.9f * m));
    }
    return relative((long double)factor[1], (long double)factor[0]);
}

/* Refraction at this cosine from tangent keeps directions finite and unit to first order: dd . d'
 * = 0 within the size of dd. */
static double tangent_grazing(double cosine) {
    const float c = (float)cosine;
    const Vec3 n = vec3(0, 0, 1), d = vec3(sqrtf((1.0f - c) * (1.0f + c)), 0, -c);
    double worst = 0.0;
    for (int k = 0; k < 2; ++k) {
        const float eta = k == 0 ? 1.0f / 1.5f : 1.0f / 4.0f;
        const DielectricSplit split = dielectric_split(d, n, eta);
        const TangentPair pair = {vec3(0.1f, 0.2f, 0), vec3(0, 1e-3f, 0)};
        const Vec3 dn = vec3(0.1f, 0.2f, 0); /* of a unit sphere */
        const TangentPair out = tangent_refract(pair, d, n, dn, eta, split.cos_i, split.cos_t);
        const double size = (double)vec3_length(out.dd);
        worst = test_worse(worst, fabs((double)vec3_dot(out.dd, split.refracted)) / size);
    }
    return worst;
}

/* ---- Phase function -------------------------------------------------------------------------- */

static double phase_error(double g) {
    const long double gl = (long double)(float)g;
    double worst = 0.0;
    for (double x = 1e-12; x <= 2.0; x *= 1.5)
        for (int side = 0; side < 2; ++side) {
            const float c = side == 0 ? (float)(1.0 - x) : (float)(x - 1.0);
            const long double base = 1.0L + gl * gl - 2.0L * gl * (long double)c;
            const long double p = (1.0L - gl * gl) / (4.0L * PI_L * base * sqrtl(base));
            worst = test_worse(worst, relative((long double)phase_hg(c, (float)g), p));
        }
    return worst;
}

/* ---- The table ------------------------------------------------------------------------------- */

#define SNELL "Snell and Fresnel in long double from the same cosine, 1 to 1e-9; cosine relative, F"
#define GRAZE "1 - F in long double, ior 4, 1.5, 1.0001, 1 + 1e-7; absolute"
#define CRITICAL "F in long double, ior 1.01 to 4; absolute"
#define POINT "1 / (4 pi^2 s_u^2 s^2); relative"
#define SCALED "the same frequency factor; relative"

static const HardCase CASES[] = {
    {"Refraction", "ior 1.5", SNELL, 1e-6, split_error, 1.0 / 1.5},
    {"Refraction", "ior 1", SNELL, 2e-7, split_error, 1.0},
    {"Refraction", "ior 1 + 1e-7", SNELL, 1e-6, split_error, 1.0 / (1.0 + 0x1p-23)},
    {"Refraction", "ior 1.001", SNELL, 1e-6, split_error, 1.0 / 1.001},
    {"Refraction", "ior 0.6", SNELL, 1e-5, split_error, 1.0 / 0.6},
    {"Refraction", "ior 4", SNELL, 1e-6, split_error, 0.25},
    {"Refraction", "1e-3 from tangent", GRAZE, 1e-6, grazing_error, 1e-3},
    {"Refraction", "1e-6 from tangent", GRAZE, 1e-6, grazing_error, 1e-6},
    {"Refraction", "1e-9 from tangent", GRAZE, 1e-6, grazing_error, 1e-9},
    {"Refraction", "total reflection 1e-3 beyond", CRITICAL, 0.0, critical_error, 1e-3},
    {"Refraction", "1e-6 beyond the threshold", CRITICAL, 1e-2, critical_error, 1e-6},
    {"Refraction", "1e-6 before the threshold", CRITICAL, 1e-2, critical_error, -1e-6},
    {"Refraction", "1e-3 before the threshold", CRITICAL, 1e-4, critical_error, -1e-3},
    {"Refraction", "ior passes 1", "directions and F as at 1; absolute", 5e-3, step_through_one,
     1e-3},
    {"Refraction", "ior passes 1 by 1e-6", "directions and F as at 1; absolute", 5e-6,
     step_through_one, 1e-6},
    {"Covariance", "point, travel 1e-6 m", POINT, 1e-6, travel_from_point, 1e-6},
    {"Covariance", "point, travel 1 m", POINT, 1e-6, travel_from_point, 1.0},
    {"Covariance", "point, travel 1e6 m", POINT, 1e-6, travel_from_point, 1e6},
    {"Covariance", "ideal point, travel 1e-6 m", POINT, 1e-12, travel_from_dirac, 1e-6},
    {"Covariance", "ideal point, travel 1e6 m", POINT, 1e-12, travel_from_dirac, 1e6},
    {"Covariance", "sun, distance 1e6 m", "travel changes nothing; relative", 1e-6, travel_of_sun,
     1e6},
    {"Covariance", "sun, distance 1e-6 m", "travel changes nothing; relative", 1e-6, travel_of_sun,
     1e-6},
    {"Covariance", "beam of 1e-3 m", "Gaussian beam; relative", 1e-9, laser, 1e-3},
    {"Covariance", "laser of 1e-6 m", "Gaussian beam; relative", 1e-6, laser, 1e-6},
    {"Covariance", "laser of 1e-9 m", "Gaussian beam; relative", 1e-2, laser, 1e-9},
    {"Covariance", "1e4 random operators", "positive semidefinite after each; how often not", 0.0,
     random_operators, 1e4},
    {"Covariance", "world 1e-6 as large", SCALED, 1e-7, covariance_scale, 1e-6},
    {"Covariance", "world 1e6 as large", SCALED, 1e-7, covariance_scale, 1e6},
    {"Covariance", "curvature 0", "lens formula; relative", 1e-9, curvature, 0.0},
    {"Covariance", "curvature 1e3 1/m", "lens formula; relative", 1e-6, curvature, 1e3},
    {"Covariance", "curvature 1e6 1/m", "lens formula; relative", 1e-6, curvature, 1e6},
    {"Tangent pairs", "float twin, radius 1e-6 m", "matrix optics in long double; relative", 1e-5,
     chain_error, 1e-6},
    {"Tangent pairs", "float twin, radius 1 m", "matrix optics in long double; relative", 1e-5,
     chain_error, 1.0},
    {"Tangent pairs", "float twin, radius 1e6 m", "matrix optics in long double; relative", 1e-5,
     chain_error, 1e6},
    {"Tangent pairs", "exactly at a focus, 1 m", "cross-section 0, factor 1; absolute", 1e-3,
     focus_error, 1.0},
    {"Tangent pairs", "exactly at a focus, 1e-6 m", "cross-section 0, factor 1; absolute", 1e-3,
     focus_error, 1e-6},
    {"Tangent pairs", "exactly at a focus, 1e6 m", "cross-section 0, factor 1; absolute", 1e-3,
     focus_error, 1e6},
    {"Tangent pairs", "world 1e-6 as large", SCALED, 1e-6, tangent_scale, 1e-6},
    {"Tangent pairs", "world 1e6 as large", SCALED, 1e-6, tangent_scale, 1e6},
    {"Tangent pairs", "1e-3 from tangent", "dd is normal to d; relative", 1e-5, tangent_grazing,
     1e-3},
    {"Tangent pairs", "1e-9 from tangent", "dd is normal to d; relative", 1e-5, tangent_grazing,
     1e-9},
    {"Phase function", "g = 0", "Henyey-Greenstein in long double; relative", 1e-6, phase_error,
     0.0},
    {"Phase function", "g = 0.999", "Henyey-Greenstein in long double; relative", 1e-6, phase_error,
     0.999},
    {"Phase function", "g = -0.999", "Henyey-Greenstein in long double; relative", 1e-6,
     phase_error, -0.999},
    {"Phase function", "g = 0.99999", "Henyey-Greenstein in long double; relative", 1e-6,
     phase_error, 0.99999},
};

static void hard_cases(void) {
    for (size_t i = 0; i < sizeof CASES / sizeof CASES[0]; ++i) {
        const HardCase *c = &CASES[i];
        const double error = c->error(c->parameter);
        printf("hard\t%s\t%s\t%s\t%.3g\t%.3g\n", c->group, c->name, c->truth, c->bound, error);
        test_check(error <= c->bound, __FILE__, __LINE__, "%s, %s: %.3g, bound %.3g", c->group,
                   c->name, error, c->bound);
    }
}

void test_hard(void);

void test_hard(void) {
    RUN(hard_cases);
}
