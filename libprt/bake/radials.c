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

// A material with an R_d of its own: its channels as profiles that the basis must reproduce.
static int own_profiles(const struct bake *b, struct prt_profile out[3], uint32_t *n)
{
    const struct prt_material *m = &b->o.material;
    double r[PRT_MATERIAL_MAX_POINT], rd[PRT_MATERIAL_MAX_POINT];
    int status = PRT_OK;
    for (*n = 0; m->profile && *n < 3 && status == PRT_OK; ++*n) {
        for (uint32_t i = 0; i < m->n_point; i++)
            r[i] = (double)m->radius[i], rd[i] = (double)m->reflectance[*n][i];
        status = prt_profile_init_curve(b->ctx, m->name, &out[*n], m->n_point, r, rd);
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

int prt_bases_create(const struct bake *b, struct bases *s)
{
    struct prt_profile own[3] = {{.kind = PRT_PROFILE_CURVE}};
    uint32_t n_own = 0;
    double size = prt_mesh_diagonal(b->mesh);
    memset(s, 0, sizeof *s);
    struct prt_radial_options o = {.kind = PRT_RADIAL_REDUCED,
                                   .family = PRT_FAMILY_DIPOLE,
                                   .eta = b->o.material.eta,
                                   .radius_mm = 1.01 * size,
                                   .max_error = 0.5 * b->o.max_error};
    int status = own_profiles(b, own, &n_own);
    o.extra = own, o.n_extra = n_own;
    x07_size(b, 16, &o);
    if (status == PRT_OK) status = prt_radial_create(b->ctx, &o, &s->reflectance);
    for (uint32_t i = 0; i < n_own; i++) prt_profile_finish(&own[i]);
    o.extra = NULL, o.n_extra = 0;
    if (status == PRT_OK && !b->o.no_single) {
        o.family = PRT_FAMILY_EXTINCTION;
        o.radius_mm = 3 * size;
        // The error of the worst medium; the mean over media is a third of it. A polynomial
        // bake takes more functions: each costs it one column only.
        o.max_error = (b->o.engine == PRT_TRANSPORT_JOINT ? 1 : 0.2) * b->o.max_error;
        x07_size(b, 8, &o);
        status = prt_radial_create(b->ctx, &o, &s->extinction);
        if (status == PRT_OK) status = prt_extinction_table_create(s->extinction, &s->integral);
    }
    if (status) prt_bases_finish(s);
    return status;
}

void prt_bases_finish(struct bases *s)
{
    prt_radial_destroy(s->reflectance);
    prt_radial_destroy(s->extinction);
    prt_extinction_table_destroy(s->integral);
    free(s->training.weight);
    memset(s, 0, sizeof *s);
}

static double log_step(double lo, double hi, int i, int n)
{
    return lo * pow(hi / lo, (double)i / (n - 1));
}

// A grey medium's coefficients: channel 0 of the fit.
static int grey_fit(const struct prt_radial *radial, const struct bake *b, double sigma_s_prime,
                    double sigma_a, float *out)
{
    struct prt_material m = {.eta = b->o.material.eta};
    float coef[64 * 3];
    for (int c = 0; c < 3; c++)
        m.sigma_s_prime[c] = (float)sigma_s_prime, m.sigma_a[c] = (float)sigma_a, m.g[c] = 0;
    int status = prt_radial_fit_material(radial, &m, coef, NULL);
    for (uint32_t j = 0; j < radial->n_function; j++) out[j] = coef[3 * j];
    return status;
}

// The response to constant irradiance divided by rho_d: the mean over vertices of the integral
// of R_d over the body. It is a few percent where light travels further than the body's size;
// the training divides by it, so that errors stay small relative to the response.
static double share_on_body(const struct bake *b, const struct prt_diffusion *d)
{
    enum { SAMPLES = 4096, VERTICES = 64 };
    const struct prt_surface_points *s = b->surface;
    const struct prt_mesh *mesh = b->mesh;
    uint32_t step = s->n_sample / SAMPLES + 1, stride = mesh->n_vertex / VERTICES + 1, n = 0;
    double coarse = (double)s->spacing * sqrt(step), sum = 0;
    if (d->z_r < 4 * coarse)
        return 1; // R_d ends within the body, and few samples do not resolve it
    for (uint32_t v = 0; v < mesh->n_vertex; v += stride, n++)
        for (uint32_t i = step / 2; i < s->n_sample; i += step) {
            double r2 = 0;
            for (int k = 0; k < 3; k++)
                r2 += pow((double)mesh->position[v][k] - (double)s->position[i][k], 2);
            sum += step * (double)s->area[i] * prt_diffusion_rd(d, sqrt(r2));
        }
    return fmin(1, sum / (n * d->rho_d));
}

static const double absorber_share = 1.4; // weight of the strongest absorbers in the training

int prt_bases_train_reflectance(const struct bake *b, struct bases *s)
{
    enum { SCATTER = 7, ABSORB = 4 };
    static const double absorb[ABSORB] = {0, 0.02, 0.25, 2};
    uint32_t J = s->reflectance->n_function;
    free(s->training.weight);
    s->training.n = SCATTER * ABSORB + (b->o.material.profile ? 3 : 0);
    s->training.weight = malloc((size_t)s->training.n * J * sizeof *s->training.weight);
    int status = s->training.weight ? PRT_OK : PRT_NOMEM;
    for (int i = 0; status == PRT_OK && i < SCATTER * ABSORB; i++) {
        double scatter = log_step(0.02, 20, i / ABSORB, SCATTER);
        struct prt_diffusion d;
        float *row = s->training.weight + (size_t)i * J;
        prt_diffusion_init(&d, scatter, absorb[i % ABSORB], b->o.material.eta);
        status = grey_fit(s->reflectance, b, scatter, absorb[i % ABSORB], row);
        double answer = d.rho_d * share_on_body(b, &d);
        // The strongest absorbers respond only near the entry point and need the highest rank.
        // Measured on 16 of the bunny's clusters: error of (0.02, 2) mm^-1 1.28 -> 1.24 %, of
        // no other medium more.
        if (i % ABSORB == ABSORB - 1) answer /= absorber_share;
        for (uint32_t j = 0; j < J; j++) row[j] /= (float)answer;
    }
    if (status == PRT_OK && b->o.material.profile) { // the bake's own R_d, channel by channel
        float coef[64 * 3];
        status = prt_radial_fit_material(s->reflectance, &b->o.material, coef, NULL);
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t j = 0; j < J; j++)
                s->training.weight[(SCATTER * ABSORB + (size_t)c) * J + j] =
                    coef[3 * j + c] / (float)b->dipole[c].rho_d;
    }
    return status;
}

static const float higher_planes = 0.6f; // weight of l > 0; chosen, not measured

int prt_bases_train_extinction(const struct bake *b, struct bases *s, uint32_t n_phase)
{
    enum { STEPS = 10 };
    uint32_t J = s->extinction->n_function, F = J * n_phase;
    free(s->training.weight);
    s->training.n = STEPS * n_phase;
    s->training.weight = calloc((size_t)s->training.n * F, sizeof *s->training.weight);
    int status = s->training.weight ? PRT_OK : PRT_NOMEM;
    for (uint32_t t = 0; status == PRT_OK && t < STEPS; t++) {
        double sigma = log_step(0.03, 40, (int)t, STEPS);
        float coef[64];
        status = grey_fit(s->extinction, b, sigma, 0, coef);
        for (uint32_t k = 0; k < n_phase; k++)
            for (uint32_t j = 0; j < J; j++)
                s->training.weight[((size_t)t * n_phase + k) * F + k * J + j] =
                    coef[j] * (float)sigma * (k ? higher_planes : 1.0f);
    }
    return status;
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
