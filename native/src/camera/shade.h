/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that an opaque surface sends back. */
#ifndef AMB_CAMERA_SHADE_H
#define AMB_CAMERA_SHADE_H

#include "camera/walker.h"

/* Radiance of an opaque surface toward where a path that travels along d came from, inside the
 * media of the stack: emission, and light of the lamps and the world that did not scatter. Light
 * that scatters in media on its way to the surface is added to the walker's orders, times `glow`
 * (the path's throughput; black: it is left out) and the surface's albedo. *out_caustics: how much
 * of the radiance is light that boundaries bent. */
Rgb shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 d, const MediumStack *stack,
                  Rgb glow, Rgb *out_caustics);

#endif
