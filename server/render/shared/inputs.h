/* SPDX-License-Identifier: MIT */
/* inputs.h owns what a request waits for before its operation runs, so that the loop does none
 * of it: a material that takes long to read, and the names of large inline cubes (18 MB take
 * tens of milliseconds). */
#ifndef RELIGHTD_INPUTS_H
#define RELIGHTD_INPUTS_H

#include "relight.pb-c.h"

#include <stdbool.h>
#include <stddef.h>

struct connection;
struct request;

/* Of a request's inline cubes, from a worker; request->digests, free()d with the request. */
struct cube_digests {
    bool out_of_range; /* a texel is negative, too large or not a number */
    char hex[][65];    /* [n_light] SHA-256 of its texels; "" where it has none */
};

/* The texels that render_spec_lights takes. */
bool texels_in_range(const float *texels, size_t n);

/* Calls run(request), now or once its inputs are known. material: the text it names, or "".
 * views: the request keeps its place among what its connection says of its views. */
void inputs_then(struct request *request, const char *material, size_t n_light,
                 Relight__Light *const *lights, bool views,
                 void (*run)(struct request *request));
/* The connection closes: what it said of its views is done by nobody. */
void inputs_drop(struct connection *conn);

#endif
