// SPDX-License-Identifier: MIT
// Sparse storage (W05): the largest Haar coefficients of every vertex, eight bits each.
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct sparse_builder {
    const struct clusters *clusters;
    uint32_t n, n_function, n_coef, n_vertex, keep; // keep: entries of a row besides scaling
    uint16_t *scaling;
    float *scale;
    uint32_t *index;
    int8_t *entry;
};

int prt_sparse_builder_create(const struct clusters *clusters, uint32_t n_vertex, uint32_t n,
                              uint32_t n_function, uint32_t n_coef, struct sparse_builder **out)
{
    struct sparse_builder *b = calloc(1, sizeof *b);
    if (!b) return PRT_NOMEM;
    b->clusters = clusters;
    b->n = n, b->n_function = n_function, b->n_coef = 6 * n * n, b->n_vertex = n_vertex;
    b->keep = n_coef > b->n_coef ? b->n_coef - 6 : n_coef > 6 ? n_coef - 6 : 0;
    size_t entries = (size_t)n_vertex * b->keep;
    b->scaling = prt_calloc((size_t)n_vertex * 6 * n_function, 2);
    b->scale = prt_calloc((size_t)n_vertex * n_function, 4);
    b->index = prt_calloc(entries + 32, 4);
    b->entry = prt_calloc((entries + 32) * n_function, 1);
    if (!b->scaling || !b->scale || !b->index || !b->entry) {
        prt_sparse_builder_destroy(b);
        return PRT_NOMEM;
    }
    for (uint32_t v = 0; v < n_vertex;
         v++) // rows that are never added have ascending indices, too
        for (uint32_t k = 0, at = 1; k < b->keep; k++, at++) {
            if (at % (n * n) == 0) at++;
            b->index[(size_t)v * b->keep + k] = at;
        }
    *out = b;
    return PRT_OK;
}

struct ranked {
    float energy;
    uint32_t index;
};

static int by_energy(const void *a, const void *b)
{
    const struct ranked *x = a, *y = b;
    if (x->energy != y->energy) return x->energy < y->energy ? 1 : -1;
    return x->index < y->index ? -1 : 1;
}

static int by_index(const void *a, const void *b)
{
    const struct ranked *x = a, *y = b;
    return x->index < y->index ? -1 : 1;
}

static void add_row(struct sparse_builder *b, uint32_t row, float *dense, struct ranked *rank)
{
    uint32_t face = b->n * b->n, J = b->n_function, n = 0;
    for (uint32_t j = 0; j < J; j++)
        for (int f = 0; f < 6; f++) prt_haar_forward(b->n, dense + j * b->n_coef + f * face);
    for (uint32_t k = 0; k < b->n_coef; k++) {
        float e = 0;
        for (uint32_t j = 0; j < J; j++) {
            float x = dense[j * b->n_coef + k];
            if (k % face == 0)
                b->scaling[((size_t)row * 6 + k / face) * J + j] = prt_f32_to_f16(x);
            e += x * x;
        }
        if (k % face) rank[n++] = (struct ranked){e, k};
    }
    qsort(rank, n, sizeof *rank, by_energy);
    qsort(rank, b->keep, sizeof *rank, by_index);
    for (uint32_t j = 0; j < J; j++) {
        float most = 0, *values = dense + j * b->n_coef;
        for (uint32_t i = 0; i < b->keep; i++) most = fmaxf(most, fabsf(values[rank[i].index]));
        float scale = most > 0 ? most / 127 : 1;
        b->scale[(size_t)row * J + j] = scale;
        for (uint32_t i = 0; i < b->keep; i++)
            b->entry[((size_t)row * b->keep + i) * J + j] =
                (int8_t)lrintf(values[rank[i].index] / scale);
    }
    for (uint32_t i = 0; i < b->keep; i++) b->index[(size_t)row * b->keep + i] = rank[i].index;
}

void prt_sparse_builder_add(struct sparse_builder *b, uint32_t cluster, float *dense)
{
    const struct prt_cluster *c = &b->clusters->cluster[cluster];
    struct ranked *rank = malloc(b->n_coef * sizeof *rank);
    for (uint32_t v = 0; rank && v < c->n_vertex; v++)
        add_row(b, c->vertex_begin + v, dense + (size_t)v * b->n_function * b->n_coef, rank);
    free(rank);
}

void prt_sparse_builder_rows(const struct sparse_builder *b, uint32_t cluster,
                             struct sparse_rows out[4])
{
    const struct prt_cluster *c = &b->clusters->cluster[cluster];
    size_t first = c->vertex_begin, n = c->n_vertex, J = b->n_function, keep = b->keep;
    out[0] = (struct sparse_rows){b->scaling + first * 6 * J, n * 6 * J * sizeof *b->scaling};
    out[1] = (struct sparse_rows){b->scale + first * J, n * J * sizeof *b->scale};
    out[2] = (struct sparse_rows){b->index + first * keep, n * keep * sizeof *b->index};
    out[3] = (struct sparse_rows){b->entry + first * keep * J, n * keep * J};
}

int prt_sparse_builder_finish(struct sparse_builder *b, struct prt_tensor *out)
{
    memset(out, 0, sizeof *out);
    uint64_t *begin = prt_alloc(b->n_vertex + 1u, sizeof *begin);
    uint32_t *order = prt_alloc(b->n_vertex, sizeof *order);
    bool wide = b->n_coef > 65536;
    size_t entries = (size_t)b->n_vertex * b->keep;
    if (!begin || !order) {
        prt_free(begin);
        prt_free(order);
        return PRT_NOMEM;
    }
    for (uint32_t v = 0; v <= b->n_vertex; v++) begin[v] = (uint64_t)v * b->keep;
    memcpy(order, b->clusters->order, b->n_vertex * sizeof *order);
    if (!wide) // narrowed in place: 2-byte writes stay behind the 4-byte reads
        for (size_t i = 0; i < entries; i++) {
            uint16_t k = (uint16_t)b->index[i];
            memcpy((char *)b->index + 2 * i, &k, 2);
        }
    out->storage = PRT_STORAGE_SPARSE;
    out->n_vertex = b->n_vertex;
    out->n_function = b->n_function;
    out->order = order;
    out->rows = (struct prt_rows){.n_row = b->n_vertex,
                                  .n_function = b->n_function,
                                  .n_coef = b->n_coef,
                                  .value = PRT_VALUE_I8,
                                  .index_bytes = wide ? 4 : 2,
                                  .begin = begin,
                                  .index = b->index,
                                  .entry = b->entry,
                                  .scale = b->scale,
                                  .scaling = b->scaling};
    b->index = NULL, b->entry = NULL, b->scale = NULL, b->scaling = NULL;
    return PRT_OK;
}

void prt_sparse_builder_destroy(struct sparse_builder *b)
{
    if (!b) return;
    prt_free(b->scaling);
    prt_free(b->scale);
    prt_free(b->index);
    prt_free(b->entry);
    free(b);
}
