// SPDX-License-Identifier: MIT
// Writer of a mesh with one colour a vertex, as binary PLY or GLB, in the model's own units.
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Position of a vertex in the model's units, as before prt_mesh_scale.
static void position_in_model_units(const struct prt_mesh *mesh, uint32_t v, float out[3])
{
    for (int c = 0; c < 3; c++)
        out[c] = mesh->mm_per_unit > 0 ? mesh->position[v][c] / mesh->mm_per_unit
                                       : mesh->position[v][c];
}

static int write_ply(const struct prt_context *ctx, const char *path,
                     const struct prt_mesh *mesh, const float (*color)[3])
{
    char head[512];
    int n = snprintf(head, sizeof head,
                     "ply\nformat binary_little_endian 1.0\n"
                     "comment linear RGB\n"
                     "element vertex %u\n"
                     "property float x\nproperty float y\nproperty float z\n"
                     "property float nx\nproperty float ny\nproperty float nz\n"
                     "property float red\nproperty float green\nproperty float blue\n"
                     "element face %u\nproperty list uchar int vertex_indices\nend_header\n",
                     mesh->n_vertex, mesh->n_triangle);
    size_t size = (size_t)n + (size_t)mesh->n_vertex * 36 + (size_t)mesh->n_triangle * 13;
    char *bytes = prt_alloc(size, 1), *p = bytes;
    if (!bytes) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %zu bytes", path, size);
    memcpy(p, head, (size_t)n);
    p += n;
    for (uint32_t v = 0; v < mesh->n_vertex; v++, p += 36) {
        float x[3];
        position_in_model_units(mesh, v, x);
        memcpy(p, x, 12);
        memcpy(p + 12, mesh->normal[v], 12);
        memcpy(p + 24, color[v], 12);
    }
    for (uint32_t t = 0; t < mesh->n_triangle; t++, p += 13) {
        *p = 3;
        memcpy(p + 1, mesh->triangle[t], 12);
    }
    int status = prt_write_file(ctx, path, bytes, size);
    prt_free(bytes);
    return status;
}

static void write_bounds(FILE *f, const struct prt_mesh *mesh, const struct prt_block *b)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t v = b->vertex_begin; v < b->vertex_begin + b->n_vertex; v++) {
        float x[3];
        position_in_model_units(mesh, v, x);
        for (int c = 0; c < 3; c++)
            low[c] = fminf(low[c], x[c]), high[c] = fmaxf(high[c], x[c]);
    }
    fprintf(f, ",\"min\":[%.9g,%.9g,%.9g],\"max\":[%.9g,%.9g,%.9g]", low[0], low[1], low[2],
            high[0], high[1], high[2]);
}

static bool drawn(const struct prt_block *b)
{
    return b->n_vertex && b->n_triangle;
}

// One node and one mesh for each object, one primitive for each block, four bufferViews of one
// buffer.
static void write_json(FILE *f, const struct prt_mesh *mesh)
{
    size_t v = (size_t)mesh->n_vertex * 12, t = (size_t)mesh->n_triangle * 12;
    uint32_t n_node = 0;
    fprintf(f, "{\"asset\":{\"version\":\"2.0\",\"generator\":\"prt\"},\"scene\":0,"
               "\"extensionsUsed\":[\"KHR_materials_unlit\"],\"materials\":[{\"extensions\":"
               "{\"KHR_materials_unlit\":{}},\"pbrMetallicRoughness\":{\"metallicFactor\":0}}],"
               "\"meshes\":[");
    for (uint32_t i = 0, a = 0, object = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        if (!drawn(b)) continue;
        bool same = a && object == b->object;
        object = b->object;
        fputs(same ? "," : a ? "]},{\"primitives\":[" : "{\"primitives\":[", f);
        fprintf(f,
                "{\"attributes\":{\"POSITION\":%u,\"NORMAL\":%u,\"COLOR_0\":%u},"
                "\"indices\":%u,\"material\":0}",
                a, a + 1, a + 2, a + 3);
        n_node += !same;
        a += 4;
    }
    fprintf(f, "]}],\"nodes\":[");
    for (uint32_t i = 0; i < n_node; i++) fprintf(f, "%s{\"mesh\":%u}", i ? "," : "", i);
    fprintf(f, "],\"scenes\":[{\"nodes\":[");
    for (uint32_t i = 0; i < n_node; i++) fprintf(f, "%s%u", i ? "," : "", i);
    fprintf(f, "]}],\"accessors\":[");
    const char *comma = "";
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        if (!drawn(b)) continue;
        for (int k = 0; k < 3; k++) {
            fprintf(f,
                    "%s{\"bufferView\":%d,\"byteOffset\":%zu,\"componentType\":5126,"
                    "\"count\":%u,\"type\":\"VEC3\"",
                    comma, k, (size_t)b->vertex_begin * 12, b->n_vertex);
            if (k == 0) write_bounds(f, mesh, b);
            fprintf(f, "}");
            comma = ",";
        }
        fprintf(f,
                ",{\"bufferView\":3,\"byteOffset\":%zu,\"componentType\":5125,"
                "\"count\":%zu,\"type\":\"SCALAR\"}",
                (size_t)b->triangle_begin * 12, (size_t)b->n_triangle * 3);
    }
    fprintf(f, "],\"bufferViews\":[");
    for (int k = 0; k < 3; k++)
        fprintf(f,
                "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,\"byteStride\":12,"
                "\"target\":34962},",
                v * (size_t)k, v);
    fprintf(f,
            "{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu,\"target\":34963}],"
            "\"buffers\":[{\"byteLength\":%zu}]}",
            v * 3, t, v * 3 + t);
}

static void put32(char *p, uint64_t x)
{
    uint32_t w = (uint32_t)x;
    memcpy(p, &w, 4);
}

static void put_arrays(const struct prt_mesh *mesh, const float (*color)[3], char *p)
{
    size_t v = (size_t)mesh->n_vertex * 12;
    for (uint32_t i = 0; i < mesh->n_vertex; i++) {
        float x[3];
        position_in_model_units(mesh, i, x);
        memcpy(p + (size_t)i * 12, x, 12);
    }
    memcpy(p + v, mesh->normal, v);
    memcpy(p + v * 2, color, v);
    uint32_t *index = (uint32_t *)(p + v * 3);
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        for (uint32_t t = b->triangle_begin; t < b->triangle_begin + b->n_triangle; t++)
            for (int k = 0; k < 3; k++)
                index[(size_t)t * 3 + (size_t)k] = mesh->triangle[t][k] - b->vertex_begin;
    }
}

static int write_glb(const struct prt_context *ctx, const char *path,
                     const struct prt_mesh *mesh, const float (*color)[3])
{
    char *json = NULL;
    size_t json_n = 0;
    FILE *f = open_memstream(&json, &json_n);
    if (!f) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", path);
    write_json(f, mesh);
    if (fclose(f)) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", path);
    size_t padded = (json_n + 3) & ~(size_t)3;
    size_t data = (size_t)mesh->n_vertex * 36 + (size_t)mesh->n_triangle * 12;
    size_t size = 12 + 8 + padded + 8 + data;
    char *bytes = size > UINT32_MAX ? NULL : prt_alloc(size, 1);
    if (!bytes) {
        free(json);
        return prt_fail(ctx, size > UINT32_MAX ? PRT_LIMIT : PRT_NOMEM,
                        "%s: %zu bytes are too many for a GLB; write .ply", path, size);
    }
    memcpy(bytes, "glTF", 4);
    put32(bytes + 4, 2);
    put32(bytes + 8, size);
    put32(bytes + 12, padded);
    memcpy(bytes + 16, "JSON", 4);
    memset(bytes + 20, ' ', padded);
    memcpy(bytes + 20, json, json_n);
    put32(bytes + 20 + padded, data);
    memcpy(bytes + 24 + padded, "BIN", 4);
    put_arrays(mesh, color, bytes + 28 + padded);
    free(json);
    int status = prt_write_file(ctx, path, bytes, size);
    prt_free(bytes);
    return status;
}

int prt_mesh_write_colors(const struct prt_context *ctx, const char *path,
                          const struct prt_mesh *mesh, const float (*color)[3])
{
    const char *dot = strrchr(path, '.');
    if (dot && !strcasecmp(dot, ".ply")) return write_ply(ctx, path, mesh, color);
    if (dot && !strcasecmp(dot, ".glb")) return write_glb(ctx, path, mesh, color);
    return prt_fail(ctx, PRT_ARG, "%s: a mesh is written as .ply or .glb", path);
}
