// SPDX-License-Identifier: MIT
// Previews of odd shapes through a real relightd: vertices that move under a picture and a
// view, cameras inside and far away, models with nothing to see.
#include "ball.h"

// The frame that comes unasked: a preview of the new shape.
static void expect_preview_of_the_shape(struct relight_view *view)
{
    struct relight_frame_out frame;
    next_frame(view, &frame);
    assert_true(frame.image.cost.engine >= RELIGHT_ENGINE_SPLAT);
    assert_int_equal(frame.image.generation, 2);
    assert_non_null(strstr(frame.image.cost.note, "vertices moved"));
    relight_frame_out_finish(&frame);
    OK(relight_view_close(view, NULL, NULL, &error));
}

// A ball 1.6 times as high: x² + (y/1.6)² + z², whose gradient is the normal.
static void expect_ellipsoid(const char *id, float (*moved)[3])
{
    struct relight_geometry after;
    OK(relight_geometry(client, id, true, &after, &error));
    assert_int_equal(after.generation, 2);
    for (int i = 0; i < N_VERTEX; i++) {
        double n[3], length = 0, dot = 0;
        for (int c = 0; c < 3; c++) {
            assert_true(fabsf(after.position[i][c] - moved[i][c]) < 1e-5f);
            n[c] = moved[i][c] / (c == 1 ? 2.56 : 1);
            length += n[c] * n[c];
        }
        for (int c = 0; c < 3; c++) dot += n[c] * after.normal[i][c] / sqrt(length);
        assert_true(dot > 0.99);
    }
    relight_geometry_finish(&after);
}

// The bake answers, when it is asked, for the shape that it was made of, and says so.
static void expect_stale_bake(const char *id)
{
    struct relight_model m;
    struct relight_cost cost;
    OK(relight_info(client, id, &m, &error));
    assert_true(m.stale);
    assert_int_equal(m.state, RELIGHT_MODEL_READY);
    assert_true(m.box_max[1] - m.box_min[1] > 1.5f * (m.box_max[0] - m.box_min[0]));
    relight_model_finish(&m);
    struct relight_image_request r = request_of(id, RELIGHT_ENGINE_WAVELET);
    free(picture(&r, &cost));
    assert_non_null(strstr(cost.note, "before its vertices moved"));
    struct relight_colors_request c = {.model = id, .n_light = 1, .lights = &white};
    struct relight_colors colors;
    OK(relight_colors(client, &c, &colors, &error));
    assert_int_equal(colors.generation, 1);
    assert_non_null(strstr(colors.cost.note, "before its vertices moved"));
    relight_colors_finish(&colors);
}

// One vertex with its normal; and vertices that are refused.
static void move_some(const char *id, float (*moved)[3])
{
    struct relight_geometry after;
    uint64_t generation;
    float up[3] = {0, 2, 0}, nan[3] = {NAN, 0, 0}, far[3] = {1e9f, 0, 0};
    OK(relight_update_vertices(client, id, 0, 1, moved[0], up, true, &generation, &error));
    assert_int_equal(generation, 3);
    OK(relight_geometry(client, id, false, &after, &error));
    assert_true(fabsf(after.normal[0][1] - 1) < 1e-6f);
    relight_geometry_finish(&after);
    expect(relight_update_vertices(client, id, 0, 1, nan, NULL, false, NULL, &error),
           RELIGHT_E_OUT_OF_RANGE, "no number");
    expect(relight_update_vertices(client, id, 0, 1, far, NULL, false, NULL, &error),
           RELIGHT_E_OUT_OF_RANGE, "1e6");
    expect(relight_update_vertices(client, id, N_VERTEX, 1, up, NULL, false, NULL, &error),
           RELIGHT_E_OUT_OF_RANGE, "allowed range 0 to 362: the vertices of moves.obj");
    expect(relight_update_vertices(client, "nobody", 0, 1, up, NULL, false, NULL, &error),
           RELIGHT_E_NOT_FOUND, NULL);
}

// All vertices in one point are an error; the model without the update is the bake again.
static void collapse_and_return(const char *id, float (*moved)[3])
{
    static const float up[3] = {0, 2, 0};
    struct relight_model m;
    struct relight_cost cost;
    struct relight_image image;
    for (int i = 0; i < N_VERTEX; i++) memcpy(moved[i], up, sizeof up);
    OK(relight_update_vertices(client, id, 0, N_VERTEX, moved[0], NULL, false, NULL, &error));
    struct relight_image_request r = request_of(id, 0);
    int status = relight_image(client, &r, &image, &error);
    assert_true(status < 0 && error.text[0]);
    OK(relight_unload(client, id, false, NULL, &error));
    free(picture(&r, &cost));
    assert_int_equal(cost.engine, RELIGHT_ENGINE_WAVELET);
    assert_string_equal(cost.note, "");
    OK(relight_info(client, id, &m, &error));
    assert_false(m.stale);
    relight_model_finish(&m);
}

static void test_vertices_move(void **state)
{
    struct relight_loaded loaded;
    struct relight_geometry g;
    uint64_t generation;
    struct relight_load load = small_load(false);
    load.bake.seed = 3; // another model than the ball
    OK(load_ball("moves.obj", load, &loaded));
    const char *id = loaded.model;
    if (loaded.job[0]) OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    struct relight_view *view = open_view(id, 0);
    struct relight_frame_out frame;
    next_frame(view, &frame);
    assert_int_equal(frame.image.cost.engine, RELIGHT_ENGINE_WAVELET);
    assert_int_equal(frame.image.generation, 1);
    relight_frame_out_finish(&frame);
    OK(relight_geometry(client, id, true, &g, &error));
    float(*moved)[3] = malloc(sizeof *moved * N_VERTEX);
    assert_non_null(moved);
    for (int i = 0; i < N_VERTEX; i++)
        for (int c = 0; c < 3; c++) moved[i][c] = g.position[i][c] * (c == 1 ? 1.6f : 1);
    OK(relight_update_vertices(client, id, 0, N_VERTEX, moved[0], NULL, true, &generation,
                               &error));
    assert_int_equal(generation, 2);
    expect_preview_of_the_shape(view);
    expect_ellipsoid(id, moved);
    expect_stale_bake(id);
    move_some(id, moved);
    collapse_and_return(id, moved);
    OK(relight_unload(client, id, true, NULL, &error));
    free(moved);
    relight_geometry_finish(&g);
    relight_loaded_finish(&loaded);
}

static void test_a_view_follows_a_wobble(void **state)
{
    struct relight_geometry g;
    OK(relight_geometry(client, ball, false, &g, &error));
    float(*moved)[3] = malloc(sizeof *moved * N_VERTEX);
    struct relight_view *view = open_view(ball, 0);
    uint64_t seen = 0, generation = 0;
    for (int k = 0; k < 25; k++) {
        for (int i = 0; i < N_VERTEX; i++)
            for (int c = 0; c < 3; c++)
                moved[i][c] = g.position[i][c] * (1 + 0.2f * sinf((float)(k + c)));
        OK(relight_update_vertices(client, ball, 0, N_VERTEX, moved[0], NULL, false,
                                   &generation, &error));
    }
    for (int i = 0; i < 40 && seen < generation; i++) {
        struct relight_frame_out frame;
        next_frame(view, &frame);
        assert_true(frame.image.generation >= seen);
        seen = frame.image.generation;
        free(pixels_of(&frame.image));
        relight_frame_out_finish(&frame);
    }
    assert_int_equal(seen, generation);
    OK(relight_view_close(view, NULL, NULL, &error));
    OK(relight_unload(client, ball, false, NULL, &error)); // back to the file's shape
    free(moved);
    relight_geometry_finish(&g);
}

static void test_odd_cameras(void **state)
{
    static const char *const camera[] = {
        "0,0,0:1,0,0",                // inside
        "0,0,0.999:0,0,1",            // inside, close to the surface
        "0,0,5:0,0,9",                // away from it: an empty view
        "0,0,1e6:0,0,0:0,1,0:1",      // less than a pixel
        "0,0,1.0001:0,0,0:0,1,0:169", // all but touching
    };
    for (int e = 0; e <= RELIGHT_ENGINE_HYBRID; e++) {
        if (e && e < RELIGHT_ENGINE_SPLAT) continue;
        for (size_t i = 0; i < sizeof camera / sizeof *camera; i++) {
            struct relight_image_request r = request_of(ball, (enum relight_engine)e);
            OK(relight_camera_parse(camera[i], &r.picture.camera, &error));
            float *rgb = picture(&r, NULL);
            double sum = 0;
            for (int k = 0; k < SIDE * SIDE * 3; k++) sum += rgb[k];
            if (i == 2) assert_true(sum == 0);
            free(rgb);
        }
    }
}

static void test_degenerate_models(void **state)
{
    static const struct {
        const char *name, *text;
        bool loads;
    } each[] = {
        {"point.obj", "v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", false},
        {"nothing.obj", "v 0 0 0\n", false},
        {"noise.glb", "glTF this is not", false},
        {"line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", true},
        {"sheet.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", true},
        {"mixed.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\nf 1 1 1\n", true},
    };
    for (size_t i = 0; i < sizeof each / sizeof *each; i++) {
        char path[160];
        struct relight_loaded loaded;
        snprintf(path, sizeof path, "%s/%s", d.folder, each[i].name);
        write_text(path, each[i].text);
        struct relight_load load = small_load(true);
        int status = relight_load_file(client, path, &load, NULL, NULL, &loaded, &error);
        print_message("%s: %s\n", each[i].name, status ? error.text : "loaded");
        assert_true(!status == each[i].loads);
        if (status) {
            assert_non_null(strstr(error.text, each[i].name)); // by the name it was given
            assert_null(strstr(error.text, d.data));
            continue;
        }
        for (int e = RELIGHT_ENGINE_SPLAT; e <= RELIGHT_ENGINE_HYBRID; e++) {
            struct relight_image_request r = request_of(loaded.model, (enum relight_engine)e);
            struct relight_image image;
            status = relight_image(client, &r, &image, &error);
            if (status) { // a clear error is fine, a crash or NaN is not
                assert_true(status != -RELIGHT_E_DISCONNECTED && error.text[0]);
                continue;
            }
            free(pixels_of(&image));
            relight_image_finish(&image);
        }
        OK(relight_unload(client, loaded.model, true, NULL, &error));
        relight_loaded_finish(&loaded);
    }
    struct relight_list list;
    OK(relight_list(client, false, &list, &error));
    assert_int_equal(list.n_model, 1); // what was refused is not remembered
    relight_list_finish(&list);
}

// Shapes that were drawn go once --cache is spent.
static void test_shapes_leave(void **state)
{
    static const char *const extra[] = {"--cache", "400k", NULL};
    enum { SHAPES = 30 };
    static struct daemon small;
    static float moved[N_VERTEX][3];
    char path[160];
    struct relight_loaded loaded;
    struct relight_geometry g;
    struct relight_load load = small_load(true);
    daemon_folder(&small);
    daemon_start(&small, extra);
    struct relight_client *other = client_open(small.address);
    snprintf(path, sizeof path, "%s/ball.obj", d.folder);
    OK(relight_load_file(other, path, &load, NULL, NULL, &loaded, &error));
    OK(relight_geometry(other, loaded.model, false, &g, &error));
    for (int k = 0; k < SHAPES; k++) {
        struct relight_image_request r = request_of(loaded.model, 0);
        struct relight_image image;
        for (int i = 0; i < N_VERTEX; i++)
            for (int c = 0; c < 3; c++)
                moved[i][c] = g.position[i][c] * (1 + 0.01f * (float)(c * k));
        OK(relight_update_vertices(other, loaded.model, 0, N_VERTEX, moved[0], NULL, false,
                                   NULL, &error));
        OK(relight_image(other, &r, &image, &error));
        relight_image_finish(&image);
    }
    double bytes = metric(other, "relightd_cache_bytes");
    for (int i = 0; i < 200 && bytes > 400 << 10; i++) {
        usleep(50000);
        bytes = metric(other, "relightd_cache_bytes");
    }
    print_message("%d shapes: %.0f kB are kept, %g evictions\n", SHAPES, bytes / 1024,
                  metric(other, "relightd_cache_evictions_total"));
    assert_true(bytes <= 400 << 10);
    assert_true(metric(other, "relightd_cache_evictions_total") > SHAPES);
    relight_geometry_finish(&g);
    relight_loaded_finish(&loaded);
    relight_close(other);
    assert_int_equal(daemon_end(&small), 0);
    daemon_remove(&small);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_vertices_move), cmocka_unit_test(test_a_view_follows_a_wobble),
        cmocka_unit_test(test_odd_cameras),   cmocka_unit_test(test_degenerate_models),
        cmocka_unit_test(test_shapes_leave),
    };
    return cmocka_run_group_tests(tests, ball_setup, ball_teardown);
}
