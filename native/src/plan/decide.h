/* SPDX-License-Identifier: GPL-3.0-or-later
 * From shares to decisions. */
#ifndef AMB_PLAN_DECIDE_H
#define AMB_PLAN_DECIDE_H

#include "plan/effect_shares.h"
#include "plan/plan.h"

/* Least share of an effect that is simulated, of the accuracy asked for: half of it. accuracy 0
 * counts as 1 %. */
double decide_share_min(double accuracy);

/* Whether more probes would change nothing that matters: of every effect that the plan still has,
 * it is clear that its share is less than twice the least, or that it is more than half of it. */
bool decide_is_settled(const EffectShares *shares, const Plan *plan);

/* Writes the shares into the plan. */
void decide_describe(const EffectShares *shares, Plan *plan);

/* Switches off, of the effects that plan says are simulated, those that are not worth it, finds
 * how many reflections are, and which objects light is not traced to. Of the choices that leave out
 * nothing that shows, and together at most this part of what they may, the one that costs least:
 * effects of a camera sample, and samples, of which what is left out takes more. */
void decide(const AmbScene *scene, const EffectShares *shares, double accuracy, double part,
            Plan *plan);

#endif
