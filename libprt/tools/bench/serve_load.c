// SPDX-License-Identifier: MIT
// relightd beyond its capacity, between principals, and with more models than memory.
#include "serve_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N_CLIENT = 16, N_MODEL = 10, RESIDENT = 4, ZIPF_ROUNDS = 5, DEADLINE_MS = 250 };

static struct serve_flow colors_flow(const struct bench_daemon *daemon, const char *light,
                                     unsigned depth)
{
    return (struct serve_flow){.send = serve_send_colors,
                               .depth = depth,
                               .model = daemon->model,
                               .env = light,
                               .step_deg = 0.731f};
}

// ---- twice the capacity

// Sends at a rate, whatever comes back, with a deadline in each request.
static int overload(struct serve_crowd *crowd, struct serve_flow *f, double rate,
                    double seconds, double *most_kib, const struct bench_daemon *daemon)
{
    double begin = prt_time_s(), sent = 0, next_look = begin;
    crowd->user = f;
    crowd->answer = serve_count;
    f->counting = true;
    f->depth = 0; // answers send nothing
    while (prt_time_s() - begin < seconds) {
        double now = prt_time_s();
        for (; sent < (now - begin) * rate; sent++) {
            struct serve_client *c = &crowd->client[(unsigned)sent % crowd->n];
            if (c->open < SERVE_DEPTH) f->send(f, c);
        }
        serve_turn(crowd, 1);
        if (now < next_look) continue;
        next_look = now + 1;
        *most_kib = fmax(*most_kib, bench_daemon_rss_kib(daemon));
    }
    int status = serve_settle(crowd, 30); // read at once: an answer that lies there is not late
    f->seconds = prt_time_s() - begin;
    f->counting = false;
    if (status) return status;
    return crowd->n_gone ? prt_fail(&crowd->env->ctx, PRT_IO,
                                    "the daemon closed %u connections", crowd->n_gone)
                         : PRT_OK;
}

// The median of single requests, one after another, in this time.
static int single_ms(struct serve_crowd *one, struct serve_flow f, double seconds, double *ms)
{
    int status = serve_run(one, &f, 0, seconds);
    *ms = serve_quantile(&f, 0.5);
    serve_flow_finish(&f);
    return status;
}

static int run_overload(struct bench_env *env)
{
    static const char *const extra[] = {"--cache", "64M", NULL};
    const double seconds = env->quick ? 1 : 60, look = env->quick ? 0.2 : 1;
    struct serve_crowd crowd = {.epoll_fd = -1}, one = {.epoll_fd = -1};
    struct bench_daemon daemon;
    char light[80];
    double before = 0, after = 0, kib = 0, most_kib = 0;
    int status = bench_daemon_start_with(env, extra, 0, &daemon);
    if (status) return status;
    status = serve_upload_env(env, &daemon, light);
    struct serve_flow single = colors_flow(&daemon, light, 1), f = single;
    struct serve_flow full = colors_flow(&daemon, light, 2);
    if (!status)
        status = serve_open(env, daemon.address[1], NULL, N_CLIENT, NULL, NULL, &crowd);
    if (!status) status = serve_open(env, daemon.address[0], NULL, 1, NULL, NULL, &one);
    if (!status) status = single_ms(&one, single, look, &before);
    if (!status) status = serve_run(&crowd, &full, look, 3 * look);
    f.deadline_ms = DEADLINE_MS;
    f.step_deg = 0.317f;
    // The books are full after a while under load: memory is compared from there on.
    if (!status) {
        struct serve_flow warm = f;
        status = overload(&crowd, &warm, 2 * serve_rate(&full), seconds / 6, &kib, &daemon);
        serve_flow_finish(&warm);
    }
    kib = bench_daemon_rss_kib(&daemon);
    if (!status)
        status = overload(&crowd, &f, 2 * serve_rate(&full), seconds, &most_kib, &daemon);
    double end = prt_time_s();
    if (!status) status = single_ms(&one, single, look, &after);
    double settled = prt_time_s() - end;
    if (!status) {
        const double in_time = (f.n_answer - f.n_over) / f.seconds;
        serve_order(&f);
        bench_begin(env, "serve_overload_goodput");
        bench_number("capacity_per_s", serve_rate(&full));
        bench_number("in_time_per_s", in_time);
        bench_number("ms_median", serve_quantile(&f, 0.5));
        bench_number("ms_p99", serve_quantile(&f, 0.99));
        serve_goal_least("of_capacity", in_time / serve_rate(&full), 0.8);
        bench_end();
        bench_begin(env, "serve_overload");
        bench_number("seconds", f.seconds);
        bench_number("answers_after_deadline", f.n_over);
        bench_number("deadline_ms", DEADLINE_MS);
        bench_number("error_deadline", f.n_late);
        bench_number("error_busy", f.n_busy);
        bench_number("single_ms_before", before);
        bench_number("single_ms_after", after);
        bench_number("after_s", settled);
        // Measured at the client, whose own thread waits for a core, too.
        serve_goal_most("worst_ms_after_deadline", f.worst_over_ms, 50);
        bench_end();
        bench_begin(env, "serve_overload_memory");
        bench_number("rss_mib", kib / 1024);
        serve_goal_most("growth", most_kib / kib, 1.1);
        bench_end();
        bench_begin(env, "serve_overload_recovery");
        serve_goal_most("single_after_over_before", after / before, 2);
        bench_end();
    }
    serve_flow_finish(&f);
    serve_flow_finish(&full);
    serve_close(&crowd);
    serve_close(&one);
    bench_daemon_stop(&daemon);
    return status;
}

// ---- a greedy principal beside a modest one

// Both crowds at once, for the same time.
static void run_both(struct serve_crowd *a, struct serve_flow *fa, struct serve_crowd *b,
                     struct serve_flow *fb, double seconds)
{
    struct serve_crowd *crowd[] = {a, b};
    struct serve_flow *flow[] = {fa, fb};
    for (int i = 0; i < 2; i++) {
        crowd[i]->user = flow[i];
        crowd[i]->answer = serve_count;
        flow[i]->counting = true;
        for (unsigned k = 0; k < flow[i]->depth; k++)
            for (unsigned c = 0; c < crowd[i]->n; c++)
                flow[i]->send(flow[i], &crowd[i]->client[c]);
    }
    double begin = prt_time_s();
    while (prt_time_s() - begin < seconds) {
        serve_turn(a, 0);
        serve_turn(b, 1);
    }
    for (int i = 0; i < 2; i++) {
        flow[i]->seconds = prt_time_s() - begin;
        flow[i]->counting = false;
        flow[i]->stopping = true;
    }
}

// The daemon takes each loopback address for a principal of its own.
static int run_greedy(struct bench_env *env)
{
    const double seconds = env->quick ? 0.2 : fmax(env->seconds, 4);
    struct serve_crowd greedy = {.epoll_fd = -1}, modest = {.epoll_fd = -1};
    struct bench_daemon daemon;
    char light[80];
    int status = bench_daemon_start(env, &daemon);
    if (status) return status;
    status = serve_upload_env(env, &daemon, light);
    struct serve_flow alone = colors_flow(&daemon, light, 2), beside = alone;
    struct serve_flow much = colors_flow(&daemon, light, 16);
    beside.step_deg = 0.317f;
    much.step_deg = 0.419f;
    if (!status)
        status = serve_open(env, daemon.address[1], "127.0.0.2", 2, NULL, NULL, &modest);
    if (!status)
        status = serve_open(env, daemon.address[1], "127.0.0.3", N_CLIENT, NULL, NULL, &greedy);
    if (!status) status = serve_run(&modest, &alone, seconds / 4, seconds);
    if (!status) {
        run_both(&modest, &beside, &greedy, &much, seconds);
        status = serve_settle(&modest, 30);
    }
    if (!status) status = serve_settle(&greedy, 60);
    if (!status) {
        // It is due what it takes alone, but no more than half of what both get.
        double fair = fmin(serve_rate(&alone), (serve_rate(&beside) + serve_rate(&much)) / 2);
        bench_begin(env, "serve_greedy");
        bench_number("modest_alone_per_s", serve_rate(&alone));
        bench_number("modest_beside_per_s", serve_rate(&beside));
        bench_number("greedy_per_s", serve_rate(&much));
        serve_goal_most("taken_from_its_share", 1 - serve_rate(&beside) / fair, 0.6);
        bench_end();
    }
    serve_flow_finish(&alone);
    serve_flow_finish(&beside);
    serve_flow_finish(&much);
    serve_close(&modest);
    serve_close(&greedy);
    bench_daemon_stop(&daemon);
    return status;
}

// ---- more models than memory

// The model of a request: Zipf's law, the k-th most popular of N_MODEL has weight 1/k.
static void send_zipf(struct serve_flow *f, struct serve_client *c)
{
    struct prt_rng rng;
    char name[16];
    double sum = 0, x;
    unsigned k = 0;
    prt_rng_init(&rng, c->turn, 77 + c->number);
    for (unsigned i = 1; i <= N_MODEL; i++) sum += 1.0 / i;
    x = (double)prt_rng_f32(&rng) * sum;
    while (k + 1 < N_MODEL && (x -= 1.0 / (k + 1)) > 0) k++;
    snprintf(name, sizeof name, "model-%u", k);
    f->model = name;
    serve_send_colors(f, c);
}

// A daemon with memory for all models, and one with memory for RESIDENT.
struct zipf {
    struct bench_daemon daemon;
    struct serve_crowd crowd;
    struct serve_flow flow[ZIPF_ROUNDS];
    char light[80];
    double rate[ZIPF_ROUNDS], cpu_s, n_answer;
};

// --cache 64M: the cache is full after the warm-up. While a cache grows, the system clears
// pages for it, which takes time from the daemon that the comparison is not about.
static int zipf_start(struct bench_env *env, const char *memory, struct zipf *z)
{
    const char *const extra[] = {"--memory", memory, "--cache", "64M", NULL};
    const double warm_s = env->quick ? 0.2 : 2;
    z->crowd.epoll_fd = -1;
    int status = bench_daemon_start_with(env, extra, N_MODEL, &z->daemon);
    if (status) return status;
    status = serve_upload_env(env, &z->daemon, z->light);
    for (int r = 0; r < ZIPF_ROUNDS; r++) {
        z->flow[r] = colors_flow(&z->daemon, z->light, 2);
        z->flow[r].send = send_zipf;
    }
    struct serve_flow warm = z->flow[0];
    if (!status)
        status = serve_open(env, z->daemon.address[1], NULL, N_CLIENT, NULL, NULL, &z->crowd);
    if (!status) status = serve_run(&z->crowd, &warm, warm_s, 0);
    serve_flow_finish(&warm);
    return status;
}

static int zipf_round(struct bench_env *env, struct zipf *z, int round)
{
    const double seconds = env->quick ? 0.2 : fmax(env->seconds, 1.5);
    const double cpu_s = bench_daemon_cpu_s(&z->daemon);
    int status = serve_run(&z->crowd, &z->flow[round], 0, seconds);
    z->cpu_s += bench_daemon_cpu_s(&z->daemon) - cpu_s;
    z->n_answer += z->flow[round].n_answer;
    z->rate[round] = serve_rate(&z->flow[round]);
    return status;
}

static void zipf_stop(struct zipf *z)
{
    for (int r = 0; r < ZIPF_ROUNDS; r++) serve_flow_finish(&z->flow[r]);
    serve_close(&z->crowd);
    bench_daemon_stop(&z->daemon);
}

// Bytes of the first model that a daemon here serves.
static int zipf_bytes(struct bench_env *env, double *bytes)
{
    struct bench_daemon probe;
    struct prt_file *file;
    char path[96];
    int status = bench_daemon_start_with(env, NULL, 1, &probe);
    if (status) return status;
    snprintf(path, sizeof path, "%s/models/model-0.prt", probe.folder);
    status = prt_file_open(&env->ctx, path, PRT_FILE_CHECK_HEADERS, &file);
    if (!status) {
        *bytes = (double)prt_file_bytes(file);
        prt_file_close(file);
    }
    bench_daemon_stop(&probe);
    return status;
}

// By turns, as the machine's speed drifts.
static int run_zipf(struct bench_env *env)
{
    struct zipf all = {.cpu_s = 0}, some = {.cpu_s = 0};
    double bytes = 0, opened = 0;
    char memory[32];
    int status = zipf_bytes(env, &bytes);
    if (status) return status;
    snprintf(memory, sizeof memory, "%.0f", bytes * (RESIDENT + 0.5));
    some.crowd.epoll_fd = -1; // where it is not started
    status = zipf_start(env, "8G", &all);
    if (!status) status = zipf_start(env, memory, &some);
    for (int r = 0; r < ZIPF_ROUNDS && !status; r++) {
        status = zipf_round(env, &all, r);
        if (!status) status = zipf_round(env, &some, r);
    }
    if (!status)
        status = serve_metric(env, &some.daemon, "relightd_models_evictions_total", &opened);
    if (!status) {
        const double rate = some.rate[serve_median(ZIPF_ROUNDS, some.rate)];
        const double of_all = all.rate[serve_median(ZIPF_ROUNDS, all.rate)];
        const double cpu_ms = some.cpu_s * 1e3 / some.n_answer;
        const double all_cpu_ms = all.cpu_s * 1e3 / all.n_answer;
        bench_begin(env, "serve_zipf");
        bench_number("models", N_MODEL);
        bench_number("resident", RESIDENT);
        bench_number("model_mib", bytes / 1048576);
        bench_number("all_resident_per_s", of_all);
        bench_number("per_s", rate);
        bench_number("evictions", opened);
        bench_number("all_resident_cpu_ms", all_cpu_ms);
        bench_number("cpu_ms", cpu_ms);
        bench_number("of_all_resident_by_cpu", all_cpu_ms / cpu_ms);
        serve_goal_least("of_all_resident", rate / of_all, 0.8);
        bench_end();
    }
    zipf_stop(&all);
    zipf_stop(&some);
    return status;
}

BENCH(serve_overload, "relightd: twice its capacity for 60 s", run_overload)
BENCH(serve_greedy, "relightd: a greedy principal beside a modest one", run_greedy)
BENCH(serve_zipf, "relightd: ten models, memory for four, Zipf's law", run_zipf)
