// SPDX-License-Identifier: MIT
// A private relightd for benchmarks: on a unix socket and a TCP port, in a temporary folder.
#ifndef PRT_BENCH_DAEMON_H
#define PRT_BENCH_DAEMON_H

#include "bench.h"

#include <sys/types.h>

struct bench_daemon {
    char folder[32];      // removed at the end
    char address[2][128]; // unix:…, tcp:…
    char model[64];       // a name it answers to
    pid_t pid;
};
// Starts the relightd beside prt-bench, or the one on PATH, on a folder that holds env->file
// or, without one, a made-up transport of bunny's size. Everything that was started is stopped
// on failure.
int bench_daemon_start(struct bench_env *env, struct bench_daemon *out);
// The same with more options of relightd (NULL-terminated, may be NULL) and, where n_model is
// not 0, with that many made-up models "model-0", "model-1", … of bunny's size instead.
int bench_daemon_start_with(struct bench_env *env, const char *const extra[], unsigned n_model,
                            struct bench_daemon *out);
void bench_daemon_stop(struct bench_daemon *daemon);
double bench_daemon_cpu_s(const struct bench_daemon *daemon);   // CPU time; NAN: unknown
double bench_daemon_rss_kib(const struct bench_daemon *daemon); // resident memory; NAN

// A sky, a sun and noise as a lat-long image file of 1024x512, similar to a camera's HDR.
// Every number gives another file. format: "hdr", "exr" or "png".
int bench_env_file(const struct prt_context *ctx, const char *format, uint32_t number,
                   struct prt_blob *out);

#endif
