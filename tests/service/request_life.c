// SPDX-License-Identifier: MIT
// How requests end that cannot be answered yet: by their deadline, by CANCEL, by an answer
// after all; and how many frames a view sends to a client that acknowledges none. The daemon is
// kept from answering by stopping the process that decodes environments.
#include "frames.h"

#include <dirent.h>

static struct daemon d;
static char model[40];
static struct relight_client *uploader;

// The daemon's child that decodes; 0: none runs.
static pid_t decode_helper(void)
{
    DIR *dir = opendir("/proc");
    pid_t found = 0;
    for (struct dirent *e; dir && !found && (e = readdir(dir));) {
        char path[300], text[512] = "", stat[512] = "";
        int parent = 0;
        if (e->d_name[0] < '0' || e->d_name[0] > '9') continue;
        snprintf(path, sizeof path, "/proc/%s/cmdline", e->d_name);
        FILE *file = fopen(path, "r");
        size_t n = file ? fread(text, 1, sizeof text - 1, file) : 0;
        if (file) fclose(file);
        snprintf(path, sizeof path, "/proc/%s/stat", e->d_name);
        if ((file = fopen(path, "r"))) {
            if (!fgets(stat, sizeof stat, file)) stat[0] = 0;
            fclose(file);
        }
        char *after = strrchr(stat, ')');
        if (after) sscanf(after + 1, " %*c %d", &parent);
        if (parent == d.pid && memmem(text, n, "--decode-helper", 15)) found = atoi(e->d_name);
    }
    if (dir) closedir(dir);
    return found;
}

static void hold_decoder(bool hold)
{
    pid_t pid = decode_helper();
    if (!pid) fail_msg("no decode helper runs");
    kill(pid, hold ? SIGSTOP : SIGCONT);
}

// An environment that the daemon has not seen: a lat-long of 8 x 4 pixels, flat RGBE, whose red
// tells one from the other. An upload is decoded ahead of its use, so hold_decoder comes first.
static char *fresh_env(void)
{
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 4 +X 8\n";
    static char word[16][80];
    static int n;
    char bytes[sizeof head - 1 + 8 * 4 * 4], hash[65], *out = word[n % 16];
    struct relight_error error;
    memcpy(bytes, head, sizeof head - 1);
    for (int i = 0; i < 8 * 4; i++) {
        char *pixel = bytes + sizeof head - 1 + 4 * i;
        pixel[0] = (char)(64 + n), pixel[1] = 100, pixel[2] = 120, pixel[3] = (char)128;
    }
    n++;
    OK(relight_upload(uploader, "small.hdr", bytes, sizeof bytes, NULL, NULL, hash, NULL,
                      &error));
    snprintf(out, sizeof word[0], "env:%s", hash);
    return out;
}

static int setup(void **state)
{
    // Two of the answers that test_unread_answers_are_late leaves unread exceed it.
    static const char *const extra[] = {"--send-buffer", "16M", NULL};
    daemon_folder(&d);
    daemon_start(&d, extra);
    struct relight_error error;
    uploader = client_open(d.address);
    bake_small(uploader, &d, model);
    struct relight_env_info info;
    OK(relight_env_prepare(uploader, fresh_env(), &info, &error)); // starts the helper
    return 0;
}

static int teardown(void **state)
{
    if (decode_helper()) hold_decoder(false);
    relight_close(uploader);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static int let_decoder_go(void **state)
{
    if (decode_helper()) hold_decoder(false);
    return 0;
}

// frames_add with a deadline.
static void add_with_deadline(struct frames *f, uint16_t type, uint64_t id,
                              uint32_t deadline_ms, const ProtobufCMessage *message)
{
    size_t at = f->n;
    frames_add(f, type, id, message, NULL, 0);
    for (int i = 0; i < 4; i++) f->bytes[at + 20 + (size_t)i] = (uint8_t)(deadline_ms >> 8 * i);
}

struct lit {
    Relight__Light light, *lights[1];
};

static void light_up(struct lit *lit)
{
    relight__light__init(&lit->light);
    lit->light.env = fresh_env();
    lit->lights[0] = &lit->light;
}

static void add_colors(struct frames *f, uint64_t id, uint32_t deadline_ms)
{
    struct lit lit;
    Relight__ColorsRequest m = RELIGHT__COLORS_REQUEST__INIT;
    light_up(&lit);
    m.model = model;
    m.n_lights = 1;
    m.lights = lit.lights;
    add_with_deadline(f, RELIGHT_TYPE_COLORS, id, deadline_ms, &m.base);
}

static void add_image(struct frames *f, uint64_t id, uint32_t deadline_ms)
{
    struct lit lit;
    Relight__ImageRequest m = RELIGHT__IMAGE_REQUEST__INIT;
    light_up(&lit);
    m.model = model;
    m.n_lights = 1;
    m.lights = lit.lights;
    add_with_deadline(f, RELIGHT_TYPE_IMAGE, id, deadline_ms, &m.base);
}

// Answers that the client has not begun to read by their deadline come as DEADLINE: the socket
// holds the beginning of the first, and none of the others.
static void test_unread_answers_are_late(void **state)
{
    enum { N = 4, DEADLINE = 4000, SIDE = 1200 };
    struct frames *f = frames_open(&d);
    unsigned good = 0, late = 0;
    for (uint64_t i = 0; i < N; i++) {
        Relight__ImageRequest m = RELIGHT__IMAGE_REQUEST__INIT;
        Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
        Relight__Picture picture = RELIGHT__PICTURE__INIT;
        light.env = "constant:1,1,1";
        picture.width = picture.height = SIDE;
        picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_F16; // 8.6 MB: more than a socket holds
        picture.exposure_ev = (float)i;
        m.model = model;
        m.lights = lights, m.n_lights = 1;
        m.picture = &picture;
        add_with_deadline(f, RELIGHT_TYPE_IMAGE, 50 + i, DEADLINE, &m.base);
    }
    frames_send(f);
    sleep_ms(DEADLINE + 500);
    for (unsigned i = 0; i < N; i++) {
        struct frames_answer a;
        assert_true(frames_next(f, &a, 20000, NULL));
        assert_false(a.closed);
        if (a.code) assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_DEADLINE);
        good += !a.code;
        late += a.code != 0;
    }
    print_message("%u answers, %u late\n", good, late);
    assert_true(good <= 1 && late >= N - 1);
    // The replaced answers are no output any more: the connection is read on.
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_PING, 60, &ping.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 60).code, 0);
    frames_close(f);
}

static void add_env(struct frames *f, uint64_t id, uint32_t deadline_ms)
{
    Relight__EnvRequest m = RELIGHT__ENV_REQUEST__INIT;
    m.env = fresh_env();
    add_with_deadline(f, RELIGHT_TYPE_ENV, id, deadline_ms, &m.base);
}

static void add_view(struct frames *f, uint64_t id, uint32_t deadline_ms)
{
    struct lit lit;
    Relight__ViewOpenRequest m = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    Relight__ViewState view_state = RELIGHT__VIEW_STATE__INIT;
    light_up(&lit);
    m.model = model;
    m.colors = true;
    m.state = &view_state;
    view_state.n_lights = 1;
    view_state.lights = lit.lights;
    add_with_deadline(f, RELIGHT_TYPE_VIEW_OPEN, id, deadline_ms, &m.base);
}

static uint64_t now_ms(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000 + (uint64_t)t.tv_nsec / 1000000;
}

// Each operation that may wait is answered DEADLINE by the daemon, not before its time and not
// long after; the connection goes on.
static void test_deadlines_of_every_operation(void **state)
{
    static const struct {
        const char *name;
        void (*add)(struct frames *f, uint64_t id, uint32_t deadline_ms);
    } operation[] = {{"ENV", add_env},
                     {"COLORS", add_colors},
                     {"IMAGE", add_image},
                     {"VIEW_OPEN", add_view}};
    enum { N = sizeof operation / sizeof *operation, LIMIT_MS = 300 };
    struct frames *f = frames_open(&d);
    hold_decoder(true);
    uint64_t start = now_ms();
    for (uint64_t i = 0; i < N; i++) operation[i].add(f, 10 + i, LIMIT_MS);
    frames_send(f);
    for (uint64_t i = 0; i < N; i++) {
        struct frames_answer a;
        if (!frames_next(f, &a, 20000, NULL)) fail_msg("a deadline is not kept");
        assert_in_range(a.id, 10, 10 + N - 1);
        uint64_t after = now_ms() - start;
        print_message("%s: code %d after %llu ms\n", operation[a.id - 10].name, a.code,
                      (unsigned long long)after);
        assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_DEADLINE);
        assert_true(a.last);
        assert_in_range(after, LIMIT_MS - 1, 15000);
    }
    frames_add(f, RELIGHT_TYPE_PING, 50, NULL, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 50).code, 0);
    frames_close(f);
}

// Of several requests that wait, CANCEL ends the one it names, and no other.
static void test_cancel_ends_one(void **state)
{
    struct frames *f = frames_open(&d);
    Relight__CancelRequest cancel = RELIGHT__CANCEL_REQUEST__INIT;
    ProtobufCMessage *message = NULL;
    struct frames_answer a;
    hold_decoder(true);
    add_colors(f, 10, 0);
    add_colors(f, 11, 0);
    add_image(f, 12, 0);
    cancel.id = 11;
    frames_add(f, RELIGHT_TYPE_CANCEL, 20, &cancel.base, NULL, 0);
    cancel.id = 99;
    frames_add(f, RELIGHT_TYPE_CANCEL, 21, &cancel.base, NULL, 0);
    frames_send(f);
    unsigned n_cancelled = 0, n_answer = 0;
    while (n_answer < 3) {
        assert_true(frames_next(f, &a, 20000, &message));
        n_answer++;
        if (a.id == 11) {
            assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
            n_cancelled++;
        } else {
            assert_true(a.id == 20 || a.id == 21);
            assert_int_equal(a.type, RELIGHT_TYPE_CANCEL | RELIGHT_TYPE_ANSWER);
            assert_int_equal(((Relight__CancelAnswer *)message)->found, a.id == 20);
        }
        protobuf_c_message_free_unpacked(message, NULL);
    }
    assert_int_equal(n_cancelled, 1);
    assert_false(frames_next(f, &a, 300, NULL)); // 10 and 12 still wait
    hold_decoder(false);
    bool answered[2] = {false};
    for (int i = 0; i < 2; i++) {
        assert_true(frames_next(f, &a, 20000, NULL));
        assert_int_equal(a.code, 0);
        assert_true(a.id == 10 || a.id == 12);
        answered[a.id == 12] = true;
    }
    assert_true(answered[0] && answered[1]);
    frames_close(f);
}

// The same through librelight: the outcome is the daemon's, not the client's own time-out.
static void test_client_sees_the_daemons_outcome(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_image image;
    struct relight_colors colors;
    uint64_t id[2];
    hold_decoder(true);
    struct relight_light light = {.env = fresh_env()};
    struct relight_image_request picture = {.model = model, .n_light = 1, .lights = &light};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    OK(relight_image_begin(client, &picture, 0, &id[0], &error));
    OK(relight_colors_begin(client, &request, 0.2, &id[1], &error));
    OK(relight_cancel(client, id[0], &error));
    assert_int_equal(relight_image_end(client, id[0], &image, &error), -RELIGHT_E_CANCELLED);
    assert_int_equal(relight_colors_end(client, id[1], &colors, &error), -RELIGHT_E_DEADLINE);
    OK(relight_ping(client, &(double){0}, &error));
    relight_close(client);
}

static void add_view_set(struct frames *f, uint64_t id, uint64_t view, uint64_t sequence,
                         float rotate_deg, uint64_t shown)
{
    Relight__ViewSetRequest m = RELIGHT__VIEW_SET_REQUEST__INIT;
    Relight__ViewState view_state = RELIGHT__VIEW_STATE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[1] = {&light};
    light.env = "constant:0.5,0.5,0.5";
    light.rotate_deg = rotate_deg;
    view_state.n_lights = 1;
    view_state.lights = lights;
    m.view = view;
    m.sequence = sequence;
    m.shown = shown;
    if (sequence) m.state = &view_state;
    frames_add(f, RELIGHT_TYPE_VIEW_SET, id, &m.base, NULL, 0);
}

// Frames of the view until it is silent for 400 ms; *sequence: of the newest.
static unsigned count_frames(struct frames *f, uint64_t view, uint64_t *sequence)
{
    unsigned n = 0;
    struct frames_answer a;
    ProtobufCMessage *message = NULL;
    while (frames_next(f, &a, 400, &message)) {
        assert_int_equal(a.code, 0);
        if (a.id == view) {
            n++;
            *sequence = ((Relight__ViewFrame *)message)->sequence;
        }
        protobuf_c_message_free_unpacked(message, NULL);
    }
    return n;
}

// A client that acknowledges nothing gets as many frames as its window, however many states it
// sends; each frame it acknowledges buys one more, and the last state is drawn in the end.
static void test_a_silent_reader_gets_its_window(void **state)
{
    struct frames *f = frames_open(&d);
    uint64_t sequence = 0;
    unsigned n = 0;
    add_view(f, 10, 0);
    frames_send(f);
    n += count_frames(f, 10, &sequence);
    for (uint64_t i = 1; i <= 6; i++) {
        add_view_set(f, 10 + i, 10, i, 10 * (float)i, 0);
        frames_send(f);
        n += count_frames(f, 10, &sequence);
    }
    print_message("%u frames unacknowledged, window 2\n", n);
    assert_int_equal(n, 2);
    assert_int_equal(sequence, 1);
    add_view_set(f, 30, 10, 0, 0, 1); // has received the first
    frames_send(f);
    assert_int_equal(count_frames(f, 10, &sequence), 1);
    assert_int_equal(sequence, 6);
    frames_close(f);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_unread_answers_are_late),
        cmocka_unit_test_teardown(test_deadlines_of_every_operation, let_decoder_go),
        cmocka_unit_test_teardown(test_cancel_ends_one, let_decoder_go),
        cmocka_unit_test_teardown(test_client_sees_the_daemons_outcome, let_decoder_go),
        cmocka_unit_test_teardown(test_a_silent_reader_gets_its_window, let_decoder_go),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
