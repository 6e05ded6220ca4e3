// SPDX-License-Identifier: MIT
// Packets of rays from points inside the body to their exits, and on through the open (W05 eq
// 5, eq 12).
#include "bake/loops.h"

#include <math.h>

static void gather_corners(const struct prt_mesh *mesh, const struct prt_packet *packet,
                           struct corners *c)
{
    for (int i = 0; i < 16; i++) {
        uint32_t t = packet->triangle[i];
        const uint32_t *tv = mesh->triangle[t == UINT32_MAX ? 0 : t];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) c->n[j][k][i] = mesh->normal[tv[j]][k];
    }
}

uint32_t prt_exits_of_hits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           const struct prt_packet *packet, const struct corners *normals,
                           uint32_t mask, float far_mm, struct lanes *out)
{
    uint32_t leave = 0;
    for (uint32_t b = plan->n_eta; b-- > 0;) // the same lanes leave at every index
        leave = prt_bake_loops(plan->cpu)->refract(packet, normals, plan->eta[b], &fresnel[b],
                                                   far_mm, &out[b]);
    return leave & mask;
}

uint32_t prt_trace_exits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         struct prt_packet *packet, uint32_t mask, float far_mm,
                         struct lanes *out)
{
    struct corners normals;
    prt_scene_intersect16(plan->scene, packet, mask, false);
    gather_corners(plan->mesh, packet, &normals);
    return prt_exits_of_hits(plan, fresnel, packet, &normals, mask, far_mm, out);
}

void prt_leave_body(const struct prt_packet *packet, uint32_t j, float eps,
                    struct prt_packet *shadow, uint32_t i)
{
    float x = packet->gx[j], y = packet->gy[j], z = packet->gz[j], t = packet->t[j];
    float off = eps / sqrtf(x * x + y * y + z * z + 1e-30f);
    shadow->ox[i] = packet->ox[j] + t * packet->dx[j] + off * x;
    shadow->oy[i] = packet->oy[j] + t * packet->dy[j] + off * y;
    shadow->oz[i] = packet->oz[j] + t * packet->dz[j] + off * z;
    shadow->dx[i] = packet->dx[j], shadow->dy[i] = packet->dy[j], shadow->dz[i] = packet->dz[j];
    shadow->tnear[i] = 0, shadow->tfar[i] = INFINITY;
}

uint32_t prt_blocked_lanes(const struct single_plan *plan, struct prt_packet *shadow,
                           uint32_t fill)
{
    uint32_t mask = fill == 16 ? 0xffff : (1u << fill) - 1;
    for (uint32_t i = fill; i < 16; i++) {
        shadow->ox[i] = shadow->oy[i] = shadow->oz[i] = 0;
        shadow->dx[i] = 1, shadow->dy[i] = shadow->dz[i] = 0;
        shadow->tnear[i] = 0, shadow->tfar[i] = 0;
    }
    return prt_scene_occluded16(plan->scene, shadow, mask);
}

uint64_t prt_trace_list(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const float p[3], const struct light_directions *light,
                        struct exits *out)
{
    struct prt_packet packet, shadow;
    struct lanes lane;
    uint64_t rays = 0;
    uint32_t n = light->n;
    float eps = prt_scene_epsilon(plan->scene);
    for (uint32_t first = 0; first < n; first += 16) {
        uint32_t m = n - first < 16 ? n - first : 16, mask = m < 16 ? (1u << m) - 1 : 0xffff;
        for (uint32_t i = 0; i < 16; i++) {
            uint32_t k = first + (i < m ? i : 0);
            packet.dx[i] = light->x[k], packet.dy[i] = light->y[k], packet.dz[i] = light->z[k];
            packet.ox[i] = p[0], packet.oy[i] = p[1], packet.oz[i] = p[2];
            packet.tnear[i] = 0, packet.tfar[i] = INFINITY;
        }
        const float far_mm = 1e4f; // 10 m: no light comes from there
        uint32_t leave = prt_trace_exits(plan, fresnel, &packet, mask, far_mm, &lane);
        uint32_t fill = 0, of[16];
        for (uint32_t i = 0; i < m; i++)
            if (leave >> i & 1) prt_leave_body(&packet, i, eps, &shadow, fill), of[fill++] = i;
        uint32_t blocked = fill ? prt_blocked_lanes(plan, &shadow, fill) : 0;
        for (uint32_t i = 0; i < fill; i++)
            if (blocked >> i & 1) lane.transmittance[of[i]] = 0;
        rays += m + fill;
        for (uint32_t i = 0; i < m; i++) {
            out->path_mm[first + i] = lane.path_mm[i];
            out->transmittance[first + i] = lane.transmittance[i];
            for (int k = 0; k < 3; k++) out->dir[k][first + i] = lane.dir[k][i];
        }
    }
    return rays;
}
