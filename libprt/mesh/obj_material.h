// SPDX-License-Identifier: MIT
// One material of an OBJ's library (.mtl).
#ifndef PRT_MESH_OBJ_MATERIAL_H
#define PRT_MESH_OBJ_MATERIAL_H

#include "internal.h"

struct obj_map {
    char file[256]; // "": none
    struct prt_texture_ref ref;
};
struct obj_material {
    char name[64]; // wanted; "": the first of the library
    bool found;
    float base[3], emissive[3];
    float roughness, metallic; // roughness -1: not given
    struct obj_map map[PRT_N_MAP];
};
void prt_obj_material_init(struct obj_material *m);
// Reads the lines of material m->name from a library's text, which ends with a NUL.
void prt_obj_material_parse(struct prt_draft *d, const char *text, struct obj_material *m);
// Decodes its images and fills surface and maps. PRT_NOMEM.
int prt_obj_material_apply(struct prt_draft *d, struct obj_material *m,
                           struct prt_surface *surface, struct prt_surface_maps *maps);

#endif
