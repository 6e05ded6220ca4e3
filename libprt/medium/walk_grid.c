// SPDX-License-Identifier: MIT
// Walks of a free medium are known at a grid of media (METHODS §9, free media). Absorption:
// e^(-sigma_a L) is fitted by e^(-sigma_j L) of the nodes over lengths of paths. Scattering:
// answers divided by the share of light that is scattered twice or more are interpolated by a
// natural cubic spline in ln sigma_s'.
#include "prt/walk_grid.h"

#include <lapacke.h>
#include <math.h>
#include <string.h>

// Lengths of paths over which the nodes are fitted [mm], and 0. Longer ones have been absorbed
// at the least node but 0, or matter at no absorption, which is a node.
enum { N_LENGTH = 160 };
static const double least_length = 1e-2, most_length = 3000;

void prt_walk_grid_default(struct prt_walk_grid *grid)
{
    *grid = (struct prt_walk_grid){.n_level = 13, .n_node = 10};
    for (uint32_t k = 0; k < grid->n_level; k++)
        grid->level[k] = (float)(0.02 * pow(27 / 0.02, k / 12.0));
    // Of ten nodes with this least one the worst error is 0.3 % for exponential lengths of
    // every mean; 8 nodes leave 2.6 %.
    for (uint32_t j = 1; j < grid->n_node; j++)
        grid->node[j] = (float)(0.0034 * pow(2.1 / 0.0034, (j - 1) / 8.0));
}

static bool ascends(const float *x, uint32_t n)
{
    for (uint32_t i = 1; i < n; i++)
        if (!(x[i - 1] < x[i] && x[i] < 1e6f)) return false;
    return true;
}

int prt_walk_grid_from_axes(uint32_t n, const float *axes, struct prt_walk_grid *grid)
{
    uint32_t k = 0;
    while (k < n && k <= PRT_WALK_MOST_LEVELS && axes[k] != 0) k++;
    const uint32_t j = n - k;
    if (k < 4 || k > PRT_WALK_MOST_LEVELS || j < 4 || j > PRT_WALK_MOST_NODES ||
        !(axes[0] >= 1e-6f) || !ascends(axes, k) || !ascends(axes + k, j))
        return PRT_FORMAT;
    *grid = (struct prt_walk_grid){.n_level = k, .n_node = j};
    memcpy(grid->level, axes, k * sizeof *axes);
    memcpy(grid->node, axes + k, j * sizeof *axes);
    return PRT_OK;
}

double prt_walk_share(double sigma_s_prime, double sigma_a)
{
    const double albedo = sigma_s_prime / (sigma_s_prime + sigma_a);
    return albedo * albedo / (1 + 4 * sqrt(1 - albedo));
}

// c_j of the nodes: least squares over the lengths, by QR.
static void fit_nodes(const struct prt_walk_grid *grid, double sigma_a, double *c)
{
    double a[N_LENGTH * PRT_WALK_MOST_NODES], f[N_LENGTH];
    const uint32_t n = grid->n_node;
    memset(c, 0, n * sizeof *c);
    for (uint32_t j = 0; j < n; j++)
        if (sigma_a == (double)grid->node[j]) {
            c[j] = 1;
            return;
        }
    for (uint32_t i = 0; i < N_LENGTH; i++) {
        const double share = (i - 1.0) / (N_LENGTH - 2);
        const double length = i ? least_length * pow(most_length / least_length, share) : 0;
        for (uint32_t j = 0; j < n; j++) a[i * n + j] = exp(-(double)grid->node[j] * length);
        f[i] = exp(-sigma_a * length);
    }
    if (LAPACKE_dgels(LAPACK_ROW_MAJOR, 'N', N_LENGTH, (int)n, 1, a, (int)n, f, 1)) f[0] = 1;
    memcpy(c, f, n * sizeof *c);
}

// Second derivatives of the spline at the levels, as combinations of its values, [n][n].
static void curvatures(uint32_t n, const double *x, double *out)
{
    double a[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_LEVELS] = {0};
    lapack_int pivot[PRT_WALK_MOST_LEVELS];
    memset(out, 0, (size_t)n * n * sizeof *out);
    a[0] = a[n * n - 1] = 1;
    for (uint32_t i = 1; i + 1 < n; i++) {
        const double below = x[i] - x[i - 1], above = x[i + 1] - x[i];
        a[i * n + i - 1] = below / 6;
        a[i * n + i] = (below + above) / 3;
        a[i * n + i + 1] = above / 6;
        out[i * n + i - 1] = 1 / below;
        out[i * n + i] = -1 / below - 1 / above;
        out[i * n + i + 1] = 1 / above;
    }
    LAPACKE_dgesv(LAPACK_ROW_MAJOR, (int)n, (int)n, a, (int)n, pivot, out, (int)n);
}

static void spline_weights(const struct prt_walk_grid *grid, double sigma_s_prime, double *w)
{
    double x[PRT_WALK_MOST_LEVELS], bend[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_LEVELS];
    const uint32_t n = grid->n_level;
    const double at = log(sigma_s_prime);
    uint32_t i = 0;
    for (uint32_t k = 0; k < n; k++) x[k] = log((double)grid->level[k]);
    curvatures(n, x, bend);
    while (i + 2 < n && at > x[i + 1]) i++;
    const double h = x[i + 1] - x[i], a = (x[i + 1] - at) / h, b = 1 - a;
    for (uint32_t k = 0; k < n; k++)
        w[k] = (k == i ? a : 0) + (k == i + 1 ? b : 0) +
               ((a * a * a - a) * bend[i * n + k] + (b * b * b - b) * bend[(i + 1) * n + k]) *
                   h * h / 6;
}

// Light that the levels' weights misplace between radii of the dipole's profiles: integral of
// |dR| 2 pi r dr over that of R. Less than a hundredth of the light counts as a hundredth.
static double level_error(const struct prt_walk_grid *grid, double eta, double sigma_s_prime,
                          double sigma_a, const double *w)
{
    enum { RADII = 40 };
    struct prt_diffusion want, at[PRT_WALK_MOST_LEVELS];
    double wrong = 0;
    const double step = log(8000) / (RADII - 1);
    prt_diffusion_init(&want, sigma_s_prime, sigma_a, eta);
    for (uint32_t k = 0; k < grid->n_level; k++)
        prt_diffusion_init(&at[k], (double)grid->level[k], sigma_a, eta);
    for (int i = 0; i < RADII; i++) {
        const double r = 0.01 * exp(step * i);
        double sum = -prt_diffusion_rd(&want, r);
        for (uint32_t k = 0; k < grid->n_level; k++) sum += w[k] * prt_diffusion_rd(&at[k], r);
        wrong += fabs(sum) * 2 * M_PI * r * r * step;
    }
    return wrong / (want.rho_d + 0.01);
}

// The worst relative error of the nodes' weights over exponential distributions of lengths.
static double node_error(const struct prt_walk_grid *grid, double sigma_a, const double *c)
{
    double worst = 0;
    for (double mean = 0.5; mean < 200; mean *= 1.6) {
        const double want = 1 / (1 + sigma_a * mean);
        double got = 0;
        for (uint32_t j = 0; j < grid->n_node; j++)
            got += c[j] / (1 + (double)grid->node[j] * mean);
        worst = fmax(worst, fabs(got - want) / (want + 0.01));
    }
    return worst;
}

void prt_walk_grid_weights(const struct prt_walk_grid *grid, double eta, double sigma_s_prime,
                           double sigma_a, double *weight, double *error)
{
    double level[PRT_WALK_MOST_LEVELS], node[PRT_WALK_MOST_NODES];
    const uint32_t n_level = grid->n_level, n_node = grid->n_node;
    const double least = (double)grid->level[0], most = (double)grid->level[n_level - 1];
    const double s = fmin(fmax(sigma_s_prime, least), most);
    const double a = fmin(fmax(sigma_a, 0), (double)grid->node[n_node - 1]);
    spline_weights(grid, s, level);
    fit_nodes(grid, a, node);
    for (uint32_t k = 0; k < n_level; k++)
        level[k] *= prt_walk_share(s, a) / prt_walk_share((double)grid->level[k], a);
    for (uint32_t k = 0; k < n_level; k++)
        for (uint32_t j = 0; j < n_node; j++) weight[k * n_node + j] = level[k] * node[j];
    if (!error) return;
    *error =
        level_error(grid, eta, sigma_s_prime, sigma_a, level) + node_error(grid, sigma_a, node);
}
