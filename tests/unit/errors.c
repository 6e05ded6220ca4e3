// SPDX-License-Identifier: MIT
// The ERROR message: ranges that texts of the library and of the daemon state become fields.
// The same as an answer over HTTP.
#include "net/errors.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cjson/cJSON.h>
#include <cmocka.h>

#include "net/connection.h"
#include "net/http_problem.h"
#include "prt/bake_limits.h"
#include "prt/base.h"
#include "prt/medium.h"

enum { RANGE = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE };

static void expect(const char *text, const char *parameter, double low, double high,
                   const char *unit)
{
    Relight__Error e;
    struct error_fields fields;
    error_fill(&e, RANGE, text, &fields);
    assert_string_equal(e.text, text);
    assert_string_equal(e.parameter, parameter);
    assert_true(e.has_range);
    if (e.minimum != low || e.maximum != high)
        fail_msg("\"%s\": %g to %g", text, e.minimum, e.maximum);
    assert_string_equal(e.unit, unit);
}

static void range_messages_are_parsed(void **state)
{
    expect("material: sigma_a[0] is -1, allowed range 0 to 1000 mm^-1", "sigma_a[0]", 0, 1000,
           "mm^-1");
    expect("marble: eta is 9, allowed range 1 to 3 (relative refractive index, no unit)", "eta",
           1, 3, "");
    expect("layer 2: thickness is 9, allowed range 0 (excluded) to 1e3 (excluded) mm: thinner",
           "thickness", 0, 1000, "mm");
    expect("lights[3].cube_n is 17, allowed range 16 to 128: 16, 32, 64 or 128",
           "lights[3].cube_n", 16, 128, "");
    expect("skin: sigma_s_prime[1] is 400, this bake covers 0.1 to 50 mm^-1: its basis would "
           "lose 40 % of the medium (the limit is 10 %)",
           "sigma_s_prime[1]", 0.1, 50, "mm^-1");
    expect("multipole: 99 layers, allowed range 1 to 16", "", 1, 16, "");
    expect("--samples is 7, allowed range 16 to 10000000", "--samples", 16, 1e7, "");
}

static void not_a_range(void **state)
{
    static const char *const texts[] = {
        "the payload has 3 bytes",       ", allowed range ",
        "x is 1, allowed range a to b",  "x is 1, allowed range 1 to",
        "x is 1, allowed range 1 and 2", " is "};
    for (size_t i = 0; i < sizeof texts / sizeof *texts; i++) {
        Relight__Error e;
        struct error_fields fields;
        error_fill(&e, RANGE, texts[i], &fields);
        assert_false(e.has_range);
    }
    // A file's name cannot make a range out of another fault.
    Relight__Error e;
    struct error_fields fields;
    error_fill(&e, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "x is 1, allowed range 1 to 2",
               &fields);
    assert_false(e.has_range);
}

static void daemon_and_library(void **state)
{
    char error[300], reason[128];
    Relight__Error e;
    struct error_fields fields;
    int code = range_refuse(error, sizeof error, 1e7, -1e6, 1e6, "degrees",
                            "lights[%d].rotate_deg", 2);
    assert_int_equal(code, RANGE);
    expect(error, "lights[2].rotate_deg", -1e6, 1e6, "degrees");
    assert_false(prt_bake_setting_ok(PRT_BAKE_CUBE, 17, reason));
    expect(reason, "cube", 16, 128, "");
    assert_false(prt_bake_error_ok(77, reason));
    error_fill(&e, RANGE, reason, &fields);
    assert_true(e.has_range && e.maximum == PRT_BAKE_ERROR_MAX);
}

static char last[400];

static void keep(void *user, enum prt_log_level level, const char *text)
{
    strncpy(last, text, sizeof last - 1);
}

static void materials(void **state)
{
    static const struct {
        const char *json, *parameter;
    } cases[] = {
        {"{\"sigma_s_prime\":[1,-2,3],\"sigma_a\":[0,0,0]}", "sigma_s_prime[1]"},
        {"{\"sigma_s_prime\":[1,2,3],\"sigma_a\":[0,0,1e9]}", "sigma_a[2]"},
        {"{\"sigma_s_prime\":[1,2,3],\"sigma_a\":[0,0,0],\"g\":2}", "g[0]"},
        {"{\"sigma_s_prime\":[1,2,3],\"sigma_a\":[0,0,0],\"eta\":9}", "eta"},
    };
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep;
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct prt_material m;
        Relight__Error e;
        struct error_fields fields;
        assert_int_equal(
            prt_material_parse(&ctx, "material", cases[i].json, strlen(cases[i].json), &m),
            PRT_ARG);
        error_fill(&e, error_of_status(PRT_ARG), last, &fields);
        assert_string_equal(e.parameter, cases[i].parameter);
        assert_true(e.has_range && e.minimum < e.maximum);
    }
}

static void never_without_code_or_text(void **state)
{
    Relight__Error e;
    struct error_fields fields;
    error_fill(&e, 0, "", &fields);
    assert_int_equal(e.code, RELIGHT__ERROR_CODE__ERROR_INTERNAL);
    assert_true(strlen(e.text) > 0);
    error_fill(&e, RELIGHT__ERROR_CODE__ERROR_BUSY, NULL, &fields);
    assert_string_equal(e.text, "ERROR_BUSY");
    error_fill(&e, 4711, "", &fields);
    assert_true(strlen(e.text) > 0);
}

// Each status of the library has a code of its own; one that the daemon does not know is its
// own fault.
static void statuses_of_the_library(void **state)
{
    static const struct {
        int status, code;
    } cases[] = {{PRT_ARG, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE},
                 {PRT_NOMEM, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY},
                 {PRT_IO, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND},
                 {PRT_FORMAT, RELIGHT__ERROR_CODE__ERROR_FORMAT},
                 {PRT_LIMIT, RELIGHT__ERROR_CODE__ERROR_LIMIT},
                 {PRT_CANCELLED, RELIGHT__ERROR_CODE__ERROR_CANCELLED},
                 {PRT_UNSUPPORTED, RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED},
                 {PRT_MISMATCH, RELIGHT__ERROR_CODE__ERROR_MISMATCH},
                 {-4711, RELIGHT__ERROR_CODE__ERROR_INTERNAL}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        assert_int_equal(error_of_status(cases[i].status), cases[i].code);
}

// A limit that a text states is a range like any other.
static void limits_have_a_range(void **state)
{
    Relight__Error e;
    struct error_fields fields;
    error_fill(&e, RELIGHT__ERROR_CODE__ERROR_LIMIT, "width is 9000, allowed range 1 to 4096",
               &fields);
    assert_true(e.has_range && e.minimum == 1 && e.maximum == 4096);
    assert_string_equal(e.parameter, "width");
}

struct answer {
    int code, status;
    bool own_limit;
    const char *title;
};

static void check_answer(const struct answer *a)
{
    struct connection conn = {.own_limit = a->own_limit};
    struct http_problem problem;
    struct error_fields fields;
    Relight__Error e;
    error_fill(&e, a->code, "no", &fields);
    problem_of_error(&conn, &e, &problem);
    if (problem.status != a->status) fail_msg("code %d: status %d", a->code, problem.status);
    assert_int_equal(problem.retry_after_ms != 0, a->status == 503);
    assert_string_equal(problem.detail, "no");
    assert_string_equal(problem.hint, error_hint(a->code));
    char *text = problem_json(&problem, "r-1");
    cJSON *json = cJSON_Parse(text);
    assert_non_null(json);
    assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json, "title")), a->title);
    assert_int_equal(cJSON_GetNumberValue(cJSON_GetObjectItem(json, "status")), a->status);
    assert_string_equal(cJSON_GetStringValue(cJSON_GetObjectItem(json, "request_id")), "r-1");
    assert_int_equal(cJSON_HasObjectItem(json, "retry_after_ms"), a->status == 503);
    assert_false(cJSON_HasObjectItem(json, "minimum") || cJSON_HasObjectItem(json, "unit"));
    cJSON_Delete(json);
    free(text);
}

// Contract of problem_of_error: 4xx where the client has to change something, 5xx where it has
// not. A busy daemon is not the fault of a client that is within its own limits.
static void codes_as_http_statuses(void **state)
{
#define CODE(name) RELIGHT__ERROR_CODE__ERROR_##name
    static const struct answer answers[] = {
        {CODE(BAD_REQUEST), 400, false, "Bad Request"},
        {CODE(OUT_OF_RANGE), 400, false, "Bad Request"},
        {CODE(FORBIDDEN), 403, false, "Forbidden"},
        {CODE(NOT_FOUND), 404, false, "Not Found"},
        {CODE(BUSY), 429, true, "Too Many Requests"},
        {CODE(BUSY), 503, false, "Service Unavailable"},
        {CODE(DEADLINE), 504, false, "Gateway Timeout"},
        {CODE(LIMIT), 413, false, "Content Too Large"},
        {CODE(FORMAT), 422, false, "Unprocessable Content"},
        {CODE(MISMATCH), 422, false, "Unprocessable Content"},
        {CODE(HASH), 422, false, "Unprocessable Content"},
        {CODE(UNSUPPORTED), 422, false, "Unprocessable Content"},
        {CODE(NOT_READY), 409, false, "Conflict"},
        {CODE(JOB_FAILED), 409, false, "Conflict"},
        {CODE(NO_MEMORY), 503, false, "Service Unavailable"},
        {CODE(MOVED), 503, false, "Service Unavailable"},
        {CODE(SHUTTING_DOWN), 503, false, "Service Unavailable"},
        {CODE(CANCELLED), 503, false, "Service Unavailable"},
        {CODE(INTERNAL), 500, false, "Internal Server Error"},
        {4711, 400, false, "Bad Request"}};
#undef CODE
    for (size_t i = 0; i < sizeof answers / sizeof *answers; i++) check_answer(&answers[i]);
}

// Statuses that no ERROR has, of the HTTP API alone, have their titles, too.
static void titles_of_other_statuses(void **state)
{
    static const struct {
        int status;
        const char *title;
    } cases[] = {{401, "Unauthorized"},
                 {405, "Method Not Allowed"},
                 {415, "Unsupported Media Type"},
                 {501, "Not Implemented"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct http_problem problem;
        http_refuse(&problem, cases[i].status, "bad_request", "no");
        char *text = problem_json(&problem, "");
        assert_non_null(strstr(text, cases[i].title));
        free(text);
    }
}

static void ranges_over_http(void **state)
{
    struct connection conn = {0};
    struct http_problem problem;
    struct error_fields fields;
    Relight__Error e;
    error_fill(&e, RANGE, "eta is 9, allowed range 1 to 3 mm", &fields);
    problem_of_error(&conn, &e, &problem);
    char *text = problem_json(&problem, "");
    assert_non_null(strstr(text, "\"parameter\":\"eta\",\"minimum\":1,\"maximum\":3,"
                                 "\"unit\":\"mm\""));
    free(text);
    e.retry_after_ms = 250;
    problem_of_error(&conn, &e, &problem);
    assert_int_equal(problem.retry_after_ms, 250);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(range_messages_are_parsed),  cmocka_unit_test(not_a_range),
        cmocka_unit_test(daemon_and_library),         cmocka_unit_test(materials),
        cmocka_unit_test(never_without_code_or_text), cmocka_unit_test(statuses_of_the_library),
        cmocka_unit_test(limits_have_a_range),        cmocka_unit_test(codes_as_http_statuses),
        cmocka_unit_test(titles_of_other_statuses),   cmocka_unit_test(ranges_over_http),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
