/* SPDX-License-Identifier: MIT */
/* new_file.h owns the writing of a file that appears whole or not at all. */
#ifndef RELIGHT_LIB_NEW_FILE_H
#define RELIGHT_LIB_NEW_FILE_H

#include "relight/relight.h"

#include <stdio.h>

struct new_file {
    FILE *file;
    const char *path;     /* the caller's */
    char temporary[4096]; /* "": a device or pipe, which is written in place */
};
/* 0, or -RELIGHT_E_FILE. */
int relight_new_file(struct new_file *out, const char *path, struct relight_error *error);
/* Closes it. Where status is 0 it gets its name; else what had the name stays. Returns status,
 * or -RELIGHT_E_FILE. */
int relight_new_file_end(struct new_file *file, int status, struct relight_error *error);

#endif
