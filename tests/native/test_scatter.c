/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons and the cells that keep them: harmonics, lobes, depths and volumes against closed forms,
 * flux balance, a white furnace, light that is never negative, and media whose channels differ
 * against grey ones.
 */
#include <stdlib.h>
#include <string.h>

#include "base/memory.h"
#include "field/scatter/lobe.h"
#include "field/scatter/scatter.h"
#include "field/scatter/scatter_cells.h"
#include "light/light_batch.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;
enum { RAYS = 400 };

static Vec3 random_direction(uint64_t *state) {
    const Sample2 u = {(float)test_uniform(state, 0.0, 1.0), (float)test_uniform(state, 0.0, 1.0)};
    return sample_cap(u, 2.0f);
}

/* ---- Harmonics ------------------------------------------------------------------------------- */

static double legendre(uint32_t degree, double x) {
    double below = 1.0, p = degree == 0 ? 1.0 : x;
    for (uint32_t l = 2; l <= degree; ++l) {
        const double next = ((2.0 * l - 1.0) * x * p - (l - 1.0) * below) / l;
        below = p;
        p = next;
    }
    return p;
}

static void addition_theorem(void) {
    uint64_t state = 1;
    const Harmonics harmonics = harmonics_create(HARMONIC_DEGREE_MAX);
    double worst = 0.0;
    for (int i = 0; i < 200; ++i) {
        const Vec3 a = random_direction(&state), b = random_direction(&state);
        float ya[HARMONIC_COUNT_MAX] = {0}, yb[HARMONIC_COUNT_MAX] = {0};
        harmonics_evaluate(&harmonics, a, ya);
        harmonics_evaluate(&harmonics, b, yb);
        for (uint32_t l = 0, j = 0; l <= HARMONIC_DEGREE_MAX; ++l) {
            double sum = 0.0;
            for (; j < harmonic_count(l); ++j)
                sum += (double)ya[j] * (double)yb[j];
            const double expected =
                (2.0 * l + 1.0) / (4.0 * PI) * legendre(l, (double)vec3_dot(a, b));
            worst = test_worse(worst, fabs(sum - expected));
        }
    }
    ENSURE_NEAR(worst, 0.0, 5e-6);
}

/* ---- Lobes ----------------------------------------------------------------------------------- */

/* Nowhere negative, flux and mean cosine exact; and the plain sum where that is possible. */
static void lobes_are_positive(void) {
    const float gs[9] = {0.1f, 0.4f, -0.55f, 0.6f, 0.66f, -0.75f, 0.8f, 0.9f, 0.97f};
    for (int i = 0; i < 9; ++i) {
        const float g = gs[i];
        const uint32_t degree = lobe_degree(g);
        float c[HARMONIC_DEGREE_MAX + 1];
        const double forward = (double)lobe_coefficients(g, degree, c);
        ENSURE((forward > 0.0) == (g > 0.7f) && forward < 0.9);
        ENSURE_NEAR((double)c[0] + forward, 1.0, 1e-6);
        if (g < 0.95f)
            ENSURE_NEAR((double)c[1] + forward, g, 1e-5);
        double least = 1.0;
        for (int k = 0; k <= 5000; ++k) {
            double sum = 0.0;
            for (uint32_t l = 0; l <= degree; ++l)
                sum += (2.0 * l + 1.0) * (double)c[l] * legendre(l, k / 2500.0 - 1.0);
            least = fmin(least, sum);
        }
        ENSURE(least >= 0.0);
        for (uint32_t l = 2; l <= degree; ++l) {
            const double plain = pow((double)g, l);
            /* A kernel that is a square falls short; what goes straight on does not. */
            const bool has_square = g < -0.67f || g > 0.905f;
            ENSURE(has_square || fabs((double)c[l] + forward - plain) < 1e-4 + 0.05 * fabs(plain));
            ENSURE(fabs((double)c[l]) <= fabs(plain) + 1e-6);
        }
    }
}

/* The bound of sharpness moves no mean cosine where lobes are said to keep theirs, nor any flux. */
static void bound_of_lobes_is_said(void) {
    double worst = 0.0;
    for (int i = -99; i <= 99; ++i) {
        const float g = 0.01f * (float)i;
        const uint32_t degree = lobe_degree(g);
        float c[HARMONIC_DEGREE_MAX + 1] = {0};
        const double forward = (double)lobe_coefficients(g, degree, c);
        ENSURE_NEAR((double)c[0] + forward, 1.0, 1e-6);
        ENSURE(lobe_keeps_mean(g) == (i >= -88 && i <= 94));
        if (degree > 0 && lobe_keeps_mean(g))
            worst = test_worse(worst, fabs((double)c[1] + forward - (double)g));
    }
    ENSURE_NEAR(worst, 0.0, 1e-5);
}

/* ---- Scenes ---------------------------------------------------------------------------------- */

/* A scene of one body, which the shape is consumed for. */
static AmbScene *scene_of(Shape *shape, bool is_smooth, AmbMaterial material) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    const AmbMesh mesh = shape_mesh(shape, "body", is_smooth);
    shape_add(scene, &mesh, id, 1.0f, 0.0f, 0.0f, 0.0f);
    shape_free(shape);
    return scene;
}

/* Ready for tracing. */
static void build(AmbScene *scene) {
    shape_commit(scene);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
}

/* A unit sphere in a uniform world of radiance 1, built for tracing. */
static AmbScene *furnace(AmbMaterial material) {
    Shape shape = shape_sphere(48, 96);
    AmbScene *scene = scene_of(&shape, true, material);
    const float world[3] = {1, 1, 1};
    ENSURE_STATUS(amb_scene_set_world(scene, world), AMB_OK);
    build(scene);
    return scene;
}

static ScatterParams world_params(uint64_t photons) {
    return (ScatterParams){
        .photon_count = photons, .light_bounces = 64, .has_world = true, .seed = 1};
}

static Scatter *trace(const AmbScene *scene, const ScatterParams *params, uint32_t threads) {
    Job job;
    job_init(&job, threads);
    Scatter *scatter = NULL;
    ENSURE_STATUS(scatter_create(scene, params, &job, &scatter), AMB_OK);
    return scatter;
}

/* Mean over places and directions of the radiance that arrives at the boundary from inside. */
static ScatterRadiance mean_radiance(const AmbScene *scene, const Scatter *scatter) {
    uint64_t state = 5;
    ScatterRadiance sum = {.once = {0, 0, 0}};
    for (int i = 0; i < RAYS; ++i) {
        const Vec3 out = random_direction(&state);
        Vec3 d = random_direction(&state);
        Hit hit;
        ENSURE(scene_intersect(scene, vec3_scale(out, 1.5f), vec3_negate(out), INFINITY, &hit));
        const SurfacePoint surface = scene_surface(scene, &hit);
        if (vec3_dot(d, surface.ng) > 0.0f)
            d = vec3_negate(d);
        const Vec3 o = scene_leave(&surface, d);
        ENSURE(scene_intersect(scene, o, d, INFINITY, &hit));
        const FieldSegment segment = {o, d, hit.t, 0, 0, 0.0f, {0, 0, 0}, NULL};
        const ScatterRadiance radiance = scatter_gather(scatter, &segment, rgb(0, 0, 0), NULL);
        sum.once = rgb_add(sum.once, rgb_scale(radiance.once, 1.0f / RAYS));
        sum.twice = rgb_add(sum.twice, rgb_scale(radiance.twice, 1.0f / RAYS));
        sum.more = rgb_add(sum.more, rgb_scale(radiance.more, 1.0f / RAYS));
    }
    return sum;
}

static Rgb total_of(const ScatterRadiance *radiance) {
    return rgb_add(rgb_add(radiance->once, radiance->twice), radiance->more);
}

/* ---- Photons' starts ------------------------------------------------------------------------- */

/* Where no lamp has any power, or more than numbers hold, each gets as many rays. */
static void rays_are_shared_among_dark_lamps(void) {
    static const double powers[3] = {0.0, (double)INFINITY, (double)NAN};
    for (int i = 0; i < 3; ++i) {
        LightBatch batches[4];
        memset(batches, 0, sizeof batches);
        for (int b = 0; b < 4; ++b)
            batches[b].power = powers[i];
        light_batches_share(batches, 4, 1000);
        for (int b = 0; b < 4; ++b) {
            ENSURE_NEAR(batches[b].emission.count, 250, 0);
            ENSURE_NEAR(batches[b].first, 250 * b, 0);
        }
    }
}

/* ---- Cells ----------------------------------------------------------------------------------- */

/* Grids for cubes of that edge, in radii. */
static void check_depths(const AmbScene *scene, float size) {
    Job job;
    job_init(&job, 1);
    DepthGrid grid;
    ENSURE_STATUS(depth_grid_build(scene, 0, size, &job, &grid), AMB_OK);
    uint64_t state = 2;
    double worst = 0.0, excess = -1.0;
    for (int i = 0; i < 4000; ++i) {
        const double radius = cbrt(test_uniform(&state, 0.0, 1.0));
        const Vec3 p = vec3_scale(random_direction(&state), (float)radius);
        const float depth = depth_grid_at(&grid, p);
        /* The mesh lies up to 1.1e-3 below the sphere. */
        worst = test_worse(worst, fabs((double)depth - (1.0 - radius)));
        excess = test_worse(excess, (double)depth_grid_free(&grid, depth) - (0.9989 - radius));
    }
    /* Around the centre, where the distance has an edge. */
    ENSURE_NEAR(worst, 0.0, 0.9 * (double)grid.spacing);
    ENSURE(excess <= 0.0);
    depth_grid_clear(&grid);
}

static void depths_of_a_sphere(void) {
    AmbScene *scene = furnace(shape_resin(1.5f, 4.0f, 0.0f, 0.0f));
    check_depths(scene, 0.0f);
    check_depths(scene, 0.15f);
    check_depths(scene, 1.0f);
    amb_scene_destroy(scene);
}

/* The first object's cells, and the sum of their volumes, m^3. */
static double build_cells(const AmbScene *scene, ScatterCells *out_cells) {
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scatter_cells_build(scene, 0, 0.1f, 2, &job, out_cells), AMB_OK);
    double sum = 0.0;
    for (uint64_t i = 0; i < out_cells->cell_count; ++i)
        sum += (double)out_cells->volumes[i];
    return sum;
}

/* Hat functions add up to 1: so do volumes to that of the layers. */
static void check_volumes_of_sphere(const AmbScene *scene) {
    ScatterCells cells;
    const double sum = build_cells(scene, &cells);
    const double inner = 1.0 - (double)cells.layers[cells.layer_count];
    ENSURE(inner > 0.3 && inner < 0.6);
    const double expected = 4.0 / 3.0 * PI * (1.0 - inner * inner * inner);
    ENSURE_NEAR(sum / expected, 1.0, 8e-3);
    scatter_cells_clear(&cells);
}

static void volumes_of_a_sphere(void) {
    AmbScene *scene = furnace(shape_resin(1.5f, 20.0f, 0.0f, 0.0f));
    check_volumes_of_sphere(scene);
    amb_scene_destroy(scene);
}

/* Lines that enter a sheet, here from below, are in no solid from there on. */
static void sheets_have_no_inside(void) {
    Shape sphere = shape_sphere(48, 96), sheet = shape_plane();
    AmbScene *scene = scene_of(&sphere, true, shape_resin(1.5f, 20.0f, 0.0f, 0.0f));
    AmbMaterial stone;
    amb_material_init(&stone);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &stone, &id), AMB_OK);
    for (uint64_t t = 0; t < sheet.triangle_count; ++t) {
        const uint32_t second = sheet.triangles[3 * t + 1];
        sheet.triangles[3 * t + 1] = sheet.triangles[3 * t + 2];
        sheet.triangles[3 * t + 2] = second;
    }
    const AmbMesh mesh = shape_mesh(&sheet, "sheet", false);
    shape_add(scene, &mesh, id, 3.0f, 0.0f, 0.0f, -0.95f);
    shape_free(&sheet);
    build(scene);
    check_volumes_of_sphere(scene);
    amb_scene_destroy(scene);
}

/* Walls just around the medium are no solid that hides what is inside: neither those of a room that
 * the camera is in nor those of one that is open. */
static void rooms_have_an_inside(void) {
    for (int k = 0; k < 2; ++k) {
        Shape sphere = shape_sphere(48, 96), room = shape_box();
        AmbScene *scene = scene_of(&sphere, true, shape_resin(1.5f, 20.0f, 0.0f, 0.0f));
        AmbMaterial paint;
        amb_material_init(&paint);
        uint32_t id = 0;
        ENSURE_STATUS(amb_scene_add_material(scene, &paint, &id), AMB_OK);
        if (k == 1)
            room.triangle_count -= 2;
        const AmbMesh mesh = shape_mesh(&room, "room", false);
        shape_add(scene, &mesh, id, 1.001f, 0.0f, 0.0f, 0.0f);
        shape_free(&room);
        build(scene); /* its camera is in the middle */
        check_volumes_of_sphere(scene);
        amb_scene_destroy(scene);
    }
}

/* Behind the walls of a room, and inside a stone, is nothing that is seen. */
static void solids_hide_what_is_behind(void) {
    for (int k = 0; k < 2; ++k) {
        Shape fog = shape_box(), solid = shape_sphere(48, 96);
        AmbScene *scene = scene_of(&fog, false, shape_resin(1.0f, 0.5f, 0.0f, 0.0f));
        AmbMaterial paint;
        amb_material_init(&paint);
        uint32_t id = 0;
        ENSURE_STATUS(amb_scene_add_material(scene, &paint, &id), AMB_OK);
        const AmbMesh mesh = shape_mesh(&solid, "solid", false);
        const float radius = k == 0 ? 0.8f : 0.3f, aside = k == 0 ? 0.0f : 0.5f;
        shape_add(scene, &mesh, id, radius, aside, 0.0f, 0.0f);
        shape_free(&solid);
        build(scene); /* its camera is in the middle: in the sphere, or beside it */
        ScatterCells cells;
        const double sum = build_cells(scene, &cells);
        const double ball = 4.0 / 3.0 * PI * pow((double)radius, 3.0);
        ENSURE_NEAR(sum / (k == 0 ? ball : 8.0 - ball), 1.0, 0.02);
        scatter_cells_clear(&cells);
        amb_scene_destroy(scene);
    }
}

/* Lines along the normals of flat walls meet their layers all alike: each layer has the volume of
 * its shell, where the grid's distances are not rounded by edges. */
static void volumes_of_a_box(void) {
    Shape shape = shape_box();
    AmbScene *scene = scene_of(&shape, false, shape_resin(1.5f, 12.0f, 0.0f, 0.0f));
    build(scene);
    Job job;
    job_init(&job, 1);
    ScatterCells cells;
    ENSURE_STATUS(scatter_cells_build(scene, 0, 0.1f, 2, &job, &cells), AMB_OK);
    double sums[LAYER_MAX] = {0.0};
    for (uint64_t n = 0; n < (uint64_t)cells.count[0] * cells.count[1] * cells.count[2]; ++n) {
        const CellColumn column = cells.columns[n];
        for (uint32_t layer = column.low; layer < column.high; ++layer)
            sums[layer] += (double)cells.volumes[column.first + layer - column.low];
    }
    for (uint32_t layer = 1; layer < 12; ++layer) {
        const double outer = 2.0 - 2.0 * (double)cells.layers[layer];
        const double inner = 2.0 - 2.0 * (double)cells.layers[layer + 1];
        ENSURE_NEAR(sums[layer] / (outer * outer * outer - inner * inner * inner), 1.0, 0.025);
    }
    scatter_cells_clear(&cells);
    amb_scene_destroy(scene);
}

/* ---- Photons --------------------------------------------------------------------------------- */

/* A sphere of index 1.5 takes in pi A (1 - 0.091778) of diffuse light. */
static void flux_is_kept(void) {
    const double albedos[2] = {1.0, 0.8};
    for (int i = 0; i < 2; ++i) {
        const float sigma_s = (float)(4.0 * albedos[i]);
        AmbScene *scene = furnace(shape_resin(1.5f, sigma_s, 4.0f - sigma_s, 0.5f));
        const ScatterParams params = world_params(20000);
        Scatter *scatter = trace(scene, &params, 1);
        const ScatterTally *tally = scatter_tally(scatter);
        ENSURE_NEAR(tally->entered[1] / (4.0 * PI * PI * (1.0 - 0.091778)), 1.0, 4e-3);
        ENSURE_NEAR((tally->absorbed[1] + tally->escaped[1]) / tally->entered[1], 1.0,
                    i == 0 ? 1e-5 : 5e-3);
        ENSURE_NEAR(tally->lost[1], 0.0, 0.0);
        if (i == 0)
            ENSURE_NEAR(tally->absorbed[1] / tally->entered[1], 0.0, 1e-5);
        scatter_destroy(scatter);
        amb_scene_destroy(scene);
    }
}

/* What is in the middle of an object hides none of the light that comes to it. */
static void stones_hide_no_surroundings(void) {
    Shape sphere = shape_sphere(48, 96), stone = shape_sphere(8, 16);
    AmbScene *scene = scene_of(&sphere, true, shape_resin(1.5f, 2.0f, 0.0f, 0.0f));
    AmbMaterial coal;
    amb_material_init(&coal);
    coal.albedo[0] = coal.albedo[1] = coal.albedo[2] = 0.0f;
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &coal, &id), AMB_OK);
    const AmbMesh mesh = shape_mesh(&stone, "stone", false);
    shape_add(scene, &mesh, id, 0.1f, 0.0f, 0.0f, 0.0f);
    shape_free(&stone);
    const float world[3] = {1, 1, 1};
    ENSURE_STATUS(amb_scene_set_world(scene, world), AMB_OK);
    build(scene);
    const ScatterParams params = world_params(20000);
    Scatter *scatter = trace(scene, &params, 1);
    const ScatterTally *tally = scatter_tally(scatter);
    ENSURE_NEAR(tally->entered[1] / (4.0 * PI * PI * (1.0 - 0.091778)), 1.0, 4e-3);
    ENSURE(tally->escaped[1] < 0.99 * tally->entered[1]);
    scatter_destroy(scatter);
    amb_scene_destroy(scene);
}

/* In white media a photon scatters as often as the object is free paths wide, on average: here the
 * longest walks go on by chance, and flux is kept on average. */
static void long_walks_are_few(void) {
    const float sigmas[2] = {1e4f, 1e7f};
    for (int i = 0; i < 2; ++i) {
        AmbScene *scene = furnace(shape_resin(1.5f, sigmas[i], 0.0f, 0.0f));
        const ScatterParams params = world_params(i == 0 ? 4000 : 200);
        Scatter *scatter = trace(scene, &params, 1);
        const ScatterTally *tally = scatter_tally(scatter);
        ENSURE(tally->collision_count < 10000 * tally->photon_count);
        if (i == 0)
            ENSURE_NEAR(tally->escaped[1] / tally->entered[1], 1.0, 0.04);
        scatter_destroy(scatter);
        amb_scene_destroy(scene);
    }
}

/* Where nothing is absorbed radiance inside is n^2 times the world's, whatever the medium: what
 * has not scattered, or straight on alone, is the rest. */
static void white_furnace(void) {
    const struct {
        float sigma, g, ior;
    } cases[4] = {
        {4.0f, 0.0f, 1.5f}, {10.0f, 0.6f, 1.3f}, {10.0f, 0.9f, 1.3f}, {30.0f, 0.0f, 2.0f}};
    for (int i = 0; i < 4; ++i) {
        AmbScene *scene = furnace(shape_resin(cases[i].ior, cases[i].sigma, 0.0f, cases[i].g));
        const ScatterParams params = world_params(30000);
        Scatter *scatter = trace(scene, &params, 1);
        const ScatterRadiance mean = mean_radiance(scene, scatter);
        /* Mean over cosines of 1 - exp(-sigma 2 cos). */
        const double x = 2.0 * ((double)cases[i].sigma - (double)scatter_forward(scatter, 0).g);
        const double scattered = 1.0 - (1.0 - exp(-x)) / x;
        const double n2 = (double)(cases[i].ior * cases[i].ior);
        ENSURE_NEAR((double)total_of(&mean).g / (n2 * scattered), 1.0, 0.02);
        ENSURE(mean.once.g > 0.0f && mean.twice.g > 0.0f && mean.more.g > mean.twice.g);
        scatter_destroy(scatter);
        amb_scene_destroy(scene);
    }
}

/* However few photons there are, and however sharp the lobes. */
static void no_light_is_negative(void) {
    const float gs[4] = {0.3f, -0.5f, 0.8f, 0.97f};
    for (int i = 0; i < 4; ++i) {
        AmbScene *scene = furnace(shape_resin(1.5f, 6.0f, 0.1f, gs[i]));
        const ScatterParams params = world_params(60);
        Scatter *scatter = trace(scene, &params, 1);
        uint64_t state = 3, lit = 0;
        double least = 0.0;
        for (int k = 0; k < 4 * RAYS; ++k) {
            const Vec3 o = vec3_scale(random_direction(&state), 0.9f);
            const FieldSegment segment = {
                o, random_direction(&state), 0.1f, 0, 0, 0.0f, {0, 0, 0}, NULL};
            const ScatterRadiance radiance = scatter_gather(scatter, &segment, rgb(0, 0, 0), NULL);
            least = fmin(least,
                         (double)fminf(radiance.once.g, fminf(radiance.twice.g, radiance.more.g)));
            lit += total_of(&radiance).g > 0.0f ? 1 : 0;
        }
        ENSURE_NEAR(least, 0.0, 0.0);
        ENSURE(lit > RAYS);
        scatter_destroy(scatter);
        amb_scene_destroy(scene);
    }
}

/* What is looked at by chance in thin media is on average what all cells say. */
static void cells_by_chance_have_the_same_mean(void) {
    enum { SEGMENTS = 12, TRIALS = 4000 };
    AmbScene *scene = furnace(shape_resin(1.5f, 0.5f, 0.1f, 0.6f));
    const ScatterParams params = world_params(20000);
    Scatter *scatter = trace(scene, &params, 1);
    uint64_t state = 7;
    int different = 0;
    for (int i = 0; i < SEGMENTS; ++i) {
        /* From just below the boundary, where depth ends, and from within. */
        const Vec3 out = random_direction(&state);
        const Vec3 o = vec3_scale(out, i % 2 == 0 ? 0.99f : 0.5f);
        Vec3 d = random_direction(&state);
        if (vec3_dot(d, out) > 0.0f)
            d = vec3_negate(d);
        const FieldSegment segment = {.o = o, .d = d, .length = i % 3 == 0 ? 0.05f : 0.9f};
        const ScatterRadiance all = scatter_gather(scatter, &segment, rgb(0, 0, 0), NULL);
        double sum = 0.0, squares = 0.0;
        for (int k = 0; k < TRIALS; ++k) {
            const Sample2 u = {(float)test_uniform(&state, 0, 1),
                               (float)test_uniform(&state, 0, 1)};
            const ScatterRadiance one = scatter_gather(scatter, &segment, rgb(0, 0, 0), &u);
            const double value = (double)one.twice.g + (double)one.more.g;
            sum += value / TRIALS;
            squares += value * value / TRIALS;
            different += one.twice.g != all.twice.g;
        }
        const double error = sqrt(fmax(squares - sum * sum, 0.0) / TRIALS);
        const double expected = (double)all.twice.g + (double)all.more.g;
        ENSURE(expected > 0.0 && error < 0.02 * expected);
        ENSURE_NEAR(sum, expected, 4.0 * error + 1e-5 * expected);
    }
    ENSURE(different > SEGMENTS * TRIALS / 2);
    scatter_destroy(scatter);
    amb_scene_destroy(scene);
}

/* Channels that share their photons' paths get what each would get alone. */
static void channels_are_media_of_their_own(void) {
    const float sigma_s[3] = {8.0f, 4.0f, 5.0f}, sigma_a[3] = {0.1f, 0.4f, 0.0f};
    AmbMaterial material = shape_resin(1.4f, 1.0f, 0.0f, 0.3f);
    memcpy(material.sigma_a, sigma_a, sizeof sigma_a);
    memcpy(material.lobes[0].sigma_s, sigma_s, sizeof sigma_s);
    AmbScene *scene = furnace(material);
    const ScatterParams params = world_params(20000);
    Scatter *scatter = trace(scene, &params, 1);
    const ScatterRadiance mean = mean_radiance(scene, scatter);
    const double together[3] = {(double)total_of(&mean).r, (double)total_of(&mean).g,
                                (double)total_of(&mean).b};
    scatter_destroy(scatter);
    amb_scene_destroy(scene);
    for (int k = 0; k < 3; ++k) {
        scene = furnace(shape_resin(1.4f, sigma_s[k], sigma_a[k], 0.3f));
        scatter = trace(scene, &params, 1);
        const ScatterRadiance alone = mean_radiance(scene, scatter);
        ENSURE_NEAR(together[k] / (double)total_of(&alone).r, 1.0, 0.03);
        scatter_destroy(scatter);
        amb_scene_destroy(scene);
    }
}

static void threads_do_not_matter(void) {
    AmbScene *scene = furnace(shape_resin(1.5f, 6.0f, 0.1f, 0.0f));
    const ScatterParams params = world_params(3000);
    Scatter *one = trace(scene, &params, 1), *three = trace(scene, &params, 3);
    const ScatterRadiance a = mean_radiance(scene, one), b = mean_radiance(scene, three);
    ENSURE_NEAR(a.once.g, b.once.g, 0.0);
    ENSURE_NEAR(a.twice.g, b.twice.g, 0.0);
    ENSURE_NEAR(a.more.g, b.more.g, 0.0);
    ENSURE_NEAR(scatter_tally(one)->absorbed[0], scatter_tally(three)->absorbed[0], 0.0);
    ENSURE_NEAR(scatter_tally(one)->collision_count, scatter_tally(three)->collision_count, 0.0);
    scatter_destroy(one);
    scatter_destroy(three);
    amb_scene_destroy(scene);
}

static void failures_leave_nothing(void) {
    AmbScene *scene = furnace(shape_resin(1.5f, 6.0f, 0.1f, 0.0f));
    const ScatterParams params = world_params(100);
    Job job;
    job_init(&job, 2);
    Scatter *scatter = NULL;
    MemoryLimit limit = {.bytes = 1 << 20};
    memory_set_limit(&limit);
    ENSURE_STATUS(scatter_create(scene, &params, &job, &scatter), AMB_OUT_OF_MEMORY);
    memory_set_limit(NULL);
    ENSURE(atomic_load(&limit.refused) > 1 << 20);
    for (int64_t n = 0; n < 12; ++n) {
        memory_fail_after(n);
        ENSURE_STATUS(scatter_create(scene, &params, &job, &scatter), AMB_OUT_OF_MEMORY);
        memory_fail_after(-1);
    }
    atomic_store(&job.cancelled, true);
    ENSURE_STATUS(scatter_create(scene, &params, &job, &scatter), AMB_CANCELLED);
    ENSURE(scatter == NULL);
    amb_scene_destroy(scene);
}

void test_scatter(void);
void test_scatter(void) {
    RUN(addition_theorem);
    RUN(lobes_are_positive);
    RUN(bound_of_lobes_is_said);
    RUN(rays_are_shared_among_dark_lamps);
    RUN(depths_of_a_sphere);
    RUN(volumes_of_a_sphere);
    RUN(sheets_have_no_inside);
    RUN(rooms_have_an_inside);
    RUN(solids_hide_what_is_behind);
    RUN(volumes_of_a_box);
    RUN(flux_is_kept);
    RUN(stones_hide_no_surroundings);
    RUN(long_walks_are_few);
    RUN(white_furnace);
    RUN(no_light_is_negative);
    RUN(cells_by_chance_have_the_same_mean);
    RUN(channels_are_media_of_their_own);
    RUN(threads_do_not_matter);
    RUN(failures_leave_nothing);
}
