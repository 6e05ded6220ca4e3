// SPDX-License-Identifier: MIT
// The isolated child: untrusted bytes are parsed in a forked process that has limits on memory,
// time, files and system calls. One pipe carries log lines and then the result back to the
// parent.
#include "base/sandbox.h"
#include "prt/base.h"

#include <errno.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

enum { TAG_LOG = 0x4c4f4721, TAG_RESULT = 0x52455321, LINE_MAX_BYTES = 1024, LINES_MAX = 500 };
enum { PIPE_FD = 3 };

// Precedes every message in the pipe.
struct head {
    uint32_t tag;
    int32_t code;  // log level or status
    uint64_t size; // bytes that follow
};

static bool put(int fd, const void *bytes, size_t n)
{
    const char *at = bytes;
    while (n) {
        ssize_t done = write(fd, at, n < (1u << 30) ? n : (1u << 30));
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) return false;
        at += done;
        n -= (size_t)done;
    }
    return true;
}

// Each piece's pages are given back as soon as the parent has them, so that the two processes
// together hold little more than one copy.
static bool put_result(int fd, const struct prt_blob *blob)
{
    const size_t piece = 8 << 20, page = (size_t)sysconf(_SC_PAGESIZE);
    char *bytes = blob->bytes;
    for (size_t at = 0; at < blob->size; at += piece) {
        size_t n = blob->size - at < piece ? blob->size - at : piece;
        if (!put(fd, bytes + at, n)) return false;
        uintptr_t begin = ((uintptr_t)(bytes + at) + page - 1) & ~(uintptr_t)(page - 1);
        uintptr_t end = (uintptr_t)(bytes + at + n) & ~(uintptr_t)(page - 1);
        if (!SANITIZED && begin < end) madvise((void *)begin, end - begin, MADV_DONTNEED);
    }
    return true;
}

static void child_log(void *user, enum prt_log_level level, const char *line)
{
    char message[sizeof(struct head) + LINE_MAX_BYTES];
    size_t n = strnlen(line, LINE_MAX_BYTES);
    struct head head = {TAG_LOG, (int32_t)level, n};
    memcpy(message, &head, sizeof head);
    memcpy(message + sizeof head, line, n);
    put(*(int *)user, message, sizeof head + n); // below PIPE_BUF: atomic among threads
}

static void close_from(int first)
{
    if (!syscall(SYS_close_range, first, ~0u, 0)) return;
    long n = sysconf(_SC_OPEN_MAX);
    for (int fd = first; fd < (n > 0 && n < 65536 ? n : 65536); fd++) close(fd);
}

// 0-2 become nothing, nothing and the noise file; 3 is the pipe, 4 the input; everything else
// is closed.
static void settle_files(int pipe_fd, int noise_fd, int input_fd)
{
    int null = open("/dev/null", O_RDWR | O_CLOEXEC);
    int keep = fcntl(pipe_fd, F_DUPFD_CLOEXEC, 10), input = -1;
    int noise = noise_fd >= 0 ? fcntl(noise_fd, F_DUPFD_CLOEXEC, 10) : null;
    if (input_fd > 0) input = fcntl(input_fd, F_DUPFD_CLOEXEC, 10);
    if (null < 0 || keep < 0 || noise < 0 || (input_fd > 0 && input < 0) || dup2(null, 0) < 0 ||
        dup2(null, 1) < 0 || dup2(noise, 2) < 0 || dup2(keep, PIPE_FD) < 0 ||
        (input >= 0 && dup2(input, PRT_ISOLATE_INPUT_FD) < 0))
        _exit(3);
    close_from(input >= 0 ? PRT_ISOLATE_INPUT_FD + 1 : PIPE_FD + 1);
}

static void settle_signals(pid_t parent)
{
    sigset_t none;
    sigemptyset(&none);
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (getppid() != parent) _exit(3);
    for (int s = 1; s < NSIG; s++) {
        bool fatal = s == SIGSEGV || s == SIGBUS || s == SIGFPE || s == SIGILL || s == SIGABRT;
        if (!(SANITIZED && fatal)) signal(s, SIG_DFL); // a sanitizer's own handlers stay
    }
    signal(SIGXFSZ, SIG_IGN);
    signal(SIGPIPE, SIG_IGN); // a parent that gave up is seen as a failed write
    sigprocmask(SIG_SETMASK, &none, NULL);
}

static bool weak_accepted(void)
{
    const char *word = getenv(PRT_ACCEPT_WEAK_SANDBOX);
    return word && !strcmp(word, "1");
}

// Confines the child or says why the file is not read.
static int confine(const struct prt_context *ctx, const char *what,
                   const struct prt_isolate_limits *limits)
{
    bool weak = weak_accepted();
    const char *part = "resource limits";
    int error = 0;
    if (!prt_sandbox_limits(limits->memory_bytes, limits->seconds, limits->threads) ||
        prctl(PR_SET_DUMPABLE, 0) || prctl(PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
        error = errno;
    enum landlock_state landlock =
        error ? LANDLOCK_ABSENT : prt_sandbox_landlock(limits->folder);
    if (landlock == LANDLOCK_FAILED) {
        part = "Landlock";
        error = errno;
    }
    if (!error) {
        // Without Landlock any file could be read: then none can be opened.
        bool may_open = limits->folder && (landlock == LANDLOCK_ON || weak);
        part = "seccomp";
        error = -prt_sandbox_filter(may_open, limits->threads);
        if (!error && limits->folder && !may_open)
            prt_log(ctx, PRT_LOG_NOTE,
                    "%s: files beside it cannot be read: this kernel has no Landlock; "
                    "--accept-weak-sandbox allows it",
                    what);
    }
    if (!error || weak) return PRT_OK;
    return prt_fail(ctx, PRT_UNSUPPORTED,
                    "%s: not read, as the process that decodes it cannot be confined (%s: %s); "
                    "--accept-weak-sandbox or %s=1 reads it all the same",
                    what, part, strerror(error), PRT_ACCEPT_WEAK_SANDBOX);
}

_Noreturn static void child(const struct prt_context *parent_ctx, const char *what,
                            pid_t parent, int pipe_fd, int noise_fd,
                            const struct prt_isolate_limits *limits, prt_isolate_fn fn,
                            void *arg)
{
    settle_signals(parent);
    settle_files(pipe_fd, noise_fd, limits->input_fd);
    int fd = PIPE_FD;
    struct prt_context ctx;
    if (parent_ctx) ctx = *parent_ctx;
    else prt_context_init(&ctx);
    ctx.log = child_log;
    ctx.log_user = &fd;
    ctx.progress = NULL;
    ctx.pool = NULL; // its threads were not forked
    struct prt_blob out = {NULL, 0};
    if (limits->prepare) limits->prepare(arg);
    int status = confine(&ctx, what, limits);
    if (!status) status = fn(&ctx, arg, &out);
    if (!out.bytes || status) out.size = 0;
    struct head head = {TAG_RESULT, status, out.size};
    _exit(put(fd, &head, sizeof head) && put_result(fd, &out) ? 0 : 3);
}

enum got { GOT_ALL, GOT_END, GOT_LATE };

// Reads exactly n bytes before the deadline.
static enum got take(int fd, void *bytes, size_t n, double deadline_s)
{
    char *at = bytes;
    while (n) {
        double left = deadline_s - prt_time_s();
        if (left <= 0) return GOT_LATE;
        struct pollfd p = {fd, POLLIN, 0};
        int ready = poll(&p, 1, left > 1000 ? 1000000 : (int)(left * 1000) + 1);
        if (ready == 0 || (ready < 0 && errno == EINTR)) continue;
        ssize_t got = read(fd, at, n);
        if (got < 0 && (errno == EINTR || errno == EAGAIN)) continue;
        if (got <= 0) return GOT_END;
        at += got;
        n -= (size_t)got;
    }
    return GOT_ALL;
}

struct answer {
    bool have; // the child sent a result
    int status;
    struct prt_blob blob;
};

// Everything the child says, until its result or the end of the pipe.
static enum got listen_to(const struct prt_context *ctx, const char *what, int fd,
                          double deadline_s, uint64_t max_bytes, struct answer *answer)
{
    for (int lines = 0;;) {
        struct head head;
        char line[LINE_MAX_BYTES + 1];
        enum got got = take(fd, &head, sizeof head, deadline_s);
        if (got != GOT_ALL) return got;
        if (head.tag == TAG_LOG && head.size <= LINE_MAX_BYTES) {
            if ((got = take(fd, line, (size_t)head.size, deadline_s)) != GOT_ALL) return got;
            line[head.size] = 0;
            if (++lines <= LINES_MAX && head.code >= PRT_LOG_ERROR && head.code <= PRT_LOG_NOTE)
                prt_log(ctx, (enum prt_log_level)head.code, "%s", line);
            continue;
        }
        if (head.tag != TAG_RESULT) return GOT_END; // its memory is not to be trusted
        if (head.size > max_bytes) {
            answer->have = true;
            answer->status = prt_fail(ctx, PRT_LIMIT, "%s: needs more than %llu MB", what,
                                      (unsigned long long)(max_bytes >> 20));
            return GOT_ALL;
        }
        if (head.size) {
            answer->blob.bytes = prt_alloc((size_t)head.size, 1);
            answer->blob.size = (size_t)head.size;
            if (!answer->blob.bytes) {
                answer->have = true;
                answer->status = prt_fail(ctx, PRT_NOMEM, "%s: no memory for %llu bytes", what,
                                          (unsigned long long)head.size);
                return GOT_ALL;
            }
            if ((got = take(fd, answer->blob.bytes, (size_t)head.size, deadline_s)) != GOT_ALL)
                return got;
        }
        answer->have = true;
        answer->status = head.code > 0 || head.code < PRT_MISMATCH ? PRT_INTERNAL : head.code;
        return GOT_ALL;
    }
}

// A sanitizer's report in the child is a defect of ours: it must be seen.
static void show_noise(int fd)
{
    char buffer[4096];
    ssize_t n;
    if (!SANITIZED || fd < 0) return;
    for (off_t at = 0; (n = pread(fd, buffer, sizeof buffer, at)) > 0; at += n)
        if (fwrite(buffer, 1, (size_t)n, stderr) != (size_t)n) break;
}

static int reap(pid_t pid)
{
    int status = 0;
    while (waitpid(pid, &status, 0) < 0)
        if (errno != EINTR) return -1; // SIGCHLD ignored: the result is all we know
    return status;
}

static atomic_uint crashes;

unsigned prt_isolate_crashes(void)
{
    return crashes;
}

static int explain(const struct prt_context *ctx, const char *what, int how, bool late,
                   const struct prt_isolate_limits *limits)
{
    if (late)
        return prt_fail(ctx, PRT_LIMIT, "%s: gave up reading it after %g s", what,
                        PRT_ISOLATE_WALL * limits->seconds);
    if (WIFSIGNALED(how) && (WTERMSIG(how) == SIGXCPU || WTERMSIG(how) == SIGKILL))
        return prt_fail(ctx, PRT_LIMIT, "%s: gave up reading it after %g s of CPU time", what,
                        limits->seconds);
    if (WIFSIGNALED(how)) {
        crashes++;
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: the decoder crashed (%s) or ran out of its %llu MB; the file is "
                        "probably damaged",
                        what, strsignal(WTERMSIG(how)),
                        (unsigned long long)(limits->memory_bytes >> 20));
    }
    return prt_fail(ctx, PRT_FORMAT, "%s: the decoder stopped with status %d", what,
                    WIFEXITED(how) ? WEXITSTATUS(how) : -1);
}

int prt_isolate(const struct prt_context *ctx, const char *what,
                const struct prt_isolate_limits *limits, prt_isolate_fn fn, void *arg,
                struct prt_blob *out)
{
    struct prt_isolate_limits own = limits ? *limits : (struct prt_isolate_limits){0};
    if (!own.memory_bytes) own.memory_bytes = 4ull << 30;
    if (!(own.seconds > 0)) own.seconds = 60;
    if (own.memory_bytes > 1ull << 44) own.memory_bytes = 1ull << 44;
    if (own.seconds > 1e6) own.seconds = 1e6;
    int end[2];
    if (pipe2(end, O_CLOEXEC)) return prt_fail(ctx, PRT_IO, "%s: %s", what, strerror(errno));
    (void)fcntl(end[1], F_SETPIPE_SZ, 1 << 20);
    // What libraries print is dropped; a sanitizer's report is not.
    int noise = SANITIZED ? memfd_create("prt-isolate", MFD_CLOEXEC) : -1;
    pid_t parent = getpid(), pid = fork();
    if (pid == 0) child(ctx, what, parent, end[1], noise, &own, fn, arg);
    int error = errno;
    close(end[1]);
    if (pid < 0) {
        close(end[0]);
        if (noise >= 0) close(noise);
        return prt_fail(ctx, PRT_NOMEM, "%s: no child process: %s", what, strerror(error));
    }
    struct answer answer = {0};
    double deadline_s = prt_time_s() + PRT_ISOLATE_WALL * own.seconds;
    enum got got = listen_to(ctx, what, end[0], deadline_s, own.memory_bytes, &answer);
    close(end[0]);
    if (got == GOT_LATE || answer.have) kill(pid, SIGKILL); // nothing more is wanted of it
    int how = reap(pid);
    show_noise(noise);
    if (noise >= 0) close(noise);
    int status = answer.have ? answer.status : explain(ctx, what, how, got == GOT_LATE, &own);
    if (status) {
        prt_free(answer.blob.bytes);
        return status;
    }
    *out = answer.blob;
    return PRT_OK;
}
