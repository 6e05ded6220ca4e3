// SPDX-License-Identifier: MIT
// Rows of pairs or halves by column (prt/columns.h).
#include "prt/columns.h"

#include <math.h>
#include <string.h>

enum { GROUP_CHUNKS = 2048 }; // their sums under a light take 64 KiB of the L2 cache

// One plane of an entry of a group on its way to its column.
struct item {
    uint16_t row; // of the group, a plane counted as one
    uint16_t column;
    uint32_t at; // entry of the rows, counted from the group's first one
};

// One unit of a column: items [first, first + n) of one chunk.
struct unit {
    uint32_t first;
    float weight;
    uint16_t chunk;
    uint8_t n, mask, level;
};

struct making {
    const struct prt_tensor *tensor;
    struct prt_columns *columns;
    uint32_t n_plane;
    float *scale;        // [n_row][n_plane][3]; 0: the plane has no entries
    float gain[64];      // prt_pair_gain of index | index / n
    uint32_t n;          // of the cube
    const float *length; // [n_row] of U's columns
};

struct group_work {
    const struct making *m;
    struct prt_column_group *g;
    uint32_t row_begin, row_end;
    uint64_t entry_begin;
    struct item *item;    // by column, then row
    uint32_t *column;     // [n_coef + 1] first item
    struct unit *unit;    // by column, chunk
    uint32_t *first_unit; // [n_coef + 1]
};

static float gain_of(const struct making *m, uint32_t index)
{
    return m->gain[(index | index / m->n) & (m->n - 1)];
}

// Channels of plane k of an entry of row `row`, in units of their scale.
static void integers_of(const struct making *m, uint32_t row, uint64_t e, uint32_t k,
                        int16_t out[3])
{
    const struct prt_rows *rows = &m->tensor->rows;
    const float *scale = m->scale + 3ull * ((uint64_t)row * m->n_plane + k);
    const float inverse = 1 / gain_of(m, ((const uint16_t *)rows->index)[e]);
    for (uint32_t ch = 0; ch < 3; ch++)
        if (rows->value == PRT_VALUE_PAIR)
            out[ch] = ((const int16_t *)rows->entry)[e / 2 * 6 + 2 * ch + e % 2];
        else
            out[ch] =
                scale[ch] > 0
                    ? (int16_t)lrintf(
                          prt_f16_to_f32(((const uint16_t *)
                                              rows->entry)[e * rows->n_function + 3 * k + ch]) *
                          inverse / scale[ch])
                    : 0;
}

static bool is_there(const int16_t x[3])
{
    return x[0] || x[1] || x[2];
}

// Sorts the planes of the group's entries, but those that are 0, by column.
static void sort_items(struct group_work *w)
{
    const struct making *m = w->m;
    const struct prt_rows *rows = &m->tensor->rows;
    const uint16_t *index = rows->index;
    const uint32_t n_coef = rows->n_coef;
    int16_t x[3];
    memset(w->column, 0, (n_coef + 2ull) * sizeof *w->column);
    // first the counts, two places higher, then the places, one higher
    for (uint32_t v = w->row_begin; v < w->row_end; v++) {
        const uint32_t row = v / m->n_plane, k = v % m->n_plane;
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            integers_of(m, row, e, k, x);
            if (is_there(x)) w->column[index[e] + 2]++;
        }
    }
    for (uint32_t c = 2; c < n_coef + 2; c++) w->column[c] += w->column[c - 1];
    for (uint32_t v = w->row_begin; v < w->row_end; v++) {
        const uint32_t row = v / m->n_plane, k = v % m->n_plane;
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            integers_of(m, row, e, k, x);
            if (is_there(x))
                w->item[w->column[index[e] + 1]++] = (struct item){
                    (uint16_t)(v - w->row_begin), index[e], (uint32_t)(e - w->entry_begin)};
        }
    }
}

static void item_integers(const struct group_work *w, const struct item *item, int16_t x[3])
{
    const uint32_t v = w->row_begin + item->row;
    integers_of(w->m, v / w->m->n_plane, w->entry_begin + item->at, v % w->m->n_plane, x);
}

static float squared_weight(const struct group_work *w, const struct item *item)
{
    const uint32_t v = w->row_begin + item->row;
    const float factor = gain_of(w->m, item->column) * w->m->length[v / w->m->n_plane];
    float sum = 0;
    int16_t x[3];
    item_integers(w, item, x);
    for (uint32_t ch = 0; ch < 3; ch++) {
        const float a = (float)x[ch] * w->m->scale[3ull * v + ch] * factor;
        sum += a * a;
    }
    return sum;
}

// The units of a column, behind the earlier ones. A second entry of the same row begins another
// unit.
static void find_units(struct group_work *w, uint32_t c)
{
    const uint32_t first = w->first_unit[c];
    uint32_t n = first;
    for (uint32_t i = w->column[c]; i < w->column[c + 1]; i++) {
        const uint32_t chunk = w->item[i].row / PRT_COLUMN_ROWS;
        const uint8_t bit = (uint8_t)(1 << w->item[i].row % PRT_COLUMN_ROWS);
        struct unit *u = n > first ? &w->unit[n - 1] : NULL;
        if (!u || u->chunk != chunk || u->mask & bit) {
            u = &w->unit[n++];
            *u = (struct unit){.first = i, .chunk = (uint16_t)chunk};
        }
        u->n++;
        u->mask |= bit;
        u->weight += squared_weight(w, &w->item[i]);
    }
    for (uint32_t i = first; i < n; i++) {
        w->unit[i].weight = sqrtf(w->unit[i].weight);
        w->g->top = fmaxf(w->g->top, w->unit[i].weight);
    }
    w->first_unit[c + 1] = n;
}

static uint8_t level_of(float weight, float top)
{
    const float level = 2 * log2f(top / weight);
    return level > 0 ? level < PRT_COLUMN_LEVELS - 1 ? (uint8_t)level : PRT_COLUMN_LEVELS - 1
                     : 0;
}

static void put_unit(const struct group_work *w, const struct unit *u)
{
    struct prt_column_group *g = w->g;
    g->unit[g->n_unit++] = (uint16_t)(u->chunk << 5 | u->mask);
    for (uint32_t i = 0; i < u->n; i++)
        item_integers(w, &w->item[u->first + i], g->entry + 3ull * g->n_entry++);
}

// The column's units, level by level.
static void put_column(struct group_work *w, uint32_t c)
{
    struct prt_column_group *g = w->g;
    const struct unit *end = w->unit + w->first_unit[c + 1];
    const uint32_t first = g->n_unit;
    g->unit_begin[c] = first;
    g->entry_begin[c] = g->n_entry;
    g->lowest[c] = PRT_COLUMN_LEVELS;
    for (struct unit *u = w->unit + w->first_unit[c]; u < end; u++) {
        u->level = level_of(u->weight, g->top);
        if (u->level < g->lowest[c]) g->lowest[c] = u->level;
    }
    for (uint8_t level = 0; level < PRT_COLUMN_LEVELS; level++) {
        for (const struct unit *u = w->unit + w->first_unit[c]; u < end; u++)
            if (u->level == level) put_unit(w, u);
        g->count[c][level] = (uint16_t)(g->n_unit - first);
    }
}

static int group_start(const struct making *m, size_t i, struct group_work *w)
{
    const struct prt_rows *rows = &m->tensor->rows;
    struct prt_column_group *g = &m->columns->group[i];
    *w = (struct group_work){.m = m, .g = g};
    w->row_begin = PRT_COLUMN_ROWS * g->chunk_begin;
    w->row_end = PRT_COLUMN_ROWS * (g->chunk_begin + g->n_chunk);
    if (w->row_end > m->columns->n_row) w->row_end = m->columns->n_row;
    w->entry_begin = rows->begin[w->row_begin / m->n_plane];
    uint64_t n = 0;
    for (uint32_t v = w->row_begin; v < w->row_end; v++)
        n += rows->begin[v / m->n_plane + 1] - rows->begin[v / m->n_plane];
    w->item = prt_alloc(n + 1, sizeof *w->item);
    w->column = prt_alloc(rows->n_coef + 2ull, sizeof *w->column);
    // A column has a unit for each chunk, and one for each second entry of a row.
    w->unit = prt_alloc(n + 1, sizeof *w->unit);
    w->first_unit = prt_calloc(rows->n_coef + 1ull, sizeof *w->first_unit);
    g->lowest = prt_alloc(rows->n_coef, 1);
    g->unit_begin = prt_alloc(rows->n_coef, sizeof *g->unit_begin);
    g->entry_begin = prt_alloc(rows->n_coef, sizeof *g->entry_begin);
    g->count = prt_alloc(rows->n_coef, sizeof *g->count);
    return w->item && w->column && w->unit && w->first_unit && g->lowest && g->unit_begin &&
                   g->entry_begin && g->count
               ? PRT_OK
               : PRT_NOMEM;
}

static int make_group(struct group_work *w)
{
    struct prt_column_group *g = w->g;
    const uint32_t n_coef = w->m->tensor->rows.n_coef;
    sort_items(w);
    for (uint32_t c = 0; c < n_coef; c++) find_units(w, c);
    g->unit = prt_alloc(w->first_unit[n_coef] + 1ull, sizeof *g->unit);
    g->entry = prt_calloc(3ull * w->column[n_coef] + 32, sizeof *g->entry);
    if (!g->unit || !g->entry) return PRT_NOMEM;
    for (uint32_t c = 0; c < n_coef; c++) put_column(w, c);
    return PRT_OK;
}

static void group_finish(struct group_work *w)
{
    prt_free(w->item);
    prt_free(w->column);
    prt_free(w->unit);
    prt_free(w->first_unit);
}

static int make_groups(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct making *m = arg;
    int status = PRT_OK;
    for (size_t i = begin; i < end && !status; i++) {
        struct group_work w;
        status = group_start(m, i, &w);
        if (!status) status = make_group(&w);
        group_finish(&w);
    }
    return status;
}

// Lengths of the columns of U that rows are multiplied with, [n_row]; the largest one where
// clusters share a row.
static void find_lengths(const struct prt_tensor *t, float *length)
{
    memset(length, 0, t->rows.n_row * sizeof *length);
    for (uint32_t k = 0; k < t->n_cluster; k++) {
        const struct prt_cluster *c = &t->cluster[k];
        const size_t padded = ((size_t)c->n_vertex + 15) & ~(size_t)15;
        for (uint32_t r = 0; r < c->rank; r++) {
            const int16_t *u = (const int16_t *)t->u + c->u_begin + r / 2 * padded * 2 + r % 2;
            float sum = 0;
            for (uint32_t v = 0; v < c->n_vertex; v++) {
                const float x = (float)u[2 * (size_t)v] * PRT_U_UNIT;
                sum += x * x;
            }
            float *own = &length[c->row_begin + r];
            *own = fmaxf(*own, sqrtf(sum));
        }
    }
}

// Scales of pairs, or those at which the largest half of a row, plane and channel is 32767.
static void find_scales(struct making *m)
{
    const struct prt_rows *rows = &m->tensor->rows;
    const uint32_t J = rows->n_function;
    if (rows->value == PRT_VALUE_PAIR) {
        memcpy(m->scale, rows->scale, 12ull * rows->n_row);
        return;
    }
    memset(m->scale, 0, 4ull * J * rows->n_row);
    for (uint32_t row = 0; row < rows->n_row; row++) {
        float *scale = m->scale + (uint64_t)row * J;
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
            const float inverse = 1 / gain_of(m, ((const uint16_t *)rows->index)[e]);
            for (uint32_t j = 0; j < J; j++)
                scale[j] =
                    fmaxf(scale[j],
                          fabsf(prt_f16_to_f32(((const uint16_t *)rows->entry)[e * J + j])) *
                              inverse);
        }
        for (uint32_t j = 0; j < J; j++) scale[j] /= 32767;
    }
}

// Scales, scaling coefficients and lengths in lanes, and the Gram matrices.
static void fill_lanes(const struct making *m)
{
    const struct prt_rows *rows = &m->tensor->rows;
    struct prt_columns *c = m->columns;
    double gram[3][6][6] = {0};
    for (uint32_t v = 0; v < c->n_row; v++)
        for (uint32_t ch = 0; ch < 3; ch++) {
            const uint32_t row = v / m->n_plane, j = 3 * (v % m->n_plane) + ch;
            const size_t chunk = v / PRT_COLUMN_ROWS, lane = v % PRT_COLUMN_ROWS * 3 + ch;
            const float own = m->scale[3ull * v + ch], scale = own > 0 ? own : 1;
            const float length = m->length[row];
            float x[6];
            c->scale[chunk * PRT_COLUMN_LANES + lane] = scale;
            c->length[chunk * PRT_COLUMN_LANES + lane] = length;
            for (uint32_t f = 0; f < 6; f++) {
                x[f] = prt_f16_to_f32(
                    rows->scaling[((uint64_t)row * 6 + f) * rows->n_function + j]);
                c->scaling[(chunk * 6 + f) * PRT_COLUMN_LANES + lane] = x[f] / scale;
            }
            for (uint32_t f = 0; f < 6; f++)
                for (uint32_t h = 0; h < 6; h++)
                    gram[ch][f][h] += (double)(x[f] * x[h] * length * length);
        }
    for (uint32_t i = 0; i < 108; i++) (&c->gram[0][0][0])[i] = (float)(&gram[0][0][0])[i];
}

static struct prt_columns *columns_alloc(uint32_t n_row, uint32_t n_plane)
{
    struct prt_columns *c = prt_calloc(1, sizeof *c);
    if (!c) return NULL;
    c->n_row = n_row * n_plane;
    c->n_plane = n_plane;
    c->n_chunk = (c->n_row + PRT_COLUMN_ROWS - 1) / PRT_COLUMN_ROWS;
    c->n_group = (c->n_chunk + GROUP_CHUNKS - 1) / GROUP_CHUNKS;
    const size_t lanes = (size_t)c->n_chunk * PRT_COLUMN_LANES;
    c->group = prt_calloc(c->n_group + 1ull, sizeof *c->group);
    c->scale = prt_calloc(lanes + 1, sizeof *c->scale);
    c->scaling = prt_calloc(6 * lanes + 1, sizeof *c->scaling);
    c->length = prt_calloc(lanes + 1, sizeof *c->length);
    if (!c->group || !c->scale || !c->scaling || !c->length) {
        prt_columns_destroy(c);
        return NULL;
    }
    for (uint32_t i = 0; i < c->n_group; i++) {
        const uint64_t begin = (uint64_t)c->n_chunk * i / c->n_group;
        c->group[i].chunk_begin = (uint32_t)begin;
        c->group[i].n_chunk = (uint32_t)((uint64_t)c->n_chunk * (i + 1) / c->n_group - begin);
    }
    return c;
}

static void count_all(struct prt_columns *c, uint32_t n_coef)
{
    c->bytes = sizeof *c + (uint64_t)c->n_chunk * PRT_COLUMN_LANES * 8 * sizeof(float);
    for (uint32_t i = 0; i < c->n_group; i++) {
        const struct prt_column_group *g = &c->group[i];
        c->n_unit += g->n_unit;
        c->bytes +=
            sizeof *g + g->n_unit * sizeof *g->unit +
            (3ull * g->n_entry + 32) * sizeof *g->entry +
            n_coef * (1 + sizeof *g->unit_begin + sizeof *g->entry_begin + sizeof *g->count);
    }
}

bool prt_columns_possible(const struct prt_tensor *t)
{
    const struct prt_rows *rows = &t->rows;
    return t->storage == PRT_STORAGE_FACTORED && t->coupling == PRT_COUPLE_DIAGONAL &&
           rows->index_bytes == 2 && rows->n_row < UINT32_MAX / 64 &&
           (rows->value == PRT_VALUE_PAIR || rows->value == PRT_VALUE_F16);
}

int prt_columns_make(const struct prt_context *ctx, const struct prt_tensor *tensor,
                     struct prt_columns **out)
{
    const struct prt_rows *rows = &tensor->rows;
    *out = NULL;
    if (!prt_columns_possible(tensor))
        return prt_fail(ctx, PRT_ARG, "only factored rows of pairs or halves have columns");
    float *length = prt_alloc(rows->n_row + 1ull, sizeof *length);
    struct making m = {
        .tensor = tensor,
        .n = 1,
        .n_plane = rows->n_function / 3,
        .scale = prt_alloc((uint64_t)rows->n_row * rows->n_function + 1, sizeof *m.scale),
        .length = length};
    m.columns = columns_alloc(rows->n_row, m.n_plane);
    while (6 * m.n * m.n < rows->n_coef) m.n *= 2;
    for (uint32_t t = 0; t < 64; t++) m.gain[t] = t < m.n ? prt_pair_gain(m.n, t) : 1;
    int status = length && m.columns && m.scale ? PRT_OK : PRT_NOMEM;
    if (!status) {
        find_lengths(tensor, length);
        find_scales(&m);
        fill_lanes(&m);
        status = prt_parallel_for(ctx, NULL, m.columns->n_group, 1, make_groups, &m);
    }
    prt_free(length);
    prt_free(m.scale);
    if (status) {
        prt_columns_destroy(m.columns);
        return prt_fail(ctx, status, "no memory for columns of %u rows", rows->n_row);
    }
    count_all(m.columns, rows->n_coef);
    *out = m.columns;
    return PRT_OK;
}

void prt_columns_destroy(struct prt_columns *c)
{
    if (!c) return;
    for (uint32_t i = 0; c->group && i < c->n_group; i++) {
        prt_free(c->group[i].lowest);
        prt_free(c->group[i].unit_begin);
        prt_free(c->group[i].entry_begin);
        prt_free(c->group[i].count);
        prt_free(c->group[i].unit);
        prt_free(c->group[i].entry);
    }
    prt_free(c->group);
    prt_free(c->scale);
    prt_free(c->scaling);
    prt_free(c->length);
    prt_free(c);
}
