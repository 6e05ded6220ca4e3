// SPDX-License-Identifier: MIT
// A moment of an animation: transforms of nodes, weights of morph targets, joints.
#ifndef PRT_MESH_GLTF_POSE_H
#define PRT_MESH_GLTF_POSE_H

#include "gltf.h"

#include <cjson/cJSON.h>

// The transform and morph weights that an animation gives a node.
struct gltf_moment {
    bool has_t, has_r, has_s;
    double t[3], r[4], s[3];
    float *weight; // [n_weight] of morph targets; NULL: none
    size_t n_weight;
};

struct gltf_pose {
    struct gltf_moment *node; // [n_node]
    double (*world)[16];      // [n_node] column-major
    uint8_t *has_world;       // [n_node] it is in the scene
    // JSON of the meshes, nodes and skins, by index; NULL where there is none
    const cJSON **mesh, **json_node, **skin;
    size_t n_skin;
    uint64_t work; // floats that were read and moved, against a limit
};

// Counts n floats of work. PRT_LIMIT.
int prt_gltf_pose_work(struct gltf *g, uint64_t n);
// A whole number of `object` in [0, 2^31), or -1.
int64_t prt_gltf_whole(const cJSON *object, const char *key);
// The values of accessor `index`, which the caller free()s.
int prt_gltf_read_floats(struct gltf *g, int64_t index, unsigned n_component,
                         struct gltf_accessor *a, float **out);

// Lists the file's animations in the draft. PRT_OK.
int prt_gltf_animations(struct gltf *g);
// Whether g->pose is needed: for an animation, skins, morph targets or instances.
bool prt_gltf_needs_pose(const struct gltf *g);
// Makes g->pose of d->animation at d->animation_time, or of the nodes as the file has them,
// without the nodes' worlds. PRT_ARG for an unknown name.
int prt_gltf_pose_begin(struct gltf *g);
// Moves vertices [first, first + n) of a node's primitive by its morph targets and its skin;
// *skinned: they are in world space then, with *det of the sign of their transform.
int prt_gltf_deform(struct gltf *g, size_t node, size_t primitive, uint32_t first, uint32_t n,
                    bool *skinned, double *det);

#endif
