/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that an opaque surface sends back. */
#ifndef AMB_CAMERA_SHADE_H
#define AMB_CAMERA_SHADE_H

#include "camera/walker.h"

/* Radiance of an opaque surface toward where a path that travels along d came from, inside the
 * media of the stack: direct light of the lamps and the world, and emission. A translucent object
 * between it and the light casts a black shadow. */
Rgb shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 d, const MediumStack *stack);

#endif
