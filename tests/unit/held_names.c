// SPDX-License-Identifier: MIT
// What rooms need of the store: a name is found whole, and as long as a room has it.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

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

static bool is_room_2(void *user, const char *room)
{
    ++*(int *)user;
    return !strcmp(room, "room 2");
}

// A room that is gone needs nothing, and what others need stays.
static void rooms_that_are_gone_hold_nothing(void **unused)
{
    struct holds *holds = holds_create();
    char ids[40];
    int asked = 0;
    holds_know(holds, true);
    holds_set(holds, "room 1", "\nbunny\nhead\n");
    holds_set(holds, "room 2", "\nbunny\n");
    holds_set(holds, "room 3", "\nhead\ntree\n");
    holds_retain(holds, is_room_2, &asked);
    assert_int_equal(asked, 3);
    assert_true(holds_has(holds, "bunny"));
    assert_false(holds_has(holds, "head") || holds_has(holds, "tree"));
    assert_string_equal(holds_of(holds, "room 1"), "");
    assert_int_equal(holds_rooms(holds, "bunny", ids, sizeof ids), 1);
    assert_string_equal(ids, "room 2");
    char *list = holds_list(holds);
    assert_string_equal(list, "bunny\n");
    free(list);
    holds_destroy(holds);
}

// Names that no room had before are told once, until they are forgotten again.
static void fresh_names_are_told_once(void **unused)
{
    struct holds *holds = holds_create();
    holds_know(holds, true);
    assert_null(holds_take_fresh(holds));
    holds_set(holds, "room 1", "\nbunny\n");
    holds_set(holds, "room 2", "\nbunny\nhead\n");
    char *fresh = holds_take_fresh(holds);
    assert_string_equal(fresh, "bunny\nhead\n");
    free(fresh);
    assert_null(holds_take_fresh(holds));
    holds_set(holds, "room 1", "");
    holds_set(holds, "room 2", "");
    holds_set(holds, "room 3", "\nbunny\n");
    fresh = holds_take_fresh(holds);
    assert_string_equal(fresh, "bunny\n");
    free(fresh);
    holds_destroy(holds);
}

// A room that needs one thing more tells that one alone.
static void a_name_that_stays_is_not_fresh(void **unused)
{
    struct holds *holds = holds_create();
    holds_know(holds, true);
    holds_set(holds, "room 1", "\nbunny\ntree\n");
    free(holds_take_fresh(holds));
    holds_set(holds, "room 1", "\nbunny\nhead\n");
    char *fresh = holds_take_fresh(holds);
    assert_string_equal(fresh, "head\n");
    free(fresh);
    assert_true(holds_has(holds, "bunny") && holds_has(holds, "head"));
    assert_false(holds_has(holds, "tree"));
    holds_destroy(holds);
}

// Three rooms are named, the others counted.
static void rooms_of_a_name_are_listed(void **unused)
{
    struct holds *holds = holds_create();
    char ids[80];
    holds_know(holds, true);
    for (int i = 0; i < 5; i++) {
        char room[8];
        snprintf(room, sizeof room, "r%d", i);
        holds_set(holds, room, i < 4 ? "\nbunny\n" : "\nhead\n");
        assert_int_equal(holds_rooms(holds, "bunny", ids, sizeof ids), i < 4 ? i + 1 : 4);
        assert_int_equal(strstr(ids, " and ") != NULL, i >= 3);
    }
    assert_non_null(strstr(ids, " and 1 more"));
    holds_destroy(holds);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_name_is_found_whole),
        cmocka_unit_test(a_name_is_held_while_a_room_has_it),
        cmocka_unit_test(rooms_that_are_gone_hold_nothing),
        cmocka_unit_test(fresh_names_are_told_once),
        cmocka_unit_test(a_name_that_stays_is_not_fresh),
        cmocka_unit_test(rooms_of_a_name_are_listed),
    };
    return cmocka_run_group_tests_name("held names", tests, NULL, NULL);
}
