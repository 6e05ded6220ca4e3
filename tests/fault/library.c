// SPDX-License-Identifier: MIT
// Every allocation of the library fails once: the call returns PRT_NOMEM and nothing of it, and
// the next call succeeds.
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "prt/radial.h"

extern void *__libc_memalign(size_t align, size_t n);

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

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(radial_bases)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
