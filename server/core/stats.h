/* SPDX-License-Identifier: MIT */
/* stats.h owns the daemon's counters: read by STATS and by GET /metrics. Loop thread only. */
#ifndef RELIGHTD_STATS_H
#define RELIGHTD_STATS_H

#include "frame.h"

#include <stddef.h>
#include <stdint.h>

struct server;
enum { STATS_N_TYPE = RELIGHT_TYPE_N, STATS_N_BUCKET = 11 };

struct stats_histogram {
    uint64_t bucket[STATS_N_BUCKET + 1];
    uint64_t count;
    double sum_s;
};

struct stats {
    uint64_t start_ns;
    uint64_t connections_total, connections_refused, frames_bad;
    uint64_t requests_total[STATS_N_TYPE]; /* by request type */
    uint64_t errors_total, busy_total, cancelled_total, deadline_total;
    uint64_t bytes_in, bytes_out;
    uint64_t bakes_done, bakes_failed, bakes_cancelled, bakes_cached, bakes_evicted;
    uint64_t children_crashed; /* decoders and bakes ended by a signal that the daemon did not
                                  send */
    uint64_t passes, relights,
        shared; /* transport passes; evaluations by them; those that shared one */
    uint64_t contractions,
        edits; /* joint transport: contractions with a light, evaluations using them */
    uint64_t materials_fixed,
        fixed_used; /* joint transport: contractions with a material, evaluations using them */
    uint64_t frames_sent, frames_dropped;
    float finish_ns_a_pixel; /* shading and encoding a picture: running mean */
    struct stats_histogram latency[STATS_N_TYPE];
};

void stats_latency(struct stats *stats, unsigned type, double seconds);

typedef void (*stats_fn)(void *user, const char *name, const char *labels, double value,
                         const char *help, const char *kind);
/* Calls fn for every metric; labels is "" or `type="colors"`. */
void stats_each(const struct server *server, stats_fn fn, void *user);
/* The Prometheus text format, malloc()ed. */
char *stats_prometheus(const struct server *server, size_t *n);

#endif
