/* SPDX-License-Identifier: MIT */
/* color_difference.h owns the difference of displayed colours: CIE 142-2001, CIEDE2000, as
 * Sharma, Wu and Dalal 2005 write it. Includes nothing of ours. Thread-safe. */
#ifndef PRT_COLOR_DIFFERENCE_H
#define PRT_COLOR_DIFFERENCE_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* CIELAB under D65 of sRGB bytes: L in [0,100]. */
void prt_lab_from_srgb8(const uint8_t rgb[3], double lab[3]);

/* Difference of two CIELAB colours with k_L = k_C = k_H = 1; about 1 is just noticeable side by
 * side. Symmetric; 0 for equal colours. */
double prt_ciede2000(const double a[3], const double b[3]);

#ifdef __cplusplus
}
#endif
#endif
