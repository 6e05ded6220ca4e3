// SPDX-License-Identifier: MIT
// Checks of a bake's settings, and the memory that a bake needs.
#include "bake/run.h"
#include "prt/bake_limits.h"

#include <math.h>

int prt_bake_check_settings(const struct prt_context *ctx, const struct prt_bake_options *o)
{
    const struct {
        enum prt_bake_setting setting;
        uint64_t value;
    } given[] = {{PRT_BAKE_SAMPLES, o->n_sample},
                 {PRT_BAKE_CUBE, o->cube},
                 {PRT_BAKE_COEFFS, o->n_coef},
                 {PRT_BAKE_RANK, o->rank},
                 {PRT_BAKE_BASIS_COEFFS, o->n_basis_coef},
                 {PRT_BAKE_PHASE_TERMS, o->n_phase},
                 {PRT_BAKE_SINGLE_POINTS, o->n_single}};
    char reason[128];
    for (size_t i = 0; i < sizeof given / sizeof *given; i++)
        if (!prt_bake_setting_ok(given[i].setting, given[i].value, reason))
            return prt_fail(ctx, PRT_ARG, "--%s", reason);
    if (!prt_bake_error_ok(o->max_error, reason)) return prt_fail(ctx, PRT_ARG, "--%s", reason);
    return PRT_OK;
}

void prt_bake_drop_line(void *user, enum prt_log_level level, const char *line)
{
}

// An upper bound, without the memory of libraries, of the rows of pass 1 (samples and half as
// many nodes), the factors of all clusters, the dense rows of one cluster for each thread, and
// the mesh with its scene.
int prt_bake_memory(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    const struct prt_bake_options *options, uint64_t *bytes)
{
    struct prt_context quiet = ctx ? *ctx : (struct prt_context){0};
    struct bake b = {.ctx = &quiet, .mesh = mesh, .o = *options};
    int status = prt_bake_check_settings(ctx, options);
    if (status) return status;
    if (!b.o.cube) b.o.cube = PRT_BAKE_CUBE_DEFAULT;
    prt_material_dipoles(&b.o.material, b.dipole);
    quiet.log = prt_bake_drop_line;
    bool joint = b.o.engine == PRT_TRANSPORT_JOINT;
    double coef = 6.0 * b.o.cube * b.o.cube, samples = prt_bake_sample_count(&b);
    double vertices = mesh->n_vertex, threads = prt_pool_size(ctx ? ctx->pool : NULL);
    double clusters = fmax(vertices / (joint ? 256 : 128) + 1, joint ? 320 : 640);
    clusters = fmin(clusters, vertices / 4 + 1);
    double functions = joint ? 16 : 3.0 * (b.o.n_phase ? b.o.n_phase : 4);
    double rank = b.o.rank ? b.o.rank : 72, of_cluster = 4 * vertices / clusters + 16;
    double factors = clusters * fmin(rank, of_cluster) * functions * coef * 1.25;
    double scratch = threads * (of_cluster * functions * coef * 8 + 256e6);
    // Polynomial transport has one light, and stores no coefficients of it.
    if (b.o.engine == PRT_TRANSPORT_POLYNOMIAL) factors = 0;
    double rows = samples * 1.5 * coef * 2;
    if (rows > (double)prt_half_rows_room()) rows = 0; // they are on disk
    double model = vertices * 4000 + (double)mesh->n_triangle * 1200;
    *bytes = (uint64_t)(rows + samples * 400 + factors + scratch + model);
    return PRT_OK;
}
