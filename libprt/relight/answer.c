// SPDX-License-Identifier: MIT
// Answers a query from a transport: per-vertex colours, or the planes they are made of.
// colour = F_t(eta, w_o) [ T_d.L/T + sum_k Y_k(w_o') T_k.L ]  (W05 section 5; METHODS §1, exit)
//
// w_o' is the direction inside whose refraction is the view. Planes of a wavelet transport
// contain the phase function's coefficients a_l and sigma_s; those of a joint transport do not,
// because both depend on the material: they are multiplied in here. Above 600 lines: every step
// reads and fills the one struct answer, which stays private to this file.
#include "answer.h"
#include "kernels.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const float Y00 = 0.28209479177387814f; // 1/sqrt(4 pi)

enum {
    VERTEX_GRAIN = 4096,
    SINK_GRAIN = 512, // vertices of a sink's block: 6 kB of colours
};

struct answer {
    const struct prt_context *ctx;
    const struct prt_transport *transport;
    const struct prt_query *query;
    const struct prt_media *media;
    struct prt_light light; // coef NULL for polynomial
    size_t n_vertex;
    unsigned n_plane;
    unsigned n_phase; // planes that the tensors fill; the view's correction may need more
    bool view;        // single scattering is corrected for the view (view_correction.c)
    bool exits;       // and gets the planes of exit that the transport has
    bool apart;       // planes of multiple scattering, of single scattering, of exit
    unsigned n_exit;  // of the planes that are apart
    enum {
        ALL_TERMS,
        ONLY_SINGLE,
        ALL_BUT_SINGLE,
        ONLY_EXIT
    } part;        // of one step of a corrected answer, or of one whose terms are apart
    float *planes; // [n_plane][n_vertex][3]
    unsigned done; // bit i: tensor i has been added to the planes
    struct prt_coefficients *coefficients; // in place of planes; NULL: planes
};

static bool is_free(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
}

static bool is_term(const struct prt_query *query, const struct prt_tensor *t)
{
    static const uint32_t of[] = {[PRT_ANSWER_MULTIPLE] = PRT_TERM_MULTIPLE,
                                  [PRT_ANSWER_SINGLE] = PRT_TERM_SINGLE,
                                  [PRT_ANSWER_UNSCATTERED] = PRT_TERM_UNSCATTERED};
    if (t->term == PRT_TERM_VIEW)
        return query->term == PRT_ANSWER_TOTAL || query->term == PRT_ANSWER_SINGLE;
    return query->term == PRT_ANSWER_TOTAL || t->term == of[query->term];
}

static bool is_wanted(const struct answer *a, const struct prt_tensor *t)
{
    bool single = t->term == PRT_TERM_SINGLE;
    if (t->term == PRT_TERM_VIEW)
        return a->exits && a->part != ONLY_SINGLE && is_term(a->query, t);
    return is_term(a->query, t) && a->part != ONLY_EXIT &&
           (a->part == ALL_TERMS || (a->part == ONLY_SINGLE) == single);
}

// Whether an object has a translucent surface, which its medium is behind.
static bool has_inside(const struct prt_mesh *mesh, uint32_t object)
{
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (mesh->block[i].object == object &&
            mesh->surface[mesh->block[i].surface].translucent)
            return true;
    return false;
}

static int check_eta(const struct prt_context *ctx, const struct prt_material *m,
                     const float range[2])
{
    if (m->eta >= range[0] - 1e-4f && m->eta <= range[1] + 1e-4f) return PRT_OK;
    return prt_fail(ctx, PRT_MISMATCH,
                    "%s: eta is %g, this bake covers %g to %g (relative refractive index, no "
                    "unit): bake again without --any-eta for another",
                    m->name[0] ? m->name : "material", (double)m->eta, (double)range[0],
                    (double)range[1]);
}

int prt_free_media_check(const struct prt_context *ctx, const struct prt_transport *t,
                         const struct prt_media *media)
{
    bool any_free = false;
    for (uint32_t i = 0; i < t->n_tensor; i++) any_free |= is_free(&t->tensor[i]);
    if (!any_free)
        return prt_fail(ctx, PRT_MISMATCH,
                        "a wavelet transport's material is fixed when it is baked: omit the "
                        "material, or bake a joint or polynomial transport");
    int status = prt_media_check(ctx, media, t->mesh.n_object);
    float range[2];
    const bool any_eta = prt_transport_any_eta(t, range);
    for (uint32_t i = 0; i < t->mesh.n_object && !status; i++) {
        const struct prt_material *m = prt_media_of(media, i),
                                  *baked = prt_media_of(&t->media, i);
        if (!has_inside(&t->mesh, i)) continue;
        if (any_eta) {
            status = check_eta(ctx, m, range);
            continue;
        }
        if (fabsf(m->eta - baked->eta) <= 1e-6f) continue;
        const char *name = t->media.n > 1 && t->mesh.object ? t->mesh.object[i].name : "";
        status = prt_fail(
            ctx, PRT_MISMATCH,
            "%s: eta is %g, this bake%s%s is for %g (relative refractive index, no "
            "unit): bake again for another%s",
            m->name[0] ? m->name : "material", (double)m->eta, *name ? " of " : "", name,
            (double)baked->eta,
            t->engine == PRT_TRANSPORT_JOINT ? ", or --any-eta for all from 1.2 to 1.6" : "");
    }
    return status;
}

// The object of a vertex, by bisection: blocks partition the vertices in order.
static uint32_t object_of(const struct prt_mesh *mesh, uint32_t vertex)
{
    uint32_t low = 0, high = mesh->n_block;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (mesh->block[middle].vertex_begin <= vertex) low = middle;
        else high = middle;
    }
    return mesh->block[low].object;
}

int prt_cluster_objects(const struct prt_transport *transport, const struct prt_tensor *tensor,
                        uint32_t **out)
{
    *out = NULL;
    if (transport->mesh.n_object < 2) return PRT_OK;
    uint32_t *object = prt_calloc(tensor->n_cluster + 1ull, sizeof *object);
    for (uint32_t c = 0; object && c < tensor->n_cluster; c++)
        if (tensor->cluster[c].n_vertex)
            object[c] =
                object_of(&transport->mesh, tensor->order[tensor->cluster[c].vertex_begin]);
    *out = object;
    return object ? PRT_OK : PRT_NOMEM;
}

int prt_cluster_media(const struct prt_transport *transport, const struct prt_tensor *tensor,
                      const struct prt_media *media, uint8_t **out)
{
    *out = NULL;
    if (media->n == 1) return PRT_OK;
    uint8_t *medium = prt_calloc(tensor->n_cluster + 1ull, 1);
    for (uint32_t c = 0; medium && c < tensor->n_cluster; c++) {
        if (!tensor->cluster[c].n_vertex) continue;
        const uint32_t first = tensor->order[tensor->cluster[c].vertex_begin];
        medium[c] = (uint8_t)prt_media_index(media, object_of(&transport->mesh, first));
    }
    *out = medium;
    return medium ? PRT_OK : PRT_NOMEM;
}

static int check_query(const struct prt_context *ctx, const struct prt_transport *t,
                       const struct prt_query *q)
{
    bool any_light = false;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        any_light |= t->tensor[i].storage != PRT_STORAGE_RADIAL;
    int status = q->media.n ? prt_free_media_check(ctx, t, &q->media) : PRT_OK;
    if (status) return status;
    if (q->lit && !prt_contracted_light_is_of(q->lit, t))
        return prt_fail(ctx, PRT_ARG, "the contracted light was made for another transport");
    if (any_light && !q->light && !q->lit)
        return prt_fail(ctx, PRT_ARG, "the query has no light, and this transport needs one");
    if (q->light && any_light && q->light->n != t->cube)
        return prt_fail(ctx, PRT_MISMATCH,
                        "the light is a cubemap of 6x%ux%u, the transport needs 6x%ux%u",
                        q->light->n, q->light->n, t->cube, t->cube);
    if (q->eye && !(isfinite(q->eye[0]) && isfinite(q->eye[1]) && isfinite(q->eye[2])))
        return prt_fail(ctx, PRT_ARG, "the eye position is not finite");
    return PRT_OK;
}

static unsigned plane_count(const struct prt_transport *t, const struct prt_query *q)
{
    unsigned n = 1;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].term == PRT_TERM_SINGLE && is_term(q, &t->tensor[i]) &&
            t->tensor[i].n_phase > n)
            n = t->tensor[i].n_phase;
    return n;
}

void prt_phase_plane_factor(const struct prt_material *material,
                            const struct prt_tensor *tensor, unsigned k, float factor[3])
{
    unsigned l = k == 0 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3;
    for (int ch = 0; ch < 3; ch++) {
        struct prt_phase phase;
        float g = material->g[ch];
        factor[ch] = tensor->term == PRT_TERM_VIEW ? material->sigma_s_prime[ch] / (1 - g) : 1;
        if (tensor->term == PRT_TERM_VIEW) continue; // planes of the exit, for an even phase
        if (!prt_phase_hg(&phase, (double)g, tensor->n_phase))
            factor[ch] = (float)phase.a[l] * material->sigma_s_prime[ch] / (1 - g);
    }
}

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
    if (is_free(t)) prt_phase_plane_factor(m, t, k, factor);
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
    if (*fits && !status && is_free(t)) status = find_coef(a, t, &o->coef);
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
        if (!is_wanted(a, &t->tensor[i])) continue;
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

// Whether some medium scatters singly.
static bool any_single(const struct prt_media *media)
{
    bool any = false;
    for (uint32_t i = 0; i < media->n; i++) any |= !media->medium[i].profile;
    return any;
}

// Media scatter evenly unless some g is not 0: their planes from 1 on are 0.
static bool all_even(const struct prt_media *media)
{
    bool even = true;
    for (uint32_t i = 0; i < media->n; i++) {
        const struct prt_material *m = &media->medium[i];
        even &= !m->profile && m->g[0] == 0 && m->g[1] == 0 && m->g[2] == 0;
    }
    return even;
}

// The planes of multiple scattering and of the phases behind it.
static unsigned apart_count(const struct answer *a)
{
    bool single = false;
    for (uint32_t i = 0; i < a->transport->n_tensor && any_single(a->media); i++)
        single |= a->transport->tensor[i].term == PRT_TERM_SINGLE &&
                  is_term(a->query, &a->transport->tensor[i]);
    const unsigned n = !single ? 1 : all_even(a->media) ? 2 : 1 + a->n_phase;
    return n < a->query->most_apart ? n : a->query->most_apart;
}

unsigned prt_answer_exit_planes(const struct prt_transport *transport,
                                const struct prt_query *query)
{
    const struct prt_media *media = query->media.n ? &query->media : &transport->media;
    for (uint32_t i = 0; i < transport->n_tensor && query->exits && any_single(media); i++)
        if (transport->tensor[i].term == PRT_TERM_VIEW && is_term(query, &transport->tensor[i]))
            return transport->tensor[i].n_phase;
    return 0;
}

// toward: the view is known, or the planes are shaded for one later. Colours are never apart.
static void answer_init(struct answer *a, const struct prt_context *ctx,
                        const struct prt_transport *transport, const struct prt_query *query,
                        bool toward, bool planes)
{
    *a = (struct answer){.ctx = ctx,
                         .transport = transport,
                         .query = query,
                         .media = query->media.n ? &query->media : &transport->media,
                         .n_vertex = transport->mesh.n_vertex,
                         .n_phase = plane_count(transport, query)};
    a->n_plane = a->n_phase;
    a->apart = planes && query->most_apart;
    if (a->apart) {
        a->n_exit = prt_answer_exit_planes(transport, query);
        a->n_plane = apart_count(a) + a->n_exit;
    }
    for (uint32_t i = 0; i < transport->n_tensor && toward && !a->apart && any_single(a->media);
         i++)
        a->view |= transport->tensor[i].term == PRT_TERM_SINGLE &&
                   is_term(query, &transport->tensor[i]);
    if (a->view && a->n_plane < 4) a->n_plane = 4;
    for (uint32_t i = 0; i < transport->n_tensor && a->view; i++) {
        const struct prt_tensor *t = &transport->tensor[i];
        if (t->term != PRT_TERM_VIEW) continue;
        a->exits = true;
        if (a->n_plane < t->n_phase) a->n_plane = t->n_phase;
    }
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
        any_free |= is_free(&a->transport->tensor[i]);
    return !any_free && !a->query->lit;
}

static bool same_layers(const struct prt_coefficients *a, const struct prt_coefficients *b)
{
    if (!a || !b) return a == b;
    return a->most_rank == b->most_rank && a->packed == b->packed && a->n_layer == b->n_layer &&
           a->n_half == b->n_half;
}

// Groups the first of n answers with those that differ from it only in their lights. Groups of
// two are not made: two single passes take less time.
static void group_answers(struct answer *a, unsigned n, const bool filled[], struct group *g)
{
    *g = (struct group){{a}, 1};
    for (unsigned i = 1; i < n && only_light(a); i++)
        if (!filled[i] && only_light(&a[i]) && a[i].query->term == a->query->term &&
            a[i].query->exit == a->query->exit &&
            a[i].query->most_rank == a->query->most_rank && a[i].n_plane == a->n_plane &&
            same_layers(a[i].coefficients, a->coefficients))
            g->answer[g->n++] = &a[i];
    if (g->n == 2) g->n = 1;
}

static int fill_many(struct answer *a, unsigned n)
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
            if (!is_wanted(&a[i], &t->tensor[k]) || a[i].done >> k & 1) continue;
            if (is_free(&t->tensor[k]) || a[i].query->lit)
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
    int status = fill_many(part, n);
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
    status = fill_many(part, m);
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
        if (m) status = fill_many(part, m);
    }
    return status;
}

static int fill_answers(struct answer *a, unsigned n)
{
    struct answer plain[PRT_RELIGHT_MAX_LIGHTS], view[PRT_RELIGHT_MAX_LIGHTS],
        apart[PRT_RELIGHT_MAX_LIGHTS];
    unsigned n_plain = 0, n_view = 0, n_apart = 0;
    for (unsigned i = 0; i < n; i++)
        if (a[i].apart) apart[n_apart++] = a[i];
        else if (a[i].view) view[n_view++] = a[i];
        else plain[n_plain++] = a[i];
    int status = n_plain ? fill_many(plain, n_plain) : PRT_OK;
    if (!status && n_apart) status = fill_apart(apart, n_apart);
    return status || !n_view ? status : fill_corrected(view, n_view);
}

int prt_answer_planes(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, unsigned *n_plane, float *planes)
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    answer_init(&a, ctx, transport, query, true, true);
    a.planes = planes;
    if (planes && (status = fill_answers(&a, 1))) return status;
    *n_plane = a.n_plane;
    return PRT_OK;
}

struct shade_job {
    const struct answer *a;
    // of each medium: the divisor of the exit, and outgoing transmittance without an eye over
    // it
    double divisor[PRT_MEDIA_MAX];
    float mean[PRT_MEDIA_MAX];
};

// w_o': the view direction refracted into the medium (Snell). Returns the cosine of w.
static float refract_out(double eta, const float n[3], const float w[3], float out[3])
{
    float cosine = n[0] * w[0] + n[1] * w[1] + n[2] * w[2];
    float inverse = (float)(1 / eta), c = cosine > 0 ? cosine : 0;
    float inside = sqrtf(fmaxf(0, 1 - inverse * inverse * (1 - c * c)));
    for (int i = 0; i < 3; i++) out[i] = w[i] * inverse + (inside - c * inverse) * n[i];
    return cosine;
}

static void view_of(const struct answer *a, size_t v, float w[3])
{
    const float *p = a->transport->mesh.position[v];
    float d[3] = {a->query->eye[0] - p[0], a->query->eye[1] - p[1], a->query->eye[2] - p[2]};
    float length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    for (int i = 0; i < 3; i++)
        w[i] = length > 0 ? d[i] / length : a->transport->mesh.normal[v][i];
}

static void shade_vertex(const struct shade_job *job, size_t v, uint32_t medium, float out[3])
{
    const struct answer *a = job->a;
    const double eta = (double)a->media->medium[medium].eta;
    const size_t size = 3 * a->n_vertex;
    const float *plane = a->planes + 3 * v;
    // adds the planes that depend on the view
    float w[3], inside[3], y[MOST_PHASES], rgb[3] = {plane[0], plane[1], plane[2]};
    unsigned n_band = a->n_plane > 9 ? 4 : a->n_plane > 4 ? 3 : a->n_plane > 1 ? 2 : 1;
    view_of(a, v, w);
    float cosine = refract_out(eta, a->transport->mesh.normal[v], w, inside);
    prt_sh_eval(n_band, inside, y);
    for (unsigned k = 1; k < a->n_plane; k++)
        for (int ch = 0; ch < 3; ch++) rgb[ch] += y[k] * plane[k * size + (size_t)ch];
    double transmittance =
        cosine > 0 ? prt_fresnel_transmittance(eta, (double)cosine) / job->divisor[medium] : 0;
    if (a->query->term != PRT_ANSWER_TOTAL && cosine > 0) transmittance = 1;
    for (int ch = 0; ch < 3; ch++) out[ch] = fmaxf(0, rgb[ch] * (float)transmittance);
}

// Shades vertices [begin_v, end) of one block. Without an eye only plane 0 (l = 0) is used.
// out[0] is vertex begin_v's colour; it may be its plane 0. gain: factors of an opaque block's
// channels; NULL: 1.
static void shade_block(const struct shade_job *job, size_t begin_v, size_t end,
                        uint32_t object, bool translucent, const float *gain, float (*out)[3])
{
    const struct answer *a = job->a;
    const bool total = a->query->term == PRT_ANSWER_TOTAL;
    const float *plane = a->planes + 3 * begin_v;
    float *color = out[0];
    const bool seen = total || a->query->term == PRT_ANSWER_SINGLE;
    if (a->query->eye && translucent && seen) {
        const uint32_t medium = prt_media_index(a->media, object);
        for (size_t v = begin_v; v < end; v++) shade_vertex(job, v, medium, out[v - begin_v]);
        return;
    }
    const float transmittance =
        translucent && total ? job->mean[prt_media_index(a->media, object)] : 1;
    const size_t n = 3 * (end - begin_v);
    for (size_t i = 0; i < n; i++) {
        const float x = plane[i] * transmittance;
        color[i] = x > 0 ? x : 0;
    }
    for (size_t i = 0; gain && !translucent && i < n; i++) color[i] *= gain[i % 3];
}

// Shades vertices [begin_v, end) to out[0] and on. Blocks partition the vertices in order.
static void shade_vertices(const struct shade_job *job, size_t begin_v, size_t end,
                           float (*out)[3])
{
    const struct prt_mesh *mesh = &job->a->transport->mesh;
    const float(*gain)[3] = job->a->query->gain;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        const size_t from = b->vertex_begin > begin_v ? b->vertex_begin : begin_v;
        const size_t stop = b->vertex_begin + (size_t)b->n_vertex;
        if (from < end && from < stop)
            shade_block(job, from, stop < end ? stop : end, b->object,
                        mesh->surface[b->surface].translucent, gain ? gain[i] : NULL,
                        out + (from - begin_v));
    }
}

static void shade_job_init(struct shade_job *job, const struct answer *a)
{
    job->a = a;
    for (uint32_t i = 0; i < a->media->n; i++) {
        const double eta = (double)a->media->medium[i].eta;
        job->divisor[i] = prt_exit_divisor(eta, a->query->exit);
        job->mean[i] = (float)(prt_fresnel_mean_transmittance(eta) / job->divisor[i]);
    }
}

// The colours of several answers; pieces of all of them are one loop.
struct shade_many {
    struct shade_job job[PRT_RELIGHT_MAX_LIGHTS];
    unsigned of[PRT_RELIGHT_MAX_LIGHTS]; // the query of each job
    float (*out[PRT_RELIGHT_MAX_LIGHTS])[3];
    size_t n_piece; // of one answer
    const struct prt_colors_sink *sink;
};

// Colours of a piece go to the sink block by block: they stay in the L1 cache, and the planes
// behind them are not written.
static void put_pieces(const struct shade_many *many, size_t k, size_t begin, size_t end)
{
    float color[SINK_GRAIN][3];
    const struct shade_job *job = &many->job[k];
    for (size_t v = begin, next; v < end; v = next) {
        next = v + SINK_GRAIN < end ? v + SINK_GRAIN : end;
        shade_vertices(job, v, next, color);
        many->sink->put(many->sink->user, job->a->ctx, many->of[k], v, next,
                        (const float(*)[3])color);
    }
}

static int shade_pieces(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct shade_many *many = arg;
    for (size_t i = begin; i < end; i++) {
        const size_t k = i / many->n_piece, n_vertex = many->job[k].a->n_vertex;
        const size_t from = i % many->n_piece * VERTEX_GRAIN;
        const size_t stop = from + VERTEX_GRAIN < n_vertex ? from + VERTEX_GRAIN : n_vertex;
        if (many->sink && many->sink->takes[many->of[k]]) put_pieces(many, k, from, stop);
        else shade_vertices(&many->job[k], from, stop, many->out[k] + from);
    }
    return PRT_OK;
}

// Colours of the n answers that have no planes[i]; planes NULL: of all.
static int shade_colors(const struct answer *a, unsigned n, const bool planes[],
                        float *const out[], const struct prt_colors_sink *sink)
{
    struct shade_many many = {.n_piece = (a->n_vertex + VERTEX_GRAIN - 1) / VERTEX_GRAIN,
                              .sink = sink};
    unsigned m = 0;
    for (unsigned i = 0; i < n; i++) {
        if (planes && planes[i]) continue;
        shade_job_init(&many.job[m], &a[i]);
        many.out[m] = (float(*)[3])out[i];
        many.of[m++] = i;
    }
    return prt_parallel_for(a->ctx, NULL, m * many.n_piece, 1, shade_pieces, &many);
}

// Room for the planes that become colours. A single plane is computed in the colours' own
// place.
static int make_planes(struct answer *a, float *color)
{
    if (!a->query->eye) a->n_plane = a->n_phase = 1; // colours without an eye use no other
    a->planes = color;
    if (a->n_plane > 1) a->planes = prt_alloc(3 * a->n_vertex * a->n_plane, sizeof *a->planes);
    return a->planes ? PRT_OK
                     : prt_fail(a->ctx, PRT_NOMEM, "no memory for %zu vertices", a->n_vertex);
}

static void drop_planes(struct answer *a, const float *color)
{
    if (a->planes != color) prt_free(a->planes);
}

int prt_answer_colors(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, float (*color)[3])
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    answer_init(&a, ctx, transport, query, query->eye != NULL, false);
    status = make_planes(&a, color[0]);
    if (!status) status = fill_answers(&a, 1);
    float *out = color[0];
    if (!status) status = shade_colors(&a, 1, NULL, &out, NULL);
    drop_planes(&a, color[0]);
    return status;
}

// The gain of parts that are sent apart; planes of pictures have it in their look.
static void gain_parts(const struct answer *a)
{
    const struct prt_mesh *mesh = &a->transport->mesh;
    const float(*gain)[3] = a->query->most_apart ? a->query->gain : NULL;
    for (uint32_t i = 0; gain && i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        if (mesh->surface[b->surface].translucent) continue;
        for (unsigned k = 0; k < a->n_plane; k++) {
            float *plane = a->planes + 3 * (k * a->n_vertex + b->vertex_begin);
            for (size_t v = 0; v < 3 * (size_t)b->n_vertex; v++) plane[v] *= gain[i][v % 3];
        }
    }
}

int prt_answer_many(const struct prt_context *ctx, const struct prt_transport *transport,
                    unsigned n, const struct prt_query query[], const bool planes[],
                    float *const out[], const struct prt_colors_sink *sink)
{
    struct answer a[PRT_RELIGHT_MAX_LIGHTS];
    int status = n >= 1 && n <= PRT_RELIGHT_MAX_LIGHTS
                     ? PRT_OK
                     : prt_fail(ctx, PRT_ARG, "%u queries in one call; 1 to %d are possible", n,
                                PRT_RELIGHT_MAX_LIGHTS);
    for (unsigned i = 0; i < n && !status; i++) status = check_query(ctx, transport, &query[i]);
    if (status) return status;
    for (unsigned i = 0; i < n; i++) {
        answer_init(&a[i], ctx, transport, &query[i], planes[i] || query[i].eye, planes[i]);
        a[i].planes = out[i];
        if (!planes[i] && !status) status = make_planes(&a[i], out[i]);
    }
    if (!status) status = fill_answers(a, n);
    if (!status) status = shade_colors(a, n, planes, out, sink);
    for (unsigned i = 0; i < n && !status; i++)
        if (planes[i]) gain_parts(&a[i]);
    for (unsigned i = 0; i < n; i++) drop_planes(&a[i], out[i]);
    return status;
}

// ---- coefficients

int prt_coefficients_plan(const struct prt_context *ctx, const struct prt_transport *transport,
                          const struct prt_query *query, struct prt_coefficients *c)
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    answer_init(&a, ctx, transport, query, false, false);
    a.exits = query->exits;
    c->n_layer = 0;
    c->n_half = 0;
    for (uint32_t i = 0; i < transport->n_tensor && !status; i++) {
        const struct prt_tensor *t = &transport->tensor[i];
        const bool single = prt_term_is_single(t->term), exit = t->term == PRT_TERM_VIEW;
        if (!is_wanted(&a, t) || (single && !any_single(a.media))) continue;
        const bool phases = exit || (single && c->phases && !all_even(a.media));
        const unsigned planes = phases ? t->n_phase : 1;
        status = prt_coefficients_add_layer(ctx, transport, i, planes, c);
    }
    return status;
}

int prt_answer_coefficients(const struct prt_context *ctx,
                            const struct prt_transport *transport, unsigned n,
                            const struct prt_query query[],
                            struct prt_coefficients *const out[])
{
    struct answer a[PRT_RELIGHT_MAX_LIGHTS];
    int status = n >= 1 && n <= PRT_RELIGHT_MAX_LIGHTS
                     ? PRT_OK
                     : prt_fail(ctx, PRT_ARG, "%u queries in one call; 1 to %d are possible", n,
                                PRT_RELIGHT_MAX_LIGHTS);
    for (unsigned i = 0; i < n && !status; i++) {
        status = check_query(ctx, transport, &query[i]);
        answer_init(&a[i], ctx, transport, &query[i], false, false);
        a[i].exits = query[i].exits;
        a[i].coefficients = out[i];
    }
    return status ? status : fill_many(a, n);
}

void prt_outgoing_of(const struct prt_material *material, enum prt_answer_term term,
                     enum prt_exit exit, struct prt_outgoing *out)
{
    const double eta = (double)material->eta;
    const bool total = term == PRT_ANSWER_TOTAL;
    const double divisor = total ? prt_exit_divisor(eta, exit) : 1;
    const double mean = total ? prt_fresnel_mean_transmittance(eta) : 1;
    *out = (struct prt_outgoing){.eta = material->eta,
                                 .roughness = material->roughness,
                                 .mean = (float)(mean / divisor),
                                 .divisor = (float)divisor,
                                 .view_slope = prt_view_slope(eta)};
}
