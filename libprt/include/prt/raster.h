/* SPDX-License-Identifier: MIT */
/* prt/raster.h owns pictures: visibility buffer, shading, specular reflection, tone map.
 *
 * Colours are linear RGB; lengths are in mm where no other unit is named. Functions that return
 * int return PRT_OK or a negative status (prt/base.h), and report its reason to ctx->log; *out
 * is written on success only. ctx may be NULL. Functions are thread-safe: an object that was
 * created does not change until it is destroyed. Those with a context run on ctx->pool and
 * block until done. */
#ifndef PRT_RASTER_H
#define PRT_RASTER_H

#include "prt/light.h"
#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A perspective camera in the model's units, as --camera gives it; raster/ multiplies by
 * mm_per_unit. */
struct prt_camera {
    float eye[3], target[3];
    float up[3];    /* any length, not parallel to the view */
    float fovy_deg; /* (0,170) */
    bool automatic; /* frame the model; the other fields are computed */
};
/* Reads "x,y,z:x,y,z:x,y,z:deg" (eye, target, up, field of view; the last two may be missing),
 * or "auto". PRT_ARG with a message that names the part at fault. Does not block. */
int prt_camera_parse(const struct prt_context *ctx, const char *text, struct prt_camera *out);
/* The default camera: all translucent vertices (all vertices where none is translucent) seen
 * from +z, 15 degrees above the horizon. aspect: width / height. Does not block. */
void prt_camera_frame(const struct prt_mesh *mesh, float aspect, struct prt_camera *out);
/* A view about the centre of the framed vertices. Azimuth 0 and elevation 0 look along -z;
 * azimuth 90 looks along -x, elevation 90 along -y. */
struct prt_orbit {
    float azimuth_deg;   /* [-1e6, 1e6], counter-clockwise about +y seen from above */
    float elevation_deg; /* [-90, 90] */
    float zoom;          /* [0.1, 100]: magnification; 1 frames the model */
};
bool prt_orbit_ok(const struct prt_orbit *orbit);
/* Reads "AZIMUTH,ELEVATION[,ZOOM]". PRT_ARG with a message that names the ranges. */
int prt_orbit_parse(const struct prt_context *ctx, const char *text, struct prt_orbit *out);
/* The camera of an orbit, at the distance from which the whole model is seen at zoom 1. */
void prt_camera_frame_from(const struct prt_mesh *mesh, float aspect,
                           const struct prt_orbit *orbit, struct prt_camera *out);
/* The file's camera of this name, or the only one whose name begins so. PRT_ARG with a message
 * that names the nearest. */
int prt_camera_named(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const char *name, struct prt_camera *out);
/* The camera as the text that prt_camera_parse reads; 256 bytes suffice. */
void prt_camera_print(const struct prt_camera *camera, char *text, size_t size);

/* The surface that a camera sees: n_sub sub-samples a pixel, each a triangle and barycentrics
 * (MT97). Valid for one mesh, camera and size; the mesh is not read after creation. The look of
 * a textured mesh (prt_mesh_look) is filtered over each pixel at creation and kept: a new light
 * reads no texture. */
struct prt_visibility;
enum prt_raster_backend {
    PRT_RASTER_AUTO, /* OSMesa, or EGL where OSMesa is missing */
    PRT_RASTER_OSMESA,
    PRT_RASTER_EGL
};
/* The pixels of a picture. */
struct prt_raster {
    uint32_t width, height; /* [1,4096] */
    unsigned n_sub;         /* sub-samples a pixel: 1, 2, 4 or 8; 1 and 4 are one draw, 2 and 8
                             * are n_sub draws */
    enum prt_raster_backend backend;
};
/* Draws a mesh. The caller destroys *out. PRT_ARG for values out of range, PRT_LIMIT for more
 * triangles than one GL draw takes, PRT_NOMEM, PRT_UNSUPPORTED without a driver for off-screen
 * OpenGL 4.5. Callers queue on a lock for each backend. */
int prt_visibility_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          const struct prt_camera *camera, const struct prt_raster *raster,
                          struct prt_visibility **out);
/* Frees a visibility buffer; NULL is allowed. */
void prt_visibility_destroy(struct prt_visibility *visibility);
/* Number of pixels with at least one covered sub-sample. */
uint32_t prt_visibility_covered(const struct prt_visibility *visibility);
/* Memory that the buffer holds [bytes]. */
uint64_t prt_visibility_bytes(const struct prt_visibility *visibility);
/* The camera (an automatic one as computed), size and sub-samples it was created with; each
 * pointer may be NULL. */
void prt_visibility_camera(const struct prt_visibility *visibility, struct prt_camera *out,
                           uint32_t *width, uint32_t *height, unsigned *n_sub);
/* Sub-sample s of pixel (x,y): returns its triangle, UINT32_MAX for none or outside the image;
 * uv: barycentrics of the triangle's vertices 1 and 2. */
uint32_t prt_visibility_sample(const struct prt_visibility *visibility, uint32_t x, uint32_t y,
                               unsigned s, float uv[2]);

/* The same as points to shade: a pixel's sub-samples on one smooth patch are one point. Points
 * are in row-major order of pixels. Corners and barycentrics interpolate values kept per
 * vertex: (1 - bary[0] - bary[1]) of corner 0, bary[0] of corner 1, bary[1] of corner 2. */
struct prt_gbuffer {
    uint32_t n_point;
    uint32_t *pixel;            /* [n_point] y*width + x */
    uint32_t *triangle, *block; /* [n_point] of the mesh */
    uint32_t *corner[3];        /* [n_point] vertices of the mesh */
    float *bary[2];             /* [n_point] */
    float *position[3];         /* [n_point] mm */
    float *normal[3];           /* [n_point] unit, on the eye's side */
    float *weight;              /* [n_point] share of the pixel (0,1] */
    uint8_t *opaque;            /* [n_point] 1: Lambertian surface */
    float *facing;              /* [n_point] cosine of the flat triangle's normal to the eye */
    float *variance;            /* [n_point] 1 - |mean normal| over the pixel, [0,1) */
    float *unblocked; /* [n_point] share of the reflection that the model does not hide,
                         [0,1]; NULL where the mesh has no `blocked` */
    /* Look of textured meshes (prt/mesh.h); NULL for others. */
    float *base[3];     /* [n_point] factor of the radiance after scattering */
    float *turned[3];   /* [n_point] unit normal of the specular reflection */
    float *smooth;      /* [n_point] `variance` without that of the normal map */
    float *roughness;   /* [n_point] [0,1]; -1: of the medium */
    float *occlusion;   /* [n_point] (0,1] factor of the specular reflection and of opaque
                           surfaces' radiance */
    float *emission[3]; /* [n_point] radiance */
};
/* *out points into the visibility buffer, which owns the arrays. */
void prt_visibility_gbuffer(const struct prt_visibility *visibility, struct prt_gbuffer *out);

/* The eye [mm] and the frame of its rays: the ray through (x,y) in pixels, y down, has the
 * direction forward + (2x/W - 1) right + (1 - 2y/H) up; forward is unit, right and up are as
 * long as the tangents of half the field of view. */
void prt_visibility_frame(const struct prt_visibility *visibility, float eye[3],
                          float forward[3], float right[3], float up[3]);

/* An environment filtered by the GGX lobe (WMLT07) for six values of roughness. */
struct prt_specular;
/* Filters a cube; the cube is not read afterwards. The caller destroys *out. PRT_NOMEM. The
 * first call of a process also computes the filters; concurrent callers wait for it. */
int prt_specular_create(const struct prt_context *ctx, const struct prt_cube *light,
                        struct prt_specular **out);
/* Frees a filtered environment; NULL is allowed. */
void prt_specular_destroy(struct prt_specular *specular);
size_t prt_specular_bytes(void); /* that one takes */
/* Radiance reflected about direction r, of any length, by a lobe of this roughness [0,1]. */
void prt_specular_eval(const struct prt_specular *specular, const float r[3], float roughness,
                       float rgb[3]);

enum prt_tone { PRT_TONE_FILMIC, PRT_TONE_REINHARD, PRT_TONE_NONE };

enum { PRT_LOOK_BASE = 1, PRT_LOOK_NORMAL = 2, PRT_LOOK_REST = 4, PRT_LOOK_ALL = 7 };
struct prt_shade {
    unsigned n_plane;    /* phase planes: 1, 4, 9 or 16; plane 0 does not depend on the view */
    const float *planes; /* [n_plane][n_vertex][3] radiance before the exit's factor */
    struct prt_media media; /* of the objects: only eta and roughness are read. Zeroed: eta 1,
                               no reflection */
    bool fresnel; /* multiply translucent radiance by F_t(eta, w_o) over the divisor of
                   * `exit` (METHODS §1) */
    enum prt_exit exit;
    const struct prt_specular *specular; /* NULL: none */
    float specular_rotate_deg;           /* rotates it as background_rotate_deg does that */
    const struct prt_cube *background;   /* NULL: background_rgb */
    unsigned leave_out;                  /* of the look of textured meshes: PRT_LOOK_... */
    float background_rgb[3];
    bool transparent;    /* no background: the image has an alpha and premultiplied radiance */
    const float *shadow; /* [height][width][3] factor in [0,1] of the background, or NULL; of a
                            transparent one, 1 - its mean is the alpha of black */
    float background_rotate_deg; /* rotates `background` counter-clockwise about +y, seen from
                                    above, so that rotating the light needs no new cube */
    /* [height][width][3], filled in place of the image, which then has no rgb: what
     * prt_tone_map() makes of it, with this tone and exposure. NULL: an image; not with
     * `transparent`. */
    uint8_t *rgb8;
    enum prt_tone tone;
    float exposure_ev;
};
/* The linear radiance image [height][width][3] of vertex values. Opaque surfaces take plane 0
 * without Fresnel. The caller ends *out with prt_image_finish. PRT_MISMATCH for a visibility
 * buffer of another mesh, PRT_ARG for another number of planes, PRT_NOMEM. */
int prt_shade_image(const struct prt_context *ctx, const struct prt_visibility *visibility,
                    const struct prt_mesh *mesh, const struct prt_shade *shade,
                    struct prt_image *out);
/* The same of radiance [n_point][3] at the points of the G-buffer, before the exit's
 * factor (C08 eq 11); shade->planes is not read. */
int prt_shade_points(const struct prt_context *ctx, const struct prt_visibility *visibility,
                     const float (*radiance)[3], const struct prt_shade *shade,
                     struct prt_image *out);

/* Multiplies by 2^exposure_ev ([-64,64] stops), applies a tone curve (METHODS §6; RSSF02) and
 * encodes as sRGB: rgb8 [height][width][3]. PRT_ARG for values out of range. */
int prt_tone_map(const struct prt_context *ctx, const struct prt_image *image,
                 enum prt_tone tone, float exposure_ev, uint8_t *rgb8);
/* The same in 1276 levels, five for each step of 8 bits, spread over rgb16 [height][width][3]
 * in [0,65535]: a level is at most dE2000 0.2, so that a rounding difference between two
 * instruction sets cannot be seen. Rounded to 8 bits they are the values of prt_tone_map. */
int prt_tone_map_fine(const struct prt_context *ctx, const struct prt_image *image,
                      enum prt_tone tone, float exposure_ev, uint16_t *rgb16);

#ifdef __cplusplus
}
#endif
#endif
