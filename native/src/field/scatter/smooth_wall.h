/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that has scattered, at boundaries whose normals are interpolated. */
#ifndef AMB_FIELD_SCATTER_SMOOTH_WALL_H
#define AMB_FIELD_SCATTER_SMOOTH_WALL_H

#include "scene/boundary.h"

/* Where a photon goes on. */
typedef struct WallTurn {
    bool is_refracted;
    Vec3 d;
    float weight; /* of its flux; 0: no camera path comes this way, it ends */
} WallTurn;

/* Whether the face's own normal and that of the crossing, as it is shaded, are different. */
bool smooth_wall_is_bent(const BoundaryCrossing *crossing);

/* The adjoint of what camera paths do at a boundary (boundary_cross; [Veach97] 5.3), for light
 * along unit d that is alike in all directions near the face's plane. Fresnel's share is in the
 * choice of the way, tints are not in the weight. u: in [0,1)^2. Pure. */
WallTurn smooth_wall_turn(const BoundaryCrossing *crossing, Vec3 d, Sample2 u);

#endif
