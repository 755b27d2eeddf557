/* SPDX-License-Identifier: GPL-3.0-or-later
 * Decides from the scene alone what is worth simulating, and says why. */
#ifndef AMB_PLAN_PLAN_H
#define AMB_PLAN_PLAN_H

#include "camera/camera_path.h"
#include "plan/share.h"

enum {
    PLAN_SINGLE_SCATTERING,
    PLAN_LIGHT_BOUNCES,
    PLAN_CAMERA_BOUNCES,
    PLAN_SURFACE_REFLECTION,
    PLAN_BACKGROUND,
    PLAN_TRANSMITTED_LIGHT,
    PLAN_WORLD_LIGHT,
    PLAN_LIGHT_ON_SURFACES,
    PLAN_CAUSTICS,
    PLAN_INTERREFLECTION,
    PLAN_RETURN, /* into media, see CameraWay */
    PLAN_LAMP_IMAGES,
    PLAN_DOUBLE_SCATTERING,
    PLAN_MULTIPLE_SCATTERING,
    PLAN_EFFECT_COUNT
};

typedef struct PlanEffect {
    const char *name;
    bool is_simulated;
    const char *reason; /* one phrase, static storage */
    uint32_t count;     /* internal reflections that are followed; 0 for other effects */
    Share share;        /* as predicted */
    Share rest;         /* of what is left out: all of it, or reflections beyond count */
} PlanEffect;

static inline PlanEffect plan_simulated(const char *name, const char *reason) {
    return (PlanEffect){.name = name, .is_simulated = true, .reason = reason};
}

static inline PlanEffect plan_skipped(const char *name, const char *reason) {
    return (PlanEffect){.name = name, .reason = reason};
}

/* What an object adds to an effect. */
typedef struct PlanObject {
    bool is_simulated;
    Share share;
} PlanObject;

/* What probes say of a camera sample that walks bring later orders and light of the surroundings:
 * what tells whether photons are the cheaper ones. */
typedef struct PlanWalks {
    bool is_known;
    double noise; /* one sample's, of the effects to be simulated, relative to the mean radiance */
    double cost;  /* in gathers (effect_cost.h) */
    double without; /* the same where photons bring later orders */
    double pixels;  /* that show an object */
} PlanWalks;

typedef struct Plan {
    PlanEffect effects[PLAN_EFFECT_COUNT];
    bool is_dark;        /* no ray of a lamp brings light to an object */
    bool has_field;      /* an effect gathers light of lamps in media */
    PlanObject *objects; /* by object and effect, object_count * PLAN_EFFECT_COUNT; owned */
    bool *targets;       /* by object: light is traced to it; owned */
    uint32_t object_count;
    bool is_automatic;            /* shares decided */
    uint64_t probe_count;         /* camera paths that measured them; 0: nothing was measured */
    double share_min;             /* least share of an effect that is simulated */
    double cpu;                   /* seconds that planning took */
    double omitted;               /* shares of all that was left out for being less, together */
    uint32_t estimator;           /* resolved, not AUTO */
    uint32_t tube_bounces;        /* of the light's reflections, those that tubes would follow */
    const char *estimator_reason; /* one phrase, static storage */
    PlanWalks walks;
    uint32_t scatter_estimator; /* resolved, not AUTO; of no effect without later orders */
    const char *scatter_estimator_reason; /* one phrase, static storage */
    bool has_points; /* the light pass is run: for volume samples, of all light or of what tubes
                      * do not carry */
    uint64_t light_samples; /* volume samples without a target or a limit that say otherwise */
    LightTraceParams light;
    FieldParams field;
    CausticParams caustics; /* light.ray_count 0: none; glow.photon_count 0: no glow */
    ScatterParams scatter;  /* of PHOTONS */
    CameraParams camera;
} Plan;

/* What probe rays of the light say of the meshes, the first two of one ray in a thousand or more.
 */
typedef struct MeshProblems {
    bool is_irregular; /* a mesh is open or crosses itself */
    bool is_nested;    /* an object is inside of another, or touches it */
    bool is_veiled;    /* much of the light in media has come through other objects */
    bool is_trapped;   /* much of it has been reflected inside three times or more */
    bool is_strewn;    /* what is reflected inside once spreads far on its way to the next wall */
} MeshProblems;

/* The part of the picture that is rendered, of params->width x height. */
typedef struct PlanCrop {
    uint32_t x, y, width, height;
} PlanCrop;

/* AMB_UNSUPPORTED for estimators and effects that do not exist; the scene need not be built. */
AmbStatus plan_check(const AmbRenderParams *params);

/* The scene must be built. With explains, the shares of effects are measured even where the plan
 * does not need them and they cost more than a small part of the render. AMB_UNSUPPORTED where an
 * estimator is asked for by name that cannot render this scene. */
AmbStatus plan_create(const AmbScene *scene, const AmbRenderParams *params, const PlanCrop *crop,
                      bool explains, Job *job, Plan *out_plan);
void plan_clear(Plan *plan);

/* Another number of volume samples than the parameters say. */
void plan_set_light_samples(Plan *plan, uint64_t samples);

/* A light field of a quarter of the bytes, about; false: it is as coarse as can be. */
bool plan_reduce_field(Plan *plan);
/* The same of the map of caustics. */
bool plan_reduce_caustics(Plan *plan);
/* The same of photons' cells, or a tree cut's samples. */
bool plan_reduce_scatter(Plan *plan);

const char *plan_estimator_name(uint32_t estimator);
const char *plan_scatter_estimator_name(uint32_t estimator);

#endif
