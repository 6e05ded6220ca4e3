/* SPDX-License-Identifier: MIT */
/* zip.h owns small zip archives in memory: writing, and reading those of strangers within
 * limits. Thread-safety: one thread at a time for one archive. */
#ifndef RELIGHT_CLI_ZIP_H
#define RELIGHT_CLI_ZIP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { ZIP_MOST_FILES = 20000, ZIP_MOST_BYTES = 256 << 20 }; /* unpacked, of one file */

struct zip_file {
    char name[260];
    uint8_t *bytes; /* [n] and a zero byte */
    size_t n;
};

struct zip_writer {
    uint8_t *bytes;
    size_t n, room, n_file;
    uint8_t *directory;
    size_t n_directory, directory_room;
    bool failed; /* not enough memory, or too large */
};
/* Adds a file, compressed where that makes it smaller. */
void zip_add(struct zip_writer *zip, const char *name, const void *bytes, size_t n);
/* The archive, malloc()ed; NULL when anything failed. The writer is empty afterwards. */
uint8_t *zip_finish(struct zip_writer *zip, size_t *n);

/* Reads all files of an archive of `n` bytes, stored or deflated. 0, or -1 with the fault's
 * text. Freed by zip_free. */
int zip_read(const uint8_t *bytes, size_t n, struct zip_file **files, size_t *n_file,
             char error[160]);
void zip_free(struct zip_file *files, size_t n_file);

#endif
