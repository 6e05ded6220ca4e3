// SPDX-License-Identifier: MIT
// The isolated child: results and log lines come back; crashes, endless loops, hunger for
// memory and forbidden system calls do not reach the parent.
#include "prt/base.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/filter.h>
#include <linux/seccomp.h>
#include <poll.h>
#include <pthread.h>
#include <setjmp.h>
#include <signal.h>
#include <stdio.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>
#include <cmocka.h>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define PRT_TEST_SANITIZED 1
#else
#define PRT_TEST_SANITIZED 0
#endif

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
    for (;;) poll(NULL, 0, 1000); // pause() is denied, and would use its CPU time up
    return PRT_OK;
}

static void endless_is_limit(void **state)
{
    struct prt_blob out;
    double begin = prt_time_s();
    assert_int_equal(run(spin, NULL, 0.25, &out), PRT_LIMIT);
    assert_true(prt_time_s() - begin < 5);
    assert_non_null(strstr(last_line, "thing.xyz: gave up reading it after 1.5 s"));
}

static int burn(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    for (volatile unsigned i = 0;; i++) {
    }
    return PRT_OK;
}

static void work_without_end_is_limit(void **state)
{
    struct prt_blob out;
    assert_int_equal(run(burn, NULL, 1, &out), PRT_LIMIT);
    assert_non_null(strstr(last_line, "thing.xyz: gave up reading it after 1 s of CPU time"));
}

// As where other programs take the processor: longer than its CPU time, with little of it.
static int dawdle(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    poll(NULL, 0, 1500);
    return PRT_OK;
}

static void waiting_is_no_work(void **state)
{
    struct prt_blob out;
    assert_int_equal(run(dawdle, NULL, 1, &out), PRT_OK);
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

// Each of what must fail has a letter; the letters of what did not are the answer.
struct attempt {
    int high;           // a descriptor of the parent's
    char secret[64];    // a file that is not the input
    char victim[64];    // the input, which must stay as it is
    char folder[64];    // "": none
    const char *beside; // a file in the folder
    unsigned most_s;    // of processor time
};

static void note(char *marks, char letter, bool succeeded)
{
    size_t n = strlen(marks);
    if (succeeded && n < 60) marks[n] = letter;
}

static void *thread_main(void *arg)
{
    return arg;
}

static int attempts(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    const struct attempt *a = arg;
    char *marks = prt_calloc(64, 1);
    struct rlimit limit;
    int pair[2];
    pthread_t thread;
    note(marks, 's', socket(AF_INET, SOCK_STREAM, 0) >= 0);
    note(marks, 'S', socketpair(AF_UNIX, SOCK_STREAM, 0, pair) >= 0);
    note(marks, 'f', fork() >= 0);
    note(marks, 'e', execl("/bin/true", "true", NULL) >= 0);
    note(marks, 'k', kill(1, 0) == 0);
    note(marks, 'w', open("/dev/null", O_WRONLY) >= 0);
    note(marks, 'R', open("/dev/null", O_RDWR) >= 0);
    note(marks, 't', open(a->victim, O_RDONLY | O_TRUNC) >= 0);
    note(marks, 'T', truncate(a->victim, 0) == 0);
    note(marks, 'c', open("made-by-child", O_RDONLY | O_CREAT, 0600) >= 0);
    note(marks, 'm', open("/tmp", O_RDONLY | O_TMPFILE, 0600) >= 0);
    note(marks, 'M', memfd_create("x", 0) >= 0);
    note(marks, 'u', unlink(a->secret) == 0);
    note(marks, 'r', open(a->secret, O_RDONLY) >= 0);
    note(marks, 'p', open("/etc/passwd", O_RDONLY) >= 0);
    note(marks, 'P', open("/proc/self/environ", O_RDONLY) >= 0);
    note(marks, 'd', write(a->high, "x", 1) >= 0); // the parent's files are closed
    note(marks, 'x',
         mmap(NULL, 4096, PROT_READ | PROT_EXEC, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) !=
             MAP_FAILED);
    // The kernel lets anyone set what holds already.
    note(marks, 'l', getrlimit(RLIMIT_CPU, &limit) || setrlimit(RLIMIT_CPU, &limit) == 0);
    // Nothing is left of a crash, locked in memory or queued; processor time has an end.
    static const int none[] = {RLIMIT_CORE, RLIMIT_MEMLOCK, RLIMIT_MSGQUEUE};
    for (int i = 0; i < 3; i++)
        note(marks, (char)('1' + i), getrlimit(none[i], &limit) || limit.rlim_max > 0);
    note(marks, 'C', getrlimit(RLIMIT_CPU, &limit) || limit.rlim_max > a->most_s);
    note(marks, 'i', ioctl(0, TIOCSTI, "x") == 0);
    if (a->folder[0]) note(marks, '+', open(a->beside, O_RDONLY) < 0); // this one must be
    if (!PRT_TEST_SANITIZED)
        note(marks, 'h', pthread_create(&thread, NULL, thread_main, NULL) == 0);
    *out = (struct prt_blob){marks, 64};
    return PRT_OK;
}

static void write_text(const char *path, const char *text)
{
    assert_int_equal(prt_write_file(NULL, path, text, strlen(text)), PRT_OK);
}

static void try_all(bool with_folder)
{
    char folder[] = "/tmp/isolate-test-XXXXXX", inside[64], beside[96];
    assert_non_null(mkdtemp(folder));
    struct attempt a = {0};
    snprintf(inside, sizeof inside, "%s/model", folder);
    assert_int_equal(mkdir(inside, 0700), 0);
    snprintf(a.secret, sizeof a.secret, "%s/token", folder);
    snprintf(a.victim, sizeof a.victim, "%s/model/input", folder);
    snprintf(beside, sizeof beside, "%s/model/a.bin", folder);
    write_text(a.secret, "a token");
    write_text(a.victim, "bytes");
    write_text(beside, "buffer");
    a.beside = beside;
    if (with_folder) snprintf(a.folder, sizeof a.folder, "%s", inside);
    int fd = open("/dev/null", O_WRONLY | O_CLOEXEC);
    assert_true(fd >= 0);
    a.high = fcntl(fd, F_DUPFD, 40);
    struct prt_isolate_limits limits = {.memory_bytes = 256 << 20, .seconds = 20};
    a.most_s = 22;
    if (with_folder) limits.folder = a.folder;
    struct prt_blob out = {NULL, 0};
    assert_int_equal(prt_isolate(NULL, "thing", &limits, attempts, &a, &out), PRT_OK);
    // A sanitizer's build may look at /proc/self.
    const char *marks = out.bytes;
    assert_string_equal(marks + (PRT_TEST_SANITIZED ? strspn(marks, "Pxl") : 0), "");
    prt_free(out.bytes);
    struct prt_blob left;
    assert_int_equal(prt_read_file(NULL, a.victim, 100, &left), PRT_OK);
    assert_int_equal(left.size, 5);
    prt_free(left.bytes);
    close(a.high);
    close(fd);
    assert_int_equal(unlink(beside) | unlink(a.victim) | unlink(a.secret), 0);
    assert_int_equal(rmdir(inside) | rmdir(folder), 0);
}

static void calls_are_denied(void **state)
{
    try_all(false);
}

// With a folder, files in it can be read and nothing else changes.
static void folder_is_readable(void **state)
{
    if (syscall(444, NULL, 0, 1) < 1) return; // no Landlock: then no file can be opened
    try_all(true);
}

static int start_thread(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    pthread_t thread;
    if (pthread_create(&thread, NULL, thread_main, NULL)) return PRT_NOMEM;
    return pthread_join(thread, NULL) || fork() >= 0 ? PRT_INTERNAL : PRT_OK;
}

static void threads_where_wanted(void **state)
{
    struct prt_isolate_limits limits = {.threads = true};
    struct prt_blob out = {NULL, 0};
    assert_int_equal(prt_isolate(NULL, "thing", &limits, start_thread, NULL, &out), PRT_OK);
}

static int read_input(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    return prt_read_fd(ctx, "input", PRT_ISOLATE_INPUT_FD, 1000, out);
}

static void input_comes_by_descriptor(void **state)
{
    char path[] = "/tmp/isolate-test-XXXXXX";
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    assert_int_equal(unlink(path), 0);
    assert_int_equal(write(fd, "twelve bytes", 12), 12);
    struct prt_isolate_limits limits = {.input_fd = fd};
    struct prt_blob out = {NULL, 0};
    assert_int_equal(prt_isolate(NULL, "thing", &limits, read_input, NULL, &out), PRT_OK);
    assert_int_equal(out.size, 12);
    assert_memory_equal(out.bytes, "twelve bytes", 12);
    prt_free(out.bytes);
    close(fd);
}

// Runs body in a child whose system calls pass the filter, for kernels that lack some. Returns
// the negative of its status and fails unless the child's last log line, where it has one,
// names the option that accepts this.
static int under(const struct sock_filter *code, unsigned short n_code, bool accepted,
                 int (*body)(void), bool *told)
{
    char text[1024] = "";
    int how, end[2];
    assert_int_equal(pipe(end), 0);
    pid_t pid = fork();
    if (pid == 0) {
        last_line[0] = 0;
        struct sock_fprog program = {n_code, (struct sock_filter *)(uintptr_t)code};
        if (accepted) setenv(PRT_ACCEPT_WEAK_SANDBOX, "1", 1);
        else unsetenv(PRT_ACCEPT_WEAK_SANDBOX);
        if (prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) ||
            prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, &program))
            _exit(99);
        int status = body();
        if (write(end[1], last_line, strlen(last_line)) < 0) _exit(98);
        _exit(-status);
    }
    close(end[1]);
    ssize_t n = read(end[0], text, sizeof text - 1);
    close(end[0]);
    assert_true(n >= 0);
    assert_int_equal(waitpid(pid, &how, 0), pid);
    assert_true(WIFEXITED(how));
    *told = strstr(text, "--accept-weak-sandbox") != NULL;
    return -WEXITSTATUS(how);
}

static int give_ten(void)
{
    size_t n = 10;
    struct prt_blob out;
    return run(give, &n, 20, &out);
}

// A kernel without seccomp: the child cannot load its own filter.
static int without_seccomp(bool accepted)
{
    const struct sock_filter code[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_seccomp, 3, 0),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, SYS_prctl, 0, 1),
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, args[0])),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, PR_SET_SECCOMP, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | EINVAL),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
    };
    bool told;
    int status = under(code, sizeof code / sizeof *code, accepted, give_ten, &told);
    if (status) assert_true(told);
    return status;
}

// PRT_OK where neither a file of the folder nor another can be opened, PRT_IO where both can.
static int open_files(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    const int in = open("/etc/passwd", O_RDONLY), beside = open("/usr/bin/env", O_RDONLY);
    return in < 0 && beside < 0 ? PRT_OK : in >= 0 && beside >= 0 ? PRT_IO : PRT_INTERNAL;
}

static int open_in_etc(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    struct prt_isolate_limits limits = {
        .memory_bytes = 256 << 20, .seconds = 20, .folder = "/etc"};
    struct prt_blob out = {NULL, 0};
    return prt_isolate(&ctx, "thing.xyz", &limits, open_files, NULL, &out);
}

// A kernel without Landlock: no file can be opened, unless the weak sandbox is accepted.
static void without_landlock_no_file_opens(void **state)
{
    if (PRT_TEST_SANITIZED) return; // the sanitizers open files of their own
    const struct sock_filter code[] = {
        BPF_STMT(BPF_LD | BPF_W | BPF_ABS, offsetof(struct seccomp_data, nr)),
        BPF_JUMP(BPF_JMP | BPF_JEQ | BPF_K, 444, 0, 1),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ERRNO | ENOSYS),
        BPF_STMT(BPF_RET | BPF_K, SECCOMP_RET_ALLOW),
    };
    const unsigned short n = sizeof code / sizeof *code;
    bool told;
    assert_int_equal(under(code, n, false, open_in_etc, &told), PRT_OK);
    assert_true(told);
    assert_int_equal(under(code, n, true, open_in_etc, &told), PRT_IO);
}

static void weak_sandbox_is_an_error(void **state)
{
    assert_int_equal(without_seccomp(false), PRT_UNSUPPORTED);
    assert_int_equal(without_seccomp(true), PRT_OK);
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
        cmocka_unit_test(result_returns),
        cmocka_unit_test(status_returns),
        cmocka_unit_test(crash_is_format),
        cmocka_unit_test(endless_is_limit),
        cmocka_unit_test(work_without_end_is_limit),
        cmocka_unit_test(waiting_is_no_work),
        cmocka_unit_test(memory_is_bounded),
        cmocka_unit_test(calls_are_denied),
        cmocka_unit_test(noise_is_hidden),
        cmocka_unit_test(threads_may_fork),
        cmocka_unit_test(folder_is_readable),
        cmocka_unit_test(input_comes_by_descriptor),
        cmocka_unit_test(weak_sandbox_is_an_error),
        cmocka_unit_test(without_landlock_no_file_opens),
        cmocka_unit_test(threads_where_wanted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
