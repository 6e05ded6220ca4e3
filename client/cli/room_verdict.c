// SPDX-License-Identifier: MIT
// What has changed since a decision: the scene, or the model under it. The scene's model can be
// another bake under the same id: a bake replaces its preview, and a forgotten model is baked
// again.
#include "room.h"

#include <stdio.h>
#include <string.h>

static unsigned revision_now(const cJSON *state)
{
    const cJSON *r, *scene = list_of(state, "scene");
    unsigned now = 0;
    cJSON_ArrayForEach(r, list_of(state, "revisions"))
    {
        if (cJSON_Compare(list_of(r, "scene"), scene, 1))
            now = (unsigned)number_of(r, "number");
    }
    return now;
}

void room_now_scene(const cJSON *state, struct room_now *out)
{
    out->revision = revision_now(state);
}

void room_now(struct room_call *c, const cJSON *state, struct room_now *out)
{
    const char *id = text_of(list_of(state, "scene"), "model");
    struct relight_model model;
    struct relight_error error;
    *out = (struct room_now){0};
    room_now_scene(state, out);
    // A model that is gone, or cannot be read yet, has no hashes: then nothing is said of it.
    if (!*id || relight_info(c->client, id, &model, &error)) return;
    snprintf(out->model, sizeof out->model, "%s", model.id);
    snprintf(out->mesh_hash, sizeof out->mesh_hash, "%s", model.mesh_hash);
    snprintf(out->bake_hash, sizeof out->bake_hash, "%s", model.bake_hash);
    relight_model_finish(&model);
}

const char *room_model_change(const cJSON *decision, const struct room_now *now)
{
    const cJSON *seen = list_of(decision, "seen");
    const char *mesh = text_of(seen, "mesh_hash"), *bake = text_of(seen, "bake_hash");
    // A daemon that says no mesh hash says no bake hash, either.
    if (strcmp(text_of(seen, "model"), now->model) || !*now->mesh_hash || !*mesh) return "";
    if (strcmp(mesh, now->mesh_hash)) return "the model has another shape since";
    if (!strcmp(bake, now->bake_hash)) return "";
    if (!*bake) return "the model was baked since";
    return *now->bake_hash ? "the model was baked anew since" : "the model has no bake now";
}

bool room_stands(const cJSON *decision, const struct room_now *now)
{
    return number_of(list_of(decision, "seen"), "revision") == now->revision &&
           !*room_model_change(decision, now);
}
