// SPDX-License-Identifier: MIT
// A bake in parts, and one that is killed again and again, write what one process writes, byte
// for byte, whatever the storage; parts that are missing, damaged or of another bake are told
// and not used; finished work is not repeated.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "bake/cluster_records.h"
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
    static struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    o.media = prt_media_one(&skin);
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

// ---- checkpoints

// Number of records; asserts that none is there twice. *end: bytes up to the last whole one.
static unsigned count_records(const char *path, uint64_t *end)
{
    enum { MOST = 4096, HEADER = 16, SLOT_ROWS = 1000 };
    static uint32_t seen[MOST][2];
    unsigned n = 0;
    struct record r;
    uint64_t at = HEADER;
    int fd = open(path, O_RDONLY);
    while (fd >= 0 && prt_read_at(fd, &r, sizeof r, at) && prt_record_whole(&r) && n < MOST) {
        for (unsigned i = 0; i < n; i++)
            assert_false(seen[i][0] == r.slot && seen[i][1] == r.cluster);
        seen[n][0] = r.slot, seen[n++][1] = r.cluster;
        at += sizeof r + (r.slot == SLOT_ROWS ? 0 : r.bytes);
    }
    if (fd >= 0) close(fd);
    *end = at;
    return n;
}

// Bakes in a child, which is killed once it has recorded `more` pieces of work. True: it ended.
static bool bake_and_kill(const struct prt_mesh *mesh, const struct prt_bake_options *o,
                          unsigned more)
{
    uint64_t end;
    unsigned before = count_records(o->checkpoint, &end);
    pid_t child = fork();
    assert_true(child >= 0);
    if (!child) {
        struct prt_context c;
        prt_context_init(&c);
        prt_pool_create(0, &c.pool);
        _exit(prt_bake(&c, mesh, o, file("parts.prt")));
    }
    for (int how;;) {
        if (waitpid(child, &how, WNOHANG) == child) {
            assert_true(WIFEXITED(how) && WEXITSTATUS(how) == PRT_OK);
            return true;
        }
        if (count_records(o->checkpoint, &end) >= before + more) break;
        usleep(500);
    }
    kill(child, SIGKILL);
    assert_int_equal(waitpid(child, NULL, 0), child);
    // Finished work is there, and the rest of a record that was being written.
    assert_true(count_records(o->checkpoint, &end) >= before + more);
    return false;
}

static void killed_makes_the_whole(struct prt_bake_options o, unsigned more)
{
    struct prt_mesh *mesh = scene();
    unsigned killed = 0;
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    char path[256];
    snprintf(path, sizeof path, "%s", file("checkpoint"));
    o.checkpoint = path;
    while (!bake_and_kill(mesh, &o, more)) assert_true(++killed < 100);
    assert_true(killed >= 2);
    same_bytes(file("whole.prt"), file("parts.prt"));
    assert_int_not_equal(access(file("checkpoint"), F_OK), 0);
    assert_int_not_equal(access(file("checkpoint.rows"), F_OK), 0);
    unlink(file("parts.prt"));
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: a wavelet bake that is killed every few records repeats none of them.
static void killed_wavelet(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    killed_makes_the_whole(o, 12);
    o.storage = PRT_STORAGE_SPARSE;
    o.no_single = true;
    killed_makes_the_whole(o, 12);
}

// Contract of prt_bake: three shards of a bake by walks write its bytes, and so does one that
// is killed every few records: its unscattered light reads the rows of pass 1, too.
static void parted_and_killed_walks(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, PRT_STORAGE_FACTORED);
    o.scattering = PRT_SCATTERING_WALK;
    o.n_walk = 16;
    o.no_single = true;
    parts_make_the_whole(o);
    killed_makes_the_whole(o, 2);
}

// Contract of prt_bake: the same for joint transport.
static void killed_joint(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_JOINT, PRT_STORAGE_FACTORED);
    o.no_single = true;
    killed_makes_the_whole(o, 12);
}

// Contract of prt_bake: the same for polynomial transport, and for one part of two.
static void killed_polynomial_and_part(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL, PRT_STORAGE_FACTORED);
    struct prt_env *env;
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    o.env = env;
    killed_makes_the_whole(o, 2);
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
        struct stat st;
        char rows[300];
        snprintf(rows, sizeof rows, "%s.rows", path);
        for (int i = 0; i < 2; i++) { // a byte turned over in either file
            int fd = open(i ? rows : path, O_RDWR);
            char byte;
            if (fd < 0 || fstat(fd, &st) || !st.st_size) continue;
            off_t at = (off_t)((uint64_t)st.st_size * (2 * round + 1) / 6);
            assert_int_equal(pread(fd, &byte, 1, at), 1);
            byte = (char)~byte;
            assert_int_equal(pwrite(fd, &byte, 1, at), 1);
            close(fd);
        }
        int status = prt_bake(&context, mesh, &o, file("parts.prt"));
        if (status == PRT_FORMAT) status = prt_bake(&context, mesh, &o, file("parts.prt"));
        assert_int_equal(status, PRT_OK);
        same_bytes(file("whole.prt"), file("parts.prt"));
    }
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

// Killed bakes leave temporary files.
static int clean_up(void **state)
{
    char command[300];
    snprintf(command, sizeof command, "rm -rf %s", folder);
    return system(command);
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
        cmocka_unit_test(killed_wavelet),
        cmocka_unit_test(parted_and_killed_walks),
        cmocka_unit_test(killed_joint),
        cmocka_unit_test(killed_polynomial_and_part),
        cmocka_unit_test(checkpoints_that_do_not_help),
        cmocka_unit_test(little_memory),
    };
    int failed = run_physics_tests(tests, NULL, clean_up);
    prt_pool_destroy(context.pool);
    return failed;
}
