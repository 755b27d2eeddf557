/* SPDX-License-Identifier: GPL-3.0-or-later
 * A few pixels seen through one field after the other along the same camera rays: their
 * differences are the fields' own. */
#ifndef AMB_RENDER_PROBE_H
#define AMB_RENDER_PROBE_H

#include "camera/camera_path.h"
#include "render/field_error.h"

/* One probe pixel: sums of radiance over the two halves of its samples. */
typedef struct ProbePixel {
    Rgb sums[2];
    uint32_t count; /* samples so far */
} ProbePixel;

/* What a level is: the light of a picture as its camera rays find it. */
typedef struct ProbeSight {
    const AmbScene *scene;
    const Field *field;
    const CameraParams *camera; /* its replicas must be 2 */
    uint32_t x, y;              /* the film's corner in the image */
} ProbeSight;

/* What a pixel shows. */
enum { PROBE_OBJECT = 1, PROBE_CAUSTICS = 2 };

/* Mean over pixels. */
typedef struct ProbeMean {
    FieldDifferences differences;
    double radiance; /* of the newest level */
    uint64_t count;  /* pixels */
} ProbeMean;

/* One pixel of each square block. */
typedef struct Probe {
    uint32_t width, height; /* of the film */
    uint32_t block;         /* pixels along an edge */
    uint32_t blocks_x, blocks_y;
    uint8_t *shows;   /* by block: PROBE_* of its pixel */
    uint8_t wanted;   /* pixels that show one of these are compared, or all if none does */
    uint32_t *counts; /* by block: samples of its pixel */
    double small; /* an error of so much, in units of the mean radiance, need not be known well, and
                   * a squared one to no better than its square */
    ProbePixel *levels[FIELD_LEVEL_MAX];
    uint32_t level_count;
    FieldDifferences differences; /* over the pixels that are compared */
    double radiance;              /* mean over the same, of the newest level */
} Probe;

/* Pixels of a probe at least, where the image has so many. */
enum { PROBE_PIXELS = 1 << 12 };

/* Compares the pixels that show an object. */
AmbStatus probe_create(uint32_t width, uint32_t height, uint32_t pixels, double small,
                       Probe *out_probe);
void probe_clear(Probe *probe);

/* Adds a level. */
AmbStatus probe_run(Probe *probe, const ProbeSight *sight, Job *job);

/* With at least two levels: more samples in all of them, and in all that follow, until the newest
 * two's difference is known or small beyond doubt. sights: by level. has_folds: it is that of few
 * pixels, where light is focused, which get many. */
AmbStatus probe_refine(Probe *probe, const ProbeSight sights[], bool has_folds, Job *job);

/* Over the pixels that show one of these (PROBE_*), or all of them for 0. */
ProbeMean probe_mean(const Probe *probe, uint8_t shows);

/* The noise that so many samples of each pixel leave in the newest level, root mean square over the
 * pixels that are compared, by the halves of theirs; more than less where edges have most of it. */
double probe_noise(const Probe *probe, uint32_t samples);

/* Squared difference of two levels in a block's pixel, mean over channels, noise included. */
float probe_block_square(const Probe *probe, uint64_t block, uint32_t a, uint32_t b);

#endif
