// SPDX-License-Identifier: MIT
// The sum of several tensors' colours in one pass. The material is folded into a cluster's
// contracted rows just before these are multiplied with the cluster's U, and tensors with the
// same clusters are summed piece by piece, while a piece's colours are in the cache.
#include "answer.h"
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

struct sum_run {
    const struct prt_kernels *kernels;
    const struct prt_term_input
        *part[PRT_MOST_PARTS]; // with the same clusters; the one with the most planes first
    unsigned n_part, n_light, n_plane;
    const struct expand_piece *pieces;
    size_t scratch;      // floats of the largest cluster's folded rows
    float *const *color; // [light][plane]
    bool add;            // to the colours of earlier passes
};

static bool is_radial(const struct prt_term_input *p)
{
    return p->tensor->storage == PRT_STORAGE_RADIAL;
}

static unsigned planes_of(const struct prt_term_input *p, unsigned n_plane)
{
    return p->tensor->n_phase < n_plane ? p->tensor->n_phase : n_plane;
}

const float *prt_fold_cluster(const struct prt_kernels *kernels, const struct prt_term_input *p,
                              uint32_t cluster, uint32_t rank, unsigned n_light,
                              unsigned n_plane, float *to)
{
    const struct prt_tensor *t = p->tensor;
    const struct prt_cluster *c = &t->cluster[cluster];
    const size_t medium = p->medium ? p->medium[cluster] : 0;
    const float(*factor)[3] = p->factor ? p->factor + medium * t->n_phase : NULL;
    const bool full = t->coupling == PRT_COUPLE_FULL;
    const unsigned planes = planes_of(p, n_plane);
    const float *in = p->lit + (size_t)c->row_begin * n_light * t->n_function * (full ? 3 : 1);
    if (full)
        kernels->material(in, (size_t)rank * t->n_phase, t->n_radial,
                          p->coef + medium * 3 * t->n_radial, to);
    else if (!factor && planes == t->n_phase) return in;
    if (full) in = to;
    // `to` may be `in`: no value moves to a higher address
    const size_t n = (size_t)rank * n_light;
    for (size_t i = 0; i < n; i++)
        for (unsigned k = 0; k < planes; k++)
            for (int ch = 0; ch < 3; ch++)
                to[3 * (i * planes + k) + (size_t)ch] =
                    in[3 * (i * t->n_phase + k) + (size_t)ch] * (factor ? factor[k][ch] : 1);
    return to;
}

// Plane by plane, because the coefficients contain each plane's factor.
static void sum_radial(const struct sum_run *run, const struct prt_term_input *p,
                       uint32_t cluster, struct expand_job *job, float *coef)
{
    const struct prt_tensor *t = p->tensor;
    const size_t medium = p->medium ? p->medium[cluster] : 0;
    const float *own = p->coef + medium * 3 * t->n_radial;
    const float(*factor)[3] = p->factor ? p->factor + medium * t->n_phase : NULL;
    const size_t n = 3 * (size_t)t->n_radial;
    const uint16_t *u = job->u;
    const uint32_t planes = planes_of(p, run->n_plane);
    job->rank = job->rank ? t->n_radial : 0;
    job->b = coef;
    job->b_stride = 3;
    job->n_triple = 1;
    for (uint32_t k = 0; k < planes; k++) {
        radial_coef(t, cluster, k, own, factor ? factor[k] : NULL, coef);
        job->u = u + k * n * job->stride;
        job->color = run->color + k;
        run->kernels->radial(job);
    }
}

static void sum_piece(const struct sum_run *run, const struct expand_piece *piece,
                      const struct prt_term_input *p, bool add, float *scratch)
{
    const struct prt_tensor *t = p->tensor;
    const struct prt_cluster *c = &t->cluster[piece->cluster];
    const bool dark = p->dark && p->dark[piece->cluster];
    const uint32_t rank = p->most_rank && c->rank > p->most_rank ? p->most_rank : c->rank;
    const unsigned planes = planes_of(p, run->n_plane);
    float *color[MOST_TRIPLES];
    struct expand_job job = {.u = t->u + c->u_begin,
                             .stride = ((size_t)c->n_vertex + 15) & ~(size_t)15,
                             .rank = dark ? 0 : rank,
                             .b = scratch,
                             .b_stride = 3 * (size_t)planes * run->n_light,
                             .n_triple = planes * run->n_light,
                             .begin = piece->begin,
                             .end = piece->end,
                             .order = t->order + c->vertex_begin,
                             .color = color,
                             .add = add};
    if (!job.rank && add) return;
    if (is_radial(p)) {
        sum_radial(run, p, piece->cluster, &job, scratch);
        return;
    }
    for (unsigned i = 0; i < job.n_triple; i++)
        color[i] = run->color[i / planes * run->n_plane + i % planes];
    if (job.rank)
        job.b = prt_fold_cluster(run->kernels, p, piece->cluster, rank, run->n_light,
                                 run->n_plane, scratch);
    run->kernels->expand(&job);
}

static int sum_pieces(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct sum_run *run = arg;
    float *scratch = prt_alloc(run->scratch, sizeof *scratch);
    if (!scratch) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++)
        for (unsigned k = 0; k < run->n_part; k++)
            sum_piece(run, &run->pieces[i], run->part[k], run->add || k > 0, scratch);
    prt_free(scratch);
    return PRT_OK;
}

static bool same_clusters(const struct prt_tensor *a, const struct prt_tensor *b)
{
    if (a == b) return true;
    if (a->n_cluster != b->n_cluster || a->n_vertex != b->n_vertex) return false;
    for (uint32_t i = 0; i < a->n_cluster; i++)
        if (a->cluster[i].vertex_begin != b->cluster[i].vertex_begin ||
            a->cluster[i].n_vertex != b->cluster[i].n_vertex)
            return false;
    return !memcmp(a->order, b->order, 4ull * a->n_vertex);
}

static void add_input(struct sum_run *run, const struct prt_term_input *p)
{
    const struct prt_tensor *t = p->tensor;
    size_t most = 0, at = run->n_part++;
    for (uint32_t i = 0; i < t->n_cluster; i++)
        if (t->cluster[i].rank > most) most = t->cluster[i].rank;
    most = is_radial(p) ? 3 * (size_t)t->n_radial : most * 3 * t->n_phase * run->n_light;
    if (most >= run->scratch) run->scratch = most + 1;
    for (; at && run->part[at - 1]->tensor->n_phase < t->n_phase; at--)
        run->part[at] = run->part[at - 1];
    run->part[at] = p;
}

static int sum_run(const struct prt_context *ctx, struct sum_run *run)
{
    const struct prt_tensor *t = run->part[0]->tensor;
    struct expand_piece *pieces = NULL;
    size_t n = 0, grain = 1;
    int status = prt_expand_pieces(ctx, t, &pieces, &n, &grain);
    if (status) return status;
    run->kernels = prt_kernels_for(ctx->cpu);
    run->pieces = pieces;
    unsigned first = planes_of(run->part[0], run->n_plane);
    for (unsigned i = 0; i < run->n_light * run->n_plane && !run->add; i++)
        if (i % run->n_plane >= first) memset(run->color[i], 0, 12ull * t->n_vertex);
    status = prt_parallel_for(ctx, NULL, n, grain, sum_pieces, run);
    free(pieces);
    return status ? prt_fail(ctx, status, "no memory to apply a material") : PRT_OK;
}

static int check(const struct prt_context *ctx, unsigned n_part,
                 const struct prt_term_input part[])
{
    if (!n_part || n_part > PRT_MOST_PARTS)
        return prt_fail(ctx, PRT_ARG, "%u tensors in one sum; 1 to %d are possible", n_part,
                        PRT_MOST_PARTS);
    for (unsigned i = 0; i < n_part; i++) {
        const struct prt_tensor *t = part[i].tensor;
        const bool moves = t->coupling == PRT_COUPLE_FULL || is_radial(&part[i]);
        if (t->storage == PRT_STORAGE_SPARSE || t->n_vertex != part[0].tensor->n_vertex ||
            moves != !!part[i].coef || (!is_radial(&part[i]) && !part[i].lit))
            return prt_fail(ctx, PRT_ARG,
                            "input %u of a sum does not have what its tensor needs", i);
    }
    return PRT_OK;
}

int prt_sum_parts_lights(const struct prt_context *ctx, unsigned n_light, unsigned n_part,
                         const struct prt_term_input part[], unsigned n_plane,
                         float *const color[])
{
    bool done[PRT_MOST_PARTS] = {false};
    int status = check(ctx, n_part, part);
    for (unsigned i = 0; i < n_part && !status; i++) {
        struct sum_run run = {
            .n_light = n_light, .n_plane = n_plane, .color = color, .add = i > 0};
        if (done[i]) continue;
        for (unsigned k = i; k < n_part; k++) {
            if (done[k] || !same_clusters(part[i].tensor, part[k].tensor)) continue;
            done[k] = true;
            add_input(&run, &part[k]);
        }
        status = sum_run(ctx, &run);
    }
    return status;
}

int prt_sum_parts(const struct prt_context *ctx, unsigned n_part,
                  const struct prt_term_input part[], unsigned n_plane, float *color)
{
    float *plane[MOST_PHASES];
    if (n_plane < 1 || n_plane > MOST_PHASES)
        return prt_fail(ctx, PRT_ARG, "%u planes in one sum; 1 to %d are possible", n_plane,
                        MOST_PHASES);
    for (unsigned k = 0; k < n_plane && n_part; k++)
        plane[k] = color + 3 * (size_t)k * part[0].tensor->n_vertex;
    return prt_sum_parts_lights(ctx, 1, n_part, part, n_plane, plane);
}
