// SPDX-License-Identifier: MIT
// Closed loops, their requests and their counts.
#include "serve_flow.h"

#include "relight/relight.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { WIDTH = 800, HEIGHT = 600 };

static int ascending(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void keep_time(struct serve_flow *f, double ms)
{
    if (f->n_ms == f->room) {
        unsigned room = f->room ? 2 * f->room : 4096;
        float *more = realloc(f->ms, room * sizeof *more);
        if (!more) return;
        f->ms = more;
        f->room = room;
    }
    f->ms[f->n_ms++] = (float)ms;
}

void serve_keep(struct serve_flow *f, double ms, double bytes)
{
    f->n_answer++;
    f->bytes += bytes;
    keep_time(f, ms);
}

void serve_order(struct serve_flow *f)
{
    if (f->n_ms) qsort(f->ms, f->n_ms, sizeof *f->ms, ascending);
}

static void count_error(struct serve_flow *f, const struct relight_frame *frame)
{
    Relight__Error *e = (Relight__Error *)relight_frame_unpack(frame);
    int code = e ? (int)e->code : 0;
    if (code == RELIGHT__ERROR_CODE__ERROR_BUSY) f->n_busy++;
    else if (code == RELIGHT__ERROR_CODE__ERROR_DEADLINE) f->n_late++;
    else if (!f->n_other++)
        snprintf(f->error, sizeof f->error, "%s", e ? e->text : "an error that does not parse");
    if (e) protobuf_c_message_free_unpacked(&e->base, NULL);
}

void serve_count(struct serve_client *c, const struct relight_frame *frame)
{
    struct serve_flow *f = c->crowd->user;
    double ms = (prt_time_s() - c->sent_s[frame->id % SERVE_DEPTH]) * 1e3;
    if (frame->type == RELIGHT_TYPE_ERROR) {
        if (f->counting) count_error(f, frame);
    } else if (f->counting) {
        serve_keep(f, ms, (double)frame->payload_size);
        if (f->deadline_ms) f->worst_over_ms = fmax(f->worst_over_ms, ms - f->deadline_ms);
        if (f->deadline_ms) f->n_over += ms > f->deadline_ms;
    }
    if (!f->stopping && f->depth) f->send(f, c);
}

int serve_run(struct serve_crowd *crowd, struct serve_flow *f, double warm_s, double seconds)
{
    f->stopping = f->counting = false;
    crowd->user = f;
    crowd->answer = serve_count;
    for (unsigned k = 0; k < f->depth; k++)
        for (unsigned i = 0; i < crowd->n; i++) f->send(f, &crowd->client[i]);
    double begin = prt_time_s(), from = begin;
    while (prt_time_s() < begin + warm_s + seconds) {
        if (!f->counting && prt_time_s() >= begin + warm_s) {
            f->counting = true;
            from = prt_time_s();
        }
        serve_turn(crowd, 20);
    }
    f->seconds = prt_time_s() - from;
    f->counting = false;
    f->stopping = true;
    serve_order(f);
    int status = serve_settle(crowd, 30);
    if (!status && crowd->n_gone)
        status = prt_fail(&crowd->env->ctx, PRT_IO, "the daemon closed %u connections",
                          crowd->n_gone);
    if (!status && f->n_other)
        status = prt_fail(&crowd->env->ctx, PRT_IO, "%u errors, the first: %s", f->n_other,
                          f->error);
    return status;
}

void serve_flow_finish(struct serve_flow *f)
{
    free(f->ms);
    f->ms = NULL;
    f->n_ms = f->room = 0;
}

double serve_rate(const struct serve_flow *f)
{
    return f->n_answer / f->seconds;
}

double serve_quantile(const struct serve_flow *f, double part)
{
    return f->n_ms ? (double)f->ms[(size_t)(part * (f->n_ms - 1) + 0.5)] : NAN;
}

// ---- requests

void serve_send_ping(struct serve_flow *f, struct serve_client *c)
{
    serve_send(c, RELIGHT_TYPE_PING, NULL, NULL, 0, f->deadline_ms);
}

// The client's next light. No two clients have the same one, unless they are to.
static void next_light(const struct serve_flow *f, struct serve_client *c, Relight__Light *out)
{
    relight__light__init(out);
    out->env = (char *)f->env;
    float turn = f->step_deg * (float)++c->turn;
    out->rotate_deg = f->same_light ? turn : turn + 0.01f * (float)(c->number + 1);
}

void serve_send_colors(struct serve_flow *f, struct serve_client *c)
{
    Relight__ColorsRequest r = RELIGHT__COLORS_REQUEST__INIT;
    Relight__Light light, *lights[] = {&light};
    next_light(f, c, &light);
    r.model = (char *)f->model;
    r.lights = lights;
    r.n_lights = 1;
    r.format = RELIGHT__COLOR_FORMAT__COLOR_RGB9E5;
    serve_send(c, RELIGHT_TYPE_COLORS, &r.base, NULL, 0, f->deadline_ms);
}

void serve_send_jpeg(struct serve_flow *f, struct serve_client *c)
{
    Relight__ImageRequest r = RELIGHT__IMAGE_REQUEST__INIT;
    Relight__Picture picture = RELIGHT__PICTURE__INIT;
    Relight__Light light, *lights[] = {&light};
    next_light(f, c, &light);
    picture.width = WIDTH;
    picture.height = HEIGHT;
    picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_JPEG;
    r.model = (char *)f->model;
    r.lights = lights;
    r.n_lights = 1;
    r.picture = &picture;
    serve_send(c, RELIGHT_TYPE_IMAGE, &r.base, NULL, 0, f->deadline_ms);
}

int serve_upload_env(struct bench_env *env, const struct bench_daemon *daemon, char word[80])
{
    struct prt_blob blob;
    struct relight_client *client = NULL;
    struct relight_error error;
    int status = bench_env_file(&env->ctx, "hdr", 1, &blob);
    if (status) return status;
    strcpy(word, "env:");
    if (relight_connect(daemon->address[0], NULL, &client, &error) ||
        relight_upload(client, "sky.hdr", blob.bytes, blob.size, NULL, NULL, word + 4, NULL,
                       &error))
        status = prt_fail(&env->ctx, PRT_IO, "%s", error.text);
    relight_close(client);
    prt_free(blob.bytes);
    return status;
}

int serve_metric(struct bench_env *env, const struct bench_daemon *daemon, const char *name,
                 double *value)
{
    struct relight_client *client = NULL;
    struct relight_stats stats = {0};
    struct relight_error error;
    int status = PRT_OK;
    *value = 0;
    if (relight_connect(daemon->address[0], NULL, &client, &error) ||
        relight_stats(client, &stats, &error))
        status = prt_fail(&env->ctx, PRT_IO, "%s", error.text);
    for (size_t i = 0; i < stats.n_metric && !status; i++)
        if (!strcmp(stats.metric[i].name, name)) *value += stats.metric[i].value;
    if (!status) relight_stats_finish(&stats);
    relight_close(client);
    return status;
}

int serve_median(int n, const double *x)
{
    for (int i = 0; i < n; i++) {
        int below = 0;
        for (int k = 0; k < n; k++) below += x[k] < x[i] || (x[k] == x[i] && k < i);
        if (below == n / 2) return i;
    }
    return 0;
}

void serve_goal_least(const char *key, double value, double goal)
{
    bench_number(key, value);
    bench_number("goal_at_least", goal);
    bench_text("goal", value >= goal ? "met" : "missed");
}

void serve_goal_most(const char *key, double value, double goal)
{
    bench_number(key, value);
    bench_number("goal_at_most", goal);
    bench_text("goal", value <= goal ? "met" : "missed");
}
