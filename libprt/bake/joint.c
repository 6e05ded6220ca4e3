// SPDX-License-Identifier: MIT
// Joint transport (METHODS §5): neither light nor material is contracted. The same stages as
// wavelet transport with a radial basis in place of one medium's R_d, and one U that serves
// training materials over the whole range.
#include "bake/radials.h"
#include "bake/shard.h"
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
        struct row_source source = {&rows, rows.n_vertex, product_multiply, product_project,
                                    product_blend};
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

// Hands `joint` to the loops of multiple scattering; single scattering's want the bake alone.
static int tensor(struct joint *j, enum prt_term term, const char *stage, prt_loop_fn range,
                  uint32_t n_function, uint32_t n_phase, const struct prt_radial *radial)
{
    struct bake *b = j->b;
    b->train = radial ? j->bases.train : NULL;
    b->n_train = j->bases.n_train;
    b->loop_arg = term == PRT_TERM_MULTIPLE ? j : NULL;
    int status =
        bake_tensor(b, term, stage, range, n_function, n_phase, term ? T_SINGLE : T_MULTIPLE);
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
    b->n_probe = JOINT_PROBES;
    if (status == PRT_OK) status = bake_probe(b, b->n_probe);
    for (uint32_t c = 0; c < b->clusters->n_cluster; c++)
        opaque |= !b->clusters->translucent[c];
    if (status == PRT_OK)
        status = tensor(j, PRT_TERM_MULTIPLE, "multiple scattering", multiple_range,
                        j->bases.reflectance->n_function, 1, j->bases.reflectance);
    half_rows_finish(&b->irradiance);
    if (status == PRT_OK && opaque) { // shadows need more columns than what scatters
        prt_free(b->probe);
        b->n_probe = DEFAULT_PROBES;
        status = bake_probe(b, b->n_probe);
    }
    if (status == PRT_OK && opaque)
        status = tensor(j, PRT_TERM_MULTIPLE, "opaque surfaces", opaque_range, 3, 1, NULL);
    if (status || b->o.no_single) return status;
    if (opaque) {
        prt_free(b->probe);
        b->n_probe = JOINT_PROBES;
        if ((status = bake_probe(b, b->n_probe))) return status;
    }
    bake_plan_single(b);
    b->single.extinction = j->bases.integral;
    single_plan_depths(&b->single);
    status = bases_train_extinction(b, &j->bases, b->o.n_phase);
    if (status == PRT_OK)
        status = tensor(j, PRT_TERM_SINGLE, "single scattering", bake_single_range,
                        b->o.n_phase * j->bases.extinction->n_function, b->o.n_phase,
                        j->bases.extinction);
    return status;
}

int bake_joint(struct bake *b)
{
    struct joint j = {.b = b};
    double started = prt_time_s();
    if (!b->surface)
        return prt_fail(b->ctx, PRT_ARG,
                        "nothing is translucent: a joint bake has no material");
    int status = bases_create(b, &j.bases);
    if (status == PRT_OK && !shard_assembling(b))
        status = irradiance_bake(b->ctx, b->scene, b->surface, b->hierarchy, b->directions,
                                 b->o.material.eta, bake_rows_room(&b->o), &b->irradiance,
                                 &b->rays_irradiance);
    b->seconds[T_IRRADIANCE] = prt_time_s() - started;
    if (status == PRT_OK) status = bake_terms(&j);
    bases_finish(&j.bases);
    return status;
}
