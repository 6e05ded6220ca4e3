// SPDX-License-Identifier: MIT
// Multiple and unscattered light at a vertex by random walks in place of the dipole (METHODS
// §9): B = (1/N) sum over walks of e^(-sigma_a L) E(exit), with E of the sample in whose
// stratum the exit lies.
#include "reference/reference_private.h"

#include <math.h>
#include <string.h>

// Sums over the walks of one vertex in one channel.
struct gather {
    const struct job *j;
    unsigned channel;
    double sigma_a;
    bool multiple, unscattered; // which of them the standard error is of
    double sum[PRT_REFERENCE_MAX_MANY][2], square[PRT_REFERENCE_MAX_MANY];
};

static void gather_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct gather *g = arg;
    const struct job *j = g->j;
    if (exit->scatterings == 1) return; // single scattering has an integral of its own
    uint32_t sample = prt_surface_stratum(j->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX) return;
    bool unscattered = exit->scatterings == 0;
    double weight = exp(-g->sigma_a * (double)exit->length_mm);
    size_t n = j->surface->n_sample;
    const float *e = j->irradiance + g->channel * n + sample;
    for (unsigned l = 0; l < j->n_light; l++, e += 3 * n) {
        double x = weight * (double)*e;
        g->sum[l][unscattered] += x;
        if (unscattered ? g->unscattered : g->multiple) g->square[l] += x * x;
    }
}

int prt_reference_walk_prepare(struct job *j)
{
    int status = prt_walk_space_create(j->ctx, j->scene, &j->space);
    if (!status) status = prt_surface_strata_create(j->ctx, j->mesh, j->surface, &j->strata);
    return status;
}

void prt_reference_walk(struct job *j, const struct prt_material *material, uint32_t v,
                        struct walk_light *out)
{
    struct gather g = {.j = j,
                       .multiple = j->o->term != PRT_REFERENCE_UNSCATTERED,
                       .unscattered = j->o->term != PRT_REFERENCE_MULTIPLE};
    struct prt_walk_start start;
    struct prt_walk_counts counts = {0};
    double n = j->o->n_walk;
    for (unsigned c = 0; c < 3; c++) {
        struct prt_walk_medium medium = {material->sigma_s_prime[c], material->eta, 0};
        g.channel = c;
        g.sigma_a = (double)material->sigma_a[c];
        memset(g.sum, 0, sizeof g.sum);
        memset(g.square, 0, sizeof g.square);
        prt_walk_start_at(j->space, v, j->mesh->block[j->vertex_block[v]].object,
                          prt_hash64(&v, sizeof v, j->o->seed + 17 + c), &start);
        prt_walk_run(j->space, &start, &medium, j->o->n_walk, gather_exit, &g, &counts);
        for (unsigned l = 0; l < j->n_light; l++) {
            double mean = (g.multiple * g.sum[l][0] + g.unscattered * g.sum[l][1]) / n;
            out[l].multiple[c] = g.sum[l][0] / n / M_PI;
            out[l].unscattered[c] = g.sum[l][1] / n / M_PI;
            out[l].error[c] = sqrt(fmax(g.square[l] / n - mean * mean, 0) / n) / M_PI;
        }
    }
    __atomic_fetch_add(&j->tally->walks, counts.walks, __ATOMIC_RELAXED);
    __atomic_fetch_add(&j->tally->lost, counts.leaked + counts.cut, __ATOMIC_RELAXED);
}
