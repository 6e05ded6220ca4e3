/* SPDX-License-Identifier: MIT */
/* prt/texture.h owns images over a mesh's texture coordinates: decoding, mip chains, filtered
 * look-up.
 *
 * All functions are thread-safe on different objects. Those with a context return PRT_OK or a
 * negative status, which they have logged; *out is written on success only. */
#ifndef PRT_TEXTURE_H
#define PRT_TEXTURE_H

#include "prt/base.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    PRT_TEXTURE_MAX_SIDE = 16384,
    PRT_TEXTURE_MAX_LEVEL = 15,
    PRT_TEXTURE_MAX_UV = 8 /* TEXCOORD sets of a mesh */
};

/* The meaning of an image's numbers. */
enum prt_texture_kind {
    PRT_TEXTURE_COLOR,  /* RGB as sRGB; levels are averages of linear light */
    PRT_TEXTURE_DATA,   /* linear numbers */
    PRT_TEXTURE_NORMAL, /* 0.5 + 0.5 n; levels are averages of unit vectors, so that their
                           length says how far the normals of a texel differ */
    PRT_TEXTURE_N_KIND
};

/* An image and its mip chain: RGBA, 8 bits a channel, row 0 on top, levels one after another
 * from the full size down to 1 x 1; each side of a level is half the one before, rounded down,
 * at least 1. */
struct prt_texture_image {
    uint32_t width, height; /* [1,PRT_TEXTURE_MAX_SIDE] */
    uint32_t n_level;       /* prt_texture_levels(width, height) */
    uint32_t kind;          /* enum prt_texture_kind */
    uint64_t begin, bytes;  /* of all levels, in the array of texels they lie in */
    uint64_t hash[2];       /* content address: XXH3-128 of size, kind and level 0 */
};

enum prt_wrap { PRT_WRAP_REPEAT, PRT_WRAP_CLAMP, PRT_WRAP_MIRROR };
/* Bits of prt_texture_ref.filter; 0 is trilinear and anisotropic. */
enum {
    PRT_FILTER_MAG_NEAREST = 1,
    PRT_FILTER_MIN_NEAREST = 2, /* within a level */
    PRT_FILTER_LEVEL_NEAREST = 4,
    PRT_FILTER_NO_LEVELS = 8, /* level 0 alone */
    PRT_FILTER_ALL = 15
};

/* An image's place on a surface. */
struct prt_texture_ref {
    uint32_t image; /* index; UINT32_MAX: none */
    uint8_t uv_set; /* TEXCOORD set */
    uint8_t wrap_u, wrap_v, filter;
    float transform[6]; /* u' = t[0] u + t[1] v + t[2], v' = t[3] u + t[4] v + t[5] */
    float scale;        /* of a normal map; strength of an occlusion map */
};

enum prt_map {
    PRT_MAP_BASE,      /* RGB linear reflectance, alpha */
    PRT_MAP_NORMAL,    /* tangent space */
    PRT_MAP_ROUGHNESS, /* G roughness, B metalness */
    PRT_MAP_OCCLUSION, /* R */
    PRT_MAP_EMISSIVE,  /* RGB */
    PRT_N_MAP
};

/* The maps of one surface and the factors they are multiplied with. */
struct prt_surface_maps {
    struct prt_texture_ref map[PRT_N_MAP];
    float emissive[3]; /* radiance, linear RGB, >= 0 */
    float metallic;    /* [0,1] */
};
/* No maps, no emission. */
void prt_surface_maps_default(struct prt_surface_maps *maps);

/* Levels of a full mip chain, and the bytes of all of them. */
uint32_t prt_texture_levels(uint32_t width, uint32_t height);
uint64_t prt_texture_bytes(uint32_t width, uint32_t height);
/* PRT_OK for an image whose numbers agree with each other and with an array of `texel_bytes`.
 */
bool prt_texture_image_valid(const struct prt_texture_image *image, uint64_t texel_bytes);
/* Whether the numbers of a surface's maps are in range, images below n_image, sets below n_uv.
 */
bool prt_surface_maps_valid(const struct prt_surface_maps *maps, uint32_t n_image,
                            uint32_t n_uv);

/* Decodes PNG, JPEG or WebP of untrusted bytes: call in an isolated child or a fuzz target
 * only. The size is checked before the pixels are allocated: at most max_bytes for all levels.
 * *texel (prt_free): level 0, with room for the other levels behind. name opens the messages.
 * PRT_FORMAT (damaged), PRT_UNSUPPORTED (KTX2 and others, which no library of Debian reads),
 * PRT_LIMIT, PRT_NOMEM. */
int prt_texture_decode(const struct prt_context *ctx, const char *name, const void *bytes,
                       size_t n, uint64_t max_bytes, uint32_t *width, uint32_t *height,
                       uint8_t **texel);
/* Computes levels 1.. behind level 0 and fills *out (begin 0). */
void prt_texture_finish_levels(uint32_t width, uint32_t height, enum prt_texture_kind kind,
                               uint8_t *texel, struct prt_texture_image *out);

/* Filtered value at uv: RGB of PRT_TEXTURE_COLOR linear, of PRT_TEXTURE_NORMAL in [-1,1] and
 * not normalised, others in [0,1]. dx, dy: derivatives of uv by the picture's axes, of one
 * pixel; an anisotropic footprint takes up to 16 look-ups along its longer axis. texel: the
 * array that image->begin counts in. */
void prt_texture_sample(const struct prt_texture_image *image, const uint8_t *texel,
                        const struct prt_texture_ref *ref, const float uv[2], const float dx[2],
                        const float dy[2], float rgba[4]);

#ifdef __cplusplus
}
#endif
#endif
