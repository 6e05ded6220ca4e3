// SPDX-License-Identifier: MIT
// Files that a model names: buffers, images, material libraries. None outside the model's
// folder is opened.
#include "internal.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// A relative path inside the model's folder: no scheme, no root, no "..".
static bool is_inside(const char *path)
{
    if (!*path || *path == '/' || strlen(path) >= 1024) return false;
    for (const char *p = path; *p; p++)
        if ((unsigned char)*p < 32 || *p == '\\' || *p == ':') return false;
    for (const char *p = path; p; p = strchr(p, '/')) {
        p += *p == '/';
        if (p[0] == '.' && p[1] == '.' && (p[2] == '/' || !p[2])) return false;
    }
    return true;
}

int prt_draft_file(const struct prt_draft *d, const struct prt_context *ctx, const char *kind,
                   const char *path, uint64_t max_bytes, struct prt_blob *out)
{
    char joined[PATH_MAX], base[PATH_MAX], real[PATH_MAX];
    if (!is_inside(path))
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: %s file \"%.80s\" is not a path inside the model's folder",
                        d->name, kind, path);
    if (!d->base_dir)
        return prt_fail(
            ctx, PRT_FORMAT,
            "%s: %s \"%.80s\" is a file of its own, which cannot be read here; send a .glb",
            d->name, kind, path);
    int n = snprintf(joined, sizeof joined, "%s/%s", d->base_dir, path);
    if (n >= (int)sizeof joined)
        return prt_fail(ctx, PRT_FORMAT, "%s: %s file \"%.80s\": the path is too long", d->name,
                        kind, path);
    if (!realpath(d->base_dir, base) || !realpath(joined, real))
        return prt_fail(ctx, PRT_IO, "%s: there is no %s file \"%.80s\"", d->name, kind, path);
    size_t length =
        strlen(base); // symbolic links are resolved: the file must be inside the folder
    if (strncmp(real, base, length) || (real[length] != '/' && strcmp(base, "/")))
        return prt_fail(ctx, PRT_FORMAT,
                        "%s: %s file \"%.80s\" is a link out of the model's folder", d->name,
                        kind, path);
    return prt_read_file(ctx, real, max_bytes, out);
}
