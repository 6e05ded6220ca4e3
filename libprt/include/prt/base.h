/* SPDX-License-Identifier: MIT */
/* prt/base.h owns what every room stands on: status codes, the context, memory, threads. */
#ifndef PRT_BASE_H
#define PRT_BASE_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* name, code, text. Functions return 0 or one of the negative codes. */
#define PRT_STATUS_LIST(X)                                        \
    X(OK, 0, "done")                                              \
    X(ARG, -1, "argument out of range")                           \
    X(NOMEM, -2, "not enough memory")                             \
    X(IO, -3, "file could not be read or written")                \
    X(FORMAT, -4, "file is damaged or not of a supported format") \
    X(LIMIT, -5, "a limit was exceeded")                          \
    X(CANCELLED, -6, "cancelled")                                 \
    X(UNSUPPORTED, -7, "not supported")                           \
    X(INTERNAL, -8, "internal error")                             \
    X(MISMATCH, -9, "inputs do not belong together")

enum prt_status {
#define X(name, code, text) PRT_##name = (code),
    PRT_STATUS_LIST(X)
#undef X
};

/* One line of English for a status code. Never NULL. Thread-safe. */
const char *prt_status_text(int status);

/* Instruction sets that a kernel may use, as bits of a mask; each x86 bit implies those above
 * it. Pass prt_cpu_detect() or a subset of it. */
enum prt_cpu {
    PRT_CPU_C = 0,
    PRT_CPU_AVX2 = 1 << 0,       /* AVX2, FMA, F16C */
    PRT_CPU_AVX512 = 1 << 1,     /* AVX-512 F, BW, DQ, VL */
    PRT_CPU_AVX512VNNI = 1 << 2, /* AVX-512 VNNI */
    PRT_CPU_NEON = 1 << 3,       /* arm64's NEON, part of every arm64 */
};
/* The words of --cpu: word, the bit it stands for, everything that it allows. */
#define PRT_CPU_WORD_LIST(X)                                                        \
    X("c", PRT_CPU_C, PRT_CPU_C)                                                    \
    X("avx2", PRT_CPU_AVX2, PRT_CPU_AVX2)                                           \
    X("avx512", PRT_CPU_AVX512, PRT_CPU_AVX2 | PRT_CPU_AVX512 | PRT_CPU_AVX512VNNI) \
    X("neon", PRT_CPU_NEON, PRT_CPU_NEON)
#define PRT_CPU_WORDS "c, avx2, avx512, neon" /* the same, for messages */

/* The mask of what this machine has. Thread-safe. */
unsigned prt_cpu_detect(void);
/* A word of PRT_CPU_WORD_LIST to what it allows of this machine's instruction sets, which may
 * be none but C. PRT_ARG for another word; *mask is untouched then. Thread-safe. */
int prt_cpu_parse(const char *word, unsigned *mask);
/* The word for the best instruction set in the mask: "c" for none. Never NULL. Thread-safe. */
const char *prt_cpu_word(unsigned mask);

enum prt_log_level { PRT_LOG_ERROR, PRT_LOG_WARNING, PRT_LOG_NOTE };
typedef void (*prt_log_fn)(void *user, enum prt_log_level level, const char *line);

/* fraction in [0,1] of the named stage; eta_s < 0 when unknown. Non-zero return cancels. */
typedef int (*prt_progress_fn)(void *user, const char *stage, double fraction, double eta_s);

struct prt_pool;

/* What a call works with. A plain struct: fill it with prt_context_init and change fields.
 * It may be shared by threads as long as its callbacks may. */
struct prt_context {
    prt_log_fn log; /* NULL: errors and warnings to stderr */
    void *log_user;
    prt_progress_fn progress; /* NULL: none */
    void *progress_user;
    struct prt_pool *pool; /* NULL: everything on the calling thread */
    unsigned cpu;          /* enum prt_cpu mask */
    uint64_t memory_limit; /* bytes one call may allocate for a file's content; 0: 8 GiB */
    uint64_t image_limit;  /* bytes of one image's pixels as floats; 0: memory_limit */
};
void prt_context_init(struct prt_context *ctx);

/* Logs one line (no newline at the end). ctx may be NULL. */
void prt_log(const struct prt_context *ctx, enum prt_log_level level, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* Logs an error line and returns `status`, so that `return prt_fail(...)` reads well. */
int prt_fail(const struct prt_context *ctx, int status, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* Reports progress; PRT_CANCELLED when the callback asks to stop, else 0. */
int prt_progress(const struct prt_context *ctx, const char *stage, double fraction);

/* 64-byte aligned memory. n*size overflow and 0 bytes give NULL. Free with prt_free. */
void *prt_alloc(size_t n, size_t size);
void *prt_calloc(size_t n, size_t size);
void prt_free(void *p);
/* true when a*b (or a+b) does not fit size_t; *out gets the result otherwise */
static inline bool prt_mul_overflow(size_t a, size_t b, size_t *out)
{
    return __builtin_mul_overflow(a, b, out);
}

/* A pool of threads. n_thread counts the caller too; 0 takes the machine's cores.
 * Thread-safe: several callers may run loops at once, they share the workers. */
int prt_pool_create(unsigned n_thread, struct prt_pool **out);
void prt_pool_destroy(struct prt_pool *pool);
unsigned prt_pool_size(const struct prt_pool *pool); /* 1 for NULL */

/* Calls fn(arg, begin, end, worker) over [0,n) cut into pieces of `grain` (the last may be
 * shorter): the cut does not depend on the thread count, so results need not either.
 * worker < prt_pool_size is unique among pieces running at once. Blocks until done. A non-zero
 * return of fn stops the loop early and is returned (the first one seen). Progress, when stage
 * is not NULL, is reported from the calling thread. */
typedef int (*prt_loop_fn)(void *arg, size_t begin, size_t end, unsigned worker);
int prt_parallel_for(const struct prt_context *ctx, const char *stage, size_t n, size_t grain,
                     prt_loop_fn fn, void *arg);

double prt_time_s(void);                                         /* monotonic seconds */
uint64_t prt_hash64(const void *bytes, size_t n, uint64_t seed); /* XXH3 */

/* PCG32: small, seekable by (seed, stream), the same everywhere. */
struct prt_rng {
    uint64_t state, inc;
};
void prt_rng_init(struct prt_rng *rng, uint64_t seed, uint64_t stream);
uint32_t prt_rng_u32(struct prt_rng *rng);
float prt_rng_f32(struct prt_rng *rng); /* [0,1) */

/* Runs fn(arg, result) in a forked child under limits and hands back what it left in `result`:
 * for decoding untrusted bytes (DESIGN: parsed only in a child process). The child may make
 * only the system calls that decoding needs: no sockets, programs, processes, threads or new
 * code, and it opens no file but for reading beneath `folder`. A crash or exceeded limit is
 * PRT_FORMAT / PRT_LIMIT with a log line naming `what`; its log lines are forwarded. In the
 * child the context has no pool and no progress, stdin to stderr lead nowhere and every other
 * file the parent had open is closed but `input_fd`. PRT_UNSUPPORTED where the system cannot
 * confine it (no seccomp), unless the environment variable PRT_ACCEPT_WEAK_SANDBOX is 1.
 * Thread-safe; blocks. Call it before threads hold locks fn needs. */
#define PRT_ACCEPT_WEAK_SANDBOX "PRT_ACCEPT_WEAK_SANDBOX"
enum { PRT_ISOLATE_INPUT_FD = 4 };
struct prt_isolate_limits {
    uint64_t memory_bytes;      /* address space beyond what the parent has; 0: 4 GiB */
    double seconds;             /* CPU and wall; 0: 60 */
    const char *folder;         /* files beneath it may be read; NULL: no file can be opened */
    bool threads;               /* fn may start threads */
    int input_fd;               /* the child finds it at PRT_ISOLATE_INPUT_FD; 0: none */
    void (*prepare)(void *arg); /* in the child before it is confined, e.g. to load a library;
                                   must not touch untrusted bytes; may be NULL */
};
struct prt_blob {
    void *bytes;
    size_t size;
};
/* fn returns a status and may fill out->bytes (prt_alloc) and out->size. */
typedef int (*prt_isolate_fn)(const struct prt_context *ctx, void *arg, struct prt_blob *out);
int prt_isolate(const struct prt_context *ctx, const char *what,
                const struct prt_isolate_limits *limits, prt_isolate_fn fn, void *arg,
                struct prt_blob *out);

/* Isolated children of this process that a signal other than their limits' ended. */
unsigned prt_isolate_crashes(void);

/* Whole file into memory; PRT_LIMIT above max_bytes. Caller prt_free()s out->bytes. */
int prt_read_file(const struct prt_context *ctx, const char *path, uint64_t max_bytes,
                  struct prt_blob *out);
/* The same of an open file from its beginning; errors call it `name`. fd stays open. */
int prt_read_fd(const struct prt_context *ctx, const char *name, int fd, uint64_t max_bytes,
                struct prt_blob *out);
/* Writes to PATH.tmp-PID, fsync, rename, fsync of the folder: nothing half-written. */
int prt_write_file(const struct prt_context *ctx, const char *path, const void *bytes,
                   size_t n);
/* The same piece by piece, for files too large to build in memory. After a failed write only
 * prt_writer_abandon (removes the temporary file) is left; finish fsyncs, renames and frees. */
struct prt_writer;
int prt_writer_open(const struct prt_context *ctx, const char *path, struct prt_writer **out);
int prt_writer_write(struct prt_writer *writer, const void *bytes, size_t n);
int prt_writer_finish(struct prt_writer *writer);
void prt_writer_abandon(struct prt_writer *writer);

#ifdef __cplusplus
}
#endif
#endif
