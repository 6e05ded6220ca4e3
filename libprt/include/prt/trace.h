/* SPDX-License-Identifier: MIT */
/* prt/trace.h owns ray tracing: Embree behind one header (3.13 and 4). */
#ifndef PRT_TRACE_H
#define PRT_TRACE_H

#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Immutable BVH of a whole mesh (all objects occlude). Thread-safe after creation. */
struct prt_scene;
int prt_scene_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     struct prt_scene **out);
void prt_scene_destroy(struct prt_scene *scene);
const struct prt_mesh *prt_scene_mesh(const struct prt_scene *scene);
/* A distance that moves a ray's start off its own surface: 1e-4 of mean edge or 1e-6 of the
 * box diagonal, whichever is larger [mm]. */
float prt_scene_epsilon(const struct prt_scene *scene);
/* Call once in every thread that traces: flush-to-zero, denormals-are-zero. */
void prt_trace_thread_init(void);

enum { PRT_PACKET = 16 };
/* n <= 16 rays as arrays; dir need not be unit (t in its length). Lanes with mask bit 0 idle.
 */
struct prt_packet {
    float ox[16], oy[16], oz[16], dx[16], dy[16], dz[16], tnear[16], tfar[16];
    /* results of prt_scene_intersect16 */
    float t[16], u[16], v[16];    /* t = tfar kept where missed */
    float gx[16], gy[16], gz[16]; /* (b - a) x (c - a) of the triangle met */
    uint32_t triangle[16];        /* mesh triangle index, UINT32_MAX where missed */
};
/* Bit i set: ray i is blocked in (tnear, tfar). coherent: common origin, near directions. */
uint32_t prt_scene_occluded16(const struct prt_scene *scene, const struct prt_packet *packet,
                              uint32_t mask);
void prt_scene_intersect16(const struct prt_scene *scene, struct prt_packet *packet,
                           uint32_t mask, bool coherent);
/* Single rays, for places where speed does not matter. What passes through a seam between
 * triangles is tried again a little beside. */
bool prt_scene_occluded(const struct prt_scene *scene, const float o[3], const float d[3],
                        float tnear, float tfar);
bool prt_scene_intersect(const struct prt_scene *scene, const float o[3], const float d[3],
                         float tnear, float tfar, float *t, uint32_t *triangle, float *u,
                         float *v);

#ifdef __cplusplus
}
#endif
#endif
