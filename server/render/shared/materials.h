/* SPDX-License-Identifier: MIT */
/* materials.h owns materials as clients say them: what takes long to work out (layered slabs,
 * some 0.1 s) is worked out once, on a worker, before the request that names it goes on. */
#ifndef RELIGHTD_MATERIALS_H
#define RELIGHTD_MATERIALS_H

#include "prt/medium.h"
#include "core/server.h"

struct cache_entry;

/* A preset's name or JSON text; error says what is wrong. Returns an enum prt_status. */
int material_resolve(struct server *server, const char *text, struct prt_material *material,
                     bool *preset, char error[300]);

/* Names what a material looks like, whatever it is called. Cryptographic, 128 bits: clients
 * share what was computed for a key, and none may make another's on purpose. */
enum { MATERIAL_KEY = 33 };
void material_key(const struct prt_material *material, char key[MATERIAL_KEY]);

/* Has a worker read a material that takes long; NULL for one that does not. material_resolve is
 * quick once the entry is ready. With a reference for the caller. */
struct cache_entry *material_prepare(struct server *server, const char *text);

#endif
