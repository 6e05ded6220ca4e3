// SPDX-License-Identifier: MIT
// What a pin or a decision was about: hashes of the mesh and of the bake, the engine.
#include "rooms/room_private.h"

#include "prt/transport.h"
#include "rooms/state.h"
#include "store/models.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct seen_wait {
    struct request_wait wait; // first
    struct room *room;
    struct model *model;
    Relight__Scene *scene;
    seen_fn fn;
};

// Also one whose file is not open; a preview that is not is MODEL_UNLOADED for model_state(),
// too.
static bool is_baked(const struct model *model)
{
    return model->state == RELIGHT__MODEL_STATE__MODEL_READY;
}

Relight__Engine engine_for(const struct server *server, const char *id,
                           const Relight__Shade *shade)
{
    const struct model *model = models_get(server->models, id);
    bool baked = model && is_baked(model);
    if (shade && shade->engine) return shade->engine;
    return baked ? RELIGHT__ENGINE__ENGINE_DEFAULT : RELIGHT__ENGINE__ENGINE_SPLAT;
}

void fetch_scene_then(struct request *request, const ProtobufCMessage *scene,
                      void (*run)(struct request *request))
{
    const struct server *server = request->server;
    if (server->fetch_then) server->fetch_then(request, scene, false, run);
    else run(request);
}

static void fill_and_go(struct seen_wait *w, struct request *request)
{
    const struct prt_file *file = w->wait.entry->value;
    const struct prt_transport *t = prt_file_transport(file);
    Relight__Seen seen = RELIGHT__SEEN__INIT;
    struct model_hashes hashes = model_hashes(file);
    bool baked = is_baked(w->model);
    static const int engines[] = {RELIGHT__ENGINE__ENGINE_WAVELET,
                                  RELIGHT__ENGINE__ENGINE_POLYNOMIAL,
                                  RELIGHT__ENGINE__ENGINE_JOINT};
    seen.model = w->model->id;
    seen.mesh_hash = hashes.mesh;
    seen.bake_hash = hashes.bake;
    seen.server = (char *)(uintptr_t)RELIGHT_VERSION;
    seen.engine = engine_for(request->server, w->scene->model, w->scene->shade);
    if (!seen.engine && baked && t->engine < 3)
        seen.engine = (Relight__Engine)engines[t->engine];
    w->fn(request, w->room, w->scene, &seen);
}

static void opened(struct request_wait *wait, struct request *request)
{
    struct seen_wait *w = (struct seen_wait *)wait;
    if (request && wait->entry->state == CACHE_READY) {
        if (w->room->state && !w->room->stale) fill_and_go(w, request);
        else request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY, "the room is being read");
    } else if (request) {
        request_fail(request, wait->entry->error_code, "%s", wait->entry->error);
    }
    cache_release(wait->entry);
    model_release(w->model);
    room_release(w->room);
    relight__scene__free_unpacked(w->scene, NULL);
    free(w);
}

void find_seen(struct request *request, struct room *room, const Relight__Scene *scene,
               seen_fn fn)
{
    char error[256];
    int code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    struct model *model = NULL;
    if (!scene || !*scene->model)
        snprintf(error, sizeof error, "the scene has no model: set it first");
    else
        model = models_find(request->server->models, request->conn->caller.name, scene->model,
                            error);
    struct cache_entry *entry = model ? model_mesh_open(model, &code, error) : NULL;
    struct seen_wait *w = entry ? calloc(1, sizeof *w) : NULL;
    if (!w || !(w->scene = message_copy(scene))) {
        cache_release(entry);
        free(w);
        request_fail(request, entry ? RELIGHT__ERROR_CODE__ERROR_NO_MEMORY : code, "%s",
                     entry ? "not enough memory" : error);
        return;
    }
    w->room = room;
    w->model = model;
    w->fn = fn;
    room_hold(room);
    model_hold(model);
    request_await_entry(request, &w->wait, entry, opened);
}
