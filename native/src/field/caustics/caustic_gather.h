/* SPDX-License-Identifier: GPL-3.0-or-later
 * What photons send to a point of a surface, compiled once for each instruction set. */
#ifndef AMB_FIELD_CAUSTICS_CAUSTIC_GATHER_H
#define AMB_FIELD_CAUSTICS_CAUSTIC_GATHER_H

#include "field/caustics/caustic_tree.h"

/* Sum of irradiance at a point of a surface with unit normal n on the side that is asked for. Of
 * each photon it is 1 / (1 + peak dimmed), peak the mean of its channels; dimmed 0: all, m^2/W.
 * The tree has a photon at least. All variants give the same bits. */
typedef Rgb (*CausticGather)(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed);

Rgb caustic_gather_portable(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed);
Rgb caustic_gather_avx2(const CausticTree *tree, Vec3 p, Vec3 n, float dimmed);

/* The best variant for this processor. */
CausticGather caustic_gather_select(void);

#endif
