/* SPDX-License-Identifier: GPL-3.0-or-later
 * Runs a fuzz target without libFuzzer: amb_fuzz TARGET RUNS SEED [FILE ...]. Files first, of which
 * those called picture_* must give a picture and those called refused_* none; then RUNS strings of
 * random bytes, or files with some bytes changed. Every run is a function of SEED
 * and its number, which is printed when it fails; =NUMBER in place of RUNS writes its bytes to
 * stdout. TARGET "all" is every target but scenes. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "base/parallel.h"
#include "base/rng.h"
#include "fuzz.h"

enum { SIZE_MAX_RANDOM = 512, FILE_MAX = 4096, FILE_SIZE_MAX = 4096, REPORTED_RUNS = 10000 };

/* CPU seconds that are worth a line: small scenes should take milliseconds. */
static const double SLOW = 1.0;

typedef struct Seed {
    const char *path;
    uint8_t data[FILE_SIZE_MAX];
    size_t size;
} Seed;

static const struct {
    const char *name;
    FuzzTarget *run;
} TARGETS[] = {{"scene", fuzz_scene},           {"small", fuzz_small},
               {"dielectric", fuzz_dielectric}, {"tangent", fuzz_tangent},
               {"covariance", fuzz_covariance}, {"kernel", fuzz_kernel},
               {"phase", fuzz_phase},           {"boundary", fuzz_boundary}};
enum { TARGET_COUNT = sizeof TARGETS / sizeof TARGETS[0] };

static bool is_story(FuzzTarget *run) {
    return run == fuzz_scene || run == fuzz_small;
}

static const char *running = "";
static unsigned long long run_seed, run_number;

void fuzz_fail(const char *file, int line, const char *format, ...) {
    fprintf(stderr, "%s:%d: %s, seed %llu, run %llu: ", file, line, running, run_seed, run_number);
    va_list arguments;
    va_start(arguments, format);
    vfprintf(stderr, format, arguments);
    va_end(arguments);
    fputc('\n', stderr);
    abort();
}

static bool read_seed(const char *path, Seed *out) {
    FILE *file = fopen(path, "rb");
    if (file == NULL)
        return false;
    out->path = path;
    out->size = fread(out->data, 1, sizeof out->data, file);
    fclose(file);
    return true;
}

/* A scene from a file comes to what its name says: a seed that ends before it reaches what it is
 * there for would test nothing. */
static void run_seed_scene(FuzzTarget *run, const Seed *seed) {
    const char *slash = strrchr(seed->path, '/'), *name = slash != NULL ? slash + 1 : seed->path;
    const unsigned long long before = fuzz_scene_pictures();
    run(seed->data, seed->size);
    const bool is_picture = fuzz_scene_pictures() > before;
    FUZZ_HOLDS(is_picture || strncmp(name, "picture_", 8) != 0, "%s gives no picture", seed->path);
    FUZZ_HOLDS(!is_picture || strncmp(name, "refused_", 8) != 0, "%s is not refused", seed->path);
}

/* Random bytes, or those of a seed with up to eight changed; every other run. */
static size_t make_input(const Seed *seeds, size_t seed_count, uint64_t key, uint8_t *out) {
    uint64_t state = rng_mix(key);
    if (seed_count == 0 || state % 2 == 0) {
        const size_t size = 1 + (size_t)(rng_mix(state + 1) % SIZE_MAX_RANDOM);
        for (size_t i = 0; i < size; ++i)
            out[i] = (uint8_t)rng_mix(state + 2 + i);
        return size;
    }
    const Seed *seed = &seeds[rng_mix(state + 1) % seed_count];
    memcpy(out, seed->data, seed->size);
    for (uint64_t i = 0; i < rng_mix(state + 2) % 8 && seed->size > 0; ++i)
        out[rng_mix(state + 3 + 2 * i) % seed->size] = (uint8_t)rng_mix(state + 4 + 2 * i);
    return seed->size;
}

static void run_target(size_t target, unsigned long long runs, bool only, const Seed *seeds,
                       size_t seed_count) {
    running = TARGETS[target].name;
    for (size_t i = 0; i < seed_count && !only; ++i)
        if (is_story(TARGETS[target].run))
            run_seed_scene(TARGETS[target].run, &seeds[i]);
        else
            TARGETS[target].run(seeds[i].data, seeds[i].size);
    static uint8_t input[FILE_SIZE_MAX];
    for (run_number = only ? runs : 0; run_number < runs + only; ++run_number) {
        const size_t size = make_input(seeds, seed_count,
                                       rng_mix(run_seed) + run_number * 0x9e3779b97f4a7c15u, input);
        if (only) {
            fwrite(input, 1, size, stdout);
            return;
        }
        const double process = clock_process_cpu();
        TARGETS[target].run(input, size);
        if ((run_number + 1) % REPORTED_RUNS == 0)
            printf("%s: %llu runs\n", running, run_number + 1);
        if (clock_process_cpu() - process > SLOW)
            printf("%s: seed %llu, run %llu takes %.1f CPU s\n", running, run_seed, run_number,
                   clock_process_cpu() - process);
    }
    printf("%s: %llu runs and %zu files, seed %llu\n", running, runs, seed_count, run_seed);
    if (is_story(TARGETS[target].run))
        fuzz_scene_report();
}

int main(int argc, char **argv) {
    if (argc < 4) {
        fprintf(stderr, "usage: amb_fuzz TARGET RUNS SEED [FILE ...]\n");
        return 2;
    }
    const bool only = argv[2][0] == '=';
    const unsigned long long runs = strtoull(argv[2] + only, NULL, 10);
    run_seed = strtoull(argv[3], NULL, 10);
    static Seed seeds[FILE_MAX];
    size_t seed_count = 0;
    for (int i = 4; i < argc && seed_count < FILE_MAX; ++i)
        seed_count += read_seed(argv[i], &seeds[seed_count]);
    setvbuf(stdout, NULL, _IOLBF, 0);
    bool is_found = false;
    for (size_t i = 0; i < TARGET_COUNT; ++i)
        if (strcmp(argv[1], TARGETS[i].name) == 0 ||
            (strcmp(argv[1], "all") == 0 && !is_story(TARGETS[i].run))) {
            is_found = true;
            run_target(i, runs, only, seeds, seed_count);
        }
    return is_found ? 0 : 2;
}
