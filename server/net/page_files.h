/* SPDX-License-Identifier: MIT */
/* page_files.h owns the files of the page (client/web): read once at the start into memory,
 * with the compressed forms that the build wrote beside them (NAME.br, NAME.gz). Loop thread
 * only. */
#ifndef RELIGHTD_PAGE_FILES_H
#define RELIGHTD_PAGE_FILES_H

#include <stdbool.h>
#include <stddef.h>

struct server;

/* How the bytes of one form are encoded; the first that a client accepts is sent. */
enum page_encoding { PAGE_BROTLI, PAGE_GZIP, PAGE_PLAIN, PAGE_N_ENCODING };

struct page_bytes {
    char *bytes; /* NULL: there is no such form */
    size_t n;
};
struct page_file {
    char *path; /* "/index.html" */
    const char *type;
    bool hashed; /* its name changes with its bytes: browsers may keep it for ever */
    struct page_bytes form[PAGE_N_ENCODING];
};

/* Reads --page, or share/relight/page beside the program's folder. A folder that is not there
 * leaves the page empty; so does one that is unreadable or too large, which is logged. */
void page_files_read(struct server *server);
/* The file at a path of a URL; "/" is index.html. NULL: there is none. */
const struct page_file *page_files_find(const char *path);
/* Whether there is a page at all. */
bool page_files_any(void);
void page_files_free(void);

#endif
