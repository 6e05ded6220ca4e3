/* SPDX-License-Identifier: MIT */
/* model_messages.h owns the messages of a model's parts, which INFO and GEOMETRY have in
 * common. Their texts belong to the mesh. */
#ifndef RELIGHTD_MODEL_MESSAGES_H
#define RELIGHTD_MODEL_MESSAGES_H

#include "prt/medium.h"
#include "prt/mesh.h"
#include "relight.pb-c.h"

void fill_vec3(Relight__Vec3 *out, const float v[3]);

struct block_text {
    Relight__Block block;
    Relight__Vec3 color, gain;
};

/* Block messages of a mesh with these media. gain: [n_block] of a variant; NULL: none. One
 * allocation each for the array and the pointers, both to free(); NULL without memory. */
struct block_text *fill_blocks(const struct prt_mesh *mesh, const struct prt_media *media,
                               const float (*gain)[3], Relight__Block ***out);
/* JSON texts of a model's media; one allocation. NULL without memory. */
char **print_media(const struct prt_media *media);

struct camera_text {
    Relight__NamedCamera named;
    Relight__Camera camera;
    Relight__Vec3 eye, target, up;
};

/* Messages of the cameras of the model's file; as fill_blocks. */
struct camera_text *fill_cameras(const struct prt_mesh *mesh, Relight__NamedCamera ***out);

#endif
