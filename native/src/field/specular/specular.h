/* SPDX-License-Identifier: GPL-3.0-or-later
 * Accurate single scattering: for every camera segment, the points of every lit triangle where
 * light refracts into it are solved for, and the light that they send is integrated along the
 * segment [Walter09], [Holzschuch15]. Nothing is sampled, blurred or interpolated, so that this is
 * the reference of the other estimators, with which it has only scene and optics in common. See
 * docs/theory.md. */
#ifndef AMB_FIELD_SPECULAR_SPECULAR_H
#define AMB_FIELD_SPECULAR_SPECULAR_H

#include "field/field.h"
#include "field/specular/specular_tree.h"

typedef struct SpecularField {
    const AmbScene *scene;
    uint32_t object;
    bool adjoint_normals; /* see BoundaryCrossing */
    SpecularTree tree;
} SpecularField;

/* What building counts on the way, over all objects. */
typedef struct SpecularCount {
    LightTally tally;
    SceneLeaks leaks;
} SpecularCount;

/* The lit triangles of one object; lights must be points, spots and suns of no extent, outside of
 * every object. Adds to *count. */
AmbStatus specular_build(const AmbScene *scene, uint32_t object, bool adjoint_normals, Job *job,
                         SpecularCount *count, SpecularField *out_field);
void specular_clear(SpecularField *field);
uint64_t specular_bytes(const SpecularField *field);

/* See field_gather. */
FieldRadiance specular_gather(const SpecularField *field, const FieldSegment *segment);

#endif
