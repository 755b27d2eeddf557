/* SPDX-License-Identifier: GPL-3.0-or-later
 * Picks the variant of the inner loop that this processor can run. */
#include "field/tubes/tube_gather.h"

TubeGather tube_gather_select(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq"))
        return tube_gather_avx512;
    if (__builtin_cpu_supports("avx2"))
        return tube_gather_avx2;
#endif
    return tube_gather_portable;
}
