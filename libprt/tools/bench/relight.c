// SPDX-License-Identifier: MIT
// Relighting: from decoded cubemaps to colours in file order.
#include "prt/relight.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "bench.h"
#include "subdivide.h"
#include "synthetic.h"

struct job {
    struct bench_env *env;
    const struct prt_tensor *tensor;
    struct prt_cube cube[8];
    struct prt_light light[8];
    unsigned n_light;
    const float *coef;
    float *color;
    struct bench_span span[BENCH_SPANS]; // of the tensor
    unsigned n_span;
    double bytes;     // in them
    double rms, most; // of from_floats
};

static int transform(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *job = arg;
    int status = PRT_OK;
    for (size_t i = begin; i < end && !status; i++)
        status = prt_light_from_cube(&job->cube[i], &job->light[i]);
    return status;
}

static int relight_cubes(void *arg)
{
    struct job *job = arg;
    const struct prt_light *lights[8];
    memset(job->light, 0, sizeof job->light);
    for (unsigned i = 0; i < 8; i++) lights[i] = &job->light[i];
    int status = prt_parallel_for(&job->env->ctx, NULL, job->n_light, 1, transform, job);
    if (!status)
        status = prt_relight(&job->env->ctx, job->tensor, job->n_light, lights, job->coef,
                             false, job->color);
    for (unsigned i = 0; i < job->n_light; i++) prt_light_finish(&job->light[i]);
    return status;
}

static void print(struct job *job, const char *name, unsigned n_light, double bandwidth,
                  const struct bench_time *time, const struct bench_time *one)
{
    const struct prt_tensor *t = job->tensor;
    uint64_t u_bytes, row_bytes;
    prt_tensor_bytes(t, &u_bytes, &row_bytes);
    double read = (double)(u_bytes + row_bytes) + 4.0 * t->n_vertex;
    double written = 12.0 * t->n_vertex * t->n_phase * n_light;
    bench_begin(job->env, name);
    bench_number("vertices", t->n_vertex);
    bench_number("rows", t->rows.n_row);
    bench_number("entries_per_row",
                 t->rows.n_row ? (double)t->rows.begin[t->rows.n_row] / t->rows.n_row : 0);
    bench_number("phase_terms", t->n_phase);
    bench_number("functions", t->n_function);
    bench_number("lights", n_light);
    bench_number("ms", 1e3 * time->best);
    bench_number("ms_median", 1e3 * time->median);
    bench_number("ms_per_light", 1e3 * time->best / n_light);
    bench_number("Mvertices_per_s", 1e-6 * t->n_vertex * n_light / time->best);
    bench_number("GB_per_s_read", 1e-9 * read / time->best);
    bench_number("GB_per_s_read_and_written", 1e-9 * (read + written) / time->best);
    if (bandwidth > 0) {
        bench_number("GB_per_s_plain_read", 1e-9 * bandwidth);
        bench_number("of_plain_read", read / time->best / bandwidth);
        bench_number("of_plain_read_with_writes", (read + written) / time->best / bandwidth);
    }
    if (one) {
        bench_number("times_one", time->best / one->best);
        bench_number("times_one_median", time->median / one->median);
        bench_number("target_times_one", n_light > 1 ? 3 : 4.5);
    }
    if (n_light > 1) {
        bench_number("from_floats_rms", job->rms);
        bench_number("from_floats_most", job->most);
    }
    if (n_light == 1 && t->n_phase == 1 && t->coupling == PRT_COUPLE_DIAGONAL) {
        if (t->storage == PRT_STORAGE_SPARSE) {
            bench_number("target_Mvertices_per_s", 30);
            bench_number("target_of_plain_read", 0.5);
        } else if (t->storage == PRT_STORAGE_FACTORED && t->n_vertex >= 500000) {
            bench_number("target_Mvertices_per_s", 100);
        } else if (t->storage == PRT_STORAGE_FACTORED) {
            bench_number("target_ms", 2);
        }
    }
    bench_end();
}

// So many lights of a job; none: its bytes are read.
struct turn {
    struct job *job;
    unsigned n_light;
};

static int relight_turn(void *arg)
{
    const struct turn *turn = arg;
    struct job *job = turn->job;
    job->n_light = turn->n_light;
    if (job->n_light) return relight_cubes(job);
    job->bytes = bench_read(job->env, job->span, job->n_span);
    return PRT_OK;
}

// How far the eight lights' colours, which are in job->color, are from each light's in f32: the
// largest RMS difference of a light, and the largest one of all over its light's largest
// colour.
static int from_floats(struct job *job, double *rms, double *most)
{
    const size_t n = 3ull * job->tensor->n_vertex * job->tensor->n_phase;
    struct prt_context ctx = job->env->ctx;
    float *alone = prt_alloc(n, sizeof *alone);
    int status = alone ? PRT_OK : PRT_NOMEM;
    *rms = *most = 0;
    ctx.cpu &= ~(unsigned)PRT_CPU_AVX512VNNI;
    if (prt_relight_in_integers(ctx.cpu)) ctx.cpu = PRT_CPU_C;
    for (unsigned l = 0; l < 8 && !status; l++) {
        const float *together = job->color + l * n;
        struct prt_light light = {0};
        const struct prt_light *lights[1] = {&light};
        double all = 0, off = 0, largest = 0, worst = 0;
        status = prt_light_from_cube(&job->cube[l], &light);
        if (!status)
            status = prt_relight(&ctx, job->tensor, 1, lights, job->coef, false, alone);
        for (size_t i = 0; i < n && !status; i++) {
            const double x = (double)alone[i], d = (double)together[i] - x;
            all += x * x;
            off += d * d;
            largest = fmax(largest, fabs(x));
            worst = fmax(worst, fabs(d));
        }
        if (all > 0) *rms = fmax(*rms, sqrt(off / all));
        if (largest > 0) *most = fmax(*most, worst / largest);
        prt_light_finish(&light);
    }
    prt_free(alone);
    return status;
}

static int start(struct job *job, struct bench_env *env, const struct prt_tensor *tensor,
                 uint32_t cube)
{
    *job = (struct job){.env = env, .tensor = tensor};
    for (unsigned i = 0; i < 8; i++) {
        int status = bench_cube(cube, env->seed + i, &job->cube[i]);
        if (status) return status;
    }
    job->color = prt_calloc(24ull * tensor->n_vertex * tensor->n_phase, sizeof *job->color);
    return job->color ? PRT_OK : PRT_NOMEM;
}

static void stop(struct job *job)
{
    for (unsigned i = 0; i < 8; i++) prt_cube_finish(&job->cube[i]);
    prt_free(job->color);
}

// One and eight lights on one tensor. *one is the time of one light: compared with when it is
// known before (best > 0).
static int one_and_eight(struct bench_env *env, const char *name,
                         const struct prt_tensor *tensor, uint32_t cube, const float *coef,
                         bool eight, struct bench_time *one)
{
    struct bench_time time[2];
    struct job job;
    struct turn none = {&job, 0}, single = {&job, 1}, many = {&job, 8};
    void *const of_read[2] = {&none, &single}, *const of_one[2] = {&single, &many};
    char label[64];
    double bandwidth = 0;
    int status = start(&job, env, tensor, cube);
    job.coef = coef;
    if (!status) {
        job.n_span = bench_tensor_spans(tensor, job.span);
        status = bench_compare(env, relight_turn, of_read, time);
        bandwidth = job.bytes / time[0].best;
    }
    if (!status) print(&job, name, 1, bandwidth, &time[1], one->best > 0 ? one : NULL);
    if (!status && one->best <= 0) *one = time[1];
    if (!status && eight) {
        snprintf(label, sizeof label, "%s_8_lights", name);
        status = bench_compare(env, relight_turn, of_one, time);
        if (!status) status = relight_turn(&many);
        if (!status) status = from_floats(&job, &job.rms, &job.most);
        if (!status) print(&job, label, 8, bandwidth, &time[1], &time[0]);
    }
    stop(&job);
    return status;
}

static int made_up(struct bench_env *env, const char *name, const struct synthetic_options *o,
                   const float *coef, bool eight, struct bench_time *one)
{
    struct prt_tensor tensor;
    int status = synthetic_tensor(o, &tensor);
    if (status) return prt_fail(&env->ctx, status, "no memory for a made-up transport");
    status = one_and_eight(env, name, &tensor, o->cube, coef, eight, one);
    synthetic_tensor_finish(&tensor);
    return status;
}

static int factored(struct bench_env *env)
{
    struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                  .value = PRT_VALUE_PAIR,
                                  .n_vertex = 34835,
                                  .n_cluster = 64,
                                  .rank = 48,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 506,
                                  .seed = env->seed,
                                  .run = 24};
    struct bench_time bunny = {0}, million = {0};
    int status = made_up(env, "factored_bunny", &o, NULL, true, &bunny);
    o.n_vertex = env->quick ? 50000 : 1000000;
    o.rank = 40;
    // runs of 24 vertices all over the file: hard on memory
    if (!status) status = made_up(env, "factored_million", &o, NULL, true, &million);
    // a grid of 1000 by 1000 in patches
    o.patch = env->quick ? 28 : 125;
    million = (struct bench_time){0};
    if (!status) status = made_up(env, "factored_million_grid", &o, NULL, true, &million);
    return status;
}

// A phase function of four terms beside an isotropic one: the four planes of single scattering.
static int phase(struct bench_env *env)
{
    struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                  .value = PRT_VALUE_PAIR,
                                  .n_vertex = 34835,
                                  .n_cluster = 64,
                                  .rank = 48,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 506,
                                  .seed = env->seed,
                                  .run = 24};
    struct bench_time one = {0};
    int status = made_up(env, "phase_1_factored", &o, NULL, false, &one);
    o.n_phase = 4;
    o.value = PRT_VALUE_F16;
    if (!status) status = made_up(env, "phase_4_factored", &o, NULL, false, &one);
    o.storage = PRT_STORAGE_SPARSE;
    o.value = PRT_VALUE_I8;
    o.coefs = 122;
    o.n_phase = 1;
    one = (struct bench_time){0};
    if (!status) status = made_up(env, "phase_1_sparse", &o, NULL, false, &one);
    o.n_phase = 4;
    if (!status) status = made_up(env, "phase_4_sparse", &o, NULL, false, &one);
    return status;
}

// The storage of W05: 128 coefficients a vertex, the six scaling ones among them.
static int sparse(struct bench_env *env)
{
    struct synthetic_options o = {.storage = PRT_STORAGE_SPARSE,
                                  .value = PRT_VALUE_I8,
                                  .n_vertex = env->quick ? 20000 : 300000,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 122,
                                  .seed = env->seed,
                                  .run = 24};
    struct bench_time one = {0};
    int status = made_up(env, "sparse_8_bit", &o, NULL, true, &one);
    o.value = PRT_VALUE_F16;
    one = (struct bench_time){0};
    if (!status) status = made_up(env, "sparse_half", &o, NULL, false, &one);
    return status;
}

struct answer_job {
    struct bench_env *env;
    const struct prt_transport *transport;
    struct prt_cube cube[8];
    unsigned n_light;
    float *color[8];
};

static int answer_cubes(void *arg)
{
    struct answer_job *job = arg;
    struct prt_query query[8];
    const bool planes[8] = {false};
    memset(query, 0, sizeof query);
    for (unsigned i = 0; i < job->n_light; i++)
        query[i] = (struct prt_query){.term = PRT_ANSWER_TOTAL, .light = &job->cube[i]};
    return prt_answer_many(&job->env->ctx, job->transport, job->n_light, query, planes,
                           job->color, NULL);
}

struct answer_turn {
    struct answer_job *job;
    unsigned n_light;
};

static int answer_turn(void *arg)
{
    const struct answer_turn *turn = arg;
    turn->job->n_light = turn->n_light;
    return answer_cubes(turn->job);
}

// Cost of a request with all tensors: one light, and eight at once.
static int answers(struct bench_env *env, const struct prt_transport *t)
{
    struct answer_job job = {.env = env, .transport = t};
    struct answer_turn turn[2] = {{&job, 1}, {&job, 8}};
    void *const turns[2] = {&turn[0], &turn[1]};
    struct bench_time time[2];
    int status = PRT_OK;
    for (unsigned i = 0; i < 8 && !status; i++) {
        status = bench_cube(t->cube, env->seed + i, &job.cube[i]);
        job.color[i] = prt_calloc(3ull * t->mesh.n_vertex, sizeof *job.color[i]);
        if (!job.color[i]) status = PRT_NOMEM;
    }
    if (!status) status = bench_compare(env, answer_turn, turns, time);
    for (int i = 0; i < 2 && !status; i++) {
        bench_begin(env, i ? "file_answer_8_lights" : "file_answer");
        bench_number("vertices", t->mesh.n_vertex);
        bench_number("lights", turn[i].n_light);
        bench_number("ms", 1e3 * time[i].best);
        bench_number("ms_median", 1e3 * time[i].median);
        if (i) {
            bench_number("times_one", time[1].best / time[0].best);
            bench_number("times_one_median", time[1].median / time[0].median);
            bench_number("target_times_one", 3);
        }
        bench_end();
    }
    for (unsigned i = 0; i < 8; i++) {
        prt_cube_finish(&job.cube[i]);
        prt_free(job.color[i]);
    }
    return status;
}

// The tensors of a baked file, each by itself, and without further options the whole
// answer.
static int file(struct bench_env *env)
{
    struct prt_file *f;
    float coef[3072];
    if (!env->file) return PRT_OK;
    int status = prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(f);
    for (int i = 0; i < 3072; i++) coef[i] = 1.0f / (float)(i + 1);
    for (uint32_t i = 0; i < t->n_tensor && !status; i++) {
        const struct prt_tensor *x = &t->tensor[i];
        char label[32];
        struct bench_time one = {0};
        snprintf(label, sizeof label, "file_tensor_%u", i);
        bool free_material = x->coupling == PRT_COUPLE_FULL || x->storage == PRT_STORAGE_RADIAL;
        status =
            one_and_eight(env, label, x, t->cube ? t->cube : 32, free_material ? coef : NULL,
                          x->storage != PRT_STORAGE_RADIAL, &one);
    }
    if (!status && t->engine == PRT_TRANSPORT_WAVELET) status = answers(env, t);
    prt_file_close(f);
    return status;
}

// The bases of --file on its model subdivided to a million vertices, as baking one would take
// an hour.
static int million(struct bench_env *env)
{
    const uint32_t n = env->quick ? 100000 : 1000000;
    struct prt_file *f;
    if (!env->file) return PRT_OK;
    int status = prt_file_open(&env->ctx, env->file, PRT_FILE_CHECK_HEADERS, &f);
    if (status) return status;
    const struct prt_transport *t = prt_file_transport(f);
    for (uint32_t i = 0; i < t->n_tensor && !status; i++) {
        const struct prt_tensor *x = &t->tensor[i];
        struct prt_tensor fine;
        char label[32];
        struct bench_time one = {0};
        if (x->storage != PRT_STORAGE_FACTORED || x->coupling != PRT_COUPLE_DIAGONAL ||
            x->n_vertex >= n)
            continue;
        if (subdivided_tensor(&t->mesh, x, n, &fine)) {
            status = prt_fail(&env->ctx, PRT_NOMEM, "no memory for %u vertices", n);
            break;
        }
        snprintf(label, sizeof label, "million_tensor_%u", i);
        status = one_and_eight(env, label, &fine, t->cube, NULL, true, &one);
        subdivided_finish(&fine);
    }
    prt_file_close(f);
    return status;
}

static int bandwidth(struct bench_env *env)
{
    struct bench_span span = {.n = env->quick ? 1u << 26 : 1u << 30};
    void *bytes = prt_calloc(span.n, 1);
    if (!bytes) return PRT_NOMEM;
    memset(bytes, 1, span.n);
    span.bytes = bytes;
    bench_begin(env, "read_bandwidth");
    bench_number("bytes", (double)span.n);
    bench_number("GB_per_s", 1e-9 * bench_read_bandwidth(env, &span, 1));
    bench_end();
    prt_free(bytes);
    return PRT_OK;
}

BENCH(bandwidth, "Plain read of 1 GB with all threads", bandwidth)
BENCH(relight_factored, "Factored transport, 35k and 1M vertices, 1 and 8 lights", factored)
BENCH(relight_sparse, "Sparse transport (W05), 128 coefficients a vertex", sparse)
BENCH(relight_phase, "Four phase terms against one", phase)
BENCH(relight_million, "A wavelet --file on its model subdivided to 1M vertices", million)
BENCH(relight_file, "The tensors of --file X.prt", file)
