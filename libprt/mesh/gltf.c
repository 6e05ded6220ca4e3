// SPDX-License-Identifier: MIT
// glTF 2.0: containers, materials, the node tree and its primitives, read with cJSON.
#include "gltf.h"

#include "draco.h"

#include <ctype.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_DEPTH = 200, SPARE_VISITS = 1000 };

// Extensions that may be required: those we read, and those that change nothing in geometry.
static const char *const supported[] = {
    "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_mesh_quantization",
    "KHR_texture_transform", "KHR_texture_basisu", "EXT_texture_webp", "EXT_texture_avif",
    "MSFT_texture_dds", "KHR_lights_punctual", "KHR_animation_pointer",
    "KHR_materials_", // all of them: a prefix
};

static const char *const scattering[] = {
    "KHR_materials_transmission", "KHR_materials_diffuse_transmission", "KHR_materials_volume",
    "KHR_materials_volume_scatter", "KHR_materials_scatter", "KHR_materials_subsurface",
    "KHR_materials_sss",
};

static int no_memory(const struct gltf *g)
{
    return prt_fail(g->d->ctx, PRT_NOMEM, "%s: no memory", g->d->name);
}

static const char *text_of(const cJSON *o, const char *key)
{
    const cJSON *item = gltf_member(o, key);
    return cJSON_IsString(item) ? item->valuestring : NULL;
}

// ---- materials

static double clamped(const struct gltf *g, const cJSON *o, const char *key, double missing,
                      double low, double high)
{
    const cJSON *item = gltf_member(o, key);
    if (!cJSON_IsNumber(item) || !(fabs(item->valuedouble) < 1e30)) return missing;
    double x = item->valuedouble;
    return x < low ? low : x > high ? high : x;
}

static int read_surface(struct gltf *g, size_t index, struct prt_surface *s, bool *extended)
{
    const cJSON *o = g->material.item[index], *ext = gltf_member(o, "extensions");
    const cJSON *pbr = gltf_member(o, "pbrMetallicRoughness");
    const cJSON *old = gltf_member(ext, "KHR_materials_pbrSpecularGlossiness");
    double color[4] = {1, 1, 1, 1};
    bool have = false;
    prt_surface_default(s, text_of(o, "name") ? text_of(o, "name") : "");
    int status = gltf_numbers(g, "material", index, pbr, "baseColorFactor", 4, color, &have);
    if (!status && !have)
        status = gltf_numbers(g, "material", index, old, "diffuseFactor", 4, color, &have);
    if (status) return status;
    for (int c = 0; c < 4; c++)
        s->base_color[c] = color[c] < 0 ? 0 : color[c] > 1 ? 1 : (float)color[c];
    s->roughness = (float)clamped(g, pbr, "roughnessFactor", 1, 1e-3, 1);
    s->double_sided = cJSON_IsTrue(gltf_member(o, "doubleSided"));
    double ior = clamped(g, gltf_member(ext, "KHR_materials_ior"), "ior", 1.5, 0, 5);
    s->ior = ior < 1 ? 1.5f : (float)ior; // 0 means "no Fresnel", which we do not know
    *extended = false;
    for (size_t i = 0; i < sizeof scattering / sizeof *scattering; i++)
        *extended |= gltf_member(ext, scattering[i]) != NULL;
    if (gltf_member(pbr, "baseColorTexture") || gltf_member(old, "diffuseTexture"))
        s->reserved[0] = 1; // for the note about textures; cleared before packing
    return PRT_OK;
}

// The surface of material `index` (material.n: none given), made on first use.
static int surface_of(struct gltf *g, size_t index, bool opaque, uint32_t *out)
{
    uint32_t *known = opaque ? g->opaque_of : g->surface_of;
    if (known[index] == UINT32_MAX) {
        struct prt_surface s;
        bool extended = false;
        prt_surface_default(&s, NULL);
        int status = index < g->material.n ? read_surface(g, index, &s, &extended) : PRT_OK;
        if (status) return status;
        opaque |= prt_draft_opaque(g->d, s.name);
        // 2: translucent unless another material is so by its extensions; see settle_surfaces
        s.translucent = opaque ? 0 : extended ? 1 : 2;
        status = prt_draft_surface(g->d, &s, &known[index]);
        if (status) return status;
    }
    *out = known[index];
    return PRT_OK;
}

static void settle_surfaces(struct gltf *g)
{
    bool any = false;
    uint32_t textured = 0;
    for (uint32_t i = 0; i < g->d->n_surface; i++) any |= g->d->surface[i].translucent == 1;
    for (size_t i = 0; i < g->material.n; i++) { // also those no primitive uses
        const cJSON *ext = gltf_member(g->material.item[i], "extensions");
        for (size_t k = 0; k < sizeof scattering / sizeof *scattering; k++)
            any |= gltf_member(ext, scattering[k]) != NULL &&
                   !prt_draft_opaque(g->d, text_of(g->material.item[i], "name"));
    }
    for (uint32_t i = 0; i < g->d->n_surface; i++) {
        struct prt_surface *s = &g->d->surface[i];
        if (s->translucent == 2) s->translucent = !any;
        textured += s->reserved[0] && !s->translucent;
        s->reserved[0] = 0;
    }
    if (textured)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: textures are not read; %u opaque materials keep their base colour factor",
                g->d->name, textured);
}

// ---- primitives

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
    return gltf_number(g, "a primitive of mesh", g->mesh_index, gltf_member(primitive, "attributes"), name,
                       1ull << 53, UINT64_MAX, out);
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
            return gltf_bad(g, "mesh %zu: index %u is out of range: the primitive has %u vertices",
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
    int status = gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "indices", 1ull << 53,
                             UINT64_MAX, &index);
    c->n = c->n_vertex;
    if (status || index == UINT64_MAX) return status;
    if ((status = gltf_accessor(g, index, &a))) return status;
    uint32_t *to = malloc(a.count * sizeof *to);
    if (!to) return no_memory(g);
    c->index = to;
    c->n = (uint32_t)a.count;
    return gltf_indices(g, &a, to);
}

int gltf_draco(struct gltf *g, const cJSON *ext, const struct gltf_mesh_data **out)
{
    static const char *const name[3] = {"POSITION", "NORMAL", "TEXCOORD_0"};
    const cJSON *attributes = gltf_member(ext, "attributes");
    uint64_t view, id[3];
    int64_t want[3];
    int status = gltf_number(g, "a Draco primitive of mesh", g->mesh_index, ext, "bufferView", 1ull << 53,
                             UINT64_MAX, &view);
    for (int i = 0; !status && i < 3; i++) {
        status = gltf_number(g, "a Draco primitive of mesh", g->mesh_index, attributes, name[i], UINT32_MAX,
                             UINT64_MAX, &id[i]);
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
        if (!data) return no_memory(g);
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
    int status = gltf_draco(g, ext, &m);
    if (!status) status = prt_draft_vertices(g->d, m->n_vertex, &c->first);
    if (status) return status;
    c->n_vertex = m->n_vertex;
    c->n = m->n_triangle * 3;
    memcpy(g->d->position[c->first], m->position, (size_t)m->n_vertex * 12);
    if (m->normal) memcpy(g->d->normal[c->first], m->normal, (size_t)m->n_vertex * 12);
    if (m->uv) memcpy(g->d->uv[c->first], m->uv, (size_t)m->n_vertex * 8);
    g->d->has_uv |= m->uv != NULL;
    uint32_t *index = malloc((size_t)c->n * sizeof *index);
    if (!index) return no_memory(g);
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
    int status = gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "material", 1ull << 53,
                             g->material.n, &material);
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
    if (!status) status = surface_of(g, (size_t)material, at->opaque, &surface);
    return status ? status
                  : prt_draft_block(g->d, (struct prt_block){
                                              at->object, surface, c->first, c->n_vertex, before,
                                              g->d->n_triangle - before});
}

static int read_primitive(struct gltf *g, const cJSON *primitive, const struct instance *at)
{
    struct corners c = {0};
    uint64_t mode, position;
    int status = gltf_number(g, "a primitive of mesh", g->mesh_index, primitive, "mode", 6, 4, &mode);
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

static int read_mesh(struct gltf *g, const cJSON *node, size_t node_index, struct instance *at)
{
    uint64_t mesh;
    int status = gltf_number(g, "node", node_index, node, "mesh", 1ull << 53, UINT64_MAX, &mesh);
    if (status || mesh == UINT64_MAX) return status;
    if (mesh >= g->mesh.n)
        return gltf_bad(g, "node %zu: mesh %llu does not exist", node_index,
                        (unsigned long long)mesh);
    const cJSON *list = gltf_member(g->mesh.item[mesh], "primitives"), *primitive;
    g->n_deformed += gltf_member(node, "skin") != NULL;
    g->mesh_index = (size_t)mesh;
    at->opaque = prt_draft_opaque(g->d, text_of(node, "name"));
    at->object = g->d->n_object;
    uint32_t before = g->d->n_block;
    if (!cJSON_IsArray(list)) return gltf_bad(g, "mesh %llu has no primitives",
                                              (unsigned long long)mesh);
    cJSON_ArrayForEach(primitive, list)
        if ((status = read_primitive(g, primitive, at))) return status;
    g->d->n_object += g->d->n_block > before;
    return PRT_OK;
}

// ---- the node tree

static void multiply(const double *a, const double *b, double *out)
{
    for (int c = 0; c < 4; c++)
        for (int r = 0; r < 4; r++)
            out[c * 4 + r] = a[r] * b[c * 4] + a[4 + r] * b[c * 4 + 1] +
                             a[8 + r] * b[c * 4 + 2] + a[12 + r] * b[c * 4 + 3];
}

static int local_matrix(struct gltf *g, size_t index, const cJSON *node, double m[16])
{
    double t[3] = {0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    bool have, rotated;
    int status = gltf_numbers(g, "node", index, node, "matrix", 16, m, &have);
    if (status || have) return status;
    if ((status = gltf_numbers(g, "node", index, node, "translation", 3, t, &have)) ||
        (status = gltf_numbers(g, "node", index, node, "rotation", 4, q, &rotated)) ||
        (status = gltf_numbers(g, "node", index, node, "scale", 3, s, &have)))
        return status;
    double l = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(l > 1e-9 && l < 1e9)) return gltf_bad(g, "node %zu: its rotation has no length", index);
    double x = q[0] / l, y = q[1] / l, z = q[2] / l, w = q[3] / l;
    const double r[9] = {1 - 2 * (y * y + z * z), 2 * (x * y + z * w),     2 * (x * z - y * w),
                         2 * (x * y - z * w),     1 - 2 * (x * x + z * z), 2 * (y * z + x * w),
                         2 * (x * z + y * w),     2 * (y * z - x * w),     1 - 2 * (x * x + y * y)};
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < 3; k++) m[c * 4 + k] = r[c * 3 + k] * s[c];
        m[c * 4 + 3] = 0;
        m[12 + c] = t[c];
    }
    m[15] = 1;
    return PRT_OK;
}

struct visit {
    size_t node;
    const cJSON *child; // the next one to enter
    double m[16];
};

struct walk {
    struct visit *stack; // [node.n + 1]: a path visits no node twice
    uint8_t *on_path;    // [node.n]
    size_t depth, visits;
};

static int enter(struct gltf *g, struct walk *w, const cJSON *index_item, const double *parent)
{
    double x = cJSON_IsNumber(index_item) ? index_item->valuedouble : -1, local[16];
    if (!(x >= 0 && x < (double)g->node.n) || x != floor(x))
        return gltf_bad(g, "node %.0f does not exist", x);
    size_t index = (size_t)x;
    if (w->on_path[index]) return gltf_bad(g, "node %zu is its own descendant", index);
    // more visits than nodes: some have several parents, which can multiply without end
    if (++w->visits > 4 * g->node.n + SPARE_VISITS)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: its %zu nodes make more than %zu instances",
                        g->d->name, g->node.n, w->visits - 1);
    const cJSON *node = g->node.item[index], *children = gltf_member(node, "children");
    struct visit *v = &w->stack[w->depth];
    int status = local_matrix(g, index, node, local);
    if (status) return status;
    v->node = index;
    v->child = cJSON_IsArray(children) ? children->child : NULL;
    multiply(parent, local, v->m);
    for (int i = 0; i < 16; i++)
        if (!(fabs(v->m[i]) < 1e30))
            return gltf_bad(g, "node %zu: its transform is too large", index);
    w->on_path[index] = 1;
    w->depth++;
    struct instance at = {.object = 0};
    memcpy(at.m, v->m, sizeof at.m);
    return read_mesh(g, node, index, &at);
}

static int walk_from(struct gltf *g, struct walk *w, const cJSON *root)
{
    static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    int status = enter(g, w, root, identity);
    while (!status && w->depth) {
        struct visit *v = &w->stack[w->depth - 1];
        if (v->child) {
            const cJSON *child = v->child;
            v->child = child->next;
            status = enter(g, w, child, v->m);
        } else {
            w->on_path[v->node] = 0;
            w->depth--;
        }
    }
    return status;
}

// Without a usable scene: every node that is nobody's child.
static int walk_roots(struct gltf *g, struct walk *w)
{
    uint8_t *is_child = gltf_own(g, g->node.n);
    int status = PRT_OK;
    if (!is_child) return no_memory(g);
    for (size_t i = 0; i < g->node.n; i++) {
        const cJSON *list = gltf_member(g->node.item[i], "children"), *c;
        for (c = cJSON_IsArray(list) ? list->child : NULL; c; c = c->next)
            if (cJSON_IsNumber(c) && c->valuedouble >= 0 && c->valuedouble < (double)g->node.n)
                is_child[(size_t)c->valuedouble] = 1;
    }
    for (size_t i = 0; !status && i < g->node.n; i++) {
        cJSON number = {.type = cJSON_Number, .valuedouble = (double)i};
        if (!is_child[i]) status = walk_from(g, w, &number);
    }
    return status;
}

static int walk_scene(struct gltf *g)
{
    struct walk w = {gltf_own(g, (g->node.n + 1) * sizeof *w.stack), gltf_own(g, g->node.n + 1),
                     0, 0};
    uint64_t index;
    int status = gltf_number(g, "JSON object", 0, g->json, "scene", 1ull << 53, 0, &index);
    if (!status && (!w.stack || !w.on_path)) status = no_memory(g);
    if (status) return status;
    if (g->scene.n && index >= g->scene.n)
        return gltf_bad(g, "scene %llu does not exist", (unsigned long long)index);
    const cJSON *roots = g->scene.n ? gltf_member(g->scene.item[index], "nodes") : NULL;
    const cJSON *root;
    if (!cJSON_IsArray(roots) || !roots->child) {
        if (g->scene.n)
            prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: scene %llu is empty: all nodes are loaded",
                    g->d->name, (unsigned long long)index);
        return walk_roots(g, &w);
    }
    cJSON_ArrayForEach(root, roots)
        if ((status = walk_from(g, &w, root))) return status;
    return PRT_OK;
}

// ---- containers

static uint32_t u32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static int open_glb(struct gltf *g, const uint8_t *bytes, size_t n, const char **json,
                    size_t *json_n)
{
    if (n < 20) return gltf_bad(g, "the GLB header is cut off");
    uint32_t version = u32(bytes + 4), length = u32(bytes + 8);
    if (version != 2)
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: GLB version %u, only 2 is known",
                        g->d->name, version);
    if (length > n || length < 20)
        return gltf_bad(g, "the GLB header says %u bytes, the file has %zu", length, n);
    if (length < n)
        prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: %zu bytes after its end are ignored",
                g->d->name, n - length);
    for (size_t at = 12, chunk = 0; at < length; chunk++) {
        if (length - at < 8) return gltf_bad(g, "GLB chunk %zu is cut off", chunk);
        size_t size = u32(bytes + at), type = u32(bytes + at + 4);
        if (size > length - at - 8)
            return gltf_bad(g, "GLB chunk %zu says %zu bytes, %zu are left", chunk, size,
                            length - at - 8);
        if (chunk == 0) {
            if (type != 0x4e4f534a) return gltf_bad(g, "its first chunk is not JSON");
            *json = (const char *)bytes + at + 8;
            *json_n = size;
        } else if (type == 0x004e4942 && !g->bin.known) {
            g->bin = (struct gltf_bytes){bytes + at + 8, size, 0, true};
        }
        at += 8 + ((size + 3) & ~(size_t)3);
    }
    return PRT_OK;
}

// cJSON recurses: the depth is bounded before it sees the text.
static int scan_depth(const struct gltf *g, const char *json, size_t n)
{
    size_t depth = 0;
    bool in_text = false;
    for (size_t i = 0; i < n; i++) {
        char c = json[i];
        if (!c) return gltf_bad(g, "a zero byte inside its JSON");
        if (in_text) {
            if (c == '\\')
                i++;
            else if (c == '"')
                in_text = false;
        } else if (c == '"') {
            in_text = true;
        } else if (c == '[' || c == '{') {
            if (++depth > MAX_DEPTH)
                return gltf_bad(g, "its JSON nests deeper than %d", MAX_DEPTH);
        } else if ((c == ']' || c == '}') && depth) {
            depth--;
        }
    }
    return PRT_OK;
}

static int parse_json(struct gltf *g, const char *json, size_t n)
{
    const char *end = NULL;
    while (n && (!json[n - 1] || isspace((unsigned char)json[n - 1]))) n--; // padding
    if (!n) return gltf_bad(g, "its JSON is empty");
    int status = scan_depth(g, json, n);
    if (status) return status;
    g->json = cJSON_ParseWithLengthOpts(json, n, &end, 0);
    if (!g->json || end != json + n)
        return gltf_bad(g, "its JSON is damaged near byte %zu", end ? (size_t)(end - json) : 0);
    if (!cJSON_IsObject(g->json)) return gltf_bad(g, "its JSON is not an object");
    return PRT_OK;
}

static int check_head(struct gltf *g)
{
    const cJSON *asset = gltf_member(g->json, "asset"), *item;
    const char *version = text_of(asset, "version"), *least = text_of(asset, "minVersion");
    if (!version) return gltf_bad(g, "has no asset.version: not glTF 2.0");
    if (version[0] != '2' || (least && strcmp(least, "2.0")))
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: glTF version %.16s, only 2.0 is known",
                        g->d->name, least ? least : version);
    cJSON_ArrayForEach(item, gltf_member(g->json, "extensionsRequired"))
    {
        bool known = false;
        for (size_t i = 0; cJSON_IsString(item) && i < sizeof supported / sizeof *supported; i++)
            known |= supported[i][strlen(supported[i]) - 1] == '_'
                         ? !strncmp(item->valuestring, supported[i], strlen(supported[i]))
                         : !strcmp(item->valuestring, supported[i]);
        if (!known)
            return prt_fail(g->d->ctx, PRT_UNSUPPORTED,
                            "%s: it requires the extension %.80s, which is not supported",
                            g->d->name, cJSON_IsString(item) ? item->valuestring : "?");
    }
    return PRT_OK;
}

static int read_tables(struct gltf *g)
{
    int status;
    if ((status = gltf_table(g, "buffers", &g->buffer)) ||
        (status = gltf_table(g, "bufferViews", &g->view)) ||
        (status = gltf_table(g, "accessors", &g->accessor)) ||
        (status = gltf_table(g, "meshes", &g->mesh)) ||
        (status = gltf_table(g, "materials", &g->material)) ||
        (status = gltf_table(g, "nodes", &g->node)) ||
        (status = gltf_table(g, "scenes", &g->scene)))
        return status;
    g->buffer_bytes = gltf_own(g, g->buffer.n * sizeof *g->buffer_bytes);
    g->view_bytes = gltf_own(g, g->view.n * sizeof *g->view_bytes);
    g->draco = gltf_own(g, g->view.n * sizeof *g->draco);
    g->surface_of = gltf_own(g, (g->material.n + 1) * sizeof *g->surface_of);
    g->opaque_of = gltf_own(g, (g->material.n + 1) * sizeof *g->opaque_of);
    if (!g->buffer_bytes || !g->view_bytes || !g->draco || !g->surface_of || !g->opaque_of)
        return no_memory(g);
    memset(g->surface_of, 0xff, (g->material.n + 1) * sizeof *g->surface_of);
    memset(g->opaque_of, 0xff, (g->material.n + 1) * sizeof *g->opaque_of);
    return PRT_OK;
}

static void tell(const struct gltf *g)
{
    if (g->n_skipped)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: %u primitives of points or lines, or without positions, are left out",
                g->d->name, g->n_skipped);
    if (g->n_deformed)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: skins and morph targets are not applied: the bind pose is used",
                g->d->name);
    if (g->n_bad_normal)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u normals have no direction and are made from the triangles", g->d->name,
                g->n_bad_normal);
    if (g->n_flat)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u primitives are flattened by a node of scale 0: they have no thickness",
                g->d->name, g->n_flat);
    if (g->n_tail)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: the last triangle of %u primitives is incomplete and left out", g->d->name,
                g->n_tail);
}

static void release(struct gltf *g)
{
    for (size_t i = 0; g->draco && i < g->view.n; i++)
        if (g->draco[i]) {
            struct prt_draco m = {.position = g->draco[i]->position,
                                  .normal = g->draco[i]->normal,
                                  .uv = g->draco[i]->uv,
                                  .triangle = g->draco[i]->triangle};
            prt_draco_free(&m);
        }
    cJSON_Delete(g->json);
    for (struct gltf_owned *p = g->owned, *next; p; p = next) {
        next = p->next;
        free(p);
    }
}

int prt_read_gltf(struct prt_draft *d, const uint8_t *bytes, size_t n)
{
    struct gltf g = {.d = d};
    const char *json = (const char *)bytes;
    size_t json_n = n;
    int status = n >= 4 && !memcmp(bytes, "glTF", 4) ? open_glb(&g, bytes, n, &json, &json_n)
                                                     : PRT_OK;
    d->units_known = true;
    if (!status) status = parse_json(&g, json, json_n);
    if (!status) status = check_head(&g);
    if (!status) status = read_tables(&g);
    if (!status) status = walk_scene(&g);
    if (!status) settle_surfaces(&g);
    if (!status) tell(&g);
    release(&g);
    return status;
}
