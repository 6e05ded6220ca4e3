// SPDX-License-Identifier: MIT
// Contraction by columns (METHODS §3.4): of a light's coefficients and the units of their
// columns (prt/columns.h), only products that matter are summed. Which ones depends on the
// light alone, not on the kernels, threads or the lights beside it.
#include "contract_columns.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// A unit is left out where its weight times the light's coefficient is below
// COLUMN_ERROR * |colours| / sqrt(units): were all left out, of which none knows of another,
// the colours' relative RMS error would be COLUMN_ERROR. It is a tenth to a third of that.
#define COLUMN_ERROR 0.005f

enum { BATCH = 32 }; // columns that are handed to a kernel at once

typedef float lanes16 __attribute__((vector_size(64), aligned(4)));

// What every light is contracted with.
struct run {
    const struct prt_kernels *kernels;
    const struct prt_tensor *tensor;
    const struct prt_light *const *light;
    uint32_t n, n_coef; // of the cube
    float gain[64];
    struct column_light *state; // [n_light]
    float *out;
    size_t light_pitch, row_pitch;
    bool again; // only lights whose threshold was too high
    uint32_t chosen[PRT_RELIGHT_MAX_LIGHTS], n_chosen;
};

// One light.
struct column_light {
    bool taken, again;
    float threshold, base; // base: the length that the colours are expected to have
    uint64_t n_unit;       // that are summed
    uint8_t *keep;         // [n_group][n_coef] levels that are kept
    double *length;        // [n_group] squared, of the colours
};

static float largest_channel(const float *x)
{
    const float a = fabsf(x[0]), b = fabsf(x[1]), c = fabsf(x[2]);
    const float most = a > b ? a : b;
    return most > c ? most : c;
}

// Squared length of what the scaling coefficients add.
static float scaling_length(const struct prt_columns *c, const struct prt_light *light)
{
    const size_t face = (size_t)light->n * light->n;
    double sum = 0;
    for (uint32_t ch = 0; ch < 3; ch++)
        for (uint32_t f = 0; f < 6; f++)
            for (uint32_t h = 0; h < 6; h++)
                sum += (double)(c->gram[ch][f][h]) * (double)light->coef[4 * face * f + ch] *
                       (double)light->coef[4 * face * h + ch];
    return sum > 0 ? (float)sqrt(sum) : 0;
}

// Levels with top 2^(-l/2) x >= threshold: the exponent of the ratio's square, and one.
static void levels_kept(const float *most, uint32_t n_coef, float ratio, uint8_t *keep)
{
    for (uint32_t i = 0; i < n_coef; i++) {
        const float x = most[i] * ratio, square = x * x;
        int32_t bits;
        memcpy(&bits, &square, 4);
        int32_t n = (bits >> 23) - 126;
        n = n < 0 ? 0 : n;
        keep[i] = (uint8_t)(n > PRT_COLUMN_LEVELS ? PRT_COLUMN_LEVELS : n);
    }
}

static uint64_t kept_units(const struct prt_column_group *g, const uint8_t *keep,
                           uint32_t n_coef)
{
    uint64_t n = 0;
    for (uint32_t i = 0; i < n_coef; i++)
        if (g->lowest[i] < keep[i]) n += g->count[i][keep[i] - 1];
    return n;
}

static int choose(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct run *run = arg;
    const struct prt_columns *c = run->tensor->columns;
    float *most = prt_alloc(run->n_coef, sizeof *most);
    if (!most) return PRT_NOMEM;
    for (size_t l = begin; l < end; l++) {
        struct column_light *s = &run->state[l];
        const float *coef = run->light[l]->coef;
        if (run->again && !s->again) continue;
        bool finite = s->base < 1e18f;
        float all = 0;
        for (uint32_t i = 0; i < run->n_coef; i++) {
            most[i] = largest_channel(coef + 4 * (size_t)i);
            all = most[i] > all ? most[i] : all;
            finite &= most[i] < 1e18f;
        }
        s->n_unit = 0;
        const float tiny = 1e-18f;
        const float threshold = s->threshold > tiny ? s->threshold : tiny;
        for (uint32_t i = 0; i < c->n_group; i++) {
            uint8_t *keep = s->keep + (size_t)i * run->n_coef;
            levels_kept(most, run->n_coef, c->group[i].top / threshold, keep);
            s->n_unit += kept_units(&c->group[i], keep, run->n_coef);
        }
        // beyond that, rows are faster
        s->taken = finite && s->n_unit <= c->n_unit / 2;
    }
    prt_free(most);
    return PRT_OK;
}

// Lights that are summed together, and a group of rows.
struct piece {
    const struct run *run;
    const struct prt_column_group *g;
    uint32_t group;
    unsigned n_light;
    uint32_t light[LIGHT_GROUP];
};

// Sets the sums of a light to what its scaling coefficients add.
static void begin_sums(const struct piece *p, unsigned l, float *sum)
{
    const struct prt_light *light = p->run->light[p->light[l]];
    const float *scaling = p->run->tensor->columns->scaling + 96ull * p->g->chunk_begin;
    const size_t face = (size_t)light->n * light->n;
    lanes16 x[6] = {0};
    for (uint32_t f = 0; f < 6; f++)
        for (uint32_t i = 0; i < 3 * PRT_COLUMN_ROWS; i++)
            x[f][i] = light->coef[4 * face * f + i % 3];
    for (uint32_t k = 0; k < p->g->n_chunk; k++) {
        const lanes16 *s = (const lanes16 *)(scaling + 96ull * k);
        *(lanes16 *)(sum + 16ull * (k * p->n_light + l)) =
            s[0] * x[0] + s[1] * x[1] + s[2] * x[2] + s[3] * x[3] + s[4] * x[4] + s[5] * x[5];
    }
}

// The units of column i that matter under any of the piece's lights.
static void fill_part(const struct piece *p, uint32_t i, struct column_part *part)
{
    const struct run *run = p->run;
    const struct prt_column_group *g = p->g;
    const float gain = run->gain[(i | i / run->n) & (run->n - 1)];
    part->unit = g->unit + g->unit_begin[i];
    part->entry = g->entry + 3ull * g->entry_begin[i];
    part->n_light = 0;
    for (unsigned l = 0; l < p->n_light; l++) {
        const uint8_t keep = run->state[p->light[l]].keep[(size_t)p->group * run->n_coef + i];
        const float *x = run->light[p->light[l]]->coef + 4 * (size_t)i;
        if (g->lowest[i] >= keep) continue;
        const uint32_t n = g->count[i][keep - 1];
        unsigned at = part->n_light++;
        for (; at && part->n[at - 1] < n; at--) {
            part->n[at] = part->n[at - 1];
            part->at[at] = part->at[at - 1];
            memcpy(part->x[at], part->x[at - 1], sizeof part->x[at]);
        }
        part->n[at] = n;
        part->at[at] = PRT_COLUMN_LANES * l;
        for (int ch = 0; ch < 3; ch++) part->x[at][ch] = gain * x[ch];
    }
}

static const uint8_t *keep_of(const struct piece *p, unsigned l)
{
    return p->run->state[p->light[l]].keep + (size_t)p->group * p->run->n_coef;
}

// The most levels that any of the piece's lights keeps: its own where there is one light, else
// `most` is filled.
static const uint8_t *most_kept(const struct piece *p, uint8_t *most)
{
    const uint32_t n = p->run->n_coef;
    if (p->n_light == 1) return keep_of(p, 0);
    memcpy(most, keep_of(p, 0), n);
    for (unsigned l = 1; l < p->n_light; l++) {
        const uint8_t *keep = keep_of(p, l);
        for (uint32_t i = 0; i < n; i++) most[i] = most[i] > keep[i] ? most[i] : keep[i];
    }
    return most;
}

static void add_columns(const struct piece *p, uint8_t *most, float *sum)
{
    const struct run *run = p->run;
    const size_t stride = (size_t)PRT_COLUMN_LANES * p->n_light;
    const uint8_t *keep = most_kept(p, most), *lowest = p->g->lowest;
    struct column_part part[BATCH];
    size_t n = 0;
    for (uint32_t i = 0; i < run->n_coef; i++) {
        if (lowest[i] >= keep[i]) continue;
        fill_part(p, i, &part[n++]);
        if (n < BATCH) continue;
        run->kernels->columns(part, n, stride, sum);
        n = 0;
    }
    run->kernels->columns(part, n, stride, sum);
}

// The group's rows of a light from its sums; returns the squared length of their colours.
static double put_rows(const struct piece *p, unsigned l, const float *sum)
{
    const struct prt_columns *c = p->run->tensor->columns;
    float *out = p->run->out + p->light[l] * p->run->light_pitch;
    lanes16 square = {0};
    double length = 0;
    size_t row = (size_t)p->g->chunk_begin * PRT_COLUMN_ROWS, plane = row % c->n_plane;
    float *to = out + row / c->n_plane * p->run->row_pitch;
    for (uint32_t k = 0; k < p->g->n_chunk; k++) {
        const size_t chunk = p->g->chunk_begin + k;
        const lanes16 x = *(const lanes16 *)(sum + 16ull * (k * p->n_light + l)) *
                          *(lanes16 *)(c->scale + 16 * chunk);
        const lanes16 y = x * *(lanes16 *)(c->length + 16 * chunk);
        float lane[16];
        square += y * y;
        memcpy(lane, &x, sizeof lane);
        for (uint32_t r = 0; r < PRT_COLUMN_ROWS && row < c->n_row; r++, row++) {
            memcpy(to + 3 * plane, lane + 3ull * r, 12);
            if (++plane == c->n_plane) plane = 0, to += p->run->row_pitch;
        }
    }
    for (int i = 0; i < 3 * PRT_COLUMN_ROWS; i++) length += (double)square[i];
    return length;
}

static int run_piece(const struct piece *p)
{
    float *sum = prt_alloc((size_t)p->g->n_chunk * PRT_COLUMN_LANES * p->n_light, sizeof *sum);
    uint8_t *most = prt_alloc(p->run->n_coef, 1);
    for (unsigned l = 0; sum && most && l < p->n_light; l++) begin_sums(p, l, sum);
    if (sum && most) add_columns(p, most, sum);
    for (unsigned l = 0; sum && most && l < p->n_light; l++)
        p->run->state[p->light[l]].length[p->group] = put_rows(p, l, sum);
    const int status = sum && most ? PRT_OK : PRT_NOMEM;
    prt_free(most);
    prt_free(sum);
    return status;
}

// Each group of rows under LIGHT_GROUP of the lights that are contracted.
static int run_pieces(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct run *run = arg;
    const struct prt_columns *c = run->tensor->columns;
    int status = PRT_OK;
    for (size_t i = begin; i < end && !status; i++) {
        struct piece p = {.run = run, .group = (uint32_t)(i % c->n_group)};
        p.g = &c->group[p.group];
        for (uint32_t k = 0; k < LIGHT_GROUP; k++) {
            const uint32_t at = (uint32_t)(i / c->n_group) * LIGHT_GROUP + k;
            if (at < run->n_chosen) p.light[p.n_light++] = run->chosen[at];
        }
        if (p.n_light) status = run_piece(&p);
    }
    return status;
}

// Where the colours are darker than expected, what was left out may be much of them.
static bool lower_threshold(const struct run *run, struct column_light *s)
{
    double length = 0;
    for (uint32_t k = 0; k < run->tensor->columns->n_group; k++) length += s->length[k];
    const double darker = sqrt(length) / (double)s->base;
    s->again = s->taken && darker < 0.25;
    if (s->again) s->threshold *= darker > 0.01 ? (float)darker : 0.01f;
    return s->again;
}

// Contracts the lights that are taken; of a second round, those whose threshold was lowered.
static int run_round(const struct prt_context *ctx, struct run *run, unsigned n_light)
{
    int status = prt_parallel_for(ctx, NULL, n_light, 1, choose, run);
    run->n_chosen = 0;
    for (unsigned l = 0; l < n_light; l++)
        if (run->state[l].taken && (!run->again || run->state[l].again))
            run->chosen[run->n_chosen++] = l;
    const size_t n = (run->n_chosen + LIGHT_GROUP - 1) / LIGHT_GROUP;
    return status ? status
                  : prt_parallel_for(ctx, NULL, n * run->tensor->columns->n_group, 1,
                                     run_pieces, run);
}

static int contract(const struct prt_context *ctx, struct run *run, unsigned n_light)
{
    const struct prt_columns *c = run->tensor->columns;
    for (unsigned l = 0; l < n_light; l++) {
        struct column_light *s = &run->state[l];
        s->base = scaling_length(c, run->light[l]);
        s->threshold = COLUMN_ERROR * s->base / sqrtf((float)(c->n_unit + 1));
    }
    int status = run_round(ctx, run, n_light);
    for (unsigned l = 0; l < n_light && !status; l++)
        run->again |= lower_threshold(run, &run->state[l]);
    return !run->again || status ? status : run_round(ctx, run, n_light);
}

int prt_contract_columns(const struct prt_context *ctx, const struct prt_tensor *tensor,
                         unsigned n_light, const struct prt_light *const light[],
                         size_t light_pitch, size_t row_pitch, float *out, bool taken[])
{
    const struct prt_columns *c = tensor->columns;
    struct column_light state[PRT_RELIGHT_MAX_LIGHTS] = {{0}};
    struct run run = {.kernels = prt_kernels_for(ctx->cpu),
                      .tensor = tensor,
                      .light = light,
                      .n = light[0]->n,
                      .n_coef = tensor->rows.n_coef,
                      .state = state,
                      .out = out,
                      .light_pitch = light_pitch,
                      .row_pitch = row_pitch};
    const size_t each = (size_t)c->n_group * run.n_coef;
    uint8_t *keep = prt_alloc(n_light * each + 1, 1);
    double *length = prt_calloc((size_t)n_light * c->n_group + 1, sizeof *length);
    int status = keep && length ? PRT_OK : PRT_NOMEM;
    for (uint32_t t = 0; t < 64; t++) run.gain[t] = t < run.n ? prt_pair_gain(run.n, t) : 1;
    for (unsigned l = 0; l < n_light && !status; l++) {
        state[l].keep = keep + l * each;
        state[l].length = length + (size_t)l * c->n_group;
    }
    if (!status) status = contract(ctx, &run, n_light);
    for (unsigned l = 0; l < n_light; l++) taken[l] = !status && state[l].taken;
    prt_free(keep);
    prt_free(length);
    return status ? prt_fail(ctx, status, "no memory for the columns of %u lights", n_light)
                  : PRT_OK;
}
