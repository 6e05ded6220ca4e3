/* SPDX-License-Identifier: MIT */
/* prt/trace.h owns ray tracing: Embree 3.13 or 4 behind one header. */
#ifndef PRT_TRACE_H
#define PRT_TRACE_H

#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The BVH of a whole mesh: all objects occlude, translucent or opaque. Immutable after
 * creation; the functions below may be called for one scene by any number of threads at once.
 */
struct prt_scene;
/* Builds the BVH on the threads of ctx->pool; blocks. `mesh` is referred to and must outlive
 * the scene. PRT_ARG: the mesh has no triangles; PRT_NOMEM; PRT_INTERNAL: Embree did not start.
 * *out is written on PRT_OK only; the caller ends it with prt_scene_destroy (NULL is allowed).
 */
int prt_scene_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     struct prt_scene **out);
void prt_scene_destroy(struct prt_scene *scene);
/* Builds the BVH anew with spatial splits, before the scene is used: rays take a tenth less
 * time (exits of single scattering, the bunny), building several times as long. Blocks.
 * PRT_NOMEM: the scene is of no use any more, and is still to be destroyed. */
int prt_scene_refine(const struct prt_context *ctx, struct prt_scene *scene);
/* The mesh that was given, owned by the caller of prt_scene_create. */
const struct prt_mesh *prt_scene_mesh(const struct prt_scene *scene);
/* The distance by which a ray's start is moved off its own surface [mm]: 1e-4 of the mean edge
 * or 1e-6 of the box's diagonal, whichever is larger. */
float prt_scene_epsilon(const struct prt_scene *scene);
/* The mesh with positions in the model's own units (prt_mesh_model_positions), which the BVH is
 * of: rays there meet the same at every scale. Owned by the scene. */
const struct prt_mesh *prt_scene_model(const struct prt_scene *scene);
/* The distance off the surface in these units, a power of two that small changes of the mesh
 * leave as it is; and a mm in these units. */
float prt_scene_model_epsilon(const struct prt_scene *scene);
float prt_scene_model_units(const struct prt_scene *scene);
/* To be called once by every thread that traces: flush-to-zero and denormals-are-zero. */
void prt_trace_thread_init(void);

/* The sky that the model hides from each vertex: out [n_vertex of the mesh] (prt/mesh.h). Equal
 * for any number of threads. Reports "hidden sky" as progress; blocks. PRT_NOMEM,
 * PRT_CANCELLED.
 */
int prt_scene_blocked(const struct prt_context *ctx, const struct prt_scene *scene,
                      int8_t (*out)[PRT_MESH_BLOCKED]);

enum { PRT_PACKET = 16 };
/* Up to 16 rays as arrays [mm]. Directions need not be unit vectors; t counts their lengths. A
 * function's mask selects the lanes; the others may hold anything. */
struct prt_packet {
    float ox[16], oy[16], oz[16], dx[16], dy[16], dz[16], tnear[16], tfar[16];
    /* results of prt_scene_intersect16 */
    float t[16];                  /* of the hit; tfar where the ray missed */
    float u[16], v[16];           /* barycentric coordinates; 0 where the ray missed */
    float gx[16], gy[16], gz[16]; /* (b - a) x (c - a) of the triangle that was hit */
    uint32_t triangle[16];        /* of the mesh; UINT32_MAX where the ray missed */
};
/* Bit i set: ray i of the mask is blocked between tnear and tfar. */
uint32_t prt_scene_occluded16(const struct prt_scene *scene, const struct prt_packet *packet,
                              uint32_t mask);
/* The same for a packet in the model's units. */
uint32_t prt_scene_model_occluded16(const struct prt_scene *scene,
                                    const struct prt_packet *packet, uint32_t mask);
/* The nearest hits of the rays of the mask. coherent: the rays have a common origin and similar
 * directions (a hint to Embree; the results are the same). */
void prt_scene_intersect16(const struct prt_scene *scene, struct prt_packet *packet,
                           uint32_t mask, bool coherent);
/* The nearest hit of one ray from o along d [mm], for places where speed does not matter. A ray
 * that misses is tried again in three slightly different directions, because it may have passed
 * through a seam between triangles. Returns whether something was hit; then *t, *triangle, *u
 * and *v are as in a packet. */
bool prt_scene_intersect(const struct prt_scene *scene, const float o[3], const float d[3],
                         float tnear, float tfar, float *t, uint32_t *triangle, float *u,
                         float *v);

#ifdef __cplusplus
}
#endif
#endif
