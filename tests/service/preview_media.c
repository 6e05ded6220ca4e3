// SPDX-License-Identifier: MIT
// Media of previews through a real relightd: profiles that are no dipole, and images over the
// model's uv that tint the medium and turn its normals, by every engine, held against the exact
// sum.
#include "ball.h"

static char dressed[ID_SIZE]; // a ball with uv

// The ball, each vertex with a place in the unit square.
static void write_dressed(const char *path)
{
    FILE *f = fopen(path, "w");
    assert_non_null(f);
    for (int i = 0; i <= RINGS; i++)
        for (int j = 0; j <= SIDES; j++) {
            double a = M_PI * i / RINGS, b = 2 * M_PI * j / SIDES;
            double s = i && i < RINGS ? sin(a) : 0;
            fprintf(f, "v %.7f %.7f %.7f\nvt %.6f %.6f\n", s * cos(b), cos(a), -s * sin(b),
                    (double)j / SIDES, 1 - (double)i / RINGS);
        }
    for (int i = 0; i < RINGS; i++)
        for (int j = 0; j < SIDES; j++) {
            int a = i * (SIDES + 1) + j + 1, b = a + SIDES + 1;
            if (i) fprintf(f, "f %d/%d %d/%d %d/%d\n", a, a, b, b, a + 1, a + 1);
            if (i < RINGS - 1)
                fprintf(f, "f %d/%d %d/%d %d/%d\n", a + 1, a + 1, b, b, b + 1, b + 1);
        }
    fclose(f);
}

static int setup(void **state)
{
    struct relight_loaded loaded;
    char path[160];
    if (ball_setup(state)) return -1;
    snprintf(path, sizeof path, "%s/dressed.obj", d.folder);
    write_dressed(path);
    OK(load_ball("dressed.obj", small_load(true), &loaded));
    snprintf(dressed, sizeof dressed, "%s", loaded.model);
    relight_loaded_finish(&loaded);
    return 0;
}

static struct prt_material parsed(const char *text)
{
    struct prt_context ctx;
    struct prt_material m;
    prt_context_init(&ctx);
    assert_int_equal(text[0] == '{' ? prt_material_parse(&ctx, "test", text, strlen(text), &m)
                                    : prt_material_load(&ctx, text, &m),
                     0);
    return m;
}

// A picture of `model`, of its exact sum, and how far they are apart.
static double off(const struct relight_image_request *r, const float *exact)
{
    struct relight_cost cost;
    float *rgb = picture(r, &cost);
    double e = difference(rgb, exact, SIDE * SIDE * 3);
    assert_true(cost.engine >= RELIGHT_ENGINE_SPLAT && cost.error_bound > 0);
    free(rgb);
    return e;
}

static struct relight_camera default_camera(const char *model)
{
    struct relight_image_request r = request_of(model, 0);
    struct relight_image image;
    OK(relight_image(client, &r, &image, &error));
    struct relight_camera camera = image.camera;
    relight_image_finish(&image);
    return camera;
}

// Profiles of a shape of their own are what previews show, by every engine and the daemon's
// choice: nearer to the exact sum over them than the nearest dipole is.
static void test_profiles_are_shown(void **state)
{
    static const char *const text[] = {
        "{\"profile\":\"burley\",\"albedo\":[0.8,0.6,0.4],\"mean_free_path\":[4,3,2.5],\"eta\":1.3}",
        "{\"profile\":\"multipole\",\"layers\":[{\"thickness\":0.5,\"sigma_s_prime\":[3,3,3],"
        "\"sigma_a\":[0.01,0.05,0.1]},{\"sigma_s_prime\":[1,1,1],\"sigma_a\":[0.1,0.02,0.02]}],"
        "\"eta\":1.3}",
        ("{\"profile\":\"curve\",\"radius\":[0,2,3,3.5],\"rd\":[[0.02,0.02,0.02,0],"
         "[0.02,0.02,0.02,0],[0.01,0.01,0.01,0]],\"eta\":1.3}")};
    struct relight_camera camera = default_camera(ball);
    for (int k = 0; k < 3; k++) {
        struct prt_material m = parsed(text[k]), plain = m;
        plain.profile = plain.n_point = 0;
        float *exact = exact_by(&camera, "ball.obj", &m, (struct prt_screen_options){0});
        float *nearest = exact_by(&camera, "ball.obj", &plain, (struct prt_screen_options){0});
        double other = difference(nearest, exact, SIDE * SIDE * 3), worst = 0;
        for (int e = 0; e <= RELIGHT_ENGINE_HYBRID; e++) {
            if (e && e < RELIGHT_ENGINE_SPLAT) continue;
            struct relight_image_request r = request_of(ball, (enum relight_engine)e);
            r.shade.material = text[k];
            double is = off(&r, exact);
            print_message("profile %d by %s: %.2f %% off, the nearest dipole %.2f %%\n", k,
                          relight_engine_name((enum relight_engine)e), 100 * is, 100 * other);
            if (e != RELIGHT_ENGINE_TANGENT) worst = fmax(worst, is);
            else assert_true(is < 0.35); // what curves away, as of any medium
        }
        assert_true(worst < 0.08);
        if (k == 2) assert_true(worst < 0.7 * other); // nothing like a dipole
        free(exact);
        free(nearest);
    }
    // as a model's own
    struct relight_loaded loaded;
    struct relight_load load = small_load(true);
    load.material = text[2];
    OK(load_ball("curve.obj", load, &loaded));
    struct relight_image_request own = request_of(loaded.model, RELIGHT_ENGINE_SPLAT), given;
    given = request_of(ball, RELIGHT_ENGINE_SPLAT);
    given.shade.material = text[2];
    float *a = picture(&own, NULL), *b = picture(&given, NULL);
    assert_true(difference(a, b, SIDE * SIDE * 3) < 0.002);
    free(a);
    free(b);
    OK(relight_unload(client, loaded.model, true, NULL, &error));
    relight_loaded_finish(&loaded);
}

// Radiance's format, one row: R,G,B * 2^(E-136).
static void upload_hdr(const char *name, uint32_t w, uint32_t h, const uint8_t (*rgbe)[4],
                       char hash[65])
{
    static char bytes[1 << 16];
    int n = snprintf(bytes, sizeof bytes, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %u +X %u\n",
                     h, w);
    memcpy(bytes + n, rgbe, (size_t)w * h * 4);
    OK(relight_upload(client, name, bytes, (size_t)n + (size_t)w * h * 4, NULL, NULL, hash,
                      NULL, &error));
}

static void decode(const uint8_t (*rgbe)[4], size_t n, float (*rgb)[3])
{
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) rgb[i][c] = ldexpf(rgbe[i][c], rgbe[i][3] - 136);
}

enum { MAP_W = 16, MAP_H = 8 };
static uint8_t patches[MAP_W * MAP_H][4], waves[MAP_W * MAP_H][4], tipped[MAP_W * MAP_H][4];

static void make_maps(void)
{
    for (int y = 0; y < MAP_H; y++)
        for (int x = 0; x < MAP_W; x++) {
            uint8_t *p = patches[y * MAP_W + x], *w = waves[y * MAP_W + x],
                    *t = tipped[y * MAP_W + x];
            bool dark = (x / 4 + y / 4) % 2;
            uint8_t light = (uint8_t)(128 + 100 * sin(2 * M_PI * x / MAP_W));
            memcpy(p, (uint8_t[]){dark ? 60 : 220, 200, dark ? 220 : 90, 128}, 4);
            memcpy(w, (uint8_t[]){light, light, light, 128}, 4);
            // 0.5 + 0.5 n, n about (0.8, 0, 0.6) on half of it
            memcpy(t, (uint8_t[]){x < 8 ? 230 : 128, 128, x < 8 ? 205 : 255, 128}, 4);
        }
}

// Tints, normals and heights are shown by every engine, as the exact sum has them.
static void test_maps_are_shown(void **state)
{
    struct prt_context ctx;
    struct prt_material skin = parsed("skin1");
    struct relight_camera camera = default_camera(dressed);
    float(*rgb)[3] = malloc(sizeof *rgb * MAP_W * MAP_H);
    uint8_t(*const source[3])[4] = {patches, tipped, waves};
    char hash[3][65];
    prt_context_init(&ctx);
    make_maps();
    for (int k = 0; k < 3; k++) {
        char name[16];
        snprintf(name, sizeof name, "map%d.hdr", k);
        upload_hdr(name, MAP_W, MAP_H, (const uint8_t(*)[4])source[k], hash[k]);
    }
    float *bare = exact_by(&camera, "dressed.obj", &skin, (struct prt_screen_options){0});
    for (int k = 0; k < 3; k++) {
        struct prt_image image = {MAP_W, MAP_H, (float *)rgb};
        struct prt_screen_map map;
        decode((const uint8_t(*)[4])source[k], MAP_W * MAP_H, rgb);
        assert_int_equal(prt_screen_map_make(&ctx, (enum prt_screen_map_kind)k, &image, true, 0,
                                             &skin, 2, &map),
                         0);
        struct prt_screen_options options = {.sigma_a_map = k == 0 ? &map : NULL,
                                             .normal_map = k == 1 ? &map : NULL,
                                             .bump_map = k == 2 ? &map : NULL};
        float *exact = exact_by(&camera, "dressed.obj", &skin, options);
        double other = difference(bare, exact, SIDE * SIDE * 3);
        for (int e = 0; e <= RELIGHT_ENGINE_HYBRID; e++) {
            if (e && e < RELIGHT_ENGINE_SPLAT) continue;
            struct relight_image_request r = request_of(dressed, (enum relight_engine)e);
            r.shade.albedo_map = k == 0 ? hash[0] : NULL;
            r.shade.normal_map = k == 1 ? hash[1] : NULL;
            r.shade.bump_map = k == 2 ? hash[2] : NULL;
            r.shade.bump_mm = k == 2 ? 2 : 0;
            double is = off(&r, exact);
            print_message("map %d by %s: %.2f %% off, without it %.2f %%\n", k,
                          relight_engine_name((enum relight_engine)e), 100 * is, 100 * other);
            assert_true(is < (e == RELIGHT_ENGINE_TANGENT ? 0.35 : 0.12));
            if (e != RELIGHT_ENGINE_TANGENT) assert_true(is < 0.7 * other);
        }
        prt_screen_map_finish(&map);
        free(exact);
    }
    // 0.5, 0.5, 1 is level
    static const uint8_t grey[4] = {128, 128, 255, 128};
    struct relight_image_request plain = request_of(dressed, RELIGHT_ENGINE_HYBRID),
                                 level = plain;
    char flat[65];
    upload_hdr("flat.hdr", 1, 1, &grey, flat);
    level.shade.normal_map = flat;
    float *a = picture(&plain, NULL), *b = picture(&level, NULL);
    assert_true(difference(a, b, SIDE * SIDE * 3) < 0.01);
    free(a);
    free(b);
    free(bare);
    free(rgb);
}

static void test_requests_without_maps(void **state)
{
    struct relight_image_request r = request_of(dressed, 0);
    struct relight_image image;
    struct relight_colors colors;
    char hash[65], text[65];
    make_maps();
    upload_hdr("map0.hdr", MAP_W, MAP_H, (const uint8_t(*)[4])patches, hash);
    OK(relight_upload(client, "words.png", "no picture", 10, NULL, NULL, text, NULL, &error));
    r.shade.albedo_map = "red";
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_BAD_REQUEST, "albedo_map");
    r.shade.albedo_map = "00000000000000000000000000000000000000000000000000000000000000ff";
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_NOT_FOUND, "no such upload");
    r.shade.albedo_map = text;
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_FORMAT, "words.png");
    r.shade.albedo_map = hash;
    r.model = ball;
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_MISMATCH,
           "texture coordinates");
    r.model = dressed;
    r.shade.bump_mm = -1;
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_OUT_OF_RANGE, "bump_mm");
    r.shade.bump_mm = 0;
    r.shade.engine = RELIGHT_ENGINE_WAVELET;
    int status = relight_image(client, &r, &image, &error);
    assert_true(status == -RELIGHT_E_NOT_READY || status == -RELIGHT_E_UNSUPPORTED);
    struct relight_colors_request c = {
        .model = dressed, .n_light = 1, .lights = &white, .shade.albedo_map = hash};
    status = relight_colors(client, &c, &colors, &error);
    assert_true(status == -RELIGHT_E_NOT_READY || status == -RELIGHT_E_UNSUPPORTED);
    // a medium that absorbs nothing has no absorption to tint it by
    r.shade.engine = 0;
    r.shade.material = "{\"sigma_s_prime\":[1,1,1],\"sigma_a\":[0,0,0]}";
    expect(relight_image(client, &r, &image, &error), RELIGHT_E_OUT_OF_RANGE,
           "absorbs nothing");
    r.shade.material = NULL;
    free(picture(&r, NULL));
}

// The next frame at full size: while the daemon is slow those of a moving view have half of it.
static void next_whole_frame(struct relight_view *view, struct relight_frame_out *frame)
{
    next_frame(view, frame);
    for (int i = 0; i < 20 && frame->image.width < SIDE; i++) {
        relight_frame_out_finish(frame);
        next_frame(view, frame);
    }
    assert_int_equal(frame->image.width, SIDE);
}

// A view takes maps and lets go of them; a bake, which knows none, takes over only without.
static void test_views_take_maps(void **state)
{
    struct relight_loaded loaded;
    struct relight_load load = small_load(false);
    struct relight_frame_out frame;
    char hash[65];
    make_maps();
    upload_hdr("map0.hdr", MAP_W, MAP_H, (const uint8_t(*)[4])patches, hash);
    load.bake.seed = 9;
    OK(load_ball("dressed.obj", load, &loaded));
    OK(relight_watch(client, loaded.job, NULL, NULL, &error));
    struct relight_view *view = open_view(loaded.model, 0);
    next_whole_frame(view, &frame);
    assert_int_equal(frame.image.cost.engine, RELIGHT_ENGINE_WAVELET);
    float *baked = pixels_of(&frame.image);
    relight_frame_out_finish(&frame);
    struct relight_shade shade = {.albedo_map = hash};
    OK(relight_view_set(view, 0, NULL, &shade, NULL, NULL, &error));
    next_whole_frame(view, &frame);
    assert_true(frame.image.cost.engine >= RELIGHT_ENGINE_SPLAT);
    float *tinted = pixels_of(&frame.image);
    assert_true(difference(tinted, baked, SIDE * SIDE * 3) > 0.1);
    relight_frame_out_finish(&frame);
    shade = (struct relight_shade){0};
    OK(relight_view_set(view, 0, NULL, &shade, NULL, NULL, &error));
    bool back = false;
    for (int i = 0; i < 20 && !back; i++) {
        next_frame(view, &frame);
        back = frame.image.cost.engine == RELIGHT_ENGINE_WAVELET;
        relight_frame_out_finish(&frame);
    }
    assert_true(back);
    free(baked);
    free(tinted);
    OK(relight_view_close(view, NULL, NULL, &error));
    relight_loaded_finish(&loaded);
}

// A texel that is not finite is 0 in the mean of a map that is reduced.
static void test_mean_without_nan(void **state)
{
    const float texel[4] = {1, NAN, 1, 1};
    float rgb[4][3];
    for (int i = 0; i < 12; i++) rgb[i / 3][i % 3] = texel[i / 3];
    struct prt_image image = {2, 2, rgb[0]};
    struct prt_screen_map map;
    struct prt_context ctx;
    prt_context_init(&ctx);
    assert_int_equal(
        prt_screen_map_make(&ctx, PRT_SCREEN_MAP_HEIGHT, &image, true, 1, NULL, 2, &map), 0);
    for (int c = 0; c < 3; c++) assert_float_equal(map.rgb[0][c], 2 * 0.75, 1e-6);
    prt_screen_map_finish(&map);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_mean_without_nan), cmocka_unit_test(test_profiles_are_shown),
        cmocka_unit_test(test_maps_are_shown),   cmocka_unit_test(test_requests_without_maps),
        cmocka_unit_test(test_views_take_maps),
    };
    return cmocka_run_group_tests(tests, setup, ball_teardown);
}
