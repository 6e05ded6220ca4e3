// SPDX-License-Identifier: MIT
// A bake in parts writes what one process writes, byte for byte, whatever the storage; parts
// that are missing, damaged or of another bake are told and not used.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bodies.h"
#include "expect.h"
#include "prt/bake.h"

static struct prt_context context;
static char folder[] = "/tmp/prt-shard-test-XXXXXX";
static char warned[512];

static const char *file(const char *name)
{
    static char path[4][256];
    static unsigned next;
    char *out = path[next++ % 4];
    snprintf(out, sizeof path[0], "%s/%s", folder, name);
    return out;
}

static void listen_in(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_NOTE) snprintf(user, sizeof warned, "%s", line);
}

// A ball of 20 mm over an opaque square: clusters of both kinds, and three of the ball.
static struct prt_mesh *scene(void)
{
    struct model m;
    model_init(&m, 48 * 33 + 4, 48 * 32 * 2 + 2);
    add_round_ball(&m, 48, 32, 10);
    const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
    add_floor(&m, 15, -11, 1);
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    split_opaque(mesh, n_vertex, n_triangle, (const float[]){0.8f, 0.6f, 0.4f});
    return mesh;
}

static struct prt_bake_options options(enum prt_transport_kind engine, enum prt_storage storage)
{
    struct prt_bake_options o = {
        .engine = engine, .storage = storage, .n_sample = 2000, .cube = 16, .seed = 3};
    assert_int_equal(prt_material_load(&context, "skin1", &o.material), PRT_OK);
    return o;
}

static void same_bytes(const char *one, const char *other)
{
    struct prt_blob a, b;
    assert_int_equal(prt_read_file(&context, one, 1u << 30, &a), PRT_OK);
    assert_int_equal(prt_read_file(&context, other, 1u << 30, &b), PRT_OK);
    assert_int_equal(a.size, b.size);
    assert_memory_equal(a.bytes, b.bytes, a.size);
    prt_free(a.bytes), prt_free(b.bytes);
}

// Three shards, the last first; only the one that ends last leaves a .prt.
static void parts_make_the_whole(struct prt_bake_options o)
{
    struct prt_mesh *mesh = scene();
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    uint32_t missing = 99;
    o.n_shard = 3;
    o.parts_missing = &missing;
    for (uint32_t i = 3; i-- > 0;) {
        o.shard = i;
        assert_int_not_equal(access(file("parts.prt"), F_OK), 0);
        assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_OK);
        assert_int_equal(missing, i);
    }
    same_bytes(file("whole.prt"), file("parts.prt"));
    for (uint32_t i = 0; i < 3; i++) {
        char name[64];
        snprintf(name, sizeof name, "parts.prt.%u-of-3.part", i);
        assert_int_not_equal(access(file(name), F_OK), 0);
    }
    assert_int_not_equal(access(file("parts.prt.0-of-3.assembling"), F_OK), 0);
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: three shards write the bytes of one bake, factored rows.
static void factored_wavelet(void **state)
{
    parts_make_the_whole(options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED));
}

// Contract of prt_bake: three shards write the bytes of one bake, sparse rows.
static void sparse_wavelet(void **state)
{
    parts_make_the_whole(options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_SPARSE));
}

// Contract of prt_bake: three shards write the bytes of one bake, joint transport.
static void joint(void **state)
{
    parts_make_the_whole(options(PRT_TRANSPORT_JOINT, PRT_STORAGE_FACTORED));
}

// Contract of prt_bake: three shards write the bytes of one bake, polynomial transport.
static void polynomial(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL, PRT_STORAGE_FACTORED);
    struct prt_env *env;
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    o.env = env;
    parts_make_the_whole(o);
    prt_env_destroy(env);
}

// Contract of prt_bake: a part that is damaged or of other settings is refused by name, and not
// used; a new one in its place is.
static void wrong_parts_are_refused(void **state)
{
    struct prt_mesh *mesh = scene();
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    struct prt_context c = context;
    uint32_t missing;
    c.log = listen_in, c.log_user = warned;
    o.no_single = true;
    o.n_shard = 2;
    o.parts_missing = &missing;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_OK);
    o.shard = 1, o.seed = 4;
    warned[0] = 0;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_OK);
    assert_int_equal(missing, 1);
    assert_non_null(strstr(warned, "0-of-2.part"));
    // Its middle turned over: found while assembling, and nothing half-written is left.
    o.seed = 3;
    FILE *f = fopen(file("w.prt.0-of-2.part"), "r+b");
    assert_non_null(f);
    fseek(f, 5000, SEEK_SET);
    int byte = fgetc(f);
    fseek(f, 5000, SEEK_SET);
    fputc(byte ^ 0xff, f);
    fclose(f);
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_FORMAT);
    assert_non_null(strstr(warned, "run shard 0/2 again"));
    assert_int_not_equal(access(file("w.prt"), F_OK), 0);
    unlink(file("w.prt.0-of-2.part"));
    o.shard = 0;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_OK);
    assert_int_equal(missing, 0);
    assert_int_equal(access(file("w.prt"), F_OK), 0);
    o.shard = 2;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_ARG);
    prt_mesh_destroy(mesh);
}

static int clean_up(void **state)
{
    static const char *const name[] = {"whole.prt", "parts.prt", "w.prt"};
    for (size_t i = 0; i < sizeof name / sizeof *name; i++) unlink(file(name[i]));
    return rmdir(folder);
}

int main(void)
{
    prt_context_init(&context);
    prt_pool_create(0, &context.pool);
    if (!mkdtemp(folder)) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(factored_wavelet),
        cmocka_unit_test(sparse_wavelet),
        cmocka_unit_test(joint),
        cmocka_unit_test(polynomial),
        cmocka_unit_test(wrong_parts_are_refused),
    };
    int failed = run_physics_tests(tests, NULL, clean_up);
    prt_pool_destroy(context.pool);
    return failed;
}
