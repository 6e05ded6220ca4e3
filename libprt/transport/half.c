// SPDX-License-Identifier: MIT
// IEEE half floats: every machine gives the same bits.
#include "base/isa.h"
#include "prt/transport.h"

#include <string.h>

uint16_t prt_f32_to_f16(float x)
{
    uint32_t u;
    memcpy(&u, &x, 4);
    uint32_t sign = (u >> 16) & 0x8000, mag = u & 0x7fffffff;
    if (mag > 0x7f800000) return (uint16_t)(sign | 0x7e00);
    // 65520 and more would round to infinity; they saturate to 65504.
    if (mag >= 0x477ff000) return (uint16_t)(sign | 0x7bff);
    if (mag < 0x38800000) { // below 2^-14: subnormal; adding 0.5 rounds to multiples of 2^-24
        float f;
        memcpy(&f, &mag, 4);
        f += 0.5f;
        memcpy(&mag, &f, 4);
        return (uint16_t)(sign | (mag - 0x3f000000));
    }
    uint32_t odd = (mag >> 13) & 1;
    return (uint16_t)(sign | ((mag - 0x38000000 + 0xfff + odd) >> 13));
}

float prt_f16_to_f32(uint16_t h)
{
    uint32_t sign = (uint32_t)(h & 0x8000) << 16, mag = h & 0x7fff, u;
    float f;
    if (mag >= 0x7c00) {
        u = 0x7f800000 | (mag << 13);
    } else if (mag < 0x400) {
        f = (float)mag * 0x1p-24f;
        memcpy(&u, &f, 4);
    } else {
        u = (mag << 13) + 0x38000000;
    }
    u |= sign;
    memcpy(&f, &u, 4);
    return f;
}

// Arrays: whole vectors; each function returns how many values it converted.
#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
static size_t to_f16_vectors(const float *x, size_t n, uint16_t *out)
{
    const __m256 limit = _mm256_set1_ps(65504.f), low = _mm256_set1_ps(-65504.f);
    size_t i = 0;
    for (; i + 8 <= n; i += 8) {
        __m256 v = _mm256_loadu_ps(x + i);
        // min and max return their second operand when one is NaN, so NaN stays NaN
        v = _mm256_max_ps(low, _mm256_min_ps(limit, v));
        _mm_storeu_si128((__m128i *)(out + i), _mm256_cvtps_ph(v, _MM_FROUND_TO_NEAREST_INT));
    }
    return i;
}

static size_t to_f32_vectors(const uint16_t *h, size_t n, float *out)
{
    size_t i = 0;
    for (; i + 8 <= n; i += 8)
        _mm256_storeu_ps(out + i, _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)(h + i))));
    return i;
}
PRT_ISA_END

static bool have_vectors(void)
{
    return prt_cpu_detect() & PRT_CPU_AVX2;
}
#elif PRT_ISA_ARM64
static size_t to_f16_vectors(const float *x, size_t n, uint16_t *out)
{
    const float32x4_t limit = vdupq_n_f32(65504.f), low = vdupq_n_f32(-65504.f);
    size_t i = 0;
    for (; i + 4 <= n; i += 4) {
        // NaN stays NaN: vmin and vmax propagate it
        const float32x4_t v = vmaxq_f32(low, vminq_f32(limit, vld1q_f32(x + i)));
        vst1_u16(out + i, vreinterpret_u16_f16(vcvt_f16_f32(v)));
    }
    return i;
}

static size_t to_f32_vectors(const uint16_t *h, size_t n, float *out)
{
    size_t i = 0;
    for (; i + 4 <= n; i += 4)
        vst1q_f32(out + i, vcvt_f32_f16(vreinterpret_f16_u16(vld1_u16(h + i))));
    return i;
}

static bool have_vectors(void)
{
    return true;
}
#else
static size_t to_f16_vectors(const float *x, size_t n, uint16_t *out)
{
    return 0;
}

static size_t to_f32_vectors(const uint16_t *h, size_t n, float *out)
{
    return 0;
}

static bool have_vectors(void)
{
    return false;
}
#endif

void prt_f32_to_f16_array(const float *x, size_t n, uint16_t *out)
{
    size_t i = have_vectors() ? to_f16_vectors(x, n, out) : 0;
    for (; i < n; i++) out[i] = prt_f32_to_f16(x[i]);
}

void prt_f16_to_f32_array(const uint16_t *h, size_t n, float *out)
{
    size_t i = have_vectors() ? to_f32_vectors(h, n, out) : 0;
    for (; i < n; i++) out[i] = prt_f16_to_f32(h[i]);
}
