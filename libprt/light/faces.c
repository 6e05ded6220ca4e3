/* SPDX-License-Identifier: MIT */
/* Finds the six files of a cubemap in a folder or by a pattern. */
#include "light_private.h"

#include <ctype.h>
#include <dirent.h>
#include <fnmatch.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* Common endings of the faces' file names; the front is -Z, the view direction. */
static const char *const words[6][8] = {
    {"posx", "px", "right", "rt", "+x", "xpos", "xp", NULL},
    {"negx", "nx", "left", "lf", "-x", "xneg", "xn", NULL},
    {"posy", "py", "top", "up", "+y", "ypos", "yp", NULL},
    {"negy", "ny", "bottom", "down", "dn", "-y", "yneg", NULL},
    {"posz", "pz", "back", "bk", "+z", "zpos", "zp", NULL},
    {"negz", "nz", "front", "ft", "-z", "zneg", "zn", NULL},
};

/* Face whose word ends the stem of a file name, or -1. */
static int face_of(const char *file)
{
    char stem[256];
    const char *dot = strrchr(file, '.');
    const size_t n = dot ? (size_t)(dot - file) : strlen(file);
    if (n == 0 || n >= sizeof stem) return -1;
    for (size_t i = 0; i < n; i++) stem[i] = (char)tolower((unsigned char)file[i]);
    stem[n] = 0;
    for (int face = 0; face < 6; face++)
        for (int w = 0; words[face][w]; w++) {
            const size_t len = strlen(words[face][w]);
            if (len > n || strcmp(stem + n - len, words[face][w])) continue;
            if (len == n || !isalpha((unsigned char)stem[n - len - 1]) ||
                !isalpha((unsigned char)stem[n - len]))
                return face;
        }
    return -1;
}

static int scan(const struct prt_context *ctx, const char *pattern, const char *folder,
                const char *glob, char *paths[6])
{
    static const char *const axes[6] = {"posx", "negx", "posy", "negy", "posz", "negz"};
    DIR *dir = opendir(folder);
    if (!dir) return prt_fail(ctx, PRT_IO, "%s: cannot read the folder %s", pattern, folder);
    int err = PRT_OK;
    for (struct dirent *e; !err && (e = readdir(dir));) {
        const int face = face_of(e->d_name);
        if (face < 0 || e->d_name[0] == '.' || fnmatch(glob, e->d_name, 0)) continue;
        if (paths[face])
            err = prt_fail(ctx, PRT_FORMAT,
                           "%s: both %s and %s could be the %s face; give a "
                           "pattern such as DIR/name_*.hdr",
                           pattern, paths[face], e->d_name, axes[face]);
        else if (asprintf(&paths[face], "%s/%s", folder, e->d_name) < 0) {
            paths[face] = NULL;
            err = prt_fail(ctx, PRT_NOMEM, "%s: no memory", pattern);
        }
    }
    closedir(dir);
    for (int face = 0; !err && face < 6; face++)
        if (!paths[face])
            err = prt_fail(ctx, PRT_FORMAT,
                           "%s: no file for the %s face; names must end in %s, "
                           "%s, … as six cube faces",
                           pattern, axes[face], words[face][0], words[face][1]);
    return err;
}

int prt_find_faces(const struct prt_context *ctx, const char *pattern, char *paths[6])
{
    struct stat st;
    char *copy = strdup(pattern);
    if (!copy) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", pattern);
    int err;
    if (!stat(pattern, &st) && S_ISDIR(st.st_mode)) {
        err = scan(ctx, pattern, copy, "*", paths);
    } else {
        char *hole = strstr(copy, "%s");
        if (hole) { /* sky_%s.png is sky_*.png */
            *hole = '*';
            memmove(hole + 1, hole + 2, strlen(hole + 2) + 1);
        }
        char *slash = strrchr(copy, '/');
        if (slash) *slash = 0;
        err = scan(ctx, pattern, slash ? (*copy ? copy : "/") : ".", slash ? slash + 1 : copy,
                   paths);
    }
    free(copy);
    return err;
}
