// SPDX-License-Identifier: MIT
// A tree of clusters of samples, which stand for their samples at a distance. Leaves are runs
// of LEAF samples. Four neighbours are a node of the next level; their boxes lie side by side
// so that four are tested at once.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEAF = TREE_LEAF, FAN = 4 };

static void clear_node(struct tree_node *node, int k)
{
    for (int i = 0; i < 3; i++) {
        node->lo[i][k] = INFINITY;
        node->hi[i][k] = -INFINITY;
        node->p[i][k] = node->w[i][k] = 0;
    }
    node->first[k] = 0;
    node->size_sq[k] = 0;
}

static void close_lane(struct tree_node *node, int k, const float mean[4])
{
    float size = 0;
    for (int i = 0; i < 3; i++) {
        float e = node->hi[i][k] - node->lo[i][k];
        size += e * e;
        node->p[i][k] = mean[3] > 0 ? mean[i] / mean[3] : (node->lo[i][k] + node->hi[i][k]) / 2;
    }
    node->size_sq[k] = size;
}

struct leaf_job {
    const struct samples *s;
    struct tree *tree;
    uint32_t object_first, object_last; // samples
    uint32_t level;                     // first node of the leaves
};

// Lane l of the leaves' level: samples [first + l LEAF, + LEAF).
static int make_leaves(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct leaf_job *job = arg;
    const struct samples *s = job->s;
    struct tree *t = job->tree;
    for (size_t l = begin; l < end; l++) {
        struct tree_node *node = &t->node[job->level + l / FAN];
        int k = (int)(l % FAN);
        uint32_t first = job->object_first + (uint32_t)l * LEAF;
        clear_node(node, k);
        if (first >= job->object_last) continue;
        uint32_t last = first + LEAF < job->object_last ? first + LEAF : job->object_last;
        float mean[4] = {0, 0, 0, 0};
        node->first[k] = first;
        for (uint32_t i = first; i < last; i++) {
            float power = 0;
            for (int c = 0; c < 3; c++) {
                float w = s->e[c][i] * s->area[i];
                t->w[c][i] = w;
                node->w[c][k] += w;
                power += w;
            }
            // dark samples do not extend a box
            if (!(power > 0)) continue;
            for (int c = 0; c < 3; c++) {
                float x = s->p[c][i];
                node->lo[c][k] = min_f(node->lo[c][k], x);
                node->hi[c][k] = max_f(node->hi[c][k], x);
                mean[c] += power * x;
            }
            mean[3] += power;
        }
        if (mean[3] > 0) close_lane(node, k, mean);
    }
    return PRT_OK;
}

// Sets lane k of `up` to the sum of node `at`.
static void join(const struct tree_node *child, uint32_t at, struct tree_node *up, int k)
{
    float mean[4] = {0, 0, 0, 0};
    clear_node(up, k);
    up->first[k] = at;
    for (int j = 0; j < FAN; j++) {
        float power = child->w[0][j] + child->w[1][j] + child->w[2][j];
        if (!(power > 0)) continue;
        for (int i = 0; i < 3; i++) {
            up->w[i][k] += child->w[i][j];
            up->lo[i][k] = min_f(up->lo[i][k], child->lo[i][j]);
            up->hi[i][k] = max_f(up->hi[i][k], child->hi[i][j]);
            mean[i] += power * child->p[i][j];
        }
        mean[3] += power;
    }
    if (mean[3] > 0) close_lane(up, k, mean);
}

static bool tree_alloc(struct tree *out, const struct samples *s, uint32_t n_object)
{
    size_t most = (size_t)s->n / LEAF / FAN * 3 / 2 + (size_t)n_object * 20 + 16;
    size_t objects = n_object ? n_object : 1;
    memset(out, 0, sizeof *out);
    out->n_object = n_object;
    out->node = prt_alloc(most, sizeof *out->node);
    out->root = prt_alloc(objects, sizeof *out->root);
    out->n_leaf_end = prt_alloc(objects, sizeof *out->n_leaf_end);
    out->sample_end = prt_alloc(objects, sizeof *out->sample_end);
    bool good = out->node && out->root && out->n_leaf_end && out->sample_end;
    for (int c = 0; c < 3; c++) {
        out->w[c] = prt_alloc((size_t)s->n + 32, sizeof(float));
        out->p[c] = s->p[c];
        good = good && out->w[c];
    }
    for (uint32_t o = 0; good && o < n_object; o++) out->root[o] = UINT32_MAX;
    // a leaf is copied whole: samples past the last one have no power
    for (int c = 0; c < 3 && good; c++) memset(out->w[c] + s->n, 0, 32 * sizeof(float));
    return good;
}

// Appends a level of nodes over the nodes [level, end).
static void join_level(struct tree *out, uint32_t level, uint32_t end)
{
    for (uint32_t i = level; i < end; i += FAN) {
        struct tree_node *up = &out->node[out->n_node++];
        for (uint32_t k = 0; k < FAN; k++) {
            if (i + k < end) join(&out->node[i + k], i + k, up, (int)k);
            else clear_node(up, (int)k);
        }
    }
}

// Appends the nodes of one object, samples [first, last); the last node is its root.
static int build_object(const struct prt_context *ctx, const struct samples *s, uint32_t first,
                        uint32_t last, struct tree *out)
{
    uint32_t object = s->object[first], level = out->n_node;
    uint32_t n = ((last - first + LEAF - 1) / LEAF + FAN - 1) / FAN;
    struct leaf_job job = {s, out, first, last, level};
    int status = prt_parallel_for(ctx, NULL, (size_t)n * FAN, 1024, make_leaves, &job);
    if (status) return status;
    out->n_node += n;
    uint32_t leaves_end = out->n_node;
    while (out->n_node - level > 1) {
        uint32_t end = out->n_node;
        join_level(out, level, end);
        level = end;
    }
    if (object >= out->n_object) return PRT_OK;
    out->root[object] = level;
    out->n_leaf_end[object] = leaves_end;
    out->sample_end[object] = last;
    return PRT_OK;
}

int prt_tree_build(const struct prt_context *ctx, const struct samples *s, uint32_t n_object,
                   struct tree *out)
{
    int status = tree_alloc(out, s, n_object) ? PRT_OK : PRT_NOMEM;
    for (uint32_t first = 0, last; first < s->n && !status; first = last) {
        last = first;
        while (last < s->n && s->object[last] == s->object[first]) last++;
        status = build_object(ctx, s, first, last, out);
    }
    if (status) prt_tree_finish(out);
    return status;
}

void prt_tree_finish(struct tree *tree)
{
    prt_free(tree->node);
    prt_free(tree->root);
    prt_free(tree->n_leaf_end);
    prt_free(tree->sample_end);
    for (int c = 0; c < 3; c++) prt_free(tree->w[c]);
    memset(tree, 0, sizeof *tree);
}

// Appends a leaf: LEAF samples are copied, those of the object are counted.
static void push_leaf(const struct tree *tree, uint32_t first, uint32_t end,
                      struct emitters *out)
{
    for (int c = 0; c < 3; c++) {
        memcpy(out->p[c] + out->n, tree->p[c] + first, LEAF * sizeof(float));
        memcpy(out->w[c] + out->n, tree->w[c] + first, LEAF * sizeof(float));
    }
    out->n += end - first < LEAF ? end - first : LEAF;
}

bool prt_tree_gather(const struct tree *tree, uint32_t object, const float lo[3],
                     const float hi[3], float opening, float r_max, struct emitters *out)
{
    uint32_t stack[256], top = 0;
    if (object >= tree->n_object || tree->root[object] == UINT32_MAX) return true;
    const float open_sq = opening * opening, r_sq = r_max * r_max;
    const uint32_t leaf_end = tree->n_leaf_end[object];
    stack[top++] = tree->root[object];
    while (top) {
        uint32_t at = stack[--top];
        const struct tree_node *node = &tree->node[at];
        float gap[FAN], far[FAN];
        for (int k = 0; k < FAN; k++) {
            float g0 = max_f(max_f(node->lo[0][k] - hi[0], lo[0] - node->hi[0][k]), 0);
            float g1 = max_f(max_f(node->lo[1][k] - hi[1], lo[1] - node->hi[1][k]), 0);
            float g2 = max_f(max_f(node->lo[2][k] - hi[2], lo[2] - node->hi[2][k]), 0);
            gap[k] = g0 * g0 + g1 * g1 + g2 * g2;
            far[k] = open_sq * gap[k] - node->size_sq[k];
        }
        if (!prt_emitters_reserve(out, out->n + FAN * LEAF + 16)) return false;
        bool leaf = at < leaf_end;
        for (int k = 0; k < FAN; k++) {
            // dark lanes have empty boxes, whose gap is infinite
            if (!(gap[k] <= r_sq)) continue;
            if (far[k] > 0) {
                float p[3] = {node->p[0][k], node->p[1][k], node->p[2][k]};
                float w[3] = {node->w[0][k], node->w[1][k], node->w[2][k]};
                emitters_push(out, p, w);
            } else if (leaf) {
                push_leaf(tree, node->first[k], tree->sample_end[object], out);
            } else {
                stack[top++] = node->first[k];
            }
        }
    }
    return true;
}
