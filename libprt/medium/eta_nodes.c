// SPDX-License-Identifier: MIT
// Weights of transport at nodes of eta (METHODS §5, any index). Multiple scattering depends on
// eta through F_t alone; single scattering also through the path's length below the exit.
#include "prt/eta_nodes.h"

#include <lapacke.h>
#include <math.h>
#include <string.h>

// Two nodes leave 0.09 % of F_t (root mean square over the hemisphere, the worst eta); three
// leave 0.07 % of the light after a path, where two would leave 1.4 %.
static const struct prt_eta_nodes nodes_of[] = {
    [PRT_FAMILY_DIPOLE] = {2, 1.2f, 1.6f, {1.23f, 1.55f}},
    [PRT_FAMILY_EXTINCTION] = {3, 1.2f, 1.6f, {1.22f, 1.38f, 1.57f}},
};

void prt_eta_nodes_default(enum prt_radial_family family, struct prt_eta_nodes *out)
{
    *out = nodes_of[family];
}

int prt_eta_nodes_from_axis(uint32_t n, const float *axis, struct prt_eta_nodes *out)
{
    static const float least_gap = 0.01f; // nodes that are closer have no stable weights
    if (n < 3 || n > 2 + PRT_ETA_MOST_NODES) return PRT_FORMAT;
    for (uint32_t i = 0; i < n; i++)
        if (!(axis[i] >= 1 && axis[i] <= 3) || (i > 2 && !(axis[i] >= axis[i - 1] + least_gap)))
            return PRT_FORMAT;
    if (axis[1] < axis[0]) return PRT_FORMAT;
    *out = (struct prt_eta_nodes){.n = n - 2, .low = axis[0], .high = axis[1]};
    memcpy(out->node, axis + 2, (n - 2) * sizeof *axis);
    return PRT_OK;
}

// Light that enters at cosine mu and has depths of [0, 5.5] mean free paths below a flat exit:
// F_t(eta, mu) e^(-depth / mu'). Points of mu = t^2 with their weights 2 mu dmu.
enum { ANGLES = 48, DEPTHS = 9, MOST_POINTS = ANGLES * DEPTHS };

struct family {
    uint32_t n_depth;
    double depth[DEPTHS]; // mean free paths
};

static struct family family_of(enum prt_radial_family family)
{
    struct family f = {1, {0}};
    if (family == PRT_FAMILY_DIPOLE) return f;
    f.n_depth = DEPTHS;
    for (int i = 1; i < DEPTHS; i++) f.depth[i] = 0.05 * pow(1.96, i - 1);
    return f;
}

static double weight_of(int i)
{
    const double t = (i + 0.5) / ANGLES;
    return 4 * t * t * t / ANGLES;
}

// [n_depth][ANGLES]
static void entering(const struct family *f, double eta, double *out)
{
    for (int i = 0; i < ANGLES; i++) {
        const double t = (i + 0.5) / ANGLES, mu = t * t;
        const double inside = sqrt(1 - (1 - mu * mu) / (eta * eta) + 1e-20);
        const double transmitted = prt_fresnel_transmittance(eta, mu);
        for (uint32_t k = 0; k < f->n_depth; k++)
            out[k * ANGLES + (uint32_t)i] = transmitted * exp(-f->depth[k] / inside);
    }
}

// Normal equations of the weights, every depth with relative errors; a dipole's weights keep
// the mean of F_t, so that light under an even sky is exact: one more row and column.
struct normal {
    lapack_int n;
    double a[(PRT_ETA_MOST_NODES + 1) * (PRT_ETA_MOST_NODES + 1)], b[PRT_ETA_MOST_NODES + 1];
};

static struct normal equations(const struct family *f, uint32_t n_node,
                               const double (*node)[MOST_POINTS], const double *want)
{
    struct normal e = {.n = (lapack_int)n_node + (f->n_depth == 1)};
    const uint32_t n = (uint32_t)e.n;
    for (uint32_t k = 0; k < f->n_depth; k++) {
        double energy = 1e-300;
        for (int i = 0; i < ANGLES; i++) energy += weight_of(i) * pow(want[k * ANGLES + i], 2);
        for (uint32_t i = 0; i < ANGLES; i++) {
            const uint32_t at = k * ANGLES + i;
            const double w = weight_of((int)i) / energy;
            for (uint32_t p = 0; p < n_node; p++) {
                for (uint32_t q = 0; q < n_node; q++)
                    e.a[p * n + q] += w * node[p][at] * node[q][at];
                e.b[p] += w * node[p][at] * want[at];
                if (n == n_node) continue;
                e.a[p * n + n_node] += w * node[p][at];
                e.a[n_node * n + p] += w * node[p][at];
            }
            if (n > n_node) e.b[n_node] += w * want[at];
        }
    }
    return e;
}

// The worst depth's misplaced light, of what there is.
static double misplaced(const struct family *f, uint32_t n_node,
                        const double (*node)[MOST_POINTS], const double *want,
                        const double *weight)
{
    double worst = 0;
    for (uint32_t k = 0; k < f->n_depth; k++) {
        double wrong = 0, all = 1e-300;
        for (uint32_t i = 0; i < ANGLES; i++) {
            double sum = -want[k * ANGLES + i];
            for (uint32_t p = 0; p < n_node; p++) sum += weight[p] * node[p][k * ANGLES + i];
            wrong += weight_of((int)i) * fabs(sum);
            all += weight_of((int)i) * want[k * ANGLES + i];
        }
        worst = fmax(worst, wrong / all);
    }
    return worst;
}

int prt_eta_weights(enum prt_radial_family family, const struct prt_eta_nodes *nodes,
                    double eta, double *weight, double *error)
{
    double node[PRT_ETA_MOST_NODES][MOST_POINTS], want[MOST_POINTS];
    lapack_int pivot[PRT_ETA_MOST_NODES + 1];
    const struct family f = family_of(family);
    for (uint32_t p = 0; p < nodes->n; p++) entering(&f, (double)nodes->node[p], node[p]);
    entering(&f, eta, want);
    struct normal e = equations(&f, nodes->n, (const double(*)[MOST_POINTS])node, want);
    if (LAPACKE_dgesv(LAPACK_ROW_MAJOR, e.n, 1, e.a, e.n, pivot, e.b, 1)) return PRT_INTERNAL;
    for (uint32_t p = 0; p < nodes->n; p++)
        if (!(fabs(e.b[p]) < 1e3)) return PRT_INTERNAL;
    memcpy(weight, e.b, nodes->n * sizeof *weight);
    if (error)
        *error = misplaced(&f, nodes->n, (const double(*)[MOST_POINTS])node, want, weight);
    return PRT_OK;
}
