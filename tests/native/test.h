/* SPDX-License-Identifier: GPL-3.0-or-later
 * The harness of the C tests: checks that count, and test functions run by name. */
#ifndef AMB_TESTS_TEST_H
#define AMB_TESTS_TEST_H

#include <math.h>
#include <stdbool.h>
#include <stdint.h>

/* Counts one check; on failure prints where, what and the message. Never stops the test. */
void test_check(bool is_true, const char *file, int line, const char *format, ...)
    __attribute__((format(printf, 4, 5)));

#define ENSURE(condition) test_check((condition), __FILE__, __LINE__, "%s", #condition)

/* |a - b| <= tolerance; false for values that are not numbers. */
#define ENSURE_NEAR(a, b, tolerance)                                                               \
    do {                                                                                           \
        const double test_a = (double)(a), test_b = (double)(b);                                   \
        test_check(fabs(test_a - test_b) <= (double)(tolerance), __FILE__, __LINE__,               \
                   "%s = %.9g, expected %.9g +- %.3g", #a, test_a, test_b, (double)(tolerance));   \
    } while (0)

/* The expression returns that status. */
#define ENSURE_STATUS(expression, expected) ENSURE_NEAR((expression), (expected), 0)

/* Uniform in [from, to) (splitmix64); *state is the seed and moves on. */
double test_uniform(uint64_t *state, double from, double to);

/* The larger error; unlike fmax, not a number is the largest of all and stays. */
static inline double test_worse(double worst, double error) {
    return isnan(worst) || worst >= error ? worst : error;
}

/* Whether AMB_TEST_LONG is set in the environment: more of the same, for minutes. */
bool test_is_long(void);

/* Runs a static void function of this file; its name is printed before its first failure. */
#define RUN(function) test_run(#function, function)
void test_run(const char *name, void (*function)(void));

#endif
