// SPDX-License-Identifier: MIT
// R_d, or a part of it, as quadratics on 32 geometric segments of q = r² + r0² (METHODS §6).
#include "base/log_grid.h"
#include "internal.h"

#include <math.h>
#include <string.h>

void prt_radial_table_fit(struct radial_table *t, profile_fn fn, const void *arg,
                          double scale_mm, double r_max_mm)
{
    // r0² is the power of two below the profile's scale squared: R_d is smooth in q under it
    int e0 = (int)floor(log2(scale_mm * scale_mm));
    double r0_sq = ldexp(1, e0), need = log2((r_max_mm * r_max_mm + r0_sq) / r0_sq);
    uint32_t per_octave = 8, octaves;
    while (per_octave > 1 && 32.0 / per_octave < need) per_octave /= 2;
    octaves = 32 / per_octave;
    t->shift = 23 - (uint32_t)__builtin_ctz(per_octave);
    t->r0_sq = (float)r0_sq;
    float q_end = (float)ldexp(r0_sq, (int)octaves);
    t->q_max = prt_bits_float(prt_float_bits(q_end) - 1);
    uint32_t first = prt_log_index((float)r0_sq, t->shift);
    for (uint32_t s = 0; s < 32; s++) {
        double a = prt_log_node(first + s, t->shift);
        double b = s == 31 ? q_end : prt_log_node(first + s + 1, t->shift);
        double node[3], value[3][3];
        for (int k = 0; k < 3; k++) {
            node[k] = (a + b) / 2 + (b - a) / 2 * cos(M_PI * (2 * k + 1) / 6);
            fn(arg, sqrt(fmax(node[k] - r0_sq, 0)), value[k]);
        }
        for (int c = 0; c < 3; c++) {
            // divided differences, expanded to powers of q
            double d01 = (value[1][c] - value[0][c]) / (node[1] - node[0]);
            double d12 = (value[2][c] - value[1][c]) / (node[2] - node[1]);
            double d2 = (d12 - d01) / (node[2] - node[0]);
            t->coef[c][0][(first + s) & 31] =
                (float)(value[0][c] - d01 * node[0] + d2 * node[0] * node[1]);
            t->coef[c][1][(first + s) & 31] = (float)(d01 - d2 * (node[0] + node[1]));
            t->coef[c][2][(first + s) & 31] = (float)d2;
        }
    }
}

void prt_radial_table_eval(const struct radial_table *t, float r_sq, float out[3])
{
    float q = min_f(r_sq + t->r0_sq, t->q_max);
    uint32_t k = prt_log_index(q, t->shift) & 31;
    for (int c = 0; c < 3; c++)
        out[c] = t->coef[c][0][k] + q * (t->coef[c][1][k] + q * t->coef[c][2][k]);
}

void prt_dipole_profile(const void *dipole3, double r_mm, double out[3])
{
    const struct prt_diffusion *d = dipole3;
    for (int c = 0; c < 3; c++) out[c] = prt_diffusion_rd(&d[c], r_mm);
}

double prt_screen_local_weight(double r_mm, double r_p_mm)
{
    // METHODS §7: the printed sign of the exponent would not be continuous
    if (r_mm <= r_p_mm) return 1 - 0.5 * exp(SPLIT_K * (r_mm - r_p_mm));
    return 0.5 * exp(-SPLIT_K * (r_mm - r_p_mm));
}

// The function of a table: R_d, its local or its global part, averaged over a disc.
struct split {
    const struct prt_diffusion *dipole; // [3]
    double r_p;                         // < 0: no split
    bool local;
    double own_mm;  // > 0, without r_p: radius of the near-field control variate
    double disc_mm; // radius; 0: a point
};

// Weight of the near-field control variate at r.
static double own_weight(double r_mm, double own_mm)
{
    return exp(-(r_mm / own_mm) * (r_mm / own_mm));
}

static void split_profile(const void *arg, double r_mm, double out[3])
{
    enum { RINGS = 3, SPOKES = 5 };
    const struct split *s = arg;
    // a disc under 5 % of the distance counts as a point
    int rings = s->disc_mm > 0.05 * r_mm ? RINGS : 0, n = rings ? rings * SPOKES : 1;
    for (int c = 0; c < 3; c++) out[c] = 0;
    for (int k = 0; k < n; k++) {
        double r = r_mm;
        if (rings) {
            double a = s->disc_mm * sqrt((k / SPOKES + 0.5) / RINGS);
            double phi =
                M_PI * (k % SPOKES + 0.5) / SPOKES; // by symmetry half of the circle is enough
            r = sqrt(fmax(r * r + a * a - 2 * r * a * cos(phi), 0));
        }
        double w = 1;
        if (s->r_p >= 0) {
            w = prt_screen_local_weight(r, s->r_p);
            if (!s->local) w = 1 - w;
        } else if (s->own_mm > 0) {
            w = own_weight(r, s->own_mm);
            if (!s->local) w = 1 - w;
        }
        double rd[3];
        prt_dipole_profile(s->dipole, r, rd);
        for (int c = 0; c < 3; c++) out[c] += w * rd[c] / n;
    }
}

static double finest_scale(const struct prt_diffusion *d)
{
    return fmin(d[0].z_r, fmin(d[1].z_r, d[2].z_r));
}

void prt_split_table(const struct frame *f, uint32_t object, double r_p, double own_mm,
                     bool local, double disc_mm, float r_max, struct radial_table *out)
{
    struct split split = {f->dipole[object], r_p, local, own_mm, disc_mm};
    prt_radial_table_fit(out, split_profile, &split,
                         fmax(finest_scale(f->dipole[object]), disc_mm), (double)r_max);
}

void prt_near_share(const struct frame *f, uint32_t object, double own_mm, double share[3])
{
    enum { STEPS = 256 };
    struct split split = {f->dipole[object], -1, true, own_mm, 0};
    // midpoints at equal steps of log r; the weight is 1e-7 at 4 own_mm
    double top = 4 * own_mm,
           ratio = 4 * own_mm / (1e-3 * fmin(own_mm, finest_scale(f->dipole[object])));
    for (int c = 0; c < 3; c++) share[c] = 0;
    for (int k = 0; k < STEPS; k++) {
        double r = top * pow(ratio, -(k + 0.5) / STEPS), value[3];
        split_profile(&split, r, value);
        for (int c = 0; c < 3; c++)
            share[c] += 2 * M_PI * r * r * value[c] * log(ratio) / STEPS;
    }
}
