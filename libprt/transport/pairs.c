// SPDX-License-Identifier: MIT
// Rounds rows of halves to rows of pairs of 16-bit integers.
#include <math.h>
#include <string.h>

#include "prt/transport.h"

float prt_pair_gain(uint32_t n, uint32_t index)
{
    // the larger of x and y has as many bits as the level's size
    const uint32_t bits = (index | index / n) & (n - 1);
    if (!bits) return 1;
    float gain = 1;
    for (uint32_t top = n / 2; !(bits & top); top /= 2) gain *= 2;
    return gain;
}

struct source {
    const struct prt_rows *rows;
    uint32_t n; // of the cube
};

static float scaled_down(const struct source *s, uint64_t e, uint32_t ch)
{
    const uint32_t index = ((const uint16_t *)s->rows->index)[e];
    return prt_f16_to_f32(((const uint16_t *)s->rows->entry)[3 * e + ch]) /
           prt_pair_gain(s->n, index);
}

// The integer that stands for 1 in a row's channel, the largest that entries and block sums
// allow.
static float steps(const struct source *s, uint64_t begin, uint64_t end, uint32_t ch)
{
    double most = 0, most_sum = 0;
    for (uint64_t e = begin; e < end; e += PRT_PAIR_BLOCK) {
        double sum = 0;
        for (uint64_t k = e; k < end && k < e + PRT_PAIR_BLOCK; k++) {
            const double x = fabs((double)scaled_down(s, k, ch));
            sum += x;
            most = fmax(most, x);
        }
        most_sum = fmax(most_sum, sum);
    }
    const double sum_most = PRT_PAIR_MOST - PRT_PAIR_BLOCK / 2;
    const double step = most > 0 ? fmin(sum_most / most_sum, 32767 / most) : 0;
    return step < 1e30 ? (float)step : 0;
}

static void fill_row(const struct source *s, uint32_t row, uint64_t at,
                     const struct prt_rows *out)
{
    const uint64_t begin = s->rows->begin[row], end = s->rows->begin[row + 1];
    uint16_t *index = (uint16_t *)(uintptr_t)out->index + at;
    int16_t *pair = (int16_t *)(uintptr_t)out->entry + 3 * at;
    float *scale = (float *)(uintptr_t)out->scale + 3ull * row;
    if (begin == end) return;
    memcpy(index, (const uint16_t *)s->rows->index + begin, 2 * (end - begin));
    if ((end - begin) % 2)
        index[end - begin] = index[end - begin - 1]; // an entry of value 0 completes the pair
    for (uint32_t ch = 0; ch < 3; ch++) {
        const float step = steps(s, begin, end, ch);
        scale[ch] = step > 0 ? 1 / step : 0;
        for (uint64_t e = begin; e < end; e++)
            pair[(e - begin) / 2 * 6 + 2 * ch + (e - begin) % 2] =
                (int16_t)lrintf(scaled_down(s, e, ch) * step);
    }
}

int prt_rows_pair(const struct prt_rows *rows, struct prt_rows *out)
{
    struct source s = {rows, 1};
    uint64_t *begin = prt_alloc(rows->n_row + 1ull, sizeof *begin), n = 0;
    while (6 * s.n * s.n < rows->n_coef) s.n *= 2;
    for (uint32_t row = 0; begin && row < rows->n_row; row++) {
        begin[row] = n;
        n += (rows->begin[row + 1] - rows->begin[row] + 1) / 2 * 2;
    }
    const size_t scaling = 18ull * rows->n_row;
    uint16_t *base = prt_alloc(scaling + 1, sizeof *base);
    *out = *rows;
    out->value = PRT_VALUE_PAIR;
    out->begin = begin;
    out->index = prt_calloc(n + 1, 2);
    out->entry = prt_calloc(3 * n + 1, 2);
    out->scale = prt_calloc(3ull * rows->n_row + 1, sizeof *out->scale);
    out->scaling = base;
    if (!begin || !out->index || !out->entry || !out->scale || !base) {
        prt_rows_finish(out);
        return PRT_NOMEM;
    }
    begin[rows->n_row] = n;
    memcpy(base, rows->scaling, scaling * sizeof *base);
    for (uint32_t row = 0; row < rows->n_row; row++) fill_row(&s, row, begin[row], out);
    return PRT_OK;
}

void prt_rows_finish(struct prt_rows *rows)
{
    const void *const own[] = {rows->begin, rows->index, rows->entry, rows->scale,
                               rows->scaling};
    for (size_t i = 0; i < sizeof own / sizeof *own; i++) prt_free((void *)(uintptr_t)own[i]);
    *rows = (struct prt_rows){0};
}
