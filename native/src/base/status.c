/* SPDX-License-Identifier: GPL-3.0-or-later
 * The thread's record of its last failure. */
#include "base/status.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

static _Thread_local AmbErrorInfo record;
static _Thread_local char entered[sizeof record.function];

static void copy_text(char *out, size_t size, const char *text) {
    snprintf(out, size, "%s", text);
}

void status_enter(const char *function) {
    copy_text(entered, sizeof entered, function);
}

const char *status_entered(void) {
    return entered;
}

void status_record(AmbStatus code, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(record.message, sizeof record.message, format, arguments);
    va_end(arguments);
    memcpy(record.function, entered, sizeof record.function);
    record.status = code;
}

void status_copy_record(AmbErrorInfo *out_info) {
    *out_info = record;
}

void status_set_record(const AmbErrorInfo *info) {
    record = *info;
}
