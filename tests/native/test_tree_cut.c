/* SPDX-License-Identifier: GPL-3.0-or-later
 * Double and multiple scattering from a cut of volume samples: its parts against closed forms and
 * moments, the whole in a medium without end. */
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "field/scatter/ball_mean.h"
#include "field/scatter/propagator.h"
#include "field/scatter/tree_cut.h"
#include "field/scatter/volume_tree.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

static Job job_of(uint32_t threads) {
    Job job;
    job_init(&job, threads);
    return job;
}

/* ---- Balls ----------------------------------------------------------------------------------- */

/* Cones of rays from the eye: along each, the chord, the integral of the distance, the cosine. */
static void light_of_balls(void) {
    enum { CONES = 20000, PLACES = 19 };
    const double radius = 0.5, volume = 4.0 / 3.0 * PI * pow(radius, 3.0);
    for (int place = 0; place < PLACES; ++place) {
        const double d = 0.02 * pow(1.37, place);
        double inverse2 = 0.0, inverse = 0.0, along = 0.0;
        const double least = d > radius ? sqrt(1.0 - radius * radius / (d * d)) : -1.0;
        for (int i = 0; i < CONES; ++i) {
            const double step = (1.0 - least) / CONES, c = least + (i + 0.5) * step;
            const double root = sqrt(radius * radius - d * d * (1.0 - c * c));
            const double far = d * c + root, near = d > radius ? d * c - root : 0.0;
            inverse2 += 2.0 * PI * step * (far - near) / volume;
            inverse += PI * step * (far * far - near * near) / volume;
            along += 2.0 * PI * step * c * (far - near) / volume;
        }
        const BallMean mean = ball_mean((float)d, (float)radius);
        ENSURE_NEAR((double)mean.inverse2 / inverse2, 1.0, 1e-4);
        ENSURE_NEAR((double)mean.inverse / inverse, 1.0, 1e-4);
        ENSURE_NEAR((double)mean.coherence, along / inverse2, 1e-4);
    }
}

/* ---- The table ------------------------------------------------------------------------------- */

static PropagatorParams one_lobe(float albedo, float g, float tau_max) {
    return (PropagatorParams){
        .albedo = albedo, .lobe_count = 1, .shares = {1.0f}, .g = {g}, .tau_max = tau_max};
}

static Propagator table_of(const PropagatorParams *params, uint32_t threads) {
    Propagator table;
    Job job = job_of(threads);
    ENSURE_STATUS(propagator_build(params, &job, &table), AMB_OK);
    return table;
}

/* Isotropic media, by Fourier's transform: a flight is A = atan(k) / k, so that the third and
 * later scatterings are albedo^3 A^2 / (1 - albedo A) / (4 pi). The slowly decaying part of A^2,
 * (pi/2)^2 / (k^2 + 1), is transformed by hand. */
static double isotropic(double albedo, double tau) {
    enum { STEPS = 60000 };
    const double end = 600.0, step = end / STEPS;
    double sum = 0.0;
    for (int i = 1; i < STEPS; ++i) {
        const double k = i * step, a = atan(k) / k;
        const double f = k * a * a / (1.0 - albedo * a) - 0.25 * PI * PI * k / (k * k + 1.0);
        sum += (i % 2 == 1 ? 4.0 : 2.0) * f * sin(k * tau);
    }
    sum = sum * step / 3.0 + 0.25 * PI * PI * 0.5 * PI * exp(-tau);
    return pow(albedo, 3.0) / (4.0 * PI) * sum / (2.0 * PI * PI * tau);
}

static void isotropic_table(void) {
    static const struct {
        float albedo;
        double tolerance;
    } cases[] = {{0.5f, 0.03}, {0.95f, 0.03}, {0.9995f, 0.06}};
    for (int c = 0; c < 3; ++c) {
        const PropagatorParams params = one_lobe(cases[c].albedo, 0.0f, 20.0f);
        Propagator table = table_of(&params, 1);
        double mean = 0.0;
        enum { PLACES = 12 };
        for (int i = 0; i < PLACES; ++i) {
            const double tau = 0.1 * pow(60.0, i / (PLACES - 1.0));
            const double ratio = (double)propagator_at(&table, (float)tau, 0.3f, 0.1f, 0.2f, 1.0f) /
                                 (tau * isotropic((double)cases[c].albedo, tau));
            ENSURE_NEAR(ratio, 1.0, 2.0 * cases[c].tolerance);
            mean += ratio / PLACES;
        }
        ENSURE_NEAR(mean, 1.0, cases[c].tolerance);
        propagator_clear(&table);
    }
}

/* Integrals of the table over places and directions: of its value, the cosine of the direction to
 * the beam's, and the place along the beam. */
static void moments(const Propagator *table, double tau_max, double out[3]) {
    enum { RADII = 60, IN = 30, OUT = 30, AZIMUTHS = 16 };
    memset(out, 0, 3 * sizeof *out);
    for (int i = 0; i < RADII; ++i) {
        const double low = tau_max * pow((double)i / RADII, 3.0);
        const double high = tau_max * pow((i + 1.0) / RADII, 3.0), tau = 0.5 * (low + high);
        for (int a = 0; a < IN; ++a)
            for (int b = 0; b < OUT; ++b)
                for (int f = 0; f < AZIMUTHS; ++f) {
                    /* Even in the sine of half the angle, as are the table's nodes. */
                    const double ha = (a + 0.5) / IN, hb = (b + 0.5) / OUT;
                    const double ca = 1.0 - 2.0 * ha * ha, cb = 1.0 - 2.0 * hb * hb;
                    const double cf = cos(PI * (f + 0.5) / AZIMUTHS);
                    const double measure = 2.0 * PI * tau * (high - low) * (4.0 * ha / IN) *
                                           (4.0 * hb / OUT) * (2.0 * PI / AZIMUTHS);
                    const double value =
                        measure * (double)propagator_at(table, (float)tau, (float)ca, (float)cb,
                                                        (float)cf, 1.0f);
                    const double sine = sqrt((1.0 - ca * ca) * (1.0 - cb * cb));
                    out[0] += value;
                    out[1] += value * (ca * cb + sine * cf);
                    out[2] += value * tau * ca;
                }
    }
}

/* Power, direction and place of all orders from the third on are geometric series. */
static void forward_table(void) {
    static const float g[] = {0.0f, 0.85f, -0.4f};
    for (int c = 0; c < 3; ++c) {
        const double a = 0.7, x = (double)g[c];
        const PropagatorParams params = one_lobe((float)a, g[c], 40.0f);
        Propagator table = table_of(&params, 1);
        double found[3], place = 0.0;
        moments(&table, 40.0, found);
        for (int n = 3; n < 200; ++n)
            for (int j = 1; j < n; ++j)
                place += pow(a, n) * pow(x, j);
        const double power = a * a * a / (1.0 - a);
        ENSURE_NEAR(found[0] / power, 1.0, 0.03);
        ENSURE_NEAR(found[1] / power, pow(a * x, 3.0) / (1.0 - a * x) / power, 0.03);
        ENSURE_NEAR(found[2] / power, place / power, 0.06);
        propagator_clear(&table);
    }
}

/* order_max leaves out what comes later: two terms of the series remain. */
static void limited_table(void) {
    PropagatorParams params = one_lobe(0.9f, 0.0f, 30.0f);
    params.order_max = 4;
    Propagator table = table_of(&params, 1);
    double found[3];
    moments(&table, 30.0, found);
    ENSURE_NEAR(found[0] / (pow(0.9, 3.0) + pow(0.9, 4.0)), 1.0, 0.02);
    propagator_clear(&table);
}

static void table_of_threads(void) {
    const PropagatorParams params = one_lobe(0.6f, 0.8f, 5.0f);
    Propagator one = table_of(&params, 1), three = table_of(&params, 3);
    ENSURE(propagator_bytes(&one) == propagator_bytes(&three));
    const uint64_t bytes = propagator_bytes(&one) / 2;
    ENSURE(memcmp(one.values, three.values, bytes) == 0);
    propagator_clear(&one);
    propagator_clear(&three);
}

/* ---- In a medium without end ------------------------------------------------------------------
 */

/* A point of one watt in the middle of a large sphere of index 1, built for tracing. */
static AmbScene *endless(float radius, float albedo, float g) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    const AmbMaterial material = shape_resin(1.0f, albedo, 1.0f - albedo, g);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    Shape shape = shape_sphere(48, 96);
    const AmbMesh mesh = shape_mesh(&shape, "sphere", true);
    shape_add(scene, &mesh, id, radius, 0.0f, 0.0f, 0.0f);
    shape_free(&shape);
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_POINT);
    for (int c = 0; c < 3; ++c)
        light.color[c] = (float)(1.0 / (4.0 * PI));
    light.radius = 0.0f;
    ENSURE_STATUS(amb_scene_add_light(scene, &light, &id), AMB_OK);
    shape_commit(scene);
    Job job = job_of(1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

static TreeCut *cut_of(const AmbScene *scene, uint64_t samples, uint32_t threads) {
    const TreeCutParams params = {.light = {.seed = 1}, .sample_count = samples};
    Job job = job_of(threads);
    TreeCut *cut = NULL;
    ENSURE_STATUS(tree_cut_create(scene, &params, &job, &cut), AMB_OK);
    return cut;
}

/* sum over m >= 2 of albedo^m A^(m+1): the fluence of light that scattered twice and more, by
 * radius. */
static double late_fluence(double albedo, double r) {
    enum { STEPS = 8000 };
    const double end = 80.0, step = end / STEPS;
    double sum = 0.0;
    for (int i = 1; i < STEPS; ++i) {
        const double k = i * step, a = atan(k) / k;
        const double f = k * a * a * a / (1.0 - albedo * a);
        sum += (i % 2 == 1 ? 4.0 : 2.0) * f * sin(k * r);
    }
    return albedo * albedo * sum * step / 3.0 / (2.0 * PI * PI * r);
}

/* method of the reference numbers: the camera at (-2, 0.5), looking along +x. */
static void infinite_medium(void) {
    const double albedo = 0.8;
    AmbScene *scene = endless(16.0f, (float)albedo, 0.0f);
    TreeCut *cut = cut_of(scene, 1 << 17, 1);
    const FieldSegment segment = {{-2.0f, 0.5f, 0.0f}, {1, 0, 0}, 17.0f, 0, 0, 0.0f,
                                  {0, 0, 0},           NULL};
    const TreeCutRadiance found = tree_cut_gather(cut, &segment);
    double more = 0.0;
    enum { STEPS = 150 };
    for (int i = 0; i < STEPS; ++i) {
        const double t = 15.0 * (i + 0.5) / STEPS;
        more += 15.0 / STEPS * exp(-t) * albedo / (4.0 * PI) *
                late_fluence(albedo, sqrt(0.25 + (t - 2.0) * (t - 2.0)));
    }
    ENSURE_NEAR((double)found.twice.g / (0.00245407 * albedo * albedo), 1.0, 0.03);
    ENSURE_NEAR((double)found.more.g / more, 1.0, 0.03);
    tree_cut_destroy(cut);
    amb_scene_destroy(scene);
}

/* ---- The cut --------------------------------------------------------------------------------- */

static bool is_same(Rgb a, Rgb b) {
    return a.r == b.r && a.g == b.g && a.b == b.b;
}

static void threads_do_not_matter(void) {
    AmbScene *scene = endless(4.0f, 0.7f, 0.6f);
    TreeCut *one = cut_of(scene, 1 << 14, 1), *three = cut_of(scene, 1 << 14, 3);
    uint64_t state = 3;
    for (int i = 0; i < 20; ++i) {
        const Vec3 d = sample_cap(
            (Sample2){(float)test_uniform(&state, 0.0, 1.0), (float)test_uniform(&state, 0.0, 1.0)},
            2.0f);
        const FieldSegment segment = {{0.3f, -0.2f, 1.0f}, d, 2.5f, 0, 0, 0.0f, {0, 0, 0}, NULL};
        const TreeCutRadiance a = tree_cut_gather(one, &segment);
        const TreeCutRadiance b = tree_cut_gather(three, &segment);
        ENSURE(a.twice.r > 0.0f && a.more.r > 0.0f);
        ENSURE(is_same(a.twice, b.twice) && is_same(a.more, b.more));
    }
    tree_cut_destroy(one);
    tree_cut_destroy(three);
    amb_scene_destroy(scene);
}

/* A disc of opaque stuff throws a shadow on double scattering; the table knows nothing of it. */
static void walls_block(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbMaterial material = shape_resin(1.0f, 0.8f, 0.2f, 0.0f);
    uint32_t resin = 0, opaque = 0, id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &resin), AMB_OK);
    amb_material_init(&material);
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &opaque), AMB_OK);
    Shape sphere = shape_sphere(48, 96), plane = shape_plane();
    const AmbMesh body = shape_mesh(&sphere, "sphere", true);
    const AmbMesh wall = shape_mesh(&plane, "wall", false);
    shape_add(scene, &body, resin, 4.0f, 0.0f, 0.0f, 0.0f);
    shape_add(scene, &wall, opaque, 8.0f, 0.0f, 0.0f, 1.0f);
    shape_free(&sphere);
    shape_free(&plane);
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_POINT);
    light.radius = 0.0f;
    ENSURE_STATUS(amb_scene_add_light(scene, &light, &id), AMB_OK);
    shape_commit(scene);
    Job job = job_of(1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    TreeCut *cut = cut_of(scene, 1 << 13, 1);
    const FieldSegment behind = {{-1.0f, 0.0f, 1.5f}, {1, 0, 0}, 2.0f, 0, 0, 0.0f, {0, 0, 0}, NULL};
    const FieldSegment before = {{-1.0f, 0.0f, 0.5f}, {1, 0, 0}, 2.0f, 0, 0, 0.0f, {0, 0, 0}, NULL};
    ENSURE(rgb_max(tree_cut_gather(cut, &behind).twice) == 0.0f);
    ENSURE(rgb_max(tree_cut_gather(cut, &behind).more) > 0.0f);
    ENSURE(rgb_min(tree_cut_gather(cut, &before).twice) > 0.0f);
    tree_cut_destroy(cut);
    amb_scene_destroy(scene);
}

static void failures_leave_nothing(void) {
    AmbScene *scene = endless(4.0f, 0.5f, 0.0f);
    const TreeCutParams params = {.light = {.seed = 1}, .sample_count = 2000, .order_max = 3};
    Job job = job_of(1);
    TreeCut *cut = NULL;
    int calls = 0; /* until one in which no allocation failed */
    for (AmbStatus status = AMB_OUT_OF_MEMORY; status != AMB_OK && calls < 100; ++calls) {
        memory_fail_after(calls);
        status = tree_cut_create(scene, &params, &job, &cut);
        memory_fail_after(-1);
        ENSURE(status == AMB_OUT_OF_MEMORY || status == AMB_OK);
        ENSURE((status == AMB_OK) == (cut != NULL));
    }
    ENSURE(calls > 12 && calls < 100);
    tree_cut_destroy(cut);
    cut = NULL;
    atomic_store(&job.cancelled, true);
    ENSURE_STATUS(tree_cut_create(scene, &params, &job, &cut), AMB_CANCELLED);
    ENSURE(cut == NULL);
    amb_scene_destroy(scene);
}

void test_tree_cut(void);
void test_tree_cut(void) {
    RUN(light_of_balls);
    RUN(isotropic_table);
    RUN(forward_table);
    RUN(limited_table);
    RUN(table_of_threads);
    RUN(infinite_medium);
    RUN(threads_do_not_matter);
    RUN(walls_block);
    RUN(failures_leave_nothing);
}
