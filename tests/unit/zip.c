// SPDX-License-Identifier: MIT
// The zip archives of relight room: what is written is read, an empty one too.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "cli/zip.h"

static void written_and_read(void **state)
{
    static const char twice[] = "abcabcabcabcabcabcabcabcabcabcabcabcabcabcabcabcabcabcabcabc";
    struct zip_writer zip = {0};
    zip_add(&zip, "stored", "\1\2\3", 3);
    zip_add(&zip, "folder/deflated", twice, sizeof twice);
    zip_add(&zip, "nothing", "", 0);
    size_t n = 0, n_file = 0;
    uint8_t *bytes = zip_finish(&zip, &n);
    struct zip_file *file = NULL;
    char fault[160] = "";
    assert_non_null(bytes);
    assert_int_equal(zip_read(bytes, n, &file, &n_file, fault), 0);
    assert_int_equal(n_file, 3);
    assert_string_equal(file[0].name, "stored");
    assert_int_equal(file[0].n, 3);
    assert_memory_equal(file[0].bytes, "\1\2\3", 4);
    assert_string_equal(file[1].name, "folder/deflated");
    assert_int_equal(file[1].n, sizeof twice);
    assert_memory_equal(file[1].bytes, twice, sizeof twice);
    assert_string_equal(file[2].name, "nothing");
    assert_int_equal(file[2].n, 0);
    zip_free(file, n_file);
    free(bytes);
}

// An archive without files is its end record alone, 22 bytes; a shorter one is none.
static void end_record_alone(void **state)
{
    struct zip_writer zip = {0};
    size_t n = 0, n_file = 7;
    uint8_t *bytes = zip_finish(&zip, &n);
    struct zip_file *file = NULL;
    char fault[160] = "";
    assert_non_null(bytes);
    assert_int_equal(n, 22);
    assert_int_equal(zip_read(bytes, n, &file, &n_file, fault), 0);
    assert_int_equal(n_file, 0);
    zip_free(file, n_file);
    assert_int_equal(zip_read(bytes, n - 1, &file, &n_file, fault), -1);
    assert_string_equal(fault, "it is no zip archive");
    free(bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(written_and_read),
                                       cmocka_unit_test(end_record_alone)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
