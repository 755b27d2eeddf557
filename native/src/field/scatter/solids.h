/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where opaque objects leave no light that is seen: inside of closed ones, and outside of those
 * that the camera is in. */
#ifndef AMB_FIELD_SCATTER_SOLIDS_H
#define AMB_FIELD_SCATTER_SOLIDS_H

#include "base/parallel.h"
#include "scene/scene.h"

enum { SOLID_ROOM_MAX = 8 }; /* opaque solids around the camera, one in another */

typedef struct SolidList {
    uint32_t objects[SOLID_ROOM_MAX];
    uint32_t count;
} SolidList;

typedef struct Solids {
    bool *is_solid;  /* by object: closed, so that light inside and outside never mix */
    SolidList rooms; /* solids that the camera is in: what is seen is inside of them */
} Solids;

/* Of those that may be in the object, or around it. On failure there is nothing to clear. */
AmbStatus solids_find(const AmbScene *scene, uint32_t object, Job *job, Solids *out_solids);
void solids_clear(Solids *solids);

/* What is around a point of a line. Light there is seen where both are 0. */
typedef struct SolidsAround {
    int hiding;  /* solids, but for the camera's rooms */
    int missing; /* of the camera's rooms, those that it is not in */
} SolidsAround;

/* For the beginning of a line that is outside of all solids but rooms. */
SolidsAround solids_around(const AmbScene *scene, const Solids *solids, Vec3 o, Vec3 d);

/* Beyond an opaque wall that the line meets. */
void solids_pass(const Solids *solids, const SurfacePoint *wall, Vec3 d, SolidsAround *around);

#endif
