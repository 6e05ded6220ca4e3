// SPDX-License-Identifier: MIT
// The discretised translucent surface: creation from samples and cells, checks, the kernel.
#include "trace/surface_private.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

bool prt_surface_translucent(const struct prt_mesh *mesh, const struct prt_block *block)
{
    return mesh->surface[block->surface].translucent != 0;
}

double prt_surface_area(const struct prt_mesh *mesh)
{
    double area = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (!prt_surface_translucent(mesh, block)) continue;
        for (uint32_t t = 0; t < block->n_triangle; t++)
            area += triangle_area(mesh, block->triangle_begin + t);
    }
    return area;
}

static int alloc_samples(struct prt_surface_points *s, uint32_t n)
{
    s->position = prt_alloc(n, sizeof *s->position);
    s->normal = prt_alloc(n, sizeof *s->normal);
    s->face_normal = prt_alloc(n, sizeof *s->face_normal);
    s->area = prt_calloc(n, sizeof *s->area);
    s->centre = prt_calloc(n, sizeof *s->centre);
    s->spread = prt_calloc(n, sizeof *s->spread);
    s->object = prt_alloc(n, sizeof *s->object);
    s->triangle = prt_alloc(n, sizeof *s->triangle);
    s->inside = prt_alloc(n, sizeof *s->inside);
    s->stratum = prt_alloc(n, sizeof *s->stratum);
    bool all = s->position && s->normal && s->face_normal && s->area && s->centre &&
               s->spread && s->object && s->triangle && s->inside && s->stratum;
    return all ? PRT_OK : PRT_NOMEM;
}

static double object_area(const struct prt_mesh *mesh, const struct piece_list *list)
{
    double area = 0;
    for (uint32_t i = 0; i < list->n; i++) area += triangle_area(mesh, list->triangle[i]);
    return area;
}

int prt_surface_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       uint32_t n_sample, float fine_mm, uint64_t seed,
                       struct prt_surface_points **out)
{
    struct prt_surface_points *s = calloc(1, sizeof *s);
    struct piece_list *list = calloc(mesh->n_object + 1u, sizeof *list);
    int status = s && list ? PRT_OK : PRT_NOMEM;
    if (s) {
        s->n_object = mesh->n_object;
        s->n_wanted = n_sample;
        s->object_begin = prt_calloc(mesh->n_object + 1u, sizeof *s->object_begin);
        if (!s->object_begin) status = PRT_NOMEM;
    }
    for (uint32_t o = 0; status == PRT_OK && o < mesh->n_object; o++)
        status = prt_surface_order(mesh, o, n_sample, &list[o]);
    if (status == PRT_OK) status = prt_surface_share(s, list, n_sample, seed);
    if (status == PRT_ARG)
        status = prt_fail(ctx, PRT_ARG, "nothing to sample: no translucent triangle has area");
    if (status == PRT_OK) status = alloc_samples(s, s->n_sample);
    if (status == PRT_OK && prt_mesh_has_look(mesh) &&
        !(s->tint = prt_alloc(s->n_sample, sizeof *s->tint)))
        status = PRT_NOMEM;
    for (uint32_t o = 0; status == PRT_OK && o < mesh->n_object; o++) {
        const uint32_t own = s->object_begin[o + 1] - s->object_begin[o];
        const double mm2 = own ? object_area(mesh, &list[o]) : 0;
        if (own) s->spacing = fmaxf(s->spacing, (float)sqrt(mm2 / own));
    }
    for (uint32_t o = 0; status == PRT_OK && o < mesh->n_object; o++)
        prt_surface_place(s, mesh, &list[o], o);
    if (status == PRT_OK) status = prt_surface_cells(ctx, s, mesh, list, fine_mm);
    for (uint32_t o = 0; list && o < mesh->n_object; o++) prt_surface_pieces_finish(&list[o]);
    free(list);
    if (status == PRT_OK) *out = s;
    else prt_surface_destroy(s);
    if (status == PRT_NOMEM)
        prt_fail(ctx, status, "no memory for %u surface samples", n_sample);
    return status;
}

int prt_surface_check(const struct prt_context *ctx, const struct prt_surface_points *s,
                      const struct prt_mesh *mesh, double mean_free_path_mm, bool chosen)
{
    // In mean free paths between samples: beyond `most` R_d falls to nothing between two, from
    // `many` on errors reach percents.
    static const double most = 256, many = 16;
    double paths = s->spacing / mean_free_path_mm, over = paths / most;
    double size = prt_mesh_diagonal(mesh);
    if (over > 1)
        return prt_fail(
            ctx, PRT_ARG,
            "a mean free path of %.3g mm on a model of %.5g mm, with samples %.3g mm "
            "apart: at most %.0f mean free paths are allowed; scale it to %.3g mm or "
            "less (--size-mm) or give --samples %.0f",
            mean_free_path_mm, size, s->spacing, most, size / over,
            ceil(s->n_sample * over * over));
    if (paths > many && chosen)
        prt_log(ctx, PRT_LOG_WARNING,
                "samples are %.3g mm apart, the mean free path is %.3g mm: expect errors of "
                "percents; with --samples %.0f there is one sample a mean free path",
                s->spacing, mean_free_path_mm, ceil(s->n_sample * paths * paths));
    return PRT_OK;
}

void prt_surface_destroy(struct prt_surface_points *s)
{
    if (!s) return;
    prt_free(s->position);
    prt_free(s->normal);
    prt_free(s->face_normal);
    prt_free(s->tint);
    prt_free(s->area);
    prt_free(s->centre);
    prt_free(s->spread);
    prt_free(s->object);
    prt_free(s->triangle);
    prt_free(s->inside);
    prt_free(s->stratum);
    prt_free(s->object_begin);
    prt_free(s->fine);
    prt_free(s->cell_begin);
    prt_free(s->cell_fine);
    prt_free(s->cell_weight);
    free(s);
}

void prt_surface_kernel(const struct prt_surface_points *s, const struct prt_diffusion d[3],
                        unsigned cpu, const float x[3], uint32_t i, float near_mm, float out[3])
{
    enum { CHUNK = 64 };
    float r2[CHUNK], weight[CHUNK], rd[CHUNK];
    const float *p = s->centre[i];
    float dx = p[0] - x[0], dy = p[1] - x[1], dz = p[2] - x[2];
    float d2 = dx * dx + dy * dy + dz * dz;
    if (d2 > near_mm * near_mm) {
        prt_surface_afar(d2, s->spread[i], &r2[0], &r2[1]);
        for (int c = 0; c < 3; c++) {
            prt_diffusion_rd_array(&d[c], cpu, 2, r2, rd);
            out[c] = 0.5f * (rd[0] + rd[1]) * s->area[i];
        }
        return;
    }
    out[0] = out[1] = out[2] = 0;
    for (uint64_t begin = s->cell_begin[i], end = s->cell_begin[i + 1]; begin < end;
         begin += CHUNK) {
        size_t n = end - begin < CHUNK ? (size_t)(end - begin) : CHUNK;
        for (size_t k = 0; k < n; k++) {
            const float *q = s->fine[s->cell_fine[begin + k]];
            float a = q[0] - x[0], b = q[1] - x[1], c = q[2] - x[2];
            r2[k] = a * a + b * b + c * c;
            weight[k] = s->cell_weight[begin + k];
        }
        for (int c = 0; c < 3; c++) {
            prt_diffusion_rd_array(&d[c], cpu, n, r2, rd);
            float sum = 0;
            for (size_t k = 0; k < n; k++) sum += rd[k] * weight[k];
            out[c] += sum;
        }
    }
}
