// SPDX-License-Identifier: MIT
// Stratified area samples of the translucent surface.
#include "trace/surface_private.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct key {
    uint64_t code;
    uint32_t triangle;
};

static int key_order(const void *a, const void *b)
{
    const struct key *x = a, *y = b;
    if (x->code != y->code) return x->code < y->code ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

// The place of a triangle's centre on a Morton curve of 2^21 cells a side.
static uint64_t morton_code(const struct prt_mesh *mesh, uint32_t t, const float lo[3],
                            double edge)
{
    uint64_t code = 0;
    for (int k = 0; k < 3; k++) {
        double c = 0;
        for (int j = 0; j < 3; j++) c += mesh->position[mesh->triangle[t][j]][k] / 3.0;
        double f = (c - lo[k]) / edge;
        code |= morton_spread((uint64_t)(fmin(fmax(f, 0), 1) * 2097151.0)) << k;
    }
    return code;
}

int prt_surface_order(const struct prt_mesh *mesh, uint32_t object, struct piece_list *out)
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
    if (!key || !out->triangle || !out->end) {
        prt_free(key);
        return PRT_NOMEM;
    }
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    double edge = 1e-30;
    for (int k = 0; k < 3; k++) edge = fmax(edge, (double)box[1][k] - box[0][k]);
    size_t i = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (block->object != object || !prt_surface_translucent(mesh, block)) continue;
        for (uint32_t t = block->triangle_begin; t < block->triangle_begin + block->n_triangle;
             t++, i++) {
            uint64_t code = morton_code(mesh, t, box[0], edge);
            key[i] = (struct key){code, t};
        }
    }
    qsort(key, n, sizeof *key, key_order);
    double sum = 0;
    for (i = 0; i < n; i++) {
        sum += triangle_area(mesh, key[i].triangle);
        out->triangle[i] = key[i].triangle;
        out->end[i] = sum;
    }
    out->n = (uint32_t)n;
    prt_free(key);
    return PRT_OK;
}

static const uint64_t least_samples = 16; // of an object that has area; chosen, not measured

int prt_surface_share(struct prt_surface_points *s, const struct piece_list *list,
                      uint32_t n_sample)
{
    double total = 0;
    uint64_t n = 0;
    for (uint32_t o = 0; o < s->n_object; o++)
        if (list[o].n) total += list[o].end[list[o].n - 1];
    for (uint32_t o = 0; o < s->n_object; o++) {
        s->object_begin[o] = (uint32_t)n;
        double area = list[o].n ? list[o].end[list[o].n - 1] : 0;
        if (area <= 0) continue;
        uint64_t own = (uint64_t)(n_sample * (area / total) + 0.5);
        if (own < least_samples) own = least_samples;
        s->spacing = fmaxf(s->spacing, (float)sqrt(area / (double)own));
        n += own;
    }
    s->object_begin[s->n_object] = (uint32_t)n;
    s->n_sample = (uint32_t)n;
    return n ? PRT_OK : PRT_ARG;
}

// A point of the unit triangle from f in [0,1): the 4-way split of the triangle walked in a
// fixed order, so that nearby f are nearby points and equal steps are equal areas.
static void walk_triangle(double f, float jitter_u, float jitter_v, unsigned levels, double *bu,
                          double *bv)
{
    double a[3][2] = {{0, 0}, {1, 0}, {0, 1}};
    for (unsigned level = 0; level < levels; level++) {
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
    double u = jitter_u, v = jitter_v;
    if (u + v > 1) u = 1 - u, v = 1 - v;
    *bu = a[0][0] + u * (a[1][0] - a[0][0]) + v * (a[2][0] - a[0][0]);
    *bv = a[0][1] + u * (a[1][1] - a[0][1]) + v * (a[2][1] - a[0][1]);
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
                       const struct piece_list *list, uint32_t object, uint32_t n,
                       uint64_t seed)
{
    double total = list->end[list->n - 1], step = total / n, before = 0;
    uint32_t at = 0, first = s->object_begin[object];
    struct prt_rng rng;
    prt_rng_init(&rng, seed, object);
    for (uint32_t i = 0; i < n; i++) {
        double a = (i + 0.5) * step;
        while (at + 1 < list->n && list->end[at] <= a) before = list->end[at++];
        double own = list->end[at] - before;
        unsigned levels = 0;
        for (double piece = own; piece > step && levels < 14; piece /= 4) levels++;
        float ju = prt_rng_f32(&rng), jv = prt_rng_f32(&rng);
        double bu, bv, f = own > 0 ? (a - before) / own : 0;
        walk_triangle(fmin(fmax(f, 0), 1), ju, jv, levels, &bu, &bv);
        place_sample(s, mesh, first + i, list->triangle[at], bu, bv);
        s->object[first + i] = object;
    }
}
