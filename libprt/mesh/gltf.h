// SPDX-License-Identifier: MIT
// The glTF reader: pre-scan, buffers, accessors, nodes. It checks every number of the file.
#ifndef PRT_MESH_GLTF_H
#define PRT_MESH_GLTF_H

#include "internal.h"
#include "tinygltf.h"

struct gltf_bytes {
    const uint8_t *at;
    size_t n, stride; // stride 0: packed
    bool known;
};

struct gltf_owned {
    struct gltf_owned *next;
};

struct gltf_mesh_data {             // a decoded Draco primitive
    int64_t id[PRT_GLTF_DRACO_IDS]; // of the attributes that were decoded
    uint32_t n_vertex, n_triangle;
    float *position, *normal, *color, *uv[PRT_GLTF_UV_SETS]; // all but position may be NULL
    uint32_t *triangle;
};

struct gltf_camera {
    char name[64];
    double fovy_deg; // 0: orthographic, or no angle in (0,170)
};

struct gltf {
    struct prt_draft *d;
    struct prt_gltf_document file;
    bool is_glb, plain;         // plain: the container keeps tinygltf's rules for chunk sizes
    uint32_t glb_n;             // length in the GLB header
    struct gltf_bytes bin;      // the GLB's BIN chunk
    struct gltf_camera *camera; // [n_camera]
    size_t n_camera;
    uint64_t *external; // [n_external] byteLength of buffers in files, in order
    size_t n_external, n_opened;
    int file_status; // status of an external file that could not be read, logged; 0: none
    struct gltf_bytes *view_bytes; // [n_view]
    struct gltf_mesh_data **draco; // [n_view]
    struct gltf_owned *owned;
    uint64_t loaded_bytes;            // of buffers and decoded views, against d->max_bytes
    uint32_t *surface_of, *opaque_of; // [n_material + 1] into d->surface, UINT32_MAX: not yet
    uint8_t *colored;                 // [2 (n_material + 1)] of d->surface: one with COLOR_0
    size_t mesh_index;                // of the mesh being read, for messages
    struct cJSON *json;    // the file's materials, textures and images; NULL: it has none
    uint32_t *image_index; // [n_json_image][PRT_TEXTURE_N_KIND] into d->image; see gltf_image.c
    uint32_t variant;      // the chosen one of KHR_materials_variants; n_variant: none
    const struct cJSON **json_mesh; // [n_mesh] where there are variants
    struct gltf_pose *pose;         // gltf_pose.h; NULL: nothing bends
    bool instances;                 // EXT_mesh_gpu_instancing is named
    uint32_t n_channel_skipped;
    uint32_t n_skipped, n_deformed, n_bad_normal, n_tail, n_flat; // counts for the notes
};

// Logs "NAME: ..." and returns PRT_FORMAT.
int prt_gltf_bad(const struct gltf *g, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
int prt_gltf_no_memory(const struct gltf *g);
void *prt_gltf_own(struct gltf *g, uint64_t bytes); // zeroed; lives until the reader ends

// Checks depth and numbers, and blanks the parts that are not read. In place.
int prt_gltf_scan(struct gltf *g, char *json, size_t n);
// Reads the text of the file's "cameras"; a damaged one has an angle of 0. PRT_NOMEM.
int prt_gltf_cameras(struct gltf *g, const char *json, size_t n);
// Adds the camera of a node, if it has one, at its world matrix [16].
void prt_gltf_add_camera(struct gltf *g, const struct prt_gltf_node *node, const double *world);
bool prt_gltf_needs_rewrite(const char *json, size_t n);
int prt_gltf_rewrite(struct gltf *g, const char *json, size_t n, char **out); // free(*out)

// prt_gltf_files.read: the bytes of a file inside the model's folder. user: struct gltf.
int prt_gltf_read_external(void *user, const char *name, void **bytes, size_t *n);
int prt_gltf_view(struct gltf *g, size_t index, struct gltf_bytes *out);

struct gltf_accessor {
    size_t index;
    uint64_t count, offset;
    int64_t view;  // -1: none
    int component; // 5120..5126
    unsigned component_bytes, n_component;
    bool normalized;
    const struct prt_gltf_accessor *sparse; // NULL: not
};
int prt_gltf_accessor(const struct gltf *g, int64_t index, struct gltf_accessor *out);
// out[count][n_component]; the accessor's type must have n_component
int prt_gltf_floats(struct gltf *g, const struct gltf_accessor *a, unsigned n_component,
                    float *out);
int prt_gltf_indices(struct gltf *g, const struct gltf_accessor *a, uint32_t *out);

// Keeps the parts of the JSON that textures need, before prt_gltf_scan blanks them. A tree is
// parsed by prt_gltf_textures_begin, after the depth of the JSON was checked.
char *prt_gltf_textures_copy(const struct gltf *g, const char *json, size_t n);
// Parses the copy, which is freed. After it d->n_uv and d->has_color hold.
int prt_gltf_textures_begin(struct gltf *g, char *copy, size_t n);
// The maps of a material on a surface that was added for it.
int prt_gltf_maps(struct gltf *g, size_t material, uint32_t surface);
// The inside of a material on its surface.
int prt_gltf_volume(struct gltf *g, size_t material, uint32_t surface);
// The decoded image of a texture; UINT32_MAX after a warning.
int prt_gltf_image(struct gltf *g, size_t image, enum prt_texture_kind kind, uint32_t *out);
void prt_gltf_textures_end(struct gltf *g);

// Lists the file's variants and chooses d->variant. PRT_ARG for an unknown name.
int prt_gltf_variants(struct gltf *g);
// After a block was added for a primitive of mesh g->mesh_index, whose own material is `own`
// (in [0, n_material]): its surfaces in all variants; the block takes the chosen variant's.
int prt_gltf_variant_surfaces(struct gltf *g, size_t primitive, size_t own, bool opaque);

// The surface of material `index` (n_material: none given), added at first use.
int prt_gltf_surface(struct gltf *g, size_t index, bool opaque, uint32_t *out);
// After all primitives: without scattering extensions in the file, all are translucent.
void prt_gltf_settle_surfaces(struct gltf *g);
// The node's mesh, if it has one, as an object; world is column-major [16].
int prt_gltf_instance(struct gltf *g, size_t node_index, const double *world);
// Frees the arrays of a view's decoded Draco mesh.
void prt_gltf_drop_draco(struct gltf *g, size_t view);
// Every node of the scene, parents before children.
int prt_gltf_walk(struct gltf *g);

#endif
