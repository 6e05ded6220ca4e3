// SPDX-License-Identifier: MIT
// What a client may hold and say: frames in orders that no client library sends, requests,
// views, bytes and answers beyond their limits, and text that is no text.
#include "frames.h"

static struct daemon d;

static void begin(const char *const extra[])
{
    setenv("MALLOC_PERTURB_", "165", 1); // what was freed does not look as before
    daemon_folder(&d);
    daemon_start(&d, extra);
}

static void end(void)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    assert_int_equal(status, 0);
}

// A test that failed leaves no daemon behind.
static int teardown(void **state)
{
    if (d.pid) daemon_remove(&d);
    return 0;
}

static void served(void)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
}

// ---- the order of what is said of views

// Takes a worker some 0.1 s to work out; another text each time.
static char *slow_material(void)
{
    static char text[4][300];
    static int n;
    char *out = text[++n % 4];
    snprintf(
        out, sizeof *text,
        "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":2,\"sigma_s_prime\":[%d,1.5,"
        "2],\"sigma_a\":[0.02,0.05,0.1]},{\"sigma_s_prime\":[2,2,3],\"sigma_a\":[0.1,0.2,"
        "0.3]}]}",
        n);
    return out;
}

static void add_view_open(struct frames *f, uint64_t id, const char *model, char *material)
{
    Relight__ViewOpenRequest open = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    Relight__ViewState state = RELIGHT__VIEW_STATE__INIT;
    Relight__Shade shade = RELIGHT__SHADE__INIT;
    open.model = (char *)model;
    open.colors = true;
    open.state = &state;
    if (material) {
        shade.material = material;
        state.shade = &shade;
    }
    frames_add(f, RELIGHT_TYPE_VIEW_OPEN, id, &open.base, NULL, 0);
}

static void add_view_set(struct frames *f, uint64_t id, uint64_t view, uint64_t sequence)
{
    Relight__ViewSetRequest set = RELIGHT__VIEW_SET_REQUEST__INIT;
    Relight__ViewState state = RELIGHT__VIEW_STATE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    light.env = "constant:1,2,3";
    state.n_lights = 1;
    state.lights = lights;
    set.view = view;
    set.sequence = sequence;
    set.state = &state;
    frames_add(f, RELIGHT_TYPE_VIEW_SET, id, &set.base, NULL, 0);
}

static void add_view_close(struct frames *f, uint64_t id, uint64_t view)
{
    Relight__ViewCloseRequest request = RELIGHT__VIEW_CLOSE_REQUEST__INIT;
    request.view = view;
    frames_add(f, RELIGHT_TYPE_VIEW_CLOSE, id, &request.base, NULL, 0);
}

// A state, or a close, for a VIEW_OPEN that comes after it and still waits for its turn: there
// is no such view yet.
static void test_view_that_is_not_open_yet(void **state)
{
    begin(NULL);
    for (int i = 0; i < 8; i++) {
        struct frames *f = frames_open(&d);
        add_view_open(f, 10, "nothing", slow_material());
        if (i % 2) add_view_close(f, 11, 12);
        else add_view_set(f, 11, 12, 1);
        add_view_open(f, 12, "nothing", slow_material());
        frames_send(f);
        struct frames_answer a;
        for (uint64_t id = 10; id < 13; id++) {
            assert_true(frames_next(f, &a, 20000, NULL));
            assert_false(a.closed);
            assert_int_equal(a.id, id);
            assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
            if (id == 11) assert_non_null(strstr(a.text, "no view was opened by request 12"));
        }
        frames_close(f);
        served();
    }
    end();
}

// A state for a VIEW_OPEN before it, whose material is still being worked out, waits its turn.
static void test_view_that_waits_for_its_material(void **state)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_loaded loaded;
    struct relight_error error;
    struct relight_load load = {.size_mm = 10, .material = "marble", .preview = true};
    OK(load_octahedron(client, &d, "small.obj", &load, &loaded, &error));
    struct frames *f = frames_open(&d);
    add_view_open(f, 10, loaded.model, slow_material());
    add_view_set(f, 11, 10, 1);
    add_view_set(f, 12, 10, 2);
    add_view_close(f, 13, 10);
    frames_send(f);
    uint64_t next = 11;
    while (next < 14) {
        struct frames_answer a;
        assert_true(frames_next(f, &a, 20000, NULL));
        assert_false(a.closed);
        if (a.id == 10) continue; // its frames, and its end
        assert_int_equal(a.id, next++);
        assert_int_equal(a.code, 0);
    }
    frames_close(f);
    relight_loaded_finish(&loaded);
    relight_close(client);
    served();
    end();
}

// ---- jobs

// A job stays valid while its own cancellation is answered, however many ended after it.
static void test_cancel_the_oldest_job(void **state)
{
    char prt[128], job[2][32];
    daemon_folder(&d);
    snprintf(prt, sizeof prt, "%s/slow", d.folder);
    write_text(prt, "#!/bin/sh\nexec sleep 60 >/dev/null 2>&1\n");
    chmod(prt, 0700);
    const char *const extra[] = {"--prt", prt, "--client-jobs", "0", NULL};
    setenv("MALLOC_PERTURB_", "165", 1);
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    enum relight_job_state at = 0;
    for (unsigned i = 0; i < 2 + 257; i++) {
        struct relight_loaded loaded;
        OK(load_small(client, &d, "small.obj", i + 1, 200, &loaded, &error));
        assert_true(loaded.job[0]);
        if (i < 2) snprintf(job[i], sizeof job[i], "%s", loaded.job);
        else {
            OK(relight_cancel_job(client, loaded.job, &at, &error));
            assert_int_equal(at, RELIGHT_JOB_CANCELLED);
        }
        relight_loaded_finish(&loaded);
    }
    OK(relight_cancel_job(client, job[1], &at, &error));
    assert_int_equal(at, RELIGHT_JOB_CANCELLED);
    OK(relight_cancel_job(client, job[0], &at, &error));
    relight_close(client);
    served();
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_view_that_is_not_open_yet, teardown),
        cmocka_unit_test_teardown(test_view_that_waits_for_its_material, teardown),
        cmocka_unit_test_teardown(test_cancel_the_oldest_job, teardown),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("limits", tests, NULL, NULL);
}
