// SPDX-License-Identifier: MIT
// Closed loops of requests: each client keeps `depth` of them open. For `prt-bench serve`.
#ifndef PRT_BENCH_SERVE_FLOW_H
#define PRT_BENCH_SERVE_FLOW_H

#include "serve_client.h"

struct serve_flow {
    void (*send)(struct serve_flow *flow, struct serve_client *client);
    unsigned depth;    // open requests of a client, at most SERVE_DEPTH
    const char *model; // for serve_send_colors
    const char *env;   // its light
    float step_deg;    // turn of the light from one request to the next
    bool same_light;   // every client's n-th request has the same light, else each its own
    uint32_t deadline_ms;
    // results of serve_run
    bool stopping, counting;
    unsigned n_answer, n_busy, n_late, n_other; // n_late: ERROR_DEADLINE; n_other: other errors
    unsigned n_over;                            // answers after the deadline, by our clock
    double seconds, bytes, worst_over_ms; // worst_over_ms: after the deadline, of an answer
    float *ms;                            // of each answer, ascending
    unsigned n_ms, room;
    char error[160]; // of the first other error
};

// Runs the loop for warm_s, then counts for `seconds`, then waits for the answers still open.
int serve_run(struct serve_crowd *crowd, struct serve_flow *flow, double warm_s,
              double seconds);
// Counts one answer; a crowd's callback where its user is a struct serve_flow.
void serve_count(struct serve_client *client, const struct relight_frame *frame);
// Counts one answer of this time and length; serve_order() before the first quantile.
void serve_keep(struct serve_flow *flow, double ms, double bytes);
void serve_order(struct serve_flow *flow);
void serve_flow_finish(struct serve_flow *flow);
double serve_rate(const struct serve_flow *flow);                  // answers/s
double serve_quantile(const struct serve_flow *flow, double part); // ms

// One request of its kind, with the next light of the client.
void serve_send_ping(struct serve_flow *flow, struct serve_client *client);
void serve_send_colors(struct serve_flow *flow, struct serve_client *client); // RGB9E5
void serve_send_jpeg(struct serve_flow *flow, struct serve_client *client);   // 800x600

// Uploads a made-up environment; word: how lights name it.
int serve_upload_env(struct bench_env *env, const struct bench_daemon *daemon, char word[80]);

// A counter or gauge of the daemon, summed over its labels; 0 where it has none.
int serve_metric(struct bench_env *env, const struct bench_daemon *daemon, const char *name,
                 double *value);
// The index of the median of x[n].
int serve_median(int n, const double *x);

// Ends the JSON line with the goal: at least (or at most) it.
void serve_goal_least(const char *key, double value, double goal);
void serve_goal_most(const char *key, double value, double goal);

#endif
