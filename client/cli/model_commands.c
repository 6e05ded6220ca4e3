// SPDX-License-Identifier: MIT
// Commands about the daemon, its models and its jobs.
#include "cli.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static void add_strings(cJSON *json, const char *key, const char *const *text, size_t n)
{
    cJSON *list = cJSON_AddArrayToObject(json, key);
    for (size_t i = 0; i < n; i++) cJSON_AddItemToArray(list, cJSON_CreateString(text[i]));
}

int run_ping(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    const struct relight_server *server = relight_server(client);
    double seconds;
    if (relight_ping(client, &seconds, &error)) return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "server", server->name);
        cJSON_AddStringToObject(json, "address", server->address);
        add_float(json, "milliseconds", seconds * 1e3);
        cJSON_AddStringToObject(json, "principal", server->principal);
        add_strings(json, "scopes", server->scope, server->n_scope);
        if (server->expires_s)
            cJSON_AddNumberToObject(json, "expires_s", (double)server->expires_s);
        add_strings(json, "materials", server->preset, server->n_preset);
        print_json(json);
    } else {
        printf("%s at %s answers in %.3f ms\nyou are %s:", escape(server->name).text,
               server->address, seconds * 1e3, escape(server->principal).text);
        for (size_t i = 0; i < server->n_scope; i++)
            printf(" %s", escape(server->scope[i]).text);
        printf("\n");
    }
    return EXIT_DONE;
}

// JSON text as JSON, or as a string when it does not parse.
static void add_text(cJSON *json, const char *key, const char *text)
{
    cJSON *value = *text ? cJSON_Parse(text) : cJSON_CreateNull();
    cJSON_AddItemToObject(json, key, value ? value : cJSON_CreateString(text));
}

static cJSON *model_json(const struct relight_model *m)
{
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "model", m->id);
    cJSON_AddStringToObject(json, "name", m->name);
    cJSON_AddStringToObject(json, "state", relight_model_state_name(m->state));
    if (*m->job) cJSON_AddStringToObject(json, "job", m->job);
    if (m->state == RELIGHT_MODEL_BAKING) add_float(json, "fraction", m->fraction);
    if (*m->failure) cJSON_AddStringToObject(json, "failure", m->failure);
    cJSON_AddNumberToObject(json, "vertices", m->n_vertex);
    cJSON_AddNumberToObject(json, "triangles", m->n_triangle);
    cJSON_AddNumberToObject(json, "objects", m->n_object);
    add_float(json, "mm_per_unit", m->mm_per_unit);
    add_floats(json, "box_min_mm", m->box_min);
    add_floats(json, "box_max_mm", m->box_max);
    cJSON_AddStringToObject(json, "engine", m->engine);
    cJSON_AddStringToObject(json, "storage", m->storage);
    cJSON_AddNumberToObject(json, "cube", m->cube);
    cJSON_AddNumberToObject(json, "bytes", (double)m->bytes);
    cJSON_AddNumberToObject(json, "resident_bytes", (double)m->resident_bytes);
    cJSON_AddNumberToObject(json, "generation", (double)m->generation);
    cJSON_AddBoolToObject(json, "pinned", m->pinned);
    add_float(json, "error_bound", m->error_bound);
    cJSON_AddBoolToObject(json, "stale", m->stale);
    cJSON_AddBoolToObject(json, "draft", m->draft);
    return json;
}

int run_models(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_list list;
    if (relight_list(client, options->files, &list, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject(), *models = cJSON_AddArrayToObject(json, "models");
        for (size_t i = 0; i < list.n_model; i++)
            cJSON_AddItemToArray(models, model_json(list.model + i));
        if (options->files) {
            cJSON *files = cJSON_AddArrayToObject(json, "files");
            for (size_t i = 0; i < list.n_file; i++) {
                cJSON *file = cJSON_CreateObject();
                cJSON_AddStringToObject(file, "path", list.file[i]);
                cJSON_AddNumberToObject(file, "bytes", (double)list.file_bytes[i]);
                cJSON_AddItemToArray(files, file);
            }
        }
        if (options->files) {
            cJSON *envs = cJSON_AddArrayToObject(json, "environments");
            for (size_t i = 0; i < list.n_env; i++) {
                cJSON *env = cJSON_CreateObject();
                cJSON_AddStringToObject(env, "env", list.env[i].env);
                cJSON_AddStringToObject(env, "name", list.env[i].name);
                cJSON_AddNumberToObject(env, "bytes", (double)list.env[i].bytes);
                cJSON_AddItemToArray(envs, env);
            }
        }
        print_json(json);
    } else {
        if (list.n_model)
            printf("%-18s %-9s %10s %9s  %s\n", "model", "state", "vertices", "MB", "name");
        for (size_t i = 0; i < list.n_model; i++) {
            const struct relight_model *m = list.model + i;
            char state[32];
            snprintf(state, sizeof state, m->state == RELIGHT_MODEL_BAKING ? "%s %.0f%%" : "%s",
                     relight_model_state_name(m->state), 100 * m->fraction);
            printf("%-18.16s %-9s %10u %9.1f  %s\n", escape(m->id).text, state, m->n_vertex,
                   (double)m->bytes * 1e-6, escape(m->name).text);
        }
        for (size_t i = 0; i < list.n_file; i++)
            printf("%12llu  %s\n", (unsigned long long)list.file_bytes[i],
                   escape(list.file[i]).text);
        for (size_t i = 0; i < list.n_env; i++)
            printf("%12llu  %s  %s\n", (unsigned long long)list.env[i].bytes,
                   escape(list.env[i].env).text, escape(list.env[i].name).text);
    }
    relight_list_finish(&list);
    return EXIT_DONE;
}

static void print_line(const char *label, const char *text)
{
    if (!*text) return;
    printf("  %s: ", label);
    print_text(stdout, text);
    putchar('\n');
}

// Takes out what only a program reads: arrays of more than 32 values, such as an error for each
// of 200 vertices, and objects that hold nothing else.
static void remove_long_arrays(cJSON *json)
{
    for (cJSON *c = json->child, *next; c; c = next) {
        next = c->next;
        bool object = cJSON_IsObject(c);
        if (object) remove_long_arrays(c);
        if (object ? !c->child : cJSON_IsArray(c) && cJSON_GetArraySize(c) > 32)
            cJSON_Delete(cJSON_DetachItemViaPointer(json, c));
    }
}

static void print_errors(const struct relight_model *m)
{
    cJSON *json = cJSON_Parse(m->errors);
    if (json) remove_long_arrays(json);
    char *text = json ? cJSON_PrintUnformatted(json) : NULL;
    print_line("errors", text ? text : m->errors);
    free(text);
    cJSON_Delete(json);
}

static void print_block(const struct relight_block *b, bool several)
{
    printf("  block: object %u, %u vertices, %u triangles, %s %s", b->object, b->n_vertex,
           b->n_triangle, b->translucent ? "translucent" : "opaque", escape(b->surface).text);
    if (*b->node) printf(" of node %s", escape(b->node).text);
    if (several && b->translucent) printf(", material %u", b->medium);
    putchar('\n');
}

// The material of a model of one; those of one with several, numbered as its blocks name them.
static void print_media(const struct relight_model *m)
{
    char label[32];
    if (m->n_medium < 2) print_line("material", m->material);
    for (size_t i = 0; m->n_medium > 1 && i < m->n_medium; i++) {
        snprintf(label, sizeof label, "material %zu", i);
        print_line(label, m->medium[i]);
    }
}

static void add_cameras(cJSON *json, const struct relight_model *m)
{
    cJSON *cameras = cJSON_AddArrayToObject(json, "cameras");
    for (size_t i = 0; i < m->n_camera; i++) {
        const struct relight_named_camera *c = m->camera + i;
        cJSON *camera = cJSON_CreateObject();
        cJSON_AddStringToObject(camera, "name", c->name);
        add_floats(camera, "eye", c->eye);
        add_floats(camera, "target", c->target);
        add_floats(camera, "up", c->up);
        add_float(camera, "fovy_deg", c->fovy_deg);
        cJSON_AddItemToArray(cameras, camera);
    }
}

int run_info(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_model m;
    if (relight_info(client, options->target, &m, &error)) return report_error(options, &error);
    if (options->json) {
        cJSON *json = model_json(&m);
        add_text(json, "material", m.material);
        cJSON *media = cJSON_AddArrayToObject(json, "media");
        for (size_t i = 0; i < m.n_medium; i++) {
            cJSON *medium = cJSON_Parse(m.medium[i]);
            cJSON_AddItemToArray(media, medium ? medium : cJSON_CreateNull());
        }
        cJSON_AddStringToObject(json, "mesh_hash", m.mesh_hash);
        cJSON_AddStringToObject(json, "bake_hash", m.bake_hash);
        add_text(json, "settings", m.settings);
        add_text(json, "errors", m.errors);
        add_strings(json, "warnings", m.warning, m.n_warning);
        cJSON *blocks = cJSON_AddArrayToObject(json, "blocks");
        for (size_t i = 0; i < m.n_block; i++) {
            const struct relight_block *b = m.block + i;
            cJSON *block = cJSON_CreateObject();
            cJSON_AddNumberToObject(block, "object", b->object);
            cJSON_AddStringToObject(block, "surface", b->surface);
            if (*b->node) cJSON_AddStringToObject(block, "node", b->node);
            cJSON_AddBoolToObject(block, "translucent", b->translucent);
            if (b->translucent) cJSON_AddNumberToObject(block, "medium", b->medium);
            cJSON_AddNumberToObject(block, "vertex_begin", b->vertex_begin);
            cJSON_AddNumberToObject(block, "n_vertex", b->n_vertex);
            cJSON_AddNumberToObject(block, "triangle_begin", b->triangle_begin);
            cJSON_AddNumberToObject(block, "n_triangle", b->n_triangle);
            cJSON_AddItemToArray(blocks, block);
        }
        add_cameras(json, &m);
        add_strings(json, "variants", m.variant, m.n_variant);
        print_json(json);
    } else {
        printf("%s  %s\n  state: %s", escape(m.id).text, escape(m.name).text,
               relight_model_state_name(m.state));
        if (m.state == RELIGHT_MODEL_BAKING)
            printf(" (%.0f %%, job %s%s)", 100 * m.fraction, escape(m.job).text,
                   m.draft ? "; a draft answers" : "");
        if (*m.failure) printf(": %s", escape(m.failure).text);
        if (m.stale) printf(", stale: vertices moved since the bake");
        printf("\n  geometry: %u vertices, %u triangles, %u objects, %.6g mm a unit, "
               "%.4g x %.4g x %.4g mm\n",
               m.n_vertex, m.n_triangle, m.n_object, m.mm_per_unit,
               (double)(m.box_max[0] - m.box_min[0]), (double)(m.box_max[1] - m.box_min[1]),
               (double)(m.box_max[2] - m.box_min[2]));
        if (*m.engine)
            printf(
                "  transport: %s %s, 6x%ux%u; with mesh and images %.2f MB, %.2f MB in memory\n",
                escape(m.storage).text, escape(m.engine).text, m.cube, m.cube,
                (double)m.bytes * 1e-6, (double)m.resident_bytes * 1e-6);
        if (m.error_bound > 0)
            printf("  measured relative RMSE: %.3g %%\n", 100 * m.error_bound);
        print_media(&m);
        print_line("settings", m.settings);
        print_errors(&m);
        for (size_t i = 0; i < m.n_block; i++) print_block(m.block + i, m.n_medium > 1);
        for (size_t i = 0; i < m.n_camera; i++) print_line("camera", m.camera[i].name);
        for (size_t i = 0; i < m.n_variant; i++) print_line("variant", m.variant[i]);
        for (size_t i = 0; i < m.n_warning; i++) print_line("warning", m.warning[i]);
    }
    relight_model_finish(&m);
    return EXIT_DONE;
}

int run_load(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_loaded loaded;
    struct relight_load *load = &options->load;
    char env[80];
    if (load->size_mm > 0 && load->mm_per_unit > 0)
        return report_usage(options, "--size-mm and --mm-per-unit exclude each other");
    // OBJ, PLY and STL have no unit of length: refused here, before the upload.
    const char *dot = strrchr(options->target, '.');
    bool unitless = dot && (!strcasecmp(dot, ".obj") || !strcasecmp(dot, ".ply") ||
                            !strcasecmp(dot, ".stl"));
    if (unitless && !(load->size_mm > 0) && !(load->mm_per_unit > 0))
        return report_usage(options,
                            "%s has no unit of length: give --size-mm or --mm-per-unit",
                            options->target);
    bool here = !options->remote && !access(options->target, F_OK);
    if (here && dot && !strcasecmp(dot, ".prt"))
        return report_usage(options,
                            "%s: a .prt is not uploaded, the daemon maps only files of its "
                            "own: put it into its models folder and add --remote",
                            options->target);
    if (options->n_env > 1) return report_usage(options, "one --env at most");
    if (options->n_rotate > options->n_env)
        return report_usage(options, "--rotate is for --env: one for it at most");
    if (options->n_env) {
        if (relight_env_resolve(client, options->env[0], progress_bar, NULL, env, &error))
            return report_error(options, &error);
        load->bake.env = env;
        load->bake.rotate_deg = options->rotate_deg[0];
    }
    int status;
    if (!here) {
        load->path = options->target;
        status = relight_load(client, load, &loaded, &error);
    } else {
        status = relight_load_file(client, options->target, load, progress_bar, NULL, &loaded,
                                   &error);
    }
    if (status) return report_error(options, &error);
    progress_clear();
    for (size_t i = 0; i < loaded.n_warning; i++)
        fprintf(stderr, "relight: %s\n", escape(loaded.warning[i]).text);
    if (options->wait && *loaded.job) {
        status = relight_watch(client, loaded.job, progress_bar, NULL, &error);
        progress_clear();
        loaded.state = status ? RELIGHT_MODEL_FAILED : RELIGHT_MODEL_READY;
    }
    if (options->json && !status) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "model", loaded.model);
        cJSON_AddStringToObject(json, "state", relight_model_state_name(loaded.state));
        if (*loaded.job) cJSON_AddStringToObject(json, "job", loaded.job);
        print_json(json);
    } else if (!status) {
        printf("%s %s%s%s\n", escape(loaded.model).text, relight_model_state_name(loaded.state),
               *loaded.job && !options->wait ? " job " : "",
               options->wait ? "" : escape(loaded.job).text);
    }
    relight_loaded_finish(&loaded);
    return status ? report_error(options, &error) : EXIT_DONE;
}

static const char *const job_names[] = {"queued", "running",   "done",
                                        "failed", "cancelled", "none"};

const char *job_name(enum relight_job_state state)
{
    return (unsigned)state < 6 ? job_names[state] : "unknown";
}

static int progress_line(void *user, const struct relight_progress *p)
{
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "state", job_name(p->state));
    cJSON_AddStringToObject(json, "stage", p->stage);
    add_float(json, "fraction", p->fraction);
    if (p->eta_s >= 0) add_float(json, "eta_s", p->eta_s);
    add_float(json, "elapsed_s", p->elapsed_s);
    print_json(json);
    fflush(stdout);
    return 0;
}

int run_watch(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    int status = relight_watch(client, options->target,
                               options->json ? progress_line : progress_bar, NULL, &error);
    progress_clear();
    if (status) return report_error(options, &error);
    if (!options->json) puts("done");
    return EXIT_DONE;
}

int run_cancel(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    enum relight_job_state state;
    if (relight_cancel_job(client, options->target, &state, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "state", job_name(state));
        print_json(json);
    } else {
        puts(job_name(state));
    }
    return EXIT_DONE;
}

int run_update(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    float *position = NULL, *normal = NULL;
    uint32_t n = 0, n_normal = 0;
    uint64_t generation = 0;
    if (!options->positions) return report_usage(options, "--positions is missing");
    int status = read_npy(options, options->positions, &n, &position);
    if (!status && options->normals)
        status = read_npy(options, options->normals, &n_normal, &normal);
    if (!status && normal && n_normal != n) {
        status = report_usage(options, "%u positions and %u normals", n, n_normal);
    } else if (!status &&
               relight_update_vertices(client, options->target, options->first, n, position,
                                       normal, options->own_units, &generation, &error)) {
        status = report_error(options, &error);
    }
    free(position);
    free(normal);
    if (status) return status;
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "vertices", n);
        cJSON_AddNumberToObject(json, "generation", (double)generation);
        print_json(json);
    } else {
        printf("%u vertices, generation %llu\n", n, (unsigned long long)generation);
    }
    return EXIT_DONE;
}

int run_pose(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    char pose[65];
    if (options->n_word != 1)
        return report_usage(options,
                            "FILE is missing: the glTF that the model was loaded from");
    if (!options->animation) return report_usage(options, "--animation is missing");
    if (relight_put_animation(client, options->target, options->words[0], options->animation,
                              (double)options->animation_time, options->load.up_z, pose,
                              &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddStringToObject(json, "pose", pose);
        print_json(json);
    } else {
        puts(pose);
    }
    return EXIT_DONE;
}

int run_unload(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    uint64_t freed;
    if (options->force && !options->forget)
        return report_usage(options, "--force is for --forget");
    enum relight_forget forget = options->force    ? RELIGHT_FORGET_HELD
                                 : options->forget ? RELIGHT_FORGET
                                                   : RELIGHT_KEEP_BAKE;
    if (relight_unload(client, options->target, forget, &freed, &error))
        return report_error(options, &error);
    if (options->json) {
        cJSON *json = cJSON_CreateObject();
        cJSON_AddNumberToObject(json, "freed_bytes", (double)freed);
        print_json(json);
    } else {
        printf("%llu bytes freed\n", (unsigned long long)freed);
    }
    return EXIT_DONE;
}

int run_stats(struct relight_client *client, struct options *options)
{
    struct relight_error error;
    struct relight_stats stats;
    if (relight_stats(client, &stats, &error)) return report_error(options, &error);
    cJSON *json = cJSON_CreateObject();
    for (size_t i = 0; i < stats.n_metric; i++) {
        if (options->json)
            cJSON_AddNumberToObject(json, stats.metric[i].name, stats.metric[i].value);
        else printf("%-44s %.15g\n", escape(stats.metric[i].name).text, stats.metric[i].value);
    }
    if (options->json) print_json(json);
    else cJSON_Delete(json);
    relight_stats_finish(&stats);
    return EXIT_DONE;
}
