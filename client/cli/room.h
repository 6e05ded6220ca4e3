/* SPDX-License-Identifier: MIT */
/* Functions that several commands of `relight room` call. */
#ifndef RELIGHT_CLI_ROOM_H
#define RELIGHT_CLI_ROOM_H

#include "cli.h"

struct room_call {
    struct relight_client *client;
    struct options *options;
    struct relight_error error;
    char room[RELIGHT_ROOM]; /* "" for verbs without one */
    const char *me;          /* display name */
    const char *const *word; /* after the room, or after the verb */
    unsigned n_word;
    unsigned n_left_out; /* export: parts that could not be made */
};

/* Each returns an exit status after reporting. */
int room_failed(struct room_call *c); /* reports c->error */
int room_list(struct room_call *c);
int room_show(struct room_call *c);
int room_compare(struct room_call *c);
int room_anchors(struct room_call *c);
int room_log(struct room_call *c);
int room_watch(struct room_call *c);
int room_export(struct room_call *c);
int room_import(struct room_call *c);

/* The room's state, deleted by the caller with cJSON_Delete. NULL after reporting. */
cJSON *room_state(struct room_call *c);
/* Does an action, which is deleted. out may be NULL. */
int room_act(struct room_call *c, cJSON *action, struct relight_room_edited *out);
/* An action with one field: its value is deleted with it. */
cJSON *room_action(const char *field, cJSON *value);

/* room_scene.c: the scene that the options describe. parts: names of the parts that they set;
 * it is deleted by the caller. */
int room_scene(struct room_call *c, cJSON **scene, cJSON **parts);

/* The camera as a field of a scene. */
void room_add_camera(cJSON *scene, const struct relight_camera *camera);

/* room_anchor.c: points of the surface of GEOMETRY. */
struct room_point {
    uint32_t object, triangle;
    double weight[2]; /* of the second and the third corner */
    double position[3];
    double distance; /* of the surface from the p of room_nearest, in the model's units */
};
/* Fills all but the distance from triangle and weights. */
void room_point_fill(const struct relight_geometry *geometry, struct room_point *point);
/* The nearest one to p; the geometry has a triangle. */
void room_nearest(const struct relight_geometry *geometry, const double p[3],
                  struct room_point *out);
/* Returns the diagonal. */
double room_bounds(const struct relight_geometry *geometry, double low[3], double high[3]);
/* SurfacePoint. */
cJSON *room_point_json(const struct room_point *point);

/* bcf_view.c: the camera of a BCF viewpoint. */
struct bcf_view {
    double eye[3], direction[3], up[3]; /* metres, +y up; direction of unit length */
    double fovy_deg;                    /* 0: not known */
    double height;                      /* of an orthogonal view, in metres; 0: perspective */
};
/* The JSON of a .bcfv file; NULL: it has no camera. */
cJSON *bcf_view_read(const void *bytes, size_t n);
/* False: json is none. */
bool bcf_view_of(const cJSON *json, struct bcf_view *out);

/* room_view.c: *at is the point where the ray through the centre of the view meets the model.
 * Where it misses, *at is the point of the model nearest to that ray's closest approach to the
 * model's centre. *camera is the view's camera. Both
 * are in the model's own units. False: eye and target are the same point when rounded to
 * floats. */
bool room_look(const struct relight_geometry *geometry, const struct bcf_view *view,
               struct room_point *at, struct relight_camera *camera);

/* Fields of JSON that the daemon sent; 0, "" or NULL where they are missing. */
const char *text_of(const cJSON *json, const char *field);
double number_of(const cJSON *json, const char *field);
const cJSON *list_of(const cJSON *json, const char *field);
/* Time in microseconds as "2026-11-22 21:04" (local), or as "2026-11-22T21:04:05Z". */
void print_time(char out[32], double time_us);
void print_utc(char out[32], double time_us);
/* The author of a stamp: the display name, else the principal. */
const char *author_of(const cJSON *stamp);
/* The item whose stamp has this sequence; NULL. */
const cJSON *item_of(const cJSON *list, double sequence);
/* A whole number of a word; false for anything else. */
bool whole_word(const char *word, uint64_t *out);

/* room_material.c: the approved material for other programs, into the folder of -o. */
int export_material(struct room_call *c, const cJSON *state);

/* room_verdict.c: the revision, model and bake that the room shows now, to be compared with
 * those that a decision was made about. */
struct room_now {
    unsigned revision; /* number of the revision that the scene is; 0: it was not saved */
    char model[40], mesh_hash[20], bake_hash[20]; /* of the scene's model; "": not known */
};
/* Asks the daemon about the model. */
void room_now(struct room_call *c, const cJSON *state, struct room_now *out);
/* Of a newer state: the revision alone. */
void room_now_scene(const cJSON *state, struct room_now *out);
/* What happened to the model since the decision, in words; "": nothing, or it is not known. */
const char *room_model_change(const cJSON *decision, const struct room_now *now);
/* Whether the room still shows the revision, mesh and bake that the decision was made about. */
bool room_stands(const cJSON *decision, const struct room_now *now);

/* room_export.c: a part of an export failed with c->error. Where the fault is in the part
 * itself (its model is gone, say) it is told and counted, and EXIT_DONE lets the export go on.
 */
int room_left_out(struct room_call *c, const char *name);

enum { ROOM_NOT_DRAWN = -1 }; /* instead of an exit status; c->error says why */
/* room_compare.c: a decision's picture against the scene now, as a sheet in a PNG file; prints
 * the numbers. Also ROOM_NOT_DRAWN. */
int room_write_change(struct room_call *c, uint64_t decision, const char *path);

/* room_strokes.c: a pin's picture with its strokes, in a PNG file; without strokes nothing. */
int room_write_strokes(struct room_call *c, const cJSON *state, double pin, const char *path);

/* bcf.c: pins as a BCF 2.1 file, and back. A topic of another program has `view` if it has a
 * viewpoint: the fields of struct bcf_view. */
int bcf_write(struct room_call *c, const cJSON *state, const char *path);
int bcf_read(struct room_call *c, const char *path, cJSON **topics);

#endif
