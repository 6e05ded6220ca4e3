// SPDX-License-Identifier: MIT
// The glTF node tree, walked without recursion.
#include "gltf.h"

#include <math.h>
#include <string.h>

enum { SPARE_VISITS = 1000 };

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
    if (!(l > 1e-9 && l < 1e9))
        return gltf_bad(g, "node %zu: its rotation has no length", index);
    double x = q[0] / l, y = q[1] / l, z = q[2] / l, w = q[3] / l;
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
    return gltf_instance(g, node, index, v->m);
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
    if (!is_child) return gltf_no_memory(g);
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

int gltf_walk(struct gltf *g)
{
    struct walk w = {gltf_own(g, (g->node.n + 1) * sizeof *w.stack), gltf_own(g, g->node.n + 1),
                     0, 0};
    uint64_t index;
    int status = gltf_number(g, "JSON object", 0, g->json, "scene", 1ull << 53, 0, &index);
    if (!status && (!w.stack || !w.on_path)) status = gltf_no_memory(g);
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
    cJSON_ArrayForEach(root, roots) if ((status = walk_from(g, &w, root))) return status;
    return PRT_OK;
}
