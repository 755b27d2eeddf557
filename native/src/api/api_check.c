/* SPDX-License-Identifier: GPL-3.0-or-later
 * Checks of arguments. */
#include "api/api_check.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

AmbStatus check_struct(const void *given, size_t size, const char *name, void *in_out_defaults) {
    AMB_TRY(check_pointer(given, name));
    uint32_t given_size = 0;
    memcpy(&given_size, given, sizeof given_size);
    if (given_size < sizeof given_size || given_size > size)
        return status_fail(AMB_INVALID_ARGUMENT, "%s.struct_size is %u, this library knows %zu",
                           name, given_size, size);
    memcpy(in_out_defaults, given, given_size);
    return AMB_OK;
}

AmbStatus check_pointer(const void *pointer, const char *name) {
    return pointer != NULL ? AMB_OK : status_fail(AMB_INVALID_ARGUMENT, "%s is NULL", name);
}

AmbStatus check_range(const float *values, int count, float low, float high, const char *field,
                      const char *object) {
    for (int i = 0; i < count; ++i)
        if (!isfinite(values[i]) || values[i] < low || values[i] > high)
            return status_fail(AMB_INVALID_ARGUMENT, "%s is %g in \"%.100s\", must be in [%g, %g]",
                               field, (double)values[i], object, (double)low, (double)high);
    return AMB_OK;
}
