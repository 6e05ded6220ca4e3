/* SPDX-License-Identifier: MIT */
/* prt/base.h owns what every room uses: status codes, the context with its log and progress,
 * memory, threads, random numbers, files and the isolated child process.
 *
 * Functions with a context log one line for an error and return a status; *out is set last, on
 * success only. ctx may be NULL where it is said. Functions do not block unless it is said. */
#ifndef PRT_BASE_H
#define PRT_BASE_H

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* name, code, text. Functions return PRT_OK or one of the negative codes. */
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
/* line: without newline and control characters, valid during the call. Any thread may call it.
 */
typedef void (*prt_log_fn)(void *user, enum prt_log_level level, const char *line);

/* fraction: of the named stage, [0,1]. eta_s: seconds left, negative when unknown. A return
 * other than 0 cancels. Called on the thread that made the call. */
typedef int (*prt_progress_fn)(void *user, const char *stage, double fraction, double eta_s);

struct prt_pool;

/* The resources and callbacks of a call. Initialise it with prt_context_init, then set fields.
 * It borrows everything it points to. Threads may share it if its callbacks are thread-safe. */
struct prt_context {
    prt_log_fn log; /* NULL: errors and warnings to stderr */
    void *log_user;
    prt_progress_fn progress; /* NULL: none */
    void *progress_user;
    struct prt_pool *pool; /* NULL: all work on the calling thread */
    uint64_t *helpers_ns;  /* CPU time of the pool's threads that help the caller's loops is
                            * added, atomically [ns]; NULL: it is not measured */
    unsigned cpu;          /* mask of enum prt_cpu */
    uint64_t memory_limit; /* bytes one call may allocate for a file's content; 0: 8 GiB */
    uint64_t image_limit;  /* bytes of one image's pixels as floats; 0: memory_limit */
};
/* Empty, with cpu = prt_cpu_detect(). */
void prt_context_init(struct prt_context *ctx);

/* Logs one line; fmt has no newline. ctx may be NULL: errors and warnings go to stderr.
 * Thread-safe if the callback is. */
void prt_log(const struct prt_context *ctx, enum prt_log_level level, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* A prt_log_fn that drops every line: for calls whose failure is no fault. */
void prt_log_none(void *user, enum prt_log_level level, const char *line);
/* Logs an error line and returns `status`, so that `return prt_fail(...)` reads well. */
int prt_fail(const struct prt_context *ctx, int status, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
/* Reports progress: PRT_CANCELLED when the callback returns other than 0. ctx may be NULL. */
int prt_progress(const struct prt_context *ctx, const char *stage, double fraction);

/* n*size bytes, aligned to 64 (from 4 MiB on to huge pages). NULL when memory is short, when
 * n*size overflows, or for 0 bytes. The caller frees them with prt_free. Thread-safe.
 * prt_calloc: zeroed. */
void *prt_alloc(size_t n, size_t size);
void *prt_calloc(size_t n, size_t size);
void prt_free(void *p);
/* True when a*b does not fit size_t; otherwise *out is the product. */
static inline bool prt_mul_overflow(size_t a, size_t b, size_t *out)
{
    return __builtin_mul_overflow(a, b, out);
}

/* A pool of threads for prt_parallel_for. n_thread counts the calling thread; 0: as many as the
 * machine has cores. Fewer are started where the system refuses more. PRT_NOMEM. Several
 * threads may run loops at once; they share the workers. Destroy it when no loop runs; this
 * blocks until the threads end. */
int prt_pool_create(unsigned n_thread, struct prt_pool **out);
void prt_pool_destroy(struct prt_pool *pool);
unsigned prt_pool_size(const struct prt_pool *pool); /* threads with the caller; 1 for NULL */

/* Calls fn(arg, begin, end, worker) for the pieces of `grain` items that make up [0,n); the
 * last may be shorter. Pieces do not depend on the number of threads, so results need not
 * either. worker is below prt_pool_size and unique among pieces that run at once. Blocks until
 * all pieces are done. The first status other than 0 that fn returns stops the loop and is
 * returned. With stage, progress is reported on the calling thread at most ten times a second,
 * and PRT_CANCELLED is possible. ctx may be NULL. Thread-safe. */
typedef int (*prt_loop_fn)(void *arg, size_t begin, size_t end, unsigned worker);
int prt_parallel_for(const struct prt_context *ctx, const char *stage, size_t n, size_t grain,
                     prt_loop_fn fn, void *arg);

double prt_time_s(void);                                         /* monotonic seconds */
uint64_t prt_hash64(const void *bytes, size_t n, uint64_t seed); /* XXH3 */

/* PCG32 (O'Neill 2014): the same numbers on every machine; streams of one seed are independent.
 * Each generator belongs to one thread. */
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
#define PRT_ISOLATE_WALL \
    6 /* a good file is read where others take most of the processor, too */
struct prt_isolate_limits {
    uint64_t memory_bytes; /* address space beyond what the parent has; 0: 4 GiB */
    double seconds;        /* of CPU time, and PRT_ISOLATE_WALL times as many in all; 0: 60 */
    const char *folder;    /* files beneath it may be read; NULL: no file can be opened */
    bool threads;          /* fn may start threads */
    int input_fd;          /* the child finds it at PRT_ISOLATE_INPUT_FD; 0: none */
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

/* How many isolated children of this process ended by a signal other than those of their
 * limits. Thread-safe. */
unsigned prt_isolate_crashes(void);

/* A regular file's bytes, with a 0 byte after them that size does not count. The caller frees
 * out->bytes with prt_free. Blocks. PRT_LIMIT: more than max_bytes; PRT_FORMAT: empty; PRT_IO.
 */
int prt_read_file(const struct prt_context *ctx, const char *path, uint64_t max_bytes,
                  struct prt_blob *out);
/* The same for an open file, from its beginning. name opens the error line; fd stays open. */
int prt_read_fd(const struct prt_context *ctx, const char *name, int fd, uint64_t max_bytes,
                struct prt_blob *out);
/* Writes a file whole or not at all: to PATH.tmp-PID, then fsync, rename, fsync of the folder.
 * Devices and pipes are written in place. Blocks. PRT_IO: the file is as it was, no temporary
 * file stays. */
int prt_write_file(const struct prt_context *ctx, const char *path, const void *bytes,
                   size_t n);
/* The same piece by piece, for files too large for memory. A writer belongs to one thread and
 * ends with prt_writer_finish, which renames the file, or with prt_writer_abandon, which
 * removes the temporary file; both free the writer, whatever they return. After a failed write
 * the writer can only be abandoned. */
struct prt_writer;
int prt_writer_open(const struct prt_context *ctx, const char *path, struct prt_writer **out);
int prt_writer_write(struct prt_writer *writer, const void *bytes, size_t n);
int prt_writer_finish(struct prt_writer *writer);
void prt_writer_abandon(struct prt_writer *writer);

/* The name that `text` stands for among name[n]: the equal one, one equal but for the case of
 * ASCII letters, or the only one that begins with it. Returns its index, or -1 with a remedy in
 * say: "it begins several names: …", "did you mean NAME?", or "". Thread-safe. */
int prt_name_choose(const char *text, const char *const name[], unsigned n, char *say,
                    size_t size);
/* Index of the name with the fewest single-character changes from `text` (Levenshtein), -1
 * where none has at most a third of text's length and one. */
int prt_name_nearest(const char *text, const char *const name[], unsigned n);

#ifdef __cplusplus
}
#endif
#endif
