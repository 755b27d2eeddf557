/* SPDX-License-Identifier: GPL-3.0-or-later
 * Caustics as lamps: light that they send from one opaque surface to another. */
#ifndef AMB_CAMERA_CAUSTIC_LAMP_H
#define AMB_CAMERA_CAUSTIC_LAMP_H

#include "camera/walker.h"

/* A caustic is small and bright: rays in proportion to the cosine that meet it by chance would show
 * as white dots. Places in proportion to its irradiance are chosen beside them, and each photon
 * is divided between both ([Veach97] 9.2): nothing is blurred. */

/* Mean radiance, weighted by the cosine, that a surface with unit normals on the side that is
 * asked for sees of caustics on others, as far as chosen places bring it. The map must be there. */
Rgb caustics_elsewhere(Walker *walker, const SurfacePoint *surface, const MediumStack *stack,
                       Vec3 ng, Vec3 ns);

#endif
