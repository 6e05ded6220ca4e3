// SPDX-License-Identifier: MIT
// glTF 2.0 files: the GLB container, the JSON, versions and extensions.
#include "gltf.h"

#include "gltf_pose.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Extensions that a file may require: those that are read here, and those that do not change
// the geometry.
static const char *const supported[] = {
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_materials_", // a prefix: all of these
};

int prt_gltf_bad(const struct gltf *g, const char *fmt, ...)
{
    char line[512];
    va_list args;
    va_start(args, fmt);
    vsnprintf(line, sizeof line, fmt, args);
    va_end(args);
    return prt_fail(g->d->ctx, PRT_FORMAT, "%s: %s", g->d->name, line);
}

int prt_gltf_no_memory(const struct gltf *g)
{
    return prt_fail(g->d->ctx, PRT_NOMEM, "%s: no memory", g->d->name);
}

void *prt_gltf_own(struct gltf *g, uint64_t bytes)
{
    if (bytes > g->d->max_bytes) return NULL;
    struct gltf_owned *p = calloc(1, sizeof *p + (size_t)bytes + 8);
    if (!p) return NULL;
    p->next = g->owned;
    g->owned = p;
    return p + 1;
}

static uint32_t u32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static void put32(uint8_t *p, uint32_t x)
{
    for (int i = 0; i < 4; i++) p[i] = (uint8_t)(x >> 8 * i);
}

static int open_glb(struct gltf *g, uint8_t *bytes, size_t n, char **json, size_t *json_n)
{
    if (n < 20) return prt_gltf_bad(g, "the GLB header is cut off");
    uint32_t version = u32(bytes + 4), length = u32(bytes + 8);
    if (version != 2)
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: GLB version %u, only 2 is known",
                        g->d->name, version);
    if (length > n || length < 20)
        return prt_gltf_bad(g, "the GLB header declares %u bytes, the file has %zu", length, n);
    if (length < n)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %zu bytes after the end of the GLB are ignored", g->d->name, n - length);
    g->is_glb = g->plain = true;
    g->glb_n = length;
    for (size_t at = 12, chunk = 0; at < length; chunk++) {
        if (length - at < 8) return prt_gltf_bad(g, "GLB chunk %zu is cut off", chunk);
        size_t size = u32(bytes + at), type = u32(bytes + at + 4);
        if (size > length - at - 8)
            return prt_gltf_bad(g, "GLB chunk %zu declares %zu bytes, %zu are left", chunk,
                                size, length - at - 8);
        if (chunk == 0) {
            if (type != 0x4e4f534a) return prt_gltf_bad(g, "the first GLB chunk is not JSON");
            *json = (char *)bytes + at + 8;
            *json_n = size;
        } else if (type == 0x004e4942 && !g->bin.known) {
            g->bin = (struct gltf_bytes){bytes + at + 8, size, 0, true};
        }
        g->plain &= size % 4 == 0 && (chunk == 0 || (size && (chunk > 1 || g->bin.known)));
        at += 8 + ((size + 3) & ~(size_t)3);
    }
    return PRT_OK;
}

// Builds a GLB with the chunks that tinygltf accepts: JSON, then BIN unless it is empty.
static int build_glb(const struct gltf *g, const char *json, size_t json_n, void **out,
                     size_t *out_n)
{
    size_t a = (json_n + 3) & ~(size_t)3, b = (g->bin.n + 3) & ~(size_t)3;
    size_t n = 20 + a + (b ? 8 + b : 0);
    if (n > UINT32_MAX || n > g->d->max_bytes)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: %zu bytes are too many for a GLB",
                        g->d->name, n);
    uint8_t *to = calloc(1, n);
    if (!to) return prt_gltf_no_memory(g);
    memcpy(to, "glTF\2\0\0\0", 8);
    put32(to + 8, (uint32_t)n);
    put32(to + 12, (uint32_t)a);
    memcpy(to + 16, "JSON", 4);
    memset(to + 20, ' ', a);
    memcpy(to + 20, json, json_n);
    if (b) {
        put32(to + 20 + a, (uint32_t)b);
        memcpy(to + 24 + a, "BIN", 4);
        memcpy(to + 28 + a, g->bin.at, g->bin.n);
    }
    *out = to;
    *out_n = n;
    return PRT_OK;
}

static int check_head(const struct gltf *g)
{
    const struct prt_gltf_document *f = &g->file;
    if (f->version &&
        (f->version[0] != '2' || (*f->min_version && strcmp(f->min_version, "2.0"))))
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: glTF version %.16s, only 2.0 is known",
                        g->d->name, *f->min_version ? f->min_version : f->version);
    for (size_t k = 0; k < f->n_required; k++) {
        bool known = false;
        for (size_t i = 0; i < sizeof supported / sizeof *supported; i++)
            known |= supported[i][strlen(supported[i]) - 1] == '_'
                         ? !strncmp(f->required[k], supported[i], strlen(supported[i]))
                         : !strcmp(f->required[k], supported[i]);
        if (!known)
            return prt_fail(g->d->ctx, PRT_UNSUPPORTED,
                            "%s: the file requires the extension %.80s, which is not supported",
                            g->d->name, f->required[k]);
    }
    return PRT_OK;
}

static int run_tinygltf(struct gltf *g, const void *bytes, size_t n)
{
    const struct prt_gltf_files files = {g, prt_gltf_read_external, prt_free};
    char say[240];
    if (n > UINT32_MAX)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: %zu bytes of JSON are too many", g->d->name,
                        n);
    int refused =
        prt_gltf_parse(bytes, (uint32_t)n, g->is_glb, &files, &g->file, say, sizeof say);
    if (g->file_status) return g->file_status;
    if (refused == PRT_GLTF_NO_MEMORY) return prt_gltf_no_memory(g);
    int status = check_head(g);
    if (status) return status;
    if (refused) return prt_gltf_bad(g, "is damaged: %s", *say ? say : "tinygltf refuses it");
    if (*say) prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: tinygltf: %s", g->d->name, say);
    return PRT_OK;
}

// json points into bytes; both are changed.
static int parse(struct gltf *g, uint8_t *bytes, size_t n, char *json, size_t json_n)
{
    char *other = NULL;
    void *built = NULL;
    while (json_n && (!json[json_n - 1] || isspace((unsigned char)json[json_n - 1])))
        json[--json_n] = ' '; // some exporters pad with zeros
    if (!json_n) return prt_gltf_bad(g, "the glTF JSON is empty");
    const size_t copy_n = json_n;
    char *copy = prt_gltf_textures_copy(g, json, json_n);
    int status = prt_gltf_scan(g, json, json_n);
    if (status) free(copy);
    else status = prt_gltf_textures_begin(g, copy, copy_n);
    if (!status && prt_gltf_needs_rewrite(json, json_n)) {
        status = prt_gltf_rewrite(g, json, json_n, &other);
        json = other;
        json_n = other ? strlen(other) : 0;
    }
    if (!status && g->is_glb && (other || !g->plain))
        status = build_glb(g, json, json_n, &built, &n);
    if (!status) {
        if (built) status = run_tinygltf(g, built, n);
        else
            status =
                g->is_glb ? run_tinygltf(g, bytes, g->glb_n) : run_tinygltf(g, json, json_n);
    }
    free(built);
    free(other);
    return status;
}

static int make_tables(struct gltf *g)
{
    size_t n_view = g->file.n_view, n_surface = g->file.n_material + 1;
    g->view_bytes = prt_gltf_own(g, n_view * sizeof *g->view_bytes);
    g->draco = prt_gltf_own(g, n_view * sizeof *g->draco);
    g->surface_of = prt_gltf_own(g, n_surface * sizeof *g->surface_of);
    g->opaque_of = prt_gltf_own(g, n_surface * sizeof *g->opaque_of);
    g->colored = prt_gltf_own(g, 2 * n_surface);
    if (!g->view_bytes || !g->draco || !g->surface_of || !g->opaque_of || !g->colored)
        return prt_gltf_no_memory(g);
    memset(g->surface_of, 0xff, n_surface * sizeof *g->surface_of);
    memset(g->opaque_of, 0xff, n_surface * sizeof *g->opaque_of);
    return PRT_OK;
}

static void log_notes(const struct gltf *g)
{
    if (g->n_skipped)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: %u primitives of points or lines, or without positions, are not loaded",
                g->d->name, g->n_skipped);
    if (g->n_deformed && !g->pose)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: skins and morph targets are not applied: the bind pose is used",
                g->d->name);
    if (g->n_deformed && g->pose)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: skins of %u Draco primitives are not applied: they keep their bind pose",
                g->d->name, g->n_deformed);
    if (g->n_channel_skipped)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u channels of the animation change something else than nodes and morph "
                "weights; they are left out",
                g->d->name, g->n_channel_skipped);
    if (g->n_bad_normal)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u normals have no direction; they are computed from the triangles",
                g->d->name, g->n_bad_normal);
    if (g->n_flat)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u primitives have a node of scale 0: they are flat and have no thickness",
                g->d->name, g->n_flat);
    if (g->n_tail)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: the last triangle of %u primitives is incomplete and not loaded",
                g->d->name, g->n_tail);
}

static void release(struct gltf *g)
{
    for (size_t i = 0; g->draco && i < g->file.n_view; i++) prt_gltf_drop_draco(g, i);
    prt_gltf_textures_end(g);
    prt_gltf_free(&g->file);
    for (struct gltf_owned *p = g->owned, *next; p; p = next) {
        next = p->next;
        free(p);
    }
}

int prt_read_gltf(struct prt_draft *d, uint8_t *bytes, size_t n)
{
    struct gltf g = {.d = d};
    char *json = (char *)bytes;
    size_t json_n = n;
    int status =
        n >= 4 && !memcmp(bytes, "glTF", 4) ? open_glb(&g, bytes, n, &json, &json_n) : PRT_OK;
    d->units_known = true;
    if (!status) status = parse(&g, bytes, n, json, json_n);
    if (!status) status = make_tables(&g);
    if (!status) status = prt_gltf_animations(&g);
    if (!status) status = prt_gltf_variants(&g);
    if (!status && prt_gltf_needs_pose(&g)) status = prt_gltf_pose_begin(&g);
    if (!status) status = prt_gltf_walk(&g);
    if (!status) prt_gltf_settle_surfaces(&g);
    if (!status) log_notes(&g);
    release(&g);
    return status;
}
