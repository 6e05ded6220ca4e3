// SPDX-License-Identifier: MIT
// Welding by exact position, angle-weighted normals, and warnings about the surface from its
// edges.
#include "internal.h"

#include <math.h>
#include <string.h>

static bool translucent(const struct prt_mesh *m, const struct prt_block *b)
{
    return m->surface[b->surface].translucent != 0;
}

struct position_key {
    float p[3];
    uint32_t object;
};

static struct position_key position_key_of(const struct prt_mesh *m, uint32_t v,
                                           uint32_t object)
{
    // + 0 turns -0 into 0
    return (struct position_key){
        {m->position[v][0] + 0.f, m->position[v][1] + 0.f, m->position[v][2] + 0.f}, object};
}

static uint64_t position_hash(struct position_key p)
{
    uint64_t w[2];
    memcpy(w, &p, sizeof w);
    uint64_t h = (w[0] ^ 0x9e3779b97f4a7c15u) * 0xbf58476d1ce4e5b9u;
    h = (h ^ (h >> 29) ^ w[1]) * 0x94d049bb133111ebu;
    return h ^ (h >> 32);
}

// weld[v]: the rank of v's (object, position) by first appearance. first[w]: that vertex.
int prt_mesh_weld(const struct prt_context *ctx, const char *name, struct prt_mesh *m)
{
    size_t size = 16;
    while (size < (size_t)m->n_vertex * 2) size *= 2;
    uint32_t *table = prt_alloc(size, sizeof *table);
    struct position_key *seen = prt_alloc(m->n_vertex, sizeof *seen);
    if (!table || !seen) {
        prt_free(table);
        prt_free(seen);
        return prt_fail(ctx, PRT_NOMEM, "%s: no memory to weld %u vertices", name, m->n_vertex);
    }
    memset(table, 0xff, size * sizeof *table);
    uint32_t n = 0;
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct prt_block *b = &m->block[i];
        for (uint32_t v = b->vertex_begin; v < b->vertex_begin + b->n_vertex; v++) {
            struct position_key p = position_key_of(m, v, b->object);
            size_t at = position_hash(p) & (size - 1);
            while (table[at] != UINT32_MAX && memcmp(&seen[table[at]], &p, sizeof p))
                at = (at + 1) & (size - 1);
            if (table[at] == UINT32_MAX) {
                table[at] = n;
                seen[n++] = p;
            }
            m->weld[v] = table[at];
        }
    }
    m->n_weld = n;
    prt_free(table);
    prt_free(seen);
    return PRT_OK;
}

// Twice the area vector of triangle t, and its edges.
static void triangle_cross(const struct prt_mesh *m, uint32_t t, double e[3][3], double n[3])
{
    for (int k = 0; k < 3; k++) {
        const float *a = m->position[m->triangle[t][k]];
        const float *b = m->position[m->triangle[t][(k + 1) % 3]];
        for (int c = 0; c < 3; c++) e[k][c] = (double)b[c] - a[c];
    }
    for (int c = 0; c < 3; c++) {
        int i = (c + 1) % 3, j = (c + 2) % 3;
        n[c] = e[0][i] * e[1][j] - e[0][j] * e[1][i];
    }
}

static double dot(const double *a, const double *b)
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Adds each face's unit normal to its three corners, weighted by the corner's angle.
static void gather_normals(const struct prt_mesh *m, double (*sum)[3])
{
    for (uint32_t t = 0; t < m->n_triangle; t++) {
        double e[3][3], n[3];
        triangle_cross(m, t, e, n);
        double area = sqrt(dot(n, n));
        if (!(area > 0)) continue;
        for (int k = 0; k < 3; k++) {
            // at corner k the edges are e[k] and -e[k-1]; |their cross| is 2A at every corner
            double angle = atan2(area, -dot(e[k], e[(k + 2) % 3]));
            double *s = sum[m->weld[m->triangle[t][k]]];
            for (int c = 0; c < 3; c++) s[c] += angle / area * n[c];
        }
    }
}

// A vertex whose face normals cancel (both sides of a sheet) gets the normal of one of its
// faces.
static void fill_cancelled_normals(struct prt_mesh *m)
{
    for (uint32_t t = 0; t < m->n_triangle; t++) {
        double e[3][3], n[3];
        triangle_cross(m, t, e, n);
        double area = sqrt(dot(n, n));
        for (int k = 0; k < 3 && area > 0; k++) {
            float *q = m->normal[m->triangle[t][k]];
            if (q[0] || q[1] || q[2]) continue;
            for (int c = 0; c < 3; c++) q[c] = (float)(n[c] / area);
        }
    }
}

static int make_normals(const struct prt_context *ctx, const char *name, struct prt_mesh *m)
{
    uint32_t missing = 0, alone = 0;
    for (uint32_t v = 0; v < m->n_vertex; v++)
        missing += !m->normal[v][0] && !m->normal[v][1] && !m->normal[v][2];
    if (!missing) return PRT_OK;
    double(*sum)[3] = prt_calloc(m->n_weld, sizeof *sum);
    if (!sum) return prt_fail(ctx, PRT_NOMEM, "%s: no memory for normals", name);
    gather_normals(m, sum);
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        float *n = m->normal[v];
        if (n[0] || n[1] || n[2]) continue;
        const double *s = sum[m->weld[v]];
        double length = sqrt(dot(s, s));
        for (int c = 0; c < 3 && length > 1e-6; c++) n[c] = (float)(s[c] / length);
    }
    prt_free(sum);
    fill_cancelled_normals(m);
    for (uint32_t v = 0; v < m->n_vertex; v++) {
        float *n = m->normal[v];
        if (n[0] || n[1] || n[2]) continue;
        n[1] = 1;
        alone++;
    }
    if (alone)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: %u vertices belong to no triangle with an area; their normal is +y and "
                "their colour has no meaning",
                name, alone);
    return PRT_OK;
}

int prt_mesh_normals(const struct prt_context *ctx, struct prt_mesh *mesh)
{
    return make_normals(ctx, "mesh", mesh);
}

// Radix sort by the lowest `bits` of each key, least significant digit first.
static uint64_t *sort_keys(uint64_t *key, uint64_t *spare, size_t n, int bits)
{
    for (int shift = 0; shift < bits; shift += 11) {
        size_t at[2049] = {0};
        for (size_t i = 0; i < n; i++) at[((key[i] >> shift) & 2047) + 1]++;
        for (int d = 0; d < 2047; d++) at[d + 1] += at[d];
        for (size_t i = 0; i < n; i++) spare[at[(key[i] >> shift) & 2047]++] = key[i];
        uint64_t *swap = key;
        key = spare;
        spare = swap;
    }
    return key;
}

struct edges {
    uint32_t boundary, crowded, flipped;
};

// Welded edges of the translucent triangles. A key is low<<(b+1) | high<<1 | direction.
static int count_edges(const struct prt_context *ctx, const char *name, struct prt_mesh *m,
                       struct edges *found)
{
    int b = 1;
    while ((m->n_weld >> b) && b < 31) b++;
    size_t n = 0, most = (size_t)m->n_triangle * 3;
    uint64_t *key = prt_alloc(most, sizeof *key), *spare = prt_alloc(most, sizeof *spare);
    if (!key || !spare) {
        prt_free(key);
        prt_free(spare);
        return prt_fail(ctx, PRT_NOMEM, "%s: no memory to count edges", name);
    }
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct prt_block *block = &m->block[i];
        if (!translucent(m, block)) continue;
        for (uint32_t t = 0; t < block->n_triangle; t++) {
            const uint32_t *corner = m->triangle[block->triangle_begin + t];
            uint32_t w[3] = {m->weld[corner[0]], m->weld[corner[1]], m->weld[corner[2]]};
            if (w[0] == w[1] || w[1] == w[2] || w[2] == w[0]) {
                m->n_degenerate_triangle++;
                continue;
            }
            for (int k = 0; k < 3; k++) {
                uint64_t p = w[k], q = w[(k + 1) % 3];
                key[n++] = p < q ? p << (b + 1) | q << 1 : q << (b + 1) | p << 1 | 1;
            }
        }
    }
    const uint64_t *sorted = sort_keys(key, spare, n, 2 * b + 1);
    for (size_t i = 0, j; i < n; i = j) {
        uint32_t back = 0;
        for (j = i; j < n && sorted[j] >> 1 == sorted[i] >> 1; j++) back += sorted[j] & 1;
        found->boundary += j - i == 1;
        found->crowded += j - i > 2;
        found->flipped += j - i == 2 && back != 1;
    }
    prt_free(key);
    prt_free(spare);
    m->n_boundary_edge = found->boundary;
    m->n_nonmanifold_edge = found->crowded;
    return PRT_OK;
}

// Closed translucent objects whose enclosed volume is negative (divergence theorem).
static uint32_t inside_out(const struct prt_mesh *m)
{
    uint32_t count = 0;
    double volume = 0;
    const float *o = NULL; // the object's first vertex
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct prt_block *b = &m->block[i];
        if (!o) o = m->position[b->vertex_begin];
        for (uint32_t t = b->triangle_begin; t < b->triangle_begin + b->n_triangle; t++) {
            double e[3][3], n[3], r[3];
            if (!translucent(m, b)) break;
            triangle_cross(m, t, e, n);
            for (int c = 0; c < 3; c++) r[c] = (double)m->position[m->triangle[t][0]][c] - o[c];
            volume += dot(r, n);
        }
        bool last = i + 1 == m->n_block || m->block[i + 1].object != b->object;
        if (last) {
            count += volume < 0;
            volume = 0;
            o = NULL;
        }
    }
    return count;
}

static void warn(const struct prt_context *ctx, const char *name, const struct prt_mesh *m,
                 const struct edges *e)
{
    if (e->boundary)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: open surface: single scattering and thickness leak through %u boundary "
                "edges%s",
                name, e->boundary,
                e->boundary > 2 * (uint64_t)m->n_triangle
                    ? " (most triangles are unconnected; weld the model)"
                    : "");
    if (e->crowded)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: %u non-manifold edges: inside and outside are ambiguous there, so single "
                "scattering and thickness near them may be wrong",
                name, e->crowded);
    if (e->flipped)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: triangles on both sides of %u edges wind in opposite senses: light is "
                "blocked on faces turned inwards",
                name, e->flipped);
    if (m->n_degenerate_triangle)
        prt_log(ctx, PRT_LOG_NOTE, "%s: %u triangles without area are ignored", name,
                m->n_degenerate_triangle);
    uint32_t turned = e->boundary || e->crowded || e->flipped ? 0 : inside_out(m);
    if (turned)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: %u objects are inside out: light falls on the inner side of their faces; "
                "reverse the winding",
                name, turned);
}

int prt_mesh_finish(const struct prt_context *ctx, const char *name, struct prt_mesh *m)
{
    float box[2][3];
    struct edges e = {0};
    prt_mesh_bounds(m, box);
    if (box[0][0] == box[1][0] && box[0][1] == box[1][1] && box[0][2] == box[1][2])
        return prt_fail(ctx, PRT_FORMAT, "%s: all vertices lie at one point", name);
    int status = prt_mesh_weld(ctx, name, m);
    if (!status) status = make_normals(ctx, name, m);
    if (!status) status = count_edges(ctx, name, m, &e);
    if (!status) warn(ctx, name, m, &e);
    return status;
}
