// SPDX-License-Identifier: MIT
// The kernels for AVX2 with FMA and F16C.
#include "avx2.h"

#include <string.h>

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)

enum { CHUNK = 8 };

// Converts n <= 8 values at p; no byte past them is read.
PRT_INLINE __m256 load_values(const void *p, bool i8, uint32_t n)
{
    if (n == CHUNK) {
        if (i8) return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64(p)));
        return _mm256_cvtph_ps(_mm_loadu_si128(p));
    }
    uint64_t raw[2] = {0, 0};
    if (i8) {
        memcpy(raw, p, n);
        return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)raw)));
    }
    memcpy(raw, p, 2 * (size_t)n);
    return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)raw));
}

// Three values to r g b x. `whole`: a fourth value lies behind them and may be read; else x is
// 0.
PRT_INLINE __m128 load3(const void *p, bool i8, bool whole)
{
    if (i8) {
        int32_t raw = 0;
        if (whole) memcpy(&raw, p, 4);
        else memcpy(&raw, p, 3);
        return _mm_cvtepi32_ps(_mm_cvtepi8_epi32(_mm_cvtsi32_si128(raw)));
    }
    uint64_t raw = 0;
    if (whole) memcpy(&raw, p, 8);
    else memcpy(&raw, p, 6);
    return _mm_cvtph_ps(_mm_cvtsi64_si128((long long)raw));
}

// Entry e of rows of one phase term; `whole` as above.
PRT_INLINE __m128 load_entry(const void *entry, uint64_t e, uint32_t kind, bool whole)
{
    if (kind == PRT_VALUE_PAIR) {
        const int16_t *p = (const int16_t *)entry + e / 2 * 6;
        int32_t blue;
        memcpy(&blue, p + 4, 4);
        __m128i rgb = _mm_insert_epi32(_mm_loadl_epi64((const __m128i *)p), blue, 2);
        return _mm_cvtepi32_ps(_mm_srai_epi32(e % 2 ? rgb : _mm_slli_epi32(rgb, 16), 16));
    }
    const bool i8 = kind == PRT_VALUE_I8;
    return load3((const char *)entry + (i8 ? 3 : 6) * e, i8, whole);
}

PRT_INLINE void store3(float *out, __m128 x)
{
    float lanes[4];
    _mm_storeu_ps(lanes, x);
    memcpy(out, lanes, 12);
}

PRT_INLINE void diagonal3(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                          const float *light, float *out, uint32_t kind)
{
    const uint64_t n_entry = rows->begin[rows->n_row];
    const size_t face = rows->n_coef / 6;
    for (uint32_t row = begin; row < end; row++, out += 3) {
        __m128 sum[4], scaling[6], dc = _mm_setzero_ps();
        for (int i = 0; i < 4; i++) sum[i] = _mm_setzero_ps();
        uint64_t e = rows->begin[row], stop = rows->begin[row + 1];
        uint64_t safe = stop < n_entry ? stop : stop - (stop > e);
        for (; e + 4 <= safe; e += 4)
            for (int i = 0; i < 4; i++)
                sum[i] = _mm_fmadd_ps(
                    load_entry(rows->entry, e + (uint64_t)i, kind, true),
                    _mm_loadu_ps(light + 4ull * rows_index(rows, e + (uint64_t)i)), sum[i]);
        for (; e < stop; e++)
            sum[0] = _mm_fmadd_ps(load_entry(rows->entry, e, kind, false),
                                  _mm_loadu_ps(light + 4ull * rows_index(rows, e)), sum[0]);
        load_scaling(rows->scaling + 18ull * row, scaling);
        for (size_t f = 0; f < 6; f++)
            dc = _mm_fmadd_ps(scaling[f], _mm_loadu_ps(light + 4 * face * f), dc);
        __m128 x = _mm_add_ps(_mm_add_ps(sum[0], sum[1]), _mm_add_ps(sum[2], sum[3]));
        if (kind != PRT_VALUE_F16) {
            const float *s = rows->scale + 3ull * row;
            x = _mm_mul_ps(x, _mm_setr_ps(s[0], s[1], s[2], 0));
        }
        store3(out, _mm_add_ps(x, dc));
    }
}

// Entries before the returned one may be read in whole vectors: these end inside the array.
// Values past an entry are not stored.
static uint64_t safe_end(const struct prt_rows *rows, uint64_t stop)
{
    uint64_t n_entry = rows->begin[rows->n_row], over = CHUNK / rows->n_function + 1;
    uint64_t safe = n_entry > over ? n_entry - over : 0;
    return stop < safe ? stop : safe;
}

// Channels of vector z: lane i holds value 8z+i, whose channel is (8z+i) % 3 = (2z+i) % 3.
PRT_INLINE __m256i channel_map(uint32_t z)
{
    const __m256i map[3] = {_mm256_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1),
                            _mm256_setr_epi32(2, 0, 1, 2, 0, 1, 2, 0),
                            _mm256_setr_epi32(1, 2, 0, 1, 2, 0, 1, 2)};
    return map[z % 3];
}

PRT_INLINE __m256 light_lanes(const float *light, __m256i map)
{
    return _mm256_permutevar8x32_ps(_mm256_castps128_ps256(_mm_loadu_ps(light)), map);
}

// DIAGONAL with several phase terms, nz vectors of 8 values from value j0 on.
PRT_INLINE void diagonal_part(const struct prt_rows *rows, uint32_t row, const float *light,
                              float *out, uint32_t j0, bool i8, const uint32_t nz)
{
    const uint32_t n = rows->n_function;
    const size_t size = i8 ? 1 : 2, face = rows->n_coef / 6;
    __m256 sum[2], dc[2];
    __m256i map[2];
    uint32_t have[2];
    for (uint32_t z = 0; z < nz; z++) {
        uint32_t left = n - j0 - 8 * z;
        sum[z] = dc[z] = _mm256_setzero_ps();
        map[z] = channel_map(j0 / 8 + z);
        have[z] = left < 8 ? left : 8;
    }
    uint64_t e = rows->begin[row], stop = rows->begin[row + 1], safe = safe_end(rows, stop);
    const char *entry = (const char *)rows->entry + (e * n + j0) * size;
    for (; e < safe; e++, entry += n * size) {
        const float *l = light + 4ull * rows_index(rows, e);
        for (uint32_t z = 0; z < nz; z++)
            sum[z] = _mm256_fmadd_ps(load_values(entry + 8 * z * size, i8, CHUNK),
                                     light_lanes(l, map[z]), sum[z]);
    }
    for (; e < stop; e++, entry += n * size) {
        const float *l = light + 4ull * rows_index(rows, e);
        for (uint32_t z = 0; z < nz; z++)
            sum[z] = _mm256_fmadd_ps(load_values(entry + 8 * z * size, i8, have[z]),
                                     light_lanes(l, map[z]), sum[z]);
    }
    for (size_t f = 0; f < 6; f++)
        for (uint32_t z = 0; z < nz; z++)
            dc[z] = _mm256_fmadd_ps(
                halves(rows->scaling + (6ull * row + f) * n + j0 + 8 * z, have[z], j0 + z > 0),
                light_lanes(light + 4 * face * f, map[z]), dc[z]);
    for (uint32_t z = 0; z < nz; z++) {
        float lanes[8], base[8];
        _mm256_storeu_ps(lanes, sum[z]);
        _mm256_storeu_ps(base, dc[z]);
        for (uint32_t i = 0; i < have[z]; i++) {
            uint32_t j = j0 + 8 * z + i;
            out[j] = lanes[i] * (i8 ? rows->scale[(uint64_t)n * row + j] : 1) + base[i];
        }
    }
}

static void diagonal(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out)
{
    const bool i8 = rows->value == PRT_VALUE_I8;
    const uint32_t n = rows->n_function;
    if (n == 3) {
        if (i8) diagonal3(rows, begin, end, light, out, PRT_VALUE_I8);
        else if (rows->value == PRT_VALUE_F16)
            diagonal3(rows, begin, end, light, out, PRT_VALUE_F16);
        else diagonal3(rows, begin, end, light, out, PRT_VALUE_PAIR);
        return;
    }
    for (uint32_t row = begin; row < end; row++, out += n)
        for (uint32_t j = 0; j < n; j += 16) {
            if (n - j > 8 && i8) diagonal_part(rows, row, light, out, j, true, 2);
            if (n - j > 8 && !i8) diagonal_part(rows, row, light, out, j, false, 2);
            if (n - j <= 8) diagonal_part(rows, row, light, out, j, i8, 1);
        }
}

// The 24 sums of eight lights and three channels, light after light, in three vectors.
struct group_sum {
    __m256 part[3];
};

PRT_INLINE void group_fma(struct group_sum *sum, __m128 rgb, const __m256 light[3])
{
    const __m256 v = _mm256_castps128_ps256(rgb);
    for (uint32_t z = 0; z < 3; z++)
        sum->part[z] = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(v, channel_map(z)), light[z],
                                       sum->part[z]);
}

PRT_INLINE void group_phase(const struct prt_rows *rows, uint32_t row, const float *table,
                            unsigned n_light, size_t light_pitch, float *out, uint32_t k,
                            uint32_t kind)
{
    const uint32_t n = rows->n_function;
    const bool i8 = kind == PRT_VALUE_I8;
    const size_t size = i8 ? 1 : 2, face = rows->n_coef / 6;
    struct group_sum fine, dc;
    __m256 light[3];
    float lanes[LIGHT_LANES], base[LIGHT_LANES];
    for (int z = 0; z < 3; z++) fine.part[z] = dc.part[z] = _mm256_setzero_ps();
    const char *entry = (const char *)rows->entry + (rows->begin[row] * n + 3ull * k) * size;
    uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    for (uint64_t e = rows->begin[row]; e < stop; e++, entry += n * size) {
        const float *p = table + (size_t)LIGHT_LANES * rows_index(rows, e);
        for (int z = 0; z < 3; z++) light[z] = _mm256_loadu_ps(p + 8 * z);
        __m128 v = kind == PRT_VALUE_PAIR ? load_entry(rows->entry, e, kind, true)
                                          : load3(entry, i8, e + 1 < n_entry);
        group_fma(&fine, v, light);
    }
    for (size_t f = 0; f < 6; f++) {
        const float *p = table + LIGHT_LANES * face * f;
        for (int z = 0; z < 3; z++) light[z] = _mm256_loadu_ps(p + 8 * z);
        group_fma(&dc, load3(rows->scaling + (6ull * row + f) * n + 3ull * k, false, f < 5),
                  light);
    }
    for (int z = 0; z < 3; z++) {
        _mm256_storeu_ps(lanes + 8 * z, fine.part[z]);
        _mm256_storeu_ps(base + 8 * z, dc.part[z]);
    }
    const float *scale = kind == PRT_VALUE_F16 ? NULL : rows->scale + (uint64_t)n * row + 3 * k;
    for (unsigned l = 0; l < n_light; l++)
        for (int ch = 0; ch < 3; ch++)
            out[l * light_pitch + 3 * k + ch] =
                lanes[3 * l + ch] * (scale ? scale[ch] : 1) + base[3 * l + ch];
}

static void diagonal_group(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out)
{
    const uint32_t n = rows->n_function, kind = rows->value;
#define GROUP_PHASE(kind) group_phase(rows, row, table, n_light, light_pitch, out, k, kind)
    for (uint32_t row = begin; row < end; row++, out += row_pitch)
        for (uint32_t k = 0; k < n / 3; k++) {
            if (kind == PRT_VALUE_I8) GROUP_PHASE(PRT_VALUE_I8);
            if (kind == PRT_VALUE_F16) GROUP_PHASE(PRT_VALUE_F16);
            if (kind == PRT_VALUE_PAIR) GROUP_PHASE(PRT_VALUE_PAIR);
        }
#undef GROUP_PHASE
}

// FULL, halves: nz vectors of 8 functions from j0 on, each with three channels.
PRT_INLINE void full_part(const struct prt_rows *rows, uint32_t row, const float *light,
                          float *out, uint32_t j0, const uint32_t nz)
{
    const uint32_t n = rows->n_function;
    const size_t size = 2, face = rows->n_coef / 6;
    __m256 sum[2][3], dc[2][3];
    uint32_t have[2];
    for (uint32_t z = 0; z < nz; z++) {
        uint32_t left = n - j0 - 8 * z;
        have[z] = left < 8 ? left : 8;
        for (int ch = 0; ch < 3; ch++) sum[z][ch] = dc[z][ch] = _mm256_setzero_ps();
    }
    uint64_t e = rows->begin[row], stop = rows->begin[row + 1], safe = safe_end(rows, stop);
    const char *entry = (const char *)rows->entry + (e * n + j0) * size;
    for (; e < safe; e++, entry += n * size) {
        const float *l = light + 4ull * rows_index(rows, e);
        for (uint32_t z = 0; z < nz; z++) {
            __m256 v = load_values(entry + 8 * z * size, false, CHUNK);
            for (int ch = 0; ch < 3; ch++)
                sum[z][ch] = _mm256_fmadd_ps(v, _mm256_broadcast_ss(l + ch), sum[z][ch]);
        }
    }
    for (; e < stop; e++, entry += n * size) {
        const float *l = light + 4ull * rows_index(rows, e);
        for (uint32_t z = 0; z < nz; z++) {
            __m256 v = load_values(entry + 8 * z * size, false, have[z]);
            for (int ch = 0; ch < 3; ch++)
                sum[z][ch] = _mm256_fmadd_ps(v, _mm256_broadcast_ss(l + ch), sum[z][ch]);
        }
    }
    for (size_t f = 0; f < 6; f++)
        for (uint32_t z = 0; z < nz; z++) {
            __m256 v =
                halves(rows->scaling + (6ull * row + f) * n + j0 + 8 * z, have[z], j0 + z > 0);
            for (int ch = 0; ch < 3; ch++)
                dc[z][ch] = _mm256_fmadd_ps(v, _mm256_broadcast_ss(light + 4 * face * f + ch),
                                            dc[z][ch]);
        }
    for (uint32_t z = 0; z < nz; z++)
        for (int ch = 0; ch < 3; ch++) {
            float lanes[8], base[8];
            _mm256_storeu_ps(lanes, sum[z][ch]);
            _mm256_storeu_ps(base, dc[z][ch]);
            for (uint32_t i = 0; i < have[z]; i++) {
                uint32_t j = j0 + 8 * z + i;
                out[3 * j + ch] = lanes[i] + base[i];
            }
        }
}

static void full(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out)
{
    const uint32_t n = rows->n_function;
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)n)
        for (uint32_t j = 0; j < n; j += 16) {
            if (n - j > 8) full_part(rows, row, light, out, j, 2);
            else full_part(rows, row, light, out, j, 1);
        }
}

// Sums over three vectors at a time (24 = 8 * 3), so that a lane keeps its channel.
static void material(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out)
{
    const uint32_t width = 3 * n_radial;
    for (size_t i = 0; i < n; i++, in += width, out += 3) {
        __m256 sum[3] = {_mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps()};
        float lanes[24], rgb[3] = {0, 0, 0};
        uint32_t j = 0;
        for (; j + 24 <= width; j += 24)
            for (uint32_t z = 0; z < 3; z++)
                sum[z] = _mm256_fmadd_ps(_mm256_loadu_ps(in + j + 8 * z),
                                         _mm256_loadu_ps(coef + j + 8 * z), sum[z]);
        for (uint32_t z = 0; z < 3; z++) _mm256_storeu_ps(lanes + 8 * z, sum[z]);
        for (; j < width; j++) rgb[j % 3] += in[j] * coef[j];
        for (uint32_t l = 0; l < 24; l++) rgb[l % 3] += lanes[l];
        memcpy(out, rgb, 12);
    }
}

const struct prt_kernels prt_kernels_avx2 = {.name = "avx2",
                                             .integers = true,
                                             .diagonal = diagonal,
                                             .diagonal_group = diagonal_group,
                                             .lights_to_integers = prt_integer_lights_fill_avx2,
                                             .pairs_group = prt_pairs_avx2,
                                             .quads = true,
                                             .columns = prt_columns_avx2,
                                             .full = full,
                                             .mixed = prt_mixed_avx2,
                                             .expand = prt_expand_integers_avx2,
                                             .radial = prt_radial_avx2,
                                             .material = material};

PRT_ISA_END
#endif
