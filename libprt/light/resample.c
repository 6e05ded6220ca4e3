/* SPDX-License-Identifier: MIT */
/* Environments to cubemaps of any size and rotation. Chooses the resampler. */
#include "resample.h"

unsigned prt_resample_cap_rays(double n_wedge, uint32_t n, double rays_per_texel)
{
    /* a corner texel at radius 0.7 n texels subtends 1/(0.7 n) rad of azimuth */
    const double rays = rays_per_texel * 2.0 * PI * 0.7 * n;
    const double s = ceil(rays / n_wedge);
    return s < 1 ? 1 : (unsigned)s;
}

double *prt_resample_row_edges(uint32_t height)
{
    double *edge = prt_alloc((size_t)height + 1, sizeof *edge);
    for (uint32_t r = 0; edge && r <= height; r++)
        edge[r] = r == 0 ? 1.0 : r == height ? -1.0 : cos(PI * r / height);
    return edge;
}

int prt_env_turned_source(const struct prt_context *ctx, const struct prt_env *env,
                          struct prt_image *temporary, const struct prt_image **out)
{
    uint32_t width = env->cube.n * 8;
    width = width < 256 ? 256 : width > 4096 ? 4096 : width;
    struct prt_env_cache *cache = env->cache;
    int err = PRT_OK;
    if (!cache) {
        err = prt_cube_to_latlong(ctx, &env->cube, width, width / 2, temporary);
        *out = temporary;
        return err;
    }
    pthread_mutex_lock(&cache->lock);
    if (!cache->latlong.rgb)
        err = prt_cube_to_latlong(ctx, &env->cube, width, width / 2, &cache->latlong);
    pthread_mutex_unlock(&cache->lock);
    *out = &cache->latlong;
    return err;
}

static int turned_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                       double degrees, struct prt_cube *out)
{
    const double quarters = degrees / 90.0;
    if (quarters == floor(quarters))
        return prt_resample_cube_to_cube(&env->cube, n, (unsigned)quarters, out);
    struct prt_image temporary = {0};
    const struct prt_image *src = NULL;
    int err = prt_env_turned_source(ctx, env, &temporary, &src);
    if (!err) err = prt_resample_latlong_to_cube(ctx, src, n, degrees * PI / 180.0, out);
    prt_image_finish(&temporary);
    return err;
}

int prt_env_to_cube(const struct prt_context *ctx, const struct prt_env *env, uint32_t n,
                    double rotate_deg, struct prt_cube *out)
{
    out->n = 0;
    out->texel = NULL;
    if (n < 1 || n > PRT_CUBE_MAX)
        return prt_fail(ctx, PRT_ARG, "cube size %u: allowed is 1..%d", n, PRT_CUBE_MAX);
    if (!isfinite(rotate_deg))
        return prt_fail(ctx, PRT_ARG, "rotation must be a finite number of degrees");
    double degrees = fmod(rotate_deg, 360.0);
    if (degrees < 0) degrees += 360.0;
    if (degrees >= 360.0) degrees = 0;
    struct prt_cube cube;
    int err = prt_cube_init(&cube, n);
    if (err) return err;
    if (env->kind == PRT_ENV_CUBE) err = turned_cube(ctx, env, n, degrees, &cube);
    else err = prt_resample_latlong_to_cube(ctx, &env->latlong, n, degrees * PI / 180.0, &cube);
    if (err) {
        prt_cube_finish(&cube);
        return prt_fail(ctx, err, "resampling to 6 x %u x %u: %s", n, n, prt_status_text(err));
    }
    *out = cube;
    return PRT_OK;
}

uint32_t prt_env_full_cube(const struct prt_env *env)
{
    /* a face spans a quarter of the lat-long's width */
    const uint32_t want =
        env->kind == PRT_ENV_CUBE ? env->cube.n : (env->latlong.width + 3) / 4;
    uint32_t n = 16;
    while (n < want && n < 1024) n *= 2;
    return n;
}
