/* SPDX-License-Identifier: GPL-3.0-or-later
 * Camera rays. */
#include "scene/camera.h"

#include "amberlight/amberlight.h"
#include "math/vec3d.h"

/* A camera this many times as far from the objects as they extend: where its rays meet them, single
 * precision counted from the camera has few digits left. */
static const double FAR_SHARE = 8.0;

/* How far from o along unit d the ray may start instead: before all objects. */
static double way_to_objects(const SceneCamera *camera, Vec3d o, Vec3d d) {
    const double radius = (double)camera->target_radius;
    const double way = vec3d_dot(vec3d_sub(vec3d_from(camera->target), o), d) - 2.0 * radius;
    return radius > 0.0 && way > FAR_SHARE * radius ? way : 0.0;
}

/* To the axis; wider rays are no cosine that doubles know. */
static const double COS_AXIS_MIN = 1e-12;

CameraRay camera_ray(const SceneCamera *camera, float x, float y, Sample2 lens) {
    const float *w = camera->window;
    const double px = (double)(w[0] + x * (w[1] - w[0]));
    const double py = (double)(w[2] + y * (w[3] - w[2]));
    const Vec3d right = vec3d_from(camera->right), up = vec3d_from(camera->up);
    const Vec3d forward = vec3d_from(camera->forward);
    Vec3d origin = vec3d_from(camera->position);
    Vec3d d = forward;
    if (camera->kind == AMB_CAMERA_ORTHOGRAPHIC) {
        origin = vec3d_madd(vec3d_madd(origin, px, right), py, up);
    } else {
        d = vec3d_madd(vec3d_madd(d, px, right), py, up);
    }
    if (camera->lens_radius > 0.0f) {
        const Sample2 disc = sample_disc(lens);
        const Vec3d aside = vec3d_madd(vec3d_scale(right, (double)(camera->lens_radius * disc.u)),
                                       (double)(camera->lens_radius * disc.v), up);
        origin = vec3d_add(origin, aside);
        /* To the focus, which may be far nearer than what the origin's digits tell. */
        d = vec3d_sub(vec3d_scale(d, (double)camera->focus_distance), aside);
    }
    d = vec3d_scale(d, 1.0 / vec3d_length(d));
    /* Along the lens itself, where rounding decides, clipping planes are far but somewhere. */
    const double cos_axis = fmax(vec3d_dot(d, forward), COS_AXIS_MIN);
    const double start = (double)camera->clip_start / cos_axis;
    const double end = (double)camera->clip_end / cos_axis;
    const Vec3d near = vec3d_madd(origin, start, d);
    const double way = fmin(way_to_objects(camera, near, d), end - start);
    return (CameraRay){.o = vec3d_round(vec3d_madd(near, way, d)),
                       .d = vec3d_round(d),
                       .t_max = (float)(end - start - way),
                       .depth_o = (float)((double)camera->clip_start + way * cos_axis),
                       .cos_axis = (float)cos_axis};
}
