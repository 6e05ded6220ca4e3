/* SPDX-License-Identifier: MIT */
/* prt/surface.h owns the discretised translucent surface: area samples and their cells. */
#ifndef PRT_SURFACE_H
#define PRT_SURFACE_H

#include "prt/medium.h"
#include "prt/mesh.h"

#include <math.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Area samples x_i, where irradiance is computed, and a fine quadrature of the same surface
 * whose points belong to samples with interpolation weights (METHODS §3.1: near field).
 * Samples of one object are contiguous. Immutable after creation. */
struct prt_surface_points {
    uint32_t n_sample, n_fine, n_object;
    float (*position)[3];    /* [n_sample] mm */
    float (*normal)[3];      /* [n_sample] interpolated vertex normals, unit */
    float (*face_normal)[3]; /* [n_sample] unit */
    float *area;             /* [n_sample] mm^2 of the cell; sums to each object's area */
    float (*centre)[3];      /* [n_sample] mm, mean of the cell: where it acts from afar */
    float *spread;           /* [n_sample] mm, the cell's standard deviation along an axis */
    uint32_t *object;        /* [n_sample] */
    uint32_t *object_begin;  /* [n_object+1] first sample of each object */
    float spacing;           /* sqrt(area / n) of the coarsest object [mm] */
    float (*fine)[3];        /* [n_fine] mm, quadrature points */
    uint64_t *cell_begin;    /* [n_sample+1] into cell_fine, cell_weight */
    uint32_t *cell_fine;     /* fine points a sample's cell reaches */
    float *cell_weight;      /* interpolation weight * fine area [mm^2] */
};

/* Bytes that prt_surface_create takes with these arguments: at most while it works, and of its
 * result. Thread-safe. */
void prt_surface_memory(const struct prt_mesh *mesh, uint32_t n_sample, float fine_mm,
                        uint64_t *making, uint64_t *kept);
/* About n_sample stratified samples over translucent triangles (at least 16 an object) and fine
 * points at most fine_mm apart (bounded to 16 a sample). PRT_ARG when nothing is translucent.
 */
int prt_surface_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       uint32_t n_sample, float fine_mm, uint64_t seed,
                       struct prt_surface_points **out);
/* Whether the samples can serve a medium of this mean free path [mm]: PRT_ARG with what would
 * be allowed when they are more than 256 of it apart (R_d falls to nothing between them); a
 * warning from 16 on, when `chosen` (--samples was given). */
int prt_surface_check(const struct prt_context *ctx, const struct prt_surface_points *surface,
                      const struct prt_mesh *mesh, double mean_free_path_mm, bool chosen);
void prt_surface_destroy(struct prt_surface_points *surface);
/* Area of translucent triangles [mm^2]. */
double prt_surface_area(const struct prt_mesh *mesh);

/* The two squared distances at which the mean of a radial function stands for its mean over a
 * piece of surface, r2 away with standard deviation `spread` along an axis: across the line of
 * sight the spread adds to r2, along it it is the step to both sides. Exact to second order. */
static inline void prt_surface_afar(float r2, float spread, float *nearer, float *farther)
{
    float r = sqrtf(r2 + spread * spread);
    *nearer = (r - spread) * (r - spread);
    *farther = (r + spread) * (r + spread);
}

/* Transport kernel between point x and sample i, integral of R_d over the sample's cell [1]:
 * the mean of R_d A_i at two distances beyond near_mm, the cell's quadrature within it. Three
 * channels. */
void prt_surface_kernel(const struct prt_surface_points *surface,
                        const struct prt_diffusion d[3], unsigned cpu, const float x[3],
                        uint32_t sample, float near_mm, float out[3]);

#ifdef __cplusplus
}
#endif
#endif
