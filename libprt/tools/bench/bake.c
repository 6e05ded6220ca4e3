// SPDX-License-Identifier: MIT
// The bake's inner loops: rays of pass 1 against bare Embree, single scattering's ray saving.
#include "bench.h"

#include "bake/measure_inner.h"
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

// The lights of --env as 6x32x32, or one made up.
static int load_lights(struct bench_env *env, struct prt_cube *light, unsigned *n)
{
    *n = 0;
    if (!env->n_light) {
        *n = 1;
        return bench_cube(32, env->seed, light);
    }
    for (unsigned i = 0; i < env->n_light; i++) {
        struct prt_env *file;
        int status = prt_env_load(&env->ctx, env->light[i], &file);
        if (status) return status;
        status = prt_env_to_cube(&env->ctx, file, 32, 0, &light[i]);
        prt_env_destroy(file);
        if (status) return status;
        ++*n;
    }
    return PRT_OK;
}

static void print_single(struct bench_env *env, const char *material, const char *light,
                         const struct prt_bake_single *s, double error)
{
    bench_begin(env, "bake_single");
    bench_text("material", material);
    bench_text("light", light);
    bench_number("rays", (double)s->rays);
    bench_number("every_ray", (double)s->every_rays);
    bench_number("seconds", s->seconds);
    bench_number("horizon_seconds", s->horizon_seconds);
    bench_number("every_ray_seconds", s->every_seconds);
    bench_number("relative_rmse_before_packing", error);
    bench_number("target_at_most", 0.02);
    bench_end();
}

static int run_single(struct bench_env *env)
{
    static const char *const media[] = {"marble", "skin1"};
    struct prt_cube light[8] = {{0}};
    struct prt_mesh *mesh;
    unsigned n = 0;
    int status = load_model(env, &mesh);
    if (status || !mesh) return status;
    status = load_lights(env, light, &n);
    for (int i = 0; status == PRT_OK && i < 2; i++) {
        struct prt_material material;
        struct prt_bake_single s;
        status = prt_material_load(&env->ctx, media[i], &material);
        if (status == PRT_OK)
            status = prt_bake_measure_single(&env->ctx, mesh, &material, light, n,
                                             env->quick ? 8 : 300, &s);
        for (unsigned l = 0; status == PRT_OK && l < n; l++)
            print_single(env, media[i], env->n_light ? env->light[l] : "made up", &s,
                         s.error[l]);
    }
    for (unsigned l = 0; l < n; l++) prt_cube_finish(&light[l]);
    prt_mesh_destroy(mesh);
    return status;
}
BENCH(bake_single, "single scattering's rays saved, the error under each --env (--model)",
      run_single)
