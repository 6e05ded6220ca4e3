// SPDX-License-Identifier: MIT
// glTF meshes: primitives become blocks of triangles in world space.
#include "gltf_pose.h"

#include "draco.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct instance {
    double m[16]; // column-major, world from node
    size_t node, primitive;
    uint32_t object;
    bool opaque;
};

static bool finite3(const float *p, float bound)
{
    return fabsf(p[0]) <= bound && fabsf(p[1]) <= bound && fabsf(p[2]) <= bound;
}

// Positions and normals to world space; normals by the cofactor matrix, det M M^-T.
static int to_world(struct gltf *g, const double *m, uint32_t first, uint32_t n, double *det)
{
    double cof[9];
    for (int c = 0; c < 3; c++)
        for (int r = 0; r < 3; r++) {
            int r1 = (r + 1) % 3, r2 = (r + 2) % 3, c1 = (c + 1) % 3, c2 = (c + 2) % 3;
            cof[c * 3 + r] = m[c1 * 4 + r1] * m[c2 * 4 + r2] - m[c1 * 4 + r2] * m[c2 * 4 + r1];
        }
    *det = m[0] * cof[0] + m[1] * cof[1] + m[2] * cof[2];
    double sign = *det < 0 ? -1 : 1, size = 0;
    for (int i = 0; i < 9; i++) size = fmax(size, fabs(cof[i]));
    if (size > 0)
        for (int i = 0; i < 9; i++) cof[i] /= size;
    for (uint32_t v = first; v < first + n; v++) {
        float *p = g->d->position[v], *q = g->d->normal[v];
        double x[3], y[3];
        if (!finite3(p, 1e30f))
            return prt_gltf_bad(g, "mesh %zu: vertex %u of a primitive is not finite",
                                g->mesh_index, v - first);
        for (int r = 0; r < 3; r++) {
            x[r] = m[r] * p[0] + m[4 + r] * p[1] + m[8 + r] * p[2] + m[12 + r];
            y[r] = sign * (cof[r] * q[0] + cof[3 + r] * q[1] + cof[6 + r] * q[2]);
        }
        double length = sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2]);
        bool good = length > 1e-6 && length < 1e6;
        for (int r = 0; r < 3; r++) {
            p[r] = (float)x[r];
            q[r] = good ? (float)(y[r] / length) : 0;
        }
        if (!finite3(p, 1e15f))
            return prt_gltf_bad(g, "mesh %zu: vertex %u of a primitive is beyond 1e15",
                                g->mesh_index, v - first);
    }
    return PRT_OK;
}

static int read_attribute(struct gltf *g, int64_t accessor, unsigned n_component, uint64_t n,
                          float *out)
{
    struct gltf_accessor a;
    int status = prt_gltf_accessor(g, accessor, &a);
    if (status) return status;
    if (a.count != n)
        return prt_gltf_bad(g, "accessor %zu: has %llu elements for %llu vertices", a.index,
                            (unsigned long long)a.count, (unsigned long long)n);
    return prt_gltf_floats(g, &a, n_component, out);
}

// COLOR_0 of three or four components.
static int read_colors(struct gltf *g, int64_t accessor, uint64_t n, float (*out)[4])
{
    struct gltf_accessor a;
    int status = prt_gltf_accessor(g, accessor, &a);
    if (status) return status;
    if (a.n_component == 4) return read_attribute(g, accessor, 4, n, out[0]);
    float *rgb = malloc((size_t)n * 3 * sizeof *rgb);
    if (!rgb) return prt_gltf_no_memory(g);
    status = read_attribute(g, accessor, 3, n, rgb);
    for (uint64_t v = 0; !status && v < n; v++) memcpy(out[v], rgb + 3 * v, 3 * sizeof *rgb);
    free(rgb);
    return status;
}

static int read_texture_attributes(struct gltf *g, const struct prt_gltf_primitive *p,
                                   uint64_t n, uint32_t first)
{
    struct prt_draft *d = g->d;
    int status = PRT_OK;
    if (p->uv[0] >= 0) {
        status = read_attribute(g, p->uv[0], 2, n, d->uv[first]);
        d->has_uv = true;
    }
    for (uint32_t k = 1; !status && k < d->n_uv; k++)
        if (p->uv[k] >= 0) status = read_attribute(g, p->uv[k], 2, n, d->uv_more[k - 1][first]);
    if (!status && d->has_color && p->color >= 0)
        status = read_colors(g, p->color, n, d->color + first);
    return status;
}

static int read_vertices(struct gltf *g, const struct prt_gltf_primitive *p, uint32_t *first,
                         uint32_t *n)
{
    struct gltf_accessor a;
    int status;
    if ((status = prt_gltf_accessor(g, p->position, &a)) ||
        (status = prt_draft_vertices(g->d, a.count, first)))
        return status;
    *n = (uint32_t)a.count;
    status = prt_gltf_floats(g, &a, 3, g->d->position[*first]);
    if (!status && p->normal >= 0)
        status = read_attribute(g, p->normal, 3, a.count, g->d->normal[*first]);
    if (!status) status = read_texture_attributes(g, p, a.count, *first);
    for (uint32_t v = *first; !status && p->normal >= 0 && v < *first + *n; v++) {
        float *q = g->d->normal[v], s = q[0] * q[0] + q[1] * q[1] + q[2] * q[2];
        if (s > 1e-12f && s < 1e12f) continue;
        g->n_bad_normal++;
        q[0] = q[1] = q[2] = 0;
    }
    return status;
}

struct corners {
    const uint32_t *index; // NULL: 0, 1, 2, ...
    uint32_t n, first, n_vertex;
    bool flip;
};

static int add_triangle(struct gltf *g, const struct corners *c, uint32_t i, uint32_t j,
                        uint32_t k)
{
    uint32_t v[3] = {i, j, k};
    for (int e = 0; e < 3; e++) {
        if (c->index) v[e] = c->index[v[e]];
        if (v[e] >= c->n_vertex)
            return prt_gltf_bad(
                g, "mesh %zu: index %u is out of range: the primitive has %u vertices",
                g->mesh_index, v[e], c->n_vertex);
        v[e] += c->first;
    }
    return prt_draft_triangle(g->d, v[0], v[c->flip ? 2 : 1], v[c->flip ? 1 : 2]);
}

static int add_triangles(struct gltf *g, const struct corners *c, int mode)
{
    int status = PRT_OK;
    if (c->n < 3) {
        g->n_tail++;
        return PRT_OK;
    }
    if (mode == 4) {
        for (uint32_t i = 0; !status && i + 2 < c->n; i += 3)
            status = add_triangle(g, c, i, i + 1, i + 2);
        g->n_tail += c->n % 3 != 0;
    } else if (mode == 5) { // every other triangle of a strip winds backwards
        for (uint32_t i = 0; !status && i + 2 < c->n; i++)
            status = add_triangle(g, c, i, i + 1 + (i & 1), i + 2 - (i & 1));
    } else {
        for (uint32_t i = 1; !status && i + 1 < c->n; i++)
            status = add_triangle(g, c, i, i + 1, 0);
    }
    return status;
}

static int read_indices(struct gltf *g, int64_t index, struct corners *c)
{
    struct gltf_accessor a;
    c->n = c->n_vertex;
    if (index < 0) return PRT_OK;
    int status = prt_gltf_accessor(g, index, &a);
    if (status) return status;
    uint32_t *to = malloc(a.count * sizeof *to);
    if (!to) return prt_gltf_no_memory(g);
    c->index = to;
    c->n = (uint32_t)a.count;
    return prt_gltf_indices(g, &a, to);
}

void prt_gltf_drop_draco(struct gltf *g, size_t view)
{
    struct gltf_mesh_data *data = g->draco[view];
    if (!data) return;
    struct prt_draco m = {.position = data->position,
                          .normal = data->normal,
                          .color = data->color,
                          .triangle = data->triangle};
    memcpy(m.uv, data->uv, sizeof m.uv);
    prt_draco_free(&m);
    g->draco[view] = NULL;
}

static int decode_draco(struct gltf *g, const struct prt_gltf_primitive *p,
                        const struct gltf_mesh_data **out)
{
    const int64_t view = p->draco_view;
    int status;
    if (view < 0 || (uint64_t)view >= g->file.n_view || p->draco_id[0] < 0)
        return prt_gltf_bad(g, "mesh %zu: damaged Draco primitive", g->mesh_index);
    // Primitives may take other attributes of one view.
    if (g->draco[view] && memcmp(g->draco[view]->id, p->draco_id, sizeof p->draco_id))
        prt_gltf_drop_draco(g, (size_t)view);
    if (!g->draco[view]) { // instances share the decoded mesh
        struct gltf_bytes bytes;
        struct prt_draco mesh;
        const char *why = NULL;
        if ((status = prt_gltf_view(g, (size_t)view, &bytes))) return status;
        struct gltf_mesh_data *data = prt_gltf_own(g, sizeof *data);
        if (!data) return prt_gltf_no_memory(g);
        if (prt_draco_decode(bytes.at, bytes.n, p->draco_id, g->d->max_vertices,
                             g->d->max_triangles, &mesh, &why)) {
            prt_draco_free(&mesh);
            return prt_gltf_bad(g, "bufferView %lld: %s", (long long)view, why);
        }
        *data = (struct gltf_mesh_data){.n_vertex = mesh.n_vertex,
                                        .n_triangle = mesh.n_triangle,
                                        .position = mesh.position,
                                        .normal = mesh.normal,
                                        .color = mesh.color,
                                        .triangle = mesh.triangle};
        memcpy(data->id, p->draco_id, sizeof data->id);
        memcpy(data->uv, mesh.uv, sizeof data->uv);
        g->draco[view] = data;
    }
    *out = g->draco[view];
    return PRT_OK;
}

static int read_draco(struct gltf *g, const struct prt_gltf_primitive *p, struct corners *c)
{
    const struct gltf_mesh_data *m = NULL;
    int status = decode_draco(g, p, &m);
    if (!status) status = prt_draft_vertices(g->d, m->n_vertex, &c->first);
    if (status) return status;
    c->n_vertex = m->n_vertex;
    c->n = m->n_triangle * 3;
    memcpy(g->d->position[c->first], m->position, (size_t)m->n_vertex * 12);
    if (m->normal) memcpy(g->d->normal[c->first], m->normal, (size_t)m->n_vertex * 12);
    if (m->uv[0]) memcpy(g->d->uv[c->first], m->uv[0], (size_t)m->n_vertex * 8);
    g->d->has_uv |= m->uv[0] != NULL;
    for (uint32_t k = 1; k < g->d->n_uv; k++)
        if (m->uv[k]) memcpy(g->d->uv_more[k - 1][c->first], m->uv[k], (size_t)m->n_vertex * 8);
    if (g->d->has_color && m->color)
        memcpy(g->d->color[c->first], m->color, (size_t)m->n_vertex * 16);
    uint32_t *index = malloc((size_t)c->n * sizeof *index);
    if (!index) return prt_gltf_no_memory(g);
    memcpy(index, m->triangle, (size_t)c->n * sizeof *index);
    c->index = index;
    return PRT_OK;
}

static bool uv_finite(struct gltf *g, uint32_t first, uint32_t n)
{
    for (uint32_t k = 0; k < g->d->n_uv; k++) {
        float(*uv)[2] = k ? g->d->uv_more[k - 1] : g->d->uv;
        for (uint32_t v = first; v < first + n; v++)
            if (!(fabsf(uv[v][0]) < 1e30f && fabsf(uv[v][1]) < 1e30f)) return false;
    }
    return true;
}

// Colours to [0,1]; NaN becomes 1.
static void clamp_colors(struct gltf *g, uint32_t first, uint32_t n)
{
    for (uint32_t v = first; g->d->has_color && v < first + n; v++)
        for (int c = 0; c < 4; c++) {
            float x = g->d->color[v][c];
            g->d->color[v][c] = x >= 0 ? x <= 1 ? x : 1 : x < 0 ? 0 : 1;
        }
}

// Vertices in the world: by the node's transform, or by their skin.
static int place(struct gltf *g, const struct instance *at, const struct corners *c,
                 double *det)
{
    static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    bool skinned = false;
    double own = 1;
    int status = g->pose ? prt_gltf_deform(g, at->node, at->primitive, c->first, c->n_vertex,
                                           &skinned, &own)
                         : PRT_OK;
    if (!status) status = to_world(g, skinned ? identity : at->m, c->first, c->n_vertex, det);
    if (skinned) *det = own;
    return status;
}

// Notes the surfaces of the last block, in all variants, as those of vertex colours.
static void note_colored(struct gltf *g)
{
    const struct prt_draft *d = g->d;
    const size_t width = d->n_variant + 1ull;
    g->colored[d->block[d->n_block - 1].surface] = 1;
    for (size_t i = 0; d->n_variant && i < width; i++)
        g->colored[d->variant_surface[width * (d->n_block - 1) + i]] = 1;
}

static int finish_primitive(struct gltf *g, int64_t given, const struct instance *at,
                            struct corners *c, int mode)
{
    uint64_t material = given < 0 ? g->file.n_material : (uint64_t)given;
    uint32_t surface = 0, before = g->d->n_triangle;
    double det;
    int status = PRT_OK;
    if (given >= 0 && material >= g->file.n_material)
        status = prt_gltf_bad(g, "material %lld does not exist", (long long)given);
    if (!status && !uv_finite(g, c->first, c->n_vertex))
        status = prt_gltf_bad(g, "a texture coordinate is not finite");
    clamp_colors(g, c->first, c->n_vertex);
    if (!status) status = place(g, at, c, &det);
    if (!status) {
        c->flip = det < 0;
        g->n_flat += det == 0;
        status = add_triangles(g, c, mode);
    }
    if (!status) status = prt_gltf_surface(g, (size_t)material, at->opaque, &surface);
    if (!status)
        status =
            prt_draft_block(g->d, (struct prt_block){at->object, surface, c->first, c->n_vertex,
                                                     before, g->d->n_triangle - before});
    return status ? status
                  : prt_gltf_variant_surfaces(g, at->primitive, (size_t)material, at->opaque);
}

static int read_primitive(struct gltf *g, const struct prt_gltf_primitive *p,
                          const struct instance *at)
{
    struct corners c = {0};
    int status, mode = p->draco ? 4 : p->mode;
    if (p->mode > 6)
        return prt_gltf_bad(g, "a primitive of mesh %zu: mode is %d, allowed range 0 to 6",
                            g->mesh_index, p->mode);
    if (p->mode < 4 || p->position < 0) {
        g->n_skipped++;
        return PRT_OK;
    }
    g->n_deformed += p->targets && !g->pose;
    if (p->draco) {
        status = read_draco(g, p, &c);
    } else {
        status = read_vertices(g, p, &c.first, &c.n_vertex);
        if (!status) status = read_indices(g, p->indices, &c);
    }
    if (!status) status = finish_primitive(g, p->material, at, &c, mode);
    if (!status && p->color >= 0) note_colored(g);
    free((void *)c.index);
    return status;
}

int prt_gltf_instance(struct gltf *g, size_t node_index, const double *world)
{
    struct instance instance = {.object = g->d->n_object}, *at = &instance;
    const struct prt_gltf_node *node = &g->file.node[node_index];
    int status;
    memcpy(at->m, world, sizeof at->m);
    if (node->mesh < 0) return PRT_OK;
    if ((uint64_t)node->mesh >= g->file.n_mesh)
        return prt_gltf_bad(g, "node %zu: mesh %lld does not exist", node_index,
                            (long long)node->mesh);
    const struct prt_gltf_mesh *mesh = &g->file.mesh[node->mesh];
    g->n_deformed += node->skin >= 0 && !g->pose;
    g->mesh_index = (size_t)node->mesh;
    at->node = node_index;
    at->opaque = prt_draft_opaque(g->d, node->name);
    uint32_t before = g->d->n_block;
    if (!mesh->n) return prt_gltf_bad(g, "mesh %lld has no primitives", (long long)node->mesh);
    for (at->primitive = 0; at->primitive < mesh->n; at->primitive++)
        if ((status = read_primitive(g, &mesh->primitive[at->primitive], at))) return status;
    return g->d->n_block > before ? prt_draft_object(g->d, node->name) : PRT_OK;
}
