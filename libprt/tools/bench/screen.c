// SPDX-License-Identifier: MIT
// Pictures: visibility, shading, and the image-space engines at the sizes of their papers, with
// their errors against the exact sum under the same light. Above 600 lines: a list of figures,
// each read alone.
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

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
    const char *light; // its name
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
    s->light = "distant";
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
    int status = prt_visibility_create(&s->env->ctx, s->mesh, &camera,
                                       &(struct prt_raster){w, h, 4, PRT_RASTER_AUTO}, &s->vis);
    if (status) return status;
    prt_visibility_gbuffer(s->vis, &s->g);
    s->radiance = prt_alloc((size_t)s->g.n_point + 1, sizeof *s->radiance);
    return s->radiance ? PRT_OK : PRT_NOMEM;
}

static struct prt_screen_input input_of(const struct stage *s,
                                        const struct prt_screen_light *light)
{
    return (struct prt_screen_input){.visibility = s->vis,
                                     .media = prt_media_one(&s->material),
                                     .cube = s->cube,
                                     .n_extra = !s->cube,
                                     .extra = light};
}

// A new light each time: from above in front, walking round.
static struct prt_screen_light next_light(struct stage *s)
{
    double phi = 0.3 + 0.05 * (s->turn++ % 20);
    return (struct prt_screen_light){
        {(float)(0.8 * sin(phi)), 0.5f, (float)(0.8 * cos(phi))}, {5, 5, 5}, false};
}

static struct prt_shade plain_shade(const struct stage *s)
{
    return (struct prt_shade){.media = prt_media_one(&s->material),
                              .fresnel = true,
                              .background_rgb = {0.05f, 0.05f, 0.05f}};
}

static int one_image(void *arg)
{
    struct stage *s = arg;
    struct prt_screen_light light = next_light(s);
    struct prt_shade shade = plain_shade(s);
    struct prt_image image;
    struct prt_screen_input input = input_of(s, &light);
    int status = prt_screen_image(&s->env->ctx, s->screen, &input, &s->options, &shade, &image,
                                  &s->report);
    if (!status) prt_image_finish(&image);
    return status;
}

static double cpu_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

// The required value of a figure.
struct target {
    double fps, error; // 0: none
};

// From a new light to the shaded image: wall time, and the time of two idle cores.
static int time_engine(struct stage *s, const char *figure, const char *medium, uint32_t w,
                       uint32_t h, float share, struct target target)
{
    struct bench_time t;
    int status = prt_material_load(&s->env->ctx, medium, &s->material);
    if (!status) status = look(s, w, h, share);
    if (!status) status = one_image(s);
    unsigned before = s->turn;
    double cpu = cpu_seconds();
    if (!status) status = bench_measure(s->env, one_image, s, &t);
    cpu = (cpu_seconds() - cpu) / (s->turn - before);
    if (status) return status;
    struct prt_screen_report report = s->report;
    struct prt_screen_options measured = s->options;
    measured.measure_error = true;
    struct prt_screen_light light = next_light(s);
    struct prt_screen_input input = input_of(s, &light);
    status = prt_screen_radiance(&s->env->ctx, s->screen, &input, &measured, s->radiance,
                                 &s->report);
    if (status) return status;
    bench_begin(s->env, figure);
    bench_text("engine", prt_screen_engine_name(s->options.engine));
    bench_text("medium", medium);
    bench_text("light", s->cube ? "environment" : "distant");
    bench_number("width", w);
    bench_number("height", h);
    bench_number("points", s->g.n_point);
    bench_number("receivers", report.receivers);
    bench_number("samples", report.n_sample);
    if (report.grid) bench_number("grid", report.grid);
    if (s->options.rings) bench_number("local", s->options.rings * s->options.spokes + 1);
    bench_number("lights", report.n_light);
    bench_number("pairs", (double)report.n_pair);
    bench_number("ms", t.best * 1e3);
    bench_number("ms_median", t.median * 1e3);
    bench_number("fps", 1 / t.median);
    bench_number("cpu_ms", cpu * 1e3);
    bench_number("fps_by_cpu_time", 2 / cpu);
    if (target.fps > 0) bench_number("target_fps", target.fps);
    bench_number("relative_rmse", s->report.error);
    bench_number("expected_error", s->report.expected_error);
    if (target.error > 0) bench_number("target_relative_rmse", target.error);
    bench_end();
    return PRT_OK;
}

static double relative(const float (*a)[3], const float (*b)[3], uint32_t n, double *absolute)
{
    double num = 0, den = 0, tone = 0;
    for (uint32_t i = 0; i < n; i++) {
        for (int c = 0; c < 3; c++) {
            double x = (double)a[i][c], y = (double)b[i][c], d = x / (1 + x) - y / (1 + y);
            num += (x - y) * (x - y);
            den += y * y;
            tone += d * d;
        }
    }
    *absolute = n ? sqrt(tone / n / 3) : 0;
    return den > 0 ? sqrt(num / den) : 0;
}

// Required times of an engine at a sample count, or at its largest.
static const struct row {
    enum prt_screen_engine engine;
    uint32_t n[5];
    double relative, tone; // targets at the counts marked
    unsigned marked;       // bits
} row[] = {{PRT_SCREEN_SPLAT, {64, 93, 145, 217, 300}, 0.04, 0, 0x18},
           {PRT_SCREEN_TANGENT, {16, 32, 64, 256, 1024}, 0.05, 0, 0x1c},
           {PRT_SCREEN_TEXTURE, {400, 900, 1600, 2500, 10000}, 0, 0.014, 0x0c},
           {PRT_SCREEN_HYBRID, {200, 400, 900, 1600, 4000}, 0.02, 0, 0x1c}};

static void say_error(struct stage *s, const struct row *r, int i, const char *medium,
                      const struct prt_screen_report *report, const float (*exact)[3],
                      double ms)
{
    double absolute,
        error = relative((const float(*)[3])s->radiance, exact, s->g.n_point, &absolute);
    bench_begin(s->env, "screen_error");
    bench_text("engine", prt_screen_engine_name(r->engine));
    bench_text("medium", medium);
    bench_text("light", s->light);
    bench_number("asked", r->n[i]);
    bench_number("samples", report->n_sample);
    bench_number("relative_rmse", error);
    if (r->marked >> i & 1 && r->relative > 0)
        bench_number("target_relative_rmse", r->relative);
    bench_number("tone_mapped_rmse", absolute);
    if (r->marked >> i & 1 && r->tone > 0) bench_number("target_tone_mapped_rmse", r->tone);
    bench_number("expected_error", report->expected_error);
    bench_number("ms", ms);
    bench_end();
}

// Errors over covered pixels against the sum over all of the reference's texels, same camera,
// same lights.
static int convergence(struct stage *s, const char *medium, unsigned engines)
{
    struct prt_screen_light light = {{0.4f, 0.5f, 0.75f}, {5, 5, 5}, false};
    uint32_t side = s->env->quick ? 48 : 160;
    int status = prt_material_load(&s->env->ctx, medium, &s->material);
    if (!status) status = look(s, side, side, 0.9f);
    if (status) return status;
    float(*exact)[3] = prt_alloc((size_t)s->g.n_point + 1, sizeof *exact);
    if (!exact) return PRT_NOMEM;
    struct prt_screen_options options = {.engine = PRT_SCREEN_REFERENCE,
                                         .n_sample = s->env->quick ? 20000 : 400000};
    struct prt_screen_input input = input_of(s, &light);
    status = prt_screen_radiance(&s->env->ctx, s->screen, &input, &options, exact, NULL);
    for (size_t k = 0; k < sizeof row / sizeof *row && !status; k++) {
        for (int i = 0; engines >> k & 1 && i < 5 && !status; i++) {
            struct prt_screen_report report;
            options =
                (struct prt_screen_options){.engine = row[k].engine, .n_sample = row[k].n[i]};
            double t0 = prt_time_s();
            status = prt_screen_radiance(&s->env->ctx, s->screen, &input, &options, s->radiance,
                                         &report);
            if (!status)
                say_error(s, &row[k], i, medium, &report, (const float(*)[3])exact,
                          (prt_time_s() - t0) * 1e3);
        }
    }
    prt_free(exact);
    return status;
}

static const char *const media[] = {"skimmilk", "marble", "cream"};

static int with_stage(struct bench_env *env, int (*work)(struct stage *s))
{
    struct stage s;
    int status = stage_init(env, &s);
    if (!status) status = work(&s);
    stage_finish(&s);
    return status;
}

static int splat(struct stage *s)
{
    int status = PRT_OK;
    for (int k = 0; k < 3 && !status; k++) {
        s->options = (struct prt_screen_options){.engine = PRT_SCREEN_SPLAT};
        status =
            time_engine(s, "screen_splat", media[k], 800, 600, 0.5f, (struct target){15, 0.04});
    }
    return status;
}

static int tangent(struct stage *s)
{
    s->options = (struct prt_screen_options){.engine = PRT_SCREEN_TANGENT, .n_sample = 64};
    return time_engine(s, "screen_tangent", "cream", 500, 500, 0.5f, (struct target){20, 0.05});
}

static int texture(struct stage *s)
{
    s->options = (struct prt_screen_options){.engine = PRT_SCREEN_TEXTURE, .n_sample = 900};
    return time_engine(s, "screen_texture", "marble", 512, 512, 0.9f, (struct target){25, 0});
}

// The near part from every point within reach, and from C08's 401.
static int hybrid(struct stage *s)
{
    s->options = (struct prt_screen_options){.engine = PRT_SCREEN_HYBRID, .n_sample = 900};
    int status =
        time_engine(s, "screen_hybrid", "marble", 512, 512, 0.9f, (struct target){20, 0.02});
    s->options.rings = s->options.spokes = 20;
    if (!status)
        status = time_engine(s, "screen_hybrid", "marble", 512, 512, 0.9f,
                             (struct target){20, 0.02});
    return status;
}

static int under_environment(struct stage *s, int (*work)(struct stage *s))
{
    struct prt_cube cube = {0};
    int status = bench_cube(32, s->env->seed, &cube);
    s->cube = &cube;
    s->light = "environment";
    if (!status) status = work(s);
    s->cube = NULL;
    s->light = "distant";
    prt_cube_finish(&cube);
    return status;
}

static int every_engine(struct stage *s)
{
    int status = PRT_OK;
    for (int e = 0; e < 4 && !status; e++) {
        s->options = (struct prt_screen_options){.engine = (enum prt_screen_engine)e};
        status = time_engine(s, "screen_environment", "marble", 800, 600, 0.5f,
                             (struct target){0, 0});
    }
    return status;
}

static int environment(struct stage *s)
{
    return under_environment(s, every_engine);
}

static int marble_convergence(struct stage *s)
{
    return convergence(s, "marble", 15);
}

static int error(struct stage *s)
{
    int status = PRT_OK;
    for (int k = 0; k < 3 && !status; k++) status = convergence(s, media[k], 15);
    return status ? status : under_environment(s, marble_convergence);
}

// C08's error under every --env, made into 64 lights as the daemon does.
static int texture_lights(struct stage *s)
{
    int status = PRT_OK;
    for (unsigned l = 0; l < s->env->n_light && !status; l++) {
        struct prt_env *light = NULL;
        struct prt_cube cube = {0};
        status = prt_env_load(&s->env->ctx, s->env->light[l], &light);
        if (!status) status = prt_env_to_cube(&s->env->ctx, light, 32, 0, &cube);
        s->cube = &cube;
        s->light = s->env->light[l];
        for (int k = 0; k < 3 && !status; k++)
            status = convergence(s, media[k], 1u << PRT_SCREEN_TEXTURE);
        s->cube = NULL;
        prt_cube_finish(&cube);
        prt_env_destroy(light);
    }
    return status;
}

// One engine's running mean against the reference, after 1, 4, 16 and 64 pictures.
static int mean_of(struct stage *s, const struct prt_screen_input *input,
                   struct prt_screen_options options, const float (*exact)[3], float (*mean)[3])
{
    for (uint32_t k = 0; k < (s->env->quick ? 4 : 64); k++) {
        struct prt_screen_report report;
        options.frame = k;
        int status =
            prt_screen_radiance(&s->env->ctx, s->screen, input, &options, s->radiance, &report);
        if (status) return status;
        prt_screen_mean_add(k, s->g.n_point, (const float(*)[3])s->radiance, mean);
        if (k != 0 && k != 3 && k != 15 && k != 63) continue;
        double tone;
        bench_begin(s->env, "screen_progress");
        bench_text("engine", prt_screen_engine_name(options.engine));
        bench_number("frames", k + 1);
        bench_number("samples", report.n_sample);
        bench_number("relative_rmse",
                     relative((const float(*)[3])mean, exact, s->g.n_point, &tone));
        bench_end();
    }
    return PRT_OK;
}

// Running means of every engine.
static int progress(struct stage *s)
{
    static const uint32_t count[4] = {128, 64, 900, 900};
    int status = prt_material_load(&s->env->ctx, "marble", &s->material);
    uint32_t side = s->env->quick ? 48 : 256;
    if (!status) status = look(s, side, side, 0.9f);
    if (status) return status;
    struct prt_screen_light light = {{0.4f, 0.5f, 0.75f}, {5, 5, 5}, false};
    struct prt_screen_input input = input_of(s, &light);
    struct prt_screen_options options = {.engine = PRT_SCREEN_REFERENCE,
                                         .n_sample = s->env->quick ? 20000 : 400000};
    float(*exact)[3] = prt_alloc((size_t)s->g.n_point + 1, sizeof *exact);
    float(*mean)[3] = prt_alloc((size_t)s->g.n_point + 1, sizeof *mean);
    status = exact && mean ? PRT_OK : PRT_NOMEM;
    if (!status)
        status = prt_screen_radiance(&s->env->ctx, s->screen, &input, &options, exact, NULL);
    for (int e = 0; e < 4 && !status; e++) {
        options = (struct prt_screen_options){.engine = (enum prt_screen_engine)e,
                                              .n_sample = count[e]};
        status = mean_of(s, &input, options, (const float(*)[3])exact, mean);
    }
    prt_free(exact);
    prt_free(mean);
    return status;
}

// For each budget: the plan, and the measured result.
static int budget(struct stage *s)
{
    static const double budget_ms[] = {10, 20, 40, 80, 160};
    int status = prt_material_load(&s->env->ctx, "marble", &s->material);
    if (!status) status = look(s, 512, 512, 0.9f);
    struct prt_screen_light light = next_light(s);
    struct prt_screen_input input = input_of(s, &light);
    for (int e = 0; e < 4 && !status; e++) {
        for (int k = 0; k < 5 && !status; k++) {
            struct prt_screen_plan plan;
            struct prt_screen_options options = {0};
            struct bench_time t;
            status = prt_screen_plan(&s->env->ctx, s->screen, &input, (enum prt_screen_engine)e,
                                     budget_ms[k], &options, &plan);
            s->options = options;
            if (!status) status = bench_measure(s->env, one_image, s, &t);
            s->options.measure_error = true;
            if (!status) status = one_image(s);
            if (status) break;
            bench_begin(s->env, "screen_budget");
            bench_text("engine", prt_screen_engine_name(s->options.engine));
            bench_number("budget_ms", budget_ms[k]);
            bench_number("samples", options.n_sample);
            bench_number("ms_median", t.median * 1e3);
            bench_number("expected_ms", plan.expected_ms);
            bench_number("relative_rmse", s->report.error);
            bench_number("expected_error", plan.expected_error);
            bench_end();
        }
    }
    return status;
}

// Bytes of a model in a file to its first shaded picture: all that has no daemon in it.
static int first_picture(void *arg)
{
    struct bench_env *env = arg;
    struct stage s;
    struct prt_screen_options options = {.engine = PRT_SCREEN_SPLAT};
    int status = stage_init(env, &s);
    s.options = options;
    if (!status) status = prt_material_load(&env->ctx, "marble", &s.material);
    if (!status) status = look(&s, 800, 600, 0.9f);
    if (!status) status = one_image(&s);
    stage_finish(&s);
    return status;
}

static int run_first(struct bench_env *env)
{
    struct bench_time t;
    int status = bench_measure(env, first_picture, env, &t);
    if (status) return status;
    bench_begin(env, "screen_first");
    bench_text("engine", "splat");
    bench_number("width", 800);
    bench_number("height", 600);
    bench_number("ms", t.best * 1e3);
    bench_number("ms_median", t.median * 1e3);
    bench_number("target_ms_with_upload_and_png", 1000);
    bench_end();
    return PRT_OK;
}

static int run_splat(struct bench_env *env)
{
    return with_stage(env, splat);
}
static int run_tangent(struct bench_env *env)
{
    return with_stage(env, tangent);
}
static int run_texture(struct bench_env *env)
{
    return with_stage(env, texture);
}
static int run_hybrid(struct bench_env *env)
{
    return with_stage(env, hybrid);
}
static int run_environment(struct bench_env *env)
{
    return with_stage(env, environment);
}
static int run_error(struct bench_env *env)
{
    return with_stage(env, error);
}
static int run_lights(struct bench_env *env)
{
    return with_stage(env, texture_lights);
}
static int run_progress(struct bench_env *env)
{
    return with_stage(env, progress);
}
static int run_budget(struct bench_env *env)
{
    return with_stage(env, budget);
}

BENCH(screen_splat, "S09 at 800x600, a new distant light each time: >= 15 fps, <= 4 %",
      run_splat)
BENCH(screen_tangent, "M03 at 500x500, 64 samples a pixel: >= 20 fps, <= 5 %", run_tangent)
BENCH(screen_texture, "C08 at 512x512, 900 samples: >= 25 fps", run_texture)
BENCH(screen_hybrid, "C08 hybrid at 512x512, 900 + 401: >= 20 fps, <= 2 %", run_hybrid)
BENCH(screen_environment, "every image-space engine under an environment at 800x600",
      run_environment)
BENCH(screen_error, "convergence of the image-space engines to the reference", run_error)
BENCH(screen_lights, "convergence of texture sampling under every --env: <= 0.014 tone-mapped",
      run_lights)
BENCH(screen_progress, "running means of image-space frames against the reference",
      run_progress)
BENCH(screen_budget, "image-space sample counts by time budget, planned and measured",
      run_budget)
BENCH(screen_first, "a model's file to its first shaded picture, no daemon", run_first)

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
    int status =
        prt_shade_image(&job->s->env->ctx, job->s->vis, job->s->mesh, &job->shade, &image);
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
    const struct prt_material surface = {.eta = 1.5f, .roughness = 0.3f};
    for (unsigned n = 1; n <= 4 && !status; n += 3) {
        job.shade = (struct prt_shade){.n_plane = n,
                                       .planes = planes,
                                       .media = prt_media_one(&surface),
                                       .fresnel = true,
                                       .specular = job.specular,
                                       .background = &sky};
        status = bench_measure(env, shade_once, &job, &t);
        if (!status)
            say(env, n == 1 ? "shade_and_tone_map" : "shade_and_tone_map_4_planes", &t, &s);
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
