// SPDX-License-Identifier: MIT
// The glTF node tree, walked without recursion.
#include "gltf_pose.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SPARE_VISITS = 1000 }; // chosen, not measured: instances beyond four a node

static void multiply(const double *a, const double *b, double *out)
{
    for (int c = 0; c < 4; c++)
        for (int r = 0; r < 4; r++)
            out[c * 4 + r] = a[r] * b[c * 4] + a[4 + r] * b[c * 4 + 1] +
                             a[8 + r] * b[c * 4 + 2] + a[12 + r] * b[c * 4 + 3];
}

static int numbers(const struct gltf *g, size_t node, const char *what,
                   const struct prt_gltf_numbers *from, size_t n, double *out)
{
    for (size_t i = 0; i < n && from->n; i++) {
        if (i >= from->n || !isfinite(from->at[i]))
            return prt_gltf_bad(g, "node %zu: %s needs %zu numbers", node, what, n);
        out[i] = from->at[i];
    }
    return PRT_OK;
}

// Translation, rotation and scale as a matrix; false where q has no length.
static bool compose(const double t[3], const double q[4], const double s[3], double m[16])
{
    const double l = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    if (!(l > 1e-9 && l < 1e9)) return false;
    const double x = q[0] / l, y = q[1] / l, z = q[2] / l, w = q[3] / l;
    const double r[9] = {
        1 - 2 * (y * y + z * z), 2 * (x * y + z * w),     2 * (x * z - y * w),
        2 * (x * y - z * w),     1 - 2 * (x * x + z * z), 2 * (y * z + x * w),
        2 * (x * z + y * w),     2 * (y * z - x * w),     1 - 2 * (x * x + y * y)};
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < 3; k++) m[c * 4 + k] = r[c * 3 + k] * s[c];
        m[c * 4 + 3] = 0;
        m[12 + c] = t[c];
    }
    m[15] = 1;
    return true;
}

static int local_matrix(const struct gltf *g, size_t index, double m[16])
{
    double t[3] = {0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1};
    const struct prt_gltf_node *node = &g->file.node[index];
    const struct gltf_moment *moment = g->pose ? &g->pose->node[index] : NULL;
    const bool moves = moment && (moment->has_t || moment->has_r || moment->has_s);
    int status = numbers(g, index, "matrix", &node->matrix, 16, m);
    if (status || (node->matrix.n && !moves)) return status;
    if ((status = numbers(g, index, "translation", &node->translation, 3, t)) ||
        (status = numbers(g, index, "rotation", &node->rotation, 4, q)) ||
        (status = numbers(g, index, "scale", &node->scale, 3, s)))
        return status;
    if (moves && moment->has_t) memcpy(t, moment->t, sizeof t);
    if (moves && moment->has_r) memcpy(q, moment->r, sizeof q);
    if (moves && moment->has_s) memcpy(s, moment->s, sizeof s);
    return compose(t, q, s, m) ? PRT_OK
                               : prt_gltf_bad(g, "node %zu: its rotation has no length", index);
}

struct visit {
    size_t node, child; // the next child to enter
    double m[16];
};

struct walk {
    struct visit *stack; // [n_node + 1]: a path visits no node twice
    uint8_t *on_path;    // [n_node]
    size_t depth, visits;
    int (*enter)(struct gltf *g, size_t node, const double *world);
};

// ---- EXT_mesh_gpu_instancing

// The places of a node's instances: [n][3], [n][4] and [n][3], or NULL.
struct places {
    float *t, *q, *s;
    uint64_t n;
};

static const cJSON *instances_of(const struct gltf *g, size_t node)
{
    const cJSON *json = g->pose ? g->pose->json_node[node] : NULL;
    const cJSON *own = cJSON_GetObjectItemCaseSensitive(
        cJSON_GetObjectItemCaseSensitive(json, "extensions"), "EXT_mesh_gpu_instancing");
    return cJSON_GetObjectItemCaseSensitive(own, "attributes");
}

// One attribute; NULL where the node has none.
static int read_places(struct gltf *g, size_t node, const char *key, unsigned n_component,
                       struct places *p, float **out)
{
    const cJSON *attributes = instances_of(g, node);
    struct gltf_accessor a;
    if (!cJSON_GetObjectItemCaseSensitive(attributes, key)) return PRT_OK;
    int status = prt_gltf_read_floats(g, prt_gltf_whole(attributes, key), n_component, &a, out);
    if (!status && p->n && a.count != p->n)
        status = prt_gltf_bad(g, "node %zu: its instances have %llu %s of %llu", node,
                              (unsigned long long)a.count, key, (unsigned long long)p->n);
    if (!status) p->n = a.count;
    return status;
}

static int place_instance(struct gltf *g, size_t node, const double *world,
                          const struct places *p, uint64_t i)
{
    double t[3] = {0}, q[4] = {0, 0, 0, 1}, s[3] = {1, 1, 1}, m[16], own[16];
    for (int c = 0; c < 3 && p->t; c++) t[c] = (double)p->t[3 * i + (unsigned)c];
    for (int c = 0; c < 4 && p->q; c++) q[c] = (double)p->q[4 * i + (unsigned)c];
    for (int c = 0; c < 3 && p->s; c++) s[c] = (double)p->s[3 * i + (unsigned)c];
    if (!compose(t, q, s, m))
        return prt_gltf_bad(g, "node %zu: the rotation of instance %llu has no length", node,
                            (unsigned long long)i);
    multiply(world, m, own);
    return prt_gltf_instance(g, node, own);
}

// The node's mesh once for each instance; a skin places the mesh itself.
static int enter_instances(struct gltf *g, size_t node, const double *world)
{
    struct places p = {0};
    int status = read_places(g, node, "TRANSLATION", 3, &p, &p.t);
    if (!status) status = read_places(g, node, "ROTATION", 4, &p, &p.q);
    if (!status) status = read_places(g, node, "SCALE", 3, &p, &p.s);
    for (uint64_t i = 0; i < p.n && !status; i++)
        status = place_instance(g, node, world, &p, i);
    free(p.t);
    free(p.q);
    free(p.s);
    return status || p.n ? status : prt_gltf_instance(g, node, world);
}

// Cameras and meshes.
static int enter_node(struct gltf *g, size_t node, const double *world)
{
    const struct prt_gltf_node *own = &g->file.node[node];
    prt_gltf_add_camera(g, own, world);
    return own->mesh >= 0 && own->skin < 0 ? enter_instances(g, node, world)
                                           : prt_gltf_instance(g, node, world);
}

// Skins need the worlds of all their joints before the first mesh; a node with several parents
// keeps the first.
static int keep_world(struct gltf *g, size_t node, const double *world)
{
    if (!g->pose->has_world[node]) memcpy(g->pose->world[node], world, 16 * sizeof *world);
    g->pose->has_world[node] = 1;
    return PRT_OK;
}

static int visit_node(struct gltf *g, struct walk *w, int64_t which, const double *parent)
{
    double local[16];
    if (which < 0 || (uint64_t)which >= g->file.n_node)
        return prt_gltf_bad(g, "node %lld does not exist", (long long)which);
    size_t index = (size_t)which;
    if (w->on_path[index]) return prt_gltf_bad(g, "node %zu is its own descendant", index);
    // A node with several parents is visited once for each path to it; their number can grow
    // exponentially.
    if (++w->visits > 4 * g->file.n_node + SPARE_VISITS)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: the %zu nodes give more than %zu instances",
                        g->d->name, g->file.n_node, w->visits - 1);
    struct visit *v = &w->stack[w->depth];
    int status = local_matrix(g, index, local);
    if (status) return status;
    v->node = index;
    v->child = 0;
    multiply(parent, local, v->m);
    for (int i = 0; i < 16; i++)
        if (!(fabs(v->m[i]) < 1e30))
            return prt_gltf_bad(g, "node %zu: its transform is too large", index);
    w->on_path[index] = 1;
    w->depth++;
    return w->enter(g, index, v->m);
}

static int walk_from(struct gltf *g, struct walk *w, int64_t root)
{
    static const double identity[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};
    int status = visit_node(g, w, root, identity);
    while (!status && w->depth) {
        struct visit *v = &w->stack[w->depth - 1];
        const struct prt_gltf_node *node = &g->file.node[v->node];
        if (v->child < node->n_child) {
            status = visit_node(g, w, node->child[v->child++], v->m);
        } else {
            w->on_path[v->node] = 0;
            w->depth--;
        }
    }
    return status;
}

// Without a usable scene: every node that has no parent.
static int walk_roots(struct gltf *g, struct walk *w)
{
    uint8_t *is_child = prt_gltf_own(g, g->file.n_node);
    int status = PRT_OK;
    if (!is_child) return prt_gltf_no_memory(g);
    for (size_t i = 0; i < g->file.n_node; i++) {
        const struct prt_gltf_node *node = &g->file.node[i];
        for (size_t c = 0; c < node->n_child; c++)
            if (node->child[c] >= 0 && (size_t)node->child[c] < g->file.n_node)
                is_child[node->child[c]] = 1;
    }
    for (size_t i = 0; !status && i < g->file.n_node; i++)
        if (!is_child[i]) status = walk_from(g, w, (int64_t)i);
    return status;
}

static int walk_scene(struct gltf *g,
                      int (*enter)(struct gltf *g, size_t node, const double *world))
{
    const struct prt_gltf_document *f = &g->file;
    struct walk w = {prt_gltf_own(g, (f->n_node + 1) * sizeof *w.stack),
                     prt_gltf_own(g, f->n_node + 1), 0, 0, enter};
    uint64_t index = f->default_scene < 0 ? 0 : (uint64_t)f->default_scene;
    int status = PRT_OK;
    if (!w.stack || !w.on_path) return prt_gltf_no_memory(g);
    if (f->n_scene && index >= f->n_scene)
        return prt_gltf_bad(g, "scene %llu does not exist", (unsigned long long)index);
    if (!f->n_scene || !f->scene[index].n) {
        if (f->n_scene)
            prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: scene %llu is empty: all nodes are loaded",
                    g->d->name, (unsigned long long)index);
        return walk_roots(g, &w);
    }
    for (size_t i = 0; !status && i < f->scene[index].n; i++)
        status = walk_from(g, &w, f->scene[index].node[i]);
    return status;
}

int prt_gltf_walk(struct gltf *g)
{
    int status = g->pose ? walk_scene(g, keep_world) : PRT_OK;
    return status ? status : walk_scene(g, enter_node);
}
