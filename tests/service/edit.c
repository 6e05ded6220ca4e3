// SPDX-License-Identifier: MIT
// Material editing through the daemon: a joint and a polynomial model take media and lights over
// the socket, views follow a dragged slider, what is out of range is refused or told.
#include "daemon.h"

#include <math.h>

static struct daemon d;
static char joint[32], polynomial[32];

static const char wax[] = "{\"name\":\"wax\",\"profile\":\"burley\",\"albedo\":[0.9,0.7,0.4],"
                          "\"mean_free_path\":[0.6,0.5,0.4]}";

static void bake(struct relight_client *client, const char *name, const char *material,
                 enum relight_transport transport, const char *env, char id[32])
{
    struct relight_error error;
    struct relight_loaded loaded;
    char path[160];
    snprintf(path, sizeof path, "%s/%s", d.folder, name);
    write_text(path, octahedron);
    struct relight_load load = {.size_mm = 10, .material = material,
                                .bake = {.samples = 2000, .cube = 16, .single_points = 2,
                                         .phase_terms = 1, .transport = transport, .env = env}};
    OK(relight_load_file(client, path, &load, NULL, NULL, &loaded, &error));
    snprintf(id, 32, "%s", loaded.model);
    if (loaded.job[0]) OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
}

static int group_setup(void **state)
{
    daemon_folder(&d);
    daemon_start(&d, NULL);
    struct relight_client *client = client_open(d.address);
    bake(client, "joint.obj", NULL, RELIGHT_TRANSPORT_DEFAULT, NULL, joint);
    bake(client, "poly.obj", "skin1", RELIGHT_TRANSPORT_POLYNOMIAL, "constant:1,2,3", polynomial);
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
               const char *material, float max_error, float out[18], float *bound,
               struct relight_error *error)
{
    struct relight_colors colors;
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {
        .model = model, .n_light = env ? 1 : 0, .lights = &light,
        .shade = {.material = material, .term = RELIGHT_TERM_MULTIPLE, .max_error = max_error}};
    int status = relight_colors(client, &request, &colors, error);
    if (status) return status;
    assert_int_equal(colors.n_vertex, OCTAHEDRON_VERTICES);
    assert_int_equal(relight_colors_decode(&colors, 0, out), 0);
    if (bound) *bound = colors.cost.error_bound;
    relight_colors_finish(&colors);
    return 0;
}

static void read_csv(const char *path, float out[18])
{
    char *text = read_text(path), *line = strchr(text, '\n');
    for (int v = 0; v < OCTAHEDRON_VERTICES; v++) {
        int vertex;
        assert_non_null(line);
        assert_int_equal(sscanf(line + 1, "%d,%f,%f,%f", &vertex, out + 3 * v, out + 3 * v + 1,
                                out + 3 * v + 2),
                         4);
        line = strchr(line + 1, '\n');
    }
    free(text);
}

static void assert_close(const float *a, const float *b, float tolerance)
{
    for (int k = 0; k < 18; k++)
        if (!(fabsf(a[k] - b[k]) <= tolerance * fabsf(b[k]) + 1e-7f))
            fail_msg("colour %d: %g, expected %g", k, (double)a[k], (double)b[k]);
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
        float want[18], got[18];
        snprintf(path, sizeof path, "%s/want.csv", d.folder);
        snprintf(command, sizeof command,
                 PRT_BINARY_DIR "/prt colors %s/bakes/%s.prt --env %s --material %s -q -o %s", d.data,
                 joint, env[i / 2], material[i % 2], path);
        assert_int_equal(system(command), 0);
        read_csv(path, want);
        snprintf(path, sizeof path, "%s/got.csv", d.folder);
        snprintf(command, sizeof command,
                 PRT_BINARY_DIR "/relight -s %s edit %s --env %s --material %s -o %s >/dev/null",
                 d.address, joint, env[i / 2], material[i % 2], path);
        assert_int_equal(system(command), 0);
        read_csv(path, got);
        assert_close(got, want, 1e-4f);
        assert_true(got[0] > 0);
    }
}

static void test_polynomial_keeps_its_light(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    float a[18], b[18], bound;
    OK(ask(client, polynomial, NULL, "skin1", 0, a, &bound, &error));
    assert_true(bound > 0 && bound < 0.2f);
    OK(ask(client, polynomial, NULL, wax, 0, b, &bound, &error));
    assert_true(b[0] > 1.2f * a[0]); // wax reflects more red
    assert_true(ask(client, polynomial, "constant", "skin1", 0, a, NULL, &error) != 0);
    assert_int_equal(error.code, RELIGHT_E_MISMATCH);
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
        {"{\"profile\":\"burley\",\"albedo\":0.5,\"mean_free_path\":-1}", RELIGHT_E_OUT_OF_RANGE,
         "allowed range 0.001 to 10000 mm"},
        {"marble", RELIGHT_E_MISMATCH, "eta is 1.5, this bake is for 1.3"},
        {"{\"profile\":\"curve\",\"file\":\"/etc/passwd\"}", RELIGHT_E_OUT_OF_RANGE,
         "not allowed here"},
    };
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    float out[18], usual, bound;
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        for (int k = 0; k < 2; k++) {
            int status = ask(client, k ? polynomial : joint, k ? NULL : "constant", row[i].json, 0,
                             out, NULL, &error);
            assert_true(status != 0);
            assert_int_equal(error.code, row[i].code);
            if (!strstr(error.text, row[i].says)) fail_msg("%s: %s", row[i].json, error.text);
        }
    OK(ask(client, joint, "constant", "skin1", 0, out, &usual, &error));
    const char *far = "{\"sigma_s_prime\":[40,40,40],\"sigma_a\":[0.1,0.1,0.1]}";
    OK(ask(client, joint, "constant", far, 0, out, &bound, &error));
    print_message("bound %.4f in range, %.4f beyond\n", (double)usual, (double)bound);
    assert_true(bound > usual + 0.001f && bound < usual + 2);
    assert_true(ask(client, joint, "constant", far, 0.5f * (usual + bound), out, NULL, &error) != 0);
    assert_int_equal(error.code, RELIGHT_E_OUT_OF_RANGE);
    assert_non_null(strstr(error.text, "max_error"));
    relight_close(client);
}

// A slider dragged through forty media: the last state is drawn, none is drawn after it.
static void test_slider(void **state)
{
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    struct relight_view *view;
    struct relight_light light = {.env = "constant:1,1,1"};
    struct relight_view_request request = {.model = joint, .n_light = 1, .lights = &light,
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
    float out[18] = {0}, want[18];
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
    assert_close(out, want, 1e-5f);
    // a state that cannot be drawn is told, and the view goes on
    struct relight_shade bad = {.term = RELIGHT_TERM_MULTIPLE, .material = "marble"};
    OK(relight_view_set(view, 0, NULL, &bad, NULL, &sequence, &error));
    struct relight_frame_out frame;
    int status = relight_view_next(view, 20, &frame, &error);
    assert_true(status != 0);
    assert_int_equal(error.code, RELIGHT_E_MISMATCH);
    struct relight_shade good = {.term = RELIGHT_TERM_MULTIPLE, .material = "cream"};
    OK(relight_view_set(view, 0, NULL, &good, NULL, &sequence, &error));
    do {
        OK(relight_view_next(view, 20, &frame, &error));
        seen = frame.sequence;
        OK(relight_colors_decode(&frame.colors, 0, out));
        relight_frame_out_finish(&frame);
    } while (seen < sequence);
    OK(ask(client, joint, "constant:1,2,0.5", "cream", 0, want, NULL, &error));
    assert_close(out, want, 1e-5f);
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
    char id[32], again[32];
    float out[18], bound;
    bake(client, "wax.obj", wax, RELIGHT_TRANSPORT_WAVELET, NULL, id);
    OK(ask(client, id, "constant", NULL, 0, out, &bound, &error));
    assert_true(out[0] > out[1] && out[1] > out[2] && out[2] > 0);
    OK(relight_info(client, id, &info, &error));
    assert_non_null(strstr(info.material, "\"profile\""));
    bake(client, "wax.obj", info.material, RELIGHT_TRANSPORT_WAVELET, NULL, again);
    assert_string_equal(again, id); // the same medium, so the same bake
    relight_model_finish(&info);
    assert_true(ask(client, id, "constant", "skin1", 0, out, NULL, &error) != 0);
    assert_int_equal(error.code, RELIGHT_E_MISMATCH);
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
    };
    return cmocka_run_group_tests(tests, group_setup, group_teardown);
}
