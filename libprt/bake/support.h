/* SPDX-License-Identifier: MIT */
/* Transport rows that are traced at a few vertices, the supports, and interpolated at the
 * others (METHODS §3.6, §3.8). Private to the bake. */
#ifndef PRT_BAKE_SUPPORT_H
#define PRT_BAKE_SUPPORT_H

#include "bake/run.h"

/* Rows of the supports, means over the texels of a cube that may be coarser than the bake's. */
struct support {
    uint32_t n, *vertex;        /* [n] */
    uint32_t *cluster;          /* [n] of each */
    uint32_t n_function, light; /* functions of a row; the rows' cube is 6 x light x light */
    uint32_t n_texel;           /* 6 light light */
    uint16_t *row;              /* [n][n_function][n_texel] halves; a factor is in scale */
    float *scale;               /* [n] */
};
/* Texels across a face of the light that supports are traced with: the least of a bake. */
enum { SUPPORT_LIGHT = 16 };

/* Spreads at most `most` supports evenly over the vertices of translucent clusters that scatter
 * singly, and makes room for their rows; light: at most SUPPORT_LIGHT, and divides it.
 * PRT_NOMEM. */
int prt_support_create(const struct bake *b, uint32_t most, uint32_t n_function, uint32_t light,
                       struct support **out);
void prt_support_destroy(struct support *s);
/* Stores the row of support i from floats [n_function][n_texel]. Thread-safe over i. */
void prt_support_set(struct support *s, uint32_t i, const float *row);
/* Values of the supports, [s->n][n_value], at the vertices of cluster c, in its order:
 * [n_vertex][n_value]. PRT_NOMEM. Thread-safe. */
int prt_support_interpolate(const struct bake *b, const struct support *s, uint32_t c,
                            uint32_t n_value, const float *value, float *out);
/* A range over clusters: job->user, a struct support, interpolated at the clusters' vertices.
 */
int prt_support_range(void *tensor_job, size_t begin, size_t end, unsigned worker);

/* Fills the supports with single scattering along -n_o: the functions of prt_bake_single_range,
 * by fewer rays. b->single is planned. extinction: a free material; NULL: b's media. */
int prt_support_trace_axis(struct bake *b, const struct extinction_table *extinction,
                           struct support *s);
/* Fills them with nine planes of what single scattering towards an eye has above the corrected
 * planes of -n_o (METHODS §3.6). */
int prt_support_trace_view(struct bake *b, const struct extinction_table *extinction,
                           struct support *s);

#endif
