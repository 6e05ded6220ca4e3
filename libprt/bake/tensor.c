// SPDX-License-Identifier: MIT
// One tensor of a bake: the rows of its clusters, factored or sparse, and their packing.
#include "bake/run.h"
#include "bake/shard.h"
#include "bake/sources.h"
#include "bake/spill.h"
#include "bake/walks.h"

#include <math.h>
#include <stdlib.h>

// Columns whose energy is below this share of --max-error are not projected. Chosen, not
// measured.
static const double tail_share = 0.25;

// White noise over the sphere: every light is met with the same expected energy.
int prt_probes_create(const struct bake *b, uint32_t m, struct probes *out)
{
    uint32_t n_coef = b->directions->n_coef;
    struct prt_rng rng;
    prt_rng_init(&rng, b->o.seed, 0x9a55);
    float *light = prt_alloc((size_t)n_coef * m, sizeof *light);
    if (!light) return PRT_NOMEM;
    for (size_t i = 0; i < (size_t)n_coef * m; i++) {
        double u = 1 - prt_rng_f32(&rng), v = prt_rng_f32(&rng);
        light[i] =
            (float)(sqrt(-2 * log(u)) * cos(2 * M_PI * v)) * b->directions->solid_angle[i / m];
    }
    *out = (struct probes){m, light};
    return PRT_OK;
}

void prt_probes_finish(struct probes *probes)
{
    prt_free(probes->light);
    *probes = (struct probes){0};
}

// The error of single scattering's planes of exit over their own size, which is a small part of
// single scattering and holds the noise of few rays; chosen.
static const double view_error = 0.1;

// The error of a tensor whose columns may be dropped.
static double tail_error(const struct tensor_job *job)
{
    const struct bake *b = job->bake;
    if (b->o.rank) return 0;
    return job->term == PRT_TERM_VIEW ? view_error : tail_share * b->o.max_error;
}

// The media that a cluster's U is trained for.
static const struct training *training_of(const struct tensor_job *job, uint32_t cluster)
{
    const struct prt_media *media = &job->bake->o.media;
    const uint32_t medium = prt_bake_medium(job->bake, cluster);
    double eta[PRT_MEDIA_MAX];
    uint32_t i = 0;
    if (!job->training || job->n_training < 2) return job->training;
    (void)prt_media_etas(media, eta);
    while (eta[i] != (double)media->medium[medium].eta) i++;
    return &job->training[i];
}

static uint32_t most_rank(const struct tensor_job *job, bool every_medium)
{
    const struct bake *b = job->bake;
    const uint32_t rank = prt_bake_rank(&b->o, every_medium, b->clusters->n_cluster);
    return job->most_rank && job->most_rank < rank ? job->most_rank : rank;
}

static struct factor_plan plan_of(const struct tensor_job *job, uint32_t cluster)
{
    const struct bake *b = job->bake;
    const struct training *t = training_of(job, cluster);
    return (struct factor_plan){.n_function = job->n_function,
                                .n_train = t ? t->n : job->n_function,
                                .train = t ? t->weight : NULL,
                                .max_rank = most_rank(job, t != NULL),
                                .n_probe = job->probes->n,
                                .tail_error = tail_error(job),
                                .n = b->o.cube,
                                .solid_angle = b->directions->solid_angle,
                                .probe = job->probes->light,
                                .lights = job->lights,
                                .work = job->work};
}

static void apply_solid_angle(const struct bake *b, float *dense, size_t rows)
{
    uint32_t n = b->directions->n_coef;
    for (size_t i = 0; i < rows; i++)
        for (uint32_t k = 0; k < n; k++) dense[i * n + k] *= b->directions->solid_angle[k];
}

int prt_bake_take_rows(const struct tensor_job *job, uint32_t c,
                       const struct row_source *source)
{
    struct bake *b = job->bake;
    if (!b->sparse) {
        struct factor_plan plan = plan_of(job, c);
        int done = prt_factor_cluster(b->ctx, &plan, source, &b->factored[c]);
        if (!done)
            prt_spill_factored(b->spill, &b->factored[c], job->n_function,
                               b->directions->n_coef);
        return done;
    }
    uint32_t n = source->n_vertex, n_coef = b->directions->n_coef;
    uint32_t n_function = job->n_function;
    float *u = prt_calloc((size_t)n * n, sizeof *u);
    float *dense = prt_alloc((size_t)n * n_function * n_coef, sizeof *dense);
    int status = u && dense ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK) {
        for (uint32_t v = 0; v < n; v++) u[(size_t)v * n + v] = 1;
        status = source->project(source->user, u, n, dense);
    }
    if (status == PRT_OK) {
        apply_solid_angle(b, dense, (size_t)n * n_function);
        prt_sparse_builder_add(b->sparse, c, dense);
    }
    prt_free(u);
    prt_free(dense);
    return status;
}

// Opaque receivers, such as the floor in W05's first figure.
int prt_bake_opaque_rows(const struct tensor_job *job, uint32_t c, const uint32_t *block)
{
    const struct bake *b = job->bake;
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    uint32_t n = cluster->n_vertex, n_coef = b->directions->n_coef;
    float *t = prt_alloc((size_t)n * 3 * n_coef, sizeof *t);
    if (!t) return PRT_NOMEM;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t v = b->clusters->order[cluster->vertex_begin + i];
        const float *albedo = b->mesh->surface[b->mesh->block[block[v]].surface].base_color;
        const float *normal = b->mesh->normal[v];
        float *row = t + (size_t)i * 3 * n_coef;
        const struct receiver at = {b->mesh->position[v], normal, normal};
        prt_irradiance_row(b->scene, b->directions, v, NULL, &at, NULL,
                           b->o.draft ? AGREEING_RAYS : EVERY_RAY, row + 2 * n_coef);
        for (int ch = 0; ch < 3; ch++) // the last channel is scaled in place
            for (uint32_t k = 0; k < n_coef; k++)
                row[(size_t)ch * n_coef + k] =
                    row[2 * (size_t)n_coef + k] * (albedo[ch] / (float)M_PI);
    }
    struct dense_rows rows = {t, n, 3, n_coef};
    struct row_source source = {&rows, n, prt_dense_multiply, prt_dense_project, NULL};
    int status = prt_bake_take_rows(job, c, &source);
    prt_free(t);
    return status;
}

void prt_bake_drop_factored(struct bake *b)
{
    for (uint32_t c = 0; b->factored && c < b->clusters->n_cluster; c++)
        prt_factored_finish(&b->factored[c]);
    prt_spill_clear(b->spill);
}

// The most bytes of a tensor: W05's 128 coefficients a vertex (640 bytes with their indices),
// and METHODS §5's sizes for joint transport. Small models, whose bases take the largest part,
// get a least number instead. Single scattering of spot (3225 vertices, 50 mm, marble) under
// studio and sunrise: 2.8 and 5.1 % in 6 MB, 1.7 and 3.7 % in 12, 1.2 and 2.6 % in 20.
double prt_bake_byte_budget(const struct bake *b, enum prt_term term, uint32_t n_phase)
{
    bool joint = b->o.engine == PRT_TRANSPORT_JOINT;
    if (term == PRT_TERM_VIEW) return fmax(200.0 * b->mesh->n_vertex, 4e6);
    double per_vertex = joint ? (term ? 2200 : 1088) : 620.0 * n_phase;
    double least = joint ? (term ? 40e6 : 24e6) : (term ? 20e6 : 16e6) * n_phase;
    return fmax(per_vertex * b->mesh->n_vertex, least);
}

// Energy error of a term's packing over --max-error. 0.75 for multiple scattering gave 0.82 %
// on the bunny at --max-error 0.01 under the hardest light; single scattering's rows carry the
// noise of their jitter, which is not worth its bytes. Unscattered light is a small part of a
// total.
static double energy_error(const struct bake *b, enum prt_term term)
{
    if (term == PRT_TERM_VIEW) return view_error;
    return b->o.max_error * (term == PRT_TERM_SINGLE        ? 1.5
                             : term == PRT_TERM_UNSCATTERED ? 3
                                                            : 0.75);
}

static int pack_rows(const struct tensor_job *job, struct prt_tensor *out)
{
    struct bake *b = job->bake;
    if (b->sparse) return prt_sparse_builder_finish(b->sparse, out);
    struct pack_options pack = {.rank = b->o.rank,
                                .n_basis_coef = b->o.n_basis_coef,
                                .energy_error = energy_error(b, job->term),
                                .low_rank = job->training != NULL,
                                .max_bytes = prt_bake_byte_budget(b, job->term, job->n_phase)};
    return prt_pack_factored(b->ctx, b->clusters, b->factored, job->n_function, b->o.cube,
                             &pack, out);
}

// The lights of the range finder, and pass 1's rows times them. Neither is there for sparse
// storage, nor the second where no rows are gathered.
static int prepare_lights(struct tensor_job *job, float **lights, struct lit_rows *lit)
{
    struct bake *b = job->bake;
    const uint32_t n = job->probes->n;
    if (b->o.storage == PRT_STORAGE_SPARSE && !b->walk) return PRT_OK;
    if (b->lit && job->term == PRT_TERM_UNSCATTERED) {
        job->lit = b->lit;
        return PRT_OK;
    }
    struct factor_plan plan = plan_of(job, 0); // the lights are the same for all
    if (plan.train && !(*lights = prt_compression_lights(&plan))) return PRT_NOMEM;
    job->lights = *lights;
    if (job->term != PRT_TERM_MULTIPLE || !b->irradiance.half) return PRT_OK;
    int status = prt_lit_rows_create(b->ctx, &b->irradiance, *lights ? *lights : plan.probe,
                                     *lights ? n + 6 : n, &b->work, lit);
    if (status == PRT_OK) job->lit = lit;
    return status;
}

void prt_bake_drop_lit(struct bake *b)
{
    if (b->lit) prt_lit_rows_finish(b->lit);
    free(b->lit);
    b->lit = NULL;
}

struct tensor_job prt_bake_channels(struct bake *bake, const char *stage, prt_loop_fn range,
                                    const struct probes *probes)
{
    return (struct tensor_job){.bake = bake,
                               .term = PRT_TERM_MULTIPLE,
                               .stage = stage,
                               .range = range,
                               .n_function = 3,
                               .n_phase = 1,
                               .probes = probes};
}

int prt_bake_tensor(struct tensor_job *job)
{
    struct bake *b = job->bake;
    struct lit_rows *lit = calloc(1, sizeof *lit);
    float *lights = NULL;
    job->work = &b->work;
    struct prt_tensor *t = &b->out.tensor[b->out.n_tensor];
    int status = lit ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK && b->o.storage == PRT_STORAGE_SPARSE)
        status = prt_sparse_builder_create(b->clusters, b->mesh->n_vertex, b->o.cube,
                                           job->n_function, b->o.n_coef, &b->sparse);
    const struct slot slot = {b->sparse ? SLOT_SPARSE : SLOT_FACTORED, job->n_function, NULL};
    bool part = false;
    if (status == PRT_OK) status = prepare_lights(job, &lights, lit);
    if (status == PRT_OK) status = prt_shard_for(b, job->stage, job->range, job, &slot, &part);
    if (b->walk && job->term == PRT_TERM_MULTIPLE && lit && lit->value && !lights) {
        b->lit = lit; // unscattered light gathers from the same rows
    } else {
        if (lit) prt_lit_rows_finish(lit);
        free(lit);
    }
    prt_free(lights);
    uint64_t started = prt_work_begin_all();
    if (status == PRT_OK && !part) status = pack_rows(job, t);
    prt_sparse_builder_destroy(b->sparse);
    b->sparse = NULL;
    prt_bake_drop_factored(b);
    if (status) return status;
    t->term = job->term;
    t->coupling = PRT_COUPLE_DIAGONAL;
    t->n_phase = job->n_phase;
    b->out.n_tensor++;
    prt_work_end_all(&b->work, WORK_PACK, started);
    return PRT_OK;
}
