/* SPDX-License-Identifier: MIT */
/* model_files.h owns the functions shared by the registry's files: models.c, catalogue.c,
 * model_open.c, model_facts.c, mesh_import.c, imports.c and op_load.c. */
#ifndef RELIGHTD_MODEL_FILES_H
#define RELIGHTD_MODEL_FILES_H

#include "store/models.h"

struct server *models_server(const struct models *models);
struct model *model_add(struct models *models, const char *id, const char *name,
                        const char *owner);
/* Removes it from the registry; holders of a reference may use it further. */
void model_take_out(struct model *model);
/* Another name of a model: its owner's replaces the first, anybody else's is an alias. False:
 * it was its name, or there are too many. */
bool model_set_name(struct model *model, const char *owner, const char *name);
/* A copy of a .prt of --models is there: it is a model. NULL when there is no memory. */
struct model *models_found(struct models *models, struct import_copy *copy, const char *name);
/* A copy's file is gone or has other content: its model is here for the rooms that need it. */
void models_replaced(struct models *models, struct import_copy *copy, const char *name);
/* Its file has this content again. */
void model_revive(struct model *model);
/* Forgets models whose file of --models has other content by now or is gone, unless they are in
 * use or rooms need them. */
void models_drop_replaced(struct models *models);
/* name is text, with or without its ending. */
bool name_matches(const char *name, const char *text);
int64_t wall_ns(void);

void model_bake_path(const struct server *server, const char *id, char path[PATH_MAX]);
void model_preview_path(const struct server *server, const char *id, char path[PATH_MAX]);
/* The .prt at `path` is a draft of the bake under way: it answers until model_drop_draft. The
 * bake's folder holds the file and pays for it. single_follows: the bake has
 * single scattering, which drafts leave out. */
void model_take_draft(struct model *model, const char *path, bool single_follows);
/* Requests in progress finish with the draft. */
void model_drop_draft(struct model *model);
/* No client has forgotten it or loaded it again since: its files may be removed with it. */
bool model_is_last(const struct model *m);
/* Charges the bake's or preview's file to the owner; 0: it was removed. */
void model_charge_bake(struct model *model, uint64_t bytes);
void model_charge_preview(struct model *model, uint64_t bytes);
/* Drops its opened file and computed results; `all`: also those in progress. */
void model_forget_results(struct model *model, bool all);

/* Keeps what the open file of a preview, or of a bake, tells about the model. */
void model_learn_mesh(struct model *model, const struct prt_file *file);
void model_learn_facts(struct model *model, const struct prt_file *file);

/* Opens a .prt on a worker and fills the entry, of which it takes a reference. */
void model_start_opening(struct model *model, struct cache_entry *entry, const char *path,
                         bool preview);
/* Reads a model's file into DATA/previews/ID.prt, unless that is there or under way. folder:
 * the file to remove when it was read; "" for none. */
struct decode_model;
void preview_start(struct model *model, const struct decode_model *order, const char *folder);
/* The bake is there, or the model is forgotten. */
void preview_remove(struct model *model);
/* Reads the properties that LIST shows of a baked model that is not open, after all requests.
 */
void model_read_header(struct model *model);

/* catalogue.c: DATA/models/ID.json, from which a restart restores the models. */
void model_remember(struct model *model);
void model_forget_record(struct model *model);
/* Removes the record in --store of a model that is not here. */
void model_forget_shared(struct server *server, const char *id);
/* Versions of the baker and the format that made a record's bake; of a record that does not
 * say it, written before records did, RECORD_BEFORE. */
enum { RECORD_BEFORE = 2 };
struct cJSON;
uint32_t record_version(const struct cJSON *record, const char *of);
/* Makes room: removes its files here. Where replicas share a folder its record stays there, and
 * a bake comes back when somebody asks for it. */
void model_evict(struct model *model);
/* The file under DATA/bakes that belongs to a record which another replica wrote; the model is
 * READY from here on. */
void model_is_away(struct model *model, uint64_t bytes);
/* At start: reads the catalogue and removes unfinished files of a killed daemon. Blocks.
 * PRT_NOMEM: nothing was removed, and the daemon must not start. */
int catalogue_read(struct models *models);
#endif
