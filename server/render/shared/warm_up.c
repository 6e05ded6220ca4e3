// SPDX-License-Identifier: MIT
// The warm-up render: a turned light, a specular filter and a picture of a tetrahedron. Builds
// the tables and the GL context before the first request needs them.
#include "render/shared/warm_up.h"

#include "prt/raster.h"

#include <stdlib.h>

// The matrix of lights that turn.
static int warm_turn(const struct prt_context *ctx)
{
    float grey[8 * 4 * 3] = {0};
    struct prt_env env = {.kind = PRT_ENV_LATLONG, .latlong = {8, 4, grey}};
    struct prt_cube cube = {0};
    int status = prt_env_cache_create(&env);
    if (!status) status = prt_env_turned(ctx, &env, 32, 1, &cube);
    prt_cube_finish(&cube);
    prt_env_cache_destroy(&env);
    return status;
}

static int run_warm(struct work *work, const struct prt_context *ctx)
{
    static const float position[4][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    static const uint32_t triangle[4][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};
    struct prt_cube cube = {0};
    struct prt_specular *specular = NULL;
    struct prt_mesh *mesh = NULL;
    struct prt_visibility *seen = NULL;
    struct prt_camera camera;
    int status = warm_turn(ctx);
    if (!status) status = prt_cube_init(&cube, 32);
    if (!status) status = prt_specular_create(ctx, &cube, &specular);
    if (!status) status = prt_mesh_create(ctx, 4, position, NULL, 4, triangle, &mesh);
    if (!status) status = prt_mesh_scale(ctx, mesh, 10, 0);
    if (!status) {
        prt_camera_frame(mesh, 1, &camera);
        status = prt_visibility_create(ctx, mesh, &camera,
                                       &(struct prt_raster){16, 16, 4, PRT_RASTER_AUTO}, &seen);
    }
    // The tone curves' tables; pages in the encoders' code.
    uint8_t rgb8[3 * 16 * 16];
    float rgb[3 * 16 * 16] = {0};
    struct prt_image image = {16, 16, rgb};
    struct prt_blob file[2] = {{0}};
    if (!status) status = prt_tone_map(ctx, &image, PRT_TONE_FILMIC, 0, rgb8);
    if (!status) status = prt_encode_jpeg(ctx, rgb8, 16, 16, 90, &file[0]);
    if (!status) status = prt_encode_png(ctx, rgb8, 16, 16, 3, &file[1]);
    for (int i = 0; i < 2; i++) prt_free(file[i].bytes);
    prt_visibility_destroy(seen);
    prt_mesh_destroy(mesh);
    prt_specular_destroy(specular);
    prt_cube_finish(&cube);
    return status;
}

static void done_warm(struct work *work)
{
    free(work); // the first picture reports an error again
}

void warm_start(struct work_pool *pool)
{
    struct work *work = calloc(1, sizeof *work);
    if (!work) return;
    work->class = WORK_BACKGROUND;
    work->run = run_warm;
    work->done = done_warm;
    work_submit(pool, work);
}
