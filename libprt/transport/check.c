// SPDX-License-Identifier: MIT
// Checks a transport's structure, so that kernels and other rooms need not check what they
// index.
#include "format.h"

#include "prt/eta_nodes.h"
#include "prt/radial.h"
#include "prt/walk_grid.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

struct check {
    const struct prt_context *ctx;
    const char *name;
    const struct prt_transport *t;
};

__attribute__((format(printf, 2, 3))) static int bad(const struct check *c, const char *fmt,
                                                     ...)
{
    char line[256];
    va_list args;
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    return prt_fail(c->ctx, PRT_FORMAT, "%s: %s", c->name, line);
}

static bool finite_f32(const void *p, uint64_t n)
{
    const uint32_t *u = p;
    uint32_t found = 0;
    for (uint64_t i = 0; i < n; i++) found |= (u[i] & 0x7f800000) == 0x7f800000;
    return !found;
}

static bool finite_f16(const uint16_t *h, uint64_t n)
{
    uint16_t found = 0;
    for (uint64_t i = 0; i < n; i++) found |= (h[i] & 0x7c00) == 0x7c00;
    return !found;
}

// Whether no magnitude exceeds `most`.
static bool within(const int16_t *x, uint64_t n, int most)
{
    uint16_t found = 0;
    for (uint64_t i = 0; i < n; i++) found |= x[i] > most || x[i] < -most;
    return !found;
}

static bool below(const uint32_t *u, uint64_t n, uint32_t limit)
{
    uint32_t found = 0;
    for (uint64_t i = 0; i < n; i++) found |= u[i] >= limit;
    return !found;
}

static bool in_unit(float x)
{
    return x >= 0 && x <= 1;
}

static int check_surfaces(const struct check *c, const struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_surface; i++) {
        const struct prt_surface *s = &m->surface[i];
        bool good = memchr(s->name, 0, sizeof s->name) && s->translucent <= 1 &&
                    s->roughness >= 0 && s->roughness <= 1 && s->ior >= 0 && s->ior < 1e3f;
        for (int k = 0; k < 4; k++) good = good && in_unit(s->base_color[k]);
        if (!good) return bad(c, "surface %u has a value out of range", i);
    }
    for (uint32_t i = 0; m->object && i < m->n_object; i++)
        if (!memchr(m->object[i].name, 0, sizeof m->object[i].name))
            return bad(c, "the name of object %u does not end", i);
    return PRT_OK;
}

// Blocks have to partition vertices and triangles in order: every vertex and triangle has a
// block.
static int check_blocks(const struct check *c, const struct prt_mesh *m)
{
    uint32_t vertex = 0, triangle = 0;
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct prt_block *b = &m->block[i];
        if (b->object >= m->n_object || b->surface >= m->n_surface ||
            b->vertex_begin != vertex || b->n_vertex > m->n_vertex - vertex ||
            b->triangle_begin != triangle || b->n_triangle > m->n_triangle - triangle)
            return bad(c, "mesh block %u is out of range", i);
        vertex += b->n_vertex;
        triangle += b->n_triangle;
    }
    if (vertex != m->n_vertex || triangle != m->n_triangle)
        return bad(c, "mesh blocks do not cover the mesh");
    return PRT_OK;
}

static int check_variants(const struct check *c, const struct prt_mesh *m)
{
    if (m->n_variant && (!m->variant || !m->variant_surface))
        return bad(c, "an array of its variants is missing");
    if (!prt_mesh_variants_ok(m) || !prt_mesh_volumes_ok(m))
        return bad(c, "its variants are damaged");
    return PRT_OK;
}

static int check_textures(const struct check *c, const struct prt_mesh *m)
{
    if (!in_unit(m->texture_split)) return bad(c, "its texture split is outside [0,1]");
    if (m->n_uv > PRT_TEXTURE_MAX_UV || (m->n_uv > 1 && !m->uv_more) ||
        (m->n_image && (!m->image || !m->texel)))
        return bad(c, "an array of its textures is missing");
    if ((m->n_uv > 1 && !finite_f32(m->uv_more, 2ull * (m->n_uv - 1) * m->n_vertex)) ||
        (m->corner_uv && !finite_f32(m->corner_uv, 6ull * m->n_triangle)) ||
        (m->color && !finite_f32(m->color, 4ull * m->n_vertex)))
        return bad(c, "a texture coordinate or vertex colour is not finite");
    for (uint64_t i = 0; m->color && i < 4ull * m->n_vertex; i++)
        if (!in_unit(m->color[0][i])) return bad(c, "a vertex colour is out of range");
    for (uint32_t i = 0; i < m->n_image; i++)
        if (!prt_texture_image_valid(&m->image[i], m->texel_bytes))
            return bad(c, "texture image %u is out of range", i);
    for (uint32_t i = 0; m->maps && i < m->n_surface; i++)
        if (!prt_surface_maps_valid(&m->maps[i], m->n_image, PRT_TEXTURE_MAX_UV))
            return bad(c, "the maps of surface %u are out of range", i);
    return PRT_OK;
}

static int check_mesh(const struct check *c)
{
    const struct prt_mesh *m = &c->t->mesh;
    int status;
    if (!m->n_vertex || !m->n_block || !m->n_object || !m->n_surface)
        return bad(c, "the mesh is empty");
    if (!m->position || !m->normal || !m->weld || !m->block || !m->surface ||
        (m->n_triangle && !m->triangle))
        return bad(c, "an array of the mesh is missing");
    if (!(m->mm_per_unit >= 0 && m->mm_per_unit < 1e12f))
        return bad(c, "the mesh's scale is %g mm a unit", (double)m->mm_per_unit);
    if (!finite_f32(m->position, 3ull * m->n_vertex) ||
        !finite_f32(m->normal, 3ull * m->n_vertex) ||
        (m->uv && !finite_f32(m->uv, 2ull * m->n_vertex)))
        return bad(c, "the mesh has coordinates that are not finite");
    if (m->n_triangle && !below(&m->triangle[0][0], 3ull * m->n_triangle, m->n_vertex))
        return bad(c, "a triangle names a vertex that does not exist");
    if (m->n_weld > m->n_vertex || !below(m->weld, m->n_vertex, m->n_weld))
        return bad(c, "the mesh's weld map is out of range");
    if ((status = check_surfaces(c, m)) || (status = check_blocks(c, m)) ||
        (status = check_variants(c, m)) || (status = check_textures(c, m)))
        return status;
    return PRT_OK;
}

static int check_order(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    uint32_t n = t->n_vertex, status = PRT_OK;
    uint64_t *seen = prt_calloc((n + 63) / 64, 8);
    if (!seen) return prt_fail(c->ctx, PRT_NOMEM, "%s: no memory to check it", c->name);
    // n distinct values below n are a permutation
    for (uint32_t k = 0; k < n && !status; k++) {
        uint32_t v = t->order[k];
        if (v >= n || (seen[v >> 6] >> (v & 63) & 1)) status = 1;
        else seen[v >> 6] |= 1ull << (v & 63);
    }
    prt_free(seen);
    return status ? bad(c, "tensor %u: the vertex order is no permutation", i) : PRT_OK;
}

static bool good_cluster(const struct prt_tensor *t, const struct prt_cluster *k,
                         uint32_t vertex)
{
    bool radial = t->storage == PRT_STORAGE_RADIAL;
    uint64_t padded = ((uint64_t)k->n_vertex + 15) & ~15ull;
    uint64_t rows = radial ? 3ull * k->rank : (k->rank + 1ull) & ~1ull; // 3 * 2^12 at most
    if (k->vertex_begin != vertex || k->n_vertex > t->n_vertex - vertex || k->rank > 4096)
        return false;
    if (radial ? k->rank && k->rank != t->n_function
               : k->row_begin > t->rows.n_row || k->rank > t->rows.n_row - k->row_begin)
        return false;
    return k->u_begin % 16 == 0 && k->u_begin <= t->u_count &&
           padded * rows <= t->u_count - k->u_begin;
}

// Whether the half row beside an odd last row of U is 0.
static bool odd_row_is_alone(const struct prt_tensor *t, const struct prt_cluster *k)
{
    const uint64_t padded = ((uint64_t)k->n_vertex + 15) & ~15ull;
    const uint16_t *last = t->u + k->u_begin + padded * (k->rank - 1ull);
    uint16_t found = 0;
    for (uint64_t v = 0; v < padded; v++) found |= last[2 * v + 1];
    return !found;
}

static int check_clusters(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    uint32_t vertex = 0;
    if (t->n_cluster && !t->cluster) return bad(c, "tensor %u: clusters are missing", i);
    if (t->u_count && !t->u) return bad(c, "tensor %u: U is missing", i);
    if (t->u_scale && (t->storage != PRT_STORAGE_RADIAL ||
                       !finite_f32(t->u_scale, 3ull * t->n_cluster * t->n_function)))
        return bad(c, "tensor %u: factors of U that are not finite, or that it has none of", i);
    for (uint32_t k = 0; k < t->n_cluster; k++) {
        if (!good_cluster(t, &t->cluster[k], vertex))
            return bad(c, "tensor %u: cluster %u is out of range", i, k);
        vertex += t->cluster[k].n_vertex;
    }
    if (vertex != t->n_vertex)
        return bad(c, "tensor %u: clusters do not cover the vertices", i);
    if (t->storage == PRT_STORAGE_RADIAL)
        return finite_f16(t->u, t->u_count) ? PRT_OK : bad(c, "tensor %u: U is not finite", i);
    if (!within((const int16_t *)t->u, t->u_count, PRT_U_MOST))
        return bad(c, "tensor %u: U is out of range", i);
    for (uint32_t k = 0; k < t->n_cluster; k++)
        if (t->cluster[k].rank % 2 && !odd_row_is_alone(t, &t->cluster[k]))
            return bad(c, "tensor %u: cluster %u has more rows of U than its rank", i, k);
    return PRT_OK;
}

// Indices have to ascend, stay below n_coef and name no scaling coefficient (these are stored
// apart). n*n is a power of two, so the low bits of a scaling coefficient's index are 0.
#define DEFINE_GOOD_ROW(name, type)                                                 \
    static bool name(const type *index, uint64_t n, uint32_t n_coef, uint32_t face) \
    {                                                                               \
        type found = 0, low = (type)(face - 1);                                     \
        for (uint64_t i = 0; i < n; i++) found |= (type)((index[i] & low) == 0);    \
        for (uint64_t i = 1; i < n; i++) found |= (type)(index[i - 1] > index[i]);  \
        return !found && index[n - 1] < n_coef;                                     \
    }
DEFINE_GOOD_ROW(good_row16, uint16_t)
DEFINE_GOOD_ROW(good_row32, uint32_t)

static int check_entries(const struct check *c, uint32_t i, const struct prt_rows *r)
{
    uint32_t face = r->n_coef / 6;
    if (r->begin[0]) return bad(c, "tensor %u: rows do not start at entry 0", i);
    for (uint32_t k = 0; k < r->n_row; k++) {
        uint64_t b = r->begin[k], e = r->begin[k + 1];
        if (b > e || e > r->begin[r->n_row] || e - b > 2ull * r->n_coef)
            return bad(c, "tensor %u: row %u is out of range", i, k);
        if (e == b) continue;
        bool good = r->index_bytes == 2
                        ? good_row16((const uint16_t *)r->index + b, e - b, r->n_coef, face)
                        : good_row32((const uint32_t *)r->index + b, e - b, r->n_coef, face);
        if (!good) return bad(c, "tensor %u: row %u has coefficients out of order", i, k);
    }
    return PRT_OK;
}

static int check_low_rank(const struct check *c, uint32_t i, const struct prt_rows *r)
{
    uint64_t n_entry = r->begin[r->n_row], at = 0;
    if (!r->value_begin || (n_entry && !r->shift))
        return bad(c, "tensor %u: an array of low-rank rows is missing", i);
    if (r->direction[0] || r->value_begin[0])
        return bad(c, "tensor %u: low-rank rows do not start at 0", i);
    for (uint32_t k = 0; k < r->n_row; k++) {
        uint64_t n = (uint64_t)r->direction[k + 1] - r->direction[k];
        // unsigned: a product of wrong counts may wrap, but is not used
        at += n * (r->begin[k + 1] - r->begin[k]);
        if (r->direction[k + 1] < r->direction[k] || n > PRT_ROWS_MOST_DIRECTIONS ||
            r->value_begin[k + 1] != at)
            return bad(c, "tensor %u: row %u's directions are out of range", i, k);
    }
    uint64_t n = r->direction[r->n_row];
    if (n && (!r->scale || !r->mix)) return bad(c, "tensor %u: directions are missing", i);
    uint8_t most = 0;
    for (uint64_t e = 0; e < n_entry; e++) most = most > r->shift[e] ? most : r->shift[e];
    if (most > 63) return bad(c, "tensor %u: an entry is shifted by %u, at most 63", i, most);
    if (!finite_f32(r->scale, n) || !finite_f16(r->mix, n * r->n_function))
        return bad(c, "tensor %u: directions have values that are not finite", i);
    return PRT_OK;
}

static int check_pairs(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    const struct prt_rows *r = &t->rows;
    if (t->storage != PRT_STORAGE_FACTORED)
        return bad(c, "tensor %u: rows of pairs in storage %u, which has none", i, t->storage);
    if (t->coupling != PRT_COUPLE_DIAGONAL || r->n_function != 3 || r->index_bytes != 2)
        return bad(c, "tensor %u: rows of pairs with %u functions, or indices of another size",
                   i, r->n_function);
    for (uint32_t row = 0; row < r->n_row; row++)
        if (r->begin[row + 1] % 2) return bad(c, "tensor %u: row %u has half a pair", i, row);
    return PRT_OK;
}

static int check_rows(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    const struct prt_rows *r = &t->rows;
    uint32_t n = c->t->cube;
    if (t->storage == PRT_STORAGE_RADIAL) {
        if (r->n_row) return bad(c, "tensor %u: radial storage has no rows", i);
        return PRT_OK;
    }
    if (n < 2 || n > 1024 || (n & (n - 1)) || r->n_coef != 6 * n * n)
        return bad(c, "tensor %u: %u coefficients for a cube of %u", i, r->n_coef, n);
    if (r->n_row && (!r->begin || !r->scaling)) return bad(c, "tensor %u: rows are missing", i);
    if (t->storage == PRT_STORAGE_SPARSE && r->n_row != t->n_vertex)
        return bad(c, "tensor %u: %u rows for %u vertices", i, r->n_row, t->n_vertex);
    if (r->value > PRT_VALUE_PAIR || r->n_function != t->n_function ||
        r->index_bytes != (r->n_coef > 65536 ? 4 : 2))
        return bad(c, "tensor %u: unknown kind of rows", i);
    if (!r->n_row) return PRT_OK;
    uint64_t n_entry = r->begin[r->n_row], n_scale = (uint64_t)r->n_row * r->n_function;
    if ((n_entry && (!r->index || !r->entry)) || (r->value != PRT_VALUE_F16 && !r->scale))
        return bad(c, "tensor %u: entries are missing", i);
    int status = check_entries(c, i, r);
    if (status) return status;
    bool mixed = r->value == PRT_VALUE_I8 && t->coupling == PRT_COUPLE_FULL;
    if (mixed != (r->direction != NULL))
        return bad(c, "tensor %u: directions of functions are missing or too many", i);
    if (mixed && (status = check_low_rank(c, i, r))) return status;
    if (r->value == PRT_VALUE_PAIR && (status = check_pairs(c, i, t))) return status;
    if ((r->value == PRT_VALUE_F16 && !finite_f16(r->entry, n_entry * r->n_function)) ||
        (r->value != PRT_VALUE_F16 && !mixed && !finite_f32(r->scale, n_scale)) ||
        !finite_f16(r->scaling, 6 * n_scale))
        return bad(c, "tensor %u: rows have values that are not finite", i);
    return PRT_OK;
}

uint32_t prt_tensor_basis_width(const struct prt_tensor *t)
{
    struct prt_walk_grid grid;
    if (t->basis_kind != PRT_RADIAL_WALK) return t->n_knot;
    return prt_walk_grid_from_axes(t->n_knot, t->knot, &grid) ? 0 : grid.n_level * grid.n_node;
}

bool prt_transport_any_eta(const struct prt_transport *transport, float range[2])
{
    float low = 1, high = 3;
    bool any = false;
    for (uint32_t i = 0; i < transport->n_tensor; i++) {
        const struct prt_tensor *t = &transport->tensor[i];
        if (!t->n_knot) continue; // no material multiplies it
        if (!t->n_eta) return false;
        low = fmaxf(low, t->eta[0]), high = fminf(high, t->eta[1]);
        any = true;
    }
    if (any) range[0] = low, range[1] = high;
    return any;
}

enum prt_variant_of prt_transport_variants(const struct prt_transport *transport)
{
    float range[2];
    if (transport->engine == PRT_TRANSPORT_WAVELET) return PRT_VARIANT_OF_FIXED;
    return prt_transport_any_eta(transport, range) ? PRT_VARIANT_OF_ANY_ETA
                                                   : PRT_VARIANT_OF_FREE;
}

static int check_eta(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    struct prt_eta_nodes nodes;
    if (!t->n_eta) return PRT_OK;
    if (!t->eta || !t->n_knot || t->basis_kind == PRT_RADIAL_WALK || t->term == PRT_TERM_VIEW ||
        t->storage != PRT_STORAGE_FACTORED || prt_eta_nodes_from_axis(t->n_eta, t->eta, &nodes))
        return bad(c, "tensor %u: the nodes of eta are damaged", i);
    if (t->n_radial % nodes.n)
        return bad(c, "tensor %u: %u functions for %u nodes of eta", i, t->n_radial, nodes.n);
    return PRT_OK;
}

static int check_basis(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    const int status = check_eta(c, i, t);
    if (status) return status;
    if (!t->n_knot) return PRT_OK;
    if (!t->knot || !t->basis || t->n_knot < 2 || t->n_knot > 1u << 24 || !t->n_radial)
        return bad(c, "tensor %u: the radial basis is damaged", i);
    const uint64_t width = prt_tensor_basis_width(t);
    if (!width || t->basis_kind > PRT_RADIAL_WALK)
        return bad(c, "tensor %u: a basis of an unknown kind, or without a grid", i);
    if (!finite_f32(t->knot, t->n_knot) ||
        !finite_f32(t->basis, width * prt_tensor_basis_size(t)))
        return bad(c, "tensor %u: the radial basis is not finite", i);
    if (t->basis_kind == PRT_RADIAL_WALK)
        return t->term == PRT_TERM_MULTIPLE
                   ? PRT_OK
                   : bad(c, "tensor %u: walks are of multiple scattering", i);
    for (uint32_t k = 1; k < t->n_knot; k++)
        if (!(t->knot[k - 1] < t->knot[k]))
            return bad(c, "tensor %u: the radial grid does not ascend", i);
    return PRT_OK;
}

static bool good_shape(const struct prt_tensor *t)
{
    static const uint32_t phases[] = {1, 4, 9, 16};
    bool phase = false;
    for (int i = 0; i < 4; i++) phase |= t->n_phase == phases[i];
    if (!phase || t->term > PRT_TERM_VIEW || t->storage > PRT_STORAGE_RADIAL ||
        t->coupling > PRT_COUPLE_FULL || t->n_radial > 1024)
        return false;
    if (t->storage == PRT_STORAGE_SPARSE && t->n_cluster) return false;
    if (t->coupling == PRT_COUPLE_DIAGONAL && t->storage != PRT_STORAGE_RADIAL)
        return t->n_function == 3 * t->n_phase;
    // no kernel takes sparse rows of full coupling
    return t->storage != PRT_STORAGE_SPARSE && t->n_radial &&
           t->n_function == t->n_radial * t->n_phase && t->n_function <= 4096;
}

static bool good_material(const struct prt_material *m)
{
    bool good = memchr(m->name, 0, sizeof m->name) && m->eta >= 1 && m->eta <= 3 &&
                finite_f32(&m->roughness, 1);
    for (int k = 0; k < 3; k++)
        good = good && m->sigma_s_prime[k] >= 0 && m->sigma_a[k] >= 0 &&
               finite_f32(m->sigma_s_prime, 3) && finite_f32(m->sigma_a, 3) &&
               fabsf(m->g[k]) < 1;
    if (m->profile) good = good && !prt_material_check(NULL, m);
    else good = good && !m->n_point;
    return good;
}

static int check_media(const struct check *c)
{
    const struct prt_media *media = &c->t->media;
    if (!media->n || media->n > PRT_MEDIA_MAX || !media->medium ||
        (media->n > 1 && !media->of_object))
        return bad(c, "%u media, 1 to %d are known", media->n, PRT_MEDIA_MAX);
    for (uint32_t i = 0; i < media->n; i++)
        if (!good_material(&media->medium[i])) return bad(c, "the material is damaged");
    for (uint32_t i = 0; media->of_object && i < c->t->mesh.n_object; i++)
        if (media->of_object[i] >= media->n)
            return bad(c, "object %u has a medium that does not exist", i);
    return PRT_OK;
}

// Media are chosen by cluster: with several of them, all vertices of a cluster have one object.
static int check_cluster_media(const struct check *c, uint32_t i, const struct prt_tensor *t)
{
    const struct prt_mesh *m = &c->t->mesh;
    uint32_t *block = c->t->media.n > 1 ? prt_mesh_vertex_blocks(m) : NULL;
    bool mixed = false;
    if (c->t->media.n == 1) return PRT_OK;
    if (!block) return prt_fail(c->ctx, PRT_NOMEM, "%s: no memory to check it", c->name);
    for (uint32_t k = 0; k < t->n_cluster; k++) {
        const uint32_t *vertex = t->order + t->cluster[k].vertex_begin;
        for (uint32_t v = 1; v < t->cluster[k].n_vertex; v++)
            mixed |= m->block[block[vertex[v]]].object != m->block[block[vertex[0]]].object;
    }
    prt_free(block);
    return mixed ? bad(c, "tensor %u: a cluster has vertices of two objects", i) : PRT_OK;
}

static int check_tensor(const struct check *c, uint32_t i)
{
    const struct prt_tensor *t = &c->t->tensor[i];
    int status;
    if (!good_shape(t)) return bad(c, "tensor %u: unknown kind of transport", i);
    if (t->n_vertex != c->t->mesh.n_vertex || !t->order)
        return bad(c, "tensor %u: %u vertices, the mesh has %u", i, t->n_vertex,
                   c->t->mesh.n_vertex);
    if ((status = check_order(c, i, t)) || (status = check_rows(c, i, t)) ||
        (status = check_basis(c, i, t)))
        return status;
    if (t->storage == PRT_STORAGE_SPARSE) return PRT_OK;
    status = check_clusters(c, i, t);
    return status ? status : check_cluster_media(c, i, t);
}

int prt_transport_check(const struct prt_context *ctx, const char *name,
                        const struct prt_transport *transport)
{
    const struct check c = {ctx, name, transport};
    int status = check_mesh(&c);
    if (!status) status = check_media(&c);
    if (status) return status;
    if (transport->n_tensor < 1 || transport->n_tensor > PRT_MOST_TENSORS)
        return bad(&c, "%u tensors, 1 to %d are known", transport->n_tensor, PRT_MOST_TENSORS);
    if (transport->engine > PRT_TRANSPORT_JOINT)
        return bad(&c, "unknown engine %u", transport->engine);
    for (uint32_t i = 0; i < transport->n_tensor; i++)
        if ((status = check_tensor(&c, i))) return status;
    return PRT_OK;
}

void prt_tensor_bytes(const struct prt_tensor *t, uint64_t *u_bytes, uint64_t *row_bytes)
{
    const struct prt_rows *r = &t->rows;
    uint64_t n_entry = r->n_row ? r->begin[r->n_row] : 0, j = t->n_function;
    *u_bytes = 2 * t->u_count + (t->u_scale ? 12ull * t->n_cluster * t->n_function : 0);
    *row_bytes = 0;
    if (!r->n_row) return;
    *row_bytes = 8 * (r->n_row + 1ull) + n_entry * r->index_bytes + 12 * j * r->n_row;
    if (r->direction)
        *row_bytes += n_entry + 12 * (r->n_row + 1ull) + r->value_begin[r->n_row] +
                      (4 + 2 * j) * r->direction[r->n_row];
    else if (r->value == PRT_VALUE_I8) *row_bytes += n_entry * j + 4 * j * r->n_row;
    else *row_bytes += 2 * n_entry * j + (r->scale ? 4 * j * r->n_row : 0);
}
