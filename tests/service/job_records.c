// SPDX-License-Identifier: MIT
// The records of bakes that have ended: a limited number is kept, and a restart tells of them
// as before.
#include "room_frames.h"

#include "lone_daemon.h"

#include <dirent.h>
#include <math.h>

enum { LONG = 2000000, KEPT = 256 }; // samples of a bake of minutes; ended bakes that are kept

static unsigned n_records(void)
{
    char path[128];
    unsigned n = 0;
    snprintf(path, sizeof path, "%s/jobs", d.data);
    DIR *dir = opendir(path);
    assert_non_null(dir);
    for (struct dirent *e; (e = readdir(dir));) n += e->d_name[0] != '.';
    closedir(dir);
    return n;
}

// What WATCH answers about a job that has ended.
static struct reply last_of(struct frames *f, const char *job)
{
    Relight__WatchRequest m = RELIGHT__WATCH_REQUEST__INIT;
    m.job = (char *)job;
    frames_add(f, RELIGHT_TYPE_WATCH, 3, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 3);
    for (; !r.code && !r.last; r = reply_to(f, 3)) reply_free(&r);
    return r;
}

static void ended_bakes_are_bounded(void **unused)
{
    enum { N = KEPT + 20, OPEN = 1 };
    char first[64] = "", last[64];
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "small.obj", 1, LONG, &loaded, &error));
    relight_loaded_finish(&loaded);
    for (unsigned i = 0; i < N; i++) {
        OK(load_small(client, &d, "small.obj", 2 + i, LONG, &loaded, &error));
        OK(relight_cancel_job(client, loaded.job, NULL, &error));
        if (!i) snprintf(first, sizeof first, "%s", loaded.job);
        snprintf(last, sizeof last, "%s", loaded.job);
        relight_loaded_finish(&loaded);
    }
    relight_close(client);
    // Old ones go when a new one comes: the last came after that.
    for (int i = 0; i < 1000 && n_records() > KEPT + OPEN + 1; i++) sleep_ms(20);
    assert_int_equal(n_records(), KEPT + OPEN + 1);
    for (int start = 0; start < 2; start++) {
        struct frames *f = frames_open(&d);
        struct reply r = last_of(f, first);
        assert_int_equal(r.code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
        reply_free(&r);
        r = last_of(f, last);
        assert_int_equal(r.code, 0);
        assert_int_equal(((Relight__Progress *)r.message)->state,
                         RELIGHT__JOB_STATE__JOB_CANCELLED);
        reply_free(&r);
        frames_close(f);
        if (start) break;
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, NULL);
    }
    end();
}

static void an_ended_bake_is_told_as_before(void **unused)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    char job[64];
    OK(load_small(client, &d, "small.obj", 1, 300, &loaded, &error));
    snprintf(job, sizeof job, "%s", loaded.job);
    OK(relight_watch(client, job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
    struct frames *f = frames_open(&d);
    struct reply before = last_of(f, job);
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    struct reply after = last_of(f, job);
    const Relight__Progress *a = (Relight__Progress *)before.message,
                            *b = (Relight__Progress *)after.message;
    assert_int_equal(a->state, RELIGHT__JOB_STATE__JOB_DONE);
    assert_int_equal(b->state, a->state);
    assert_string_equal(b->job, job);
    assert_string_equal(b->model, a->model);
    assert_string_equal(b->stage, a->stage);
    assert_true(b->fraction == 1 && a->fraction == 1);
    assert_true(b->eta_s == a->eta_s);
    assert_true(a->elapsed_s > 0 && fabs(b->elapsed_s - a->elapsed_s) < 1e-3);
    reply_free(&before);
    reply_free(&after);
    frames_close(f);
    end();
}

// The order in a job's record, whose first digit becomes `digit` unless that is 0.
static uint64_t order_in_record(const char *job, char digit)
{
    char path[160], text[20000];
    snprintf(path, sizeof path, "%s/jobs/%s.json", d.data, job);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    size_t n = fread(text, 1, sizeof text - 1, file);
    fclose(file);
    text[n] = 0;
    char *at = strstr(text, "\"order\":");
    assert_non_null(at);
    at += strcspn(at, "0123456789");
    if (digit) *at = digit;
    if (digit) write_text(path, text);
    return strtoull(at, NULL, 10);
}

static void cancelled_bake(uint64_t seed, char job[64])
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "small.obj", seed, LONG, &loaded, &error));
    snprintf(job, 64, "%s", loaded.job);
    OK(relight_cancel_job(client, job, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
}

// A job comes after all that are recorded, though the clock was set back since.
static void a_clock_that_was_set_back(void **unused)
{
    char first[64], second[64], third[64];
    begin(NULL);
    cancelled_bake(1, first);
    assert_int_equal(daemon_stop(&d), 0);
    const uint64_t later = order_in_record(first, '9');
    daemon_start(&d, NULL);
    cancelled_bake(2, second);
    cancelled_bake(3, third);
    assert_int_equal(daemon_stop(&d), 0);
    assert_true(order_in_record(second, 0) > later);
    assert_true(order_in_record(third, 0) > order_in_record(second, 0));
    daemon_start(&d, NULL);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(ended_bakes_are_bounded, teardown),
        cmocka_unit_test_teardown(an_ended_bake_is_told_as_before, teardown),
        cmocka_unit_test_teardown(a_clock_that_was_set_back, teardown),
    };
    return cmocka_run_group_tests_name("job records", tests, NULL, NULL);
}
