// SPDX-License-Identifier: MIT
// The daemon is killed at random moments of uploads, bakes and the writing of its files, and
// started again on the same folder. Nothing that it acknowledged is lost, nothing is corrupt,
// it serves by itself. Then: loading and unloading over and over leaves no memory behind.
//   kill_daemon [ROUNDS [LOADS]]
#include "daemon.h"

#include <pthread.h>

enum { FILE_BYTES = 3 << 20, MOST = 4096 };

static struct daemon d;
static int rounds = 5, loads = 100;
static unsigned seed = 20240611;

static int setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    return 0;
}

static int teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static void fill(uint8_t *bytes, unsigned turn)
{
    unsigned x = turn * 2654435761u + 1;
    for (int i = 0; i < FILE_BYTES; i++)
        bytes[i] = (uint8_t)((x = x * 1103515245 + 12345) >> 16);
}

// ---- requests of clients until the daemon is gone, and its answers

struct record {
    char name[ID_SIZE]; // a model's id
    char hash[65];      // or an upload's
    unsigned turn;
    float colors[18];
};
static struct record uploaded[MOST], baked[MOST];
static unsigned n_uploaded, n_baked, n_turn;

static int colors_of(struct relight_client *client, const char *model, float out[18],
                     struct relight_error *error)
{
    struct relight_light light = {.env = "constant:1,0.5,0.25"};
    struct relight_colors_request r = {.model = model, .n_light = 1, .lights = &light};
    struct relight_colors colors;
    int status = relight_colors(client, &r, &colors, error);
    if (status) return status;
    status = relight_colors_decode(&colors, 0, out);
    relight_colors_finish(&colors);
    return status;
}

static void *upload_on(void *arg)
{
    static uint8_t bytes[FILE_BYTES];
    struct relight_client *client = arg;
    struct relight_error error;
    while (n_uploaded < MOST) {
        struct record *r = &uploaded[n_uploaded];
        r->turn = ++n_turn;
        fill(bytes, r->turn);
        if (relight_upload(client, "some.bin", bytes, sizeof bytes, NULL, NULL, r->hash, NULL,
                           &error))
            break;
        n_uploaded++;
    }
    return NULL;
}

static int bake_one(struct relight_client *client, struct relight_error *error)
{
    static uint64_t bake_seed = 100;
    struct record *r = &baked[n_baked];
    struct relight_loaded loaded;
    int status = load_small(client, &d, "o.obj", ++bake_seed, 100, &loaded, error);
    if (status) return status;
    snprintf(r->name, sizeof r->name, "%s", loaded.model);
    if (loaded.job[0]) status = relight_watch(client, loaded.job, NULL, NULL, error);
    relight_loaded_finish(&loaded);
    if (!status) status = colors_of(client, r->name, r->colors, error);
    n_baked += !status;
    return status;
}

static void *bake_on(void *arg)
{
    struct relight_error error;
    while (n_baked < MOST && !bake_one(arg, &error)) continue;
    return NULL;
}

// ---- afterwards

static void check_uploads(void)
{
    static uint8_t want[FILE_BYTES], have[FILE_BYTES + 1];
    for (unsigned i = 0; i < n_uploaded; i++) {
        char path[200];
        snprintf(path, sizeof path, "%s/blobs/%s", d.data, uploaded[i].hash);
        FILE *file = fopen(path, "r");
        if (!file) fail_msg("upload %u was acknowledged and is gone", i);
        size_t n = fread(have, 1, sizeof have, file);
        fclose(file);
        fill(want, uploaded[i].turn);
        if (n != sizeof want || memcmp(want, have, n)) fail_msg("upload %u is corrupt", i);
    }
}

static void check_bakes(struct relight_client *client)
{
    struct relight_error error;
    for (unsigned i = 0; i < n_baked; i++) {
        float got[18];
        if (colors_of(client, baked[i].name, got, &error))
            fail_msg("bake %u was acknowledged and is lost: %s", i, error.text);
        if (memcmp(got, baked[i].colors, sizeof got)) fail_msg("bake %u is another one", i);
    }
}

static void killed_at_random(void **state)
{
    struct relight_client *first = client_open(d.address);
    struct relight_error error;
    OK(bake_one(first, &error));
    relight_close(first);
    for (int round = 0; round < rounds; round++) {
        pthread_t thread[2];
        struct relight_client *client[2] = {client_open(d.address), client_open(d.address)};
        assert_int_equal(pthread_create(&thread[0], NULL, upload_on, client[0]), 0);
        assert_int_equal(pthread_create(&thread[1], NULL, bake_on, client[1]), 0);
        sleep_ms(50 + rand_r(&seed) % (round % 3 == 1 ? 6000 : 1500));
        kill(d.pid, SIGKILL);
        for (int i = 0; i < 2; i++) pthread_join(thread[i], NULL);
        for (int i = 0; i < 2; i++) relight_close(client[i]);
        waitpid(d.pid, NULL, 0);
        daemon_start(&d, NULL);
        if (log_says(&d, "damaged", 0)) fail_msg("round %d: a file is damaged", round);
        struct relight_client *after = client_open(d.address);
        check_uploads();
        check_bakes(after);
        relight_close(after);
    }
    print_message("%d kills: %u uploads and %u bakes acknowledged, all there\n", rounds,
                  n_uploaded, n_baked);
    assert_true(n_uploaded > 0);
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

static void load_and_unload(struct relight_client *client, int turn)
{
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {
        .size_mm = 10 + (float)turn / 256, .material = "marble", .preview = true};
    OK(load_octahedron(client, &d, "o.obj", &load, &loaded, &error));
    struct relight_light light = {.env = "constant"};
    struct relight_image_request r = {.model = loaded.model,
                                      .n_light = 1,
                                      .lights = &light,
                                      .picture = {.width = 64, .height = 48}};
    struct relight_image image;
    OK(relight_image(client, &r, &image, &error));
    relight_image_finish(&image);
    OK(relight_unload(client, loaded.model, true, NULL, &error));
    relight_loaded_finish(&loaded);
}

// Law of the books: what a model took is given back when it is forgotten.
static void loads_leave_nothing(void **state)
{
    struct relight_client *client = client_open(d.address);
    int turn = 0;
    while (turn < loads / 2) load_and_unload(client, ++turn);
    long before = resident_kb();
    double cache = metric(client, "relightd_cache_bytes");
    while (turn < loads) load_and_unload(client, ++turn);
    long after = resident_kb();
    print_message("%d loads: %ld kB resident, then %ld kB\n", loads, before, after);
    assert_true(after <= before + before / 20);
    assert_true(metric(client, "relightd_cache_bytes") <= cache * 1.05 + 65536);
    // Each kill interrupts one bake at most, which goes on and ends in an open model.
    assert_true(metric(client, "relightd_models_open") <= 1 + (double)n_baked + rounds);
    relight_close(client);
}

int main(int argc, char **argv)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(killed_at_random),
                                       cmocka_unit_test(loads_leave_nothing)};
    signal(SIGPIPE, SIG_IGN);
    if (argc > 1) rounds = atoi(argv[1]);
    if (argc > 2) loads = atoi(argv[2]);
    return cmocka_run_group_tests_name("kill", tests, setup, teardown);
}
