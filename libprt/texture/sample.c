// SPDX-License-Identifier: MIT
// Filtered look-up: bilinear within a level, linear between two, and along the longer axis of
// an anisotropic footprint.
#include "texture/internal.h"

#include <math.h>

enum { MOST_PROBES = 16 };

struct level {
    const uint8_t *texel;
    uint32_t w, h;
};

static struct level level_of(const struct prt_texture_image *image, const uint8_t *texel,
                             uint32_t k)
{
    struct level l = {texel + image->begin, image->width, image->height};
    for (; k; k--) {
        l.texel += 4 * (size_t)l.w * l.h;
        l.w = l.w > 1 ? l.w / 2 : 1;
        l.h = l.h > 1 ? l.h / 2 : 1;
    }
    return l;
}

// A texel's index on an axis of n texels.
static uint32_t wrap(int64_t i, uint32_t n, unsigned mode)
{
    if (mode == PRT_WRAP_CLAMP) return i < 0 ? 0 : i >= n ? n - 1 : (uint32_t)i;
    int64_t period = mode == PRT_WRAP_MIRROR ? 2 * (int64_t)n : n;
    i %= period;
    if (i < 0) i += period;
    return (uint32_t)(i >= n ? period - 1 - i : i);
}

// Adds weight * the value of a texel.
static void add(const struct prt_texture_image *image, const uint8_t *p, float weight,
                const float *linear, float rgba[4])
{
    if (image->kind == PRT_TEXTURE_COLOR)
        for (int c = 0; c < 3; c++) rgba[c] += weight * linear[p[c]];
    else
        for (int c = 0; c < 3; c++) rgba[c] += weight * (1.0f / 255) * (float)p[c];
    rgba[3] += weight * (1.0f / 255) * (float)p[3];
}

static void sample_level(const struct prt_texture_image *image, const uint8_t *texel,
                         const struct prt_texture_ref *ref, uint32_t k, bool nearest,
                         const float uv[2], float weight, float rgba[4])
{
    const float *linear = prt_texture_linear();
    struct level l = level_of(image, texel, k);
    // beyond 2^20 repeats a float has no fraction left
    float u = fabsf(uv[0]) < 1 << 20 ? uv[0] : 0, v = fabsf(uv[1]) < 1 << 20 ? uv[1] : 0;
    double x = (double)u * l.w - (nearest ? 0 : 0.5);
    double y = (double)v * l.h - (nearest ? 0 : 0.5);
    double x0 = floor(x), y0 = floor(y);
    float fx = nearest ? 0 : (float)(x - x0), fy = nearest ? 0 : (float)(y - y0);
    uint32_t i[2], j[2];
    for (int s = 0; s < 2; s++) {
        i[s] = wrap((int64_t)x0 + s, l.w, ref->wrap_u);
        j[s] = wrap((int64_t)y0 + s, l.h, ref->wrap_v);
    }
    for (int s = 0; s < 4; s++) {
        float w = (s & 1 ? fx : 1 - fx) * (s >> 1 ? fy : 1 - fy);
        if (w > 0)
            add(image, l.texel + 4 * ((size_t)j[s >> 1] * l.w + i[s & 1]), weight * w, linear,
                rgba);
    }
}

static void sample_lod(const struct prt_texture_image *image, const uint8_t *texel,
                       const struct prt_texture_ref *ref, float lod, const float uv[2],
                       float weight, float rgba[4])
{
    const unsigned filter = ref->filter;
    bool nearest = filter & (lod > 0 ? PRT_FILTER_MIN_NEAREST : PRT_FILTER_MAG_NEAREST);
    float top = (float)(image->n_level - 1);
    lod = lod > 0 ? lod < top ? lod : top : 0;
    if (filter & PRT_FILTER_LEVEL_NEAREST) lod = floorf(lod + 0.5f);
    uint32_t k = (uint32_t)lod;
    float share = lod - (float)k;
    sample_level(image, texel, ref, k, nearest, uv, weight * (1 - share), rgba);
    if (share > 0) sample_level(image, texel, ref, k + 1, nearest, uv, weight * share, rgba);
}

// A derivative of uv after the transform, in texels.
static float in_texels(const struct prt_texture_image *image, const float *t, const float d[2],
                       float out[2])
{
    out[0] = t[0] * d[0] + t[1] * d[1];
    out[1] = t[3] * d[0] + t[4] * d[1];
    float x = out[0] * (float)image->width, y = out[1] * (float)image->height;
    float l = sqrtf(x * x + y * y);
    return isfinite(l) ? l : 0;
}

void prt_texture_sample(const struct prt_texture_image *image, const uint8_t *texel,
                        const struct prt_texture_ref *ref, const float uv[2], const float dx[2],
                        const float dy[2], float rgba[4])
{
    const float *t = ref->transform;
    float at[2] = {t[0] * uv[0] + t[1] * uv[1] + t[2], t[3] * uv[0] + t[4] * uv[1] + t[5]};
    float a[2], b[2], la = in_texels(image, t, dx, a), lb = in_texels(image, t, dy, b);
    const float *axis = la > lb ? a : b;
    float longer = la > lb ? la : lb, shorter = la > lb ? lb : la;
    for (int c = 0; c < 4; c++) rgba[c] = 0;
    for (int c = 0; c < 2; c++) at[c] = isfinite(at[c]) ? at[c] : 0;
    int n = 1;
    if (!(ref->filter & (PRT_FILTER_NO_LEVELS | PRT_FILTER_MIN_NEAREST)) && longer > 1)
        n = (int)fminf(ceilf(longer / fmaxf(shorter, 1) - 0.05f), MOST_PROBES);
    n = n > 1 ? n : 1;
    float lod = ref->filter & PRT_FILTER_NO_LEVELS ? (longer > 1 ? 1e-6f : 0)
                                                   : log2f(fmaxf(longer / (float)n, 1e-6f));
    for (int k = 0; k < n; k++) {
        float s = ((float)k + 0.5f) / (float)n - 0.5f;
        float p[2] = {at[0] + s * axis[0], at[1] + s * axis[1]};
        if (n == 1) p[0] = at[0], p[1] = at[1];
        if (ref->filter & PRT_FILTER_NO_LEVELS)
            sample_level(image, texel, ref, 0,
                         ref->filter &
                             (lod > 0 ? PRT_FILTER_MIN_NEAREST : PRT_FILTER_MAG_NEAREST),
                         p, 1.0f / (float)n, rgba);
        else sample_lod(image, texel, ref, lod, p, 1.0f / (float)n, rgba);
    }
    if (image->kind == PRT_TEXTURE_NORMAL)
        for (int c = 0; c < 3; c++) rgba[c] = 2 * rgba[c] - 1;
}
