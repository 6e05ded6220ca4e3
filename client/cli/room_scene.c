// SPDX-License-Identifier: MIT
// A room's scene from the options of the command line.
#include "room.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void add_vec3(cJSON *to, const char *field, const float x[3])
{
    static const char *const axis[] = {"x", "y", "z"};
    cJSON *v = cJSON_AddObjectToObject(to, field);
    for (int i = 0; i < 3; i++) add_float(v, axis[i], x[i]);
}

static int add_lights(struct room_call *c, cJSON *scene)
{
    const struct options *o = c->options;
    cJSON *lights = cJSON_AddArrayToObject(scene, "lights");
    for (size_t i = 0; i < o->n_env; i++) {
        char env[80];
        if (relight_env_resolve(c->client, o->env[i], progress_bar, NULL, env, &c->error))
            return room_failed(c);
        cJSON *light = cJSON_CreateObject();
        cJSON_AddItemToArray(lights, light);
        cJSON_AddStringToObject(light, "env", env);
        if (o->n_rotate) add_float(light, "rotate_deg", o->rotate_deg[o->n_rotate > 1 ? i : 0]);
        if (o->n_gain) add_vec3(light, "gain", o->gain[o->n_gain > 1 ? i : 0]);
    }
    progress_clear();
    return EXIT_DONE;
}

static bool has_camera(const struct relight_camera *camera)
{
    return camera->set || camera->has_orbit || camera->name[0];
}

void room_add_camera(cJSON *scene, const struct relight_camera *camera)
{
    cJSON *out = cJSON_AddObjectToObject(scene, "camera");
    if (camera->name[0]) {
        cJSON_AddStringToObject(out, "name", camera->name);
    } else if (camera->has_orbit) {
        cJSON *orbit = cJSON_AddObjectToObject(out, "orbit");
        add_float(orbit, "azimuth_deg", camera->azimuth_deg);
        add_float(orbit, "elevation_deg", camera->elevation_deg);
        add_float(orbit, "zoom", camera->zoom);
    } else {
        add_vec3(out, "eye", camera->eye);
        add_vec3(out, "target", camera->target);
        const float *up = camera->up;
        if (fabsf(up[0]) + fabsf(up[1]) + fabsf(up[2]) > 0) add_vec3(out, "up", up);
        add_float(out, "fovy_deg", camera->fovy_deg);
    }
}

// What the command names; the rest stays as it is in the room.
static void add_picture(const struct options *o, cJSON *scene, cJSON *parts)
{
    static const char *const tones[] = {"filmic", "reinhard", "none"};
    const struct relight_picture *p = &o->picture;
    cJSON *out = cJSON_CreateObject();
    if (o->given['z']) cJSON_AddNumberToObject(out, "width", p->width);
    if (o->given['z']) cJSON_AddNumberToObject(out, "height", p->height);
    if (o->given['n']) cJSON_AddStringToObject(out, "tone", tones[p->tone]);
    if (o->given['x']) add_float(out, "exposure_ev", p->exposure_ev);
    if (o->given['a']) cJSON_AddNumberToObject(out, "samples", p->samples);
    if (p->no_specular) cJSON_AddTrueToObject(out, "no_specular");
    if (p->floor) cJSON_AddTrueToObject(out, "floor");
    if (o->given['B']) {
        cJSON_AddBoolToObject(out, "transparent", p->transparent);
        cJSON_AddBoolToObject(out, "plain_background", p->plain_background);
        add_vec3(out, "background", p->background);
    }
    if (!out->child) {
        cJSON_Delete(out);
        return;
    }
    cJSON_AddItemToObject(scene, "picture", out);
    cJSON_AddItemToArray(parts, cJSON_CreateString("picture"));
}

static int add_model(struct room_call *c, cJSON *scene, cJSON *parts)
{
    struct relight_model model;
    if (relight_info(c->client, c->options->model, &model, &c->error)) return room_failed(c);
    cJSON_AddStringToObject(scene, "model", model.id);
    cJSON_AddItemToArray(parts, cJSON_CreateString("model"));
    relight_model_finish(&model);
    return EXIT_DONE;
}

// Engine, term, variant and the media by object.
static void add_shade(const struct options *o, cJSON *scene, cJSON *parts)
{
    static const char *const terms[] = {"total", "irradiance", "multiple", "single"};
    const bool variant = o->given[9], term = o->given['t'], engine = o->given['g'];
    const bool error = o->shade.max_error > 0, budget = o->shade.budget_ms > 0;
    if (!engine && !o->n_material && !variant && !term && !error && !budget) return;
    cJSON *shade = cJSON_AddObjectToObject(scene, "shade");
    cJSON_AddItemToArray(parts, cJSON_CreateString("shade"));
    if (engine) cJSON_AddStringToObject(shade, "engine", relight_engine_name(o->shade.engine));
    if (term) cJSON_AddStringToObject(shade, "term", terms[o->shade.term]);
    if (error) cJSON_AddNumberToObject(shade, "max_error", (double)o->shade.max_error);
    if (budget) cJSON_AddNumberToObject(shade, "budget_ms", o->shade.budget_ms);
    if (variant) cJSON_AddStringToObject(shade, "variant", o->shade.variant);
    if (!o->n_material) return;
    cJSON *list = cJSON_AddArrayToObject(shade, "materials");
    for (size_t i = 0; i < o->n_material; i++) {
        cJSON *own = cJSON_CreateObject();
        cJSON_AddStringToObject(own, "object", o->materials[i].object);
        cJSON_AddStringToObject(own, "material", o->materials[i].material);
        cJSON_AddItemToArray(list, own);
    }
}

static void add_rest(const struct options *o, cJSON *scene, cJSON *parts)
{
    if (o->material) {
        cJSON_AddStringToObject(scene, "material", o->material);
        cJSON_AddItemToArray(parts, cJSON_CreateString("material"));
    }
    add_shade(o, scene, parts);
    if (has_camera(&o->picture.camera)) {
        room_add_camera(scene, &o->picture.camera);
        cJSON_AddItemToArray(parts, cJSON_CreateString("camera"));
    }
    add_picture(o, scene, parts);
}

int room_scene(struct room_call *c, cJSON **scene, cJSON **parts)
{
    const struct options *o = c->options;
    int status = EXIT_DONE;
    if ((o->n_rotate > 1 && o->n_rotate != o->n_env) ||
        (o->n_gain > 1 && o->n_gain != o->n_env))
        return report_usage(o, "--rotate and --gain come once, or once for each --env");
    if ((o->n_rotate || o->n_gain) && !o->n_env)
        return report_usage(o, "--rotate and --gain are for --env");
    *scene = cJSON_CreateObject();
    *parts = cJSON_CreateArray();
    if (o->model) status = add_model(c, *scene, *parts);
    if (!status && o->n_env) {
        status = add_lights(c, *scene);
        cJSON_AddItemToArray(*parts, cJSON_CreateString("lights"));
    }
    add_rest(o, *scene, *parts);
    if (!status) return EXIT_DONE;
    cJSON_Delete(*scene);
    cJSON_Delete(*parts);
    return status;
}
