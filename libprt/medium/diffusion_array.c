// SPDX-License-Identifier: MIT
// R_d over arrays of squared distances: C, AVX2 and AVX-512. A bake evaluates R_d billions of
// times.
//
// One pole is a y^2 (sigma + y) 2^(c d) with y = 1/d = rsqrt(r^2 + z^2) after one Newton step
// and c = -sigma log2(e). The power is taken by rounding c d to a multiple of 1/16 (1/8 in
// AVX2) by the addition of a large constant; the low bits of the sum index 2^(k/16) in a
// register, and a short polynomial gives the power of the remainder: relative error 4e-7.
#include "base/isa.h"
#include "material.h"

#include <math.h>

struct pole {
    float z2;      /* mm^2 */
    float c;       /* -sigma_tr log2 e, mm^-1 */
    float a;       /* albedo' z / 4 pi, mm */
    float a_sigma; /* a sigma_tr */
};

static void poles_init(const struct prt_diffusion *dipole, struct pole pole[2])
{
    double z[2] = {dipole->z_r, dipole->z_v};
    for (int i = 0; i < 2; i++) {
        double a = dipole->albedo_prime * z[i] / (4 * M_PI);
        pole[i] = (struct pole){(float)(z[i] * z[i]), (float)(-dipole->sigma_tr * M_LOG2E),
                                (float)a, (float)(a * dipole->sigma_tr)};
    }
}

/* 2^x for x <= 0, 2e-7 relative; 0 below 2^-126. Written so that the compiler vectorises it. */
static inline float exp2_c(float x)
{
    const float magic = 12582912.0f; /* 1.5 * 2^23: the sum is rounded to an integer */
    float clamped = x < -125.0f ? -125.0f : x;
    float t = clamped + magic, f = clamped - (t - magic);
    float p = 1.3333558e-3f;
    p = p * f + 9.6181291e-3f;
    p = p * f + 5.5504109e-2f;
    p = p * f + 2.4022651e-1f;
    p = p * f + 6.9314718e-1f;
    p = p * f + 1.0f;
    uint32_t bits, scale;
    memcpy(&bits, &t, 4);
    scale = (bits + 127u) << 23;
    float power;
    memcpy(&power, &scale, 4);
    return x < -125.0f ? 0.0f : p * power;
}

static inline float pole_c(const struct pole *p, float r2)
{
    float d = sqrtf(r2 + p->z2), y = 1 / d;
    return (p->a * y + p->a_sigma) * (y * y) * exp2_c(p->c * d);
}

static void rd_array_c(const struct pole *pole, size_t n, const float *restrict r2,
                       float *restrict out)
{
    for (size_t i = 0; i < n; i++) out[i] = pole_c(&pole[0], r2[i]) + pole_c(&pole[1], r2[i]);
}

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX512)

/* C1 is ln 2 plus the Chebyshev correction for the dropped cubic term on |f| <= 1/32. */
#define LN2 0.69314718055994531
#define EXP512_C2 (LN2 * LN2 / 2)
#define EXP512_C1 (LN2 + LN2 * LN2 * LN2 / 6 * 0.75 / 1024)

struct pole512 {
    __m512 z2, c, a, a_sigma;
};

PRT_INLINE struct pole512 pole512_load(const struct pole *p)
{
    return (struct pole512){_mm512_set1_ps(p->z2), _mm512_set1_ps(p->c), _mm512_set1_ps(p->a),
                            _mm512_set1_ps(p->a_sigma)};
}

/* accumulate + the pole at 16 squared distances */
PRT_INLINE __m512 pole512_add(const struct pole512 *p, __m512 r2, __m512 table,
                              __m512 accumulate)
{
    const __m512 magic = _mm512_set1_ps(786432.0f); /* 1.5 * 2^19: rounds to 1/16 */
    __m512 d2 = _mm512_add_ps(r2, p->z2);
    __m512 y = _mm512_rsqrt14_ps(d2);
    __m512 d = _mm512_mul_ps(d2, y);
    __m512 e = _mm512_fnmadd_ps(d, y, _mm512_set1_ps(1.0f));
    e = _mm512_mul_ps(e, _mm512_set1_ps(0.5f));
    y = _mm512_fmadd_ps(y, e, y);
    d = _mm512_fmadd_ps(d, e, d);
    __m512 t = _mm512_fmadd_ps(d, p->c, magic);
    __m512 k = _mm512_sub_ps(t, magic);
    __m512 f = _mm512_fmsub_ps(d, p->c, k);
    __m512 q =
        _mm512_fmadd_ps(_mm512_set1_ps((float)EXP512_C2), f, _mm512_set1_ps((float)EXP512_C1));
    q = _mm512_fmadd_ps(q, f, _mm512_set1_ps(1.0f));
    q = _mm512_mul_ps(q, _mm512_permutexvar_ps(_mm512_castps_si512(t), table));
    __m512 w = _mm512_mul_ps(_mm512_mul_ps(y, y), _mm512_fmadd_ps(p->a, y, p->a_sigma));
    return _mm512_fmadd_ps(w, _mm512_scalef_ps(q, k), accumulate);
}

PRT_INLINE __m512 table512(void)
{
    static const float power[16] = {1.00000000f, 1.04427378f, 1.09050773f, 1.13878863f,
                                    1.18920712f, 1.24185781f, 1.29683955f, 1.35425555f,
                                    1.41421356f, 1.47682615f, 1.54221083f, 1.61049033f,
                                    1.68179283f, 1.75625216f, 1.83400809f, 1.91520656f};
    return _mm512_loadu_ps(power);
}

PRT_INLINE __mmask16 mask16(size_t left)
{
    return left >= 16 ? (__mmask16)0xffff : (__mmask16)((1u << left) - 1);
}

static void rd_array_avx512(const struct pole *pole, size_t n, const float *r2, float *out)
{
    const __m512 table = table512(), zero = _mm512_setzero_ps();
    const struct pole512 p0 = pole512_load(&pole[0]), p1 = pole512_load(&pole[1]);
    for (size_t i = 0; i < n; i += 16) {
        __mmask16 m = mask16(n - i);
        __m512 x = _mm512_maskz_loadu_ps(m, r2 + i);
        __m512 sum = pole512_add(&p1, x, table, pole512_add(&p0, x, table, zero));
        _mm512_mask_storeu_ps(out + i, m, sum);
    }
}

static void rd3_array_avx512(const struct pole pole[3][2], size_t n, const float *r2,
                             float *const out[3])
{
    const __m512 table = table512(), zero = _mm512_setzero_ps();
    struct pole512 p[3][2];
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < 2; k++) p[c][k] = pole512_load(&pole[c][k]);
    for (size_t i = 0; i < n; i += 16) {
        __mmask16 m = mask16(n - i);
        __m512 x = _mm512_maskz_loadu_ps(m, r2 + i);
        for (int c = 0; c < 3; c++) {
            __m512 sum = pole512_add(&p[c][0], x, table, zero);
            sum = pole512_add(&p[c][1], x, table, sum);
            _mm512_mask_storeu_ps(out[c] + i, m, sum);
        }
    }
}

PRT_ISA_END

PRT_ISA_BEGIN(PRT_ISA_AVX2)
PRT_INLINE __m256 pole256_add(const struct pole *p, __m256 r2, __m256 table, __m256 accumulate)
{
    const __m256 magic = _mm256_set1_ps(1572864.0f); /* 1.5 * 2^20: rounds to 1/8 */
    __m256 d2 = _mm256_add_ps(r2, _mm256_set1_ps(p->z2));
    __m256 y =
        _mm256_rsqrt_ps(d2); /* relative error 3.7e-4, so the step below is of third order */
    __m256 d = _mm256_mul_ps(d2, y);
    __m256 e = _mm256_fnmadd_ps(d, y, _mm256_set1_ps(1.0f));
    e = _mm256_mul_ps(e, _mm256_fmadd_ps(e, _mm256_set1_ps(0.375f), _mm256_set1_ps(0.5f)));
    y = _mm256_fmadd_ps(y, e, y);
    d = _mm256_fmadd_ps(d, e, d);
    __m256 x = _mm256_max_ps(_mm256_mul_ps(d, _mm256_set1_ps(p->c)), _mm256_set1_ps(-125.0f));
    __m256 t = _mm256_add_ps(x, magic);
    __m256 f = _mm256_sub_ps(x, _mm256_sub_ps(t, magic));
    __m256 q = _mm256_fmadd_ps(_mm256_set1_ps((float)(LN2 * LN2 * LN2 / 6)), f,
                               _mm256_set1_ps((float)(LN2 * LN2 / 2)));
    q = _mm256_fmadd_ps(q, f, _mm256_set1_ps((float)LN2));
    q = _mm256_fmadd_ps(q, f, _mm256_set1_ps(1.0f));
    __m256i bits = _mm256_castps_si256(t);
    q = _mm256_mul_ps(q, _mm256_permutevar8x32_ps(table, bits));
    __m256i exponent = _mm256_slli_epi32(_mm256_srai_epi32(bits, 3), 23);
    q = _mm256_castsi256_ps(_mm256_add_epi32(_mm256_castps_si256(q), exponent));
    __m256 w = _mm256_mul_ps(_mm256_mul_ps(y, y), _mm256_fmadd_ps(_mm256_set1_ps(p->a), y,
                                                                  _mm256_set1_ps(p->a_sigma)));
    return _mm256_fmadd_ps(w, q, accumulate);
}

static size_t rd_array_avx2(const struct pole *pole, size_t n, const float *r2, float *out)
{
    const __m256 table = _mm256_setr_ps(1.00000000f, 1.09050773f, 1.18920712f, 1.29683955f,
                                        1.41421356f, 1.54221083f, 1.68179283f, 1.83400809f);
    size_t i = 0;
    for (; i + 8 <= n; i += 8) {
        __m256 x = _mm256_loadu_ps(r2 + i);
        __m256 sum = pole256_add(&pole[0], x, table, _mm256_setzero_ps());
        _mm256_storeu_ps(out + i, pole256_add(&pole[1], x, table, sum));
    }
    return i;
}
PRT_ISA_END
#endif

void prt_diffusion_rd_array(const struct prt_diffusion *dipole, unsigned cpu, size_t n,
                            const float *r2_mm2, float *out)
{
    struct pole pole[2];
    if (dipole->n_point) {
        prt_material_table_array(dipole, n, r2_mm2, out);
        return;
    }
    poles_init(dipole, pole);
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512) {
        rd_array_avx512(pole, n, r2_mm2, out);
        return;
    }
    if (cpu & PRT_CPU_AVX2) {
        size_t done = rd_array_avx2(pole, n, r2_mm2, out);
        rd_array_c(pole, n - done, r2_mm2 + done, out + done);
        return;
    }
#endif
    rd_array_c(pole, n, r2_mm2, out);
}

void prt_diffusion_rd3_array(const struct prt_diffusion dipole[3], unsigned cpu, size_t n,
                             const float *r2_mm2, float *out0, float *out1, float *out2)
{
    float *const out[3] = {out0, out1, out2};
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512 && !dipole->n_point) {
        struct pole pole[3][2];
        for (int c = 0; c < 3; c++) poles_init(&dipole[c], pole[c]);
        rd3_array_avx512(pole, n, r2_mm2, out);
        return;
    }
#endif
    /* The constants of three channels need 32 vector registers. Without them the channels are
     * evaluated one after the other, in pieces whose r2 stays in the L1 cache (8 KiB). */
    for (size_t i = 0; i < n; i += 2048) {
        size_t piece = n - i < 2048 ? n - i : 2048;
        for (int c = 0; c < 3; c++)
            prt_diffusion_rd_array(&dipole[c], cpu, piece, r2_mm2 + i, out[c] + i);
    }
}
