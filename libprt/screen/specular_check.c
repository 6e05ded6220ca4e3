// SPDX-License-Identifier: MIT
// Reflections against traced rays: the error of specular occlusion (METHODS §6) at points of a
// picture, with the GGX lobe of raster/specular.c and the same light.
#include "prt/screen.h"
#include "prt/trace.h"

#include <math.h>
#include <string.h>

enum { N_RAY = 256, MOST_POINT = 4096 };

struct check {
    const struct prt_scene *scene;
    const struct prt_gbuffer *g;
    const struct prt_cube *light;
    float eye[3], eta, roughness;
    double (*sum)[3]; // [n] of error^2 with, without occlusion, of the reference^2
    uint32_t n, step;
};

static float luminance(const float *rgb)
{
    return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2];
}

static float radiance(const struct prt_cube *cube, const float d[3])
{
    unsigned face;
    float s, t;
    const uint32_t n = cube->n;
    prt_cube_lookup(d, &face, &s, &t);
    uint32_t x = (uint32_t)fminf((s + 1) / 2 * (float)n, (float)n - 1);
    uint32_t y = (uint32_t)fminf((t + 1) / 2 * (float)n, (float)n - 1);
    return luminance(cube->texel + 3 * ((size_t)(face * n + y) * n + x));
}

static void basis_of(const float axis[3], float u[3], float v[3])
{
    int a = fabsf(axis[0]) > 0.7f;
    float l = hypotf(axis[!a], axis[2]);
    memset(u, 0, 12);
    u[!a] = axis[2] / l;
    u[2] = -axis[!a] / l;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, k = (i + 2) % 3;
        v[i] = axis[j] * u[k] - axis[k] * u[j];
    }
}

// Directions of the lobe's density about the axis, weighed by their cosine to it. Returns the
// sums of light of all directions, of the open ones, and of the weights.
static void trace_lobe(const struct check *c, const float o[3], const float axis[3],
                       const float normal[3], double out[3])
{
    float u[3], v[3], a2 = c->roughness * c->roughness * c->roughness * c->roughness;
    basis_of(axis, u, v);
    for (int i = 0; i < N_RAY; i += PRT_PACKET) {
        struct prt_packet p;
        float light[PRT_PACKET], weight[PRT_PACKET];
        uint32_t mask = 0;
        for (int k = 0; k < PRT_PACKET; k++) {
            float e = ((float)(i + k) + 0.5f) / N_RAY, turn = (float)(i + k) * 2.39996323f,
                  d[3];
            float h2 = (1 - e) / (1 + (a2 - 1) * e), cosine = 2 * h2 - 1;
            float sine = sqrtf(fmaxf(1 - cosine * cosine, 0)), up = 0;
            for (int j = 0; j < 3; j++) {
                d[j] = cosine * axis[j] + sine * (cosf(turn) * u[j] + sinf(turn) * v[j]);
                up += d[j] * normal[j];
            }
            p.ox[k] = o[0];
            p.oy[k] = o[1];
            p.oz[k] = o[2];
            p.dx[k] = d[0];
            p.dy[k] = d[1];
            p.dz[k] = d[2];
            p.tnear[k] = 0;
            p.tfar[k] = INFINITY;
            weight[k] = fmaxf(cosine, 0);
            light[k] = weight[k] * radiance(c->light, d);
            mask |= (uint32_t)(up > 0) << k;
        }
        uint32_t open = mask & ~prt_scene_occluded16(c->scene, &p, mask);
        for (int k = 0; k < PRT_PACKET; k++) {
            out[0] += (double)light[k]; // as the filtered environment: no horizon
            out[1] += open >> k & 1 ? (double)light[k] : 0;
            out[2] += (double)weight[k];
        }
    }
}

static void check_point(const struct check *c, uint32_t i, double sum[3])
{
    const struct prt_gbuffer *g = c->g;
    float n[3], w[3], r[3], o[3], cosine = 0, l = 0;
    double lobe[3] = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        n[k] = g->normal[k][i];
        w[k] = c->eye[k] - g->position[k][i];
        l += w[k] * w[k];
    }
    for (int k = 0; k < 3; k++) cosine += n[k] * (w[k] /= sqrtf(l));
    if (g->opaque[i] || cosine < 0.02f) return;
    for (int k = 0; k < 3; k++) {
        r[k] = 2 * cosine * n[k] - w[k];
        o[k] = g->position[k][i] + 2 * prt_scene_epsilon(c->scene) * n[k];
    }
    trace_lobe(c, o, r, n, lobe);
    double share = 1 - prt_fresnel_transmittance((double)c->eta, (double)cosine);
    double all = share * lobe[0] / lobe[2], open = share * lobe[1] / lobe[2];
    double ours = g->unblocked ? all * (double)g->unblocked[i] : all;
    sum[0] = (ours - open) * (ours - open);
    sum[1] = (all - open) * (all - open);
    sum[2] = open * open;
}

static int check_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct check *c = arg;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++) check_point(c, (uint32_t)i * c->step, c->sum[i]);
    return PRT_OK;
}

int prt_specular_error(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_visibility *visibility, const struct prt_cube *light,
                       float eta, float roughness, double *error, double *without)
{
    struct prt_gbuffer g;
    float forward[3], right[3], up[3];
    prt_visibility_gbuffer(visibility, &g);
    struct check c = {scene, &g, light, {0}, eta, roughness, NULL, 0, 1};
    prt_visibility_frame(visibility, c.eye, forward, right, up);
    c.step = g.n_point / MOST_POINT + 1;
    c.n = g.n_point / c.step;
    c.sum = prt_calloc(c.n + 1, sizeof *c.sum);
    if (!c.sum) return prt_fail(ctx, PRT_NOMEM, "no memory for %u points", c.n);
    int status = prt_parallel_for(ctx, NULL, c.n, 64, check_range, &c);
    double total[3] = {0, 0, 0};
    for (uint32_t i = 0; i < c.n; i++)
        for (int k = 0; k < 3; k++) total[k] += c.sum[i][k];
    prt_free(c.sum);
    *error = total[2] > 0 ? sqrt(total[0] / total[2]) : 0;
    *without = total[2] > 0 ? sqrt(total[1] / total[2]) : 0;
    return status;
}
