// SPDX-License-Identifier: MIT
// Folds a material into the rows of a joint transport: rows over (phase, radial function)
// become rows over (phase, channel). Entries that hardly contribute under this material are
// dropped.
#include "answer.h"
#include "kernels.h"

#include <math.h>
#include <string.h>

struct fold_job {
    const struct prt_tensor *tensor;
    const float *coef;
    size_t
        pitch; // floats from one plane's coefficients to the next one's; 0: all have the same
    const uint8_t *medium; // [n_row] of each row, or NULL: 0
    size_t medium_pitch;   // floats from one medium's coefficients to the next one's
    uint16_t *entry, *scaling;
};

// n values to n_phase * 3: out[3 k + ch] = sum_j value[k * n_radial + j] coef[j][ch].
static void fold_values(const struct fold_job *job, const float *value, float *out)
{
    const uint32_t n_radial = job->tensor->n_radial;
    for (uint32_t k = 0; k < job->tensor->n_phase; k++, value += n_radial) {
        float sum[3] = {0, 0, 0};
        for (uint32_t j = 0; j < n_radial; j++)
            for (int ch = 0; ch < 3; ch++)
                sum[ch] += value[j] * job->coef[k * job->pitch + 3 * j + (size_t)ch];
        memcpy(out + 3 * k, sum, sizeof sum);
    }
}

// fold_values of halves to halves. value: scratch of [n_function + 3 * n_phase].
static void fold_halves(const struct fold_job *job, const uint16_t *in, float *value,
                        uint16_t *out)
{
    const uint32_t n = job->tensor->rows.n_function;
    prt_f16_to_f32_array(in, n, value);
    fold_values(job, value, value + n);
    prt_f32_to_f16_array(value + n, 3 * job->tensor->n_phase, out);
}

// Folds a low-rank row: its components are folded first, and its entries are sums of these.
// Where several entries have one coefficient, the first gets their sum and the others get 0.
static void fold_low_rank(const struct fold_job *job, uint32_t row, float *value, float *folded)
{
    const struct prt_rows *rows = &job->tensor->rows;
    const uint32_t J = rows->n_function, width = 3 * job->tensor->n_phase;
    const uint32_t first = rows->direction[row], n = rows->direction[row + 1] - first;
    const int8_t *entry = (const int8_t *)rows->entry + rows->value_begin[row];
    for (uint32_t d = 0; d < n; d++) {
        prt_f16_to_f32_array(rows->mix + (uint64_t)(first + d) * J, J, value);
        for (uint32_t j = 0; j < J; j++) value[j] *= rows->scale[first + d];
        fold_values(job, value, folded + (size_t)d * width);
    }
    uint64_t at = rows->begin[row];
    for (uint64_t e = at; e < rows->begin[row + 1]; e++, entry += n) {
        const float factor = rows_factor(rows, e);
        if (e == at || rows_index(rows, e) != rows_index(rows, at)) {
            at = e;
            memset(value, 0, width * sizeof *value);
        } else {
            memset(job->entry + e * width, 0, 2 * (size_t)width);
        }
        for (uint32_t d = 0; d < n; d++)
            for (uint32_t k = 0; k < width; k++)
                value[k] += factor * entry[d] * folded[(size_t)d * width + k];
        prt_f32_to_f16_array(value, width, job->entry + at * width);
    }
}

static int fold_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct fold_job *all = arg;
    struct fold_job own = *all, *job = &own;
    const struct prt_rows *rows = &job->tensor->rows;
    const uint32_t n = rows->n_function, width = 3 * job->tensor->n_phase;
    float *value = prt_alloc((size_t)n + width, sizeof *value);
    float *folded = prt_alloc((size_t)PRT_ROWS_MOST_DIRECTIONS * width, sizeof *folded);
    int status = value && folded ? PRT_OK : PRT_NOMEM;
    for (size_t row = begin; row < end && !status; row++) {
        own.coef = all->coef + (all->medium ? all->medium[row] * all->medium_pitch : 0);
        if (rows->direction) fold_low_rank(job, (uint32_t)row, value, folded);
        for (uint64_t e = rows->begin[row]; !rows->direction && e < rows->begin[row + 1]; e++)
            fold_halves(job, (const uint16_t *)rows->entry + e * n, value,
                        job->entry + e * width);
        for (uint64_t f = 6 * row; f < 6 * row + 6; f++)
            fold_halves(job, rows->scaling + f * n, value, job->scaling + f * width);
    }
    prt_free(value);
    prt_free(folded);
    return status;
}

static int fold_all(const struct prt_context *ctx, const struct prt_tensor *tensor,
                    const float *coef, size_t pitch, const uint8_t *medium,
                    struct prt_rows *out)
{
    const struct prt_rows *rows = &tensor->rows;
    if (tensor->coupling != PRT_COUPLE_FULL || tensor->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_ARG,
                        "the tensor's material is fixed: it has no radial functions to fold");
    if (!rows->n_row) return prt_fail(ctx, PRT_ARG, "the tensor has no rows to fold");
    uint64_t n_entry = rows->begin[rows->n_row], width = 3ull * tensor->n_phase;
    uint64_t *begin = prt_alloc(rows->n_row + 1ull, 8);
    char *index = prt_alloc(n_entry + 1, rows->index_bytes);
    struct fold_job job = {tensor,
                           coef,
                           pitch,
                           medium,
                           3 * (size_t)tensor->n_radial * tensor->n_phase,
                           prt_alloc(n_entry * width + 1, 2),
                           prt_alloc(6 * width * rows->n_row, 2)};
    *out = (struct prt_rows){.n_row = rows->n_row,
                             .n_function = (uint32_t)width,
                             .n_coef = rows->n_coef,
                             .value = PRT_VALUE_F16,
                             .index_bytes = rows->index_bytes,
                             .begin = begin,
                             .index = index,
                             .entry = job.entry,
                             .scaling = job.scaling};
    int status = PRT_NOMEM;
    if (begin && index && job.entry && job.scaling) {
        memcpy(begin, rows->begin, 8 * (rows->n_row + 1ull));
        memcpy(index, rows->index, n_entry * rows->index_bytes);
        status = prt_parallel_for(ctx, NULL, rows->n_row, 16, fold_rows, &job);
    }
    if (!status) return PRT_OK;
    prt_rows_finish(out);
    return prt_fail(ctx, status, "no memory to fold a material");
}

int prt_rows_fold(const struct prt_context *ctx, const struct prt_tensor *tensor,
                  const float *coef, struct prt_rows *out)
{
    return fold_all(ctx, tensor, coef, 0, NULL, out);
}

// ---- dropping small entries

// The worth of an entry is its energy times the energy of its row's column of U: what the
// colours lose without it; times the weight of its object. A histogram of worths finds the
// threshold; its bins are the leading bits of a float, four bins an octave.
enum {
    BIN_SHIFT = 21,
    N_BIN = 1 << (32 - BIN_SHIFT),
    CHUNKS = 32
}; // CHUNKS ranges of rows, summed in a fixed order

struct thin_job {
    const struct prt_rows *rows;
    const float *weight; // [n_row]
    double *own;         // [n_row] energy of each row, or NULL
    size_t grain;        // rows a chunk
    double *bin;         // [CHUNKS][N_BIN] sums of entries' worths
    double *scaling;     // [CHUNKS] sums of scaling coefficients' worths
    uint32_t from;       // entries in bins below this one are dropped
    uint8_t *keep;       // [n_entry]
};

static float energy_of(const uint16_t *half, uint32_t n)
{
    float value[48], sum = 0;
    for (uint32_t m; n; n -= m, half += m) {
        m = n < 48 ? n : 48;
        prt_f16_to_f32_array(half, m, value);
        for (uint32_t k = 0; k < m; k++) sum += value[k] * value[k];
    }
    return sum;
}

static uint32_t bin_of(float worth)
{
    uint32_t bits;
    memcpy(&bits, &worth, 4);
    return bits >> BIN_SHIFT;
}

static float worth_of(const struct thin_job *job, size_t row, uint64_t e)
{
    const uint32_t n = job->rows->n_function;
    return job->weight[row] * energy_of((const uint16_t *)job->rows->entry + e * n, n);
}

static int count_worth(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct thin_job *job = arg;
    const struct prt_rows *rows = job->rows;
    const uint32_t n = 6 * rows->n_function;
    double *bin = job->bin + begin / job->grain * N_BIN;
    for (size_t row = begin; row < end; row++) {
        job->scaling[begin / job->grain] +=
            (double)(job->weight[row] * energy_of(rows->scaling + row * n, n));
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            float x = worth_of(job, row, e);
            bin[bin_of(x)] += (double)x;
        }
    }
    return PRT_OK;
}

static int mark(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct thin_job *job = arg;
    for (size_t row = begin; row < end; row++)
        for (uint64_t e = job->rows->begin[row]; e < job->rows->begin[row + 1]; e++)
            job->keep[e] = bin_of(worth_of(job, row, e)) >= job->from;
    return PRT_OK;
}

// The largest threshold whose dropped entries stay below a share of all energy.
static void find_threshold(struct thin_job *job, double share)
{
    double all = 0, gone = 0;
    for (int c = 0; c < CHUNKS; c++) {
        all += job->scaling[c];
        for (int i = 0; i < N_BIN; i++) all += job->bin[(size_t)c * N_BIN + i];
    }
    for (job->from = 0; job->from < N_BIN; job->from++) {
        for (int c = 0; c < CHUNKS; c++) gone += job->bin[(size_t)c * N_BIN + job->from];
        if (gone > share * all) break;
    }
}

static void row_weights(const struct prt_tensor *t, float *weight)
{
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        const size_t padded = ((size_t)k->n_vertex + 15) & ~(size_t)15;
        const int16_t *u = (const int16_t *)t->u + k->u_begin;
        for (uint32_t r = 0; r < k->rank; r++) {
            const int16_t *row = u + 2 * padded * (r / 2) + r % 2;
            float sum = 0;
            for (size_t v = 0; v < k->n_vertex; v++) {
                const float x = (float)row[2 * v] * PRT_U_UNIT;
                sum += x * x;
            }
            weight[k->row_begin + r] += sum;
        }
    }
}

static int row_energies(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct thin_job *job = arg;
    const struct prt_rows *rows = job->rows;
    for (size_t row = begin; row < end; row++) {
        double sum =
            (double)energy_of(rows->scaling + row * 6 * rows->n_function, 6 * rows->n_function);
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++)
            sum += (double)energy_of((const uint16_t *)rows->entry + e * rows->n_function,
                                     rows->n_function);
        job->own[row] = (double)job->weight[row] * sum;
    }
    return PRT_OK;
}

// An object of less than this part of the mean energy a vertex counts as one of it: as where a
// bake is packed.
static const double least_part = 1e-4;

// Weights that give every object the mean energy a vertex, from the rows' energies, into the
// rows' weights. object [n_cluster]; sum [n_object + 1][2]: energy and vertices, the last of
// all.
static void weigh_objects(const struct prt_tensor *t, const uint32_t *object, uint32_t n_object,
                          const double *own, double (*sum)[2], float *weight)
{
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        const uint32_t at[2] = {object[c], n_object};
        for (int i = 0; i < 2 && k->rank; i++) {
            for (uint32_t r = 0; r < k->rank; r++) sum[at[i]][0] += own[k->row_begin + r];
            sum[at[i]][1] += k->n_vertex;
        }
    }
    const double mean = sum[n_object][0] / fmax(sum[n_object][1], 1);
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        const double one = sum[object[c]][0] / fmax(sum[object[c]][1], 1);
        const double factor = one > 0 ? mean / fmax(one, least_part * mean) : 1;
        for (uint32_t r = 0; r < k->rank; r++) weight[k->row_begin + r] *= (float)factor;
    }
}

static int weigh_rows(const struct prt_context *ctx, const struct prt_tensor *tensor,
                      const uint32_t *object, struct thin_job *job, float *weight)
{
    const uint32_t n_row = job->rows->n_row;
    uint32_t n_object = 0;
    row_weights(tensor, weight);
    for (uint32_t c = 0; object && c < tensor->n_cluster; c++)
        n_object = object[c] >= n_object ? object[c] + 1 : n_object;
    if (n_object < 2) return PRT_OK;
    double(*sum)[2] = prt_calloc(n_object + 1ull, sizeof *sum);
    job->own = prt_alloc(n_row, sizeof *job->own);
    int status = sum && job->own ? PRT_OK : PRT_NOMEM;
    if (!status) status = prt_parallel_for(ctx, NULL, n_row, job->grain, row_energies, job);
    if (!status) weigh_objects(tensor, object, n_object, job->own, sum, weight);
    prt_free(sum);
    prt_free(job->own);
    job->own = NULL;
    return status;
}

// Closes the gaps between the entries that are kept, in place.
static void compact(struct prt_rows *rows, const struct thin_job *job)
{
    uint16_t *entry = (uint16_t *)(uintptr_t)rows->entry;
    char *index = (char *)(uintptr_t)rows->index;
    uint64_t *begin = (uint64_t *)(uintptr_t)rows->begin, to = 0, e = 0;
    const uint32_t n = rows->n_function, size = rows->index_bytes;
    for (uint32_t row = 0; row < rows->n_row; row++) {
        const uint64_t stop = begin[row + 1];
        begin[row] = to;
        for (; e < stop; e++) {
            if (!job->keep[e]) continue;
            memmove(entry + to * n, entry + e * n, 2 * n);
            memmove(index + to * size, index + e * size, size);
            to++;
        }
    }
    begin[rows->n_row] = to;
}

// A copy of the first bytes of p, which is freed; p itself where memory is short.
static void *shorter(void *p, size_t bytes)
{
    void *q = prt_alloc(bytes + 1, 1);
    if (!q) return p;
    memcpy(q, p, bytes);
    prt_free(p);
    return q;
}

// Drops from freshly folded rows the entries that together hold error^2 of all energy.
static int thin(const struct prt_context *ctx, const struct prt_tensor *tensor,
                const uint32_t *object, double error, struct prt_rows *rows)
{
    float *weight = prt_calloc(rows->n_row, sizeof *weight);
    struct thin_job job = {.rows = rows,
                           .weight = weight,
                           .grain = (rows->n_row + CHUNKS - 1) / CHUNKS,
                           .bin = prt_calloc((size_t)CHUNKS * N_BIN, sizeof *job.bin),
                           .scaling = prt_calloc(CHUNKS, sizeof *job.scaling),
                           .keep = prt_alloc(rows->begin[rows->n_row] + 1, 1)};
    int status = weight && job.bin && job.scaling && job.keep ? PRT_OK : PRT_NOMEM;
    if (!status) status = weigh_rows(ctx, tensor, object, &job, weight);
    if (!status)
        status = prt_parallel_for(ctx, NULL, rows->n_row, job.grain, count_worth, &job);
    if (!status) {
        find_threshold(&job, error * error);
        status = prt_parallel_for(ctx, NULL, rows->n_row, job.grain, mark, &job);
    }
    if (!status) {
        compact(rows, &job);
        const uint64_t kept = rows->begin[rows->n_row];
        rows->entry = shorter((void *)(uintptr_t)rows->entry, 2 * kept * rows->n_function);
        rows->index = shorter((void *)(uintptr_t)rows->index, kept * rows->index_bytes);
    }
    prt_free(weight);
    prt_free(job.bin);
    prt_free(job.scaling);
    prt_free(job.keep);
    return status;
}

// The number of each row's medium.
static uint8_t *row_media(const struct prt_tensor *t, const uint8_t *medium)
{
    uint8_t *of_row = prt_calloc(t->rows.n_row + 1ull, 1);
    for (uint32_t c = 0; of_row && c < t->n_cluster; c++)
        memset(of_row + t->cluster[c].row_begin, medium[c], t->cluster[c].rank);
    return of_row;
}

int prt_rows_fold_planes(const struct prt_context *ctx, const struct prt_tensor *tensor,
                         const float *coef, const uint8_t *medium, const uint32_t *object,
                         double error, struct prt_rows *out)
{
    uint8_t *of_row = medium ? row_media(tensor, medium) : NULL;
    if (medium && !of_row) return prt_fail(ctx, PRT_NOMEM, "no memory to fold a material");
    int status = fold_all(ctx, tensor, coef, 3 * (size_t)tensor->n_radial, of_row, out);
    prt_free(of_row);
    if (status || !(status = thin(ctx, tensor, object, error, out))) return status;
    prt_rows_finish(out);
    return prt_fail(ctx, status, "no memory to fold a material");
}
