/* SPDX-License-Identifier: GPL-3.0-or-later
 * The shares of the effects in the picture, measured before the render: a few camera paths with
 * everything on, through coarse light fields, each contribution marked with what it needs. */
#ifndef AMB_PLAN_EFFECT_SHARES_H
#define AMB_PLAN_EFFECT_SHARES_H

#include "plan/effect_cost.h"
#include "plan/light_probe.h"
#include "plan/share.h"
#include "plan/view.h"

enum {
    SHARE_SINGLE,
    SHARE_DOUBLE,
    SHARE_MULTIPLE,
    SHARE_SURFACE_REFLECTION,
    SHARE_BACKGROUND,
    SHARE_TRANSMITTED,
    SHARE_WORLD_LIGHT,
    SHARE_RETURN,
    /* More reflections than BOUNCE_STEPS[i], for all but the last: what no step follows is not
     * seen. */
    SHARE_CAMERA_BOUNCES,
    SHARE_LIGHT_BOUNCES = SHARE_CAMERA_BOUNCES + CAMERA_STEP_COUNT - 1,
    SHARE_COUNT = SHARE_LIGHT_BOUNCES + LIGHT_STEP_COUNT - 1
};

typedef struct EffectShares {
    uint64_t probe_count;
    double radiance;       /* mean over the pixels that show an object, mean of channels */
    double radiance_error; /* standard error in units of it */
    uint32_t object_count;
    ShareSum image[SHARE_COUNT];
    ShareSum *objects; /* by object and share: what it adds in the object's own medium, or by way of
                        * its boundary */
    double radiance_sum, radiance_square_sum;
    EffectWork work_sum; /* over the probes */
} EffectShares;

typedef struct EffectProbe {
    const AmbScene *scene;
    const View *view;
    const LightProbe *light;
    CameraParams camera; /* with everything on */
    double share_min;    /* what shows */
} EffectProbe;

AmbStatus effect_shares_create(const AmbScene *scene, EffectShares *out_shares);
void effect_shares_clear(EffectShares *shares);

/* Measures `count` more probes. */
AmbStatus effect_shares_measure(EffectShares *shares, const EffectProbe *probe, uint64_t count,
                                Job *job);

/* Of one camera sample. */
EffectWork effect_work(const EffectShares *shares);

/* The noise that one sample has of what it finds of a share, in units of the mean radiance. */
double effect_noise(const EffectShares *shares, uint32_t share);

Share effect_share(const EffectShares *shares, uint32_t share);
Share effect_share_of(const EffectShares *shares, uint32_t object, uint32_t share);

#endif
