// SPDX-License-Identifier: MIT
// The kernels for AVX-512 (F, BW, DQ, VL): rows times light and material. expand_avx512.c has
// the expansion, mixed_avx512.c low-rank rows.
#include "avx512.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX512)

// Four light rows, r g b x each. Halves are joined in 256 bits: faster than four inserts.
PRT_INLINE __m512 light4(const float *light, size_t i0, size_t i1, size_t i2, size_t i3)
{
    __m256 lo = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(light + 4 * i0)),
                                     _mm_loadu_ps(light + 4 * i1), 1);
    __m256 hi = _mm256_insertf128_ps(_mm256_castps128_ps256(_mm_loadu_ps(light + 4 * i2)),
                                     _mm_loadu_ps(light + 4 * i3), 1);
    return _mm512_insertf32x8(_mm512_castps256_ps512(lo), hi, 1);
}

// Values of four entries of three functions as r g b 0 each. n: 5 when at least two more
// entries follow in the array, so that whole vectors may be read; else how many entries there
// are.
PRT_INLINE __m512 spread4(const void *entry, uint64_t e, uint32_t kind, uint32_t n)
{
    if (kind == PRT_VALUE_I8) {
        const __m128i map = _mm_setr_epi8(0, 1, 2, -1, 3, 4, 5, -1, 6, 7, 8, -1, 9, 10, 11, -1);
        const char *p = (const char *)entry + 3 * e;
        __m128i raw = n == 5 ? _mm_loadu_si128((const __m128i *)p)
                             : _mm_maskz_loadu_epi8((__mmask16)((1u << 3 * n) - 1), p);
        return _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_shuffle_epi8(raw, map)));
    }
    const __m256i map =
        kind == PRT_VALUE_PAIR
            ? _mm256_setr_epi16(0, 2, 4, 15, 1, 3, 5, 15, 6, 8, 10, 15, 7, 9, 11, 15)
            : _mm256_setr_epi16(0, 1, 2, 15, 3, 4, 5, 15, 6, 7, 8, 15, 9, 10, 11, 15);
    const char *p = (const char *)entry + 6 * e;
    __m256i raw = n == 5 ? _mm256_loadu_si256((const __m256i *)p)
                         : _mm256_maskz_loadu_epi16((__mmask16)((1u << 3 * n) - 1), p);
    raw = _mm256_maskz_permutexvar_epi16(0x7777, map, raw);
    if (kind == PRT_VALUE_PAIR) return _mm512_cvtepi32_ps(_mm512_cvtepi16_epi32(raw));
    return _mm512_cvtph_ps(raw);
}

#define INDEX(e) (wide ? ((const uint32_t *)index)[e] : ((const uint16_t *)index)[e])

PRT_INLINE __m512 diagonal3_sum(const void *index, const void *entry, uint64_t e, uint64_t end,
                                uint64_t safe, const float *light, uint32_t kind, bool wide)
{
    __m512 a = _mm512_setzero_ps(), b = a;
    // reads of whole vectors before `safe` end inside the array
    uint64_t stop = end < safe ? end : safe;
    for (; e + 8 <= stop; e += 8) {
        // rows are read once, from memory: prefetch them
        _mm_prefetch((const char *)entry + (kind == PRT_VALUE_I8 ? 3 : 6) * e + 3072,
                     _MM_HINT_T0);
        _mm_prefetch((const char *)index + (wide ? 4 : 2) * e + 1536, _MM_HINT_T0);
        a = _mm512_fmadd_ps(spread4(entry, e, kind, 5),
                            light4(light, INDEX(e), INDEX(e + 1), INDEX(e + 2), INDEX(e + 3)),
                            a);
        b = _mm512_fmadd_ps(
            spread4(entry, e + 4, kind, 5),
            light4(light, INDEX(e + 4), INDEX(e + 5), INDEX(e + 6), INDEX(e + 7)), b);
    }
    for (; e < end; e += 4) {
        uint32_t n = end - e < 4 ? (uint32_t)(end - e) : 4;
        size_t i0 = INDEX(e), i1 = n > 1 ? INDEX(e + 1) : i0, i2 = n > 2 ? INDEX(e + 2) : i0;
        size_t i3 = n > 3 ? INDEX(e + 3) : i0;
        a = _mm512_fmadd_ps(spread4(entry, e, kind, n), light4(light, i0, i1, i2, i3), a);
    }
    return _mm512_add_ps(a, b);
}

enum { ROWS_AHEAD = 8 };

// Prefetches a row's metadata some rows ahead; the hardware prefetcher does not follow these
// short streams. n: functions.
PRT_INLINE void prefetch_row(const struct prt_rows *rows, uint32_t row, const uint32_t n,
                             bool scaled)
{
    const uint64_t ahead = row + (uint64_t)ROWS_AHEAD;
    const char *scaling = (const char *)(rows->scaling + 6 * n * ahead);
    for (uint32_t at = 0; at < 12 * n; at += 64) _mm_prefetch(scaling + at, _MM_HINT_T0);
    _mm_prefetch((const char *)(rows->begin + ahead), _MM_HINT_T0);
    if (scaled) _mm_prefetch((const char *)(rows->scale + n * ahead), _MM_HINT_T0);
}

PRT_INLINE __m128 fold4(__m512 z)
{
    __m256 y = _mm256_add_ps(_mm512_castps512_ps256(z), _mm512_extractf32x8_ps(z, 1));
    return _mm_add_ps(_mm256_castps256_ps128(y), _mm256_extractf128_ps(y, 1));
}

PRT_INLINE void diagonal3(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                          const float *light, float *out, uint32_t kind, bool wide)
{
    uint64_t n_entry = rows->begin[rows->n_row], safe = n_entry > 2 ? n_entry - 2 : 0;
    size_t face = rows->n_coef / 6;
    const __m512 dc0 = light4(light, 0, face, 2 * face, 3 * face);
    const __m512 dc1 = light4(light, 4 * face, 5 * face, 0, 0);
    for (uint32_t row = begin; row < end; row++, out += 3) {
        const uint16_t *scaling = rows->scaling + 18ull * row;
        prefetch_row(rows, row, 3, kind != PRT_VALUE_F16);
        __m512 z = diagonal3_sum(rows->index, rows->entry, rows->begin[row],
                                 rows->begin[row + 1], safe, light, kind, wide);
        __m512 dc = _mm512_mul_ps(spread4(scaling, 0, PRT_VALUE_F16, 4), dc0);
        dc = _mm512_fmadd_ps(spread4(scaling, 4, PRT_VALUE_F16, 2), dc1, dc);
        __m128 x;
        if (kind != PRT_VALUE_F16)
            x = _mm_fmadd_ps(fold4(z), _mm_maskz_loadu_ps(7, rows->scale + 3ull * row),
                             fold4(dc));
        else x = fold4(_mm512_add_ps(z, dc));
        _mm_mask_storeu_ps(out, 7, x);
    }
}

// Converts 16 values at p; only those in the mask are read.
PRT_INLINE __m512 load_values(const void *p, bool i8, __mmask16 mask)
{
    if (i8) return _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_maskz_loadu_epi8(mask, p)));
    return _mm512_cvtph_ps(_mm256_maskz_loadu_epi16(mask, p));
}

PRT_INLINE __mmask16 lane_mask(uint32_t n)
{
    return (__mmask16)(n >= 16 ? 0xffff : (1u << n) - 1);
}

// Channels of vector z: lane i holds value 16z+i, whose channel is (16z+i) % 3 = (z+i) % 3.
PRT_INLINE __m512i channel_map(int z)
{
    __m512i map[3] = {_mm512_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0),
                      _mm512_setr_epi32(1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1),
                      _mm512_setr_epi32(2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2)};
    return map[z % 3];
}

// DIAGONAL rows of several phase terms: the 3P values of an entry fill nz vectors.
PRT_INLINE void diagonal_many(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                              const float *light, float *out, bool i8, const int nz)
{
    const uint32_t n = rows->n_function;
    const size_t size = i8 ? 1 : 2, pitch = n * size;
    const size_t face = rows->n_coef / 6;
    __m512i map[3];
    __mmask16 mask[3];
    for (int z = 0; z < nz; z++) {
        map[z] = channel_map(z);
        mask[z] = lane_mask(n - 16 * (uint32_t)z);
    }
    for (uint32_t row = begin; row < end; row++, out += n) {
        __m512 sum[3], odd[3], dc[3];
        const char *entry = (const char *)rows->entry + rows->begin[row] * pitch;
        prefetch_row(rows, row, n, i8);
        for (int z = 0; z < nz; z++) sum[z] = odd[z] = dc[z] = _mm512_setzero_ps();
        uint64_t e = rows->begin[row], stop = rows->begin[row + 1];
        for (; e + 2 <= stop; e += 2, entry += 2 * pitch) {
            // rows are read once, from memory: prefetch them
            for (size_t ahead = 0; ahead < 32 * (size_t)nz * size; ahead += 64)
                _mm_prefetch(entry + 3072 + ahead, _MM_HINT_T0);
            _mm_prefetch((const char *)rows->index + rows->index_bytes * e + 512, _MM_HINT_T0);
            __m512 l = _mm512_castps128_ps512(_mm_loadu_ps(light + 4ull * rows_index(rows, e)));
            __m512 m =
                _mm512_castps128_ps512(_mm_loadu_ps(light + 4ull * rows_index(rows, e + 1)));
            for (int z = 0; z < nz; z++) {
                sum[z] = _mm512_fmadd_ps(load_values(entry + 16 * z * size, i8, mask[z]),
                                         _mm512_permutexvar_ps(map[z], l), sum[z]);
                odd[z] =
                    _mm512_fmadd_ps(load_values(entry + pitch + 16 * z * size, i8, mask[z]),
                                    _mm512_permutexvar_ps(map[z], m), odd[z]);
            }
        }
        if (e < stop) {
            __m512 l = _mm512_castps128_ps512(_mm_loadu_ps(light + 4ull * rows_index(rows, e)));
            for (int z = 0; z < nz; z++)
                sum[z] = _mm512_fmadd_ps(load_values(entry + 16 * z * size, i8, mask[z]),
                                         _mm512_permutexvar_ps(map[z], l), sum[z]);
        }
        const uint16_t *scaling = rows->scaling + 6ull * n * row;
        for (int f = 0; f < 6; f++, scaling += n) {
            __m512 l = _mm512_castps128_ps512(_mm_loadu_ps(light + 4 * face * (size_t)f));
            for (int z = 0; z < nz; z++)
                dc[z] = _mm512_fmadd_ps(load_values(scaling + 16 * z, false, mask[z]),
                                        _mm512_permutexvar_ps(map[z], l), dc[z]);
        }
        for (int z = 0; z < nz; z++) {
            __m512 x = _mm512_add_ps(sum[z], odd[z]);
            if (i8)
                x = _mm512_fmadd_ps(
                    x, _mm512_maskz_loadu_ps(mask[z], rows->scale + (uint64_t)n * row + 16 * z),
                    dc[z]);
            else x = _mm512_add_ps(x, dc[z]);
            _mm512_mask_storeu_ps(out + 16 * z, mask[z], x);
        }
    }
}

static void diagonal(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const float *light, float *out)
{
    bool i8 = rows->value == PRT_VALUE_I8, wide = rows->index_bytes == 4;
    uint32_t n = rows->n_function;
    if (n == 3) {
        if (rows->value == PRT_VALUE_PAIR)
            diagonal3(rows, begin, end, light, out, PRT_VALUE_PAIR, false);
        else if (i8 && !wide) diagonal3(rows, begin, end, light, out, PRT_VALUE_I8, false);
        else if (!wide) diagonal3(rows, begin, end, light, out, PRT_VALUE_F16, false);
        else if (i8) diagonal3(rows, begin, end, light, out, PRT_VALUE_I8, true);
        else diagonal3(rows, begin, end, light, out, PRT_VALUE_F16, true);
    } else if (n <= 16) {
        if (i8) diagonal_many(rows, begin, end, light, out, true, 1);
        if (!i8) diagonal_many(rows, begin, end, light, out, false, 1);
    } else if (n <= 32) {
        diagonal_many(rows, begin, end, light, out, i8, 2);
    } else {
        diagonal_many(rows, begin, end, light, out, i8, 3);
    }
}

// The 24 lanes of a table's row are light-major, in vectors of 16 and 8. These maps spread
// triple t of a vector of values to r g b r g b ...
struct group_maps {
    __m512i lo[4], hi[2]; // hi: the 8 last lanes, of two triples
    __m256i half[2];      // the 8 last lanes, of one
};

PRT_INLINE struct group_maps group_maps(void)
{
    struct group_maps m;
    const __m256i one = _mm512_castsi512_si256(channel_map(1));
    const __m512i tail = _mm512_inserti32x8(_mm512_castsi256_si512(one), one, 1);
    const __m512i second = _mm512_maskz_set1_epi32(0xff00, 3);
    for (int t = 0; t < 4; t++)
        m.lo[t] = _mm512_add_epi32(channel_map(0), _mm512_set1_epi32(3 * t));
    for (int t = 0; t < 2; t++) {
        m.hi[t] = _mm512_add_epi32(_mm512_add_epi32(tail, second), _mm512_set1_epi32(6 * t));
        m.half[t] = _mm256_add_epi32(one, _mm256_set1_epi32(3 * t));
    }
    return m;
}

// 24 lanes.
struct lanes {
    __m512 lo;
    __m256 hi;
};

PRT_INLINE struct lanes no_lanes(void)
{
    return (struct lanes){_mm512_setzero_ps(), _mm256_setzero_ps()};
}

PRT_INLINE struct lanes add_lanes(struct lanes a, struct lanes b)
{
    return (struct lanes){_mm512_add_ps(a.lo, b.lo), _mm256_add_ps(a.hi, b.hi)};
}

// Adds triple t (0 or 1) of v times the lights.
PRT_INLINE void accumulate(struct lanes *sum, __m256 v, int t, const struct group_maps *m,
                           struct lanes light)
{
    __m512 wide = _mm512_permutexvar_ps(m->lo[t], _mm512_castps256_ps512(v));
    sum->lo = _mm512_fmadd_ps(wide, light.lo, sum->lo);
    sum->hi = _mm256_fmadd_ps(_mm256_permutevar8x32_ps(v, m->half[t]), light.hi, sum->hi);
}

PRT_INLINE struct lanes lights_at(const float *table, size_t i)
{
    const float *p = table + LIGHT_LANES * i;
    return (struct lanes){_mm512_loadu_ps(p), _mm256_loadu_ps(p + 16)};
}

// Eight values at p: two triples and two values more.
PRT_INLINE __m256 load_two(const char *p, bool i8)
{
    if (i8)
        return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_loadl_epi64((const __m128i *)p)));
    return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)p));
}

// Two entries of a pair, in the order of load_two.
PRT_INLINE __m256 load_pair(const char *p)
{
    const __m128i map = _mm_setr_epi8(0, 1, 4, 5, 8, 9, 2, 3, 6, 7, 10, 11, -1, -1, -1, -1);
    const __m128i raw = _mm_maskz_loadu_epi16(0x3f, p);
    return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(_mm_shuffle_epi8(raw, map)));
}

// The first n of two triples; the others are 0 and are not read.
PRT_INLINE __m256 load_some(const char *p, bool i8, uint32_t n)
{
    const __mmask8 mask = (__mmask8)((1u << 3 * n) - 1);
    if (i8) return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_maskz_loadu_epi8(mask, p)));
    return _mm256_cvtph_ps(_mm_maskz_loadu_epi16(mask, p));
}

// Writes the first 3 * n_light of a row's 24 sums to out[light*pitch + ch].
PRT_INLINE void group_store(struct lanes x, unsigned n_light, size_t pitch, float *out)
{
    float lanes[LIGHT_LANES];
    if (pitch == 3) {
        const uint32_t n = 3 * n_light;
        _mm512_mask_storeu_ps(out, lane_mask(n), x.lo);
        if (n > 16) _mm256_mask_storeu_ps(out + 16, (__mmask8)((1u << (n - 16)) - 1), x.hi);
        return;
    }
    _mm512_storeu_ps(lanes, x.lo);
    _mm256_storeu_ps(lanes + 16, x.hi);
    for (unsigned l = 0; l < n_light; l++)
        for (int ch = 0; ch < 3; ch++) out[l * pitch + (size_t)ch] = lanes[3 * l + (size_t)ch];
}

// fine * scale[ch] + base; a NULL scale is 1.
PRT_INLINE struct lanes scaled(struct lanes fine, const float *scale, struct lanes base,
                               const struct group_maps *m)
{
    if (!scale) return add_lanes(fine, base);
    const __m512 s = _mm512_maskz_loadu_ps(7, scale);
    const __m256 low = _mm512_castps512_ps256(s);
    return (struct lanes){
        _mm512_fmadd_ps(fine.lo, _mm512_permutexvar_ps(m->lo[0], s), base.lo),
        _mm256_fmadd_ps(fine.hi, _mm256_permutevar8x32_ps(low, m->half[0]), base.hi)};
}

// The triple's sum over the scaling coefficients at scaling[3*first + 3*f*pitch ...].
PRT_INLINE struct lanes group_scaling(const struct prt_rows *rows, uint64_t first,
                                      uint64_t pitch, const float *table,
                                      const struct group_maps *m)
{
    const uint16_t *p = rows->scaling + 3 * first;
    const size_t face = rows->n_coef / 6;
    struct lanes a = no_lanes(), b = a;
    for (size_t f = 0; f < 6; f += 2, p += 6 * pitch) {
        __m256 v = load_some((const char *)p, false, pitch == 1 ? 2 : 1), w = v;
        if (pitch != 1) w = load_some((const char *)(p + 3 * pitch), false, 1);
        accumulate(&a, v, 0, m, lights_at(table, face * f));
        accumulate(&b, w, pitch == 1, m, lights_at(table, face * (f + 1)));
    }
    return add_lanes(a, b);
}

// Entries [e, stop) of one phase term. Four independent sums hide the latency of the additions.
PRT_INLINE struct lanes group3_sum(const struct prt_rows *rows, uint64_t e, uint64_t stop,
                                   const float *table, const struct group_maps *m,
                                   uint32_t kind, bool wide)
{
    const bool i8 = kind == PRT_VALUE_I8, pair = kind == PRT_VALUE_PAIR;
    const void *index = rows->index;
    const size_t size = i8 ? 3 : 6;
    const uint64_t n_entry = rows->begin[rows->n_row];
    // two entries are read as whole vectors while a third one follows
    const uint64_t safe = stop < n_entry ? stop : n_entry - (n_entry > 0);
    const char *entry = (const char *)rows->entry + e * size;
    struct lanes s[4];
    for (int k = 0; k < 4; k++) s[k] = no_lanes();
    for (; e + 4 <= safe; e += 4, entry += 4 * size) {
        // rows are read once, from memory: prefetch them
        _mm_prefetch(entry + 1024, _MM_HINT_T0);
        _mm_prefetch((const char *)index + (wide ? 4 : 2) * e + 512, _MM_HINT_T0);
        const __m256 v = pair ? load_pair(entry) : load_two(entry, i8);
        const __m256 w = pair ? load_pair(entry + 2 * size) : load_two(entry + 2 * size, i8);
        accumulate(&s[0], v, 0, m, lights_at(table, INDEX(e)));
        accumulate(&s[1], v, 1, m, lights_at(table, INDEX(e + 1)));
        accumulate(&s[2], w, 0, m, lights_at(table, INDEX(e + 2)));
        accumulate(&s[3], w, 1, m, lights_at(table, INDEX(e + 3)));
    }
    for (; e < stop; e += 4, entry += 4 * size) {
        const uint32_t n = stop - e < 4 ? (uint32_t)(stop - e) : 4;
        const __m256 v = pair ? load_pair(entry) : load_some(entry, i8, n < 2 ? 1 : 2);
        const __m256 w = !pair   ? load_some(entry + 2 * size, i8, n < 3 ? 0 : n - 2)
                         : n > 2 ? load_pair(entry + 2 * size)
                                 : _mm256_setzero_ps();
        accumulate(&s[0], v, 0, m, lights_at(table, INDEX(e)));
        accumulate(&s[1], v, 1, m, lights_at(table, INDEX(e + (n > 1 ? 1 : 0))));
        accumulate(&s[2], w, 0, m, lights_at(table, INDEX(e + (n > 2 ? 2 : 0))));
        accumulate(&s[3], w, 1, m, lights_at(table, INDEX(e + (n > 3 ? 3 : 0))));
    }
    return add_lanes(add_lanes(s[0], s[1]), add_lanes(s[2], s[3]));
}

// One phase term.
PRT_INLINE void group3(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                       const float *table, unsigned n_light, size_t light_pitch,
                       size_t row_pitch, float *out, uint32_t kind, bool wide)
{
    const struct group_maps m = group_maps();
    for (uint32_t row = begin; row < end; row++, out += row_pitch) {
        prefetch_row(rows, row, 3, kind != PRT_VALUE_F16);
        struct lanes x =
            group3_sum(rows, rows->begin[row], rows->begin[row + 1], table, &m, kind, wide);
        struct lanes base = group_scaling(rows, 6ull * row, 1, table, &m);
        x = scaled(x, kind == PRT_VALUE_F16 ? NULL : rows->scale + 3ull * row, base, &m);
        group_store(x, n_light, light_pitch, out);
    }
}

// Phase terms [k0, k0 + nk), nk 4 or 1: one vector holds these values of an entry.
PRT_INLINE void group_phase(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                            const float *table, unsigned n_light, size_t light_pitch,
                            size_t row_pitch, float *out, uint32_t k0, const uint32_t nk)
{
    const struct group_maps m = group_maps();
    const bool i8 = rows->value == PRT_VALUE_I8;
    const uint32_t n = rows->n_function, p = n / 3;
    const size_t size = i8 ? 1 : 2;
    const __mmask16 mask = lane_mask(3 * nk);
    for (uint32_t row = begin; row < end; row++, out += row_pitch) {
        __m512 lo[4], hi[2];
        prefetch_row(rows, row, n, i8);
        for (int t = 0; t < 4; t++) lo[t] = hi[t / 2] = _mm512_setzero_ps();
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            const char *entry = (const char *)rows->entry + (e * n + 3ull * k0) * size;
            const struct lanes light = lights_at(table, rows_index(rows, e));
            _mm_prefetch(entry + 1024, _MM_HINT_T0);
            __m512 v = load_values(entry, i8, mask);
            __m512 high = _mm512_broadcast_f32x8(light.hi);
            for (uint32_t t = 0; t < nk; t++)
                lo[t] = _mm512_fmadd_ps(_mm512_permutexvar_ps(m.lo[t], v), light.lo, lo[t]);
            for (uint32_t t = 0; t < nk; t += 2)
                hi[t / 2] =
                    _mm512_fmadd_ps(_mm512_permutexvar_ps(m.hi[t / 2], v), high, hi[t / 2]);
        }
        for (uint32_t t = 0; t < nk; t++) {
            struct lanes x = {lo[t], t % 2 ? _mm512_extractf32x8_ps(hi[t / 2], 1)
                                           : _mm512_castps512_ps256(hi[t / 2])};
            struct lanes base = group_scaling(rows, 6ull * p * row + k0 + t, p, table, &m);
            x = scaled(x, i8 ? rows->scale + (uint64_t)n * row + 3 * (k0 + t) : NULL, base, &m);
            group_store(x, n_light, light_pitch, out + 3 * (k0 + t));
        }
    }
}

static void diagonal_group(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const float *table, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, float *out)
{
    const uint32_t p = rows->n_function / 3;
    const bool i8 = rows->value == PRT_VALUE_I8, wide = rows->index_bytes == 4;
#define GROUP3(kind, wide) \
    group3(rows, begin, end, table, n_light, light_pitch, row_pitch, out, kind, wide)
    if (p == 1) {
        if (rows->value == PRT_VALUE_PAIR) GROUP3(PRT_VALUE_PAIR, false);
        else if (i8 && !wide) GROUP3(PRT_VALUE_I8, false);
        else if (!wide) GROUP3(PRT_VALUE_F16, false);
        else if (i8) GROUP3(PRT_VALUE_I8, true);
        else GROUP3(PRT_VALUE_F16, true);
        return;
    }
    uint32_t k = 0;
    for (; k + 4 <= p; k += 4)
        group_phase(rows, begin, end, table, n_light, light_pitch, row_pitch, out, k, 4);
    for (; k < p; k++)
        group_phase(rows, begin, end, table, n_light, light_pitch, row_pitch, out, k, 1);
}

// FULL, halves: nz vectors of 16 functions from j0 on, each with three channels.
PRT_INLINE void full_part(const struct prt_rows *rows, uint32_t row, const float *light,
                          float *out, uint32_t j0, const int nz)
{
    const uint32_t n = rows->n_function;
    const size_t size = 2, face = rows->n_coef / 6;
    __m512 sum[4][3], dc[4][3];
    __mmask16 mask[4];
    for (int z = 0; z < nz; z++) {
        mask[z] = lane_mask(n - j0 - 16 * (uint32_t)z);
        for (int ch = 0; ch < 3; ch++) sum[z][ch] = dc[z][ch] = _mm512_setzero_ps();
    }
    const char *entry = (const char *)rows->entry + (rows->begin[row] * n + j0) * size;
    for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++, entry += n * size) {
        const float *l = light + 4ull * rows_index(rows, e);
        _mm_prefetch(entry + 2048, _MM_HINT_T0);
        if (nz > 2) _mm_prefetch(entry + 2112, _MM_HINT_T0);
        for (int z = 0; z < nz; z++) {
            __m512 v = load_values(entry + 16 * z * size, false, mask[z]);
            for (int ch = 0; ch < 3; ch++)
                sum[z][ch] = _mm512_fmadd_ps(v, _mm512_set1_ps(l[ch]), sum[z][ch]);
        }
    }
    for (size_t f = 0; f < 6; f++)
        for (int z = 0; z < nz; z++) {
            __m512 v =
                load_values(rows->scaling + (6ull * row + f) * n + j0 + 16 * z, false, mask[z]);
            for (int ch = 0; ch < 3; ch++)
                dc[z][ch] =
                    _mm512_fmadd_ps(v, _mm512_set1_ps(light[4 * face * f + ch]), dc[z][ch]);
        }
    for (int z = 0; z < nz; z++) {
        float lanes[3][16];
        uint32_t j1 = j0 + 16 * (uint32_t)z, nj = n - j1 < 16 ? n - j1 : 16;
        for (int ch = 0; ch < 3; ch++)
            _mm512_storeu_ps(lanes[ch], _mm512_add_ps(sum[z][ch], dc[z][ch]));
        for (uint32_t j = 0; j < nj; j++)
            for (int ch = 0; ch < 3; ch++) out[3 * (j1 + j) + ch] = lanes[ch][j];
    }
}

static void full(const struct prt_rows *rows, uint32_t begin, uint32_t end, const float *light,
                 float *out)
{
    const uint32_t n = rows->n_function;
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)n) {
        uint32_t j = 0;
        for (; n - j > 48; j += 64) {
            full_part(rows, row, light, out, j, 4);
            if (n - j <= 64) break;
        }
        if (n - j > 48) continue;
        if (n - j > 32) full_part(rows, row, light, out, j, 3);
        else if (n - j > 16) full_part(rows, row, light, out, j, 2);
        else if (n > j) full_part(rows, row, light, out, j, 1);
    }
}

// Five functions a vector, 15 lanes: a lane keeps its channel.
enum { FIVE = 15, MOST_FIVES = 8 };

PRT_INLINE __m512 five_mask(const float *p, uint32_t j, uint32_t width)
{
    return _mm512_maskz_loadu_ps(width - j >= FIVE ? 0x7fff : lane_mask(width - j), p + j);
}

// r g b 0 of the sums of the five triples in each of four vectors.
PRT_INLINE __m512 sum_fives(const __m512 x[4])
{
    const __m512i four =
        _mm512_setr_epi32(0, 1, 2, 15, 3, 4, 5, 15, 6, 7, 8, 15, 9, 10, 11, 15);
    const __m512i fifth =
        _mm512_setr_epi32(12, 13, 14, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15);
    __m512 y[4];
    for (int i = 0; i < 4; i++)
        y[i] = _mm512_add_ps(_mm512_permutexvar_ps(four, x[i]),
                             _mm512_permutexvar_ps(fifth, x[i]));
    // quarters of four vectors, transposed while they are summed
    __m512 lo = _mm512_add_ps(_mm512_shuffle_f32x4(y[0], y[1], 0x44),
                              _mm512_shuffle_f32x4(y[0], y[1], 0xee));
    __m512 hi = _mm512_add_ps(_mm512_shuffle_f32x4(y[2], y[3], 0x44),
                              _mm512_shuffle_f32x4(y[2], y[3], 0xee));
    return _mm512_add_ps(_mm512_shuffle_f32x4(lo, hi, 0x88),
                         _mm512_shuffle_f32x4(lo, hi, 0xdd));
}

// Items [0, m) of four from `in` on.
PRT_INLINE __m512 material_four(const float *in, uint32_t m, uint32_t width, const float *coef,
                                const __m512 first[MOST_FIVES])
{
    __m512 x[4];
    for (uint32_t i = 0; i < 4; i++) {
        const float *p = in + (i < m ? i : 0) * (size_t)width;
        x[i] = _mm512_setzero_ps();
        uint32_t j = 0;
        for (uint32_t k = 0; k < MOST_FIVES && j < width; k++, j += FIVE)
            x[i] = _mm512_fmadd_ps(five_mask(p, j, width), first[k], x[i]);
        for (; j < width; j += FIVE)
            x[i] = _mm512_fmadd_ps(five_mask(p, j, width), five_mask(coef, j, width), x[i]);
    }
    return sum_fives(x);
}

static void material(const float *in, size_t n, uint32_t n_radial, const float *coef,
                     float *out)
{
    const __m512i close = _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 0, 0, 0, 0);
    const uint32_t width = 3 * n_radial;
    __m512 first[MOST_FIVES];
    for (uint32_t k = 0; k < MOST_FIVES; k++)
        first[k] = FIVE * k < width ? five_mask(coef, FIVE * k, width) : _mm512_setzero_ps();
    for (size_t i = 0; i < n; i += 4, in += 4 * (size_t)width, out += 12) {
        const uint32_t m = n - i < 4 ? (uint32_t)(n - i) : 4;
        __m512 x = material_four(in, m, width, coef, first);
        _mm512_mask_storeu_ps(out, lane_mask(3 * m), _mm512_permutexvar_ps(close, x));
    }
}

const struct prt_kernels prt_kernels_avx512 = {.name = "avx512",
                                               .diagonal = diagonal,
                                               .diagonal_group = diagonal_group,
                                               .columns = prt_columns_avx512,
                                               .full = full,
                                               .mixed = prt_mixed_avx512,
                                               .expand = prt_expand_avx512,
                                               .radial = prt_radial_avx512,
                                               .material = material};

const struct prt_kernels prt_kernels_vnni = {.name = "vnni",
                                             .integers = true,
                                             .diagonal = diagonal,
                                             .diagonal_group = diagonal_group,
                                             .lights_to_integers = prt_integer_lights_fill_vnni,
                                             .pairs_group = prt_pairs_vnni,
                                             .columns = prt_columns_avx512,
                                             .full = full,
                                             .mixed = prt_mixed_avx512,
                                             .expand = prt_expand_vnni,
                                             .radial = prt_radial_avx512,
                                             .material = material};

PRT_ISA_END
#endif
