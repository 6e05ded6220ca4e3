// SPDX-License-Identifier: MIT
// The ratio of random walks to the dipole under even irradiance (METHODS §6, walk ratio): walks
// from points of the surface, the dipole's sum at the same points, smoothed over groups of
// points.
#include "walk_ratio.h"

#include "prt/surface.h"
#include "prt/walk.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    POINTS = 16384,    // of the surface, where walks start; chosen, not measured
    TEXELS = 65536,    // of the dipole's sum, as check.c has them
    GROUP_WALKS = 256, // walks that a value of W is the mean of
    GROUP_POINTS = 25, // points that they start from, about
    LEAST_WALKS = 4,   // a point and channel
};
// Scatterings of all walks that may be expected: some 20 s of two cores.
static const double most_scatterings = 600e6;
// Of the weights (1 - (d/R)^2)^2 the squared mean over the mean square is 5 pi/9 (R/h)^2 points
// at spacing h: 25 with R = 3.8 h.
static const float group_reach = 3.8f;
static const double refused_leak = 0.1, reported_leak = 0.01; // as bakes have them
static const double many_mean_lengths = 256, faint = 9.2;     // e^-9.2 = 1e-4
static const float least_sigma_s = 1e-5f;

// Sums over the walks of one point and channel.
struct tally {
    double sigma_a, sum[PRT_WALK_SHARES], square;
};

struct making {
    const struct prt_context *ctx;
    const struct prt_scene *scene;
    const struct prt_mesh *mesh;
    const struct prt_media *media;
    struct prt_walk_space *space;
    struct samples at;         // the points, by object
    struct ratio_point *point; // [at.n] in their order
    uint32_t n_walk;           // a point and channel
    uint64_t seed;
    struct frame frame;  // with R_d of the objects
    uint8_t *walked;     // [n_object]
    uint64_t (*lost)[2]; // [n_object] walks that escaped, of all
    uint64_t walks, rays;
};

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct tally *t = arg;
    const double light = exp(-t->sigma_a * (double)exit->length_mm);
    t->sum[PRT_WALK_ALL] += light;
    t->square += light * light;
    if (exit->scatterings >= 2) t->sum[PRT_WALK_MULTIPLE] += light;
}

// A walk that is longer has next to no light, or is one of the few that never leave.
static double longest_walk(const struct making *m, uint32_t object, int c, bool *faded)
{
    const struct prt_material *k = prt_media_of(m->media, object);
    const double mean = prt_walk_mean_length(m->space, object, (double)k->eta);
    const double dark = faint / fmax((double)k->sigma_a[c], 1e-30);
    *faded = dark < many_mean_lengths * mean;
    return *faded ? dark : many_mean_lengths * mean;
}

static void walk_point(struct making *m, uint32_t i, int c, struct prt_walk_counts *counts,
                       uint64_t lost[2])
{
    const struct prt_material *material = prt_media_of(m->media, m->at.object[i]);
    const uint64_t key[2] = {i, (uint64_t)c};
    bool faded;
    const struct prt_walk_medium medium = {fmaxf(material->sigma_s_prime[c], least_sigma_s),
                                           material->eta,
                                           (float)longest_walk(m, m->at.object[i], c, &faded)};
    struct prt_walk_start start = {.object = m->at.object[i],
                                   .seed = prt_hash64(key, sizeof key, m->seed + 0x7a71)};
    struct tally t = {.sigma_a = (double)material->sigma_a[c]};
    struct prt_walk_counts own = {0};
    for (int k = 0; k < 3; k++) {
        start.position[k] = m->at.p[k][i];
        start.normal[k] = m->at.normal[k][i];
        start.inward[k] = -m->at.face[k][i];
    }
    prt_walk_run(m->space, &start, &medium, m->n_walk, take_exit, &t, &own);
    const double n = m->n_walk;
    for (int s = 0; s < PRT_WALK_SHARES; s++) m->point[i].walk[s][c] = (float)(t.sum[s] / n);
    const double mean = t.sum[PRT_WALK_ALL] / n;
    m->point[i].variance[c] = (float)(fmax(t.square / n - mean * mean, 0) / (n - 1));
    counts->walks += own.walks, counts->rays += own.rays;
    lost[0] += own.leaked + (faded ? 0 : own.cut);
    lost[1] += own.walks;
}

static int walk_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct making *m = arg;
    struct prt_walk_counts counts = {0};
    for (size_t i = begin; i < end; i++) {
        const uint32_t object = m->at.object[i];
        uint64_t lost[2] = {0};
        if (!m->walked[object]) continue;
        for (int c = 0; c < 3; c++) walk_point(m, (uint32_t)i, c, &counts, lost);
        __atomic_fetch_add(&m->lost[object][0], lost[0], __ATOMIC_RELAXED);
        __atomic_fetch_add(&m->lost[object][1], lost[1], __ATOMIC_RELAXED);
    }
    __atomic_fetch_add(&m->walks, counts.walks, __ATOMIC_RELAXED);
    __atomic_fetch_add(&m->rays, counts.rays, __ATOMIC_RELAXED);
    return PRT_OK;
}

// Scatterings that one walk from every point is expected to have, over the channels.
static double scatterings_expected(const struct making *m)
{
    double all = 0;
    for (uint32_t i = 0; i < m->at.n; i++) {
        const uint32_t object = m->at.object[i];
        const struct prt_material *k = prt_media_of(m->media, object);
        const double mean = prt_walk_mean_length(m->space, object, (double)k->eta);
        for (int c = 0; c < 3 && m->walked[object]; c++) {
            bool faded;
            const double most = longest_walk(m, object, c, &faded);
            all += 1 + (double)k->sigma_s_prime[c] * fmin(mean, most);
        }
    }
    return all;
}

// Objects that cannot be walked keep the dipole.
static void choose_objects(struct making *m)
{
    for (uint32_t o = 0; o < m->mesh->n_object; o++) {
        if (!(prt_walk_area(m->space, o) > 0)) continue;
        const bool profile = prt_media_of(m->media, o)->profile != 0;
        char words[PRT_OBJECT_WORDS];
        m->walked[o] = !profile && prt_walk_volume(m->space, o) > 0;
        if (m->walked[o]) continue;
        prt_log(m->ctx, PRT_LOG_WARNING, "%s: %s: its multiple scattering is the %s, unscaled",
                prt_mesh_object_words(m->mesh, o, words),
                profile ? "a material with a profile of its own has no walks"
                        : "its triangles enclose no volume, or face inwards",
                profile ? "profile's" : "dipole's");
    }
}

static void check_leaks(struct making *m, struct prt_walk_ratio_report *report)
{
    for (uint32_t o = 0; o < m->mesh->n_object; o++) {
        const bool any = prt_walk_area(m->space, o) > 0;
        char words[PRT_OBJECT_WORDS];
        const double leak = m->lost[o][1] ? (double)m->lost[o][0] / (double)m->lost[o][1] : 0;
        if (leak > refused_leak)
            prt_log(
                m->ctx, PRT_LOG_WARNING,
                "%s: %.3g %% of the walks escape through holes (at most 10 %% "
                "may): its multiple scattering is the dipole's, unscaled; close its surface",
                prt_mesh_object_words(m->mesh, o, words), 100 * leak);
        else if (leak > reported_leak)
            prt_log(m->ctx, PRT_LOG_WARNING,
                    "%s: %.3g %% of the walks escape through holes, and it is too "
                    "dark by as much; close its surface",
                    prt_mesh_object_words(m->mesh, o, words), 100 * leak);
        if (leak > refused_leak) m->walked[o] = 0;
        else report->leaked = fmax(report->leaked, leak);
        report->n_kept += any && !m->walked[o];
    }
}

// ---- the dipole

struct dipole_job {
    struct making *m;
    const struct texel_sum *sum;
    uint32_t first, n; // points of the object
};

enum { SLICE = 64 }; // points

static int add_dipole(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct dipole_job *job = arg;
    struct making *m = job->m;
    float column[9][SLICE] __attribute__((aligned(64))) = {{0}};
    const float *const p[3] = {column[0], column[1], column[2]};
    const float *const e[3] = {column[3], column[4], column[5]};
    float *const sum[3] = {column[6], column[7], column[8]};
    for (uint32_t i = 0; i < SLICE; i++) { // the last slice repeats its last point
        const uint32_t at = job->first + min_u((uint32_t)begin + i, (uint32_t)end - 1);
        for (int k = 0; k < 3; k++) column[k][i] = m->at.p[k][at], column[3 + k][i] = 1;
    }
    prt_texel_sum_add(m->ctx, job->sum, SLICE, p, e, sum);
    for (uint32_t i = 0; begin + i < end; i++)
        for (int c = 0; c < 3; c++)
            m->point[job->first + begin + i].dipole[c] = column[6 + c][i];
    return PRT_OK;
}

static uint32_t object_end(const struct samples *s, uint32_t first)
{
    uint32_t last = first;
    while (last < s->n && s->object[last] == s->object[first]) last++;
    return last;
}

// Both lists of samples have the objects in the same order.
static int sum_dipole(struct making *m)
{
    struct samples texels;
    int status = prt_samples_atlas(m->ctx, m->mesh, TEXELS, &texels);
    if (status) return status;
    for (uint32_t i = 0; i < texels.n; i++)
        for (int c = 0; c < 3; c++) texels.e[c][i] = 1;
    for (uint32_t from = 0, first = 0, to, last; first < m->at.n && !status;
         from = to, first = last) {
        struct texel_sum sum;
        to = object_end(&texels, from);
        last = object_end(&m->at, first);
        struct dipole_job job = {m, &sum, first, last - first};
        status = prt_texel_sum_init(&m->frame, &texels, from, to, &sum) ? PRT_OK : PRT_NOMEM;
        if (!status) status = prt_screen_loop(m->ctx, last - first, SLICE, add_dipole, &job);
        prt_texel_sum_finish(&sum);
    }
    prt_samples_finish(&texels);
    return status;
}

// ---- groups of points

struct group {
    double weight, weight2, walk[PRT_WALK_SHARES][3], variance[3];
};

static void add_to_group(void *arg, const struct ratio_point *q, float weight)
{
    struct group *g = arg;
    const double w = (double)weight;
    g->weight += w;
    g->weight2 += w * w;
    for (int c = 0; c < 3; c++) {
        g->variance[c] += w * w * (double)q->variance[c];
        for (int s = 0; s < PRT_WALK_SHARES; s++) g->walk[s][c] += w * (double)q->walk[s][c];
    }
}

struct smooth_job {
    const struct ratio_grid *grid;
    const uint8_t *walked;
    struct ratio_point *smooth; // out, in the grid's order
    float reach_mm;
};

// A point is in its own group, so that the sum of weights is positive.
static int smooth_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct smooth_job *job = arg;
    for (size_t i = begin; i < end; i++) {
        struct ratio_point *q = &job->smooth[i];
        struct group g = {0};
        *q = job->grid->point[i];
        for (int s = 0; s < PRT_WALK_SHARES; s++)
            memcpy(q->walk[s], q->dipole, sizeof q->dipole);
        memset(q->variance, 0, sizeof q->variance);
        if (!job->walked[q->object]) continue;
        prt_ratio_gather(job->grid, q->p, q->n, q->object, job->reach_mm, add_to_group, &g);
        q->n_group = (float)(g.weight * g.weight / g.weight2);
        for (int c = 0; c < 3; c++) {
            q->variance[c] = (float)(g.variance[c] / (g.weight * g.weight));
            for (int s = 0; s < PRT_WALK_SHARES; s++)
                q->walk[s][c] = (float)(g.walk[s][c] / g.weight);
        }
    }
    return PRT_OK;
}

// ---- report

static void measure(const struct ratio_point *point, uint32_t n,
                    struct prt_walk_ratio_report *report)
{
    double error2 = 0, walk2 = 0, groups = 0, walked = 0;
    report->least = INFINITY, report->most = 0;
    for (uint32_t i = 0; i < n; i++) {
        const struct ratio_point *q = &point[i];
        for (int c = 0; c < 3; c++) {
            const double all = (double)q->walk[PRT_WALK_ALL][c], d = (double)q->dipole[c];
            error2 += (double)q->variance[c];
            walk2 += all * all;
            report->least = fmin(report->least, all / fmax(d, 1e-30));
            report->most = fmax(report->most, all / fmax(d, 1e-30));
        }
        walked += q->n_group > 0;
        groups += (double)q->n_group;
    }
    report->standard_error = walk2 > 0 ? sqrt(error2 / walk2) : 0;
    report->group_walks = walked > 0 ? groups / walked * report->n_walk : 0;
}

// ---- the whole

static void making_finish(struct making *m)
{
    prt_samples_finish(&m->at);
    prt_walk_space_destroy(m->space);
    prt_free(m->walked);
    prt_free(m->lost);
    prt_free(m->point);
    free(m->frame.dipole);
}

static bool making_init(struct making *m, struct prt_screen *screen)
{
    const uint32_t n_object = m->mesh->n_object;
    *screen =
        (struct prt_screen){.mesh = m->mesh, .diameter_mm = (float)prt_mesh_diagonal(m->mesh)};
    m->frame = (struct frame){.ctx = m->ctx, .screen = screen, .n_object = n_object};
    m->frame.dipole = calloc(n_object + 1u, sizeof *m->frame.dipole);
    m->point = prt_calloc(m->at.n + 1u, sizeof *m->point);
    m->walked = prt_calloc(n_object + 1u, sizeof *m->walked);
    m->lost = prt_calloc(n_object + 1u, sizeof *m->lost);
    if (!m->frame.dipole || !m->point || !m->walked || !m->lost) return false;
    for (uint32_t o = 0; o < n_object; o++)
        prt_material_dipoles(prt_media_of(m->media, o), m->frame.dipole[o]);
    for (uint32_t i = 0; i < m->at.n; i++) {
        m->point[i].object = m->at.object[i];
        for (int k = 0; k < 3; k++) {
            m->point[i].p[k] = m->at.p[k][i];
            m->point[i].n[k] = m->at.normal[k][i];
        }
    }
    return true;
}

// The grid's points become those of `out`, with W averaged over groups.
static int smooth(struct making *m, struct prt_walk_ratio *out)
{
    const uint32_t n = m->at.n;
    const float reach_mm = group_reach * out->spacing_mm;
    struct ratio_point *smoothed = prt_alloc(n + 1u, sizeof *smoothed);
    int status =
        smoothed ? prt_ratio_grid_create(m->point, n, reach_mm, &out->grid) : PRT_NOMEM;
    struct smooth_job job = {&out->grid, m->walked, smoothed, reach_mm};
    if (!status) status = prt_screen_loop(m->ctx, n, 64, smooth_points, &job);
    if (status) {
        prt_ratio_grid_finish(&out->grid);
        prt_free(smoothed);
        return status;
    }
    out->grid.point = smoothed;
    return PRT_OK;
}

// Walks, the dipole, and both at the vertices.
static int make(struct making *m, struct prt_walk_ratio *out,
                struct prt_walk_ratio_report *report)
{
    choose_objects(m);
    const double most = most_scatterings / fmax(scatterings_expected(m), 1);
    if (most < m->n_walk) m->n_walk = most > LEAST_WALKS ? (uint32_t)most : LEAST_WALKS;
    int status = prt_parallel_for(m->ctx, "walk ratio", m->at.n, 16, walk_points, m);
    if (!status) check_leaks(m, report);
    if (!status) status = sum_dipole(m);
    if (!status) status = smooth(m, out);
    if (!status) status = prt_ratio_vertices(m->ctx, m->mesh, out);
    if (status) return status;
    report->n_point = m->at.n;
    report->n_walk = m->n_walk;
    report->walks = m->walks;
    report->rays = m->rays;
    measure(out->grid.point, m->at.n, report);
    return PRT_OK;
}

int prt_walk_ratio_create(const struct prt_context *ctx, const struct prt_scene *scene,
                          const struct prt_media *media, uint32_t n_walk, uint64_t seed,
                          struct prt_walk_ratio **out, struct prt_walk_ratio_report *report)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    const uint32_t wanted = n_walk ? n_walk : GROUP_WALKS;
    struct prt_walk_ratio_report said = {0};
    struct prt_screen screen;
    struct prt_walk_ratio *r;
    const double started = prt_time_s();
    if (wanted < 16 || wanted > 1048576)
        return prt_fail(ctx, PRT_ARG, "walk ratio: %u walks a group: 16 to 1048576 are allowed",
                        wanted);
    struct making m = {ctx,          scene,
                       mesh,         media,
                       .seed = seed, .n_walk = (wanted + GROUP_POINTS - 1) / GROUP_POINTS};
    if (m.n_walk < 2) m.n_walk = 2; // the noise is known from at least two
    int status = prt_media_check(ctx, media, mesh->n_object);
    if (!status) status = prt_walk_space_create(ctx, scene, &m.space);
    if (!status) status = prt_samples_atlas(ctx, mesh, POINTS, &m.at);
    if (!status && !(r = prt_calloc(1, sizeof *r))) status = PRT_NOMEM;
    if (status) {
        making_finish(&m);
        return status;
    }
    r->spacing_mm = (float)sqrt(prt_surface_area(mesh) / m.at.n);
    status = making_init(&m, &screen) ? make(&m, r, &said) : PRT_NOMEM;
    making_finish(&m);
    if (status) {
        prt_walk_ratio_destroy(r);
        return status == PRT_NOMEM ? prt_fail(ctx, status, "no memory for the walk ratio")
                                   : status;
    }
    said.seconds = prt_time_s() - started;
    if (report) *report = said;
    *out = r;
    return PRT_OK;
}

void prt_walk_ratio_destroy(struct prt_walk_ratio *r)
{
    if (!r) return;
    for (int s = 0; s < PRT_WALK_SHARES; s++) prt_free(r->vertex[s]);
    prt_free(r->grid.point);
    prt_ratio_grid_finish(&r->grid);
    prt_free(r->position);
    prt_free(r->normal);
    prt_free(r->triangle);
    prt_free(r->object);
    prt_free(r->large);
    prt_free(r);
}

uint64_t prt_walk_ratio_bytes(const struct prt_walk_ratio *r)
{
    const uint64_t cells = (uint64_t)r->grid.cells[0] * r->grid.cells[1] * r->grid.cells[2];
    return sizeof *r + r->n_vertex * (uint64_t)(12 * (2 + PRT_WALK_SHARES)) +
           r->n_triangle * UINT64_C(17) + r->grid.n * sizeof *r->grid.point + 4 * cells;
}

const float (*prt_walk_ratio_vertices(const struct prt_walk_ratio *r,
                                      enum prt_walk_share share))[3]
{
    return (const float(*)[3])r->vertex[share];
}
