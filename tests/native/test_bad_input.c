/* SPDX-License-Identifier: GPL-3.0-or-later
 * Scenes that no one would build on purpose: each gives a defined picture, or one clear error. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "demo.h"
#include "test.h"

/* Many pictures, so small ones. */
static Demo small_demo(void) {
    Demo demo = demo_create();
    demo.params.width = demo.params.height = 10;
    demo.params.light_samples = 10000;
    return demo;
}

/* Renders, checks the picture and gives it away. */
static Picture checked(const Demo *demo, const char *what) {
    Picture picture = demo_render(demo);
    picture_check(&picture, what);
    return picture;
}

static void check_demo(const Demo *demo, const char *what) {
    Picture picture = checked(demo, what);
    picture_free(&picture);
}

/* With both estimators and with internal reflections. */
static void check_thoroughly(const Demo *demo, const char *what) {
    Demo copy = *demo;
    for (uint32_t estimator = AMB_ESTIMATOR_POINTS_FIXED;
         estimator <= AMB_ESTIMATOR_POINTS_COVARIANCE; ++estimator) {
        copy.params.estimator = estimator;
        copy.params.light_bounces = copy.params.camera_bounces = 0;
        check_demo(&copy, what);
        copy.params.light_bounces = copy.params.camera_bounces = 3;
        check_demo(&copy, what);
    }
}

/* ---- Empty scenes ---------------------------------------------------------------------------- */

static void empty_scenes(void) {
    Demo demo = small_demo();
    Picture picture = checked(&demo, "complete");
    ENSURE(picture_mean(&picture, PASS_SINGLE) > 1e-4);
    picture_free(&picture);

    demo.has_light = false;
    picture = checked(&demo, "no light");
    ENSURE(picture_mean(&picture, PASS_SINGLE) == 0.0);
    ENSURE(picture_mean(&picture, PASS_SURFACE) > 0.0);
    picture_free(&picture);

    shape_free(&demo.shape);
    demo.has_ground = false;
    picture = checked(&demo, "empty");
    /* The world, everywhere. */
    ENSURE(picture.passes[PASS_COMBINED][2] == 0.4f && picture.passes[PASS_COMBINED][3] == 1.0f);
    ENSURE(picture.passes[PASS_DEPTH][0] == 1e10f);
    picture_free(&picture);

    demo.has_light = true;
    check_demo(&demo, "light without objects");
    memset(demo.light.color, 0, sizeof demo.light.color);
    check_demo(&demo, "black light without objects");
    demo_free(&demo);
    demo = small_demo();
    memset(demo.light.color, 0, sizeof demo.light.color);
    check_demo(&demo, "black light");
    demo_free(&demo);
}

static void no_camera_is_an_error(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_INVALID_ARGUMENT);
    AmbErrorInfo info;
    amb_last_error(&info);
    ENSURE(strstr(info.message, "camera") != NULL);
    amb_scene_destroy(scene);
}

static void meshes_without_triangles(void) {
    Demo demo = small_demo();
    demo.shape.triangle_count = 0;
    check_demo(&demo, "no triangles");
    demo.is_smooth = false;
    check_demo(&demo, "no triangles, flat");
    demo.shape.vertex_count = 0;
    check_demo(&demo, "no vertices");
    demo_free(&demo);
}

/* ---- Broken meshes --------------------------------------------------------------------------- */

static void degenerate_triangles(void) {
    Demo demo = small_demo();
    Shape *s = &demo.shape;
    /* Every fifth has two corners in one place, every seventh lies on a line. */
    for (uint64_t t = 0; t < s->triangle_count; t += 5)
        s->triangles[3 * t + 1] = s->triangles[3 * t];
    check_thoroughly(&demo, "zero-area triangles");
    for (uint64_t t = 0; t < 3 * s->triangle_count; ++t)
        s->triangles[t] = (uint32_t)(t % 2);
    check_thoroughly(&demo, "nothing but lines");
    for (uint64_t t = 0; t < 3 * s->triangle_count; ++t)
        s->triangles[t] = 5;
    check_thoroughly(&demo, "nothing but points");
    demo_free(&demo);

    /* Slivers whose area underflows. */
    demo = small_demo();
    for (uint64_t i = 0; i < demo.shape.vertex_count; ++i)
        demo.shape.positions[3 * i] *= 1e-20f;
    check_thoroughly(&demo, "flattened to 1e-20");
    demo_free(&demo);
}

static void duplicate_triangles(void) {
    Demo demo = small_demo();
    Shape *s = &demo.shape;
    uint32_t *twice = malloc(6 * s->triangle_count * sizeof(uint32_t));
    memcpy(twice, s->triangles, 3 * s->triangle_count * sizeof(uint32_t));
    memcpy(twice + 3 * s->triangle_count, s->triangles, 3 * s->triangle_count * sizeof(uint32_t));
    free(s->triangles);
    s->triangles = twice;
    s->triangle_count *= 2;
    check_thoroughly(&demo, "duplicate triangles");
    /* The copies turned over. */
    for (uint64_t t = s->triangle_count / 2; t < s->triangle_count; ++t) {
        const uint32_t corner = twice[3 * t];
        twice[3 * t] = twice[3 * t + 1];
        twice[3 * t + 1] = corner;
    }
    check_thoroughly(&demo, "duplicate triangles turned over");
    demo_free(&demo);
}

static void open_and_non_manifold_meshes(void) {
    Demo demo = small_demo();
    const uint64_t all = demo.shape.triangle_count;
    demo.shape.triangle_count = all / 2;
    check_thoroughly(&demo, "half a sphere");
    demo.shape.triangle_count = all - 1;
    check_thoroughly(&demo, "a hole");
    demo.shape.triangle_count = 1;
    check_thoroughly(&demo, "one triangle");
    demo_free(&demo);

    /* A fin on the inside and the outside: three triangles at an edge. */
    demo = small_demo();
    demo.shape.triangles[0] = 17;
    demo.shape.triangles[1] = 203;
    demo.shape.triangles[2] = 411;
    check_thoroughly(&demo, "a fin");
    /* No order at all; paths branch at every triangle. */
    uint64_t state = 1;
    demo.params.width = demo.params.height = 6;
    demo.shape.triangle_count = 120;
    for (uint64_t t = 0; t < 3 * demo.shape.triangle_count; ++t)
        demo.shape.triangles[t] =
            (uint32_t)test_uniform(&state, 0.0, (double)demo.shape.vertex_count);
    check_thoroughly(&demo, "random triangles");
    demo_free(&demo);

    demo = small_demo();
    shape_free(&demo.shape);
    demo.shape = shape_plane();
    check_thoroughly(&demo, "a sheet");
    demo_free(&demo);
}

/* The warnings say of which object, whoever finds the hole. */
static void holes_are_named(void) {
    for (uint32_t estimator = AMB_ESTIMATOR_POINTS_FIXED; estimator <= AMB_ESTIMATOR_SPECULAR;
         ++estimator) {
        Demo demo = small_demo();
        demo.shape.triangle_count -= demo.shape.triangle_count / 4;
        demo.has_ground = false;
        demo.light.position[0] = -2.0f; /* on the other side of the hole */
        demo.light.position[1] = 2.0f;
        demo.light.position[2] = 0.0f;
        demo.params.camera_bounces = 3;
        demo.params.light_samples = 1000;
        demo.params.estimator = estimator;
        Picture picture = checked(&demo, "a sphere with a hole");
        ENSURE(strstr(picture.report, "hero: light rays left it through a hole") != NULL);
        ENSURE(strstr(picture.report, "hero: camera rays left it through a hole") != NULL);
        picture_free(&picture);
        demo_free(&demo);
    }
}

/* Photons cannot tell the sharpest lobes: the report says so, and AUTO does not take them there. */
static void lobes_too_sharp_for_photons_are_named(void) {
    static const float gs[] = {0.99f, -0.89f, 0.9f};
    for (int i = 0; i < 3; ++i)
        for (uint32_t choice = AMB_SCATTER_AUTO; choice <= AMB_SCATTER_PHOTONS; ++choice) {
            Demo demo = small_demo();
            demo.material = shape_resin(1.5f, 8.0f, 0.1f, gs[i]);
            demo.params.effects |= AMB_EFFECT_MULTIPLE_SCATTERING;
            demo.params.light_samples = 100;
            demo.params.scatter_estimator = choice;
            Picture picture = checked(&demo, "a sharp lobe");
            const bool is_said = strstr(picture.report, "hero: it scatters too sharply") != NULL;
            ENSURE(is_said == (i < 2 && choice == AMB_SCATTER_PHOTONS));
            picture_free(&picture);
            demo_free(&demo);
        }
}

/* Cubes of scales and their reciprocals are no floats; where the vertices come to lie counts. */
static void scales_whose_cubes_overflow(void) {
    static const float scales[] = {1.0f, 1e20f, 1e-20f, 1e13f};
    double first = 0.0;
    for (size_t i = 0; i < sizeof scales / sizeof scales[0]; ++i) {
        Demo demo = small_demo();
        demo.params.light_samples = 1000;
        AmbScene *scene = demo_scene(&demo);
        for (uint64_t k = 0; k < 3 * demo.shape.vertex_count; ++k)
            demo.shape.positions[k] /= scales[i];
        const AmbMesh mesh = shape_mesh(&demo.shape, "beside", true);
        shape_add(scene, &mesh, 0, scales[i], 1.5f, 1.0f, 0.0f);
        Picture picture;
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
        picture_check(&picture, "an object of a large scale");
        const double mean = picture_mean(&picture, PASS_COMBINED);
        first = i == 0 ? mean : first;
        ENSURE_NEAR(mean / first, 1.0, 1e-3);
        picture_free(&picture);
        amb_scene_destroy(scene);
        demo_free(&demo);
    }
}

/* What leaves through the hole is in a medium without end, which absorbs nothing: photons did not
 * end, walks after a million events. */
static void later_orders_in_an_open_mesh(void) {
    Demo demo = small_demo();
    demo.shape.triangle_count -= demo.shape.triangle_count / 4;
    demo.has_ground = false;
    demo.material = shape_resin(1.5f, 3.0f, 0.0f, 0.3f);
    demo.params.effects |= AMB_EFFECT_DOUBLE_SCATTERING | AMB_EFFECT_MULTIPLE_SCATTERING;
    demo.params.light_samples = 3000;
    demo.params.scatter_estimator = AMB_SCATTER_WALK;
    check_demo(&demo, "walks in an open sphere");
    demo.params.scatter_estimator = AMB_SCATTER_PHOTONS;
    Picture picture = checked(&demo, "photons in an open sphere");
    ENSURE(strstr(picture.report, "\"flux_lost\"") != NULL);
    ENSURE(strstr(picture.report, "\"flux_lost\": [0,") == NULL);
    picture_free(&picture);
    demo_free(&demo);
}

/* A sun is seen from within a medium that no face ends, and that is clear. */
static void suns_seen_out_of_an_open_mesh(void) {
    Demo demo = small_demo();
    demo.shape.triangle_count -= demo.shape.triangle_count / 4;
    demo.has_ground = false;
    demo.material = shape_resin(1.5f, 0.0f, 0.0f, 0.0f);
    amb_light_init(&demo.light, AMB_LIGHT_SUN);
    demo.light.angle = 3.0f;
    demo.params.effects = AMB_EFFECT_BACKGROUND | AMB_EFFECT_LAMP_IMAGES;
    demo.params.camera_bounces = 4;
    check_demo(&demo, "a sun out of an open sphere");
    demo_free(&demo);
}

/* Far from the middle of the scene coordinates are 0.008 apart, and free paths 150 times shorter:
 * paths did not move, nor end. */
static void free_paths_below_resolution(void) {
    for (uint32_t scatter = AMB_SCATTER_WALK; scatter <= AMB_SCATTER_PHOTONS; ++scatter) {
        Demo demo = small_demo();
        demo.params.width = demo.params.height = 4;
        demo.params.light_samples = 1000;
        demo.params.effects |= AMB_EFFECT_DOUBLE_SCATTERING | AMB_EFFECT_MULTIPLE_SCATTERING;
        demo.params.scatter_estimator = scatter;
        demo.has_ground = false;
        demo.at[0] = demo.at[1] = demo.at[2] = 1e5f;
        demo.material = shape_resin(1.1f, 2e4f, 0.0f, 0.0f);
        AmbScene *scene = demo_scene(&demo);
        const AmbMesh mesh = shape_mesh(&demo.shape, "beside", true);
        shape_add(scene, &mesh, 0, 1.0f, -1e5f, -1e5f, -1e5f);
        Picture picture;
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
        picture_check(&picture, "free paths below resolution");
        picture_free(&picture);
        amb_scene_destroy(scene);
        demo_free(&demo);
    }
}

static void normals_that_are_none(void) {
    static const float bad[] = {(float)NAN, (float)INFINITY, 0.0f, 1e-30f, 1e30f};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        Demo demo = small_demo();
        for (uint64_t k = 0; k < 3 * demo.shape.vertex_count; k += i % 2 ? 1 : 7)
            demo.shape.normals[k] = bad[i];
        check_thoroughly(&demo, "broken normals");
        demo_free(&demo);
    }
    Demo demo = small_demo();
    Picture right = checked(&demo, "right");
    /* All normals inward, or the winding, or both: the side is found out. */
    for (int variant = 0; variant < 3; ++variant) {
        if (variant != 1)
            for (uint64_t k = 0; k < 3 * demo.shape.vertex_count; ++k)
                demo.shape.normals[k] *= -1.0f;
        if (variant != 0 && variant != 2)
            for (uint64_t t = 0; t < demo.shape.triangle_count; ++t) {
                const uint32_t corner = demo.shape.triangles[3 * t];
                demo.shape.triangles[3 * t] = demo.shape.triangles[3 * t + 1];
                demo.shape.triangles[3 * t + 1] = corner;
            }
        Picture turned = checked(&demo, "turned over");
        ENSURE_NEAR(picture_mean(&turned, PASS_SINGLE) / picture_mean(&right, PASS_SINGLE), 1.0,
                    0.01);
        ENSURE_NEAR(picture_mean(&turned, PASS_SURFACE) / picture_mean(&right, PASS_SURFACE), 1.0,
                    0.01);
        picture_free(&turned);
    }
    picture_free(&right);
    /* Normals of some other mesh. */
    uint64_t state = 2;
    for (uint64_t k = 0; k < 3 * demo.shape.vertex_count; ++k)
        demo.shape.normals[k] = (float)test_uniform(&state, -1.0, 1.0);
    check_thoroughly(&demo, "random normals");
    demo_free(&demo);
}

static void positions_that_are_none(void) {
    static const float bad[] = {(float)NAN, (float)INFINITY, -(float)INFINITY};
    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; ++i) {
        Demo demo = small_demo();
        demo.shape.positions[100] = bad[i];
        AmbScene *scene = NULL;
        uint32_t id;
        ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
        const AmbMesh mesh = shape_mesh(&demo.shape, "hero", true);
        ENSURE_STATUS(amb_scene_add_mesh(scene, &mesh, &id), AMB_INVALID_ARGUMENT);
        AmbErrorInfo info;
        amb_last_error(&info);
        ENSURE(strstr(info.message, "hero") != NULL && strstr(info.message, "33") != NULL);
        amb_scene_destroy(scene);
        demo_free(&demo);
    }
    /* Finite in the mesh, not in the world: known when the scene is committed. */
    Demo demo = small_demo();
    for (uint64_t k = 0; k < 3 * demo.shape.vertex_count; ++k)
        demo.shape.positions[k] *= 1e30f;
    demo.scale = 1e10f;
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_INVALID_ARGUMENT);
    AmbErrorInfo info;
    amb_last_error(&info);
    ENSURE(strstr(info.message, "hero") != NULL && strstr(info.message, "finite") != NULL);
    amb_scene_destroy(scene);
    demo_free(&demo);
    /* Finite, but squares of areas are not. */
    static const float scales[] = {1.5e8f, 2e9f, 1e11f};
    for (size_t i = 0; i < sizeof scales / sizeof scales[0]; ++i) {
        demo = small_demo();
        demo.scale = scales[i];
        scene = demo_scene(&demo);
        const AmbStatus status = amb_scene_commit(scene);
        ENSURE(status == (i == 0 ? AMB_OK : AMB_INVALID_ARGUMENT));
        amb_last_error(&info);
        ENSURE(status == AMB_OK || strstr(info.message, "hero") != NULL);
        amb_scene_destroy(scene);
        if (i == 0)
            check_demo(&demo, "as large as can be");
        demo_free(&demo);
    }
}

/* ---- Sizes and places ------------------------------------------------------------------------ */

/* The long faces of a bar are slivers, and a lamp is next to one of them. Quartered alike they
 * would be eight million tubes; the light is that of points. */
static void slivers_beside_a_lamp(void) {
    Demo demo = small_demo();
    shape_free(&demo.shape);
    demo.shape = shape_box();
    for (uint64_t v = 0; v < demo.shape.vertex_count; ++v)
        demo.shape.positions[3 * v] *= 500.0f;
    demo.is_smooth = demo.has_ground = false;
    demo.light.position[0] = demo.light.position[1] = 0.1f;
    demo.light.position[2] = 1.02f;
    demo.params.effects = AMB_EFFECT_SINGLE_SCATTERING;
    double means[2];
    static const uint32_t estimators[2] = {AMB_ESTIMATOR_TUBES, AMB_ESTIMATOR_POINTS_FIXED};
    demo.params.light_samples = 1 << 18;
    for (int i = 0; i < 2; ++i) {
        demo.params.estimator = estimators[i];
        Picture picture = checked(&demo, "slivers beside a lamp");
        means[i] = picture_mean(&picture, PASS_SINGLE);
        const char *tubes = strstr(picture.report, "\"tubes\": ");
        ENSURE(tubes != NULL && strtoul(tubes + strlen("\"tubes\": "), NULL, 10) < 300000);
        picture_free(&picture);
    }
    ENSURE_NEAR(means[0] / means[1], 1.0, 0.03);
    demo_free(&demo);
}

static void scales_and_offsets(void) {
    static const float scales[] = {1e-4f, 1e4f};
    for (size_t i = 0; i < 2; ++i) {
        Demo demo = small_demo();
        demo.scale = scales[i];
        check_thoroughly(&demo, "scale");
        demo_free(&demo);
    }
    Demo demo = small_demo();
    Picture near = checked(&demo, "near");
    demo.at[0] = demo.at[1] = 1e4f;
    demo.at[2] = -1e4f;
    check_thoroughly(&demo, "offset of 1e4");
    Picture far = checked(&demo, "far");
    /* Floats there are 1e-3 apart, and the object has facets of 0.1. */
    ENSURE_NEAR(picture_mean(&far, PASS_SINGLE) / picture_mean(&near, PASS_SINGLE), 1.0, 0.05);
    picture_free(&far);
    picture_free(&near);
    /* Larger than floats there can tell apart: defined all the same. */
    demo.at[0] = 1e8f;
    check_demo(&demo, "offset of 1e8");
    demo_free(&demo);
}

static void image_sizes(void) {
    static const uint32_t sizes[][2] = {{1, 1}, {1, 64}, {64, 1}, {8192, 4}};
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; ++i) {
        Demo demo = small_demo();
        demo.params.width = sizes[i][0];
        demo.params.height = sizes[i][1];
        demo.params.samples = 1;
        check_demo(&demo, "size of the image");
        demo_free(&demo);
    }
}

static void extreme_parameters(void) {
    static const float kernels[] = {1e-6f, 1e-2f, 1e3f, 1e6f};
    for (size_t i = 0; i < sizeof kernels / sizeof kernels[0]; ++i) {
        Demo demo = small_demo();
        demo.params.kernel_size = kernels[i];
        demo.params.light_samples = 3000; /* a large kernel makes every pixel see all of them */
        check_thoroughly(&demo, "kernel_size");
        demo_free(&demo);
    }
    static const uint64_t light_samples[] = {1, 2, 9};
    for (size_t i = 0; i < sizeof light_samples / sizeof light_samples[0]; ++i) {
        Demo demo = small_demo();
        demo.params.light_samples = light_samples[i];
        check_thoroughly(&demo, "light_samples");
        demo_free(&demo);
    }
    Demo demo = small_demo();
    demo.params.width = demo.params.height = 8;
    demo.params.light_bounces = demo.params.camera_bounces = UINT32_MAX;
    check_demo(&demo, "bounces without end");
    demo.params.light_bounces = demo.params.camera_bounces = 0;
    demo.params.effects = 0;
    check_demo(&demo, "no effects");
    demo.params.effects = AMB_EFFECT_SINGLE_SCATTERING;
    check_demo(&demo, "single scattering alone");
    demo.params.adjoint_normals = 0;
    check_demo(&demo, "no adjoint normals");
    demo.params.threads = 300;
    check_demo(&demo, "300 threads");
    demo.params.seed = UINT32_MAX;
    check_demo(&demo, "seed");
    demo_free(&demo);
}

/* ---- Media ----------------------------------------------------------------------------------- */

static void extreme_media(void) {
    static const float iors[] = {0.1f, 0.7f, 1.0f, 1.0000001f, 2.5f, 10.0f};
    for (size_t i = 0; i < sizeof iors / sizeof iors[0]; ++i) {
        Demo demo = small_demo();
        demo.material.ior = iors[i];
        check_thoroughly(&demo, "ior");
        demo_free(&demo);
    }
    static const float densities[] = {0.0f, 1e-6f, 100.0f, 1e6f, 1e9f};
    for (size_t i = 0; i < sizeof densities / sizeof densities[0]; ++i)
        for (int part = 1; part <= 3; ++part) {
            Demo demo = small_demo();
            demo.material = shape_resin(1.5f, part & 1 ? densities[i] : 0.0f,
                                        part & 2 ? densities[i] : 0.0f, 0.3f);
            check_thoroughly(&demo, "density");
            /* One channel clear: its light goes on for ever. */
            demo.material.sigma_a[1] = demo.material.lobes[0].sigma_s[1] = 0.0f;
            check_demo(&demo, "density with a clear channel");
            demo_free(&demo);
        }
    static const float gs[] = {-0.99f, 0.99f, -0.9999f, 0.9999f};
    for (size_t i = 0; i < sizeof gs / sizeof gs[0]; ++i) {
        Demo demo = small_demo();
        demo.material.lobes[0].g = gs[i];
        check_thoroughly(&demo, "g");
        /* Seen along the light and against it, where the peak is. */
        for (int side = -1; side <= 1; side += 2) {
            demo.material.ior = 1.0f;
            demo.light.position[0] = 0.0f;
            demo.light.position[1] = -4.0f * (float)side;
            demo.light.position[2] = 0.5f;
            check_thoroughly(&demo, "g along the light");
        }
        demo_free(&demo);
    }
    Demo demo = small_demo();
    demo.material.lobe_count = AMB_PHASE_LOBE_MAX;
    for (uint32_t l = 1; l < AMB_PHASE_LOBE_MAX; ++l)
        demo.material.lobes[l] = demo.material.lobes[0];
    memset(demo.material.sigma_a, 0, sizeof demo.material.sigma_a);
    check_thoroughly(&demo, "albedo 1");
    demo.material.lobe_count = 0;
    check_thoroughly(&demo, "no lobes");
    memset(demo.material.transmit_color, 0, sizeof demo.material.transmit_color);
    memset(demo.material.reflect_color, 0, sizeof demo.material.reflect_color);
    check_thoroughly(&demo, "black tints");
    demo_free(&demo);
}

static void camera_and_lights_in_odd_places(void) {
    static const float places[][3] = {{0, 0, 0},           {0, 0, 1},          {0, -1, 0},
                                      {0.5f, 0.2f, -0.1f}, {0, 0, 0.9999999f}, {0, -4, 0.5f}};
    for (size_t i = 0; i < sizeof places / sizeof places[0]; ++i) {
        Demo demo = small_demo();
        memcpy(demo.camera_at, places[i], sizeof demo.camera_at);
        check_thoroughly(&demo, "camera in the medium or on its surface");
        demo_free(&demo);
        /* Points, discs, spots and rectangles inside, on the surface, and in the camera. */
        for (uint32_t kind = AMB_LIGHT_POINT; kind <= AMB_LIGHT_AREA; ++kind)
            for (int soft = 0; soft < 2; ++soft) {
                demo = small_demo();
                amb_light_init(&demo.light, kind);
                memcpy(demo.light.position, places[i], sizeof demo.light.position);
                demo.light.radius = soft ? 0.2f : 0.0f;
                demo.light.angle = soft ? 1.0f : 0.0f;
                demo.light.spot_blend = soft ? 1.0f : 0.0f;
                check_demo(&demo, "light in the medium or on its surface");
                demo_free(&demo);
            }
    }
    Demo demo = small_demo();
    demo.light.position[2] = 1e6f;
    check_demo(&demo, "light far away");
    demo.light.radius = 1e6f;
    check_demo(&demo, "light of enormous radius");
    amb_light_init(&demo.light, AMB_LIGHT_SUN);
    demo.light.angle = 3.14159265f;
    check_demo(&demo, "half a sky of sun");
    amb_light_init(&demo.light, AMB_LIGHT_SPOT);
    demo.light.position[2] = 4.0f;
    demo.light.spot_size = 1e-4f;
    check_demo(&demo, "spot like a needle");
    demo.light.spot_size = 3.14159265f;
    check_demo(&demo, "spot of half a sphere");
    amb_light_init(&demo.light, AMB_LIGHT_AREA);
    demo.light.position[2] = 4.0f;
    demo.light.size[0] = 1e-20f;
    demo.light.size[1] = 1e4f;
    check_demo(&demo, "area like a wire");
    demo_free(&demo);

    demo = small_demo();
    amb_camera_init(&demo.camera, AMB_CAMERA_ORTHOGRAPHIC);
    demo.camera.clip_start = -10.0f;
    check_thoroughly(&demo, "orthographic, from behind");
    demo.camera.clip_start = 3.5f;
    demo.camera.clip_end = 3.6f;
    check_thoroughly(&demo, "clipped to a slice of the medium");
    amb_camera_init(&demo.camera, AMB_CAMERA_PERSPECTIVE);
    demo.camera.lens_radius = 3.0f;
    demo.camera.focus_distance = 4.0f;
    check_thoroughly(&demo, "a lens larger than the object");
    demo_free(&demo);
}

/* Embree's assertions end the process over a ray from beyond its bound of 1.8e18. */
/* A focus nearer to the lens than coordinates can tell: every ray runs along the lens. */
static void focus_within_the_lens(void) {
    Demo demo = small_demo();
    demo.camera.lens_radius = 0.1f;
    demo.camera.focus_distance = 1e-20f;
    check_demo(&demo, "a focus within the lens");
    demo_free(&demo);
}

static void camera_beyond_all_coordinates(void) {
    static const float places[] = {1e18f, 1e19f, 3e38f};
    for (size_t i = 0; i < sizeof places / sizeof places[0]; ++i)
        for (int axis = 0; axis < 3; ++axis) {
            Demo demo = small_demo();
            demo.camera_at[axis] = places[i];
            check_demo(&demo, "camera beyond all coordinates");
            amb_camera_init(&demo.camera, AMB_CAMERA_ORTHOGRAPHIC);
            check_demo(&demo, "orthographic camera beyond all coordinates");
            demo_free(&demo);
        }
    Demo demo = small_demo();
    memset(demo.light.position, 0, sizeof demo.light.position);
    demo.light.position[0] = 3e38f;
    check_demo(&demo, "light beyond all coordinates");
    demo_free(&demo);
}

/* Spheres in one another, more than a path can keep track of. */
static void more_nested_objects_than_fit(void) {
    enum { NESTED = 12 };
    Demo demo = small_demo();
    const AmbMesh mesh = shape_mesh(&demo.shape, "shell", true);
    for (int inside = 0; inside < 2; ++inside) {
        demo.camera_at[1] = inside ? 0.0f : -4.0f;
        for (uint32_t bounces = 0; bounces <= 2; bounces += 2) {
            AmbScene *scene = demo_scene(&demo);
            for (int i = 0; i < NESTED; ++i) {
                AmbMaterial material = demo.material;
                material.ior = 1.0f + 0.05f * (float)(i % 5);
                uint32_t id;
                ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
                shape_add(scene, &mesh, id, 0.95f - 0.07f * (float)i, 0, 0, 0);
            }
            demo.params.light_bounces = demo.params.camera_bounces = bounces;
            Picture picture;
            ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
            ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
            picture_check(&picture, "nested objects");
            picture_free(&picture);
            amb_scene_destroy(scene);
        }
    }
    demo_free(&demo);
}

/* The same object twice in the same place, and objects that cut through each other. */
static void overlapping_objects(void) {
    static const float offsets[] = {0.0f, 1e-7f, 0.5f, 2.0f};
    for (size_t i = 0; i < sizeof offsets / sizeof offsets[0]; ++i) {
        Demo demo = small_demo();
        demo.params.light_bounces = demo.params.camera_bounces = 2;
        AmbScene *scene = demo_scene(&demo);
        const AmbMesh mesh = shape_mesh(&demo.shape, "twin", true);
        shape_add(scene, &mesh, 0, 1.0f, offsets[i], 0, 0);
        Picture picture;
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
        picture_check(&picture, "overlapping objects");
        picture_free(&picture);
        amb_scene_destroy(scene);
        demo_free(&demo);
    }
}

/* Whether objects lie in one another is asked at faces, of which some have no normal. */
static void overlapping_degenerate_triangles(void) {
    Demo demo = small_demo();
    demo.params.estimator = AMB_ESTIMATOR_AUTO;
    for (uint64_t t = 0; t < demo.shape.triangle_count; t += 2)
        demo.shape.triangles[3 * t + 1] = demo.shape.triangles[3 * t];
    AmbScene *scene = demo_scene(&demo);
    const AmbMesh mesh = shape_mesh(&demo.shape, "beside", true);
    shape_add(scene, &mesh, 0, 1.0f, 1.4f, 1.4f, 0);
    Picture picture;
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
    picture_check(&picture, "overlapping degenerate triangles");
    picture_free(&picture);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

static void surfaces_of_mixed_slots(void) {
    Demo demo = small_demo();
    AmbScene *scene = demo_scene(&demo);
    uint32_t *slots = malloc(demo.shape.triangle_count * sizeof(uint32_t));
    for (uint64_t t = 0; t < demo.shape.triangle_count; ++t)
        slots[t] = (uint32_t)(t % 7); /* beyond the last: the last */
    AmbMesh mesh = shape_mesh(&demo.shape, "patches", true);
    mesh.slots = slots;
    static const uint32_t materials[3] = {1, 0, 1}; /* ground, resin, ground */
    AmbObject object;
    amb_object_init(&object);
    object.materials = materials;
    object.material_count = 3;
    object.to_world[7] = -2.0f;
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_mesh(scene, &mesh, &object.mesh), AMB_OK);
    ENSURE_STATUS(amb_scene_add_object(scene, &object, &id), AMB_OK);
    Picture picture;
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
    picture_check(&picture, "mixed slots");
    picture_free(&picture);
    amb_scene_destroy(scene);
    free(slots);
    demo_free(&demo);
}

void test_bad_input(void);

void test_bad_input(void) {
    RUN(empty_scenes);
    RUN(no_camera_is_an_error);
    RUN(meshes_without_triangles);
    RUN(degenerate_triangles);
    RUN(duplicate_triangles);
    RUN(open_and_non_manifold_meshes);
    RUN(holes_are_named);
    RUN(lobes_too_sharp_for_photons_are_named);
    RUN(scales_whose_cubes_overflow);
    RUN(later_orders_in_an_open_mesh);
    RUN(suns_seen_out_of_an_open_mesh);
    RUN(free_paths_below_resolution);
    RUN(normals_that_are_none);
    RUN(positions_that_are_none);
    RUN(slivers_beside_a_lamp);
    RUN(scales_and_offsets);
    RUN(image_sizes);
    RUN(extreme_parameters);
    RUN(extreme_media);
    RUN(camera_and_lights_in_odd_places);
    RUN(focus_within_the_lens);
    RUN(camera_beyond_all_coordinates);
    RUN(more_nested_objects_than_fit);
    RUN(overlapping_objects);
    RUN(overlapping_degenerate_triangles);
    RUN(surfaces_of_mixed_slots);
}
