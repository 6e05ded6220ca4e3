// SPDX-License-Identifier: MIT
// The mesh room's inside: the draft a reader fills, and the readers.
#ifndef PRT_MESH_INTERNAL_H
#define PRT_MESH_INTERNAL_H

#include "prt/mesh.h"

// What readers build, in the child process. Arrays grow; vertices and triangles are global.
struct prt_draft {
    const struct prt_context *ctx;
    const char *name;          // for messages
    const char *base_dir;      // where external buffers may lie; NULL: nowhere
    const char *const *opaque; // NULL-terminated names, or NULL
    uint64_t opaque_hit;       // bit i: name i was met (the first 64)
    uint32_t max_vertices, max_triangles;
    uint64_t max_bytes;
    uint32_t n_vertex, n_triangle, n_block, n_surface, n_object;
    uint32_t cap_vertex, cap_triangle, cap_block, cap_surface;
    float (*position)[3];
    float (*normal)[3]; // 0,0,0: to be made
    float (*uv)[2];
    uint32_t (*triangle)[3];
    struct prt_block *block;
    struct prt_surface *surface;
    bool has_uv, units_known;
};

// n zeroed vertices at the end; PRT_LIMIT or PRT_NOMEM with a log line.
int prt_draft_vertices(struct prt_draft *d, uint64_t n, uint32_t *first);
int prt_draft_triangle(struct prt_draft *d, uint32_t a, uint32_t b, uint32_t c);
int prt_draft_block(struct prt_draft *d, struct prt_block block);
int prt_draft_surface(struct prt_draft *d, const struct prt_surface *s, uint32_t *index);
// true when the user asked for this material or node to be opaque
bool prt_draft_opaque(struct prt_draft *d, const char *name);
void prt_draft_finish(struct prt_draft *d);
void prt_surface_default(struct prt_surface *s, const char *name);

int prt_read_gltf(struct prt_draft *d, uint8_t *bytes, size_t n);  // changes bytes
int prt_read_obj(struct prt_draft *d, const char *text, size_t n); // text[n] == 0
int prt_read_ply(struct prt_draft *d, const char *text, size_t n); // text[n] == 0

// The draft as one block of memory, and back: lengths and indices are checked on the way in.
int prt_blob_pack(const struct prt_draft *d, struct prt_blob *out);
// Takes over blob->bytes on success.
int prt_blob_open(const struct prt_context *ctx, const char *name, const struct prt_blob *blob,
                  struct prt_mesh **out);
// Welds, makes missing normals, counts edges and warns. In place.
int prt_mesh_finish(const struct prt_context *ctx, const char *name, struct prt_mesh *mesh);

#endif
