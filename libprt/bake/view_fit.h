/* SPDX-License-Identifier: MIT */
/* Directions of exit inside a body, and the fit of nine spherical harmonics to values at them
 * (METHODS §3.6). Private to the bake. */
#ifndef PRT_BAKE_VIEW_FIT_H
#define PRT_BAKE_VIEW_FIT_H

enum {
    VIEW_PLANES = 9,  /* spherical harmonics of degree 2 and less */
    VIEW_VALUES = 13, /* directions of exit; the first is the normal */
};
/* Directions from a vertex of unit normal n in a medium of index eta, inside and outward;
 * `turn`: the fraction of a circle by which they are turned about n. */
void prt_view_directions(double eta, const float n[3], double turn, float out[VIEW_VALUES][3]);
/* The harmonics' coefficients from the values at these directions: out [plane][value]. */
void prt_view_fit(const float direction[VIEW_VALUES][3], float out[VIEW_PLANES][VIEW_VALUES]);

#endif
