// SPDX-License-Identifier: MIT
// The ledger: what is given back is what was taken, and limits refuse before anything is
// charged.
#include "core/ledger.h"

#include "core/options.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static struct options options = {.client_requests = 10, .queue = 15, .client_memory = 100};

static void test_limits(void **state)
{
    struct ledger *ledger = ledger_create(&options);
    struct principal *a = ledger_principal(ledger, "uid:1"),
                     *b = ledger_principal(ledger, "uid:2");
    char error[256];
    assert_int_equal(ledger_take(a, LEDGER_REQUESTS, 10, error), LEDGER_GRANTED);
    assert_int_equal(ledger_take(a, LEDGER_REQUESTS, 1, error), LEDGER_CLIENT_FULL);
    assert_non_null(strstr(error, "--client-requests"));
    assert_non_null(strstr(error, "you hold 10"));
    assert_int_equal(a->held[LEDGER_REQUESTS], 10);
    assert_int_equal(ledger_take(b, LEDGER_REQUESTS, 5, error), LEDGER_GRANTED);
    assert_int_equal(ledger_take(b, LEDGER_REQUESTS, 1, error), LEDGER_ALL_FULL);
    assert_non_null(strstr(error, "--queue"));
    assert_int_equal(ledger_total(ledger, LEDGER_REQUESTS), 15);
    // What exists already is charged beyond every limit, and comes back the same way.
    ledger_force(b, LEDGER_REQUESTS, 7);
    assert_int_equal(ledger_total(ledger, LEDGER_REQUESTS), 22);
    ledger_give(b, LEDGER_REQUESTS, 12);
    ledger_give(a, LEDGER_REQUESTS, 10);
    assert_int_equal(ledger_total(ledger, LEDGER_REQUESTS), 0);
    // An amount that no sum may hold.
    assert_int_equal(ledger_take(a, LEDGER_PAYLOAD, UINT64_MAX, error), LEDGER_CLIENT_FULL);
    assert_int_equal(ledger_take(a, LEDGER_PAYLOAD, 60, error), LEDGER_GRANTED);
    assert_int_equal(ledger_take(a, LEDGER_PAYLOAD, UINT64_MAX - 10, error),
                     LEDGER_CLIENT_FULL);
    ledger_give(a, LEDGER_PAYLOAD, 60);
    // 0 stands for no limit.
    assert_int_equal(ledger_take(a, LEDGER_JOBS, 1u << 30, error), LEDGER_GRANTED);
    ledger_give(a, LEDGER_JOBS, 1u << 30);
    principal_release(a);
    principal_release(b);
    ledger_destroy(ledger);
}

// For every limit, amount and amount held: granted where the sum is within both limits, and the
// client's own limit is named first. A refusal charges nothing.
static void test_sums(void **state)
{
    static const uint64_t amounts[] = {0, 1, 9, 10, 11, 15, 16, UINT64_MAX};
    enum { N = sizeof amounts / sizeof *amounts };
    for (uint64_t mine = 0; mine <= 10; mine++)
        for (uint64_t others = 0; mine + others <= 15; others += 5)
            for (size_t i = 0; i < N; i++) {
                struct ledger *ledger = ledger_create(&options);
                struct principal *a = ledger_principal(ledger, "uid:1"),
                                 *b = ledger_principal(ledger, "uid:2");
                char error[256];
                ledger_force(a, LEDGER_REQUESTS, mine);
                ledger_force(b, LEDGER_REQUESTS, others);
                const bool own = amounts[i] <= 10 - mine,
                           all = amounts[i] <= 15 - mine - others;
                const enum ledger_refusal r =
                    ledger_take(a, LEDGER_REQUESTS, amounts[i], error);
                assert_int_equal(r, !own  ? LEDGER_CLIENT_FULL
                                    : all ? LEDGER_GRANTED
                                          : LEDGER_ALL_FULL);
                const uint64_t taken = r == LEDGER_GRANTED ? amounts[i] : 0;
                assert_true(a->held[LEDGER_REQUESTS] == mine + taken);
                assert_true(ledger_total(ledger, LEDGER_REQUESTS) == mine + others + taken);
                principal_release(b);
                principal_release(a);
                ledger_destroy(ledger);
            }
}

// Where only the daemon has a limit, no amount passes it, however large.
static void test_limit_of_all(void **state)
{
    static const struct options all_only = {.queue = 15};
    static const uint64_t amounts[] = {6, 15, 16, UINT64_MAX - 5, UINT64_MAX};
    struct ledger *ledger = ledger_create(&all_only);
    struct principal *a = ledger_principal(ledger, "uid:1");
    char error[256];
    ledger_force(a, LEDGER_REQUESTS, 10);
    for (size_t i = 0; i < sizeof amounts / sizeof *amounts; i++)
        assert_int_equal(ledger_take(a, LEDGER_REQUESTS, amounts[i], error), LEDGER_ALL_FULL);
    assert_int_equal(ledger_take(a, LEDGER_REQUESTS, 5, error), LEDGER_GRANTED);
    ledger_give(a, LEDGER_REQUESTS, 15);
    principal_release(a);
    ledger_destroy(ledger);
}

// A charge of any kind keeps its principal.
static void test_any_charge_stays(void **state)
{
    struct ledger *ledger = ledger_create(&options);
    for (int i = 0; i < LEDGER_N; i++) {
        struct principal *a = ledger_principal(ledger, "uid:1");
        ledger_force(a, (enum ledger_resource)i, 1);
        principal_release(a);
        assert_ptr_equal(ledger_first(ledger), a);
        ledger_give(a, (enum ledger_resource)i, 1);
        assert_null(ledger_first(ledger));
    }
    ledger_destroy(ledger);
}

static void test_principals(void **state)
{
    struct ledger *ledger = ledger_create(&options);
    struct principal *a = ledger_principal(ledger, "addr:192.0.2.7");
    char error[256];
    assert_ptr_equal(ledger_principal(ledger, "addr:192.0.2.7"), a);
    assert_int_equal(a->refs, 2);
    principal_release(a);
    // It holds something: it stays after its last reference, and is found again.
    assert_int_equal(ledger_take(a, LEDGER_MODELS, 1, error), LEDGER_GRANTED);
    principal_release(a);
    assert_ptr_equal(ledger_principal(ledger, "addr:192.0.2.7"), a);
    assert_int_equal(a->held[LEDGER_MODELS], 1);
    principal_release(a);
    ledger_give(a, LEDGER_MODELS, 1);
    assert_int_equal(ledger_total(ledger, LEDGER_MODELS), 0);
    assert_null(ledger_first(ledger)); // nobody refers to it, and it holds nothing
    ledger_destroy(ledger);
}

static void test_names(void **state)
{
    assert_string_equal(ledger_name(LEDGER_CONNECTIONS), "connections");
    assert_string_equal(ledger_name(LEDGER_LONG_REQUESTS), "long_requests");
}

// Tokens limit OUTPUT to 50, 20 and 80 bytes; of REQUESTS none says anything.
static void token_limits(void *user, const char *principal, uint64_t limit[LEDGER_N])
{
    limit[LEDGER_OUTPUT] = principal[0] == 'a' ? 50 : principal[0] == 'b' ? 20 : 80;
}

static void test_least_limit(void **state)
{
    struct ledger *ledger = ledger_create(&options);
    struct principal *p[3] = {NULL};
    assert_int_equal(ledger_limit_least(ledger, LEDGER_REQUESTS), 10);
    ledger_set_quotas(ledger, token_limits, NULL);
    for (int i = 0; i < 3; i++)
        p[i] = ledger_principal(ledger, i == 0 ? "anna" : i == 1 ? "bob" : "carl");
    assert_int_equal(ledger_limit_least(ledger, LEDGER_OUTPUT), 20);
    assert_int_equal(ledger_limit_least(ledger, LEDGER_REQUESTS), 10);
    // A refusal names the token's quota, or the option where the token says nothing.
    char error[256];
    assert_int_equal(ledger_take(p[1], LEDGER_OUTPUT, 21, error), LEDGER_CLIENT_FULL);
    assert_non_null(strstr(error, "your token's quota"));
    assert_int_equal(ledger_take(p[1], LEDGER_REQUESTS, 11, error), LEDGER_CLIENT_FULL);
    assert_non_null(strstr(error, "(--client-requests)"));
    for (int i = 0; i < 3; i++) principal_release(p[i]);
    ledger_destroy(ledger);
}

static void test_share(void **state)
{
    struct ledger *ledger = ledger_create(&options);
    struct principal *a = ledger_principal(ledger, "uid:1"),
                     *b = ledger_principal(ledger, "uid:2");
    ledger_force(a, LEDGER_REQUESTS, 8); // of 15, which are its own as long as it is alone
    assert_false(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:1", NULL, 0));
    assert_true(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:1", "uid:2", 1));
    assert_false(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:2", "uid:2", 7));
    assert_true(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:2", "uid:2", 8));
    ledger_force(b, LEDGER_REQUESTS, 7);
    assert_true(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:1", NULL, 0));
    assert_false(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:2", NULL, 0));
    assert_false(ledger_above_share(ledger, LEDGER_REQUESTS, "uid:3", NULL, 0));
    ledger_give(a, LEDGER_REQUESTS, 8);
    ledger_give(b, LEDGER_REQUESTS, 7);
    principal_release(a);
    principal_release(b);
    ledger_destroy(ledger);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_principals),
        cmocka_unit_test(test_names),
        cmocka_unit_test(test_least_limit),
        cmocka_unit_test(test_share),
        cmocka_unit_test(test_sums),
        cmocka_unit_test(test_any_charge_stays),
        cmocka_unit_test(test_limit_of_all),
    };
    return cmocka_run_group_tests_name("ledger", tests, NULL, NULL);
}
