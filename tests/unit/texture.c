// SPDX-License-Identifier: MIT
// texture/ and the textures of a glTF: decoding and its limits, mip chains, wrap modes,
// filters, transforms, TEXCOORD sets, vertex colours, and files that name what is not there.
#include "mesh/obj_material.h"
#include "prt/light.h"
#include "prt/mesh.h"
#include "prt/raster.h"
#include "prt/surface.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "../data.h"

static char lines[4096];
static void remember(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(lines);
    snprintf(lines + n, sizeof lines - n, "%s\n", line);
}

static struct prt_context context(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = remember;
    lines[0] = 0;
    return ctx;
}

static struct prt_texture_ref plain_ref(void)
{
    struct prt_surface_maps maps;
    prt_surface_maps_default(&maps);
    maps.map[0].image = 0;
    return maps.map[0];
}

// An image whose texel (x, y) has red 10 x and green 10 y.
static uint8_t *ramp(uint32_t w, uint32_t h, enum prt_texture_kind kind,
                     struct prt_texture_image *out)
{
    uint8_t *t = prt_calloc(prt_texture_bytes(w, h), 1);
    assert_non_null(t);
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++) {
            uint8_t *p = t + 4 * (y * w + x);
            p[0] = (uint8_t)(10 * x), p[1] = (uint8_t)(10 * y), p[3] = 255;
        }
    prt_texture_finish_levels(w, h, kind, t, out);
    assert_true(prt_texture_image_valid(out, out->bytes));
    return t;
}

static void wrap_modes(void **state)
{
    struct prt_texture_image image;
    uint8_t *t = ramp(8, 4, PRT_TEXTURE_DATA, &image);
    struct prt_texture_ref ref = plain_ref();
    const float no[2] = {0, 0};
    static const struct {
        uint8_t mode;
        float u, texel;
    } at[] = {
        {PRT_WRAP_REPEAT, 1 + 2.5f / 8, 2},
        {PRT_WRAP_REPEAT, -0.5f / 8, 7},
        {PRT_WRAP_CLAMP, 3, 7},
        {PRT_WRAP_CLAMP, -2, 0},
        {PRT_WRAP_MIRROR, 1 + 0.5f / 8, 7},
        {PRT_WRAP_MIRROR, -2.5f / 8, 2},
        {PRT_WRAP_MIRROR, 2 + 3.5f / 8, 3},
    };
    for (size_t i = 0; i < sizeof at / sizeof *at; i++) {
        float uv[2] = {at[i].u, 0.625f}, rgba[4];
        ref.wrap_u = at[i].mode;
        prt_texture_sample(&image, t, &ref, uv, no, no, rgba);
        assert_float_equal(rgba[0] * 255, 10 * at[i].texel, 1e-3);
        assert_float_equal(rgba[1] * 255, 20, 1e-3);
    }
    ref.wrap_u = PRT_WRAP_REPEAT; // halfway between two texels, and the nearest of them
    float uv[2] = {3.75f / 8, 0.125f}, rgba[4];
    prt_texture_sample(&image, t, &ref, uv, no, no, rgba);
    assert_float_equal(rgba[0] * 255, 32.5f, 1e-3);
    ref.filter = PRT_FILTER_MAG_NEAREST;
    prt_texture_sample(&image, t, &ref, uv, no, no, rgba);
    assert_float_equal(rgba[0] * 255, 30, 1e-3);
    prt_free(t);
}

// Levels average linear light: a chess board of black and white sRGB is 0.5, not 0.214, at any
// size; odd sides weigh their middle by area.
static void levels_average_light(void **state)
{
    for (uint32_t w = 4; w <= 9; w++) {
        struct prt_texture_image image;
        uint8_t *t = prt_calloc(prt_texture_bytes(w, w), 1);
        double mean = 0;
        for (uint32_t i = 0; i < w * w; i++) {
            uint8_t v = (i % w + i / w) & 1 ? 255 : 0;
            memset(t + 4 * i, v, 3);
            mean += v / 255.0 / (w * w);
        }
        prt_texture_finish_levels(w, w, PRT_TEXTURE_COLOR, t, &image);
        struct prt_texture_ref ref = plain_ref();
        const float uv[2] = {0.3f, 0.7f}, dx[2] = {1, 0}, dy[2] = {0, 1};
        float rgba[4];
        prt_texture_sample(&image, t, &ref, uv, dx, dy, rgba);
        assert_float_equal(rgba[0], mean, 0.02);
        prt_free(t);
    }
}

// A texel of the next level is the mean over its share of the side, three texels of an odd one.
static void odd_sides_weigh_by_area(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 8, 1);
    for (uint32_t n = 2; n <= 15; n++)
        for (int along = 0; along < 2; along++) {
            const uint32_t w = along ? 1 : n, h = along ? n : 1, m = n / 2;
            struct prt_texture_image image;
            uint8_t *t = prt_calloc(prt_texture_bytes(w, h), 1);
            for (uint32_t i = 0; i < 4 * n; i++) t[i] = (uint8_t)(prt_rng_u32(&rng) >> 24);
            prt_texture_finish_levels(w, h, PRT_TEXTURE_DATA, t, &image);
            for (uint32_t i = 0; i < 4 * m; i++) {
                const double wide = (double)n / m, begin = i / 4 * wide;
                double mean = 0;
                for (uint32_t k = 0; k < n; k++) {
                    const double share = fmin(k + 1, begin + wide) - fmax(k, begin);
                    mean += fmax(share, 0) / wide * t[4 * k + i % 4];
                }
                assert_float_equal(t[4 * n + i], mean, 0.501);
            }
            prt_free(t);
        }
}

// A map with a transform is the map without it at transformed coordinates and footprints.
static void transforms_turn_footprints(void **state)
{
    enum { SIDE = 64 };
    struct prt_texture_image image;
    struct prt_rng rng;
    uint8_t *t = prt_calloc(prt_texture_bytes(SIDE, SIDE), 1);
    prt_rng_init(&rng, 9, 1);
    for (int i = 0; i < 4 * SIDE * SIDE; i++) t[i] = (uint8_t)(prt_rng_u32(&rng) >> 24);
    prt_texture_finish_levels(SIDE, SIDE, PRT_TEXTURE_DATA, t, &image);
    for (int round = 0; round < 200; round++) {
        struct prt_texture_ref turned = plain_ref(), plain = plain_ref();
        float *m = turned.transform, x[3][2], y[3][2], a[4], b[4];
        for (int k = 0; k < 6; k++) m[k] = 2 * prt_rng_f32(&rng) - 1;
        for (int k = 0; k < 3; k++) {
            const float size = k ? (float)(k == 1 ? 16 : 2) / SIDE : 1; // a point, two steps
            for (int c = 0; c < 2; c++) x[k][c] = size * (2 * prt_rng_f32(&rng) - 1);
            for (int c = 0; c < 2; c++)
                y[k][c] = m[3 * c] * x[k][0] + m[3 * c + 1] * x[k][1] + (k ? 0 : m[3 * c + 2]);
        }
        prt_texture_sample(&image, t, &turned, x[0], x[1], x[2], a);
        prt_texture_sample(&image, t, &plain, y[0], y[1], y[2], b);
        for (int c = 0; c < 4; c++) assert_float_equal(a[c], b[c], 1e-4);
    }
    prt_free(t);
}

// Every level has one value, 20 times its number: a footprint of x texels has level log2(x),
// between two levels their mix, the nearest of them or, without levels, the first; never one
// past the last.
static void levels_by_footprint(void **state)
{
    enum { SIDE = 64, TOP = 6 };
    static const unsigned filter[] = {0, PRT_FILTER_LEVEL_NEAREST,
                                      PRT_FILTER_LEVEL_NEAREST | PRT_FILTER_MIN_NEAREST,
                                      PRT_FILTER_MIN_NEAREST, PRT_FILTER_NO_LEVELS};
    struct prt_texture_image image;
    uint8_t *t = ramp(SIDE, SIDE, PRT_TEXTURE_DATA, &image), *at = t;
    for (uint32_t k = 0; k <= TOP; k++) {
        const size_t n = 4 * (size_t)(SIDE >> k) * (SIDE >> k);
        memset(at, 20 * (int)k, n);
        at += n;
    }
    assert_int_equal(image.n_level, TOP + 1);
    for (size_t f = 0; f < sizeof filter / sizeof *filter; f++)
        for (int i = -8; i <= 8 * (TOP + 2); i++) {
            const float level = (float)i / 8 + 1e-3f, wide = exp2f(level) / SIDE;
            const float uv[2] = {0.3f, 0.6f}, dx[2] = {wide, 0}, dy[2] = {0, wide};
            const float held = fminf(fmaxf(level, 0), TOP);
            const float want = filter[f] & PRT_FILTER_NO_LEVELS       ? 0
                               : filter[f] & PRT_FILTER_LEVEL_NEAREST ? roundf(held)
                                                                      : held;
            struct prt_texture_ref ref = plain_ref();
            float rgba[4];
            ref.filter = (uint8_t)filter[f];
            prt_texture_sample(&image, t, &ref, uv, dx, dy, rgba);
            assert_float_equal(rgba[0] * 255, 20 * want, 1e-3);
        }
    prt_free(t);
}

// Stripes along v, seen at a slant: a footprint of 16 texels along v and 1 along u keeps them;
// without anisotropic probes the blur is 16 texels both ways.
static void anisotropic(void **state)
{
    enum { N = 64 };
    struct prt_texture_image image;
    uint8_t *t = prt_calloc(prt_texture_bytes(N, N), 1);
    for (uint32_t i = 0; i < N * N; i++) memset(t + 4 * i, i % N / 2 & 1 ? 255 : 0, 4);
    prt_texture_finish_levels(N, N, PRT_TEXTURE_DATA, t, &image);
    struct prt_texture_ref ref = plain_ref();
    const float dx[2] = {1.0f / N, 0}, dy[2] = {0, 16.0f / N};
    float white[2] = {3.0f / N, 0.5f}, black[2] = {5.0f / N, 0.5f}, a[4], b[4];
    prt_texture_sample(&image, t, &ref, white, dx, dy, a);
    prt_texture_sample(&image, t, &ref, black, dx, dy, b);
    assert_true(a[0] > 0.95f && b[0] < 0.05f);
    prt_free(t);
}

// Probes lie evenly about their point: over a ramp their mean is the value there.
static void probes_lie_about_the_point(void **state)
{
    enum { N = 16 };
    struct prt_texture_image image;
    uint8_t *t = ramp(N, N, PRT_TEXTURE_DATA, &image);
    struct prt_texture_ref ref = plain_ref();
    for (int long_side = 1; long_side <= 8; long_side++)
        for (int along = 0; along < 2; along++) {
            const float at[2] = {0.47f, 0.55f}, size = (float)long_side / N;
            const float dx[2] = {along ? 0 : size, along ? size : 0};
            const float dy[2] = {along ? 1.0f / N : 0, along ? 0 : 1.0f / N};
            float rgba[4];
            prt_texture_sample(&image, t, &ref, at, dx, dy, rgba);
            for (int k = 0; k < 2; k++)
                assert_float_equal(rgba[k] * 255, 10 * (at[k] * N - 0.5f), 0.01);
        }
    prt_free(t);
}

static void hash_is_of_content(void **state)
{
    struct prt_texture_image a, b, c;
    uint8_t *p = ramp(4, 4, PRT_TEXTURE_DATA, &a), *q = ramp(4, 4, PRT_TEXTURE_DATA, &b);
    uint8_t *r = ramp(4, 4, PRT_TEXTURE_COLOR, &c);
    assert_memory_equal(a.hash, b.hash, sizeof a.hash);
    assert_memory_not_equal(a.hash, c.hash, sizeof a.hash);
    prt_free(p), prt_free(q), prt_free(r);
}

static struct prt_blob png(const struct prt_context *ctx, uint32_t w, uint32_t h,
                           const uint8_t *rgb)
{
    struct prt_blob out;
    assert_int_equal(prt_encode_png(ctx, rgb, w, h, 3, &out), PRT_OK);
    return out;
}

static void decoding_and_limits(void **state)
{
    struct prt_context ctx = context();
    const uint8_t rgb[12] = {1, 2, 3, 50, 60, 70, 255, 0, 9, 128, 129, 130};
    struct prt_blob file = png(&ctx, 2, 2, rgb);
    uint32_t w = 0, h = 0;
    uint8_t *t = NULL, *bytes = (uint8_t *)file.bytes;
    assert_int_equal(prt_texture_decode(&ctx, "a", bytes, file.size, 1 << 20, &w, &h, &t), 0);
    assert_true(w == 2 && h == 2 && t[4] == 50 && t[15] == 255 && t[13] == 129);
    prt_free(t);
    // too little memory is refused before the pixels
    assert_int_equal(prt_texture_decode(&ctx, "a", bytes, file.size, 16, &w, &h, &t),
                     PRT_LIMIT);
    // every cut is refused
    for (size_t n = 0; n + 12 < file.size; n++)
        assert_true(prt_texture_decode(&ctx, "a", bytes, n, 1 << 20, &w, &h, &t) < 0);
    // a lie about the size: the header's checksum fails, and with it the file
    bytes[16] = 0x7f;
    assert_true(prt_texture_decode(&ctx, "a", bytes, file.size, 1 << 20, &w, &h, &t) < 0);
    static const char ktx[] = "\xabKTX 20\xbb\r\n\x1a\n and more";
    assert_int_equal(prt_texture_decode(&ctx, "wall", ktx, sizeof ktx, 1 << 20, &w, &h, &t),
                     PRT_UNSUPPORTED);
    assert_non_null(strstr(lines, "wall: KTX2"));
    prt_free(file.bytes);
}

static void base64(const uint8_t *p, size_t n, char *out)
{
    static const char digit[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < n; i += 3) {
        uint32_t b = (uint32_t)p[i] << 16 | (uint32_t)(i + 1 < n ? p[i + 1] : 0) << 8 |
                     (i + 2 < n ? p[i + 2] : 0);
        for (int k = 0; k < 4; k++)
            *out++ = i + (size_t)k > n ? '=' : digit[b >> (18 - 6 * k) & 63];
    }
    *out = 0;
}

// A square of two triangles with two sets of uv, the second (0.25, 0.75) everywhere, and
// colours; materials is JSON with one %s for an image's data URI.
static int square_read(const struct prt_context *ctx, const char *materials,
                       const struct prt_mesh_options *options, struct prt_mesh **out)
{
    static const struct {
        float p[4][3], n[4][3], uv[4][2], uv1[4][2];
        uint8_t color[4][4];
        uint16_t index[6];
    } data = {
        {{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}},
        {{0, 0, 1}, {0, 0, 1}, {0, 0, 1}, {0, 0, 1}},
        {{0, 1}, {1, 1}, {1, 0}, {0, 0}},
        {{.25f, .75f}, {.25f, .75f}, {.25f, .75f}, {.25f, .75f}},
        {{255, 51, 255, 255}, {255, 51, 255, 255}, {255, 51, 255, 255}, {255, 51, 255, 255}},
        {0, 1, 2, 0, 2, 3}};
    // rows: red, green / blue, white
    const uint8_t rgb[12] = {255, 0, 0, 0, 255, 0, 0, 0, 255, 255, 255, 255};
    struct prt_blob file = png(ctx, 2, 2, rgb);
    char buffer[600], image[2000], part[4000], json[8000];
    base64((const uint8_t *)&data, sizeof data, buffer);
    base64((const uint8_t *)file.bytes, file.size, image);
    prt_free(file.bytes);
    snprintf(part, sizeof part, materials, image);
    int n = snprintf(
        json, sizeof json,
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
        "\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":[{\"material\":0,\"indices\":5,"
        "\"attributes\":{\"POSITION\":0,\"NORMAL\":1,\"TEXCOORD_0\":2,\"TEXCOORD_1\":3,"
        "\"COLOR_0\":4}}]}],%s,\"accessors\":["
        "{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"},"
        "{\"bufferView\":0,\"byteOffset\":48,\"componentType\":5126,\"count\":4,\"type\":"
        "\"VEC3\"},"
        "{\"bufferView\":0,\"byteOffset\":96,\"componentType\":5126,\"count\":4,\"type\":"
        "\"VEC2\"},"
        "{\"bufferView\":0,\"byteOffset\":128,\"componentType\":5126,\"count\":4,\"type\":"
        "\"VEC2\"},"
        "{\"bufferView\":0,\"byteOffset\":160,\"componentType\":5121,\"normalized\":true,"
        "\"count\":4,\"type\":\"VEC4\"},"
        "{\"bufferView\":0,\"byteOffset\":176,\"componentType\":5123,\"count\":6,\"type\":"
        "\"SCALAR\"}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":188}],\"buffers\":[{\"byteLength\":188,"
        "\"uri\":\"data:application/octet-stream;base64,%s\"}]}",
        part, buffer);
    assert_in_range(n, 1, sizeof json - 1);
    return prt_mesh_load_memory(ctx, "square", json, (size_t)n, NULL, options, out);
}

static int square(const struct prt_context *ctx, const char *materials, struct prt_mesh **out)
{
    return square_read(ctx, materials, NULL, out);
}

// The look at the middle of the lower right triangle, whose texture coordinates are near (2/3,
// 2/3): the white texel, but for transforms.
static struct prt_look look(const struct prt_mesh *m)
{
    const float no[2] = {0, 0}, up[3] = {0, 0, 1};
    struct prt_look out;
    prt_mesh_look(m, 0, 0, 1 / 3.0f, 1 / 3.0f, no, no, up, &out);
    return out;
}

static const char *const image_json =
    "\"images\":[{\"name\":\"four\",\"uri\":\"data:image/png;base64,%s\"}],"
    "\"samplers\":[{\"magFilter\":9728,\"wrapS\":33071}],"
    "\"textures\":[{\"source\":0,\"sampler\":0},{\"source\":7}],\"materials\":[{";

static struct prt_mesh *load(const struct prt_context *ctx, const char *material)
{
    char text[4000];
    struct prt_mesh *m = NULL;
    snprintf(text, sizeof text, "%s%s}]", image_json, material);
    if (square(ctx, text, &m)) fail_msg("%s", lines);
    return m;
}

// flip_v: the first set's place moves from the white texel to the green one above it, the
// second's from the blue one to the red one.
static void images_upside_down(void **state)
{
    const struct prt_mesh_options options = {.flip_v = true};
    for (int set = 0; set < 2; set++) {
        struct prt_context ctx = context();
        char text[4000];
        struct prt_mesh *m = NULL;
        snprintf(text, sizeof text,
                 "%s\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,"
                 "\"texCoord\":%d}}}]",
                 image_json, set);
        assert_int_equal(square_read(&ctx, text, &options, &m), PRT_OK);
        const struct prt_look l = look(m);
        assert_float_equal(l.base[0], set, 1e-4);
        assert_float_equal(l.base[1], set ? 0 : 0.2, 1e-4); // times the vertex colour
        assert_float_equal(l.base[2], 0, 1e-4);
        prt_mesh_destroy(m);
    }
}

// flip_v: a map's transform holds in the file's own v. It moves the second set's v from 0.75 to
// 0.375, in the red texel, and the flipped image is blue there.
static void images_upside_down_and_moved(void **state)
{
    const struct prt_mesh_options options[2] = {{0}, {.flip_v = true}};
    for (int flipped = 0; flipped < 2; flipped++) {
        struct prt_context ctx = context();
        char text[4000];
        struct prt_mesh *m = NULL;
        snprintf(text, sizeof text,
                 "%s\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"texCoord\":1,"
                 "\"extensions\":{\"KHR_texture_transform\":{\"scale\":[1,0.5]}}}}}]",
                 image_json);
        assert_int_equal(square_read(&ctx, text, &options[flipped], &m), PRT_OK);
        const struct prt_look l = look(m);
        assert_float_equal(l.base[0], !flipped, 1e-4);
        assert_float_equal(l.base[2], flipped, 1e-4);
        prt_mesh_destroy(m);
    }
}

static void maps_of_a_gltf(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m = load(&ctx, "\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,0.5,1],"
                                    "\"baseColorTexture\":{\"index\":0}}");
    struct prt_look l = look(m); // white * factor * vertex colour
    assert_float_equal(l.base[0], 1, 1e-4);
    assert_float_equal(l.base[1], 0.2, 1e-4);
    assert_float_equal(l.base[2], 0.5, 1e-4);
    assert_true(m->n_image == 1 && l.roughness < 0);
    prt_mesh_destroy(m);
    // the second set lies in the blue texel; its transform moves it to the green one
    m = load(&ctx,
             "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"texCoord\":1}}");
    l = look(m);
    assert_true(l.base[0] < 1e-4f && l.base[1] < 1e-4f && l.base[2] > 0.99f && m->n_uv == 2);
    prt_mesh_destroy(m);
    m = load(&ctx, "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0,\"texCoord\":1,"
                   "\"extensions\":{\"KHR_texture_transform\":{\"offset\":[0.5,-0.5]}}}}");
    l = look(m);
    assert_true(l.base[0] < 1e-4f && l.base[1] > 0.19f && l.base[2] < 1e-4f);
    prt_mesh_destroy(m);
    // a quarter turn counter-clockwise, as the extension draws it: (u, v) -> (v, -u)
    m = load(&ctx, "\"emissiveFactor\":[2,1,1],\"emissiveTexture\":{\"index\":0,\"texCoord\":1,"
                   "\"extensions\":{\"KHR_texture_transform\":{\"rotation\":1.5707963}}}");
    l = look(m); // (0.75, -0.25): with the edge of S held and T repeated, the white texel
    assert_float_equal(l.emission[0], 2, 1e-4);
    assert_true(l.emission[1] > 0.99f);
    prt_mesh_destroy(m);
    m = load(&ctx,
             "\"normalTexture\":{\"index\":0,\"texCoord\":1},\"occlusionTexture\":{\"index\":"
             "0,\"texCoord\":1,\"strength\":0.5},\"pbrMetallicRoughness\":{\"roughnessFactor\""
             ":0.5,\"metallicRoughnessTexture\":{\"index\":0}}");
    l = look(m); // set 1 has no area for tangents: the normal stays
    assert_float_equal(l.normal[2], 1, 1e-5);
    assert_float_equal(l.roughness, 0.5, 1e-5);
    assert_float_equal(l.occlusion, 0.5, 1e-4);
    assert_int_equal(m->n_image, 2); // the same pixels as normals and as numbers
    prt_mesh_destroy(m);
    assert_null(strstr(lines, "left out"));
}

// What extensions replace: the set of coordinates, the strength of emission, the metal of a
// glossy material, and a PNG that has a WebP beside it.
static void extensions_of_a_gltf(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m =
        load(&ctx, "\"emissiveFactor\":[0.5,0.25,0],\"pbrMetallicRoughness\":"
                   "{\"baseColorTexture\":{\"index\":0,\"extensions\":"
                   "{\"KHR_texture_transform\":{\"texCoord\":1}}}},\"extensions\":"
                   "{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":4}}");
    struct prt_look l = look(m); // the second set lies in the blue texel
    assert_true(l.base[0] < 1e-4f && l.base[2] > 0.99f);
    assert_float_equal(l.emission[0], 2, 1e-5);
    assert_float_equal(l.emission[1], 1, 1e-5);
    assert_float_equal(l.metallic, 1, 0);
    prt_mesh_destroy(m);
    m = load(&ctx, "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":"
                   "{\"diffuseTexture\":{\"index\":0}}}");
    assert_int_equal(m->n_image, 1);
    assert_float_equal(look(m).metallic, 0, 0);
    prt_mesh_destroy(m);
    lines[0] = 0;
    assert_int_equal(
        square(&ctx,
               "\"images\":[{\"uri\":\"none.png\"},{\"uri\":\"data:image/png;base64,%s\"}],"
               "\"textures\":[{\"source\":0,\"extensions\":{\"EXT_texture_webp\":"
               "{\"source\":1}}}],\"materials\":[{\"pbrMetallicRoughness\":"
               "{\"baseColorTexture\":{\"index\":0}}}]",
               &m),
        PRT_OK);
    assert_int_equal(m->n_image, 1);
    assert_null(strstr(lines, "none.png"));
    prt_mesh_destroy(m);
}

// Each of many materials keeps its own maps, and one without any has none.
static void maps_of_many_materials(void **state)
{
    enum { N = 200, ROOM = 200 * N };
    static const float p[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    struct prt_context ctx = context();
    struct prt_mesh *m = NULL;
    char buffer[100], *json = malloc(ROOM);
    base64((const uint8_t *)p, sizeof p, buffer);
    int n =
        snprintf(json, ROOM,
                 "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],"
                 "\"nodes\":[{\"mesh\":0}],\"buffers\":[{\"byteLength\":36,\"uri\":"
                 "\"data:application/octet-stream;base64,%s\"}],\"bufferViews\":[{\"buffer\":0,"
                 "\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,"
                 "\"count\":3,\"type\":\"VEC3\"}],\"materials\":[",
                 buffer);
    for (int k = 0; k < N; k++)
        n += snprintf(json + n, (size_t)(ROOM - n),
                      "%s{\"name\":\"%d\",\"emissiveFactor\":[0,%.9g,0]}", k ? "," : "", k,
                      k % 3 ? k / 256.0 : 0);
    n += snprintf(json + n, (size_t)(ROOM - n), "],\"meshes\":[{\"primitives\":[");
    for (int k = 0; k < N; k++)
        n += snprintf(json + n, (size_t)(ROOM - n),
                      "%s{\"attributes\":{\"POSITION\":0},\"material\":%d}", k ? "," : "", k);
    n += snprintf(json + n, (size_t)(ROOM - n), "]}]}");
    assert_int_equal(prt_mesh_load_memory(&ctx, "many", json, (size_t)n, NULL, NULL, &m),
                     PRT_OK);
    assert_int_equal(m->n_surface, N);
    for (int k = 0; k < N; k++) {
        const int of = atoi(m->surface[k].name);
        const float emits = of % 3 ? (float)of / 256 : 0;
        assert_true(m->maps[k].emissive[1] == emits);
        for (int i = 0; i < PRT_N_MAP; i++)
            assert_int_equal(m->maps[k].map[i].image, m->maps[0].map[i].image);
    }
    prt_mesh_destroy(m);
    free(json);
}

// Numbers come from the channels that glTF says: red occludes, green is rough, blue is metal.
static void channels_of_numbers(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m =
        load(&ctx, "\"occlusionTexture\":{\"index\":0,\"strength\":0.5},"
                   "\"pbrMetallicRoughness\":{\"roughnessFactor\":0.8,\"metallicFactor\":0.5,"
                   "\"metallicRoughnessTexture\":{\"index\":0}}");
    struct prt_texture_image image;
    uint8_t *t = ramp(1, 1, PRT_TEXTURE_DATA, &image);
    t[0] = 51, t[1] = 102, t[2] = 204; // 0.2, 0.4, 0.8
    assert_int_equal(m->n_image, 1);
    m->image[0] = image;
    m->texel = t;
    struct prt_look l = look(m);
    assert_float_equal(l.occlusion, 0.6, 1e-5);
    assert_float_equal(l.roughness, 0.32, 1e-5);
    assert_float_equal(l.metallic, 0.4, 1e-5);
    prt_free(t);
    prt_mesh_destroy(m);
}

// Maps are filtered over the spacing of the surface's samples, however large its triangles are:
// where texels are far larger, samples have the tint of their own one.
static void samples_look_over_their_spacing(void **state)
{
    const float no[2] = {0, 0}, up[3] = {0, 0, 1};
    struct prt_context ctx = context();
    struct prt_mesh *m =
        load(&ctx, "\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}");
    struct prt_surface_points *s;
    unsigned own = 0;
    m->texture_split = 1;
    assert_int_equal(prt_mesh_scale(&ctx, m, 0, 100), PRT_OK);
    assert_int_equal(prt_surface_create(&ctx, m, 4000, 10, 1, &s), PRT_OK);
    for (uint32_t i = 0; i < s->n_sample; i++) {
        struct prt_look at;
        prt_mesh_look(m, s->triangle[i], 0, s->inside[i][0], s->inside[i][1], no, no, up, &at);
        own += fabsf(s->tint[i] - prt_mesh_tint(m, at.base)) < 1e-3f;
    }
    assert_true(own > s->n_sample / 10 * 9);
    prt_surface_destroy(s);
    prt_mesh_destroy(m);
}

// Inside of a material: numbers of the extensions, and none of those out of range.
static void volumes_of_a_gltf(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m =
        load(&ctx, "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.9,0.8,0.7,1]},"
                   "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":0.02,"
                   "\"attenuationColor\":[0.9,0.6,0.1]}}");
    assert_non_null(m->volume);
    assert_int_equal(m->volume[0].kind, PRT_VOLUME_ATTENUATION);
    assert_float_equal(m->volume[0].distance, 0.02, 1e-7);
    assert_float_equal(m->volume[0].color[1], 0.6, 1e-6);
    assert_float_equal(m->volume[0].albedo[2], 0.7, 1e-6);
    prt_mesh_destroy(m);
    m = load(&ctx, "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":-3,"
                   "\"attenuationColor\":[2,0,0]},\"KHR_materials_volume_scatter\":"
                   "{\"multiscatterColor\":[0.3,0.4,0.5],\"scatterAnisotropy\":7}}");
    assert_int_equal(m->volume[0].kind, PRT_VOLUME_SCATTER);
    assert_float_equal(m->volume[0].distance, 0, 0);
    assert_float_equal(m->volume[0].color[0], 1, 0);
    assert_float_equal(m->volume[0].albedo[1], 0.4, 1e-6);
    assert_float_equal(m->volume[0].g, 0, 0);
    prt_mesh_destroy(m);
    m = load(&ctx, "\"name\":\"plain\"");
    assert_null(m->volume);
    prt_mesh_destroy(m);
    // one number out of range makes the whole colour absent
    m = load(&ctx, "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.9,0.8,0.7,1]},"
                   "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":0.02,"
                   "\"attenuationColor\":[0.5,0.6,7]},\"KHR_materials_scatter\":"
                   "{\"multiscatterColor\":[0.3,0.4]}}");
    for (int c = 0; c < 3; c++) {
        assert_float_equal(m->volume[0].color[c], 1, 0);
        assert_float_equal(m->volume[0].albedo[c], 0.9 - 0.1 * c, 1e-6);
    }
    prt_mesh_destroy(m);
    lines[0] = 0; // F_0 of a quarter of eta 1.5 is 0.01; a coat is named as lost
    m = load(&ctx, "\"extensions\":{\"KHR_materials_specular\":{\"specularFactor\":0.25},"
                   "\"KHR_materials_clearcoat\":{},\"KHR_materials_transmission\":"
                   "{\"transmissionFactor\":0.75},\"KHR_materials_volume\":{}}");
    assert_float_equal(m->surface[0].ior, 1.1 / 0.9, 1e-5);
    assert_non_null(strstr(lines, "a medium has no clearcoat: left out"));
    prt_mesh_destroy(m); // a colour of the reflection counts by its mean: a quarter again
    m = load(&ctx, "\"extensions\":{\"KHR_materials_specular\":{\"specularColorFactor\":"
                   "[0.6,0.15,0]},\"KHR_materials_transmission\":{\"transmissionFactor\":0.75},"
                   "\"KHR_materials_volume\":{}}");
    assert_float_equal(m->surface[0].ior, 1.1 / 0.9, 1e-5);
    assert_non_null(strstr(lines, "the 25 % of it that do not transmit"));
    prt_mesh_destroy(m);
    m = load(&ctx, "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":0.01,"
                   "\"attenuationColor\":[0.4,0.5,0.4]},\"KHR_materials_scatter\":"
                   "{\"multiscatterColorFactor\":[0.2,0.5,0.6],\"scatterAnisotropy\":0.2}}");
    assert_int_equal(m->volume[0].kind, PRT_VOLUME_SCATTER);
    assert_float_equal(m->volume[0].albedo[1], 0.5, 1e-6);
    assert_float_equal(m->volume[0].g, 0.2, 1e-6);
    prt_mesh_destroy(m);
}

// Green is up the image: a map that says (0, 0.7, 0.7) tilts towards smaller v, here +y.
static void normals_tilt_up(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m = load(&ctx, "\"normalTexture\":{\"index\":0}");
    struct prt_texture_image image;
    uint8_t *t = ramp(1, 1, PRT_TEXTURE_NORMAL, &image);
    t[0] = 128, t[1] = 218, t[2] = 218;
    m->image[0] = image;
    m->texel = t;
    struct prt_look l = look(m);
    assert_float_equal(l.normal[0], 0, 0.01);
    assert_float_equal(l.normal[1], 0.707, 0.01);
    prt_free(t);
    prt_mesh_destroy(m);
}

// A picture reads a map at the level whose texels have the size of a pixel, in pictures of
// every shape.
static void level_of_a_pixel(void **state)
{
    enum { SIDE = 64, LEVELS = 7 };
    static const uint32_t sides[][2] = {{40, 40}, {160, 40}, {20, 80}};
    struct prt_context ctx = context();
    struct prt_mesh *m = load(&ctx, "\"occlusionTexture\":{\"index\":0}");
    struct prt_texture_image image;
    uint8_t *t = ramp(SIDE, SIDE, PRT_TEXTURE_DATA, &image), *at = t;
    for (uint32_t k = 0; k < LEVELS; k++) {
        const size_t n = 4 * (size_t)(SIDE >> k) * (SIDE >> k);
        memset(at, 20 * (int)k, n);
        at += n;
    }
    m->image[0] = image;
    m->texel = t;
    for (int i = 0; i < 3; i++) {
        // two units are as high as the picture
        const struct prt_camera camera = {.eye = {.5f, .5f, 2},
                                          .target = {.5f, .5f, 0},
                                          .up = {0, 1, 0},
                                          .fovy_deg = 53.130102f};
        const struct prt_raster raster = {sides[i][0], sides[i][1], 1, PRT_RASTER_AUTO};
        const double want = log2(2.0 * SIDE / sides[i][1]);
        struct prt_visibility *seen = NULL;
        struct prt_gbuffer g;
        double level = 0;
        assert_int_equal(prt_visibility_create(&ctx, m, &camera, &raster, &seen), PRT_OK);
        prt_visibility_gbuffer(seen, &g);
        assert_true(g.n_point > 100 && g.occlusion);
        for (uint32_t k = 0; k < g.n_point; k++)
            level += (double)g.occlusion[k] * 255 / 20 / g.n_point;
        if (fabs(level - want) > 0.05) fail_msg("level %g, %g is a pixel's", level, want);
        prt_visibility_destroy(seen);
    }
    prt_free(t);
    prt_mesh_destroy(m);
}

// The mean of normals is shorter the more they differ, at every level: its length is the look's
// variance, and is not lost on the way to the coarsest.
static void means_of_normals_stay_short(void **state)
{
    for (uint32_t side = 2; side <= 32; side *= 2) {
        struct prt_texture_image image;
        uint8_t *t = prt_calloc(prt_texture_bytes(side, side), 1);
        for (uint32_t i = 0; i < side * side; i++) { // columns tilt by 45 degrees to both sides
            t[4 * i] = i % 2 ? 218 : 37;
            t[4 * i + 1] = 128, t[4 * i + 2] = 218, t[4 * i + 3] = 255;
        }
        prt_texture_finish_levels(side, side, PRT_TEXTURE_NORMAL, t, &image);
        struct prt_texture_ref ref = plain_ref();
        const float uv[2] = {0.4f, 0.6f}, dx[2] = {1, 0}, dy[2] = {0, 1};
        float n[4];
        prt_texture_sample(&image, t, &ref, uv, dx, dy, n);
        assert_float_equal(n[0], 0, 0.02);
        assert_float_equal(n[2], 0.7071, 0.02);
        prt_free(t);
    }
}

// A material of an OBJ: its map's -s and -o count v upwards, where the mesh counts it
// downwards; a GGX lobe is as wide as Phong's of the exponent Ns.
static void numbers_of_an_obj_material(void **state)
{
    struct prt_draft draft = {.name = "obj"};
    struct obj_material m;
    static const char text[] = "newmtl other\nNs 7\nKd 1 1 1\nnewmtl wall\nNs 30\nKd .1 .2 .3\n"
                               "map_Kd -s 2 3 -o 0.25 0.5 -clamp on a b.png\n"
                               "newmtl third\nKe 1 1 1\n";
    prt_obj_material_init(&m);
    strcpy(m.name, "wall");
    prt_obj_material_parse(&draft, text, &m);
    assert_true(m.found && m.emissive[0] == 0 && m.base[1] == 0.2f);
    assert_float_equal(pow((double)m.roughness, 4), 2 / 32., 1e-6); // alpha^2 = 2 / (Ns + 2)
    const struct obj_map *map = &m.map[PRT_MAP_BASE];
    const float *t = map->ref.transform, u = 0.3f, v = 0.7f; // v of the OBJ
    assert_string_equal(map->file, "a b.png");
    assert_int_equal(map->ref.wrap_v, PRT_WRAP_CLAMP);
    assert_float_equal(t[0] * u + t[1] * (1 - v) + t[2], 0.25 + 2 * u, 1e-6);
    assert_float_equal(t[3] * u + t[4] * (1 - v) + t[5], 1 - (0.5 + 3 * v), 1e-6);
    // Pr holds, whichever comes first; a name may begin with digits
    static const char *const order[] = {
        "newmtl a\nPr .5\nNs 100\nmap_Kd -s 2 2 1001.png\n",
        "newmtl a\nNs 100\nPr .5\nmap_Kd -o 0 0 -mm 0 1 3d.png"};
    static const char *const name[] = {"1001.png", "3d.png"};
    for (int i = 0; i < 2; i++) {
        prt_obj_material_init(&m);
        prt_obj_material_parse(&draft, order[i], &m);
        assert_float_equal(m.roughness, 0.5, 0);
        assert_string_equal(m.map[PRT_MAP_BASE].file, name[i]);
        assert_float_equal(m.map[PRT_MAP_BASE].ref.transform[0], i ? 1 : 2, 0);
    }
}

// Each map of an OBJ's material has its own word, or several.
static void maps_of_an_obj_material(void **state)
{
    static const struct {
        const char *word;
        enum prt_map map;
    } row[] = {{"map_Kd", PRT_MAP_BASE},      {"map_Ke", PRT_MAP_EMISSIVE},
               {"map_Pr", PRT_MAP_ROUGHNESS}, {"norm", PRT_MAP_NORMAL},
               {"map_Kn", PRT_MAP_NORMAL},    {"map_Bump", PRT_MAP_NORMAL},
               {"bump", PRT_MAP_NORMAL}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct prt_draft draft = {.name = "obj"};
        struct obj_material m;
        char text[80];
        snprintf(text, sizeof text, "newmtl a\n%s a.png\n", row[i].word);
        prt_obj_material_init(&m);
        prt_obj_material_parse(&draft, text, &m);
        for (int k = 0; k < PRT_N_MAP; k++)
            assert_string_equal(m.map[k].file, k == (int)row[i].map ? "a.png" : "");
    }
}

static void wrong_texture_records(void **state)
{
    static const struct {
        const char *material, *line;
    } bad[] = {
        {"\"normalTexture\":{\"index\":9}", "normal texture is left out"},
        {"\"normalTexture\":{\"index\":-1}", "normal texture is left out"},
        {"\"normalTexture\":{\"index\":1}", "names no image"},
        {"\"normalTexture\":{\"index\":0,\"texCoord\":9}", "texCoord is out of range"},
        {"\"normalTexture\":{\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"offset\":"
         "[1e30,0]}}}",
         "KHR_texture_transform is out of range"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct prt_context ctx = context();
        struct prt_mesh *m = load(&ctx, bad[i].material);
        assert_non_null(strstr(lines, bad[i].line));
        assert_int_equal(m->n_image, 0);
        prt_mesh_destroy(m);
    }
    static const char *const image[] = {
        "data:image/png;base64,iVBORw0KGgo=", "data:image/png,plain", "../../etc/passwd",
        "no%%20such.png", ""};
    for (size_t i = 0; i < sizeof image / sizeof *image; i++) {
        struct prt_context ctx = context();
        struct prt_mesh *m = NULL;
        char text[1000];
        snprintf(
            text, sizeof text,
            "\"images\":[{\"name\":\"wall\",\"uri\":\"%s\"}],\"textures\":[{\"source\":0}],"
            "\"materials\":[{\"normalTexture\":{\"index\":0}}]",
            image[i]);
        assert_int_equal(square(&ctx, text, &m), PRT_OK);
        assert_non_null(strstr(lines, "left out"));
        prt_mesh_destroy(m);
    }
}

// Images in base64 of all three remainders: each byte counts, for libwebp takes no file that is
// shorter than its header says.
static void data_uri_to_its_last_byte(void **state)
{
    for (unsigned more = 0; more <= 4; more += 2) { // zeros behind the picture, in its chunk
        uint8_t webp[38] = {'R', 'I', 'F',  'F', 26,   0,    0,    0,    'W',  'E',  'B',
                            'P', 'V', 'P',  '8', 'L',  14,   0,    0,    0,    0x2f, 0,
                            0,   0,   0x10, 7,   0x10, 0x11, 0x11, 0x88, 0x88, 0xfe, 7};
        struct prt_context ctx = context();
        struct prt_mesh *m = NULL;
        char data[80], text[1000];
        webp[4] = (uint8_t)(webp[4] + more);
        webp[16] = (uint8_t)(webp[16] + more);
        base64(webp, 34 + more, data);
        snprintf(text, sizeof text,
                 "\"images\":[{\"uri\":\"data:image/webp;base64,%s\"}],"
                 "\"textures\":[{\"source\":0}],"
                 "\"materials\":[{\"normalTexture\":{\"index\":0}}]",
                 data);
        assert_int_equal(square(&ctx, text, &m), PRT_OK);
        assert_int_equal(m->n_image, 1);
        assert_true(m->image[0].width == 1 && m->image[0].height == 1);
        prt_mesh_destroy(m);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wrap_modes),
        cmocka_unit_test(levels_average_light),
        cmocka_unit_test(levels_by_footprint),
        cmocka_unit_test(level_of_a_pixel),
        cmocka_unit_test(anisotropic),
        cmocka_unit_test(odd_sides_weigh_by_area),
        cmocka_unit_test(transforms_turn_footprints),
        cmocka_unit_test(hash_is_of_content),
        cmocka_unit_test(probes_lie_about_the_point),
        cmocka_unit_test(decoding_and_limits),
        cmocka_unit_test(images_upside_down),
        cmocka_unit_test(images_upside_down_and_moved),
        cmocka_unit_test(maps_of_a_gltf),
        cmocka_unit_test(extensions_of_a_gltf),
        cmocka_unit_test(maps_of_many_materials),
        cmocka_unit_test(channels_of_numbers),
        cmocka_unit_test(numbers_of_an_obj_material),
        cmocka_unit_test(maps_of_an_obj_material),
        cmocka_unit_test(normals_tilt_up),
        cmocka_unit_test(means_of_normals_stay_short),
        cmocka_unit_test(samples_look_over_their_spacing),
        cmocka_unit_test(volumes_of_a_gltf),
        cmocka_unit_test(wrong_texture_records),
        cmocka_unit_test(data_uri_to_its_last_byte),
    };
    return run_test_group(tests, NULL, NULL);
}
