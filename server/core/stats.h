/* SPDX-License-Identifier: MIT */
/* stats.h owns the daemon's counters: read by STATS and by GET /metrics. Loop thread only. */
#ifndef RELIGHTD_STATS_H
#define RELIGHTD_STATS_H

#include "frame.h"

#include <stddef.h>
#include <stdint.h>

struct server;
enum {
    STATS_N_TYPE = RELIGHT_TYPE_N,
    STATS_N_BUCKET = 11,
    STATS_OK = 0,    /* outcomes of requests; from 1 on, the protocol's error codes */
    STATS_GONE = 30, /* the client left before the answer */
    STATS_N_OUTCOME,
    STATS_N_CARRIER = 8,
};

/* Counts of values at most as large as each bound of a list, and beyond the last. */
struct stats_histogram {
    uint64_t bucket[STATS_N_BUCKET + 1];
    uint64_t count;
    double sum;
};

struct stats {
    uint64_t start_ns;
    uint64_t connections_total, connections_refused, frames_bad;
    uint64_t requests_total[STATS_N_TYPE][STATS_N_OUTCOME]; /* ended, by type and outcome */
    struct {
        const char *name; /* NULL: the list ends */
        unsigned open;
        uint64_t total;
    } carrier[STATS_N_CARRIER];
    unsigned views_open;
    uint64_t errors_total, busy_total, cancelled_total, deadline_total;
    uint64_t late_refused_total; /* BUSY, as the answer would come after the deadline */
    uint64_t bytes_in, bytes_out;
    uint64_t bakes_done, bakes_failed, bakes_cancelled, bakes_cached, bakes_evicted;
    uint64_t children_crashed; /* decoders and bakes ended by a signal that the daemon did not
                                  send */
    uint64_t passes, relights,
        shared;               /* transport passes; evaluations by them; those that shared one */
    uint64_t items_withdrawn; /* evaluations that left the queue of a pass */
    uint64_t contractions,
        edits; /* joint transport: contractions with a light, evaluations using them */
    uint64_t materials_fixed,
        fixed_used; /* joint transport: contractions with a material, evaluations using them */
    uint64_t frames_sent, frames_dropped, frames_reduced;
    float finish_ns_a_pixel; /* shading and encoding a picture: running mean */
    /* By request type, in seconds: from the frame to the last answer; before computing; of
     * computing. A view's are those of its frames. */
    struct stats_histogram latency[STATS_N_TYPE], queue[STATS_N_TYPE], compute[STATS_N_TYPE];
    struct stats_histogram batch; /* evaluations in one pass over transport */
};

/* A request ended. outcome: STATS_OK, an error code, or STATS_GONE. */
void stats_ended(struct stats *stats, unsigned type, int outcome, double seconds);
/* The outcome's word: "ok", "busy", "gone". */
void stats_outcome(int outcome, char out[40]);
/* How long a request's work waited for a worker or for others, and how long it took. */
void stats_work(struct stats *stats, unsigned type, double queue_s, double compute_s);
void stats_batch(struct stats *stats, unsigned n);
/* A connection of this carrier was opened (1) or closed (-1); the name is kept. */
void stats_connection(struct stats *stats, const char *carrier, int change);

typedef void (*stats_fn)(void *user, const char *name, const char *labels, double value,
                         const char *help, const char *kind);
/* Calls fn for every metric; labels is "" or `type="colors"`. */
void stats_each(const struct server *server, stats_fn fn, void *user);
/* The Prometheus text format, malloc()ed. */
char *stats_prometheus(const struct server *server, size_t *n);

#endif
