// SPDX-License-Identifier: MIT
// Basis functions: the singular vectors of a family, or splines on knots that dynamic
// programming places (X07 §5).
#include "radial.h"

#include <lapacke.h>
#include <math.h>
#include <string.h>

/* ---- reduced basis ---- */

/* Members of the family: a logarithmic grid over its range (METHODS §4). */
enum { N_SIGMA = 28, N_SIGMA_A = 16, N_SIGMA_T = 160 };

/* Steps of sigma_s' for each index: fewer where several indices, which R_d follows smoothly,
 * fill the family. */
static int sigma_steps(const struct radial *radial)
{
    const int n_eta = (int)radial_n_eta(&radial->pub);
    return n_eta == 1 ? N_SIGMA : n_eta < 5 ? 36 / n_eta : 7;
}

static uint32_t most_members(const struct radial *radial)
{
    uint32_t dipoles = radial_n_eta(&radial->pub) * (uint32_t)sigma_steps(radial) * N_SIGMA_A;
    return dipoles > N_SIGMA_T ? dipoles : N_SIGMA_T;
}

static uint32_t family_members(const struct radial *radial, struct radial_member *out)
{
    const double *s = radial->pub.range[0], *a = radial->pub.range[1];
    uint32_t n = 0;
    if (radial->pub.family == PRT_FAMILY_EXTINCTION) {
        for (int i = 0; i < N_SIGMA_T; i++)
            prt_radial_member_init(&out[n++], PRT_FAMILY_EXTINCTION, 1,
                                   s[0] * pow(s[1] / s[0], i / (N_SIGMA_T - 1.0)), 0);
        return n;
    }
    const double a_lo = a[0] > 0 ? a[0] : fmin(1e-5, a[1]);
    const int steps = sigma_steps(radial);
    for (int i = 0; i < steps * (int)radial_n_eta(&radial->pub); i++)
        for (int k = 0; k < N_SIGMA_A; k++) {
            double t = (k - 1) / (N_SIGMA_A - 2.0);
            double sigma_a = k && a_lo > 0 ? a_lo * pow(a[1] / a_lo, t) : a[0];
            prt_radial_member_init(&out[n++], PRT_FAMILY_DIPOLE,
                                   radial_eta(&radial->pub, (uint32_t)(i / steps)),
                                   s[0] * pow(s[1] / s[0], i % steps / (steps - 1.0)), sigma_a);
        }
    return n;
}

/* Left singular vectors into l: rows = L Q, then the SVD of the small matrix L. */
static int left_vectors(uint32_t n, uint32_t nq, double *row, double *l, double *value)
{
    double *tau = prt_calloc(n, sizeof *tau), *superb = prt_calloc(n, sizeof *superb);
    int err = tau && superb ? PRT_INTERNAL : PRT_NOMEM;
    if (err == PRT_INTERNAL &&
        !LAPACKE_dgelqf(LAPACK_ROW_MAJOR, (int)n, (int)nq, row, (int)nq, tau)) {
        for (uint32_t i = 0; i < n; i++)
            memcpy(l + (size_t)i * n, row + (size_t)i * nq, (i + 1) * sizeof *l);
        if (!LAPACKE_dgesvd(LAPACK_ROW_MAJOR, 'O', 'N', (int)n, (int)n, l, (int)n, value, NULL,
                            1, NULL, 1, superb))
            err = PRT_OK;
    }
    prt_free(tau);
    prt_free(superb);
    return err;
}

/* B_j = sum_m U_mj f_m / s_j, evaluated from the exact profiles f_m at every grid radius. */
static uint32_t combine(const struct radial *radial, const struct radial_member *member,
                        uint32_t n, const double *l, const double *value, uint32_t n_max,
                        double *out)
{
    const uint32_t ng = radial->pub.n_grid;
    uint32_t count = 0;
    while (count < n_max && count < n && value[count] > 1e-11 * value[0]) count++;
    memset(out, 0, (size_t)count * ng * sizeof *out);
    for (uint32_t m = 0; m < n; m++) {
        double scale = 1 / prt_radial_member_inside(&member[m], radial->pub.r[ng - 1]);
        for (uint32_t i = 0; i < ng; i++) {
            double f = scale * prt_radial_member_eval(&member[m], radial->pub.r[i]);
            for (uint32_t j = 0; j < count; j++)
                out[(size_t)j * ng + i] += f * l[(size_t)m * n + j] / value[j];
        }
    }
    return count;
}

int prt_radial_reduced(const struct radial *radial, uint32_t n_max, double *out,
                       uint32_t *n_out)
{
    const uint32_t nq = radial->n_quad;
    struct radial_member *member = prt_calloc(most_members(radial), sizeof *member);
    if (!member) return PRT_NOMEM;
    uint32_t n = family_members(radial, member);
    double *row = prt_calloc((size_t)n * nq, sizeof *row);
    double *l = prt_calloc((size_t)n * n, sizeof *l), *value = prt_calloc(n, sizeof *value);
    int err = PRT_NOMEM;
    if (!row || !l || !value) goto done;
    if ((err = nq >= n ? PRT_OK : PRT_ARG) < 0) goto done;
    /* rows sqrt(w) f / inside: the L1 error of each member has the same weight */
    for (uint32_t m = 0; m < n; m++) {
        double scale =
            1 / prt_radial_member_inside(&member[m], radial->pub.r[radial->pub.n_grid - 1]);
        for (uint32_t q = 0; q < nq; q++)
            row[(size_t)m * nq + q] = scale * sqrt(radial->weight[q]) *
                                      prt_radial_member_eval(&member[m], radial->quad_r[q]);
    }
    if ((err = left_vectors(n, nq, row, l, value)) == PRT_OK)
        *n_out = combine(radial, member, n, l, value, n_max, out);
done:
    prt_free(member);
    prt_free(row);
    prt_free(l);
    prt_free(value);
    return err;
}

/* ---- knots ---- */

/* Functions that the knots are placed for. X07 takes the mean of three members. The other kinds
 * take members over the whole range, each scaled to the same integral, and add their costs:
 * knots for the mean of three have an error of 55 % at the ends of a wide range. */
enum { MAX_TARGET = 15 };
struct knot_target {
    uint32_t n;
    double *f; /* [n][n_quad] */
};

static void add_target(const struct radial *radial, struct knot_target *target, double weight,
                       double sigma, double sigma_a)
{
    struct radial_member m;
    double *f = target->f + (size_t)target->n * radial->n_quad;
    prt_radial_member_init(&m, radial->pub.family, radial->pub.eta, sigma, sigma_a);
    for (uint32_t q = 0; q < radial->n_quad; q++)
        f[q] += weight * prt_radial_member_eval(&m, radial->quad_r[q]);
}

static int knot_target_init(const struct radial *radial, struct knot_target *target)
{
    static const double dipole[3][2] = {{0.2, 0.001}, {2, 0.02}, {10, 0.2}};
    static const double sigma_t[3] = {0.2, 2, 10};
    const bool is_dipole = radial->pub.family == PRT_FAMILY_DIPOLE;
    const double *s = radial->pub.range[0], *a = radial->pub.range[1];
    const double end = radial->pub.r[radial->pub.n_grid - 1];
    target->n = 0;
    target->f = prt_calloc((size_t)MAX_TARGET * radial->n_quad, sizeof *target->f);
    if (!target->f) return PRT_NOMEM;
    if (prt_radial_is_plain(radial)) {
        for (int i = 0; i < 3; i++)
            add_target(radial, target, 1 / 3.0, is_dipole ? dipole[i][0] : sigma_t[i],
                       dipole[i][1]);
        target->n = 1;
        return PRT_OK;
    }
    for (int i = 0; i < MAX_TARGET; i++) { /* five scales, and for dipoles three absorptions */
        double t = is_dipole ? i / 3 / 4.0 : i / (MAX_TARGET - 1.0);
        double sigma = s[0] * pow(s[1] / s[0], t);
        double sigma_a = fmin(a[1], fmax(a[0], sigma * (double[]){0.0005, 0.02, 0.5}[i % 3]));
        struct radial_member m;
        prt_radial_member_init(&m, radial->pub.family, radial->pub.eta, sigma, sigma_a);
        add_target(radial, target, 1 / prt_radial_member_inside(&m, end), sigma, sigma_a);
        target->n++;
    }
    return PRT_OK;
}

/* Least squares residual of one polynomial a target over quadrature points [begin, end). */
static double piece_cost(const struct radial *radial, const struct knot_target *target,
                         uint32_t begin, uint32_t end, double r0, double r1)
{
    double g[3][3] = {{0}}, b[MAX_TARGET][3] = {{0}}, ff[MAX_TARGET] = {0}, cost = 0;
    const uint32_t d = radial->degree;
    for (uint32_t q = begin; q < end; q++) {
        double t = 2 * (radial->quad_r[q] - r0) / (r1 - r0) - 1, w = radial->weight[q];
        double p[3] = {1, t, (3 * t * t - 1) / 2};
        for (uint32_t i = 0; i <= d; i++)
            for (uint32_t k = 0; k <= i; k++) g[i][k] += w * p[i] * p[k];
        for (uint32_t m = 0; m < target->n; m++) {
            double f = target->f[(size_t)m * radial->n_quad + q];
            for (uint32_t i = 0; i <= d; i++) b[m][i] += w * p[i] * f;
            ff[m] += w * f * f;
        }
    }
    for (uint32_t i = 0; i <= d; i++)
        for (uint32_t k = 0; k <= i; k++) {
            double sum = g[i][k];
            for (uint32_t l = 0; l < k; l++) sum -= g[i][l] * g[k][l];
            if (i == k && sum <= 1e-14 * g[i][i]) return 0; /* fewer points than terms */
            g[i][k] = i == k ? sqrt(sum) : sum / g[k][k];
        }
    for (uint32_t m = 0; m < target->n; m++) { /* |f|^2 - |L^-1 b|^2 */
        for (uint32_t i = 0; i <= d; i++) {
            for (uint32_t l = 0; l < i; l++) b[m][i] -= g[i][l] * b[m][l];
            b[m][i] /= g[i][i];
            ff[m] -= b[m][i] * b[m][i];
        }
        cost += ff[m] > 0 ? ff[m] : 0;
    }
    return cost;
}

enum { KNOT_STEP = 4 }; /* grid intervals between candidate knots: 16 candidates an octave */

static uint32_t candidate(uint32_t k, uint32_t n_candidate, uint32_t n_grid)
{
    return k == 0 ? 0 : k == n_candidate - 1 ? n_grid - 1 : k * KNOT_STEP;
}

int prt_radial_knots(const struct radial *radial, uint32_t m_max, uint32_t *knot)
{
    const uint32_t ng = radial->pub.n_grid, n = (ng - 1 + KNOT_STEP - 1) / KNOT_STEP + 1;
    if (m_max >= n) return PRT_ARG;
    struct knot_target target;
    double *cost = prt_calloc((size_t)n * n, sizeof *cost);
    double *best = prt_calloc((size_t)(m_max + 1) * n, sizeof *best);
    uint32_t *from = prt_calloc((size_t)(m_max + 1) * n, sizeof *from);
    int err = knot_target_init(radial, &target);
    if (err == PRT_OK && !(cost && best && from)) err = PRT_NOMEM;
    if (err < 0) goto done;
    for (uint32_t a = 0; a < n; a++)
        for (uint32_t b = a + 1; b < n; b++) {
            uint32_t i = candidate(a, n, ng), k = candidate(b, n, ng);
            cost[(size_t)a * n + b] =
                piece_cost(radial, &target, 2 * i, 2 * k, radial->pub.r[i], radial->pub.r[k]);
        }
    for (uint32_t b = 0; b < n; b++) best[b] = b ? INFINITY : 0;
    for (uint32_t m = 1; m <= m_max; m++)
        for (uint32_t b = 0; b < n; b++) {
            best[(size_t)m * n + b] = INFINITY;
            for (uint32_t a = 0; a < b; a++) {
                double c = best[(size_t)(m - 1) * n + a] + cost[(size_t)a * n + b];
                if (c < best[(size_t)m * n + b]) {
                    best[(size_t)m * n + b] = c;
                    from[(size_t)m * n + b] = a;
                }
            }
        }
    for (uint32_t m = 1; m <= m_max; m++)
        for (uint32_t k = m + 1, b = n - 1; k-- > 0;) {
            knot[(size_t)m * (m_max + 1) + k] = candidate(b, n, ng);
            if (k) b = from[(size_t)k * n + b];
        }
done:
    prt_free(target.f);
    prt_free(cost);
    prt_free(best);
    prt_free(from);
    return err;
}

/* ---- splines ---- */

/* The d+1 B-splines of degree d that are not 0 on interval k, at r: numbers k to k+d. */
static void bspline(uint32_t d, uint32_t m, const double *x, uint32_t k, double r,
                    double out[3])
{
#define KNOT(i) x[(i) < 0 ? 0 : (i) > (int)m ? (int)m : (i)]
    out[0] = 1;
    for (uint32_t p = 1; p <= d; p++) { /* de Boor's triangle with clamped end knots */
        double saved = 0;
        for (uint32_t i = 0; i < p; i++) {
            double right = KNOT((int)(k + i + 1)), left = KNOT((int)(k + i + 1) - (int)p);
            double share = out[i] / (right - left);
            out[i] = saved + (right - r) * share;
            saved = (r - left) * share;
        }
        out[p] = saved;
    }
#undef KNOT
}

static void bernstein(uint32_t d, double t, double out[3])
{
    double s = 1 - t;
    if (d == 2) out[0] = s * s, out[1] = 2 * s * t, out[2] = t * t;
    else out[0] = s, out[1] = t, out[2] = 0;
}

static void fill_splines(const struct radial *radial, uint32_t m, const uint32_t *knot,
                         const double *x, double *fit)
{
    const uint32_t ng = radial->pub.n_grid, d = radial->degree;
    for (uint32_t k = 0; k < m; k++)
        for (uint32_t i = knot[k]; i <= knot[k + 1]; i++) {
            double v[3];
            bspline(d, m, x, k, radial->pub.r[i], v);
            for (uint32_t j = 0; j <= d; j++) fit[(size_t)(k + j) * ng + i] = v[j];
        }
}

/* The polynomials of piece k in Bernstein form, which stay in [0,1] and do not cancel, and the
 * contribution of each spline to them. A node shared by two pieces belongs to the right one. */
static void fill_pieces(const struct radial *radial, uint32_t m, const uint32_t *knot,
                        const double *x, struct radial_functions *f)
{
    const uint32_t ng = radial->pub.n_grid, d = radial->degree, s = f->n_fit;
    for (uint32_t k = 0; k < m; k++) {
        double *stored = f->stored + (size_t)k * (d + 1) * ng;
        double *map = f->map + (size_t)k * (d + 1) * s;
        uint32_t last = k + 1 == m ? ng : knot[k + 1];
        for (uint32_t i = knot[k]; i < last; i++) {
            double b[3];
            bernstein(d, (radial->pub.r[i] - x[k]) / (x[k + 1] - x[k]), b);
            for (uint32_t j = 0; j <= d; j++) stored[(size_t)j * ng + i] = b[j];
        }
        double at0[3], at1[3], mid[3];
        bspline(d, m, x, k, x[k], at0);
        bspline(d, m, x, k, x[k + 1], at1);
        bspline(d, m, x, k, (x[k] + x[k + 1]) / 2, mid);
        for (uint32_t j = 0; j <= d; j++) {
            map[k + j] = at0[j];
            map[(size_t)d * s + k + j] = at1[j];
            if (d == 2) map[(size_t)s + k + j] = 2 * mid[j] - (at0[j] + at1[j]) / 2;
        }
    }
}

int prt_radial_spline(const struct radial *radial, uint32_t m, const uint32_t *knot,
                      struct radial_functions *out)
{
    const uint32_t ng = radial->pub.n_grid, d = radial->degree;
    const bool pieces = radial->pub.kind != PRT_RADIAL_HAT;
    struct radial_functions f = {.n_fit = m + d, .n_function = pieces ? m * (d + 1) : m + d};
    double x[RADIAL_MAX_FUNCTION + 1];
    if (!m || m > RADIAL_MAX_FUNCTION || f.n_function > RADIAL_MAX_FUNCTION) return PRT_LIMIT;
    for (uint32_t k = 0; k <= m; k++) x[k] = radial->pub.r[knot[k]];
    f.fit = prt_calloc((size_t)f.n_fit * ng, sizeof *f.fit);
    if (pieces) {
        f.map = prt_calloc((size_t)f.n_function * f.n_fit, sizeof *f.map);
        f.stored = prt_calloc((size_t)f.n_function * ng, sizeof *f.stored);
    }
    if (!f.fit || (pieces && (!f.map || !f.stored))) {
        prt_radial_functions_finish(&f);
        return PRT_NOMEM;
    }
    fill_splines(radial, m, knot, x, f.fit);
    if (pieces) fill_pieces(radial, m, knot, x, &f);
    *out = f;
    return PRT_OK;
}
