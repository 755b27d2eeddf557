/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that an opaque surface sends back. */
#ifndef AMB_CAMERA_SHADE_H
#define AMB_CAMERA_SHADE_H

#include "camera/walker.h"

/* What an opaque surface sends back of light that did not scatter. */
typedef struct DiffuseLight {
    Rgb radiance; /* light of the lamps and the world, and emission but that of lamps; */
    Rgb lamp;     /* emission of a mesh that is a lamp: for eyes, everyone else is lit by it */
    Rgb caustics; /* what boundaries bent of it */
    Rgb interreflected; /* light that comes from other opaque surfaces, not in the radiance */
} DiffuseLight;

/* Toward where a path that travels along d came from, inside the media of the stack. Light that
 * scatters in media on its way to the surface is added to the walker's orders, times `glow` (the
 * path's throughput; black: it is left out) and the surface's albedo. */
DiffuseLight shade_diffuse(Walker *walker, const SurfacePoint *surface, Vec3 d,
                           const MediumStack *stack, Rgb glow, bool interreflects);

#endif
