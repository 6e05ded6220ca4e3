// SPDX-License-Identifier: MIT
// Loading: detects the format and runs its reader in a child process with limits.
#include "internal.h"

#include <ctype.h>
#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

// Input of the child.
struct request {
    int fd; // of the file; -1: `bytes` holds it
    const void *bytes;
    size_t n;
    const char *name, *base_dir;
    const struct prt_mesh_options *options;
    uint64_t max_bytes;
};

static const char *skip_space(const char *p, const char *end)
{
    if (end - p >= 3 && !memcmp(p, "\xef\xbb\xbf", 3)) p += 3;
    while (p < end && isspace((unsigned char)*p)) p++;
    return p;
}

// OBJ has no signature: it is text with a vertex line in its first MiB.
static bool looks_like_obj(const char *p, size_t n)
{
    if (n > 1 << 20) n = 1 << 20;
    if (memchr(p, 0, n)) return false;
    for (const char *end = p + n; p && p < end;) {
        while (p < end && (*p == ' ' || *p == '\t')) p++;
        if (end - p > 2 && *p == 'v' && (p[1] == ' ' || p[1] == '\t')) return true;
        p = memchr(p, '\n', (size_t)(end - p));
        if (p) p++;
    }
    return false;
}

static bool looks_like_text_stl(const char *p, const char *end)
{
    return end - p > 6 && !strncasecmp(p, "solid", 5) && isspace((unsigned char)p[5]) &&
           !memchr(p, 0, (size_t)(end - p));
}

static bool ends_with(const char *name, const char *end)
{
    size_t n = strlen(name), m = strlen(end);
    return n >= m && !strcasecmp(name + n - m, end);
}

static int read_any(struct prt_draft *d, char *bytes, size_t n)
{
    const char *start = skip_space(bytes, bytes + n);
    if (n >= 4 && !memcmp(bytes, "glTF", 4)) return prt_read_gltf(d, (uint8_t *)bytes, n);
    if (n >= 4 && !memcmp(bytes, "ply", 3) && isspace((unsigned char)bytes[3]))
        return prt_read_ply(d, bytes, n);
    if (start < bytes + n && *start == '{') return prt_read_gltf(d, (uint8_t *)bytes, n);
    if (prt_is_binary_stl(bytes, n) || looks_like_text_stl(start, bytes + n))
        return prt_read_stl(d, bytes, n);
    if (looks_like_obj(bytes, n)) return prt_read_obj(d, bytes, n);
    if (ends_with(d->name, ".stl")) return prt_read_stl(d, bytes, n); // its faults are named
    return prt_fail(d->ctx, PRT_FORMAT, "%s: not a glTF, GLB, OBJ, PLY or STL model", d->name);
}

static int check_opaque(const struct prt_draft *d)
{
    for (int i = 0; i < 64 && d->opaque && d->opaque[i]; i++)
        if (!(d->opaque_hit >> i & 1))
            return prt_fail(d->ctx, PRT_ARG, "%s: has no material or node named \"%s\"",
                            d->name, d->opaque[i]);
    return PRT_OK;
}

static int read_draft(const struct prt_context *ctx, const struct request *r,
                      struct prt_blob *file, struct prt_blob *out)
{
    struct prt_draft d = {.ctx = ctx,
                          .name = r->name,
                          .base_dir = r->base_dir,
                          .max_vertices = 50000000,
                          .max_triangles = 100000000,
                          .n_uv = 1,
                          .max_bytes = r->max_bytes};
    bool up_z = r->options && r->options->up_z, flip_v = r->options && r->options->flip_v;
    if (r->options) {
        d.opaque = r->options->opaque;
        if (r->options->max_vertices) d.max_vertices = r->options->max_vertices;
        if (r->options->max_triangles) d.max_triangles = r->options->max_triangles;
        d.no_textures = r->options->no_textures;
        d.animation = r->options->animation;
        d.animation_time = r->options->time_s;
        d.variant = r->options->variant;
    }
    if (d.max_vertices > 1u << 29) d.max_vertices = 1u << 29;
    if (d.max_triangles > 1u << 29) d.max_triangles = 1u << 29;
    int status = read_any(&d, file->bytes, file->size);
    if (!status && d.variant && !d.n_variant)
        status = prt_fail(ctx, PRT_ARG, "%s has no variants: leave the variant out", r->name);
    if (!status && d.animation && !d.n_animation)
        status = prt_fail(ctx, PRT_ARG, "%s has no animations: leave --animation out", r->name);
    if (!status && !d.n_triangle)
        status = prt_fail(ctx, PRT_FORMAT, "%s: has no triangles", r->name);
    if (!status) status = check_opaque(&d);
    if (!status && flip_v) prt_draft_flip_v(&d);
    if (!status) prt_draft_place(&d, up_z);
    if (!status) status = prt_blob_pack(&d, out);
    prt_draft_finish(&d);
    return status;
}

static int parse(const struct prt_context *ctx, void *arg, struct prt_blob *out)
{
    const struct request *r = arg;
    struct prt_blob file = {NULL, 0};
    int status;
    if (r->fd >= 0) {
        bool here = r->options && r->options->in_process;
        status =
            prt_read_fd(ctx, r->name, here ? r->fd : PRT_ISOLATE_INPUT_FD, r->max_bytes, &file);
        if (status) return status;
    } else {
        if (!r->n) return prt_fail(ctx, PRT_FORMAT, "%s: the file is empty", r->name);
        if (r->n > r->max_bytes)
            return prt_fail(ctx, PRT_LIMIT, "%s: the file has %zu bytes, the limit is %llu",
                            r->name, r->n, (unsigned long long)r->max_bytes);
        char *copy = prt_alloc(r->n + 1, 1); // the text readers need a NUL at the end
        if (!copy)
            return prt_fail(ctx, PRT_NOMEM, "%s: no memory for %zu bytes", r->name, r->n);
        memcpy(copy, r->bytes, r->n);
        copy[r->n] = 0;
        file = (struct prt_blob){copy, r->n};
    }
    status = read_draft(ctx, r, &file, out);
    prt_free(file.bytes);
    return status;
}

// glTF has buffers and images beside it, OBJ its materials: nothing beside a PLY is read.
static bool may_have_siblings(const struct request *r)
{
    char head[4096];
    ssize_t n = r->n < sizeof head ? (ssize_t)r->n : (ssize_t)sizeof head;
    if (r->fd >= 0) n = pread(r->fd, head, sizeof head, 0);
    else if (n) memcpy(head, r->bytes, (size_t)n);
    return n >= 4 && memcmp(head, "ply", 3) != 0;
}

static int load(const struct prt_context *ctx, struct request *r, struct prt_mesh **out)
{
    struct stat st;
    struct prt_blob blob = {NULL, 0};
    struct prt_mesh *mesh = NULL;
    r->max_bytes = ctx && ctx->memory_limit ? ctx->memory_limit : 8ull << 30;
    if (r->fd >= 0 && (fstat(r->fd, &st) || !S_ISREG(st.st_mode)))
        return prt_fail(ctx, PRT_IO, "%s: not a regular file", r->name);
    struct prt_isolate_limits limits = {.memory_bytes = r->max_bytes,
                                        .seconds = 120,
                                        .input_fd = r->fd,
                                        .folder = may_have_siblings(r) ? r->base_dir : NULL};
    int status = r->options && r->options->in_process
                     ? parse(ctx, r, &blob)
                     : prt_isolate(ctx, r->name, &limits, parse, r, &blob);
    if (status) return status;
    status = prt_blob_open(ctx, r->name, &blob, &mesh);
    if (status) {
        prt_free(blob.bytes);
        return status;
    }
    status = prt_mesh_finish(ctx, r->name, mesh);
    if (status) {
        prt_mesh_destroy(mesh);
        return status;
    }
    *out = mesh;
    return PRT_OK;
}

int prt_mesh_load_fd(const struct prt_context *ctx, const char *name, int fd,
                     const char *base_dir, const struct prt_mesh_options *options,
                     struct prt_mesh **out)
{
    struct request r = {.fd = fd, .name = name, .base_dir = base_dir, .options = options};
    return load(ctx, &r, out);
}

int prt_mesh_load(const struct prt_context *ctx, const char *path,
                  const struct prt_mesh_options *options, struct prt_mesh **out)
{
    char folder[PATH_MAX];
    if (snprintf(folder, sizeof folder, "%s", path) >= (int)sizeof folder)
        return prt_fail(ctx, PRT_IO, "%s: the path is too long", path);
    // O_NONBLOCK: opening a pipe would otherwise wait for a writer.
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
    if (fd < 0) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    int status = prt_mesh_load_fd(ctx, path, fd, dirname(folder), options, out);
    close(fd);
    return status;
}

int prt_mesh_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                         size_t n, const char *base_dir, const struct prt_mesh_options *options,
                         struct prt_mesh **out)
{
    struct request r = {.fd = -1,
                        .bytes = bytes,
                        .n = n,
                        .name = name,
                        .base_dir = base_dir,
                        .options = options};
    return load(ctx, &r, out);
}
