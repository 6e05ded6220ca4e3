// SPDX-License-Identifier: MIT
// The bake's inner loops for each instruction set.
#include "bake/loops.h"

#include "base/isa.h"
#include "base/log_grid.h"

#include <math.h>
#include <string.h>

enum { ROW_LANES = 16 }; // sums and maxima kept apart, in a register; divides 6 n n, as n >= 16

// Least change of s + s' over a step: as a share of the step, and of s + s' itself, of which
// rounding must leave some digits. Only the mean over the change is used; the table is linear
// over changes of a thousandth in most places.
static const float least_slope = 1e-3f, least_ratio = 1e-3f;

#define PRT_KERNEL_FILE "bake/loops_kernel.h"
#include "base/isa_each.h"

const struct bake_loops *prt_bake_loops(unsigned cpu)
{
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512) return &loops_avx512;
    if (cpu & PRT_CPU_AVX2) return &loops_avx2;
#endif
    return &loops_c;
}
