/* SPDX-License-Identifier: MIT */
/* load.h owns what models.c and op_load.c share of the registry. */
#ifndef RELIGHTD_LOAD_H
#define RELIGHTD_LOAD_H

#include "store/models.h"

struct model *model_by_id(struct models *models, const char *id);
struct model *model_add(struct models *models, const char *id, const char *name);
/* The model of a .prt in --models; NULL when it is none. */
struct model *model_from_prt(struct models *models, const char *path, const char *name);
void model_bake_path(const struct server *server, const char *id, char path[PATH_MAX]);
void model_preview_path(const struct server *server, const char *id, char path[PATH_MAX]);
/* Nobody has forgotten it, or loaded it again since: its files may go with it. */
bool model_is_last(const struct model *model);
/* Opens a .prt on a worker and fills the entry, of which it takes a reference. */
void model_start_opening(struct model *model, struct cache_entry *entry, const char *path,
                         bool preview);
/* Reads a model's file into DATA/previews/ID.prt, unless that is there or under way. folder:
 * what to remove when it was read; "" for none. */
struct decode_model;
void preview_start(struct model *model, const struct decode_model *order, const char *folder);
/* The bake is there, or the model is forgotten. */
void preview_remove(struct model *model);
void remove_tree(const char *folder);
/* Looks what LIST is to say of a baked model before it is opened, behind every request. */
void model_read_header(struct model *model);
/* Writes the catalogue's entry. */
void model_remember(const struct model *model);
#endif
