// SPDX-License-Identifier: MIT
// What a bake's settings need: bounds, memory and time.
//
// The estimate adds up the largest arrays that are held at once, stage by stage. It was
// compared with the largest VmHWM of the process; two threads, models 50 mm across, marble
// where a medium is wanted, those with * without single scattering:
//
//     model, vertices   transport   samples  cube  estimate  measured [MiB]  ratio
//     spot, 3225        wavelet        3000    16       131             124   1.06
//     spot, 3225        wavelet*       3000    32       222             170   1.31
//     spot, 3225        wavelet*       3000    64       574             480   1.20
//     dragon, 5891      sparse        20000    16       375             274   1.37
//     dragon, 5891      polynomial    20000    32       534             355   1.51
//     dragon, 5891      wavelet       20000    32       660             563   1.17
//     dragon, 5891      joint         20000    16       518             410   1.26
//     bunny, 34835      wavelet       30000    16       433             332   1.31
//     bunny, 34835      joint*        20000    16       888             704   1.26
//     bunny, 34835      wavelet      150000    32      3501            2970   1.18
//     bunny, 34835      joint        150000    32      5219            4608   1.13
#include "bake/cube_draw.h"
#include "bake/measure.h"
#include "bake/run.h"
#include "bake/walks.h"
#include "prt/bake_limits.h"
#include "prt/radial.h"
#include "prt/walk_grid.h"

#include <math.h>
#include <stdlib.h>
#include <unistd.h>

// Combinations that joint bases are trained with, a phase term (radials.c).
enum { TRAIN_REFLECTANCE = 28, TRAIN_EXTINCTION = 10 };
static const double PROGRAM = 46e6; // code and data of the program and its libraries
static const double A_THREAD = 5e6; // OpenBLAS' buffers as far as they are used, stacks
static const double MARGIN = 1.1;
enum { EXIT_SUPPORTS = 9000, EXIT_LIGHT = 6 * 8 * 8 };                      // of view.c
enum { DRAFT_SUPPORTS = 2500, DRAFT_LIGHT = 6 * 16 * 16, DRAFT_RANK = 16 }; // of view.c

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
                 {PRT_BAKE_SINGLE_POINTS, o->n_single},
                 {PRT_BAKE_WALKS, o->n_walk}};
    char reason[128];
    for (size_t i = 0; i < sizeof given / sizeof *given; i++)
        if (!prt_bake_setting_ok(given[i].setting, given[i].value, reason))
            return prt_fail(ctx, PRT_ARG, "--%s", reason);
    if (!prt_bake_error_ok(o->max_error, reason)) return prt_fail(ctx, PRT_ARG, "--%s", reason);
    return PRT_OK;
}

size_t prt_bake_rows_room(const struct prt_bake_options *options)
{
    long pages = sysconf(_SC_AVPHYS_PAGES), page = sysconf(_SC_PAGESIZE);
    size_t room = pages > 0 && page > 0 ? (size_t)pages * (size_t)page : SIZE_MAX;
    if (options->memory) room = options->memory;
    return room / 10 * 6;
}

// What decides a bake's memory, in the units of its allocations.
struct demand {
    const struct bake *b;
    double vertices, triangles, threads, samples, nodes, coef, area;
    bool spill;                 // rows of factored clusters are on disk
    double layers, paths;       // nodes of eta of pass 1's rows and of single scattering, or 1
    uint32_t n_cluster, widest; // clusters of vertices, vertices of the largest
    double ranks;               // columns of U that all clusters hold while they are factored
};

static void count_nodes(struct demand *d)
{
    struct prt_eta_nodes nodes;
    d->layers = prt_bake_eta_nodes(d->b, PRT_FAMILY_DIPOLE, &nodes) ? nodes.n : 1;
    d->paths = prt_bake_eta_nodes(d->b, PRT_FAMILY_EXTINCTION, &nodes) ? nodes.n : 1;
}

// Of the groups that clusters_create splits: one for each object and kind of surface.
static int count_clusters(struct demand *d, bool every_medium)
{
    const struct prt_mesh *mesh = d->b->mesh;
    uint32_t size = prt_bake_cluster_size(d->b), n_group = 2 * mesh->n_object;
    uint32_t *group = calloc(n_group + 1u, sizeof *group);
    if (!group) return PRT_NOMEM;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const struct prt_block *block = &mesh->block[i];
        group[2 * block->object + (mesh->surface[block->surface].translucent != 0)] +=
            block->n_vertex;
    }
    d->n_cluster = d->widest = 0;
    for (uint32_t i = 0; i < n_group; i++) {
        uint32_t n = group[i], pieces = n ? 1 : 0;
        for (; n > size; n = n / 2 + n % 2) pieces *= 2;
        d->n_cluster += pieces;
        d->widest = n > d->widest ? n : d->widest;
    }
    d->ranks = 0;
    uint32_t rank = prt_bake_rank(&d->b->o, every_medium, d->n_cluster);
    for (uint32_t i = 0; i < n_group; i++) {
        uint32_t n = group[i], pieces = 1;
        for (; n > size; n = n / 2 + n % 2) pieces *= 2;
        d->ranks += (double)pieces * (rank < n ? rank : n);
    }
    free(group);
    return PRT_OK;
}

// Columns of the widest cut: samples no further from the cluster than cells are integrated,
// and nodes that grow with distance, as cluster_kernel.c opens them. Measured, not derived.
static double cut_columns(const struct demand *d)
{
    double spacing = sqrt(d->area / fmax(d->samples, 1)), side = sqrt(d->area / d->n_cluster);
    double near = pow(side / spacing + 7, 2), far = 850 * log(1 + sqrt(d->area) / spacing);
    return fmin(3 * near + far, 0.9 * d->samples);
}

// Functions of a free medium, at every node of eta; of its basis: 14, 15 and 17 were found for
// models of 20, 50 and 200 mm, one more where three times the size is covered.
static double basis_size(const struct demand *d, bool extinction)
{
    const struct prt_bake_options *o = &d->b->o;
    double pieces = extinction ? 8 : 16, reach = prt_mesh_diagonal(d->b->mesh);
    if (o->engine == PRT_TRANSPORT_WAVELET) return 3;
    if (o->basis == PRT_RADIAL_POLYNOMIAL) return 2 * pieces;
    if (o->basis == PRT_RADIAL_HAT) return pieces + 1;
    double finer = fmax(log(PRT_BAKE_ERROR_DEFAULT / o->max_error), 0);
    double size = ceil(fmax(11 + log(fmax(reach, 1)) + 2 * finer, 4)) + (extinction ? 1 : 0);
    return size * (extinction ? d->paths : d->layers);
}

// A thread's arrays while one cluster is factored (factor.c): functions stored, trained ones,
// lights, with a cut of `columns` (0: rows that were made otherwise).
static double factor_bytes(const struct demand *d, double functions, double trained,
                           double probes, double columns)
{
    enum { ROWS_AT_ONCE = 192 }; // sources.c
    double n = d->widest, J = functions, C = columns * d->layers;
    double rank = fmin(prt_bake_rank(&d->b->o, trained > J, d->n_cluster), n);
    double answers = J * n * (probes + 6) * 4, some = C > 0 ? ROWS_AT_ONCE * d->coef * 4 : 0;
    double multiply = some + C * probes * 4 + trained * n * probes * 4;
    double basis = trained * n * probes * 12 + n * n * 8 + 3 * n * rank * 8;
    double made = C > 0 && trained > J ? fmin(J, MAX_COMPONENTS) / 2 : J; // of a row, functions
    double project = rank * made * (d->coef + C) * 4 + some;
    double faces = trained > J ? (probes + 6) * d->coef * 4 : 0;
    return J / d->layers * n * columns * 4 + columns * 16 + answers +
           fmax(fmax(multiply, basis) + faces, project);
}

// All clusters' factors: halves of each function or direction, and floats of their energy.
static double factors(const struct demand *d, double functions, bool every_medium)
{
    double wide = every_medium ? fmin(functions, MAX_COMPONENTS) : functions;
    double a_column = ((d->spill ? 0 : 2 * wide) + 4) * d->coef + 4 * d->widest;
    if (every_medium) a_column += (wide + 6) * functions * 4;
    return d->ranks * a_column;
}

static double packed(const struct demand *d, enum prt_term term, double functions)
{
    double all = d->ranks * (d->coef * (2 * functions + 2) + 4 * d->widest);
    return fmin(prt_bake_byte_budget(d->b, term, d->b->o.n_phase), all);
}

static double horizon(const struct demand *d)
{
    const double n =
        d->vertices + prt_horizon_more((uint32_t)d->vertices, (uint32_t)d->samples);
    return n * (8.0 * prt_horizon_words((uint32_t)n) + 25) + 34 * d->vertices;
}

// A thread's arrays of single scattering: cells of a cluster's vertices (cells.c), its rays.
static double single_bytes(const struct demand *d, double functions)
{
    double cells = d->widest * d->coef * (4 + functions);
    double arrays = SINGLE_MAX_NODES * (5 * d->paths + 2 + 2) + 4 + functions;
    double rays = arrays * d->coef * 4 + (double)prt_draw_bytes(0, 0);
    return cells + rays;
}

// A thread's arrays of a free medium's walks in a cluster: answers and smoothing matrices of
// all media of the grid, hits, and the work on one level.
static double free_walk_bytes(const struct demand *d)
{
    struct prt_walk_grid grid;
    prt_walk_grid_default(&grid);
    const bool joint = d->b->o.engine == PRT_TRANSPORT_JOINT;
    const double n = d->widest, lights = joint ? JOINT_PROBES + 6 : 3, nodes = grid.n_node;
    const double media = grid.n_level * nodes, walks = d->b->o.n_walk ? d->b->o.n_walk : 256;
    const double hits = joint ? grid.n_level * walks * n * 8 : 0;
    const double fields = media * n * 24 * 12; // of the clusters that choose the functions
    return fmax(media * n * lights * 4, fields) + media * n * n * 4 + hits +
           3 * nodes * n * lights * 4 + n * n * (nodes * 12 + 6 * 4 + 16) + d->samples * 4;
}

// A thread's arrays of walks in a cluster: the halves' and the dipole's answers, the smoothing
// of three channels, and its work in doubles. The grid of distances is beside them.
static double walk_bytes(const struct demand *d)
{
    const double n = d->widest, probes = WAVELET_PROBES;
    if (d->b->o.scattering != PRT_SCATTERING_WALK) return 0;
    if (d->b->o.engine != PRT_TRANSPORT_WAVELET) return free_walk_bytes(d);
    return 3 * n * probes * 12 + 9 * n * n * 4 + 5 * n * n * 8 + n * probes * 40 +
           d->samples * 4 + 2e6 / d->threads;
}

static double sparse_bytes(const struct demand *d, double functions)
{
    return d->vertices * (16 * functions + d->b->o.n_coef * (4 + functions));
}

static double sparse_scratch(const struct demand *d, double functions, double columns)
{
    double n = d->widest;
    return n * n * 4 + n * functions * (d->coef + 2 * columns) * 4 + 192 * d->coef * 4;
}

// The largest of the stages, above what is held all along.
static double stages(struct demand *d, double rows)
{
    const struct prt_bake_options *o = &d->b->o;
    const bool joint = o->engine == PRT_TRANSPORT_JOINT;
    const bool sparse = o->storage == PRT_STORAGE_SPARSE;
    const double multiple = basis_size(d, false), single = o->n_phase * basis_size(d, true);
    const double columns = cut_columns(d);
    if (o->engine == PRT_TRANSPORT_POLYNOMIAL) {
        double kept = d->vertices * 6 * (multiple + single) + (d->samples + d->nodes) * 12;
        double cut = multiple * d->widest * columns * 4 + columns * 16;
        double rays = single_bytes(d, 0) - d->widest * d->coef * 4.0;
        return kept + fmax(d->threads * fmax(cut + walk_bytes(d), rays), horizon(d));
    }
    double probes = joint ? JOINT_PROBES : WAVELET_PROBES, lights = d->coef * probes * 4;
    double lit = sparse ? 0 : (d->samples + d->nodes) * d->layers * (probes + 6) * 4;
    if (o->scattering == PRT_SCATTERING_WALK && !joint)
        lit = (d->samples + d->nodes) * probes * 4;
    double first = rows + horizon(d), second, third = 0;
    if (!o->no_single) rows += horizon(d); // held until single scattering is there
    if (sparse) {
        second = rows + lit + sparse_bytes(d, multiple) +
                 d->threads * (sparse_scratch(d, multiple, columns) + walk_bytes(d));
        third = sparse_bytes(d, multiple) + sparse_bytes(d, single) + horizon(d) +
                d->threads * (single_bytes(d, single) + sparse_scratch(d, single, 0));
    } else {
        double tensor = packed(d, PRT_TERM_MULTIPLE, multiple);
        double train = joint ? TRAIN_REFLECTANCE * d->layers : multiple;
        second = rows + lit + factors(d, multiple, joint) +
                 fmax(d->threads *
                          (factor_bytes(d, multiple, train, probes, columns) + walk_bytes(d)),
                      tensor);
        if (o->scattering == PRT_SCATTERING_WALK) second += tensor;
        train = joint ? TRAIN_EXTINCTION * o->n_phase * fmin(d->paths, 2) : single;
        // rows of all supports of a draft; else those of a cluster and its rays
        const double supports = fmin(DRAFT_SUPPORTS, d->vertices) * single * DRAFT_LIGHT * 2;
        const double held = o->draft ? supports : horizon(d);
        const double own = o->draft ? 0 : single_bytes(d, single);
        struct demand last = *d;
        if (o->draft) last.ranks = fmin(d->ranks, DRAFT_RANK * (double)d->n_cluster);
        // The allocator may keep what the threads freed: their arrays are counted beside the
        // packed tensor.
        third = tensor + held + factors(&last, single, joint) +
                d->threads * (own + factor_bytes(d, single, train, probes, 0)) +
                packed(&last, PRT_TERM_SINGLE, single);
    }
    if (o->exit_planes && !o->draft)
        third += EXIT_SUPPORTS * 9 * basis_size(d, true) * EXIT_LIGHT * 2;
    if (o->no_single || (!prt_bake_any_single(d->b) && !joint)) third = 0;
    return fmax(first, lights + fmax(second, third));
}

// The bake is measured against the reference's samples, when its rows and factors are gone.
static double measuring(const struct demand *d)
{
    bool fixed = d->b->o.engine == PRT_TRANSPORT_WAVELET;
    double densest = fixed ? 0 : 27; // METHODS' range of a free medium [mm^-1]
    for (uint32_t c = 0; fixed && c < 3 * d->b->o.media.n; c++)
        densest = fmax(densest, d->b->dipole[c / 3][c % 3].sigma_t_prime);
    uint64_t making, kept;
    double n = fmin(fmax(60000, d->area * densest * densest / 4e4), 2e7);
    prt_surface_memory(d->b->mesh, (uint32_t)n, (float)(1 / densest / 8), &making, &kept);
    return (double)making + n * 12 * MEASURE_LIGHTS + d->vertices * 12;
}

// Embree's tree with what it takes to build it, the mesh and the file it came from, textures.
static double model_bytes(const struct prt_mesh *mesh)
{
    return mesh->n_vertex * 150.0 + mesh->n_triangle * 350.0 + (double)mesh->texel_bytes;
}

// ---- time

// CPU seconds of one core of a 2.x GHz server with AVX2, a unit of work each: fitted to
// --profile of 14 bakes (spot of 3,225 vertices, a dragon of 5,891, a bunny of 34,835; 3,000 to
// 30,000 samples; cubes of 16 and 32; marble and ketchup; a walk bake, a draft), which it meets
// within a factor of 1.45.
struct price {
    double ray;        // of pass 1: a sample and a texel
    double exit;       // single scattering: a vertex and a texel
    double projection; // factors: a vertex and a texel
    double pack;       // the same, done once
    double vertex;     // cuts, products, range
    double measuring;  // against the reference
    double walk;       // a vertex and a walk
};
static const struct price prices[] = {
    [PRT_TRANSPORT_WAVELET] = {1e-7, 5e-7, 1e-7, 6e-8, 3e-4, 4.6, 2e-5},
    [PRT_TRANSPORT_POLYNOMIAL] = {1e-8, 2e-7, 0, 0, 6e-4, 4, 2e-5},
    [PRT_TRANSPORT_JOINT] = {1e-7, 1.25e-6, 7e-7, 5e-7, 8e-4, 8, 7e-5},
};
enum { MOST_FACTORED = 80000 }; // vertices: clusters of larger models grow, their ranks do not

// *once: of it what every shard does again, or one alone: pass 1, packing, measuring.
static void count_seconds(const struct demand *d, double *seconds, double *once)
{
    const struct prt_bake_options *o = &d->b->o;
    const struct price *p = &prices[o->engine];
    const bool single = !o->no_single && prt_bake_any_single(d->b);
    const double texels = d->coef, factored = fmin(d->vertices, MOST_FACTORED);
    const double draft = o->draft ? 0.1 : 1, walks = prt_walks_each(o, (uint32_t)d->vertices);
    double rays = 7e-6 * d->samples + p->ray * (o->draft ? 0.6 : 1) * d->samples * texels;
    double measured = p->measuring * (o->draft ? 0.3 : single ? 1 : 0.7) + 7e-5 * d->vertices;
    double pack = p->pack * fmin(d->vertices, MOST_FACTORED / 8) * texels;
    double parts = p->vertex * d->vertices + p->projection * factored * texels;
    if (single || (o->engine == PRT_TRANSPORT_JOINT && !o->no_single))
        parts += p->exit * draft * d->vertices * texels;
    if (o->scattering == PRT_SCATTERING_WALK) {
        parts += p->walk * d->vertices * walks;
        measured *= 4;
    }
    if (o->any_eta) rays *= 1.1, parts *= 1.9; // of spot, 54 -> 60 s and 48 -> 95 s
    *once = rays + measured + pack;
    *seconds = *once + parts;
}

struct needs {
    uint64_t bytes;
    double cpu_s, once_s;
};

// spill: the bake keeps the rows of factored clusters on disk.
static int estimate(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    const struct prt_bake_options *options, bool spill, struct needs *out)
{
    struct prt_context quiet = ctx ? *ctx : (struct prt_context){0};
    struct bake b = {.ctx = &quiet, .mesh = mesh, .o = *options};
    int status = prt_bake_check_settings(ctx, options);
    if (!status) status = prt_media_check(ctx, &options->media, mesh->n_object);
    if (status) return status;
    prt_bake_set_defaults(&b.o);
    if ((status = prt_bake_dipoles(&b))) return status;
    quiet.log = prt_log_none;
    struct demand d = {.b = &b,
                       .spill = spill,
                       .vertices = mesh->n_vertex,
                       .triangles = mesh->n_triangle,
                       .threads = prt_pool_size(ctx ? ctx->pool : NULL),
                       .coef = 6.0 * b.o.cube * b.o.cube,
                       .area = prt_surface_area(mesh)};
    count_nodes(&d);
    status = count_clusters(&d, b.o.engine == PRT_TRANSPORT_JOINT);
    if (status) {
        prt_free(b.dipole);
        return status;
    }
    uint64_t making = 0, kept = 0;
    if (d.area > 0) {
        uint32_t n = prt_bake_sample_count(&b);
        d.samples = n;
        d.nodes = (double)prt_hierarchy_most_nodes(n, mesh->n_object);
        prt_surface_memory(mesh, n, prt_bake_fine_mm(&b), &making, &kept);
    }
    double rows = (d.samples + d.nodes) * (d.layers > 1 ? 1.25 : 1) * d.coef * 2;
    if (rows > (double)prt_bake_rows_room(&b.o)) rows = 0; // they are on disk
    double trees = d.samples * (8 + 4) + d.nodes * sizeof(struct node);
    double rays = prt_bake_patterns(&b.o) * d.coef * SUBS * 24;
    double work = d.area > 0 ? fmax(stages(&d, rows), measuring(&d)) : stages(&d, 0);
    double held = (double)kept + trees + rays + model_bytes(mesh);
    double all = PROGRAM + d.threads * A_THREAD + fmax(held + work, (double)making);
    out->bytes = (uint64_t)(MARGIN * all);
    count_seconds(&d, &out->cpu_s, &out->once_s);
    prt_free(b.dipole);
    return PRT_OK;
}

int prt_bake_memory(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    const struct prt_bake_options *options, uint64_t *bytes)
{
    struct needs needs = {0};
    int status = estimate(ctx, mesh, options, false, &needs);
    if (!status && options->memory && needs.bytes > options->memory)
        status = estimate(ctx, mesh, options, true, &needs);
    if (!status) *bytes = needs.bytes;
    return status;
}

int prt_bake_seconds(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_bake_options *options, double *cpu_s, double *once_s)
{
    struct needs needs = {0};
    int status = estimate(ctx, mesh, options, false, &needs);
    if (status) return status;
    *cpu_s = needs.cpu_s;
    *once_s = needs.once_s;
    return PRT_OK;
}

uint64_t prt_bake_spill_bytes(const struct prt_context *ctx, const struct prt_mesh *mesh,
                              const struct prt_bake_options *options)
{
    struct needs all = {0}, rest = {0};
    if (!options->memory || estimate(ctx, mesh, options, false, &all) ||
        all.bytes <= options->memory || estimate(ctx, mesh, options, true, &rest) ||
        rest.bytes >= all.bytes)
        return 0;
    return 2 * (all.bytes - rest.bytes) +
           (UINT64_C(1) << 30); // a sparse file: what is not used costs nothing
}
