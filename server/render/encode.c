// SPDX-License-Identifier: MIT
// Colours and pictures in the formats of the protocol.
#include "core/image_format.h"
#include "render/evaluation.h"
#include "prt/picture.h"

#include <math.h>
#include <string.h>

static float srgb(float x)
{
    if (!(x > 0)) return 0;
    if (x >= 1) return 255;
    x = x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f;
    return x * 255 + 0.5f;
}

size_t color_bytes(int format)
{
    switch (format) {
    case RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS:
    case RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED:
        return 0;
    case RELIGHT__COLOR_FORMAT__COLOR_F32:
        return 12;
    case RELIGHT__COLOR_FORMAT__COLOR_F16:
        return 6;
    default:
        return 4;
    }
}

unsigned most_parts(const struct render_spec *spec)
{
    if (spec->picture || !spec->phases || spec->has_eye ||
        spec->term == RELIGHT__TERM__TERM_IRRADIANCE)
        return 0;
    switch (spec->format) {
    case RELIGHT__COLOR_FORMAT__COLOR_F32:
    case RELIGHT__COLOR_FORMAT__COLOR_F16:
        return 17;
    case RELIGHT__COLOR_FORMAT__COLOR_RGB9E5:
        return 2; // the parts behind the second have negative numbers
    default:
        return 0;
    }
}

bool sends_exits(const struct render_spec *spec)
{
    // Planes of exit have negative numbers, which RGB9E5 has not.
    return spec->exits && (is_coefficients(spec) || most_parts(spec) > 2);
}

size_t plane_bytes(const struct render_spec *spec, const struct vertex_values *values)
{
    if (is_coefficients(spec)) return values->coefficients.n_half * sizeof(uint16_t);
    return (size_t)values->n_plane * values->n_vertex * color_bytes(spec->format);
}

void encode_some_colors(const struct prt_context *ctx, int format, float exposure_ev,
                        const float *from, size_t n, uint8_t *to)
{
    const float scale = exp2f(exposure_ev);
    switch (format) {
    case RELIGHT__COLOR_FORMAT__COLOR_F32:
        memcpy(to, from, 3 * n * sizeof(float));
        return;
    case RELIGHT__COLOR_FORMAT__COLOR_F16:
        prt_f32_to_f16_array(from, 3 * n, (uint16_t *)to);
        return;
    case RELIGHT__COLOR_FORMAT__COLOR_RGB9E5:
        prt_encode_rgb9e5(ctx, from, n, (uint32_t *)to);
        return;
    default:
        for (size_t v = 0; v < n; v++) {
            for (size_t i = 0; i < 3; i++)
                to[4 * v + i] = (uint8_t)srgb(from[3 * v + i] * scale);
            to[4 * v + 3] = 255;
        }
    }
}

struct encoding {
    const struct prt_context *ctx;
    const struct render_spec *spec;
    const float *from;
    uint8_t *to;
};

static int encode_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct encoding *e = arg;
    encode_some_colors(e->ctx, e->spec->format, e->spec->exposure_ev, e->from + 3 * begin,
                       end - begin, e->to + color_bytes(e->spec->format) * begin);
    return PRT_OK;
}

void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                   const struct vertex_values *values, uint8_t *to)
{
    struct encoding e = {ctx, spec, values->values, to};
    if (is_coefficients(spec)) memcpy(to, values->values, plane_bytes(spec, values));
    else
        prt_parallel_for(ctx, NULL, (size_t)values->n_plane * values->n_vertex, 4096,
                         encode_range, &e);
}

int encode_coarse(const struct prt_context *ctx, const struct render_spec *spec,
                  const struct vertex_values *values, const uint32_t *vertex, uint32_t n,
                  uint8_t *to)
{
    float *part = prt_alloc(3 * (size_t)n + 1, sizeof *part);
    for (unsigned k = 0; part && k < values->n_plane; k++) {
        const float *from = values->values + 3 * (size_t)k * values->n_vertex;
        for (size_t i = 0; i < n; i++) memcpy(part + 3 * i, from + 3 * (size_t)vertex[i], 12);
        encode_some_colors(ctx, spec->format, spec->exposure_ev, part, n,
                           to + k * n * color_bytes(spec->format));
    }
    prt_free(part);
    return part ? PRT_OK : PRT_NOMEM;
}

// ---- pictures

static int raw_f16(const struct prt_context *ctx, const struct prt_image *image,
                   const struct prt_picture_options *options, struct prt_blob *out)
{
    size_t n = (size_t)image->width * image->height;
    *out = (struct prt_blob){prt_alloc(n, 6), n * 6};
    if (!out->bytes) return PRT_NOMEM;
    prt_f32_to_f16_array(image->rgb, n * 3, out->bytes);
    return PRT_OK;
}

static int raw_rgb8(const struct prt_context *ctx, const struct prt_image *image,
                    const struct prt_picture_options *options, struct prt_blob *out)
{
    size_t n = (size_t)image->width * image->height;
    *out = (struct prt_blob){prt_alloc(n, 3), n * 3};
    if (!out->bytes) return PRT_NOMEM;
    return prt_tone_map(ctx, image, options->tone, options->exposure_ev, out->bytes);
}

bool image_format_known(unsigned format)
{
    return image_format_of(format) != NULL;
}

bool image_format_alpha(unsigned format)
{
    const struct image_format *known = image_format_of(format);
    return known && known->ending && prt_picture_format(known->ending)->alpha;
}

bool draws_rgb8(const struct render_spec *s)
{
    const struct image_format *format = image_format_of(s->image_format);
    return !s->transparent && !format->fine &&
           (format->ending ? prt_picture_format(format->ending)->encode_rgb8 != NULL
                           : s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_RGB8);
}

static struct prt_picture_options options_of(const struct render_spec *s)
{
    const struct image_format *format = image_format_of(s->image_format);
    return (struct prt_picture_options){.tone = (enum prt_tone)s->tone,
                                        .exposure_ev = s->picture_ev,
                                        .quality = (int)s->quality,
                                        .full_float = format->full_float,
                                        .fine = format->fine};
}

int encode_rgb8(const struct prt_context *ctx, const struct render_spec *s, uint8_t *rgb8,
                struct prt_blob *out)
{
    const char *ending = image_format_of(s->image_format)->ending;
    const struct prt_picture_options options = options_of(s);
    struct prt_blob blob = {rgb8, (size_t)s->width * s->height * 3};
    if (ending) {
        blob = (struct prt_blob){0};
        int status = prt_picture_format(ending)->encode_rgb8(ctx, rgb8, s->width, s->height,
                                                             &options, &blob);
        prt_free(rgb8);
        if (status) {
            prt_free(blob.bytes);
            return status;
        }
    }
    *out = blob;
    return PRT_OK;
}

int encode_image(const struct prt_context *ctx, const struct render_spec *s,
                 const struct prt_image *image, struct prt_blob *out)
{
    const char *ending = image_format_of(s->image_format)->ending;
    const struct prt_picture_options options = options_of(s);
    struct prt_blob blob = {0};
    int status;
    if (ending)
        status = prt_picture_encode(ctx, prt_picture_format(ending), image, &options, &blob);
    else if (s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_F16)
        status = raw_f16(ctx, image, &options, &blob);
    else status = raw_rgb8(ctx, image, &options, &blob);
    if (status) prt_free(blob.bytes);
    else *out = blob;
    return status;
}
