// SPDX-License-Identifier: MIT
// A cluster's walks at every level of a free medium: one set of walks a level answers for all
// absorptions, e^(-sigma_a L). Levels share random numbers. Above the last walked level the
// dipole answers, times the ratio of both there.
#include "bake/free_walks.h"
#include "bake/sources.h"

#include <cblas.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

// Walks of a level over those of the mean: as many as an equal share of cost and noise allows.
// A walk costs about as much as other_cost scatterings beside its own.
static const double other_cost = 4, mean_level = 0.7, fewest = 0.25, most = 1.5;

struct level_fill {
    const struct free_walks_job *job;
    struct free_walks *w;
    const uint32_t *column;
    uint32_t object, capacity, n_hit, chunk, n_chunk; // chunk: first hit of the vertex and half
    bool failed;
    float *row; // [capacity of a chunk][n_light] gathered rows
    uint32_t row_capacity;
    uint32_t *place; // of the chunk's hits
    float *weight;   // [n_node][n_chunk]
    struct walk_answers answers;
};

static bool grow(struct level_fill *f)
{
    if (f->n_hit == f->capacity) {
        const uint32_t more = 2 * f->capacity + 4096;
        struct walk_hit *hits = realloc(f->w->hits, more * sizeof *hits);
        if (!hits) return false;
        f->w->hits = hits;
        f->capacity = more;
    }
    return true;
}

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct level_fill *f = arg;
    const struct walk_bake *walk = f->job->b->walk;
    if (exit->scatterings < 2 || f->failed) return;
    const uint32_t sample = prt_surface_stratum(walk->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX || f->n_chunk == f->row_capacity) return;
    const uint32_t place = walk->place[sample];
    if (f->column[place] == UINT32_MAX) return;
    if (!grow(f)) {
        f->failed = true;
        return;
    }
    f->w->hits[f->n_hit++] = (struct walk_hit){f->column[place], exit->length_mm};
    f->place[f->n_chunk++] = place;
}

// Adds the chunk's hits to the answers of a vertex in a half: every node's weights times rows.
static void add_answers(struct level_fill *f, uint32_t v, unsigned half)
{
    const struct walk_pool *pool = f->job->pool;
    const struct lit_rows *lit = f->job->lit;
    const uint32_t m = lit->n_light, n = f->w->n_vertex, h = f->n_chunk, J = pool->grid.n_node;
    const struct walk_hit *hit = f->w->hits + f->chunk;
    for (uint32_t i = 0; i < h; i++)
        memcpy(f->row + (size_t)i * m, lit->value + (size_t)f->place[i] * m,
               m * sizeof *f->row);
    for (uint32_t j = 0; j < J; j++)
        for (uint32_t i = 0; i < h; i++)
            f->weight[(size_t)j * h + i] = expf(-pool->grid.node[j] * hit[i].length_mm);
    if (h)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)J, (int)m, (int)h, 1,
                    f->weight, (int)h, f->row, (int)m, 0, f->answers.half[half] + (size_t)v * m,
                    (int)(n * m));
}

// All walks of a level: hits, and the answers of its nodes in two halves.
static int fill_level(struct level_fill *f, uint32_t level)
{
    const struct free_walks_job *job = f->job;
    const struct bake *b = job->b;
    const struct prt_material *m = &b->o.media.medium[prt_bake_medium(b, job->cluster)];
    const struct prt_walk_medium medium = {job->pool->grid.level[level], m->eta, 0};
    const uint32_t n = f->w->n_vertex, half_walks = f->w->walks[level] / 2;
    const uint32_t m_light = job->lit->n_light, J = job->pool->grid.n_node;
    struct prt_walk_counts counts = {0};
    for (unsigned h = 0; h < 2; h++)
        memset(f->answers.half[h], 0, (size_t)J * n * m_light * sizeof(float));
    if (!job->keep_hits) f->n_hit = 0;
    for (uint32_t v = 0; v < n && !f->failed; v++) {
        const uint32_t vertex =
            b->clusters->order[b->clusters->cluster[job->cluster].vertex_begin + v];
        f->w->begin[(size_t)level * n + v] = f->n_hit;
        for (unsigned h = 0; h < 2; h++) {
            const uint64_t key[2] = {vertex, h};
            struct prt_walk_start start;
            prt_walk_start_at(b->walk->space, vertex, f->object,
                              prt_hash64(key, sizeof key, b->o.seed + 0x3a1c), &start);
            f->chunk = f->n_hit, f->n_chunk = 0;
            prt_walk_run(b->walk->space, &start, &medium, half_walks, take_exit, f, &counts);
            add_answers(f, v, h);
            if (!job->keep_hits) f->n_hit = 0;
        }
    }
    f->w->begin[(size_t)(level + 1) * n] = f->n_hit;
    const float each = 1 / ((float)M_PI * (float)half_walks);
    for (unsigned h = 0; h < 2; h++)
        for (size_t i = 0; i < (size_t)J * n * m_light; i++) f->answers.half[h][i] *= each;
    for (size_t i = 0; i < (size_t)J * n; i++) f->answers.n_walk[i] = 2 * half_walks;
    prt_work_count(job->work, WORK_WALKS, counts.rays, 0);
    return f->failed ? PRT_NOMEM : PRT_OK;
}

// The dipole's answers [n][n_vertex][n_light] of media that are combinations [n][n_radial] of
// the basis' answers.
static void dipole_answers(const struct free_walks *w, const float *combination, uint32_t n,
                           const float *radial, float *out)
{
    const int block = (int)(w->n_vertex * w->n_light), F = (int)w->pool->n_radial;
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, block, F, 1, combination, F,
                radial, block, 0, out, block);
}

// Smooths a level's answers into w->answer; the matrices take the factors of creases.
static int smooth_level(struct level_fill *f, uint32_t level, const float *like,
                        const float *radial, float *dipole)
{
    struct free_walks *w = f->w;
    const struct walk_pool *pool = w->pool;
    const size_t n = w->n_vertex, m = w->n_light, J = pool->grid.n_node;
    const uint32_t own = prt_bake_medium(f->job->b, f->job->cluster);
    float *made = NULL, *factor = prt_alloc(n, sizeof *factor);
    double noise[2] = {0, 0};
    if (!factor) return PRT_NOMEM;
    dipole_answers(w, pool->dipole + ((size_t)own * pool->n_media + level * J) * pool->n_radial,
                   (uint32_t)J, radial, dipole);
    int status = prt_walks_smooth(f->job->b, like, dipole, &f->answers, &made, factor, noise);
    for (size_t j = 0; j < J && !status; j++) {
        float *matrix = w->smooth + (level * J + j) * n * n,
              *sum = f->answers.half[0] + j * n * m;
        const float *more = f->answers.half[1] + j * n * m;
        for (size_t i = 0; i < n * n; i++) matrix[i] = made[j * n * n + i] * factor[i / n];
        for (size_t i = 0; i < n * m; i++) sum[i] = 0.5f * (sum[i] + more[i]);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)n, 1,
                    matrix, (int)n, sum, (int)m, 0, w->answer + (level * J + j) * n * m,
                    (int)m);
    }
    w->noise[0] += noise[0], w->noise[1] += noise[1];
    prt_free(made);
    prt_free(factor);
    return status;
}

// Media above the last walked level. dipole: [n_node][n_vertex][n_light] scratch.
static void fill_above(struct level_fill *f, const float *radial, float *dipole)
{
    struct free_walks *w = f->w;
    const struct walk_pool *pool = w->pool;
    const size_t n = w->n_vertex, m = w->n_light, J = pool->grid.n_node;
    const uint32_t n_above = pool->n_media - pool->n_walked;
    const uint32_t own = prt_bake_medium(f->job->b, f->job->cluster);
    const float *last = w->answer + pool->last_level * J * n * m;
    for (uint32_t i = 0; i < n_above; i++) {
        const size_t medium = pool->n_walked + i;
        float *answer = w->answer + medium * n * m;
        dipole_answers(w, pool->ratio_basis + ((size_t)own * n_above + i) * pool->n_radial, 1,
                       radial, dipole);
        dipole_answers(w, pool->dipole + (own * pool->n_media + medium) * pool->n_radial, 1,
                       radial, answer);
        for (size_t v = 0; v < n; v++) {
            double product = 0, square = 0;
            for (size_t l = 0; l < m; l++) {
                const double d = (double)dipole[v * m + l];
                double walk = 0;
                for (size_t j = 0; j < J; j++)
                    walk +=
                        (double)pool->ratio_mix[i * J + j] * (double)last[(j * n + v) * m + l];
                product += walk * d;
                square += d * d;
            }
            const float ratio = square > 0 ? (float)fmax(product / square, 0) : 1;
            w->ratio[(size_t)i * n + v] = ratio;
            for (size_t l = 0; l < m; l++) answer[v * m + l] *= ratio;
        }
    }
}

static uint32_t walks_of_level(const struct free_walks_job *job, uint32_t level, double mean_mm)
{
    const double own = other_cost + (double)job->pool->grid.level[level] * mean_mm;
    const double share = sqrt((other_cost + mean_level * mean_mm) / own);
    const double n = job->n_walk * fmin(fmax(share, fewest), most);
    return n < 4 ? 4 : 2 * (uint32_t)(n / 2);
}

static int allocate(struct level_fill *f, const struct free_walks_job *job,
                    struct free_walks *w)
{
    const struct walk_pool *pool = job->pool;
    const size_t n = w->n_vertex, m = w->n_light, J = pool->grid.n_node;
    const uint32_t levels = pool->last_level + 1,
                   most_chunk = (uint32_t)(job->n_walk * most) + 4;
    w->answer = prt_alloc(pool->n_media * n * m, sizeof *w->answer);
    w->smooth = prt_alloc(pool->n_walked * n * n, sizeof *w->smooth);
    w->ratio = prt_alloc((pool->n_media - pool->n_walked) * n + 1, sizeof *w->ratio);
    w->walks = prt_alloc(levels, sizeof *w->walks);
    w->begin = prt_alloc(levels * n + 1, sizeof *w->begin);
    f->row = prt_alloc(most_chunk * m, sizeof *f->row);
    f->place = prt_alloc(most_chunk, sizeof *f->place);
    f->weight = prt_alloc(most_chunk * J, sizeof *f->weight);
    f->row_capacity = most_chunk;
    f->answers =
        (struct walk_answers){w->n_vertex, w->n_light, (uint32_t)J, {NULL, NULL}, NULL};
    f->answers.half[0] = prt_alloc(J * n * m, sizeof(float));
    f->answers.half[1] = prt_alloc(J * n * m, sizeof(float));
    f->answers.n_walk = prt_alloc(J * n, sizeof *f->answers.n_walk);
    return w->answer && w->smooth && w->ratio && w->walks && w->begin && f->row && f->place &&
                   f->weight && f->answers.half[0] && f->answers.half[1] && f->answers.n_walk
               ? PRT_OK
               : PRT_NOMEM;
}

// The basis' answers to the lights, [n_radial][n_vertex][n_light].
static float *radial_answers(const struct free_walks_job *job, const struct free_walks *w)
{
    const struct walk_pool *pool = job->pool;
    struct half_rows none = {.n_layer = 1};
    struct product_rows rows = {&none,    job->cut,  w->n_vertex, pool->n_radial,
                                job->lit, job->work, NULL};
    float *out = prt_alloc((size_t)pool->n_radial * w->n_vertex * w->n_light, sizeof *out);
    if (out && !prt_product_multiply(&rows, job->lit->light, w->n_light, out)) return out;
    prt_free(out);
    return NULL;
}

int prt_free_walks_run(const struct free_walks_job *job, struct free_walks *out)
{
    const struct bake *b = job->b;
    const struct walk_pool *pool = job->pool;
    struct level_fill f = {.job = job, .w = out, .object = b->clusters->object[job->cluster]};
    *out = (struct free_walks){.pool = pool,
                               .n_vertex = b->clusters->cluster[job->cluster].n_vertex,
                               .n_light = job->lit->n_light};
    const double mean_mm =
        prt_walk_mean_length(b->walk->space, f.object,
                             (double)b->o.media.medium[prt_bake_medium(b, job->cluster)].eta);
    uint32_t *column = prt_walk_columns(b, job->cut);
    float *radial = radial_answers(job, out), *like = prt_walk_likeness(b, job->cluster);
    float *dipole =
        prt_alloc((size_t)pool->grid.n_node * out->n_vertex * out->n_light, sizeof *dipole);
    f.column = column;
    int status = column && radial && like && dipole ? allocate(&f, job, out) : PRT_NOMEM;
    for (uint32_t k = 0; k <= pool->last_level && !status; k++) {
        uint64_t started = prt_work_begin();
        out->walks[k] = walks_of_level(job, k, mean_mm);
        status = fill_level(&f, k);
        prt_work_end(job->work, WORK_WALKS, started, 0, 0);
        started = prt_work_begin();
        if (!status) status = smooth_level(&f, k, like, radial, dipole);
        prt_work_end(job->work, WORK_SMOOTH, started, 0, 0);
    }
    if (!status) fill_above(&f, radial, dipole);
    prt_walk_answers_finish(&f.answers);
    prt_free(f.row);
    prt_free(f.place);
    prt_free(f.weight);
    prt_free(column);
    prt_free(radial);
    prt_free(like);
    prt_free(dipole);
    if (status) prt_free_walks_finish(out);
    return status;
}

void prt_free_walks_finish(struct free_walks *w)
{
    prt_free(w->answer);
    prt_free(w->smooth);
    prt_free(w->ratio);
    prt_free(w->walks);
    prt_free(w->begin);
    free(w->hits);
    *w = (struct free_walks){0};
}

void prt_free_walks_mix(const struct free_walks *w, float *out)
{
    const int block = (int)(w->n_vertex * w->n_light), n = (int)w->pool->n_media;
    const struct walk_pool *pool = w->pool;
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)pool->n_own[0], block, n, 1,
                pool->mix, n, w->answer, block, 0, out, block);
    memset(out + (size_t)pool->n_own[0] * block, 0, sizeof *out * pool->n_own[1] * block);
}
