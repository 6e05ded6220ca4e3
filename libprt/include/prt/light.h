/* SPDX-License-Identifier: MIT */
/* prt/light.h owns environments: decoding, cubemaps, the Haar light vector, image files. */
#ifndef PRT_LIGHT_H
#define PRT_LIGHT_H

#include "prt/base.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { PRT_CUBE_MIN = 4, PRT_CUBE_MAX = 2048 };

/* Pixels [height][width][3], linear RGB radiance, row 0 on top. */
struct prt_image {
    uint32_t width, height;
    float *rgb;
};
void prt_image_finish(struct prt_image *image);

/* Radiance of texels: texel[((face*n + y)*n + x)*3 + c], linear RGB, average over the texel.
 * Faces +X -X +Y -Y +Z -Z with OpenGL's face axes:
 * with s = 2(x+.5)/n-1, t = 2(y+.5)/n-1 the direction is
 * +X (1,-t,-s)  -X (-1,-t,s)  +Y (s,1,t)  -Y (s,-1,-t)  +Z (s,-t,1)  -Z (-s,-t,-1). */
struct prt_cube {
    uint32_t n;
    float *texel;
};
int prt_cube_init(struct prt_cube *cube, uint32_t n); /* zeroed */
void prt_cube_finish(struct prt_cube *cube);

/* Unit direction through face coordinates (s,t) in [-1,1]. */
void prt_cube_direction(unsigned face, double s, double t, float dir[3]);
/* Face and (s,t) hit by a direction (need not be unit). */
void prt_cube_lookup(const float dir[3], unsigned *face, float *s, float *t);
/* Exact solid angle of texel (x,y) on any face of an n x n cube [sr]; all sum to 4 pi. */
double prt_cube_solid_angle(uint32_t n, uint32_t x, uint32_t y);
/* [n*n] solid angles of one face. */
void prt_cube_solid_angles(uint32_t n, float *out);

/* A decoded environment, lat-long or cube, sanitised: finite, non-negative radiance. */
enum prt_env_kind { PRT_ENV_LATLONG, PRT_ENV_CUBE };
struct prt_env {
    enum prt_env_kind kind;
    struct prt_image latlong; /* project convention: centre -Z, +X right, row 0 up */
    struct prt_cube cube;
    uint32_t n_negative, n_nonfinite; /* pixels that were mended */
    struct prt_env_cache *cache;      /* private; NULL in an environment made by hand */
};
/* .hdr .exr .png .jpg .dds …; lat-long, crosses, strips, envmap EXR; a folder or a pattern
 * (DIR/sky_*.png or DIR/sky_%s.png) of six faces named posx.., px.., right.. (front is -Z).
 * PNG/JPEG are linearised from sRGB. Decoding runs in a child process. The words "constant" and
 * "constant:R,G,B" name a uniform environment. */
int prt_env_load(const struct prt_context *ctx, const char *path, struct prt_env **out);
int prt_env_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                        size_t n, struct prt_env **out);
void prt_env_destroy(struct prt_env *env);
/* What a loaded cube keeps, for one made by hand: the lat-long it is turned from, made at its
 * first turn (100 ms for a cube of 256) instead of at each; 384 n^2 bytes. PRT_NOMEM at worst.
 * Destroy it when nobody uses env any more. */
int prt_env_cache_create(struct prt_env *env);
void prt_env_cache_destroy(struct prt_env *env);

/* Power-conserving resample to an n-cube: sum radiance*solid angle equals the source's integral
 * to 0.1 %. rotate_deg turns the light counter-clockwise about +y seen from above. n need not
 * be a power of two. Thread-safe; uses ctx->pool. */
int prt_env_to_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                    double rotate_deg, struct prt_cube *out);
/* The cube size that resolves the source (power of two, 16..1024): what --cube full means. */
uint32_t prt_env_full_cube(const struct prt_env *env);
/* Cube to lat-long, also power-conserving. */
int prt_cube_to_latlong(const struct prt_context *ctx, const struct prt_cube *cube,
                        uint32_t width, uint32_t height, struct prt_image *out);

/* Orthonormal non-standard 2-D Haar of one n x n plane, in place, n a power of two. Layout:
 * coefficient (x,y) of the classical nested (Mallat) arrangement; [0] is the scaling one. */
void prt_haar_forward(uint32_t n, float *plane);
void prt_haar_inverse(uint32_t n, float *plane);

/* The light as kernels take it: Haar coefficients of the cube, RGB + one pad.
 * coef[(face*n*n + y*n + x)*4 + c]. */
struct prt_light {
    uint32_t n;  /* cube size */
    float *coef; /* [6*n*n][4], 64-byte aligned */
};
int prt_light_from_cube(const struct prt_cube *cube, struct prt_light *out);
void prt_light_finish(struct prt_light *light);

/* Image files. .exr: linear half (or float); .png/.jpg get 8-bit bytes that the caller has
 * already tone-mapped. All write through a temporary file and rename. envmap_cube: the image is
 * n x 6n, six unmirrored camera views +X -X +Y -Y +Z -Z (+Y with +z up, -Y with -z up), and the
 * file carries OpenEXR's envmap attribute. Halves above 65504 are stored as 65504. */
int prt_write_exr(const struct prt_context *ctx, const char *path,
                  const struct prt_image *image, bool full_float, bool envmap_cube);
int prt_encode_exr(const struct prt_context *ctx, const struct prt_image *image,
                   bool full_float, struct prt_blob *out);
/* Radiance RGBE, a shared exponent a pixel; negative values become 0. */
int prt_encode_hdr(const struct prt_context *ctx, const struct prt_image *image,
                   struct prt_blob *out);
/* rgb8 [height][width][n_channel 3|4]; PNG at a fast zlib level, JPEG quality 1..100. */
int prt_encode_png(const struct prt_context *ctx, const uint8_t *pixels, uint32_t width,
                   uint32_t height, unsigned n_channel, struct prt_blob *out);
int prt_encode_jpeg(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                    uint32_t height, int quality, struct prt_blob *out);

/* Reads any image for comparison or viewing as linear RGB (child process, as prt_env_load). */
int prt_image_load(const struct prt_context *ctx, const char *path, struct prt_image *out);
int prt_image_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                          size_t n, struct prt_image *out);

#ifdef __cplusplus
}
#endif
#endif
