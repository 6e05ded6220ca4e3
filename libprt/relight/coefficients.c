// SPDX-License-Identifier: MIT
// Contracted rows as halves: the part of a relighting that a viewer with U can finish itself.
#include "answer.h"
#include "kernels.h"
#include "pack_triples.h"

#include <math.h>
#include <string.h>

enum { LAYER_ALIGN = 32 }; // halves: layers begin at multiples of 64 bytes

static uint32_t rows_of(const struct prt_cluster *c, uint32_t most_rank)
{
    return most_rank && c->rank > most_rank ? most_rank : c->rank;
}

int prt_coefficients_add_layer(const struct prt_context *ctx,
                               const struct prt_transport *transport, uint32_t tensor,
                               unsigned n_plane, struct prt_coefficients *c)
{
    const struct prt_tensor *t = &transport->tensor[tensor];
    struct prt_coefficient_layer *layer = &c->layer[c->n_layer];
    if (t->storage != PRT_STORAGE_FACTORED)
        return prt_fail(ctx, PRT_MISMATCH,
                        "%s storage has no bases that coefficients could belong to: take "
                        "colours, or bake wavelet or joint transport with --storage factored",
                        t->storage == PRT_STORAGE_SPARSE ? "sparse" : "polynomial");
    *layer = (struct prt_coefficient_layer){.tensor = tensor, .n_plane = n_plane, .scale = 1};
    layer->begin = (c->n_half + LAYER_ALIGN - 1) / LAYER_ALIGN * LAYER_ALIGN;
    for (uint32_t i = 0; i < t->n_cluster; i++)
        layer->n_row += rows_of(&t->cluster[i], c->most_rank);
    const size_t n = (size_t)layer->n_row * n_plane;
    c->n_half = layer->begin + (c->packed ? 2 * (n + n % 2) : 3 * n);
    c->n_layer++;
    return PRT_OK;
}

struct gather {
    const struct prt_kernels *kernels;
    unsigned cpu;
    const struct prt_term_input *part;
    unsigned n_light, n_plane;
    uint32_t most_rank;
    size_t *begin; // [n_cluster] first row of the cluster in `rows`
    size_t n_row;
    float *rows; // [n_light][n_row][n_plane][3]
    size_t scratch;
    struct prt_coefficients *const *out;
    unsigned layer;
};

// The cluster's folded rows, those of one light together.
static int gather_clusters(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct gather *g = arg;
    const struct prt_tensor *t = g->part->tensor;
    const size_t width = 3 * (size_t)g->n_plane;
    float *scratch = prt_alloc(g->scratch, sizeof *scratch);
    if (!scratch) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++) {
        struct prt_cluster c = t->cluster[i];
        const uint32_t n = c.rank = rows_of(&c, g->most_rank); // others were not computed
        const bool dark = g->part->dark && g->part->dark[i];
        const float *in = dark || !n ? NULL
                                     : prt_fold_cluster(g->kernels, g->part, (uint32_t)i, n,
                                                        g->n_light, g->n_plane, scratch);
        for (unsigned l = 0; l < g->n_light; l++)
            for (uint32_t r = 0; r < n; r++) {
                float *to = g->rows + (l * g->n_row + g->begin[i] + r) * width;
                if (in) memcpy(to, in + ((size_t)r * g->n_light + l) * width, 4 * width);
                else memset(to, 0, 4 * width);
            }
    }
    prt_free(scratch);
    return PRT_OK;
}

// Halves of one light each: the largest becomes 2^14 to 2^15, so that small ones keep their
// digits.
static int round_lights(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct gather *g = arg;
    const size_t n = g->n_row * g->n_plane * 3;
    for (size_t l = begin; l < end; l++) {
        float *rows = g->rows + l * n;
        const float most = prt_largest_magnitude(g->cpu, rows, n);
        struct prt_coefficient_layer *layer = &g->out[l]->layer[g->layer];
        int exponent = 15;
        if (most > 0 && isfinite(most)) frexpf(most, &exponent);
        if (exponent < -100) exponent = -100;
        layer->scale = ldexpf(1, exponent - 15);
        const float inverse = ldexpf(1, 15 - exponent);
        uint16_t *half = g->out[l]->half + layer->begin;
        if (g->out[l]->packed) {
            prt_pack_triples(g->cpu, rows, inverse, n / 3, (uint32_t *)(void *)half);
            continue;
        }
        for (size_t i = 0; i < n; i++) rows[i] *= inverse;
        prt_f32_to_f16_array(rows, n, half);
    }
    return PRT_OK;
}

static void plan_gather(struct gather *g)
{
    const struct prt_tensor *t = g->part->tensor;
    uint32_t rank = 0;
    g->n_row = 0;
    for (uint32_t i = 0; i < t->n_cluster; i++) {
        g->begin[i] = g->n_row;
        g->n_row += rows_of(&t->cluster[i], g->most_rank);
        if (t->cluster[i].rank > rank) rank = t->cluster[i].rank;
    }
    g->scratch = (size_t)rank * 3 * t->n_phase * g->n_light + 1;
}

int prt_coefficients_fill(const struct prt_context *ctx, const struct prt_term_input *part,
                          unsigned layer, unsigned n_light,
                          struct prt_coefficients *const out[])
{
    const struct prt_tensor *t = part->tensor;
    struct gather g = {.kernels = prt_kernels_for(ctx->cpu),
                       .cpu = ctx->cpu,
                       .part = part,
                       .n_light = n_light,
                       .n_plane = out[0]->layer[layer].n_plane,
                       .most_rank = out[0]->most_rank,
                       .begin = prt_alloc(t->n_cluster + 1ull, sizeof(size_t)),
                       .out = out,
                       .layer = layer};
    int status = g.begin ? PRT_OK : PRT_NOMEM;
    if (!status) plan_gather(&g);
    if (!status) g.rows = prt_alloc(n_light * g.n_row * g.n_plane * 3 + 1, sizeof *g.rows);
    if (!g.rows) status = PRT_NOMEM;
    if (!status) status = prt_parallel_for(ctx, NULL, t->n_cluster, 8, gather_clusters, &g);
    if (!status) status = prt_parallel_for(ctx, NULL, n_light, 1, round_lights, &g);
    prt_free(g.begin);
    prt_free(g.rows);
    return status == PRT_NOMEM ? prt_fail(ctx, status, "no memory for coefficients") : status;
}
