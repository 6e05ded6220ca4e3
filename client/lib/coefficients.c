// SPDX-License-Identifier: MIT
// FACTORS, and coefficients multiplied by them (PROTOCOL.md, "FACTORS and coefficients").
#include "internal.h"

#include <math.h>

static const float u_unit = 0x1p-20f;

static size_t stride_of(uint32_t n_vertex)
{
    return ((size_t)n_vertex + 15) / 16 * 16;
}

static uint32_t least(uint32_t rank, uint32_t limit)
{
    return limit && rank > limit ? limit : rank;
}

// Numbers of U in one cluster.
static uint64_t block_of(const uint32_t cluster[2], uint32_t most_rank)
{
    return ((uint64_t)least(cluster[1], most_rank) + 1) / 2 * 2 * stride_of(cluster[0]);
}

static bool section_fits(uint64_t offset, uint64_t bytes, uint64_t payload_size)
{
    return offset % RELIGHT_FRAME_ALIGN == 0 && offset <= payload_size &&
           bytes <= payload_size - offset;
}

// Whether clusters and order describe every vertex once and U has their numbers.
static bool tensor_holds(const struct relight_factor_tensor *t, uint32_t n_vertex,
                         uint32_t most_rank)
{
    uint64_t vertices = 0, u = 0;
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        if (t->cluster[c][1] > RELIGHT_MOST_RANK) return false;
        vertices += t->cluster[c][0];
        u += block_of(t->cluster[c], most_rank);
        if (vertices > n_vertex || u > t->n_u) return false;
    }
    uint8_t *seen = calloc((size_t)n_vertex + 1, 1);
    bool good = seen && vertices == n_vertex && u == t->n_u;
    for (uint32_t i = 0; good && i < n_vertex; i++) {
        good = t->order[i] < n_vertex && !seen[t->order[i]];
        if (good) seen[t->order[i]] = 1;
    }
    free(seen);
    return good;
}

static bool get_tensor(const Relight__FactorTensor *m, const struct answer *answer,
                       uint32_t n_vertex, uint32_t most_rank, struct relight_factor_tensor *out)
{
    const uint8_t *p = answer->payload;
    if (!section_fits(m->clusters_offset, 8ull * m->n_cluster, answer->payload_size) ||
        !section_fits(m->order_offset, 4ull * n_vertex, answer->payload_size) ||
        !section_fits(m->u_offset, m->u_bytes, answer->payload_size) || m->u_bytes % 4)
        return false;
    *out = (struct relight_factor_tensor){
        .single = m->term == RELIGHT__TERM__TERM_SINGLE,
        .exit = m->exit,
        .n_cluster = m->n_cluster,
        .cluster = (const uint32_t(*)[2])(p + m->clusters_offset),
        .order = (const uint32_t *)(p + m->order_offset),
        .u = (const int16_t *)(p + m->u_offset),
        .n_u = m->u_bytes / 2,
    };
    return tensor_holds(out, n_vertex, most_rank);
}

int relight_get_factors(const Relight__FactorsAnswer *m, const struct answer *answer,
                        uint32_t most_rank, struct relight_factors *out,
                        struct relight_error *error)
{
    *out = (struct relight_factors){
        .hash = m->factors, .n_vertex = m->n_vertex, .most_rank = most_rank};
    bool good = m->n_tensors <= RELIGHT_MOST_LAYERS;
    for (size_t i = 0; good && i < m->n_tensors; i++)
        good = get_tensor(m->tensors[i], answer, m->n_vertex, most_rank, &out->tensor[i]);
    out->n_tensor = good ? (uint32_t)m->n_tensors : 0;
    return good ? 0
                : relight_fail(error, RELIGHT_E_PROTOCOL, "",
                               "factors answer: clusters, vertices and U do not fit together");
}

static int fetch_factors(struct relight_client *client, const char *model, uint32_t most_rank,
                         bool exits, struct relight_factors *out, struct relight_error *error)
{
    Relight__FactorsRequest m = RELIGHT__FACTORS_REQUEST__INIT;
    struct relight_factors factors;
    struct answer *answer;
    m.model = relight_text(model);
    m.most_rank = most_rank;
    m.exits = exits;
    int status = relight_call(client, RELIGHT_TYPE_FACTORS, &m.base, &answer, error);
    if (status) return status;
    status = relight_get_factors((Relight__FactorsAnswer *)answer->message, answer, most_rank,
                                 &factors, error);
    if (status) {
        relight_answer_free(answer);
        return status;
    }
    if (!(factors.owner = relight_owner(answer)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for factors");
    *out = factors;
    return 0;
}

int relight_factors(struct relight_client *client, const char *model, uint32_t most_rank,
                    struct relight_factors *out, struct relight_error *error)
{
    return fetch_factors(client, model, most_rank, false, out, error);
}

int relight_factors_with_exits(struct relight_client *client, const char *model,
                               uint32_t most_rank, struct relight_factors *out,
                               struct relight_error *error)
{
    return fetch_factors(client, model, most_rank, true, out, error);
}

void relight_factors_finish(struct relight_factors *factors)
{
    relight_owner_free(factors->owner);
    *factors = (struct relight_factors){0};
}

// ---- coefficients of an answer

// Of n triples.
static uint64_t triples_bytes(int format, uint64_t n)
{
    return format == RELIGHT_COLOR_COEFFICIENTS_PACKED ? 4 * (n + n % 2) : 6 * n;
}

static bool get_layer(const Relight__CoefficientLayer *m, const Relight__ColorsAnswer *colors,
                      struct relight_layer *out)
{
    const uint32_t phases = m->n_phase;
    *out = (struct relight_layer){.tensor = m->tensor,
                                  .n_phase = phases,
                                  .n_row = m->n_row,
                                  .offset = m->offset,
                                  .scale = m->scales};
    const uint64_t bytes = triples_bytes((int)colors->format, (uint64_t)m->n_row * phases);
    for (size_t i = 0; i < m->n_scales; i++)
        if (!isfinite(m->scales[i])) return false;
    return (phases == 1 || phases == 4 || phases == 9 || phases == 16) &&
           m->n_scales == colors->n_plane && m->tensor < RELIGHT_MOST_LAYERS &&
           section_fits(m->offset, bytes, colors->plane_bytes);
}

bool relight_get_coefficients(const Relight__ColorsAnswer *m, struct relight_colors *out)
{
    const Relight__Coefficients *c = m->coefficients;
    if (!c || c->n_layers > RELIGHT_MOST_LAYERS || !c->n_outgoing) return false;
    out->factors = c->factors;
    out->most_rank = c->most_rank;
    out->n_layer = (uint32_t)c->n_layers;
    out->n_outgoing = c->n_outgoing;
    out->outgoings = c->outgoing;
    for (uint32_t i = 0; i < out->n_layer; i++)
        if (!get_layer(c->layers[i], m, &out->layer[i])) return false;
    return true;
}

int relight_colors_outgoing(const struct relight_colors *colors, size_t block,
                            struct relight_outgoing *out)
{
    if (!colors->n_outgoing || (colors->n_outgoing > 1 && block >= colors->n_outgoing))
        return -RELIGHT_E_ARGUMENT;
    const Relight__Outgoing *const *all = colors->outgoings;
    const Relight__Outgoing *m = all[colors->n_outgoing > 1 ? block : 0];
    *out = (struct relight_outgoing){.eta = m->eta,
                                     .roughness = m->roughness,
                                     .mean = m->mean,
                                     .divisor = m->divisor,
                                     .view_slope = m->view_slope};
    return 0;
}

// ---- products

// Triples [first, first + n) of a layer of COEFFICIENTS_PACKED (PROTOCOL.md).
static void decode_packed(const uint8_t *from, size_t first, size_t n, float *out)
{
    for (size_t i = 0; i < n; i++) {
        const size_t even = (first + i) / 2 * 2;
        uint32_t two[2];
        memcpy(two, from + 4 * even, 8);
        const float step = ldexpf(1, (int)(two[0] >> 30 | two[1] >> 30 << 2) - 9);
        const uint32_t x = two[first + i - even];
        for (int c = 0; c < 3; c++) {
            const int m = (int)(x >> 10 * c & 1023);
            out[3 * i + (size_t)c] = (float)(m < 512 ? m : m - 1024) * step;
        }
    }
}

// Rows [first, first + n) of a layer, [n + 1][n_phase][3], the last one 0. width: 3 n_phase.
static void decode_rows(int format, const uint8_t *from, size_t first, size_t n, size_t width,
                        float scale, float *out)
{
    const uint16_t *half = (const uint16_t *)(const void *)from + first * width;
    if (format == RELIGHT_COLOR_COEFFICIENTS_PACKED)
        decode_packed(from, first * width / 3, n * width / 3, out);
    else relight_decode_f16(half, n * width, out);
    for (size_t i = 0; i < n * width; i++) out[i] *= scale;
    memset(out + n * width, 0, width * sizeof *out);
}

// value[3 * vertex] of one channel += U b, b in steps of `width` floats.
static void add_channel(const int16_t *u, size_t stride, uint32_t n_vertex, uint32_t n_row,
                        const float *b, size_t width, const uint32_t *order, float *sum,
                        float *value)
{
    memset(sum, 0, n_vertex * sizeof *sum);
    for (uint32_t r = 0; r < n_row; r += 2) {
        const int16_t *pair = u + (size_t)r * stride;
        const float b0 = b[r * width], b1 = b[(r + 1) * width];
        for (uint32_t i = 0; i < n_vertex; i++)
            sum[i] += (float)pair[2 * i] * b0 + (float)pair[2 * i + 1] * b1;
    }
    for (uint32_t i = 0; i < n_vertex; i++) value[3 * (size_t)order[i]] += sum[i] * u_unit;
}

struct product {
    const struct relight_factors *factors;
    const struct relight_factor_tensor *tensor;
    const struct relight_layer *layer;
    uint32_t most_rank; // of the coefficients
    int format;
    const uint8_t *numbers;
    float scale;
    float *row, *sum; // of the largest cluster
};

static void add_layer(const struct product *p, uint32_t n_phase, float *const phase[])
{
    const struct relight_factor_tensor *t = p->tensor;
    const size_t width = 3 * (size_t)p->layer->n_phase;
    size_t row = 0;
    const uint32_t *order = t->order;
    const int16_t *u = t->u;
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const uint32_t *cluster = t->cluster[c], sent = least(cluster[1], p->most_rank);
        const uint32_t n_row = least(sent, p->factors->most_rank);
        decode_rows(p->format, p->numbers, row, n_row, width, p->scale, p->row);
        for (uint32_t k = 0; k < n_phase && k < p->layer->n_phase; k++)
            for (size_t ch = 0; ch < 3; ch++)
                add_channel(u, stride_of(cluster[0]), cluster[0], n_row, p->row + 3 * k + ch,
                            width, order, p->sum, phase[k] + ch);
        row += sent;
        order += cluster[0];
        u += block_of(cluster, p->factors->most_rank);
    }
}

// Room for the largest cluster; checks that the layer has the rows of all clusters.
static int plan(struct product *p, struct relight_error *error)
{
    const struct relight_factor_tensor *t = p->tensor;
    uint64_t rows = 0, rank = 0, vertices = 0;
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const uint32_t n = least(t->cluster[c][1], p->most_rank);
        rows += n;
        if (n > rank) rank = n;
        if (t->cluster[c][0] > vertices) vertices = t->cluster[c][0];
    }
    if (rows != p->layer->n_row)
        return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                            "coefficients: %u rows where the clusters have %llu",
                            p->layer->n_row, (unsigned long long)rows);
    p->row = malloc((rank + 2) * 3 * p->layer->n_phase * sizeof *p->row);
    p->sum = malloc((vertices + 1) * sizeof *p->sum);
    return p->row && p->sum ? 0
                            : relight_fail(error, RELIGHT_E_NO_MEMORY, "",
                                           "not enough memory for coefficients");
}

// Where the sums of a tensor go: planes [n][n_vertex][3], n 0: they are not wanted.
struct sums {
    float *plane[RELIGHT_MOST_PHASES];
    uint32_t n;
};

static void sums_clear(struct sums *sums, float *to, uint32_t n, size_t size)
{
    sums->n = n;
    for (uint32_t k = 0; k < n; k++) sums->plane[k] = to + k * size;
    if (n) memset(to, 0, n * size * sizeof *to);
}

// into: of tensors of multiple scattering, of single scattering, of the planes of exit.
static int expand(const struct relight_factors *factors, const struct relight_colors *colors,
                  uint32_t plane, const struct sums into[3], struct relight_error *error)
{
    int status = 0;
    if (!relight_is_coefficients((int)colors->format) || plane >= colors->n_plane)
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "no coefficients of plane %u",
                            plane);
    if (colors->factors != factors->hash || colors->n_vertex != factors->n_vertex)
        return relight_fail(error, RELIGHT_E_MISMATCH, "fetch the factors again",
                            "these coefficients belong to the factors of another bake");
    for (uint32_t i = 0; i < colors->n_layer && !status; i++) {
        const struct relight_layer *layer = &colors->layer[i];
        if (layer->tensor >= factors->n_tensor)
            return relight_fail(error, RELIGHT_E_PROTOCOL, "",
                                "coefficients of tensor %u, the factors have %u", layer->tensor,
                                factors->n_tensor);
        const struct relight_factor_tensor *tensor = &factors->tensor[layer->tensor];
        const struct sums *sums = &into[tensor->exit ? 2 : tensor->single];
        struct product p = {
            .factors = factors,
            .tensor = tensor,
            .layer = layer,
            .most_rank = colors->most_rank,
            .format = (int)colors->format,
            .numbers =
                (const uint8_t *)colors->data + plane * colors->plane_bytes + layer->offset,
            .scale = layer->scale[plane],
        };
        if (!sums->n) continue;
        status = plan(&p, error);
        if (!status) add_layer(&p, sums->n, sums->plane);
        free(p.row);
        free(p.sum);
    }
    return status;
}

int relight_coefficients_expand(const struct relight_factors *factors,
                                const struct relight_colors *colors, uint32_t plane,
                                uint32_t n_phase, float *multiple, float *single,
                                struct relight_error *error)
{
    const size_t n = 3 * (size_t)factors->n_vertex;
    struct sums into[3] = {{.n = 0}};
    if (n_phase > RELIGHT_MOST_PHASES)
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "no coefficients of %u phases",
                            n_phase);
    sums_clear(&into[0], multiple, 1, n);
    sums_clear(&into[1], single, n_phase, n);
    return expand(factors, colors, plane, into, error);
}

int relight_coefficients_exits(const struct relight_factors *factors,
                               const struct relight_colors *colors, uint32_t plane,
                               float *exits, struct relight_error *error)
{
    struct sums into[3] = {{.n = 0}};
    sums_clear(&into[2], exits, RELIGHT_EXIT_PLANES, 3 * (size_t)factors->n_vertex);
    return expand(factors, colors, plane, into, error);
}

int relight_coefficients_colors(const struct relight_factors *factors,
                                const struct relight_colors *colors, uint32_t plane,
                                size_t n_block, const struct relight_block *block, float *out,
                                struct relight_error *error)
{
    float *single = malloc(((size_t)factors->n_vertex + 1) * 12);
    if (!single)
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "",
                            "not enough memory for coefficients");
    int status = relight_coefficients_expand(factors, colors, plane, 1, out, single, error);
    for (size_t i = 0; i < n_block && !status; i++) {
        const uint64_t begin = block[i].vertex_begin, end = begin + block[i].n_vertex;
        struct relight_outgoing outgoing = {.mean = 1};
        if (block[i].translucent && relight_colors_outgoing(colors, i, &outgoing))
            status = relight_fail(error, RELIGHT_E_PROTOCOL, "",
                                  "coefficients lack what leaves block %zu", i);
        for (uint64_t k = 3 * begin; k < 3 * end && end <= factors->n_vertex; k++) {
            const float sum = out[k] + (block[i].translucent ? single[k] : 0);
            out[k] = fmaxf(0, outgoing.mean * sum);
            if (block[i].has_gain) out[k] *= block[i].gain[k % 3];
        }
    }
    free(single);
    return status;
}
