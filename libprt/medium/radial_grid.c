// SPDX-License-Identifier: MIT
// The grid of a radial basis, the members of its family, and evaluation of B_j from its table.
#include "base/isa.h"
#include "base/log_grid.h"
#include "radial.h"

#include <math.h>
#include <string.h>

void prt_radial_member_init(struct radial_member *member, enum prt_radial_family family,
                            double eta, double sigma, double sigma_a)
{
    *member = (struct radial_member){.family = family, .sigma_t = sigma};
    if (family == PRT_FAMILY_DIPOLE) prt_diffusion_init(&member->dipole, sigma, sigma_a, eta);
}

double prt_radial_member_eval(const struct radial_member *member, double r)
{
    if (member->family == PRT_FAMILY_DIPOLE) return prt_diffusion_rd(&member->dipole, r);
    return exp(-member->sigma_t * r);
}

double prt_radial_member_inside(const struct radial_member *member, double radius)
{
    if (member->family == PRT_FAMILY_DIPOLE)
        return member->dipole.rho_d - prt_diffusion_tail(&member->dipole, radius);
    return -expm1(-member->sigma_t * radius) / member->sigma_t;
}

bool prt_radial_is_plain(const struct radial *radial)
{
    return radial->pub.kind == PRT_RADIAL_X07;
}

bool prt_radial_is_spline(const struct radial *radial)
{
    return radial->pub.kind != PRT_RADIAL_REDUCED;
}

static void fill_quadrature(struct radial *radial)
{
    const bool dipole = radial->pub.family == PRT_FAMILY_DIPOLE;
    for (uint32_t q = 0; q < radial->n_quad; q++) {
        double a = radial->pub.r[q / 2], h = radial->pub.r[q / 2 + 1] - a;
        double t = q & 1 ? 0.78867513459481288 : 0.21132486540518712;
        double r = a + t * h, mu = dipole ? 2 * M_PI * r : 1; /* d mu / dr */
        radial->quad_r[q] = r;
        radial->quad_r2[q] = (float)(r * r);
        radial->measure[q] = mu * h / 2;
        radial->measure32[q] = (float)radial->measure[q];
        radial->weight[q] = (prt_radial_is_plain(radial) ? 1 : mu * mu * r) * h / 2;
    }
}

int prt_radial_grid_init(struct radial *radial, double r_lo, double radius)
{
    struct prt_radial *pub = &radial->pub;
    /* the octave that holds r_lo */
    uint32_t first = prt_float_bits((float)r_lo) >> 23 << 23 >> RADIAL_OCTAVE_SHIFT, n = 2;
    while (prt_log_node(first + n - 2, RADIAL_OCTAVE_SHIFT) < radius) n++;
    if (n > RADIAL_MAX_GRID) return PRT_LIMIT;
    pub->n_grid = n;
    radial->base = first;
    radial->n_quad = 2 * (n - 1);
    pub->r = prt_calloc(n, sizeof *pub->r);
    radial->inv_step = prt_calloc(n, sizeof(float));
    radial->quad_r2 = prt_calloc(radial->n_quad + 16, sizeof(float));
    radial->measure32 = prt_calloc(radial->n_quad, sizeof(float));
    radial->quad_r = prt_calloc(radial->n_quad, sizeof(double));
    radial->measure = prt_calloc(radial->n_quad, sizeof(double));
    radial->weight = prt_calloc(radial->n_quad, sizeof(double));
    if (!pub->r || !radial->inv_step || !radial->quad_r2 || !radial->measure32 ||
        !radial->quad_r || !radial->measure || !radial->weight)
        return PRT_NOMEM;
    for (uint32_t i = 1; i < n; i++)
        pub->r[i] = prt_log_node(first + i - 1, RADIAL_OCTAVE_SHIFT);
    for (uint32_t i = 0; i + 1 < n; i++) radial->inv_step[i] = 1 / (pub->r[i + 1] - pub->r[i]);
    fill_quadrature(radial);
    return PRT_OK;
}

static inline __attribute__((always_inline)) void
eval_body(const struct radial *radial, size_t n, const float *restrict r, float *restrict out)
{
    const uint32_t n_function = radial->pub.n_function, stride = radial->stride;
    const float r1 = radial->pub.r[1], end = radial->pub.r[radial->pub.n_grid - 1];
    for (size_t i = 0; i < n; i++, out += n_function) {
        if (!(r[i] < end)) {
            memset(out, 0, n_function * sizeof *out);
            continue;
        }
        uint32_t k =
            r[i] < r1 ? 0 : prt_log_index(r[i], RADIAL_OCTAVE_SHIFT) - radial->base + 1;
        float t = (r[i] - radial->pub.r[k]) * radial->inv_step[k];
        const float *restrict a = radial->table + (size_t)k * stride, *restrict b = a + stride;
        for (uint32_t j = 0; j < n_function; j++) out[j] = a[j] + t * (b[j] - a[j]);
    }
}

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
static void eval_avx2(const struct radial *radial, size_t n, const float *r, float *out)
{
    eval_body(radial, n, r, out);
}
PRT_ISA_END
#endif

static void eval_c(const struct radial *radial, size_t n, const float *r, float *out)
{
    eval_body(radial, n, r, out);
}

void prt_radial_eval(const struct prt_radial *radial, size_t n, const float *r, float *out)
{
    const struct radial *self = (const struct radial *)radial;
#if PRT_ISA_X86
    if (self->cpu & PRT_CPU_AVX2) {
        eval_avx2(self, n, r, out);
        return;
    }
#endif
    eval_c(self, n, r, out);
}
