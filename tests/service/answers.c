// SPDX-License-Identifier: MIT
// Details of answers: the mean of ENV, the alignment, exposure and errors of colours, ids, and
// the order of jobs.
#include "ask.h"
#include "frames.h"
#include "lone_daemon.h"
#include "prt/light.h"

static struct relight_client *begin_client(const char *const extra[])
{
    begin(extra);
    return client_open(d.address);
}

static void end_client(struct relight_client *client)
{
    relight_close(client);
    end();
}

// The mean of an environment is over solid angle: a lat-long whose upper quarter, up to 45
// degrees from the pole, has radiance 1 has the mean (1 - cos 45) / 2.
static void test_mean_of_an_environment(void **state)
{
    enum { W = 64, H = 32 };
    static const char head[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 32 +X 64\n";
    static char bytes[sizeof head - 1 + H * (4 + 4 * (W + 1))];
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    struct relight_env_info info;
    char hash[65], env[80], *at = bytes + sizeof head - 1;
    memcpy(bytes, head, sizeof head - 1);
    for (int y = 0; y < H; y++) {
        *at++ = 2, *at++ = 2, *at++ = 0, *at++ = W;
        for (int c = 0; c < 4; c++) {
            *at++ = (char)W; // a literal run
            memset(at, c == 3 ? 128 + 1 : y < H / 4 ? 128 : 0, W);
            at += W;
        }
    }
    OK(relight_upload(client, "cap.hdr", bytes, (size_t)(at - bytes), NULL, NULL, hash, NULL,
                      &error));
    snprintf(env, sizeof env, "env:%s", hash);
    OK(relight_env_prepare(client, env, &info, &error));
    print_message("mean %g, the cap has %g\n", (double)info.mean[0], (1 - sqrt(0.5)) / 2);
    for (int c = 0; c < 3; c++)
        if (fabs((double)info.mean[c] - (1 - sqrt(0.5)) / 2) > 0.002) fail_msg("mean is off");
    OK(relight_env_prepare(client, env, &info, &error));
    assert_true(info.decode_ms == 0); // it is decoded already
    end_client(client);
}

static char *put_bytes(char *at, const void *bytes, size_t n)
{
    memcpy(at, bytes, n);
    return at + n;
}

// An attribute of an OpenEXR header.
static char *put_attribute(char *at, const char *name, const char *type, const void *value,
                           int32_t n)
{
    at = put_bytes(at, name, strlen(name) + 1);
    at = put_bytes(at, type, strlen(type) + 1);
    at = put_bytes(at, &n, 4);
    return put_bytes(at, value, (size_t)n);
}

// An OpenEXR image of W x H pixels of 1, without compression; its size. *pixels: the first of
// the planes B, G, R of the first row, each row with 8 bytes before them.
enum { EXR_W = 8, EXR_H = 4, EXR_ROW = 8 + 3 * 4 * EXR_W };
static size_t plain_exr(char out[1000], char **pixels)
{
    static const char magic[] = {0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0};
    static const char channels[] = "B\0\2\0\0\0\0\0\0\0\1\0\0\0\1\0\0\0"
                                   "G\0\2\0\0\0\0\0\0\0\1\0\0\0\1\0\0\0"
                                   "R\0\2\0\0\0\0\0\0\0\1\0\0\0\1\0\0\0";
    const int32_t window[4] = {0, 0, EXR_W - 1, EXR_H - 1};
    const float one = 1, centre[2] = {0, 0};
    char *at = put_bytes(out, magic, sizeof magic);
    at = put_attribute(at, "channels", "chlist", channels, sizeof channels);
    at = put_attribute(at, "compression", "compression", "", 1);
    at = put_attribute(at, "dataWindow", "box2i", window, 16);
    at = put_attribute(at, "displayWindow", "box2i", window, 16);
    at = put_attribute(at, "lineOrder", "lineOrder", "", 1);
    at = put_attribute(at, "pixelAspectRatio", "float", &one, 4);
    at = put_attribute(at, "screenWindowCenter", "v2f", centre, 8);
    at = put_attribute(at, "screenWindowWidth", "float", &one, 4);
    *at++ = 0;
    char *const rows = at + (size_t)EXR_H * 8;
    for (int y = 0; y < EXR_H; y++) {
        const uint64_t offset = (uint64_t)(rows - out) + (uint64_t)y * EXR_ROW;
        at = put_bytes(at, &offset, 8);
    }
    for (int32_t y = 0, n = EXR_ROW - 8; y < EXR_H; y++) {
        at = put_bytes(at, &y, 4);
        at = put_bytes(at, &n, 4);
        for (int i = 0; i < 3 * EXR_W; i++) at = put_bytes(at, &one, 4);
    }
    *pixels = rows + 8;
    return (size_t)(at - out);
}

// ENV counts the values that it mends: those below 0 and those that are no number.
static void test_mended_values_are_counted(void **state)
{
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    struct relight_env_info info;
    static const float broken[] = {-1, NAN, INFINITY};
    char bytes[1000], hash[65], env[80], *pixels;
    const size_t n = plain_exr(bytes, &pixels);
    for (int i = 0; i < 4; i++) { // none, then one more each time
        if (i) memcpy(pixels + 8 * i, &broken[i - 1], 4);
        OK(relight_upload(client, "sky.exr", bytes, n, NULL, NULL, hash, NULL, &error));
        snprintf(env, sizeof env, "env:%s", hash);
        OK(relight_env_prepare(client, env, &info, &error));
        assert_int_equal(info.width, EXR_W);
        assert_int_equal(info.n_mended, i);
    }
    end_client(client);
}

// A GEOMETRY request may omit normals, triangles or both; its answer names the sections it has.
static void test_parts_of_a_geometry(void **state)
{
    enum { VECTORS = 12 * OCTAHEDRON_VERTICES, AFTER = 128, TRIANGLES = 8 * 12 };
    struct relight_client *client = begin_client(NULL);
    struct frames *f = frames_open(&d);
    char id[ID_SIZE];
    bake_small(client, &d, id);
    for (unsigned i = 0; i < 4; i++) {
        Relight__GeometryRequest m = RELIGHT__GEOMETRY_REQUEST__INIT;
        struct frames_answer a;
        ProtobufCMessage *message = NULL;
        m.model = id;
        m.no_normals = i & 1;
        m.no_triangles = i & 2;
        frames_add(f, RELIGHT_TYPE_GEOMETRY, 10 + i, &m.base, NULL, 0);
        frames_send(f);
        assert_true(frames_next(f, &a, 20000, &message));
        assert_int_equal(a.type, RELIGHT_TYPE_GEOMETRY | RELIGHT_TYPE_ANSWER);
        const Relight__GeometryAnswer *g = (const Relight__GeometryAnswer *)message;
        const uint64_t triangles_at = i & 2 ? 0 : i & 1 ? AFTER : 2 * AFTER;
        const uint64_t size = i & 2   ? i & 1 ? VECTORS : AFTER + VECTORS
                              : i & 1 ? AFTER + TRIANGLES
                                      : 2 * AFTER + TRIANGLES;
        assert_int_equal(g->n_vertex, OCTAHEDRON_VERTICES);
        assert_int_equal(g->n_triangle, i & 2 ? 0 : 8);
        assert_int_equal(g->normals_offset, i & 1 ? 0 : AFTER);
        assert_int_equal(g->triangles_offset, triangles_at);
        assert_int_equal(a.payload, size);
        protobuf_c_message_free_unpacked(message, NULL);
    }
    frames_close(f);
    end_client(client);
}

// Planes of several lights begin at multiples of 64 bytes (PROTOCOL.md).
static void test_planes_are_aligned(void **state)
{
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    struct relight_colors colors;
    struct relight_light lights[2] = {{.env = "constant"}, {.env = "constant:1,0,0"}};
    struct relight_colors_request request = {.n_light = 2, .lights = lights};
    char id[ID_SIZE];
    bake_small(client, &d, id);
    request.model = id;
    OK(relight_colors(client, &request, &colors, &error));
    assert_int_equal(colors.plane_bytes, (12 * OCTAHEDRON_VERTICES + 63) / 64 * 64);
    relight_colors_finish(&colors);
    end_client(client);
}

static float srgb(float x)
{
    x = x < 0 ? 0 : x > 1 ? 1 : x;
    return 255 * (x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f);
}

// 8-bit colours are the linear ones times 2^exposure, by the sRGB curve, to half a step.
static void test_exposure_of_colours(void **state)
{
    static const float ev[] = {0, 1.5f, -3, 8};
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    struct relight_light light = {.env = "constant:1,0.3,0.05"};
    struct relight_colors_request request = {.n_light = 1, .lights = &light};
    struct relight_colors linear, bytes;
    char id[ID_SIZE];
    bake_small(client, &d, id);
    request.model = id;
    OK(relight_colors(client, &request, &linear, &error));
    request.format = RELIGHT_COLOR_SRGB8;
    for (int i = 0; i < 4; i++) {
        request.exposure_ev = ev[i];
        OK(relight_colors(client, &request, &bytes, &error));
        for (int v = 0; v < OCTAHEDRON_VERTICES; v++) {
            const uint8_t *got = (const uint8_t *)bytes.data + 4 * v;
            for (int c = 0; c < 3; c++) {
                float want = srgb(((const float *)linear.data)[3 * v + c] * exp2f(ev[i]));
                if (fabsf((float)got[c] - want) > 0.51f)
                    fail_msg("%g EV: %d, expected %g", (double)ev[i], got[c], (double)want);
            }
            assert_int_equal(got[3], 255);
        }
        relight_colors_finish(&bytes);
    }
    relight_colors_finish(&linear);
    end_client(client);
}

static void colors_as(struct relight_client *client, const char *model, const char *env,
                      enum relight_color_format format, struct relight_colors *out)
{
    struct relight_error error;
    struct relight_light light = {.env = env};
    struct relight_colors_request request = {.model = model,
                                             .n_light = 1,
                                             .lights = &light,
                                             .format = format,
                                             .exposure_ev =
                                                 format == RELIGHT_COLOR_SRGB8 ? 0.5f : 0};
    OK(relight_colors(client, &request, out, &error));
}

// Colours that the pass encodes and those encoded from floats in the cache have the same bytes:
// the first environment was never asked for as floats, the second, of the same light, was.
static void test_formats_of_cached_colours(void **state)
{
    static const enum relight_color_format formats[] = {RELIGHT_COLOR_F16, RELIGHT_COLOR_RGB9E5,
                                                        RELIGHT_COLOR_SRGB8};
    static const char fresh[] = "constant:1,0.3,0.05", known[] = "constant:1.0,0.30,0.050";
    struct relight_client *client = begin_client(NULL);
    struct relight_colors floats, one, other;
    char id[ID_SIZE];
    bake_small(client, &d, id);
    colors_as(client, id, known, RELIGHT_COLOR_F32, &floats);
    for (int i = 0; i < 3; i++) {
        colors_as(client, id, fresh, formats[i], &one);
        colors_as(client, id, known, formats[i], &other);
        assert_int_equal(one.format, formats[i]);
        assert_int_equal(one.plane_bytes, other.plane_bytes);
        assert_memory_equal(one.data, other.data, one.plane_bytes);
        relight_colors_finish(&one);
        relight_colors_finish(&other);
    }
    relight_colors_finish(&floats);
    end_client(client);
}

// A bake whose measured error is above max_error is refused with both numbers; the bound that
// its answers state is allowed.
static void test_measured_error_of_a_bake(void **state)
{
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {.n_light = 1, .lights = &light};
    struct relight_colors colors;
    char id[ID_SIZE];
    bake_small(client, &d, id);
    request.model = id;
    OK(relight_colors(client, &request, &colors, &error));
    float bound = colors.cost.error_bound;
    relight_colors_finish(&colors);
    assert_true(bound > 0);
    request.shade.max_error = 0.9f * bound;
    expect(relight_colors(client, &request, &colors, &error), RELIGHT_E_OUT_OF_RANGE, &error,
           "max_error");
    request.shade.max_error = 1.01f * bound;
    OK(relight_colors(client, &request, &colors, &error));
    relight_colors_finish(&colors);
    end_client(client);
}

// Two open requests of a connection cannot have one id.
static void test_an_id_is_open_once(void **state)
{
    struct relight_client *client = begin_client(NULL);
    struct frames *f = frames_open(&d);
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    struct frames_answer a;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, 10, &in.base, NULL, 0); // open until it is cancelled
    frames_add(f, RELIGHT_TYPE_PING, 10, NULL, NULL, 0);
    frames_send(f);
    do assert_true(frames_next(f, &a, 20000, NULL));
    while (!a.closed && a.type != RELIGHT_TYPE_ERROR &&
           a.type != (RELIGHT_TYPE_PING | RELIGHT_TYPE_ANSWER));
    assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    assert_non_null(strstr(a.text, "open already"));
    frames_close(f);
    end_client(client);
}

// Bakes run in the order of their requests: when the third has ended, the second has.
static void test_bakes_keep_their_order(void **state)
{
    static const char *const extra[] = {"--bakes", "1", NULL};
    struct relight_client *client = begin_client(extra);
    struct relight_error error;
    struct relight_loaded loaded[3];
    for (int i = 0; i < 3; i++) {
        char name[20];
        snprintf(name, sizeof name, "o%d.obj", i);
        OK(load_small(client, &d, name, 70 + (uint64_t)i, 60, &loaded[i], &error));
    }
    OK(relight_watch(client, loaded[2].job, NULL, NULL, &error));
    struct relight_colors colors;
    struct relight_light light = {.env = "constant"};
    struct relight_colors_request request = {
        .model = loaded[1].model, .n_light = 1, .lights = &light};
    OK(relight_colors(client, &request, &colors, &error)); // ready: colours come from a bake
    relight_colors_finish(&colors);
    for (int i = 0; i < 3; i++) relight_loaded_finish(&loaded[i]);
    end_client(client);
}

// In floating point to one step of their mantissas: kernels may add a light's products in
// another order beside other lights. In integers (kernels.h) there is no such difference.
static void assert_same_colors(const uint32_t *a, const uint32_t *b, int n)
{
#ifdef __x86_64__
    const bool integers =
        __builtin_cpu_supports("avx512vnni") ||
        (__builtin_cpu_supports("avx2") && !__builtin_cpu_supports("avx512f"));
    if (integers) assert_memory_equal(a, b, 4 * (size_t)n);
#endif
    for (int i = 0; i < n; i++) {
        const uint32_t exponent = a[i] >> 27 > b[i] >> 27 ? a[i] >> 27 : b[i] >> 27;
        for (int c = 0; c < 3; c++) {
            const double x = ldexp(a[i] >> 9 * c & 511, (int)(a[i] >> 27));
            const double y = ldexp(b[i] >> 9 * c & 511, (int)(b[i] >> 27));
            assert_true(fabs(x - y) <= ldexp(1, (int)exponent));
        }
    }
}

// The floats behind encoded colours are within --cache: where it is small, a pass has few
// lights (an eighth of 4,000 bytes is room for six octahedra of six vertices). Both daemons
// answer the same colours. Each answer says how many lights its pass had.
static void test_passes_within_the_cache(void **state)
{
    enum { N = 40, MOST = 500 / (3 * 4 * OCTAHEDRON_VERTICES) };
    static const char *const cache[] = {"--cache", "4000", NULL}, *const large[] = {NULL};
    uint32_t answer[2][N][OCTAHEDRON_VERTICES];
    for (int small = 0; small < 2; small++) {
        struct relight_client *client = begin_client(small ? cache : large);
        struct relight_error error;
        char model[ID_SIZE];
        uint64_t id[N];
        bake_small(client, &d, model);
        for (int i = 0; i < N; i++) {
            char env[40];
            snprintf(env, sizeof env, "constant:%d,1,2", i + 100);
            struct relight_light light = {.env = env};
            struct relight_colors_request c = {
                .model = model, .n_light = 1, .lights = &light, .format = RELIGHT_COLOR_RGB9E5};
            OK(relight_colors_begin(client, &c, 0, &id[i], &error));
        }
        int n_shared = 0;
        for (int i = 0; i < N; i++) {
            struct relight_colors colors;
            OK(relight_colors_end(client, id[i], &colors, &error));
            assert_int_equal(colors.cost.shared > MOST && small, 0);
            assert_true(colors.cost.shared > 0);
            n_shared += colors.cost.shared > 1;
            memcpy(answer[small][i], colors.data, sizeof answer[small][i]);
            relight_colors_finish(&colors);
        }
        print_message("%d of %d lights shared a pass\n", n_shared, N);
        assert_true(n_shared <= metric(client, "relightd_relights_shared_total"));
        end_client(client);
    }
    assert_same_colors(answer[0][0], answer[1][0], N * OCTAHEDRON_VERTICES);
}

// What an environment keeps of its turns for a bake with a cube of side 64 counts towards
// --cache once, as that for smaller cubes does from the start.
static void test_turns_are_charged(void **state)
{
    static const char hdr[] = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\nAAAABBBB";
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    char model[ID_SIZE], hash[65], env[80];
    struct relight_load load = small_bake(0, 100);
    load.bake.cube = 64;
    bake_octahedron(client, &d, "large.obj", &load, model);
    OK(relight_upload(client, "sky.hdr", hdr, sizeof hdr - 1, NULL, NULL, hash, NULL, &error));
    snprintf(env, sizeof env, "env:%s", hash);
    double before = 0, after[3];
    for (int i = 0; i < 3; i++) {
        struct relight_light light = {.env = env, .rotate_deg = (float)(11 * i)};
        struct relight_colors_request r = {.model = model, .n_light = 1, .lights = &light};
        struct relight_colors colors;
        before = i ? before : metric(client, "relightd_cache_bytes");
        OK(relight_colors(client, &r, &colors, &error));
        relight_colors_finish(&colors);
        after[i] = metric(client, "relightd_cache_bytes");
    }
    print_message("cache: %g, then %g, turned %g and %g bytes\n", before, after[0], after[1],
                  after[2]);
    assert_true(after[0] - before < 8e6);
    assert_true(after[1] - after[0] >= (double)PRT_ENV_TURNED_BYTES(64));
    assert_true(after[2] - after[1] < 2e6);
    end_client(client);
}

static double relative_difference(const float *a, const float *b, size_t n)
{
    double off = 0, power = 0;
    for (size_t i = 0; i < n; i++) {
        off += ((double)a[i] - b[i]) * ((double)a[i] - b[i]);
        power += (double)b[i] * b[i];
    }
    return sqrt(off / power);
}

// Texels that are turned again are kept as an environment with what its turns need, once for
// all turns; by a turn that is nearly a quarter they light as by a quarter, which resamples
// nothing.
static void test_turned_texels_are_kept(void **state)
{
    enum { N = 16, TURNS = 6 };
    static const float degrees[TURNS] = {0, 90, 90.01f, 90.02f, 90.03f, 90.01f};
    static float texel[6 * N * N * 3];
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    char model[ID_SIZE];
    struct relight_load load = small_bake(0, 100);
    bake_octahedron(client, &d, "texels.obj", &load, model);
    for (size_t i = 0; i < 6 * N * N; i++)
        for (size_t c = 0; c < 3; c++)
            texel[3 * i + c] = i / (N * N) == 4 ? 3 : 0.2f; // a bright face
    double kept[TURNS];
    float values[TURNS][3 * OCTAHEDRON_VERTICES];
    for (int i = 0; i < TURNS; i++) {
        struct relight_light light = {.cube = texel, .cube_n = N, .rotate_deg = degrees[i]};
        if (i == TURNS - 1) light.gain[0] = light.gain[1] = light.gain[2] = 2; // made anew
        struct relight_colors_request r = {
            .model = model, .n_light = 1, .lights = &light, .format = RELIGHT_COLOR_F32};
        struct relight_colors colors;
        OK(relight_colors(client, &r, &colors, &error));
        memcpy(values[i], colors.data, sizeof values[i]);
        relight_colors_finish(&colors);
        kept[i] = metric(client, "relightd_cache_bytes");
    }
    const double off = relative_difference(values[3], values[1], 3 * OCTAHEDRON_VERTICES);
    print_message("cache: %g bytes, turned %g, %g, %g and %g; 90.02 degrees from 90: %.4f\n",
                  kept[0], kept[1], kept[2], kept[3], kept[4], off);
    const double small = (double)PRT_ENV_TURNED_BYTES(16);
    assert_true(kept[2] - kept[0] < small); // nothing but cubes
    assert_true(kept[3] - kept[2] >=
                (double)(PRT_ENV_TURNED_BYTES(32) + PRT_ENV_TURNED_BYTES(16) + 384 * N * N));
    assert_true(kept[4] - kept[3] < small);
    // The first answer at this angle was made before the texels were kept, the last one after.
    for (int i = 0; i < 3 * OCTAHEDRON_VERTICES; i++) values[5][i] /= 2;
    assert_true(relative_difference(values[5], values[2], 3 * OCTAHEDRON_VERTICES) < 1e-5);
    assert_true(relative_difference(values[1], values[0], 3 * OCTAHEDRON_VERTICES) >
                0.1); // it did turn
    assert_true(off < 0.01);
    end_client(client);
}

// The workers' memory for colours that are encoded counts while a pass runs, and not longer.
static void test_scratch_is_given_back(void **state)
{
    enum { N = 8, ROUNDS = 3 };
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    char model[ID_SIZE], env[40];
    double left[ROUNDS];
    bake_small(client, &d, model);
    for (int round = 0; round < ROUNDS; round++) {
        for (int i = 0; i < N; i++) {
            snprintf(env, sizeof env, "constant:1,%d,2", 1 + i);
            struct relight_light light = {.env = env};
            struct relight_colors_request r = {
                .model = model, .n_light = 1, .lights = &light, .format = RELIGHT_COLOR_RGB9E5};
            struct relight_colors colors;
            OK(relight_colors(client, &r, &colors, &error));
            relight_colors_finish(&colors);
        }
        OK(relight_unload(client, model, false, NULL, &error)); // and its colours
        left[round] = metric(client, "relightd_cache_bytes");
    }
    print_message("cache: %g, %g and %g bytes\n", left[0], left[1], left[2]);
    assert_true(left[2] == left[1]);
    end_client(client);
}

// An environment that is filtered for reflection counts towards --cache.
static void test_reflections_are_charged(void **state)
{
    enum { FILTERED = 300000 }; // less than prt_specular_bytes()
    struct relight_client *client = begin_client(NULL);
    struct relight_error error;
    char model[ID_SIZE];
    struct relight_light light = {.env = "constant"};
    struct relight_load load = small_bake(0, 100);
    bake_octahedron(client, &d, "small.obj", &load, model);
    double used[2];
    for (int i = 0; i < 2; i++) {
        struct relight_image_request r = {
            .model = model,
            .n_light = 1,
            .lights = &light,
            .picture = {
                .width = 16, .height = 16, .format = RELIGHT_IMAGE_RGB8, .no_specular = !i}};
        struct relight_image image;
        OK(relight_image(client, &r, &image, &error));
        relight_image_finish(&image);
        used[i] = metric(client, "relightd_cache_bytes");
    }
    print_message("cache: %g, with reflections %g bytes\n", used[0], used[1]);
    assert_true(used[1] - used[0] >= FILTERED);
    end_client(client);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_mean_of_an_environment, teardown),
        cmocka_unit_test_teardown(test_mended_values_are_counted, teardown),
        cmocka_unit_test_teardown(test_parts_of_a_geometry, teardown),
        cmocka_unit_test_teardown(test_planes_are_aligned, teardown),
        cmocka_unit_test_teardown(test_exposure_of_colours, teardown),
        cmocka_unit_test_teardown(test_formats_of_cached_colours, teardown),
        cmocka_unit_test_teardown(test_measured_error_of_a_bake, teardown),
        cmocka_unit_test_teardown(test_an_id_is_open_once, teardown),
        cmocka_unit_test_teardown(test_bakes_keep_their_order, teardown),
        cmocka_unit_test_teardown(test_passes_within_the_cache, teardown),
        cmocka_unit_test_teardown(test_turns_are_charged, teardown),
        cmocka_unit_test_teardown(test_turned_texels_are_kept, teardown),
        cmocka_unit_test_teardown(test_scratch_is_given_back, teardown),
        cmocka_unit_test_teardown(test_reflections_are_charged, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
