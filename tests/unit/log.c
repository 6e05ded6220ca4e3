// SPDX-License-Identifier: MIT
// The daemon's log: arguments cannot forge fields, a reader that does not read costs nothing
// but lines, and one call site cannot flood it.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "core/log.h"
#include "core/log_format.h"

#include <cjson/cJSON.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

static int saved = -1, reading = -1;

// stderr becomes a pipe.
static void take_stderr(void)
{
    int end[2];
    assert_int_equal(pipe(end), 0);
    fflush(stderr);
    saved = dup(STDERR_FILENO);
    dup2(end[1], STDERR_FILENO);
    close(end[1]);
    reading = end[0];
    fcntl(reading, F_SETFL, O_NONBLOCK);
}

static void give_stderr_back(void)
{
    dup2(saved, STDERR_FILENO);
    close(saved);
    close(reading);
}

static size_t read_log(char *text, size_t room)
{
    size_t n = 0;
    for (ssize_t m; n < room - 1 && (m = read(reading, text + n, room - 1 - n)) > 0;)
        n += (size_t)m;
    text[n] = 0;
    return n;
}

static void expect(const char *argument, const char *escaped)
{
    char text[4096], wanted[512];
    take_stderr();
    log_line(LOG_WARN, "escape text=\"%s\"", argument);
    read_log(text, sizeof text);
    give_stderr_back();
    snprintf(wanted, sizeof wanted, " warning escape text=\"%s\"\n", escaped);
    assert_non_null(strstr(text, wanted));
}

static void arguments_are_escaped(void **state)
{
    expect("plain", "plain");
    expect("x\" level=error user=\"root", "x\\\" level=error user=\\\"root");
    expect("back\\slash", "back\\\\slash");
    expect("line\nbreak\x1b[2J\x7f", "line\\x0abreak\\x1b[2J\\x7f");
    expect("gr\xc3\xbc\xc3\x9f\x65 \xe2\x80\xa6", "gr\xc3\xbc\xc3\x9f\x65 \xe2\x80\xa6");
    expect("\xff\xfe\x80", "\\xff\\xfe\\x80"); // no UTF-8
    expect("\xc2\x9b", "\\xc2\\x9b");          // C1: a terminal's CSI in one character
    expect("\xe0\x80\xaf \xed\xa0\x80",
           "\\xe0\\x80\\xaf \\xed\\xa0\\x80"); // overlong, surrogate
    expect("\xf0\x9f\x90", "\\xf0\\x9f\\x90"); // cut inside a character
}

static void conversions_match_printf(void **state)
{
    char text[4096];
    take_stderr();
    log_line(LOG_WARN, "kinds %d %5u %-4d| %llu %zu %08lx %.3f %.1g %.*s %.2s %c %%", -3, 7u,
             12, 18446744073709551615ull, (size_t)9, 255ul, 3.14159, 0.25, 2, "abc", "xyz",
             '!');
    read_log(text, sizeof text);
    give_stderr_back();
    assert_non_null(strstr(
        text, " kinds -3     7 12  | 18446744073709551615 9 000000ff 3.142 0.2 ab xy ! %\n"));
}

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void one_call_site_cannot_flood(void **state)
{
    static char text[1 << 20];
    take_stderr();
    fcntl(reading, F_SETPIPE_SZ, 1 << 20);
    uint64_t before = log_lost();
    double start = now_s();
    for (int i = 0; i < 5000; i++) log_line(LOG_WARN, "flood i=%d", i);
    double took = now_s() - start;
    log_line(LOG_WARN, "other site");
    read_log(text, sizeof text);
    give_stderr_back();
    int lines = 0;
    for (char *at = text; (at = strstr(at, " flood ")); at++) lines++;
    print_message("5000 lines in %.3f s: %d written\n", took, lines);
    assert_in_range(lines, LOG_BURST, LOG_BURST + (int)(took * LOG_RATE) + 1);
    assert_int_equal(log_lost() - before, 5000 - lines);
    assert_non_null(strstr(text, " other site\n"));
}

static void log_part(int part, int n)
{
    for (int i = 0; i < n; i++) log_line(LOG_WARN, "ebb part=%d i=%d", part, i);
}

// A limited site has LOG_RATE lines a second again, in fractions of a second too.
static void a_site_recovers(void **state)
{
    static char text[1 << 20];
    enum { MORE = 100 };
    take_stderr();
    fcntl(reading, F_SETPIPE_SZ, 1 << 20);
    double start = now_s();
    log_part(1, 2 * LOG_BURST);
    double limited = now_s();
    usleep(400000);
    double again = now_s();
    log_part(2, MORE);
    double end = now_s();
    read_log(text, sizeof text);
    give_stderr_back();
    int lines = 0;
    for (char *at = text; (at = strstr(at, " part=2 ")); at++) lines++;
    int least = (int)((again - limited) * LOG_RATE), most = (int)((end - start) * LOG_RATE) + 1;
    print_message("%d lines after %.3f s\n", lines, again - limited);
    assert_in_range(lines, least < MORE ? least : MORE, most);
}

// Each of 400 call sites has a format of its own: the rate limit does not help here.
static void a_full_pipe_does_not_block(void **state)
{
    static char format[400][32];
    static char filler[1100];
    static char text[2 << 20];
    memset(filler, 'f', sizeof filler - 1);
    take_stderr();
    log_start();
    uint64_t lost = log_lost();
    double start = now_s();
    for (int i = 0; i < 400; i++) {
        snprintf(format[i], sizeof format[i], "fill%d text=%%s", i);
#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wformat-nonliteral"
        log_line(LOG_WARN, format[i], filler); // nobody reads
#pragma GCC diagnostic pop
    }
    double took = now_s() - start;
    uint64_t dropped = log_lost() - lost;
    print_message("400 lines of 1.1 kB into a full pipe: %.4f s, %llu dropped\n", took,
                  (unsigned long long)dropped);
    assert_true(took < 20); // a line that waits for a reader waits for ever
    assert_in_range(dropped, 50, 250);
    size_t n = 0; // somebody reads again: the loss is told
    for (int i = 0; i < 200 && !strstr(text, "log dropped="); i++) {
        usleep(10000);
        n += read_log(text + n, sizeof text - n);
    }
    log_stop();
    give_stderr_back();
    assert_non_null(strstr(text, "log dropped="));
}

static void *log_traces(void *unused)
{
    for (int i = 0; i < 1000; i++) log_line(LOG_TRACE, "not shown i=%d", i);
    return NULL;
}

// A reload sets the level while other threads log. The thread sanitizer is the judge.
static void the_level_changes_while_threads_log(void **state)
{
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, log_traces, NULL), 0);
    for (int i = 0; i < 1000; i++) log_set_level(i % 2 ? LOG_EVENT : LOG_WARN);
    pthread_join(thread, NULL);
}

// A line that does not fit ends early: its fields are those of the whole line, in their order,
// the last one cut between two characters.
static void lines_that_do_not_fit(void **state)
{
    static const char text[] =
        "2026-01-02T03:04:05Z warning two words \xe2\x80\xa6 "
        "name=\"gr\xc3\xbc\xc3\x9f\x65 \\\"\xe2\x80\xa6\xf0\x9f\x90\x9f\\\" "
        "\\\\ \\x1b\\\\\" path=\xe2\x80\xa6\xc3\xbc/\xc3\xbc n=12";
    char all[400], out[400];
    size_t whole = log_reformat(LOG_FORMAT_JSON, text, sizeof text - 1, all, sizeof all), n = 0;
    cJSON *want = cJSON_ParseWithLength(all, whole);
    assert_int_equal(cJSON_GetArraySize(want), 6);
    for (size_t room = 80; n < whole; room++) {
        memset(out, '#', sizeof out);
        n = log_reformat(LOG_FORMAT_JSON, text, sizeof text - 1, out, room);
        assert_true(n < room && out[room] == '#');
        cJSON *got = cJSON_ParseWithLength(out, n);
        if (!got) fail_msg("no JSON: %.*s", (int)n, out);
        const cJSON *w = want->child;
        for (const cJSON *g = got->child; g; g = g->next, w = w->next) {
            size_t length = strlen(g->valuestring);
            assert_string_equal(g->string, w->string);
            assert_memory_equal(g->valuestring, w->valuestring, length);
            if (g->next) assert_int_equal(length, strlen(w->valuestring));
            else assert_true((w->valuestring[length] & 0xc0) != 0x80);
        }
        cJSON_Delete(got);
    }
    cJSON_Delete(want);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(arguments_are_escaped),
        cmocka_unit_test(conversions_match_printf),
        cmocka_unit_test(lines_that_do_not_fit),
        cmocka_unit_test(one_call_site_cannot_flood),
        cmocka_unit_test(a_site_recovers),
        cmocka_unit_test(a_full_pipe_does_not_block),
        cmocka_unit_test(the_level_changes_while_threads_log),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
