// SPDX-License-Identifier: MIT
// prt image: a lit model drawn from a camera.
#include "maps.h"
#include "difference.h"
#include "tool.h"
#include "terminal.h"
#include "walk_ratio.h"
#include "prt/relight.h"
#include "prt/screen.h"
#include "prt/trace.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MAX_LINE = 512 }; // of a message

// The parts of a picture, in one struct so that picture_finish releases all.
struct picture {
    struct source source;
    struct prt_env *env;
    struct prt_cube light, mirror, back;
    struct prt_camera camera;
    struct prt_orbit orbit;
    struct prt_visibility *visibility;
    struct prt_specular *specular;
    float *planes;
    unsigned n_plane;
    bool plain; // a plain background, or none
    bool transparent;
    float *shadow;           // of --floor
    struct prt_scene *scene; // of specular occlusion of a model and its error
    double specular_error,
        without; // of reflections against traced rays, --measure-error; of the first medium
    bool specular_measured;
    float background[3];
    struct prt_image image;
    double lost;                  // error of the .prt's radial bases for the material
    struct difference difference; // of --term difference
    bool on_screen; // drawn by an image-space engine, without transport and vertices
    struct prt_screen_report report;
    struct prt_walk_ratio *ratio; // of a picture by such an engine; NULL: it is not scaled
    struct prt_walk_ratio_report ratio_report;
    struct maps maps;
    unsigned leave_out; // of the file's own textures
};

static void picture_finish(struct picture *p)
{
    maps_finish(&p->maps);
    prt_walk_ratio_destroy(p->ratio);
    prt_image_finish(&p->image);
    prt_free(p->shadow);
    prt_scene_destroy(p->scene);
    if (p->source.loaded) prt_free(p->source.loaded->blocked);
    prt_free(p->planes);
    prt_specular_destroy(p->specular);
    prt_visibility_destroy(p->visibility);
    prt_cube_finish(&p->light);
    prt_cube_finish(&p->mirror);
    prt_cube_finish(&p->back);
    if (p->env) prt_env_destroy(p->env);
    source_close(&p->source);
}

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(user, MAX_LINE, "%s", line);
}

// The library's message about a camera or an orbit becomes one about wrong usage.
static int camera_error(const struct tool *tool, int status, const char *line)
{
    return status ? usage_error(&tool->opt, "--%s", line) : EXIT_DONE;
}

static bool is_position(const char *camera)
{
    return strchr(camera, ':') || strchr(camera, ',') || !strcmp(camera, "auto");
}

// Texts that need no mesh are checked before the model is read.
static int parse_view(const struct tool *tool, struct picture *p)
{
    const struct options *o = &tool->opt;
    char line[MAX_LINE] = "";
    struct prt_context ctx = tool->ctx;
    int status = PRT_OK;
    ctx.log = keep_line;
    ctx.log_user = line;
    if (o->camera && is_position(o->camera))
        status = prt_camera_parse(&ctx, o->camera, &p->camera);
    if (o->orbit) status = prt_orbit_parse(&ctx, o->orbit, &p->orbit);
    return camera_error(tool, status, line);
}

static int check_usage(struct tool *tool, struct picture *p)
{
    const struct options *o = &tool->opt;
    int status;
    if (o->n_input > 1 && (o->out || !is_terminal_path(o->input[1])))
        return usage_error(o, "%s: one SOURCE, and - or -o OUT", o->input[1]);
    if (o->n_input > 1) tool->opt.out = o->input[1];
    if (!o->out) return usage_error(o, "-o OUT is missing");
    if (!is_terminal_path(o->out) && !prt_picture_format(o->out))
        return picture_path_error(o, "pictures");
    if (!o->env) return usage_error(o, "--env is missing");
    if ((o->camera || o->orbit) && o->eye.set)
        return usage_error(o, "--%s says where the eye is: leave --eye out",
                           o->camera ? "camera" : "orbit");
    if (o->camera && o->orbit)
        return usage_error(o, "--camera and --orbit both place the eye: choose one");
    if ((status = parse_view(tool, p))) return status;
    if (maps_given(o) &&
        (!o->engine || !strcmp(o->engine, "vertex") || !strcmp(o->engine, "reference")))
        return usage_error(o, "maps are for --engine splat, tangent, texture and hybrid");
    if (o->bump_mm > 0 && !o->bump_map) return usage_error(o, "--bump-mm is for --bump-map");
    if (o->background && !strcmp(o->background, "none")) {
        p->plain = true;
    } else if (o->background && !strcmp(o->background, "transparent")) {
        p->plain = p->transparent = true;
        if (is_terminal_path(o->out) || !prt_picture_format(o->out)->alpha)
            return usage_error(
                o, "%s has no alpha: --background transparent is for .png and .exr", o->out);
    } else if (o->background && strcmp(o->background, "env")) {
        p->plain = true;
        if (!parse_vector(o->background, p->background) || p->background[0] < 0 ||
            p->background[1] < 0 || p->background[2] < 0)
            return usage_error(o,
                               "--background %s: expected env, none, transparent, or three "
                               "radiances R,G,B >= 0",
                               o->background);
    }
    if (o->floor && o->background && !strcmp(o->background, "none"))
        return usage_error(o,
                           "--floor casts its shadow on the background: --background none is "
                           "black already");
    return EXIT_DONE;
}

// The engine to use, or NULL after a message with its exit status in *status.
static const char *choose_engine(struct tool *tool, const struct source *source, int *status)
{
    const struct options *o = &tool->opt;
    const char *engine = o->engine ? o->engine : source->transport ? "vertex" : "reference";
    *status = EXIT_DONE;
    if (o->term && !strcmp(o->term, "difference") && !source_has_walks(source) &&
        !(o->scattering && !strcmp(o->scattering, "walk"))) {
        *status =
            usage_error(o,
                        "--term difference compares the dipole with walks: %s has none; bake "
                        "it with --scattering walk, or give --engine reference --scattering "
                        "walk",
                        source->path);
        return NULL;
    }
    if (!strcmp(engine, "vertex") && o->scattering && !strcmp(o->scattering, "walk")) {
        *status = usage_error(o, "--scattering walk is for --engine reference and image-space "
                                 "engines: a .prt answers as it was baked");
        return NULL;
    }
    if (!strcmp(engine, "vertex")) {
        if (!source->transport) {
            *status = usage_error(o,
                                  "--engine vertex needs a baked transport: bake %s first "
                                  "(prt bake %s -o OUT.prt) and give the .prt",
                                  source->path, source->path);
            return NULL;
        }
        if (o->term && !strcmp(o->term, "irradiance")) {
            prt_log(&tool->ctx, PRT_LOG_NOTE,
                    "a .prt holds no irradiance: E at the vertices is "
                    "traced again by the reference engine");
            return "reference";
        }
        return engine;
    }
    if (!strcmp(engine, "reference")) return engine;
    if (o->term && !strcmp(o->term, "difference")) {
        *status = usage_error(o, "--term difference is for --engine vertex and reference");
        return NULL;
    }
    if (o->term && (!strcmp(o->term, "irradiance") || !strcmp(o->term, "single"))) {
        *status = usage_error(o,
                              "--engine %s computes multiple scattering: --term must be "
                              "multiple or total",
                              engine);
        return NULL;
    }
    return engine;
}

static int place_camera(const struct tool *tool, struct picture *p, float aspect)
{
    const struct options *o = &tool->opt;
    char line[MAX_LINE] = "";
    struct prt_context ctx = tool->ctx;
    ctx.log = keep_line;
    ctx.log_user = line;
    if (o->camera && is_position(o->camera)) return EXIT_DONE;
    if (o->camera)
        return camera_error(tool, prt_camera_named(&ctx, p->source.mesh, o->camera, &p->camera),
                            line);
    if (o->orbit) prt_camera_frame_from(p->source.mesh, aspect, &p->orbit, &p->camera);
    else prt_camera_frame(p->source.mesh, aspect, &p->camera);
    if (o->eye.set) memcpy(p->camera.eye, o->eye.v, sizeof p->camera.eye);
    return EXIT_DONE;
}

static int no_memory(const struct tool *tool)
{
    return tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the picture"));
}

// A variant's albedo is part of the base colour of a picture: planes take it where that is left
// out.
static void gain_planes(const struct picture *p)
{
    const struct prt_mesh *mesh = p->source.mesh;
    if (!mesh->gain || !(p->leave_out & PRT_LOOK_BASE)) return;
    for (unsigned k = 0; k < p->n_plane; k++)
        for (uint32_t i = 0; i < mesh->n_block; i++) {
            const struct prt_block *b = &mesh->block[i];
            float *plane = p->planes + 3 * ((size_t)k * mesh->n_vertex + b->vertex_begin);
            for (size_t x = 0; x < 3 * (size_t)b->n_vertex; x++)
                plane[x] *= mesh->gain[i][x % 3];
        }
}

// Phase planes of a baked transport.
static int vertex_planes(struct tool *tool, struct picture *p, const char *term)
{
    const struct prt_transport *t = p->source.transport;
    struct prt_query query = {
        .term = answer_term(term),
        .light = t->engine == PRT_TRANSPORT_POLYNOMIAL ? NULL : &p->light,
        .exit = exit_option(&tool->opt),
    };
    if (p->source.media_given) query.media = p->source.media;
    int status = prt_answer_planes(&tool->ctx, t, &query, &p->n_plane, NULL);
    if (status) return tool_exit(tool, status);
    p->planes = prt_alloc((size_t)p->n_plane * t->mesh.n_vertex, 3 * sizeof(float));
    if (!p->planes) return no_memory(tool);
    status = prt_answer_planes(&tool->ctx, t, &query, &p->n_plane, p->planes);
    if (!status) gain_planes(p);
    return tool_exit(tool, status);
}

// One plane by brute force: the terms without their outgoing Fresnel factor, which the shading
// applies a pixel at a time.
static int reference_planes(struct tool *tool, struct picture *p, const char *term)
{
    size_t n = (size_t)p->source.mesh->n_vertex;
    float eye[3];
    for (int i = 0; i < 3; i++) eye[i] = p->camera.eye[i] * p->source.mesh->mm_per_unit;
    struct prt_reference_options options = reference_options(&tool->opt, &p->source, term, eye);
    options.no_exit = true;
    p->n_plane = 1;
    if (!(p->planes = prt_alloc(n, 3 * sizeof(float)))) return no_memory(tool);
    return tool_exit(tool, prt_reference_colors(&tool->ctx, p->source.mesh, &p->source.media,
                                                &p->light, &options, (float(*)[3])p->planes));
}

static int difference_planes(struct tool *tool, struct picture *p, bool baked)
{
    const int status = baked ? check_own_light(tool, &p->source) : EXIT_DONE;
    if (status) return status;
    p->n_plane = 1;
    p->planes = prt_alloc(p->source.mesh->n_vertex, 3 * sizeof(float));
    if (!p->planes) return no_memory(tool);
    return difference_colors(tool, &p->source, &p->light, baked, (float(*)[3])p->planes,
                             &p->difference);
}

// Cubes of the light: the engine's own, one for mirrors and one for the background.
static int load_lights(struct tool *tool, struct picture *p, bool vertex, bool total)
{
    const struct options *o = &tool->opt;
    const struct prt_context *ctx = &tool->ctx;
    int status = tool_env_load(tool, o->env, &p->env);
    if (status) return tool_exit(tool, status);
    uint32_t own = vertex ? p->source.transport->cube : 0;
    if (vertex && p->source.transport->engine == PRT_TRANSPORT_POLYNOMIAL)
        prt_log(ctx, PRT_LOG_NOTE,
                "%s was baked under one light: --env and --rotate change its mirror image and "
                "background only",
                p->source.path);
    int exit_status = source_light(tool, &p->source, p->env, own, &p->light);
    if (exit_status) return exit_status;
    uint32_t full = prt_env_full_cube(p->env);
    if (total) {
        status =
            prt_env_to_cube(ctx, p->env, full < 256 ? full : 256, o->rotate_deg, &p->mirror);
        if (!status) status = prt_specular_create(ctx, &p->mirror, &p->specular);
    }
    if (!status && !p->plain)
        status = prt_env_to_cube(ctx, p->env, full < 512 ? full : 512, o->rotate_deg, &p->back);
    return tool_exit(tool, status);
}

// A .prt carries the sky that its model hides; for a model it is traced. A picture with a time
// budget is drawn without.
static int trace_hidden_sky(struct tool *tool, struct picture *p)
{
    const struct options *o = &tool->opt;
    struct prt_mesh *mesh = p->source.loaded;
    int status = PRT_OK;
    if (!mesh || o->budget_ms > 0) return EXIT_DONE;
    if (!(mesh->blocked = prt_alloc(mesh->n_vertex, sizeof *mesh->blocked)))
        return no_memory(tool);
    status = prt_scene_create(&tool->ctx, mesh, &p->scene);
    if (!status) status = prt_scene_blocked(&tool->ctx, p->scene, mesh->blocked);
    return tool_exit(tool, status);
}

static int measure_specular(struct tool *tool, struct picture *p)
{
    int status = PRT_OK;
    if (!p->scene) status = prt_scene_create(&tool->ctx, p->source.mesh, &p->scene);
    if (!status)
        status = prt_specular_error(
            &tool->ctx, p->scene, p->visibility, &p->mirror, p->source.media.medium[0].eta,
            p->source.media.medium[0].roughness, &p->specular_error, &p->without);
    if (status) return tool_exit(tool, status);
    p->specular_measured = true;
    prt_log(&tool->ctx, PRT_LOG_NOTE,
            "reflections: relative RMSE %.1f %% against traced rays, %.1f %% without occlusion",
            100 * p->specular_error, 100 * p->without);
    return EXIT_DONE;
}

static struct prt_shade shade_of(const struct picture *p, bool total, enum prt_exit exit)
{
    struct prt_shade shade = {
        .n_plane = p->n_plane,
        .planes = p->planes,
        .media = p->source.media,
        .fresnel = total,
        .exit = exit,
        .specular = p->specular,
        .background = p->plain ? NULL : &p->back,
        .leave_out = p->leave_out,
        .transparent = p->transparent,
        .shadow = p->shadow,
    };
    memcpy(shade.background_rgb, p->background, sizeof shade.background_rgb);
    return shade;
}

// Draws colours at the vertices, interpolated and shaded.
static int draw_vertices(struct tool *tool, struct picture *p, bool reference, bool total,
                         const char *term)
{
    int status = !strcmp(term, "difference") ? difference_planes(tool, p, !reference)
                 : reference                 ? reference_planes(tool, p, term)
                                             : vertex_planes(tool, p, term);
    if (status) return status;
    struct prt_shade shade = shade_of(p, total, exit_option(&tool->opt));
    return tool_exit(
        tool, prt_shade_image(&tool->ctx, p->visibility, p->source.mesh, &shade, &p->image));
}

// Draws with an image-space engine: irradiance and diffusion at the visible surface.
static int draw_on_screen(struct tool *tool, struct picture *p, const char *engine, bool total)
{
    const struct options *o = &tool->opt;
    struct prt_screen_options options = {
        .n_sample = (uint32_t)o->samples,
        .budget_ms = (float)o->budget_ms,
        .seed = o->seed,
        .measure_error = o->measure_error,
    };
    struct prt_shade shade_options = shade_of(p, total, exit_option(o));
    struct prt_screen *screen;
    int status = prt_screen_engine_parse(engine, &options.engine);
    if (status) return tool_exit(tool, status);
    if ((status = maps_load(tool, p->source.mesh, &p->source.media, &p->maps, &options)))
        return status;
    if (ratio_wanted(o))
        status =
            ratio_create(tool, p->source.mesh, &p->source.media, &p->ratio, &p->ratio_report);
    options.ratio = p->ratio;
    options.ratio_share = total ? PRT_WALK_ALL : PRT_WALK_MULTIPLE;
    if (!status) status = prt_screen_create(&tool->ctx, p->source.mesh, NULL, &screen);
    if (status) return tool_exit(tool, status);
    struct prt_screen_input input = {
        .visibility = p->visibility, .media = p->source.media, .cube = &p->light};
    status = prt_screen_image(&tool->ctx, screen, &input, &options, &shade_options, &p->image,
                              &p->report);
    prt_screen_destroy(screen);
    return tool_exit(tool, status);
}

static void add_screen_report(cJSON *root, const struct prt_screen_report *report)
{
    cJSON_AddNumberToObject(root, "samples", report->n_sample);
    cJSON_AddNumberToObject(root, "lights", report->n_light);
    cJSON_AddNumberToObject(root, "rays", (double)report->n_ray);
    cJSON_AddNumberToObject(root, "pairs", (double)report->n_pair);
    cJSON_AddNumberToObject(root, "irradiance_s", report->irradiance_s);
    cJSON_AddNumberToObject(root, "scatter_s", report->scatter_s);
    cJSON_AddNumberToObject(root, "receivers", report->receivers);
    cJSON_AddBoolToObject(root, "uv_atlas", report->uv_atlas);
    if (report->expected_error > 0)
        cJSON_AddNumberToObject(root, "expected_error", report->expected_error);
    if (report->error >= 0) cJSON_AddNumberToObject(root, "error", report->error);
}

static bool is_difference(const struct tool *tool)
{
    return tool->opt.term && !strcmp(tool->opt.term, "difference");
}

// The colours of a picture of the difference, as its pixels have them: sRGB in 8 bits.
static void legend_text(double excess, char out[8])
{
    float rgb[3];
    unsigned byte[3];
    difference_color(excess, rgb);
    for (int c = 0; c < 3; c++) {
        const double x = (double)rgb[c];
        const double s = x <= 0.0031308 ? 12.92 * x : 1.055 * pow(x, 1 / 2.4) - 0.055;
        byte[c] = (unsigned)(255 * s + 0.5);
    }
    snprintf(out, 8, "#%02x%02x%02x", byte[0] & 255, byte[1] & 255, byte[2] & 255);
}

static void note_legend(const struct tool *tool)
{
    char line[256] = "", color[8];
    for (int i = 0; i < DIFFERENCE_LEGEND; i++) {
        const size_t n = strlen(line);
        legend_text(difference_legend[i], color);
        snprintf(line + n, sizeof line - n, "%s%+g %% %s", i ? ", " : "",
                 100 * difference_legend[i], color);
    }
    prt_log(&tool->ctx, PRT_LOG_NOTE, "dipole over walks, less 1: %s", line);
}

static void legend_json(cJSON *to)
{
    cJSON *list = cJSON_AddArrayToObject(to, "legend");
    for (int i = 0; i < DIFFERENCE_LEGEND; i++) {
        char color[8];
        cJSON *o = cJSON_CreateObject();
        legend_text(difference_legend[i], color);
        cJSON_AddNumberToObject(o, "excess", difference_legend[i]);
        cJSON_AddStringToObject(o, "color", color);
        cJSON_AddItemToArray(list, o);
    }
}

static void summary(const struct tool *tool, const struct picture *p, const char *engine,
                    double seconds)
{
    const struct prt_camera *c = &p->camera;
    double covered = (double)prt_visibility_covered(p->visibility);
    if (!tool->opt.json) {
        prt_log(&tool->ctx, PRT_LOG_NOTE, "%s: %ux%u by %s in %.3f s", tool->opt.out,
                p->image.width, p->image.height, engine, seconds);
        if (p->ratio) ratio_note(tool, &p->ratio_report);
        if (is_difference(tool)) note_legend(tool);
        if (is_difference(tool))
            prt_log(
                &tool->ctx, PRT_LOG_NOTE,
                "the dipole errs by %.2g %% RMS under this light; at one vertex in fifty it "
                "is more than %+.2g %% off, at one more than %+.2g %%",
                100 * p->difference.rms, 100 * p->difference.darkest,
                100 * p->difference.brightest);
        return;
    }
    char camera[256];
    prt_camera_print(c, camera, sizeof camera);
    cJSON *root = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "out", tool->opt.out);
    cJSON_AddStringToObject(root, "engine", engine);
    cJSON_AddNumberToObject(root, "width", p->image.width);
    cJSON_AddNumberToObject(root, "height", p->image.height);
    cJSON_AddNumberToObject(root, "covered", covered);
    cJSON_AddStringToObject(root, "camera", camera);
    cJSON_AddNumberToObject(root, "seconds", seconds);
    if (p->source.media_given && p->source.transport && !p->on_screen)
        cJSON_AddNumberToObject(root, "material_error", p->lost);
    if (is_difference(tool)) {
        cJSON_AddNumberToObject(root, "dipole_error", p->difference.rms);
        cJSON_AddNumberToObject(root, "dipole_darkest", p->difference.darkest);
        cJSON_AddNumberToObject(root, "dipole_brightest", p->difference.brightest);
        legend_json(root);
    }
    if (p->on_screen) add_screen_report(root, &p->report);
    if (p->ratio) ratio_json(root, &p->ratio_report);
    if (p->specular_measured) {
        cJSON_AddNumberToObject(root, "specular_error", p->specular_error);
        cJSON_AddNumberToObject(root, "specular_error_without_occlusion", p->without);
    }
    char *text = cJSON_PrintUnformatted(root);
    puts(text ? text : "{}");
    free(text);
    cJSON_Delete(root);
}

static enum prt_tone tone_of(const char *word)
{
    if (word && !strcmp(word, "reinhard")) return PRT_TONE_REINHARD;
    if (word && !strcmp(word, "none")) return PRT_TONE_NONE;
    return PRT_TONE_FILMIC;
}

static int draw(struct tool *tool, struct picture *p)
{
    const struct options *o = &tool->opt;
    const char *term = o->term ? o->term : "total";
    bool total = !strcmp(term, "total");
    uint32_t width = o->width ? o->width : 800, height = o->height ? o->height : 600;
    if (!o->width && is_terminal_path(o->out)) {
        struct prt_terminal terminal;
        prt_terminal_detect(STDOUT_FILENO, &terminal);
        prt_terminal_fit(&terminal, &width, &height);
    }
    int status;
    const char *engine = choose_engine(tool, &p->source, &status);
    if (!engine) return status;
    bool vertex = !strcmp(engine, "vertex"), reference = !strcmp(engine, "reference");
    if (vertex && (o->cube_full || (o->cube && o->cube != p->source.transport->cube)))
        return usage_error(o,
                           "%s was baked for a light of 6x%ux%u: --cube sets it for other "
                           "engines only",
                           p->source.path, p->source.transport->cube,
                           p->source.transport->cube);
    if (vertex && (status = source_material_error(tool, &p->source, term, &p->lost)))
        return status;
    if ((status = place_camera(tool, p, (float)width / (float)height))) return status;
    double started = prt_time_s();
    if ((status = load_lights(tool, p, vertex, total))) return status;
    if (total && (status = trace_hidden_sky(tool, p))) return status;
    struct prt_raster raster = {width, height, o->msaa ? (unsigned)o->msaa : 4,
                                PRT_RASTER_AUTO};
    status = tool_exit(tool, prt_visibility_create(&tool->ctx, p->source.mesh, &p->camera,
                                                   &raster, &p->visibility));
    if (status) return status;
    p->on_screen = !vertex && !reference;
    const bool difference = !strcmp(term, "difference");
    if (!strcmp(term, "irradiance") || difference) p->leave_out = PRT_LOOK_ALL;
    if (o->no_textures) p->leave_out = PRT_LOOK_ALL;
    if (o->albedo_map) p->leave_out |= PRT_LOOK_BASE;
    if (o->normal_map || o->bump_map) p->leave_out |= PRT_LOOK_NORMAL;
    if (o->floor)
        status =
            prt_floor_shadow(&tool->ctx, p->source.mesh, p->visibility, &p->light, &p->shadow);
    if (status) return tool_exit(tool, status);
    status = p->on_screen ? draw_on_screen(tool, p, engine, total)
                          : draw_vertices(tool, p, reference, total, term);
    if (!status && total && o->measure_error) status = measure_specular(tool, p);
    if (status) return status;
    double seconds = prt_time_s() - started;
    struct prt_picture_options options = {.tone = difference ? PRT_TONE_NONE : tone_of(o->tone),
                                          .exposure_ev = (float)o->exposure_ev,
                                          .quality = o->quality ? (int)o->quality : 92,
                                          .full_float = o->full_float};
    status = tool_exit(tool, output_image(&tool->ctx, o->out, &p->image, &options));
    if (!status) summary(tool, p, engine, seconds);
    return status;
}

int run_image(struct tool *tool)
{
    struct picture p = {0};
    int status = check_usage(tool, &p);
    if (!status && !is_terminal_path(tool->opt.out))
        status = check_writable(tool, tool->opt.out);
    if (status) return status;
    if ((status = source_open(tool, tool->opt.input[0], NULL, &p.source))) return status;
    status = draw(tool, &p);
    picture_finish(&p);
    return status;
}
