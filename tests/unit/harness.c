// SPDX-License-Identifier: MIT
// The helpers of the tests themselves: exit codes of skipped and failed programs
// (tests/data.h), values beyond their bounds (tests/physics/expect.h), and a sanitizer's report
// in a daemon's log (tests/service/daemon.h). The program runs itself with the name of a group.
#include "../physics/expect.h"
#include "../service/daemon.h"

#include <sys/wait.h>

static void missing(void **state)
{
    want_data("/nonexistent/model.glb");
}

static void present(void **state)
{
    want_data("/");
    expect_below("value", 1, 2);
    expect_above("value above", 2, 1);
    expect_near("value near", 1.5, 1, 0.5);
    expect_near("exact value", 3, 3, 0);
}

static void not_a_number(void **state)
{
    expect_below("value", 1, 2);
    expect_below("value", NAN, 2);
}

static void at_the_bound(void **state)
{
    expect_below("value", 2, 2);
}

static void too_low(void **state)
{
    expect_above("value", -1, 0);
}

static void far_away(void **state)
{
    expect_near("value", 1, 1 + 1e-9, 0);
}

static void good(void **state)
{
}

// What the end of a group returns is nothing to cmocka.
static int end_with_report(void **state)
{
    struct daemon d;
    daemon_folder(&d);
    write_text(d.log, "start\n==7==ERROR: LeakSanitizer: detected memory leaks\n");
    daemon_remove(&d);
    return 0;
}

static int run_inner(const char *name)
{
    const struct CMUnitTest fine[] = {cmocka_unit_test(good)};
    if (!strcmp(name, "reported")) return cmocka_run_group_tests(fine, NULL, end_with_report);
    const struct CMUnitTest skipped[] = {cmocka_unit_test(missing), cmocka_unit_test(missing)};
    const struct CMUnitTest mixed[] = {cmocka_unit_test(missing), cmocka_unit_test(present)};
    const struct CMUnitTest beyond[] = {cmocka_unit_test(not_a_number),
                                        cmocka_unit_test(at_the_bound),
                                        cmocka_unit_test(too_low), cmocka_unit_test(far_away)};
    if (!strcmp(name, "skipped")) return run_test_group(skipped, NULL, NULL);
    if (!strcmp(name, "skipped_physics")) return run_physics_tests(skipped, NULL, NULL);
    if (!strcmp(name, "mixed")) return run_physics_tests(mixed, NULL, NULL);
    return run_physics_tests(beyond, NULL, NULL);
}

// The exit code of this program with the name of a group, its output into `text` [4096].
static int code_of(const char *group, const char *require, char *text)
{
    char command[128];
    snprintf(command, sizeof command, "PRT_REQUIRE_DATA=%s /proc/%d/exe %s 2>&1", require,
             (int)getpid(), group);
    FILE *f = popen(command, "r");
    assert_non_null(f);
    text[fread(text, 1, 4095, f)] = 0;
    while (fgetc(f) != EOF) continue;
    int status = pclose(f);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

static void only_skipped_is_77(void **state)
{
    char text[4096];
    assert_int_equal(code_of("skipped", "0", text), 77);
    assert_non_null(strstr(text, "SKIPPED: /nonexistent/model.glb cannot be read"));
    assert_non_null(strstr(text, "2 of 2 cases skipped"));
    assert_int_equal(code_of("skipped_physics", "0", text), 77);
    assert_int_equal(code_of("mixed", "0", text), 0);
    assert_non_null(strstr(text, "1 of 2 cases skipped"));
}

static void required_data_fails(void **state)
{
    char text[4096];
    assert_int_equal(code_of("skipped", "1", text), 2);
    assert_non_null(strstr(text, "PRT_REQUIRE_DATA is 1"));
    assert_int_equal(code_of("mixed", "1", text), 1);
}

static void values_beyond_bounds_fail(void **state)
{
    char text[4096];
    assert_int_equal(code_of("beyond", "0", text), 4);
    assert_non_null(strstr(text, "value: nan, must be below 2"));
    assert_non_null(strstr(text, "value: -1, must be above 0"));
}

static void report_in_a_log_fails(void **state)
{
    char text[4096];
    assert_int_equal(code_of("reported", "0", text), 1);
    assert_non_null(strstr(text, "LeakSanitizer: detected memory leaks"));
}

int main(int argc, char **argv)
{
    if (argc > 1) return run_inner(argv[1]);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_skipped_is_77),
        cmocka_unit_test(required_data_fails),
        cmocka_unit_test(values_beyond_bounds_fail),
        cmocka_unit_test(report_in_a_log_fails),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
