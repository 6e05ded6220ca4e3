/* SPDX-License-Identifier: MIT */
/* dispatch.h owns the way from a frame to its operation. */
#ifndef RELIGHTD_DISPATCH_H
#define RELIGHTD_DISPATCH_H

#include "net/connection.h"

struct model;
struct cache_entry;

/* A frame came in; the payload (malloc()ed, may be NULL) is taken. */
void dispatch_frame(struct connection *conn, const struct relight_frame *frame,
                    uint8_t *payload);

/* Whether the caller has these scopes (enum access_scope); if not, the request is answered with
 * ERROR_FORBIDDEN, which names the missing scope. Each operation's row states the scopes that
 * it always needs; an operation calls this for those that depend on the request. */
bool operation_allowed(struct request *request, unsigned scopes);

/* Whether the caller owns what it acts on, or has the scope admin; if not, the request is
 * answered with ERROR_FORBIDDEN. owner: a principal's name. what: its name for the error. */
bool operation_owned(struct request *request, const char *owner, const char *what);

/* Calls fn once the model of this name is open; fn holds `file` no longer than its call, unless
 * it holds the entry itself. Answers the request with an error where there is none. */
typedef void (*with_model_fn)(struct request *request, struct model *model,
                              struct cache_entry *file);
void with_model(struct request *request, const char *model, with_model_fn fn);
/* with_mesh: the file that has the mesh, baked or not. with_shape: the current geometry, or
 * that of a named pose, in a variant ("": none); the entry's value is a struct shape. */
void with_mesh(struct request *request, const char *model, with_model_fn fn);
void with_shape(struct request *request, const char *model, const char *pose,
                const char *variant, with_model_fn fn);

/* The properties of a type of request, from its line in OPERATION_LIST. */
enum operation_flag {
    OPERATION_BEFORE_HELLO = 1,
    OPERATION_WHILE_DRAINING = 2, /* ends or reports work that is running */
    OPERATION_LONG = 4,           /* open until the client ends it: counted as LONG_REQUESTS,
                                     no deadline but the client's own */
    OPERATION_ENDS_AT_DRAIN = 8, /* does not end by itself: the daemon ends it when it drains */
    OPERATION_ALWAYS = 16,       /* accepted beyond the limits: it frees or reports resources */
    OPERATION_GUEST = 64,        /* also for those who come with an invitation to a room */
    OPERATION_ORDERED = 32,      /* requests of a connection about views run in their order */
};
struct material_texts;
struct operation {
    void (*run)(struct request *request);
    unsigned flags;
    unsigned scopes;    /* that the caller needs: enum access_scope */
    size_t max_payload; /* bytes; 0: no payload is allowed */
    /* Adds the texts of the materials it names. NULL: its message has no material. */
    void (*materials)(const ProtobufCMessage *message, struct material_texts *texts);
    /* One-way types, instead of run: no request is created and nothing is answered. */
    void (*take)(struct connection *conn, const ProtobufCMessage *message);
};
/* NULL for an unknown type. */
const struct operation *operation_of(uint16_t type);

/* Every operation: its request's message as frame.h's list names it, the function that
 * runs it, its flags (enum operation_flag without OPERATION_), the scopes that its caller needs
 * (enum access_scope without SCOPE_; 0: none), its largest payload in bytes (0: none; ANY: as
 * much as a frame takes; a larger one is answered with LIMIT), and the function of dispatch.c
 * that adds the texts of the materials that its message names (NULL: it names none). */
#define OPERATION_LIST(X)                                                                 \
    X(hello_request, op_hello, BEFORE_HELLO | ALWAYS | GUEST, 0, 0, NULL)                 \
    X(ping_request, op_ping, DRAINING | ALWAYS | GUEST, 0, MAX_PING, NULL)                \
    X(list_request, op_list, 0, VIEW, 0, NULL)                                            \
    X(put_blob_request, op_put_blob, 0, UPLOAD, ANY, NULL)                                \
    X(env_request, op_env, GUEST, VIEW, 0, NULL)                                          \
    X(load_request, models_load, 0, UPLOAD, 0, load_materials)                            \
    X(watch_request, op_watch, LONG, VIEW, 0, NULL)                                       \
    X(cancel_job_request, op_cancel_job, DRAINING | ALWAYS, EDIT, 0, NULL)                \
    X(cancel_request, op_cancel, DRAINING | ALWAYS | GUEST, 0, 0, NULL)                   \
    X(info_request, op_info, GUEST, VIEW, 0, NULL)                                        \
    X(geometry_request, op_geometry, GUEST, VIEW, 0, NULL)                                \
    X(colors_request, op_colors, GUEST, VIEW, ANY, colors_materials)                      \
    X(image_request, op_image, GUEST, VIEW, ANY, image_materials)                         \
    X(view_open_request, op_view_open, LONG | ENDS | ORDERED | GUEST, VIEW, ANY,          \
      view_open_materials)                                                                \
    X(view_set_request, op_view_set, ORDERED | GUEST, VIEW, ANY, view_set_materials)      \
    X(view_close_request, op_view_close, DRAINING | ALWAYS | ORDERED | GUEST, 0, 0, NULL) \
    X(update_vertices_request, op_update_vertices, 0, EDIT, ANY, NULL)                    \
    X(unload_request, op_unload, 0, EDIT, 0, NULL)                                        \
    X(stats_request, op_stats, DRAINING, VIEW, 0, NULL)                                   \
    X(subscribe_request, op_subscribe, LONG | ENDS | GUEST, VIEW, 0, NULL)                \
    X(token_create_request, op_token_create, 0, ADMIN, 0, NULL)                           \
    X(token_list_request, op_token_list, 0, ADMIN, 0, NULL)                               \
    X(token_revoke_request, op_token_revoke, 0, ADMIN, 0, NULL)                           \
    X(get_blob_request, op_get_blob, 0, VIEW, 0, NULL)                                    \
    X(put_pose_request, op_put_pose, 0, VIEW, ANY, NULL)                                  \
    X(factors_request, op_factors, GUEST, VIEW, 0, NULL)                                  \
    X(material_request, op_material, GUEST, VIEW, 0, own_material)                        \
    X(room_create_request, op_room_create, 0, EDIT, 0, NULL)                              \
    X(room_list_request, op_room_list, GUEST, VIEW, 0, NULL)                              \
    X(room_get_request, op_room_get, GUEST, VIEW, 0, NULL)                                \
    X(room_edit_request, op_room_edit, GUEST, VIEW, 0, NULL)                              \
    X(room_picture_request, op_room_picture, GUEST, VIEW, 0, NULL)                        \
    X(room_backup_request, op_room_backup, 0, ADMIN, 0, NULL)                             \
    X(sign_request, op_sign, 0, VIEW, 0, NULL)

/* One-way types: message, function, flags. No request is created and nothing is answered. */
#define ONE_WAY_LIST(X)                                  \
    X(room_presence_request, take_room_presence, ALWAYS) \
    X(view_ack, take_view_ack, ALWAYS)

#define X(message, run, ...) void run(struct request *request);
OPERATION_LIST(X)
#undef X
#define X(message, take, flags) \
    void take(struct connection *conn, const ProtobufCMessage *header);
ONE_WAY_LIST(X)
#undef X
void room_subscribe(struct request *request); /* SUBSCRIBE with `room` */

#endif
