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

/* One row an operation (dispatch.c): the properties of a type of request. */
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

/* op_basic.c, op_jobs.c, op_evaluate.c, op_events.c, op_view.c, op_update_vertices.c: one
 * function an operation; models_load is store/models.h's. */
void op_hello(struct request *request);
void op_ping(struct request *request);
void op_list(struct request *request);
void op_put_blob(struct request *request);
void op_env(struct request *request);
void op_watch(struct request *request);
void op_cancel_job(struct request *request);
void op_cancel(struct request *request);
void op_info(struct request *request);
void op_geometry(struct request *request);
void op_factors(struct request *request);
void op_sign(struct request *request);
void op_colors(struct request *request);
void op_image(struct request *request);
void op_view_open(struct request *request);
void op_view_set(struct request *request);
void op_view_close(struct request *request);
void op_update_vertices(struct request *request);
void op_unload(struct request *request);
void op_stats(struct request *request);
void op_token_create(struct request *request);
void op_token_list(struct request *request);
void op_token_revoke(struct request *request);
void op_subscribe(struct request *request);
void op_get_blob(struct request *request);
void op_put_pose(struct request *request);
void op_material(struct request *request);
void op_room_create(struct request *request);
void op_room_list(struct request *request);
void op_room_get(struct request *request);
void op_room_edit(struct request *request);
void op_room_picture(struct request *request);
void op_room_backup(struct request *request);
void room_subscribe(struct request *request); /* SUBSCRIBE with `room` */
void take_room_presence(struct connection *conn, const ProtobufCMessage *message);
void take_view_ack(struct connection *conn, const ProtobufCMessage *message);

#endif
