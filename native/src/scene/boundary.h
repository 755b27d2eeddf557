/* SPDX-License-Identifier: GPL-3.0-or-later
 * Which media a path is inside of, and what happens to it at a dielectric boundary.
 *
 * Objects may overlap, lie in one another and touch. A path knows all that enclose it; where they
 * overlap the medium of the highest priority holds, and a boundary that does not change it is not
 * there ([Schmidt02]). Among equal priorities the object entered last holds. */
#ifndef AMB_SCENE_BOUNDARY_H
#define AMB_SCENE_BOUNDARY_H

#include "optics/dielectric.h"
#include "scene/scene.h"

enum { MEDIUM_STACK_MAX = 16 };

/* Objects that enclose a path, in the order in which they were entered. */
typedef struct MediumStack {
    uint32_t count;
    uint32_t objects[MEDIUM_STACK_MAX];
    uint32_t top; /* index of the one whose medium holds */
} MediumStack;

/* Object whose medium the path is in; count must be > 0. */
static inline uint32_t medium_stack_top(const MediumStack *stack) {
    return stack->objects[stack->top];
}

/* Material of that medium, or NULL outside of everything. */
static inline const SceneMaterial *medium_stack_material(const AmbScene *scene,
                                                         const MediumStack *stack) {
    if (stack->count == 0)
        return NULL;
    return &scene->materials[scene->objects[medium_stack_top(stack)].inside];
}

/* Index of refraction of that medium, 1 outside of everything. */
static inline float medium_stack_ior(const AmbScene *scene, const MediumStack *stack) {
    const SceneMaterial *material = medium_stack_material(scene, stack);
    return material != NULL ? material->ior : 1.0f;
}

/* Media at a point, found by following a ray to the outside. */
MediumStack scene_media_at(const AmbScene *scene, Vec3 p);

typedef struct BoundaryCrossing {
    bool is_ignored;  /* the medium stays the same: the path goes on straight, with `beyond`, as if
                       * nothing were there. A boundary of lower priority; an object met again from
                       * the same side (its mesh crosses itself or is open) */
    bool is_stray;    /* left a mesh that the path never entered: it is open */
    bool is_again;    /* entered an object that it is in: its mesh crosses itself */
    bool is_opaque;   /* an opaque face lies on the boundary: the path ends at `surface`, which is
                       * that face's, and what follows but `beyond` is not set */
    bool is_entering; /* from the side of the outward normal of `surface` */
    bool can_refract; /* false: total reflection, or a direction on the wrong side of the face, */
    bool can_reflect; /* where light has no path: Veach's correction vanishes towards it */
    MediumStack beyond; /* media after refraction, or after passing */
    float eta;          /* n here / n beyond */
    Vec3 n;             /* unit shading normal on the incident side */
    DielectricSplit split;
    /* Its directions, but laid into the face where n turns them to the wrong side of it: for paths
     * that carry radiance. Ended there, they would leave rims of coarse smooth meshes dark. */
    Vec3 refracted, reflected;
    float adjoint_refract; /* Veach's correction for shading normals when light is traced, */
    float adjoint_reflect; /* |wo.Ns| |wt.Ng| / (|wo.Ng| |wt.Ns|)  [Veach97] 5.3.2; 0 where Ns is
                            * turned away from the light and no camera path comes that way */
    /* Where faces of several objects lie on one another: the one of the object whose medium begins
     * or ends there, of the higher priority if these are two. Else as given. */
    SurfacePoint surface;
} BoundaryCrossing;

/* A path along unit d arrives at a dielectric surface; all boundaries that lie on it within
 * rounding are crossed at once, in an order that does not depend on which of them was met. Pure. */
BoundaryCrossing boundary_cross(const AmbScene *scene, const MediumStack *stack,
                                const SurfacePoint *surface, Vec3 d);

/* Whether the boundary of another object lies on this one there. */
bool boundary_is_touched(const AmbScene *scene, const SurfacePoint *surface);

/* The next surface that a path meets. */
typedef struct BoundaryArrival {
    float t;                   /* m, from the path's origin */
    bool is_opaque;            /* `surface` is, and there is no crossing */
    uint32_t passed_count;     /* boundaries passed on the way, */
    uint32_t irregular_count;  /* open or crossing meshes met so far, */
    uint32_t nested_count;     /* and boundaries inside of other objects */
    BoundaryCrossing crossing; /* not ignored; with the surface in any case */
} BoundaryArrival;

/* Follows a path along unit d through its medium to where that ends, past boundaries that are
 * ignored: *stack takes in the objects entered and left, and its medium stays the same. For a place
 * on the way the stack is that of a path followed up to there. False: nothing up to t_max; the
 * counts are set. */
bool boundary_find(const AmbScene *scene, MediumStack *stack, Vec3 o, Vec3 d, float t_max,
                   BoundaryArrival *out_arrival);

#endif
