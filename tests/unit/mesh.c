// SPDX-License-Identifier: MIT
// Loading: every kind of file gives the vertices, triangles, objects and normals it should, in
// the file's order. Small models are written here; the development data are used where present.
// Above 600 lines: a list of formats, each read alone.
#include "prt/mesh.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>

#include "../data.h"

static char lines[8192]; // what was logged since the last load

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(lines);
    snprintf(lines + n, sizeof lines - n, "%s\n", line);
}

static struct prt_context context(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    lines[0] = 0;
    return ctx;
}

static int load_text(const char *text, const struct prt_mesh_options *options,
                     struct prt_mesh **out)
{
    struct prt_context ctx = context();
    *out = NULL;
    return prt_mesh_load_memory(&ctx, "inline", text, strlen(text), NULL, options, out);
}

static struct prt_mesh *must_load(const char *text)
{
    struct prt_mesh *m;
    int status = load_text(text, NULL, &m);
    if (status) fail_msg("status %d: %s", status, lines);
    return m;
}

// ---- small glTF files: a buffer in base64 and JSON around it

static void base64(const void *bytes, size_t n, char *out)
{
    static const char set[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const unsigned char *b = bytes;
    for (size_t i = 0; i < n; i += 3) {
        unsigned v = b[i] << 16 | (i + 1 < n ? b[i + 1] : 0) << 8 | (i + 2 < n ? b[i + 2] : 0);
        for (int k = 0; k < 4; k++) *out++ = set[v >> (18 - 6 * k) & 63];
        if (i + 1 >= n) out[-2] = '=';
        if (i + 2 >= n) out[-1] = '=';
    }
    *out = 0;
}

// Everything after "buffers" is the caller's.
static const char *gltf(const void *bytes, size_t n, const char *rest)
{
    static char text[16384], data[4096];
    base64(bytes, n, data);
    snprintf(text, sizeof text,
             "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":%zu,"
             "\"uri\":\"data:application/octet-stream;base64,%s\"}],%s}",
             n, data, rest);
    return text;
}

// A tetrahedron: 4 positions, 12 u16 indices (72 bytes, outward).
struct tetrahedron {
    float p[4][3];
    uint16_t i[12];
};
static const struct tetrahedron tetrahedron = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                                               {0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3}};
#define TETRA_VIEWS                                                                           \
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":48},"                                      \
    "{\"buffer\":0,\"byteOffset\":48,\"byteLength\":24}],"                                    \
    "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"}," \
    "{\"bufferView\":1,\"componentType\":5123,\"count\":12,\"type\":\"SCALAR\"}]"

static double volume(const struct prt_mesh *m)
{
    double v = 0;
    for (uint32_t t = 0; t < m->n_triangle; t++) {
        const float *a = m->position[m->triangle[t][0]], *b = m->position[m->triangle[t][1]],
                    *c = m->position[m->triangle[t][2]];
        v += a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
             a[2] * (b[0] * c[1] - b[1] * c[0]);
    }
    return v / 6;
}

static void nodes_make_objects(void **state)
{
    // two nodes share a mesh; the second is mirrored and moved, below a scaled parent
    struct prt_mesh *m = must_load(gltf(
        &tetrahedron, sizeof tetrahedron,
        TETRA_VIEWS ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                    "\"indices\":1}]}],\"nodes\":[{\"mesh\":0},{\"children\":[2],"
                    "\"scale\":[2,2,2]},{\"mesh\":0,\"scale\":[-1,1,1],"
                    "\"translation\":[5,0,0]}],\"scenes\":[{\"nodes\":[0,1]}],\"scene\":0"));
    assert_int_equal(m->n_object, 2);
    assert_int_equal(m->n_block, 2);
    assert_int_equal(m->n_vertex, 8);
    assert_int_equal(m->n_triangle, 8);
    assert_int_equal(m->n_weld, 8); // places are not shared between objects
    assert_int_equal(m->units_known, 1);
    assert_int_equal(m->n_boundary_edge, 0);
    assert_int_equal(m->block[1].object, 1);
    assert_int_equal(m->block[1].vertex_begin, 4);
    const float want[4][3] = {{10, 0, 0}, {8, 0, 0}, {10, 2, 0}, {10, 0, 2}};
    for (int v = 0; v < 4; v++)
        for (int c = 0; c < 3; c++) assert_float_equal(m->position[4 + v][c], want[v][c], 1e-6);
    assert_float_equal(volume(m), 1 / 6. + 8 / 6., 1e-6); // the mirrored one still faces out
    prt_mesh_destroy(m);
}

// Chunks of a GLB begin at multiples of four bytes, also behind one whose length is none: some
// exporters do not count the padding.
static void uncounted_padding_of_a_glb(void **state)
{
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":72}]," TETRA_VIEWS
        ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}],"
        "\"nodes\":[{\"mesh\":0}]}";
    for (uint32_t spaces = 0; spaces < 5; spaces++) {
        uint8_t file[2048];
        const uint32_t n = sizeof json - 1 + spaces, padded = (n + 3) / 4 * 4;
        const uint32_t total = 28 + padded + sizeof tetrahedron;
        const uint32_t head[] = {0x46546c67, 2, total, n, 0x4e4f534a};
        const uint32_t bin[] = {sizeof tetrahedron, 0x004e4942};
        struct prt_context ctx = context();
        struct prt_mesh *m;
        assert_true(total <= sizeof file);
        memset(file, ' ', sizeof file);
        memcpy(file, head, sizeof head);
        memcpy(file + 20, json, sizeof json - 1);
        memcpy(file + 20 + padded, bin, sizeof bin);
        memcpy(file + 28 + padded, &tetrahedron, sizeof tetrahedron);
        if (prt_mesh_load_memory(&ctx, "a.glb", file, total, NULL, NULL, &m))
            fail_msg("%u spaces: %s", spaces, lines);
        assert_float_equal(volume(m), 1 / 6., 1e-6);
        prt_mesh_destroy(m);
    }
}

// A rotation turns and scales nothing, whatever the length of its quaternion: here a quarter
// turn about z.
static void rotations_keep_lengths(void **state)
{
    static const char *const quarter[] = {"0,0,0.70710678,0.70710678", "0,0,2,2",
                                          "0,0,-1e-3,-1e-3"};
    for (int i = 0; i < 3; i++) {
        char rest[2048];
        snprintf(rest, sizeof rest,
                 TETRA_VIEWS ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                             "\"indices\":1}]}],\"nodes\":[{\"mesh\":0,\"rotation\":[%s]}]",
                 quarter[i]);
        struct prt_mesh *m = must_load(gltf(&tetrahedron, sizeof tetrahedron, rest));
        const float want[4][3] = {{0, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, 0, 1}};
        for (int v = 0; v < 4; v++)
            for (int c = 0; c < 3; c++) assert_float_equal(m->position[v][c], want[v][c], 1e-6);
        prt_mesh_destroy(m);
    }
}

static void normals_are_angle_weighted(void **state)
{
    // at the right-angled corner three faces of equal angle meet
    struct prt_mesh *m = must_load(
        gltf(&tetrahedron, sizeof tetrahedron,
             TETRA_VIEWS ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                         "\"indices\":1}]}],\"nodes\":[{\"mesh\":0}]"));
    for (int c = 0; c < 3; c++) assert_float_equal(m->normal[0][c], -1 / sqrt(3), 1e-6);
    // corner (1,0,0): -z and -y faces with 45 degrees each, the slanted one with 60
    double k = 60 / sqrt(3), n[3] = {k, k - 45, k - 45},
           l = sqrt(n[0] * n[0] + 2 * n[1] * n[1]);
    for (int c = 0; c < 3; c++) assert_float_equal(m->normal[1][c], n[c] / l, 1e-5);
    prt_mesh_destroy(m);
}

// Two triangles at an edge wind in one sense where they run through it in opposite directions.
static void opposite_windings_are_told(void **state)
{
    static const struct {
        const char *faces;
        bool told;
    } row[] = {{"f 1 2 3\nf 2 1 4\n", false},
               {"f 2 1 4\nf 1 2 3\n", false},
               {"f 1 2 3\nf 1 2 4\n", true},
               {"f 2 1 3\nf 2 1 4\n", true}};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char text[256];
        snprintf(text, sizeof text, "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 -1 0\n%s", row[i].faces);
        struct prt_mesh *m = must_load(text);
        assert_int_equal(m->n_boundary_edge, 4);
        assert_int_equal(strstr(lines, "both sides of 1 edges wind") != NULL, row[i].told);
        prt_mesh_destroy(m);
    }
}

static void mirrored_normals_point_out(void **state)
{
    struct {
        float p[3][3], n[3][3];
    } tri = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {{0, 0, 1}, {0, 0, 1}, {0.6f, 0, 0.8f}}};
    struct prt_mesh *m = must_load(gltf(
        &tri, sizeof tri,
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36},{\"buffer\":0,\"byteOffset\":36,"
        "\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,\"componentType\":5126,"
        "\"count\":3,\"type\":\"VEC3\"},{\"bufferView\":1,\"componentType\":5126,\"count\":3,"
        "\"type\":\"VEC3\"}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,"
        "\"NORMAL\":1}}]}],\"nodes\":[{\"mesh\":0,\"scale\":[-2,1,1]}]"));
    assert_int_equal(m->triangle[0][1], 2); // winding turned
    assert_float_equal(m->normal[0][2], 1, 1e-6);
    // inverse transpose of diag(-2,1,1) on (.6,0,.8) is (-.3,0,.8)
    assert_float_equal(m->normal[2][0], -0.3 / sqrt(0.73), 1e-6);
    assert_float_equal(m->normal[2][2], 0.8 / sqrt(0.73), 1e-6);
    prt_mesh_destroy(m);
}

static void modes_give_triangles(void **state)
{
    // five points in a row of a strip, read as strip, fan and list
    struct {
        float p[6][3];
        uint8_t i[8];
    } s = {{{0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {1, 1, 0}, {2, 0, 0}, {2, 1, 0}},
           {0, 2, 1, 3, 5, 4, 0, 0}};
    static const struct {
        const char *mode, *indices;
        uint32_t n, first[3], second[3];
    } want[] = {
        {"5", "", 4, {0, 1, 2}, {1, 3, 2}},
        {"6", "", 4, {1, 2, 0}, {2, 3, 0}},
        {"4", "", 2, {0, 1, 2}, {3, 4, 5}},
        {"5", ",\"indices\":1", 4, {0, 2, 1}, {2, 3, 1}},
        {"4", ",\"indices\":1", 2, {0, 2, 1}, {3, 5, 4}},
    };
    for (size_t k = 0; k < sizeof want / sizeof *want; k++) {
        char rest[1024];
        snprintf(rest, sizeof rest,
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},{\"buffer\":0,"
                 "\"byteOffset\":72,\"byteLength\":6}],\"accessors\":[{\"bufferView\":0,"
                 "\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"},{\"bufferView\":1,"
                 "\"componentType\":5121,\"count\":6,\"type\":\"SCALAR\"}],\"meshes\":[{"
                 "\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":1},"
                 "{\"attributes\":{\"POSITION\":0},\"mode\":%s%s}]}],\"nodes\":[{\"mesh\":0}]",
                 want[k].mode, want[k].indices);
        struct prt_mesh *m = must_load(gltf(&s, sizeof s, rest));
        assert_non_null(strstr(lines, "points or lines"));
        assert_int_equal(m->n_block, 1);
        assert_int_equal(m->n_triangle, want[k].n);
        assert_memory_equal(m->triangle[0], want[k].first, 12);
        assert_memory_equal(m->triangle[1], want[k].second, 12);
        prt_mesh_destroy(m);
    }
}

// An accessor lies in its view as a whole, wherever in it it begins.
static void accessors_end_in_their_view(void **state)
{
    static const struct {
        const char *view, *accessor, *why; // NULL: it is read
    } row[] = {{"", "", NULL},
               {",\"byteStride\":16", "", NULL},
               {"", ",\"byteOffset\":12", NULL},
               {",\"byteStride\":20", "", NULL},
               {",\"byteStride\":24", "", "reads 8 bytes past bufferView 0"},
               {"", ",\"byteOffset\":28", "reads 12 bytes past bufferView 0"},
               {"", ",\"byteOffset\":52", "reads 36 bytes past bufferView 0"},
               {"", ",\"byteOffset\":56", "reads 40 bytes past bufferView 0"},
               {",\"byteStride\":16", ",\"byteOffset\":12", "reads 4 bytes past bufferView 0"},
               {",\"byteStride\":8", "", "stride 8 is less than an element"}};
    const float p[26] = {0, 0, 0, 1, 0, 0, 2, 3, 0, 0, 4, 0, 5};
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        char rest[800];
        struct prt_mesh *m = NULL;
        snprintf(rest, sizeof rest,
                 "\"bufferViews\":[{\"buffer\":0,\"byteLength\":52%s}],\"accessors\":[{"
                 "\"bufferView\":0%s,\"componentType\":5126,\"count\":3,\"type\":"
                 "\"VEC3\"}],\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],"
                 "\"nodes\":[{\"mesh\":0}]",
                 row[i].view, row[i].accessor);
        const int status = load_text(gltf(p, sizeof p, rest), NULL, &m);
        if (!row[i].why) {
            if (status) fail_msg("%zu: %s", i, lines);
            prt_mesh_destroy(m);
        } else if (status != PRT_FORMAT || !strstr(lines, row[i].why)) {
            fail_msg("%zu: '%s', not '%s'", i, lines, row[i].why);
        }
    }
}

// What is left of a primitive beyond its last whole triangle is told, once a primitive.
static void incomplete_triangles_are_counted(void **state)
{
    struct {
        float p[6][3];
        uint8_t index[6];
    } s = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}},
           {0, 1, 2, 3, 4, 5}};
    static const struct {
        int mode, n, n_triangle;
    } row[] = {{4, 5, 1}, {4, 2, 0}, {4, 1, 0}, {5, 2, 0}, {5, 1, 0}, {6, 2, 0},
               {6, 1, 0}, {4, 4, 1}, {4, 3, 1}, {5, 4, 2}, {6, 5, 3}};
    enum { N_ROW = sizeof row / sizeof *row, N_INCOMPLETE = 8 };
    char rest[4096], *at = rest;
    int want = 0;
    at += sprintf(at, "\"bufferViews\":[{\"buffer\":0,\"byteLength\":72},{\"buffer\":0,"
                      "\"byteOffset\":72,\"byteLength\":6}],\"accessors\":[{\"bufferView\":0,"
                      "\"componentType\":5126,\"count\":6,\"type\":\"VEC3\"}");
    for (int n = 1; n <= 6; n++)
        at += sprintf(at,
                      ",{\"bufferView\":1,\"componentType\":5121,\"count\":%d,"
                      "\"type\":\"SCALAR\"}",
                      n);
    at += sprintf(at, "],\"meshes\":[{\"primitives\":[");
    for (int i = 0; i < N_ROW; i++) {
        at += sprintf(at, "%s{\"attributes\":{\"POSITION\":0},\"mode\":%d,\"indices\":%d}",
                      i ? "," : "", row[i].mode, row[i].n);
        want += row[i].n_triangle;
    }
    sprintf(at, "]}],\"nodes\":[{\"mesh\":0}]");
    struct prt_mesh *m = must_load(gltf(&s, sizeof s, rest));
    char line[80];
    snprintf(line, sizeof line, "the last triangle of %d primitives is incomplete",
             N_INCOMPLETE);
    assert_non_null(strstr(lines, line));
    assert_int_equal(m->n_triangle, want);
    prt_mesh_destroy(m);
}

static void sparse_and_normalised(void **state)
{
    // i16 normalised positions, strided by 8; vertex 2 replaced by a sparse value
    struct {
        int16_t p[3][4];
        uint8_t where[4];
        int16_t what[4];
    } s = {{{0, 0, 0, 9}, {32767, 0, 0, 9}, {0, 1, 0, 9}}, {2}, {0, -32768, 16384, 0}};
    static const char rest[] =
        "\"extensionsRequired\":[\"KHR_mesh_quantization\"],\"bufferViews\":[{\"buffer\":0,"
        "\"byteLength\":24,\"byteStride\":8},{\"buffer\":0,\"byteOffset\":24,"
        "\"byteLength\":1},{\"buffer\":0,\"byteOffset\":28,\"byteLength\":6}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5122,\"normalized\":true,"
        "\"count\":3,\"type\":\"VEC3\",\"sparse\":{\"count\":1,\"indices\":{"
        "\"bufferView\":1,\"componentType\":5121},\"values\":{\"bufferView\":2}}}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}],"
        "\"nodes\":[{\"mesh\":0}]";
    struct prt_mesh *m = must_load(gltf(&s, sizeof s, rest));
    assert_float_equal(m->position[1][0], 1, 1e-7);
    assert_float_equal(m->position[2][0], 0, 0);
    assert_float_equal(m->position[2][1], -1, 0);
    assert_float_equal(m->position[2][2], 16384 / 32767., 1e-6);
    assert_int_equal(m->n_boundary_edge, 3);
    assert_non_null(strstr(lines, "leak through 3 boundary edges"));
    prt_mesh_destroy(m);
    s.where[0] = 3; // one past the last
    assert_int_equal(load_text(gltf(&s, sizeof s, rest), NULL, &m), PRT_FORMAT);
    assert_non_null(strstr(lines, "sparse index 3 of 3"));
}

// glTF: an accessor without a bufferView and without sparse values is 0 everywhere.
static void accessors_without_a_view_are_zero(void **state)
{
    const float p[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    static const char rest[] =
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,"
        "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"},{\"componentType\":5126,"
        "\"count\":3,\"type\":\"VEC2\"}],\"meshes\":[{\"primitives\":[{\"attributes\":{"
        "\"POSITION\":0,\"TEXCOORD_0\":1}}]}],\"nodes\":[{\"mesh\":0}]";
    struct prt_mesh *m = must_load(gltf(p, sizeof p, rest));
    assert_non_null(m->uv);
    for (int k = 0; k < 6; k++) assert_float_equal(m->uv[k / 2][k % 2], 0, 0);
    prt_mesh_destroy(m);
}

// glTF: a signed byte c stands for max(c / 127, -1), a byte for c / 255.
static void bytes_are_normalised(void **state)
{
    static const int8_t p[3][4] = {{127, -128, 64, 0}, {-127, 0, 1, 0}, {0, 100, 0, 0}};
    static const char *const type[] = {"5120", "5121"};
    for (int k = 0; k < 2; k++) {
        char rest[600];
        snprintf(rest, sizeof rest,
                 "\"extensionsRequired\":[\"KHR_mesh_quantization\"],\"bufferViews\":[{"
                 "\"buffer\":0,\"byteLength\":12,\"byteStride\":4}],\"accessors\":[{"
                 "\"bufferView\":0,\"componentType\":%s,\"normalized\":true,\"count\":3,"
                 "\"type\":\"VEC3\"}],\"meshes\":[{\"primitives\":[{\"attributes\":{"
                 "\"POSITION\":0}}]}],\"nodes\":[{\"mesh\":0}]",
                 type[k]);
        struct prt_mesh *m = must_load(gltf(p, sizeof p, rest));
        for (int v = 0; v < 3; v++)
            for (int c = 0; c < 3; c++) {
                double want = k ? (uint8_t)p[v][c] / 255.0 : fmax(p[v][c] / 127.0, -1);
                assert_float_equal(m->position[v][c], want, 1e-6);
            }
        prt_mesh_destroy(m);
    }
}

#define TWO_MATERIALS(first)                                                                \
    TETRA_VIEWS ",\"materials\":[{\"name\":\"wax\"" first "},{\"name\":\"floor\","          \
                "\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,0.25,0.125,1],"         \
                "\"roughnessFactor\":0.4}}],\"meshes\":[{\"primitives\":[{\"attributes\":{" \
                "\"POSITION\":0},\"indices\":1,\"material\":0},{\"attributes\":{"           \
                "\"POSITION\":0},\"indices\":1,\"material\":1}]}],\"nodes\":[{\"mesh\":0,"  \
                "\"name\":\"thing\"}]"

static void materials_decide(void **state)
{
    struct prt_mesh *m =
        must_load(gltf(&tetrahedron, sizeof tetrahedron,
                       TWO_MATERIALS(",\"extensions\":{\"KHR_materials_volume\":{},"
                                     "\"KHR_materials_ior\":{\"ior\":1.3}}")));
    assert_int_equal(m->n_object, 1);
    assert_int_equal(m->n_block, 2);
    const struct prt_surface *wax = &m->surface[m->block[0].surface];
    const struct prt_surface *floor = &m->surface[m->block[1].surface];
    assert_string_equal(wax->name, "wax");
    assert_int_equal(wax->translucent, 1);
    assert_float_equal(wax->ior, 1.3, 1e-6);
    assert_int_equal(floor->translucent, 0);
    assert_float_equal(floor->base_color[1], 0.25, 0);
    assert_float_equal(floor->roughness, 0.4, 1e-6);
    assert_int_equal(m->n_weld, 4); // one object: the places are shared
    uint32_t *of_triangle = prt_mesh_triangle_blocks(m), *of_vertex = prt_mesh_vertex_blocks(m);
    assert_int_equal(of_triangle[3], 0);
    assert_int_equal(of_triangle[4], 1);
    assert_int_equal(of_vertex[3], 0);
    assert_int_equal(of_vertex[4], 1);
    prt_free(of_triangle);
    prt_free(of_vertex);
    prt_mesh_destroy(m);

    // without scattering extensions all are translucent, but for those named opaque
    const char *plain = gltf(&tetrahedron, sizeof tetrahedron, TWO_MATERIALS(""));
    const char *const floor_name[] = {"floor", NULL}, *const thing[] = {"thing", NULL},
                      *const nobody[] = {"nobody", NULL};
    struct prt_mesh_options options = {.opaque = floor_name};
    assert_int_equal(load_text(plain, &options, &m), PRT_OK);
    assert_int_equal(m->surface[m->block[0].surface].translucent, 1);
    assert_int_equal(m->surface[m->block[1].surface].translucent, 0);
    prt_mesh_destroy(m);
    options.opaque = thing;
    assert_int_equal(load_text(plain, &options, &m), PRT_OK);
    assert_int_equal(m->surface[m->block[0].surface].translucent, 0);
    assert_int_equal(m->surface[m->block[1].surface].translucent, 0);
    prt_mesh_destroy(m);
    options.opaque = nobody;
    assert_int_equal(load_text(plain, &options, &m), PRT_ARG);
    // each name is one of the model's, not any of them
    for (int i = 0; i < 2; i++) {
        const char *const one_wrong[] = {i ? "floor" : "nobody", i ? "nobody" : "floor", NULL};
        options.opaque = one_wrong;
        assert_int_equal(load_text(plain, &options, &m), PRT_ARG);
        assert_non_null(strstr(lines, "\"nobody\""));
    }
    assert_non_null(strstr(lines, "nobody"));
}

// A surface that the file does not name is "default", for --opaque, too.
// COLOR_0 of one object leaves another as it is: the factor of a translucent surface counts
// where that has a texture or colours itself.
static void colours_are_of_their_object(void **state)
{
    static const char rest[] = TETRA_VIEWS
        ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.5,1,1,1]}},"
        "{\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.25,1,1,1]}}],"
        "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"COLOR_0\":0},"
        "\"indices\":1,\"material\":0}]},{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
        "\"indices\":1,\"material\":1}]}],\"nodes\":[{\"mesh\":0},{\"mesh\":1}]";
    struct prt_mesh *m = must_load(gltf(&tetrahedron, sizeof tetrahedron, rest));
    const float no[2] = {0, 0}, up[3] = {0, 0, 1};
    struct prt_look look;
    assert_non_null(m->color);
    prt_mesh_look(m, 3, 0, 0, 0, no, no, up, &look); // at x 1
    assert_float_equal(look.base[0], 0.5, 1e-6);
    prt_mesh_look(m, 7, 1, 0, 0, no, no, up, &look);
    assert_float_equal(look.base[0], 1, 0);
    prt_mesh_destroy(m);
}

static void unnamed_surfaces(void **state)
{
    static const char *const texts[] = {
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        "end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        "solid\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
        "endloop\nendfacet\nendsolid\n",
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"};
    static const char *const opaque[] = {"default", NULL};
    const struct prt_mesh_options options = {.opaque = opaque};
    for (int i = 0; i < 3; i++) {
        struct prt_mesh *m = must_load(texts[i]);
        assert_string_equal(m->surface[0].name, "default");
        assert_int_equal(m->surface[0].translucent, 1);
        prt_mesh_destroy(m);
        int status = load_text(texts[i], &options, &m);
        if (status) fail_msg("%.6s: status %d: %s", texts[i], status, lines);
        assert_int_equal(m->surface[0].translucent, 0);
        prt_mesh_destroy(m);
    }
}

// Variants without a name, or with that of another, get one that no other has.
static void variants_have_names_of_their_own(void **state)
{
    struct prt_mesh *m = must_load(
        gltf(&tetrahedron, sizeof tetrahedron,
             TWO_MATERIALS("") ",\"extensions\":{\"KHR_materials_variants\":{\"variants\":["
                               "{\"name\":\"variant 1\"},{},{\"name\":\"variant 1\"},{}]}}"));
    assert_int_equal(m->n_variant, 4);
    assert_string_equal(m->variant[0].name, "variant 1");
    for (uint32_t i = 0; i < 4; i++)
        for (uint32_t k = 0; k < i; k++)
            assert_string_not_equal(m->variant[i].name, m->variant[k].name);
    prt_mesh_destroy(m);
}

static void limits_hold(void **state)
{
    struct prt_mesh *m;
    struct prt_mesh_options options = {.max_vertices = 7};
    const char *text = gltf(&tetrahedron, sizeof tetrahedron, TWO_MATERIALS(""));
    assert_int_equal(load_text(text, &options, &m), PRT_LIMIT);
    options = (struct prt_mesh_options){.max_triangles = 7};
    assert_int_equal(load_text(text, &options, &m), PRT_LIMIT);
    options.max_triangles = 8;
    assert_int_equal(load_text(text, &options, &m), PRT_OK);
    prt_mesh_destroy(m);
}

static void faults_are_named(void **state)
{
    static const struct {
        const char *rest, *say;
        int status;
    } bad[] = {
        {"\"extensionsRequired\":[\"EXT_strange\"]", "EXT_strange", PRT_UNSUPPORTED},
        {"\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":3}}]}],\"nodes\":[{"
         "\"mesh\":0}]",
         "accessor 3 does not exist", PRT_FORMAT},
        {"\"bufferViews\":[{\"buffer\":0,\"byteLength\":48}],\"accessors\":[{\"bufferView\":0,"
         "\"componentType\":5126,\"count\":5,\"type\":\"VEC3\"}],\"meshes\":[{\"primitives\":[{"
         "\"attributes\":{\"POSITION\":0}}]}],\"nodes\":[{\"mesh\":0}]",
         "accessor 0: reads 12 bytes past bufferView 0", PRT_FORMAT},
        {"\"nodes\":[{\"children\":[1]},{\"children\":[1]}],\"scenes\":[{\"nodes\":[0]}]",
         "its own descendant", PRT_FORMAT},
        {"\"nodes\":[{}]", "no triangles", PRT_FORMAT},
        // one behind the last bufferView
        {TETRA_VIEWS
         ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1,"
         "\"extensions\":{\"KHR_draco_mesh_compression\":{\"bufferView\":2,"
         "\"attributes\":{\"POSITION\":0}}}}]}],\"nodes\":[{\"mesh\":0}]",
         "damaged Draco primitive", PRT_FORMAT},
        {TETRA_VIEWS
         ",\"materials\":[{}],\"meshes\":[{\"primitives\":[{\"attributes\":{"
         "\"POSITION\":0},\"indices\":1,\"material\":1}]}],\"nodes\":[{\"mesh\":0}]",
         "material 1 does not exist", PRT_FORMAT},
        // numbers the parser would turn into others
        {"\"bufferViews\":[{\"buffer\":0,\"byteOffset\":-4,\"byteLength\":48}]",
         "byteOffset is not a whole number", PRT_FORMAT},
        {"\"nodes\":[{\"mesh\":4294967296}]", "mesh is not a whole number", PRT_FORMAT},
        {"\"nodes\":[{\"children\":[0.5]}]", "not a whole number", PRT_FORMAT},
        {"\"accessors\":[{\"count\":\"3\"}]", "count is not a whole number", PRT_FORMAT},
    };
    struct prt_mesh *m;
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        int status = load_text(gltf(&tetrahedron, sizeof tetrahedron, bad[i].rest), NULL, &m);
        assert_int_equal(status, bad[i].status);
        if (!strstr(lines, bad[i].say)) fail_msg("\"%s\" lacks \"%s\"", lines, bad[i].say);
        assert_non_null(strstr(lines, "inline: "));
        assert_null(m);
    }
    assert_int_equal(
        load_text("{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":4,"
                  "\"uri\":\"x.bin\"}]}",
                  NULL, &m),
        PRT_FORMAT);
    assert_int_equal(load_text("hello\n", NULL, &m), PRT_FORMAT);
    assert_int_equal(load_text("", NULL, &m), PRT_FORMAT);
}

static void what_is_not_read_cannot_fail(void **state)
{
    struct prt_mesh *m = must_load(gltf(
        &tetrahedron, sizeof tetrahedron,
        TETRA_VIEWS
        ",\"images\":[{\"bufferView\":99},{\"uri\":\"../none.png\"},7],\"animations\":[1],"
        "\"skins\":[{\"joints\":[-1]}],\"cameras\":[[]],\"meshes\":[{\"extras\":{\"count\":"
        "-1,\"a\":[{\"]}\":\"\\\"\"}]},\"primitives\":[{\"attributes\":{\"POSITION\":0},"
        "\"indices\":1}]}],\"nodes\":[{\"mesh\":0}]"));
    assert_int_equal(m->n_triangle, 4);
    assert_null(strstr(lines, "png"));
    prt_mesh_destroy(m);
}

// ---- external files

static void put_file(const char *folder, const char *name, const void *bytes, size_t n)
{
    char path[512];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    assert_int_equal(fwrite(bytes, 1, n, f), n);
    fclose(f);
}

static int load_with_uri(const char *folder, const char *uri, struct prt_mesh **out)
{
    char text[2048];
    struct prt_context ctx = context();
    int n = snprintf(text, sizeof text,
                     "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":72,"
                     "\"uri\":\"%s\"}]," TETRA_VIEWS
                     ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},"
                     "\"indices\":1}]}],\"nodes\":[{\"mesh\":0}]}",
                     uri);
    *out = NULL;
    return prt_mesh_load_memory(&ctx, "m.gltf", text, (size_t)n, folder, NULL, out);
}

static void buffers_stay_in_the_folder(void **state)
{
    char root[] = "/tmp/prt-mesh-XXXXXX", inner[64], path[160];
    struct prt_mesh *m;
    assert_non_null(mkdtemp(root));
    snprintf(inner, sizeof inner, "%s/in side", root);
    snprintf(path, sizeof path, "mkdir '%s'", inner);
    assert_int_equal(system(path), 0);
    put_file(root, "secret.bin", &tetrahedron, sizeof tetrahedron);
    put_file(inner, "b.bin", &tetrahedron, sizeof tetrahedron);
    snprintf(path, sizeof path, "%s/link.bin", inner);
    assert_int_equal(symlink("../secret.bin", path), 0);

    assert_int_equal(load_with_uri(inner, "b.bin", &m), PRT_OK);
    prt_mesh_destroy(m);
    assert_int_equal(load_with_uri(root, "in%20side/b.bin", &m), PRT_OK);
    prt_mesh_destroy(m);
    char padded[sizeof tetrahedron + 8] = {0}; // a file may be longer than the buffer
    memcpy(padded, &tetrahedron, sizeof tetrahedron);
    put_file(inner, "long.bin", padded, sizeof padded);
    put_file(inner, "short.bin", padded, 71);
    assert_int_equal(load_with_uri(inner, "long.bin", &m), PRT_OK);
    assert_int_equal(m->n_triangle, 4);
    prt_mesh_destroy(m);
    assert_int_equal(load_with_uri(inner, "short.bin", &m), PRT_FORMAT);
    assert_non_null(strstr(lines, "72 bytes declared, 71 there"));
    snprintf(path, sizeof path, "%s/b.bin", inner);
    const char *const outside[] = {
        "../secret.bin", "%2e%2e/secret.bin",  "link.bin",        path,
        "file:b.bin",    "a/../../secret.bin", "..\\\\secret.bin"};
    for (size_t i = 0; i < sizeof outside / sizeof *outside; i++)
        assert_int_equal(load_with_uri(inner, outside[i], &m), PRT_FORMAT);
    assert_int_equal(load_with_uri(inner, "none.bin", &m), PRT_IO);
    assert_int_equal(load_with_uri(NULL, "b.bin", &m), PRT_FORMAT);
    char clean[128];
    snprintf(clean, sizeof clean, "rm -r '%s'", root);
    assert_int_equal(system(clean), 0);
}

// ---- OBJ and PLY

static void obj_keeps_its_vertices(void **state)
{
    struct prt_mesh *m = must_load("# a unit square as one face, and a triangle by names\r\n"
                                   "o thing\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 1 1 0\nv 0 1 0\n"
                                   "v 9 9 9\nvt 0 0\nvt 1 0.25\nvn 0 0 2\n"
                                   "f 1/1/1 2/2/1 3/1/1 4/1/1\nf -5//1 -4//1 -3//1\n");
    assert_int_equal(m->n_vertex, 5);
    assert_int_equal(m->n_triangle, 3);
    const uint32_t want[3][3] = {{0, 1, 2}, {0, 2, 3}, {0, 1, 2}};
    assert_memory_equal(m->triangle, want, sizeof want);
    assert_float_equal(m->normal[1][2], 1, 0);
    assert_float_equal(m->uv[1][0], 1, 0);
    assert_float_equal(m->uv[1][1], 0.75, 0);
    assert_int_equal(m->units_known, 0);
    assert_non_null(strstr(lines, "belong to no triangle"));
    prt_mesh_destroy(m);
    assert_int_equal(load_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", NULL, &m), PRT_FORMAT);
    assert_non_null(strstr(lines, "line 4"));
}

// A backslash continues a line, but not a comment; faults name the line that was begun.
static void obj_lines_go_on(void **state)
{
    struct prt_mesh *m = must_load("# c:\\\nv 0 0 \\\n0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n"
                                   "f 1 2 \\\r\n 3 \\\r\n 4\nf 1 3 4\n");
    assert_int_equal(m->n_vertex, 4);
    assert_int_equal(m->n_triangle, 3);
    assert_int_equal(m->triangle[1][2], 3);
    prt_mesh_destroy(m);
    assert_int_equal(
        load_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 \\\n 2 3\nf 1 2 \\\n 4\n", NULL, &m),
        PRT_FORMAT);
    assert_non_null(strstr(lines, "line 6"));
}

// Every line mtllib counts, once, and every name on it; a name may hold blanks.
static void obj_libraries_add_up(void **state)
{
    static const char text[] =
        "mtllib a.mtl\nmtllib b.mtl  c.mtl\nmtllib a.mtl\nmtllib d e.mtl\n"
        "mtllib no such.mtl\n"
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\n"
        "v 2 0 0\nv 3 0 0\nv 2 1 0\nusemtl b\nf 4 5 6\n"
        "v 4 0 0\nv 5 0 0\nv 4 1 0\nusemtl c\nf 7 8 9\n"
        "v 6 0 0\nv 7 0 0\nv 6 1 0\nusemtl d\nf 10 11 12\n"
        "v 8 0 0\nv 9 0 0\nv 8 1 0\nusemtl e\nf 13 14 15\n";
    static const char *const file[] = {"a.mtl", "b.mtl", "c.mtl", "d e.mtl"};
    char folder[] = "/tmp/prt-mesh-XXXXXX", library[64], clean[128];
    struct prt_context ctx = context();
    struct prt_mesh *m = NULL;
    assert_non_null(mkdtemp(folder));
    for (int i = 0; i < 4; i++) {
        int n = snprintf(library, sizeof library, "newmtl %c\nKd .%d 0 0", 'a' + i, i + 1);
        put_file(folder, file[i], library, (size_t)n);
    }
    assert_int_equal(
        prt_mesh_load_memory(&ctx, "m.obj", text, sizeof text - 1, folder, NULL, &m), PRT_OK);
    assert_int_equal(m->n_surface, 5);
    for (uint32_t i = 0; i < 4; i++)
        assert_float_equal(m->surface[i].base_color[0], (float)(i + 1) / 10, 1e-6);
    assert_non_null(strstr(lines, "no material file \"no such.mtl\""));
    assert_null(strstr(lines, "a.mtl\"")); // none of the others
    assert_non_null(strstr(lines, "none of its libraries has material \"e\""));
    prt_mesh_destroy(m);
    // one warning is for all lines beyond 64
    char *many = malloc(10000);
    size_t n = (size_t)sprintf(many, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    for (int i = 0; i < 80; i++) n += (size_t)sprintf(many + n, "mtllib %d.mtl\n", i);
    ctx = context();
    assert_int_equal(prt_mesh_load_memory(&ctx, "m.obj", many, n, folder, NULL, &m), PRT_OK);
    const char *said = strstr(lines, "more than 64 mtllib");
    assert_non_null(said);
    assert_null(strstr(said + 1, "more than 64 mtllib"));
    prt_mesh_destroy(m);
    free(many);
    snprintf(clean, sizeof clean, "rm -r '%s'", folder);
    assert_int_equal(system(clean), 0);
}

static void put_swapped(char **p, const void *value, int n, bool swap)
{
    for (int i = 0; i < n; i++) *(*p)++ = ((const char *)value)[swap ? n - 1 - i : i];
}

__attribute__((format(printf, 2, 3))) static char *print(char *at, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    int n = vsnprintf(at, 512, fmt, args);
    va_end(args);
    return at + n;
}

static void ply_in_three_formats(void **state)
{
    static const char *const format[] = {"ascii", "binary_little_endian", "binary_big_endian"};
    const float p[4][3] = {{0, 0, 0}, {1, 0, 0}, {1, 2, 0}, {0, 1.5f, -1}};
    for (int f = 0; f < 3; f++) {
        char file[2048], *at = file;
        at = print(at,
                   "ply\nformat %s 1.0\ncomment x\nelement vertex 4\nproperty uchar flag\n"
                   "property float x\nproperty double y\nproperty float z\n"
                   "element face 2\nproperty list uchar int vertex_indices\n"
                   "property short group\nelement tristrips 1\n"
                   "property list int int vertex_indices\nend_header\n",
                   format[f]);
        // the second strip begins anew after an odd one
        const int32_t strip[10] = {9, 0, 1, 2, -1, 0, 1, 2, 3, -1};
        if (f == 0) {
            for (int v = 0; v < 4; v++)
                at = print(at, "7 %g %g %g\n", p[v][0], p[v][1], p[v][2]);
            at = print(at, "4 0 1 2 3 5\n3 0 1 3 -5\n9 0 1 2 -1 0 1 2 3 -1\n");
        } else {
            for (int v = 0; v < 4; v++) {
                double y = p[v][1];
                *at++ = 7;
                put_swapped(&at, &p[v][0], 4, f == 2);
                put_swapped(&at, &y, 8, f == 2);
                put_swapped(&at, &p[v][2], 4, f == 2);
            }
            const int32_t faces[2][5] = {{4, 0, 1, 2, 3}, {3, 0, 1, 3}};
            for (int k = 0; k < 2; k++) {
                int16_t group = 300;
                *at++ = (char)faces[k][0];
                for (int i = 1; i <= faces[k][0]; i++)
                    put_swapped(&at, &faces[k][i], 4, f == 2);
                put_swapped(&at, &group, 2, f == 2);
            }
            for (int i = 0; i < 10; i++) put_swapped(&at, &strip[i], 4, f == 2);
        }
        struct prt_context ctx = context();
        struct prt_mesh *m = NULL;
        int status = prt_mesh_load_memory(&ctx, "m", file, (size_t)(at - file), NULL, NULL, &m);
        if (status) fail_msg("%s: %s", format[f], lines);
        assert_int_equal(m->n_vertex, 4);
        const uint32_t want[6][3] = {{0, 1, 2}, {0, 2, 3}, {0, 1, 3},
                                     {0, 1, 2}, {0, 1, 2}, {2, 1, 3}};
        assert_int_equal(m->n_triangle, 6);
        assert_memory_equal(m->triangle, want, sizeof want);
        assert_memory_equal(m->position, p, sizeof p);
        prt_mesh_destroy(m);
        status =
            prt_mesh_load_memory(&ctx, "m.ply", file, (size_t)(at - file) - 4, NULL, NULL, &m);
        assert_int_equal(status, PRT_FORMAT);
    }
}

// Normals of any length, coordinates whose v counts upwards, and signed whole numbers.
static void ply_numbers(void **state)
{
    static const char head[] =
        "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty short x\n"
        "property char y\nproperty int z\nproperty char nx\nproperty char ny\n"
        "property char nz\nproperty uchar s\nproperty uchar t\nelement face 1\n"
        "property list uchar ushort vertex_indices\nend_header\n";
    static const unsigned char body[] = {
        0xff, 0xfe, 0xfd, 0xff, 0xff, 0xff, 0xfc, 0, 3, 4,    2, 3, // -2 -3 -4
        1,    0,    0,    0,    0,    0,    0,    0, 3, 0xfc, 0, 1, // 256 0 0
        0,    0,    7,    0,    0,    1,    0,    0, 0, 5,    1, 0, // 0 7 256
        3,    0,    0,    0,    1,    0,    2};
    char file[sizeof head + sizeof body];
    struct prt_context ctx = context();
    struct prt_mesh *m = NULL;
    memcpy(file, head, sizeof head - 1);
    memcpy(file + sizeof head - 1, body, sizeof body);
    assert_int_equal(prt_mesh_load_memory(&ctx, "m.ply", file, sizeof head - 1 + sizeof body,
                                          NULL, NULL, &m),
                     PRT_OK);
    const float p[3][3] = {{-2, -3, -4}, {256, 0, 0}, {0, 7, 256}};
    const float n[3][3] = {{0, 0.6f, 0.8f}, {0, 0.6f, -0.8f}, {0, 0, 1}};
    const float uv[3][2] = {{2, -2}, {0, 0}, {1, 1}};
    assert_memory_equal(m->position, p, sizeof p);
    assert_memory_equal(m->uv, uv, sizeof uv);
    for (int v = 0; v < 3; v++)
        for (int c = 0; c < 3; c++) assert_float_equal(m->normal[v][c], n[v][c], 1e-6);
    prt_mesh_destroy(m);
}

// Two triangles that touch at an edge on y = 0, which one of them writes as -0: one surface.
static void zero_has_one_place(void **state)
{
    struct prt_mesh *m = must_load("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 -0 -0\nv -0 -0 -0\n"
                                   "v 0 -1 0\nf 1 2 3\nf 4 5 6\n");
    assert_int_equal(m->n_weld, 4);
    assert_int_equal(m->weld[0], m->weld[4]);
    prt_mesh_destroy(m);
}

// Faces of two objects in turns: each triangle keeps the texture coordinates of its corners,
// which differ at a seam, and the opaque object has a surface of its own.
static void obj_faces_in_turns(void **state)
{
    static const char *const opaque[] = {"b", NULL};
    const struct prt_mesh_options options = {.opaque = opaque}, flip = {.flip_v = true},
                                  plain = {.no_textures = true};
    struct prt_mesh *m;
    const char *text = "usemtl wax\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 5 0 0\nv 6 0 0\n"
                       "v 5 1 0\nv 5 0 1\nvt 0 0\nvt .25 0\nvt .5 0\nvt .75 0\n"
                       "o a\nf 1/1 2/1 3/1\no b\nf 5/2 6/2 7/2\n"
                       "o a\nf 1/3 3/3 4/3\no b\nf 5/4 7/4 8/4\n";
    assert_int_equal(load_text(text, &options, &m), PRT_OK);
    assert_int_equal(m->n_block, 2);
    assert_non_null(m->corner_uv);
    for (int t = 0; t < 4; t++)
        for (int c = 0; c < 3; c++)
            assert_float_equal(m->corner_uv[t][c][0], (float)(t / 2 + 2 * (t % 2)) / 4, 0);
    assert_int_equal(m->surface[m->block[0].surface].translucent, 1);
    assert_int_equal(m->surface[m->block[1].surface].translucent, 0);
    assert_float_equal(m->corner_uv[3][2][1], 1, 0); // OBJ's v counts upwards
    prt_mesh_destroy(m);
    assert_int_equal(load_text(text, &flip, &m), PRT_OK);
    for (int t = 0; t < 4; t++)
        for (int c = 0; c < 3; c++) assert_float_equal(m->corner_uv[t][c][1], 0, 0);
    prt_mesh_destroy(m);
    assert_int_equal(load_text(text, &plain, &m), PRT_OK); // maps of the caller's follow seams
    assert_non_null(m->corner_uv);
    assert_float_equal(m->corner_uv[1][0][0], 0.5, 0);
    prt_mesh_destroy(m);
}

// ---- arrays, scale, writing

static struct prt_mesh *make_tetrahedron(void)
{
    struct prt_mesh *m = NULL;
    struct prt_context ctx = context();
    uint32_t triangle[4][3];
    for (int i = 0; i < 12; i++) triangle[i / 3][i % 3] = tetrahedron.i[i];
    assert_int_equal(
        prt_mesh_create(&ctx, 4, tetrahedron.p, NULL, 4, (const uint32_t(*)[3])triangle, &m),
        PRT_OK);
    return m;
}

static void scale_is_refused_or_done(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m = make_tetrahedron();
    float box[2][3];
    assert_int_equal(prt_mesh_scale(&ctx, m, 0, 0), PRT_ARG);
    assert_int_equal(prt_mesh_scale(&ctx, m, -1, 0), PRT_ARG);
    assert_int_equal(prt_mesh_scale(&ctx, m, NAN, 0), PRT_ARG);
    assert_int_equal(prt_mesh_scale(&ctx, m, 0, INFINITY), PRT_ARG);
    assert_int_equal(prt_mesh_scale(&ctx, m, 1e9, 0), PRT_ARG);
    assert_int_equal(prt_mesh_scale(&ctx, m, 50, 0), PRT_OK);
    assert_int_equal(prt_mesh_scale(&ctx, m, 50, 0), PRT_ARG); // once only
    prt_mesh_bounds(m, box);
    assert_float_equal(box[1][0] - box[0][0], 50 / sqrt(3), 1e-4);
    assert_float_equal(m->mm_per_unit, 50 / sqrt(3), 1e-4);
    prt_mesh_destroy(m);
    uint32_t beyond[1][3] = {{0, 1, 4}};
    assert_int_equal(
        prt_mesh_create(&ctx, 4, tetrahedron.p, NULL, 1, (const uint32_t(*)[3])beyond, &m),
        PRT_ARG);
}

static void colours_round_trip(void **state)
{
    struct prt_context ctx = context();
    struct prt_mesh *m = make_tetrahedron(), *back = NULL;
    const float color[4][3] = {{0, 0.5f, 1}, {2, 3, 4}, {1e-3f, 0, 7}, {0.25f, 0.125f, 9}};
    assert_int_equal(prt_mesh_scale(&ctx, m, 0, 2), PRT_OK);
    static const char *const name[] = {"/tmp/prt-mesh-%d.ply", "/tmp/prt-mesh-%d.glb"};
    for (int k = 0; k < 2; k++) {
        char path[64];
        struct prt_blob file;
        snprintf(path, sizeof path, name[k], (int)getpid());
        assert_int_equal(prt_mesh_write_colors(&ctx, path, m, color), PRT_OK);
        assert_int_equal(prt_mesh_load(&ctx, path, NULL, &back), PRT_OK);
        assert_int_equal(back->n_vertex, 4);
        assert_int_equal(back->n_triangle, 4);
        assert_memory_equal(back->triangle, m->triangle, 48);
        for (int v = 0; v < 4; v++)
            for (int c = 0; c < 3; c++) {
                assert_float_equal(back->position[v][c], tetrahedron.p[v][c], 1e-6);
                assert_float_equal(back->normal[v][c], m->normal[v][c], 1e-6);
            }
        assert_int_equal(prt_read_file(&ctx, path, 1 << 20, &file), PRT_OK);
        const char *at = k ? memmem(file.bytes, file.size, color, sizeof color)
                           : memmem(file.bytes, file.size, color[1], sizeof color[1]);
        assert_non_null(at);
        prt_free(file.bytes);
        prt_mesh_destroy(back);
        unlink(path);
    }
    assert_int_equal(prt_mesh_write_colors(&ctx, "/tmp/x.stl", m, color), PRT_ARG);
    prt_mesh_destroy(m);
}

// The first chunk of a GLB is its JSON, and a later one of that type is not read: neither
// checked in its place nor used. The length of the later one makes the reader build a GLB of
// its own.
static void later_json_of_a_glb(void **state)
{
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":72}]," TETRA_VIEWS
        ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}],"
        "\"nodes\":[{\"mesh\":0}]}   ";
    static const char other[] = "{\"meshes\":0}";
    const uint32_t n = (sizeof json - 1) / 4 * 4, more = sizeof other - 2;
    const uint32_t total = 36 + n + sizeof tetrahedron + (more + 3) / 4 * 4;
    const uint32_t head[] = {0x46546c67, 2, total, n, 0x4e4f534a};
    const uint32_t bin[] = {sizeof tetrahedron, 0x004e4942}, third[] = {more, 0x4e4f534a};
    struct prt_context ctx = context();
    struct prt_mesh *m;
    uint8_t file[2048], *at = file;
    assert_true(total <= sizeof file);
    memcpy(at, head, sizeof head), at += sizeof head;
    memcpy(at, json, n), at += n;
    memcpy(at, bin, sizeof bin), at += sizeof bin;
    memcpy(at, &tetrahedron, sizeof tetrahedron), at += sizeof tetrahedron;
    memcpy(at, third, sizeof third), at += sizeof third;
    memcpy(at, other, sizeof other - 1);
    if (prt_mesh_load_memory(&ctx, "a.glb", file, total, NULL, NULL, &m)) fail_msg("%s", lines);
    assert_float_equal(volume(m), 1 / 6., 1e-6);
    prt_mesh_destroy(m);
}

// A GLB keeps the blocks of a mesh: an octahedron and a tetrahedron have other numbers of
// triangles than of vertices.
static void blocks_round_trip(void **state)
{
    static const char text[] =
        "o a\nv 1 0 0\nv -1 0 0\nv 0 1 0\nv 0 -1 0\nv 0 0 1\nv 0 0 -1\n"
        "f 1 3 5\nf 3 2 5\nf 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n"
        "o b\nv 3 0 0\nv 4 0 0\nv 3 1 0\nv 3 0 1\nf 7 9 8\nf 7 8 10\nf 7 10 9\nf 8 9 10\n";
    struct prt_context ctx = context();
    struct prt_mesh *m = NULL, *back = NULL;
    const float color[10][3] = {{0}};
    char path[64];
    snprintf(path, sizeof path, "/tmp/prt-mesh-%d.glb", (int)getpid());
    assert_int_equal(prt_mesh_load_memory(&ctx, "m.obj", text, sizeof text - 1, NULL, NULL, &m),
                     PRT_OK);
    assert_int_equal(m->n_block, 2);
    assert_int_equal(prt_mesh_write_colors(&ctx, path, m, color), PRT_OK);
    assert_int_equal(prt_mesh_load(&ctx, path, NULL, &back), PRT_OK);
    unlink(path);
    assert_int_equal(back->n_block, 2);
    for (uint32_t i = 0; i < 2; i++) {
        assert_int_equal(back->block[i].n_vertex, i ? 4 : 6);
        assert_int_equal(back->block[i].n_triangle, i ? 4 : 8);
        assert_int_equal(back->block[i].vertex_begin, i ? 6 : 0);
        assert_int_equal(back->block[i].triangle_begin, i ? 8 : 0);
    }
    assert_memory_equal(back->triangle, m->triangle, 12 * sizeof *m->triangle);
    prt_mesh_destroy(back);
    prt_mesh_destroy(m);
}

// ---- the development data

struct expected {
    const char *file;
    uint32_t n_vertex, n_triangle, n_boundary, n_nonmanifold;
};

// vertices and triangles as data/README.md lists them
static const struct expected models[] = {
    {"armadillo.glb", 43243, 86482, 0, 0},
    {"armadillo.obj", 43243, 86482, 0, 0},
    {"bunny.glb", 34835, 69666, 0, 0},
    {"bunny.gltf", 34835, 69666, 0, 0},
    {"bunny_draco.glb", 34835, 69666, 0, 0},
    {"bunny_meshopt.glb", 34835, 69666, 0, 0},
    {"bunny_quantized.glb", 34835, 69666, 0, 0},
    {"bunny_zipper_open.ply", 35947, 69451, 223, 0},
    {"dragon_100k.glb", 99891, 199998, 0, 0},
    {"dragon_30k.glb", 29891, 59998, 0, 0},
    {"dragon_6k.glb", 5891, 11998, 0, 0},
    {"dragon_full_435k_meshopt.glb", 435545, 871306, 0, 18},
    {"dragon_res3_nonmanifold.ply", 22998, 47794, 0, 2094},
    {"duck.glb", 2399, 4212, 0, 0},
    {"happy_buddha.glb", 29609, 51414, 0, 0},
    {"happy_buddha_50k_nonmanifold.glb", 49950, 100000, 0, 50},
    {"lee_perry_smith.glb", 9223, 17684, 0, 4},
    {"lee_perry_smith_draco.glb", 9223, 17684, 0, 4},
    {"max_planck_5k_nonormals.glb", 5272, 10540, 0, 0},
    {"slab_100x2x100mm.glb", 13442, 26880, 0, 0},
    {"sphere_r10mm.glb", 40962, 81920, 0, 0},
    {"spot.glb", 3225, 5856, 0, 0},
    {"spot.obj", 2930, 5856, 0, 0},
    {"suzanne.glb", 8098, 15744, 168, 0},
    {"suzanne_draco.glb", 7503, 14842, 160, 0},
    {"features/Mesh_PrimitiveMode_04.gltf", 4, 2, 4, 0},
    {"features/Mesh_PrimitiveMode_06.gltf", 6, 2, 4, 0},
    {"features/Mesh_PrimitiveMode_12.gltf", 4, 2, 4, 0},
    {"features/Mesh_PrimitiveMode_14.gltf", 4, 2, 4, 0},
    {"features/SimpleSparseAccessor.gltf", 14, 12, 14, 0},
    {"features/cube_att.gltf", 96, 48, 0, 0},
    {"features/Triangle_translation_only_matrix.gltf", 3, 1, 3, 0},
    {"features/BoxTextured_meshopt.glb", 24, 12, 0, 0},
    {"features/BoxDraco.glb", 24, 12, 0, 0},
    {"features/triangle_strip_mode5.gltf", 104696, 2786, 2656, 0},
    {"features/no_indices_building.glb", 216, 72, 0, 12},
    {"features/Box.gltf", 24, 12, 0, 0},
    // points and lines only
    {"features/Mesh_PrimitiveMode_00.gltf", 0, 0, 0, 0},
    {"features/Mesh_PrimitiveMode_02.gltf", 0, 0, 0, 0},
    {"features/Mesh_PrimitiveMode_08.gltf", 0, 0, 0, 0},
    {"features/Mesh_PrimitiveMode_10.gltf", 0, 0, 0, 0},
};

static int load_model(const char *name, struct prt_mesh **out)
{
    char path[512];
    struct prt_context ctx = context();
    snprintf(path, sizeof path, PRT_SHARED_DATA "/models/%s", name);
    *out = NULL;
    return prt_mesh_load(&ctx, path, NULL, out);
}

static void data_counts(void **state)
{
    want_data(PRT_SHARED_DATA "/models");
    for (size_t i = 0; i < sizeof models / sizeof *models; i++) {
        const struct expected *e = &models[i];
        struct prt_mesh *m;
        int status = load_model(e->file, &m);
        if ((status == PRT_OK) != (e->n_vertex > 0))
            fail_msg("%s: %d %s", e->file, status, lines);
        if (status) continue;
        if (m->n_vertex != e->n_vertex || m->n_triangle != e->n_triangle ||
            m->n_boundary_edge != e->n_boundary || m->n_nonmanifold_edge != e->n_nonmanifold)
            fail_msg("%s: %u vertices, %u triangles, %u boundary, %u non-manifold edges",
                     e->file, m->n_vertex, m->n_triangle, m->n_boundary_edge,
                     m->n_nonmanifold_edge);
        for (uint32_t v = 0; v < m->n_vertex; v++) {
            const float *n = m->normal[v];
            float l = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
            if (!(fabsf(l - 1) < 1e-5f))
                fail_msg("%s: normal %u has length^2 %g", e->file, v, l);
        }
        prt_mesh_destroy(m);
    }
}

// 7e-6 is what the file's own 16-bit values are off, decoded independently.
// Each vertex of the variant has one of the original within tol, and a normal close to its.
static void data_variants_agree(void **state)
{
    static const struct {
        const char *file;
        double tol;
        bool same_order;
    } variant[] = {{"bunny.gltf", 0, true},
                   {"bunny_quantized.glb", 7e-6, true},
                   {"bunny_meshopt.glb", 7e-6, false},
                   {"bunny_draco.glb", 6e-5, false}};
    struct prt_mesh *a, *b;
    want_data(PRT_SHARED_DATA "/models");
    assert_int_equal(load_model("bunny.glb", &a), PRT_OK);
    for (size_t k = 0; k < sizeof variant / sizeof *variant; k++) {
        assert_int_equal(load_model(variant[k].file, &b), PRT_OK);
        float box[2][2][3];
        prt_mesh_bounds(a, box[0]);
        prt_mesh_bounds(b, box[1]);
        double worst = 0, volumes[2] = {volume(a), volume(b)};
        for (int i = 0; i < 6; i++)
            worst = fmax(worst, fabs(box[0][i / 3][i % 3] - box[1][i / 3][i % 3]));
        for (uint32_t v = 0; variant[k].same_order && v < a->n_vertex; v++)
            for (int c = 0; c < 3; c++)
                worst = fmax(worst, fabs(a->position[v][c] - b->position[v][c]));
        if (worst > variant[k].tol) fail_msg("%s: off by %g", variant[k].file, worst);
        assert_true(fabs(volumes[0] - volumes[1]) < 2e-3 * volumes[0]);
        // file normals agree with faces: flux of n over the surface ~ area
        double flux = 0;
        for (uint32_t v = 0; v < b->n_vertex; v += 97) {
            double best = 1, dot = 0;
            for (uint32_t w = 0; w < a->n_vertex; w++) {
                double d = 0;
                for (int c = 0; c < 3; c++) d += pow(a->position[w][c] - b->position[v][c], 2);
                if (d >= best) continue;
                best = d;
                dot = a->normal[w][0] * b->normal[v][0] + a->normal[w][1] * b->normal[v][1] +
                      a->normal[w][2] * b->normal[v][2];
            }
            flux += dot > 0.98;
        }
        if (flux < 0.97 * b->n_vertex / 97) fail_msg("%s: normals differ", variant[k].file);
        prt_mesh_destroy(b);
    }
    prt_mesh_destroy(a);
}

static void data_dragon_is_translucent(void **state)
{
    struct prt_mesh *m;
    struct prt_context ctx = context();
    want_data(PRT_SHARED_DATA "/models");
    assert_int_equal(load_model("dragon_100k.glb", &m), PRT_OK);
    assert_int_equal(m->surface[m->block[0].surface].translucent, 1);
    assert_int_equal(prt_mesh_scale(&ctx, m, 0, 0), PRT_OK); // glTF is in metres
    assert_float_equal(m->mm_per_unit, 1000, 0);
    prt_mesh_destroy(m);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nodes_make_objects),
        cmocka_unit_test(rotations_keep_lengths),
        cmocka_unit_test(uncounted_padding_of_a_glb),
        cmocka_unit_test(later_json_of_a_glb),
        cmocka_unit_test(normals_are_angle_weighted),
        cmocka_unit_test(opposite_windings_are_told),
        cmocka_unit_test(mirrored_normals_point_out),
        cmocka_unit_test(modes_give_triangles),
        cmocka_unit_test(accessors_end_in_their_view),
        cmocka_unit_test(incomplete_triangles_are_counted),
        cmocka_unit_test(sparse_and_normalised),
        cmocka_unit_test(accessors_without_a_view_are_zero),
        cmocka_unit_test(bytes_are_normalised),
        cmocka_unit_test(materials_decide),
        cmocka_unit_test(variants_have_names_of_their_own),
        cmocka_unit_test(limits_hold),
        cmocka_unit_test(faults_are_named),
        cmocka_unit_test(what_is_not_read_cannot_fail),
        cmocka_unit_test(buffers_stay_in_the_folder),
        cmocka_unit_test(obj_keeps_its_vertices),
        cmocka_unit_test(obj_lines_go_on),
        cmocka_unit_test(obj_libraries_add_up),
        cmocka_unit_test(ply_in_three_formats),
        cmocka_unit_test(ply_numbers),
        cmocka_unit_test(zero_has_one_place),
        cmocka_unit_test(unnamed_surfaces),
        cmocka_unit_test(colours_are_of_their_object),
        cmocka_unit_test(obj_faces_in_turns),
        cmocka_unit_test(scale_is_refused_or_done),
        cmocka_unit_test(colours_round_trip),
        cmocka_unit_test(blocks_round_trip),
        cmocka_unit_test(data_counts),
        cmocka_unit_test(data_variants_agree),
        cmocka_unit_test(data_dragon_is_translucent),
    };
    return run_test_group(tests, NULL, NULL);
}
