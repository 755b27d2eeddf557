/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light on opaque surfaces: the tree of kernels against a plain sum, flux against the integral of
 * the irradiance and against what lamps send, the same bits for any number of threads, and failures
 * on the way. */
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "field/caustics/caustic_gather.h"
#include "field/caustics/caustics.h"
#include "field/caustics/neighbours.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

static float uniform(uint64_t *state, double from, double to) {
    return (float)test_uniform(state, from, to);
}

/* ---- The tree -------------------------------------------------------------------------------- */

static CausticPhoton random_photon(uint64_t *state) {
    const Sample2 turn = {uniform(state, 0, 1), uniform(state, 0, 1)};
    CausticPhoton photon = {.p = vec3(uniform(state, -1, 1), uniform(state, -1, 1), 0)};
    photon.n = sample_cap(turn, 0.3f);
    Vec3 x, y;
    vec3_frame(photon.n, &x, &y);
    photon.u = vec3_scale(x, 1.0f / uniform(state, 0.01, 0.3));
    photon.v = vec3_scale(y, 1.0f / uniform(state, 0.01, 0.3));
    photon.peak = rgb(uniform(state, 0, 1), uniform(state, 0, 1), uniform(state, 0, 1));
    return photon;
}

/* No tree, in double. */
static double plain_sum(const CausticPhoton *photons, uint64_t count, Vec3 p, Vec3 n) {
    double sum = 0.0;
    for (uint64_t i = 0; i < count; ++i) {
        const CausticPhoton *photon = &photons[i];
        const Vec3 x = vec3_sub(p, photon->p);
        const double a = (double)vec3_dot(x, photon->u), b = (double)vec3_dot(x, photon->v);
        const double r2 = a * a + b * b;
        const double axis = 1.0 / sqrt(fmin((double)vec3_dot(photon->u, photon->u),
                                            (double)vec3_dot(photon->v, photon->v)));
        if (r2 < 1.0 && (double)vec3_dot(n, photon->n) >= 0.5 &&
            fabs((double)vec3_dot(x, photon->n)) <= 0.5 * axis)
            sum += (double)photon->peak.g * (1.0 - r2);
    }
    return sum;
}

static void tree_is_a_sum(void) {
    static const uint64_t COUNTS[] = {1, 7, 8, 9, 63, 1000, 4097};
    for (size_t c = 0; c < sizeof COUNTS / sizeof COUNTS[0]; ++c) {
        const uint64_t count = COUNTS[c];
        uint64_t state = 11 + c;
        CausticPhoton *photons = memory_alloc_array(count, sizeof *photons);
        CausticPhoton *copy = memory_alloc_array(count, sizeof *copy);
        for (uint64_t i = 0; i < count; ++i)
            photons[i] = random_photon(&state);
        /* Some at one place: their order must not matter to who ends where. */
        for (uint64_t i = 1; i < count / 4; ++i)
            photons[i].p = photons[0].p;
        memcpy(copy, photons, count * sizeof *photons);
        Job job;
        job_init(&job, 2);
        CausticTree tree;
        ENSURE_STATUS(caustic_tree_build(photons, count, &job, &tree), AMB_OK);
        memory_free(photons);
        double worst = 0.0, most = 0.0;
        for (int i = 0; i < 300; ++i) {
            const Vec3 p = vec3(uniform(&state, -1, 1), uniform(&state, -1, 1), 0);
            const Vec3 n = vec3(0, 0, i % 7 == 0 ? -1.0f : 1.0f);
            const double expected = plain_sum(copy, count, p, n);
            const Rgb found = caustic_gather_portable(&tree, p, n, 0.0f);
            const Rgb selected = caustic_gather_select()(&tree, p, n, 0.0f);
            ENSURE(memcmp(&found, &selected, sizeof found) == 0);
            worst = test_worse(worst, fabs((double)found.g - expected));
            most = fmax(most, expected);
        }
        /* A photon whose plane is just as far as counts may fall on either side. */
        ENSURE_NEAR(worst, 0.0, 2e-6 * (1.0 + most));
        ENSURE(count < 1000 || most > 0.0);
        caustic_tree_clear(&tree);
        memory_free(copy);
    }
}

/* ---- Scenes ---------------------------------------------------------------------------------- */

/* A glass ball half a metre above a floor, in the sun. */
static AmbScene *ball_on_floor(float angle) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    const AmbMaterial glass = shape_resin(1.5f, 0.1f, 0.2f, 0.0f);
    AmbMaterial grey;
    amb_material_init(&grey);
    uint32_t glass_id = 0, grey_id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &glass, &glass_id), AMB_OK);
    ENSURE_STATUS(amb_scene_add_material(scene, &grey, &grey_id), AMB_OK);
    Shape ball = shape_sphere(32, 64), plane = shape_plane();
    const AmbMesh ball_mesh = shape_mesh(&ball, "ball", true);
    const AmbMesh plane_mesh = shape_mesh(&plane, "floor", false);
    shape_add(scene, &ball_mesh, glass_id, 1.0f, 0.1f, 0.2f, 1.5f);
    shape_add(scene, &plane_mesh, grey_id, 20.0f, 0.0f, 0.0f, 0.0f);
    shape_free(&ball);
    shape_free(&plane);
    AmbLight sun;
    amb_light_init(&sun, AMB_LIGHT_SUN);
    sun.direction[0] = 0.2f;
    sun.direction[2] = -1.0f;
    sun.color[0] = sun.color[1] = sun.color[2] = 1.0f;
    sun.angle = angle;
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_light(scene, &sun, &id), AMB_OK);
    shape_commit(scene);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

static CausticParams params(uint64_t rays) {
    return (CausticParams){
        .light = {.ray_count = rays, .bounces = 2, .follows_through = true, .lands = true},
        .overlap = 8.0f};
}

static CausticMap *create(const AmbScene *scene, uint64_t rays, uint32_t threads) {
    Job job;
    job_init(&job, threads);
    const CausticParams given = params(rays);
    CausticMap *map = NULL;
    ENSURE_STATUS(caustics_create(scene, &given, &job, &map), AMB_OK);
    return map;
}

/* Integral over the square of the half edge b around the origin, less that of a, W. */
static double integrate(const CausticMap *map, double a, double b) {
    enum { EDGE = 800 };
    double sum = 0.0;
    for (int j = 0; j < EDGE; ++j)
        for (int i = 0; i < EDGE; ++i) {
            const double x = b * (2.0 * (i + 0.5) / EDGE - 1.0);
            const double y = b * (2.0 * (j + 0.5) / EDGE - 1.0);
            if (fabs(x) > a || fabs(y) > a)
                sum +=
                    (double)caustics_irradiance(map, vec3((float)x, (float)y, 0), vec3(0, 0, 1), 0)
                        .g;
        }
    return sum * 4.0 * b * b / ((double)EDGE * EDGE);
}

/* The kernels' integral is the flux that landed: nothing is lost or made between. */
static void flux_is_kept(void) {
    for (int soft = 0; soft < 2; ++soft) {
        AmbScene *scene = ball_on_floor(soft ? 0.1f : 0.0f);
        CausticMap *map = create(scene, 1 << 15, 2);
        const CausticAccount account = caustics_account(map);
        const double sum =
            integrate(map, 0.0, 1.0) + integrate(map, 1.0, 4.0) + integrate(map, 4.0, 20.0);
        ENSURE(account.photon_count > 1 << 15);
        ENSURE_NEAR(sum / account.landed[1], 1.0, 2e-3);
        /* Most of what falls on the ball, pi, less what it absorbs and reflects upwards. */
        ENSURE(account.landed[1] > 0.5 * PI && account.landed[1] < PI);
        ENSURE_NEAR(caustics_irradiance(map, vec3(0, 0, 0), vec3(0, 0, -1), 0).g, 0.0, 0.0);
        caustics_destroy(map);
        amb_scene_destroy(scene);
    }
}

/* The bounds of kernels' axes and of their ratio move no flux: footprints of any shape, those of
 * folds that are a line or a point too, add up to what landed. */
static void bounds_of_kernels_keep_the_flux(void) {
    enum { COUNT = 300, EDGE = 200 };
    uint64_t state = 3;
    double worst = 0.0, longest = 0.0;
    int point_count = 0;
    for (int i = 0; i < COUNT; ++i) {
        const float turn = uniform(&state, 0.0, 2.0 * PI);
        const float a = powf(10.0f, uniform(&state, -4.0, 3.0));
        const float b = i % 5 == 0 ? 0.0f : a * powf(10.0f, uniform(&state, -5.0, 0.0));
        LightLanding landing = {.n = {0, 0, 1}, .flux = {2, 2, 2}};
        landing.footprint[0] = vec3(a * cosf(turn), a * sinf(turn), 0);
        landing.footprint[1] = vec3(-b * sinf(turn), b * cosf(turn), 0);
        if (i % 3 == 0)
            landing.footprint[TANGENT_LATTICE] = vec3(0.1f, 0, 0);
        const CausticPhoton photon = caustics_kernel(&landing, 8.0f, 1.0f);
        CausticPhoton list = photon;
        const double u = 1.0 / (double)vec3_length(photon.u),
                     v = 1.0 / (double)vec3_length(photon.v);
        longest = fmax(longest, u / v);
        point_count += v < 0.006 ? 1 : 0;
        const Vec3 along = vec3_scale(photon.u, (float)(u * u)),
                   across = vec3_scale(photon.v, (float)(v * v));
        Job job;
        job_init(&job, 1);
        CausticTree tree;
        ENSURE_STATUS(caustic_tree_build(&list, 1, &job, &tree), AMB_OK);
        double sum = 0.0;
        for (int k = 0; k < EDGE; ++k)
            for (int j = 0; j < EDGE; ++j) {
                const float s = 2.2f * ((float)j + 0.5f) / EDGE - 1.1f;
                const float t = 2.2f * ((float)k + 0.5f) / EDGE - 1.1f;
                const Vec3 p = vec3_madd(vec3_scale(along, s), t, across);
                sum += (double)caustic_gather_select()(&tree, p, vec3(0, 0, 1), 0.0f).g;
            }
        sum *= 2.2 * 2.2 * u * v / (double)(EDGE * EDGE);
        worst = test_worse(worst, fabs(sum / 2.0 - 1.0));
        caustic_tree_clear(&tree);
    }
    /* Bounds act, and what they leave is the flux. */
    ENSURE(longest > 100.0 && longest < 129.0 && point_count > 10);
    ENSURE_NEAR(worst, 0.0, 1e-4);
}

/* What one part says is noise about the whole: over the parts the mean is what it was undivided. */
static void parts_add_up(void) {
    AmbScene *scene = ball_on_floor(0.05f);
    Job job;
    job_init(&job, 2);
    CausticParams divided = params(20000);
    divided.part_count = 4;
    CausticMap *parts = NULL, *whole = create(scene, 20000, 2);
    ENSURE_STATUS(caustics_create(scene, &divided, &job, &parts), AMB_OK);
    ENSURE(caustics_account(parts).photon_count == caustics_account(whole).photon_count);
    const Vec3 n = vec3(0, 0, 1);
    uint64_t state = 5;
    double worst = 0.0, all = 0.0, differ = 0.0;
    for (int i = 0; i < 2000; ++i) {
        const Vec3 p = vec3(uniform(&state, -1, 1), uniform(&state, -1, 1), 0.0f);
        const double expected = (double)caustics_irradiance(whole, p, n, 0).g;
        double mean = 0.0;
        for (uint32_t k = 1; k <= 4; ++k) {
            const double part = (double)caustics_irradiance(parts, p, n, k).g;
            mean += 0.25 * part;
            differ += fabs(part - expected) / (4 * 2000);
        }
        all += expected / 2000;
        worst = test_worse(worst, fabs(mean - expected));
        worst = test_worse(worst, fabs((double)caustics_irradiance(parts, p, n, 0).g - expected));
    }
    ENSURE_NEAR(worst / all, 0.0, 1e-4);
    ENSURE(differ > 0.05 * all);
    caustics_destroy(parts);
    caustics_destroy(whole);
    amb_scene_destroy(scene);
}

/* Places that are chosen and rays that meet them by chance bring all light between them: integrals
 * over the square of the half edge b. */
static void places_and_rays_share_the_light(void) {
    enum { EDGE = 600, CHOICES = 200000 };
    const double b = 1.0;
    AmbScene *scene = ball_on_floor(0.05f);
    Job job;
    job_init(&job, 2);
    CausticParams divided = params(20000);
    divided.part_count = 2;
    CausticMap *map = NULL;
    ENSURE_STATUS(caustics_create(scene, &divided, &job, &map), AMB_OK);
    const Vec3 n = vec3(0, 0, 1);
    for (uint32_t part = 0; part <= 2; ++part) {
        const float density = part == 0 ? 0.3f : 30.0f;
        double all = 0.0, by_rays = 0.0, chosen = 0.0, square = 0.0;
        for (int j = 0; j < EDGE; ++j)
            for (int i = 0; i < EDGE; ++i) {
                const double x = b * (2.0 * (i + 0.5) / EDGE - 1.0);
                const double y = b * (2.0 * (j + 0.5) / EDGE - 1.0);
                const Vec3 p = vec3((float)x, (float)y, 0.0f);
                const double area = 4.0 * b * b / ((double)EDGE * EDGE);
                all += area * (double)caustics_irradiance(map, p, n, part).g;
                by_rays += area * (double)caustics_irradiance_by_rays(map, p, n, part, density).g;
            }
        uint64_t state = 7 + part;
        for (int i = 0; i < CHOICES; ++i) {
            const Sample2 choice = {uniform(&state, 0, 1), uniform(&state, 0, 1)};
            const Sample2 place = {uniform(&state, 0, 1), uniform(&state, 0, 1)};
            CausticPoint point;
            ENSURE(caustics_choose(map, part, choice, place, &point));
            ENSURE_NEAR(point.p.z, 0.0, 1e-5);
            if (fabsf(point.p.x) > (float)b || fabsf(point.p.y) > (float)b)
                continue;
            const double one =
                (double)(point.flux.g * point.density / (point.density + density)) / CHOICES;
            chosen += one;
            square += one * one;
        }
        ENSURE(by_rays > 0.02 * all && chosen > 0.02 * all);
        ENSURE_NEAR((by_rays + chosen) / all, 1.0, 2e-3 + 4.0 * sqrt(square) / all);
        ENSURE_NEAR(caustics_irradiance_by_rays(map, vec3(0, 0, 0), n, part, INFINITY).g,
                    (double)caustics_irradiance(map, vec3(0, 0, 0), n, part).g, 0.0);
    }
    caustics_destroy(map);
    amb_scene_destroy(scene);
}

static void threads_do_not_matter(void) {
    AmbScene *scene = ball_on_floor(0.05f);
    CausticMap *one = create(scene, 20000, 1), *three = create(scene, 20000, 3);
    const CausticAccount a = caustics_account(one), b = caustics_account(three);
    ENSURE(memcmp(&a, &b, sizeof a) == 0);
    bool is_same = true;
    uint64_t state = 3;
    for (int i = 0; i < 2000; ++i) {
        const Vec3 p = vec3(uniform(&state, -2, 2), uniform(&state, -2, 2), 0.0f);
        const Rgb x = caustics_irradiance(one, p, vec3(0, 0, 1), 0);
        const Rgb y = caustics_irradiance(three, p, vec3(0, 0, 1), 0);
        is_same = is_same && memcmp(&x, &y, sizeof x) == 0;
    }
    ENSURE(is_same);
    caustics_destroy(one);
    caustics_destroy(three);
    amb_scene_destroy(scene);
}

/* ---- Glow ------------------------------------------------------------------------------------ */

/* A lamp in the middle of a ball of a medium that absorbs nothing, 1.5 m above a floor, or in the
 * middle of an opaque box of half edge 3 m. */
static AmbScene *lamp_in_ball(float ior, float sigma_s, bool is_boxed) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    const AmbMaterial milk = shape_resin(ior, sigma_s, 0.0f, 0.0f);
    AmbMaterial grey;
    amb_material_init(&grey);
    uint32_t milk_id = 0, grey_id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &milk, &milk_id), AMB_OK);
    ENSURE_STATUS(amb_scene_add_material(scene, &grey, &grey_id), AMB_OK);
    Shape ball = shape_sphere(64, 128), walls = is_boxed ? shape_box() : shape_plane();
    const AmbMesh ball_mesh = shape_mesh(&ball, "ball", true);
    const AmbMesh wall_mesh = shape_mesh(&walls, "walls", false);
    shape_add(scene, &ball_mesh, milk_id, 1.0f, 0.0f, 0.0f, 1.5f);
    shape_add(scene, &wall_mesh, grey_id, is_boxed ? 3.0f : 40.0f, 0.0f, 0.0f,
              is_boxed ? 1.5f : 0.0f);
    shape_free(&ball);
    shape_free(&walls);
    AmbLight lamp;
    amb_light_init(&lamp, AMB_LIGHT_POINT);
    lamp.position[2] = 1.5f;
    lamp.color[0] = lamp.color[1] = lamp.color[2] = 1.0f;
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_light(scene, &lamp, &id), AMB_OK);
    shape_commit(scene);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

static CausticMap *create_glow(const AmbScene *scene, uint64_t photons, uint32_t parts,
                               uint32_t threads) {
    Job job;
    job_init(&job, threads);
    const CausticParams given = {.glow = {.photon_count = photons, .light_bounces = 64},
                                 .part_count = parts};
    CausticMap *map = NULL;
    ENSURE_STATUS(caustics_create(scene, &given, &job, &map), AMB_OK);
    return map;
}

/* The glow of a part of the photons that walk for cells. */
static CausticMap *create_traced(const AmbScene *scene, uint64_t photons, float part,
                                 uint32_t threads) {
    Job job;
    job_init(&job, threads);
    const ScatterParams cells = {
        .photon_count = photons, .light_bounces = 64, .landing_part = part};
    Scatter *scatter = NULL;
    ENSURE_STATUS(scatter_create(scene, &cells, &job, &scatter), AMB_OK);
    const CausticParams given = {.glow = {.photon_count = (uint64_t)(part * (float)photons)},
                                 .traced = scatter,
                                 .part_count = 2};
    CausticMap *map = NULL;
    ENSURE_STATUS(caustics_create(scene, &given, &job, &map), AMB_OK);
    scatter_destroy(scatter);
    return map;
}

/* In a closed box all light lands. Of a lamp's 4 pi what has not scattered leaves after one, two,
 * .. stretches to the boundary and back, R being reflected of it each time; the rest has. */
static void all_that_scattered_lands(void) {
    static const struct {
        float ior, sigma_s;
    } cases[] = {{1.0f, 0.3f}, {1.0f, 4.0f}, {1.5f, 0.3f}, {1.5f, 8.0f}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; ++i) {
        AmbScene *scene = lamp_in_ball(cases[i].ior, cases[i].sigma_s, true);
        CausticMap *map = create_glow(scene, 1 << 15, 1, 2);
        const double r = pow(((double)cases[i].ior - 1.0) / ((double)cases[i].ior + 1.0), 2);
        const double out = exp(-(double)cases[i].sigma_s);
        const double passed = out * (1.0 - r) / (1.0 - r * out * out);
        const CausticAccount account = caustics_account(map);
        ENSURE_NEAR(account.glow_landed[1] / (4.0 * PI * (1.0 - passed)), 1.0, 5e-3);
        ENSURE(account.landed[1] == 0.0);
        caustics_destroy(map);
        /* Half of the photons stand for all. */
        map = create_traced(scene, 1 << 15, 0.5f, 2);
        const CausticAccount traced = caustics_account(map);
        ENSURE_NEAR(traced.glow_landed[1] / (4.0 * PI * (1.0 - passed)), 1.0, 8e-3);
        ENSURE(traced.glow_ray_count == 1 << 14);
        ENSURE(traced.glow_photon_count >= account.glow_photon_count / 2);
        caustics_destroy(map);
        amb_scene_destroy(scene);
    }
}

/* Of light from the middle of a ball without reflections, that scatters alike to all sides: the
 * share that leaves after exactly one scattering, by the midpoint rule. */
static double once_scattered(double sigma) {
    enum { STEPS = 400 };
    double sum = 0.0;
    for (int i = 0; i < STEPS; ++i)
        for (int j = 0; j < STEPS; ++j) {
            const double r = (i + 0.5) / STEPS, mu = 2.0 * (j + 0.5) / STEPS - 1.0;
            const double left = sqrt(1.0 - r * r * (1.0 - mu * mu)) - r * mu;
            sum += sigma * exp(-sigma * (r + left)) / (STEPS * STEPS);
        }
    return sum;
}

/* Orders by themselves, in thick media, too, where the first is rare. */
static void orders_land_as_they_should(void) {
    static const float sigmas[] = {0.3f, 2.0f, 5.0f};
    for (int i = 0; i < 3; ++i) {
        AmbScene *scene = lamp_in_ball(1.0f, sigmas[i], true);
        Job job;
        job_init(&job, 2);
        const ScatterParams params = {.photon_count = 1 << 14};
        GlowLandings landings;
        ENSURE_STATUS(glow_trace(scene, &params, &job, &landings), AMB_OK);
        double once = 0.0, square = 0.0;
        for (uint64_t k = 0; k < landings.orders[0].count; ++k) {
            const double flux = (double)landings.orders[0].list[k].flux.g;
            once += flux;
            square += flux * flux;
        }
        const double expected = 4.0 * PI * once_scattered((double)sigmas[i]);
        ENSURE_NEAR(once / expected, 1.0, 2e-3 + 3.0 * sqrt(square) / expected);
        glow_clear(&landings);
        amb_scene_destroy(scene);
    }
}

static double glow_sum(const CausticMap *map, Vec3 p, Vec3 n, uint32_t part) {
    const CausticGlow glow = caustics_glow(map, p, n, part);
    return (double)glow.orders[0].g + (double)glow.orders[1].g + (double)glow.orders[2].g;
}

/* Over a wall of the box: kernels end where it does and lose nothing there, about. */
static void walls_get_what_lands(void) {
    enum { EDGE = 60 };
    AmbScene *scene = lamp_in_ball(1.0f, 1.0f, true);
    CausticMap *map = create_glow(scene, 1 << 14, 1, 2);
    double sum = 0.0, rim = 0.0, light = 0.0;
    for (int j = 0; j < EDGE; ++j)
        for (int i = 0; i < EDGE; ++i) {
            const double x = 6.0 * (i + 0.5) / EDGE - 3.0, y = 6.0 * (j + 0.5) / EDGE - 3.0;
            const double found = glow_sum(map, vec3((float)x, (float)y, -1.5f), vec3(0, 0, 1), 0) *
                                 36.0 / (EDGE * EDGE);
            sum += found;
            /* Light of a small lamp in the middle, per watt. */
            const double expected =
                3.0 / (4.0 * PI * pow(x * x + y * y + 9.0, 1.5)) * 36.0 / (EDGE * EDGE);
            if (fmax(fabs(x), fabs(y)) > 2.8) {
                rim += found;
                light += expected;
            }
        }
    const double landed = caustics_account(map).glow_landed[1];
    ENSURE_NEAR(sum / (landed / 6.0), 1.0, 0.03);
    /* Kernels neither end at the rim nor pile up there. */
    ENSURE_NEAR(rim / (light * landed), 1.0, 0.15);
    caustics_destroy(map);
    amb_scene_destroy(scene);
}

static void glow_parts_add_up(void) {
    AmbScene *scene = lamp_in_ball(1.3f, 1.0f, false);
    CausticMap *parts = create_glow(scene, 4000, 4, 1), *whole = create_glow(scene, 4000, 1, 3);
    ENSURE(caustics_account(parts).glow_photon_count == caustics_account(whole).glow_photon_count);
    const Vec3 n = vec3(0, 0, 1);
    uint64_t state = 5;
    double worst = 0.0, all = 0.0, differ = 0.0;
    for (int i = 0; i < 200; ++i) {
        const Vec3 p = vec3(uniform(&state, -2, 2), uniform(&state, -2, 2), 0.0f);
        const double expected = glow_sum(whole, p, n, 0);
        double mean = 0.0;
        for (uint32_t k = 1; k <= 4; ++k) {
            const double part = glow_sum(parts, p, n, k);
            mean += 0.25 * part;
            differ += fabs(part - expected) / (4 * 200);
        }
        all += expected / 200;
        worst = test_worse(worst, fabs(mean - expected));
        worst = test_worse(worst, fabs(glow_sum(parts, p, n, 0) - expected));
    }
    ENSURE_NEAR(worst / all, 0.0, 1e-4);
    ENSURE(differ > 0.01 * all);
    caustics_destroy(parts);
    caustics_destroy(whole);
    amb_scene_destroy(scene);
}

static void same_glow(CausticMap *one, CausticMap *three) {
    const CausticAccount a = caustics_account(one), b = caustics_account(three);
    ENSURE(memcmp(&a, &b, sizeof a) == 0);
    bool is_same = true;
    uint64_t state = 3;
    for (int i = 0; i < 500; ++i) {
        const Vec3 p = vec3(uniform(&state, -2, 2), uniform(&state, -2, 2), 0.0f);
        const CausticGlow x = caustics_glow(one, p, vec3(0, 0, 1), 0);
        const CausticGlow y = caustics_glow(three, p, vec3(0, 0, 1), 0);
        is_same = is_same && memcmp(&x, &y, sizeof x) == 0;
    }
    ENSURE(is_same);
    caustics_destroy(one);
    caustics_destroy(three);
}

static void glow_threads_do_not_matter(void) {
    AmbScene *scene = lamp_in_ball(1.3f, 5.0f, false);
    same_glow(create_glow(scene, 3000, 2, 1), create_glow(scene, 3000, 2, 3));
    same_glow(create_traced(scene, 3000, 0.7f, 1), create_traced(scene, 3000, 0.7f, 3));
    amb_scene_destroy(scene);
}

/* Against all of them. */
static void neighbours_are_the_nearest(void) {
    enum { COUNT = 700 };
    uint64_t state = 9;
    static Place places[COUNT];
    static Place sorted[COUNT];
    for (uint64_t i = 0; i < COUNT; ++i) {
        const Sample2 turn = {uniform(&state, 0, 1), uniform(&state, 0, 1)};
        places[i] = (Place){.p = vec3(uniform(&state, 0, 1), uniform(&state, 0, 3),
                                      i % 5 == 0 ? 0.0f : uniform(&state, 0, 0.2)),
                            .n = sample_cap(turn, 1.0f),
                            .id = i};
    }
    memcpy(sorted, places, sizeof sorted);
    neighbours_sort(sorted, COUNT);
    for (uint32_t i = 0; i < COUNT; i += 7) {
        const uint32_t rank = 1 + i % NEIGHBOURS_MAX;
        const float found = neighbours_distance(sorted, COUNT, &places[i], rank);
        uint32_t nearer = 0, as_near = 0;
        for (uint32_t k = 0; k < COUNT; ++k) {
            if (k == i || vec3_dot(places[k].n, places[i].n) < 0.5f)
                continue;
            const float distance = vec3_length(vec3_sub(places[k].p, places[i].p));
            nearer += distance < 0.99999f * found;
            as_near += distance < 1.00001f * found;
        }
        ENSURE(nearer == rank - 1 && as_near == rank);
    }
    ENSURE(isinf(neighbours_distance(sorted, 3, &places[0], NEIGHBOURS_MAX)));
}

static void failures_leave_nothing(void) {
    AmbScene *scene = ball_on_floor(0.0f);
    CausticParams given = params(500);
    given.glow = (ScatterParams){.photon_count = 500};
    CausticMap *map = NULL;
    AmbStatus status = AMB_OUT_OF_MEMORY;
    int failed = 0;
    for (int n = 0; n < 1000 && status != AMB_OK; ++n) {
        Job job;
        job_init(&job, 1);
        memory_fail_after(n);
        status = caustics_create(scene, &given, &job, &map);
        memory_fail_after(-1);
        failed += status == AMB_OUT_OF_MEMORY;
        ENSURE(status == AMB_OK || (status == AMB_OUT_OF_MEMORY && map == NULL));
    }
    ENSURE_STATUS(status, AMB_OK);
    ENSURE(failed > 5);
    caustics_destroy(map);
    Job job;
    job_init(&job, 1);
    atomic_store(&job.cancelled, true);
    ENSURE_STATUS(caustics_create(scene, &given, &job, &map), AMB_CANCELLED);
    ENSURE(map == NULL);
    amb_scene_destroy(scene);
}

void test_caustics(void);
void test_caustics(void) {
    RUN(tree_is_a_sum);
    RUN(flux_is_kept);
    RUN(bounds_of_kernels_keep_the_flux);
    RUN(parts_add_up);
    RUN(places_and_rays_share_the_light);
    RUN(threads_do_not_matter);
    RUN(neighbours_are_the_nearest);
    RUN(all_that_scattered_lands);
    RUN(orders_land_as_they_should);
    RUN(walls_get_what_lands);
    RUN(glow_parts_add_up);
    RUN(glow_threads_do_not_matter);
    RUN(failures_leave_nothing);
}
