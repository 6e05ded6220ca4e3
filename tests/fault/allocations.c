// SPDX-License-Identifier: MIT
// Every allocation of the daemon fails once: at its start, in HELLO, uploads, LOAD, COLORS,
// IMAGE, views and the rest. It answers with an error or closes the connection, and the next
// request of another client is answered as if nothing had been.
#include "faulty_room.h"

#include <arpa/inet.h>
#include <netinet/in.h>

static const char *scratch_name;
static const char *const options[] = {"--http", "127.0.0.1:0", "--room-idle", "0", NULL};

static int setup(void **state)
{
    faults_setup_room(options, "faults");
    return 0;
}

// ---- actions while an allocation fails; each returns 0 or the error's code

typedef int (*act_fn)(struct relight_client *client, unsigned turn,
                      struct relight_error *error);

static int act_hello(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    double seconds;
    return relight_ping(client, &seconds, error);
}

static int act_list(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_list list;
    int status = relight_list(client, true, &list, error);
    if (!status) relight_list_finish(&list);
    return status;
}

static int act_stats(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_stats stats;
    int status = relight_stats(client, &stats, error);
    if (!status) relight_stats_finish(&stats);
    return status;
}

static int act_upload(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    char text[64], hash[65];
    snprintf(text, sizeof text, "file %s %u", scratch_name, turn);
    return relight_upload(client, "some.bin", text, strlen(text), NULL, NULL, hash, NULL,
                          error);
}

static int act_load(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_loaded loaded;
    struct relight_load load = {
        .size_mm = 10 + (float)turn / 64, .material = "marble", .preview = true};
    int status = load_octahedron(client, &d, "o.obj", &load, &loaded, error);
    if (status) return status;
    char id[ID_SIZE];
    snprintf(id, sizeof id, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    return relight_unload(client, id, true, NULL, error);
}

static int act_colors(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_light light = {.env = "constant:1,0.5,0.25", .rotate_deg = (float)turn};
    struct relight_colors_request r = {
        .model = model, .n_light = 1, .lights = &light, .format = RELIGHT_COLOR_RGB9E5};
    struct relight_colors colors;
    int status = relight_colors(client, &r, &colors, error);
    if (!status) relight_colors_finish(&colors);
    return status;
}

static int act_image(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_light light = {.env = "constant", .rotate_deg = 0.5f + (float)turn};
    struct relight_image_request r = {
        .model = model,
        .n_light = 1,
        .lights = &light,
        .picture = {.width = 32 + turn % 7, .height = 24, .format = RELIGHT_IMAGE_PNG}};
    struct relight_image image;
    int status = relight_image(client, &r, &image, error);
    if (!status) relight_image_finish(&image);
    return status;
}

static int act_material(struct relight_client *client, unsigned turn,
                        struct relight_error *error)
{
    char text[200];
    snprintf(text, sizeof text,
             "{\"profile\":\"burley\",\"albedo\":[0.8,0.7,0.6],\"mean_free_path\":[1,1,%g]}",
             1 + turn * 1e-3);
    // The bake of a wavelet transport has a material: this one is parsed and then refused.
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request r = {
        .model = model, .n_light = 1, .lights = &light, .shade = {.material = text}};
    struct relight_colors colors;
    int status = relight_colors(client, &r, &colors, error);
    if (!status) relight_colors_finish(&colors);
    return strstr(error->text, "material") ? 0 : status;
}

// Opened, drawn, changed, drawn again and closed.
static int act_view(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct relight_light light = {.env = "constant", .rotate_deg = 0.25f + (float)turn};
    struct relight_view_request open = {
        .model = model, .n_light = 1, .lights = &light, .colors = true};
    struct relight_view *view;
    struct relight_frame_out frame;
    int status = relight_view_open(client, &open, &view, error);
    if (status) return status;
    status = relight_view_next(view, 5, &frame, error);
    if (!status) relight_frame_out_finish(&frame);
    light.rotate_deg += 0.1f;
    int set = relight_view_set(view, 1, &light, NULL, NULL, NULL, error);
    if (!set && !status && !(set = relight_view_next(view, 5, &frame, error)))
        relight_frame_out_finish(&frame);
    int closed = relight_view_close(view, NULL, NULL, error);
    return status ? status : set ? set : closed;
}

// Edits wait until the room is read: the state that one of them spoils is not for the next.
static int act_room(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    struct frames *f = frames_connect(&d);
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__RoomGetRequest get = RELIGHT__ROOM_GET_REQUEST__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    char *parts[] = {"model"};
    int worst = 0;
    scene.model = model;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 1;
    action.scene = &change;
    get.room = room;
    frames_add_hello(f, "faults");
    for (uint64_t id = 2; id < 5; id++) room_add_edit(f, id, room, &action, "Ann", "", 0);
    frames_add(f, RELIGHT_TYPE_ROOM_GET, 5, &get.base, NULL, 0);
    bool sent = frames_try_send(f);
    for (int n = 0; n < 5 && worst >= 0; n++) {
        struct reply r;
        if (!reply_next(f, 0, 20000, &r, NULL)) fail_msg("%d of 5 answers", n);
        if (r.closed || r.code) worst = r.closed ? -1 : r.code;
        reply_free(&r);
    }
    frames_close(f);
    if (log_says(&d, "is damaged", 0)) fail_msg("without memory a room counts as damaged");
    return sent ? worst : -1;
}

// One request over HTTP, whose answer may be missing: its socket is closed then. The status; an
// answer that is empty is none.
static int ask_http(const char *request)
{
    char text[32 << 10] = "";
    struct sockaddr_in to = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    size_t n = strlen(request);
    to.sin_port = htons((uint16_t)atoi(strrchr(d.http, ':') + 1));
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_true(fd >= 0);
    if (!connect(fd, (struct sockaddr *)&to, sizeof to) &&
        send(fd, request, n, MSG_NOSIGNAL) == (ssize_t)n) {
        struct pollfd p = {fd, POLLIN, 0};
        if (poll(&p, 1, 5000) != 1) fail_msg("neither answered nor closed: %s", request);
        if (recv(fd, text, sizeof text - 1, 0) < 0) text[0] = 0;
    }
    close(fd);
    if (strstr(text, "content-length: 0\r\n"))
        fail_msg("an empty answer to %s: %s", request, text);
    return strncmp(text, "HTTP/1.1 ", 9) ? 0 : atoi(text + 9);
}

static int act_http(struct relight_client *client, unsigned turn, struct relight_error *error)
{
    static const char ask[] = "POST /v1/blobs?name=a.bin HTTP/1.1\r\nHost: localhost\r\n"
                              "Transfer-Encoding: chunked\r\n\r\n5\r\n%05u\r\n0\r\n\r\n";
    char post[400];
    snprintf(post, sizeof post, ask, turn % 8);
    int list = ask_http("GET /v1/models?limit=1 HTTP/1.1\r\nHost: localhost\r\n\r\n");
    int upload = ask_http(post);
    return list == 200 && upload / 100 == 2 ? 0 : 1;
}

static int act_http_json(struct relight_client *client, unsigned turn,
                         struct relight_error *error)
{
    static const char ask[] = "POST /v1/models/%s/colors HTTP/1.1\r\nHost: localhost\r\n"
                              "Content-Type: application/json\r\n";
    static const char body[] = "{\"lights\":[{\"env\":\"constant\"}]}";
    char head[300], whole[600];
    snprintf(head, sizeof head, ask, model);
    snprintf(whole, sizeof whole, "%sContent-Length: %zu\r\n\r\n%s", head, strlen(body), body);
    int plain = ask_http(whole);
    snprintf(whole, sizeof whole, "%sTransfer-Encoding: chunked\r\n\r\n%zx\r\n%s\r\n0\r\n\r\n",
             head, strlen(body), body);
    int chunked = ask_http(whole);
    int health = ask_http("GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n");
    return plain == 200 && chunked == 200 && health == 200 ? 0 : 1;
}

static const struct act {
    const char *name;
    act_fn fn;
    unsigned sampled; // above this many allocations not each fails: JSON has one a value
} acts[] = {{"HELLO and PING", act_hello}, {"LIST", act_list},
            {"STATS", act_stats},          {"an upload", act_upload},
            {"LOAD and UNLOAD", act_load}, {"COLORS", act_colors},
            {"IMAGE", act_image},          {"a material", act_material},
            {"a view", act_view},          {"a room", act_room, 60},
            {"HTTP", act_http, 20},        {"JSON by HTTP", act_http_json, 20}};

static void must_serve(const char *after, int64_t n)
{
    struct relight_error error = {.text = ""};
    must_live(after, n);
    struct relight_client *client = try_connect();
    if (client && !act_colors(client, 7, &error)) {
        relight_close(client);
        return;
    }
    relight_close(client);
    sleep_ms(300);
    must_live(after, n);
    fail_msg("not served after fault %lld in %s: %s", (long long)n, after, error.text);
}

// Raises n until the act is over before its n-th allocation.
static void each_allocation(const struct act *act)
{
    int64_t n = 1, left = 0, n_error = 0;
    scratch_name = act->name;
    for (; n < 2000 && left == 0; n += act->sampled ? 1 + n / act->sampled : 1) {
        struct relight_error error = {.text = ""};
        int64_t failed = faults->n_failed;
        faults->allocation = n;
        struct relight_client *client = try_connect();
        int status = client ? act->fn(client, (unsigned)n, &error) : -1;
        relight_close(client);
        left = faults->n_failed == failed;
        faults_off();
        if (left) assert_int_equal(status, 0);
        n_error += status != 0;
        must_serve(act->name, n);
    }
    print_message("%s: %lld allocations, %lld of them fatal to the request\n", act->name,
                  (long long)n - 2, (long long)n_error);
    assert_true(n > 3 && n < 2000);
}

static void requests(void **state)
{
    for (size_t i = 0; i < sizeof acts / sizeof *acts; i++) each_allocation(&acts[i]);
}

// A start makes some 4,000; the test gives up here.
static const int64_t most_at_start = 20000;

static void at_the_start(void **state)
{
    int64_t n = 1;
    int refused = 0;
    assert_int_equal(daemon_stop(&d), 0);
    for (; n < most_at_start; n += 1 + n / 40) {
        int how = 0;
        int64_t failed = faults->n_failed;
        faults->allocation = n;
        unlink(d.log);
        d.pid = daemon_spawn(&d, NULL);
        bool up = false, gone = false;
        for (int i = 0; i < 2000 && !up && !gone; i++) {
            up = log_says(&d, " start version", 0);
            gone = waitpid(d.pid, &how, WNOHANG) == d.pid;
            sleep_ms(5);
        }
        if (gone) {
            d.pid = 0;
            refused++;
            char *text = read_text(d.log);
            if (!WIFEXITED(how) || !strstr(text, "error"))
                fail_msg("allocation %lld at the start: status %d, log: %s", (long long)n, how,
                         text);
            free(text);
        } else {
            assert_true(up);
            faults_off();
            must_serve("the start", n);
            assert_int_equal(daemon_stop(&d), 0);
        }
        bool over = faults->n_failed == failed;
        faults_off();
        if (over) break;
    }
    print_message("start: %lld allocations, %d starts refused\n", (long long)n, refused);
    assert_true(n > 10 && n < most_at_start);
    daemon_start(&d, NULL);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(requests),
                                       cmocka_unit_test(at_the_start)};
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("allocations", tests, setup, faults_teardown);
}
