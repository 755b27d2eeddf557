/* SPDX-License-Identifier: GPL-3.0-or-later
 * Picks the variant of the inner loop that this processor can run. */
#include "field/points/point_gather.h"

PointGather point_gather_select(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2"))
        return point_gather_avx2;
#endif
    return point_gather_portable;
}
