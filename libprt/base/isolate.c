// SPDX-License-Identifier: MIT
// The isolated child: untrusted bytes are parsed in a forked process that has limits on memory,
// time and system calls. One pipe carries log lines and then the result back to the parent.
#include "prt/base.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>
#ifdef PRT_HAVE_SECCOMP
#include <sched.h>
#include <seccomp.h>
#endif

#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define SANITIZED 1
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define SANITIZED 1
#endif
#ifndef SANITIZED
#define SANITIZED 0
#endif

enum { TAG_LOG = 0x4c4f4721, TAG_RESULT = 0x52455321, LINE_MAX_BYTES = 1024, LINES_MAX = 500 };
enum { NOISE_BYTES = 1 << 20 }; // what the child may print to stderr

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

static void child_log(void *user, enum prt_log_level level, const char *line)
{
    char message[sizeof(struct head) + LINE_MAX_BYTES];
    size_t n = strnlen(line, LINE_MAX_BYTES);
    struct head head = {TAG_LOG, (int32_t)level, n};
    memcpy(message, &head, sizeof head);
    memcpy(message + sizeof head, line, n);
    put(*(int *)user, message, sizeof head + n); // below PIPE_BUF: atomic among threads
}

#ifdef PRT_HAVE_SECCOMP
static const int denied[] = {
    SCMP_SYS(socket),
    SCMP_SYS(socketpair),
    SCMP_SYS(connect),
    SCMP_SYS(bind),
    SCMP_SYS(listen),
    SCMP_SYS(accept),
    SCMP_SYS(accept4),
    SCMP_SYS(sendto),
    SCMP_SYS(sendmsg),
    SCMP_SYS(sendmmsg),
    SCMP_SYS(execve),
    SCMP_SYS(execveat),
    SCMP_SYS(ptrace),
    SCMP_SYS(process_vm_readv),
    SCMP_SYS(process_vm_writev),
    SCMP_SYS(fork),
    SCMP_SYS(vfork),
    SCMP_SYS(kill),
    SCMP_SYS(tkill),
    SCMP_SYS(rt_sigqueueinfo),
    SCMP_SYS(rt_tgsigqueueinfo),
    SCMP_SYS(pidfd_open),
    SCMP_SYS(pidfd_send_signal),
    SCMP_SYS(bpf),
    SCMP_SYS(perf_event_open),
    SCMP_SYS(userfaultfd),
    SCMP_SYS(io_uring_setup),
    SCMP_SYS(keyctl),
    SCMP_SYS(add_key),
    SCMP_SYS(request_key),
    SCMP_SYS(mount),
    SCMP_SYS(umount2),
    SCMP_SYS(pivot_root),
    SCMP_SYS(chroot),
    SCMP_SYS(unshare),
    SCMP_SYS(setns),
    SCMP_SYS(init_module),
    SCMP_SYS(finit_module),
    SCMP_SYS(kexec_load),
    SCMP_SYS(reboot),
    SCMP_SYS(creat),
    SCMP_SYS(unlink),
    SCMP_SYS(unlinkat),
    SCMP_SYS(rename),
    SCMP_SYS(renameat),
    SCMP_SYS(renameat2),
    SCMP_SYS(link),
    SCMP_SYS(linkat),
    SCMP_SYS(symlink),
    SCMP_SYS(symlinkat),
    SCMP_SYS(mkdir),
    SCMP_SYS(mkdirat),
    SCMP_SYS(rmdir),
    SCMP_SYS(mknod),
    SCMP_SYS(mknodat),
    SCMP_SYS(truncate),
    SCMP_SYS(chmod),
    SCMP_SYS(fchmod),
    SCMP_SYS(fchmodat),
    SCMP_SYS(chown),
    SCMP_SYS(fchown),
    SCMP_SYS(lchown),
    SCMP_SYS(fchownat),
    SCMP_SYS(setxattr),
    SCMP_SYS(prlimit64),
    SCMP_SYS(setrlimit),
    SCMP_SYS(open_by_handle_at),
    SCMP_SYS(openat2),
};

// Threads, reading files and memory stay allowed; programs, sockets, other processes and every
// way of changing a file answer EPERM. Best effort: without seccomp the limits still hold.
static void deny_calls(void)
{
    scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ALLOW);
    if (!filter) return;
    const uint32_t no = SCMP_ACT_ERRNO(EPERM);
    for (size_t i = 0; i < sizeof denied / sizeof *denied; i++)
        seccomp_rule_add(filter, no, denied[i], 0);
    for (unsigned mode = O_WRONLY; mode <= O_ACCMODE; mode++) {
        seccomp_rule_add(filter, no, SCMP_SYS(open), 1,
                         SCMP_A1(SCMP_CMP_MASKED_EQ, O_ACCMODE, mode));
        seccomp_rule_add(filter, no, SCMP_SYS(openat), 1,
                         SCMP_A2(SCMP_CMP_MASKED_EQ, O_ACCMODE, mode));
    }
    seccomp_rule_add(filter, no, SCMP_SYS(open), 1,
                     SCMP_A1(SCMP_CMP_MASKED_EQ, O_CREAT, O_CREAT));
    seccomp_rule_add(filter, no, SCMP_SYS(openat), 1,
                     SCMP_A2(SCMP_CMP_MASKED_EQ, O_CREAT, O_CREAT));
    seccomp_rule_add(filter, no, SCMP_SYS(tgkill), 1,
                     SCMP_A0(SCMP_CMP_NE, (scmp_datum_t)getpid()));
    seccomp_rule_add(filter, no, SCMP_SYS(clone), 1,
                     SCMP_A0(SCMP_CMP_MASKED_EQ, CLONE_THREAD, 0));
    // its flags lie in memory, where a filter cannot look: libc falls back to clone
    seccomp_rule_add(filter, SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(clone3), 0);
    seccomp_load(filter);
    seccomp_release(filter);
}
#else
static void deny_calls(void)
{
}
#endif

static void set_limit(int which, uint64_t soft, uint64_t hard)
{
    struct rlimit old, limit = {soft, hard};
    if (getrlimit(which, &old)) return;
    if (limit.rlim_max > old.rlim_max) limit.rlim_max = old.rlim_max;
    if (limit.rlim_cur > limit.rlim_max) limit.rlim_cur = limit.rlim_max;
    setrlimit(which, &limit);
}

// Pages the process has, after /proc/self/statm: field 0 is all of them, 5 is private data.
static uint64_t pages(int field)
{
    unsigned long long value[7] = {0};
    FILE *f = fopen("/proc/self/statm", "re");
    if (!f) return 0;
    for (int i = 0; i < 7; i++)
        if (fscanf(f, "%llu", &value[i]) != 1) break;
    fclose(f);
    return value[field];
}

static void set_limits(uint64_t memory_bytes, double seconds)
{
    uint64_t page = (uint64_t)sysconf(_SC_PAGESIZE);
    // A sanitizer reserves terabytes of address space as it runs; only data can be bounded.
    if (SANITIZED)
        set_limit(RLIMIT_DATA, pages(5) * page + 4 * memory_bytes,
                  pages(5) * page + 4 * memory_bytes);
    else set_limit(RLIMIT_AS, pages(0) * page + memory_bytes, pages(0) * page + memory_bytes);
    uint64_t cpu = (uint64_t)ceil(seconds);
    struct rusage used;
    if (!getrusage(RUSAGE_SELF, &used)) // 0 after fork, but be exact
        cpu += (uint64_t)used.ru_utime.tv_sec + (uint64_t)used.ru_stime.tv_sec;
    set_limit(RLIMIT_CPU, cpu, cpu + 1);
    set_limit(RLIMIT_CORE, 0, 0);
    set_limit(RLIMIT_FSIZE, NOISE_BYTES, NOISE_BYTES);
}

static void close_from(int first)
{
    if (!syscall(SYS_close_range, first, ~0u, 0)) return;
    long n = sysconf(_SC_OPEN_MAX);
    for (int fd = first; fd < (n > 0 && n < 65536 ? n : 65536); fd++) close(fd);
}

// 0-2 become nothing, nothing and the noise file; 3 is the pipe; everything else is closed.
static int settle_files(int pipe_fd, int noise_fd)
{
    int null = open("/dev/null", O_RDWR | O_CLOEXEC);
    int keep = fcntl(pipe_fd, F_DUPFD_CLOEXEC, 10),
        noise = fcntl(noise_fd, F_DUPFD_CLOEXEC, 10);
    if (null < 0 || keep < 0) _exit(3);
    dup2(null, 0);
    dup2(null, 1);
    dup2(noise >= 0 ? noise : null, 2);
    dup2(keep, 3);
    close_from(4);
    return 3;
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

_Noreturn static void child(const struct prt_context *parent_ctx, pid_t parent, int pipe_fd,
                            int noise_fd, const struct prt_isolate_limits *limits,
                            prt_isolate_fn fn, void *arg)
{
    settle_signals(parent);
    int fd = settle_files(pipe_fd, noise_fd);
    set_limits(limits->memory_bytes, limits->seconds);
    prctl(PR_SET_DUMPABLE, 0);
    deny_calls();
    struct prt_context ctx;
    if (parent_ctx) ctx = *parent_ctx;
    else prt_context_init(&ctx);
    ctx.log = child_log;
    ctx.log_user = &fd;
    ctx.progress = NULL;
    ctx.pool = NULL; // its threads were not forked
    struct prt_blob out = {NULL, 0};
    int status = fn(&ctx, arg, &out);
    if (!out.bytes || status) out.size = 0;
    struct head head = {TAG_RESULT, status, out.size};
    _exit(put(fd, &head, sizeof head) && put(fd, out.bytes, out.size) ? 0 : 3);
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

static int explain(const struct prt_context *ctx, const char *what, int how, bool late,
                   const struct prt_isolate_limits *limits)
{
    if (late || (WIFSIGNALED(how) && (WTERMSIG(how) == SIGXCPU || WTERMSIG(how) == SIGKILL)))
        return prt_fail(ctx, PRT_LIMIT, "%s: gave up reading it after %g s", what,
                        limits->seconds);
    if (WIFSIGNALED(how))
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: the decoder crashed (%s) or ran out of its %llu MB; the file is "
                        "probably damaged",
                        what, strsignal(WTERMSIG(how)),
                        (unsigned long long)(limits->memory_bytes >> 20));
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
    int noise = memfd_create("prt-isolate", MFD_CLOEXEC);
    pid_t parent = getpid(), pid = fork();
    if (pid == 0) child(ctx, parent, end[1], noise, &own, fn, arg);
    int error = errno;
    close(end[1]);
    if (pid < 0) {
        close(end[0]);
        if (noise >= 0) close(noise);
        return prt_fail(ctx, PRT_NOMEM, "%s: no child process: %s", what, strerror(error));
    }
    struct answer answer = {0};
    enum got got =
        listen_to(ctx, what, end[0], prt_time_s() + own.seconds, own.memory_bytes, &answer);
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
