// SPDX-License-Identifier: MIT
// Allocations of the library fail once each: the call returns PRT_NOMEM and nothing of it, and
// the next call succeeds.
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

#include <cmocka.h>

#include "prt/bake.h"
#include "prt/light.h"
#include "prt/mesh.h"
#include "prt/radial.h"

extern void *__libc_memalign(size_t align, size_t n);
extern void *__libc_realloc(void *p, size_t n);

static _Atomic int64_t countdown; // the allocation that fails; 0: none
static _Atomic int64_t n_failed;

static int fails(void)
{
    if (!countdown || --countdown) return 0;
    n_failed++;
    return 1;
}

// prt_alloc() calls these two, and this program's own come first.
void *aligned_alloc(size_t align, size_t n)
{
    return fails() ? NULL : __libc_memalign(align, n);
}

int posix_memalign(void **out, size_t align, size_t n)
{
    if (fails()) return 12; // ENOMEM
    *out = __libc_memalign(align, n);
    return *out ? 0 : 12;
}

// Lists that grow: their first sizes are small and many, and fail elsewhere.
enum { LARGE = 16 << 10 };
static _Atomic int64_t growth; // the growth to LARGE bytes or more that fails; 0: none

void *realloc(void *p, size_t n)
{
    if (n < LARGE || !growth || --growth) return __libc_realloc(p, n);
    n_failed++;
    return NULL;
}

static void ignore_line(void *user, enum prt_log_level level, const char *line)
{
}

static void each_allocation_fails(int (*act)(const struct prt_context *ctx))
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = ignore_line;
    int64_t n = 1;
    for (int64_t before = -1; before != n_failed; n++) {
        before = n_failed;
        countdown = n;
        int status = act(&ctx);
        countdown = 0;
        assert_int_equal(status, n_failed > before ? PRT_NOMEM : PRT_OK);
    }
    assert_true(n > 4);
    print_message("%lld allocations failed\n", (long long)n - 2);
}

static int make_radial(const struct prt_context *ctx, enum prt_radial_kind kind,
                       enum prt_radial_family family)
{
    const struct prt_radial_options o = {.kind = kind,
                                         .family = family,
                                         .eta = 1.3,
                                         .sigma_lo = 0.5,
                                         .sigma_hi = 1,
                                         .radius_mm = 10,
                                         .n_function = 6,
                                         .degree = 2,
                                         .max_error = 0.1};
    struct prt_radial *radial = NULL;
    int status = prt_radial_create(ctx, &o, &radial);
    assert_true(!radial == !!status);
    prt_radial_destroy(radial);
    return status;
}

static int reduced(const struct prt_context *ctx)
{
    return make_radial(ctx, PRT_RADIAL_REDUCED, PRT_FAMILY_EXTINCTION);
}

static int polynomial(const struct prt_context *ctx)
{
    return make_radial(ctx, PRT_RADIAL_POLYNOMIAL, PRT_FAMILY_DIPOLE);
}

static void radial_bases(void **state)
{
    each_allocation_fails(reduced);
    each_allocation_fails(polynomial);
}

// A light's cube and its vector: what is refused is empty.
static int light_of_a_cube(const struct prt_context *ctx)
{
    struct prt_cube cube;
    struct prt_light light;
    int status = prt_cube_init(&cube, 16);
    assert_true(status ? !cube.n && !cube.texel : cube.n == 16 && cube.texel);
    if (status) return status;
    status = prt_light_from_cube(&cube, &light);
    assert_true(status ? !light.n && !light.coef : light.n == 16 && light.coef);
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    return status;
}

static void lights(void **state)
{
    each_allocation_fails(light_of_a_cube);
}

// The walks of a free medium are kept in lists that grow with their exits.
static int bake_walks(const struct prt_context *ctx, const struct prt_mesh *mesh)
{
    static const struct prt_material m = {.sigma_s_prime = {1, 1, 1},
                                          .sigma_a = {0.01f, 0.01f, 0.01f},
                                          .eta = 1.3f,
                                          .roughness = 0.3f};
    const struct prt_bake_options o = {.engine = PRT_TRANSPORT_JOINT,
                                       .media = prt_media_one(&m),
                                       .scattering = PRT_SCATTERING_WALK,
                                       .n_walk = 16,
                                       .n_sample = 300,
                                       .cube = 16,
                                       .no_single = true,
                                       .unmeasured = true};
    char path[64];
    snprintf(path, sizeof path, "/tmp/prt-library-%d.prt", (int)getpid());
    const int status = prt_bake(ctx, mesh, &o, path);
    assert_int_equal(unlink(path), status ? -1 : 0);
    return status;
}

static void growing_lists(void **state)
{
    static const char octahedron[] =
        "v 10 0 0\nv -10 0 0\nv 0 10 0\nv 0 -10 0\nv 0 0 10\nv 0 0 -10\nf 1 3 5\nf 3 2 5\n"
        "f 2 4 5\nf 4 1 5\nf 3 1 6\nf 2 3 6\nf 4 2 6\nf 1 4 6\n";
    struct prt_context ctx;
    struct prt_mesh *mesh;
    prt_context_init(&ctx);
    ctx.log = ignore_line;
    assert_int_equal(prt_mesh_load_memory(&ctx, "o.obj", octahedron, sizeof octahedron - 1,
                                          NULL, NULL, &mesh),
                     PRT_OK);
    assert_int_equal(prt_mesh_scale(&ctx, mesh, 20, 0), PRT_OK);
    int64_t n = 1, before = -1;
    for (n_failed = 0; before != n_failed; n++) {
        before = n_failed;
        growth = n;
        const int status = bake_walks(&ctx, mesh);
        growth = 0;
        assert_int_equal(status, n_failed > before ? PRT_NOMEM : PRT_OK);
    }
    assert_true(n > 2);
    print_message("%lld growths failed\n", (long long)n - 2);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(radial_bases), cmocka_unit_test(lights),
                                       cmocka_unit_test(growing_lists)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
