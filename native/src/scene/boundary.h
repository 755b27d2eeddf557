/* SPDX-License-Identifier: GPL-3.0-or-later
 * Which media a path is inside of, and what happens to it at a dielectric boundary. */
#ifndef AMB_SCENE_BOUNDARY_H
#define AMB_SCENE_BOUNDARY_H

#include "optics/dielectric.h"
#include "scene/scene.h"

enum { MEDIUM_STACK_MAX = 8 };

/* Objects that enclose a path, outermost first; the last one's medium is the one it is in. */
typedef struct MediumStack {
    uint32_t count;
    uint32_t objects[MEDIUM_STACK_MAX];
} MediumStack;

/* Object whose medium the path is in; count must be > 0. */
static inline uint32_t medium_stack_top(const MediumStack *stack) {
    return stack->objects[stack->count - 1];
}

/* Material of that medium, or NULL outside of everything. */
static inline const SceneMaterial *medium_stack_material(const AmbScene *scene,
                                                         const MediumStack *stack) {
    if (stack->count == 0)
        return NULL;
    return &scene->materials[scene->objects[medium_stack_top(stack)].inside];
}

/* Media at a point, found by following a ray to the outside. */
MediumStack scene_media_at(const AmbScene *scene, Vec3 p);

typedef struct BoundaryCrossing {
    bool is_ignored;  /* seen from inside by a path that never came in (open or self-crossing
                       * mesh): it goes on as if nothing were there */
    bool is_entering; /* from the side of the outward normal */
    bool can_refract; /* false: total reflection, or a direction on the wrong side of the face */
    bool can_reflect;
    MediumStack beyond; /* media after refraction */
    float eta;          /* n here / n beyond */
    Vec3 n;             /* unit shading normal on the incident side */
    DielectricSplit split;
    float adjoint_refract; /* Veach's correction for shading normals when light is traced, */
    float adjoint_reflect; /* |wo.Ns| |wt.Ng| / (|wo.Ng| |wt.Ns|)  [Veach97] 5.3.2 */
} BoundaryCrossing;

/* A path along unit d arrives at a dielectric surface. Pure. */
BoundaryCrossing boundary_cross(const AmbScene *scene, const MediumStack *stack,
                                const SurfacePoint *surface, Vec3 d);

#endif
