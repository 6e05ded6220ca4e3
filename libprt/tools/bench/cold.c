// SPDX-License-Identifier: MIT
// Cold start: from a path to a transport that can be relit, page cache warm.
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bench.h"
#include "synthetic.h"

struct job {
    struct bench_env *env;
    const char *path;
    enum prt_file_check check;
    uint64_t bytes;
    uint32_t n_vertex;
};

static int open_once(void *arg)
{
    struct job *job = arg;
    struct prt_file *file;
    int status = prt_file_open(&job->env->ctx, job->path, job->check, &file);
    if (status) return status;
    job->bytes = prt_file_bytes(file);
    job->n_vertex = prt_file_transport(file)->mesh.n_vertex;
    prt_file_close(file);
    return PRT_OK;
}

static int run(struct bench_env *env)
{
    char temp[] = "/tmp/prt-bench-XXXXXX";
    struct job job = {.env = env, .path = env->file};
    struct bench_time time;
    int status = PRT_OK;
    if (!env->file) {
        int fd = mkstemp(temp);
        if (fd < 0) return prt_fail(&env->ctx, PRT_IO, "no temporary file");
        close(fd);
        job.path = temp;
        status = synthetic_bunny(&env->ctx, temp, false, env->seed);
    }
    for (int check = 0; check < 2 && !status; check++) {
        job.check = check ? PRT_FILE_CHECK_ALL : PRT_FILE_CHECK_HEADERS;
        if ((status = bench_measure(env, open_once, &job, &time))) break;
        bench_begin(env, "cold_start");
        bench_text("file", env->file ? env->file : "made up");
        bench_text("check", check ? "structure and checksums" : "structure");
        bench_number("vertices", job.n_vertex);
        bench_number("bytes", (double)job.bytes);
        bench_number("ms", 1e3 * time.best);
        bench_number("ms_median", 1e3 * time.median);
        bench_number("target_ms", 50);
        bench_end();
    }
    if (!env->file) unlink(temp);
    return status;
}

BENCH(cold_start, "Opening a .prt until it can be relit", run)
