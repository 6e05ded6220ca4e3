// SPDX-License-Identifier: MIT
// Sums over pairs: every emitter of a list to every point of a tile.
#include "internal.h"

#include "base/isa.h"

#include <math.h>
#include <string.h>

bool prt_emitters_reserve(struct emitters *e, uint32_t capacity)
{
    if (capacity <= e->capacity) return true;
    capacity = (capacity + capacity / 2 + 31) & ~15u;
    for (int k = 0; k < 6; k++) {
        float **column = k < 3 ? &e->p[k] : &e->w[k - 3];
        float *grown = prt_alloc(capacity, sizeof(float));
        if (!grown) return false;
        if (e->n) memcpy(grown, *column, e->n * sizeof(float));
        prt_free(*column);
        *column = grown;
    }
    e->capacity = capacity;
    return true;
}

void prt_emitters_finish(struct emitters *e)
{
    for (int k = 0; k < 3; k++) {
        prt_free(e->p[k]);
        prt_free(e->w[k]);
    }
    memset(e, 0, sizeof *e);
}

// The C reference: 16 points at a time in plain loops.
#define PLAIN_BODY                                                                           \
    const float r0_sq = t->r0_sq, q_max = t->q_max;                                          \
    const uint32_t shift = t->shift;                                                         \
    for (uint32_t at = 0; at < n_point; at += 16) {                                          \
        float s0[16], s1[16], s2[16];                                                        \
        memset(s0, 0, sizeof s0);                                                            \
        memset(s1, 0, sizeof s1);                                                            \
        memset(s2, 0, sizeof s2);                                                            \
        for (uint32_t j = begin; j < end; j++) {                                             \
            const float x = e->p[0][j], y = e->p[1][j], z = e->p[2][j];                      \
            const float w0 = e->w[0][j], w1 = e->w[1][j], w2 = e->w[2][j];                   \
            for (int i = 0; i < 16; i++) {                                                   \
                float dx = p[0][at + (uint32_t)i] - x, dy = p[1][at + (uint32_t)i] - y;      \
                float dz = p[2][at + (uint32_t)i] - z;                                       \
                float q = r0_sq + dx * dx + dy * dy + dz * dz;                               \
                q = q < q_max ? q : q_max;                                                   \
                union {                                                                      \
                    float f;                                                                 \
                    uint32_t u;                                                              \
                } bits = {q};                                                                \
                uint32_t k = bits.u >> shift & 31;                                           \
                s0[i] +=                                                                     \
                    w0 * (t->coef[0][0][k] + q * (t->coef[0][1][k] + q * t->coef[0][2][k])); \
                s1[i] +=                                                                     \
                    w1 * (t->coef[1][0][k] + q * (t->coef[1][1][k] + q * t->coef[1][2][k])); \
                s2[i] +=                                                                     \
                    w2 * (t->coef[2][0][k] + q * (t->coef[2][1][k] + q * t->coef[2][2][k])); \
            }                                                                                \
        }                                                                                    \
        for (int i = 0; i < 16; i++) {                                                       \
            sum[0][at + (uint32_t)i] += s0[i];                                               \
            sum[1][at + (uint32_t)i] += s1[i];                                               \
            sum[2][at + (uint32_t)i] += s2[i];                                               \
        }                                                                                    \
    }

static void pairs_c(const struct radial_table *t, const struct emitters *e, uint32_t begin,
                    uint32_t end, uint32_t n_point, const float *const p[3],
                    float *const sum[3]){PLAIN_BODY}

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
    // Looks up one of 32 entries: four permutes of 8 entries each, blended by the index's two
    // high bits.
    PRT_INLINE __m256 pick32(const float *table, __m256i k, __m256 bit3, __m256 bit4)
{
    __m256 a = _mm256_permutevar8x32_ps(_mm256_load_ps(table), k);
    __m256 b = _mm256_permutevar8x32_ps(_mm256_load_ps(table + 8), k);
    __m256 c = _mm256_permutevar8x32_ps(_mm256_load_ps(table + 16), k);
    __m256 d = _mm256_permutevar8x32_ps(_mm256_load_ps(table + 24), k);
    return _mm256_blendv_ps(_mm256_blendv_ps(a, b, bit3), _mm256_blendv_ps(c, d, bit3), bit4);
}

static void pairs_avx2(const struct radial_table *t, const struct emitters *e, uint32_t begin,
                       uint32_t end, uint32_t n_point, const float *const p[3],
                       float *const sum[3])
{
    float table[9][32] __attribute__((aligned(64)));
    memcpy(table, t->coef, sizeof table);
    const __m256 r0 = _mm256_set1_ps(t->r0_sq), q_max = _mm256_set1_ps(t->q_max);
    const __m128i shift = _mm_cvtsi32_si128((int)t->shift);
    for (uint32_t at = 0; at < n_point; at += 8) {
        __m256 x = _mm256_load_ps(p[0] + at), y = _mm256_load_ps(p[1] + at);
        __m256 z = _mm256_load_ps(p[2] + at), s[3];
        for (int c = 0; c < 3; c++) s[c] = _mm256_setzero_ps();
        for (uint32_t j = begin; j < end; j++) {
            __m256 dx = _mm256_sub_ps(x, _mm256_broadcast_ss(e->p[0] + j));
            __m256 dy = _mm256_sub_ps(y, _mm256_broadcast_ss(e->p[1] + j));
            __m256 dz = _mm256_sub_ps(z, _mm256_broadcast_ss(e->p[2] + j));
            __m256 q = _mm256_fmadd_ps(dx, dx, r0);
            q = _mm256_fmadd_ps(dy, dy, q);
            q = _mm256_min_ps(_mm256_fmadd_ps(dz, dz, q), q_max);
            __m256i k = _mm256_srl_epi32(_mm256_castps_si256(q), shift);
            __m256 bit3 = _mm256_castsi256_ps(_mm256_slli_epi32(k, 28));
            __m256 bit4 = _mm256_castsi256_ps(_mm256_slli_epi32(k, 27));
            for (int c = 0; c < 3; c++) {
                __m256 r = _mm256_fmadd_ps(q, pick32(table[3 * c + 2], k, bit3, bit4),
                                           pick32(table[3 * c + 1], k, bit3, bit4));
                r = _mm256_fmadd_ps(q, r, pick32(table[3 * c], k, bit3, bit4));
                s[c] = _mm256_fmadd_ps(r, _mm256_broadcast_ss(e->w[c] + j), s[c]);
            }
        }
        for (int c = 0; c < 3; c++)
            _mm256_store_ps(sum[c] + at, _mm256_add_ps(s[c], _mm256_load_ps(sum[c] + at)));
    }
}

PRT_ISA_END

PRT_ISA_BEGIN(PRT_ISA_AVX512)
// The table stays in 18 registers, two for each coefficient; one permute of two sources is a
// look-up.
static void pairs_avx512(const struct radial_table *t, const struct emitters *e, uint32_t begin,
                         uint32_t end, uint32_t n_point, const float *const p[3],
                         float *const sum[3])
{
    __m512 lo[9], hi[9];
    for (int k = 0; k < 9; k++) {
        lo[k] = _mm512_loadu_ps(&t->coef[0][0][0] + 32 * k);
        hi[k] = _mm512_loadu_ps(&t->coef[0][0][0] + 32 * k + 16);
    }
    const __m512 r0 = _mm512_set1_ps(t->r0_sq), q_max = _mm512_set1_ps(t->q_max);
    const __m128i shift = _mm_cvtsi32_si128((int)t->shift);
    const float *ex = e->p[0], *ey = e->p[1], *ez = e->p[2];
    const float *w0 = e->w[0], *w1 = e->w[1], *w2 = e->w[2];
    for (uint32_t at = 0; at < n_point; at += 16) {
        __m512 x = _mm512_load_ps(p[0] + at), y = _mm512_load_ps(p[1] + at);
        __m512 z = _mm512_load_ps(p[2] + at);
        __m512 s0 = _mm512_setzero_ps(), s1 = s0, s2 = s0;
        for (uint32_t j = begin; j < end; j++) {
            __m512 dx = _mm512_sub_ps(x, _mm512_set1_ps(ex[j]));
            __m512 dy = _mm512_sub_ps(y, _mm512_set1_ps(ey[j]));
            __m512 dz = _mm512_sub_ps(z, _mm512_set1_ps(ez[j]));
            __m512 q = _mm512_fmadd_ps(dx, dx, r0);
            q = _mm512_fmadd_ps(dy, dy, q);
            q = _mm512_min_ps(_mm512_fmadd_ps(dz, dz, q), q_max);
            __m512i k = _mm512_srl_epi32(_mm512_castps_si512(q), shift);
            __m512 a = _mm512_fmadd_ps(q, _mm512_permutex2var_ps(lo[2], k, hi[2]),
                                       _mm512_permutex2var_ps(lo[1], k, hi[1]));
            __m512 b = _mm512_fmadd_ps(q, _mm512_permutex2var_ps(lo[5], k, hi[5]),
                                       _mm512_permutex2var_ps(lo[4], k, hi[4]));
            __m512 c = _mm512_fmadd_ps(q, _mm512_permutex2var_ps(lo[8], k, hi[8]),
                                       _mm512_permutex2var_ps(lo[7], k, hi[7]));
            a = _mm512_fmadd_ps(q, a, _mm512_permutex2var_ps(lo[0], k, hi[0]));
            b = _mm512_fmadd_ps(q, b, _mm512_permutex2var_ps(lo[3], k, hi[3]));
            c = _mm512_fmadd_ps(q, c, _mm512_permutex2var_ps(lo[6], k, hi[6]));
            s0 = _mm512_fmadd_ps(a, _mm512_set1_ps(w0[j]), s0);
            s1 = _mm512_fmadd_ps(b, _mm512_set1_ps(w1[j]), s1);
            s2 = _mm512_fmadd_ps(c, _mm512_set1_ps(w2[j]), s2);
        }
        _mm512_store_ps(sum[0] + at, _mm512_add_ps(s0, _mm512_load_ps(sum[0] + at)));
        _mm512_store_ps(sum[1] + at, _mm512_add_ps(s1, _mm512_load_ps(sum[1] + at)));
        _mm512_store_ps(sum[2] + at, _mm512_add_ps(s2, _mm512_load_ps(sum[2] + at)));
    }
}
PRT_ISA_END
#endif

pair_fn prt_pair_kernel(unsigned cpu)
{
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512) return pairs_avx512;
    if (cpu & PRT_CPU_AVX2) return pairs_avx2;
#endif
    return pairs_c;
}
