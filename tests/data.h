/* SPDX-License-Identifier: MIT */
/* data.h owns how a test says that it skips. Development data lies in PRT_SHARED_DATA and may
 * be absent: a case that wants it calls want_data() first. A program whose every case skipped
 * exits with 77, which ctest counts as skipped; with PRT_REQUIRE_DATA=1 in the environment a
 * missing file is a failure. */
#ifndef TESTS_DATA_H
#define TESTS_DATA_H

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static unsigned data_n_skipped;

/* Ends the running case as skipped and prints why. tests/run repeats lines that begin with
 * SKIPPED after ctest's summary. */
__attribute__((unused)) static void skip_because(const char *reason)
{
    print_message("SKIPPED: %s\n", reason);
    data_n_skipped++;
    skip();
}

/* Skips the running case when `path` cannot be read; fails it under PRT_REQUIRE_DATA=1. */
__attribute__((unused)) static void want_data(const char *path)
{
    const char *required = getenv("PRT_REQUIRE_DATA");
    char reason[600];
    if (!access(path, R_OK)) return;
    if (required && !strcmp(required, "1"))
        fail_msg("%s cannot be read and PRT_REQUIRE_DATA is 1: put the development data there "
                 "or unset PRT_REQUIRE_DATA",
                 path);
    snprintf(reason, sizeof reason, "%s cannot be read", path);
    skip_because(reason);
}

/* The exit code of a program of n cases of which `failed` failed. */
static inline int data_exit_code(int failed, size_t n)
{
    if (!failed && data_n_skipped)
        print_message("%u of %zu cases skipped\n", data_n_skipped, n);
    return !failed && data_n_skipped == n ? 77 : failed;
}

/* cmocka_run_group_tests(), but the result is 77 where every case skipped. */
#define run_test_group(tests, setup, teardown)                     \
    data_exit_code(cmocka_run_group_tests(tests, setup, teardown), \
                   sizeof(tests) / sizeof((tests)[0]))

#endif
