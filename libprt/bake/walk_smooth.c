// SPDX-License-Identifier: MIT
// Noise of walks is taken out by what is known of a cluster's vertices before a walk is taken:
// the dipole's answers D, without noise, times an unknown factor near 1 that changes slowly
// over position and normal. Answers of vertices then have the covariance
//     C_vw = (D D^T)_vw [1 + a exp(-|x_v - x_w|^2 / 2 l^2 - (1 - n_v.n_w) / 4)]
// and with the variances N of the walks' means the best linear estimate of the transport is
// M K, M = C (C + N)^-1 (Gaussian processes; METHODS §9). a and l are those with which one half
// of the walks predicts the other best. Where a vertex differs from what its neighbours say by
// a factor that all lights agree on, and by more than noise explains, it keeps its factor:
// creases are finer than l.
#include "bake/walks.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CANDIDATES = 6, PREDICTED = 48 }; // pairs (l, a); lights of the choice
static const struct {
    double length, amount; // l in diagonals of the cluster's box
} candidate[CANDIDATES] = {{0.5, 0.1}, {0.25, 0.1}, {1, 0.1},
                           {0.5, 0.4}, {0.5, 0.02}, {0.12, 0.1}};

enum { JUDGED = 3 }; // channels that the choice reads

struct smoother {
    uint32_t n, m, n_channel;
    const float *like; // [CANDIDATES][n][n]
    double *dipole;    // [n_channel][n][n] C of the dipole
    double *variance;  // [n_channel][n] of the mean of all walks, a light
    double *c, *a;     // [n][n] scratch: covariance, with noise
};

// Places [n][6] of a cluster's vertices, position [mm] and normal; returns the squared diagonal
// of their box.
static double fill_places(const struct bake *b, const struct prt_cluster *cluster,
                          double (*place)[6])
{
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    double diagonal2 = 0;
    for (uint32_t v = 0; v < cluster->n_vertex; v++) {
        const uint32_t at = b->clusters->order[cluster->vertex_begin + v];
        for (int k = 0; k < 3; k++) {
            const double x = (double)b->mesh->position[at][k];
            place[v][k] = x;
            place[v][3 + k] = (double)b->mesh->normal[at][k];
            low[k] = fmin(low[k], x), high[k] = fmax(high[k], x);
        }
    }
    for (int k = 0; k < 3; k++) diagonal2 += (high[k] - low[k]) * (high[k] - low[k]);
    return diagonal2;
}

float *prt_walk_likeness(const struct bake *b, uint32_t c)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    const size_t n = cluster->n_vertex;
    double(*place)[6] = prt_alloc(n, sizeof *place);
    float *like = place ? prt_alloc(CANDIDATES * n * n, sizeof *like) : NULL;
    const double diagonal2 = like ? fill_places(b, cluster, place) : 0;
    for (size_t i = 0; like && i < CANDIDATES; i++) {
        const double length = candidate[i].length, scale = 2 * length * length * diagonal2;
        for (size_t v = 0; v < n; v++)
            for (size_t w = 0; w < n; w++) {
                const double *p = place[v], *q = place[w];
                double d2 = 0, cosine = 0;
                for (int k = 0; k < 3; k++)
                    d2 += (p[k] - q[k]) * (p[k] - q[k]), cosine += p[3 + k] * q[3 + k];
                like[(i * n + v) * n + w] =
                    scale > 0 ? expf((float)(-d2 / scale - (1 - cosine) / 4)) : 1;
            }
    }
    prt_free(place);
    return like;
}

// The mean product of two vertices' answers over the lights.
static int fill_dipole(const float *dipole, struct smoother *s)
{
    const size_t n = s->n, m = s->m;
    double *y = prt_alloc(n * m, sizeof *y);
    if (!y) return PRT_NOMEM;
    for (size_t ch = 0; ch < s->n_channel; ch++) {
        for (size_t i = 0; i < n * m; i++) y[i] = (double)dipole[ch * n * m + i];
        cblas_dgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)n, (int)n, (int)m,
                    1 / (double)m, y, (int)m, y, (int)m, 0, s->dipole + ch * n * n, (int)n);
    }
    prt_free(y);
    return PRT_OK;
}

// From the difference of the halves, a walk's variance; half of it is the cluster's mean.
static void fill_variance(const struct walk_answers *w, struct smoother *s)
{
    for (size_t ch = 0; ch < s->n_channel; ch++) {
        double *own = s->variance + ch * s->n, mean = 0;
        for (size_t v = 0; v < s->n; v++) {
            const size_t at = (ch * s->n + v) * s->m;
            double sum = 0;
            for (size_t i = 0; i < s->m; i++) {
                const double d = (double)w->half[0][at + i] - (double)w->half[1][at + i];
                sum += d * d;
            }
            own[v] = sum / (4 * (double)s->m) * w->n_walk[ch * s->n + v];
            mean += own[v] / (double)s->n;
        }
        for (size_t v = 0; v < s->n; v++)
            own[v] = 0.5 * (own[v] + mean) / w->n_walk[ch * s->n + v];
    }
}

// C of a channel into s->c, and C + times N into s->a, factored.
static int factor(struct smoother *s, size_t ch, unsigned which, double times)
{
    const size_t n = s->n;
    const double *dipole = s->dipole + ch * n * n, *variance = s->variance + ch * n;
    const float *like = s->like + which * n * n;
    const double amount = candidate[which].amount;
    double trace = 0;
    for (size_t i = 0; i < n * n; i++) s->c[i] = dipole[i] * (1 + amount * (double)like[i]);
    memcpy(s->a, s->c, n * n * sizeof *s->a);
    for (size_t v = 0; v < n; v++) trace += s->c[v * n + v] / (double)n;
    for (size_t v = 0; v < n; v++)
        s->a[v * n + v] += times * variance[v] + 1e-6 * trace + 1e-30;
    return LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', (int)n, s->a, (int)n) ? PRT_INTERNAL : PRT_OK;
}

// The squared difference of one half and what the other predicts for it, over some lights.
static int predict(struct smoother *s, const struct walk_answers *w, size_t ch, double *out)
{
    const size_t n = s->n, m = s->m < PREDICTED ? s->m : PREDICTED;
    double *x = prt_alloc(2 * m * n, sizeof *x), *got = prt_alloc(2 * m * n, sizeof *got);
    int status = x && got ? PRT_OK : PRT_NOMEM;
    if (!status) {
        for (size_t h = 0; h < 2; h++)
            for (size_t i = 0; i < m; i++)
                for (size_t v = 0; v < n; v++)
                    x[(h * m + i) * n + v] = (double)w->half[h][(ch * n + v) * s->m + i];
        if (LAPACKE_dpotrs(LAPACK_COL_MAJOR, 'L', (int)n, (int)(2 * m), s->a, (int)n, x,
                           (int)n))
            status = PRT_INTERNAL;
    }
    if (!status) {
        cblas_dgemm(CblasColMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)(2 * m), (int)n, 1,
                    s->c, (int)n, x, (int)n, 0, got, (int)n);
        for (size_t h = 0; h < 2; h++)
            for (size_t i = 0; i < m; i++)
                for (size_t v = 0; v < n; v++) {
                    const double d =
                        got[(h * m + i) * n + v] - (double)w->half[!h][(ch * n + v) * s->m + i];
                    *out += d * d;
                }
    }
    prt_free(x);
    prt_free(got);
    return status;
}

// The candidate that predicts best over some channels. A half has twice the variance.
static int choose(struct smoother *s, const struct walk_answers *w, unsigned *out)
{
    double best = INFINITY;
    int status = PRT_OK;
    const size_t judged = s->n_channel < JUDGED ? s->n_channel : JUDGED;
    for (unsigned i = 0; i < CANDIDATES && !status; i++) {
        double error = 0;
        for (size_t k = 0; k < judged && !status; k++) {
            const size_t ch = k * s->n_channel / judged;
            status = factor(s, ch, i, 2);
            if (!status) status = predict(s, w, ch, &error);
        }
        if (error < best) best = error, *out = i;
    }
    return status;
}

// The products of a vertex' answers with its smoothed ones, over the square of the latter: by
// either half. *square gets the mean square of the smoothed ones.
static void factor_of(const float *a, const float *b, const float *smooth, size_t m,
                      double ratio[2], double *square)
{
    double sum[2] = {0, 0}, all = 0;
    for (size_t i = 0; i < m; i++) {
        const double x = (double)smooth[i];
        sum[0] += (double)a[i] * x;
        sum[1] += (double)b[i] * x;
        all += x * x;
    }
    *square = all / (double)m;
    for (int k = 0; k < 2; k++) ratio[k] = all > 0 ? sum[k] / all : 1;
}

// Adds a channel's factors that stand out of the noise to the vertices' mean over channels,
// gain[v] / weight[v], by energy. A factor's variance is that of the vertex' mean, times what
// the halves' factors of the whole cluster say about it.
static void keep_factors(const struct smoother *s, const struct walk_answers *w, size_t ch,
                         const float *smooth, double *gain, double *weight, double noise[2])
{
    const size_t n = s->n, m = s->m;
    const double *variance = s->variance + ch * n;
    double seen = 0, expected = 0;
    for (unsigned pass = 0; pass < 2; pass++)
        for (size_t v = 0; v < n; v++) {
            const size_t at = (ch * n + v) * m;
            double ratio[2], square;
            factor_of(w->half[0] + at, w->half[1] + at, smooth + v * m, m, ratio, &square);
            if (!(square > 0)) continue;
            if (!pass) {
                seen += (ratio[0] - ratio[1]) * (ratio[0] - ratio[1]) / 4;
                expected += variance[v] / square;
                continue;
            }
            const double off = (ratio[0] + ratio[1]) / 2 - 1;
            const double own = expected > 0 ? seen / expected * variance[v] / square : 0;
            const double sure = off * off > 4 * own ? 1 - 4 * own / (off * off) : 0;
            gain[v] += square * fmax(1 + sure * off, 0);
            weight[v] += square;
            noise[0] += sure * sure * own * square * (double)m;
        }
}

// M of a channel, and the energies of M (half 0 - half 1)/2 and of M times the mean.
static int finish(struct smoother *s, const struct walk_answers *w, size_t ch, float *out,
                  double *gain, double *weight, double noise[2])
{
    const size_t n = s->n, m = s->m;
    float *y = prt_alloc(4 * n * m, sizeof *y), *difference = y + n * m,
          *smooth = y + 2 * n * m;
    if (!y) return PRT_NOMEM;
    // M is the transpose of A^-1 C; by columns, that is M by rows.
    if (LAPACKE_dpotrs(LAPACK_COL_MAJOR, 'L', (int)n, (int)n, s->a, (int)n, s->c, (int)n)) {
        prt_free(y);
        return PRT_INTERNAL;
    }
    for (size_t i = 0; i < n * n; i++) out[i] = (float)s->c[i];
    for (size_t i = 0; i < n * m; i++) {
        const float a = w->half[0][ch * n * m + i], b = w->half[1][ch * n * m + i];
        y[i] = 0.5f * (a + b), difference[i] = 0.5f * (a - b);
    }
    for (unsigned k = 0; k < 2; k++)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)n, 1, out,
                    (int)n, y + k * n * m, (int)m, 0, smooth + k * n * m, (int)m);
    for (size_t i = 0; i < n * m; i++) {
        noise[0] += (double)smooth[n * m + i] * (double)smooth[n * m + i];
        noise[1] += (double)smooth[i] * (double)smooth[i];
    }
    keep_factors(s, w, ch, smooth, gain, weight, noise);
    prt_free(y);
    return PRT_OK;
}

int prt_walks_smooth(const struct bake *b, const float *like, const float *dipole,
                     const struct walk_answers *walks, float **out, float *factor_of_vertex,
                     double noise[2])
{
    const size_t n = walks->n_vertex, n_channel = walks->n_channel;
    struct smoother s = {
        .n = walks->n_vertex, .m = walks->n_light, .n_channel = walks->n_channel, .like = like};
    unsigned best = 0;
    float *made = prt_alloc(n_channel * n * n, sizeof *made);
    s.dipole = prt_alloc(n_channel * n * n, sizeof *s.dipole);
    s.variance = prt_alloc(n_channel * n, sizeof *s.variance);
    s.c = prt_alloc(n * n, sizeof *s.c);
    s.a = prt_alloc(n * n, sizeof *s.a);
    double *gain = prt_calloc(2 * n, sizeof *gain), *weight = gain + n;
    int status = made && s.dipole && s.variance && s.c && s.a && gain ? PRT_OK : PRT_NOMEM;
    if (!status) status = fill_dipole(dipole, &s);
    if (!status) {
        fill_variance(walks, &s);
        status = choose(&s, walks, &best);
    }
    noise[0] = noise[1] = 0;
    for (size_t ch = 0; ch < n_channel && !status; ch++) {
        status = factor(&s, ch, best, 1);
        if (!status) status = finish(&s, walks, ch, made + ch * n * n, gain, weight, noise);
    }
    for (size_t v = 0; v < n && !status; v++)
        factor_of_vertex[v] = weight[v] > 0 ? (float)(gain[v] / weight[v]) : 1;
    prt_free(gain);
    prt_free(s.dipole);
    prt_free(s.variance);
    prt_free(s.c);
    prt_free(s.a);
    if (status) prt_free(made);
    else *out = made;
    return status == PRT_INTERNAL
               ? prt_fail(b->ctx, status,
                          "the walks of a cluster of %u vertices could not be "
                          "smoothed: LAPACK found no factors",
                          walks->n_vertex)
               : status;
}
