/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, compiled once for each instruction set. */
#ifndef AMB_FIELD_TUBES_TUBE_GATHER_H
#define AMB_FIELD_TUBES_TUBE_GATHER_H

#include "field/field.h"
#include "field/tubes/tube_tree.h"

typedef FieldRadiance (*TubeGather)(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                                    float length, bool has_frequency);

/* Sum over all tubes whose light meets the segment o + t d, 0 < t < length (world); without
 * has_frequency that one stays 0. The portable
 * and the AVX2 variant give the same bits: no fused multiply-add, the same order of sums. AVX-512
 * fuses, and differs in the last digits. */
FieldRadiance tube_gather_portable(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                                   float length, bool has_frequency);
FieldRadiance tube_gather_avx2(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                               float length, bool has_frequency);

FieldRadiance tube_gather_avx512(const TubeTree *tree, const Medium *medium, Vec3 o, Vec3 d,
                                 float length, bool has_frequency);

/* The best variant for this processor. */
TubeGather tube_gather_select(void);

#endif
