/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that scatters once inside a segment of a ray: the one interface of all estimators. */
#ifndef AMB_FIELD_FIELD_H
#define AMB_FIELD_FIELD_H

#include "light/light_trace.h"

typedef struct Field Field;

/* Of FieldParams. */
enum { TUBE_REFINEMENT_MIN = -2, TUBE_REFINEMENT_MAX = 4 };

typedef struct FieldParams {
    uint32_t estimator;      /* AMB_ESTIMATOR_*, not AUTO; TUBES: with points for the light pass's
                              * beams, which carry what tubes do not */
    uint64_t sample_target;  /* points: volume samples to place, about */
    float kernel_size;       /* points: C_k of [Liang19] eq. 8 */
    int32_t tube_refinement; /* tubes: see TubeParams */
    uint32_t light_bounces;  /* tubes: internal reflections to follow */
    uint32_t part_count;     /* points: parts that can be gathered one at a time; 0: one */
    const bool *targets;     /* by object: those that have a field; NULL: all */
    bool adjoint_normals;    /* tubes and specular: see BoundaryCrossing; points have it from the
                              * light pass */
} FieldParams;

/* CPU seconds of gathers, by what the light did before: of light that has passed an object, and of
 * other light that was reflected inside. */
typedef struct FieldTimes {
    double passed, reflected;
} FieldTimes;

/* A straight stretch of a camera path inside one medium. */
typedef struct FieldSegment {
    Vec3 o, d;       /* d unit, direction of travel away from the camera */
    float length;    /* m, finite */
    uint32_t object; /* whose medium */
    uint32_t part;   /* 0: all light; k: that of part k of the field, as if it were all: over the
                      * parts the mean is the whole */
    float reflected_excess; /* what light that was reflected inside counts for beyond once, where
                             * tubes carry the rest: 0 as it is, -1 not at all, which saves its
                             * time */
    Rgb straight;           /* what scatters straight on, 1/m; black: not asked for */
    FieldTimes *times;      /* NULL: not asked for */
} FieldSegment;

typedef struct FieldRadiance {
    Rgb radiance;       /* W m^-2 sr^-1, at the segment's start, inside the medium (no n^2) */
    float frequency;    /* sum of contribution * frequency factor of its sample; tubes: if wanted */
    float contribution; /* sum of contributions (mean of channels): the weight of frequency */
    Rgb reflected;      /* of radiance, light that was reflected inside before it scattered, */
    Rgb passed;         /* and light that has passed an object before; they overlap */
    /* Of light that goes straight on along the segment after it scattered, to its start: once, and
     * more often. Not in radiance. */
    Rgb straight_once, straight_more;
} FieldRadiance;

static inline FieldRadiance field_radiance_add(FieldRadiance a, FieldRadiance b) {
    return (FieldRadiance){.radiance = rgb_add(a.radiance, b.radiance),
                           .frequency = a.frequency + b.frequency,
                           .contribution = a.contribution + b.contribution,
                           .reflected = rgb_add(a.reflected, b.reflected),
                           .passed = rgb_add(a.passed, b.passed),
                           .straight_once = rgb_add(a.straight_once, b.straight_once),
                           .straight_more = rgb_add(a.straight_more, b.straight_more)};
}

static inline FieldRadiance field_radiance_scale(FieldRadiance a, float s) {
    return (FieldRadiance){.radiance = rgb_scale(a.radiance, s),
                           .frequency = s * a.frequency,
                           .contribution = s * a.contribution,
                           .reflected = rgb_scale(a.reflected, s),
                           .passed = rgb_scale(a.passed, s),
                           .straight_once = rgb_scale(a.straight_once, s),
                           .straight_more = rgb_scale(a.straight_more, s)};
}

/* Builds the field of an estimator: points from the light pass; tubes and specular, which refract
 * at the mesh's own triangles, from the scene, and light may be NULL. Where it is not, tubes are
 * joined by points for its beams. The scene must outlive it. */
AmbStatus field_create(const AmbScene *scene, const LightField *light, const FieldParams *params,
                       Job *job, Field **out_field);
void field_destroy(Field *field);

/* Radiance that light scattered once inside the segment sends to its start,
 *   L = int_0^length exp(-sigma_t t) Q(o + t d, -d) dt,
 * and with x = straight t, where that is asked for, the same of x Q and (exp(x) - 1 - x) Q.
 * Any thread; the field is const, but for its count of sums that are no numbers and are left out.
 */
FieldRadiance field_gather(const Field *field, const FieldSegment *segment);

enum { FIELD_GATHER_MAX = 64 };

/* The same for as many segments as that: neighbours in one object share work. What each gets does
 * not depend on the others. Of segment i tubes tell the frequency if bit i is set, which takes a
 * tenth longer. */
void field_gather_many(const Field *field, const FieldSegment segments[], uint32_t count,
                       uint64_t with_frequency, FieldRadiance out[]);

/* How many of them were born in an object: above zero it is a defect. */
uint64_t field_nonfinite(const Field *field, uint32_t object);

/* What a field is made of. */
typedef struct FieldSize {
    uint64_t volume_samples, tubes, lit_triangles;
    uint64_t point_bytes, bytes; /* of volume samples; of all */
    /* Of the latter, what holds light that has passed an object, and other light that was
     * reflected inside. */
    uint64_t passed_bytes, reflected_bytes;
} FieldSize;

FieldSize field_size(const Field *field);

/* Adds the flux that tubes or lit triangles take up, and light lines that left through holes, to
 * what the light pass says of points; what arrives and enters replaces the light pass's, which
 * traced the same. */
void field_tally(const Field *field, LightTally *tally, SceneLeaks *leaks);

#endif
