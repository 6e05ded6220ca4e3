// SPDX-License-Identifier: MIT
// Pictures: visibility, shading, and the image-space engines at the sizes of their papers, with
// their errors against the exact sum under the same light.
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bench.h"
#include "prt/screen.h"

struct stage {
    struct bench_env *env;
    struct prt_mesh *mesh;
    struct prt_scene *scene;
    struct prt_screen *screen;
    struct prt_visibility *vis;
    struct prt_gbuffer g;
    struct prt_material material;
    struct prt_cube *cube;
    struct prt_screen_options options;
    struct prt_screen_report report;
    unsigned turn;
    float (*radiance)[3];
};

// The model of --model at 50 mm, or a bumpy ball of as many vertices as the bunny.
static int stage_mesh(struct bench_env *env, struct stage *s)
{
    if (env->mesh) {
        int status = prt_mesh_load(&env->ctx, env->mesh, NULL, &s->mesh);
        return status ? status : prt_mesh_scale(&env->ctx, s->mesh, 50, 0);
    }
    uint32_t n = env->quick ? 24 : 132, n_vertex = (n + 1) * (2 * n + 1), at = 0;
    float(*p)[3] = malloc(n_vertex * sizeof *p);
    uint32_t(*t)[3] = malloc((size_t)4 * n * n * sizeof *t);
    if (!p || !t) {
        free(p);
        free(t);
        return PRT_NOMEM;
    }
    for (uint32_t i = 0; i <= n; i++) {
        for (uint32_t j = 0; j <= 2 * n; j++, at++) {
            double a = M_PI * i / n, b = M_PI * (j % (2 * n)) / n;
            double round = i < n ? sin(a) : 0, r = 15 + 1.2 * sin(5 * b) * sin(4 * a) * round;
            p[at][0] = (float)(r * round * sin(b));
            p[at][1] = (float)(r * cos(a));
            p[at][2] = (float)(r * round * cos(b));
        }
    }
    at = 0;
    for (uint32_t i = 0; i < n; i++) {
        for (uint32_t j = 0; j < 2 * n; j++) {
            uint32_t a = i * (2 * n + 1) + j, b = a + 2 * n + 1;
            uint32_t quad[2][3] = {{a, b, a + 1}, {a + 1, b, b + 1}};
            // the poles' triangles have one corner twice
            if (i > 0) memcpy(t[at++], quad[0], sizeof *quad);
            if (i < n - 1) memcpy(t[at++], quad[1], sizeof *quad);
        }
    }
    int status = prt_mesh_create(&env->ctx, n_vertex, (const float(*)[3])p, NULL, at,
                                 (const uint32_t(*)[3])t, &s->mesh);
    free(p);
    free(t);
    return status ? status : prt_mesh_scale(&env->ctx, s->mesh, 50, 0);
}

static int stage_init(struct bench_env *env, struct stage *s)
{
    memset(s, 0, sizeof *s);
    s->env = env;
    int status = stage_mesh(env, s);
    if (!status) status = prt_scene_create(&env->ctx, s->mesh, &s->scene);
    if (!status) status = prt_screen_create(&env->ctx, s->mesh, s->scene, &s->screen);
    return status;
}

static void stage_finish(struct stage *s)
{
    if (s->screen) prt_screen_destroy(s->screen);
    if (s->scene) prt_scene_destroy(s->scene);
    prt_visibility_destroy(s->vis);
    if (s->mesh) prt_mesh_destroy(s->mesh);
    prt_free(s->radiance);
}

// A view of w x h in which the model fills this share of the default view.
static int look(struct stage *s, uint32_t w, uint32_t h, float share)
{
    struct prt_camera camera;
    prt_camera_frame(s->mesh, (float)w / (float)h, &camera);
    for (int k = 0; k < 3; k++)
        camera.eye[k] = camera.target[k] + (camera.eye[k] - camera.target[k]) * 0.9f / share;
    camera.automatic = false;
    prt_visibility_destroy(s->vis);
    prt_free(s->radiance);
    s->vis = NULL;
    s->radiance = NULL;
    int status = prt_visibility_create(&s->env->ctx, s->mesh, &camera, w, h, 4, PRT_RASTER_AUTO,
                                       &s->vis);
    if (status) return status;
    prt_visibility_gbuffer(s->vis, &s->g);
    s->radiance = prt_alloc((size_t)s->g.n_point + 1, sizeof *s->radiance);
    return s->radiance ? PRT_OK : PRT_NOMEM;
}

// A new light each time: from above in front, walking round.
static struct prt_screen_light next_light(struct stage *s)
{
    double phi = 0.3 + 0.05 * (s->turn++ % 20);
    return (struct prt_screen_light){{(float)(0.8 * sin(phi)), 0.5f, (float)(0.8 * cos(phi))},
                                     {5, 5, 5}, false};
}

static int one_image(void *arg)
{
    struct stage *s = arg;
    struct prt_screen_light light = next_light(s);
    struct prt_shade shade = {.eta = s->material.eta, .fresnel = true,
                              .background_rgb = {0.05f, 0.05f, 0.05f}};
    struct prt_image image;
    int status = prt_screen_image(&s->env->ctx, s->screen, s->vis, &s->material, s->cube,
                                  !s->cube, &light, &s->options, &shade, &image, &s->report);
    if (!status) prt_image_finish(&image);
    return status;
}

static int time_engine(struct stage *s, const char *figure, const char *medium, uint32_t w,
                       uint32_t h, float share)
{
    struct bench_time t;
    int status = prt_material_load(&s->env->ctx, medium, &s->material);
    if (!status) status = look(s, w, h, share);
    if (!status) status = bench_measure(s->env, one_image, s, &t);
    if (status) return status;
    bench_begin(s->env, figure);
    bench_text("engine", prt_screen_engine_name(s->options.engine));
    bench_text("medium", medium);
    bench_number("width", w);
    bench_number("height", h);
    bench_number("points", s->g.n_point);
    bench_number("samples", s->report.n_sample);
    bench_number("lights", s->report.n_light);
    bench_number("ms", t.best * 1e3);
    bench_number("ms_median", t.median * 1e3);
    bench_number("fps", 1 / t.median);
    bench_end();
    return PRT_OK;
}

static double relative(const float (*a)[3], const float (*b)[3], uint32_t n, double *absolute)
{
    double num = 0, den = 0, tone = 0;
    for (uint32_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++) {
            double x = a[i][c], y = b[i][c], d = x / (1 + x) - y / (1 + y);
            num += (x - y) * (x - y);
            den += y * y;
            tone += d * d;
        }
    }
    *absolute = n ? sqrt(tone / n / 3) : 0;
    return den > 0 ? sqrt(num / den) : 0;
}

// Errors over covered pixels against every one of the reference's texels, same light.
static int convergence(struct stage *s, const char *medium)
{
    static const struct {
        enum prt_screen_engine engine;
        uint32_t n[4];
    } row[] = {{PRT_SCREEN_SPLAT, {32, 64, 128, 256}},
               {PRT_SCREEN_TANGENT, {16, 64, 256, 1024}},
               {PRT_SCREEN_TEXTURE, {400, 900, 1600, 2500}},
               {PRT_SCREEN_HYBRID, {200, 400, 900, 1600}}};
    struct prt_screen_light light = {{0.4f, 0.7f, 0.6f}, {5, 5, 5}, false};
    uint32_t side = s->env->quick ? 48 : 200;
    int status = prt_material_load(&s->env->ctx, medium, &s->material);
    if (!status) status = look(s, side, side, 0.9f);
    if (status) return status;
    float(*exact)[3] = prt_alloc((size_t)s->g.n_point + 1, sizeof *exact);
    if (!exact) return PRT_NOMEM;
    struct prt_screen_options options = {.engine = PRT_SCREEN_REFERENCE,
                                         .n_sample = s->env->quick ? 20000 : 200000};
    status = prt_screen_radiance(&s->env->ctx, s->screen, s->vis, &s->material, s->cube, !s->cube,
                                 &light, &options, exact, NULL);
    for (size_t k = 0; k < sizeof row / sizeof *row && !status; k++) {
        for (int i = 0; i < 4 && !status; i++) {
            struct prt_screen_report report;
            options = (struct prt_screen_options){.engine = row[k].engine, .n_sample = row[k].n[i]};
            double t0 = prt_time_s(), absolute;
            status = prt_screen_radiance(&s->env->ctx, s->screen, s->vis, &s->material, s->cube,
                                         !s->cube, &light, &options, s->radiance, &report);
            if (status) break;
            double t1 = prt_time_s();
            double error = relative((const float(*)[3])s->radiance, (const float(*)[3])exact,
                                    s->g.n_point, &absolute);
            bench_begin(s->env, "screen_error");
            bench_text("engine", prt_screen_engine_name(row[k].engine));
            bench_text("medium", medium);
            bench_text("light", s->cube ? "environment" : "distant");
            bench_number("asked", row[k].n[i]);
            bench_number("samples", report.n_sample);
            bench_number("relative_rmse", error);
            bench_number("tone_mapped_rmse", absolute);
            bench_number("ms", (t1 - t0) * 1e3);
            bench_end();
        }
    }
    prt_free(exact);
    return status;
}

static int run(struct bench_env *env)
{
    struct stage s;
    int status = stage_init(env, &s);
    static const char *const media[] = {"skimmilk", "marble", "cream"};
    for (int k = 0; k < 3 && !status; k++) {
        s.options = (struct prt_screen_options){.engine = PRT_SCREEN_SPLAT};
        status = time_engine(&s, "splat_800x600", media[k], 800, 600, 0.5f);
    }
    if (!status) {
        s.options = (struct prt_screen_options){.engine = PRT_SCREEN_TANGENT, .n_sample = 64};
        status = time_engine(&s, "tangent_500x500", "cream", 500, 500, 0.5f);
    }
    for (int hybrid = 0; hybrid < 2 && !status; hybrid++) {
        s.options = (struct prt_screen_options){
            .engine = hybrid ? PRT_SCREEN_HYBRID : PRT_SCREEN_TEXTURE, .n_sample = 900};
        status = time_engine(&s, "texture_512x512", "marble", 512, 512, 0.9f);
    }
    struct prt_cube cube = {0};
    if (!status) status = bench_cube(32, env->seed, &cube);
    if (!status) {
        s.cube = &cube;
        s.options = (struct prt_screen_options){.engine = PRT_SCREEN_SPLAT};
        status = time_engine(&s, "splat_environment", "marble", 800, 600, 0.5f);
        s.cube = NULL;
    }
    for (int k = 0; k < 2 && !status; k++) status = convergence(&s, media[k]);
    prt_cube_finish(&cube);
    stage_finish(&s);
    return status;
}

BENCH(screen, "image-space engines: splat, tangent, texture, hybrid; their errors", run)

struct raster_job {
    struct stage *s;
    struct prt_shade shade;
    struct prt_cube *cube;
    uint8_t *rgb8;
    struct prt_specular *specular;
};

static int draw_once(void *arg)
{
    struct stage *s = ((struct raster_job *)arg)->s;
    return look(s, 800, 600, 0.9f);
}

static int shade_once(void *arg)
{
    struct raster_job *job = arg;
    struct prt_image image;
    int status = prt_shade_image(&job->s->env->ctx, job->s->vis, job->s->mesh, &job->shade, &image);
    if (!status)
        status = prt_tone_map(&job->s->env->ctx, &image, PRT_TONE_FILMIC, 0, job->rgb8);
    if (!status) prt_image_finish(&image);
    return status;
}

static int specular_once(void *arg)
{
    struct raster_job *job = arg;
    prt_specular_destroy(job->specular);
    job->specular = NULL;
    return prt_specular_create(&job->s->env->ctx, job->cube, &job->specular);
}

static void say(struct bench_env *env, const char *figure, const struct bench_time *t,
                const struct stage *s)
{
    bench_begin(env, figure);
    bench_number("width", 800);
    bench_number("height", 600);
    bench_number("covered", prt_visibility_covered(s->vis));
    bench_number("ms", t->best * 1e3);
    bench_number("ms_median", t->median * 1e3);
    bench_end();
}

static int run_raster(struct bench_env *env)
{
    struct stage s;
    struct bench_time t;
    struct prt_cube sky = {0}, cube = {0};
    int status = stage_init(env, &s);
    struct raster_job job = {.s = &s, .cube = &cube};
    if (!status) status = bench_cube(32, env->seed, &cube);
    if (!status) status = bench_cube(env->quick ? 64 : 256, env->seed, &sky);
    if (!status) status = bench_measure(env, draw_once, &job, &t);
    if (!status) say(env, "visibility", &t, &s);
    if (!status) status = bench_measure(env, specular_once, &job, &t);
    if (!status) say(env, "specular", &t, &s);
    float *planes = NULL;
    if (!status) {
        planes = prt_calloc((size_t)s.mesh->n_vertex * 4, 12);
        job.rgb8 = prt_alloc(800 * 600, 3);
        status = planes && job.rgb8 ? PRT_OK : PRT_NOMEM;
    }
    for (unsigned n = 1; n <= 4 && !status; n += 3) {
        job.shade = (struct prt_shade){.n_plane = n, .planes = planes, .eta = 1.5f,
                                       .roughness = 0.3f, .fresnel = true,
                                       .specular = job.specular, .background = &sky};
        status = bench_measure(env, shade_once, &job, &t);
        if (!status) say(env, n == 1 ? "shade_and_tone_map" : "shade_and_tone_map_4_planes", &t, &s);
    }
    prt_specular_destroy(job.specular);
    prt_free(planes);
    prt_free(job.rgb8);
    prt_cube_finish(&sky);
    prt_cube_finish(&cube);
    stage_finish(&s);
    return status;
}

BENCH(raster, "visibility buffer, shading, specular, tone map at 800x600", run_raster)
