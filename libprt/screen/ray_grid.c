// SPDX-License-Identifier: MIT
// Points of the surface by grids of parallel rays: depth layers peeled along the three axes,
// and a distant light's view as points or as an image of depths.
#include "internal.h"

#include "trace/triangle.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

// An intersection of a ray of the grid with translucent surface.
struct hit {
    uint64_t code;
    uint32_t triangle, column;
    float u, v, area; // barycentrics; mm^2 of surface that the ray stands for
};
struct row {
    struct hit *hit;
    uint32_t n, capacity;
};

static bool push_hit(struct row *row, struct hit h)
{
    if (row->n == row->capacity) {
        uint32_t capacity = row->capacity ? 2 * row->capacity : 64;
        struct hit *grown = realloc(row->hit, capacity * sizeof *grown);
        if (!grown) return false;
        row->hit = grown;
        row->capacity = capacity;
    }
    row->hit[row->n++] = h;
    return true;
}

// A grid of parallel rays: from origin + (i u + j v) step along d.
struct ray_grid {
    const struct prt_scene *scene;
    const struct prt_mesh *mesh;
    const uint32_t *triangle_block;
    float origin[3], u[3], v[3], d[3];
    float step, length, epsilon, lo[3], inv_edge;
    uint32_t nu, nv;
    int axis; // >= 0: peel all layers, keep surface that faces this axis most; < 0: first hits
    struct row *row;
    atomic_uint_fast64_t rays;
};

static void face_normal(const struct prt_mesh *mesh, uint32_t t, double n[3])
{
    double l = 0;
    triangle_cross(mesh, t, n);
    for (int k = 0; k < 3; k++) l += n[k] * n[k];
    l = l > 0 ? 1 / sqrt(l) : 0;
    for (int k = 0; k < 3; k++) n[k] *= l;
}

// Surface area that a ray stands for at its hit [mm^2]; 0: the hit is not kept.
static float hit_area(const struct ray_grid *view, uint32_t t)
{
    if (!prt_block_translucent(view->mesh, view->triangle_block[t])) return 0;
    double n[3], c = 0;
    face_normal(view->mesh, t, n);
    for (int k = 0; k < 3; k++) c += n[k] * view->d[k];
    if (view->axis >= 0) {
        int a = view->axis, b = (a + 1) % 3, g = (a + 2) % 3;
        // ties go to one axis only
        if (!(fabs(n[a]) > fabs(n[b]) || (fabs(n[a]) == fabs(n[b]) && a < b))) return 0;
        if (!(fabs(n[a]) > fabs(n[g]) || (fabs(n[a]) == fabs(n[g]) && a < g))) return 0;
        return (float)(view->step * view->step / fabs(c));
    }
    // light enters the front of a face only
    if (!(c < -0.02)) return 0;
    return (float)(view->step * view->step / -c);
}

static uint64_t hit_code(const struct ray_grid *view, const struct prt_packet *p, uint32_t k)
{
    float at[3] = {p->ox[k] + p->t[k] * p->dx[k], p->oy[k] + p->t[k] * p->dy[k],
                   p->oz[k] + p->t[k] * p->dz[k]};
    uint32_t object = view->mesh->block[view->triangle_block[p->triangle[k]]].object;
    return (uint64_t)object << CODE_BITS | prt_morton_code(view->lo, view->inv_edge, at);
}

// Rays [i, i + 16) of row j; returns the mask of those inside the grid.
static uint32_t set_rays(const struct ray_grid *view, size_t j, uint32_t i,
                         struct prt_packet *p)
{
    uint32_t mask = 0;
    memset(p, 0, sizeof *p);
    for (uint32_t k = 0; k < 16; k++) {
        float a = (float)(i + k) * view->step, b = (float)j * view->step;
        p->ox[k] = view->origin[0] + a * view->u[0] + b * view->v[0];
        p->oy[k] = view->origin[1] + a * view->u[1] + b * view->v[1];
        p->oz[k] = view->origin[2] + a * view->u[2] + b * view->v[2];
        p->dx[k] = view->d[0];
        p->dy[k] = view->d[1];
        p->dz[k] = view->d[2];
        p->tfar[k] = view->length;
        mask |= (uint32_t)(i + k < view->nu) << k;
    }
    return mask;
}

// Appends the hits of one layer to row j and moves the rays behind them. Clears from the mask
// the rays that end: all of a light's view, those without a hit of a peeled one. False without
// memory.
static bool take_hits(const struct ray_grid *view, size_t j, uint32_t i, struct prt_packet *p,
                      uint32_t *mask)
{
    for (uint32_t k = 0; k < 16; k++) {
        if (!(*mask >> k & 1)) continue;
        uint32_t t = p->triangle[k];
        if (t == UINT32_MAX || view->axis < 0) *mask &= ~(1u << k);
        if (t == UINT32_MAX) continue;
        float area = hit_area(view, t);
        struct hit hit = {hit_code(view, p, k), t, i + k, p->u[k], p->v[k], area};
        if (area > 0 && !push_hit(&view->row[j], hit)) return false;
        p->tnear[k] = p->t[k] * 1.000001f + view->epsilon;
        p->tfar[k] = view->length;
    }
    return true;
}

static int view_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    enum { MOST_LAYERS = 64 }; // bounds the time of degenerate surface; chosen, not measured
    struct ray_grid *view = arg;
    uint64_t rays = 0;
    prt_trace_thread_init();
    for (size_t j = begin; j < end; j++) {
        for (uint32_t i = 0; i < view->nu; i += 16) {
            struct prt_packet p;
            uint32_t mask = set_rays(view, j, i, &p);
            for (int layer = 0; mask && layer < MOST_LAYERS; layer++) {
                rays += (uint32_t)__builtin_popcount(mask);
                prt_scene_intersect16(view->scene, &p, mask, true);
                if (!take_hits(view, j, i, &p, &mask)) return PRT_NOMEM;
            }
        }
    }
    atomic_fetch_add(&view->rays, rays);
    return PRT_OK;
}

struct place_job {
    const struct prt_mesh *mesh;
    const struct hit *hit;
    const struct key *key;
    struct samples *out;
    const struct prt_screen_light *light; // distant, whose irradiance the samples get; or NULL
    const float *eta;
};

static int place_samples(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct place_job *job = arg;
    struct samples *s = job->out;
    for (size_t i = begin; i < end; i++) {
        const struct hit *h = &job->hit[job->key[i].index];
        prt_sample_place(job->mesh, h->triangle, (double)h->u, (double)h->v, s, (uint32_t)i);
        s->area[i] = h->area;
        s->object[i] = (uint32_t)(job->key[i].code >> CODE_BITS);
        if (!job->light) continue;
        double c = 0;
        for (int k = 0; k < 3; k++) c += (double)(s->normal[k][i] * job->light->where[k]);
        double eta = (double)job->eta[s->object[i]];
        double f = c > 0 ? prt_fresnel_transmittance(eta, fmin(c, 1)) * c : 0;
        for (int k = 0; k < 3; k++) s->e[k][i] = (float)(f * (double)job->light->rgb[k]);
    }
    return PRT_OK;
}

// All rows of one or more grids as samples, by object and along a Morton curve.
static int collect(const struct prt_context *ctx, const struct ray_grid *view, uint32_t n_view,
                   const struct prt_screen_light *light, const float *eta, struct samples *out)
{
    size_t n = 0, at = 0;
    for (uint32_t k = 0; k < n_view; k++)
        for (uint32_t j = 0; j < view[k].nv; j++) n += view[k].row[j].n;
    struct key *key = malloc(2 * (n + 1) * sizeof *key);
    struct hit *hit = malloc((n + 1) * sizeof *hit);
    if (!key || !hit || n > UINT32_MAX / 2 || !prt_samples_init(out, (uint32_t)n)) {
        free(key);
        free(hit);
        return prt_fail(ctx, PRT_NOMEM, "screen: no memory for %zu surface points", n);
    }
    for (uint32_t k = 0; k < n_view; k++) {
        for (uint32_t j = 0; j < view[k].nv; j++) {
            for (uint32_t i = 0; i < view[k].row[j].n; i++, at++) {
                hit[at] = view[k].row[j].hit[i];
                key[at] = (struct key){hit[at].code, (uint32_t)at};
            }
        }
    }
    struct place_job job = {view[0].mesh, hit,   prt_sort_keys(key, key + n + 1, n),
                            out,          light, eta};
    int status = prt_parallel_for(ctx, NULL, n, 1024, place_samples, &job);
    out->n = (uint32_t)n;
    free(key);
    free(hit);
    if (status) prt_samples_finish(out);
    return status;
}

static int trace_view(const struct prt_context *ctx, struct ray_grid *view, uint64_t *n_ray)
{
    view->row = calloc(view->nv, sizeof *view->row);
    if (!view->row) return prt_fail(ctx, PRT_NOMEM, "screen: no memory for %u rows", view->nv);
    int status = prt_screen_loop(ctx, view->nv, 4, view_rows, view);
    *n_ray += atomic_load(&view->rays);
    return status;
}

static void free_view(struct ray_grid *view)
{
    for (uint32_t j = 0; view->row && j < view->nv; j++) free(view->row[j].hit);
    free(view->row);
}

// The grid starts at a multiple of its step, so that small moves of the light keep its points
// (S09: no flicker). The fraction avoids vertices at round coordinates.
static float snap(double lo, double step, float phase)
{
    return (float)((floor(lo / step - (double)phase) + 0.4871 + (double)phase) * step);
}

// Extent of translucent vertices along a direction.
static void extent(const struct prt_mesh *mesh, const float d[3], double *lo, double *hi)
{
    *lo = INFINITY;
    *hi = -INFINITY;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        if (!prt_block_translucent(mesh, b)) continue;
        const struct prt_block *k = &mesh->block[b];
        for (uint32_t v = k->vertex_begin; v < k->vertex_begin + k->n_vertex; v++) {
            double x = 0;
            for (int i = 0; i < 3; i++) x += (double)d[i] * mesh->position[v][i];
            *lo = fmin(*lo, x);
            *hi = fmax(*hi, x);
        }
    }
}

static void set_view(struct ray_grid *view, const struct prt_mesh *mesh,
                     const struct grid *grid, const double ends[2])
{
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    memcpy(view->lo, box[0], sizeof view->lo);
    view->inv_edge = prt_inverse_edge(box);
    double ulo, uhi, vlo, vhi;
    extent(mesh, view->u, &ulo, &uhi);
    extent(mesh, view->v, &vlo, &vhi);
    float a = snap(ulo, (double)view->step, grid->phase[0]);
    float b = snap(vlo, (double)view->step, grid->phase[1]);
    double margin = 1e-3 * (ends[1] - ends[0]) + 10.0 * view->epsilon;
    view->nu = (uint32_t)fmax(1, ceil((uhi - a) / view->step) + 1);
    view->nv = (uint32_t)fmax(1, ceil((vhi - b) / view->step) + 1);
    view->length = (float)(ends[1] - ends[0] + 2 * margin);
    for (int k = 0; k < 3; k++)
        view->origin[k] =
            a * view->u[k] + b * view->v[k] + (float)(ends[0] - margin) * view->d[k];
}

int prt_samples_peel(const struct prt_context *ctx, const struct prt_scene *scene,
                     const struct grid *grid, struct samples *out, uint64_t *n_ray)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    struct ray_grid view[3];
    memset(view, 0, sizeof view);
    int status = PRT_OK;
    for (int a = 0; a < 3 && !status; a++) {
        struct ray_grid *v = &view[a];
        v->scene = scene;
        v->mesh = mesh;
        v->triangle_block = grid->triangle_block;
        v->axis = a;
        v->step = grid->spacing_mm;
        v->epsilon = prt_scene_epsilon(scene);
        v->d[a] = v->u[(a + 1) % 3] = v->v[(a + 2) % 3] = 1;
        double ends[2];
        extent(mesh, v->d, &ends[0], &ends[1]);
        set_view(v, mesh, grid, ends);
        status = trace_view(ctx, v, n_ray);
    }
    if (!status) status = collect(ctx, view, 3, NULL, NULL, out);
    for (int a = 0; a < 3; a++) free_view(&view[a]);
    return status;
}

// The grid of a distant light: d along the light, u and v across it.
static void aim(struct ray_grid *view, const struct prt_mesh *mesh,
                const struct prt_scene *scene, const struct prt_screen_light *light,
                const struct grid *grid)
{
    *view = (struct ray_grid){.scene = scene,
                              .mesh = mesh,
                              .axis = -1,
                              .step = grid->spacing_mm,
                              .epsilon = prt_scene_epsilon(scene),
                              .triangle_block = grid->triangle_block};
    const float *w = light->where;
    int least = fabsf(w[0]) < fabsf(w[1]) ? 0 : 1;
    if (fabsf(w[2]) < fabsf(w[least])) least = 2;
    float helper[3] = {0, 0, 0};
    helper[least] = 1;
    float l = 0;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        view->d[k] = -w[k];
        view->u[k] = w[i] * helper[j] - w[j] * helper[i];
        l += view->u[k] * view->u[k];
    }
    for (int k = 0; k < 3; k++) view->u[k] /= sqrtf(l);
    float across[3], cosine = cosf(grid->turn), sine = sinf(grid->turn);
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        across[k] = w[i] * view->u[j] - w[j] * view->u[i];
    }
    for (int k = 0; k < 3; k++) {
        float u = view->u[k];
        view->u[k] = cosine * u + sine * across[k];
        view->v[k] = cosine * across[k] - sine * u;
    }
    // rays start outside all triangles, opaque ones included, since those cast shadows
    double ends[2] = {INFINITY, -INFINITY};
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        double x = 0;
        for (int k = 0; k < 3; k++) x += (double)view->d[k] * (double)mesh->position[v][k];
        ends[0] = fmin(ends[0], x);
        ends[1] = fmax(ends[1], x);
    }
    set_view(view, mesh, grid, ends);
}

int prt_samples_light_view(const struct prt_context *ctx, const struct prt_scene *scene,
                           const struct prt_screen_light *light, const struct grid *grid,
                           const float *eta, struct samples *out, uint32_t *n_grid,
                           uint64_t *n_ray)
{
    struct ray_grid view;
    aim(&view, prt_scene_mesh(scene), scene, light, grid);
    *n_grid = view.nu > view.nv ? view.nu : view.nv;
    int status = trace_view(ctx, &view, n_ray);
    if (!status) status = collect(ctx, &view, 1, light, eta, out);
    free_view(&view);
    return status;
}

static uint32_t bfloat16(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, 4);
    return (bits + 0x8000) >> 16;
}

struct map_job {
    struct ray_grid *view;
    struct light_map *map;
    const struct prt_screen_light *light;
    const float *eta;
};

static int fill_map(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct map_job *job = arg;
    const struct ray_grid *view = job->view;
    for (size_t j = begin; j < end; j++) {
        struct light_texel *row = job->map->texel + j * view->nu;
        for (uint32_t i = 0; i < view->nu; i++) row[i].object = UINT32_MAX;
        for (uint32_t i = 0; i < view->row[j].n; i++) {
            const struct hit *h = &view->row[j].hit[i];
            const uint32_t *v = view->mesh->triangle[h->triangle];
            struct light_texel *q = &row[h->column];
            float w[3] = {1 - h->u - h->v, h->u, h->v}, n[3], l = 0, c = 0;
            q->depth = 0;
            for (int k = 0; k < 3; k++) {
                float p = 0;
                n[k] = 0;
                for (int a = 0; a < 3; a++) {
                    p += w[a] * view->mesh->position[v[a]][k];
                    n[k] += w[a] * view->mesh->normal[v[a]][k];
                }
                q->depth += (p - view->origin[k]) * view->d[k];
                l += n[k] * n[k];
                c += n[k] * job->light->where[k];
            }
            q->object = (uint32_t)(h->code >> CODE_BITS);
            c = l > 0 ? c / sqrtf(l) : 0;
            // E dA = F_t cos L dA; h->area divides the cosine to the face out again
            double f = c > 0 ? prt_fresnel_transmittance((double)job->eta[q->object],
                                                         fmin((double)c, 1)) *
                                   (double)c
                             : 0;
            double area = (double)(h->area / (view->step * view->step)), face[3], a = 0, b = 0;
            face_normal(view->mesh, h->triangle, face);
            double along = 0;
            for (int k = 0; k < 3; k++) {
                along += face[k] * (double)view->d[k];
                a += face[k] * (double)view->u[k];
                b += face[k] * (double)view->v[k];
            }
            // bounds the slope of grazing planes to 10
            along = copysign(fmax(fabs(along), 0.1), along);
            q->slope = bfloat16((float)(-a / along)) << 16 | bfloat16((float)(-b / along));
            q->e = (float)(f * area);
        }
    }
    return PRT_OK;
}

int prt_light_map_make(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_screen_light *light, const struct grid *grid,
                       const float *eta, struct light_map *out, uint64_t *n_ray)
{
    struct ray_grid view;
    memset(out, 0, sizeof *out);
    aim(&view, prt_scene_mesh(scene), scene, light, grid);
    int status = trace_view(ctx, &view, n_ray);
    out->nu = view.nu;
    out->nv = view.nv;
    out->step = view.step;
    for (int k = 0; k < 3; k++) {
        out->origin[k] = view.origin[k];
        out->u[k] = view.u[k];
        out->v[k] = view.v[k];
        out->d[k] = view.d[k];
    }
    if (!status && !(out->texel = prt_calloc((size_t)view.nu * view.nv, sizeof *out->texel)))
        status = prt_fail(ctx, PRT_NOMEM, "screen: no memory for a light's view");
    struct map_job job = {&view, out, light, eta};
    if (!status) status = prt_parallel_for(ctx, NULL, view.nv, 8, fill_map, &job);
    free_view(&view);
    return status;
}

void prt_light_map_finish(struct light_map *map)
{
    prt_free(map->texel);
    map->texel = NULL;
}
