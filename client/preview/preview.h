/* SPDX-License-Identifier: MIT */
/* preview.h declares the functions and types that the files of relight-preview share. */
#ifndef RELIGHT_PREVIEW_H
#define RELIGHT_PREVIEW_H

#include "common/program.h"
#include "prt/media.h"
#include "prt/picture.h"
#include "relight/relight.h"

enum { MAX_ENV = 16, MAX_TRY = 32 };

struct options {
    const char *server, *model, *output;
    const char *follow;                  /* --follow: a room, in place of model and env; NULL */
    const char *material[PRT_MEDIA_MAX]; /* [OBJECT=]NAME|FILE */
    unsigned n_material, n_try;
    const char *variant;          /* --variant: of the model's file; NULL: the bake's own */
    const char *attempt[MAX_TRY]; /* --try: each gives a column, in place of frames */
    const char *env[MAX_ENV];
    size_t n_env;
    double rotate_deg, timeout_s;
    uint32_t n_frame; /* --follow: 0, no limit */
    uint32_t width, height, samples, gap;
    double fps;
    bool difference; /* of two pictures, in place of them */
    bool turn_light, sheet, json, no_specular, plain, no_textures, transparent;
    bool look_given; /* one of the options that --follow does not take */
    float background[3], exposure_ev;
    int quality;
    enum prt_tone tone;
    struct prt_camera camera; /* automatic: frame the model */
    struct prt_orbit orbit;   /* zoom 0: not given */
    const char *camera_name;  /* of the model's file; NULL: none */
    enum relight_color_format format;
};
void options_parse(int argc, char **argv, struct options *options);

/* One environment, for the daemon and for drawing. */
struct sky {
    char word[80];       /* for the daemon */
    struct prt_env *env; /* NULL: the daemon's image; no background, no reflections */
};

/* The fetched model: geometry in mm, media by object. */
struct scene {
    struct relight_client *client;
    const struct options *options;
    struct prt_context ctx;
    struct relight_geometry geometry;
    struct prt_mesh mesh;    /* arrays of its own */
    struct prt_media *media; /* by object: the model's own, edited by options->material */
    /* options->material for the daemon: JSON texts, owned; `shade` points into them */
    char *text[PRT_MEDIA_MAX];
    char object[PRT_MEDIA_MAX][128];
    struct relight_object_material given[PRT_MEDIA_MAX];
    struct relight_shade shade;
    bool anisotropic;        /* a g is not 0 */
    bool exit_planes;        /* the bake has them */
    struct prt_camera named; /* options->camera_name's */
    struct sky sky[MAX_ENV];
};
/* Return exit statuses; errors are reported. */
int scene_fetch(struct scene *scene);
/* Textures of the fetched geometry into scene->mesh, checked; texels are fetched. */
int scene_textures(struct scene *scene);
void scene_textures_finish(struct scene *scene);
/* Media of the fetched geometry with options->material and, unless it is NULL, `more` of the
 * same form; those of an earlier call are dropped. */
int scene_media(struct scene *scene, const char *more);
void scene_media_finish(struct scene *scene);
void scene_finish(struct scene *scene);

/* Planes of prt_shade: value[n][n_vertex][3], prt_free()d; zeroed before the first use. */
struct planes {
    unsigned n;
    float *value;
};

/* Colours without outgoing Fresnel under one light, as planes: one answer serves every camera.
 * begin sends, end waits and replaces *out: other work fits between. */
struct colors_pending {
    uint64_t id;
    bool begun;
};
int scene_colors_begin(struct scene *scene, const struct sky *sky, double rotate_deg,
                       struct colors_pending *pending);
int scene_colors_end(struct scene *scene, struct colors_pending *pending, struct planes *out);

/* Columns of a sheet: frames, or --try. */
static inline uint32_t options_columns(const struct options *o)
{
    return o->n_try ? o->n_try : o->n_frame;
}

/* Draws every frame and writes the files. */
int draw_all(struct scene *scene);

int report(const struct relight_error *error);
/* Prints a line for a file that was written. */
void print_written(const struct options *options, const char *path, uint32_t width,
                   uint32_t height);

#endif
