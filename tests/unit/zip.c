// SPDX-License-Identifier: MIT
// The zip archives of relight room: what is written is read, an empty one too; a
// damaged one is refused for its reason.
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

// The archive of one stored file "stored" of three bytes: where its parts begin.
enum { LOCAL_AT = 0, DATA_AT = 36, CENTRAL_AT = 39, END_AT = 91, SIZE = 113 };

static uint8_t *one_file(void)
{
    struct zip_writer zip = {0};
    size_t n;
    zip_add(&zip, "stored", "\1\2\3", 3);
    uint8_t *bytes = zip_finish(&zip, &n);
    assert_non_null(bytes);
    assert_int_equal(n, SIZE);
    return bytes;
}

// Each number of an archive that lies is found. Those that are the largest right ones lie next
// to those that are refused.
static void numbers_that_lie(void **state)
{
    static const char damaged[] = "its directory is damaged",
                      outside[] = "a file lies outside the archive",
                      content[] = "a file in it is damaged";
    static const struct {
        int at, n_byte;
        uint32_t value;
        const char *fault;
    } row[] = {
        {END_AT + 10, 2, 2, damaged},
        {END_AT + 10, 2, ZIP_MOST_FILES + 1, "it has too many files"},
        {END_AT + 16, 4, CENTRAL_AT - 1, damaged},
        {END_AT + 16, 4, END_AT - 45, damaged},
        {END_AT + 16, 4, END_AT + 1, damaged},
        {END_AT + 16, 4, UINT32_MAX, damaged},
        {CENTRAL_AT, 1, 'p', damaged},
        {CENTRAL_AT + 8, 2, 1, "it is encrypted"},
        {CENTRAL_AT + 10, 2, 1, "a compression that is not supported"},
        {CENTRAL_AT + 10, 2, 8, content}, // three bytes that are no deflate stream
        {CENTRAL_AT + 16, 1, 0, content}, // the sum
        {CENTRAL_AT + 20, 4, 2, content}, // stored in fewer bytes than it has
        {CENTRAL_AT + 20, 4, SIZE - DATA_AT + 1, outside},
        {CENTRAL_AT + 20, 4, UINT32_MAX, outside},
        {CENTRAL_AT + 24, 4, 4, content},
        {CENTRAL_AT + 24, 4, ZIP_MOST_BYTES + 1, "it unpacks to more than 256 MiB"},
        {CENTRAL_AT + 28, 2, 0, "a name is too long"},
        {CENTRAL_AT + 28, 2, 7, damaged}, // name, extra field and comment end before the end
        {CENTRAL_AT + 30, 2, 1, damaged},
        {CENTRAL_AT + 32, 2, 1, damaged},
        {CENTRAL_AT + 32, 2, 65535, damaged},
        {CENTRAL_AT + 42, 4, 1, outside},
        {CENTRAL_AT + 42, 4, SIZE - 29, outside},
        {CENTRAL_AT + 42, 4, SIZE + 1, outside},
        {CENTRAL_AT + 46, 1, 0, "a name has a zero byte"},
        {LOCAL_AT, 1, 'p', outside},
        {LOCAL_AT + 26, 2, 65535, outside},
        {LOCAL_AT + 28, 2, 65535, outside},
        {LOCAL_AT + 28, 2, SIZE - DATA_AT - 2, outside},
        {LOCAL_AT + 28, 2, 1, content}, // the bytes begin one later
        {DATA_AT, 1, 2, content},
        {0, 0, 0, NULL},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        uint8_t *bytes = one_file();
        struct zip_file *file = NULL;
        size_t n_file = 0;
        char fault[160] = "";
        for (int k = 0; k < row[i].n_byte; k++)
            bytes[row[i].at + k] = (uint8_t)(row[i].value >> 8 * k);
        const int status = zip_read(bytes, SIZE, &file, &n_file, fault);
        if (status != (row[i].fault ? -1 : 0) ||
            strcmp(fault, row[i].fault ? row[i].fault : ""))
            fail_msg("%u at %d: status %d, \"%s\" in place of \"%s\"", row[i].value, row[i].at,
                     status, fault, row[i].fault ? row[i].fault : "");
        if (!status) zip_free(file, n_file);
        free(bytes);
    }
}

// Other programs write a comment behind the end, and an extra field before a file's bytes.
static void other_programs(void **state)
{
    uint8_t *bytes = one_file(), *more = calloc(1, SIZE + 2 + 300);
    assert_non_null(more);
    memcpy(more, bytes, DATA_AT);
    memcpy(more + DATA_AT + 2, bytes + DATA_AT, SIZE - DATA_AT);
    more[LOCAL_AT + 28] = 2;                // the extra field
    more[END_AT + 2 + 16] = CENTRAL_AT + 2; // the directory begins after it
    for (size_t comment = 0; comment <= 300; comment += 100) {
        struct zip_file *file = NULL;
        size_t n_file = 0;
        char fault[160] = "";
        assert_int_equal(zip_read(more, SIZE + 2 + comment, &file, &n_file, fault), 0);
        assert_int_equal(n_file, 1);
        assert_string_equal(file[0].name, "stored");
        assert_int_equal(file[0].n, 3);
        assert_memory_equal(file[0].bytes, "\1\2\3", 3);
        zip_free(file, n_file);
    }
    free(more);
    free(bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(written_and_read), cmocka_unit_test(end_record_alone),
        cmocka_unit_test(numbers_that_lie), cmocka_unit_test(other_programs)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
