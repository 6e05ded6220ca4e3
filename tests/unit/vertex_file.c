// SPDX-License-Identifier: MIT
// CSV, NPY, PLY and GLB: bytes of a small mesh, and NPY files that are damaged.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "vertex_file.h"
#include <cjson/cJSON.h>

// Two triangles of two objects and a block of one vertex without triangles.
enum { N_VERTEX = 7, N_TRIANGLE = 2 };
static const float position[N_VERTEX][3] = {{0, 0, 0}, {2, 0, 0}, {0, 4, 0}, {0, 0, 6},
                                            {8, 0, 6}, {0, 8, 6}, {1, 1, 1}};
static const float color[N_VERTEX][3] = {{0.1f, 0.2f, 0.3f}, {1e-9f, 1e9f, 0}, {3, 4, 5},
                                         {6, 7, 8},          {9, 10, 11},      {12, 13, 14},
                                         {15, 16, 17}};
static const uint32_t triangle[N_TRIANGLE][3] = {{0, 1, 2}, {3, 5, 4}};
static const struct prt_vertex_block block[] = {
    {0, 0, 3, 0, 1}, {1, 3, 3, 1, 1}, {1, 6, 1, 2, 0}, {2, 6, 2, 2, 0}, {3, 0, 3, 1, 2}};

static struct prt_vertex_data mesh(void)
{
    return (struct prt_vertex_data){.n_vertex = N_VERTEX,
                                    .n_triangle = N_TRIANGLE,
                                    .position = position,
                                    .unit = 2,
                                    .color = color,
                                    .triangle = triangle,
                                    .block = block,
                                    .n_block = sizeof block / sizeof *block,
                                    .generator = "test"};
}

static char *write_file(enum prt_vertex_format format, const struct prt_vertex_data *data,
                        size_t *n)
{
    enum { MOST = 1 << 16 };
    char *bytes = malloc(MOST);
    FILE *f = fmemopen(bytes, MOST, "w");
    assert_non_null(f);
    assert_int_equal(prt_vertex_file_write(f, format, data), 0);
    *n = (size_t)ftell(f);
    assert_int_equal(fclose(f), 0); // appends a zero byte
    return bytes;
}

static void an_ending_names_a_format(void **state)
{
    assert_int_equal(prt_vertex_format_of("a.csv"), PRT_VERTEX_CSV);
    assert_int_equal(prt_vertex_format_of("a.b/c.NPY"), PRT_VERTEX_NPY);
    assert_int_equal(prt_vertex_format_of("a.Ply"), PRT_VERTEX_PLY);
    assert_int_equal(prt_vertex_format_of("a.glb"), PRT_VERTEX_GLB);
    assert_int_equal(prt_vertex_format_of("a.glb.txt"), PRT_VERTEX_NONE);
    assert_int_equal(prt_vertex_format_of(".csv"), PRT_VERTEX_NONE);
    assert_int_equal(prt_vertex_format_of(""), PRT_VERTEX_NONE);
    assert_int_equal(prt_vertex_format_of(NULL), PRT_VERTEX_NONE);
    assert_true(prt_vertex_format_has_mesh(PRT_VERTEX_GLB));
    assert_false(prt_vertex_format_has_mesh(PRT_VERTEX_NPY));
}

static void a_csv_has_a_header_and_nine_digits(void **state)
{
    struct prt_vertex_data data = {.n_vertex = 2, .color = color};
    size_t n;
    char *bytes = write_file(PRT_VERTEX_CSV, &data, &n);
    assert_string_equal(bytes, "vertex,r,g,b\n0,0.100000001,0.200000003,0.300000012\n"
                               "1,9.99999972e-10,1e+09,0\n");
    free(bytes);
}

static void an_npy_is_read_back(void **state)
{
    struct prt_vertex_data data = mesh();
    struct prt_npy npy;
    float back[N_VERTEX][3];
    size_t n;
    char *bytes = write_file(PRT_VERTEX_NPY, &data, &n);
    assert_int_equal(n, 128 + sizeof color);
    assert_int_equal(bytes[127], '\n');
    assert_null(prt_npy_parse(bytes, n, &npy));
    assert_int_equal(npy.n, N_VERTEX);
    assert_false(npy.is_f64);
    prt_npy_rows(&npy, back);
    assert_memory_equal(back, color, sizeof color);
    // Any cut is refused, and so are other types, shapes and orders.
    for (size_t cut = 0; cut < n; cut++) assert_non_null(prt_npy_parse(bytes, cut, &npy));
    static const char *const wrong[][2] = {
        {"<f4", "<i4"}, {"False", "True "}, {"(7, 3)", "(7, 4)"}};
    for (int i = 0; i < 3; i++) {
        char *at = strstr(bytes + 10, wrong[i][0]);
        assert_non_null(at);
        memcpy(at, wrong[i][1], strlen(wrong[i][1]));
        assert_non_null(prt_npy_parse(bytes, n, &npy));
        assert_int_equal(npy.n, 0);
        memcpy(at, wrong[i][0], strlen(wrong[i][0]));
    }
    assert_null(prt_npy_parse(bytes, n, &npy));
    free(bytes);
    // Without colours the positions are written, in the file's unit.
    data.color = NULL;
    bytes = write_file(PRT_VERTEX_NPY, &data, &n);
    assert_null(prt_npy_parse(bytes, n, &npy));
    prt_npy_rows(&npy, back);
    assert_float_equal(back[4][0], 4, 0);
    free(bytes);
}

static void an_npy_of_doubles_is_rounded(void **state)
{
    static const char header[] =
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 3), }\n";
    char file[10 + sizeof header - 1 + 24] = "\x93NUMPY\x01";
    const double row[3] = {0.1, 1e300, -3};
    struct prt_npy npy;
    float back[1][3];
    file[8] = sizeof header - 1;
    memcpy(file + 10, header, sizeof header - 1);
    memcpy(file + 10 + sizeof header - 1, row, sizeof row);
    assert_null(prt_npy_parse(file, sizeof file, &npy));
    assert_true(npy.is_f64);
    prt_npy_rows(&npy, back);
    assert_float_equal(back[0][0], 0.1f, 0);
    assert_float_equal(back[0][2], -3, 0);
}

// Versions 2 and 3 have a header length of four bytes, so that the header begins at byte 12.
static void an_npy_of_version_2(void **state)
{
    static const char header[] =
        "{'descr': '<f4', 'fortran_order': False, 'shape': (1, 3), }   \n";
    char file[12 + sizeof header - 1 + 12] = "\x93NUMPY\x02";
    const float row[3] = {0.1f, 2, -3};
    struct prt_npy npy;
    float back[1][3];
    file[8] = sizeof header - 1;
    memcpy(file + 12, header, sizeof header - 1);
    memcpy(file + 12 + sizeof header - 1, row, sizeof row);
    assert_null(prt_npy_parse(file, sizeof file, &npy));
    prt_npy_rows(&npy, back);
    assert_memory_equal(back[0], row, sizeof row);
    assert_non_null(prt_npy_parse(file, sizeof file - 1, &npy));
    file[6] = 4;
    assert_non_null(prt_npy_parse(file, sizeof file, &npy));
}

static void a_ply_has_vertices_and_triangles(void **state)
{
    struct prt_vertex_data data = mesh();
    size_t n;
    char *bytes = write_file(PRT_VERTEX_PLY, &data, &n);
    const char *end = strstr(bytes, "end_header\n");
    assert_non_null(end);
    assert_non_null(strstr(bytes, "element vertex 7\n"));
    assert_non_null(strstr(bytes, "comment linear RGB\n"));
    assert_null(strstr(bytes, "property float nx"));
    size_t header = (size_t)(end - bytes) + strlen("end_header\n");
    assert_int_equal(n, header + N_VERTEX * 24 + N_TRIANGLE * 13);
    float row[6];
    memcpy(row, bytes + header + 24, sizeof row);
    assert_float_equal(row[0], 1, 0); // 2 in units of 2
    assert_memory_equal(row + 3, color[1], 12);
    free(bytes);
}

static double item(const cJSON *array, int i, const char *key)
{
    const cJSON *value = cJSON_GetObjectItem(cJSON_GetArrayItem(array, i), key);
    assert_non_null(value);
    return value->valuedouble;
}

// Blocks that reach beyond the arrays are left out; one without triangles becomes points.
static void a_glb_has_a_mesh_for_each_object(void **state)
{
    struct prt_vertex_data data = mesh();
    size_t n;
    uint32_t head[5], index[N_TRIANGLE][3];
    char *bytes = write_file(PRT_VERTEX_GLB, &data, &n);
    memcpy(head, bytes, sizeof head);
    assert_memory_equal(bytes, "glTF\2\0\0\0", 8);
    assert_int_equal(head[2], n);
    cJSON *json = cJSON_ParseWithLength(bytes + 20, head[3]);
    assert_non_null(json);
    const cJSON *meshes = cJSON_GetObjectItem(json, "meshes");
    const cJSON *accessors = cJSON_GetObjectItem(json, "accessors");
    assert_int_equal(cJSON_GetArraySize(meshes), 2);
    assert_int_equal(cJSON_GetArraySize(cJSON_GetObjectItem(json, "nodes")), 2);
    const cJSON *second = cJSON_GetObjectItem(cJSON_GetArrayItem(meshes, 1), "primitives");
    assert_int_equal(cJSON_GetArraySize(second), 2);
    assert_int_equal(item(second, 1, "mode"), 0);
    assert_int_equal(cJSON_GetArraySize(accessors), 3 + 3 + 2);
    assert_int_equal(item(accessors, 3, "byteOffset"), 36);
    // glTF 2.0: 5126 floats in threes of a stride, 5125 whole numbers for indices.
    const cJSON *views = cJSON_GetObjectItem(json, "bufferViews");
    for (int i = 0; i < 3 + 3 + 2; i++) {
        const cJSON *a = cJSON_GetArrayItem(accessors, i),
                    *type = cJSON_GetObjectItem(a, "type");
        const bool whole = i == 2 || i == 5;
        const int view = (int)item(accessors, i, "bufferView");
        assert_int_equal(item(accessors, i, "componentType"), whole ? 5125 : 5126);
        assert_string_equal(cJSON_GetStringValue(type), whole ? "SCALAR" : "VEC3");
        assert_int_equal(item(views, view, "target"), whole ? 34963 : 34962);
        if (!whole) assert_int_equal(item(views, view, "byteStride"), 12);
    }
    const cJSON *max = cJSON_GetObjectItem(cJSON_GetArrayItem(accessors, 3), "max");
    assert_float_equal(cJSON_GetArrayItem(max, 0)->valuedouble, 4, 0);
    memcpy(index, bytes + n - sizeof index, sizeof index);
    const uint32_t local[N_TRIANGLE][3] = {{0, 1, 2}, {0, 2, 1}};
    assert_memory_equal(index, local, sizeof local);
    cJSON_Delete(json);
    free(bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_ending_names_a_format),
        cmocka_unit_test(a_csv_has_a_header_and_nine_digits),
        cmocka_unit_test(an_npy_is_read_back),
        cmocka_unit_test(an_npy_of_doubles_is_rounded),
        cmocka_unit_test(an_npy_of_version_2),
        cmocka_unit_test(a_ply_has_vertices_and_triangles),
        cmocka_unit_test(a_glb_has_a_mesh_for_each_object),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
