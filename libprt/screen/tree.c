// SPDX-License-Identifier: MIT
// Clusters of samples as seen from afar, and tiles of G-buffer points that look at them.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEAF = 8, FAN = 4 };

static void node_weigh(struct tree_node *node, double mean[4])
{
    for (int k = 0; k < 3; k++)
        node->p[k] = mean[3] > 0 ? (float)(mean[k] / mean[3]) : (node->lo[k] + node->hi[k]) / 2;
}

static struct tree_node make_leaf(const struct samples *s, uint32_t first, uint32_t n)
{
    struct tree_node node = {.first = first, .n = n, .leaf = true};
    double mean[4] = {0};
    for (int k = 0; k < 3; k++) {
        node.lo[k] = INFINITY;
        node.hi[k] = -INFINITY;
    }
    for (uint32_t i = first; i < first + n; i++) {
        double power = 0;
        for (int k = 0; k < 3; k++) {
            float w = s->e[k][i] * s->area[i];
            node.w[k] += w;
            power += w;
            node.lo[k] = min_f(node.lo[k], s->p[k][i]);
            node.hi[k] = max_f(node.hi[k], s->p[k][i]);
        }
        for (int k = 0; k < 3; k++) mean[k] += power * s->p[k][i];
        mean[3] += power;
    }
    node_weigh(&node, mean);
    return node;
}

static struct tree_node join(const struct tree_node *child, uint32_t first, uint32_t n)
{
    struct tree_node node = child[0];
    double mean[4] = {0};
    node.first = first;
    node.n = n;
    node.leaf = false;
    memset(node.w, 0, sizeof node.w);
    for (uint32_t i = 0; i < n; i++) {
        double power = 0;
        for (int k = 0; k < 3; k++) {
            node.w[k] += child[i].w[k];
            power += child[i].w[k];
            node.lo[k] = min_f(node.lo[k], child[i].lo[k]);
            node.hi[k] = max_f(node.hi[k], child[i].hi[k]);
        }
        for (int k = 0; k < 3; k++) mean[k] += power * child[i].p[k];
        mean[3] += power;
    }
    node_weigh(&node, mean);
    return node;
}

int tree_build(const struct samples *s, uint32_t n_object, struct tree *out)
{
    memset(out, 0, sizeof *out);
    size_t most = (size_t)s->n / LEAF * 3 / 2 + (size_t)n_object * 20 + 16;
    out->node = prt_alloc(most, sizeof *out->node);
    out->root = prt_alloc(n_object ? n_object : 1, sizeof *out->root);
    if (!out->node || !out->root) {
        tree_finish(out);
        return PRT_NOMEM;
    }
    out->n_object = n_object;
    for (uint32_t o = 0; o < n_object; o++) out->root[o] = UINT32_MAX;
    for (uint32_t first = 0, last; first < s->n; first = last) {
        uint32_t object = s->object[first];
        last = first;
        while (last < s->n && s->object[last] == object) last++;
        uint32_t level = out->n_node;
        for (uint32_t i = first; i < last; i += LEAF)
            out->node[out->n_node++] = make_leaf(s, i, last - i < LEAF ? last - i : LEAF);
        while (out->n_node - level > 1) {
            uint32_t end = out->n_node;
            for (uint32_t i = level; i < end; i += FAN) {
                uint32_t n = end - i < FAN ? end - i : FAN;
                out->node[out->n_node++] = join(&out->node[i], i, n);
            }
            level = end;
        }
        if (object < n_object) out->root[object] = level;
    }
    return PRT_OK;
}

void tree_finish(struct tree *tree)
{
    prt_free(tree->node);
    prt_free(tree->root);
    memset(tree, 0, sizeof *tree);
}

bool tree_gather(const struct tree *tree, const struct samples *s, uint32_t object,
                 const float lo[3], const float hi[3], float opening, float r_max,
                 struct emitters *out)
{
    uint32_t stack[256], top = 0;
    if (object >= tree->n_object || tree->root[object] == UINT32_MAX) return true;
    stack[top++] = tree->root[object];
    while (top) {
        const struct tree_node *node = &tree->node[stack[--top]];
        if (!(node->w[0] + node->w[1] + node->w[2] > 0)) continue;
        float gap = 0, size = 0;
        for (int k = 0; k < 3; k++) {
            float g = max_f(max_f(node->lo[k] - hi[k], lo[k] - node->hi[k]), 0);
            float e = node->hi[k] - node->lo[k];
            gap += g * g;
            size += e * e;
        }
        if (gap > r_max * r_max) continue;
        if (!emitters_reserve(out, out->n + LEAF + 16)) return false;
        if (size < opening * opening * gap) {
            emitters_push(out, node->p, node->w);
        } else if (node->leaf) {
            for (uint32_t i = node->first; i < node->first + node->n; i++) {
                float p[3] = {s->p[0][i], s->p[1][i], s->p[2][i]}, a = s->area[i];
                float w[3] = {s->e[0][i] * a, s->e[1][i] * a, s->e[2][i] * a};
                if (w[0] + w[1] + w[2] > 0) emitters_push(out, p, w);
            }
        } else {
            for (uint32_t i = 0; i < node->n; i++) stack[top++] = node->first + i;
        }
    }
    return true;
}

int tiles_build(const struct prt_gbuffer *g, const struct prt_mesh *mesh, uint32_t width,
                uint32_t height, struct tiles *out)
{
    memset(out, 0, sizeof *out);
    uint32_t across = (width + 7) / 8, down = (height + 7) / 8, n_bucket = across * down;
    uint32_t *start = calloc((size_t)n_bucket + 1, sizeof *start), total = 0;
    out->order = malloc(((size_t)g->n_point + 1) * sizeof *out->order);
    // a tile ends at 64 points, at a bucket's end or where the object changes
    if (!start || !out->order) goto nomem;
    for (uint32_t i = 0; i < g->n_point; i++) {
        if (g->opaque[i]) continue;
        uint32_t y = g->pixel[i] / width, x = g->pixel[i] % width;
        start[y / 8 * across + x / 8 + 1]++;
        total++;
    }
    for (uint32_t b = 0; b < n_bucket; b++) start[b + 1] += start[b];
    for (uint32_t i = 0; i < g->n_point; i++) {
        if (g->opaque[i]) continue;
        uint32_t y = g->pixel[i] / width, x = g->pixel[i] % width;
        out->order[start[y / 8 * across + x / 8]++] = i;
    }
    out->begin = malloc(((size_t)total + 2) * sizeof *out->begin);
    out->object = malloc(((size_t)total + 1) * sizeof *out->object);
    if (!out->begin || !out->object) goto nomem;
    for (uint32_t b = 0, first = 0; b < n_bucket; first = start[b++]) {
        uint32_t last = start[b]; // moved to the bucket's end by the placing above
        for (uint32_t i = first; i < last;) {
            uint32_t object = mesh->block[g->block[out->order[i]]].object, n = 0;
            // bring this object's points together
            for (uint32_t j = i; j < last && n < TILE_POINTS; j++) {
                uint32_t p = out->order[j];
                if (mesh->block[g->block[p]].object != object) continue;
                out->order[j] = out->order[i + n];
                out->order[i + n++] = p;
            }
            out->begin[out->n_tile] = i;
            out->object[out->n_tile++] = object;
            i += n;
        }
    }
    out->begin[out->n_tile] = total;
    free(start);
    return PRT_OK;
nomem:
    free(start);
    tiles_finish(out);
    return PRT_NOMEM;
}

void tiles_finish(struct tiles *tiles)
{
    free(tiles->begin);
    free(tiles->order);
    free(tiles->object);
    memset(tiles, 0, sizeof *tiles);
}
