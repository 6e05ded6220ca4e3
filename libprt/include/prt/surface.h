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

/* Area samples x_i, at which irradiance is computed, and a fine quadrature of the same surface
 * whose points belong to samples with interpolation weights (METHODS §3.1: near field).
 * Samples of one object are contiguous. Immutable after creation: any number of threads may
 * read it. */
struct prt_surface_points {
    uint32_t n_sample, n_fine, n_object;
    uint32_t n_wanted;       /* samples that were asked for */
    float (*position)[3];    /* [n_sample] mm */
    float (*normal)[3];      /* [n_sample] interpolated vertex normals, unit */
    float (*face_normal)[3]; /* [n_sample] unit */
    float *tint;             /* [n_sample] factor of irradiance (prt_mesh_tint, occlusion map);
                                NULL: 1. Normal maps turn `normal` */
    float *area;             /* [n_sample] mm^2 of the cell; sums to each object's area */
    float (*centre)[3];      /* [n_sample] mm, mean of the cell: its place in the far field */
    float *spread;           /* [n_sample] mm, the cell's standard deviation along an axis */
    uint32_t *object;        /* [n_sample] */
    uint32_t *triangle;      /* [n_sample] the triangle it lies on, */
    float (*inside)[2];      /* [n_sample] at these barycentric u, v */
    double *stratum;         /* [n_sample] where its stratum begins on the sampler's path over
                                the object, in areas of model units */
    uint32_t *object_begin;  /* [n_object+1] first sample of each object */
    float spacing;           /* sqrt(area / n) of the coarsest object [mm] */
    float (*fine)[3];        /* [n_fine] mm, quadrature points */
    uint64_t *cell_begin;    /* [n_sample+1] into cell_fine, cell_weight */
    uint32_t *cell_fine;     /* fine points of a sample's cell */
    float *cell_weight;      /* interpolation weight * fine area [mm^2] */
};

/* Bytes that prt_surface_create takes with these arguments: at most while it works, and of its
 * result. Thread-safe. */
void prt_surface_memory(const struct prt_mesh *mesh, uint32_t n_sample, float fine_mm,
                        uint64_t *making, uint64_t *kept);
/* About n_sample stratified samples over the translucent triangles, at least 16 on each object,
 * and fine points at most fine_mm apart, or further where that would exceed 16 a sample. Equal
 * seeds give equal samples for any number of threads. Blocks; reports "surface" as progress.
 * PRT_ARG: nothing is translucent; PRT_LIMIT: too many points; PRT_NOMEM; PRT_CANCELLED. *out
 * is written on PRT_OK only; the caller ends it with prt_surface_destroy (NULL is allowed). */
int prt_surface_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       uint32_t n_sample, float fine_mm, uint64_t seed,
                       struct prt_surface_points **out);
/* Checks the distance of the samples against a mean free path [mm]. More than 256 of it apart
 * (R_d falls to nothing between two samples): PRT_ARG, with the size and the number of samples
 * that would be allowed. From 16 on: PRT_OK and a warning, if `chosen` (--samples was given).
 */
int prt_surface_check(const struct prt_context *ctx, const struct prt_surface_points *surface,
                      const struct prt_mesh *mesh, double mean_free_path_mm, bool chosen);
void prt_surface_destroy(struct prt_surface_points *surface);
/* Area of the translucent triangles [mm^2]. Thread-safe. */
double prt_surface_area(const struct prt_mesh *mesh);

/* Two squared distances [mm^2] such that the mean of a radial function over them approximates
 * its mean over a piece of surface at squared distance r2 with standard deviation `spread` [mm]
 * along an axis (METHODS §3.1). Across the line of sight the spread adds to r2; along it, it is
 * the step to both sides. Exact to second order. */
static inline void prt_surface_afar(float r2, float spread, float *nearer, float *farther)
{
    float r = sqrtf(r2 + spread * spread);
    *nearer = (r - spread) * (r - spread);
    *farther = (r + spread) * (r + spread);
}

/* Integral of R_d over the cell of a sample, seen from point x [mm], of three channels [1]
 * (METHODS §3.1): beyond near_mm R_d A_i as the mean over two distances, within near_mm the
 * quadrature of the cell. cpu: enum prt_cpu. Thread-safe. */
void prt_surface_kernel(const struct prt_surface_points *surface,
                        const struct prt_diffusion d[3], unsigned cpu, const float x[3],
                        uint32_t sample, float near_mm, float out[3]);

/* From points of the translucent surface to samples. The samples divide each object into
 * strata, one a sample: pieces of the path that the sampler takes over the surface, of two
 * areas, one twice the other, or what remains of a block. */
struct prt_surface_strata;
/* `surface` must be a result of prt_surface_create for this mesh, and outlive the strata.
 * PRT_NOMEM. *out is written on PRT_OK only; the caller ends it with prt_surface_strata_destroy
 * (NULL is allowed). */
int prt_surface_strata_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                              const struct prt_surface_points *surface,
                              struct prt_surface_strata **out);
void prt_surface_strata_destroy(struct prt_surface_strata *strata);
/* The sample in whose stratum the point with barycentric coordinates u, v of a triangle lies;
 * UINT32_MAX where the triangle is opaque. Thread-safe. */
uint32_t prt_surface_stratum(const struct prt_surface_strata *strata, uint32_t triangle,
                             float u, float v);

#ifdef __cplusplus
}
#endif
#endif
