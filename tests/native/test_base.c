/* SPDX-License-Identifier: GPL-3.0-or-later
 * Status records, memory, random numbers, order, parallel loops. */
#include <pthread.h>
#include <string.h>

#include "base/memory.h"
#include "base/order.h"
#include "base/parallel.h"
#include "base/rng.h"
#include "base/status.h"
#include "test.h"

/* ---- Status ---------------------------------------------------------------------------------- */

static AmbStatus first_or_second(AmbStatus first, AmbStatus second) {
    AMB_TRY(first);
    return second;
}

static void status_record_has_function_and_message(void) {
    status_enter("amb_some_function");
    ENSURE_STATUS(status_fail(AMB_IO, "file \"%s\" has %d rows", "a.exr", 7), AMB_IO);
    AmbErrorInfo info;
    status_copy_record(&info);
    ENSURE(info.status == AMB_IO);
    ENSURE(strcmp(info.function, "amb_some_function") == 0);
    ENSURE(strcmp(info.message, "file \"a.exr\" has 7 rows") == 0);
    /* Success leaves the record of the last failure. */
    status_enter("amb_other_function");
    AmbErrorInfo later;
    status_copy_record(&later);
    ENSURE(strcmp(later.function, "amb_some_function") == 0);

    ENSURE_STATUS(first_or_second(AMB_OK, AMB_OK), AMB_OK);
    ENSURE_STATUS(first_or_second(AMB_IO, AMB_OK), AMB_IO);
    ENSURE_STATUS(first_or_second(AMB_OK, AMB_INTERNAL), AMB_INTERNAL);
}

static void status_record_cuts_long_texts(void) {
    char text[1000];
    memset(text, 'x', sizeof text);
    text[sizeof text - 1] = '\0';
    status_enter(text);
    (void)status_fail(AMB_IO, "%s", text);
    AmbErrorInfo info;
    status_copy_record(&info);
    ENSURE(strlen(info.function) == sizeof info.function - 1);
    ENSURE(strlen(info.message) == sizeof info.message - 1);
    /* A name from the caller is text, not a format. */
    (void)status_fail(AMB_IO, "%s", "%s%n%d");
    status_copy_record(&info);
    ENSURE(strcmp(info.message, "%s%n%d") == 0);
}

static void *fail_elsewhere(void *user) {
    AmbErrorInfo *out = user;
    status_copy_record(&out[0]);
    status_enter("amb_elsewhere");
    (void)status_fail(AMB_INTERNAL, "elsewhere");
    status_copy_record(&out[1]);
    return NULL;
}

static void status_record_belongs_to_its_thread(void) {
    status_enter("amb_here");
    (void)status_fail(AMB_IO, "here");
    AmbErrorInfo there[2], here;
    pthread_t thread;
    ENSURE(pthread_create(&thread, NULL, fail_elsewhere, there) == 0);
    pthread_join(thread, NULL);
    status_copy_record(&here);
    ENSURE(there[0].status == AMB_OK && there[0].message[0] == '\0');
    ENSURE(strcmp(there[1].message, "elsewhere") == 0);
    ENSURE(here.status == AMB_IO && strcmp(here.message, "here") == 0);
    status_set_record(&there[1]);
    status_copy_record(&here);
    ENSURE(strcmp(here.function, "amb_elsewhere") == 0);
}

/* ---- Memory ---------------------------------------------------------------------------------- */

static void memory_is_aligned_zeroed_and_copied(void) {
    for (uint64_t count = 0; count < 200; count += 13) {
        unsigned char *zeroed = memory_zero_array(count, 5);
        ENSURE(zeroed != NULL && (uintptr_t)zeroed % 64 == 0);
        bool is_zero = zeroed != NULL;
        for (uint64_t i = 0; is_zero && i < 5 * count; ++i)
            is_zero = zeroed[i] == 0;
        ENSURE(is_zero);
        memory_free(zeroed);
    }
    static const uint16_t numbers[3] = {1, 2, 3};
    uint16_t *copy = memory_copy_array(numbers, 3, sizeof numbers[0]);
    ENSURE(copy != NULL && memcmp(copy, numbers, sizeof numbers) == 0);
    memory_free(copy);
    void *nothing = memory_copy_array(NULL, 0, 8);
    ENSURE(nothing != NULL);
    memory_free(nothing);
    char *text = memory_copy_text("resin"), *empty = memory_copy_text(NULL);
    ENSURE(text != NULL && strcmp(text, "resin") == 0);
    ENSURE(empty != NULL && empty[0] == '\0');
    memory_free(text);
    memory_free(empty);
    memory_free(NULL);
}

static void memory_refuses_sizes_that_overflow(void) {
    static const uint64_t sizes[][2] = {{UINT64_MAX, 1},           {1, UINT64_MAX},
                                        {UINT64_MAX, UINT64_MAX},  {UINT64_MAX / 2 + 1, 2},
                                        {UINT64_MAX / 12 + 1, 12}, {1ull << 32, 1ull << 32}};
    for (size_t i = 0; i < sizeof sizes / sizeof sizes[0]; ++i) {
        ENSURE(memory_alloc_array(sizes[i][0], sizes[i][1]) == NULL);
        ENSURE(memory_zero_array(sizes[i][0], sizes[i][1]) == NULL);
        ENSURE(memory_copy_array(sizes, sizes[i][0], sizes[i][1]) == NULL);
    }
}

static void memory_fails_on_demand(void) {
    memory_fail_after(2);
    for (int i = 0; i < 5; ++i) {
        void *pointer = memory_alloc_array(1, 1);
        ENSURE((pointer == NULL) == (i == 2));
        memory_free(pointer);
    }
    memory_fail_from(1);
    for (int i = 0; i < 5; ++i) {
        void *pointer = memory_alloc_array(1, 1);
        ENSURE((pointer == NULL) == (i >= 1));
        memory_free(pointer);
    }
    memory_fail_after(0);
    memory_fail_after(-1);
    void *pointer = memory_alloc_array(1, 1);
    ENSURE(pointer != NULL);
    memory_free(pointer);
}

/* ---- Random numbers -------------------------------------------------------------------------- */

enum { BINS = 64, DRAWS = 64000 };

/* Which index of the generator runs while the others stand. */
typedef enum Running { SEED, STAGE, PATH, DIMENSION, RUNNING_COUNT } Running;

static float draw(Running running, uint32_t i) {
    const Rng rng = rng_create(running == SEED ? i : 3, running == STAGE ? i : RNG_STAGE_CAMERA,
                               running == PATH ? i : 12345);
    return rng_float(rng, running == DIMENSION ? i : 2);
}

/* sum (count - expected)^2 / expected has mean bins - 1 and variance 2 (bins - 1). */
static double chi_square(const uint32_t *counts, int bins) {
    const double expected = (double)DRAWS / bins;
    double sum = 0.0;
    for (int i = 0; i < bins; ++i)
        sum += (counts[i] - expected) * (counts[i] - expected) / expected;
    return sum;
}

static void rng_is_uniform_along_every_index(void) {
    for (Running running = 0; running < RUNNING_COUNT; ++running) {
        uint32_t single[BINS] = {0}, pairs[BINS] = {0};
        bool is_inside = true;
        float last = draw(running, 0);
        for (uint32_t i = 1; i <= DRAWS; ++i) {
            const float next = draw(running, i);
            is_inside = is_inside && next >= 0.0f && next < 1.0f;
            ++single[(int)(next * BINS)];
            /* Neighbours, as the two coordinates of a point. */
            ++pairs[8 * (int)(last * 8) + (int)(next * 8)];
            last = next;
        }
        ENSURE(is_inside);
        /* Five standard deviations either way: a lattice would be too even. */
        ENSURE_NEAR(chi_square(single, BINS), BINS - 1, 5.0 * sqrt(2.0 * (BINS - 1)));
        ENSURE_NEAR(chi_square(pairs, BINS), BINS - 1, 5.0 * sqrt(2.0 * (BINS - 1)));
    }
}

static void rng_depends_on_its_indices_alone(void) {
    float forward[100];
    for (uint32_t i = 0; i < 100; ++i)
        forward[i] = rng_float(rng_create(1, RNG_STAGE_LIGHT, i / 10), i % 10);
    bool is_same = true;
    for (uint32_t i = 100; i-- > 0;)
        is_same =
            is_same && forward[i] == rng_float(rng_create(1, RNG_STAGE_LIGHT, i / 10), i % 10);
    ENSURE(is_same);
    const float base = rng_float(rng_create(1, RNG_STAGE_LIGHT, 5), 0);
    ENSURE(base != rng_float(rng_create(2, RNG_STAGE_LIGHT, 5), 0));
    ENSURE(base != rng_float(rng_create(1, RNG_STAGE_CAMERA, 5), 0));
    ENSURE(base != rng_float(rng_create(1, RNG_STAGE_LIGHT, 6), 0));
    ENSURE(base != rng_float(rng_create(1, RNG_STAGE_LIGHT, 5 + (1ull << 32)), 0));
    ENSURE(base != rng_float(rng_create(1, RNG_STAGE_LIGHT, 5), 1));
}

/* ---- Order ----------------------------------------------------------------------------------- */

typedef struct Ranked {
    float key;
    uint32_t id;
} Ranked;

static bool ranked_before(const void *first, const void *second, const void *user) {
    const Ranked *a = first, *b = second;
    return *(const float *)user * a->key < *(const float *)user * b->key;
}

/* Lists of all lengths, sorted, turned around, alike and by chance; keys that are no numbers must
 * not hang it, and nothing gets lost. */
static void order_selects_any_rank(void) {
    enum { LENGTH_MAX = 67, KINDS = 5 };
    uint64_t state = 3;
    int wrong = 0;
    for (uint32_t count = 1; count <= LENGTH_MAX; ++count)
        for (int kind = 0; kind < KINDS; ++kind)
            for (uint32_t rank = 0; rank < count; ++rank) {
                Ranked list[LENGTH_MAX];
                for (uint32_t i = 0; i < count; ++i) {
                    const float keys[KINDS] = {(float)i, -(float)i, 1.0f,
                                               (float)(int)test_uniform(&state, 0, 9),
                                               i % 3 == 1 ? NAN : (float)(i % 7)};
                    list[i] = (Ranked){keys[kind], i};
                }
                const float sign = rank % 2 == 0 ? 1.0f : -1.0f;
                order_select(list, sizeof list[0], count, rank, ranked_before, &sign);
                uint32_t ids = 0;
                for (uint32_t i = 0; i < count; ++i) {
                    ids += list[i].id;
                    const Ranked *low = &list[i < rank ? i : rank];
                    const Ranked *high = &list[i < rank ? rank : i];
                    wrong += kind < 4 && ranked_before(high, low, &sign) ? 1 : 0;
                }
                wrong += ids != count * (count - 1) / 2;
            }
    ENSURE(wrong == 0);
}

/* ---- Parallel loops -------------------------------------------------------------------------- */

enum { ITEM_MAX = 2000 };

typedef struct Visits {
    atomic_uint counts[ITEM_MAX];
    atomic_uint wrong_ranges;
    uint64_t count, grain;
    uint32_t thread_count;
} Visits;

static AmbStatus visit(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    Visits *visits = user;
    if (begin >= end || end > visits->count || end - begin > visits->grain ||
        thread >= visits->thread_count)
        atomic_fetch_add(&visits->wrong_ranges, 1);
    for (uint64_t i = begin; i < end; ++i)
        atomic_fetch_add(&visits->counts[i], 1);
    return AMB_OK;
}

static void parallel_for_visits_every_index_once(void) {
    static const uint64_t counts[] = {0, 1, 2, 7, 100, 1999, ITEM_MAX};
    static const uint64_t grains[] = {0, 1, 3, 64, 5000};
    static Visits visits;
    for (uint32_t threads = 1; threads <= 7; ++threads)
        for (size_t c = 0; c < sizeof counts / sizeof counts[0]; ++c)
            for (size_t g = 0; g < sizeof grains / sizeof grains[0]; ++g) {
                memset(&visits, 0, sizeof visits);
                visits.count = counts[c];
                visits.grain = grains[g] > 0 ? grains[g] : 1;
                visits.thread_count = threads;
                Job job;
                job_init(&job, threads);
                ENSURE_STATUS(parallel_for(&job, counts[c], grains[g], visit, &visits), AMB_OK);
                bool is_once = true;
                for (uint64_t i = 0; i < ITEM_MAX; ++i)
                    is_once = is_once && visits.counts[i] == (i < counts[c] ? 1u : 0u);
                ENSURE(is_once && visits.wrong_ranges == 0);
            }
}

typedef struct Failing {
    Job *job;
    uint64_t from; /* items from here on fail */
    bool only_helpers;
    atomic_uint begun, failed;
} Failing;

static AmbStatus fail_from(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)end;
    Failing *failing = user;
    atomic_fetch_add(&failing->begun, 1);
    if (failing->only_helpers && thread == 0) {
        /* Waits until a helper has failed, so that the error is certain to come from there. */
        const double start = clock_wall();
        while (atomic_load(&failing->failed) == 0 && clock_wall() < start + 30.0) {
        }
        return AMB_OK;
    }
    if (begin < failing->from)
        return AMB_OK;
    atomic_fetch_add(&failing->failed, 1);
    return status_fail(AMB_IO, "item %u", (unsigned)begin);
}

static void parallel_for_hands_the_first_error_to_its_caller(void) {
    /* Helpers take over the name of the function that their caller is in. */
    status_enter("amb_loop");
    for (uint32_t threads = 1; threads <= 7; ++threads) {
        Job job;
        job_init(&job, threads);
        Failing failing = {.job = &job, .from = 50};
        (void)status_fail(AMB_INTERNAL, "an old error");
        ENSURE_STATUS(parallel_for(&job, ITEM_MAX, 1, fail_from, &failing), AMB_IO);
        AmbErrorInfo info;
        status_copy_record(&info);
        ENSURE(info.status == AMB_IO && strncmp(info.message, "item ", 5) == 0);
        ENSURE(strcmp(info.function, "amb_loop") == 0);
        if (threads == 1)
            ENSURE(strcmp(info.message, "item 50") == 0);
        /* Each thread stops at its first failure, and begins nothing after another's. */
        ENSURE(failing.failed >= 1 && failing.failed <= threads);
        ENSURE(failing.begun <= 50 + threads);
    }
    Job job;
    job_init(&job, 2);
    Failing helper = {.job = &job, .only_helpers = true};
    (void)status_fail(AMB_INTERNAL, "an old error");
    ENSURE_STATUS(parallel_for(&job, ITEM_MAX, 1, fail_from, &helper), AMB_IO);
    AmbErrorInfo info;
    status_copy_record(&info);
    ENSURE(strncmp(info.message, "item ", 5) == 0);
    ENSURE(strcmp(info.function, "amb_loop") == 0);
}

static AmbStatus cancel_at(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)end;
    (void)thread;
    Failing *failing = user;
    atomic_fetch_add(&failing->begun, 1);
    if (begin == failing->from)
        atomic_store(&failing->job->cancelled, true);
    return AMB_OK;
}

static void parallel_for_stops_when_cancelled(void) {
    for (uint32_t threads = 1; threads <= 7; ++threads) {
        Job job;
        job_init(&job, threads);
        Failing cancelling = {.job = &job, .from = 20};
        ENSURE_STATUS(parallel_for(&job, ITEM_MAX, 1, cancel_at, &cancelling), AMB_CANCELLED);
        ENSURE(cancelling.begun >= 21 && cancelling.begun < ITEM_MAX);
        cancelling.begun = 0;
        ENSURE_STATUS(parallel_for(&job, ITEM_MAX, 1, cancel_at, &cancelling), AMB_CANCELLED);
        ENSURE(cancelling.begun == 0);
    }
    /* Cancelled within the last item: the work is done all the same, and whoever cares asks the
     * job. */
    Job job;
    job_init(&job, 1);
    Failing last = {.job = &job, .from = 9};
    ENSURE_STATUS(parallel_for(&job, 10, 1, cancel_at, &last), AMB_OK);
    ENSURE(job_is_cancelled(&job));
}

static AmbStatus burn(void *user, uint64_t begin, uint64_t end, uint32_t thread) {
    (void)begin;
    (void)end;
    (void)thread;
    atomic_uint *sum = user;
    const double start = clock_thread_cpu();
    while (clock_thread_cpu() < start + 0.005)
        atomic_fetch_add(sum, 1);
    return AMB_OK;
}

static void job_counts_threads_and_their_time(void) {
    Job job;
    job_init(&job, 0);
    ENSURE(job.thread_count >= 1);
    job_init(&job, 100000);
    ENSURE(job.thread_count == 256);
    job_init(&job, 4);
    atomic_uint sum = 0;
    const double start = clock_thread_cpu();
    ENSURE_STATUS(parallel_for(&job, 8, 1, burn, &sum), AMB_OK);
    const double own = clock_thread_cpu() - start;
    /* Eight items of 5 ms, whoever did them. */
    ENSURE(own + 1e-9 * (double)atomic_load(&job.cpu_ns) > 0.0395);
    const double before = clock_wall();
    ENSURE(clock_wall() >= before);
}

void test_base(void);

void test_base(void) {
    RUN(status_record_has_function_and_message);
    RUN(status_record_cuts_long_texts);
    RUN(status_record_belongs_to_its_thread);
    RUN(memory_is_aligned_zeroed_and_copied);
    RUN(memory_refuses_sizes_that_overflow);
    RUN(memory_fails_on_demand);
    RUN(rng_is_uniform_along_every_index);
    RUN(rng_depends_on_its_indices_alone);
    RUN(order_selects_any_rank);
    RUN(parallel_for_visits_every_index_once);
    RUN(parallel_for_hands_the_first_error_to_its_caller);
    RUN(parallel_for_stops_when_cancelled);
    RUN(job_counts_threads_and_their_time);
}
