// SPDX-License-Identifier: MIT
// Texture-space sampling (C08): points drawn from irradiance over an area-preserving atlas, the
// same for all pixels. Surface closer to a pixel than the points' spacing is a control variate
// from the picture (near_field.c), or in the hybrid engine a dense sum.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// CELL_TURNS: steps of Lloyd's iteration (METHODS §6).
enum { CELL_TURNS = 2 };
// Samples without a count or a budget, and the most that refinement reaches; texels of the
// atlas. Chosen, not measured.
enum { TEXTURE_SAMPLES = 2500, HYBRID_SAMPLES = 900, MOST_SAMPLES = 16384 };
enum { LEAST_TEXELS = 16384, MOST_TEXELS = 262144 };
#define DEFAULT_BOUND 0.1 // [mm^-1], of prt_screen_options.bound

double prt_screen_split_radius(const struct prt_diffusion dipole[3], double bound)
{
    double last = 0;
    for (int c = 0; c < 3; c++) {
        for (int i = 1; i <= 4000; i++) {
            double r = 1e-3 * pow(1e6, i / 4000.0);
            if (2 * M_PI * r * prt_diffusion_rd(&dipole[c], r) > bound) last = fmax(last, r);
        }
    }
    return last;
}

uint32_t prt_screen_mip_sample(const float *mip, uint32_t n, float u)
{
    uint32_t level = 0, size = n;
    const float *at = mip;
    while (size > 1) {
        at += size;
        size /= 4;
        level++;
    }
    double x = u * (double)at[0];
    uint32_t index = 0;
    while (level-- > 0) {
        size *= 4;
        at -= size;
        index *= 4;
        uint32_t last = index + 3;
        while (index < last && x >= at[index]) x -= at[index++];
        // rounding may step beyond the last texel with light
        while (index > (last & ~3u) && !(at[index] > 0)) index--;
    }
    return index;
}

// Powers of texels [first, last), padded with 0 to a power of 4, then each coarser level.
static float *make_mip(const struct samples *s, uint32_t first, uint32_t last, uint32_t *n_out)
{
    uint32_t n = 1;
    while (n < last - first) n *= 4;
    float *mip = prt_calloc((size_t)n / 3 * 4 + 4, sizeof *mip), *at = mip;
    if (!mip) return NULL;
    for (uint32_t i = first; i < last; i++)
        mip[i - first] = (s->e[0][i] + s->e[1][i] + s->e[2][i]) * s->area[i];
    for (uint32_t size = n; size > 1; size /= 4) {
        float *next = at + size;
        for (uint32_t i = 0; i < size / 4; i++)
            next[i] = at[4 * i] + at[4 * i + 1] + at[4 * i + 2] + at[4 * i + 3];
        at = next;
    }
    *n_out = n;
    return mip;
}

// Drawn points and the cells of texels that are nearest to them.
struct cells {
    const struct samples *s;
    uint32_t first, last; // the object's texels
    uint32_t n;
    float (*p)[3];    // [n] mean of the cell, by power
    double (*sum)[8]; // [n] power * position, power, rgb, power * second moment
    uint32_t *owner;  // [last - first]
    // points sorted into buckets of a uniform grid
    float lo[3], inv_edge;
    uint32_t size[3], *start, *point;
};

static float texel_power(const struct samples *s, uint32_t i)
{
    return (s->e[0][i] + s->e[1][i] + s->e[2][i]) * s->area[i];
}

static void bucket_of(const struct cells *c, const float p[3], int b[3])
{
    for (int k = 0; k < 3; k++) {
        float x = (p[k] - c->lo[k]) * c->inv_edge;
        b[k] = x > 0 ? (int)x : 0;
        if (b[k] >= (int)c->size[k]) b[k] = (int)c->size[k] - 1;
    }
}

static uint32_t bucket_index(const struct cells *c, int x, int y, int z)
{
    return ((uint32_t)z * c->size[1] + (uint32_t)y) * c->size[0] + (uint32_t)x;
}

static bool make_buckets(struct cells *c, double edge)
{
    float hi[3];
    for (int k = 0; k < 3; k++) {
        c->lo[k] = INFINITY;
        hi[k] = -INFINITY;
        for (uint32_t i = 0; i < c->n; i++) {
            c->lo[k] = min_f(c->lo[k], c->p[i][k]);
            hi[k] = max_f(hi[k], c->p[i][k]);
        }
    }
    c->inv_edge = edge > 0 ? (float)(1 / edge) : 0;
    for (int k = 0; k < 3; k++) {
        double n = 1 + floor((double)(hi[k] - c->lo[k]) * (double)c->inv_edge);
        c->size[k] = n < 128 ? (uint32_t)n : 128;
    }
    size_t n_bucket = (size_t)c->size[0] * c->size[1] * c->size[2];
    free(c->start);
    free(c->point);
    c->start = calloc(n_bucket + 2, sizeof *c->start);
    c->point = malloc(((size_t)c->n + 1) * sizeof *c->point);
    if (!c->start || !c->point) return false;
    for (uint32_t i = 0; i < c->n; i++) {
        int b[3];
        bucket_of(c, c->p[i], b);
        c->start[bucket_index(c, b[0], b[1], b[2]) + 2]++;
    }
    for (size_t k = 0; k <= n_bucket; k++) c->start[k + 1] += c->start[k];
    for (uint32_t i = 0; i < c->n; i++) {
        int b[3];
        bucket_of(c, c->p[i], b);
        c->point[c->start[bucket_index(c, b[0], b[1], b[2]) + 1]++] = i;
    }
    return true;
}

// Range of buckets at most `reach` from bucket b along one axis; false when it is empty.
static bool bucket_range(uint32_t size, int b, int reach, int range[2])
{
    range[0] = b - reach < 0 ? 0 : b - reach;
    range[1] = b + reach >= (int)size ? (int)size - 1 : b + reach;
    return range[0] <= range[1];
}

struct nearest {
    float p[3], distance_sq;
    uint32_t point;
};

// Points of the buckets [x[0], x[1]] of one row.
static void search_row(const struct cells *c, const int x[2], int y, int z,
                       struct nearest *best)
{
    uint32_t to = c->start[bucket_index(c, x[1], y, z) + 1];
    for (uint32_t k = c->start[bucket_index(c, x[0], y, z)]; k < to; k++) {
        const float *q = c->p[c->point[k]];
        float dx = q[0] - best->p[0], dy = q[1] - best->p[1], dz = q[2] - best->p[2];
        float d2 = dx * dx + dy * dy + dz * dz;
        if (d2 >= best->distance_sq) continue;
        best->distance_sq = d2;
        best->point = c->point[k];
    }
}

// Points of the buckets at most `reach` from bucket b.
static void search_box(const struct cells *c, const int b[3], int reach, struct nearest *best)
{
    int x[2], y[2], z[2];
    if (!bucket_range(c->size[0], b[0], reach, x) ||
        !bucket_range(c->size[1], b[1], reach, y) || !bucket_range(c->size[2], b[2], reach, z))
        return;
    for (int k = z[0]; k <= z[1]; k++)
        for (int j = y[0]; j <= y[1]; j++) search_row(c, x, j, k, best);
}

// Assigns each lit texel to the nearest point of the buckets about it; the search box grows
// until it holds a point. A texel without one keeps its owner.
static int own_texels(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct cells *c = arg;
    const struct samples *s = c->s;
    for (size_t i = begin; i < end; i++) {
        uint32_t at = c->first + (uint32_t)i;
        if (!(s->e[0][at] + s->e[1][at] + s->e[2][at] > 0)) {
            c->owner[i] = UINT32_MAX;
            continue;
        }
        struct nearest best = {.p = {s->p[0][at], s->p[1][at], s->p[2][at]},
                               .distance_sq = INFINITY,
                               .point = c->owner[i] < c->n ? c->owner[i] : UINT32_MAX};
        int b[3];
        bucket_of(c, best.p, b);
        for (int reach = 1; reach < 64 && !(best.distance_sq < INFINITY); reach *= 4)
            search_box(c, b, reach, &best);
        c->owner[i] = best.point;
    }
    return PRT_OK;
}

// Power, mean position and second moment of each cell; points move to the means.
static void weigh_cells(struct cells *c)
{
    const struct samples *s = c->s;
    memset(c->sum, 0, c->n * sizeof *c->sum);
    for (uint32_t i = c->first; i < c->last; i++) {
        uint32_t k = c->owner[i - c->first];
        if (k == UINT32_MAX) continue;
        double w = (double)texel_power(s, i), *sum = c->sum[k], r2 = 0;
        for (int j = 0; j < 3; j++) {
            double d = (double)s->p[j][i] - (double)c->p[k][j];
            sum[j] += w * d;
            sum[4 + j] += (double)(s->e[j][i] * s->area[i]);
            r2 += d * d;
        }
        sum[3] += w;
        sum[7] += w * (r2 + (double)s->area[i] / (2 * M_PI));
    }
    for (uint32_t k = 0; k < c->n; k++) {
        double *sum = c->sum[k], shift = 0;
        if (!(sum[3] > 0)) continue;
        for (int j = 0; j < 3; j++) {
            double d = sum[j] / sum[3];
            c->p[k][j] += (float)d;
            shift += d * d;
        }
        sum[7] = fmax(sum[7] / sum[3] - shift, 0);
    }
}

struct cell_key {
    float radius;
    uint32_t cell;
};

static int by_radius(const void *a, const void *b)
{
    const struct cell_key *x = a, *y = b;
    if (x->radius != y->radius) return x->radius < y->radius ? -1 : 1;
    return x->cell < y->cell ? -1 : x->cell > y->cell;
}

// The drawn points as emitters, in classes of similar discs.
struct drawn {
    struct emitters *list;          // [n_object]
    uint32_t (*class_end)[CLASSES]; // [n_object]
    double (*disc_mm)[CLASSES];     // [n_object] radii
};

static bool emit_cells(const struct cells *c, uint32_t object, struct drawn *out)
{
    struct cell_key *key = malloc(((size_t)c->n + 1) * sizeof *key);
    struct emitters *list = &out->list[object];
    if (!key || !prt_emitters_reserve(list, c->n + 16)) {
        free(key);
        return false;
    }
    uint32_t n = 0;
    for (uint32_t k = 0; k < c->n; k++)
        // a uniform disc of radius a has the second moment a²/2
        if (c->sum[k][3] > 0) key[n++] = (struct cell_key){(float)sqrt(2 * c->sum[k][7]), k};
    qsort(key, n, sizeof *key, by_radius);
    for (uint32_t k = 0, i = 0; k < CLASSES; k++) {
        uint32_t end = (uint32_t)((uint64_t)n * (k + 1) / CLASSES);
        double square = 0, power = 0;
        for (; i < end; i++) {
            const double *sum = c->sum[key[i].cell];
            float w[3] = {(float)sum[4], (float)sum[5], (float)sum[6]};
            emitters_push(list, c->p[key[i].cell], w);
            square += sum[3] * (double)(key[i].radius * key[i].radius);
            power += sum[3];
        }
        out->class_end[object][k] = end;
        out->disc_mm[object][k] = power > 0 ? sqrt(square / power) : 0;
    }
    free(key);
    return true;
}

// Mean distance of drawn points: the side of an equal share of the lit area.
static double cell_edge(const struct cells *c, uint32_t n)
{
    double sum = 0, square = 0;
    for (uint32_t i = c->first; i < c->last; i++) {
        double e = (double)(c->s->e[0][i] + c->s->e[1][i] + c->s->e[2][i]);
        sum += e * (double)c->s->area[i];
        square += e * e * (double)c->s->area[i];
    }
    return square > 0 && n ? sqrt(sum * sum / square / n) : 0;
}

// Draws `share` points of one object from E' by stratified numbers through the mip chain, and
// moves them to the means of their cells.
static int draw_object(struct frame *f, const float *mip, uint32_t n_mip, struct cells *c,
                       uint32_t share, float shift)
{
    const struct samples *s = c->s;
    uint32_t n_texel = c->last - c->first;
    c->p = malloc(((size_t)share + 1) * sizeof *c->p);
    c->sum = malloc(((size_t)share + 1) * sizeof *c->sum);
    c->owner = malloc(((size_t)n_texel + 1) * sizeof *c->owner);
    if (!c->p || !c->sum || !c->owner)
        return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for %u samples", share);
    uint32_t before = UINT32_MAX;
    for (uint32_t i = 0; i < share; i++) {
        double u = (i + (double)shift) / (double)share;
        uint32_t t = prt_screen_mip_sample(mip, n_mip, (float)u);
        // a texel drawn twice in a row is one point
        if (t >= n_texel || !(mip[t] > 0) || t == before) continue;
        before = t;
        for (int k = 0; k < 3; k++) c->p[c->n][k] = s->p[k][c->first + t];
        c->n++;
    }
    if (!c->n) return PRT_OK;
    double edge = cell_edge(c, c->n);
    memset(c->owner, 0xff, n_texel * sizeof *c->owner);
    for (int turn = 0; turn < CELL_TURNS; turn++) {
        if (!make_buckets(c, edge)) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
        int status = prt_screen_loop(f->ctx, n_texel, 512, own_texels, c);
        if (status) return status;
        weigh_cells(c);
    }
    return PRT_OK;
}

static void cells_finish(struct cells *c)
{
    free(c->p);
    free(c->sum);
    free(c->owner);
    free(c->start);
    free(c->point);
}

// Draws n points from E' of the frame's atlas, shared by power among the objects.
static int draw_emitters(struct frame *f, uint32_t n, struct drawn *out)
{
    const struct samples *s = &f->screen->atlas;
    double total = 0;
    for (uint32_t i = 0; i < s->n; i++) total += (double)texel_power(s, i);
    if (!(total > 0)) return PRT_OK;
    struct prt_rng rng;
    prt_rng_init(&rng, f->seed, 1);
    float shift = f->seed ? prt_rng_f32(&rng) : 0.5f;
    for (uint32_t first = 0, last; first < s->n; first = last) {
        uint32_t object = s->object[first], n_mip;
        last = first;
        while (last < s->n && s->object[last] == object) last++;
        float *mip = make_mip(s, first, last, &n_mip);
        if (!mip) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for mip levels");
        double own = (double)mip[n_mip > 1 ? (size_t)(n_mip - 1) / 3 * 4 : 0];
        uint32_t share = (uint32_t)(n * (own / total) + 0.5);
        if (share < 16) share = 16;
        struct cells cells = {.s = s, .first = first, .last = last};
        int status = own > 0 ? draw_object(f, mip, n_mip, &cells, share, shift) : PRT_OK;
        if (!status && cells.n && !emit_cells(&cells, object, out))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for %u samples", share);
        cells_finish(&cells);
        prt_free(mip);
        if (status) return status;
    }
    return PRT_OK;
}

static struct radial_table *disc_tables(const struct frame *f, const struct drawn *drawn,
                                        double r_p, const double *own_mm)
{
    uint32_t n = f->n_object ? f->n_object : 1;
    struct radial_table *table = prt_calloc((size_t)n * CLASSES, sizeof *table);
    for (uint32_t o = 0; table && o < f->n_object; o++)
        for (uint32_t k = 0; k < CLASSES && drawn->list[o].n; k++)
            prt_split_table(f, o, r_p, own_mm[o], false, drawn->disc_mm[o][k],
                            f->screen->diameter_mm, &table[o * CLASSES + k]);
    return table;
}

// The near part: the ring pattern, or every point of the light views or the atlas within reach.
static int local_scatter(struct frame *f, double r_p, float spacing)
{
    float reach = (float)(r_p + 5 / SPLIT_K);
    if (prt_frame_light_views_only(f) && f->options->rings && !maps_turn(f) &&
        !prt_map_occludes(f))
        return prt_scatter_pattern(f, r_p, spacing, reach);
    if (prt_frame_light_views_only(f))
        return prt_scatter_light_views(f, r_p, spacing, 0.7f, reach);
    return prt_scatter_discs(f, &f->screen->atlas, r_p, 0.7f, reach);
}

// One picture of an engine of this file.
struct texture_job {
    bool hybrid;
    uint32_t n;          // drawn points
    double r_p, spacing; // HYBRID: split radius, < 0: none; distance of near points [mm]
    struct drawn drawn;
    double *own_mm;             // [n_object] radius of the near-field control variate; 0: none
    struct radial_table *table; // [n_object][CLASSES]
};

static bool job_init(struct texture_job *job, const struct frame *f)
{
    uint32_t n_object = f->n_object ? f->n_object : 1;
    job->drawn = (struct drawn){calloc(n_object, sizeof *job->drawn.list),
                                calloc(n_object, sizeof *job->drawn.class_end),
                                calloc(n_object, sizeof *job->drawn.disc_mm)};
    job->own_mm = calloc(n_object, sizeof *job->own_mm);
    return job->drawn.list && job->drawn.class_end && job->drawn.disc_mm && job->own_mm;
}

static void job_finish(struct texture_job *job, uint32_t n_object)
{
    prt_free(job->table);
    for (uint32_t o = 0; job->drawn.list && o < n_object; o++)
        prt_emitters_finish(&job->drawn.list[o]);
    free(job->own_mm);
    free(job->drawn.list);
    free(job->drawn.class_end);
    free(job->drawn.disc_mm);
}

// Counts and distances, and from them the texels of the atlas.
static uint32_t plan_texels(const struct frame *f, struct texture_job *job)
{
    const uint32_t normal = job->hybrid ? HYBRID_SAMPLES : TEXTURE_SAMPLES;
    uint32_t n = f->report->n_asked = prt_frame_samples(f, normal, MOST_SAMPLES);
    // later frames of a running mean draw up to four times the points, so that the discs of the
    // points do not remain visible in the mean
    if (f->options->frame && !(f->options->budget_ms > 0))
        n = (uint32_t)fmin(fmax(n, MOST_SAMPLES), n * fmin(1 + f->options->frame / 8.0, 4));
    double texels = LEAST_TEXELS;
    job->spacing = prt_frame_mean_free_path(f);
    job->r_p = -1;
    if (job->hybrid) {
        double bound = f->options->bound > 0 ? f->options->bound : DEFAULT_BOUND;
        for (uint32_t o = 0; o < f->n_object; o++)
            job->r_p = fmax(job->r_p, prt_screen_split_radius(f->dipole[o], bound));
        // near points lie less than a mean free path apart, and closer with more samples
        job->spacing = fmax(0.8 * job->spacing, (double)f->screen->diameter_mm / 300);
        job->spacing *= fmin(fmax(pow((double)HYBRID_SAMPLES / n, 0.25), 0.35), 1.2);
        if (!prt_frame_light_views_only(f))
            texels = f->screen->area_mm2 / (0.4 * job->spacing * job->spacing);
    }
    job->n = n;
    return (uint32_t)fmin(fmax(fmax(texels, 16.0 * n), LEAST_TEXELS), MOST_TEXELS);
}

// The far part: drawn points as discs, and without a split the near field from the image.
static int far_scatter(struct frame *f, struct texture_job *job)
{
    struct drawn *drawn = &job->drawn;
    int status = draw_emitters(f, job->n, drawn);
    if (status) return status;
    double scale = (double)prt_frame_mean_free_path(f), disc = INFINITY;
    for (uint32_t o = 0; o < f->n_object; o++) {
        f->report->n_sample += drawn->list[o].n;
        for (int k = 0; k < CLASSES && !job->hybrid; k++)
            job->own_mm[o] += drawn->disc_mm[o][k] / CLASSES;
        if (drawn->list[o].n) disc = fmin(disc, drawn->disc_mm[o][CLASSES / 2]);
    }
    job->table = disc_tables(f, drawn, job->r_p, job->own_mm);
    if (!job->table) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    // light of discs, without the near field, varies over the discs' radii at the least
    status = prt_receivers_begin(f, fmax(scale, isfinite(disc) ? disc : scale));
    if (!status)
        status = prt_scatter_all(f, job->table, drawn->list,
                                 (const uint32_t(*)[CLASSES])drawn->class_end);
    if (!status) status = prt_receivers_resolve(f);
    if (!status && !job->hybrid) status = prt_near_field_add(f, job->own_mm);
    return status;
}

// The near part of HYBRID. Light views count their own time as irradiance and scattering.
static int near_scatter(struct frame *f, const struct texture_job *job)
{
    struct prt_screen_report *report = f->report;
    double t0 = prt_time_s(), before = report->irradiance_s + report->scatter_s;
    int status = prt_receivers_begin(f, (double)prt_frame_mean_free_path(f));
    if (!status) status = local_scatter(f, job->r_p, (float)job->spacing);
    if (!status) status = prt_receivers_resolve(f);
    double counted = report->irradiance_s + report->scatter_s - before;
    report->scatter_s += prt_time_s() - t0 - counted;
    report->r_p_mm = (float)job->r_p;
    return status;
}

int prt_engine_texture(struct frame *f, bool hybrid)
{
    struct texture_job job = {.hybrid = hybrid};
    double t0 = prt_time_s();
    int status = prt_frame_atlas(f, plan_texels(f, &job), false);
    double t1 = prt_time_s();
    f->report->irradiance_s = t1 - t0;
    if (!job_init(&job, f) && !status)
        status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) status = far_scatter(f, &job);
    f->report->scatter_s = prt_time_s() - t1;
    if (!status && hybrid) status = near_scatter(f, &job);
    job_finish(&job, f->n_object);
    return status;
}
