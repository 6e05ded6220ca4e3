/* SPDX-License-Identifier: MIT */
/* import_file.h owns the work of imports.h that blocks: opening a file below --models, copying
 * it, and listing the folder. Thread-safety: any thread. */
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

struct import_file {
    char hash[65], stamp[IMPORT_STAMP];
    uint64_t bytes;
    bool prt, copied; /* copied: false when the copy of `known` was good still */
    char **name;      /* of a .gltf: the files it refers to */
    size_t n_name;
    int code; /* protocol error code; 0: done */
    char error[300];
};

/* Copies FOLDER/path to TO/HASH. known: hash of a copy that is there, made of a file with
 * known_stamp; "" for none. Files above `most` bytes are refused. *stop ends the copying. */
void import_copy_file(const char *folder, const char *path, const char *to, const char *known,
                      const char *known_stamp, uint64_t most, const atomic_bool *stop,
                      struct import_file *out);
void import_file_finish(struct import_file *file);

struct import_entry {
    char *name; /* as it is in the folder */
    char stamp[IMPORT_STAMP];
    uint64_t bytes;
    bool prt;
};
/* The model files of the folder itself. */
struct import_entry *import_list(const char *folder, size_t *n);
void import_list_free(struct import_entry *entry, size_t n);

/* Copies `text` with control characters and bytes that are no UTF-8 as \xNN. */
void name_printable(const char *text, char *out, size_t n);

#endif
