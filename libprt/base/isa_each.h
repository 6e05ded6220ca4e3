/* SPDX-License-Identifier: MIT */
// Includes the kernels of PRT_KERNEL_FILE, a path below libprt, once for plain C and once for
// each instruction set of this architecture (isa.h). The file sees PRT_ISA_NAME, the suffix of
// its functions, and PRT_ISA_LANES, the floats in a register. No include guard: a source may
// include it for several files.
#include "base/isa.h"

#define PRT_ISA_NAME c
#define PRT_ISA_LANES 4
#include PRT_KERNEL_FILE
#undef PRT_ISA_NAME
#undef PRT_ISA_LANES
#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
#define PRT_ISA_NAME avx2
#define PRT_ISA_LANES 8
#include PRT_KERNEL_FILE
#undef PRT_ISA_NAME
#undef PRT_ISA_LANES
PRT_ISA_END
PRT_ISA_BEGIN(PRT_ISA_AVX512)
#define PRT_ISA_NAME avx512
#define PRT_ISA_LANES 16
#include PRT_KERNEL_FILE
#undef PRT_ISA_NAME
#undef PRT_ISA_LANES
PRT_ISA_END
#endif
#undef PRT_KERNEL_FILE
