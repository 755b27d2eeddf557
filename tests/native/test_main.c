/* SPDX-License-Identifier: GPL-3.0-or-later
 * Runs the C tests, all, a module or one test of it: amb_test [MODULE [TEST]]. */
#include "test.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static unsigned long checks, failures;
static const char *running = "", *wanted; /* NULL: all of a module */

void test_check(bool is_true, const char *file, int line, const char *format, ...) {
    ++checks;
    if (is_true)
        return;
    ++failures;
    printf("%s:%d: in %s: ", file, line, running);
    va_list arguments;
    va_start(arguments, format);
    vprintf(format, arguments);
    va_end(arguments);
    putchar('\n');
}

double test_uniform(uint64_t *state, double from, double to) {
    uint64_t z = (*state += 0x9e3779b97f4a7c15u);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    z ^= z >> 31;
    return from + (to - from) * ((double)(z >> 11) * 0x1p-53);
}

bool test_is_long(void) {
    return getenv("AMB_TEST_LONG") != NULL;
}

void test_run(const char *name, void (*function)(void)) {
    running = name;
    if (wanted == NULL || strcmp(wanted, name) == 0)
        function();
}

/* X(module): test_module in test_module.c; the same list as in tests/CMakeLists.txt. */
#define MODULE_LIST(X)                                                                             \
    X(accuracy)                                                                                    \
    X(api)                                                                                         \
    X(bad_input)                                                                                   \
    X(base)                                                                                        \
    X(boundary)                                                                                    \
    X(caustics)                                                                                    \
    X(covariance)                                                                                  \
    X(faults)                                                                                      \
    X(gather)                                                                                      \
    X(hard)                                                                                        \
    X(optics)                                                                                      \
    X(scatter)                                                                                     \
    X(scene) X(smooth_wall) X(specular) X(tangent) X(texture) X(tree_cut) X(tubes) X(world)

#define DECLARE(name) void test_##name(void);
MODULE_LIST(DECLARE)

#define ENTRY(name) {#name, test_##name},
static const struct {
    const char *name;
    void (*run)(void);
} modules[] = {MODULE_LIST(ENTRY)};

int main(int argc, char **argv) {
    bool is_found = false;
    wanted = argc > 2 ? argv[2] : NULL;
    for (size_t i = 0; i < sizeof modules / sizeof modules[0]; ++i)
        if (argc < 2 || strcmp(argv[1], modules[i].name) == 0) {
            is_found = true;
            modules[i].run();
        }
    if (!is_found || checks == 0) {
        fprintf(stderr, "no such test\n");
        return 2;
    }
    printf("%lu checks, %lu failures\n", checks, failures);
    return failures > 0 ? 1 : 0;
}
