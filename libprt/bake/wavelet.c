// SPDX-License-Identifier: MIT
// Wavelet transport (METHODS §3): the light is free, the material fixed; multiple scattering by
// the dipole or by walks (METHODS §9).
#include "bake/draft_walks.h"
#include "bake/run.h"
#include "bake/sources.h"
#include "bake/walks.h"

#include <string.h>

// The cluster's kernel becomes that of walks, smoothed by the answers that it gave before.
static int take_walks(const struct tensor_job *job, uint32_t c, struct product_rows *rows,
                      struct cut *cut, float *factor)
{
    const struct bake *b = job->bake;
    const uint32_t m = job->lit->n_light;
    struct walk_answers walks = {0};
    float *smooth = NULL, *dipole = prt_alloc((size_t)3 * rows->n_vertex * m, sizeof *dipole);
    float *like = dipole ? prt_walk_likeness(b, c) : NULL;
    int status = like ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK) status = prt_product_multiply(rows, job->lit->light, m, dipole);
    if (status == PRT_OK) status = prt_walks_fill(job, c, cut, &walks);
    const uint64_t started = prt_work_begin();
    if (status == PRT_OK)
        status = prt_walks_smooth(b, like, dipole, &walks, &smooth, factor, b->walk->noise[c]);
    prt_work_end(job->work, WORK_SMOOTH, started, 0, 0);
    prt_walk_answers_finish(&walks);
    prt_free(dipole);
    prt_free(like);
    rows->smooth = smooth;
    return status;
}

// Rows of walked vertices times their factors. A factor scales a row of U, which takes no
// column more.
static int take_scaled_rows(const struct tensor_job *job, uint32_t c, struct product_rows *rows,
                            const struct row_source *source, const float *factor)
{
    struct bake *b = job->bake;
    const size_t n = rows->n_vertex;
    float *smooth = (float *)(uintptr_t)rows->smooth;
    for (size_t i = 0; smooth && b->sparse && i < 3 * n * n; i++)
        smooth[i] *= factor[i / n % n];
    int status = prt_bake_take_rows(job, c, source);
    const struct factored *f = &b->factored[c];
    for (size_t i = 0; smooth && !b->sparse && !status && i < f->rank * n; i++)
        f->u[i] *= factor[i % n];
    return status;
}

static int multiple_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    const struct bake *b = job->bake;
    int status = PRT_OK;
    prt_trace_thread_init();
    uint32_t *block = prt_mesh_vertex_blocks(b->mesh);
    if (!block) return PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) {
            status = prt_bake_opaque_rows(job, (uint32_t)c, block);
            continue;
        }
        struct cut cut = {0};
        float *factor = prt_alloc(b->clusters->cluster[c].n_vertex, sizeof *factor);
        if (!factor) status = PRT_NOMEM;
        uint64_t started = prt_work_begin();
        const struct cut_source from = prt_bake_cut_source(b);
        if (!status)
            status = prt_cut_build(b->ctx, &from, (uint32_t)c,
                                   &b->radial[prt_bake_medium(b, (uint32_t)c)], &cut);
        if (!status) status = prt_draft_walks_scale(b, (uint32_t)c, &cut);
        prt_work_end(job->work, WORK_KERNEL, started, 0, 0);
        struct product_rows rows = {
            &b->irradiance, &cut, b->clusters->cluster[c].n_vertex, 3, job->lit,
            job->work,      NULL};
        if (status == PRT_OK && prt_walks_in(b, (uint32_t)c))
            status = take_walks(job, (uint32_t)c, &rows, &cut, factor);
        struct row_source source = {&rows, rows.n_vertex, prt_product_multiply,
                                    prt_product_project, prt_product_combine};
        if (status == PRT_OK && factor)
            status = take_scaled_rows(job, (uint32_t)c, &rows, &source, factor);
        prt_free((float *)(uintptr_t)rows.smooth);
        prt_free(factor);
        prt_cut_finish(&cut);
    }
    prt_free(block);
    return status;
}

int prt_bake_wavelet(struct bake *b)
{
    struct probes probes = {0};
    int status = prt_bake_irradiance(b);
    if (status == PRT_OK) status = prt_probes_create(b, WAVELET_PROBES, &probes);
    struct tensor_job multiple =
        prt_bake_channels(b, "multiple scattering", multiple_range, &probes);
    if (status == PRT_OK) status = prt_bake_tensor(&multiple);
    struct tensor_job unscattered = multiple;
    unscattered.term = PRT_TERM_UNSCATTERED;
    unscattered.stage = "unscattered light";
    unscattered.range = prt_bake_unscattered_range;
    unscattered.lit = NULL;
    if (status == PRT_OK && b->walk) status = prt_bake_tensor(&unscattered);
    prt_half_rows_finish(&b->irradiance);
    prt_bake_drop_lit(b);
    // A material's own profile holds all light that leaves: single scattering is part of it.
    if (status == PRT_OK && !b->o.no_single && b->surface && prt_bake_any_single(b)) {
        struct tensor_job single = {.bake = b,
                                    .term = PRT_TERM_SINGLE,
                                    .stage = "single scattering",
                                    .range = prt_bake_single_range,
                                    .n_function = 3 * b->o.n_phase,
                                    .n_phase = b->o.n_phase,
                                    .probes = &probes};
        status = prt_bake_plan_single(b, NULL, 0);
        if (status == PRT_OK)
            status =
                b->o.draft ? prt_bake_draft_single(&single, NULL) : prt_bake_tensor(&single);
        if (status == PRT_OK && prt_bake_has_view(b))
            status = prt_bake_view(b, NULL, &probes, NULL, 0);
    }
    prt_probes_finish(&probes);
    return status;
}
