/* SPDX-License-Identifier: MIT */
/* imports.h owns the files of the folder --models: which there are, and DATA/imports/HASH, a
 * copy of each that was loaded, named by its SHA-256. The daemon and its children open the
 * copies alone, so that a file of --models may be truncated, rewritten or removed at any time.
 * Copies share their blocks with the original where the file system can do that. A file is
 * recognised by device, inode, size and times, and copied again when these have changed.
 * The folder is scanned every two seconds and after inotify events.
 * Thread-safety: loop thread only. */
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
/* The same, if `text` is the file's name, with or without its ending. */
bool import_is_called(const struct imports *imports, const char *hash, const char *text);
/* Whether a file of --models has this content as far as is known. */
bool import_is_current(const struct imports *imports, const char *hash);

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
