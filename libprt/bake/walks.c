// SPDX-License-Identifier: MIT
// Walks of a cluster's vertices fill the matrix that R_d fills otherwise (METHODS §9).
#include "bake/walks.h"
#include "bake/sources.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Walks a vertex and channel where --walks does not say: as many over the model as 512 at
// 35,000 vertices, because vertices that lie close are smoothed together.
static const double default_walks = 18e6;
static const uint32_t least_walks = 512, most_walks = 2048;
static const uint32_t level_walks = 256; // the same of each level, where the medium is free
// Walks that escape through holes, of all: more than the first are reported, with more than
// the second the dipole takes the object.
static const double reported_leak = 0.01, refused_leak = 0.1;
static const float least_sigma_s = 1e-5f;

static void drop_exit(void *arg, const struct prt_walk_exit *exit)
{
}

// The share of walks that escape from an object, by walks from some of its samples.
static double leak_of(const struct bake *b, uint32_t object)
{
    enum { STARTS = 256, WALKS = 16 };
    const struct prt_surface_points *s = b->surface;
    const struct prt_material *m = prt_media_of(&b->o.media, object);
    const uint32_t begin = s->object_begin[object], n = s->object_begin[object + 1] - begin;
    struct prt_walk_counts counts = {0};
    float densest = fmaxf(fmaxf(m->sigma_s_prime[0], m->sigma_s_prime[1]), m->sigma_s_prime[2]);
    struct prt_walk_medium medium = {fmaxf(densest, least_sigma_s), m->eta, 0};
    for (uint32_t i = 0; i < STARTS && n; i++) {
        uint32_t sample = begin + (uint32_t)((uint64_t)i * n / STARTS);
        struct prt_walk_start start = {.object = object, .seed = b->o.seed + i};
        memcpy(start.position, s->position[sample], sizeof start.position);
        memcpy(start.normal, s->face_normal[sample], sizeof start.normal);
        prt_walk_run(b->walk->space, &start, &medium, WALKS, drop_exit, NULL, &counts);
    }
    return counts.walks ? (double)(counts.leaked + counts.cut) / (double)counts.walks : 0;
}

static int test_objects(struct bake *b)
{
    struct walk_bake *w = b->walk;
    bool any = false;
    for (uint32_t o = 0; o < b->mesh->n_object; o++) {
        if (!(prt_walk_area(w->space, o) > 0)) continue;
        const bool closed = prt_walk_volume(w->space, o) > 0;
        const double leak = closed ? leak_of(b, o) : 1;
        char words[PRT_OBJECT_WORDS];
        any |= closed;
        w->walked[o] = leak <= refused_leak;
        if (leak > refused_leak)
            prt_log(b->ctx, PRT_LOG_WARNING,
                    "%s: %.3g %% of the walks escape through holes (at most 10 %% may): "
                    "it is baked with the dipole; close its surface",
                    prt_mesh_object_words(b->mesh, o, words), 100 * leak);
        else if (leak > reported_leak)
            prt_log(b->ctx, PRT_LOG_WARNING,
                    "%s: %.3g %% of the walks escape through holes, and it is too "
                    "dark by as much; close its surface",
                    prt_mesh_object_words(b->mesh, o, words), 100 * leak);
        if (w->walked[o]) w->leaked = fmax(w->leaked, leak);
    }
    if (any) {
        for (uint32_t o = 0; o < b->mesh->n_object; o++)
            if (w->walked[o]) return PRT_OK;
        prt_walks_destroy(w); // the dipole bakes all
        b->walk = NULL;
        return PRT_OK;
    }
    return prt_fail(
        b->ctx, PRT_ARG,
        "--scattering walk: no object encloses a volume: the triangles must bound a "
        "closed body and face outwards");
}

uint32_t prt_walks_each(const struct prt_bake_options *o, uint32_t n_vertex)
{
    const double n = default_walks / fmax(n_vertex, 1);
    if (o->n_walk) return o->n_walk;
    if (o->engine != PRT_TRANSPORT_WAVELET) return level_walks;
    return n < least_walks ? least_walks : n > most_walks ? most_walks : (uint32_t)n;
}

int prt_walks_create(struct bake *b)
{
    struct walk_bake *w = b->walk = calloc(1, sizeof *b->walk);
    if (!w) return PRT_NOMEM;
    for (uint32_t i = 0; i < b->o.media.n; i++)
        if (b->o.media.medium[i].profile)
            return prt_fail(b->ctx, PRT_ARG,
                            "--scattering walk: a material with a profile of its own has no "
                            "walks: give sigma_s' and sigma_a, or bake with the dipole");
    int status = prt_walk_space_create(b->ctx, b->scene, &w->space);
    if (!status) status = prt_surface_strata_create(b->ctx, b->mesh, b->surface, &w->strata);
    if (status) return status;
    w->place = prt_alloc(b->surface->n_sample + 1u, sizeof *w->place);
    w->walked = prt_calloc(b->mesh->n_object + 1u, sizeof *w->walked);
    w->noise = prt_calloc(b->clusters->n_cluster + 1u, sizeof *w->noise);
    if (!w->place || !w->walked || !w->noise) return PRT_NOMEM;
    for (uint32_t i = 0; i < b->surface->n_sample; i++) w->place[b->hierarchy->order[i]] = i;
    w->n_walk = prt_walks_each(&b->o, b->mesh->n_vertex);
    return test_objects(b);
}

void prt_walks_destroy(struct walk_bake *w)
{
    if (!w) return;
    prt_walk_space_destroy(w->space);
    prt_surface_strata_destroy(w->strata);
    prt_free(w->place);
    prt_free(w->walked);
    prt_free(w->noise);
    free(w);
}

bool prt_walks_in(const struct bake *b, uint32_t c)
{
    return b->walk && b->clusters->translucent[c] && b->walk->walked[b->clusters->object[c]];
}

double prt_walks_noise(const struct bake *b)
{
    double noise = 0, all = 0;
    for (uint32_t c = 0; b->walk && c < b->clusters->n_cluster; c++)
        noise += b->walk->noise[c][0], all += b->walk->noise[c][1];
    return all > 0 ? sqrt(noise / all) : 0;
}

// ---- one cluster

uint32_t *prt_walk_columns(const struct bake *b, const struct cut *cut)
{
    const uint32_t n_sample = b->surface->n_sample;
    uint32_t *column = prt_alloc(n_sample + 1u, sizeof *column);
    if (!column) return NULL;
    memset(column, 0xff, n_sample * sizeof *column);
    for (uint32_t i = 0; i < cut->n_column; i++) {
        const uint32_t row = cut->row[i];
        if (row < n_sample) {
            column[row] = i;
            continue;
        }
        const struct node *node = &b->hierarchy->node[row - n_sample];
        for (uint32_t s = 0; s < node->count; s++) column[node->begin + s] = i;
    }
    return column;
}

struct fill {
    const struct tensor_job *job;
    const struct prt_cluster *cluster;
    const struct prt_material *material;
    uint32_t object, vertex, n_vertex;
    const uint32_t *column;
    double sigma_a;  // of the channel at hand
    float *k, *half; // of the vertex, channel and half at hand
};

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct fill *f = arg;
    const struct walk_bake *w = f->job->bake->walk;
    const struct lit_rows *lit = f->job->lit;
    if (exit->scatterings < 2) return;
    uint32_t sample = prt_surface_stratum(w->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX) return;
    const uint32_t place = w->place[sample];
    const float light = (float)exp(-f->sigma_a * (double)exit->length_mm);
    if (f->column[place] != UINT32_MAX) f->k[(size_t)f->column[place] * f->n_vertex] += light;
    const float *row = lit->value + (size_t)place * lit->n_light;
    for (uint32_t i = 0; i < lit->n_light; i++) f->half[i] += light * row[i];
}

// n walks of vertex v in a channel and half. round: another one has other random numbers.
static void walk_from(struct fill *f, struct cut *cut, struct walk_answers *a, uint32_t v,
                      unsigned ch, unsigned half, unsigned round, uint32_t n)
{
    const struct bake *b = f->job->bake;
    const uint32_t vertex = b->clusters->order[f->cluster->vertex_begin + v];
    const uint64_t key[2] = {vertex, 4 * ch + 2 * half + round};
    const struct prt_walk_medium medium = {fmaxf(f->material->sigma_s_prime[ch], least_sigma_s),
                                           f->material->eta, 0};
    struct prt_walk_start start;
    struct prt_walk_counts counts = {0};
    prt_walk_start_at(b->walk->space, vertex, f->object,
                      prt_hash64(key, sizeof key, b->o.seed + 0x3a1c), &start);
    f->sigma_a = (double)f->material->sigma_a[ch];
    f->k = cut->k + (size_t)ch * f->n_vertex * cut->n_column + v;
    f->half = a->half[half] + ((size_t)ch * f->n_vertex + v) * a->n_light;
    prt_walk_run(b->walk->space, &start, &medium, n, take_exit, f, &counts);
    a->n_walk[(size_t)ch * f->n_vertex + v] += n;
    prt_work_count(f->job->work, WORK_WALKS, counts.rays, 0);
}

// The deviation of each sum of walks, [3][n_vertex]: half of it is the cluster's mean, because
// two halves say little about one vertex.
static void deviations(const struct walk_answers *a, double *out)
{
    for (unsigned ch = 0; ch < 3; ch++) {
        double mean = 0;
        for (uint32_t v = 0; v < a->n_vertex; v++) {
            const size_t at = (size_t)ch * a->n_vertex + v;
            double sum = 0;
            for (uint32_t i = 0; i < a->n_light; i++) {
                double d = (double)a->half[0][at * a->n_light + i] -
                           (double)a->half[1][at * a->n_light + i];
                sum += d * d;
            }
            out[at] = sqrt(sum);
            mean += out[at] / a->n_vertex;
        }
        for (uint32_t v = 0; v < a->n_vertex; v++) {
            double *d = &out[(size_t)ch * a->n_vertex + v];
            *d = 0.5 * (*d + mean);
        }
    }
}

// Walks in the proportion of the deviations, so that the sum of squared errors is least for
// their number (Neyman); the first round's are taken off.
static void second_round(struct fill *f, struct cut *cut, struct walk_answers *a,
                         const double *deviation, uint32_t n_walk)
{
    const size_t n = 3 * (size_t)a->n_vertex;
    double mean = 0;
    for (size_t i = 0; i < n; i++) mean += deviation[i] / (double)n;
    for (size_t i = 0; i < n && mean > 0; i++) {
        const double want = fmin(n_walk * deviation[i] / mean, 4.0 * n_walk);
        const uint32_t half = (uint32_t)(want / 2), done = a->n_walk[i] / 2;
        for (unsigned h = 0; h < 2 && half > done; h++)
            walk_from(f, cut, a, (uint32_t)(i % a->n_vertex), (unsigned)(i / a->n_vertex), h, 1,
                      half - done);
    }
}

// Sums become means.
static void divide(struct cut *cut, struct walk_answers *a)
{
    for (unsigned ch = 0; ch < 3; ch++)
        for (uint32_t v = 0; v < a->n_vertex; v++) {
            const size_t at = (size_t)ch * a->n_vertex + v;
            const float each = (float)(1 / (M_PI * a->n_walk[at]));
            float *k = cut->k + (size_t)ch * a->n_vertex * cut->n_column + v;
            for (uint32_t c = 0; c < cut->n_column; c++) k[(size_t)c * a->n_vertex] *= each;
            for (uint32_t i = 0; i < a->n_light; i++) {
                a->half[0][at * a->n_light + i] *= 2 * each;
                a->half[1][at * a->n_light + i] *= 2 * each;
            }
        }
}

int prt_walks_fill(const struct tensor_job *job, uint32_t c, struct cut *cut,
                   struct walk_answers *out)
{
    const struct bake *b = job->bake;
    const uint32_t n = b->clusters->cluster[c].n_vertex, m = job->lit->n_light;
    const uint32_t n_walk = b->walk->n_walk, first = n_walk / 4 ? n_walk / 4 : 1;
    const uint64_t started = prt_work_begin();
    struct fill f = {.job = job,
                     .cluster = &b->clusters->cluster[c],
                     .material = &b->o.media.medium[prt_bake_medium(b, c)],
                     .object = b->clusters->object[c],
                     .n_vertex = n};
    uint32_t *column = prt_walk_columns(b, cut);
    double *deviation = prt_alloc(3 * (size_t)n, sizeof *deviation);
    *out = (struct walk_answers){n, m, 3, {NULL, NULL}, NULL};
    out->half[0] = prt_calloc((size_t)3 * n * m, sizeof(float));
    out->half[1] = prt_calloc((size_t)3 * n * m, sizeof(float));
    out->n_walk = prt_calloc((size_t)3 * n, sizeof *out->n_walk);
    f.column = column;
    int status =
        column && deviation && out->half[0] && out->half[1] && out->n_walk ? PRT_OK : PRT_NOMEM;
    if (!status) {
        memset(cut->k, 0, (size_t)3 * n * cut->n_column * sizeof *cut->k);
        for (uint32_t v = 0; v < n; v++)
            for (unsigned i = 0; i < 6; i++) walk_from(&f, cut, out, v, i / 2, i % 2, 0, first);
        deviations(out, deviation);
        second_round(&f, cut, out, deviation, n_walk);
        divide(cut, out);
    }
    prt_free(column);
    prt_free(deviation);
    prt_work_end(job->work, WORK_WALKS, started, 0, 0);
    return status;
}

void prt_walk_answers_finish(struct walk_answers *a)
{
    prt_free(a->half[0]);
    prt_free(a->half[1]);
    prt_free(a->n_walk);
}
