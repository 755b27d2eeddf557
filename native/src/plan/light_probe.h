/* SPDX-License-Identifier: GPL-3.0-or-later
 * A few light rays before the render, and coarse light fields of them, one for each kind of light:
 * reflected inside so many times, or come through another object. */
#ifndef AMB_PLAN_LIGHT_PROBE_H
#define AMB_PLAN_LIGHT_PROBE_H

#include "field/field.h"
#include "plan/plan.h"

/* Numbers of internal reflections among which the planner chooses: on the camera's side all, of the
 * light, of which every step costs a field, the first ones. What a camera sees in clear glass goes
 * round in its rim without loss. */
enum {
    LIGHT_STEP_COUNT = 9,
    LIGHT_BOUNCES_MOST = 16,
    CAMERA_STEP_COUNT = 10,
    CAMERA_BOUNCES_MOST = 128
};
extern const uint32_t BOUNCE_STEPS[CAMERA_STEP_COUNT]; /* 0, 1, .. CAMERA_BOUNCES_MOST */

/* Index of the smallest of the first step_count steps that follows so many reflections; of the last
 * one for more. */
uint32_t bounce_step(uint32_t bounces, uint32_t step_count);

/* By bounce_step, and light that has passed an object. */
enum { LIGHT_CLASS_PASSED = LIGHT_STEP_COUNT, LIGHT_CLASS_COUNT };

typedef struct LightProbe {
    double flux[LIGHT_CLASS_COUNT]; /* W, all channels, that enters media and interacts there */
    bool is_dark;                   /* no ray of a lamp brings light to an object */
    MeshProblems problems;
    Field *fields[LIGHT_CLASS_COUNT]; /* NULL: no light of this kind, or not asked for */
} LightProbe;

typedef struct LightProbeParams {
    uint64_t ray_count;
    uint32_t bounces;
    bool has_fields; /* else the flux alone */
    bool adjoint_normals;
    uint32_t seed;
} LightProbeParams;

AmbStatus light_probe_create(const AmbScene *scene, const LightProbeParams *params, Job *job,
                             LightProbe *out_probe);
void light_probe_clear(LightProbe *probe);

#endif
