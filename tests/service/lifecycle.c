// SPDX-License-Identifier: MIT
// Starting, stopping, coming back, and the HTTP side. Each test has a daemon of its own; they
// share one data folder, so that the octahedron is baked once. Above 600 lines: a list of
// scenarios, each read alone.
#include "daemon.h"

#include <math.h>
#include <netinet/in.h>

static struct daemon d;
static char model[ID_SIZE];

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

static int after_each(void **state)
{
    if (d.pid) kill(d.pid, SIGKILL), waitpid(d.pid, NULL, 0);
    d.pid = 0;
    return 0;
}

static void red_of_first_vertex(struct relight_client *client, float red, float *out)
{
    struct relight_error error;
    struct relight_colors colors;
    char env[40];
    snprintf(env, sizeof env, "constant:%g,1,1", (double)red);
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    OK(relight_colors(client, &request, &colors, &error));
    *out = *(const float *)colors.data;
    relight_colors_finish(&colors);
}

static void test_restart_keeps_the_bake(void **state)
{
    float before, after;
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    red_of_first_vertex(client, 1, &before);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    assert_int_equal(access(d.socket, F_OK), -1); // its socket's file goes with it

    daemon_start(&d, NULL);
    client = client_open(d.address);
    red_of_first_vertex(client, 1, &after); // by its id, without a load
    assert_true(before == after);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "small.obj", 0, 200, &loaded, &error));
    assert_string_equal(loaded.model, model);
    assert_int_equal(loaded.state, RELIGHT_MODEL_READY);
    assert_string_equal(loaded.job, "");
    assert_true(metric(client, "relightd_bakes_total{outcome=\"done\"}") == 0);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static bool is_pinned(struct relight_client *client)
{
    struct relight_model info;
    struct relight_error error;
    OK(relight_info(client, model, &info, &error));
    bool pinned = info.pinned;
    relight_model_finish(&info);
    return pinned;
}

// A pin outlives the daemon, and so does its end.
static void test_restart_keeps_the_pin(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load pin = small_bake(0, 200);
    pin.pin = true;
    for (int unloaded = 0; unloaded < 2; unloaded++) {
        daemon_start(&d, NULL);
        struct relight_client *client = client_open(d.address);
        if (unloaded) {
            assert_true(is_pinned(client));
            OK(relight_unload(client, model, RELIGHT_KEEP_BAKE, NULL, &error));
        } else {
            OK(load_octahedron(client, &d, "small.obj", &pin, &loaded, &error));
            relight_loaded_finish(&loaded);
        }
        assert_true(is_pinned(client) == !unloaded);
        relight_close(client);
        assert_int_equal(daemon_stop(&d), 0);
    }
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    assert_false(is_pinned(client));
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_damaged_bake_is_refused_and_made_anew(void **state)
{
    char path[200];
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, model);
    int fd = open(path, O_RDWR);
    struct stat st;
    assert_true(fd >= 0 && !fstat(fd, &st));
    assert_int_equal(ftruncate(fd, st.st_size / 2), 0);
    close(fd);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_colors colors;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    assert_int_equal(relight_colors(client, &request, &colors, &error), -RELIGHT_E_FORMAT);
    char again[ID_SIZE];
    bake_small(client, &d, again);
    assert_string_equal(again, model);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_sigterm_answers_what_is_open(void **state)
{
    static const char *const extra[] = {"--drain", "60", NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_image image;
    struct relight_light light = {.env = "constant"};
    struct relight_image_request request = {
        .model = model,
        .n_light = 1,
        .lights = &light,
        .picture = {.width = 1600, .height = 1200, .format = RELIGHT_IMAGE_PNG}};
    uint64_t id;
    OK(relight_image_begin(client, &request, 0, &id, &error));
    sleep_ms(30); // it is being worked on
    kill(d.pid, SIGTERM);
    assert_true(log_says(&d, " drain ", 5000));
    OK(relight_image_end(client, id, &image, &error));
    assert_int_equal(image.width, 1600);
    relight_image_finish(&image);
    assert_int_equal(daemon_stop(&d), 0);
    relight_close(client);
}

static void test_sigterm_ends_a_bake(void **state)
{
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    OK(load_small(client, &d, "long.obj", 9, 3000000, &loaded, &error));
    char path[200];
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, loaded.model);
    sleep_ms(300);
    assert_int_equal(daemon_stop(&d), 0);
    assert_true(log_says(&d, "suspended", 0)); // service/resume.c: it goes on
    assert_int_equal(access(path, F_OK), -1);  // nothing half-written
    relight_close(client);

    // Under its id after the start; cancelled, it is gone at the next one.
    daemon_start(&d, NULL);
    client = client_open(d.address);
    assert_true(metric(client, "relightd_jobs_open") == 1);
    OK(relight_cancel_job(client, loaded.job, NULL, &error));
    assert_int_equal(relight_watch(client, loaded.job, NULL, NULL, &error),
                     -RELIGHT_E_CANCELLED);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    assert_true(metric(client, "relightd_jobs_open") == 0);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static int run_second(const char *address, const char *data)
{
    int how = 0;
    struct daemon other = d;
    snprintf(other.address, sizeof other.address, "%s", address);
    snprintf(other.data, sizeof other.data, "%s", data);
    snprintf(other.log, sizeof other.log, "%s/log2", d.folder);
    unlink(other.log);
    pid_t pid = daemon_spawn(&other, NULL);
    for (int i = 0; i < 500 && waitpid(pid, &how, WNOHANG) != pid; i++) sleep_ms(20);
    if (!WIFEXITED(how)) kill(pid, SIGKILL);
    return WIFEXITED(how) ? WEXITSTATUS(how) : -1;
}

static bool second_said(const char *word)
{
    char path[128];
    snprintf(path, sizeof path, "%s/log2", d.folder);
    char *text = read_text(path);
    bool said = strstr(text, word) != NULL;
    free(text);
    return said;
}

static void test_one_daemon_a_socket_and_a_folder(void **state)
{
    char data[128], address[128];
    snprintf(data, sizeof data, "%s/data2", d.folder);
    snprintf(address, sizeof address, "unix:%s/other", d.folder);
    daemon_start(&d, NULL);
    assert_int_equal(run_second(d.address, data), 1);
    assert_true(second_said("another relightd serves this socket"));
    assert_int_equal(run_second(address, d.data), 1);
    assert_true(second_said("another relightd uses it"));
    struct relight_client *client = client_open(d.address); // the first is unharmed
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_socket_of_a_dead_daemon_is_replaced(void **state)
{
    daemon_start(&d, NULL);
    kill(d.pid, SIGKILL);
    waitpid(d.pid, NULL, 0);
    assert_int_equal(access(d.socket, F_OK), 0);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    float red;
    red_of_first_vertex(client, 2, &red); // and its catalogue is read
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Beyond --memory an unused model is unloaded, and comes back when it is asked for.
static void test_memory_budget(void **state)
{
    static const char *const extra[] = {"--memory", "1k", "--cache", "1k", NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    float red[3];
    for (int i = 0; i < 3; i++) red_of_first_vertex(client, (float)i + 1, &red[i]);
    assert_true(red[2] > red[1] && red[1] > red[0]);
    assert_true(metric(client, "relightd_models_evictions_total") >= 1);
    assert_true(metric(client, "relightd_models_bytes") == 0);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Files are removed behind the answers: true when the model is forgotten within five seconds.
static bool comes_to_leave(struct relight_client *client, const char *id)
{
    struct relight_error error;
    struct relight_model info;
    for (int i = 0; i < 250; i++) {
        if (relight_info(client, id, &info, &error)) return error.code == RELIGHT_E_NOT_FOUND;
        relight_model_finish(&info);
        sleep_ms(20);
    }
    return false;
}

// A budget that one bake fills: the one used longest ago goes, the newest and pinned ones stay.
static void test_disk_budget_of_bakes(void **state)
{
    static const char *const extra[] = {"--bakes-disk", "1", NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    struct relight_loaded loaded;
    char path[200], other[ID_SIZE];
    assert_true(comes_to_leave(client, model)); // the maintenance at the start
    bake_small(client, &d, model);              // anew
    OK(load_small(client, &d, "other.obj", 7, 200, &loaded, &error));
    OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    snprintf(other, sizeof other, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    assert_true(comes_to_leave(client, model));
    snprintf(path, sizeof path, "%s/bakes/%s.prt", d.data, model);
    for (int i = 0; i < 250 && !access(path, F_OK); i++) sleep_ms(20);
    assert_int_equal(access(path, F_OK), -1);
    assert_true(metric(client, "relightd_bakes_evicted_total") == 2);
    for (int i = 0; i < 250 && metric(client, "relightd_bakes_bytes") < 1000; i++) sleep_ms(20);
    assert_true(metric(client, "relightd_bakes_bytes") > 1000); // known once it was opened

    struct relight_load load = {.size_mm = 10,
                                .material = "marble",
                                .pin = true,
                                .bake = {.samples = 200, .cube = 16, .single_points = 2}};
    snprintf(path, sizeof path, "%s/small.obj", d.folder);
    OK(relight_load_file(client, path, &load, NULL, NULL, &loaded, &error));
    assert_string_equal(loaded.model, model);
    OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
    assert_true(comes_to_leave(client, other));
    OK(load_small(client, &d, "other.obj", 8, 200, &loaded, &error));
    OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
    OK(relight_info(client, model, &info, &error));
    assert_true(info.pinned);
    relight_model_finish(&info);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A .prt of the models folder is known under its file's name and the one that a load gave it,
// and listed with its facts before anybody opens it.
static void test_names_of_a_file(void **state)
{
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_list list;
    char from[200], to[200];
    snprintf(from, sizeof from, "%s/bakes/%s.prt", d.data, model);
    snprintf(to, sizeof to, "%s/stone.prt", d.models);
    assert_int_equal(link(from, to), 0);
    uint32_t vertices = 0;
    for (int i = 0; i < 3000 && !vertices; i++) {
        OK(relight_list(client, false, &list, &error));
        for (size_t k = 0; k < list.n_model; k++)
            if (!strcmp(list.model[k].name, "stone.prt")) {
                vertices = list.model[k].n_vertex;
                assert_true(!vertices || list.model[k].error_bound > 0);
                assert_int_equal(list.model[k].state, RELIGHT_MODEL_UNLOADED);
            }
        relight_list_finish(&list);
        sleep_ms(20);
    }
    assert_int_equal(vertices, OCTAHEDRON_VERTICES);
    struct relight_load load = {.path = "stone.prt", .name = "pebble"};
    OK(relight_load(client, &load, &loaded, &error));
    static const char *const names[] = {"pebble", "stone.prt", "stone"};
    for (int i = 0; i < 3; i++) {
        struct relight_model info;
        OK(relight_info(client, names[i], &info, &error));
        assert_string_equal(info.id, loaded.model);
        assert_string_equal(info.name, "pebble");
        relight_model_finish(&info);
    }
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    unlink(to);
}

static void test_busy_at_the_limit(void **state)
{
    enum { N = 40 };
    static const char *const extra[] = {"--requests", "4", NULL};
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    uint64_t id[N];
    int n_ok = 0, n_busy = 0;
    for (int i = 0; i < N; i++) {
        char env[40];
        snprintf(env, sizeof env, "constant:%d,3,2", i + 1);
        struct relight_light light = {.env = env};
        struct relight_image_request request = {.model = model,
                                                .n_light = 1,
                                                .lights = &light,
                                                .picture = {.width = 400, .height = 300}};
        OK(relight_image_begin(client, &request, 0, &id[i], &error));
    }
    for (int i = 0; i < N; i++) {
        struct relight_image image;
        int status = relight_image_end(client, id[i], &image, &error);
        if (!status) {
            n_ok++;
            relight_image_finish(&image);
        } else {
            assert_int_equal(status, -RELIGHT_E_BUSY);
            assert_true(error.retry_after_ms > 0);
            n_busy++;
        }
    }
    assert_true(n_ok >= 4 && n_busy >= 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- configuration

static int shell(const char *fmt, ...) __attribute__((format(printf, 1, 2)));
static int shell(const char *fmt, ...)
{
    char command[900];
    va_list args;
    va_start(args, fmt);
    vsnprintf(command, sizeof command, fmt, args);
    va_end(args);
    int how = system(command);
    return WIFEXITED(how) ? WEXITSTATUS(how) : -1;
}

static void test_configuration(void **state)
{
    char path[128];
    snprintf(path, sizeof path, "%s/conf", d.folder);
    // The printed default, with every line switched on, is read back.
    assert_int_equal(shell(PRT_BINARY_DIR
                           "/relightd --print-config | sed 's/^#\\([a-z]\\)/\\1/'"
                           " > %s",
                           path),
                     0);
    char *text = read_text(path);
    assert_non_null(strstr(text, "\nbakes = 1\n"));
    free(text);
    const char *const extra[] = {"--config", path, NULL};
    daemon_start(&d, extra);
    assert_int_equal(daemon_stop(&d), 0);
    write_text(path, "bakes = many\n");
    assert_int_equal(shell(PRT_BINARY_DIR "/relightd --config %s 2> %s/err", path, d.folder),
                     2);
    snprintf(path, sizeof path, "%s/err", d.folder);
    text = read_text(path);
    assert_non_null(strstr(text, "conf:1: bakes: expected a number"));
    free(text);
    // What is behind a zero byte, or beyond a mebibyte, is not passed over in silence.
    assert_int_equal(shell("cd %s; printf 'bakes = 1\\n\\0bakes = x\\n' > conf; " PRT_BINARY_DIR
                           "/relightd --config conf --print-config > out 2> err",
                           d.folder),
                     2);
    text = read_text(path);
    assert_non_null(strstr(text, "conf: not text: it contains a zero byte"));
    free(text);
    assert_int_equal(shell("cd %s; yes '# comment' | head -c 1048577 > conf; " PRT_BINARY_DIR
                           "/relightd --config conf --print-config > out 2> err",
                           d.folder),
                     2);
    text = read_text(path);
    assert_non_null(strstr(text, "conf: longer than 1048576 bytes"));
    free(text);
    assert_int_equal(shell(PRT_BINARY_DIR "/relightd --nonsense 2> /dev/null"), 2);
}

// ---- HTTP

static int http_connect(void)
{
    int port = atoi(strrchr(d.http, ':') + 1), fd = socket(AF_INET, SOCK_STREAM, 0);
    struct sockaddr_in a = {.sin_family = AF_INET,
                            .sin_port = htons((uint16_t)port),
                            .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

static void start_with_http(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t n = sizeof a;
    int fd = socket(AF_INET, SOCK_STREAM, 0);
    assert_int_equal(bind(fd, (struct sockaddr *)&a, sizeof a), 0);
    assert_int_equal(getsockname(fd, (struct sockaddr *)&a, &n), 0);
    close(fd);
    char address[40], page[128], path[160];
    snprintf(address, sizeof address, "127.0.0.1:%d", ntohs(a.sin_port));
    snprintf(page, sizeof page, "%s/page", d.folder);
    mkdir(page, 0700);
    snprintf(path, sizeof path, "%s/index.html", page);
    write_text(path, "<!doctype html><title>page</title>");
    const char *const extra[] = {"--http", address, "--page", page, NULL};
    daemon_start(&d, extra);
    assert_string_equal(d.http, address);
}

static void get_with(const char *path, const char *fields, char *out, size_t n)
{
    char ask[400];
    bool closed;
    int fd = http_connect();
    snprintf(ask, sizeof ask,
             "GET %s HTTP/1.1\r\nHost: localhost\r\n%sConnection: close\r\n\r\n", path, fields);
    assert_true(write(fd, ask, strlen(ask)) > 0);
    out[raw_read(fd, out, n - 1, 3000, &closed)] = 0;
    close(fd);
}

static void get(const char *path, char *out, size_t n)
{
    get_with(path, "", out, n);
}

static void write_page_file(const char *name, const char *text)
{
    char path[160];
    snprintf(path, sizeof path, "%s/page/%s", d.folder, name);
    write_text(path, text);
}

// The forms of a page's file, and how long each may be kept.
static void test_page(void **state)
{
    static char text[65536];
    char path[160], tag[60] = "";
    snprintf(path, sizeof path, "%s/page", d.folder);
    mkdir(path, 0700);
    snprintf(path, sizeof path, "%s/page/assets", d.folder);
    mkdir(path, 0700);
    write_page_file("assets/a-1.js", "plain form");
    write_page_file("assets/a-1.js.gz", "gzip form");
    write_page_file("assets/a-1.js.br", "brotli form");
    write_page_file(".hidden", "hidden");
    start_with_http();
    get("/assets/a-1.js", text, sizeof text);
    assert_non_null(strstr(text, "plain form"));
    assert_non_null(strstr(text, "text/javascript"));
    assert_non_null(strstr(text, "immutable"));
    get_with("/assets/a-1.js", "Accept-Encoding: gzip, br;q=0\r\n", text, sizeof text);
    assert_non_null(strstr(text, "gzip form"));
    assert_non_null(strstr(text, "content-encoding: gzip"));
    get_with("/assets/a-1.js", "Accept-Encoding: br;q=0.0, gzip;q=0.5\r\n", text, sizeof text);
    assert_non_null(strstr(text, "gzip form"));
    get_with("/assets/a-1.js", "Accept-Encoding: gzip;q=0.000, identity\r\n", text,
             sizeof text);
    assert_non_null(strstr(text, "plain form"));
    get_with("/assets/a-1.js", "Accept-Encoding: gzip, deflate, br\r\n", text, sizeof text);
    assert_non_null(strstr(text, "brotli form"));
    get("/?from=letter", text, sizeof text);
    assert_non_null(strstr(text, "<title>page</title>"));
    assert_non_null(strstr(text, "no-cache"));
    assert_non_null(strstr(text, "content-security-policy: default-src 'none'"));
    assert_null(strstr(text, "unsafe-inline"));
    assert_int_equal(sscanf(strstr(text, "etag: "), "etag: %50s", tag), 1);
    char known[100];
    snprintf(known, sizeof known, "If-None-Match: %s\r\n", tag);
    get_with("/", known, text, sizeof text);
    assert_non_null(strstr(text, "304"));
    assert_null(strstr(text, "<title>"));
    const char *const absent[] = {"/.hidden", "/assets", "/assets/a-1.js.br",
                                  "/assets/../index.html.br", "/%2e%2e/log"};
    for (size_t i = 0; i < sizeof absent / sizeof *absent; i++) {
        get(absent[i], text, sizeof text);
        assert_non_null(strstr(text, "404"));
    }
    get_with("/assets/a-1.js", "Origin: http://elsewhere\r\n", text, sizeof text);
    assert_non_null(strstr(text, "403"));
    assert_int_equal(daemon_stop(&d), 0);
}

// A folder without a page: the daemon serves, and "/" says how to get one.
static void test_no_page(void **state)
{
    static char text[65536];
    char page[128];
    snprintf(page, sizeof page, "%s/empty", d.folder);
    mkdir(page, 0700);
    const char *const extra[] = {"--http", "127.0.0.1:0", "--page", page, NULL};
    daemon_start(&d, extra);
    get("/", text, sizeof text);
    assert_non_null(strstr(text, "RELIGHT_PAGE=ON"));
    get("/healthz", text, sizeof text);
    assert_non_null(strstr(text, "ok\n"));
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_http(void **state)
{
    static char text[65536];
    start_with_http();
    get("/healthz", text, sizeof text);
    assert_non_null(strstr(text, "200"));
    assert_non_null(strstr(text, "ok\n"));
    get("/metrics", text, sizeof text);
    assert_non_null(
        strstr(text, "# TYPE relightd_passes_total counter\nrelightd_passes_total 0"));
    get("/", text, sizeof text);
    assert_non_null(strstr(text, "<title>page</title>"));
    get("/nothing", text, sizeof text);
    assert_non_null(strstr(text, "404"));
    get("/../log", text, sizeof text);
    assert_null(strstr(text, "listen address"));
    struct relight_client *client = client_open(d.address); // the sockets are served beside it
    float red;
    red_of_first_vertex(client, 3, &red);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// The vectors of proto/: HELLO as a client sends it.
static size_t hello_frame(uint8_t *out)
{
    // client "t", version_min 1, version_max 1
    static const uint8_t header[] = {0x0a, 1, 't', 0x10, 1, 0x18, 1};
    memset(out, 0, 32);
    memcpy(out, "RLGT\1\2\1\0", 8);
    out[8] = 1;
    out[16] = sizeof header;
    memcpy(out + 32, header, sizeof header);
    return 32 + sizeof header;
}

static void ws_send(int fd, const uint8_t *bytes, size_t n)
{
    uint8_t frame[256] = {0x82, (uint8_t)(0x80 | n), 1, 2, 3, 4};
    assert_true(n < 126);
    for (size_t i = 0; i < n; i++) frame[6 + i] = bytes[i] ^ frame[2 + i % 4];
    assert_int_equal(write(fd, frame, n + 6), n + 6);
}

static int ws_ask(const char *origin, char *text, size_t room)
{
    char ask[500];
    snprintf(
        ask, sizeof ask,
        "GET /ws HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: relight.v1\r\nOrigin: %s\r\n\r\n",
        origin);
    int fd = http_connect();
    assert_true(write(fd, ask, strlen(ask)) > 0);
    struct pollfd p = {fd, POLLIN, 0};
    assert_int_equal(poll(&p, 1, 3000), 1);
    ssize_t n = read(fd, text, room - 1);
    text[n > 0 ? n : 0] = 0;
    return fd;
}

static int ws_open(void)
{
    char text[1024];
    int fd = ws_ask("http://localhost", text, sizeof text);
    assert_non_null(strstr(text, "101"));
    assert_non_null(strstr(text, "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="));
    return fd;
}

static void test_websocket_carries_frames(void **state)
{
    start_with_http();
    uint8_t frame[128], answer[4096];
    bool closed;
    int fd = ws_open();
    ws_send(fd, frame, hello_frame(frame));
    size_t n = raw_read(fd, answer, sizeof answer, 500, &closed);
    assert_true(n > 40 && !closed);
    size_t at = (answer[1] & 127) == 126 ? 4 : 2;
    assert_int_equal(answer[0], 0x82);
    assert_memory_equal(answer + at, "RLGT\1\2\1\x80", 8);
    close(fd);
    // Bytes that are no frame: an error, and the end of this connection only.
    fd = ws_open();
    ws_send(fd, (const uint8_t *)"GARBAGE", 7);
    n = raw_read(fd, answer, sizeof answer, 3000, &closed);
    assert_true(n > 2 && closed);
    close(fd);
    fd = ws_open();
    ws_send(fd, frame, hello_frame(frame));
    assert_true(raw_read(fd, answer, sizeof answer, 500, &closed) > 40);
    close(fd);
    assert_int_equal(daemon_stop(&d), 0);
}

// A page of another site may not use the visitor's connection.
static void test_websocket_of_another_origin(void **state)
{
    char text[1024];
    start_with_http();
    close(ws_ask("http://elsewhere.example", text, sizeof text));
    assert_null(strstr(text, "101"));
    assert_true(log_says(&d, "elsewhere.example", 1000));
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_token(void **state)
{
    char path[128];
    snprintf(path, sizeof path, "%s/token", d.folder);
    write_text(path, "open sesame\n");
    const char *const extra[] = {"--token-file", path, NULL};
    daemon_start(&d, extra);
    char tcp[80]; // on the unix socket the user needs no token
    snprintf(tcp, sizeof tcp, "tcp:%s", d.tcp);
    static const char *const wrong[] = {NULL, "open", "open sesame!", "xpen sesame"};
    struct relight_client *client;
    struct relight_error error;
    for (int i = 0; i < 4; i++) {
        struct relight_options options = {.token = wrong[i]};
        assert_int_equal(relight_connect(tcp, &options, &client, &error), -RELIGHT_E_FORBIDDEN);
    }
    struct relight_options options = {.token = "open sesame"};
    OK(relight_connect(tcp, &options, &client, &error));
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_restart_keeps_the_bake, after_each),
        cmocka_unit_test_teardown(test_restart_keeps_the_pin, after_each),
        cmocka_unit_test_teardown(test_damaged_bake_is_refused_and_made_anew, after_each),
        cmocka_unit_test_teardown(test_sigterm_answers_what_is_open, after_each),
        cmocka_unit_test_teardown(test_sigterm_ends_a_bake, after_each),
        cmocka_unit_test_teardown(test_one_daemon_a_socket_and_a_folder, after_each),
        cmocka_unit_test_teardown(test_socket_of_a_dead_daemon_is_replaced, after_each),
        cmocka_unit_test_teardown(test_memory_budget, after_each),
        cmocka_unit_test_teardown(test_disk_budget_of_bakes, after_each),
        cmocka_unit_test_teardown(test_names_of_a_file, after_each),
        cmocka_unit_test_teardown(test_busy_at_the_limit, after_each),
        cmocka_unit_test_teardown(test_configuration, after_each),
        cmocka_unit_test_teardown(test_http, after_each),
        cmocka_unit_test_teardown(test_page, after_each),
        cmocka_unit_test_teardown(test_no_page, after_each),
        cmocka_unit_test_teardown(test_websocket_carries_frames, after_each),
        cmocka_unit_test_teardown(test_websocket_of_another_origin, after_each),
        cmocka_unit_test_teardown(test_token, after_each),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("lifecycle", tests, setup, teardown);
}
