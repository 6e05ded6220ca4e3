// SPDX-License-Identifier: MIT
// Shared by the files that are compiled for AVX-512.
#ifndef PRT_RELIGHT_AVX512_H
#define PRT_RELIGHT_AVX512_H

#include "kernels.h"

#if defined(__x86_64__)
#include <immintrin.h>

#define INLINE static inline __attribute__((always_inline))

void relight_expand_avx512(const struct expand_job *job);
void relight_radial_avx512(const struct expand_job *job);
// The same as relight_expand_avx512 in 16-bit integers where there are eight triples or more.
void relight_expand_vnni(const struct expand_job *job);

#endif
#endif
