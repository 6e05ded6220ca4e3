// SPDX-License-Identifier: MIT
// What rooms need of the store: a name is found whole, and as long as a room has it.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "store/holds.h"

static void a_name_is_found_whole(void **unused)
{
    static const char names[] = "\nbunny\nbunny/1\nenv:ab12\n";
    assert_true(holds_among(names, "bunny"));
    assert_true(holds_among(names, "bunny/1"));
    assert_true(holds_among(names, "env:ab12"));
    assert_false(holds_among(names, "bun"));
    assert_false(holds_among(names, "unny"));
    assert_false(holds_among(names, "ab12"));
    assert_false(holds_among(names, "env:ab1"));
    assert_false(holds_among("", "bunny"));
}

static void a_name_is_held_while_a_room_has_it(void **unused)
{
    struct holds *holds = holds_create();
    assert_true(holds_has(holds, "bunny")); // unknown yet: everything is held
    holds_know(holds, true);
    holds_set(holds, "room 1", "\nbunny\nhead\n");
    holds_set(holds, "room 2", "\nbunny\n");
    assert_true(holds_has(holds, "bunny") && holds_has(holds, "head"));
    assert_false(holds_has(holds, "bun") || holds_has(holds, "bunny/1"));
    holds_set(holds, "room 1", "");
    assert_true(holds_has(holds, "bunny"));
    assert_false(holds_has(holds, "head"));
    assert_string_equal(holds_of(holds, "room 1"), "");
    assert_string_equal(holds_of(holds, "room 2"), "\nbunny\n");
    holds_set(holds, "room 2", "\nhead\n");
    assert_false(holds_has(holds, "bunny"));
    assert_true(holds_has(holds, "head"));
    holds_destroy(holds);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_name_is_found_whole),
        cmocka_unit_test(a_name_is_held_while_a_room_has_it),
    };
    return cmocka_run_group_tests_name("held names", tests, NULL, NULL);
}
