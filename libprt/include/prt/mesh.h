/* SPDX-License-Identifier: MIT */
/* prt/mesh.h owns the scene's geometry: loading, units, welding, normals, coloured output.
 *
 * A loaded mesh is read-only and may be shared between threads; prt_mesh_scale and
 * prt_mesh_normals change it and need exclusive access. A function that returns int returns
 * PRT_OK or a negative status, which it has logged to ctx with a line that names the file and
 * the fault; *out is written on success only. */
#ifndef PRT_MESH_H
#define PRT_MESH_H

#include "prt/base.h"
#include "prt/texture.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The properties of a glTF material that light transport uses. Opaque ones are Lambertian
 * receivers. */
struct prt_surface {
    char name[64];
    uint8_t translucent; /* 1: the bake's --material applies; 0: opaque */
    uint8_t double_sided;
    uint8_t reserved[2];
    float base_color[4]; /* linear RGB + alpha in [0,1]; the albedo of opaque surfaces */
    float roughness;     /* (0,1] */
    float ior;           /* KHR_materials_ior, else 1.5 */
};

/* A node instance, or a part of one that has a medium of its own. */
struct prt_object {
    char name[64]; /* of the glTF node, or "" */
};

/* The inside of a surface as a glTF material gives it, in the file's unit of length. */
enum prt_volume_kind { PRT_VOLUME_NONE, PRT_VOLUME_ATTENUATION, PRT_VOLUME_SCATTER };
struct prt_volume {
    uint32_t kind;   /* enum prt_volume_kind */
    float color[3];  /* [0,1] left after `distance` */
    float distance;  /* model units; 0: the file gives none */
    float albedo[3]; /* [0,1] diffuse */
    float g;         /* [-0.95,0.95] */
};

/* One (node, primitive): vertices [vertex_begin, +n_vertex) in the file's order. */
struct prt_block {
    uint32_t object;  /* index of the node instance; light never crosses objects */
    uint32_t surface; /* into prt_mesh.surface */
    uint32_t vertex_begin, n_vertex;
    uint32_t triangle_begin, n_triangle;
};

/* A perspective camera of the file, in world space and the model's own units. */
struct prt_mesh_camera {
    char name[64]; /* of its node, else of the camera; no two are equal */
    float eye[3], target[3],
        up[3];      /* target: in front of the eye, as deep as the model's centre */
    float fovy_deg; /* (0,170) */
};
enum {
    PRT_MESH_MOST_CAMERAS = 256,
    PRT_MESH_MOST_ANIMATIONS = 64,
    PRT_MESH_MOST_VARIANTS = 64
};
/* A variant of a glTF's materials (KHR_materials_variants); names are unique (prt/variant.h).
 */
struct prt_mesh_variant {
    char name[64];
};
/* An animation of a glTF; names are unique. */
struct prt_mesh_animation {
    char name[64];
    float duration_s; /* its last key, as the file says; 0: not said */
};
/* Sky that the model hides from a vertex, as real spherical harmonics l <= 3 (prt_sh_eval) of
 * the indicator of hidden directions and their mirror images in the tangent plane, each
 * coefficient in steps of PRT_MESH_BLOCKED_SCALE / 127. */
enum { PRT_MESH_BLOCKED = 16, PRT_MESH_BLOCKED_SCALE = 4 };

/* Immutable after loading; positions in mm once scaled. World space, right-handed, +y up.
 * Arrays are contiguous; those a reader maps from a .prt file are owned by the map. */
struct prt_mesh {
    uint32_t n_vertex, n_triangle, n_block, n_object, n_surface;
    uint32_t n_weld;         /* distinct (object, position) pairs */
    float (*position)[3];    /* [n_vertex] mm (model units before prt_mesh_scale) */
    float (*model)[3];       /* [n_vertex] before prt_mesh_scale, in model units; NULL: not
                                scaled, or of a .prt. Who changes positions later frees it: rays
                                and samples go by it */
    float (*normal)[3];      /* [n_vertex] unit; angle-weighted where the file has none */
    float (*uv)[2];          /* [n_vertex] TEXCOORD_0, or NULL */
    uint32_t (*triangle)[3]; /* [n_triangle] global vertex indices */
    uint32_t *weld;          /* [n_vertex] -> [0,n_weld): same object, same position */
    struct prt_block *block;
    struct prt_surface *surface;
    struct prt_object *object;      /* [n_object], NULL when no object has a name */
    struct prt_mesh_camera *camera; /* [n_camera], NULL when there is none */
    uint32_t n_camera;
    struct prt_mesh_animation *animation; /* [n_animation] of a model, not of a .prt; or NULL */
    uint32_t n_animation, n_variant;
    struct prt_mesh_variant *variant; /* [n_variant], or NULL */
    uint32_t *variant_surface; /* [n_block][n_variant + 1] surface of each block in each variant
                                  and, last, without one; NULL where n_variant is 0 */
    float (*gain)[3];     /* [n_block] of a view of a variant: factor that pictures multiply
                             baked colours with; NULL: 1 */
    float mm_per_unit;    /* model units * mm_per_unit = mm; 0 while not scaled */
    uint32_t units_known; /* 1: the format says metres (glTF) */
    /* of the translucent blocks, welded: edges of one triangle, of more than two, triangles
     * whose corners coincide */
    uint32_t n_boundary_edge, n_nonmanifold_edge, n_degenerate_triangle;
    void *owner; /* memory behind the arrays; NULL when mapped */
    void *parts; /* memory behind `object` after prt_mesh_divide, else NULL */
    /* Textures (METHODS §10); 0 and NULL where the file has none. */
    uint32_t n_uv;                   /* TEXCOORD sets; 0 stands for 1 where uv is set */
    uint32_t n_image;                /* images that maps name */
    float (*uv_more)[2];             /* [n_uv - 1][n_vertex] sets 1.. */
    float (*corner_uv)[3][2];        /* [n_triangle] set 0 by corner, where an OBJ has seams */
    float (*color)[4];               /* [n_vertex] COLOR_0, linear RGBA in [0,1] */
    struct prt_surface_maps *maps;   /* [n_surface] */
    struct prt_texture_image *image; /* [n_image] */
    uint8_t *texel;                  /* [texel_bytes] levels of all images */
    uint64_t texel_bytes;
    int8_t (*blocked)[PRT_MESH_BLOCKED]; /* [n_vertex] of a .prt, or NULL: pictures without
                                            specular occlusion */
    struct prt_volume *volume;           /* [n_surface], or NULL; of a model, and of a .prt
                                            with variants */
    float texture_split; /* [0,1] share of a texture that scattering blurs (METHODS §10) */
};

struct prt_mesh_options {
    const char *const *opaque; /* material or node names made opaque, NULL-terminated; NULL */
    uint32_t max_vertices;     /* 0: 50 million */
    uint32_t max_triangles;    /* 0: 100 million */
    bool up_z;                 /* +z is up in the file: (x,y,z) becomes (x,z,-y) */
    bool flip_v;               /* its images are upside down: v becomes 1 - v in every set */
    bool in_process;           /* parse without a child process (fuzzers only) */
    bool no_textures;          /* read no images, TEXCOORD sets above 0 and vertex colours */
    /* A glTF's vertices in a moment of this animation, or of the only one whose name begins so;
     * times before its first and after its last key have their values. NULL: at rest. */
    const char *animation;
    double time_s;
    const char
        *variant; /* materials of this variant of a glTF, named so; NULL: the file's own */
};

/* Loads .glb, .gltf (with .bin files and data URIs), .obj, .ply or .stl; the content decides.
 * An STL's vertices are three a facet, in the file's order. Blocks
 * while a child process parses, at most 120 s. Warns about open, non-manifold and
 * inconsistently wound surfaces and names the engines they affect. options may be NULL. The
 * caller destroys *out. PRT_IO, PRT_FORMAT, PRT_UNSUPPORTED, PRT_LIMIT, PRT_ARG (an opaque name
 * that the file lacks), PRT_NOMEM. */
int prt_mesh_load(const struct prt_context *ctx, const char *path,
                  const struct prt_mesh_options *options, struct prt_mesh **out);
/* The same of an open regular file, which is read from its beginning and stays open; `name`
 * stands in messages. base_dir: the folder of a glTF's other files; NULL refuses them. */
int prt_mesh_load_fd(const struct prt_context *ctx, const char *name, int fd,
                     const char *base_dir, const struct prt_mesh_options *options,
                     struct prt_mesh **out);
/* The same from memory. */
int prt_mesh_load_memory(const struct prt_context *ctx, const char *name, const void *bytes,
                         size_t n, const char *base_dir, const struct prt_mesh_options *options,
                         struct prt_mesh **out);
void prt_mesh_destroy(struct prt_mesh *mesh);

/* A mesh of one object and one translucent surface from arrays, which are copied; normals may
 * be NULL. Positions finite and within 1e15, at least one triangle. PRT_ARG, PRT_LIMIT,
 * PRT_NOMEM. */
int prt_mesh_create(const struct prt_context *ctx, uint32_t n_vertex,
                    const float (*position)[3], const float (*normal)[3], uint32_t n_triangle,
                    const uint32_t (*triangle)[3], struct prt_mesh **out);

/* Texture coordinates of set `set` at barycentrics (a, b) of a triangle; 0,0 where the mesh has
 * no such set. */
void prt_mesh_uv(const struct prt_mesh *mesh, uint32_t triangle, unsigned set, float a, float b,
                 float uv[2]);
/* The same at the triangle's three corners. */
void prt_mesh_corner_uv(const struct prt_mesh *mesh, uint32_t triangle, unsigned set,
                        float uv[3][2]);
/* The values of a surface's texture maps at a point. */
struct prt_look {
    float base[4];     /* linear reflectance that light is multiplied with after scattering, and
                          alpha: base colour texture * COLOR_0, of translucent surfaces also * the
                          factor; 1 where a surface has neither */
    float normal[3];   /* unit, turned by the normal map */
    float variance;    /* of the directions within the footprint, 1 - |mean|, [0,1) */
    float roughness;   /* (0,1] of surfaces with such a map, else -1 */
    float metallic;    /* [0,1]; 0 without maps */
    float occlusion;   /* (0,1] */
    float emission[3]; /* radiance */
};
/* The look at barycentrics (a, b) of a triangle. normal: the interpolated one, unit. da, db:
 * change of a and of b over each of the footprint's two axes. Thread-safe. */
void prt_mesh_look(const struct prt_mesh *mesh, uint32_t triangle, uint32_t block, float a,
                   float b, const float da[2], const float db[2], const float normal[3],
                   struct prt_look *out);
/* The change of barycentrics along a step [mm] in the triangle's plane; 0 on one without area.
 */
void prt_mesh_footprint(const struct prt_mesh *mesh, uint32_t triangle, const float step[3],
                        float d[2]);
/* The block of a triangle, by bisection. */
uint32_t prt_mesh_block_of(const struct prt_mesh *mesh, uint32_t triangle);
/* Whether any surface or vertex has a look of its own, or a block a gain. */
bool prt_mesh_has_look(const struct prt_mesh *mesh);
/* Brightness of a reflectance that irradiance is multiplied with at bake time: its luminance to
 * the power of texture_split (METHODS §10). 1 for a split of 0. */
float prt_mesh_tint(const struct prt_mesh *mesh, const float base[3]);
/* Leaves the textures out: colours, maps and images; uv stay. The arrays are not freed. */
void prt_mesh_drop_textures(struct prt_mesh *mesh);

/* A hash of the mesh as it is: positions, normals, triangles, blocks, and its look where it has
 * one. 0 stands for "not known" elsewhere. Thread-safe. */
uint64_t prt_mesh_hash(const struct prt_mesh *mesh);

/* An object in messages: "object 2 leaf", or "object 2" where it has no name. Returns words. */
enum { PRT_OBJECT_WORDS = 80 };
const char *prt_mesh_object_words(const struct prt_mesh *mesh, uint32_t object,
                                  char words[PRT_OBJECT_WORDS]);

/* Bounding box [2][3] of the translucent blocks' vertices (of all if none is translucent). */
void prt_mesh_bounds(const struct prt_mesh *mesh, float box[2][3]);
/* The box's diagonal in the mesh's unit; no straight path through a translucent object is
 * longer. */
double prt_mesh_diagonal(const struct prt_mesh *mesh);
/* Multiplies positions once: by mm_per_unit if > 0, else so that the translucent box's diagonal
 * is size_mm. Both 0: metres when units_known (a note is logged), else PRT_ARG.
 * Refuses non-finite, non-positive and absurd (diagonal outside 1e-3..1e6 mm) scales. */
int prt_mesh_scale(const struct prt_context *ctx, struct prt_mesh *mesh, double size_mm,
                   double mm_per_unit);
/* Positions in the model's own units, which another scale leaves as they are; in mm where they
 * are not known. */
static inline const float (*prt_mesh_model_positions(const struct prt_mesh *mesh))[3]
{
    return (const float(*)[3])(mesh->model ? mesh->model : mesh->position);
}
/* Divides objects: blocks of one object with different numbers part[n_block] become objects of
 * their own with the same name, welded apart. Objects are numbered anew, by their first block.
 * Changes nothing where all blocks of each object have one number. PRT_NOMEM. */
int prt_mesh_divide(const struct prt_context *ctx, struct prt_mesh *mesh,
                    const uint32_t part[]);
/* Computes each normal that is 0,0,0 from the triangles around its vertex, weighted by angle;
 * for vertices that moved. Reads position, triangle and weld; changes only such normals.
 * PRT_NOMEM. */
int prt_mesh_normals(const struct prt_context *ctx, struct prt_mesh *mesh);
/* The index of the variant that `name` stands for (prt_name_choose); n_variant for "default",
 * the file's own materials, where no variant has this name. `model` opens the error line.
 * PRT_ARG: there are no variants, or none of this name (the message has near ones). */
int prt_mesh_variant_find(const struct prt_context *ctx, const char *model,
                          const struct prt_mesh *mesh, const char *name, uint32_t *out);
/* Whether the variants have names that end and surfaces of the mesh, and whether the insides of
 * surfaces have numbers in their ranges. */
bool prt_mesh_variants_ok(const struct prt_mesh *mesh);
bool prt_mesh_volumes_ok(const struct prt_mesh *mesh);
/* Whether the cameras have names that end, finite numbers and a field of view in (0,170). */
bool prt_mesh_cameras_ok(const struct prt_mesh *mesh);
/* [n_triangle] block index of each triangle; NULL without memory; the caller prt_free()s. */
uint32_t *prt_mesh_triangle_blocks(const struct prt_mesh *mesh);
/* [n_vertex] block index of each vertex; NULL without memory; the caller prt_free()s. */
uint32_t *prt_mesh_vertex_blocks(const struct prt_mesh *mesh);
/* The vertices in an order whose prefixes, down to n_root, are coarser sets of them. A
 * vertex behind the prefix is the mean of its two parents, which come before it in the order. A
 * block's vertices have parents of that block. */
struct prt_coarse_order {
    uint32_t n, n_root;
    uint32_t *vertex;      /* [n] the vertex at each position */
    uint32_t (*parent)[2]; /* [n] positions before the own one; of the first n_root their own */
};
/* Deterministic. PRT_NOMEM. Finish with prt_coarse_order_finish. */
int prt_coarse_order_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            struct prt_coarse_order *out);
void prt_coarse_order_finish(struct prt_coarse_order *order);
/* Writes the mesh with linear RGB colours [n_vertex][3] as binary .ply or .glb (COLOR_0 float),
 * in the model's own units. PRT_ARG for another ending, PRT_LIMIT (a GLB above 4 GiB), PRT_IO,
 * PRT_NOMEM. */
int prt_mesh_write_colors(const struct prt_context *ctx, const char *path,
                          const struct prt_mesh *mesh, const float (*color)[3]);

#ifdef __cplusplus
}
#endif
#endif
