/* SPDX-License-Identifier: MIT */
/* R_d over lanes, included by base/isa_each.h for each instruction set: AVX-512 registers hold
 * the table. Arrays hold LANES. */

#if PRT_ISA_LANES == 16
static void PRT_KERNEL(radial)(const struct radial_table *t, int n, const float *r_sq,
                               float *r0, float *r1, float *r2)
{
    __m512 lo[9], hi[9];
    for (int k = 0; k < 9; k++) {
        lo[k] = _mm512_loadu_ps(&t->coef[0][0][0] + 32 * k);
        hi[k] = _mm512_loadu_ps(&t->coef[0][0][0] + 32 * k + 16);
    }
    const __m512 base = _mm512_set1_ps(t->r0_sq), q_max = _mm512_set1_ps(t->q_max);
    const __m128i shift = _mm_cvtsi32_si128((int)t->shift);
    float *const out[3] = {r0, r1, r2};
    for (int i = 0; i < n; i += 16) {
        __m512 q = _mm512_min_ps(_mm512_add_ps(_mm512_loadu_ps(r_sq + i), base), q_max);
        __m512i k = _mm512_srl_epi32(_mm512_castps_si512(q), shift);
        for (int c = 0; c < 3; c++) {
            __m512 r = _mm512_permutex2var_ps(lo[3 * c + 2], k, hi[3 * c + 2]);
            r = _mm512_fmadd_ps(q, r, _mm512_permutex2var_ps(lo[3 * c + 1], k, hi[3 * c + 1]));
            r = _mm512_fmadd_ps(q, r, _mm512_permutex2var_ps(lo[3 * c], k, hi[3 * c]));
            _mm512_storeu_ps(out[c] + i, r);
        }
    }
}
#else
/* R_d of three channels at n squared distances. */
static void PRT_KERNEL(radial)(const struct radial_table *t, int n, const float *r_sq,
                               float *r0, float *r1, float *r2)
{
    const float base = t->r0_sq, q_max = t->q_max;
    const uint32_t shift = t->shift;
    for (int i = 0; i < n; i++) {
        float q = r_sq[i] + base;
        q = q < q_max ? q : q_max;
        union {
            float f;
            uint32_t u;
        } bits = {q};
        uint32_t k = bits.u >> shift & 31;
        r0[i] = t->coef[0][0][k] + q * (t->coef[0][1][k] + q * t->coef[0][2][k]);
        r1[i] = t->coef[1][0][k] + q * (t->coef[1][1][k] + q * t->coef[1][2][k]);
        r2[i] = t->coef[2][0][k] + q * (t->coef[2][1][k] + q * t->coef[2][2][k]);
    }
}
#endif
