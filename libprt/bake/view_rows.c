// SPDX-License-Identifier: MIT
// Single scattering towards an eye: paths that refraction bends towards a few directions of
// exit are traced from the supports. What their radiance has above the planes of -n_o, as
// prt_view_correct corrects them, is fitted by nine planes (METHODS §3.6).
#include "bake/support.h"
#include "bake/view_fit.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_BASE = 16 };                          // planes of -n_o
static const uint32_t nodes = 7, draft_nodes = 5; // depths of a path
static const float never = 1e9f, differ = .1f,
                   uncertain = .3f; // thresholds of blocks; chosen by METHODS §3.6

struct view_bake {
    struct bake *b;
    struct support *s;
    struct directions *directions;
    struct single_plan *axis, *toward; // [media.n] along -n_o; towards a direction
    struct fresnel_table *fresnel;     // prt_bake_single_fresnel
    uint32_t n_base;                   // functions of one direction: 3, or those of a basis
    uint32_t *corner_begin, *corner;   // triangles around each welded vertex
    uint32_t *coarse;                  // [n_coef] texel of the supports
    float *share;                      // [n_coef] of its solid angle
    atomic_uint_fast64_t rays;
};

// ---- plans

// Tiles of 4 x 4 texels take one ray each, or four where they differ from their neighbours; a
// draft's take one: their noise is averaged over directions and supports.
static struct single_plan coarse_plan(const struct single_plan *full,
                                      const struct directions *directions, bool draft)
{
    struct single_plan plan = *full;
    plan.directions = directions;
    plan.n_direction = directions->n_coef;
    plan.every_ray = false;
    plan.n_node = draft ? draft_nodes : nodes;
    if (draft) plan.horizon = NULL; // its rays would outnumber those of a few supports
    plan.differ = draft ? never : differ;
    plan.uncertain = draft ? never : uncertain;
    plan.differ_texel = plan.uncertain_texel = never;
    return plan;
}

static int make_plans(struct view_bake *v)
{
    struct bake *b = v->b;
    for (uint32_t i = 0; i < b->o.media.n; i++) {
        const struct prt_material *m = &b->o.media.medium[i];
        v->axis[i] = coarse_plan(&b->single[i], v->directions, b->o.draft);
        if (b->single[i].extinction) v->axis[i].n_phase = 1;
        v->toward[i] = v->axis[i];
        v->toward[i].n_phase = 1;
        v->toward[i].toward = v->toward[i].isotropic = true;
        for (int c = 0; c < 3; c++) {
            (void)prt_phase_hg(&v->toward[i].phase[c], (double)m->g[c], PRT_PHASE_16);
            v->toward[i].isotropic &= m->g[c] == 0;
        }
    }
    return PRT_OK;
}

static void map_texels(struct view_bake *v)
{
    const uint32_t n = v->directions->n, wide = v->s->light, step = n / wide;
    float *sum = v->share + v->directions->n_coef;
    for (uint32_t t = 0; t < v->s->n_texel; t++) sum[t] = 0;
    for (uint32_t t = 0; t < v->directions->n_coef; t++) {
        const uint32_t face = t / (n * n), y = t / n % n, x = t % n;
        v->coarse[t] = (face * wide + y / step) * wide + x / step;
        sum[v->coarse[t]] += v->directions->solid_angle[t];
    }
    for (uint32_t t = 0; t < v->directions->n_coef; t++)
        v->share[t] = v->directions->solid_angle[t] / sum[v->coarse[t]];
}

static int find_corners(struct view_bake *v)
{
    const struct prt_mesh *mesh = v->b->mesh;
    uint32_t *begin = v->corner_begin = prt_calloc(mesh->n_weld + 2u, sizeof *begin);
    v->corner = prt_calloc(3ull * mesh->n_triangle + 1, sizeof *v->corner);
    if (!begin || !v->corner) return PRT_NOMEM;
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int k = 0; k < 3; k++) begin[mesh->weld[mesh->triangle[t][k]] + 2]++;
    for (uint32_t w = 0; w < mesh->n_weld; w++) begin[w + 2] += begin[w + 1];
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int k = 0; k < 3; k++)
            v->corner[begin[mesh->weld[mesh->triangle[t][k]] + 1]++] = t;
    return PRT_OK;
}

// ---- one support

static float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static bool face_normal(const struct prt_mesh *mesh, uint32_t t, float out[3])
{
    const float *a = mesh->position[mesh->triangle[t][0]],
                *b = mesh->position[mesh->triangle[t][1]],
                *c = mesh->position[mesh->triangle[t][2]];
    float e[3], f[3];
    for (int k = 0; k < 3; k++) e[k] = b[k] - a[k], f[k] = c[k] - a[k];
    for (int k = 0; k < 3; k++)
        out[k] = e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3];
    const float length = sqrtf(dot3(out, out));
    for (int k = 0; k < 3; k++) out[k] /= length > 0 ? length : 1;
    return length > 0;
}

// At a crease the path may lead out of the body between the vertex's own faces: it is bent
// towards -n as the reference engine bends it (METHODS §1).
static void bend_inwards(const struct view_bake *v, uint32_t vertex, const float out[3],
                         float bent[3])
{
    const struct prt_mesh *mesh = v->b->mesh;
    const float *n = mesh->normal[vertex];
    const uint32_t w = mesh->weld[vertex];
    float least = 1, length;
    memcpy(bent, out, 3 * sizeof *bent);
    for (uint32_t k = v->corner_begin[w]; k < v->corner_begin[w + 1]; k++) {
        float face[3];
        if (!face_normal(mesh, v->corner[k], face)) continue;
        const float own = -dot3(face, out), straight = -dot3(face, n), limit = 0.05f * straight;
        if (straight < 0 && own > limit)
            least = fminf(least, (straight - limit) / (straight - own));
    }
    if (least >= 1) return;
    for (int k = 0; k < 3; k++) bent[k] = least * out[k] + (1 - least) * n[k];
    length = sqrtf(dot3(bent, bent));
    for (int k = 0; k < 3; k++) bent[k] /= length;
}

// A thread's arrays. value: cells of one direction; row: texels of all directions.
struct view_scratch {
    void *rays;
    float *value; // [MOST_BASE n_base][n_coef]
    float *row;   // [VIEW_VALUES][n_base][n_texel]
    float *plane; // [n_phase][n_base][n_texel] of -n_o
    float *out;   // [VIEW_PLANES][n_base][n_texel]
};

static int scratch_create(const struct view_bake *v, struct view_scratch *q)
{
    const size_t texels = (size_t)v->n_base * v->s->n_texel, n = v->directions->n_coef;
    q->rays = prt_alloc(prt_single_scratch_bytes(&v->axis[0]), 1);
    q->value = prt_alloc(n * MOST_BASE * v->n_base, sizeof *q->value);
    q->row = prt_alloc(VIEW_VALUES * texels, sizeof *q->row);
    q->plane = prt_alloc(MOST_BASE * texels, sizeof *q->plane);
    q->out = prt_alloc(VIEW_PLANES * texels, sizeof *q->out);
    return q->rays && q->value && q->row && q->plane && q->out ? PRT_OK : PRT_NOMEM;
}

static void scratch_finish(struct view_scratch *q)
{
    prt_free(q->rays);
    prt_free(q->value);
    prt_free(q->row);
    prt_free(q->plane);
    prt_free(q->out);
}

// Cells of n functions to texels of the supports.
static void to_texels(const struct view_bake *v, const struct single_cells *c, uint32_t n,
                      float *out)
{
    memset(out, 0, (size_t)n * v->s->n_texel * sizeof *out);
    for (uint32_t f = 0; f < n; f++) {
        const float *value = c->value + (size_t)f * c->n_cell;
        float *to = out + (size_t)f * v->s->n_texel;
        for (uint32_t t = 0; t < v->directions->n_coef; t++)
            to[v->coarse[t]] += v->share[t] * value[c->cell[t]];
    }
}

// The weight that each plane of -n_o gets in a radiance towards w, corrected for the view.
static void base_weights(const struct view_bake *v, const float n[3],
                         const struct single_plan *p, const float w[3], float out[MOST_BASE])
{
    struct prt_context alone = *v->b->ctx;
    const unsigned n_phase = p->n_phase, n_plane = n_phase < 4 ? 4 : n_phase;
    float y[MOST_BASE];
    alone.pool = NULL;
    alone.progress = NULL;
    prt_sh_eval(n_plane == 16 ? 4 : n_plane == 9 ? 3 : 2, w, y);
    for (unsigned k = 0; k < n_phase; k++) {
        float plane[MOST_BASE][3] = {{0}};
        plane[k][0] = k ? 1 : y[0];
        (void)prt_view_correct(&alone, 1, 0, 1, (const float(*)[3])n, (double)p->eta[0],
                               n_phase, n_plane, plane[0]);
        out[k] = plane[0][0];
        for (unsigned i = 1; i < n_plane; i++) out[k] += y[i] * plane[i][0];
    }
}

// q->row[i] becomes the radiance towards direction i less the corrected planes.
static void subtract_planes(const struct view_bake *v, const struct single_plan *axis,
                            const float n[3], const float w[3], const struct view_scratch *q,
                            float *row)
{
    const size_t texels = (size_t)v->n_base * v->s->n_texel;
    float weight[MOST_BASE];
    base_weights(v, n, axis, w, weight);
    for (unsigned k = 0; k < axis->n_phase; k++)
        for (size_t i = 0; i < texels; i++) row[i] -= weight[k] * q->plane[k * texels + i];
}

static void trace_direction(struct view_bake *v, uint32_t medium, uint32_t vertex,
                            const float w[3], struct view_scratch *q, float *row)
{
    const struct single_plan *toward = &v->toward[medium];
    const size_t texels = (size_t)v->n_base * v->s->n_texel;
    struct single_cells cells;
    float bent[3];
    bend_inwards(v, vertex, w, bent);
    v->rays += prt_single_toward(toward, &v->fresnel[medium], vertex, bent, w, q->value, &cells,
                                 q->rays);
    to_texels(v, &cells, v->n_base, row);
    const float y00 = (float)(0.5 / sqrt(M_PI)); // a basis' rows hold Y_00 of the light alone
    for (size_t i = 0; toward->extinction && i < texels; i++) row[i] *= y00;
    subtract_planes(v, &v->axis[medium], v->b->mesh->normal[vertex], w, q, row);
}

static void trace_support(struct view_bake *v, uint32_t i, struct view_scratch *q)
{
    const uint32_t vertex = v->s->vertex[i], medium = prt_bake_medium(v->b, v->s->cluster[i]);
    const size_t texels = (size_t)v->n_base * v->s->n_texel;
    const float *n = v->b->mesh->normal[vertex];
    const struct single_plan *axis = &v->axis[medium];
    struct single_cells cells;
    float w[VIEW_VALUES][3], matrix[VIEW_PLANES][VIEW_VALUES];
    v->rays += prt_single_cells(axis, &v->fresnel[medium], vertex, q->value, &cells, q->rays);
    to_texels(v, &cells, axis->n_phase * v->n_base, q->plane);
    prt_view_directions((double)axis->eta[0], n,
                        (double)(prt_hash64(&vertex, sizeof vertex, 3) % 4096) / 4096, w);
    for (int d = 0; d < VIEW_VALUES; d++) {
        float *row = q->row + (size_t)d * texels;
        // along the normal an isotropic medium has what was baked
        if (d || !(v->toward[medium].isotropic || axis->extinction))
            trace_direction(v, medium, vertex, w[d], q, row);
        else memset(row, 0, texels * sizeof *row);
    }
    prt_view_fit((const float(*)[3])w, matrix);
    memset(q->out, 0, VIEW_PLANES * texels * sizeof *q->out);
    for (int k = 0; k < VIEW_PLANES; k++)
        for (int d = 0; d < VIEW_VALUES; d++)
            for (size_t t = 0; t < texels; t++)
                q->out[(size_t)k * texels + t] += matrix[k][d] * q->row[(size_t)d * texels + t];
    prt_support_set(v->s, i, q->out);
}

static int view_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct view_bake *v = arg;
    struct view_scratch q = {0};
    prt_trace_thread_init();
    int status = scratch_create(v, &q);
    for (size_t i = begin; status == PRT_OK && i < end; i++) trace_support(v, (uint32_t)i, &q);
    scratch_finish(&q);
    return status;
}

// ---- all supports

static int axis_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct view_bake *v = arg;
    struct view_scratch q = {0};
    prt_trace_thread_init();
    int status = scratch_create(v, &q);
    for (size_t i = begin; status == PRT_OK && i < end; i++) {
        const uint32_t medium = prt_bake_medium(v->b, v->s->cluster[i]);
        struct single_cells cells;
        const struct single_plan *axis = &v->axis[medium];
        v->rays += prt_single_cells(axis, prt_plan_fresnel(v->fresnel, axis, medium),
                                    v->s->vertex[i], q.value, &cells, q.rays);
        to_texels(v, &cells, axis->n_phase * v->n_base, q.plane);
        prt_support_set(v->s, (uint32_t)i, q.plane);
    }
    scratch_finish(&q);
    return status;
}

static int trace(struct bake *b, const struct extinction_table *extinction, const char *stage,
                 prt_loop_fn range, bool whole_phase, struct support *s)
{
    struct view_bake v = {
        .b = b, .s = s, .n_base = extinction ? b->single[0].n_eta * extinction->n_function : 3};
    const uint32_t light = SUPPORT_LIGHT;
    int status = prt_directions_create(b->ctx->cpu, light, prt_bake_patterns(&b->o), b->o.seed,
                                       &v.directions);
    v.axis = prt_calloc(b->o.media.n, sizeof *v.axis);
    v.toward = prt_calloc(b->o.media.n, sizeof *v.toward);
    v.fresnel = prt_bake_single_fresnel(b);
    v.coarse = prt_alloc(6ull * light * light, sizeof *v.coarse);
    v.share = prt_alloc(12ull * light * light, sizeof *v.share);
    if (!v.axis || !v.toward || !v.fresnel || !v.coarse || !v.share) status = PRT_NOMEM;
    if (status == PRT_OK) status = make_plans(&v);
    for (uint32_t i = 0; status == PRT_OK && whole_phase && i < b->o.media.n; i++)
        v.axis[i].n_phase = b->single[i].n_phase;
    if (status == PRT_OK) map_texels(&v);
    if (status == PRT_OK) status = find_corners(&v);
    if (status == PRT_OK) status = prt_parallel_for(b->ctx, stage, s->n, 8, range, &v);
    if (status == PRT_OK) b->rays_single[0] += v.rays;
    prt_directions_destroy(v.directions);
    prt_free(v.axis);
    prt_free(v.toward);
    prt_free(v.fresnel);
    prt_free(v.coarse);
    prt_free(v.share);
    prt_free(v.corner_begin);
    prt_free(v.corner);
    return status;
}

int prt_support_trace_axis(struct bake *b, const struct extinction_table *extinction,
                           struct support *s)
{
    return trace(b, extinction, "single scattering", axis_range, true, s);
}

int prt_support_trace_view(struct bake *b, const struct extinction_table *extinction,
                           struct support *s)
{
    return trace(b, extinction, "exit directions", view_range, false, s);
}
