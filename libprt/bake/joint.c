// SPDX-License-Identifier: MIT
// Joint transport (METHODS §5): neither light nor material is contracted. The same stages as
// wavelet transport with a radial basis in place of one medium's R_d, and one U that serves
// training materials over the whole range.
#include "bake/radials.h"
#include "bake/sources.h"

#include <stdlib.h>
#include <string.h>

struct joint {
    struct bake *b;
    struct bases bases;
};

static int multiple_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct joint *job = arg;
    struct bake *b = job->b;
    struct radial_set radial = bases_radial_set(&job->bases);
    int status = PRT_OK;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) continue;
        struct cut cut = {0};
        status = cut_build(b->ctx, b->mesh, b->surface, b->hierarchy, b->clusters, (uint32_t)c,
                           &radial, &cut);
        struct product_rows rows = {&b->irradiance, &cut, b->clusters->cluster[c].n_vertex,
                                    radial.n};
        struct row_source source = {&rows, rows.n_vertex, product_multiply, product_project};
        if (status == PRT_OK) status = bake_take_rows(b, (uint32_t)c, radial.n, &source);
        cut_finish(&cut);
    }
    return status;
}

static int opaque_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct joint *job = arg;
    int status = PRT_OK;
    prt_trace_thread_init();
    uint32_t *block = prt_mesh_vertex_blocks(job->b->mesh);
    if (!block) return PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++)
        if (!job->b->clusters->translucent[c])
            status = bake_opaque_rows(job->b, (uint32_t)c, block);
    prt_free(block);
    return status;
}

static int single_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct joint *job = arg;
    struct bake *b = job->b;
    struct fresnel_table fresnel;
    uint32_t n_coef = b->directions->n_coef;
    uint32_t F = b->o.n_phase * job->bases.extinction->n_function;
    int status = PRT_OK;
    prt_trace_thread_init();
    fresnel_table_init(&fresnel, b->o.material.eta);
    void *scratch = prt_alloc(single_scratch_bytes(&b->single), 1);
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) continue;
        const struct prt_cluster *cluster = &b->clusters->cluster[c];
        float *t = prt_alloc((size_t)cluster->n_vertex * F * n_coef, sizeof *t);
        if (!t || !scratch) status = PRT_NOMEM;
        for (uint32_t i = 0; status == PRT_OK && i < cluster->n_vertex; i++)
            b->rays_single[c] +=
                single_rows(&b->single, &fresnel, b->clusters->order[cluster->vertex_begin + i],
                            t + (size_t)i * F * n_coef, scratch);
        struct dense_rows rows = {t, cluster->n_vertex, F, n_coef};
        struct row_source source = {&rows, cluster->n_vertex, dense_multiply, dense_project};
        if (status == PRT_OK) status = bake_take_rows(b, (uint32_t)c, F, &source);
        prt_free(t);
    }
    prt_free(scratch);
    return status;
}

// The step that made b->out's newest tensor hands `joint` to its loop through here.
static int tensor(struct joint *j, enum prt_term term, const char *stage, prt_loop_fn range,
                  uint32_t n_function, uint32_t n_phase, const struct prt_radial *radial)
{
    struct bake *b = j->b;
    b->train = radial ? j->bases.train : NULL;
    b->n_train = j->bases.n_train;
    b->loop_arg = j;
    int status = bake_tensor(b, term, stage, range, n_function, n_phase,
                             term ? T_SINGLE : T_MULTIPLE);
    b->loop_arg = NULL;
    b->train = NULL;
    if (status || !radial) return status;
    struct prt_tensor *t = &b->out.tensor[b->out.n_tensor - 1];
    t->coupling = PRT_COUPLE_FULL;
    return bases_record(radial, n_phase, t);
}

static int bake_terms(struct joint *j)
{
    struct bake *b = j->b;
    bool opaque = false;
    int status = bases_train_reflectance(b, &j->bases);
    b->n_probe = 64;
    if (status == PRT_OK) status = bake_probe(b, b->n_probe);
    for (uint32_t c = 0; c < b->clusters->n_cluster; c++) opaque |= !b->clusters->translucent[c];
    if (status == PRT_OK)
        status = tensor(j, PRT_TERM_MULTIPLE, "multiple scattering", multiple_range,
                        j->bases.reflectance->n_function, 1, j->bases.reflectance);
    half_rows_finish(&b->irradiance);
    if (status == PRT_OK && opaque)
        status = tensor(j, PRT_TERM_MULTIPLE, "opaque surfaces", opaque_range, 3, 1, NULL);
    if (status || b->o.no_single) return status;
    bake_plan_single(b);
    b->single.extinction = j->bases.integral;
    single_plan_depths(&b->single);
    status = bases_train_extinction(b, &j->bases, b->o.n_phase);
    if (status == PRT_OK)
        status = tensor(j, PRT_TERM_SINGLE, "single scattering", single_range,
                        b->o.n_phase * j->bases.extinction->n_function, b->o.n_phase,
                        j->bases.extinction);
    return status;
}

int bake_joint(struct bake *b)
{
    struct joint j = {.b = b};
    double started = prt_time_s();
    if (!b->surface)
        return prt_fail(b->ctx, PRT_ARG, "nothing is translucent: a joint bake has no material");
    int status = bases_create(b, &j.bases);
    if (status == PRT_OK)
        status = irradiance_bake(b->ctx, b->scene, b->surface, b->hierarchy, b->directions,
                                 b->o.material.eta, &b->irradiance, &b->rays_irradiance);
    b->seconds[T_IRRADIANCE] = prt_time_s() - started;
    if (status == PRT_OK) status = bake_terms(&j);
    bases_finish(&j.bases);
    return status;
}
