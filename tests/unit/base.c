// SPDX-License-Identifier: MIT
// Files that are written whole or not at all, the words for instruction sets, and loops that
// end early.
#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <malloc.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "prt/base.h"

static char folder[64], last_line[1024];

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

static struct prt_context quiet(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    last_line[0] = 0;
    return ctx;
}

static int entries_of(const char *path)
{
    DIR *dir = opendir(path);
    assert_non_null(dir);
    int n = 0;
    for (struct dirent *e; (e = readdir(dir));) n += e->d_name[0] != '.';
    closedir(dir);
    return n;
}

static void in_folder(char out[128], const char *name)
{
    snprintf(out, 128, "%s/%s", folder, name);
}

static void files_are_replaced_whole(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_blob blob;
    struct prt_writer *w;
    char path[128];
    in_folder(path, "file");
    assert_int_equal(prt_write_file(&ctx, path, "old", 3), PRT_OK);
    assert_int_equal(prt_writer_open(&ctx, path, &w), PRT_OK);
    assert_int_equal(prt_writer_write(w, "new ", 4), PRT_OK);
    assert_int_equal(prt_read_file(&ctx, path, 100, &blob), PRT_OK);
    assert_string_equal(blob.bytes, "old"); // until the writer finishes
    prt_free(blob.bytes);
    assert_int_equal(prt_writer_write(w, "bytes", 5), PRT_OK);
    assert_int_equal(prt_writer_finish(w), PRT_OK);
    assert_int_equal(prt_read_file(&ctx, path, 9, &blob), PRT_OK);
    assert_string_equal(blob.bytes, "new bytes");
    prt_free(blob.bytes);
    assert_int_equal(prt_read_file(&ctx, path, 8, &blob), PRT_LIMIT);
    assert_int_equal(entries_of(folder), 1);
    assert_int_equal(unlink(path), 0);
}

// The target becomes a folder while the file is being written: the rename fails after
// everything else succeeded, and the temporary file has to go.
static void a_failed_rename_leaves_no_temporary_file(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_writer *w;
    char path[128];
    in_folder(path, "target");
    assert_int_equal(prt_writer_open(&ctx, path, &w), PRT_OK);
    assert_int_equal(prt_writer_write(w, "bytes", 5), PRT_OK);
    assert_int_equal(entries_of(folder), 1); // the temporary file
    assert_int_equal(mkdir(path, 0777), 0);
    assert_int_equal(prt_writer_finish(w), PRT_IO);
    assert_non_null(strstr(last_line, path));
    assert_non_null(strstr(last_line, strerror(EISDIR)));
    assert_int_equal(entries_of(folder), 1); // the folder alone
    assert_int_equal(rmdir(path), 0);
    assert_int_equal(entries_of(folder), 0);
}

// The disk is full in the middle: what was there stays, though the caller goes on.
static void a_failed_write_leaves_the_earlier_file(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_writer *w;
    struct rlimit all, little = {.rlim_cur = 100};
    struct prt_blob blob;
    char path[128], many[1000] = "";
    in_folder(path, "file");
    assert_int_equal(prt_write_file(&ctx, path, "earlier", 7), PRT_OK);
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &all), 0);
    little.rlim_max = all.rlim_max;
    void (*before)(int) = signal(SIGXFSZ, SIG_IGN);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &little), 0);
    assert_int_equal(prt_writer_open(&ctx, path, &w), PRT_OK);
    int first = prt_writer_write(w, many, sizeof many), next = prt_writer_write(w, many, 1);
    assert_int_equal(setrlimit(RLIMIT_FSIZE, &all), 0);
    signal(SIGXFSZ, before);
    assert_int_equal(first, PRT_IO);
    assert_int_equal(next, PRT_IO);
    assert_int_equal(prt_writer_finish(w), PRT_IO);
    assert_int_equal(prt_read_file(&ctx, path, 100, &blob), PRT_OK);
    assert_string_equal(blob.bytes, "earlier");
    prt_free(blob.bytes);
    assert_int_equal(entries_of(folder), 1);
    assert_int_equal(unlink(path), 0);
}

static void an_abandoned_file_leaves_nothing(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_writer *w;
    char path[128];
    in_folder(path, "file");
    assert_int_equal(prt_writer_open(&ctx, path, &w), PRT_OK);
    assert_int_equal(prt_writer_write(w, "bytes", 5), PRT_OK);
    prt_writer_abandon(w);
    assert_int_equal(entries_of(folder), 0);
    in_folder(path, "none/file");
    assert_int_equal(prt_writer_open(&ctx, path, &w), PRT_IO);
    assert_int_equal(prt_write_file(&ctx, folder, "bytes", 5), PRT_IO);
    assert_int_equal(prt_write_file(&ctx, "/dev/full", "bytes", 5), PRT_IO);
    assert_int_equal(entries_of(folder), 0);
}

// A path beyond PATH_MAX, of the file or of its temporary one, is an error that keeps no
// memory.
static void a_path_that_is_too_long(void **state)
{
    struct prt_context ctx = quiet();
    char path[PATH_MAX + 2];
    memset(path, 'd', sizeof path);
    path[sizeof path - 1] = 0;
    assert_int_equal(prt_write_file(&ctx, path, "bytes", 5), PRT_IO);
    const size_t before = mallinfo2().uordblks;
    for (size_t n = PATH_MAX - 8; n < sizeof path; n++) {
        path[n] = 0;
        assert_int_equal(prt_write_file(&ctx, path, "bytes", 5), PRT_IO);
        assert_non_null(strstr(last_line, "the path is too long"));
        path[n] = 'd';
    }
    assert_true(mallinfo2().uordblks <= before);
}

static void cpu_words_come_back(void **state)
{
    static const struct {
        const char *word;
        unsigned allowed;
    } words[] = {
#define X(word, bit, allowed) {word, allowed},
        PRT_CPU_WORD_LIST(X)
#undef X
    };
    const unsigned here = prt_cpu_detect();
    unsigned mask = 123;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++) {
        assert_int_equal(prt_cpu_parse(words[i].word, &mask), PRT_OK);
        assert_int_equal(mask, here & words[i].allowed);
        assert_string_equal(prt_cpu_word(words[i].allowed), words[i].word);
        assert_non_null(strstr(PRT_CPU_WORDS, words[i].word));
    }
    mask = 123;
    assert_int_equal(prt_cpu_parse("sse", &mask), PRT_ARG);
    assert_int_equal(mask, 123);
    assert_string_equal(prt_cpu_word(PRT_CPU_C), "c");
    assert_string_equal(prt_cpu_word(PRT_CPU_AVX2 | PRT_CPU_AVX512), "avx512");
}

struct pieces {
    unsigned begun;
    size_t fails; // the piece that does
};

static int count_piece(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pieces *p = arg;
    p->begun++;
    return begin == p->fails ? PRT_FORMAT : PRT_OK;
}

static int cancel(void *user, const char *stage, double fraction, double eta_s)
{
    return ++*(unsigned *)user > 0;
}

static int wait_a_while(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pieces *p = arg;
    p->begun++;
    usleep(120000); // progress is told ten times a second
    return PRT_OK;
}

// Contract of prt_parallel_for: after a failure, and when the callback cancels, no further
// piece is begun.
static void a_failed_loop_begins_no_more(void **state)
{
    unsigned told = 0;
    struct prt_context ctx;
    struct pieces p = {0, 3};
    prt_context_init(&ctx);
    assert_int_equal(prt_parallel_for(&ctx, NULL, 1000, 1, count_piece, &p), PRT_FORMAT);
    assert_int_equal(p.begun, 4);
    ctx.progress = cancel;
    ctx.progress_user = &told;
    p = (struct pieces){0, 0};
    assert_int_equal(prt_parallel_for(&ctx, "stage", 8, 1, wait_a_while, &p), PRT_CANCELLED);
    assert_int_equal(p.begun, 1);
    assert_int_equal(told, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(files_are_replaced_whole),
        cmocka_unit_test(a_failed_rename_leaves_no_temporary_file),
        cmocka_unit_test(a_failed_write_leaves_the_earlier_file),
        cmocka_unit_test(an_abandoned_file_leaves_nothing),
        cmocka_unit_test(a_path_that_is_too_long),
        cmocka_unit_test(cpu_words_come_back),
        cmocka_unit_test(a_failed_loop_begins_no_more),
    };
    if (!mkdtemp(strcpy(folder, "/tmp/prt-base-XXXXXX"))) return 1;
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    rmdir(folder);
    return failed;
}
