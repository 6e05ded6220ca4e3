// SPDX-License-Identifier: MIT
// Stratified area samples of the translucent surface: triangles in the order of blocks, and the
// points of the samples on them.
#include "trace/surface_private.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// A cell of the grid, a place on the Morton curve within it.
struct key {
    uint64_t block, code;
    uint32_t triangle;
};

static int key_order(const void *a, const void *b)
{
    const struct key *x = a, *y = b;
    if (x->block != y->block) return x->block < y->block ? -1 : 1;
    if (x->code != y->code) return x->code < y->code ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

// The cell of a triangle's centre in a grid through the origin, and its place on a Morton curve
// of 2^21 steps a side through the cell. Neither changes with another part of the mesh.
static struct key key_of(const struct prt_mesh *mesh, uint32_t t, double edge)
{
    const float(*at)[3] = prt_mesh_model_positions(mesh);
    struct key key = {.triangle = t};
    for (int k = 0; k < 3; k++) {
        double c = 0;
        for (int j = 0; j < 3; j++) c += at[mesh->triangle[t][j]][k] / 3.0;
        const double cell = floor(c / edge), in = c / edge - cell;
        key.block |= morton_spread((uint64_t)((int64_t)fmax(fmin(cell, 1e15), -1e15))) << k;
        key.code |= morton_spread((uint64_t)(fmin(fmax(in, 0), 1) * 2097151.0)) << k;
    }
    return key;
}

// The edge of a block: a power of two, so that it holds for a mesh that is a little larger. An
// object has about most_blocks of them, fewer where there are few samples.
static double block_edge(double area, uint32_t n_sample)
{
    static const double most_blocks = 1024, samples = 16; // chosen, not measured
    double n = exp2(2 * round(log2(n_sample / samples) / 2));
    n = fmin(fmax(n, 1), most_blocks);
    return area > 0 ? exp2(round(log2(area / n) / 2)) : 1;
}

static double list_triangles(const struct prt_mesh *mesh, uint32_t object, struct key *key)
{
    double area = 0;
    size_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (block->object != object || !prt_surface_translucent(mesh, block)) continue;
        for (uint32_t i = 0; i < block->n_triangle; i++) {
            key[n].triangle = block->triangle_begin + i;
            area += model_area(mesh, key[n++].triangle);
        }
    }
    return area;
}

int prt_surface_order(const struct prt_mesh *mesh, uint32_t object, uint32_t n_sample,
                      struct piece_list *out)
{
    size_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        if (mesh->block[b].object == object && prt_surface_translucent(mesh, &mesh->block[b]))
            n += mesh->block[b].n_triangle;
    memset(out, 0, sizeof *out);
    if (!n) return PRT_OK;
    struct key *key = prt_alloc(n, sizeof *key);
    out->triangle = prt_alloc(n, sizeof *out->triangle);
    out->end = prt_alloc(n, sizeof *out->end);
    out->block = prt_alloc(n, sizeof *out->block);
    if (!key || !out->triangle || !out->end || !out->block) {
        prt_free(key);
        return PRT_NOMEM;
    }
    const double edge = block_edge(list_triangles(mesh, object, key), n_sample);
    for (size_t i = 0; i < n; i++) key[i] = key_of(mesh, key[i].triangle, edge);
    qsort(key, n, sizeof *key, key_order);
    double sum = 0;
    for (size_t i = 0; i < n; i++) {
        sum += model_area(mesh, key[i].triangle);
        out->triangle[i] = key[i].triangle;
        out->block[i] = key[i].block;
        out->end[i] = sum;
    }
    out->n = (uint32_t)n;
    out->edge = edge;
    prt_free(key);
    return PRT_OK;
}

void prt_surface_pieces_finish(struct piece_list *list)
{
    prt_free(list->triangle);
    prt_free(list->block);
    prt_free(list->end);
    prt_free(list->stratum);
}

static const uint32_t least_samples = 16; // of an object that has area; chosen, not measured

int prt_surface_share(struct prt_surface_points *s, struct piece_list *list, uint32_t n_sample,
                      uint64_t seed)
{
    double total = 0;
    uint64_t n = 0;
    int status = PRT_OK;
    for (uint32_t o = 0; o < s->n_object; o++)
        if (list[o].n) total += list[o].end[list[o].n - 1];
    for (uint32_t o = 0; o < s->n_object && !status; o++) {
        s->object_begin[o] = (uint32_t)n;
        double area = list[o].n ? list[o].end[list[o].n - 1] : 0;
        if (area <= 0) continue;
        double own = fmax(n_sample * (area / total), least_samples);
        do {
            prt_free(list[o].stratum);
            status = prt_surface_draw(&list[o], own, seed);
            own *= 2;
        } while (!status && list[o].n_stratum < least_samples);
        n += list[o].n_stratum;
    }
    s->object_begin[s->n_object] = (uint32_t)n;
    s->n_sample = (uint32_t)n;
    return status ? status : n ? PRT_OK : PRT_ARG;
}

// A point of the unit triangle from f in [0,1): the 4-way split of the triangle walked in a
// fixed order, so that nearby f are nearby points and equal steps are equal areas.
static void walk_triangle(double f, double *bu, double *bv)
{
    double a[3][2] = {{0, 0}, {1, 0}, {0, 1}};
    for (unsigned level = 0; level < SURFACE_LEVELS; level++) {
        f *= 4;
        int child = (int)f;
        if (child > 3) child = 3;
        f -= child;
        double m01[2], m12[2], m20[2];
        for (int k = 0; k < 2; k++) {
            m01[k] = (a[0][k] + a[1][k]) / 2;
            m12[k] = (a[1][k] + a[2][k]) / 2;
            m20[k] = (a[2][k] + a[0][k]) / 2;
        }
        for (int k = 0; k < 2; k++) {
            double c[4][3] = {{a[0][k], m01[k], m20[k]},
                              {m01[k], m12[k], m20[k]},
                              {m01[k], a[1][k], m12[k]},
                              {m20[k], m12[k], a[2][k]}};
            for (int j = 0; j < 3; j++) a[j][k] = c[child][j];
        }
    }
    *bu = (a[0][0] + a[1][0] + a[2][0]) / 3;
    *bv = (a[0][1] + a[1][1] + a[2][1]) / 3;
}

// Turns a sample's normal by the normal map and notes the factor of its irradiance; maps are
// filtered over the spacing of the samples.
static void apply_look(struct prt_surface_points *s, const struct prt_mesh *mesh, uint32_t i,
                       uint32_t t, double bu, double bv)
{
    const uint32_t *v = mesh->triangle[t];
    float step[2][3], d[2][2];
    const float *n = s->face_normal[i];
    double length = 0;
    struct prt_look look;
    for (int k = 0; k < 3; k++) {
        step[0][k] = mesh->position[v[1]][k] - mesh->position[v[0]][k];
        length += (double)step[0][k] * (double)step[0][k];
    }
    float by = length > 0 ? s->spacing / (float)sqrt(length) : 0;
    for (int k = 0; k < 3; k++) step[0][k] *= by;
    for (int k = 0; k < 3; k++) {
        int p = (k + 1) % 3, q = (k + 2) % 3;
        step[1][k] = n[p] * step[0][q] - n[q] * step[0][p];
    }
    for (int j = 0; j < 2; j++) prt_mesh_footprint(mesh, t, step[j], d[j]);
    const float da[2] = {d[0][0], d[1][0]}, db[2] = {d[0][1], d[1][1]};
    prt_mesh_look(mesh, t, prt_mesh_block_of(mesh, t), (float)bu, (float)bv, da, db,
                  s->normal[i], &look);
    s->tint[i] = prt_mesh_tint(mesh, look.base) * look.occlusion;
    memcpy(s->normal[i], look.normal, sizeof look.normal);
}

static void place_sample(struct prt_surface_points *s, const struct prt_mesh *mesh, uint32_t i,
                         uint32_t t, double bu, double bv)
{
    const uint32_t *v = mesh->triangle[t];
    double w[3] = {1 - bu - bv, bu, bv}, n[3] = {0, 0, 0}, length = 0, face[3], fl = 0;
    triangle_cross(mesh, t, face);
    for (int k = 0; k < 3; k++) {
        double p = 0;
        for (int j = 0; j < 3; j++) {
            p += w[j] * mesh->position[v[j]][k];
            n[k] += w[j] * mesh->normal[v[j]][k];
        }
        s->position[i][k] = (float)p;
        length += n[k] * n[k];
        fl += face[k] * face[k];
    }
    length = sqrt(length), fl = sqrt(fl);
    for (int k = 0; k < 3; k++) {
        s->face_normal[i][k] = (float)(fl > 0 ? face[k] / fl : 0);
        s->normal[i][k] = (float)(length > 1e-12 ? n[k] / length : s->face_normal[i][k]);
    }
    if (s->tint) apply_look(s, mesh, i, t, bu, bv);
}

void prt_surface_place(struct prt_surface_points *s, const struct prt_mesh *mesh,
                       const struct piece_list *list, uint32_t object)
{
    const uint32_t first = s->object_begin[object];
    double before = 0;
    uint32_t at = 0;
    for (uint32_t i = 0; i < list->n_stratum; i++) {
        const double a = list->stratum[i].sample;
        while (at + 1 < list->n && list->end[at] <= a) before = list->end[at++];
        double own = list->end[at] - before;
        double bu, bv, f = own > 0 ? (a - before) / own : 0;
        walk_triangle(fmin(fmax(f, 0), 1), &bu, &bv);
        s->triangle[first + i] = list->triangle[at];
        s->inside[first + i][0] = (float)bu, s->inside[first + i][1] = (float)bv;
        s->stratum[first + i] = list->stratum[i].begin;
        place_sample(s, mesh, first + i, list->triangle[at], bu, bv);
        s->object[first + i] = object;
    }
}
