/* SPDX-License-Identifier: GPL-3.0-or-later
 * Where in the picture light is seen by way of several internal reflections. */
#ifndef AMB_PLAN_VIEW_REFLECTIONS_H
#define AMB_PLAN_VIEW_REFLECTIONS_H

#include "plan/view.h"

/* Gives the pixels of a view a part of its probes in proportion to what later internal reflections
 * on the camera's side may bring there: in a cube a few columns of pixels have nearly all of it,
 * and few probes miss them. One camera path for each of some pixels, without light fields or walks.
 * camera: only its rays count. */
AmbStatus view_weigh_reflections(const AmbScene *scene, const CameraParams *camera, Job *job,
                                 View *view);

#endif
