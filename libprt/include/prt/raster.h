/* SPDX-License-Identifier: MIT */
/* prt/raster.h owns pictures: visibility buffer, shading, specular, tone map. */
#ifndef PRT_RASTER_H
#define PRT_RASTER_H

#include "prt/light.h"
#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* In the model's own units as --camera gives it; raster multiplies by mm_per_unit. */
struct prt_camera {
    float eye[3], target[3], up[3];
    float fovy_deg; /* (0,170) */
    bool automatic; /* frame the model; other fields are filled in */
};
/* "x,y,z:x,y,z:x,y,z:deg", UP and FOVY optional. */
int prt_camera_parse(const struct prt_context *ctx, const char *text, struct prt_camera *out);
/* The default camera: frames the translucent box from slightly above the front (+z side). */
void prt_camera_frame(const struct prt_mesh *mesh, float aspect, struct prt_camera *out);

/* What a camera sees of a mesh: n_sub sub-samples a pixel (1, 2, 4 or 8), each a triangle and
 * barycentrics; 1 and 4 are drawn at once, 2 and 8 one by one. Kept for as long as model,
 * camera and size stay. */
struct prt_visibility;
enum prt_raster_backend { PRT_RASTER_AUTO, PRT_RASTER_OSMESA, PRT_RASTER_EGL };
int prt_visibility_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          const struct prt_camera *camera, uint32_t width, uint32_t height,
                          unsigned n_sub, enum prt_raster_backend backend,
                          struct prt_visibility **out);
void prt_visibility_destroy(struct prt_visibility *visibility);
uint32_t prt_visibility_covered(const struct prt_visibility *visibility); /* pixels touched */
uint64_t prt_visibility_bytes(const struct prt_visibility *visibility);
/* Camera and size it was made for; sub-sample s of pixel (x,y): triangle (UINT32_MAX none) and
 * barycentrics u,v of vertices 1 and 2. */
void prt_visibility_camera(const struct prt_visibility *visibility, struct prt_camera *out,
                           uint32_t *width, uint32_t *height, unsigned *n_sub);
uint32_t prt_visibility_sample(const struct prt_visibility *visibility, uint32_t x, uint32_t y,
                               unsigned s, float uv[2]);

/* The same as points to shade: a pixel's sub-samples that lie on one smooth patch are one
 * point, standing for weight = their share of the pixel. Points are in row-major order of
 * pixels. The arrays belong to the visibility buffer. position [mm]; normal is unit and turned
 * towards the eye where the back of a face is seen; corners and weights of the triangle's
 * vertices 1 and 2 interpolate anything kept per vertex. */
struct prt_gbuffer {
    uint32_t n_point;
    uint32_t *pixel;                /* [n_point] y*width + x */
    uint32_t *triangle, *block;     /* [n_point] */
    uint32_t *corner[3];            /* [n_point] mesh vertices */
    float *bary[2];                 /* [n_point] */
    float *position[3], *normal[3]; /* [n_point] */
    float *weight;                  /* [n_point] (0,1] */
    uint8_t *opaque;                /* [n_point] 1: Lambertian receiver */
};
void prt_visibility_gbuffer(const struct prt_visibility *visibility, struct prt_gbuffer *out);

/* The eye [mm] and the frame of its rays: through (x,y) in pixels, y down, the direction is
 * forward + (2x/W - 1) right + (1 - 2y/H) up; forward is unit, right and up are as long as the
 * tangents of half the field of view. */
void prt_visibility_frame(const struct prt_visibility *visibility, float eye[3],
                          float forward[3], float right[3], float up[3]);

/* Environment pre-filtered for specular reflection: mip levels of growing roughness. */
struct prt_specular;
int prt_specular_create(const struct prt_context *ctx, const struct prt_cube *light,
                        struct prt_specular **out);
void prt_specular_destroy(struct prt_specular *specular);
/* Radiance reflected about direction r for a lobe of this roughness. */
void prt_specular_eval(const struct prt_specular *specular, const float r[3], float roughness,
                       float rgb[3]);

struct prt_shade {
    unsigned n_plane;                    /* phase planes; plane 0 is view-free */
    const float *planes;                 /* [n_plane][n_vertex][3] before outgoing Fresnel */
    float eta, roughness;                /* of the translucent material */
    bool fresnel;                        /* multiply translucent radiance by F_t(eta, w_o) */
    const struct prt_specular *specular; /* NULL: none */
    const struct prt_cube *background;   /* NULL: plain */
    float background_rgb[3];
    float background_rotate_deg; /* turns `background` counter-clockwise about +y, seen from
                                    above: a turned light needs no new background cube */
};
/* Linear radiance image [height][width][3]; pixels of opaque surfaces take plane 0 as it is. */
int prt_shade_image(const struct prt_context *ctx, const struct prt_visibility *visibility,
                    const struct prt_mesh *mesh, const struct prt_shade *shade,
                    struct prt_image *out);
/* The same compositing for an image-space engine: radiance [n_point][3] per G-buffer point,
 * before outgoing Fresnel; shade->planes is ignored. */
int prt_shade_points(const struct prt_context *ctx, const struct prt_visibility *visibility,
                     const float (*radiance)[3], const struct prt_shade *shade,
                     struct prt_image *out);

enum prt_tone { PRT_TONE_FILMIC, PRT_TONE_REINHARD, PRT_TONE_NONE };
/* exposure_ev: stops; sRGB-encoded 8-bit [height][width][3]. */
int prt_tone_map(const struct prt_context *ctx, const struct prt_image *image,
                 enum prt_tone tone, float exposure_ev, uint8_t *rgb8);

#ifdef __cplusplus
}
#endif
#endif
