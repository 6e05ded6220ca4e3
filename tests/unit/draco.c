// SPDX-License-Identifier: MIT
// Draco compression changes no attribute: one mesh is written plain and compressed without
// loss, by libdraco's own encoder, and both files give the same vertices, triangles and uv
// sets.
#include "draco_file.h"
#include "prt/mesh.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 5, N_VERTEX = SIDE * SIDE, N_TRIANGLE = 2 * (SIDE - 1) * (SIDE - 1), N_UV = 3 };

// A bent grid with values of its own in every attribute.
struct grid {
    float position[N_VERTEX][3], normal[N_VERTEX][3], color[N_VERTEX][4];
    float uv[N_UV][N_VERTEX][2];
    uint32_t triangle[N_TRIANGLE][3];
};

static bool with_material = true; // that names the third uv set

static void fill(struct grid *g)
{
    uint32_t t = 0;
    for (uint32_t v = 0; v < N_VERTEX; v++) {
        const uint32_t x = v % SIDE, y = v / SIDE;
        const float at[3] = {(float)x, (float)y, 0.125f * (float)(x * y)};
        const float up[3] = {(float)(v % 3) * 0.25f, 0, 1};
        memcpy(g->position[v], at, sizeof at);
        memcpy(g->normal[v], up, sizeof up);
        for (int c = 0; c < 4; c++)
            g->color[v][c] = (float)((v * 7 + (uint32_t)c * 5) % 32) / 32;
        for (int k = 0; k < N_UV; k++) {
            g->uv[k][v][0] = (float)x / (4 << k) + (float)k;
            g->uv[k][v][1] = (float)y / (4 << k) - (float)k;
        }
        if (x + 1 == SIDE || y + 1 == SIDE) continue;
        const uint32_t two[2][3] = {{v, v + 1, v + SIDE}, {v + 1, v + SIDE + 1, v + SIDE}};
        memcpy(g->triangle[t], two, sizeof two);
        t += 2;
    }
}

// A GLB of one primitive: its attributes and what else it has, and the buffer.
static struct prt_mesh *load(const char *accessors, const char *primitive, const void *bin,
                             size_t n_bin)
{
    static char json[4096], file[32768];
    snprintf(
        json, sizeof json,
        "{\"asset\":{\"version\":\"2.0\"},\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":"
        "0}],\"textures\":[{\"source\":0}],\"images\":[{\"uri\":\"none.png\"}],"
        "%s"
        "\"buffers\":[{\"byteLength\":%zu}],%s,"
        "\"meshes\":[{\"primitives\":[{%s\"indices\":0,\"attributes\":{"
        "\"POSITION\":1,\"NORMAL\":2,\"COLOR_0\":3,\"TEXCOORD_0\":4,\"TEXCOORD_1\":5,"
        "\"TEXCOORD_2\":6}%s}]}]}",
        with_material ? "\"materials\":[{\"emissiveTexture\":{\"index\":0,\"texCoord\":2}}],"
                      : "",
        n_bin, accessors, with_material ? "\"material\":0," : "", primitive);
    size_t n_json = strlen(json);
    for (; n_json % 4; n_json++) json[n_json] = ' ';
    const size_t padded = (n_bin + 3) / 4 * 4, all = 28 + n_json + padded;
    const uint32_t head[5] = {0x46546c67, 2, (uint32_t)all, (uint32_t)n_json, 0x4e4f534a};
    const uint32_t chunk[2] = {(uint32_t)padded, 0x004e4942};
    assert_true(all <= sizeof file);
    memset(file, 0, sizeof file);
    memcpy(file, head, 20);
    memcpy(file + 20, json, n_json);
    memcpy(file + 20 + n_json, chunk, 8);
    memcpy(file + 28 + n_json, bin, n_bin);
    struct prt_context ctx;
    struct prt_mesh *m = NULL;
    prt_context_init(&ctx);
    assert_int_equal(prt_mesh_load_memory(&ctx, "grid.glb", file, all, NULL, NULL, &m), 0);
    return m;
}

// The seven accessors of the grid; with views of their own where it is not compressed.
static const char *accessors(char *text, size_t room, const struct grid *g, bool plain)
{
    static const char *const type[] = {"SCALAR", "VEC3", "VEC3", "VEC4",
                                       "VEC2",   "VEC2", "VEC2"};
    const void *part[] = {g->triangle, g->position, g->normal, g->color,
                          g->uv[0],    g->uv[1],    g->uv[2]};
    size_t n = (size_t)snprintf(text, room, "\"accessors\":[");
    for (int i = 0; i < 7; i++) {
        n += (size_t)snprintf(
            text + n, room - n, "%s{\"componentType\":%d,\"count\":%d,\"type\":\"%s\"",
            i ? "," : "", i ? 5126 : 5125, i ? N_VERTEX : 3 * N_TRIANGLE, type[i]);
        if (plain)
            n += (size_t)snprintf(text + n, room - n, ",\"bufferView\":0,\"byteOffset\":%td",
                                  (const char *)part[i] - (const char *)g);
        n += (size_t)snprintf(text + n, room - n, "}");
    }
    assert_true(n < room);
    return text;
}

static struct prt_mesh *load_plain(const struct grid *g)
{
    char text[2048];
    accessors(text, sizeof text, g, true);
    const size_t n = strlen(text);
    snprintf(text + n, sizeof text - n, "],\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu}]",
             sizeof *g);
    return load(text, "", g, sizeof *g);
}

// The same through a Draco stream with n_color values a colour. more: further primitives.
static struct prt_mesh *load_stream(const struct grid *g, int n_color, const char *more)
{
    float color[N_VERTEX][4];
    for (int v = 0; v < N_VERTEX; v++)
        memcpy((float *)color + v * n_color, g->color[v], sizeof(float) * (size_t)n_color);
    const struct draco_attribute attribute[] = {
        {DRACO_UV, 2, g->uv[2][0]},          {DRACO_COLOR, n_color, color[0]},
        {DRACO_POSITION, 3, g->position[0]}, {DRACO_UV, 2, g->uv[0][0]},
        {DRACO_NORMAL, 3, g->normal[0]},     {DRACO_UV, 2, g->uv[1][0]}};
    static char stream[16384];
    char text[2048], primitive[1024];
    size_t n = draco_write(N_VERTEX, N_TRIANGLE, (const uint32_t(*)[3])g->triangle, 6,
                           attribute, stream, sizeof stream);
    assert_int_not_equal(n, 0);
    accessors(text, sizeof text, g, false);
    const size_t end = strlen(text);
    snprintf(text + end, sizeof text - end,
             "],\"bufferViews\":[{\"buffer\":0,\"byteLength\":%zu}]", n);
    snprintf(primitive, sizeof primitive,
             ",\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,"
             "\"attributes\":{\"POSITION\":2,\"NORMAL\":4,\"COLOR_0\":1,\"TEXCOORD_0\":3,"
             "\"TEXCOORD_1\":5,\"TEXCOORD_2\":0}}}%s",
             more);
    return load(text, primitive, stream, n);
}

static struct prt_mesh *load_compressed(const struct grid *g, int n_color)
{
    return load_stream(g, n_color, "");
}

static void attributes_survive(void **state)
{
    static struct grid g;
    fill(&g);
    struct prt_mesh *a = load_plain(&g);
    assert_int_equal(a->n_uv, N_UV);
    assert_memory_equal(a->uv_more[0], g.uv[1], sizeof g.uv[1]); // the plain file is right
    for (int n_color = 3; n_color <= 4; n_color++) {
        struct prt_mesh *b = load_compressed(&g, n_color);
        assert_int_equal(b->n_vertex, N_VERTEX);
        assert_int_equal(b->n_triangle, N_TRIANGLE);
        assert_int_equal(b->n_uv, N_UV);
        assert_memory_equal(b->position, a->position, sizeof g.position);
        assert_memory_equal(b->normal, a->normal, sizeof g.normal);
        assert_memory_equal(b->triangle, a->triangle, sizeof g.triangle);
        assert_memory_equal(b->uv, a->uv, sizeof g.uv[0]);
        for (int k = 1; k < N_UV; k++)
            assert_memory_equal(b->uv_more[(k - 1) * N_VERTEX], a->uv_more[(k - 1) * N_VERTEX],
                                sizeof g.uv[k]);
        for (int v = 0; v < N_VERTEX; v++)
            for (int c = 0; c < 4; c++)
                assert_float_equal(b->color[v][c], c < n_color ? a->color[v][c] : 1, 0);
        prt_mesh_destroy(b);
    }
    prt_mesh_destroy(a);
}

static void colours_need_no_material(void **state)
{
    static struct grid g;
    fill(&g);
    with_material = false;
    struct prt_mesh *a = load_plain(&g), *b = load_compressed(&g, 4);
    with_material = true;
    assert_non_null(a->color);
    assert_non_null(b->color);
    assert_memory_equal(a->color, g.color, sizeof g.color);
    assert_memory_equal(b->color, g.color, sizeof g.color);
    prt_mesh_destroy(a);
    prt_mesh_destroy(b);
}

// Two primitives of one stream take attributes of their own.
static void primitives_share_a_stream(void **state)
{
    static struct grid g;
    fill(&g);
    struct prt_mesh *m = load_stream(
        &g, 4,
        "},{\"indices\":0,\"attributes\":{\"POSITION\":1,\"TEXCOORD_0\":4,\"TEXCOORD_1\":5},"
        "\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":0,"
        "\"attributes\":{\"POSITION\":2,\"TEXCOORD_0\":5,\"TEXCOORD_1\":3}}}");
    assert_int_equal(m->n_vertex, 2 * N_VERTEX);
    assert_memory_equal(m->uv, g.uv[0], sizeof g.uv[0]);
    assert_memory_equal(m->uv[N_VERTEX], g.uv[1], sizeof g.uv[1]);
    assert_memory_equal(m->uv_more[0], g.uv[1], sizeof g.uv[1]);
    assert_memory_equal(m->uv_more[N_VERTEX], g.uv[0], sizeof g.uv[0]);
    for (int v = 0; v < N_VERTEX; v++) // without COLOR_0 it is white
        for (int c = 0; c < 4; c++) assert_float_equal(m->color[N_VERTEX + v][c], 1, 0);
    prt_mesh_destroy(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(attributes_survive),
                                       cmocka_unit_test(colours_need_no_material),
                                       cmocka_unit_test(primitives_share_a_stream)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
