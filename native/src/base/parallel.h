/* SPDX-License-Identifier: GPL-3.0-or-later
 * Parallel loops that can be cancelled, and the account of what they cost. */
#ifndef AMB_BASE_PARALLEL_H
#define AMB_BASE_PARALLEL_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stdint.h>

#include "base/status.h"

/* What one render shares with all its loops. */
typedef struct Job {
    uint32_t thread_count; /* >= 1 */
    atomic_bool cancelled;
    atomic_uint_least64_t cpu_ns;     /* CPU time of helper threads of finished loops; the
                                       * calling thread's own time is not in it */
    atomic_uint_least64_t work_done;  /* items finished in the stage that reports progress */
    atomic_uint_least64_t work_total; /* items of that stage; 0: unknown */
} Job;

void job_init(Job *job, uint32_t thread_count); /* 0 = one for each processor */

static inline bool job_is_cancelled(const Job *job) {
    return atomic_load_explicit(&job->cancelled, memory_order_relaxed);
}

/* Processes items begin .. end-1. Work and its results must depend on the indices alone, never on
 * the thread (0 .. thread_count-1), which only selects scratch memory. Long items ask
 * job_is_cancelled and return AMB_CANCELLED. */
typedef AmbStatus (*ParallelFunction)(void *user, uint64_t begin, uint64_t end, uint32_t thread);

/* Calls function for [0, count) in grains. Returns the first failure (its record is set for the
 * calling thread), AMB_CANCELLED, or AMB_OK. The calling thread takes part. */
AmbStatus parallel_for(Job *job, uint64_t count, uint64_t grain, ParallelFunction function,
                       void *user);

void clock_sleep(double seconds);
double clock_wall(void);        /* seconds, monotonic */
double clock_thread_cpu(void);  /* seconds of the calling thread */
double clock_process_cpu(void); /* seconds of all threads of the process */

#endif
