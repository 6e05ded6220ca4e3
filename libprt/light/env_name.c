/* SPDX-License-Identifier: MIT */
/* Environments by a beginning of their file's name, as the other names of the tools. */
#include "light_private.h"

#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { MOST_FILES = 4096 };

static bool is_picture(const char *name)
{
    static const char *const ends[] = {".exr", ".hdr", ".pic",  ".png", ".jpg",
                                       ".dds", ".ktx", ".ktx2", ".jpeg"};
    const char *dot = strrchr(name, '.');
    for (size_t i = 0; dot && dot > name && i < sizeof ends / sizeof *ends; i++)
        if (!strcasecmp(dot, ends[i])) return true;
    return false;
}

/* Names of the pictures in a folder, malloc()ed; their number. */
static unsigned list_pictures(const char *folder, char *name[MOST_FILES])
{
    DIR *dir = opendir(folder);
    unsigned n = 0;
    for (struct dirent *e; dir && n < MOST_FILES && (e = readdir(dir));)
        if (is_picture(e->d_name) && (name[n] = strdup(e->d_name))) n++;
    if (dir) closedir(dir);
    return n;
}

int prt_env_by_beginning(const struct prt_context *ctx, const char *path, char *out, size_t n)
{
    const char *slash = strrchr(path, '/'), *base = slash ? slash + 1 : path;
    char folder[4096] = ".", remedy[256];
    char **name = calloc(MOST_FILES, sizeof *name);
    const size_t length = slash ? (size_t)(slash - path) + 1 : 0;
    if (!name || length >= sizeof folder || length + 256 >= n) {
        free(name);
        return prt_fail(ctx, PRT_IO, "%s: No such file or directory", path);
    }
    if (length) snprintf(folder, sizeof folder, "%.*s", (int)length, path);
    const unsigned count = list_pictures(folder, name);
    const int found =
        prt_name_choose(base, (const char *const *)name, count, remedy, sizeof remedy);
    if (found >= 0) snprintf(out, n, "%.*s%s", (int)length, path, name[found]);
    for (unsigned i = 0; i < count; i++) free(name[i]);
    free(name);
    if (found < 0)
        return prt_fail(ctx, PRT_IO, "%s: No such file or directory%s%s", path,
                        remedy[0] ? "; " : "", remedy);
    prt_log(ctx, PRT_LOG_NOTE, "%s: read from %s", path, out);
    return PRT_OK;
}
