/* SPDX-License-Identifier: MIT */
/* Cube geometry, Haar, image files, layouts and file variants. Above 600 lines: a list of laws
 * and of formats, each read alone. */
#include "prt/light.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>
#include <unistd.h>
#include <cmocka.h>

#include "../data.h"

#define PI 3.14159265358979323846

static char last_line[1024];
static struct prt_context ctx;

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

static int setup(void **state)
{
    prt_context_init(&ctx);
    ctx.log = keep_line;
    setenv("PRT_LIBDIR", PRT_BINARY_DIR, 1);
    return 0;
}

/* ---- geometry ---- */

static void solid_angles_sum_to_4pi(void **state)
{
    for (uint32_t n = 1; n <= 257; n = n < 8 ? n + 1 : 2 * n + 1) {
        float *w = prt_alloc((size_t)n * n, sizeof *w);
        double sum = 0, sum_float = 0;
        prt_cube_solid_angles(n, w);
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                sum += prt_cube_solid_angle(n, x, y);
                sum_float += w[y * n + x];
                assert_float_equal(w[y * n + x], prt_cube_solid_angle(n, x, y),
                                   1e-6 * w[y * n + x]);
            }
        assert_true(fabs(6 * sum - 4 * PI) < 1e-11);
        assert_true(fabs(6 * sum_float - 4 * PI) < 1e-5);
        prt_free(w);
    }
    /* a whole face is a sixth of the sphere */
    assert_true(fabs(prt_cube_solid_angle(1, 0, 0) - 4 * PI / 6) < 1e-14);
}

static void directions_look_up_themselves(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 1, 1);
    for (unsigned i = 0; i < 20000; i++) {
        const unsigned face = i % 6;
        const double s = 1.998 * prt_rng_f32(&rng) - 0.999,
                     t = 1.998 * prt_rng_f32(&rng) - 0.999;
        float dir[3], s2, t2;
        unsigned face2;
        prt_cube_direction(face, s, t, dir);
        assert_float_equal(dir[0] * dir[0] + dir[1] * dir[1] + dir[2] * dir[2], 1, 1e-6);
        prt_cube_lookup(dir, &face2, &s2, &t2);
        assert_int_equal(face, face2);
        assert_float_equal(s, s2, 1e-5);
        assert_float_equal(t, t2, 1e-5);
    }
}

static void faces_look_along_their_axes(void **state)
{
    static const float axis[6][3] = {{1, 0, 0},  {-1, 0, 0}, {0, 1, 0},
                                     {0, -1, 0}, {0, 0, 1},  {0, 0, -1}};
    for (unsigned face = 0; face < 6; face++) {
        float dir[3];
        prt_cube_direction(face, 0, 0, dir);
        for (int c = 0; c < 3; c++) assert_float_equal(dir[c], axis[face][c], 0);
    }
    float up[3]; /* OpenGL: the top of the sides is +y, the top of +Y is -z */
    prt_cube_direction(4, 0, -1, up);
    assert_true(up[1] > 0.7f);
    prt_cube_direction(2, 0, -1, up);
    assert_true(up[2] < -0.7f);
}

/* ---- Haar ---- */

static void haar_is_orthonormal(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 7, 3);
    for (uint32_t n = 2; n <= 128; n *= 2) {
        float *a = prt_alloc((size_t)n * n, sizeof *a),
              *b = prt_alloc((size_t)n * n, sizeof *b);
        double before = 0, after = 0, sum = 0;
        for (uint32_t i = 0; i < n * n; i++) {
            a[i] = b[i] = prt_rng_f32(&rng) - 0.3f;
            before += (double)a[i] * a[i];
            sum += a[i];
        }
        prt_haar_forward(n, b);
        for (uint32_t i = 0; i < n * n; i++) after += (double)b[i] * b[i];
        assert_float_equal(after / before, 1, 1e-5); /* Parseval */
        assert_float_equal(b[0], sum / n, 1e-3);     /* scaling function 1/n */
        prt_haar_inverse(n, b);
        for (uint32_t i = 0; i < n * n; i++) assert_float_equal(a[i], b[i], 1e-5);
        prt_free(a);
        prt_free(b);
    }
}

/* A wavelet of the nested layout: its inverse transform is one step in x over a quadrant. */
static void haar_layout_is_nested(void **state)
{
    float p[64] = {0};
    p[1] = 1; /* coarsest horizontal detail, at (1,0) */
    prt_haar_inverse(8, p);
    for (int y = 0; y < 8; y++)
        for (int x = 0; x < 8; x++)
            assert_float_equal(p[y * 8 + x], x < 4 ? 0.125f : -0.125f, 1e-7);
    memset(p, 0, sizeof p);
    p[(4 + 1) * 8 + 2] = 1; /* finest vertical detail of block (2,1) */
    prt_haar_inverse(8, p);
    for (int y = 0; y < 8; y++)
        for (int x = 0; x < 8; x++) {
            const float want = x / 2 == 2 && y / 2 == 1 ? (y & 1 ? -0.5f : 0.5f) : 0;
            assert_float_equal(p[y * 8 + x], want, 1e-7);
        }
}

static void constant_light_has_six_coefficients(void **state)
{
    struct prt_env *env;
    struct prt_cube cube;
    struct prt_light light;
    assert_int_equal(prt_env_load(&ctx, "constant:2,0.5,3", &env), 0);
    assert_int_equal(prt_env_to_cube(&ctx, env, 32, 77.7, &cube), 0);
    for (uint32_t i = 0; i < 6 * 32 * 32; i++) {
        assert_float_equal(cube.texel[i * 3], 2, 1e-6);
        assert_float_equal(cube.texel[i * 3 + 1], 0.5, 1e-6);
        assert_float_equal(cube.texel[i * 3 + 2], 3, 1e-6);
    }
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    assert_int_equal((uintptr_t)light.coef % 64, 0);
    for (uint32_t i = 0; i < 6 * 32 * 32; i++)
        for (int c = 0; c < 4; c++)
            assert_float_equal(light.coef[i * 4 + c],
                               (i % 1024 || c == 3 ? 0
                                                   : 32 * (c == 0   ? 2
                                                           : c == 1 ? 0.5
                                                                    : 3)),
                               2e-5);
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    prt_env_destroy(env);
    struct prt_env *none;
    const char *const bad[] = {"constant:",        "constant:1",      "constant:1,2",
                               "constant:1,2,3,4", "constant:-1,1,1", "constant:nan,1,1",
                               "constant:1,2,inf", "constant:1,2,3x"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_int_equal(prt_env_load(&ctx, bad[i], &none), PRT_ARG);
}

static void light_wants_power_of_two(void **state)
{
    struct prt_cube cube;
    struct prt_light light;
    assert_int_equal(prt_cube_init(&cube, 12), 0);
    assert_int_equal(prt_light_from_cube(&cube, &light), PRT_ARG);
    prt_cube_finish(&cube);
    assert_int_equal(prt_cube_init(&cube, 0), PRT_ARG);
    assert_int_equal(prt_cube_init(&cube, PRT_CUBE_MAX + 1), PRT_ARG);
}

/* ---- layouts ---- */

/* A radiance that tells every direction apart. */
static void radiance(const double d[3], float rgb[3])
{
    const double r = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int c = 0; c < 3; c++) rgb[c] = (float)(1.5 + d[c] / r);
}

/* What a camera looking along `face` sees at (s,t), right-handed, t down; up is +y, and for the
 * +Y and -Y faces -z is towards the bottom respectively the top edge (data conventions). */
static void camera_view(unsigned face, double s, double t, double d[3])
{
    const double v[6][3] = {{1, -t, s}, {-1, -t, -s}, {s, 1, -t},
                            {s, -1, t}, {-s, -t, 1},  {s, -t, -1}};
    memcpy(d, v[face], sizeof v[face]);
}

enum { N = 16 };

static void draw_face(struct prt_image *im, unsigned face, uint32_t col, uint32_t row,
                      bool turned)
{
    for (uint32_t y = 0; y < N; y++)
        for (uint32_t x = 0; x < N; x++) {
            double s = 2 * (x + 0.5) / N - 1, t = 2 * (y + 0.5) / N - 1, d[3];
            camera_view(face, turned ? -s : s, turned ? -t : t, d);
            radiance(d, im->rgb + ((row * N + y) * (size_t)im->width + col * N + x) * 3);
        }
}

static struct prt_image blank(uint32_t width, uint32_t height)
{
    return (struct prt_image){width, height, prt_calloc((size_t)width * height * 3, 4)};
}

static void check_directions(const struct prt_env *env, double tolerance)
{
    struct prt_cube cube;
    assert_int_equal(prt_env_to_cube(&ctx, env, N, 0, &cube), 0);
    for (unsigned face = 0; face < 6; face++)
        for (uint32_t y = 0; y < N; y++)
            for (uint32_t x = 0; x < N; x++) {
                float dir[3], want[3];
                prt_cube_direction(face, 2 * (x + 0.5) / N - 1, 2 * (y + 0.5) / N - 1, dir);
                radiance((const double[3]){dir[0], dir[1], dir[2]}, want);
                for (int c = 0; c < 3; c++)
                    assert_float_equal(cube.texel[((face * N + y) * N + x) * 3 + c], want[c],
                                       tolerance);
            }
    prt_cube_finish(&cube);
}

static void check_image(struct prt_image *im)
{
    struct prt_blob blob;
    struct prt_env *env = NULL;
    assert_int_equal(prt_encode_exr(&ctx, im, true, &blob), 0);
    assert_int_equal(prt_env_load_memory(&ctx, "layout.exr", blob.bytes, blob.size, &env), 0);
    check_directions(env, 4e-3);
    prt_env_destroy(env);
    prt_free(blob.bytes);
    prt_image_finish(im);
}

static void crosses_and_strips(void **state)
{
    static const unsigned char h[6][2] = {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {3, 1}, {1, 1}};
    struct prt_image im = blank(4 * N, 3 * N);
    for (unsigned face = 0; face < 6; face++)
        draw_face(&im, face, h[face][0], h[face][1], false);
    check_image(&im);
    im = blank(3 * N, 4 * N);
    for (unsigned face = 0; face < 6; face++)
        draw_face(&im, face, face == 4 ? 1 : h[face][0], face == 4 ? 3 : h[face][1], face == 4);
    check_image(&im);
    im = blank(6 * N, N);
    for (unsigned face = 0; face < 6; face++) draw_face(&im, face, face, 0, false);
    check_image(&im);
    im = blank(N, 6 * N);
    for (unsigned face = 0; face < 6; face++) draw_face(&im, face, 0, face, false);
    check_image(&im);
}

static void latlong_directions(void **state)
{
    struct prt_image im = blank(256, 128);
    for (uint32_t y = 0; y < im.height; y++)
        for (uint32_t x = 0; x < im.width; x++) {
            const double phi = 2 * PI * ((x + 0.5) / im.width - 0.5);
            const double theta = PI * (0.5 - (y + 0.5) / im.height);
            const double d[3] = {sin(phi) * cos(theta), sin(theta), -cos(phi) * cos(theta)};
            radiance(d, im.rgb + ((size_t)y * im.width + x) * 3);
        }
    check_image(&im);
}

static void folder_of_faces(void **state)
{
    static const char *const sets[2][6] = {{"posx", "negx", "posy", "negy", "posz", "negz"},
                                           {"px", "nx", "py", "ny", "pz", "nz"}};
    char dir[] = "/tmp/prt-light-XXXXXX", path[128];
    assert_non_null(mkdtemp(dir));
    for (int set = 0; set < 2; set++) {
        for (unsigned face = 0; face < 6; face++) {
            struct prt_image im = blank(N, N);
            draw_face(&im, face, 0, 0, false);
            snprintf(path, sizeof path, "%s/%s%s.exr", dir, set ? "sky_" : "", sets[set][face]);
            assert_int_equal(prt_write_exr(&ctx, path, &im, true, false), 0);
            prt_image_finish(&im);
        }
        struct prt_env *env = NULL;
        snprintf(path, sizeof path, set ? "%s/sky_*.exr" : "%s", dir);
        assert_int_equal(prt_env_load(&ctx, path, &env), 0);
        check_directions(env, 4e-3);
        prt_env_destroy(env);
    }
    struct prt_env *env = NULL; /* both sets are there now: ambiguous */
    assert_int_equal(prt_env_load(&ctx, dir, &env), PRT_FORMAT);
    assert_non_null(strstr(last_line, "pattern"));
    snprintf(path, sizeof path, "%s/sky_nz.exr", dir);
    unlink(path);
    snprintf(path, sizeof path, "%s/sky_%%s.exr", dir);
    assert_int_equal(prt_env_load(&ctx, path, &env), PRT_FORMAT);
    assert_non_null(strstr(last_line, "negz"));
    for (int set = 0; set < 2; set++)
        for (unsigned face = 0; face < 6; face++) {
            snprintf(path, sizeof path, "%s/%s%s.exr", dir, set ? "sky_" : "", sets[set][face]);
            unlink(path);
        }
    rmdir(dir);
}

static void envmap_cube_round_trip(void **state)
{
    char path[] = "/tmp/prt-light-XXXXXX";
    const int fd = mkstemp(path);
    assert_true(fd >= 0);
    close(fd);
    struct prt_image im = blank(N, 6 * N);
    struct prt_env *env = NULL;
    for (unsigned face = 0; face < 6; face++)
        draw_face(&im, face, 0, face, false); /* OpenEXR's faces are camera views */
    assert_int_equal(prt_write_exr(&ctx, path, &im, false, true), 0);
    assert_int_equal(prt_env_load(&ctx, path, &env), 0);
    check_directions(env, 5e-3);
    prt_env_destroy(env);
    prt_image_finish(&im);
    im = blank(N, 5 * N);
    assert_int_equal(prt_write_exr(&ctx, path, &im, false, true), PRT_ARG);
    prt_image_finish(&im);
    unlink(path);
}

static void squares_are_refused(void **state)
{
    struct prt_image im = blank(40, 40);
    struct prt_blob blob;
    struct prt_env *env = NULL;
    assert_int_equal(prt_encode_exr(&ctx, &im, false, &blob), 0);
    assert_int_equal(prt_env_load_memory(&ctx, "probe.exr", blob.bytes, blob.size, &env),
                     PRT_FORMAT);
    assert_null(env);
    assert_non_null(strstr(last_line, "probe.exr: 40 x 40"));
    prt_free(blob.bytes);
    prt_image_finish(&im);
}

/* ---- image files ---- */

static void exr_round_trip(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 5, 5);
    for (int full = 0; full < 2; full++) {
        struct prt_image im = blank(37, 53), back;
        char path[] = "/tmp/prt-light-XXXXXX";
        close(mkstemp(path));
        for (size_t i = 0; i < 37 * 53 * 3; i++) im.rgb[i] = expf(20 * prt_rng_f32(&rng) - 10);
        im.rgb[0] = 1e6f;
        assert_int_equal(prt_write_exr(&ctx, path, &im, full, false), 0);
        assert_int_equal(prt_image_load(&ctx, path, &back), 0);
        assert_int_equal(back.width, 37);
        assert_int_equal(back.height, 53);
        for (size_t i = 1; i < 37 * 53 * 3; i++)
            assert_float_equal(back.rgb[i] / im.rgb[i], 1, full ? 0 : 1.0 / 1024);
        assert_float_equal(back.rgb[0], full ? 1e6f : 65504.0f, 0);
        prt_image_finish(&im);
        prt_image_finish(&back);
        unlink(path);
    }
}

// An EXR has every line of its alpha. Renamed, the channels A, B and G are read as B, G and R.
static void exr_alpha_round_trip(void **state)
{
    enum { W = 5, H = 40, CHANNEL = 18 }; // bytes of a channel of one letter in the header
    static const char renamed[4] = {'B', 'G', 'R', 'Z'};
    float alpha[W * H];
    struct prt_image im = blank(W, H), back;
    struct prt_blob blob;
    for (int i = 0; i < W * H; i++) {
        alpha[i] = (float)(i % 101) / 128;
        for (int c = 0; c < 3; c++) im.rgb[3 * i + c] = (float)(c + 1);
    }
    im.alpha = alpha;
    assert_int_equal(prt_encode_exr(&ctx, &im, true, &blob), PRT_OK);
    char *at = memmem(blob.bytes, blob.size, "A\0\2\0\0\0", 6);
    assert_non_null(at);
    for (int c = 0; c < 4; c++) at[c * CHANNEL] = renamed[c];
    assert_int_equal(prt_image_load_memory(&ctx, "a.exr", blob.bytes, blob.size, &back),
                     PRT_OK);
    for (int i = 0; i < W * H; i++) {
        assert_float_equal(back.rgb[3 * i + 2], alpha[i], 0);
        assert_float_equal(back.rgb[3 * i + 1], 3, 0); // blue
        assert_float_equal(back.rgb[3 * i], 2, 0);     // green
    }
    prt_free(blob.bytes);
    im.alpha = NULL;
    prt_image_finish(&im);
    prt_image_finish(&back);
}

static double srgb_to_linear(double v)
{
    return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

static void png_and_jpeg_are_linearised(void **state)
{
    enum { W = 64, H = 32 };
    static uint8_t rgb[W * H * 3], rgba[W * H * 4];
    static uint16_t fine[W * H * 3];
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            const uint8_t p[3] = {(uint8_t)(4 * x), (uint8_t)(8 * y), (uint8_t)(2 * x + 3 * y)};
            memcpy(rgb + (y * W + x) * 3, p, 3);
            memcpy(rgba + (y * W + x) * 4, p, 3);
            rgba[(y * W + x) * 4 + 3] = 255;
        }
    for (int i = 0; i < W * H * 3; i++) fine[i] = (uint16_t)(257 * rgb[i]);
    struct prt_blob blob[4];
    assert_int_equal(prt_encode_png16(&ctx, fine, W, H, 3, &blob[3]), 0);
    assert_int_equal(prt_encode_png(&ctx, rgb, W, H, 3, &blob[0]), 0);
    assert_int_equal(prt_encode_png(&ctx, rgba, W, H, 4, &blob[1]), 0);
    assert_int_equal(prt_encode_jpeg(&ctx, rgb, W, H, 98, &blob[2]), 0);
    for (int k = 0; k < 4; k++) {
        struct prt_env *env = NULL;
        const char *name = k == 2 ? "blob.jpg" : "no-extension";
        assert_int_equal(prt_env_load_memory(&ctx, name, blob[k].bytes, blob[k].size, &env), 0);
        assert_int_equal(env->kind, PRT_ENV_LATLONG);
        assert_int_equal(env->latlong.width, W);
        for (int i = 0; i < W * H * 3; i++)
            assert_float_equal(env->latlong.rgb[i], srgb_to_linear(rgb[i] / 255.0),
                               k == 2 ? 0.05 : 1e-4);
        prt_env_destroy(env);
        prt_free(blob[k].bytes);
    }
    assert_int_equal(prt_encode_png(&ctx, rgb, 0, H, 3, &blob[0]), PRT_ARG);
    assert_int_equal(prt_encode_png16(&ctx, fine, W, 0, 3, &blob[0]), PRT_ARG);
    assert_int_equal(prt_encode_png(&ctx, rgb, W, H, 2, &blob[0]), PRT_ARG);
    assert_int_equal(prt_encode_jpeg(&ctx, rgb, W, H, 101, &blob[0]), PRT_ARG);
}

// A file that was cut off anywhere is refused; decoders fill up the rest of a JPEG with grey.
static void a_jpeg_without_its_end_is_refused(void **state)
{
    enum { W = 64, H = 32 };
    static uint8_t rgb[W * H * 3];
    for (int i = 0; i < W * H * 3; i++) rgb[i] = (uint8_t)(i * 7);
    struct prt_blob jpeg;
    struct prt_env *env;
    assert_int_equal(prt_encode_jpeg(&ctx, rgb, W, H, 90, &jpeg), 0);
    for (size_t n = jpeg.size - 1; n > jpeg.size / 2; n -= 1 + n / 64) {
        env = NULL;
        assert_int_equal(prt_env_load_memory(&ctx, "cut.jpg", jpeg.bytes, n, &env), PRT_FORMAT);
        assert_null(env);
    }
    assert_int_equal(prt_env_load_memory(&ctx, "whole.jpg", jpeg.bytes, jpeg.size, &env), 0);
    prt_env_destroy(env);
    prt_free(jpeg.bytes);
}

// ---- PNGs made by hand: every filter, depth and kind of colour that is read here ----

static uint32_t png_crc(const uint8_t *p, size_t n)
{
    uint32_t c = ~0u;
    while (n--) {
        c ^= *p++;
        for (int k = 0; k < 8; k++) c = c & 1 ? c >> 1 ^ 0xedb88320u : c >> 1;
    }
    return ~c;
}

static uint8_t *png_u32(uint8_t *p, uint32_t v)
{
    for (int k = 24; k >= 0; k -= 8) *p++ = (uint8_t)(v >> k);
    return p;
}

static uint8_t *png_chunk(uint8_t *p, const char *type, const void *body, size_t n)
{
    uint8_t *start = png_u32(p, (uint32_t)n);
    memcpy(start, type, 4);
    if (n) memcpy(start + 4, body, n);
    return png_u32(start + 4 + n, png_crc(start, n + 4));
}

static int png_predict(int filter, int a, int b, int c)
{
    int p = a + b - c, pa = abs(p - a), pb = abs(p - b), pc = abs(p - c);
    int paeth = pa <= pb && pa <= pc ? a : pb <= pc ? b : c;
    return filter == 1   ? a
           : filter == 2 ? b
           : filter == 3 ? (a + b) / 2
           : filter == 4 ? paeth
                         : 0;
}

// raw [h][row_bytes]; filters change from row to row. One stored deflate block. Returns the
// size.
static size_t make_png(uint32_t w, uint32_t h, int depth, int type, const uint8_t *raw,
                       size_t row_bytes, size_t step, const uint8_t *palette, uint8_t *out)
{
    static uint8_t body[1 << 16];
    uint8_t *p = body, head[13], *at = out;
    size_t n = (row_bytes + 1) * h;
    uint32_t low = 1, high = 0;
    assert_true(n < 65000);
    *p++ = 0x78;
    *p++ = 1;
    const uint8_t stored[5] = {1, (uint8_t)n, (uint8_t)(n >> 8), (uint8_t)~n,
                               (uint8_t)(~n >> 8)};
    memcpy(p, stored, 5);
    p += 5;
    for (uint32_t y = 0; y < h; y++) {
        const uint8_t *row = raw + y * row_bytes, *above = y ? row - row_bytes : NULL;
        int filter = (int)(y % 5);
        *p++ = (uint8_t)filter;
        for (size_t i = 0; i < row_bytes; i++)
            *p++ = (uint8_t)(row[i] - png_predict(filter, i >= step ? row[i - step] : 0,
                                                  above ? above[i] : 0,
                                                  above && i >= step ? above[i - step] : 0));
    }
    for (uint8_t *q = body + 7; q < p; q++) {
        low = (low + *q) % 65521;
        high = (high + low) % 65521;
    }
    p = png_u32(p, high << 16 | low);
    png_u32(png_u32(head, w), h);
    memcpy(head + 8, (const uint8_t[5]){(uint8_t)depth, (uint8_t)type, 0, 0, 0}, 5);
    memcpy(at, "\x89PNG\r\n\x1a\n", 8);
    at = png_chunk(at + 8, "IHDR", head, 13);
    if (palette) at = png_chunk(at, "PLTE", palette, 768);
    at = png_chunk(at, "IDAT", body, 1000); // two chunks, cut anywhere
    at = png_chunk(at, "IDAT", body + 1000, (size_t)(p - body) - 1000);
    return (size_t)(png_chunk(at, "IEND", NULL, 0) - out);
}

static void png_of_every_plain_kind(void **state)
{
    enum { W = 64, H = 32 };
    static const int kind[][3] = {{8, 0, 1},  {8, 2, 3},  {8, 3, 1},  {8, 4, 2}, {8, 6, 4},
                                  {16, 0, 1}, {16, 2, 3}, {16, 4, 2}, {16, 6, 4}};
    static uint8_t raw[W * H * 8], palette[768], file[1 << 17];
    struct prt_rng rng;
    prt_rng_init(&rng, 3, 4);
    for (size_t i = 0; i < sizeof raw; i++)
        raw[i] = (uint8_t)(i / 40 + (prt_rng_u32(&rng) >> 28)); // smooth, wrapping
    for (int i = 0; i < 768; i++) palette[i] = (uint8_t)(prt_rng_u32(&rng) >> 24);
    for (size_t k = 0; k < sizeof kind / sizeof *kind; k++) {
        size_t wide = (size_t)kind[k][0] / 8, n = (size_t)kind[k][2], step = wide * n;
        struct prt_env *env = NULL;
        size_t size = make_png(W, H, kind[k][0], kind[k][1], raw, W * step, step,
                               kind[k][1] == 3 ? palette : NULL, file);
        assert_int_equal(prt_env_load_memory(&ctx, "kind.png", file, size, &env), 0);
        for (size_t i = 0; i < W * H; i++)
            for (size_t c = 0; c < 3; c++) {
                const uint8_t *p = raw + i * step + (n >= 3 ? c * wide : 0);
                double v = kind[k][1] == 3 ? palette[3 * p[0] + c] / 255.0
                           : wide == 2     ? (p[0] * 256 + p[1]) / 65535.0
                                           : p[0] / 255.0;
                assert_float_equal(env->latlong.rgb[3 * i + c], srgb_to_linear(v), 2e-6);
            }
        prt_env_destroy(env);
        // Damage is not taken for a picture.
        file[size - 30] ^= 4;
        assert_int_not_equal(prt_env_load_memory(&ctx, "kind.png", file, size, &env), 0);
    }
}

/* ---- the development data's variants ---- */

static void load_image(const char *folder, const char *file, struct prt_image *im)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s", folder, file);
    if (prt_image_load(&ctx, path, im)) fail_msg("%s: %s", file, last_line);
}

static double worst_difference(const struct prt_image *a, const struct prt_image *b)
{
    double worst = 0;
    assert_int_equal(a->width, b->width);
    assert_int_equal(a->height, b->height);
    for (size_t i = 0; i < (size_t)a->width * a->height * 3; i++) {
        const double d = fabs(a->rgb[i] - b->rgb[i]) / (fabs(b->rgb[i]) + 1e-3);
        worst = d > worst ? d : worst;
    }
    return worst;
}

static void exr_variants(void **state)
{
    static const struct {
        const char *file;
        double tolerance;
    } same[] = {{"float_zip.exr", 0},        {"float_piz.exr", 0},
                {"float_pxr24.exr", 1.6e-5}, {"half_none.exr", 5e-4},
                {"half_rle.exr", 5e-4},      {"half_zip.exr", 5e-4},
                {"half_zips.exr", 5e-4},     {"half_piz.exr", 5e-4},
                {"half_pxr24.exr", 5e-4},    {"half_b44.exr", 0.21},
                {"half_b44a.exr", 0.21},     {"half_dwaa.exr", 0.33},
                {"half_dwab.exr", 0.33},     {"decreasing_y.exr", 5e-4},
                {"tiled32.exr", 5e-4},       {"multipart.exr", 5e-4},
                {"layered_names.exr", 5e-4}, {"mixed_types.exr", 5e-4},
                {"rgba_alpha1.exr", 5e-4},   {"datawindow_negative_origin.exr", 5e-4}};
    const char *dir = PRT_SHARED_DATA "/env/exr_variants";
    struct prt_image ref, im;
    want_data(dir);
    load_image(dir, "ref_float_none.exr", &ref);
    for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
        load_image(dir, same[i].file, &im);
        const double d = worst_difference(&im, &ref);
        if (!(d <= same[i].tolerance)) fail_msg("%s differs by %g", same[i].file, d);
        prt_image_finish(&im);
    }
    load_image(dir, "gray_Y_only.exr", &im);
    for (size_t i = 0; i < 256 * 128; i++) {
        const float *p = ref.rgb + i * 3;
        const double y = 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2];
        assert_float_equal(im.rgb[i * 3 + 1], y, 2e-3 * y + 1e-5);
        assert_float_equal(im.rgb[i * 3], im.rgb[i * 3 + 2], 0);
    }
    prt_image_finish(&im);
    load_image(dir, "datawindow_inset.exr", &im); /* 32..223 x 16..111 of the picture */
    for (int y = 0; y < 128; y++)
        for (int x = 0; x < 256; x++) {
            const bool in = x >= 32 && x <= 223 && y >= 16 && y <= 111;
            const float want = in ? ref.rgb[(y * 256 + x) * 3] : 0;
            assert_float_equal(im.rgb[(y * 256 + x) * 3], want, 5e-4 * want);
        }
    prt_image_finish(&im);
    prt_image_finish(&ref);
    load_image(dir, "luminance_chroma_flowers_openexr.exr", &im);
    double mean[3] = {0};
    for (size_t i = 0; i < (size_t)im.width * im.height * 3; i++) {
        assert_true(isfinite(im.rgb[i]));
        mean[i % 3] += im.rgb[i] / im.width / im.height;
    }
    assert_true(mean[2] > mean[0] && mean[0] > mean[1] * 0.9); /* blue hydrangeas */
    prt_image_finish(&im);
    char path[512];
    snprintf(path, sizeof path, "%s/deep_openexr.exr", dir);
    assert_int_equal(prt_image_load(&ctx, path, &im), PRT_FORMAT);
    assert_non_null(strstr(last_line, "deep"));
}

static void pixels_are_mended(void **state)
{
    static const char *const files[] = {"nan_inf_negative_pixels.exr",
                                        "nan_inf_negative_pixels_float.exr",
                                        "big_values_float_1e30.exr", "denormals.exr"};
    want_data(PRT_SHARED_DATA "/env/exr_variants");
    for (int f = 0; f < 4; f++) {
        char path[512];
        struct prt_env *env = NULL;
        snprintf(path, sizeof path, PRT_SHARED_DATA "/env/exr_variants/%s", files[f]);
        last_line[0] = 0;
        assert_int_equal(prt_env_load(&ctx, path, &env), 0);
        for (size_t i = 0; i < (size_t)env->latlong.width * env->latlong.height * 3; i++)
            assert_true(isfinite(env->latlong.rgb[i]) && env->latlong.rgb[i] >= 0);
        assert_int_equal(env->n_nonfinite > 0, f < 2);
        assert_int_equal(env->n_negative > 0, f < 2);
        assert_int_equal(last_line[0] != 0, f < 2);
        prt_env_destroy(env);
    }
}

/* An infinite pixel gets the largest finite value of its channel. Values that are no number or
 * below 0 become 0. */
static void values_of_mended_pixels(void **state)
{
    char path[] = "/tmp/prt-light-XXXXXX";
    struct prt_env *env = NULL;
    struct prt_image im = blank(8, 4);
    close(mkstemp(path));
    for (size_t i = 0; i < 3 * 8 * 4; i++) im.rgb[i] = (float)(i + 1);
    im.rgb[3 * 5 + 1] = INFINITY;
    im.rgb[3 * 6 + 2] = NAN;
    im.rgb[3 * 7] = -3;
    assert_int_equal(prt_write_exr(&ctx, path, &im, true, false), 0);
    assert_int_equal(prt_env_load(&ctx, path, &env), 0);
    for (size_t i = 0; i < 3 * 8 * 4; i++) {
        const float want = i == 3 * 5 + 1                 ? 3 * 31 + 2
                           : i == 3 * 6 + 2 || i == 3 * 7 ? 0
                                                          : (float)(i + 1);
        assert_float_equal(env->latlong.rgb[i], want, 0);
    }
    assert_int_equal(env->n_nonfinite, 2);
    assert_int_equal(env->n_negative, 1);
    prt_env_destroy(env);
    prt_image_finish(&im);
    unlink(path);
}

/* The largest channel of a Radiance pixel is rounded to the nearest of 256 steps, also where it
 * rounds up to the next power of two. */
static void rgbe_rounds_to_nearest(void **state)
{
    enum { W = 64, H = 32 };
    struct prt_image im = blank(W, H), back;
    struct prt_blob blob;
    for (int i = 0; i < W * H; i++) {
        im.rgb[3 * i + 1] = ldexpf(0.5f + 0.5f * (float)i / (W * H), i % 9 - 4);
        im.rgb[3 * i] = 0.3f * im.rgb[3 * i + 1];
        im.rgb[3 * i + 2] = i % 2 ? im.rgb[3 * i + 1] : 0;
    }
    assert_int_equal(prt_encode_hdr(&ctx, &im, &blob), PRT_OK);
    assert_int_equal(prt_image_load_memory(&ctx, "a.hdr", blob.bytes, blob.size, &back), 0);
    for (int i = 0; i < W * H; i++) {
        const float half_step = ldexpf(0.501f, i % 9 - 4 - 8);
        assert_float_equal(back.rgb[3 * i + 1], im.rgb[3 * i + 1], half_step);
        assert_float_equal(back.rgb[3 * i], im.rgb[3 * i], 2 * half_step);
        assert_float_equal(back.rgb[3 * i + 2], im.rgb[3 * i + 2], half_step);
    }
    prt_free(blob.bytes);
    prt_image_finish(&back);
    prt_image_finish(&im);
}

static void hdr_variants(void **state)
{
    static const char *const same[] = {"flat.hdr",
                                       "gamma_and_comments.hdr",
                                       "magic_rgbe.hdr",
                                       "no_format_line.hdr",
                                       "trailing_garbage.hdr",
                                       "bottom_up_plusY.hdr",
                                       "mirrored_minusX.hdr",
                                       "rotated_X_first.hdr",
                                       "exposure_2.hdr",
                                       "exposure_twice_2x4.hdr"};
    const char *dir = PRT_SHARED_DATA "/env/hdr_variants";
    struct prt_image ref, im;
    want_data(dir);
    load_image(dir, "ref_rle.hdr", &ref);
    for (size_t i = 0; i < sizeof same / sizeof *same; i++) {
        load_image(dir, same[i], &im);
        const double d = worst_difference(&im, &ref);
        if (d > 1e-6) fail_msg("%s differs by %g", same[i], d);
        prt_image_finish(&im);
    }
    load_image(dir, "xyze.hdr",
               &im); /* 8-bit mantissas of XYZ: a few percent in saturated colours */
    double sum = 0, error = 0;
    for (size_t i = 0; i < 128 * 64 * 3; i++) {
        sum += ref.rgb[i] * ref.rgb[i];
        error += (im.rgb[i] - ref.rgb[i]) * (im.rgb[i] - ref.rgb[i]);
    }
    assert_true(sqrt(error / sum) < 0.01);
    prt_image_finish(&im);
    prt_image_finish(&ref);
    load_image(dir, "old_style_rle_reference.hdr", &ref);
    load_image(dir, "old_style_rle.hdr", &im);
    assert_float_equal(worst_difference(&im, &ref), 0, 1e-7);
    prt_image_finish(&im);
    prt_image_finish(&ref);
    load_image(dir, "imagers_old-rle.hdr", &im);
    prt_image_finish(&im);
    load_image(dir, "width7_must_be_flat.hdr", &im);
    assert_int_equal(im.width, 7);
    prt_image_finish(&im);
}

// A header that is broken is told as what it is.
static void hdr_headers_that_are_refused(void **state)
{
    static const struct {
        const char *lines, *size, *why; // why NULL: it is read
        int status;
    } row[] = {
        {"FORMAT=32-bit_rle_rgbe\n\n", "-Y 1 +X 1", NULL, PRT_OK},
        {"EXPOSURE=2\n\n", "+X 1 -Y 1", NULL, PRT_OK},
        {"FORMAT=32-bit_rle\n\n", "-Y 1 +X 1", "unknown format \"32-bit_rle\"", PRT_FORMAT},
        {"EXPOSURE=0\n\n", "-Y 1 +X 1", "EXPOSURE must be a positive number", PRT_FORMAT},
        {"EXPOSURE=much\n\n", "-Y 1 +X 1", "EXPOSURE must be a positive number", PRT_FORMAT},
        {"EXPOSURE=1e21\n\n", "-Y 1 +X 1", "EXPOSURE must be a positive number", PRT_FORMAT},
        {"\n", "-Y 1 +Y 1", "no valid resolution line", PRT_FORMAT},
        {"\n", "-Y 0 +X 1", "no valid resolution line", PRT_FORMAT},
        {"\n", "-Y 1 *X 1", "no valid resolution line", PRT_FORMAT},
        {"\n", "-Y 1", "no valid resolution line", PRT_FORMAT},
        {"\n", "-Y 1 +X 99999999", "above the limit", PRT_LIMIT},
        {"", "", "no empty line at its end", PRT_FORMAT}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char file[200];
        struct prt_image im;
        const int n = snprintf(file, sizeof file, "#?RADIANCE\n%s%s%sabcd", row[i].lines,
                               row[i].size, *row[i].size ? "\n" : "");
        const int status = prt_image_load_memory(&ctx, "h.hdr", file, (size_t)n, &im);
        if (status != row[i].status || (row[i].why && !strstr(last_line, row[i].why)))
            fail_msg("%zu: %d, %s", i, status, last_line);
        if (!status) prt_image_finish(&im);
    }
}

// Strips are encoded by several threads: the picture is that of one encoder, coefficient by
// coefficient, whatever the height, the sampling and the threads.
static void jpeg_in_strips_is_one_picture(void **state)
{
    static const uint32_t size[][2] = {
        {61, 127}, {200, 128}, {37, 600}, {640, 333}, {16, 1500}};
    struct prt_context pooled;
    prt_context_init(&pooled);
    assert_int_equal(prt_pool_create(3, &pooled.pool), PRT_OK);
    for (int k = 0; k < 10; k++) {
        const uint32_t w = size[k / 2][0], h = size[k / 2][1];
        const int quality = k % 2 ? 90 : 70, sampling = k % 2 ? TJSAMP_444 : TJSAMP_420;
        struct prt_rng rng;
        prt_rng_init(&rng, 5, (uint64_t)k);
        uint8_t *rgb = test_malloc(w * h * 3), *a = test_malloc(w * h * 3),
                *b = test_malloc(w * h * 3);
        for (uint32_t i = 0; i < w * h * 3; i++)
            rgb[i] = (uint8_t)(i / 3 % w * 200 / w + (prt_rng_u32(&rng) >> 27));
        struct prt_blob strips, alone;
        assert_int_equal(prt_encode_jpeg(&pooled, rgb, w, h, quality, &strips), PRT_OK);
        assert_int_equal(prt_encode_jpeg(NULL, rgb, w, h, quality, &alone), PRT_OK);
        assert_int_equal(strips.size, alone.size);
        assert_memory_equal(strips.bytes, alone.bytes, alone.size);
        tjhandle pack = tjInitCompress(), unpack = tjInitDecompress();
        unsigned char *whole = NULL;
        unsigned long n = 0;
        assert_int_equal(tjCompress2(pack, rgb, (int)w, 0, (int)h, TJPF_RGB, &whole, &n,
                                     sampling, quality, TJFLAG_FASTDCT),
                         0);
        assert_int_equal(tjDecompress2(unpack, whole, n, a, (int)w, 0, (int)h, TJPF_RGB, 0), 0);
        assert_int_equal(
            tjDecompress2(unpack, strips.bytes, strips.size, b, (int)w, 0, (int)h, TJPF_RGB, 0),
            0);
        assert_memory_equal(a, b, w * h * 3);
        tjFree(whole);
        tjDestroy(pack);
        tjDestroy(unpack);
        prt_free(strips.bytes);
        prt_free(alone.bytes);
        test_free(rgb);
        test_free(a);
        test_free(b);
    }
    prt_pool_destroy(pooled.pool);
}

// A cube made by hand turns the same with what a loaded one keeps and without, again and again.
static void cache_of_a_turned_cube(void **state)
{
    enum { SIDE = 32 };
    struct prt_env env = {.kind = PRT_ENV_CUBE};
    struct prt_cube plain, cached;
    struct prt_rng rng;
    prt_rng_init(&rng, 9, 1);
    assert_int_equal(prt_cube_init(&env.cube, SIDE), 0);
    for (int i = 0; i < 18 * SIDE * SIDE; i++) env.cube.texel[i] = prt_rng_f32(&rng);
    assert_int_equal(prt_env_to_cube(&ctx, &env, 16, 33, &plain), 0);
    assert_int_equal(prt_env_cache_create(&env), 0);
    for (int i = 0; i < 2; i++) {
        assert_int_equal(prt_env_to_cube(&ctx, &env, 16, 33, &cached), 0);
        assert_memory_equal(plain.texel, cached.texel, 18 * 16 * 16 * sizeof(float));
        prt_cube_finish(&cached);
    }
    prt_env_cache_destroy(&env);
    prt_env_cache_destroy(&env); // nothing is left: nothing happens
    prt_cube_finish(&plain);
    prt_cube_finish(&env.cube);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(solid_angles_sum_to_4pi),
        cmocka_unit_test(directions_look_up_themselves),
        cmocka_unit_test(faces_look_along_their_axes),
        cmocka_unit_test(haar_is_orthonormal),
        cmocka_unit_test(haar_layout_is_nested),
        cmocka_unit_test(constant_light_has_six_coefficients),
        cmocka_unit_test(light_wants_power_of_two),
        cmocka_unit_test(crosses_and_strips),
        cmocka_unit_test(latlong_directions),
        cmocka_unit_test(folder_of_faces),
        cmocka_unit_test(envmap_cube_round_trip),
        cmocka_unit_test(squares_are_refused),
        cmocka_unit_test(exr_round_trip),
        cmocka_unit_test(exr_alpha_round_trip),
        cmocka_unit_test(png_and_jpeg_are_linearised),
        cmocka_unit_test(a_jpeg_without_its_end_is_refused),
        cmocka_unit_test(cache_of_a_turned_cube),
        cmocka_unit_test(jpeg_in_strips_is_one_picture),
        cmocka_unit_test(png_of_every_plain_kind),
        cmocka_unit_test(exr_variants),
        cmocka_unit_test(pixels_are_mended),
        cmocka_unit_test(values_of_mended_pixels),
        cmocka_unit_test(hdr_variants),
        cmocka_unit_test(hdr_headers_that_are_refused),
        cmocka_unit_test(rgbe_rounds_to_nearest),
    };
    return run_test_group(tests, setup, NULL);
}
