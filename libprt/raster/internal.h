/* SPDX-License-Identifier: MIT */
/* Shared by the files of raster/: the camera's frame, the fields of the visibility buffer. */
#ifndef RASTER_INTERNAL_H
#define RASTER_INTERNAL_H

#include "prt/raster.h"

enum { RASTER_MAX_SIZE = 4096, RASTER_MAX_SUB = 8 };

/* A camera in mm: a ray through image position (x,y) in pixels, y down, has the direction
 * forward + (2x/W - 1) right + (1 - 2y/H) up, right and up already scaled by the field. */
struct camera_frame {
    double eye[3], forward[3], right[3], up[3];
    double tan_x, tan_y;
};
/* Checks a camera and computes its frame; PRT_ARG with a message where it is degenerate. */
int prt_camera_frame_init(const struct prt_context *ctx, const struct prt_camera *camera,
                          double mm_per_unit, uint32_t width, uint32_t height,
                          struct camera_frame *out);

/* Triangle numbers of one band of rows: id[(y*width + x)*n_sub + s], UINT32_MAX for none. */
struct gl_draw {
    const struct prt_mesh *mesh;
    const struct camera_frame *frame;
    uint32_t width, height;
    unsigned n_sub;
    double z_near, z_far;                  /* depth range of the mesh before the eye, mm */
    float sub_position[RASTER_MAX_SUB][2]; /* out: sub-samples in the pixel, y down */
    /* called for each band, top to bottom; id is valid during the call */
    int (*band)(void *user, uint32_t row_begin, uint32_t row_end, const uint32_t *id);
    void *user;
};
/* Draws with a process-wide context kept for the next call; callers queue on a lock. */
int prt_gl_draw_triangles(const struct prt_context *ctx, enum prt_raster_backend backend,
                          struct gl_draw *draw);

/* Fills `unblocked` of the G-buffer where the mesh has `blocked`. */
int prt_raster_unblocked(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         struct prt_visibility *vis);
/* Fills the look of the G-buffer where the mesh has one; prt_visibility_destroy frees it. */
int prt_raster_look(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    struct prt_visibility *vis);
void prt_raster_look_finish(struct prt_gbuffer *g);

/* tone.c: a tone curve at an exposure, and n values by it. */
struct tone_curve {
    const uint8_t *table;
    const uint16_t *fine; /* of prt_tone_map_fine */
    float scale;
    /* n values in 8 bits by the fastest instructions of the context */
    void (*values)(const struct tone_curve *tone, const float *in, size_t n, uint8_t *out);
};
int prt_tone_curve(const struct prt_context *ctx, enum prt_tone tone, float exposure_ev,
                   struct tone_curve *out);

struct prt_visibility {
    struct prt_camera camera;
    struct camera_frame frame;
    uint32_t width, height;
    unsigned n_sub;
    uint32_t n_mesh_vertex, n_mesh_triangle; /* of the mesh it was drawn from */
    uint32_t n_block, *block_object;         /* [n_block] object of each block of it */
    /* covered pixels, row-major */
    uint32_t n_covered;
    uint32_t *row_covered;     /* [height+1] first covered pixel of a row */
    uint32_t *pixel;           /* [n_covered] y*width + x */
    uint32_t *sample_triangle; /* [n_covered][n_sub] */
    uint16_t (*sample_uv)[2];  /* [n_covered][n_sub] barycentrics, unorm16 */
    /* shading points: groups of a pixel's sub-samples that lie on one smooth patch */
    uint32_t *row_point; /* [height+1] */
    struct prt_gbuffer g;
};

#endif
