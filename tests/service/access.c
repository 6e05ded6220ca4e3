// SPDX-License-Identifier: MIT
// Who may do what: tokens, scopes, quotas, local users, and the delay after wrong tokens.
// Above 600 lines: a list of scenarios, each read alone.
#include "ask.h"
#include "frames.h"

#include <arpa/inet.h>
#include <netinet/in.h>

static struct daemon d;

static int setup(void **state)
{
    daemon_folder(&d);
    return 0;
}

static int teardown(void **state)
{
    daemon_remove(&d);
    return 0;
}

// Each test begins without tokens.
static int after_each(void **state)
{
    if (d.pid) daemon_stop(&d);
    nftw(d.data, remove_one, 16, FTW_DEPTH | FTW_PHYS);
    return 0;
}

static int http_connect(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    a.sin_port = htons((uint16_t)atoi(strrchr(d.http, ':') + 1));
    inet_pton(AF_INET, "127.0.0.1", &a.sin_addr);
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

// The status of a GET; its answer's beginning is in text.
static int get(const char *path, const char *headers, char *text, size_t room)
{
    char ask[1024];
    bool closed;
    int fd = http_connect();
    int n = snprintf(ask, sizeof ask, "GET %s HTTP/1.1\r\nHost: localhost\r\n%s\r\n", path,
                     headers);
    assert_int_equal(write(fd, ask, (size_t)n), n);
    size_t have = raw_read(fd, text, room - 1, 300, &closed);
    text[have] = 0;
    close(fd);
    return have > 12 ? atoi(text + 9) : 0;
}

// The token of --token-file in HTTP: as a header, as ?token=, and refused with its reason.
static void test_http_takes_tokens(void **state)
{
    char path[128], text[2048];
    snprintf(path, sizeof path, "%s/token", d.folder);
    write_text(path, "open sesame\n");
    const char *const extra[] = {"--http", "127.0.0.1:0", "--token-file", path, NULL};
    daemon_start(&d, extra);
    assert_int_equal(get("/metrics", "", text, sizeof text), 401);
    assert_non_null(strcasestr(text, "www-authenticate: Bearer"));
    assert_non_null(strstr(text, "the token is missing"));
    assert_int_equal(get("/metrics?token=open%20sesame", "", text, sizeof text), 200);
    assert_int_equal(get("/metrics?token=open", "", text, sizeof text), 401);
    assert_non_null(strstr(text, "the token is wrong"));
    assert_int_equal(
        get("/metrics", "Authorization: Bearer open sesame\r\n", text, sizeof text), 200);
    assert_true(log_says(&d, "audit act=refused who=addr:127.0.0.1", 1000));
    assert_false(log_says(&d, "sesame", 0));
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- helpers

static struct sockaddr_in loopback(const char *name)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    a.sin_port = htons((uint16_t)atoi(strrchr(name, ':') + 1));
    return a;
}

// A raw connection to the TCP address, with HELLO sent. *answer: HELLO's.
static struct frames *frames_tcp(const char *token, struct frames_answer *answer)
{
    struct frames *f = calloc(1, sizeof *f);
    struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    struct sockaddr_in a = loopback(d.tcp);
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    assert_non_null(f);
    relight_decoder_init(&f->decoder, &limits);
    f->fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(f->fd, (struct sockaddr *)&a, sizeof a), 0);
    hello.version_min = hello.version_max = RELIGHT_PROTOCOL_VERSION;
    hello.token = (char *)token;
    frames_add(f, RELIGHT_TYPE_HELLO, 1, &hello.base, NULL, 0);
    frames_send(f);
    assert_true(frames_next(f, answer, 5000, NULL));
    return f;
}

static int connect_tcp(const char *token, struct relight_client **out,
                       struct relight_error *error)
{
    char address[80];
    struct relight_options options = {.token = token, .timeout_s = 20};
    snprintf(address, sizeof address, "tcp:%s", d.tcp);
    return relight_connect(address, &options, out, error);
}

static struct relight_client *open_tcp(const char *token)
{
    struct relight_client *client;
    struct relight_error error;
    OK(connect_tcp(token, &client, &error));
    return client;
}

// Creates a token; scopes of at most four words.
static void create(struct relight_client *admin, const char *name, const char *const scopes[],
                   uint64_t lifetime_s, const struct relight_quotas *quotas,
                   char secret[RELIGHT_SECRET])
{
    struct relight_error error;
    struct relight_token_order order = {
        .name = name, .scope = scopes, .lifetime_s = lifetime_s};
    while (scopes[order.n_scope]) order.n_scope++;
    if (quotas) order.quotas = *quotas;
    OK(relight_token_create(admin, &order, secret, &error));
}

static const char *const view[] = {"view", NULL},
                         *const work[] = {"view", "edit", "upload", NULL},
                         *const all[] = {"view", "edit", "upload", "admin", NULL};

// ---- tokens

// A token lives in the store as a hash alone, survives a restart, and goes at once.
static void test_a_token_lives_and_goes(void **state)
{
    const char *const extra[] = {"--http", "127.0.0.1:0", NULL};
    char secret[RELIGHT_SECRET], path[160], bearer[256], text[2048];
    struct relight_client *admin, *client;
    struct relight_error error;
    struct relight_tokens tokens;
    struct stat st;
    uint32_t closed;
    daemon_start(&d, extra);
    admin = client_open(d.address);
    create(admin, "anna", view, 0, NULL, secret);
    snprintf(path, sizeof path, "%s/tokens.json", d.data);
    assert_int_equal(stat(path, &st), 0);
    assert_int_equal(st.st_mode & 0777, 0600);
    char *file = read_text(path);
    assert_non_null(strstr(file, "anna"));
    assert_null(strstr(file, secret + 8));
    free(file);
    assert_false(log_says(&d, secret + 8, 0));
    client = open_tcp(secret);
    assert_string_equal(relight_server(client)->principal, "token:anna");
    assert_int_equal(relight_server(client)->n_scope, 1);
    assert_string_equal(relight_server(client)->scope[0], "view");
    relight_close(client);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);

    daemon_start(&d, extra);
    admin = client_open(d.address);
    client = open_tcp(secret);
    snprintf(bearer, sizeof bearer, "Authorization: Bearer %s\r\n", secret);
    assert_int_equal(get("/metrics", bearer, text, sizeof text), 200);
    OK(relight_token_list(admin, &tokens, &error));
    assert_int_equal(tokens.n_token, 1);
    assert_string_equal(tokens.token[0].name, "anna");
    assert_int_equal(tokens.token[0].connections, 1);
    relight_tokens_finish(&tokens);
    OK(relight_token_revoke(admin, "anna", &closed, &error));
    assert_int_equal(closed, 1);
    double seconds;
    assert_int_not_equal(relight_ping(client, &seconds, &error), 0);
    relight_close(client);
    expect(connect_tcp(secret, &client, &error), RELIGHT_E_FORBIDDEN, &error, "revoked");
    assert_int_equal(get("/metrics", bearer, text, sizeof text), 401);
    expect(relight_token_revoke(admin, "anna", NULL, &error), RELIGHT_E_NOT_FOUND, &error,
           "anna");
    // The last token went: TCP does not become open to all by that, nor by a restart.
    expect(connect_tcp(NULL, &client, &error), RELIGHT_E_FORBIDDEN, &error, "missing");
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, extra);
    expect(connect_tcp(NULL, &client, &error), RELIGHT_E_FORBIDDEN, &error, "missing");
    assert_int_equal(daemon_stop(&d), 0);
}

static bool closes_within(int fd, int ms)
{
    char bytes[4096];
    bool closed;
    raw_read(fd, bytes, sizeof bytes, ms, &closed);
    return closed;
}

// A WebSocket on which HELLO was sent with this token.
static int ws_hello(const char *token)
{
    uint8_t *frame, message[512] = {0x82, 0xfe};
    size_t n;
    char text[1024];
    bool closed;
    static const char ask[] =
        "GET /ws HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: relight.v1\r\n\r\n";
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    struct relight_frame head = {
        .flags = RELIGHT_FRAME_LAST, .type = RELIGHT_TYPE_HELLO, .id = 1};
    hello.version_min = hello.version_max = RELIGHT_PROTOCOL_VERSION;
    hello.token = (char *)token;
    assert_int_equal(relight_frame_pack(&head, &hello.base, 0, 0, &frame, &n), 0);
    int fd = http_connect();
    assert_int_equal(write(fd, ask, sizeof ask - 1), sizeof ask - 1);
    size_t have = raw_read(fd, text, sizeof text - 1, 300, &closed);
    assert_true(have > 12 && !memcmp(text + 9, "101", 3));
    message[2] = (uint8_t)(n >> 8);
    message[3] = (uint8_t)n;
    memcpy(message + 8, frame, n); // the mask is 0
    assert_int_equal(write(fd, message, n + 8), n + 8);
    free(frame);
    return fd;
}

// A revoked token's connections close within a second: idle, with an open view, and on
// WebSocket; another token's stay.
static void test_revoked_connections_close(void **state)
{
    const char *const extra[] = {"--http", "127.0.0.1:0", NULL};
    char secret[RELIGHT_SECRET], other[RELIGHT_SECRET];
    struct frames_answer a;
    struct relight_error error;
    uint32_t closed;
    daemon_start(&d, extra);
    struct relight_client *admin = client_open(d.address);
    create(admin, "anna", work, 0, NULL, secret);
    create(admin, "ben", view, 0, NULL, other);
    struct frames *idle = frames_tcp(secret, &a), *busy = frames_tcp(secret, &a);
    struct frames *stays = frames_tcp(other, &a);
    assert_int_equal(a.code, 0);
    int web = ws_hello(secret);
    Relight__SubscribeRequest subscribe = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    frames_add(busy, RELIGHT_TYPE_SUBSCRIBE, 2, &subscribe.base, NULL, 0);
    frames_send(busy);
    assert_true(frames_next(busy, &a, 2000, NULL));
    OK(relight_token_revoke(admin, "anna", &closed, &error));
    assert_int_equal(closed, 3);
    assert_true(frames_next(idle, &a, 1000, NULL)); // its reason
    assert_int_equal(a.code, RELIGHT_E_FORBIDDEN);
    assert_int_equal(a.id, 0);
    assert_true(closes_within(idle->fd, 1000));
    assert_true(closes_within(busy->fd, 1000));
    assert_true(closes_within(web, 1000));
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    frames_add(stays, RELIGHT_TYPE_PING, 9, &ping.base, NULL, 0);
    frames_send(stays);
    assert_int_equal(frames_wait(stays, 9).code, 0);
    frames_close(idle);
    frames_close(busy);
    frames_close(stays);
    close(web);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// HTTP has the rules of the frames: the scope that is missing is named, and a stream of events
// ends with its token.
static void test_http_api(void **state)
{
    const char *const extra[] = {"--http", "127.0.0.1:0", NULL};
    char secret[RELIGHT_SECRET], ask[512], text[4096], bearer[256];
    struct relight_error error;
    struct relight_loaded loaded;
    bool closed;
    daemon_start(&d, extra);
    struct relight_client *admin = client_open(d.address);
    create(admin, "viewer", view, 0, NULL, secret);
    snprintf(bearer, sizeof bearer, "Authorization: Bearer %s\r\n", secret);
    assert_int_equal(get("/v1/models", "", text, sizeof text), 401);
    assert_int_equal(get("/v1/models", bearer, text, sizeof text), 200);
    int fd = http_connect();
    int n = snprintf(ask, sizeof ask,
                     "POST /v1/blobs HTTP/1.1\r\nHost: localhost\r\n%sContent-Length: 4\r\n\r\n"
                     "blob",
                     bearer);
    assert_int_equal(write(fd, ask, (size_t)n), n);
    text[raw_read(fd, text, sizeof text - 1, 500, &closed)] = 0;
    assert_non_null(strstr(text, " 403 "));
    assert_non_null(strstr(text, "needs the scope upload"));
    close(fd);
    OK(load_small(admin, &d, "long.obj", 5, 2000000, &loaded, &error)); // a bake of minutes
    fd = http_connect();
    n = snprintf(ask, sizeof ask,
                 "GET /v1/jobs/%s/events?token=%s HTTP/1.1\r\nHost: localhost\r\n\r\n",
                 loaded.job, secret);
    assert_int_equal(write(fd, ask, (size_t)n), n);
    text[raw_read(fd, text, sizeof text - 1, 500, &closed)] = 0;
    assert_non_null(strstr(text, "text/event-stream"));
    assert_false(closed);
    OK(relight_token_revoke(admin, "viewer", NULL, &error));
    assert_true(closes_within(fd, 1000));
    close(fd);
    OK(relight_cancel_job(admin, loaded.job, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_expired_token(void **state)
{
    char secret[RELIGHT_SECRET];
    struct frames_answer a;
    struct relight_client *client;
    struct relight_error error;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    create(admin, "brief", view, 2, NULL, secret);
    struct frames *f = frames_tcp(secret, &a);
    assert_int_equal(a.code, 0);
    assert_true(frames_next(f, &a, 4000, NULL));
    assert_int_equal(a.code, RELIGHT_E_FORBIDDEN);
    assert_true(closes_within(f->fd, 1000));
    frames_close(f);
    for (int i = 0; i < 8; i++) // no guess: it delays nobody
        expect(connect_tcp(secret, &client, &error), RELIGHT_E_FORBIDDEN, &error, "expired");
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// Names are unique and harmless; what is missing or unknown is said.
static void test_orders_that_are_refused(void **state)
{
    char secret[RELIGHT_SECRET];
    struct relight_error error;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    create(admin, "carl", all, 0, NULL, secret);
    static const char *const unknown[] = {"see"}, *const one[] = {"view"};
    const struct {
        struct relight_token_order order;
        int code;
        const char *word;
    } bad[] = {
        {{.name = "carl", .scope = one, .n_scope = 1}, RELIGHT_E_BAD_REQUEST, "exists"},
        {{.name = "default", .scope = one, .n_scope = 1}, RELIGHT_E_OUT_OF_RANGE, "token-file"},
        {{.name = "../x", .scope = one, .n_scope = 1}, RELIGHT_E_OUT_OF_RANGE, "letters"},
        {{.name = "", .scope = one, .n_scope = 1}, RELIGHT_E_OUT_OF_RANGE, "letters"},
        {{.name = "x", .scope = unknown, .n_scope = 1}, RELIGHT_E_OUT_OF_RANGE, "scopes"},
        {{.name = "x"}, RELIGHT_E_OUT_OF_RANGE, "scopes"},
        {{.name = "x", .scope = one, .n_scope = 1, .lifetime_s = UINT64_MAX},
         RELIGHT_E_OUT_OF_RANGE,
         "lifetime_s"},
        {{.name = "x", .scope = one, .n_scope = 1, .quotas = {.rate = -1}},
         RELIGHT_E_OUT_OF_RANGE,
         "rate"},
        {{.name = "x", .scope = one, .n_scope = 1, .quotas = {.disk = UINT64_MAX}},
         RELIGHT_E_OUT_OF_RANGE,
         "quota"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        expect(relight_token_create(admin, &bad[i].order, secret, &error), bad[i].code, &error,
               bad[i].word);
    static const char *const administer[] = {"admin", NULL};
    create(admin, "dora", administer, 0, NULL, secret);
    struct relight_client *dora = open_tcp(secret);
    struct relight_token_order more = {.name = "x", .scope = one, .n_scope = 1};
    expect(relight_token_create(dora, &more, secret, &error), RELIGHT_E_FORBIDDEN, &error,
           "view");
    relight_close(dora);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// A damaged store is refused: an empty one might open the daemon to all.
static void test_damaged_store(void **state)
{
    char path[160];
    int how;
    snprintf(path, sizeof path, "%s/tokens.json", d.data);
    mkdir(d.data, 0700);
    write_text(path, "{\"tokens\":[{\"name\":\"anna\"");
    unlink(d.log);
    pid_t pid = daemon_spawn(&d, NULL);
    assert_int_equal(waitpid(pid, &how, 0), pid);
    assert_true(WIFEXITED(how) && WEXITSTATUS(how) == 1);
    assert_true(log_says(&d, "tokens.json", 1000));
}

// ---- scopes and owners

static void test_scopes(void **state)
{
    char secret[RELIGHT_SECRET];
    struct relight_client *admin, *viewer;
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_tokens tokens;
    daemon_start(&d, NULL);
    admin = client_open(d.address);
    char id[ID_SIZE];
    bake_small(admin, &d, id);
    create(admin, "viewer", view, 0, NULL, secret);
    viewer = open_tcp(secret);
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request colors = {.model = id, .lights = &light, .n_light = 1};
    float rgb[N_COLOR];
    OK(ask_colors(viewer, &colors, rgb, NULL, &error));
    expect(load_small(viewer, &d, "new.obj", 7, 100, &loaded, &error), RELIGHT_E_FORBIDDEN,
           &error, "upload");
    float p[3] = {0};
    expect(relight_update_vertices(viewer, id, 0, 1, p, NULL, false, NULL, &error),
           RELIGHT_E_FORBIDDEN, &error, "edit");
    expect(relight_unload(viewer, id, true, NULL, &error), RELIGHT_E_FORBIDDEN, &error, "edit");
    expect(relight_token_list(viewer, &tokens, &error), RELIGHT_E_FORBIDDEN, &error, "admin");
    OK(ask_colors(viewer, &colors, rgb, NULL, &error)); // the connection is fine
    assert_true(log_says(&d, "audit act=refused who=token:viewer", 1000));
    relight_close(viewer);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// Without admin nobody unloads, pins or cancels what another principal made.
static void test_owners(void **state)
{
    char anna_secret[RELIGHT_SECRET], ben_secret[RELIGHT_SECRET];
    struct relight_error error;
    struct relight_loaded loaded, again;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    create(admin, "anna", work, 0, NULL, anna_secret);
    create(admin, "ben", work, 0, NULL, ben_secret);
    struct relight_client *anna = open_tcp(anna_secret), *ben = open_tcp(ben_secret);
    OK(load_small(anna, &d, "anna.obj", 3, 2000000, &loaded, &error)); // a bake of minutes
    expect(relight_unload(ben, loaded.model, false, NULL, &error), RELIGHT_E_FORBIDDEN, &error,
           "another client");
    expect(relight_unload(ben, loaded.model, true, NULL, &error), RELIGHT_E_FORBIDDEN, &error,
           "another client");
    expect(relight_cancel_job(ben, loaded.job, NULL, &error), RELIGHT_E_FORBIDDEN, &error,
           "another client");
    struct relight_load pin = small_bake(3, 2000000);
    pin.pin = true;
    expect(load_octahedron(ben, &d, "anna.obj", &pin, &again, &error), RELIGHT_E_FORBIDDEN,
           &error, "another client");
    OK(load_octahedron(anna, &d, "anna.obj", &pin, &again, &error));
    relight_loaded_finish(&again);
    OK(relight_cancel_job(anna, loaded.job, NULL, &error));
    assert_true(log_says(&d, "audit act=cancel-job who=token:anna", 1000));
    OK(relight_unload(admin, loaded.model, true, NULL, &error));
    assert_true(log_says(&d, "audit act=unload who=uid:", 1000));
    relight_loaded_finish(&loaded);
    // A bake belongs to the client that ordered it, whoever loaded the model first.
    struct relight_load bake = small_bake(4, 2000000), preview = bake;
    preview.preview = true;
    OK(load_octahedron(anna, &d, "shared.obj", &preview, &loaded, &error));
    relight_loaded_finish(&loaded);
    OK(load_octahedron(ben, &d, "shared.obj", &bake, &loaded, &error));
    expect(relight_cancel_job(anna, loaded.job, NULL, &error), RELIGHT_E_FORBIDDEN, &error,
           "another client");
    OK(relight_cancel_job(ben, loaded.job, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(ben);
    relight_close(anna);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- quotas

static void test_quotas(void **state)
{
    char secret[RELIGHT_SECRET], other[RELIGHT_SECRET];
    struct relight_error error;
    struct relight_loaded loaded;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address), *more;
    struct relight_quotas quotas = {
        .models = 1, .connections = 2, .disk = 1 << 20, .views = 1, .bakes = 1};
    create(admin, "small", work, 0, &quotas, secret);
    create(admin, "other", work, 0, NULL, other);
    struct relight_client *a = open_tcp(secret), *b = open_tcp(secret);
    expect(connect_tcp(secret, &more, &error), RELIGHT_E_BUSY, &error, "quota");
    relight_close(open_tcp(other)); // the address holds none of them
    struct relight_load load = small_bake(1, 100);
    load.preview = true;
    OK(load_octahedron(a, &d, "one.obj", &load, &loaded, &error));
    relight_loaded_finish(&loaded);
    load.pin = true;
    load.bake.seed = 2;
    load.size_mm = 11;
    OK(load_octahedron(b, &d, "two.obj", &load, &loaded, &error)); // the preview makes room
    relight_loaded_finish(&loaded);
    load.size_mm = 12;
    expect(load_octahedron(b, &d, "three.obj", &load, &loaded, &error), RELIGHT_E_LIMIT, &error,
           "quota");
    struct frames_answer answer;
    relight_close(a);
    struct frames *f = frames_tcp(secret, &answer);
    Relight__SubscribeRequest subscribe = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 2, &subscribe.base, NULL, 0);
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 3, &subscribe.base, NULL, 0);
    frames_send(f);
    answer = frames_wait(f, 3);
    assert_int_equal(answer.code, RELIGHT_E_BUSY);
    assert_non_null(strstr(answer.text, "quota"));
    frames_close(f);
    static char big[2 << 20];
    char hash[65];
    expect(relight_upload(b, "big.bin", big, sizeof big, NULL, NULL, hash, NULL, &error),
           RELIGHT_E_LIMIT, &error, NULL);
    relight_close(b);
    relight_close(open_tcp(secret)); // its places are free again
    // Nor does the address keep the places of connections that named a token.
    double held = 0;
    for (int i = 0; i < 500 && held != 1; i++) {
        held = metric(admin, "relightd_resource_held{resource=\"connections\"}");
        if (held != 1) sleep_ms(20);
    }
    assert_true(held == 1);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// A token of a name that was used before has its own quotas, though the earlier one's uploads
// are there still.
static void test_quotas_of_a_name_used_again(void **state)
{
    char secret[RELIGHT_SECRET], hash[65];
    static char big[2 << 20];
    struct relight_error error;
    struct relight_client *client;
    const struct relight_quotas quotas = {.disk = 1 << 20, .connections = 1};
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    create(admin, "again", work, 0, NULL, secret);
    client = open_tcp(secret);
    OK(relight_upload(client, "small.bin", "small", 5, NULL, NULL, hash, NULL, &error));
    relight_close(client);
    OK(relight_token_revoke(admin, "again", NULL, &error));
    create(admin, "again", work, 0, &quotas, secret);
    client = open_tcp(secret);
    expect(relight_upload(client, "big.bin", big, sizeof big, NULL, NULL, hash, NULL, &error),
           RELIGHT_E_LIMIT, &error, "quota");
    struct relight_client *more;
    expect(connect_tcp(secret, &more, &error), RELIGHT_E_BUSY, &error, "quota");
    relight_close(client);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// TOKEN_LIST shows the quotas, scopes and end that TOKEN_CREATE gave, also after a restart.
static void test_quotas_are_listed(void **state)
{
    char secret[RELIGHT_SECRET];
    struct relight_error error;
    struct relight_tokens tokens;
    const struct relight_quotas quotas = {.rate = 1.5,
                                          .connections = 2,
                                          .requests = 3,
                                          .views = 4,
                                          .memory = 5 << 20,
                                          .output = 6 << 20,
                                          .bakes = 7,
                                          .uploads = 8,
                                          .models = 9,
                                          .disk = 10 << 20};
    for (int round = 0; round < 2; round++) {
        daemon_start(&d, NULL);
        struct relight_client *admin = client_open(d.address);
        if (!round) create(admin, "small", work, 1000, &quotas, secret);
        OK(relight_token_list(admin, &tokens, &error));
        assert_int_equal(tokens.n_token, 1);
        const struct relight_token *t = &tokens.token[0];
        assert_memory_equal(&t->quotas, &quotas, sizeof quotas);
        assert_int_equal(t->expires_s - t->created_s, 1000);
        assert_int_equal(t->n_scope, 3);
        assert_int_equal(strncmp(t->by, "uid:", 4), 0);
        assert_int_equal(t->connections, 0);
        struct relight_client *client = open_tcp(secret); // which HELLO tells the same
        assert_int_equal(relight_server(client)->expires_s, t->expires_s);
        relight_close(client);
        relight_tokens_finish(&tokens);
        relight_close(admin);
        assert_int_equal(daemon_stop(&d), 0);
    }
}

// Bakes that wait or run, and bytes that requests hold.
static void test_bakes_and_memory(void **state)
{
    char secret[RELIGHT_SECRET], other[RELIGHT_SECRET];
    static float cube[6 * 64 * 64 * 3];
    struct relight_error error;
    struct relight_loaded loaded, more;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    struct relight_quotas quotas = {.bakes = 1, .memory = 64 << 10};
    create(admin, "small", work, 0, &quotas, secret);
    create(admin, "other", work, 0, NULL, other);
    struct relight_client *a = open_tcp(secret), *b = open_tcp(other);
    OK(load_small(a, &d, "one.obj", 1, 2000000, &loaded, &error)); // a bake of minutes
    expect(load_small(a, &d, "two.obj", 2, 2000000, &more, &error), RELIGHT_E_BUSY, &error,
           "quota");
    OK(load_small(b, &d, "two.obj", 3, 2000000, &more, &error)); // another's is its own
    OK(relight_cancel_job(b, more.job, NULL, &error));
    relight_loaded_finish(&more);
    OK(relight_cancel_job(a, loaded.job, NULL, &error));
    relight_loaded_finish(&loaded);
    for (size_t i = 0; i < sizeof cube / sizeof *cube; i++) cube[i] = 1;
    struct relight_light light = {.cube = cube, .cube_n = 64};
    struct relight_colors_request request = {.model = "none", .n_light = 1, .lights = &light};
    struct relight_colors colors;
    expect(relight_colors(a, &request, &colors, &error), RELIGHT_E_LIMIT, &error, "quota");
    expect(relight_colors(b, &request, &colors, &error), RELIGHT_E_NOT_FOUND, &error, NULL);
    relight_close(a);
    relight_close(b);
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// Requests a second: BUSY says truly when the next one passes; PING always does.
static void test_rate(void **state)
{
    char secret[RELIGHT_SECRET];
    struct relight_error error;
    struct relight_model info;
    double seconds;
    const char *const extra[] = {"--http", "127.0.0.1:0", NULL};
    char bearer[256], text[2048];
    daemon_start(&d, extra);
    struct relight_client *admin = client_open(d.address);
    struct relight_quotas quotas = {.rate = 2};
    create(admin, "slow", work, 0, &quotas, secret);
    struct relight_client *client = open_tcp(secret);
    int n = 0, status;
    while ((status = relight_info(client, "none", &info, &error)) == -RELIGHT_E_NOT_FOUND)
        assert_true(++n < 50);
    assert_int_equal(status, -RELIGHT_E_BUSY);
    assert_true(n >= 10); // what may come at once
    assert_true(error.retry_after_ms > 0 && error.retry_after_ms <= 500);
    OK(relight_ping(client, &seconds, &error));
    // A new connection has no new allowance.
    struct relight_client *next = open_tcp(secret);
    while ((status = relight_info(next, "none", &info, &error)) == -RELIGHT_E_NOT_FOUND)
        assert_true(++n < 50);
    assert_int_equal(status, -RELIGHT_E_BUSY);
    relight_close(next);
    // Nor has HTTP, which says when to come back.
    snprintf(bearer, sizeof bearer, "Authorization: Bearer %s\r\n", secret);
    for (n = 0; (status = get("/v1/models", bearer, text, sizeof text)) == 200;)
        assert_true(++n < 50);
    assert_int_equal(status, 429);
    assert_non_null(strcasestr(text, "retry-after: 1"));
    assert_int_equal(get("/healthz", bearer, text, sizeof text), 200); // is nobody's request
    sleep_ms((int)error.retry_after_ms);
    assert_int_equal(relight_info(client, "none", &info, &error), -RELIGHT_E_NOT_FOUND);
    relight_close(client);
    // The longest wait is not a short one.
    quotas.rate = 1e-9;
    create(admin, "still", work, 0, &quotas, secret);
    snprintf(bearer, sizeof bearer, "Authorization: Bearer %s\r\n", secret);
    for (n = 0; (status = get("/v1/models", bearer, text, sizeof text)) == 200;)
        assert_true(++n < 50);
    assert_int_equal(status, 429);
    assert_non_null(strcasestr(text, "retry-after: 4294968\r\n"));
    assert_non_null(strstr(text, "\"retry_after_ms\":4294967295"));
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- clients without a token

// The first token closes the door of TCP, also for those who are in.
static void test_first_token(void **state)
{
    char secret[RELIGHT_SECRET];
    struct frames_answer a;
    struct relight_client *client;
    struct relight_error error;
    daemon_start(&d, NULL);
    struct frames *early = frames_tcp("", &a);
    assert_int_equal(a.code, 0);
    struct relight_client *admin = open_tcp(NULL); // loopback: it may create
    assert_int_equal(relight_server(admin)->n_scope, 4);
    create(admin, "first", all, 0, NULL, secret);
    relight_close(admin);
    assert_true(closes_within(early->fd, 1000));
    frames_close(early);
    expect(connect_tcp(NULL, &client, &error), RELIGHT_E_FORBIDDEN, &error, "missing");
    relight_close(open_tcp(secret));
    relight_close(client_open(d.address)); // the unix socket's user needs none
    assert_int_equal(daemon_stop(&d), 0);
    // It is enough to listen beyond loopback.
    const char *const open[] = {"--listen", "tcp:0.0.0.0:0", NULL};
    daemon_start(&d, open);
    assert_false(log_says(&d, "warning listen", 0));
    assert_int_equal(daemon_stop(&d), 0);
}

// Wrong tokens are delayed by address; the right one is not looked at meanwhile, and works
// after retry_after_ms. Local users are not concerned.
static void test_guesses(void **state)
{
    char secret[RELIGHT_SECRET], guess[64];
    struct relight_client *client;
    struct relight_error error;
    daemon_start(&d, NULL);
    struct relight_client *admin = client_open(d.address);
    create(admin, "anna", view, 0, NULL, secret);
    int status, n = 0;
    do snprintf(guess, sizeof guess, "guess-%d", n);
    while ((status = connect_tcp(guess, &client, &error)) == -RELIGHT_E_FORBIDDEN && ++n < 100);
    assert_int_equal(status, -RELIGHT_E_BUSY);
    assert_int_equal(n, 5);
    assert_int_equal(connect_tcp(secret, &client, &error), -RELIGHT_E_BUSY);
    assert_true(error.retry_after_ms > 0 && error.retry_after_ms <= 1000);
    relight_close(client_open(d.address));
    sleep_ms((int)error.retry_after_ms + 1);
    relight_close(open_tcp(secret));
    relight_close(admin);
    assert_int_equal(daemon_stop(&d), 0);
}

// Another user of this machine, on the unix socket: --local-scopes.
static int as_nobody(void)
{
    struct relight_client *client;
    struct relight_error error;
    struct relight_tokens tokens;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request colors = {.model = "none", .lights = &light, .n_light = 1};
    float rgb[N_COLOR];
    if (setgid(65533) || setuid(65534)) return 10; // a principal is a user, no group
    if (relight_connect(d.address, NULL, &client, &error)) return 11;
    if (strcmp(relight_server(client)->principal, "uid:65534")) return 12;
    if (relight_token_list(client, &tokens, &error) != -RELIGHT_E_FORBIDDEN) return 13;
    int status = ask_colors(client, &colors, rgb, NULL, &error);
    relight_close(client);
    return status == -RELIGHT_E_NOT_FOUND ? 0 : status == -RELIGHT_E_FORBIDDEN ? 1 : 14;
}

static void test_local_users(void **state)
{
    if (getuid()) skip(); // it takes root to be another
    static const char *const scopes[] = {"view,edit,upload", "upload"};
    for (int i = 0; i < 2; i++) {
        int how;
        const char *const extra[] = {"--socket-mode", "0666", "--local-scopes", scopes[i],
                                     NULL};
        daemon_start(&d, extra);
        chmod(d.folder, 0711);
        pid_t pid = fork();
        if (!pid) _exit(as_nobody());
        assert_int_equal(waitpid(pid, &how, 0), pid);
        assert_int_equal(WEXITSTATUS(how), i);
        assert_int_equal(daemon_stop(&d), 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_http_takes_tokens, after_each),
        cmocka_unit_test_teardown(test_first_token, after_each),
        cmocka_unit_test_teardown(test_a_token_lives_and_goes, after_each),
        cmocka_unit_test_teardown(test_revoked_connections_close, after_each),
        cmocka_unit_test_teardown(test_http_api, after_each),
        cmocka_unit_test_teardown(test_expired_token, after_each),
        cmocka_unit_test_teardown(test_orders_that_are_refused, after_each),
        cmocka_unit_test_teardown(test_damaged_store, after_each),
        cmocka_unit_test_teardown(test_scopes, after_each),
        cmocka_unit_test_teardown(test_owners, after_each),
        cmocka_unit_test_teardown(test_quotas, after_each),
        cmocka_unit_test_teardown(test_quotas_of_a_name_used_again, after_each),
        cmocka_unit_test_teardown(test_quotas_are_listed, after_each),
        cmocka_unit_test_teardown(test_bakes_and_memory, after_each),
        cmocka_unit_test_teardown(test_rate, after_each),
        cmocka_unit_test_teardown(test_guesses, after_each),
        cmocka_unit_test_teardown(test_local_users, after_each),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("access", tests, setup, teardown);
}
