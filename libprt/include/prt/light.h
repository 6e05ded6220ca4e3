/* SPDX-License-Identifier: MIT */
/* prt/light.h owns environments: decoding, cubemaps, the Haar light vector, image files.
 *
 * All functions are thread-safe on different objects. A function that returns int returns
 * PRT_OK or a negative status, which it has logged to ctx with a line that names the file and
 * the fault; *out is written on success only, unless stated. The caller finishes or destroys
 * each *out. */
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
    float *rgb;   /* with alpha: premultiplied by it */
    float *alpha; /* [height][width] in [0,1], of a picture without background; else NULL */
};
void prt_image_finish(struct prt_image *image); /* frees rgb and alpha; NULL is allowed */

/* Radiance of texels: texel[((face*n + y)*n + x)*3 + c], linear RGB, average over the texel.
 * Faces +X -X +Y -Y +Z -Z with OpenGL's face axes:
 * with s = 2(x+.5)/n-1, t = 2(y+.5)/n-1 the direction is
 * +X (1,-t,-s)  -X (-1,-t,s)  +Y (s,1,t)  -Y (s,-1,-t)  +Z (s,-t,1)  -Z (-s,-t,-1). */
struct prt_cube {
    uint32_t n;
    float *texel;
};
/* A cube of zeros, n in 1..PRT_CUBE_MAX. PRT_ARG, PRT_NOMEM: cube->texel is NULL. */
int prt_cube_init(struct prt_cube *cube, uint32_t n);
void prt_cube_finish(struct prt_cube *cube);

/* Unit direction through face coordinates (s,t) in [-1,1]. */
void prt_cube_direction(unsigned face, double s, double t, float dir[3]);
/* Face and (s,t) hit by a direction (need not be unit). */
void prt_cube_lookup(const float dir[3], unsigned *face, float *s, float *t);
/* Exact solid angle of texel (x,y) on any face of an n x n cube [sr]; all sum to 4 pi. */
double prt_cube_solid_angle(uint32_t n, uint32_t x, uint32_t y);
/* [n*n] solid angles of one face. */
void prt_cube_solid_angles(uint32_t n, float *out);

/* A decoded environment, lat-long or cube: finite, non-negative radiance. Read-only after
 * loading, so threads may share it. */
enum prt_env_kind { PRT_ENV_LATLONG, PRT_ENV_CUBE };
struct prt_env {
    enum prt_env_kind kind;
    struct prt_image latlong; /* project convention: centre -Z, +X right, row 0 up */
    struct prt_cube cube;
    uint32_t n_negative, n_nonfinite; /* pixels whose values were replaced */
    struct prt_env_cache *cache;      /* private; NULL in an environment made by hand */
};
/* Loads an environment. `path`: a file (.hdr .pic .exr .png .jpg .dds .ktx .ktx2 …) that holds
 * a lat-long, a cross, a strip or an envmap EXR; a folder or a pattern (DIR/sky_*.png or
 * DIR/sky_%s.png) of six faces named posx.., px.., right.. (front is -Z); or the words
 * "constant" and "constant:R,G,B" for a uniform environment. PNG and JPEG are linearised from
 * sRGB. Blocks while a child process decodes, at most 10 s. PRT_IO, PRT_FORMAT (damaged, no
 * environment), PRT_LIMIT (too large), PRT_UNSUPPORTED, PRT_ARG, PRT_NOMEM; *out is NULL then.
 * prt_env_load_memory takes the file's bytes; `name` stands in messages, and its extension
 * helps to detect the format. */
int prt_env_load(const struct prt_context *ctx, const char *path, struct prt_env **out);
int prt_env_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                        size_t n, struct prt_env **out);
/* How the pictures of a cube's faces +X -X +Y -Y +Z -Z lie in the world. Seen from inside, the
 * pictures are unmirrored in all but GL. */
enum prt_faces {
    PRT_FACES_GUESS, /* by the edges that fit, then by the names; a note says how it was read */
    PRT_FACES_CAMERA, /* camera views: the front is -Z, +X is at its right */
    PRT_FACES_GL,     /* OpenGL's axes in a right-handed world: mirrored pictures */
    PRT_FACES_D3D,    /* a left-handed world: looked up with (x,y,-z) */
    PRT_FACES_THREE,  /* three.js's CubeTexture: looked up with (-x,y,z); d3d turned by 180 */
};
/* prt_env_load and prt_env_load_memory with a convention for six files, strips, crosses, DDS
 * and KTX cubes; a lat-long image has none. */
int prt_env_load_faces(const struct prt_context *ctx, const char *path, enum prt_faces faces,
                       struct prt_env **out);
int prt_env_load_memory_faces(const struct prt_context *ctx, const char *name,
                              const void *bytes, size_t n, enum prt_faces faces,
                              struct prt_env **out);
/* Reads "camera", "gl", "d3d", "three" or "guess"; false for another word. */
bool prt_faces_parse(const char *word, enum prt_faces *out);
void prt_env_destroy(struct prt_env *env);
/* Gives an environment made by hand the cache that loaded ones have. Of a cube it holds the
 * lat-long image that rotations resample, made at the first rotation (100 ms for a cube of 256)
 * and not at each: 384 n^2 bytes. Of a lat-long image it holds the reduced ones of
 * prt_env_turned(): PRT_ENV_TURNED_BYTES(n) for each n that was asked for. PRT_OK or PRT_NOMEM.
 * Destroy the cache when no thread uses env any more. */
int prt_env_cache_create(struct prt_env *env);
void prt_env_cache_destroy(struct prt_env *env);

/* Resamples to a cube of n texels a side (1..PRT_CUBE_MAX, any number) and conserves power: the
 * sum of radiance times solid angle equals the source's integral to 0.1 % (METHODS §2).
 * rotate_deg turns the light counter-clockwise about +y seen from above. Uses ctx->pool and
 * blocks. PRT_ARG, PRT_NOMEM; out->texel is NULL then. */
int prt_env_to_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                    double rotate_deg, struct prt_cube *out);
/* As prt_env_to_cube(), for a light that turns: of an environment with a cache, at n of 16, 32
 * or 64, a matrix that is made once in a process maps an image of 8 n x 4 n pixels to the cube,
 * in 0.1 ms at n = 32 instead of 4 ms. The power of a pixel that is not bright may lie up to a
 * quarter of a texel beside its place (METHODS §2). Without a cache, at other n and at a turn
 * of 0 it is prt_env_to_cube() itself. */
int prt_env_turned(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                   double rotate_deg, struct prt_cube *out);
/* The image, 16 cubes of it at whole columns, and its bright pixels. */
#define PRT_ENV_TURNED_BYTES(n) ((size_t)2176 * (n) * (n) + 24576)
/* The cube size that resolves the source: a power of two in 16..1024. Meaning of --cube full.
 */
uint32_t prt_env_full_cube(const struct prt_env *env);
/* Resamples a cube to a lat-long image of 1..16384 pixels a side; conserves power. Uses
 * ctx->pool and blocks. PRT_ARG, PRT_NOMEM; out->rgb is NULL then. */
int prt_cube_to_latlong(const struct prt_context *ctx, const struct prt_cube *cube,
                        uint32_t width, uint32_t height, struct prt_image *out);

/* Orthonormal non-standard 2-D Haar transform (NRH03) of one n x n plane, in place, n a power
 * of two up to PRT_CUBE_MAX (asserted). Layout: Mallat's nested arrangement of the coefficients
 * (x,y); [0] is the scaling coefficient. */
void prt_haar_forward(uint32_t n, float *plane);
void prt_haar_inverse(uint32_t n, float *plane);

/* The light vector that the kernels take: Haar coefficients of the cube, RGB and one pad.
 * coef[(face*n*n + y*n + x)*4 + c]. */
struct prt_light {
    uint32_t n;  /* cube size */
    float *coef; /* [6*n*n][4], 64-byte aligned */
};
/* PRT_ARG unless cube->n is a power of two of at least PRT_CUBE_MIN; PRT_NOMEM. */
int prt_light_from_cube(const struct prt_cube *cube, struct prt_light *out);
void prt_light_finish(struct prt_light *light);

/* Writes linear RGB as OpenEXR, half or float, through a temporary file and rename.
 * envmap_cube: the image is n x 6n, six unmirrored camera views +X -X +Y -Y +Z -Z (+Y with +z
 * up, -Y with -z up), and the file carries OpenEXR's envmap attribute. Values beyond +-65504
 * are stored as
 * +-65504 in a half. PRT_ARG, PRT_IO, PRT_NOMEM, PRT_INTERNAL. */
int prt_write_exr(const struct prt_context *ctx, const char *path,
                  const struct prt_image *image, bool full_float, bool envmap_cube);
/* The same into memory: prt_free(out->bytes). */
int prt_encode_exr(const struct prt_context *ctx, const struct prt_image *image,
                   bool full_float, struct prt_blob *out);
/* Radiance RGBE, a shared exponent a pixel; negative values become 0. prt_free(out->bytes).
 * PRT_NOMEM; *out is unchanged then. */
int prt_encode_hdr(const struct prt_context *ctx, const struct prt_image *image,
                   struct prt_blob *out);
/* pixels [height][width][n_channel 3|4], sRGB bytes that the caller has tone-mapped; at most
 * 16384 pixels a side. PNG at the fastest deflate level. prt_free(out->bytes). PRT_ARG,
 * PRT_NOMEM; out->bytes is NULL then. */
int prt_encode_png(const struct prt_context *ctx, const uint8_t *pixels, uint32_t width,
                   uint32_t height, unsigned n_channel, struct prt_blob *out);
/* The same with 16 bits a channel. */
int prt_encode_png16(const struct prt_context *ctx, const uint16_t *pixels, uint32_t width,
                     uint32_t height, unsigned n_channel, struct prt_blob *out);
/* rgb8 [height][width][3], quality 1..100, 4:4:4 chroma from 90. Equal images give equal files
 * for any number of threads; uses ctx->pool. Statuses as prt_encode_png, and PRT_INTERNAL. */
int prt_encode_jpeg(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                    uint32_t height, int quality, struct prt_blob *out);

/* Reads any image as linear RGB, with the child process, limits and statuses of prt_env_load;
 * values are as in the file, negative and non-finite ones too. */
int prt_image_load(const struct prt_context *ctx, const char *path, struct prt_image *out);
int prt_image_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                          size_t n, struct prt_image *out);

#ifdef __cplusplus
}
#endif
#endif
