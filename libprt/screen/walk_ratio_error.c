// SPDX-License-Identifier: MIT
// What the dipole costs under even light, by the points of a walk ratio (METHODS §9).
#include "walk_ratio.h"

#include <math.h>
#include <stdlib.h>

// D/W - 1 of a point by walks of two scatterings or more, all channels together.
static double excess_of(const struct ratio_point *q)
{
    double d = 0, w = 0;
    for (int c = 0; c < 3; c++) {
        d += (double)q->dipole[c];
        w += (double)q->walk[PRT_WALK_MULTIPLE][c];
    }
    return w > 0 ? d / w - 1 : 0;
}

static int ascending(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return x < y ? -1 : x > y;
}

struct sums {
    double excess2, walk2, off, most, least;
};

static void add_point(struct sums *s, const struct ratio_point *q, struct prt_dipole_error *e)
{
    const double x = excess_of(q);
    bool off = false;
    for (int c = 0; c < 3; c++) {
        const double w = (double)q->walk[PRT_WALK_MULTIPLE][c], d = (double)q->dipole[c] - w;
        s->excess2 += d * d;
        s->walk2 += w * w;
        off |= fabs(d) > 0.1 * w;
    }
    s->off += off;
    for (int k = 0; k < 3; k++) {
        if (x > s->most) e->bright_mm[k] = q->p[k];
        if (x < s->least) e->dark_mm[k] = q->p[k];
    }
    s->most = fmax(s->most, x);
    s->least = fmin(s->least, x);
}

int prt_walk_ratio_dipole_error(const struct prt_walk_ratio *r, const struct prt_media *media,
                                uint32_t medium, struct prt_dipole_error *out)
{
    struct prt_dipole_error e = {0};
    struct sums s = {.most = -INFINITY, .least = INFINITY};
    double *value = prt_alloc(r->grid.n + 1u, sizeof *value);
    if (!value) return PRT_NOMEM;
    for (uint32_t i = 0; i < r->grid.n; i++) {
        const struct ratio_point *q = &r->grid.point[i];
        if (!(q->n_group > 0) || prt_media_index(media, q->object) != medium) continue;
        value[e.n_point++] = excess_of(q);
        add_point(&s, q, &e);
    }
    if (e.n_point) {
        qsort(value, e.n_point, sizeof *value, ascending);
        e.darkest = value[e.n_point / 50];
        e.brightest = value[e.n_point - 1 - e.n_point / 50];
        e.rms = s.walk2 > 0 ? sqrt(s.excess2 / s.walk2) : 0;
        e.above_tenth = s.off / e.n_point;
    }
    prt_free(value);
    *out = e;
    return PRT_OK;
}
