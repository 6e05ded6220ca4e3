/* SPDX-License-Identifier: MIT */
/* versions.h owns the table of the folders NAME/VERSION of --models: the model that answers
 * under each of these names, and those whose file is still to be loaded (ops/repository.h does
 * that). NAME alone stands for its newest version that can answer; versions are ordered as
 * numbers where they are numbers. Thread-safety: loop thread only. */
#ifndef RELIGHTD_VERSIONS_H
#define RELIGHTD_VERSIONS_H

#include "store/import_file.h"
#include "store/models.h"

enum version_state {
    VERSION_IDLE,
    VERSION_SETTLING, /* it changed: loaded when the next scan finds it unchanged */
    VERSION_WANTED,
    VERSION_LOADING
};

struct version {
    struct version *next;
    char *name;            /* "NAME/VERSION" */
    char *path, *settings; /* of its file, below --models; model.json or NULL */
    char stamp[IMPORT_STAMP], fault[160];
    bool prt, pin;
    enum version_state state;
    char model[MODEL_ID + 1]; /* answers under this name; "": none yet */
    unsigned missed;          /* scans, one after another, that did not find it */
};

struct versions;
int versions_create(struct models *models, struct versions **out);
void versions_destroy(struct versions *versions); /* NULL is fine */

/* The id of the model that the name "NAME/VERSION" or "NAME" stands for; "": none. */
const char *versions_find(const struct versions *versions, const char *text);
/* Whether the text is a NAME: the model that it stands for may change. */
bool versions_is_name(const struct versions *versions, const char *text);
/* NULL: there is none of this name. */
struct version *versions_get(const struct versions *versions, const char *name);
/* One after another; start with NULL. */
struct version *versions_next(const struct versions *versions, const struct version *version);

/* The model answers under the version's name from here on; another that did is replaced. */
void version_answers(struct versions *versions, struct version *version, struct model *model);
/* A scan found these models. Those that are new or have changed are WANTED, or SETTLING first;
 * those that two scans missed are removed. */
void versions_scanned(struct versions *versions, const struct import_entry *entry, size_t n);

#endif
