// SPDX-License-Identifier: MIT
// What a scan of --models finds, and which files a .gltf names (server/store/import_file.h).
#include "store/import_file.h"

#include "ops/load.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "descriptors.h"

static char folder[] = "/tmp/import-list-XXXXXX";

static void put_text(const char *name, const char *text)
{
    char path[300];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    for (char *slash = path + strlen(folder) + 1; (slash = strchr(slash, '/'));
         *slash++ = '/') {
        *slash = 0;
        mkdir(path, 0700);
    }
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    assert_true(fputs(text, file) >= 0);
    assert_int_equal(fclose(file), 0);
}

static void list_known(struct import_list *list, const char *name)
{
    *list = (struct import_list){0};
    assert_non_null(list->known = calloc(1, sizeof *list->known));
    assert_non_null(list->known[0].name = strdup(name));
    list->n_known = 1;
    import_list(folder, list);
}

// A scan that lacks descriptors says nothing of the folder: files that it could not open are
// not gone.
static void test_scan_without_descriptors(void **state)
{
    struct import_list list;
    put_text("a.prt", "");
    put_text("ball/model.json", "{}");
    put_text("ball/1/o.obj", "v 0 0 0\n");
    list_known(&list, "a.prt");
    assert_true(list.readable);
    assert_int_equal(list.n, 2);
    assert_true(list.known[0].stamp[0]);
    import_list_finish(&list);
    list_known(&list, "gone.prt"); // one that is not there is no fault of the scan
    assert_true(list.readable);
    assert_false(list.known[0].stamp[0]);
    import_list_finish(&list);
    for (unsigned n = 0; n < 4; n++) { // the folder; a file or NAME; NAME/VERSION; model.json
        rlim_t before = allow_descriptors(n);
        list_known(&list, "a.prt");
        descriptors_again(before);
        assert_false(list.readable);
        import_list_finish(&list);
    }
    rlim_t before = allow_descriptors(4);
    list_known(&list, "a.prt");
    descriptors_again(before);
    assert_true(list.readable);
    assert_int_equal(list.n, 2);
    import_list_finish(&list);
}

static void copy(const char *name, struct import_file *out)
{
    char to[300];
    atomic_bool stop = false;
    snprintf(to, sizeof to, "%s/copies", folder);
    mkdir(to, 0700);
    import_copy_file(folder, name, to, "", "", 1 << 30, &stop, out);
}

static void test_names_in_a_gltf(void **state)
{
    struct import_file file;
    put_text("names.gltf", "{\"buffers\": [{\"uri\": \"a%20b.bin\"}, {\"uri\": \"100%.bin\"},"
                           "{\"uri\": \"%c3%A4.bin\"}, {\"uri\": \"%2e%2e/up.bin\"},"
                           "{\"uri\": \"a%20b.bin\"}, {\"uri\": \"% f.bin\"}]}");
    copy("names.gltf", &file);
    assert_int_equal(file.code, 0);
    assert_int_equal(file.n_name, 4);
    assert_string_equal(file.name[0], "a b.bin");
    assert_string_equal(file.name[1], "100%.bin");
    assert_string_equal(file.name[2], "\xc3\xa4.bin");
    assert_string_equal(file.name[3], "% f.bin");
    import_file_finish(&file);
}

// The time for names with per cent signs grows with the file, not with its square.
static void test_names_take_linear_time(void **state)
{
    enum { N = 4000, SIGNS = 190 };
    struct import_file file;
    struct timespec begin, end;
    char *text = malloc(N * (3 * SIGNS + 12) + 1), *at = text;
    assert_non_null(text);
    for (int i = 0; i < N; i++) {
        at += sprintf(at, "\"uri\":\"");
        for (int k = 0; k < SIGNS; k++) at += sprintf(at, "%%41");
        at += sprintf(at, "\",\n");
    }
    put_text("many.gltf", text);
    free(text);
    clock_gettime(CLOCK_MONOTONIC, &begin);
    copy("many.gltf", &file);
    clock_gettime(CLOCK_MONOTONIC, &end);
    assert_int_equal(file.code, 0);
    assert_int_equal(file.n_name, 1);
    assert_true(end.tv_sec - begin.tv_sec < 5);
    import_file_finish(&file);
}

// The copies of a LOAD's files are in use, and stay on the disk, until it has ended; a file too
// many is not added.
static void test_files_of_a_load_are_used(void **state)
{
    struct load *load = calloc(1, sizeof *load);
    struct import_copy copy = {.refs = 1};
    assert_true(load_add_file(load, "upload.bin", "", NULL));
    for (size_t n = load->n_file; n < MAX_FILES; n++) {
        assert_int_equal(copy.users, n - 1);
        assert_true(load_add_file(load, "a.bin", "", &copy));
        assert_int_equal(copy.refs, 1 + copy.users);
    }
    assert_false(load_add_file(load, "b.bin", "", &copy));
    assert_int_equal(load->n_file, MAX_FILES);
    assert_int_equal(copy.users, MAX_FILES - 1);
    assert_true(copy.used_ns > 0);
    load_drop(load);
    assert_int_equal(copy.users, 0);
    assert_int_equal(copy.refs, 1);
}

// A model.json has at most 64 KiB.
static void test_largest_settings(void **state)
{
    enum { MOST = 64 << 10 };
    for (size_t n = MOST; n <= MOST + 1; n++) {
        struct import_list list;
        bool found = false;
        char *text = calloc(1, n + 1);
        assert_non_null(text);
        memset(text, ' ', n);
        memcpy(text, "{}", 2);
        put_text("large/1/model.json", text);
        put_text("large/1/o.obj", "v 0 0 0\n");
        list_known(&list, "a.prt");
        for (size_t i = 0; i < list.n; i++) {
            const struct import_entry *e = &list.entry[i];
            if (!e->version || strcmp(e->version, "large/1")) continue;
            found = true;
            assert_int_equal(e->fault[0] == 0, n == MOST);
            if (n == MOST) assert_string_equal(e->settings, text);
        }
        assert_true(found);
        import_list_finish(&list);
        free(text);
    }
}

// Of a file's name only printable characters of UTF-8 are shown as they are; other bytes come
// as their numbers, and the name ends before one that has no room.
static void test_printable_names(void **state)
{
    static const char *const names[][2] = {
        {"\xc3\xa4 \xe2\x82\xac \xf0\x9f\x8e\xb1", "\xc3\xa4 \xe2\x82\xac \xf0\x9f\x8e\xb1"},
        {"a\tb\x7f", "a\\x09b\\x7f"},
        {"\xc2\x80\xc2\x9f\xc2\xa0", "\\xc2\\x80\\xc2\\x9f\xc2\xa0"}, // C1 controls
        {"\xc0\xaf\xe0\x9f\xbf", "\\xc0\\xaf\\xe0\\x9f\\xbf"},        // overlong
        {"\xed\xa0\x80\xf4\x90\x80\x80", "\\xed\\xa0\\x80\\xf4\\x90\\x80\\x80"},
        {"\xe2\x82", "\\xe2\\x82"}};
    char out[64];
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        name_printable(names[i][0], out, sizeof out);
        assert_string_equal(out, names[i][1]);
    }
    name_printable("abcdefgh", out, 8);
    assert_string_equal(out, "abc");
}

static int setup(void **state)
{
    return mkdtemp(folder) ? 0 : -1;
}

static int teardown(void **state)
{
    char command[100];
    snprintf(command, sizeof command, "rm -rf %s", folder);
    return system(command);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_scan_without_descriptors),
        cmocka_unit_test(test_names_in_a_gltf),
        cmocka_unit_test(test_names_take_linear_time),
        cmocka_unit_test(test_files_of_a_load_are_used),
        cmocka_unit_test(test_largest_settings),
        cmocka_unit_test(test_printable_names),
    };
    return cmocka_run_group_tests_name("import_list", tests, setup, teardown);
}
