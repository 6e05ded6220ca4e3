// SPDX-License-Identifier: MIT
// Points of the surface: their columns, their order along a Morton curve, and the atlas of
// texels of equal area along the triangles.
#include "internal.h"

#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

bool prt_samples_init(struct samples *s, uint32_t capacity)
{
    memset(s, 0, sizeof *s);
    capacity = (capacity + 47) & ~15u;
    bool good = (s->area = prt_calloc(capacity, 4)) && (s->object = prt_calloc(capacity, 4)) &&
                (s->triangle = prt_calloc(capacity, 4)) &&
                (s->bary[0] = prt_calloc(capacity, 4)) &&
                (s->bary[1] = prt_calloc(capacity, 4));
    for (int k = 0; k < 3 && good; k++)
        good = (s->p[k] = prt_calloc(capacity, 4)) &&
               (s->normal[k] = prt_calloc(capacity, 4)) &&
               (s->face[k] = prt_calloc(capacity, 4)) && (s->e[k] = prt_calloc(capacity, 4));
    s->capacity = capacity;
    if (!good) prt_samples_finish(s);
    return good;
}

void prt_samples_finish(struct samples *s)
{
    for (int k = 0; k < 3; k++) {
        prt_free(s->p[k]);
        prt_free(s->normal[k]);
        prt_free(s->face[k]);
        prt_free(s->e[k]);
    }
    prt_free(s->area);
    prt_free(s->object);
    prt_free(s->triangle);
    prt_free(s->bary[0]);
    prt_free(s->bary[1]);
    memset(s, 0, sizeof *s);
}

bool prt_block_translucent(const struct prt_mesh *mesh, uint32_t block)
{
    return mesh->surface[mesh->block[block].surface].translucent != 0;
}

double prt_sample_place(const struct prt_mesh *mesh, uint32_t t, double bu, double bv,
                        struct samples *s, uint32_t at)
{
    const uint32_t *v = mesh->triangle[t];
    double w[3] = {1 - bu - bv, bu, bv}, n[3], face[3], length = 0, fl = 0;
    for (int k = 0; k < 3; k++) {
        double p = 0;
        n[k] = 0;
        for (int j = 0; j < 3; j++) {
            p += w[j] * mesh->position[v[j]][k];
            n[k] += w[j] * mesh->normal[v[j]][k];
        }
        s->p[k][at] = (float)p;
        length += n[k] * n[k];
    }
    triangle_cross(mesh, t, face);
    for (int k = 0; k < 3; k++) fl += face[k] * face[k];
    s->triangle[at] = t;
    s->bary[0][at] = (float)bu;
    s->bary[1][at] = (float)bv;
    length = sqrt(length);
    fl = sqrt(fl);
    for (int k = 0; k < 3; k++) {
        s->face[k][at] = (float)(fl > 0 ? face[k] / fl : 0);
        s->normal[k][at] = (float)(length > 1e-12 ? n[k] / length : s->face[k][at]);
    }
    return fl / 2;
}

enum { DIGIT = 11, DIGITS = 1 << DIGIT };

uint64_t prt_morton_code(const float lo[3], float inv_edge, const float p[3])
{
    uint64_t code = 0;
    for (int k = 0; k < 3; k++) {
        float f = (p[k] - lo[k]) * inv_edge * 1023;
        code |= morton_spread(f > 0 ? f < 1023 ? (uint64_t)f : 1023 : 0) << k;
    }
    return code;
}

// Stable radix sort by as many digits as the largest code has.
struct key *prt_sort_keys(struct key *key, struct key *other, size_t n)
{
    uint64_t all = 0;
    for (size_t i = 0; i < n; i++) all |= key[i].code;
    for (unsigned shift = 0; shift < 64 && all >> shift; shift += DIGIT) {
        size_t start[DIGITS + 1] = {0};
        for (size_t i = 0; i < n; i++) start[(key[i].code >> shift & (DIGITS - 1)) + 1]++;
        for (int k = 0; k < DIGITS; k++) start[k + 1] += start[k];
        for (size_t i = 0; i < n; i++)
            other[start[key[i].code >> shift & (DIGITS - 1)]++] = key[i];
        struct key *swap = key;
        key = other;
        other = swap;
    }
    return key;
}

float prt_inverse_edge(float box[2][3])
{
    float edge = 1e-20f;
    for (int k = 0; k < 3; k++) edge = max_f(edge, box[1][k] - box[0][k]);
    return 1 / edge;
}

// Barycentrics of a point at f in [0,1) along Sierpinski's curve of a triangle. Each level
// halves the triangle at the midpoint of the curve's side, so that equal steps are equal areas
// and the curve is continuous.
static void sierpinski_point(double f, double *bu, double *bv)
{
    double a[2] = {1, 0}, b[2] = {0, 1}, c[2] = {0, 0};
    for (unsigned level = 0; level < 24; level++) {
        f *= 2;
        bool second = f >= 1;
        f -= second;
        for (int k = 0; k < 2; k++) {
            double m = (a[k] + b[k]) / 2;
            if (second) a[k] = c[k];
            else b[k] = c[k];
            c[k] = m;
        }
    }
    *bu = (a[0] + b[0] + c[0]) / 3;
    *bv = (a[1] + b[1] + c[1]) / 3;
}

// Translucent triangles by object and along a Morton curve; the caller frees *memory.
static struct key *order_triangles(const struct prt_mesh *mesh, uint32_t *n_out, void **memory)
{
    struct key *key = malloc(2 * ((size_t)mesh->n_triangle + 1) * sizeof *key);
    *memory = key;
    if (!key) return NULL;
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    float inv = prt_inverse_edge(box);
    uint32_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        if (!prt_block_translucent(mesh, b)) continue;
        const struct prt_block *k = &mesh->block[b];
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle; t++) {
            float c[3] = {0, 0, 0};
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) c[i] += mesh->position[mesh->triangle[t][j]][i] / 3;
            key[n++] = (struct key){
                (uint64_t)k->object << CODE_BITS | prt_morton_code(box[0], inv, c), t};
        }
    }
    *n_out = n;
    return prt_sort_keys(key, key + mesh->n_triangle + 1, n);
}

int prt_samples_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                      struct samples *out)
{
    uint32_t n_key = 0;
    void *memory;
    struct key *key = order_triangles(mesh, &n_key, &memory);
    double total = 0, *end = malloc(((size_t)n_key + 1) * sizeof *end);
    uint64_t count = 0;
    if (!key || !end) goto nomem;
    for (uint32_t i = 0; i < n_key; i++) {
        total += triangle_area(mesh, key[i].index);
        end[i] = total;
    }
    if (!(total > 0)) {
        free(memory);
        free(end);
        return prt_fail(ctx, PRT_ARG, "screen: no translucent triangle has any area");
    }
    if (!prt_samples_init(out, n + 64 * (mesh->n_object + 1))) goto nomem;
    for (uint32_t first = 0, last; first < n_key; first = last) {
        double before = first ? end[first - 1] : 0;
        last = first;
        uint64_t object = key[first].code >> CODE_BITS;
        while (last < n_key && key[last].code >> CODE_BITS == object) last++;
        double own = end[last - 1] - before;
        if (!(own > 0)) continue;
        uint32_t share = (uint32_t)(n * (own / total)), at = first;
        if (share < 16) share = 16;
        for (uint32_t i = 0; i < share; i++, count++) {
            double a = before + (i + 0.5) / share * own, bu, bv;
            while (at + 1 < last && end[at] <= a) at++;
            double low = at ? end[at - 1] : 0, size = end[at] - low;
            sierpinski_point(size > 0 ? fmin(fmax((a - low) / size, 0), 1) : 0, &bu, &bv);
            prt_sample_place(mesh, key[at].index, bu, bv, out, (uint32_t)count);
            out->area[count] = (float)(own / share);
            out->object[count] = (uint32_t)object;
        }
    }
    out->n = (uint32_t)count;
    free(memory);
    free(end);
    return PRT_OK;
nomem:
    free(memory);
    free(end);
    return prt_fail(ctx, PRT_NOMEM, "screen: no memory for an atlas of %u texels", n);
}
