// SPDX-License-Identifier: MIT
// glTF meshes: primitives become blocks of triangles in the world.
#include "gltf.h"

#include "draco.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct instance {
    double m[16]; // column-major, world from node
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
            return gltf_bad(g, "mesh %zu: vertex %u of a primitive is not finite",
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
            return gltf_bad(g, "mesh %zu: vertex %u of a primitive lies beyond 1e15",
                            g->mesh_index, v - first);
    }
    return PRT_OK;
}

// The index of an attribute's accessor; UINT64_MAX when the primitive has none.
static int attribute(struct gltf *g, const cJSON *primitive, const char *name, uint64_t *out)
{
    return gltf_number(g, "a primitive of mesh", g->mesh_index,
                       gltf_member(primitive, "attributes"), name, 1ull << 53, UINT64_MAX, out);
}

static int read_attribute(struct gltf *g, uint64_t accessor, unsigned n_component, uint64_t n,
                          float *out)
{
    struct gltf_accessor a;
    int status = gltf_accessor(g, accessor, &a);
    if (status) return status;
    if (a.count != n)
        return gltf_bad(g, "accessor %zu: has %llu elements for %llu vertices", a.index,
                        (unsigned long long)a.count, (unsigned long long)n);
    return gltf_floats(g, &a, n_component, out);
}

static int read_vertices(struct gltf *g, const cJSON *primitive, uint64_t position,
                         uint32_t *first, uint32_t *n)
{
    struct gltf_accessor a;
    uint64_t normal, uv;
    int status;
    if ((status = gltf_accessor(g, position, &a)) ||
        (status = attribute(g, primitive, "NORMAL", &normal)) ||
        (status = attribute(g, primitive, "TEXCOORD_0", &uv)) ||
        (status = prt_draft_vertices(g->d, a.count, first)))
        return status;
    *n = (uint32_t)a.count;
    status = gltf_floats(g, &a, 3, g->d->position[*first]);
    if (!status && normal != UINT64_MAX)
        status = read_attribute(g, normal, 3, a.count, g->d->normal[*first]);
    if (!status && uv != UINT64_MAX) {
        status = read_attribute(g, uv, 2, a.count, g->d->uv[*first]);
        g->d->has_uv = true;
    }
    for (uint32_t v = *first; !status && normal != UINT64_MAX && v < *first + *n; v++) {
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
            return gltf_bad(g,
                            "mesh %zu: index %u is out of range: the primitive has %u vertices",
                            g->mesh_index, v[e], c->n_vertex);
        v[e] += c->first;
    }
    return prt_draft_triangle(g->d, v[0], v[c->flip ? 2 : 1], v[c->flip ? 1 : 2]);
}

static int add_triangles(struct gltf *g, const struct corners *c, uint64_t mode)
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

static int read_indices(struct gltf *g, const cJSON *primitive, struct corners *c)
{
    struct gltf_accessor a;
    uint64_t index;
    int status = gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "indices",
                             1ull << 53, UINT64_MAX, &index);
    c->n = c->n_vertex;
    if (status || index == UINT64_MAX) return status;
    if ((status = gltf_accessor(g, index, &a))) return status;
    uint32_t *to = malloc(a.count * sizeof *to);
    if (!to) return gltf_no_memory(g);
    c->index = to;
    c->n = (uint32_t)a.count;
    return gltf_indices(g, &a, to);
}

static int decode_draco(struct gltf *g, const cJSON *ext, const struct gltf_mesh_data **out)
{
    static const char *const name[3] = {"POSITION", "NORMAL", "TEXCOORD_0"};
    const cJSON *attributes = gltf_member(ext, "attributes");
    uint64_t view, id[3];
    int64_t want[3];
    int status = gltf_number(g, "a Draco primitive of mesh", g->mesh_index, ext, "bufferView",
                             1ull << 53, UINT64_MAX, &view);
    for (int i = 0; !status && i < 3; i++) {
        status = gltf_number(g, "a Draco primitive of mesh", g->mesh_index, attributes, name[i],
                             UINT32_MAX, UINT64_MAX, &id[i]);
        want[i] = id[i] == UINT64_MAX ? -1 : (int64_t)id[i];
    }
    if (status) return status;
    if (view >= g->view.n || want[0] < 0) return gltf_bad(g, "damaged Draco primitive");
    if (!g->draco[view]) { // instances share what was decoded once
        struct gltf_bytes bytes;
        struct prt_draco mesh;
        const char *why = NULL;
        if ((status = gltf_view(g, (size_t)view, &bytes))) return status;
        struct gltf_mesh_data *data = gltf_own(g, sizeof *data);
        if (!data) return gltf_no_memory(g);
        if (prt_draco_decode(bytes.at, bytes.n, want, g->d->max_vertices, g->d->max_triangles,
                             &mesh, &why)) {
            prt_draco_free(&mesh);
            return gltf_bad(g, "bufferView %llu: %s", (unsigned long long)view, why);
        }
        *data = (struct gltf_mesh_data){mesh.n_vertex, mesh.n_triangle, mesh.position,
                                        mesh.normal,   mesh.uv,         mesh.triangle};
        g->draco[view] = data;
    }
    *out = g->draco[view];
    return PRT_OK;
}

static int read_draco(struct gltf *g, const cJSON *ext, struct corners *c)
{
    const struct gltf_mesh_data *m = NULL;
    int status = decode_draco(g, ext, &m);
    if (!status) status = prt_draft_vertices(g->d, m->n_vertex, &c->first);
    if (status) return status;
    c->n_vertex = m->n_vertex;
    c->n = m->n_triangle * 3;
    memcpy(g->d->position[c->first], m->position, (size_t)m->n_vertex * 12);
    if (m->normal) memcpy(g->d->normal[c->first], m->normal, (size_t)m->n_vertex * 12);
    if (m->uv) memcpy(g->d->uv[c->first], m->uv, (size_t)m->n_vertex * 8);
    g->d->has_uv |= m->uv != NULL;
    uint32_t *index = malloc((size_t)c->n * sizeof *index);
    if (!index) return gltf_no_memory(g);
    memcpy(index, m->triangle, (size_t)c->n * sizeof *index);
    c->index = index;
    return PRT_OK;
}

static bool uv_finite(struct gltf *g, uint32_t first, uint32_t n)
{
    for (uint32_t v = first; v < first + n; v++)
        if (!(fabsf(g->d->uv[v][0]) < 1e30f && fabsf(g->d->uv[v][1]) < 1e30f)) return false;
    return true;
}

static int finish_primitive(struct gltf *g, const cJSON *primitive, const struct instance *at,
                            struct corners *c, uint64_t mode)
{
    uint64_t material;
    uint32_t surface = 0, before = g->d->n_triangle;
    double det;
    int status = gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "material",
                             1ull << 53, g->material.n, &material);
    if (!status && material > g->material.n)
        status = gltf_bad(g, "material %llu does not exist", (unsigned long long)material);
    if (!status && !uv_finite(g, c->first, c->n_vertex))
        status = gltf_bad(g, "a TEXCOORD_0 is not finite");
    if (!status) status = to_world(g, at->m, c->first, c->n_vertex, &det);
    if (!status) {
        c->flip = det < 0;
        g->n_flat += det == 0;
        status = add_triangles(g, c, mode);
    }
    if (!status) status = gltf_surface(g, (size_t)material, at->opaque, &surface);
    return status ? status
                  : prt_draft_block(g->d, (struct prt_block){at->object, surface, c->first,
                                                             c->n_vertex, before,
                                                             g->d->n_triangle - before});
}

static int read_primitive(struct gltf *g, const cJSON *primitive, const struct instance *at)
{
    struct corners c = {0};
    uint64_t mode, position;
    int status =
        gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "mode", 6, 4, &mode);
    if (!status) status = attribute(g, primitive, "POSITION", &position);
    if (status) return status;
    if (mode < 4 || position == UINT64_MAX) {
        g->n_skipped++;
        return PRT_OK;
    }
    const cJSON *draco =
        gltf_member(gltf_member(primitive, "extensions"), "KHR_draco_mesh_compression");
    g->n_deformed += gltf_member(primitive, "targets") != NULL;
    if (draco) {
        mode = 4;
        status = read_draco(g, draco, &c);
    } else {
        status = read_vertices(g, primitive, position, &c.first, &c.n_vertex);
        if (!status) status = read_indices(g, primitive, &c);
    }
    if (!status) status = finish_primitive(g, primitive, at, &c, mode);
    free((void *)c.index);
    return status;
}

int gltf_instance(struct gltf *g, const cJSON *node, size_t node_index, const double *world)
{
    struct instance instance = {.object = g->d->n_object}, *at = &instance;
    memcpy(at->m, world, sizeof at->m);
    uint64_t mesh;
    int status =
        gltf_number(g, "node", node_index, node, "mesh", 1ull << 53, UINT64_MAX, &mesh);
    if (status || mesh == UINT64_MAX) return status;
    if (mesh >= g->mesh.n)
        return gltf_bad(g, "node %zu: mesh %llu does not exist", node_index,
                        (unsigned long long)mesh);
    const cJSON *list = gltf_member(g->mesh.item[mesh], "primitives"), *primitive;
    g->n_deformed += gltf_member(node, "skin") != NULL;
    g->mesh_index = (size_t)mesh;
    at->opaque = prt_draft_opaque(g->d, gltf_text(node, "name"));
    uint32_t before = g->d->n_block;
    if (!cJSON_IsArray(list))
        return gltf_bad(g, "mesh %llu has no primitives", (unsigned long long)mesh);
    cJSON_ArrayForEach(primitive,
                       list) if ((status = read_primitive(g, primitive, at))) return status;
    g->d->n_object += g->d->n_block > before;
    return PRT_OK;
}
