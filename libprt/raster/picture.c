// SPDX-License-Identifier: MIT
// The table of picture formats.
#include "prt/picture.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

static int encode_exr(const struct prt_context *ctx, const struct prt_image *image,
                      const struct prt_picture_options *options, struct prt_blob *out)
{
    return prt_encode_exr(ctx, image, options->full_float, out);
}

static int encode_hdr(const struct prt_context *ctx, const struct prt_image *image,
                      const struct prt_picture_options *options, struct prt_blob *out)
{
    return prt_encode_hdr(ctx, image, out);
}

static int no_memory(const struct prt_context *ctx, const struct prt_image *image)
{
    return prt_fail(ctx, PRT_NOMEM, "no memory for a picture of %u x %u pixels", image->width,
                    image->height);
}

// Colours of prt_tone_map_fine(), and alpha, where the image has it: [height][width][3 or 4].
static int fine_pixels(const struct prt_context *ctx, const struct prt_image *image,
                       const float *alpha, const struct prt_picture_options *options,
                       uint16_t *out)
{
    const size_t n = (size_t)image->width * image->height;
    int status = prt_tone_map_fine(ctx, image, options->tone, options->exposure_ev, out);
    if (!alpha) return status;
    for (size_t i = n; i-- > 0;) { // the last first: a pixel grows from three values to four
        const float a = fminf(fmaxf(alpha[i], 0), 1);
        memmove(out + 4 * i, out + 3 * i, 3 * sizeof *out);
        out[4 * i + 3] = (uint16_t)(257 * (unsigned)(255 * a + 0.5f));
    }
    return status;
}

// Straight colours from premultiplied ones, as PNG has them. Tone curves apply to the straight
// colour.
static int straighten(const struct prt_context *ctx, const struct prt_image *image,
                      struct prt_image *out)
{
    const size_t n = (size_t)image->width * image->height;
    *out = (struct prt_image){image->width, image->height, prt_alloc(n, 12), NULL};
    if (!out->rgb) return no_memory(ctx, image);
    for (size_t i = 0; i < 3 * n; i++)
        out->rgb[i] = image->rgb[i] / fmaxf(image->alpha[i / 3], 1e-4f);
    return PRT_OK;
}

static int encode_fine(const struct prt_context *ctx, const struct prt_image *image,
                       const struct prt_picture_options *options, struct prt_blob *out)
{
    const unsigned n_channel = image->alpha ? 4 : 3;
    struct prt_image straight = {0};
    uint16_t *pixels = prt_alloc((size_t)image->width * image->height, 2 * n_channel);
    int status = pixels ? PRT_OK : no_memory(ctx, image);
    if (!status && image->alpha) status = straighten(ctx, image, &straight);
    if (!status)
        status =
            fine_pixels(ctx, image->alpha ? &straight : image, image->alpha, options, pixels);
    if (!status)
        status = prt_encode_png16(ctx, pixels, image->width, image->height, n_channel, out);
    prt_image_finish(&straight);
    prt_free(pixels);
    return status;
}

static int encode_alpha(const struct prt_context *ctx, const struct prt_image *image,
                        const struct prt_picture_options *options, struct prt_blob *out)
{
    const size_t n = (size_t)image->width * image->height;
    struct prt_image straight = {0};
    uint8_t *rgb8 = prt_alloc(n, 3), *rgba8 = prt_alloc(n, 4);
    int status = rgb8 && rgba8 ? straighten(ctx, image, &straight) : no_memory(ctx, image);
    if (!status)
        status = prt_tone_map(ctx, &straight, options->tone, options->exposure_ev, rgb8);
    for (size_t i = 0; !status && i < n; i++) {
        memcpy(rgba8 + 4 * i, rgb8 + 3 * i, 3);
        rgba8[4 * i + 3] = (uint8_t)(255 * fminf(fmaxf(image->alpha[i], 0), 1) + 0.5f);
    }
    if (!status) status = prt_encode_png(ctx, rgba8, image->width, image->height, 4, out);
    prt_image_finish(&straight);
    prt_free(rgb8);
    prt_free(rgba8);
    return status;
}

static int png_of_rgb8(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                       uint32_t height, const struct prt_picture_options *options,
                       struct prt_blob *out)
{
    return prt_encode_png(ctx, rgb8, width, height, 3, out);
}

static int jpeg_of_rgb8(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                        uint32_t height, const struct prt_picture_options *options,
                        struct prt_blob *out)
{
    return prt_encode_jpeg(ctx, rgb8, width, height, options->quality, out);
}

// Pixels of 8 bits by a format that has them.
static int encode_8bit(const struct prt_context *ctx, const struct prt_picture_format *format,
                       const struct prt_image *image, const struct prt_picture_options *options,
                       struct prt_blob *out)
{
    const uint32_t width = image->width, height = image->height;
    uint8_t *rgb8 = prt_alloc((size_t)width * height, 3);
    if (!rgb8) return no_memory(ctx, image);
    int status = prt_tone_map(ctx, image, options->tone, options->exposure_ev, rgb8);
    if (!status) status = format->encode_rgb8(ctx, rgb8, width, height, options, out);
    prt_free(rgb8);
    return status;
}

// PNGs of 16 bits, or with alpha.
static int encode_png(const struct prt_context *ctx, const struct prt_image *image,
                      const struct prt_picture_options *options, struct prt_blob *out)
{
    return options->fine ? encode_fine(ctx, image, options, out)
                         : encode_alpha(ctx, image, options, out);
}

// A format of 8 bits alone has `encode_rgb8` and nothing else.
static const struct prt_picture_format formats[] = {
    {.ending = "exr", .linear = true, .alpha = true, .encode = encode_exr},
    {.ending = "hdr", .linear = true, .encode = encode_hdr},
    {.ending = "png", .alpha = true, .encode = encode_png, .encode_rgb8 = png_of_rgb8},
    {.ending = "jpg", .alias = "jpeg", .encode_rgb8 = jpeg_of_rgb8},
};
enum { N_FORMAT = sizeof formats / sizeof *formats };

const struct prt_picture_format *prt_picture_format(const char *name)
{
    const char *dot = strrchr(name, '.');
    for (int i = 0; dot && i < N_FORMAT; i++)
        if (!strcasecmp(dot + 1, formats[i].ending) ||
            (formats[i].alias && !strcasecmp(dot + 1, formats[i].alias)))
            return &formats[i];
    return NULL;
}

int prt_picture_encode(const struct prt_context *ctx, const struct prt_picture_format *format,
                       const struct prt_image *image, const struct prt_picture_options *options,
                       struct prt_blob *out)
{
    const bool more =
        !format->encode_rgb8 || (format->encode && (options->fine || image->alpha));
    return more ? format->encode(ctx, image, options, out)
                : encode_8bit(ctx, format, image, options, out);
}

const char *prt_picture_endings(char text[100])
{
    size_t at = 0;
    for (int i = 0; i < N_FORMAT && at < 100; i++)
        at += (size_t)snprintf(text + at, 100 - at, "%s.%s",
                               !i                  ? ""
                               : i == N_FORMAT - 1 ? " or "
                                                   : ", ",
                               formats[i].ending);
    return text;
}
