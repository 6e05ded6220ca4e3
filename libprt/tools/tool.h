/* SPDX-License-Identifier: MIT */
/* tool.h declares the functions and types that the subcommands of prt share. */
#ifndef PRT_TOOL_H
#define PRT_TOOL_H

#include "prt/base.h"
#include "prt/light.h"
#include "prt/media.h"
#include "prt/medium.h"
#include "prt/mesh.h"
#include "prt/picture.h"
#include "prt/raster.h"
#include "prt/reference.h"
#include "prt/relight.h"
#include "prt/transport.h"
#include "prt/variant.h"
#include "vertex_file.h"

/* Exit statuses of the command contract. */
enum { EXIT_DONE = 0, EXIT_FAILED = 1, EXIT_USAGE = 2 };

enum command {
    CMD_BAKE,
    CMD_COLORS,
    CMD_IMAGE,
    CMD_INFO,
    CMD_COMPARE,
    CMD_ENV,
    CMD_MATERIAL,
    N_COMMAND
};
enum { MAX_INPUT = 2, MAX_OPAQUE = 64, MAX_ENV = 16 };

struct vector_option {
    bool set;
    float v[3];
};

/* The parsed command line. Absent options are NULL, 0 or false unless a comment says otherwise.
 */
struct options {
    enum command command;
    const char *input[MAX_INPUT];
    unsigned n_input;
    const char *out, *env, *engine, *term, *transport, *storage, *basis, *camera, *animation,
        *variant, *cpu, *scattering, *exit;
    const char *tone, *background, *layout, *orbit, *up, *checkpoint, *cache, *faces;
    const char *opaque[MAX_OPAQUE + 1];
    unsigned n_opaque;
    const char *material[PRT_MEDIA_MAX]; /* "[OBJECT=]NAME|FILE" */
    unsigned n_material;
    const char *envs[MAX_ENV]; /* compare: every --env; env is the first */
    unsigned n_env;
    const char *materials;                          /* compare: --materials */
    const char *albedo_map, *normal_map, *bump_map; /* image: of --engine tangent */
    double size_mm, mm_per_unit, rotate_deg, max_error, max_rmse, exposure_ev, budget_ms,
        bump_mm, time_s, texture_split;
    uint64_t rank, coeffs, basis_coeffs, phase_terms, samples, rays, single_points, seed, walks;
    uint64_t threads, msaa, quality, vertices, memory, checkpoint_room, cache_room;
    bool memory_set, flip_v, estimate, accept_weak_sandbox;
    uint32_t cube; /* 0: not given */
    bool cube_full;
    struct vector_option eye;
    uint32_t width, height; /* --size; height 0 when only one number was given */
    uint32_t shard, n_shard;
    int progress_fd; /* -1: not given */
    bool max_rmse_set;
    bool json, quiet, profile, draft, no_single, exit_planes, any_eta, every_ray, straight,
        full_float, measure_error, no_textures, floor;
};

/* Fills `out` from the program's arguments. Returns -1 to go on, else the exit status: after
 * --help or --version, or after a message about wrong usage. */
int options_parse(int argc, char **argv, struct options *out);
/* Prints one error line that ends with the place of the help; returns EXIT_USAGE. */
int usage_error(const struct options *options, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
/* Parses "x,y,z" into three finite numbers; false when it is anything else. */
bool parse_vector(const char *text, float v[3]);

/* A run of the program. */
struct tool {
    struct options opt;
    struct prt_context ctx;
};
/* Starts log, progress bar, signals and threads. Returns an exit status, or -1 to go on. */
int tool_begin(struct tool *tool);
void tool_end(struct tool *tool);
/* Library status to exit status; prints an error line if none was printed yet. */
int tool_exit(const struct tool *tool, int status);
/* Checks before long work that `path` can be created: 0, or EXIT_FAILED after a message. */
int check_writable(const struct tool *tool, const char *path);

/* Ends the run with an error when it holds more than `bytes` of memory (0: any amount), or when
 * RLIMIT_DATA is about to be reached: the progress callback then cancels the bake. Returns an
 * exit status. */
int memory_watch(struct tool *tool, uint64_t bytes);
bool memory_is_over(void); /* the progress callback has to cancel */
/* Stops watching. status: of the library call that was watched; returns the exit status. */
int memory_watch_end(int status);

/* A SOURCE of the command contract. */
struct source {
    const char *path;
    struct prt_file *file;                 /* of a .prt, else NULL */
    const struct prt_transport *transport; /* of a .prt, else NULL */
    struct prt_mesh *loaded;               /* of a model, else NULL */
    const struct prt_mesh *mesh;           /* in mm */
    struct prt_media media;                /* --material, the file's own, or the baked ones;
                                              zeroed: none */
    bool media_given;                      /* by --material */
    struct prt_media *made;                /* memory of media, or NULL */
    struct prt_variant *variant;           /* of a .prt: --variant; `mesh` is its mesh */
    struct prt_mesh plain; /* of a .prt: --no-textures; shares `mesh`'s arrays */
};
/* Another program's material and its medium as JSON; the caller deletes it. */
struct cJSON *describe_import(const struct prt_import *item);
/* Makes source->media of a model from --material and the file's own materials, and divides
 * objects of several media. fallback: as source_open. Returns an exit status. */
int source_media(struct tool *tool, struct source *source, const struct prt_material *fallback);
/* The same of a .prt: --material in place of baked media, or of its variant's. */
int source_media_edit(struct tool *tool, struct source *source);
/* Opens SOURCE and checks it by the contract. fallback: the medium of a model's objects that
 * neither --material nor the file gives one; NULL: wrong usage. Returns an exit status. */
int source_open(struct tool *tool, const char *path, const struct prt_material *fallback,
                struct source *out);
void source_close(struct source *source);
/* How --opaque and --up have a model read. */
struct prt_mesh_options source_mesh_options(const struct options *options);
/* Name of the engine that the transport was baked for. */
const char *source_engine_name(const struct prt_transport *transport);
/* Error of a .prt's radial bases for --material (0 for the baked one). Returns an exit status:
 * an error above the limit is refused with the parameter and its range. */
int source_material_error(struct tool *tool, const struct source *source, const char *term,
                          double *error);
enum prt_answer_term answer_term(const char *word); /* NULL: total */
enum prt_exit exit_option(const struct options *o);
/* Loads an environment, its faces read as --faces says. Library status. */
int tool_env_load(const struct tool *tool, const char *path, struct prt_env **out);
/* Resamples env, turned by --rotate, to an n-cube. n = 0: the resolution of --cube (full: the
 * file's own), else the .prt's, else 32. Returns an exit status. */
int source_light(struct tool *tool, const struct source *source, const struct prt_env *env,
                 uint32_t n, struct prt_cube *out);
/* Loads the preset, file or JSON text `name` that --`option` (NULL: an operand) gave. Returns
 * an exit status. */
int material_named(struct tool *tool, const char *option, const char *name,
                   struct prt_material *out);
/* Whether a .prt was baked by random walks. */
bool source_has_walks(const struct source *source);
/* The reference engine's options by the command line; term NULL: total; eye [3] mm or NULL.
 * Without --scattering it scatters as the .prt was baked. */
struct prt_reference_options reference_options(const struct options *o,
                                               const struct source *source, const char *term,
                                               const float *eye_mm);
/* Reference colours of a term for the whole mesh; eye in mm or NULL. noise: the relative
 * standard error of walks over all vertices, 0 without walks; may be NULL. Returns an exit
 * status. */
int reference_term(struct tool *tool, const struct source *source, const struct prt_cube *light,
                   const char *term, const float *eye_mm, float (*color)[3], double *noise);
/* sqrt(sum error^2 / sum color^2) over n values. */
double relative_noise(const float *error, const float *color, size_t n);

/* Colours [n_vertex][3] as CSV, NPY, PLY or GLB by the path's ending. Library status. */
int output_colors(const struct prt_context *ctx, const char *path, const struct prt_mesh *mesh,
                  const float (*color)[3]);
/* The usage error of -o with an ending of no picture: "`things` are written as …". */
int picture_path_error(const struct options *options, const char *things);
/* Writes a linear picture; prt_picture_format has a format for the path. Library status. */
// Whether pictures go to the terminal: "-".
bool is_terminal_path(const char *path);
int output_image(const struct prt_context *ctx, const char *path, const struct prt_image *image,
                 const struct prt_picture_options *options);
/* Colours of a .csv or .npy [n][3]; caller prt_free()s. Library status. */
int table_load(const struct prt_context *ctx, const char *path, float **rgb, size_t *n);

/* Integral of radiance over the sphere, RGB [W m^-2]. */
void env_power(const struct prt_env *env, double power[3]);
void cube_power(const struct prt_cube *cube, double power[3]);

/* [n] distinct file vertices, ascending, the same for the same seed; NULL without memory. */
uint32_t *pick_vertices(uint32_t n_vertex, uint32_t n, uint64_t seed);
/* [*n] vertices that an eye [mm] sees: they face it, and nothing lies between. NULL after a
 * message; the caller prt_free()s. */
uint32_t *seen_vertices(const struct tool *tool, const struct prt_mesh *mesh,
                        const float eye[3], uint32_t *n);
/* prt compare A.prt reference with --materials or several --env: media x lights. */
int compare_table(struct tool *tool);
/* A polynomial .prt answers for one light: refuses another --env or --rotate, for which the
 * reference engine would answer. EXIT_DONE for other transports. */
int check_own_light(const struct tool *tool, const struct source *of);

int run_bake(struct tool *tool);
int run_colors(struct tool *tool);
int run_image(struct tool *tool);
int run_info(struct tool *tool);
int run_compare(struct tool *tool);
int run_env(struct tool *tool);
int run_material(struct tool *tool);

#endif
