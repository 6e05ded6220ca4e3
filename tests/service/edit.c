// SPDX-License-Identifier: MIT
// Material editing through the daemon: a joint and a polynomial model take media and lights
// over the socket, views follow a dragged slider, what is out of range is refused or told.
#include "ask.h"

static struct daemon d;
static char joint[ID_SIZE], polynomial[ID_SIZE];

static const char wax[] = "{\"name\":\"wax\",\"profile\":\"burley\",\"albedo\":[0.9,0.7,0.4],"
                          "\"mean_free_path\":[0.6,0.5,0.4]}";

static const char slab_text[] = "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":2,"
                                "\"sigma_s_prime\":[%g,1.5,2],\"sigma_a\":[0.02,0.05,0.1]},"
                                "{\"sigma_s_prime\":[2,2,3],\"sigma_a\":[0.1,0.2,0.3]}]}";

static void bake(struct relight_client *client, const char *name, const char *material,
                 enum relight_transport transport, const char *env, char id[ID_SIZE])
{
    struct relight_load load = {.size_mm = 10,
                                .material = material,
                                .bake = {.samples = 2000,
                                         .cube = 16,
                                         .single_points = 2,
                                         .phase_terms = 1,
                                         .transport = transport,
                                         .env = env}};
    bake_octahedron(client, &d, name, &load, id);
}

static int group_setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake(client, "joint.obj", NULL, RELIGHT_TRANSPORT_DEFAULT, NULL, joint);
    bake(client, "poly.obj", "skin1", RELIGHT_TRANSPORT_POLYNOMIAL, "constant:1,2,3",
         polynomial);
    relight_close(client);
    return 0;
}

static int group_teardown(void **state)
{
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

static int ask(struct relight_client *client, const char *model, const char *env,
               const char *material, float max_error, float out[N_COLOR], float *bound,
               struct relight_error *error)
{
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {
        .model = model,
        .n_light = env ? 1 : 0,
        .lights = &light,
        .shade = {.material = material, .term = RELIGHT_TERM_MULTIPLE, .max_error = max_error}};
    return ask_colors(client, &request, out, bound, error);
}

// A load that names no material leaves it open: joint transport.
static void test_open_by_default(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    OK(relight_info(client, joint, &info, &error));
    assert_string_equal(info.engine, "joint");
    relight_model_finish(&info);
    relight_close(client);
}

// relight edit writes what prt colors writes, for a preset, for a profile, under new lights.
static void test_edit_equals_prt(void **state)
{
    static const char *const env[] = {"constant:1,0.5,0.25", "constant:3,3,1"};
    char path[160], json[160], command[900];
    snprintf(json, sizeof json, "%s/wax.json", d.folder);
    write_text(json, wax);
    const char *const material[] = {"ketchup", json};
    for (int i = 0; i < 4; i++) {
        float want[N_COLOR], got[N_COLOR];
        snprintf(path, sizeof path, "%s/want.csv", d.folder);
        snprintf(command, sizeof command,
                 PRT_BINARY_DIR "/prt colors %s/bakes/%s.prt --env %s --material %s -q -o %s",
                 d.data, joint, env[i / 2], material[i % 2], path);
        assert_int_equal(system(command), 0);
        read_csv(path, want);
        snprintf(path, sizeof path, "%s/got.csv", d.folder);
        snprintf(command, sizeof command,
                 PRT_BINARY_DIR
                 "/relight -s %s edit %s --env %s --material %s -o %s >/dev/null",
                 d.address, joint, env[i / 2], material[i % 2], path);
        assert_int_equal(system(command), 0);
        read_csv(path, got);
        assert_close(got, want, N_COLOR, 1e-4f);
        assert_true(got[0] > 0);
    }
}

static void test_polynomial_keeps_its_light(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    float a[N_COLOR], b[N_COLOR], bound;
    OK(ask(client, polynomial, NULL, "skin1", 0, a, &bound, &error));
    assert_true(bound > 0 && bound < 0.2f);
    OK(ask(client, polynomial, NULL, wax, 0, b, &bound, &error));
    assert_true(b[0] > 1.2f * a[0]); // wax reflects more red
    expect(ask(client, polynomial, "constant", "skin1", 0, a, NULL, &error), RELIGHT_E_MISMATCH,
           &error, NULL);
    relight_close(client);
}

// Told with its bound, or refused by parameter, range and unit; nothing in between.
static void test_out_of_range(void **state)
{
    static const struct {
        const char *json;
        int code;
        const char *says;
    } row[] = {
        {"{\"sigma_s_prime\":[900,1,1],\"sigma_a\":[0,0,0]}", RELIGHT_E_OUT_OF_RANGE,
         "sigma_s_prime[0] is 900, this bake covers 0.02 to 25 mm^-1"},
        {"{\"sigma_s_prime\":[1,1,1],\"sigma_a\":[300,300,300]}", RELIGHT_E_OUT_OF_RANGE,
         "this bake covers 0 to 2 mm^-1"},
        {"{\"sigma_s_prime\":[-1,1,1],\"sigma_a\":[0,0,0]}", RELIGHT_E_OUT_OF_RANGE,
         "allowed range 1e-05 to 1000 mm^-1"},
        {"{\"profile\":\"burley\",\"albedo\":0.5,\"mean_free_path\":-1}",
         RELIGHT_E_OUT_OF_RANGE, "allowed range 0.001 to 10000 mm"},
        {"marble", RELIGHT_E_MISMATCH, "eta is 1.5, this bake is for 1.3"},
        {"{\"profile\":\"curve\",\"file\":\"/etc/passwd\"}", RELIGHT_E_OUT_OF_RANGE,
         "not allowed here"},
    };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    float out[N_COLOR], usual, bound;
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        for (int k = 0; k < 2; k++) {
            expect(ask(client, k ? polynomial : joint, k ? NULL : "constant", row[i].json, 0,
                       out, NULL, &error),
                   row[i].code, &error, row[i].says);
        }
    OK(ask(client, joint, "constant", "skin1", 0, out, &usual, &error));
    const char *far = "{\"sigma_s_prime\":[40,40,40],\"sigma_a\":[0.1,0.1,0.1]}";
    OK(ask(client, joint, "constant", far, 0, out, &bound, &error));
    print_message("bound %.4f in range, %.4f beyond\n", (double)usual, (double)bound);
    assert_true(bound > usual + 0.001f && bound < usual + 2);
    expect(ask(client, joint, "constant", far, 0.5f * (usual + bound), out, NULL, &error),
           RELIGHT_E_OUT_OF_RANGE, &error, "max_error");
    relight_close(client);
}

// A slider dragged through forty media: the last state is drawn, none is drawn after it.
static void test_slider(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_view *view;
    struct relight_light light = {.env = "constant:1,1,1"};
    struct relight_view_request request = {.model = joint,
                                           .n_light = 1,
                                           .lights = &light,
                                           .shade = {.term = RELIGHT_TERM_MULTIPLE},
                                           .colors = true};
    OK(relight_view_open(client, &request, &view, &error));
    uint64_t sequence = 0, seen = 0, frames, dropped;
    char text[120];
    for (int i = 1; i <= 40; i++) {
        snprintf(text, sizeof text, "{\"sigma_s_prime\":[%g,1,1],\"sigma_a\":[0.01,%g,0.2]}",
                 0.1 * i, 0.01 * i);
        struct relight_shade shade = {.term = RELIGHT_TERM_MULTIPLE, .material = text};
        OK(relight_view_set(view, 0, NULL, &shade, NULL, &sequence, &error));
    }
    light.env = "constant:1,2,0.5"; // and the light, while the material stays
    OK(relight_view_set(view, 1, &light, NULL, NULL, &sequence, &error));
    float out[N_COLOR] = {0}, want[N_COLOR];
    while (seen < sequence) {
        struct relight_frame_out frame;
        OK(relight_view_next(view, 20, &frame, &error));
        assert_true(frame.has_colors);
        assert_true(frame.sequence >= seen);
        seen = frame.sequence;
        OK(relight_colors_decode(&frame.colors, 0, out));
        relight_frame_out_finish(&frame);
    }
    OK(ask(client, joint, "constant:1,2,0.5", text, 0, want, NULL, &error));
    assert_close(out, want, N_COLOR, 1e-5f);
    // a state that cannot be drawn is told, and the view goes on
    struct relight_shade bad = {.term = RELIGHT_TERM_MULTIPLE, .material = "marble"};
    OK(relight_view_set(view, 0, NULL, &bad, NULL, &sequence, &error));
    struct relight_frame_out frame;
    expect(relight_view_next(view, 20, &frame, &error), RELIGHT_E_MISMATCH, &error, NULL);
    struct relight_shade good = {.term = RELIGHT_TERM_MULTIPLE, .material = "cream"};
    OK(relight_view_set(view, 0, NULL, &good, NULL, &sequence, &error));
    do {
        OK(relight_view_next(view, 20, &frame, &error));
        seen = frame.sequence;
        OK(relight_colors_decode(&frame.colors, 0, out));
        relight_frame_out_finish(&frame);
    } while (seen < sequence);
    OK(ask(client, joint, "constant:1,2,0.5", "cream", 0, want, NULL, &error));
    assert_close(out, want, N_COLOR, 1e-5f);
    OK(relight_view_close(view, &frames, &dropped, &error));
    assert_true(frames >= 2 && frames <= 44);
    relight_close(client);
}

// A wavelet bake in a profile: answered, its material told as JSON that reads back.
static void test_profile_bakes(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_model info;
    char id[ID_SIZE], again[ID_SIZE];
    float out[N_COLOR], bound;
    bake(client, "wax.obj", wax, RELIGHT_TRANSPORT_WAVELET, NULL, id);
    OK(ask(client, id, "constant", NULL, 0, out, &bound, &error));
    assert_true(out[0] > out[1] && out[1] > out[2] && out[2] > 0);
    OK(relight_info(client, id, &info, &error));
    assert_non_null(strstr(info.material, "\"profile\""));
    bake(client, "wax.obj", info.material, RELIGHT_TRANSPORT_WAVELET, NULL, again);
    assert_string_equal(again, id); // the same medium, so the same bake
    relight_model_finish(&info);
    expect(ask(client, id, "constant", "skin1", 0, out, NULL, &error), RELIGHT_E_MISMATCH,
           &error, NULL);
    relight_close(client);
}

// A light that comes again is contracted once, for all materials, terms and formats; the
// answers are those of a plain pass, which the same light under another name gets.
static void test_lights_contracted_once(void **state)
{
    static const struct {
        const char *material;
        enum relight_term term;
        bool eye;
    } row[] = {{"skin1", RELIGHT_TERM_TOTAL, false},  {"ketchup", RELIGHT_TERM_TOTAL, false},
               {"ketchup", RELIGHT_TERM_TOTAL, true}, {"ketchup", RELIGHT_TERM_SINGLE, false},
               {wax, RELIGHT_TERM_MULTIPLE, false},   {"skin2", RELIGHT_TERM_MULTIPLE, false}};
    enum { N = sizeof row / sizeof *row };
    static float cube[CUBE_FLOATS], twice[CUBE_FLOATS];
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    double contracted = metric(client, "relightd_lights_contracted_total");
    double edits = metric(client, "relightd_edits_total");
    fill_cube(cube);
    for (int i = 0; i < CUBE_FLOATS; i++) twice[i] = 2 * cube[i];
    for (int i = 0; i < N; i++) {
        float got[N_COLOR], want[N_COLOR], gain = (float)(1 << i);
        struct relight_light light = {.cube_n = 16, .cube = cube, .gain = {1, 1, 1}};
        struct relight_colors_request request = {.model = joint,
                                                 .n_light = 1,
                                                 .lights = &light,
                                                 .shade = {.material = row[i].material,
                                                           .term = row[i].term,
                                                           .has_eye = row[i].eye,
                                                           .eye = {3, 2, 4}}};
        OK(ask_colors(client, &request, got, NULL, &error));
        light = (struct relight_light){
            .cube_n = 16, .cube = twice, .gain = {0.5f * gain, 0.5f * gain, 0.5f * gain}};
        OK(ask_colors(client, &request, want, NULL, &error));
        for (int k = 0; k < N_COLOR; k++) want[k] /= gain; // powers of two: exact
        assert_close(got, want, N_COLOR, 1e-5f);
        assert_true(got[0] > 0);
    }
    assert_true(metric(client, "relightd_lights_contracted_total") == contracted + 1);
    assert_true(metric(client, "relightd_edits_total") == edits + N - 1);
    relight_close(client);
}

// Ketchup under a light, and two other materials before so that the light is contracted.
static void ask_under(struct relight_client *client, const float *cube, float gain,
                      bool contracted, float *out)
{
    struct relight_error error;
    struct relight_light light = {.cube_n = 16, .cube = cube, .gain = {gain, gain, gain}};
    struct relight_colors_request request = {
        .model = joint, .n_light = 1, .lights = &light, .shade = {.material = "chicken1"}};
    if (contracted) OK(ask_colors(client, &request, out, NULL, &error));
    request.shade.material = "chicken2";
    if (contracted) OK(ask_colors(client, &request, out, NULL, &error));
    request.shade.material = "ketchup";
    OK(ask_colors(client, &request, out, NULL, &error));
}

// A material that stays under ever new lights is put into the transport: answers are as near as
// that says, and nobody waited for it.
static void test_material_put_in(void **state)
{
    enum { LIGHTS = 100 };
    static float cube[CUBE_FLOATS], twice[CUBE_FLOATS];
    struct relight_client *client = client_open(d.address);
    double made = metric(client, "relightd_materials_fixed_total");
    double used = metric(client, "relightd_relights_fixed_total"), n = 0;
    fill_cube(cube);
    for (int i = 0; i < CUBE_FLOATS; i++) twice[i] = 2 * cube[i];
    for (int i = 0; i < LIGHTS && n < 4; i++) {
        float got[N_COLOR], want[N_COLOR], gain = 3 + 0.125f * (float)i;
        ask_under(client, cube, gain, false, got);
        double now = metric(client, "relightd_relights_fixed_total") - used;
        if (now > n) {
            ask_under(client, twice, 0.5f * gain, true, want);
            assert_close(got, want, N_COLOR, 1e-2f);
            assert_true(metric(client, "relightd_relights_fixed_total") - used == now);
        }
        n = now;
        usleep(i > 8 ? 50000 : 0);
    }
    assert_true(n >= 4);
    double all = metric(client, "relightd_materials_fixed_total");
    assert_true(all >= 1 && all <= made + 1); // an earlier test may have had it put in
    relight_close(client);
}

// What is contracted counts against --cache and goes when that is spent; it keeps no transport
// in memory that --memory has no room for.
static void test_contracted_lights_leave(void **state)
{
    static const char *const extra[] = {"--cache", "96k", "--memory", "1k", NULL};
    static const char *const material[] = {"skin1", "ketchup", "skin2"};
    static struct daemon small;
    char command[400];
    daemon_folder(&small);
    snprintf(command, sizeof command, "cp %s/bakes/%s.prt %s/joint.prt", d.data, joint,
             small.models);
    assert_int_equal(system(command), 0);
    daemon_start(&small, extra);
    struct relight_client *client = client_open(d.address), *other = client_open(small.address);
    struct relight_error error;
    for (int i = 0; i < 40; i++)
        for (int k = 0; k < 3; k++) {
            float got[N_COLOR], want[N_COLOR];
            char env[40];
            snprintf(env, sizeof env, "constant:1,%d,2", 1 + i % 20);
            OK(ask(other, "joint", env, material[k], 0, got, NULL, &error));
            if (i % 8) continue;
            OK(ask(client, joint, env, material[k], 0, want, NULL, &error));
            assert_close(got, want, N_COLOR, 1e-2f); // this one may have put the material in
        }
    assert_true(metric(other, "relightd_lights_contracted_total") >= 20);
    assert_true(metric(other, "relightd_cache_evictions_total") > 0);
    assert_true(metric(other, "relightd_cache_bytes") <= 96 << 10);
    assert_true(metric(other, "relightd_models_bytes") == 0);
    relight_close(client);
    relight_close(other);
    assert_int_equal(daemon_end(&small), 0);
    daemon_remove(&small);
}

// A layered slab takes a tenth of a second to work out, of one worker: others are answered
// meanwhile.
static void test_slow_materials_hold_nobody_up(void **state)
{
    struct relight_client *client = client_open(d.address), *other = client_open(d.address);
    struct relight_error error;
    double best = INFINITY;
    for (int i = 0; i < 6 && best > 0.5; i++) {
        char slab[300];
        struct relight_light light = {.env = "constant"};
        struct relight_colors_request request = {
            .model = joint, .n_light = 1, .lights = &light, .shade.material = slab};
        struct relight_colors colors;
        struct timespec t0, t1, t2;
        uint64_t id;
        double seconds;
        snprintf(slab, sizeof slab, slab_text, 1.0 + 0.01 * i);
        clock_gettime(CLOCK_MONOTONIC, &t0);
        OK(relight_colors_begin(client, &request, 0, &id, &error));
        sleep_ms(2);
        OK(relight_ping(other, &seconds, &error));
        clock_gettime(CLOCK_MONOTONIC, &t1);
        OK(relight_colors_end(client, id, &colors, &error));
        clock_gettime(CLOCK_MONOTONIC, &t2);
        relight_colors_finish(&colors);
        double pinged =
            (double)(t1.tv_sec - t0.tv_sec) + 1e-9 * (double)(t1.tv_nsec - t0.tv_nsec);
        double answered =
            (double)(t2.tv_sec - t0.tv_sec) + 1e-9 * (double)(t2.tv_nsec - t0.tv_nsec);
        best = fmin(best, pinged / answered);
    }
    print_message("a ping beside a new slab took %.2f of its time\n", best);
    assert_true(best < 0.5);
    relight_close(client);
    relight_close(other);
}

// What a connection says of a view keeps its order, however long a material takes.
static void test_slow_materials_keep_their_order(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_view *view;
    struct relight_light light = {.env = "constant:1,2,1"};
    char slab[300], last[300];
    float out[N_COLOR] = {0}, want[N_COLOR];
    uint64_t sequence = 0, seen = 0, frames, dropped;
    snprintf(slab, sizeof slab, slab_text, 2.0);
    struct relight_view_request request = {
        .model = joint,
        .n_light = 1,
        .lights = &light,
        .colors = true,
        .shade = {.term = RELIGHT_TERM_MULTIPLE, .material = slab}};
    OK(relight_view_open(client, &request, &view, &error));
    for (int i = 0; i < 9; i++) {
        if (i % 3)
            snprintf(last, sizeof last,
                     "{\"sigma_s_prime\":[%d,1,1],\"sigma_a\":[0.1,0.1,0.2]}", i + 1);
        else snprintf(last, sizeof last, slab_text, 2.1 + 0.1 * i);
        struct relight_shade shade = {.term = RELIGHT_TERM_MULTIPLE, .material = last};
        OK(relight_view_set(view, 0, NULL, &shade, NULL, &sequence, &error));
    }
    while (seen < sequence) {
        struct relight_frame_out frame;
        OK(relight_view_next(view, 20, &frame, &error));
        assert_true(frame.sequence >= seen);
        seen = frame.sequence;
        OK(relight_colors_decode(&frame.colors, 0, out));
        relight_frame_out_finish(&frame);
    }
    OK(ask(client, joint, "constant:1,2,1", last, 0, want, NULL, &error));
    assert_close(out, want, N_COLOR, 1e-5f);
    // Closed, or its client gone without a word, while a material is worked out.
    snprintf(last, sizeof last, slab_text, 4.0);
    struct relight_shade shade = {.term = RELIGHT_TERM_MULTIPLE, .material = last};
    OK(relight_view_set(view, 0, NULL, &shade, NULL, &sequence, &error));
    OK(relight_view_close(view, &frames, &dropped, &error));
    snprintf(slab, sizeof slab, slab_text, 5.0);
    pid_t gone = fork();
    if (!gone) {
        client = client_open(d.address);
        _exit(relight_view_open(client, &request, &view, &error) ? 1 : 0);
    }
    int how = 1;
    assert_int_equal(waitpid(gone, &how, 0), gone);
    assert_int_equal(how, 0);
    // One that is refused is refused as ever, also when it is known already.
    for (int i = 0; i < 2; i++)
        expect(ask(client, joint, "constant", "{\"profile\":\"multipole\",\"layers\":[]}", 0,
                   out, NULL, &error),
               RELIGHT_E_OUT_OF_RANGE, &error, "layers");
    relight_close(client);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_open_by_default),
        cmocka_unit_test(test_edit_equals_prt),
        cmocka_unit_test(test_polynomial_keeps_its_light),
        cmocka_unit_test(test_out_of_range),
        cmocka_unit_test(test_slider),
        cmocka_unit_test(test_profile_bakes),
        cmocka_unit_test(test_lights_contracted_once),
        cmocka_unit_test(test_contracted_lights_leave),
        cmocka_unit_test(test_material_put_in),
        cmocka_unit_test(test_slow_materials_hold_nobody_up),
        cmocka_unit_test(test_slow_materials_keep_their_order),
    };
    return cmocka_run_group_tests(tests, group_setup, group_teardown);
}
