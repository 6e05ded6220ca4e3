// SPDX-License-Identifier: MIT
// Writes colours and pictures in the format of the file's ending; reads tables of colours back.
#include "tool.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static int write_table(const struct prt_context *ctx, const char *path, uint32_t n_vertex,
                       const float (*color)[3])
{
    struct prt_vertex_data data = {.n_vertex = n_vertex, .color = color};
    char *bytes = NULL;
    size_t n = 0;
    FILE *f = open_memstream(&bytes, &n);
    if (!f) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %u rows", path, n_vertex);
    int bad = prt_vertex_file_write(f, prt_vertex_format_of(path), &data) || ferror(f);
    bad |= fclose(f) != 0;
    int status = bad ? prt_fail(ctx, PRT_NOMEM, "%s: no memory for %u rows", path, n_vertex)
                     : prt_write_file(ctx, path, bytes, n);
    free(bytes);
    return status;
}

int output_colors(const struct prt_context *ctx, const char *path, const struct prt_mesh *mesh,
                  const float (*color)[3])
{
    return prt_vertex_format_has_mesh(prt_vertex_format_of(path))
               ? prt_mesh_write_colors(ctx, path, mesh, color)
               : write_table(ctx, path, mesh->n_vertex, color);
}

// Radiance RGBE, flat: a shared exponent, mantissas rounded to nearest. Mantissas below 128 on
// all three channels never occur, so no pixel can be taken for a run-length mark.
static void rgbe_encode(const float rgb[3], unsigned char out[4])
{
    float top = fmaxf(rgb[0], fmaxf(rgb[1], rgb[2]));
    int exponent = 0;
    memset(out, 0, 4);
    if (!(top > 1e-36f)) return;
    frexpf(top, &exponent);
    if (roundf(ldexpf(top, 8 - exponent)) > 255) exponent++;
    if (exponent > 127) exponent = 127;
    for (int c = 0; c < 3; c++) {
        float mantissa = roundf(ldexpf(fmaxf(rgb[c], 0), 8 - exponent));
        out[c] = (unsigned char)fminf(mantissa, 255);
    }
    out[3] = (unsigned char)(exponent + 128);
}

static int write_exr(const struct prt_context *ctx, const char *path,
                     const struct prt_image *image, const struct picture_style *style)
{
    return prt_write_exr(ctx, path, image, style->full_float, style->envmap);
}

static int write_hdr(const struct prt_context *ctx, const char *path,
                     const struct prt_image *image, const struct picture_style *style)
{
    size_t n = (size_t)image->width * image->height, used;
    unsigned char *file = prt_alloc(n + 32, 4);
    if (!file) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for the picture", path);
    used = (size_t)snprintf((char *)file, 128,
                            "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %u +X %u\n",
                            image->height, image->width);
    for (size_t i = 0; i < n; i++) rgbe_encode(image->rgb + 3 * i, file + used + 4 * i);
    int status = prt_write_file(ctx, path, file, used + 4 * n);
    prt_free(file);
    return status;
}

// Encodes tone-mapped pixels [height][width][3].
typedef int encode_rgb8(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                        uint32_t height, const struct picture_style *style,
                        struct prt_blob *out);

static int encode_png(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                      uint32_t height, const struct picture_style *style, struct prt_blob *out)
{
    return prt_encode_png(ctx, rgb8, width, height, 3, out);
}

static int encode_jpeg(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                       uint32_t height, const struct picture_style *style, struct prt_blob *out)
{
    return prt_encode_jpeg(ctx, rgb8, width, height, style->quality, out);
}

static int write_rgb8(const struct prt_context *ctx, const char *path,
                      const struct prt_image *image, const struct picture_style *style,
                      encode_rgb8 *encode)
{
    struct prt_blob blob = {0};
    uint8_t *rgb8 = prt_alloc((size_t)image->width * image->height, 3);
    if (!rgb8) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for the picture", path);
    int status = prt_tone_map(ctx, image, style->tone, (float)style->exposure_ev, rgb8);
    if (!status) status = encode(ctx, rgb8, image->width, image->height, style, &blob);
    prt_free(rgb8);
    if (!status) status = prt_write_file(ctx, path, blob.bytes, blob.size);
    prt_free(blob.bytes);
    return status;
}

// A format has `write` for linear radiance or `encode` for 8 bits.
static const struct picture_format {
    const char *ending;
    int (*write)(const struct prt_context *ctx, const char *path, const struct prt_image *image,
                 const struct picture_style *style);
    encode_rgb8 *encode;
} picture_formats[] = {
    {".exr", write_exr, NULL},   {".hdr", write_hdr, NULL},    {".png", NULL, encode_png},
    {".jpg", NULL, encode_jpeg}, {".jpeg", NULL, encode_jpeg},
};
enum { N_PICTURE_FORMAT = sizeof picture_formats / sizeof *picture_formats };

bool path_ends_in(const char *path, const char *ending)
{
    size_t n = strlen(path), m = strlen(ending);
    return n > m && !strcasecmp(path + n - m, ending);
}

static const struct picture_format *picture_format(const char *path)
{
    for (int i = 0; i < N_PICTURE_FORMAT; i++)
        if (path_ends_in(path, picture_formats[i].ending)) return &picture_formats[i];
    return NULL;
}

enum picture_range picture_range(const char *path)
{
    const struct picture_format *format = picture_format(path);
    return !format ? PICTURE_NONE : format->write ? PICTURE_LINEAR : PICTURE_8BIT;
}

int picture_path_error(const struct options *options, const char *things)
{
    char list[128] = "";
    for (int i = 0; i < N_PICTURE_FORMAT; i++) {
        size_t n = strlen(list);
        snprintf(list + n, sizeof list - n, "%s%s",
                 !i                         ? ""
                 : i + 1 < N_PICTURE_FORMAT ? ", "
                                            : " or ",
                 picture_formats[i].ending);
    }
    return usage_error(options, "-o %s: %s are written as %s", options->out, things, list);
}

int output_image(const struct prt_context *ctx, const char *path, const struct prt_image *image,
                 const struct picture_style *style)
{
    const struct picture_format *format = picture_format(path);
    return format->write ? format->write(ctx, path, image, style)
                         : write_rgb8(ctx, path, image, style, format->encode);
}

static int bad_row(const struct prt_context *ctx, const char *path, size_t row, const char *why)
{
    return prt_fail(ctx, PRT_FORMAT, "%s: line %zu: %s", path, row + 2, why);
}

static int parse_csv(const struct prt_context *ctx, const char *path, char *text, float **rgb,
                     size_t *n)
{
    static const char header[] = "vertex,r,g,b";
    size_t m = sizeof header - 1, count = 0;
    if (strncmp(text, header, m) || (text[m] != '\n' && text[m] != '\r'))
        return prt_fail(ctx, PRT_FORMAT, "%s: does not start with %s", path, header);
    char *at = strchr(text, '\n');
    at = at ? at + 1 : text + strlen(text);
    for (const char *c = at; *c; c++) count += *c == '\n';
    float *value = prt_alloc(count + 1, 3 * sizeof *value);
    if (!value) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %zu rows", path, count);
    size_t row = 0;
    int status = PRT_OK;
    for (; *at && !status; row++) {
        char *end;
        if (strtoull(at, &end, 10) != row || end == at)
            status = bad_row(ctx, path, row, "the vertex number is not the next one");
        for (int c = 0; c < 3 && !status; c++) {
            if (*end != ',') status = bad_row(ctx, path, row, "expected vertex,r,g,b");
            at = end + 1;
            if (!status) value[row * 3 + (size_t)c] = strtof(at, &end);
            if (!status && end == at) status = bad_row(ctx, path, row, "not a number");
        }
        at = end + strspn(end, "\r");
        if (!status && *at && *at++ != '\n')
            status = bad_row(ctx, path, row, "more than four columns");
    }
    if (status) {
        prt_free(value);
        return status;
    }
    *rgb = value;
    *n = row;
    return PRT_OK;
}

static int load_npy(const struct prt_context *ctx, const char *path,
                    const struct prt_blob *blob, float **rgb, size_t *n)
{
    struct prt_npy npy;
    const char *reason = prt_npy_parse(blob->bytes, blob->size, &npy);
    if (reason) return prt_fail(ctx, PRT_FORMAT, "%s: the file %s", path, reason);
    *n = (size_t)npy.n;
    *rgb = prt_alloc(*n + 1, 3 * sizeof **rgb);
    if (!*rgb) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %zu rows", path, *n);
    prt_npy_rows(&npy, (float(*)[3]) * rgb);
    return PRT_OK;
}

enum { MOST_TABLE_GB = 8 }; // when the context has no limit; chosen, not measured

int table_load(const struct prt_context *ctx, const char *path, float **rgb, size_t *n)
{
    struct prt_blob blob;
    uint64_t most = ctx->memory_limit ? ctx->memory_limit : (uint64_t)MOST_TABLE_GB << 30;
    int status = prt_read_file(ctx, path, most, &blob);
    if (status) return status;
    status = prt_vertex_format_of(path) == PRT_VERTEX_CSV
                 ? parse_csv(ctx, path, blob.bytes, rgb, n)
                 : load_npy(ctx, path, &blob, rgb, n);
    prt_free(blob.bytes);
    if (!status && !*n) {
        prt_free(*rgb);
        return prt_fail(ctx, PRT_FORMAT, "%s: no rows", path);
    }
    return status;
}
