// SPDX-License-Identifier: MIT
// prt compare A.prt reference, as a table of media and lights, each against brute force. All
// media share the reference's rays under a light, so a table costs little more than a row.
#include "tool.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_MEDIA = 32, TABLE_SAMPLES = 120000, TABLE_RAYS = 1024 };

struct table {
    struct tool *tool;
    struct source source;
    unsigned n_media, n_light, n;                // n: vertices
    struct prt_material *media;                  // [MAX_MEDIA]
    struct prt_media set[MAX_MEDIA];             // the media of a row's objects
    struct prt_cube own[MAX_ENV], seen[MAX_ENV]; // the bake's resolution, the reference's
    uint32_t *vertex;
    float *want, *got;       // [n_media][n_light][n][3]
    float *again;            // another reference, of walks, whose noise is its own; else NULL
    double bound[MAX_MEDIA]; // error of the radial basis, added to that of the bake
    double error[MAX_MEDIA][MAX_ENV];
    double spacing_mm; // of the bake's samples; 0: unknown
};

static double path_mm(const struct prt_material *m)
{
    double finest = INFINITY;
    for (int c = 0; c < 3; c++)
        finest = fmin(finest, 1 / ((double)m->sigma_s_prime[c] + (double)m->sigma_a[c]));
    return finest;
}

// Media whose mean free path the bake's samples do not resolve are listed and not counted.
static bool judged(const struct table *t, unsigned m)
{
    return path_mm(&t->media[m]) >= t->spacing_mm;
}

static int add_medium(struct table *t, const struct prt_material *m)
{
    if (t->n_media == MAX_MEDIA)
        return usage_error(&t->tool->opt, "--materials: at most %d", MAX_MEDIA);
    t->media[t->n_media] = *m;
    t->set[t->n_media] = prt_media_one(&t->media[t->n_media]);
    t->n_media++;
    return EXIT_DONE;
}

// Whether the bake serves media of this eta.
static bool serves(const struct table *t, float eta)
{
    float range[2];
    if (prt_transport_any_eta(t->source.transport, range))
        return eta >= range[0] && eta <= range[1];
    return fabsf(eta - t->source.media.medium[0].eta) < 1e-6f;
}

// The measured media whose eta the bake serves.
static int add_measured(struct table *t)
{
    const struct prt_material *m;
    int status = EXIT_DONE;
    for (unsigned i = 0; !status && (m = prt_material_preset(i)); i++)
        if (serves(t, m->eta)) status = add_medium(t, m);
    return status;
}

// Grey media at both ends of the range of METHODS.
static int add_ends(struct table *t)
{
    static const float scatter[2] = {0.02f, 25}, absorb[2] = {0, 2};
    int status = EXIT_DONE;
    for (int i = 0; i < 4 && !status; i++) {
        struct prt_material m = {.eta = t->source.media.medium[0].eta, .roughness = 0.3f};
        for (int c = 0; c < 3; c++)
            m.sigma_s_prime[c] = scatter[i / 2], m.sigma_a[c] = absorb[i % 2];
        snprintf(m.name, sizeof m.name, "s' %g a %g", (double)scatter[i / 2],
                 (double)absorb[i % 2]);
        status = add_medium(t, &m);
    }
    return status;
}

static int add_named(struct table *t, const char *list)
{
    bool json = *list == '{';
    int status = EXIT_DONE;
    for (const char *at = list; !status && *at;) {
        char name[4096];
        struct prt_material m;
        size_t n = json ? strlen(at) : strcspn(at, ",");
        if (json) {
            status = material_named(t->tool, "materials", at, &m);
        } else {
            if (n >= sizeof name) n = sizeof name - 1;
            memcpy(name, at, n);
            name[n] = 0;
            status = material_named(t->tool, "materials", name, &m);
        }
        if (!status) status = add_medium(t, &m);
        at += n;
        at += *at == ',';
    }
    return status;
}

static int choose_media(struct table *t)
{
    const struct options *o = &t->tool->opt;
    const struct prt_transport *p = t->source.transport;
    t->media = prt_calloc(MAX_MEDIA, sizeof *t->media);
    if (!t->media) return tool_exit(t->tool, prt_fail(&t->tool->ctx, PRT_NOMEM, "no memory"));
    if (!o->materials) {
        int added = add_medium(t, t->source.media.medium);
        t->set[0] = t->source.media;
        return added;
    }
    double eta[PRT_MEDIA_MAX];
    float range[2];
    if (o->n_material) return usage_error(o, "--material and --materials exclude each other");
    if (!prt_transport_any_eta(p, range) && prt_media_etas(&p->media, eta) > 1)
        return usage_error(o,
                           "%s has objects of different eta: --materials is for bakes of one; "
                           "give --material by object",
                           t->source.path);
    if (p->engine == PRT_TRANSPORT_WAVELET)
        return usage_error(o,
                           "%s is a wavelet .prt, whose material (%s) is fixed by the bake: "
                           "leave --materials out",
                           t->source.path, p->media.medium[0].name);
    int status;
    bool all = !strcmp(o->materials, "all");
    if (all || !strcmp(o->materials, "media")) {
        status = add_measured(t);
        if (!status && all) status = add_ends(t);
    } else if (!strcmp(o->materials, "range")) {
        status = add_ends(t);
    } else {
        status = add_named(t, o->materials);
    }
    if (!status && !t->n_media)
        return usage_error(o, "--materials %s: no measured medium has the bake's eta, %g",
                           o->materials, (double)p->media.medium[0].eta);
    return status;
}

static double setting(const cJSON *settings, const char *name)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(settings, name);
    return cJSON_IsNumber(item) ? item->valuedouble : 0;
}

int check_own_light(const struct tool *tool, const struct source *of)
{
    const struct options *o = &tool->opt;
    int status = EXIT_DONE;
    if (of->transport->engine != PRT_TRANSPORT_POLYNOMIAL) return EXIT_DONE;
    cJSON *settings = cJSON_Parse(of->transport->settings);
    const cJSON *source = cJSON_GetObjectItemCaseSensitive(settings, "source");
    const cJSON *env = cJSON_GetObjectItemCaseSensitive(source, "env");
    const char *slash = strrchr(o->env, '/'), *given = slash ? slash + 1 : o->env;
    const double turn = setting(source, "rotate_deg");
    // relightd bakes from a copy, whose name says nothing
    const bool named = cJSON_IsString(env) && strcmp(env->valuestring, ".environment");
    if (o->n_env > 1 || (named && strcmp(env->valuestring, given)))
        status = usage_error(o, "%s was baked under %s: give that one light as --env", of->path,
                             named ? env->valuestring : "one light");
    else if (fabs(turn - (double)o->rotate_deg) > 1e-4)
        status =
            usage_error(o, "%s was baked under a light turned by %g degrees: give --rotate %g",
                        of->path, turn, turn);
    cJSON_Delete(settings);
    return status;
}

static int load_lights(struct table *t)
{
    const struct options *o = &t->tool->opt;
    int status = EXIT_DONE;
    for (; !status && t->n_light < o->n_env; t->n_light++) {
        struct prt_env *env = NULL;
        status = tool_exit(t->tool, tool_env_load(t->tool, o->envs[t->n_light], &env));
        if (!status)
            status = source_light(t->tool, &t->source, env, t->source.transport->cube,
                                  &t->own[t->n_light]);
        if (!status) status = source_light(t->tool, &t->source, env, 0, &t->seen[t->n_light]);
        if (env) prt_env_destroy(env);
    }
    return status;
}

// One call of the reference for each index, which the irradiance of all its media has.
static int reference_by_eta(struct table *t, const struct prt_reference_options *options,
                            float *want)
{
    const struct prt_cube *light[MAX_ENV];
    bool done[MAX_MEDIA] = {false};
    int status = PRT_OK;
    for (unsigned l = 0; l < t->n_light; l++) light[l] = &t->seen[l];
    for (unsigned first = 0; first < t->n_media && !status; first++) {
        struct prt_media set[MAX_MEDIA];
        float(*color[MAX_MEDIA * MAX_ENV])[3];
        unsigned n = 0;
        for (unsigned m = first; m < t->n_media && !done[first]; m++) {
            if (t->media[m].eta != t->media[first].eta) continue;
            for (unsigned l = 0; l < t->n_light; l++)
                color[n * t->n_light + l] =
                    (float(*)[3])(want + ((size_t)m * t->n_light + l) * t->n * 3);
            set[n++] = t->set[m];
            done[m] = m > first;
        }
        if (n)
            status = prt_reference_many(&t->tool->ctx, t->source.mesh, n, set, t->n_light,
                                        light, options, color);
    }
    return status;
}

// number: 0, or 1 of another one with other random numbers.
static int fill_reference(struct table *t, const float *eye, unsigned number, float *want)
{
    const struct options *o = &t->tool->opt;
    struct prt_reference_options options = reference_options(o, &t->source, o->term, eye);
    options.seed += 1000003 * number;
    if (!o->samples) options.n_sample = TABLE_SAMPLES;
    if (!o->rays) options.n_ray = TABLE_RAYS;
    options.vertex = t->vertex;
    options.n_vertex = t->n;
    return reference_by_eta(t, &options, want);
}

// The relative RMSE of `got`; from two references what both agree on, so that the noise of
// neither counts.
static double error_from(const float *got, const float *want, const float *again, size_t n)
{
    double error = 0, all = 0;
    if (!again) return prt_relative_rmse(got, want, n);
    for (size_t i = 0; i < n; i++) {
        error += ((double)got[i] - (double)want[i]) * ((double)got[i] - (double)again[i]);
        all += (double)want[i] * (double)again[i];
    }
    return all > 0 ? sqrt(fmax(error, 0) / all) : INFINITY;
}

static int fill_answers(struct table *t, const float *eye)
{
    const struct prt_transport *p = t->source.transport;
    const struct prt_context *ctx = &t->tool->ctx;
    bool fixed = p->engine == PRT_TRANSPORT_WAVELET;
    float(*all)[3] = prt_alloc(p->mesh.n_vertex, sizeof *all);
    int status = all ? PRT_OK : prt_fail(ctx, PRT_NOMEM, "no memory for the colours");
    for (unsigned m = 0; m < t->n_media && !status; m++) {
        struct prt_query query = {.term = answer_term(t->tool->opt.term),
                                  .media = fixed ? (struct prt_media){0} : t->set[m],
                                  .eye = eye,
                                  .exit = exit_option(&t->tool->opt)};
        if (!fixed)
            status = prt_answer_material_error(ctx, p, &t->set[m], query.term, &t->bound[m]);
        for (unsigned l = 0; l < t->n_light && !status; l++) {
            float *got = t->got + ((size_t)m * t->n_light + l) * t->n * 3;
            query.light = p->engine == PRT_TRANSPORT_POLYNOMIAL ? NULL : &t->own[l];
            status = prt_answer_colors(ctx, p, &query, all);
            for (uint32_t i = 0; i < t->n && !status; i++)
                memcpy(got + 3 * (size_t)i, all[t->vertex[i]], sizeof *all);
        }
    }
    prt_free(all);
    return status;
}

// The file's name without folder and ending; returns its length.
static int light_base(const struct options *o, unsigned l, const char **name)
{
    const char *slash = strrchr(o->envs[l], '/');
    *name = slash ? slash + 1 : o->envs[l];
    return (int)strcspn(*name, ".");
}

// The base; the light as it was given where another one has the same.
static void light_key(const struct options *o, unsigned n_light, unsigned l, char out[256])
{
    const char *name, *other;
    const int n = light_base(o, l, &name);
    snprintf(out, 256, "%.*s", n, name);
    for (unsigned k = 0; k < n_light; k++)
        if (k != l && light_base(o, k, &other) == n && !strncmp(name, other, (size_t)n))
            snprintf(out, 256, "%s", o->envs[l]);
}

// Largest error of the counted media; false when there is none.
static bool worst_of(const struct table *t, double *worst)
{
    bool any = false;
    *worst = 0;
    for (unsigned m = 0; m < t->n_media; m++)
        for (unsigned l = 0; judged(t, m) && l < t->n_light; l++) {
            any = true;
            if (!(t->error[m][l] <= *worst)) *worst = t->error[m][l];
        }
    return any;
}

// "within" needs --max-rmse.
static void print_json(const struct table *t, double worst, bool any)
{
    const struct options *o = &t->tool->opt;
    char key[256];
    cJSON *root = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "file", t->source.path);
    cJSON_AddStringToObject(root, "engine", source_engine_name(t->source.transport));
    cJSON_AddStringToObject(root, "term", o->term ? o->term : "total");
    cJSON_AddNumberToObject(root, "vertices", t->n);
    cJSON *rows = cJSON_AddArrayToObject(root, "media");
    for (unsigned m = 0; m < t->n_media; m++) {
        cJSON *row = cJSON_CreateObject();
        cJSON_AddStringToObject(row, "material", t->media[m].name);
        cJSON_AddNumberToObject(row, "material_error", t->bound[m]);
        cJSON_AddNumberToObject(row, "mean_free_path_mm", path_mm(&t->media[m]));
        cJSON_AddBoolToObject(row, "judged", judged(t, m));
        cJSON *errors = cJSON_AddObjectToObject(row, "rmse");
        for (unsigned l = 0; l < t->n_light; l++) {
            light_key(o, t->n_light, l, key);
            cJSON_AddNumberToObject(errors, key, t->error[m][l]);
        }
        cJSON_AddItemToArray(rows, row);
    }
    if (any) cJSON_AddNumberToObject(root, "worst", worst);
    else cJSON_AddNullToObject(root, "worst");
    if (o->max_rmse_set) {
        cJSON_AddNumberToObject(root, "target", o->max_rmse);
        cJSON_AddBoolToObject(root, "within", any && worst <= o->max_rmse);
    }
    char *text = cJSON_PrintUnformatted(root);
    puts(text ? text : "{}");
    free(text);
    cJSON_Delete(root);
}

static void print_text(const struct table *t, double worst, bool any)
{
    const struct options *o = &t->tool->opt;
    const char *name;
    bool starred = false;
    printf("%s (%s), --term %s, %u vertices: relative RMSE against the reference, %%\n",
           t->source.path, source_engine_name(t->source.transport), o->term ? o->term : "total",
           t->n);
    printf("%-16s %8s", "medium", "bound");
    for (unsigned l = 0; l < t->n_light; l++) {
        const int n = light_base(o, l, &name);
        printf(" %11.*s", n < 11 ? n : 11, name);
    }
    putchar('\n');
    for (unsigned m = 0; m < t->n_media; m++) {
        starred |= !judged(t, m);
        printf("%-15s%c %8.3f", t->media[m].name, judged(t, m) ? ' ' : '*', 100 * t->bound[m]);
        for (unsigned l = 0; l < t->n_light; l++) printf(" %11.3f", 100 * t->error[m][l]);
        putchar('\n');
    }
    if (t->again) puts("two references of walks: the noise of neither is in the errors");
    if (starred)
        printf("* mean free path below the bake's sample spacing (%.3g mm): told, not judged\n",
               t->spacing_mm);
    if (any && o->max_rmse_set)
        printf("worst %.3f %%, target %.3g %%: %s\n", 100 * worst, 100 * o->max_rmse,
               worst <= o->max_rmse ? "met" : "not met");
    else if (any) printf("worst %.3f %%\n", 100 * worst);
}

static int prepare(struct table *t)
{
    const struct options *o = &t->tool->opt;
    int status = source_open(t->tool, o->input[0], NULL, &t->source);
    if (status) return status;
    if (!t->source.transport) return usage_error(o, "%s is not a .prt", o->input[0]);
    cJSON *settings = cJSON_Parse(t->source.transport->settings);
    t->spacing_mm = setting(settings, "spacing_mm");
    cJSON_Delete(settings);
    status = check_own_light(t->tool, &t->source);
    if (!status) status = choose_media(t);
    if (!status) status = load_lights(t);
    uint64_t want = o->vertices ? o->vertices : 512;
    uint32_t *seen = NULL, n_seen = t->source.mesh->n_vertex;
    float eye[3];
    if (status) return status;
    for (int i = 0; i < 3; i++) eye[i] = o->eye.v[i] * t->source.mesh->mm_per_unit;
    if (o->eye.set && !(seen = seen_vertices(t->tool, t->source.mesh, eye, &n_seen)))
        return EXIT_FAILED;
    t->n = want < n_seen ? (uint32_t)want : n_seen;
    size_t all = (size_t)t->n_media * t->n_light * t->n * 3;
    t->want = prt_alloc(all, sizeof *t->want);
    t->got = prt_alloc(all, sizeof *t->got);
    const bool walks = reference_options(o, &t->source, o->term, NULL).n_walk != 0;
    const bool single = o->term && !strcmp(o->term, "single"); // no walks are in it
    if (walks && !single) t->again = prt_alloc(all, sizeof *t->again);
    t->vertex = pick_vertices(n_seen, t->n, o->seed);
    for (uint32_t i = 0; t->vertex && seen && i < t->n; i++) t->vertex[i] = seen[t->vertex[i]];
    prt_free(seen);
    if (t->want && t->got && t->vertex && (t->again || !walks || single)) return EXIT_DONE;
    return tool_exit(t->tool, prt_fail(&t->tool->ctx, PRT_NOMEM, "no memory for the colours"));
}

static int measure(struct table *t)
{
    const struct options *o = &t->tool->opt;
    float eye[3];
    for (int i = 0; i < 3; i++) eye[i] = o->eye.v[i] * t->source.mesh->mm_per_unit;
    int status = fill_answers(t, o->eye.set ? eye : NULL); // refusals before long work
    if (!status) status = fill_reference(t, o->eye.set ? eye : NULL, 0, t->want);
    if (!status && t->again) status = fill_reference(t, o->eye.set ? eye : NULL, 1, t->again);
    for (unsigned m = 0; m < t->n_media && !status; m++)
        for (unsigned l = 0; l < t->n_light; l++) {
            size_t at = ((size_t)m * t->n_light + l) * t->n * 3;
            t->error[m][l] = error_from(t->got + at, t->want + at,
                                        t->again ? t->again + at : NULL, 3 * (size_t)t->n);
        }
    if (status == PRT_MISMATCH) return EXIT_USAGE; // a medium of another eta
    if (status) return tool_exit(t->tool, status);
    double worst;
    bool any = worst_of(t, &worst);
    if (o->json) print_json(t, worst, any);
    else print_text(t, worst, any);
    if (o->max_rmse_set && !any) {
        prt_log(&t->tool->ctx, PRT_LOG_ERROR,
                "no medium's mean free path reaches the bake's sample spacing (%.3g mm): "
                "--max-rmse has none to judge",
                t->spacing_mm);
        return EXIT_FAILED;
    }
    if (!o->max_rmse_set || worst <= o->max_rmse) return EXIT_DONE;
    prt_log(&t->tool->ctx, PRT_LOG_ERROR, "relative RMSE %.6g is above --max-rmse %g", worst,
            o->max_rmse);
    return EXIT_FAILED;
}

int compare_table(struct tool *tool)
{
    struct table *t = prt_calloc(1, sizeof *t);
    if (!t) return tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory"));
    t->tool = tool;
    int status;
    if (!tool->opt.env)
        status = usage_error(&tool->opt, "comparing with the reference needs --env");
    else if (tool->opt.term && !strcmp(tool->opt.term, "irradiance"))
        status = usage_error(&tool->opt, "a .prt holds no irradiance to compare");
    else if (!(status = prepare(t))) status = measure(t);
    prt_free(t->want);
    prt_free(t->again);
    prt_free(t->got);
    prt_free(t->vertex);
    prt_free(t->media);
    for (unsigned l = 0; l < MAX_ENV; l++) {
        prt_cube_finish(&t->own[l]);
        prt_cube_finish(&t->seen[l]);
    }
    source_close(&t->source);
    prt_free(t);
    return status;
}
