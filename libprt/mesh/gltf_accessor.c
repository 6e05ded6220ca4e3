// SPDX-License-Identifier: MIT
// Reading accessors: typed, strided, normalised and sparse, with every bound checked.
#include "gltf.h"

#include <string.h>

static unsigned component_bytes(int type)
{
    switch (type) {
    case 5120:
    case 5121:
        return 1;
    case 5122:
    case 5123:
        return 2;
    case 5125:
    case 5126:
        return 4;
    }
    return 0;
}

int prt_gltf_accessor(const struct gltf *g, int64_t index, struct gltf_accessor *out)
{
    if (index < 0 || (uint64_t)index >= g->file.n_accessor)
        return prt_gltf_bad(g, "accessor %lld does not exist", (long long)index);
    size_t i = (size_t)index;
    const struct prt_gltf_accessor *o = &g->file.accessor[i];
    struct gltf_accessor a = {.index = i,
                              .count = o->count,
                              .offset = o->offset,
                              .view = o->view,
                              .component = o->component,
                              .component_bytes = component_bytes(o->component),
                              .n_component = o->n_component,
                              .normalized = o->normalized,
                              .sparse = o->sparse ? o : NULL};
    if (!a.n_component || !a.component_bytes)
        return prt_gltf_bad(g, "accessor %zu: unknown type or componentType %d", i,
                            a.component);
    if (!a.count) return prt_gltf_bad(g, "accessor %zu: count is 0", i);
    // checked before memory is allocated for it
    if (a.count > (uint64_t)g->d->max_triangles * 3)
        return prt_fail(g->d->ctx, PRT_LIMIT, "%s: accessor %zu: %llu elements are too many",
                        g->d->name, i, (unsigned long long)a.count);
    if (a.view >= 0 && (uint64_t)a.view >= g->file.n_view)
        return prt_gltf_bad(g, "accessor %zu: names bufferView %lld of %zu", i,
                            (long long)a.view, g->file.n_view);
    *out = a;
    return PRT_OK;
}

// `count` elements of `size` bytes in a view, from `offset`; *stride is at least size.
static int elements(struct gltf *g, size_t accessor, int64_t view, uint64_t offset,
                    uint64_t count, size_t size, const uint8_t **at, size_t *stride)
{
    struct gltf_bytes b;
    if (view < 0 || (uint64_t)view >= g->file.n_view)
        return prt_gltf_bad(g, "accessor %zu: names bufferView %lld of %zu", accessor,
                            (long long)view, g->file.n_view);
    int status = prt_gltf_view(g, (size_t)view, &b);
    if (status) return status;
    *stride = b.stride ? b.stride : size;
    if (*stride < size)
        return prt_gltf_bad(g, "accessor %zu: its stride %zu is less than an element", accessor,
                            *stride);
    uint64_t need = (count - 1) * *stride + size; // count < 2^31, stride < 2^21
    if (offset > b.n || need > b.n - offset)
        return prt_gltf_bad(g, "accessor %zu: reads %llu bytes past bufferView %lld", accessor,
                            (unsigned long long)(offset + need - b.n), (long long)view);
    *at = b.at + offset;
    return PRT_OK;
}

static float component_float(const uint8_t *p, int type, bool normalized)
{
    float f;
    int16_t s;
    uint16_t u;
    uint32_t w;
    switch (type) {
    case 5120:
        f = (float)(int8_t)*p;
        return normalized ? (f < -127 ? -1 : f / 127) : f;
    case 5121:
        return normalized ? (float)*p / 255 : (float)*p;
    case 5122:
        memcpy(&s, p, 2);
        return normalized ? (s < -32767 ? -1 : (float)s / 32767) : (float)s;
    case 5123:
        memcpy(&u, p, 2);
        return normalized ? (float)u / 65535 : (float)u;
    case 5125:
        memcpy(&w, p, 4);
        return normalized ? (float)((double)w / 4294967295.0) : (float)w;
    }
    memcpy(&f, p, 4);
    return f;
}

static void convert(const struct gltf_accessor *a, const uint8_t *p, float *out)
{
    for (unsigned c = 0; c < a->n_component; c++)
        out[c] = component_float(p + c * a->component_bytes, a->component, a->normalized);
}

static uint32_t index_value(const uint8_t *p, int type)
{
    uint16_t u;
    uint32_t w;
    if (type == 5121) return *p;
    if (type == 5123) {
        memcpy(&u, p, 2);
        return u;
    }
    memcpy(&w, p, 4);
    return w;
}

// Replaced elements: out_f (float rows) or out_i (indices), whichever is given.
static int apply_sparse(struct gltf *g, const struct gltf_accessor *a, float *out_f,
                        uint32_t *out_i)
{
    const struct prt_gltf_accessor *o = a->sparse;
    const uint8_t *index, *value;
    size_t index_stride, value_stride, size = a->component_bytes * a->n_component;
    int status, type = o->index_component;
    if (o->sparse_count <= 0 || (uint64_t)o->sparse_count > a->count || o->index_offset < 0 ||
        o->value_offset < 0 || (type != 5121 && type != 5123 && type != 5125))
        return prt_gltf_bad(
            g, "accessor %zu: its sparse values have an impossible count, offset or type",
            a->index);
    uint64_t n = (uint64_t)o->sparse_count;
    if ((status = elements(g, a->index, o->index_view, (uint64_t)o->index_offset, n,
                           component_bytes(type), &index, &index_stride)) ||
        (status = elements(g, a->index, o->value_view, (uint64_t)o->value_offset, n, size,
                           &value, &value_stride)))
        return status;
    for (uint64_t i = 0; i < n; i++) {
        uint32_t k = index_value(index + i * index_stride, type);
        if (k >= a->count)
            return prt_gltf_bad(g, "accessor %zu: sparse index %u of %llu", a->index, k,
                                (unsigned long long)a->count);
        if (out_f) convert(a, value + i * value_stride, out_f + (size_t)k * a->n_component);
        else out_i[k] = index_value(value + i * value_stride, a->component);
    }
    return PRT_OK;
}

int prt_gltf_floats(struct gltf *g, const struct gltf_accessor *a, unsigned n_component,
                    float *out)
{
    if (a->n_component != n_component)
        return prt_gltf_bad(g, "accessor %zu: has %u components where %u are needed", a->index,
                            a->n_component, n_component);
    const uint8_t *p;
    size_t stride;
    if (a->view < 0) {
        memset(out, 0, a->count * n_component * sizeof *out);
    } else {
        int status = elements(g, a->index, a->view, a->offset, a->count,
                              a->component_bytes * n_component, &p, &stride);
        if (status) return status;
        for (uint64_t i = 0; i < a->count; i++)
            convert(a, p + i * stride, out + i * n_component);
    }
    return a->sparse ? apply_sparse(g, a, out, NULL) : PRT_OK;
}

int prt_gltf_indices(struct gltf *g, const struct gltf_accessor *a, uint32_t *out)
{
    if (a->n_component != 1 ||
        (a->component != 5121 && a->component != 5123 && a->component != 5125))
        return prt_gltf_bad(g, "accessor %zu: indices must be unsigned whole numbers",
                            a->index);
    const uint8_t *p;
    size_t stride;
    if (a->view < 0) {
        memset(out, 0, a->count * sizeof *out);
    } else {
        int status = elements(g, a->index, a->view, a->offset, a->count, a->component_bytes, &p,
                              &stride);
        if (status) return status;
        for (uint64_t i = 0; i < a->count; i++)
            out[i] = index_value(p + i * stride, a->component);
    }
    return a->sparse ? apply_sparse(g, a, NULL, out) : PRT_OK;
}
