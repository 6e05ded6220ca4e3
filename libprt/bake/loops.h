/* SPDX-License-Identifier: MIT */
/* The bake's inner loops, compiled once for each instruction set (loops.c, base/isa.h). Each is
 * described in loops_kernel.h. */
#ifndef PRT_BAKE_LOOPS_H
#define PRT_BAKE_LOOPS_H

#include "bake/single.h"

#include <math.h>
#include <stddef.h>

struct bake_loops {
    uint32_t (*light_texels)(const struct directions *d, size_t at, const float n[3],
                             const float f[3], const struct fresnel_table *fresnel,
                             uint32_t open, float sum[4]);
    void (*aim)(const struct directions *d, const float *slope, const uint32_t number[16],
                struct prt_packet *packet, uint32_t texel[16], float length[16]);
    uint32_t (*refract)(const struct prt_packet *packet, const struct corners *corner,
                        float eta, const struct fresnel_table *fresnel, float far_mm,
                        struct lanes *out);
    void (*attenuate)(const struct exits *e, uint32_t n, uint32_t stride, float weakest,
                      float depth, float *out);
    void (*steps)(const float *value, uint32_t wide, float *step);
    void (*subdivide)(const struct knots *k, uint32_t n_node, uint32_t substeps,
                      float out[PATH_POINTS][PATH_TILE]);
    void (*integrate_isotropic)(const struct path *path, float sigma_t, float factor, float end,
                                float sum[PATH_TILE]);
    void (*integrate_radial)(const struct path_job *job, const struct path *path,
                             uint32_t first, uint32_t m);
    void (*expand_cells)(const float *value, const uint32_t *cell, uint32_t first, uint32_t n,
                         float *out);
    float (*largest)(const float *x, const float *sum, float limit, uint32_t n);
    float (*kept_energy)(const float *x, const float *sum, float limit, uint32_t n);
    uint32_t (*count_above)(const float *sum, float limit, const float *share, float above,
                            uint32_t n);
    float (*squared_steps)(const float *sum, float limit, const float *share, float above,
                           uint32_t n);
    void (*raise_share)(const float *x, float scale, float *share, uint32_t n);
};
/* The largest absolute value of x [n]; 0 for none. Eight at a time, without a call of fmaxf. */
static inline float largest_of(const float *x, size_t n)
{
    float lane[8] = {0};
    for (size_t k = 0; k < n; k += 8)
        for (size_t j = 0; j < (n - k < 8 ? n - k : 8); j++)
            lane[j] = fabsf(x[k + j]) > lane[j] ? fabsf(x[k + j]) : lane[j];
    for (size_t j = 1; j < 8; j++) lane[0] = lane[j] > lane[0] ? lane[j] : lane[0];
    return lane[0];
}
/* The loops for a mask of enum prt_cpu; 0: plain C. */
const struct bake_loops *prt_bake_loops(unsigned cpu);

#endif
