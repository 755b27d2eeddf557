/* SPDX-License-Identifier: GPL-3.0-or-later
 * Parallel loops on POSIX threads. */
#include "base/parallel.h"

#include <math.h>
#include <pthread.h>
#include <time.h>
#include <unistd.h>

#include "base/memory.h"

enum { THREAD_MAX = 256 };

typedef struct Loop {
    Job *job;
    const char *function_name; /* public function of the caller, for failures on other threads */
    MemoryLimit *memory;       /* of the caller */
    uint64_t count;
    uint64_t grain;
    ParallelFunction function;
    void *user;
    atomic_uint_least64_t next;
    atomic_bool failed;
    pthread_mutex_t mutex; /* guards status and record */
    AmbStatus status;
    AmbErrorInfo record;
} Loop;

typedef struct Worker {
    Loop *loop;
    uint32_t thread;
} Worker;

static double read_clock(clockid_t id) {
    struct timespec now;
    clock_gettime(id, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

void clock_sleep(double seconds) {
    const struct timespec time = {.tv_sec = (time_t)seconds,
                                  .tv_nsec = (long)(1e9 * (seconds - floor(seconds)))};
    nanosleep(&time, NULL);
}

double clock_wall(void) {
    return read_clock(CLOCK_MONOTONIC);
}

double clock_process_cpu(void) {
    return read_clock(CLOCK_PROCESS_CPUTIME_ID);
}

double clock_thread_cpu(void) {
    return read_clock(CLOCK_THREAD_CPUTIME_ID);
}

void job_init(Job *job, uint32_t thread_count) {
    if (thread_count == 0) {
        const long processors = sysconf(_SC_NPROCESSORS_ONLN);
        thread_count = processors > 0 ? (uint32_t)processors : 1;
    }
    job->thread_count = thread_count < THREAD_MAX ? thread_count : THREAD_MAX;
    atomic_init(&job->cancelled, false);
    atomic_init(&job->cpu_ns, 0);
    atomic_init(&job->work_done, 0);
    atomic_init(&job->work_total, 0);
}

static void loop_fail(Loop *loop, AmbStatus status) {
    pthread_mutex_lock(&loop->mutex);
    if (loop->status == AMB_OK) {
        loop->status = status;
        status_copy_record(&loop->record);
    }
    pthread_mutex_unlock(&loop->mutex);
    atomic_store(&loop->failed, true);
}

static void loop_run(Loop *loop, uint32_t thread) {
    while (!atomic_load_explicit(&loop->failed, memory_order_relaxed)) {
        const uint64_t begin = atomic_fetch_add(&loop->next, loop->grain);
        if (begin >= loop->count)
            break;
        if (job_is_cancelled(loop->job)) {
            loop_fail(loop, AMB_CANCELLED);
            break;
        }
        const uint64_t rest = loop->count - begin;
        const uint64_t size = rest < loop->grain ? rest : loop->grain;
        const AmbStatus status = loop->function(loop->user, begin, begin + size, thread);
        if (status != AMB_OK) {
            loop_fail(loop, status);
            break;
        }
    }
}

static void *worker_main(void *user) {
    const Worker *worker = user;
    status_enter(worker->loop->function_name);
    memory_set_limit(worker->loop->memory);
    const double cpu = clock_thread_cpu();
    loop_run(worker->loop, worker->thread);
    atomic_fetch_add(&worker->loop->job->cpu_ns, (uint64_t)(1e9 * (clock_thread_cpu() - cpu)));
    return NULL;
}

AmbStatus parallel_for(Job *job, uint64_t count, uint64_t grain, ParallelFunction function,
                       void *user) {
    Loop loop = {.function_name = status_entered(),
                 .memory = memory_get_limit(),
                 .job = job,
                 .count = count,
                 .grain = grain > 0 ? grain : 1,
                 .function = function,
                 .user = user};
    atomic_init(&loop.next, 0);
    atomic_init(&loop.failed, false);
    pthread_mutex_init(&loop.mutex, NULL);

    const uint64_t grains = count / loop.grain + (count % loop.grain != 0);
    const uint32_t wanted = grains < job->thread_count ? (uint32_t)grains : job->thread_count;
    pthread_t threads[THREAD_MAX];
    Worker workers[THREAD_MAX];
    uint32_t started = 0;
    for (uint32_t i = 1; i < wanted; ++i) {
        workers[i] = (Worker){&loop, i};
        /* A thread that cannot be had costs time, not the picture: the others do its share. */
        if (pthread_create(&threads[started], NULL, worker_main, &workers[i]) == 0)
            ++started;
    }
    loop_run(&loop, 0);
    for (uint32_t i = 0; i < started; ++i)
        pthread_join(threads[i], NULL);
    pthread_mutex_destroy(&loop.mutex);

    if (loop.status != AMB_OK)
        status_set_record(&loop.record);
    return loop.status;
}
