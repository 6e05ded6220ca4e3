// SPDX-License-Identifier: MIT
// prt colors: one colour a vertex, by a baked transport or by the reference engine.
#include "tool.h"
#include "prt/relight.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// The engine that answers, or NULL after a usage error.
static const char *choose_engine(const struct tool *tool, const struct source *source)
{
    const struct options *o = &tool->opt;
    bool reference = o->engine && !strcmp(o->engine, "reference");
    if (!source->transport) {
        if (!o->engine || reference) return "reference";
        usage_error(o,
                    "--engine %s needs a baked transport: bake %s first "
                    "(prt bake %s -o OUT.prt) and give the .prt",
                    o->engine, source->path, source->path);
        return NULL;
    }
    const char *own = source_engine_name(source->transport);
    if (reference) return "reference";
    if (o->engine && strcmp(o->engine, own)) {
        usage_error(o, "%s was baked for --engine %s, not %s", source->path, own, o->engine);
        return NULL;
    }
    if (o->term && !strcmp(o->term, "irradiance")) {
        prt_log(&tool->ctx, PRT_LOG_NOTE,
                "a .prt holds no irradiance: E at the vertices is "
                "traced again by the reference engine");
        return "reference";
    }
    return own;
}

static int answer(struct tool *tool, const struct source *source, const struct prt_cube *light,
                  const float *eye_mm, float (*color)[3])
{
    struct prt_query query = {
        .term = answer_term(tool->opt.term),
        .light = light,
        .eye = eye_mm,
        .exit = exit_option(&tool->opt),
    };
    if (source->media_given) query.media = source->media;
    if (source->variant) query.gain = (const float(*)[3])source->variant->mesh.gain;
    return tool_exit(tool, prt_answer_colors(&tool->ctx, source->transport, &query, color));
}

static void summary(const struct tool *tool, const struct source *source, const char *engine,
                    uint32_t cube, double seconds, double lost, double noise,
                    const float (*color)[3])
{
    uint32_t n = source->mesh->n_vertex;
    double mean[3] = {0};
    for (uint32_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) mean[c] += (double)color[i][c] / n;
    if (!tool->opt.json) {
        prt_log(&tool->ctx, PRT_LOG_NOTE, "%s: %u colours by %s in %.3f s, mean %.4g %.4g %.4g",
                tool->opt.out, n, engine, seconds, mean[0], mean[1], mean[2]);
        if (lost > 0)
            prt_log(&tool->ctx, PRT_LOG_NOTE,
                    "the bake's radial basis represents this material within %.2g %%",
                    100 * lost);
        if (noise > 0)
            prt_log(&tool->ctx, PRT_LOG_NOTE, "standard error of the walks: %.2g %%",
                    100 * noise);
        return;
    }
    cJSON *root = cJSON_CreateObject();
    cJSON_AddStringToObject(root, "out", tool->opt.out);
    cJSON_AddStringToObject(root, "engine", engine);
    cJSON_AddStringToObject(root, "term", tool->opt.term ? tool->opt.term : "total");
    cJSON_AddNumberToObject(root, "vertices", n);
    if (cube) cJSON_AddNumberToObject(root, "cube", cube);
    cJSON_AddNumberToObject(root, "seconds", seconds);
    if (source->media_given && source->transport)
        cJSON_AddNumberToObject(root, "material_error", lost);
    if (noise > 0) cJSON_AddNumberToObject(root, "standard_error", noise);
    cJSON_AddItemToObject(root, "mean", cJSON_CreateDoubleArray(mean, 3));
    char *text = cJSON_PrintUnformatted(root);
    puts(text ? text : "{}");
    free(text);
    cJSON_Delete(root);
}

// Loads the light at the engine's resolution; *cube stays empty for a transport with its own
// light.
static int load_light(struct tool *tool, const struct source *source, bool reference,
                      struct prt_cube *cube)
{
    const struct options *o = &tool->opt;
    struct prt_env *env = NULL;
    bool fixed = !reference && source->transport->engine == PRT_TRANSPORT_POLYNOMIAL;
    if (fixed) {
        if (o->env || o->rotate_deg != 0)
            prt_log(&tool->ctx, PRT_LOG_NOTE,
                    "%s was baked under one light: --env and --rotate change nothing",
                    source->path);
        return EXIT_DONE;
    }
    if (!o->env) return usage_error(o, "--env is missing");
    uint32_t own = reference ? 0 : source->transport->cube;
    if (!reference && (o->cube_full || (o->cube && o->cube != own)))
        return usage_error(o,
                           "%s was baked for a light of 6x%ux%u: --cube sets it for --engine "
                           "reference only",
                           source->path, own, own);
    int status = tool_exit(tool, tool_env_load(tool, o->env, &env));
    if (!status) status = source_light(tool, source, env, own, cube);
    if (env) prt_env_destroy(env);
    return status;
}

int run_colors(struct tool *tool)
{
    const struct options *o = &tool->opt;
    if (!o->out) return usage_error(o, "-o OUT is missing");
    if (prt_vertex_format_of(o->out) == PRT_VERTEX_NONE)
        return usage_error(o, "-o %s: colours are written as .csv, .npy, .ply or .glb", o->out);
    struct source source = {0};
    struct prt_cube cube = {0};
    float(*color)[3] = NULL;
    int status = check_writable(tool, o->out);
    if (status || (status = source_open(tool, o->input[0], NULL, &source))) return status;
    const char *engine = choose_engine(tool, &source);
    bool reference = engine && !strcmp(engine, "reference");
    double lost = 0, noise = 0;
    if (engine && !reference && o->scattering && !strcmp(o->scattering, "walk")) {
        status = usage_error(o, "--scattering walk is for --engine reference");
        goto done;
    }
    status = engine ? load_light(tool, &source, reference, &cube) : EXIT_USAGE;
    if (!status && !reference) status = source_material_error(tool, &source, o->term, &lost);
    if (status) goto done;
    float eye[3];
    for (int i = 0; i < 3; i++) eye[i] = o->eye.v[i] * source.mesh->mm_per_unit;
    const float *eye_mm = o->eye.set ? eye : NULL;
    if (!(color = prt_alloc(source.mesh->n_vertex, sizeof *color))) {
        status = tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the colours"));
        goto done;
    }
    double started = prt_time_s();
    status = reference ? reference_term(tool, &source, &cube, o->term ? o->term : "total",
                                        eye_mm, color, &noise)
                       : answer(tool, &source, cube.texel ? &cube : NULL, eye_mm, color);
    double seconds = prt_time_s() - started;
    if (!status)
        status = tool_exit(
            tool, output_colors(&tool->ctx, o->out, source.mesh, (const float(*)[3])color));
    if (!status)
        summary(tool, &source, engine, cube.n, seconds, lost, noise, (const float(*)[3])color);
done:
    prt_free(color);
    prt_cube_finish(&cube);
    source_close(&source);
    return status;
}
