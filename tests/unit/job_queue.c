// SPDX-License-Identifier: MIT
// The queue of bakes (jobs/jobs.h) with a fake runner: which jobs run, in which order, and how
// jobs end that are queued, running or drafting when they are cancelled or the daemon stops.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/server.h"
#include "jobs/jobs.h"
#include "relight.pb-c.h"

enum {
    QUEUED = RELIGHT__JOB_STATE__JOB_QUEUED,
    RUNNING = RELIGHT__JOB_STATE__JOB_RUNNING,
    DONE = RELIGHT__JOB_STATE__JOB_DONE,
    FAILED = RELIGHT__JOB_STATE__JOB_FAILED,
    CANCELLED = RELIGHT__JOB_STATE__JOB_CANCELLED,
    MOST = 700,
};

// ---- the runner

struct job_run {
    const struct job_events *events;
    void *user;
    char word[16]; // first of its argv
    bool over;
    unsigned n_cancel;
};

static struct job_run runs[MOST]; // in the order in which they were started
static unsigned n_run;
static bool refuses;

static struct job_run *start(struct server *server, const struct job_order *order,
                             const struct job_events *events, void *user, char error[256])
{
    if (refuses) snprintf(error, 256, "it cannot be started");
    if (refuses) return NULL;
    assert_true(n_run < MOST);
    struct job_run *run = &runs[n_run++];
    *run = (struct job_run){.events = events, .user = user};
    snprintf(run->word, sizeof run->word, "%s", order->argv[0]);
    return run;
}

static void cancel(struct job_run *run)
{
    assert_false(run->over);
    run->n_cancel++;
}

static const struct job_runner played = {.name = "played", .start = start, .cancel = cancel};

static void end(struct job_run *run, enum job_outcome outcome, const char *error)
{
    assert_false(run->over);
    run->over = true;
    run->events->ended(run->user, outcome, error);
}

// ---- jobs

static struct server server;
static struct jobs *jobs;
static struct {
    char id[32];
    int outcome;
} ends[MOST];
static unsigned n_end, n_drafted;

static void ended(void *user, struct job *job, enum job_outcome outcome)
{
    assert_true(n_end < MOST);
    snprintf(ends[n_end].id, sizeof ends[n_end].id, "%s", job_id(job));
    ends[n_end++].outcome = (int)outcome;
}

static void drafted(void *user, struct job *job)
{
    n_drafted++;
}

static char **argv_of(const char *word)
{
    char **argv = calloc(2, sizeof *argv);
    argv[0] = strdup(word);
    return argv;
}

static struct job *add(const char *word, const char *draft)
{
    struct job_origin origin = {.model = word, .owner = "ann", .recipe = "{}", .folder = ""};
    struct job_order order = {.argv = argv_of(word), .drafted = drafted};
    if (draft) order.draft = argv_of(draft);
    return jobs_add(jobs, &origin, &order, ended, NULL);
}

static int setup(void **state)
{
    memset(&server, 0, sizeof server);
    server.data_temporary = true;
    server.options.models = "";
    server.options.bakes = 1;
    server.options.bake_queue = 4;
    n_run = n_end = n_drafted = 0;
    refuses = false;
    return jobs_create(&server, &played, &jobs);
}

static int teardown(void **state)
{
    jobs_destroy(jobs);
    return 0;
}

static void counts_are(uint64_t done, uint64_t failed, uint64_t cancelled)
{
    assert_int_equal(server.stats.bakes_done, done);
    assert_int_equal(server.stats.bakes_failed, failed);
    assert_int_equal(server.stats.bakes_cancelled, cancelled);
}

// ---- laws

// At most --bakes run, the oldest first; the queue holds --bake-queue more.
static void as_many_run_as_may(void **state)
{
    for (unsigned bakes = 0; bakes < 4; bakes++) {
        const unsigned may = bakes ? bakes : 1;
        struct job *job[8];
        char word[8];
        setup(NULL);
        server.options.bakes = bakes;
        for (unsigned i = 0; i < may + 4; i++) {
            snprintf(word, sizeof word, "%u", i);
            assert_false(jobs_full(jobs));
            assert_non_null(job[i] = add(word, NULL));
            assert_int_equal(job_state(job[i]), i < may ? RUNNING : QUEUED);
        }
        assert_true(jobs_full(jobs));
        assert_null(add("more", NULL));
        assert_int_equal(jobs_open(jobs), may + 4);
        for (unsigned i = 0; i < may + 4; i++) {
            snprintf(word, sizeof word, "%u", i);
            assert_int_equal(jobs_running(jobs), i < 5 ? may : may + 4 - i);
            assert_string_equal(runs[i].word, word);
            assert_int_equal(job_state(job[i]), RUNNING);
            end(&runs[i], i % 2 ? JOB_OUT_FAILED : JOB_OUT_DONE, i % 2 ? "odd" : NULL);
            assert_int_equal(job_state(job[i]), i % 2 ? FAILED : DONE);
            assert_string_equal(job_error(job[i]), i % 2 ? "odd" : "");
        }
        assert_int_equal(jobs_open(jobs), 0);
        counts_are((may + 5) / 2, (may + 4) / 2, 0);
        if (bakes < 3) teardown(NULL);
    }
}

// A run that waits for another replica lets another job run, until it goes on or ends.
static void idle_runs_leave_their_place(void **state)
{
    server.options.bake_queue = 9;
    add("a", NULL), add("b", NULL), add("c", NULL), add("d", NULL);
    assert_int_equal(n_run, 1);
    runs[0].events->idle(runs[0].user, true);
    runs[0].events->idle(runs[0].user, true); // said twice, it counts once
    assert_int_equal(n_run, 2);
    runs[0].events->idle(runs[0].user, false);
    end(&runs[1], JOB_OUT_DONE, NULL);
    assert_int_equal(n_run, 2); // a runs again
    runs[0].events->idle(runs[0].user, true);
    assert_int_equal(n_run, 3);
    end(&runs[0], JOB_OUT_DONE, NULL); // while it is idle
    assert_int_equal(n_run, 3);        // c runs, d waits
    add("e", NULL);
    assert_int_equal(n_run, 3);
    end(&runs[2], JOB_OUT_DONE, NULL);
    assert_int_equal(n_run, 4);
    assert_string_equal(runs[3].word, "d");
    end(&runs[3], JOB_OUT_DONE, NULL);
    end(&runs[4], JOB_OUT_DONE, NULL);
    assert_int_equal(jobs_open(jobs), 0);
}

// A draft and its bake are one run of the queue; the bake follows however the draft ended.
static void a_bake_follows_its_draft(void **state)
{
    for (int outcome = JOB_OUT_DONE; outcome <= JOB_OUT_FAILED; outcome++) {
        struct job *job = add("bake", "draft"), *next = add("next", NULL);
        struct job_run *draft = &runs[n_run - 1];
        assert_string_equal(draft->word, "draft");
        end(draft, (enum job_outcome)outcome, "no draft");
        assert_string_equal(runs[n_run - 1].word, "bake");
        assert_int_equal(job_state(job), RUNNING);
        assert_int_equal(job_state(next), QUEUED);
        assert_int_equal(n_drafted, 1); // of the one that was made
        end(&runs[n_run - 1], JOB_OUT_DONE, NULL);
        assert_int_equal(job_state(job), DONE);
        end(&runs[n_run - 1], JOB_OUT_DONE, NULL);
    }
    // A bake that cannot be started after its draft fails, and the next one has its turn.
    struct job *job = add("bake", "draft");
    refuses = true;
    end(&runs[n_run - 1], JOB_OUT_DONE, NULL);
    assert_int_equal(job_state(job), FAILED);
    assert_string_equal(job_error(job), "it cannot be started");
    assert_int_equal(jobs_open(jobs), 0);
    job = add("bake", NULL);
    assert_int_equal(job_state(job), FAILED);
    assert_int_equal(jobs_open(jobs), 0);
    counts_are(4, 2, 0);
}

// A cancelled job ends as cancelled wherever it was, but as done where its bake was done
// already.
static void cancelled_jobs_end_as_cancelled(void **state)
{
    struct job *a = add("a", NULL), *b = add("b", NULL), *c = add("c", "draft");
    jobs_cancel(jobs, b); // in the queue
    assert_int_equal(job_state(b), CANCELLED);
    assert_int_equal(jobs_open(jobs), 2);
    jobs_cancel(jobs, b);
    jobs_cancel(jobs, a);
    jobs_cancel(jobs, a);
    assert_int_equal(runs[0].n_cancel, 1);
    assert_int_equal(job_state(a), RUNNING); // until it has ended
    end(&runs[0], JOB_OUT_FAILED, "signal 15");
    assert_int_equal(job_state(a), CANCELLED);
    assert_string_equal(job_error(a), "cancelled");
    jobs_cancel(jobs, c); // drafting: no bake follows, even where the draft was made
    end(&runs[1], JOB_OUT_DONE, NULL);
    assert_int_equal(job_state(c), CANCELLED);
    assert_int_equal(n_run, 2);
    struct job *d = add("d", NULL);
    jobs_cancel(jobs, d);
    end(&runs[2], JOB_OUT_DONE, NULL);
    assert_int_equal(job_state(d), DONE);
    jobs_cancel(jobs, d);
    assert_int_equal(jobs_open(jobs), 0);
    counts_are(1, 0, 3);
    assert_int_equal(n_end, 4);
}

// When the daemon stops, open jobs are suspended and none starts. A job whose bake has finished
// ends as done, and one that was cancelled as cancelled.
static void the_end_suspends(void **state)
{
    server.options.bakes = 4;
    for (int i = 0; i < 4; i++) assert_non_null(add("run", i == 1 ? "draft" : NULL));
    struct job *waits = add("waits", NULL), *cancelled = add("cancelled", NULL);
    jobs_cancel(jobs, cancelled);
    assert_ptr_equal(jobs_find(jobs, job_id(waits)), waits);
    jobs_cancel(jobs, jobs_find(jobs, "run")); // its newest job
    assert_int_equal(runs[3].n_cancel, 1);
    server.data_temporary = false; // only now: records of jobs are not written here
    jobs_stop(jobs);
    for (int i = 0; i < 4; i++) assert_int_equal(runs[i].n_cancel, 1);
    assert_int_equal(jobs_open(jobs), 4);
    assert_null(add("late", NULL));
    server.data_temporary = true;
    const unsigned before = n_run;
    end(&runs[0], JOB_OUT_FAILED, "signal 15");
    end(&runs[1], JOB_OUT_DONE, NULL); // a draft
    end(&runs[2], JOB_OUT_DONE, NULL); // a bake, in time
    end(&runs[3], JOB_OUT_FAILED, "signal 15");
    assert_int_equal(n_run, before);
    assert_int_equal(jobs_open(jobs), 0);
    assert_int_equal(job_state(waits), QUEUED);
    counts_are(1, 0, 2);
    static const int outcomes[] = {JOB_OUT_CANCELLED, JOB_OUT_SUSPENDED, JOB_OUT_SUSPENDED,
                                   JOB_OUT_SUSPENDED, JOB_OUT_DONE,      JOB_OUT_CANCELLED};
    assert_int_equal(n_end, 6);
    for (int i = 0; i < 6; i++) assert_int_equal(ends[i].outcome, outcomes[i]);
}

// With a temporary folder nothing can go on later: all jobs are cancelled.
static void a_temporary_folder_keeps_no_job(void **state)
{
    struct job *a = add("a", NULL), *b = add("b", NULL);
    jobs_stop(jobs);
    assert_int_equal(job_state(b), CANCELLED);
    end(&runs[0], JOB_OUT_FAILED, "signal 15");
    assert_int_equal(job_state(a), CANCELLED);
    assert_int_equal(n_run, 1);
    assert_int_equal(jobs_open(jobs), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(as_many_run_as_may, NULL, teardown),
        cmocka_unit_test_setup_teardown(idle_runs_leave_their_place, setup, teardown),
        cmocka_unit_test_setup_teardown(a_bake_follows_its_draft, setup, teardown),
        cmocka_unit_test_setup_teardown(cancelled_jobs_end_as_cancelled, setup, teardown),
        cmocka_unit_test_setup_teardown(the_end_suspends, setup, teardown),
        cmocka_unit_test_setup_teardown(a_temporary_folder_keeps_no_job, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
