/* SPDX-License-Identifier: GPL-3.0-or-later
 * How functions fail: a status code, and one record a thread that says which call and why. */
#ifndef AMB_BASE_STATUS_H
#define AMB_BASE_STATUS_H

#include "amberlight/amberlight.h"

/* Returns the expression's status from the calling function unless it is AMB_OK. The only macro
 * in the library that hides control flow. */
#define AMB_TRY(expr)                                                                              \
    do {                                                                                           \
        const AmbStatus amb_try_status = (expr);                                                   \
        if (amb_try_status != AMB_OK)                                                              \
            return amb_try_status;                                                                 \
    } while (0)

/* Names the public function that the calling thread is in; later failures carry it. */
void status_enter(const char *function);
const char *status_entered(void); /* valid on this thread until the next status_enter */

/* Records a failure for the calling thread; its value is the code. The message is cut at 255
 * bytes; nothing is allocated. A macro, so that compilers and analysers see which code returns. */
#define status_fail(code, ...) (status_record((code), __VA_ARGS__), (code))
void status_record(AmbStatus code, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Hands a record from one thread to another: a worker's failure belongs to whoever waits. */
void status_copy_record(AmbErrorInfo *out_info);
void status_set_record(const AmbErrorInfo *info);

#endif
