// SPDX-License-Identifier: MIT
// The kernels in plain C: the reference that the other variants are held against.
#include "kernels.h"
#include "prt/columns.h"

#include <string.h>

static float value(const struct prt_rows *rows, uint64_t i)
{
    if (rows->value == PRT_VALUE_PAIR) {
        const uint64_t e = i / 3;
        return (float)((const int16_t *)rows->entry)[e / 2 * 6 + i % 3 * 2 + e % 2];
    }
    return rows->value == PRT_VALUE_I8 ? (float)((const int8_t *)rows->entry)[i]
                                       : prt_f16_to_f32(((const uint16_t *)rows->entry)[i]);
}

// DIAGONAL: value j is multiplied with the light's channel j % 3 only.
static void row_diagonal(const struct prt_rows *rows, uint32_t row, const float *light,
                         float *out)
{
    uint32_t n = rows->n_function, face = rows->n_coef / 6;
    for (uint32_t j = 0; j < n; j++) {
        double sum = 0, fine = 0;
        for (uint32_t f = 0; f < 6; f++)
            sum += (double)prt_f16_to_f32(rows->scaling[((uint64_t)row * 6 + f) * n + j]) *
                   (double)light[(size_t)f * face * 4 + j % 3];
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++)
            fine += (double)value(rows, e * n + j) *
                    (double)light[rows_index(rows, e) * (size_t)4 + j % 3];
        if (rows->value != PRT_VALUE_F16) fine *= (double)rows->scale[(uint64_t)row * n + j];
        out[j] = (float)(sum + fine);
    }
}

static void diagonal(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out)
{
    for (uint32_t row = begin; row < end; row++)
        row_diagonal(rows, row, light, out + (size_t)(row - begin) * rows->n_function);
}

static float group_value(const struct prt_rows *rows, uint32_t row, uint32_t j, unsigned l,
                         const float *table)
{
    uint32_t n = rows->n_function, face = rows->n_coef / 6;
    const float *light = table + 3 * l + j % 3;
    double sum = 0, fine = 0;
    for (uint32_t f = 0; f < 6; f++)
        sum += (double)prt_f16_to_f32(rows->scaling[((uint64_t)row * 6 + f) * n + j]) *
               (double)light[(size_t)LIGHT_LANES * face * f];
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++)
        fine += (double)value(rows, e * n + j) *
                (double)light[(size_t)LIGHT_LANES * rows_index(rows, e)];
    if (rows->value != PRT_VALUE_F16) fine *= (double)rows->scale[(uint64_t)row * n + j];
    return (float)(sum + fine);
}

static void diagonal_group(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out)
{
    for (unsigned l = 0; l < n_light; l++)
        for (uint32_t row = begin; row < end; row++)
            for (uint32_t j = 0; j < rows->n_function; j++)
                out[l * light_pitch + (row - begin) * row_pitch + j] =
                    group_value(rows, row, j, l, table);
}

static void full(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out)
{
    uint32_t n = rows->n_function, face = rows->n_coef / 6;
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)n)
        for (uint32_t j = 0; j < n; j++)
            for (int ch = 0; ch < 3; ch++) {
                double sum = 0, fine = 0;
                for (uint32_t f = 0; f < 6; f++)
                    sum +=
                        (double)prt_f16_to_f32(rows->scaling[((uint64_t)row * 6 + f) * n + j]) *
                        (double)light[(size_t)f * face * 4 + ch];
                for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++)
                    fine += (double)value(rows, e * n + j) *
                            (double)light[rows_index(rows, e) * (size_t)4 + ch];
                out[3 * j + ch] = (float)(sum + fine);
            }
}

// Function j of entry e of a low-rank row.
static double mixed_value(const struct prt_rows *rows, uint32_t row, uint64_t e, uint32_t j)
{
    const uint32_t first = rows->direction[row], n = rows->direction[row + 1] - first;
    const int8_t *v =
        (const int8_t *)rows->entry + rows->value_begin[row] + (e - rows->begin[row]) * n;
    double sum = 0;
    for (uint32_t d = 0; d < n; d++)
        sum += v[d] * (double)rows->scale[first + d] *
               (double)prt_f16_to_f32(rows->mix[(uint64_t)(first + d) * rows->n_function + j]);
    return sum * (double)rows_factor(rows, e);
}

static void mixed(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                  float *out)
{
    uint32_t n = rows->n_function, face = rows->n_coef / 6;
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)n)
        for (uint32_t j = 0; j < n; j++) {
            double sum[3] = {0, 0, 0};
            for (uint32_t f = 0; f < 6; f++)
                for (int ch = 0; ch < 3; ch++)
                    sum[ch] +=
                        (double)prt_f16_to_f32(rows->scaling[((uint64_t)row * 6 + f) * n + j]) *
                        (double)light[(size_t)f * face * 4 + ch];
            for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
                double x = mixed_value(rows, row, e, j);
                for (int ch = 0; ch < 3; ch++)
                    sum[ch] += x * (double)light[rows_index(rows, e) * (size_t)4 + ch];
            }
            for (int ch = 0; ch < 3; ch++) out[3 * j + ch] = (float)sum[ch];
        }
}

static void expand(const struct expand_job *job)
{
    for (uint32_t v = job->begin; v < job->end; v++)
        for (uint32_t t = 0; t < job->n_triple; t++) {
            float sum[3] = {0, 0, 0}, *out = job->color[t] + 3ull * job->order[v];
            for (uint32_t r = 0; r < job->rank; r++) {
                const size_t at = 2 * (r / 2 * job->stride + v) + r % 2;
                const float u = (float)((const int16_t *)job->u)[at] * PRT_U_UNIT;
                for (int ch = 0; ch < 3; ch++)
                    sum[ch] += u * job->b[r * job->b_stride + 3 * t + ch];
            }
            for (int ch = 0; ch < 3; ch++) out[ch] = job->add ? out[ch] + sum[ch] : sum[ch];
        }
}

static void radial(const struct expand_job *job)
{
    for (uint32_t v = job->begin; v < job->end; v++)
        for (uint32_t t = 0; t < job->n_triple; t++) {
            float sum[3] = {0, 0, 0}, *out = job->color[t] + 3ull * job->order[v];
            const uint16_t *u = job->u + (size_t)t * job->rank * 3 * job->stride;
            for (uint32_t r = 0; r < job->rank; r++)
                for (int ch = 0; ch < 3; ch++)
                    sum[ch] += prt_f16_to_f32(u[(3 * (size_t)r + ch) * job->stride + v]) *
                               job->b[r * job->b_stride + ch];
            for (int ch = 0; ch < 3; ch++) out[ch] = job->add ? out[ch] + sum[ch] : sum[ch];
        }
}

static void material(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out)
{
    for (size_t i = 0; i < n; i++, in += 3 * (size_t)n_radial)
        for (int ch = 0; ch < 3; ch++) {
            float sum = 0;
            for (uint32_t j = 0; j < n_radial; j++) sum += in[3 * j + ch] * coef[3 * j + ch];
            out[3 * i + ch] = sum;
        }
}

void prt_columns_c(const struct column_part *part, size_t n, size_t stride, float *sum)
{
    for (const struct column_part *end = part + n; part < end; part++)
        for (unsigned l = 0; l < part->n_light; l++) {
            const int16_t *entry = part->entry;
            for (uint32_t k = 0; k < part->n[l]; k++) {
                float *to = sum + (part->unit[k] >> 5) * stride + part->at[l];
                for (uint32_t r = 0; r < PRT_COLUMN_ROWS; r++, to += 3) {
                    if (!(part->unit[k] >> r & 1)) continue;
                    for (int ch = 0; ch < 3; ch++) to[ch] += (float)entry[ch] * part->x[l][ch];
                    entry += 3;
                }
            }
        }
}

const struct prt_kernels prt_kernels_c = {.name = "c",
                                          .diagonal = diagonal,
                                          .diagonal_group = diagonal_group,
                                          .columns = prt_columns_c,
                                          .full = full,
                                          .mixed = mixed,
                                          .expand = expand,
                                          .radial = radial,
                                          .material = material};
