/* SPDX-License-Identifier: MIT */
/* import_file.h owns the work of imports.h that blocks: opening a file below --models, copying
 * it (import_file.c), and listing the folder (import_list.c). Thread-safety: any thread. */
#ifndef RELIGHTD_IMPORT_FILE_H
#define RELIGHTD_IMPORT_FILE_H

#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { IMPORT_STAMP = 128 };

/* Opens a regular file below the folder with these flags; links and ".." that lead out of it
 * are refused by the kernel. stamp names its device, inode, size and times. -errno on failure.
 */
int import_open(const char *folder, const char *path, int flags, char stamp[IMPORT_STAMP],
                uint64_t *bytes);

/* The same below an open folder. _any: folders, too, and no stamp. */
int import_open_below(int dir, const char *path, int flags, char stamp[IMPORT_STAMP],
                      uint64_t *bytes);
int import_open_any_below(int dir, const char *path, int flags);

struct import_file {
    char hash[65], stamp[IMPORT_STAMP];
    uint64_t bytes;
    bool prt, copied; /* copied: false when the copy of `known` was good still */
    char **name;      /* of a .gltf: the files it refers to */
    size_t n_name;
    int code;   /* protocol error code; 0: done */
    bool lasts; /* the file itself is at fault: the same until it changes */
    char error[300];
};

/* Copies FOLDER/path to TO/HASH. known: hash of a copy that is there, made of a file with
 * known_stamp; "" for none. Files above `most` bytes are refused. *stop ends the copying. */
void import_copy_file(const char *folder, const char *path, const char *to, const char *known,
                      const char *known_stamp, uint64_t most, const atomic_bool *stop,
                      struct import_file *out);
void import_file_finish(struct import_file *file);

/* A model that the folder offers. */
struct import_entry {
    char *name; /* of its file, below the folder */
    char *
        version; /* "NAME/VERSION" of a folder of versions; NULL: a file of the folder itself */
    char *settings; /* of a version: its model.json, or that of NAME; NULL: there is none */
    char stamp[IMPORT_STAMP];
    uint64_t bytes;
    bool prt;
    char fault[160]; /* why a version cannot be used; name is then "" */
};
/* Files whose stamps are to be read again; stamp "": the file is not there. */
struct import_known {
    char *name, stamp[IMPORT_STAMP];
};
struct import_list {
    struct import_entry *entry;
    size_t n;
    struct import_known *known;
    size_t n_known;
    bool readable; /* false: nothing is known of the folder: it could not be read, or memory or
                    * descriptors were short */
};
/* Lists the model files of the folder and of its NAME/VERSION folders, and fills the stamps of
 * list->known. */
void import_list(const char *folder, struct import_list *list);
void import_list_finish(struct import_list *list);

/* Copies `text` with control characters and bytes that are no UTF-8 as \xNN. */
void name_printable(const char *text, char *out, size_t n);

#endif
