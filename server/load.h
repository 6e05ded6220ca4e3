/* SPDX-License-Identifier: MIT */
/* load.h owns what models.c and load.c share of the registry. */
#ifndef RELIGHTD_LOAD_H
#define RELIGHTD_LOAD_H

#include "models.h"

struct model *model_by_id(struct models *models, const char *id);
struct model *model_add(struct models *models, const char *id, const char *name);
/* The model of a .prt in --models; NULL when it is none. */
struct model *model_from_prt(struct models *models, const char *path, const char *name);
void model_bake_path(const struct server *server, const char *id, char path[PATH_MAX]);
/* Writes the catalogue's entry. */
void model_remember(const struct model *model);
/* A preset's name or JSON text; error says what is wrong. */
struct prt_material;
int material_resolve(const char *text, struct prt_material *material, bool *preset,
                     char error[300]);

#endif
