// SPDX-License-Identifier: MIT
#include "scene_request.h"

#include "message_text.h"
#include "relight.pb-c.h"

#include <stdio.h>

static void put_vec3(const Relight__Vec3 *from, float to[3])
{
    to[0] = from ? from->x : 0;
    to[1] = from ? from->y : 0;
    to[2] = from ? from->z : 0;
}

static const char *given(const char *text)
{
    return text && *text ? text : NULL;
}

static void put_camera(const Relight__Camera *from, struct relight_camera *to)
{
    if (!from) return;
    if (given(from->name)) snprintf(to->name, sizeof to->name, "%s", from->name);
    to->set = from->eye || from->orbit || to->name[0];
    put_vec3(from->eye, to->eye);
    put_vec3(from->target, to->target);
    put_vec3(from->up, to->up);
    to->fovy_deg = from->fovy_deg;
    if (!from->orbit) return;
    to->has_orbit = true;
    to->azimuth_deg = from->orbit->azimuth_deg;
    to->elevation_deg = from->orbit->elevation_deg;
    to->zoom = from->orbit->zoom;
}

static void put_picture(const Relight__Picture *from, struct relight_picture *to)
{
    if (!from) return;
    to->width = from->width, to->height = from->height;
    to->tone = (enum relight_tone)from->tone;
    to->exposure_ev = from->exposure_ev;
    to->plain_background = from->plain_background;
    put_vec3(from->background, to->background);
    to->samples = from->samples;
    to->no_specular = from->no_specular;
    to->floor = from->floor, to->transparent = from->transparent;
}

static void put_shade(const Relight__Shade *from, struct relight_shade *to)
{
    if (!from) return;
    to->engine = (enum relight_engine)from->engine;
    to->term = (enum relight_term)from->term;
    to->max_error = from->max_error;
    to->budget_ms = from->budget_ms;
    to->albedo_map = given(from->albedo_map);
    to->normal_map = given(from->normal_map);
    to->bump_map = given(from->bump_map);
    to->bump_mm = from->bump_mm;
    to->variant = given(from->variant);
}

static void put_lists(const Relight__Scene *scene, struct scene_request *out)
{
    struct relight_image_request *r = &out->request;
    r->lights = out->light;
    for (; r->n_light < scene->n_lights && r->n_light < SCENE_LIGHTS; r->n_light++) {
        const Relight__Light *from = scene->lights[r->n_light];
        struct relight_light *to = &out->light[r->n_light];
        *to = (struct relight_light){.env = from->env, .rotate_deg = from->rotate_deg};
        put_vec3(from->gain, to->gain);
    }
    size_t n = scene->shade ? scene->shade->n_materials : 0;
    r->shade.materials = out->material;
    for (; r->shade.n_material < n && r->shade.n_material < SCENE_MATERIALS;
         r->shade.n_material++) {
        const Relight__ObjectMaterial *from = scene->shade->materials[r->shade.n_material];
        out->material[r->shade.n_material] =
            (struct relight_object_material){from->object, from->material};
    }
}

int scene_request_make(const cJSON *json, struct scene_request *out,
                       struct relight_error *error)
{
    char fault[MESSAGE_TEXT_ERROR] = "";
    ProtobufCMessage *message = message_new(&relight__scene__descriptor);
    *error = (struct relight_error){.code = RELIGHT_E_NO_MEMORY, .text = "not enough memory"};
    if (!message) return -RELIGHT_E_NO_MEMORY;
    if (message_from_json(message, json, fault)) {
        protobuf_c_message_free_unpacked(message, NULL);
        error->code = RELIGHT_E_PROTOCOL;
        snprintf(error->text, sizeof error->text, "the room's scene: %s", fault);
        return -RELIGHT_E_PROTOCOL;
    }
    const Relight__Scene *scene = (const Relight__Scene *)(const void *)message;
    *out = (struct scene_request){.scene = message};
    out->request.model = scene->model;
    out->request.pose = given(scene->pose);
    put_shade(scene->shade, &out->request.shade);
    out->request.shade.material = given(scene->material);
    put_picture(scene->picture, &out->request.picture);
    put_camera(scene->camera, &out->request.picture.camera);
    put_lists(scene, out);
    return 0;
}

void scene_request_finish(struct scene_request *request)
{
    if (request->scene) protobuf_c_message_free_unpacked(request->scene, NULL);
    request->scene = NULL;
}
