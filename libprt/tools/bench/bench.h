// SPDX-License-Identifier: MIT
// Interface of the benchmarks of prt-bench. A benchmark is a file of this folder:
//
//     static int run(struct bench_env *env) { ...; bench_begin(env, "x"); ...; bench_end(); }
//     BENCH(x, "description", run)
//
// It prints one JSON object a line for each figure and returns 0 or a negative prt_status.
#ifndef PRT_BENCH_H
#define PRT_BENCH_H

#include "prt/light.h"
#include "prt/transport.h"

struct bench_env {
    struct prt_context ctx; // its pool has `threads` threads
    const char *cpu_name;   // kernels in use
    unsigned threads;
    const char *file;     // --file, or NULL
    const char *mesh;     // --model, or NULL
    const char *light[8]; // --env, n_light of them
    unsigned n_light;
    double seconds; // each figure is measured for about this long
    bool quick;     // small sizes, as a check that it runs
    uint64_t seed;
};

struct bench {
    const char *name, *help;
    int (*run)(struct bench_env *env);
    struct bench *next;
};
void bench_register(struct bench *bench);

#define BENCH(id, text, function)                                      \
    static struct bench bench_##id = {#id, text, function, NULL};      \
    __attribute__((constructor)) static void bench_register_##id(void) \
    {                                                                  \
        bench_register(&bench_##id);                                   \
    }

// One JSON object a line: {"bench":figure,"cpu":…,"threads":…,keys…}
void bench_begin(const struct bench_env *env, const char *figure);
void bench_number(const char *key, double value); // 6 significant digits; null if not finite
void bench_text(const char *key, const char *value);
void bench_end(void);

// Seconds of one call of fn, measured over about env->seconds after one call to warm up.
struct bench_time {
    double best, median, mean;
    unsigned n;
};
typedef int (*bench_fn)(void *arg);
int bench_measure(const struct bench_env *env, bench_fn fn, void *arg, struct bench_time *out);
// The same of two things, some calls of each by turns: for their ratio where a machine's speed
// drifts.
int bench_compare(const struct bench_env *env, bench_fn fn, void *const arg[2],
                  struct bench_time out[2]);

// Bytes/s of a plain sum over the given pieces of memory, with all threads. Best of the time.
struct bench_span {
    const void *bytes;
    size_t n;
};
double bench_read_bandwidth(struct bench_env *env, const struct bench_span *span, unsigned n);
// Reads them once; returns the bytes.
double bench_read(struct bench_env *env, const struct bench_span *span, unsigned n);
enum { BENCH_SPANS = 10 };
// The arrays of a tensor that a relight reads; returns how many.
unsigned bench_tensor_spans(const struct prt_tensor *tensor,
                            struct bench_span span[BENCH_SPANS]);

// A cubemap with a sky, a floor and a small sun, similar to a decoded environment.
int bench_cube(uint32_t n, uint64_t seed, struct prt_cube *out);

#endif
