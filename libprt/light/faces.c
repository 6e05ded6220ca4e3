/* SPDX-License-Identifier: MIT */
/* The six files of a cubemap in a folder or by a pattern, and the conventions by which a cube's
 * faces lie in the world. */
#include "light_private.h"

#include <ctype.h>
#include <dirent.h>
#include <fnmatch.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

/* Common endings of the faces' file names; the front is -Z, the view direction. */
static const char *const words[6][9] = {
    {"posx", "px", "right", "rt", "+x", "xpos", "xp", NULL},
    {"negx", "nx", "left", "lf", "-x", "xneg", "xn", NULL},
    {"posy", "py", "top", "up", "+y", "ypos", "yp", NULL},
    {"negy", "ny", "bottom", "down", "dn", "-y", "yneg", "yn", NULL},
    {"posz", "pz", "back", "bk", "+z", "zpos", "zp", NULL},
    {"negz", "nz", "front", "ft", "-z", "zneg", "zn", NULL},
};

/* The word of a face that ends the stem of a file name, or NULL. */
static const char *word_of(const char *file, int *face)
{
    char stem[256];
    const char *dot = strrchr(file, '.');
    const size_t n = dot ? (size_t)(dot - file) : strlen(file);
    if (n == 0 || n >= sizeof stem) return NULL;
    for (size_t i = 0; i < n; i++) stem[i] = (char)tolower((unsigned char)file[i]);
    stem[n] = 0;
    for (*face = 0; *face < 6; ++*face)
        for (int w = 0; words[*face][w]; w++) {
            const size_t len = strlen(words[*face][w]);
            if (len > n || strcmp(stem + n - len, words[*face][w])) continue;
            if (len == n || !isalpha((unsigned char)stem[n - len - 1]) ||
                !isalpha((unsigned char)stem[n - len]))
                return words[*face][w];
        }
    return NULL;
}

static int scan(const struct prt_context *ctx, const char *pattern, const char *folder,
                const char *glob, char *paths[6])
{
    static const char *const axes[6] = {"posx", "negx", "posy", "negy", "posz", "negz"};
    DIR *dir = opendir(folder);
    if (!dir) return prt_fail(ctx, PRT_IO, "%s: cannot read the folder %s", pattern, folder);
    int err = PRT_OK;
    for (struct dirent *e; !err && (e = readdir(dir));) {
        int face;
        if (!word_of(e->d_name, &face) || e->d_name[0] == '.' || fnmatch(glob, e->d_name, 0))
            continue;
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

bool prt_face_has_axis_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    int face;
    const char *word = word_of(slash ? slash + 1 : path, &face);
    return word && strpbrk(word, "xyz");
}

bool prt_faces_parse(const char *word, enum prt_faces *out)
{
    static const char *const names[] = {"guess", "camera", "gl", "d3d", "three"};
    for (int i = 0; i < 5; i++)
        if (!strcmp(word, names[i])) {
            *out = (enum prt_faces)i;
            return true;
        }
    return false;
}

/* The cube has OpenGL's axes. A camera view is its face mirrored left to right at the sides and
 * top to bottom at +Y and -Y. Looking up with (x,y,-z) swaps the faces +Z and -Z of camera
 * views; with (-x,y,z) it swaps +X and -X and mirrors every face left to right. */
struct prt_face_place prt_face_place(enum prt_faces faces, unsigned face)
{
    const bool cap = face == 2 || face == 3;
    switch (faces) {
    case PRT_FACES_GL:
        return (struct prt_face_place){face, false, false};
    case PRT_FACES_D3D:
        return (struct prt_face_place){face >= 4 ? 9 - face : face, !cap, cap};
    case PRT_FACES_THREE:
        return (struct prt_face_place){face < 2 ? 1 - face : face, true, false};
    default:
        return (struct prt_face_place){face, !cap, cap};
    }
}

/* The texel of a cube that was filled by CAMERA at coordinates (s,t) of a face when its
 * pictures are read by `faces`. Coordinates beyond an edge continue on the neighbour. */
static const float *texel_of(const struct prt_cube *cube, enum prt_faces faces, unsigned face,
                             double s, double t)
{
    float dir[3], fs, ft;
    unsigned at;
    prt_cube_direction(face, s, t, dir);
    prt_cube_lookup(dir, &at, &fs, &ft);
    for (unsigned named = 0; named < 6; named++) {
        const struct prt_face_place place = prt_face_place(faces, named);
        const struct prt_face_place own = prt_face_place(PRT_FACES_CAMERA, named);
        if (place.face != at) continue;
        const float x = place.flip_x != own.flip_x ? -fs : fs;
        const float y = place.flip_y != own.flip_y ? -ft : ft;
        const uint32_t n = cube->n;
        const uint32_t px = (uint32_t)fminf(fmaxf((x + 1) / 2 * (float)n, 0), (float)n - 1);
        const uint32_t py = (uint32_t)fminf(fmaxf((y + 1) / 2 * (float)n, 0), (float)n - 1);
        return cube->texel + (((size_t)named * n + py) * n + px) * 3;
    }
    return cube->texel;
}

static double log_difference(const float *a, const float *b)
{
    const double p = 1e-4 + (double)a[0] + (double)a[1] + (double)a[2];
    const double q = 1e-4 + (double)b[0] + (double)b[1] + (double)b[2];
    return fabs(log(p / q));
}

/* Mean step across the edges of the four sides, of log radiance. */
static double edge_cost(const struct prt_cube *cube, enum prt_faces faces)
{
    static const unsigned side[4] = {0, 1, 4, 5};
    const double in = 1 - 1.0 / cube->n, out = 1 + 1.0 / cube->n;
    double sum = 0;
    for (int i = 0; i < 4; i++)
        for (uint32_t k = 0; k < cube->n; k++) {
            const double along = (2 * k + 1.0) / cube->n - 1;
            const double edge[4][2] = {{1, 0}, {-1, 0}, {0, 1}, {0, -1}};
            for (int e = 0; e < 4; e++) {
                const double *d = edge[e], s = d[0] != 0 ? 0 : along, t = d[0] != 0 ? along : 0;
                const float *a = texel_of(cube, faces, side[i], s + in * d[0], t + in * d[1]);
                const float *b = texel_of(cube, faces, side[i], s + out * d[0], t + out * d[1]);
                sum += log_difference(a, b);
            }
        }
    return sum / (16.0 * cube->n);
}

enum prt_faces prt_faces_by_edges(const struct prt_cube *cube)
{
    /* 1.2: chosen, not measured; wrong edges cost several times the right ones */
    return edge_cost(cube, PRT_FACES_CAMERA) > 1.2 * edge_cost(cube, PRT_FACES_THREE) + 1e-6
               ? PRT_FACES_THREE
               : PRT_FACES_CAMERA;
}
