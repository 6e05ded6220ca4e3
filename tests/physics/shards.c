// SPDX-License-Identifier: MIT
// A bake in parts, and one that is killed again and again, write what one process writes, byte
// for byte, whatever the storage; parts that are missing, damaged or of another bake are told
// and not used; finished work is not repeated.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "bake_parts.h"
#include "bodies.h"

static char warned[512];

static void listen_in(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_NOTE) snprintf(user, sizeof warned, "%s", line);
}

// Clusters of both kinds, and three of the ball.
static struct prt_mesh *scene(void)
{
    return ball_over_square(&context, 48, 32);
}

static struct prt_bake_options options(enum prt_transport_kind engine, enum prt_storage storage)
{
    struct prt_bake_options o = {
        .engine = engine, .storage = storage, .n_sample = 2000, .cube = 16, .seed = 3};
    static struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    o.media = prt_media_one(&skin);
    return o;
}

static void parted(struct prt_bake_options o)
{
    struct prt_mesh *mesh = scene();
    parts_make_the_whole(mesh, o);
    prt_mesh_destroy(mesh);
}

static void killed(struct prt_bake_options o, unsigned more)
{
    struct prt_mesh *mesh = scene();
    killed_makes_the_whole(mesh, o, more);
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: three shards write the bytes of one bake, factored rows.
static void factored_wavelet(void **state)
{
    parted(options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED));
}

// Contract of prt_bake: three shards write the bytes of one bake, sparse rows.
static void sparse_wavelet(void **state)
{
    parted(options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_SPARSE));
}

// Contract of prt_bake: three shards write the bytes of one bake, joint transport.
static void joint(void **state)
{
    parted(options(PRT_TRANSPORT_JOINT, PRT_STORAGE_FACTORED));
}

// Contract of prt_bake: three shards write the bytes of one bake, polynomial transport.
static void polynomial(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL, PRT_STORAGE_FACTORED);
    struct prt_env *env;
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    o.env = env;
    parted(o);
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
    // A byte of it inverted: found while assembling, and nothing half-written is left.
    o.seed = 3;
    assert_true(invert_byte(file("w.prt.0-of-2.part"), 5000));
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_FORMAT);
    assert_non_null(strstr(warned, "run shard 0/2 again"));
    assert_false(is_there(file("w.prt")));
    unlink(file("w.prt.0-of-2.part"));
    o.shard = 0;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_OK);
    assert_int_equal(missing, 0);
    assert_true(is_there(file("w.prt")));
    o.shard = 2;
    assert_int_equal(prt_bake(&c, mesh, &o, file("w.prt")), PRT_ARG);
    prt_mesh_destroy(mesh);
}

// ---- checkpoints

// Contract of prt_bake: a wavelet bake that is killed every few records repeats none of them.
static void killed_wavelet(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    killed(o, 12);
    o.storage = PRT_STORAGE_SPARSE;
    o.no_single = true;
    killed(o, 12);
}

// Contract of prt_bake: the same for joint transport.
static void killed_joint(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_JOINT, PRT_STORAGE_FACTORED);
    o.no_single = true;
    killed(o, 12);
}

// Contract of prt_bake: the same for polynomial transport, and for one part of two.
static void killed_polynomial_and_part(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL, PRT_STORAGE_FACTORED);
    struct prt_env *env;
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    o.env = env;
    killed(o, 2);
    prt_env_destroy(env);
    o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    o.no_single = true;
    struct prt_mesh *mesh = scene();
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    char path[256];
    snprintf(path, sizeof path, "%s", file("checkpoint"));
    o.n_shard = 2, o.checkpoint = path;
    for (o.shard = 0; o.shard < 2; o.shard++)
        while (!bake_and_kill(mesh, &o, 12)) continue;
    same_bytes(file("whole.prt"), file("parts.prt"));
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: a checkpoint without room, of other settings, or damaged at any place
// changes no byte of the bake.
static void checkpoints_that_do_not_help(void **state)
{
    struct prt_mesh *mesh = scene();
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    char path[256];
    o.no_single = true;
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    snprintf(path, sizeof path, "%s", file("checkpoint"));
    o.checkpoint = path;
    o.checkpoint_room = 1 << 20;
    assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_OK);
    same_bytes(file("whole.prt"), file("parts.prt"));
    o.checkpoint_room = 0;
    for (unsigned round = 0; round < 3; round++) {
        o.seed = round == 2 ? 4 : 3; // the last checkpoint is of another bake
        assert_false(bake_and_kill(mesh, &o, 33 + round));
        o.seed = 3;
        const char *damaged[] = {path, file("checkpoint.rows")};
        struct stat st;
        for (int i = 0; i < 2; i++) // the rows may be gone already
            if (!stat(damaged[i], &st) && st.st_size)
                assert_true(invert_byte(damaged[i],
                                        (off_t)((uint64_t)st.st_size * (2 * round + 1) / 6)));
        int status = prt_bake(&context, mesh, &o, file("parts.prt"));
        if (status == PRT_FORMAT) status = prt_bake(&context, mesh, &o, file("parts.prt"));
        assert_int_equal(status, PRT_OK);
        same_bytes(file("whole.prt"), file("parts.prt"));
    }
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// Where the data of a checkpoint's first record of this slot begin; 0: it has none.
static off_t data_of(const char *path, uint32_t slot)
{
    enum { HEADER = 16, SLOT_ROWS = 1000 };
    struct record r;
    uint64_t at = HEADER;
    bool found = false;
    int fd = open(path, O_RDONLY);
    while (!found && fd >= 0 && prt_read_at(fd, &r, sizeof r, at) && prt_record_whole(&r)) {
        found = r.slot == slot && (r.bytes || slot > SLOT_ROWS);
        at += sizeof r + (found || r.slot == SLOT_ROWS ? 0 : r.bytes);
    }
    if (fd >= 0) close(fd);
    return found ? (off_t)at : 0;
}

// Contract of prt_bake: a checkpoint whose rows are removed, as all that is made of them is
// recorded, is of no use once one of these records is damaged: the bake fails and begins anew.
static void damage_where_rows_are_removed(void **state)
{
    enum { SLOT_ROWS_DONE = 1001 };
    struct prt_mesh *mesh = scene();
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    char path[256];
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    snprintf(path, sizeof path, "%s", file("checkpoint"));
    o.checkpoint = path;
    pid_t child = bake_in_child(mesh, &o, file("parts.prt"));
    while (!data_of(path, SLOT_ROWS_DONE)) {
        assert_int_equal(waitpid(child, NULL, WNOHANG), 0);
        usleep(500);
    }
    kill(child, SIGKILL);
    assert_int_equal(waitpid(child, NULL, 0), child);
    assert_true(invert_byte(path, data_of(path, 0)));
    assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_FORMAT);
    assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_OK);
    same_bytes(file("whole.prt"), file("parts.prt"));
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// Contract of options.memory: a bake that has no room for its rows keeps them in files, and
// writes the same bytes.
static void little_memory(void **state)
{
    struct prt_mesh *mesh = scene();
    const enum prt_transport_kind engine[] = {PRT_TRANSPORT_WAVELET, PRT_TRANSPORT_JOINT};
    for (int i = 0; i < 2; i++) {
        struct prt_bake_options o = options(engine[i], PRT_STORAGE_FACTORED);
        uint64_t all, less;
        o.draft = true;
        assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
        assert_int_equal(prt_bake_memory(&context, mesh, &o, &all), PRT_OK);
        o.memory = 1 << 20;
        assert_int_equal(prt_bake(&context, mesh, &o, file("parts.prt")), PRT_OK);
        assert_int_equal(prt_bake_memory(&context, mesh, &o, &less), PRT_OK);
        same_bytes(file("whole.prt"), file("parts.prt"));
        expect_below("memory with rows in files, of all", (double)less / (double)all, 1);
    }
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// The textures of a model are held while it is baked.
static void textures_need_memory(void **state)
{
    struct prt_mesh *mesh = scene();
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    uint64_t plain, textured;
    assert_int_equal(prt_bake_memory(&context, mesh, &o, &plain), PRT_OK);
    mesh->texel_bytes = 1 << 30;
    assert_int_equal(prt_bake_memory(&context, mesh, &o, &textured), PRT_OK);
    assert_true(textured >= plain + (1 << 30));
    prt_mesh_destroy(mesh);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(factored_wavelet),
        cmocka_unit_test(sparse_wavelet),
        cmocka_unit_test(joint),
        cmocka_unit_test(polynomial),
        cmocka_unit_test(wrong_parts_are_refused),
        cmocka_unit_test(killed_wavelet),
        cmocka_unit_test(killed_joint),
        cmocka_unit_test(killed_polynomial_and_part),
        cmocka_unit_test(checkpoints_that_do_not_help),
        cmocka_unit_test(damage_where_rows_are_removed),
        cmocka_unit_test(little_memory),
        cmocka_unit_test(textures_need_memory),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
