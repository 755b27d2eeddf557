/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light tubes: the lit triangles of a boundary with the light that they refract, and the radiance
 * along a segment as an integral over the curve in light space whose lines it meets.
 *
 *   L = sigma_s int dPhi p exp(-sigma_t (s + t)) delta(f),   f = (x - o) . (w x d)
 *
 * f is the side product of the light line x + s w and the camera ray o + t d: zero where they
 * meet, linear in the Pluecker coordinates of the light line, and so nearly linear inside a small
 * triangle, where with a the corner whose sign differs
 *   int_T delta(f) dA / A_T = 2 |fa| / (|fa - fb| |fa - fc|).
 * There is no kernel and no noise; folds of the light (caustics) are bounded sums of tubes. See
 * docs/theory.md. */
#ifndef AMB_FIELD_TUBES_TUBES_H
#define AMB_FIELD_TUBES_TUBES_H

#include "field/field.h"
#include "field/tubes/tube_gather.h"

typedef struct TubeParams {
    int32_t refinement;   /* each triangle is halved that many times along its edges, and limits
                           * on what a tube may be are; below 0 they double, but for size */
    uint32_t bounces;     /* internal reflections to follow */
    bool adjoint_normals; /* see BoundaryCrossing */
} TubeParams;

/* One tree for each light and material of the boundary that it enters through, and one for each
 * light and tint of what the walls reflect of it. */
typedef struct TubeField {
    uint64_t tube_count;
    Medium medium;
    TubeTree *trees;
    uint32_t tree_count;
} TubeField;

/* What building tubes counts on the way, over all objects. */
typedef struct TubeCount {
    LightTally tally;
    SceneLeaks leaks;
} TubeCount;

/* Tubes of all lights that enter one object, which must be outside of every object. Adds to *count.
 */
AmbStatus tubes_build(const AmbScene *scene, uint32_t object, const TubeParams *params, Job *job,
                      TubeCount *count, TubeField *out_tubes);
void tubes_clear(TubeField *tubes);
uint64_t tubes_bytes(const TubeField *tubes);
uint64_t tubes_reflected_bytes(const TubeField *tubes); /* of these */

/* See field_gather_many: all of one object. times: NULL where they are not asked for. */
void tubes_gather(const TubeField *tubes, const TubeRay rays[], uint32_t count, FieldTimes *times,
                  FieldRadiance out[]);

#endif
