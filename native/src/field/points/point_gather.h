/* SPDX-License-Identifier: GPL-3.0-or-later
 * The inner loop of the point estimators, compiled once for each instruction set. */
#ifndef AMB_FIELD_POINTS_POINT_GATHER_H
#define AMB_FIELD_POINTS_POINT_GATHER_H

#include "field/field.h"
#include "field/points/point_tree.h"

typedef FieldRadiance (*PointGather)(const PointTree *tree, const Medium *medium,
                                     const FieldSegment *segment, PointCount *met);

/* Sum over all samples whose cylinder the segment passes through, and added to met, unless that is
 * NULL, how many these are. All variants give the same bits: no fused
 * multiply-add, the same order of sums. */
FieldRadiance point_gather_portable(const PointTree *tree, const Medium *medium,
                                    const FieldSegment *segment, PointCount *met);
FieldRadiance point_gather_avx2(const PointTree *tree, const Medium *medium,
                                const FieldSegment *segment, PointCount *met);

/* The best variant for this processor. */
PointGather point_gather_select(void);

#endif
