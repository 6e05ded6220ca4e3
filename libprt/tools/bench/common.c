// SPDX-License-Identifier: MIT
// JSON lines, timing, and the machine's read bandwidth.
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

#include <cjson/cJSON.h>

static cJSON *line; // between bench_begin and bench_end

void bench_begin(const struct bench_env *env, const char *figure)
{
    line = cJSON_CreateObject();
    bench_text("bench", figure);
    bench_text("cpu", env->cpu_name);
    cJSON_AddNumberToObject(line, "threads", env->threads);
}

void bench_number(const char *key, double value)
{
    char text[32];
    snprintf(text, sizeof text, "%.6g", value);
    if (isfinite(value)) cJSON_AddRawToObject(line, key, text);
    else cJSON_AddNullToObject(line, key);
}

void bench_text(const char *key, const char *value)
{
    cJSON_AddStringToObject(line, key, value);
}

void bench_end(void)
{
    char *text = cJSON_PrintUnformatted(line);
    if (text) puts(text);
    fflush(stdout);
    free(text);
    cJSON_Delete(line);
    line = NULL;
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

enum { MOST_CALLS = 1000, TURN = 8 };

struct calls {
    double time[MOST_CALLS];
    unsigned n;
};

static int call_some(bench_fn fn, void *arg, unsigned n, struct calls *calls)
{
    for (; n && calls->n < MOST_CALLS; n--) {
        const double start = prt_time_s();
        const int status = fn(arg);
        if (status) return status;
        calls->time[calls->n++] = prt_time_s() - start;
    }
    return PRT_OK;
}

static struct bench_time time_of(struct calls *calls)
{
    double sum = 0;
    for (unsigned i = 0; i < calls->n; i++) sum += calls->time[i];
    qsort(calls->time, calls->n, sizeof *calls->time, ascending);
    return (struct bench_time){.best = calls->time[0],
                               .median = calls->time[calls->n / 2],
                               .mean = sum / calls->n,
                               .n = calls->n};
}

int bench_measure(const struct bench_env *env, bench_fn fn, void *arg, struct bench_time *out)
{
    struct calls calls = {.n = 0};
    const double start = prt_time_s();
    int status = fn(arg);
    do {
        if (!status) status = call_some(fn, arg, 1, &calls);
    } while (!status && calls.n < MOST_CALLS && prt_time_s() - start < env->seconds);
    if (!status) *out = time_of(&calls);
    return status;
}

int bench_compare(const struct bench_env *env, bench_fn fn, void *const arg[2],
                  struct bench_time out[2])
{
    struct calls calls[2] = {{.n = 0}, {.n = 0}};
    const double start = prt_time_s();
    int status = PRT_OK;
    do {
        for (int i = 0; i < 2 && !status; i++) {
            status = fn(arg[i]); // the first of a turn finds the other's bytes in the caches
            if (!status) status = call_some(fn, arg[i], TURN, &calls[i]);
        }
    } while (!status && calls[0].n < MOST_CALLS && prt_time_s() - start < 2 * env->seconds);
    for (int i = 0; i < 2 && !status; i++) out[i] = time_of(&calls[i]);
    return status;
}

struct reading {
    struct bench_env *env;
    const struct bench_span *span;
    const uint64_t *words;
    uint64_t sum[64];
};

static int sum_words(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct reading *r = arg;
    uint64_t sum[8] = {0};
    size_t i = begin;
    for (; i + 8 <= end; i += 8)
        for (int k = 0; k < 8; k++) sum[k] += r->words[i + (size_t)k];
    for (int k = 0; k < 8; k++) r->sum[worker % 64] += sum[k];
    return PRT_OK;
}

double bench_read(struct bench_env *env, const struct bench_span *span, unsigned n)
{
    struct reading r = {.env = env};
    double bytes = 0;
    for (unsigned i = 0; i < n; i++) {
        r.words = span[i].bytes;
        prt_parallel_for(&env->ctx, NULL, span[i].n / 8, 1 << 17, sum_words, &r);
        bytes += (double)(span[i].n / 8 * 8);
    }
    volatile uint64_t kept = r.sum[0];
    (void)kept;
    return bytes;
}

double bench_read_bandwidth(struct bench_env *env, const struct bench_span *span, unsigned n)
{
    double best = 1e9, bytes, start = prt_time_s();
    do {
        double t = prt_time_s();
        bytes = bench_read(env, span, n);
        best = fmin(best, prt_time_s() - t);
    } while (prt_time_s() - start < env->seconds);
    return bytes / best;
}

unsigned bench_tensor_spans(const struct prt_tensor *t, struct bench_span span[BENCH_SPANS])
{
    const struct prt_rows *r = &t->rows;
    uint64_t n_entry = r->n_row ? r->begin[r->n_row] : 0, j = t->n_function;
    const uint64_t n = r->direction ? r->direction[r->n_row] : 0;
    const struct bench_span all[] = {{t->u, 2 * t->u_count},
                                     {t->order, 4ull * t->n_vertex},
                                     {r->begin, r->n_row ? 8 * (r->n_row + 1ull) : 0},
                                     {r->index, n_entry * r->index_bytes},
                                     {r->entry, r->direction ? r->value_begin[r->n_row]
                                                : r->value == PRT_VALUE_I8 ? n_entry * j
                                                                           : 2 * n_entry * j},
                                     {r->scale, r->direction ? 4 * n
                                                : r->scale   ? 4 * j * r->n_row
                                                             : 0},
                                     {r->shift, r->direction ? n_entry : 0},
                                     {r->mix, 2 * n * j},
                                     {r->scaling, 12 * j * r->n_row}};
    unsigned used = 0;
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (all[i].n) span[used++] = all[i];
    return used;
}

int bench_cube(uint32_t n, uint64_t seed, struct prt_cube *out)
{
    struct prt_rng rng;
    int status = prt_cube_init(out, n);
    if (status) return status;
    prt_rng_init(&rng, seed, 5);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        float level = i / (n * n) == 3 ? 0.1f : 1;
        for (int ch = 0; ch < 3; ch++)
            out->texel[3 * i + (uint32_t)ch] = level * (0.5f + prt_rng_f32(&rng));
    }
    uint32_t sun = prt_rng_u32(&rng) % (6 * n * n);
    for (int ch = 0; ch < 3; ch++) out->texel[3 * sun + (uint32_t)ch] = 1000;
    return PRT_OK;
}
