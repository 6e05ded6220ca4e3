// SPDX-License-Identifier: MIT
// glTF 2.0 files: the GLB container, the JSON, versions and extensions.
#include "gltf.h"

#include "draco.h"

#include <ctype.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_DEPTH = 200 };

// Extensions that may be required: those we read, and those that change nothing in geometry.
static const char *const supported[] = {
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
    "KHR_materials_", // all of them: a prefix
};

static uint32_t u32(const uint8_t *p)
{
    return p[0] | (uint32_t)p[1] << 8 | (uint32_t)p[2] << 16 | (uint32_t)p[3] << 24;
}

static int open_glb(struct gltf *g, const uint8_t *bytes, size_t n, const char **json,
                    size_t *json_n)
{
    if (n < 20) return gltf_bad(g, "the GLB header is cut off");
    uint32_t version = u32(bytes + 4), length = u32(bytes + 8);
    if (version != 2)
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: GLB version %u, only 2 is known",
                        g->d->name, version);
    if (length > n || length < 20)
        return gltf_bad(g, "the GLB header says %u bytes, the file has %zu", length, n);
    if (length < n)
        prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: %zu bytes after its end are ignored",
                g->d->name, n - length);
    for (size_t at = 12, chunk = 0; at < length; chunk++) {
        if (length - at < 8) return gltf_bad(g, "GLB chunk %zu is cut off", chunk);
        size_t size = u32(bytes + at), type = u32(bytes + at + 4);
        if (size > length - at - 8)
            return gltf_bad(g, "GLB chunk %zu says %zu bytes, %zu are left", chunk, size,
                            length - at - 8);
        if (chunk == 0) {
            if (type != 0x4e4f534a) return gltf_bad(g, "its first chunk is not JSON");
            *json = (const char *)bytes + at + 8;
            *json_n = size;
        } else if (type == 0x004e4942 && !g->bin.known) {
            g->bin = (struct gltf_bytes){bytes + at + 8, size, 0, true};
        }
        at += 8 + ((size + 3) & ~(size_t)3);
    }
    return PRT_OK;
}

// cJSON recurses: the depth is bounded before it sees the text.
static int scan_depth(const struct gltf *g, const char *json, size_t n)
{
    size_t depth = 0;
    bool in_text = false;
    for (size_t i = 0; i < n; i++) {
        char c = json[i];
        if (!c) return gltf_bad(g, "a zero byte inside its JSON");
        if (in_text) {
            if (c == '\\') i++;
            else if (c == '"') in_text = false;
        } else if (c == '"') {
            in_text = true;
        } else if (c == '[' || c == '{') {
            if (++depth > MAX_DEPTH)
                return gltf_bad(g, "its JSON nests deeper than %d", MAX_DEPTH);
        } else if ((c == ']' || c == '}') && depth) {
            depth--;
        }
    }
    return PRT_OK;
}

static int parse_json(struct gltf *g, const char *json, size_t n)
{
    const char *end = NULL;
    while (n && (!json[n - 1] || isspace((unsigned char)json[n - 1]))) n--; // padding
    if (!n) return gltf_bad(g, "its JSON is empty");
    int status = scan_depth(g, json, n);
    if (status) return status;
    g->json = cJSON_ParseWithLengthOpts(json, n, &end, 0);
    if (!g->json || end != json + n)
        return gltf_bad(g, "its JSON is damaged near byte %zu", end ? (size_t)(end - json) : 0);
    if (!cJSON_IsObject(g->json)) return gltf_bad(g, "its JSON is not an object");
    return PRT_OK;
}

static int check_head(struct gltf *g)
{
    const cJSON *asset = gltf_member(g->json, "asset"), *item;
    const char *version = gltf_text(asset, "version"), *least = gltf_text(asset, "minVersion");
    if (!version) return gltf_bad(g, "has no asset.version: not glTF 2.0");
    if (version[0] != '2' || (least && strcmp(least, "2.0")))
        return prt_fail(g->d->ctx, PRT_UNSUPPORTED, "%s: glTF version %.16s, only 2.0 is known",
                        g->d->name, least ? least : version);
    cJSON_ArrayForEach(item, gltf_member(g->json, "extensionsRequired"))
    {
        bool known = false;
        for (size_t i = 0; cJSON_IsString(item) && i < sizeof supported / sizeof *supported;
             i++)
            known |= supported[i][strlen(supported[i]) - 1] == '_'
                         ? !strncmp(item->valuestring, supported[i], strlen(supported[i]))
                         : !strcmp(item->valuestring, supported[i]);
        if (!known)
            return prt_fail(g->d->ctx, PRT_UNSUPPORTED,
                            "%s: it requires the extension %.80s, which is not supported",
                            g->d->name, cJSON_IsString(item) ? item->valuestring : "?");
    }
    return PRT_OK;
}

static int read_tables(struct gltf *g)
{
    int status;
    if ((status = gltf_table(g, "buffers", &g->buffer)) ||
        (status = gltf_table(g, "bufferViews", &g->view)) ||
        (status = gltf_table(g, "accessors", &g->accessor)) ||
        (status = gltf_table(g, "meshes", &g->mesh)) ||
        (status = gltf_table(g, "materials", &g->material)) ||
        (status = gltf_table(g, "nodes", &g->node)) ||
        (status = gltf_table(g, "scenes", &g->scene)))
        return status;
    g->buffer_bytes = gltf_own(g, g->buffer.n * sizeof *g->buffer_bytes);
    g->view_bytes = gltf_own(g, g->view.n * sizeof *g->view_bytes);
    g->draco = gltf_own(g, g->view.n * sizeof *g->draco);
    g->surface_of = gltf_own(g, (g->material.n + 1) * sizeof *g->surface_of);
    g->opaque_of = gltf_own(g, (g->material.n + 1) * sizeof *g->opaque_of);
    if (!g->buffer_bytes || !g->view_bytes || !g->draco || !g->surface_of || !g->opaque_of)
        return gltf_no_memory(g);
    memset(g->surface_of, 0xff, (g->material.n + 1) * sizeof *g->surface_of);
    memset(g->opaque_of, 0xff, (g->material.n + 1) * sizeof *g->opaque_of);
    return PRT_OK;
}

static void tell(const struct gltf *g)
{
    if (g->n_skipped)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: %u primitives of points or lines, or without positions, are left out",
                g->d->name, g->n_skipped);
    if (g->n_deformed)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: skins and morph targets are not applied: the bind pose is used",
                g->d->name);
    if (g->n_bad_normal)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u normals have no direction and are made from the triangles", g->d->name,
                g->n_bad_normal);
    if (g->n_flat)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: %u primitives are flattened by a node of scale 0: they have no thickness",
                g->d->name, g->n_flat);
    if (g->n_tail)
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: the last triangle of %u primitives is incomplete and left out", g->d->name,
                g->n_tail);
}

static void release(struct gltf *g)
{
    for (size_t i = 0; g->draco && i < g->view.n; i++)
        if (g->draco[i]) {
            struct prt_draco m = {.position = g->draco[i]->position,
                                  .normal = g->draco[i]->normal,
                                  .uv = g->draco[i]->uv,
                                  .triangle = g->draco[i]->triangle};
            prt_draco_free(&m);
        }
    cJSON_Delete(g->json);
    for (struct gltf_owned *p = g->owned, *next; p; p = next) {
        next = p->next;
        free(p);
    }
}

int prt_read_gltf(struct prt_draft *d, const uint8_t *bytes, size_t n)
{
    struct gltf g = {.d = d};
    const char *json = (const char *)bytes;
    size_t json_n = n;
    int status =
        n >= 4 && !memcmp(bytes, "glTF", 4) ? open_glb(&g, bytes, n, &json, &json_n) : PRT_OK;
    d->units_known = true;
    if (!status) status = parse_json(&g, json, json_n);
    if (!status) status = check_head(&g);
    if (!status) status = read_tables(&g);
    if (!status) status = gltf_walk(&g);
    if (!status) gltf_settle_surfaces(&g);
    if (!status) tell(&g);
    release(&g);
    return status;
}
