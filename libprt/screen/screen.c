// SPDX-License-Identifier: MIT
// The public calls: they set a frame's lights and tables up, run an engine and compose the
// result.
#include "prt/surface.h"
#include "walk_ratio.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char *const engine_name[] = {"splat", "tangent", "texture", "hybrid", "reference"};
enum { N_ENGINE = sizeof engine_name / sizeof *engine_name };
enum { MAX_LIGHTS = 4096, DEFAULT_LIGHTS = 64 }; // chosen, not measured

int prt_screen_engine_parse(const char *word, enum prt_screen_engine *out)
{
    for (int i = 0; i < N_ENGINE; i++) {
        if (strcmp(word, engine_name[i])) continue;
        *out = (enum prt_screen_engine)i;
        return PRT_OK;
    }
    return PRT_ARG;
}

const char *prt_screen_engine_name(enum prt_screen_engine engine)
{
    return (unsigned)engine < N_ENGINE ? engine_name[engine] : "unknown";
}

int prt_screen_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                      const struct prt_scene *scene, struct prt_screen **out)
{
    struct prt_screen *s = prt_calloc(1, sizeof *s);
    if (!s) return prt_fail(ctx, PRT_NOMEM, "screen: no memory");
    s->mesh = mesh;
    s->scene = scene;
    s->diameter_mm = (float)prt_mesh_diagonal(mesh);
    s->area_mm2 = prt_surface_area(mesh);
    int status = PRT_OK;
    if (!isfinite(s->diameter_mm) || !(s->diameter_mm > 0))
        status = prt_fail(ctx, PRT_ARG,
                          "screen: the model's vertices are all at one point, or not finite");
    if (!status && !(s->triangle_block = prt_mesh_triangle_blocks(mesh)))
        status = prt_fail(ctx, PRT_NOMEM, "screen: no memory");
    if (!status && !scene) {
        status = prt_scene_create(ctx, mesh, (struct prt_scene **)&s->own_scene);
        s->scene = s->own_scene;
    }
    if (status) {
        prt_screen_destroy(s);
        return status;
    }
    *out = s;
    return PRT_OK;
}

void prt_screen_destroy(struct prt_screen *s)
{
    if (!s) return;
    prt_samples_finish(&s->atlas);
    prt_samples_finish(&s->peel);
    prt_samples_finish(&s->check);
    for (int k = 0; k < VIEWS; k++) prt_view_finish(&s->view[k]);
    prt_tangent_view_finish(&s->tangent);
    prt_free(s->triangle_block);
    if (s->own_scene) prt_scene_destroy(s->own_scene);
    prt_free(s);
}

int prt_screen_loop(const struct prt_context *ctx, size_t n, size_t grain, prt_loop_fn fn,
                    void *arg)
{
    int status = prt_progress(ctx, "picture", 0);
    return status ? status : prt_parallel_for(ctx, "picture", n, grain, fn, arg);
}

float prt_frame_mean_free_path(const struct frame *f)
{
    double least = INFINITY;
    for (uint32_t o = 0; o < f->n_object; o++)
        for (int c = 0; c < 3; c++) least = fmin(least, f->dipole[o][c].z_r);
    return (float)least;
}

int prt_frame_atlas(struct frame *f, uint32_t n, bool equal)
{
    struct prt_screen *s = f->screen;
    bool own_uv = s->uv_state >= 0 && !equal;
    if (!s->atlas.n || s->atlas_size != n || s->atlas_uv != own_uv) {
        prt_samples_finish(&s->atlas);
        s->atlas_size = n;
        int status = PRT_OK;
        s->atlas_uv = false;
        if (own_uv) {
            status = prt_samples_uv_atlas(f->ctx, s->mesh, n, &s->atlas, &s->atlas_uv);
            if (!status) s->uv_state = s->atlas_uv ? 1 : -1;
        }
        if (!status && !s->atlas_uv) status = prt_samples_atlas(f->ctx, s->mesh, n, &s->atlas);
        if (status) return status;
    }
    if (!equal) f->report->uv_atlas = s->atlas_uv;
    return prt_frame_irradiance(f, &s->atlas);
}

int prt_frame_irradiance(struct frame *f, struct samples *s)
{
    const struct prt_screen_options *o = f->options;
    if (o->vertex_irradiance)
        return prt_irradiance_vertices(f->ctx, f->screen->mesh, o->vertex_irradiance, s);
    struct samples lit = *s; // shares all columns but the normals that maps turn
    int status = maps_turn(f) ? prt_map_normals(f, &lit) : PRT_OK;
    // harmonics have no shadows and represent the cube alone: further lights are traced
    const bool harmonics = o->sh_irradiance && f->cube && o->engine != PRT_SCREEN_TANGENT;
    const uint32_t first = harmonics ? f->n_cube_light : 0;
    if (!status && (!harmonics || f->n_light > first))
        status = prt_irradiance_traced(f->ctx, f->screen->scene, f->n_light - first,
                                       f->light + first, f->eta, &lit, &f->report->n_ray);
    if (!status && harmonics)
        prt_irradiance_harmonics(f->cube, f->eta, f->n_light > first, &lit);
    for (int k = 0; k < 3; k++)
        if (lit.normal[k] != s->normal[k]) prt_free(lit.normal[k]);
    return status ? status : prt_map_occlude(f, s);
}

// R_d of each object, as coefficients and as a table.
static int make_tables(struct frame *f, const struct prt_media *media)
{
    int status = prt_media_check(f->ctx, media, f->n_object);
    if (status) return status;
    uint32_t n = f->n_object ? f->n_object : 1;
    f->dipole = calloc(n, sizeof *f->dipole);
    f->eta = calloc(n, sizeof *f->eta);
    f->table = prt_alloc(n, sizeof *f->table);
    if (!f->dipole || !f->eta || !f->table)
        return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t o = 0; o < f->n_object; o++) {
        const struct prt_material *m = prt_media_of(media, o);
        double scale = INFINITY;
        prt_material_dipoles(m, f->dipole[o]); // or the material's own profile
        for (int c = 0; c < 3; c++) scale = fmin(scale, f->dipole[o][c].z_r);
        f->eta[o] = m->eta;
        prt_radial_table_fit(&f->table[o], prt_dipole_profile, f->dipole[o], scale,
                             f->screen->diameter_mm);
    }
    return PRT_OK;
}

uint32_t prt_cube_lights(const struct prt_screen_input *input,
                         const struct prt_screen_options *options)
{
    if (!input->cube) return 0;
    return options && options->n_light ? options->n_light : DEFAULT_LIGHTS;
}

static int make_lights(struct frame *f, const struct prt_screen_input *input)
{
    uint32_t n = prt_cube_lights(input, f->options), n_extra = input->n_extra;
    if (n > MAX_LIGHTS || n_extra > MAX_LIGHTS)
        return prt_fail(f->ctx, PRT_ARG, "screen: %u lights are more than %d", n + n_extra,
                        MAX_LIGHTS);
    f->light = calloc((size_t)n + n_extra + 1, sizeof *f->light);
    if (!f->light) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (n) f->n_light = f->n_cube_light = prt_screen_lights_from_cube(f->cube, n, f->light);
    for (uint32_t i = 0; i < n_extra; i++) {
        struct prt_screen_light l = input->extra[i];
        float length = 0;
        bool good = true;
        for (int k = 0; k < 3; k++) {
            length += l.where[k] * l.where[k];
            good &= isfinite(l.where[k]) && isfinite(l.rgb[k]) && l.rgb[k] >= 0;
        }
        if (!good || (!l.point && !(length > 1e-12f)))
            return prt_fail(
                f->ctx, PRT_ARG,
                "screen: light %u: direction or position and colour must be finite, "
                "the colour >= 0",
                i);
        for (int k = 0; k < 3 && !l.point; k++) l.where[k] /= sqrtf(length);
        f->light[f->n_light++] = l;
    }
    f->report->n_light = f->n_light;
    return PRT_OK;
}

// albedo/pi E on the opaque points.
static int light_opaque(struct frame *f)
{
    const struct prt_mesh *mesh = f->screen->mesh;
    struct samples s;
    uint32_t n = 0;
    for (uint32_t i = 0; i < f->g.n_point; i++) n += f->g.opaque[i];
    if (!n) return PRT_OK;
    if (!prt_samples_init(&s, n)) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        if (!f->g.opaque[i]) continue;
        for (int k = 0; k < 3; k++) {
            s.p[k][s.n] = f->g.position[k][i];
            s.normal[k][s.n] = s.face[k][s.n] = f->g.normal[k][i];
            if (f->g.turned[0]) s.normal[k][s.n] = f->g.turned[k][i];
        }
        s.n++;
    }
    int status = prt_irradiance_traced(f->ctx, f->screen->scene, f->n_light, f->light, NULL, &s,
                                       &f->report->n_ray);
    for (uint32_t i = 0, at = 0; !status && i < f->g.n_point; i++) {
        if (!f->g.opaque[i]) continue;
        const float *albedo = mesh->surface[mesh->block[f->g.block[i]].surface].base_color;
        for (int k = 0; k < 3; k++)
            f->radiance[i][k] = albedo[k] * s.e[k][at] * (float)(1 / M_PI);
        at++;
    }
    prt_samples_finish(&s);
    return status;
}

// Ranges of the options. The most samples bound memory and time; chosen, not measured.
static int check_options(const struct prt_context *ctx, const struct prt_screen_options *o)
{
    static const uint32_t most[N_ENGINE] = {4096, 65536, 1u << 20, 1u << 20, 1u << 24};
    if ((unsigned)o->engine >= N_ENGINE)
        return prt_fail(ctx, PRT_ARG,
                        "screen: engine %d is not one of splat, tangent, texture, hybrid, "
                        "reference",
                        (int)o->engine);
    if (o->n_sample > most[o->engine] || o->n_sample == 1)
        return prt_fail(ctx, PRT_ARG, "screen: %u samples for %s: 2 to %u are allowed",
                        o->n_sample, engine_name[o->engine], most[o->engine]);
    if ((o->rings > 0) != (o->spokes > 0) || o->rings > 256 || o->spokes > 256)
        return prt_fail(
            ctx, PRT_ARG,
            "screen: a pattern of %u rings of %u spokes: 1 to 256 of both are allowed",
            o->rings, o->spokes);
    if (!(o->budget_ms >= 0))
        return prt_fail(ctx, PRT_ARG, "screen: a budget of %g ms: must be >= 0",
                        (double)o->budget_ms);
    if (!(o->bound >= 0))
        return prt_fail(ctx, PRT_ARG, "screen: a bound of %g mm^-1: must be >= 0",
                        (double)o->bound);
    if (!(o->epsilon >= 0 && o->epsilon < 1))
        return prt_fail(ctx, PRT_ARG, "screen: epsilon %g is outside [0,1)",
                        (double)o->epsilon);
    return PRT_OK;
}

static int check_maps(const struct frame *f)
{
    const struct prt_screen_options *o = f->options;
    const struct prt_screen_map *map[4] = {o->sigma_s_map, o->sigma_a_map, o->bump_map,
                                           o->normal_map};
    for (int k = 0; k < 4; k++) {
        uint32_t n = map[k] && o->maps_by_surface ? f->screen->mesh->n_surface : map[k] != NULL;
        for (uint32_t i = 0; i < n; i++) {
            if (o->maps_by_surface && !map[k][i].rgb) continue;
            int status =
                prt_map_check(f->ctx, f->screen->mesh, &map[k][i], k < 2, o->maps_checked);
            if (status) return status;
        }
    }
    return PRT_OK;
}

static int run_engine(struct frame *f)
{
    switch (f->options->engine) {
    case PRT_SCREEN_SPLAT:
        return prt_engine_splat(f);
    case PRT_SCREEN_TANGENT:
        return prt_engine_tangent(f);
    case PRT_SCREEN_TEXTURE:
        return prt_engine_texture(f, false);
    case PRT_SCREEN_HYBRID:
        return prt_engine_texture(f, true);
    case PRT_SCREEN_REFERENCE:
        return prt_engine_reference(f, f->options->n_sample ? f->options->n_sample : 262144, 1,
                                    NULL);
    }
    return PRT_ARG; // check_options refused the others
}

static void finish_frame(struct frame *f)
{
    prt_receivers_finish(f);
    free(f->dipole);
    free(f->eta);
    prt_free(f->table);
    free(f->light);
}

// Everything that a frame needs before an engine runs.
static int begin_frame(struct frame *f, const struct prt_screen_input *input)
{
    prt_visibility_gbuffer(f->vis, &f->g);
    prt_visibility_camera(f->vis, NULL, &f->width, &f->height, NULL);
    f->n_object = f->screen->mesh->n_object;
    f->seed = f->options->seed + (uint64_t)f->options->frame * 0x9e3779b97f4a7c15ULL;
    int status = check_options(f->ctx, f->options);
    if (!status) status = check_maps(f);
    if (!status) status = make_tables(f, &input->media);
    if (!status) status = make_lights(f, input);
    f->view_key = prt_view_key(f);
    for (uint32_t i = 0; i < f->g.n_point && !f->any; i++) f->any = !f->g.opaque[i];
    return status;
}

struct plan_view prt_frame_plan(const struct frame *f)
{
    return (struct plan_view){.n_point = f->g.n_point,
                              .n_light = f->n_light,
                              .pixel_mm = (double)prt_view_pixel_mm(f->vis),
                              .area_mm2 = f->screen->area_mm2,
                              .diameter_mm = (double)f->screen->diameter_mm,
                              .mean_free_path_mm = (double)prt_frame_mean_free_path(f)};
}

uint32_t prt_frame_samples(const struct frame *f, uint32_t normal, uint32_t most)
{
    const struct prt_screen_options *o = f->options;
    struct plan_view view = prt_frame_plan(f);
    uint32_t n = o->n_sample;
    if (!n && o->budget_ms > 0)
        n = prt_plan_samples(f->screen, o->engine, &view, (double)o->budget_ms * 1e-3);
    if (!n) n = normal;
    uint64_t finer = (uint64_t)n << min_u(o->refine, 16);
    if (finer > n) n = (uint32_t)(finer < most ? finer : n > most ? n : most);
    return n;
}

// Texels of a measured error, and points compared; chosen, not measured.
enum { MEASURE_LEAST = 65536, MEASURE_MOST = 524288, MEASURE_POINTS = 500 };

// Texels of 0.35 mean free paths, so that several lie under R_d's peak.
static uint32_t measure_texels(const struct frame *f)
{
    double l = 0.35 * (double)prt_frame_mean_free_path(f), n = f->screen->area_mm2 / (l * l);
    return n < MEASURE_LEAST ? MEASURE_LEAST : n > MEASURE_MOST ? MEASURE_MOST : (uint32_t)n;
}

// A change above which earlier measurements of the error are discarded.
static bool changed(double before, double now)
{
    return now > 1.5 * before || before > 1.5 * now;
}

// Updates the speed and the expected error. The first frame of a kind (engine, few or many
// lights, samples, mean free path) is checked, and every CHECK_EVERY-th one: errors depend on
// the model and on light more than on sample counts.
static int report_frame(struct frame *f, double seconds)
{
    enum { CHECK_EVERY = 16 };
    enum prt_screen_engine e = f->options->engine;
    struct prt_screen_report *r = f->report;
    if (e == PRT_SCREEN_REFERENCE) return PRT_OK;
    uint32_t n = e == PRT_SCREEN_SPLAT ? r->grid : r->n_asked;
    struct plan_view view = prt_frame_plan(f);
    // later frames of a running mean draw more points to finer receivers than n says
    if (!f->options->frame) prt_plan_learn(f->screen, e, n, &view, seconds);
    struct prt_screen *s = f->screen;
    struct checked *checked = &s->checked[e][view.n_light > FEW_LIGHTS];
    // the check sums with one medium an object; TANGENT mixes media, others are scaled after it
    bool maps = e == PRT_SCREEN_TANGENT && maps_tint(f->options);
    bool due = !(checked->ratio > 0) || checked->since++ >= CHECK_EVERY ||
               changed(checked->work, n) || changed(checked->path_mm, view.mean_free_path_mm);
    if (due && !f->options->frame && !maps) {
        double error, predicted = prt_plan_error(e, n, &view);
        uint64_t rays = r->n_ray;
        int status = prt_frame_check(f, &error);
        r->n_ray = rays; // rays of the check are not the picture's
        if (status) return status;
        if (predicted > 0 && error > 0)
            *checked = (struct checked){fmin(fmax(error / predicted, 0.05), 50), n,
                                        view.mean_free_path_mm, 0};
    }
    r->expected_error = prt_plan_expect(s, e, n, &view);
    return PRT_OK;
}

// The engine's light, the frame's expected error and, where the options ask for it, the
// measured one.
static int draw_translucent(struct frame *f, double started)
{
    const struct prt_screen_options *o = f->options;
    int status = run_engine(f);
    if (!status) status = report_frame(f, prt_time_s() - started);
    // these two take R_d of the mapped medium at each point; the others spread light in the
    // plain medium and are scaled afterwards
    bool mapped = o->engine == PRT_SCREEN_TANGENT || o->engine == PRT_SCREEN_REFERENCE;
    if (!status && !mapped && maps_tint(o)) status = prt_map_tint(f);
    if (!status && o->measure_error)
        status = prt_engine_reference(f, measure_texels(f), f->g.n_point / MEASURE_POINTS + 1,
                                      &f->report->error);
    if (!status && o->ratio) status = prt_ratio_apply(f);
    return status;
}

int prt_screen_radiance(const struct prt_context *ctx, struct prt_screen *screen,
                        const struct prt_screen_input *input,
                        const struct prt_screen_options *options, float (*radiance)[3],
                        struct prt_screen_report *report)
{
    struct prt_screen_report unused;
    if (!screen || !input || !input->visibility || !input->media.n || !options || !radiance)
        return prt_fail(ctx, PRT_ARG,
                        "screen: screen, visibility, media, options or radiance is missing");
    struct frame f = {.ctx = ctx,
                      .screen = screen,
                      .vis = input->visibility,
                      .cube = input->cube,
                      .options = options,
                      .radiance = radiance,
                      .report = report ? report : &unused};
    double started = prt_time_s();
    *f.report = (struct prt_screen_report){
        .engine = options->engine, .error = -1, .frame = options->frame};
    int status = begin_frame(&f, input);
    memset(radiance, 0, f.g.n_point * sizeof *radiance);
    if (!status) status = light_opaque(&f);
    if (!status && f.any && screen->area_mm2 > 0) status = draw_translucent(&f, started);
    finish_frame(&f);
    return status;
}

int prt_screen_image(const struct prt_context *ctx, struct prt_screen *screen,
                     const struct prt_screen_input *input,
                     const struct prt_screen_options *options, const struct prt_shade *shade,
                     struct prt_image *out, struct prt_screen_report *report)
{
    if (!input || !input->visibility || !shade || !out)
        return prt_fail(ctx, PRT_ARG, "screen: visibility, shade or out is NULL");
    struct prt_gbuffer g;
    prt_visibility_gbuffer(input->visibility, &g);
    float(*radiance)[3] = prt_alloc((size_t)g.n_point + 1, sizeof *radiance);
    if (!radiance)
        return prt_fail(ctx, PRT_NOMEM, "screen: no memory for %u points", g.n_point);
    int status = prt_screen_radiance(ctx, screen, input, options, radiance, report);
    if (!status)
        status =
            prt_shade_points(ctx, input->visibility, (const float(*)[3])radiance, shade, out);
    prt_free(radiance);
    return status;
}
