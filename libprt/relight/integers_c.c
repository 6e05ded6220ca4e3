// SPDX-License-Identifier: MIT
// The integer kernels in plain C: the reference for those of AVX2 and of AVX-512 VNNI, which
// have to return the same bits. Every step rounds where they round: coefficients and lights to
// 16 bits, to nearest even; sums of products are exact in 32 bits; floats are multiplied in
// their order. No machine runs these in place of f32: without the instructions they are slower.
#include "kernels.h"

#include <math.h>
#include <string.h>

static int16_t saturated(float x)
{
    const float y = rintf(x);
    return (int16_t)(y > INT16_MAX ? INT16_MAX : y < INT16_MIN ? INT16_MIN : y);
}

static void lights_to_integers(const struct integer_lights *q, unsigned n_light,
                               const float *const coef[], uint32_t begin, uint32_t end)
{
    const uint32_t n = q->n;
    const size_t lanes = q->lanes;
    for (uint32_t i = begin; i < end; i++) {
        const float gain = q->gain[(i | i / n) & (n - 1)];
        int16_t *lane = q->lane + lanes * i;
        memset(lane, 0, lanes * sizeof *lane);
        for (unsigned l = 0; l < n_light; l++)
            for (size_t ch = 0; ch < 3; ch++) {
                const float factor = q->scale[l][ch] * gain;
                lane[integer_lane_of(q, l) + ch] =
                    saturated(coef[l][4 * (size_t)i + ch] * factor);
            }
    }
}

// Sum over a row's blocks; within a block in integers. lane: of the light and channel, `lanes`
// from one coefficient to the next.
static float row_sum(const struct prt_rows *rows, uint32_t row, const int16_t *lane,
                     size_t lanes, uint32_t ch)
{
    const uint16_t *index = rows->index;
    const int16_t *pair = rows->entry;
    float sum = 0;
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1];) {
        int32_t block = 0;
        for (int k = 0; k < PRT_PAIR_BLOCK && e < rows->begin[row + 1]; k++, e++)
            block += pair[e / 2 * 6 + 2 * ch + e % 2] * lane[lanes * index[e]];
        sum += (float)block;
    }
    return sum;
}

static void pairs_group(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                        const struct integer_lights *q, unsigned n_light, size_t light_pitch,
                        size_t row_pitch, float *out)
{
    for (uint32_t row = begin; row < end; row++, out += row_pitch)
        for (unsigned l = 0; l < n_light; l++)
            for (uint32_t ch = 0; ch < 3; ch++) {
                const float factor = rows->scale[3ull * row + ch] * q->back[l][ch];
                float x =
                    row_sum(rows, row, q->lane + integer_lane_of(q, l) + ch, q->lanes, ch) *
                    factor;
                for (uint32_t f = 0; f < 6; f++)
                    x = fmaf(prt_f16_to_f32(rows->scaling[18ull * row + 3 * f + ch]),
                             q->scaling[f][l][ch], x);
                out[l * light_pitch + ch] = x;
            }
}

// One column (triple and channel) of the job's coefficients.
struct column {
    float back; // sums -> colours
    int16_t c[EXPAND_RANK_MOST];
};

// False when a coefficient is not finite.
static bool scale_column(const struct expand_job *job, uint32_t column, struct column *q)
{
    const float *b = job->b + column;
    float sum = 0, most = 0;
    for (uint32_t r = 0; r < job->rank; r++) {
        const float x = fabsf(b[r * job->b_stride]);
        sum += x;
        most = x > most ? x : most;
    }
    if (!(sum < 3e38f)) return false;
    q->back = 0;
    float scale = 0;
    if (sum > 1e-30f) {
        scale = fminf(EXPAND_SUM_MOST / sum, EXPAND_COEF_MOST / most);
        q->back = PRT_U_UNIT / scale;
    }
    for (uint32_t r = 0; r < job->rank; r++)
        q->c[r] = (int16_t)rintf(b[r * job->b_stride] * scale);
    return true;
}

static void expand_column(const struct expand_job *job, uint32_t column, const struct column *q)
{
    const int16_t *u = (const int16_t *)job->u;
    float *color = job->color[column / 3] + column % 3;
    for (uint32_t v = job->begin; v < job->end; v++) {
        int32_t sum = 0;
        for (uint32_t r = 0; r < job->rank; r++)
            sum += u[2 * (r / 2 * job->stride + v) + r % 2] * q->c[r];
        float *out = color + 3ull * job->order[v];
        const float x = (float)sum * q->back;
        *out = job->add ? *out + x : x;
    }
}

// Triples [t, t + n) in integers; false when they have to go in f32.
static bool expand_group(const struct expand_job *job, uint32_t t, uint32_t n)
{
    struct column column[24];
    for (uint32_t k = 0; k < 3 * n; k++)
        if (!scale_column(job, 3 * t + k, &column[k])) return false;
    for (uint32_t k = 0; k < 3 * n; k++) expand_column(job, 3 * t + k, &column[k]);
    return true;
}

static void expand(const struct expand_job *job)
{
    const uint32_t whole = job->rank <= EXPAND_RANK_MOST ? job->n_triple : 0;
    struct expand_job rest = *job;
    uint32_t t = 0;
    for (uint32_t n; t < whole; t += n) {
        n = whole - t >= 8 ? 8 : whole - t >= 4 ? 4 : 1;
        if (!expand_group(job, t, n)) break;
    }
    if (t == job->n_triple) return;
    rest.b += 3 * t;
    rest.color += t;
    rest.n_triple -= t;
    prt_kernels_c.expand(&rest);
}

const struct prt_kernels prt_kernels_integer_c = {.name = "integer_c",
                                                  .integers = true,
                                                  .quads = true,
                                                  .lights_to_integers = lights_to_integers,
                                                  .pairs_group = pairs_group,
                                                  .expand = expand};
