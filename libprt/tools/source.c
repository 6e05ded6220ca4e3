// SPDX-License-Identifier: MIT
// SOURCE of the command contract: a .prt, or a model with a material and a scale; and its
// light.
#include "tool.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

int material_named(struct tool *tool, const char *option, const char *name,
                   struct prt_material *out)
{
    const struct prt_context *ctx = &tool->ctx;
    bool inline_json = name[strspn(name, " \t\r\n")] == '{';
    bool is_file = !inline_json && (access(name, R_OK) == 0 || prt_material_is_foreign(name));
    char remedy[160] = "";
    if (!inline_json && !is_file && !prt_material_preset_named(name, remedy, sizeof remedy)) {
        const struct prt_material *preset;
        char list[256] = "";
        for (unsigned i = 0; (preset = prt_material_preset(i)); i++) {
            size_t n = strlen(list);
            snprintf(list + n, sizeof list - n, "%s%s", n ? ", " : "", preset->name);
        }
        return usage_error(&tool->opt, "%s%s%s%s: neither a file nor one of %s%s%s",
                           option ? "--" : "", option ? option : "", option ? " " : "", name,
                           list, remedy[0] ? "; " : "", remedy);
    }
    int status = prt_material_load(ctx, name, out);
    if (!status) status = prt_material_check(ctx, out);
    // A wrong file is a failure; wrong text on the command line is wrong usage.
    if (status) return is_file ? EXIT_FAILED : EXIT_USAGE;
    return EXIT_DONE;
}

const char *source_engine_name(const struct prt_transport *transport)
{
    switch ((enum prt_transport_kind)transport->engine) {
    case PRT_TRANSPORT_WAVELET:
        return "wavelet";
    case PRT_TRANSPORT_POLYNOMIAL:
        return "polynomial";
    case PRT_TRANSPORT_JOINT:
        return "joint";
    }
    return "unknown";
}

static bool any_single(const struct prt_media *media)
{
    bool any = false;
    for (uint32_t i = 0; i < media->n; i++) any |= !media->medium[i].profile;
    return any;
}

// Reports that a bake with --no-single has 0 for `single`, also in `total`.
static void report_no_single(const struct tool *tool, const struct source *source)
{
    const struct options *o = &tool->opt;
    const struct prt_transport *t = source->transport;
    bool own =
        !o->engine || !strcmp(o->engine, "vertex") || !strcmp(o->engine, source_engine_name(t));
    bool wanted = !o->term || !strcmp(o->term, "single") || !strcmp(o->term, "total");
    bool lights = o->command == CMD_COLORS || o->command == CMD_IMAGE;
    if (!lights || !own || !wanted || !any_single(&t->media)) return;
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].term == PRT_TERM_SINGLE) return;
    prt_log(&tool->ctx, o->term && !strcmp(o->term, "single") ? PRT_LOG_WARNING : PRT_LOG_NOTE,
            "%s was baked without single scattering, which is 0", source->path);
}

// Only walks have unscattered light: those of the bake, or of --scattering walk.
static int check_unscattered(const struct tool *tool, const struct source *source)
{
    const struct options *o = &tool->opt;
    const bool walks = o->scattering && !strcmp(o->scattering, "walk");
    if (!o->term || strcmp(o->term, "unscattered") || walks || source_has_walks(source))
        return EXIT_DONE;
    return usage_error(
        o,
        "%s was baked with the dipole, which has no unscattered light: bake with "
        "--scattering walk",
        source->path);
}

// Whether the transport answers; else an engine that needs no bake, as of all irradiance.
static bool answers_baked(const struct options *o, const struct prt_transport *t)
{
    if (o->term && !strcmp(o->term, "irradiance")) return false;
    return !o->engine || !strcmp(o->engine, "vertex") ||
           !strcmp(o->engine, source_engine_name(t));
}

// The .prt as --variant has it: an engine of its own answers where the transport does not.
static int open_variant(struct tool *tool, struct source *source)
{
    const struct options *o = &tool->opt;
    const struct prt_transport *t = source->transport;
    const enum prt_variant_of of =
        answers_baked(o, t) ? prt_transport_variants(t) : PRT_VARIANT_OF_MODEL;
    const bool free_media = of == PRT_VARIANT_OF_FREE || of == PRT_VARIANT_OF_ANY_ETA;
    int status = prt_variant_create(&tool->ctx, source->path, source->mesh, &source->media, of,
                                    o->variant, &source->variant);
    if (status) // wrong text on the command line, or a variant that was not baked
        return status == PRT_ARG ? EXIT_USAGE : tool_exit(tool, status);
    source->mesh = &source->variant->mesh;
    source->media = *source->variant->media;
    source->media_given = free_media && !source->variant->plain;
    return EXIT_DONE;
}

static int open_prt(struct tool *tool, struct source *source)
{
    const struct options *o = &tool->opt;
    if (o->size_mm > 0 || o->mm_per_unit > 0 || o->n_opaque || o->up || o->flip_v)
        return usage_error(
            o,
            "%s is a .prt, which carries its own scale, axes and surfaces: leave "
            "--size-mm, --mm-per-unit, --up, --flip-v and --opaque out",
            source->path);
    if (o->animation || o->time_s > 0)
        return usage_error(o,
                           "%s is a .prt, which holds the model at rest alone: give "
                           "--animation and --time with the model's glTF",
                           source->path);
    if (o->texture_split > 0)
        return usage_error(o,
                           "%s is a .prt, whose texture split is fixed by the bake: leave "
                           "--texture-split out, or bake again",
                           source->path);
    int status = prt_file_open(&tool->ctx, source->path, PRT_FILE_CHECK_ALL, &source->file);
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    source->transport = prt_file_transport(source->file);
    source->mesh = &source->transport->mesh;
    source->media = source->transport->media;
    report_no_single(tool, source);
    if ((status = check_unscattered(tool, source))) return status;
    if (o->variant && (status = open_variant(tool, source))) return status;
    if (o->no_textures && !answers_baked(o, source->transport)) {
        source->plain = *source->mesh;
        source->plain.texture_split = 0;
        prt_mesh_drop_textures(&source->plain);
        source->mesh = &source->plain;
    }
    if (!o->n_material) return EXIT_DONE;
    if (source->transport->engine == PRT_TRANSPORT_WAVELET)
        return usage_error(o,
                           "%s is a wavelet .prt, whose material (%s) is fixed by the bake: "
                           "leave --material out, or bake again",
                           source->path, source->media.medium[0].name);
    return source_media_edit(tool, source);
}

int source_material_error(struct tool *tool, const struct source *source, const char *term,
                          double *error)
{
    *error = 0;
    if (!source->transport || !source->media_given) return EXIT_DONE;
    int status = prt_answer_material_error(&tool->ctx, source->transport, &source->media,
                                           answer_term(term), error);
    // A medium with another eta is wrong usage, as one out of range is.
    return status == PRT_MISMATCH ? EXIT_USAGE : tool_exit(tool, status);
}

enum prt_answer_term answer_term(const char *word)
{
    return word && !strcmp(word, "multiple")      ? PRT_ANSWER_MULTIPLE
           : word && !strcmp(word, "single")      ? PRT_ANSWER_SINGLE
           : word && !strcmp(word, "unscattered") ? PRT_ANSWER_UNSCATTERED
                                                  : PRT_ANSWER_TOTAL;
}

struct prt_mesh_options source_mesh_options(const struct options *o)
{
    return (struct prt_mesh_options){.opaque = o->n_opaque ? o->opaque : NULL,
                                     .no_textures = o->no_textures,
                                     .animation = o->animation,
                                     .variant = o->variant,
                                     .time_s = o->time_s,
                                     .up_z = o->up && !strcmp(o->up, "z"),
                                     .flip_v = o->flip_v};
}

static void log_errors(void *user, enum prt_log_level level, const char *line)
{
    const struct tool *tool = user;
    if (level == PRT_LOG_ERROR) prt_log(&tool->ctx, level, "%s", line);
}

// --size-mm is the size of the model at rest, whatever the moment: mm_per_unit is its scale.
static int scale_model(struct tool *tool, const struct source *source,
                       const struct prt_mesh_options *options)
{
    const struct options *o = &tool->opt;
    struct prt_mesh *bind = NULL;
    double mm_per_unit = o->mm_per_unit;
    int status = PRT_OK;
    if (o->animation && o->size_mm > 0) {
        struct prt_mesh_options own = *options;
        struct prt_context quiet = tool->ctx; // its notes and warnings were said of the pose
        quiet.log = log_errors;
        quiet.log_user = tool;
        own.animation = NULL;
        own.no_textures = true;
        status = prt_mesh_load(&quiet, source->path, &own, &bind);
        if (!status) status = prt_mesh_scale(&quiet, bind, o->size_mm, 0);
        if (!status) mm_per_unit = (double)bind->mm_per_unit;
        prt_mesh_destroy(bind);
    }
    if (status) return status;
    return prt_mesh_scale(&tool->ctx, source->loaded, mm_per_unit > 0 ? 0 : o->size_mm,
                          mm_per_unit);
}

static int open_model(struct tool *tool, const struct prt_material *fallback,
                      struct source *source)
{
    const struct options *o = &tool->opt;
    struct prt_mesh_options options = source_mesh_options(o);
    if (o->time_s > 0 && !o->animation)
        return usage_error(o, "--time is for --animation: name one (prt info lists them)");
    int status = prt_mesh_load(&tool->ctx, source->path, &options, &source->loaded);
    // A name that one of these misspells.
    if (status == PRT_ARG && (o->n_opaque || o->animation || o->variant)) return EXIT_USAGE;
    if (status) return tool_exit(tool, status == PRT_ARG ? PRT_FORMAT : status);
    source->mesh = source->loaded;
    source->loaded->texture_split = (float)o->texture_split;
    if (!(o->size_mm > 0) && !(o->mm_per_unit > 0) && !source->loaded->units_known)
        return usage_error(o, "%s has no units of length: give --size-mm or --mm-per-unit",
                           source->path);
    status = scale_model(tool, source, &options);
    return status ? tool_exit(tool, status) : source_media(tool, source, fallback);
}

int source_open(struct tool *tool, const char *path, const struct prt_material *fallback,
                struct source *out)
{
    *out = (struct source){.path = path};
    if (access(path, R_OK))
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_IO, "%s: %s", path, strerror(errno)));
    size_t n = strlen(path);
    bool named_prt = n > 4 && !strcasecmp(path + n - 4, ".prt");
    int status = named_prt || prt_file_probe(path) ? open_prt(tool, out)
                                                   : open_model(tool, fallback, out);
    if (status) source_close(out);
    return status;
}

void source_close(struct source *source)
{
    if (source->file) prt_file_close(source->file);
    if (source->loaded) prt_mesh_destroy(source->loaded);
    prt_free(source->made);
    prt_variant_destroy(source->variant);
    source->made = NULL;
    source->variant = NULL;
    source->file = NULL;
    source->loaded = NULL;
}

int tool_env_load(const struct tool *tool, const char *path, struct prt_env **out)
{
    enum prt_faces faces = PRT_FACES_GUESS;
    if (tool->opt.faces) (void)prt_faces_parse(tool->opt.faces, &faces); // one of the table
    return prt_env_load_faces(&tool->ctx, path, faces, out);
}

int source_light(struct tool *tool, const struct source *source, const struct prt_env *env,
                 uint32_t n, struct prt_cube *out)
{
    const struct options *o = &tool->opt;
    if (!n && o->cube_full) n = prt_env_full_cube(env);
    if (!n) n = o->cube;
    if (!n && source->transport) n = source->transport->cube;
    if (!n) n = 32;
    return tool_exit(tool, prt_env_to_cube(&tool->ctx, env, n, o->rotate_deg, out));
}

static enum prt_reference_term term_of(const char *word)
{
    if (!word) return PRT_REFERENCE_TOTAL;
    if (!strcmp(word, "irradiance")) return PRT_REFERENCE_IRRADIANCE;
    if (!strcmp(word, "multiple")) return PRT_REFERENCE_MULTIPLE;
    if (!strcmp(word, "single")) return PRT_REFERENCE_SINGLE;
    if (!strcmp(word, "unscattered")) return PRT_REFERENCE_UNSCATTERED;
    return PRT_REFERENCE_TOTAL;
}

enum prt_exit exit_option(const struct options *o)
{
    return o->exit && !strcmp(o->exit, "papers") ? PRT_EXIT_PAPERS : PRT_EXIT_NORMALISED;
}

enum { DEFAULT_WALKS = 1024 };

bool source_has_walks(const struct source *source)
{
    const struct prt_transport *t = source->transport;
    for (uint32_t i = 0; t && i < t->n_tensor; i++)
        if (t->tensor[i].term == PRT_TERM_UNSCATTERED) return true;
    return false;
}

struct prt_reference_options reference_options(const struct options *o,
                                               const struct source *source, const char *term,
                                               const float *eye_mm)
{
    bool walk = o->scattering ? !strcmp(o->scattering, "walk") : source_has_walks(source);
    return (struct prt_reference_options){
        .term = term_of(term),
        .exit = exit_option(o),
        .eye = eye_mm,
        .straight_single = o->straight,
        .n_sample = (uint32_t)o->samples,
        .n_ray = (uint32_t)o->rays,
        .n_single = (uint32_t)o->single_points,
        .n_phase_term = (unsigned)o->phase_terms,
        .seed = o->seed,
        .n_walk = !walk      ? 0
                  : o->walks ? (uint32_t)o->walks
                             : DEFAULT_WALKS,
    };
}

double relative_noise(const float *error, const float *color, size_t n)
{
    double e = 0, c = 0;
    for (size_t i = 0; i < n; i++) {
        e += (double)error[i] * (double)error[i];
        c += (double)color[i] * (double)color[i];
    }
    return c > 0 ? sqrt(e / c) : 0;
}

int reference_term(struct tool *tool, const struct source *source, const struct prt_cube *light,
                   const char *term, const float *eye_mm, float (*color)[3], double *noise)
{
    struct prt_reference_options options = reference_options(&tool->opt, source, term, eye_mm);
    float(*error)[3] = NULL;
    size_t n = source->mesh->n_vertex;
    if (noise) *noise = 0;
    if (noise && options.n_walk) {
        if (!(error = prt_alloc(n, sizeof *error)))
            return tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM, "no memory for the errors"));
        options.standard_error = &error;
    }
    int status =
        prt_reference_colors(&tool->ctx, source->mesh, &source->media, light, &options, color);
    if (error && !status) *noise = relative_noise(error[0], color[0], 3 * n);
    prt_free(error);
    return tool_exit(tool, status);
}
