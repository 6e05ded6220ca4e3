// SPDX-License-Identifier: MIT
// Commands that fetch light: environments, colours, pictures, edits; and geometry.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int run_env(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_env_info info;
    char env[80];
    if (relight_env_resolve(client, options->target, progress_bar, NULL, env, &error) ||
        relight_env_prepare(client, env, &info, &error))
        return report_error(options, &error);
    progress_clear();
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "env", env);
        cJSON_AddStringToObject(json, "kind", info.cube ? "cube" : "latlong");
        cJSON_AddNumberToObject(json, "width", info.width);
        cJSON_AddNumberToObject(json, "height", info.height);
        cJSON_AddNumberToObject(json, "full_cube", info.full_cube);
        cJSON_AddNumberToObject(json, "mended", info.n_mended);
        add_floats(json, "mean", info.mean);
        add_float(json, "decode_ms", info.decode_ms);
        print_json(json);
    } else {
        puts(env);
    }
    return EXIT_DONE;
}

// Polynomial transport has the light of its bake, and takes no other.
static bool has_own_light(struct relight_client *client, const char *model)
{
    struct relight_error error;
    struct relight_model m;
    if (relight_info(client, model, &m, &error)) return false;
    bool own = !strcmp(m.engine, "polynomial");
    relight_model_finish(&m);
    return own;
}

// The lights of the command line, files uploaded. names[i] backs lights[i].env.
static int get_lights(struct relight_client *client, struct options *o,
                      struct relight_light lights[MAX_WORDS], char names[MAX_WORDS][80])
{
    struct relight_error error;
    if (!o->n_env && (o->n_rotate || o->n_gain))
        return report_usage(o, "--rotate and --gain are for --env");
    if (!o->n_env && !has_own_light(client, o->target))
        return report_usage(o, "--env is missing");
    if (o->n_rotate > 1 && o->n_rotate != o->n_env)
        return report_usage(o, "%zu --rotate for %zu --env", o->n_rotate, o->n_env);
    if (o->n_gain > 1 && o->n_gain != o->n_env)
        return report_usage(o, "%zu --gain for %zu --env", o->n_gain, o->n_env);
    for (size_t i = 0; i < o->n_env; i++) {
        if (relight_env_resolve(client, o->env[i], progress_bar, NULL, names[i], &error))
            return report_error(o, &error);
        lights[i] = (struct relight_light){.env = names[i]};
        lights[i].rotate_deg = o->rotate_deg[o->n_rotate > 1 ? i : 0];
        if (o->n_gain) memcpy(lights[i].gain, o->gain[o->n_gain > 1 ? i : 0], 12);
    }
    progress_clear();
    return EXIT_DONE;
}

// Uploads the files of --albedo-map, --normal-map and --bump-map.
static int get_maps(struct relight_client *client, struct options *o)
{
    struct relight_error error;
    const char **use[3] = {&o->shade.albedo_map, &o->shade.normal_map, &o->shade.bump_map};
    if (o->shade.bump_mm > 0 && !o->map[2])
        return report_usage(o, "--bump-mm is for --bump-map");
    for (int k = 0; k < 3; k++) {
        if (!o->map[k]) continue;
        if (relight_upload_file(client, o->map[k], progress_bar, NULL, o->map_hash[k], NULL,
                                &error))
            return report_error(o, &error);
        *use[k] = o->map_hash[k];
    }
    progress_clear();
    return EXIT_DONE;
}

static void add_cost(cJSON *json, const struct relight_cost *cost)
{
    cJSON_AddStringToObject(json, "engine", relight_engine_name(cost->engine));
    add_float(json, "error_bound", cost->error_bound);
    if (*cost->note) cJSON_AddStringToObject(json, "note", cost->note);
    if (cost->samples) cJSON_AddNumberToObject(json, "samples", cost->samples);
    if (cost->draft) add_float(json, "bake_fraction", cost->bake_fraction);
    cJSON *ms = cJSON_AddObjectToObject(json, "milliseconds");
    add_float(ms, "queue", cost->queue_ms);
    add_float(ms, "light", cost->light_ms);
    add_float(ms, "relight", cost->relight_ms);
    add_float(ms, "raster", cost->raster_ms);
    add_float(ms, "shade", cost->shade_ms);
    add_float(ms, "encode", cost->encode_ms);
    add_float(ms, "total", cost->total_ms);
}

static void print_cost(const char *what, const char *path, const struct relight_cost *cost)
{
    printf("%s: %s, %s, %.1f ms", path, what, relight_engine_name(cost->engine),
           (double)cost->total_ms);
    if (cost->error_bound > 0)
        printf(", error %s%.2g %%", cost->samples ? "about " : "",
               100 * (double)cost->error_bound);
    putchar('\n');
    if (*cost->note) fprintf(stderr, "relight: %s\n", escape(cost->note).text);
}

// The first plane as linear RGB; coefficients are multiplied with the model's factors.
static int decode(struct relight_client *client, const struct options *o,
                  const struct relight_colors *colors, float *rgb, struct relight_error *error)
{
    struct relight_factors factors = {0};
    struct relight_model model = {0};
    struct relight_geometry own = {0}; // whose blocks have a variant's gains
    const char *variant = o->shade.variant;
    if (colors->format != RELIGHT_COLOR_COEFFICIENTS &&
        colors->format != RELIGHT_COLOR_COEFFICIENTS_PACKED)
        return relight_colors_decode(colors, 0, rgb);
    int status = variant
                     ? relight_geometry_variant(client, o->target, variant, false, &own, error)
                     : relight_info(client, o->target, &model, error);
    if (!status) status = relight_factors(client, o->target, 0, &factors, error);
    if (!status)
        status = relight_coefficients_colors(&factors, colors, 0,
                                             variant ? own.n_block : model.n_block,
                                             variant ? own.block : model.block, rgb, error);
    relight_factors_finish(&factors);
    relight_model_finish(&model);
    relight_geometry_finish(&own);
    return status;
}

static int save_colors(struct relight_client *client, struct options *o,
                       const struct relight_colors *colors)
{
    struct relight_error error;
    struct relight_geometry geometry = {0};
    bool solid = prt_vertex_format_has_mesh(prt_vertex_format_of(o->output));
    if (solid && relight_geometry_posed(client, o->target, o->pose, true, &geometry, &error))
        return report_error(o, &error);
    float *rgb = malloc(((size_t)colors->n_vertex + 1) * 12);
    int status;
    if (!rgb) {
        error =
            (struct relight_error){.code = RELIGHT_E_NO_MEMORY, .text = "not enough memory"};
        status = report_error(o, &error);
    } else if (solid && geometry.n_vertex != colors->n_vertex) {
        error = (struct relight_error){.code = RELIGHT_E_PROTOCOL,
                                       .text = "colours and geometry differ in length"};
        status = report_error(o, &error);
    } else {
        status = decode(client, o, colors, rgb, &error);
        if (status) status = report_error(o, &error);
        else status = write_vertices(o, o->output, colors->n_vertex, rgb, &geometry);
    }
    free(rgb);
    relight_geometry_finish(&geometry);
    return status;
}

int run_colors(struct relight_client *client, struct options *o)
{
    struct relight_error error;
    struct relight_light lights[MAX_WORDS];
    char names[MAX_WORDS][80];
    struct relight_colors colors;
    if (prt_vertex_format_of(o->output) == PRT_VERTEX_NONE)
        return report_usage(o, "-o FILE has to end in .csv, .npy, .ply or .glb");
    int status = get_lights(client, o, lights, names);
    if (status) return status;
    struct relight_colors_request request = {.model = o->target,
                                             .n_light = o->n_env,
                                             .lights = lights,
                                             .sum = true,
                                             .shade = o->shade,
                                             .format = o->format,
                                             .exposure_ev = o->picture.exposure_ev,
                                             .pose = o->pose,
                                             .priority = o->priority};
    if (relight_colors(client, &request, &colors, &error)) return report_error(o, &error);
    status = save_colors(client, o, &colors);
    if (!status && o->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", o->output);
        cJSON_AddNumberToObject(json, "vertices", colors.n_vertex);
        add_cost(json, &colors.cost);
        print_json(json);
    } else if (!status && strcmp(o->output, "/dev/stdout")) {
        char what[32];
        snprintf(what, sizeof what, "%u vertices", colors.n_vertex);
        print_cost(what, o->output, &colors.cost);
    }
    relight_colors_finish(&colors);
    return status;
}

int put_picture(const struct options *o, const struct relight_image *image)
{
    const bool terminal = is_terminal_path(o->output);
    int status = terminal ? draw_in_terminal(o, image)
                          : write_file(o, o->output, image->data, image->n_byte);
    if (!status && o->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", o->output);
        cJSON_AddNumberToObject(json, "width", image->width);
        cJSON_AddNumberToObject(json, "height", image->height);
        if (image->camera.set) {
            cJSON *camera = cJSON_AddObjectToObject(json, "camera");
            add_floats(camera, "eye", image->camera.eye);
            add_floats(camera, "target", image->camera.target);
            add_floats(camera, "up", image->camera.up);
            add_float(camera, "fovy_deg", image->camera.fovy_deg);
        }
        add_cost(json, &image->cost);
        print_json(json);
    } else if (!status && !terminal && strcmp(o->output, "/dev/stdout")) {
        char what[40];
        snprintf(what, sizeof what, "%u x %u", image->width, image->height);
        print_cost(what, o->output, &image->cost);
    }
    return status;
}

int run_image(struct relight_client *client, struct options *o)
{
    struct relight_error error;
    struct relight_light lights[MAX_WORDS];
    char names[MAX_WORDS][80];
    struct relight_image image;
    if (!picture_ending(o->output, &o->picture.format)) return picture_usage(o, "");
    fit_terminal(o);
    int status = get_lights(client, o, lights, names);
    if (!status) status = get_maps(client, o);
    if (status) return status;
    struct relight_image_request request = {.model = o->target,
                                            .n_light = o->n_env,
                                            .lights = lights,
                                            .shade = o->shade,
                                            .picture = o->picture,
                                            .pose = o->pose,
                                            .priority = o->priority};
    if (relight_image(client, &request, &image, &error)) return report_error(o, &error);
    status = put_picture(o, &image);
    relight_image_finish(&image);
    return status;
}

int run_edit(struct relight_client *client, struct options *o)
{
    if (!o->material && !o->n_material) return report_usage(o, "--material is missing");
    bool vertices = prt_vertex_format_of(o->output) != PRT_VERTEX_NONE;
    if (!vertices && !picture_ending(o->output, &o->picture.format))
        return picture_usage(o, ".csv, .npy, .ply, .glb, ");
    if (vertices && (o->map[0] || o->map[1] || o->map[2]))
        return report_usage(o, "--albedo-map, --normal-map and --bump-map are for pictures");
    return vertices ? run_colors(client, o) : run_image(client, o);
}

int run_geometry(struct relight_client *client, struct options *o)
{
    struct relight_error error;
    struct relight_geometry geometry;
    enum prt_vertex_format format = prt_vertex_format_of(o->output);
    if (format == PRT_VERTEX_NONE || format == PRT_VERTEX_CSV)
        return report_usage(o, "-o FILE has to end in .ply, .glb or .npy");
    if (relight_geometry(client, o->target, o->own_units, &geometry, &error))
        return report_error(o, &error);
    int status = write_vertices(o, o->output, geometry.n_vertex, NULL, &geometry);
    if (!status && o->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "file", o->output);
        cJSON_AddNumberToObject(json, "vertices", geometry.n_vertex);
        cJSON_AddNumberToObject(json, "triangles", geometry.n_triangle);
        add_float(json, "mm_per_unit", geometry.mm_per_unit);
        print_json(json);
    } else if (!status && strcmp(o->output, "/dev/stdout")) {
        printf("%s: %u vertices, %u triangles\n", o->output, geometry.n_vertex,
               geometry.n_triangle);
    }
    relight_geometry_finish(&geometry);
    return status;
}
