// SPDX-License-Identifier: MIT
// Writes colours and pictures in the format of the file's ending; reads tables of colours back.
#include "tool.h"

#include "terminal.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

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

int picture_path_error(const struct options *options, const char *things)
{
    char endings[100];
    return usage_error(options, "-o %s: %s are written as %s", options->out, things,
                       prt_picture_endings(endings));
}

bool is_terminal_path(const char *path)
{
    return path && !strcmp(path, "-");
}

static int draw_in_terminal(const struct prt_context *ctx, const struct prt_image *image,
                            const struct prt_picture_options *options)
{
    struct prt_terminal terminal;
    uint8_t *rgb = prt_alloc((size_t)image->width * image->height, 3);
    if (!rgb) return prt_fail(ctx, PRT_NOMEM, "no memory for a picture in the terminal");
    prt_terminal_detect(STDOUT_FILENO, &terminal);
    int status = prt_tone_map(ctx, image, options->tone, options->exposure_ev, rgb);
    if (!status && prt_terminal_draw(stdout, &terminal, image->width, image->height, rgb))
        status = prt_fail(ctx, PRT_IO, "the picture could not be written to standard output");
    prt_free(rgb);
    return status;
}

int output_image(const struct prt_context *ctx, const char *path, const struct prt_image *image,
                 const struct prt_picture_options *options)
{
    if (is_terminal_path(path)) return draw_in_terminal(ctx, image, options);
    struct prt_blob blob = {0};
    int status = prt_picture_encode(ctx, prt_picture_format(path), image, options, &blob);
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
