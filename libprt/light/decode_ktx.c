/* SPDX-License-Identifier: MIT */
/* Parser of KTX and KTX2 cubemaps: the base level of six faces, in half, float,
 * shared-exponent, 11-bit float and 8-bit formats. OpenImageIO reads neither. */
#include "light_private.h"

#include <math.h>
#include <string.h>
#include <zstd.h>
#ifdef PRT_HAVE_LIBDEFLATE
#include <libdeflate.h>
#else
#include <zlib.h>
#endif

enum { KTX1_HEADER = 64, KTX2_HEADER = 80, KTX2_LEVEL = 24 };

enum texel { HALF, FLOAT, RGB9E5, R11G11B10, SRGB8, BGR8 };
struct faces {
    enum texel kind;
    unsigned channels;    /* of HALF, FLOAT, SRGB8, BGR8 */
    uint32_t n;           /* texels a side */
    const uint8_t *bytes; /* six faces, rows of row_bytes */
    size_t row_bytes, face_bytes;
};

bool prt_is_ktx(const uint8_t *bytes, size_t n)
{
    return n >= 12 && (!memcmp(bytes, "\xabKTX 11\xbb\r\n\x1a\n", 12) ||
                       !memcmp(bytes, "\xabKTX 20\xbb\r\n\x1a\n", 12));
}

static uint32_t u32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static uint64_t u64(const uint8_t *p)
{
    return u32(p) | (uint64_t)u32(p + 4) << 32;
}

/* An unsigned float of 5 exponent bits and `bits` mantissa bits. */
static float small_float(uint32_t v, int bits)
{
    const int e = (int)(v >> bits & 31), m = (int)(v & ((1u << bits) - 1));
    if (e == 31) return m ? NAN : INFINITY;
    return e ? ldexpf((float)(m + (1 << bits)), e - 15 - bits) : ldexpf((float)m, -14 - bits);
}

static float half_to_float(uint32_t h)
{
    const float v = small_float(h & 0x7fff, 10);
    return h & 0x8000 ? -v : v;
}

static size_t texel_bytes(const struct faces *f)
{
    return f->kind == FLOAT                            ? 4 * f->channels
           : f->kind == HALF                           ? 2 * f->channels
           : f->kind == RGB9E5 || f->kind == R11G11B10 ? 4
                                                       : f->channels;
}

static void read_texel(const struct faces *f, const uint8_t *p, float rgb[3])
{
    const uint32_t v = texel_bytes(f) >= 4 ? u32(p) : 0;
    for (int c = 0; c < 3; c++) {
        float value = 0;
        uint32_t bits;
        switch (f->kind) {
        case HALF:
            value = half_to_float(p[2 * c] | (uint32_t)p[2 * c + 1] << 8);
            break;
        case FLOAT:
            bits = u32(p + 4 * c);
            memcpy(&value, &bits, sizeof value);
            break;
        case RGB9E5:
            value = ldexpf((float)(v >> 9 * c & 511), (int)(v >> 27) - 24);
            break;
        case R11G11B10:
            value = c < 2 ? small_float(v >> 11 * c & 2047, 6) : small_float(v >> 22, 5);
            break;
        case SRGB8:
        case BGR8:
            value = prt_srgb_to_linear((float)p[f->kind == BGR8 ? 2 - c : c] / 255);
            break;
        }
        rgb[c] = value;
    }
}

static int unpack(const struct prt_context *ctx, const char *name, const struct faces *f,
                  struct prt_decoded *out)
{
    const size_t side = f->n, step = texel_bytes(f);
    int err = prt_image_reserve(ctx, name, side, side * 6, &out->image);
    for (size_t y = 0; !err && y < 6 * side; y++)
        for (size_t x = 0; x < side; x++)
            read_texel(f,
                       f->bytes + y / side * f->face_bytes + y % side * f->row_bytes + x * step,
                       out->image.rgb + (y * side + x) * 3);
    out->hint = PRT_HINT_GL_CUBE;
    return err;
}

static int check_shape(const struct prt_context *ctx, const char *name, uint32_t width,
                       uint32_t height, uint32_t n_face, uint32_t n_layer)
{
    if (n_face != 6 || n_layer > 1)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: a KTX of %u faces and %u layers; an environment is one cubemap of "
                        "six faces",
                        name, n_face, n_layer);
    if (width != height || !width || width > PRT_CUBE_MAX)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: cube faces of %u x %u pixels; faces are squares of 1 to %d", name,
                        width, height, PRT_CUBE_MAX);
    return PRT_OK;
}

static int short_file(const struct prt_context *ctx, const char *name)
{
    return prt_fail(ctx, PRT_FORMAT, "%s: the file ends in the middle of the faces", name);
}

/* OpenGL's constants of type and format. */
static bool gl_format(uint32_t type, uint32_t format, struct faces *f)
{
    const bool bgr = format == 0x80e0 || format == 0x80e1;
    f->channels = format == 0x1907 || format == 0x80e0   ? 3
                  : format == 0x1908 || format == 0x80e1 ? 4
                                                         : 0;
    if (!f->channels) return false;
    switch (type) {
    case 0x140b:
    case 0x8d61:
        f->kind = HALF;
        return !bgr;
    case 0x1406:
        f->kind = FLOAT;
        return !bgr;
    case 0x1401:
        f->kind = bgr ? BGR8 : SRGB8;
        return true;
    case 0x8c3e:
        f->kind = RGB9E5;
        return !bgr;
    case 0x8c3b:
        f->kind = R11G11B10;
        return !bgr;
    default:
        return false;
    }
}

static int decode_ktx1(const struct prt_context *ctx, const char *name, const uint8_t *b,
                       size_t n, struct prt_decoded *out)
{
    struct faces f = {0};
    if (n < KTX1_HEADER)
        return prt_fail(ctx, PRT_FORMAT, "%s: the file ends inside the KTX header", name);
    if (u32(b + 12) != 0x04030201)
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: a big-endian KTX is not read; write it little-endian", name);
    int err = check_shape(ctx, name, u32(b + 36), u32(b + 40), u32(b + 52), u32(b + 48));
    if (err) return err;
    if (!gl_format(u32(b + 16), u32(b + 24), &f))
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: a KTX of type 0x%x and format 0x%x is not read; write half, float "
                        "or 8-bit RGB(A)",
                        name, u32(b + 16), u32(b + 24));
    f.n = u32(b + 36);
    const uint64_t at = KTX1_HEADER + (uint64_t)u32(b + 60) + 4; /* behind imageSize */
    f.row_bytes = (texel_bytes(&f) * f.n + 3) & ~(size_t)3;
    f.face_bytes = f.row_bytes * f.n;
    if (at > n || n - at < 6 * f.face_bytes) return short_file(ctx, name);
    f.bytes = b + at;
    return unpack(ctx, name, &f, out);
}

/* Vulkan's formats. */
static bool vk_format(uint32_t format, struct faces *f)
{
    static const struct {
        uint32_t format;
        enum texel kind;
        unsigned channels;
    } known[] = {{90, HALF, 3},    {97, HALF, 4},       {106, FLOAT, 3}, {109, FLOAT, 4},
                 {123, RGB9E5, 3}, {122, R11G11B10, 3}, {23, SRGB8, 3},  {29, SRGB8, 3},
                 {37, SRGB8, 4},   {43, SRGB8, 4},      {44, BGR8, 4},   {50, BGR8, 4}};
    for (size_t i = 0; i < sizeof known / sizeof *known; i++)
        if (known[i].format == format) {
            f->kind = known[i].kind;
            f->channels = known[i].channels;
            return true;
        }
    return false;
}

/* Schemes 2 (Zstandard) and 3 (zlib). */
static bool inflate_level(uint32_t scheme, const uint8_t *from, size_t n, uint8_t *to,
                          size_t size)
{
    if (scheme == 2) return ZSTD_decompress(to, size, from, n) == size;
#ifdef PRT_HAVE_LIBDEFLATE
    struct libdeflate_decompressor *d = libdeflate_alloc_decompressor();
    const bool ok = d && libdeflate_zlib_decompress(d, from, n, to, size, NULL) == 0;
    libdeflate_free_decompressor(d);
    return ok;
#else
    uLongf got = size;
    return uncompress(to, &got, from, n) == Z_OK && got == size;
#endif
}

static int decode_ktx2(const struct prt_context *ctx, const char *name, const uint8_t *b,
                       size_t n, struct prt_decoded *out)
{
    struct faces f = {0};
    if (n < KTX2_HEADER + KTX2_LEVEL)
        return prt_fail(ctx, PRT_FORMAT, "%s: the file ends inside the KTX2 header", name);
    const uint32_t scheme = u32(b + 44);
    int err = check_shape(ctx, name, u32(b + 20), u32(b + 24), u32(b + 36), u32(b + 32));
    if (err) return err;
    if (!vk_format(u32(b + 12), &f) || (scheme && scheme != 2 && scheme != 3))
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: a KTX2 of format %u and compression %u is not read; write half, "
                        "float or 8-bit RGB(A), plain or with Zstandard",
                        name, u32(b + 12), scheme);
    f.n = u32(b + 20);
    const uint64_t at = u64(b + KTX2_HEADER), length = u64(b + KTX2_HEADER + 8);
    f.row_bytes = texel_bytes(&f) * f.n;
    f.face_bytes = f.row_bytes * f.n;
    if (at > n || length > n - at || (!scheme && length < 6 * f.face_bytes))
        return short_file(ctx, name);
    if (scheme && u64(b + KTX2_HEADER + 16) != 6 * f.face_bytes)
        return prt_fail(ctx, PRT_FORMAT, "%s: its level has another size than its faces", name);
    uint8_t *level = scheme ? prt_alloc(6 * f.face_bytes, 1) : NULL;
    if (scheme && !level) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", name);
    if (scheme && !inflate_level(scheme, b + at, (size_t)length, level, 6 * f.face_bytes))
        err = prt_fail(ctx, PRT_FORMAT, "%s: its compressed level is damaged", name);
    f.bytes = scheme ? level : b + at;
    if (!err) err = unpack(ctx, name, &f, out);
    prt_free(level);
    return err;
}

int prt_decode_ktx(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out)
{
    return bytes[5] == '1' ? decode_ktx1(ctx, name, bytes, n, out)
                           : decode_ktx2(ctx, name, bytes, n, out);
}
