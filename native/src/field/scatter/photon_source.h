/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where photons start: lamps and the world, towards each object that light can enter. */
#ifndef AMB_FIELD_SCATTER_PHOTON_SOURCE_H
#define AMB_FIELD_SCATTER_PHOTON_SOURCE_H

#include "field/scatter/scatter.h"
#include "light/light_batch.h"

typedef struct PhotonSource {
    LightBatch *batches;
    uint64_t batch_count, photon_count;
} PhotonSource;

typedef struct Photon {
    Vec3 o, d; /* d unit */
    float way; /* m, travelled before o */
    Rgb flux;  /* W; from the surroundings: for a radiance of 1 */
    const LightBatch *batch;
} Photon;

AmbStatus photon_source_create(const AmbScene *scene, const ScatterParams *params,
                               PhotonSource *out_source);
void photon_source_clear(PhotonSource *source);

/* Photons towards an object. */
uint64_t photon_source_count(const PhotonSource *source, uint32_t object);

/* Photon i < photon_count. Those of a batch form a lattice, as the rays of the light pass do. */
Photon photon_emit(const PhotonSource *source, uint64_t i);

/* Radiance that an opaque surface outside of all media sends along d, translucent objects casting
 * black shadows: that of lamps and the world, straight from there or, where it interreflects, by
 * way of other opaque surfaces, and its own emission unless it is one of the lamps. Random numbers
 * from *dimension on. */
Rgb photon_surface_radiance(const AmbScene *scene, const SurfacePoint *surface, Vec3 d,
                            bool interreflects, Rng rng, uint32_t *dimension);

/* Of light that an opaque surface sends on so much survives, for as much more: in closed rooms with
 * white walls it ends. */
float photon_survival(Rgb albedo);

/* Share of the flux that reaches distance t, of a photon that nothing stopped: the falloff of
 * Cycles' discs (see light_trace). */
float photon_falloff(const Photon *photon, float t);

#endif
