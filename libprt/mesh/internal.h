// SPDX-License-Identifier: MIT
// Internal to the mesh room: the mesh builder that readers fill, and the readers.
#ifndef PRT_MESH_INTERNAL_H
#define PRT_MESH_INTERNAL_H

#include "prt/mesh.h"

// The mesh that a reader builds, in the child process. Arrays grow; indices are into the whole
// mesh.
struct prt_draft {
    const struct prt_context *ctx;
    const char *name;          // for messages
    const char *base_dir;      // folder of external buffers; NULL: none are allowed
    const char *const *opaque; // NULL-terminated names, or NULL
    uint64_t opaque_hit;       // bit i: the file has the name opaque[i] (the first 64)
    uint32_t max_vertices, max_triangles;
    uint64_t max_bytes;
    uint32_t n_vertex, n_triangle, n_block, n_surface, n_object;
    uint32_t cap_vertex, cap_triangle, cap_block, cap_surface;
    float (*position)[3];
    float (*normal)[3]; // 0,0,0: to be computed
    float (*uv)[2];
    uint32_t (*triangle)[3];
    struct prt_block *block;
    struct prt_surface *surface;
    struct prt_object *object; // [cap_object]
    uint32_t cap_object;
    struct prt_mesh_camera camera[PRT_MESH_MOST_CAMERAS];
    uint32_t n_camera;
    const char *animation; // whose moment animation_time [s] is read; NULL: at rest
    double animation_time;
    struct prt_mesh_animation animations[PRT_MESH_MOST_ANIMATIONS];
    uint32_t n_animation;
    const char *variant; // of materials; NULL: the file's own
    struct prt_mesh_variant variants[PRT_MESH_MOST_VARIANTS];
    uint32_t n_variant;
    uint32_t *variant_surface; // [n_block][n_variant + 1]
    uint32_t cap_variant_surface;
    bool has_uv, units_known;
    // textures
    bool no_textures, has_color, has_maps;
    uint32_t n_uv;                               // TEXCOORD sets kept, 1 at least
    float (*uv_more[PRT_TEXTURE_MAX_UV - 1])[2]; // sets 1..
    float (*color)[4];                           // where has_color
    float (*corner_uv)[3][2];                    // [n_triangle], or NULL
    struct prt_surface_maps *maps;               // [cap_maps] of the surfaces
    uint32_t cap_maps;
    struct prt_volume *volume; // [cap_volume] of the surfaces, or NULL
    uint32_t cap_volume;
    struct prt_texture_image *image; // begin 0: each has an array of its own
    uint8_t **texel;
    uint32_t n_image, cap_image, cap_texel;
    uint64_t texel_bytes;
};

// Appends n zeroed vertices from *first on. PRT_LIMIT or PRT_NOMEM with a log line.
int prt_draft_vertices(struct prt_draft *d, uint64_t n, uint32_t *first);
int prt_draft_triangle(struct prt_draft *d, uint32_t a, uint32_t b, uint32_t c);
int prt_draft_block(struct prt_draft *d, struct prt_block block);
// The row of the last block in variant_surface, for the caller to fill. NULL without memory.
uint32_t *prt_draft_variant_row(struct prt_draft *d);
// The next object: block.object is d->n_object - 1 afterwards. name may be NULL.
int prt_draft_object(struct prt_draft *d, const char *name);
int prt_draft_surface(struct prt_draft *d, const struct prt_surface *s, uint32_t *index);
// The maps of a surface, all absent at first. NULL without memory.
struct prt_surface_maps *prt_draft_maps(struct prt_draft *d, uint32_t surface);
// The same of its inside.
struct prt_volume *prt_draft_volume(struct prt_draft *d, uint32_t surface);
// Decodes an image of the model, warns where it cannot be read, and gives its index; UINT32_MAX
// after a warning. PRT_NOMEM.
int prt_draft_image(struct prt_draft *d, const char *name, const void *bytes, size_t n,
                    enum prt_texture_kind kind, uint32_t *index);
// A file that the model names, in its folder; messages go to ctx and call it a `kind` file.
int prt_draft_file(const struct prt_draft *d, const struct prt_context *ctx, const char *kind,
                   const char *path, uint64_t max_bytes, struct prt_blob *out);
// A context whose errors become warnings that end with "it is left out". *user must outlive it.
struct prt_context prt_draft_lenient(const struct prt_draft *d,
                                     const struct prt_context **user);
// true when the options name this material or node as opaque
bool prt_draft_opaque(struct prt_draft *d, const char *name);
// Every image is looked up at 1 - v, after its map's transform.
void prt_draft_flip_v(struct prt_draft *d);
void prt_draft_finish(struct prt_draft *d);
// name NULL: the file names no material
#define PRT_UNNAMED_SURFACE "default"
void prt_surface_default(struct prt_surface *s, const char *name);

int prt_read_gltf(struct prt_draft *d, uint8_t *bytes, size_t n);  // changes bytes
int prt_read_obj(struct prt_draft *d, char *text, size_t n);       // text[n] == 0; changes text
int prt_read_ply(struct prt_draft *d, const char *text, size_t n); // text[n] == 0
bool prt_is_binary_stl(const void *bytes, size_t n);
int prt_read_stl(struct prt_draft *d, const char *bytes, size_t n); // bytes[n] == 0
// Adds a camera at `eye` that looks along `forward` (unit); its name is made unique.
void prt_draft_camera(struct prt_draft *d, const char *name, const double eye[3],
                      const double forward[3], const double up[3], double fovy_deg);
// Once all vertices are known: targets of the cameras, and the turn of a file with +z up.
void prt_draft_place(struct prt_draft *d, bool up_z);

// Packs the built mesh into one block of memory (prt_free), for the parent process.
int prt_blob_pack(const struct prt_draft *d, struct prt_blob *out);
// Makes a mesh of such a block, after checks of every length, index and number. Takes over
// blob->bytes on success. PRT_FORMAT, PRT_NOMEM.
int prt_blob_open(const struct prt_context *ctx, const char *name, const struct prt_blob *blob,
                  struct prt_mesh **out);
// Welds, computes missing normals, counts edges, and warns about open, non-manifold and
// inconsistently wound surfaces. In place.
int prt_mesh_finish(const struct prt_context *ctx, const char *name, struct prt_mesh *mesh);
// Numbers the distinct (object, position) pairs: weld and n_weld.
int prt_mesh_weld(const struct prt_context *ctx, const char *name, struct prt_mesh *mesh);

#endif
