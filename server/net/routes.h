/* SPDX-License-Identifier: MIT */
/* routes.h owns what the table of the API (routes.c) names: pages that need no operation, and
 * the functions that turn an operation's answer into HTTP (route_answers.c). Loop thread only.
 */
#ifndef RELIGHTD_ROUTES_H
#define RELIGHTD_ROUTES_H

#include "net/exchange.h"

#include <cjson/cJSON.h>

/* Values of x->format for colours: those of the protocol, then files made of F32. */
enum { COLORS_CSV = 4, COLORS_NPY, COLORS_N_FORMAT };

/* false, with the problem, where a JSON body says another thing than the path or the query. */
bool route_body_agrees(struct exchange *x, const cJSON *body, struct http_problem *problem);

/* Whether a signed link may have the path: it is a picture's. */
bool route_is_signable(const char *path);

bool page_health(struct exchange *x, struct http_problem *problem);
bool page_ready(struct exchange *x, struct http_problem *problem);
bool page_metrics(struct exchange *x, struct http_problem *problem);
bool page_openapi(struct exchange *x, struct http_problem *problem);

/* A file of the page (net/page_files.c). */
bool page_file(struct exchange *x, struct http_problem *problem);

void answer_json(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload);
void answer_load(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload);
void answer_image(struct exchange *x, const ProtobufCMessage *message, bool last,
                  struct payload *payload);
void answer_environment(struct exchange *x, const ProtobufCMessage *message, bool last,
                        struct payload *payload);
void answer_colors(struct exchange *x, const ProtobufCMessage *message, bool last,
                   struct payload *payload);
void answer_events(struct exchange *x, const ProtobufCMessage *message, bool last,
                   struct payload *payload);
void answer_room(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload);
void answer_blob(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload);

#endif
