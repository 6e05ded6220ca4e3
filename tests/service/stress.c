// SPDX-License-Identifier: MIT
// Clients that get in each other's way: models are loaded, moved, looked at, unloaded and
// forgotten by several at once, while memory, cache and disk are too small for them. Any answer
// will do that says what happened; the daemon stays whole and keeps its books.
#include "ask.h"

#include <dirent.h>
#include <pthread.h>

enum { N_CLIENT = 3, N_CODE = 120 };
#if defined(__SANITIZE_THREAD__) || defined(__SANITIZE_ADDRESS__)
static const double run_s = 12; // each test: the daemon is some ten times slower
#else
static const double run_s = 2.5;
#endif

struct worker {
    pthread_t thread;
    const struct daemon *d;
    unsigned number, seed;
    unsigned done, refused[N_CODE];
    char wrong[640]; // an error that nobody should see
};

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static unsigned draw(struct worker *w, unsigned n)
{
    return (unsigned)rand_r(&w->seed) / 7 % n;
}

// What may happen to who is overtaken by another.
static bool is_fair(int code)
{
    return code == RELIGHT_E_NOT_FOUND || code == RELIGHT_E_NOT_READY ||
           code == RELIGHT_E_CANCELLED || code == RELIGHT_E_JOB_FAILED ||
           code == RELIGHT_E_TIMEOUT || code == RELIGHT_E_DEADLINE || code == RELIGHT_E_BUSY;
}

static bool went(struct worker *w, const char *what, int status,
                 const struct relight_error *error)
{
    if (!status) {
        w->done++;
        return true;
    }
    if (-status < N_CODE) w->refused[-status]++;
    if (!is_fair(-status) && !w->wrong[0])
        snprintf(w->wrong, sizeof w->wrong, "%s: %d %s", what, status, error->text);
    return false;
}

#define WENT(call) went(w, #call, call, &error)

// One of a few materials, so that ids meet; each is a model of its own.
static bool load_one(struct worker *w, struct relight_client *c, bool preview, char id[ID_SIZE])
{
    static const char *const material[] = {"marble", "skin1"};
    struct relight_error error;
    struct relight_loaded loaded;
    char path[160];
    struct relight_load load = small_bake(0, 100);
    load.material = material[draw(w, 2)];
    load.preview = preview;
    load.pin = !draw(w, 8);
    snprintf(path, sizeof path, "%s/stress.obj", w->d->folder);
    if (!WENT(relight_load_file(c, path, &load, NULL, NULL, &loaded, &error))) return false;
    snprintf(id, ID_SIZE, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    return true;
}

static void look(struct worker *w, struct relight_client *c, const char *id, bool wait)
{
    struct relight_error error;
    struct relight_image image;
    char env[40];
    uint64_t request;
    snprintf(env, sizeof env, "constant:1,%u,1", 1 + draw(w, 5));
    struct relight_light light = {.env = env};
    struct relight_image_request r = {
        .model = id,
        .n_light = 1,
        .lights = &light,
        .picture = {.width = 48 + 16 * draw(w, 2), .height = 48, .format = RELIGHT_IMAGE_RGB8}};
    if (draw(w, 3) == 0) r.shade.engine = RELIGHT_ENGINE_SPLAT + draw(w, 4);
    if (!WENT(relight_image_begin(c, &r, 0, &request, &error))) return;
    if (!wait) WENT(relight_cancel(c, request, &error));
    if (WENT(relight_image_end(c, request, &image, &error))) relight_image_finish(&image);
}

static void ask_some(struct worker *w, struct relight_client *c, const char *id)
{
    struct relight_error error;
    struct relight_colors colors;
    char env[40];
    snprintf(env, sizeof env, "constant:1,%u,1", 1 + draw(w, 5));
    struct relight_light light = {.env = env};
    struct relight_colors_request r = {.model = id, .n_light = 1, .lights = &light};
    if (WENT(relight_colors(c, &r, &colors, &error))) relight_colors_finish(&colors);
}

static void view(struct worker *w, struct relight_client *c, const char *id)
{
    struct relight_error error;
    struct relight_view *v;
    struct relight_light light = {.env = "constant"};
    struct relight_view_request r = {
        .model = id,
        .n_light = 1,
        .lights = &light,
        .colors = draw(w, 2),
        .picture = {.width = 40, .height = 40, .format = RELIGHT_IMAGE_RGB8}};
    if (!WENT(relight_view_open(c, &r, &v, &error))) return;
    for (unsigned i = 0, n = 1 + draw(w, 4); i < n; i++) {
        struct relight_frame_out frame;
        light.rotate_deg = (float)draw(w, 360);
        if (draw(w, 2)) WENT(relight_view_set(v, 1, &light, NULL, NULL, NULL, &error));
        if (WENT(relight_view_next(v, 0.05 + 0.01 * draw(w, 15), &frame, &error)))
            relight_frame_out_finish(&frame);
    }
    WENT(relight_view_close(v, NULL, NULL, &error));
}

static void move(struct worker *w, struct relight_client *c, const char *id)
{
    struct relight_error error;
    float p[3] = {5 + (float)draw(w, 5), 0, 0};
    WENT(relight_update_vertices(c, id, 0, 1, p, NULL, false, NULL, &error));
}

static void look_up(struct worker *w, struct relight_client *c, const char *id)
{
    struct relight_error error;
    struct relight_model info;
    struct relight_geometry geometry;
    struct relight_list list;
    if (WENT(relight_info(c, id, &info, &error))) relight_model_finish(&info);
    if (WENT(relight_geometry(c, id, false, &geometry, &error)))
        relight_geometry_finish(&geometry);
    if (WENT(relight_list(c, true, &list, &error))) relight_list_finish(&list);
}

static void *race(void *arg)
{
    struct worker *w = arg;
    struct relight_client *c = client_open(w->d->address);
    struct relight_error error;
    char id[ID_SIZE] = "none";
    double end = now_s() + run_s;
    bool bakes = w->number >= 10;
    while (now_s() < end && !w->wrong[0]) {
        switch (draw(w, 10)) {
        case 0:
        case 1:
            load_one(w, c, !bakes || draw(w, 3) == 0, id);
            break;
        case 2:
            look(w, c, id, true);
            break;
        case 3:
            look(w, c, id, false);
            break;
        case 4:
            ask_some(w, c, id);
            break;
        case 5:
            view(w, c, id);
            break;
        case 6:
            move(w, c, id);
            break;
        case 7:
            look_up(w, c, id);
            break;
        case 8:
            WENT(relight_unload(c, id, false, NULL, &error));
            break;
        default:
            if (!bakes || draw(w, 2)) WENT(relight_unload(c, id, true, NULL, &error));
            else if (draw(w, 2)) WENT(relight_watch(c, id, NULL, NULL, &error));
            else WENT(relight_cancel_job(c, id, NULL, &error));
        }
        if (draw(w, 40) == 0) { // and now and then without a word
            relight_close(c);
            c = client_open(w->d->address);
        }
    }
    relight_close(c);
    return NULL;
}

static unsigned files_in(const struct daemon *d, const char *name)
{
    char path[160];
    unsigned n = 0;
    snprintf(path, sizeof path, "%s/%s", d->data, name);
    DIR *dir = opendir(path);
    for (struct dirent *e; dir && (e = readdir(dir));) n += e->d_name[0] != '.';
    if (dir) closedir(dir);
    return n;
}

// All models forgotten: nothing of them is left in memory, on disk or in the books.
static void check_empty(struct daemon *d)
{
    struct relight_client *c = client_open(d->address);
    struct relight_error error;
    struct relight_list list;
    double disk = 0;
    OK(relight_list(c, false, &list, &error));
    for (size_t i = 0; i < list.n_model; i++)
        OK(relight_unload(c, list.model[i].id, true, NULL, &error));
    relight_list_finish(&list);
    for (int i = 0; i < 500; i++) { // what is under way comes to its end
        disk = metric(c, "relightd_disk_bytes");
        if (metric(c, "relightd_models_bytes") == 0 && metric(c, "relightd_jobs_open") == 0 &&
            !files_in(d, "previews") && !files_in(d, "bakes") && !files_in(d, "work"))
            break;
        sleep_ms(20);
    }
    assert_true(metric(c, "relightd_models_bytes") == 0);
    assert_int_equal(files_in(d, "previews"), 0);
    assert_int_equal(files_in(d, "bakes"), 0);
    assert_int_equal(files_in(d, "work"), 0);
    assert_int_equal(files_in(d, "models"), 0);
    if (disk != 2 * 4096) // the upload alone: a block of bytes and one with its owner
        fail_msg("%g bytes are said to be on disk", disk);
    relight_close(c);
}

static void run(unsigned first, const char *const extra[])
{
    static struct daemon d;
    static struct worker worker[N_CLIENT];
    char path[160], wrong[640] = "";
    unsigned done = 0, refused = 0;
    daemon_folder(&d);
    daemon_start(&d, extra);
    snprintf(path, sizeof path, "%s/stress.obj", d.folder);
    write_text(path, octahedron);
    for (unsigned i = 0; i < N_CLIENT; i++) {
        worker[i] = (struct worker){.d = &d, .number = first + i, .seed = 1 + first + i};
        assert_int_equal(pthread_create(&worker[i].thread, NULL, race, &worker[i]), 0);
    }
    for (unsigned i = 0; i < N_CLIENT; i++) {
        pthread_join(worker[i].thread, NULL);
        done += worker[i].done;
        for (int k = 0; k < N_CODE; k++) refused += worker[i].refused[k];
        if (worker[i].wrong[0]) snprintf(wrong, sizeof wrong, "%s", worker[i].wrong);
    }
    print_message("%u done, %u refused\n", done, refused);
    if (!wrong[0]) check_empty(&d);
    assert_int_equal(daemon_end(&d), 0);
    daemon_remove(&d);
    if (wrong[0]) fail_msg("%s", wrong);
    assert_true(done > 20);
}

static void test_previews(void **state)
{
    run(0, NULL);
}

static void test_bakes_without_room(void **state)
{
    static const char *const extra[] = {
        "--memory", "100k", "--cache", "300k", "--bakes-disk", "200k", "--bakes", "2", NULL};
    run(10, extra);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_previews),
        cmocka_unit_test(test_bakes_without_room),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("stress", tests, NULL, NULL);
}
