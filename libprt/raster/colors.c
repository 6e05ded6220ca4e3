/* SPDX-License-Identifier: MIT */
/* Colours in formats for textures. */
#include "base/isa.h"
#include "prt/picture.h"

#include <string.h>

#define PRT_KERNEL_FILE "raster/colors_kernel.h"
#include "base/isa_each.h"

void prt_encode_rgb9e5(const struct prt_context *ctx, const float *rgb, size_t n, uint32_t *out)
{
    void (*encode)(const float *restrict, size_t, uint32_t *restrict) = rgb9e5_c;
#if PRT_ISA_X86
    const unsigned cpu = ctx ? ctx->cpu : prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) encode = rgb9e5_avx2;
    if (cpu & PRT_CPU_AVX512) encode = rgb9e5_avx512;
#endif
    encode(rgb, n, out);
}
