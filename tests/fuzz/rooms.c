// SPDX-License-Identifier: MIT
#include "rooms.h"

#include "core/access.h"
#include "core/events.h"
#include "core/log.h"
#include "core/server.h"
#include "net/connection.h"
#include "net/request.h"
#include "render/shared/poses.h"
#include "rooms/rooms.h"
#include "store/holds.h"
#include "store/models.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

enum { MAX_RUNS = 64 };

static struct server server;

// ---- the runner

struct job_run {
    const struct job_events *events;
    void *user;
    char out[4096];
    bool cancelled;
};

static struct job_run *runs[MAX_RUNS];
static unsigned n_run;
static bool refuse_bakes;

static struct job_run *run_start(struct server *of, const struct job_order *order,
                                 const struct job_events *events, void *user, char error[256])
{
    struct job_run *run =
        n_run < MAX_RUNS && !refuse_bakes ? calloc(1, sizeof(struct job_run)) : NULL;
    if (!run) {
        snprintf(error, 256, "the fuzzer refuses to start it");
        return NULL;
    }
    run->events = events;
    run->user = user;
    for (char **a = order->argv; *a; a++)
        if (!strcmp(*a, "-o") && a[1]) snprintf(run->out, sizeof run->out, "%s", a[1]);
    return runs[n_run++] = run;
}

static void run_cancel(struct job_run *run)
{
    run->cancelled = true; // a child takes a while to die
}

static bool run_reap(int pid, int how)
{
    return false;
}

static const struct job_runner runner = {"fuzz", run_start, run_cancel, run_reap};

unsigned rooms_bakes(void)
{
    return n_run;
}

unsigned rooms_bakes_open(void)
{
    return jobs_open(server.jobs);
}

void rooms_refuse_bakes(bool refuse)
{
    refuse_bakes = refuse;
}

void rooms_bake_progress(unsigned i, const char *stage, double fraction)
{
    if (!runs[i]->cancelled) runs[i]->events->progress(runs[i]->user, stage, fraction, 1);
}

void rooms_bake_line(unsigned i, const char *line)
{
    runs[i]->events->line(runs[i]->user, line);
}

static void copy_file(const char *from, const char *to)
{
    char bytes[4096];
    FILE *in = fopen(from, "rb"), *out = fopen(to, "wb");
    for (size_t n; in && out && (n = fread(bytes, 1, sizeof bytes, in)) > 0;)
        fwrite(bytes, 1, n, out);
    if (in) fclose(in);
    if (out) fclose(out);
}

void rooms_bake_end(unsigned i, enum rooms_end how, const char *bake)
{
    struct job_run *run = runs[i];
    runs[i] = runs[--n_run];
    if (run->cancelled && how != ROOMS_DONE) how = ROOMS_CANCELLED;
    if (how == ROOMS_DONE) copy_file(bake, run->out);
    enum job_outcome outcome = how == ROOMS_CANCELLED ? JOB_OUT_CANCELLED
                               : how == ROOMS_FAILED  ? JOB_OUT_FAILED
                                                      : JOB_OUT_DONE;
    run->events->ended(run->user, outcome, how == ROOMS_FAILED ? "the fuzzer ended it" : NULL);
    free(run);
}

// ---- the carrier

static void want_write(struct connection *conn)
{
}

static void set_reading(struct connection *conn, bool on)
{
    ((struct pipe_end *)conn->carrier_data)->reading = on;
}

static void closed(struct connection *conn)
{
    ((struct pipe_end *)conn->carrier_data)->conn = NULL;
}

static size_t unsent(const struct connection *conn)
{
    return 0; // the pipe has no buffer of its own
}

static const struct carrier carrier = {"memory", want_write, set_reading, closed, unsent};

bool rooms_connect(struct pipe_end *end, const char *who)
{
    end->reading = true;
    end->conn = connection_open(&server, &carrier, end, "fuzz", who);
    return end->conn != NULL;
}

void rooms_stream(struct pipe_end *end, const void *bytes, size_t n)
{
    if (end->conn && !end->conn->closing) connection_bytes(end->conn, bytes, n, UINT64_MAX);
}

void rooms_message(struct pipe_end *end, const void *bytes, size_t n, size_t most)
{
    const char *at = bytes;
    while (end->conn && !end->conn->closing) {
        size_t part = n < most ? n : most;
        connection_part(end->conn, at, part, part == n);
        at += part;
        n -= part;
        if (!n) break;
    }
}

size_t rooms_output(struct pipe_end *end, uint8_t *out, size_t n)
{
    size_t have = 0;
    while (end->conn && have < n) {
        struct iovec iov[8];
        size_t before = have;
        int n_iov = connection_output(end->conn, iov, 8);
        for (int i = 0; i < n_iov && have < n; i++) {
            size_t take = iov[i].iov_len < n - have ? iov[i].iov_len : n - have;
            memcpy(out + have, iov[i].iov_base, take);
            have += take;
        }
        if (have == before) break;
        connection_written(end->conn, have - before);
    }
    return have;
}

void rooms_disconnect(struct pipe_end *end)
{
    if (end->conn) connection_close(end->conn, "closed by the fuzzer");
}

// ---- the server

static bool make_folders(const char *data)
{
    static const char *const name[] = {"", "blobs", "bakes", "models", "work", "previews"};
    char path[4096];
    snprintf(server.data, sizeof server.data, "%s", data);
    for (size_t i = 0; i < sizeof name / sizeof *name; i++) {
        snprintf(path, sizeof path, "%s/%s", data, name[i]);
        mkdir(path, 0700);
    }
    snprintf(path, sizeof path, "%s/blobs", data);
    struct blobs_setup setup = {.folder = path,
                                .max_blob = server.options.max_blob,
                                .ledger = server.ledger,
                                .work = server.work,
                                .keep_s = 600,
                                .idle_s = 0.05,
                                .wanted_s = 60};
    return !blobs_open(&setup, &server.blobs);
}

bool rooms_start(const struct rooms_settings *settings)
{
    char *argv[] = {"relightd", NULL};
    memset(&server, 0, sizeof server);
    options_parse(1, argv, &server.options);
    struct options *o = &server.options;
    o->requests = settings->requests;
    o->queue = settings->queue;
    o->bakes = settings->bakes;
    o->bake_queue = settings->bake_queue;
    o->cache = settings->cache;
    o->memory = settings->memory;
    o->disk = settings->disk;
    o->send_buffer = settings->send_buffer;
    o->client_poses = 3000; // some six of the fuzzer's model
    o->poses = 6000;
    o->idle = settings->idle_s;
    o->frame_time = settings->frame_time_s;
    const struct decoder_limits decoding = {o->decode_memory, o->decode_total, o->cache};
    log_set_level(LOG_ERR);
    server.n_core = settings->threads;
    drain_init(&server.drain, settings->threads);
    server.stats.start_ns = loop_now_ns();
    strcpy(server.run, "0123456789abcdef"); // messages.c names it
    char fault[256];
    if (!(server.ledger = ledger_create(o)) || events_create(64, &server.events) ||
        access_create(o, NULL, &server.access, fault) || loop_create(&server.loop) ||
        cache_create(o->cache, &server.cache) || cache_create(o->memory, &server.files) ||
        !(server.holds = holds_create()) ||
        decoder_create(server.loop, &decoding, &server.stats.children_crashed,
                       &server.decoder) ||
        work_pool_create(server.loop, settings->threads, prt_cpu_detect(), &server.work) ||
        !make_folders(settings->data) || jobs_create(&server, &runner, &server.jobs) ||
        poses_create(&server, &server.poses) || models_create(&server, &server.models) ||
        rooms_create(&server, &server.rooms))
        return false;
    cache_hold_files(server.cache, server.files);
    return true;
}

void rooms_stop(void)
{
    while (server.connections) connection_close(server.connections, "the fuzzer stops");
    connections_free_closed(&server);
    decoder_destroy(server.decoder);
    server.decoder = NULL;
    while (work_busy(server.work)) loop_turn(server.loop, 50);
    rooms_destroy(server.rooms);
    work_pool_destroy(server.work);
    models_destroy(server.models);
    cache_destroy(server.cache);
    poses_destroy(server.poses);
    cache_destroy(server.files);
    jobs_destroy(server.jobs);
    blobs_close(server.blobs);
    ledger_destroy(server.ledger);
    access_destroy(server.access);
    events_destroy(server.events);
    loop_destroy(server.loop);
    holds_destroy(server.holds);
}

void rooms_turn(int ms)
{
    loop_turn(server.loop, ms);
    connections_shed(&server);
    connections_free_closed(&server);
}

void rooms_expire(void)
{
    blobs_maintain(server.blobs);
}

bool rooms_working(void)
{
    return work_busy(server.work);
}

unsigned rooms_requests(void)
{
    return server.n_request;
}

unsigned rooms_long_requests(void)
{
    unsigned n = 0;
    for (const struct connection *c = server.connections; c; c = c->next)
        for (const struct request *r = c->requests; r; r = r->next)
            n += r->type == RELIGHT_TYPE_WATCH || r->type == RELIGHT_TYPE_VIEW_OPEN ||
                 r->type == RELIGHT_TYPE_SUBSCRIBE;
    return n;
}

// Moved vertices stay with their model, and who moved them pays on.
static uint64_t charged_for_models(void)
{
    uint64_t n = 0;
    for (struct model *m = NULL; (m = models_next(server.models, m));)
        n += m->pose ? m->pose->charged : 0;
    return n;
}

const char *rooms_leftover(void)
{
    static const enum ledger_resource of_clients[] = {LEDGER_CONNECTIONS,   LEDGER_REQUESTS,
                                                      LEDGER_LONG_REQUESTS, LEDGER_PAYLOAD,
                                                      LEDGER_OUTPUT,        LEDGER_JOBS};
    static char text[128];
    if (server.n_connection || server.connections || server.closed) return "a connection";
    if (server.n_request) return "a request";
    if (jobs_open(server.jobs)) return "a bake";
    // Shapes that are kept for reuse hold vertices that were moved before.
    if (ledger_total(server.ledger, LEDGER_PAYLOAD) != charged_for_models())
        cache_forget(server.cache, "", false);
    for (size_t i = 0; i < sizeof of_clients / sizeof *of_clients; i++) {
        uint64_t held = ledger_total(server.ledger, of_clients[i]);
        if (of_clients[i] == LEDGER_PAYLOAD) held -= charged_for_models();
        if (!held) continue;
        snprintf(text, sizeof text, "%llu of %s in the ledger", (unsigned long long)held,
                 ledger_name(of_clients[i]));
        return text;
    }
    return NULL;
}
