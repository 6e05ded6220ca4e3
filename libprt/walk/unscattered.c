// SPDX-License-Identifier: MIT
// Light that crosses a body without a scattering (METHODS §9): straight paths that divide at
// the boundary. No random number decides what a path does, so that few paths suffice.
#include "walk/walk_private.h"

#include <math.h>
#include <string.h>

enum { MOST_BOUNCES = 64 };
static const float least_light = 1e-4f;

struct path {
    float p[3], d[3]; // mm, unit
    float length, share;
    uint32_t index, bounces;
    bool on;
};

static float fraction(float x)
{
    return x - floorf(x);
}

// Path i: equal strata of F_t cos, and azimuths by the golden ratio; shifted by the seed.
static void begin_path(const struct prt_walk_space *space, const struct prt_walk_start *start,
                       float eta, const float cosine[WALK_ANGLES + 1], uint32_t i, uint32_t n,
                       struct path *out)
{
    const float *normal = start->normal, *away = start->inward;
    float tangent[3], bitangent[3];
    float shift[2] = {(float)(start->seed >> 40) * 0x1p-24f,
                      (float)(start->seed >> 16 & 0xffffff) * 0x1p-24f};
    float at = ((float)i + shift[0]) / (float)n * WALK_ANGLES;
    float phi = 2 * (float)M_PI * fraction((float)i * 0.61803399f + shift[1]);
    int k = at < WALK_ANGLES - 1 ? (int)at : WALK_ANGLES - 1;
    float outside = cosine[k] + (at - (float)k) * (cosine[k + 1] - cosine[k]);
    float sine = sqrtf(fmaxf(1 - outside * outside, 0)) / eta, inside = sqrtf(1 - sine * sine);
    bool given = away[0] != 0 || away[1] != 0 || away[2] != 0;
    prt_walk_frame(normal, tangent, bitangent);
    *out = (struct path){.share = 1, .index = i, .on = true};
    for (int c = 0; c < 3; c++) {
        out->d[c] =
            -inside * normal[c] + sine * (cosf(phi) * tangent[c] + sinf(phi) * bitangent[c]);
        out->p[c] = start->position[c] + space->epsilon * (given ? away[c] : -normal[c]);
    }
}

struct crossing {
    const struct prt_walk_space *space;
    const struct prt_walk_start *start;
    float eta, sigma_t;
    void (*sink)(void *arg, const struct prt_walk_exit *exit);
    void *arg;
};

// The path's ray met a triangle: a share leaves, the rest is reflected.
static void at_boundary(const struct crossing *c, struct path *w, const struct prt_packet *ray,
                        int i)
{
    uint32_t triangle = ray->triangle[i];
    w->on = false;
    if (triangle == UINT32_MAX) return;
    if (c->space->triangle_object[triangle] != c->start->object) return;
    float g[3] = {ray->gx[i], ray->gy[i], ray->gz[i]}, cosine = 0;
    float scale = 1 / sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    for (int k = 0; k < 3; k++) {
        g[k] *= scale;
        cosine += g[k] * w->d[k];
    }
    if (!(cosine > 0)) return;
    float reflected = prt_walk_inner_reflectance(c->eta, fminf(cosine, 1));
    w->length += ray->t[i];
    if (reflected < 1)
        c->sink(c->arg, &(struct prt_walk_exit){w->index, triangle, ray->u[i], ray->v[i],
                                                w->length, 0, w->share * (1 - reflected)});
    w->share *= reflected;
    for (int k = 0; k < 3; k++) {
        w->p[k] += ray->t[i] * w->d[k] - c->space->epsilon * g[k];
        w->d[k] -= 2 * cosine * g[k];
    }
    w->on =
        ++w->bounces < MOST_BOUNCES && w->share * expf(-c->sigma_t * w->length) > least_light;
}

static void trace(const struct crossing *c, struct path lane[PRT_PACKET], uint32_t busy)
{
    struct prt_packet ray;
    memset(&ray, 0, sizeof ray);
    while (busy) {
        for (int i = 0; i < PRT_PACKET; i++) {
            ray.ox[i] = lane[i].p[0], ray.oy[i] = lane[i].p[1], ray.oz[i] = lane[i].p[2];
            ray.dx[i] = lane[i].d[0], ray.dy[i] = lane[i].d[1], ray.dz[i] = lane[i].d[2];
            ray.tfar[i] = INFINITY;
        }
        prt_scene_intersect16(c->space->scene, &ray, busy, false);
        for (int i = 0; i < PRT_PACKET; i++) {
            if (!(busy >> i & 1)) continue;
            at_boundary(c, &lane[i], &ray, i);
            if (!lane[i].on) busy &= ~(1u << i);
        }
    }
}

void prt_walk_unscattered(const struct prt_walk_space *space,
                          const struct prt_walk_start *start, float eta, float sigma_t,
                          uint32_t n_ray,
                          void (*sink)(void *arg, const struct prt_walk_exit *exit), void *arg)
{
    const struct crossing c = {space, start, eta, sigma_t, sink, arg};
    float cosine[WALK_ANGLES + 1];
    prt_walk_first_cosines(eta, cosine);
    for (uint32_t first = 0; first < n_ray; first += PRT_PACKET) {
        struct path lane[PRT_PACKET];
        uint32_t n = n_ray - first < PRT_PACKET ? n_ray - first : PRT_PACKET;
        memset(lane, 0, sizeof lane);
        for (uint32_t i = 0; i < n; i++)
            begin_path(space, start, eta, cosine, first + i, n_ray, &lane[i]);
        trace(&c, lane, (1u << n) - 1);
    }
}
