/* SPDX-License-Identifier: GPL-3.0-or-later
 * Checks of arguments that the public functions share. */
#ifndef AMB_API_API_CHECK_H
#define AMB_API_API_CHECK_H

#include <stddef.h>

#include "base/status.h"

/* Copies a caller's struct over defaults, as far as its struct_size covers it. */
AmbStatus check_struct(const void *given, size_t size, const char *name, void *in_out_defaults);

AmbStatus check_pointer(const void *pointer, const char *name);

/* Every value finite and in [low, high]; name says which field of which object. */
AmbStatus check_range(const float *values, int count, float low, float high, const char *field,
                      const char *object);

#endif
