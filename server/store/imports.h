/* SPDX-License-Identifier: MIT */
/* imports.h owns the files of the folder --models: which there are, and DATA/imports/HASH, a
 * copy of each that was loaded, named by its SHA-256. The daemon and its children open the
 * copies alone, so that a file of --models may be truncated, rewritten or removed at any time.
 * Copies share their blocks with the original where the file system can do that. A file is
 * recognised by device, inode, size and times, and copied again when these have changed.
 * The folder is scanned every --poll seconds and after inotify events. A file that two scans
 * did not find is gone: nothing is called by its name any more, and its copy is removed when
 * its space is needed. Thread-safety: loop thread only. */
#ifndef RELIGHTD_IMPORTS_H
#define RELIGHTD_IMPORTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct server;
struct imports;

/* One content. It is kept while somebody refers to it, with or without its file. */
struct import_copy {
    struct import_copy *next;
    char hash[65];
    uint64_t bytes;
    char owner[96]; /* principal's name: pays for it on disk */
    bool present;   /* DATA/imports/HASH is there */
    bool prt;       /* it begins as a .prt does */
    unsigned paths; /* files of --models that have this content as far as is known */
    unsigned refs;  /* references */
    unsigned users; /* references that need the file */
    int64_t used_ns;
};

int imports_create(struct server *server, struct imports **out);
/* Stops copying; waiters are not called any more. */
void imports_stop(struct imports *imports);
void imports_destroy(struct imports *imports);
/* Scans the folder, takes its .prt files in for up to `seconds`, then scans at intervals. */
void imports_start(struct imports *imports, double seconds);

/* fn is called after each scan. entry: the models of the folder, of NAME/VERSION folders too.
 * changed: paths of files that are no .prt and were copied before, whose content has changed
 * since. All are the scan's. */
struct import_entry;
typedef void (*imports_scanned_fn)(void *user, const struct import_entry *entry, size_t n,
                                   const char *const *changed, size_t n_changed);
void imports_on_scan(struct imports *imports, imports_scanned_fn fn, void *user);

/* A waiter for a copy. done is called once, unless it is cancelled before: with the
 * copy, which is there and stays until done returns or longer if it is held, and for a .gltf
 * the names of the files it refers to; or with copy NULL, a protocol error code and its text.
 */
struct import_request {
    struct import_request *next;
    void (*done)(struct import_request *request, struct import_copy *copy, char *const *names,
                 size_t n_name, int code, const char *error);
};
/* path: below --models. Requests for one path share one copying. owner pays for a new copy. */
void imports_get(struct imports *imports, const char *path, const char *owner,
                 struct import_request *request);
void imports_cancel(struct imports *imports, struct import_request *request);

void import_hold(struct import_copy *copy);                             /* refers to it */
void import_release(struct imports *imports, struct import_copy *copy); /* NULL is fine */
/* The file must stay, or may go again. */
void import_use(struct import_copy *copy);
void import_unuse(struct import_copy *copy);
void import_path(const struct imports *imports, const char *hash, char *path, size_t n);
/* The file in --models that has this content now, or had it last; NULL: none. */
const char *import_source(const struct imports *imports, const char *hash);
/* Contents of files of this name, with or without their ending, one after another; *at begins
 * as NULL. Versions of NAME/VERSION folders are none of them. */
struct indexed;
const struct import_copy *import_called(const struct imports *imports, const char *text,
                                        const struct indexed **at);
/* Whether a file of --models has this content as far as is known: of two scans at least one
 * found it. */
bool import_is_current(const struct import_copy *copy);

/* For eviction: copies one after another, and the removal of one's file. */
struct import_copy *imports_next(const struct imports *imports, const struct import_copy *copy);
void import_evict(struct imports *imports, struct import_copy *copy);

/* Model files in the folder when it was last looked at; names are printable UTF-8. */
struct import_listed {
    char *name;
    uint64_t bytes;
};
const struct import_listed *imports_files(const struct imports *imports, size_t *n);

#endif
