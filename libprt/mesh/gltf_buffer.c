// SPDX-License-Identifier: MIT
// Where a glTF's bytes come from: the GLB chunk, data URIs, files beside the model, and views
// compressed with meshoptimizer. Nothing outside the model's own folder is opened.
#include "gltf.h"

#include <limits.h>
#include <meshoptimizer.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int base64_value(char c)
{
    if (c >= 'A' && c <= 'Z') return c - 'A';
    if (c >= 'a' && c <= 'z') return c - 'a' + 26;
    if (c >= '0' && c <= '9') return c - '0' + 52;
    return c == '+' || c == '-' ? 62 : c == '/' || c == '_' ? 63 : -1;
}

// The bytes' number, or -1 when it is not base64.
static int64_t base64(const char *text, size_t n, uint8_t *out)
{
    size_t at = 0;
    uint32_t bits = 0;
    int have = 0;
    while (n && text[n - 1] == '=') n--;
    for (size_t i = 0; i < n; i++) {
        int v = base64_value(text[i]);
        if (v < 0) return -1;
        bits = bits << 6 | (uint32_t)v;
        have += 6;
        if (have >= 8) {
            have -= 8;
            out[at++] = (uint8_t)(bits >> have);
        }
    }
    return n % 4 == 1 ? -1 : (int64_t)at;
}

static int load_data_uri(struct gltf *g, size_t index, const char *uri, struct gltf_bytes *out)
{
    const char *comma = strchr(uri, ',');
    if (!comma || comma - uri < 7 || memcmp(comma - 7, ";base64", 7))
        return gltf_bad(g, "buffer %zu: its data URI is not base64", index);
    size_t n = strlen(comma + 1);
    uint8_t *bytes = gltf_own(g, n / 4 * 3 + 3);
    if (!bytes) return gltf_no_memory(g);
    int64_t got = base64(comma + 1, n, bytes);
    if (got < 0) return gltf_bad(g, "buffer %zu: damaged base64", index);
    *out = (struct gltf_bytes){bytes, (size_t)got, 0, true};
    return PRT_OK;
}

static int hex(char c)
{
    return c >= '0' && c <= '9'                 ? c - '0'
           : (c | 32) >= 'a' && (c | 32) <= 'f' ? (c | 32) - 87
                                                : -1;
}

// A relative path inside the model's folder: no scheme, no root, no "..".
static bool decode_path(const char *uri, char *out, size_t size)
{
    size_t n = 0;
    for (; *uri; uri++) {
        int c = (unsigned char)*uri;
        if (c == '%') {
            int a = hex(uri[1]), b = a < 0 ? -1 : hex(uri[2]);
            if (b < 0) return false;
            c = a * 16 + b;
            uri += 2;
        }
        if (c < 32 || c == '\\' || c == ':' || n + 1 >= size) return false;
        out[n++] = (char)c;
    }
    out[n] = 0;
    if (!n || out[0] == '/') return false;
    for (char *p = out; p; p = strchr(p, '/')) {
        p += *p == '/';
        if (p[0] == '.' && p[1] == '.' && (p[2] == '/' || !p[2])) return false;
    }
    return true;
}

static int load_file(struct gltf *g, size_t index, const char *uri, struct gltf_bytes *out)
{
    char relative[1024], joined[PATH_MAX], base[PATH_MAX], real[PATH_MAX];
    struct prt_blob blob;
    if (!decode_path(uri, relative, sizeof relative))
        return gltf_bad(g, "buffer %zu: \"%.80s\" is not a path beside the model", index, uri);
    if (!g->d->base_dir)
        return gltf_bad(g, "buffer %zu: \"%.80s\" is outside the file; send a .glb", index,
                        uri);
    int n = snprintf(joined, sizeof joined, "%s/%s", g->d->base_dir, relative);
    if (n >= (int)sizeof joined) return gltf_bad(g, "buffer %zu: path too long", index);
    if (!realpath(g->d->base_dir, base) || !realpath(joined, real))
        return prt_fail(g->d->ctx, PRT_IO, "%s: buffer %zu: there is no file \"%.80s\"",
                        g->d->name, index, relative);
    size_t length = strlen(base); // a link may lead elsewhere
    if (strncmp(real, base, length) || (real[length] != '/' && strcmp(base, "/")))
        return gltf_bad(g, "buffer %zu: \"%.80s\" leads out of the model's folder", index, uri);
    int status = prt_read_file(g->d->ctx, real, g->d->max_bytes - g->loaded_bytes, &blob);
    if (status) return status;
    uint8_t *bytes = gltf_own(g, blob.size);
    if (bytes) memcpy(bytes, blob.bytes, blob.size);
    prt_free(blob.bytes);
    if (!bytes) return gltf_no_memory(g);
    *out = (struct gltf_bytes){bytes, blob.size, 0, true};
    return PRT_OK;
}

int gltf_buffer(struct gltf *g, size_t index, const struct gltf_bytes **out)
{
    uint64_t length;
    struct gltf_bytes *b = &g->buffer_bytes[index];
    *out = b;
    if (b->known) return PRT_OK;
    const cJSON *o = g->buffer.item[index], *uri = gltf_member(o, "uri");
    int status = gltf_number(g, "buffer", index, o, "byteLength", 1ull << 53, 0, &length);
    if (status) return status;
    if (uri && !cJSON_IsString(uri)) return gltf_bad(g, "buffer %zu: uri is no text", index);
    if (!uri) {
        if (index != 0 || !g->bin.known) return gltf_bad(g, "buffer %zu: has no data", index);
        *b = g->bin;
    } else if (!strncmp(uri->valuestring, "data:", 5)) {
        status = load_data_uri(g, index, uri->valuestring, b);
    } else {
        status = load_file(g, index, uri->valuestring, b);
    }
    if (status) return status;
    if (length > b->n) {
        b->known = false;
        return gltf_bad(g, "buffer %zu: declares %llu bytes, there are %zu", index,
                        (unsigned long long)length, b->n);
    }
    if (uri) g->loaded_bytes += b->n;
    b->n = (size_t)length;
    return PRT_OK;
}

// [offset, offset + length) of a buffer
static int slice(struct gltf *g, size_t view, const cJSON *o, struct gltf_bytes *out)
{
    uint64_t buffer, offset, length;
    const struct gltf_bytes *from;
    int status;
    if ((status = gltf_number(g, "bufferView", view, o, "buffer", 1ull << 53, UINT64_MAX,
                              &buffer)) ||
        (status =
             gltf_number(g, "bufferView", view, o, "byteOffset", 1ull << 53, 0, &offset)) ||
        (status = gltf_number(g, "bufferView", view, o, "byteLength", 1ull << 53, 0, &length)))
        return status;
    if (buffer >= g->buffer.n)
        return gltf_bad(g, "bufferView %zu: names buffer %lld of %zu", view, (long long)buffer,
                        g->buffer.n);
    if ((status = gltf_buffer(g, (size_t)buffer, &from))) return status;
    if (offset > from->n || length > from->n - offset)
        return gltf_bad(g, "bufferView %zu: reads %llu bytes past buffer %llu", view,
                        (unsigned long long)(offset + length - from->n),
                        (unsigned long long)buffer);
    *out = (struct gltf_bytes){from->at + offset, (size_t)length, 0, true};
    return PRT_OK;
}

static bool is_text(const cJSON *item, const char *text)
{
    return cJSON_IsString(item) && !strcmp(item->valuestring, text);
}

static bool meshopt_filter(const cJSON *filter, void *out, size_t count, size_t stride)
{
    if (!filter || is_text(filter, "NONE")) return true;
    if (is_text(filter, "OCTAHEDRAL") && (stride == 4 || stride == 8))
        meshopt_decodeFilterOct(out, count, stride);
    else if (is_text(filter, "QUATERNION") && stride == 8)
        meshopt_decodeFilterQuat(out, count, stride);
    else if (is_text(filter, "EXPONENTIAL") && stride % 4 == 0)
        meshopt_decodeFilterExp(out, count, stride);
    else return false;
    return true;
}

// EXT_meshopt_compression: the view's bytes are decoded from another buffer.
static int load_meshopt(struct gltf *g, size_t view, const cJSON *ext, struct gltf_bytes *out)
{
    struct gltf_bytes source;
    uint64_t count, stride;
    int status;
    if ((status = slice(g, view, ext, &source)) ||
        (status = gltf_number(g, "bufferView", view, ext, "count", 1u << 30, 0, &count)) ||
        (status = gltf_number(g, "bufferView", view, ext, "byteStride", 256, 0, &stride)))
        return status;
    const cJSON *mode = gltf_member(ext, "mode"), *filter = gltf_member(ext, "filter");
    bool attributes = is_text(mode, "ATTRIBUTES"), triangles = is_text(mode, "TRIANGLES");
    bool ok = attributes ? stride && stride % 4 == 0
                         : (triangles || is_text(mode, "INDICES")) &&
                               (stride == 2 || stride == 4) && !(triangles && count % 3);
    if (!ok || !count || !source.n)
        return gltf_bad(g, "bufferView %zu: impossible EXT_meshopt_compression settings", view);
    uint64_t bytes = count * stride;
    if (bytes + g->loaded_bytes > g->d->max_bytes)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: bufferView %zu: needs more than %llu MB",
                        g->d->name, view, (unsigned long long)(g->d->max_bytes >> 20));
    uint8_t *to = gltf_own(g, bytes);
    if (!to) return gltf_no_memory(g);
    g->loaded_bytes += bytes;
    int bad = attributes  ? meshopt_decodeVertexBuffer(to, count, stride, source.at, source.n)
              : triangles ? meshopt_decodeIndexBuffer(to, count, stride, source.at, source.n)
                          : meshopt_decodeIndexSequence(to, count, stride, source.at, source.n);
    if (bad || (attributes && !meshopt_filter(filter, to, count, stride)))
        return gltf_bad(g, "bufferView %zu: damaged EXT_meshopt_compression data", view);
    *out = (struct gltf_bytes){to, (size_t)bytes, (size_t)stride, true};
    return PRT_OK;
}

int gltf_view(struct gltf *g, size_t index, struct gltf_bytes *out)
{
    struct gltf_bytes *b = &g->view_bytes[index];
    if (!b->known) {
        const cJSON *o = g->view.item[index];
        const cJSON *ext = gltf_member(gltf_member(o, "extensions"), "EXT_meshopt_compression");
        uint64_t stride = 0;
        int status = ext ? load_meshopt(g, index, ext, b) : slice(g, index, o, b);
        if (!status)
            status = gltf_number(g, "bufferView", index, o, "byteStride", 1u << 20, b->stride,
                                 &stride);
        if (status) {
            b->known = false;
            return status;
        }
        b->stride = (size_t)stride;
    }
    *out = *b;
    return PRT_OK;
}
