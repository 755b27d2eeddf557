/* SPDX-License-Identifier: GPL-3.0-or-later
 * Light that scatters three times and more between two points of a medium without end, in a
 * table: [Wang16]'s multiple scattering as its successor [Wang17] describes it. */
#ifndef AMB_FIELD_SCATTER_PROPAGATOR_H
#define AMB_FIELD_SCATTER_PROPAGATOR_H

#include "base/parallel.h"
#include "optics/medium.h"

/* One channel of a medium. Distances tau are optical. A beam that travels along d collides once
 * at the origin, with unit power; T is what then scatters for the third and later times at tau,
 * radiance per optical length into the direction of travel o, per optical area:
 *   T(tau, d . r, r . o, azimuth of o about r from d),   r = the direction to tau.
 * Kept is tau exp(decay tau) T, which is smooth. */
typedef struct Propagator {
    float tau_max; /* beyond it the last value goes on */
    float decay;
    float log_scale;          /* see propagator_radial */
    uint32_t direction_count; /* nodes for d . r, the same for r . o: 1 where g = 0 */
    uint32_t azimuth_count;   /* over 0 .. pi; 1 where g = 0 */
    float *values;            /* (radial, d . r, r . o, azimuth) */
    float *means;             /* (radial, r . o): the same for beams of all directions alike */
    uint64_t collision_count; /* of the walks that filled it */
} Propagator;

typedef struct PropagatorParams {
    float albedo;
    uint32_t lobe_count;
    float shares[AMB_PHASE_LOBE_MAX]; /* of lobes in what scatters; sum 1 */
    float g[AMB_PHASE_LOBE_MAX];
    float tau_max;
    uint32_t order_max; /* 0: no limit */
} PropagatorParams;

/* By random walks; the same result for any number of threads. */
AmbStatus propagator_build(const PropagatorParams *params, Job *job, Propagator *out);
void propagator_clear(Propagator *propagator);
uint64_t propagator_bytes(const Propagator *propagator);

/* tau T for a beam whose directions have the mean cosine `coherence` to d: between that of one
 * direction (1) and of all (0). */
float propagator_at(const Propagator *propagator, float tau, float cos_in, float cos_out,
                    float cos_azimuth, float coherence);

#endif
