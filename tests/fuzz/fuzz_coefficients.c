// SPDX-License-Identifier: MIT
// Hostile answers to FACTORS and COLORS: a stream of frames; each factors answer that the
// client accepts is multiplied with each coefficients answer that it accepts.
#include "internal.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

enum { MOST = 4, FACTORS_ANSWER = 0x801b, COLORS_ANSWER = 0x800c };

struct taken {
    ProtobufCMessage *message;
    struct answer answer;
    struct relight_factors factors;
    struct relight_colors colors;
};

static void multiply(const struct relight_factors *factors, const struct relight_colors *colors)
{
    const struct relight_block block[2] = {{.translucent = true, .n_vertex = factors->n_vertex},
                                           {.vertex_begin = 1, .n_vertex = UINT32_MAX}};
    if (factors->n_vertex > 4096) return;
    float *values = malloc(17 * 12 * (size_t)(factors->n_vertex + 1));
    if (!values) return;
    relight_coefficients_expand(factors, colors, colors->n_plane - 1, RELIGHT_MOST_PHASES,
                                values, values + 3 * (size_t)factors->n_vertex, NULL);
    relight_coefficients_exits(factors, colors, colors->n_plane - 1, values, NULL);
    relight_coefficients_colors(factors, colors, 0, 2, block, values, NULL);
    free(values);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    const struct relight_frame_limits limits = {1 << 14, 1 << 20};
    struct relight_decoder d;
    struct taken taken[MOST];
    unsigned n = 0;
    int status = 0;
    size_t used;
    relight_decoder_init(&d, &limits);
    for (size_t at = 0; at < size && status >= 0 && n < MOST; at += used) {
        status = relight_decoder_feed(&d, data + at, size - at, &used);
        if (status != 1 || (d.frame.type != FACTORS_ANSWER && d.frame.type != COLORS_ANSWER))
            continue;
        struct taken *t = &taken[n];
        *t = (struct taken){.answer.type = d.frame.type,
                            .answer.payload_size = d.frame.payload_size,
                            .message = relight_frame_unpack(&d.frame)};
        t->answer.payload = relight_decoder_take(&d);
        n++;
        if (!t->message) continue;
        if (t->answer.type == FACTORS_ANSWER)
            relight_get_factors((Relight__FactorsAnswer *)t->message, &t->answer, 0,
                                &t->factors, NULL);
        else if (relight_get_colors((Relight__ColorsAnswer *)t->message, t->answer.payload,
                                    t->answer.payload_size, &t->colors, NULL))
            t->colors = (struct relight_colors){0};
    }
    for (unsigned i = 0; i < n; i++)
        for (unsigned k = 0; k < n; k++)
            if (taken[i].factors.n_tensor && taken[k].colors.n_plane)
                multiply(&taken[i].factors, &taken[k].colors);
    for (unsigned i = 0; i < n; i++) {
        if (taken[i].message) protobuf_c_message_free_unpacked(taken[i].message, NULL);
        free(taken[i].answer.payload);
    }
    relight_decoder_finish(&d);
    return 0;
}
