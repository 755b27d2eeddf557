/* SPDX-License-Identifier: GPL-3.0-or-later
 * Camera rays. */
#include "scene/camera.h"

#include "amberlight/amberlight.h"

CameraRay camera_ray(const SceneCamera *camera, float x, float y, Sample2 lens) {
    const float *w = camera->window;
    const float px = w[0] + x * (w[1] - w[0]);
    const float py = w[2] + y * (w[3] - w[2]);
    Vec3 origin = camera->position;
    Vec3 d = camera->forward;
    if (camera->kind == AMB_CAMERA_ORTHOGRAPHIC) {
        origin = vec3_madd(vec3_madd(origin, px, camera->right), py, camera->up);
    } else {
        d = vec3_madd(vec3_madd(d, px, camera->right), py, camera->up);
    }
    if (camera->lens_radius > 0.0f) {
        const Vec3 focus = vec3_madd(origin, camera->focus_distance, d);
        const Sample2 disc = sample_disc(lens);
        origin = vec3_madd(origin, camera->lens_radius * disc.u, camera->right);
        origin = vec3_madd(origin, camera->lens_radius * disc.v, camera->up);
        d = vec3_sub(focus, origin);
    }
    d = vec3_normalize(d);
    CameraRay ray;
    ray.d = d;
    ray.cos_axis = vec3_dot(d, camera->forward);
    ray.depth_o = camera->clip_start;
    ray.o = vec3_madd(origin, camera->clip_start / ray.cos_axis, d);
    ray.t_max = (camera->clip_end - camera->clip_start) / ray.cos_axis;
    return ray;
}
