// SPDX-License-Identifier: MIT
// Two trees: the hierarchy over surface samples (JB02) and the spatial clusters of vertices.
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEAF_SAMPLES = 8 }; // chosen, not measured

struct item {
    float key;
    uint32_t id;
};

static int item_order(const void *a, const void *b)
{
    const struct item *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return x->id < y->id ? -1 : x->id > y->id;
}

// Sorts id[0..n) along the longest axis of their box.
static void sort_longest(const float (*position)[3], uint32_t *id, uint32_t n,
                         struct item *scratch)
{
    float lo[3] = {INFINITY, INFINITY, INFINITY}, hi[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (uint32_t i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) {
            lo[k] = fminf(lo[k], position[id[i]][k]);
            hi[k] = fmaxf(hi[k], position[id[i]][k]);
        }
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (hi[k] - lo[k] > hi[axis] - lo[axis]) axis = k;
    for (uint32_t i = 0; i < n; i++) scratch[i] = (struct item){position[id[i]][axis], id[i]};
    qsort(scratch, n, sizeof *scratch, item_order);
    for (uint32_t i = 0; i < n; i++) id[i] = scratch[i].id;
}

static void measure_node(const struct prt_surface_points *s, const uint32_t *order,
                         struct node *node)
{
    double area = 0, sum[3] = {0, 0, 0};
    for (int k = 0; k < 3; k++) node->box[0][k] = INFINITY, node->box[1][k] = -INFINITY;
    for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
        uint32_t id = order[i];
        double a = fmax(s->area[id], 1e-30);
        area += a;
        for (int k = 0; k < 3; k++) {
            float p = s->centre[id][k];
            sum[k] += a * p;
            node->box[0][k] = fminf(node->box[0][k], p);
            node->box[1][k] = fmaxf(node->box[1][k], p);
        }
    }
    node->area = (float)area;
    for (int k = 0; k < 3; k++) node->centre[k] = (float)(sum[k] / area);
    double spread = 0;
    for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
        uint32_t id = order[i];
        double own = pow((double)s->spread[id], 2);
        for (int k = 0; k < 3; k++)
            own += 0.5 * pow((double)s->centre[id][k] - (double)node->centre[k], 2);
        spread += fmax(s->area[id], 1e-30) * own;
    }
    node->spread = (float)sqrt(spread / area);
}

static uint32_t build(const struct prt_surface_points *s, struct hierarchy *h, uint32_t begin,
                      uint32_t count, struct item *scratch)
{
    uint32_t at = h->n_node++;
    h->node[at] = (struct node){.begin = begin, .count = count};
    measure_node(s, h->order, &h->node[at]);
    if (count > LEAF_SAMPLES) {
        sort_longest((const float(*)[3])s->position, h->order + begin, count, scratch);
        uint32_t left = build(s, h, begin, count / 2, scratch);
        uint32_t right = build(s, h, begin + count / 2, count - count / 2, scratch);
        h->node[at].child[0] = left;
        h->node[at].child[1] = right;
    }
    return at;
}

uint64_t prt_hierarchy_most_nodes(uint32_t n_sample, uint32_t n_object)
{
    uint64_t leaves = 1;
    for (uint32_t n = n_sample; n > LEAF_SAMPLES; n = n / 2 + n % 2) leaves *= 2;
    // Of several objects each has fewer: halves of more than 8 samples have more than 4.
    return n_object > 1 ? n_sample / 2 + 2ull * n_object : 2 * leaves;
}

int prt_hierarchy_create(const struct prt_surface_points *s, struct hierarchy **out)
{
    struct hierarchy *h = calloc(1, sizeof *h);
    struct item *scratch = prt_alloc(s->n_sample, sizeof *scratch);
    if (h) {
        h->node = prt_alloc((size_t)s->n_sample + 2 * s->n_object + 2, sizeof *h->node);
        h->order = prt_alloc(s->n_sample, sizeof *h->order);
        h->root = prt_calloc(s->n_object + 1u, sizeof *h->root);
    }
    if (!h || !scratch || !h->node || !h->order || !h->root) {
        prt_hierarchy_destroy(h);
        prt_free(scratch);
        return PRT_NOMEM;
    }
    for (uint32_t i = 0; i < s->n_sample; i++) h->order[i] = i;
    for (uint32_t o = 0; o < s->n_object; o++) {
        uint32_t begin = s->object_begin[o], n = s->object_begin[o + 1] - begin;
        if (n) h->root[o] = build(s, h, begin, n, scratch) + 1;
    }
    prt_free(scratch);
    *out = h;
    return PRT_OK;
}

void prt_hierarchy_destroy(struct hierarchy *h)
{
    if (!h) return;
    prt_free(h->node);
    prt_free(h->order);
    prt_free(h->root);
    free(h);
}

static int index_order(const void *a, const void *b)
{
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return x < y ? -1 : x > y;
}

// A group of vertices of one object and kind of surface that is split.
struct group {
    const struct prt_mesh *mesh;
    uint32_t target, object; // most vertices of a cluster
    bool translucent;
    struct item *scratch;
};

static void split(const struct group *g, struct clusters *c, uint32_t begin, uint32_t n)
{
    if (n > g->target) {
        sort_longest((const float(*)[3])g->mesh->position, c->order + begin, n, g->scratch);
        split(g, c, begin, n / 2);
        split(g, c, begin + n / 2, n - n / 2);
        return;
    }
    // File order within a cluster, because answers are scattered to file order.
    qsort(c->order + begin, n, sizeof *c->order, index_order);
    uint32_t at = c->n_cluster++;
    c->cluster[at] = (struct prt_cluster){.vertex_begin = begin, .n_vertex = n};
    c->object[at] = g->object;
    c->translucent[at] = g->translucent;
}

int prt_clusters_create(const struct prt_mesh *mesh, uint32_t target, struct clusters **out)
{
    struct clusters *c = calloc(1, sizeof *c);
    uint32_t *block = prt_mesh_vertex_blocks(mesh);
    struct item *scratch = prt_alloc(mesh->n_vertex, sizeof *scratch);
    size_t most = (size_t)mesh->n_vertex * 2 / (target ? target : 1) + 2u * mesh->n_object + 2;
    if (most > mesh->n_vertex + 1u) most = mesh->n_vertex + 1u;
    if (c) {
        c->cluster = prt_calloc(most, sizeof *c->cluster);
        c->object = prt_calloc(most, sizeof *c->object);
        c->translucent = prt_calloc(most, 1);
        c->order = prt_alloc(mesh->n_vertex, sizeof *c->order);
    }
    if (!c || !block || !scratch || !c->cluster || !c->object || !c->translucent || !c->order) {
        prt_clusters_destroy(c);
        prt_free(block);
        prt_free(scratch);
        return PRT_NOMEM;
    }
    // One group for each (object, translucent), each split in space.
    struct item *group = scratch;
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        const struct prt_block *b = &mesh->block[block[v]];
        bool t = mesh->surface[b->surface].translucent != 0;
        group[v] = (struct item){(float)(2.0 * b->object + t), v};
    }
    qsort(group, mesh->n_vertex, sizeof *group, item_order);
    for (uint32_t v = 0; v < mesh->n_vertex; v++) c->order[v] = group[v].id;
    for (uint32_t begin = 0; begin < mesh->n_vertex;) {
        const struct prt_block *b = &mesh->block[block[c->order[begin]]];
        bool t = mesh->surface[b->surface].translucent != 0;
        uint32_t end = begin;
        while (end < mesh->n_vertex) {
            const struct prt_block *e = &mesh->block[block[c->order[end]]];
            if (e->object != b->object || (mesh->surface[e->surface].translucent != 0) != t)
                break;
            end++;
        }
        split(&(struct group){mesh, target, b->object, t, scratch}, c, begin, end - begin);
        begin = end;
    }
    prt_free(block);
    prt_free(scratch);
    *out = c;
    return PRT_OK;
}

void prt_clusters_destroy(struct clusters *c)
{
    if (!c) return;
    prt_free(c->cluster);
    prt_free(c->object);
    prt_free(c->translucent);
    prt_free(c->order);
    free(c);
}
