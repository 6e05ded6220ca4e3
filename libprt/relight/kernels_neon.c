// SPDX-License-Identifier: MIT
// The kernels for arm64 with NEON.
#include "kernels.h"
#include "prt/columns.h"
#include "spread.h"

#include <string.h>

#if PRT_ISA_ARM64

// ---- rows times light

// Three values to r g b x. `whole`: a fourth value lies behind them and may be read.
PRT_INLINE float32x4_t load3(const void *p, bool i8, bool whole)
{
    uint64_t raw = 0;
    if (i8) {
        memcpy(&raw, p, whole ? 4 : 3);
        const int16x8_t wide = vmovl_s8(vcreate_s8(raw));
        return vcvtq_f32_s32(vmovl_s16(vget_low_s16(wide)));
    }
    memcpy(&raw, p, whole ? 8 : 6);
    return vcvt_f32_f16(vcreate_f16(raw));
}

// Both entries of a pair, r g b 0 each.
struct pair {
    float32x4_t first, second;
};

PRT_INLINE struct pair load_pair(const int16_t *p)
{
    uint64_t raw[2] = {0, 0};
    memcpy(raw, p, 12);
    const int16x8_t x = vcombine_s16(vcreate_s16(raw[0]), vcreate_s16(raw[1]));
    return (struct pair){vcvtq_f32_s32(vmovl_s16(vget_low_s16(vuzp1q_s16(x, x)))),
                         vcvtq_f32_s32(vmovl_s16(vget_low_s16(vuzp2q_s16(x, x))))};
}

PRT_INLINE void store3(float *out, float32x4_t x)
{
    float lanes[4];
    vst1q_f32(lanes, x);
    memcpy(out, lanes, 12);
}

PRT_INLINE float32x4_t light_at(const struct prt_rows *rows, const float *light, uint64_t e)
{
    return vld1q_f32(light + 4ull * rows_index(rows, e));
}

// The triple at value j0 of a row's entries under one light, without the scaling coefficients.
PRT_INLINE float32x4_t triple_sum(const struct prt_rows *rows, uint32_t row, const float *light,
                                  uint32_t j0, uint32_t kind)
{
    const uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    const uint32_t n = rows->n_function;
    const bool i8 = kind == PRT_VALUE_I8;
    const size_t pitch = n * (i8 ? 1 : 2);
    float32x4_t sum[4];
    for (int i = 0; i < 4; i++) sum[i] = vdupq_n_f32(0);
    uint64_t e = rows->begin[row];
    if (kind == PRT_VALUE_PAIR) {
        const int16_t *p = (const int16_t *)rows->entry + 3 * e;
        for (; e < stop; e += 4, p += 12) {
            struct pair v = load_pair(p);
            sum[0] = vfmaq_f32(sum[0], v.first, light_at(rows, light, e));
            sum[1] = vfmaq_f32(sum[1], v.second, light_at(rows, light, e + 1));
            if (e + 2 == stop) break;
            v = load_pair(p + 6);
            sum[2] = vfmaq_f32(sum[2], v.first, light_at(rows, light, e + 2));
            sum[3] = vfmaq_f32(sum[3], v.second, light_at(rows, light, e + 3));
        }
    } else {
        const char *p = (const char *)rows->entry + e * pitch + j0 * (i8 ? 1 : 2);
        const uint64_t safe = stop < n_entry ? stop : stop - (stop > e);
        for (; e + 4 <= safe; e += 4)
            for (uint64_t i = 0; i < 4; i++, p += pitch)
                sum[i] = vfmaq_f32(sum[i], load3(p, i8, true), light_at(rows, light, e + i));
        for (; e < stop; e++, p += pitch)
            sum[0] = vfmaq_f32(sum[0], load3(p, i8, false), light_at(rows, light, e));
    }
    return vaddq_f32(vaddq_f32(sum[0], sum[1]), vaddq_f32(sum[2], sum[3]));
}

PRT_INLINE void diagonal_triple(const struct prt_rows *rows, uint32_t row, const float *light,
                                float *out, uint32_t j0, uint32_t kind)
{
    const uint32_t n = rows->n_function;
    const size_t face = rows->n_coef / 6;
    float32x4_t x = triple_sum(rows, row, light, j0, kind);
    if (kind != PRT_VALUE_F16) {
        float scale[4] = {0};
        memcpy(scale, rows->scale + (uint64_t)n * row + j0, 12);
        x = vmulq_f32(x, vld1q_f32(scale));
    }
    for (size_t f = 0; f < 6; f++)
        x = vfmaq_f32(x, load3(rows->scaling + (6ull * row + f) * n + j0, false, f < 5),
                      vld1q_f32(light + 4 * face * f));
    store3(out + j0, x);
}

// Four triples, 12 values: three vectors in which channels rotate, r g b r, g b r g, b r g b.
struct twelve {
    float32x4_t x[3];
};

PRT_INLINE struct twelve load12(const void *p, bool i8)
{
    if (!i8) {
        const uint16_t *h = p;
        return (struct twelve){{vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(h))),
                                vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(h + 4))),
                                vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(h + 8)))}};
    }
    uint64_t raw[2] = {0, 0};
    memcpy(raw, p, 12);
    const int16x8_t lo = vmovl_s8(vcreate_s8(raw[0])), hi = vmovl_s8(vcreate_s8(raw[1]));
    return (struct twelve){{vcvtq_f32_s32(vmovl_s16(vget_low_s16(lo))),
                            vcvtq_f32_s32(vmovl_s16(vget_high_s16(lo))),
                            vcvtq_f32_s32(vmovl_s16(vget_low_s16(hi)))}};
}

// r g b x in the three rotations.
PRT_INLINE struct twelve rotate(float32x4_t rgb)
{
    struct twelve r;
    r.x[0] = vcopyq_laneq_f32(rgb, 3, rgb, 0);
    r.x[1] = vcopyq_laneq_f32(vextq_f32(r.x[0], r.x[0], 1), 3, rgb, 1);
    r.x[2] = vextq_f32(r.x[0], r.x[1], 2);
    r.x[2] = vcopyq_laneq_f32(vcopyq_laneq_f32(r.x[2], 2, rgb, 1), 3, rgb, 2);
    return r;
}

PRT_INLINE void diagonal_twelve(const struct prt_rows *rows, uint32_t row, const float *light,
                                float *out, uint32_t j0, bool i8)
{
    const uint32_t n = rows->n_function;
    const size_t size = i8 ? 1 : 2, face = rows->n_coef / 6;
    const char *p = (const char *)rows->entry + (rows->begin[row] * n + j0) * size;
    struct twelve sum;
    for (int z = 0; z < 3; z++) sum.x[z] = vdupq_n_f32(0);
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++, p += n * size) {
        const struct twelve v = load12(p, i8), l = rotate(light_at(rows, light, e));
        for (int z = 0; z < 3; z++) sum.x[z] = vfmaq_f32(sum.x[z], v.x[z], l.x[z]);
    }
    for (int z = 0; z < 3 && i8; z++)
        sum.x[z] = vmulq_f32(sum.x[z],
                             vld1q_f32(rows->scale + (uint64_t)n * row + j0 + 4 * (uint32_t)z));
    for (size_t f = 0; f < 6; f++) {
        const struct twelve v = load12(rows->scaling + (6ull * row + f) * n + j0, false);
        const struct twelve l = rotate(vld1q_f32(light + 4 * face * f));
        for (int z = 0; z < 3; z++) sum.x[z] = vfmaq_f32(sum.x[z], v.x[z], l.x[z]);
    }
    for (int z = 0; z < 3; z++) vst1q_f32(out + j0 + 4 * z, sum.x[z]);
}

static void diagonal(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out)
{
    const uint32_t n = rows->n_function, kind = rows->value;
    for (uint32_t row = begin; row < end; row++, out += n) {
        uint32_t j = 0;
        for (; j + 12 <= n; j += 12) {
            if (kind == PRT_VALUE_I8) diagonal_twelve(rows, row, light, out, j, true);
            else diagonal_twelve(rows, row, light, out, j, false);
        }
        for (; j < n; j += 3) {
            if (kind == PRT_VALUE_I8) diagonal_triple(rows, row, light, out, j, PRT_VALUE_I8);
            if (kind == PRT_VALUE_F16) diagonal_triple(rows, row, light, out, j, PRT_VALUE_F16);
            if (kind == PRT_VALUE_PAIR)
                diagonal_triple(rows, row, light, out, j, PRT_VALUE_PAIR);
        }
    }
}

// ---- rows times several lights: 24 lanes, light after light

struct lanes {
    float32x4_t x[6];
};

PRT_INLINE void add_lights(struct lanes *sum, float32x4_t rgb, const float *table, uint32_t i)
{
    const float *light = table + (size_t)LIGHT_LANES * i;
    const struct twelve v = rotate(rgb);
    for (int z = 0; z < 6; z++)
        sum->x[z] = vfmaq_f32(sum->x[z], v.x[z % 3], vld1q_f32(light + 4 * z));
}

PRT_INLINE void group_triple(const struct prt_rows *rows, uint32_t row, const float *table,
                             unsigned n_light, size_t light_pitch, float *out, uint32_t j0,
                             uint32_t kind)
{
    const uint32_t n = rows->n_function, face = rows->n_coef / 6;
    const bool i8 = kind == PRT_VALUE_I8;
    const size_t size = i8 ? 1 : 2;
    const uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    const char *p = (const char *)rows->entry + (rows->begin[row] * n + j0) * size;
    struct lanes sum;
    for (int z = 0; z < 6; z++) sum.x[z] = vdupq_n_f32(0);
    for (uint64_t e = rows->begin[row]; e < stop; e++, p += n * size) {
        if (kind == PRT_VALUE_PAIR) {
            const struct pair v = load_pair((const int16_t *)rows->entry + 3 * e);
            add_lights(&sum, v.first, table, rows_index(rows, e));
            add_lights(&sum, v.second, table, rows_index(rows, ++e));
        } else {
            add_lights(&sum, load3(p, i8, e + 1 < n_entry), table, rows_index(rows, e));
        }
    }
    if (kind != PRT_VALUE_F16) {
        float scale[4] = {0};
        memcpy(scale, rows->scale + (uint64_t)n * row + j0, 12);
        const struct twelve s = rotate(vld1q_f32(scale));
        for (int z = 0; z < 6; z++) sum.x[z] = vmulq_f32(sum.x[z], s.x[z % 3]);
    }
    for (uint32_t f = 0; f < 6; f++)
        add_lights(&sum, load3(rows->scaling + (6ull * row + f) * n + j0, false, f < 5), table,
                   face * f);
    float all[LIGHT_LANES];
    for (int z = 0; z < 6; z++) vst1q_f32(all + 4 * z, sum.x[z]);
    for (unsigned l = 0; l < n_light; l++) memcpy(out + l * light_pitch + j0, all + 3 * l, 12);
}

static void diagonal_group(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out)
{
    const uint32_t n = rows->n_function, kind = rows->value;
#define GROUP_TRIPLE(kind) group_triple(rows, row, table, n_light, light_pitch, out, j, kind)
    for (uint32_t row = begin; row < end; row++, out += row_pitch)
        for (uint32_t j = 0; j < n; j += 3) {
            if (kind == PRT_VALUE_I8) GROUP_TRIPLE(PRT_VALUE_I8);
            if (kind == PRT_VALUE_F16) GROUP_TRIPLE(PRT_VALUE_F16);
            if (kind == PRT_VALUE_PAIR) GROUP_TRIPLE(PRT_VALUE_PAIR);
        }
#undef GROUP_TRIPLE
}

// ---- FULL rows: each function under three channels

// n <= 4 halves; none behind them is read.
PRT_INLINE float32x4_t load_halves(const uint16_t *p, uint32_t n)
{
    if (n >= 4) return vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(p)));
    uint64_t raw = 0;
    memcpy(&raw, p, 2 * (size_t)n);
    return vcvt_f32_f16(vcreate_f16(raw));
}

PRT_INLINE void add_channels(float32x4x3_t *sum, float32x4_t v, float32x4_t light)
{
    sum->val[0] = vfmaq_laneq_f32(sum->val[0], v, light, 0);
    sum->val[1] = vfmaq_laneq_f32(sum->val[1], v, light, 1);
    sum->val[2] = vfmaq_laneq_f32(sum->val[2], v, light, 2);
}

// Functions [j, j + n), n <= 4, to out[j][3].
PRT_INLINE void store_functions(float32x4x3_t sum, uint32_t j, uint32_t n, float *out)
{
    float all[12];
    if (n >= 4) {
        vst3q_f32(out + 3ull * j, sum);
        return;
    }
    vst3q_f32(all, sum);
    memcpy(out + 3ull * j, all, 12ull * n);
}

static float32x4x3_t no_sums(void)
{
    const float32x4_t zero = vdupq_n_f32(0);
    return (float32x4x3_t){{zero, zero, zero}};
}

PRT_INLINE void full_part(const struct prt_rows *rows, uint32_t row, const float *light,
                          float *out, uint32_t j0, const uint32_t nz)
{
    const uint32_t n = rows->n_function;
    const size_t face = rows->n_coef / 6;
    const uint16_t *entry = (const uint16_t *)rows->entry + rows->begin[row] * n + j0;
    float32x4x3_t sum[4];
    uint32_t have[4];
    for (uint32_t z = 0; z < nz; z++) {
        sum[z] = no_sums();
        have[z] = n - j0 - 4 * z < 4 ? n - j0 - 4 * z : 4;
    }
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++, entry += n) {
        const float32x4_t l = light_at(rows, light, e);
        for (uint32_t z = 0; z < nz; z++)
            add_channels(&sum[z], load_halves(entry + 4 * z, have[z]), l);
    }
    for (size_t f = 0; f < 6; f++) {
        const uint16_t *p = rows->scaling + (6ull * row + f) * n + j0;
        const float32x4_t l = vld1q_f32(light + 4 * face * f);
        for (uint32_t z = 0; z < nz; z++)
            add_channels(&sum[z], load_halves(p + 4 * z, have[z]), l);
    }
    for (uint32_t z = 0; z < nz; z++) store_functions(sum[z], j0 + 4 * z, have[z], out);
}

static void full(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out)
{
    const uint32_t n = rows->n_function;
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)n) {
        uint32_t j = 0;
        for (; n - j > 12; j += n - j < 16 ? n - j : 16) full_part(rows, row, light, out, j, 4);
        if (n - j > 8) full_part(rows, row, light, out, j, 3);
        else if (n - j > 4) full_part(rows, row, light, out, j, 2);
        else if (n > j) full_part(rows, row, light, out, j, 1);
    }
}

// Components [d0, d0 + 4) of a low-rank row of n: weight[d][ch].
static void component_sums(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t d0,
                           const float *light, float weight[PRT_ROWS_MOST_DIRECTIONS][4])
{
    const uint32_t have = n - d0 < 4 ? n - d0 : 4;
    const int8_t *value = (const int8_t *)rows->entry + rows->value_begin[row] + d0;
    float32x4x3_t sum = no_sums();
    float lanes[3][4];
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++, value += n) {
        uint32_t raw = 0;
        memcpy(&raw, value, have);
        const int16x8_t wide = vmovl_s8(vcreate_s8(raw));
        const float32x4_t v = vcvtq_f32_s32(vmovl_s16(vget_low_s16(wide)));
        add_channels(&sum, vmulq_n_f32(v, rows_factor(rows, e)), light_at(rows, light, e));
    }
    for (int ch = 0; ch < 3; ch++) vst1q_f32(lanes[ch], sum.val[ch]);
    for (uint32_t d = 0; d < have; d++)
        for (int ch = 0; ch < 3; ch++)
            weight[d0 + d][ch] = lanes[ch][d] * rows->scale[rows->direction[row] + d0 + d];
}

static void mixed(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                  float *out)
{
    const uint32_t J = rows->n_function;
    const size_t face = rows->n_coef / 6;
    float weight[PRT_ROWS_MOST_DIRECTIONS][4];
    memset(weight, 0, sizeof weight);
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)J) {
        const uint32_t n = rows->direction[row + 1] - rows->direction[row];
        const uint16_t *mix = rows->mix + (uint64_t)rows->direction[row] * J;
        const uint16_t *scaling = rows->scaling + 6ull * row * J;
        for (uint32_t d = 0; d < n; d += 4) component_sums(rows, row, n, d, light, weight);
        for (uint32_t j = 0; j < J; j += 4) {
            const uint32_t have = J - j < 4 ? J - j : 4;
            float32x4x3_t sum = no_sums();
            for (size_t f = 0; f < 6; f++)
                add_channels(&sum, load_halves(scaling + f * J + j, have),
                             vld1q_f32(light + 4 * face * f));
            for (uint32_t d = 0; d < n; d++)
                add_channels(&sum, load_halves(mix + (size_t)d * J + j, have),
                             vld1q_f32(weight[d]));
            store_functions(sum, j, have, out);
        }
    }
}

// ---- contracted rows to colours

// Colours of vertices [v, v + 4), as many as the job has.
PRT_INLINE void put4(const struct expand_job *job, uint32_t v, uint32_t t, float32x4x3_t rgb)
{
    float all[12];
    const uint32_t n = job->end - v < 4 ? job->end - v : 4;
    vst3q_f32(all, rgb);
    for (uint32_t i = 0; i < n; i++) {
        float *out = job->color[t] + 3ull * job->order[v + i];
        for (int ch = 0; ch < 3 && job->add; ch++) all[3 * i + (uint32_t)ch] += out[ch];
        memcpy(out, all + 3 * i, 12);
    }
}

// nt triples of nv vectors of 4 vertices from v on: the sums stay in registers.
PRT_INLINE void expand_block(const struct expand_job *job, uint32_t v, uint32_t t0,
                             const uint32_t nt, const uint32_t nv)
{
    float32x4_t sum[4][3][4];
    const int16_t *u = (const int16_t *)job->u + 2 * (size_t)v;
    const float *b = job->b + 3 * t0;
    for (uint32_t t = 0; t < nt; t++)
        for (int ch = 0; ch < 3; ch++)
            for (uint32_t i = 0; i < nv; i++) sum[t][ch][i] = vdupq_n_f32(0);
    for (uint32_t r = 0; r < job->rank; r += 2, u += 2 * job->stride, b += 2 * job->b_stride) {
        const float *other = r + 1 < job->rank ? b + job->b_stride : b; // U has 0 there
        for (uint32_t i = 0; i < nv; i++) {
            const int32x4_t two = vreinterpretq_s32_s16(vld1q_s16(u + 8 * i));
            const float32x4_t x = vcvtq_f32_s32(vshrq_n_s32(vshlq_n_s32(two, 16), 16));
            const float32x4_t y = vcvtq_f32_s32(vshrq_n_s32(two, 16));
            for (uint32_t t = 0; t < nt; t++)
                for (uint32_t ch = 0; ch < 3; ch++) {
                    float32x4_t *s = &sum[t][ch][i];
                    *s = vfmaq_n_f32(*s, x, b[3 * t + ch]);
                    *s = vfmaq_n_f32(*s, y, other[3 * t + ch]);
                }
        }
    }
    for (uint32_t t = 0; t < nt; t++)
        for (uint32_t i = 0; i < nv && v + 4 * i < job->end; i++) {
            float32x4x3_t rgb;
            for (int ch = 0; ch < 3; ch++) rgb.val[ch] = vmulq_n_f32(sum[t][ch][i], PRT_U_UNIT);
            put4(job, v + 4 * i, t0 + t, rgb);
        }
}

static void expand(const struct expand_job *job)
{
    const uint32_t n = job->n_triple;
    for (uint32_t v = job->begin; v < job->end; v += 16) { // U is padded to 16 vertices
        uint32_t t = 0;
        for (; n - t >= 4; t += 4)
            for (uint32_t i = v; i < v + 16 && i < job->end; i += 4)
                expand_block(job, i, t, 4, 1);
        for (; t < n; t++) expand_block(job, v, t, 1, 4);
    }
}

static void radial(const struct expand_job *job)
{
    for (uint32_t v = job->begin; v < job->end; v += 8)
        for (uint32_t t = 0; t < job->n_triple; t++) {
            float32x4x3_t sum[2] = {no_sums(), no_sums()};
            const uint16_t *u = job->u + (size_t)t * job->rank * 3 * job->stride + v;
            const float *b = job->b;
            for (uint32_t r = 0; r < job->rank; r++, b += job->b_stride)
                for (int ch = 0; ch < 3; ch++, u += job->stride)
                    for (int i = 0; i < 2; i++)
                        sum[i].val[ch] =
                            vfmaq_n_f32(sum[i].val[ch], load_halves(u + 4 * i, 4), b[ch]);
            put4(job, v, t, sum[0]);
            if (v + 4 < job->end) put4(job, v + 4, t, sum[1]);
        }
}

static void material(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out)
{
    for (size_t i = 0; i < n; i++, in += 3 * (size_t)n_radial, out += 3) {
        float32x4x3_t sum = no_sums();
        float rgb[3] = {0, 0, 0};
        uint32_t j = 0;
        for (; j + 4 <= n_radial; j += 4) {
            const float32x4x3_t x = vld3q_f32(in + 3 * j), c = vld3q_f32(coef + 3 * j);
            for (int ch = 0; ch < 3; ch++)
                sum.val[ch] = vfmaq_f32(sum.val[ch], x.val[ch], c.val[ch]);
        }
        for (j *= 3; j < 3 * n_radial; j++) rgb[j % 3] += in[j] * coef[j];
        for (int ch = 0; ch < 3; ch++) out[ch] = rgb[ch] + vaddvq_f32(sum.val[ch]);
    }
}

// Eight of a unit's lanes as floats: the entries spread over them (spread.h).
static inline float32x4x2_t spread_half(const int16_t *entry, const char *shuffle)
{
    const int8x16_t x =
        vqtbl1q_s8(vreinterpretq_s8_s16(vld1q_s16(entry)), vld1q_u8((const uint8_t *)shuffle));
    const int16x8_t lane = vreinterpretq_s16_s8(x);
    return (float32x4x2_t){{vcvtq_f32_s32(vmovl_s16(vget_low_s16(lane))),
                            vcvtq_f32_s32(vmovl_s16(vget_high_s16(lane)))}};
}

// The units of one light.
static void column_light(const struct column_part *part, unsigned l, size_t stride, float *sum)
{
    const float *c = part->x[l];
    float lane[PRT_COLUMN_LANES] = {0};
    for (int i = 0; i < 3 * PRT_COLUMN_ROWS; i++) lane[i] = c[i % 3];
    const float32x4x4_t x = vld1q_f32_x4(lane);
    const int16_t *entry = part->entry;
    for (uint32_t k = 0; k < part->n[l]; k++) {
        const uint32_t unit = part->unit[k];
        const struct spread *s = &spreads[unit & 31];
        float *to = sum + (unit >> 5) * stride + part->at[l];
        const float32x4x2_t a = spread_half(entry, s->shuffle);
        const float32x4x2_t b = spread_half(entry + s->half, s->shuffle + 16);
        vst1q_f32(to, vfmaq_f32(vld1q_f32(to), a.val[0], x.val[0]));
        vst1q_f32(to + 4, vfmaq_f32(vld1q_f32(to + 4), a.val[1], x.val[1]));
        vst1q_f32(to + 8, vfmaq_f32(vld1q_f32(to + 8), b.val[0], x.val[2]));
        vst1q_f32(to + 12, vfmaq_f32(vld1q_f32(to + 12), b.val[1], x.val[3]));
        entry += s->n;
    }
}

static void columns(const struct column_part *part, size_t n, size_t stride, float *sum)
{
    for (const struct column_part *end = part + n; part < end; part++)
        for (unsigned l = 0; l < part->n_light; l++) column_light(part, l, stride, sum);
}

const struct prt_kernels prt_kernels_neon = {.name = "neon",
                                             .diagonal = diagonal,
                                             .diagonal_group = diagonal_group,
                                             .columns = columns,
                                             .full = full,
                                             .mixed = mixed,
                                             .expand = expand,
                                             .radial = radial,
                                             .material = material};
#endif
