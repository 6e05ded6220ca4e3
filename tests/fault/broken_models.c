// SPDX-License-Identifier: MIT
// Real broken models: each is refused with a line that names it, or loads; none crashes, hangs
// or takes more than its limit. Without the development data one damaged in here stands for
// all.
#include "prt/mesh.h"

#include <ftw.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <unistd.h>
#include <cmocka.h>

#include "../data.h"

static int n_file, n_refused, n_failed;
static int n_error;
static char last_error[1100];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_ERROR) return;
    n_error++;
    snprintf(last_error, sizeof last_error, "%s", line);
}

static void complain(const char *path, const char *what)
{
    print_error("%s: %s (%s)\n", path, what, last_error);
    n_failed++;
}

static void check_mesh(const char *path, const struct prt_mesh *m)
{
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        const float *n = m->normal[v], *p = m->position[v];
        float l = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        if (!(fabsf(l - 1) < 1e-3f) || !isfinite(p[0] + p[1] + p[2]) ||
            m->weld[v] >= m->n_weld) {
            complain(path, "a vertex is not sane");
            return;
        }
    }
}

static int one_file(const char *path, const struct stat *st, int type, struct FTW *ftw)
{
    struct prt_context ctx;
    struct prt_mesh *mesh = NULL;
    if (type != FTW_F) return 0;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    ctx.memory_limit = 1u << 30;
    n_error = 0;
    last_error[0] = 0;
    double begin = prt_time_s();
    int status = prt_mesh_load(&ctx, path, NULL, &mesh);
    if (prt_time_s() - begin > 10) complain(path, "took more than 10 s");
    n_file++;
    if (status) {
        n_refused++;
        if (mesh) complain(path, "an error with a mesh");
        if (n_error != 1) complain(path, "not one error line");
        if (!strstr(last_error, path)) complain(path, "the error does not name the file");
        if (strstr(last_error, "crashed") && !strstr(path, "draco"))
            complain(path, "our own reader crashed");
    } else {
        if (n_error) complain(path, "success with an error line");
        check_mesh(path, mesh);
        prt_mesh_destroy(mesh);
    }
    return 0;
}

static void every_broken_model(void **state)
{
    static const char *const folder[] = {PRT_SHARED_DATA "/broken/gltf",
                                         PRT_SHARED_DATA "/broken/mesh"};
    want_data(folder[0]);
    for (int i = 0; i < 2; i++) assert_int_equal(nftw(folder[i], one_file, 16, FTW_PHYS), 0);
    print_message("%d files, %d refused\n", n_file, n_refused);
    assert_true(n_file > 200);
    assert_int_equal(n_failed, 0);
}

// What the manifest says must load or must be refused, and why.
static void files_of_the_manifest(void **state)
{
    static const struct {
        const char *file, *say;
        int status;
    } want[] = {
        {"gltf/derived/ok_reference.glb", "", PRT_OK},
        {"gltf/derived/node_scale_mirrored.glb", "", PRT_OK},
        {"gltf/derived/triangle_soup.glb", "", PRT_OK},
        {"gltf/derived/normals_zero_nan.glb", "", PRT_OK},
        {"gltf/derived/node_chain_20000.glb", "", PRT_OK},
        {"gltf/tinygltf/zero-sized-bin-chunk-issue-440.glb", "", PRT_OK},
        {"mesh/trimesh/nancolor.obj", "", PRT_OK},
        {"mesh/trimesh/negative_indices.obj", "", PRT_OK},
        {"gltf/derived/node_dag_2e40.glb", "instances", PRT_LIMIT},
        {"gltf/derived/accessor_without_bufferview_bomb.glb", "accessor", PRT_LIMIT},
        {"gltf/derived/json_nesting_200000.glb", "deeper", PRT_FORMAT},
        {"gltf/derived/required_unknown_extension.glb", "VENDOR_unknown", PRT_UNSUPPORTED},
        {"gltf/derived/uri_traversal.gltf", "inside the model's folder", PRT_FORMAT},
        {"gltf/derived/uri_percent_traversal.gltf", "inside the model's folder", PRT_FORMAT},
        {"gltf/derived/position_3e38.glb", "not finite", PRT_FORMAT},
        {"gltf/derived/all_vertices_coincident.glb", "one point", PRT_FORMAT},
        {"mesh/derived/obj_int_overflow.obj", "line", PRT_FORMAT},
        {"mesh/derived/ply_vertex_count_4e9.ply", "shorter", PRT_FORMAT},
    };
    want_data(PRT_SHARED_DATA "/broken");
    for (size_t i = 0; i < sizeof want / sizeof *want; i++) {
        char path[512];
        struct prt_context ctx;
        struct prt_mesh *mesh = NULL;
        snprintf(path, sizeof path, PRT_SHARED_DATA "/broken/%s", want[i].file);
        prt_context_init(&ctx);
        ctx.log = keep_line;
        last_error[0] = 0;
        int status = prt_mesh_load(&ctx, path, NULL, &mesh);
        if (status != want[i].status || !strstr(last_error, want[i].say))
            fail_msg("%s: status %d, %s", path, status, last_error);
        prt_mesh_destroy(mesh);
    }
}

// A GLB whose every byte is damaged in turn: three ways each.
static void every_byte_in_turn(void **state)
{
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[{\"mesh\":0}],\"meshes\":[{\"primitives\":"
        "["
        "{\"attributes\":{\"POSITION\":0}}]}],\"accessors\":[{\"bufferView\":0,\"count\":3,"
        "\"componentType\":5126,\"type\":\"VEC3\"}],\"bufferViews\":[{\"buffer\":0,"
        "\"byteLength\":36}],\"buffers\":[{\"byteLength\":36}]}";
    const float p[9] = {0, 0, 0, 1, 0, 0, 0, 1, 0};
    uint8_t file[512], copy[512];
    uint32_t n = (sizeof json - 1 + 3) & ~3u,
             head[5] = {0x46546c67, 2, 28 + n + 36, n, 0x4e4f534a}, chunk[2] = {36, 0x004e4942};
    memset(file, ' ', sizeof file);
    memcpy(file, head, 20);
    memcpy(file + 20, json, sizeof json - 1);
    memcpy(file + 20 + n, chunk, 8);
    memcpy(file + 28 + n, p, 36);
    struct prt_context ctx;
    struct prt_mesh *mesh = NULL;
    const struct prt_mesh_options options = {.in_process = true};
    prt_context_init(&ctx);
    ctx.log = keep_line;
    assert_int_equal(prt_mesh_load_memory(&ctx, "x", file, 64 + n, NULL, &options, &mesh), 0);
    prt_mesh_destroy(mesh);
    for (uint32_t i = 0; i < (64 + n) * 3; i++) {
        memcpy(copy, file, sizeof copy);
        copy[i / 3] ^= (uint8_t[]){1, 0x80, 0xff}[i % 3];
        mesh = NULL;
        n_error = 0;
        if (prt_mesh_load_memory(&ctx, "x", copy, 64 + n, NULL, &options, &mesh))
            assert_int_equal(n_error, 1);
        else check_mesh("x", mesh);
        prt_mesh_destroy(mesh);
        assert_int_not_equal(
            prt_mesh_load_memory(&ctx, "x", file, i / 3, NULL, &options, &mesh),
            PRT_OK); // and cut there
    }
    assert_int_equal(n_failed, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_byte_in_turn),
        cmocka_unit_test(every_broken_model),
        cmocka_unit_test(files_of_the_manifest),
    };
    return run_test_group(tests, NULL, NULL);
}
