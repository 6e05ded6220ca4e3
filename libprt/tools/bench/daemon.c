// SPDX-License-Identifier: MIT
// Time that a client of relightd waits on loopback: from the call to the received answer,
// through librelight. Each figure is the median and the 95th percentile of 40 requests, beside
// the target the project set itself (where it did).
#include "daemon.h"

#include "relight/relight.h"

#include <math.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { N_TIME = 40, N_PART = 7, WIDTH = 800, HEIGHT = 600, MAX_CLIENT = 8 };

struct session {
    struct bench_env *env;
    struct bench_daemon daemon;
    struct relight_client *client[2]; // unix, tcp
    unsigned n;                       // requests a figure
    uint32_t number;                  // of the last environment file
    float turn;                       // every request gets one that was never used
    unsigned n_material;
    char envs[N_TIME + 1][80];
};

struct sample {
    double ms[N_TIME];
    double part[N_PART][N_TIME]; // times that the daemon reports
    double bytes;
    unsigned n;
    double cpu_s; // of the daemon's clock when it began
};

static int fail(struct session *s, const struct relight_error *error)
{
    return prt_fail(&s->env->ctx, PRT_IO, "%s", error->text);
}

static int ascending(const void *a, const void *b)
{
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double quantile(double *x, unsigned n, double q)
{
    qsort(x, n, sizeof *x, ascending);
    return x[(unsigned)(q * (n - 1) + 0.5)];
}

static void keep(struct sample *out, double ms, const struct relight_cost *c, uint64_t bytes)
{
    const float part[N_PART] = {c->queue_ms, c->light_ms,  c->relight_ms, c->raster_ms,
                                c->shade_ms, c->encode_ms, c->total_ms};
    for (int i = 0; i < N_PART; i++) out->part[i][out->n] = (double)part[i];
    out->ms[out->n++] = ms;
    out->bytes = (double)bytes;
}

// target_ms 0: none was set.
static void print(struct session *s, const char *name, const char *carrier, struct sample *x,
                  double target_ms)
{
    static const char *const part[N_PART] = {
        "daemon_queue_ms", "daemon_light_ms",  "daemon_relight_ms", "daemon_raster_ms",
        "daemon_shade_ms", "daemon_encode_ms", "daemon_total_ms"};
    bench_begin(s->env, name);
    bench_text("carrier", carrier);
    double median = quantile(x->ms, x->n, 0.5);
    bench_number("ms_median", median);
    bench_number("ms_p95", quantile(x->ms, x->n, 0.95));
    bench_number("ms_best", x->ms[0]);
    bench_number("requests", x->n);
    bench_number("daemon_cpu_ms", (bench_daemon_cpu_s(&s->daemon) - x->cpu_s) * 1e3 / x->n);
    if (target_ms > 0) {
        bench_number("target_ms", target_ms);
        bench_text("target", median <= target_ms ? "met" : "missed");
    }
    for (int i = 0; i < N_PART; i++) bench_number(part[i], quantile(x->part[i], x->n, 0.5));
    bench_number("bytes", x->bytes);
    bench_end();
}

// ---- one request of a kind, timed

static int time_image(struct session *s, struct relight_client *client, const char *light_env,
                      float turn, enum relight_image_format format, double begin,
                      struct sample *out)
{
    struct relight_light light = {.env = light_env, .rotate_deg = turn};
    struct relight_image_request r = {
        .model = s->daemon.model,
        .n_light = 1,
        .lights = &light,
        .picture = {.width = WIDTH, .height = HEIGHT, .format = format}};
    struct relight_image image;
    struct relight_error error;
    if (relight_image(client, &r, &image, &error)) return fail(s, &error);
    if (out) keep(out, (prt_time_s() - begin) * 1e3, &image.cost, image.n_byte);
    relight_image_finish(&image);
    return PRT_OK;
}

static int time_colors(struct session *s, struct relight_client *client, float turn,
                       enum relight_color_format format, struct sample *out)
{
    struct relight_light light = {.env = s->envs[0], .rotate_deg = turn};
    struct relight_colors_request r = {
        .model = s->daemon.model, .n_light = 1, .lights = &light, .format = format};
    struct relight_colors colors;
    struct relight_error error;
    double begin = prt_time_s();
    if (relight_colors(client, &r, &colors, &error)) return fail(s, &error);
    keep(out, (prt_time_s() - begin) * 1e3, &colors.cost, colors.plane_bytes * colors.n_plane);
    relight_colors_finish(&colors);
    return PRT_OK;
}

static float new_turn(struct session *s)
{
    return s->turn += 0.731f;
}

static int upload(struct session *s, const char *format, bool timed, char word[80],
                  struct sample *out)
{
    struct prt_blob blob;
    struct relight_error error;
    char name[32];
    int status = bench_env_file(&s->env->ctx, format, ++s->number, &blob);
    if (status) return status;
    snprintf(name, sizeof name, "sky-%u.%s", s->number, format);
    double begin = prt_time_s();
    strcpy(word, "env:");
    if (relight_upload(s->client[0], name, blob.bytes, blob.size, NULL, NULL, word + 4, NULL,
                       &error))
        status = fail(s, &error);
    if (!status && timed)
        status = time_image(s, s->client[0], word, 0, RELIGHT_IMAGE_PNG, begin, out);
    prt_free(blob.bytes);
    return status;
}

// Waits until the daemon is idle (it decodes uploads ahead).
static int settle(struct session *s)
{
    double bytes = -1, last = -2, begin = prt_time_s();
    while (bytes != last && prt_time_s() - begin < 60) {
        struct relight_stats stats;
        struct relight_error error;
        usleep(s->env->quick ? 50000 : 500000);
        if (relight_stats(s->client[0], &stats, &error)) return fail(s, &error);
        last = bytes;
        for (size_t i = 0; i < stats.n_metric; i++)
            if (!strcmp(stats.metric[i].name, "relightd_cache_bytes"))
                bytes = stats.metric[i].value;
        relight_stats_finish(&stats);
    }
    return PRT_OK;
}

static void close_session(struct session *s)
{
    for (int i = 0; i < 2; i++) relight_close(s->client[i]);
    bench_daemon_stop(&s->daemon);
}

// A daemon that has drawn one picture: camera and model are cached, as in a session.
static int open_session(struct bench_env *env, struct session *s)
{
    struct relight_error error;
    *s = (struct session){.env = env, .n = env->quick ? 3 : N_TIME};
    int status = bench_daemon_start(env, &s->daemon);
    for (int i = 0; i < 2 && !status; i++)
        if (relight_connect(s->daemon.address[i], NULL, &s->client[i], &error))
            status = fail(s, &error);
    if (!status) status = upload(s, "hdr", false, s->envs[0], NULL);
    if (!status)
        status = time_image(s, s->client[0], s->envs[0], 0, RELIGHT_IMAGE_JPEG, 0, NULL);
    if (!status) status = settle(s);
    if (status) close_session(s);
    return status;
}

// ---- figures

static int images(struct session *s)
{
    static const struct {
        const char *name, *carrier;
        int client;
        enum relight_image_format format;
        double target_ms;
    } figure[] = {
        {"daemon_image_jpeg_new_angle", "unix", 0, RELIGHT_IMAGE_JPEG, 15},
        {"daemon_image_jpeg_new_angle", "tcp", 1, RELIGHT_IMAGE_JPEG, 15},
        {"daemon_image_png_new_angle", "unix", 0, RELIGHT_IMAGE_PNG, 60},
        {"daemon_image_png_new_angle", "tcp", 1, RELIGHT_IMAGE_PNG, 60},
    };
    int status = PRT_OK;
    for (size_t f = 0; f < sizeof figure / sizeof *figure && !status; f++) {
        struct sample x = {.cpu_s = bench_daemon_cpu_s(&s->daemon)};
        for (unsigned i = 0; i < s->n && !status; i++)
            status = time_image(s, s->client[figure[f].client], s->envs[0], new_turn(s),
                                figure[f].format, prt_time_s(), &x);
        if (!status) print(s, figure[f].name, figure[f].carrier, &x, figure[f].target_ms);
    }
    return status;
}

// Lights that the daemon has, but that no request has named yet.
static int unused_lights(struct session *s)
{
    int status = PRT_OK;
    for (int png = 0; png < 2 && !status; png++) {
        struct sample x = {.n = 0};
        for (unsigned i = 1; i <= s->n && !status; i++)
            status = upload(s, "hdr", false, s->envs[i], NULL);
        if (!status) status = settle(s);
        x.cpu_s = bench_daemon_cpu_s(&s->daemon);
        for (unsigned i = 1; i <= s->n && !status; i++)
            status = time_image(s, s->client[0], s->envs[i], 0,
                                png ? RELIGHT_IMAGE_PNG : RELIGHT_IMAGE_JPEG, prt_time_s(), &x);
        if (!status)
            print(s, png ? "daemon_image_png_unused_light" : "daemon_image_jpeg_unused_light",
                  "unix", &x, png ? 60 : 15);
    }
    return status;
}

static int colors(struct session *s)
{
    static const struct {
        const char *name, *carrier;
        int client;
        enum relight_color_format format;
    } figure[] = {{"daemon_colors_f32", "unix", 0, RELIGHT_COLOR_F32},
                  {"daemon_colors_f32", "tcp", 1, RELIGHT_COLOR_F32},
                  {"daemon_colors_f16", "unix", 0, RELIGHT_COLOR_F16},
                  {"daemon_colors_srgb8", "unix", 0, RELIGHT_COLOR_SRGB8}};
    int status = PRT_OK;
    for (size_t f = 0; f < sizeof figure / sizeof *figure && !status; f++) {
        struct sample x = {.cpu_s = bench_daemon_cpu_s(&s->daemon)};
        for (unsigned i = 0; i < s->n && !status; i++)
            status =
                time_colors(s, s->client[figure[f].client], new_turn(s), figure[f].format, &x);
        if (!status) print(s, figure[f].name, figure[f].carrier, &x, 0);
    }
    return status;
}

static int with_session(struct bench_env *env, int (*measure)(struct session *))
{
    struct session *s = calloc(1, sizeof *s);
    int status = s ? open_session(env, s) : PRT_NOMEM;
    if (!status) {
        status = measure(s);
        close_session(s);
    }
    free(s);
    return status;
}

static int answers(struct session *s)
{
    int status = images(s);
    if (!status) status = unused_lights(s);
    return status ? status : colors(s);
}

static int run_answers(struct bench_env *env)
{
    return with_session(env, answers);
}

// A file the daemon has never seen, from its bytes in memory to a PNG in hand. The first of
// each kind finds a daemon that has just been started.
static int new_files(struct session *s)
{
    static const char *const format[] = {"hdr", "exr", "png"};
    int status = PRT_OK;
    for (size_t f = 0; f < 3 && !status; f++) {
        struct sample x = {.cpu_s = bench_daemon_cpu_s(&s->daemon)};
        char name[64], word[80];
        for (unsigned i = 0; i < s->n && !status; i++)
            status = upload(s, format[f], true, word, &x);
        snprintf(name, sizeof name, "daemon_new_%s_to_picture", format[f]);
        double first = x.ms[0];
        if (status) break;
        print(s, name, "unix", &x, 500);
        snprintf(name, sizeof name, "daemon_first_%s_to_picture", format[f]);
        x = (struct sample){.n = 1, .ms = {first}};
        bench_begin(s->env, name);
        bench_number("ms", first);
        bench_number("target_ms", 500);
        bench_text("target", first <= 500 ? "met" : "missed");
        bench_end();
    }
    return status;
}

static int run_new_files(struct bench_env *env)
{
    return with_session(env, new_files);
}

// ---- editing: --file is a joint transport

// A material without cached results: near marble, with the bake's eta.
static void new_material(struct session *s, double eta, char text[160])
{
    double x = 0.001 * ++s->n_material;
    snprintf(text, 160,
             "{\"sigma_s_prime\":[%.4f,1.4,1.9],\"sigma_a\":[0.01,%.5f,0.09],\"eta\":%g}",
             1.1 + x, 0.03 + 0.1 * x, eta);
}

static int time_edit(struct session *s, double eta, float turn, int picture,
                     enum relight_color_format format, struct sample *out)
{
    char text[160];
    struct relight_light light = {.env = s->envs[0], .rotate_deg = turn};
    struct relight_shade shade = {.material = text};
    struct relight_colors_request r = {.model = s->daemon.model,
                                       .n_light = 1,
                                       .lights = &light,
                                       .shade = shade,
                                       .format = format};
    struct relight_image_request p = {
        .model = s->daemon.model,
        .n_light = 1,
        .lights = &light,
        .shade = shade,
        .picture = {.width = WIDTH, .height = HEIGHT, .format = RELIGHT_IMAGE_JPEG}};
    struct relight_colors colors;
    struct relight_image image;
    struct relight_error error;
    new_material(s, eta, text);
    double begin = prt_time_s();
    if (picture ? relight_image(s->client[0], &p, &image, &error)
                : relight_colors(s->client[0], &r, &colors, &error))
        return fail(s, &error);
    double ms = (prt_time_s() - begin) * 1e3;
    if (picture) {
        keep(out, ms, &image.cost, image.n_byte);
        relight_image_finish(&image);
    } else {
        keep(out, ms, &colors.cost, colors.plane_bytes * colors.n_plane);
        relight_colors_finish(&colors);
    }
    return PRT_OK;
}

// A new material under a light that stays, under one that is new as well, and in a picture.
static int edits(struct session *s)
{
    static const struct {
        const char *name;
        bool new_light, picture;
        enum relight_color_format format;
    } figure[] = {{"daemon_edit_colors_f32", false, false, RELIGHT_COLOR_F32},
                  {"daemon_edit_colors_f16", false, false, RELIGHT_COLOR_F16},
                  {"daemon_edit_and_new_light_colors_f16", true, false, RELIGHT_COLOR_F16},
                  {"daemon_edit_image_jpeg", false, true, RELIGHT_COLOR_F32},
                  {"daemon_edit_and_new_light_image_jpeg", true, true, RELIGHT_COLOR_F32}};
    struct prt_file *file;
    int status = prt_file_open(&s->env->ctx, s->env->file, PRT_FILE_CHECK_HEADERS, &file);
    if (status) return status;
    double eta = (double)prt_file_transport(file)->media.medium->eta;
    bool joint = prt_file_transport(file)->engine == PRT_TRANSPORT_JOINT;
    prt_file_close(file);
    if (!joint)
        return prt_fail(&s->env->ctx, PRT_MISMATCH, "%s is not a joint transport",
                        s->env->file);
    for (size_t f = 0; f < sizeof figure / sizeof *figure && !status; f++) {
        struct sample x = {.n = 0};
        // The second asking of a light is not the first edit under it that a user makes.
        for (unsigned i = 0; i < 2 && !status; i++)
            status = time_edit(s, eta, 0, figure[f].picture, figure[f].format, &x);
        x = (struct sample){.cpu_s = bench_daemon_cpu_s(&s->daemon)};
        for (unsigned i = 0; i < s->n && !status; i++)
            status = time_edit(s, eta, figure[f].new_light ? new_turn(s) : 0, figure[f].picture,
                               figure[f].format, &x);
        if (!status) print(s, figure[f].name, "unix", &x, 0);
    }
    return status;
}

static int run_edits(struct bench_env *env)
{
    return env->file ? with_session(env, edits) : PRT_OK; // nothing made up takes materials
}

// Several clients at once, each with its own turning light.

struct visitor {
    struct session *session;
    struct relight_client *client;
    pthread_t thread;
    float turn;
    struct sample sample;
    int status;
};

static void *visit(void *arg)
{
    struct visitor *v = arg;
    struct session *s = v->session;
    for (unsigned i = 0; i < s->n && !v->status; i++)
        v->status = time_image(s, v->client, s->envs[0], v->turn += 0.731f, RELIGHT_IMAGE_JPEG,
                               prt_time_s(), &v->sample);
    return NULL;
}

static int crowd(struct session *s, unsigned n)
{
    static struct visitor visitor[MAX_CLIENT];
    double all[MAX_CLIENT * N_TIME];
    int status = PRT_OK;
    unsigned n_ready = 0, n_all = 0;
    memset(visitor, 0, sizeof visitor);
    for (; n_ready < n && !status; n_ready++) {
        struct relight_error error;
        struct visitor *v = &visitor[n_ready];
        v->session = s;
        v->turn = 0.01f * (float)(n_ready + 1) + s->turn;
        if (relight_connect(s->daemon.address[n_ready % 2], NULL, &v->client, &error))
            status = fail(s, &error);
    }
    unsigned n_started = 0;
    double begin = prt_time_s();
    while (!status && n_started < n) {
        struct visitor *v = &visitor[n_started];
        if (pthread_create(&v->thread, NULL, visit, v))
            status = prt_fail(&s->env->ctx, PRT_NOMEM, "no thread for a client");
        else n_started++;
    }
    for (unsigned i = 0; i < n_started; i++) {
        pthread_join(visitor[i].thread, NULL);
        if (!status) status = visitor[i].status;
    }
    double seconds = prt_time_s() - begin;
    for (unsigned i = 0; i < n_ready; i++) {
        memcpy(all + n_all, visitor[i].sample.ms, visitor[i].sample.n * sizeof *all);
        n_all += visitor[i].sample.n;
        relight_close(visitor[i].client);
    }
    s->turn += 0.731f * (float)(s->n + 1);
    if (status) return status;
    bench_begin(s->env, "daemon_clients_jpeg_new_angle");
    bench_number("clients", n);
    bench_number("images_per_s", n_all / seconds);
    bench_number("ms_median", quantile(all, n_all, 0.5));
    bench_number("ms_p95", quantile(all, n_all, 0.95));
    bench_number("ms_worst", all[n_all - 1]);
    bench_number("requests", n_all);
    bench_end();
    return PRT_OK;
}

static int crowds(struct session *s)
{
    int status = PRT_OK;
    for (unsigned n = 1; n <= MAX_CLIENT && !status; n *= 2) status = crowd(s, n);
    return status;
}

static int run_crowds(struct bench_env *env)
{
    return with_session(env, crowds);
}

BENCH(daemon_answers, "relightd: pictures and colours under a light turned or unused",
      run_answers)
BENCH(daemon_new_env, "relightd: a new HDR file, upload to picture", run_new_files)
BENCH(daemon_edit, "relightd: new materials, with --file J.prt (a joint transport)", run_edits)
BENCH(daemon_clients, "relightd: 1, 2, 4 and 8 clients at once", run_crowds)
