// SPDX-License-Identifier: MIT
// The bytes of a glTF: buffers in files, which tinygltf reads through prt_gltf_read_external,
// and bufferViews, some of them compressed with meshoptimizer. Opens no file outside the
// model's folder.
#include "gltf.h"

#include <meshoptimizer.h>
#include <string.h>

int prt_gltf_read_external(void *user, const char *name, void **bytes, size_t *n)
{
    struct gltf *g = user;
    struct prt_blob blob = {NULL, 0};
    uint64_t want = g->n_opened < g->n_external ? g->external[g->n_opened] : UINT64_MAX;
    if (g->file_status ||
        (g->file_status = prt_draft_file(g->d, g->d->ctx, "buffer", name,
                                         g->d->max_bytes - g->loaded_bytes, &blob)))
        return g->file_status;
    if (want != UINT64_MAX && want > blob.size) {
        prt_free(blob.bytes);
        return g->file_status =
                   prt_gltf_bad(g, "buffer file \"%.80s\": %llu bytes declared, %zu there",
                                name, (unsigned long long)want, blob.size);
    }
    g->n_opened++;
    g->loaded_bytes += blob.size;
    *bytes = blob.bytes;
    *n = want < blob.size ? (size_t)want
                          : blob.size; // glTF allows a longer file, tinygltf does not
    return PRT_OK;
}

// [offset, offset + length) of a buffer
static int slice(const struct gltf *g, size_t view, const struct prt_gltf_slice *s,
                 struct gltf_bytes *out)
{
    if (s->buffer < 0 || (uint64_t)s->buffer >= g->file.n_buffer)
        return prt_gltf_bad(g, "bufferView %zu: names buffer %lld of %zu", view,
                            (long long)s->buffer, g->file.n_buffer);
    const struct prt_gltf_buffer *b = &g->file.buffer[s->buffer];
    if (s->buffer > 0 &&
        !b->has_uri) // tinygltf gives the BIN chunk to every buffer without a URI
        return prt_gltf_bad(g, "buffer %lld: has no data", (long long)s->buffer);
    if (s->offset < 0 || s->length < 0)
        return prt_gltf_bad(g, "bufferView %zu: its offset or length is not a whole number",
                            view);
    uint64_t offset = (uint64_t)s->offset, length = (uint64_t)s->length;
    if (offset > b->n || length > b->n - offset)
        return prt_gltf_bad(g, "bufferView %zu: reads %llu bytes past buffer %lld", view,
                            (unsigned long long)(offset + length - b->n), (long long)s->buffer);
    *out = (struct gltf_bytes){b->at + offset, (size_t)length, 0, true};
    return PRT_OK;
}

static bool meshopt_filter(const char *filter, void *out, size_t count, size_t stride)
{
    if (!*filter || !strcmp(filter, "NONE")) return true;
    if (!strcmp(filter, "OCTAHEDRAL") && (stride == 4 || stride == 8))
        meshopt_decodeFilterOct(out, count, stride);
    else if (!strcmp(filter, "QUATERNION") && stride == 8)
        meshopt_decodeFilterQuat(out, count, stride);
    else if (!strcmp(filter, "EXPONENTIAL") && stride % 4 == 0)
        meshopt_decodeFilterExp(out, count, stride);
    else return false;
    return true;
}

// EXT_meshopt_compression: the view's bytes are decoded from another buffer.
static int load_meshopt(struct gltf *g, size_t view, struct gltf_bytes *out)
{
    const struct prt_gltf_view *v = &g->file.view[view];
    struct gltf_bytes source;
    int status = slice(g, view, &v->packed, &source);
    if (status) return status;
    bool attributes = !strcmp(v->mode, "ATTRIBUTES"), triangles = !strcmp(v->mode, "TRIANGLES");
    bool ok = v->packed_count > 0 && v->packed_count <= 1 << 30 && v->packed_stride > 0 &&
              v->packed_stride <= 256;
    size_t count = ok ? (size_t)v->packed_count : 0, stride = ok ? (size_t)v->packed_stride : 0;
    ok = ok && source.n &&
         (attributes ? stride % 4 == 0
                     : (triangles || !strcmp(v->mode, "INDICES")) &&
                           (stride == 2 || stride == 4) && !(triangles && count % 3));
    if (!ok)
        return prt_gltf_bad(g, "bufferView %zu: impossible EXT_meshopt_compression settings",
                            view);
    uint64_t bytes = (uint64_t)count * stride;
    if (bytes + g->loaded_bytes > g->d->max_bytes)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: bufferView %zu: needs more than %llu MB",
                        g->d->name, view, (unsigned long long)(g->d->max_bytes >> 20));
    uint8_t *to = prt_gltf_own(g, bytes);
    if (!to) return prt_gltf_no_memory(g);
    g->loaded_bytes += bytes;
    int bad = attributes  ? meshopt_decodeVertexBuffer(to, count, stride, source.at, source.n)
              : triangles ? meshopt_decodeIndexBuffer(to, count, stride, source.at, source.n)
                          : meshopt_decodeIndexSequence(to, count, stride, source.at, source.n);
    if (bad || (attributes && !meshopt_filter(v->filter, to, count, stride)))
        return prt_gltf_bad(g, "bufferView %zu: damaged EXT_meshopt_compression data", view);
    *out = (struct gltf_bytes){to, (size_t)bytes, stride, true};
    return PRT_OK;
}

int prt_gltf_view(struct gltf *g, size_t index, struct gltf_bytes *out)
{
    struct gltf_bytes *b = &g->view_bytes[index];
    if (!b->known) {
        const struct prt_gltf_view *v = &g->file.view[index];
        int status = v->meshopt ? load_meshopt(g, index, b) : slice(g, index, &v->slice, b);
        if (status) return status;
        if (v->stride > 1 << 20)
            return prt_gltf_bad(g, "bufferView %zu: byteStride is too large", index);
        if (v->stride) b->stride = (size_t)v->stride;
    }
    *out = *b;
    return PRT_OK;
}
