/* SPDX-License-Identifier: MIT */
/* materials.h owns materials as clients name them: a preset's name or JSON text. Texts that
 * take long to parse (layered slabs, some 0.1 s) are parsed once, on a worker, before the
 * operation of the request runs. */
#ifndef RELIGHTD_MATERIALS_H
#define RELIGHTD_MATERIALS_H

#include "prt/medium.h"
#include "core/server.h"
#include "relight.pb-c.h"

struct request;

/* The texts of the materials that a message names; they belong to it. */
enum { MATERIAL_TEXTS = 1 + PRT_MEDIA_MAX };
struct material_texts {
    size_t n;
    const char *text[MATERIAL_TEXTS];
};
/* Appends a text, if it is not empty; texts above the limit, which the operation refuses, are
 * left out. */
void material_texts_add(struct material_texts *texts, const char *text);
void material_texts_of_objects(struct material_texts *texts, size_t n,
                               Relight__ObjectMaterial *const *entry);
void material_texts_of_shade(struct material_texts *texts, const Relight__Shade *shade);

/* Parses a preset's name or JSON text on this thread; error has the cause. Returns
 * an enum prt_status. */
int material_resolve(const char *text, struct prt_material *material, bool *preset,
                     char error[300]);
/* The same for a text that the request's message names; the result of material_then(), where
 * there is one, is used instead of parsing again. */
int material_of_request(struct request *request, const char *text,
                        struct prt_material *material, bool *preset, char error[300]);
/* The request needs none of its texts any more. */
void materials_used(struct request *request);

/* A hash of the material's values, independent of its name. Cryptographic, 128 bits: clients
 * share cache entries by it, and none may construct another's key. */
enum { MATERIAL_KEY = 33 };
void material_key(const struct prt_material *material, char key[MATERIAL_KEY]);

/* Calls run(request), now or when the materials of these texts are parsed and a large payload,
 * the cubes of lights, is hashed. texts NULL: the request has no material and no lights. views:
 * run() is called in the order of the connection's requests about views. */
void material_then(struct request *request, const struct material_texts *texts, bool views,
                   void (*run)(struct request *request));
/* The connection closes: its waiting requests about views do not run. */
void materials_drop(struct connection *conn);

#endif
