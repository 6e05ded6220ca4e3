// SPDX-License-Identifier: MIT
// The one way in which a kernel is compiled for an instruction set that the compiler's default
// flags do not include. No file needs compiler flags of its own.
//
// A kernel is written once for each instruction set, between PRT_ISA_BEGIN and PRT_ISA_END, and
// is called through a pointer that the context's CPU mask chose (enum prt_cpu in prt/base.h). A
// kernel in plain C that only needs to be compiled several times stands in a header of its own,
// which isa_each.h includes once in each of these regions; the header names its functions
// PRT_KERNEL(name).
//
//     #define PRT_KERNEL_FILE "screen/pattern_kernel.h"
//     #include "base/isa_each.h"
//
// Headers with intrinsics (immintrin.h, arm_neon.h) are included here, outside every region.
#ifndef PRT_BASE_ISA_H
#define PRT_BASE_ISA_H

#include "prt/base.h"

#if defined(__x86_64__)
#define PRT_ISA_X86 1
#include <immintrin.h>
#else
#define PRT_ISA_X86 0
#endif
#if defined(__aarch64__)
#define PRT_ISA_ARM64 1
#include <arm_neon.h>
#else
#define PRT_ISA_ARM64 0
#endif

// The compiler's names of the features behind each bit of enum prt_cpu; prt_cpu_detect tests
// the same features. NEON is part of every arm64 and needs no region.
#define PRT_ISA_AVX2 "avx2,fma,f16c"
#define PRT_ISA_AVX512 "avx2,fma,f16c,avx512f,avx512bw,avx512dq,avx512vl,prfchw"
#define PRT_ISA_VNNI "avx2,fma,f16c,avx512f,avx512bw,avx512dq,avx512vl,prfchw,avx512vnni"

#define PRT_ISA_PRAGMA(text) _Pragma(#text)
#if defined(__clang__)
#define PRT_ISA_BEGIN(isa) \
    PRT_ISA_PRAGMA(clang attribute push(__attribute__((target(isa))), apply_to = function))
#define PRT_ISA_END _Pragma("clang attribute pop")
#else
#define PRT_ISA_BEGIN(isa) _Pragma("GCC push_options") PRT_ISA_PRAGMA(GCC target(isa))
#define PRT_ISA_END _Pragma("GCC pop_options")
#endif

#define PRT_ISA_JOIN2(name, isa) name##_##isa
#define PRT_ISA_JOIN(name, isa) PRT_ISA_JOIN2(name, isa)
#define PRT_KERNEL(name) PRT_ISA_JOIN(name, PRT_ISA_NAME)

// Helpers of kernels are always inlined: a call would spill the vectors they take and return.
#define PRT_INLINE static inline __attribute__((always_inline))

#endif
