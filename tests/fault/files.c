// SPDX-License-Identifier: MIT
// Calls on files of the data folder fail: short writes, ENOSPC, EIO, EMFILE, once at each place
// and from there on. What is answered with success is there afterwards, also after a restart;
// what failed can be done again; the daemon serves on.
#include "faulty_daemon.h"

static char model[ID_SIZE];
static float reference[18];

static int colors(struct relight_client *client, const char *name, float out[18],
                  struct relight_error *error)
{
    struct relight_light light = {.env = "constant:1,0.5,0.25"};
    struct relight_colors_request r = {.model = name, .n_light = 1, .lights = &light};
    struct relight_colors c;
    int status = relight_colors(client, &r, &c, error);
    if (status) return status;
    assert_int_equal(c.n_vertex, OCTAHEDRON_VERTICES);
    assert_int_equal(relight_colors_decode(&c, 0, out), 0);
    relight_colors_finish(&c);
    return 0;
}

static int setup(void **state)
{
    struct relight_error error;
    faults_setup();
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    OK(colors(client, model, reference, &error));
    relight_close(client);
    return 0;
}

static void must_serve(const char *after, int64_t n)
{
    struct relight_error error = {.text = ""};
    float got[18];
    must_live(after, n);
    struct relight_client *client = client_open(d.address);
    if (colors(client, model, got, &error) || memcmp(got, reference, sizeof got))
        fail_msg("not served after fault %lld in %s: %s", (long long)n, after, error.text);
    relight_close(client);
}

// Some 300 kB that differ from turn to turn, in two chunks and a bit.
enum { FILE_BYTES = 300000 };

static void fill(uint8_t *bytes, unsigned turn)
{
    unsigned x = turn * 2654435761u + 1;
    for (int i = 0; i < FILE_BYTES; i++)
        bytes[i] = (uint8_t)((x = x * 1103515245 + 12345) >> 16);
}

static int upload(struct relight_client *client, unsigned turn, char hash[65],
                  struct relight_error *error)
{
    static uint8_t bytes[FILE_BYTES];
    fill(bytes, turn);
    return relight_upload(client, "some.bin", bytes, sizeof bytes, NULL, NULL, hash, NULL,
                          error);
}

// The stored file has the bytes.
static bool stored(const char *hash, unsigned turn)
{
    static uint8_t want[FILE_BYTES], have[FILE_BYTES + 1];
    char path[200];
    snprintf(path, sizeof path, "%s/blobs/%s", d.data, hash);
    FILE *file = fopen(path, "r");
    size_t n = file ? fread(have, 1, sizeof have, file) : 0;
    if (file) fclose(file);
    fill(want, turn);
    return n == sizeof want && !memcmp(want, have, sizeof want);
}

static const struct fault {
    const char *name;
    int error, kinds;
} fault_list[] = {{"short writes", 0, FAULT_WRITE},
                  {"ENOSPC", ENOSPC, FAULT_WRITE | FAULT_NAME | FAULT_SIZE},
                  {"EIO", EIO, FAULT_WRITE | FAULT_SYNC | FAULT_SIZE | FAULT_NAME},
                  {"EMFILE", EMFILE, FAULT_OPEN}};

// n-th call fails (and all after it): an upload that was acknowledged is whole.
static bool upload_under(const struct fault *f, int64_t n, bool lasting, unsigned turn)
{
    char hash[65];
    struct relight_error error = {.text = ""};
    int64_t failed = faults->n_failed;
    struct relight_client *client = client_open(d.address);
    faults->error = f->error;
    faults->kinds = f->kinds;
    faults->lasting = lasting;
    faults->call = n;
    int status = upload(client, turn, hash, &error);
    bool hit = faults->n_failed != failed;
    faults_off();
    if (!hit && status) fail_msg("%s: %s without a fault", f->name, error.text);
    if (!f->error && status) fail_msg("short writes: %s", error.text);
    if (!status && !stored(hash, turn))
        fail_msg("%s at %lld: acknowledged, and not stored", f->name, (long long)n);
    relight_close(client);
    client = client_open(d.address);
    if (upload(client, turn, hash, &error))
        fail_msg("%s at %lld: not even afterwards: %s", f->name, (long long)n, error.text);
    assert_true(stored(hash, turn));
    relight_close(client);
    must_serve(f->name, n);
    return hit;
}

static void uploads(void **state)
{
    unsigned turn = 0;
    for (size_t i = 0; i < sizeof fault_list / sizeof *fault_list; i++)
        for (int lasting = 0; lasting < 2; lasting++) {
            int64_t n = 1;
            while (n < 200 && upload_under(&fault_list[i], n, lasting, ++turn)) n++;
            print_message("upload, %s%s: %lld calls\n", fault_list[i].name,
                          lasting ? " from then on" : "", (long long)n - 1);
            assert_true(n > 1 && n < 200);
        }
}

static int picture(struct relight_client *client, const char *name, struct relight_image *image,
                   struct relight_error *error)
{
    struct relight_light light = {.env = "constant"};
    struct relight_image_request r = {
        .model = name, .n_light = 1, .lights = &light, .picture = {.width = 16, .height = 16}};
    return relight_image(client, &r, image, error);
}

// LOAD with a preview, and its picture.
static bool load_under(const struct fault *f, int64_t n, bool lasting, unsigned turn)
{
    struct relight_error error = {.text = ""};
    struct relight_loaded loaded;
    struct relight_load load = {
        .size_mm = 10 + (float)turn / 64, .material = "marble", .preview = true};
    int64_t failed = faults->n_failed;
    struct relight_client *client = client_open(d.address);
    faults->error = f->error;
    faults->kinds = f->kinds;
    faults->lasting = lasting;
    faults->call = n;
    int status = load_octahedron(client, &d, "o.obj", &load, &loaded, &error);
    if (!status) relight_loaded_finish(&loaded);
    bool hit = faults->n_failed != failed;
    faults_off();
    relight_close(client);
    client = client_open(d.address);
    if (load_octahedron(client, &d, "o.obj", &load, &loaded, &error))
        fail_msg("%s at %lld: not loaded afterwards: %s", f->name, (long long)n, error.text);
    struct relight_image image;
    status = picture(client, loaded.model, &image, &error);
    // A mesh that could not be written is read again once the model was forgotten.
    if (status) {
        if (!hit || !f->error)
            fail_msg("%s at %lld: no picture: %s", f->name, (long long)n, error.text);
        OK(relight_unload(client, loaded.model, true, NULL, &error));
        relight_loaded_finish(&loaded);
        OK(load_octahedron(client, &d, "o.obj", &load, &loaded, &error));
        status = picture(client, loaded.model, &image, &error);
    }
    if (status)
        fail_msg("%s at %lld: no picture afterwards: %s", f->name, (long long)n, error.text);
    relight_image_finish(&image);
    OK(relight_unload(client, loaded.model, true, NULL, &error));
    relight_loaded_finish(&loaded);
    relight_close(client);
    must_serve(f->name, n);
    return hit;
}

static void loads(void **state)
{
    unsigned turn = 0;
    for (size_t i = 0; i < sizeof fault_list / sizeof *fault_list; i++)
        for (int lasting = 0; lasting < 2; lasting++) {
            int64_t n = 1;
            while (n < 200 && load_under(&fault_list[i], n, lasting, ++turn)) n++;
            print_message("LOAD, %s%s: %lld calls\n", fault_list[i].name,
                          lasting ? " from then on" : "", (long long)n - 1);
            assert_true(n < 200);
        }
}

// The bake survives each open that fails while the daemon starts.
static void bakes_survive_starts(void **state)
{
    int64_t n = 1;
    for (bool hit = true; hit && n < 200; n++) {
        int64_t failed = faults->n_failed;
        int how;
        assert_int_equal(daemon_stop(&d), 0);
        faults->error = n % 2 ? EMFILE : EIO;
        faults->kinds = FAULT_OPEN;
        faults->call = n;
        unlink(d.log);
        d.pid = daemon_spawn(&d, NULL);
        bool up = false, gone = false;
        for (int i = 0; i < 2000 && !up && !gone; i++) {
            up = log_says(&d, " start version", 0);
            gone = waitpid(d.pid, &how, WNOHANG) == d.pid;
            sleep_ms(5);
        }
        sleep_ms(100); // files that are read after the start
        hit = faults->n_failed != failed;
        faults_off();
        if (gone) {
            if (!WIFEXITED(how))
                fail_msg("open %lld at the start: status %d", (long long)n, how);
            d.pid = 0;
            daemon_start(&d, NULL);
        }
        must_serve("the start", n);
    }
    print_message("start: %lld opens\n", (long long)n - 2);
    assert_true(n > 3);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(uploads), cmocka_unit_test(loads),
                                       cmocka_unit_test(bakes_survive_starts)};
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("files", tests, setup, faults_teardown);
}
