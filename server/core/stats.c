// SPDX-License-Identifier: MIT
// The list of metrics, for STATS and for GET /metrics.
#include "core/stats.h"

#include "store/disk.h"
#include "store/eviction.h"
#include "frame.h"
#include "core/log.h"
#include "core/server.h"
#include "relight.pb-c.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double bound_s[STATS_N_BUCKET] = {0.0005, 0.001, 0.002, 0.005, 0.01, 0.02,
                                               0.05,   0.1,   0.5,   2,     10};
static const double bound_batch[STATS_N_BUCKET] = {1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16};

static void observe(struct stats_histogram *h, const double bound[STATS_N_BUCKET], double x)
{
    unsigned i = 0;
    while (i < STATS_N_BUCKET && x > bound[i]) i++;
    h->bucket[i]++;
    h->count++;
    h->sum += x;
}

void stats_ended(struct stats *stats, unsigned type, int outcome, double seconds)
{
    if (type >= STATS_N_TYPE) return;
    if (outcome < 0 || outcome >= STATS_N_OUTCOME) outcome = STATS_GONE;
    stats->requests_total[type][outcome]++;
    observe(&stats->latency[type], bound_s, seconds);
}

void stats_work(struct stats *stats, unsigned type, double queue_s, double compute_s)
{
    if (type >= STATS_N_TYPE) return;
    observe(&stats->queue[type], bound_s, queue_s > 0 ? queue_s : 0);
    observe(&stats->compute[type], bound_s, compute_s > 0 ? compute_s : 0);
}

void stats_batch(struct stats *stats, unsigned n)
{
    observe(&stats->batch, bound_batch, n);
}

void stats_connection(struct stats *stats, const char *carrier, int change)
{
    unsigned i = 0;
    while (i + 1 < STATS_N_CARRIER && stats->carrier[i].name &&
           strcmp(stats->carrier[i].name, carrier))
        i++;
    stats->carrier[i].name = carrier;
    stats->carrier[i].open = (unsigned)((int)stats->carrier[i].open + change);
    if (change > 0) stats->carrier[i].total++;
}

static void lower(const char *name, char out[40])
{
    size_t n = 0;
    for (; name[n] && n < 39; n++) out[n] = (char)tolower((unsigned char)name[n]);
    out[n] = 0;
}

void stats_outcome(int outcome, char out[40])
{
    const ProtobufCEnumValue *v =
        protobuf_c_enum_descriptor_get_value(&relight__error_code__descriptor, outcome);
    const char *name = outcome == STATS_OK     ? "ok"
                       : outcome == STATS_GONE ? "gone"
                       : v                     ? v->name + strlen("ERROR_")
                                               : "other";
    lower(name, out);
}

static void each_request(const struct stats *s, stats_fn fn, void *user)
{
    char label[120], type[40], word[40];
    for (unsigned t = 1; t < STATS_N_TYPE; t++)
        for (int o = 0; o < STATS_N_OUTCOME; o++) {
            if (!s->requests_total[t][o]) continue;
            stats_outcome(o, word);
            lower(relight_type_name((uint16_t)t), type);
            snprintf(label, sizeof label, "operation=\"%s\",outcome=\"%s\"", type, word);
            fn(user, "relightd_requests_total", label, (double)s->requests_total[t][o],
               "requests that ended, by operation and outcome", "counter");
        }
}

// One histogram; label: "" or `operation="image",`.
static void histogram(const char *name, const char *label, const struct stats_histogram *h,
                      const double bound[STATS_N_BUCKET], const char *help, stats_fn fn,
                      void *user)
{
    char full[80], labels[120];
    uint64_t sum = 0;
    snprintf(full, sizeof full, "%s_bucket", name);
    for (unsigned i = 0; i <= STATS_N_BUCKET; i++) {
        sum += h->bucket[i];
        if (i < STATS_N_BUCKET) snprintf(labels, sizeof labels, "%sle=\"%g\"", label, bound[i]);
        else snprintf(labels, sizeof labels, "%sle=\"+Inf\"", label);
        fn(user, full, labels, (double)sum, help, "histogram");
    }
    snprintf(labels, sizeof labels, "%.*s", *label ? (int)strlen(label) - 1 : 0, label);
    snprintf(full, sizeof full, "%s_sum", name);
    fn(user, full, labels, h->sum, "", "");
    snprintf(full, sizeof full, "%s_count", name);
    fn(user, full, labels, (double)h->count, "", "");
}

static void each_histogram(const char *name, const struct stats_histogram h[STATS_N_TYPE],
                           const char *help, stats_fn fn, void *user)
{
    char label[80], type[40];
    for (unsigned t = 1; t < STATS_N_TYPE; t++) {
        if (!h[t].count) continue;
        lower(relight_type_name((uint16_t)t), type);
        snprintf(label, sizeof label, "operation=\"%s\",", type);
        histogram(name, label, &h[t], bound_s, help, fn, user);
    }
}

static void each_type(const struct stats *s, stats_fn fn, void *user)
{
    each_request(s, fn, user);
    each_histogram("relightd_request_seconds", s->latency,
                   "time from a request's frame to its last answer", fn, user);
    each_histogram("relightd_queue_seconds", s->queue,
                   "time that the work of a request waited, of a view that of each frame", fn,
                   user);
    each_histogram("relightd_compute_seconds", s->compute,
                   "time that the work of a request took, of a view that of each frame", fn,
                   user);
    histogram("relightd_batch_size", "", &s->batch, bound_batch,
              "evaluations that one pass over transport answered", fn, user);
}

static void each_carrier(const struct stats *s, stats_fn fn, void *user)
{
    char label[40];
    for (int total = 0; total < 2; total++)
        for (int i = 0; i < STATS_N_CARRIER && s->carrier[i].name; i++) {
            snprintf(label, sizeof label, "carrier=\"%s\"", s->carrier[i].name);
            if (total)
                fn(user, "relightd_carrier_connections_total", label,
                   (double)s->carrier[i].total, "connections accepted, by carrier", "counter");
            else
                fn(user, "relightd_carrier_connections", label, s->carrier[i].open,
                   "open connections by carrier; HTTP counts requests of the API", "gauge");
        }
}

static void each_bake(const struct stats *s, stats_fn fn, void *user)
{
    const struct {
        const char *label;
        uint64_t n;
    } bakes[] = {{"outcome=\"done\"", s->bakes_done},
                 {"outcome=\"failed\"", s->bakes_failed},
                 {"outcome=\"cancelled\"", s->bakes_cancelled},
                 {"outcome=\"cached\"", s->bakes_cached}};
    for (int i = 0; i < 4; i++)
        fn(user, "relightd_bakes_total", bakes[i].label, (double)bakes[i].n,
           "bakes by outcome; cached: the bake was on disk already", "counter");
}

static void each_resource(const struct ledger *ledger, stats_fn fn, void *user)
{
    char label[80];
    for (int limit = 0; limit < 2; limit++)
        for (int i = 0; i < LEDGER_N; i++) {
            enum ledger_resource resource = (enum ledger_resource)i;
            snprintf(label, sizeof label, "resource=\"%s\"", ledger_name(resource));
            if (limit)
                fn(user, "relightd_resource_limit", label,
                   (double)ledger_limit_all(ledger, resource),
                   "limit of all clients together, 0 for no limit", "gauge");
            else
                fn(user, "relightd_resource_held", label,
                   (double)ledger_total(ledger, resource), "held by all clients together",
                   "gauge");
        }
}

static unsigned principals(const struct ledger *ledger)
{
    unsigned n = 0;
    for (const struct principal *p = ledger_first(ledger); p; p = p->next) n++;
    return n;
}

void stats_each(const struct server *server, stats_fn fn, void *user)
{
    const struct stats *s = &server->stats;
    struct cache_counts cache, files;
    cache_count(server->cache, &cache);
    cache_count(server->files, &files);
#define G(name, value, help) fn(user, "relightd_" name, "", (double)(value), help, "gauge")
#define C(name, value, help) \
    fn(user, "relightd_" name "_total", "", (double)(value), help, "counter")
    G("uptime_seconds", (double)(loop_now_ns() - s->start_ns) * 1e-9,
      "seconds since the start");
    G("draining", server->draining, "1 after SIGTERM");
    G("connections", server->n_connection, "open connections");
    G("requests_open", server->n_request, "requests not answered yet");
    G("work_waiting", work_waiting(server->work), "jobs that wait for a worker thread");
    struct work_counts work;
    work_count(server->work, "", &work);
    C("work_seconds", (double)work.all_ns * 1e-9, "thread-seconds of all jobs");
    C("work_withdrawn", work.withdrawn + s->items_withdrawn,
      "jobs that left a queue because nobody waited for them any more");
    C("view_reduced", s->frames_reduced, "frames of views at a lower resolution, to keep up");
    G("models_bytes", files.bytes, "bytes of open transport files");
    G("models_open", files.entries, "open transport files");
    G("models_limit_bytes", server->options.memory,
      "limit of relightd_models_bytes (--memory)");
    G("cache_limit_bytes", server->options.cache, "limit of relightd_cache_bytes (--cache)");
    G("bakes_limit_bytes", server->options.bakes_disk,
      "limit of relightd_bakes_bytes (--bakes-disk)");
    G("principals", principals(server->ledger), "clients that are connected or hold something");
    G("views_open", s->views_open, "open views");
    G("cache_bytes", cache.bytes, "bytes of shared results");
    G("cache_entries", cache.entries, "shared results");
    G("disk_bytes", disk_bytes(server->ledger),
      "bytes of uploads, previews, copies of --models and bakes");
    G("bakes_bytes", bakes_bytes(server), "bytes of bakes alone");
    G("jobs_open", jobs_open(server->jobs), "bakes that wait or run");
    G("jobs_running", jobs_running(server->jobs), "bakes that run");
    C("connections", s->connections_total, "connections accepted");
    C("connections_refused", s->connections_refused, "connections refused at the limit");
    C("frames_bad", s->frames_bad, "frames that broke the protocol");
    C("errors", s->errors_total, "error answers");
    C("busy", s->busy_total, "requests answered busy");
    C("cancelled", s->cancelled_total, "requests cancelled by clients");
    C("late_refused", s->late_refused_total,
      "requests that were refused as their answer would have come after the deadline");
    C("deadline", s->deadline_total, "requests whose deadline passed");
    C("bytes_in", s->bytes_in, "bytes received");
    C("bytes_out", s->bytes_out, "bytes sent");
    C("bakes_evicted", s->bakes_evicted, "bakes deleted to free disk space");
    C("children_crashed", s->children_crashed,
      "decoders and bakes ended by a signal, cancelled bakes excluded");
    C("passes", s->passes, "passes over transport");
    C("relights", s->relights, "evaluations computed by passes");
    C("relights_shared", s->shared, "evaluations that shared a pass");
    C("lights_contracted", s->contractions, "contractions of joint transport with a light");
    C("edits", s->edits, "evaluations that used a contracted light");
    C("materials_fixed", s->materials_fixed, "contractions of joint transport with a material");
    C("relights_fixed", s->fixed_used, "evaluations that used a contracted material");
    C("cache_hits", cache.hits, "shared results found in the cache");
    C("cache_misses", cache.misses, "shared results computed");
    C("cache_evictions", cache.evictions, "shared results evicted");
    C("models_evictions", files.evictions, "models unloaded to free memory");
    C("view_frames", s->frames_sent, "frames sent to views");
    C("view_overtaken", s->frames_dropped,
      "view states replaced by a newer one before they were drawn");
#undef G
#undef C
    each_bake(s, fn, user);
    each_carrier(s, fn, user);
    each_resource(server->ledger, fn, user);
    each_type(s, fn, user);
}

struct text {
    FILE *file;
    char last[80];
};

static void print_metric(void *user, const char *name, const char *labels, double value,
                         const char *help, const char *kind)
{
    struct text *t = user;
    char family[80];
    snprintf(family, sizeof family, "%s", name);
    char *bucket = strcmp(kind, "histogram") ? NULL : strstr(family, "_bucket");
    if (bucket) *bucket = 0;
    if (kind[0] && strcmp(t->last, family)) {
        fprintf(t->file, "# HELP %s %s\n# TYPE %s %s\n", family, help, family, kind);
        snprintf(t->last, sizeof t->last, "%s", family);
    }
    fprintf(t->file, labels[0] ? "%s{%s} %.17g\n" : "%s%s %.17g\n", name, labels, value);
}

char *stats_prometheus(const struct server *server, size_t *n)
{
    char *bytes = NULL;
    struct text t = {.file = open_memstream(&bytes, n)};
    if (!t.file) return NULL;
    stats_each(server, print_metric, &t);
    fclose(t.file);
    return bytes;
}
