// SPDX-License-Identifier: MIT
// Colours and pictures in the formats that go over the wire.
#include "render/evaluation.h"

#include <math.h>
#include <string.h>

static float srgb(float x)
{
    if (!(x > 0)) return 0;
    if (x >= 1) return 255;
    x = x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f;
    return x * 255 + 0.5f;
}

static uint32_t rgb9e5(const float c[3])
{
    // EXT_texture_shared_exponent: 9 bits of mantissa, exponent bias 15
    const float top = 65408;
    float v[3], high = 0;
    for (int i = 0; i < 3; i++) {
        v[i] = c[i] > 0 ? fminf(c[i], top) : 0;
        high = fmaxf(high, v[i]);
    }
    int e;
    frexpf(high, &e); // high = m 2^e, m in [0.5, 1)
    int exponent = (e > -15 ? e : -15) + 15;
    if ((int)floorf(ldexpf(high, 15 + 9 - exponent) + 0.5f) == 512) exponent++;
    uint32_t out = (uint32_t)exponent << 27;
    for (int i = 0; i < 3; i++)
        out |= (uint32_t)floorf(ldexpf(v[i], 15 + 9 - exponent) + 0.5f) << 9 * i;
    return out;
}

size_t color_bytes(int format)
{
    return format == RELIGHT__COLOR_FORMAT__COLOR_F32   ? 12
           : format == RELIGHT__COLOR_FORMAT__COLOR_F16 ? 6
                                                        : 4;
}

struct encoding {
    const float *from;
    uint8_t *to;
    int format;
    float scale;
};

static int encode_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct encoding *e = arg;
    for (size_t v = begin; v < end; v++) {
        const float *c = e->from + 3 * v;
        if (e->format == RELIGHT__COLOR_FORMAT__COLOR_RGB9E5) {
            ((uint32_t *)e->to)[v] = rgb9e5(c);
        } else {
            for (int i = 0; i < 3; i++)
                e->to[4 * v + (size_t)i] = (uint8_t)srgb(c[i] * e->scale);
            e->to[4 * v + 3] = 255;
        }
    }
    return PRT_OK;
}

void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                   const struct vertex_values *values, uint8_t *to)
{
    size_t n = (size_t)values->n_vertex * 3;
    if (spec->format == RELIGHT__COLOR_FORMAT__COLOR_F32) {
        memcpy(to, values->values, n * sizeof(float));
    } else if (spec->format == RELIGHT__COLOR_FORMAT__COLOR_F16) {
        prt_f32_to_f16_array(values->values, n, (uint16_t *)to);
    } else {
        struct encoding e = {values->values, to, spec->format, exp2f(spec->exposure_ev)};
        prt_parallel_for(ctx, NULL, values->n_vertex, 4096, encode_range, &e);
    }
}

int encode_image(const struct prt_context *ctx, const struct render_spec *s,
                 const struct prt_image *image, struct prt_blob *out)
{
    size_t n = (size_t)image->width * image->height;
    struct prt_blob blob = {0};
    int status = PRT_OK;
    if (s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_EXR ||
        s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT) {
        status = prt_encode_exr(
            ctx, image, s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT, &blob);
    } else if (s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_F16) {
        blob = (struct prt_blob){prt_alloc(n, 6), n * 6};
        if (!blob.bytes) return PRT_NOMEM;
        prt_f32_to_f16_array(image->rgb, n * 3, blob.bytes);
    } else {
        uint8_t *rgb8 = prt_alloc(n, 3);
        if (!rgb8) return PRT_NOMEM;
        status = prt_tone_map(ctx, image, (enum prt_tone)s->tone, s->picture_ev, rgb8);
        if (!status && s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_PNG)
            status = prt_encode_png(ctx, rgb8, image->width, image->height, 3, &blob);
        else if (!status && s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_JPEG)
            status =
                prt_encode_jpeg(ctx, rgb8, image->width, image->height, (int)s->quality, &blob);
        else if (!status) {
            blob = (struct prt_blob){rgb8, n * 3};
            rgb8 = NULL;
        }
        prt_free(rgb8);
    }
    if (!status) *out = blob;
    return status;
}
