// SPDX-License-Identifier: MIT
// Contractions of whole tensors: divides the work into pieces and runs the kernels on them.
#include "contract_columns.h"
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

enum {
    ROW_GRAIN = 32,      // basis rows per piece, each of some hundred entries
    VERTEX_GRAIN = 4096, // vertices per piece of a cluster, a multiple of EXPAND_ALIGN
    SPARSE_BLOCK = 32,   // vertices per block that is scattered to the planes
    TABLE_GRAIN = 1536,
    STREAM_BYTES = 1 << 24, // colours of this size are evicted before they are read: stores
                            // bypass the caches
};

static int check_lights(const struct prt_context *ctx, const struct prt_tensor *tensor,
                        unsigned n_light, const struct prt_light *const light[])
{
    if (!n_light || n_light > PRT_RELIGHT_MAX_LIGHTS)
        return prt_fail(ctx, PRT_ARG, "%u lights in one call; 1 to %d are possible", n_light,
                        PRT_RELIGHT_MAX_LIGHTS);
    for (unsigned i = 0; i < n_light; i++)
        if (6ull * light[i]->n * light[i]->n != tensor->rows.n_coef)
            return prt_fail(ctx, PRT_MISMATCH,
                            "the light has 6x%ux%u coefficients, the transport needs %u",
                            light[i]->n, light[i]->n, tensor->rows.n_coef);
    return PRT_OK;
}

// The lights of one group. Rows of pairs need them multiplied by the gains of their
// coefficients.
struct light_group {
    uint32_t n, n_coef; // of the cube
    unsigned n_light;
    const float *coef[LIGHT_GROUP];
    float gain[64];             // of rows of pairs, as in struct integer_lights
    float *own;                 // the multiplied coefficients, [LIGHT_GROUP][n_coef][4]
    float most[LIGHT_GROUP][4]; // largest product, scaling coefficients left out
};

typedef int32_t lanes4 __attribute__((vector_size(16), aligned(4)));
typedef float floats4 __attribute__((vector_size(16), aligned(4)));

// Multiplies n coefficients by a gain and returns the largest bits of their absolute values,
// which are ordered as the values are. out may be NULL.
static inline lanes4 gain_span(const float *in, uint32_t n, float gain, lanes4 most, float *out)
{
    for (uint32_t i = 0; i < n; i++) {
        const floats4 x = *(const floats4 *)(in + 4 * (size_t)i) * gain;
        const lanes4 bits = (lanes4)x & 0x7fffffff, larger = bits > most;
        if (out) *(floats4 *)(out + 4 * (size_t)i) = x;
        most = (bits & larger) | (most & ~larger);
    }
    return most;
}

static inline void gain_light(struct light_group *a, size_t l, float *out)
{
    const uint32_t n = a->n;
    lanes4 most = {0};
    for (uint32_t i = 0; i < 6 * n * n; i += n)
        // along a row of texels, one span of equal gain after the other
        for (uint32_t x = 0, y = i / n % n, stop; x < n; x = stop) {
            for (stop = 1; stop <= (x | y) && stop < n;) stop *= 2;
            const size_t at = 4 * (size_t)(i + x);
            const lanes4 span = gain_span(a->coef[l] + at, stop - x, a->gain[x | y], most,
                                          out ? out + at : NULL);
            if (x | y) most = span; // scaling coefficients stay in f32
        }
    memcpy(a->most[l], &most, sizeof most);
}

static int find_most(void *arg, size_t begin, size_t end, unsigned worker)
{
    for (size_t l = begin; l < end; l++) gain_light(arg, l, NULL);
    return PRT_OK;
}

static int gain_lights(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct light_group *a = arg;
    for (size_t l = begin; l < end; l++) {
        float *out = a->own + 4 * l * a->n_coef;
        gain_light(a, l, out);
        a->coef[l] = out;
    }
    return PRT_OK;
}

struct table_job {
    const struct prt_kernels *kernels;
    const struct light_group *group;
    float *table;
    const struct integer_lights *integers; // in place of the table
};

static int fill_table(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct table_job *job = arg;
    const uint32_t b = (uint32_t)begin, e = (uint32_t)end;
    const struct light_group *group = job->group;
    if (job->integers)
        job->kernels->lights_to_integers(job->integers, group->n_light, group->coef, b, e);
    else prt_light_table_fill(group->n_light, group->coef, b, e, job->table);
    return PRT_OK;
}

struct rows_job {
    const struct prt_kernels *kernels;
    const struct prt_tensor *tensor;
    unsigned n_light;                      // of this group
    const float *light;                    // the only light, or
    const float *table;                    // the group's table, or
    const struct integer_lights *integers; // the group's integers
    float *out;
    size_t light_pitch, row_pitch;
    bool together;      // the results of a row's lights are adjacent
    uint32_t most_rank; // run_clusters: rows of a cluster
};

static int run_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct rows_job *job = arg;
    const struct prt_rows *rows = &job->tensor->rows;
    uint32_t b = (uint32_t)begin, e = (uint32_t)end;
    bool full = job->tensor->coupling == PRT_COUPLE_FULL;
    float *out = job->out + begin * job->row_pitch;
    if (full && rows->direction) job->kernels->mixed(rows, b, e, job->light, out);
    else if (full) job->kernels->full(rows, b, e, job->light, out);
    else if (job->integers)
        job->kernels->pairs_group(rows, b, e, job->integers, job->n_light, job->light_pitch,
                                  job->row_pitch, out);
    else if (job->table)
        job->kernels->diagonal_group(rows, b, e, job->table, job->n_light, job->light_pitch,
                                     job->row_pitch, out);
    else job->kernels->diagonal(rows, b, e, job->light, out);
    return PRT_OK;
}

// The first most_rank rows of each cluster.
static int run_clusters(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct rows_job *job = arg;
    for (size_t i = begin; i < end; i++) {
        const struct prt_cluster *c = &job->tensor->cluster[i];
        const uint32_t n = c->rank < job->most_rank ? c->rank : job->most_rank;
        run_rows(arg, c->row_begin, (size_t)c->row_begin + n, worker);
    }
    return PRT_OK;
}

static bool takes_integers(const struct rows_job *job)
{
    return job->tensor->rows.value == PRT_VALUE_PAIR && job->kernels->pairs_group;
}

// Lights of a group share one pass over the rows. Two single passes take less time than a group
// of two, but for that of quads. With `together` every light is in a group: results of a row's
// lights are adjacent.
static unsigned group_size(const struct rows_job *job, unsigned left)
{
    const bool alone =
        left == 2 && !job->together && !(takes_integers(job) && job->kernels->quads);
    return left < 2 || alone ? 1 : left < LIGHT_GROUP ? left : LIGHT_GROUP;
}

// Whether a group of n lights that is not in integers is read from a table of floats.
static bool takes_table(const struct rows_job *job, unsigned n)
{
    return n > 1 || job->together;
}

// Bytes of a coefficient in a table of the largest group; 0 where none is read.
static size_t table_bytes(const struct rows_job *job, unsigned n_light)
{
    if (job->tensor->coupling == PRT_COUPLE_FULL) return 0;
    if (group_size(job, n_light) > 1) return LIGHT_LANES * sizeof(float);
    return takes_integers(job) ? 4 * sizeof(int16_t) : 0;
}

// Lays the group's lights out for its kernel: sets job->integers, job->table or job->light.
static int prepare_lights(const struct prt_context *ctx, const struct prt_tensor *tensor,
                          struct light_group *group, float *table,
                          struct integer_lights *integers, struct rows_job *job)
{
    const bool pairs = tensor->rows.value == PRT_VALUE_PAIR;
    struct table_job fill = {job->kernels, group, table, NULL};
    int status = PRT_OK;
    job->table = NULL;
    job->integers = NULL;
    if (takes_integers(job)) {
        integers->lane = (int16_t *)table;
        status = prt_parallel_for(ctx, NULL, group->n_light, 1, find_most, group);
        if (!status &&
            prt_integer_lights_init(integers, group->n_light, job->kernels->quads, group->n,
                                    group->coef, (const float(*)[4])group->most))
            job->integers = fill.integers = integers;
    }
    if (!takes_table(job, group->n_light) && !job->integers) table = NULL;
    if (pairs && !job->integers && !status) {
        if (!group->own)
            group->own = prt_alloc((table ? LIGHT_GROUP : 1) * (size_t)group->n_coef, 16);
        if (!group->own)
            return prt_fail(ctx, PRT_NOMEM, "no memory to scale %u lights", group->n_light);
        status = prt_parallel_for(ctx, NULL, group->n_light, 1, gain_lights, group);
    }
    if (!job->integers) job->table = table;
    job->light = group->coef[0];
    if (!table || status) return status;
    return prt_parallel_for(ctx, NULL, group->n_coef, TABLE_GRAIN, fill_table, &fill);
}

// Runs fn over n_item items for every group of lights.
static int for_groups(const struct prt_context *ctx, const struct prt_tensor *tensor,
                      unsigned n_light, const struct prt_light *const light[], size_t n_item,
                      size_t grain, prt_loop_fn fn, struct rows_job *job)
{
    float *table = NULL;
    float *out = job->out;
    struct light_group group = {.n = light[0]->n, .n_coef = tensor->rows.n_coef};
    struct integer_lights integers;
    int status = PRT_OK;
    const bool full = tensor->coupling == PRT_COUPLE_FULL;
    for (uint32_t t = 0; t < 64 && tensor->rows.value == PRT_VALUE_PAIR; t++)
        group.gain[t] = t < group.n ? prt_pair_gain(group.n, t) : 1;
    const size_t bytes = table_bytes(job, n_light);
    if (bytes) {
        table = prt_alloc(tensor->rows.n_coef, bytes);
        if (!table)
            status = prt_fail(ctx, PRT_NOMEM, "no memory for a table of %u lights", n_light);
    }
    for (unsigned l = 0, n; l < n_light && !status; l += n) {
        n = full ? 1 : group_size(job, n_light - l);
        job->n_light = n;
        job->out = out + l * job->light_pitch;
        group.n_light = n;
        for (unsigned k = 0; k < n; k++) group.coef[k] = light[l + k]->coef;
        status = prepare_lights(ctx, tensor, &group, table, &integers, job);
        if (!status) status = prt_parallel_for(ctx, NULL, n_item, grain, fn, job);
    }
    prt_free(table);
    prt_free(group.own);
    return status;
}

static int by_rows(const struct prt_context *ctx, unsigned n_light,
                   const struct prt_light *const light[], struct rows_job *job)
{
    const struct prt_tensor *t = job->tensor;
    return job->most_rank
               ? for_groups(ctx, t, n_light, light, t->n_cluster, 1, run_clusters, job)
               : for_groups(ctx, t, n_light, light, t->rows.n_row, ROW_GRAIN, run_rows, job);
}

// By columns, and by rows the lights under which too many columns matter.
static int by_columns(const struct prt_context *ctx, unsigned n_light,
                      const struct prt_light *const light[], struct rows_job *job)
{
    bool taken[PRT_RELIGHT_MAX_LIGHTS];
    float *out = job->out;
    int status = prt_contract_columns(ctx, job->tensor, n_light, light, job->light_pitch,
                                      job->row_pitch, out, taken);
    for (unsigned l = 0, n; l < n_light && !status; l += n) {
        for (n = 0; l + n < n_light && !taken[l + n];) n++;
        job->out = out + l * job->light_pitch;
        if (n) status = by_rows(ctx, n, light + l, job);
        else n = 1;
    }
    return status;
}

// out[light][row][..], or out[row][light][..] when `together`. most_rank: 0: all rows; others
// than the first most_rank of a cluster are not to be read.
static int contract(const struct prt_context *ctx, const struct prt_tensor *tensor,
                    unsigned n_light, const struct prt_light *const light[], bool together,
                    uint32_t most_rank, float *out)
{
    int status = check_lights(ctx, tensor, n_light, light);
    if (status) return status;
    if (tensor->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_ARG,
                        "only factored storage has bases that a light can be contracted with");
    const struct prt_rows *rows = &tensor->rows;
    size_t width = rows->n_function * (tensor->coupling == PRT_COUPLE_FULL ? 3ull : 1ull);
    struct rows_job job = {.kernels = prt_kernels_for(ctx->cpu),
                           .tensor = tensor,
                           .out = out,
                           .light_pitch = together ? width : rows->n_row * width,
                           .row_pitch = together ? n_light * width : width,
                           .together = together,
                           .most_rank = most_rank};
    if (__atomic_load_n(&tensor->columns, __ATOMIC_ACQUIRE))
        return by_columns(ctx, n_light, light, &job);
    return by_rows(ctx, n_light, light, &job);
}

int prt_contract_lights(const struct prt_context *ctx, const struct prt_tensor *tensor,
                        unsigned n_light, const struct prt_light *const light[],
                        uint32_t most_rank, float *out)
{
    return contract(ctx, tensor, n_light, light, n_light > 1, most_rank, out);
}

int prt_contract_light(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], float *out)
{
    return contract(ctx, tensor, n_light, light, false, 0, out);
}

struct material_job {
    const struct prt_kernels *kernels;
    const float *in, *coef;
    float *out;
    uint32_t n_radial;
};

static int run_material(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct material_job *job = arg;
    job->kernels->material(job->in + begin * 3 * job->n_radial, end - begin, job->n_radial,
                           job->coef, job->out + 3 * begin);
    return PRT_OK;
}

int prt_contract_material(const struct prt_context *ctx, const struct prt_tensor *tensor,
                          const float *in, const float *coef, float *out)
{
    if (tensor->coupling != PRT_COUPLE_FULL || tensor->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_ARG, "the tensor's material is fixed");
    struct material_job job = {prt_kernels_for(ctx->cpu), in, coef, out, tensor->n_radial};
    return prt_parallel_for(ctx, NULL, (size_t)tensor->rows.n_row * tensor->n_phase, 2048,
                            run_material, &job);
}

int prt_expand_pieces(const struct prt_context *ctx, const struct prt_tensor *tensor,
                      struct expand_piece **out, size_t *n_out, size_t *grain)
{
    size_t n = 0, most = (size_t)tensor->n_cluster + tensor->n_vertex / VERTEX_GRAIN;
    struct expand_piece *pieces = malloc((most + 1) * sizeof *pieces);
    if (!pieces) return prt_fail(ctx, PRT_NOMEM, "no memory for %zu pieces of work", most);
    for (uint32_t i = 0; i < tensor->n_cluster; i++) {
        uint32_t end = tensor->cluster[i].n_vertex;
        for (uint32_t b = 0; b < end; b += VERTEX_GRAIN)
            pieces[n++] =
                (struct expand_piece){i, b, end - b < VERTEX_GRAIN ? end : b + VERTEX_GRAIN};
    }
    *out = pieces;
    *n_out = n;
    // several small clusters per task: about two thousand vertices
    size_t mean = n ? tensor->n_vertex / n : 1;
    *grain = 2048 / (mean + 1);
    if (!*grain) *grain = 1;
    return PRT_OK;
}

struct expand_run {
    const struct prt_kernels *kernels;
    const struct prt_tensor *tensor;
    const struct expand_piece *pieces;
    const float *b;
    size_t b_stride;
    uint32_t n_triple;
    float *color[MOST_TRIPLES];
    bool add, stream;
};

// Plane by plane, because columns have factors of their own.
static void expand_radial(const struct expand_run *run, uint32_t cluster,
                          struct expand_job *job, float *coef)
{
    const struct prt_tensor *t = run->tensor;
    const size_t plane = 3 * (size_t)t->n_radial * job->stride;
    job->rank = job->rank ? t->n_radial : 0;
    job->b = coef;
    job->n_triple = 1;
    for (uint32_t k = 0; k < run->n_triple; k++) {
        radial_coef(t, cluster, k, run->b, NULL, coef);
        run->kernels->radial(job);
        job->u += plane;
        job->color++;
    }
}

static int run_expand(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct expand_run *run = arg;
    const struct prt_tensor *t = run->tensor;
    const bool radial = t->storage == PRT_STORAGE_RADIAL;
    float *coef = radial ? prt_alloc(3 * (size_t)t->n_radial + 1, sizeof *coef) : NULL;
    if (radial && !coef) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++) {
        const struct expand_piece *p = &run->pieces[i];
        const struct prt_cluster *c = &t->cluster[p->cluster];
        struct expand_job job = {.u = t->u + c->u_begin,
                                 .stride = ((size_t)c->n_vertex + 15) & ~(size_t)15,
                                 .rank = c->rank,
                                 .b = run->b + (radial ? 0 : c->row_begin * run->b_stride),
                                 .b_stride = run->b_stride,
                                 .n_triple = run->n_triple,
                                 .begin = p->begin,
                                 .end = p->end,
                                 .order = t->order + c->vertex_begin,
                                 .color = run->color,
                                 .add = run->add,
                                 .stream = run->stream};
        if (radial) expand_radial(run, p->cluster, &job, coef);
        else run->kernels->expand(&job);
    }
    prt_free(coef);
    return PRT_OK;
}

// Expands every cluster; color holds one plane after the other.
static int expand_all(const struct prt_context *ctx, struct expand_run *run, float *color)
{
    if (run->n_triple > MOST_TRIPLES)
        return prt_fail(ctx, PRT_ARG, "%u planes of colours in one call; %d are possible",
                        run->n_triple, MOST_TRIPLES);
    for (uint32_t t = 0; t < run->n_triple; t++)
        run->color[t] = color + 3 * (size_t)t * run->tensor->n_vertex;
    struct expand_piece *pieces = NULL;
    size_t n = 0, grain = 1;
    int status = prt_expand_pieces(ctx, run->tensor, &pieces, &n, &grain);
    if (status) return status;
    run->kernels = prt_kernels_for(ctx->cpu);
    run->pieces = pieces;
    status = prt_parallel_for(ctx, NULL, n, grain, run_expand, run);
    free(pieces);
    return status ? prt_fail(ctx, status, "no memory to relight") : PRT_OK;
}

// b[row][light][phase][3]: all lights in one pass over U.
static int expand_together(const struct prt_context *ctx, const struct prt_tensor *tensor,
                           unsigned n_light, const float *b, bool add, float *color)
{
    struct expand_run run = {.tensor = tensor,
                             .b = b,
                             .b_stride = 3 * (size_t)tensor->n_phase * n_light,
                             .n_triple = n_light * tensor->n_phase,
                             .add = add};
    run.stream = !add && 12ull * run.n_triple * tensor->n_vertex >= STREAM_BYTES;
    return expand_all(ctx, &run, color);
}

int prt_expand(const struct prt_context *ctx, const struct prt_tensor *tensor, unsigned n_light,
               const float *b, bool add, float *color)
{
    if (tensor->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_ARG, "only factored storage can be expanded");
    size_t width = 3 * (size_t)tensor->n_phase, n_row = tensor->rows.n_row;
    float *rows = NULL;
    if (n_light > 1) {
        rows = prt_alloc(n_row * n_light * width + 1, sizeof *rows);
        if (!rows) return prt_fail(ctx, PRT_NOMEM, "no memory for %u lights", n_light);
        for (unsigned l = 0; l < n_light; l++)
            for (size_t r = 0; r < n_row; r++)
                memcpy(rows + (r * n_light + l) * width, b + (l * n_row + r) * width,
                       width * sizeof *rows);
    }
    int status = expand_together(ctx, tensor, n_light, rows ? rows : b, add, color);
    prt_free(rows);
    return status;
}

int prt_relight_radial(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       const float *coef, bool add, float *color)
{
    if (tensor->storage != PRT_STORAGE_RADIAL)
        return prt_fail(ctx, PRT_ARG, "the tensor's storage is not radial");
    struct expand_run run = {
        .tensor = tensor, .b = coef, .b_stride = 3, .n_triple = tensor->n_phase, .add = add};
    return expand_all(ctx, &run, color);
}

struct sparse_job {
    struct rows_job rows; // the first member: for_groups fills it
    bool add;
};

// Stores or adds one vertex's n triples to their planes.
static void put_vertex(const float *in, uint32_t n, size_t plane, bool add, float *out)
{
    for (uint32_t k = 0; k < n; k++, in += 3, out += plane) {
        if (add)
            for (int ch = 0; ch < 3; ch++) out[ch] += in[ch];
        else memcpy(out, in, 12);
    }
}

static int run_sparse(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct sparse_job *job = arg;
    const struct prt_tensor *t = job->rows.tensor;
    const uint32_t width = t->n_function, n_light = job->rows.n_light;
    const size_t plane = 3 * (size_t)t->n_vertex;
    float block[SPARSE_BLOCK * 48 * LIGHT_GROUP];
    for (uint32_t v = (uint32_t)begin, n; v < end; v += n) {
        n = end - v < SPARSE_BLOCK ? (uint32_t)(end - v) : SPARSE_BLOCK;
        for (uint32_t i = 0; i < n; i += 4)
            for (uint32_t k = 0; k < n_light * t->n_phase; k++)
                __builtin_prefetch(job->rows.out + k * plane + 3ull * t->order[v + i], 1, 3);
        if (job->rows.table)
            job->rows.kernels->diagonal_group(&t->rows, v, v + n, job->rows.table, n_light,
                                              width, n_light * width, block);
        else job->rows.kernels->diagonal(&t->rows, v, v + n, job->rows.light, block);
        for (uint32_t i = 0; i < n; i++)
            put_vertex(block + i * n_light * width, n_light * t->n_phase, plane, job->add,
                       job->rows.out + 3ull * t->order[v + i]);
    }
    return PRT_OK;
}

int prt_relight_sparse(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], bool add,
                       float *color)
{
    int status = check_lights(ctx, tensor, n_light, light);
    if (status) return status;
    if (tensor->storage != PRT_STORAGE_SPARSE || tensor->coupling != PRT_COUPLE_DIAGONAL ||
        tensor->rows.value == PRT_VALUE_PAIR)
        return prt_fail(ctx, PRT_ARG,
                        "the tensor's storage is not sparse, or its values are pairs");
    struct sparse_job job = {
        .rows = {.kernels = prt_kernels_for(ctx->cpu),
                 .tensor = tensor,
                 .out = color,
                 .light_pitch = 3 * (size_t)tensor->n_vertex * tensor->n_phase},
        .add = add};
    return for_groups(ctx, tensor, n_light, light, tensor->n_vertex, 1024, run_sparse,
                      &job.rows);
}

static int factored_colors(const struct prt_context *ctx, const struct prt_tensor *tensor,
                           unsigned n_light, const struct prt_light *const light[],
                           const float *coef, bool add, float *color)
{
    bool full = tensor->coupling == PRT_COUPLE_FULL;
    size_t n_row = tensor->rows.n_row, width = 3 * (size_t)tensor->n_phase;
    size_t wide = n_row * (full ? 3 * (size_t)tensor->n_function : width);
    float *b = prt_alloc(wide * n_light + 1, sizeof *b), *folded = NULL;
    const bool together = !full && n_light > 2;
    int status = b ? contract(ctx, tensor, n_light, light, together, 0, b)
                   : prt_fail(ctx, PRT_NOMEM, "no memory to relight");
    if (!status && full) {
        folded = prt_alloc(n_row * width * n_light + 1, sizeof *folded);
        if (!folded) status = prt_fail(ctx, PRT_NOMEM, "no memory to relight");
        for (unsigned l = 0; l < n_light && !status; l++)
            status = prt_contract_material(ctx, tensor, b + l * wide, coef,
                                           folded + l * n_row * width);
    }
    if (!status)
        status = together ? expand_together(ctx, tensor, n_light, b, add, color)
                          : prt_expand(ctx, tensor, n_light, full ? folded : b, add, color);
    prt_free(folded);
    prt_free(b);
    return status;
}

int prt_relight(const struct prt_context *ctx, const struct prt_tensor *tensor,
                unsigned n_light, const struct prt_light *const light[], const float *coef,
                bool add, float *color)
{
    bool free_material =
        tensor->coupling == PRT_COUPLE_FULL || tensor->storage == PRT_STORAGE_RADIAL;
    if (free_material != (coef != NULL))
        return prt_fail(ctx, PRT_ARG,
                        coef ? "the tensor's material is fixed"
                             : "the tensor's material is free: coefficients of one are needed");
    if (tensor->storage == PRT_STORAGE_RADIAL)
        return prt_relight_radial(ctx, tensor, coef, add, color);
    if (tensor->storage == PRT_STORAGE_SPARSE)
        return prt_relight_sparse(ctx, tensor, n_light, light, add, color);
    return factored_colors(ctx, tensor, n_light, light, coef, add, color);
}
