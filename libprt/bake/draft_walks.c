// SPDX-License-Identifier: MIT
// A draft is by the dipole. Where a bake by walks replaces it, its kernel is scaled so that
// under even irradiance each vertex returns what walks return (METHODS §3.8).
#include "bake/draft_walks.h"
#include "bake/support.h"
#include "prt/walk.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Walks start at so many vertices, so many a channel in all; what they return is the mean over
// the starts within a reach [spacings of the starts]. Chosen: the mean's noise is some 2 %.
enum { STARTS = 2500, WALKS = 48 * STARTS, LEAST_EACH = 16, MOST_EACH = 2048 };
static const float reach_spacings = 2.5f;
static const double most_leak = 0.1; // of an object's walks; above it keeps the dipole
static const float least_sigma_s = 1e-5f;

struct draft_walks {
    struct support *support;
    float (*exitance)[3]; // [support->n] by walks of two scatterings or more, smoothed
    uint8_t *walked;      // [n_object]
};

struct start_job {
    const struct bake *b;
    const struct prt_walk_space *space;
    const struct support *support;
    uint32_t n_walk; // a start and channel
    float (*exitance)[3];
    struct prt_walk_counts *counts; // [support->n]
};

struct sum {
    double sigma_a, light;
};

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct sum *s = arg;
    if (exit->scatterings >= 2) s->light += exp(-s->sigma_a * (double)exit->length_mm);
}

static int walk_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct start_job *job = arg;
    const struct bake *b = job->b;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++) {
        const uint32_t c = job->support->cluster[i], vertex = job->support->vertex[i];
        const struct prt_material *m = &b->o.media.medium[prt_bake_medium(b, c)];
        const uint32_t object = b->clusters->object[c];
        for (int ch = 0; ch < 3 && prt_walk_volume(job->space, object) > 0; ch++) {
            const uint64_t key[2] = {vertex, (uint64_t)ch};
            const struct prt_walk_medium medium = {fmaxf(m->sigma_s_prime[ch], least_sigma_s),
                                                   m->eta, 0};
            struct prt_walk_start start;
            struct sum sum = {(double)m->sigma_a[ch], 0};
            prt_walk_start_at(job->space, vertex, object,
                              prt_hash64(key, sizeof key, b->o.seed + 0xd4af), &start);
            prt_walk_run(job->space, &start, &medium, job->n_walk, take_exit, &sum,
                         &job->counts[i]);
            job->exitance[i][ch] = (float)(sum.light / job->n_walk);
        }
    }
    return PRT_OK;
}

// Objects that enclose a volume and whose walks stay inside.
static void find_walked(const struct start_job *job, uint8_t *walked)
{
    const struct bake *b = job->b;
    for (uint32_t o = 0; o < b->mesh->n_object; o++) {
        uint64_t walks = 0, lost = 0;
        for (uint32_t i = 0; i < job->support->n; i++) {
            if (b->clusters->object[job->support->cluster[i]] != o) continue;
            walks += job->counts[i].walks;
            lost += job->counts[i].leaked + job->counts[i].cut;
        }
        walked[o] = walks && (double)lost <= most_leak * (double)walks;
    }
}

// The weight of start j in the mean at start i: (1 - d^2/R^2)^2 ((1 + n.n')/2)^8.
static float weight_of(const struct prt_mesh *mesh, uint32_t i, uint32_t j, float reach2)
{
    float d2 = 0, cosine = 0;
    for (int k = 0; k < 3; k++) {
        const float d = mesh->position[i][k] - mesh->position[j][k];
        d2 += d * d;
        cosine += mesh->normal[i][k] * mesh->normal[j][k];
    }
    if (!(d2 < reach2)) return 0;
    const float near = 1 - d2 / reach2, alike = powf(fmaxf(0.5f + 0.5f * cosine, 0), 8);
    return near * near * alike;
}

static int smooth(const struct bake *b, struct draft_walks *w)
{
    const struct support *s = w->support;
    const double spacing = sqrt(prt_surface_area(b->mesh) / fmax(s->n, 1));
    const float reach = reach_spacings * (float)spacing;
    float(*mean)[3] = prt_alloc(s->n + 1u, sizeof *mean);
    if (!mean) return PRT_NOMEM;
    for (uint32_t i = 0; i < s->n; i++) {
        const uint32_t object = b->clusters->object[s->cluster[i]];
        double all = 0, sum[3] = {0};
        for (uint32_t j = 0; j < s->n; j++) {
            if (b->clusters->object[s->cluster[j]] != object) continue;
            const float x = weight_of(b->mesh, s->vertex[i], s->vertex[j], reach * reach);
            all += (double)x;
            for (int k = 0; x > 0 && k < 3; k++) sum[k] += (double)(x * w->exitance[j][k]);
        }
        for (int k = 0; k < 3; k++) mean[i][k] = (float)(sum[k] / all);
    }
    memcpy(w->exitance, mean, s->n * sizeof *mean);
    prt_free(mean);
    return PRT_OK;
}

int prt_draft_walks_create(struct bake *b)
{
    struct draft_walks *w = b->draft_walks = calloc(1, sizeof *w);
    struct prt_walk_space *space = NULL;
    struct prt_walk_counts *counts = NULL;
    if (!w) return PRT_NOMEM;
    const uint64_t started = prt_work_begin_all();
    int status = prt_walk_space_create(b->ctx, b->scene, &space);
    if (!status) status = prt_support_create(b, STARTS, 1, 1, &w->support);
    if (!status) {
        w->exitance = prt_calloc(w->support->n + 1u, sizeof *w->exitance);
        w->walked = prt_calloc(b->mesh->n_object + 1u, sizeof *w->walked);
        counts = prt_calloc(w->support->n + 1u, sizeof *counts);
        if (!w->exitance || !w->walked || !counts) status = PRT_NOMEM;
    }
    struct start_job job = {b, space, w->support, 0, w->exitance, counts};
    if (!status) {
        const uint32_t each = WALKS / (w->support->n + 1);
        // a start for each cluster at least: models of many small objects have more of them
        job.n_walk = each < LEAST_EACH ? LEAST_EACH : each < MOST_EACH ? each : MOST_EACH;
        status = prt_parallel_for(b->ctx, "walks", w->support->n, 16, walk_range, &job);
    }
    if (!status) find_walked(&job, w->walked);
    if (!status) status = smooth(b, w);
    prt_work_end_all(&b->work, WORK_WALKS, started);
    prt_free(counts);
    prt_walk_space_destroy(space);
    return status;
}

void prt_draft_walks_destroy(struct draft_walks *w)
{
    if (!w) return;
    prt_support_destroy(w->support);
    prt_free(w->exitance);
    prt_free(w->walked);
    free(w);
}

const uint8_t *prt_draft_walks_objects(const struct draft_walks *w)
{
    return w ? w->walked : NULL;
}

int prt_draft_walks_scale(const struct bake *b, uint32_t c, struct cut *cut)
{
    const struct draft_walks *w = b->draft_walks;
    const size_t n = b->clusters->cluster[c].n_vertex, m = cut->n_column;
    if (!w || !w->walked[b->clusters->object[c]]) return PRT_OK;
    float(*walk)[3] = prt_alloc(n + 1, sizeof *walk);
    double *dipole = prt_alloc(n + 1, sizeof *dipole);
    float *ratio = prt_alloc(n + 1, sizeof *ratio);
    int status = walk && dipole && ratio ? PRT_OK : PRT_NOMEM;
    if (!status) status = prt_support_interpolate(b, w->support, c, 3, w->exitance[0], walk[0]);
    for (size_t ch = 0; ch < 3 && !status; ch++) {
        float *k = cut->k + ch * n * m;
        memset(dipole, 0, n * sizeof *dipole);
        for (size_t i = 0; i < m; i++)
            for (size_t v = 0; v < n; v++) dipole[v] += M_PI * k[i * n + v];
        for (size_t v = 0; v < n; v++)
            ratio[v] = dipole[v] > 0 ? (float)(walk[v][ch] / dipole[v]) : 1;
        for (size_t i = 0; i < m; i++)
            for (size_t v = 0; v < n; v++) k[i * n + v] *= ratio[v];
    }
    prt_free(walk);
    prt_free(dipole);
    prt_free(ratio);
    return status;
}
