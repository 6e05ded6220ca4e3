// SPDX-License-Identifier: MIT
// Material first: rows over (phase, radial function) become rows over (phase, channel).
#include "kernels.h"

#include <string.h>

struct fold_job {
    const struct prt_tensor *tensor;
    const float *coef;
    uint16_t *entry, *scaling;
};

// One entry's n_phase * n_radial values to n_phase * 3.
static void fold_values(const struct fold_job *job, const float *value, uint16_t *out)
{
    const uint32_t n_radial = job->tensor->n_radial;
    for (uint32_t k = 0; k < job->tensor->n_phase; k++, value += n_radial) {
        float sum[3] = {0, 0, 0};
        for (uint32_t j = 0; j < n_radial; j++)
            for (int ch = 0; ch < 3; ch++) sum[ch] += value[j] * job->coef[3 * j + ch];
        prt_f32_to_f16_array(sum, 3, out + 3 * k);
    }
}

static void load_entry(const struct prt_rows *rows, uint32_t row, uint64_t e, float *value)
{
    const uint32_t n = rows->n_function;
    if (rows->value == PRT_VALUE_F16) {
        prt_f16_to_f32_array((const uint16_t *)rows->entry + e * n, n, value);
        return;
    }
    for (uint32_t j = 0; j < n; j++)
        value[j] = (float)((const int8_t *)rows->entry)[e * n + j] *
                   rows->scale[(uint64_t)row * n + j] * (rows->shift ? rows_factor(rows, e) : 1);
}

static int fold_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct fold_job *job = arg;
    const struct prt_rows *rows = &job->tensor->rows;
    const uint32_t n = rows->n_function, width = 3 * job->tensor->n_phase;
    float *value = prt_alloc(n, sizeof *value);
    if (!value) return PRT_NOMEM;
    for (size_t row = begin; row < end; row++) {
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            load_entry(rows, (uint32_t)row, e, value);
            fold_values(job, value, job->entry + e * width);
        }
        for (uint64_t f = 6 * row; f < 6 * row + 6; f++) {
            prt_f16_to_f32_array(rows->scaling + f * n, n, value);
            fold_values(job, value, job->scaling + f * width);
        }
    }
    prt_free(value);
    return PRT_OK;
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
