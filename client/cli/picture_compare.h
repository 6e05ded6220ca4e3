/* SPDX-License-Identifier: MIT */
/* picture_compare.h compares two pictures of the same size, sRGB bytes [height][width][3]. */
#ifndef RELIGHT_CLI_PICTURE_COMPARE_H
#define RELIGHT_CLI_PICTURE_COMPARE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

/* CIEDE2000 over all pixels, and over those that differ. */
struct picture_difference {
    double mean, median, p95, most;
    double changed;      /* share of pixels that differ, [0,1] */
    double changed_mean; /* over those; 0 without any */
    double noticeable;   /* share of pixels above 1 */
};

/* delta [height*width] gets the difference of each pixel. Returns false without memory. */
bool picture_compare(const uint8_t *a, const uint8_t *b, size_t n_pixel, float *delta,
                     struct picture_difference *out);

enum compare_layout { COMPARE_SHEET, COMPARE_SIDE, COMPARE_WIPE, COMPARE_DELTA };
/* Draws both: side by side; a wipe, whose left half is a; the differences from black (0) to
 * white (10 and above); or all of them in a sheet of two rows. The picture is free()d by the
 * caller; NULL without memory. */
uint8_t *compare_draw(enum compare_layout layout, const uint8_t *a, const uint8_t *b,
                      const float *delta, uint32_t width, uint32_t height, uint32_t *out_width,
                      uint32_t *out_height);

/* A PNG file in memory, free()d by the caller; NULL without memory. */
void *encode_png(const uint8_t *rgb, uint32_t width, uint32_t height, size_t *n);

#endif
