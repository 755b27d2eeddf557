/* SPDX-License-Identifier: GPL-3.0-or-later
 * Picks the variant of the inner loop that this processor can run. */
#include "field/caustics/caustic_gather.h"

CausticGather caustic_gather_select(void) {
#if defined(__x86_64__)
    if (__builtin_cpu_supports("avx2"))
        return caustic_gather_avx2;
#endif
    return caustic_gather_portable;
}
