// SPDX-License-Identifier: MIT
// The bake's inner loops: rays of pass 1 against bare Embree, single scattering's ray saving.
#include "bench.h"

#include "prt/bake.h"
#include "prt/mesh.h"

#include <string.h>

// --model FILE at 50 mm; the benchmarks below need one.
static int load_model(struct bench_env *env, struct prt_mesh **mesh)
{
    if (!env->mesh) {
        prt_log(&env->ctx, PRT_LOG_NOTE, "the bake's benchmarks want --model FILE: left out");
        *mesh = NULL;
        return PRT_OK;
    }
    int status = prt_mesh_load(&env->ctx, env->mesh, NULL, mesh);
    return status ? status : prt_mesh_scale(&env->ctx, *mesh, 50, 0);
}

static int run_rays(struct bench_env *env)
{
    struct prt_mesh *mesh;
    struct prt_bake_rays rays;
    int status = load_model(env, &mesh);
    if (status || !mesh) return status;
    status = prt_bake_measure_rays(&env->ctx, mesh, env->quick ? 200 : 6000, 32, &rays);
    if (status == PRT_OK) {
        bench_begin(env, "bake_rays");
        bench_number("rays", (double)rays.rays);
        bench_number("rays_per_s", (double)rays.rays / rays.seconds);
        bench_number("bare_embree_rays_per_s", (double)rays.rays / rays.bare_seconds);
        bench_number("ratio_to_bare", rays.bare_seconds / rays.seconds);
        bench_end();
    }
    prt_mesh_destroy(mesh);
    return status;
}
BENCH(bake_rays, "pass 1's rays a second against a bare Embree loop (--model)", run_rays)

static int run_single(struct bench_env *env)
{
    static const char *const media[] = {"marble", "skin1"};
    struct prt_mesh *mesh;
    int status = load_model(env, &mesh);
    if (status || !mesh) return status;
    for (int i = 0; status == PRT_OK && i < 2; i++) {
        struct prt_material material;
        struct prt_bake_single s;
        struct prt_cube light;
        status = prt_material_load(&env->ctx, media[i], &material);
        if (status == PRT_OK) status = bench_cube(32, env->seed, &light);
        if (status) break;
        status = prt_bake_measure_single(&env->ctx, mesh, &material, &light,
                                         env->quick ? 8 : 300, &s);
        prt_cube_finish(&light);
        if (status) break;
        bench_begin(env, "bake_single");
        bench_text("material", media[i]);
        bench_number("rays", (double)s.rays);
        bench_number("every_ray", (double)s.every_rays);
        bench_number("seconds", s.seconds);
        bench_number("every_ray_seconds", s.every_seconds);
        bench_number("relative_rmse_before_packing", s.error);
        bench_end();
    }
    prt_mesh_destroy(mesh);
    return status;
}
BENCH(bake_single, "single scattering's rays saved and what they cost (--model)", run_single)
