// SPDX-License-Identifier: MIT
// The inverse of sampling: from a point of the surface to the sample whose stratum it lies in.
#include "trace/surface_private.h"

#include <stdlib.h>

struct prt_surface_strata {
    const struct prt_surface_points *surface;
    double *begin;    /* [n_triangle] running area before it; < 0: not translucent */
    double *area;     /* [n_triangle] in model units */
    uint32_t *object; /* [n_triangle] */
};

static int add_object(struct prt_surface_strata *s, const struct prt_mesh *mesh,
                      uint32_t object)
{
    struct piece_list list;
    int status = prt_surface_order(mesh, object, s->surface->n_wanted, &list);
    for (uint32_t i = 0; !status && i < list.n; i++) {
        double before = i ? list.end[i - 1] : 0;
        s->begin[list.triangle[i]] = before;
        s->area[list.triangle[i]] = list.end[i] - before;
        s->object[list.triangle[i]] = object;
    }
    prt_surface_pieces_finish(&list);
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
        if (!s->begin || !s->area || !s->object) status = PRT_NOMEM;
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
    free(strata);
}

// The place of a point on the path that walk_triangle of surface_samples.c takes through the
// triangle, in [0,1): at each level the child that holds it, and its coordinates there.
static double path_place(float u, float v)
{
    double b = (double)u, c = (double)v, a = 1 - b - c, place = 0, share = 1;
    for (unsigned level = 0; level < SURFACE_LEVELS; level++) {
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
    const struct prt_surface_points *s = strata->surface;
    if (strata->begin[triangle] < 0) return UINT32_MAX;
    const uint32_t object = strata->object[triangle], first = s->object_begin[object];
    uint32_t low = first, high = s->object_begin[object + 1];
    const double at = strata->begin[triangle] + strata->area[triangle] * path_place(u, v);
    while (high - low > 1) { // the last that begins before it
        const uint32_t middle = low + (high - low) / 2;
        if (s->stratum[middle] <= at) low = middle;
        else high = middle;
    }
    return high > first ? low : UINT32_MAX;
}
