/* SPDX-License-Identifier: GPL-3.0-or-later
 * Meshes that shine as lamps: light is traced from them, and looked for on them; chance would find
 * a small bright one now and then, and behind a refractive boundary never straight. */
#ifndef AMB_SCENE_MESH_LAMPS_H
#define AMB_SCENE_MESH_LAMPS_H

#include "scene/scene.h"

enum { MESH_LAMPS_MAX = 16 }; /* the last one takes all objects that are left */

/* Finds the objects that are lamps, once all are placed; docs/theory.md says which. Marks them and
 * makes their lights, MESH_LAMPS_MAX at most. Errors name the object; marks may then be left. */
AmbStatus mesh_lamps_take(AmbScene *scene, SceneLight out_lights[MESH_LAMPS_MAX],
                          uint32_t *out_count);

/* Frees what mesh_lamps_take made. */
void mesh_lamps_clear(SceneLight lights[], uint32_t count);

#endif
