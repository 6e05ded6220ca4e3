// SPDX-License-Identifier: MIT
// Importance sampling of a piecewise constant cube light.
#include "reference/lights.h"

#include <math.h>
#include <stdlib.h>

// Morton order within a face keeps neighbouring texels together in the running sum, so that
// systematic sampling is stratified in direction.
static uint32_t morton(uint32_t x, uint32_t y)
{
    uint32_t code = 0;
    for (unsigned b = 0; b < 16; b++)
        code |= (x >> b & 1) << (2 * b) | (y >> b & 1) << (2 * b + 1);
    return code;
}

struct keyed {
    uint64_t key;
    uint32_t texel;
};

static int keyed_order(const void *a, const void *b)
{
    const struct keyed *x = a, *y = b;
    return x->key < y->key ? -1 : x->key > y->key;
}

// Half of the rays are drawn by power, a third by its square root (for the shadows of dim
// parts), the rest by solid angle. Shares chosen, not measured.
static double *running_density(const struct prt_cube *light, const struct keyed *order,
                               const float *solid_angle, uint32_t n)
{
    double *end = prt_alloc(n, sizeof *end), power = 0, root = 0, sum = 0;
    if (!end) return NULL;
    for (int pass = 0; pass < 2; pass++)
        for (uint32_t i = 0; i < n; i++) {
            uint32_t t = order[i].texel;
            const float *c = light->texel + (size_t)t * 3;
            double w = solid_angle[t % (light->n * light->n)];
            double l = 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
            if (!pass) {
                power += w * l;
                root += w * sqrt(l);
                continue;
            }
            double p = w / (4 * M_PI);
            if (power > 0) p = 0.5 * w * l / power + 0.33 * w * sqrt(l) / root + 0.17 * p;
            sum += p;
            end[i] = sum;
        }
    return end;
}

static void draw_pattern(struct light_rays *r, uint32_t p, const struct prt_cube *light,
                         const struct keyed *order, const double *end, uint32_t n,
                         const float *solid_angle, struct prt_rng *rng)
{
    double total = end[n - 1], offset = prt_rng_f32(rng);
    double ju = prt_rng_f32(rng), jv = prt_rng_f32(rng);
    uint32_t at = 0, face = light->n * light->n;
    for (uint32_t k = 0; k < r->n_ray; k++) {
        double u = (k + offset) / r->n_ray * total;
        while (at + 1 < n && end[at] <= u) at++;
        uint32_t t = order[at].texel, x = t % light->n, y = t / light->n % light->n;
        double density = (end[at] - (at ? end[at - 1] : 0)) / total;
        // R2 sequence inside the texel, then made uniform in solid angle by its weight.
        double fx = ju + k * 0.7548776662466927, fy = jv + k * 0.5698402909980532;
        fx -= floor(fx), fy -= floor(fy);
        double s = 2 * (x + fx) / light->n - 1, v = 2 * (y + fy) / light->n - 1;
        double q = 1 + s * s + v * v, step = 2.0 / light->n;
        double weight = step * step / (q * sqrt(q)) / (density * r->n_ray);
        float dir[3];
        size_t i = (size_t)p * r->n_ray + k;
        prt_cube_direction(t / face, s, v, dir);
        r->x[i] = dir[0], r->y[i] = dir[1], r->z[i] = dir[2];
        for (int c = 0; c < 3; c++)
            r->rgb[i * 3 + (size_t)c] =
                (float)(light->texel[(size_t)t * 3 + (size_t)c] * weight);
    }
}

int prt_light_rays_create(const struct prt_cube *light, uint32_t n_pattern, uint32_t n_ray,
                          uint64_t seed, struct light_rays **out)
{
    uint32_t face = light->n * light->n, n = 6 * face;
    struct light_rays *r = calloc(1, sizeof *r);
    size_t all = (size_t)n_pattern * n_ray;
    struct keyed *order = prt_alloc(n, sizeof *order);
    float *solid_angle = prt_alloc(face, sizeof *solid_angle);
    double *end = NULL;
    if (r) {
        r->n_pattern = n_pattern, r->n_ray = n_ray;
        r->x = prt_alloc(all, 4), r->y = prt_alloc(all, 4), r->z = prt_alloc(all, 4);
        r->rgb = prt_alloc(all * 3, 4);
    }
    int status =
        r && r->x && r->y && r->z && r->rgb && order && solid_angle ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK) {
        prt_cube_solid_angles(light->n, solid_angle);
        for (uint32_t i = 0; i < n; i++)
            order[i] = (struct keyed){
                (uint64_t)(i / face) << 32 | morton(i % light->n, i / light->n % light->n), i};
        qsort(order, n, sizeof *order, keyed_order);
        end = running_density(light, order, solid_angle, n);
        if (!end) status = PRT_NOMEM;
    }
    for (uint32_t p = 0; status == PRT_OK && p < n_pattern; p++) {
        struct prt_rng rng;
        prt_rng_init(&rng, seed, p);
        draw_pattern(r, p, light, order, end, n, solid_angle, &rng);
    }
    prt_free(order);
    prt_free(solid_angle);
    prt_free(end);
    if (status) {
        prt_light_rays_destroy(r);
        return status;
    }
    *out = r;
    return PRT_OK;
}

void prt_light_rays_destroy(struct light_rays *r)
{
    if (!r) return;
    prt_free(r->x), prt_free(r->y), prt_free(r->z);
    prt_free(r->rgb);
    free(r);
}
