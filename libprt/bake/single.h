/* SPDX-License-Identifier: MIT */
/* The pieces of single scattering: packets of rays to exits (single_exits.c), the rays of a
 * vertex (single_nodes.c), cells and rows (single.c). Private to these files. */
#ifndef PRT_BAKE_SINGLE_H
#define PRT_BAKE_SINGLE_H

#include "bake/path_integral.h"

/* Exits of up to 16 rays. transmittance 0: no light comes from there. */
struct lanes {
    float path_mm[16];       /* s_i' [mm] */
    float transmittance[16]; /* F_t(eta, w_i), or 0 */
    float dir[3][16];        /* w_i', outward */
    float cosine[16];        /* w_i . n_i; 0: no exit */
};
/* The exits of the lanes of mask, rays from inside the body that found what they hit, out
 * [plan->n_eta], since rays do not depend on eta. transmittance does not yet count occlusion
 * beyond the exit. Lanes without an exit get the path length far_mm and no light. Returns the
 * lanes of mask that leave the body. */
uint32_t prt_exits_of_hits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           const struct prt_packet *packet, const struct corners *normals,
                           uint32_t mask, float far_mm, struct lanes *out);
/* The same for rays that are traced first. */
uint32_t prt_trace_exits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         struct prt_packet *packet, uint32_t mask, float far_mm,
                         struct lanes *out);
/* Lane i of `shadow` becomes the ray from lane j's exit onwards, eps [mm] off the triangle. */
void prt_leave_body(const struct prt_packet *packet, uint32_t j, float eps,
                    struct prt_packet *shadow, uint32_t i);
/* The lanes among the first `fill` whose ray meets the surface again. Fills the idle lanes. */
uint32_t prt_blocked_lanes(const struct single_plan *plan, struct prt_packet *shadow,
                           uint32_t fill);
/* One ray for each of the light's directions from point p [mm]. Returns the rays cast. */
uint64_t prt_trace_list(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const float p[3], const struct light_directions *light,
                        struct exits *out);

/* A path of one vertex: nodes at x - depth out. */
struct vertex_path {
    const float *x, *out; /* position [mm]; outward direction, the normal or another */
    unsigned pattern;     /* jitter of the sub-samples */
    const float *depth;   /* [n_node] mm */
};
/* Fills the nodes for every texel, and s->fine and s->split. Returns the rays cast. */
uint64_t prt_trace_nodes(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const struct vertex_path *path, struct scratch *s);
/* A ray for every texel from point p into node 0. Returns the rays cast. */
uint64_t prt_trace_every(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const float p[3], unsigned pattern, struct scratch *s);

/* The sub-sample that stands for texel i (0..3) of a block: an index into directions->x. */
static inline size_t texel_ray(const struct directions *d, unsigned pattern, uint32_t block,
                               uint32_t i)
{
    return ((size_t)(pattern % d->n_pattern) * d->n_packet + block) * 16 + i * 4 +
           (((pattern >> 6) + i) & 3);
}
/* The j-th block (0..3) of tile t, on faces of 2^log_wide tiles. */
static inline uint32_t block_of(uint32_t t, uint32_t j, unsigned log_wide)
{
    const uint32_t y = (t >> log_wide) * 2 + (j >> 1), x = (t & ((1u << log_wide) - 1)) * 2;
    return (y << (log_wide + 1)) + x + (j & 1);
}
/* Whether a plan's values are smooth between blocks: not those of a free medium, whose many
 * functions would cost a joint bake some 25 s of CPU time. */
static inline bool prt_single_smooth(const struct single_plan *plan)
{
    return !plan->every_ray && !plan->extinction;
}
/* Values of a face's texels that share those of a block, [n][n], become bilinear between the
 * means of blocks. cell: the face's cells. mean: room for n n / 4. */
void prt_smooth_blocks(const uint32_t *cell, uint32_t n, float *value, float *mean);

#endif
