// SPDX-License-Identifier: MIT
// Points of the surface: atlas texels, peeled depth layers, a distant light's view.
#include "internal.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

bool samples_init(struct samples *s, uint32_t capacity)
{
    memset(s, 0, sizeof *s);
    capacity = (capacity + 47) & ~15u;
    bool good = (s->area = prt_calloc(capacity, 4)) && (s->object = prt_calloc(capacity, 4)) &&
                (s->triangle = prt_calloc(capacity, 4)) &&
                (s->bary[0] = prt_calloc(capacity, 4)) &&
                (s->bary[1] = prt_calloc(capacity, 4));
    for (int k = 0; k < 3 && good; k++)
        good = (s->p[k] = prt_calloc(capacity, 4)) &&
               (s->normal[k] = prt_calloc(capacity, 4)) &&
               (s->face[k] = prt_calloc(capacity, 4)) && (s->e[k] = prt_calloc(capacity, 4));
    s->capacity = capacity;
    if (!good) samples_finish(s);
    return good;
}

void samples_finish(struct samples *s)
{
    for (int k = 0; k < 3; k++) {
        prt_free(s->p[k]);
        prt_free(s->normal[k]);
        prt_free(s->face[k]);
        prt_free(s->e[k]);
    }
    prt_free(s->area);
    prt_free(s->object);
    prt_free(s->triangle);
    prt_free(s->bary[0]);
    prt_free(s->bary[1]);
    memset(s, 0, sizeof *s);
}

bool block_translucent(const struct prt_mesh *mesh, uint32_t block)
{
    return mesh->surface[mesh->block[block].surface].translucent != 0;
}

// Position, smooth normal and face normal of a place in a triangle; its area.
double place(const struct prt_mesh *mesh, uint32_t t, double bu, double bv, struct samples *s,
             uint32_t at)
{
    const uint32_t *v = mesh->triangle[t];
    double w[3] = {1 - bu - bv, bu, bv}, n[3], e1[3], e2[3], face[3], length = 0, fl = 0;
    for (int k = 0; k < 3; k++) {
        double p = 0;
        n[k] = 0;
        for (int j = 0; j < 3; j++) {
            p += w[j] * mesh->position[v[j]][k];
            n[k] += w[j] * mesh->normal[v[j]][k];
        }
        e1[k] = (double)mesh->position[v[1]][k] - mesh->position[v[0]][k];
        e2[k] = (double)mesh->position[v[2]][k] - mesh->position[v[0]][k];
        s->p[k][at] = (float)p;
        length += n[k] * n[k];
    }
    for (int k = 0; k < 3; k++) {
        int a = (k + 1) % 3, b = (k + 2) % 3;
        face[k] = e1[a] * e2[b] - e1[b] * e2[a];
        fl += face[k] * face[k];
    }
    s->triangle[at] = t;
    s->bary[0][at] = (float)bu;
    s->bary[1][at] = (float)bv;
    length = sqrt(length);
    fl = sqrt(fl);
    for (int k = 0; k < 3; k++) {
        s->face[k][at] = (float)(fl > 0 ? face[k] / fl : 0);
        s->normal[k][at] = (float)(length > 1e-12 ? n[k] / length : s->face[k][at]);
    }
    return fl / 2;
}

enum { DIGIT = 11, DIGITS = 1 << DIGIT };

// A place on a Morton curve of 1024³ cells.
static uint64_t morton(const float lo[3], float inv_edge, const float p[3])
{
    uint64_t code = 0;
    for (int k = 0; k < 3; k++) {
        float f = (p[k] - lo[k]) * inv_edge * 1023;
        code |= morton_spread(f > 0 ? f < 1023 ? (uint64_t)f : 1023 : 0) << k;
    }
    return code;
}

// Stable radix sort, as many digits as the largest code has. Returns the array that holds the
// result, one of the two.
struct key *sort_keys(struct key *key, struct key *other, size_t n)
{
    uint64_t all = 0;
    for (size_t i = 0; i < n; i++) all |= key[i].code;
    for (unsigned shift = 0; shift < 64 && all >> shift; shift += DIGIT) {
        size_t start[DIGITS + 1] = {0};
        for (size_t i = 0; i < n; i++) start[(key[i].code >> shift & (DIGITS - 1)) + 1]++;
        for (int k = 0; k < DIGITS; k++) start[k + 1] += start[k];
        for (size_t i = 0; i < n; i++)
            other[start[key[i].code >> shift & (DIGITS - 1)]++] = key[i];
        struct key *swap = key;
        key = other;
        other = swap;
    }
    return key;
}

static float inverse_edge(float box[2][3])
{
    float edge = 1e-20f;
    for (int k = 0; k < 3; k++) edge = max_f(edge, box[1][k] - box[0][k]);
    return 1 / edge;
}

// A place in the unit triangle from f in [0,1), along Sierpinski's curve: halving at the middle
// of the side it runs along keeps equal steps equal areas, and the curve never jumps.
static void walk_triangle(double f, double *bu, double *bv)
{
    double a[2] = {1, 0}, b[2] = {0, 1}, c[2] = {0, 0};
    for (unsigned level = 0; level < 24; level++) {
        f *= 2;
        bool second = f >= 1;
        f -= second;
        for (int k = 0; k < 2; k++) {
            double m = (a[k] + b[k]) / 2;
            if (second) a[k] = c[k];
            else b[k] = c[k];
            c[k] = m;
        }
    }
    *bu = (a[0] + b[0] + c[0]) / 3;
    *bv = (a[1] + b[1] + c[1]) / 3;
}

// Translucent triangles by object and along a Morton curve; *memory is to be freed.
static struct key *order_triangles(const struct prt_mesh *mesh, uint32_t *n_out, void **memory)
{
    struct key *key = malloc(2 * ((size_t)mesh->n_triangle + 1) * sizeof *key);
    *memory = key;
    if (!key) return NULL;
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    float inv = inverse_edge(box);
    uint32_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        if (!block_translucent(mesh, b)) continue;
        const struct prt_block *k = &mesh->block[b];
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle; t++) {
            float c[3] = {0, 0, 0};
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) c[i] += mesh->position[mesh->triangle[t][j]][i] / 3;
            key[n++] =
                (struct key){(uint64_t)k->object << CODE_BITS | morton(box[0], inv, c), t};
        }
    }
    *n_out = n;
    return sort_keys(key, key + mesh->n_triangle + 1, n);
}

int samples_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                  struct samples *out)
{
    uint32_t n_key = 0;
    void *memory;
    struct key *key = order_triangles(mesh, &n_key, &memory);
    double total = 0, *end = malloc(((size_t)n_key + 1) * sizeof *end);
    uint64_t count = 0;
    if (!key || !end) goto nomem;
    for (uint32_t i = 0; i < n_key; i++) {
        total += triangle_area(mesh, key[i].index);
        end[i] = total;
    }
    if (!(total > 0)) {
        free(memory);
        free(end);
        return prt_fail(ctx, PRT_ARG, "screen: no translucent triangle has any area");
    }
    if (!samples_init(out, n + 64 * (mesh->n_object + 1))) goto nomem;
    for (uint32_t first = 0, last; first < n_key; first = last) {
        double before = first ? end[first - 1] : 0;
        last = first;
        uint64_t object = key[first].code >> CODE_BITS;
        while (last < n_key && key[last].code >> CODE_BITS == object) last++;
        double own = end[last - 1] - before;
        if (!(own > 0)) continue;
        uint32_t share = (uint32_t)(n * (own / total)), at = first;
        if (share < 16) share = 16;
        for (uint32_t i = 0; i < share; i++, count++) {
            double a = before + (i + 0.5) / share * own, bu, bv;
            while (at + 1 < last && end[at] <= a) at++;
            double low = at ? end[at - 1] : 0, size = end[at] - low;
            walk_triangle(size > 0 ? fmin(fmax((a - low) / size, 0), 1) : 0, &bu, &bv);
            place(mesh, key[at].index, bu, bv, out, (uint32_t)count);
            out->area[count] = (float)(own / share);
            out->object[count] = (uint32_t)object;
        }
    }
    out->n = (uint32_t)count;
    free(memory);
    free(end);
    return PRT_OK;
nomem:
    free(memory);
    free(end);
    return prt_fail(ctx, PRT_NOMEM, "screen: no memory for an atlas of %u texels", n);
}

struct hit {
    uint64_t code;
    uint32_t triangle, column;
    float u, v, area;
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

// A bundle of parallel rays: origin + (i u + j v) step, along d.
struct view {
    const struct prt_scene *scene;
    const struct prt_mesh *mesh;
    const uint32_t *triangle_block;
    float origin[3], u[3], v[3], d[3];
    float step, length, epsilon, lo[3], inv_edge;
    uint32_t nu, nv;
    int axis; // >= 0: peel all layers, keep what faces this axis most
    struct row *row;
    atomic_uint_fast64_t rays;
};

static void face_normal(const struct prt_mesh *mesh, uint32_t t, double n[3])
{
    const float *a = mesh->position[mesh->triangle[t][0]];
    const float *b = mesh->position[mesh->triangle[t][1]];
    const float *c = mesh->position[mesh->triangle[t][2]];
    double e[2][3];
    for (int k = 0; k < 3; k++) {
        e[0][k] = (double)b[k] - a[k];
        e[1][k] = (double)c[k] - a[k];
    }
    double l = 0;
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        n[k] = e[0][i] * e[1][j] - e[0][j] * e[1][i];
        l += n[k] * n[k];
    }
    l = l > 0 ? 1 / sqrt(l) : 0;
    for (int k = 0; k < 3; k++) n[k] *= l;
}

// What a hit is worth as an area sample; 0: nothing.
static float hit_area(const struct view *view, uint32_t t)
{
    if (!block_translucent(view->mesh, view->triangle_block[t])) return 0;
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
    // seen from the light: the back of a face takes in nothing
    if (!(c < -0.02)) return 0;
    return (float)(view->step * view->step / -c);
}

static uint64_t hit_code(const struct view *view, const struct prt_packet *p, uint32_t k)
{
    float at[3] = {p->ox[k] + p->t[k] * p->dx[k], p->oy[k] + p->t[k] * p->dy[k],
                   p->oz[k] + p->t[k] * p->dz[k]};
    uint32_t object = view->mesh->block[view->triangle_block[p->triangle[k]]].object;
    return (uint64_t)object << CODE_BITS | morton(view->lo, view->inv_edge, at);
}

static int view_rows(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct view *view = arg;
    uint64_t rays = 0;
    prt_trace_thread_init();
    for (size_t j = begin; j < end; j++) {
        for (uint32_t i = 0; i < view->nu; i += 16) {
            struct prt_packet p;
            uint32_t mask = 0;
            memset(&p, 0, sizeof p);
            for (uint32_t k = 0; k < 16; k++) {
                float a = (float)(i + k) * view->step, b = (float)j * view->step;
                p.ox[k] = view->origin[0] + a * view->u[0] + b * view->v[0];
                p.oy[k] = view->origin[1] + a * view->u[1] + b * view->v[1];
                p.oz[k] = view->origin[2] + a * view->u[2] + b * view->v[2];
                p.dx[k] = view->d[0];
                p.dy[k] = view->d[1];
                p.dz[k] = view->d[2];
                p.tfar[k] = view->length;
                mask |= (uint32_t)(i + k < view->nu) << k;
            }
            for (int layer = 0; mask && layer < 64; layer++) {
                rays += (uint32_t)__builtin_popcount(mask);
                prt_scene_intersect16(view->scene, &p, mask, true);
                for (uint32_t k = 0; k < 16; k++) {
                    if (!(mask >> k & 1)) continue;
                    uint32_t t = p.triangle[k];
                    if (t == UINT32_MAX || view->axis < 0) mask &= ~(1u << k);
                    if (t == UINT32_MAX) continue;
                    float area = hit_area(view, t);
                    struct hit hit = {hit_code(view, &p, k), t, i + k, p.u[k], p.v[k], area};
                    if (area > 0 && !push_hit(&view->row[j], hit)) return PRT_NOMEM;
                    p.tnear[k] = p.t[k] * 1.000001f + view->epsilon;
                    p.tfar[k] = view->length;
                }
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
        place(job->mesh, h->triangle, (double)h->u, (double)h->v, s, (uint32_t)i);
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

// Rows of one or more views as samples, by object and along a Morton curve.
static int collect(const struct prt_context *ctx, const struct view *view, uint32_t n_view,
                   const struct prt_screen_light *light, const float *eta, struct samples *out)
{
    size_t n = 0, at = 0;
    for (uint32_t k = 0; k < n_view; k++)
        for (uint32_t j = 0; j < view[k].nv; j++) n += view[k].row[j].n;
    struct key *key = malloc(2 * (n + 1) * sizeof *key);
    struct hit *hit = malloc((n + 1) * sizeof *hit);
    if (!key || !hit || n > UINT32_MAX / 2 || !samples_init(out, (uint32_t)n)) {
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
    struct place_job job = {view[0].mesh, hit, sort_keys(key, key + n + 1, n), out, light, eta};
    int status = prt_parallel_for(ctx, NULL, n, 1024, place_samples, &job);
    out->n = (uint32_t)n;
    free(key);
    free(hit);
    if (status) samples_finish(out);
    return status;
}

static int trace_view(const struct prt_context *ctx, struct view *view, uint64_t *n_ray)
{
    view->row = calloc(view->nv, sizeof *view->row);
    if (!view->row) return prt_fail(ctx, PRT_NOMEM, "screen: no memory for %u rows", view->nv);
    int status = screen_loop(ctx, view->nv, 4, view_rows, view);
    *n_ray += atomic_load(&view->rays);
    return status;
}

static void free_view(struct view *view)
{
    for (uint32_t j = 0; view->row && j < view->nv; j++) free(view->row[j].hit);
    free(view->row);
}

// The grid starts at a multiple of its step, so that small moves of the view keep its points;
// the fraction keeps rays off vertices that lie on round numbers.
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
        if (!block_translucent(mesh, b)) continue;
        const struct prt_block *k = &mesh->block[b];
        for (uint32_t v = k->vertex_begin; v < k->vertex_begin + k->n_vertex; v++) {
            double x = 0;
            for (int i = 0; i < 3; i++) x += (double)d[i] * mesh->position[v][i];
            *lo = fmin(*lo, x);
            *hi = fmax(*hi, x);
        }
    }
}

static void set_view(struct view *view, const struct prt_mesh *mesh, const struct grid *grid,
                     const double ends[2])
{
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    memcpy(view->lo, box[0], sizeof view->lo);
    view->inv_edge = inverse_edge(box);
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

int samples_peel(const struct prt_context *ctx, const struct prt_scene *scene,
                 const struct grid *grid, struct samples *out, uint64_t *n_ray)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    struct view view[3];
    memset(view, 0, sizeof view);
    int status = PRT_OK;
    for (int a = 0; a < 3 && !status; a++) {
        struct view *v = &view[a];
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

// A light's view: along the light, u and v across it.
static void aim(struct view *view, const struct prt_mesh *mesh, const struct prt_scene *scene,
                const struct prt_screen_light *light, const struct grid *grid)
{
    *view = (struct view){.scene = scene,
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
    // rays start before anything that could cast a shadow
    double ends[2] = {INFINITY, -INFINITY};
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        double x = 0;
        for (int k = 0; k < 3; k++) x += (double)view->d[k] * (double)mesh->position[v][k];
        ends[0] = fmin(ends[0], x);
        ends[1] = fmax(ends[1], x);
    }
    set_view(view, mesh, grid, ends);
}

int samples_light_view(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_screen_light *light, const struct grid *grid,
                       const float *eta, struct samples *out, uint32_t *n_grid, uint64_t *n_ray)
{
    struct view view;
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
    struct view *view;
    struct light_map *map;
    const struct prt_screen_light *light;
    const float *eta;
};

static int fill_map(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct map_job *job = arg;
    const struct view *view = job->view;
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
            // E dA is F_t cos L dA: per area across the light the cosine to the face goes
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
            // a grazing plane is not followed for ever
            along = copysign(fmax(fabs(along), 0.1), along);
            q->slope = bfloat16((float)(-a / along)) << 16 | bfloat16((float)(-b / along));
            q->e = (float)(f * area);
        }
    }
    return PRT_OK;
}

int light_map_make(const struct prt_context *ctx, const struct prt_scene *scene,
                   const struct prt_screen_light *light, const struct grid *grid,
                   const float *eta, struct light_map *out, uint64_t *n_ray)
{
    struct view view;
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

void light_map_finish(struct light_map *map)
{
    prt_free(map->texel);
    map->texel = NULL;
}
