/* SPDX-License-Identifier: GPL-3.0-or-later
 * The session: runs the stages in order on a thread of its own; start, poll, cancel, finish. */
#ifndef AMB_RENDER_RENDER_H
#define AMB_RENDER_RENDER_H

#include <pthread.h>

#include "base/memory.h"
#include "film/film.h"
#include "plan/plan.h"
#include "render/accuracy.h"

enum { STAGE_SCENE, STAGE_LIGHT, STAGE_FIELD, STAGE_CAMERA, STAGE_COUNT };
extern const char *const STAGE_NAMES[STAGE_COUNT];

typedef struct StageCost {
    double cpu, wall; /* seconds */
} StageCost;

/* What is built from light: traced, put in order, and its error measured. */
enum { LIGHT_COST_FIELD, LIGHT_COST_SCATTER, LIGHT_COST_CAUSTICS, LIGHT_COST_COUNT };

/* What the newest light field is made of. */
typedef struct FieldAccount {
    uint64_t ray_count;
    SceneLeaks leaks; /* of the light */
    uint64_t light_bytes;
    FieldSize size;
    LightTally tally;
} FieldAccount;

/* What photons of later orders did. */
typedef struct ScatterAccount {
    uint64_t cell_count, bytes;
    ScatterTally tally;
} ScatterAccount;

struct AmbRender {
    AmbScene *scene;
    AmbRenderParams params;
    uint32_t crop_x, crop_y; /* of the film in the full image */
    Plan plan;
    Film film;
    Job job;
    MemoryLimit memory;
    pthread_t thread;
    double start; /* clock_wall */

    /* The lock guards what follows. */
    pthread_mutex_t lock;
    pthread_cond_t ended_changed;
    uint32_t state; /* AMB_STATE_* */
    uint32_t stage;
    uint32_t samples_done, pixel_step; /* as in AmbProgress */
    float fraction;                    /* largest reported */
    double stage_start;
    bool is_reduced;   /* the light field is coarser than asked for, or will be: memory */
    Accuracy accuracy; /* the measure so far; only its thread writes */
    double elapsed;    /* of an ended render */
    AmbStatus status;
    AmbErrorInfo error;

    /* Constant once ended. */
    StageCost costs[STAGE_COUNT];
    double light_costs[LIGHT_COST_COUNT]; /* CPU seconds, of stages before the camera's */
    Ledger ledger;                        /* of the camera's */
    FieldAccount account;
    CausticAccount caustics;
    uint64_t caustic_rays_planned; /* under a target, before it is known how many are enough */
    ScatterAccount scatter;
    atomic_uint_least64_t camera_leak_count;
    atomic_uint_least32_t camera_leak_object; /* the first of theirs */
    uint64_t scene_bytes, peak_rss_bytes;
    uint64_t *nonfinite_objects; /* sums over the light field that were no numbers, or NULL */
    bool has_plan;
};

AmbStatus render_start(AmbScene *scene, const AmbRenderParams *params, AmbRender **out_render);
void render_progress(AmbRender *render, AmbProgress *out_progress);
void render_cancel(AmbRender *render);
/* See amb_render_wait. */
AmbStatus render_wait(AmbRender *render, double timeout, bool *out_ended);
void render_destroy(AmbRender *render);
/* See amb_plan_explain. */
AmbStatus render_explain(AmbScene *scene, const AmbRenderParams *params, char *buffer,
                         uint64_t size, uint64_t *out_size);

/* Stages, for those who run them more than once. */

/* The light field as the plan has it now; its account replaces the last one's. */
AmbStatus render_build_field(AmbRender *render, Field **out_field);
/* The same, coarser and coarser where it goes beyond the limit of memory. */
AmbStatus render_build_fitting_field(AmbRender *render, Field **out_field);
/* Whether a failure was the limit's of memory; if so, the next one will be told from it. */
bool render_forgive_memory(AmbRender *render, AmbStatus status);
/* One more level of a probe: light of fields[1] and of scatters[1] (NULL: none, or walks). [0] are
 * the level before, of which a second level may ask for more samples. has_folds as in
 * probe_refine. */
AmbStatus render_probe(AmbRender *render, Probe *probe, const Field *const fields[2],
                       const Scatter *const scatters[2], bool has_folds);
/* One more level of a probe of photons before there is a field. */
AmbStatus render_probe_trial(AmbRender *render, Probe *probe, const ProbeSight *sight);
/* One more level of the probe of caustics; sights: by level. */
AmbStatus render_probe_caustics(AmbRender *render, const ProbeSight sights[]);
/* A map of caustics as the plan has it now; not yet seen by the camera. */
AmbStatus render_build_caustics(AmbRender *render, CausticMap **out_map);
/* Light of later orders as the plan has it now, seen by the camera from then on. */
AmbStatus render_build_scatter(AmbRender *render, Scatter **out_scatter);
/* One more round of camera samples: quotas, by pixel of the film. */
AmbStatus render_round(AmbRender *render, const Field *field, const uint32_t *quotas);
/* The camera samples of all rounds, about, as far as is known. */
void render_expect(AmbRender *render, double samples);

#endif
