// SPDX-License-Identifier: MIT
// Supports: vertices that are spread evenly over the model and whose rows are interpolated at
// the others. As a row source a cluster is the product of the weights with the supports' rows.
#include "bake/loops.h"
#include "bake/support.h"

#include <cblas.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { NEAREST = 6 };

static float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Distance of two vertices, in which normals that differ count as a way of `turn` mm: the sides
// of a thin sheet are far from each other.
static float apart2(const struct prt_mesh *mesh, uint32_t v, uint32_t w, float turn)
{
    float sum = turn * turn * fmaxf(0, 2 - 2 * dot3(mesh->normal[v], mesh->normal[w]));
    for (int k = 0; k < 3; k++) {
        const float d = mesh->position[v][k] - mesh->position[w][k];
        sum += d * d;
    }
    return sum;
}

// A fifth of a cluster's extent; chosen.
static float turn_of(const struct bake *b, const struct prt_cluster *cluster)
{
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    float sum = 0;
    for (uint32_t i = 0; i < cluster->n_vertex; i++) {
        const float *x = b->mesh->position[b->clusters->order[cluster->vertex_begin + i]];
        for (int k = 0; k < 3; k++)
            low[k] = fminf(low[k], x[k]), high[k] = fmaxf(high[k], x[k]);
    }
    for (int k = 0; k < 3; k++) sum += (high[k] - low[k]) * (high[k] - low[k]);
    return 0.2f * sqrtf(sum);
}

static bool scatters(const struct bake *b, uint32_t c)
{
    if (!b->clusters->translucent[c] || !b->clusters->cluster[c].n_vertex) return false;
    return b->o.engine != PRT_TRANSPORT_WAVELET ||
           !b->o.media.medium[prt_bake_medium(b, c)].profile;
}

// n vertices of a cluster, each the farthest from those before it.
static int spread(const struct bake *b, uint32_t c, uint32_t n, struct support *s)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    const uint32_t *order = b->clusters->order + cluster->vertex_begin;
    const float turn = turn_of(b, cluster);
    float *far = prt_alloc(cluster->n_vertex, sizeof *far);
    if (!far) return PRT_NOMEM;
    for (uint32_t i = 0; i < cluster->n_vertex; i++) far[i] = INFINITY;
    for (uint32_t k = 0, at = 0; k < n; k++) {
        s->vertex[s->n] = order[at];
        s->cluster[s->n++] = c;
        uint32_t next = 0;
        for (uint32_t i = 0; i < cluster->n_vertex; i++) {
            far[i] = fminf(far[i], apart2(b->mesh, order[i], order[at], turn));
            if (far[i] > far[next]) next = i;
        }
        at = next;
    }
    prt_free(far);
    return PRT_OK;
}

int prt_support_create(const struct bake *b, uint32_t most, uint32_t n_function, uint32_t light,
                       struct support **out)
{
    const struct clusters *all = b->clusters;
    double vertices = 0;
    uint32_t n_cluster = 0, room = 0;
    for (uint32_t c = 0; c < all->n_cluster; c++)
        if (scatters(b, c)) vertices += all->cluster[c].n_vertex, n_cluster++;
    const double share = fmin(most / fmax(vertices, 1), 1);
    for (uint32_t c = 0; c < all->n_cluster; c++)
        room += (uint32_t)(share * all->cluster[c].n_vertex) + 1;
    struct support *s = calloc(1, sizeof *s);
    if (!s) return PRT_NOMEM;
    *s = (struct support){
        .n_function = n_function, .light = light, .n_texel = 6 * light * light};
    s->vertex = prt_alloc(room, sizeof *s->vertex);
    s->cluster = prt_alloc(room, sizeof *s->cluster);
    int status = s->vertex && s->cluster ? PRT_OK : PRT_NOMEM;
    for (uint32_t c = 0; status == PRT_OK && c < all->n_cluster; c++) {
        const uint32_t n = (uint32_t)(share * all->cluster[c].n_vertex) + 1;
        if (!scatters(b, c)) continue;
        status = spread(b, c, n < all->cluster[c].n_vertex ? n : all->cluster[c].n_vertex, s);
    }
    s->row = prt_calloc(((size_t)s->n + 1) * n_function * s->n_texel, sizeof *s->row);
    s->scale = prt_calloc(s->n + 1u, sizeof *s->scale);
    if (!s->row || !s->scale) status = PRT_NOMEM;
    if (status) prt_support_destroy(s);
    else *out = s;
    return status;
}

void prt_support_destroy(struct support *s)
{
    if (!s) return;
    prt_free(s->vertex);
    prt_free(s->cluster);
    prt_free(s->row);
    prt_free(s->scale);
    free(s);
}

void prt_support_set(struct support *s, uint32_t i, const float *row)
{
    const size_t n = (size_t)s->n_function * s->n_texel;
    const float most = largest_of(row, n);
    s->scale[i] = most > 0 ? most / 1024 : 1; // far above a half's least number
    float *scaled = prt_alloc(n, sizeof *scaled);
    for (size_t k = 0; scaled && k < n; k++) scaled[k] = row[k] / s->scale[i];
    if (scaled) prt_f32_to_f16_array(scaled, n, s->row + i * n);
    prt_free(scaled);
}

// The supports of a cluster's vertices and their weights.
struct cluster_support {
    const struct support *s;
    uint32_t n_vertex, n_column, coarser; // texels of the bake along one of the supports
    uint32_t light;                       // of the bake
    uint32_t *support;                    // [n_column]
    float *weight;                        // [n_vertex][n_column]
};

static void cluster_support_finish(struct cluster_support *k)
{
    prt_free(k->support);
    prt_free(k->weight);
    *k = (struct cluster_support){0};
}

struct near {
    float d2;
    uint32_t support;
};

// The nearest supports of vertex v on its own object and, behind them, the next one.
static uint32_t find_near(const struct bake *b, const struct support *s, uint32_t c, uint32_t v,
                          float turn, struct near out[NEAREST + 1])
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < s->n; i++) {
        if (b->clusters->object[s->cluster[i]] != b->clusters->object[c]) continue;
        const float d2 = apart2(b->mesh, v, s->vertex[i], turn);
        if (n == NEAREST + 1 && d2 >= out[n - 1].d2) continue;
        uint32_t at = n < NEAREST + 1 ? n++ : NEAREST;
        for (; at && out[at - 1].d2 > d2; at--) out[at] = out[at - 1];
        out[at] = (struct near){d2, i};
    }
    return n;
}

// Shepard's weights, which vanish where the next support takes over. They sum to 1.
static uint32_t weigh(struct near *at, uint32_t n, float w[NEAREST])
{
    const uint32_t used = n > NEAREST ? NEAREST : n;
    const float reach = n > NEAREST ? sqrtf(at[NEAREST].d2) : 2 * sqrtf(at[n - 1].d2) + 1e-12f;
    float sum = 0;
    for (uint32_t i = 0; i < used; i++) {
        const float d = sqrtf(at[i].d2),
                    q = fmaxf(reach - d, 1e-6f * reach) / (d + 1e-3f * reach);
        sum += w[i] = q * q;
    }
    for (uint32_t i = 0; i < used; i++) w[i] /= sum;
    return used;
}

static int find_weights(const struct bake *b, const struct support *s, uint32_t c,
                        struct cluster_support *k)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    const float turn = turn_of(b, cluster);
    uint32_t *column = prt_alloc(s->n, sizeof *column);
    struct near(*near)[NEAREST + 1] = prt_alloc(cluster->n_vertex, sizeof *near);
    uint32_t *n = prt_alloc(cluster->n_vertex, sizeof *n);
    *k = (struct cluster_support){.s = s,
                                  .n_vertex = cluster->n_vertex,
                                  .coarser = b->o.cube / s->light,
                                  .light = b->o.cube,
                                  .support = prt_alloc(s->n, sizeof *k->support)};
    int status = column && near && n && k->support ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < s->n; i++) column[i] = UINT32_MAX;
    for (uint32_t v = 0; status == PRT_OK && v < cluster->n_vertex; v++) {
        n[v] = find_near(b, s, c, b->clusters->order[cluster->vertex_begin + v], turn, near[v]);
        for (uint32_t i = 0; i < n[v] && i < NEAREST; i++) {
            uint32_t *to = &column[near[v][i].support];
            if (*to == UINT32_MAX) {
                *to = k->n_column;
                k->support[k->n_column++] = near[v][i].support;
            }
        }
    }
    k->weight = prt_calloc((size_t)cluster->n_vertex * k->n_column + 1, sizeof *k->weight);
    if (!k->weight) status = PRT_NOMEM;
    for (uint32_t v = 0; status == PRT_OK && v < cluster->n_vertex && k->n_column; v++) {
        float w[NEAREST];
        const uint32_t used = weigh(near[v], n[v], w);
        for (uint32_t i = 0; i < used; i++)
            k->weight[(size_t)v * k->n_column + column[near[v][i].support]] = w[i];
    }
    prt_free(column);
    prt_free(near);
    prt_free(n);
    return status;
}

int prt_support_interpolate(const struct bake *b, const struct support *s, uint32_t c,
                            uint32_t n_value, const float *value, float *out)
{
    struct cluster_support k;
    int status = find_weights(b, s, c, &k);
    memset(out, 0, (size_t)k.n_vertex * n_value * sizeof *out);
    for (size_t i = 0; !status && i < (size_t)k.n_vertex * k.n_column; i++) {
        const float *from = value + (size_t)k.support[i % k.n_column] * n_value;
        if (k.weight[i] > 0)
            cblas_saxpy((int)n_value, k.weight[i], from, 1, out + i / k.n_column * n_value, 1);
    }
    cluster_support_finish(&k);
    return status;
}

// The texel of the supports' cube that holds texel t of the bake's.
static uint32_t coarse_texel(const struct cluster_support *k, uint32_t t)
{
    const uint32_t n = k->light, face = t / (n * n), y = t / n % n, x = t % n;
    const uint32_t wide = k->s->light;
    return (face * wide + y / k->coarser) * wide + x / k->coarser;
}

// Function f of a column's supports as floats [n_column][n_texel].
static void load_rows(const struct cluster_support *k, uint32_t f, float *out)
{
    const struct support *s = k->s;
    for (uint32_t i = 0; i < k->n_column; i++) {
        const uint32_t at = k->support[i];
        float *to = out + (size_t)i * s->n_texel;
        prt_f16_to_f32_array(s->row + ((size_t)at * s->n_function + f) * s->n_texel, s->n_texel,
                             to);
        for (uint32_t t = 0; t < s->n_texel; t++) to[t] *= s->scale[at];
    }
}

static int support_multiply(void *user, const float *x, uint32_t m, float *out)
{
    const struct cluster_support *k = user;
    const struct support *s = k->s;
    const uint32_t n_coef = 6 * k->light * k->light;
    float *lit = prt_calloc((size_t)s->n_texel * m, sizeof *lit);
    float *rows = prt_alloc((size_t)k->n_column * s->n_texel, sizeof *rows);
    float *answer = prt_alloc((size_t)k->n_column * m, sizeof *answer);
    int status = lit && rows && answer ? PRT_OK : PRT_NOMEM;
    for (uint32_t t = 0; status == PRT_OK && t < n_coef; t++)
        cblas_saxpy((int)m, 1, x + (size_t)t * m, 1, lit + (size_t)coarse_texel(k, t) * m, 1);
    for (uint32_t f = 0; status == PRT_OK && f < s->n_function; f++) {
        load_rows(k, f, rows);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)k->n_column, (int)m,
                    (int)s->n_texel, 1, rows, (int)s->n_texel, lit, (int)m, 0, answer, (int)m);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)k->n_vertex, (int)m,
                    (int)k->n_column, 1, k->weight, (int)k->n_column, answer, (int)m, 0,
                    out + (size_t)f * k->n_vertex * m, (int)m);
    }
    prt_free(lit);
    prt_free(rows);
    prt_free(answer);
    return status;
}

static int support_project(void *user, const float *u, uint32_t rank, float *out)
{
    const struct cluster_support *k = user;
    const struct support *s = k->s;
    const uint32_t n_coef = 6 * k->light * k->light, F = s->n_function;
    float *mixed = prt_alloc((size_t)rank * k->n_column + 1, sizeof *mixed);
    float *rows = prt_alloc((size_t)k->n_column * s->n_texel, sizeof *rows);
    float *coarse = prt_alloc((size_t)rank * s->n_texel + 1, sizeof *coarse);
    uint32_t *texel = prt_alloc(n_coef, sizeof *texel); // the coarse one of each
    int status = mixed && rows && coarse && texel ? PRT_OK : PRT_NOMEM;
    for (uint32_t t = 0; status == PRT_OK && t < n_coef; t++) texel[t] = coarse_texel(k, t);
    if (status == PRT_OK)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rank, (int)k->n_column,
                    (int)k->n_vertex, 1, u, (int)k->n_vertex, k->weight, (int)k->n_column, 0,
                    mixed, (int)k->n_column);
    for (uint32_t f = 0; status == PRT_OK && f < F; f++) {
        load_rows(k, f, rows);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rank, (int)s->n_texel,
                    (int)k->n_column, 1, mixed, (int)k->n_column, rows, (int)s->n_texel, 0,
                    coarse, (int)s->n_texel);
        for (uint32_t r = 0; r < rank; r++) {
            float *to = out + ((size_t)r * F + f) * n_coef;
            const float *from = coarse + (size_t)r * s->n_texel;
            for (uint32_t t = 0; t < n_coef; t++) to[t] = from[texel[t]];
        }
    }
    prt_free(mixed);
    prt_free(rows);
    prt_free(coarse);
    prt_free(texel);
    return status;
}

int prt_support_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    const struct bake *b = job->bake;
    int status = PRT_OK;
    for (size_t c = begin; c < end && status == PRT_OK; c++) {
        struct cluster_support k;
        if (!scatters(b, (uint32_t)c)) continue;
        status = find_weights(b, job->user, (uint32_t)c, &k);
        struct row_source source = {&k, k.n_vertex, support_multiply, support_project, NULL};
        if (status == PRT_OK) status = prt_bake_take_rows(job, (uint32_t)c, &source);
        cluster_support_finish(&k);
    }
    return status;
}
