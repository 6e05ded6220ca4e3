// SPDX-License-Identifier: MIT
// The places of a pass between principals.
#include "render/shared/pass_share.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>

#include <cmocka.h>

enum { MOST = 16 };

static void add(struct pass_share *share, const char *name, unsigned n)
{
    for (unsigned i = 0; i < n; i++) pass_share_add(share, name);
}

static unsigned granted(struct pass_share *share, const char *name)
{
    unsigned n = 0;
    while (pass_share_take(share, name)) n++;
    return n;
}

static void test_one_principal_has_all(void **state)
{
    struct pass_share share = {0};
    add(&share, "a", 100);
    pass_share_before(&share, "a");
    pass_share_grant(&share, MOST);
    assert_int_equal(granted(&share, "a"), MOST);
    assert_int_equal(share.n_granted, 0);
}

static void test_turns(void **state)
{
    struct pass_share share = {0};
    add(&share, "greedy", 300);
    add(&share, "b", 300);
    pass_share_grant(&share, MOST);
    assert_int_equal(granted(&share, "greedy"), MOST / 2);
    assert_int_equal(granted(&share, "b"), MOST / 2);
}

// The pass is short where one principal has most of what waits.
static void test_greedy_and_modest(void **state)
{
    struct pass_share share = {0};
    add(&share, "greedy", 300);
    add(&share, "modest", 2);
    pass_share_grant(&share, MOST);
    assert_int_equal(granted(&share, "modest"), 2);
    assert_int_equal(granted(&share, "greedy"), PASS_SHARE_ALONE);
    // The modest one has its answers now, and comes back.
    share = (struct pass_share){0};
    add(&share, "greedy", 300);
    pass_share_before(&share, "greedy");
    pass_share_before(&share, "modest");
    pass_share_grant(&share, MOST);
    assert_int_equal(granted(&share, "greedy"), PASS_SHARE_ALONE);
}

static void test_many_principals(void **state)
{
    struct pass_share share = {0};
    char name[40][8];
    unsigned all = 0;
    for (int i = 0; i < 40; i++) {
        snprintf(name[i], sizeof name[i], "p%d", i);
        add(&share, name[i], 2);
    }
    pass_share_grant(&share, MOST);
    for (int i = 0; i < 40; i++) {
        unsigned n = granted(&share, name[i]);
        assert_true(n <= 1);
        all += n;
    }
    assert_int_equal(all, MOST);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_one_principal_has_all),
        cmocka_unit_test(test_turns),
        cmocka_unit_test(test_greedy_and_modest),
        cmocka_unit_test(test_many_principals),
    };
    return cmocka_run_group_tests_name("pass_share", tests, NULL, NULL);
}
