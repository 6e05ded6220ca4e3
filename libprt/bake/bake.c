// SPDX-License-Identifier: MIT
// Runs the stages of a bake in order and writes the .prt.
#include "bake/checkpoint.h"
#include "bake/draft_walks.h"
#include "bake/measure.h"
#include "bake/row_store.h"
#include "bake/run.h"
#include "bake/shard.h"
#include "bake/spill.h"
#include "bake/walks.h"
#include "trace/triangle_grid.h"

#include "prt/bake_limits.h"
#include "prt/radial.h"
#include "prt/relight.h"

#include <cblas.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Columns of U that are computed when --max-error chooses the rank; packing drops some.
static const uint32_t default_rank = 72; // chosen, not measured
// A joint bake's columns: joint_columns over all clusters, at least joint_rank and at most
// default_rank in each. 48 in each of a slab's eight clusters left 1.18 % where 1 % is allowed.
static const uint32_t joint_rank = 64;
static const uint32_t joint_columns = 3072;
// Vertices of a cluster. In clusters of 640 the rank limits single scattering: that of the
// bunny (35k vertices, 50 mm, marble) under studio errs by 4.0 %, in clusters of 320 by 3.0 %,
// in as many bytes. Walks' answers are smoothed over a cluster.
static const uint32_t cluster_vertices = 320, walk_cluster_vertices = 640;
static const uint32_t most_clusters = 128; // of a large model; twice as many of a joint bake
// Clusters of a model of fewer vertices, and the least vertices of one. Spot (3225 vertices, 50
// mm, marble) under sunrise: 6.4 % in clusters of 640, 5.1 % in clusters of 64, in the same
// bytes; a dragon of 5891 in clusters of 109 6.9 %, of 64 6.2 %. Joint bakes by walks keep 320:
// spot's has a noise of 2.4 % then, and 2.6 % with 160.
static const uint32_t few_clusters = 108, least_cluster = 64;
static const uint32_t few_walk_clusters = 54, least_walk_cluster = 160;
// Irradiance samples when --samples does not say: at least W05's number. Beyond the most the
// near-field cells keep the integral right, and the user is warned.
static const double few_samples = 75000, least_samples = 150000, most_samples = 600000;
static const uint32_t examined_vertices = 200; // whose error the file records
// Walks of each of two references, and those of a bake below which they are as many; those of
// a draft, whose errors are several per cent; chosen.
static const uint32_t examining_walks = 1536, few_walks = 256, draft_walks = 128;
static const uint32_t reference_samples =
    60000; // at least, of the reference it is held against

static void dipole_eval(const void *user, unsigned cpu, size_t n, const float *r2,
                        float *const *out)
{
    const struct prt_diffusion *d = user;
    for (int c = 0; c < 3; c++) prt_diffusion_rd_array(&d[c], cpu, n, r2, out[c]);
}

// A draft's settings where the caller leaves them open. Bunny of 35k vertices, joint: the worst
// of three media under three lights errs by less than 3 %.
static const uint32_t draft_cube = 16, draft_samples = 20000;
static const double draft_error = 0.05;

void prt_bake_set_defaults(struct prt_bake_options *o)
{
    if (o->draft) {
        if (!o->cube) o->cube = draft_cube;
        if (!o->n_sample) o->n_sample = draft_samples;
        if (o->max_error == 0) o->max_error = draft_error;
    }
    if (!o->cube) o->cube = PRT_BAKE_CUBE_DEFAULT;
    if (!o->n_coef) o->n_coef = PRT_BAKE_COEFFS_DEFAULT;
    if (!o->n_phase) { // an isotropic medium needs one term; where g is free, or not 0, four
        bool fixed = o->engine == PRT_TRANSPORT_WAVELET, isotropic = true;
        for (uint32_t i = 0; i < 3 * o->media.n; i++)
            isotropic &= o->media.medium[i / 3].g[i % 3] == 0;
        o->n_phase = fixed && isotropic ? 1 : 4;
    }
    if (!o->n_single) o->n_single = PRT_BAKE_SINGLE_POINTS_DEFAULT;
    if (o->max_error == 0) o->max_error = PRT_BAKE_ERROR_DEFAULT;
    if (!o->cache_room) o->cache_room = UINT64_C(8) << 30;
}

// A bake for any index: the walks and the planes of exit are refracted by one, and columns of a
// fixed light are cheaper to bake for each.
static int check_any_eta(const struct prt_context *ctx, const struct prt_bake_options *o)
{
    struct prt_eta_nodes nodes;
    prt_eta_nodes_default(PRT_FAMILY_DIPOLE, &nodes);
    if (!o->any_eta) return PRT_OK;
    if (o->engine != PRT_TRANSPORT_JOINT)
        return prt_fail(ctx, PRT_ARG, "--any-eta goes with --transport joint only");
    if (o->scattering == PRT_SCATTERING_WALK)
        return prt_fail(ctx, PRT_ARG,
                        "--any-eta goes with --scattering dipole only: walks are "
                        "refracted and reflected by one eta");
    if (o->exit_planes)
        return prt_fail(ctx, PRT_ARG,
                        "--any-eta and --exit-planes exclude each other: the "
                        "directions of exit are refracted by one eta");
    for (uint32_t i = 0; i < o->media.n; i++)
        if (!(o->media.medium[i].eta >= nodes.low && o->media.medium[i].eta <= nodes.high))
            return prt_fail(ctx, PRT_ARG, "%s: eta is %g, --any-eta covers %g to %g",
                            o->media.medium[i].name, (double)o->media.medium[i].eta,
                            (double)nodes.low, (double)nodes.high);
    return PRT_OK;
}

static int check_options(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         struct prt_bake_options *o)
{
    double eta[PRT_MEDIA_MAX];
    int status = prt_bake_check_settings(ctx, o);
    if (!status) status = prt_media_check(ctx, &o->media, mesh->n_object);
    if (status) return status;
    if (o->engine != PRT_TRANSPORT_WAVELET && !o->any_eta &&
        prt_media_etas(&o->media, eta) > PRT_RADIAL_MORE_ETA + 1)
        return prt_fail(ctx, PRT_ARG,
                        "the media have more than %d values of eta: a joint or polynomial bake "
                        "takes no more",
                        PRT_RADIAL_MORE_ETA + 1);
    prt_bake_set_defaults(o);
    if (o->n_coef > 6 * o->cube * o->cube)
        return prt_fail(ctx, PRT_ARG, "--coeffs %u: must lie in [6, %u]", o->n_coef,
                        6 * o->cube * o->cube);
    if (o->engine != PRT_TRANSPORT_WAVELET && o->storage == PRT_STORAGE_SPARSE)
        return prt_fail(ctx, PRT_ARG, "--storage sparse goes with --transport wavelet only");
    if (o->draft && o->engine == PRT_TRANSPORT_POLYNOMIAL)
        return prt_fail(ctx, PRT_ARG, "--draft goes with --transport wavelet and joint only");
    if (o->engine == PRT_TRANSPORT_POLYNOMIAL && !o->env)
        return prt_fail(ctx, PRT_ARG, "--transport polynomial fixes the light: give it --env");
    if ((status = check_any_eta(ctx, o))) return status;
    if (o->basis > PRT_RADIAL_HAT || (o->basis && o->engine != PRT_TRANSPORT_POLYNOMIAL))
        return prt_fail(ctx, PRT_ARG,
                        "--basis polynomial and hat go with --transport polynomial only");
    if (o->n_shard > 1 && o->shard >= o->n_shard)
        return prt_fail(ctx, PRT_ARG, "--shard %u/%u: I must lie in [0, %u]", o->shard,
                        o->n_shard, o->n_shard - 1);
    return PRT_OK;
}

static double shortest_path(const struct bake *b)
{
    double finest = INFINITY;
    for (uint32_t c = 0; c < 3 * b->o.media.n; c++)
        finest = fmin(finest, 1 / b->dipole[c / 3][c % 3].sigma_t_prime);
    return finest;
}

// One sample a squared mean free path, within the limits above. A fixed medium whose path is
// long takes two and a half or more: the bunny in marble (50 mm) errs under studio, sunrise,
// grace and lobby by 0.755, 0.533, 0.244 and 0.158 % with 75,000 of them, with 90,000 by 0.747,
// 0.537, 0.228 and 0.156, with 60,000 by 0.798, 0.541, 0.262 and 0.164 (multiple scattering).
// Samples of a smaller number are among those of a larger one, and their rays are shared
// (row_store.c).
uint32_t prt_bake_sample_count(const struct bake *b)
{
    if (b->o.n_sample) return b->o.n_sample;
    double area = prt_surface_area(b->mesh), finest = shortest_path(b);
    double want = area / (finest * finest);
    if (want > most_samples)
        prt_log(b->ctx, PRT_LOG_WARNING,
                "the mean free path (%.3g mm) is short against the model: %.0f samples would "
                "resolve it, %.0f are used",
                finest, want, most_samples);
    double least = least_samples;
    if (b->o.engine == PRT_TRANSPORT_WAVELET && 2.5 * want <= few_samples) least = few_samples;
    return (uint32_t)fmin(fmax(want, least), most_samples);
}

struct cut_source prt_bake_cut_source(const struct bake *b)
{
    static const float draft_coarseness = 3; // see prt_bake_set_defaults
    return (struct cut_source){b->mesh, b->surface, b->hierarchy, b->clusters,
                               b->o.draft ? draft_coarseness : 1};
}

// A fifth of the mean free path, or for a free medium of that of the densest in METHODS' range.
float prt_bake_fine_mm(const struct bake *b)
{
    return b->o.engine == PRT_TRANSPORT_WAVELET ? (float)shortest_path(b) / 5 : 0.2f / 27;
}

uint32_t prt_bake_patterns(const struct prt_bake_options *o)
{
    return o->cube <= 32 ? 16 : o->cube <= 64 ? 8 : 4;
}

uint32_t prt_bake_cluster_size(const struct bake *b)
{
    const bool joint = b->o.engine == PRT_TRANSPORT_JOINT;
    const bool walks = b->o.scattering == PRT_SCATTERING_WALK, fixed_walks = walks && !joint;
    const uint32_t n = b->mesh->n_vertex;
    const uint32_t large = n / (joint ? 2 * most_clusters : most_clusters) + 1;
    const uint32_t small = n / (fixed_walks ? few_walk_clusters : few_clusters);
    const uint32_t usual = fixed_walks ? walk_cluster_vertices : cluster_vertices;
    uint32_t least = least_cluster;
    if (walks) least = joint ? usual : least_walk_cluster;
    if (small < usual) return small < least ? least : small;
    return large < usual ? usual : large;
}

uint32_t prt_bake_rank(const struct prt_bake_options *o, bool every_medium, uint32_t n_cluster)
{
    uint32_t rank = default_rank, spread = joint_columns / (n_cluster ? n_cluster : 1);
    if (every_medium && spread < rank) rank = spread > joint_rank ? spread : joint_rank;
    return o->rank ? o->rank : rank;
}

int prt_bake_dipoles(struct bake *b)
{
    b->dipole = prt_alloc(b->o.media.n, sizeof *b->dipole);
    if (!b->dipole) return PRT_NOMEM;
    for (uint32_t i = 0; i < b->o.media.n; i++)
        prt_material_dipoles(&b->o.media.medium[i], b->dipole[i]);
    return PRT_OK;
}

struct fresnel_table *prt_bake_fresnel(const struct prt_media *media)
{
    struct fresnel_table *table = prt_alloc(media->n, sizeof *table);
    for (uint32_t i = 0; table && i < media->n; i++)
        prt_fresnel_table_init(&table[i], (double)media->medium[i].eta);
    return table;
}

struct fresnel_table *prt_bake_node_fresnel(const struct prt_eta_nodes *nodes)
{
    struct fresnel_table *table = prt_alloc(nodes->n, sizeof *table);
    for (uint32_t i = 0; table && i < nodes->n; i++)
        prt_fresnel_table_init(&table[i], (double)nodes->node[i]);
    return table;
}

struct fresnel_table *prt_bake_single_fresnel(const struct bake *b)
{
    struct prt_eta_nodes nodes;
    return prt_bake_eta_nodes(b, PRT_FAMILY_EXTINCTION, &nodes) ? prt_bake_node_fresnel(&nodes)
                                                                : prt_bake_fresnel(&b->o.media);
}

bool prt_bake_eta_nodes(const struct bake *b, enum prt_radial_family family,
                        struct prt_eta_nodes *out)
{
    if (b->o.any_eta) prt_eta_nodes_default(family, out);
    return b->o.any_eta;
}

uint32_t prt_bake_medium(const struct bake *b, uint32_t cluster)
{
    return prt_media_index(&b->o.media, b->clusters->object[cluster]);
}

bool prt_bake_any_single(const struct bake *b)
{
    bool any = false;
    for (uint32_t i = 0; i < b->o.media.n; i++) any |= !b->o.media.medium[i].profile;
    return any;
}

// The kernels of pass 2: R_d of each medium.
static int make_kernels(struct bake *b)
{
    int status = prt_bake_dipoles(b);
    b->radial = prt_alloc(b->o.media.n, sizeof *b->radial);
    if (status || !b->radial) return PRT_NOMEM;
    for (uint32_t i = 0; i < b->o.media.n; i++) {
        float steepest = 0;
        for (int c = 0; c < 3; c++) steepest = fmaxf(steepest, (float)b->dipole[i][c].sigma_tr);
        b->radial[i] = (struct radial_set){3, dipole_eval, b->dipole[i], steepest};
    }
    return PRT_OK;
}

static int prepare(struct bake *b)
{
    uint64_t started = prt_work_begin_all();
    const struct prt_mesh *mesh = b->mesh;
    int status = make_kernels(b);
    if (status) return status;
    const float fine = prt_bake_fine_mm(b);
    const double finest = shortest_path(b);
    status = prt_scene_create(b->ctx, mesh, &b->scene);
    if (status == PRT_OK && !b->o.draft) status = prt_scene_refine(b->ctx, b->scene);
    bool any = prt_surface_area(mesh) > 0;
    if (status == PRT_OK && !any)
        prt_log(b->ctx, PRT_LOG_WARNING, "nothing is translucent: only shadows are baked");
    if (status == PRT_OK && any)
        status = prt_surface_create(b->ctx, mesh, prt_bake_sample_count(b), fine, b->o.seed,
                                    &b->surface);
    if (status == PRT_OK && any && b->o.engine == PRT_TRANSPORT_WAVELET)
        status = prt_surface_check(b->ctx, b->surface, mesh, finest, b->o.n_sample != 0);
    if (status == PRT_OK && any) status = prt_hierarchy_create(b->surface, &b->hierarchy);
    if (status == PRT_OK)
        status = prt_directions_create(b->ctx->cpu, b->o.cube, prt_bake_patterns(&b->o),
                                       b->o.seed, &b->directions);
    if (status == PRT_OK)
        status = prt_clusters_create(mesh, prt_bake_cluster_size(b), &b->clusters);
    if (status == PRT_OK && any && b->o.scattering == PRT_SCATTERING_WALK)
        status = prt_walks_create(b);
    if (status == PRT_OK && any && b->o.draft && b->o.walks_follow)
        status = prt_draft_walks_create(b);
    if (status == PRT_OK) {
        b->factored = calloc(b->clusters->n_cluster + 1u, sizeof *b->factored);
        b->rays_single = calloc(b->clusters->n_cluster + 1u, sizeof *b->rays_single);
        if (!b->factored || !b->rays_single) status = PRT_NOMEM;
        uint64_t spill = prt_bake_spill_bytes(b->ctx, mesh, &b->o);
        if (!status && spill) b->spill = prt_spill_create(b->ctx, spill);
    }
    prt_work_end_all(&b->work, WORK_SAMPLES, started);
    return status;
}

static struct single_plan plan_of_medium(struct bake *b, const struct prt_material *m)
{
    struct single_plan plan = {.cpu = b->ctx->cpu,
                               .scene = b->scene,
                               .mesh = b->mesh,
                               .directions = b->directions,
                               .n_eta = 1,
                               .eta = {m->eta},
                               .n_phase = b->o.n_phase,
                               .n_point = b->o.n_single,
                               .every_ray = b->o.every_ray,
                               .seed = b->o.seed,
                               .n_direction = b->directions->n_coef,
                               .work = &b->work};
    for (int c = 0; c < 3; c++) {
        plan.sigma_s[c] = m->sigma_s_prime[c] / (1 - m->g[c]);
        plan.sigma_t[c] = plan.sigma_s[c] + m->sigma_a[c];
        (void)prt_phase_hg(&plan.phase[c], m->g[c], b->o.n_phase);
    }
    return plan;
}

int prt_bake_plan_single(struct bake *b, const struct extinction_table *extinction,
                         uint32_t n_direction)
{
    struct prt_eta_nodes nodes;
    prt_bake_unplan_single(b);
    b->single = prt_alloc(b->o.media.n, sizeof *b->single);
    if (!b->single) return PRT_NOMEM;
    for (uint32_t i = 0; i < b->o.media.n; i++) {
        b->single[i] = plan_of_medium(b, &b->o.media.medium[i]);
        b->single[i].extinction = extinction;
        if (prt_bake_eta_nodes(b, PRT_FAMILY_EXTINCTION, &nodes)) {
            b->single[i].n_eta = nodes.n;
            memcpy(b->single[i].eta, nodes.node, nodes.n * sizeof *nodes.node);
        }
        if (n_direction) b->single[i].n_direction = n_direction;
        b->single[i].horizon = b->horizon;
        b->single[i].grid = b->grid;
        prt_single_plan_depths(&b->single[i]);
        b->horizon = b->single[i].horizon;
        b->grid = b->single[i].grid;
    }
    return PRT_OK;
}

void prt_bake_unplan_single(struct bake *b)
{
    prt_free(b->single);
    b->single = NULL;
}

int prt_bake_irradiance(struct bake *b)
{
    if (!b->surface || prt_shard_assembling(b) || prt_checkpoint_skips_rows(b)) return PRT_OK;
    struct prt_eta_nodes nodes;
    const bool any_eta = prt_bake_eta_nodes(b, PRT_FAMILY_DIPOLE, &nodes);
    const bool needed = !b->o.no_single && !b->o.draft; // by single scattering
    if (!b->horizon &&
        (needed || prt_irradiance_horizon_pays(b->directions, b->scene, b->surface->n_sample)))
        (void)prt_horizon_create( // without memory no direction is known
            b->scene, prt_horizon_more(b->mesh->n_vertex, b->surface->n_sample), &b->horizon);
    struct row_store *store = prt_row_store_open(b);
    struct irradiance_source from = {.scene = b->scene,
                                     .surface = b->surface,
                                     .hierarchy = b->hierarchy,
                                     .directions = b->directions,
                                     .checkpoint = b->checkpoint,
                                     .store = store,
                                     .work = &b->work,
                                     .horizon = b->horizon,
                                     .media = &b->o.media,
                                     .nodes = any_eta ? &nodes : NULL,
                                     .room = prt_bake_rows_room(&b->o)};
    int status = prt_irradiance_bake(b->ctx, &from, &b->irradiance);
    prt_row_store_close(store);
    if (b->o.no_single) {
        prt_horizon_destroy(b->horizon);
        b->horizon = NULL;
    }
    return status;
}

// Walks of each of the two references that the bake is held against; 0: the dipole.
static uint32_t reference_walks(const struct bake *b)
{
    if (!b->walk) return b->o.draft && b->o.walks_follow ? draft_walks : 0;
    return b->walk->n_walk < few_walks ? b->walk->n_walk : examining_walks;
}

// Relative errors of the finished bake as JSON, to free(). A polynomial bake is measured under
// the light that it fixed.
static int examine(struct bake *b, char **errors)
{
    struct prt_cube own = {0};
    bool fixed = b->o.engine == PRT_TRANSPORT_POLYNOMIAL;
    int status =
        fixed ? prt_env_to_cube(b->ctx, b->o.env, b->o.cube, b->o.rotate_deg, &own) : PRT_OK;
    const struct measure_options options = {
        .own = fixed ? &own : NULL,
        .n_vertex = examined_vertices,
        .least_samples = b->o.draft ? b->o.n_sample : reference_samples,
        .seed = b->o.seed,
        .draft = b->o.draft,
        .n_walk = reference_walks(b),
        .walked = b->walk ? b->walk->walked : prt_draft_walks_objects(b->draft_walks),
        .noise = prt_walks_noise(b)};
    if (status == PRT_OK) status = prt_measure_bake(b->ctx, &b->out, &options, errors);
    prt_cube_finish(&own);
    return status;
}

static void release(struct bake *b)
{
    for (uint32_t t = 0; t < b->out.n_tensor; t++) prt_tensor_finish(&b->out.tensor[t]);
    if (b->clusters) prt_bake_drop_factored(b);
    free(b->factored);
    prt_spill_destroy(b->spill);
    free(b->rays_single);
    prt_half_rows_finish(&b->irradiance);
    prt_horizon_destroy(b->horizon);
    prt_triangle_grid_destroy(b->grid);
    prt_clusters_destroy(b->clusters);
    prt_directions_destroy(b->directions);
    prt_hierarchy_destroy(b->hierarchy);
    prt_surface_destroy(b->surface);
    prt_bake_unplan_single(b);
    prt_walks_destroy(b->walk);
    prt_draft_walks_destroy(b->draft_walks);
    prt_bake_drop_lit(b);
    prt_scene_destroy(b->scene);
    prt_free(b->out.mesh.blocked);
    prt_free(b->dipole);
    prt_free(b->radial);
}

// A hash of everything that determines the clusters' contents: equal for all parts of one bake.
static int shard_key(const struct bake *b, uint64_t *out)
{
    char *settings = prt_bake_describe(b);
    if (!settings) return PRT_NOMEM;
    const uint32_t more[] = {b->o.rank,      b->o.n_basis_coef, b->o.no_single,
                             b->o.every_ray, b->o.basis,        b->o.walks_follow};
    uint64_t key = prt_hash64(settings, strlen(settings), b->out.mesh_hash);
    key = prt_hash64(more, sizeof more, key);
    free(settings);
    // The settings print a profile with few digits, and the mesh's hash covers no surfaces.
    const uint64_t media = prt_media_hash(&b->o.media, b->mesh->n_object);
    key = prt_hash64(&media, sizeof media, key);
    for (uint32_t i = 0; i < b->mesh->n_surface; i++) {
        const struct prt_surface *s = &b->mesh->surface[i];
        const uint32_t translucent = s->translucent;
        key = prt_hash64(s->base_color, sizeof s->base_color, key);
        key = prt_hash64(&translucent, sizeof translucent, key);
    }
    key = prt_hash64(&b->o.rotate_deg, sizeof b->o.rotate_deg, key);
    const struct prt_env *env = b->o.engine == PRT_TRANSPORT_POLYNOMIAL ? b->o.env : NULL;
    if (env && env->kind == PRT_ENV_CUBE)
        key = prt_hash64(env->cube.texel, (size_t)env->cube.n * env->cube.n * 72, key);
    else if (env)
        key = prt_hash64(env->latlong.rgb,
                         (size_t)env->latlong.width * env->latlong.height * 12, key);
    *out = key;
    return PRT_OK;
}

static int run_engine(struct bake *b)
{
    return b->o.engine == PRT_TRANSPORT_JOINT        ? prt_bake_joint(b)
           : b->o.engine == PRT_TRANSPORT_POLYNOMIAL ? prt_bake_polynomial(b)
                                                     : prt_bake_wavelet(b);
}

// Runs the engine on this process' clusters. When all other parts are complete it runs the
// engine once more, to assemble them.
static int run_shard(struct bake *b, const char *out_path, uint32_t *missing)
{
    *missing = 0;
    uint64_t key = 0;
    int status = b->o.n_shard > 1 || b->o.checkpoint ? shard_key(b, &key) : PRT_OK;
    if (status == PRT_OK) status = prt_checkpoint_open(b, key);
    if (status == PRT_OK) status = prt_shard_create(b, out_path, key);
    if (status == PRT_OK && !prt_shard_done(b)) status = run_engine(b);
    if (status == PRT_OK) status = prt_shard_close(b, missing);
    if (status == PRT_OK && b->shard) prt_checkpoint_close(b, true); // the part has it all
    if (status != PRT_OK || !prt_shard_assembling(b)) return status;
    for (uint32_t t = 0; t < b->out.n_tensor; t++) prt_tensor_finish(&b->out.tensor[t]);
    memset(b->out.tensor, 0, sizeof b->out.tensor);
    b->out.n_tensor = 0;
    prt_bake_unplan_single(b);
    return run_engine(b);
}

// Times are reported and not stored, so that equal bakes are equal bytes.
static int report_work(struct bake *b)
{
    struct prt_bake_profile *out = b->o.profile;
    if (!out) return PRT_OK;
    prt_work_report(&b->work, out);
    out->seconds = prt_time_s() - b->started;
    out->n_thread = prt_pool_size(b->ctx->pool);
    return b->surface ? prt_work_measure_limits(b->ctx, b->scene, b->surface, out) : PRT_OK;
}

// The sky that the model hides from its vertices, for specular occlusion of pictures.
static int add_blocked(struct bake *b)
{
    b->out.mesh.blocked = prt_alloc(b->mesh->n_vertex, sizeof *b->out.mesh.blocked);
    return b->out.mesh.blocked ? prt_scene_blocked(b->ctx, b->scene, b->out.mesh.blocked)
                               : PRT_NOMEM;
}

static int measure_and_write(struct bake *b, const char *out_path)
{
    char *errors = NULL;
    uint64_t started = prt_work_begin_all();
    int status = b->surface && !b->o.unmeasured ? examine(b, &errors) : PRT_OK;
    if (!status) prt_work_end_all(&b->work, WORK_ERRORS, started);
    if (!status) status = add_blocked(b);
    if (status) {
        free(errors);
        return status;
    }
    char *settings = prt_bake_describe(b);
    b->out.settings = settings;
    b->out.errors = errors ? errors : "{}";
    status = settings ? prt_file_write(b->ctx, out_path, &b->out) : PRT_NOMEM;
    free(settings);
    free(errors);
    return status == PRT_OK ? report_work(b) : status;
}

int prt_bake(const struct prt_context *ctx, const struct prt_mesh *mesh,
             const struct prt_bake_options *options, const char *out_path)
{
    struct bake b = {.ctx = ctx, .mesh = mesh, .o = *options, .started = prt_time_s()};
    uint32_t missing = 0;
    int status = check_options(ctx, mesh, &b.o);
    if (status) return status;
    if (!(mesh->mm_per_unit > 0))
        return prt_fail(ctx, PRT_ARG, "the model has no scale: prt_mesh_scale it first");
    openblas_set_num_threads(1); // the pool runs the clusters in parallel
    b.out.mesh = *mesh;
    b.out.mesh.owner = NULL;
    b.out.mesh.blocked = NULL;
    b.out.media = b.o.media;
    b.out.cube = b.o.cube;
    b.out.engine = b.o.engine;
    b.out.mesh_hash = prt_mesh_hash(mesh);
    status = prepare(&b);
    if (status == PRT_OK) status = run_shard(&b, out_path, &missing);
    if (status == PRT_OK && !missing) status = measure_and_write(&b, out_path);
    prt_checkpoint_close(&b, status == PRT_OK);
    prt_shard_destroy(&b, status == PRT_OK);
    if (options->parts_missing) *options->parts_missing = missing;
    release(&b);
    if (status == PRT_NOMEM)
        prt_fail(ctx, status,
                 "not enough memory for this bake: raise the limit of the process (ulimit -d, "
                 "prt's --memory), or ask for fewer samples or a smaller cube");
    return status;
}
