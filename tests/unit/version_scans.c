// SPDX-License-Identifier: MIT
// What scans of --models make of a version (server/store/versions.h), without a daemon.
#include "store/versions.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>

#include <cmocka.h>

// One scan that finds the version a/1: with a file of these times, or with a fault.
static enum version_state scan(struct versions *versions, const char *stamp, const char *fault)
{
    char version[] = "a/1", name[] = "a/1/a.obj", none[] = "";
    struct import_entry entry = {.name = fault ? none : name, .version = version};
    snprintf(entry.stamp, sizeof entry.stamp, "%s", stamp);
    snprintf(entry.fault, sizeof entry.fault, "%s", fault ? fault : "");
    versions_scanned(versions, &entry, 1);
    return versions_get(versions, version)->state;
}

// Its file is loaded when two scans, one after another, found it unchanged; a fault between
// them only delays this.
static void fault_while_it_settles(void **state)
{
    struct versions *versions;
    assert_int_equal(versions_create(NULL, &versions), 0);
    versions_scanned(versions, NULL, 0);
    assert_int_equal(scan(versions, "then", NULL), VERSION_SETTLING);
    assert_int_equal(scan(versions, "", "2 model files"), VERSION_IDLE);
    assert_int_equal(scan(versions, "then", NULL), VERSION_SETTLING);
    assert_int_equal(scan(versions, "then", NULL), VERSION_WANTED);
    versions_destroy(versions);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(fault_while_it_settles)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
