// SPDX-License-Identifier: MIT
// Chooses the basis vectors and coefficients that a factored tensor keeps, and lays it out.
#include "bake/spill.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// The choice at one price, by cluster.
struct choice {
    unsigned cpu; // mask of enum prt_cpu
    struct factored *f;
    uint32_t n_cluster, n_function, n, n_coef;
    uint32_t stride;        // every stride-th cluster is evaluated
    bool low_rank;          // rows of components, in bytes; else of functions, in halves
    double entry_bytes;     // of an entry; low_rank: beside a byte for each component
    double row_bytes;       // of a row beside its entries
    double component_bytes; // low_rank: of a component beside its bytes in the entries
    double *bytes;          // [n_cluster] kept
    double *weight;         // [n_cluster] of lost energy: the error is each object's own
    double price;           // weighted energy that one byte has to hold
    const struct pack_options *options;
    double *dropped;   // [n_cluster] energy lost
    uint64_t *entries; // [n_cluster] kept
    uint32_t *rank;    // [n_cluster] kept
    float *threshold;  // [n_cluster] energy above which an entry is kept
};

// An object of less than this part of the mean energy a vertex is not stored as exactly as
// others, for the bytes. Chosen, not measured: its radiance is a hundredth.
static const double least_part = 1e-4;

// Energy that a byte of cluster i has to hold.
static double price_of(const struct choice *c, size_t i)
{
    return c->price / c->weight[i];
}

static bool is_scaling(uint32_t n, uint32_t k)
{
    return k % (n * n) == 0;
}

static int float_down(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return x < y ? 1 : x > y ? -1 : 0;
}

// With a given rank and mean count: the threshold that keeps rank*count over the whole basis.
static int fixed_choice(struct choice *c, size_t i)
{
    struct factored *f = &c->f[i];
    uint32_t rank = c->options->rank && c->options->rank < f->rank ? c->options->rank : f->rank;
    size_t all = (size_t)rank * c->n_coef, want = (size_t)rank * c->options->n_basis_coef;
    c->rank[i] = rank;
    c->threshold[i] = 0;
    if (!want || want >= all) return PRT_OK;
    float *sorted = prt_alloc(all, sizeof *sorted);
    if (!sorted) return PRT_NOMEM;
    memcpy(sorted, f->energy, all * sizeof *sorted);
    qsort(sorted, all, sizeof *sorted, float_down);
    c->threshold[i] = sorted[want];
    prt_free(sorted);
    return PRT_OK;
}

// Bytes of U that row r adds: rows are stored in pairs.
static double u_bytes(const struct factored *f, uint32_t r)
{
    return r % 2 ? 0 : 4.0 * f->n_vertex;
}

// Lagrangian choice: an entry is kept when its energy exceeds the price of its bytes, and a
// basis vector when the surplus of its entries exceeds the price of its column of U.
static void priced_choice(struct choice *c, size_t i)
{
    struct factored *f = &c->f[i];
    const double price = price_of(c, i);
    float limit = (float)(price * c->entry_bytes);
    uint32_t most = c->options->rank && c->options->rank < f->rank ? c->options->rank : f->rank;
    uint32_t keep = 0;
    c->threshold[i] = limit;
    if (c->options->rank) {
        c->rank[i] = most;
        return;
    }
    double surplus = 0, best = 0;
    for (uint32_t r = 0; r < most; r++) {
        const float *e = f->energy + (size_t)r * c->n_coef;
        double own = -price * (u_bytes(f, r) + c->row_bytes);
        for (uint32_t k = 0; k < c->n_coef; k++)
            if (e[k] > limit || is_scaling(c->n, k)) own += (double)e[k] - limit;
        surplus += own;
        if (surplus > best) best = surplus, keep = r + 1;
    }
    c->rank[i] = keep;
}

// The same for low-rank rows, whose components are chosen, too.
static void low_rank_choice(struct choice *c, size_t i, float *room)
{
    struct factored *f = &c->f[i];
    const struct component_price price = {price_of(c, i), c->entry_bytes, c->component_bytes,
                                          c->cpu};
    uint32_t most = c->options->rank && c->options->rank < f->rank ? c->options->rank : f->rank;
    double surplus = 0, best = 0, lost = f->tail ? f->tail[0] : 0, left = lost, bytes = 0;
    uint64_t entries = 0;
    c->rank[i] = 0;
    c->entries[i] = 0;
    for (uint32_t r = 0; r < most; r++) {
        const float *e = f->energy + (size_t)r * c->n_coef;
        struct component_choice row;
        double all = 0;
        prt_choose_components(f, r, c->n_coef, &price, room, &row);
        for (uint32_t k = 0; k < c->n_coef; k++) all += (double)e[k];
        double own = (double)row.entries * (c->entry_bytes + row.width) +
                     row.width * c->component_bytes + u_bytes(f, r) + c->row_bytes;
        // The energy of a column of U: its scaling coefficients and its entries.
        double held = f->tail[r] - f->tail[r + 1] - all + row.energy;
        surplus += held - price.byte * own;
        left -= held;
        bytes += own;
        entries += row.entries;
        if (!(surplus > best) && !c->options->rank) continue;
        best = surplus;
        lost = left;
        c->rank[i] = r + 1;
        c->entries[i] = entries;
        c->bytes[i] = bytes;
    }
    c->dropped[i] = fmax(lost, 0);
}

static int choose_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct choice *c = arg;
    float *room =
        c->low_rank ? prt_alloc(COMPONENT_ROOM * (size_t)c->n_coef, sizeof *room) : NULL;
    if (c->low_rank && !room) return PRT_NOMEM;
    for (size_t turn = begin; turn < end; turn++) {
        size_t i = turn * c->stride;
        struct factored *f = &c->f[i];
        int status = PRT_OK;
        c->bytes[i] = 0;
        if (c->low_rank) {
            low_rank_choice(c, i, room);
            prt_spill_rest(f);
            continue;
        }
        if (c->options->n_basis_coef) status = fixed_choice(c, i);
        else priced_choice(c, i);
        if (status) return status;
        double lost = f->tail ? f->tail[c->rank[i]] : 0;
        uint64_t entries = 0;
        for (uint32_t r = 0; r < c->rank[i]; r++) {
            const float *e = f->energy + (size_t)r * c->n_coef;
            for (uint32_t k = 0; k < c->n_coef; k++) {
                if (is_scaling(c->n, k)) continue;
                if (e[k] > c->threshold[i]) entries++;
                else lost += e[k];
            }
        }
        c->dropped[i] = lost;
        c->entries[i] = entries;
        c->bytes[i] = (double)entries * c->entry_bytes + c->rank[i] * c->row_bytes;
        for (uint32_t r = 0; r < c->rank[i]; r++) c->bytes[i] += u_bytes(f, r);
    }
    prt_free(room);
    return PRT_OK;
}

// Bytes kept and energy lost at a price, over every stride-th cluster.
static int weigh(const struct prt_context *ctx, struct choice *c, double log_price,
                 double *bytes, double *lost)
{
    c->price = exp(log_price);
    uint32_t n = (c->n_cluster + c->stride - 1) / c->stride;
    int status = prt_parallel_for(ctx, NULL, n, 1, choose_range, c);
    *bytes = *lost = 0;
    for (uint32_t i = 0; i < c->n_cluster; i += c->stride) {
        *lost += c->weight[i] * c->dropped[i];
        *bytes += c->bytes[i];
    }
    return status;
}

static double mean_entries(const struct choice *c)
{
    double entries = 0, rows = 0;
    for (uint32_t i = 0; i < c->n_cluster; i++)
        entries += (double)c->entries[i], rows += c->rank[i];
    return rows > 0 ? entries / rows : 0;
}

struct goal {
    double bytes, lost; // at most, of the clusters evaluated
};

static struct goal goal_of(const struct choice *c)
{
    double total = 0, vertices = 0, all = 0;
    for (uint32_t i = 0; i < c->n_cluster; i++) {
        bool own = i % c->stride == 0;
        all += c->f[i].n_vertex;
        vertices += own ? c->f[i].n_vertex : 0;
        if (own && c->f[i].tail) total += c->weight[i] * c->f[i].tail[0];
    }
    double e = c->options->energy_error;
    return (struct goal){c->options->max_bytes * vertices / fmax(all, 1), total * e * e};
}

// > 0 where the price is too high: more energy is lost than allowed, and bytes are left.
static int excess(const struct prt_context *ctx, struct choice *c, double log_price,
                  double *out)
{
    struct goal goal = goal_of(c);
    double bytes, lost;
    int status = weigh(ctx, c, log_price, &bytes, &lost);
    *out = fmin(log(fmax(lost, 1e-300) / fmax(goal.lost, 1e-300)),
                log(fmax(goal.bytes, 1) / fmax(bytes, 1)));
    if (c->options->n_basis_coef)
        *out = log(c->options->n_basis_coef / fmax(mean_entries(c), 1e-3));
    return status;
}

static int bisect(const struct prt_context *ctx, struct choice *c, double *lo, double *hi)
{
    for (int step = 0; step < 24; step++) {
        double mid = 0.5 * (*lo + *hi), more;
        int status = excess(ctx, c, mid, &more);
        if (status) return status;
        if (more > 0) *hi = mid;
        else *lo = mid;
    }
    return PRT_OK;
}

// Refines the multiplier of some clusters on all: a bracket around it, then regula falsi until
// the remaining excess is at most a thousandth. The choice is then the one at *hi.
static int refine(const struct prt_context *ctx, struct choice *c, double *lo, double *hi)
{
    enum { TURNS = 12 };
    const double enough = 1e-3;
    double x = *hi, above = 0, below = 0, step = 0.05, least = *lo, most = *hi;
    bool has_lo = false, has_hi = false;
    for (int turn = 0; turn < TURNS; turn++) {
        double more;
        int status = excess(ctx, c, x, &more);
        if (status) return status;
        if (more >= 0 && more < enough) return *hi = x, PRT_OK;
        if (more > 0) most = x, above = more, has_hi = true;
        else least = x, below = more, has_lo = true;
        if (!has_lo || !has_hi) {
            x += more > 0 ? -step : step;
            step *= 2;
            continue;
        }
        double part = fmin(fmax((0.5 * enough - below) / (above - below), 0.05), 0.95);
        x = least + part * (most - least);
    }
    if (has_hi) *lo = least, *hi = most;
    double more;
    return excess(ctx, c, *hi, &more);
}

// Finds the highest price at which the whole model loses no more than the allowed energy, or,
// where noise or detail would take more than max_bytes for that, the price of max_bytes. With
// many clusters the price is estimated on every n-th cluster, then refined on all.
static int choose(const struct prt_context *ctx, struct choice *c)
{
    enum { SOME = 8 }; // clusters of the estimate; chosen, not measured
    if (c->options->n_basis_coef && !c->low_rank)
        return prt_parallel_for(ctx, NULL, c->n_cluster, 1, choose_range, c);
    double total = 0, more;
    for (uint32_t i = 0; i < c->n_cluster; i++)
        if (c->f[i].tail) total += c->weight[i] * c->f[i].tail[0];
    double hi = log(fmax(total, 1e-300)), lo = hi + log(1e-16);
    bool some = c->n_cluster >= 4 * SOME && !c->options->n_basis_coef;
    if (some) c->stride = c->n_cluster / SOME;
    int status = bisect(ctx, c, &lo, &hi);
    c->stride = 1;
    if (status) return status;
    return some ? refine(ctx, c, &lo, &hi) : excess(ctx, c, hi, &more);
}

// Weights that give every object the mean energy a vertex: what is lost of a dark one counts as
// much as it shows beside the rest of that object.
static int weigh_objects(struct choice *c, const struct clusters *clusters)
{
    uint32_t n_object = 0;
    for (uint32_t i = 0; i < c->n_cluster; i++)
        n_object = clusters->object[i] >= n_object ? clusters->object[i] + 1 : n_object;
    double *energy = prt_calloc(2 * ((size_t)n_object + 1), sizeof *energy);
    double *vertices = energy ? energy + n_object + 1 : NULL;
    if (!energy) return PRT_NOMEM;
    for (uint32_t i = 0; i < c->n_cluster; i++) {
        if (!c->f[i].tail) continue;
        const uint32_t at[2] = {clusters->object[i], n_object}; // its object, and all
        for (int k = 0; k < 2; k++) {
            energy[at[k]] += c->f[i].tail[0];
            vertices[at[k]] += c->f[i].n_vertex;
        }
    }
    const double mean = energy[n_object] / fmax(vertices[n_object], 1);
    for (uint32_t i = 0; i < c->n_cluster; i++) {
        const uint32_t o = clusters->object[i];
        const double own = energy[o] / fmax(vertices[o], 1);
        c->weight[i] = own > 0 ? mean / fmax(own, least_part * mean) : 1;
    }
    prt_free(energy);
    return PRT_OK;
}

static void set_index(struct prt_rows *rows, uint64_t at, uint32_t k)
{
    if (rows->index_bytes == 2) ((uint16_t *)(uintptr_t)rows->index)[at] = (uint16_t)k;
    else ((uint32_t *)(uintptr_t)rows->index)[at] = k;
}

struct layout {
    struct choice *c;
    struct prt_tensor *tensor;
    uint64_t *cluster_entry; // first entry of each cluster
};

// Writes one row of halves times s: its entries from rows->begin[row] on and its scaling
// coefficients. Returns the end of the entries.
static uint64_t write_row(const struct choice *c, size_t i, uint32_t r, float s,
                          struct prt_rows *rows, uint32_t row, float *value)
{
    uint64_t at = rows->begin[row];
    const struct factored *f = &c->f[i];
    const float *e = f->energy + (size_t)r * c->n_coef;
    const uint32_t J = c->n_function, face = c->n * c->n;
    for (uint32_t k = 0; k < c->n_coef; k++) {
        bool dc = k % face == 0;
        if (!dc && !(e[k] > c->threshold[i])) continue;
        for (uint32_t j = 0; j < J; j++) {
            size_t from = (size_t)r * J + j;
            value[j] = prt_f16_to_f32(f->b[from * c->n_coef + k]) * f->scale[from] * s;
        }
        uint16_t *to =
            dc ? (uint16_t *)(uintptr_t)rows->scaling + ((size_t)row * 6 + k / face) * J
               : (uint16_t *)(uintptr_t)rows->entry + at * J;
        prt_f32_to_f16_array(value, J, to);
        if (!dc) set_index(rows, at++, k);
    }
    return at;
}

// Writes row r of U divided by 64 * most as integers, interleaved with the other row of its
// pair.
static void write_u(const struct factored *f, uint32_t r, float most, uint32_t padded,
                    uint16_t *out)
{
    const float *u = f->u + (size_t)r * f->n_vertex, scale = PRT_U_MOST / most;
    int16_t *to = (int16_t *)out + 2 * (size_t)padded * (r / 2) + r % 2;
    for (uint32_t v = 0; v < f->n_vertex; v++)
        to[2 * (size_t)v] = (int16_t)lrintf(u[v] * scale);
}

// Writes one cluster's rows and U. U is divided so that its largest value is 1/64, which keeps
// the rows well inside the range of half floats.
static int write_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct layout *l = arg;
    struct choice *c = l->c;
    struct prt_rows *rows = &l->tensor->rows;
    float *value = prt_alloc(c->n_function, sizeof *value);
    if (!value) return PRT_NOMEM;
    int status = PRT_OK;
    for (size_t i = begin; i < end && !status; i++) {
        const struct prt_cluster *cluster = &l->tensor->cluster[i];
        struct factored *f = &c->f[i];
        uint64_t at = l->cluster_entry[i];
        uint32_t padded = (cluster->n_vertex + 15) / 16 * 16;
        for (uint32_t r = 0; r < cluster->rank && !status; r++) {
            uint32_t row = cluster->row_begin + r;
            const float *u = f->u + (size_t)r * f->n_vertex;
            float most = 1e-30f;
            for (uint32_t v = 0; v < f->n_vertex; v++) most = fmaxf(most, fabsf(u[v]));
            write_u(f, r, most, padded, (uint16_t *)(uintptr_t)l->tensor->u + cluster->u_begin);
            if (c->low_rank) {
                status = prt_write_low_rank_row(f, r, 64 * most, c->cpu, rows, row);
                continue;
            }
            ((uint64_t *)(uintptr_t)rows->begin)[row] = at;
            at = write_row(c, i, r, 64 * most, rows, row, value);
        }
        prt_spill_rest(f);
    }
    prt_free(value);
    return status;
}

// Offsets of the low-rank rows, and memory for their arrays.
static int allocate_low_rank(const struct choice *c, struct prt_tensor *t)
{
    struct prt_rows *rows = &t->rows;
    uint32_t *direction = prt_alloc(rows->n_row + 1u, sizeof *direction);
    uint64_t *value_begin = prt_alloc(rows->n_row + 1u, sizeof *value_begin), at = 0;
    uint32_t row = 0;
    rows->value = PRT_VALUE_I8;
    rows->direction = direction;
    rows->value_begin = value_begin;
    if (!direction || !value_begin) return PRT_NOMEM;
    direction[0] = 0;
    value_begin[0] = 0;
    for (uint32_t i = 0; i < c->n_cluster; i++)
        for (uint32_t r = 0; r < c->rank[i]; r++, row++) {
            ((uint64_t *)(uintptr_t)rows->begin)[row] = at;
            at += c->f[i].count[r];
            direction[row + 1] = direction[row] + c->f[i].width[r];
            value_begin[row + 1] =
                value_begin[row] + (uint64_t)c->f[i].count[r] * c->f[i].width[r];
        }
    rows->entry = prt_alloc(value_begin[row] + 32, 1);
    rows->shift = prt_alloc(at + 32, 1);
    rows->scale = prt_alloc(direction[row] + 1u, sizeof *rows->scale);
    rows->mix = prt_alloc((size_t)direction[row] * c->n_function + 1, sizeof *rows->mix);
    return rows->entry && rows->shift && rows->scale && rows->mix ? PRT_OK : PRT_NOMEM;
}

static int allocate(struct choice *c, const struct clusters *clusters, struct layout *l,
                    struct prt_tensor *t)
{
    uint64_t entries = 0, u = 0;
    uint32_t n_row = 0, n_vertex = 0;
    struct prt_cluster *cluster = prt_calloc(c->n_cluster, sizeof *cluster);
    if (!cluster) return PRT_NOMEM;
    t->cluster = cluster;
    for (uint32_t i = 0; i < c->n_cluster; i++) {
        cluster[i] = clusters->cluster[i];
        cluster[i].rank = c->rank[i];
        cluster[i].row_begin = n_row;
        cluster[i].u_begin = u;
        l->cluster_entry[i] = entries;
        n_row += c->rank[i];
        n_vertex += cluster[i].n_vertex;
        u += (c->rank[i] + 1ull) / 2 * 2 * ((cluster[i].n_vertex + 15) / 16 * 16);
        entries += c->entries[i];
    }
    uint32_t J = c->n_function;
    uint32_t *order = prt_alloc(n_vertex, sizeof *order);
    uint64_t *begin = prt_alloc(n_row + 1u, sizeof *begin);
    t->rows = (struct prt_rows){.n_row = n_row,
                                .n_function = J,
                                .n_coef = c->n_coef,
                                .value = PRT_VALUE_F16,
                                .index_bytes = c->n_coef > 65536 ? 4 : 2};
    t->rows.index = prt_alloc(entries + 32, t->rows.index_bytes);
    if (!c->low_rank) t->rows.entry = prt_alloc((entries + 32) * J, 2);
    t->rows.scaling = prt_alloc((size_t)n_row * 6 * J + 32, 2);
    t->u = prt_calloc(u + 32, 2);
    t->u_count = u;
    t->rows.begin = begin;
    t->order = order;
    t->n_vertex = n_vertex;
    t->n_cluster = c->n_cluster;
    t->n_function = J;
    if (!order || !begin || !t->rows.index || (!c->low_rank && !t->rows.entry) ||
        !t->rows.scaling || !t->u)
        return PRT_NOMEM;
    memcpy(order, clusters->order, n_vertex * sizeof *order);
    begin[n_row] = entries;
    return c->low_rank ? allocate_low_rank(c, t) : PRT_OK;
}

// Rows of one phase term as pairs of integers, which serve several lights at a time.
static int pair_rows(struct prt_tensor *t)
{
    struct prt_rows pairs;
    const int status = prt_rows_pair(&t->rows, &pairs);
    if (status) return status;
    prt_rows_finish(&t->rows);
    t->rows = pairs;
    return PRT_OK;
}

int prt_pack_factored(const struct prt_context *ctx, const struct clusters *clusters,
                      struct factored *factored, uint32_t n_function, uint32_t n,
                      const struct pack_options *options, struct prt_tensor *out)
{
    uint32_t nc = clusters->n_cluster;
    struct choice c = {.f = factored,
                       .cpu = ctx ? ctx->cpu : 0,
                       .n_cluster = nc,
                       .n_function = n_function,
                       .n = n,
                       .n_coef = 6 * n * n,
                       .stride = 1,
                       .options = options,
                       .low_rank = options->low_rank};
    const double index = c.n_coef > 65536 ? 4 : 2;
    c.entry_bytes = c.low_rank ? index + 1 : index + 2.0 * n_function;
    const bool pairs = !c.low_rank && n_function == 3 && index == 2;
    c.row_bytes = 12.0 * n_function + (c.low_rank ? 20 : 8);
    if (pairs) c.row_bytes += 4.0 * n_function + c.entry_bytes; // scales, and a half pair
    c.component_bytes = 2.0 * n_function + 4;
    struct layout l = {&c, out, prt_alloc(nc, sizeof *l.cluster_entry)};
    c.dropped = prt_alloc(nc, sizeof *c.dropped);
    c.entries = prt_alloc(nc, sizeof *c.entries);
    c.rank = prt_alloc(nc, sizeof *c.rank);
    c.bytes = prt_alloc(nc, sizeof *c.bytes);
    c.threshold = prt_alloc(nc, sizeof *c.threshold);
    c.weight = prt_alloc(nc, sizeof *c.weight);
    memset(out, 0, sizeof *out);
    out->storage = PRT_STORAGE_FACTORED;
    int status = l.cluster_entry && c.dropped && c.entries && c.rank && c.threshold &&
                         c.bytes && c.weight
                     ? PRT_OK
                     : PRT_NOMEM;
    if (status == PRT_OK) status = weigh_objects(&c, clusters);
    if (status == PRT_OK) status = choose(ctx, &c);
    if (status == PRT_OK) status = allocate(&c, clusters, &l, out);
    if (status == PRT_OK) status = prt_parallel_for(ctx, NULL, nc, 1, write_range, &l);
    if (status == PRT_OK && pairs) status = pair_rows(out);
    prt_free(l.cluster_entry);
    prt_free(c.dropped);
    prt_free(c.entries);
    prt_free(c.rank);
    prt_free(c.bytes);
    prt_free(c.threshold);
    prt_free(c.weight);
    if (status) prt_tensor_finish(out);
    return status;
}

void prt_tensor_finish(struct prt_tensor *t)
{
    prt_free((void *)(uintptr_t)t->order);
    prt_free((void *)(uintptr_t)t->cluster);
    prt_free((void *)(uintptr_t)t->u);
    prt_free((void *)(uintptr_t)t->u_scale);
    prt_free((void *)(uintptr_t)t->rows.begin);
    prt_free((void *)(uintptr_t)t->rows.index);
    prt_free((void *)(uintptr_t)t->rows.entry);
    prt_free((void *)(uintptr_t)t->rows.scale);
    prt_free((void *)(uintptr_t)t->rows.shift);
    prt_free((void *)(uintptr_t)t->rows.direction);
    prt_free((void *)(uintptr_t)t->rows.value_begin);
    prt_free((void *)(uintptr_t)t->rows.mix);
    prt_free((void *)(uintptr_t)t->rows.scaling);
    prt_free((void *)(uintptr_t)t->knot);
    prt_free((void *)(uintptr_t)t->basis);
    prt_free((void *)(uintptr_t)t->eta);
    memset(t, 0, sizeof *t);
}
