// SPDX-License-Identifier: MIT
// The loaded mesh: creation from arrays, bounds, scale, maps to blocks.
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

void prt_mesh_destroy(struct prt_mesh *mesh)
{
    if (!mesh) return;
    prt_free(mesh->owner);
    prt_free(mesh->parts);
    prt_free(mesh->model);
    prt_free(mesh);
}

// Copies the arrays into a mesh builder; a normal of length 0 counts as missing.
static int fill(struct prt_draft *d, uint32_t n_vertex, const float (*position)[3],
                const float (*normal)[3], uint32_t n_triangle, const uint32_t (*triangle)[3])
{
    struct prt_surface surface;
    uint32_t first, index;
    prt_surface_default(&surface, "default");
    int status = prt_draft_vertices(d, n_vertex, &first);
    if (!status) status = prt_draft_surface(d, &surface, &index);
    for (uint32_t v = 0; !status && v < n_vertex; v++) {
        for (int c = 0; c < 3; c++) {
            d->position[v][c] = position[v][c];
            if (!(fabsf(position[v][c]) <= 1e15f))
                return prt_fail(d->ctx, PRT_ARG, "%s: vertex %u is not finite", d->name, v);
        }
        double n[3] = {0}, length = 0;
        for (int c = 0; normal && c < 3; c++) {
            n[c] = normal[v][c];
            length += n[c] * n[c];
        }
        if (length > 1e-30 && length < 1e30)
            for (int c = 0; c < 3; c++) d->normal[v][c] = (float)(n[c] / sqrt(length));
    }
    for (uint32_t t = 0; !status && t < n_triangle; t++) {
        const uint32_t *i = triangle[t];
        if (i[0] >= n_vertex || i[1] >= n_vertex || i[2] >= n_vertex)
            return prt_fail(d->ctx, PRT_ARG,
                            "%s: triangle %u has an index beyond the %u vertices", d->name, t,
                            n_vertex);
        status = prt_draft_triangle(d, i[0], i[1], i[2]);
    }
    if (!status) status = prt_draft_object(d, NULL);
    return status ? status
                  : prt_draft_block(
                        d, (struct prt_block){.n_vertex = n_vertex, .n_triangle = n_triangle});
}

int prt_mesh_create(const struct prt_context *ctx, uint32_t n_vertex,
                    const float (*position)[3], const float (*normal)[3], uint32_t n_triangle,
                    const uint32_t (*triangle)[3], struct prt_mesh **out)
{
    struct prt_draft d = {.ctx = ctx,
                          .name = "mesh",
                          .max_vertices = 1u << 29,
                          .max_triangles = 1u << 29,
                          .n_uv = 1,
                          .max_bytes = UINT64_MAX};
    struct prt_blob blob = {NULL, 0};
    struct prt_mesh *mesh = NULL;
    if (!n_vertex || !n_triangle)
        return prt_fail(ctx, PRT_ARG, "a mesh needs vertices and triangles");
    int status = fill(&d, n_vertex, position, normal, n_triangle, triangle);
    if (!status) status = prt_blob_pack(&d, &blob);
    prt_draft_finish(&d);
    if (!status && (status = prt_blob_open(ctx, d.name, &blob, &mesh))) prt_free(blob.bytes);
    if (!status && (status = prt_mesh_finish(ctx, d.name, mesh))) prt_mesh_destroy(mesh);
    if (!status) *out = mesh;
    return status;
}

static void include_block(const struct prt_mesh *mesh, const struct prt_block *b,
                          float box[2][3])
{
    for (uint32_t v = b->vertex_begin; v < b->vertex_begin + b->n_vertex; v++)
        for (int c = 0; c < 3; c++) {
            const float x = mesh->position[v][c];
            box[0][c] = x < box[0][c] ? x : box[0][c]; // fminf would be a call
            box[1][c] = x > box[1][c] ? x : box[1][c];
        }
}

void prt_mesh_bounds(const struct prt_mesh *mesh, float box[2][3])
{
    bool any = false;
    for (int c = 0; c < 3; c++) box[0][c] = INFINITY, box[1][c] = -INFINITY;
    for (uint32_t i = 0; i < mesh->n_block; i++)
        any |= mesh->surface[mesh->block[i].surface].translucent && mesh->block[i].n_vertex;
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (!any || mesh->surface[mesh->block[i].surface].translucent)
            include_block(mesh, &mesh->block[i], box);
}

double prt_mesh_diagonal(const struct prt_mesh *mesh)
{
    float box[2][3];
    double sum = 0;
    prt_mesh_bounds(mesh, box);
    for (int c = 0; c < 3; c++) sum += pow((double)box[1][c] - (double)box[0][c], 2);
    return sqrt(sum);
}

int prt_mesh_scale(const struct prt_context *ctx, struct prt_mesh *mesh, double size_mm,
                   double mm_per_unit)
{
    double diagonal = prt_mesh_diagonal(mesh);
    if (mesh->mm_per_unit > 0)
        return prt_fail(ctx, PRT_ARG, "the mesh is in millimetres already");
    if (!(size_mm >= 0 && mm_per_unit >= 0)) // NaN too
        return prt_fail(ctx, PRT_ARG, "the model's size must be a positive number of mm");
    double scale = mm_per_unit > 0 ? mm_per_unit : size_mm > 0 ? size_mm / diagonal : 0;
    if (scale == 0) {
        if (!mesh->units_known)
            return prt_fail(ctx, PRT_ARG,
                            "OBJ and PLY files have no unit: give --size-mm or --mm-per-unit");
        scale = 1000;
        prt_log(ctx, PRT_LOG_NOTE, "the model is in metres, the unit of glTF: %.4g mm across",
                diagonal * scale);
    }
    if (!(diagonal * scale >= 1e-3 && diagonal * scale <= 1e6))
        return prt_fail(ctx, PRT_ARG,
                        "the model would be %.3g mm across; 0.001 to 1000000 mm are allowed",
                        diagonal * scale);
    mesh->model = prt_alloc(mesh->n_vertex, sizeof *mesh->model);
    if (!mesh->model) return PRT_NOMEM;
    memcpy(mesh->model, mesh->position, (size_t)mesh->n_vertex * sizeof *mesh->model);
    for (uint32_t v = 0; v < mesh->n_vertex; v++)
        for (int c = 0; c < 3; c++)
            mesh->position[v][c] = (float)(mesh->position[v][c] * scale);
    mesh->mm_per_unit = (float)scale;
    return PRT_OK;
}

uint32_t *prt_mesh_triangle_blocks(const struct prt_mesh *mesh)
{
    uint32_t *map = prt_alloc(mesh->n_triangle, sizeof *map);
    for (uint32_t i = 0; map && i < mesh->n_block; i++)
        for (uint32_t k = 0; k < mesh->block[i].n_triangle; k++)
            map[mesh->block[i].triangle_begin + k] = i;
    return map;
}

uint32_t prt_mesh_block_of(const struct prt_mesh *mesh, uint32_t triangle)
{
    uint32_t lo = 0, hi = mesh->n_block;
    while (hi - lo > 1) {
        uint32_t mid = lo + (hi - lo) / 2;
        if (mesh->block[mid].triangle_begin <= triangle) lo = mid;
        else hi = mid;
    }
    return lo;
}

uint32_t *prt_mesh_vertex_blocks(const struct prt_mesh *mesh)
{
    uint32_t *map = prt_alloc(mesh->n_vertex, sizeof *map);
    for (uint32_t i = 0; map && i < mesh->n_block; i++)
        for (uint32_t k = 0; k < mesh->block[i].n_vertex; k++)
            map[mesh->block[i].vertex_begin + k] = i;
    return map;
}

const char *prt_mesh_object_words(const struct prt_mesh *mesh, uint32_t object,
                                  char words[PRT_OBJECT_WORDS])
{
    const char *name = mesh->object ? mesh->object[object].name : "";
    snprintf(words, PRT_OBJECT_WORDS, "object %u%s%s", object, *name ? " " : "", name);
    return words;
}

void prt_mesh_corner_uv(const struct prt_mesh *mesh, uint32_t triangle, unsigned set,
                        float uv[3][2])
{
    const uint32_t *v = mesh->triangle[triangle];
    const float(*from)[2] = (const float(*)[2])mesh->uv;
    memset(uv, 0, 3 * sizeof *uv);
    if (!set && mesh->corner_uv) {
        memcpy(uv, mesh->corner_uv[triangle], 3 * sizeof *uv);
        return;
    }
    if (set && set < mesh->n_uv)
        from = (const float(*)[2])mesh->uv_more + (size_t)(set - 1) * mesh->n_vertex;
    else if (set) from = NULL;
    for (int k = 0; from && k < 3; k++) memcpy(uv[k], from[v[k]], sizeof uv[k]);
}

void prt_mesh_uv(const struct prt_mesh *mesh, uint32_t triangle, unsigned set, float a, float b,
                 float uv[2])
{
    float corner[3][2];
    prt_mesh_corner_uv(mesh, triangle, set, corner);
    for (int k = 0; k < 2; k++)
        uv[k] = (1 - a - b) * corner[0][k] + a * corner[1][k] + b * corner[2][k];
}

void prt_mesh_drop_textures(struct prt_mesh *mesh)
{
    mesh->n_image = 0;
    mesh->color = NULL;
    mesh->maps = NULL;
    mesh->image = NULL;
    mesh->texel = NULL;
    mesh->texel_bytes = 0;
}
