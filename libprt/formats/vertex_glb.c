// SPDX-License-Identifier: MIT
// GLB: one node and mesh an object, one primitive a block, one buffer view an array. Vertices
// stay in the order of the input.
#include "vertex_glb.h"

#include <cjson/cJSON.h>
#include <float.h>
#include <stdlib.h>
#include <string.h>

// Numbers of the glTF 2.0 specification.
enum {
    GLTF_ARRAY_BUFFER = 34962,
    GLTF_ELEMENT_ARRAY_BUFFER = 34963,
    GLTF_FLOAT = 5126,
    GLTF_UNSIGNED_INT = 5125,
    GLTF_POINTS = 0,
    GLB_MAGIC = 0x46546c67,
    GLB_JSON = 0x4e4f534a,
    GLB_BIN = 0x004e4942,
};
enum { POSITION, NORMAL, COLOR, INDEX, N_VIEW }; // arrays of the buffer, in its order

struct glb {
    const struct prt_vertex_data *data;
    const struct prt_vertex_block *block;
    uint32_t n_block;
    int view[N_VIEW]; // index of the buffer view, -1 where there is none
    uint64_t n_byte;  // of the buffer
    cJSON *root, *views, *accessors, *meshes, *nodes, *scene_nodes;
};

static cJSON *add_item(cJSON *array)
{
    cJSON *item = cJSON_CreateObject();
    cJSON_AddItemToArray(array, item);
    return item;
}

static bool block_fits(const struct prt_vertex_data *d, const struct prt_vertex_block *b)
{
    return b->n_vertex && b->vertex_begin <= d->n_vertex &&
           b->n_vertex <= d->n_vertex - b->vertex_begin && b->triangle_begin <= d->n_triangle &&
           b->n_triangle <= d->n_triangle - b->triangle_begin;
}

static void add_views(struct glb *g)
{
    const struct prt_vertex_data *d = g->data;
    const uint64_t size[N_VIEW] = {
        12 * (uint64_t)d->n_vertex,
        d->normal ? 12 * (uint64_t)d->n_vertex : 0,
        d->color ? 12 * (uint64_t)d->n_vertex : 0,
        12 * (uint64_t)d->n_triangle,
    };
    int n = 0;
    for (int i = 0; i < N_VIEW; i++) {
        g->view[i] = size[i] ? n++ : -1;
        if (!size[i]) continue;
        cJSON *view = add_item(g->views);
        cJSON_AddNumberToObject(view, "buffer", 0);
        cJSON_AddNumberToObject(view, "byteOffset", (double)g->n_byte);
        cJSON_AddNumberToObject(view, "byteLength", (double)size[i]);
        if (i != INDEX) cJSON_AddNumberToObject(view, "byteStride", 12);
        cJSON_AddNumberToObject(view, "target",
                                i == INDEX ? GLTF_ELEMENT_ARRAY_BUFFER : GLTF_ARRAY_BUFFER);
        g->n_byte += size[i];
    }
}

static cJSON *add_accessor(struct glb *g, int view, uint32_t first, uint64_t count)
{
    bool index = view == INDEX;
    cJSON *a = add_item(g->accessors);
    cJSON_AddNumberToObject(a, "bufferView", g->view[view]);
    cJSON_AddNumberToObject(a, "byteOffset", 12 * (double)first);
    cJSON_AddNumberToObject(a, "componentType", index ? GLTF_UNSIGNED_INT : GLTF_FLOAT);
    cJSON_AddNumberToObject(a, "count", (double)count);
    cJSON_AddStringToObject(a, "type", index ? "SCALAR" : "VEC3");
    return a;
}

static void add_vector(cJSON *object, const char *key, const float x[3])
{
    char text[80];
    snprintf(text, sizeof text, "[%.9g,%.9g,%.9g]", (double)x[0], (double)x[1], (double)x[2]);
    cJSON_AddRawToObject(object, key, text);
}

// glTF requires the bounds of positions.
static void add_bounds(cJSON *accessor, const struct prt_vertex_data *d,
                       const struct prt_vertex_block *b)
{
    float low[3] = {FLT_MAX, FLT_MAX, FLT_MAX}, high[3] = {-FLT_MAX, -FLT_MAX, -FLT_MAX};
    for (uint32_t v = b->vertex_begin; v < b->vertex_begin + b->n_vertex; v++) {
        float x[3];
        prt_vertex_position(d, v, x);
        for (int c = 0; c < 3; c++) {
            if (x[c] < low[c]) low[c] = x[c];
            if (x[c] > high[c]) high[c] = x[c];
        }
    }
    add_vector(accessor, "min", low);
    add_vector(accessor, "max", high);
}

static void add_primitive(struct glb *g, cJSON *primitives, const struct prt_vertex_block *b)
{
    static const char *const name[] = {"POSITION", "NORMAL", "COLOR_0"};
    cJSON *primitive = add_item(primitives);
    cJSON *attributes = cJSON_AddObjectToObject(primitive, "attributes");
    for (int i = POSITION; i <= COLOR; i++) {
        if (g->view[i] < 0) continue;
        cJSON_AddNumberToObject(attributes, name[i], cJSON_GetArraySize(g->accessors));
        cJSON *a = add_accessor(g, i, b->vertex_begin, b->n_vertex);
        if (i == POSITION) add_bounds(a, g->data, b);
    }
    if (b->n_triangle) {
        cJSON_AddNumberToObject(primitive, "indices", cJSON_GetArraySize(g->accessors));
        add_accessor(g, INDEX, b->triangle_begin, 3 * (uint64_t)b->n_triangle);
    } else {
        cJSON_AddNumberToObject(primitive, "mode", GLTF_POINTS);
    }
    cJSON_AddNumberToObject(primitive, "material", 0);
}

static void add_objects(struct glb *g)
{
    cJSON *primitives = NULL;
    uint32_t object = 0;
    for (uint32_t i = 0; i < g->n_block; i++) {
        const struct prt_vertex_block *b = g->block + i;
        if (!block_fits(g->data, b)) continue;
        if (!primitives || b->object != object) {
            int mesh = cJSON_GetArraySize(g->meshes);
            primitives = cJSON_AddArrayToObject(add_item(g->meshes), "primitives");
            cJSON_AddNumberToObject(add_item(g->nodes), "mesh", mesh);
            cJSON_AddItemToArray(g->scene_nodes, cJSON_CreateNumber(mesh));
            object = b->object;
        }
        add_primitive(g, primitives, b);
    }
}

// Colours are radiance: the material is unlit, so that a viewer does not shade them again.
static void add_material(cJSON *root)
{
    cJSON *used = cJSON_AddArrayToObject(root, "extensionsUsed");
    cJSON_AddItemToArray(used, cJSON_CreateString("KHR_materials_unlit"));
    cJSON *material = add_item(cJSON_AddArrayToObject(root, "materials"));
    cJSON *extensions = cJSON_AddObjectToObject(material, "extensions");
    cJSON_AddObjectToObject(extensions, "KHR_materials_unlit");
    cJSON *metallic = cJSON_AddObjectToObject(material, "pbrMetallicRoughness");
    cJSON_AddNumberToObject(metallic, "metallicFactor", 0);
    cJSON_AddTrueToObject(material, "doubleSided");
}

// Owned by the caller; NULL without memory.
static char *make_json(struct glb *g)
{
    g->root = cJSON_CreateObject();
    cJSON *asset = cJSON_AddObjectToObject(g->root, "asset");
    cJSON_AddStringToObject(asset, "version", "2.0");
    cJSON_AddStringToObject(asset, "generator", g->data->generator ? g->data->generator : "");
    cJSON_AddNumberToObject(g->root, "scene", 0);
    add_material(g->root);
    g->meshes = cJSON_AddArrayToObject(g->root, "meshes");
    g->nodes = cJSON_AddArrayToObject(g->root, "nodes");
    cJSON *scene = add_item(cJSON_AddArrayToObject(g->root, "scenes"));
    g->scene_nodes = cJSON_AddArrayToObject(scene, "nodes");
    g->accessors = cJSON_AddArrayToObject(g->root, "accessors");
    g->views = cJSON_AddArrayToObject(g->root, "bufferViews");
    add_views(g);
    add_objects(g);
    cJSON *buffer = add_item(cJSON_AddArrayToObject(g->root, "buffers"));
    cJSON_AddNumberToObject(buffer, "byteLength", (double)g->n_byte);
    char *text = cJSON_PrintUnformatted(g->root);
    cJSON_Delete(g->root);
    return text;
}

static void write_u32(FILE *f, uint32_t x)
{
    fwrite(&x, sizeof x, 1, f);
}

// Indices of a primitive count from its first vertex.
static int write_indices(FILE *f, const struct glb *g)
{
    const struct prt_vertex_data *d = g->data;
    uint32_t(*index)[3] = malloc(((size_t)d->n_triangle + 1) * sizeof *index);
    if (!index) return PRT_VERTEX_NO_MEMORY;
    if (d->n_triangle) memcpy(index, d->triangle, d->n_triangle * sizeof *index);
    for (uint32_t k = 0; k < g->n_block; k++) {
        const struct prt_vertex_block *b = g->block + k;
        if (!block_fits(d, b)) continue;
        for (uint32_t t = b->triangle_begin; t < b->triangle_begin + b->n_triangle; t++)
            for (int c = 0; c < 3; c++) index[t][c] -= b->vertex_begin;
    }
    fwrite(index, sizeof *index, d->n_triangle, f);
    free(index);
    return 0;
}

int prt_vertex_write_glb(FILE *out, const struct prt_vertex_data *d)
{
    struct prt_vertex_block whole = {.n_vertex = d->n_vertex, .n_triangle = d->n_triangle};
    struct glb g = {.data = d,
                    .block = d->n_block ? d->block : &whole,
                    .n_block = d->n_block ? d->n_block : 1};
    char *json = make_json(&g);
    if (!json) return PRT_VERTEX_NO_MEMORY;
    size_t n = strlen(json), padded = (n + 3) / 4 * 4;
    uint64_t total = 28 + padded + g.n_byte; // header, two chunk headers, chunks
    if (total > UINT32_MAX) {
        free(json);
        return PRT_VERTEX_TOO_LARGE;
    }
    write_u32(out, GLB_MAGIC);
    write_u32(out, 2);
    write_u32(out, (uint32_t)total);
    write_u32(out, (uint32_t)padded);
    write_u32(out, GLB_JSON);
    fwrite(json, 1, n, out);
    fwrite("   ", 1, padded - n, out);
    free(json);
    write_u32(out, (uint32_t)g.n_byte);
    write_u32(out, GLB_BIN);
    for (uint32_t i = 0; i < d->n_vertex; i++) {
        float x[3];
        prt_vertex_position(d, i, x);
        fwrite(x, sizeof x, 1, out);
    }
    if (d->normal) fwrite(d->normal, 12, d->n_vertex, out);
    if (d->color) fwrite(d->color, 12, d->n_vertex, out);
    return write_indices(out, &g);
}
