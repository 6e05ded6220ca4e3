// SPDX-License-Identifier: MIT
// SUBSCRIBE: events of models, bakes and environments, cursors over reconnects and restarts,
// readers that stay behind.
#include "frames.h"
#include "lone_daemon.h"

struct cursor {
    char run[32];
    uint64_t sequence;
};

static void add_subscribe(struct frames *f, uint64_t id, const struct cursor *from,
                          Relight__EventKind *kinds, size_t n_kind)
{
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    if (from) {
        in.run = (char *)from->run;
        in.after = from->sequence;
    }
    in.kinds = kinds;
    in.n_kinds = n_kind;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, id, &in.base, NULL, 0);
}

// The next event of this request; the cursor follows. NULL when none came in time.
static Relight__Event *next_event(struct frames *f, uint64_t id, struct cursor *cursor, int ms)
{
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    for (;;) {
        if (!frames_next(f, &a, ms, &m)) return NULL;
        assert_false(a.closed);
        if (a.id == id && a.type == (RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER)) break;
        if (a.id == id) fail_msg("SUBSCRIBE was answered with %d %s", a.code, a.text);
        protobuf_c_message_free_unpacked(m, NULL);
    }
    Relight__Event *e = (Relight__Event *)m;
    if (cursor) {
        assert_true(strcmp(cursor->run, e->run) || e->sequence >= cursor->sequence);
        snprintf(cursor->run, sizeof cursor->run, "%s", e->run);
        cursor->sequence = e->sequence;
    }
    return e;
}

static void drop(Relight__Event *e)
{
    protobuf_c_message_free_unpacked(&e->base, NULL);
}

// Reads until an event of this kind came; fails when it is lost or late.
static Relight__Event *event_of(struct frames *f, uint64_t id, int kind, struct cursor *cursor)
{
    for (;;) {
        Relight__Event *e = next_event(f, id, cursor, 20000);
        if (!e) fail_msg("no event of kind %d", kind);
        assert_false(e->lost);
        if ((int)e->kind == kind) return e;
        drop(e);
    }
}

// Opens a connection with a subscription, and returns whether events were lost before it.
static struct frames *subscribe(const struct cursor *from, struct cursor *cursor, bool *lost)
{
    struct frames *f = frames_open(&d);
    add_subscribe(f, 2, from, NULL, 0);
    frames_send(f);
    Relight__Event *first = next_event(f, 2, cursor, 20000);
    assert_non_null(first);
    assert_int_equal(first->kind, RELIGHT__EVENT_KIND__EVENT_NONE);
    if (lost) *lost = first->lost;
    drop(first);
    return f;
}

static void models_jobs_and_environments(void **state)
{
    begin(NULL);
    struct cursor cursor = {"", 0};
    struct frames *f = subscribe(NULL, &cursor, NULL);
    assert_int_equal(strlen(cursor.run), 16);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char id[ID_SIZE], hash[65];
    bake_small(client, &d, id);

    Relight__Event *e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED, &cursor);
    assert_string_equal(e->model, id);
    assert_string_equal(e->name, "small.obj");
    drop(e);
    for (bool done = false; !done;) {
        e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_JOB, &cursor);
        assert_non_null(e->progress);
        assert_string_equal(e->progress->model, id);
        assert_int_equal(strncmp(e->progress->job, "job-", 4), 0);
        done = e->progress->state == RELIGHT__JOB_STATE__JOB_DONE;
        if (done) assert_float_equal(e->progress->fraction, 1, 0);
        drop(e);
    }
    static const char hdr[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nAAAABBBB";
    OK(relight_upload(client, "sky.hdr", hdr, sizeof hdr - 1, NULL, NULL, hash, NULL, &error));
    e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_ENVIRONMENT_ADDED, &cursor);
    assert_string_equal(e->env + 4, hash);
    assert_string_equal(e->name, "sky.hdr");
    drop(e);
    // An upload is its owner's affair: one who comes over TCP is another principal.
    struct relight_client *other;
    char address[80];
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    other = client_open(address);
    static const char second[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nCCCCBBBB";
    OK(relight_upload(other, "secret.hdr", second, sizeof second - 1, NULL, NULL, hash, NULL,
                      &error));
    OK(relight_unload(client, id, true, NULL, &error));
    for (bool gone = false; !gone;) {
        e = next_event(f, 2, &cursor, 20000);
        assert_non_null(e);
        assert_true(strcmp(e->name, "secret.hdr") != 0);
        gone = e->kind == RELIGHT__EVENT_KIND__EVENT_MODEL_REMOVED;
        if (gone) assert_string_equal(e->model, id);
        drop(e);
    }
    relight_close(other);
    relight_close(client);
    frames_close(f);
    end();
}

static void a_filter_of_kinds(void **state)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    Relight__EventKind kinds[40] = {RELIGHT__EVENT_KIND__EVENT_MODEL_REMOVED,
                                    (Relight__EventKind)4711};
    add_subscribe(f, 3, NULL, kinds, 40);
    frames_send(f);
    assert_int_equal(frames_wait(f, 3).code, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    add_subscribe(f, 4, NULL, kinds, 2);
    frames_send(f);
    drop(next_event(f, 4, NULL, 20000));
    struct relight_error error;
    char id[ID_SIZE];
    bake_small(client, &d, id);
    OK(relight_unload(client, id, true, NULL, &error));
    Relight__Event *e = next_event(f, 4, NULL, 20000);
    assert_non_null(e);
    assert_int_equal(e->kind, RELIGHT__EVENT_KIND__EVENT_MODEL_REMOVED);
    drop(e);
    assert_null(next_event(f, 4, NULL, 200));
    // It is cancelled as any request is.
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    cancel.id = 4;
    frames_add(f, RELIGHT_TYPE_CANCEL, 5, &cancel.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 4).code, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
    relight_close(client);
    frames_close(f);
    end();
}

// Its id. `x` makes it another shape.
static void load_preview(struct relight_client *client, const char *x, char id[ID_SIZE])
{
    struct relight_error error;
    struct relight_loaded loaded;
    char text[sizeof octahedron + 16], name[32], hash[65];
    snprintf(text, sizeof text, "v %s 0 0%s", x, strchr(octahedron, '\n'));
    snprintf(name, sizeof name, "shape-%s.obj", x);
    OK(relight_upload(client, name, text, strlen(text), NULL, NULL, hash, NULL, &error));
    struct relight_file file = {name, hash};
    struct relight_load load = {.n_file = 1, .files = &file, .size_mm = 10, .preview = true};
    OK(relight_load(client, &load, &loaded, &error));
    snprintf(id, ID_SIZE, "%s", loaded.model);
    relight_loaded_finish(&loaded);
}

// Of a model only the newest state is kept, and that of each model is.
static void the_newest_state_of_each_model(void **state)
{
    begin(NULL);
    struct cursor cursor = {"", 0};
    bool lost = true;
    char id[2][ID_SIZE];
    unsigned n[2] = {0};
    frames_close(subscribe(NULL, &cursor, NULL));
    struct relight_client *client = client_open(d.address);
    load_preview(client, "1.5", id[0]);
    load_preview(client, "2.5", id[1]);
    struct frames *f = subscribe(&cursor, &cursor, &lost);
    assert_false(lost);
    for (Relight__Event *e; (e = next_event(f, 2, &cursor, 500)); drop(e))
        for (int i = 0; i < 2; i++)
            n[i] +=
                e->kind == RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED && !strcmp(e->model, id[i]);
    assert_int_equal(n[0], 1);
    assert_int_equal(n[1], 1);
    relight_close(client);
    frames_close(f);
    end();
}

// A subscription to one model gets the events of this one alone.
static void a_filter_of_a_model(void **state)
{
    begin(NULL);
    char id[2][ID_SIZE], long_id[34];
    struct relight_error error;
    struct relight_client *client = client_open(d.address);
    load_preview(client, "1.5", id[0]);
    load_preview(client, "2.5", id[1]);
    struct frames *f = frames_open(&d);
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    memset(long_id, 'a', 33);
    long_id[33] = 0;
    in.model = long_id;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 3, &in.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 3).code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    in.model = id[1];
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 4, &in.base, NULL, 0);
    frames_send(f);
    drop(next_event(f, 4, NULL, 20000));
    OK(relight_unload(client, id[0], true, NULL, &error));
    OK(relight_unload(client, id[1], true, NULL, &error));
    for (bool gone = false; !gone;) {
        Relight__Event *e = next_event(f, 4, NULL, 20000);
        assert_non_null(e);
        assert_string_equal(e->model, id[1]);
        gone = e->kind == RELIGHT__EVENT_KIND__EVENT_MODEL_REMOVED;
        drop(e);
    }
    relight_close(client);
    frames_close(f);
    end();
}

// Names a model again and again: each time is an event.
static void rename_often(struct relight_client *client, int n)
{
    struct relight_error error;
    char hash[65], name[32];
    OK(relight_upload(client, "often.obj", octahedron, sizeof octahedron - 1, NULL, NULL, hash,
                      NULL, &error));
    struct relight_file file = {"often.obj", hash};
    for (int i = 0; i < n; i++) {
        struct relight_loaded loaded;
        snprintf(name, sizeof name, "name %d", i);
        struct relight_load load = {
            .n_file = 1, .files = &file, .size_mm = 10, .name = name, .preview = true};
        OK(relight_load(client, &load, &loaded, &error));
        relight_loaded_finish(&loaded);
    }
}

static void a_cursor_resumes(void **state)
{
    begin(NULL);
    struct cursor cursor = {"", 0}, old;
    bool lost = true;
    frames_close(subscribe(NULL, &cursor, &lost));
    assert_false(lost);
    old = cursor;
    frames_close(subscribe(&old, &cursor, &lost)); // at the newest: it has missed none
    assert_false(lost);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char id[ID_SIZE];
    bake_small(client, &d, id); // while nobody is connected
    struct frames *f = subscribe(&cursor, &cursor, &lost);
    assert_false(lost);
    Relight__Event *e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED, &cursor);
    assert_string_equal(e->model, id);
    drop(e);
    frames_close(f);
    // A cursor ahead of all events is not of this daemon.
    struct cursor ahead = cursor;
    ahead.sequence += 1000000;
    frames_close(subscribe(&ahead, &cursor, &lost));
    assert_true(lost);
    OK(relight_unload(client, id, true, NULL, &error));
    relight_close(client);
    // Nor is one of an earlier run.
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    frames_close(subscribe(&old, &cursor, &lost));
    assert_true(lost);
    assert_true(strcmp(old.run, cursor.run) != 0);
    end();
}

// More events than are kept, while the reader does not read: it learns of the loss, gets the
// newest, and the daemon keeps nothing for it.
static void a_reader_that_stays_behind(void **state)
{
    enum { MANY = 1100 }; // 1024 are kept
    begin(NULL);
    char last[32];
    struct cursor cursor = {"", 0};
    struct relight_client *client = client_open(d.address);
    frames_close(subscribe(NULL, &cursor, NULL));
    rename_often(client, MANY);
    snprintf(last, sizeof last, "name %d", MANY - 1);
    struct frames *f = subscribe(&cursor, &cursor, NULL);
    Relight__Event *e = next_event(f, 2, &cursor, 20000);
    assert_non_null(e);
    assert_true(e->lost);
    drop(e);
    bool newest = false;
    while (!newest) {
        e = next_event(f, 2, &cursor, 20000);
        assert_non_null(e);
        newest = !strcmp(e->name, last);
        drop(e);
    }
    frames_close(f);
    relight_close(client);
    end();
}

// A bake that is found damaged, when it is opened or by the check behind an earlier opening:
// whoever lists the models hears of it.
static void a_model_that_is_damaged(void **state)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    char id[ID_SIZE], path[300];
    bake_small(client, &d, id);
    OK(relight_info(client, id, &info, &error)); // it is open, and is not being opened
    relight_model_finish(&info);
    struct cursor cursor = {"", 0};
    struct frames *f = subscribe(NULL, &cursor, NULL);
    OK(relight_unload(client, id, false, NULL, &error));
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, id);
    assert_int_equal(truncate(path, 64), 0);
    // Where the check was first, it is known to have failed.
    if (!relight_info(client, id, &info, &error)) relight_model_finish(&info);
    Relight__Event *e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED, &cursor);
    while (e->state != RELIGHT__MODEL_STATE__MODEL_FAILED) {
        drop(e);
        e = event_of(f, 2, RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED, &cursor);
    }
    assert_string_equal(e->model, id);
    assert_non_null(e->error);
    assert_int_equal(e->error->code, RELIGHT__ERROR_CODE__ERROR_FORMAT);
    drop(e);
    relight_close(client);
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(models_jobs_and_environments, teardown),
        cmocka_unit_test_teardown(a_filter_of_kinds, teardown),
        cmocka_unit_test_teardown(a_cursor_resumes, teardown),
        cmocka_unit_test_teardown(the_newest_state_of_each_model, teardown),
        cmocka_unit_test_teardown(a_filter_of_a_model, teardown),
        cmocka_unit_test_teardown(a_reader_that_stays_behind, teardown),
        cmocka_unit_test_teardown(a_model_that_is_damaged, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
