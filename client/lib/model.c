// SPDX-License-Identifier: MIT
// Models: load, watch, list, info, geometry, vertices, unload; ping, stats, environments.
// Above 600 lines: one function an operation, each read alone.
#include "internal.h"

#include <stdio.h>

static const char *const engine_names[] = {"default",    "reference", "wavelet",
                                           "polynomial", "joint",     "splat",
                                           "tangent",    "texture",   "hybrid"};
static const char *const storage_names[] = {"", "factored", "sparse"};
static const char *const state_names[] = {"unknown", "received", "preview", "baking",
                                          "ready",   "unloaded", "failed"};
enum { N_ENGINE = 9, N_STORAGE = 3, N_STATE = 7 };

const char *relight_engine_name(enum relight_engine engine)
{
    return (unsigned)engine < N_ENGINE ? engine_names[engine] : "unknown";
}

const char *relight_model_state_name(enum relight_model_state state)
{
    return (unsigned)state < N_STATE ? state_names[state] : "unknown";
}

static int no_memory(struct relight_error *error)
{
    return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for an answer");
}

int relight_ping(struct relight_client *client, double *seconds, struct relight_error *error)
{
    Relight__PingRequest m = RELIGHT__PING_REQUEST__INIT;
    struct answer *answer;
    double begin = relight_now_s();
    int status = relight_call(client, RELIGHT_TYPE_PING, &m.base, &answer, error);
    if (status) return status;
    if (seconds) *seconds = relight_now_s() - begin;
    relight_answer_free(answer);
    return 0;
}

int relight_cancel_job(struct relight_client *client, const char *job,
                       enum relight_job_state *state, struct relight_error *error)
{
    Relight__CancelJobRequest m = RELIGHT__CANCEL_JOB_REQUEST__INIT;
    struct answer *answer;
    m.job = relight_text(job);
    int status = relight_call(client, RELIGHT_TYPE_CANCEL_JOB, &m.base, &answer, error);
    if (status) return status;
    if (state)
        *state = (enum relight_job_state)((Relight__CancelJobAnswer *)answer->message)->state;
    relight_answer_free(answer);
    return 0;
}

int relight_unload(struct relight_client *client, const char *model, enum relight_forget forget,
                   uint64_t *freed_bytes, struct relight_error *error)
{
    Relight__UnloadRequest m = RELIGHT__UNLOAD_REQUEST__INIT;
    struct answer *answer;
    m.model = relight_text(model);
    m.forget = forget != RELIGHT_KEEP_BAKE;
    m.force = forget == RELIGHT_FORGET_HELD;
    int status = relight_call(client, RELIGHT_TYPE_UNLOAD, &m.base, &answer, error);
    if (status) return status;
    if (freed_bytes) *freed_bytes = ((Relight__UnloadAnswer *)answer->message)->freed_bytes;
    relight_answer_free(answer);
    return 0;
}

int relight_env_prepare(struct relight_client *client, const char *env,
                        struct relight_env_info *out, struct relight_error *error)
{
    Relight__EnvRequest m = RELIGHT__ENV_REQUEST__INIT;
    struct answer *answer;
    m.env = relight_text(env);
    int status = relight_call(client, RELIGHT_TYPE_ENV, &m.base, &answer, error);
    if (status) return status;
    const Relight__EnvAnswer *a = (Relight__EnvAnswer *)answer->message;
    if (out) {
        *out = (struct relight_env_info){a->cube,     a->width,  a->height,   a->full_cube,
                                         a->n_mended, {0, 0, 0}, a->decode_ms};
        if (a->mean)
            out->mean[0] = a->mean->x, out->mean[1] = a->mean->y, out->mean[2] = a->mean->z;
    }
    relight_answer_free(answer);
    return 0;
}

int relight_stats(struct relight_client *client, struct relight_stats *out,
                  struct relight_error *error)
{
    Relight__StatsRequest m = RELIGHT__STATS_REQUEST__INIT;
    struct answer *answer;
    int status = relight_call(client, RELIGHT_TYPE_STATS, &m.base, &answer, error);
    if (status) return status;
    const Relight__StatsAnswer *a = (Relight__StatsAnswer *)answer->message;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    struct relight_metric *metric = relight_owner_alloc(owner, a->n_metrics, sizeof *metric);
    if (!metric) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    for (size_t i = 0; i < a->n_metrics; i++)
        metric[i] = (struct relight_metric){a->metrics[i]->name, a->metrics[i]->help,
                                            a->metrics[i]->value};
    *out = (struct relight_stats){a->n_metrics, metric, owner};
    return 0;
}

void relight_stats_finish(struct relight_stats *stats)
{
    relight_owner_free(stats->owner);
    *stats = (struct relight_stats){0};
}

static void put_bake(Relight__BakeSettings *m, const struct relight_bake *bake)
{
    relight__bake_settings__init(m);
    m->transport = (Relight__Transport)bake->transport;
    m->storage = (Relight__Storage)bake->storage;
    m->scattering = (Relight__Scattering)bake->scattering;
    m->walks = bake->walks;
    m->samples = bake->samples;
    m->cube = bake->cube;
    m->coeffs = bake->coeffs;
    m->rank = bake->rank;
    m->phase_terms = bake->phase_terms;
    m->single_points = bake->single_points;
    m->no_single = bake->no_single;
    m->exit_planes = bake->exit_planes;
    m->any_eta = bake->any_eta;
    m->max_error = bake->max_error;
    m->seed = bake->seed;
    m->env = relight_text(bake->env);
    m->rotate_deg = bake->rotate_deg;
}

int relight_load(struct relight_client *client, const struct relight_load *load,
                 struct relight_loaded *out, struct relight_error *error)
{
    Relight__LoadRequest m = RELIGHT__LOAD_REQUEST__INIT;
    Relight__BakeSettings bake;
    Relight__ObjectMaterial material[RELIGHT_MAX_MATERIAL], *materials[RELIGHT_MAX_MATERIAL];
    int status =
        relight_put_materials(load->n_material, load->materials, material, materials, error);
    if (status) return status;
    put_bake(&bake, &load->bake);
    Relight__FileRef *ref = calloc(load->n_file + 1, sizeof *ref);
    Relight__FileRef **refs = calloc(load->n_file + 1, sizeof *refs);
    if (!ref || !refs) {
        free(ref);
        free(refs);
        return no_memory(error);
    }
    for (size_t i = 0; i < load->n_file; i++) {
        relight__file_ref__init(ref + i);
        ref[i].name = relight_text(load->files[i].name);
        ref[i].blob = relight_text(load->files[i].hash);
        refs[i] = ref + i;
    }
    m.n_files = load->n_file;
    m.files = refs;
    m.path = relight_text(load->path);
    m.name = relight_text(load->name);
    m.size_mm = load->size_mm;
    m.mm_per_unit = load->mm_per_unit;
    m.material = relight_text(load->material);
    m.n_materials = load->n_material;
    m.materials = materials;
    m.bake = &bake;
    m.n_opaque = load->n_opaque;
    m.opaque = (char **)(uintptr_t)load->opaque;
    m.pin = load->pin;
    m.up_z = load->up_z;
    m.flip_v = load->flip_v;
    m.variant = relight_text(load->variant);
    m.preview = load->preview;
    m.no_draft = load->no_draft;
    struct answer *answer;
    status = relight_call(client, RELIGHT_TYPE_LOAD, &m.base, &answer, error);
    free(ref);
    free(refs);
    if (status) return status;
    const Relight__LoadAnswer *a = (Relight__LoadAnswer *)answer->message;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    *out = (struct relight_loaded){.model = a->model,
                                   .state = (enum relight_model_state)a->state,
                                   .job = a->job,
                                   .n_warning = a->n_warnings,
                                   .warning = (const char *const *)a->warnings,
                                   .owner = owner};
    return 0;
}

void relight_loaded_finish(struct relight_loaded *loaded)
{
    relight_owner_free(loaded->owner);
    *loaded = (struct relight_loaded){0};
}

static int job_end(const Relight__Progress *p, struct relight_error *error)
{
    if (p->state == RELIGHT__JOB_STATE__JOB_DONE) return 0;
    if (p->error) {
        int status = relight_fail_message(error, p->error);
        if (error && p->state == RELIGHT__JOB_STATE__JOB_FAILED)
            error->code = RELIGHT_E_JOB_FAILED;
        return p->state == RELIGHT__JOB_STATE__JOB_FAILED ? -RELIGHT_E_JOB_FAILED : status;
    }
    if (p->state == RELIGHT__JOB_STATE__JOB_NONE)
        return relight_fail(error, RELIGHT_E_NOT_READY, "load it without preview to bake it",
                            "%s: %s", p->model, p->stage);
    if (p->state == RELIGHT__JOB_STATE__JOB_CANCELLED)
        return relight_fail(error, RELIGHT_E_CANCELLED, "", "job %s was cancelled", p->job);
    return relight_fail(error, RELIGHT_E_JOB_FAILED, "", "job %s failed in stage %s", p->job,
                        p->stage);
}

int relight_watch(struct relight_client *client, const char *job, relight_progress_fn fn,
                  void *user, struct relight_error *error)
{
    Relight__WatchRequest m = RELIGHT__WATCH_REQUEST__INIT;
    uint64_t id;
    m.job = relight_text(job);
    int status =
        relight_start(client, RELIGHT_TYPE_WATCH, &m.base, NULL, 0, 0, false, &id, error);
    if (status) return status;
    for (;;) {
        struct answer *answer;
        status = relight_next(client, id, -1, &answer, error);
        if (status) return status;
        bool last = answer->last;
        if (answer->type != (RELIGHT_TYPE_WATCH | RELIGHT_TYPE_ANSWER)) {
            relight_answer_free(answer);
            if (!last) relight_forget(client, id);
            return relight_fail(error, RELIGHT_E_PROTOCOL, "", "unexpected answer to WATCH");
        }
        const Relight__Progress *p = (Relight__Progress *)answer->message;
        struct relight_progress progress = {p->stage, p->fraction, p->eta_s, p->elapsed_s,
                                            (enum relight_job_state)p->state};
        int stop = fn ? fn(user, &progress) : 0;
        if (last) status = job_end(p, error);
        relight_answer_free(answer);
        if (last) return status;
        if (stop) {
            relight_forget(client, id);
            return relight_fail(error, RELIGHT_E_CANCELLED, "", "stopped watching job %s", job);
        }
    }
}

static void get_vec3(const Relight__Vec3 *m, float out[3])
{
    if (m) out[0] = m->x, out[1] = m->y, out[2] = m->z;
}

static void get_model(const Relight__ModelInfo *m, struct relight_model *out)
{
    *out = (struct relight_model){
        .id = m->model,
        .name = m->name,
        .job = m->job,
        .state = (enum relight_model_state)m->state,
        .fraction = m->fraction,
        .n_vertex = m->n_vertex,
        .n_triangle = m->n_triangle,
        .n_object = m->n_object,
        .mm_per_unit = m->mm_per_unit,
        .engine = m->engine ? relight_engine_name((enum relight_engine)m->engine) : "",
        .storage = (unsigned)m->storage < N_STORAGE ? storage_names[m->storage] : "",
        .cube = m->cube,
        .exit_planes = m->exit_planes,
        .bytes = m->bytes,
        .resident_bytes = m->resident_bytes,
        .generation = m->generation,
        .pinned = m->pinned,
        .error_bound = m->error_bound,
        .stale = m->stale,
        .draft = m->draft,
        .material = m->material,
        .settings = m->settings,
        .errors = m->errors,
        .n_warning = m->n_warnings,
        .warning = (const char *const *)m->warnings,
        .n_variant = m->n_variants,
        .variant = (const char *const *)m->variants,
        .failure = m->error ? m->error->text : "",
        .mesh_hash = m->mesh_hash,
        .bake_hash = m->bake_hash};
    get_vec3(m->box_min, out->box_min);
    get_vec3(m->box_max, out->box_max);
}

static int get_cameras(struct owner *owner, const Relight__ModelInfo *a,
                       struct relight_model *out)
{
    struct relight_named_camera *camera =
        relight_owner_alloc(owner, a->n_cameras, sizeof *camera);
    if (!camera) return -1;
    for (size_t i = 0; i < a->n_cameras; i++) {
        const Relight__Camera *c = a->cameras[i]->camera;
        camera[i].name = a->cameras[i]->name;
        if (!c) continue;
        get_vec3(c->eye, camera[i].eye);
        get_vec3(c->target, camera[i].target);
        get_vec3(c->up, camera[i].up);
        camera[i].fovy_deg = c->fovy_deg;
    }
    out->n_camera = a->n_cameras;
    out->camera = camera;
    return 0;
}

int relight_info(struct relight_client *client, const char *model, struct relight_model *out,
                 struct relight_error *error)
{
    Relight__InfoRequest m = RELIGHT__INFO_REQUEST__INIT;
    struct answer *answer;
    m.model = relight_text(model);
    int status = relight_call(client, RELIGHT_TYPE_INFO, &m.base, &answer, error);
    if (status) return status;
    const Relight__ModelInfo *a = (Relight__ModelInfo *)answer->message;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    get_model(a, out);
    out->owner = owner;
    out->n_block = a->n_blocks;
    out->n_medium = a->n_media;
    out->medium = (const char *const *)a->media;
    if (relight_get_blocks(owner, a->n_blocks, a->blocks, &out->block) ||
        get_cameras(owner, a, out)) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    return 0;
}

void relight_model_finish(struct relight_model *model)
{
    relight_owner_free(model->owner);
    *model = (struct relight_model){0};
}

// Moves the models of `more` behind those of `all`.
static bool append_models(Relight__ListAnswer *all, Relight__ListAnswer *more)
{
    size_t n = all->n_models + more->n_models;
    Relight__ModelInfo **models = realloc(all->models, (n + 1) * sizeof *models);
    if (!models) return false;
    all->models = models;
    for (size_t i = 0; i < more->n_models; i++) models[all->n_models++] = more->models[i];
    more->n_models = 0;
    all->next = more->next;
    return true;
}

// One answer with the models of all. The daemon lists a limited number at a time.
static int list_all(struct relight_client *client, bool files, struct answer **out,
                    struct relight_error *error)
{
    Relight__ListRequest m = RELIGHT__LIST_REQUEST__INIT;
    struct answer *more;
    m.files = m.environments = files;
    int status = relight_call(client, RELIGHT_TYPE_LIST, &m.base, out, error);
    if (status) return status;
    Relight__ListAnswer *all = (Relight__ListAnswer *)(*out)->message;
    m.files = m.environments = false;
    for (uint64_t last = 0; all->next && all->next != last;) {
        m.after = last = all->next;
        if (!(status = relight_call(client, RELIGHT_TYPE_LIST, &m.base, &more, error))) {
            if (!append_models(all, (Relight__ListAnswer *)more->message))
                status = no_memory(error);
            relight_answer_free(more);
        }
        if (!status) continue;
        relight_answer_free(*out);
        return status;
    }
    return 0;
}

int relight_list(struct relight_client *client, bool files, struct relight_list *out,
                 struct relight_error *error)
{
    struct answer *answer;
    int status = list_all(client, files, &answer, error);
    if (status) return status;
    const Relight__ListAnswer *a = (Relight__ListAnswer *)answer->message;
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    struct relight_model *model = relight_owner_alloc(owner, a->n_models, sizeof *model);
    const char **name = relight_owner_alloc(owner, a->n_files, sizeof *name);
    uint64_t *bytes = relight_owner_alloc(owner, a->n_files, sizeof *bytes);
    if (!model || !name || !bytes) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    for (size_t i = 0; i < a->n_models; i++) get_model(a->models[i], model + i);
    for (size_t i = 0; i < a->n_files; i++) {
        name[i] = a->files[i]->path;
        bytes[i] = a->files[i]->bytes;
    }
    struct relight_env_entry *env = relight_owner_alloc(owner, a->n_environments, sizeof *env);
    if (!env) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    for (size_t i = 0; i < a->n_environments; i++) {
        const Relight__EnvironmentEntry *e = a->environments[i];
        env[i] = (struct relight_env_entry){e->env, e->name, e->bytes};
    }
    *out = (struct relight_list){.n_model = a->n_models,
                                 .n_file = a->n_files,
                                 .model = model,
                                 .file = name,
                                 .file_bytes = bytes,
                                 .owner = owner,
                                 .n_env = a->n_environments,
                                 .env = env};
    return 0;
}

void relight_list_finish(struct relight_list *list)
{
    relight_owner_free(list->owner);
    *list = (struct relight_list){0};
}

static bool section_fits(uint64_t offset, uint64_t n, uint64_t payload_size)
{
    return offset % RELIGHT_FRAME_ALIGN == 0 && offset <= payload_size &&
           n * 12 <= payload_size - offset; // n is 32-bit: no overflow
}

// Checks the payload against the header, and the indices of the triangles.
static bool geometry_fits(const Relight__GeometryAnswer *a, const struct answer *answer)
{
    if (!section_fits(a->positions_offset, a->n_vertex, answer->payload_size) ||
        !section_fits(a->normals_offset, a->n_vertex, answer->payload_size) ||
        !section_fits(a->triangles_offset, a->n_triangle, answer->payload_size))
        return false;
    if (!a->triangles_offset) return true;
    const uint32_t *index = (const uint32_t *)(answer->payload + a->triangles_offset);
    for (uint64_t i = 0; i < (uint64_t)a->n_triangle * 3; i++)
        if (index[i] >= a->n_vertex) return false;
    return true;
}

static int geometry(struct relight_client *client, const char *model, const char *pose,
                    const char *variant, bool own_units, bool textures,
                    struct relight_geometry *out, struct relight_error *error)
{
    Relight__GeometryRequest m = RELIGHT__GEOMETRY_REQUEST__INIT;
    struct answer *answer;
    m.model = relight_text(model);
    m.own_units = own_units;
    m.pose = relight_text(pose);
    m.variant = relight_text(variant);
    m.textures = textures;
    int status = relight_call(client, RELIGHT_TYPE_GEOMETRY, &m.base, &answer, error);
    if (status) return status;
    const Relight__GeometryAnswer *a = (Relight__GeometryAnswer *)answer->message;
    if (!geometry_fits(a, answer) || (textures && !relight_textures_fit(a, answer))) {
        status = relight_fail(error, RELIGHT_E_PROTOCOL, "",
                              "geometry answer: %u vertices and %u triangles do not fit",
                              a->n_vertex, a->n_triangle);
        relight_answer_free(answer);
        return status;
    }
    struct owner *owner = relight_owner(answer);
    if (!owner) return no_memory(error);
    const uint8_t *p = answer->payload;
    struct relight_geometry g = {
        .n_vertex = a->n_vertex,
        .n_triangle = a->triangles_offset ? a->n_triangle : 0,
        .position = (const float(*)[3])(p + a->positions_offset),
        .normal = a->normals_offset ? (const float(*)[3])(p + a->normals_offset) : NULL,
        .triangle =
            a->triangles_offset ? (const uint32_t(*)[3])(p + a->triangles_offset) : NULL,
        .mm_per_unit = a->mm_per_unit,
        .generation = a->generation,
        .n_block = a->n_blocks,
        .n_medium = a->n_media,
        .medium = (const char *const *)a->media,
        .mesh_hash = a->mesh_hash,
        .owner = owner};
    bool good = !textures || relight_get_textures(owner, answer, &g);
    if (!good || relight_get_blocks(owner, a->n_blocks, a->blocks, &g.block)) {
        relight_owner_free(owner);
        return no_memory(error);
    }
    *out = g;
    return 0;
}

int relight_geometry(struct relight_client *client, const char *model, bool own_units,
                     struct relight_geometry *out, struct relight_error *error)
{
    return geometry(client, model, NULL, NULL, own_units, false, out, error);
}

int relight_geometry_variant(struct relight_client *client, const char *model,
                             const char *variant, bool own_units, struct relight_geometry *out,
                             struct relight_error *error)
{
    return geometry(client, model, NULL, variant, own_units, true, out, error);
}

int relight_geometry_textured(struct relight_client *client, const char *model, bool own_units,
                              struct relight_geometry *out, struct relight_error *error)
{
    return geometry(client, model, NULL, NULL, own_units, true, out, error);
}

int relight_geometry_posed(struct relight_client *client, const char *model, const char *pose,
                           bool own_units, struct relight_geometry *out,
                           struct relight_error *error)
{
    return geometry(client, model, pose, NULL, own_units, false, out, error);
}

void relight_geometry_finish(struct relight_geometry *geometry)
{
    relight_owner_free(geometry->owner);
    *geometry = (struct relight_geometry){0};
}

static int update_range(struct relight_client *client, Relight__UpdateVerticesRequest *m,
                        const float *position, const float *normal, uint64_t *generation,
                        struct relight_error *error)
{
    struct iovec piece[2] = {{(void *)(uintptr_t)position, 12 * (size_t)m->n},
                             {(void *)(uintptr_t)normal, 12 * (size_t)m->n}};
    uint64_t id;
    struct answer *answer;
    int status = relight_start(client, RELIGHT_TYPE_UPDATE_VERTICES, &m->base, piece,
                               normal ? 2 : 1, relight_timeout(client), false, &id, error);
    if (!status) status = relight_end(client, id, RELIGHT_TYPE_UPDATE_VERTICES, &answer, error);
    if (status) return status;
    if (generation)
        *generation = ((Relight__UpdateVerticesAnswer *)answer->message)->generation;
    relight_answer_free(answer);
    return 0;
}

int relight_update_vertices(struct relight_client *client, const char *model, uint32_t first,
                            uint32_t n, const float *position, const float *normal,
                            bool own_units, uint64_t *generation, struct relight_error *error)
{
    return relight_update_vertices_if(client, model, 0, first, n, position, normal, own_units,
                                      generation, error);
}

// The largest number of vertices of one request; 0: any.
static uint64_t most_vertices(const struct relight_client *client, bool normals)
{
    return relight_server(client)->max_payload / (normals ? 24 : 12);
}

int relight_update_vertices_if(struct relight_client *client, const char *model,
                               uint64_t if_generation, uint32_t first, uint32_t n,
                               const float *position, const float *normal, bool own_units,
                               uint64_t *generation, struct relight_error *error)
{
    Relight__UpdateVerticesRequest m = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    uint64_t limit = most_vertices(client, normal != NULL), now = 0;
    int status = 0;
    m.model = relight_text(model);
    m.has_normals = normal != NULL;
    m.own_units = own_units;
    m.if_generation = if_generation;
    // Divided so that every request fits the daemon's largest payload.
    for (uint32_t at = 0; !status && (at < n || !n); at += m.n) {
        m.first = first + at;
        m.n = limit && n - at > limit ? (uint32_t)limit : n - at;
        status = update_range(client, &m, position + 3 * (size_t)at,
                              normal ? normal + 3 * (size_t)at : NULL, &now, error);
        if (!status && generation) *generation = now;
        if (if_generation) m.if_generation = now;
        if (!n) break;
    }
    return status;
}

int relight_put_pose(struct relight_client *client, const char *model, const char *base,
                     uint32_t first, uint32_t n, const float *position, const float *normal,
                     bool own_units, char pose[65], struct relight_error *error)
{
    Relight__PutPoseRequest m = RELIGHT__PUT_POSE_REQUEST__INIT;
    uint64_t limit = most_vertices(client, normal != NULL);
    char name[65] = "";
    int status = 0;
    m.model = relight_text(model);
    m.base_pose = relight_text(base);
    m.has_normals = normal != NULL;
    m.own_units = own_units;
    // A pose that does not fit one request is built from the one before.
    for (uint32_t at = 0; !status && (at < n || !n); at += m.n) {
        struct answer *answer;
        uint64_t id;
        m.first = first + at;
        m.n = limit && n - at > limit ? (uint32_t)limit : n - at;
        size_t bytes = (size_t)m.n * 12;
        struct iovec payload[2] = {
            {(void *)(uintptr_t)(position + 3 * (size_t)at), bytes},
            {normal ? (void *)(uintptr_t)(normal + 3 * (size_t)at) : NULL, bytes}};
        status = relight_start(client, RELIGHT_TYPE_PUT_POSE, &m.base, payload,
                               !m.n     ? 0
                               : normal ? 2
                                        : 1,
                               relight_timeout(client), false, &id, error);
        if (!status) status = relight_end(client, id, RELIGHT_TYPE_PUT_POSE, &answer, error);
        if (status) break;
        snprintf(name, sizeof name, "%s", ((Relight__PutPoseAnswer *)answer->message)->pose);
        m.base_pose = name;
        relight_answer_free(answer);
        if (!n) break;
    }
    if (!status) memcpy(pose, name, sizeof name);
    return status;
}
