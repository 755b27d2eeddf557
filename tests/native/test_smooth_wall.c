/* SPDX-License-Identifier: GPL-3.0-or-later
 * Photons at boundaries with interpolated normals against camera paths there: where light is alike
 * from all sides, what goes on is what cameras see. */
#include "field/scatter/smooth_wall.h"
#include "math/sampling.h"
#include "shapes.h"
#include "test.h"

static const float IOR = 1.4f;

/* One object with an index, whose mesh does not matter: faces are made up. */
static AmbScene *make_object(void) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    const AmbMaterial material = shape_resin(IOR, 1.0f, 0.0f, 0.0f);
    uint32_t id = 0;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    Shape sphere = shape_sphere(8, 16);
    const AmbMesh mesh = shape_mesh(&sphere, "sphere", true);
    shape_add(scene, &mesh, id, 1.0f, 0, 0, 0);
    shape_free(&sphere);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Job job;
    job_init(&job, 1);
    ENSURE_STATUS(scene_build(scene, &job), AMB_OK);
    return scene;
}

/* What goes one way: flux, and its first moments off and along the face. */
typedef struct Moments {
    double sum[3];
} Moments;

static void add(Moments *moments, Vec3 d, double weight) {
    moments->sum[0] += weight;
    moments->sum[1] += weight * (double)d.z;
    moments->sum[2] += weight * (double)d.x;
}

typedef struct Wall {
    const AmbScene *scene;
    SurfacePoint surface;
    bool is_inside; /* where the light comes from */
} Wall;

static BoundaryCrossing cross(const Wall *wall, bool is_inside, Vec3 d) {
    const MediumStack stack = {.count = is_inside ? 1 : 0};
    return boundary_cross(wall->scene, &stack, &wall->surface, d);
}

static Sample2 random2(uint64_t *state) {
    const double below = 1.0 - 0x1p-24; /* a float rounds to 1 beyond */
    const float u = (float)test_uniform(state, 0.0, below);
    return (Sample2){u, (float)test_uniform(state, 0.0, below)};
}

static Vec3 cosine_direction(uint64_t *state, bool is_up) {
    const Vec3 d = sample_cosine_hemisphere(random2(state));
    return vec3(d.x, d.y, is_up ? d.z : -d.z);
}

/* [0]: reflected, [1]: refracted; by photons, and as cameras see it. */
static void compare(const Wall *wall, int count, Moments photons[2], Moments cameras[2]) {
    uint64_t state = 1;
    for (int i = 0; i < count; ++i) {
        /* Light that arrives is alike from all sides of the hemisphere: its flux as the cosine. */
        const Vec3 d = cosine_direction(&state, wall->is_inside);
        const BoundaryCrossing crossing = cross(wall, wall->is_inside, d);
        const WallTurn turn = smooth_wall_turn(&crossing, d, random2(&state));
        add(&photons[turn.is_refracted], turn.d, (double)turn.weight / count);
        for (int k = 0; k < 2; ++k) {
            const bool is_inside = (k == 0) == wall->is_inside;
            const Vec3 back = cosine_direction(&state, is_inside);
            const BoundaryCrossing seen = cross(wall, is_inside, back);
            const double part =
                k == 0 ? (double)seen.split.reflectance
                       : (1.0 - (double)seen.split.reflectance) * (double)(seen.eta * seen.eta);
            add(&cameras[k], vec3_negate(back), part / count);
        }
    }
}

static void light_goes_as_cameras_see_it(void) {
    AmbScene *scene = make_object();
    const float tilts[5] = {0.0f, 0.1f, 0.4f, 0.7f, 0.9f};
    for (int i = 0; i < 10; ++i) {
        const float tilt = tilts[i / 2];
        const Wall wall = {.scene = scene,
                           .surface = {.ng = vec3(0, 0, 1),
                                       .ns = vec3(sinf(tilt), 0, cosf(tilt)),
                                       .material = &scene->materials[0],
                                       .object = 0},
                           .is_inside = i % 2 == 0};
        Moments photons[2] = {{{0}}}, cameras[2] = {{{0}}};
        compare(&wall, test_is_long() ? 4000000 : 200000, photons, cameras);
        for (int k = 0; k < 2; ++k)
            for (int m = 0; m < 3; ++m) {
                /* Camera paths that leave, and are laid into the face then, have no light that
                 * comes to them. */
                const double missing = k == 1 && !wall.is_inside ? 0.035 : 0.0;
                ENSURE_NEAR(photons[k].sum[m], cameras[k].sum[m], 0.01 + missing);
            }
    }
    amb_scene_destroy(scene);
}

void test_smooth_wall(void);
void test_smooth_wall(void) {
    RUN(light_goes_as_cameras_see_it);
}
