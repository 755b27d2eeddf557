/* SPDX-License-Identifier: GPL-3.0-or-later
 * Volume samples: their placement along beams, their tree, and the sum over them, against a slow
 * twin in double that knows no tree, no lanes and no Gauss points. */
#include <stdlib.h>
#include <string.h>

#include "field/points/point_gather.h"
#include "field/points/points.h"
#include "optics/kernel.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

/* ---- The twin -------------------------------------------------------------------------------- */

typedef struct Vector {
    double x, y, z;
} Vector;

static Vector from_float(Vec3 a) {
    return (Vector){(double)a.x, (double)a.y, (double)a.z};
}

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector madd(Vector a, double s, Vector b) {
    return (Vector){a.x + s * b.x, a.y + s * b.y, a.z + s * b.z};
}

typedef struct Segment {
    Vec3 o, d;
    float length;
} Segment;

/* What scatters straight on, 1/m. */
static const Rgb STRAIGHT = {0.3f, 0.1f, 0.02f};

static FieldRadiance along(PointGather gather, const PointTree *tree, const Medium *medium, Vec3 o,
                           Vec3 d, float length, PointCount *met) {
    const FieldSegment segment = {.o = o, .d = d, .length = length, .straight = STRAIGHT};
    return gather(tree, medium, &segment, met);
}

static FieldRadiance cloud_along(const PointCloud *cloud, Vec3 o, Vec3 d, float length) {
    const FieldSegment segment = {.o = o, .d = d, .length = length};
    return points_gather(cloud, &segment, NULL);
}

static double channel_of(Rgb c, int channel) {
    return (double)(channel == 0 ? c.r : channel == 1 ? c.g : c.b);
}

/* A sample and a segment in double. With slack the sample is that much larger all round. */
typedef struct Meeting {
    Vector w, d, delta; /* delta: the segment's origin from the sample's */
    double low, high, radius, slack;
    double length;
} Meeting;

/* Interval of t inside the cylinder. */
static bool chord(const Meeting *m, double *out_from, double *out_to) {
    const double c = dot(m->d, m->w), along = dot(m->delta, m->w);
    const Vector across = madd(m->delta, -along, m->w), turn = madd(m->d, -c, m->w);
    const double a = dot(turn, turn), b = dot(across, turn), r = m->radius + m->slack;
    const double outside = dot(across, across) - r * r;
    double from = 0.0, to = m->length;
    if (a > 0.0) {
        const double root2 = b * b - a * outside;
        if (root2 <= 0.0 || r <= 0.0)
            return false;
        from = fmax(from, (-b - sqrt(root2)) / a);
        to = fmin(to, (-b + sqrt(root2)) / a);
    } else if (outside >= 0.0) {
        return false;
    }
    const double low = m->low - m->slack - along, high = m->high + m->slack - along;
    if (c != 0.0) {
        from = fmax(from, fmin(low / c, high / c));
        to = fmin(to, fmax(low / c, high / c));
    } else if (low > 0.0 || high <= 0.0) {
        return false;
    }
    *out_from = from;
    *out_to = to;
    return to > from;
}

/* int K exp(-sigma_t (t + s)) dt over the chord, for each channel. */
static void integrate(const Meeting *m, const Medium *medium, double out[3]) {
    enum { STEPS = 2000 };
    double from, to;
    out[0] = out[1] = out[2] = 0.0;
    if (!chord(m, &from, &to))
        return;
    const double radius2 = m->radius * m->radius;
    for (int i = 0; i < STEPS; ++i) {
        const double t = from + (i + 0.5) / STEPS * (to - from);
        const Vector x = madd(m->delta, t, m->d);
        const double s = dot(x, m->w);
        const Vector across = madd(x, -s, m->w);
        const double r = fmax(sqrt(dot(across, across)) - m->slack, 0.0);
        const double kernel = fmax(2.0 / (PI * radius2) * (1.0 - r * r / radius2), 0.0);
        for (int k = 0; k < 3; ++k)
            out[k] += kernel * exp(-channel_of(medium->sigma_t, k) * (t + fmax(s, 0.0)));
    }
    for (int k = 0; k < 3; ++k)
        out[k] *= (to - from) / STEPS;
}

static double phase(double cosine, double g) {
    return (1.0 - g * g) / (4.0 * PI * pow(1.0 + g * g - 2.0 * g * cosine, 1.5));
}

/* What samples send along a segment, and how far the library may be off. */
typedef struct Sum {
    double radiance[3], reflected[3], passed[3];
    double bound[3];
    double frequency; /* weighted by contributions */
    int hits, reflected_hits, passed_hits;
} Sum;

static void add_twin(Sum *sum, const PointSample *sample, const Medium *medium,
                     const Segment *segment) {
    Meeting m = {.w = from_float(sample->direction),
                 .d = from_float(segment->d),
                 .delta = madd(from_float(segment->o), -1.0, from_float(sample->origin)),
                 .low = (double)sample->low,
                 .high = (double)sample->high,
                 .radius = (double)sample->radius,
                 .length = (double)segment->length};
    /* The library knows places to a few units in the last place of how far apart things are: the
     * truth lies between a sample that is larger by that, and one that is smaller. */
    const double reach = sqrt(dot(m.delta, m.delta)) + fabs(m.low) + fabs(m.high);
    const double place = 2e-7 * reach;
    double exact[3], larger[3] = {0}, smaller[3];
    m.slack = place;
    double from, to;
    if (!chord(&m, &from, &to))
        return;
    integrate(&m, medium, larger);
    m.slack = -place;
    integrate(&m, medium, smaller);
    m.slack = 0.0;
    integrate(&m, medium, exact);
    sum->hits += exact[0] > 0.0;
    sum->passed_hits += exact[0] > 0.0 && sample->has_passed;
    sum->reflected_hits += exact[0] > 0.0 && sample->is_reflected && !sample->has_passed;

    const double c = dot(m.d, m.w);
    for (int k = 0; k < 3; ++k) {
        double scattering = 0.0, peak = 0.0;
        for (uint32_t l = 0; l < medium->lobe_count; ++l) {
            const double g = (double)medium->lobes[l].g;
            scattering += channel_of(medium->lobes[l].sigma_s, k) * phase(-c, g);
            peak = fmax(peak, fabs(3.0 * g) / (1.0 + g * g + 2.0 * g * c));
        }
        const double scale = channel_of(sample->flux, k) * scattering;
        /* Rounding: distances enter the exponential; directions are unit to 1e-7, which moves a
         * sharp phase function by p'/p. */
        const double rounding = 2e-5 + channel_of(medium->sigma_t, k) * 4.0 * place + 2e-7 * peak;
        sum->radiance[k] += scale * exact[k];
        sum->reflected[k] += sample->is_reflected ? scale * exact[k] : 0.0;
        sum->passed[k] += sample->has_passed ? scale * exact[k] : 0.0;
        sum->frequency += scale * exact[k] / 3.0 * (double)sample->frequency;
        sum->bound[k] += scale * (larger[k] - smaller[k] + larger[k] * rounding);
    }
}

static Sum twin(const PointSample *samples, int count, const Medium *medium,
                const Segment *segment) {
    Sum sum = {.hits = 0};
    for (int i = 0; i < count; ++i)
        add_twin(&sum, &samples[i], medium, segment);
    return sum;
}

/* ---- Random samples and segments ------------------------------------------------------------- */

static Vec3 random_point(uint64_t *state, double size) {
    const float x = (float)test_uniform(state, -size, size);
    const float y = (float)test_uniform(state, -size, size);
    return vec3(x, y, (float)test_uniform(state, -size, size));
}

static Vec3 random_direction(uint64_t *state) {
    for (;;) {
        const Vec3 p = random_point(state, 1.0);
        const float length = vec3_length(p);
        if (length > 0.1f && length < 1.0f)
            return vec3_normalize(p);
    }
}

static PointSample random_sample(uint64_t *state) {
    PointSample sample = {.origin = random_point(state, 1.0), .direction = random_direction(state)};
    /* Some of them along an axis, as a sun overhead makes them. */
    if (test_uniform(state, 0, 1) < 0.1)
        sample.direction = vec3(0, 0, -1);
    sample.high = (float)exp(test_uniform(state, -4.0, 0.0));
    sample.radius = (float)exp(test_uniform(state, -4.0, -0.5));
    if (test_uniform(state, 0, 1) < 0.3)
        sample.low = -sample.radius * (float)test_uniform(state, 0, 4);
    sample.flux = rgb((float)test_uniform(state, 0, 1), (float)test_uniform(state, 0, 1),
                      (float)test_uniform(state, 0, 1));
    sample.frequency = (float)test_uniform(state, 0, 1);
    sample.is_reflected = test_uniform(state, 0, 1) < 0.4;
    sample.has_passed = test_uniform(state, 0, 1) < 0.3;
    return sample;
}

static Medium random_medium(uint64_t *state) {
    Medium medium = {.lobe_count = 1 + (uint32_t)test_uniform(state, 0, 3.999)};
    const float size = (float)exp(test_uniform(state, -4.0, 1.0));
    medium.sigma_t = rgb(size, 0.1f * size, 0.0f);
    for (uint32_t l = 0; l < medium.lobe_count; ++l) {
        medium.lobes[l].sigma_s =
            rgb(size / 8, (float)test_uniform(state, 0, 0.02) * size, (float)l);
        medium.lobes[l].g = l == 0 ? 0.0f : (float)test_uniform(state, -0.9, 0.9);
        medium.sigma_t.b += (float)l;
    }
    return medium;
}

typedef enum Regime {
    ANYWHERE,
    STARTS_INSIDE,
    NEARLY_PARALLEL,
    PARALLEL,
    PERPENDICULAR,
    FAR_AWAY,
    SHORT,
    REGIME_COUNT
} Regime;

/* A segment that meets the given sample in a certain way, mostly. */
static Segment random_segment(uint64_t *state, const PointSample *near, Regime regime) {
    Vec3 x, y;
    vec3_frame(near->direction, &x, &y);
    const float r = near->radius;
    Vec3 inside = vec3_madd(near->origin, near->high * (float)test_uniform(state, 0.01, 0.99),
                            near->direction);
    inside = vec3_madd(inside, r * (float)test_uniform(state, -0.6, 0.6), x);
    inside = vec3_madd(inside, r * (float)test_uniform(state, -0.6, 0.6), y);
    Segment segment = {.o = inside, .d = random_direction(state), .length = 3.0f};
    float back = (float)test_uniform(state, 0.5, 2.0);
    switch (regime) {
    case STARTS_INSIDE:
        back = 0.0f;
        break;
    case NEARLY_PARALLEL: {
        const float tilt = (float)exp(test_uniform(state, -16.0, -1.0));
        const float side = test_uniform(state, 0, 1) < 0.5 ? -1.0f : 1.0f;
        segment.d = vec3_scale(vec3_normalize(vec3_madd(near->direction, tilt, x)), side);
        break;
    }
    case PARALLEL:
        segment.d =
            test_uniform(state, 0, 1) < 0.5 ? near->direction : vec3_negate(near->direction);
        break;
    case PERPENDICULAR:
        segment.d = x;
        break;
    case FAR_AWAY:
        back = 1000.0f;
        segment.length = 2000.0f;
        break;
    case SHORT:
        back = r * (float)test_uniform(state, 0, 1);
        segment.length = r * (float)test_uniform(state, 0, 1);
        break;
    default:
        break;
    }
    segment.o = vec3_madd(inside, -back, segment.d);
    return segment;
}

/* ---- The sum --------------------------------------------------------------------------------- */

enum { SAMPLE_MAX = 3000 };
static const int SAMPLE_COUNTS[] = {1, 2, 7, 8, 9, 64, 65, 100, 520, SAMPLE_MAX};
enum { COUNT_CASES = sizeof SAMPLE_COUNTS / sizeof SAMPLE_COUNTS[0] };

static void fill_samples(uint64_t *state, PointSample *samples, int count) {
    for (int i = 0; i < count; ++i)
        samples[i] = random_sample(state);
}

static PointTree build(const PointSample *samples, int count, uint32_t threads) {
    Job job;
    job_init(&job, threads);
    PointTree tree;
    ENSURE_STATUS(point_tree_build(samples, (uint64_t)count, &job, &tree), AMB_OK);
    return tree;
}

static double rgb_channel_error(const FieldRadiance *out, const Sum *sum, int k) {
    return fabs(channel_of(out->radiance, k) - sum->radiance[k]);
}

static void gather_matches_brute_force(void) {
    static PointSample samples[SAMPLE_MAX];
    uint64_t state = 1;
    int hits[REGIME_COUNT] = {0}, all_hits = 0;
    long long missed = 0;
    double worst = 0.0;
    for (int n = 0; n < COUNT_CASES; ++n) {
        const int count = SAMPLE_COUNTS[n];
        fill_samples(&state, samples, count);
        const Medium medium = random_medium(&state);
        PointTree tree = build(samples, count, 2);
        const int trials = count > 500 ? 4 : 40;
        for (Regime regime = 0; regime < REGIME_COUNT; ++regime)
            for (int trial = 0; trial < trials; ++trial) {
                const int near = (int)test_uniform(&state, 0, count);
                const Segment segment = random_segment(&state, &samples[near], regime);
                PointCount met = {.all = 0};
                const FieldRadiance out = along(point_gather_portable, &tree, &medium, segment.o,
                                                segment.d, segment.length, &met);
                const Sum sum = twin(samples, count, &medium, &segment);
                hits[regime] += sum.hits;
                /* Where nothing arrives, a hit is none for the sum. */
                if (sum.hits > 0)
                    missed += llabs((long long)met.all - sum.hits) +
                              llabs((long long)met.passed - sum.passed_hits) +
                              llabs((long long)met.reflected - sum.reflected_hits);
                for (int k = 0; k < 3; ++k) {
                    const double error = rgb_channel_error(&out, &sum, k);
                    worst = test_worse(worst, error / (sum.bound[k] + 1e-30));
                    if (!(error <= sum.bound[k] + 1e-12))
                        test_check(false, __FILE__, __LINE__,
                                   "%d samples, regime %d, channel %d: %.6g, expected %.6g +- %.2g",
                                   count, (int)regime, k, channel_of(out.radiance, k),
                                   sum.radiance[k], sum.bound[k]);
                }
                const double slack = (sum.bound[0] + sum.bound[1] + sum.bound[2]) / 3.0 + 1e-12;
                for (int k = 0; k < 3; ++k) {
                    ENSURE_NEAR(channel_of(out.reflected, k), sum.reflected[k], 3.0 * slack);
                    ENSURE_NEAR(channel_of(out.passed, k), sum.passed[k], 3.0 * slack);
                }
                ENSURE_NEAR(out.frequency, sum.frequency, slack);
                ENSURE_NEAR(out.contribution, rgb_mean(out.radiance), 0.0);
            }
        point_tree_clear(&tree);
    }
    /* Bounds that are never nearly used would be no test. */
    ENSURE(worst > 0.1);
    for (Regime regime = 0; regime < REGIME_COUNT; ++regime) {
        ENSURE(hits[regime] > 200);
        all_hits += hits[regime];
    }
    ENSURE(missed < all_hits / 1000);
}

static bool is_same(const FieldRadiance *a, const FieldRadiance *b) {
    return memcmp(a, b, sizeof *a) == 0;
}

/* The instruction set changes the speed alone. */
static void gather_variants_agree_bit_for_bit(void) {
#if defined(__x86_64__)
    if (!__builtin_cpu_supports("avx2"))
        return;
    static PointSample samples[SAMPLE_MAX];
    uint64_t state = 2;
    int bright = 0, different = 0;
    for (int n = 0; n < COUNT_CASES; ++n) {
        const int count = SAMPLE_COUNTS[n];
        fill_samples(&state, samples, count);
        const Medium medium = random_medium(&state);
        PointTree tree = build(samples, count, 1);
        for (Regime regime = 0; regime < REGIME_COUNT; ++regime)
            for (int trial = 0; trial < 100; ++trial) {
                const int near = (int)test_uniform(&state, 0, count);
                const Segment s = random_segment(&state, &samples[near], regime);
                const FieldRadiance a =
                    along(point_gather_portable, &tree, &medium, s.o, s.d, s.length, NULL);
                const FieldRadiance b =
                    along(point_gather_avx2, &tree, &medium, s.o, s.d, s.length, NULL);
                bright += a.contribution > 0.0f;
                different += !is_same(&a, &b);
            }
        point_tree_clear(&tree);
    }
    ENSURE(bright > 1000);
    ENSURE(different == 0);
    ENSURE(point_gather_select() == point_gather_avx2);
#endif
}

/* The tree has the same bits whoever builds it, and finds every sample. */
static void tree_does_not_depend_on_threads(void) {
    static PointSample samples[SAMPLE_MAX];
    uint64_t state = 3;
    for (int n = 0; n < COUNT_CASES; ++n) {
        const int count = SAMPLE_COUNTS[n];
        fill_samples(&state, samples, count);
        /* Equal centres: half of the samples stand on top of others. */
        for (int i = 1; i < count; i += 2)
            samples[i] = samples[i - 1];
        PointTree one = build(samples, count, 1);
        for (uint32_t threads = 2; threads <= 7; threads += 5) {
            PointTree many = build(samples, count, threads);
            ENSURE(one.node_count == many.node_count && one.block_count == many.block_count);
            ENSURE(memcmp(one.nodes, many.nodes, one.node_count * sizeof *one.nodes) == 0);
            ENSURE(memcmp(one.blocks, many.blocks, one.block_count * sizeof *one.blocks) == 0);
            point_tree_clear(&many);
        }
        point_tree_clear(&one);
    }
    Job job;
    job_init(&job, 2);
    atomic_store(&job.cancelled, true);
    PointTree tree;
    ENSURE_STATUS(point_tree_build(samples, SAMPLE_MAX, &job, &tree), AMB_CANCELLED);
    ENSURE(tree.nodes == NULL && tree.blocks == NULL);
}

/* Camera and light exactly along each other, on the axis: the kernel is a constant there. */
static void gather_along_a_sample_is_exact(void) {
    const Medium medium = {
        .sigma_t = {0.02f, 0.01f, 0.0f}, .lobe_count = 1, .lobes = {{{1, 1, 1}, 0.3f}}};
    for (int direction = -1; direction <= 1; direction += 2) {
        const PointSample sample = {.origin = {0.5f, 0.25f, 0},
                                    .direction = {0, 0, 1},
                                    .high = 2.0f,
                                    .radius = 0.125f,
                                    .flux = {1, 2, 3}};
        PointTree tree = build(&sample, 1, 1);
        const Vec3 o = vec3(0.5f, 0.25f, direction > 0 ? -1.0f : 3.0f);
        const FieldRadiance out = along(point_gather_portable, &tree, &medium, o,
                                        vec3(0, 0, (float)direction), 10.0f, NULL);
        const double kernel = 2.0 / (PI * 0.125 * 0.125), p = phase(-direction, 0.3);
        for (int k = 0; k < 3; ++k) {
            const double sigma_t = channel_of(medium.sigma_t, k);
            /* Along: t + s = 1 + 2 s; against: t + s = 3, whatever s. */
            const double light =
                direction > 0
                    ? (sigma_t > 0.0 ? exp(-sigma_t) * (1.0 - exp(-4.0 * sigma_t)) / (2.0 * sigma_t)
                                     : 2.0)
                    : 2.0 * exp(-3.0 * sigma_t);
            ENSURE_NEAR(channel_of(out.radiance, k) / ((k + 1) * kernel * p * light), 1.0, 2e-4);
        }
        point_tree_clear(&tree);
    }
}

/* Rays side by side through a sample: int K dA = 1, so the sum is sigma_s p Phi. */
static void kernel_is_normalised(void) {
    enum { RAYS = 2000 };
    const Medium medium = {
        .sigma_t = {0, 0, 0}, .lobe_count = 1, .lobes = {{{0.5f, 0.5f, 0.5f}, 0.4f}}};
    static const float radii[] = {1e-3f, 0.1f, 1.0f, 100.0f};
    for (size_t i = 0; i < sizeof radii / sizeof radii[0]; ++i) {
        const float radius = radii[i];
        const PointSample sample = {
            .direction = {1, 0, 0}, .high = 8.0f * radius, .radius = radius, .flux = {2, 2, 2}};
        PointTree tree = build(&sample, 1, 1);
        double sum = 0.0;
        for (int ray = 0; ray < RAYS; ++ray) {
            const float y = radius * (2.2f * ((float)ray + 0.5f) / RAYS - 1.1f);
            const Vec3 o = vec3(4.0f * radius, y, -3.0f * radius);
            const FieldRadiance out =
                along(point_gather_portable, &tree, &medium, o, vec3(0, 0, 1), 6.0f * radius, NULL);
            sum += (double)out.radiance.r * 2.2 * (double)radius / RAYS;
        }
        ENSURE_NEAR(sum, 0.5 * phase(0.0, 0.4) * 2.0, 1e-5);
        point_tree_clear(&tree);
    }
}

/* ---- Placement ------------------------------------------------------------------------------- */

static LightBeam straight_beam(float length, float area) {
    LightBeam beam = {.direction = {1, 0, 0}, .length = length, .flux = {1, 1, 1}};
    beam.entry_area = beam.cell_area = area;
    beam.spread.coefficients[0] = area * area;
    return beam;
}

static PointCloud place(LightBeam *beams, uint64_t count, const Medium *medium,
                        PointParams params) {
    const LightBeams list = {beams, count};
    Job job;
    job_init(&job, 1);
    PointCloud cloud;
    ENSURE_STATUS(points_build(&list, medium, &params, &job, &cloud), AMB_OK);
    return cloud;
}

/* Radiance of the ray that crosses the x axis at a right angle at x = s. */
static double across(const PointCloud *cloud, float s) {
    return (double)cloud_along(cloud, vec3(s, 0, -50), vec3(0, 0, 1), 100.0f).radiance.r;
}

static const Medium THIN = {
    .sigma_t = {1e-3f, 0, 0}, .lobe_count = 1, .lobes = {{{1, 1, 1}, 0.0f}}};

/* Samples tile their beam: neither gap nor overlap, and the flux is that of the point itself. */
static void points_tile_a_beam(void) {
    for (int count = 1; count <= 40; count += 13) {
        LightBeam beam = straight_beam(7.0f, 0.01f);
        PointCloud cloud =
            place(&beam, 1, &THIN, (PointParams){true, 16.0f, 7.0f / (float)count, 0, 0});
        ENSURE(cloud.count.all == (uint64_t)count);
        ENSURE(points_bytes(&cloud) > 0);
        const double radius = sqrt(0.6 * 16.0 * 0.01 / PI);
        double worst = 0.0;
        for (float s = 0.003f; s < 7.0f; s += 0.0101f) {
            /* int K over a diameter is 8 / (3 pi R). */
            const double expected =
                8.0 / (3.0 * PI * radius) / (4.0 * PI) * exp(-1e-3 * (50.0 + (double)s));
            worst = test_worse(worst, fabs(across(&cloud, s) / expected - 1.0));
        }
        ENSURE_NEAR(worst, 0.0, 2e-5);
        ENSURE(across(&cloud, -0.01f) == 0.0 && across(&cloud, 7.01f) == 0.0);
        points_clear(&cloud);
        ENSURE(cloud.count.all == 0);
    }
}

/* Bounds of cells' areas (GROWTH_MAX beside lamps, AREA_MAX) say how wide kernels are, and move no
 * flux: what all rays across a beam see is that of the point itself, whatever the area. */
static void bounds_of_kernels_keep_the_flux(void) {
    enum { RAYS = 4000 };
    const float areas[] = {1e-8f, 1e-4f, 1e-2f, 0.16f, 0.64f};
    for (size_t i = 0; i < sizeof areas / sizeof areas[0]; ++i) {
        LightBeam beam = straight_beam(7.0f, areas[i]);
        PointCloud cloud = place(&beam, 1, &THIN, (PointParams){true, 16.0f, 0.7f, 0, 0});
        const double reach = 1.1 * sqrt(0.6 * 16.0 * (double)areas[i] / PI);
        double sum = 0.0;
        for (int ray = 0; ray < RAYS; ++ray) {
            const double y = reach * (2.0 * (ray + 0.5) / RAYS - 1.0);
            const Vec3 o = vec3(3.5f, (float)y, -50.0f);
            const FieldRadiance seen = cloud_along(&cloud, o, vec3(0, 0, 1), 100.0f);
            sum += (double)seen.radiance.r * 2.0 * reach / RAYS;
        }
        ENSURE_NEAR(sum * 4.0 * PI * exp(1e-3 * 53.5), 1.0, 1e-4);
        points_clear(&cloud);
    }
}

static void points_reach_to_a_tilted_boundary(void) {
    LightBeam beam = straight_beam(7.0f, 0.01f);
    beam.start_slope = 1.0f;
    beam.end_slope = 1e6f;
    PointCloud cloud = place(&beam, 1, &THIN, (PointParams){true, 16.0f, 1.0f, 0, 0});
    const float radius = sqrtf(0.6f * 16.0f * 0.01f / 3.14159265f);
    ENSURE(across(&cloud, -0.98f * radius) > 0.0 && across(&cloud, -1.02f * radius) == 0.0);
    /* At grazing incidence the reach is bounded. */
    ENSURE(across(&cloud, 7.0f + radius) > 0.0 && across(&cloud, 7.0f + 5.0f * radius) == 0.0);
    points_clear(&cloud);
}

/* R from the height of the profile, 8 / (3 pi R) (1/4 pi). */
static double radius_at(const PointCloud *cloud, float s) {
    return 8.0 / (3.0 * PI) / (4.0 * PI) / across(cloud, s);
}

static void points_follow_the_covariance(void) {
    Medium clear = THIN;
    clear.sigma_t = rgb(0, 0, 0);
    /* A tube of two equal axes that closes at s = 4: a = a_0 (1 - s/4)^2. */
    LightBeam beam = straight_beam(8.0f, 0.02f);
    const float a2 = 0.02f * 0.02f;
    static const float binomial[5] = {1, 4, 6, 4, 1};
    for (int i = 0; i < 5; ++i)
        beam.spread.coefficients[i] = a2 * binomial[i] * powf(-0.25f, (float)i);
    PointCloud cloud = place(&beam, 1, &clear, (PointParams){true, 10.0f, 0.1f, 0, 0});
    ENSURE(cloud.count.all == 80);
    for (int i = 0; i < 80; ++i) {
        const double s = 0.05 + 0.1 * i, width = 1.0 - s / 4.0;
        const double frequency = 1.0 / (1.0 + width * width);
        const double area = 0.02 * 10.0 * (0.4 * cos(PI * frequency) + 0.6);
        ENSURE_NEAR(radius_at(&cloud, (float)s) / sqrt(area / PI), 1.0, 1e-3);
        const FieldRadiance out =
            cloud_along(&cloud, vec3((float)s, 0, -50), vec3(0, 0, 1), 100.0f);
        ENSURE_NEAR(out.frequency / out.contribution, frequency, 1e-3);
    }
    points_clear(&cloud);
    /* One radius for all: the mean entry area by flux. */
    LightBeam beams[2] = {straight_beam(1.0f, 0.01f), straight_beam(1.0f, 0.04f)};
    beams[0].flux = rgb(3, 3, 3);
    beams[1].origin = vec3(0, 10, 0);
    cloud = place(beams, 2, &clear, (PointParams){false, 10.0f, 0.1f, 0, 0});
    ENSURE_NEAR(radius_at(&cloud, 0.55f) * 3.0 / sqrt(10.0 * 0.0175 / PI), 1.0, 1e-4);
    points_clear(&cloud);
}

/* However a beam is cut into samples, the sum is the same: the attenuation is taken at the point
 * itself. Not exactly, for each sample integrates it with two Gauss points along its own chord. */
static void points_do_not_depend_on_the_cut(void) {
    const Medium medium = {
        .sigma_t = {1.0f, 0.3f, 0.0f}, .lobe_count = 1, .lobes = {{{1, 1, 1}, 0.5f}}};
    uint64_t state = 4;
    double worst_thin = 0.0, worst = 0.0;
    for (int trial = 0; trial < 200; ++trial) {
        LightBeam beams[4];
        for (int i = 0; i < 4; ++i) {
            beams[i] = straight_beam((float)test_uniform(&state, 0.5, 4.0), 0.01f);
            beams[i].origin = random_point(&state, 0.1);
            beams[i].direction = random_direction(&state);
        }
        const PointSample near = {.origin = beams[0].origin,
                                  .direction = beams[0].direction,
                                  .high = beams[0].length,
                                  .radius = 0.1f};
        const Segment s = random_segment(&state, &near, trial % 2 ? NEARLY_PARALLEL : ANYWHERE);
        FieldRadiance cuts[3];
        static const float spacings[3] = {0.02f, 0.3f, 100.0f};
        for (int i = 0; i < 3; ++i) {
            PointCloud cloud =
                place(beams, 4, &medium, (PointParams){false, 4.0f, spacings[i], 0, 0});
            cuts[i] = cloud_along(&cloud, s.o, s.d, s.length);
            points_clear(&cloud);
        }
        const double fine = (double)cuts[0].radiance.r;
        worst_thin = test_worse(worst_thin, fabs((double)cuts[1].radiance.r / fine - 1.0));
        worst = test_worse(worst, fabs((double)cuts[2].radiance.r / fine - 1.0));
        /* Without extinction there is nothing to integrate but the kernel: exact. */
        if (cuts[0].radiance.b > 0.0f)
            ENSURE_NEAR((double)cuts[2].radiance.b / (double)cuts[0].radiance.b, 1.0, 2e-4);
    }
    ENSURE_NEAR(worst_thin, 0.0, 1e-4);
    ENSURE_NEAR(worst, 0.0, 1e-4);
}

/* Parts are of the beams, each of one part: their sum is the whole. */
static void parts_add_up(void) {
    enum { BEAMS = 64, PARTS = 4 };
    uint64_t state = 8;
    LightBeam beams[BEAMS];
    for (int i = 0; i < BEAMS; ++i) {
        beams[i] = straight_beam((float)test_uniform(&state, 0.5, 4.0), 0.05f);
        beams[i].origin = random_point(&state, 0.1);
        beams[i].direction = random_direction(&state);
        beams[i].rank = (float)test_uniform(&state, 0.0, 0.999);
    }
    PointCloud whole = place(beams, BEAMS, &THIN, (PointParams){true, 16.0f, 0.3f, 0, 0});
    PointCloud parts[PARTS];
    uint64_t count = 0;
    for (uint32_t k = 0; k < PARTS; ++k) {
        parts[k] = place(beams, BEAMS, &THIN, (PointParams){true, 16.0f, 0.3f, k, PARTS});
        ENSURE(parts[k].count.all > 0 && parts[k].count.all < whole.count.all);
        count += parts[k].count.all;
    }
    ENSURE(count == whole.count.all);
    double worst = 0.0;
    for (int trial = 0; trial < 200; ++trial) {
        const Vec3 o = random_point(&state, 0.5), d = random_direction(&state);
        const double expected = (double)cloud_along(&whole, o, d, 3.0f).radiance.g;
        double sum = 0.0;
        for (uint32_t k = 0; k < PARTS; ++k)
            sum += (double)cloud_along(&parts[k], o, d, 3.0f).radiance.g;
        worst = test_worse(worst, expected > 0.0 ? fabs(sum / expected - 1.0) : sum);
    }
    ENSURE_NEAR(worst, 0.0, 1e-4);
    for (uint32_t k = 0; k < PARTS; ++k)
        points_clear(&parts[k]);
    points_clear(&whole);
}

/* ---- Limits ---------------------------------------------------------------------------------- */

static bool is_finite(const FieldRadiance *out) {
    return rgb_is_finite(out->radiance) && rgb_is_finite(out->straight_once) &&
           rgb_is_finite(out->straight_more) && isfinite(out->frequency) &&
           isfinite(out->contribution);
}

/* Light that goes straight on a part of the way is what is gathered from its end: with F =
 * straight, int x Q = int F exp(-sigma s) G(s) ds,  int (exp(x) - 1 - x) Q = int F (exp(F s) - 1)
 * ..., G(s) the radiance beyond s. */
static void straight_light_is_gathered_from_beyond(void) {
    enum { STEPS = 400 };
    static PointSample samples[SAMPLE_MAX];
    uint64_t state = 11;
    double sums[2] = {0, 0}, expected[2] = {0, 0}, difference[2] = {0, 0};
    const int count = 100;
    fill_samples(&state, samples, count);
    PointTree tree = build(samples, count, 1);
    for (int trial = 0; trial < 60; ++trial) {
        const Medium medium = random_medium(&state);
        const int near = (int)test_uniform(&state, 0, count);
        const Segment s = random_segment(&state, &samples[near], (Regime)(trial % REGIME_COUNT));
        const float length = fminf(s.length, 6.0f);
        FieldSegment segment = {.o = s.o, .d = s.d, .length = length};
        const float sigma_t = medium.sigma_t.r, straight = 0.5f * sigma_t;
        segment.straight = rgb(straight, straight, straight);
        const FieldRadiance out = point_gather_portable(&tree, &medium, &segment, NULL);
        double once = 0.0, more = 0.0;
        for (int i = 0; i < STEPS; ++i) {
            const float begin = ((float)i + 0.5f) * length / (float)STEPS;
            const FieldRadiance beyond =
                along(point_gather_portable, &tree, &medium, vec3_madd(s.o, begin, s.d), s.d,
                      length - begin, NULL);
            const double weight = exp(-(double)(sigma_t * begin)) * (double)straight *
                                  (double)beyond.radiance.r * (double)length / STEPS;
            once += weight;
            more += weight * expm1((double)(straight * begin));
        }
        const double found[2] = {(double)out.straight_once.r, (double)out.straight_more.r};
        const double sought[2] = {once, more};
        for (int k = 0; k < 2; ++k) {
            sums[k] += found[k];
            expected[k] += sought[k];
            difference[k] += fabs(found[k] - sought[k]);
        }
    }
    point_tree_clear(&tree);
    for (int k = 0; k < 2; ++k) {
        ENSURE(expected[k] > 0.0);
        ENSURE_NEAR(sums[k] / expected[k], 1.0, 0.01);
        ENSURE_NEAR(difference[k] / expected[k], 0.0, 0.02);
    }
}

static void gather_is_finite_at_the_limits(void) {
    static const float sigmas[] = {0.0f, 1e-6f, 1.0f, 1e6f};
    static const float lengths[] = {1e-7f, 1e-3f, 1.0f, 1e3f, 1e7f};
    static const float radii[] = {1e-6f, 1e-2f, 1e3f};
    static const float gs[] = {-0.9999f, 0.9999f};
    uint64_t state = 5;
    int bright = 0;
    bool all_finite = true, none_negative = true;
    for (size_t a = 0; a < 4; ++a)
        for (size_t b = 0; b < 5; ++b)
            for (size_t c = 0; c < 3; ++c)
                for (int trial = 0; trial < 70; ++trial) {
                    const Medium medium = {
                        .sigma_t = {sigmas[a], sigmas[a], sigmas[a]},
                        .lobe_count = 1,
                        .lobes = {{{sigmas[a], sigmas[a], sigmas[a]}, gs[trial % 2]}}};
                    PointSample sample = random_sample(&state);
                    sample.radius = radii[c];
                    sample.high = lengths[b];
                    PointTree tree = build(&sample, 1, 1);
                    Segment s =
                        random_segment(&state, &sample, (Regime)(trial % (int)REGIME_COUNT));
                    if (trial % 3 == 0)
                        s.length = lengths[(b + (size_t)trial) % 5];
                    const FieldRadiance out =
                        along(point_gather_select(), &tree, &medium, s.o, s.d, s.length, NULL);
                    all_finite = all_finite && is_finite(&out);
                    none_negative = none_negative && out.radiance.r >= 0.0f;
                    bright += out.radiance.r > 0.0f;
                    point_tree_clear(&tree);
                }
    ENSURE(all_finite);
    ENSURE(none_negative);
    ENSURE(bright > 500);
}

static void gather_skips_what_is_beside_the_segment(void) {
    const PointSample sample = {
        .direction = {1, 0, 0}, .high = 1.0f, .radius = 0.1f, .flux = {1, 1, 1}};
    PointTree tree = build(&sample, 1, 1);
    const Vec3 up = vec3(0, 0, 1);
    const Vec3 below = vec3(0.5f, 0, -1);
    ENSURE(along(point_gather_portable, &tree, &THIN, below, up, 2.0f, NULL).radiance.r > 0.0f);
    /* Ends before, begins behind, passes by on all sides. */
    ENSURE(along(point_gather_portable, &tree, &THIN, below, up, 0.89f, NULL).radiance.r == 0.0f);
    ENSURE(along(point_gather_portable, &tree, &THIN, vec3(0.5f, 0, 0.11f), up, 2.0f, NULL)
               .radiance.r == 0.0f);
    ENSURE(along(point_gather_portable, &tree, &THIN, vec3(0.5f, 0.101f, -1), up, 2.0f, NULL)
               .radiance.r == 0);
    ENSURE(along(point_gather_portable, &tree, &THIN, vec3(-1e-5f, 0, -1), up, 2.0f, NULL)
               .radiance.r == 0);
    ENSURE(along(point_gather_portable, &tree, &THIN, vec3(1.00001f, 0, -1), up, 2.0f, NULL)
               .radiance.r == 0);
    /* Components of no direction, with either sign of zero. */
    const Vec3 minus = vec3(-0.0f, -0.0f, 1.0f);
    ENSURE(along(point_gather_portable, &tree, &THIN, below, minus, 2.0f, NULL).radiance.r > 0.0f);
    point_tree_clear(&tree);
}

static void field_without_light_is_dark(void) {
    SceneObject object = {.inside = 0};
    SceneMaterial material = {.medium = THIN};
    AmbScene scene = {.objects = &object, .materials = &material, .object_count = 1};
    LightBeams none = {NULL, 0};
    const LightField light = {.objects = &none, .object_count = 1};
    const FieldParams params = {
        .estimator = AMB_ESTIMATOR_POINTS_COVARIANCE, .sample_target = 1000, .kernel_size = 16.0f};
    Job job;
    job_init(&job, 1);
    Field *field = NULL;
    ENSURE_STATUS(field_create(&scene, &light, &params, &job, &field), AMB_OK);
    const FieldSegment segment = {{0, 0, 0}, {0, 0, 1}, 1.0f, 0, 0, 0.0f, {0, 0, 0}, NULL};
    const FieldRadiance out = field_gather(field, &segment);
    ENSURE(out.contribution == 0.0f && out.frequency == 0.0f && rgb_max(out.radiance) == 0.0f);
    ENSURE(field_size(field).volume_samples == 0);
    field_destroy(field);
    field_destroy(NULL);
}

/* About as many samples as were asked for, shared by length. */
static void field_places_about_the_samples_asked_for(void) {
    enum { BEAMS = 500 };
    static LightBeam beams[BEAMS];
    uint64_t state = 6;
    for (int i = 0; i < BEAMS; ++i) {
        beams[i] = straight_beam((float)test_uniform(&state, 0.01, 2.0), 0.01f);
        beams[i].direction = random_direction(&state);
    }
    SceneObject object = {.inside = 0};
    SceneMaterial material = {.medium = THIN};
    AmbScene scene = {.objects = &object, .materials = &material, .object_count = 1};
    LightBeams list = {beams, BEAMS};
    const LightField light = {.objects = &list, .object_count = 1};
    for (uint64_t target = 4000; target <= 64000; target *= 4) {
        const FieldParams params = {
            .estimator = AMB_ESTIMATOR_POINTS_FIXED, .sample_target = target, .kernel_size = 16.0f};
        Job job;
        job_init(&job, 2);
        Field *field = NULL;
        ENSURE_STATUS(field_create(&scene, &light, &params, &job, &field), AMB_OK);
        ENSURE_NEAR((double)field_size(field).volume_samples / (double)target, 1.0, 0.02);
        field_destroy(field);
    }
}

void test_gather(void);

void test_gather(void) {
    RUN(gather_matches_brute_force);
    RUN(gather_variants_agree_bit_for_bit);
    RUN(tree_does_not_depend_on_threads);
    RUN(gather_along_a_sample_is_exact);
    RUN(kernel_is_normalised);
    RUN(points_tile_a_beam);
    RUN(bounds_of_kernels_keep_the_flux);
    RUN(points_reach_to_a_tilted_boundary);
    RUN(points_follow_the_covariance);
    RUN(points_do_not_depend_on_the_cut);
    RUN(parts_add_up);
    RUN(straight_light_is_gathered_from_beyond);
    RUN(gather_is_finite_at_the_limits);
    RUN(gather_skips_what_is_beside_the_segment);
    RUN(field_without_light_is_dark);
    RUN(field_places_about_the_samples_asked_for);
}
