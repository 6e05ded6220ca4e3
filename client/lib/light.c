// SPDX-License-Identifier: MIT
// Requests for colours and pictures, blocking and pipelined; decoding of colour formats.
#include "internal.h"

#include <math.h>

static int start(struct relight_client *client, uint16_t type, const ProtobufCMessage *message,
                 const struct request_parts *parts, double timeout_s, uint64_t *id,
                 struct relight_error *error)
{
    if (!(timeout_s > 0)) timeout_s = relight_timeout(client);
    return relight_start(client, type, message, parts->cube, parts->n_cube, timeout_s, false,
                         id, error);
}

int relight_colors_begin(struct relight_client *client,
                         const struct relight_colors_request *request, double timeout_s,
                         uint64_t *id, struct relight_error *error)
{
    Relight__ColorsRequest m = RELIGHT__COLORS_REQUEST__INIT;
    struct request_parts parts;
    int status = relight_put_lights(&parts, request->n_light, request->lights, error);
    if (!status) status = relight_put_shade(&parts, &request->shade, error);
    if (status) return status;
    m.model = relight_text(request->model);
    m.pose = relight_text(request->pose);
    m.n_lights = request->n_light;
    m.lights = parts.lights;
    m.sum = request->sum;
    m.shade = &parts.shade;
    m.format = (Relight__ColorFormat)request->format;
    m.exposure_ev = request->exposure_ev;
    m.most_rank = request->most_rank;
    m.phases = request->phases;
    m.exits = request->exits;
    m.priority = (Relight__Priority)request->priority;
    return start(client, RELIGHT_TYPE_COLORS, &m.base, &parts, timeout_s, id, error);
}

int relight_colors_end(struct relight_client *client, uint64_t id, struct relight_colors *out,
                       struct relight_error *error)
{
    struct answer *answer;
    struct relight_colors colors;
    int status = relight_end(client, id, RELIGHT_TYPE_COLORS, &answer, error);
    if (status) return status;
    status = relight_get_colors((Relight__ColorsAnswer *)answer->message, answer->payload,
                                answer->payload_size, &colors, error);
    if (status) {
        relight_answer_free(answer);
        return status;
    }
    if (!(colors.owner = relight_owner(answer)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for colours");
    *out = colors;
    return 0;
}

int relight_colors(struct relight_client *client, const struct relight_colors_request *request,
                   struct relight_colors *out, struct relight_error *error)
{
    uint64_t id;
    int status = relight_colors_begin(client, request, 0, &id, error);
    return status ? status : relight_colors_end(client, id, out, error);
}

void relight_colors_finish(struct relight_colors *colors)
{
    relight_owner_free(colors->owner);
    *colors = (struct relight_colors){0};
}

int relight_image_begin(struct relight_client *client,
                        const struct relight_image_request *request, double timeout_s,
                        uint64_t *id, struct relight_error *error)
{
    Relight__ImageRequest m = RELIGHT__IMAGE_REQUEST__INIT;
    struct request_parts parts;
    int status = relight_put_lights(&parts, request->n_light, request->lights, error);
    if (!status) status = relight_put_shade(&parts, &request->shade, error);
    if (status) return status;
    relight_put_picture(&parts, &request->picture);
    m.model = relight_text(request->model);
    m.pose = relight_text(request->pose);
    m.n_lights = request->n_light;
    m.lights = parts.lights;
    m.shade = &parts.shade;
    m.picture = &parts.picture;
    m.priority = (Relight__Priority)request->priority;
    return start(client, RELIGHT_TYPE_IMAGE, &m.base, &parts, timeout_s, id, error);
}

int relight_image_end(struct relight_client *client, uint64_t id, struct relight_image *out,
                      struct relight_error *error)
{
    struct answer *answer;
    struct relight_image image;
    int status = relight_end(client, id, RELIGHT_TYPE_IMAGE, &answer, error);
    if (status) return status;
    status = relight_get_image((Relight__ImageAnswer *)answer->message, answer->payload,
                               answer->payload_size, &image, error);
    if (status) {
        relight_answer_free(answer);
        return status;
    }
    if (!(image.owner = relight_owner(answer)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for an image");
    *out = image;
    return 0;
}

int relight_image(struct relight_client *client, const struct relight_image_request *request,
                  struct relight_image *out, struct relight_error *error)
{
    uint64_t id;
    int status = relight_image_begin(client, request, 0, &id, error);
    return status ? status : relight_image_end(client, id, out, error);
}

void relight_image_finish(struct relight_image *image)
{
    relight_owner_free(image->owner);
    *image = (struct relight_image){0};
}

void relight_decode_f16(const uint16_t *in, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t sign = (uint32_t)(in[i] & 0x8000) << 16, magnitude = in[i] & 0x7fff, bits;
        if (magnitude >= 0x7c00) {
            bits = 0x7f800000 | (magnitude & 0x3ff) << 13; // infinity, NaN
        } else if (magnitude >= 0x400) {
            bits = (magnitude << 13) + ((127 - 15) << 23);
        } else {
            float small = (float)magnitude * 0x1p-24f; // subnormal: exact
            memcpy(&bits, &small, sizeof bits);
        }
        bits |= sign;
        memcpy(out + i, &bits, sizeof bits);
    }
}

// GL_EXT_texture_shared_exponent: 9 bits each of R, G, B from the low end, exponent bias 15.
void relight_decode_rgb9e5(const uint32_t *in, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++) {
        uint32_t bits = ((in[i] >> 27) + 127 - 15 - 9) << 23;
        float scale;
        memcpy(&scale, &bits, sizeof scale);
        for (int c = 0; c < 3; c++) out[3 * i + c] = (float)(in[i] >> 9 * c & 511) * scale;
    }
}

void relight_decode_srgb8(const uint8_t *in, size_t n, float *out)
{
    float table[256];
    for (int i = 0; i < 256; i++) {
        double x = i / 255.0;
        table[i] = (float)(x <= 0.04045 ? x / 12.92 : pow((x + 0.055) / 1.055, 2.4));
    }
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) out[3 * i + c] = table[in[4 * i + c]];
}

int relight_colors_decode(const struct relight_colors *colors, uint32_t plane, float *out)
{
    const uint32_t parts = colors->n_part ? colors->n_part : 1;
    if (plane / parts >= colors->n_plane) return -RELIGHT_E_ARGUMENT;
    const size_t n = colors->n_coarse ? colors->n_coarse : colors->n_vertex;
    const uint8_t *data = (const uint8_t *)colors->data + plane / parts * colors->plane_bytes +
                          plane % parts * n * relight_color_bytes(colors->format);
    switch (colors->format) {
    case RELIGHT_COLOR_F32:
        memcpy(out, data, n * 12);
        break;
    case RELIGHT_COLOR_F16:
        relight_decode_f16((const uint16_t *)data, n * 3, out);
        break;
    case RELIGHT_COLOR_RGB9E5:
        relight_decode_rgb9e5((const uint32_t *)data, n, out);
        break;
    case RELIGHT_COLOR_SRGB8:
        relight_decode_srgb8(data, n, out);
        break;
    case RELIGHT_COLOR_COEFFICIENTS:
    case RELIGHT_COLOR_COEFFICIENTS_PACKED:
        return -RELIGHT_E_ARGUMENT;
    }
    return 0;
}
