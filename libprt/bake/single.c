// SPDX-License-Identifier: MIT
// Single scattering along -n_o (W05 eq 10-12, METHODS §3.5) with far fewer rays than texels x
// points: along the path the exits are traced at a few depths only (single_plan.c,
// single_nodes.c), texels that share their rays are gathered into cells, and path_integral.c
// integrates between the depths.
#include "bake/single.h"
#include "bake/work.h"

#include <stdlib.h>
#include <string.h>

// Floats of one direction: the exits of the nodes at each index, the values that compare them
// (value, uncertain and step 1/4 each, coarse and fine 1/16 each), and cosine, cell, first,
// split and list.
size_t prt_single_scratch_bytes(const struct single_plan *plan)
{
    const size_t arrays = SINGLE_MAX_NODES * (5 * (size_t)plan->n_eta + 2) + 5;
    return (arrays * plan->n_direction + 64 + 32) * sizeof(float) +
           prt_draw_bytes(plan->n_direction, SINGLE_MAX_NODES);
}

static void carve(const struct single_plan *plan, void *memory, struct scratch *s)
{
    float *at = memory;
    uint32_t n = plan->n_direction;
    s->node = s->of_eta[0];
    for (uint32_t i = 0; i < plan->n_eta * SINGLE_MAX_NODES; i++) {
        struct exits *e = &s->of_eta[i / SINGLE_MAX_NODES][i % SINGLE_MAX_NODES];
        e->path_mm = at, at += n;
        e->transmittance = at, at += n;
        for (int k = 0; k < 3; k++) e->dir[k] = at, at += n;
    }
    for (int a = 0; a < SINGLE_MAX_NODES; a++) {
        s->value[a] = at;
        s->uncertain[a] = at + n / 4;
        s->fine[a] = at + n / 2, at += n;
        s->step[a] = at, at += n / 4;
    }
    s->cosine = at, at += n;
    s->cell = (uint32_t *)at, at += n;
    s->first = (uint32_t *)at, at += n;
    s->split = (uint8_t *)at, at += n;
    s->list = (uint32_t *)at, at += n + 16;
    s->y = at;
    size_t used = (size_t)((char *)(at + 64) - (char *)memory);
    prt_draw_carve((char *)memory + (used + 63) / 64 * 64, n, SINGLE_MAX_NODES, &s->draw);
}

static float luminance(const float c[3])
{
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
}

// Makes n texels a cell, whose cosine with the normal is their mean.
static void add_cell(struct scratch *s, const uint32_t *texel, uint32_t n, uint32_t *n_cell)
{
    float cosine = 0;
    for (uint32_t i = 0; i < n; i++) cosine += s->cosine[texel[i]], s->cell[texel[i]] = *n_cell;
    s->first[*n_cell] = texel[0];
    s->cosine[texel[0]] = cosine / (float)n;
    ++*n_cell;
}

// Texels that share their rays at every node become one cell. Returns the number of cells.
static uint32_t make_cells(const struct single_plan *plan, struct scratch *s)
{
    const struct directions *d = plan->directions;
    uint32_t wide = d->n / 4, n_cell = 0, at[16];
    const unsigned log_wide = (unsigned)__builtin_ctz(wide);
    for (uint32_t t = 0; t < 6 * wide * wide; t++) {
        bool fine = false;
        for (uint32_t a = 0; a < plan->n_node; a++) fine |= s->fine[a][t] > 0;
        for (uint32_t j = 0; j < 4; j++) {
            uint32_t b = block_of(t, j, log_wide);
            memcpy(at + j * 4, d->texel + (size_t)b * 4, 4 * sizeof *at);
            if (!fine) continue;
            if (!s->split[b]) add_cell(s, at + j * 4, 4, &n_cell);
            for (uint32_t i = 0; s->split[b] && i < 4; i++)
                add_cell(s, at + j * 4 + i, 1, &n_cell);
        }
        if (!fine) add_cell(s, at, 16, &n_cell);
    }
    return n_cell;
}

static uint32_t nearest_block(uint32_t i, int step, uint32_t n)
{
    return step < 0 && i == 0 ? 0 : step > 0 && i + 1 == n ? i : i + (uint32_t)step;
}

void prt_smooth_blocks(const uint32_t *cell, uint32_t n, float *value, float *mean)
{
    const uint32_t half = n / 2;
    for (uint32_t b = 0; b < half * half; b++) {
        const float *at = value + (b / half * n + b % half) * 2;
        mean[b] = 0.25f * (at[0] + at[1] + at[n] + at[n + 1]);
    }
    for (uint32_t b = 0; b < half * half; b++) {
        const uint32_t x = b % half, y = b / half, at = (y * n + x) * 2;
        const uint32_t tile = y / 2 * 4 * n + x / 2 * 4; // its first texel
        if (cell[tile] == cell[tile + 3 * n + 3]) continue;
        if (cell[at] != cell[at + n + 1]) continue;
        for (uint32_t i = 0; i < 4; i++) {
            const uint32_t u = nearest_block(x, i & 1 ? 1 : -1, half);
            const uint32_t v = nearest_block(y, i >> 1 ? 1 : -1, half);
            value[at + (i >> 1) * n + (i & 1)] = (9 * mean[b] + 3 * mean[y * half + u] +
                                                  3 * mean[v * half + x] + mean[v * half + u]) /
                                                 16;
        }
    }
}

// Length of the path from x along -out inside the body [mm].
static float thickness_at(const struct single_plan *plan, const float x[3], const float n[3],
                          const float out[3])
{
    float eps = prt_scene_epsilon(plan->scene), down[3], start[3], t, u, v;
    uint32_t triangle;
    float deep = plan->extinction ? plan->inward_mm : fminf(3 * plan->inward_mm, 1e5f);
    for (int k = 0; k < 3; k++) down[k] = -out[k], start[k] = x[k] - eps * n[k];
    if (prt_scene_intersect(plan->scene, start, down, eps, deep, &t, &triangle, &u, &v))
        return fmaxf(t, 4 * eps);
    return deep;
}

uint64_t prt_single_light(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          uint32_t vertex, const struct light_directions *light, float *out,
                          void *memory)
{
    uint32_t n = light->n;
    const float *p = plan->mesh->position[vertex], *normal = plan->mesh->normal[vertex];
    struct scratch s = {0};
    float depth[SINGLE_MAX_NODES], thickness = thickness_at(plan, p, normal, normal);
    uint64_t rays = 1;
    carve(plan, memory, &s);
    s.first = NULL;
    prt_single_plan_nodes(plan, thickness, depth);
    for (uint32_t a = 0; a < plan->n_node; a++) {
        float at[3];
        for (int k = 0; k < 3; k++) at[k] = p[k] - depth[a] * normal[k];
        rays += prt_trace_list(plan, fresnel, at, light, &s.node[a]);
    }
    for (uint32_t t = 0; t < n; t++)
        s.cosine[t] =
            normal[0] * light->x[t] + normal[1] * light->y[t] + normal[2] * light->z[t];
    memset(out, 0, (size_t)plan->n_phase * plan->extinction->n_function * 3 * sizeof *out);
    float end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    prt_path_integrate(
        &(struct path_job){plan, fresnel, &s, depth, end, n, light->rgb, out, NULL, 0, 0});
    return rays;
}

// W05 eq 12 as printed: n_point points and a ray for every texel at each. For measurements.
static uint64_t every_ray(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          const struct vertex_path *path, float thickness, struct scratch *s,
                          float *out)
{
    const struct directions *d = plan->directions;
    uint32_t K = plan->n_phase;
    float sigma = luminance(plan->sigma_t), lambda = 1 - expf(-sigma * thickness);
    uint64_t rays = 0;
    memset(out, 0, (size_t)K * 3 * d->n_coef * sizeof *out);
    for (uint32_t i = 0; i < plan->n_point; i++) {
        float xi = ((float)i + 0.5f) / (float)plan->n_point;
        float depth = -logf(1 - xi * lambda) / sigma, p[3];
        float weight = lambda / ((float)plan->n_point * sigma * expf(-sigma * depth));
        for (int k = 0; k < 3; k++) p[k] = path->x[k] - depth * path->out[k];
        rays += prt_trace_every(plan, fresnel, p, path->pattern + i * 0x51, s);
        for (uint32_t t = 0; t < d->n_coef; t++) {
            float transmittance = s->node[0].transmittance[t];
            if (transmittance <= 0) continue;
            float w[3] = {s->node[0].dir[0][t], s->node[0].dir[1][t], s->node[0].dir[2][t]};
            prt_sh_eval(K == 9 ? 3 : K == 4 ? 2 : 1, w, s->y);
            for (int c = 0; c < 3; c++) {
                float e = transmittance * weight * plan->sigma_s[c] *
                          exp_minus(plan->sigma_t[c] * (depth + s->node[0].path_mm[t]));
                for (uint32_t k = 0; k < K; k++) {
                    out[((size_t)k * 3 + (unsigned)c) * d->n_coef + t] +=
                        e * (float)plan->phase[c].a[path_degree(k)] * s->y[k];
                }
            }
        }
    }
    return rays;
}

// Cells of the path along -out.
static uint64_t cells_along(const struct single_plan *plan, const struct fresnel_table *fresnel,
                            uint32_t vertex, const float *out_dir, const float *toward,
                            float *value, struct single_cells *out, void *memory)
{
    const struct directions *d = plan->directions;
    const float *x = plan->mesh->position[vertex], *n = plan->mesh->normal[vertex];
    struct scratch s = {0};
    carve(plan, memory, &s);
    uint64_t rays = 1;
    float thickness = thickness_at(plan, x, n, out_dir);
    unsigned pattern = (unsigned)(prt_hash64(&vertex, sizeof vertex, plan->seed) >> 20);
    *out = (struct single_cells){d->n_coef, s.cell, value};
    if (plan->every_ray) {
        for (uint32_t t = 0; t < d->n_coef; t++) s.cell[t] = t;
        const struct vertex_path all = {.x = x, .out = out_dir, .pattern = pattern};
        return rays + every_ray(plan, fresnel, &all, thickness, &s, value);
    }
    float depth[SINGLE_MAX_NODES], end;
    prt_single_plan_nodes(plan, thickness, depth);
    for (uint32_t k = 0; k < d->n_packet * 4; k++) {
        size_t at = texel_ray(d, pattern, k / 4, k % 4);
        s.cosine[d->texel[k]] = n[0] * d->x[at] + n[1] * d->y[at] + n[2] * d->z[at];
    }
    const struct vertex_path path = {x, out_dir, pattern, depth};
    uint64_t started = prt_work_begin();
    rays += prt_trace_nodes(plan, fresnel, &path, &s);
    prt_work_end(plan->work, WORK_EXITS, started, rays, 0);
    started = prt_work_begin();
    end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    out->n_cell = make_cells(plan, &s);
    const uint32_t J = plan->extinction ? plan->extinction->n_function : 0;
    for (uint32_t b = 0; b < plan->n_eta; b++) {
        s.node = s.of_eta[b];
        prt_path_integrate(&(struct path_job){plan, &fresnel[b], &s, depth, end, out->n_cell,
                                              NULL, value, toward, plan->n_eta * J, b * J});
    }
    prt_work_end(plan->work, WORK_PATHS, started, 0, 0);
    return rays;
}

uint64_t prt_single_cells(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          uint32_t vertex, float *value, struct single_cells *out, void *memory)
{
    return cells_along(plan, fresnel, vertex, plan->mesh->normal[vertex], NULL, value, out,
                       memory);
}

uint64_t prt_single_toward(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           uint32_t vertex, const float path[3], const float toward[3],
                           float *value, struct single_cells *out, void *memory)
{
    return cells_along(plan, fresnel, vertex, path, toward, value, out, memory);
}

uint64_t prt_single_rows(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         uint32_t vertex, float *out, void *memory)
{
    uint32_t n = plan->directions->n_coef;
    uint32_t n_plane =
        plan->n_phase * (plan->extinction ? plan->n_eta * plan->extinction->n_function : 3);
    struct single_cells c;
    struct scratch s = {0};
    uint64_t rays = prt_single_cells(plan, fresnel, vertex, out, &c, memory);
    carve(plan, memory, &s);
    float *row = s.node[0].path_mm, *mean = s.value[0]; // not used any more
    for (uint32_t p = n_plane; p-- > 0;) {              // in place, the last plane first
        float *to = out + (size_t)p * n;
        memcpy(row, out + (size_t)p * c.n_cell, c.n_cell * sizeof *row);
        for (uint32_t t = 0; t < n; t++) to[t] = row[c.cell[t]];
        for (uint32_t f = 0; f < 6 && prt_single_smooth(plan); f++)
            prt_smooth_blocks(c.cell + f * n / 6, plan->directions->n, to + f * n / 6, mean);
    }
    return rays;
}
