/* SPDX-License-Identifier: MIT */
/* Readers of common PNG and JPEG, which spare the half second that OpenImageIO's 262 libraries
 * take to open. For other files (interlaced or below 8 bits a channel, CMYK, damaged) they
 * return PRT_UNSUPPORTED without a log line, and OpenImageIO reads them. Runs in the isolated
 * child.
 *
 * The PNG reader is the project's own because libpng 1.6.39 takes longer for the same floats:
 * on 2048 x 1024 pixels 18.2 ms against 14.7 ms (8-bit grey), 32.7 against 26.3 (RGB), 44.8
 * against 31.2 (RGBA), 108 against 98.7 (16-bit RGB); processor time, least of 9 runs.
 * libdeflate inflates the whole image at once, where libpng inflates row by row through zlib.
 */
#include "light_private.h"

#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>
#ifdef PRT_HAVE_LIBDEFLATE
#include <libdeflate.h>
#else
#include <zlib.h>
#endif

static bool inflate_all(const uint8_t *in, size_t n, uint8_t *out, size_t room)
{
#ifdef PRT_HAVE_LIBDEFLATE
    struct libdeflate_decompressor *d = libdeflate_alloc_decompressor();
    size_t got = 0;
    const bool ok = d && !libdeflate_zlib_decompress(d, in, n, out, room, &got) && got == room;
    if (d) libdeflate_free_decompressor(d);
    return ok;
#else
    uLongf got = room;
    return uncompress(out, &got, in, n) == Z_OK && got == room;
#endif
}

static uint32_t crc(const uint8_t *bytes, size_t n)
{
#ifdef PRT_HAVE_LIBDEFLATE
    return libdeflate_crc32(0, bytes, n);
#else
    return (uint32_t)crc32(crc32(0, NULL, 0), bytes, (uInt)n);
#endif
}

static uint32_t get_u32(const uint8_t *p)
{
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

struct png {
    uint32_t width, height;
    unsigned depth, channels;
    bool palette;
    uint8_t color[256][3];
    unsigned n_color;
    uint8_t *idat; /* all IDAT chunks, joined */
    size_t idat_size;
};

static bool read_header(struct png *p, const uint8_t *body, size_t n)
{
    static const uint8_t channels[7] = {1, 0, 3, 1, 2, 0, 4};
    if (n != 13 || body[10] || body[11] || body[12] || body[9] > 6 || !channels[body[9]])
        return false;
    p->width = get_u32(body);
    p->height = get_u32(body + 4);
    p->depth = body[8];
    p->channels = channels[body[9]];
    p->palette = body[9] == 3;
    return p->depth == 8 || (p->depth == 16 && !p->palette);
}

/* Reads the chunks; false for a file that OpenImageIO has to read. p->idat has room for every
 * byte of the file. */
static bool read_chunks(struct png *p, const uint8_t *bytes, size_t n)
{
    size_t at = 8;
    bool first = true;
    while (n - at >= 12) {
        const uint8_t *c = bytes + at, *body = c + 8;
        const size_t size = get_u32(c);
        if (size > n - at - 12 || crc(c + 4, size + 4) != get_u32(body + size)) return false;
        if (first != !memcmp(c + 4, "IHDR", 4) || (first && !read_header(p, body, size)))
            return false;
        first = false;
        if (!memcmp(c + 4, "PLTE", 4)) {
            if (size > sizeof p->color || size % 3) return false;
            memcpy(p->color, body, size);
            p->n_color = (unsigned)(size / 3);
        } else if (!memcmp(c + 4, "IDAT", 4)) {
            memcpy(p->idat + p->idat_size, body, size);
            p->idat_size += size;
        } else if (!memcmp(c + 4, "IEND", 4)) {
            return p->idat_size && (!p->palette || p->n_color);
        }
        at += size + 12;
    }
    return false;
}

static uint8_t paeth(int a, int b, int c)
{
    const int p = a + b - c, da = abs(p - a), db = abs(p - b), dc = abs(p - c);
    return (uint8_t)(da <= db && da <= dc ? a : db <= dc ? b : c);
}

static bool unfilter(unsigned filter, uint8_t *row, const uint8_t *above, size_t n, size_t step)
{
    for (size_t i = 0; i < n; i++) {
        const int left = i >= step ? row[i - step] : 0;
        const int corner = i >= step ? above[i - step] : 0;
        switch (filter) {
        case 0:
            return true;
        case 1:
            row[i] = (uint8_t)(row[i] + left);
            break;
        case 2:
            row[i] = (uint8_t)(row[i] + above[i]);
            break;
        case 3:
            row[i] = (uint8_t)(row[i] + (left + above[i]) / 2);
            break;
        case 4:
            row[i] = (uint8_t)(row[i] + paeth(left, above[i], corner));
            break;
        default:
            return false;
        }
    }
    return true;
}

static bool convert_row(const struct png *p, const uint8_t *row, const float *linear,
                        float *rgb)
{
    const unsigned step = p->channels * p->depth / 8;
    for (uint32_t x = 0; x < p->width; x++, row += step, rgb += 3) {
        if (p->palette) {
            if (*row >= p->n_color) return false;
            for (int c = 0; c < 3; c++) rgb[c] = linear[p->color[*row][c]];
            continue;
        }
        for (unsigned c = 0; c < 3; c++) { /* alpha is dropped */
            const unsigned from = p->channels >= 3 ? c : 0;
            rgb[c] = p->depth == 8
                         ? linear[row[from]]
                         : prt_srgb_to_linear((float)(row[2 * from] << 8 | row[2 * from + 1]) /
                                              65535.0f);
        }
    }
    return true;
}

static void linear_table(float out[256])
{
    for (int i = 0; i < 256; i++) out[i] = prt_srgb_to_linear((float)i / 255.0f);
}

static int decode_rows(const struct prt_context *ctx, const char *name, const struct png *p,
                       struct prt_image *out)
{
    struct prt_image image;
    int err = prt_image_reserve(ctx, name, p->width, p->height, &image);
    if (err) return err;
    const size_t step = (size_t)p->channels * p->depth / 8, n = p->width * step;
    uint8_t *rows = prt_alloc((n + 1) * ((size_t)p->height + 1),
                              1); /* a row of zeros comes before the first */
    bool ok = rows && inflate_all(p->idat, p->idat_size, rows + n + 1, (n + 1) * p->height);
    float linear[256];
    linear_table(linear);
    if (ok) memset(rows, 0, n + 1);
    for (uint32_t y = 0; ok && y < p->height; y++) {
        uint8_t *row = rows + (n + 1) * ((size_t)y + 1);
        ok = unfilter(row[0], row + 1, row - n, n, step) &&
             convert_row(p, row + 1, linear, image.rgb + (size_t)y * p->width * 3);
    }
    prt_free(rows);
    if (ok) *out = image;
    else prt_image_finish(&image);
    return ok ? PRT_OK : PRT_UNSUPPORTED;
}

int prt_decode_png(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_image *out)
{
    struct png p = {.idat = prt_alloc(n, 1)};
    const int err =
        p.idat && read_chunks(&p, bytes, n) ? decode_rows(ctx, name, &p, out) : PRT_UNSUPPORTED;
    prt_free(p.idat);
    return err;
}

// OpenImageIO reads a file that was cut off, and fills the rest with grey.
static int undecoded(const struct prt_context *ctx, const char *name, tjhandle tj)
{
    if (!strstr(tjGetErrorStr2(tj), "Premature end")) return PRT_UNSUPPORTED;
    return prt_fail(ctx, PRT_FORMAT, "%s: the file ends in the middle of the pixels", name);
}

int prt_decode_jpeg(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                    size_t n, struct prt_image *out)
{
    int width = 0, height = 0, sampling = 0, space = 0, err = PRT_UNSUPPORTED;
    struct prt_image image = {0};
    float linear[256];
    tjhandle tj = tjInitDecompress();
    if (!tj || tjDecompressHeader3(tj, bytes, n, &width, &height, &sampling, &space) ||
        width < 1 || height < 1 ||
        (space != TJCS_RGB && space != TJCS_YCbCr && space != TJCS_GRAY))
        goto done;
    err = prt_image_reserve(ctx, name, (uint64_t)width, (uint64_t)height, &image);
    if (err) goto done;
    const size_t count = (size_t)width * (size_t)height * 3;
    uint8_t *rgb8 = prt_alloc(count, 1);
    if (!rgb8) err = PRT_UNSUPPORTED;
    else if (tjDecompress2(tj, bytes, n, rgb8, width, 0, height, TJPF_RGB, TJFLAG_ACCURATEDCT))
        err = undecoded(ctx, name, tj);
    linear_table(linear);
    for (size_t i = 0; !err && i < count; i++) image.rgb[i] = linear[rgb8[i]];
    prt_free(rgb8);
    if (err) prt_image_finish(&image);
    else *out = image;
done:
    if (tj) tjDestroy(tj);
    return err;
}
