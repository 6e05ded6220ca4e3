/* SPDX-License-Identifier: MIT */
/* prt/media.h owns the choice of each object's medium by name (METHODS §10).
 *
 * A medium belongs to a body: an object of the mesh, inside which light scatters. Names are
 * those of glTF materials and of nodes, compared as prt_name_choose does. While a choice is
 * made it is kept by block, of_block[n_block]: the medium behind each block's surface, NULL for
 * none; media are borrowed. All functions are thread-safe and log one line for an error. */
#ifndef PRT_MEDIA_H
#define PRT_MEDIA_H

#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One entry of a map "OBJECT=medium". */
struct prt_media_entry {
    const char *object; /* name; NULL or "": all translucent blocks that no entry names */
    const struct prt_material *material;
};
/* Where "OBJECT=" of an argument "OBJECT=MEDIUM" ends; 0 for one medium of all. A '=' behind
 * the first '{' or '/' belongs to the medium. */
size_t prt_media_name_length(const char *argument);

/* Gives of_block the media of n entries; what no entry names keeps its medium. PRT_ARG: more
 * than PRT_MEDIA_MAX + 1 entries, an object that two entries name, a name that the mesh does
 * not have (the message has near ones) or that is opaque. PRT_NOMEM. */
int prt_media_assign(const struct prt_context *ctx, const struct prt_mesh *mesh, unsigned n,
                     const struct prt_media_entry entry[],
                     const struct prt_material *of_block[]);
/* The medium of surface i's own material in the file, where it has one; lengths of the file
 * become millimetres by mm_per_unit. Warns of what is lost. */
bool prt_media_of_surface(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          uint32_t i, double mm_per_unit, struct prt_material *out);
/* Gives the translucent blocks that have no medium those of the file's own materials, with a
 * note for each; own[n_surface] is their memory. */
void prt_media_own(const struct prt_context *ctx, const struct prt_mesh *mesh,
                   struct prt_material own[], const struct prt_material *of_block[]);
/* Divides the objects whose translucent blocks have different media (prt_mesh_divide), with a
 * note for each: light does not scatter from one part into another. PRT_NOMEM. */
int prt_media_divide(const struct prt_context *ctx, struct prt_mesh *mesh,
                     const struct prt_material *const of_block[]);
/* The media by object, copied, equal ones once; the caller prt_free()s *out, which is written
 * on success only. PRT_ARG: a translucent block has no medium, two of one object have different
 * ones, or more than PRT_MEDIA_MAX are different. PRT_NOMEM. */
int prt_media_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_material *const of_block[], struct prt_media **out);
/* The media `base` of a mesh with n entries in place of some; statuses as above. */
int prt_media_edit(const struct prt_context *ctx, const struct prt_mesh *mesh,
                   const struct prt_media *base, unsigned n,
                   const struct prt_media_entry entry[], struct prt_media **out);

#ifdef __cplusplus
}
#endif
#endif
