// SPDX-License-Identifier: MIT
// Polynomial transport (X07): the light is fixed and contracted while baking; the material
// stays free as coefficients of radial functions. T_j (X07 eq 10) is summed over the cut of the
// hierarchy, S_j (X07 eq 15) over directions drawn from the light.
#include "bake/checkpoint.h"
#include "bake/polynomial_walks.h"
#include "bake/shard.h"

#include "prt/light.h"
#include "reference/lights.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Rays of one sample, directions of one vertex, and independent sets of them: chosen, not
// measured.
enum { SAMPLE_RAYS = 1024, SINGLE_RAYS = 512, PATTERNS = 64 };

struct polynomial {
    struct bake *b;
    struct bases bases;
    struct light_rays *rays;
    float (*irradiance)[3]; // samples in tree order, then nodes: means under the light
    struct prt_tensor *tensor;
    struct polynomial_walks walks; // of a bake by walks
};

// E at x under the fixed light: sum F_t V L (n.w) over one pattern; fresnel NULL: 1 (opaque).
static void irradiance_at(const struct polynomial *p, size_t pattern, const float x[3],
                          const float n[3], const float f[3],
                          const struct fresnel_table *fresnel, double sum[3])
{
    const struct light_rays *r = p->rays;
    const struct prt_scene *scene = p->b->scene;
    float eps = prt_scene_epsilon(scene);
    size_t base = pattern % r->n_pattern * r->n_ray;
    sum[0] = sum[1] = sum[2] = 0;
    for (uint32_t k = 0; k < r->n_ray; k += 16) {
        struct prt_packet packet;
        float cosine[16];
        uint32_t mask = 0;
        for (uint32_t l = 0; l < 16; l++) {
            size_t at = base + (k + l < r->n_ray ? k + l : k);
            float d[3] = {r->x[at], r->y[at], r->z[at]};
            packet.ox[l] = x[0] + eps * f[0], packet.oy[l] = x[1] + eps * f[1];
            packet.oz[l] = x[2] + eps * f[2];
            packet.dx[l] = d[0], packet.dy[l] = d[1], packet.dz[l] = d[2];
            packet.tnear[l] = 0, packet.tfar[l] = INFINITY;
            cosine[l] = fminf(n[0] * d[0] + n[1] * d[1] + n[2] * d[2], 1);
            bool above = f[0] * d[0] + f[1] * d[1] + f[2] * d[2] > 0;
            if (k + l < r->n_ray && above && cosine[l] > 0) mask |= 1u << l;
        }
        uint32_t open = mask ? mask & ~prt_scene_occluded16(scene, &packet, mask) : 0;
        for (uint32_t l = 0; l < 16; l++) {
            if (!(open >> l & 1)) continue;
            double w = (double)cosine[l];
            if (fresnel) w *= (double)fresnel_table_eval(fresnel, cosine[l]);
            for (size_t c = 0; c < 3; c++) sum[c] += w * (double)r->rgb[(base + k + l) * 3 + c];
        }
    }
}

static int sample_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct polynomial *p = arg;
    struct bake *b = p->b;
    struct fresnel_table *fresnel = prt_bake_fresnel(&b->o.media);
    if (!fresnel) return PRT_NOMEM;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++) {
        uint32_t s = b->hierarchy->order[i];
        uint32_t medium = prt_media_index(&b->o.media, b->surface->object[s]);
        double sum[3];
        irradiance_at(p, prt_hash64(&s, sizeof s, 21) >> 8, b->surface->position[s],
                      b->surface->normal[s], b->surface->face_normal[s], &fresnel[medium], sum);
        double tint = b->surface->tint ? (double)b->surface->tint[s] : 1;
        for (int c = 0; c < 3; c++) p->irradiance[i][c] = (float)(sum[c] * tint);
    }
    prt_free(fresnel);
    return PRT_OK;
}

static int irradiance(struct polynomial *p)
{
    struct bake *b = p->b;
    uint32_t n = b->surface->n_sample;
    const struct hierarchy *h = b->hierarchy;
    p->irradiance = prt_alloc((size_t)n + h->n_node, sizeof *p->irradiance);
    if (!p->irradiance) return PRT_NOMEM;
    size_t bytes = ((size_t)n + h->n_node) * sizeof *p->irradiance;
    if (prt_checkpoint_read_array(b->checkpoint, p->irradiance, bytes)) return PRT_OK;
    int status = prt_parallel_for(b->ctx, "irradiance", n, 64, sample_range, p);
    for (uint32_t i = h->n_node; status == PRT_OK && i-- > 0;) { // children come after parents
        const struct node *node = &h->node[i];
        double sum[3] = {0, 0, 0};
        if (node->child[0])
            for (int k = 0; k < 2; k++)
                for (int c = 0; c < 3; c++)
                    sum[c] += (double)h->node[node->child[k]].area *
                              p->irradiance[n + node->child[k]][c];
        else
            for (uint32_t s = node->begin; s < node->begin + node->count; s++)
                for (int c = 0; c < 3; c++)
                    sum[c] += (double)b->surface->area[h->order[s]] * p->irradiance[s][c];
        for (int c = 0; c < 3; c++) p->irradiance[n + i][c] = (float)(sum[c] / node->area);
    }
    if (status == PRT_OK) prt_checkpoint_write_array(b->checkpoint, p->irradiance, bytes);
    return status;
}

static int multiple_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct polynomial *p = arg;
    struct bake *b = p->b;
    struct radial_set radial = prt_bases_radial_set(&p->bases);
    int status = PRT_OK;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        const struct prt_cluster *cluster = &p->tensor->cluster[c];
        if (!b->clusters->translucent[c]) continue;
        struct cut cut = {0};
        const struct cut_source from = prt_bake_cut_source(b);
        status = prt_cut_build(b->ctx, &from, (uint32_t)c, &radial, &cut);
        uint32_t n = cluster->n_vertex;
        float *sum = prt_calloc((size_t)radial.n * n * 3, sizeof *sum);
        if (!sum) status = PRT_NOMEM;
        for (uint32_t j = 0; status == PRT_OK && j < radial.n; j++) {
            const float *k = cut.k + (size_t)j * n * cut.n_column;
            float *to = sum + (size_t)j * n * 3;
            for (uint32_t i = 0; i < cut.n_column; i++) {
                const float *e = p->irradiance[cut.row[i]];
                for (uint32_t v = 0; v < n; v++)
                    for (int ch = 0; ch < 3; ch++)
                        to[(size_t)ch * n + v] += k[(size_t)i * n + v] * e[ch];
            }
        }
        if (!status) prt_radial_store(p->tensor, (uint32_t)c, sum);
        prt_free(sum);
        prt_cut_finish(&cut);
    }
    return status;
}

static int single_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct polynomial *p = arg;
    struct bake *b = p->b;
    const struct light_rays *r = p->rays;
    struct fresnel_table *fresnel = prt_bake_fresnel(&b->o.media);
    uint32_t F = b->o.n_phase * p->bases.extinction->n_function;
    prt_trace_thread_init();
    void *scratch = prt_alloc(prt_single_scratch_bytes(&b->single[0]), 1);
    float *out = prt_alloc((size_t)F * 3, sizeof *out);
    int status = scratch && out && fresnel ? PRT_OK : PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        const struct prt_cluster *cluster = &p->tensor->cluster[c];
        const uint32_t medium = prt_bake_medium(b, (uint32_t)c);
        const size_t n = cluster->n_vertex;
        if (!b->clusters->translucent[c]) continue;
        float *column = prt_alloc(n * F * 3 + 1, sizeof *column);
        if (!column) {
            status = PRT_NOMEM;
            break;
        }
        for (uint32_t i = 0; i < cluster->n_vertex; i++) {
            uint32_t v = b->clusters->order[cluster->vertex_begin + i];
            size_t base =
                (size_t)((prt_hash64(&v, sizeof v, 23) >> 8) % r->n_pattern) * r->n_ray;
            const struct light_directions light = {r->n_ray, r->x + base, r->y + base,
                                                   r->z + base, r->rgb + base * 3};
            b->rays_single[c] +=
                prt_single_light(&b->single[medium], &fresnel[medium], v, &light, out, scratch);
            for (uint32_t k = 0; k < 3 * F; k++) column[k * n + i] = out[k];
        }
        prt_radial_store(p->tensor, (uint32_t)c, column);
        prt_free(column);
    }
    prt_free(fresnel);
    prt_free(scratch);
    prt_free(out);
    return status;
}

// An empty RADIAL tensor over all clusters, in which opaque clusters have no columns. n_radial
// 0: a tensor of the opaque clusters alone, with one colour a vertex.
static int add_tensor(struct polynomial *p, enum prt_term term, uint32_t n_phase,
                      uint32_t n_radial)
{
    struct bake *b = p->b;
    struct prt_tensor *t = &b->out.tensor[b->out.n_tensor++];
    uint32_t nc = b->clusters->n_cluster, J = n_radial ? n_radial * n_phase : 1;
    struct prt_cluster *cluster = prt_calloc(nc, sizeof *cluster);
    uint32_t *order = prt_alloc(b->mesh->n_vertex, sizeof *order);
    uint64_t u = 0;
    memset(t, 0, sizeof *t);
    t->cluster = cluster, t->order = order;
    if (!cluster || !order) return PRT_NOMEM;
    for (uint32_t c = 0; c < nc; c++) {
        cluster[c] = b->clusters->cluster[c];
        cluster[c].rank = !b->clusters->translucent[c] == !n_radial ? J : 0;
        cluster[c].u_begin = u;
        u += (uint64_t)cluster[c].rank * 3 * ((cluster[c].n_vertex + 15) / 16 * 16);
    }
    memcpy(order, b->clusters->order, b->mesh->n_vertex * sizeof *order);
    t->u = prt_calloc(u + 32, 2);
    t->u_count = u;
    float *scale = prt_alloc((size_t)nc * J * 3, sizeof *scale);
    t->u_scale = scale;
    for (size_t k = 0; scale && k < (size_t)nc * J * 3; k++) scale[k] = 1;
    t->term = term;
    t->storage = PRT_STORAGE_RADIAL;
    t->coupling = PRT_COUPLE_FULL;
    t->n_vertex = b->mesh->n_vertex;
    t->n_cluster = nc;
    t->n_function = J;
    t->n_phase = t->n_radial = 1;
    p->tensor = t;
    return t->u && scale ? PRT_OK : PRT_NOMEM;
}

static int add_radial(struct polynomial *p, enum prt_term term, uint32_t n_phase,
                      const struct prt_radial *radial)
{
    int status = add_tensor(p, term, n_phase, radial->n_function);
    return status ? status : prt_bases_record(radial, n_phase, p->tensor);
}

// Opaque vertices: albedo/pi E, which does not depend on the material.
static int opaque_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    enum { PATTERNS_A_VERTEX = 4 };
    struct polynomial *p = arg;
    const struct prt_mesh *mesh = p->b->mesh;
    uint32_t *block = prt_mesh_vertex_blocks(mesh);
    if (!block) return PRT_NOMEM;
    prt_trace_thread_init();
    for (size_t c = begin; c < end; c++) {
        const struct prt_cluster *cluster = &p->tensor->cluster[c];
        const size_t n = cluster->n_vertex;
        if (!cluster->rank) continue;
        float *column = prt_alloc(3 * n + 1, sizeof *column);
        if (!column) {
            prt_free(block);
            return PRT_NOMEM;
        }
        for (uint32_t i = 0; i < n; i++) {
            uint32_t v = p->tensor->order[cluster->vertex_begin + i];
            const float *albedo = mesh->surface[mesh->block[block[v]].surface].base_color;
            size_t first = prt_hash64(&v, sizeof v, 23) >> 8;
            double all[3] = {0, 0, 0}, sum[3];
            for (size_t k = 0; k < PATTERNS_A_VERTEX; k++) {
                irradiance_at(p, first + k, mesh->position[v], mesh->normal[v], mesh->normal[v],
                              NULL, sum);
                for (int ch = 0; ch < 3; ch++) all[ch] += sum[ch] / PATTERNS_A_VERTEX;
            }
            for (size_t ch = 0; ch < 3; ch++)
                column[ch * n + i] = (float)(all[ch] * (double)albedo[ch] / M_PI);
        }
        prt_radial_store(p->tensor, (uint32_t)c, column);
        prt_free(column);
    }
    prt_free(block);
    return PRT_OK;
}

static int bake_clusters(struct polynomial *p, const char *stage, prt_loop_fn range, void *arg)
{
    const struct slot slot = {SLOT_RADIAL, 0, p->tensor};
    bool part;
    return prt_shard_for(p->b, stage, range, arg, &slot, &part);
}

// Multiple scattering and unscattered light by walks.
static int bake_walks(struct polynomial *p)
{
    struct polynomial_walks *w = &p->walks;
    float *value = p->irradiance ? p->irradiance[0] : NULL;
    *w = (struct polynomial_walks){.b = p->b, .bases = &p->bases, .lit = {3, value, value}};
    int status = prt_walk_pool_create(p->b, &p->bases, &w->pool);
    if (status) return status;
    status = add_tensor(p, PRT_TERM_MULTIPLE, 1, w->pool.n_function);
    w->tensor = p->tensor;
    if (!status) status = prt_walk_pool_record(&w->pool, p->tensor);
    if (!status)
        status = bake_clusters(p, "multiple scattering", prt_polynomial_walks_multiple, w);
    if (!status) status = add_radial(p, PRT_TERM_UNSCATTERED, 1, p->bases.extinction);
    w->tensor = p->tensor;
    if (!status)
        status = bake_clusters(p, "unscattered light", prt_polynomial_walks_unscattered, w);
    prt_walk_pool_finish(&w->pool);
    return status;
}

static int bake_multiple(struct polynomial *p)
{
    struct bake *b = p->b;
    bool opaque = false;
    for (uint32_t c = 0; c < b->clusters->n_cluster; c++)
        opaque |= !b->clusters->translucent[c];
    int status =
        b->walk ? bake_walks(p) : add_radial(p, PRT_TERM_MULTIPLE, 1, p->bases.reflectance);
    if (status == PRT_OK && !b->walk)
        status = bake_clusters(p, "multiple scattering", multiple_range, p);
    if (status || !opaque) return status;
    status = add_tensor(p, PRT_TERM_MULTIPLE, 1, 0);
    if (status == PRT_OK) status = bake_clusters(p, "opaque surfaces", opaque_range, p);
    return status;
}

static int bake_single(struct polynomial *p, const struct prt_cube *light)
{
    struct bake *b = p->b;
    int status = prt_light_rays_create(light, PATTERNS, SINGLE_RAYS, b->o.seed + 2, &p->rays);
    if (status) return status;
    status = prt_bake_plan_single(b, p->bases.integral, SINGLE_RAYS);
    if (status == PRT_OK)
        status = add_radial(p, PRT_TERM_SINGLE, b->o.n_phase, p->bases.extinction);
    if (status == PRT_OK) status = bake_clusters(p, "single scattering", single_range, p);
    prt_light_rays_destroy(p->rays);
    p->rays = NULL;
    return status;
}

int prt_bake_polynomial(struct bake *b)
{
    struct polynomial p = {.b = b};
    struct prt_cube light = {0};
    if (!b->surface)
        return prt_fail(b->ctx, PRT_ARG, "nothing is translucent: no material to edit");
    uint64_t started = prt_work_begin_all();
    int status = prt_env_to_cube(b->ctx, b->o.env, b->o.cube, b->o.rotate_deg, &light);
    if (status == PRT_OK) status = prt_bases_create(b, &p.bases);
    if (status == PRT_OK)
        status = prt_light_rays_create(&light, PATTERNS, SAMPLE_RAYS, b->o.seed + 1, &p.rays);
    if (status == PRT_OK && !prt_shard_assembling(b)) status = irradiance(&p);
    prt_work_end_all(&b->work, WORK_IRRADIANCE, started);
    started = prt_work_begin_all();
    if (status == PRT_OK) status = bake_multiple(&p);
    prt_work_end_all(&b->work, WORK_KERNEL, started);
    started = prt_work_begin_all();
    prt_light_rays_destroy(p.rays);
    p.rays = NULL;
    if (status == PRT_OK && !b->o.no_single) status = bake_single(&p, &light);
    if (!b->o.no_single) prt_work_end_all(&b->work, WORK_EXITS, started);
    prt_free(p.irradiance);
    prt_cube_finish(&light);
    prt_bases_finish(&p.bases);
    return status;
}
