// SPDX-License-Identifier: MIT
// Every allocation of the daemon fails once: at its start, in HELLO, uploads, LOAD, COLORS,
// IMAGE, views and the rest. It answers with an error or closes the connection, and the next
// request of another client is answered as if nothing had been.
#include "faulty_daemon.h"

static char model[ID_SIZE];
static const char *scratch_name;

static int setup(void **state)
{
    faults_setup();
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    relight_close(client);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

// ---- what is done while an allocation fails: 0, or the error's code

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

static const struct act {
    const char *name;
    act_fn fn;
} acts[] = {{"HELLO and PING", act_hello}, {"LIST", act_list},
            {"STATS", act_stats},          {"an upload", act_upload},
            {"LOAD and UNLOAD", act_load}, {"COLORS", act_colors},
            {"IMAGE", act_image},          {"a material", act_material}};

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
    for (; n < 2000 && left == 0; n++) {
        struct relight_error error = {.text = ""};
        int64_t failed = faults->n_failed;
        faults->allocation = n;
        struct relight_client *client = try_connect();
        int status = client ? act->fn(client, (unsigned)n, &error) : -1;
        relight_close(client);
        left = faults->n_failed == failed;
        faults_off();
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

static void at_the_start(void **state)
{
    int64_t n = 1;
    int refused = 0;
    assert_int_equal(daemon_stop(&d), 0);
    for (; n < 2000; n += 1 + n / 40) {
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
    assert_true(n > 10 && n < 2000);
    daemon_start(&d, NULL);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(requests),
                                       cmocka_unit_test(at_the_start)};
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("allocations", tests, setup, teardown);
}
