/* SPDX-License-Identifier: MIT */
/* The packed format of coefficients (prt/relight.h): a u32 for r, g and b. */
#ifndef PRT_RELIGHT_PACK_TRIPLES_H
#define PRT_RELIGHT_PACK_TRIPLES_H

#include <stddef.h>
#include <stdint.h>

/* The largest magnitude of x [n]; NaN is passed over; 0 of none. cpu: a mask of enum prt_cpu.
 */
float prt_largest_magnitude(unsigned cpu, const float *x, size_t n);
/* Packs n triples rgb [n][3] times a factor, below 2^15 in magnitude, into out [n + n % 2]; the
 * last of an odd number is joined by zeros. NaN becomes the least number. The words are the
 * same for every cpu. */
void prt_pack_triples(unsigned cpu, const float *rgb, float factor, size_t n, uint32_t *out);

#endif
