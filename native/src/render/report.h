/* SPDX-License-Identifier: GPL-3.0-or-later
 * The account of an ended render, as JSON. */
#ifndef AMB_RENDER_REPORT_H
#define AMB_RENDER_REPORT_H

#include "render/render.h"

/* Writes the report, zero-terminated, into buffer if it fits; *out_size is the size needed. */
void report_write(const AmbRender *render, char *buffer, uint64_t size, uint64_t *out_size);

/* The same of a plan alone. */
void report_write_plan(const AmbScene *scene, const Plan *plan, char *buffer, uint64_t size,
                       uint64_t *out_size);

#endif
