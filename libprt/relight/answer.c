// SPDX-License-Identifier: MIT
// Answers a query from a transport: per-vertex colours, or the planes they are made of.
// colour = F_t(eta, w_o) [ T_d.L/T + sum_k Y_k(w_o') T_k.L ]  (W05 section 5; METHODS §1, exit)
//
// w_o' is the direction inside whose refraction is the view. Planes of a wavelet transport
// contain the phase function's coefficients a_l and sigma_s; those of a joint transport do not,
// because both depend on the material: they are multiplied in here.
#include "answer_parts.h"
#include "kernels.h"

#include <math.h>
#include <stdlib.h>

bool prt_query_has_term(const struct prt_query *query, const struct prt_tensor *t)
{
    static const uint32_t of[] = {[PRT_ANSWER_MULTIPLE] = PRT_TERM_MULTIPLE,
                                  [PRT_ANSWER_SINGLE] = PRT_TERM_SINGLE,
                                  [PRT_ANSWER_UNSCATTERED] = PRT_TERM_UNSCATTERED};
    if (t->term == PRT_TERM_VIEW)
        return query->term == PRT_ANSWER_TOTAL || query->term == PRT_ANSWER_SINGLE;
    return query->term == PRT_ANSWER_TOTAL || t->term == of[query->term];
}

bool prt_answer_wants(const struct answer *a, const struct prt_tensor *t)
{
    bool single = t->term == PRT_TERM_SINGLE;
    if (t->term == PRT_TERM_VIEW)
        return a->exits && a->part != ONLY_SINGLE && prt_query_has_term(a->query, t);
    return prt_query_has_term(a->query, t) && a->part != ONLY_EXIT &&
           (a->part == ALL_TERMS || (a->part == ONLY_SINGLE) == single);
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
        if (t->tensor[i].term == PRT_TERM_SINGLE && prt_query_has_term(q, &t->tensor[i]) &&
            t->tensor[i].n_phase > n)
            n = t->tensor[i].n_phase;
    return n;
}

// The planes of multiple scattering and of the phases behind it.
static unsigned apart_count(const struct answer *a)
{
    bool single = false;
    for (uint32_t i = 0; i < a->transport->n_tensor && prt_media_scatter_singly(a->media); i++)
        single |= a->transport->tensor[i].term == PRT_TERM_SINGLE &&
                  prt_query_has_term(a->query, &a->transport->tensor[i]);
    const unsigned n = !single ? 1 : prt_media_scatter_evenly(a->media) ? 2 : 1 + a->n_phase;
    return n < a->query->most_apart ? n : a->query->most_apart;
}

unsigned prt_answer_exit_planes(const struct prt_transport *transport,
                                const struct prt_query *query)
{
    const struct prt_media *media = query->media.n ? &query->media : &transport->media;
    for (uint32_t i = 0;
         i < transport->n_tensor && query->exits && prt_media_scatter_singly(media); i++)
        if (transport->tensor[i].term == PRT_TERM_VIEW &&
            prt_query_has_term(query, &transport->tensor[i]))
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
    for (uint32_t i = 0;
         i < transport->n_tensor && toward && !a->apart && prt_media_scatter_singly(a->media);
         i++)
        a->view |= transport->tensor[i].term == PRT_TERM_SINGLE &&
                   prt_query_has_term(query, &transport->tensor[i]);
    if (a->view && a->n_plane < 4) a->n_plane = 4;
    for (uint32_t i = 0; i < transport->n_tensor && a->view; i++) {
        const struct prt_tensor *t = &transport->tensor[i];
        if (t->term != PRT_TERM_VIEW) continue;
        a->exits = true;
        if (a->n_plane < t->n_phase) a->n_plane = t->n_phase;
    }
}

int prt_answer_planes(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, unsigned *n_plane, float *planes)
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    answer_init(&a, ctx, transport, query, true, true);
    a.planes = planes;
    if (planes && (status = prt_answers_fill(&a, 1))) return status;
    *n_plane = a.n_plane;
    return PRT_OK;
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
    if (!status) status = prt_answers_fill(&a, 1);
    float *out = color[0];
    if (!status) status = prt_answers_shade(&a, 1, NULL, &out, NULL);
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
    if (!status) status = prt_answers_fill(a, n);
    if (!status) status = prt_answers_shade(a, n, planes, out, sink);
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
        if (!prt_answer_wants(&a, t) || (single && !prt_media_scatter_singly(a.media)))
            continue;
        const bool phases = exit || (single && c->phases && !prt_media_scatter_evenly(a.media));
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
    return status ? status : prt_answers_fill_as_one(a, n);
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
