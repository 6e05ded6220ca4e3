// SPDX-License-Identifier: MIT
// The radial bases of joint and polynomial bakes, and the training media of joint ones.
#include "bake/radials.h"
#include "prt/profile.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static void reflectance_eval(const void *user, unsigned cpu, size_t n, const float *r2,
                             float *const *out)
{
    const struct prt_radial *radial = user;
    enum { CHUNK = 64 };
    float r[CHUNK], value[CHUNK * 64];
    uint32_t J = radial->n_function;
    for (size_t at = 0; at < n; at += CHUNK) {
        size_t m = n - at < CHUNK ? n - at : CHUNK;
        for (size_t i = 0; i < m; i++) r[i] = sqrtf(r2[at + i]);
        prt_radial_eval(radial, m, r, value);
        for (uint32_t j = 0; j < J; j++)
            for (size_t i = 0; i < m; i++) out[j][at + i] = value[i * J + j];
    }
}

struct radial_set prt_bases_radial_set(const struct bases *s)
{
    // 12 mm^-1: a function that falls faster is negligible beyond near_spacings
    // (cluster_kernel.c), within which the cells are integrated.
    return (struct radial_set){s->reflectance->n_function, reflectance_eval, s->reflectance,
                               12};
}

// Media with an R_d of their own: their channels as profiles that the basis must reproduce.
enum { MOST_OWN = 6 }; // profiles; prt/radial.h takes eight

static int own_profiles(const struct bake *b, struct prt_profile out[MOST_OWN], uint32_t *n)
{
    double r[PRT_MATERIAL_MAX_POINT], rd[PRT_MATERIAL_MAX_POINT];
    int status = PRT_OK;
    *n = 0;
    for (uint32_t k = 0; k < 3 * b->o.media.n && status == PRT_OK; k++) {
        const struct prt_material *m = &b->o.media.medium[k / 3];
        if (!m->profile) continue;
        if (*n == MOST_OWN)
            return prt_fail(b->ctx, PRT_LIMIT,
                            "more than %d media with a profile of their own: a joint or "
                            "polynomial bake takes no more",
                            MOST_OWN / 3);
        for (uint32_t i = 0; i < m->n_point; i++)
            r[i] = (double)m->radius[i], rd[i] = (double)m->reflectance[k % 3][i];
        status = prt_profile_init_curve(b->ctx, m->name, &out[(*n)++], m->n_point, r, rd);
    }
    return status;
}

// X07's kinds of basis in X07's sizes: 16 linear pieces (32 coefficients) for R_d and 8 pieces
// for the exponential; hats on the same knots.
static void x07_size(const struct bake *b, uint32_t pieces, struct prt_radial_options *o)
{
    o->kind = (enum prt_radial_kind)b->o.basis;
    if (o->kind == PRT_RADIAL_REDUCED) return;
    o->degree = 1;
    o->n_function = o->kind == PRT_RADIAL_HAT ? pieces + 1 : 2 * pieces;
    o->extra = NULL, o->n_extra = 0;
}

// The indices that the basis of R_d serves: the media's own, or all of the nodes' range.
static void choose_etas(const struct bake *b, struct prt_radial_options *o)
{
    struct prt_eta_nodes nodes;
    double eta[PRT_MEDIA_MAX];
    if (prt_bake_eta_nodes(b, PRT_FAMILY_DIPOLE, &nodes)) {
        o->eta = (double)nodes.low;
        o->eta_more[0] = (double)nodes.high;
        o->eta_more[1] = (o->eta + o->eta_more[0]) / 2;
        o->n_eta_more = 2;
        o->eta_between = true;
        return;
    }
    o->n_eta_more = prt_media_etas(&b->o.media, eta) - 1;
    o->eta = eta[0];
    memcpy(o->eta_more, eta + 1, o->n_eta_more * sizeof *eta);
}

int prt_bases_create(const struct bake *b, struct bases *s)
{
    struct prt_profile own[MOST_OWN] = {{.kind = PRT_PROFILE_CURVE}};
    uint32_t n_own = 0;
    double size = prt_mesh_diagonal(b->mesh);
    memset(s, 0, sizeof *s);
    struct prt_radial_options o = {.kind = PRT_RADIAL_REDUCED,
                                   .family = PRT_FAMILY_DIPOLE,
                                   .radius_mm = 1.01 * size,
                                   .max_error = 0.5 * b->o.max_error};
    choose_etas(b, &o);
    int status = own_profiles(b, own, &n_own);
    o.extra = own, o.n_extra = n_own;
    x07_size(b, 16, &o);
    if (status == PRT_OK) status = prt_radial_create(b->ctx, &o, &s->reflectance);
    for (uint32_t i = 0; i < n_own; i++) prt_profile_finish(&own[i]);
    o.extra = NULL, o.n_extra = 0;
    // Paths without a scattering are as single scattering's.
    if (status == PRT_OK && (b->walk || !b->o.no_single)) {
        o.family = PRT_FAMILY_EXTINCTION;
        o.radius_mm = 3 * size;
        // The error of the worst medium; the mean over media is a third of it. A polynomial
        // bake takes more functions: each costs it one column only.
        o.max_error = (b->o.engine == PRT_TRANSPORT_JOINT ? 1 : 0.2) * b->o.max_error;
        x07_size(b, 8, &o);
        status = prt_radial_create(b->ctx, &o, &s->extinction);
        if (status == PRT_OK && !b->o.no_single)
            status = prt_extinction_table_create(s->extinction, &s->integral);
    }
    if (status) prt_bases_finish(s);
    return status;
}

void prt_bases_drop_training(struct bases *s)
{
    for (uint32_t i = 0; i < s->n_training; i++) free(s->training[i].weight);
    s->n_training = 0;
}

void prt_bases_finish(struct bases *s)
{
    prt_radial_destroy(s->reflectance);
    prt_radial_destroy(s->extinction);
    prt_extinction_table_destroy(s->integral);
    prt_bases_drop_training(s);
    memset(s, 0, sizeof *s);
}

static double log_step(double lo, double hi, int i, int n)
{
    return lo * pow(hi / lo, (double)i / (n - 1));
}

// A grey medium's coefficients: channel 0 of the fit.
static int grey_fit(const struct prt_radial *radial, double eta, double sigma_s_prime,
                    double sigma_a, float *out)
{
    struct prt_material m = {.eta = (float)eta};
    float coef[64 * 3];
    for (int c = 0; c < 3; c++)
        m.sigma_s_prime[c] = (float)sigma_s_prime, m.sigma_a[c] = (float)sigma_a, m.g[c] = 0;
    int status = prt_radial_fit_material(radial, &m, coef, NULL);
    for (uint32_t j = 0; j < radial->n_function; j++) out[j] = coef[3 * j];
    return status;
}

static uint32_t translucent_vertices(const struct prt_mesh *mesh)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (mesh->surface[mesh->block[i].surface].translucent) n += mesh->block[i].n_vertex;
    return n;
}

// Adds the response of vertex v, which `object` owns, by every step-th of its samples.
static void add_response(const struct bake *b, const struct prt_diffusion *d, uint32_t v,
                         uint32_t object, uint32_t step, double *sum)
{
    enum { FEWEST = 64 }; // samples of an object, where it has them
    const struct prt_surface_points *s = b->surface;
    const uint32_t begin = s->object_begin[object], n = s->object_begin[object + 1] - begin;
    if (n / step < FEWEST) step = n / FEWEST + 1;
    for (uint32_t i = begin + step / 2; i < begin + n; i += step) {
        double r2 = 0;
        for (int k = 0; k < 3; k++)
            r2 += pow((double)b->mesh->position[v][k] - (double)s->position[i][k], 2);
        *sum += step * (double)s->area[i] * prt_diffusion_rd(d, sqrt(r2));
    }
}

// The response to constant irradiance divided by rho_d: the mean over translucent vertices of
// the integral of R_d over their objects. It is a few percent where light travels further than
// the body's size; the training divides by it, so that errors stay small relative to the
// response.
static double share_on_body(const struct bake *b, const struct prt_diffusion *d)
{
    enum { SAMPLES = 4096, VERTICES = 64 };
    const struct prt_surface_points *s = b->surface;
    const struct prt_mesh *mesh = b->mesh;
    const uint32_t step = s->n_sample / SAMPLES + 1;
    const uint32_t stride = translucent_vertices(mesh) / VERTICES + 1;
    double coarse = (double)s->spacing * sqrt(step), sum = 0;
    uint32_t n = 0, at = 0;
    if (d->z_r < 4 * coarse)
        return 1; // R_d ends within the body, and few samples do not resolve it
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *block = &mesh->block[i];
        if (!mesh->surface[block->surface].translucent) continue;
        for (uint32_t v = 0; v < block->n_vertex; v++) {
            if (at++ % stride) continue;
            add_response(b, d, block->vertex_begin + v, block->object, step, &sum);
            n++;
        }
    }
    return fmin(1, sum / (fmax(n, 1) * d->rho_d));
}

static const double absorber_share = 1.4; // weight of the strongest absorbers in the training

enum { SCATTER = 7, ABSORB = 4 };

// The channels of the bake's media that have an R_d of their own and this eta; 0: any.
static uint32_t count_own(const struct bake *b, double eta)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < b->o.media.n; i++)
        if (b->o.media.medium[i].profile &&
            (eta == 0 || (double)b->o.media.medium[i].eta == eta))
            n += 3;
    return n;
}

// A row's coefficients in the basis become those at every node of eta, [node][n].
static int spread(const struct prt_eta_nodes *nodes, enum prt_radial_family family, double eta,
                  uint32_t n, float *row)
{
    double weight[PRT_ETA_MOST_NODES];
    int status = prt_eta_weights(family, nodes, eta, weight, NULL);
    for (uint32_t b = nodes->n; b-- > 0 && !status;)
        for (uint32_t j = 0; j < n; j++) row[b * n + j] = (float)(weight[b] * (double)row[j]);
    return status;
}

static int train_own(const struct bake *b, const struct bases *s, double eta,
                     const struct prt_eta_nodes *nodes, float *row)
{
    const uint32_t J = s->reflectance->n_function, F = J * nodes->n;
    int status = PRT_OK;
    for (uint32_t i = 0; i < b->o.media.n && status == PRT_OK; i++) {
        const struct prt_material *m = &b->o.media.medium[i];
        float coef[64 * 3];
        if (!m->profile || (eta > 0 && (double)m->eta != eta)) continue;
        status = prt_radial_fit_material(s->reflectance, m, coef, NULL);
        for (uint32_t c = 0; c < 3 && !status; c++, row += F) {
            for (uint32_t j = 0; j < J; j++)
                row[j] = coef[3 * j + c] / (float)b->dipole[i][c].rho_d;
            if (nodes->n > 1) status = spread(nodes, PRT_FAMILY_DIPOLE, (double)m->eta, J, row);
        }
    }
    return status;
}

// Media over the range at one eta, [SCATTER * ABSORB][functions].
static int train_media(const struct bake *b, const struct bases *s, double eta,
                       const struct prt_eta_nodes *nodes, float *row)
{
    static const double absorb[ABSORB] = {0, 0.02, 0.25, 2};
    const uint32_t J = s->reflectance->n_function, F = J * nodes->n;
    int status = PRT_OK;
    for (int i = 0; status == PRT_OK && i < SCATTER * ABSORB; i++, row += F) {
        double scatter = log_step(0.02, 20, i / ABSORB, SCATTER);
        struct prt_diffusion d;
        prt_diffusion_init(&d, scatter, absorb[i % ABSORB], eta);
        status = grey_fit(s->reflectance, eta, scatter, absorb[i % ABSORB], row);
        double answer = d.rho_d * share_on_body(b, &d);
        // The strongest absorbers respond only near the entry point and need the highest rank.
        // Measured on 16 of the bunny's clusters: error of (0.02, 2) mm^-1 1.28 -> 1.24 %, of
        // no other medium more.
        if (i % ABSORB == ABSORB - 1) answer /= absorber_share;
        for (uint32_t j = 0; j < J; j++) row[j] /= (float)answer;
        if (!status && nodes->n > 1) status = spread(nodes, PRT_FAMILY_DIPOLE, eta, J, row);
    }
    return status;
}

static int train_eta(const struct bake *b, const struct bases *s, double eta,
                     struct training *t)
{
    static const struct prt_eta_nodes fixed = {.n = 1};
    const uint32_t J = s->reflectance->n_function;
    t->n = SCATTER * ABSORB + count_own(b, eta);
    t->weight = malloc((size_t)t->n * J * sizeof *t->weight);
    int status = t->weight ? PRT_OK : PRT_NOMEM;
    if (!status) status = train_media(b, s, eta, &fixed, t->weight);
    return status ? status
                  : train_own(b, s, eta, &fixed, t->weight + (size_t)SCATTER * ABSORB * J);
}

// One training for all indices: the media at both nodes, between and beyond which F_t and R_d
// change little.
static int train_any_eta(const struct bake *b, const struct bases *s,
                         const struct prt_eta_nodes *nodes, struct training *t)
{
    const uint32_t F = s->reflectance->n_function * nodes->n, own = count_own(b, 0);
    const size_t media = (size_t)SCATTER * ABSORB * F;
    t->n = nodes->n * SCATTER * ABSORB + own;
    t->weight = malloc((size_t)t->n * F * sizeof *t->weight);
    int status = t->weight ? PRT_OK : PRT_NOMEM;
    for (uint32_t a = 0; a < nodes->n && !status; a++)
        status = train_media(b, s, (double)nodes->node[a], nodes, t->weight + a * media);
    return status ? status : train_own(b, s, 0, nodes, t->weight + nodes->n * media);
}

int prt_bases_train_reflectance(const struct bake *b, struct bases *s)
{
    double eta[PRT_MEDIA_MAX];
    struct prt_eta_nodes nodes;
    const uint32_t n = prt_media_etas(&b->o.media, eta);
    int status = PRT_OK;
    prt_bases_drop_training(s);
    if (prt_bake_eta_nodes(b, PRT_FAMILY_DIPOLE, &nodes)) {
        s->n_training = 1;
        return train_any_eta(b, s, &nodes, &s->training[0]);
    }
    for (s->n_training = 0; s->n_training < n && status == PRT_OK; s->n_training++)
        status = train_eta(b, s, eta[s->n_training], &s->training[s->n_training]);
    return status;
}

static const float higher_planes = 0.6f; // weight of l > 0; chosen, not measured

// Extinctions over the range at one eta, each plane of the phase function apart: weight
// [STEPS * n_phase][n_phase][functions].
enum { STEPS = 10 };

static int train_paths(const struct bases *s, uint32_t n_phase, double eta,
                       const struct prt_eta_nodes *nodes, float *weight)
{
    const uint32_t J = s->extinction->n_function, N = J * nodes->n;
    float row[PRT_ETA_MOST_NODES * 64];
    int status = PRT_OK;
    for (uint32_t t = 0; status == PRT_OK && t < STEPS; t++) {
        double sigma = log_step(0.03, 40, (int)t, STEPS);
        status = grey_fit(s->extinction, 1, sigma, 0, row);
        if (!status && nodes->n > 1) status = spread(nodes, PRT_FAMILY_EXTINCTION, eta, J, row);
        for (uint32_t k = 0; k < n_phase; k++)
            for (uint32_t j = 0; j < N; j++)
                weight[(((size_t)t * n_phase + k) * n_phase + k) * N + j] =
                    row[j] * (float)sigma * (k ? higher_planes : 1.0f);
    }
    return status;
}

int prt_bases_train_extinction(const struct bake *b, struct bases *s, uint32_t n_phase)
{
    struct prt_eta_nodes nodes = {.n = 1};
    const bool any_eta = prt_bake_eta_nodes(b, PRT_FAMILY_EXTINCTION, &nodes);
    const uint32_t N = s->extinction->n_function * nodes.n, at = any_eta ? 2 : 1;
    const size_t block = (size_t)STEPS * n_phase * n_phase * N;
    struct training *t = &s->training[0];
    prt_bases_drop_training(s);
    t->n = at * STEPS * n_phase;
    t->weight = calloc(at * block, sizeof *t->weight);
    s->n_training = 1;
    int status = t->weight ? PRT_OK : PRT_NOMEM;
    for (uint32_t a = 0; a < at && !status; a++) // the first and the last node
        status = train_paths(s, n_phase, (double)nodes.node[a ? nodes.n - 1 : 0], &nodes,
                             t->weight + a * block);
    return status;
}

int prt_bases_record_eta(const struct bake *b, struct prt_tensor *t)
{
    struct prt_eta_nodes nodes;
    const enum prt_radial_family family =
        t->term == PRT_TERM_MULTIPLE ? PRT_FAMILY_DIPOLE : PRT_FAMILY_EXTINCTION;
    if (!prt_bake_eta_nodes(b, family, &nodes)) return PRT_OK;
    float *axis = prt_alloc(2 + nodes.n, sizeof *axis);
    t->eta = axis;
    if (!axis) return PRT_NOMEM;
    axis[0] = nodes.low, axis[1] = nodes.high;
    memcpy(axis + 2, nodes.node, nodes.n * sizeof *axis);
    t->n_eta = 2 + nodes.n;
    t->n_radial *= nodes.n;
    return PRT_OK;
}

int prt_bases_record(const struct prt_radial *radial, uint32_t n_phase, struct prt_tensor *t)
{
    size_t grid = radial->n_grid, all = grid * radial->n_function;
    float *knot = prt_alloc(grid, sizeof *knot), *basis = prt_alloc(all, sizeof *basis);
    t->knot = knot, t->basis = basis;
    if (!knot || !basis) return PRT_NOMEM;
    memcpy(knot, radial->r, grid * sizeof *knot);
    memcpy(basis, radial->value, all * sizeof *basis);
    t->n_knot = radial->n_grid;
    t->n_radial = radial->n_function;
    t->n_phase = n_phase;
    t->basis_kind = radial->kind;
    return PRT_OK;
}
