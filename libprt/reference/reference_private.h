/* SPDX-License-Identifier: MIT */
/* The state of one call of the reference engine. */
#ifndef PRT_REFERENCE_PRIVATE_H
#define PRT_REFERENCE_PRIVATE_H

#include "prt/reference.h"
#include "prt/surface.h"
#include "prt/trace.h"
#include "prt/walk.h"
#include "reference/lights.h"

struct job {
    // The medium and the light at hand: set in a copy of the job for each vertex.
    const struct prt_context *ctx;
    const struct prt_mesh *mesh;
    const struct prt_material *material;
    const struct prt_reference_options *o;
    struct prt_scene *scene;
    struct prt_surface_points *surface;
    struct light_rays *rays;
    uint32_t *vertex_block;
    uint32_t *corner_begin, *corner; // triangles around each welded vertex
    unsigned n_map, n_light;
    const struct prt_media *media;       // [n_map]
    struct prt_diffusion (**dipoles)[3]; // [n_map], each [media[m].n]
    struct light_rays **lights;          // [n_light] rays that vertices trace
    float *irradiance;                   // [n_light][3][n_sample]
    float (*const *color)[3];            // [n_map * n_light]
    // With walks (METHODS §9).
    struct prt_walk_space *space;
    struct prt_surface_strata *strata;
    struct walk_tally *tally;
};

struct walk_tally { // atomic
    uint64_t walks, lost;
};

// Light of one vertex under one light by walks.
struct walk_light {
    double multiple[3], unscattered[3]; // B/pi of two and more, and of no scatterings
    double error[3];                    // standard error of the term asked for
};

static inline float dot3(const float a[3], const float b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}
/* Unit flat normal of a triangle; 0 where it has no area. */
void prt_reference_face_normal(const struct prt_mesh *mesh, uint32_t t, float out[3]);
/* L1 of vertex v under j->rays in j->material (METHODS §1, single scattering). */
void prt_reference_single(const struct job *j, uint32_t v, float out[3]);
/* What walks need besides samples and their irradiance. */
int prt_reference_walk_prepare(struct job *j);
/* Walks from vertex v in `material` under every light: out[n_light]. */
void prt_reference_walk(struct job *j, const struct prt_material *material, uint32_t v,
                        struct walk_light *out);

#endif
