/* SPDX-License-Identifier: MIT */
/* Writers of 8-bit and 16-bit images: PNG with a choice of two row filters and the fastest
 * deflate level; JPEG in strips that threads encode. */
#include "light_private.h"

#include <stdlib.h>
#include <string.h>
#include <turbojpeg.h>
#ifdef PRT_HAVE_LIBDEFLATE
#include <libdeflate.h>
#else
#include <zlib.h>
#endif

#ifdef PRT_HAVE_LIBDEFLATE
static uint32_t crc(uint32_t start, const void *bytes, size_t n)
{
    return libdeflate_crc32(start, bytes, n);
}

/* Returns the compressed size, 0 on failure; *out gets prt_alloc memory with `front` bytes free
 * before the stream and `back` behind. */
static size_t deflate_all(const uint8_t *bytes, size_t n, size_t front, size_t back,
                          uint8_t **out)
{
    struct libdeflate_compressor *c = libdeflate_alloc_compressor(1);
    const size_t bound = c ? libdeflate_zlib_compress_bound(c, n) : 0;
    *out = c ? prt_alloc(front + bound + back, 1) : NULL;
    const size_t size = *out ? libdeflate_zlib_compress(c, bytes, n, *out + front, bound) : 0;
    if (c) libdeflate_free_compressor(c);
    return size;
}
#else
static uint32_t crc(uint32_t start, const void *bytes, size_t n)
{
    return (uint32_t)crc32(start, bytes, (uInt)n);
}

static size_t deflate_all(const uint8_t *bytes, size_t n, size_t front, size_t back,
                          uint8_t **out)
{
    uLongf size = compressBound(n);
    *out = prt_alloc(front + size + back, 1);
    return *out && compress2(*out + front, &size, bytes, n, 1) == Z_OK ? size : 0;
}
#endif

static uint8_t *put_u32(uint8_t *p, uint32_t v)
{
    p[0] = (uint8_t)(v >> 24);
    p[1] = (uint8_t)(v >> 16);
    p[2] = (uint8_t)(v >> 8);
    p[3] = (uint8_t)v;
    return p + 4;
}

/* Length, type, body, CRC; the body is already at p + 8 when NULL. */
static uint8_t *put_chunk(uint8_t *p, const char *type, const void *body, size_t n)
{
    put_u32(p, (uint32_t)n);
    memcpy(p + 4, type, 4);
    if (body) memcpy(p + 8, body, n);
    put_u32(p + 8 + n, crc(crc(0, NULL, 0), p + 4, n + 4));
    return p + 12 + n;
}

/* Applies the PNG filter Sub or Up, whichever has the smaller sum of magnitudes. */
static void filter_row(const uint8_t *row, const uint8_t *above, size_t n, size_t step,
                       uint8_t *out, uint8_t *spare)
{
    unsigned sub = 0, up = 0;
    out[0] = 1;
    spare[0] = 2;
    for (size_t i = 0; i < step; i++) out[1 + i] = row[i];
    for (size_t i = step; i < n; i++) out[1 + i] = (uint8_t)(row[i] - row[i - step]);
    for (size_t i = 0; i < n; i++) spare[1 + i] = (uint8_t)(row[i] - above[i]);
    for (size_t i = 1; i <= n; i++) {
        sub += (unsigned)abs((int8_t)out[i]);
        up += (unsigned)abs((int8_t)spare[i]);
    }
    if (up < sub) memcpy(out, spare, n + 1);
}

static int check_png(const struct prt_context *ctx, uint32_t width, uint32_t height,
                     unsigned n_channel)
{
    if (width && height && width <= PRT_IMAGE_MAX && height <= PRT_IMAGE_MAX &&
        (n_channel == 3 || n_channel == 4))
        return PRT_OK;
    return prt_fail(ctx, PRT_ARG,
                    "PNG of %u x %u x %u: allowed are 1 to %d pixels a side and 3 or 4 "
                    "channels",
                    width, height, n_channel, PRT_IMAGE_MAX);
}

/* pixels: as the file has them, 16-bit channels with the high byte first. */
static int encode_png(const struct prt_context *ctx, const uint8_t *pixels, uint32_t width,
                      uint32_t height, unsigned n_channel, unsigned bits, struct prt_blob *out)
{
    static const uint8_t magic[8] = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};
    enum { FRONT = 8 + 25 + 13 + 8, BACK = 4 + 12 };
    const size_t step = (size_t)n_channel * bits / 8, n = width * step;
    uint8_t *filtered = prt_alloc((n + 1) * (height + 1) + n, 1);
    if (!filtered)
        return prt_fail(ctx, PRT_NOMEM, "no memory for a PNG of %u x %u", width, height);
    uint8_t *spare = filtered + (n + 1) * height, *zero = spare + n + 1;
    memset(zero, 0, n);
    for (uint32_t y = 0; y < height; y++)
        filter_row(pixels + y * n, y ? pixels + (y - 1) * n : zero, n, step,
                   filtered + y * (n + 1), spare);
    uint8_t *file = NULL;
    const size_t size = deflate_all(filtered, (n + 1) * height, FRONT, BACK, &file);
    prt_free(filtered);
    if (!size || size > INT32_MAX) {
        prt_free(file);
        return prt_fail(ctx, PRT_NOMEM, "cannot compress a PNG of %u x %u", width, height);
    }
    uint8_t header[13], *p = file;
    put_u32(put_u32(header, width), height);
    memcpy(header + 8, (const uint8_t[5]){(uint8_t)bits, n_channel == 4 ? 6 : 2, 0, 0, 0}, 5);
    memcpy(p, magic, 8);
    p = put_chunk(p + 8, "IHDR", header, sizeof header);
    p = put_chunk(p, "sRGB", "\0", 1);
    p = put_chunk(p, "IDAT", NULL, size);
    p = put_chunk(p, "IEND", "", 0);
    out->bytes = file;
    out->size = (size_t)(p - file);
    return PRT_OK;
}

int prt_encode_png(const struct prt_context *ctx, const uint8_t *pixels, uint32_t width,
                   uint32_t height, unsigned n_channel, struct prt_blob *out)
{
    memset(out, 0, sizeof *out);
    int status = check_png(ctx, width, height, n_channel);
    return status ? status : encode_png(ctx, pixels, width, height, n_channel, 8, out);
}

int prt_encode_png16(const struct prt_context *ctx, const uint16_t *pixels, uint32_t width,
                     uint32_t height, unsigned n_channel, struct prt_blob *out)
{
    const size_t n = (size_t)width * height * n_channel;
    memset(out, 0, sizeof *out);
    int status = check_png(ctx, width, height, n_channel);
    if (status) return status;
    uint8_t *bytes = prt_alloc(n, 2);
    if (!bytes)
        return prt_fail(ctx, PRT_NOMEM, "no memory for a PNG of %u x %u", width, height);
    for (size_t i = 0; i < n; i++) {
        bytes[2 * i] = (uint8_t)(pixels[i] >> 8);
        bytes[2 * i + 1] = (uint8_t)pixels[i];
    }
    status = encode_png(ctx, bytes, width, height, n_channel, 16, out);
    prt_free(bytes);
    return status;
}

/* ---- JPEG: strips that threads encode, one scan with a restart marker between them ---- */

enum {
    STRIPS_MAX = 16,     /* chosen, not measured: more than the threads of a usual machine */
    STRIP_ROWS_MIN = 64, /* pixels; chosen, not measured: a marker costs some bytes a strip */
};

struct strips {
    const uint8_t *rgb8;
    uint32_t width, height, rows; /* rows: of every strip but the last */
    int sampling, quality;
    uint8_t *file[STRIPS_MAX]; /* a JPEG of its own */
    unsigned long size[STRIPS_MAX];
};

static int encode_strip(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct strips *s = arg;
    int err = PRT_OK;
    for (size_t i = begin; i < end && !err; i++) {
        const uint32_t first = (uint32_t)i * s->rows, left = s->height - first;
        const int rows = (int)(left < s->rows ? left : s->rows);
        tjhandle tj = tjInitCompress();
        s->size[i] = tjBufSize((int)s->width, rows, s->sampling);
        s->file[i] = tj ? prt_alloc(s->size[i], 1) : NULL;
        if (!s->file[i]) err = PRT_NOMEM;
        else if (tjCompress2(tj, s->rgb8 + (size_t)first * s->width * 3, (int)s->width, 0, rows,
                             TJPF_RGB, &s->file[i], &s->size[i], s->sampling, s->quality,
                             TJFLAG_NOREALLOC | TJFLAG_FASTDCT))
            err = PRT_INTERNAL;
        if (tj) tjDestroy(tj);
    }
    return err;
}

/* Offsets of the frame header, of the scan header and of the scan's bits; false in a file that
 * libjpeg-turbo did not write this way. */
static bool find_scan(const uint8_t *file, size_t size, size_t *header, size_t *bits,
                      size_t *frame)
{
    for (size_t at = 2; at + 9 < size && file[at] == 0xff;) {
        const size_t n = 2 + ((size_t)file[at + 2] << 8 | file[at + 3]);
        if (file[at + 1] == 0xc0) *frame = at;
        if (file[at + 1] == 0xda) {
            *header = at;
            *bits = at + n;
            return *frame && *bits + 2 <= size;
        }
        at += n;
    }
    return false;
}

/* Joins the strips' scans. A restart interval begins byte-aligned and with fresh predictions,
 * as a separate file does, and all strips have the same tables: their bits are copied
 * unchanged. */
static int join_strips(const struct strips *s, unsigned n, unsigned mcu, struct prt_blob *out)
{
    size_t total = 16, header[STRIPS_MAX], bits[STRIPS_MAX], frame[STRIPS_MAX] = {0};
    for (unsigned i = 0; i < n; i++) {
        if (!find_scan(s->file[i], s->size[i], &header[i], &bits[i], &frame[i]))
            return PRT_INTERNAL;
        total += s->size[i] + 2;
    }
    uint8_t *file = prt_alloc(total, 1), *p = file;
    if (!file) return PRT_NOMEM;
    const uint32_t interval = (s->width + mcu - 1) / mcu * (s->rows / mcu);
    memcpy(p, s->file[0], header[0]);
    p[frame[0] + 5] = (uint8_t)(s->height >> 8);
    p[frame[0] + 6] = (uint8_t)s->height;
    p += header[0];
    memcpy(p, (const uint8_t[6]){0xff, 0xdd, 0, 4, (uint8_t)(interval >> 8), (uint8_t)interval},
           6);
    p += 6;
    memcpy(p, s->file[0] + header[0], bits[0] - header[0]);
    p += bits[0] - header[0];
    for (unsigned i = 0; i < n; i++) {
        const size_t body = s->size[i] - 2 - bits[i]; /* without the end marker */
        memcpy(p, s->file[i] + bits[i], body);
        p += body;
        *p++ = 0xff;
        *p++ = i + 1 < n ? (uint8_t)(0xd0 + i % 8) : 0xd9;
    }
    *out = (struct prt_blob){file, (size_t)(p - file)};
    return PRT_OK;
}

int prt_encode_jpeg(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                    uint32_t height, int quality, struct prt_blob *out)
{
    memset(out, 0, sizeof *out);
    if (!width || !height || width > PRT_IMAGE_MAX || height > PRT_IMAGE_MAX || quality < 1 ||
        quality > 100)
        return prt_fail(ctx, PRT_ARG,
                        "JPEG of %u x %u at quality %d: allowed are 1 to %d pixels a side and "
                        "quality 1 to 100",
                        width, height, quality, PRT_IMAGE_MAX);
    struct strips s = {.rgb8 = rgb8,
                       .width = width,
                       .height = height,
                       .rows = height,
                       .sampling = quality >= 90 ? TJSAMP_444 : TJSAMP_420,
                       .quality = quality};
    const unsigned mcu = s.sampling == TJSAMP_444 ? 8 : 16;
    unsigned n = height / STRIP_ROWS_MIN;
    n = n > STRIPS_MAX ? STRIPS_MAX : n;
    /* Strips are whole rows of blocks, and at most 65535 blocks, the largest restart interval.
     * Their number does not depend on the threads, so that equal images give equal files. */
    if (n > 1) {
        const uint32_t rows = ((height + n - 1) / n + mcu - 1) / mcu * mcu;
        if ((width + mcu - 1) / mcu * (rows / mcu) <= 65535) s.rows = rows;
    }
    n = (height + s.rows - 1) / s.rows;
    int err = prt_parallel_for(ctx, NULL, n, 1, encode_strip, &s);
    if (!err && n == 1) {
        *out = (struct prt_blob){s.file[0], s.size[0]};
        return PRT_OK;
    }
    if (!err) err = join_strips(&s, n, mcu, out);
    for (unsigned i = 0; i < STRIPS_MAX; i++) prt_free(s.file[i]);
    return err ? prt_fail(ctx, err, "cannot encode a JPEG of %u x %u", width, height) : PRT_OK;
}
