/* SPDX-License-Identifier: MIT */
/* prt/variant.h owns views of a mesh in one of its variants (KHR_materials_variants), for
 * requests: the same geometry with other surfaces, and the media that these have of their own.
 *
 * A bake serves every variant that does not change what was baked: which surfaces are
 * translucent; their media (of wavelet transport), refractive indices, normal and occlusion
 * maps; and, with a texture split, their colours. Textures, roughness, emission and the albedo
 * of opaque surfaces change freely, and so do the other coefficients of media in joint and
 * polynomial transport. */
#ifndef PRT_VARIANT_H
#define PRT_VARIANT_H

#include "prt/media.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_variant_of {
    PRT_VARIANT_OF_MODEL,  /* nothing is baked: references and image-space engines */
    PRT_VARIANT_OF_FIXED,  /* wavelet transport */
    PRT_VARIANT_OF_FREE,   /* joint or polynomial transport: media change */
    PRT_VARIANT_OF_ANY_ETA /* the same for media of any refractive index that the transport has
                            */
};
struct prt_variant {
    uint32_t index;       /* of the variant; n_variant: the file's own materials */
    bool plain;           /* colours at vertices and media are those of the base */
    struct prt_mesh mesh; /* shares all arrays of the base's mesh but `block` and `gain` */
    float (*gain)[3];     /* [n_block] from colours of the base's albedo to the variant's; 1 of
                             translucent blocks */
    struct prt_media *media; /* by object */
};
/* A view of `mesh`, whose surfaces and media[n_object] are those of a bake or of a loaded
 * model; they must outlive it. A medium changes where the base has the medium of its surface's
 * own material, scaled to mm. `model` opens the error line, which names the variant and the
 * surface. mesh.gain is `gain` where an opaque surface's albedo differs from the baked one.
 * PRT_ARG: no variant, or more than one, has this name. PRT_MISMATCH: the variant changes what
 * was baked and needs a bake of its own. PRT_NOMEM. Thread-safe; the caller destroys *out. */
int prt_variant_create(const struct prt_context *ctx, const char *model,
                       const struct prt_mesh *mesh, const struct prt_media *media,
                       enum prt_variant_of of, const char *name, struct prt_variant **out);
void prt_variant_destroy(struct prt_variant *variant); /* NULL: nothing */

#ifdef __cplusplus
}
#endif
#endif
