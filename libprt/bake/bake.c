// SPDX-License-Identifier: MIT
// Runs the stages of a bake in order and writes the .prt.
#include "bake/measure.h"
#include "bake/run.h"
#include "bake/shard.h"
#include "bake/sources.h"

#include "prt/bake_limits.h"
#include "prt/radial.h"
#include "prt/relight.h"

#include <cblas.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint32_t default_rank = 72;    // columns looked at when the error chooses
static const uint32_t joint_rank = 64;      // the same where one U serves every medium, or more
static const uint32_t joint_columns = 3072; // on a small model: this many over all clusters
static const double tail_share = 0.25;      // of max_error: columns below it are not projected

static void dipole_eval(const void *user, unsigned cpu, size_t n, const float *r2,
                        float *const *out)
{
    const struct prt_diffusion *d = user;
    for (int c = 0; c < 3; c++) prt_diffusion_rd_array(&d[c], cpu, n, r2, out[c]);
}

void bake_set_defaults(struct prt_bake_options *o)
{
    if (!o->cube) o->cube = PRT_BAKE_CUBE_DEFAULT;
    if (!o->n_coef) o->n_coef = PRT_BAKE_COEFFS_DEFAULT;
    if (!o->n_phase) { // an isotropic medium needs one term; where g is free, or not 0, four
        const float *g = o->material.g;
        bool fixed = o->engine == PRT_TRANSPORT_WAVELET;
        o->n_phase = fixed && g[0] == 0 && g[1] == 0 && g[2] == 0 ? 1 : 4;
    }
    if (!o->n_single) o->n_single = PRT_BAKE_SINGLE_POINTS_DEFAULT;
    if (o->max_error == 0) o->max_error = PRT_BAKE_ERROR_DEFAULT;
}

static int check_options(const struct prt_context *ctx, struct prt_bake_options *o)
{
    int status = bake_check_settings(ctx, o);
    if (status) return status;
    bake_set_defaults(o);
    if (o->n_coef > 6 * o->cube * o->cube)
        return prt_fail(ctx, PRT_ARG, "--coeffs %u: must lie in [6, %u]", o->n_coef,
                        6 * o->cube * o->cube);
    if (o->engine != PRT_TRANSPORT_WAVELET && o->storage == PRT_STORAGE_SPARSE)
        return prt_fail(ctx, PRT_ARG, "--storage sparse goes with --transport wavelet only");
    if (o->engine == PRT_TRANSPORT_POLYNOMIAL && !o->env)
        return prt_fail(ctx, PRT_ARG, "--transport polynomial fixes the light: give it --env");
    if (o->basis > PRT_RADIAL_HAT || (o->basis && o->engine != PRT_TRANSPORT_POLYNOMIAL))
        return prt_fail(ctx, PRT_ARG,
                        "--basis polynomial and hat go with --transport polynomial only");
    if (o->n_shard > 1 && o->shard >= o->n_shard)
        return prt_fail(ctx, PRT_ARG, "--shard %u/%u: I must lie in [0, %u]", o->shard,
                        o->n_shard, o->n_shard - 1);
    return prt_material_check(ctx, &o->material);
}

// As many samples as the mean free path asks for, at least W05's 150,000, at most 600,000:
// beyond that the near-field cells keep the integral right and the user is told.
uint32_t bake_sample_count(const struct bake *b)
{
    if (b->o.n_sample) return b->o.n_sample;
    double area = prt_surface_area(b->mesh), finest = INFINITY;
    for (int c = 0; c < 3; c++) finest = fmin(finest, 1 / b->dipole[c].sigma_t_prime);
    double want = area / (finest * finest);
    if (want > 600000)
        prt_log(b->ctx, PRT_LOG_WARNING,
                "the mean free path (%.3g mm) is short against the model: %.0f samples would "
                "resolve it, 600000 are used",
                finest, want);
    return (uint32_t)fmin(fmax(want, 150000), 600000);
}

static float shortest_path(const struct bake *b)
{
    float finest = INFINITY;
    for (int c = 0; c < 3; c++) finest = fminf(finest, (float)(1 / b->dipole[c].sigma_t_prime));
    return finest;
}

float bake_fine_mm(const struct bake *b)
{
    return b->o.engine == PRT_TRANSPORT_WAVELET ? shortest_path(b) / 5 : 0.2f / 27;
}

uint32_t bake_patterns(const struct prt_bake_options *o)
{
    return o->cube <= 32 ? 16 : o->cube <= 64 ? 8 : 4;
}

uint32_t bake_cluster_size(const struct bake *b)
{
    uint32_t smaller = b->o.engine == PRT_TRANSPORT_JOINT ? 2 : 1;
    uint32_t size = b->mesh->n_vertex / (128 * smaller) + 1;
    return size < 640 / smaller ? 640 / smaller : size;
}

uint32_t bake_rank(const struct prt_bake_options *o, bool every_medium, uint32_t n_cluster)
{
    uint32_t rank = default_rank, spread = joint_columns / (n_cluster ? n_cluster : 1);
    if (every_medium && spread < rank) rank = spread > joint_rank ? spread : joint_rank;
    return o->rank ? o->rank : rank;
}

static int prepare(struct bake *b)
{
    double started = prt_time_s();
    const struct prt_mesh *mesh = b->mesh;
    float steepest = 0;
    prt_material_dipoles(&b->o.material, b->dipole);
    for (int c = 0; c < 3; c++) steepest = fmaxf(steepest, (float)b->dipole[c].sigma_tr);
    float finest = shortest_path(b), fine = bake_fine_mm(b);
    b->radial = (struct radial_set){3, dipole_eval, b->dipole, steepest};
    int status = prt_scene_create(b->ctx, mesh, &b->scene);
    bool any = prt_surface_area(mesh) > 0;
    if (status == PRT_OK && !any)
        prt_log(b->ctx, PRT_LOG_WARNING, "nothing is translucent: only shadows are baked");
    if (status == PRT_OK && any)
        status = prt_surface_create(b->ctx, mesh, bake_sample_count(b), fine, b->o.seed,
                                    &b->surface);
    if (status == PRT_OK && any && b->o.engine == PRT_TRANSPORT_WAVELET)
        status = prt_surface_check(b->ctx, b->surface, mesh, finest, b->o.n_sample != 0);
    if (status == PRT_OK && any) status = hierarchy_create(b->surface, &b->hierarchy);
    if (status == PRT_OK)
        status = directions_create(b->o.cube, bake_patterns(&b->o), b->o.seed, &b->directions);
    if (status == PRT_OK) status = clusters_create(mesh, bake_cluster_size(b), &b->clusters);
    if (status == PRT_OK) {
        b->factored = calloc(b->clusters->n_cluster + 1u, sizeof *b->factored);
        b->rays_single = calloc(b->clusters->n_cluster + 1u, sizeof *b->rays_single);
        if (!b->factored || !b->rays_single) status = PRT_NOMEM;
    }
    b->n_probe = DEFAULT_PROBES;
    b->seconds[T_SAMPLES] = prt_time_s() - started;
    return status;
}

// Gaussian lights: white noise over the sphere, as every light is met by the same energy.
int bake_probe(struct bake *b, uint32_t m)
{
    uint32_t n_coef = b->directions->n_coef;
    struct prt_rng rng;
    prt_rng_init(&rng, b->o.seed, 0x9a55);
    b->probe = prt_alloc((size_t)n_coef * m, sizeof *b->probe);
    if (!b->probe) return PRT_NOMEM;
    for (size_t i = 0; i < (size_t)n_coef * m; i++) {
        double u = 1 - prt_rng_f32(&rng), v = prt_rng_f32(&rng);
        b->probe[i] =
            (float)(sqrt(-2 * log(u)) * cos(2 * M_PI * v)) * b->directions->solid_angle[i / m];
    }
    return PRT_OK;
}

static struct factor_plan plan_of(const struct bake *b, uint32_t n_function)
{
    return (struct factor_plan){.n_function = n_function,
                                .n_train = b->train ? b->n_train : n_function,
                                .train = b->train,
                                .max_rank =
                                    bake_rank(&b->o, b->train != NULL, b->clusters->n_cluster),
                                .n_probe = b->n_probe,
                                .tail_error = b->o.rank ? 0 : tail_share * b->o.max_error,
                                .n = b->o.cube,
                                .solid_angle = b->directions->solid_angle,
                                .probe = b->probe};
}

static void apply_solid_angle(const struct bake *b, float *dense, size_t rows)
{
    uint32_t n = b->directions->n_coef;
    for (size_t i = 0; i < rows; i++)
        for (uint32_t k = 0; k < n; k++) dense[i * n + k] *= b->directions->solid_angle[k];
}

// Hands a cluster's rows to the storage that was asked for.
int bake_take_rows(struct bake *b, uint32_t c, uint32_t n_function,
                   const struct row_source *source)
{
    if (!b->sparse) {
        struct factor_plan plan = plan_of(b, n_function);
        return factor_cluster(b->ctx, &plan, source, &b->factored[c]);
    }
    uint32_t n = source->n_vertex, n_coef = b->directions->n_coef;
    float *u = prt_calloc((size_t)n * n, sizeof *u);
    float *dense = prt_alloc((size_t)n * n_function * n_coef, sizeof *dense);
    int status = u && dense ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK) {
        for (uint32_t v = 0; v < n; v++) u[(size_t)v * n + v] = 1;
        status = source->project(source->user, u, n, dense);
    }
    if (status == PRT_OK) {
        apply_solid_angle(b, dense, (size_t)n * n_function);
        sparse_builder_add(b->sparse, c, dense);
    }
    prt_free(u);
    prt_free(dense);
    return status;
}

// Opaque receivers (W05 fig. 1's floor): albedo/pi times shadowed irradiance.
int bake_opaque_rows(struct bake *b, uint32_t c, uint32_t *block)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    uint32_t n = cluster->n_vertex, n_coef = b->directions->n_coef;
    float *t = prt_alloc((size_t)n * 3 * n_coef, sizeof *t);
    if (!t) return PRT_NOMEM;
    for (uint32_t i = 0; i < n; i++) {
        uint32_t v = b->clusters->order[cluster->vertex_begin + i];
        const float *albedo = b->mesh->surface[b->mesh->block[block[v]].surface].base_color;
        const float *normal = b->mesh->normal[v];
        float *row = t + (size_t)i * 3 * n_coef;
        irradiance_row(b->scene, b->directions, v, NULL, b->mesh->position[v], normal, normal,
                       row + 2 * n_coef);
        for (int ch = 0; ch < 3; ch++) // the last channel is scaled in place
            for (uint32_t k = 0; k < n_coef; k++)
                row[(size_t)ch * n_coef + k] =
                    row[2 * (size_t)n_coef + k] * (albedo[ch] / (float)M_PI);
    }
    struct dense_rows rows = {t, n, 3, n_coef};
    struct row_source source = {&rows, n, dense_multiply, dense_project, NULL};
    int status = bake_take_rows(b, c, 3, &source);
    prt_free(t);
    return status;
}

static int multiple_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct bake *b = arg;
    int status = PRT_OK;
    prt_trace_thread_init();
    uint32_t *block = prt_mesh_vertex_blocks(b->mesh);
    if (!block) return PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) {
            status = bake_opaque_rows(b, (uint32_t)c, block);
            continue;
        }
        struct cut cut = {0};
        status = cut_build(b->ctx, b->mesh, b->surface, b->hierarchy, b->clusters, (uint32_t)c,
                           &b->radial, &cut);
        struct product_rows rows = {&b->irradiance, &cut, b->clusters->cluster[c].n_vertex, 3};
        struct row_source source = {&rows, rows.n_vertex, product_multiply, product_project,
                                    product_blend};
        if (status == PRT_OK) status = bake_take_rows(b, (uint32_t)c, 3, &source);
        cut_finish(&cut);
    }
    prt_free(block);
    return status;
}

static void drop_factored(struct bake *b)
{
    for (uint32_t c = 0; b->factored && c < b->clusters->n_cluster; c++)
        factored_finish(&b->factored[c]);
}

// The most a tensor may take: W05's 128 coefficients a vertex (640 bytes with their indices)
// and METHODS §5's sizes for joint transport; small models, whose bases weigh most, get a
// floor.
double bake_byte_budget(const struct bake *b, enum prt_term term, uint32_t n_phase)
{
    bool joint = b->o.engine == PRT_TRANSPORT_JOINT;
    double per_vertex = joint ? (term ? 2200 : 1088) : 620.0 * n_phase;
    double least = joint ? (term ? 40e6 : 24e6) : (term ? 6e6 : 16e6) * n_phase;
    return fmax(per_vertex * b->mesh->n_vertex, least);
}

// One term's tensor: rows by `range`, then packing.
int bake_tensor(struct bake *b, enum prt_term term, const char *stage, prt_loop_fn range,
                uint32_t n_function, uint32_t n_phase, unsigned clock)
{
    double started = prt_time_s();
    struct prt_tensor *t = &b->out.tensor[b->out.n_tensor];
    int status = PRT_OK;
    if (b->o.storage == PRT_STORAGE_SPARSE)
        status = sparse_builder_create(b->clusters, b->mesh->n_vertex, b->o.cube, n_function,
                                       b->o.n_coef, &b->sparse);
    if (status == PRT_OK) status = shard_for(b, stage, range, b->loop_arg ? b->loop_arg : b);
    bool part = false;
    if (status == PRT_OK)
        status = b->sparse ? shard_sparse(b, &part) : shard_factored(b, n_function, &part);
    b->seconds[clock] = prt_time_s() - started;
    started = prt_time_s();
    struct pack_options pack = {.rank = b->o.rank,
                                .n_basis_coef = b->o.n_basis_coef,
                                .energy_error = b->o.max_error * (term ? 1.5 : 0.75),
                                .mixed = b->train != NULL,
                                .max_bytes = bake_byte_budget(b, term, n_phase)};
    if (status == PRT_OK && !part)
        status = b->sparse ? sparse_builder_finish(b->sparse, t)
                           : pack_factored(b->ctx, b->clusters, b->factored, n_function,
                                           b->o.cube, &pack, t);
    sparse_builder_destroy(b->sparse);
    b->sparse = NULL;
    drop_factored(b);
    if (status) return status;
    t->term = term;
    t->coupling = PRT_COUPLE_DIAGONAL;
    t->n_phase = n_phase;
    b->out.n_tensor++;
    b->seconds[T_PACK] += prt_time_s() - started;
    return PRT_OK;
}

void bake_plan_single(struct bake *b)
{
    const struct prt_material *m = &b->o.material;
    b->single = (struct single_plan){.scene = b->scene,
                                     .mesh = b->mesh,
                                     .directions = b->directions,
                                     .eta = m->eta,
                                     .n_phase = b->o.n_phase,
                                     .n_point = b->o.n_single,
                                     .every_ray = b->o.every_ray,
                                     .seed = b->o.seed};
    for (int c = 0; c < 3; c++) {
        b->single.sigma_s[c] = m->sigma_s_prime[c] / (1 - m->g[c]);
        b->single.sigma_t[c] = b->single.sigma_s[c] + m->sigma_a[c];
        (void)prt_phase_hg(&b->single.phase[c], m->g[c], b->o.n_phase);
    }
    b->single.n_direction = b->directions->n_coef;
    single_plan_depths(&b->single);
}

static int bake_wavelet(struct bake *b)
{
    double started = prt_time_s();
    int status = PRT_OK;
    if (b->surface && !shard_assembling(b))
        status = irradiance_bake(b->ctx, b->scene, b->surface, b->hierarchy, b->directions,
                                 b->o.material.eta, bake_rows_room(&b->o), &b->irradiance,
                                 &b->rays_irradiance);
    b->seconds[T_IRRADIANCE] = prt_time_s() - started;
    if (status == PRT_OK) status = bake_probe(b, DEFAULT_PROBES);
    if (status == PRT_OK)
        status = bake_tensor(b, PRT_TERM_MULTIPLE, "multiple scattering", multiple_range, 3, 1,
                             T_MULTIPLE);
    half_rows_finish(&b->irradiance);
    if (status != PRT_OK || b->o.no_single || !b->surface) return status;
    if (b->o.material.profile) // its R_d holds all light that leaves
        return PRT_OK;
    bake_plan_single(b);
    return bake_tensor(b, PRT_TERM_SINGLE, "single scattering", bake_single_range,
                       3 * b->o.n_phase, b->o.n_phase, T_SINGLE);
}

static uint64_t mesh_hash(const struct prt_mesh *m)
{
    uint64_t h = prt_hash64(m->position, (size_t)m->n_vertex * 12, 1);
    h = prt_hash64(m->normal, (size_t)m->n_vertex * 12, h);
    h = prt_hash64(m->triangle, (size_t)m->n_triangle * 12, h);
    return prt_hash64(m->block, (size_t)m->n_block * sizeof *m->block, h);
}

static void describe(const struct bake *b, char *out, size_t n)
{
    static const char *const engine[] = {"wavelet", "polynomial", "joint"};
    uint64_t rays = 0;
    for (uint32_t c = 0; b->rays_single && c < b->clusters->n_cluster; c++)
        rays += b->rays_single[c];
    char material[512];
    prt_material_summary(&b->o.material, material, sizeof material);
    snprintf(
        out, n,
        "{\"engine\":\"%s\",\"storage\":\"%s\",\"cube\":%u,\"samples\":%u,\"spacing_mm\":%g,"
        "\"phase_terms\":%u,\"single_points\":%u,\"coeffs\":%u,\"max_error\":%g,\"seed\":%llu,"
        "\"clusters\":%u,\"rays_irradiance\":%llu,\"rays_single\":%llu,\"material\":%s%s%s}",
        engine[b->o.engine], b->o.storage == PRT_STORAGE_SPARSE ? "sparse" : "factored",
        b->o.cube, b->surface ? b->surface->n_sample : 0, b->surface ? b->surface->spacing : 0,
        b->o.n_phase, b->o.n_single, b->o.n_coef, b->o.max_error, (unsigned long long)b->o.seed,
        b->clusters->n_cluster, (unsigned long long)b->rays_irradiance,
        (unsigned long long)rays, material, b->o.settings_json ? ",\"source\":" : "",
        b->o.settings_json ? b->o.settings_json : "");
}

// A polynomial bake can only be asked about the light it fixed.
static int examine(struct bake *b, char *errors, size_t n)
{
    struct prt_cube own = {0};
    bool fixed = b->o.engine == PRT_TRANSPORT_POLYNOMIAL;
    int status =
        fixed ? prt_env_to_cube(b->ctx, b->o.env, b->o.cube, b->o.rotate_deg, &own) : PRT_OK;
    if (status == PRT_OK)
        status = measure_bake(b->ctx, &b->out, fixed ? &own : NULL, 200, b->o.seed, errors, n);
    prt_cube_finish(&own);
    return status;
}

static void release(struct bake *b)
{
    for (uint32_t t = 0; t < b->out.n_tensor; t++) tensor_finish(&b->out.tensor[t]);
    if (b->clusters) drop_factored(b);
    free(b->factored);
    free(b->rays_single);
    half_rows_finish(&b->irradiance);
    prt_free(b->probe);
    clusters_destroy(b->clusters);
    directions_destroy(b->directions);
    hierarchy_destroy(b->hierarchy);
    prt_surface_destroy(b->surface);
    single_plan_finish(&b->single);
    prt_scene_destroy(b->scene);
}

// The same for every part of one bake: all that decides what clusters hold.
static uint64_t shard_key(const struct bake *b)
{
    char settings[4096];
    describe(b, settings, sizeof settings);
    const uint32_t more[] = {b->o.rank, b->o.n_basis_coef, b->o.no_single, b->o.every_ray,
                             b->o.basis};
    uint64_t key = prt_hash64(settings, strlen(settings), b->out.mesh_hash);
    key = prt_hash64(more, sizeof more, key);
    key = prt_hash64(&b->o.rotate_deg, sizeof b->o.rotate_deg, key);
    const struct prt_env *env = b->o.engine == PRT_TRANSPORT_POLYNOMIAL ? b->o.env : NULL;
    if (env && env->kind == PRT_ENV_CUBE)
        key = prt_hash64(env->cube.texel, (size_t)env->cube.n * env->cube.n * 72, key);
    else if (env)
        key = prt_hash64(env->latlong.rgb,
                         (size_t)env->latlong.width * env->latlong.height * 12, key);
    return key;
}

static int run_engine(struct bake *b)
{
    return b->o.engine == PRT_TRANSPORT_JOINT        ? bake_joint(b)
           : b->o.engine == PRT_TRANSPORT_POLYNOMIAL ? bake_polynomial(b)
                                                     : bake_wavelet(b);
}

// Runs the engine on this process' clusters and, when it has the last part, once more to
// assemble them all.
static int run_shard(struct bake *b, const char *out_path, uint32_t *missing)
{
    *missing = 0;
    int status = shard_create(b, out_path, b->o.n_shard > 1 ? shard_key(b) : 0);
    if (status == PRT_OK && !shard_done(b)) status = run_engine(b);
    if (status == PRT_OK) status = shard_close(b, missing);
    if (status != PRT_OK || !shard_assembling(b)) return status;
    for (uint32_t t = 0; t < b->out.n_tensor; t++) tensor_finish(&b->out.tensor[t]);
    memset(b->out.tensor, 0, sizeof b->out.tensor);
    b->out.n_tensor = 0;
    prt_free(b->probe);
    b->probe = NULL;
    b->n_probe = DEFAULT_PROBES;
    single_plan_finish(&b->single);
    return run_engine(b);
}

int prt_bake(const struct prt_context *ctx, const struct prt_mesh *mesh,
             const struct prt_bake_options *options, const char *out_path)
{
    struct bake b = {.ctx = ctx, .mesh = mesh, .o = *options};
    char settings[4096], errors[2048] = "{}";
    uint32_t missing = 0;
    int status = check_options(ctx, &b.o);
    if (status) return status;
    if (!(mesh->mm_per_unit > 0))
        return prt_fail(ctx, PRT_ARG, "the model has no scale: prt_mesh_scale it first");
    openblas_set_num_threads(1);
    b.out.mesh = *mesh;
    b.out.mesh.owner = NULL;
    b.out.material = b.o.material;
    b.out.cube = b.o.cube;
    b.out.engine = b.o.engine;
    b.out.mesh_hash = mesh_hash(mesh);
    status = prepare(&b);
    if (status == PRT_OK) status = run_shard(&b, out_path, &missing);
    if (status == PRT_OK && b.surface && !missing) status = examine(&b, errors, sizeof errors);
    if (status == PRT_OK && !missing) {
        // Times are told, not stored: equal bakes are equal bytes.
        prt_log(ctx, PRT_LOG_NOTE,
                "seconds: samples %.2f, irradiance %.2f, multiple %.2f, single %.2f, pack %.2f",
                b.seconds[T_SAMPLES], b.seconds[T_IRRADIANCE], b.seconds[T_MULTIPLE],
                b.seconds[T_SINGLE], b.seconds[T_PACK]);
        describe(&b, settings, sizeof settings);
        b.out.settings = settings;
        b.out.errors = errors;
        status = prt_file_write(ctx, out_path, &b.out);
    }
    shard_destroy(&b, status == PRT_OK);
    if (options->parts_missing) *options->parts_missing = missing;
    release(&b);
    if (status == PRT_NOMEM) prt_fail(ctx, status, "not enough memory for this bake");
    return status;
}
