// SPDX-License-Identifier: MIT
// Parts and checkpoints of a bake belong to all its inputs: one that differs in any of them is
// not used. One checkpoint has one process.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <errno.h>
#include <math.h>
#include <signal.h>
#include <string.h>
#include <sys/file.h>
#include <sys/resource.h>

#include "bake_parts.h"
#include "bodies.h"

static char warned[512];

static void listen_in(void *user, enum prt_log_level level, const char *line)
{
    if (level != PRT_LOG_NOTE) snprintf(user, sizeof warned, "%s", line);
}

static struct prt_bake_options options(enum prt_transport_kind engine,
                                       const struct prt_material *material)
{
    return (struct prt_bake_options){.engine = engine,
                                     .n_sample = 300,
                                     .cube = 16,
                                     .seed = 3,
                                     .no_single = true,
                                     .unmeasured = true,
                                     .n_shard = 2,
                                     .media = prt_media_one(material)};
}

static void part_0(const struct prt_mesh *mesh, struct prt_bake_options o)
{
    assert_int_equal(prt_bake(&context, mesh, &o, file("k.prt")), PRT_OK);
    assert_true(is_there(file("k.prt.0-of-2.part")));
}

// Bakes part 1 beside part 0 of another bake.
static void another_bake(const struct prt_mesh *mesh, struct prt_bake_options o)
{
    struct prt_context c = context;
    uint32_t missing = 0;
    c.log = listen_in, c.log_user = warned;
    o.shard = 1;
    o.parts_missing = &missing;
    warned[0] = 0;
    assert_int_equal(prt_bake(&c, mesh, &o, file("k.prt")), PRT_OK);
    assert_int_equal(missing, 1);
    assert_non_null(strstr(warned, "0-of-2.part"));
    unlink(file("k.prt.1-of-2.part"));
}

// Contract of prt_bake: a fixed light, its turn, an option that the settings do not list, and
// the albedo of an opaque object are inputs of a bake.
static void light_options_and_albedo(void **state)
{
    struct prt_mesh *mesh = ball_over_square(&context, 24, 16);
    struct prt_env *env, *other;
    struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.6", &other), PRT_OK);
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL, &skin), changed;
    o.env = env;
    part_0(mesh, o);
    changed = o, changed.env = other;
    another_bake(mesh, changed);
    changed = o, changed.rotate_deg = 5;
    another_bake(mesh, changed);
    changed = o, changed.basis = PRT_RADIAL_HAT;
    another_bake(mesh, changed);
    changed = o, changed.no_single = false;
    another_bake(mesh, changed);
    for (uint32_t i = 0; i < mesh->n_surface; i++) {
        if (mesh->surface[i].translucent) continue;
        mesh->surface[i].base_color[2] = 0.3f;
        another_bake(mesh, o);
        mesh->surface[i].base_color[2] = 0.4f;
    }
    unlink(file("k.prt.0-of-2.part"));
    prt_env_destroy(env);
    prt_env_destroy(other);
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: every point of a profile is an input, in all its digits.
static void points_of_a_profile(void **state)
{
    static const char text[] =
        "{\"profile\":\"curve\",\"radius\":[0,1,2,4],\"rd\":[[0.03,0.02,0.01,0],"
        "[0.03,0.01,0.005,0],[0.02,0.01,0.003,0]]}";
    struct prt_mesh *mesh = ball_over_square(&context, 24, 16);
    struct prt_material curve;
    assert_int_equal(prt_material_parse(&context, "curve", text, strlen(text), &curve), PRT_OK);
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, &curve);
    part_0(mesh, o);
    curve.reflectance[0][0] = nextafterf(curve.reflectance[0][0], 1);
    another_bake(mesh, o);
    unlink(file("k.prt.0-of-2.part"));
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: a checkpoint that another process holds is said to be in use, after ten
// seconds, and is left alone.
static void checkpoint_in_use(void **state)
{
    struct prt_mesh *mesh = ball_over_square(&context, 24, 16);
    struct prt_material skin;
    struct prt_context c = context;
    char path[256];
    snprintf(path, sizeof path, "%s", file("held"));
    const int fd = open(path, O_RDWR | O_CREAT, 0600);
    assert_true(fd >= 0 && !flock(fd, LOCK_EX) && write(fd, "mine", 4) == 4);
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, &skin);
    o.n_shard = 0;
    o.checkpoint = path;
    c.log = listen_in, c.log_user = warned;
    assert_int_equal(prt_bake(&c, mesh, &o, file("held.prt")), PRT_IO);
    assert_non_null(strstr(warned, "another process bakes with this checkpoint"));
    struct stat st;
    assert_true(!fstat(fd, &st) && st.st_size == 4 && is_there(path));
    close(fd);
    unlink(path);
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: a checkpoint that cannot be written when the bake begins ends it, and
// the line names the file and the reason.
static void checkpoint_without_room(void **state)
{
    struct prt_mesh *mesh = ball_over_square(&context, 24, 16);
    struct prt_material skin;
    struct prt_context c = context;
    struct rlimit before, none;
    char path[256];
    snprintf(path, sizeof path, "%s", file("full"));
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET, &skin);
    o.n_shard = 0;
    o.checkpoint = path;
    c.log = listen_in, c.log_user = warned;
    warned[0] = 0;
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &before), 0);
    none = (struct rlimit){0, before.rlim_max};
    signal(SIGXFSZ, SIG_IGN);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &none), 0);
    const int status = prt_bake(&c, mesh, &o, file("full.prt"));
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &before), 0);
    assert_int_equal(status, PRT_IO);
    assert_non_null(strstr(warned, path));
    assert_non_null(strstr(warned, strerror(EFBIG)));
    assert_false(is_there(file("full.prt")));
    unlink(path);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(light_options_and_albedo),
        cmocka_unit_test(points_of_a_profile),
        cmocka_unit_test(checkpoint_in_use),
        cmocka_unit_test(checkpoint_without_room),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
