// SPDX-License-Identifier: MIT
// prt-bench: every performance figure, one JSON object a line.
#include <argp.h>
#include <malloc.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"

static struct bench *benches;

void bench_register(struct bench *bench)
{
    struct bench **at = &benches;
    while (*at && strcmp((*at)->name, bench->name) < 0) at = &(*at)->next;
    bench->next = *at;
    *at = bench;
}

struct options {
    struct bench_env env;
    const char *cpu;
    bool list;
    const char *names[64];
    unsigned n_name;
};

enum {
    KEY_LIST = 256,
    KEY_FILE,
    KEY_MODEL,
    KEY_ENV,
    KEY_CPU,
    KEY_SECONDS,
    KEY_QUICK,
    KEY_SEED
};

static const struct argp_option option_table[] = {
    {"list", KEY_LIST, 0, 0, "List the benchmarks and stop", 0},
    {"file", KEY_FILE, "X.prt", 0, "Measure this transport instead of made-up ones", 0},
    {"model", KEY_MODEL, "FILE", 0, "Measure bakes and images of this model", 0},
    {"env", KEY_ENV, "FILE", 0, "Under this light too (up to 8 times); default: a made-up one",
     0},
    {"threads", 't', "N", 0, "Threads (default: the machine's cores)", 0},
    {"cpu", KEY_CPU, "ISA", 0, "Use at most these instructions: " PRT_CPU_WORDS, 0},
    {"seconds", KEY_SECONDS, "S", 0, "Time spent on each figure (default 0.5)", 0},
    {"quick", KEY_QUICK, 0, 0, "Small sizes, 0.02 s a figure: does it run?", 0},
    {"seed", KEY_SEED, "N", 0, "Of made-up data (default 1)", 0},
    {0}};

static error_t parse(int key, char *arg, struct argp_state *state)
{
    struct options *o = state->input;
    char *end = NULL;
    double number = arg ? strtod(arg, &end) : 0;
    bool numeric = arg && *arg && !*end && number >= 0 && number <= 1e9;
    switch (key) {
    case KEY_LIST:
        o->list = true;
        break;
    case KEY_FILE:
        o->env.file = arg;
        break;
    case KEY_MODEL:
        o->env.mesh = arg;
        break;
    case KEY_ENV:
        if (o->env.n_light == 8) argp_error(state, "--env: at most 8");
        o->env.light[o->env.n_light++] = arg;
        break;
    case KEY_CPU:
        o->cpu = arg;
        break;
    case KEY_QUICK:
        o->env.quick = true;
        break;
    case 't':
        if (!numeric || number > 1024) argp_error(state, "--threads takes 0 to 1024");
        o->env.threads = (unsigned)number;
        break;
    case KEY_SECONDS:
        if (!numeric || number > 3600) argp_error(state, "--seconds takes 0 to 3600");
        o->env.seconds = number;
        break;
    case KEY_SEED:
        if (!numeric) argp_error(state, "--seed takes a number");
        o->env.seed = (uint64_t)number;
        break;
    case ARGP_KEY_ARG:
        if (o->n_name == 64) argp_error(state, "too many names");
        o->names[o->n_name++] = arg;
        break;
    default:
        return ARGP_ERR_UNKNOWN;
    }
    return 0;
}

// A name stands for itself and for all that begin with it and an underscore.
static bool named(const char *name, const struct bench *b)
{
    size_t n = strlen(name);
    return !strncmp(name, b->name, n) && (!b->name[n] || b->name[n] == '_');
}

static bool wanted(const struct options *o, const struct bench *b)
{
    for (unsigned i = 0; i < o->n_name; i++)
        if (named(o->names[i], b)) return true;
    return !o->n_name;
}

static int check_names(const struct options *o)
{
    for (unsigned i = 0; i < o->n_name; i++) {
        bool found = false;
        for (struct bench *b = benches; b; b = b->next) found |= named(o->names[i], b);
        if (!found) {
            fprintf(stderr, "prt-bench: no benchmark is called %s (see --list)\n", o->names[i]);
            return 2;
        }
    }
    return 0;
}

int main(int argc, char **argv)
{
    static const char doc[] =
        "Measures what this machine does: one JSON object a line on standard output.\v"
        "Examples:\n"
        "  prt-bench --list\n"
        "  prt-bench relight_factored relight_sparse\n"
        "  prt-bench --file bunny.prt relight_file cold_start\n"
        "  prt-bench --model bunny.glb --env studio.exr --env grace.exr bake_single\n"
        "  prt-bench --file bunny.prt serve        every figure that begins with serve_\n"
        "  prt-bench --cpu avx2 --threads 1 --seconds 2 relight_sparse\n";
    const struct argp argp = {option_table, parse, "[NAME...]", doc, 0, 0, 0};
    struct options o = {.env = {.seconds = 0.5, .seed = 1}};
    argp_err_exit_status = 2;
    argp_parse(&argp, argc, argv, 0, NULL, &o);
    if (o.list) {
        for (struct bench *b = benches; b; b = b->next) printf("%-20s %s\n", b->name, b->help);
        return 0;
    }
    if (check_names(&o)) return 2;
    // as relightd: pages of a call serve the next
    mallopt(M_MMAP_THRESHOLD, 32 << 20);
    mallopt(M_TRIM_THRESHOLD, 256 << 20);
    prt_context_init(&o.env.ctx);
    if (o.cpu && prt_cpu_parse(o.cpu, &o.env.ctx.cpu)) {
        fprintf(stderr, "prt-bench: --cpu %s is none of %s\n", o.cpu, PRT_CPU_WORDS);
        return 2;
    }
    o.env.cpu_name = prt_cpu_word(o.env.ctx.cpu);
    if (o.env.quick) o.env.seconds = 0.02;
    if (prt_pool_create(o.env.threads, &o.env.ctx.pool)) return 1;
    o.env.threads = prt_pool_size(o.env.ctx.pool);
    int status = 0;
    for (struct bench *b = benches; b; b = b->next)
        if (wanted(&o, b) && b->run(&o.env)) {
            fprintf(stderr, "prt-bench: %s failed\n", b->name);
            status = 1;
        }
    prt_pool_destroy(o.env.ctx.pool);
    return status;
}
