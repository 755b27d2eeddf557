/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the tubes, compiled once for each instruction set. */
#ifndef AMB_FIELD_TUBES_TUBE_GATHER_H
#define AMB_FIELD_TUBES_TUBE_GATHER_H

#include "field/field.h"
#include "field/tubes/tube_tree.h"

enum { TUBE_PACKET = 16 }; /* rays that are best gathered for together, where they are neighbours */

/* The segment o + t d, 0 < t < length (world); without has_frequency that one stays 0. */
typedef struct TubeRay {
    Vec3 o, d;
    float length;
    bool has_frequency;
    float reflected; /* what light of reflected tubes counts for; 0: they are not looked at */
    Rgb straight;    /* see FieldSegment */
} TubeRay;

/* For up to TUBE_PACKET rays the sum over all tubes whose light meets the segment; what a ray gets
 * does not depend on the others. The portable and the AVX2 variant give the same bits: no fused
 * multiply-add, the same order of sums. AVX-512 fuses, and differs in the last digits. */
typedef void (*TubeGather)(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                           uint32_t count, FieldRadiance out[]);

void tube_gather_portable(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                          uint32_t count, FieldRadiance out[]);
void tube_gather_avx2(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                      uint32_t count, FieldRadiance out[]);
void tube_gather_avx512(const TubeTree *tree, const Medium *medium, const TubeRay rays[],
                        uint32_t count, FieldRadiance out[]);

/* The best variant for this processor. */
TubeGather tube_gather_select(void);

#endif
