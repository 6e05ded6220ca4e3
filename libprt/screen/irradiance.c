// SPDX-License-Identifier: MIT
// Irradiance at samples: E = sum over lights of F_t(eta, n.w) V (n.w) L (METHODS §1), by shadow
// rays, by interpolation from vertices, or by spherical harmonics without shadows.
#include "internal.h"

#include <math.h>
#include <stdatomic.h>
#include <string.h>

struct job {
    const struct prt_scene *scene;
    const struct prt_screen_light *light;
    uint32_t n_light;
    const float *eta;
    struct samples *s;
    float epsilon;
    atomic_uint_fast64_t rays;
};

// F_t cos for 16 lanes, exact and unpolarised; eta 0: the cosine alone, for Lambertian
// surfaces.
static void lobe16(const float *cosine, const float *eta, float *out)
{
    for (int i = 0; i < 16; i++) {
        float c = cosine[i], n = eta[i] > 0 ? eta[i] : 1;
        float ct = sqrtf(1 - (1 - c * c) / (n * n) + 1e-12f);
        float rs = (c - n * ct) / (c + n * ct), rp = (n * c - ct) / (n * c + ct);
        float t = eta[i] > 0 ? 1 - 0.5f * (rs * rs + rp * rp) : 1;
        out[i] = c > 0 ? t * c : 0;
    }
}

static uint32_t block16(struct job *job, size_t at, int n)
{
    struct samples *s = job->s;
    struct prt_packet packet;
    float eta[16], cosine[16], face[16], lobe[16], scale[16], sum[3][16];
    uint32_t rays = 0;
    memset(sum, 0, sizeof sum);
    memset(&packet, 0, sizeof packet);
    for (int i = 0; i < 16; i++) {
        size_t k = at + (size_t)(i < n ? i : n - 1);
        eta[i] = job->eta ? job->eta[s->object[k]] : 0;
        packet.ox[i] = s->p[0][k];
        packet.oy[i] = s->p[1][k];
        packet.oz[i] = s->p[2][k];
        packet.tnear[i] = job->epsilon;
    }
    for (uint32_t l = 0; l < job->n_light; l++) {
        const struct prt_screen_light *light = &job->light[l];
        const float *w = light->where;
        for (int i = 0; i < 16; i++) {
            size_t k = at + (size_t)(i < n ? i : n - 1);
            float d[3] = {w[0], w[1], w[2]}, far = INFINITY, inv = 1;
            if (light->point) {
                for (int j = 0; j < 3; j++) d[j] -= s->p[j][k];
                float l2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + 1e-20f;
                far = sqrtf(l2);
                inv = 1 / l2;
                for (int j = 0; j < 3; j++) d[j] /= far;
            }
            packet.dx[i] = d[0];
            packet.dy[i] = d[1];
            packet.dz[i] = d[2];
            packet.tfar[i] = far;
            scale[i] = inv;
            cosine[i] =
                d[0] * s->normal[0][k] + d[1] * s->normal[1][k] + d[2] * s->normal[2][k];
            face[i] = d[0] * s->face[0][k] + d[1] * s->face[1][k] + d[2] * s->face[2][k];
            cosine[i] = cosine[i] < 1 ? cosine[i] : 1;
        }
        uint32_t mask = 0;
        for (int i = 0; i < n; i++) mask |= (uint32_t)(cosine[i] > 0 && face[i] > 0) << i;
        if (!mask) continue;
        rays += (uint32_t)__builtin_popcount(mask);
        mask &= ~prt_scene_occluded16(job->scene, &packet, mask);
        if (!mask) continue;
        lobe16(cosine, eta, lobe);
        for (int i = 0; i < n; i++) {
            float f = mask >> i & 1 ? lobe[i] * scale[i] : 0;
            for (int c = 0; c < 3; c++) sum[c][i] += f * light->rgb[c];
        }
    }
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < n; i++) s->e[c][at + (size_t)i] = sum[c][i];
    return rays;
}

static int run(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *job = arg;
    uint64_t rays = 0;
    prt_trace_thread_init();
    for (size_t at = begin; at < end; at += 16)
        rays += block16(job, at, end - at < 16 ? (int)(end - at) : 16);
    atomic_fetch_add(&job->rays, rays);
    return PRT_OK;
}

int prt_irradiance_traced(const struct prt_context *ctx, const struct prt_scene *scene,
                          uint32_t n_light, const struct prt_screen_light *light,
                          const float *eta, struct samples *s, uint64_t *n_ray)
{
    struct job job = {.scene = scene,
                      .light = light,
                      .n_light = n_light,
                      .eta = eta,
                      .s = s,
                      .epsilon = prt_scene_epsilon(scene)};
    int status = prt_screen_loop(ctx, s->n, 512, run, &job);
    *n_ray += atomic_load(&job.rays);
    return status;
}

struct vertex_job {
    const struct prt_mesh *mesh;
    const float (*e)[3];
    struct samples *s;
};

static int interpolate(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct vertex_job *job = arg;
    struct samples *s = job->s;
    for (size_t i = begin; i < end; i++) {
        const uint32_t *v = job->mesh->triangle[s->triangle[i]];
        float a = s->bary[0][i], b = s->bary[1][i];
        for (int c = 0; c < 3; c++) {
            float e = (1 - a - b) * job->e[v[0]][c] + a * job->e[v[1]][c] + b * job->e[v[2]][c];
            s->e[c][i] = e > 0 && isfinite(e) ? e : 0;
        }
    }
    return PRT_OK;
}

int prt_irradiance_vertices(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            const float (*e)[3], struct samples *s)
{
    struct vertex_job job = {mesh, e, s};
    return prt_parallel_for(ctx, NULL, s->n, 2048, interpolate, &job);
}

bool prt_visible_samples(const struct frame *f, uint32_t n, const uint32_t *index,
                         struct samples *s)
{
    const struct prt_gbuffer *g = &f->g;
    const struct prt_mesh *mesh = f->screen->mesh;
    if (!prt_samples_init(s, n)) return false;
    s->n = n;
    for (uint32_t at = 0; at < n; at++) {
        uint32_t i = index ? index[at] : at;
        const uint32_t *v = mesh->triangle[g->triangle[i]];
        float e[2][3], face[3], l = 0, facing = 0;
        for (int k = 0; k < 3; k++) {
            e[0][k] = mesh->position[v[1]][k] - mesh->position[v[0]][k];
            e[1][k] = mesh->position[v[2]][k] - mesh->position[v[0]][k];
            s->p[k][at] = g->position[k][i];
            s->normal[k][at] = g->normal[k][i];
        }
        for (int k = 0; k < 3; k++) {
            int a = (k + 1) % 3, b = (k + 2) % 3;
            face[k] = e[0][a] * e[1][b] - e[0][b] * e[1][a];
            l += face[k] * face[k];
            facing += face[k] * g->normal[k][i];
        }
        l = l > 0 ? (facing < 0 ? -1 : 1) / sqrtf(l) : 0;
        for (int k = 0; k < 3; k++) s->face[k][at] = face[k] * l;
        s->object[at] = mesh->block[g->block[i]].object;
        s->triangle[at] = g->triangle[i];
        for (int k = 0; k < 2; k++) s->bary[k][at] = g->bary[k][i];
    }
    return true;
}

// Coefficients of the cube's light for the 16 harmonics of 4 bands.
static void project_cube(const struct prt_cube *cube, double light[16][3])
{
    const uint32_t n = cube->n;
    memset(light, 0, 16 * sizeof *light);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        uint32_t y = i / n % n, x = i % n;
        const float *t = cube->texel + (size_t)i * 3;
        float d[3], h[16];
        prt_cube_direction(i / (n * n), (2 * x + 1.0) / n - 1, (2 * y + 1.0) / n - 1, d);
        prt_sh_eval(4, d, h);
        double omega = prt_cube_solid_angle(n, x, y);
        for (int k = 0; k < 16; k++)
            for (int c = 0; c < 3; c++) light[k][c] += h[k] * t[c] * omega;
    }
}

// f_l = 2 pi int F_t(c) c P_l(c) dc, by 256 midpoints.
static void zonal_transmittance(float eta, double zonal[4])
{
    memset(zonal, 0, 4 * sizeof *zonal);
    for (int k = 0; k < 256; k++) {
        double c = (k + 0.5) / 256, f = prt_fresnel_transmittance(eta, c) * c;
        double p[4] = {1, c, (3 * c * c - 1) / 2, (5 * c * c * c - 3 * c) / 2};
        for (int l = 0; l < 4; l++) zonal[l] += 2 * M_PI * f * p[l] / 256;
    }
}

void prt_irradiance_harmonics(const struct prt_cube *cube, const float *eta, bool add,
                              struct samples *s)
{
    static const int band[16] = {0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3};
    double light[16][3], zonal[4] = {0};
    float last = -1;
    project_cube(cube, light);
    for (uint32_t i = 0; i < s->n; i++) {
        float own = eta[s->object[i]];
        if (own != last) zonal_transmittance(own, zonal);
        last = own;
        float n[3] = {s->normal[0][i], s->normal[1][i], s->normal[2][i]}, h[16];
        prt_sh_eval(4, n, h);
        for (int c = 0; c < 3; c++) {
            double e = 0;
            for (int k = 0; k < 16; k++) e += zonal[band[k]] * light[k][c] * h[k];
            s->e[c][i] = (add ? s->e[c][i] : 0) + (e > 0 ? (float)e : 0);
        }
    }
}
