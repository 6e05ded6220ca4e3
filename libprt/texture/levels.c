// SPDX-License-Identifier: MIT
// Mip chains: sizes, averages of four texels, the content address; and the checks of images and
// maps that come from files and other processes.
#include "texture/internal.h"

#include <math.h>
#include <pthread.h>
#include <string.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

static uint32_t half_of(uint32_t side)
{
    return side > 1 ? side / 2 : 1;
}

uint32_t prt_texture_levels(uint32_t width, uint32_t height)
{
    uint32_t n = 1;
    for (uint32_t side = width > height ? width : height; side > 1; side /= 2) n++;
    return n;
}

uint64_t prt_texture_bytes(uint32_t width, uint32_t height)
{
    uint64_t bytes = 0;
    for (uint32_t n = prt_texture_levels(width, height); n; n--) {
        bytes += 4ull * width * height;
        width = half_of(width);
        height = half_of(height);
    }
    return bytes;
}

static float linear_of[256];
static uint8_t srgb_of[4096];
static pthread_once_t tables_once = PTHREAD_ONCE_INIT;

static void make_tables(void)
{
    for (int i = 0; i < 256; i++) {
        float v = (float)i / 255;
        linear_of[i] = v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
    }
    for (int i = 0; i < 4096; i++) {
        float v = (float)i / 4095;
        v = v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f;
        srgb_of[i] = (uint8_t)(v * 255 + 0.5f);
    }
}

const float *prt_texture_linear(void)
{
    pthread_once(&tables_once, make_tables);
    return linear_of;
}

// The share of source texels [from, from + 3) in target texel x of an axis that shrinks from n
// to half_of(n): two or, on odd sides, three neighbours.
static unsigned weights(uint32_t n, uint32_t x, float w[3], uint32_t *from)
{
    if (n == 1) {
        *from = 0;
        w[0] = 1;
        return 1;
    }
    *from = 2 * x;
    if (n % 2 == 0) {
        w[0] = w[1] = 0.5f;
        return 2;
    }
    uint32_t m = n / 2;
    w[0] = (float)(m - x) / (float)n;
    w[1] = (float)m / (float)n;
    w[2] = (float)(x + 1) / (float)n;
    return 3;
}

static void decode_texel(enum prt_texture_kind kind, const uint8_t *p, float out[4])
{
    for (int c = 0; c < 3; c++)
        out[c] = kind == PRT_TEXTURE_COLOR ? linear_of[p[c]] : (float)p[c] / 255;
    out[3] = (float)p[3] / 255;
    if (kind != PRT_TEXTURE_NORMAL) return;
    float l = 0;
    for (int c = 0; c < 3; c++) {
        out[c] = 2 * out[c] - 1;
        l += out[c] * out[c];
    }
    l = l > 1 ? 1 / sqrtf(l) : 1; // averages are shorter than 1 and stay so
    for (int c = 0; c < 3; c++) out[c] *= l;
}

static void encode_texel(enum prt_texture_kind kind, const float v[4], uint8_t *p)
{
    for (int c = 0; c < 4; c++) {
        float x = kind == PRT_TEXTURE_NORMAL && c < 3 ? 0.5f + 0.5f * v[c] : v[c];
        x = x > 0 ? x < 1 ? x : 1 : 0;
        p[c] = kind == PRT_TEXTURE_COLOR && c < 3 ? srgb_of[(int)(x * 4095 + 0.5f)]
                                                  : (uint8_t)(x * 255 + 0.5f);
    }
}

static void shrink(enum prt_texture_kind kind, const uint8_t *in, uint32_t w, uint32_t h,
                   uint8_t *out)
{
    for (uint32_t y = 0; y < half_of(h); y++) {
        float wy[3], wx[3];
        uint32_t y0, x0;
        unsigned ny = weights(h, y, wy, &y0);
        for (uint32_t x = 0; x < half_of(w); x++) {
            float sum[4] = {0}, one[4];
            unsigned nx = weights(w, x, wx, &x0);
            for (unsigned j = 0; j < ny; j++)
                for (unsigned i = 0; i < nx; i++) {
                    decode_texel(kind, in + 4 * ((size_t)(y0 + j) * w + x0 + i), one);
                    for (int c = 0; c < 4; c++) sum[c] += wy[j] * wx[i] * one[c];
                }
            encode_texel(kind, sum, out + 4 * ((size_t)y * half_of(w) + x));
        }
    }
}

void prt_texture_finish_levels(uint32_t width, uint32_t height, enum prt_texture_kind kind,
                               uint8_t *texel, struct prt_texture_image *out)
{
    const uint32_t head[3] = {width, height, (uint32_t)kind};
    XXH128_hash_t hash = XXH3_128bits_withSeed(texel, 4 * (size_t)width * height,
                                               XXH3_64bits(head, sizeof head));
    *out = (struct prt_texture_image){.width = width,
                                      .height = height,
                                      .n_level = prt_texture_levels(width, height),
                                      .kind = (uint32_t)kind,
                                      .bytes = prt_texture_bytes(width, height),
                                      .hash = {hash.low64, hash.high64}};
    prt_texture_linear();
    for (uint32_t level = 1; level < out->n_level; level++) {
        uint8_t *next = texel + 4 * (size_t)width * height;
        shrink(kind, texel, width, height, next);
        texel = next;
        width = half_of(width);
        height = half_of(height);
    }
}

bool prt_texture_image_valid(const struct prt_texture_image *image, uint64_t texel_bytes)
{
    uint32_t w = image->width, h = image->height;
    if (!w || !h || w > PRT_TEXTURE_MAX_SIDE || h > PRT_TEXTURE_MAX_SIDE) return false;
    return image->n_level == prt_texture_levels(w, h) && image->kind < PRT_TEXTURE_N_KIND &&
           image->bytes == prt_texture_bytes(w, h) && image->begin <= texel_bytes &&
           image->bytes <= texel_bytes - image->begin;
}

static bool ref_valid(const struct prt_texture_ref *r, uint32_t n_image, uint32_t n_uv)
{
    if (r->image == UINT32_MAX) return true;
    bool good = r->image < n_image && r->uv_set < n_uv && r->wrap_u <= PRT_WRAP_MIRROR &&
                r->wrap_v <= PRT_WRAP_MIRROR && r->filter <= PRT_FILTER_ALL &&
                fabsf(r->scale) <= 1e6f;
    for (int k = 0; k < 6; k++) good = good && fabsf(r->transform[k]) <= 1e6f;
    return good;
}

bool prt_surface_maps_valid(const struct prt_surface_maps *maps, uint32_t n_image,
                            uint32_t n_uv)
{
    bool good = maps->metallic >= 0 && maps->metallic <= 1;
    for (int c = 0; c < 3; c++)
        good = good && maps->emissive[c] >= 0 && maps->emissive[c] <= 1e6f;
    for (int k = 0; k < PRT_N_MAP; k++) good = good && ref_valid(&maps->map[k], n_image, n_uv);
    return good;
}

void prt_surface_maps_default(struct prt_surface_maps *maps)
{
    memset(maps, 0, sizeof *maps);
    for (int k = 0; k < PRT_N_MAP; k++) {
        maps->map[k].image = UINT32_MAX;
        maps->map[k].transform[0] = maps->map[k].transform[4] = 1;
        maps->map[k].scale = 1;
    }
}
