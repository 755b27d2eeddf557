/* SPDX-License-Identifier: GPL-3.0-or-later
 * What the scene alone says, before any ray: effects that cannot be. */
#ifndef AMB_PLAN_SCENE_RULES_H
#define AMB_PLAN_SCENE_RULES_H

#include "scene/boundary.h"

bool scene_has_boundary(const AmbScene *scene);   /* a translucent object */
bool scene_has_refraction(const AmbScene *scene); /* with an ior other than 1 */
bool scene_has_scattering(const AmbScene *scene); /* with a medium that scatters */
bool scene_has_opaque_surface(const AmbScene *scene);
float scene_albedo_max(const AmbScene *scene); /* of all media and channels */
bool scene_has_lamp(const AmbScene *scene);
/* One that the world's image does not show. */
bool scene_has_wide_lamp(const AmbScene *scene);
bool scene_object_scatters(const AmbScene *scene, uint32_t object);

/* Whether their bounding spheres meet: one of them may be inside the other. */
bool scene_may_touch(const SceneObject *a, const SceneObject *b);

/* Whether the bounding sphere of a translucent object reaches where camera rays begin: within the
 * near plane's part of the view, or for an orthographic camera the window pushed to it. */
bool scene_may_start_inside(const AmbScene *scene);

#endif
