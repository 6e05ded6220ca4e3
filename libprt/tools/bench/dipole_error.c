// SPDX-License-Identifier: MIT
// The error of the dipole: its multiple scattering against that of random walks (METHODS §9),
// for the measured media on a ball, a slab, a leaf and --model at 50 mm, under even light. Two
// sets of walks differ in their noise alone: the product of the differences from both holds
// neither.
#include "bench.h"

#include "prt/reference.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    VERTICES = 96,
    CUBE = 16,
    SIDE = 32,
    /* a power of two: edges of two faces are equal */ AROUND = 48,
    DOWN = 24
};

struct shape {
    uint32_t n_vertex, n_triangle;
    float position[8 * SIDE * SIDE][3];
    uint32_t triangle[16 * SIDE * SIDE][3];
};

static void add_square(struct shape *s, const uint32_t corner[4])
{
    const uint32_t a[3] = {corner[0], corner[1], corner[2]};
    const uint32_t b[3] = {corner[0], corner[2], corner[3]};
    memcpy(s->triangle[s->n_triangle++], a, sizeof a);
    memcpy(s->triangle[s->n_triangle++], b, sizeof b);
}

// A closed plate of half sizes h, thin along y, whose rim has two squares across; each face has
// vertices of its own.
static void add_plate(struct shape *s, const float h[3])
{
    static const uint32_t squares[3] = {SIDE, 2, SIDE};
    for (int face = 0; face < 6; face++) {
        const int k = face / 2, i = (k + 1) % 3, j = (k + 2) % 3;
        const float sign = face % 2 ? -1 : 1;
        const uint32_t first = s->n_vertex, n = squares[i], wide = n + 1;
        for (uint32_t y = 0; y <= squares[j]; y++)
            for (uint32_t x = 0; x <= n; x++) {
                float *p = s->position[s->n_vertex++];
                p[k] = sign * h[k];
                p[i] = h[i] * sign * (2 * (float)x / (float)n - 1);
                p[j] = h[j] * (2 * (float)y / (float)squares[j] - 1);
            }
        for (uint32_t y = 0; y < squares[j]; y++)
            for (uint32_t x = 0; x < n; x++) {
                const uint32_t at = first + y * wide + x;
                add_square(s, (const uint32_t[]){at, at + 1, at + wide + 1, at + wide});
            }
    }
}

// A closed ball of half sizes h, bent: y grows by x^2 / bend_mm.
static void add_ball(struct shape *s, const float h[3], float bend_mm)
{
    for (uint32_t y = 0; y <= DOWN; y++)
        for (uint32_t x = 0; x < AROUND; x++) {
            const double theta = M_PI * y / DOWN, phi = 2 * M_PI * x / AROUND;
            const double out = y % DOWN ? sin(theta) : 0; // one point at each pole
            float *p = s->position[s->n_vertex++];
            p[0] = h[0] * (float)(out * cos(phi));
            p[2] = -h[2] * (float)(out * sin(phi));
            p[1] = h[1] * (float)cos(theta) + (bend_mm > 0 ? p[0] * p[0] / bend_mm : 0);
        }
    for (uint32_t y = 0; y < DOWN; y++)
        for (uint32_t x = 0; x < AROUND; x++) {
            const uint32_t right = (x + 1) % AROUND, at = y * AROUND, below = at + AROUND;
            add_square(s, (const uint32_t[]){at + x, below + x, below + right, at + right});
        }
}

static int errors_of(struct bench_env *env, const char *body, const struct prt_mesh *mesh,
                     const struct prt_cube *light, const struct prt_material *m)
{
    static float got[3][VERTICES][3];
    uint32_t vertex[VERTICES];
    const struct prt_media media = prt_media_one(m);
    struct prt_reference_options o = {.term = PRT_REFERENCE_MULTIPLE,
                                      .n_sample = 30000,
                                      .n_ray = 256,
                                      .vertex = vertex,
                                      .n_vertex = VERTICES};
    double error = 0, noise = 0, all = 0;
    int status = PRT_OK;
    for (uint32_t i = 0; i < VERTICES; i++)
        vertex[i] = (uint32_t)(((uint64_t)i * mesh->n_vertex + mesh->n_vertex / 2) / VERTICES);
    for (unsigned k = 0; k < 3 && !status; k++) {
        o.n_walk = k ? (env->quick ? 32 : 512) : 0;
        o.seed = env->seed + k;
        status = prt_reference_colors(&env->ctx, mesh, &media, light, &o, got[k]);
    }
    if (status) return status;
    for (uint32_t i = 0; i < 3 * VERTICES; i++) {
        const double d = (double)got[0][i / 3][i % 3], a = (double)got[1][i / 3][i % 3],
                     b = (double)got[2][i / 3][i % 3];
        error += (d - a) * (d - b);
        noise += (a - b) * (a - b) / 4;
        all += a * b;
    }
    bench_begin(env, "dipole_error");
    bench_text("body", body);
    bench_text("medium", m->name);
    bench_number("dipole_error", sqrt(fmax(error, 0) / all));
    bench_number("walk_noise", sqrt(noise / all / VERTICES)); // of a mean over the vertices
    bench_end();
    return PRT_OK;
}

static int table_of(struct bench_env *env, const char *body, const struct prt_mesh *mesh)
{
    struct prt_cube light = {0};
    const struct prt_material *m;
    int status = prt_cube_init(&light, CUBE);
    for (uint32_t i = 0; i < 18 * CUBE * CUBE && !status; i++) light.texel[i] = 1;
    for (unsigned i = 0; !status && (m = prt_material_preset(i)) && !(env->quick && i); i++)
        status = errors_of(env, body, mesh, &light, m);
    prt_cube_finish(&light);
    return status;
}

static int make(struct bench_env *env, const struct shape *s, struct prt_mesh **out)
{
    int status = prt_mesh_create(&env->ctx, s->n_vertex, (const float(*)[3])s->position, NULL,
                                 s->n_triangle, (const uint32_t(*)[3])s->triangle, out);
    return status ? status : prt_mesh_scale(&env->ctx, *out, 0, 1);
}

static int run(struct bench_env *env)
{
    static const char *const bodies[] = {"ball, radius 10 mm", "slab, 2 mm",
                                         "curved leaf, 1 mm in the middle", "model, 50 mm"};
    struct shape *s = calloc(1, sizeof *s);
    int status = s ? PRT_OK : PRT_NOMEM;
    for (unsigned i = 0; i < (env->quick ? 1 : 4) && !status; i++) {
        struct prt_mesh *mesh = NULL;
        if (i == 3 && !env->mesh) break;
        memset(s, 0, sizeof *s);
        if (i == 0) add_ball(s, (const float[]){10, 10, 10}, 0);
        if (i == 1) add_plate(s, (const float[]){10, 1, 10});
        if (i == 2) add_ball(s, (const float[]){12, 0.5f, 8}, 30);
        if (i < 3) status = make(env, s, &mesh);
        else status = prt_mesh_load(&env->ctx, env->mesh, NULL, &mesh);
        if (i == 3 && !status) status = prt_mesh_scale(&env->ctx, mesh, 50, 0);
        if (!status) status = table_of(env, bodies[i], mesh);
        prt_mesh_destroy(mesh);
    }
    free(s);
    return status;
}
BENCH(dipole_error, "the dipole's error against random walks: media x bodies (--model)", run)
