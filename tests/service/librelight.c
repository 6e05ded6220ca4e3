// SPDX-License-Identifier: MIT
// librelight with a live relightd: pipelining, inline lights, formats, views, cancelling,
// geometry that moves, stats. The model is a small ball, baked once at the start.
#include "daemon.h"

#include <math.h>

enum { RINGS = 16, SIDES = 24, N_VERTEX = 2 + (RINGS - 1) * SIDES };

static struct daemon d;
static struct relight_client *client;
static struct relight_error error;
static const struct relight_light white = {.env = "constant"};

static void write_ball(FILE *f)
{
    fputs("v 0 1 0\n", f);
    for (int i = 1; i < RINGS; i++) {
        double a = M_PI * i / RINGS;
        for (int j = 0; j < SIDES; j++) {
            double b = 2 * M_PI * j / SIDES;
            fprintf(f, "v %.7f %.7f %.7f\n", sin(a) * cos(b), cos(a), -sin(a) * sin(b));
        }
    }
    fputs("v 0 -1 0\n", f);
    for (int j = 0; j < SIDES; j++) {
        int k = (j + 1) % SIDES, south = N_VERTEX - 1 - SIDES;
        fprintf(f, "f 1 %d %d\n", 2 + j, 2 + k);
        for (int i = 0; i < RINGS - 2; i++) {
            int a = 2 + i * SIDES + j, b = 2 + i * SIDES + k;
            fprintf(f, "f %d %d %d\nf %d %d %d\n", a, a + SIDES, b, b, a + SIDES, b + SIDES);
        }
        fprintf(f, "f %d %d %d\n", N_VERTEX, 1 + south + k, 1 + south + j);
    }
}

static int start(void **state)
{
    char command[512], path[128];
    daemon_folder(&d);
    snprintf(path, sizeof path, "%s/ball.obj", d.models);
    FILE *f = fopen(path, "w");
    if (!f) return -1;
    write_ball(f);
    if (fclose(f)) return -1;
    snprintf(
        command, sizeof command,
        "%s/prt bake -q %s/ball.obj --size-mm 20 --material skin1 --samples 3000 --cube 16 "
        "--no-single -o %s/ball.prt >/dev/null",
        PRT_BINARY_DIR, d.models, d.models);
    if (system(command)) return -1;
    daemon_start(&d, NULL);
    client = client_open(d.address);
    struct relight_load load = {.path = "ball.prt", .name = "ball"};
    struct relight_loaded loaded;
    if (relight_load(client, &load, &loaded, &error)) {
        fprintf(stderr, "%s\n", error.text);
        return -1;
    }
    relight_loaded_finish(&loaded);
    return 0;
}

static int stop(void **state)
{
    relight_close(client);
    int status = daemon_end(&d);
    daemon_remove(&d);
    return status;
}

#define CALL(call)                                       \
    do {                                                 \
        if (call) fail_msg("%s: %s", #call, error.text); \
    } while (0)

static float *colors_of(const struct relight_light *lights, size_t n_light, bool sum,
                        enum relight_color_format format, uint32_t *n_plane)
{
    struct relight_colors_request request = {.model = "ball",
                                             .n_light = n_light,
                                             .lights = lights,
                                             .sum = sum,
                                             .format = format,
                                             .shade.term = RELIGHT_TERM_MULTIPLE};
    struct relight_colors colors;
    CALL(relight_colors(client, &request, &colors, &error));
    assert_int_equal(colors.n_vertex, N_VERTEX);
    float *out = malloc(colors.n_plane * N_VERTEX * 12);
    for (uint32_t i = 0; i < colors.n_plane; i++)
        assert_int_equal(relight_colors_decode(&colors, i, out + (size_t)i * N_VERTEX * 3), 0);
    if (n_plane) *n_plane = colors.n_plane;
    relight_colors_finish(&colors);
    return out;
}

static double rmse(const float *a, const float *b)
{
    double e = 0, s = 0;
    for (int i = 0; i < N_VERTEX * 3; i++) {
        e += (double)(a[i] - b[i]) * (a[i] - b[i]);
        s += (double)b[i] * b[i];
    }
    return sqrt(e / s);
}

// One light, however it is named; several planes and their sum.
static void lights(void **state)
{
    float *cube = malloc(16 * 16 * 18 * sizeof *cube);
    for (int i = 0; i < 16 * 16 * 18; i++) cube[i] = 1;
    struct relight_light two[2] = {{.env = "constant:1,1,1"}, {.cube_n = 16, .cube = cube}};
    uint32_t n_plane;
    float *one = colors_of(&white, 1, false, RELIGHT_COLOR_F32, &n_plane);
    assert_int_equal(n_plane, 1);
    float *both = colors_of(two, 2, false, RELIGHT_COLOR_F32, &n_plane);
    assert_int_equal(n_plane, 2);
    assert_true(rmse(both, one) < 1e-5);
    assert_true(rmse(both + N_VERTEX * 3, one) < 1e-5);
    two[1].gain[0] = two[1].gain[1] = two[1].gain[2] = 3;
    float *sum = colors_of(two, 2, true, RELIGHT_COLOR_F32, &n_plane);
    assert_int_equal(n_plane, 1);
    for (int i = 0; i < N_VERTEX * 3; i++) sum[i] /= 4;
    assert_true(rmse(sum, one) < 1e-5);
    free(sum);
    free(both);
    free(one);
    free(cube);
}

// As many lights as the daemon takes are sent, and no more.
static void most_lights(void **state)
{
    enum { MOST = 16 };
    struct relight_light light[MOST + 1];
    struct relight_colors_request request = {.model = "ball", .lights = light};
    struct relight_colors colors;
    for (int i = 0; i <= MOST; i++) light[i] = white;
    float *one = colors_of(&white, 1, false, RELIGHT_COLOR_F32, NULL);
    float *sum = colors_of(light, MOST, true, RELIGHT_COLOR_F32, NULL);
    for (int i = 0; i < N_VERTEX * 3; i++) sum[i] /= MOST;
    assert_true(rmse(sum, one) < 1e-4);
    request.n_light = MOST + 1;
    assert_int_equal(relight_colors(client, &request, &colors, &error), -RELIGHT_E_ARGUMENT);
    free(sum);
    free(one);
}

static void formats(void **state)
{
    float *f32 = colors_of(&white, 1, false, RELIGHT_COLOR_F32, NULL);
    float *f16 = colors_of(&white, 1, false, RELIGHT_COLOR_F16, NULL);
    float *e5 = colors_of(&white, 1, false, RELIGHT_COLOR_RGB9E5, NULL);
    float *srgb = colors_of(&white, 1, false, RELIGHT_COLOR_SRGB8, NULL);
    assert_true(rmse(f16, f32) < 0x1p-11);
    assert_true(rmse(e5, f32) < 0x1p-8);
    assert_true(rmse(srgb, f32) < 0.01);
    assert_true(rmse(srgb, f32) > 0); // it is another path
    free(srgb);
    free(e5);
    free(f16);
    free(f32);
}

// Sixteen requests before the first answer is asked for; ends in another order.
static void pipelined(void **state)
{
    uint64_t id[16];
    struct relight_colors_request request = {
        .model = "ball", .n_light = 1, .shade.term = RELIGHT_TERM_MULTIPLE};
    float *one = colors_of(&white, 1, false, RELIGHT_COLOR_F32, NULL);
    char env[16][32];
    for (int i = 0; i < 16; i++) {
        snprintf(env[i], sizeof env[i], "constant:%d,%d,%d", i + 1, i + 1, i + 1);
        struct relight_light light = {.env = env[i]};
        request.lights = &light;
        CALL(relight_colors_begin(client, &request, 0, id + i, &error));
    }
    for (int k = 0; k < 16; k++) {
        int i = k * 7 % 16;
        struct relight_colors colors;
        float rgb[N_VERTEX * 3];
        CALL(relight_colors_end(client, id[i], &colors, &error));
        relight_colors_decode(&colors, 0, rgb);
        relight_colors_finish(&colors);
        for (int j = 0; j < N_VERTEX * 3; j++) rgb[j] /= (float)(i + 1);
        // Answered together they are summed in 16-bit integers: 4e-5 from one alone.
        assert_true(rmse(rgb, one) < 1e-4);
    }
    free(one);
}

static void refusals(void **state)
{
    struct relight_colors colors;
    struct relight_image image;
    struct relight_colors_request request = {.model = "ball", .n_light = 1, .lights = &white};
    request.shade.material = "marble";
    assert_int_equal(relight_colors(client, &request, &colors, &error), -RELIGHT_E_MISMATCH);
    assert_true(*error.text && *error.hint);
    request.shade.material = NULL;
    request.model = "no-such-model";
    assert_int_equal(relight_colors(client, &request, &colors, &error), -RELIGHT_E_NOT_FOUND);
    request.model = "ball";
    struct relight_light bad = {.env = "constant:-1,0,0"};
    request.lights = &bad;
    assert_int_not_equal(relight_colors(client, &request, &colors, &error), 0);
    struct relight_image_request picture = {.model = "ball",
                                            .n_light = 1,
                                            .lights = &white,
                                            .picture.width = 5000,
                                            .picture.height = 10};
    assert_int_not_equal(relight_image(client, &picture, &image, &error), 0);
    assert_int_equal(relight_ping(client, NULL, &error), 0);
}

// Forty turns of the light at once: the last one is always drawn, most others never.
static void view_latest_wins(void **state)
{
    struct relight_view *view;
    struct relight_view_request request = {.model = "ball",
                                           .n_light = 1,
                                           .lights = &white,
                                           .picture = {.width = 400, .height = 300}};
    struct relight_light light = {.env = "constant:1,.5,.2"};
    uint64_t last = 0, drawn = 0, seen, dropped;
    CALL(relight_view_open(client, &request, &view, &error));
    for (int i = 0; i < 40; i++) {
        light.rotate_deg = (float)i;
        CALL(relight_view_set(view, 1, &light, NULL, NULL, &last, &error));
    }
    bool whole = false; // while the light turns, pictures may have half the width
    for (seen = 0; seen < last || !whole; drawn++) {
        struct relight_frame_out frame;
        CALL(relight_view_next(view, 60, &frame, &error));
        assert_true(frame.sequence >= seen);
        assert_true(frame.has_image && frame.image.n_byte > 100);
        whole = !frame.image.cost.reduced;
        assert_int_equal(frame.image.width, whole ? 400 : 200);
        seen = frame.sequence;
        relight_frame_out_finish(&frame);
    }
    assert_int_equal(seen, 40);
    // A state that cannot be drawn is told; the view goes on.
    struct relight_shade shade = {.material = "marble"};
    struct relight_frame_out frame;
    CALL(relight_view_set(view, 0, NULL, &shade, NULL, &last, &error));
    assert_int_equal(relight_view_next(view, 60, &frame, &error), -RELIGHT_E_MISMATCH);
    CALL(relight_view_set(view, 0, NULL, &(struct relight_shade){0}, NULL, &last, &error));
    CALL(relight_view_next(view, 60, &frame, &error));
    assert_int_equal(frame.sequence, last);
    relight_frame_out_finish(&frame);
    CALL(relight_view_close(view, &seen, &dropped, &error));
    assert_true(seen + dropped >= 40);
    print_message("view: 40 states, %llu frames taken\n", (unsigned long long)drawn);
}

static void view_of_colors(void **state)
{
    struct relight_view *view;
    struct relight_view_request request = {.model = "ball",
                                           .n_light = 1,
                                           .lights = &white,
                                           .colors = true,
                                           .color_format = RELIGHT_COLOR_RGB9E5};
    struct relight_frame_out frame;
    CALL(relight_view_open(client, &request, &view, &error));
    CALL(relight_view_next(view, 60, &frame, &error));
    assert_true(frame.has_colors && frame.colors.n_vertex == N_VERTEX);
    relight_frame_out_finish(&frame);
    CALL(relight_view_close(view, NULL, NULL, &error));
}

static void geometry(void **state)
{
    struct relight_geometry g;
    CALL(relight_geometry(client, "ball", false, &g, &error));
    assert_int_equal(g.n_vertex, N_VERTEX);
    assert_int_equal(g.n_triangle, 2 * SIDES * (RINGS - 1));
    assert_int_equal(g.n_block, 1);
    assert_true(g.block[0].translucent);
    // The ball's bounding box has a diagonal of 20 mm.
    assert_true(fabs((double)g.position[0][1] - 10 / sqrt(3)) < 1e-3);
    assert_true(fabs((double)g.normal[0][1] - 1) < 1e-3);
    relight_geometry_finish(&g);
    CALL(relight_geometry(client, "ball", true, &g, &error));
    assert_true(fabs((double)g.position[0][1] - 1) < 1e-4);
    relight_geometry_finish(&g);
}

static void info_list_stats(void **state)
{
    struct relight_model m;
    struct relight_list list;
    struct relight_stats stats;
    CALL(relight_info(client, "ball", &m, &error));
    assert_int_equal(m.state, RELIGHT_MODEL_READY);
    assert_int_equal(m.n_vertex, N_VERTEX);
    assert_string_equal(m.engine, "wavelet");
    assert_string_equal(m.storage, "factored");
    assert_non_null(strstr(m.material, "skin1"));
    assert_non_null(strstr(m.errors, "multiple"));
    relight_model_finish(&m);
    CALL(relight_list(client, true, &list, &error));
    assert_int_equal(list.n_model, 1);
    bool found = false;
    for (size_t i = 0; i < list.n_file; i++) found |= !strcmp(list.file[i], "ball.obj");
    assert_true(found);
    relight_list_finish(&list);
    CALL(relight_stats(client, &stats, &error));
    assert_true(stats.n_metric > 5);
    relight_stats_finish(&stats);
}

// Both carriers, one daemon; a second client does not disturb the first. Unloaded, it comes
// back.
static void unloaded(void **state)
{
    struct relight_client *other;
    struct relight_model m;
    CALL(relight_connect(d.address, NULL, &other, &error));
    CALL(relight_unload(other, "ball", false, NULL, &error));
    relight_close(other);
    CALL(relight_info(client, "ball", &m, &error));
    relight_model_finish(&m);
    free(colors_of(&white, 1, false, RELIGHT_COLOR_F16, NULL));
}

// A medium in numbers: sigma_t = sigma_s' / (1 - g) + sigma_a and 1 / (sigma_s' + sigma_a),
// each channel with its own g.
static void medium(void **state)
{
    static const char text[] = "{\"sigma_s_prime\":[2,1,0.5],\"sigma_a\":[0.1,0.2,0.4],"
                               "\"g\":[0,0.5,0.8],\"eta\":1.4}";
    static const double g[3] = {0, .5, .8}, sigma_t[3] = {2.1, 2.2, 2.9},
                        path[3] = {1 / 2.1, 1 / 1.2, 1 / .9};
    struct relight_medium m;
    CALL(relight_material(client, text, &m, &error));
    for (int c = 0; c < 3; c++) {
        assert_float_equal(m.g[c], g[c], 1e-6);
        assert_float_equal(m.sigma_t[c], sigma_t[c], 1e-5);
        assert_float_equal(m.mean_free_path_mm[c], path[c], 1e-5);
        assert_true(m.reflectance[c] > 0 && m.reflectance[c] < (c ? m.reflectance[c - 1] : 1));
    }
    assert_false(m.profile);
    relight_medium_finish(&m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(lights),          cmocka_unit_test(most_lights),
        cmocka_unit_test(formats),         cmocka_unit_test(pipelined),
        cmocka_unit_test(refusals),        cmocka_unit_test(view_latest_wins),
        cmocka_unit_test(view_of_colors),  cmocka_unit_test(geometry),
        cmocka_unit_test(info_list_stats), cmocka_unit_test(unloaded),
        cmocka_unit_test(medium),
    };
    return cmocka_run_group_tests_name("librelight", tests, start, stop);
}
