// SPDX-License-Identifier: MIT
// The confinement of a process that parses untrusted bytes. The filter is a list of the calls
// that are allowed. Any other call fails with EPERM and does not kill the process: libraries
// probe calls (sched_getaffinity, prctl, sysinfo) and go on without them, and a new libc may
// make a call that this list does not know. An attacker gains nothing by it: the call does not
// happen. A call by another architecture's numbers kills the process.
#include "base/sandbox.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <sched.h>
#include <stdio.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>
#ifdef PRT_HAVE_SECCOMP
#include <seccomp.h>
#endif

// ---- resource limits

static bool set_limit(int which, uint64_t soft, uint64_t hard)
{
    struct rlimit old, limit = {soft, hard};
    if (getrlimit(which, &old)) return false;
    if (limit.rlim_max > old.rlim_max) limit.rlim_max = old.rlim_max;
    if (limit.rlim_cur > limit.rlim_max) limit.rlim_cur = limit.rlim_max;
    return !setrlimit(which, &limit);
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

bool prt_sandbox_limits(uint64_t memory_bytes, double seconds, bool may_thread)
{
    enum { FILES = 16 }; // the pipe, the input, one buffer of a glTF and the folders on its way
    uint64_t page = (uint64_t)sysconf(_SC_PAGESIZE), cpu = (uint64_t)ceil(seconds);
    struct rusage used;
    if (!getrusage(RUSAGE_SELF, &used)) // 0 after fork, but be exact
        cpu += (uint64_t)used.ru_utime.tv_sec + (uint64_t)used.ru_stime.tv_sec;
    bool ok = set_limit(RLIMIT_CPU, cpu, cpu + 1) && set_limit(RLIMIT_CORE, 0, 0) &&
              set_limit(RLIMIT_MEMLOCK, 0, 0) && set_limit(RLIMIT_MSGQUEUE, 0, 0);
    // A sanitizer reserves terabytes of address space as it runs: only data can be bounded. It
    // has a thread of its own and writes its reports to a file.
    if (SANITIZED) {
        uint64_t data = pages(5) * page + 4 * memory_bytes;
        return ok && set_limit(RLIMIT_DATA, data, data) &&
               set_limit(RLIMIT_FSIZE, NOISE_BYTES, NOISE_BYTES) &&
               set_limit(RLIMIT_NOFILE, 64, 64);
    }
    uint64_t all = pages(0) * page + memory_bytes;
    return ok && set_limit(RLIMIT_AS, all, all) && set_limit(RLIMIT_FSIZE, 0, 0) &&
           (may_thread || set_limit(RLIMIT_NPROC, 0, 0)) &&
           set_limit(RLIMIT_NOFILE, FILES, FILES);
}

// ---- Landlock, by its numbers: the headers of an older system lack some

enum {
    LANDLOCK_CREATE_RULESET = 444,
    LANDLOCK_ADD_RULE = 445,
    LANDLOCK_RESTRICT_SELF = 446,
    LANDLOCK_VERSION_FLAG = 1,
    LANDLOCK_PATH_BENEATH = 1,
    LANDLOCK_READ_FILE = 1 << 2,
    LANDLOCK_READ_DIR = 1 << 3,
};

struct landlock_ruleset {
    uint64_t fs, net, scoped;
};

struct landlock_path {
    uint64_t allowed;
    int32_t folder_fd;
} __attribute__((packed));

// Every right of the kernel's version: what is not handled stays allowed.
static size_t ruleset_of(long version, struct landlock_ruleset *rules)
{
    int rights = version >= 5 ? 16 : version >= 3 ? 15 : version >= 2 ? 14 : 13;
    *rules = (struct landlock_ruleset){
        .fs = (UINT64_C(1) << rights) - 1,
        .net = version >= 4 ? 3 : 0,    // bind, connect
        .scoped = version >= 6 ? 3 : 0, // abstract unix sockets, signals
    };
    return version >= 6 ? 24 : version >= 4 ? 16 : 8;
}

static bool allow_folder(int ruleset, const char *path)
{
    struct landlock_path rule = {.allowed = LANDLOCK_READ_FILE | LANDLOCK_READ_DIR,
                                 .folder_fd = open(path, O_PATH | O_DIRECTORY | O_CLOEXEC)};
    if (rule.folder_fd < 0) return errno == ENOENT; // nothing to allow
    bool ok = !syscall(LANDLOCK_ADD_RULE, ruleset, LANDLOCK_PATH_BENEATH, &rule, 0);
    close(rule.folder_fd);
    return ok;
}

enum landlock_state prt_sandbox_landlock(const char *folder)
{
    struct landlock_ruleset rules;
    long version = syscall(LANDLOCK_CREATE_RULESET, NULL, 0, LANDLOCK_VERSION_FLAG);
    if (version < 1) return LANDLOCK_ABSENT;
    size_t size = ruleset_of(version, &rules);
    int ruleset = (int)syscall(LANDLOCK_CREATE_RULESET, &rules, size, 0);
    if (ruleset < 0) return LANDLOCK_FAILED;
    bool ok = !folder || allow_folder(ruleset, folder);
    if (SANITIZED)
        ok = ok && allow_folder(ruleset, "/proc/self") && allow_folder(ruleset, "/usr");
    ok = ok && !syscall(LANDLOCK_RESTRICT_SELF, ruleset, 0);
    int error = errno;
    close(ruleset);
    errno = error;
    return ok ? LANDLOCK_ON : LANDLOCK_FAILED;
}

// ---- the filter

#ifdef PRT_HAVE_SECCOMP
static const int allowed[] = {
    // memory
    SCMP_SYS(brk),
    SCMP_SYS(munmap),
    SCMP_SYS(mremap),
    SCMP_SYS(madvise),
    // descriptors it has: the pipe, the input, nowhere
    SCMP_SYS(read),
    SCMP_SYS(readv),
    SCMP_SYS(pread64),
    SCMP_SYS(write),
    SCMP_SYS(writev),
    SCMP_SYS(lseek),
    SCMP_SYS(close),
    SCMP_SYS(fstat),
    SCMP_SYS(poll),
    SCMP_SYS(ppoll),
    // time, and randomness for hash tables
    SCMP_SYS(clock_gettime),
    SCMP_SYS(gettimeofday),
    SCMP_SYS(time),
    SCMP_SYS(clock_getres),
    SCMP_SYS(clock_nanosleep),
    SCMP_SYS(nanosleep),
    SCMP_SYS(getrandom),
    // itself
    SCMP_SYS(futex),
    SCMP_SYS(sched_yield),
    SCMP_SYS(sched_getaffinity),
    SCMP_SYS(getpid),
    SCMP_SYS(gettid),
    SCMP_SYS(getuid),
    SCMP_SYS(geteuid),
    SCMP_SYS(getgid),
    SCMP_SYS(getegid),
    SCMP_SYS(getrusage),
    SCMP_SYS(getrlimit),
    SCMP_SYS(set_robust_list),
    SCMP_SYS(rseq),
    SCMP_SYS(rt_sigaction),
    SCMP_SYS(rt_sigprocmask),
    SCMP_SYS(rt_sigreturn),
    SCMP_SYS(sigaltstack),
    SCMP_SYS(restart_syscall),
    SCMP_SYS(exit),
    SCMP_SYS(exit_group),
};

// Names of files: whether they are there and what kind they are. Only where files may be
// opened.
static const int allowed_names[] = {
    SCMP_SYS(newfstatat), SCMP_SYS(stat),       SCMP_SYS(lstat),  SCMP_SYS(statx),
    SCMP_SYS(readlink),   SCMP_SYS(readlinkat), SCMP_SYS(access), SCMP_SYS(faccessat),
    SCMP_SYS(faccessat2), SCMP_SYS(getcwd),
};

// A sanitizer reads /proc/self/maps, has a thread of its own and maps memory as it likes.
static const int allowed_sanitized[] = {
    SCMP_SYS(mmap),       SCMP_SYS(mprotect),   SCMP_SYS(prctl),      SCMP_SYS(pipe),
    SCMP_SYS(pipe2),      SCMP_SYS(dup),        SCMP_SYS(getppid),    SCMP_SYS(tgkill),
    SCMP_SYS(uname),      SCMP_SYS(ioctl),      SCMP_SYS(prlimit64),  SCMP_SYS(fcntl),
    SCMP_SYS(getdents64), SCMP_SYS(membarrier), SCMP_SYS(arch_prctl), SCMP_SYS(sysinfo),
};

static int allow_all(scmp_filter_ctx filter, const int *calls, size_t n)
{
    int status = 0;
    for (size_t i = 0; !status && i < n; i++)
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, calls[i], 0);
    return status;
}

// Reading only: none of the flags that write, create, empty or make a nameless file.
static int allow_open(scmp_filter_ctx filter)
{
    const unsigned harmless =
        O_CLOEXEC | O_NOFOLLOW | O_DIRECTORY | O_NONBLOCK | O_NOCTTY | O_LARGEFILE;
    const scmp_datum_t others = (uint32_t)~harmless;
    int status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(open), 1,
                                  SCMP_A1(SCMP_CMP_MASKED_EQ, others, 0));
    if (!status)
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(openat), 1,
                                  SCMP_A2(SCMP_CMP_MASKED_EQ, others, 0));
    if (!status)
        status = allow_all(filter, allowed_names, sizeof allowed_names / sizeof *allowed_names);
    return status;
}

static int allow_plain(scmp_filter_ctx filter)
{
    const scmp_datum_t self = (scmp_datum_t)getpid();
    // no new code: libraries were loaded before
    int status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(mmap), 1,
                                  SCMP_A2(SCMP_CMP_MASKED_EQ, PROT_EXEC, 0));
    if (!status)
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(mprotect), 1,
                                  SCMP_A2(SCMP_CMP_MASKED_EQ, PROT_EXEC, 0));
    if (!status) // abort()
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(tgkill), 1,
                                  SCMP_A0(SCMP_CMP_EQ, self));
    if (!status) // its own limits may be read
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(prlimit64), 1,
                                  SCMP_A2(SCMP_CMP_EQ, 0));
    if (!status)
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(fcntl), 1,
                                  SCMP_A1(SCMP_CMP_EQ, F_GETFL));
    return status;
}

// Threads, not processes.
static int allow_threads(scmp_filter_ctx filter)
{
    const scmp_datum_t thread = CLONE_THREAD | CLONE_VM | CLONE_SIGHAND;
    return seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(clone), 1,
                            SCMP_A0(SCMP_CMP_MASKED_EQ, thread, thread));
}

int prt_sandbox_filter(bool may_open, bool may_thread)
{
    scmp_filter_ctx filter = seccomp_init(SCMP_ACT_ERRNO(EPERM));
    if (!filter) return -ENOSYS;
    int status = seccomp_attr_set(filter, SCMP_FLTATR_ACT_BADARCH, SCMP_ACT_KILL_PROCESS);
    if (!status) status = allow_all(filter, allowed, sizeof allowed / sizeof *allowed);
    if (!status && (may_open || SANITIZED)) status = allow_open(filter);
    else if (!status) // libc's fstat: a descriptor without a name
        status = seccomp_rule_add(filter, SCMP_ACT_ALLOW, SCMP_SYS(newfstatat), 1,
                                  SCMP_A3(SCMP_CMP_EQ, AT_EMPTY_PATH));
    if (!status && !SANITIZED) status = allow_plain(filter);
    if (!status && SANITIZED)
        status = allow_all(filter, allowed_sanitized,
                           sizeof allowed_sanitized / sizeof *allowed_sanitized);
    if (!status && (may_thread || SANITIZED)) status = allow_threads(filter);
    // Its flags lie in memory, where a filter cannot look: libc falls back to clone.
    if (!status) status = seccomp_rule_add(filter, SCMP_ACT_ERRNO(ENOSYS), SCMP_SYS(clone3), 0);
    if (!status) status = seccomp_load(filter);
    seccomp_release(filter);
    return status;
}
#else
int prt_sandbox_filter(bool may_open, bool may_thread)
{
    return -ENOSYS;
}
#endif
