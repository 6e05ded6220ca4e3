// SPDX-License-Identifier: MIT
// CSV, NPY and PLY; chooses the format by the path's ending.
#include "vertex_file.h"
#include "vertex_glb.h"

#include <string.h>
#include <strings.h>

enum prt_vertex_format prt_vertex_format_of(const char *path)
{
    static const struct {
        const char *ending;
        enum prt_vertex_format format;
    } formats[] = {
        {".csv", PRT_VERTEX_CSV},
        {".npy", PRT_VERTEX_NPY},
        {".ply", PRT_VERTEX_PLY},
        {".glb", PRT_VERTEX_GLB},
    };
    size_t n = path ? strlen(path) : 0;
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++)
        if (n > 4 && !strcasecmp(path + n - 4, formats[i].ending)) return formats[i].format;
    return PRT_VERTEX_NONE;
}

bool prt_vertex_format_has_mesh(enum prt_vertex_format format)
{
    return format == PRT_VERTEX_PLY || format == PRT_VERTEX_GLB;
}

void prt_vertex_position(const struct prt_vertex_data *data, uint32_t vertex, float out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] =
            data->unit > 0 ? data->position[vertex][c] / data->unit : data->position[vertex][c];
}

static void write_csv(FILE *f, const struct prt_vertex_data *data)
{
    fputs("vertex,r,g,b\n", f);
    for (uint32_t i = 0; i < data->n_vertex; i++)
        fprintf(f, "%u,%.9g,%.9g,%.9g\n", i, (double)data->color[i][0],
                (double)data->color[i][1], (double)data->color[i][2]);
}

// NPY 1.0: magic, version, length of the header, a Python dictionary padded with spaces so that
// the rows start at byte 128, rows.
static void write_npy(FILE *f, const struct prt_vertex_data *data)
{
    char header[119];
    int n = snprintf(header, sizeof header,
                     "{'descr': '<f4', 'fortran_order': False, 'shape': (%u, 3), }",
                     data->n_vertex);
    fwrite("\x93NUMPY\x01\x00\x76\x00", 1, 10, f);
    fprintf(f, "%s%*s\n", header, 117 - n, "");
    for (uint32_t i = 0; i < data->n_vertex; i++) {
        float row[3];
        if (data->color) memcpy(row, data->color[i], sizeof row);
        else prt_vertex_position(data, i, row);
        fwrite(row, sizeof row, 1, f);
    }
}

static void write_ply(FILE *f, const struct prt_vertex_data *data)
{
    fputs("ply\nformat binary_little_endian 1.0\n", f);
    if (data->color) fputs("comment linear RGB\n", f);
    fprintf(f, "element vertex %u\n", data->n_vertex);
    fputs("property float x\nproperty float y\nproperty float z\n", f);
    if (data->normal) fputs("property float nx\nproperty float ny\nproperty float nz\n", f);
    if (data->color)
        fputs("property float red\nproperty float green\nproperty float blue\n", f);
    fprintf(f, "element face %u\nproperty list uchar int vertex_indices\nend_header\n",
            data->n_triangle);
    for (uint32_t i = 0; i < data->n_vertex; i++) {
        float x[3];
        prt_vertex_position(data, i, x);
        fwrite(x, sizeof x, 1, f);
        if (data->normal) fwrite(data->normal[i], sizeof x, 1, f);
        if (data->color) fwrite(data->color[i], sizeof x, 1, f);
    }
    for (uint32_t i = 0; i < data->n_triangle; i++) {
        fputc(3, f);
        fwrite(data->triangle[i], sizeof data->triangle[i], 1, f);
    }
}

int prt_vertex_file_write(FILE *out, enum prt_vertex_format format,
                          const struct prt_vertex_data *data)
{
    switch (format) {
    case PRT_VERTEX_CSV:
        write_csv(out, data);
        return 0;
    case PRT_VERTEX_NPY:
        write_npy(out, data);
        return 0;
    case PRT_VERTEX_PLY:
        write_ply(out, data);
        return 0;
    case PRT_VERTEX_GLB:
        return prt_vertex_write_glb(out, data);
    case PRT_VERTEX_NONE:
        break;
    }
    return 0;
}

const char *prt_npy_parse(const void *bytes, size_t size, struct prt_npy *out)
{
    static const char *const wrong = "is not a NumPy array of shape (n, 3) in <f4 or <f8";
    const unsigned char *b = bytes;
    unsigned long long rows = 0, columns = 0;
    char header[256];
    *out = (struct prt_npy){0};
    if (size < 12 || memcmp(b, "\x93NUMPY", 6) || b[6] < 1 || b[6] > 3) return wrong;
    // Version 1 has a length of two bytes, versions 2 and 3 of four, of which three are enough.
    size_t length = b[8] | (size_t)b[9] << 8, begin = 10;
    if (b[6] > 1) {
        length |= (size_t)b[10] << 16;
        begin = 12;
    }
    if (length > size - begin) return "ends inside its header";
    snprintf(header, sizeof header, "%.*s",
             (int)(length < sizeof header ? length : sizeof header - 1),
             (const char *)b + begin);
    begin += length;
    const char *shape = strstr(header, "'shape': (");
    out->is_f64 = strstr(header, "'<f8'") != NULL;
    if (!shape || (!out->is_f64 && !strstr(header, "'<f4'")) ||
        !strstr(header, "'fortran_order': False") ||
        sscanf(shape + 10, "%llu , %llu", &rows, &columns) != 2 || columns != 3)
        return wrong;
    size_t each = out->is_f64 ? 24 : 12;
    if (rows > (size - begin) / each || rows * each != size - begin)
        return "does not have the number of bytes that its shape needs";
    out->n = rows;
    out->rows = b + begin;
    return NULL;
}

void prt_npy_rows(const struct prt_npy *npy, float (*out)[3])
{
    size_t n = (size_t)npy->n;
    if (!npy->is_f64 && n) memcpy(out, npy->rows, n * sizeof *out);
    for (size_t i = 0; npy->is_f64 && i < n; i++) {
        double row[3];
        memcpy(row, (const char *)npy->rows + i * sizeof row, sizeof row);
        for (int c = 0; c < 3; c++) out[i][c] = (float)row[c];
    }
}
