/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that has scattered before and scatters once more inside a segment of a ray: what
 * field_gather is for the first scattering, for all later ones, without a walk. */
#ifndef AMB_FIELD_SCATTER_SCATTER_H
#define AMB_FIELD_SCATTER_SCATTER_H

#include "field/field.h"
#include "field/scatter/photon_landing.h"
#include "math/sampling.h"

typedef struct Scatter Scatter;

typedef struct ScatterParams {
    bool uses_tree_cut;    /* [Wang16]'s volume samples instead of photons; see tree_cut.h */
    uint64_t photon_count; /* to emit, over all lights, the world and objects; or samples */
    uint32_t sum_count; /* photons: sums kept at most while they walk, and so threads; 0: enough */
    uint32_t light_bounces; /* internal reflections of light that has not scattered yet */
    uint32_t order_max;     /* scatterings to follow; 0: no limit */
    bool follows_through;   /* go on with light that leaves an object, to others behind it */
    bool adjoint_normals;   /* see BoundaryCrossing; for light that has not scattered yet */
    bool has_world;         /* the world's light enters media; photons only, as are the next two: */
    bool interreflects;     /* what opaque surfaces send one another does, too, */
    bool returns;           /* and what comes to them from translucent objects */
    float landing_part; /* of the photons, whose landings on opaque surfaces are kept; 0: none */
    uint32_t seed;
} ScatterParams;

/* Radiance at the segment's start by the order of its last scattering, W m^-2 sr^-1, inside the
 * medium (no n^2). */
typedef struct ScatterRadiance {
    Rgb once; /* light of the world alone: that of lamps is field_gather's */
    Rgb twice, more;
} ScatterRadiance;

/* What photons did, W per channel but for the counts. */
typedef struct ScatterTally {
    uint64_t photon_count, collision_count;
    double entered[3], absorbed[3], escaped[3]; /* entered = absorbed + escaped + lost */
    double lost[3]; /* through holes, or more boundaries than a path may have */
} ScatterTally;

/* The scene must outlive it. Same result for any number of threads. */
AmbStatus scatter_create(const AmbScene *scene, const ScatterParams *params, Job *job,
                         Scatter **out_scatter);
void scatter_destroy(Scatter *scatter);

/* Any thread; the scatter is const. forward: optical depth, of light that scatters straight on,
 * along the ray before the segment, 0 at the lens. What goes straight on along the segment, of
 * light that has scattered before, is in the radiance; of light that has not, or once and straight
 * from a lamp, the caller knows. u: in [0,1)^2, chooses what is looked at where light comes from
 * many cells, with the same mean; NULL: everything. */
ScatterRadiance scatter_gather(const Scatter *scatter, const FieldSegment *segment, Rgb forward,
                               const Sample2 *u);

/* What an object's medium scatters straight on, 1/m: the peaks of sharp lobes, which cells do not
 * have (lobe.h). */
Rgb scatter_forward(const Scatter *scatter, uint32_t object);

/* Optical depth of a way of that depth which goes on for a length in a medium that scatters so much
 * straight on. It ends at 60: no more than half of what light meets sends it straight on, so that
 * less than e^-60 of it is left there, and e^60 is a number. */
static inline Rgb scatter_forward_depth(Rgb before, Rgb straight, float length) {
    const Rgb depth = rgb_add(before, rgb_scale(straight, length));
    return rgb(fminf(depth.r, 60.0f), fminf(depth.g, 60.0f), fminf(depth.b, 60.0f));
}

/* What landed, in lists of the caller's own from then on: a second time there are none. The same
 * for any number of threads. */
enum { SCATTER_LIST_MAX = 16 };
void scatter_take_landings(Scatter *scatter, PhotonLandings out_lists[SCATTER_LIST_MAX]);

uint64_t scatter_bytes(const Scatter *scatter);
uint64_t scatter_cell_count(const Scatter *scatter); /* or volume samples */
const ScatterTally *scatter_tally(const Scatter *scatter);

#endif
