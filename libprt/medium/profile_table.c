// SPDX-License-Identifier: MIT
// Point tables of a profile: linear between points, integrals in closed form.
#include "profile.h"

#include <math.h>

/* The interval of the table that holds r, r[0] <= r < r[n-1]. */
static uint32_t find_interval(const struct prt_profile *p, double r)
{
    uint32_t lo = 0, hi = p->n - 1;
    while (hi - lo > 1) {
        uint32_t mid = (lo + hi) / 2;
        if (p->r[mid] <= r) lo = mid;
        else hi = mid;
    }
    return lo;
}

double prt_profile_table_rd(const struct prt_profile *p, double r)
{
    if (!p->n || r >= p->r[p->n - 1]) return 0;
    if (r <= p->r[0]) return p->rd[0];
    uint32_t i = find_interval(p, r);
    double t = (r - p->r[i]) / (p->r[i + 1] - p->r[i]);
    return p->rd[i] + t * (p->rd[i + 1] - p->rd[i]);
}

double prt_profile_table_tail(const struct prt_profile *p, double r)
{
    if (!p->n) return 0;
    /* Beyond the last point the tail falls as 1/r, the slowest fall of any profile (R_d as
     * r^-3). outside[] ends at 0 but in a multipole's table, whose last entry is that tail. */
    if (r >= p->r[p->n - 1]) return p->outside[p->n - 1] * p->r[p->n - 1] / r;
    if (r <= p->r[0]) return p->outside[0] + prt_line_integral(r, p->rd[0], p->r[0], p->rd[0]);
    uint32_t i = find_interval(p, r);
    return p->outside[i + 1] +
           prt_line_integral(r, prt_profile_table_rd(p, r), p->r[i + 1], p->rd[i + 1]);
}

int prt_profile_table_alloc(struct prt_profile *profile, uint32_t n)
{
    profile->n = n;
    profile->r = prt_calloc(n, sizeof(double));
    profile->rd = prt_calloc(n, sizeof(double));
    profile->outside = prt_calloc(n, sizeof(double));
    if (profile->r && profile->rd && profile->outside) return PRT_OK;
    prt_profile_finish(profile);
    return PRT_NOMEM;
}

void prt_profile_table_integrate(struct prt_profile *profile)
{
    const double *r = profile->r, *rd = profile->rd;
    profile->outside[profile->n - 1] = 0;
    for (uint32_t i = profile->n - 1; i-- > 0;)
        profile->outside[i] =
            profile->outside[i + 1] + prt_line_integral(r[i], rd[i], r[i + 1], rd[i + 1]);
}
