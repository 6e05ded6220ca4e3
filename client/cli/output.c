// SPDX-License-Identifier: MIT
// Files: CSV, NPY, PLY, GLB of vertices; every file is whole or not there.
#include "cli.h"

#include <errno.h>
#include <fcntl.h>
#include <float.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static int file_error(const struct options *options, const char *path, const char *text)
{
    struct relight_error error = {.code = RELIGHT_E_FILE};
    snprintf(error.text, sizeof error.text, "%s: %s", path, text);
    return report_error(options, &error);
}

static int write_all(int fd, const char *bytes, size_t n)
{
    while (n) {
        ssize_t put = write(fd, bytes, n < (1u << 30) ? n : (1u << 30));
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return -1;
        bytes += put;
        n -= (size_t)put;
    }
    return 0;
}

int write_file(const struct options *options, const char *path, const void *bytes, size_t n)
{
    char temp[4096];
    struct stat st;
    // Devices and pipes (/dev/stdout) are written in place: there is nothing to rename.
    bool special = stat(path, &st) == 0 && !S_ISREG(st.st_mode);
    if (snprintf(temp, sizeof temp, "%s.tmp-%ld", path, (long)getpid()) >= (int)sizeof temp)
        return file_error(options, path, "the path is too long");
    int fd = special ? open(path, O_WRONLY | O_CLOEXEC)
                     : open(temp, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) return file_error(options, path, strerror(errno));
    bool bad = write_all(fd, bytes, n) || (!special && fsync(fd));
    int fault = errno;
    if (close(fd) && !bad) {
        bad = true;
        fault = errno;
    }
    if (!bad && !special && rename(temp, path)) {
        bad = true;
        fault = errno;
    }
    if (bad && !special) unlink(temp);
    return bad ? file_error(options, path, strerror(fault)) : EXIT_DONE;
}

bool picture_format(const char *path, enum relight_image_format *format)
{
    static const struct {
        const char *suffix;
        enum relight_image_format format;
    } formats[] = {
#define X(name, number, suffix) {suffix, RELIGHT_IMAGE_##name},
        RELIGHT_IMAGE_FORMAT_LIST(X)
#undef X
            {"jpeg", RELIGHT_IMAGE_JPEG}};
    const char *dot = path ? strrchr(path, '.') : NULL;
    for (unsigned i = 0; dot && dot[1] && i < sizeof formats / sizeof *formats; i++)
        if (!strcasecmp(dot + 1, formats[i].suffix)) {
            *format = formats[i].format;
            return true;
        }
    return false;
}

const char *picture_suffixes(char text[100])
{
    static const char *const suffix[] = {
#define X(name, number, suffix) suffix,
        RELIGHT_IMAGE_FORMAT_LIST(X)
#undef X
    };
    size_t at = 0;
    for (unsigned i = 0; at < 100 && i < sizeof suffix / sizeof *suffix; i++)
        if (suffix[i][0])
            at += (size_t)snprintf(text + at, 100 - at, "%s.%s", at ? ", " : "", suffix[i]);
    return text;
}

enum output_kind output_kind(const char *path)
{
    enum relight_image_format format;
    static const struct {
        const char *suffix;
        enum output_kind kind;
    } kinds[] = {
        {"csv", OUTPUT_CSV}, {"npy", OUTPUT_NPY}, {"ply", OUTPUT_PLY}, {"glb", OUTPUT_GLB}};
    const char *dot = path ? strrchr(path, '.') : NULL;
    for (unsigned i = 0; dot && i < sizeof kinds / sizeof *kinds; i++)
        if (!strcasecmp(dot + 1, kinds[i].suffix)) return kinds[i].kind;
    return picture_format(path, &format) ? OUTPUT_PICTURE : OUTPUT_UNKNOWN;
}

static void write_csv(FILE *f, uint32_t n, const float *rgb)
{
    fputs("vertex,r,g,b\n", f);
    for (uint32_t i = 0; i < n; i++, rgb += 3)
        fprintf(f, "%u,%.9g,%.9g,%.9g\n", i, rgb[0], rgb[1], rgb[2]);
}

// NumPy 1.0 file: the header's length makes the data start at a multiple of 64.
static void write_npy(FILE *f, uint32_t n, const float *rows)
{
    char head[118], dict[118];
    int size = snprintf(dict, sizeof dict,
                        "{'descr': '<f4', 'fortran_order': False, 'shape': (%u, 3), }", n);
    memset(head, ' ', sizeof head);
    memcpy(head, dict, (size_t)size);
    head[sizeof head - 1] = '\n';
    fwrite("\x93NUMPY\x01\x00\x76\x00", 1, 10, f);
    fwrite(head, 1, sizeof head, f);
    fwrite(rows, 12, n, f);
}

static void write_ply(FILE *f, const float *rgb, const struct relight_geometry *g)
{
    fprintf(f, "ply\nformat binary_little_endian 1.0\nelement vertex %u\n", g->n_vertex);
    fputs("property float x\nproperty float y\nproperty float z\n", f);
    if (g->normal) fputs("property float nx\nproperty float ny\nproperty float nz\n", f);
    if (rgb) fputs("property float red\nproperty float green\nproperty float blue\n", f);
    fprintf(f, "element face %u\nproperty list uchar uint vertex_indices\nend_header\n",
            g->n_triangle);
    for (uint32_t i = 0; i < g->n_vertex; i++) {
        fwrite(g->position[i], 12, 1, f);
        if (g->normal) fwrite(g->normal[i], 12, 1, f);
        if (rgb) fwrite(rgb + 3 * (size_t)i, 12, 1, f);
    }
    for (uint32_t i = 0; i < g->n_triangle; i++) {
        fputc(3, f);
        fwrite(g->triangle[i], 12, 1, f);
    }
}

// ---- GLB
// -----------------------------------------------------------------------------------------

static cJSON *add_item(cJSON *array)
{
    cJSON *item = cJSON_CreateObject();
    cJSON_AddItemToArray(array, item);
    return item;
}

static int add_view(cJSON *views, size_t offset, size_t size, int target)
{
    cJSON *view = add_item(views);
    cJSON_AddNumberToObject(view, "buffer", 0);
    cJSON_AddNumberToObject(view, "byteOffset", (double)offset);
    cJSON_AddNumberToObject(view, "byteLength", (double)size);
    cJSON_AddNumberToObject(view, "target", target);
    return cJSON_GetArraySize(views) - 1;
}

static cJSON *add_accessor(cJSON *accessors, int view, size_t offset, int component,
                           uint32_t count, const char *type)
{
    cJSON *a = add_item(accessors);
    cJSON_AddNumberToObject(a, "bufferView", view);
    cJSON_AddNumberToObject(a, "byteOffset", (double)offset);
    cJSON_AddNumberToObject(a, "componentType", component);
    cJSON_AddNumberToObject(a, "count", count);
    cJSON_AddStringToObject(a, "type", type);
    return a;
}

static void add_bounds(cJSON *accessor, const float (*p)[3], uint32_t n)
{
    float low[3] = {FLT_MAX, FLT_MAX, FLT_MAX}, high[3] = {-FLT_MAX, -FLT_MAX, -FLT_MAX};
    for (uint32_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++) {
            if (p[i][c] < low[c]) low[c] = p[i][c];
            if (p[i][c] > high[c]) high[c] = p[i][c];
        }
    }
    cJSON_AddItemToObject(accessor, "min", cJSON_CreateFloatArray(low, 3));
    cJSON_AddItemToObject(accessor, "max", cJSON_CreateFloatArray(high, 3));
}

// One primitive a block, so that vertices stay in the order of the model's file.
static void add_primitive(cJSON *primitives, cJSON *accessors, const struct relight_geometry *g,
                          const struct relight_block *b, const int view[4])
{
    enum { FLOAT = 5126, UINT = 5125 };
    cJSON *primitive = add_item(primitives),
          *map = cJSON_AddObjectToObject(primitive, "attributes");
    size_t at = 12 * (size_t)b->vertex_begin;
    const char *name[3] = {"POSITION", "NORMAL", "COLOR_0"};
    for (int i = 0; i < 3; i++) {
        if (view[i] < 0) continue;
        cJSON *a = add_accessor(accessors, view[i], at, FLOAT, b->n_vertex, "VEC3");
        if (i == 0) add_bounds(a, g->position + b->vertex_begin, b->n_vertex);
        cJSON_AddNumberToObject(map, name[i], cJSON_GetArraySize(accessors) - 1);
    }
    if (view[3] >= 0 && b->n_triangle) {
        add_accessor(accessors, view[3], 12 * (size_t)b->triangle_begin, UINT,
                     3 * b->n_triangle, "SCALAR");
        cJSON_AddNumberToObject(primitive, "indices", cJSON_GetArraySize(accessors) - 1);
    }
    cJSON_AddNumberToObject(primitive, "material", 0);
}

static bool block_fits(const struct relight_geometry *g, const struct relight_block *b)
{
    return b->n_vertex && b->vertex_begin <= g->n_vertex &&
           b->n_vertex <= g->n_vertex - b->vertex_begin && b->triangle_begin <= g->n_triangle &&
           b->n_triangle <= g->n_triangle - b->triangle_begin;
}

static void write_u32(FILE *f, uint32_t x)
{
    fwrite(&x, 4, 1, f);
}

static int write_indices(FILE *f, const struct relight_geometry *g,
                         const struct relight_block *block, size_t n_block)
{
    uint32_t *index = malloc(12 * ((size_t)g->n_triangle + 1));
    if (!index) return -1;
    if (g->n_triangle) memcpy(index, g->triangle, 12 * (size_t)g->n_triangle);
    for (size_t k = 0; k < n_block; k++) {
        if (!block_fits(g, block + k)) continue;
        uint32_t *at = index + 3 * (size_t)block[k].triangle_begin;
        for (size_t i = 0; i < 3 * (size_t)block[k].n_triangle; i++)
            at[i] -= block[k].vertex_begin;
    }
    fwrite(index, 12, g->n_triangle, f);
    free(index);
    return 0;
}

static char *glb_json(const struct relight_geometry *g, bool colored,
                      const struct relight_block *block, size_t n_block)
{
    enum { VERTICES = 34962, INDICES = 34963 };
    size_t rows = 12 * (size_t)g->n_vertex, at = 0;
    cJSON *root = cJSON_CreateObject(), *asset = cJSON_AddObjectToObject(root, "asset");
    cJSON_AddStringToObject(asset, "version", "2.0");
    cJSON_AddStringToObject(asset, "generator", "relight " RELIGHT_VERSION);
    cJSON *used = cJSON_AddArrayToObject(root, "extensionsUsed");
    cJSON_AddItemToArray(used, cJSON_CreateString("KHR_materials_unlit"));
    cJSON *views = cJSON_AddArrayToObject(root, "bufferViews");
    int view[4] = {-1, -1, -1, -1};
    bool have[3] = {true, g->normal != NULL, colored};
    for (int i = 0; i < 3; i++) {
        if (!have[i]) continue;
        view[i] = add_view(views, at, rows, VERTICES);
        cJSON_AddNumberToObject(cJSON_GetArrayItem(views, view[i]), "byteStride", 12);
        at += rows;
    }
    if (g->n_triangle) {
        view[3] = add_view(views, at, 12 * (size_t)g->n_triangle, INDICES);
        at += 12 * (size_t)g->n_triangle;
    }
    cJSON *buffer = add_item(cJSON_AddArrayToObject(root, "buffers"));
    cJSON_AddNumberToObject(buffer, "byteLength", (double)at);
    cJSON *accessors = cJSON_AddArrayToObject(root, "accessors");
    cJSON *mesh = add_item(cJSON_AddArrayToObject(root, "meshes"));
    cJSON *primitives = cJSON_AddArrayToObject(mesh, "primitives");
    for (size_t i = 0; i < n_block; i++)
        if (block_fits(g, block + i)) add_primitive(primitives, accessors, g, block + i, view);
    // Colours are radiance already: nothing shades them again.
    cJSON *material = add_item(cJSON_AddArrayToObject(root, "materials"));
    cJSON *extensions = cJSON_AddObjectToObject(material, "extensions");
    cJSON_AddObjectToObject(extensions, "KHR_materials_unlit");
    cJSON_AddTrueToObject(material, "doubleSided");
    cJSON_AddNumberToObject(add_item(cJSON_AddArrayToObject(root, "nodes")), "mesh", 0);
    int zero = 0;
    cJSON *scene = add_item(cJSON_AddArrayToObject(root, "scenes"));
    cJSON_AddItemToObject(scene, "nodes", cJSON_CreateIntArray(&zero, 1));
    cJSON_AddNumberToObject(root, "scene", 0);
    char *text = cJSON_PrintUnformatted(root);
    cJSON_Delete(root);
    return text;
}

static int write_glb(FILE *f, const float *rgb, const struct relight_geometry *g)
{
    struct relight_block whole = {.n_vertex = g->n_vertex, .n_triangle = g->n_triangle};
    const struct relight_block *block = g->n_block ? g->block : &whole;
    size_t n_block = g->n_block ? g->n_block : 1;
    char *json = glb_json(g, rgb != NULL, block, n_block);
    if (!json) return -1;
    size_t size = strlen(json), padded = (size + 3) / 4 * 4;
    uint64_t rows = 12 * (uint64_t)g->n_vertex;
    uint64_t bin =
        rows * (1 + (g->normal != NULL) + (rgb != NULL)) + 12 * (uint64_t)g->n_triangle;
    if (bin + padded + 28 > UINT32_MAX) {
        free(json);
        return -2;
    }
    write_u32(f, 0x46546c67);
    write_u32(f, 2);
    write_u32(f, (uint32_t)(28 + padded + bin));
    write_u32(f, (uint32_t)padded);
    write_u32(f, 0x4e4f534a);
    fwrite(json, 1, size, f);
    fwrite("   ", 1, padded - size, f);
    free(json);
    write_u32(f, (uint32_t)bin);
    write_u32(f, 0x004e4942);
    fwrite(g->position, 12, g->n_vertex, f);
    if (g->normal) fwrite(g->normal, 12, g->n_vertex, f);
    if (rgb) fwrite(rgb, 12, g->n_vertex, f);
    return write_indices(f, g, block, n_block);
}

int write_vertices(const struct options *options, const char *path, uint32_t n,
                   const float *rgb, const struct relight_geometry *geometry)
{
    char *bytes = NULL;
    size_t size = 0;
    FILE *f = open_memstream(&bytes, &size);
    if (!f) return file_error(options, path, "not enough memory");
    int bad = 0;
    switch (output_kind(path)) {
    case OUTPUT_CSV:
        write_csv(f, n, rgb);
        break;
    case OUTPUT_NPY:
        write_npy(f, n, rgb ? rgb : geometry->position[0]);
        break;
    case OUTPUT_PLY:
        write_ply(f, rgb, geometry);
        break;
    default:
        bad = write_glb(f, rgb, geometry);
        break;
    }
    bool failed = ferror(f) != 0;
    failed |= fclose(f) != 0;
    int status = bad == -2 ? file_error(options, path, "more than 4 GiB do not fit a .glb")
                 : bad || failed ? file_error(options, path, "not enough memory")
                                 : write_file(options, path, bytes, size);
    free(bytes);
    return status;
}

// The header of a .npy is a Python literal; what geometry -o writes and numpy.save of a
// C-ordered float32 array reads: {'descr': '<f4', 'fortran_order': False, 'shape': (n, 3), }.
static bool npy_rows(const char *header, uint32_t *n)
{
    const char *shape = strstr(header, "'shape':");
    unsigned long long rows = 0, columns = 0;
    if (!strstr(header, "'<f4'") || !strstr(header, "'fortran_order': False") || !shape ||
        sscanf(shape, "'shape': (%llu, %llu", &rows, &columns) != 2 || columns != 3 ||
        rows > UINT32_MAX)
        return false;
    *n = (uint32_t)rows;
    return true;
}

int read_npy(const struct options *options, const char *path, uint32_t *n, float **out)
{
    unsigned char head[10];
    char header[4096];
    FILE *f = fopen(path, "rbe");
    if (!f) return file_error(options, path, strerror(errno));
    bool good = fread(head, 1, 10, f) == 10 && !memcmp(head, "\x93NUMPY\x01", 7);
    size_t size = good ? head[8] | (size_t)head[9] << 8 : 0;
    good = good && size < sizeof header && fread(header, 1, size, f) == size;
    header[good ? size : 0] = 0;
    if (!good || !npy_rows(header, n)) {
        fclose(f);
        return file_error(options, path, "is not a .npy of f32 [n][3]");
    }
    *out = malloc(((size_t)*n + 1) * 12);
    good = *out && fread(*out, 12, *n, f) == *n;
    fclose(f);
    if (good) return EXIT_DONE;
    const char *why = *out ? "is cut short" : "not enough memory";
    free(*out);
    *out = NULL;
    return file_error(options, path, why);
}
