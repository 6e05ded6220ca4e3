/* SPDX-License-Identifier: MIT */
/* Resampling conserves power (METHODS 2): sums of radiance times solid angle, a one-pixel sun,
 * rotation, and every layout of one picture. */
#include "prt/light.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <dirent.h>
#include <malloc.h>
#include <cmocka.h>

#include "expect.h"

#define PI 3.14159265358979323846

static struct prt_context ctx;

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

static int setup(void **state)
{
    prt_context_init(&ctx);
    ctx.log = quiet;
    setenv("PRT_LIBDIR", PRT_BINARY_DIR, 1);
    return 0;
}

static double luminance(const float *p)
{
    return 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
}

static double cube_power(const struct prt_cube *cube)
{
    double sum = 0;
    const uint32_t n = cube->n;
    for (uint32_t i = 0; i < 6 * n * n; i++)
        sum +=
            luminance(cube->texel + (size_t)i * 3) * prt_cube_solid_angle(n, i % n, i / n % n);
    return sum;
}

static double latlong_power(const struct prt_image *im)
{
    double sum = 0;
    for (uint32_t y = 0; y < im->height; y++) {
        const double w =
            (cos(PI * y / im->height) - cos(PI * (y + 1.0) / im->height)) * 2 * PI / im->width;
        for (uint32_t x = 0; x < im->width; x++)
            sum += w * luminance(im->rgb + ((size_t)y * im->width + x) * 3);
    }
    return sum;
}

static double env_power(const struct prt_env *env)
{
    return env->kind == PRT_ENV_CUBE ? cube_power(&env->cube) : latlong_power(&env->latlong);
}

static void check_power(const char *name, const struct prt_env *env)
{
    static const double turns[] = {0, 37.5, 90, 211.3, -45};
    static const uint32_t sizes[] = {16, 32, 64, 128, 24};
    const double want = env_power(env);
    for (int i = 0; i < 5; i++) {
        struct prt_cube cube;
        assert_int_equal(prt_env_to_cube(&ctx, env, sizes[i], turns[(i * 2) % 5], &cube), 0);
        const double have = cube_power(&cube);
        if (!(fabs(have / want - 1) <= 1e-6)) print_error("%s at %u:\n", name, sizes[i]);
        expect_near("power over the picture's", have / want, 1, 1e-6);
        prt_cube_finish(&cube);
    }
}

/* Law: the cube's sum of radiance x solid angle is the picture's, at any size and turn (METHODS
 * §2). */
static void files_keep_their_power(void **state)
{
    static const char *const folders[] = {"latlong", "cube"};
    int count = 0;
    want_data(PRT_SHARED_DATA "/env");
    for (int f = 0; f < 2; f++) {
        char path[512];
        snprintf(path, sizeof path, PRT_SHARED_DATA "/env/%s", folders[f]);
        DIR *dir = opendir(path);
        assert_non_null(dir);
        for (struct dirent *e; (e = readdir(dir));) {
            struct prt_env *env = NULL;
            snprintf(path, sizeof path, PRT_SHARED_DATA "/env/%s/%s", folders[f], e->d_name);
            if (e->d_name[0] == '.' || strstr(e->d_name, "angularprobe")) continue;
            assert_int_equal(prt_env_load(&ctx, path, &env), 0);
            check_power(e->d_name, env);
            prt_env_destroy(env);
            count++;
        }
        closedir(dir);
    }
    assert_true(count >= 25);
}

/* Direction of a lat-long position after the light is turned by degrees (CCW from above). */
static void turned_direction(double x, double y, uint32_t w, uint32_t h, double degrees,
                             double d[3])
{
    const double phi = 2 * PI * (x / w - 0.5), theta = PI * (0.5 - y / h),
                 a = degrees * PI / 180;
    const double v[3] = {sin(phi) * cos(theta), sin(theta), -cos(phi) * cos(theta)};
    d[0] = cos(a) * v[0] + sin(a) * v[2]; /* rotation about +y */
    d[1] = v[1];
    d[2] = -sin(a) * v[0] + cos(a) * v[2];
}

/* Law: the power of one pixel lands within a texel and a half of it, and no other texel changes
 * (METHODS §2). */
static void one_pixel_sun(void **state)
{
    enum { W = 512, H = 256 };
    static const struct {
        uint32_t x, y;
    } places[] = {{0, 0},     {300, 0},           {77, 1},   {W - 1, H - 1},
                  {0, H / 2}, {W - 1, H / 2 - 1}, {64, 128}, {191, 64},
                  {192, 63},  {320, 81},          {448, 90}, {256, 128},
                  {123, 200}, {400, 250}};
    const float sky = 0.01f, sun = 1e5f;
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {W, H, NULL}};
    env.latlong.rgb = prt_alloc(W * H * 3, sizeof(float));
    for (size_t p = 0; p < sizeof places / sizeof *places; p++)
        for (int k = 0; k < 6; k++) {
            const uint32_t n = k < 4 ? 16u << k : 32;
            const double degrees = k < 3 ? 0 : 73.21 * k;
            for (int i = 0; i < W * H * 3; i++) env.latlong.rgb[i] = sky;
            float *pixel = env.latlong.rgb + ((size_t)places[p].y * W + places[p].x) * 3;
            pixel[0] = pixel[1] = pixel[2] = sun;
            struct prt_cube cube;
            assert_int_equal(prt_env_to_cube(&ctx, &env, n, degrees, &cube), 0);
            const double want = latlong_power(&env.latlong);
            expect_near("power over the picture's", cube_power(&cube) / want, 1, 1e-5);
            double d[3], near_power = 0, far = 0;
            turned_direction(places[p].x + 0.5, places[p].y + 0.5, W, H, degrees, d);
            for (uint32_t i = 0; i < 6 * n * n; i++) {
                const uint32_t x = i % n, y = i / n % n;
                float dir[3];
                prt_cube_direction(i / n / n, 2 * (x + 0.5) / n - 1, 2 * (y + 0.5) / n - 1,
                                   dir);
                const double c = dir[0] * d[0] + dir[1] * d[1] + dir[2] * d[2];
                const double reach = 1.5 * 2.0 / n + 1.5 * 2 * PI / W;
                if (c > cos(reach))
                    near_power += (cube.texel[i * 3] - sky) * prt_cube_solid_angle(n, x, y);
                else far = fmax(far, fabs(cube.texel[i * 3] / sky - 1));
            }
            expect_near("share of the sun near its place", near_power / (want - sky * 4 * PI),
                        1, 2e-3);
            expect_below("change of the sky elsewhere", far, 5e-4);
            prt_cube_finish(&cube);
        }
    prt_free(env.latlong.rgb);
}

/* Law: a texel is the mean of the picture over it: a sum over 400 x 400 directions (METHODS
 * §2). */
static void texels_are_averages(void **state)
{
    enum { W = 1024, H = 512, N = 32, S = 400 };
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {W, H, NULL}};
    struct prt_rng rng;
    double worst = 0, sum = 0;
    env.latlong.rgb = prt_alloc(W * H * 3, sizeof(float));
    prt_rng_init(&rng, 11, 1);
    for (int i = 0; i < W * H * 3; i++) env.latlong.rgb[i] = expf(3 * prt_rng_f32(&rng));
    struct prt_cube cube;
    const double degrees = 123.4;
    assert_int_equal(prt_env_to_cube(&ctx, &env, N, degrees, &cube), 0);
    for (int k = 0; k < 60; k++) {
        const uint32_t face = k % 6, x = prt_rng_u32(&rng) % N, y = prt_rng_u32(&rng) % N;
        double total = 0, weight = 0;
        for (int j = 0; j < S; j++)
            for (int i = 0; i < S; i++) {
                const double s = 2 * (x + (i + prt_rng_f32(&rng)) / S) / N - 1;
                const double t = 2 * (y + (j + prt_rng_f32(&rng)) / S) / N - 1;
                const double w = pow(1 + s * s + t * t, -1.5), a = -degrees * PI / 180;
                float d[3];
                prt_cube_direction(face, s, t, d);
                const double dx = cos(a) * d[0] + sin(a) * d[2],
                             dz = -sin(a) * d[0] + cos(a) * d[2];
                const int px = (int)(W * (atan2(dx, -dz) / (2 * PI) + 0.5)) % W;
                const int py = (int)(H * (0.5 - asin(d[1]) / PI));
                total += w * env.latlong.rgb[(py * W + px) * 3];
                weight += w;
            }
        const double error =
            fabs(cube.texel[((face * N + y) * N + x) * 3] / (total / weight) - 1);
        worst = fmax(worst, error);
        sum += error / 60;
    }
    print_message("white noise, 6x32x32: mean error %.2g, worst %.2g\n", sum, worst);
    expect_below("error of a texel", worst, 1.5e-3);
    prt_free(env.latlong.rgb);
    prt_cube_finish(&cube);
}

/* Irradiance at a normal. */
static double irradiance(const struct prt_cube *cube, const float normal[3])
{
    double sum = 0;
    for (uint32_t i = 0; i < 6 * cube->n * cube->n; i++) {
        const uint32_t x = i % cube->n, y = i / cube->n % cube->n;
        float d[3];
        prt_cube_direction(i / cube->n / cube->n, 2 * (x + 0.5) / cube->n - 1,
                           2 * (y + 0.5) / cube->n - 1, d);
        const double c = d[0] * normal[0] + d[1] * normal[1] + d[2] * normal[2];
        if (c > 0)
            sum += c * luminance(cube->texel + 3 * i) * prt_cube_solid_angle(cube->n, x, y);
    }
    return sum;
}

/* The largest difference of the irradiance at 26 normals, over the greatest irradiance. */
static double irradiance_error(const struct prt_cube *a, const struct prt_cube *b)
{
    double worst = 0, most = 0;
    for (int k = 0; k < 27; k++) {
        float d[3] = {(float)(k % 3 - 1), (float)(k / 3 % 3 - 1), (float)(k / 9 - 1)};
        const float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        if (length == 0) continue;
        for (int c = 0; c < 3; c++) d[c] /= length;
        const double exact = irradiance(b, d);
        worst = fmax(worst, fabs(irradiance(a, d) - exact));
        most = fmax(most, exact);
    }
    return worst / most;
}

/* Bytes that are allocated. */
static double heap(void)
{
    const struct mallinfo2 m = mallinfo2();
    return (double)(m.uordblks + m.hblkhd);
}

/* Contract of prt_env_cache_create: what the cache of an environment that was turned through
 * all angles holds, at one size of cube. */
static void turned_lights_hold_memory(void **state)
{
    if (!(heap() > 0)) skip(); /* a sanitizer's allocator does not count */
    for (uint32_t n = 16; n <= 64; n *= 2) {
        struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {256, 128, NULL}};
        struct prt_cube turned;
        env.latlong.rgb = prt_calloc((size_t)256 * 128 * 3, sizeof(float));
        assert_int_equal(prt_env_cache_create(&env), 0);
        for (int i = 1; i < 360; i++) {
            assert_int_equal(prt_env_turned(&ctx, &env, n, i, &turned), 0);
            prt_cube_finish(&turned);
        }
        double held = heap();
        prt_env_cache_destroy(&env);
        held -= heap();
        expect_near("bytes held over those stated", held / (double)PRT_ENV_TURNED_BYTES(n), 1,
                    0.02);
        prt_image_finish(&env.latlong);
    }
}

/* Law: a light that turns quickly keeps its power and the irradiance of the exact cube, a sun
 * of one pixel, lat-long images of any size and cubes included (METHODS §2). */
static void turned_lights(void **state)
{
    static const uint32_t width[] = {1024, 300, 24};
    struct prt_rng rng;
    prt_rng_init(&rng, 5, 1);
    for (int k = 0; k < 12; k++) {
        const uint32_t w = width[k % 3], h = w / 2, n = 16u << k % 2;
        const double degrees = 31.7 * k + 0.4;
        struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {w, h, NULL}};
        struct prt_cube exact, turned, again, made;
        env.latlong.rgb = prt_alloc((size_t)w * h * 3, sizeof(float));
        for (size_t i = 0; i < (size_t)w * h * 3; i++)
            env.latlong.rgb[i] = expf(2 * prt_rng_f32(&rng));
        float *sun = env.latlong.rgb + 3 * (size_t)(prt_rng_u32(&rng) % (w * h));
        if (k % 2) sun[0] = sun[1] = sun[2] = 50.f * (float)(w * h);
        if (k > 8) { /* the same as a cube */
            assert_int_equal(prt_env_to_cube(&ctx, &env, 64, 0, &made), 0);
            prt_image_finish(&env.latlong);
            env.kind = PRT_ENV_CUBE;
            env.cube = made;
        }
        assert_int_equal(prt_env_cache_create(&env), 0);
        assert_int_equal(prt_env_to_cube(&ctx, &env, n, degrees, &exact), 0);
        assert_int_equal(prt_env_turned(&ctx, &env, n, degrees, &turned), 0);
        expect_near("power over the exact cube's", cube_power(&turned) / cube_power(&exact), 1,
                    1.8e-5);
        expect_below("difference of irradiance", irradiance_error(&turned, &exact), 2.6e-3);
        // Cubes that are kept between turns, and replaced, change nothing.
        for (int i = 0; i < 50; i++) {
            assert_int_equal(prt_env_turned(&ctx, &env, n, i < 49 ? 7.3 * i : degrees, &again),
                             0);
            if (i == 49)
                assert_memory_equal(again.texel, turned.texel, sizeof(float) * 18 * n * n);
            prt_cube_finish(&again);
        }
        prt_cube_finish(&exact);
        prt_cube_finish(&turned);
        prt_env_cache_destroy(&env);
        prt_image_finish(&env.latlong);
        if (k > 8) prt_cube_finish(&env.cube);
    }
}

/* Law: an image whose columns are moved by one turns as the image turned by one column less,
 * also between the last column and the first (METHODS §2). */
static void moved_columns_are_turns(void **state)
{
    enum { W = 128, H = 64, N = 16 }; /* as wide as the image that is turned */
    static const double columns[] = {0.5, -0.25, 1.75, 40.3, 127.5};
    struct prt_env env[2];
    struct prt_rng rng;
    prt_rng_init(&rng, 15, 1);
    for (int k = 0; k < 2; k++) {
        env[k] = (struct prt_env){.kind = PRT_ENV_LATLONG, .latlong = {W, H, NULL}};
        env[k].latlong.rgb = prt_alloc(3 * W * H, sizeof(float));
        assert_int_equal(prt_env_cache_create(&env[k]), 0);
    }
    for (size_t i = 0; i < W * H; i++)
        for (size_t c = 0; c < 3; c++)
            env[0].latlong.rgb[3 * i + c] =
                env[1].latlong.rgb[3 * (i / W * W + (i + 1) % W) + c] =
                    expf(2 * prt_rng_f32(&rng));
    for (size_t k = 0; k < sizeof columns / sizeof *columns; k++) {
        struct prt_cube still, moved;
        double worst = 0;
        assert_int_equal(prt_env_turned(&ctx, &env[0], N, (columns[k] - 1) * 360 / W, &still),
                         0);
        assert_int_equal(prt_env_turned(&ctx, &env[1], N, columns[k] * 360 / W, &moved), 0);
        for (size_t i = 0; i < 18 * N * N; i++)
            worst = fmax(worst, fabs((double)(moved.texel[i] - still.texel[i])));
        expect_below("difference of a texel of about 3", worst, 2e-5);
        prt_cube_finish(&still);
        prt_cube_finish(&moved);
    }
    for (int k = 0; k < 2; k++) {
        prt_env_cache_destroy(&env[k]);
        prt_image_finish(&env[k].latlong);
    }
}

/* Law: texels of a fine cube lie between the coarse picture's extremes, and power stays
 * (METHODS §2). */
static void upsampling_has_no_holes(void **state)
{
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {16, 8, NULL}};
    struct prt_cube cube;
    env.latlong.rgb = prt_alloc(16 * 8 * 3, sizeof(float));
    for (int i = 0; i < 16 * 8 * 3; i++) env.latlong.rgb[i] = 1 + (float)(i % 7);
    assert_int_equal(prt_env_to_cube(&ctx, &env, 128, 10, &cube), 0);
    for (int i = 0; i < 6 * 128 * 128 * 3; i++)
        expect_near("texel, of a picture in 1 to 7", cube.texel[i], 4, 3.05);
    expect_near("power over the picture's", cube_power(&cube) / latlong_power(&env.latlong), 1,
                1e-5);
    prt_cube_finish(&cube);
    prt_free(env.latlong.rgb);
}

static double relative_rms(const struct prt_cube *a, const struct prt_cube *b)
{
    double sum = 0, diff = 0;
    assert_int_equal(a->n, b->n);
    for (size_t i = 0; i < (size_t)6 * a->n * a->n * 3; i++) {
        sum += b->texel[i] * b->texel[i];
        diff += (a->texel[i] - b->texel[i]) * (a->texel[i] - b->texel[i]);
    }
    return sqrt(diff / sum);
}

static void load_cube(const char *file, uint32_t n, double degrees, struct prt_cube *cube)
{
    char path[512];
    struct prt_env *env = NULL;
    snprintf(path, sizeof path, PRT_SHARED_DATA "/env/%s", file);
    assert_int_equal(prt_env_load(&ctx, path, &env), 0);
    assert_int_equal(prt_env_to_cube(&ctx, env, n, degrees, cube), 0);
    prt_env_destroy(env);
}

/* Law: every layout of a picture gives the same cube (METHODS §2). Small lamps cut by texel
 * edges make the difference; a wrong orientation gives above 0.5. The OpenEXR pairs were
 * sampled with pixel centres on the edges, half a pixel from ours. */
static void layouts_agree(void **state)
{
    static const struct {
        const char *file, *other;
        double tolerance;
    } pairs[] = {{"cube/lobby_gl.dds", "latlong/lobby.exr", 0.04},
                 {"cube/lobby_hcross.exr", "cube/lobby_gl.dds", 1e-3},
                 {"cube/lobby_vcross.hdr", "cube/lobby_gl.dds", 0.01},
                 {"cube/lobby_faces", "cube/lobby_gl.dds", 0.01},
                 {"latlong/lobby.hdr", "latlong/lobby.exr", 0.01},
                 {"cube/studio_hcross.exr", "latlong/studio.exr", 0.03},
                 {"cube/studio_vcross.hdr", "latlong/studio.exr", 0.03},
                 {"cube/sunrise_hcross.exr", "cube/sunrise_vcross.hdr", 0.02},
                 {"cube/sunrise_hcross.exr", "latlong/sunrise.exr", 0.15},
                 {"cube/grace_vcross.hdr", "latlong/grace.exr", 0.03},
                 {"cube/stage_openexr_cube.exr", "latlong/stage_openexr.exr", 0.2},
                 {"cube/wavylines_openexr_cube.exr", "latlong/wavylines_openexr.exr", 0.2}};
    want_data(PRT_SHARED_DATA "/env");
    for (size_t i = 0; i < sizeof pairs / sizeof *pairs; i++)
        for (int turn = 0; turn < 2; turn++) {
            struct prt_cube a, b;
            load_cube(pairs[i].file, 32, turn * 40.0, &a);
            load_cube(pairs[i].other, 32, turn * 40.0, &b);
            const double d = relative_rms(&a, &b);
            expect_below(
                expect_name("%s - %.30s", pairs[i].file, strchr(pairs[i].other, '/') + 1), d,
                pairs[i].tolerance);
            prt_cube_finish(&a);
            prt_cube_finish(&b);
        }
}

/* Law: a quarter turn maps faces on faces: +X goes to -Z, and so on (METHODS §2). */
static void quarter_turns_map_faces(void **state)
{
    enum { N = 16 };
    struct prt_env latlong = {.kind = PRT_ENV_LATLONG, .latlong = {256, 128, NULL}};
    struct prt_env cube = {.kind = PRT_ENV_CUBE};
    struct prt_rng rng;
    prt_rng_init(&rng, 3, 3);
    latlong.latlong.rgb = prt_alloc(256 * 128 * 3, sizeof(float));
    for (int i = 0; i < 256 * 128 * 3; i++) latlong.latlong.rgb[i] = prt_rng_f32(&rng);
    assert_int_equal(prt_cube_init(&cube.cube, N), 0);
    for (int i = 0; i < 6 * N * N * 3; i++) cube.cube.texel[i] = prt_rng_f32(&rng);
    for (int k = 0; k < 2; k++) {
        const struct prt_env *env = k ? &cube : &latlong;
        struct prt_cube still, turned;
        assert_int_equal(prt_env_to_cube(&ctx, env, N, 0, &still), 0);
        for (int q = -1; q < 4; q++) {
            assert_int_equal(prt_env_to_cube(&ctx, env, N, 90.0 * q, &turned), 0);
            for (unsigned i = 0; i < 6 * N * N; i++) {
                float d[3], s, t;
                unsigned face;
                prt_cube_direction(i / N / N, 2 * (i % N + 0.5) / N - 1,
                                   2 * (i / N % N + 0.5) / N - 1, d);
                for (int r = 0; r < (q + 4) % 4; r++) { /* back: -90 degrees about +y */
                    const float x = d[0];
                    d[0] = -d[2];
                    d[2] = x;
                }
                prt_cube_lookup(d, &face, &s, &t);
                const int x = (int)((s + 1) * 0.5f * N), y = (int)((t + 1) * 0.5f * N);
                expect_near("texel after a turn", turned.texel[i * 3],
                            still.texel[((face * N + y) * N + x) * 3], 2e-3);
            }
            prt_cube_finish(&turned);
        }
        prt_cube_finish(&still);
    }
    prt_free(latlong.latlong.rgb);
    prt_cube_finish(&cube.cube);
}

/* Law: cube to lat-long keeps the power, and back nearly every texel (METHODS §2). */
static void cube_and_latlong_there_and_back(void **state)
{
    struct prt_cube cube, back;
    struct prt_image im;
    want_data(PRT_SHARED_DATA "/env");
    load_cube("latlong/grace.exr", 64, 0, &cube);
    assert_int_equal(prt_cube_to_latlong(&ctx, &cube, 2048, 1024, &im), 0);
    expect_near("power over the cube's", latlong_power(&im) / cube_power(&cube), 1, 1e-5);
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = im};
    assert_int_equal(prt_env_to_cube(&ctx, &env, 64, 0, &back), 0);
    expect_below("relative RMS there and back", relative_rms(&back, &cube), 0.06);
    prt_cube_finish(&back);
    prt_cube_finish(&cube);
    prt_image_finish(&im);
}

/* Law: cube to lat-long keeps the power of each channel (METHODS §2): lamps of one texel, a red
 * one on the upper face, a green one on a side, a blue one in a corner of the lower face. */
static void latlong_keeps_every_channel(void **state)
{
    enum { N = 12, W = 50, H = 25 };
    static const uint32_t lamp[3] = {2 * N * N + 3 * N + 7, 4 * N * N + 5 * N + 2, 3 * N * N};
    struct prt_cube cube;
    struct prt_image im;
    double want[3] = {0}, got[3] = {0};
    assert_int_equal(prt_cube_init(&cube, N), 0);
    memset(cube.texel, 0, 6 * N * N * 3 * sizeof(float));
    for (uint32_t c = 0; c < 3; c++) {
        cube.texel[lamp[c] * 3 + c] = 100;
        want[c] = 100 * prt_cube_solid_angle(N, lamp[c] % N, lamp[c] / N % N);
    }
    assert_int_equal(prt_cube_to_latlong(&ctx, &cube, W, H, &im), 0);
    for (int i = 0; i < W * H; i++) {
        const double up = cos(PI * (i / W) / H), low = cos(PI * (i / W + 1.0) / H);
        for (int c = 0; c < 3; c++)
            got[c] += (up - low) * 2 * PI / W * (double)im.rgb[i * 3 + c];
    }
    for (int c = 0; c < 3; c++)
        expect_near("power of one channel over the cube's", got[c] / want[c], 1, 1e-6);
    prt_cube_finish(&cube);
    prt_image_finish(&im);
}

/* Contract of prt_env_to_cube: equal bits for any number of threads; C agrees with vector code.
 */
static void threads_and_isa_agree(void **state)
{
    struct prt_context one = ctx, two = ctx, plain = ctx;
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {512, 256, NULL}};
    struct prt_cube a, b, c;
    struct prt_rng rng;
    assert_int_equal(prt_pool_create(3, &two.pool), 0);
    plain.cpu = PRT_CPU_C;
    prt_rng_init(&rng, 9, 9);
    env.latlong.rgb = prt_alloc(512 * 256 * 3, sizeof(float));
    for (int i = 0; i < 512 * 256 * 3; i++) env.latlong.rgb[i] = prt_rng_f32(&rng);
    assert_int_equal(prt_env_to_cube(&one, &env, 32, 12.3, &a), 0);
    assert_int_equal(prt_env_to_cube(&two, &env, 32, 12.3, &b), 0);
    assert_int_equal(prt_env_to_cube(&plain, &env, 32, 12.3, &c), 0);
    assert_memory_equal(a.texel, b.texel, 6 * 32 * 32 * 3 * sizeof(float));
    for (int i = 0; i < 6 * 32 * 32 * 3; i++)
        expect_close("C code", c.texel[i], a.texel[i], 1e-5);
    prt_cube_finish(&a);
    prt_cube_finish(&b);
    prt_cube_finish(&c);
    prt_free(env.latlong.rgb);
    prt_pool_destroy(two.pool);
}

/* Contract of prt_env_to_cube: sizes and angles out of range are refused. */
static void nonsense_is_refused(void **state)
{
    float pixel[3] = {1, 1, 1};
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {1, 1, pixel}};
    struct prt_cube cube;
    assert_int_equal(prt_env_to_cube(&ctx, &env, 0, 0, &cube), PRT_ARG);
    assert_int_equal(prt_env_to_cube(&ctx, &env, PRT_CUBE_MAX + 1, 0, &cube), PRT_ARG);
    assert_int_equal(prt_env_to_cube(&ctx, &env, 32, NAN, &cube), PRT_ARG);
    assert_int_equal(prt_env_to_cube(&ctx, &env, 32, 1e9, &cube), 0);
    assert_float_equal(cube.texel[17], 1, 1e-6);
    prt_cube_finish(&cube);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(files_keep_their_power),
        cmocka_unit_test(one_pixel_sun),
        cmocka_unit_test(texels_are_averages),
        cmocka_unit_test(turned_lights),
        cmocka_unit_test(turned_lights_hold_memory),
        cmocka_unit_test(moved_columns_are_turns),
        cmocka_unit_test(upsampling_has_no_holes),
        cmocka_unit_test(layouts_agree),
        cmocka_unit_test(quarter_turns_map_faces),
        cmocka_unit_test(cube_and_latlong_there_and_back),
        cmocka_unit_test(latlong_keeps_every_channel),
        cmocka_unit_test(threads_and_isa_agree),
        cmocka_unit_test(nonsense_is_refused),
    };
    return run_physics_tests(tests, setup, NULL);
}
