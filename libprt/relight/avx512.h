// SPDX-License-Identifier: MIT
// Kernels for AVX-512 and for AVX-512 with VNNI that one file defines and another one's table
// names.
#ifndef PRT_RELIGHT_AVX512_H
#define PRT_RELIGHT_AVX512_H

#include "kernels.h"

#if PRT_ISA_X86
void prt_columns_avx512(const struct column_part *part, size_t n, size_t stride, float *sum);
void prt_mixed_avx512(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                      const float *light, float *out);
void prt_expand_avx512(const struct expand_job *job);
void prt_radial_avx512(const struct expand_job *job);
// prt_expand_avx512 in 16-bit integers.
void prt_expand_vnni(const struct expand_job *job);
void prt_integer_lights_fill_vnni(const struct integer_lights *q, unsigned n_light,
                                  const float *const coef[], uint32_t begin, uint32_t end);
void prt_pairs_vnni(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const struct integer_lights *lights, unsigned n_light, size_t light_pitch,
                    size_t row_pitch, float *out);
#endif
#endif
