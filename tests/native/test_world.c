/* SPDX-License-Identifier: GPL-3.0-or-later
 * The world as an image: what is seen where, directions in proportion to it, and suns in it. */
#include <stdlib.h>
#include <string.h>

#include "scene/scene.h"
#include "scene/world_lamps.h"
#include "shapes.h"
#include "test.h"

static const double PI = 3.14159265358979323846;
static const float IDENTITY[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
/* A turn about (1, 1, 1): x to y, y to z, z to x. */
static const float CYCLE[9] = {0, 0, 1, 1, 0, 0, 0, 1, 0};

static Vec3 random_direction(uint64_t *state) {
    const double z = test_uniform(state, -1.0, 1.0), phi = test_uniform(state, 0.0, 2.0 * PI);
    const double r = sqrt(1.0 - z * z);
    return vec3((float)(r * cos(phi)), (float)(r * sin(phi)), (float)z);
}

static AmbScene *begin_scene(const float *pixels, uint32_t width, uint32_t height,
                             const float to_world[9]) {
    AmbScene *scene = NULL;
    ENSURE_STATUS(amb_scene_create(&scene), AMB_OK);
    AmbCamera camera;
    amb_camera_init(&camera, AMB_CAMERA_PERSPECTIVE);
    ENSURE_STATUS(amb_scene_set_camera(scene, &camera), AMB_OK);
    AmbWorldImage image;
    amb_world_image_init(&image);
    image.width = width;
    image.height = height;
    image.radiance = pixels;
    memcpy(image.to_world, to_world, sizeof image.to_world);
    ENSURE_STATUS(amb_scene_set_world_image(scene, &image), AMB_OK);
    return scene;
}

static AmbScene *image_scene(const float *pixels, uint32_t width, uint32_t height,
                             const float to_world[9]) {
    AmbScene *scene = begin_scene(pixels, width, height, to_world);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    return scene;
}

static float *random_pixels(uint32_t width, uint32_t height, uint64_t seed) {
    float *pixels = malloc(3 * sizeof(float) * width * height);
    for (uint32_t i = 0; i < 3 * width * height; ++i)
        pixels[i] = (float)test_uniform(&seed, 0.2, 1.0);
    return pixels;
}

/* Cycles' convention, written down once more: the middle is +x, a quarter to the left +y, the top
 * row +z. */
static void directions_are_where_cycles_has_them(void) {
    static const struct {
        float d[3];
        uint32_t x, y;
    } known[6] = {{{1, 0, 0}, 4, 1},  {{0, 1, 0}, 2, 1}, {{-1, 0, 0}, 0, 1},
                  {{0, -1, 0}, 6, 1}, {{0, 0, 1}, 0, 2}, {{0, 0, -1}, 0, 0}};
    for (int i = 0; i < 6; ++i) {
        /* An odd number of rows has its middle on the horizon; the pole is a whole row. */
        float image[3][8][3] = {{{0}}};
        const Vec3 d = vec3_from(known[i].d);
        const bool is_pole = known[i].y != 1;
        for (uint32_t x = 0; x < 8; ++x)
            if (is_pole || x == known[i].x || x + 1 == known[i].x || (known[i].x == 0 && x == 7))
                image[known[i].y][x][1] = 1.0f;
        AmbScene *scene = begin_scene(&image[0][0][0], 8, 3, IDENTITY);
        ENSURE_NEAR(world_radiance(&scene->world, d).g, 1.0, 1e-5);
        ENSURE(world_radiance(&scene->world, d).r == 0.0f);
        ENSURE_NEAR(world_radiance(&scene->world, vec3_negate(d)).g, 0.0, 1e-5);
        amb_scene_destroy(scene);
        /* The rotation takes x to y, y to z, z to x. */
        scene = begin_scene(&image[0][0][0], 8, 3, CYCLE);
        ENSURE_NEAR(world_radiance(&scene->world, vec3(d.z, d.x, d.y)).g, 1.0, 1e-5);
        amb_scene_destroy(scene);
    }
}

static void radiance_is_bilinear(void) {
    enum { WIDTH = 7, HEIGHT = 5 };
    float *pixels = random_pixels(WIDTH, HEIGHT, 3);
    AmbScene *scene = begin_scene(pixels, WIDTH, HEIGHT, CYCLE);
    const WorldImage *image = &scene->world.image;
    double worst = 0.0;
    for (int y = 0; y < HEIGHT; ++y)
        for (int x = 0; x < WIDTH; ++x)
            for (int k = 0; k < 4; ++k) {
                const float fx = 0.25f * (float)k, fy = y + 1 < HEIGHT ? 0.3f * (float)k : 0.0f;
                const Vec3 d = world_direction(image, (float)x + 0.5f + fx, (float)y + 0.5f + fy);
                ENSURE_NEAR(vec3_length(d), 1.0, 1e-6);
                const int right = (x + 1) % WIDTH, up = y + 1 < HEIGHT ? y + 1 : y;
                const float a = pixels[3 * (y * WIDTH + x)], b = pixels[3 * (y * WIDTH + right)];
                const float c = pixels[3 * (up * WIDTH + x)], e = pixels[3 * (up * WIDTH + right)];
                const float expected =
                    (1 - fy) * ((1 - fx) * a + fx * b) + fy * ((1 - fx) * c + fx * e);
                const float found = world_radiance(&scene->world, d).r;
                worst = test_worse(worst, fabs((double)(found - expected)));
            }
    ENSURE_NEAR(worst, 0.0, 1e-5);
    amb_scene_destroy(scene);
    free(pixels);
}

/* int f dw over the sphere by the midpoint rule on a grid that divides every pixel. */
static double integrate(const World *world, uint32_t columns, uint32_t rows,
                        double (*value)(const World *, Vec3)) {
    const WorldImage *image = &world->image;
    double sum = 0.0;
    for (uint32_t j = 0; j < rows; ++j) {
        const double weight = 2.0 * PI / columns * (cos(PI * j / rows) - cos(PI * (j + 1) / rows));
        const float y = ((float)j + 0.5f) * (float)image->height / (float)rows;
        for (uint32_t i = 0; i < columns; ++i) {
            const float x = ((float)i + 0.5f) * (float)image->width / (float)columns;
            sum += weight * value(world, world_direction(image, x, y));
        }
    }
    return sum;
}

static double green(const World *world, Vec3 d) {
    return (double)world_radiance(world, d).g;
}

static double green_but_lamps(const World *world, Vec3 d) {
    return (double)world_radiance_but_lamps(world, d).g;
}

static double density(const World *world, Vec3 d) {
    return (double)world_pdf(world, d);
}

static void pixels_weigh_what_they_light(void) {
    enum { WIDTH = 6, HEIGHT = 4 };
    float *pixels = random_pixels(WIDTH, HEIGHT, 5);
    AmbScene *scene = image_scene(pixels, WIDTH, HEIGHT, IDENTITY);
    ENSURE(scene->world_lamp_count == 0 && scene->light_count == 0);
    double sum = 0.0, solid_angle = 0.0;
    for (uint32_t y = 0; y < HEIGHT; ++y)
        for (uint32_t x = 0; x < WIDTH; ++x) {
            const double weight = world_pixel_weight(&scene->world.image, y);
            solid_angle += weight;
            sum += weight * (double)pixels[3 * (y * WIDTH + x) + 1];
        }
    ENSURE_NEAR(solid_angle, 4.0 * PI, 1e-6);
    ENSURE_NEAR(integrate(&scene->world, 60 * WIDTH, 60 * HEIGHT, green) / sum, 1.0, 2e-4);
    ENSURE_NEAR((double)scene->world.mean.g * 4.0 * PI / sum, 1.0, 1e-5);
    /* One pixel alone, and a world of one value. */
    static const float grey[3] = {0.5f, 0.25f, 2.0f};
    AmbScene *even = image_scene(grey, 1, 1, IDENTITY);
    uint64_t state = 1;
    for (int i = 0; i < 20; ++i) {
        const Rgb seen = world_radiance(&even->world, random_direction(&state));
        ENSURE_NEAR(seen.r + seen.g + seen.b, 2.75, 1e-6);
    }
    amb_scene_destroy(even);
    amb_scene_destroy(scene);
    free(pixels);
}

/* The density is one over the sphere, and that of the samples; the mean of radiance over density is
 * the integral of the radiance. */
static void samples_have_their_density(void) {
    enum { WIDTH = 8, HEIGHT = 6, SAMPLES = 200000 };
    float *pixels = random_pixels(WIDTH, HEIGHT, 7);
    for (int i = 0; i < 3 * WIDTH * HEIGHT; ++i)
        pixels[i] = i % 5 == 0 ? 0.0f : pixels[i] * pixels[i];
    /* A dark corner: nothing is sampled there, but its neighbours' light reaches into it. */
    memset(pixels, 0, sizeof(float) * 3 * 2);
    AmbScene *scene = image_scene(pixels, WIDTH, HEIGHT, CYCLE);
    const World *world = &scene->world;
    const double whole = integrate(world, 60 * WIDTH, 60 * HEIGHT, density);
    ENSURE_NEAR(whole, 1.0, 2e-4);
    double mean = 0.0, square = 0.0;
    int counts[8] = {0}, zero = 0;
    for (uint64_t i = 0; i < SAMPLES; ++i) {
        const Vec3 d = world_sample(world, sample_r2(i, 0.37f, 0.71f));
        const double pdf = (double)world_pdf(world, d);
        zero += !(pdf > 0.0);
        const double value = pdf > 0.0 ? (double)world_radiance(world, d).g / pdf : 0.0;
        mean += value / SAMPLES;
        square += value * value / SAMPLES;
        ++counts[(d.x > 0.0f) + 2 * (d.y > 0.0f) + 4 * (d.z > 0.0f)];
    }
    ENSURE(zero < SAMPLES / 10000); /* rounding at edges of pixels */
    const double expected = integrate(world, 60 * WIDTH, 60 * HEIGHT, green);
    ENSURE_NEAR(mean / expected, 1.0, 2e-3);
    /* Close to proportional: that is what it is for. */
    ENSURE(square / (mean * mean) < 1.6);
    uint64_t state = 2;
    double octants[8] = {0};
    for (int i = 0; i < 4 * SAMPLES; ++i) {
        const Vec3 d = random_direction(&state);
        octants[(d.x > 0.0f) + 2 * (d.y > 0.0f) + 4 * (d.z > 0.0f)] +=
            (double)world_pdf(world, d) * 4.0 * PI / (4.0 * SAMPLES);
    }
    for (int i = 0; i < 8; ++i)
        ENSURE_NEAR((double)counts[i] / SAMPLES, octants[i], 4e-3);
    amb_scene_destroy(scene);
    free(pixels);
}

/* ---- Suns ------------------------------------------------------------------------------------ */

enum { SKY_WIDTH = 256, SKY_HEIGHT = 128 };

/* A sky of 1 above and 0.1 below, brighter towards x. */
static float *sky_pixels(void) {
    float *pixels = malloc(3 * sizeof(float) * SKY_WIDTH * SKY_HEIGHT);
    for (int y = 0; y < SKY_HEIGHT; ++y)
        for (int x = 0; x < SKY_WIDTH; ++x)
            for (int c = 0; c < 3; ++c)
                pixels[3 * (y * SKY_WIDTH + x) + c] =
                    (y < SKY_HEIGHT / 2 ? 0.1f : 1.0f + 0.5f * (float)x / SKY_WIDTH) *
                    (1.0f + 0.1f * (float)c);
    return pixels;
}

static void add_disc(float *pixels, float x0, float y0, float radius, float value) {
    for (int y = 0; y < SKY_HEIGHT; ++y)
        for (int x = 0; x < SKY_WIDTH; ++x) {
            float dx = (float)x + 0.5f - x0;
            dx -= SKY_WIDTH * roundf(dx / SKY_WIDTH);
            const float dy = (float)y + 0.5f - y0;
            if (dx * dx + dy * dy <= radius * radius)
                for (int c = 0; c < 3; ++c)
                    pixels[3 * (y * SKY_WIDTH + x) + c] += value / (1.0f + (float)c);
        }
}

static double total_green(const float *pixels, const WorldImage *image) {
    double sum = 0.0;
    for (int y = 0; y < SKY_HEIGHT; ++y)
        for (int x = 0; x < SKY_WIDTH; ++x)
            sum += world_pixel_weight(image, (uint32_t)y) *
                   (double)pixels[3 * (y * SKY_WIDTH + x) + 1];
    return sum;
}

/* Irradiance of each direction's own plane, summed over a lamp's directions. */
static double lamp_green(const SceneLight *light) {
    const double cap = 1.0 - cos((double)light->angle);
    return (double)light->color.g / (1.0 - 0.5 * cap);
}

static void a_sky_without_sun_has_no_lamp(void) {
    float *pixels = sky_pixels();
    /* Glow that is wide is not small: chance finds it. */
    add_disc(pixels, 100.0f, 90.0f, 30.0f, 5.0f);
    AmbScene *scene = image_scene(pixels, SKY_WIDTH, SKY_HEIGHT, IDENTITY);
    ENSURE(scene->world_lamp_count == 0);
    amb_scene_destroy(scene);
    free(pixels);
}

/* Suns at different places, one across the edge of the image and one at the pole, keep what they
 * send, where it comes from, and how wide they are. */
static void suns_become_lamps(void) {
    static const struct {
        float x, y, radius, value;
    } suns[] = {{100.5f, 100.5f, 0.6f, 1e5f},
                {40.5f, 70.0f, 2.0f, 1e4f},
                {0.0f, 90.0f, 3.0f, 1e4f},
                {255.9f, 80.0f, 1.2f, 3e4f},
                {60.0f, 126.5f, 1.0f, 3e6f}};
    for (size_t i = 0; i < sizeof suns / sizeof suns[0]; ++i) {
        float *pixels = sky_pixels();
        add_disc(pixels, suns[i].x, suns[i].y, suns[i].radius, suns[i].value);
        AmbScene *scene = image_scene(pixels, SKY_WIDTH, SKY_HEIGHT, CYCLE);
        const World *world = &scene->world;
        ENSURE(scene->world_lamp_count == 1 && scene->light_count == 1);
        const SceneLight *lamp = &scene->lights[0];
        ENSURE(lamp->kind == AMB_LIGHT_SUN);
        const double before = total_green(pixels, &world->image);
        const double rest = total_green((const float *)world->image.pixels, &world->image);
        ENSURE_NEAR((rest + lamp_green(lamp)) / before, 1.0, 2e-6);
        ENSURE(lamp_green(lamp) > 0.5 * before);
        ENSURE_NEAR(lamp->color.r / lamp->color.g, 2.0 * (1.0 / 1.1), 0.2);
        const Vec3 middle = world_direction(&world->image, suns[i].x, suns[i].y);
        ENSURE_NEAR(vec3_length(vec3_add(lamp->direction, middle)), 0.0, 0.012);
        /* Its radius and that of the interpolation. */
        const double pixel = PI / SKY_HEIGHT;
        if (i < 4)
            ENSURE_NEAR((double)lamp->angle / pixel,
                        sqrt((double)(suns[i].radius * suns[i].radius) + 0.7), 0.45);
        /* Seen it is as before, lit by the rest only. */
        uint64_t state = i;
        double worst = 0.0;
        for (int k = 0; k < 200; ++k) {
            Vec3 d = random_direction(&state);
            if (k % 2 == 0)
                d = vec3_normalize(vec3_madd(middle, 0.1f, d));
            const double seen = green(world, d), without = green_but_lamps(world, d);
            worst = test_worse(worst, without - seen);
            ENSURE(without < 2.1);
        }
        ENSURE(worst < 1e-3);
        const double whole = integrate(world, 4 * SKY_WIDTH, 4 * SKY_HEIGHT, green);
        ENSURE_NEAR(whole / before, 1.0, 6e-3);
        amb_scene_destroy(scene);
        free(pixels);
    }
}

/* The glow around a sun is a lamp of its own, and does not widen the core. */
static void a_glow_does_not_blur_its_sun(void) {
    float *pixels = sky_pixels();
    add_disc(pixels, 128.0f, 90.0f, 3.0f, 1e5f);
    add_disc(pixels, 128.0f, 90.0f, 1.0f, 1e6f);
    AmbScene *scene = image_scene(pixels, SKY_WIDTH, SKY_HEIGHT, IDENTITY);
    ENSURE(scene->world_lamp_count == 2);
    const double pixel = PI / SKY_HEIGHT;
    ENSURE((double)scene->lights[0].angle < 2.0 * pixel);
    ENSURE((double)scene->lights[1].angle > 2.5 * pixel);
    const WorldImage *image = &scene->world.image;
    const double rest = total_green((const float *)image->pixels, image);
    ENSURE_NEAR((rest + lamp_green(&scene->lights[0]) + lamp_green(&scene->lights[1])) /
                    total_green(pixels, image),
                1.0, 2e-6);
    amb_scene_destroy(scene);
    free(pixels);
}

/* Alone in the dark it leaves nothing behind. */
static void one_bright_block_is_a_sun(void) {
    float *pixels = calloc(3 * SKY_WIDTH * SKY_HEIGHT, sizeof *pixels);
    add_disc(pixels, 200.0f, 64.0f, 0.8f, 500.0f);
    AmbScene *scene = image_scene(pixels, SKY_WIDTH, SKY_HEIGHT, IDENTITY);
    ENSURE(scene->world_lamp_count == 1);
    ENSURE(scene->world.is_black);
    ENSURE_NEAR(lamp_green(&scene->lights[0]) / total_green(pixels, &scene->world.image), 1.0,
                1e-6);
    amb_scene_destroy(scene);
    free(pixels);
}

void test_world(void);
void test_world(void) {
    RUN(directions_are_where_cycles_has_them);
    RUN(radiance_is_bilinear);
    RUN(pixels_weigh_what_they_light);
    RUN(samples_have_their_density);
    RUN(a_sky_without_sun_has_no_lamp);
    RUN(suns_become_lamps);
    RUN(a_glow_does_not_blur_its_sun);
    RUN(one_bright_block_is_a_sun);
}
