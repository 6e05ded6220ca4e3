// SPDX-License-Identifier: MIT
// A transport and a question to per-vertex colours: DESIGN's terms, W05 section 5's run time
// colour = F_t(eta, w_o) [ T_d.L + sum_k h_k(w_o') T_k.L ].
//
// Phase planes are weighted by h_k = Y_k(w_o'), w_o' the outward direction whose refraction is
// the view: the stored planes carry light part, a_l and sigma_s. A joint transport's planes do
// not: its a_l and sigma_s come in here.
#include "answer.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const float Y00 = 0.28209479177387814f; // 1/sqrt(4 pi)

enum { MAX_PLANE = 16, VERTEX_GRAIN = 4096 };

struct answer {
    const struct prt_context *ctx;
    const struct prt_transport *transport;
    const struct prt_query *query;
    const struct prt_material *material;
    struct prt_light light; // coef NULL for polynomial
    size_t n_vertex;
    unsigned n_plane;
    float *planes; // [n_plane][n_vertex][3]
};

static bool is_free(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
}

static bool asked(const struct prt_query *query, const struct prt_tensor *t)
{
    return query->term == PRT_ANSWER_TOTAL ||
           (t->term == PRT_TERM_SINGLE) == (query->term == PRT_ANSWER_SINGLE);
}

int relight_material_check(const struct prt_context *ctx, const struct prt_transport *t,
                           const struct prt_material *material)
{
    bool any_free = false;
    for (uint32_t i = 0; i < t->n_tensor; i++) any_free |= is_free(&t->tensor[i]);
    if (!any_free)
        return prt_fail(ctx, PRT_MISMATCH,
                        "a wavelet transport's material is fixed when it is baked");
    int status = prt_material_check(ctx, material);
    if (status || fabsf(material->eta - t->material.eta) <= 1e-6f) return status;
    return prt_fail(ctx, PRT_MISMATCH,
                    "%s: eta is %g, this bake is for %g (relative refractive index, no unit): "
                    "bake again for another",
                    material->name[0] ? material->name : "material", (double)material->eta,
                    (double)t->material.eta);
}

static int check_query(const struct prt_context *ctx, const struct prt_transport *t,
                       const struct prt_query *q)
{
    bool any_light = false;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        any_light |= t->tensor[i].storage != PRT_STORAGE_RADIAL;
    int status = q->material ? relight_material_check(ctx, t, q->material) : PRT_OK;
    if (status) return status;
    if (q->lit && !relight_lit_is_of(q->lit, t))
        return prt_fail(ctx, PRT_ARG, "the contracted light is another transport's");
    if (any_light && !q->light && !q->lit) return prt_fail(ctx, PRT_ARG, "this transport needs a light");
    if (q->light && any_light && q->light->n != t->cube)
        return prt_fail(ctx, PRT_MISMATCH, "a light of 6x%ux%u for a transport of 6x%ux%u",
                        q->light->n, q->light->n, t->cube, t->cube);
    if (q->eye && !(isfinite(q->eye[0]) && isfinite(q->eye[1]) && isfinite(q->eye[2])))
        return prt_fail(ctx, PRT_ARG, "the eye is not at a finite place");
    return PRT_OK;
}

static unsigned plane_count(const struct prt_transport *t, const struct prt_query *q)
{
    unsigned n = 1;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].term == PRT_TERM_SINGLE && asked(q, &t->tensor[i]) &&
            t->tensor[i].n_phase > n)
            n = t->tensor[i].n_phase;
    return n;
}

// Adds a tensor's planes [n_phase][n_vertex][3] to `out`.
static int relight(const struct answer *a, const struct prt_tensor *t, float *out)
{
    float *coef = NULL;
    const struct prt_light *light = &a->light;
    int status = PRT_OK;
    if (is_free(t)) {
        coef = prt_alloc(3 * (size_t)t->n_radial, sizeof *coef);
        status = coef ? relight_material_coef(a->ctx, a->transport, t, a->material, coef)
                      : prt_fail(a->ctx, PRT_NOMEM, "no memory for a material");
    }
    if (!status && a->query->lit)
        status = relight_lit(a->ctx, a->query->lit, t, coef, true, out);
    else if (!status) status = prt_relight(a->ctx, t, 1, &light, coef, true, out);
    prt_free(coef);
    return status;
}

// What plane k of a single-scattering tensor is multiplied by, beside Y_k(w_o').
static void plane_factor(const struct answer *a, const struct prt_tensor *t, unsigned k,
                         float factor[3])
{
    unsigned l = k == 0 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3;
    for (int ch = 0; ch < 3; ch++) {
        struct prt_phase phase;
        float g = a->material->g[ch];
        factor[ch] = 1;
        if (a->material->profile) factor[ch] = 0; // its R_d holds all light that leaves
        if (factor[ch] == 0 || !is_free(t) || prt_phase_hg(&phase, (double)g, t->n_phase)) continue;
        factor[ch] = (float)phase.a[l] * a->material->sigma_s_prime[ch] / (1 - g);
    }
}

struct mix_job {
    const struct answer *a;
    const float *in;
    float *out;
    float factor[3], constant;
};

static int mix(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct mix_job *job = arg;
    for (size_t v = begin; v < end; v++)
        for (int ch = 0; ch < 3; ch++)
            job->out[3 * v + ch] += job->in[3 * v + ch] * job->factor[ch] * job->constant;
    return PRT_OK;
}

// Opaque surfaces scatter nothing inside, whatever a file says of them.
static int mix_translucent(const struct answer *a, const struct mix_job *whole)
{
    const struct prt_mesh *mesh = &a->transport->mesh;
    int status = PRT_OK;
    for (uint32_t i = 0; i < mesh->n_block && !status; i++) {
        const struct prt_block *b = &mesh->block[i];
        struct mix_job job = *whole;
        if (!mesh->surface[b->surface].translucent) continue;
        job.in += 3 * (size_t)b->vertex_begin;
        job.out += 3 * (size_t)b->vertex_begin;
        status = prt_parallel_for(a->ctx, NULL, b->n_vertex, VERTEX_GRAIN, mix, &job);
    }
    return status;
}

// Adds a tensor's own planes: single scattering's plane 0 is view-free once it is times Y_00 and
// joins the multiple plane.
static int mix_tensor(const struct answer *a, const struct prt_tensor *t, const float *own)
{
    size_t size = 3 * a->n_vertex;
    bool single = t->term == PRT_TERM_SINGLE;
    int status = PRT_OK;
    for (unsigned k = 0; k < t->n_phase && k < a->n_plane && !status; k++) {
        struct mix_job job = {.a = a, .in = own + k * size, .out = a->planes + k * size,
                              .factor = {1, 1, 1}, .constant = single && !k ? Y00 : 1};
        if (single) plane_factor(a, t, k, job.factor);
        status = single ? mix_translucent(a, &job)
                        : prt_parallel_for(a->ctx, NULL, a->n_vertex, VERTEX_GRAIN, mix, &job);
    }
    return status;
}

static int add_single(const struct answer *a, const struct prt_tensor *t)
{
    float *own = prt_calloc(3 * a->n_vertex * t->n_phase, sizeof *own);
    if (!own) return prt_fail(a->ctx, PRT_NOMEM, "no memory for %u phase planes", t->n_phase);
    int status = relight(a, t, own);
    if (!status) status = mix_tensor(a, t, own);
    prt_free(own);
    return status;
}

static int fill_planes(struct answer *a)
{
    const struct prt_transport *t = a->transport;
    int status = PRT_OK;
    memset(a->planes, 0, 3 * a->n_vertex * a->n_plane * sizeof *a->planes);
    if (a->query->light && !a->query->lit &&
        (status = prt_light_from_cube(a->query->light, &a->light)))
        return prt_fail(a->ctx, status, "the light cannot be transformed");
    for (uint32_t i = 0; i < t->n_tensor && !status; i++) {
        if (!asked(a->query, &t->tensor[i])) continue;
        if (t->tensor[i].term == PRT_TERM_SINGLE) status = add_single(a, &t->tensor[i]);
        else status = relight(a, &t->tensor[i], a->planes);
    }
    if (a->light.coef) prt_light_finish(&a->light);
    return status;
}

static void begin(struct answer *a, const struct prt_context *ctx,
                  const struct prt_transport *transport, const struct prt_query *query)
{
    *a = (struct answer){.ctx = ctx,
                         .transport = transport,
                         .query = query,
                         .material = query->material ? query->material : &transport->material,
                         .n_vertex = transport->mesh.n_vertex,
                         .n_plane = plane_count(transport, query)};
}

int prt_answer_planes(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, unsigned *n_plane, float *planes)
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    begin(&a, ctx, transport, query);
    a.planes = planes;
    if (planes && (status = fill_planes(&a))) return status;
    *n_plane = a.n_plane;
    return PRT_OK;
}

struct shade_job {
    const struct answer *a;
    const uint32_t *block; // [n_vertex]
    float (*color)[3];
    double mean; // outgoing transmittance without an eye
};

// Outward w_o': w_o bent towards the normal, as its path inside runs (Snell).
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

static void shade_vertex(const struct shade_job *job, size_t v, bool translucent, float out[3])
{
    const struct answer *a = job->a;
    const size_t size = 3 * a->n_vertex;
    const float *plane = a->planes + 3 * v;
    double transmittance = 1, eta = (double)a->transport->material.eta;
    memcpy(out, plane, 12);
    // the phase function's view part: all planes with an eye, plane 0 (l = 0) without one
    if (a->query->eye && translucent &&
        (a->n_plane > 1 || a->query->term == PRT_ANSWER_TOTAL)) {
        float w[3], inside[3], y[MAX_PLANE];
        unsigned n_band = a->n_plane > 9 ? 4 : a->n_plane > 4 ? 3 : a->n_plane > 1 ? 2 : 1;
        view_of(a, v, w);
        float cosine = refract_out(eta, a->transport->mesh.normal[v], w, inside);
        prt_sh_eval(n_band, inside, y);
        for (unsigned k = 1; k < a->n_plane; k++)
            for (int ch = 0; ch < 3; ch++) out[ch] += y[k] * plane[k * size + (size_t)ch];
        transmittance = cosine > 0 ? prt_fresnel_transmittance(eta, (double)cosine) : 0;
    } else {
        transmittance = job->mean;
    }
    if (a->query->term != PRT_ANSWER_TOTAL || !translucent) transmittance = 1;
    for (int ch = 0; ch < 3; ch++) out[ch] = fmaxf(0, out[ch] * (float)transmittance);
}

static int shade(void *arg, size_t begin_v, size_t end, unsigned worker)
{
    const struct shade_job *job = arg;
    const struct prt_mesh *mesh = &job->a->transport->mesh;
    for (size_t v = begin_v; v < end; v++) {
        const struct prt_block *block = &mesh->block[job->block[v]];
        shade_vertex(job, v, mesh->surface[block->surface].translucent, job->color[v]);
    }
    return PRT_OK;
}

// Blocks tile the vertices in order.
static uint32_t *vertex_blocks(const struct prt_mesh *mesh)
{
    uint32_t *out = prt_alloc(mesh->n_vertex, sizeof *out);
    for (uint32_t i = 0; out && i < mesh->n_block; i++)
        for (uint32_t v = 0; v < mesh->block[i].n_vertex; v++)
            out[mesh->block[i].vertex_begin + v] = i;
    return out;
}

static int shade_colors(const struct answer *a, float (*color)[3])
{
    struct shade_job job = {a, vertex_blocks(&a->transport->mesh), color,
                            prt_fresnel_mean_transmittance((double)a->transport->material.eta)};
    if (!job.block) return prt_fail(a->ctx, PRT_NOMEM, "no memory for %zu vertices", a->n_vertex);
    int status = prt_parallel_for(a->ctx, NULL, a->n_vertex, VERTEX_GRAIN, shade, &job);
    prt_free((void *)(uintptr_t)job.block);
    return status;
}

int prt_answer_colors(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, float (*color)[3])
{
    struct answer a;
    int status = check_query(ctx, transport, query);
    if (status) return status;
    begin(&a, ctx, transport, query);
    if (!query->eye) a.n_plane = 1; // no other plane is looked at
    a.planes = prt_alloc(3 * a.n_vertex * a.n_plane, sizeof *a.planes);
    status = a.planes ? fill_planes(&a)
                      : prt_fail(ctx, PRT_NOMEM, "no memory for %zu vertices", a.n_vertex);
    if (!status) status = shade_colors(&a, color);
    prt_free(a.planes);
    return status;
}

// ---- several questions, one reading of the transport

enum { MANY_BYTES = 256 << 20 }; // of planes between the two steps

// One tensor for the answers that ask for it, as many lights a pass as the memory allows.
static int relight_many(struct answer *const answer[], unsigned n, const struct prt_tensor *t)
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
            status = mix_tensor(answer[i + k], t, own + k * each);
    }
    prt_free(own);
    return status;
}

static int fill_many(struct answer *a, unsigned n)
{
    const struct prt_transport *t = a[0].transport;
    int status = PRT_OK;
    for (unsigned i = 0; i < n && !status; i++)
        if (a[i].query->light && !a[i].query->lit &&
            prt_light_from_cube(a[i].query->light, &a[i].light))
            status = prt_fail(a[i].ctx, PRT_NOMEM, "the light cannot be transformed");
    for (uint32_t k = 0; k < t->n_tensor && !status; k++) {
        struct answer *group[PRT_RELIGHT_MAX_LIGHTS];
        unsigned m = 0;
        for (unsigned i = 0; i < n && !status; i++) {
            if (!asked(a[i].query, &t->tensor[k])) continue;
            if (n > 1 && !is_free(&t->tensor[k]) && !a[i].query->lit) group[m++] = &a[i];
            else if (t->tensor[k].term == PRT_TERM_SINGLE) status = add_single(&a[i], &t->tensor[k]);
            else status = relight(&a[i], &t->tensor[k], a[i].planes);
        }
        if (m && !status) status = relight_many(group, m, &t->tensor[k]);
    }
    for (unsigned i = 0; i < n; i++)
        if (a[i].light.coef) prt_light_finish(&a[i].light);
    return status;
}

int prt_answer_many(const struct prt_context *ctx, const struct prt_transport *transport,
                    unsigned n, const struct prt_query query[], const bool planes[],
                    float *const out[])
{
    struct answer a[PRT_RELIGHT_MAX_LIGHTS];
    int status = n >= 1 && n <= PRT_RELIGHT_MAX_LIGHTS
                     ? PRT_OK
                     : prt_fail(ctx, PRT_ARG, "%u questions are outside [1,%d]", n,
                                PRT_RELIGHT_MAX_LIGHTS);
    for (unsigned i = 0; i < n && !status; i++) status = check_query(ctx, transport, &query[i]);
    if (status) return status;
    for (unsigned i = 0; i < n; i++) {
        begin(&a[i], ctx, transport, &query[i]);
        if (!planes[i] && !query[i].eye) a[i].n_plane = 1;
        size_t size = 3 * a[i].n_vertex * a[i].n_plane;
        a[i].planes = planes[i] ? out[i] : prt_alloc(size, sizeof *a[i].planes);
        if (a[i].planes) memset(a[i].planes, 0, size * sizeof *a[i].planes);
        else status = prt_fail(ctx, PRT_NOMEM, "no memory for %zu vertices", a[i].n_vertex);
    }
    if (!status) status = fill_many(a, n);
    for (unsigned i = 0; i < n; i++) {
        if (planes[i]) continue;
        if (!status) status = shade_colors(&a[i], (float (*)[3])out[i]);
        prt_free(a[i].planes);
    }
    return status;
}
