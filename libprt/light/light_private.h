/* SPDX-License-Identifier: MIT */
/* Declarations shared by the sources of this room. */
#ifndef PRT_LIGHT_PRIVATE_H
#define PRT_LIGHT_PRIVATE_H

#include "prt/light.h"

#include <pthread.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A lat-long image reduced to the resolution of a cube of one size (turn.c). `pixel` is NULL
 * until the image is reduced. */
enum { PRT_BRIGHT_MAX = 512 };
struct prt_bright_pixel { /* left out of the reduced image */
    double phi, theta;    /* left edge, azimuth of (sin, ., -cos); upper edge from +Y [rad] */
    double width, height; /* [rad] */
    float power[3];       /* radiance times solid angle */
};
enum { PRT_MOVED_KEPT = 16 };
struct prt_moved_cube { /* of the image moved by a whole number of columns */
    uint64_t used;      /* n_use at its last use */
    uint32_t column;
    float *texel; /* [6 n n][3]; NULL: none */
};
struct prt_turned_image {
    uint32_t width, height, n_bright;
    float (*pixel)[4]; /* [height][2 width], each row twice; 16-byte aligned, the fourth is 0 */
    struct prt_bright_pixel *bright;
    struct prt_moved_cube moved[PRT_MOVED_KEPT]; /* under the cache's lock */
    uint64_t n_use;
};
void prt_turned_image_finish(struct prt_turned_image *image);

/* Cache of an environment, filled at the first rotation: the lat-long image that rotations of
 * a cube environment resample; those that prt_env_turned() reads, for its sizes. */
struct prt_env_cache {
    pthread_mutex_t lock;
    struct prt_image latlong;
    struct prt_turned_image reduced[3];
};

enum { PRT_IMAGE_MAX = 16384, PRT_FACES_MAX = 6 };
#define PRT_IMAGE_MAX_PIXELS ((uint64_t)16384 * 8192)
#define PRT_RADIANCE_MAX \
    1e30f /* larger values are clamped, so that sums over a cube stay finite */

/* The layout that a file declares. */
enum prt_layout_hint {
    PRT_HINT_NONE,        /* by aspect ratio */
    PRT_HINT_EXR_LATLONG, /* OpenEXR's envmap attribute */
    PRT_HINT_EXR_CUBE,
    PRT_HINT_GL_CUBE, /* six faces stacked, OpenGL's axes (DDS) */
    PRT_HINT_COUNT
};

struct prt_decoded {
    struct prt_image image;
    enum prt_layout_hint hint;
    bool is_chroma; /* an EXR that OpenEXRCore decodes wrongly: Y RY BY or subsampled */
};

/* Parses untrusted bytes; call only in the isolated child (or a fuzz target). */
int prt_decode(const struct prt_context *ctx, const char *name, const void *bytes, size_t n,
               struct prt_decoded *out);
/* As prt_decode without OpenImageIO: PRT_UNSUPPORTED without a log line for a file that only
 * OpenImageIO can read. */
int prt_decode_own(const struct prt_context *ctx, const char *name, const void *bytes, size_t n,
                   struct prt_decoded *out);
/* Loads OpenImageIO; call it before the child is confined, which cannot open files. */
void prt_oiio_open(void);
/* The parsers behind it. */
bool prt_is_hdr(const uint8_t *bytes, size_t n);
bool prt_is_exr(const uint8_t *bytes, size_t n);
bool prt_is_ktx(const uint8_t *bytes, size_t n);
int prt_decode_ktx(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out);
bool prt_is_dds(const uint8_t *bytes, size_t n);
int prt_decode_hdr(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_image *out);
/* PRT_UNSUPPORTED without a log line for files left to OpenImageIO (DWA, chroma). */
int prt_decode_exr(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out);
int prt_decode_dds(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_decoded *out);
/* Both return PRT_UNSUPPORTED without a log line for files left to OpenImageIO. */
int prt_decode_png(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                   size_t n, struct prt_image *out);
int prt_decode_jpeg(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                    size_t n, struct prt_image *out);
int prt_decode_oiio(const struct prt_context *ctx, const char *name, const uint8_t *bytes,
                    size_t n, bool is_chroma, struct prt_image *out);
/* Bytes that prt_image_reserve allocates behind the pixels, for the header of the child's
 * answer. */
enum { PRT_IMAGE_TAIL = 16 };
/* PRT_OK for an image size within the limits, else a logged PRT_FORMAT or PRT_LIMIT. */
int prt_image_check(const struct prt_context *ctx, const char *name, uint64_t width,
                    uint64_t height);
/* As prt_image_check, and allocates out->rgb (prt_free). */
int prt_image_reserve(const struct prt_context *ctx, const char *name, uint64_t width,
                      uint64_t height, struct prt_image *out);
/* 8-bit style sRGB value in [0,1] to linear. */
float prt_srgb_to_linear(float v);

struct prt_input {
    const char *name;
    const void *bytes;
    size_t size;
};

/* Turns an image into an environment by its hint or aspect ratio. A lat-long environment takes
 * in->image over. */
int prt_env_from_image(const struct prt_context *ctx, const char *name, struct prt_decoded *in,
                       enum prt_faces faces, struct prt_env *env);
/* Six square images named +X -X +Y -Y +Z -Z. `axis_names`: px or posx, not right. */
int prt_env_from_faces(const struct prt_context *ctx, const char *name,
                       const struct prt_decoded *image, enum prt_faces faces, bool axis_names,
                       struct prt_env *env);
/* The only environment file of path's folder whose name begins so, into out[n]. PRT_IO with a
 * line that names the nearest. */
int prt_env_by_beginning(const struct prt_context *ctx, const char *path, char *out, size_t n);
/* Finds the six files of a folder or pattern; paths are malloc()ed. */
int prt_find_faces(const struct prt_context *ctx, const char *pattern, char *paths[6]);
/* Whether a file of a face is named by its axis alone: px, nx, … or posx, negx, … */
bool prt_face_has_axis_name(const char *path);
/* faces.c: how the image named `face` fills a cube's face by a convention. */
struct prt_face_place {
    unsigned face; /* of the cube */
    bool flip_x, flip_y;
};
struct prt_face_place prt_face_place(enum prt_faces faces, unsigned face);
/* The convention by which neighbouring faces fit at their edges: CAMERA, or THREE for those
 * that the pictures cannot tell apart (gl, d3d, three). cube: filled by CAMERA. */
enum prt_faces prt_faces_by_edges(const struct prt_cube *cube);

#ifdef __cplusplus
}
#endif
#endif
