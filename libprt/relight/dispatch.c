// SPDX-License-Identifier: MIT
// Which table of kernels runs, and how lights are laid out for kernels that take several.
#include "kernels.h"

#include <math.h>
#include <string.h>

static const struct {
    unsigned needs; // bits of enum prt_cpu
    const struct prt_kernels *kernels;
} tables[] = {
#if PRT_ISA_X86
    {PRT_CPU_AVX512VNNI, &prt_kernels_vnni},
    {PRT_CPU_AVX512, &prt_kernels_avx512},
    {PRT_CPU_AVX2, &prt_kernels_avx2},
#endif
#if PRT_ISA_ARM64
    {PRT_CPU_NEON, &prt_kernels_neon},
#endif
    {PRT_CPU_C, &prt_kernels_c},
};

void prt_kernels_visit(unsigned cpu, bool (*visit)(void *user, const struct prt_kernels *k),
                       void *user)
{
    for (size_t i = 0; i < sizeof tables / sizeof *tables; i++)
        if ((cpu & tables[i].needs) == tables[i].needs && !visit(user, tables[i].kernels))
            return;
}

static bool take_first(void *user, const struct prt_kernels *k)
{
    *(const struct prt_kernels **)user = k;
    return false;
}

const struct prt_kernels *prt_kernels_for(unsigned cpu)
{
    const struct prt_kernels *best = &prt_kernels_c;
    prt_kernels_visit(cpu, take_first, &best);
    return best;
}

bool prt_relight_in_integers(unsigned cpu)
{
    return prt_kernels_for(cpu)->integers;
}

void prt_light_table_fill(unsigned n_light, const float *const coef[], uint32_t begin,
                          uint32_t end, float *table)
{
    const size_t unused = LIGHT_LANES - 3 * (size_t)n_light;
    for (uint32_t i = begin; i < end; i++) {
        float *row = table + (size_t)LIGHT_LANES * i;
        // Four floats are copied for each light, and the next light overwrites the fourth: a
        // row that is built elsewhere and read back waits for all of its partial stores.
        for (unsigned l = 0; l + 1 < n_light; l++)
            memcpy(row + 3 * l, coef[l] + 4 * (size_t)i, 16);
        memcpy(row + 3 * (n_light - 1), coef[n_light - 1] + 4 * (size_t)i, 12);
        memset(row + 3 * n_light, 0, unused * sizeof *row);
    }
}

bool prt_integer_lights_init(struct integer_lights *q, unsigned n_light, bool quads, uint32_t n,
                             const float *const coef[], const float most[][4])
{
    q->n = n;
    q->lanes = n_light == 1 ? 4 : quads && n_light <= 4 ? 16 : 32;
    for (uint32_t t = 0; t < 64; t++) q->gain[t] = t < n ? prt_pair_gain(n, t) : 1;
    memset(q->scale, 0, sizeof q->scale);
    memset(q->back, 0, sizeof q->back);
    memset(q->scaling, 0, sizeof q->scaling);
    for (unsigned l = 0; l < n_light; l++)
        for (size_t ch = 0; ch < 3; ch++) {
            if (!(most[l][ch] < 3e38f)) return false;
            if (most[l][ch] > 1e-30f) {
                q->scale[l][ch] = LIGHT_INTEGER_MOST / most[l][ch];
                q->back[l][ch] = most[l][ch] / LIGHT_INTEGER_MOST;
            }
            for (size_t f = 0; f < 6; f++) {
                q->scaling[f][l][ch] = coef[l][4 * ((size_t)n * n) * f + ch];
                if (!(fabsf(q->scaling[f][l][ch]) < 3e38f)) return false;
            }
        }
    return true;
}
