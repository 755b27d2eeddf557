/* SPDX-License-Identifier: GPL-3.0-or-later
 * Boundaries, media, kernels, and the point sets that sample them. */
#include <stdlib.h>

#include "math/mat4.h"
#include "math/sampling.h"
#include "optics/dielectric.h"
#include "optics/kernel.h"
#include "optics/medium.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

/* ---- Fresnel and Snell ----------------------------------------------------------------------- */

static const Vec3 UP = {0, 0, 1};

/* Light that comes down at the cosine c. */
static DielectricSplit split_at(double c, double eta) {
    return dielectric_split(vec3((float)sqrt((1.0 - c) * (1.0 + c)), 0, (float)-c), UP, (float)eta);
}

/* Reflectance in double, by the textbook: tangents and sines are not used, for they are 0/0 at
 * normal incidence. */
static double reflectance(double c, double eta) {
    const double sin2_t = eta * eta * (1.0 - c * c);
    if (sin2_t >= 1.0)
        return 1.0;
    const double c_t = sqrt(1.0 - sin2_t);
    const double s = (eta * c - c_t) / (eta * c + c_t);
    const double p = (eta * c_t - c) / (eta * c_t + c);
    return 0.5 * (s * s + p * p);
}

static void dielectric_matches_fresnel_and_snell(void) {
    uint64_t state = 1;
    double worst_f = 0.0, worst_snell = 0.0, worst_length = 0.0, worst_mirror = 0.0;
    for (int i = 0; i < 100000; ++i) {
        const double c = test_uniform(&state, 1e-3, 1.0);
        const double eta = exp(test_uniform(&state, -1.0, 1.0));
        const double sin2_t = eta * eta * (1.0 - c * c);
        /* At the critical angle the reflectance has an infinite slope: see the test below. */
        if (fabs(sin2_t - 1.0) < 1e-3)
            continue;
        const DielectricSplit s = split_at(c, eta);
        worst_f = test_worse(worst_f, fabs((double)s.reflectance - reflectance(c, eta)));
        worst_mirror = test_worse(worst_mirror, fabs((double)s.reflected.z - c));
        if (sin2_t > 1.0) {
            ENSURE(s.reflectance == 1.0f && s.cos_t == 0.0f);
            continue;
        }
        worst_snell = test_worse(worst_snell, fabs((double)s.refracted.x - sqrt(sin2_t)));
        worst_snell = test_worse(worst_snell, fabs((double)s.refracted.z + sqrt(1.0 - sin2_t)));
        worst_length = test_worse(worst_length, fabs((double)vec3_length(s.refracted) - 1.0));
        ENSURE(s.refracted.y == 0.0f);
    }
    /* 1 - c^2 is off by 1e-7, sin2_t by e^2 times that; 1e-3 from critical, where cos_t is
     * sqrt(1e-3), that is 1e-5 of cos_t, and the reflectance changes up to twice as fast. */
    ENSURE_NEAR(worst_f, 0.0, 4e-5);
    ENSURE_NEAR(worst_snell, 0.0, 5e-6);
    ENSURE_NEAR(worst_length, 0.0, 2e-7);
    ENSURE_NEAR(worst_mirror, 0.0, 2e-7);
}

static void dielectric_limits(void) {
    static const double indices[] = {1.1, 1.333, 1.5, 2.4};
    for (size_t i = 0; i < sizeof indices / sizeof indices[0]; ++i) {
        const double n = indices[i];
        const double normal = (n - 1.0) * (n - 1.0) / ((n + 1.0) * (n + 1.0));
        ENSURE_NEAR(split_at(1.0, 1.0 / n).reflectance, normal, 1e-7);
        ENSURE_NEAR(split_at(1.0, n).reflectance, normal, 1e-7);
        ENSURE(split_at(1.0, 1.0 / n).refracted.z == -1.0f);
        /* Brewster: no parallel part, so half of the perpendicular one,
         * ((n^2-1)/(n^2+1))^2 / 2, at tan = n. */
        const double perpendicular = (n * n - 1.0) / (n * n + 1.0);
        ENSURE_NEAR(split_at(1.0 / sqrt(1.0 + n * n), 1.0 / n).reflectance,
                    0.5 * perpendicular * perpendicular, 1e-6);
        ENSURE_NEAR(split_at(1e-6, 1.0 / n).reflectance, 1.0, 1e-4);

        /* The critical angle from both sides: sin = 1/n inside. */
        const double critical = sqrt(1.0 - 1.0 / (n * n));
        const DielectricSplit total = split_at(critical - 1e-5, n);
        const DielectricSplit partial = split_at(critical + 1e-5, n);
        ENSURE(total.reflectance == 1.0f && total.cos_t == 0.0f);
        ENSURE(partial.reflectance < 1.0f && partial.cos_t > 0.0f);
        ENSURE_NEAR(partial.reflectance, reflectance(critical + 1e-5, n), 2e-3);
        ENSURE(partial.refracted.z < 0.0f);
    }
}

/* From an index of 10 into one of 0.1, the most that is taken: eta^2 is 1e4, and rounded. */
static void dielectric_keeps_normal_incidence(void) {
    uint64_t state = 4;
    double worst = 0.0;
    for (int i = 0; i < 10000; ++i) {
        const double eta = exp(test_uniform(&state, log(0.01), log(100.0)));
        const float normal = split_at(1.0, eta).cos_t;
        ENSURE_NEAR(normal, 1.0, 0);
        const double c = 1.0 - exp(test_uniform(&state, log(1e-7), log(1e-4)));
        const DielectricSplit s = split_at(c, eta);
        const double cos_i = (double)s.cos_i, sin2_t = eta * eta * (1.0 - cos_i) * (1.0 + cos_i);
        ENSURE(s.cos_t <= 1.0f);
        if (sin2_t < 0.5)
            worst = test_worse(worst, fabs((double)s.cos_t - sqrt(1.0 - sin2_t)));
    }
    ENSURE_NEAR(worst, 0.0, 2e-7);
}

static void dielectric_is_exact_without_boundary(void) {
    uint64_t state = 2;
    for (int i = 0; i < 1000; ++i) {
        const Vec3 d = vec3_normalize(
            vec3((float)test_uniform(&state, -1, 1), (float)test_uniform(&state, -1, 1), -0.1f));
        const DielectricSplit s = dielectric_split(d, UP, 1.0f);
        ENSURE(s.reflectance == 0.0f);
        ENSURE(s.refracted.x == d.x && s.refracted.y == d.y && s.refracted.z == d.z);
        ENSURE(s.cos_t == s.cos_i);
    }
}

/* Light that goes back the way it came meets the same transmittance. */
static void dielectric_is_reciprocal(void) {
    uint64_t state = 3;
    double worst = 0.0, worst_direction = 0.0;
    for (int i = 0; i < 10000; ++i) {
        const double eta = test_uniform(&state, 0.4, 0.95), c = test_uniform(&state, 0.02, 1.0);
        const DielectricSplit there = split_at(c, eta);
        const DielectricSplit back =
            dielectric_split(vec3_negate(there.refracted), vec3_negate(UP), (float)(1.0 / eta));
        /* The way back meets the angle near its critical one, where rounding grows as 1/c. */
        worst = test_worse(worst, c * fabs((double)back.reflectance - (double)there.reflectance));
        worst_direction = test_worse(worst_direction, c * fabs((double)back.refracted.z - c));
    }
    ENSURE_NEAR(worst, 0.0, 5e-6);
    ENSURE_NEAR(worst_direction, 0.0, 1e-6);
}

/* Average over the hemisphere, int F 2 c dc, by Simpson in x with c = x^2: the integrand is smooth
 * in the root of the cosine beside grazing, and the critical angle is cut out by the caller. */
static double mean_reflectance(double eta, double c_from, double c_to) {
    enum { STEPS = 4000 };
    double sum = 0.0;
    for (int i = 0; i <= STEPS; ++i) {
        /* A cubic map that is flat at the lower end, where the slope is infinite. */
        const double u = (double)i / STEPS;
        const double c = c_from + (c_to - c_from) * u * u;
        const double weight = i == 0 || i == STEPS ? 1.0 : i % 2 ? 4.0 : 2.0;
        sum += weight * (double)split_at(c, eta).reflectance * 2.0 * c * 2.0 * u * (c_to - c_from);
    }
    return sum / (3.0 * STEPS);
}

static void dielectric_mean_reflectance(void) {
    const double n = 1.5, critical = sqrt(1.0 - 1.0 / (n * n));
    const double outside = mean_reflectance(1.0 / n, 0.0, 1.0);
    /* Everything below the critical cosine is reflected: int 2 c dc = critical^2. */
    const double inside = critical * critical + mean_reflectance(n, critical, 1.0);
    ENSURE_NEAR(outside, 0.091778, 2e-6);
    ENSURE_NEAR(inside, 0.596346, 2e-6);
    ENSURE_NEAR(1.0 - inside, (1.0 - outside) / (n * n), 1e-6);
}

/* ---- Media ----------------------------------------------------------------------------------- */

/* int p dcos dphi and the mean cosine, by Simpson in x with cos = 1 - 2 x^4 (or its mirror), which
 * resolves the peak. */
static void integrate_hg(float g, double *out_integral, double *out_mean) {
    enum { STEPS = 20000 };
    const double sign = g < 0.0f ? -1.0 : 1.0;
    double integral = 0.0, mean = 0.0;
    for (int i = 0; i <= STEPS; ++i) {
        const double x = (double)i / STEPS;
        const double cosine = sign * (1.0 - 2.0 * x * x * x * x);
        const double weight = i == 0 || i == STEPS ? 1.0 : i % 2 ? 4.0 : 2.0;
        const double value =
            weight * (double)phase_hg((float)cosine, g) * 2.0 * PI * 8.0 * x * x * x;
        integral += value;
        mean += value * cosine;
    }
    *out_integral = integral / (3.0 * STEPS);
    *out_mean = mean / (3.0 * STEPS);
}

static void phase_is_normalised_with_mean_cosine_g(void) {
    static const float gs[] = {-0.99f, -0.5f, -0.1f, 0.0f, 0.3f, 0.85f, 0.99f};
    for (size_t i = 0; i < sizeof gs / sizeof gs[0]; ++i) {
        double integral, mean;
        integrate_hg(gs[i], &integral, &mean);
        /* At |g| = 0.99 the peak is as wide as 1 - cos = 1e-4, and cos itself a float. */
        const double tolerance = fabsf(gs[i]) > 0.9f ? 1e-4 : 1e-6;
        ENSURE_NEAR(integral, 1.0, tolerance);
        ENSURE_NEAR(mean, gs[i], tolerance);
    }
    ENSURE_NEAR(phase_hg(0.3f, 0.0f), 1.0 / (4.0 * PI), 1e-8);
    /* Positive g goes on along the direction of travel. */
    ENSURE(phase_hg(1.0f, 0.5f) > 20.0f * phase_hg(-1.0f, 0.5f));
    ENSURE_NEAR(phase_hg(1.0f, 0.5f), 0.75 / (4.0 * PI * 0.125), 1e-6);
    ENSURE(phase_hg(0.4f, 0.6f) == phase_hg(-0.4f, -0.6f));
    /* The sharpest lobes that are allowed, at cosines that rounding has pushed past 1:
     * p(1) = (1 + g) / (4 pi (1 - g)^2). */
    for (float cosine = 0.9999999f; cosine < 1.0000003f; cosine += 1e-7f)
        ENSURE(phase_hg(cosine, 0.9999f) > 1e5f && phase_hg(-cosine, -0.9999f) < 1.7e7f);
    ENSURE_NEAR(phase_hg(1.0f, 0.9999f) * 1e-8f, 1.9999 / (4.0 * PI), 1e-4);
}

static void medium_transmittance_multiplies(void) {
    const Medium medium = {.sigma_t = {0.3f, 1.0f, 7.0f}};
    for (float a = 0.0f; a < 3.0f; a += 0.37f)
        for (float b = 0.0f; b < 3.0f; b += 0.41f) {
            const Rgb once = medium_transmittance(&medium, a + b);
            const Rgb twice =
                rgb_mul(medium_transmittance(&medium, a), medium_transmittance(&medium, b));
            /* Rounding of the exponent: up to 42 ulp of exp. */
            ENSURE_NEAR(once.r / twice.r, 1.0, 1e-6);
            ENSURE_NEAR(once.g / twice.g, 1.0, 2e-6);
            ENSURE_NEAR(once.b / twice.b, 1.0, 1e-5);
        }
    ENSURE(medium_transmittance(&medium, 0.0f).b == 1.0f);
    ENSURE_NEAR(medium_transmittance(&medium, 1.0f).g, exp(-1.0), 1e-7);
    ENSURE(medium_transmittance(&medium, 1e30f).r == 0.0f);
    const Medium clear = {.lobe_count = 0};
    ENSURE(medium_transmittance(&clear, 1e30f).r == 1.0f);

    Medium lobes = {.lobe_count = 2};
    ENSURE(!medium_scatters(&clear) && !medium_scatters(&lobes));
    lobes.lobes[1].sigma_s.b = 1e-6f;
    ENSURE(medium_scatters(&lobes));
    lobes.lobe_count = 1;
    ENSURE(!medium_scatters(&lobes));
}

/* ---- Kernel ---------------------------------------------------------------------------------- */

static void kernel_follows_equation_8(void) {
    static const float sizes[] = {6.0f, 16.0f};
    for (size_t i = 0; i < 2; ++i) {
        const double size = (double)sizes[i];
        ENSURE_NEAR(kernel_multiplier(sizes[i], 0.0f), size, 1e-6);
        ENSURE_NEAR(kernel_multiplier(sizes[i], 0.5f), 0.6 * size, 2e-6);
        ENSURE_NEAR(kernel_multiplier(sizes[i], 1.0f), 0.2 * size, 2e-6);
    }
    float last = INFINITY;
    for (float f = 0.0f; f <= 1.0f; f += 0.01f) {
        const float k = kernel_multiplier(16.0f, f);
        ENSURE(k < last);
        last = k;
    }
    ENSURE(kernel_frequency(0.3f, 0.3f) == 0.5f);
    ENSURE(kernel_frequency(0.3f, 0.0f) == 1.0f);
    ENSURE(kernel_frequency(0.3f, INFINITY) == 0.0f);
    ENSURE_NEAR(kernel_frequency(1.0f, 3.0f), 0.25, 1e-7);
    const double radius = (double)kernel_radius(2.0f);
    ENSURE_NEAR(PI * radius * radius, 2.0, 1e-6);
}

/* ---- Sampling -------------------------------------------------------------------------------- */

/* Largest difference of the share of points in an anchored box [0,x) x [0,y) and its area, over a
 * grid of boxes: the star discrepancy, nearly. */
static double discrepancy(const Sample2 *points, int count) {
    enum { GRID = 32 };
    static uint32_t cells[GRID][GRID];
    for (int x = 0; x < GRID; ++x)
        for (int y = 0; y < GRID; ++y)
            cells[x][y] = 0;
    for (int i = 0; i < count; ++i)
        ++cells[(int)(points[i].u * GRID)][(int)(points[i].v * GRID)];
    double worst = 0.0;
    uint32_t columns[GRID] = {0};
    for (int x = 0; x < GRID; ++x) {
        uint32_t inside = 0;
        for (int y = 0; y < GRID; ++y) {
            columns[y] += cells[x][y];
            inside += columns[y];
            const double area = (x + 1.0) * (y + 1.0) / (GRID * GRID);
            worst = test_worse(worst, fabs((double)inside / count - area));
        }
    }
    return worst;
}

enum { POINTS = 4096 };

static void point_sets_have_low_discrepancy(void) {
    static Sample2 r2[POINTS], fibonacci[POINTS], random[POINTS];
    uint64_t state = 4;
    /* With and without a shift; points that are random score about 1.2 / sqrt(N) = 0.019. */
    for (int shifted = 0; shifted < 2; ++shifted) {
        const float shift = shifted ? 0.7654321f : 0.0f;
        bool is_inside = true;
        for (int i = 0; i < POINTS; ++i) {
            r2[i] = sample_r2((uint64_t)i, shift, 0.5f * shift);
            fibonacci[i] = sample_fibonacci((uint64_t)i, POINTS, shift);
            random[i] = (Sample2){(float)test_uniform(&state, 0, 0.999999),
                                  (float)test_uniform(&state, 0, 0.999999)};
            is_inside = is_inside && r2[i].u >= 0.0f && r2[i].u < 1.0f && r2[i].v >= 0.0f &&
                        r2[i].v < 1.0f && fibonacci[i].u >= 0.0f && fibonacci[i].u < 1.0f &&
                        fibonacci[i].v >= 0.0f && fibonacci[i].v < 1.0f;
        }
        ENSURE(is_inside);
        ENSURE(discrepancy(random, POINTS) > 0.004);
        ENSURE(discrepancy(r2, POINTS) < 0.002);
        ENSURE(discrepancy(fibonacci, POINTS) < 0.002);
        /* R2 is good at any length, also beyond 2^32. */
        for (int count = 100; count < POINTS; count *= 3)
            ENSURE(discrepancy(r2, count) < 4.0 / count + 0.01);
        for (int i = 0; i < POINTS; ++i)
            r2[i] = sample_r2(((uint64_t)1 << 40) + (uint64_t)i, shift, shift);
        ENSURE(discrepancy(r2, POINTS) < 0.002);
    }
}

/* Points of low rank are as many as they should be, and cover the square evenly themselves. */
static void ranks_choose_even_parts(void) {
    enum { N = 65536 };
    static Sample2 chosen[N];
    for (int k = 0; k < 4; ++k) {
        const float part = 0.01f * (float)(1 << (2 * k)), shift = 0.21f * (float)k;
        int count = 0;
        for (uint64_t i = 0; i < N; ++i) {
            const float rank = sample_fibonacci_rank(i, shift);
            ENSURE(rank >= 0.0f && rank < 1.0f);
            if (rank < part)
                chosen[count++] = sample_fibonacci(i, N, shift);
        }
        ENSURE_NEAR(count, part * N, 4.0);
        /* By chance it would be 1.2 / sqrt(count). */
        ENSURE(discrepancy(chosen, count) < 0.5 / sqrt(count));
    }
    ENSURE(sample_fibonacci_rank(UINT64_MAX, 0.999999940395f) < 1.0f);
}

/* The last of very many points lies nearer to 1 than floats do. */
static void lattice_stays_inside_the_square(void) {
    for (uint64_t n = 1; n <= 1ull << 31; n *= 2) {
        const Sample2 last = sample_fibonacci(n - 1, n, 0.999999940395f);
        ENSURE(last.u >= 0.0f && last.u < 1.0f && last.v >= 0.0f && last.v < 1.0f);
    }
}

/* Means over the lattice: the area of what is mapped shows in its moments. */
static void maps_keep_area(void) {
    enum { N = 20000 };
    static const float caps[] = {2.0f, 1.0f, 0.3f, 1e-6f};
    double disc2 = 0.0, disc_x = 0.0, cosine = 0.0, cosine2 = 0.0, below = 0.0;
    for (uint64_t i = 0; i < N; ++i) {
        const Sample2 s = sample_fibonacci(i, N, 0.3f);
        const Sample2 d = sample_disc(s);
        disc2 += (double)(d.u * d.u + d.v * d.v) / N;
        disc_x += (double)d.u / N;
        const Vec3 h = sample_cosine_hemisphere(s);
        cosine += (double)h.z / N;
        cosine2 += (double)(h.z * h.z) / N;
        below += h.z < 0.0f;
        ENSURE_NEAR(vec3_length(h), 1.0, 1e-6);
    }
    /* Disc: E r^2 = 1/2. Cosine hemisphere, pdf c/pi: E c = 2/3, E c^2 = 1/2. */
    ENSURE_NEAR(disc2, 0.5, 1e-6);
    ENSURE_NEAR(disc_x, 0.0, 1e-4);
    ENSURE_NEAR(cosine, 2.0 / 3.0, 1e-5);
    ENSURE_NEAR(cosine2, 0.5, 1e-5);
    ENSURE(below == 0.0);
    for (size_t k = 0; k < sizeof caps / sizeof caps[0]; ++k) {
        /* 1 - cos is uniform in [0, h]: means h/2, and E sin^2 = h - h^2/3. */
        const double h = (double)caps[k];
        double sin2 = 0.0, x = 0.0, inside = 0.0;
        for (uint64_t i = 0; i < N; ++i) {
            const Vec3 d = sample_cap(sample_fibonacci(i, N, 0.3f), caps[k]);
            sin2 += (double)(d.x * d.x + d.y * d.y) / N;
            x += (double)d.x / N;
            inside += (double)(d.x * d.x + d.y * d.y < 0.25f * caps[k] * (2.0f - 0.25f * caps[k]) &&
                               d.z > 0.0f) /
                      N;
        }
        ENSURE_NEAR(sin2 / (h - h * h / 3.0), 1.0, 1e-5);
        ENSURE_NEAR(x / sqrt(h), 0.0, 1e-4);
        /* The inner cap of a quarter of 1 - cos has a quarter of the points. */
        ENSURE_NEAR(inside, 0.25, 2e-4);
    }
}

/* ---- Frames and matrices --------------------------------------------------------------------- */

static void frames_are_right_handed(void) {
    uint64_t state = 5;
    double worst = 0.0;
    for (int i = 0; i < 10000; ++i) {
        Vec3 n = vec3_normalize(vec3((float)test_uniform(&state, -1, 1),
                                     (float)test_uniform(&state, -1, 1),
                                     (float)test_uniform(&state, -1, 1)));
        if (i < 4)
            n = vec3(0, 0, i % 2 ? -1.0f : 1.0f);
        if (i == 3)
            n = vec3(1e-7f, 0, -1.0f);
        Vec3 x, y;
        vec3_frame(n, &x, &y);
        worst = test_worse(worst, fabs((double)vec3_dot(x, y)));
        worst = test_worse(worst, fabs((double)vec3_length(x) - 1.0));
        worst = test_worse(worst, fabs((double)vec3_dot(vec3_cross(x, y), n) - 1.0));
    }
    ENSURE_NEAR(worst, 0.0, 1e-6);
}

/* A plane's normal stays perpendicular to its tangents, and outside when the map mirrors. */
static void normals_transform_by_cofactors(void) {
    uint64_t state = 6;
    double worst = 0.0;
    for (int i = 0; i < 1000; ++i) {
        float m[16] = {0};
        for (int k = 0; k < 12; ++k)
            m[k] = (float)test_uniform(&state, -2, 2);
        m[15] = 1.0f;
        if (fabs(mat4_determinant(m)) < 0.1)
            continue;
        const Vec3 a = vec3(1, 0.5f, 0), b = vec3(0, 1, -0.3f), n = vec3_cross(a, b);
        const Vec3 zero = vec3d_round(mat4_point(m, vec3(0, 0, 0)));
        const Vec3 ma = vec3_sub(vec3d_round(mat4_point(m, a)), zero);
        const Vec3 mb = vec3_sub(vec3d_round(mat4_point(m, b)), zero);
        const Vec3 mn = mat4_normal(m, n);
        worst = test_worse(worst, fabs((double)vec3_dot(mn, vec3_normalize(ma))));
        worst = test_worse(worst, fabs((double)vec3_dot(mn, vec3_normalize(mb))));
        /* A point on the normal's side goes to the normal's side. */
        ENSURE(vec3_dot(vec3_sub(vec3d_round(mat4_point(m, n)), zero), mn) > 0.0f);
    }
    ENSURE_NEAR(worst, 0.0, 2e-5);
}

void test_optics(void);

void test_optics(void) {
    RUN(dielectric_matches_fresnel_and_snell);
    RUN(dielectric_limits);
    RUN(dielectric_keeps_normal_incidence);
    RUN(dielectric_is_exact_without_boundary);
    RUN(dielectric_is_reciprocal);
    RUN(dielectric_mean_reflectance);
    RUN(phase_is_normalised_with_mean_cosine_g);
    RUN(medium_transmittance_multiplies);
    RUN(kernel_follows_equation_8);
    RUN(point_sets_have_low_discrepancy);
    RUN(ranks_choose_even_parts);
    RUN(lattice_stays_inside_the_square);
    RUN(maps_keep_area);
    RUN(frames_are_right_handed);
    RUN(normals_transform_by_cofactors);
}
