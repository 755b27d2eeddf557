/* SPDX-License-Identifier: GPL-3.0-or-later
 * Images on opaque surfaces: what is seen where. */
#include <string.h>

#include "scene/scene.h"
#include "test.h"

/* Red counts the pixel, from the bottom left. */
static SceneTexture numbered(Rgb pixels[6], uint32_t extension, bool is_closest) {
    for (int i = 0; i < 6; ++i)
        pixels[i] = rgb(0.1f * (float)i, 0.0f, 1.0f);
    return (SceneTexture){.name = NULL,
                          .width = 3,
                          .height = 2,
                          .extension = extension,
                          .is_closest = is_closest,
                          .pixels = pixels};
}

static float seen(const SceneTexture *texture, float x, float y) {
    const Rgb color = texture_color(texture, (Vec2){x, y});
    ENSURE(color.g == 0.0f);
    return 10.0f * color.r;
}

static void pixels_have_their_places(void) {
    Rgb pixels[6];
    const SceneTexture closest = numbered(pixels, AMB_EXTENSION_REPEAT, true);
    for (uint32_t i = 0; i < 6; ++i)
        for (int k = 0; k < 9; ++k) {
            const uint32_t row = i / 3;
            const int step = k / 3;
            const float x = ((float)(i % 3) + 0.1f + 0.4f * (float)(k % 3)) / 3.0f;
            const float y = ((float)row + 0.1f + 0.4f * (float)step) / 2.0f;
            ENSURE_NEAR(seen(&closest, x, y), (double)i, 1e-5);
        }
    const SceneTexture linear = numbered(pixels, AMB_EXTENSION_REPEAT, false);
    ENSURE_NEAR(seen(&linear, 0.5f / 3.0f, 0.25f), 0.0, 1e-5);
    ENSURE_NEAR(seen(&linear, 1.5f / 3.0f, 0.75f), 4.0, 1e-5);
    ENSURE_NEAR(seen(&linear, 1.0f / 3.0f, 0.5f), (0 + 1 + 3 + 4) / 4.0, 1e-5);
    ENSURE_NEAR(seen(&linear, 1.25f / 3.0f, 0.25f), 0.75, 1e-5);
}

static void edges_go_on_as_they_are_told(void) {
    Rgb pixels[6];
    const struct {
        uint32_t extension;
        float left, right, above; /* of pixel 0; closest, a third of a pixel beyond the edge */
        float seam;               /* linear, at x = 0 in the middle of the lower row */
    } known[4] = {{AMB_EXTENSION_REPEAT, 2, 0, 0, 1.0f},
                  {AMB_EXTENSION_EDGE, 0, 2, 3, 0.0f},
                  {AMB_EXTENSION_CLIP, 0, 0, 0, 0.0f},
                  {AMB_EXTENSION_MIRROR, 0, 2, 3, 0.0f}};
    for (int i = 0; i < 4; ++i) {
        const SceneTexture closest = numbered(pixels, known[i].extension, true);
        ENSURE_NEAR(seen(&closest, -0.1f, 0.25f), known[i].left, 1e-5);
        ENSURE_NEAR(seen(&closest, 1.1f, 0.25f), known[i].right, 1e-5);
        ENSURE_NEAR(seen(&closest, 0.1f, 1.1f), known[i].above, 1e-5);
        const SceneTexture linear = numbered(pixels, known[i].extension, false);
        ENSURE_NEAR(seen(&linear, 0.0f, 0.25f), known[i].seam, 1e-5);
        /* A whole turn, and two where it is mirrored, change nothing. */
        if (known[i].extension == AMB_EXTENSION_REPEAT)
            ENSURE_NEAR(seen(&linear, 5.4f, -2.7f), seen(&linear, 0.4f, 0.3f), 1e-4);
        if (known[i].extension == AMB_EXTENSION_MIRROR) {
            ENSURE_NEAR(seen(&linear, 4.4f, -1.7f), seen(&linear, 0.4f, 0.3f), 1e-4);
            ENSURE_NEAR(seen(&linear, 1.6f, -0.3f), seen(&linear, 0.4f, 0.3f), 1e-4);
        }
        const Rgb outside = texture_color(&closest, (Vec2){-0.1f, 0.25f});
        ENSURE(outside.b == (known[i].extension == AMB_EXTENSION_CLIP ? 0.0f : 1.0f));
    }
}

static void any_place_has_a_colour(void) {
    static const float places[] = {(float)NAN, (float)INFINITY, -(float)INFINITY, 3e38f, -3e38f,
                                   1e10f,      -1e-30f,         -1e-9f,           1.0f,  0x1p-149f};
    enum { COUNT = sizeof places / sizeof places[0] };
    Rgb pixels[6];
    for (uint32_t extension = 0; extension < 4; ++extension)
        for (int k = 0; k < 2 * COUNT * COUNT; ++k) {
            const SceneTexture texture = numbered(pixels, extension, k % 2 == 0);
            const float number = seen(&texture, places[k / 2 % COUNT], places[k / 2 / COUNT]);
            ENSURE(number >= 0.0f && number <= 5.0001f);
        }
}

/* A triangle whose corners have coordinates, and a material that turns and moves them. */
static void surfaces_find_their_place(void) {
    static const float positions[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    static const uint32_t triangle[3] = {0, 1, 2};
    static const float uvs[6] = {0.1f, 0.2f, 0.5f, 0.2f, 0.1f, 0.8f};
    static const float color[6] = {0.2f, 0.4f, 0.6f, 0.8f, 1.0f, 0.0f}; /* two pixels */
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbTexture texture;
    amb_texture_init(&texture);
    texture.width = 2;
    texture.height = 1;
    texture.interpolation = AMB_INTERPOLATION_CLOSEST;
    texture.color = color;
    AmbMaterial material;
    amb_material_init(&material);
    ENSURE_STATUS(amb_scene_add_texture(scene, &texture, &material.texture), AMB_OK);
    ENSURE(material.texture == 1);
    material.albedo[1] = 0.5f;
    const float turned[6] = {0, 1, 0.1f, -1, 0, 0}; /* (v + 0.1, -u) */
    memcpy(material.uv_to_texture, turned, sizeof turned);
    uint32_t id;
    ENSURE_STATUS(amb_scene_add_material(scene, &material, &id), AMB_OK);
    AmbMesh mesh;
    amb_mesh_init(&mesh);
    mesh.positions = positions;
    mesh.vertex_count = 3;
    mesh.triangles = triangle;
    mesh.triangle_count = 1;
    AmbObject object;
    amb_object_init(&object);
    object.materials = &id;
    object.material_count = 1;
    for (int k = 0; k < 2; ++k) {
        mesh.uvs = k == 0 ? uvs : NULL;
        ENSURE_STATUS(amb_scene_add_mesh(scene, &mesh, &object.mesh), AMB_OK);
        uint32_t placed;
        ENSURE_STATUS(amb_scene_add_object(scene, &object, &placed), AMB_OK);
    }
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Hit hit = {.geometry = 0, .triangle = 0, .u = 0.25f, .v = 0.25f};
    SurfacePoint surface = scene_surface(scene, &hit);
    Rgb albedo = scene_albedo(scene, &surface); /* v = 0.35, at 0.45: the left pixel */
    ENSURE_NEAR(albedo.r, 0.8 * 0.2, 1e-6);
    ENSURE_NEAR(albedo.g, 0.5 * 0.4, 1e-6);
    hit.v = 0.7f; /* v = 0.62, at 0.72: the right one */
    surface = scene_surface(scene, &hit);
    albedo = scene_albedo(scene, &surface);
    ENSURE_NEAR(albedo.r, 0.8 * 0.8, 1e-6);
    ENSURE_NEAR(albedo.b, 0.0, 1e-6);
    hit.geometry = 1; /* without coordinates: at 0.1 */
    surface = scene_surface(scene, &hit);
    ENSURE_NEAR(scene_albedo(scene, &surface).r, 0.8 * 0.2, 1e-6);
    amb_scene_destroy(scene);
}

void test_texture(void);
void test_texture(void) {
    RUN(pixels_have_their_places);
    RUN(edges_go_on_as_they_are_told);
    RUN(any_place_has_a_colour);
    RUN(surfaces_find_their_place);
}
