/* SPDX-License-Identifier: MIT */
/* picture.h owns the file formats in which pictures are written: one table of their endings and
 * encoders, which prt, relight-preview and relightd share. */
#ifndef PRT_PICTURE_H
#define PRT_PICTURE_H

#include "prt/light.h"
#include "prt/raster.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How a linear picture becomes a file; formats ignore what they do not use. */
struct prt_picture_options {
    enum prt_tone tone; /* 8-bit formats */
    float exposure_ev;  /* stops, 8-bit formats */
    int quality;        /* JPEG, 1..100 */
    bool full_float;    /* OpenEXR: 32-bit channels instead of 16-bit */
    bool fine;          /* PNG: prt_tone_map_fine() in 16-bit channels instead of 8-bit */
};

struct prt_picture_format {
    const char *ending; /* without the dot, lower case: "png" */
    const char *alias;  /* another ending ("jpeg"); NULL: none */
    bool linear;        /* keeps radiance above 1 */
    bool alpha; /* keeps alpha: EXR with premultiplied colours, PNG with straight ones */
    /* As prt_picture_encode, of what encode_rgb8 cannot hold; NULL: it holds all. */
    int (*encode)(const struct prt_context *ctx, const struct prt_image *image,
                  const struct prt_picture_options *options, struct prt_blob *out);
    /* The same of pixels rgb8[height][width][3] that prt_tone_map() made, without alpha; NULL:
     * not this format. Width and height are 1 to PRT_IMAGE_MAX. After a failure *out is
     * as it was, or empty. */
    int (*encode_rgb8)(const struct prt_context *ctx, const uint8_t *rgb8, uint32_t width,
                       uint32_t height, const struct prt_picture_options *options,
                       struct prt_blob *out);
};

/* The format of a name by its ending ("a.png", ".PNG"); NULL: none. Thread-safe, does not
 * block.
 */
const struct prt_picture_format *prt_picture_format(const char *name);
/* Encodes linear RGB [height][width][3]. Returns an enum prt_status; *out, written where that
 * is 0, is freed by prt_free(out->bytes). Thread-safe; blocks while it computes. */
int prt_picture_encode(const struct prt_context *ctx, const struct prt_picture_format *format,
                       const struct prt_image *image, const struct prt_picture_options *options,
                       struct prt_blob *out);
/* The endings of all formats, as ".exr, .hdr or .png": for messages. Thread-safe, does not
 * block. */
const char *prt_picture_endings(char text[100]);

/* Colours rgb[n][3], linear, to GL_RGB9_E5 in out[n]: three mantissas of 9 bits under the
 * exponent of the largest channel. Negative values and NaN become 0, values above 65408 that.
 * Thread-safe; ctx chooses the instructions, NULL for the machine's. */
void prt_encode_rgb9e5(const struct prt_context *ctx, const float *rgb, size_t n,
                       uint32_t *out);

#ifdef __cplusplus
}
#endif
#endif
