/* SPDX-License-Identifier: MIT */
/* Shared by the files of tangent-plane sampling: tangent*.c and tangent_kernel.h. */
#ifndef SCREEN_TANGENT_H
#define SCREEN_TANGENT_H

#include "internal.h"

enum { LANES = 64, VARIANTS = 16 };

/* One of the 4x4 interleaved sets of samples. */
struct pattern {
    float *cosine, *sine;      /* [n_tangent] */
    float **radius, **density; /* [medium][n_tangent] mm, mm^-2 */
    uint32_t *uniform;         /* [n_uniform] G-buffer points */
};

/* A G-buffer point as a sample reads it; one cache line holds it. */
struct seen {
    float p[3];
    uint32_t object;
    float n[3];
    float plane; /* (p - eye).n */
    float e[3];
    float depth; /* (p - eye) along the view */
};

/* The tangent plane at one point. */
struct tangent_plane {
    const struct radial_table *table; /* of its medium */
    uint32_t object, medium;
    float rel[3], n[3], t[3], b[3]; /* point minus eye [mm]; normal and two tangents, unit */
    float height;                   /* rel.n [mm]: minus the eye's height above the plane */
    float uniform;                  /* density of uniform samples [mm^-2] times their number */
};

/* Samples side by side. */
struct tangent_lanes {
    uint32_t index[LANES];              /* G-buffer point that the sample is seen at */
    float x[LANES], y[LANES], z[LANES]; /* its point in the tangent plane minus the eye [mm] */
    float f[LANES]; /* number of tangent samples times their density [mm^-2] */
};

/* One frame of the engine. */
struct tangent_job {
    const struct seen *seen; /* [n_point] */
    const float *face[3];
    const uint8_t *needed, *variant, *medium; /* [n_point]; medium NULL: the object's */
    const uint32_t *point_of;                 /* [pixel] or UINT32_MAX */
    const struct radial_table *table;         /* [medium] */
    struct prt_diffusion (*dipole)[3];
    float (*inv_rho)[3];   /* [medium] 1 / (3 rho_d) */
    const float (*rho)[3]; /* [n_point] rho_d of the point's own medium; NULL without maps */
    uint32_t n_medium;
    struct pattern pattern[VARIANTS];
    uint32_t n_tangent, n_uniform, width, height;
    float visible_area; /* mm^2 that uniform samples are drawn from */
    float slack;        /* share of its depth by which a pixel's plane may be extended */
    float eye[3], forward[3], right[3], up[3];
    float (*radiance)[3];
    void (*run)(const struct tangent_job *job, size_t begin, size_t end);
};

/* tangent_view.c: the view's arrays, computed when the view is new and kept while it stays. */
int prt_tangent_view_get(struct frame *f, const struct tangent_job *job);
/* Two points of the view lie on one smooth patch of one object, within sqrt(reach_sq) mm. */
bool prt_tangent_alike(const struct frame *f, const struct samples *s, uint32_t i, uint32_t j,
                       float reach_sq);
/* tangent_hidden.c: adds light of the surface that the picture does not hold. */
int prt_tangent_hidden(struct frame *f, const struct tangent_job *job,
                       const struct samples *seen);
/* tangent_filter.c: runs the kernel at every point and filters its sums. */
int prt_tangent_sample(struct frame *f, struct tangent_job *job, const struct samples *seen);

#endif
