// SPDX-License-Identifier: MIT
// Maps from image files: the meaning of their numbers, and a resolution no finer than needed.
#include "internal.h"

#include <math.h>
#include <string.h>
#include <strings.h>

bool prt_screen_map_linear(const char *file)
{
    static const char *const ending[] = {".exr", ".hdr", ".pfm", ".pic"};
    const char *dot = strrchr(file, '.');
    for (size_t k = 0; dot && k < sizeof ending / sizeof *ending; k++)
        if (!strcasecmp(dot, ending[k])) return true;
    return false;
}

// The sRGB code that a file stored for a linear value.
static float as_stored(float v)
{
    return v <= 0.0031308f ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f;
}

struct shrink_job {
    const struct prt_image *in;
    float (*out)[3];
    uint32_t width, height;
    bool stored;
};

// Mean of the image over [x0, x1) x [y0, y1); values that are not finite count as 0.
static void mean_of(const struct shrink_job *job, size_t x0, size_t x1, size_t y0, size_t y1,
                    float out[3])
{
    double sum[3] = {0, 0, 0}, n = (double)(x1 - x0) * (double)(y1 - y0);
    for (size_t j = y0; j < y1; j++) {
        const float *row = job->in->rgb + 3 * j * job->in->width;
        for (size_t i = 3 * x0; i < 3 * x1; i++)
            if (isfinite(row[i]))
                sum[i % 3] += (double)(job->stored ? as_stored(row[i]) : row[i]);
    }
    for (int c = 0; c < 3; c++) {
        float v = (float)(sum[c] / n);
        out[c] = isfinite(v) ? v : 0;
    }
}

// Rows of the map: each texel is the mean of its share of the image.
static int shrink(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct shrink_job *job = arg;
    const uint64_t w = job->in->width, h = job->in->height;
    for (size_t y = begin; y < end; y++) {
        size_t y0 = y * h / job->height, y1 = (y + 1) * h / job->height;
        for (size_t x = 0; x < job->width; x++)
            mean_of(job, x * w / job->width, (x + 1) * w / job->width, y0, y1,
                    job->out[y * job->width + x]);
    }
    return PRT_OK;
}

int prt_screen_map_make(const struct prt_context *ctx, enum prt_screen_map_kind kind,
                        const struct prt_image *image, bool linear, uint32_t most_side,
                        const struct prt_material *material, float height_mm,
                        struct prt_screen_map *out)
{
    memset(out, 0, sizeof *out);
    if (!image->rgb || !image->width || !image->height)
        return prt_fail(ctx, PRT_ARG, "map: the image has no pixels");
    uint32_t side = image->width > image->height ? image->width : image->height;
    double by = most_side && side > most_side ? (double)most_side / side : 1;
    uint32_t w = (uint32_t)(image->width * by + 0.5), h = (uint32_t)(image->height * by + 0.5);
    w = w ? w : 1;
    h = h ? h : 1;
    float(*rgb)[3] = prt_alloc((size_t)w * h, sizeof *rgb);
    if (!rgb) return prt_fail(ctx, PRT_NOMEM, "map: no memory for %ux%u texels", w, h);
    struct shrink_job job = {image, rgb, w, h, !linear && kind != PRT_SCREEN_MAP_ALBEDO};
    int status = prt_parallel_for(ctx, NULL, h, 16, shrink, &job);
    size_t n = (size_t)w * h;
    if (!status && kind == PRT_SCREEN_MAP_ALBEDO)
        status = prt_screen_albedo_factors(ctx, material, n, (const float(*)[3])rgb, rgb);
    for (size_t i = 0; !status && kind == PRT_SCREEN_MAP_HEIGHT && i < n; i++)
        for (int c = 0; c < 3; c++) rgb[i][c] *= height_mm > 0 ? height_mm : 0.5f;
    if (status) {
        prt_free(rgb);
        return status;
    }
    *out = (struct prt_screen_map){w, h, (const float(*)[3])rgb};
    return PRT_OK;
}

void prt_screen_map_finish(struct prt_screen_map *map)
{
    prt_free((void *)(uintptr_t)map->rgb);
    memset(map, 0, sizeof *map);
}
