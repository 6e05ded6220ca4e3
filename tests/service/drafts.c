// SPDX-License-Identifier: MIT
// Drafts: a real relightd answers with an image-space engine, then with a draft, then with the
// bake, in one view and without a step; each is as right as it says. A draft and its bake are
// one job, which is cancelled as one and outlives the daemon.
#include "ask.h"

#include <math.h>

enum { SIDE = 48, N_PIXEL = SIDE * SIDE, N_VALUE = 3 * N_PIXEL, FADE_FRAMES = 12 };

static struct daemon d;
static struct relight_client *client;
static struct relight_error error;

// The fewest samples and the smallest light that a draft comes before.
static struct relight_load drafted_bake(uint64_t seed)
{
    struct relight_load load = small_bake(seed, 40000);
    load.bake.cube = 32;
    return load;
}

static void load_drafted(uint64_t seed, const struct relight_load *load, char id[ID_SIZE],
                         char job[64])
{
    struct relight_load own = load ? *load : drafted_bake(seed);
    struct relight_loaded loaded;
    OK(load_octahedron(client, &d, "drafted.obj", &own, &loaded, &error));
    snprintf(id, ID_SIZE, "%s", loaded.model);
    snprintf(job, 64, "%s", loaded.job);
    assert_int_equal(loaded.state, RELIGHT_MODEL_BAKING);
    relight_loaded_finish(&loaded);
}

static struct relight_model info_of(const char *model)
{
    struct relight_model m;
    OK(relight_info(client, model, &m, &error));
    return m;
}

static bool has_draft(const char *model)
{
    struct relight_model m = info_of(model);
    bool draft = m.draft;
    relight_model_finish(&m);
    return draft;
}

static void wait_for_draft(const char *model)
{
    for (int i = 0; i < 30000 && !has_draft(model); i++) sleep_ms(20);
    assert_true(has_draft(model));
}

// ---- one view, from the first picture to the bake's

enum phase { IMAGE_SPACE, DRAFT, FADE, BAKE, N_PHASE };

static enum phase phase_of(const struct relight_cost *cost)
{
    if (cost->engine >= RELIGHT_ENGINE_SPLAT) return IMAGE_SPACE;
    if (!cost->draft) return BAKE;
    // A draft's picture may end when the bake has: its bake_fraction is 1, too.
    return strncmp(cost->note, "the bake replaces", 17) ? DRAFT : FADE;
}

static float half(uint16_t h)
{
    int e = h >> 10 & 31, m = h & 1023;
    float x = e ? ldexpf((float)(m + 1024), e - 25) : ldexpf((float)m, -24);
    return h & 0x8000 ? -x : x;
}

static void pixels(const struct relight_image *image, float out[N_VALUE])
{
    assert_int_equal((int)image->n_byte, 2 * N_VALUE);
    for (int i = 0; i < N_VALUE; i++) {
        uint16_t h;
        memcpy(&h, (const uint8_t *)image->data + 2 * i, 2);
        out[i] = half(h);
    }
}

static double largest_difference(const float *a, const float *b, int n)
{
    double most = 0;
    for (int i = 0; i < n; i++) most = fmax(most, fabs((double)a[i] - (double)b[i]));
    return most;
}

static double rms_difference(const float *got, const float *want, int n)
{
    double off = 0, all = 0;
    for (int i = 0; i < n; i++) {
        off += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)want[i]);
        all += (double)want[i] * (double)want[i];
    }
    return sqrt(off / all);
}

static const struct relight_light sky = {.env = "constant:1,0.8,0.5"};

static struct relight_colors_request colors_request(const char *model, enum relight_term term)
{
    return (struct relight_colors_request){
        .model = model, .n_light = 1, .lights = &sky, .shade = {.term = term}};
}

// Colours of a term with their bound.
static float colors_of(const char *model, enum relight_term term, float out[N_COLOR])
{
    struct relight_colors_request r = colors_request(model, term);
    float bound = 0;
    OK(ask_colors(client, &r, out, &bound, &error));
    return bound;
}

struct answers { // of one phase
    float multiple[N_COLOR], single[N_COLOR], total[N_COLOR];
    float bound_multiple, bound_single, bound_total;
};

static struct answers ask_all(const char *model)
{
    struct answers a;
    a.bound_single = colors_of(model, RELIGHT_TERM_SINGLE, a.single);
    a.bound_multiple = colors_of(model, RELIGHT_TERM_MULTIPLE, a.multiple);
    a.bound_total = colors_of(model, RELIGHT_TERM_TOTAL, a.total);
    return a;
}

// Colours of a draft under a pose are of the file's shape, and say so.
static void check_posed(const char *model)
{
    const float away[3] = {0, 30, 0};
    char pose[65];
    struct relight_colors colors;
    struct relight_colors_request r = colors_request(model, RELIGHT_TERM_TOTAL);
    OK(relight_put_pose(client, model, NULL, 2, 1, away, NULL, false, pose, &error));
    r.pose = pose;
    OK(relight_colors(client, &r, &colors, &error));
    assert_true(colors.cost.draft);
    assert_non_null(strstr(colors.cost.note, "before its vertices moved"));
    relight_colors_finish(&colors);
}

static struct answers ask_draft(const char *model)
{
    struct relight_colors_request r = colors_request(model, RELIGHT_TERM_TOTAL);
    float out[N_COLOR];
    struct answers a = ask_all(model);
    struct relight_model m = info_of(model);
    assert_int_equal(m.state, RELIGHT_MODEL_BAKING);
    assert_true(m.draft && m.cube == 16);
    assert_string_equal(m.engine, "wavelet");
    assert_true(fabs(m.error_bound - (double)a.bound_multiple) < 1e-6);
    relight_model_finish(&m);
    check_posed(model);
    r.shade = (struct relight_shade){.max_error = a.bound_total / 2};
    expect(ask_colors(client, &r, out, NULL, &error), RELIGHT_E_OUT_OF_RANGE, &error, "draft");
    return a;
}

// Both approximate the same radiance: they differ by no more than the sum of their bounds.
static void compare(const char *what, const float *draft, float draft_bound, const float *bake,
                    float bake_bound)
{
    double off = rms_difference(draft, bake, N_COLOR);
    print_message(
        "%s: the draft is %.2f %% off the bake; its bound is %.2f %%, the bake's %.2f "
        "%%\n",
        what, 100 * off, 100 * (double)draft_bound, 100 * (double)bake_bound);
    assert_true(draft_bound > 0 && off <= (double)(draft_bound + bake_bound));
}

static struct relight_view *open_view(const char *model)
{
    struct relight_view *view;
    struct relight_view_request r = {
        .model = model,
        .n_light = 1,
        .lights = &sky,
        .window = 1, // the next frame waits for this one to be taken
        .picture = {.width = SIDE, .height = SIDE, .format = RELIGHT_IMAGE_F16}};
    OK(relight_view_open(client, &r, &view, &error));
    return view;
}

struct fade {
    float first[N_VALUE], last[N_VALUE]; // the draft's last picture, the newest one
    double most;                         // between two frames
    unsigned n;
};

// LAW: the fade's k-th frame is (1 - k/12) draft + (k/12) bake, so each step is a twelfth of
// the difference; tone mapping and clamping are not in F16 pictures, halves round by 2^-11.
static void check_fade(const struct fade *fade)
{
    double all = largest_difference(fade->first, fade->last, N_VALUE), brightest = 0;
    for (int i = 0; i < N_VALUE; i++) brightest = fmax(brightest, (double)fade->last[i]);
    double bound = all / FADE_FRAMES + brightest / 1024;
    print_message("fade: %u frames, from draft to bake %.4f, largest step %.4f, bound %.4f\n",
                  fade->n, all, fade->most, bound);
    assert_int_equal(fade->n, FADE_FRAMES - 1);
    assert_true(all > 0.01 && fade->most <= bound);
}

static void test_image_space_then_draft_then_bake(void **state)
{
    char model[ID_SIZE], job[64];
    unsigned seen[N_PHASE] = {0};
    struct answers draft = {.bound_total = 0}, bake;
    struct fade fade = {.n = 0};
    enum phase phase = IMAGE_SPACE;
    double started = (double)time(NULL);
    load_drafted(1, NULL, model, job);
    struct relight_view *view = open_view(model);
    while (phase != BAKE && (double)time(NULL) < started + 2500) { // a bake may be slow
        struct relight_frame_out frame;
        float now[N_VALUE];
        if (relight_view_next(view, 5, &frame, &error)) continue;
        const struct relight_cost *cost = &frame.image.cost;
        enum phase next = phase_of(cost);
        assert_int_equal(frame.skipped, 0);
        pixels(&frame.image, now);
        if (next < phase) fail_msg("phase %d after %d: %s", next, phase, cost->note);
        if (next == DRAFT && !seen[DRAFT]) draft = ask_draft(model);
        if (next >= FADE)
            fade.most = fmax(fade.most, largest_difference(now, fade.last, N_VALUE));
        if (next <= DRAFT) memcpy(fade.first, now, sizeof now);
        memcpy(fade.last, now, sizeof now);
        fade.n += next == FADE;
        assert_true(cost->error_bound > 0);
        assert_true(next == BAKE || cost->note[0]);
        seen[phase = next]++;
        relight_frame_out_finish(&frame);
    }
    print_message("frames: %u by image space, %u draft, %u faded, %u bake\n", seen[0], seen[1],
                  seen[2], seen[3]);
    assert_true(seen[IMAGE_SPACE] && seen[DRAFT] && seen[BAKE]);
    OK(relight_view_close(view, NULL, NULL, &error));
    check_fade(&fade);
    assert_false(has_draft(model));
    bake = ask_all(model);
    compare("multiple", draft.multiple, draft.bound_multiple, bake.multiple,
            bake.bound_multiple);
    compare("single", draft.single, draft.bound_single, bake.single, bake.bound_single);
    compare("total", draft.total, draft.bound_total, bake.total, bake.bound_total);
    // Walks from six vertices leave the multiple scattering of both the same noise.
    assert_true(bake.bound_single < draft.bound_single && bake.bound_total < draft.bound_total);
}

// ---- one job

static int stop_at_bake(void *user, const struct relight_progress *p)
{
    bool *drafted = user;
    if (p->state != RELIGHT_JOB_RUNNING) return 0;
    if (!strncmp(p->stage, "draft-", 6)) *drafted = true;
    return !strncmp(p->stage, "irradiance", 10);
}

static int stop_at_draft(void *user, const struct relight_progress *p)
{
    return !strncmp(p->stage, "draft-", 6);
}

static void cancel(const char *model, const char *job)
{
    enum relight_job_state state;
    OK(relight_cancel_job(client, job, &state, &error));
    expect(relight_watch(client, job, NULL, NULL, &error), RELIGHT_E_CANCELLED, &error, NULL);
    struct relight_model m = info_of(model);
    assert_int_equal(m.state, RELIGHT_MODEL_FAILED);
    assert_false(m.draft);
    relight_model_finish(&m);
}

static void test_no_draft(void **state)
{
    char model[ID_SIZE], job[64];
    bool drafted = false;
    struct relight_load load = drafted_bake(2);
    load.no_draft = true;
    load_drafted(2, &load, model, job);
    expect(relight_watch(client, job, stop_at_bake, &drafted, &error), RELIGHT_E_CANCELLED,
           &error, NULL);
    assert_false(drafted || has_draft(model));
    cancel(model, job);
}

// CANCEL_JOB in the draft: the bake does not follow.
static void test_cancel_ends_both(void **state)
{
    char model[ID_SIZE], job[64];
    load_drafted(3, NULL, model, job);
    expect(relight_watch(client, job, stop_at_draft, NULL, &error), RELIGHT_E_CANCELLED, &error,
           NULL);
    cancel(model, job);
    assert_int_equal((int)metric(client, "relightd_jobs_running"), 0);
}

// SIGKILL behind the draft: it answers after the restart, is not made again, and counts as one
// job of the client, which may have one.
static void test_a_draft_survives(void **state)
{
    static const char *const one_bake[] = {"--client-jobs", "1", NULL};
    char model[ID_SIZE], other[ID_SIZE], job[64];
    float before[N_COLOR], after[N_COLOR];
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, one_bake);
    client = client_open(d.address);
    load_drafted(4, NULL, model, job);
    struct relight_loaded loaded;
    struct relight_load load = drafted_bake(5);
    expect(load_octahedron(client, &d, "drafted.obj", &load, &loaded, &error), RELIGHT_E_BUSY,
           &error, NULL);
    wait_for_draft(model);
    float bound = colors_of(model, RELIGHT_TERM_TOTAL, before);
    relight_close(client);
    kill(d.pid, SIGKILL);
    assert_int_equal(waitpid(d.pid, NULL, 0), d.pid);
    daemon_start(&d, one_bake);
    client = client_open(d.address);
    assert_true(has_draft(model));
    assert_true(fabsf(colors_of(model, RELIGHT_TERM_TOTAL, after) - bound) < 1e-6f);
    assert_close(after, before, N_COLOR, 1e-6f);
    bool drafted = false;
    expect(relight_watch(client, job, stop_at_bake, &drafted, &error), RELIGHT_E_CANCELLED,
           &error, NULL);
    assert_false(drafted);
    cancel(model, job);
    snprintf(other, sizeof other, "%s", model);
}

// A draft that fails fails nothing else.
static void test_a_draft_that_fails(void **state)
{
    char model[ID_SIZE], job[64], path[160], script[400];
    const char *const other[] = {"--prt", path, NULL};
    bool drafted = false;
    relight_close(client);
    assert_int_equal(daemon_stop(&d), 0);
    snprintf(path, sizeof path, "%s/prt", d.folder);
    snprintf(script, sizeof script,
             "#!/bin/sh\ncase $* in bake*) echo warning: odd >&2;; esac\n"
             "case $* in *--draft*) echo error: no >&2; exit 1;; esac\nexec %s/prt \"$@\"\n",
             PRT_BINARY_DIR);
    write_text(path, script);
    chmod(path, 0700);
    daemon_start(&d, other);
    client = client_open(d.address);
    load_drafted(6, NULL, model, job);
    expect(relight_watch(client, job, stop_at_bake, &drafted, &error), RELIGHT_E_CANCELLED,
           &error, NULL);
    assert_false(has_draft(model));
    assert_true(log_says(&d, "draft failed", 1000));
    OK(relight_watch(client, job, NULL, NULL, &error));
    // What draft and bake both warn of is told once.
    struct relight_model m = info_of(model);
    assert_int_equal(m.n_warning, 1);
    assert_string_equal(m.warning[0], "odd");
    relight_model_finish(&m);
}

static int setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    client = client_open(d.address);
    return 0;
}

static int teardown(void **state)
{
    relight_close(client);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_image_space_then_draft_then_bake),
        cmocka_unit_test(test_no_draft),
        cmocka_unit_test(test_cancel_ends_both),
        cmocka_unit_test(test_a_draft_survives),
        cmocka_unit_test(test_a_draft_that_fails),
    };
    return cmocka_run_group_tests_name("drafts", tests, setup, teardown);
}
