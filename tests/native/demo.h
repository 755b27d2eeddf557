/* SPDX-License-Identifier: GPL-3.0-or-later
 * A small scene that tests bend, and the picture of it, through the public interface alone. */
#ifndef AMB_TESTS_DEMO_H
#define AMB_TESTS_DEMO_H

#include "shapes.h"

/* One translucent object, a ground below it, a light above, a camera in front of it. Lengths are
 * in units of `scale`, around `at`; so are the medium's coefficients and the light's intensity,
 * and the picture does not depend on either. */
typedef struct Demo {
    Shape shape; /* owned */
    bool is_smooth;
    bool has_ground, has_light;
    float glow; /* radiance of the ground */
    float scale, at[3];
    AmbMaterial material;
    AmbLight light;
    AmbCamera camera;
    float camera_at[3]; /* looks along +y */
    float world[3];
    AmbRenderParams params;
} Demo;

Demo demo_create(void); /* a sphere of resin, 16 x 16 pixels */
void demo_free(Demo *demo);

/* The scene up to but not including its commit. */
AmbScene *demo_scene(const Demo *demo);
void demo_set_camera(AmbScene *scene, const Demo *demo);

enum {
    PASS_COMBINED,
    PASS_DEPTH,
    PASS_SINGLE,
    PASS_DOUBLE,
    PASS_MULTIPLE,
    PASS_SURFACE,
    PASS_FREQUENCY,
    PASS_ERROR,
    PASS_ALBEDO,
    PASS_NORMAL,
    PASS_COUNT
};
extern const char *const PASS_NAMES[PASS_COUNT];
extern const uint32_t PASS_CHANNELS[PASS_COUNT];

typedef struct Picture {
    uint32_t width, height;
    float *passes[PASS_COUNT]; /* NULL where nothing was rendered */
    char *report;
} Picture;

/* Renders a committed scene. On failure the picture is empty. */
AmbStatus picture_render(AmbScene *scene, const AmbRenderParams *params, Picture *out);

/* Commits and renders; checks that this succeeds. */
Picture demo_render(const Demo *demo);

void picture_free(Picture *picture);
uint64_t picture_floats(const Picture *picture, int pass);
bool picture_is_same(const Picture *a, const Picture *b); /* bit for bit */
double picture_mean(const Picture *picture, int pass);

/* Every value of every pass finite, none negative, alpha and frequency in [0, 1], Combined the sum
 * of its parts, and nothing refused by the film. */
void picture_check(const Picture *picture, const char *what);

#endif
