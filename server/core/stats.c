// SPDX-License-Identifier: MIT
// The list of metrics, for STATS and for GET /metrics.
#include "core/stats.h"

#include "store/disk.h"
#include "store/eviction.h"
#include "frame.h"
#include "core/log.h"
#include "core/server.h"
#include "store/disk.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const double bucket_s[STATS_N_BUCKET] = {0.0005, 0.001, 0.002, 0.005, 0.01, 0.02,
                                                0.05,   0.1,   0.5,   2,     10};

void stats_latency(struct stats *stats, unsigned type, double seconds)
{
    if (type >= STATS_N_TYPE) return;
    struct stats_histogram *h = &stats->latency[type];
    unsigned i = 0;
    while (i < STATS_N_BUCKET && seconds > bucket_s[i]) i++;
    h->bucket[i]++;
    h->count++;
    h->sum_s += seconds;
}

static void each_type(const struct stats *s, stats_fn fn, void *user)
{
    char label[80];
    for (unsigned t = 1; t < STATS_N_TYPE; t++) {
        if (!s->requests_total[t]) continue;
        snprintf(label, sizeof label, "type=\"%s\"", relight_type_name((uint16_t)t));
        fn(user, "relightd_requests_total", label, (double)s->requests_total[t],
           "requests by type", "counter");
    }
    for (unsigned t = 1; t < STATS_N_TYPE; t++) {
        const struct stats_histogram *h = &s->latency[t];
        const char *name = relight_type_name((uint16_t)t);
        uint64_t sum = 0;
        if (!h->count) continue;
        for (unsigned i = 0; i <= STATS_N_BUCKET; i++) {
            sum += h->bucket[i];
            if (i < STATS_N_BUCKET)
                snprintf(label, sizeof label, "type=\"%s\",le=\"%g\"", name, bucket_s[i]);
            else snprintf(label, sizeof label, "type=\"%s\",le=\"+Inf\"", name);
            fn(user, "relightd_request_seconds_bucket", label, (double)sum,
               "time from a request's frame to its last answer", "histogram");
        }
        snprintf(label, sizeof label, "type=\"%s\"", name);
        fn(user, "relightd_request_seconds_sum", label, h->sum_s, "", "");
        fn(user, "relightd_request_seconds_count", label, (double)h->count, "", "");
    }
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
    G("models_bytes", files.bytes, "bytes of open transport files");
    G("models_open", files.entries, "open transport files");
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
    C("deadline", s->deadline_total, "requests whose deadline passed");
    C("bytes_in", s->bytes_in, "bytes received");
    C("bytes_out", s->bytes_out, "bytes sent");
    C("bakes_done", s->bakes_done, "bakes finished");
    C("bakes_failed", s->bakes_failed, "bakes that failed");
    C("bakes_cancelled", s->bakes_cancelled, "bakes cancelled");
    C("bakes_cached", s->bakes_cached, "loads that found their bake on disk");
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
    char *bucket = strstr(family, "_seconds_bucket");
    if (bucket) bucket[8] = 0;
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
