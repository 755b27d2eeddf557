/* SPDX-License-Identifier: GPL-3.0-or-later
 * What can go wrong around a render: memory and disks that end, processes that are killed. Sees
 * the public header alone, but for the switches that make memory and files fail. */
#define _GNU_SOURCE
#include <dirent.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "base/memory.h"
#include "demo.h"
#include "film/film.h"
#include "test.h"

/* ---- Memory ---------------------------------------------------------------------------------- */

enum { SIDE = 2, FLOATS = SIDE * SIDE * 4 };

#define STEP(call)                                                                                 \
    do {                                                                                           \
        status = (call);                                                                           \
        if (status != AMB_OK)                                                                      \
            goto done;                                                                             \
    } while (0)

/* Everything a caller does, until something fails. */
static AmbStatus whole_cycle(const Demo *demo, const char *path, float out_pixels[FLOATS]) {
    static const uint32_t slots[3] = {0, 0, 0}, opaque = 1;
    AmbScene *scene = NULL;
    AmbRender *render = NULL;
    AmbStatus status;
    uint32_t id;
    int32_t is_ended;
    Shape plane = shape_plane();
    AmbMesh hero = shape_mesh(&demo->shape, "hero", true);
    AmbMesh ground = shape_mesh(&plane, "ground", false);
    /* The last face has no area: such a mesh has indices of its own in the accelerator. */
    static const uint32_t faces[9] = {0, 1, 3, 0, 3, 2, 0, 3, 3};
    ground.triangles = faces;
    ground.triangle_count = 3;
    ground.slots = slots;
    AmbMaterial diffuse;
    amb_material_init(&diffuse);
    for (int k = 0; k < 3; ++k)
        diffuse.emission[k] = demo->glow;
    static const float corners[18] = {0, 0, 1, 0, 0, 1, 1, 0, 0, 1, 1, 1};
    ground.uvs = corners;
    static const float color[6] = {0.8f, 0.8f, 0.8f, 0.7f, 0.8f, 0.9f};
    AmbTexture texture;
    amb_texture_init(&texture);
    texture.width = 2;
    texture.height = 1;
    texture.color = color;
    AmbObject object;
    amb_object_init(&object);
    object.material_count = 1;
    object.materials = slots;
    STEP(amb_scene_create(&scene));
    STEP(amb_scene_add_material(scene, &demo->material, &id));
    STEP(amb_scene_add_texture(scene, &texture, &diffuse.texture));
    STEP(amb_scene_add_material(scene, &diffuse, &id));
    STEP(amb_scene_add_mesh(scene, &hero, &id));
    STEP(amb_scene_add_mesh(scene, &ground, &id));
    STEP(amb_scene_add_object(scene, &object, &id));
    object.mesh = 1;
    object.materials = &opaque; /* light through the hero falls onto it */
    object.to_world[11] = -2.0f;
    STEP(amb_scene_add_object(scene, &object, &id));
    STEP(amb_scene_add_light(scene, &demo->light, &id));
    STEP(amb_scene_set_world(scene, demo->world));
    STEP(amb_scene_set_camera(scene, &demo->camera));
    STEP(amb_scene_commit(scene));
    STEP(amb_render_start(scene, &demo->params, &render));
    STEP(amb_render_wait(render, -1.0, &is_ended));
    STEP(amb_render_read_pass(render, "Combined", out_pixels, FLOATS));
    STEP(amb_render_write_exr(render, path, "Layer"));
done:
    amb_render_destroy(render);
    amb_scene_destroy(scene);
    shape_free(&plane);
    return status;
}
#undef STEP

/* One line for each way to render. */
typedef struct MemoryCase {
    const char *what;
    uint32_t estimator, light_bounces;
    float accuracy;
    uint32_t threads;           /* 0: 1 */
    uint32_t light_samples;     /* 0: next to none */
    int step;                   /* of n in a short run, where a cycle takes a tenth of a second; 0:
                                 * every allocation */
    uint32_t scatter_estimator; /* AUTO: light scatters once */
    bool has_caustics;
    float glow;
} MemoryCase;

enum { FEW_SAMPLES = 30, TWO_CHUNKS = 10000 };

static const MemoryCase MEMORY_CASES[] = {
    {"tubes", .estimator = AMB_ESTIMATOR_TUBES},
    {"tubes that reflect, two threads", .estimator = AMB_ESTIMATOR_TUBES, .light_bounces = 1,
     .threads = 2},
    {"tubes and points", .estimator = AMB_ESTIMATOR_TUBES, .light_bounces = 3, .step = 3},
    {"tubes and points to a target", .estimator = AMB_ESTIMATOR_TUBES, .light_bounces = 3,
     .accuracy = 1.0f, .step = 41},
    {"tubes to a target", .estimator = AMB_ESTIMATOR_TUBES, .accuracy = 1.0f},
    {"points", .estimator = AMB_ESTIMATOR_POINTS_FIXED, .light_bounces = 1,
     .light_samples = TWO_CHUNKS},
    {"points to a target", .estimator = AMB_ESTIMATOR_POINTS_COVARIANCE, .accuracy = 1.0f},
    {"specular", .estimator = AMB_ESTIMATOR_SPECULAR},
    {"caustics", .estimator = AMB_ESTIMATOR_SPECULAR, .has_caustics = true},
    {"walks", .estimator = AMB_ESTIMATOR_TUBES, .scatter_estimator = AMB_SCATTER_WALK},
    {"photons", .estimator = AMB_ESTIMATOR_TUBES, .scatter_estimator = AMB_SCATTER_PHOTONS},
    {"photons to a target", .estimator = AMB_ESTIMATOR_TUBES, .accuracy = 1.0f, .step = 7,
     .scatter_estimator = AMB_SCATTER_PHOTONS},
    {"a mesh that emits light", .estimator = AMB_ESTIMATOR_TUBES, .step = 3, .glow = 10.0f},
    {"a tree cut", .estimator = AMB_ESTIMATOR_TUBES, .step = 11,
     .scatter_estimator = AMB_SCATTER_TREE_CUT},
};

/* What must be true of a cycle in which memory may have failed; returns whether it gave a picture.
 */
static bool check_cycle(const Demo *demo, const char *what, int n, const char *folder,
                        const float expected[FLOATS]) {
    static float pixels[FLOATS];
    char path[96];
    snprintf(path, sizeof path, "%s/memory.exr", folder);
    const AmbStatus status = whole_cycle(demo, path, pixels);
    memory_fail_after(-1);
    if (status == AMB_OK) {
        test_check(memcmp(pixels, expected, sizeof pixels) == 0, __FILE__, __LINE__,
                   "%s, allocation %d: another picture", what, n);
        ENSURE(remove(path) == 0);
    } else {
        AmbErrorInfo info;
        amb_last_error(&info);
        test_check(status == AMB_OUT_OF_MEMORY && info.status == status, __FILE__, __LINE__,
                   "%s, allocation %d: %s: %s", what, n, amb_status_name(status), info.message);
        test_check(strstr(info.message, "memory") != NULL, __FILE__, __LINE__,
                   "%s, allocation %d: %s: %s", what, n, info.function, info.message);
    }
    /* No file is left, under whatever name. */
    test_check(rmdir(folder) == 0, __FILE__, __LINE__, "%s, allocation %d: a file is left", what,
               n);
    ENSURE(mkdir(folder, 0700) == 0);
    return status == AMB_OK;
}

/* Of the allocations of a whole cycle, Embree's and OpenEXR's among them, the n-th fails, or all
 * from the n-th on do. With more threads than one their number is not always the same. */
static void check_memory_case(const MemoryCase *memory, const char *folder) {
    static float expected[FLOATS];
    char path[96];
    Demo demo = demo_create();
    demo.params.width = demo.params.height = SIDE;
    demo.params.samples = 1;
    demo.params.light_samples = memory->light_samples > 0 ? memory->light_samples : FEW_SAMPLES;
    shape_free(&demo.shape);
    demo.shape = shape_sphere(3, 4);
    demo.params.estimator = memory->estimator;
    demo.params.light_bounces = memory->light_bounces;
    demo.params.accuracy = memory->accuracy;
    demo.glow = memory->glow;
    if (memory->scatter_estimator != AMB_SCATTER_AUTO) {
        demo.params.scatter_estimator = memory->scatter_estimator;
        demo.params.effects |= AMB_EFFECT_DOUBLE_SCATTERING | AMB_EFFECT_MULTIPLE_SCATTERING;
    }
    if (!memory->has_caustics)
        demo.params.effects &= ~(uint32_t)AMB_EFFECT_CAUSTICS;
    demo.params.threads = memory->threads > 0 ? memory->threads : 1;
    snprintf(path, sizeof path, "%s/first.exr", folder);
    ENSURE_STATUS(whole_cycle(&demo, path, expected), AMB_OK);
    ENSURE(remove(path) == 0);
    int n = 0, pictures = 0;
    const int step = test_is_long() || memory->step == 0 ? 1 : memory->step;
    for (; pictures < 3 && n < 2000; n += step) {
        n % 3 == 0 ? memory_fail_from(n) : memory_fail_after(n);
        const bool is_picture = check_cycle(&demo, memory->what, n, folder, expected);
        /* Once one allocation less than all has been reached, none may fail. */
        ENSURE(pictures == 0 || is_picture || memory->threads > 1);
        pictures += is_picture;
        /* And the next is as ever. */
        if (!is_picture && n % 16 == 1)
            ENSURE(check_cycle(&demo, memory->what, n, folder, expected));
    }
    test_check(n > 60 && pictures == 3, __FILE__, __LINE__, "%s: %d pictures in %d cycles",
               memory->what, pictures, n);
    demo_free(&demo);
}

static void memory_failing_anywhere_is_an_error(void) {
    char folder[] = "/tmp/amb_faults_XXXXXX";
    ENSURE(mkdtemp(folder) != NULL);
    for (size_t i = 0; i < sizeof MEMORY_CASES / sizeof MEMORY_CASES[0]; ++i)
        check_memory_case(&MEMORY_CASES[i], folder);
    ENSURE(rmdir(folder) == 0);
    ENSURE(memory_held() == 0);
}

/* ---- Limits of memory ------------------------------------------------------------------------ */

static uint64_t report_number(const char *report, const char *key) {
    char text[64];
    snprintf(text, sizeof text, "\"%s\": ", key);
    const char *at = report != NULL ? strstr(report, text) : NULL;
    ENSURE(at != NULL);
    return at != NULL ? strtoull(at + strlen(text), NULL, 10) : 0;
}

/* Where the limit is too low for what is asked, it is what is left of it after a coarser light
 * field, and the picture is the one of that. */
static void light_field_shrinks_to_fit(void) {
    static const struct {
        uint32_t estimator, bounces;
        bool has_tubes, has_points;
    } cases[] = {{AMB_ESTIMATOR_TUBES, 0, true, false},
                 {AMB_ESTIMATOR_TUBES, 4, true, true},
                 {AMB_ESTIMATOR_POINTS_FIXED, 0, false, true}};
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; ++i) {
        Demo demo = demo_create();
        demo.params.estimator = cases[i].estimator;
        demo.params.light_bounces = cases[i].bounces;
        /* The map of caustics shrinks by itself. */
        demo.params.effects &= ~(uint32_t)(AMB_EFFECT_CAUSTICS | AMB_EFFECT_TRANSMITTED_LIGHT);
        demo.params.tube_refinement = 3;
        demo.params.light_samples = 1 << 18;
        demo.params.memory_limit = 1ull << 40;
        Picture whole = demo_render(&demo);
        ENSURE(strstr(whole.report, "memory_limit") == NULL);
        ENSURE(report_number(whole.report, "limit_bytes") == 1ull << 40);
        const uint64_t refinement = report_number(whole.report, "tube_refinement");
        const uint64_t samples = report_number(whole.report, "light_samples");

        /* Between what the finest needs, and a part of it. */
        demo.params.memory_limit = memory_held() + report_number(whole.report, "scene_bytes") +
                                   report_number(whole.report, "film_bytes") +
                                   (report_number(whole.report, "light_bytes") +
                                    report_number(whole.report, "field_bytes")) /
                                       2;
        Picture part = demo_render(&demo);
        picture_check(&part, "a light field that shrank");
        const uint64_t given_refinement = report_number(part.report, "tube_refinement");
        const uint64_t given_samples = report_number(part.report, "light_samples");
        test_check((given_refinement < refinement) == cases[i].has_tubes &&
                       (given_samples < samples) == cases[i].has_points,
                   __FILE__, __LINE__, "case %zu: refinement %llu, %llu samples", i,
                   (unsigned long long)given_refinement, (unsigned long long)given_samples);
        ENSURE(strstr(part.report, "memory_limit is reached") != NULL);
        ENSURE_NEAR(picture_mean(&part, PASS_SINGLE) / picture_mean(&whole, PASS_SINGLE), 1.0,
                    0.05);

        demo.params.memory_limit = 0;
        demo.params.tube_refinement = (int32_t)given_refinement;
        demo.params.light_samples = given_samples * demo.params.light_samples / samples;
        Picture same = demo_render(&demo);
        ENSURE(picture_is_same(&part, &same));
        picture_free(&whole);
        picture_free(&part);
        picture_free(&same);
        demo_free(&demo);
    }
}

/* So do photons of later orders, and the samples of a tree cut. */
static void later_orders_shrink_to_fit(void) {
    static const uint32_t estimators[] = {AMB_SCATTER_PHOTONS, AMB_SCATTER_TREE_CUT};
    for (size_t i = 0; i < 2; ++i) {
        Demo demo = demo_create();
        demo.params.estimator = AMB_ESTIMATOR_TUBES;
        demo.params.scatter_estimator = estimators[i];
        demo.params.effects = AMB_EFFECT_SINGLE_SCATTERING | AMB_EFFECT_DOUBLE_SCATTERING |
                              AMB_EFFECT_MULTIPLE_SCATTERING;
        demo.params.light_samples = 1 << 18;
        demo.params.memory_limit = 1ull << 40;
        Picture whole = demo_render(&demo);
        demo.params.memory_limit = memory_held() + (6u << 20);
        Picture part = demo_render(&demo);
        picture_check(&part, "later orders that shrank");
        const uint64_t given = report_number(part.report, "cells");
        const uint64_t asked = report_number(whole.report, "cells");
        test_check(given < asked, __FILE__, __LINE__, "%llu cells of %llu",
                   (unsigned long long)given, (unsigned long long)asked);
        ENSURE(strstr(part.report, "memory_limit is reached") != NULL);
        ENSURE_NEAR(picture_mean(&part, PASS_DOUBLE) / picture_mean(&whole, PASS_DOUBLE), 1.0, 0.2);
        picture_free(&whole);
        picture_free(&part);
        demo_free(&demo);
    }
}

/* Under a target the levels that fit are all there are. */
static void target_keeps_to_the_limit(void) {
    Demo demo = demo_create();
    demo.params.estimator = AMB_ESTIMATOR_TUBES;
    demo.params.accuracy = 0.02f;
    demo.params.width = demo.params.height = 4;
    demo.params.memory_limit = memory_held() + (4u << 20);
    Picture picture = demo_render(&demo);
    picture_check(&picture, "caustics to a target with little memory");
    ENSURE(strstr(picture.report, "caustics: more photons go beyond memory_limit") != NULL);
    picture_free(&picture);

    demo.params.effects = AMB_EFFECT_SINGLE_SCATTERING;
    demo.params.estimator = AMB_ESTIMATOR_POINTS_COVARIANCE;
    demo.params.light_samples = 1 << 18;
    demo.params.memory_limit = 0;
    demo.params.accuracy = 0.0002f;
    uint64_t levels[2];
    for (int i = 0; i < 2; ++i) {
        picture = demo_render(&demo);
        picture_check(&picture, "points to a target with little memory");
        levels[i] = report_number(picture.report, "light_samples");
        ENSURE(i == 0 || strstr(picture.report, "\"reached\": false") != NULL);
        picture_free(&picture);
        demo.params.memory_limit = memory_held() + (3u << 20);
    }
    test_check(levels[1] > 0 && levels[1] < levels[0], __FILE__, __LINE__, "%llu, %llu samples",
               (unsigned long long)levels[0], (unsigned long long)levels[1]);
    demo_free(&demo);
}

static void limit_that_is_too_low_is_one_sentence(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    AmbErrorInfo info;
    Picture picture;
    /* From nothing to what a render of this scene needs and a little more. */
    uint64_t limit = 1;
    uint32_t refused = 0;
    for (AmbStatus status = AMB_OUT_OF_MEMORY; status != AMB_OK; limit += 1 << 17) {
        demo.params.memory_limit = limit;
        status = picture_render(scene, &demo.params, &picture);
        if (status == AMB_OK)
            break;
        ++refused;
        amb_last_error(&info);
        test_check(status == AMB_OUT_OF_MEMORY && strstr(info.message, "memory_limit is") != NULL,
                   __FILE__, __LINE__, "%s: %s", amb_status_name(status), info.message);
        if (refused > 1000)
            break;
    }
    ENSURE(refused > 3 && refused < 1000);
    picture_free(&picture);
    /* The largest image, before a byte of it is touched. */
    AmbRender *render = NULL;
    demo.params.width = demo.params.height = 65536;
    demo.params.memory_limit = 0;
    const AmbStatus status = amb_render_start(scene, &demo.params, &render);
    amb_last_error(&info);
    ENSURE(status == AMB_OUT_OF_MEMORY && render == NULL);
    ENSURE(strstr(info.message, "65536 x 65536") != NULL);
    ENSURE(strstr(info.message, "memory_limit is") != NULL);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* A scene is placed before any render says what it may take: it keeps to what the machine has. */
static void scene_beyond_the_machine_is_one_sentence(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    const uint64_t held = memory_held();
    AmbErrorInfo info;
    uint32_t refused = 0;
    AmbStatus status = AMB_OUT_OF_MEMORY;
    for (uint64_t room = 0; status != AMB_OK && refused < 1000; room += 512) {
        memory_pretend_machine((held + room) / 7 * 8);
        status = amb_scene_commit(scene);
        amb_last_error(&info);
        if (status == AMB_OK)
            break;
        ++refused;
        test_check(status == AMB_OUT_OF_MEMORY && strstr(info.message, "the machine has") != NULL,
                   __FILE__, __LINE__, "%s: %s", amb_status_name(status), info.message);
        ENSURE_NEAR(memory_held(), held, 0);
    }
    memory_pretend_machine(0);
    ENSURE(refused > 3 && refused < 1000);
    Picture picture;
    ENSURE_STATUS(picture_render(scene, &demo.params, &picture), AMB_OK);
    picture_check(&picture, "a scene that was refused before");
    picture_free(&picture);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* ---- Cancelling, and several at once --------------------------------------------------------- */

static void sleep_for(double seconds) {
    const struct timespec pause = {.tv_sec = (time_t)seconds,
                                   .tv_nsec = (long)(1e9 * (seconds - floor(seconds)))};
    nanosleep(&pause, NULL);
}

/* Cancelled at any moment a render returns, frees what it holds, and the next one of the same scene
 * is bit for bit what it would have been. */
static void cancel_at_any_moment(void) {
    const int moments = test_is_long() ? 500 : 60;
    uint64_t state = 9;
    static const uint32_t estimators[] = {AMB_ESTIMATOR_TUBES, AMB_ESTIMATOR_POINTS_COVARIANCE,
                                          AMB_ESTIMATOR_SPECULAR};
    int cancelled = 0;
    for (size_t e = 0; e < 3; ++e) {
        Demo demo = demo_create();
        demo.params.estimator = estimators[e];
        demo.params.width = demo.params.height = 8;
        demo.params.light_samples = 5000;
        demo.params.accuracy = 0.0f;
        AmbScene *scene = demo_scene(&demo);
        ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
        Picture expected;
        ENSURE_STATUS(picture_render(scene, &demo.params, &expected), AMB_OK);
        const uint64_t held = memory_held();
        for (int i = 0; i < moments / 3; ++i) {
            AmbRender *render = NULL;
            ENSURE_STATUS(amb_render_start(scene, &demo.params, &render), AMB_OK);
            sleep_for(test_uniform(&state, 0.0, 0.04));
            amb_render_cancel(render);
            int32_t is_ended = 0;
            const AmbStatus status = amb_render_wait(render, -1.0, &is_ended);
            ENSURE(is_ended == 1 && (status == AMB_CANCELLED || status == AMB_OK));
            cancelled += status == AMB_CANCELLED;
            amb_render_destroy(render);
            ENSURE_NEAR(memory_held(), held, 0);
            if (i % 10 != 0)
                continue;
            Picture again;
            ENSURE_STATUS(picture_render(scene, &demo.params, &again), AMB_OK);
            ENSURE(picture_is_same(&again, &expected));
            picture_free(&again);
        }
        picture_free(&expected);
        amb_scene_destroy(scene);
        demo_free(&demo);
    }
    printf("%d of %d renders were cancelled before their end\n", cancelled, moments);
}

/* Two that are begun anew all the time, as viewports do, beside one that runs through. */
static void viewports_beside_a_final_render(void) {
    Demo demo = demo_create();
    AmbScene *scene = demo_scene(&demo);
    ENSURE_STATUS(amb_scene_commit(scene), AMB_OK);
    Picture expected;
    ENSURE_STATUS(picture_render(scene, &demo.params, &expected), AMB_OK);
    const double seconds = test_is_long() ? 600.0 : 3.0;
    struct timespec begin, now;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    uint64_t state = 4;
    uint32_t starts = 0, finals = 0;
    AmbRenderParams views[2] = {demo.params, demo.params};
    AmbScene *scenes[2] = {NULL, NULL};
    AmbRender *renders[2] = {NULL, NULL};
    do {
        AmbRender *final = NULL;
        int32_t is_ended = 0;
        ENSURE_STATUS(amb_render_start(scene, &demo.params, &final), AMB_OK);
        while (is_ended == 0) {
            const uint32_t i = starts++ % 2;
            amb_render_destroy(renders[i]);
            amb_scene_destroy(scenes[i]);
            demo.camera_at[0] = (float)test_uniform(&state, -1.0, 1.0);
            scenes[i] = demo_scene(&demo);
            views[i].samples = 1000;
            ENSURE_STATUS(amb_scene_commit(scenes[i]), AMB_OK);
            ENSURE_STATUS(amb_render_start(scenes[i], &views[i], &renders[i]), AMB_OK);
            AmbProgress progress;
            amb_progress_init(&progress);
            ENSURE_STATUS(amb_render_progress(renders[i], &progress), AMB_OK);
            static float pixels[16 * 16 * 4];
            const AmbStatus read =
                amb_render_read_pass(renders[1 - i], "Combined", pixels, sizeof pixels / 4);
            ENSURE(read == AMB_OK || read == AMB_INVALID_STATE || renders[1 - i] == NULL);
            ENSURE_STATUS(amb_render_wait(final, 0.02, &is_ended), AMB_OK);
        }
        static float pixels[16 * 16 * 4];
        ENSURE_STATUS(amb_render_read_pass(final, "Combined", pixels, sizeof pixels / 4), AMB_OK);
        ENSURE(memcmp(pixels, expected.passes[PASS_COMBINED], sizeof pixels) == 0);
        amb_render_destroy(final);
        ++finals;
        clock_gettime(CLOCK_MONOTONIC, &now);
    } while (difftime(now.tv_sec, begin.tv_sec) < seconds);
    for (int i = 0; i < 2; ++i) {
        amb_render_destroy(renders[i]);
        amb_scene_destroy(scenes[i]);
    }
    printf("%u final renders beside %u of viewports\n", finals, starts);
    picture_free(&expected);
    amb_scene_destroy(scene);
    demo_free(&demo);
}

/* ---- Files ----------------------------------------------------------------------------------- */

/* An ended render and an empty folder to write its picture to. */
typedef struct Writer {
    AmbScene *scene;
    AmbRender *render;
    char folder[32];
    char path[64]; /* in the folder */
} Writer;

static Writer writer_create(void) {
    Writer writer = {.folder = "/tmp/amb_faults_XXXXXX"};
    ENSURE(mkdtemp(writer.folder) != NULL);
    snprintf(writer.path, sizeof writer.path, "%s/picture.exr", writer.folder);
    Demo demo = demo_create();
    demo.params.width = demo.params.height = 64;
    demo.params.samples = 1;
    writer.scene = demo_scene(&demo);
    int32_t is_ended;
    ENSURE_STATUS(amb_scene_commit(writer.scene), AMB_OK);
    ENSURE_STATUS(amb_render_start(writer.scene, &demo.params, &writer.render), AMB_OK);
    ENSURE_STATUS(amb_render_wait(writer.render, -1.0, &is_ended), AMB_OK);
    demo_free(&demo);
    return writer;
}

static void writer_destroy(Writer *writer) {
    amb_render_destroy(writer->render);
    amb_scene_destroy(writer->scene);
    test_check(rmdir(writer->folder) == 0, __FILE__, __LINE__, "files are left in %s",
               writer->folder);
}

static int64_t file_size(const char *path) {
    struct stat about;
    return stat(path, &about) == 0 ? (int64_t)about.st_size : -1;
}

/* Entries of a folder; the size of all that are not `size` bytes long is counted as broken. */
static int count_files(const char *folder, int64_t size, int *out_broken) {
    int count = 0;
    *out_broken = 0;
    DIR *listing = opendir(folder);
    ENSURE(listing != NULL);
    for (struct dirent *entry; listing != NULL && (entry = readdir(listing)) != NULL;) {
        if (strcmp(entry->d_name, ".") == 0 || strcmp(entry->d_name, "..") == 0)
            continue;
        char path[320];
        snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        ++count;
        *out_broken += file_size(path) != size;
    }
    closedir(listing);
    return count;
}

static void remove_files(const char *folder) {
    DIR *listing = opendir(folder);
    for (struct dirent *entry; listing != NULL && (entry = readdir(listing)) != NULL;) {
        char path[320];
        snprintf(path, sizeof path, "%s/%s", folder, entry->d_name);
        if (entry->d_name[0] != '.' || strlen(entry->d_name) > 2)
            remove(path);
    }
    closedir(listing);
}

/* The call fails with AMB_IO and that part of a message, and the folder has `count` files. */
static void check_write_fails(const Writer *writer, const char *path, const char *part, int count) {
    ENSURE_STATUS(amb_render_write_exr(writer->render, path, "L"), AMB_IO);
    AmbErrorInfo info;
    amb_last_error(&info);
    test_check(strstr(info.message, part) != NULL, __FILE__, __LINE__, "\"%s\" lacks \"%s\"",
               info.message, part);
    int broken;
    ENSURE_NEAR(count_files(writer->folder, 0, &broken), count, 0);
}

/* Writing ends after every so many bytes: over nothing, and over the picture of before. */
static void disk_that_is_full_leaves_no_file(void) {
    Writer writer = writer_create();
    struct rlimit limit, small;
    ENSURE(getrlimit(RLIMIT_FSIZE, &limit) == 0);
    signal(SIGXFSZ, SIG_IGN);
    for (int is_named = 0; is_named < 2; ++is_named) {
        film_exr_avoid_nameless(is_named == 1);
        ENSURE_STATUS(amb_render_write_exr(writer.render, writer.path, "L"), AMB_OK);
        const int64_t size = file_size(writer.path);
        ENSURE(size > 10000);
        for (int is_over = 1; is_over >= 0; --is_over) {
            if (!is_over)
                remove(writer.path);
            for (int64_t bytes = 0; bytes < size; bytes += bytes < 64 ? 16 : size / 13) {
                small = limit;
                small.rlim_cur = (rlim_t)bytes;
                ENSURE(setrlimit(RLIMIT_FSIZE, &small) == 0);
                check_write_fails(&writer, writer.path, "File too large", is_over);
                ENSURE(setrlimit(RLIMIT_FSIZE, &limit) == 0);
                ENSURE(file_size(writer.path) == (is_over ? size : -1));
            }
        }
        ENSURE_STATUS(amb_render_write_exr(writer.render, writer.path, "L"), AMB_OK);
        ENSURE(file_size(writer.path) == size && remove(writer.path) == 0);
    }
    film_exr_avoid_nameless(false);
    signal(SIGXFSZ, SIG_DFL);
    writer_destroy(&writer);
}

enum { CHILD_OK = 0, CHILD_FAILED = 1, CHILD_CANNOT = 2 };

/* Mounts that this process alone sees: as root, or as root of a name space of its own. */
static bool may_mount(void) {
    if (unshare(CLONE_NEWNS) != 0) {
        const unsigned user = (unsigned)getuid();
        FILE *map = NULL;
        if (unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0 ||
            (map = fopen("/proc/self/uid_map", "w")) == NULL)
            return false;
        fprintf(map, "0 %u 1\n", user);
        if (fclose(map) != 0)
            return false;
    }
    return mount("none", "/", NULL, MS_REC | MS_PRIVATE, NULL) == 0;
}

/* On a real file system of 16 KiB, where this process may make one. */
static int write_to_small_disk(const Writer *writer) {
    if (!may_mount() || mount("none", writer->folder, "tmpfs", 0, "size=16k") != 0)
        return CHILD_CANNOT;
    AmbErrorInfo info;
    const AmbStatus status = amb_render_write_exr(writer->render, writer->path, "L");
    amb_last_error(&info);
    int broken;
    const bool is_right = status == AMB_IO && strstr(info.message, "No space left") != NULL &&
                          count_files(writer->folder, 0, &broken) == 0;
    return is_right ? CHILD_OK : CHILD_FAILED;
}

static void small_disk_says_so(void) {
    Writer writer = writer_create();
    ENSURE_STATUS(amb_render_write_exr(writer.render, writer.path, "L"), AMB_OK);
    ENSURE(file_size(writer.path) > 16384 && remove(writer.path) == 0);
    fflush(stdout);
    const pid_t child = fork();
    if (child == 0) {
        /* Not _exit: the thread sanitizer takes the parent's render for a thread that the child
         * left. */
        syscall(SYS_exit_group, write_to_small_disk(&writer));
        abort();
    }
    int status = 0;
    ENSURE(waitpid(child, &status, 0) == child && WIFEXITED(status));
    test_check(WEXITSTATUS(status) != CHILD_FAILED, __FILE__, __LINE__,
               "a disk of 16 KiB was not full");
    if (WEXITSTATUS(status) == CHILD_CANNOT)
        printf("a disk of 16 KiB: skipped, this process may not mount one\n");
    writer_destroy(&writer);
}

static void paths_that_cannot_be(void) {
    Writer writer = writer_create();
    char path[400];
    for (int is_named = 0; is_named < 2; ++is_named) {
        film_exr_avoid_nameless(is_named == 1);
        snprintf(path, sizeof path, "%s/no/such/folder.exr", writer.folder);
        check_write_fails(&writer, path, "No such file", 0);
        ENSURE(mkdir(writer.path, 0700) == 0);
        check_write_fails(&writer, writer.path, "directory", 1);
        ENSURE(rmdir(writer.path) == 0);
        check_write_fails(&writer, "", "cannot write", 0);
        snprintf(path, sizeof path, "%s/", writer.folder);
        check_write_fails(&writer, path, "cannot write", 0);
        check_write_fails(&writer, "/proc/version", "cannot write", 0);
        /* The longest name that there is, and one more. */
        int length = snprintf(path, sizeof path, "%s/%0255d", writer.folder, 0);
        ENSURE_STATUS(amb_render_write_exr(writer.render, path, "L"), AMB_OK);
        ENSURE(remove(path) == 0);
        memcpy(path + length, "0", 2);
        check_write_fails(&writer, path, "too long", 0);
        /* A file is no folder. */
        ENSURE_STATUS(amb_render_write_exr(writer.render, writer.path, "L"), AMB_OK);
        length = snprintf(path, sizeof path, "%s/x.exr", writer.path);
        check_write_fails(&writer, path, "Not a directory", 1);
        ENSURE(remove(writer.path) == 0);
    }
    film_exr_avoid_nameless(false);
    /* Relative to the current folder. */
    char before[1000];
    ENSURE(getcwd(before, sizeof before) != NULL && chdir(writer.folder) == 0);
    ENSURE_STATUS(amb_render_write_exr(writer.render, "picture.exr", "L"), AMB_OK);
    ENSURE(chdir(before) == 0 && remove(writer.path) == 0);
    writer_destroy(&writer);
}

/* A process that does nothing but write the file again and again is killed at some moment. */
static void killed_writer_leaves_whole_files(void) {
    Writer writer = writer_create();
    ENSURE_STATUS(amb_render_write_exr(writer.render, writer.path, "L"), AMB_OK);
    const int64_t size = file_size(writer.path);
    ENSURE(remove(writer.path) == 0);
    uint64_t state = 5;
    const int rounds = test_is_long() ? 500 : 30;
    int extra = 0;
    for (int i = 0; i < rounds; ++i) {
        const bool is_named = i % 3 == 2;
        film_exr_avoid_nameless(is_named);
        fflush(stdout);
        const pid_t child = fork();
        if (child == 0)
            for (;;)
                (void)amb_render_write_exr(writer.render, writer.path, "L");
        const struct timespec pause = {.tv_nsec = (long)test_uniform(&state, 0.0, 2e7)};
        nanosleep(&pause, NULL);
        ENSURE(kill(child, SIGKILL) == 0);
        int status = 0;
        ENSURE(waitpid(child, &status, 0) == child && WIFSIGNALED(status));
        const int64_t left = file_size(writer.path);
        ENSURE(left == -1 || left == size);
        int broken = 0;
        const int count = count_files(writer.folder, size, &broken);
        extra += count - (left == size);
        /* Between its two names a nameless file is a whole one. */
        ENSURE(is_named || broken == 0);
        ENSURE(count <= 2);
        remove_files(writer.folder);
    }
    film_exr_avoid_nameless(false);
    printf("%d writers killed: %d files left beside the final name\n", rounds, extra);
    writer_destroy(&writer);
}

void test_faults(void);

void test_faults(void) {
    RUN(memory_failing_anywhere_is_an_error);
    RUN(light_field_shrinks_to_fit);
    RUN(later_orders_shrink_to_fit);
    RUN(target_keeps_to_the_limit);
    RUN(limit_that_is_too_low_is_one_sentence);
    RUN(scene_beyond_the_machine_is_one_sentence);
    RUN(cancel_at_any_moment);
    RUN(viewports_beside_a_final_render);
    RUN(disk_that_is_full_leaves_no_file);
    RUN(small_disk_says_so);
    RUN(paths_that_cannot_be);
    RUN(killed_writer_leaves_whole_files);
    ENSURE(memory_held() == 0);
}
