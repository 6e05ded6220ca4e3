// SPDX-License-Identifier: MIT
// C interface of tinygltf, which has a C++ one only: a parsed file as plain structs. tinygltf
// does not check indices and offsets, so the caller checks each before use.
#ifndef PRT_MESH_TINYGLTF_H
#define PRT_MESH_TINYGLTF_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { PRT_GLTF_UV_SETS = 8, PRT_GLTF_DRACO_IDS = 3 + PRT_GLTF_UV_SETS };
// An index is -1 where the file has none.
struct prt_gltf_buffer {
    const uint8_t *at;
    size_t n;
    bool has_uri;
};
struct prt_gltf_slice {
    int64_t buffer, offset, length;
};
struct prt_gltf_view {
    struct prt_gltf_slice slice;
    uint64_t stride; // 0: packed
    bool meshopt;    // EXT_meshopt_compression: the bytes are decoded from `packed`
    struct prt_gltf_slice packed;
    int64_t packed_count, packed_stride;
    const char *mode, *filter; // "" when absent
};
struct prt_gltf_accessor {
    int64_t view;
    uint64_t offset, count;
    int component;        // 5120..5130
    unsigned n_component; // 0: none of SCALAR, VEC2, VEC3, VEC4, MAT4
    bool normalized, sparse;
    int64_t sparse_count, index_view, index_offset, value_view, value_offset;
    int index_component;
};
struct prt_gltf_primitive {
    int64_t position, normal, uv[PRT_GLTF_UV_SETS], color, indices, material;
    int mode;
    bool targets, draco;
    int64_t draco_view;
    int64_t draco_id[PRT_GLTF_DRACO_IDS]; // POSITION, NORMAL, COLOR_0, TEXCOORD_0..
};
struct prt_gltf_mesh {
    const struct prt_gltf_primitive *primitive;
    size_t n;
};
struct prt_gltf_numbers {
    const double *at;
    size_t n; // 0: absent
};
struct prt_gltf_node {
    const char *name;
    int64_t mesh, skin, camera;
    struct prt_gltf_numbers matrix, translation, rotation, scale;
    const int *child;
    size_t n_child;
};
struct prt_gltf_scene {
    const int *node;
    size_t n;
};
struct prt_gltf_material {
    const char *name;
    struct prt_gltf_numbers base_color; // the diffuse factor of KHR_..._pbrSpecularGlossiness
    double roughness, ior;
    bool double_sided, textured;
    const char *const *extension;
    size_t n_extension;
};

struct prt_gltf_document {
    const char *version, *min_version;
    const char *const *required; // extensions
    const struct prt_gltf_buffer *buffer;
    const struct prt_gltf_view *view;
    const struct prt_gltf_accessor *accessor;
    const struct prt_gltf_mesh *mesh;
    const struct prt_gltf_node *node;
    const struct prt_gltf_scene *scene;
    const struct prt_gltf_material *material;
    size_t n_required, n_buffer, n_view, n_accessor, n_mesh, n_node, n_scene, n_material;
    int64_t default_scene;
    void *holder;
};

// Replaces tinygltf's file access. `name` is URL-decoded and otherwise as in the file. The
// bytes are copied, then passed to release.
struct prt_gltf_files {
    void *user;
    int (*read)(void *user, const char *name, void **bytes,
                size_t *n); // 0, or a status whose reason is logged
    void (*release)(void *bytes);
};

enum { PRT_GLTF_REFUSED = 1, PRT_GLTF_NO_MEMORY = 2 };
// Parses a GLB with one JSON and at most one BIN chunk, or JSON. Returns 0 or one of the above;
// `say` receives tinygltf's error or warning, "" for none. On PRT_GLTF_REFUSED only the
// document's version and required extensions are set, as far as they were read. Free with
// prt_gltf_free in any case.
int prt_gltf_parse(const void *bytes, uint32_t n, bool binary,
                   const struct prt_gltf_files *files, struct prt_gltf_document *out, char *say,
                   size_t say_size);
void prt_gltf_free(struct prt_gltf_document *d);

#ifdef __cplusplus
}
#endif
#endif
