// SPDX-License-Identifier: MIT
// The table that carries a profile inside struct prt_material: made from any profile, checked,
// evaluated, hashed.
#include "material.h"
#include "profile.h"

#include <math.h>

enum { N_DENSE = 3072 }; /* candidate radii of closed forms; chosen, not measured: 12 a point */

/* ---- evaluation: linear between points ---- */

void prt_material_dipoles(const struct prt_material *m, struct prt_diffusion out[3])
{
    for (int c = 0; c < 3; c++) {
        prt_diffusion_init(&out[c], m->sigma_s_prime[c], m->sigma_a[c], m->eta);
        if (!m->profile) continue;
        out[c].n_point = m->n_point;
        out[c].radius = m->radius;
        out[c].reflectance = m->reflectance[c];
        out[c].rho_d = prt_material_table_tail(&out[c], 0);
    }
}

/* The last point at or before r; r >= radius[0]. Eight steps without a data-dependent branch,
 * because engines evaluate a table for each pair of points. */
static inline uint32_t find(const float *radius, uint32_t n, float r)
{
    uint32_t i = 0;
    for (uint32_t step = PRT_MATERIAL_MAX_POINT / 2; step; step /= 2)
        if (i + step < n && radius[i + step] <= r) i += step;
    return i;
}

static inline float table_at(const float *radius, const float *value, uint32_t n, float r)
{
    if (!(r > radius[0])) return value[0];
    if (r >= radius[n - 1]) return 0;
    uint32_t i = find(radius, n, r);
    return value[i] + (r - radius[i]) / (radius[i + 1] - radius[i]) * (value[i + 1] - value[i]);
}

double prt_material_table_rd(const struct prt_diffusion *d, double r_mm)
{
    return (double)table_at(d->radius, d->reflectance, d->n_point, (float)r_mm);
}

void prt_material_table_array(const struct prt_diffusion *d, size_t n, const float *r2,
                              float *out)
{
    for (size_t i = 0; i < n; i++)
        out[i] = table_at(d->radius, d->reflectance, d->n_point, sqrtf(r2[i]));
}

double prt_material_table_tail(const struct prt_diffusion *d, double r_mm)
{
    const float *r = d->radius, *f = d->reflectance;
    double sum = r_mm < (double)r[0] ? prt_line_integral(r_mm, f[0], r[0], f[0]) : 0;
    for (uint32_t i = 0; i + 1 < d->n_point; i++)
        if (r_mm <= (double)r[i]) sum += prt_line_integral(r[i], f[i], r[i + 1], f[i + 1]);
        else if (r_mm < (double)r[i + 1])
            sum += prt_line_integral(r_mm, prt_material_table_rd(d, r_mm), r[i + 1], f[i + 1]);
    return sum;
}

int prt_material_check_profile(const struct prt_context *ctx, const struct prt_material *m)
{
    const char *what = m->name[0] ? m->name : "material";
    if (!prt_profile_type(m->profile))
        return prt_fail(ctx, PRT_ARG, "%s: unknown profile kind %u, allowed range 0 to %d",
                        what, m->profile, PRT_PROFILE_N_KIND - 1);
    if (!m->profile && m->n_point)
        return prt_fail(ctx, PRT_ARG, "%s: %u profile points, but a dipole has none", what,
                        m->n_point);
    if (!m->profile) return PRT_OK;
    if (m->n_point < 2 || m->n_point > PRT_MATERIAL_MAX_POINT)
        return prt_fail(ctx, PRT_ARG, "%s: a profile of %u points, allowed range 2 to %d", what,
                        m->n_point, PRT_MATERIAL_MAX_POINT);
    for (uint32_t i = 0; i < m->n_point; i++) {
        if (!(m->radius[i] >= 0 && m->radius[i] <= 1e6f) ||
            (i && !(m->radius[i] > m->radius[i - 1])))
            return prt_fail(ctx, PRT_ARG,
                            "%s: radius %u is %g mm; radii ascend within 0 to 1000000 mm", what,
                            i, (double)m->radius[i]);
        for (int c = 0; c < 3; c++)
            if (!(m->reflectance[c][i] >= 0 && m->reflectance[c][i] <= 1e12f))
                return prt_fail(ctx, PRT_ARG, "%s: R_d %u is %g, allowed range 0 to 1e12 mm^-2",
                                what, i, (double)m->reflectance[c][i]);
    }
    struct prt_diffusion d[3];
    prt_material_dipoles(m, d);
    for (int c = 0; c < 3; c++)
        if (!(d[c].rho_d > 0 && d[c].rho_d <= 1.001))
            return prt_fail(ctx, PRT_ARG,
                            "%s: channel %d reflects %g of the light (2 pi r R_d dr), allowed "
                            "range 0 (excluded) to 1",
                            what, c, d[c].rho_d);
    return PRT_OK;
}

uint64_t prt_material_hash(const struct prt_material *m)
{
    const float core[11] = {m->sigma_s_prime[0],
                            m->sigma_s_prime[1],
                            m->sigma_s_prime[2],
                            m->sigma_a[0],
                            m->sigma_a[1],
                            m->sigma_a[2],
                            m->g[0],
                            m->g[1],
                            m->g[2],
                            m->eta,
                            m->roughness};
    uint64_t h = prt_hash64(core, sizeof core, m->profile != 0);
    if (!m->profile) return h;
    size_t bytes = m->n_point * sizeof(float);
    h = prt_hash64(m->radius, bytes, h);
    for (int c = 0; c < 3; c++) h = prt_hash64(m->reflectance[c], bytes, h);
    return h;
}

/* ---- making one ---- */

/* Candidate radii and the three profiles there. */
struct dense {
    uint32_t n;
    double *r, *f[3];
};

static int dense_create(struct dense *d, uint32_t n)
{
    d->n = n;
    d->r = prt_calloc(4 * (size_t)n, sizeof *d->r);
    for (int c = 0; d->r && c < 3; c++) d->f[c] = d->r + (size_t)(c + 1) * n;
    return d->r ? PRT_OK : PRT_NOMEM;
}

/* Radius of the table's last point: 1e-4 of the light leaves beyond it; at most 2000 mm. */
static double last_radius(const struct prt_profile *p)
{
    return fmin(prt_profile_radius(p, 1e-4), 2000);
}

static int dense_of(const struct prt_optics *o, struct dense *d)
{
    const struct prt_profile *p = o->channel;
    if (prt_profile_type(o->kind)->is_points) { /* all channels on the profile's own radii */
        int err = dense_create(d, p[0].n);
        for (uint32_t i = 0; !err && i < d->n; i++) {
            d->r[i] = p[0].r[i];
            for (int c = 0; c < 3; c++) d->f[c][i] = p[c].rd[i];
        }
        return err;
    }
    double first = INFINITY, last = 0;
    for (int c = 0; c < 3; c++) {
        first = fmin(first, 1e-4 * prt_profile_radius(&p[c], 0.5));
        last = fmax(last, last_radius(&p[c]));
    }
    int err = dense_create(d, N_DENSE);
    for (uint32_t i = 0; !err && i < d->n; i++) {
        d->r[i] = first * pow(last / first, i / (d->n - 1.0));
        for (int c = 0; c < 3; c++) d->f[c][i] = prt_profile_rd(&p[c], d->r[i]);
    }
    return err;
}

/* Chooses points that equalise the error of linear interpolation: with the weight 2 pi r /
 * rho_d their density is proportional to the cube root of weight times second derivative. */
static uint32_t choose_points(const struct prt_optics *o, const struct dense *d, uint32_t *pick)
{
    double *sum = prt_calloc(d->n, sizeof *sum);
    uint32_t found = 0;
    if (d->n <= PRT_MATERIAL_MAX_POINT || !sum) {
        for (; found < d->n && found < PRT_MATERIAL_MAX_POINT; found++) pick[found] = found;
        prt_free(sum);
        return found;
    }
    for (uint32_t i = 1; i < d->n; i++) {
        uint32_t k = i + 1 < d->n ? i : i - 1;
        double a = d->r[k] - d->r[k - 1], b = d->r[k + 1] - d->r[k], density = 0;
        for (int c = 0; c < 3; c++) {
            const double *f = d->f[c];
            double bend = 2 * ((f[k + 1] - f[k]) / b - (f[k] - f[k - 1]) / a) / (a + b);
            density += cbrt(2 * M_PI * d->r[k] * fabs(bend) / o->channel[c].total);
        }
        sum[i] = sum[i - 1] + density * (d->r[i] - d->r[i - 1]);
    }
    double whole = sum[d->n - 1];
    for (uint32_t i = 0; i < d->n; i++) /* a tenth of the points is spread evenly */
        sum[i] = (whole > 0 ? 0.9 * sum[i] / whole : 0) + 0.1 * i / (d->n - 1.0);
    for (uint32_t i = 0, k = 0; k < PRT_MATERIAL_MAX_POINT; k++) {
        double want = sum[d->n - 1] * k / (PRT_MATERIAL_MAX_POINT - 1.0);
        while (i + 1 < d->n && sum[i] < want) i++;
        if (!found || i > pick[found - 1]) pick[found++] = i;
    }
    pick[found - 1] = d->n - 1;
    prt_free(sum);
    return found;
}

/* Largest over channels of the integral |table - profile| 2 pi r dr over that of the profile.
 */
static double table_error(const struct prt_optics *o, const struct dense *d)
{
    struct prt_diffusion table[3];
    double worst = 0;
    prt_material_dipoles(&o->material, table);
    for (int c = 0; c < 3; c++) {
        double error = 0;
        for (uint32_t i = 0; i + 1 < d->n; i++) {
            double r = (d->r[i] + d->r[i + 1]) / 2, f = prt_profile_rd(&o->channel[c], r);
            error += fabs(f - prt_material_table_rd(&table[c], r)) * 2 * M_PI * r *
                     (d->r[i + 1] - d->r[i]);
        }
        worst = fmax(worst, error / o->channel[c].total);
    }
    return worst;
}

int prt_material_from_optics(const struct prt_context *ctx, const char *what,
                             struct prt_optics *o)
{
    struct prt_material *m = &o->material;
    struct dense d = {0};
    uint32_t pick[PRT_MATERIAL_MAX_POINT];
    if (dense_of(o, &d) < 0) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", what);
    m->profile = o->kind;
    uint32_t n = choose_points(o, &d, pick);
    m->n_point = 0;
    for (uint32_t i = 0; i < n; i++) { /* radii must ascend after rounding to float too */
        float r = (float)d.r[pick[i]];
        if (m->n_point && !(r > m->radius[m->n_point - 1])) continue;
        m->radius[m->n_point] = r;
        for (int c = 0; c < 3; c++) m->reflectance[c][m->n_point] = (float)d.f[c][pick[i]];
        m->n_point++;
    }
    int err = PRT_OK;
    if (m->n_point < 2)
        err =
            prt_fail(ctx, PRT_ARG,
                     "%s: the curve's radii are too close together to differ as floats", what);
    struct prt_diffusion table[3];
    if (err == PRT_OK) prt_material_dipoles(m, table);
    bool exact = prt_profile_type(o->kind)->is_points && d.n <= PRT_MATERIAL_MAX_POINT;
    for (int c = 0; err == PRT_OK && !exact && c < 3; c++) /* scaled to keep the integral */
        for (uint32_t i = 0; i < m->n_point; i++)
            m->reflectance[c][i] *= (float)(o->channel[c].total / table[c].rho_d);
    double error = err == PRT_OK && !exact ? table_error(o, &d) : 0;
    if (error > 0.005)
        prt_log(ctx, PRT_LOG_WARNING,
                "%s: the table of %d points differs from its profile by %.2g %%", what,
                PRT_MATERIAL_MAX_POINT, 100 * error);
    prt_free(d.r);
    return err < 0 ? err : prt_material_check(ctx, m);
}
