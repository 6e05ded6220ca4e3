/* SPDX-License-Identifier: MIT */
/* cli.h declares the functions and types that the files of the relight program share. */
#ifndef RELIGHT_CLI_H
#define RELIGHT_CLI_H

#include "common/picture_ending.h"
#include "common/program.h"
#include "relight/relight.h"
#include "vertex_file.h"

#include <cjson/cJSON.h>
#include <stdio.h>

enum { MAX_WORDS = 16 };

/* Every option of every command; a command's table says which it takes. */
struct options {
    const char *server, *token, *ca;
    char *own_token; /* copy of --token, owned */
    double timeout_s;
    bool json;
    const char *command, *target, *output; /* target: ID, MODEL, JOB or FILE */
    const char *env[MAX_WORDS];
    float rotate_deg[MAX_WORDS], gain[MAX_WORDS][3];
    size_t n_env, n_rotate, n_gain;
    struct relight_shade shade;
    char *material; /* text of shade.material, owned */
    struct relight_object_material materials[RELIGHT_MAX_MATERIAL]; /* by object, owned */
    size_t n_material;
    const char *map[3]; /* files of albedo, normals, heights; their uploads */
    char map_hash[3][65];
    enum relight_color_format format;
    struct relight_picture picture;
    enum relight_priority priority;
    struct relight_load load; /* name, scale, bake, pin */
    const char *opaque[MAX_WORDS];
    const char *positions, *normals; /* .npy files of update-vertices */
    uint32_t first;
    struct relight_token_order token_order;
    const char *scopes;
    const char *animation, *pose;
    float animation_time;
    const char *words[MAX_WORDS]; /* arguments after the target */
    unsigned n_word;
    const char *as, *role, *at, *model, *layout; /* of rooms */
    uint32_t revision, decision;
    bool given[256]; /* by the option's key */
    bool wait, files, remote, forget, force, own_units, follow;
};

struct command {
    const char *name, *args, *doc;
    const char *takes; /* keys of the options it takes, see options.c */
    bool has_target;
    int (*run)(struct relight_client *client, struct options *options);
};
extern const struct command commands[]; /* ends with name NULL */

/* options.c: parses argv; exits with EXIT_USAGE on wrong usage. */
const struct command *options_parse(int argc, char **argv, struct options *options);
void options_finish(struct options *options);
/* Materials in files of other programs become JSON by the daemon. An exit status. */
int options_materials(struct relight_client *client, struct options *options);

/* report.c */
/* Prints an error and returns the exit status it calls for. */
int report_error(const struct options *options, const struct relight_error *error);
int report_usage(const struct options *options, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
/* Text of the daemon for a terminal, where an escape sequence in a name could rewrite the
 * screen: control characters become \xNN. print_text prints all of it; escape() keeps what
 * fits. */
struct escaped {
    char text[512];
};
struct escaped escape(const char *text);
void print_text(FILE *file, const char *text);
/* The length of a text, at most `most` bytes, without part of a character at its end. */
size_t whole_characters(const char *text, size_t most);
void print_json(cJSON *json); /* one line on stdout; deletes it */
/* Numbers with the digits that a float has. */
void add_float(cJSON *json, const char *key, double x);
void add_floats(cJSON *json, const char *key, const float x[3]);
/* A relight_progress_fn: bar on stderr when that is a terminal, nothing otherwise. */
int progress_bar(void *user, const struct relight_progress *progress);
void progress_clear(void);

/* output.c: files, written to a temporary file that is renamed. 0 or EXIT_FAILED, reported. */
int write_file(const struct options *options, const char *path, const void *bytes, size_t n);
/* Pictures in the terminal: whether `path` is "-"; the size of a picture for it, where --size
 * gives none; drawing one of IMAGE_RGB8. */
bool is_terminal_path(const char *path);
void fit_terminal(struct options *options);
int draw_in_terminal(const struct options *options, const struct relight_image *image);
/* The usage error of an -o whose ending is none of `others` ("" or ".csv, ") and of pictures.
 */
int picture_usage(const struct options *options, const char *others);
/* Reads a .npy of little-endian f32 or f64 [n][3]; *out is malloc()ed. 0 or EXIT_FAILED,
 * reported. */
int read_npy(const struct options *options, const char *path, uint32_t *n, float **out);
/* Writes rgb [n][3] or NULL, in the format of the path's ending; for CSV and NPY of colours
 * geometry may be empty. 0 or EXIT_FAILED, reported. */
int write_vertices(const struct options *options, const char *path, uint32_t n,
                   const float *rgb, const struct relight_geometry *geometry);

const char *job_name(enum relight_job_state state); /* "queued", …: model_commands.c */

/* The commands. */
int run_ping(struct relight_client *client, struct options *options);
int run_models(struct relight_client *client, struct options *options);
int run_load(struct relight_client *client, struct options *options);
int run_info(struct relight_client *client, struct options *options);
int run_watch(struct relight_client *client, struct options *options);
int run_cancel(struct relight_client *client, struct options *options);
int run_env(struct relight_client *client, struct options *options);
int run_colors(struct relight_client *client, struct options *options);
int run_image(struct relight_client *client, struct options *options);
/* Writes a picture to -o, or draws it in the terminal, and tells of it, with --json as JSON. */
int put_picture(const struct options *options, const struct relight_image *image);
int run_edit(struct relight_client *client, struct options *options);
int run_geometry(struct relight_client *client, struct options *options);
int run_update(struct relight_client *client, struct options *options);
int run_pose(struct relight_client *client, struct options *options);
int run_unload(struct relight_client *client, struct options *options);
int run_room(struct relight_client *client, struct options *options);
int run_token(struct relight_client *client, struct options *options);
int run_sign(struct relight_client *client, struct options *options);
int run_events(struct relight_client *client, struct options *options);
int run_download(struct relight_client *client, struct options *options);
int run_stats(struct relight_client *client, struct options *options);

#endif
