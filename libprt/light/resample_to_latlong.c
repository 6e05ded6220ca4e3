/* SPDX-License-Identifier: MIT */
/* Resamples a cubemap to a lat-long image; power is conserved (resample.h). */
#include "resample.h"

#include <string.h>

/* Wedges through a corner texel of a cap, chosen as the least that a cube takes. */
static const double RAYS_PER_TEXEL = 8.0;

struct to_latlong {
    const struct prt_cube *cube;
    struct prt_image *out;
    const double *edge;
    unsigned rays;
};

/* Meridian phi through the cube as descending z of cell ends and the cells; returns the count.
 */
static uint32_t meridian(const struct prt_cube *cube, const unsigned quadrant, double beta,
                         double *end, const float **cell)
{
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n;
    const double phi = quadrants[quadrant].phi + beta, c = cos(beta);
    uint32_t count = 0;
    struct cap_walk w;
    bool last = false;
    cap_walk_start(&w, n, sin(phi), -cos(phi));
    while (!last) {
        cell[count] = cube->texel + (2 * n_face + (size_t)w.y * n + w.x) * 3;
        const double rho = cap_walk_next(&w, &last);
        end[count++] = 1.0 / sqrt(1.0 + rho * rho);
    }
    const uint32_t n_cap = count;
    const double s = -tan(beta);
    const double fx = (s + 1.0) * 0.5 * n;
    const uint32_t x = fx < 0 ? 0 : fx >= n ? n - 1 : (uint32_t)fx;
    for (uint32_t y = 0; y < n; y++) {
        const double q = (2.0 * (y + 1) / n - 1.0) * c;
        cell[count] = cube->texel + (quadrants[quadrant].face * n_face + (size_t)y * n + x) * 3;
        end[count++] = -q / sqrt(1.0 + q * q);
    }
    for (uint32_t i = n_cap; i-- > 0;) { /* -Y is +Y with t mirrored, walked inwards */
        const size_t at = (size_t)(cell[i] - cube->texel) / 3 - 2 * n_face;
        cell[count] = cube->texel + (3 * n_face + (n - 1 - at / n) * n + at % n) * 3;
        end[count++] = i > 0 ? -end[i - 1] : -1.0;
    }
    return count;
}

static int latlong_columns(void *arg, size_t begin, size_t stop, unsigned worker)
{
    const struct to_latlong *job = arg;
    const uint32_t n = job->cube->n, width = job->out->width, height = job->out->height;
    double *acc = prt_alloc((size_t)height * 3 + 5 * n + 8, sizeof *acc);
    const float **cell = prt_alloc((size_t)5 * n + 8, sizeof *cell);
    if (!acc || !cell) {
        prt_free(acc);
        prt_free(cell);
        return PRT_NOMEM;
    }
    double *end = acc + (size_t)height * 3;
    for (size_t i = begin; i < stop; i++) {
        const double first = 2 * PI * (double)i / width - PI;
        const double past = 2 * PI * (double)(i + 1) / width - PI;
        memset(acc, 0, (size_t)height * 3 * sizeof *acc);
        for (double cur = first; cur < past - 1e-13;) {
            /* the side column that holds cur: its far edge ends the wedge */
            const double turns = floor((cur + 1e-13 + PI / 4) / (PI / 2));
            const unsigned quadrant = (unsigned)(((int)turns % 4 + 4) % 4);
            const double beta = cur - turns * PI / 2;
            double j = floor((tan(beta) + 1.0) * 0.5 * n + 1e-9) + 1;
            double far = j >= n ? PI / 4 : atan(2.0 * j / n - 1.0);
            if (far <= beta + 1e-13) far = j + 1 >= n ? PI / 4 : atan(2.0 * (j + 1) / n - 1.0);
            double next = turns * PI / 2 + far;
            next = next < past ? next : past;
            if (next <= cur) next = past;
            const double wedge = (next - cur) / job->rays;
            for (unsigned r = 0; r < job->rays; r++) {
                const uint32_t count =
                    meridian(job->cube, quadrant, beta + wedge * (r + 0.5), end, cell);
                uint32_t row = 0;
                double z = 1.0;
                for (uint32_t k = 0; k < count; k++)
                    while (z > end[k]) {
                        const bool row_ends = row + 1 < height && job->edge[row + 1] > end[k];
                        const double low = row_ends ? job->edge[row + 1] : end[k];
                        const double omega = (z - low) * wedge;
                        for (int c = 0; c < 3; c++) acc[row * 3 + c] += omega * cell[k][c];
                        z = low;
                        row += row_ends;
                    }
            }
            cur = next;
        }
        for (uint32_t r = 0; r < height; r++) {
            const double omega = (job->edge[r] - job->edge[r + 1]) * (past - first);
            for (int c = 0; c < 3; c++)
                job->out->rgb[((size_t)r * width + i) * 3 + c] =
                    (float)(acc[r * 3 + c] / omega);
        }
    }
    prt_free(acc);
    prt_free(cell);
    return PRT_OK;
}

static void latlong_power(const struct prt_image *im, const double *edge, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    for (uint32_t r = 0; r < im->height; r++) {
        const float *p = im->rgb + (size_t)r * im->width * 3;
        double sum[3] = {0, 0, 0};
        for (uint32_t x = 0; x < im->width; x++)
            for (int c = 0; c < 3; c++) sum[c] += p[x * 3 + c];
        for (int c = 0; c < 3; c++)
            power[c] += sum[c] * (edge[r] - edge[r + 1]) * 2 * PI / im->width;
    }
}

static void cube_power(const struct prt_cube *cube, double power[3])
{
    memset(power, 0, 3 * sizeof *power);
    const uint32_t n = cube->n;
    for (uint32_t y = 0; y < n; y++)
        for (uint32_t x = 0; x < n; x++) {
            const double omega = prt_cube_solid_angle(n, x, y);
            for (unsigned face = 0; face < 6; face++)
                for (int c = 0; c < 3; c++)
                    power[c] += omega * cube->texel[(((size_t)face * n + y) * n + x) * 3 + c];
        }
}

int prt_cube_to_latlong(const struct prt_context *ctx, const struct prt_cube *cube,
                        uint32_t width, uint32_t height, struct prt_image *out)
{
    memset(out, 0, sizeof *out);
    if (!cube->n || !width || !height || width > 16384 || height > 16384)
        return prt_fail(ctx, PRT_ARG, "lat-long size %u x %u: allowed is 1..16384", width,
                        height);
    struct prt_image image = {width, height,
                              prt_alloc((size_t)width * height * 3, sizeof(float))};
    double *edge = prt_resample_row_edges(height);
    int err = PRT_NOMEM;
    if (image.rgb && edge) {
        struct to_latlong job = {
            cube, &image, edge,
            prt_resample_cap_rays(width + 4.0 * cube->n, cube->n, RAYS_PER_TEXEL)};
        err = prt_parallel_for(ctx, NULL, width, 16, latlong_columns, &job);
    }
    if (!err) {
        double want[3], have[3];
        cube_power(cube, want);
        latlong_power(&image, edge, have);
        for (int c = 0; c < 3; c++) {
            const float scale = have[c] > 0 ? (float)(want[c] / have[c]) : 1.0f;
            for (size_t i = 0; i < (size_t)width * height; i++) image.rgb[i * 3 + c] *= scale;
        }
    }
    prt_free(edge);
    if (err) {
        prt_image_finish(&image);
        return prt_fail(ctx, err, "lat-long of %u x %u: %s", width, height,
                        prt_status_text(err));
    }
    *out = image;
    return PRT_OK;
}
