/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light tubes: the sum over them against quadrature in double that knows no zero curve, no lanes
 * and no tree. */
#include <string.h>

#include "field/tubes/tube_gather.h"
#include "scene/scene.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

enum { TUBE_MAX = 3000 };

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

/* A tube of about the given size within a unit ball. */
static Tube random_tube(uint64_t *state, double size) {
    const Vec3 x = random_point(state, 0.5), w = random_direction(state);
    Tube tube = {.far = 0.0f};
    for (int k = 0; k < 3; ++k) {
        tube.x[k] = vec3_add(x, random_point(state, size));
        tube.w[k] = vec3_normalize(vec3_add(w, random_point(state, 0.3 * size)));
        tube.limit[k] = (float)test_uniform(state, 0.5, 2.0);
        tube.start[k] = (float)test_uniform(state, 0.0, 0.5);
        tube.value[k] = (float)test_uniform(state, 0.2, 1.0);
        tube.far = fmaxf(tube.far, tube.limit[k]);
    }
    return tube;
}

typedef struct Segment {
    Vec3 o, d;
    float length;
} Segment;

/* A segment that meets some of the tube's light, mostly; sometimes it runs nearly along it. */
static Segment random_segment(uint64_t *state, const Tube *near) {
    const float s = (float)test_uniform(state, 0.0, 1.5);
    const float u = (float)test_uniform(state, 0.0, 0.5), v = (float)test_uniform(state, 0.0, 0.5);
    const float weight[3] = {1.0f - u - v, u, v};
    Vec3 p = vec3(0, 0, 0);
    for (int k = 0; k < 3; ++k)
        p = vec3_madd(p, weight[k], vec3_madd(near->x[k], s, near->w[k]));
    Segment segment = {.d = random_direction(state)};
    if (test_uniform(state, 0, 1) < 0.3)
        segment.d = vec3_normalize(vec3_add(near->w[0], random_point(state, 0.2)));
    segment.o = vec3_madd(p, -(float)test_uniform(state, 0.0, 1.0), segment.d);
    segment.length = (float)test_uniform(state, 0.2, 2.0);
    return segment;
}

static Medium test_medium(float sigma_t, float g) {
    Medium medium = {.sigma_t = {sigma_t, 0.3f * sigma_t, 0.0f}, .lobe_count = 1};
    medium.lobes[0] = (MediumLobe){.sigma_s = {0.4f, 0.3f, 0.2f}, .g = g};
    return medium;
}

/* Values are watts. */
static const TubeLight LIGHT = {.color = {1.0f, 0.5f, 0.7f}, .value = TUBE_VALUE_IS_FLUX};

static TubeTree build(const Tube *tubes, uint64_t count, uint32_t threads) {
    Job job;
    job_init(&job, threads);
    TubeTree tree;
    ENSURE_STATUS(tube_tree_build(tubes, count, &LIGHT, vec3(0, 0, 0), 1.0f, &job, &tree), AMB_OK);
    tree.bend_max = 0.1f;
    return tree;
}

typedef struct Vector {
    double x, y, z;
} Vector;

static Vector mixed(const Vec3 v[3], const double weight[3]) {
    Vector out = {0, 0, 0};
    for (int k = 0; k < 3; ++k) {
        out.x += weight[k] * (double)v[k].x;
        out.y += weight[k] * (double)v[k].y;
        out.z += weight[k] * (double)v[k].z;
    }
    return out;
}

static double dot(Vector a, Vector b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}

static Vector cross(Vector a, Vector b) {
    return (Vector){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

static double phase(double cosine, double g) {
    return (1.0 - g * g) / (4.0 * PI * pow(1.0 + g * g - 2.0 * g * cosine, 1.5));
}

static double f_of(const Tube *tube, const Segment *segment, const double weight[3]) {
    const Vector x = mixed(tube->x, weight), w = mixed(tube->w, weight);
    const Vector o = {(double)segment->o.x, (double)segment->o.y, (double)segment->o.z};
    const Vector d = {(double)segment->d.x, (double)segment->d.y, (double)segment->d.z};
    return dot((Vector){x.x - o.x, x.y - o.y, x.z - o.z}, cross(w, d));
}

/* What a line of the tube contributes per flux and unit of f, red; 0 where it misses. */
static double line_value(const Tube *tube, const Segment *segment, const Medium *medium,
                         const double weight[3]) {
    const Vector x = mixed(tube->x, weight), w = mixed(tube->w, weight);
    const Vector o = {(double)segment->o.x, (double)segment->o.y, (double)segment->o.z};
    const Vector d = {(double)segment->d.x, (double)segment->d.y, (double)segment->d.z};
    const Vector e = {x.x - o.x, x.y - o.y, x.z - o.z};
    const double unit = sqrt(dot(w, w)), c = dot(w, d) / unit;
    const double sin2 = 1.0 - c * c;
    const double t = (dot(e, d) - dot(e, w) / unit * c) / sin2;
    const double s = (dot(e, d) * c - dot(e, w) / unit) / sin2;
    double limit = 0.0, flux = 0.0, start = 0.0;
    for (int k = 0; k < 3; ++k) {
        limit += weight[k] * (double)tube->limit[k];
        start += weight[k] * (double)tube->start[k];
        flux += weight[k] * (double)tube->value[k];
    }
    if (t < 0.0 || t > (double)segment->length || s < 0.0 || s > limit)
        return 0.0;
    return flux * (double)LIGHT.color.r * (double)medium->lobes[0].sigma_s.r *
           phase(-c, (double)medium->lobes[0].g) *
           exp(-(double)medium->sigma_t.r * (start + s + t));
}

/* int dA/A delta(f) value, f between the corners linear as it is in Pluecker coordinates, with the
 * delta function as a narrow box: a grid over the triangle. */
static double brute_force(const Tube *tube, const Segment *segment, const Medium *medium) {
    enum { STEPS = 500 };
    static const double corners[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    double f[3];
    for (int k = 0; k < 3; ++k)
        f[k] = f_of(tube, segment, corners[k]);
    const double range = fmax(fmax(f[0], f[1]), f[2]) - fmin(fmin(f[0], f[1]), f[2]);
    const double width = range / 50.0;
    double sum = 0.0;
    uint64_t points = 0;
    for (int i = 0; i < STEPS; ++i)
        for (int j = 0; i + j < STEPS; ++j)
            for (int half = 0; half < (i + j + 1 < STEPS ? 2 : 1); ++half) {
                const double u = (i + (half + 1) / 3.0) / STEPS, v = (j + (half + 1) / 3.0) / STEPS;
                const double weight[3] = {1.0 - u - v, u, v};
                ++points;
                if (fabs(weight[0] * f[0] + weight[1] * f[1] + weight[2] * f[2]) < 0.5 * width)
                    sum += line_value(tube, segment, medium, weight) / width;
            }
    return sum / (double)points;
}

/* What scatters straight on, 1/m. */
static const Rgb STRAIGHT = {0.3f, 0.1f, 0.02f};

static FieldRadiance gather(TubeGather variant, const TubeTree *tree, const Medium *medium, Vec3 o,
                            Vec3 d, float length) {
    const TubeRay ray = {o, d, length, true, 1.0f, STRAIGHT};
    FieldRadiance out;
    variant(tree, medium, &ray, 1, &out);
    return out;
}

static void one_tube_matches_brute_force(void) {
    uint64_t state = 1;
    double total = 0.0, expected = 0.0, difference = 0.0;
    int hits = 0;
    for (int trial = 0; trial < 150; ++trial) {
        const Tube tube = random_tube(&state, 0.05);
        const Segment segment = random_segment(&state, &tube);
        const Medium medium = test_medium(trial % 2 == 0 ? 0.5f : 3.0f, trial % 3 == 0 ? 0.6f : 0);
        TubeTree tree = build(&tube, 1, 1);
        const FieldRadiance out =
            gather(tube_gather_portable, &tree, &medium, segment.o, segment.d, segment.length);
        tube_tree_clear(&tree);
        const double truth = brute_force(&tube, &segment, &medium);
        hits += truth > 0.0;
        total += (double)out.radiance.r;
        expected += truth;
        difference += fabs((double)out.radiance.r - truth);
        ENSURE(out.frequency >= 0.0f && out.frequency <= out.contribution * 1.00001f);
    }
    ENSURE(hits > 80);
    /* The box smooths each truth by 1/50 of the tube; over all of them that nearly cancels. */
    ENSURE_NEAR(total / expected, 1.0, 0.01);
    ENSURE(difference < 0.05 * expected);
}

/* Light across the ray everywhere: L = Phi sigma_s p e^{-sigma_t (s + t)} / width of the sheet. */
static void a_square_of_light_is_exact(void) {
    Tube tubes[2];
    static const float corner[2][3][2] = {{{0, 0}, {1, 0}, {1, 1}}, {{0, 0}, {1, 1}, {0, 1}}};
    for (int i = 0; i < 2; ++i) {
        tubes[i] = (Tube){.far = 10.0f};
        for (int k = 0; k < 3; ++k) {
            tubes[i].x[k] = vec3(corner[i][k][0], corner[i][k][1], 0);
            tubes[i].w[k] = vec3(0, 0, 1);
            tubes[i].limit[k] = 10.0f;
            tubes[i].value[k] = 0.5f; /* 1 W over a square metre */
        }
    }
    TubeTree tree = build(tubes, 2, 1);
    const Medium medium = test_medium(0.7f, 0.0f);
    const double p = 0.4 / (4.0 * PI);
    /* Along x at depth 2 and y = 0.3 from x = -1: lit for 1 < t < 2. */
    const FieldRadiance across =
        gather(tube_gather_portable, &tree, &medium, vec3(-1, 0.3f, 2), vec3(1, 0, 0), 5.0f);
    const double lit = p * exp(-0.7 * 2.0) * (exp(-0.7) - exp(-1.4)) / 0.7;
    ENSURE_NEAR(across.radiance.r, lit, 2e-3 * lit); /* midpoint per chord of both triangles */
    /* The segment ends within the light. */
    const FieldRadiance half =
        gather(tube_gather_portable, &tree, &medium, vec3(-1, 0.3f, 2), vec3(1, 0, 0), 1.5f);
    const double lit_half = p * exp(-0.7 * 2.0) * (exp(-0.7) - exp(-1.05)) / 0.7;
    ENSURE_NEAR(half.radiance.r, lit_half, 2e-3 * lit_half);
    /* Nearly along the light, from inside: int_0^3 of E sigma_s p e^{-sigma_t (1 + 2 t)}. */
    const Vec3 along = vec3_normalize(vec3(1e-3f, 2e-4f, 1));
    const FieldRadiance view =
        gather(tube_gather_portable, &tree, &medium, vec3(0.3f, 0.4f, 1), along, 3.0f);
    const double deep = p * exp(-0.7) * (1.0 - exp(-4.2)) / 1.4;
    ENSURE_NEAR(view.radiance.r, deep, 3e-3 * deep);
    ENSURE_NEAR(view.contribution, rgb_mean(view.radiance), 0.0);
    tube_tree_clear(&tree);
}

/* See test_gather.c: what is gathered from beyond each place, and goes straight on from there. */
static void straight_light_is_gathered_from_beyond(void) {
    enum { STEPS = 400 };
    static Tube tubes[TUBE_MAX];
    const float sigmas[3] = {0.5f, 3.0f, 30.0f};
    uint64_t state = 12;
    for (int m = 0; m < 3; ++m) {
        const Medium medium = test_medium(sigmas[m], 0.3f);
        const float straight = 0.5f * sigmas[m];
        double sums[2] = {0, 0}, expected[2] = {0, 0};
        for (int trial = 0; trial < 40; ++trial) {
            for (int i = 0; i < 20; ++i)
                tubes[i] = random_tube(&state, 0.03);
            TubeTree tree = build(tubes, 20, 1);
            Segment s = random_segment(&state, &tubes[0]);
            /* Along the light tubes as wide as these are not linear, in either way. */
            while (fabsf(vec3_dot(s.d, tubes[0].w[0])) > 0.9f)
                s = random_segment(&state, &tubes[0]);
            const float length = fminf(s.length, fminf(2.0f, 12.0f / sigmas[m]));
            const TubeRay ray = {s.o, s.d, length, false, 1.0f, rgb(straight, straight, straight)};
            FieldRadiance out;
            tube_gather_select()(&tree, &medium, &ray, 1, &out);
            sums[0] += (double)out.straight_once.r;
            sums[1] += (double)out.straight_more.r;
            for (int i = 0; i < STEPS; ++i) {
                const float begin = ((float)i + 0.5f) * length / (float)STEPS;
                const FieldRadiance beyond =
                    gather(tube_gather_select(), &tree, &medium, vec3_madd(s.o, begin, s.d), s.d,
                           length - begin);
                const double weight = exp(-(double)(sigmas[m] * begin)) * (double)straight *
                                      (double)beyond.radiance.r * (double)length / STEPS;
                expected[0] += weight;
                expected[1] += weight * expm1((double)(straight * begin));
            }
            tube_tree_clear(&tree);
        }
        for (int k = 0; k < 2; ++k) {
            ENSURE(expected[k] > 0.0);
            ENSURE_NEAR(sums[k] / expected[k], 1.0, 0.03);
        }
    }
}

static void tree_loses_no_tube(void) {
    static Tube tubes[TUBE_MAX];
    uint64_t state = 3;
    int bright = 0;
    for (int n = 0; n < 3; ++n) {
        const uint64_t count = n == 0 ? 9 : n == 1 ? 200 : 700;
        for (uint64_t i = 0; i < count; ++i)
            tubes[i] = random_tube(&state, 0.1);
        TubeTree tree = build(tubes, count, 2);
        const Medium medium = test_medium(0.5f, 0.3f);
        for (int trial = 0; trial < 30; ++trial) {
            const Segment s = random_segment(&state, &tubes[trial % (int)count]);
            const FieldRadiance all =
                gather(tube_gather_portable, &tree, &medium, s.o, s.d, s.length);
            double sum = 0.0, frequency = 0.0;
            for (uint64_t i = 0; i < count; ++i) {
                TubeTree one = build(&tubes[i], 1, 1);
                const FieldRadiance out =
                    gather(tube_gather_portable, &one, &medium, s.o, s.d, s.length);
                sum += (double)out.radiance.r;
                frequency += (double)out.frequency;
                tube_tree_clear(&one);
            }
            bright += sum > 0.0;
            ENSURE_NEAR(all.radiance.r, sum, 1e-5 * sum);
            ENSURE_NEAR(all.frequency, frequency, 1e-5 * frequency);
        }
        tube_tree_clear(&tree);
    }
    ENSURE(bright > 60);
}

static void gather_variants_agree_bit_for_bit(void) {
#if defined(__x86_64__)
    if (!__builtin_cpu_supports("avx2"))
        return;
    static Tube tubes[TUBE_MAX];
    uint64_t state = 4;
    int bright = 0, different = 0;
    for (int i = 0; i < TUBE_MAX; ++i)
        tubes[i] = random_tube(&state, 0.1);
    TubeTree tree = build(tubes, TUBE_MAX, 1);
    const Medium medium = test_medium(1.0f, 0.7f);
    for (int trial = 0; trial < 1000; ++trial) {
        const Segment s = random_segment(&state, &tubes[trial]);
        const FieldRadiance a = gather(tube_gather_portable, &tree, &medium, s.o, s.d, s.length);
        const FieldRadiance b = gather(tube_gather_avx2, &tree, &medium, s.o, s.d, s.length);
        bright += a.contribution > 0.0f;
        different += memcmp(&a, &b, sizeof a) != 0;
    }
    tube_tree_clear(&tree);
    ENSURE(bright > 900);
    ENSURE(different == 0);
#endif
}

/* Rays that go through the tree together get what each gets alone, to the bit. */
static void rays_do_not_depend_on_each_other(void) {
    static Tube tubes[TUBE_MAX];
    const TubeGather variants[] = {tube_gather_portable, tube_gather_select()};
    uint64_t state = 8;
    for (int i = 0; i < TUBE_MAX; ++i)
        tubes[i] = random_tube(&state, 0.1);
    const Medium medium = test_medium(1.0f, 0.7f);
    TubeTree tree = build(tubes, TUBE_MAX, 1);
    int bright = 0, different = 0;
    for (uint32_t trial = 0; trial < 60; ++trial) {
        const uint32_t count = 1 + trial % TUBE_PACKET;
        TubeRay rays[TUBE_PACKET];
        for (uint32_t r = 0; r < count; ++r) {
            const Tube *tube = &tubes[TUBE_PACKET * trial + r];
            const Segment s = random_segment(&state, tube);
            /* Some run along the light. */
            const bool is_along = (trial + r) % 5 == 0;
            rays[r] = (TubeRay){is_along ? tube->x[0] : s.o,
                                is_along ? tube->w[0] : s.d,
                                s.length,
                                r % 2 == 0,
                                1.0f,
                                STRAIGHT};
        }
        for (int v = 0; v < 2; ++v) {
            FieldRadiance together[TUBE_PACKET];
            variants[v](&tree, &medium, rays, count, together);
            for (uint32_t r = 0; r < count; ++r) {
                FieldRadiance alone;
                variants[v](&tree, &medium, &rays[r], 1, &alone);
                bright += alone.contribution > 0.0f;
                different += memcmp(&alone, &together[r], sizeof alone) != 0;
            }
        }
    }
    tube_tree_clear(&tree);
    ENSURE(bright > 800);
    ENSURE(different == 0);
}

/* That one rounds once where the others round twice. */
static void avx512_agrees(void) {
#if defined(__x86_64__)
    if (!__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512bw") ||
        !__builtin_cpu_supports("avx512dq"))
        return;
    static Tube tubes[TUBE_MAX];
    uint64_t state = 6;
    double total = 0.0, difference = 0.0;
    for (int i = 0; i < TUBE_MAX; ++i)
        tubes[i] = random_tube(&state, 0.1);
    TubeTree tree = build(tubes, TUBE_MAX, 1);
    const Medium medium = test_medium(1.0f, 0.7f);
    for (int trial = 0; trial < 1000; ++trial) {
        const Segment s = random_segment(&state, &tubes[trial]);
        const FieldRadiance a = gather(tube_gather_portable, &tree, &medium, s.o, s.d, s.length);
        const FieldRadiance b = gather(tube_gather_avx512, &tree, &medium, s.o, s.d, s.length);
        total += (double)a.contribution;
        difference += fabs((double)(a.contribution - b.contribution));
        ENSURE_NEAR(b.radiance.g, a.radiance.g, 1e-2 * (double)a.radiance.g);
    }
    tube_tree_clear(&tree);
    ENSURE(difference < 1e-5 * total);
    ENSURE(tube_gather_select() == tube_gather_avx512);
#endif
}

/* A grid of tubes shares its corners: patches are nearly full and hold each tube once. */
static void patches_share_corners(void) {
    enum { SIDE = 30 };
    static Tube tubes[2 * SIDE * SIDE];
    for (int i = 0; i < SIDE * SIDE; ++i)
        for (int half = 0; half < 2; ++half) {
            Tube *tube = &tubes[2 * i + half];
            *tube = (Tube){.far = 1.0f};
            static const int step[2][3][2] = {{{0, 0}, {1, 0}, {1, 1}}, {{0, 0}, {1, 1}, {0, 1}}};
            for (int k = 0; k < 3; ++k) {
                tube->x[k] = vec3((float)(i % SIDE + step[half][k][0]) / SIDE,
                                  (float)(i / SIDE + step[half][k][1]) / SIDE, 0.0f);
                tube->w[k] = vec3(0, 0, 1);
                tube->value[k] = 1.0f;
                /* Within what two rays to the same end differ. */
                tube->limit[k] = 1.0f + 1e-4f * (float)((i + k) % 3);
            }
        }
    TubeTree tree = build(tubes, 2 * SIDE * SIDE, 2);
    uint64_t held = 0;
    for (uint64_t p = 0; p < tree.patch_count; ++p)
        for (int t = 0; t < PATCH_TUBES; ++t) {
            const uint16_t mask = tree.patches[p].masks[t];
            held += mask != 0;
            ENSURE(mask == 0 || __builtin_popcount(mask) == 3);
        }
    ENSURE(held == 2 * SIDE * SIDE);
    ENSURE(tree.patch_count * 12 < held);
    tube_tree_clear(&tree);
}

/* ---- Bent tubes: a piece of a lens, its normals interpolated ----------------------------------
 */

static const double ETA = 1.0 / 1.5;

typedef struct Lens {
    Vec3 x[3], n[3], light;
} Lens;

static Vec3 refracted(const Lens *lens, const float weight[3], Vec3 *out_x) {
    Vec3 x = vec3(0, 0, 0), n = x;
    for (int k = 0; k < 3; ++k) {
        x = vec3_madd(x, weight[k], lens->x[k]);
        n = vec3_madd(n, weight[k], lens->n[k]);
    }
    n = vec3_normalize(n);
    const Vec3 d = vec3_normalize(vec3_sub(x, lens->light));
    const double c = -(double)vec3_dot(d, n);
    const double cos_t = sqrt(1.0 - ETA * ETA * (1.0 - c * c));
    *out_x = x;
    return vec3_normalize(vec3_madd(vec3_scale(d, (float)ETA), (float)(ETA * c - cos_t), n));
}

/* Cuts the piece into 4^level tubes, all straight (bulge 0) or one bent one. */
static uint64_t cut_lens(const Lens *lens, const float corner[3][3], int level, float bulge,
                         Tube *out) {
    if (level > 0) {
        uint64_t count = 0;
        float middle[3][3];
        for (int k = 0; k < 3; ++k)
            for (int i = 0; i < 3; ++i)
                middle[k][i] = 0.5f * (corner[k][i] + corner[(k + 1) % 3][i]);
        for (int k = 0; k < 4; ++k) {
            float part[3][3];
            for (int i = 0; i < 3; ++i) {
                part[0][i] = k < 3 ? corner[k][i] : middle[0][i];
                part[1][i] = k < 3 ? middle[k][i] : middle[1][i];
                part[2][i] = k < 3 ? middle[(k + 2) % 3][i] : middle[2][i];
            }
            count += cut_lens(lens, (const float(*)[3])part, level - 1, bulge, out + count);
        }
        return count;
    }
    *out = (Tube){.far = 2.0f, .bulge = bulge};
    for (int k = 0; k < 3; ++k) {
        out->w[k] = refracted(lens, corner[k], &out->x[k]);
        out->value[k] = 1.0f;
        out->limit[k] = 2.0f;
    }
    return 1;
}

static TubeTree build_lens(const Lens *lens, int level, float bulge) {
    static const float whole[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static Tube tubes[4096];
    const uint64_t count = cut_lens(lens, whole, level, bulge, tubes);
    const TubeLight light = {
        .color = {1, 1, 1}, .value = TUBE_VALUE_ARRIVES, .origin = lens->light, .eta = (float)ETA};
    Job job;
    job_init(&job, 1);
    TubeTree tree;
    ENSURE_STATUS(tube_tree_build(tubes, count, &light, vec3(0, 0, 0), 1.0f, &job, &tree), AMB_OK);
    tree.bend_max = 0.002f;
    return tree;
}

/* One tube that the gather may quarter against 4096 that it may not, along rays around the lens's
 * caustic: quartering takes away nearly all of the error of one tube, at the worst ones too. */
static void bent_tubes_are_quartered(void) {
    uint64_t state = 7;
    const Medium medium = test_medium(0.5f, 0.0f);
    double plain = 0.0, bent = 0.0, total = 0.0;
    for (int trial = 0; trial < 20; ++trial) {
        Lens lens = {.light = vec3(0.1f, 0.0f, 1.5f)};
        for (int k = 0; k < 3; ++k) {
            const double angle = 2.0 * PI * k / 3.0 + test_uniform(&state, 0.0, 0.5);
            lens.x[k] = vec3(0.2f * (float)cos(angle), 0.2f * (float)sin(angle), 0.5f);
            lens.n[k] = vec3_normalize(
                vec3_madd(vec3(0, 0, 1), 4.0f, vec3_sub(lens.x[k], vec3(0, 0, 0.5f))));
        }
        TubeTree one = build_lens(&lens, 0, 0.0f), adapts = build_lens(&lens, 0, 0.3f);
        TubeTree many = build_lens(&lens, 6, 0.0f);
        for (int ray = 0; ray < 50; ++ray) {
            const Vec3 o = vec3((float)test_uniform(&state, -0.1, 0.1), -1.0f,
                                (float)test_uniform(&state, -0.6, 0.3));
            const Vec3 d = vec3_normalize(vec3((float)test_uniform(&state, -0.1, 0.1), 1, 0));
            const double truth =
                (double)gather(tube_gather_portable, &many, &medium, o, d, 2.0f).contribution;
            total += truth;
            plain +=
                fabs((double)gather(tube_gather_portable, &one, &medium, o, d, 2.0f).contribution -
                     truth);
            bent += fabs(
                (double)gather(tube_gather_portable, &adapts, &medium, o, d, 2.0f).contribution -
                truth);
        }
        tube_tree_clear(&one);
        tube_tree_clear(&adapts);
        tube_tree_clear(&many);
    }
    ENSURE(total > 0.0);
    ENSURE(plain > 0.1 * total);
    ENSURE(bent < 2e-3 * total);
}

static void tree_does_not_depend_on_threads(void) {
    static Tube tubes[TUBE_MAX];
    static const uint64_t counts[] = {1, 7, 8, 9, 64, 65, 513, TUBE_MAX};
    uint64_t state = 5;
    for (size_t n = 0; n < sizeof counts / sizeof counts[0]; ++n) {
        for (uint64_t i = 0; i < counts[n]; ++i)
            /* Half of them stand on top of others. */
            tubes[i] = i % 2 == 1 ? tubes[i - 1] : random_tube(&state, 0.1);
        TubeTree one = build(tubes, counts[n], 1);
        TubeTree many = build(tubes, counts[n], 5);
        ENSURE(one.node_count == many.node_count && one.patch_count == many.patch_count);
        ENSURE(memcmp(one.nodes, many.nodes, one.node_count * sizeof *one.nodes) == 0);
        ENSURE(memcmp(one.patches, many.patches, one.patch_count * sizeof *one.patches) == 0);
        tube_tree_clear(&one);
        tube_tree_clear(&many);
    }
}

/* ---- A field of tubes ------------------------------------------------------------------------ */

/* A lamp beside a ball whose walls reflect. */
static AmbScene *lit_ball(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    const AmbMaterial resin = shape_resin(1.5f, 0.3f, 0.1f, 0.2f);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &resin, &id), AMB_OK);
    Shape ball = shape_sphere(12, 24);
    const AmbMesh mesh = shape_mesh(&ball, "ball", true);
    shape_add(scene, &mesh, id, 1.0f, 0.0f, 0.0f, 0.0f);
    shape_free(&ball);
    AmbLight lamp;
    amb_light_init(&lamp, AMB_LIGHT_POINT);
    lamp.position[0] = 3.0f;
    lamp.color[0] = lamp.color[1] = lamp.color[2] = 10.0f;
    ENSURE_STATUS(amb_scene_add_light(scene, &lamp, &id), AMB_OK);
    shape_commit(scene);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

/* What walls reflect counts as often as a segment says, and each gets what it would alone. */
static void reflected_light_is_weighed(void) {
    static const float excesses[] = {0.0f, -1.0f, 2.0f};
    AmbScene *scene = lit_ball();
    Job job;
    job_init(&job, 1);
    const FieldParams params = {.estimator = AMB_ESTIMATOR_TUBES, .light_bounces = 1};
    Field *field = NULL;
    ENSURE_STATUS(field_create(scene, NULL, &params, &job, &field), AMB_OK);
    uint64_t state = 23;
    double worst = 0.0, reflected = 0.0;
    for (int trial = 0; trial < 100; ++trial) {
        FieldSegment segments[3];
        FieldRadiance together[3], alone[3];
        const Vec3 p = random_point(&state, 0.5), d = random_direction(&state);
        for (int i = 0; i < 3; ++i)
            segments[i] =
                (FieldSegment){.o = p, .d = d, .length = 0.5f, .reflected_excess = excesses[i]};
        field_gather_many(field, segments, 3, 0, together);
        for (int i = 0; i < 3; ++i) {
            alone[i] = field_gather(field, &segments[i]);
            ENSURE(memcmp(&alone[i], &together[i], sizeof alone[i]) == 0);
            const double expected =
                (double)alone[0].radiance.g + (double)excesses[i] * (double)alone[0].reflected.g;
            worst = test_worse(worst, fabs((double)alone[i].radiance.g - expected) /
                                          ((double)alone[0].radiance.g + 1e-6));
        }
        ENSURE(alone[1].reflected.g == 0.0f);
        reflected += (double)alone[0].reflected.g;
    }
    ENSURE(reflected > 0.0);
    ENSURE_NEAR(worst, 0.0, 1e-4);
    field_destroy(field);
    amb_scene_destroy(scene);
}

void test_tubes(void);

void test_tubes(void) {
    RUN(one_tube_matches_brute_force);
    RUN(a_square_of_light_is_exact);
    RUN(straight_light_is_gathered_from_beyond);
    RUN(tree_loses_no_tube);
    RUN(gather_variants_agree_bit_for_bit);
    RUN(rays_do_not_depend_on_each_other);
    RUN(avx512_agrees);
    RUN(patches_share_corners);
    RUN(bent_tubes_are_quartered);
    RUN(tree_does_not_depend_on_threads);
    RUN(reflected_light_is_weighed);
}
