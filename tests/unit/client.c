// SPDX-License-Identifier: MIT
// librelight against a scripted peer on a unix socket: what a real daemon rarely does on
// purpose: answers in small pieces, out of order, in parts, late, damaged, or not at all.
// Above 600 lines: short cases, each read alone.
#include "frame.h"
#include "relight.pb-c.h"
#include "relight/relight.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <math.h>
#include <poll.h>
#include <pthread.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cmocka.h>

// ---- the peer
// ------------------------------------------------------------------------------------

struct peer;
typedef void (*script_fn)(struct peer *peer);
struct peer {
    int listener, fd;
    char path[108], address[128];
    script_fn script;
    pthread_t thread;
    struct relight_decoder decoder;
    size_t crumb; // bytes a write; 0: whole
    // what the scripts learn
    uint64_t blob_bytes, cancelled;
    unsigned n_cancel, n_ack, deadline_ms;
};

static bool peer_read(struct peer *p)
{
    if (p->decoder.ready) relight_decoder_commit(&p->decoder, 0);
    for (;;) {
        size_t n;
        uint8_t *to = relight_decoder_space(&p->decoder, &n);
        if (!to) return false;
        ssize_t got = recv(p->fd, to, n, 0);
        if (got <= 0) return false;
        int status = relight_decoder_commit(&p->decoder, (size_t)got);
        if (status < 0) return false;
        if (status) return true;
    }
}

static void peer_bytes(struct peer *p, const void *bytes, size_t n)
{
    const char *at = bytes;
    while (n) {
        size_t size = p->crumb && p->crumb < n ? p->crumb : n;
        ssize_t put = send(p->fd, at, size, MSG_NOSIGNAL);
        if (put <= 0) return;
        at += put;
        n -= (size_t)put;
    }
}

static void peer_send(struct peer *p, uint16_t type, uint8_t flags, uint64_t id,
                      const ProtobufCMessage *message, const void *payload, size_t size)
{
    struct relight_frame f = {.type = type, .flags = flags, .id = id, .payload_size = size};
    uint8_t *bytes;
    size_t n;
    if (relight_frame_pack(&f, message, 0, size, &bytes, &n)) abort();
    if (size) memcpy(bytes + n, payload, size);
    peer_bytes(p, bytes, n + size);
    free(bytes);
}

static void peer_answer(struct peer *p, const ProtobufCMessage *message, const void *payload,
                        size_t size)
{
    peer_send(p, p->decoder.frame.type | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST,
              p->decoder.frame.id, message, payload, size);
}

static void peer_pong(struct peer *p)
{
    Relight__PingAnswer pong = RELIGHT__PING_ANSWER__INIT;
    peer_answer(p, &pong.base, NULL, 0);
}

static uint32_t most_in_flight = 64; // that the peer takes

static void peer_hello_of(struct peer *p, uint64_t max_payload)
{
    Relight__HelloAnswer m = RELIGHT__HELLO_ANSWER__INIT;
    static char *presets[] = {"marble"};
    if (!peer_read(p) || p->decoder.frame.type != RELIGHT_TYPE_HELLO) return;
    m.server = "peer";
    m.version = 1;
    m.max_payload = max_payload;
    m.max_in_flight = most_in_flight;
    m.chunk = 1000;
    m.presets = presets;
    m.n_presets = 1;
    peer_answer(p, &m.base, NULL, 0);
}

static void peer_hello(struct peer *p)
{
    peer_hello_of(p, 8 << 20);
}

static void *peer_main(void *arg)
{
    struct peer *p = arg;
    p->fd = accept(p->listener, NULL, NULL);
    struct relight_frame_limits limits = {1 << 16, 16 << 20};
    relight_decoder_init(&p->decoder, &limits);
    p->script(p);
    relight_decoder_finish(&p->decoder);
    close(p->fd);
    return NULL;
}

static void peer_start(struct peer *p, script_fn script, size_t crumb)
{
    *p = (struct peer){.script = script, .crumb = crumb};
    snprintf(p->path, sizeof p->path, "/tmp/relight-test-%ld.sock", (long)getpid());
    snprintf(p->address, sizeof p->address, "unix:%s", p->path);
    unlink(p->path);
    struct sockaddr_un at = {.sun_family = AF_UNIX};
    snprintf(at.sun_path, sizeof at.sun_path, "%.100s", p->path);
    p->listener = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(bind(p->listener, (struct sockaddr *)&at, sizeof at), 0);
    assert_int_equal(listen(p->listener, 4), 0);
    assert_int_equal(pthread_create(&p->thread, NULL, peer_main, p), 0);
}

static struct relight_client *connect_to(struct peer *p, double timeout_s)
{
    struct relight_options options = {.timeout_s = timeout_s};
    struct relight_client *client = NULL;
    struct relight_error error;
    if (relight_connect(p->address, &options, &client, &error)) fail_msg("%s", error.text);
    return client;
}

static void peer_stop(struct peer *p, struct relight_client *client)
{
    relight_close(client);
    pthread_join(p->thread, NULL);
    close(p->listener);
    unlink(p->path);
}

// ---- scripts and tests
// -----------------------------------------------------------------------------

static void pong_script(struct peer *p)
{
    peer_hello(p);
    while (peer_read(p)) peer_pong(p);
}

static void answers_in_small_pieces(void **state)
{
    struct peer p;
    double seconds;
    for (size_t crumb = 1; crumb < 40; crumb += 12) {
        peer_start(&p, pong_script, crumb);
        struct relight_client *client = connect_to(&p, 30);
        assert_string_equal(relight_server(client)->name, "peer");
        assert_string_equal(relight_server(client)->preset[0], "marble");
        for (int i = 0; i < 20; i++) assert_int_equal(relight_ping(client, &seconds, NULL), 0);
        peer_stop(&p, client);
    }
}

// Three requests; answered last to first; n_vertex tells whose answer it is.
static void reverse_script(struct peer *p)
{
    uint64_t id[3];
    peer_hello(p);
    for (int i = 0; i < 3; i++) {
        if (!peer_read(p)) return;
        id[i] = p->decoder.frame.id;
    }
    for (int i = 2; i >= 0; i--) {
        Relight__ColorsAnswer m = RELIGHT__COLORS_ANSWER__INIT;
        float rgb[9] = {(float)i};
        m.n_vertex = (uint32_t)i + 1;
        m.n_plane = 1;
        m.plane_bytes = 12 * m.n_vertex;
        peer_send(p, RELIGHT_TYPE_COLORS | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST, id[i],
                  &m.base, rgb, m.plane_bytes);
    }
    while (peer_read(p)) peer_pong(p);
}

static const struct relight_light sky = {.env = "constant"};

static void answers_out_of_order(void **state)
{
    struct peer p;
    struct relight_error error;
    peer_start(&p, reverse_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    struct relight_colors_request request = {.model = "m", .n_light = 1, .lights = &sky};
    uint64_t id[3];
    for (int i = 0; i < 3; i++)
        assert_int_equal(relight_colors_begin(client, &request, 0, id + i, &error), 0);
    for (int i = 0; i < 3; i++) {
        struct relight_colors colors;
        float rgb[9];
        assert_int_equal(relight_colors_end(client, id[i], &colors, &error), 0);
        assert_int_equal(colors.n_vertex, i + 1);
        assert_int_equal(relight_colors_decode(&colors, 0, rgb), 0);
        assert_true(rgb[0] == (float)i);
        assert_int_equal(relight_colors_decode(&colors, 1, rgb), -RELIGHT_E_ARGUMENT);
        relight_colors_finish(&colors);
    }
    assert_int_equal(relight_colors_end(client, id[0], NULL, &error), -RELIGHT_E_ARGUMENT);
    peer_stop(&p, client);
}

// A picture in three frames, with another request's answer between them.
static void parts_script(struct peer *p)
{
    Relight__ImageAnswer m = RELIGHT__IMAGE_ANSWER__INIT;
    Relight__PingAnswer pong = RELIGHT__PING_ANSWER__INIT;
    uint16_t type = RELIGHT_TYPE_IMAGE | RELIGHT_TYPE_ANSWER;
    peer_hello(p);
    if (!peer_read(p)) return;
    uint64_t id = p->decoder.frame.id;
    if (!peer_read(p)) return;
    m.width = m.height = 10;
    peer_send(p, type, RELIGHT_FRAME_MORE, id, &m.base, "abc", 3);
    peer_send(p, type, RELIGHT_FRAME_MORE, id, NULL, "defg", 4);
    peer_send(p, RELIGHT_TYPE_PING | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST,
              p->decoder.frame.id, &pong.base, NULL, 0);
    peer_send(p, type, RELIGHT_FRAME_LAST, id, NULL, "hi", 2);
    peer_read(p);
}

static void answers_in_frames(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_image image;
    struct relight_image_request request = {.model = "m", .n_light = 1, .lights = &sky};
    uint64_t id;
    double seconds;
    peer_start(&p, parts_script, 5);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_image_begin(client, &request, 0, &id, &error), 0);
    assert_int_equal(relight_ping(client, &seconds, &error), 0);
    assert_int_equal(relight_image_end(client, id, &image, &error), 0);
    assert_int_equal(image.n_byte, 9);
    assert_memory_equal(image.data, "abcdefghi", 9);
    relight_image_finish(&image);
    peer_stop(&p, client);
    // The parts together are held to the client's limit, too.
    struct relight_options options = {.timeout_s = 30, .max_payload = 8};
    peer_start(&p, parts_script, 0);
    assert_int_equal(relight_connect(p.address, &options, &client, &error), 0);
    assert_int_equal(relight_image_begin(client, &request, 0, &id, &error), 0);
    relight_ping(client, &seconds, &error);
    assert_int_equal(relight_image_end(client, id, &image, &error), -RELIGHT_E_PROTOCOL);
    assert_non_null(strstr(error.text, "too large"));
    peer_stop(&p, client);
}

static void error_script(struct peer *p)
{
    Relight__Error m = RELIGHT__ERROR__INIT;
    peer_hello(p);
    m.code = RELIGHT__ERROR_CODE__ERROR_BUSY;
    m.text = "the queue is full";
    m.hint = "wait";
    m.retry_after_ms = 70;
    if (peer_read(p))
        peer_send(p, RELIGHT_TYPE_ERROR, RELIGHT_FRAME_LAST, p->decoder.frame.id, &m.base, NULL,
                  0);
    if (peer_read(p)) peer_pong(p);
    m.code = RELIGHT__ERROR_CODE__ERROR_BAD_FRAME;
    m.text = "that was no frame";
    if (peer_read(p)) peer_send(p, RELIGHT_TYPE_ERROR, RELIGHT_FRAME_LAST, 0, &m.base, NULL, 0);
}

static void errors(void **state)
{
    struct peer p;
    struct relight_error error;
    peer_start(&p, error_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_BUSY);
    assert_int_equal(error.code, RELIGHT_E_BUSY);
    assert_string_equal(error.text, "the queue is full");
    assert_string_equal(error.hint, "wait");
    assert_int_equal(error.retry_after_ms, 70);
    assert_int_equal(relight_ping(client, NULL, &error), 0); // the connection lives on
    // Request id 0 speaks of the connection: everything ends with that error.
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_BAD_FRAME);
    assert_string_equal(error.text, "that was no frame");
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_BAD_FRAME);
    peer_stop(&p, client);
}

// Says nothing to the first request; answers it after the second, when nobody waits any more.
static void late_script(struct peer *p)
{
    Relight__PingAnswer pong = RELIGHT__PING_ANSWER__INIT;
    uint64_t late;
    peer_hello(p);
    if (!peer_read(p)) return;
    late = p->decoder.frame.id;
    p->deadline_ms = p->decoder.frame.deadline_ms;
    if (p->decoder.frame.deadline_ms != 50) return;
    while (peer_read(p)) {
        if (p->decoder.frame.type == RELIGHT_TYPE_CANCEL) {
            Relight__CancelRequest *m =
                (Relight__CancelRequest *)relight_frame_unpack(&p->decoder.frame);
            Relight__CancelAnswer answer = RELIGHT__CANCEL_ANSWER__INIT;
            p->n_cancel++;
            p->cancelled = m->id;
            protobuf_c_message_free_unpacked(&m->base, NULL);
            peer_answer(p, &answer.base, NULL, 0);
            continue;
        }
        peer_send(p, RELIGHT_TYPE_PING | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST, late,
                  &pong.base, NULL, 0);
        peer_pong(p);
    }
}

static void timeouts(void **state)
{
    struct peer p;
    struct relight_error error;
    peer_start(&p, late_script, 0);
    struct relight_client *client = connect_to(&p, 0.05);
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_TIMEOUT);
    assert_int_equal(relight_ping(client, NULL, &error), 0);
    peer_stop(&p, client);
    assert_int_equal(p.deadline_ms, 50);
    assert_int_equal(p.n_cancel, 1);
    assert_int_equal(p.cancelled, 2); // HELLO was 1
}

// A request's own time is its deadline, and the connection's where it names none.
enum { N_TIMED = 6 };
static uint32_t deadlines_ms[N_TIMED];

static void deadlines_script(struct peer *p)
{
    peer_hello(p);
    for (int i = 0; i < N_TIMED && peer_read(p); i++)
        deadlines_ms[i] = p->decoder.frame.deadline_ms;
    while (peer_read(p)) peer_pong(p);
}

static void deadlines(void **state)
{
    static const double own_s[N_TIMED] = {7, 0, 7000, 9, 0, 0.25};
    struct peer p;
    struct relight_error error;
    struct relight_colors_request colors = {.model = "m", .n_light = 1, .lights = &sky};
    struct relight_image_request image = {.model = "m", .n_light = 1, .lights = &sky};
    uint64_t id;
    peer_start(&p, deadlines_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    for (int i = 0; i < 3; i++)
        assert_int_equal(relight_colors_begin(client, &colors, own_s[i], &id, &error), 0);
    for (int i = 3; i < N_TIMED; i++)
        assert_int_equal(relight_image_begin(client, &image, own_s[i], &id, &error), 0);
    assert_int_equal(relight_ping(client, NULL, &error), 0);
    peer_stop(&p, client);
    for (int i = 0; i < N_TIMED; i++)
        assert_int_equal(deadlines_ms[i], own_s[i] > 0 ? own_s[i] * 1e3 : 30000);
}

static void hangup_script(struct peer *p)
{
    peer_hello(p);
    peer_read(p);
}

static void silent_script(struct peer *p)
{
    peer_read(p);
}

static void foreign_script(struct peer *p)
{
    static const char http[] = "HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n";
    peer_bytes(p, http, sizeof http - 1);
    peer_read(p);
}

static void unreachable(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_client *client = NULL;
    assert_int_equal(relight_connect("unix:/nowhere/at/all", NULL, &client, &error),
                     -RELIGHT_E_UNREACHABLE);
    assert_int_equal(relight_connect("tcp:127.0.0.1:1", NULL, &client, &error),
                     -RELIGHT_E_UNREACHABLE);
    assert_int_equal(relight_connect("http://x", NULL, &client, &error), -RELIGHT_E_ARGUMENT);
    assert_int_equal(relight_connect("tcp:127.0.0.1:99999", NULL, &client, &error),
                     -RELIGHT_E_ARGUMENT);
    assert_int_equal(relight_connect("tcp:[::1", NULL, &client, &error), -RELIGHT_E_ARGUMENT);
    static const char *const malformed[] = {
        "tcp:",      "tcp::80",    "tcp:a:",          "tcp:a:8x",
        "tcp:a: 8",  "tcp:a:-1",   "tcp:a:65536",     "tcp:a:000080",
        "tcp:[]:80", "tcp:[::1]x", "tcp:[::1]80",     "tcp:[::1]:",
        "tls:",      "tls::80",    "tls:[::1]:65536", "unix:"};
    for (size_t i = 0; i < sizeof malformed / sizeof *malformed; i++)
        if (relight_connect(malformed[i], NULL, &client, &error) != -RELIGHT_E_ARGUMENT)
            fail_msg("the address \"%s\": %s", malformed[i], error.text);
    static const char *const nobody[] = {"tcp:127.0.0.1:00001", "tcp:[::1]:1",
                                         "tcp:[127.0.0.1]:1"};
    for (size_t i = 0; i < sizeof nobody / sizeof *nobody; i++)
        if (relight_connect(nobody[i], NULL, &client, &error) != -RELIGHT_E_UNREACHABLE)
            fail_msg("the address %s: %s", nobody[i], error.text);
    peer_start(&p, silent_script, 0);
    struct relight_options hurry = {.connect_timeout_s = 0.1};
    assert_int_equal(relight_connect(p.address, &hurry, &client, &error),
                     -RELIGHT_E_UNREACHABLE);
    peer_stop(&p, NULL);
    peer_start(&p, foreign_script, 0);
    assert_int_equal(relight_connect(p.address, NULL, &client, &error), -RELIGHT_E_UNREACHABLE);
    assert_non_null(strstr(error.text, "RLGT"));
    peer_stop(&p, NULL);
    assert_null(client);
    peer_start(&p, hangup_script, 0);
    client = connect_to(&p, 30);
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_DISCONNECTED);
    assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_DISCONNECTED);
    peer_stop(&p, client);
}

// Where positions, normals and triangles are said to begin in 256 bytes: each time one of them
// is wrong. At 64 are indices of vertices that do not exist; of the second, six triangles are
// too many.
static const uint32_t offsets[][3] = {
    {0, 0, 64},    {0, 0, 192}, {4, 0, 128},   {256, 0, 128},
    {320, 0, 128}, {0, 4, 128}, {0, 256, 128}, {0, 320, 128},
    {0, 0, 132},   {0, 0, 256}, {0, 0, 320},   {0, 0, 128}}; // the last is right
enum { N_OFFSETS = sizeof offsets / sizeof *offsets };

// Answers that describe more than they carry, one after the other; the connection survives
// them.
static void lies_script(struct peer *p)
{
    static uint8_t bytes[256];
    Relight__ColorsAnswer c = RELIGHT__COLORS_ANSWER__INIT;
    Relight__GeometryAnswer g = RELIGHT__GEOMETRY_ANSWER__INIT;
    Relight__ImageAnswer m = RELIGHT__IMAGE_ANSWER__INIT;
    peer_hello(p);
    for (int i = 0; i < 6 && peer_read(p); i++) {
        c.n_vertex = i == 1 ? UINT32_MAX : 2;
        c.n_plane = i == 2 ? UINT32_MAX : i == 3 ? 0 : 1;
        c.plane_bytes = i == 2 ? UINT64_MAX / 64 * 64 : i == 5 ? 23 : 24;
        c.format = (Relight__ColorFormat)(i == 4 ? 99 : 0);
        peer_answer(p, &c.base, bytes, i == 0 ? 23 : 24);
    }
    memset(bytes + 64, 0xff, 12);
    for (size_t i = 0; i < N_OFFSETS && peer_read(p); i++) {
        g.n_vertex = 3;
        g.n_triangle = i == 1 ? 6 : 1;
        g.positions_offset = offsets[i][0];
        g.normals_offset = offsets[i][1];
        g.triangles_offset = offsets[i][2];
        peer_answer(p, &g.base, bytes, sizeof bytes);
    }
    m.width = m.height = 100;
    m.format = RELIGHT__IMAGE_FORMAT__IMAGE_RGB8;
    if (peer_read(p)) peer_answer(p, &m.base, bytes, sizeof bytes);
    while (peer_read(p)) peer_pong(p);
}

static void answers_with_wrong_sizes(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_colors colors;
    struct relight_geometry geometry;
    struct relight_image image;
    struct relight_colors_request request = {.model = "m", .n_light = 1, .lights = &sky};
    struct relight_image_request picture = {.model = "m", .n_light = 1, .lights = &sky};
    peer_start(&p, lies_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    for (int i = 0; i < 6; i++)
        assert_int_equal(relight_colors(client, &request, &colors, &error),
                         -RELIGHT_E_PROTOCOL);
    for (size_t i = 0; i + 1 < N_OFFSETS; i++)
        assert_int_equal(relight_geometry(client, "m", false, &geometry, &error),
                         -RELIGHT_E_PROTOCOL);
    assert_int_equal(relight_geometry(client, "m", false, &geometry, &error), 0);
    relight_geometry_finish(&geometry);
    assert_int_equal(relight_image(client, &picture, &image, &error), -RELIGHT_E_PROTOCOL);
    assert_int_equal(relight_ping(client, NULL, &error), 0);
    // A wrong type of answer.
    assert_int_equal(relight_colors(client, &request, &colors, &error), 0 - RELIGHT_E_PROTOCOL);
    peer_stop(&p, client);
}

// Bytes that break framing, or a header that does not parse: the connection is given up.
static const struct {
    const char *bytes;
    size_t n;
} damage[] = {
    {"RLGT\x01\x02\x02\x80\x02\0\0\0\0\0\0\0\x04\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\xff\xff\xff\xff",
     36},
    {"RLGT\x01\x02\x02\x80\x02\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\xff", 32},
    {"RLGT\x01\x02\x02\x80\x02\0\0\0\0\0\0\0\xff\xff\xff\x7f\0\0\0\0\0\0\0\0\0\0\0\0", 32},
    {"RLGT\x01\x02\x02\x00\x02\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", 32},
    {"RLGT\x01\x06\x02\x80\x02\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0", 32},
};
static unsigned damage_at;

static void damage_script(struct peer *p)
{
    peer_hello(p);
    if (peer_read(p)) peer_bytes(p, damage[damage_at].bytes, damage[damage_at].n);
    peer_read(p);
}

static int no_news(void *user, enum relight_room_news news, const char *json)
{
    fail_msg("news of a lost connection: %s", json);
    return 1;
}

static void damaged(void **state)
{
    struct peer p;
    struct relight_error error;
    uint64_t after = 0;
    for (damage_at = 0; damage_at < sizeof damage / sizeof *damage; damage_at++) {
        peer_start(&p, damage_script, 0);
        struct relight_client *client = connect_to(&p, 30);
        assert_int_equal(relight_ping(client, NULL, &error), -RELIGHT_E_PROTOCOL);
        // so do all requests after it
        assert_int_equal(
            relight_room_follow(client, "room", "me", &after, -1, no_news, NULL, &error),
            -RELIGHT_E_PROTOCOL);
        peer_stop(&p, client);
    }
}

// A store of one blob, as PROTOCOL.md has it.
static void store_blob(struct peer *p, uint64_t received)
{
    peer_hello(p);
    while (peer_read(p)) {
        struct relight_frame *f = &p->decoder.frame;
        Relight__PutBlobRequest *m = (Relight__PutBlobRequest *)relight_frame_unpack(f);
        Relight__PutBlobAnswer a = RELIGHT__PUT_BLOB_ANSWER__INIT;
        p->blob_bytes += f->payload_size;
        if (m->offset == received) received += f->payload_size;
        a.received = received;
        a.complete = received == m->size;
        protobuf_c_message_free_unpacked(&m->base, NULL);
        peer_answer(p, &a.base, NULL, 0);
    }
}

static void blob_script(struct peer *p)
{
    store_blob(p, 0);
}

// An earlier connection has sent 4000 bytes.
static void begun_script(struct peer *p)
{
    store_blob(p, 4000);
}

// Has all bytes of an earlier connection, which its check refused: it takes them anew.
static void refused_script(struct peer *p)
{
    uint64_t received = UINT64_MAX;
    peer_hello(p);
    while (peer_read(p)) {
        struct relight_frame *f = &p->decoder.frame;
        Relight__PutBlobRequest *m = (Relight__PutBlobRequest *)relight_frame_unpack(f);
        Relight__PutBlobAnswer a = RELIGHT__PUT_BLOB_ANSWER__INIT;
        p->blob_bytes += f->payload_size;
        if (received == UINT64_MAX) {
            a.received = m->size;
            received = 0;
        } else {
            if (m->offset == received) received += f->payload_size;
            a.received = received;
            a.complete = received == m->size;
        }
        protobuf_c_message_free_unpacked(&m->base, NULL);
        peer_answer(p, &a.base, NULL, 0);
    }
}

static int count_progress(void *user, const struct relight_progress *progress)
{
    ++*(int *)user;
    return 0;
}

static void uploads(void **state)
{
    struct peer p;
    struct relight_error error;
    char bytes[10500], hash[65], again[65];
    uint64_t sent;
    int calls = 0;
    for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (char)(i * 7);
    peer_start(&p, blob_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_upload(client, "x", bytes, sizeof bytes, count_progress, &calls,
                                    hash, &sent, &error),
                     0);
    assert_int_equal(sent, sizeof bytes);
    assert_int_equal(calls, 11); // chunks of 1000
    assert_int_equal(
        relight_upload(client, "x", bytes, sizeof bytes, NULL, NULL, again, &sent, &error), 0);
    assert_int_equal(sent, 0);
    assert_string_equal(hash, again);
    relight_hash(bytes, sizeof bytes, again);
    assert_string_equal(hash, again);
    assert_int_equal(relight_upload(client, "x", bytes, 0, NULL, NULL, again, NULL, &error),
                     -RELIGHT_E_ARGUMENT);
    assert_int_equal(
        relight_upload_file(client, "/nowhere.hdr", NULL, NULL, again, NULL, &error),
        -RELIGHT_E_FILE);
    assert_non_null(strstr(error.text, "/nowhere.hdr"));
    peer_stop(&p, client);
    assert_int_equal(p.blob_bytes, sizeof bytes);
    // An upload goes on where an earlier one ended.
    peer_start(&p, begun_script, 0);
    client = connect_to(&p, 30);
    assert_int_equal(
        relight_upload(client, "x", bytes, sizeof bytes, NULL, NULL, again, &sent, &error), 0);
    assert_int_equal(sent, sizeof bytes - 4000);
    peer_stop(&p, client);
    assert_int_equal(p.blob_bytes, sizeof bytes - 4000);
    // One whose bytes are all there and are not accepted is sent again.
    peer_start(&p, refused_script, 0);
    client = connect_to(&p, 30);
    assert_int_equal(
        relight_upload(client, "x", bytes, sizeof bytes, NULL, NULL, again, &sent, &error), 0);
    assert_int_equal(sent, sizeof bytes);
    peer_stop(&p, client);
    assert_int_equal(p.blob_bytes, sizeof bytes);
}

// Answers a chunk when no more come: how many travelled at once, and the largest.
static uint32_t together;
static uint64_t largest, limit;

static void slow_script(struct peer *p)
{
    uint64_t received = 0, id[16];
    peer_hello_of(p, limit);
    for (bool more = true; more;) {
        Relight__PutBlobAnswer a = RELIGHT__PUT_BLOB_ANSWER__INIT;
        struct pollfd readable = {p->fd, POLLIN, 0};
        uint32_t n = 0;
        bool chunks = false;
        do {
            if (!(more = peer_read(p))) break;
            if (p->decoder.frame.type != RELIGHT_TYPE_PUT_BLOB) {
                peer_pong(p);
                break;
            }
            Relight__PutBlobRequest *m =
                (Relight__PutBlobRequest *)relight_frame_unpack(&p->decoder.frame);
            const uint64_t size = p->decoder.frame.payload_size;
            if (m->offset == received) received += size;
            if (size > largest) largest = size;
            a.complete = received == m->size;
            chunks |= size > 0;
            id[n++] = p->decoder.frame.id;
            protobuf_c_message_free_unpacked(&m->base, NULL);
        } while (n < 16 && poll(&readable, 1, 30) == 1);
        if (chunks && n > together) together = n;
        a.received = received;
        for (uint32_t i = 0; i < n; i++)
            peer_send(p, RELIGHT_TYPE_PUT_BLOB | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST, id[i],
                      &a.base, NULL, 0);
    }
}

static int stop_at_once(void *user, const struct relight_progress *progress)
{
    return 1;
}

// An upload sends chunks of the size, and as many at once, as the server allows. After the
// program stops an upload, the connection serves other requests.
static void upload_limits(void **state)
{
    static const struct {
        uint64_t payload;
        uint32_t in_flight, together, largest;
    } row[] = {{8 << 20, 64, 4, 1000}, {300, 64, 4, 300}, {8 << 20, 1, 1, 1000}, {7, 3, 3, 7}};
    char bytes[6500], hash[65];
    for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (char)(i * 11);
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        const size_t n = row[i].largest < 1000 ? row[i].largest * 9 + 1 : sizeof bytes;
        struct peer p;
        struct relight_error error;
        uint64_t sent;
        together = 0, largest = 0;
        limit = row[i].payload;
        most_in_flight = row[i].in_flight;
        peer_start(&p, slow_script, 0);
        struct relight_client *client = connect_to(&p, 30);
        assert_int_equal(relight_upload(client, "x", bytes, n, NULL, NULL, hash, &sent, &error),
                         0);
        assert_int_equal(sent, n);
        peer_stop(&p, client);
        assert_int_equal(largest, row[i].largest);
        assert_true(together <= row[i].together);
        peer_start(&p, slow_script, 0);
        client = connect_to(&p, 30);
        assert_int_equal(
            relight_upload(client, "x", bytes, n, stop_at_once, NULL, hash, &sent, &error),
            -RELIGHT_E_CANCELLED);
        assert_int_equal(relight_ping(client, NULL, &error), 0);
        peer_stop(&p, client);
    }
    most_in_flight = 64;
}

// What a request for vertices had.
static struct vertex_piece {
    uint32_t first, n;
    uint64_t if_generation, bytes;
    char base[8];
    float position, normal; // the first ones
    bool own_units;
} piece[8];
static unsigned n_piece;

static void keep_piece(const struct relight_frame *f, uint32_t first, uint32_t n,
                       uint64_t if_generation, const char *base, bool own_units)
{
    struct vertex_piece *to = &piece[n_piece++];
    *to = (struct vertex_piece){first, n, if_generation, f->payload_size, "", 0, 0, own_units};
    snprintf(to->base, sizeof to->base, "%s", base);
    memcpy(&to->position, f->payload, sizeof to->position);
    if (f->payload_size == 24 * n) memcpy(&to->normal, f->payload + 12 * n, sizeof to->normal);
}

// Takes at most 100 bytes a request. Its generations count from 40; its poses are p1, p2, and
// so on.
static void vertices_script(struct peer *p)
{
    peer_hello_of(p, 100);
    n_piece = 0;
    while (n_piece < 8 && peer_read(p)) {
        const struct relight_frame *f = &p->decoder.frame;
        ProtobufCMessage *m = relight_frame_unpack(f);
        if (f->type == RELIGHT_TYPE_UPDATE_VERTICES) {
            const Relight__UpdateVerticesRequest *u = (Relight__UpdateVerticesRequest *)m;
            Relight__UpdateVerticesAnswer a = RELIGHT__UPDATE_VERTICES_ANSWER__INIT;
            keep_piece(f, u->first, u->n, u->if_generation, "", u->own_units);
            a.generation = 40 + n_piece;
            peer_answer(p, &a.base, NULL, 0);
        } else {
            const Relight__PutPoseRequest *u = (Relight__PutPoseRequest *)m;
            Relight__PutPoseAnswer a = RELIGHT__PUT_POSE_ANSWER__INIT;
            char name[8];
            keep_piece(f, u->first, u->n, 0, u->base_pose, u->own_units);
            snprintf(name, sizeof name, "p%u", n_piece);
            a.pose = name;
            peer_answer(p, &a.base, NULL, 0);
        }
        protobuf_c_message_free_unpacked(m, NULL);
    }
}

// Vertices that exceed the largest payload go in several requests, each with its own part. A
// later one builds on what the one before it made: its generation, or its pose.
static void vertices_in_pieces(void **state)
{
    enum { N = 10, FIRST = 3 };
    struct peer p;
    struct relight_error error;
    float position[N][3], normal[N][3];
    char pose[65];
    uint64_t generation = 0;
    for (int i = 0; i < N; i++)
        for (int k = 0; k < 3; k++) position[i][k] = (float)i, normal[i][k] = (float)-i;
    for (int kind = 0; kind < 3; kind++) {
        const bool normals = kind != 1;
        const uint32_t each = normals ? 4 : 8, pieces = normals ? 3 : 2;
        const float *n = normals ? normal[0] : NULL;
        peer_start(&p, vertices_script, 0);
        struct relight_client *client = connect_to(&p, 30);
        const int status =
            kind == 2
                ? relight_put_pose(client, "m", "p0", FIRST, N, position[0], n, true, pose,
                                   &error)
                : relight_update_vertices_if(client, "m", kind ? 0 : 40, FIRST, N, position[0],
                                             n, kind == 0, &generation, &error);
        assert_int_equal(status, 0);
        peer_stop(&p, client);
        assert_int_equal(n_piece, pieces);
        for (uint32_t i = 0; i < pieces; i++) {
            const uint32_t count = i + 1 < pieces ? each : N - i * each;
            char base[8];
            snprintf(base, sizeof base, kind == 2 ? "p%u" : "", i);
            assert_int_equal(piece[i].first, FIRST + i * each);
            assert_int_equal(piece[i].n, count);
            assert_int_equal(piece[i].bytes, (normals ? 24 : 12) * count);
            assert_int_equal(piece[i].if_generation, kind ? 0 : 40 + i);
            assert_string_equal(piece[i].base, base);
            assert_int_equal(piece[i].own_units, kind != 1);
            assert_true(piece[i].position == (float)(i * each));
            assert_true(piece[i].normal == (normals ? -(float)(i * each) : 0));
        }
        if (kind == 2) assert_string_equal(pose, "p3");
        else assert_int_equal(generation, 40 + pieces);
    }
}

// How the peer sends a blob of 2500 bytes, in pieces of 1000.
static enum way { WELL, DAMAGED, TOO_MUCH, NOTHING, SHRUNK } way;
static char blob_text[2600];

static void fetch_script(struct peer *p)
{
    enum { SIZE = 2500 };
    char copy[sizeof blob_text];
    memcpy(copy, blob_text, sizeof copy);
    if (way == DAMAGED) copy[SIZE - 1] ^= 1;
    peer_hello(p);
    for (int i = 0; i < 5 && peer_read(p); i++) {
        Relight__GetBlobRequest *r =
            (Relight__GetBlobRequest *)relight_frame_unpack(&p->decoder.frame);
        Relight__GetBlobAnswer a = RELIGHT__GET_BLOB_ANSWER__INIT;
        const uint64_t at = r->offset;
        uint64_t n = at < SIZE ? SIZE - at : 0;
        protobuf_c_message_free_unpacked(&r->base, NULL);
        if (n > 1000) n = 1000;
        else if (way == TOO_MUCH) n++;
        else if (way == NOTHING) n = 0;
        a.size = way == SHRUNK && at ? 1500 : SIZE;
        p->n_ack++;
        peer_answer(p, &a.base, copy + at, n);
    }
    peer_read(p);
}

static int stop_after_two(void *user, const struct relight_progress *progress)
{
    assert_true(progress->fraction == 1000.0 * ++*(int *)user / 2500);
    return *(int *)user == 2;
}

// A file comes in pieces, each from where the one before it ended. Of one that is damaged, too
// long, ends early or was stopped nothing stays.
static void downloads(void **state)
{
    static const int want[] = {0, -RELIGHT_E_HASH, -RELIGHT_E_PROTOCOL, -RELIGHT_E_PROTOCOL,
                               -RELIGHT_E_PROTOCOL};
    struct peer p;
    struct relight_error error;
    struct relight_client *client;
    char hash[65], named[80], path[64];
    uint64_t size = 7;
    int calls = 0;
    for (size_t i = 0; i < sizeof blob_text; i++) blob_text[i] = (char)(i * 13 + i / 256);
    relight_hash(blob_text, 2500, hash);
    snprintf(named, sizeof named, "env:%s", hash);
    snprintf(path, sizeof path, "/tmp/relight-test-%ld.blob", (long)getpid());
    for (int k = SHRUNK; k >= WELL; k--) { // the good one last: it leaves a file
        way = (enum way)k;
        peer_start(&p, fetch_script, 0);
        client = connect_to(&p, 30);
        const int status =
            relight_download(client, k ? hash : named, path, NULL, NULL, &size, &error);
        if (status != want[k]) fail_msg("way %d: status %d, %s", k, status, error.text);
        assert_int_equal(access(path, F_OK), k ? -1 : 0);
        assert_int_equal(size, k ? 7 : 2500);
        peer_stop(&p, client);
        assert_int_equal(p.n_ack, k == SHRUNK ? 2 : 3);
    }
    char got[2600];
    FILE *file = fopen(path, "rb");
    assert_non_null(file);
    assert_int_equal(fread(got, 1, sizeof got, file), 2500);
    fclose(file);
    unlink(path);
    assert_memory_equal(got, blob_text, 2500);
    peer_start(&p, fetch_script, 0);
    client = connect_to(&p, 30);
    assert_int_equal(
        relight_download(client, hash, path, stop_after_two, &calls, &size, &error),
        -RELIGHT_E_CANCELLED);
    assert_int_equal(access(path, F_OK), -1);
    assert_int_equal(relight_download(client, "env:abc", path, NULL, NULL, NULL, &error),
                     -RELIGHT_E_ARGUMENT);
    peer_stop(&p, client);
}

static void *ping_many(void *arg)
{
    intptr_t bad = 0;
    for (int i = 0; i < 200; i++) bad += relight_ping(arg, NULL, NULL) != 0;
    return (void *)bad;
}

static void threads_share_a_client(void **state)
{
    struct peer p;
    pthread_t thread[4];
    peer_start(&p, pong_script, 0);
    struct relight_client *client = connect_to(&p, 10);
    for (int i = 0; i < 4; i++)
        assert_int_equal(pthread_create(thread + i, NULL, ping_many, client), 0);
    for (int i = 0; i < 4; i++) {
        void *bad;
        pthread_join(thread[i], &bad);
        assert_null(bad);
    }
    peer_stop(&p, client);
}

// Answers before it has read the request whole, more than the socket buffers hold: a client
// that only writes while it sends would never finish.
static void flood_script(struct peer *p)
{
    static uint8_t bytes[4 << 20];
    peer_hello(p);
    for (int i = 0; i < 2; i++) {
        Relight__ColorsAnswer m = RELIGHT__COLORS_ANSWER__INIT;
        m.n_vertex = sizeof bytes / 12;
        m.n_plane = 1;
        m.plane_bytes = sizeof bytes;
        // HELLO was 1: the requests are 2 and 3.
        peer_send(p, RELIGHT_TYPE_COLORS | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST,
                  2 + (uint64_t)i, &m.base, bytes, sizeof bytes);
        if (!peer_read(p)) return;
    }
    while (peer_read(p)) peer_pong(p);
}

static void requests_while_answers_arrive(void **state)
{
    struct peer p;
    struct relight_error error;
    float *cube = calloc(6 * 128 * 128 * 3, sizeof *cube);
    struct relight_light lights[4];
    uint64_t id[2];
    for (int i = 0; i < 4; i++) lights[i] = (struct relight_light){.cube_n = 128, .cube = cube};
    struct relight_colors_request request = {.model = "m", .n_light = 4, .lights = lights};
    peer_start(&p, flood_script, 0);
    struct relight_client *client = connect_to(&p, 10);
    for (int i = 0; i < 2; i++)
        assert_int_equal(relight_colors_begin(client, &request, 0, id + i, &error), 0);
    for (int i = 0; i < 2; i++) {
        struct relight_colors colors;
        assert_int_equal(relight_colors_end(client, id[i], &colors, &error), 0);
        assert_int_equal((uintptr_t)colors.data % 64, 0);
        relight_colors_finish(&colors);
    }
    lights[0].cube_n = 20;
    assert_int_equal(relight_colors_begin(client, &request, 0, id, &error),
                     -RELIGHT_E_ARGUMENT);
    peer_stop(&p, client);
    free(cube);
}

static void view_script(struct peer *p)
{
    uint64_t view;
    peer_hello(p);
    if (!peer_read(p)) return;
    view = p->decoder.frame.id;
    for (uint64_t i = 1; i <= 6; i++) {
        Relight__ViewFrame m = RELIGHT__VIEW_FRAME__INIT;
        Relight__ImageAnswer image = RELIGHT__IMAGE_ANSWER__INIT;
        Relight__Error error = RELIGHT__ERROR__INIT;
        char byte = (char)('0' + i);
        m.frame = i;
        image.width = image.height = 8;
        if (i < 6) m.image = &image;
        else m.error = &error;
        error.code = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
        error.text = "eta 9 is outside [1, 3]";
        if (i == 6) { // the client has seen the others
            if (!peer_read(p)) return;
            p->n_ack++;
        }
        peer_send(p, RELIGHT_TYPE_VIEW_OPEN | RELIGHT_TYPE_ANSWER, 0, view, &m.base, &byte, 1);
    }
    while (peer_read(p)) {
        if (p->decoder.frame.type == RELIGHT_TYPE_VIEW_CLOSE) {
            Relight__ViewCloseAnswer a = RELIGHT__VIEW_CLOSE_ANSWER__INIT;
            Relight__ViewFrame m = RELIGHT__VIEW_FRAME__INIT;
            a.frames = 6;
            peer_send(p, RELIGHT_TYPE_VIEW_OPEN | RELIGHT_TYPE_ANSWER, RELIGHT_FRAME_LAST, view,
                      &m.base, NULL, 0);
            peer_answer(p, &a.base, NULL, 0);
        } else {
            p->n_ack++;
        }
    }
}

static void views(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_view *view;
    struct relight_frame_out frame;
    struct relight_view_request request = {.model = "m", .n_light = 1, .lights = &sky};
    uint64_t frames;
    peer_start(&p, view_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_view_open(client, &request, &view, &error), 0);
    // All five have arrived once the last is there; none is lost that is not counted.
    uint64_t told = 0;
    do {
        usleep(200000);
        if (told) relight_frame_out_finish(&frame);
        assert_int_equal(relight_view_next(view, 30, &frame, &error), 0);
        told += 1 + frame.skipped;
        assert_int_equal(frame.frame, told);
    } while (told < 5);
    assert_true(frame.skipped > 0);
    assert_true(frame.has_image);
    assert_memory_equal(frame.image.data, "5", 1);
    relight_frame_out_finish(&frame);
    assert_int_equal(relight_view_next(view, 30, &frame, &error), -RELIGHT_E_OUT_OF_RANGE);
    assert_string_equal(error.text, "eta 9 is outside [1, 3]");
    assert_int_equal(relight_view_next(view, 0.05, &frame, &error), -RELIGHT_E_TIMEOUT);
    assert_int_equal(relight_view_close(view, &frames, NULL, &error), 0);
    assert_int_equal(frames, 6);
    peer_stop(&p, client);
    assert_true(p.n_ack >= 2);
}

static void formats(void **state)
{
    // Every half against its definition.
    for (uint32_t h = 0; h < 65536; h++) {
        uint16_t half = (uint16_t)h;
        float got;
        relight_decode_f16(&half, 1, &got);
        unsigned e = h >> 10 & 31, m = h & 1023;
        double want = e == 31 ? (m ? NAN : INFINITY)
                      : e     ? ldexp(1024 + m, (int)e - 25)
                              : ldexp(m, -24);
        if (h >> 15) want = -want;
        if (isnan(want)) assert_true(isnan(got));
        else assert_true((double)got == want);
    }
    uint32_t packed[3] = {0x81010100, 0, 0xf80001ff};
    float rgb[9], want[9] = {1, .5f, .25f, 0, 0, 0, 65408, 0, 0};
    relight_decode_rgb9e5(packed, 3, rgb);
    assert_memory_equal(rgb, want, sizeof want);
    uint32_t smallest = 1; // 2^-24
    relight_decode_rgb9e5(&smallest, 1, rgb);
    assert_true(rgb[0] == 0x1p-24f);
    uint8_t srgb[8] = {0, 10, 11, 255, 128, 255, 1, 255};
    relight_decode_srgb8(srgb, 2, rgb);
    assert_true(rgb[0] == 0 && rgb[4] == 1);
    assert_true(fabs(rgb[1] - 10 / 255.0 / 12.92) < 1e-7);
    assert_true(fabs(rgb[2] - pow((11 / 255.0 + 0.055) / 1.055, 2.4)) < 1e-7);
    assert_true(fabs(rgb[3] - 0.2158605) < 1e-6);
}

static ProtobufCMessage *kept[2];

static void keep_script(struct peer *p)
{
    peer_hello(p);
    for (int i = 0; i < 2 && peer_read(p); i++)
        kept[i] = relight_frame_unpack(&p->decoder.frame);
    peer_read(p);
}

// A request has the values that its caller set, in every field.
static void fields_of_requests(void **state)
{
    struct peer p;
    struct relight_error error;
    uint64_t id;
    struct relight_shade shade = {.engine = RELIGHT_ENGINE_JOINT,
                                  .term = RELIGHT_TERM_MULTIPLE,
                                  .max_error = .25f,
                                  .budget_ms = 40,
                                  .variant = "waxen"};
    struct relight_colors_request colors = {.model = "m",
                                            .n_light = 1,
                                            .lights = &sky,
                                            .sum = true,
                                            .shade = shade,
                                            .format = RELIGHT_COLOR_RGB9E5,
                                            .exposure_ev = 1.5f,
                                            .priority = RELIGHT_PRIORITY_BULK,
                                            .pose = "bent",
                                            .most_rank = 7,
                                            .phases = true,
                                            .exits = true};
    struct relight_image_request image = {.model = "n",
                                          .n_light = 1,
                                          .lights = &sky,
                                          .shade = shade,
                                          .pose = "straight",
                                          .priority = RELIGHT_PRIORITY_BULK};
    peer_start(&p, keep_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_colors_begin(client, &colors, 0, &id, &error), 0);
    assert_int_equal(relight_image_begin(client, &image, 0, &id, &error), 0);
    peer_stop(&p, client);
    const Relight__ColorsRequest *c = (const Relight__ColorsRequest *)kept[0];
    const Relight__ImageRequest *i = (const Relight__ImageRequest *)kept[1];
    assert_true(c && i);
    assert_string_equal(c->model, "m");
    assert_string_equal(c->pose, "bent");
    assert_true(c->sum && c->phases && c->exits && c->most_rank == 7);
    assert_true(c->exposure_ev == 1.5f);
    assert_int_equal(c->format, RELIGHT__COLOR_FORMAT__COLOR_RGB9E5);
    assert_int_equal(c->priority, RELIGHT__PRIORITY__PRIORITY_BULK);
    assert_string_equal(i->model, "n");
    assert_string_equal(i->pose, "straight");
    assert_int_equal(i->priority, RELIGHT__PRIORITY__PRIORITY_BULK);
    for (int k = 0; k < 2; k++) {
        const Relight__Shade *s = k ? i->shade : c->shade;
        assert_int_equal(s->engine, RELIGHT__ENGINE__ENGINE_JOINT);
        assert_int_equal(s->term, RELIGHT__TERM__TERM_MULTIPLE);
        assert_true(s->max_error == .25f && s->budget_ms == 40);
        assert_string_equal(s->variant, "waxen");
        protobuf_c_message_free_unpacked(kept[k], NULL);
    }
}

// The first frame of a view, and what the client sends then.
static void keep_view_script(struct peer *p)
{
    Relight__ViewFrame m = RELIGHT__VIEW_FRAME__INIT;
    Relight__ImageAnswer image = RELIGHT__IMAGE_ANSWER__INIT;
    peer_hello(p);
    kept[0] = kept[1] = NULL;
    if (!peer_read(p)) return;
    kept[0] = relight_frame_unpack(&p->decoder.frame);
    m.frame = 5;
    image.width = image.height = 8;
    m.image = &image;
    peer_send(p, RELIGHT_TYPE_VIEW_OPEN | RELIGHT_TYPE_ANSWER, 0, p->decoder.frame.id, &m.base,
              "x", 1);
    while (!kept[1] && peer_read(p))
        if (p->decoder.frame.type == RELIGHT_TYPE_VIEW_SET)
            kept[1] = relight_frame_unpack(&p->decoder.frame);
        else p->n_ack++;
    Relight__ViewCloseAnswer closed = RELIGHT__VIEW_CLOSE_ANSWER__INIT;
    if (peer_read(p)) peer_answer(p, &closed.base, NULL, 0);
    peer_read(p);
}

static void expect_vec3(const Relight__Vec3 *v, float x, float y, float z)
{
    assert_true(v && v->x == x && v->y == y && v->z == z);
}

// So has a view, in its options, too. A new state tells the last frame that was shown.
static void fields_of_views(void **state)
{
    static const char *const fields[] = {"picture", "options.window"};
    struct peer p;
    struct relight_error error;
    struct relight_view *view;
    struct relight_frame_out frame;
    uint64_t sequence = 0;
    const struct relight_object_material of_object = {"ear", "wax"};
    struct relight_view_request request = {.model = "m",
                                           .n_light = 1,
                                           .lights = &sky,
                                           .shade = {.material = "jade",
                                                     .n_material = 1,
                                                     .materials = &of_object,
                                                     .has_eye = true,
                                                     .eye = {1, 2, 3},
                                                     .albedo_map = "a",
                                                     .normal_map = "b",
                                                     .bump_map = "c",
                                                     .bump_mm = .75f},
                                           .picture = {.width = 21,
                                                       .height = 22,
                                                       .camera = {.set = true,
                                                                  .eye = {4, 5, 6},
                                                                  .target = {7, 8, 9},
                                                                  .up = {1, 2},
                                                                  .fovy_deg = 31},
                                                       .format = RELIGHT_IMAGE_EXR_FLOAT,
                                                       .quality = 77,
                                                       .tone = RELIGHT_TONE_REINHARD,
                                                       .exposure_ev = -2,
                                                       .plain_background = true,
                                                       .background = {.1f, .2f, .3f},
                                                       .samples = 8,
                                                       .no_specular = true,
                                                       .floor = true,
                                                       .transparent = true},
                                           .color_format = RELIGHT_COLOR_F16,
                                           .color_exposure_ev = .5f,
                                           .max_fps = 23,
                                           .window = 3,
                                           .window_bytes = 24,
                                           .frame_deadline_ms = 25,
                                           .priority = RELIGHT_PRIORITY_STILL,
                                           .skip_equal = true,
                                           .most_rank = 26,
                                           .phases = true,
                                           .exits = true,
                                           .coarse = true,
                                           .pose = "bent"};
    peer_start(&p, keep_view_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_view_open(client, &request, &view, &error), 0);
    assert_int_equal(relight_view_next(view, 30, &frame, &error), 0);
    relight_frame_out_finish(&frame);
    assert_int_equal(relight_view_change(view, &request, 0, NULL, &sequence, &error),
                     -RELIGHT_E_ARGUMENT); // nothing is sent
    assert_string_equal(error.text, "no field is named");
    assert_int_equal(relight_view_change(view, &request, 2, fields, &sequence, &error), 0);
    assert_int_equal(sequence, 1);
    assert_int_equal(relight_view_close(view, NULL, NULL, &error), 0);
    peer_stop(&p, client);
    const Relight__ViewOpenRequest *open = (const Relight__ViewOpenRequest *)kept[0];
    const Relight__ViewSetRequest *set = (const Relight__ViewSetRequest *)kept[1];
    assert_true(open && set);
    assert_string_equal(open->model, "m");
    assert_int_equal(open->priority, RELIGHT__PRIORITY__PRIORITY_STILL);
    assert_int_equal(set->sequence, 1);
    assert_int_equal(set->shown, 5);
    assert_int_equal(set->state->n_fields, 2);
    assert_int_equal(open->state->n_lights, 1);
    assert_int_equal(set->state->n_lights, 0);
    for (int k = 0; k < 2; k++) {
        const Relight__ViewState *m = k ? set->state : open->state;
        const Relight__Picture *i = m->picture;
        const Relight__Shade *s = m->shade;
        const Relight__ViewOptions *o = m->options;
        assert_string_equal(m->pose, "bent");
        assert_true(i->width == 21 && i->height == 22 && i->quality == 77 && i->samples == 8);
        assert_int_equal(i->format, RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT);
        assert_int_equal(i->tone, RELIGHT__TONE__TONE_REINHARD);
        assert_true(i->exposure_ev == -2 && i->plain_background);
        assert_true(i->no_specular && i->floor && i->transparent);
        expect_vec3(i->background, .1f, .2f, .3f);
        expect_vec3(i->camera->eye, 4, 5, 6);
        expect_vec3(i->camera->target, 7, 8, 9);
        expect_vec3(i->camera->up, 1, 2, 0);
        assert_true(i->camera->fovy_deg == 31);
        assert_string_equal(s->material, "jade");
        assert_int_equal(s->n_materials, 1);
        assert_string_equal(s->materials[0]->object, "ear");
        assert_string_equal(s->materials[0]->material, "wax");
        expect_vec3(s->eye, 1, 2, 3);
        assert_string_equal(s->albedo_map, "a");
        assert_string_equal(s->normal_map, "b");
        assert_string_equal(s->bump_map, "c");
        assert_true(s->bump_mm == .75f);
        assert_int_equal(o->color_format, RELIGHT__COLOR_FORMAT__COLOR_F16);
        assert_true(o->color_exposure_ev == .5f && o->max_fps == 23 && o->window == 3);
        assert_true(o->window_bytes == 24 && o->frame_deadline_ms == 25 && o->most_rank == 26);
        assert_true(o->skip_equal && o->phases && o->exits && o->coarse);
        protobuf_c_message_free_unpacked(kept[k], NULL);
    }
}

// Colours of fewer vertices: those of the others are means of their parents. An order of
// another bake, or fewer colours than it has roots, are refused.
static void coarse_colours_are_of_their_order(void **state)
{
    static const uint32_t vertex[] = {4, 0, 2, 1, 3},
                          parent[][2] = {{0, 0}, {0, 0}, {0, 1}, {0, 2}, {2, 3}};
    static const float sent[] = {8, 0, 1, 0, 4, 1, 2, 2, 1}; // of vertices 4, 0, 2
    static const float want[][3] = {
        {0, 4, 1}, {5, 1, 1}, {2, 2, 1}, {3.5f, 1.5f, 1}, {8, 0, 1}};
    struct relight_coarse_order order = {
        .hash = 7, .n_vertex = 5, .n_root = 2, .vertex = vertex, .parent = parent};
    struct relight_colors colors = {.n_vertex = 5,
                                    .n_plane = 1,
                                    .n_coarse = 3,
                                    .coarse_order = 7,
                                    .plane_bytes = sizeof sent,
                                    .format = RELIGHT_COLOR_F32,
                                    .data = sent};
    float out[5][3];
    assert_int_equal(relight_coarse_expand(&order, &colors, 0, out[0]), 0);
    assert_memory_equal(out, want, sizeof want);
    assert_int_equal(relight_coarse_expand(&order, &colors, 1, out[0]), -RELIGHT_E_ARGUMENT);
    colors.coarse_order = 8;
    assert_int_equal(relight_coarse_expand(&order, &colors, 0, out[0]), -RELIGHT_E_MISMATCH);
    colors.coarse_order = 7;
    order.n_root = 4;
    assert_int_equal(relight_coarse_expand(&order, &colors, 0, out[0]), -RELIGHT_E_MISMATCH);
    order.n_root = 2;
    colors.n_vertex = 6;
    assert_int_equal(relight_coarse_expand(&order, &colors, 0, out[0]), -RELIGHT_E_MISMATCH);
}

// Parts of fewer colours: each is as long as the vertices that are there, not as all of them.
static void parts_of_coarse_colours(void **state)
{
    static const float sent[8][3] = {{1, 2, 3}, {4, 5, 6}, {7, 8, 9}, {10, 11, 12}};
    const struct relight_colors colors = {.n_vertex = 5,
                                          .n_plane = 1,
                                          .n_part = 2,
                                          .n_coarse = 2,
                                          .plane_bytes = sizeof sent / 2,
                                          .format = RELIGHT_COLOR_F32,
                                          .data = sent};
    for (uint32_t part = 0; part < 2; part++) {
        float out[2][3] = {{0}};
        assert_int_equal(relight_colors_decode(&colors, part, out[0]), 0);
        assert_memory_equal(out, sent + 2 * part, sizeof out);
    }
}

// Every number of a cost has its own name.
static void cost_script(struct peer *p)
{
    Relight__ColorsAnswer m = RELIGHT__COLORS_ANSWER__INIT;
    Relight__Cost c = RELIGHT__COST__INIT;
    static const float rgb[3];
    c.queue_ms = 1, c.light_ms = 2, c.relight_ms = 3, c.raster_ms = 4;
    c.shade_ms = 5, c.encode_ms = 6, c.total_ms = 7, c.error_bound = 8;
    c.shared = 9, c.samples = 10, c.frames = 11, c.reduced = 12, c.bake_fraction = 13;
    c.engine = RELIGHT__ENGINE__ENGINE_JOINT;
    c.note = "note";
    c.converged = true;
    m.n_vertex = m.n_plane = 1;
    m.plane_bytes = sizeof rgb;
    m.cost = &c;
    peer_hello(p);
    if (peer_read(p)) peer_answer(p, &m.base, rgb, sizeof rgb);
    peer_read(p);
}

static void fields_of_costs(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_colors colors;
    struct relight_colors_request request = {.model = "m", .n_light = 1, .lights = &sky};
    peer_start(&p, cost_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_colors(client, &request, &colors, &error), 0);
    const struct relight_cost *c = &colors.cost;
    assert_true(c->queue_ms == 1 && c->light_ms == 2 && c->relight_ms == 3);
    assert_true(c->raster_ms == 4 && c->shade_ms == 5 && c->encode_ms == 6);
    assert_true(c->total_ms == 7 && c->error_bound == 8 && c->bake_fraction == 13);
    assert_true(c->shared == 9 && c->samples == 10 && c->frames == 11 && c->reduced == 12);
    assert_int_equal(c->engine, RELIGHT_ENGINE_JOINT);
    assert_string_equal(c->note, "note");
    assert_true(c->converged && !c->draft);
    relight_colors_finish(&colors);
    peer_stop(&p, client);
}

// Every field of a surface's look has its own name, and each map its place.
static void look_script(struct peer *p)
{
    static float base[] = {1, 2, 3, 4}, transform[] = {1, 2, 3, 4, 5, 6}, xyz[3];
    Relight__GeometryAnswer m = RELIGHT__GEOMETRY_ANSWER__INIT;
    Relight__Surface s = RELIGHT__SURFACE__INIT, *surfaces[] = {&s};
    Relight__Vec3 emissive = RELIGHT__VEC3__INIT;
    Relight__TextureMap map[5];
    for (uint32_t i = 0; i < 5; i++) {
        relight__texture_map__init(&map[i]);
        map[i].image = i, map[i].uv_set = 10 + i, map[i].filter = 20 + i;
        map[i].wrap_u = 30 + i, map[i].wrap_v = 40 + i, map[i].scale = (float)(50 + i);
        map[i].n_transform = 6, map[i].transform = transform;
    }
    emissive.x = 7, emissive.y = 8, emissive.z = 9;
    s.n_base_color = 4, s.base_color = base;
    s.roughness = 5, s.metallic = 6, s.emissive = &emissive;
    s.base_map = map, s.normal_map = map + 1, s.roughness_map = map + 2;
    s.occlusion_map = map + 3, s.emissive_map = map + 4;
    m.n_vertex = 1;
    m.n_surfaces = 1, m.surfaces = surfaces;
    peer_hello(p);
    if (peer_read(p)) peer_answer(p, &m.base, xyz, sizeof xyz);
    peer_read(p);
}

static void fields_of_looks(void **state)
{
    struct peer p;
    struct relight_error error;
    struct relight_geometry g;
    peer_start(&p, look_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_geometry_textured(client, "m", false, &g, &error), 0);
    assert_int_equal(g.n_look, 1);
    const struct relight_look *l = g.look;
    assert_true(l->base_color[0] == 1 && l->base_color[1] == 2 && l->base_color[2] == 3);
    assert_true(l->base_color[3] == 4 && l->roughness == 5 && l->metallic == 6);
    assert_true(l->emissive[0] == 7 && l->emissive[1] == 8 && l->emissive[2] == 9);
    const struct relight_map *map[] = {&l->base, &l->normal, &l->metallic_roughness,
                                       &l->occlusion, &l->emission};
    for (uint32_t i = 0; i < 5; i++) {
        assert_true(map[i]->present && map[i]->image == i && map[i]->uv_set == 10 + i);
        assert_true(map[i]->filter == 20 + i && map[i]->wrap_u == 30 + i);
        assert_true(map[i]->wrap_v == 40 + i && map[i]->scale == (float)(50 + i));
        for (int k = 0; k < 6; k++) assert_true(map[i]->transform[k] == (float)(k + 1));
    }
    relight_geometry_finish(&g);
    peer_stop(&p, client);
}

// What comes with a textured surface, of 2 vertices and a triangle: where each part begins in
// the payload, whose words count from 0. The first is right; in each other one number is not.
static const struct {
    uint32_t n_uv, uv, color, blocked, corner, size;
    bool fits;
} textured[] = {
    {2, 192, 256, 320, 384, 408, true},  {8, 192, 320, 320, 384, 408, true},
    {0, 0, 0, 0, 0, 140, true},          {2, 192, 256, 320, 384, 407, false},
    {9, 192, 256, 320, 384, 408, false}, {1, 0, 256, 320, 384, 408, false},
    {2, 196, 256, 320, 384, 408, false}, {2, 192, 260, 320, 384, 408, false},
    {2, 192, 256, 328, 384, 408, false}, {2, 192, 256, 320, 376, 408, false},
    {2, 384, 256, 320, 384, 408, false}, {2, 192, 384, 320, 384, 408, false},
    {2, 192, 256, 384, 384, 408, false}, {2, 192, 256, 320, 448, 408, false},
    {2, 448, 256, 320, 384, 408, false}, {2, 192, 448, 320, 384, 408, false},
    {2, 192, 256, 448, 384, 408, false}, {3, 384, 0, 0, 0, 431, false},
    {3, 384, 0, 0, 0, 432, true},
};
enum { N_TEXTURED = sizeof textured / sizeof *textured };

static void textured_script(struct peer *p)
{
    static uint32_t words[128];
    static char *of[2]; // model and image of a request for texels
    Relight__TextureImage info[2], *images[2] = {info, info + 1};
    Relight__GeometryAnswer m = RELIGHT__GEOMETRY_ANSWER__INIT;
    for (uint32_t i = 0; i < 128; i++) words[i] = i;
    words[32] = words[33] = words[34] = 0; // the triangle
    for (uint32_t i = 0; i < 2; i++) {
        relight__texture_image__init(info + i);
        info[i].hash = i ? "other" : "first";
        info[i].width = 10 + i, info[i].height = 20 + i, info[i].bytes = 30 + i;
        info[i].kind = (Relight__TextureKind)i;
    }
    m.n_vertex = 2, m.n_triangle = 1, m.triangles_offset = 128;
    m.normals_offset = 64, m.mm_per_unit = 3, m.generation = 4, m.mesh_hash = "mesh";
    m.n_images = 2, m.images = images, m.texture_split = 5;
    peer_hello(p);
    for (int i = 0; i < N_TEXTURED && peer_read(p); i++) {
        m.n_uv = textured[i].n_uv, m.uv_offset = textured[i].uv;
        m.color_offset = textured[i].color, m.blocked_offset = textured[i].blocked;
        m.corner_uv_offset = textured[i].corner;
        peer_answer(p, &m.base, words, textured[i].size);
    }
    for (int i = 0; i < 3 && peer_read(p); i++) { // texels: too few, too many, 30
        Relight__GeometryRequest *r =
            (Relight__GeometryRequest *)relight_frame_unpack(&p->decoder.frame);
        Relight__GeometryAnswer a = RELIGHT__GEOMETRY_ANSWER__INIT;
        of[0] = r->model, of[1] = r->image;
        if (strcmp(of[0], "m") || strcmp(of[1], "first")) p->n_cancel++;
        protobuf_c_message_free_unpacked(&r->base, NULL);
        peer_answer(p, &a.base, words, i == 0 ? 29 : i == 1 ? 31 : 30);
    }
    peer_read(p);
}

// Each part of a textured surface lies where the daemon says, and within what it sent.
static void parts_of_textured_surfaces(void **state)
{
    struct peer p;
    struct relight_error error;
    uint8_t *texels = NULL;
    peer_start(&p, textured_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    for (int i = 0; i < N_TEXTURED; i++) {
        struct relight_geometry g;
        const int status = relight_geometry_textured(client, "m", false, &g, &error);
        if (status != (textured[i].fits ? 0 : -RELIGHT_E_PROTOCOL))
            fail_msg("row %d: status %d", i, status);
        if (status) continue;
        const uint32_t *uv = (const uint32_t *)g.uv, *color = (const uint32_t *)g.color,
                       *corner = (const uint32_t *)g.corner_uv,
                       *blocked = (const uint32_t *)g.blocked;
        assert_int_equal(g.n_uv, textured[i].n_uv);
        assert_int_equal(uv ? 4 * *uv : 0, textured[i].uv);
        assert_int_equal(color ? 4 * *color : 0, textured[i].color);
        assert_int_equal(blocked ? 4 * *blocked : 0, textured[i].blocked);
        assert_int_equal(corner ? 4 * *corner : 0, textured[i].corner);
        assert_int_equal(*(const uint32_t *)g.position, 0);
        assert_int_equal(*(const uint32_t *)g.normal, 16);
        assert_true(g.mm_per_unit == 3 && g.generation == 4 && g.texture_split == 5);
        assert_string_equal(g.mesh_hash, "mesh");
        assert_int_equal(g.n_image, 2);
        for (uint32_t k = 0; k < 2; k++) {
            assert_string_equal(g.image[k].hash, k ? "other" : "first");
            assert_true(g.image[k].width == 10 + k && g.image[k].height == 20 + k);
            assert_true(g.image[k].bytes == 30 + k && (uint32_t)g.image[k].kind == k);
        }
        relight_geometry_finish(&g);
    }
    const struct relight_image_info first = {.hash = "first", .bytes = 30};
    for (int i = 0; i < 3; i++)
        assert_int_equal(relight_texture(client, "m", &first, &texels, &error),
                         i < 2 ? -RELIGHT_E_PROTOCOL : 0);
    assert_int_equal(((const uint32_t *)texels)[6], 6);
    free(texels);
    peer_stop(&p, client);
    assert_int_equal(p.n_cancel, 0);
}

// Quotas of different numbers, from `first` on.
static struct relight_quotas quotas_from(uint64_t first)
{
    return (struct relight_quotas){.rate = (double)first,
                                   .connections = first + 1,
                                   .requests = first + 2,
                                   .views = first + 3,
                                   .memory = first + 4,
                                   .output = first + 5,
                                   .bakes = first + 6,
                                   .uploads = first + 7,
                                   .models = first + 8,
                                   .disk = first + 9};
}

static char secret_text[RELIGHT_SECRET + 1];

static void tokens_script(struct peer *p)
{
    peer_hello(p);
    for (size_t n = RELIGHT_SECRET; n >= RELIGHT_SECRET - 1 && peer_read(p); n--) {
        Relight__TokenCreateAnswer a = RELIGHT__TOKEN_CREATE_ANSWER__INIT;
        memset(secret_text, 's', n);
        secret_text[n] = 0;
        a.token = secret_text;
        protobuf_c_message_free_unpacked(kept[0], NULL);
        kept[0] = relight_frame_unpack(&p->decoder.frame);
        peer_answer(p, &a.base, NULL, 0);
    }
    if (peer_read(p)) { // one with an empty text
        Relight__TokenCreateAnswer a = RELIGHT__TOKEN_CREATE_ANSWER__INIT;
        peer_answer(p, &a.base, NULL, 0);
    }
    Relight__TokenListAnswer list = RELIGHT__TOKEN_LIST_ANSWER__INIT;
    Relight__TokenInfo info[2], *tokens[2] = {info, info + 1};
    Relight__TokenQuotas q = RELIGHT__TOKEN_QUOTAS__INIT;
    static char *scopes[] = {"view", "edit", "admin"};
    q.rate = 50, q.connections = 51, q.requests = 52, q.views = 53, q.memory = 54;
    q.output = 55, q.bakes = 56, q.uploads = 57, q.models = 58, q.disk = 59;
    for (uint32_t i = 0; i < 2; i++) {
        relight__token_info__init(info + i);
        info[i].name = i ? "ann" : "shop", info[i].by = i ? "root" : "ann";
        info[i].n_scopes = 2 + i, info[i].scopes = scopes;
        info[i].created_s = 70 + i, info[i].expires_s = 80 + i, info[i].connections = 90 + i;
    }
    info[1].quotas = &q;
    list.n_tokens = 2, list.tokens = tokens;
    if (peer_read(p)) peer_answer(p, &list.base, NULL, 0);
    Relight__TokenRevokeAnswer revoked = RELIGHT__TOKEN_REVOKE_ANSWER__INIT;
    revoked.connections = 7;
    for (int i = 0; i < 2; i++)
        if (peer_read(p)) peer_answer(p, &revoked.base, NULL, 0);
    Relight__SignAnswer link = RELIGHT__SIGN_ANSWER__INIT;
    link.url = "/v1/x?sig=y", link.expires_s = 123;
    if (peer_read(p)) {
        kept[1] = relight_frame_unpack(&p->decoder.frame);
        peer_answer(p, &link.base, NULL, 0);
    }
    peer_read(p);
}

// Every number of a token's order, of a list of tokens and of a link has its own name; a text
// that does not fit is no token.
static void fields_of_tokens(void **state)
{
    static const char *const scope[] = {"upload", "view"};
    const struct relight_token_order order = {.name = "shop",
                                              .scope = scope,
                                              .n_scope = 2,
                                              .lifetime_s = 60,
                                              .quotas = quotas_from(30)};
    const struct relight_quotas none = {0}, fifty = quotas_from(50);
    struct peer p;
    struct relight_error error;
    struct relight_tokens tokens;
    struct relight_link link;
    char secret[RELIGHT_SECRET] = "before";
    uint32_t connections = 0;
    kept[0] = kept[1] = NULL;
    peer_start(&p, tokens_script, 0);
    struct relight_client *client = connect_to(&p, 30);
    assert_int_equal(relight_token_create(client, &order, secret, &error), -RELIGHT_E_PROTOCOL);
    assert_string_equal(secret, "before");
    assert_int_equal(relight_token_create(client, &order, secret, &error), 0);
    assert_int_equal(strlen(secret), RELIGHT_SECRET - 1);
    assert_int_equal(relight_token_create(client, &order, secret, &error), -RELIGHT_E_PROTOCOL);
    assert_int_equal(relight_token_list(client, &tokens, &error), 0);
    assert_int_equal(tokens.n_token, 2);
    for (uint32_t i = 0; i < 2; i++) {
        const struct relight_token *t = tokens.token + i;
        assert_string_equal(t->name, i ? "ann" : "shop");
        assert_string_equal(t->by, i ? "root" : "ann");
        assert_int_equal(t->n_scope, 2 + i);
        assert_string_equal(t->scope[1], "edit");
        assert_true(t->created_s == 70 + i && t->expires_s == 80 + i);
        assert_int_equal(t->connections, 90 + i);
        assert_memory_equal(&t->quotas, i ? &fifty : &none, sizeof none);
    }
    relight_tokens_finish(&tokens);
    assert_int_equal(relight_token_revoke(client, "shop", &connections, &error), 0);
    assert_int_equal(connections, 7);
    assert_int_equal(relight_token_revoke(client, "shop", NULL, &error), 0);
    assert_int_equal(relight_sign(client, "/v1/x", 99, &link, &error), 0);
    assert_string_equal(link.url, "/v1/x?sig=y");
    assert_int_equal(link.expires_s, 123);
    relight_link_finish(&link);
    peer_stop(&p, client);
    const Relight__TokenCreateRequest *c = (const Relight__TokenCreateRequest *)kept[0];
    const Relight__SignRequest *s = (const Relight__SignRequest *)kept[1];
    assert_true(c && s && c->quotas);
    assert_string_equal(c->name, "shop");
    assert_int_equal(c->n_scopes, 2);
    assert_string_equal(c->scopes[0], "upload");
    assert_int_equal(c->lifetime_s, 60);
    const Relight__TokenQuotas *q = c->quotas;
    assert_true(q->rate == 30 && q->connections == 31 && q->requests == 32 && q->views == 33);
    assert_true(q->memory == 34 && q->output == 35 && q->bakes == 36 && q->uploads == 37);
    assert_true(q->models == 38 && q->disk == 39);
    assert_string_equal(s->url, "/v1/x");
    assert_int_equal(s->lifetime_s, 99);
    for (int i = 0; i < 2; i++) protobuf_c_message_free_unpacked(kept[i], NULL);
}

static void cameras(void **state)
{
    struct relight_camera c;
    assert_int_equal(relight_camera_parse("0,1,3:0,.5,0", &c, NULL), 0);
    assert_true(c.set && c.eye[2] == 3 && c.target[1] == .5f && c.fovy_deg == 0);
    assert_int_equal(relight_camera_parse("0,1,3:0,0,0:0,0,1:35", &c, NULL), 0);
    assert_true(c.up[2] == 1 && c.fovy_deg == 35);
    assert_int_equal(relight_camera_parse("0,1,3:0,0,0:35", &c, NULL), 0);
    assert_true(c.up[2] == 0 && c.fovy_deg == 35);
    static const char *const bad[] = {"",
                                      "1,2,3",
                                      "1,2:3,4,5",
                                      "1,2,3:4,5,6:",
                                      "1,2,3:4,5,6:170",
                                      "1,2,3:4,5,6:0,1,0:35:1",
                                      "nan,0,0:0,0,0",
                                      "1,2,3:4,5,6x",
                                      "1,2,3:4,5,6:0,1,0:0,1,0",
                                      "1,2,3:4,5,6:35:0,1,0"};
    for (unsigned i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_int_equal(relight_camera_parse(bad[i], &c, NULL), -RELIGHT_E_ARGUMENT);
}

// A format without a line in relight.h could not be asked for.
static void every_image_format_is_in_the_header(void **state)
{
#define COUNT(name, number, ending) +1
    assert_int_equal(0 RELIGHT_IMAGE_FORMAT_LIST(COUNT),
                     relight__image_format__descriptor.n_values);
#undef COUNT
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_image_format_is_in_the_header),
        cmocka_unit_test(answers_in_small_pieces),
        cmocka_unit_test(answers_out_of_order),
        cmocka_unit_test(answers_in_frames),
        cmocka_unit_test(errors),
        cmocka_unit_test(timeouts),
        cmocka_unit_test(deadlines),
        cmocka_unit_test(unreachable),
        cmocka_unit_test(answers_with_wrong_sizes),
        cmocka_unit_test(damaged),
        cmocka_unit_test(uploads),
        cmocka_unit_test(upload_limits),
        cmocka_unit_test(vertices_in_pieces),
        cmocka_unit_test(downloads),
        cmocka_unit_test(threads_share_a_client),
        cmocka_unit_test(requests_while_answers_arrive),
        cmocka_unit_test(views),
        cmocka_unit_test(formats),
        cmocka_unit_test(fields_of_requests),
        cmocka_unit_test(fields_of_views),
        cmocka_unit_test(fields_of_costs),
        cmocka_unit_test(fields_of_looks),
        cmocka_unit_test(parts_of_textured_surfaces),
        cmocka_unit_test(fields_of_tokens),
        cmocka_unit_test(coarse_colours_are_of_their_order),
        cmocka_unit_test(parts_of_coarse_colours),
        cmocka_unit_test(cameras),
    };
    return cmocka_run_group_tests_name("client", tests, NULL, NULL);
}
