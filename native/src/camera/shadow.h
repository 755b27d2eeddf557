/* SPDX-License-Identifier: GPL-3.0-or-later
 * What a straight line between an opaque surface and a light passes. */
#ifndef AMB_CAMERA_SHADOW_H
#define AMB_CAMERA_SHADOW_H

#include "scene/boundary.h"

/* Share of the light that arrives at p, in the media of `stack`, along unit -d from `distance`
 * away (infinite: from outside of the scene). Boundaries between equal indices let it go straight
 * on, attenuated by the media between them: exactly what does not scatter. All others bend it, and
 * it ends there, as at opaque surfaces. */
Rgb shadow_transmittance(const AmbScene *scene, const MediumStack *stack, Vec3 p, Vec3 d,
                         float distance);

#endif
