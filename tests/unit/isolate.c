// SPDX-License-Identifier: MIT
// The isolated child: results and log lines come back; crashes, endless loops, hunger for
// memory and forbidden system calls do not reach the parent.
#include "prt/base.h"

#include <errno.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdio.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>
#include <cmocka.h>

static char last_line[1024];
static int n_line;

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
    n_line++;
}

static int run(prt_isolate_fn fn, void *arg, double seconds, struct prt_blob *out)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    struct prt_isolate_limits limits = {.memory_bytes = 256 << 20, .seconds = seconds};
    n_line = 0;
    last_line[0] = 0;
    *out = (struct prt_blob){NULL, 0};
    return prt_isolate(&ctx, "thing.xyz", &limits, fn, arg, out);
}

static int give(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    size_t n = *(size_t *)arg;
    if (ctx->pool) return PRT_INTERNAL;
    unsigned char *bytes = prt_alloc(n, 1);
    for (size_t i = 0; i < n; i++) bytes[i] = (unsigned char)(i * 131 >> 3);
    *out = (struct prt_blob){bytes, n};
    prt_log(ctx, PRT_LOG_NOTE, "made %zu", n);
    return PRT_OK;
}

static void result_returns(void **state)
{
    for (size_t n = 1; n < 20000000; n = n * 7 + 3) {
        struct prt_blob out;
        assert_int_equal(run(give, &n, 20, &out), PRT_OK);
        assert_int_equal(out.size, n);
        for (size_t i = 0; i < n; i++)
            if (((unsigned char *)out.bytes)[i] != (unsigned char)(i * 131 >> 3)) fail();
        assert_int_equal(n_line, 1);
        prt_free(out.bytes);
    }
}

static int refuse(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    return prt_fail(ctx, PRT_UNSUPPORTED, "%s", "no such thing");
}

static void status_returns(void **state)
{
    struct prt_blob out;
    assert_int_equal(run(refuse, NULL, 5, &out), PRT_UNSUPPORTED);
    assert_string_equal(last_line, "no such thing");
    assert_null(out.bytes);
}

static int crash(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    abort();
}

static void crash_is_format(void **state)
{
    struct prt_blob out;
    assert_int_equal(run(crash, NULL, 5, &out), PRT_FORMAT);
    assert_non_null(strstr(last_line, "thing.xyz"));
}

static int spin(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    for (;;) pause();
    return PRT_OK;
}

static void endless_is_limit(void **state)
{
    struct prt_blob out;
    double begin = prt_time_s();
    assert_int_equal(run(spin, NULL, 0.5, &out), PRT_LIMIT);
    assert_true(prt_time_s() - begin < 5);
    assert_non_null(strstr(last_line, "thing.xyz"));
}

static char *volatile hoard; // or the compiler sees that nobody looks at the memory

static int hunger(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    for (int i = 0; i < 64; i++) {
        char *p = malloc(64 << 20);
        if (!p) return PRT_NOMEM;
        memset(p, 1, 64 << 20);
        hoard = p;
    }
    return PRT_OK;
}

static void memory_is_bounded(void **state)
{
    struct prt_blob out;
    assert_int_not_equal(run(hunger, NULL, 20, &out), PRT_OK);
}

static int forbidden(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    if (socket(AF_INET, SOCK_STREAM, 0) >= 0) return PRT_ARG;
    if (fork() >= 0) return PRT_IO;
    if (open("/dev/null", O_WRONLY) >= 0) return PRT_LIMIT;
    if (write(*(int *)arg, "x", 1) >= 0) return PRT_NOMEM; // the parent's files are closed
    int fd = open("/dev/null", O_RDONLY);
    return fd >= 0 ? PRT_OK : PRT_INTERNAL;
}

static void calls_are_denied(void **state)
{
    struct prt_blob out;
    int fd = open("/dev/null", O_WRONLY | O_CLOEXEC);
    assert_true(fd >= 0);
    int high = fcntl(fd, F_DUPFD, 40);
    assert_int_equal(run(forbidden, &high, 5, &out), PRT_OK);
    close(high);
    close(fd);
}

static int noise(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    if (write(2, "chatter\n", 8) != 8 || write(1, "chatter\n", 8) != 8) return PRT_IO;
    return PRT_OK;
}

static void noise_is_hidden(void **state)
{
    struct prt_blob out;
    assert_int_equal(run(noise, NULL, 5, &out), PRT_OK);
    assert_int_equal(n_line, 0);
    assert_int_equal(waitpid(-1, NULL, WNOHANG), -1); // and nobody is left behind
    assert_int_equal(errno, ECHILD);
}

struct busy {
    const struct prt_context *ctx;
    int bad[8];
};

static int load_in_thread(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct busy *busy = arg;
    for (size_t i = begin; i < end; i++) {
        size_t n = 1000 + i;
        struct prt_blob out = {NULL, 0};
        int status = prt_isolate(busy->ctx, "thing", NULL, give, &n, &out);
        busy->bad[i] = status || out.size != n;
        prt_free(out.bytes);
    }
    return PRT_OK;
}

static void ignore_line(void *user, enum prt_log_level level, const char *line)
{
}

// Children forked from several threads of a pool at once do not wait for its locks.
static void threads_may_fork(void **state)
{
    struct prt_context ctx;
    struct busy busy = {.ctx = &ctx};
    prt_context_init(&ctx);
    ctx.log = ignore_line;
    assert_int_equal(prt_pool_create(4, &ctx.pool), PRT_OK);
    for (int round = 0; round < 5; round++)
        assert_int_equal(prt_parallel_for(&ctx, NULL, 8, 1, load_in_thread, &busy), PRT_OK);
    for (int i = 0; i < 8; i++) assert_int_equal(busy.bad[i], 0);
    prt_pool_destroy(ctx.pool);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(result_returns),    cmocka_unit_test(status_returns),
        cmocka_unit_test(crash_is_format),   cmocka_unit_test(endless_is_limit),
        cmocka_unit_test(memory_is_bounded), cmocka_unit_test(calls_are_denied),
        cmocka_unit_test(noise_is_hidden),   cmocka_unit_test(threads_may_fork),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
