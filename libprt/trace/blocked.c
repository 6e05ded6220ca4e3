// SPDX-License-Identifier: MIT
// The part of the sky that the model itself hides from each vertex, as spherical harmonics: it
// takes from reflections the light that cannot arrive (METHODS §6, specular occlusion).
#include "prt/medium.h"
#include "prt/trace.h"

#include <math.h>
#include <string.h>

enum { N_DIRECTION = 256, N_COEF = PRT_MESH_BLOCKED };

struct job {
    const struct prt_scene *scene;
    float direction[N_DIRECTION][3], harmonic[N_DIRECTION][N_COEF];
    int8_t (*out)[N_COEF];
};

// A spiral of equal solid angles, by the golden angle.
static void choose_directions(struct job *job)
{
    for (int i = 0; i < N_DIRECTION; i++) {
        double y = 1 - 2 * (i + 0.5) / N_DIRECTION, turn = 2 * M_PI * i * 0.6180339887498949;
        float *d = job->direction[i];
        d[0] = (float)(sqrt(1 - y * y) * cos(turn));
        d[1] = (float)y;
        d[2] = (float)(sqrt(1 - y * y) * sin(turn));
        prt_sh_eval(4, d, job->harmonic[i]);
    }
}

// A hidden direction counts with its mirror image in the tangent plane: the function is then
// even, and reflections near the horizon are not averaged with directions below it.
static void add_hidden(const struct job *job, int i, const float n[3], double sum[N_COEF])
{
    const float *d = job->direction[i];
    float c = 2 * (d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), y[N_COEF];
    prt_sh_eval(4, (float[]){d[0] - c * n[0], d[1] - c * n[1], d[2] - c * n[2]}, y);
    for (int k = 0; k < N_COEF; k++) sum[k] += (double)(job->harmonic[i][k] + y[k]);
}

static void trace_vertex(const struct job *job, uint32_t v)
{
    const struct prt_mesh *m = prt_scene_mesh(job->scene);
    const float *p = m->position[v], *n = m->normal[v], off = prt_scene_epsilon(job->scene);
    double sum[N_COEF] = {0};
    for (int i = 0; i < N_DIRECTION; i += PRT_PACKET) {
        struct prt_packet packet;
        uint32_t mask = 0;
        for (int k = 0; k < PRT_PACKET; k++) {
            const float *d = job->direction[i + k];
            packet.ox[k] = p[0] + off * n[0];
            packet.oy[k] = p[1] + off * n[1];
            packet.oz[k] = p[2] + off * n[2];
            packet.dx[k] = d[0];
            packet.dy[k] = d[1];
            packet.dz[k] = d[2];
            packet.tnear[k] = off;
            packet.tfar[k] = INFINITY;
            mask |= (uint32_t)(d[0] * n[0] + d[1] * n[1] + d[2] * n[2] > 0) << k;
        }
        uint32_t hidden = mask ? prt_scene_occluded16(job->scene, &packet, mask) & mask : 0;
        for (int k = 0; hidden >> k; k++)
            if (hidden >> k & 1) add_hidden(job, i + k, n, sum);
    }
    for (int k = 0; k < N_COEF; k++) {
        double value = sum[k] * 4 * M_PI / N_DIRECTION * 127 / PRT_MESH_BLOCKED_SCALE;
        job->out[v][k] = (int8_t)lrint(fmin(fmax(value, -127), 127));
    }
}

static int trace_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    prt_trace_thread_init();
    for (size_t v = begin; v < end; v++) trace_vertex(arg, (uint32_t)v);
    return PRT_OK;
}

int prt_scene_blocked(const struct prt_context *ctx, const struct prt_scene *scene,
                      int8_t (*out)[PRT_MESH_BLOCKED])
{
    struct job *job = prt_calloc(1, sizeof *job);
    if (!job) return prt_fail(ctx, PRT_NOMEM, "no memory for hidden directions");
    job->scene = scene;
    job->out = out;
    choose_directions(job);
    int status = prt_parallel_for(ctx, "hidden sky", prt_scene_mesh(scene)->n_vertex, 256,
                                  trace_range, job);
    prt_free(job);
    return status;
}
