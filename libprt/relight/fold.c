// SPDX-License-Identifier: MIT
// Material first: rows over (phase, radial function) become rows over (phase, channel).
#include "kernels.h"

#include <string.h>

struct fold_job {
    const struct prt_tensor *tensor;
    const float *coef;
    uint16_t *entry, *scaling;
};

// n values to n_phase * 3: out[3 k + ch] = sum_j value[k * n_radial + j] coef[j][ch].
static void fold_values(const struct fold_job *job, const float *value, float *out)
{
    const uint32_t n_radial = job->tensor->n_radial;
    for (uint32_t k = 0; k < job->tensor->n_phase; k++, value += n_radial) {
        float sum[3] = {0, 0, 0};
        for (uint32_t j = 0; j < n_radial; j++)
            for (int ch = 0; ch < 3; ch++) sum[ch] += value[j] * job->coef[3 * j + ch];
        memcpy(out + 3 * k, sum, sizeof sum);
    }
}

// The same of halves, to halves. value: room for [n_function + 3 * n_phase].
static void fold_halves(const struct fold_job *job, const uint16_t *in, float *value,
                        uint16_t *out)
{
    const uint32_t n = job->tensor->rows.n_function;
    prt_f16_to_f32_array(in, n, value);
    fold_values(job, value, value + n);
    prt_f32_to_f16_array(value + n, 3 * job->tensor->n_phase, out);
}

// A mixed row: its directions are folded, then its entries are sums of these.
static void fold_mixed(const struct fold_job *job, uint32_t row, float *value, float *folded)
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
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++, entry += n) {
        const float factor = rows_factor(rows, e);
        memset(value, 0, width * sizeof *value);
        for (uint32_t d = 0; d < n; d++)
            for (uint32_t k = 0; k < width; k++)
                value[k] += factor * entry[d] * folded[(size_t)d * width + k];
        prt_f32_to_f16_array(value, width, job->entry + e * width);
    }
}

static int fold_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct fold_job *job = arg;
    const struct prt_rows *rows = &job->tensor->rows;
    const uint32_t n = rows->n_function, width = 3 * job->tensor->n_phase;
    float *value = prt_alloc((size_t)n + width, sizeof *value);
    float *folded = prt_alloc((size_t)PRT_ROWS_MOST_DIRECTIONS * width, sizeof *folded);
    int status = value && folded ? PRT_OK : PRT_NOMEM;
    for (size_t row = begin; row < end && !status; row++) {
        if (rows->direction) fold_mixed(job, (uint32_t)row, value, folded);
        for (uint64_t e = rows->begin[row]; !rows->direction && e < rows->begin[row + 1]; e++)
            fold_halves(job, (const uint16_t *)rows->entry + e * n, value, job->entry + e * width);
        for (uint64_t f = 6 * row; f < 6 * row + 6; f++)
            fold_halves(job, rows->scaling + f * n, value, job->scaling + f * width);
    }
    prt_free(value);
    prt_free(folded);
    return status;
}

int prt_rows_fold(const struct prt_context *ctx, const struct prt_tensor *tensor,
                  const float *coef, struct prt_rows *out)
{
    const struct prt_rows *rows = &tensor->rows;
    if (tensor->coupling != PRT_COUPLE_FULL || tensor->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_ARG, "this transport's material is fixed");
    if (!rows->n_row) return prt_fail(ctx, PRT_ARG, "this transport has no rows");
    uint64_t n_entry = rows->begin[rows->n_row], width = 3ull * tensor->n_phase;
    uint64_t *begin = prt_alloc(rows->n_row + 1ull, 8);
    char *index = prt_alloc(n_entry + 1, rows->index_bytes);
    struct fold_job job = {tensor, coef, prt_alloc(n_entry * width + 1, 2),
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

void prt_rows_finish(struct prt_rows *rows)
{
    prt_free((void *)(uintptr_t)rows->begin);
    prt_free((void *)(uintptr_t)rows->index);
    prt_free((void *)(uintptr_t)rows->entry);
    prt_free((void *)(uintptr_t)rows->scale);
    prt_free((void *)(uintptr_t)rows->scaling);
    *rows = (struct prt_rows){0};
}
