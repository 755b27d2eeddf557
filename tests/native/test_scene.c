/* SPDX-License-Identifier: GPL-3.0-or-later
 * Geometry, boundaries between media, lights and cameras. */
#include <stdlib.h>
#include <string.h>

#include "scene/boundary.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;

static Vec3 random_direction(uint64_t *state) {
    const double z = test_uniform(state, -1.0, 1.0), phi = test_uniform(state, 0.0, 2.0 * PI);
    const double r = sqrt(1.0 - z * z);
    return vec3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z);
}

static AmbScene *begin_scene(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    return scene;
}

static uint32_t add_resin(AmbScene *scene, float ior) {
    const AmbMaterial material = shape_resin(ior, 1.0f, 0.0f, 0.0f);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    return id;
}

static void finish_scene(AmbScene *scene) {
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
}

/* ---- Media ----------------------------------------------------------------------------------- */

/* Spheres of radius 3, 2 and 1 in one another, moved to `at`. */
static AmbScene *nested_spheres(float at) {
    AmbScene *scene = begin_scene();
    Shape sphere = shape_sphere(24, 48);
    const AmbMesh mesh = shape_mesh(&sphere, "sphere", true);
    for (uint32_t i = 0; i < 3; ++i)
        shape_add(scene, &mesh, add_resin(scene, 1.2f + 0.1f * (float)i), 3.0f - (float)i, at, at,
                  at);
    shape_free(&sphere);
    finish_scene(scene);
    return scene;
}

static void media_at_a_point_are_its_enclosing_objects(void) {
    static const float places[] = {0.0f, 100.0f, -1e4f};
    for (size_t i = 0; i < sizeof places / sizeof places[0]; ++i) {
        AmbScene *scene = nested_spheres(places[i]);
        uint64_t state = 1;
        int wrong = 0;
        for (int trial = 0; trial < 300; ++trial) {
            const Vec3 d = random_direction(&state);
            const float r = (float)test_uniform(&state, 0.0, 4.0);
            /* Beside the facets a point is on neither side for certain. */
            if (fabsf(r - roundf(r)) < 0.05f)
                continue;
            /* A committed scene counts places from an origin of its own. */
            const Vec3 at = scene->center;
            const MediumStack stack = scene_media_at(scene, vec3_madd(at, r, d));
            const uint32_t expected = r > 3.0f ? 0 : r > 2.0f ? 1 : r > 1.0f ? 2 : 3;
            wrong += stack.count != expected;
            /* Outermost first. */
            for (uint32_t k = 0; k < stack.count; ++k)
                wrong += stack.objects[k] != k;
            const SceneMaterial *material = medium_stack_material(scene, &stack);
            wrong += (material == NULL) != (expected == 0);
            if (material != NULL)
                wrong += material->ior != 1.1f + 0.1f * (float)expected;
        }
        ENSURE(wrong == 0);
        amb_scene_destroy(scene);
    }
}

/* A ray from far left along +x, one boundary after the other. */
static void crossing_keeps_the_stack_of_media(void) {
    AmbScene *scene = nested_spheres(0.0f);
    MediumStack stack = {.count = 0};
    const Vec3 d = vec3_normalize(vec3(1, 0.02f, 0.01f));
    Vec3 o = vec3(-5, 0, 0);
    static const uint32_t counts[6] = {1, 2, 3, 2, 1, 0};
    static const float etas[6] = {1.0f / 1.2f, 1.2f / 1.3f, 1.3f / 1.4f,
                                  1.4f / 1.3f, 1.3f / 1.2f, 1.2f};
    for (int i = 0; i < 6; ++i) {
        Hit hit;
        ENSURE(scene_intersect(scene, o, d, INFINITY, &hit));
        const SurfacePoint surface = scene_surface(scene, &hit);
        const BoundaryCrossing crossing = boundary_cross(scene, &stack, &surface, d);
        ENSURE(!crossing.is_ignored && crossing.is_entering == (i < 3));
        ENSURE(crossing.can_refract && crossing.can_reflect);
        ENSURE(crossing.beyond.count == counts[i]);
        ENSURE_NEAR(crossing.eta, etas[i], 1e-6);
        ENSURE(vec3_dot(crossing.n, d) < 0.0f);
        stack = crossing.beyond;
        o = scene_leave(&surface, d);
    }
    Hit hit;
    ENSURE(!scene_intersect(scene, o, d, INFINITY, &hit));
    ENSURE(!scene_is_occluded(scene, o, d, INFINITY));
    ENSURE(scene_is_occluded(scene, vec3(-5, 0, 0), d, INFINITY));
    ENSURE(!scene_is_occluded(scene, vec3(-5, 0, 0), d, 1.9f));
    amb_scene_destroy(scene);
}

static SurfacePoint flat_surface(const AmbScene *scene, Vec3 ng) {
    return (SurfacePoint){
        .ng = ng, .ns = ng, .material = &scene->materials[0], .object = 0, .p = {0, 0, 0}};
}

static void crossing_knows_what_cannot_be(void) {
    AmbScene *scene = nested_spheres(0.0f); /* object 0: ior 1.2 */
    const SurfacePoint top = flat_surface(scene, vec3(0, 0, 1));
    const MediumStack outside = {.count = 0}, inside = {.count = 1};
    /* Seen from inside by a path that never came in. */
    const Vec3 up = vec3_normalize(vec3(0.1f, 0, 1));
    const BoundaryCrossing stray = boundary_cross(scene, &outside, &top, up);
    ENSURE(stray.is_ignored && stray.is_stray && stray.beyond.count == 0);
    /* Entered twice (overlap of an object with itself): leaving takes one of them. */
    const BoundaryCrossing twice = boundary_cross(scene, &inside, &top, vec3_negate(up));
    ENSURE(twice.is_ignored && twice.is_again && !twice.is_stray && twice.beyond.count == 2);
    /* More boundaries than the stack holds. */
    MediumStack full = {.count = MEDIUM_STACK_MAX};
    ENSURE(boundary_cross(scene, &full, &top, vec3_negate(up)).is_ignored);

    /* Total reflection: sin > 1/1.2 inside. */
    const float critical = asinf(1.0f / 1.2f);
    for (int i = -1; i <= 1; i += 2) {
        const float angle = critical + 1e-3f * (float)i;
        const Vec3 d = vec3(sinf(angle), 0, cosf(angle));
        const BoundaryCrossing c = boundary_cross(scene, &inside, &top, d);
        ENSURE(!c.is_ignored && !c.is_entering && c.can_reflect);
        ENSURE(c.can_refract == (i < 0));
        ENSURE(c.beyond.count == 0);
        ENSURE(c.n.z == -1.0f);
        ENSURE(c.split.reflected.z < 0.0f);
    }

    /* A shading normal that has turned away from the ray is not used. */
    SurfacePoint bent = top;
    bent.ns = vec3_normalize(vec3(0.9f, 0, 0.5f));
    const Vec3 grazing = vec3_normalize(vec3(1, 0, -0.1f));
    const BoundaryCrossing silhouette = boundary_cross(scene, &outside, &bent, grazing);
    ENSURE(silhouette.n.z == 1.0f);
    ENSURE_NEAR(silhouette.adjoint_refract, 1.0, 1e-6);
    /* One that sends the reflection below the face: no reflection. */
    bent.ns = vec3_normalize(vec3(0.08f, 0, 1));
    const BoundaryCrossing below = boundary_cross(scene, &outside, &bent, grazing);
    ENSURE(below.n.x > 0.0f && below.can_refract && !below.can_reflect);
    /* Veach's factor is 1 where normals agree, and for the reverse path its inverse. */
    bent.ns = vec3_normalize(vec3(0.2f, 0.1f, 1));
    const Vec3 down = vec3_normalize(vec3(0.3f, 0.2f, -1));
    const BoundaryCrossing there = boundary_cross(scene, &outside, &bent, down);
    const BoundaryCrossing back =
        boundary_cross(scene, &inside, &bent, vec3_negate(there.split.refracted));
    ENSURE(fabsf(there.adjoint_refract - 1.0f) > 1e-3f);
    ENSURE_NEAR(there.adjoint_refract * back.adjoint_refract, 1.0, 1e-5);
    amb_scene_destroy(scene);
}

/* ---- Surfaces -------------------------------------------------------------------------------- */

/* A smooth sphere that has been stretched, and turned over by its transform or its winding. */
static AmbScene *stretched_sphere(bool is_mirrored, bool is_wound_backwards) {
    AmbScene *scene = begin_scene();
    Shape sphere = shape_sphere(16, 32);
    if (is_wound_backwards)
        for (uint64_t t = 0; t < sphere.triangle_count; ++t) {
            const uint32_t swap = sphere.triangles[3 * t];
            sphere.triangles[3 * t] = sphere.triangles[3 * t + 1];
            sphere.triangles[3 * t + 1] = swap;
        }
    const AmbMesh mesh = shape_mesh(&sphere, "sphere", true);
    AmbObject object;
    amb_object_init(&object);
    const uint32_t material = add_resin(scene, 1.5f);
    ENSURE_STATUS(amb_scene_add_mesh(scene, &mesh, &object.mesh), AMB_OK);
    object.materials = &material;
    object.material_count = 1;
    /* Rows of a matrix with shear; the mirror turns x over. */
    static const float m[12] = {1.5f, 0.2f, 0, 4, 0, 0.8f, 0.3f, -2, 0.1f, 0, 1.1f, 7};
    memcpy(object.to_world, m, sizeof m);
    if (is_mirrored)
        for (int row = 0; row < 3; ++row)
            object.to_world[4 * row] *= -1.0f;
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_object(scene, &object, &id), AMB_OK);
    shape_free(&sphere);
    finish_scene(scene);
    return scene;
}

static const Vec3 STRETCHED_CENTER = {4, -2, 7};

static void outside_stays_outside(void) {
    for (int variant = 0; variant < 4; ++variant) {
        AmbScene *scene = stretched_sphere(variant & 1, (variant & 2) != 0);
        uint64_t state = 2;
        int wrong = 0;
        for (int trial = 0; trial < 500; ++trial) {
            const Vec3 d = random_direction(&state);
            Hit hit;
            if (!scene_intersect(scene, STRETCHED_CENTER, d, INFINITY, &hit)) {
                ++wrong;
                continue;
            }
            const SurfacePoint s = scene_surface(scene, &hit);
            wrong += !(vec3_dot(s.ng, d) > 0.0f && vec3_dot(s.ns, s.ng) > 0.9f);
            wrong += fabsf(vec3_length(s.ng) - 1.0f) > 1e-5f;
            wrong += fabsf(vec3_length(s.ns) - 1.0f) > 1e-5f;
        }
        ENSURE(wrong == 0);
        ENSURE(scene_media_at(scene, STRETCHED_CENTER).count == 1);
        ENSURE(scene_media_at(scene, vec3(0, 0, 0)).count == 0);
        amb_scene_destroy(scene);
    }
}

static void normal_derivative_matches_finite_differences(void) {
    for (int variant = 0; variant < 4; ++variant) {
        AmbScene *scene = stretched_sphere(variant & 1, (variant & 2) != 0);
        uint64_t state = 3;
        double worst = 0.0, largest = 0.0;
        for (int trial = 0; trial < 500; ++trial) {
            Hit hit;
            ENSURE(
                scene_intersect(scene, STRETCHED_CENTER, random_direction(&state), INFINITY, &hit));
            /* Two places of the same triangle, in barycentrics. */
            hit.u = (float)test_uniform(&state, 0.1, 0.4);
            hit.v = (float)test_uniform(&state, 0.1, 0.4);
            const double du = test_uniform(&state, -1, 1), dv = test_uniform(&state, -1, 1);
            const float h = 0.02f;
            Hit plus = hit, minus = hit;
            plus.u += h * (float)du;
            plus.v += h * (float)dv;
            minus.u -= h * (float)du;
            minus.v -= h * (float)dv;
            const SurfacePoint a = scene_surface(scene, &minus), b = scene_surface(scene, &plus);
            const Vec3 dn = scene_normal_derivative(scene, &hit, vec3_sub(b.p, a.p));
            const Vec3 expected = vec3_sub(b.ns, a.ns);
            worst = test_worse(worst, (double)vec3_length(vec3_sub(dn, expected)));
            largest = fmax(largest, (double)vec3_length(expected));
        }
        ENSURE(largest > 5e-3);
        /* The steps are differences of positions at 7 m, known to 5e-7, in triangles of 0.1 m over
         * which normals turn by up to 0.4. */
        ENSURE_NEAR(worst, 0.0, 5e-6);
        amb_scene_destroy(scene);
    }
}

static void flat_and_broken_normals_are_the_face(void) {
    Shape plane = shape_plane();
    static const float odd[4][3] = {
        {0, 0, 0}, {(float)NAN, 0, 1}, {0, 0, (float)INFINITY}, {0, 0, -3}};
    for (int variant = 0; variant < 3; ++variant) {
        AmbScene *scene = begin_scene();
        if (variant == 1)
            memcpy(plane.normals, odd, sizeof odd);
        if (variant == 2)
            memset(plane.normals, 0, 12 * sizeof(float));
        const AmbMesh mesh = shape_mesh(&plane, "plane", variant > 0);
        shape_add(scene, &mesh, add_resin(scene, 1.5f), 2.0f, 0, 0, 0);
        finish_scene(scene);
        for (float x = -0.9f; x < 1.0f; x += 0.3f) {
            Hit hit;
            ENSURE(scene_intersect(scene, vec3(x, 0.31f, 5), vec3(0, 0, -1), INFINITY, &hit));
            ENSURE_NEAR(hit.t, 5.0, 1e-6);
            const SurfacePoint s = scene_surface(scene, &hit);
            ENSURE_NEAR(vec3_dot(s.ng, s.ns), 1.0, 1e-6);
            ENSURE_NEAR(fabsf(s.ns.z), 1.0, 1e-6);
            const Vec3 dn = scene_normal_derivative(scene, &hit, vec3(1, 0, 0));
            ENSURE_NEAR(vec3_length(dn), 0.0, 1e-6);
        }
        amb_scene_destroy(scene);
    }
    shape_free(&plane);
}

static AmbScene *scene_of(Shape *shape, bool is_smooth) {
    AmbScene *scene = begin_scene();
    const AmbMesh mesh = shape_mesh(shape, "faces", is_smooth);
    shape_add(scene, &mesh, add_resin(scene, 1.5f), 1.0f, 0, 0, 0);
    finish_scene(scene);
    return scene;
}

/* A third corner in the middle of two, exactly: rays at such a line would meet it by rounding. */
static void faces_without_area_are_not_met(void) {
    enum { FACES = 200 };
    float positions[9 * FACES];
    uint32_t triangles[3 * FACES];
    uint64_t state = 1;
    for (uint32_t t = 0; t < FACES; ++t)
        for (uint32_t k = 0; k < 3; ++k) {
            float *p = positions + 9 * t + k;
            p[0] = (float)floor(test_uniform(&state, -4096, 4096)) / 4096.0f;
            p[3] = (float)floor(test_uniform(&state, -4096, 4096)) / 4096.0f;
            p[6] = 0.5f * (p[0] + p[3]);
            triangles[3 * t + k] = 3 * t + k;
        }
    Shape shape = {.positions = positions,
                   .triangles = triangles,
                   .vertex_count = 3 * FACES,
                   .triangle_count = FACES};
    AmbScene *scene = scene_of(&shape, false);
    int met = 0;
    for (uint32_t trial = 0; trial < 100 * FACES; ++trial) {
        const float *p = positions + 9 * (trial % FACES);
        const Vec3 to =
            vec3_madd(vec3_scale(vec3(p[0], p[1], p[2]), 0.3f), 0.7f, vec3(p[3], p[4], p[5]));
        const Vec3 o = vec3_scale(random_direction(&state), 3.0f);
        Hit hit;
        met += scene_intersect(scene, o, vec3_normalize(vec3_sub(to, o)), INFINITY, &hit);
    }
    ENSURE_NEAR(met, 0, 0);
    amb_scene_destroy(scene);
}

/* Both long edges are the same once their ends are subtracted in floats. */
static void slivers_from_far_away_have_a_normal(void) {
    float positions[9] = {-18052948, 16491034, 6299229, -0.37f, -2.04f,
                          -1.13f,    -1.25f,   -0.89f,  -0.51f};
    float normals[9] = {0, 0, 1, 0, 0.6f, 0.8f, 0.6f, 0, 0.8f};
    uint32_t triangle[3] = {0, 1, 2};
    Shape shape = {.positions = positions,
                   .normals = normals,
                   .triangles = triangle,
                   .vertex_count = 3,
                   .triangle_count = 1};
    AmbScene *scene = scene_of(&shape, true);
    const Hit hit = {.u = 0.1f, .v = 0.8f};
    const SurfacePoint surface = scene_surface(scene, &hit);
    const Vec3 edge =
        vec3(positions[6] - positions[3], positions[7] - positions[4], positions[8] - positions[5]);
    const Vec3 far = vec3_normalize(vec3(positions[0], positions[1], positions[2]));
    ENSURE_NEAR(vec3_length(surface.ng), 1.0, 1e-6);
    ENSURE_NEAR(vec3_dot(surface.ng, edge), 0.0, 1e-6);
    ENSURE_NEAR(vec3_dot(surface.ng, far), 0.0, 1e-6);
    /* Along the short edge normals go from the second corner's to the third's. */
    const Vec3 dn = scene_normal_derivative(scene, &hit, edge);
    const SurfacePoint next = scene_surface(scene, &(Hit){.u = 0.099f, .v = 0.801f});
    ENSURE_NEAR(vec3_length(vec3_sub(vec3_sub(next.ns, surface.ns), vec3_scale(dn, 1e-3f))), 0.0,
                1e-5);
    amb_scene_destroy(scene);
}

/* A ray that goes on from a surface never meets the same surface again, near the origin and far
 * from it, on large triangles and at grazing angles. */
static void leaving_a_surface_is_final(void) {
    static const float places[] = {0.0f, 1.0f, 1e4f};
    static const float scales[] = {1e-3f, 1.0f, 1e3f};
    Shape box = shape_box();
    const AmbMesh mesh = shape_mesh(&box, "box", false);
    for (size_t i = 0; i < 3; ++i)
        for (size_t k = 0; k < 3; ++k) {
            /* A box of millimetres ten kilometres away is smaller than floats there resolve. */
            if (places[i] * 1e-6f > 0.1f * scales[k])
                continue;
            AmbScene *scene = begin_scene();
            shape_add(scene, &mesh, add_resin(scene, 1.5f), scales[k], places[i], -places[i],
                      0.5f * places[i]);
            finish_scene(scene);
            const Vec3 center = scene->center;
            uint64_t state = 4;
            int again = 0, hits = 0;
            for (int trial = 0; trial < 3000; ++trial) {
                Hit hit;
                if (!scene_intersect(scene, center, random_direction(&state), INFINITY, &hit))
                    continue;
                ++hits;
                const SurfacePoint s = scene_surface(scene, &hit);
                /* Outward, down to 0.1 degrees above the face. */
                Vec3 x, y;
                vec3_frame(s.ng, &x, &y);
                const float up = (float)exp(test_uniform(&state, -6.0, 0.0));
                const float turn = (float)test_uniform(&state, 0.0, 6.28);
                Vec3 d = vec3_madd(vec3_scale(x, cosf(turn)), sinf(turn), y);
                d = vec3_normalize(vec3_madd(d, up, s.ng));
                again += scene_intersect(scene, scene_leave(&s, d), d, INFINITY, &hit);
                /* Inward: another face comes, at a distance. */
                const Vec3 in = vec3_madd(d, -2.0f * vec3_dot(d, s.ng), s.ng);
                const uint32_t before = hit.triangle;
                if (scene_intersect(scene, scene_leave(&s, in), in, INFINITY, &hit))
                    again += hit.triangle == before && hit.t < 1e-5f * scales[k];
            }
            ENSURE(hits == 3000);
            ENSURE(again == 0);
            amb_scene_destroy(scene);
        }
    shape_free(&box);
}

/* ---- Lights ---------------------------------------------------------------------------------- */

static SceneLight light_of(const AmbLight *light) {
    AmbScene *scene = begin_scene();
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_light(scene, light, &id), AMB_OK);
    SceneLight copy = scene->lights[0];
    copy.name = NULL; /* dies with the scene */
    amb_scene_destroy(scene);
    return copy;
}

/* Flux of all rays, and of those that reach the target sphere. */
static void emitted(const LightEmission *emission, double *out_total, double *out_hitting) {
    *out_total = *out_hitting = 0.0;
    for (uint64_t i = 0; i < emission->count; ++i) {
        const LightRay ray = light_emit(emission, i);
        *out_total += (double)ray.flux.g;
        const Vec3 to = vec3_sub(emission->target, ray.o);
        const float along = vec3_dot(to, ray.d);
        const Vec3 miss = vec3_madd(to, -along, ray.d);
        if (vec3_dot(miss, miss) <= emission->target_radius * emission->target_radius &&
            along > -emission->target_radius)
            *out_hitting += (double)ray.flux.g;
    }
}

static void emission_of_a_point_fills_the_cap(void) {
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_POINT);
    light.color[1] = 3.0f;
    light.position[2] = 5.0f;
    SceneLight point = light_of(&light);
    LightEmission emission = {.light = &point, .target_radius = 2.0f, .count = 5000};
    double total, hitting;
    emitted(&emission, &total, &hitting);
    const double cap = 2.0 * PI * (1.0 - sqrt(1.0 - 4.0 / 25.0));
    ENSURE_NEAR(total / (3.0 * cap), 1.0, 1e-5);
    ENSURE_NEAR(hitting / total, 1.0, 1e-3);
    ENSURE_NEAR((double)light_power_towards(&emission) / (cap * (3.0 + 1.0 + 1.0) / 3.0), 1.0,
                1e-6);
    /* Inside of the target, and asked for every direction: the whole sphere. */
    emission.target_radius = 6.0f;
    emitted(&emission, &total, &hitting);
    ENSURE_NEAR(total / (3.0 * 4.0 * PI), 1.0, 1e-5);
    emission.target_radius = INFINITY;
    emitted(&emission, &total, &hitting);
    ENSURE_NEAR(total / (3.0 * 4.0 * PI), 1.0, 1e-5);
    /* A small and far target keeps its digits. */
    emission.target_radius = 1e-3f;
    emission.target = vec3(0, 0, -995.0f);
    emitted(&emission, &total, &hitting);
    ENSURE_NEAR(total / (3.0 * PI * 1e-12), 1.0, 1e-4);
    /* With a radius every direction has the same intensity, and the cap is wider. */
    light.radius = 0.5f;
    point = light_of(&light);
    emission = (LightEmission){.light = &point, .target_radius = 2.0f, .count = 20000};
    emitted(&emission, &total, &hitting);
    const double wider = 2.0 * PI * (1.0 - sqrt(1.0 - 2.5 * 2.5 / 25.0));
    ENSURE_NEAR(total / (3.0 * wider), 1.0, 1e-5);
    /* What reaches the target is as if from a point, to second order in radius / distance. */
    ENSURE_NEAR(hitting / (3.0 * cap), 1.0, 0.01);
}

static void emission_of_a_spot_is_its_cone(void) {
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_SPOT);
    light.position[2] = 5.0f;
    light.spot_size = 0.1f;
    SceneLight spot = light_of(&light);
    /* Narrow spot, wide target: rays fill the cone. */
    LightEmission emission = {.light = &spot, .target_radius = 4.0f, .count = 20000};
    double total, hitting;
    emitted(&emission, &total, &hitting);
    const double cone = 2.0 * PI * (1.0 - cos(0.05));
    ENSURE_NEAR(total / cone, 1.0, 1e-4);
    ENSURE_NEAR(hitting / total, 1.0, 1e-6);
    ENSURE_NEAR((double)light_power_towards(&emission) / cone, 1.0, 1e-4);
    /* Blend 1 from axis to edge: x uniform over the cone in 1 - cos, int 3x^2 - 2x^3 = 1/2. */
    light.spot_blend = 1.0f;
    spot = light_of(&light);
    emitted(&emission, &total, &hitting);
    ENSURE_NEAR(total / cone, 0.5, 1e-4);
    /* Blender 3.4's cosine: over the half space its mean is 1/2. */
    light.spot_blend = 0.0f;
    light.spot_size = (float)PI;
    light.spot_cosine = 1.0f;
    spot = light_of(&light);
    emission.target_radius = INFINITY;
    emitted(&emission, &total, &hitting);
    ENSURE_NEAR(total / PI, 1.0, 1e-3);
    /* Turned away from a small target: nothing. */
    light.direction[2] = 1.0f;
    spot = light_of(&light);
    emission.target_radius = 0.1f;
    emitted(&emission, &total, &hitting);
    ENSURE(total == 0.0);
}

static void emission_of_a_sun_is_irradiance_times_disc(void) {
    for (int soft = 0; soft < 2; ++soft) {
        AmbLight light;
        amb_light_init(&light, AMB_LIGHT_SUN);
        light.color[1] = 4.0f;
        light.direction[0] = 1.0f;
        light.angle = soft ? 0.1f : 0.0f;
        const SceneLight sun = light_of(&light);
        const LightEmission emission = {.light = &sun,
                                        .target = {1, 2, 3},
                                        .target_radius = 1.5f,
                                        .distance = 10.0f,
                                        .count = 5000};
        double total, hitting;
        emitted(&emission, &total, &hitting);
        /* Irradiance is given across the axis; a sphere faces every direction of the disc alike. */
        const double mean_cosine = soft ? 0.5 * (1.0 + cos(0.05)) : 1.0;
        ENSURE_NEAR(total * mean_cosine / (4.0 * PI * 2.25), 1.0, 1e-5);
        ENSURE_NEAR(hitting / total, 1.0, 1e-3);
        double mean = 0.0, edge = 0.0;
        for (uint64_t i = 0; i < emission.count; ++i) {
            const LightRay ray = light_emit(&emission, i);
            const double cosine = (double)vec3_dot(ray.d, sun.direction);
            mean += (1.0 - cosine) / (double)emission.count;
            edge = fmax(edge, 1.0 - cosine);
        }
        /* The source's pairs are those of a point on the target, wherever rays begin. */
        for (int k = TANGENT_LATTICE; k < TANGENT_COUNT; ++k) {
            const TangentPair pair = light_emit(&emission, 17).pairs[k];
            ENSURE_NEAR(vec3_length(pair.dd), soft ? sqrt(3.0) * 0.05 : 0.0, 1e-6);
            ENSURE_NEAR(vec3_length(vec3_madd(pair.dp, 10.0f, pair.dd)), 0.0, 1e-6);
        }
        /* Uniform over the disc of radius 0.05: half of the edge. */
        const double limit = soft ? 1.0 - cos(0.05) : 0.0;
        ENSURE_NEAR(mean, 0.5 * limit, 1e-5);
        ENSURE_NEAR(edge, limit, 2e-6);
    }
}

static void emission_of_an_area_is_lambertian(void) {
    for (uint32_t shape = AMB_AREA_RECTANGLE; shape <= AMB_AREA_ELLIPSE; ++shape) {
        AmbLight light;
        amb_light_init(&light, AMB_LIGHT_AREA);
        light.position[2] = 3.0f;
        light.size[0] = 1.0f;
        light.size[1] = 0.5f;
        light.area_shape = shape;
        const SceneLight area = light_of(&light);
        const double measure = shape == AMB_AREA_ELLIPSE ? 0.5 * PI / 4.0 : 0.5;
        LightEmission emission = {
            .light = &area, .target_radius = INFINITY, .count = 100000, .shift_u = 0.3f};
        double total, hitting;
        emitted(&emission, &total, &hitting);
        ENSURE_NEAR(total / (PI * measure), 1.0, 1e-3); /* one side only: pi L A */
        /* A sphere far away: L A R^2 pi / d^2, seen head on. */
        emission.target = vec3(0, 0, -97.0f);
        emission.target_radius = 1.0f;
        emitted(&emission, &total, &hitting);
        ENSURE_NEAR(hitting / (measure * PI / 1e4), 1.0, 1e-3);
        /* Nothing behind. */
        emission.target = vec3(0, 0, 103.0f);
        emitted(&emission, &total, &hitting);
        ENSURE(total == 0.0);
    }
}

/* The mean over the source's points, on a grid of strata. */
static double mean_arrival(const SceneLight *light, Vec3 p, Vec3 n) {
    enum { GRID = 100 };
    double sum = 0.0;
    for (int i = 0; i < GRID; ++i)
        for (int k = 0; k < GRID; ++k) {
            const Sample2 u = {((float)i + 0.5f) / GRID, ((float)k + 0.5f) / GRID};
            const LightArrival arrival = light_arrival(light, p, u);
            sum += (double)(arrival.irradiance.g * fmaxf(vec3_dot(arrival.wi, n), 0.0f));
        }
    return sum / (GRID * GRID);
}

static void arrival_matches_closed_forms(void) {
    const Vec3 up = vec3(0, 0, 1);
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_POINT);
    light.color[1] = 3.0f;
    light.position[2] = 2.0f;
    SceneLight scene_light = light_of(&light);
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(0, 0, 0), up), 3.0 / 4.0, 1e-6);
    /* cos^3 / h^2 to the side. */
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(1, 0, 0), up), 3.0 / 4.0 * pow(0.8, 1.5), 1e-6);
    /* On the light itself: nothing rather than infinity. */
    ENSURE(light_arrival(&scene_light, vec3(0, 0, 2), (Sample2){0.5f, 0.5f}).irradiance.g == 0.0f);

    /* A disc that faces the receiver, E = I / (d^2 + r^2) on its axis. */
    light.radius = 1.5f;
    scene_light = light_of(&light);
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(0, 0, 0), up), 3.0 / (4.0 + 2.25), 1e-4);

    /* Area light on its axis: ellipse of equal axes, E = pi L R^2 / (d^2 + R^2). */
    amb_light_init(&light, AMB_LIGHT_AREA);
    light.position[2] = 2.0f;
    light.size[0] = light.size[1] = 3.0f;
    light.area_shape = AMB_AREA_ELLIPSE;
    scene_light = light_of(&light);
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(0, 0, 0), up), PI * 2.25 / (4.0 + 2.25), 1e-4);
    ENSURE(mean_arrival(&scene_light, vec3(0, 0, 5), vec3(0, 0, -1)) == 0.0);
    /* Square of half-width a: E = L 4 (a/s) atan(a/s) with s^2 = a^2 + d^2. */
    light.area_shape = AMB_AREA_RECTANGLE;
    scene_light = light_of(&light);
    const double s = sqrt(1.5 * 1.5 + 4.0);
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(0, 0, 0), up), 4.0 * 1.5 / s * atan(1.5 / s), 1e-4);

    amb_light_init(&light, AMB_LIGHT_SUN);
    light.angle = 0.2f;
    scene_light = light_of(&light);
    const LightArrival sun = light_arrival(&scene_light, vec3(7, 8, 9), (Sample2){0.3f, 0.6f});
    ENSURE(isinf(sun.distance));
    /* Its strength is what a plane across its axis gets. */
    ENSURE_NEAR(mean_arrival(&scene_light, vec3(0, 0, 0), up), 1.0, 1e-5);
}

/* Irradiance by the radiance that is seen, over a grid of directions by the cosine around z. */
static double seen_irradiance(const SceneLight *light, Vec3 p) {
    enum { GRID = 600 };
    double sum = 0.0;
    for (int i = 0; i < GRID; ++i)
        for (int k = 0; k < GRID; ++k) {
            const Sample2 u = {((float)i + 0.5f) / GRID, ((float)k + 0.5f) / GRID};
            float t = 0.0f;
            const Rgb radiance = light_seen(light, p, sample_cosine_hemisphere(u), INFINITY, &t);
            ENSURE(!(radiance.g > 0.0f) || t > 0.0f);
            sum += (double)radiance.g;
        }
    return PI * sum / (GRID * GRID);
}

static void what_is_seen_is_what_arrives(void) {
    static const uint32_t kinds[] = {AMB_LIGHT_POINT, AMB_LIGHT_SPOT, AMB_LIGHT_SUN, AMB_LIGHT_AREA,
                                     AMB_LIGHT_AREA};
    for (uint32_t i = 0; i < 5; ++i) {
        AmbLight light;
        amb_light_init(&light, kinds[i]);
        light.position[0] = 0.4f;
        light.position[2] = 2.0f;
        light.radius = 0.8f;
        light.angle = 0.6f;
        light.size[0] = 1.5f;
        light.size[1] = 1.0f;
        light.spot_size = 1.2f;
        light.spot_blend = 0.5f;
        light.area_shape = i == 3 ? AMB_AREA_RECTANGLE : AMB_AREA_ELLIPSE;
        const SceneLight lamp = light_of(&light);
        ENSURE(light_has_extent(&lamp));
        for (int k = 0; k < 3; ++k) {
            const Vec3 p = vec3(0.3f * (float)k, 0.2f, 0.0f);
            const double arrives = mean_arrival(&lamp, p, vec3(0, 0, 1));
            ENSURE_NEAR(seen_irradiance(&lamp, p) / arrives, 1.0, 0.01);
        }
        /* Not from behind, and not beyond what is asked. */
        float t = 0.0f;
        ENSURE(light_seen(&lamp, vec3(0.4f, 0, 0), vec3(0, 0, 1), 2.1f, &t).g > 0.0f ||
               kinds[i] == AMB_LIGHT_SUN);
        ENSURE(light_seen(&lamp, vec3(0.4f, 0, 0), vec3(0, 0, 1), 1.9f, &t).g == 0.0f);
        ENSURE(light_seen(&lamp, vec3(0.4f, 0, 0), vec3(0, 0, -1), INFINITY, &t).g == 0.0f);
    }
}

static void spot_edge_is_a_smoothstep(void) {
    AmbLight light;
    amb_light_init(&light, AMB_LIGHT_SPOT);
    light.spot_size = 1.0f;
    light.spot_blend = 0.4f;
    const SceneLight spot = light_of(&light);
    const double outer = cos(0.5);
    for (double angle = 0.0; angle < 0.7; angle += 0.01) {
        const double x = fmin(fmax((cos(angle) - outer) / ((1.0 - outer) * 0.4), 0.0), 1.0);
        const Vec3 p = vec3((float)sin(angle), 0, (float)-cos(angle));
        const LightArrival arrival = light_arrival(&spot, p, (Sample2){0, 0});
        ENSURE_NEAR(arrival.irradiance.g, x * x * (3.0 - 2.0 * x), 1e-5);
        ENSURE(vec3_dot(arrival.wi, p) < -0.999f);
    }
}

/* ---- Camera ---------------------------------------------------------------------------------- */

static void camera_rays_pass_the_window(void) {
    AmbScene *scene = begin_scene();
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    camera.clip_start = 0.5f;
    camera.clip_end = 20.0f;
    camera.window[0] = -1.0f;
    camera.window[1] = 2.0f;
    camera.to_world[3] = 10.0f;
    /* Scale of the transform is removed. */
    for (int i = 0; i < 3; ++i)
        camera.to_world[5 * i] = 7.0f;
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    const Sample2 center = {0, 0};
    CameraRay ray = camera_ray(&scene->camera, 1.0f, 0.5f, center);
    ENSURE_NEAR(ray.d.x / -ray.d.z, 2.0, 1e-6);
    ENSURE_NEAR(ray.d.y, 0.0, 1e-7);
    ENSURE_NEAR(ray.o.z, -0.5, 1e-6);
    ENSURE_NEAR(ray.o.x, 10.0 + 0.5 * 2.0, 1e-5);
    ENSURE_NEAR(ray.o.z + ray.t_max * ray.d.z, -20.0, 1e-4);
    ENSURE_NEAR(ray.depth_o + ray.t_max * ray.cos_axis, 20.0, 1e-4);
    ray = camera_ray(&scene->camera, 0.0f, 0.0f, center);
    ENSURE_NEAR(ray.d.x / -ray.d.z, -1.0, 1e-6);
    ENSURE_NEAR(ray.d.y / -ray.d.z, -0.5, 1e-6);

    /* All rays of a lens meet in the plane of focus. */
    camera.lens_radius = 0.3f;
    camera.focus_distance = 4.0f;
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    uint64_t state = 5;
    for (int i = 0; i < 100; ++i) {
        const Sample2 lens = {(float)test_uniform(&state, 0, 1), (float)test_uniform(&state, 0, 1)};
        ray = camera_ray(&scene->camera, 0.9f, 0.2f, lens);
        const float t = (-4.0f - ray.o.z) / ray.d.z;
        ENSURE_NEAR(ray.o.x + t * ray.d.x, 10.0 + 4.0 * 1.7, 2e-5);
        ENSURE_NEAR(ray.o.y + t * ray.d.y, 4.0 * -0.3, 1e-5);
    }

    amb_camera_init(&camera, AMB_CAMERA_ORTHOGRAPHIC);
    camera.clip_start = -3.0f;
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    ray = camera_ray(&scene->camera, 1.0f, 0.0f, center);
    ENSURE(ray.d.z == -1.0f && ray.cos_axis == 1.0f);
    ENSURE_NEAR(ray.o.x, 0.5, 1e-7);
    ENSURE_NEAR(ray.o.y, -0.5, 1e-7);
    ENSURE_NEAR(ray.o.z, 3.0, 1e-6);
    amb_scene_destroy(scene);
}

void test_scene(void);

void test_scene(void) {
    RUN(media_at_a_point_are_its_enclosing_objects);
    RUN(crossing_keeps_the_stack_of_media);
    RUN(crossing_knows_what_cannot_be);
    RUN(outside_stays_outside);
    RUN(normal_derivative_matches_finite_differences);
    RUN(flat_and_broken_normals_are_the_face);
    RUN(faces_without_area_are_not_met);
    RUN(slivers_from_far_away_have_a_normal);
    RUN(leaving_a_surface_is_final);
    RUN(emission_of_a_point_fills_the_cap);
    RUN(emission_of_a_spot_is_its_cone);
    RUN(emission_of_a_sun_is_irradiance_times_disc);
    RUN(emission_of_an_area_is_lambertian);
    RUN(arrival_matches_closed_forms);
    RUN(what_is_seen_is_what_arrives);
    RUN(spot_edge_is_a_smoothstep);
    RUN(camera_rays_pass_the_window);
}
