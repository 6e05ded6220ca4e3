// SPDX-License-Identifier: MIT
// Pass 2's kernel: the rows of the hierarchy that a cluster of vertices gathers from, and the
// radial functions between each vertex and each row (W05 eq 7; opened by solid angle, JB02).
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// A node is opened when its solid angle from the cluster exceeds JB02's epsilon [sr], or its
// extent exceeds open_extent of the kernel's own length. That is 1/sigma_tr, but at least
// r/open_lengths: a function that falls faster has nothing left at r. The values were chosen
// together with the cells' second moments: the error against a cut of twelve times the columns
// is 0.04 to 0.09 %.
static const float open_solid_angle = 0.04f;
static const float open_extent = 1;
static const float open_lengths = 4;
static const float near_spacings = 3.5f; // a sample's cell is integrated within this distance

struct cut_build {
    const struct cut_source *from;
    const struct prt_cluster *cluster;
    const struct radial_set *radial;
    unsigned cpu;
    const struct prt_surface_points *s;
    const struct hierarchy *h;
    struct cut *cut;
    float box[2][3];
    float near_mm, steepest;
};

static int add_column(struct cut *cut, uint32_t row)
{
    if (cut->n_column == cut->capacity) {
        uint32_t capacity = cut->capacity ? cut->capacity * 2 : 4096;
        uint32_t *grown = realloc(cut->row, capacity * sizeof *grown);
        if (!grown) return PRT_NOMEM;
        cut->row = grown;
        cut->capacity = capacity;
    }
    cut->row[cut->n_column++] = row;
    return PRT_OK;
}

// Adds the columns of a node: the node itself, or of the nodes and samples below it.
static int visit(struct cut_build *b, uint32_t at)
{
    const struct node *node = &b->h->node[at];
    float gap2 = 0, centre2 = 0, extent2 = 0;
    for (int k = 0; k < 3; k++) {
        float gap =
            fmaxf(fmaxf(node->box[0][k] - b->box[1][k], b->box[0][k] - node->box[1][k]), 0);
        float c =
            fmaxf(fmaxf(node->centre[k] - b->box[1][k], b->box[0][k] - node->centre[k]), 0);
        float e = node->box[1][k] - node->box[0][k];
        gap2 += gap * gap;
        centre2 += c * c;
        extent2 += e * e;
    }
    bool open = gap2 < b->near_mm * b->near_mm ||
                node->area > open_solid_angle * b->from->coarseness * centre2 ||
                sqrtf(extent2) * fminf(b->steepest, open_lengths / sqrtf(gap2)) >
                    open_extent * sqrtf(b->from->coarseness);
    if (!open) return add_column(b->cut, b->s->n_sample + at);
    int status = PRT_OK;
    if (node->child[0]) {
        status = visit(b, node->child[0]);
        return status ? status : visit(b, node->child[1]);
    }
    for (uint32_t i = node->begin; status == PRT_OK && i < node->begin + node->count; i++)
        status = add_column(b->cut, i);
    return status;
}

// The integral over a sample's cell for one vertex (METHODS §3.1).
static void near_column(const struct prt_surface_points *s, uint32_t sample, const float x[3],
                        const struct radial_set *radial, unsigned cpu, float *scratch,
                        float *out)
{
    enum { CHUNK = 128 };
    float *r2 = scratch, *value[64];
    for (uint32_t f = 0; f < radial->n; f++) value[f] = scratch + CHUNK * (f + 1), out[f] = 0;
    for (uint64_t at = s->cell_begin[sample], end = s->cell_begin[sample + 1]; at < end;
         at += CHUNK) {
        size_t n = end - at < CHUNK ? (size_t)(end - at) : CHUNK;
        for (size_t i = 0; i < n; i++) {
            const float *q = s->fine[s->cell_fine[at + i]];
            float a = q[0] - x[0], b = q[1] - x[1], c = q[2] - x[2];
            r2[i] = a * a + b * b + c * c;
        }
        radial->eval(radial->user, cpu, n, r2, value);
        for (uint32_t f = 0; f < radial->n; f++)
            for (size_t i = 0; i < n; i++) out[f] += value[f][i] * s->cell_weight[at + i];
    }
}

// K's column of one row of the hierarchy: [n_function][n_vertex], stride n_vertex*n_column.
static void fill_column(const struct cut_build *b, uint32_t column, float *scratch)
{
    const struct prt_mesh *mesh = b->from->mesh;
    const struct clusters *clusters = b->from->clusters;
    const struct prt_cluster *cluster = b->cluster;
    const struct radial_set *radial = b->radial;
    uint32_t row = b->cut->row[column], n = cluster->n_vertex;
    bool is_sample = row < b->s->n_sample;
    uint32_t sample = is_sample ? b->h->order[row] : 0;
    const struct node *node = is_sample ? NULL : &b->h->node[row - b->s->n_sample];
    const float *p = is_sample ? b->s->centre[sample] : node->centre;
    float area = (is_sample ? b->s->area[sample] : node->area) * (float)(0.5 / M_PI);
    float spread = is_sample ? b->s->spread[sample] : node->spread;
    size_t stride = (size_t)n * b->cut->n_column;
    float *r2 = scratch, *afar = r2 + n, *both = afar + 2 * n, *value[64], *at[64];
    float *inner = both + 2 * (size_t)n * radial->n, one[64];
    for (uint32_t f = 0; f < radial->n; f++) {
        value[f] = b->cut->k + f * stride + (size_t)column * n;
        at[f] = both + 2 * (size_t)n * f;
    }
    for (uint32_t v = 0; v < n; v++) {
        const float *x = mesh->position[clusters->order[cluster->vertex_begin + v]];
        float d0 = p[0] - x[0], d1 = p[1] - x[1], d2 = p[2] - x[2];
        r2[v] = d0 * d0 + d1 * d1 + d2 * d2;
        prt_surface_afar(r2[v], spread, &afar[v], &afar[n + v]);
    }
    radial->eval(radial->user, b->cpu, 2 * (size_t)n, afar, at);
    for (uint32_t f = 0; f < radial->n; f++)
        for (uint32_t v = 0; v < n; v++) value[f][v] = area * (at[f][v] + at[f][n + v]);
    if (!is_sample) return;
    for (uint32_t v = 0; v < n; v++) {
        if (r2[v] > b->near_mm * b->near_mm) continue;
        near_column(b->s, sample, mesh->position[clusters->order[cluster->vertex_begin + v]],
                    radial, b->cpu, inner, one);
        for (uint32_t f = 0; f < radial->n; f++) value[f][v] = one[f] * (float)(1 / M_PI);
    }
}

int prt_cut_build(const struct prt_context *ctx, const struct cut_source *from, uint32_t c,
                  const struct radial_set *radial, struct cut *cut)
{
    const struct prt_mesh *mesh = from->mesh;
    const struct clusters *clusters = from->clusters;
    const struct prt_cluster *cluster = &clusters->cluster[c];
    struct cut_build b = {.from = from,
                          .cluster = cluster,
                          .radial = radial,
                          .cpu = ctx->cpu,
                          .s = from->surface,
                          .h = from->hierarchy,
                          .cut = cut,
                          .steepest = radial->steepest,
                          .near_mm = near_spacings * from->surface->spacing};
    cut->n_column = 0;
    for (int k = 0; k < 3; k++) b.box[0][k] = INFINITY, b.box[1][k] = -INFINITY;
    for (uint32_t v = 0; v < cluster->n_vertex; v++) {
        const float *x = mesh->position[clusters->order[cluster->vertex_begin + v]];
        for (int k = 0; k < 3; k++) {
            b.box[0][k] = fminf(b.box[0][k], x[k]);
            b.box[1][k] = fmaxf(b.box[1][k], x[k]);
        }
    }
    uint32_t root = from->hierarchy->root[clusters->object[c]];
    int status = root ? visit(&b, root - 1) : PRT_OK;
    size_t need = (size_t)radial->n * cluster->n_vertex * cut->n_column;
    if (status == PRT_OK && need > cut->k_capacity) {
        prt_free(cut->k);
        cut->k_capacity = need + need / 8;
        cut->k = prt_alloc(cut->k_capacity, sizeof *cut->k);
        if (!cut->k) cut->k_capacity = 0, status = PRT_NOMEM;
    }
    float *scratch =
        prt_alloc((3 + 2 * (size_t)radial->n) * cluster->n_vertex + 128 * (radial->n + 1),
                  sizeof *scratch);
    if (!scratch) status = PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < cut->n_column; i++)
        fill_column(&b, i, scratch);
    prt_free(scratch);
    return status;
}

void prt_cut_finish(struct cut *cut)
{
    free(cut->row);
    prt_free(cut->k);
    memset(cut, 0, sizeof *cut);
}
