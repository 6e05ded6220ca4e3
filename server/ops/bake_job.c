// SPDX-License-Identifier: MIT
// The bake that a LOAD orders: its recipe, which the queue of bakes keeps over restarts, the
// command of `prt bake` that follows from it, the end of the job, and the disk space that its
// folder takes meanwhile.
#include "ops/load.h"

#include "core/log.h"
#include "prt/bake.h"
#include "store/disk.h"
#include "store/eviction.h"

#include <cjson/cJSON.h>
#include <dirent.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const uint64_t measure_gap_ns = 2000000000;
static const uint64_t least_room = 64 << 20; // a checkpoint with less is not worth its writing

struct baking {
    struct file_task task; // first: measuring the folder
    struct loop_timer timer;
    struct model *model; // NULL: the job has ended while the folder was measured
    struct server *server;
    char folder[PATH_MAX], owner[96];
    uint64_t charged, measured; // bytes on disk
    bool measuring;
};

// ---- the recipe

static void print_version(char out[64])
{
    snprintf(out, 64, "bake %d, file %d", PRT_BAKE_VERSION, PRT_FILE_VERSION);
}

static void add_strings(cJSON *json, const char *key, char *const *text, size_t n)
{
    cJSON *list = cJSON_AddArrayToObject(json, key);
    for (size_t i = 0; i < n; i++) cJSON_AddItemToArray(list, cJSON_CreateString(text[i]));
}

// JSON from which the command and the preview's order follow, to free().
static char *bake_recipe(const struct load *load)
{
    const Relight__LoadRequest *r = load_message(load);
    char version[64];
    struct load_args args = {0};
    cJSON *json = cJSON_CreateObject();
    print_version(version);
    cJSON_AddStringToObject(json, "version", version);
    cJSON_AddStringToObject(json, "file", load->file[0].name);
    cJSON_AddStringToObject(json, "name", load->name);
    cJSON_AddNumberToObject(json, "size_mm", (double)r->size_mm);
    cJSON_AddNumberToObject(json, "mm_per_unit", (double)r->mm_per_unit);
    cJSON_AddBoolToObject(json, "up_z", r->up_z);
    cJSON_AddBoolToObject(json, "flip_v", r->flip_v);
    cJSON_AddStringToObject(json, "variant", r->variant);
    add_strings(json, "opaque", r->opaque, r->n_opaque);
    for (unsigned i = 0; i < load->n_material; i++)
        load_add_arg(&args, "--material=%s", load->material[i].arg);
    load_add_settings(&args, r);
    if (!strncmp(load->env, "env:", 4)) load_add_arg(&args, "--env=.environment");
    else if (load->env[0]) load_add_arg(&args, "--env=%s", load->env);
    add_strings(json, "args", args.argv, args.n);
    for (size_t i = 0; i < args.n; i++) free(args.argv[i]);
    if (load_wants_draft(load)) {
        args.n = 0;
        load_add_draft(&args, load);
        add_strings(json, "draft", args.argv, args.n);
        for (size_t i = 0; i < args.n; i++) free(args.argv[i]);
    }
    cJSON_AddBoolToObject(json, "no_single", r->bake && r->bake->no_single);
    cJSON_AddBoolToObject(json, "joint", load_is_joint(load));
    cJSON_AddNumberToObject(json, "samples", r->bake ? r->bake->samples : 0);
    char *text = cJSON_PrintUnformatted(json);
    cJSON_Delete(json);
    return text;
}

static const char *text_of(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

static float number_of(const cJSON *json, const char *key)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, key);
    return cJSON_IsNumber(item) ? (float)item->valuedouble : 0;
}

// ---- the draft

#define DRAFT_FILE ".draft.prt" // in the bake's folder, with which it goes

static void draft_path(const char *folder, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%.*s/" DRAFT_FILE, PATH_MAX - 16, folder);
}

static void take_draft(struct model *m, const char *folder, const char *recipe)
{
    int code;
    char path[PATH_MAX], error[256];
    cJSON *json = cJSON_Parse(recipe);
    draft_path(folder, path);
    model_take_draft(m, path,
                     !cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "no_single")));
    cJSON_Delete(json);
    // Opened at once: watchers request pictures next.
    if (model_answering(m) != m) cache_release(model_open(m, &code, error));
}

static void drafted(void *user, struct job *job)
{
    struct baking *b = user;
    if (b->model->gone) return;
    take_draft(b->model, b->folder, job_recipe(job));
    model_changed(b->model);
}

// ---- the command

// Disk space that the finished work of this bake may take; 0: none is kept.
static uint64_t checkpoint_room(struct server *server)
{
    uint64_t room = server->options.bake_checkpoint, disk = server->options.disk;
    uint64_t used = disk_bytes(server->ledger), left = used < disk ? disk - used : 0;
    if (!disk) left = UINT64_MAX;         // no limit
    if (server->data_temporary) return 0; // nothing survives the daemon
    if (room > left) room = left;
    return room < least_room ? 0 : room;
}

// `prt bake` with the options that any bake has; out is written last, and whole.
static void begin_command(struct load_args *c, const struct options *o, const cJSON *recipe)
{
    load_add_arg(c, "bake");
    load_add_arg(c, "./%s", text_of(recipe, "file"));
    load_add_arg(c, "--progress-fd");
    load_add_arg(c, "{progress}");
    load_add_arg(c, "--quiet");
    load_add_arg(c, "--memory=%llu", (unsigned long long)o->bake_memory);
    if (o->bake_threads) load_add_arg(c, "--threads=%u", o->bake_threads);
}

// With the recipe's arguments of this key; NULL where it has none, or without memory.
static char **end_command(struct load_args *c, const cJSON *recipe, const char *key)
{
    const cJSON *arg, *args = cJSON_GetObjectItemCaseSensitive(recipe, key);
    char **argv = calloc(MAX_ARGS + 1, sizeof *argv);
    cJSON_ArrayForEach(arg, args) if (cJSON_IsString(arg))
        load_add_arg(c, "%s", arg->valuestring);
    if (argv && args) {
        memcpy(argv, c->argv, c->n * sizeof *argv);
        return argv;
    }
    for (size_t i = 0; i < c->n; i++) free(c->argv[i]);
    free(argv);
    return NULL;
}

// Paths are relative to the folder of the bake, so that DATA may be moved between two starts.
static struct job_order bake_order(struct server *server, const char *id, const char *folder,
                                   const cJSON *recipe)
{
    const struct options *o = &server->options;
    struct load_args c = {0}, draft = {0};
    uint64_t room = checkpoint_room(server);
    char path[PATH_MAX];
    begin_command(&c, o, recipe);
    load_add_arg(&c, "-o");
    load_add_arg(&c, "../../bakes/%s.prt", id);
    if (room) {
        load_add_arg(&c, "--checkpoint=.checkpoint");
        load_add_arg(&c, "--checkpoint-room=%llu", (unsigned long long)room);
    }
    if (o->bake_cache && !server->data_temporary && strcmp(o->runner, "slurm")) {
        load_add_arg(&c, "--cache=../../rays");
        load_add_arg(&c, "--cache-room=%llu", (unsigned long long)o->bake_cache);
    }
    struct job_order order = {.argv = end_command(&c, recipe, "args"), .cwd = strdup(folder)};
    order.kind = (struct pace_kind){
        .joint = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(recipe, "joint")),
        .single = !cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(recipe, "no_single")),
        .n_sample = (uint32_t)number_of(recipe, "samples")};
    draft_path(folder, path);
    if (!access(path, F_OK)) return order; // made before a restart
    begin_command(&draft, o, recipe);
    load_add_arg(&draft, "-o");
    load_add_arg(&draft, DRAFT_FILE);
    order.draft = end_command(&draft, recipe, "draft");
    order.drafted = drafted;
    order.kind.draft = order.draft != NULL;
    return order;
}

// ---- the disk space of its folder

// Blocks of the files that have no other link: a link to an upload is charged as that.
static uint64_t folder_bytes(const char *path)
{
    uint64_t bytes = 0;
    DIR *dir = opendir(path);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        struct stat st;
        if (!fstatat(dirfd(dir), d->d_name, &st, AT_SYMLINK_NOFOLLOW) && S_ISREG(st.st_mode) &&
            st.st_nlink == 1)
            bytes += (uint64_t)st.st_blocks * 512;
    }
    if (dir) closedir(dir);
    return bytes;
}

static int run_measure(struct file_task *task)
{
    struct baking *b = (struct baking *)task;
    b->measured = folder_bytes(b->folder);
    return PRT_OK;
}

static void charge_folder(struct baking *b, uint64_t bytes)
{
    disk_charge(b->server->ledger, b->owner, (int64_t)bytes - (int64_t)b->charged);
    b->charged = bytes;
}

static void measure_later(struct baking *b)
{
    loop_timer_set(b->server->loop, &b->timer, loop_now_ns() + measure_gap_ns);
}

static void measure_done(struct file_task *task)
{
    struct baking *b = (struct baking *)task;
    b->measuring = false;
    if (!b->model) {
        free(b);
        return;
    }
    if (b->model->job && b->model->facts.known)
        job_set_vertices(b->model->job, b->model->facts.n_vertex);
    uint64_t before = b->charged;
    charge_folder(b, b->measured);
    if (b->charged > before) evict_for_room(b->server, NULL, NULL);
    measure_later(b);
}

static void measure(struct loop_timer *timer)
{
    struct baking *b = (struct baking *)((char *)timer - offsetof(struct baking, timer));
    b->measuring = true;
    b->task.run = run_measure;
    b->task.done = measure_done;
    file_queue_add(b->server->file_queue, &b->task);
}

static void drop_baking(struct baking *b)
{
    struct model *m = b->model;
    loop_timer_stop(b->server->loop, &b->timer);
    charge_folder(b, 0);
    b->model = NULL;
    if (!b->measuring) free(b);
    model_release(m);
}

static struct baking *new_baking(struct model *m, const char *owner, const char *folder)
{
    struct baking *b = calloc(1, sizeof *b);
    if (!b) return NULL;
    b->server = m->server;
    b->model = m;
    model_hold(m);
    snprintf(b->folder, sizeof b->folder, "%s", folder);
    snprintf(b->owner, sizeof b->owner, "%s", owner);
    b->timer.fire = measure;
    measure_later(b);
    return b;
}

// ---- the job's end

static void give_job_back(struct server *server, const char *owner)
{
    struct principal *p = ledger_principal(server->ledger, owner);
    if (!p) return;
    if (p->held[LEDGER_JOBS]) ledger_give(p, LEDGER_JOBS, 1);
    principal_release(p);
}

static void baked(struct model *m)
{
    int code;
    char error[256];
    model_set_state(m, RELIGHT__MODEL_STATE__MODEL_READY);
    model_drop_draft(m);
    model_remember(m);
    // Opened at once: watchers request colours next, and opening determines the file's size.
    cache_release(model_open(m, &code, error));
    preview_remove(m);
}

static void not_baked(struct model *m, int code, const char *error)
{
    m->error_code = code;
    model_drop_draft(m);
    snprintf(m->error, sizeof m->error, "%s", error);
    model_set_state(m, RELIGHT__MODEL_STATE__MODEL_FAILED);
}

static void bake_ended(void *user, struct job *job, enum job_outcome outcome)
{
    struct baking *b = user;
    struct model *m = b->model;
    struct server *server = m->server;
    char path[PATH_MAX];
    give_job_back(server, b->owner);
    m->job = NULL;
    if (outcome == JOB_OUT_SUSPENDED) { // its folder stays
        drop_baking(b);
        return;
    }
    model_bake_path(server, m->id, path);
    if (job_warnings(job)[0]) {
        free(m->warnings);
        m->warnings = strdup(job_warnings(job));
    }
    if (m->gone) {
        if (model_is_last(m)) file_remove(server->file_queue, path);
    } else if (outcome == JOB_OUT_DONE) {
        baked(m);
    } else {
        not_baked(m,
                  outcome == JOB_OUT_CANCELLED ? RELIGHT__ERROR_CODE__ERROR_CANCELLED
                                               : RELIGHT__ERROR_CODE__ERROR_JOB_FAILED,
                  job_error(job)[0] ? job_error(job) : "the bake wrote no file");
    }
    if (!m->gone) model_changed(m);
    drop_baking(b);
}

// ---- its beginning

int load_order_bake(struct load *load, struct model *m, char error[256])
{
    struct server *server = load->server;
    char *text = bake_recipe(load);
    cJSON *recipe = text ? cJSON_Parse(text) : NULL;
    struct baking *b = recipe ? new_baking(m, load->owner, load->bake_folder) : NULL;
    struct job *job = NULL;
    int code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    snprintf(error, 256, "not enough memory");
    if (!b) goto done;
    if (ledger_take(load->request->conn->principal, LEDGER_JOBS, 1, error)) {
        code = RELIGHT__ERROR_CODE__ERROR_BUSY;
        drop_baking(b);
        goto done;
    }
    struct job_order order = bake_order(server, m->id, b->folder, recipe);
    const struct job_origin origin = {m->id, b->owner, text, load_file_part(b->folder)};
    m->error[0] = m->job_id[0] = 0;
    model_set_state(m, RELIGHT__MODEL_STATE__MODEL_BAKING);
    m->checked = false;
    m->job = NULL;
    model_remember(m); // before the job, whose record stands for nothing without it
    job = jobs_add(server->jobs, &origin, &order, bake_ended, b);
    if (!job) {
        if (jobs_full(server->jobs)) {
            code = RELIGHT__ERROR_CODE__ERROR_BUSY;
            snprintf(error, 256, "%llu bakes wait already (--bake-queue)",
                     (unsigned long long)server->options.bake_queue);
        }
        give_job_back(server, b->owner);
        drop_baking(b);
        goto done;
    }
    snprintf(m->job_id, sizeof m->job_id, "%s", job_id(job));
    // One that could not be started has ended already.
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING) m->job = job;
done:
    cJSON_Delete(recipe);
    free(text);
    return job ? 0 : code;
}

// ---- after a restart

static void resume_preview(struct model *m, const char *folder, const cJSON *recipe)
{
    char path[PATH_MAX + 256];
    char *opaque[MAX_OPAQUE], *material[MATERIAL_TEXTS];
    size_t n = 0, n_material = 0;
    const cJSON *name;
    if (m->mesh == MESH_THERE) return;
    cJSON_ArrayForEach(name, cJSON_GetObjectItemCaseSensitive(
                                 recipe, "opaque")) if (cJSON_IsString(name) && n < MAX_OPAQUE)
        opaque[n++] = name->valuestring;
    cJSON_ArrayForEach(name, cJSON_GetObjectItemCaseSensitive(recipe, "args"))
    {
        const char *text = cJSON_GetStringValue(name);
        if (text && !strncmp(text, "--material=", 11) && n_material < MATERIAL_TEXTS &&
            (material[n_material] = load_material_path(text + 11, folder)))
            n_material++;
    }
    snprintf(path, sizeof path, "%s/%s", folder, text_of(recipe, "file"));
    struct decode_model order = {
        .path = path,
        .name = m->name,
        .size_mm = (double)number_of(recipe, "size_mm"),
        .mm_per_unit = (double)number_of(recipe, "mm_per_unit"),
        .up_z = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(recipe, "up_z")),
        .flip_v = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(recipe, "flip_v")),
        .variant = text_of(recipe, "variant"),
        .n_material = n_material,
        .material = material,
        .n_opaque = n,
        .opaque = opaque};
    preview_start(m, &order, "");
    while (n_material) free(material[--n_material]);
}

// Why the job cannot go on; NULL: it can.
static const char *obstacle(const struct model *m, const char *folder, const cJSON *recipe)
{
    char version[64], path[PATH_MAX + 256];
    struct stat st;
    print_version(version);
    snprintf(path, sizeof path, "%s/%s", folder, text_of(recipe, "file"));
    if (!m) return "its model was forgotten: load it again";
    if (strcmp(text_of(recipe, "version"), version))
        return "the baker has another version by now: load the model again";
    if (!load_safe_name(text_of(recipe, "file")) || stat(path, &st))
        return "its files were lost while the daemon was down: load the model again";
    return NULL;
}

static void resume(struct models *models, struct server *server, struct job *job)
{
    char folder[PATH_MAX];
    struct model *m = models_get(models, job_model(job));
    cJSON *recipe = cJSON_Parse(job_recipe(job));
    snprintf(folder, sizeof folder, "%s/work/%s", server->data, job_folder(job));
    const char *error = obstacle(m, folder, recipe);
    bool ready = m && m->state == RELIGHT__MODEL_STATE__MODEL_READY; // only its end was missed
    struct principal *p = ledger_principal(server->ledger, job_owner(job));
    struct baking *b = !ready && !error && p ? new_baking(m, job_owner(job), folder) : NULL;
    if (!b && !ready && !error) error = "not enough memory";
    if (m) snprintf(m->job_id, sizeof m->job_id, "%s", job_id(job));
    if (b) {
        ledger_force(p, LEDGER_JOBS, 1);
        snprintf(m->key, sizeof m->key, "%s", job_folder(job));
        m->job = job;
        resume_preview(m, folder, recipe);
        struct job_order order = bake_order(server, m->id, folder, recipe);
        take_draft(m, folder, job_recipe(job));
        jobs_resume(server->jobs, job, &order, bake_ended, b, NULL);
    } else {
        file_remove(server->file_queue, folder);
        if (m && !ready) not_baked(m, RELIGHT__ERROR_CODE__ERROR_JOB_FAILED, error);
        jobs_resume(server->jobs, job, NULL, NULL, NULL, ready ? NULL : error);
    }
    principal_release(p);
    cJSON_Delete(recipe);
}

void models_resume_bakes(struct models *models)
{
    struct server *server = models_server(models);
    for (struct job *job; (job = jobs_recalled(server->jobs));) resume(models, server, job);
}
