// SPDX-License-Identifier: MIT
// prt compare: relative RMSE of A against B: colours, pictures, or a .prt against brute force.
#include "tool.h"
#include "prt/relight.h"
#include "prt/trace.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct values {
    float *rgb; // [n][3]
    size_t n;
    double noise;           // relative standard error of walks; 0: none
    uint32_t width, height; // 0 for colours
};

static bool is_table(const char *path)
{
    enum prt_vertex_format format = prt_vertex_format_of(path);
    return format == PRT_VERTEX_CSV || format == PRT_VERTEX_NPY;
}

static int values_load(struct tool *tool, const char *path, struct values *out)
{
    struct prt_image image = {0};
    int status = is_table(path) ? table_load(&tool->ctx, path, &out->rgb, &out->n)
                                : prt_image_load(&tool->ctx, path, &image);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    if (image.rgb)
        *out = (struct values){.rgb = image.rgb,
                               .n = (size_t)image.width * image.height,
                               .width = image.width,
                               .height = image.height};
    for (size_t i = 0; i < 3 * out->n; i++)
        if (!isfinite(out->rgb[i]))
            return tool_exit(tool, prt_fail(&tool->ctx, PRT_FORMAT,
                                            "%s: value %zu is not a finite number", path, i));
    return EXIT_DONE;
}

static int check_sizes(struct tool *tool, const struct values *a, const struct values *b)
{
    const char *na = tool->opt.input[0], *nb = tool->opt.input[1];
    if (!a->width != !b->width)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_MISMATCH,
                                        "%s and %s: colours cannot be compared with a picture",
                                        na, nb));
    if (a->width != b->width || a->height != b->height)
        return tool_exit(tool,
                         prt_fail(&tool->ctx, PRT_MISMATCH, "%s has %ux%u pixels, %s has %ux%u",
                                  na, a->width, a->height, nb, b->width, b->height));
    if (a->n != b->n)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_MISMATCH,
                                        "%s has %zu colours, %s has %zu", na, a->n, nb, b->n));
    return EXIT_DONE;
}

struct difference {
    double rmse, channel[3], max_abs; // rmse relative to B
    size_t max_at;                    // vertex or pixel of max_abs
};

static double relative(double diff2, double ref2)
{
    return diff2 == 0 ? 0 : sqrt(diff2 / ref2); // infinite against black
}

static struct difference measure(const struct values *a, const struct values *b)
{
    struct difference d = {0};
    double diff2[3] = {0}, ref2[3] = {0};
    for (size_t i = 0; i < a->n; i++)
        for (size_t c = 0; c < 3; c++) {
            double x = (double)a->rgb[3 * i + c], y = (double)b->rgb[3 * i + c];
            diff2[c] += (x - y) * (x - y);
            ref2[c] += y * y;
            if (fabs(x - y) > d.max_abs) {
                d.max_abs = fabs(x - y);
                d.max_at = i;
            }
        }
    for (int c = 0; c < 3; c++) d.channel[c] = relative(diff2[c], ref2[c]);
    d.rmse = relative(diff2[0] + diff2[1] + diff2[2], ref2[0] + ref2[1] + ref2[2]);
    return d;
}

// JSON has no infinity: it is written as null.
static cJSON *number(double x)
{
    return isfinite(x) ? cJSON_CreateNumber(x) : cJSON_CreateNull();
}

static int report(const struct tool *tool, const struct values *a, const struct values *b,
                  const struct difference *d)
{
    const struct options *o = &tool->opt;
    bool within = !o->max_rmse_set || d->rmse <= o->max_rmse;
    if (o->json) {
        cJSON *root = cJSON_CreateObject(), *channels = cJSON_CreateArray();
        for (int c = 0; c < 3; c++) cJSON_AddItemToArray(channels, number(d->channel[c]));
        cJSON_AddStringToObject(root, "a", o->input[0]);
        cJSON_AddStringToObject(root, "b", o->input[1]);
        cJSON_AddNumberToObject(root, "count", (double)a->n);
        cJSON_AddItemToObject(root, "rmse", number(d->rmse));
        cJSON_AddItemToObject(root, "rmse_rgb", channels);
        if (b->noise > 0) {
            const double left = d->rmse * d->rmse - b->noise * b->noise;
            cJSON_AddNumberToObject(root, "reference_noise", b->noise);
            cJSON_AddNumberToObject(root, "rmse_without_noise", sqrt(fmax(left, 0)));
        }
        cJSON_AddItemToObject(root, "max_abs", number(d->max_abs));
        cJSON_AddNumberToObject(root, "max_abs_at", (double)d->max_at);
        if (o->max_rmse_set) cJSON_AddBoolToObject(root, "within", within);
        char *text = cJSON_PrintUnformatted(root);
        puts(text ? text : "{}");
        free(text);
        cJSON_Delete(root);
    } else {
        printf("relative RMSE %.6g  (r %.6g  g %.6g  b %.6g)\n", d->rmse, d->channel[0],
               d->channel[1], d->channel[2]);
        if (b->noise > 0)
            printf(
                "standard error of the reference's walks %.3g of its colours; without it the "
                "relative RMSE is %.3g\n",
                b->noise, sqrt(fmax(d->rmse * d->rmse - b->noise * b->noise, 0)));
        if (a->width)
            printf("max |A-B| %.6g at pixel %zu,%zu of %ux%u\n", d->max_abs,
                   d->max_at % a->width, d->max_at / a->width, a->width, a->height);
        else printf("max |A-B| %.6g at vertex %zu of %zu\n", d->max_abs, d->max_at, a->n);
    }
    if (!within)
        prt_log(&tool->ctx, PRT_LOG_ERROR, "relative RMSE %.6g is above --max-rmse %g", d->rmse,
                o->max_rmse);
    return within ? EXIT_DONE : EXIT_FAILED;
}

uint32_t *pick_vertices(uint32_t n_vertex, uint32_t n, uint64_t seed)
{
    uint32_t *pick = prt_alloc(n, sizeof *pick), found = 0;
    struct prt_rng rng;
    if (!pick) return NULL;
    prt_rng_init(&rng, seed, 0x76657274);
    // Selection sampling: a vertex is taken with probability (missing picks)/(remaining
    // vertices).
    for (uint32_t i = 0; i < n_vertex && found < n; i++)
        if (((uint64_t)prt_rng_u32(&rng) * (n_vertex - i)) >> 32 < n - found) pick[found++] = i;
    return pick;
}

static int reference_at(struct tool *tool, const struct source *source,
                        const struct prt_cube *light, const float *eye, const uint32_t *pick,
                        uint32_t n, float *rgb, double *noise)
{
    struct prt_reference_options options =
        reference_options(&tool->opt, source, tool->opt.term, eye);
    float(*error)[3] = options.n_walk ? prt_alloc(n, sizeof *error) : NULL;
    options.vertex = pick;
    options.n_vertex = n;
    if (error) options.standard_error = &error;
    int status = prt_reference_colors(&tool->ctx, source->mesh, &source->media, light, &options,
                                      (float(*)[3])rgb);
    *noise = error && !status ? relative_noise(error[0], rgb, 3 * (size_t)n) : 0;
    prt_free(error);
    return status;
}
uint32_t *seen_vertices(const struct tool *tool, const struct prt_mesh *mesh,
                        const float eye[3], uint32_t *n)
{
    struct prt_scene *scene = NULL;
    uint32_t *seen = prt_alloc(mesh->n_vertex, sizeof *seen);
    int status = seen ? prt_scene_create(&tool->ctx, mesh, &scene)
                      : prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the vertices");
    *n = 0;
    for (uint32_t v = 0; v < mesh->n_vertex && !status; v++) {
        const float *p = mesh->position[v], *normal = mesh->normal[v];
        float start[3], d[3], t, a, b, facing = 0, length = 0, off = prt_scene_epsilon(scene);
        uint32_t triangle;
        for (int k = 0; k < 3; k++) {
            d[k] = eye[k] - p[k];
            start[k] = p[k] + off * normal[k];
            facing += d[k] * normal[k];
            length += d[k] * d[k];
        }
        for (int k = 0; k < 3; k++) d[k] /= sqrtf(length > 0 ? length : 1);
        if (facing > 0 &&
            !prt_scene_intersect(scene, start, d, off, sqrtf(length), &t, &triangle, &a, &b))
            seen[(*n)++] = v;
    }
    prt_scene_destroy(scene);
    if (!status && !*n)
        status = prt_fail(&tool->ctx, PRT_ARG, "--eye sees no vertex of the model");
    if (!status) return seen;
    prt_free(seen);
    return NULL;
}

// Compares A.prt with the reference engine at random vertices under --env, with --eye at those
// that it sees. Polynomial transport
// keeps its own light; the reference engine takes the light at the resolution of --cube.
static int against_reference(struct tool *tool, struct values *a, struct values *b)
{
    const struct options *o = &tool->opt;
    if (!o->env) return usage_error(o, "comparing with the reference needs --env");
    if (o->term && !strcmp(o->term, "irradiance"))
        return usage_error(o, "a .prt holds no irradiance to compare");
    struct source source;
    int exit_status = source_open(tool, o->input[0], NULL, &source);
    if (exit_status) return exit_status;
    struct prt_cube own = {0}, light = {0};
    struct prt_env *env = NULL;
    float *color = NULL;
    uint32_t *pick = NULL, *seen = NULL, n_vertex = source.mesh->n_vertex, n_seen = n_vertex;
    uint64_t want = o->vertices ? o->vertices : 512;
    float eye[3];
    for (int i = 0; i < 3; i++) eye[i] = o->eye.v[i] * source.mesh->mm_per_unit;
    if (o->eye.set && !(seen = seen_vertices(tool, source.mesh, eye, &n_seen))) {
        exit_status = EXIT_FAILED;
        goto done;
    }
    uint32_t n = want < n_seen ? (uint32_t)want : n_seen;
    if (!source.transport) {
        exit_status = usage_error(o, "%s is not a .prt", o->input[0]);
        goto done;
    }
    if ((exit_status = check_own_light(tool, &source))) goto done;
    int status = tool_env_load(tool, o->env, &env);
    exit_status = tool_exit(tool, status);
    if (!exit_status)
        exit_status = source_light(tool, &source, env, source.transport->cube, &own);
    if (!exit_status) exit_status = source_light(tool, &source, env, 0, &light);
    if (exit_status) goto done;
    struct prt_query query = {
        .term = answer_term(o->term),
        .light = source.transport->engine == PRT_TRANSPORT_POLYNOMIAL ? NULL : &own,
        .eye = o->eye.set ? eye : NULL,
        .exit = exit_option(o),
    };
    if (source.media_given) query.media = source.media;
    color = prt_alloc(n_vertex, 3 * sizeof *color);
    a->rgb = prt_alloc(n, 3 * sizeof *a->rgb);
    b->rgb = prt_alloc(n, 3 * sizeof *b->rgb);
    a->n = b->n = n;
    pick = pick_vertices(n_seen, n, o->seed);
    for (uint32_t i = 0; pick && seen && i < n; i++) pick[i] = seen[pick[i]];
    status = color && a->rgb && b->rgb && pick
                 ? PRT_OK
                 : prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the colours");
    if (!status)
        status = prt_answer_colors(&tool->ctx, source.transport, &query, (float(*)[3])color);
    if (!status)
        status = reference_at(tool, &source, &light, query.eye, pick, n, b->rgb, &b->noise);
    for (uint32_t i = 0; i < n && !status; i++)
        memcpy(a->rgb + 3 * (size_t)i, color + 3 * (size_t)pick[i], 3 * sizeof *color);
    exit_status = tool_exit(tool, status);
done:
    prt_free(pick);
    prt_free(seen);
    prt_free(color);
    prt_cube_finish(&own);
    prt_cube_finish(&light);
    if (env) prt_env_destroy(env);
    source_close(&source);
    return exit_status;
}

// The first of the options that only a comparison with the reference engine takes.
static const char *reference_option(const struct options *o)
{
    const struct {
        const char *name;
        bool given;
    } all[] = {{"env", o->env},
               {"materials", o->materials},
               {"material", o->n_material},
               {"term", o->term},
               {"eye", o->eye.set},
               {"exit", o->exit},
               {"rotate", o->rotate_deg != 0},
               {"faces", o->faces},
               {"scattering", o->scattering},
               {"walks", o->walks},
               {"cube", o->cube || o->cube_full},
               {"samples", o->samples},
               {"rays", o->rays},
               {"single-points", o->single_points},
               {"vertices", o->vertices}};
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (all[i].given) return all[i].name;
    return NULL;
}

int run_compare(struct tool *tool)
{
    const struct options *o = &tool->opt;
    struct values a = {0}, b = {0};
    int status;
    bool reference = !strcmp(o->input[1], "reference");
    if (reference && (o->materials || o->n_env > 1)) return compare_table(tool);
    const char *unused = reference ? NULL : reference_option(o);
    if (unused) return usage_error(o, "--%s is for B = reference", unused);
    if (reference) {
        status = against_reference(tool, &a, &b);
    } else {
        status = values_load(tool, o->input[0], &a);
        if (!status) status = values_load(tool, o->input[1], &b);
        if (!status) status = check_sizes(tool, &a, &b);
    }
    if (!status) {
        struct difference d = measure(&a, &b);
        status = report(tool, &a, &b, &d);
    }
    // Pictures and tables come from the same allocator.
    prt_free(a.rgb);
    prt_free(b.rgb);
    return status;
}
