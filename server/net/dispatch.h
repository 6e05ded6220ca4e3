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

/* Calls fn once the model of this name is open; fn holds `file` no longer than its call, unless
 * it holds the entry itself. Answers the request with an error where there is none. */
typedef void (*with_model_fn)(struct request *request, struct model *model,
                              struct cache_entry *file);
void with_model(struct request *request, const char *model, with_model_fn fn);
/* The same with the file that has the mesh, baked or not; and with the geometry as it is now:
 * the entry's value is then a struct shape. */
void with_mesh(struct request *request, const char *model, with_model_fn fn);
void with_shape(struct request *request, const char *model, with_model_fn fn);

/* One row an operation (dispatch.c): all that is special about a type of request. */
enum operation_flag {
    OPERATION_BEFORE_HELLO = 1,
    OPERATION_WHILE_DRAINING = 2, /* finishes what is under way, or says how it is */
    OPERATION_LONG = 4,           /* open as long as the client likes: counted as LONG_REQUESTS,
                                     no deadline but the client's own */
    OPERATION_ENDS_AT_DRAIN = 8,  /* would never end by itself */
    OPERATION_ALWAYS = 16,        /* taken when all is full: it frees something, or says so */
    OPERATION_ORDERED = 32,       /* what a connection says of its views keeps its order */
};
struct operation {
    void (*run)(struct request *request);
    unsigned flags;
    size_t max_payload; /* bytes; 0: it takes none */
    /* The text of the material it names, "" for none. NULL: it never does. */
    const char *(*material)(const ProtobufCMessage *message);
};
/* NULL for an unknown type. */
const struct operation *operation_of(uint16_t type);

/* op_basic.c, op_evaluate.c, op_view.c, op_update_vertices.c: one function an operation;
 * models_load is store/models.h's. */
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
void op_colors(struct request *request);
void op_image(struct request *request);
void op_view_open(struct request *request);
void op_view_set(struct request *request);
void op_view_close(struct request *request);
void op_update_vertices(struct request *request);
void op_unload(struct request *request);
void op_stats(struct request *request);

#endif
