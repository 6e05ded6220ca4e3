// SPDX-License-Identifier: MIT
// The media at which a free medium's walks are known, and the few functions that are stored:
// the leading directions of the media's answers in some clusters of the body, to fields of
// irradiance on its surface that no light needs to be known for. Clusters that are walked and
// those that the dipole serves have functions of their own: a medium that absorbs much returns
// far more light by the dipole, beside which the error of a function could hide the walks'.
#include "bake/free_walks.h"
#include "bake/sources.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

// The highest level that is walked [mm^-1]; at the next one the mean free path is a 15th of a
// millimetre and the dipole's error is one factor.
static const float last_walked = 10;
// Directions of either kind: as many as leave this share of no medium's answers out, root mean
// square over media, and at most the number below.
static const double left_out = 0.002;
enum { MOST_FUNCTIONS = 24, FIELDS = 24, PILOTS = 8 };
// Answers of media below this share of the largest count as this share in the training.
static const double least_share = 0.05;

static int fit_medium(const struct prt_radial *radial, double eta, double sigma_s_prime,
                      double sigma_a, float *out)
{
    struct prt_material m = {.eta = (float)eta};
    float coef[64 * 3];
    for (int c = 0; c < 3; c++)
        m.sigma_s_prime[c] = (float)sigma_s_prime, m.sigma_a[c] = (float)sigma_a;
    int status = prt_radial_fit_material(radial, &m, coef, NULL);
    for (uint32_t j = 0; j < radial->n_function && !status; j++) out[j] = coef[3 * j];
    return status;
}

// The media, and the ratios above the last walked level, as the dipole answers them.
static int fit_media(const struct bake *b, const struct bases *bases, struct walk_pool *p)
{
    const uint32_t J = p->grid.n_node, F = p->n_radial, n_above = p->n_media - p->n_walked;
    const float top = p->grid.level[p->last_level];
    double weight[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_NODES];
    int status = PRT_OK;
    for (uint32_t o = 0; o < b->o.media.n && !status; o++) {
        const double eta = (double)b->o.media.medium[o].eta;
        for (uint32_t i = 0; i < p->n_media && !status; i++)
            status = fit_medium(bases->reflectance, eta, (double)p->grid.level[i / J],
                                (double)p->grid.node[i % J],
                                p->dipole + ((size_t)o * p->n_media + i) * F);
        for (uint32_t i = 0; i < n_above && !status; i++) {
            const float level = p->grid.level[(p->n_walked + i) / J];
            const double sigma_a = (double)(p->grid.node[i % J] * top / level);
            prt_walk_grid_weights(&p->grid, eta, (double)top, sigma_a, weight, NULL);
            for (uint32_t j = 0; j < J; j++)
                p->ratio_mix[i * J + j] = (float)weight[p->last_level * J + j];
            status = fit_medium(bases->reflectance, eta, (double)top, sigma_a,
                                p->ratio_basis + ((size_t)o * n_above + i) * F);
        }
    }
    return status;
}

// ---- fields of irradiance: even light, and waves of lengths from the body's size downwards

static void fill_waves(const struct bake *b, float wave[FIELDS][4])
{
    struct prt_rng rng;
    const float size = prt_mesh_diagonal(b->mesh);
    prt_rng_init(&rng, b->o.seed, 0x3f1e);
    memset(wave, 0, FIELDS * sizeof *wave);
    for (int i = 1; i < FIELDS; i++) {
        const float z = 2 * prt_rng_f32(&rng) - 1, phi = 2 * (float)M_PI * prt_rng_f32(&rng);
        const float side = sqrtf(fmaxf(1 - z * z, 0));
        const float waves = 2 * (float)M_PI / size * powf(32, (float)(i - 1) / (FIELDS - 2));
        wave[i][0] = waves * side * cosf(phi), wave[i][1] = waves * side * sinf(phi);
        wave[i][2] = waves * z, wave[i][3] = 2 * (float)M_PI * prt_rng_f32(&rng);
    }
}

// The fields at the samples in the order of the tree, and the means of the nodes.
static int fill_fields(const struct bake *b, struct lit_rows *out)
{
    const struct hierarchy *h = b->hierarchy;
    const struct prt_surface_points *s = b->surface;
    const uint32_t n = s->n_sample;
    float wave[FIELDS][4];
    *out = (struct lit_rows){FIELDS, NULL, NULL};
    out->value = prt_alloc(((size_t)n + h->n_node) * FIELDS, sizeof *out->value);
    if (!out->value) return PRT_NOMEM;
    out->light = out->value; // no texels: a name for the products
    fill_waves(b, wave);
    for (uint32_t i = 0; i < n; i++) {
        const float *x = s->position[h->order[i]];
        for (int f = 0; f < FIELDS; f++)
            out->value[(size_t)i * FIELDS + f] = cosf(
                f ? wave[f][0] * x[0] + wave[f][1] * x[1] + wave[f][2] * x[2] + wave[f][3] : 0);
    }
    for (uint32_t i = h->n_node; i-- > 0;) {
        const struct node *node = &h->node[i];
        double sum[FIELDS] = {0}, area = 0;
        for (uint32_t k = 0; k < (node->child[0] ? 2 : node->count); k++) {
            const uint32_t row = node->child[0] ? n + node->child[k] : node->begin + k;
            const float own = node->child[0] ? h->node[node->child[k]].area
                                             : s->area[h->order[node->begin + k]];
            for (int f = 0; f < FIELDS; f++)
                sum[f] += (double)own * (double)out->value[(size_t)row * FIELDS + f];
            area += (double)own;
        }
        for (int f = 0; f < FIELDS; f++)
            out->value[((size_t)n + i) * FIELDS + f] = area > 0 ? (float)(sum[f] / area) : 0;
    }
    return PRT_OK;
}

// ---- directions

struct pilot {
    const struct bake *b;
    const struct walk_pool *pool;
    const struct lit_rows *lit;
    struct radial_set radial;
    uint32_t n_walk, n, n_walked, cluster[2 * PILOTS]; // the walked ones first
    double *gram, *even; // [2 PILOTS][n_media][n_media], [2 PILOTS][n_media] squares of even
                         // light
};

// Answers of walks, [n_media][n_vertex][FIELDS].
static int walked_answers(const struct pilot *p, uint32_t c, const struct cut *cut, double *y)
{
    const size_t all = (size_t)p->pool->n_media * p->b->clusters->cluster[c].n_vertex * FIELDS;
    const struct free_walks_job job = {p->b, p->pool, cut, p->lit, NULL, c, p->n_walk, false};
    struct free_walks walks = {0};
    int status = prt_free_walks_run(&job, &walks);
    for (size_t k = 0; k < all && !status; k++) y[k] = (double)walks.answer[k];
    prt_free_walks_finish(&walks);
    return status;
}

// The same of the dipole.
static int dipole_answers(const struct pilot *p, uint32_t c, const struct cut *cut, double *y)
{
    const struct walk_pool *pool = p->pool;
    const uint32_t n = p->b->clusters->cluster[c].n_vertex, F = pool->n_radial;
    const size_t block = (size_t)n * FIELDS, N = pool->n_media;
    const float *of = pool->dipole + prt_bake_medium(p->b, c) * N * F;
    struct half_rows none = {.n_layer = 1};
    struct product_rows product = {&none, cut, n, F, p->lit, NULL, NULL};
    float *one = prt_alloc(F * block, sizeof *one), *all = prt_alloc(N * block, sizeof *all);
    int status =
        one && all ? prt_product_multiply(&product, p->lit->light, FIELDS, one) : PRT_NOMEM;
    if (!status)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)N, (int)block, (int)F, 1,
                    of, (int)F, one, (int)block, 0, all, (int)block);
    for (size_t k = 0; k < N * block && !status; k++) y[k] = (double)all[k];
    prt_free(one);
    prt_free(all);
    return status;
}

static int pilot_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct pilot *p = arg;
    const struct bake *b = p->b;
    const size_t N = p->pool->n_media;
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t i = begin; i < end && !status; i++) {
        struct cut cut = {0};
        const uint32_t c = p->cluster[i], n_vertex = b->clusters->cluster[c].n_vertex;
        const size_t block = (size_t)n_vertex * FIELDS;
        const struct cut_source from = prt_bake_cut_source(b);
        double *y = prt_alloc(N * block, sizeof *y);
        status = y ? prt_cut_build(b->ctx, &from, c, &p->radial, &cut) : PRT_NOMEM;
        if (!status)
            status = (prt_walks_in(b, c) ? walked_answers : dipole_answers)(p, c, &cut, y);
        if (!status)
            cblas_dsyrk(CblasRowMajor, CblasLower, CblasNoTrans, (int)N, (int)block, 1, y,
                        (int)block, 0, p->gram + i * N * N, (int)N);
        for (size_t k = 0; k < N && !status; k++) {
            double sum = 0;
            for (size_t v = 0; v < n_vertex; v++)
                sum += y[k * block + v * FIELDS] * y[k * block + v * FIELDS];
            p->even[i * N + k] = sum / n_vertex / p->n;
        }
        prt_free(y);
        prt_cut_finish(&cut);
    }
    return status;
}

// Up to PILOTS clusters that are walked, or that the dipole serves, spread evenly.
static void choose_pilots(struct pilot *p, bool walked)
{
    const struct bake *b = p->b;
    const uint32_t n = b->clusters->n_cluster, first = p->n;
    uint32_t found = 0, seen = 0;
    for (uint32_t c = 0; c < n; c++)
        found += b->clusters->translucent[c] && prt_walks_in(b, c) == walked;
    const uint32_t want = found < PILOTS ? found : PILOTS;
    for (uint32_t c = 0; c < n && p->n < first + want; c++) {
        if (!b->clusters->translucent[c] || prt_walks_in(b, c) != walked) continue;
        if (seen * want >= (p->n - first) * found) p->cluster[p->n++] = c;
        seen++;
    }
}

// Appends functions of one kind to the pool: the leading eigenvectors of the media's
// correlations. gram [n_media][n_media]: its answers' products, lower; overwritten. most: the
// largest answer of all kinds.
static int add_functions(double *gram, unsigned kind, double most, struct walk_pool *p)
{
    const uint32_t N = p->n_media, first = p->n_function;
    double *value = prt_alloc(2 * (size_t)N, sizeof *value), *norm = value + N, left = N;
    uint32_t D = 0;
    if (!value) return PRT_NOMEM;
    for (uint32_t i = 0; i < N;
         i++) // a medium without an answer, of few walks, has no direction
        norm[i] = fmax(sqrt(gram[i * N + i]), fmax(1e-9 * most, 1e-30));
    for (uint32_t i = 0; i < N; i++)
        for (uint32_t j = 0; j <= i; j++) gram[i * N + j] /= norm[i] * norm[j];
    int status = LAPACKE_dsyevd(LAPACK_ROW_MAJOR, 'V', 'L', (int)N, gram, (int)N, value)
                     ? PRT_INTERNAL
                     : PRT_OK;
    for (; D < MOST_FUNCTIONS && D < N && left > left_out * left_out * N; D++)
        left -= value[N - 1 - D];
    for (uint32_t d = 0; d < D && !status; d++)
        for (uint32_t i = 0; i < N; i++) {
            const double x = gram[(size_t)i * N + (N - 1 - d)];
            const size_t at = (size_t)(first + d) * N + i;
            p->mix[at] = (float)(x * most / norm[i] / sqrt(N));
            p->basis[at] = (float)(x * norm[i] / most * sqrt(N));
        }
    p->n_own[kind] = D;
    p->n_function += D;
    prt_free(value);
    return status;
}

// Sums the answers of the pilots of one kind: products in the first one's place, and the
// answers to even light.
static void sum_kind(const struct pilot *pilot, unsigned kind, struct walk_pool *p)
{
    const size_t N = p->n_media;
    const uint32_t begin = kind ? pilot->n_walked : 0;
    const uint32_t end = kind ? pilot->n : pilot->n_walked;
    double *gram = pilot->gram + begin * N * N;
    for (size_t i = 0; i < N; i++) {
        double even = 0;
        for (size_t k = begin; k < end; k++) even += pilot->even[k * N + i];
        p->norm[kind][i] = (float)sqrt(even) + 1e-12f;
        for (size_t k = 1; k < end - begin; k++)
            for (size_t j = 0; j <= i; j++) gram[i * N + j] += gram[(k * N + i) * N + j];
    }
}

// The functions of both kinds.
static int choose_functions(const struct pilot *pilot, struct walk_pool *p)
{
    const size_t N = p->n_media;
    const bool any[2] = {pilot->n_walked > 0, pilot->n > pilot->n_walked};
    double *gram[2] = {pilot->gram, pilot->gram + pilot->n_walked * N * N}, most = 0;
    int status = PRT_OK;
    for (unsigned kind = 0; kind < 2; kind++) {
        sum_kind(pilot, kind, p);
        for (size_t i = 0; i < N && any[kind]; i++)
            most = fmax(most, sqrt(gram[kind][i * N + i]));
    }
    for (unsigned kind = 0; kind < 2 && !status; kind++)
        if (any[kind]) status = add_functions(gram[kind], kind, most, p);
    return status;
}

static int find_functions(const struct bake *b, const struct bases *bases, struct walk_pool *p)
{
    const size_t N = p->n_media;
    struct lit_rows fields = {0};
    struct pilot pilot = {.b = b, .pool = p, .lit = &fields, .n_walk = b->walk->n_walk};
    pilot.radial = prt_bases_radial_set(bases);
    pilot.gram = prt_calloc(2 * PILOTS * N * N, sizeof *pilot.gram);
    pilot.even = prt_calloc(2 * PILOTS * N, sizeof *pilot.even);
    choose_pilots(&pilot, true);
    pilot.n_walked = pilot.n;
    choose_pilots(&pilot, false);
    int status = pilot.gram && pilot.even ? fill_fields(b, &fields) : PRT_NOMEM;
    if (!status) status = prt_parallel_for(b->ctx, "walks", pilot.n, 1, pilot_range, &pilot);
    if (!status) status = choose_functions(&pilot, p);
    prt_free(fields.value);
    prt_free(pilot.gram);
    prt_free(pilot.even);
    return status;
}

int prt_walk_pool_create(const struct bake *b, const struct bases *bases, struct walk_pool *p)
{
    *p = (struct walk_pool){.n_radial = bases->reflectance->n_function};
    prt_walk_grid_default(&p->grid);
    while (p->last_level + 1 < p->grid.n_level &&
           p->grid.level[p->last_level + 1] <= last_walked)
        p->last_level++;
    p->n_media = p->grid.n_level * p->grid.n_node;
    p->n_walked = (p->last_level + 1) * p->grid.n_node;
    const size_t n_above = p->n_media - p->n_walked, n = b->o.media.n;
    p->dipole = prt_alloc(n * p->n_media * p->n_radial, sizeof *p->dipole);
    p->ratio_mix = prt_alloc(n_above * p->grid.n_node, sizeof *p->ratio_mix);
    p->ratio_basis = prt_alloc(n * n_above * p->n_radial, sizeof *p->ratio_basis);
    p->mix = prt_alloc(2 * MOST_FUNCTIONS * (size_t)p->n_media, sizeof *p->mix);
    p->basis = prt_alloc(2 * MOST_FUNCTIONS * (size_t)p->n_media, sizeof *p->basis);
    for (unsigned kind = 0; kind < 2; kind++)
        p->norm[kind] = prt_alloc(p->n_media, sizeof *p->norm[kind]);
    int status = p->dipole && p->ratio_mix && p->ratio_basis && p->mix && p->basis &&
                         p->norm[0] && p->norm[1]
                     ? PRT_OK
                     : PRT_NOMEM;
    if (!status) status = fit_media(b, bases, p);
    if (!status) status = find_functions(b, bases, p);
    if (status == PRT_INTERNAL)
        prt_fail(b->ctx, status, "LAPACK found no directions of the media's answers");
    if (status) prt_walk_pool_finish(p);
    return status;
}

void prt_walk_pool_finish(struct walk_pool *p)
{
    prt_free(p->dipole);
    prt_free(p->ratio_mix);
    prt_free(p->ratio_basis);
    prt_free(p->mix);
    prt_free(p->basis);
    prt_free(p->norm[0]);
    prt_free(p->norm[1]);
    *p = (struct walk_pool){0};
}

int prt_walk_pool_record(const struct walk_pool *p, struct prt_tensor *t)
{
    const uint32_t n_level = p->grid.n_level, n_node = p->grid.n_node;
    const size_t all = (size_t)p->n_function * p->n_media;
    float *knot = prt_alloc(n_level + n_node, sizeof *knot), *basis = prt_alloc(all, 4);
    t->knot = knot, t->basis = basis;
    if (!knot || !basis) return PRT_NOMEM;
    memcpy(knot, p->grid.level, n_level * sizeof *knot);
    memcpy(knot + n_level, p->grid.node, n_node * sizeof *knot);
    memcpy(basis, p->basis, all * sizeof *basis);
    t->n_knot = n_level + n_node;
    t->n_radial = p->n_function;
    t->n_phase = 1;
    t->basis_kind = PRT_RADIAL_WALK;
    return PRT_OK;
}

int prt_walk_pool_train(const struct walk_pool *p, struct bases *s)
{
    const uint32_t D = p->n_function, J = p->grid.n_node;
    struct training *t = &s->training[0];
    float least[2] = {0, 0};
    prt_bases_drop_training(s);
    for (unsigned kind = 0; kind < 2; kind++)
        for (uint32_t i = 0; i < p->n_media; i++)
            least[kind] = fmaxf(least[kind], (float)least_share * p->norm[kind][i]);
    t->weight = malloc((size_t)p->n_media * D * sizeof *t->weight);
    if (!t->weight) return PRT_NOMEM;
    t->n = 0;
    s->n_training = 1;
    for (uint32_t i = 0; i < p->n_media; i++) {
        if (i % J % 3 == 1) continue; // two of three absorptions
        for (uint32_t d = 0; d < D; d++) {
            const unsigned kind = d >= p->n_own[0];
            t->weight[(size_t)t->n * D + d] =
                p->basis[(size_t)d * p->n_media + i] / fmaxf(p->norm[kind][i], least[kind]);
        }
        t->n++;
    }
    return PRT_OK;
}
