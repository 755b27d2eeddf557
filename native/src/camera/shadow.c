/* SPDX-License-Identifier: GPL-3.0-or-later
 * What a straight line between an opaque surface and a light passes. */
#include "camera/shadow.h"

enum { BOUNDARY_MAX = 256 }; /* a guard against lines that never end */

Rgb shadow_transmittance(const AmbScene *scene, const MediumStack *stack, Vec3 p, Vec3 d,
                         float distance) {
    const Rgb black = rgb(0, 0, 0);
    MediumStack media = *stack;
    Rgb left = rgb(1, 1, 1);
    for (int i = 0; i < BOUNDARY_MAX; ++i) {
        BoundaryArrival arrival;
        const bool is_hit = boundary_find(scene, &media, p, d, distance, &arrival);
        const float length = is_hit ? arrival.t : distance;
        const SceneMaterial *material = medium_stack_material(scene, &media);
        if (material != NULL) {
            if (!isfinite(length))
                return black; /* out through a hole of the mesh */
            left = rgb_mul(left, medium_transmittance(&material->medium, length));
        }
        if (!is_hit)
            return left;
        const BoundaryCrossing *crossing = &arrival.crossing;
        if (arrival.is_opaque || crossing->eta != 1.0f)
            return black;
        left = rgb_mul(left, crossing->surface.material->transmit_color);
        media = crossing->beyond;
        p = scene_leave(&crossing->surface, d);
        distance -= arrival.t;
    }
    return black;
}
