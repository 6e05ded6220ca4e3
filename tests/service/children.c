// SPDX-License-Identifier: MIT
// The daemon's child processes: they have limits, their ends are counted, and they die with it.
#include "daemon.h"

#include <ctype.h>
#include <dirent.h>
#include <zlib.h>

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

static int after_each(void **state)
{
    if (d.pid) kill(d.pid, SIGKILL), waitpid(d.pid, NULL, 0);
    d.pid = 0;
    return 0;
}

// Parent of a process, and whether its command line has this word; -1: it has gone.
static pid_t parent_of(pid_t pid, const char *word, bool *has)
{
    char path[64], text[4096];
    int parent = -1;
    snprintf(path, sizeof path, "/proc/%d/stat", (int)pid);
    FILE *f = fopen(path, "r");
    size_t n = f ? fread(text, 1, sizeof text - 1, f) : 0;
    if (f) fclose(f);
    text[n] = 0;
    char *close = strrchr(text, ')');
    if (!close || sscanf(close + 2, "%*c %d", &parent) != 1) return -1;
    snprintf(path, sizeof path, "/proc/%d/cmdline", (int)pid);
    f = fopen(path, "r");
    n = f ? fread(text, 1, sizeof text - 1, f) : 0;
    if (f) fclose(f);
    for (size_t i = 0; i < n; i++)
        if (!text[i]) text[i] = ' ';
    text[n] = 0;
    *has = strstr(text, word) != NULL;
    return (pid_t)parent;
}

// Children of `parent` with this word in their command line; one of them in *one.
static int children(pid_t parent, const char *word, pid_t *one)
{
    DIR *dir = opendir("/proc");
    int n = 0;
    assert_non_null(dir);
    for (struct dirent *e; (e = readdir(dir));) {
        bool has = false;
        if (!isdigit((unsigned char)e->d_name[0])) continue;
        pid_t pid = (pid_t)atoi(e->d_name);
        if (parent_of(pid, word, &has) != parent || !has) continue;
        *one = pid;
        n++;
    }
    closedir(dir);
    return n;
}

static pid_t wait_for_bake(void)
{
    pid_t pid = 0;
    for (int i = 0; i < 3000 && !children(d.pid, " bake ", &pid); i++) sleep_ms(20);
    assert_true(pid > 0);
    return pid;
}

// A bake of minutes; its job's number.
static void start_long_bake(struct relight_client *client, char job[32])
{
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load load = {.size_mm = 10,
                                .material = "marble",
                                .bake = {.samples = 3000000, .cube = 16, .single_points = 64}};
    OK(load_octahedron(client, &d, "long.obj", &load, &loaded, &error));
    snprintf(job, 32, "%s", loaded.job);
    relight_loaded_finish(&loaded);
}

static void test_a_bake_dies_with_the_daemon(void **state)
{
    char job[32];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    start_long_bake(client, job);
    pid_t bake = wait_for_bake();
    kill(d.pid, SIGKILL);
    waitpid(d.pid, NULL, 0);
    d.pid = 0;
    bool there = true;
    for (int i = 0; i < 100 && there; i++) {
        sleep_ms(20);
        bool has = false; // a process that has ended has no command line
        there = parent_of(bake, " bake ", &has) >= 0 && has;
    }
    if (there) kill(bake, SIGKILL);
    assert_false(there);
    relight_close(client);
}

static void expect_failure(struct relight_client *client, const char *job, const char *word)
{
    struct relight_error error;
    assert_int_not_equal(relight_watch(client, job, NULL, NULL, &error), 0);
    if (!strstr(error.text, word)) fail_msg("no \"%s\" in: %s", word, error.text);
}

static void test_a_bake_has_its_time(void **state)
{
    static const char *const extra[] = {"--bake-time", "1", NULL};
    char job[32];
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    start_long_bake(client, job);
    expect_failure(client, job, "--bake-time");
    pid_t left;
    assert_int_equal(children(d.pid, " bake ", &left), 0);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_a_bake_has_its_memory(void **state)
{
    static const char *const extra[] = {"--bake-memory", "1G", NULL};
    char job[32];
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    start_long_bake(client, job);
    expect_failure(client, job, "--bake-memory");
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_crashes_are_counted(void **state)
{
    char job[32];
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    start_long_bake(client, job);
    kill(wait_for_bake(), SIGILL); // which no sanitizer takes for itself
    expect_failure(client, job, "signal 4");
    assert_true(metric(client, "relightd_children_crashed_total") == 1);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// Makes a prt in the test's folder that runs these commands of the shell in place of a bake.
static void write_prt(char path[160], const char *commands)
{
    char text[800];
    snprintf(path, 160, "%s/prt", d.folder);
    snprintf(text, sizeof text, "#!/bin/sh\ncase $* in bake*) %s;; esac\nexec %s/prt \"$@\"\n",
             commands, PRT_BINARY_DIR);
    write_text(path, text);
    chmod(path, 0700);
}

// The error of a bake names a file of --models as its users do, without the folder's path.
static void test_errors_do_not_tell_the_folder(void **state)
{
    char path[160], text[400];
    const char *const own[] = {"--prt", path, NULL};
    struct relight_load load = small_bake(1, 200);
    struct relight_loaded loaded;
    struct relight_error error;
    snprintf(text, sizeof text,
             "echo \"error: %s/odd.obj: it is odd\" >&2; echo note: by the way >&2; exit 1",
             d.models);
    write_prt(path, text);
    snprintf(text, sizeof text, "%s/odd.obj", d.models);
    write_text(text, octahedron);
    daemon_start(&d, own);
    struct relight_client *client = client_open(d.address);
    load.path = "odd.obj";
    OK(relight_load(client, &load, &loaded, &error));
    assert_int_equal(relight_watch(client, loaded.job, NULL, NULL, &error),
                     -RELIGHT_E_JOB_FAILED);
    assert_non_null(strstr(error.text, "odd.obj: it is odd"));
    assert_null(strstr(error.text, d.folder));
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A PNG of one colour: a file of some hundred kB however large the picture.
static void write_flat_png(const char *path, uint32_t width, uint32_t height, unsigned grey)
{
    FILE *file = fopen(path, "wb");
    z_stream z = {0};
    size_t n_row = width + 1, n_out = (size_t)height * n_row / 500 + 100000, used;
    unsigned char *row = calloc(1, n_row), *out = malloc(n_out + 12);
    assert_true(file && row && out && deflateInit(&z, 9) == Z_OK);
    memset(row + 1, (int)grey, width);
    z.next_out = out + 8;
    z.avail_out = (uInt)n_out;
    for (uint32_t y = 0; y < height; y++) {
        z.next_in = row;
        z.avail_in = (uInt)n_row;
        deflate(&z, y + 1 == height ? Z_FINISH : Z_NO_FLUSH);
    }
    used = z.total_out;
    assert_true(z.avail_out > 0);
    deflateEnd(&z);
    unsigned char head[25] = {0, 0, 0, 13, 'I', 'H', 'D', 'R'},
                  end[12] = {0, 0, 0, 0, 'I', 'E', 'N', 'D'};
    for (int i = 0; i < 4; i++) {
        head[8 + i] = (unsigned char)(width >> (24 - 8 * i));
        head[12 + i] = (unsigned char)(height >> (24 - 8 * i));
        out[i] = (unsigned char)(used >> (24 - 8 * i));
    }
    head[16] = 8;
    memcpy(out + 4, "IDAT", 4);
    struct {
        unsigned char *at;
        size_t n;
    } chunk[] = {{head + 4, 17}, {out + 4, used + 4}, {end + 4, 4}};
    for (int i = 0; i < 3; i++) {
        uLong crc = crc32(0, chunk[i].at, (uInt)chunk[i].n);
        for (int k = 0; k < 4; k++)
            chunk[i].at[chunk[i].n + (size_t)k] = (unsigned char)(crc >> (24 - 8 * k));
    }
    assert_int_equal(fwrite("\x89PNG\r\n\x1a\n", 1, 8, file), 8);
    assert_int_equal(fwrite(head, 1, 25, file), 25);
    assert_int_equal(fwrite(out, 1, used + 12, file), used + 12);
    assert_int_equal(fwrite(end, 1, 12, file), 12);
    assert_int_equal(fclose(file), 0);
    free(row);
    free(out);
}

static int relight_by(struct relight_client *client, const char *model, const char *env,
                      struct relight_error *error)
{
    struct relight_colors colors;
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    int status = relight_colors(client, &request, &colors, error);
    if (!status) relight_colors_finish(&colors);
    return status;
}

static void upload(struct relight_client *client, const char *path, char env[80])
{
    struct relight_error error;
    OK(relight_env_resolve(client, path, NULL, NULL, env, &error));
}

// 16384 x 8192 pixels take 1536 MB decoded, which a cache of 1 GB would never keep.
static void test_an_image_above_the_cache_is_not_decoded(void **state)
{
    char path[160], model[ID_SIZE], env[80];
    struct relight_error error;
    struct timespec begin, end;
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    snprintf(path, sizeof path, "%s/flat.png", d.folder);
    write_flat_png(path, 16384, 8192, 77);
    upload(client, path, env);
    double fastest = 1e9; // of three: what else runs only adds
    for (int i = 0; i < 3; i++) {
        clock_gettime(CLOCK_MONOTONIC, &begin);
        assert_int_equal(relight_by(client, model, env, &error), -RELIGHT_E_LIMIT);
        assert_non_null(strstr(error.text, "16384 x 8192 pixels take 1536 MB"));
        clock_gettime(CLOCK_MONOTONIC, &end);
        double seconds =
            (double)(end.tv_sec - begin.tv_sec) + 1e-9 * (double)(end.tv_nsec - begin.tv_nsec);
        if (seconds < fastest) fastest = seconds;
    }
    print_message("a refusal in %.3f s\n", fastest);
    assert_true(fastest < 1.5); // one decoding takes longer
    snprintf(path, sizeof path, "%s/small.png", d.folder);
    write_flat_png(path, 512, 256, 77);
    upload(client, path, env);
    OK(relight_by(client, model, env, &error));
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// As many decoders at once as their memory allows: one here, whatever is asked for.
static void test_decoders_share_a_memory(void **state)
{
    static const char *const extra[] = {"--decode-memory", "1G", "--decode-total", "1900M",
                                        NULL};
    enum { N = 4 };
    char path[160], model[ID_SIZE], env[N][80];
    struct relight_error error;
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    for (int i = 0; i < N; i++) {
        snprintf(path, sizeof path, "%s/flat%d.png", d.folder, i);
        write_flat_png(path, 4096, 2048, 50 + (unsigned)i);
        upload(client, path, env[i]);
    }
    uint64_t id[N];
    pid_t helper = 0, one;
    assert_int_equal(children(d.pid, "--decode-helper", &helper), 1);
    for (int i = 0; i < N; i++) {
        struct relight_light light = {.env = env[i]};
        struct relight_colors_request request = {
            .model = model, .n_light = 1, .lights = &light};
        OK(relight_colors_begin(client, &request, 0, &id[i], &error));
    }
    int most = 0;
    for (int i = 0; i < 100; i++) {
        int n = children(helper, "--decode-helper", &one);
        if (n > most) most = n;
        sleep_ms(2);
    }
    assert_int_equal(most, 1);
    for (int i = 0; i < N; i++) {
        struct relight_colors colors;
        OK(relight_colors_end(client, id[i], &colors, &error));
        relight_colors_finish(&colors);
    }
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A file has no more memory than all files together: one is decoded at a time.
static void test_one_decoder_has_all_memory(void **state)
{
    static const char *const extra[] = {"--decode-memory", "8G", "--decode-total", "1G", NULL};
    char path[160], model[ID_SIZE], env[80];
    struct relight_error error;
    struct relight_colors colors;
    daemon_start(&d, extra);
    struct relight_client *client = client_open(d.address);
    bake_small(client, &d, model);
    snprintf(path, sizeof path, "%s/flat.png", d.folder);
    write_flat_png(path, 64, 32, 50);
    upload(client, path, env);
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {.model = model, .n_light = 1, .lights = &light};
    OK(relight_colors(client, &request, &colors, &error));
    relight_colors_finish(&colors);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// A bake's checkpoint gets at most the room that --disk leaves.
static void test_a_checkpoint_has_what_the_disk_leaves(void **state)
{
    enum { LEFT = 200 << 20 };
    static const char word[] = "--checkpoint-room=";
    char path[160], said[160], text[300];
    const char *const own[] = {"--prt", path, "--disk", "200M", NULL};
    struct relight_loaded loaded;
    struct relight_error error;
    snprintf(said, sizeof said, "%s/said", d.folder);
    snprintf(text, sizeof text, "echo \"$*\" >>%s; exit 1", said);
    write_prt(path, text);
    unlink(said);
    daemon_start(&d, own);
    struct relight_client *client = client_open(d.address);
    OK(load_small(client, &d, "room.obj", 3, 200, &loaded, &error));
    assert_int_equal(relight_watch(client, loaded.job, NULL, NULL, &error),
                     -RELIGHT_E_JOB_FAILED);
    char *commands = read_text(said), *room = strstr(commands, word);
    assert_non_null(room);
    assert_in_range(strtoull(room + strlen(word), NULL, 10), LEFT / 2, LEFT - 1);
    free(commands);
    relight_loaded_finish(&loaded);
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

// The library's bounds, in its words.
static void test_settings_have_one_bound(void **state)
{
    struct relight_error error;
    struct relight_loaded loaded;
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    struct relight_load load = small_bake(0, 10000001);
    assert_int_equal(load_octahedron(client, &d, "b.obj", &load, &loaded, &error),
                     -RELIGHT_E_OUT_OF_RANGE);
    assert_string_equal(error.text, "samples is 10000001, allowed range 16 to 10000000");
    load = small_bake(0, 200);
    load.bake.rank = 513;
    assert_int_equal(load_octahedron(client, &d, "b.obj", &load, &loaded, &error),
                     -RELIGHT_E_OUT_OF_RANGE);
    assert_string_equal(error.text, "rank is 513, allowed range 1 to 512");
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
}

#define TEST(name) cmocka_unit_test_teardown(name, after_each)

int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(test_a_bake_dies_with_the_daemon),
        TEST(test_a_bake_has_its_time),
        TEST(test_a_bake_has_its_memory),
        TEST(test_crashes_are_counted),
        TEST(test_errors_do_not_tell_the_folder),
        TEST(test_an_image_above_the_cache_is_not_decoded),
        TEST(test_decoders_share_a_memory),
        TEST(test_one_decoder_has_all_memory),
        TEST(test_a_checkpoint_has_what_the_disk_leaves),
        TEST(test_settings_have_one_bound),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
