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

/* op_basic.c, op_evaluate.c, op_view.c: one function an operation */
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
