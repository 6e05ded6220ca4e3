// SPDX-License-Identifier: MIT
// Results as files: colours as CSV, NumPy, PLY or GLB; pictures in the formats of
// prt/picture.h. Reads CSV and NumPy back for comparisons.
#include "tool.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum output_kind output_kind(const char *path)
{
    static const struct {
        const char *ending;
        enum output_kind kind;
    } endings[] = {{".csv", OUT_CSV}, {".npy", OUT_NPY}, {".ply", OUT_PLY}, {".glb", OUT_GLB}};
    size_t n = strlen(path);
    for (size_t i = 0; i < sizeof endings / sizeof *endings; i++) {
        size_t m = strlen(endings[i].ending);
        if (n > m && !strcasecmp(path + n - m, endings[i].ending)) return endings[i].kind;
    }
    return prt_picture_format(path) ? OUT_PICTURE : OUT_NONE;
}

static int write_csv(const struct prt_context *ctx, const char *path, uint32_t n,
                     const float (*color)[3])
{
    // Three %.9g need at most 16 characters each, the index 10, separators 4.
    size_t room = (size_t)n * 64 + 32, used;
    char *text = prt_alloc(room, 1);
    if (!text) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %u rows", path, n);
    used = (size_t)snprintf(text, room, "vertex,r,g,b\n");
    for (uint32_t i = 0; i < n; i++)
        used += (size_t)snprintf(text + used, room - used, "%u,%.9g,%.9g,%.9g\n", i,
                                 (double)color[i][0], (double)color[i][1], (double)color[i][2]);
    int status = prt_write_file(ctx, path, text, used);
    prt_free(text);
    return status;
}

// NPY 1.0: magic, version, header length, a Python dictionary padded to 64 bytes, raw rows.
static int write_npy(const struct prt_context *ctx, const char *path, uint32_t n,
                     const float (*color)[3])
{
    size_t bytes = (size_t)n * 12;
    unsigned char *file = prt_alloc(128 + bytes, 1);
    if (!file) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %u rows", path, n);
    memcpy(file, "\x93NUMPY\x01\x00\x76\x00", 10);
    memset(file + 10, ' ', 118);
    char header[118];
    int m = snprintf(header, sizeof header,
                     "{'descr': '<f4', 'fortran_order': False, 'shape': (%u, 3), }", n);
    memcpy(file + 10, header, (size_t)m);
    file[127] = '\n';
    memcpy(file + 128, color, bytes);
    int status = prt_write_file(ctx, path, file, 128 + bytes);
    prt_free(file);
    return status;
}

int output_colors(const struct prt_context *ctx, const char *path, const struct prt_mesh *mesh,
                  const float (*color)[3])
{
    switch (output_kind(path)) {
    case OUT_CSV:
        return write_csv(ctx, path, mesh->n_vertex, color);
    case OUT_NPY:
        return write_npy(ctx, path, mesh->n_vertex, color);
    case OUT_PLY:
    case OUT_GLB:
        return prt_mesh_write_colors(ctx, path, mesh, color);
    default:
        return prt_fail(ctx, PRT_ARG, "%s: colours are written as .csv, .npy, .ply or .glb",
                        path);
    }
}

int output_image(const struct prt_context *ctx, const char *path, const struct prt_image *image,
                 const struct prt_picture_options *options)
{
    const struct prt_picture_format *format = prt_picture_format(path);
    struct prt_blob blob = {0};
    char endings[100];
    if (!format)
        return prt_fail(ctx, PRT_ARG, "%s: pictures are written as %s", path,
                        prt_picture_endings(endings));
    int status = format->encode(ctx, image, options, &blob);
    if (!status) status = prt_write_file(ctx, path, blob.bytes, blob.size);
    prt_free(blob.bytes);
    return status;
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

// Little-endian float32 or float64 rows of three, C order: what NumPy writes of such an array.
static int parse_npy(const struct prt_context *ctx, const char *path, const unsigned char *file,
                     size_t size, float **rgb, size_t *n)
{
    unsigned long long rows = 0, columns = 0;
    size_t begin = 0;
    char header[256] = "";
    bool ok = size > 12 && !memcmp(file, "\x93NUMPY", 6) && file[6] >= 1 && file[6] <= 3;
    if (ok) {
        size_t length = file[6] == 1 ? file[8] | (size_t)file[9] << 8
                                     : file[8] | (size_t)file[9] << 8 | (size_t)file[10] << 16;
        size_t at = file[6] == 1 ? 10 : 12;
        begin = at + length;
        ok = begin <= size;
        if (ok)
            snprintf(header, sizeof header, "%.*s", (int)(length < 255 ? length : 255),
                     (const char *)file + at);
    }
    const char *shape = strstr(header, "'shape': (");
    bool f8 = strstr(header, "'<f8'") != NULL, f4 = strstr(header, "'<f4'") != NULL;
    ok = ok && shape && (f4 || f8) && strstr(header, "'fortran_order': False") &&
         sscanf(shape + 10, "%llu , %llu", &rows, &columns) == 2 && columns == 3;
    if (!ok)
        return prt_fail(ctx, PRT_FORMAT, "%s: not a NumPy array of shape (n, 3) in <f4 or <f8",
                        path);
    size_t each = f8 ? 24 : 12;
    if (rows > (size - begin) / each || rows * each != size - begin)
        return prt_fail(ctx, PRT_FORMAT, "%s: %zu bytes of data do not make %llu rows", path,
                        size - begin, rows);
    float *value = prt_alloc((size_t)rows + 1, 3 * sizeof *value);
    if (!value) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %llu rows", path, rows);
    if (f4) memcpy(value, file + begin, (size_t)rows * 12);
    else
        for (size_t i = 0; i < (size_t)rows * 3; i++) {
            double x;
            memcpy(&x, file + begin + 8 * i, 8);
            value[i] = (float)x;
        }
    *rgb = value;
    *n = (size_t)rows;
    return PRT_OK;
}

int table_load(const struct prt_context *ctx, const char *path, float **rgb, size_t *n)
{
    struct prt_blob blob;
    int status =
        prt_read_file(ctx, path, ctx->memory_limit ? ctx->memory_limit : 8ull << 30, &blob);
    if (status) return status;
    status = output_kind(path) == OUT_CSV ? parse_csv(ctx, path, blob.bytes, rgb, n)
                                          : parse_npy(ctx, path, blob.bytes, blob.size, rgb, n);
    prt_free(blob.bytes);
    if (!status && !*n) {
        prt_free(*rgb);
        return prt_fail(ctx, PRT_FORMAT, "%s: no rows", path);
    }
    return status;
}
