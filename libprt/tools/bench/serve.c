// SPDX-License-Identifier: MIT
// relightd under many clients, on loopback: small requests, idle connections, clients with
// different lights, with the same light, and with pictures.
#include "serve_flow.h"

#include "prt/relight.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

enum { N_CLIENT = 16, N_PICTURE_CLIENT = 8, N_IDLE = 1000, N_ACTIVE = 200 };

struct served {
    struct bench_env *env;
    struct bench_daemon daemon;
    char light[80];
};

static int with_daemon(struct bench_env *env, const char *const extra[], unsigned n_model,
                       int (*measure)(struct served *s))
{
    struct served s = {.env = env};
    int status = bench_daemon_start_with(env, extra, n_model, &s.daemon);
    if (status) return status;
    status = serve_upload_env(env, &s.daemon, s.light);
    if (!status) status = measure(&s);
    bench_daemon_stop(&s.daemon);
    return status;
}

static struct serve_flow new_flow(const struct served *s,
                                  void (*send)(struct serve_flow *, struct serve_client *),
                                  unsigned depth)
{
    return (struct serve_flow){.send = send,
                               .depth = depth,
                               .model = s->daemon.model,
                               .env = s->light,
                               .step_deg = 0.731f};
}

static double figure_s(const struct served *s, double least)
{
    return s->env->quick ? 0.1 : fmax(s->env->seconds, least);
}

// ---- small requests

static int small(struct served *s)
{
    struct serve_crowd crowd;
    int status = PRT_OK;
    for (int carrier = 1; carrier >= 0 && !status; carrier--) {
        struct serve_flow f = new_flow(s, serve_send_ping, SERVE_DEPTH / 2);
        status = serve_open(s->env, s->daemon.address[carrier], NULL, N_CLIENT, serve_count, &f,
                            &crowd);
        double cpu_s = bench_daemon_cpu_s(&s->daemon), seconds = figure_s(s, 2);
        if (!status) status = serve_run(&crowd, &f, 0, seconds);
        cpu_s = bench_daemon_cpu_s(&s->daemon) - cpu_s;
        serve_close(&crowd);
        if (!status) {
            bench_begin(s->env, "serve_small_requests");
            bench_text("carrier", carrier ? "tcp" : "unix");
            bench_number("clients", N_CLIENT);
            bench_number("pipelined", f.depth);
            bench_number("ms_median", serve_quantile(&f, 0.5));
            bench_number("ms_p99", serve_quantile(&f, 0.99));
            bench_number("daemon_cpu_us", cpu_s * 1e6 / f.n_answer);
            serve_goal_least("requests_per_s", serve_rate(&f), 60000);
            bench_end();
        }
        serve_flow_finish(&f);
    }
    return status;
}

static int run_small(struct bench_env *env)
{
    return with_daemon(env, NULL, 0, small);
}

// ---- idle connections

// INFO of a model with a name of 900 kB: its header is the large one. The answer is an error.
static int send_large_header(struct serve_crowd *crowd)
{
    enum { NAME = 900000 };
    char *name = malloc(NAME + 1);
    int status = name ? PRT_OK : PRT_NOMEM;
    Relight__InfoRequest r = RELIGHT__INFO_REQUEST__INIT;
    if (name) memset(name, 'x', NAME);
    if (name) name[NAME] = 0;
    r.model = name;
    for (unsigned i = 0; i < crowd->n && !status; i++) {
        struct serve_client *c = &crowd->client[i];
        serve_send(c, RELIGHT_TYPE_INFO, &r.base, NULL, 0, 0);
        status = serve_settle(crowd, 30);
        free(c->out);
        c->out = NULL;
        c->out_size = c->out_sent = c->out_room = 0;
    }
    free(name);
    return status;
}

static int idle(struct served *s)
{
    struct serve_crowd sleeping = {.epoll_fd = -1}, active = {.epoll_fd = -1};
    struct serve_flow f = new_flow(s, serve_send_ping, 1), warm = f;
    unsigned n_idle = s->env->quick ? 50 : N_IDLE, n_active = s->env->quick ? 10 : N_ACTIVE;
    const char *tcp = s->daemon.address[1];
    // The pages that the allocator keeps for active clients are not part of an idle one.
    int status = serve_open(s->env, tcp, NULL, n_active, NULL, NULL, &active);
    if (!status) status = serve_run(&active, &warm, 0, figure_s(s, 1));
    if (!status) status = send_large_header(&active);
    double before = bench_daemon_rss_kib(&s->daemon);
    if (!status) status = serve_open(s->env, tcp, NULL, n_idle, NULL, NULL, &sleeping);
    if (!status) status = send_large_header(&sleeping);
    if (!status) status = serve_run(&active, &f, 0, figure_s(s, 2));
    double kib = (bench_daemon_rss_kib(&s->daemon) - before) / n_idle;
    if (!status && sleeping.n_gone)
        status = prt_fail(&s->env->ctx, PRT_IO, "the daemon closed idle connections");
    if (!status) {
        bench_begin(s->env, "serve_idle_connections");
        bench_number("idle", n_idle);
        bench_number("active", n_active);
        bench_number("active_requests_per_s", serve_rate(&f));
        bench_number("active_ms_p99", serve_quantile(&f, 0.99));
        bench_number("rss_mib", bench_daemon_rss_kib(&s->daemon) / 1024);
        serve_goal_most("kib_per_idle", kib, 16);
        bench_end();
    }
    serve_flow_finish(&f);
    serve_flow_finish(&warm);
    serve_close(&sleeping);
    serve_close(&active);
    return status;
}

static int run_idle(struct bench_env *env)
{
    static const char *const extra[] = {"--connections", "1400", NULL};
    struct rlimit files = {4096, 4096};
    setrlimit(RLIMIT_NOFILE, &files);
    return with_daemon(env, extra, 0, idle);
}

// With a small cache the steady state, in which evicted results give their memory to new ones,
// begins at once and not after some thousand frames.
static const char *const small_cache[] = {"--cache", "64M", NULL};

// ---- different lights, against the kernel alone

struct kernel {
    struct bench_env *env;
    struct prt_file *file;
    struct prt_cube cube[N_CLIENT];
    float *out[N_CLIENT];
};

static void kernel_finish(struct kernel *k)
{
    for (unsigned i = 0; i < N_CLIENT; i++) {
        prt_cube_finish(&k->cube[i]);
        prt_free(k->out[i]);
    }
    if (k->file) prt_file_close(k->file);
}

static int kernel_init(struct served *s, struct kernel *k)
{
    char path[128];
    *k = (struct kernel){.env = s->env};
    snprintf(path, sizeof path, "%s/models/%s.prt", s->daemon.folder, s->daemon.model);
    int status = prt_file_open(&s->env->ctx, path, PRT_FILE_CHECK_HEADERS, &k->file);
    if (!status) status = prt_file_columns(&s->env->ctx, k->file); // as the daemon soon has
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(k->file);
    for (unsigned i = 0; i < N_CLIENT && !status; i++) {
        status = bench_cube(t->cube, s->env->seed + i, &k->cube[i]);
        k->out[i] = prt_alloc(t->mesh.n_vertex, 12);
        if (!k->out[i]) status = PRT_NOMEM;
    }
    return status;
}

// All lights in one pass over the transport: colours in the order of the file.
static int kernel_pass(void *arg)
{
    struct kernel *k = arg;
    struct prt_query query[N_CLIENT];
    bool planes[N_CLIENT] = {false};
    for (unsigned i = 0; i < N_CLIENT; i++)
        query[i] = (struct prt_query){.term = PRT_ANSWER_TOTAL, .light = &k->cube[i]};
    return prt_answer_many(&k->env->ctx, prt_file_transport(k->file), N_CLIENT, query, planes,
                           k->out, NULL);
}

static double total(const struct served *s, const char *metric)
{
    double value = 0;
    serve_metric(s->env, &s->daemon, metric, &value);
    return value;
}

static double own_cpu_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + (double)t.tv_nsec * 1e-9;
}

// By turns, as the machine's speed drifts; the ratio is that of the medians. CPU times compare
// where other programs take the cores: a frame's is the daemon's and the clients'.
static int lights(struct served *s)
{
    enum { ROUNDS = 3 };
    struct serve_crowd crowd = {.epoll_fd = -1};
    struct serve_flow f[ROUNDS];
    struct kernel kernel;
    struct bench_time time;
    double kernel_rate[ROUNDS], rate[ROUNDS], cpu_s = 0, n = 0;
    double kernel_cpu_s = 0, n_kernel = 0, client_cpu_s = 0;
    int status = kernel_init(s, &kernel);
    for (int r = 0; r < ROUNDS; r++) f[r] = new_flow(s, serve_send_colors, 2);
    if (!status)
        status = serve_open(s->env, s->daemon.address[1], NULL, N_CLIENT, NULL, NULL, &crowd);
    double passes = total(s, "relightd_passes_total"),
           all = total(s, "relightd_relights_total");
    for (int r = 0; r < ROUNDS && !status; r++) {
        kernel_cpu_s -= own_cpu_s();
        status = bench_measure(s->env, kernel_pass, &kernel, &time);
        kernel_cpu_s += own_cpu_s();
        n_kernel += N_CLIENT * (time.n + 1.0); // one to warm up
        kernel_rate[r] = N_CLIENT / time.mean; // as the daemon's: of all its time
        double cpu = bench_daemon_cpu_s(&s->daemon);
        client_cpu_s -= own_cpu_s();
        if (!status) status = serve_run(&crowd, &f[r], 0, figure_s(s, 2));
        client_cpu_s += own_cpu_s();
        cpu_s += bench_daemon_cpu_s(&s->daemon) - cpu;
        rate[r] = serve_rate(&f[r]);
        n += f[r].n_answer;
    }
    passes = total(s, "relightd_passes_total") - passes;
    all = total(s, "relightd_relights_total") - all;
    if (!status) {
        int m = serve_median(ROUNDS, rate);
        bench_begin(s->env, "serve_lights_rgb9e5");
        bench_number("clients", N_CLIENT);
        bench_number("vertices", prt_file_transport(kernel.file)->mesh.n_vertex);
        bench_number("frames_per_s", rate[m]);
        bench_number("kernel_per_s", kernel_rate[serve_median(ROUNDS, kernel_rate)]);
        bench_number("lights_per_pass", all / passes);
        bench_number("kernel_cpu_ms", kernel_cpu_s * 1e3 / n_kernel);
        bench_number("daemon_cpu_ms", cpu_s * 1e3 / n);
        bench_number("client_cpu_ms", client_cpu_s * 1e3 / n);
        bench_number("of_the_kernel_by_cpu",
                     kernel_cpu_s / n_kernel / ((cpu_s + client_cpu_s) / n));
        bench_number("ms_median", serve_quantile(&f[m], 0.5));
        bench_number("ms_p99", serve_quantile(&f[m], 0.99));
        serve_goal_least("of_the_kernel",
                         rate[m] / kernel_rate[serve_median(ROUNDS, kernel_rate)], 0.8);
        bench_end();
        bench_begin(s->env, "serve_lights_evenness");
        serve_goal_most("p99_over_median",
                        serve_quantile(&f[m], 0.99) / serve_quantile(&f[m], 0.5), 3);
        bench_end();
    }
    for (int r = 0; r < ROUNDS; r++) serve_flow_finish(&f[r]);
    serve_close(&crowd);
    kernel_finish(&kernel);
    return status;
}

static int run_lights(struct bench_env *env)
{
    return with_daemon(env, small_cache, 0, lights);
}

// ---- the same light for all

static int same(struct served *s)
{
    double rate[2];
    int status = PRT_OK;
    for (int many = 0; many < 2 && !status; many++) {
        struct serve_crowd crowd;
        struct serve_flow f = new_flow(s, serve_send_colors, 2);
        f.same_light = true;
        f.step_deg = many ? 0.613f : 0.731f;
        status = serve_open(s->env, s->daemon.address[1], NULL, many ? N_CLIENT : 1, NULL, NULL,
                            &crowd);
        if (!status) status = serve_run(&crowd, &f, figure_s(s, 0.5), figure_s(s, 2));
        rate[many] = serve_rate(&f);
        serve_flow_finish(&f);
        serve_close(&crowd);
    }
    if (status) return status;
    bench_begin(s->env, "serve_same_light_rgb9e5");
    bench_number("clients", N_CLIENT);
    bench_number("frames_per_s_of_one", rate[0]);
    bench_number("frames_per_s", rate[1]);
    serve_goal_least("times_one", rate[1] / rate[0], 8);
    bench_end();
    return PRT_OK;
}

static int run_same(struct bench_env *env)
{
    return with_daemon(env, NULL, 0, same);
}

// ---- pictures

static int pictures(struct served *s)
{
    struct serve_crowd crowd;
    struct serve_flow f = new_flow(s, serve_send_jpeg, 1), warm = f;
    int status =
        serve_open(s->env, s->daemon.address[1], NULL, N_PICTURE_CLIENT, NULL, NULL, &crowd);
    // What only the first pictures pay: the GL context, tables, the rows' columns.
    if (!status) status = serve_run(&crowd, &warm, 0, figure_s(s, 2));
    serve_flow_finish(&warm);
    double cpu_s = bench_daemon_cpu_s(&s->daemon);
    double passes = total(s, "relightd_passes_total"),
           all = total(s, "relightd_relights_total");
    if (!status) status = serve_run(&crowd, &f, 0, figure_s(s, 4));
    cpu_s = bench_daemon_cpu_s(&s->daemon) - cpu_s;
    passes = total(s, "relightd_passes_total") - passes;
    all = total(s, "relightd_relights_total") - all;
    serve_close(&crowd);
    if (!status) {
        bench_begin(s->env, "serve_pictures_jpeg");
        bench_number("clients", N_PICTURE_CLIENT);
        bench_number("kib", f.bytes / f.n_answer / 1024);
        bench_number("lights_per_pass", all / passes);
        bench_number("ms_median", serve_quantile(&f, 0.5));
        bench_number("ms_p99", serve_quantile(&f, 0.99));
        bench_number("daemon_cpu_ms", cpu_s * 1e3 / f.n_answer);
        serve_goal_least("images_per_s", serve_rate(&f), 150);
        bench_end();
    }
    serve_flow_finish(&f);
    return status;
}

static int run_pictures(struct bench_env *env)
{
    return with_daemon(env, small_cache, 0, pictures);
}

BENCH(serve_small, "relightd: pings/s, pipelined over 16 connections", run_small)
BENCH(serve_idle, "relightd: memory of 1,000 idle connections beside 200 active ones", run_idle)
BENCH(serve_lights, "relightd: 16 clients with different lights against the kernel", run_lights)
BENCH(serve_same, "relightd: the same light for 16 clients against one", run_same)
BENCH(serve_pictures, "relightd: 8 clients of 800x600 JPEG", run_pictures)
