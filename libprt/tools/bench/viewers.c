// SPDX-License-Identifier: MIT
// 200 viewers of one model: each has a view of its own whose light turns ten times a second and
// takes frames of coefficients. Viewers do not draw. Fewer viewers, and colours, for
// comparison.
#include "serve_flow.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N_VIEWER = 200, STATES_PER_S = 10, KEPT = 64 };

struct viewer {
    uint64_t view, sequence;
    double set_s[KEPT]; // when state i was sent, at i % KEPT
    double next_s;      // when the next one is due
    bool busy;          // a state was sent, and no frame has shown it yet
};

struct audience {
    struct bench_env *env;
    const struct bench_daemon *daemon;
    const char *light;
    struct viewer *viewer;
    int format;
    bool counting;
    struct serve_flow times; // of frames: latencies, bytes
    unsigned n_error, n_late;
    char error[160];
};

static void put_light(const struct audience *a, const struct serve_client *c,
                      Relight__Light *out)
{
    relight__light__init(out);
    out->env = (char *)a->light;
    out->rotate_deg = 3.1f * (float)c->turn + 0.37f * (float)c->number;
}

static void open_view(struct audience *a, struct serve_client *c)
{
    Relight__ViewOpenRequest m = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    Relight__ViewState state = RELIGHT__VIEW_STATE__INIT;
    Relight__ViewOptions options = RELIGHT__VIEW_OPTIONS__INIT;
    Relight__Light light, *lights[] = {&light};
    put_light(a, c, &light);
    options.window = 2;
    options.color_format = (Relight__ColorFormat)a->format;
    state.n_lights = 1;
    state.lights = lights;
    state.options = &options;
    m.model = (char *)a->daemon->model;
    m.colors = true;
    m.state = &state;
    struct viewer *v = &a->viewer[c->number];
    v->view = serve_send(c, RELIGHT_TYPE_VIEW_OPEN, &m.base, NULL, 0, 0);
    v->set_s[0] = prt_time_s();
    v->next_s = v->set_s[0] + (c->number % 100) / 100.0 / STATES_PER_S;
    v->busy = true;
}

static void turn_light(struct audience *a, struct serve_client *c, double now)
{
    static char *fields[] = {(char *)"lights.rotate_deg"};
    struct viewer *v = &a->viewer[c->number];
    Relight__ViewSetRequest m = RELIGHT__VIEW_SET_REQUEST__INIT;
    Relight__ViewState state = RELIGHT__VIEW_STATE__INIT;
    Relight__Light light, *lights[] = {&light};
    c->turn++;
    put_light(a, c, &light);
    state.n_lights = 1;
    state.lights = lights;
    state.n_fields = 1;
    state.fields = fields;
    m.view = v->view;
    m.sequence = ++v->sequence;
    m.state = &state;
    v->set_s[m.sequence % KEPT] = now;
    a->n_late += a->counting && v->busy;
    v->busy = true;
    serve_send(c, RELIGHT_TYPE_VIEW_SET, &m.base, NULL, 0, 0);
    v->next_s += 1.0 / STATES_PER_S;
    if (v->next_s < now) v->next_s = now; // this program was held up
}

// Acknowledges at once: one-way, under id 0, without an answer.
static void acknowledge(struct serve_client *c, uint64_t view, uint64_t frame)
{
    Relight__ViewAck m = RELIGHT__VIEW_ACK__INIT;
    m.view = view;
    m.shown = frame;
    uint64_t id = c->last_id;
    c->last_id = UINT64_MAX;
    serve_send(c, RELIGHT_TYPE_VIEW_ACK, &m.base, NULL, 0, 0);
    c->last_id = id;
    c->open--;
}

static void take(struct serve_client *c, const struct relight_frame *frame)
{
    struct audience *a = c->crowd->user;
    struct viewer *v = &a->viewer[c->number];
    if (frame->type == (RELIGHT_TYPE_VIEW_SET | RELIGHT_TYPE_ANSWER)) return;
    ProtobufCMessage *message = relight_frame_unpack(frame);
    if (!message) return;
    const Relight__ViewFrame *f = (Relight__ViewFrame *)message;
    const Relight__Error *error =
        frame->type == RELIGHT_TYPE_ERROR ? (Relight__Error *)message : f->error;
    if (error) {
        if (!a->n_error++) snprintf(a->error, sizeof a->error, "%s", error->text);
    } else {
        if (f->sequence == v->sequence) v->busy = false;
        if (a->counting)
            serve_keep(&a->times, (prt_time_s() - v->set_s[f->sequence % KEPT]) * 1e3,
                       (double)(frame->payload_size + frame->header_size));
        acknowledge(c, v->view, f->frame);
    }
    protobuf_c_message_free_unpacked(message, NULL);
}

static void run_for(struct serve_crowd *crowd, struct audience *a, double seconds)
{
    double end = prt_time_s() + seconds, now;
    while ((now = prt_time_s()) < end) {
        for (unsigned i = 0; i < crowd->n; i++)
            if (now >= a->viewer[i].next_s) turn_light(a, &crowd->client[i], now);
        serve_turn(crowd, 1);
    }
}

static void report(struct bench_env *env, const char *name, const struct audience *a,
                   unsigned n, double cpu_ms, double lights)
{
    const struct serve_flow *f = &a->times;
    const double wanted = (double)n * STATES_PER_S;
    bench_begin(env, name);
    bench_number("viewers", n);
    bench_number("frames_per_s", serve_rate(f));
    bench_number("frames_per_s_each", serve_rate(f) / n);
    bench_number("bytes_a_frame", f->bytes / f->n_answer);
    bench_number("mbit_per_s", f->bytes / f->seconds * 8e-6);
    bench_number("ms_median", serve_quantile(f, 0.5));
    bench_number("ms_p95", serve_quantile(f, 0.95));
    bench_number("ms_p99", serve_quantile(f, 0.99));
    bench_number("daemon_cpu_ms_a_frame", cpu_ms / f->n_answer);
    bench_number("lights_per_pass", lights);
    bench_number("states_overtaken", a->n_late);
    serve_goal_least("of_the_states", serve_rate(f) / wanted, 0.97);
    bench_end();
}

static int watch(struct bench_env *env, const struct bench_daemon *daemon, const char *light,
                 unsigned n, int format, const char *name)
{
    struct serve_crowd crowd = {.epoll_fd = -1};
    struct audience a = {.env = env,
                         .daemon = daemon,
                         .light = light,
                         .format = format,
                         .viewer = calloc(n, sizeof *a.viewer)};
    double passes = 0, relights = 0, passes_end = 0, relights_end = 0;
    int status =
        a.viewer ? serve_open(env, daemon->address[1], NULL, n, NULL, NULL, &crowd) : PRT_NOMEM;
    crowd.user = &a;
    crowd.answer = take;
    for (unsigned i = 0; i < n && !status; i++) open_view(&a, &crowd.client[i]);
    if (!status) run_for(&crowd, &a, env->quick ? 0.5 : 2);
    if (!status) status = serve_metric(env, daemon, "relightd_passes_total", &passes);
    if (!status) status = serve_metric(env, daemon, "relightd_relights_total", &relights);
    double cpu_s = bench_daemon_cpu_s(daemon), begin = prt_time_s();
    a.counting = true;
    if (!status) run_for(&crowd, &a, env->quick ? 0.5 : fmax(env->seconds, 5));
    a.times.seconds = prt_time_s() - begin;
    cpu_s = bench_daemon_cpu_s(daemon) - cpu_s;
    if (!status) status = serve_metric(env, daemon, "relightd_passes_total", &passes_end);
    if (!status) status = serve_metric(env, daemon, "relightd_relights_total", &relights_end);
    serve_order(&a.times);
    if (!status && (a.n_error || crowd.n_gone || !a.times.n_answer))
        status = prt_fail(&env->ctx, PRT_IO, "%u frames failed (%s), %u connections closed",
                          a.n_error, a.error, crowd.n_gone);
    if (!status)
        report(env, name, &a, n, cpu_s * 1e3,
               (relights_end - relights) / (passes_end - passes));
    serve_flow_finish(&a.times);
    serve_close(&crowd);
    free(a.viewer);
    return status;
}

static int run_viewers(struct bench_env *env)
{
    static const char *const extra[] = {"--cache", "256M", NULL};
    const unsigned n = env->quick ? 20 : N_VIEWER;
    struct bench_daemon daemon;
    char light[80];
    int status = bench_daemon_start_with(env, extra, 0, &daemon);
    if (status) return status;
    status = serve_upload_env(env, &daemon, light);
    if (!status)
        status = watch(env, &daemon, light, 1, RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED,
                       "viewers_1");
    if (!status)
        status = watch(env, &daemon, light, n, RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED,
                       "viewers");
    if (!status)
        status = watch(env, &daemon, light, n / 4, RELIGHT__COLOR_FORMAT__COLOR_RGB9E5,
                       "viewers_rgb9e5");
    bench_daemon_stop(&daemon);
    return status;
}

BENCH(viewers, "relightd: 200 viewers of one model, each with a light that turns at 10/s",
      run_viewers)
