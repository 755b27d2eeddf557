/* SPDX-License-Identifier: GPL-3.0-or-later
 * The Error pass: the stated error by place. Noise is each pixel's own, smoothed over neighbours;
 * what the light's discretisation costs is spread as the levels of a probe differ. */
#ifndef AMB_RENDER_ERROR_PASS_H
#define AMB_RENDER_ERROR_PASS_H

#include "render/survey.h"

/* What two levels of a probe say of the picture's squared error, by place. */
typedef struct BlockErrors {
    const Probe *probe;
    double scale;   /* squared error in units of the probe's squared differences */
    float *squares; /* by block of the probe: smoothed squared differences, or NULL */
    uint32_t set;   /* of the accuracy's sets: whose pixels have this error */
} BlockErrors;

enum {
    BLOCKS_OF_FIELD, /* by part */
    BLOCKS_OF_PHOTONS = BLOCKS_OF_FIELD + FIELD_PART_COUNT,
    BLOCKS_OF_CAUSTICS,
    BLOCK_ERROR_COUNT
};

typedef struct ErrorPass {
    Survey *survey;
    double *shares; /* by pixel: variance handed to each of the neighbours */
    BlockErrors blocks[BLOCK_ERROR_COUNT];
    const BlockErrors *measured; /* of sum_blocks */
} ErrorPass;

/* Fails with AMB_OUT_OF_MEMORY; to be cleared either way. The survey has to outlive it. */
AmbStatus error_pass_create(Survey *survey, ErrorPass *out_pass);
void error_pass_clear(ErrorPass *pass);

/* Into the film, after survey_measure_noise: over the pixels of a set, the mean of its square is
 * (stated * radiance)^2. noise_factor: of the survey's noise. Leaves the survey's costs changed. */
AmbStatus error_pass_write(ErrorPass *pass, double noise_factor);

#endif
