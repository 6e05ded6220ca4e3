// SPDX-License-Identifier: MIT
// The store of uploads and the account of bytes on disk, without a daemon around them.
#include <errno.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/options.h"
#include "store/disk.h"

static char folder[] = "/tmp/blobs-test-XXXXXX";

// ---- the account of bytes by owner

static void test_disk_is_charged_by_owner(void **state)
{
    struct options options = {.disk = 10000, .client_disk = 6000};
    struct ledger *ledger = ledger_create(&options);
    char error[256];
    assert_non_null(ledger);
    assert_int_equal(disk_size(0), 0);
    assert_int_equal(disk_size(1), 4096);
    assert_int_equal(disk_size(4097), 8192);
    disk_charge(ledger, "uid:1", 5000);
    assert_int_equal(disk_take(ledger, "uid:1", 1001, error), LEDGER_CLIENT_FULL);
    assert_non_null(strstr(error, "--client-disk"));
    assert_int_equal(disk_take(ledger, "uid:2", 5001, error), LEDGER_ALL_FULL);
    assert_non_null(strstr(error, "--disk"));
    assert_int_equal(disk_take(ledger, "uid:2", 5000, error), LEDGER_GRANTED);
    assert_int_equal(disk_bytes(ledger), 10000);
    assert_int_equal(disk_bytes_of(ledger, "uid:1"), 5000);
    disk_charge(ledger, "uid:1", -5000);
    assert_int_equal(disk_bytes_of(ledger, "uid:1"), 0);
    disk_charge(ledger, "uid:2", -6000); // more than is held: all of it
    assert_int_equal(disk_bytes(ledger), 0);
    ledger_destroy(ledger);
}

static void test_owner_is_kept_beside_the_file(void **state)
{
    char path[128], owner[96];
    snprintf(path, sizeof path, "%s/file", folder);
    disk_owner_read(path, owner);
    assert_string_equal(owner, DISK_NOBODY);
    assert_int_equal(disk_owner_write(path, "token:ann"), 0);
    disk_owner_read(path, owner);
    assert_string_equal(owner, "token:ann");
    strcat(path, ".owner");
    assert_int_equal(unlink(path), 0);
    snprintf(path, sizeof path, "%s/none/file", folder);
    assert_int_equal(disk_owner_write(path, "token:ann"), -ENOENT);
}

static int setup(void **state)
{
    return mkdtemp(folder) ? 0 : -1;
}

static int teardown(void **state)
{
    return rmdir(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_disk_is_charged_by_owner),
        cmocka_unit_test(test_owner_is_kept_beside_the_file),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
