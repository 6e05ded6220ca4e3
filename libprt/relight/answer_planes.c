// SPDX-License-Identifier: MIT
// Sums the tensors of a transport into the planes of answers: those of several queries in one
// pass where they differ only in their lights, those whose single scattering is corrected for
// the view, and those whose terms are kept apart.
#include "answer_parts.h"
#include "kernels.h"

#include <stdlib.h>
#include <string.h>

static const float Y00 = 0.28209479177387814f; // 1/sqrt(4 pi)

// The exit's divisor for a total, else 1.
static float single_gain(const struct answer *a, const struct prt_material *m)
{
    return a->query->term == PRT_ANSWER_TOTAL
               ? (float)prt_exit_divisor((double)m->eta, a->query->exit)
               : 1;
}

// The factor of a single-scattering tensor's plane. A tensor whose material is fixed already
// contains it; a material with a measured R_d has no single scattering of its own.
static void plane_factor(const struct answer *a, const struct prt_material *m,
                         const struct prt_tensor *t, unsigned k, float factor[3])
{
    for (int ch = 0; ch < 3; ch++) factor[ch] = 1;
    if (prt_tensor_is_free(t)) prt_phase_plane_factor(m, t, k, factor);
    for (int ch = 0; ch < 3 && m->profile; ch++) factor[ch] = 0;
    for (int ch = 0; ch < 3; ch++) factor[ch] *= single_gain(a, m);
}

struct plane_job {
    const struct answer *a;
    const float *in;
    float *out;
    float factor[3], constant;
};

static int add_plane(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct plane_job *job = arg;
    for (size_t v = begin; v < end; v++)
        for (int ch = 0; ch < 3; ch++)
            job->out[3 * v + ch] += job->in[3 * v + ch] * job->factor[ch] * job->constant;
    return PRT_OK;
}

// Adds plane k of single scattering at translucent vertices only: it is 0 at opaque ones,
// whatever the file contains.
static int add_translucent(const struct answer *a, const struct prt_tensor *t, unsigned k,
                           const struct plane_job *whole)
{
    const struct prt_mesh *mesh = &a->transport->mesh;
    int status = PRT_OK;
    for (uint32_t i = 0; i < mesh->n_block && !status; i++) {
        const struct prt_block *b = &mesh->block[i];
        struct plane_job job = *whole;
        if (!mesh->surface[b->surface].translucent) continue;
        plane_factor(a, prt_media_of(a->media, b->object), t, k, job.factor);
        job.in += 3 * (size_t)b->vertex_begin;
        job.out += 3 * (size_t)b->vertex_begin;
        status = prt_parallel_for(a->ctx, NULL, b->n_vertex, VERTEX_GRAIN, add_plane, &job);
    }
    return status;
}

// Adds the planes of one tensor. Plane 0 of single scattering does not depend on the view after
// it is multiplied by Y_00; it is added to the plane of multiple scattering.
static int add_tensor(const struct answer *a, const struct prt_tensor *t, const float *own)
{
    size_t size = 3 * a->n_vertex;
    bool single = prt_term_is_single(t->term);
    int status = PRT_OK;
    for (unsigned k = 0; k < t->n_phase && k < a->n_plane && !status; k++) {
        struct plane_job job = {.a = a,
                                .in = own + k * size,
                                .out = a->planes + k * size,
                                .factor = {1, 1, 1},
                                .constant = single && !k ? Y00 : 1};
        status =
            single ? add_translucent(a, t, k, &job)
                   : prt_parallel_for(a->ctx, NULL, a->n_vertex, VERTEX_GRAIN, add_plane, &job);
    }
    return status;
}

// ---- tensors of one query that are summed in one pass

// The input of one tensor and the arrays that it owns.
struct owned_input {
    struct prt_term_input part;
    float *lit, *coef, (*factor)[3];
    uint8_t *dark, *medium;
};

static void owned_input_finish(struct owned_input *o)
{
    prt_free(o->lit);
    prt_free(o->coef);
    prt_free(o->factor);
    prt_free(o->dark);
    prt_free(o->medium);
}

// *out marks the opaque clusters, for which single scattering is 0; NULL when there is none.
// *mixed: some cluster has both kinds of vertices, which no bake makes.
static int find_opaque_clusters(const struct answer *a, const struct prt_tensor *t,
                                uint8_t **out, bool *mixed)
{
    const struct prt_mesh *mesh = &a->transport->mesh;
    bool any = false;
    *out = NULL;
    *mixed = false;
    for (uint32_t i = 0; i < mesh->n_block; i++)
        any |= !mesh->surface[mesh->block[i].surface].translucent;
    if (!any) return PRT_OK;
    uint8_t *opaque = prt_calloc(a->n_vertex, 1), *dark = prt_calloc(t->n_cluster + 1ull, 1);
    for (uint32_t i = 0; opaque && i < mesh->n_block; i++)
        if (!mesh->surface[mesh->block[i].surface].translucent)
            memset(opaque + mesh->block[i].vertex_begin, 1, mesh->block[i].n_vertex);
    for (uint32_t c = 0; opaque && dark && c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        uint32_t n = 0;
        for (uint32_t v = 0; v < k->n_vertex; v++) n += opaque[t->order[k->vertex_begin + v]];
        dark[c] = n > 0;
        *mixed |= n > 0 && n < k->n_vertex;
    }
    prt_free(opaque);
    if (opaque && dark) *out = dark;
    else prt_free(dark);
    return *out ? PRT_OK : PRT_NOMEM;
}

static int find_coef(const struct answer *a, const struct prt_tensor *t, float **out)
{
    *out = prt_alloc(3 * (size_t)t->n_radial * a->media->n + 1, sizeof **out);
    if (!*out) return PRT_NOMEM;
    return prt_basis_coef(a->ctx, a->transport, t, a->media, *out);
}

// Queries that differ only in their lights and are answered in one pass.
struct group {
    struct answer *answer[PRT_RELIGHT_MAX_LIGHTS];
    unsigned n;
};

// Rows of a cluster that colours are made of: even, since kernels take columns of U in pairs.
static uint32_t color_rank(const struct answer *a)
{
    const uint32_t most = a->query->most_rank;
    return most + most % 2;
}

static int contract_group(const struct group *g, const struct prt_tensor *t, float **own,
                          const float **out)
{
    const struct answer *a = g->answer[0];
    const struct prt_light *light[PRT_RELIGHT_MAX_LIGHTS];
    if (a->query->lit) {
        *out = prt_contracted_light_rows(a->query->lit, t);
        return PRT_OK;
    }
    const uint32_t most = a->coefficients ? a->coefficients->most_rank : color_rank(a);
    for (unsigned i = 0; i < g->n; i++) light[i] = &g->answer[i]->light;
    *out = *own = prt_alloc(g->n * prt_contracted_light_floats(t), sizeof **own);
    return *own ? prt_contract_lights(a->ctx, t, g->n, light, most, *own) : PRT_NOMEM;
}

// The factor of every plane of each medium; add_tensor says why plane 0 has Y_00.
static int find_factors(const struct answer *a, const struct prt_tensor *t, float (**out)[3])
{
    *out = prt_alloc((size_t)t->n_phase * a->media->n, sizeof **out);
    for (unsigned i = 0; *out && i < t->n_phase * a->media->n; i++) {
        const unsigned k = i % t->n_phase;
        plane_factor(a, &a->media->medium[i / t->n_phase], t, k, (*out)[i]);
        for (int ch = 0; ch < 3 && !k; ch++) (*out)[i][ch] *= Y00;
    }
    return *out ? PRT_OK : PRT_NOMEM;
}

// Makes the input of tensor t for prt_sum_parts_lights; *fits is false where it cannot take
// part.
static int make_input(const struct group *g, const struct prt_tensor *t, struct owned_input *o,
                      bool *fits)
{
    const struct answer *a = g->answer[0];
    bool mixed = false;
    int status = PRT_OK;
    *o = (struct owned_input){.part.tensor = t};
    *fits = false;
    if (t->storage == PRT_STORAGE_SPARSE) return PRT_OK;
    if (prt_term_is_single(t->term)) {
        status = find_opaque_clusters(a, t, &o->dark, &mixed);
        if (!status && !mixed) status = find_factors(a, t, &o->factor);
    }
    *fits = !status && !mixed;
    if (*fits) status = prt_cluster_media(a->transport, t, a->media, &o->medium);
    if (*fits && !status && prt_tensor_is_free(t)) status = find_coef(a, t, &o->coef);
    if (*fits && !status && t->storage == PRT_STORAGE_FACTORED)
        status = contract_group(g, t, &o->lit, &o->part.lit);
    o->part.coef = o->coef;
    o->part.factor = (const float(*)[3])o->factor;
    o->part.dark = o->dark;
    o->part.medium = o->medium;
    o->part.most_rank = a->coefficients || a->query->lit ? 0 : color_rank(a);
    return status == PRT_NOMEM ? prt_fail(a->ctx, status, "no memory to apply a material")
                               : status;
}

static int sum_parts(const struct group *g, unsigned n, const struct prt_term_input part[])
{
    const struct answer *a = g->answer[0];
    float *color[MOST_TRIPLES];
    for (unsigned i = 0; i < g->n; i++)
        for (unsigned k = 0; k < a->n_plane; k++) {
            float **to = &color[i * a->n_plane + k];
            *to = g->answer[i]->planes + 3 * k * a->n_vertex;
            if (!n) memset(*to, 0, 3 * a->n_vertex * sizeof **to);
        }
    return n ? prt_sum_parts_lights(a->ctx, g->n, n, part, a->n_plane, color) : PRT_OK;
}

// Rounds the contracted rows of the parts to halves in place of expanding them.
static int round_parts(const struct group *g, unsigned n, const struct prt_term_input part[])
{
    const struct prt_transport *t = g->answer[0]->transport;
    struct prt_coefficients *out[PRT_RELIGHT_MAX_LIGHTS];
    int status = PRT_OK;
    for (unsigned i = 0; i < g->n; i++) out[i] = g->answer[i]->coefficients;
    for (unsigned layer = 0; layer < out[0]->n_layer && !status; layer++) {
        unsigned i = 0;
        while (i < n && part[i].tensor != &t->tensor[out[0]->layer[layer].tensor]) i++;
        if (i == n)
            return prt_fail(g->answer[0]->ctx, PRT_MISMATCH,
                            "a cluster has translucent and opaque vertices, which coefficients "
                            "cannot describe: take colours");
        status = prt_coefficients_fill(g->answer[0]->ctx, &part[i], layer, g->n, out);
    }
    return status;
}

// Overwrites the planes with the sum of those tensors that one pass can sum.
static int fill_parts(const struct group *g)
{
    const struct answer *a = g->answer[0];
    const struct prt_transport *t = a->transport;
    struct owned_input owned[PRT_MOST_PARTS];
    struct prt_term_input part[PRT_MOST_PARTS];
    unsigned n = 0, done = 0;
    int status = PRT_OK;
    for (uint32_t i = 0; i < t->n_tensor && n < PRT_MOST_PARTS && !status; i++) {
        bool fits;
        if (!prt_answer_wants(a, &t->tensor[i])) continue;
        status = make_input(g, &t->tensor[i], &owned[n], &fits);
        part[n] = owned[n].part;
        if (fits || status) n++;
        else owned_input_finish(&owned[n]);
        if (fits) done |= 1u << i;
    }
    if (!status) status = (a->coefficients ? round_parts : sum_parts)(g, n, part);
    for (unsigned i = 0; i < n; i++) owned_input_finish(&owned[i]);
    for (unsigned i = 0; i < g->n; i++) g->answer[i]->done = done;
    return status;
}

// Adds a tensor whose material is free and that fill_parts had to leave out.
static int add_free(const struct answer *a, const struct prt_tensor *t)
{
    float *own = prt_calloc(3 * a->n_vertex * t->n_phase, sizeof *own), *coef = NULL;
    const struct prt_light *light = &a->light;
    if (a->media->n > 1) {
        prt_free(own);
        return prt_fail(a->ctx, PRT_MISMATCH,
                        "the file has clusters of opaque and translucent vertices together: it "
                        "takes one medium for all objects");
    }
    int status = own ? find_coef(a, t, &coef) : PRT_NOMEM;
    if (status == PRT_NOMEM) prt_fail(a->ctx, status, "no memory for %u planes", t->n_phase);
    if (!status && a->query->lit)
        status = prt_contracted_light_relight(a->ctx, a->query->lit, t, coef, false, own);
    else if (!status) status = prt_relight(a->ctx, t, 1, &light, coef, false, own);
    if (!status) status = add_tensor(a, t, own);
    prt_free(coef);
    prt_free(own);
    return status;
}

// ---- several queries, one pass over the transport

enum { MANY_BYTES = 256 << 20 }; // limit of the planes kept between the two steps

// Adds one tensor of fixed material to n answers, in passes of as many lights as MANY_BYTES
// allow.
static int add_fixed(struct answer *const answer[], unsigned n, const struct prt_tensor *t)
{
    size_t each = 3 * answer[0]->n_vertex * t->n_phase;
    size_t fit = MANY_BYTES / (each * sizeof(float));
    unsigned most = fit < 1 ? 1 : fit < n ? (unsigned)fit : n;
    float *own = prt_alloc(most * each, sizeof *own);
    if (!own) return prt_fail(answer[0]->ctx, PRT_NOMEM, "no memory for %u lights", most);
    int status = PRT_OK;
    for (unsigned i = 0; i < n && !status; i += most) {
        const struct prt_light *light[PRT_RELIGHT_MAX_LIGHTS];
        unsigned m = n - i < most ? n - i : most;
        for (unsigned k = 0; k < m; k++) light[k] = &answer[i + k]->light;
        status = prt_relight(answer[0]->ctx, t, m, light, NULL, false, own);
        for (unsigned k = 0; k < m && !status; k++)
            status = add_tensor(answer[i + k], t, own + k * each);
    }
    prt_free(own);
    return status;
}

static int transform_lights(void *arg, size_t begin_i, size_t end, unsigned worker)
{
    struct answer *a = arg;
    for (size_t i = begin_i; i < end; i++)
        if (a[i].query->light && !a[i].query->lit &&
            prt_light_from_cube(a[i].query->light, &a[i].light))
            return prt_fail(a[i].ctx, PRT_NOMEM,
                            "no memory for the wavelet transform of a light");
    return PRT_OK;
}

// Whether the query supplies a light and nothing else.
static bool only_light(const struct answer *a)
{
    bool any_free = false;
    for (uint32_t i = 0; i < a->transport->n_tensor; i++)
        any_free |= prt_tensor_is_free(&a->transport->tensor[i]);
    return !any_free && !a->query->lit;
}

static bool same_layers(const struct prt_coefficients *a, const struct prt_coefficients *b)
{
    if (!a || !b) return a == b;
    return a->most_rank == b->most_rank && a->packed == b->packed && a->n_layer == b->n_layer &&
           a->n_half == b->n_half;
}

// Whether two lights take less time in one pass than in two.
static bool two_share(const struct answer *a)
{
    const struct prt_transport *t = a->transport;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (prt_answer_wants(a, &t->tensor[i]) && t->tensor[i].rows.value != PRT_VALUE_PAIR)
            return false;
    return prt_kernels_for(a->ctx->cpu)->quads;
}

// Groups the first of n answers with those that differ from it only in their lights.
static void group_answers(struct answer *a, unsigned n, const bool filled[], struct group *g)
{
    *g = (struct group){{a}, 1};
    for (unsigned i = 1; i < n && only_light(a); i++)
        if (!filled[i] && only_light(&a[i]) && a[i].query->term == a->query->term &&
            a[i].query->exit == a->query->exit &&
            a[i].query->most_rank == a->query->most_rank && a[i].n_plane == a->n_plane &&
            same_layers(a[i].coefficients, a->coefficients))
            g->answer[g->n++] = &a[i];
    if (g->n == 2 && !two_share(a)) g->n = 1;
}

int prt_answers_fill_as_one(struct answer *a, unsigned n)
{
    const struct prt_transport *t = a[0].transport;
    bool filled[PRT_RELIGHT_MAX_LIGHTS] = {false};
    int status = prt_parallel_for(a[0].ctx, NULL, n, 1, transform_lights, a);
    for (unsigned i = 0; i < n && !status; i++) {
        struct group group;
        if (filled[i]) continue;
        group_answers(a + i, n - i, filled + i, &group);
        status = fill_parts(&group);
        for (unsigned k = 0; k < group.n; k++) filled[group.answer[k] - a] = true;
    }
    for (uint32_t k = 0; k < t->n_tensor && !status; k++) {
        struct answer *left[PRT_RELIGHT_MAX_LIGHTS];
        unsigned m = 0;
        for (unsigned i = 0; i < n && !status; i++) {
            if (!prt_answer_wants(&a[i], &t->tensor[k]) || a[i].done >> k & 1) continue;
            if (prt_tensor_is_free(&t->tensor[k]) || a[i].query->lit)
                status = add_free(&a[i], &t->tensor[k]);
            else left[m++] = &a[i];
        }
        if (m && !status) status = add_fixed(left, m, &t->tensor[k]);
    }
    for (unsigned i = 0; i < n; i++)
        if (a[i].light.coef) prt_light_finish(&a[i].light);
    return status;
}

static int add_scratch(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct plane_job *job = arg;
    for (size_t i = 3 * begin; i < 3 * end; i++) job->out[i] += job->in[i];
    return PRT_OK;
}

// Planes of what is added behind the correction: that of the other terms, those of the exit.
static unsigned rest_planes(const struct answer *a)
{
    const struct prt_transport *t = a->transport;
    unsigned n = a->query->term == PRT_ANSWER_TOTAL;
    for (uint32_t i = 0; i < t->n_tensor && a->exits; i++)
        if (t->tensor[i].term == PRT_TERM_VIEW && t->tensor[i].n_phase > n)
            n = t->tensor[i].n_phase;
    return n;
}

// Each run of blocks with one eta.
static int correct_view(const struct answer *a)
{
    const struct prt_mesh *mesh = &a->transport->mesh;
    int status = PRT_OK;
    for (uint32_t i = 0, next; i < mesh->n_block && !status; i = next) {
        const struct prt_block *b = &mesh->block[i], *last = b;
        const float eta = prt_media_of(a->media, b->object)->eta;
        for (next = i + 1; next < mesh->n_block; next++) {
            if (prt_media_of(a->media, mesh->block[next].object)->eta != eta) break;
            last = &mesh->block[next];
        }
        status = prt_view_correct(
            a->ctx, mesh->n_vertex, b->vertex_begin, last->vertex_begin + last->n_vertex,
            (const float(*)[3])mesh->normal, (double)eta, a->n_phase, a->n_plane, a->planes);
    }
    return status;
}

// Answers whose single scattering is corrected for the view: it is computed alone, corrected,
// and the rest is added.
static int fill_corrected(struct answer *a, unsigned n)
{
    struct answer part[PRT_RELIGHT_MAX_LIGHTS];
    const size_t size = 3 * a[0].n_vertex;
    size_t all = 0, at = 0;
    unsigned m = 0;
    for (unsigned i = 0; i < n; i++) {
        part[i] = a[i];
        part[i].part = ONLY_SINGLE;
        part[i].n_plane = a[i].n_phase;
        all += rest_planes(&a[i]);
    }
    int status = prt_answers_fill_as_one(part, n);
    for (unsigned i = 0; i < n && !status; i++) {
        const unsigned made = a[i].n_phase < 4 ? 4 : a[i].n_phase;
        if (a[i].n_plane > made)
            memset(a[i].planes + made * size, 0,
                   (a[i].n_plane - made) * size * sizeof *a[i].planes);
        status = correct_view(&a[i]);
    }
    if (status || !all) return status;
    float *scratch = prt_alloc(all * size, sizeof *scratch);
    if (!scratch) return prt_fail(a[0].ctx, PRT_NOMEM, "no memory for %zu planes", all);
    for (unsigned i = 0; i < n; i++) {
        if (!rest_planes(&a[i])) continue;
        part[m] = a[i];
        part[m].part = ALL_BUT_SINGLE;
        part[m].n_plane = rest_planes(&a[i]);
        part[m].planes = scratch + at * size;
        at += part[m++].n_plane;
    }
    status = prt_answers_fill_as_one(part, m);
    at = 0;
    for (unsigned i = 0; i < n; i++)
        for (unsigned k = 0; k < rest_planes(&a[i]) && !status; k++) {
            struct plane_job job = {.in = scratch + at++ * size, .out = a[i].planes + k * size};
            status = prt_parallel_for(a[i].ctx, NULL, a[i].n_vertex, VERTEX_GRAIN, add_scratch,
                                      &job);
        }
    prt_free(scratch);
    return status;
}

// One step of answers whose terms are kept apart: n_plane planes from `first` on.
struct apart_step {
    int part;
    unsigned first, n_plane;
};

static struct apart_step apart_step(const struct answer *a, unsigned step)
{
    const unsigned rest = a->n_plane - 1 - a->n_exit;
    return step == 0   ? (struct apart_step){ALL_BUT_SINGLE, 0, 1}
           : step == 1 ? (struct apart_step){ONLY_SINGLE, 1, rest}
                       : (struct apart_step){ONLY_EXIT, 1 + rest, a->n_exit};
}

// Answers whose terms are kept apart.
static int fill_apart(struct answer *a, unsigned n)
{
    int status = PRT_OK;
    for (unsigned step = 0; step < 3 && !status; step++) {
        struct answer part[PRT_RELIGHT_MAX_LIGHTS];
        unsigned m = 0;
        for (unsigned i = 0; i < n; i++) {
            const struct apart_step now = apart_step(&a[i], step);
            if (!now.n_plane) continue;
            part[m] = a[i];
            part[m].part = now.part;
            part[m].exits = now.part == ONLY_EXIT;
            part[m].n_plane = now.n_plane;
            part[m++].planes = a[i].planes + 3 * now.first * a[i].n_vertex;
        }
        if (m) status = prt_answers_fill_as_one(part, m);
    }
    return status;
}

int prt_answers_fill(struct answer *a, unsigned n)
{
    struct answer plain[PRT_RELIGHT_MAX_LIGHTS], view[PRT_RELIGHT_MAX_LIGHTS],
        apart[PRT_RELIGHT_MAX_LIGHTS];
    unsigned n_plain = 0, n_view = 0, n_apart = 0;
    for (unsigned i = 0; i < n; i++)
        if (a[i].apart) apart[n_apart++] = a[i];
        else if (a[i].view) view[n_view++] = a[i];
        else plain[n_plain++] = a[i];
    int status = n_plain ? prt_answers_fill_as_one(plain, n_plain) : PRT_OK;
    if (!status && n_apart) status = fill_apart(apart, n_apart);
    return status || !n_view ? status : fill_corrected(view, n_view);
}
