// SPDX-License-Identifier: MIT
// What a client asks first: who the daemon is and what it holds.
#include "ops/geometry_textures.h"
#include "net/replicas.h"
#include "net/dispatch.h"
#include "ops/model_messages.h"
#include "ops/shared_models.h"
#include "core/log.h"
#include "core/access.h"
#include "store/model_files.h"
#include "store/models.h"
#include "relight.pb-c.h"
#include "render/render.h"
#include "net/request_wait.h"
#include "render/shared/geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MESSAGE(type) ((const Relight__##type *)request->message)

static uint32_t milliseconds(double seconds)
{
    return seconds * 1e3 < (double)UINT32_MAX ? (uint32_t)(seconds * 1e3) : UINT32_MAX;
}

static void fill_limits(const struct options *o, Relight__HelloAnswer *out)
{
    // PROTOCOL.md lists them; a client tests for a word before it relies on the feature.
    static const char *const features[] = {
        "animations", "coarse",      "coefficients", "coefficients-packed",
        "env-cube",   "error-range", "events",       "exits",
        "get-blob",   "goaway",      "material",     "materials",
        "poses",      "rooms",       "route",        "run",
        "sign",       "texture-png", "textures",     "tokens",
        "view-ack",   "view-equal",  "view-fields",
    };
    out->features = (char **)features;
    out->n_features = sizeof features / sizeof *features;
    out->max_lights = RENDER_MAX_LIGHTS;
    out->max_side = o->max_side;
    out->max_ping = SERVER_MAX_PING;
    out->max_window = SERVER_MAX_WINDOW;
    out->max_answer_header = SERVER_MAX_ANSWER_HEADER;
    out->handshake_ms = milliseconds(o->handshake);
    out->frame_time_ms = milliseconds(o->frame_time);
    out->write_time_ms = milliseconds(o->write_time);
    out->idle_ms = milliseconds(o->idle);
    out->deadline_ms = milliseconds(o->deadline);
}

// Finds out who the client is. False: it was refused.
static bool identify(struct request *request, const char *secret)
{
    struct connection *conn = request->conn;
    struct caller caller;
    char error[256];
    const char *who = conn->greeted ? conn->caller.name : conn->principal->name;
    enum access_verdict verdict = conn->greeted
                                      ? ACCESS_GRANTED
                                      : access_check(request->server->access, who, secret,
                                                     &caller, error, &request->retry_ms);
    if (conn->greeted) return true; // a second HELLO changes sizes, not the identity
    if (verdict == ACCESS_GRANTED && connection_identify(conn, &caller, error)) return true;
    bool busy = verdict == ACCESS_GRANTED || verdict == ACCESS_LATER;
    if (verdict == ACCESS_LATER)
        log_line(LOG_EVENT, "audit act=refused who=%s peer=%s conn=%llu op=HELLO text=\"%s\"",
                 who, conn->peer, (unsigned long long)conn->number, error);
    request_fail(request,
                 busy ? RELIGHT__ERROR_CODE__ERROR_BUSY : RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                 "%s", error);
    if (!conn->dead) connection_finish(conn, "no token");
    return false;
}

// Words of the scopes; at most 8.
static size_t scope_list(unsigned scopes, char *out[8])
{
    static char *const words[] = {"view", "edit", "upload", "admin"};
    size_t n = 0;
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (scopes & 1u << i) out[n++] = words[i];
    return n;
}

// Another replica serves the connection's route, or will when this one has gone: the client is
// told where, and connects there.
static bool sent_elsewhere(struct request *request, const Relight__HelloRequest *in)
{
    const struct server *server = request->server;
    const struct options *o = &server->options;
    struct connection *conn = request->conn;
    char address[128];
    if (!in->route[0] || in->stay || conn->greeted || strlen(in->route) > 200 ||
        !replica_choose(o->replicas, in->route, server->leaving ? o->advertise : "", address,
                        sizeof address) ||
        !strcmp(address, o->advertise))
        return false;
    request->moved = address;
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_MOVED, "%.80s is served by %.120s",
                 in->route, address);
    if (!conn->dead) connection_finish(conn, "another replica serves its route");
    return true;
}

void op_hello(struct request *request)
{
    const Relight__HelloRequest *in = MESSAGE(HelloRequest);
    const struct options *o = &request->server->options;
    struct connection *conn = request->conn;
    if (in->version_min > RELIGHT_PROTOCOL_VERSION ||
        in->version_max < RELIGHT_PROTOCOL_VERSION) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_VERSION,
                     "the client speaks versions %u to %u, this daemon version %d",
                     in->version_min, in->version_max, RELIGHT_PROTOCOL_VERSION);
        if (!conn->dead) connection_finish(conn, "no common version");
        return;
    }
    if (in->max_payload && in->max_payload < 4096) {
        char error[128];
        request_fail(request,
                     range_refuse(error, sizeof error, (double)in->max_payload, 4096,
                                  18446744073709551615.0, "bytes", "max_payload"),
                     "%s; 0 is no limit", error);
        return;
    }
    if (sent_elsewhere(request, in) || !identify(request, in->token)) return;
    conn->greeted = true;
    conn->decoder.limits =
        (struct relight_frame_limits){SERVER_MAX_HEADER, SERVER_MAX_PAYLOAD, true};
    conn->max_payload = in->max_payload;
    log_line(LOG_EVENT, "hello conn=%llu who=%s client=\"%s\"",
             (unsigned long long)conn->number, conn->caller.name, in->client);
    Relight__HelloAnswer out = RELIGHT__HELLO_ANSWER__INIT;
    char *presets[64];
    out.server = "relightd " RELIGHT_VERSION;
    out.version = RELIGHT_PROTOCOL_VERSION;
    out.max_payload = SERVER_MAX_PAYLOAD;
    out.max_header = SERVER_MAX_HEADER;
    out.max_in_flight = o->requests;
    out.max_blob = o->max_blob;
    out.chunk = SERVER_CHUNK;
    char *scopes[8];
    out.principal = conn->caller.name;
    out.scopes = scopes;
    out.n_scopes = scope_list(conn->caller.scopes, scopes);
    out.expires_s = (uint64_t)conn->caller.expires_s;
    out.run = request->server->run;
    out.shares = request->server->shared_models != NULL;
    fill_limits(o, &out);
    out.presets = presets;
    for (const struct prt_material *m;
         out.n_presets < 64 && (m = prt_material_preset((unsigned)out.n_presets));)
        presets[out.n_presets++] = (char *)m->name;
    request_answer(request, &out.base, NULL);
}

void op_ping(struct request *request)
{
    struct timespec now;
    Relight__PingAnswer out = RELIGHT__PING_ANSWER__INIT;
    clock_gettime(CLOCK_REALTIME, &now);
    out.time_us = (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
    struct payload payload = {request->payload, request->payload_size, request->payload, free};
    request->payload = NULL;
    request_answer(request, &out.base, &payload);
}

// ---- models

struct info_text {
    Relight__ModelInfo info;
    Relight__Vec3 low, high;
    Relight__Error error;
    struct error_fields fields;
    char *warnings[64], *warning_text;
    char *variants[PRT_MESH_MOST_VARIANTS];
    char *settings, *errors;
};

static void fill_info(const struct model *m, const char *asker, struct info_text *t)
{
    Relight__ModelInfo *out = &t->info;
    const struct model *answering = model_answering((struct model *)m);
    const struct model_facts *f = answering->facts.known ? &answering->facts : &m->facts;
    relight__model_info__init(out);
    out->model = (char *)m->id;
    out->name = (char *)model_name_for(m, asker);
    out->state = model_state(m);
    out->pinned = m->pinned;
    out->generation = m->generation;
    bool baked = m->state == RELIGHT__MODEL_STATE__MODEL_READY;
    out->fraction = baked ? 1 : m->job ? (float)job_fraction(m->job) : 0;
    if (!baked) out->job = (char *)m->job_id;
    if (f->known) {
        out->n_vertex = f->n_vertex;
        out->n_triangle = f->n_triangle;
        out->n_object = f->n_object;
        out->mm_per_unit = f->mm_per_unit;
        out->stale = m->pose && baked;
        fill_vec3(&t->low, m->facts.known ? m->facts.box[0] : f->box[0]);
        fill_vec3(&t->high, m->facts.known ? m->facts.box[1] : f->box[1]);
        out->box_min = &t->low;
        out->box_max = &t->high;
    }
    out->draft = answering != m;
    if (f->baked) {
        out->engine = (Relight__Engine)(RELIGHT__ENGINE__ENGINE_WAVELET + (int)f->engine);
        out->storage = (Relight__Storage)(RELIGHT__STORAGE__STORAGE_FACTORED + (int)f->storage);
        out->cube = f->cube;
        out->exit_planes = f->exit_planes;
        out->bytes = f->bytes;
        out->error_bound = f->error_multiple;
        if (out->state == RELIGHT__MODEL_STATE__MODEL_READY) out->resident_bytes = f->bytes;
    }
    if (m->state == RELIGHT__MODEL_STATE__MODEL_FAILED) {
        error_fill(&t->error, m->error_code, m->error, &t->fields);
        out->error = &t->error;
    }
    for (uint32_t i = 0; i < m->n_variant; i++) t->variants[i] = m->variant[i].name;
    out->n_variants = m->n_variant;
    out->variants = t->variants;
    t->warning_text = m->warnings ? strdup(m->warnings) : NULL;
    out->warnings = t->warnings;
    char *save = NULL;
    for (char *line = t->warning_text ? strtok_r(t->warning_text, "\n", &save) : NULL;
         line && out->n_warnings < 64; line = strtok_r(NULL, "\n", &save))
        t->warnings[out->n_warnings++] = line;
}

// Fills one entry each; their texts are the folder's list's.
static size_t list_files(const struct server *server, Relight__FileEntry ***out)
{
    size_t n = 0;
    const struct import_listed *file = imports_files(server->imports, &n);
    Relight__FileEntry *entry = calloc(n + 1, sizeof *entry);
    *out = calloc(n + 1, sizeof **out);
    if (!entry || !*out) {
        free(entry);
        return 0;
    }
    for (size_t i = 0; i < n; i++) {
        relight__file_entry__init(&entry[i]);
        entry[i].path = file[i].name;
        entry[i].bytes = file[i].bytes;
        (*out)[i] = &entry[i];
    }
    if (!n) free(entry);
    return n;
}

// The images that the client uploaded; one allocation each for the texts and the pointers.
struct environments {
    struct blob_listed listed[1000];
    Relight__EnvironmentEntry entry[1000], *entries[1000];
    char env[1000][70];
};

static struct environments *list_environments(const struct request *request,
                                              Relight__ListAnswer *out)
{
    struct environments *e = malloc(sizeof *e);
    if (!e) return NULL;
    size_t n =
        blobs_images(request->server->blobs, request->conn->caller.name, e->listed, 1000);
    for (size_t i = 0; i < n; i++) {
        relight__environment_entry__init(&e->entry[i]);
        snprintf(e->env[i], sizeof e->env[i], "env:%s", e->listed[i].hash);
        e->entry[i].env = e->env[i];
        e->entry[i].name = (char *)e->listed[i].name;
        e->entry[i].bytes = e->listed[i].bytes;
        e->entries[i] = &e->entry[i];
    }
    out->environments = e->entries;
    out->n_environments = n;
    return e;
}

// The models of one answer: those after the last one of the answer before, newest first.
static void list_models(const struct request *request, struct info_text *text, size_t most,
                        Relight__ListAnswer *out)
{
    const struct models *models = request->server->models;
    uint64_t after = MESSAGE(ListRequest)->after;
    for (struct model *m = NULL; (m = models_next(models, m));) {
        if (m->replaced || m->removed || (after && m->serial >= after)) continue;
        if (out->n_models == most) {
            out->next = after;
            return;
        }
        fill_info(m, request->conn->caller.name, &text[out->n_models]);
        out->models[out->n_models] = &text[out->n_models].info;
        out->n_models++;
        after = m->serial;
    }
}

// Behind them those that other replicas have, and that are loaded here when somebody asks.
static const uint64_t others_from = UINT64_C(1) << 62; // `after` of LIST: their numbers from 1

static void list_others(const struct request *request, struct info_text *text, size_t most,
                        Relight__ListAnswer *out)
{
    uint64_t after = MESSAGE(ListRequest)->after;
    size_t from = after > others_from ? (size_t)(after - others_from - 1) : 0;
    size_t room = most - out->n_models;
    struct shared_listed *listed = out->next ? NULL : calloc(room + 1, sizeof *listed);
    if (!listed) return;
    size_t n = shared_models_list(request->server->shared_models, from, listed, room + 1);
    if (n > room) out->next = others_from + 1 + from + (n = room);
    for (size_t i = 0; i < n; i++) {
        Relight__ModelInfo *info = &text[out->n_models].info;
        relight__model_info__init(info);
        info->model = (char *)(uintptr_t)listed[i].id;
        info->name = (char *)(uintptr_t)listed[i].name;
        info->state = listed[i].baking ? RELIGHT__MODEL_STATE__MODEL_BAKING
                                       : RELIGHT__MODEL_STATE__MODEL_PREVIEW;
        out->models[out->n_models++] = info;
    }
    free(listed);
}

// The loop serves nobody else while it lists: an answer has 256 models at most.
void op_list(struct request *request)
{
    enum { MOST = 256 };
    const Relight__ListRequest *in = MESSAGE(ListRequest);
    Relight__ListAnswer out = RELIGHT__LIST_ANSWER__INIT;
    size_t most = in->limit && in->limit < MOST ? in->limit : MOST;
    struct environments *environments = NULL;
    struct info_text *text = calloc(most, sizeof *text);
    out.models = calloc(most, sizeof *out.models);
    if (!text || !out.models) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        goto end;
    }
    if (in->after <= others_from) list_models(request, text, most, &out);
    list_others(request, text, most, &out);
    if (in->files) out.n_files = list_files(request->server, &out.files);
    if (in->environments) environments = list_environments(request, &out);
    request_answer(request, &out.base, NULL);
end:
    for (size_t i = 0; i < out.n_models; i++) free(text[i].warning_text);
    if (out.n_files) free(out.files[0]);
    free(text);
    free(environments);
    free(out.models);
    free(out.files);
}

static void info_ready(struct request *request, struct model *m, struct cache_entry *file)
{
    const struct prt_transport *t = prt_file_transport(file->value);
    struct info_text *text = calloc(1, sizeof *text);
    Relight__Block **blocks = NULL;
    Relight__NamedCamera **cameras = NULL;
    struct block_text *block_text = fill_blocks(&t->mesh, &t->media, NULL, &blocks);
    char **media = print_media(&t->media);
    struct camera_text *camera_text = fill_cameras(&t->mesh, &cameras);
    if (!text || !block_text || !blocks || !camera_text || !cameras || !media) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    } else {
        struct model_hashes hashes = model_hashes(file->value);
        fill_info(m, request->conn->caller.name, text);
        text->info.mesh_hash = hashes.mesh;
        text->info.bake_hash = hashes.bake;
        text->info.material = media[0];
        text->info.n_media = t->media.n;
        text->info.media = media;
        bool baked = m->state == RELIGHT__MODEL_STATE__MODEL_READY;
        text->info.settings = (char *)(baked && t->settings ? t->settings : "");
        text->info.errors = (char *)(baked && t->errors ? t->errors : "");
        text->info.n_blocks = t->mesh.n_block;
        text->info.blocks = blocks;
        text->info.n_cameras = t->mesh.n_camera;
        text->info.cameras = cameras;
        request_answer(request, &text->info.base, NULL);
        free(text->warning_text);
    }
    free(text);
    free(media);
    free(block_text);
    free(blocks);
    free(camera_text);
    free(cameras);
}

void op_info(struct request *request)
{
    const char *name = MESSAGE(InfoRequest)->model;
    char error[256];
    struct model *m =
        models_find(request->server->models, request->conn->caller.name, name, error);
    if (!m) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "%s", error);
        return;
    }
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY || m->mesh == MESH_THERE) {
        with_mesh(request, m->id, info_ready);
        return;
    }
    struct info_text *text = calloc(1, sizeof *text);
    if (!text) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    fill_info(m, request->conn->caller.name, text);
    request_answer(request, &text->info.base, NULL);
    free(text->warning_text);
    free(text);
}

// ---- geometry: copied on a worker

struct geometry {
    struct request_wait wait;
    struct cache_entry *shape;
    bool normals, triangles, textures;
    struct texture_sections sections;
    float scale;
    uint64_t generation;
    size_t normals_offset, triangles_offset, size;
    struct model_hashes hashes;
    char *bytes;
};

static size_t up64(size_t n)
{
    return (n + 63) / 64 * 64;
}

static int run_geometry(struct work *work, const struct prt_context *ctx)
{
    struct geometry *g = (struct geometry *)work;
    const struct prt_mesh *mesh = &((struct shape *)g->shape->value)->mesh;
    g->bytes = prt_calloc(g->size ? g->size : 1, 1);
    if (!g->bytes) return PRT_NOMEM;
    size_t n = (size_t)mesh->n_vertex * 3;
    float *position = (float *)g->bytes;
    const float *from = &mesh->position[0][0];
    for (size_t i = 0; i < n; i++) position[i] = from[i] * g->scale;
    if (g->normals) memcpy(g->bytes + g->normals_offset, mesh->normal, n * sizeof(float));
    if (g->triangles)
        memcpy(g->bytes + g->triangles_offset, mesh->triangle, (size_t)mesh->n_triangle * 12);
    if (g->textures) texture_sections_copy(mesh, &g->sections, g->bytes);
    return PRT_OK;
}

static void geometry_copied(struct request_wait *wait, struct request *request)
{
    struct geometry *g = (struct geometry *)wait;
    const struct prt_mesh *mesh = &((struct shape *)g->shape->value)->mesh;
    if (request && wait->work.status) {
        request_fail(request, error_of_status(wait->work.status), "%s", wait->work.error);
    } else if (request) {
        Relight__GeometryAnswer out = RELIGHT__GEOMETRY_ANSWER__INIT;
        struct payload payload = {g->bytes, g->size, g->bytes, prt_free};
        const struct prt_media *own = ((struct shape *)g->shape->value)->media;
        const struct prt_variant *variant = ((struct shape *)g->shape->value)->variant;
        struct block_text *text = fill_blocks(
            mesh, own, variant ? (const float(*)[3])variant->gain : NULL, &out.blocks);
        char **media = print_media(own);
        out.n_blocks = text && out.blocks ? mesh->n_block : 0;
        out.n_media = media ? own->n : 0;
        out.media = media;
        out.n_vertex = mesh->n_vertex;
        out.n_triangle = g->triangles ? mesh->n_triangle : 0;
        out.normals_offset = g->normals ? g->normals_offset : 0;
        out.triangles_offset = g->triangles ? g->triangles_offset : 0;
        out.mm_per_unit = mesh->mm_per_unit;
        out.generation = g->generation;
        out.mesh_hash = g->hashes.mesh;
        void *textures = g->textures ? texture_answer(mesh, &g->sections, &out) : NULL;
        g->bytes = NULL;
        request_answer(request, &out.base, &payload);
        free(text);
        free(out.blocks);
        free(media);
        free(textures);
    }
    prt_free(g->bytes);
    cache_release(g->shape);
    free(g);
}

static void geometry_ready(struct request *request, struct model *m, struct cache_entry *shape)
{
    const Relight__GeometryRequest *in = MESSAGE(GeometryRequest);
    const struct prt_mesh *mesh = &((struct shape *)shape->value)->mesh;
    struct geometry *g = calloc(1, sizeof *g);
    if (!g) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    *g = (struct geometry){.shape = shape,
                           .generation = ((struct shape *)shape->value)->generation,
                           .normals = !in->no_normals,
                           .triangles = !in->no_triangles};
    const struct prt_file *file = ((struct shape *)shape->value)->file->value;
    g->hashes = model_hashes(file);
    g->scale = in->own_units && mesh->mm_per_unit > 0 ? 1 / mesh->mm_per_unit : 1;
    size_t vectors = (size_t)mesh->n_vertex * 12;
    g->size = vectors;
    if (g->normals) {
        g->normals_offset = up64(g->size);
        g->size = g->normals_offset + vectors;
    }
    if (g->triangles) {
        g->triangles_offset = up64(g->size);
        g->size = g->triangles_offset + (size_t)mesh->n_triangle * 12;
    }
    g->textures = in->textures;
    if (g->textures) g->size = texture_sections_plan(mesh, g->size, &g->sections);
    cache_hold(shape);
    request_await_work(request, &g->wait, run_geometry, geometry_copied);
}

void op_geometry(struct request *request)
{
    const Relight__GeometryRequest *in = MESSAGE(GeometryRequest);
    if (*in->image) op_geometry_image(request);
    else if (in->coarse) op_geometry_coarse(request);
    else with_shape(request, in->model, in->pose, in->variant, geometry_ready);
}

// A model that review rooms need is forgotten by force alone. True when the request was
// answered.
static bool refuse_held(struct request *request, const struct model *m, bool force)
{
    const struct holds *holds = request->server->holds;
    bool admin = !access_missing(request->conn->caller.scopes, SCOPE_ADMIN);
    char ids[160];
    if (!holds_has(holds, m->id) || (force && admin)) return false;
    if (force) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "force needs the scope admin: review rooms need %.100s", m->name);
    } else if (!holds_known(holds)) {
        request->retry_ms = 200;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY,
                     "the review rooms that may need %.100s are being read: try again",
                     m->name);
    } else {
        unsigned n = holds_rooms(holds, m->id, ids, sizeof ids);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                     "%.100s: %u review room%s need%s it%s%s: its pins could not be drawn "
                     "again. Close what is over (--rooms-keep deletes it later), or an admin "
                     "forces it (--force)",
                     m->name, n, n == 1 ? "" : "s", n == 1 ? "s" : "", admin ? ": " : "",
                     admin ? ids : "");
    }
    return true;
}

void op_unload(struct request *request)
{
    const Relight__UnloadRequest *in = MESSAGE(UnloadRequest);
    char error[256];
    struct model *m =
        models_find(request->server->models, request->conn->caller.name, in->model, error);
    if (!m) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "%s", error);
        return;
    }
    if (!operation_owned(request, m->owner, in->model)) return;
    Relight__UnloadAnswer out = RELIGHT__UNLOAD_ANSWER__INIT;
    bool forget = in->forget, unpins = m->pinned && !forget;
    if (forget && refuse_held(request, m, in->force)) return;
    log_line(LOG_EVENT, "audit act=unload who=%s model=%s owner=%s forget=%d held=%d",
             request->conn->caller.name, m->id, m->owner, forget,
             holds_has(request->server->holds, m->id));
    if (unpins) m->pinned = false;
    model_hold(m);
    if (forget) shared_models_forget_kin(request->server->shared_models, m);
    out.freed_bytes = model_unload(m, forget);
    if (unpins) model_remember(m); // else the next start would open it
    out.state =
        forget ? RELIGHT__MODEL_STATE__MODEL_UNKNOWN : (Relight__ModelState)model_state(m);
    model_release(m);
    request_answer(request, &out.base, NULL);
}

// ---- stats

enum { MAX_METRICS = 4096 };

struct metrics {
    Relight__StatsAnswer answer;
    Relight__Metric *metric[MAX_METRICS];
};

static void add_metric(void *user, const char *name, const char *labels, double value,
                       const char *help, const char *kind)
{
    struct metrics *all = user;
    Relight__Metric *m = malloc(sizeof *m);
    if (!m || all->answer.n_metrics == MAX_METRICS) {
        free(m);
        return;
    }
    relight__metric__init(m);
    if (asprintf(&m->name, labels[0] ? "%s{%s}" : "%s%s", name, labels) < 0) {
        free(m);
        return;
    }
    m->value = value;
    m->help = (char *)help;
    all->metric[all->answer.n_metrics++] = m;
}

void op_stats(struct request *request)
{
    struct metrics *all = malloc(sizeof *all);
    if (!all) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    relight__stats_answer__init(&all->answer);
    all->answer.metrics = all->metric;
    stats_each(request->server, add_metric, all);
    struct work_counts work;
    work_count(request->server->work, request->principal->name, &work);
    add_metric(all, "relightd_own_work_seconds", "", (double)work.own_ns * 1e-9,
               "thread-seconds of the asker's work since it was last idle for long", "gauge");
    request_answer(request, &all->answer.base, NULL);
    for (size_t i = 0; i < all->answer.n_metrics; i++) {
        free(all->metric[i]->name);
        free(all->metric[i]);
    }
    free(all);
}
