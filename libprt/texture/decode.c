// SPDX-License-Identifier: MIT
// Decodes the images of a model to RGBA bytes, in the isolated child: PNG, JPEG and WebP. The
// declared size is checked before the pixels are allocated. Values stay as they are stored:
// glTF ignores gamma and profiles of its images.
#include "texture/internal.h"

#include <png.h>
#include <setjmp.h>
#include <string.h>
#include <turbojpeg.h>
#include <webp/decode.h>

struct decode {
    const struct prt_context *ctx;
    const char *name;
    uint64_t max_bytes;
    uint32_t width, height;
    uint8_t *texel;
};

static int reserve(struct decode *d, uint64_t width, uint64_t height)
{
    if (!width || !height)
        return prt_fail(d->ctx, PRT_FORMAT, "%s: the image has no pixels", d->name);
    if (width > PRT_TEXTURE_MAX_SIDE || height > PRT_TEXTURE_MAX_SIDE)
        return prt_fail(d->ctx, PRT_LIMIT, "%s: %llu x %llu pixels, at most %d a side are read",
                        d->name, (unsigned long long)width, (unsigned long long)height,
                        PRT_TEXTURE_MAX_SIDE);
    uint64_t bytes = prt_texture_bytes((uint32_t)width, (uint32_t)height);
    if (bytes > d->max_bytes)
        return prt_fail(d->ctx, PRT_LIMIT,
                        "%s: %llu x %llu pixels need %llu MB, %llu MB are left for textures",
                        d->name, (unsigned long long)width, (unsigned long long)height,
                        (unsigned long long)(bytes >> 20),
                        (unsigned long long)(d->max_bytes >> 20));
    d->texel = prt_alloc((size_t)bytes, 1);
    if (!d->texel)
        return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory for %llu x %llu pixels", d->name,
                        (unsigned long long)width, (unsigned long long)height);
    d->width = (uint32_t)width;
    d->height = (uint32_t)height;
    return PRT_OK;
}

static int damaged(const struct decode *d, const char *format)
{
    return prt_fail(d->ctx, PRT_FORMAT, "%s: the %s is damaged or cut off", d->name, format);
}

struct png_source {
    const uint8_t *at;
    size_t left;
};

static void png_take(png_structp png, png_bytep out, size_t n)
{
    struct png_source *s = png_get_io_ptr(png);
    if (n > s->left) png_error(png, "cut off");
    memcpy(out, s->at, n);
    s->at += n;
    s->left -= n;
}

static void png_quiet(png_structp png, png_const_charp text)
{
}

static void png_stop(png_structp png, png_const_charp text)
{
    longjmp(png_jmpbuf(png), 1);
}

// Any kind of PNG as RGBA of 8 bits: palettes, grey, 1 to 16 bits, tRNS, interlaced.
static void png_to_rgba(png_structp png, png_infop info)
{
    png_set_expand(png);
    png_set_scale_16(png);
    png_set_gray_to_rgb(png);
    png_set_add_alpha(png, 255, PNG_FILLER_AFTER);
    png_set_interlace_handling(png);
    png_read_update_info(png, info);
}

static int decode_png(struct decode *d, const uint8_t *bytes, size_t n)
{
    struct png_source source = {bytes, n};
    png_structp png = png_create_read_struct(PNG_LIBPNG_VER_STRING, NULL, png_stop, png_quiet);
    png_infop info = png ? png_create_info_struct(png) : NULL;
    png_bytep *volatile row = NULL;
    volatile int status = PRT_FORMAT;
    if (!info) {
        png_destroy_read_struct(&png, NULL, NULL);
        return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    }
    if (!setjmp(png_jmpbuf(png))) {
        png_set_user_limits(png, PRT_TEXTURE_MAX_SIDE, PRT_TEXTURE_MAX_SIDE);
        png_set_chunk_malloc_max(png, 1 << 20);
        png_set_read_fn(png, &source, png_take);
        png_read_info(png, info);
        status = reserve(d, png_get_image_width(png, info), png_get_image_height(png, info));
        if (!status && !(row = prt_alloc(d->height, sizeof *row))) status = PRT_NOMEM;
        if (!status) {
            png_to_rgba(png, info);
            if (png_get_rowbytes(png, info) != 4 * (size_t)d->width) png_error(png, "width");
            for (uint32_t y = 0; y < d->height; y++)
                row[y] = d->texel + 4 * (size_t)y * d->width;
            png_read_image(png, row);
        }
    } else {
        status = damaged(d, "PNG");
    }
    prt_free(row);
    png_destroy_read_struct(&png, &info, NULL);
    return status;
}

static int decode_jpeg(struct decode *d, const uint8_t *bytes, size_t n)
{
    int width = 0, height = 0, sampling = 0, space = 0, status = PRT_FORMAT;
    tjhandle tj = tjInitDecompress();
    if (!tj) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory", d->name);
    if (tjDecompressHeader3(tj, bytes, n, &width, &height, &sampling, &space)) {
        damaged(d, "JPEG");
    } else if (space == TJCS_CMYK || space == TJCS_YCCK) {
        status = prt_fail(d->ctx, PRT_UNSUPPORTED, "%s: CMYK JPEG is not read; save it as RGB",
                          d->name);
    } else if (!(status = reserve(d, width > 0 ? (uint64_t)width : 0,
                                  height > 0 ? (uint64_t)height : 0))) {
        if (tjDecompress2(tj, bytes, n, d->texel, width, 0, height, TJPF_RGBA,
                          TJFLAG_ACCURATEDCT) &&
            tjGetErrorCode(tj) == TJERR_FATAL)
            status = damaged(d, "JPEG");
    }
    tjDestroy(tj);
    return status;
}

static int decode_webp(struct decode *d, const uint8_t *bytes, size_t n)
{
    WebPBitstreamFeatures f;
    if (WebPGetFeatures(bytes, n, &f) != VP8_STATUS_OK) return damaged(d, "WebP");
    if (f.has_animation)
        return prt_fail(d->ctx, PRT_UNSUPPORTED, "%s: an animated WebP is not read", d->name);
    int status = reserve(d, (uint64_t)f.width, (uint64_t)f.height);
    if (status) return status;
    size_t size = 4 * (size_t)d->width * d->height;
    return WebPDecodeRGBAInto(bytes, n, d->texel, size, 4 * f.width) ? PRT_OK
                                                                     : damaged(d, "WebP");
}

int prt_texture_decode(const struct prt_context *ctx, const char *name, const void *bytes,
                       size_t n, uint64_t max_bytes, uint32_t *width, uint32_t *height,
                       uint8_t **texel)
{
    struct decode d = {.ctx = ctx, .name = name, .max_bytes = max_bytes};
    const uint8_t *p = bytes;
    int status;
    if (n >= 8 && !memcmp(p, "\x89PNG\r\n\x1a\n", 8)) status = decode_png(&d, p, n);
    else if (n >= 3 && !memcmp(p, "\xff\xd8\xff", 3)) status = decode_jpeg(&d, p, n);
    else if (n >= 12 && !memcmp(p, "RIFF", 4) && !memcmp(p + 8, "WEBP", 4))
        status = decode_webp(&d, p, n);
    else if (n >= 12 && !memcmp(p, "\xabKTX 20\xbb\r\n\x1a\n", 12))
        status = prt_fail(ctx, PRT_UNSUPPORTED,
                          "%s: KTX2 is not read (Debian has no library for it); give PNG, JPEG "
                          "or WebP",
                          name);
    else status = prt_fail(ctx, PRT_UNSUPPORTED, "%s: not a PNG, JPEG or WebP image", name);
    if (status) {
        prt_free(d.texel);
        return status;
    }
    *width = d.width;
    *height = d.height;
    *texel = d.texel;
    return PRT_OK;
}
