// SPDX-License-Identifier: MIT
// Low-rank rows (prt_rows, "mixed"): the responses of a spatial pattern to all training media
// have rank 4 to 5 to 1 %. A row stores the components, combinations of functions, and an entry
// one byte a component instead of one a function.
#include "bake/loops.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

// Components with a smaller share of the cluster's energy are not computed. It lies far below
// the energy error that packing allows (0.75e-2 squared). Chosen, not measured.
static const double component_share = 2e-8;
// Added to the metric, relative to its mean: keeps functions that no training medium uses from
// being free of error, for media outside the training. Chosen, not measured.
static const double metric_floor = 1e-5;

// Error of a combination of functions, summed over the training media.
struct metric {
    uint32_t n;
    double *l; // [n][n] lower: train^T train = l l^T
};

static int metric_create(const struct factor_plan *plan, struct metric *m)
{
    const uint32_t n = plan->n_function;
    double trace = 0;
    m->n = n;
    m->l = calloc((size_t)n * n, sizeof *m->l);
    if (!m->l) return PRT_NOMEM;
    for (uint32_t t = 0; t < plan->n_train; t++)
        for (uint32_t i = 0; i < n; i++)
            for (uint32_t j = 0; j <= i; j++)
                m->l[i * n + j] +=
                    (double)plan->train[t * n + i] * (double)plan->train[t * n + j];
    for (uint32_t i = 0; i < n; i++) trace += m->l[i * n + i];
    for (uint32_t i = 0; i < n; i++) m->l[i * n + i] += metric_floor * trace / n;
    return LAPACKE_dpotrf(LAPACK_ROW_MAJOR, 'L', (int)n, m->l, (int)n) ? PRT_INTERNAL : PRT_OK;
}

// Eigenvectors of the symmetric g [n][n] as its columns, by rising value; at least the last
// `wanted` of them. work: [n][n]. Where few are wanted all would take three times as long (168
// functions at the nodes of eta).
static int eigenvectors(double *g, int n, int wanted, double *value, double *work)
{
    lapack_int support[2 * MAX_COMPONENTS], found = 0;
    if (3 * wanted > n)
        return LAPACKE_dsyev(LAPACK_ROW_MAJOR, 'V', 'L', n, g, n, value) ? PRT_INTERNAL
                                                                         : PRT_OK;
    if (LAPACKE_dsyevr(LAPACK_ROW_MAJOR, 'V', 'I', 'L', n, g, n, 0, 0, n - wanted + 1, n, 0,
                       &found, value, work, wanted, support) ||
        found != wanted)
        return PRT_INTERNAL;
    memmove(value + n - wanted, value, (size_t)wanted * sizeof *value);
    memset(g, 0, (size_t)n * (size_t)n * sizeof *g);
    for (int i = 0; i < n; i++)
        memcpy(g + (size_t)i * (size_t)n + n - wanted, work + (size_t)i * (size_t)wanted,
               (size_t)wanted * sizeof *g);
    return PRT_OK;
}

// Components of one row by falling energy over training, from the Gram matrix [n][n] (lower) of
// its functions: forward [d][n] maps functions to components, back [d][n] components to
// functions, energy [d]. work: [2 n n + n].
static int find_components(const struct metric *m, const float *gram, uint32_t n_component,
                           double *work, float *forward, float *back, double *energy)
{
    const int n = (int)m->n;
    double *g = work, *v = work + (size_t)n * (size_t)n, *value = v + (size_t)n * (size_t)n;
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) g[i * n + j] = g[j * n + i] = (double)gram[i * n + j];
    // l^T (b b^T) l
    cblas_dtrmm(CblasRowMajor, CblasLeft, CblasLower, CblasTrans, CblasNonUnit, n, n, 1, m->l,
                n, g, n);
    cblas_dtrmm(CblasRowMajor, CblasRight, CblasLower, CblasNoTrans, CblasNonUnit, n, n, 1,
                m->l, n, g, n);
    if (eigenvectors(g, n, (int)n_component, value, v)) return PRT_INTERNAL;
    memcpy(v, g, (size_t)n * (size_t)n * sizeof *v); // columns, by rising energy
    cblas_dtrmm(CblasRowMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, n, n, 1, m->l,
                n, v, n); // l v: its columns map to components
    cblas_dtrsm(CblasRowMajor, CblasLeft, CblasLower, CblasTrans, CblasNonUnit, n, n, 1, m->l,
                n, g,
                n); // l^-T v
    for (uint32_t d = 0; d < n_component; d++) {
        energy[d] = fmax(value[n - 1 - (int)d], 0);
        for (int j = 0; j < n; j++) {
            forward[d * m->n + (uint32_t)j] = (float)v[j * n + n - 1 - (int)d];
            back[d * m->n + (uint32_t)j] = (float)g[j * n + n - 1 - (int)d];
        }
    }
    return PRT_OK;
}

// One component's coefficients as halves, divided by the largest.
static void to_halves(const float *x, uint32_t n, uint16_t *out, float *scale, float *room)
{
    const float most = largest_of(x, n);
    *scale = most > 0 ? most : 1;
    for (uint32_t k = 0; k < n; k++) room[k] = x[k] / *scale;
    prt_f32_to_f16_array(room, n, out);
}

// Memory for rows of nd components.
static int allocate(const struct factor_plan *plan, uint32_t nd, struct factored *f)
{
    const uint32_t J = plan->n_function, n_coef = 6 * plan->n * plan->n;
    size_t rows = (size_t)f->rank * nd;
    f->n_component = nd;
    f->b = prt_calloc(rows * n_coef + 1, sizeof *f->b);
    f->scale = prt_calloc(rows + 1, sizeof *f->scale);
    f->component = prt_calloc(rows * J + 1, sizeof *f->component);
    f->scaling = prt_alloc((size_t)f->rank * 6 * J + 1, sizeof *f->scaling);
    f->energy = prt_calloc((size_t)f->rank * n_coef + 1, sizeof *f->energy);
    f->width = calloc(f->rank + 1u, 1);
    f->limit = calloc(f->rank + 1u, sizeof *f->limit);
    f->count = calloc(f->rank + 1u, sizeof *f->count);
    return f->b && f->scale && f->component && f->scaling && f->energy && f->width &&
                   f->limit && f->count
               ? PRT_OK
               : PRT_NOMEM;
}

// The coefficients of component d of row r.
static void coefficients(const struct factored *f, uint32_t r, uint32_t d, uint32_t n_coef,
                         float *out)
{
    size_t from = (size_t)r * f->n_component + d;
    prt_f16_to_f32_array(f->b + from * n_coef, n_coef, out);
    for (uint32_t k = 0; k < n_coef; k++) out[k] *= f->scale[from];
}

// Stores component d of row r, Haar coefficients with the scaling ones set to 0. room:
// [n_coef].
static void store_component(struct factored *f, uint32_t r, uint32_t d, const float *x,
                            uint32_t n_coef, float *room)
{
    size_t at = (size_t)r * f->n_component + d;
    float *energy = f->energy + (size_t)r * n_coef;
    to_halves(x, n_coef, f->b + at * n_coef, f->scale + at, room);
    coefficients(f, r, d, n_coef,
                 room); // as rounded to halves, so that kept and lost energy add up
    for (uint32_t k = 0; k < n_coef; k++) energy[k] += room[k] * room[k];
}

int prt_compress_rows(const struct factor_plan *plan, float *b, struct factored *f)
{
    const uint32_t J = plan->n_function, n_coef = 6 * plan->n * plan->n,
                   face = plan->n * plan->n, nd = J < MAX_COMPONENTS ? J : MAX_COMPONENTS;
    struct metric m = {0};
    double *work = malloc((2 * (size_t)J * J + J + nd) * sizeof *work);
    float *turned = prt_alloc((size_t)nd * n_coef + (size_t)J * J + (size_t)nd * J + n_coef,
                              sizeof *turned);
    int status = allocate(plan, nd, f);
    if (!work || !turned) status = PRT_NOMEM;
    if (status == PRT_OK) status = metric_create(plan, &m);
    float *gram = turned ? turned + (size_t)nd * n_coef : NULL;
    float *forward = turned ? gram + (size_t)J * J : NULL,
          *room = forward ? forward + nd * J : NULL;
    for (uint32_t r = 0; r < f->rank && !status; r++) {
        float *row = b + (size_t)r * J * n_coef;
        for (uint32_t k = 0; k < 6; k++)
            for (uint32_t j = 0; j < J; j++) {
                float *x = &row[(size_t)j * n_coef + (size_t)k * face];
                f->scaling[((size_t)r * 6 + k) * J + j] = *x;
                *x = 0;
            }
        cblas_ssyrk(CblasRowMajor, CblasLower, CblasNoTrans, (int)J, (int)n_coef, 1, row,
                    (int)n_coef, 0, gram, (int)J);
        status = find_components(&m, gram, nd, work, forward, f->component + (size_t)r * nd * J,
                                 work + 2 * (size_t)J * J + J);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)nd, (int)n_coef, (int)J, 1,
                    forward, (int)J, row, (int)n_coef, 0, turned, (int)n_coef);
        for (uint32_t d = 0; d < nd; d++)
            store_component(f, r, d, turned + (size_t)d * n_coef, n_coef, room);
    }
    free(m.l);
    free(work);
    prt_free(turned);
    return status;
}

float *prt_compression_lights(const struct factor_plan *plan)
{
    const uint32_t m = plan->n_probe, wide = m + 6, face = plan->n * plan->n;
    float *x = prt_calloc(6 * (size_t)face * wide, sizeof *x);
    for (uint32_t k = 0; x && k < 6 * face; k++) {
        memcpy(x + (size_t)k * wide, plan->probe + (size_t)k * m, m * sizeof *x);
        x[(size_t)k * wide + m + k / face] = plan->solid_angle[k] / (float)plan->n;
    }
    return x;
}

// The scaling coefficients of the probes, [6][n_probe].
static void probe_scaling(const struct factor_plan *plan, float *out)
{
    const uint32_t m = plan->n_probe, face = plan->n * plan->n;
    memset(out, 0, 6 * (size_t)m * sizeof *out);
    for (uint32_t k = 0; k < 6 * face; k++)
        for (uint32_t i = 0; i < m; i++)
            out[k / face * m + i] +=
                plan->probe[(size_t)k * m + i] / (plan->solid_angle[k] * (float)plan->n);
}

// The components of all rows before they are computed.
struct combination {
    uint32_t J, wide, m, nd;
    float *row;     // [rank][J][wide] U's projection of the response
    float *scaling; // [6][m] scaling coefficients of the probes
    float *forward; // [rank][nd][J]
    uint32_t *held; // [rank] components worth computing
};

// Components of every row from its response to white lights, whose mean product is the Gram
// matrix of the functions. Components without energy are left out; their energy is counted as
// lost.
static int choose_held(const struct factor_plan *plan, struct combination *s,
                       struct factored *f)
{
    const uint32_t J = s->J, nd = s->nd, n_coef = 6 * plan->n * plan->n;
    struct metric m = {0};
    double *work = malloc((2 * (size_t)J * J + J + nd) * sizeof *work);
    float *gram = prt_alloc((size_t)J * J, sizeof *gram);
    int status = work && gram ? metric_create(plan, &m) : PRT_NOMEM;
    for (uint32_t r = 0; r < f->rank && !status; r++) {
        float *z = s->row + (size_t)r * J * s->wide;
        double *energy = work + 2 * (size_t)J * J + J;
        for (uint32_t j = 0; j < J; j++)
            for (uint32_t k = 0; k < 6; k++)
                f->scaling[((size_t)r * 6 + k) * J + j] = z[(size_t)j * s->wide + s->m + k];
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)J, (int)s->m, 6, -1,
                    z + s->m, (int)s->wide, s->scaling, (int)s->m, 1, z, (int)s->wide);
        cblas_ssyrk(CblasRowMajor, CblasLower, CblasNoTrans, (int)J, (int)s->m, 1 / (float)s->m,
                    z, (int)s->wide, 0, gram, (int)J);
        status = find_components(&m, gram, nd, work, s->forward + (size_t)r * nd * J,
                                 f->component + (size_t)r * nd * J, energy);
        for (uint32_t d = 0; d < nd; d++) {
            if (energy[d] > component_share * f->tail[0] || !d) s->held[r] = d + 1;
            else f->energy[(size_t)r * n_coef] += (float)energy[d];
        }
    }
    free(m.l);
    free(work);
    prt_free(gram);
    return status;
}

// Computes the held components of all rows at once and stores their Haar coefficients.
static int compute_held(const struct factor_plan *plan, const struct row_source *source,
                        const struct combination *s, struct factored *f)
{
    const uint32_t J = s->J, n_coef = 6 * plan->n * plan->n, face = plan->n * plan->n;
    uint32_t n = 0;
    for (uint32_t r = 0; r < f->rank; r++) n += s->held[r];
    float *w = prt_alloc((size_t)n * J + 1, sizeof *w),
          *x = prt_alloc((n + 1) * (size_t)n_coef, 4);
    uint32_t *row = prt_alloc(n + 1u, sizeof *row);
    int status = w && x && row ? PRT_OK : PRT_NOMEM;
    for (uint32_t r = 0, i = 0; r < f->rank && !status; r++)
        for (uint32_t d = 0; d < s->held[r]; d++, i++) {
            row[i] = r;
            memcpy(w + (size_t)i * J, s->forward + ((size_t)r * s->nd + d) * J, J * sizeof *w);
        }
    if (!status) status = source->combine(source->user, f->u, f->rank, n, w, row, x);
    for (uint32_t r = 0, i = 0; r < f->rank && !status; r++)
        for (uint32_t d = 0; d < s->held[r]; d++, i++) {
            float *own = x + (size_t)i * n_coef;
            for (uint32_t k = 0; k < n_coef; k++) own[k] *= plan->solid_angle[k];
            for (uint32_t k = 0; k < 6; k++) {
                prt_haar_forward(plan->n, own + (size_t)k * face);
                own[(size_t)k * face] = 0;
            }
            store_component(f, r, d, own, n_coef, x + (size_t)n * n_coef);
        }
    prt_free(w);
    prt_free(x);
    prt_free(row);
    return status;
}

int prt_compress_source(const struct factor_plan *plan, const struct row_source *source,
                        const float *response, struct factored *f)
{
    const uint32_t J = plan->n_function, n_vertex = source->n_vertex;
    struct combination s = {.J = J,
                            .m = plan->n_probe,
                            .wide = plan->n_probe + 6,
                            .nd = J < MAX_COMPONENTS ? J : MAX_COMPONENTS};
    s.row = prt_alloc((size_t)f->rank * J * s.wide + 1, sizeof *s.row);
    s.scaling = prt_alloc(6 * (size_t)s.m, sizeof *s.scaling);
    s.forward = prt_alloc((size_t)f->rank * s.nd * J + 1, sizeof *s.forward);
    s.held = prt_calloc(f->rank + 1u, sizeof *s.held);
    int status =
        s.row && s.scaling && s.forward && s.held ? allocate(plan, s.nd, f) : PRT_NOMEM;
    for (uint32_t j = 0; j < J && f->rank && !status; j++)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)f->rank, (int)s.wide,
                    (int)n_vertex, 1, f->u, (int)n_vertex,
                    response + (size_t)j * n_vertex * s.wide, (int)s.wide, 0,
                    s.row + (size_t)j * s.wide, (int)(J * s.wide));
    if (!status) {
        probe_scaling(plan, s.scaling);
        status = choose_held(plan, &s, f);
    }
    if (!status) status = compute_held(plan, source, &s, f);
    prt_free(s.row);
    prt_free(s.scaling);
    prt_free(s.forward);
    prt_free(s.held);
    return status;
}

// Rounding to bytes loses a twelfth of the squared step in energy; the step is a 127th of the
// largest value, halved as often as the entry allows. Where that exceeds the price of an entry
// the residual is stored as a second entry. Returns the share of the row's largest values above
// which this is so. unit2: the sum of the components' squared steps.
static float twice_above(float unit2, float limit)
{
    int exponent; // a step above 2^(exponent-1), the largest power below, loses more than limit
    frexp(sqrt(12 * (double)limit / fmax((double)unit2, 1e-300)), &exponent);
    return ldexpf(1, exponent < 1 ? exponent - 1 : 0);
}

// A row's components as floats, decoded on first use into room [COMPONENT_ROOM][n_coef], whose
// first two arrays are the sums of their squares and the shares of the largest values.
struct decoded_row {
    const struct factored *f;
    uint32_t r, n_coef, n;
    float *sum, *share, *x;
    const struct bake_loops *loops;
};

static struct decoded_row decode_row(const struct factored *f, uint32_t r, uint32_t n_coef,
                                     unsigned cpu, float *room)
{
    return (struct decoded_row){.f = f,
                                .r = r,
                                .n_coef = n_coef,
                                .sum = room,
                                .share = room + n_coef,
                                .x = room + 2 * (size_t)n_coef,
                                .loops = prt_bake_loops(cpu)};
}

static const float *decode_component(struct decoded_row *s, uint32_t d)
{
    for (; s->n <= d; s->n++)
        coefficients(s->f, s->r, s->n, s->n_coef, s->x + (size_t)s->n * s->n_coef);
    return s->x + (size_t)d * s->n_coef;
}

static void sum_energies(struct decoded_row *s, uint32_t width)
{
    memset(s->sum, 0, s->n_coef * sizeof *s->sum);
    for (uint32_t d = 0; d < width; d++) {
        const float *x = decode_component(s, d);
        for (uint32_t k = 0; k < s->n_coef; k++) s->sum[k] += x[k] * x[k];
    }
}

// Entries of a row with its first `width` components, whose energies are in s->sum. *lost gets
// the energy lost by rounding to bytes.
static uint64_t count_entries(struct decoded_row *s, uint32_t width, float limit, double *lost)
{
    float unit2 = 0, above;
    memset(s->share, 0, s->n_coef * sizeof *s->share);
    for (uint32_t d = 0; d < width; d++) {
        const float *x = decode_component(s, d);
        float most = s->loops->largest(x, s->sum, limit, s->n_coef);
        unit2 += most / 127 * (most / 127);
        s->loops->raise_share(x, 127 / most, s->share, s->n_coef);
    }
    above = 127 * twice_above(unit2, limit);
    *lost = (double)unit2 / 12 *
            (double)s->loops->squared_steps(s->sum, limit, s->share, above, s->n_coef);
    return s->loops->count_above(s->sum, limit, s->share, above, s->n_coef);
}

// A component is kept when its energy in the kept entries exceeds the price of its byte in
// each.
void prt_choose_components(struct factored *f, uint32_t r, uint32_t n_coef,
                           const struct component_price *price, float *room,
                           struct component_choice *out)
{
    enum { AHEAD = 4, TURNS = 4 };
    struct decoded_row s = decode_row(f, r, n_coef, price->cpu, room);
    uint32_t width = f->width[r] ? f->width[r] : AHEAD,
             next; // starts from the choice at another price
    if (width > f->n_component) width = f->n_component;
    next = width;
    for (int turn = 0; turn < TURNS && (!turn || next != width); turn++) {
        uint32_t look = next + AHEAD < f->n_component ? next + AHEAD : f->n_component;
        width = next;
        *out = (struct component_choice){
            .width = width, .limit = (float)(price->byte * (price->entry_bytes + width))};
        sum_energies(&s, width);
        out->entries = s.loops->count_above(s.sum, out->limit, s.sum, INFINITY, n_coef);
        double cost = price->byte * ((double)out->entries + price->component_bytes);
        next = 0;
        for (uint32_t d = 0; d < look && (d < width || next == d); d++) {
            float all =
                s.loops->kept_energy(decode_component(&s, d), s.sum, out->limit, n_coef);
            if (d < width) out->energy += (double)all;
            if (next == d && (!d || (double)all > cost)) next = d + 1;
        }
    }
    double lost;
    out->entries = count_entries(&s, out->width, out->limit, &lost);
    out->energy -= lost;
    f->width[r] = (uint8_t)out->width;
    f->limit[r] = out->limit;
    f->count[r] = (uint32_t)out->entries;
}

// Rounds an entry to bytes: the largest of its values, each in its component's unit, takes all
// 7 bits. value keeps the residual.
static uint8_t put_bytes(float *value, uint32_t n, int8_t *out)
{
    float most = 0, up;
    int exponent;
    for (uint32_t d = 0; d < n; d++) most = fmaxf(most, fabsf(value[d]));
    frexpf(fmaxf(most, 1e-30f) / 127.0001f, &exponent); // most <= 127 * 2^exponent
    int shift = exponent > 0 ? 0 : exponent < -63 ? 63 : -exponent;
    up = ldexpf(1, shift);
    for (uint32_t d = 0; d < n; d++) {
        out[d] = (int8_t)lrintf(value[d] * up);
        value[d] -= out[d] / up;
    }
    return (uint8_t)shift;
}

// Arrays of prt_rows are const for readers; packing writes them.
#define WRITABLE(type, p) ((type *)(uintptr_t)(p))

// Writes component d's weights divided by the largest; returns the largest.
static float write_component(const struct factored *f, uint32_t r, uint32_t d, uint32_t J,
                             uint16_t *out)
{
    const float *mix = f->component + ((size_t)r * f->n_component + d) * J;
    float most = 1e-30f;
    for (uint32_t j = 0; j < J; j++) most = fmaxf(most, fabsf(mix[j]));
    for (uint32_t j = 0; j < J; j++) out[j] = prt_f32_to_f16(mix[j] / most);
    return most;
}

int prt_write_low_rank_row(const struct factored *f, uint32_t r, float s, unsigned cpu,
                           struct prt_rows *rows, uint32_t row)
{
    const uint32_t J = rows->n_function, n_coef = rows->n_coef, width = f->width[r];
    const uint32_t first = rows->direction[row];
    uint64_t at = rows->begin[row];
    int8_t *entry = WRITABLE(int8_t, rows->entry) + rows->value_begin[row];
    float *room = prt_alloc(COMPONENT_ROOM * (size_t)n_coef, sizeof *room), unit2 = 0;
    if (!room) return PRT_NOMEM;
    struct decoded_row decoded = decode_row(f, r, n_coef, cpu, room);
    float *sum = decoded.sum, *x = decoded.x;
    sum_energies(&decoded, width);
    for (uint32_t d = 0; d < width; d++) {
        float *own = x + (size_t)d * n_coef;
        float most = decoded.loops->largest(own, sum, f->limit[r], n_coef);
        unit2 += most / 127 * (most / 127);
        for (uint32_t k = 0; k < n_coef; k++) own[k] *= 127 / most;
        WRITABLE(float, rows->scale)
        [first + d] =
            most / 127 * s *
            write_component(f, r, d, J,
                            WRITABLE(uint16_t, rows->mix) + (uint64_t)(first + d) * J);
    }
    float above = 127 * twice_above(unit2, f->limit[r]);
    for (uint32_t k = 0; k < n_coef; k++) {
        float value[MAX_COMPONENTS], share = 0;
        if (!(sum[k] > f->limit[r])) continue;
        for (uint32_t d = 0; d < width; d++) {
            value[d] = x[(size_t)d * n_coef + k];
            share = fmaxf(share, fabsf(value[d]));
        }
        for (int turn = 0; turn < 1 + (share > above) && at < rows->begin[row + 1];
             turn++, at++) {
            WRITABLE(uint8_t, rows->shift)[at] = put_bytes(value, width, entry);
            if (rows->index_bytes == 2) WRITABLE(uint16_t, rows->index)[at] = (uint16_t)k;
            else WRITABLE(uint32_t, rows->index)[at] = k;
            entry += width;
        }
    }
    for (uint32_t k = 0; k < 6 * J; k++) WRITABLE(uint16_t, rows->scaling)
    [(size_t)row * 6 * J + k] = prt_f32_to_f16(f->scaling[(size_t)r * 6 * J + k] * s);
    prt_free(room);
    return at == rows->begin[row + 1] ? PRT_OK : PRT_INTERNAL;
}
