// SPDX-License-Identifier: MIT
// The daemon's cost of a frame of coefficients in the packed format, which the page asks for:
// the contraction and the rounding.
#include "bench.h"
#include "prt/relight.h"

#include <math.h>
#include <string.h>

enum { MOST = PRT_RELIGHT_MAX_LIGHTS };

struct job {
    struct bench_env *env;
    const struct prt_transport *transport;
    struct prt_query query[MOST];
    struct prt_coefficients rows[MOST], *out[MOST];
};

struct turn {
    struct job *job;
    unsigned n_light;
};

static int run_turn(void *arg)
{
    const struct turn *turn = arg;
    struct job *job = turn->job;
    return prt_answer_coefficients(&job->env->ctx, job->transport, turn->n_light, job->query,
                                   job->out);
}

// The i-th light: a made-up one, or the --env in turn, each time turned further.
static int light_cube(struct bench_env *env, uint32_t n, unsigned i, struct prt_cube *out)
{
    struct prt_env *light;
    if (!env->n_light) return bench_cube(n, env->seed + i, out);
    int status = prt_env_load(&env->ctx, env->light[i % env->n_light], &light);
    if (status) return status;
    status = prt_env_to_cube(&env->ctx, light, n, 20.0 * i, out);
    prt_env_destroy(light);
    return status;
}

static int prepare(struct bench_env *env, struct job *job, struct prt_cube cube[MOST])
{
    int status = PRT_OK;
    for (unsigned i = 0; i < MOST && !status; i++) {
        job->out[i] = &job->rows[i];
        status = light_cube(env, job->transport->cube, i, &cube[i]);
        job->query[i] = (struct prt_query){.term = PRT_ANSWER_TOTAL, .light = &cube[i]};
        job->rows[i].packed = true;
        if (!status)
            status =
                prt_coefficients_plan(&env->ctx, job->transport, &job->query[i], job->out[i]);
        job->rows[i].half = prt_alloc(job->rows[i].n_half + 1, sizeof(uint16_t));
        if (!job->rows[i].half) status = PRT_NOMEM;
    }
    return status;
}

// One light, and several in one pass, in turns. by_rows: the file has no columns yet, as models
// in relightd that few lights were asked of.
static int frames(struct bench_env *env, const struct prt_transport *t, bool by_rows)
{
    static const char *const label[] = {"coefficients", "coefficients_2", "coefficients_4",
                                        "coefficients_8", "coefficients_16"};
    static const char *const rows[] = {"coefficients_rows", "coefficients_rows_2",
                                       "coefficients_rows_4", "coefficients_rows_8",
                                       "coefficients_rows_16"};
    struct job job = {.env = env, .transport = t};
    struct turn turn[] = {{&job, 1}, {&job, 2}, {&job, 4}, {&job, 8}, {&job, 16}};
    struct prt_cube cube[MOST] = {0};
    int status = prepare(env, &job, cube);
    for (size_t i = 0; i < sizeof turn / sizeof *turn && !status; i++) {
        void *const turns[2] = {&turn[0], &turn[i]};
        struct bench_time time[2];
        status = bench_compare(env, run_turn, turns, time);
        if (status) break;
        bench_begin(env, by_rows ? rows[i] : label[i]);
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("lights", turn[i].n_light);
        bench_number("bytes_a_frame", 2.0 * (double)job.rows[0].n_half);
        bench_number("ms", 1e3 * time[1].best);
        bench_number("ms_a_frame", 1e3 * time[1].best / turn[i].n_light);
        bench_number("ms_a_frame_median", 1e3 * time[1].median / turn[i].n_light);
        bench_number("target_ms_a_frame", 1);
        bench_end();
    }
    for (unsigned i = 0; i < MOST; i++) {
        prt_cube_finish(&cube[i]);
        prt_free(job.rows[i].half);
    }
    return status;
}

// Colours under the first light.
static int first_colors(struct bench_env *env, const struct prt_transport *t, float (*out)[3])
{
    struct prt_cube cube = {0};
    int status = light_cube(env, t->cube, 0, &cube);
    const struct prt_query query = {.term = PRT_ANSWER_TOTAL, .light = &cube};
    if (!status) status = prt_answer_colors(&env->ctx, t, &query, out);
    prt_cube_finish(&cube);
    return status;
}

static double relative_rms(const float (*got)[3], const float (*want)[3], size_t n)
{
    double off = 0, all = 0;
    for (size_t i = 0; i < 3 * n; i++) {
        const double a = (double)got[i / 3][i % 3], b = (double)want[i / 3][i % 3];
        off += (a - b) * (a - b);
        all += b * b;
    }
    return sqrt(off / all);
}

// What columns leave out of the colours, METHODS §3.4.
static int make_columns(struct bench_env *env, struct prt_file *f)
{
    const struct prt_transport *t = prt_file_transport(f);
    const size_t n = t->mesh.n_vertex;
    float(*rows)[3] = prt_alloc(n, sizeof *rows), (*columns)[3] = prt_alloc(n, sizeof *columns);
    int status = rows && columns ? first_colors(env, t, rows) : PRT_NOMEM;
    const double start = prt_time_s();
    if (!status) status = prt_file_columns(&env->ctx, f);
    const double took = prt_time_s() - start;
    if (!status) status = first_colors(env, prt_file_transport(f), columns);
    if (!status) {
        bench_begin(env, "coefficients_columns");
        bench_number("ms_to_make", 1e3 * took);
        bench_number("file_bytes", (double)prt_file_bytes(f));
        bench_number("bytes", (double)(prt_file_memory(f) - prt_file_bytes(f)));
        bench_number("left_out_rms",
                     relative_rms((const float(*)[3])columns, (const float(*)[3])rows, n));
        bench_end();
    }
    prt_free(rows);
    prt_free(columns);
    return status;
}

static int coefficients(struct bench_env *env)
{
    struct prt_file *f;
    if (!env->file) return PRT_OK;
    int status = prt_file_read(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    status = frames(env, prt_file_transport(f), true);
    if (!status) status = make_columns(env, f);
    if (!status) status = frames(env, prt_file_transport(f), false);
    prt_file_close(f);
    return status;
}

BENCH(coefficients,
      "Frames of coefficients of a wavelet --file, by rows and by columns, under "
      "--env or made-up lights; --threads 1: of one core",
      coefficients)
