// SPDX-License-Identifier: MIT
// One environment in every layout and convention of cubes gives the light of its lat-long
// image: six files, strips, crosses, DDS, KTX and KTX2, as camera views, by OpenGL's axes,
// Direct3D's and three.js's. The test writes all of them from one formula.
#include "prt/light.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <cmocka.h>
#include <zstd.h>

#include "../data.h"

enum { N = 32, CUBE = 8 };
static char folder[64], lines[2048];
static struct prt_cube truth;

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(lines);
    snprintf(lines + n, sizeof lines - n, "%s\n", line);
}

static struct prt_context context(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    lines[0] = 0;
    return ctx;
}

// Three lamps over a gradient, without any symmetry.
static void radiance(const float d[3], float rgb[3])
{
    static const float lamp[3][3] = {
        {0.8f, 0.36f, 0.48f}, {-0.6f, 0.48f, 0.64f}, {0, -0.6f, -0.8f}};
    double l = sqrt((double)d[0] * d[0] + (double)d[1] * d[1] + (double)d[2] * d[2]);
    for (int c = 0; c < 3; c++) {
        double dot = 0;
        for (int k = 0; k < 3; k++) dot += (double)d[k] / l * (double)lamp[c][k];
        rgb[c] = (float)(0.3 + 0.1 * d[1] / l + 4 * exp(6 * (dot - 1)));
    }
}

// Direction of pixel (x,y) of the picture named `face`.
static void direction(enum prt_faces faces, unsigned face, int x, int y, float d[3])
{
    static const float view[6][3][3] = {
        // forward, right, up
        {{1, 0, 0}, {0, 0, 1}, {0, 1, 0}},  {{-1, 0, 0}, {0, 0, -1}, {0, 1, 0}},
        {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},  {{0, -1, 0}, {1, 0, 0}, {0, 0, -1}},
        {{0, 0, 1}, {-1, 0, 0}, {0, 1, 0}}, {{0, 0, -1}, {1, 0, 0}, {0, 1, 0}}};
    float s = 2 * ((float)x + 0.5f) / N - 1, t = 2 * ((float)y + 0.5f) / N - 1;
    for (int k = 0; k < 3; k++)
        d[k] = view[face][0][k] + s * view[face][1][k] - t * view[face][2][k];
    if (faces == PRT_FACES_CAMERA) return;
    // OpenGL 4.5, table 8.19: the axes of the look-up
    const float gl[6][3] = {{1, -t, -s}, {-1, -t, s}, {s, 1, t},
                            {s, -1, -t}, {s, -t, 1},  {-s, -t, -1}};
    memcpy(d, gl[face], 3 * sizeof *d);
    if (faces == PRT_FACES_D3D) d[2] = -d[2];
    if (faces == PRT_FACES_THREE) d[0] = -d[0];
}

// The picture of a face into an image at (x0,y0), perhaps turned by half a circle.
static void draw(struct prt_image *im, enum prt_faces faces, unsigned face, int x0, int y0,
                 bool turned)
{
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++) {
            float d[3];
            direction(faces, face, turned ? N - 1 - x : x, turned ? N - 1 - y : y, d);
            radiance(d, im->rgb + (((size_t)(y0 + y)) * im->width + (size_t)(x0 + x)) * 3);
        }
}

static struct prt_image image(uint32_t width, uint32_t height)
{
    struct prt_image im = {width, height, calloc((size_t)width * height, 12)};
    assert_non_null(im.rgb);
    return im;
}

static const char *file(const char *name)
{
    static char path[160];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

static void write_exr(struct prt_image *im, const char *name)
{
    struct prt_context ctx = context();
    assert_int_equal(prt_write_exr(&ctx, file(name), im, true, false), PRT_OK);
    free(im->rgb);
}

// Reads a file by a convention and compares its light with the truth.
static double error_of(const char *name, enum prt_faces faces)
{
    struct prt_context ctx = context();
    struct prt_env *env;
    struct prt_cube cube;
    if (prt_env_load_faces(&ctx, file(name), faces, &env)) fail_msg("%s: %s", name, lines);
    assert_int_equal(prt_env_to_cube(&ctx, env, CUBE, 0, &cube), PRT_OK);
    double sum = 0, all = 0;
    for (int i = 0; i < 6 * CUBE * CUBE * 3; i++) {
        double e = (double)cube.texel[i] - (double)truth.texel[i];
        sum += e * e;
        all += (double)truth.texel[i] * (double)truth.texel[i];
    }
    prt_cube_finish(&cube);
    prt_env_destroy(env);
    return sqrt(sum / all);
}

static void agrees(const char *name, enum prt_faces faces)
{
    double error = error_of(name, faces);
    if (!(error < 0.005)) fail_msg("%s as %d: %.3f off", name, faces, error);
}

static int setup(void **state)
{
    struct prt_image im = image(4 * N, 2 * N);
    struct prt_context ctx = context();
    struct prt_env *env;
    if (!mkdtemp(strcpy(folder, "/tmp/prt-faces-XXXXXX"))) return 1;
    for (int y = 0; y < 2 * N; y++)
        for (int x = 0; x < 4 * N; x++) {
            double theta = M_PI / 2 - M_PI * (y + 0.5) / (2 * N);
            double phi = 2 * M_PI * ((x + 0.5) / (4 * N) - 0.5);
            const float d[3] = {(float)(sin(phi) * cos(theta)), (float)sin(theta),
                                (float)(-cos(phi) * cos(theta))};
            radiance(d, im.rgb + ((size_t)y * 4 * N + (size_t)x) * 3);
        }
    write_exr(&im, "latlong.exr");
    int status = prt_env_load(&ctx, file("latlong.exr"), &env);
    if (!status) status = prt_env_to_cube(&ctx, env, CUBE, 0, &truth);
    if (!status) prt_env_destroy(env);
    return status;
}

static int teardown(void **state)
{
    char command[96];
    prt_cube_finish(&truth);
    snprintf(command, sizeof command, "rm -r %s", folder);
    return system(command);
}

static const char *const word[] = {"guess", "camera", "gl", "d3d", "three"};

static void six_files(void **state)
{
    static const char *const names[4][6] = {
        {"px", "nx", "py", "ny", "pz", "nz"},
        {"posx", "negx", "posy", "negy", "posz", "negz"},
        {"sky_rt", "sky_lf", "sky_up", "sky_dn", "sky_bk", "sky_ft"},
        {"xp", "xn", "yp", "yn", "zp", "zn"}};
    for (int faces = PRT_FACES_CAMERA; faces <= PRT_FACES_THREE; faces++)
        for (int set = 0; set < 4; set++) {
            char name[64], full[96];
            snprintf(name, sizeof name, "%s-%d", word[faces], set);
            assert_int_equal(mkdir(file(name), 0700), 0);
            for (unsigned f = 0; f < 6; f++) {
                struct prt_image im = image(N, N);
                draw(&im, (enum prt_faces)faces, f, 0, 0, false);
                snprintf(full, sizeof full, "%s/%s.exr", name, names[set][f]);
                write_exr(&im, full);
            }
            agrees(name, (enum prt_faces)faces);
            double guessed = error_of(name, PRT_FACES_GUESS);
            // mirrored pictures and a half turn leave no trace in the edges
            if (faces == PRT_FACES_CAMERA || faces == PRT_FACES_THREE)
                assert_true(guessed < 0.005);
            else assert_true(guessed > 0.1);
            assert_non_null(strstr(lines, "--faces"));
            assert_non_null(strstr(lines, set == 2 ? "named by side" : "named by axis"));
            assert_true(!strstr(lines, "three.js") == (faces == PRT_FACES_CAMERA));
        }
}

static void write_file(const char *name, const uint8_t *bytes, size_t n)
{
    FILE *f = fopen(file(name), "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, n, f), n);
    fclose(f);
}

// A hidden file, such as a file manager's, is no face; two files of one face are told.
static void faces_are_six_files(void **state)
{
    struct prt_context ctx = context();
    struct prt_env *env;
    const uint8_t byte = 'x';
    assert_int_equal(mkdir(file("odd"), 0700), 0);
    for (unsigned f = 0; f < 6; f++) {
        static const char *const name[] = {"px", "nx", "py", "ny", "pz", "nz"};
        struct prt_image im = image(N, N);
        char full[96];
        draw(&im, PRT_FACES_CAMERA, f, 0, 0, false);
        snprintf(full, sizeof full, "odd/%s.exr", name[f]);
        write_exr(&im, full);
    }
    write_file("odd/._px.exr", &byte, 1);
    write_file("odd/.posx", &byte, 1);
    write_file("odd/thumbnail.jpg", &byte, 1);
    agrees("odd", PRT_FACES_CAMERA);
    write_file("odd/right.exr", &byte, 1);
    assert_int_equal(prt_env_load(&ctx, file("odd"), &env), PRT_FORMAT);
    assert_non_null(strstr(lines, "could be the posx face"));
}

// Cells of +X -X +Y -Y front and back; the middle of a cross is the front.
static void strips_and_crosses(void **state)
{
    static const struct {
        const char *name;
        int columns, rows, cell[6][2];
        bool cross;
    } layout[] = {{"hstrip", 6, 1, {{0, 0}, {1, 0}, {2, 0}, {3, 0}, {4, 0}, {5, 0}}, false},
                  {"vstrip", 1, 6, {{0, 0}, {0, 1}, {0, 2}, {0, 3}, {0, 4}, {0, 5}}, false},
                  {"hcross", 4, 3, {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 1}, {3, 1}}, true},
                  {"vcross", 3, 4, {{2, 1}, {0, 1}, {1, 0}, {1, 2}, {1, 1}, {1, 3}}, true}};
    for (int faces = PRT_FACES_CAMERA; faces <= PRT_FACES_THREE; faces++)
        for (int l = 0; l < 4; l++) {
            char name[64];
            struct prt_image im =
                image((uint32_t)(layout[l].columns * N), (uint32_t)(layout[l].rows * N));
            for (unsigned f = 0; f < 6; f++) {
                // the front of camera views is -Z, of the others +Z
                bool swap = layout[l].cross && f >= 4 && faces == PRT_FACES_CAMERA;
                const int *at = layout[l].cell[swap ? 9 - f : f];
                draw(&im, (enum prt_faces)faces, f, at[0] * N, at[1] * N,
                     layout[l].cross && at[1] == 3);
            }
            snprintf(name, sizeof name, "%s-%s.exr", word[faces], layout[l].name);
            write_exr(&im, name);
            agrees(name, (enum prt_faces)faces);
            if (faces == PRT_FACES_CAMERA || (faces == PRT_FACES_THREE && !layout[l].cross))
                agrees(name, PRT_FACES_GUESS);
        }
}

static void put(uint8_t *p, uint64_t v, int n)
{
    for (int i = 0; i < n; i++) p[i] = (uint8_t)(v >> 8 * i);
}

// Faces of a convention as floats RGBA, rows from the top.
static float *float_faces(enum prt_faces faces)
{
    float *all = calloc((size_t)6 * N * N, 16);
    struct prt_image im = image(N, N);
    assert_non_null(all);
    for (unsigned f = 0; f < 6; f++) {
        draw(&im, faces, f, 0, 0, false);
        for (size_t i = 0; i < (size_t)N * N; i++) {
            memcpy(all + ((size_t)f * N * N + i) * 4, im.rgb + i * 3, 12);
            all[((size_t)f * N * N + i) * 4 + 3] = 1;
        }
    }
    free(im.rgb);
    return all;
}

enum { FACES_BYTES = 6 * N * N * 16 };
static uint8_t bytes[FACES_BYTES + 256];

static size_t ktx1(const void *texels)
{
    static const uint32_t head[13] = {0x04030201, 0x1406, 4, 0x1908, 0x8814, 0x1908, N,
                                      N,          0,      0, 6,      1,      0};
    memset(bytes, 0, sizeof bytes);
    memcpy(bytes, "\xabKTX 11\xbb\r\n\x1a\n", 12);
    for (int i = 0; i < 13; i++) put(bytes + 12 + 4 * i, head[i], 4);
    put(bytes + 64, FACES_BYTES / 6, 4);
    memcpy(bytes + 68, texels, FACES_BYTES);
    return 68 + FACES_BYTES;
}

static size_t ktx2(const void *texels, bool packed)
{
    memset(bytes, 0, sizeof bytes);
    memcpy(bytes, "\xabKTX 20\xbb\r\n\x1a\n", 12);
    const uint32_t head[9] = {109, 4, N, N, 0, 0, 6, 1, packed ? 2 : 0};
    for (int i = 0; i < 9; i++) put(bytes + 12 + 4 * i, head[i], 4);
    size_t n = packed ? ZSTD_compress(bytes + 112, sizeof bytes - 112, texels, FACES_BYTES, 3)
                      : FACES_BYTES;
    if (!packed) memcpy(bytes + 112, texels, FACES_BYTES);
    put(bytes + 80, 112, 8);
    put(bytes + 88, n, 8);
    put(bytes + 96, FACES_BYTES, 8);
    return 112 + n;
}

static size_t dds(const void *texels)
{
    memset(bytes, 0, sizeof bytes);
    memcpy(bytes, "DDS ", 4);
    put(bytes + 4, 124, 4);
    put(bytes + 12, N, 4);
    put(bytes + 16, N, 4);
    put(bytes + 76, 32, 4);
    put(bytes + 80, 4, 4);
    put(bytes + 84, 116, 4); // A32B32G32R32F
    put(bytes + 112, 0xfe00, 4);
    memcpy(bytes + 128, texels, FACES_BYTES);
    return 128 + FACES_BYTES;
}

static void cubes_in_one_file(void **state)
{
    for (int faces = PRT_FACES_CAMERA; faces <= PRT_FACES_THREE; faces++) {
        float *texels = float_faces((enum prt_faces)faces);
        for (int kind = 0; kind < 4; kind++) {
            char name[64];
            static const char *const end[] = {"ktx", "ktx2", "z.ktx2", "dds"};
            size_t n = kind == 0   ? ktx1(texels)
                       : kind == 3 ? dds(texels)
                                   : ktx2(texels, kind == 2);
            snprintf(name, sizeof name, "%s.%s", word[faces], end[kind]);
            write_file(name, bytes, n);
            agrees(name, (enum prt_faces)faces);
            if (faces == PRT_FACES_GL) agrees(name, PRT_FACES_GUESS);
        }
        free(texels);
    }
}

enum { SIDE = 3 };

// A KTX or KTX2 of SIDE texels a side, all black but texel (2,1) of face 4. Rows of a KTX are
// multiples of four bytes long.
static size_t one_texel(bool second, uint32_t type, uint32_t format, const uint8_t *texel,
                        size_t n)
{
    const size_t row = second ? SIDE * n : (SIDE * n + 3) / 4 * 4, first = second ? 112 : 68;
    const uint32_t one[13] = {0x04030201, type, 1, format, 0, 0, SIDE, SIDE, 0, 0, 6, 1, 0};
    const uint32_t two[9] = {format, 1, SIDE, SIDE, 0, 0, 6, 1, 0};
    memset(bytes, 0, sizeof bytes);
    memcpy(bytes, second ? "\xabKTX 20\xbb\r\n\x1a\n" : "\xabKTX 11\xbb\r\n\x1a\n", 12);
    for (int i = 0; i < (second ? 9 : 13); i++)
        put(bytes + 12 + 4 * i, second ? two[i] : one[i], 4);
    put(bytes + 64, row * SIDE, 4);
    if (second) put(bytes + 80, 112, 8), put(bytes + 88, 6 * row * SIDE, 8);
    memcpy(bytes + first + (4 * SIDE + 1) * row + 2 * n, texel, n);
    return first + 6 * row * SIDE;
}

// The value of every format's bits, subnormal ones, too, at its place among padded rows.
static void texels_of_every_format(void **state)
{
    const float grey = 0.21586050f, least = 0x1p-24f; // of sRGB 128; of half floats
    const struct {
        uint32_t type, format, vulkan; // OpenGL's for KTX, Vulkan's for KTX2
        size_t n;
        uint8_t texel[8];
        float want[3];
    } row[] = {
        {0x140b, 0x1907, 90, 6, {0, 0x3c, 1, 0, 0xff, 3}, {1, least, 1023 * least}},
        {0x140b, 0x1908, 97, 8, {0xff, 0x7b, 0, 4, 0, 0x38, 0, 0x3c}, {65504, 0x1p-14f, 0.5f}},
        // 992: 1.5 of 11 bits; 1: 2^-20; 520: 2.5 of 10 bits
        {0x8c3b, 0x1907, 122, 4, {0xe0, 0x0b, 0, 0x82}, {1.5f, 0x1p-20f, 2.5f}},
        // 256, 128, 511 of 2^-8
        {0x8c3e, 0x1907, 123, 4, {0, 1, 0xfd, 0x87}, {1, 0.5f, 511.f / 256}},
        {0x1401, 0x1908, 43, 4, {255, 128, 0, 255}, {1, grey, 0}},
        {0x1401, 0x80e1, 50, 4, {0, 128, 255, 255}, {1, grey, 0}}};
    for (size_t i = 0; i < 2 * sizeof row / sizeof *row; i++) {
        const size_t k = i / 2, at = (4 * SIDE + 1) * SIDE + 2;
        struct prt_context ctx = context();
        struct prt_env *env;
        size_t n = one_texel(i % 2, row[k].type, i % 2 ? row[k].vulkan : row[k].format,
                             row[k].texel, row[k].n);
        if (prt_env_load_memory(&ctx, "one.ktx", bytes, n, &env)) fail_msg("%s", lines);
        assert_int_equal(env->cube.n, SIDE);
        for (size_t j = 0; j < 6 * SIDE * SIDE; j++)
            for (int c = 0; c < 3; c++) {
                const float want = j == at ? row[k].want[c] : 0;
                assert_float_equal(env->cube.texel[3 * j + (size_t)c], want, 1e-6f * want);
            }
        prt_env_destroy(env);
    }
}

struct dds_kind {
    uint32_t flags, fourcc, dxgi, bits; // dxgi: of the extended header, 0: there is none
    size_t n;
    uint8_t texel[16];
    float want[3];
};

// A DDS of SIDE texels a side, all black but texel (2,1) of face 4; levels of 3, 1, 1 texels.
static size_t one_dds(const struct dds_kind *k, uint32_t mips)
{
    const size_t first = k->dxgi ? 148 : 128, face = SIDE * SIDE * k->n;
    const size_t stride = face + (mips - 1) * k->n;
    const uint32_t head[7] = {124, mips > 1 ? 0x20000 : 0, SIDE, SIDE, 0, 0, mips};
    const uint32_t format[7] = {32, k->flags, k->fourcc, k->bits, 0xff0000, 0xff00, 0xff};
    memset(bytes, 0, sizeof bytes);
    memcpy(bytes, "DDS ", 4);
    for (int i = 0; i < 7; i++) put(bytes + 4 + 4 * i, head[i], 4);
    for (int i = 0; i < 7; i++) put(bytes + 76 + 4 * i, format[i], 4);
    put(bytes + 112, 0xfe00, 4);
    if (k->dxgi) put(bytes + 128, k->dxgi, 4), put(bytes + 136, 4, 4);
    for (size_t f = 0; f < 6; f++)
        memset(bytes + first + f * stride + face, 0x3b, stride - face);
    memcpy(bytes + first + 4 * stride + (SIDE + 2) * k->n, k->texel, k->n);
    return first + 6 * stride;
}

// The same of a DDS: halves, floats and bytes, with smaller levels behind each face.
static void texels_of_a_dds(void **state)
{
    const float grey = 0.21586050f, least = 0x1p-24f; // of sRGB 128; of half floats
    const uint32_t extended = 0x30315844;             // "DX10"
    const struct dds_kind row[] = {
        {4, 113, 0, 0, 8, {0, 0x3c, 1, 0, 0xff, 3, 0, 0x3c}, {1, least, 1023 * least}},
        {4, extended, 10, 0, 8, {0, 0x3e, 0, 4, 0, 0x7b, 0, 0}, {1.5f, 0x1p-14f, 57344}},
        {4, extended, 2, 0, 16, {0, 0, 0x80, 0x3e, 0, 0, 0x40, 0x40}, {0.25f, 3, 0}},
        {0x40, 0, 0, 32, 4, {0, 128, 255, 255}, {1, grey, 0}},
        {0x40, 0, 0, 24, 3, {255, 128, 0}, {0, grey, 1}}};
    for (size_t i = 0; i < 2 * sizeof row / sizeof *row; i++) {
        const struct dds_kind *k = &row[i / 2];
        const size_t at = (4 * SIDE + 1) * SIDE + 2;
        struct prt_context ctx = context();
        struct prt_env *env;
        const size_t n = one_dds(k, i % 2 ? 3 : 1);
        if (prt_env_load_memory(&ctx, "one.dds", bytes, n, &env)) fail_msg("%s", lines);
        assert_int_equal(env->cube.n, SIDE);
        for (size_t j = 0; j < 6 * SIDE * SIDE; j++)
            for (int c = 0; c < 3; c++) {
                const float want = j == at ? k->want[c] : 0;
                assert_float_equal(env->cube.texel[3 * j + (size_t)c], want, 1e-6f * want);
            }
        prt_env_destroy(env);
    }
}

static void pic_is_radiance(void **state)
{
    struct prt_image im = image(4 * N, 2 * N), back;
    struct prt_context ctx = context();
    struct prt_blob blob;
    assert_int_equal(prt_image_load(&ctx, file("latlong.exr"), &back), PRT_OK);
    assert_int_equal(prt_encode_hdr(&ctx, &back, &blob), PRT_OK);
    write_file("latlong.pic", blob.bytes, blob.size);
    agrees("latlong.pic", PRT_FACES_GUESS);
    prt_free(blob.bytes);
    prt_image_finish(&back);
    free(im.rgb);
}

static void refused(const char *name, size_t n, const char *said)
{
    struct prt_context ctx = context();
    struct prt_env *env;
    assert_int_equal(prt_env_load_memory(&ctx, name, bytes, n, &env), PRT_FORMAT);
    if (!strstr(lines, said)) fail_msg("%s: said %s", name, lines);
}

static void damaged_ktx(void **state)
{
    float *texels = float_faces(PRT_FACES_GL);
    size_t n = ktx1(texels);
    refused("short.ktx", n - 1, "middle of the faces");
    refused("head.ktx", 40, "inside the KTX header");
    put(bytes + 60, 0xffffffff, 4); // bytes of keys
    refused("keys.ktx", n, "middle of the faces");
    ktx1(texels);
    put(bytes + 52, 1, 4);
    refused("flat.ktx", n, "six faces");
    ktx1(texels);
    put(bytes + 36, 0xffffffff, 4);
    refused("huge.ktx", n, "squares of 1 to");
    ktx1(texels);
    put(bytes + 16, 0x1404, 4);
    refused("ints.ktx", n, "is not read");
    n = ktx2(texels, true);
    refused("short.ktx2", n - 1, "middle of the faces");
    bytes[150] ^= 0xff;
    refused("flipped.ktx2", n, "damaged");
    ktx2(texels, true);
    put(bytes + 96, 1ull << 60, 8);
    refused("level.ktx2", n, "another size");
    ktx2(texels, true);
    put(bytes + 80, 1ull << 63, 8);
    refused("offset.ktx2", n, "middle of the faces");
    free(texels);
}

static void files_by_a_beginning(void **state)
{
    struct prt_context ctx = context();
    struct prt_env *env;
    agrees("latl", PRT_FACES_GUESS);
    assert_int_equal(prt_env_load(&ctx, file("latlonk.exr"), &env), PRT_IO);
    assert_non_null(strstr(lines, "did you mean latlong.exr?"));
    write_file("latlong_2.hdr", (const uint8_t *)"x", 1);
    assert_int_equal(prt_env_load(&ctx, file("latlo"), &env), PRT_IO);
    assert_non_null(strstr(lines, "several names"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(six_files),
        cmocka_unit_test(faces_are_six_files),
        cmocka_unit_test(strips_and_crosses),
        cmocka_unit_test(cubes_in_one_file),
        cmocka_unit_test(texels_of_every_format),
        cmocka_unit_test(texels_of_a_dds),
        cmocka_unit_test(files_by_a_beginning),
        cmocka_unit_test(pic_is_radiance),
        cmocka_unit_test(damaged_ktx),
    };
    return run_test_group(tests, setup, teardown);
}
