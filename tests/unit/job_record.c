// SPDX-License-Identifier: MIT
// Records of jobs: what is printed is parsed, and a folder that leads elsewhere is none.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "jobs/job_record.h"
#include "relight.pb-c.h"

static void printed_and_parsed(void **state)
{
    const struct job_record r = {.id = "job-1",
                                 .model = "0123",
                                 .owner = "uid:7",
                                 .folder = "0123.00000001",
                                 .order = UINT64_MAX - 1,
                                 .state = RELIGHT__JOB_STATE__JOB_FAILED,
                                 .stage = "walks",
                                 .fraction = 0.25,
                                 .elapsed_s = 3.5,
                                 .error = "no memory",
                                 .warnings = "one\ntwo\n",
                                 .recipe = "{}"};
    char *text = job_record_print(&r);
    struct job_record got;
    assert_non_null(text);
    assert_true(job_record_parse(text, &got));
    assert_string_equal(got.id, r.id);
    assert_string_equal(got.model, r.model);
    assert_string_equal(got.owner, r.owner);
    assert_string_equal(got.folder, r.folder);
    assert_true(got.order == r.order && got.state == r.state);
    assert_true(got.fraction == r.fraction && got.elapsed_s == r.elapsed_s);
    assert_string_equal(got.stage, r.stage);
    assert_string_equal(got.error, r.error);
    assert_string_equal(got.warnings, r.warnings);
    assert_string_equal(got.recipe, "{}");
    free(got.recipe);
    free(text);
}

// The daemon removes DATA/work/FOLDER with all that it holds.
static void folders_that_lead_elsewhere(void **state)
{
    static const char *const folder[] = {"", ".", "..", "/", "../bakes", "a/..", ".a"};
    for (size_t i = 0; i < sizeof folder / sizeof *folder; i++) {
        struct job_record r = {.id = "job-1", .recipe = "{}"}, got;
        snprintf(r.folder, sizeof r.folder, "%s", folder[i]);
        char *text = job_record_print(&r);
        if (job_record_parse(text, &got)) fail_msg("folder \"%s\" is taken", folder[i]);
        free(text);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(printed_and_parsed),
                                       cmocka_unit_test(folders_that_lead_elsewhere)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
