/* SPDX-License-Identifier: GPL-3.0-or-later
 * Camera rays. */
#ifndef AMB_SCENE_CAMERA_H
#define AMB_SCENE_CAMERA_H

#include <stdint.h>

#include "math/sampling.h"
#include "math/vec3.h"

typedef struct SceneCamera {
    uint32_t kind;           /* AMB_CAMERA_* */
    Vec3 position;           /* world */
    Vec3 right, up, forward; /* unit, world */
    float window[4];         /* left, right, bottom, top */
    float clip_start, clip_end;
    float lens_radius, focus_distance;
    Vec3 target;         /* a ball around all objects, for cameras far from them */
    float target_radius; /* m */
} SceneCamera;

typedef struct CameraRay {
    Vec3 o, d;      /* d unit; o lies on the near clipping plane */
    float t_max;    /* where the far clipping plane is */
    float depth_o;  /* distance of o along the view axis, m */
    float cos_axis; /* d . forward: depth = depth_o + t cos_axis */
} CameraRay;

/* Ray through the image point (x, y) in [0,1]^2, y = 0 at the bottom; lens in [0,1)^2. */
CameraRay camera_ray(const SceneCamera *camera, float x, float y, Sample2 lens);

#endif
