// SPDX-License-Identifier: MIT
// What a client may hold and say: frames in orders that no client library sends, requests,
// views, bytes and answers beyond their limits, and text that is no text. Above 600 lines: a
// list of limits, each read alone.
#include "frames.h"
#include "lone_daemon.h"

static void served(void)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double seconds;
    OK(relight_ping(client, &seconds, &error));
    relight_close(client);
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static long resident_kb(void)
{
    char path[64];
    snprintf(path, sizeof path, "/proc/%d/status", (int)d.pid);
    char *text = read_text(path), *at = strstr(text, "VmRSS:");
    long kb = at ? atol(at + 6) : 0;
    free(text);
    return kb;
}

// Once the daemon's own warm-up no longer adds to it.
static long settled_kb(void)
{
    long kb = resident_kb();
    for (int still = 0; still < 10;) {
        sleep_ms(100);
        long now = resident_kb();
        still = now - kb < 100 ? still + 1 : 0;
        kb = now;
    }
    return kb;
}

// ---- the order of messages about views

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

// ---- bytes that a client holds

static void add_watch(struct frames *f, uint64_t id, const char *job)
{
    Relight__WatchRequest watch = RELIGHT__WATCH_REQUEST__INIT;
    watch.job = (char *)job;
    frames_add(f, RELIGHT_TYPE_WATCH, id, &watch.base, NULL, 0);
}

static double held(struct relight_client *client, const char *resource)
{
    char name[80];
    snprintf(name, sizeof name, "relightd_resource_held{resource=\"%s\"}", resource);
    return metric(client, name);
}

// Loads a preview, so that views open.
static void load_preview(struct relight_client *client, char model[32])
{
    struct relight_loaded loaded;
    struct relight_error error;
    struct relight_load load = {.size_mm = 10, .material = "marble", .preview = true};
    OK(load_octahedron(client, &d, "small.obj", &load, &loaded, &error));
    snprintf(model, 32, "%s", loaded.model);
    relight_loaded_finish(&loaded);
}

// Views that are held for ever fill their own quota and nobody's requests.
static void test_idle_views_leave_room_for_requests(void **state)
{
    static const char *const extra[] = {
        "--client-views",    "40", "--requests", "8", "--queue", "8",
        "--client-requests", "8",  NULL};
    begin(extra);
    struct relight_client *client = client_open(d.address);
    char model[32];
    load_preview(client, model);
    struct frames *f = frames_open(&d);
    for (uint64_t id = 10; id < 60; id++) add_view_open(f, id, model, NULL);
    add_watch(f, 60, "nothing");
    frames_send(f);
    int busy = 0;
    for (int i = 0; i < 11; i++) {
        struct frames_answer a;
        do assert_true(frames_next(f, &a, 20000, NULL) && !a.closed);
        while (a.type != RELIGHT_TYPE_ERROR);
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BUSY);
        assert_non_null(strstr(a.text, "--client-views"));
        busy++;
    }
    assert_int_equal(busy, 11);
    assert_true(held(client, "long_requests") == 40);
    served();                                   // HELLO, PING and others go on
    assert_true(held(client, "requests") == 1); // this STATS
    // A closed view makes room.
    add_view_close(f, 70, 10);
    add_view_open(f, 71, model, NULL);
    add_view_close(f, 72, 71);
    frames_send(f);
    assert_int_equal(frames_wait(f, 70).code, 0);
    assert_int_equal(frames_wait(f, 72).code, 0);
    frames_close(f);
    sleep_ms(100);
    assert_true(held(client, "long_requests") == 0);
    relight_close(client);
    end();
}

// When every request is taken, what frees or asks for little still passes.
static void test_closes_pass_when_full(void **state)
{
    static const char *const extra[] = {"--queue", "1", "--client-requests", "1", NULL};
    begin(extra);
    struct frames *f = frames_open(&d), *other;
    Relight__ColorsRequest colors = RELIGHT__COLORS_REQUEST__INIT;
    Relight__Shade shade = RELIGHT__SHADE__INIT;
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    Relight__CancelJobRequest cancel_job = RELIGHT__CANCEL_JOB_REQUEST__INIT;
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
    colors.shade = &shade;
    shade.material = slow_material();
    cancel.id = 2;
    cancel_job.job = "nothing";
    frames_add(f, RELIGHT_TYPE_COLORS, 2, &colors.base, NULL, 0); // waits for its material
    frames_add(f, RELIGHT_TYPE_LIST, 3, &list.base, NULL, 0);
    frames_add(f, RELIGHT_TYPE_PING, 4, &ping.base, "payload", 7);
    frames_add(f, RELIGHT_TYPE_CANCEL_JOB, 5, &cancel_job.base, NULL, 0);
    add_view_close(f, 6, 77);
    frames_add(f, RELIGHT_TYPE_CANCEL, 7, &cancel.base, NULL, 0);
    frames_add(f, RELIGHT_TYPE_LIST, 8, &list.base, NULL, 0);
    frames_send(f);
    struct frames_answer a;
    static const int code[] = {
        [2] = RELIGHT__ERROR_CODE__ERROR_CANCELLED, [3] = RELIGHT__ERROR_CODE__ERROR_BUSY,
        [5] = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, [6] = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
        [8] = RELIGHT__ERROR_CODE__ERROR_NONE,
    };
    for (int i = 0; i < 7; i++) {
        assert_true(frames_next(f, &a, 20000, NULL) && !a.closed);
        assert_int_equal(a.code, code[a.id]);
        if (a.id == 4) assert_int_equal(a.payload, 7);
    }
    other = frames_open(&d);
    frames_close(other);
    frames_close(f);
    end();
}

// Payloads are asked for before they are stored, and counted as long as they are held.
static void test_bytes_held_by_requests(void **state)
{
    enum { CUBES = 8, TEXELS = CUBES * 6 * 64 * 64 * 3 };
    static const char *const extra[] = {"--client-memory", "8M", NULL};
    begin(extra);
    struct relight_client *client = client_open(d.address);
    char model[32];
    load_preview(client, model);
    struct frames *f = frames_open(&d);
    float *texels = calloc(TEXELS, sizeof *texels); // 2.25 MiB
    Relight__ViewOpenRequest open = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    Relight__ViewState view = RELIGHT__VIEW_STATE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[CUBES];
    for (int i = 0; i < CUBES; i++) lights[i] = &light;
    light.cube_n = 64;
    view.n_lights = CUBES;
    view.lights = lights;
    open.model = model;
    open.state = &view;
    open.colors = true;
    for (uint64_t id = 10; id < 20; id++)
        frames_add(f, RELIGHT_TYPE_VIEW_OPEN, id, &open.base, texels, TEXELS * sizeof *texels);
    frames_send(f);
    struct frames_answer a;
    for (int i = 0; i < 7;) {
        assert_true(frames_next(f, &a, 20000, NULL) && !a.closed);
        if (a.type != RELIGHT_TYPE_ERROR) continue;
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BUSY);
        assert_non_null(strstr(a.text, "--client-memory"));
        i++;
    }
    // Three views hold their texels once, and nothing else of size.
    double bytes = held(client, "payload");
    assert_true(bytes >= 3.0 * TEXELS * sizeof *texels);
    assert_true(bytes < 3.2 * TEXELS * sizeof *texels);
    // The connection goes on, and what a view let go of is there again: a payload that waiting
    // would not help is told apart.
    add_view_close(f, 30, 10);
    frames_send(f);
    assert_int_equal(frames_wait(f, 30).code, 0);
    // A worker that draws the closed view has its texels still.
    for (int i = 0; i < 1000 && held(client, "payload") > 2.2 * TEXELS * sizeof *texels; i++)
        sleep_ms(20);
    frames_add(f, RELIGHT_TYPE_VIEW_OPEN, 31, &open.base, texels, TEXELS * sizeof *texels);
    add_view_close(f, 32, 31);
    Relight__UpdateVerticesRequest update = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    update.model = model;
    char *large = calloc(1, 9 << 20);
    frames_send(f);
    assert_int_equal(frames_wait(f, 32).code, 0);
    frames_add(f, RELIGHT_TYPE_UPDATE_VERTICES, 33, &update.base, large, 9 << 20);
    frames_send(f);
    assert_int_equal(frames_wait(f, 33).code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    free(large);
    free(texels);
    frames_close(f);
    for (int i = 0; i < 100 && held(client, "payload") > 1000; i++) sleep_ms(20);
    assert_true(held(client, "payload") < 1000);
    relight_close(client);
    served();
    end();
}

// CPU time of the daemon's loop, which is its first thread.
static double loop_cpu_ms(void)
{
    char path[64];
    snprintf(path, sizeof path, "/proc/%d/task/%d/schedstat", (int)d.pid, (int)d.pid);
    char *text = read_text(path);
    double ms = strtod(text, NULL) * 1e-6;
    free(text);
    return ms;
}

// Law: cubes of lights cost the loop no more than the same bytes of an upload, which are
// received, counted and hashed elsewhere.
static void test_cubes_are_hashed_elsewhere(void **state)
{
    enum { CUBES = 16, TEXELS = CUBES * 6 * 128 * 128 * 3, TURNS = 6 };
    static const char *const extra[] = {"--client-memory", "1G", NULL};
    begin(extra);
    struct frames *f = frames_open(&d);
    float *texels = calloc(TEXELS, sizeof *texels); // 18 MiB
    Relight__ColorsRequest colors = RELIGHT__COLORS_REQUEST__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[CUBES];
    Relight__PutBlobRequest put = RELIGHT__PUT_BLOB_REQUEST__INIT;
    for (int i = 0; i < CUBES; i++) lights[i] = &light;
    light.cube_n = 128;
    colors.model = (char *)"nothing"; // the lights are read before the model is looked for
    colors.lights = lights;
    colors.n_lights = CUBES;
    put.hash = (char *)"0000000000000000000000000000000000000000000000000000000000000000";
    put.size = TEXELS * sizeof *texels;
    double cpu_ms[2] = {0, 0};
    for (uint64_t id = 2; id < 2 + 2 * TURNS; id++) {
        int cubes = id % 2;
        texels[0] = (float)id;
        double before = loop_cpu_ms();
        if (cubes)
            frames_add(f, RELIGHT_TYPE_COLORS, id, &colors.base, texels,
                       TEXELS * sizeof *texels);
        else
            frames_add(f, RELIGHT_TYPE_PUT_BLOB, id, &put.base, texels,
                       TEXELS * sizeof *texels);
        frames_send(f);
        assert_int_equal(frames_wait(f, id).code, cubes ? RELIGHT__ERROR_CODE__ERROR_NOT_FOUND
                                                        : RELIGHT__ERROR_CODE__ERROR_HASH);
        double ms = loop_cpu_ms() - before; // the best turn: what else runs only adds
        if (!cpu_ms[cubes] || ms < cpu_ms[cubes]) cpu_ms[cubes] = ms;
    }
    print_message("18 MiB: %.1f ms of the loop for cubes, %.1f ms for an upload\n", cpu_ms[1],
                  cpu_ms[0]);
    assert_true(cpu_ms[1] < 1.6 * cpu_ms[0]);
    // One that is no radiance is found there, too.
    texels[1234567] = -1;
    frames_add(f, RELIGHT_TYPE_COLORS, 50, &colors.base, texels, TEXELS * sizeof *texels);
    frames_send(f);
    struct frames_answer a = frames_wait(f, 50);
    assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    assert_non_null(strstr(a.text, "texels[1234567]"));
    free(texels);
    frames_close(f);
    served();
    end();
}

// Vertices that were moved are paid for by who moved them, until they are put back.
static void test_poses_are_counted(void **state)
{
    static const char *const extra[] = {"--client-memory", "4k", NULL};
    begin(extra);
    struct relight_client *client = client_open(d.address);
    char model[32];
    load_preview(client, model);
    struct frames *f = frames_open(&d);
    float vertex[3] = {1, 2, 3};
    Relight__UpdateVerticesRequest update = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    Relight__UnloadRequest unload = RELIGHT__UNLOAD_REQUEST__INIT;
    update.model = unload.model = model;
    update.n = 1;
    double before = held(client, "payload"), pose = 24.0 * OCTAHEDRON_VERTICES;
    for (uint64_t id = 2; id < 5; id++) { // once, however often they move
        frames_add(f, RELIGHT_TYPE_UPDATE_VERTICES, id, &update.base, vertex, sizeof vertex);
        frames_send(f);
        assert_int_equal(frames_wait(f, id).code, 0);
        assert_true(held(client, "payload") == before + pose);
    }
    frames_add(f, RELIGHT_TYPE_UNLOAD, 6, &unload.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 6).code, 0);
    for (int i = 0; i < 100 && held(client, "payload") != before; i++) sleep_ms(20);
    assert_true(held(client, "payload") == before);
    frames_close(f);
    relight_close(client);
    end();
}

static struct relight_view *open_picture(struct relight_client *client, const char *model)
{
    struct relight_view *view;
    struct relight_error error;
    struct relight_frame_out frame;
    struct relight_light light = {.env = "constant"};
    struct relight_view_request open = {.model = model, .n_light = 1, .lights = &light};
    open.picture.width = open.picture.height = 200;
    OK(relight_view_open(client, &open, &view, &error));
    OK(relight_view_next(view, 20, &frame, &error));
    relight_frame_out_finish(&frame);
    return view;
}

// The mean of a view's pictures is its client's, as long as the state stays; where it would be
// beyond the limit the view is not refined.
static void test_means_are_counted(void **state)
{
    enum { LEAST = 50000 }; // bytes of the mean of the points that the picture sees
    static const char *const little[] = {"--client-memory", "32k", NULL};
    begin(NULL);
    struct relight_client *other = client_open(d.address), *client = client_open(d.address);
    struct relight_error error;
    struct relight_frame_out frame;
    char model[40];
    load_preview(other, model);
    double before = held(other, "payload");
    struct relight_view *view = open_picture(client, model);
    assert_true(held(other, "payload") > before + LEAST);
    OK(relight_view_close(view, NULL, NULL, &error));
    for (int i = 0; i < 100 && held(other, "payload") > before; i++) sleep_ms(20);
    assert_true(held(other, "payload") == before);
    relight_close(client);
    relight_close(other);
    end();
    begin(little);
    client = client_open(d.address);
    load_preview(client, model);
    view = open_picture(client, model);
    assert_int_equal(relight_view_next(view, 1, &frame, &error), -RELIGHT_E_TIMEOUT);
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_close(client);
    end();
}

// Whether the daemon runs under AddressSanitizer or ThreadSanitizer: its memory says nothing of
// its own then, and it is slow.
static bool is_sanitized(void)
{
    char path[64];
    snprintf(path, sizeof path, "/proc/%d/maps", (int)d.pid);
    char *maps = read_text(path);
    bool found = strstr(maps, "libasan") || strstr(maps, "libtsan");
    free(maps);
#if defined __SANITIZE_ADDRESS__ || defined __SANITIZE_THREAD__ // linked statically
    found = true;
#endif
    return found;
}

// A view's texels lie in memory once: not beside the payload that brought them.
static void test_texels_lie_there_once(void **state)
{
    enum { CUBES = 16, TEXELS = CUBES * 6 * 64 * 64 * 3, N = 20 };
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    char model[32];
    load_preview(client, model);
    struct frames *f = frames_open(&d);
    float *texels = calloc(TEXELS, sizeof *texels); // 4.5 MiB
    Relight__ViewOpenRequest open = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    Relight__ViewState view = RELIGHT__VIEW_STATE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[CUBES];
    for (int i = 0; i < CUBES; i++) lights[i] = &light;
    light.cube_n = 64;
    view.n_lights = CUBES;
    view.lights = lights;
    open.model = model;
    open.state = &view;
    open.colors = true;
    long before = settled_kb(), each = TEXELS * (long)sizeof *texels >> 10;
    for (uint64_t id = 10; id < 10 + N; id++) {
        frames_add(f, RELIGHT_TYPE_VIEW_OPEN, id, &open.base, texels, TEXELS * sizeof *texels);
        frames_send(f);
        struct frames_answer a;
        assert_true(frames_next(f, &a, 20000, NULL) &&
                    !a.closed); // not ready: it bakes nothing
    }
    double views = (double)(resident_kb() - before) / (double)each;
    print_message("%d views hold the bytes of %.1f\n", N, views);
    assert_true(is_sanitized() || views < 1.4 * N);
    free(texels);
    frames_close(f);
    relight_close(client);
    end();
}

// A payload where none belongs is not stored at all, and the connection goes on.
static void test_payload_where_none_belongs(void **state)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char *bytes = calloc(1, 40 << 20);
    Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_LIST, 2, &list.base, bytes, 40 << 20);
    frames_add(f, RELIGHT_TYPE_PING, 3, &ping.base, bytes, 65537);
    frames_add(f, RELIGHT_TYPE_PING, 4, &ping.base, bytes, 65536);
    frames_add(f, RELIGHT_TYPE_PING, 0, &ping.base, NULL, 0);
    frames_send(f);
    struct frames_answer a = frames_wait(f, 2);
    assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    assert_non_null(strstr(a.text, "has no payload"));
    assert_int_equal(frames_wait(f, 3).code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_int_equal(frames_wait(f, 4).payload, 65536);
    a = frames_wait(f, 0);
    assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    assert_non_null(strstr(a.text, "id 0"));
    free(bytes);
    frames_close(f);
    end();
}

// ---- answers that are not read

// Answers of 64 KiB, asked for and not read.
static struct frames *open_sleeper(int n)
{
    struct frames *f = frames_open(&d);
    static char bytes[65536];
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    for (int i = 0; i < n; i++)
        frames_add(f, RELIGHT_TYPE_PING, 10 + (uint64_t)i, &ping.base, bytes, sizeof bytes);
    frames_try_send(f); // it may be closed meanwhile
    return f;
}

// Of all who do not read, the one that holds most is closed first.
static void test_largest_output_is_closed(void **state)
{
    static const char *const extra[] = {"--output-memory", "4M", "--send-buffer", "8M", NULL};
    begin(extra);
    struct relight_client *client = client_open(d.address);
    struct frames *small = open_sleeper(16), *large = open_sleeper(100);
    assert_true(log_says(&d, "why=\"all unread answers exceed --output-memory", 10000));
    struct frames_answer a;
    int n = 0;
    while (frames_next(large, &a, 5000, NULL) && !a.closed) n++;
    assert_true(a.closed);
    assert_true(n < 100);
    assert_int_equal(frames_wait(small, 25).payload, 65536); // this one lost nothing
    assert_true(held(client, "output") <= 4 << 20);
    frames_close(small);
    frames_close(large);
    relight_close(client);
    end();
}

// A reader that reads, but never catches up, has --write-time to come below the send buffer.
static void test_reader_that_stays_behind(void **state)
{
    static const char *const extra[] = {"--send-buffer", "256k", "--write-time", "1", NULL};
    begin(extra);
    struct frames *f = frames_open(&d);
    Relight__StatsRequest stats = RELIGHT__STATS_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_STATS, 2, &stats.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 2).code, 0);
    size_t size = f->decoder.frame.header_size;
    for (uint64_t id = 3; id < 3 + (640 << 10) / size; id++)
        frames_add(f, RELIGHT_TYPE_STATS, id, &stats.base, NULL, 0);
    frames_send(f);
    char bytes[4096];
    double until = now_s() + 10;
    bool closed = false;
    while (!closed && now_s() < until) {
        sleep_ms(50);
        closed =
            recv(f->fd, bytes, sizeof bytes, 0) <= 0 || log_says(&d, "passed --send-buf", 0);
    }
    // The log's thread may write the line after the connection was closed.
    assert_true(log_says(&d, "why=\"its answers have passed --send-buffer", 10000));
    frames_close(f);
    served();
    end();
}

// One answer many times the send buffer reaches whoever reads it, in pieces or whole.
static void test_answer_beyond_the_send_buffer(void **state)
{
    static const char *const extra[] = {"--send-buffer", "10k", NULL};
    begin(extra);
    for (int pieces = 0; pieces < 2; pieces++) {
        struct frames *f = frames_connect(&d);
        Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
        hello.client = "reader";
        hello.version_min = hello.version_max = 1;
        hello.max_payload = pieces ? 4096 : 0;
        frames_add(f, RELIGHT_TYPE_HELLO, 1, &hello.base, NULL, 0);
        static char bytes[65536];
        Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
        frames_send(f);
        assert_int_equal(frames_wait(f, 1).code, 0);
        for (uint64_t id = 2; id < 6; id++) {
            struct frames_answer a;
            uint64_t got = 0;
            frames_add(f, RELIGHT_TYPE_PING, id, &ping.base, bytes, sizeof bytes);
            frames_send(f);
            do {
                assert_true(frames_next(f, &a, 5000, NULL));
                assert_false(a.closed);
                assert_int_equal(a.id, id);
                got += a.payload;
            } while (!a.last);
            assert_int_equal(got, sizeof bytes);
        }
        frames_close(f);
    }
    end();
}

// Requests that were read before the answers to others filled the send buffer are answered once
// these were read.
static void test_requests_behind_a_full_buffer(void **state)
{
    enum { N = 1500 }; // less than is read at once, and more than a turn of the loop answers
    static const char *const extra[] = {"--send-buffer", "1M", NULL};
    begin(extra);
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    Relight__StatsRequest stats = RELIGHT__STATS_REQUEST__INIT;
    for (uint64_t id = 2; id < N + 2; id++)
        frames_add(f, RELIGHT_TYPE_STATS, id, &stats.base, NULL, 0);
    frames_send(f);
    for (int i = 0; i < 1000 && held(client, "output") <= 1 << 20; i++) sleep_ms(10);
    assert_true(held(client, "output") > 1 << 20);
    assert_int_equal(frames_wait(f, N + 1).code, 0);
    frames_close(f);
    relight_close(client);
    end();
}

// The connection ends while its answers are made; the daemon goes on.
static void ends(struct frames *f)
{
    struct frames_answer a;
    frames_send(f);
    do assert_true(frames_next(f, &a, 20000, NULL));
    while (!a.closed);
    frames_close(f);
    served();
}

// Many requests of one connection wait for the same thing. The answers to the first pass the
// send buffer, which closes the connection, and ends the others while they are being woken.
static void test_closed_by_one_of_many_answers(void **state)
{
    static const char *const extra[] = {"--send-buffer", "1k", NULL};
    enum { N = 100 };
    char model[32];
    begin(extra);
    struct relight_error error;
    struct relight_client *client = client_open(d.address);
    load_preview(client, model);
    OK(relight_unload(client, model, false, NULL, &error));
    struct frames *f = frames_open(&d);
    Relight__InfoRequest info = RELIGHT__INFO_REQUEST__INIT;
    info.model = model;
    for (uint64_t id = 2; id < 2 + N; id++) // of a model whose file is opened first
        frames_add(f, RELIGHT_TYPE_INFO, id, &info.base, NULL, 0);
    ends(f);
    f = frames_open(&d);
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    load.path = "nothing.glb";
    load.size_mm = 10;
    load.material = "marble";
    for (uint64_t id = 2; id < 2 + N; id++) // of a file that is looked for
        frames_add(f, RELIGHT_TYPE_LOAD, id, &load.base, NULL, 0);
    ends(f);
    relight_close(client);
    end();
}

// The same where they wait for lights that one pass over the transport computes.
static void test_closed_by_one_light_of_a_pass(void **state)
{
    static const char *const extra[] = {"--send-buffer", "64", NULL};
    enum { N = 16, ROUNDS = 10 };
    char model[ID_SIZE], env[N][40];
    begin(extra);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    for (int round = 0; round < ROUNDS; round++) {
        struct frames *f = frames_open(&d);
        for (int i = 0; i < N; i++) {
            Relight__ColorsRequest colors = RELIGHT__COLORS_REQUEST__INIT;
            Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
            snprintf(env[i], sizeof env[i], "constant:%d,%d,1", round + 1, i + 1);
            light.env = env[i];
            colors.model = model;
            colors.lights = lights;
            colors.n_lights = 1;
            frames_add(f, RELIGHT_TYPE_COLORS, 2 + (uint64_t)i, &colors.base, NULL, 0);
        }
        ends(f);
    }
    relight_close(client);
    end();
}

// ---- headers

// Half a million empty messages in one header are refused before any is unpacked.
static void test_headers_that_unpack_to_much(void **state)
{
    enum { HEADER = 1 << 20 };
    static uint8_t lights[HEADER], opaque[HEADER], unknown[HEADER];
    begin(NULL);
    for (int i = 0; i < HEADER; i += 2) {
        lights[i] = 2 << 3 | 2;   // ColorsRequest.lights
        opaque[i] = 8 << 3 | 2;   // LoadRequest.opaque
        unknown[i] = 15 << 3 | 0; // of no field
        lights[i + 1] = opaque[i + 1] = unknown[i + 1] = 0;
    }
    struct frames *f = frames_open(&d);
    frames_add_raw(f, RELIGHT_TYPE_COLORS, 2, lights, HEADER);
    frames_add_raw(f, RELIGHT_TYPE_LOAD, 3, opaque, HEADER);
    frames_add_raw(f, RELIGHT_TYPE_PING, 4, unknown, HEADER);
    frames_send(f);
    for (uint64_t id = 2; id < 5; id++) {
        struct frames_answer a = frames_wait(f, id);
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_non_null(strstr(a.text, "more parts"));
    }
    // One of 16000 parts is read, one of 16385 is not.
    frames_add_raw(f, RELIGHT_TYPE_LOAD, 5, opaque, 2 * 16000);
    frames_add_raw(f, RELIGHT_TYPE_LOAD, 6, opaque, 2 * 16385);
    frames_send(f);
    assert_null(strstr(frames_wait(f, 5).text, "more parts"));
    assert_non_null(strstr(frames_wait(f, 6).text, "more parts"));
    // Nor do they hold up the loop.
    double best = 1;
    struct relight_client *client = client_open(d.address);
    for (int i = 0; i < 5; i++) {
        double before = now_s();
        frames_add_raw(f, RELIGHT_TYPE_COLORS, 10 + (uint64_t)i, lights, HEADER);
        frames_send(f);
        frames_wait(f, 10 + (uint64_t)i);
        double took = now_s() - before;
        if (took < best) best = took;
    }
    print_message("a header of a mebibyte was answered after %.1f ms\n", best * 1e3);
    // Reading it is most of that; a sanitizer makes it ten times as long.
    assert_true(best < (is_sanitized() ? 0.2 : 0.02));
    relight_close(client);
    frames_close(f);
    served();
    end();
}

// A connection that sent one large header keeps nothing of it.
static void test_idle_after_a_large_header(void **state)
{
    enum { N = 400, HEADER = 1 << 20 };
    static struct frames *f[N];
    static uint8_t header[HEADER];
    begin(NULL);
    header[0] = 15 << 3 | 2; // an unknown field, long
    size_t n = HEADER - 4;
    header[1] = (uint8_t)(n & 127) | 128;
    header[2] = (uint8_t)(n >> 7 & 127) | 128;
    header[3] = (uint8_t)(n >> 14);
    memset(header + 4, 'x', n);
    for (int i = 0; i < N; i++) f[i] = frames_open(&d);
    long before = 0;
    for (int i = 0; i < N; i++) {
        if (i == 1) before = settled_kb(); // malloc keeps the first one's memory for the rest
        frames_add_raw(f[i], RELIGHT_TYPE_PING, 2, header, HEADER);
        frames_send(f[i]);
        assert_int_equal(frames_wait(f[i], 2).code, 0);
    }
    long each = (resident_kb() - before) / N;
    const bool kept = is_sanitized();
    print_message("%ld KiB a connection\n", each);
    for (int i = 0; i < N; i++) frames_close(f[i]);
    end();
    if (kept) {
        print_message(
            "skipped: the daemon's sanitizer keeps memory that was freed, so that its "
            "size says nothing\n");
        skip();
    }
    assert_true(each <= 16);
}

// ---- text

static struct frames_answer load_named(struct frames *f, uint64_t id, const char *name,
                                       const char *path)
{
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    load.path = (char *)path;
    load.name = (char *)name;
    load.size_mm = 10;
    load.material = "marble";
    load.preview = true;
    frames_add(f, RELIGHT_TYPE_LOAD, id, &load.base, NULL, 0);
    frames_send(f);
    return frames_wait(f, id);
}

// The code of a LOAD of one uploaded file under this name, whose bytes are not there.
static int code_of_file_name(struct frames *f, uint64_t id, const char *name)
{
    static char nowhere[65];
    Relight__FileRef file = RELIGHT__FILE_REF__INIT, *files[] = {&file};
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    memset(nowhere, 'a', 64);
    file.name = (char *)name;
    file.blob = nowhere;
    load.files = files, load.n_files = 1;
    load.size_mm = 10;
    load.material = "marble";
    load.preview = true;
    frames_add(f, RELIGHT_TYPE_LOAD, id, &load.base, NULL, 0);
    frames_send(f);
    return frames_wait(f, id).code;
}

// Every kind of name that leads out of a model's folder, hides, or is no text for a log. A name
// is looked at before its bytes, so that a good one gets as far as these.
static void test_file_names_are_plain(void **state)
{
    char longest[202];
    memset(longest, 'x', sizeof longest - 1);
    longest[201] = 0;
    const char *const bad[] = {"",     "/a",   ".a",   "..",   "../a", "a/../b",
                               "a/..", "a/.b", "a//b", "a\\b", longest};
    const char *const control[] = {"a\nb", "a\x1f", "a\x7f"}; // refused as text already
    const char *const good[] = {"a",    "a/b/c.bin", "a..b",     "a.",
                                "~a b", "\xc3\xbc",  longest + 1};
    begin(NULL);
    struct frames *f = frames_open(&d);
    uint64_t id = 2;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        const int code = code_of_file_name(f, id++, bad[i]);
        if (code != RELIGHT__ERROR_CODE__ERROR_FORBIDDEN)
            fail_msg("bad name %zu: code %d", i, code);
    }
    for (size_t i = 0; i < sizeof control / sizeof *control; i++)
        assert_int_equal(code_of_file_name(f, id++, control[i]),
                         RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        const int code = code_of_file_name(f, id++, good[i]);
        if (code != RELIGHT__ERROR_CODE__ERROR_NOT_FOUND)
            fail_msg("good name %zu: code %d", i, code);
    }
    frames_close(f);
    end();
}

static void test_text_is_text(void **state)
{
    static const char *const bad[] = {
        "\xff\xfe\x80",     // no UTF-8 at all
        "\xc0\xaf",         // overlong
        "\xed\xa0\x80",     // a surrogate
        "\xf4\x90\x80\x80", // beyond Unicode
        "half \xe2\x82",    // cut off
    };
    static const char *const control[] = {"a\nb", "\x1b[31mred", "del\x7f",
                                          ("\xc2\x9b"
                                           "31m")};
    begin(NULL);
    char path[160];
    snprintf(path, sizeof path, "%s/model.obj", d.models);
    write_text(path, octahedron);
    struct frames *f = frames_open(&d);
    uint64_t id = 2;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct frames_answer a = load_named(f, id++, bad[i], "model.obj");
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_string_equal(a.text, "name: the text is not valid UTF-8");
        a = load_named(f, id++, "", bad[i]);
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_string_equal(a.text, "path: the text is not valid UTF-8");
    }
    for (size_t i = 0; i < sizeof control / sizeof *control; i++) {
        struct frames_answer a = load_named(f, id++, control[i], "model.obj");
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_string_equal(a.text, "name: a name has no control characters");
    }
    // A zero byte would hide what follows it.
    static const uint8_t zero[] = {3 << 3 | 2, 3, 'a', 0, 'b'};
    frames_add_raw(f, RELIGHT_TYPE_LOAD, id, zero, sizeof zero);
    frames_send(f);
    assert_non_null(strstr(frames_wait(f, id++).text, "not valid UTF-8"));
    assert_int_equal(
        load_named(f, id++, "grüße \xe2\x82\xac \xf0\x9f\x90\xb0", "model.obj").code, 0);
    // A long text is cut between characters, in an error and in a name.
    char euros[1500], shifted[1504];
    for (size_t i = 0; i < sizeof euros - 1; i++) euros[i] = "\xe2\x82\xac"[i % 3];
    euros[sizeof euros - 3] = 0;
    for (size_t shift = 0; shift < 3; shift++) {
        memset(shifted, 'x', shift);
        snprintf(shifted + shift, sizeof shifted - shift, "%s", euros);
        struct frames_answer a = load_named(f, id++, "", shifted);
        assert_true(a.code != 0);
        for (const char *at = a.text; *at;) {
            size_t n = relight_utf8_next((const uint8_t *)at, strlen(at));
            assert_true(n > 0);
            at += n;
        }
        assert_int_equal(load_named(f, id++, shifted, "model.obj").code, 0);
        Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
        frames_add(f, RELIGHT_TYPE_LIST, id++, &list.base, NULL, 0);
        frames_send(f);
        ProtobufCMessage *m = NULL;
        assert_true(frames_next(f, &a, 5000, &m) && !a.closed);
        const Relight__ListAnswer *all = (const Relight__ListAnswer *)m;
        assert_true(all->n_models > 0);
        for (size_t i = 0; i < all->n_models; i++)
            for (const char *at = all->models[i]->name; *at;) {
                size_t n = relight_utf8_next((const uint8_t *)at, strlen(at));
                assert_true(n > 0);
                at += n;
            }
        protobuf_c_message_free_unpacked(m, NULL);
    }
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_view_that_is_not_open_yet, teardown),
        cmocka_unit_test_teardown(test_view_that_waits_for_its_material, teardown),
        cmocka_unit_test_teardown(test_cancel_the_oldest_job, teardown),
        cmocka_unit_test_teardown(test_idle_views_leave_room_for_requests, teardown),
        cmocka_unit_test_teardown(test_closes_pass_when_full, teardown),
        cmocka_unit_test_teardown(test_bytes_held_by_requests, teardown),
        cmocka_unit_test_teardown(test_poses_are_counted, teardown),
        cmocka_unit_test_teardown(test_means_are_counted, teardown),
        cmocka_unit_test_teardown(test_texels_lie_there_once, teardown),
        cmocka_unit_test_teardown(test_payload_where_none_belongs, teardown),
        cmocka_unit_test_teardown(test_largest_output_is_closed, teardown),
        cmocka_unit_test_teardown(test_reader_that_stays_behind, teardown),
        cmocka_unit_test_teardown(test_answer_beyond_the_send_buffer, teardown),
        cmocka_unit_test_teardown(test_requests_behind_a_full_buffer, teardown),
        cmocka_unit_test_teardown(test_closed_by_one_of_many_answers, teardown),
        cmocka_unit_test_teardown(test_closed_by_one_light_of_a_pass, teardown),
        cmocka_unit_test_teardown(test_headers_that_unpack_to_much, teardown),
        cmocka_unit_test_teardown(test_idle_after_a_large_header, teardown),
        cmocka_unit_test_teardown(test_cubes_are_hashed_elsewhere, teardown),
        cmocka_unit_test_teardown(test_file_names_are_plain, teardown),
        cmocka_unit_test_teardown(test_text_is_text, teardown),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("limits", tests, NULL, NULL);
}
