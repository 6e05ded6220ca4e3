// SPDX-License-Identifier: MIT
// The projection onto a radial basis: a weighted least squares that conserves the integral. It
// is solved once into an operator; a material then takes a small matrix-vector product.
#include "base/isa.h"
#include "profile.h"
#include "radial.h"

#include <lapacke.h>
#include <math.h>
#include <string.h>

/* Values at a quadrature point of a function given at the grid, linear in between. */
static double at_quad(const double *node, uint32_t q)
{
    double t = q & 1 ? 0.78867513459481288 : 0.21132486540518712;
    return node[q / 2] + t * (node[q / 2 + 1] - node[q / 2]);
}

static double absolute_mass(const struct radial *radial, const double *node)
{
    double sum = 0;
    for (uint32_t q = 0; q < radial->n_quad; q++)
        sum += radial->measure[q] * fabs(at_quad(node, q));
    return sum;
}

static void scale_rows(const struct radial *radial, uint32_t n, double *function, double *map,
                       uint32_t n_map)
{
    const uint32_t n_grid = radial->pub.n_grid;
    for (uint32_t j = 0; j < n; j++) {
        double mass = absolute_mass(radial, function + (size_t)j * n_grid);
        if (!(mass > 0)) continue;
        for (uint32_t i = 0; i < n_grid; i++) function[(size_t)j * n_grid + i] /= mass;
        for (uint32_t s = 0; map && s < n_map; s++) map[(size_t)j * n_map + s] *= mass;
    }
}

struct workspace {
    double *a; /* [n_quad][s]: sqrt(w) phi, then Q */
    double *r; /* [s][s] upper */
    double *tau, *integral, *h, *scale;
    double *op; /* [s][n_quad]: the operator onto the fit functions */
};

static void workspace_free(struct workspace *w)
{
    prt_free(w->a);
    prt_free(w->r);
    prt_free(w->tau);
    prt_free(w->integral);
    prt_free(w->h);
    prt_free(w->scale);
    prt_free(w->op);
}

static int workspace_init(struct workspace *w, size_t s, size_t n_quad)
{
    w->a = prt_calloc(s * n_quad, sizeof(double));
    w->r = prt_calloc(s * s, sizeof(double));
    w->tau = prt_calloc(s, sizeof(double));
    w->integral = prt_calloc(s, sizeof(double));
    w->h = prt_calloc(s, sizeof(double));
    w->scale = prt_calloc(s, sizeof(double));
    w->op = prt_calloc(s * n_quad, sizeof(double));
    return w->a && w->r && w->tau && w->integral && w->h && w->scale && w->op ? PRT_OK
                                                                              : PRT_NOMEM;
}

/* x := R^-1 x and x := R^-T x, R upper [s][s] row-major */
static void solve_upper(const double *r, uint32_t s, double *x, size_t step)
{
    for (uint32_t i = s; i-- > 0;) {
        double sum = x[i * step];
        for (uint32_t k = i + 1; k < s; k++) sum -= r[i * s + k] * x[k * step];
        x[i * step] = sum / r[i * s + i];
    }
}
static void solve_upper_transposed(const double *r, uint32_t s, double *x)
{
    for (uint32_t i = 0; i < s; i++) {
        double sum = x[i];
        for (uint32_t k = 0; k < i; k++) sum -= r[k * s + i] * x[k];
        x[i] = sum / r[i * s + i];
    }
}

/* A = sqrt(W) Phi with unit columns = QR; op = R^-1 Q^T sqrt(W). With the constraint
 * I.c = inside:  c += h (inside - I.c)/(I.h),  h = R^-1 R^-T I. */
static int solve_operator(const struct radial *radial, const struct radial_functions *f,
                          struct workspace *w)
{
    const uint32_t s = f->n_fit, nq = radial->n_quad, ng = radial->pub.n_grid;
    for (uint32_t j = 0; j < s; j++) {
        double norm = 0;
        for (uint32_t q = 0; q < nq; q++) {
            double v = at_quad(f->fit + (size_t)j * ng, q);
            w->integral[j] += radial->measure[q] * v;
            w->a[(size_t)q * s + j] = sqrt(radial->weight[q]) * v;
            norm += radial->weight[q] * v * v;
        }
        w->scale[j] = norm > 0 ? 1 / sqrt(norm) : 1;
        for (uint32_t q = 0; q < nq; q++) w->a[(size_t)q * s + j] *= w->scale[j];
        w->integral[j] *= w->scale[j];
    }
    if (LAPACKE_dgeqrf(LAPACK_ROW_MAJOR, (int)nq, (int)s, w->a, (int)s, w->tau))
        return PRT_INTERNAL;
    for (uint32_t i = 0; i < s; i++)
        for (uint32_t k = i; k < s; k++) w->r[i * s + k] = w->a[(size_t)i * s + k];
    for (uint32_t i = 0; i < s; i++)
        if (!(fabs(w->r[i * s + i]) > 1e-13)) return PRT_ARG; /* dependent functions */
    if (LAPACKE_dorgqr(LAPACK_ROW_MAJOR, (int)nq, (int)s, (int)s, w->a, (int)s, w->tau))
        return PRT_INTERNAL;
    for (uint32_t q = 0; q < nq; q++) {
        for (uint32_t j = 0; j < s; j++)
            w->op[(size_t)j * nq + q] = w->a[(size_t)q * s + j] * sqrt(radial->weight[q]);
        solve_upper(w->r, s, w->op + q, nq);
    }
    memcpy(w->h, w->integral, s * sizeof(double));
    solve_upper_transposed(w->r, s, w->h);
    solve_upper(w->r, s, w->h, 1);
    double kappa = 0;
    for (uint32_t j = 0; j < s; j++) kappa += w->integral[j] * w->h[j];
    const bool conserve = !prt_radial_is_plain(radial) && kappa > 0;
    for (uint32_t j = 0; j < s; j++) w->h[j] = conserve ? w->h[j] / kappa : 0;
    for (uint32_t q = 0; conserve && q < nq; q++) {
        double ic = 0;
        for (uint32_t j = 0; j < s; j++) ic += w->integral[j] * w->op[(size_t)j * nq + q];
        for (uint32_t j = 0; j < s; j++) w->op[(size_t)j * nq + q] -= w->h[j] * ic;
    }
    for (uint32_t j = 0; j < s; j++) {
        w->h[j] *= w->scale[j];
        for (uint32_t q = 0; q < nq; q++) w->op[(size_t)j * nq + q] *= w->scale[j];
    }
    return PRT_OK;
}

void prt_radial_free_functions(struct radial *radial)
{
    prt_free(radial->pub.value);
    prt_free(radial->phi);
    prt_free(radial->project);
    prt_free(radial->moment);
    prt_free(radial->table);
    radial->pub.value = radial->phi = radial->project = radial->moment = radial->table = NULL;
}

static int alloc_functions(struct radial *radial, uint32_t n)
{
    prt_radial_free_functions(radial);
    radial->pub.n_function = n;
    radial->stride = (n + 7) / 8 * 8;
    radial->pub.value = prt_calloc((size_t)n * radial->pub.n_grid, sizeof(float));
    radial->phi = prt_calloc((size_t)n * radial->n_quad, sizeof(float));
    radial->project = prt_calloc((size_t)radial->stride * radial->n_quad, sizeof(float));
    radial->moment = prt_calloc(radial->stride, sizeof(float));
    radial->table = prt_calloc((size_t)radial->stride * radial->pub.n_grid, sizeof(float));
    return radial->pub.value && radial->phi && radial->project && radial->moment &&
                   radial->table
               ? PRT_OK
               : PRT_NOMEM;
}

static void store_operator(struct radial *radial, const struct radial_functions *f,
                           const struct workspace *w)
{
    const uint32_t n = f->n_function, s = f->n_fit, nq = radial->n_quad,
                   ng = radial->pub.n_grid;
    const double *stored = f->map ? f->stored : f->fit;
    for (uint32_t j = 0; j < n; j++) {
        for (uint32_t i = 0; i < ng; i++) {
            radial->pub.value[(size_t)j * ng + i] = (float)stored[(size_t)j * ng + i];
            radial->table[(size_t)i * radial->stride + j] = (float)stored[(size_t)j * ng + i];
        }
        for (uint32_t q = 0; q < nq; q++) {
            radial->phi[(size_t)j * nq + q] = (float)at_quad(stored + (size_t)j * ng, q);
            double p = 0;
            for (uint32_t k = 0; f->map && k < s; k++)
                p += f->map[(size_t)j * s + k] * w->op[(size_t)k * nq + q];
            if (!f->map) p = w->op[(size_t)j * nq + q];
            radial->project[(size_t)q * radial->stride + j] = (float)p;
        }
        double h = f->map ? 0 : w->h[j];
        for (uint32_t k = 0; f->map && k < s; k++) h += f->map[(size_t)j * s + k] * w->h[k];
        radial->moment[j] = (float)h;
    }
}

int prt_radial_build(struct radial *radial, struct radial_functions *f)
{
    struct workspace w = {0};
    int err = PRT_NOMEM;
    if (f->map) scale_rows(radial, f->n_function, f->stored, f->map, f->n_fit);
    else scale_rows(radial, f->n_fit, f->fit, NULL, 0);
    if ((err = workspace_init(&w, f->n_fit, radial->n_quad)) == PRT_OK &&
        (err = solve_operator(radial, f, &w)) == PRT_OK &&
        (err = alloc_functions(radial, f->n_function)) == PRT_OK)
        store_operator(radial, f, &w);
    workspace_free(&w);
    return err;
}

void prt_radial_functions_finish(struct radial_functions *f)
{
    prt_free(f->fit);
    prt_free(f->map);
    prt_free(f->stored);
    *f = (struct radial_functions){0};
}

/* coef[j*step] of up to three channels f[c][n_quad] with their integrals; largest error. */
static inline __attribute__((always_inline)) double
project_body(const struct radial *radial, unsigned n_channel,
             float (*restrict f)[RADIAL_MAX_QUAD], const double *inside, float *coef)
{
    const uint32_t n = radial->pub.n_function, nq = radial->n_quad, stride = radial->stride;
    float sum[3][RADIAL_MAX_FUNCTION] = {{0}};
    for (uint32_t q = 0; q < nq; q++) {
        const float *restrict p = radial->project + (size_t)q * stride;
        for (unsigned c = 0; c < n_channel; c++) {
            const float x = f[c][q];
            for (uint32_t j = 0; j < stride; j++) sum[c][j] += p[j] * x;
        }
    }
    double worst = 0;
    for (unsigned c = 0; c < n_channel; c++) {
        for (uint32_t j = 0; j < n; j++) {
            float v = sum[c][j] + radial->moment[j] * (float)inside[c];
            const float *restrict phi = radial->phi + (size_t)j * nq;
            coef[(size_t)j * n_channel + c] = v;
            for (uint32_t q = 0; q < nq; q++) f[c][q] -= v * phi[q];
        }
        double error = 0;
        for (uint32_t q = 0; q < nq; q++)
            error += (double)radial->measure32[q] * fabsf(f[c][q]);
        error /= inside[c];
        if (!(error <= worst)) worst = error;
    }
    return worst;
}

static double project_c(const struct radial *radial, unsigned n_channel,
                        float (*f)[RADIAL_MAX_QUAD], const double *inside, float *coef)
{
    return project_body(radial, n_channel, f, inside, coef);
}

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
static double project_avx2(const struct radial *radial, unsigned n_channel,
                           float (*f)[RADIAL_MAX_QUAD], const double *inside, float *coef)
{
    return project_body(radial, n_channel, f, inside, coef);
}
PRT_ISA_END
#endif

double prt_radial_project(const struct radial *radial, unsigned n_channel,
                          float (*f)[RADIAL_MAX_QUAD], const double *inside, float *coef)
{
#if PRT_ISA_X86
    if (radial->cpu & PRT_CPU_AVX2) return project_avx2(radial, n_channel, f, inside, coef);
#endif
    return project_c(radial, n_channel, f, inside, coef);
}

static double fit_members(const struct radial *radial, const struct radial_member member[3],
                          float *coef)
{
    float f[3][RADIAL_MAX_QUAD];
    double inside[3];
    for (int c = 0; c < 3; c++)
        inside[c] = prt_radial_member_inside(&member[c], radial->pub.r[radial->pub.n_grid - 1]);
    if (radial->pub.family == PRT_FAMILY_DIPOLE) {
        struct prt_diffusion dipole[3];
        for (int c = 0; c < 3; c++) dipole[c] = member[c].dipole;
        prt_diffusion_rd3_array(dipole, radial->cpu, radial->n_quad, radial->quad_r2, f[0],
                                f[1], f[2]);
    } else {
        for (int c = 0; c < 3; c++)
            for (uint32_t q = 0; q < radial->n_quad; q++)
                f[c][q] = expf((float)(-member[c].sigma_t * radial->quad_r[q]));
    }
    return prt_radial_project(radial, 3, f, inside, coef);
}

/* Fits a material's table; returns the error, or -1 when it is 0 inside the grid. */
static double fit_own_profile(const struct radial *radial, const struct prt_material *m,
                              float *coef)
{
    float f[3][RADIAL_MAX_QUAD];
    struct prt_diffusion d[3];
    double inside[3];
    prt_material_dipoles(m, d);
    for (int c = 0; c < 3; c++) {
        prt_diffusion_rd_array(&d[c], radial->cpu, radial->n_quad, radial->quad_r2, f[c]);
        inside[c] =
            d[c].rho_d - prt_diffusion_tail(&d[c], radial->pub.r[radial->pub.n_grid - 1]);
        if (!(inside[c] > 0)) return -1;
    }
    return prt_radial_project(radial, 3, f, inside, coef);
}

// The family's index that a medium of index `eta` has; 0: none.
static double covered_eta(const struct prt_radial *radial, double eta)
{
    double range[2];
    radial_eta_range(radial, range);
    if (radial->eta_between && eta >= range[0] - 1e-4 && eta <= range[1] + 1e-4) return eta;
    for (uint32_t i = 0; i < radial_n_eta(radial); i++)
        if (fabs(radial_eta(radial, i) - eta) < 1e-4) return radial_eta(radial, i);
    return 0;
}

int prt_radial_fit_material(const struct prt_radial *radial,
                            const struct prt_material *material, float *coef, double *error)
{
    const struct radial *self = (const struct radial *)radial;
    struct radial_member member[3];
    const bool dipole = radial->family == PRT_FAMILY_DIPOLE;
    const double eta = covered_eta(radial, (double)material->eta);
    if (dipole && !(eta > 0)) return PRT_MISMATCH;
    for (int c = 0; c < 3; c++) {
        double s = material->sigma_s_prime[c], a = material->sigma_a[c], g = material->g[c];
        double sigma = dipole ? s : a + s / (1 - g);
        if (!(s > 0 && a >= 0 && g < 1) || !isfinite(sigma)) return PRT_ARG;
        prt_radial_member_init(&member[c], radial->family, eta, sigma, a);
    }
    double e;
    if (dipole && material->profile) {
        if ((e = fit_own_profile(self, material, coef)) < 0) return PRT_ARG;
    } else {
        e = fit_members(self, member, coef);
    }
    if (error) *error = e;
    return PRT_OK;
}

/* ---- profiles beside the family ---- */

/* The profile at quadrature points; returns its integral over the grid. */
static double sample_profile(const struct radial *radial, const struct prt_profile *p, float *f)
{
    for (uint32_t q = 0; q < radial->n_quad; q++)
        f[q] = (float)prt_profile_rd(p, radial->quad_r[q]);
    return p->total - prt_profile_tail(p, radial->pub.r[radial->pub.n_grid - 1]);
}

double prt_radial_remainder(const struct radial *radial, const struct prt_profile *profile,
                            double *out)
{
    float f[1][RADIAL_MAX_QUAD], coef[RADIAL_MAX_FUNCTION];
    const uint32_t ng = radial->pub.n_grid;
    double inside = sample_profile(radial, profile, f[0]);
    if (!(inside > 0)) return 0;
    double error = prt_radial_project(radial, 1, f, &inside, coef);
    for (uint32_t i = 0; i < ng; i++) {
        out[i] = prt_profile_rd(profile, radial->pub.r[i]);
        /* infinite at 0: the value there with which a line keeps the first cell's integral */
        if (!i && prt_profile_type(profile->kind)->is_singular) {
            double r1 = radial->pub.r[1];
            out[0] =
                6 * ((profile->total - prt_profile_tail(profile, r1)) / (2 * M_PI * r1 * r1) -
                     prt_profile_rd(profile, r1) / 3);
        }
        for (uint32_t j = 0; j < radial->pub.n_function; j++)
            out[i] -= (double)coef[j] * radial->pub.value[(size_t)j * ng + i];
    }
    return error;
}

/* ---- the error of the basis, on media between those of the family ---- */

static double log_between(double lo, double hi, double t)
{
    return lo * pow(hi / lo, t);
}

// The k-th index that the error is measured at.
static double measured_eta(const struct prt_radial *pub, int k)
{
    double range[2];
    if (!pub->eta_between) return radial_eta(pub, (uint32_t)k % radial_n_eta(pub));
    radial_eta_range(pub, range);
    return range[0] + (range[1] - range[0]) * fmod(k * 0.618033988749895, 1);
}

int prt_radial_measure(struct radial *radial)
{
    enum { N_TRIPLE = 96 };
    const double *s = radial->pub.range[0], *a = radial->pub.range[1];
    const double a_lo = a[0] > 0 ? a[0] : fmin(1e-5, a[1]);
    struct prt_rng rng;
    prt_rng_init(&rng, 2007, 9);
    float coef[3 * RADIAL_MAX_FUNCTION];
    double mean = 0, worst = 0;
    for (int i = 0; i < N_TRIPLE; i++) {
        struct radial_member m[3];
        double e[3];
        for (int c = 0; c < 3; c++) {
            int k = 3 * i + c; /* the first four are the corners */
            double u = k < 4 ? (k & 1) : prt_rng_f32(&rng),
                   v = k < 4 ? k >> 1 : prt_rng_f32(&rng);
            double sigma_a = k >= 4 && v < 0.1 ? a[0]
                             : a_lo > 0        ? log_between(a_lo, a[1], v)
                                               : 0;
            prt_radial_member_init(&m[0], radial->pub.family, measured_eta(&radial->pub, k),
                                   log_between(s[0], s[1], u), k < 4 ? a[v > 0] : sigma_a);
            m[1] = m[2] = m[0];
            e[c] = fit_members(radial, m, coef);
            mean += e[c] / (3 * N_TRIPLE);
            if (!(e[c] <= worst)) worst = e[c];
        }
    }
    radial->pub.mean_error = mean;
    radial->pub.worst_error = worst;
    return PRT_OK;
}
