// SPDX-License-Identifier: MIT
// The inverse of sampling: from a point of the surface to the sample whose stratum it lies in.
#include "trace/surface_private.h"
#include "trace/triangle.h"

#include <stdlib.h>

struct prt_surface_strata {
    const struct prt_surface_points *surface;
    double *begin;    /* [n_triangle] running area before it [mm^2]; < 0: not translucent */
    float *area;      /* [n_triangle] mm^2 */
    uint32_t *object; /* [n_triangle] */
    double *step;     /* [n_object] area of a stratum [mm^2] */
};

static int add_object(struct prt_surface_strata *s, const struct prt_mesh *mesh,
                      uint32_t object)
{
    const uint32_t *first = s->surface->object_begin;
    struct piece_list list;
    int status = prt_surface_order(mesh, object, &list);
    for (uint32_t i = 0; !status && i < list.n; i++) {
        double before = i ? list.end[i - 1] : 0;
        s->begin[list.triangle[i]] = before;
        s->area[list.triangle[i]] = (float)(list.end[i] - before);
        s->object[list.triangle[i]] = object;
    }
    uint32_t n = first[object + 1] - first[object];
    if (!status && n) s->step[object] = list.end[list.n - 1] / n;
    prt_free(list.triangle);
    prt_free(list.end);
    return status;
}

int prt_surface_strata_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                              const struct prt_surface_points *surface,
                              struct prt_surface_strata **out)
{
    struct prt_surface_strata *s = calloc(1, sizeof *s);
    int status = s ? PRT_OK : PRT_NOMEM;
    if (s) {
        s->surface = surface;
        s->begin = prt_alloc(mesh->n_triangle, sizeof *s->begin);
        s->area = prt_calloc(mesh->n_triangle, sizeof *s->area);
        s->object = prt_calloc(mesh->n_triangle, sizeof *s->object);
        s->step = prt_calloc(mesh->n_object, sizeof *s->step);
        if (!s->begin || !s->area || !s->object || !s->step) status = PRT_NOMEM;
    }
    for (uint32_t t = 0; !status && t < mesh->n_triangle; t++) s->begin[t] = -1;
    for (uint32_t o = 0; !status && o < mesh->n_object; o++) status = add_object(s, mesh, o);
    if (!status) *out = s;
    else prt_surface_strata_destroy(s);
    return status == PRT_NOMEM ? prt_fail(ctx, status, "no memory for the samples' strata")
                               : status;
}

void prt_surface_strata_destroy(struct prt_surface_strata *strata)
{
    if (!strata) return;
    prt_free(strata->begin);
    prt_free(strata->area);
    prt_free(strata->object);
    prt_free(strata->step);
    free(strata);
}

// The place of a point on the path that walk_triangle of surface_samples.c takes through the
// triangle, in [0,1): at each level the child that holds it, and its coordinates there.
static double path_place(double u, double v, unsigned levels)
{
    double a = 1 - u - v, b = u, c = v, place = 0, share = 1;
    for (unsigned level = 0; level < levels; level++) {
        double x = a, y = b, z = c;
        int child = 1;
        share /= 4;
        if (x > 0.5) child = 0, a = 2 * x - 1, b = 2 * y, c = 2 * z;
        else if (y > 0.5) child = 2, a = 2 * x, b = 2 * y - 1, c = 2 * z;
        else if (z > 0.5) child = 3, a = 2 * x, b = 2 * y, c = 2 * z - 1;
        else a = 1 - 2 * z, b = 1 - 2 * x, c = 1 - 2 * y;
        place += share * child;
    }
    return place + share / 2;
}

uint32_t prt_surface_stratum(const struct prt_surface_strata *strata, uint32_t triangle,
                             float u, float v)
{
    uint32_t object = strata->object[triangle];
    const uint32_t *first = strata->surface->object_begin;
    uint32_t n = first[object + 1] - first[object];
    double step = strata->step[object], area = strata->area[triangle];
    if (strata->begin[triangle] < 0 || !(step > 0)) return UINT32_MAX;
    unsigned levels = 0;
    // Two levels finer than the samples' pieces: a stratum's ends fall inside pieces.
    for (double piece = area; piece > step / 16 && levels < 16; piece /= 4) levels++;
    double at = strata->begin[triangle] + area * path_place((double)u, (double)v, levels);
    double i = at / step;
    return first[object] + (i < n - 1 ? (uint32_t)i : n - 1);
}
