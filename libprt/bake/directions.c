// SPDX-License-Identifier: MIT
// Sub-sampled texel directions in packets of 16, and the Fresnel table.
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>

// Solid angle density of face coordinates.
static double density(double s, double t)
{
    double q = 1 + s * s + t * t;
    return 1 / (q * sqrt(q));
}

// The sub-sample of texel i of a packet is (turn + i) & 3, as in texel_ray.
static float *slopes_of(const struct directions *d, unsigned pattern, unsigned turn)
{
    return d->slope + ((size_t)pattern * SUBS + turn) * 2 * d->n_coef;
}

const float *prt_direction_slopes(const struct directions *d, unsigned pattern)
{
    return slopes_of(d, pattern % d->n_pattern, pattern >> 6 & 3);
}

static void fill_packet(struct directions *d, uint32_t pattern, uint32_t packet, unsigned face,
                        uint32_t bx, uint32_t by, struct prt_rng *rng)
{
    size_t at = ((size_t)pattern * d->n_packet + packet) * 16;
    for (unsigned texel = 0; texel < 4; texel++) {
        uint32_t x = bx + (texel & 1), y = by + (texel >> 1);
        double sum = 0, ju = prt_rng_f32(rng), jv = prt_rng_f32(rng);
        d->texel[packet * 4 + texel] = (face * d->n + y) * d->n + x;
        for (unsigned sub = 0; sub < SUBS; sub++, at++) {
            // The 2 x 2 strata share one jitter, which keeps the sub-samples evenly spread.
            double s = 2 * (x + ((sub & 1) + ju) / 2) / d->n - 1;
            double t = 2 * (y + ((sub >> 1) + jv) / 2) / d->n - 1;
            float dir[3];
            prt_cube_direction(face, s, t, dir);
            d->x[at] = dir[0], d->y[at] = dir[1], d->z[at] = dir[2];
            d->weight[at] = (float)density(s, t);
            sum += density(s, t);
            float *slope = slopes_of(d, pattern, (sub - texel) & 3);
            slope[d->texel[packet * 4 + texel]] = (float)s;
            slope[d->n_coef + d->texel[packet * 4 + texel]] = (float)t;
        }
        for (unsigned sub = 0; sub < SUBS; sub++) d->weight[at - SUBS + sub] /= (float)sum;
    }
}

// The middle direction of a packet and the horizon's bins of its texels. Jitters do not change
// them.
static void fill_middle(struct directions *d, uint32_t packet, unsigned face, uint32_t bx,
                        uint32_t by)
{
    float dir[3];
    struct packet_bins *bins = &d->bins[packet];
    prt_cube_direction(face, 2.0 * (bx + 1) / d->n - 1, 2.0 * (by + 1) / d->n - 1, dir);
    for (int c = 0; c < 3; c++) d->centre[c][packet] = dir[c];
    *bins = (struct packet_bins){
        .word = {d->bin[d->texel[packet * 4]] / 64, d->bin[d->texel[packet * 4 + 3]] / 64}};
    for (int j = 0; j < 4; j++) {
        const uint16_t bin = d->bin[d->texel[packet * 4 + (unsigned)j]];
        bins->mask[bin / 64 != bins->word[0]] |= (uint64_t)1 << bin % 64;
    }
}

int prt_directions_create(unsigned cpu, uint32_t n, uint32_t n_pattern, uint64_t seed,
                          struct directions **out)
{
    struct directions *d = calloc(1, sizeof *d);
    if (!d) return PRT_NOMEM;
    d->cpu = cpu;
    d->n = n;
    d->n_coef = 6 * n * n;
    d->n_pattern = n_pattern;
    d->n_packet = d->n_coef / 4;
    size_t rays = (size_t)d->n_pattern * d->n_packet * 16;
    d->x = prt_alloc(rays, 4), d->y = prt_alloc(rays, 4), d->z = prt_alloc(rays, 4);
    d->weight = prt_alloc(rays, 4);
    d->texel = prt_alloc((size_t)d->n_packet * 4, 4);
    d->solid_angle = prt_alloc(d->n_coef, 4);
    d->bin = prt_alloc(d->n_coef, sizeof *d->bin);
    d->bins = prt_alloc(d->n_packet, sizeof *d->bins);
    float *centre = prt_alloc((size_t)3 * d->n_packet, sizeof *centre);
    for (size_t c = 0; c < 3; c++) d->centre[c] = centre ? centre + c * d->n_packet : NULL;
    d->slope = prt_alloc(2 * rays, 4);
    if (!d->slope || !d->x || !d->y || !d->z || !d->weight || !d->texel || !d->solid_angle ||
        !d->bin || !d->bins || !centre) {
        prt_directions_destroy(d);
        return PRT_NOMEM;
    }
    struct prt_rng rng;
    prt_rng_init(&rng, seed, 0xd12ec);
    for (uint32_t p = 0; p < n_pattern; p++)
        for (uint32_t k = 0, face = 0; face < 6; face++)
            for (uint32_t y = 0; y < n; y += 2)
                for (uint32_t x = 0; x < n; x += 2, k++) fill_packet(d, p, k, face, x, y, &rng);
    for (uint32_t i = 0; i < d->n_coef; i++)
        d->solid_angle[i] = (float)prt_cube_solid_angle(n, i % n, i / n % n);
    for (uint32_t i = 0; i < d->n_coef; i++) {
        uint32_t x = i % n * HORIZON_WIDE / n, y = i / n % n * HORIZON_WIDE / n;
        d->bin[i] = (uint16_t)((i / (n * n) * HORIZON_WIDE + y) * HORIZON_WIDE + x);
    }
    for (uint32_t k = 0, face = 0; face < 6; face++)
        for (uint32_t y = 0; y < n; y += 2)
            for (uint32_t x = 0; x < n; x += 2, k++) fill_middle(d, k, face, x, y);
    *out = d;
    return PRT_OK;
}

void prt_directions_destroy(struct directions *d)
{
    if (!d) return;
    prt_free(d->x), prt_free(d->y), prt_free(d->z);
    prt_free(d->weight);
    prt_free(d->texel);
    prt_free(d->solid_angle);
    prt_free(d->bin);
    prt_free(d->bins);
    prt_free(d->centre[0]);
    prt_free(d->slope);
    free(d);
}

void prt_fresnel_table_init(struct fresnel_table *table, double eta)
{
    for (int i = 0; i <= FRESNEL_STEPS; i++)
        table->value[i] = (float)prt_fresnel_transmittance(eta, (double)i / FRESNEL_STEPS);
    table->value[FRESNEL_STEPS + 1] = table->value[FRESNEL_STEPS];
}
