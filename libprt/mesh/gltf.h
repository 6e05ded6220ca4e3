// SPDX-License-Identifier: MIT
// The glTF reader's own parts: JSON access, buffers, accessors. Every number is checked here.
#ifndef PRT_MESH_GLTF_H
#define PRT_MESH_GLTF_H

#include "internal.h"

#include <cjson/cJSON.h>

// A JSON array of objects as a table, since cJSON's arrays are lists.
struct gltf_table {
    const cJSON **item;
    size_t n;
};

struct gltf_bytes {
    const uint8_t *at;
    size_t n, stride; // stride 0: packed
    bool known;
};

struct gltf_owned {
    struct gltf_owned *next;
};

struct gltf_mesh_data { // a decoded Draco primitive
    uint32_t n_vertex, n_triangle;
    float *position, *normal, *uv; // normal, uv: NULL when absent
    uint32_t *triangle;
};

struct gltf {
    struct prt_draft *d;
    cJSON *json;
    struct gltf_table buffer, view, accessor, mesh, material, node, scene;
    struct gltf_bytes bin;           // the GLB's own chunk
    struct gltf_bytes *buffer_bytes; // [buffer.n], loaded when first used
    struct gltf_bytes *view_bytes;   // [view.n]
    struct gltf_mesh_data **draco;   // [view.n]
    struct gltf_owned *owned;
    uint64_t loaded_bytes;            // of buffers and decoded views, against d->max_bytes
    uint32_t *surface_of, *opaque_of; // [material.n + 1] into d->surface, UINT32_MAX: not yet
    size_t mesh_index;                // being read, for messages
    uint32_t n_skipped, n_deformed, n_bad_normal, n_tail, n_flat;
};

// A line "NAME: ..." and PRT_FORMAT.
int gltf_bad(const struct gltf *g, const char *fmt, ...) __attribute__((format(printf, 2, 3)));
int gltf_no_memory(const struct gltf *g);
void *gltf_own(struct gltf *g, uint64_t bytes); // zeroed; lives until the reader ends

const cJSON *gltf_member(const cJSON *object, const char *key);
const char *gltf_text(const cJSON *object, const char *key); // NULL when absent
// The whole number object[key] in [0,max]; *out = missing when absent.
int gltf_number(const struct gltf *g, const char *kind, size_t index, const cJSON *object,
                const char *key, uint64_t max, uint64_t missing, uint64_t *out);
// n finite numbers; *have tells whether the key is there.
int gltf_numbers(const struct gltf *g, const char *kind, size_t index, const cJSON *object,
                 const char *key, size_t n, double *out, bool *have);
int gltf_table(struct gltf *g, const char *key, struct gltf_table *out);

int gltf_buffer(struct gltf *g, size_t index, const struct gltf_bytes **out);
int gltf_view(struct gltf *g, size_t index, struct gltf_bytes *out);

struct gltf_accessor {
    size_t index;
    uint64_t count, view, offset; // view UINT64_MAX: none
    int component;                // 5120..5126
    unsigned component_bytes, n_component;
    bool normalized;
    const cJSON *sparse;
};
int gltf_accessor(const struct gltf *g, uint64_t index, struct gltf_accessor *out);
// out[count][n_component]; the accessor's type must have n_component
int gltf_floats(struct gltf *g, const struct gltf_accessor *a, unsigned n_component,
                float *out);
int gltf_indices(struct gltf *g, const struct gltf_accessor *a, uint32_t *out);

// The surface of material `index` (material.n: none given), made on first use.
int gltf_surface(struct gltf *g, size_t index, bool opaque, uint32_t *out);
// After all primitives: without scattering extensions in the file, all are translucent.
void gltf_settle_surfaces(struct gltf *g);
// The node's mesh, if it has one, as an object; world is column-major [16].
int gltf_instance(struct gltf *g, const cJSON *node, size_t node_index, const double *world);
// Every node of the scene, parents before children.
int gltf_walk(struct gltf *g);

#endif
