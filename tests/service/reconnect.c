// SPDX-License-Identifier: MIT
// A client over a restart of the daemon: GOAWAY, connecting again, events from the cursor on;
// uploads that are listed and come back; WATCH of a model without a bake.
#include "ask.h"
#include "lone_daemon.h"

#include <pthread.h>

static struct relight_client *lasting_client(void)
{
    struct relight_client *client = NULL;
    struct relight_error error;
    struct relight_options options = {.timeout_s = 60, .reconnect_s = 30};
    OK(relight_connect(d.address, &options, &client, &error));
    return client;
}

static void calls_over_a_restart(void **state)
{
    begin(NULL);
    struct relight_client *lasting = lasting_client(), *plain = client_open(d.address);
    struct relight_error error;
    struct relight_goaway goaway;
    double seconds;
    OK(relight_ping(lasting, &seconds, &error));
    assert_false(relight_goaway(lasting, &goaway));
    for (int round = 0; round < 3; round++) {
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, NULL);
        OK(relight_ping(lasting, &seconds, &error));
        assert_false(relight_goaway(lasting, NULL));
    }
    assert_int_equal(relight_ping(plain, &seconds, &error), -RELIGHT_E_DISCONNECTED);
    assert_true(relight_goaway(plain, &goaway)); // it came before the end
    assert_float_equal(goaway.drain_s, 10, 1e-6);
    assert_string_equal(goaway.address, "");
    relight_close(plain);
    // Nobody listens any more: the call ends when reconnect_s has passed.
    relight_close(lasting);
    struct relight_options brief = {.timeout_s = 60, .reconnect_s = 0.3};
    OK(relight_connect(d.address, &brief, &lasting, &error));
    assert_int_equal(daemon_stop(&d), 0);
    assert_true(relight_ping(lasting, &seconds, &error) < 0);
    assert_true(relight_ping(lasting, &seconds, &error) < 0);
    daemon_start(&d, NULL);
    OK(relight_ping(lasting, &seconds, &error));
    relight_close(lasting);
    end();
}

// GOAWAY names another daemon: the next call goes there.
static void goes_where_it_is_sent(void **state)
{
    struct daemon other;
    char address[128];
    begin(NULL);
    other = d;
    daemon_folder(&d);
    snprintf(address, sizeof address, "%s", other.address);
    daemon_start(&d, (const char *const[]){"--goaway-address", address, NULL});
    struct relight_client *client = lasting_client();
    struct relight_error error;
    struct relight_stats stats;
    assert_int_equal(daemon_stop(&d), 0);
    daemon_remove(&d);
    OK(relight_stats(client, &stats, &error));
    relight_stats_finish(&stats);
    relight_close(client);
    d = other;
    end();
}

struct follower {
    struct relight_client *client;
    struct relight_cursor cursor;
    pthread_t thread;
    char want[ID_SIZE];
    int n, lost, status;
    struct relight_error error;
};

static int note(void *user, const struct relight_event *e)
{
    struct follower *f = user;
    __atomic_add_fetch(&f->n, 1, __ATOMIC_SEQ_CST);
    if (e->lost) f->lost++;
    return e->kind == RELIGHT_EVENT_MODEL_REMOVED;
}

static void *follow(void *user)
{
    struct follower *f = user;
    f->status = relight_events(f->client, &f->cursor, 60, note, f, &f->error);
    return NULL;
}

static void events_over_a_restart(void **state)
{
    begin(NULL);
    struct follower f = {.client = lasting_client()};
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char id[ID_SIZE], run[24];
    assert_int_equal(pthread_create(&f.thread, NULL, follow, &f), 0);
    while (!__atomic_load_n(&f.n, __ATOMIC_SEQ_CST)) sleep_ms(10);
    snprintf(run, sizeof run, "%s", relight_server(client)->run);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    bake_small(client, &d, id);
    for (int i = 0; i < 1000 && __atomic_load_n(&f.n, __ATOMIC_SEQ_CST) < 3; i++) sleep_ms(20);
    OK(relight_unload(client, id, true, NULL, &error));
    pthread_join(f.thread, NULL);
    if (f.status) fail_msg("events: %s", f.error.text);
    assert_true(f.lost >= 1); // those of the run before
    assert_true(strcmp(f.cursor.run, run) != 0);
    relight_close(client);
    relight_close(f.client);
    end();
}

static void uploads_come_back(void **state)
{
    enum { LARGE = 9 << 20 };
    begin(NULL);
    char address[80], path[160], hash[65], text[700], env[80];
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    struct relight_client *a = client_open(d.address);
    struct relight_error error;
    struct relight_list list;
    static const char hdr[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nAAAABBBB";
    OK(relight_upload(a, "sky.hdr", hdr, sizeof hdr - 1, NULL, NULL, hash, NULL, &error));
    snprintf(env, sizeof env, "env:%s", hash);
    uint8_t *bytes = malloc(LARGE), *back = malloc(LARGE);
    for (size_t i = 0; i < LARGE; i++) bytes[i] = (uint8_t)(i * 2654435761u >> 13);
    OK(relight_upload(a, "noise.bin", bytes, LARGE, NULL, NULL, hash, NULL, &error));
    for (int round = 0; round < 2; round++) { // the second after a restart
        OK(relight_list(a, true, &list, &error));
        assert_int_equal(list.n_env, 1);
        assert_string_equal(list.env[0].env, env);
        assert_string_equal(list.env[0].name, "sky.hdr");
        assert_int_equal(list.env[0].bytes, sizeof hdr - 1);
        relight_list_finish(&list);
        uint64_t size;
        snprintf(path, sizeof path, "%s/back", d.folder);
        OK(relight_download(a, hash, path, NULL, NULL, &size, &error));
        assert_int_equal(size, LARGE);
        FILE *file = fopen(path, "rb");
        assert_int_equal(fread(back, 1, LARGE, file), LARGE);
        fclose(file);
        assert_memory_equal(back, bytes, LARGE);
        OK(relight_download(a, env, path, NULL, NULL, &size, &error));
        char *got = read_text(path);
        assert_memory_equal(got, hdr, sizeof hdr - 1);
        free(got);
        relight_close(a);
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, NULL);
        a = client_open(d.address);
    }
    memset(hash, 'a', 64);
    expect(relight_download(a, hash, path, NULL, NULL, NULL, &error), RELIGHT_E_NOT_FOUND,
           &error, "no such upload");
    char *stays = read_text(path);
    assert_memory_equal(stays, hdr, sizeof hdr - 1);
    free(stays);
    unlink(path);
    expect(relight_download(a, hash, path, NULL, NULL, NULL, &error), RELIGHT_E_NOT_FOUND,
           &error, "no such upload");
    snprintf(text, sizeof text, "ls %s | grep back", d.folder); // nor is a part of it there
    assert_int_not_equal(system(text), 0);
    relight_close(a);
    // The command.
    snprintf(text, sizeof text, "%s -s %s download %s -o %s > /dev/null",
             PRT_BINARY_DIR "/relight", d.address, env, path);
    assert_int_equal(system(text), 0);
    snprintf(text, sizeof text, "%s -s %s models --files | grep -q 'sky.hdr'",
             PRT_BINARY_DIR "/relight", d.address);
    assert_int_equal(system(text), 0);
    free(bytes);
    free(back);
    end();
}

// Another principal neither lists nor fetches it, though it knows the hash and asked for it. An
// administrator does.
static void uploads_of_others(void **state)
{
    begin(NULL);
    char path[160], hash[65], secret[RELIGHT_SECRET];
    struct relight_error error;
    struct relight_list list;
    struct relight_client *a = client_open(d.address), *b;
    struct relight_token_order order = {.name = "guest", .n_scope = 2};
    order.scope = (const char *const[]){"view", "upload"};
    OK(relight_token_create(a, &order, secret, &error));
    static const char hdr[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nAAAABBBB";
    struct relight_options guest = {.token = secret, .timeout_s = 60};
    OK(relight_connect(d.address, &guest, &b, &error));
    snprintf(path, sizeof path, "%s/back", d.folder);
    OK(relight_upload(a, "mine.hdr", hdr, sizeof hdr - 1, NULL, NULL, hash, NULL, &error));
    expect(relight_download(b, hash, path, NULL, NULL, NULL, &error), RELIGHT_E_NOT_FOUND,
           &error, "no such upload");
    // It is complete at once, and so no byte was sent.
    OK(relight_upload(b, "theirs.hdr", hdr, sizeof hdr - 1, NULL, NULL, hash, NULL, &error));
    expect(relight_download(b, hash, path, NULL, NULL, NULL, &error), RELIGHT_E_NOT_FOUND,
           &error, "no such upload");
    static const char own[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nCCCCBBBB";
    OK(relight_upload(b, "own.hdr", own, sizeof own - 1, NULL, NULL, hash, NULL, &error));
    OK(relight_download(b, hash, path, NULL, NULL, NULL, &error));
    OK(relight_download(a, hash, path, NULL, NULL, NULL, &error)); // admin
    OK(relight_list(a, true, &list, &error));
    for (size_t i = 0; i < list.n_env; i++)
        assert_true(strcmp(list.env[i].name, "own.hdr") != 0);
    relight_list_finish(&list);
    relight_close(b);
    relight_close(a);
    end();
}

static void watch_without_a_bake(void **state)
{
    begin(NULL);
    struct relight_client *a = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    enum relight_job_state job_state;
    char preview[ID_SIZE], baked[ID_SIZE], job[40], record[200];
    struct relight_load load = small_bake(3, 200);
    load.preview = true;
    OK(load_octahedron(a, &d, "preview.obj", &load, &loaded, &error));
    snprintf(preview, sizeof preview, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    load = small_bake(0, 200);
    OK(load_octahedron(a, &d, "small.obj", &load, &loaded, &error));
    snprintf(baked, sizeof baked, "%s", loaded.model);
    snprintf(job, sizeof job, "%s", loaded.job);
    relight_loaded_finish(&loaded);
    OK(relight_watch(a, job, NULL, NULL, &error));
    snprintf(record, sizeof record, "%s/jobs/%s.json", d.data, job);
    for (int round = 0; round < 3; round++) {
        expect(relight_watch(a, preview, NULL, NULL, &error), RELIGHT_E_NOT_READY, &error,
               "no bake was ordered");
        OK(relight_watch(a, baked, NULL, NULL, &error));
        if (round < 2) { // kept over the first restart
            OK(relight_watch(a, job, NULL, NULL, &error));
            OK(relight_cancel_job(a, job, &job_state, &error));
            assert_int_equal(job_state, RELIGHT_JOB_DONE);
        } else { // not kept over the second one
            expect(relight_watch(a, job, NULL, NULL, &error), RELIGHT_E_NOT_FOUND, &error,
                   "of an earlier run");
            break;
        }
        relight_close(a);
        assert_int_equal(daemon_stop(&d), 0);
        if (round) assert_int_equal(unlink(record), 0);
        daemon_start(&d, NULL);
        a = client_open(d.address);
    }
    // The next bake has an id of its own.
    load = small_bake(9, 200);
    OK(load_octahedron(a, &d, "small.obj", &load, &loaded, &error));
    assert_true(strcmp(loaded.job, job) != 0);
    relight_loaded_finish(&loaded);
    relight_close(a);
    end();
}

// ---- several replicas, without a proxy

static struct relight_client *routed(const char *address, const char *route)
{
    struct relight_client *client = NULL;
    struct relight_error error;
    struct relight_options options = {.timeout_s = 60, .reconnect_s = 30, .route = route};
    OK(relight_connect(address, &options, &client, &error));
    return client;
}

// Every replica names the same replica for a route; both have some. Where that one is gone, the
// other serves.
static void routes_choose_a_replica(void **state)
{
    struct daemon a, b;
    char replicas[300], run[2][40];
    int at[2] = {0, 0}, first[12], mine = -1;
    daemon_folder(&a);
    daemon_folder(&b);
    snprintf(replicas, sizeof replicas, "%s,%s", a.address, b.address);
    daemon_start(&a,
                 (const char *const[]){"--replicas", replicas, "--advertise", a.address, NULL});
    daemon_start(&b,
                 (const char *const[]){"--replicas", replicas, "--advertise", b.address, NULL});
    for (int i = 0; i < 2; i++) {
        struct relight_client *plain = client_open(i ? b.address : a.address);
        snprintf(run[i], sizeof run[i], "%s", relight_server(plain)->run);
        relight_close(plain);
    }
    assert_string_not_equal(run[0], run[1]);
    for (int i = 0; i < 12; i++)
        for (int asked = 0; asked < 2; asked++) {
            char route[20];
            snprintf(route, sizeof route, "model-%d", i);
            struct relight_client *client = routed(asked ? b.address : a.address, route);
            int place = !strcmp(relight_server(client)->run, run[1]);
            if (asked) assert_int_equal(place, first[i]);
            first[i] = place;
            at[place]++;
            if (place) mine = i;
            relight_close(client);
        }
    assert_true(at[0] > 1 && at[1] > 1);
    // A route of b, asked of a: b goes, and a serves, for the open connection and for new ones.
    char route[20];
    struct relight_error error;
    double seconds;
    snprintf(route, sizeof route, "model-%d", mine);
    struct relight_client *client = routed(a.address, route);
    assert_string_equal(relight_server(client)->run, run[1]);
    assert_int_equal(daemon_stop(&b), 0);
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
    client = routed(a.address, route);
    assert_string_equal(relight_server(client)->run, run[0]);
    relight_close(client);
    daemon_remove(&b);
    assert_int_equal(daemon_end(&a), 0);
    daemon_remove(&a);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(routes_choose_a_replica, teardown),
        cmocka_unit_test_teardown(calls_over_a_restart, teardown),
        cmocka_unit_test_teardown(goes_where_it_is_sent, teardown),
        cmocka_unit_test_teardown(events_over_a_restart, teardown),
        cmocka_unit_test_teardown(uploads_come_back, teardown),
        cmocka_unit_test_teardown(uploads_of_others, teardown),
        cmocka_unit_test_teardown(watch_without_a_bake, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
