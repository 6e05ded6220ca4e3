/* SPDX-License-Identifier: MIT */
/* materials.h owns materials as clients say them: what takes long to work out (layered slabs,
 * some 0.1 s) is worked out once, on a worker, before the request that names it goes on. */
#ifndef RELIGHTD_MATERIALS_H
#define RELIGHTD_MATERIALS_H

#include "prt/medium.h"
#include "core/server.h"

struct request;

/* A preset's name or JSON text; error says what is wrong. Returns an enum prt_status. */
int material_resolve(struct server *server, const char *text, struct prt_material *material,
                     bool *preset, char error[300]);

/* Names what a material looks like, whatever it is called. Cryptographic, 128 bits: clients
 * share what was computed for a key, and none may make another's on purpose. */
enum { MATERIAL_KEY = 33 };
void material_key(const struct prt_material *material, char key[MATERIAL_KEY]);

/* Calls run(request), now or when the material of this text is known: material_resolve is quick
 * then. views: the request keeps its place among what its connection says of its views. */
void material_then(struct request *request, const char *text, bool views,
                   void (*run)(struct request *request));
/* The connection closes: what it said of its views is done by nobody. */
void materials_drop(struct connection *conn);

#endif
