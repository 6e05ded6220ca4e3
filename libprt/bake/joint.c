// SPDX-License-Identifier: MIT
// Joint transport (METHODS §5): light and material are both free. The stages are those of
// wavelet transport with a radial basis in place of one medium's R_d, and one U serves training
// materials over the whole range.
#include "bake/checkpoint.h"
#include "bake/free_walks.h"
#include "bake/shard.h"
#include "bake/sources.h"
#include "bake/view_fit.h"

#include <stdlib.h>
#include <string.h>

struct joint {
    struct bake *b;
    struct bases bases;
    struct walk_pool pool; // of a bake by walks
};

// Rows of a cluster by walks; with holes, by the dipole as a combination of the same functions.
static int take_walks(const struct tensor_job *job, uint32_t c, struct product_rows *product)
{
    const struct bake *b = job->bake;
    const struct joint *j = job->user;
    struct walk_rows rows = {
        .pool = &j->pool, .product = product, .medium = prt_bake_medium(b, c)};
    const struct free_walks_job walk = {b,         &j->pool, product->cut,    job->lit,
                                        job->work, c,        b->walk->n_walk, true};
    const struct row_source source = {&rows, product->n_vertex, prt_walk_rows_multiply, NULL,
                                      prt_walk_rows_combine};
    int status = prt_walks_in(b, c) ? prt_free_walks_run(&walk, &rows.walks) : PRT_OK;
    memcpy(b->walk->noise[c], rows.walks.noise, sizeof rows.walks.noise);
    if (!status) status = prt_bake_take_rows(job, c, &source);
    prt_free_walks_finish(&rows.walks);
    return status;
}

static int multiple_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    const struct bake *b = job->bake;
    const struct joint *j = job->user;
    struct radial_set radial = prt_bases_radial_set(&j->bases);
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) continue;
        struct cut cut = {0};
        uint64_t started = prt_work_begin();
        const struct cut_source from = prt_bake_cut_source(b);
        status = prt_cut_build(b->ctx, &from, (uint32_t)c, &radial, &cut);
        prt_work_end(job->work, WORK_KERNEL, started, 0, 0);
        struct product_rows rows = {&b->irradiance,
                                    &cut,
                                    b->clusters->cluster[c].n_vertex,
                                    b->walk ? radial.n : job->n_function,
                                    job->lit,
                                    job->work,
                                    NULL};
        struct row_source source = {&rows, rows.n_vertex, prt_product_multiply,
                                    prt_product_project, prt_product_combine};
        if (status == PRT_OK)
            status = b->walk ? take_walks(job, (uint32_t)c, &rows)
                             : prt_bake_take_rows(job, (uint32_t)c, &source);
        prt_cut_finish(&cut);
    }
    return status;
}

static int opaque_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    int status = PRT_OK;
    prt_trace_thread_init();
    uint32_t *block = prt_mesh_vertex_blocks(job->bake->mesh);
    if (!block) return PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++)
        if (!job->bake->clusters->translucent[c])
            status = prt_bake_opaque_rows(job, (uint32_t)c, block);
    prt_free(block);
    return status;
}

// Makes the last tensor one over a radial basis.
static int record_basis(struct bake *b, const struct prt_radial *radial, uint32_t n_phase)
{
    struct prt_tensor *t = &b->out.tensor[b->out.n_tensor - 1];
    t->coupling = PRT_COUPLE_FULL;
    const int status = prt_bases_record(radial, n_phase, t);
    return status ? status : prt_bases_record_eta(b, t);
}

// A tensor over a radial basis: every light and every training medium is served.
static int radial_tensor(struct tensor_job *job, const struct prt_radial *radial)
{
    int status = prt_bake_tensor(job);
    return status ? status : record_basis(job->bake, radial, job->n_phase);
}

static uint32_t eta_nodes(const struct bake *b, enum prt_radial_family family)
{
    struct prt_eta_nodes nodes;
    return prt_bake_eta_nodes(b, family, &nodes) ? nodes.n : 1;
}

static int bake_multiple(struct joint *j, const struct probes *probes)
{
    const uint32_t layers = eta_nodes(j->b, PRT_FAMILY_DIPOLE);
    struct tensor_job job = {.bake = j->b,
                             .term = PRT_TERM_MULTIPLE,
                             .stage = "multiple scattering",
                             .range = multiple_range,
                             .n_function = layers * j->bases.reflectance->n_function,
                             .n_phase = 1,
                             .probes = probes,
                             .training = j->bases.training,
                             .user = j};
    int status = j->b->walk ? prt_walk_pool_train(&j->pool, &j->bases)
                            : prt_bases_train_reflectance(j->b, &j->bases);
    if (status) return status;
    job.n_training = j->bases.n_training;
    if (!j->b->walk) return radial_tensor(&job, j->bases.reflectance);
    job.n_function = j->pool.n_function;
    status = prt_bake_tensor(&job);
    if (status) return status;
    struct prt_tensor *t = &j->b->out.tensor[j->b->out.n_tensor - 1];
    t->coupling = PRT_COUPLE_FULL;
    return prt_walk_pool_record(&j->pool, t);
}

// Light that crosses without a scattering: by the extinction's functions of the path.
static int bake_unscattered(struct joint *j, const struct probes *probes)
{
    struct tensor_job job = {.bake = j->b,
                             .term = PRT_TERM_UNSCATTERED,
                             .stage = "unscattered light",
                             .range = prt_bake_free_unscattered_range,
                             .n_function = j->bases.extinction->n_function,
                             .n_phase = 1,
                             .probes = probes,
                             .training = j->bases.training,
                             .n_training = 1,
                             .user = j->bases.extinction};
    int status = prt_bases_train_extinction(j->b, &j->bases, 1);
    return status ? status : radial_tensor(&job, j->bases.extinction);
}

// Opaque clusters in a tensor of three channels, which no material multiplies.
static int bake_opaque(struct bake *b)
{
    struct probes probes = {0};
    struct tensor_job job = prt_bake_channels(b, "opaque surfaces", opaque_range, &probes);
    int status = prt_probes_create(b, OPAQUE_PROBES, &probes);
    if (status == PRT_OK) status = prt_bake_tensor(&job);
    prt_probes_finish(&probes);
    return status;
}

static int bake_single(struct joint *j, const struct probes *probes)
{
    struct bake *b = j->b;
    const uint32_t layers = eta_nodes(b, PRT_FAMILY_EXTINCTION);
    struct tensor_job job = {.bake = b,
                             .term = PRT_TERM_SINGLE,
                             .stage = "single scattering",
                             .range = prt_bake_single_range,
                             .n_function =
                                 b->o.n_phase * layers * j->bases.extinction->n_function,
                             .n_phase = b->o.n_phase,
                             .probes = probes,
                             .training = j->bases.training,
                             .n_training = 1};
    int status = prt_bake_plan_single(b, j->bases.integral, 0);
    if (!status) status = prt_bases_train_extinction(b, &j->bases, b->o.n_phase);
    if (!status && b->o.draft) {
        status = prt_bake_draft_single(&job, j->bases.integral);
        if (!status) status = record_basis(b, j->bases.extinction, job.n_phase);
    } else if (!status) {
        status = radial_tensor(&job, j->bases.extinction);
    }
    if (status || !prt_bake_has_view(b)) return status;
    status = prt_bases_train_extinction(b, &j->bases, VIEW_PLANES);
    if (!status) status = prt_bake_view(b, j->bases.integral, probes, j->bases.training, 1);
    return status ? status : record_basis(b, j->bases.extinction, VIEW_PLANES);
}

static int bake_terms(struct joint *j)
{
    struct bake *b = j->b;
    struct probes probes = {0};
    bool opaque = false;
    for (uint32_t c = 0; c < b->clusters->n_cluster; c++)
        opaque |= !b->clusters->translucent[c];
    int status = prt_probes_create(b, JOINT_PROBES, &probes);
    if (status == PRT_OK && b->walk) status = prt_walk_pool_create(b, &j->bases, &j->pool);
    if (status == PRT_OK) status = bake_multiple(j, &probes);
    if (status == PRT_OK && b->walk) status = bake_unscattered(j, &probes);
    prt_half_rows_finish(&b->irradiance);
    if (status == PRT_OK && opaque) status = bake_opaque(b);
    if (status == PRT_OK && !b->o.no_single) status = bake_single(j, &probes);
    prt_probes_finish(&probes);
    return status;
}

int prt_bake_joint(struct bake *b)
{
    struct joint j = {.b = b};
    if (!b->surface)
        return prt_fail(b->ctx, PRT_ARG,
                        "nothing is translucent: a joint bake has no material");
    int status = prt_bases_create(b, &j.bases);
    if (status == PRT_OK) status = prt_bake_irradiance(b);
    if (status == PRT_OK) status = bake_terms(&j);
    prt_bases_finish(&j.bases);
    prt_walk_pool_finish(&j.pool);
    return status;
}
