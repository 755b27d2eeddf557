/* SPDX-License-Identifier: GPL-3.0-or-later
 * A few pixels seen through one field after the other along the same camera rays: their
 * differences are the fields' own. */
#ifndef AMB_RENDER_PROBE_H
#define AMB_RENDER_PROBE_H

#include "camera/camera_path.h"
#include "render/field_error.h"

/* Radiance of one probe pixel, by the two halves of its samples. */
typedef struct ProbePixel {
    Rgb halves[2];
} ProbePixel;

/* One pixel of each square block. */
typedef struct Probe {
    uint32_t width, height; /* of the film */
    uint32_t block;         /* pixels along an edge */
    uint32_t blocks_x, blocks_y;
    uint8_t *objects; /* by block: 1 if its pixel shows a translucent object */
    uint32_t *counts; /* by block: samples of its pixel */
    ProbePixel *levels[FIELD_LEVEL_MAX];
    uint32_t level_count;
    FieldDifferences differences; /* over the pixels with objects, or all if there are none */
    double radiance;              /* mean over the same, of the newest level */
} Probe;

AmbStatus probe_create(uint32_t width, uint32_t height, Probe *out_probe);
void probe_clear(Probe *probe);

/* Adds a level. camera: its replicas must be 2; x, y: the film's corner in the image. */
AmbStatus probe_run(Probe *probe, const AmbScene *scene, const Field *field,
                    const CameraParams *camera, uint32_t x, uint32_t y, Job *job);

/* After the first two levels: many samples for those pixels that make most of their difference,
 * in both and all that follow. It is that of few pixels, where light is focused. */
AmbStatus probe_focus(Probe *probe, const AmbScene *scene, Field *const fields[2],
                      const CameraParams *camera, uint32_t x, uint32_t y, Job *job);

/* Squared difference of two levels in a block's pixel, mean over channels, noise included. */
float probe_block_square(const Probe *probe, uint64_t block, uint32_t a, uint32_t b);

#endif
