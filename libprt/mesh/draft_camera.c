// SPDX-License-Identifier: MIT
// Cameras of the mesh that a reader builds, and the turn of a file whose +z is up.
#include "internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static double length3(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

// Control characters become spaces, and a second camera of one name gets a number.
static void name_camera(struct prt_draft *d, const char *name, char out[64])
{
    bool taken = true;
    for (unsigned number = 1; taken && number <= PRT_MESH_MOST_CAMERAS; number++) {
        if (number == 1) snprintf(out, 64, "%.56s", name);
        else snprintf(out, 64, "%.56s %u", name, number);
        for (char *c = out; *c; c++)
            if ((unsigned char)*c < 32 || *c == 127 || *c == ':' || *c == ',') *c = ' ';
        taken = false;
        for (uint32_t i = 0; i < d->n_camera; i++) taken |= !strcmp(d->camera[i].name, out);
    }
}

void prt_draft_camera(struct prt_draft *d, const char *name, const double eye[3],
                      const double forward[3], const double up[3], double fovy_deg)
{
    double f = length3(forward), u = length3(up);
    if (d->n_camera == PRT_MESH_MOST_CAMERAS || !(f > 1e-12 && f < 1e15) ||
        !(u > 1e-12 && u < 1e15) || !(length3(eye) < 1e14)) {
        prt_log(d->ctx, PRT_LOG_WARNING, "%s: camera \"%.60s\" is left out: %s", d->name, name,
                d->n_camera == PRT_MESH_MOST_CAMERAS ? "there are 256 already"
                                                     : "its node has no usable transform");
        return;
    }
    struct prt_mesh_camera *c = &d->camera[d->n_camera];
    *c = (struct prt_mesh_camera){.fovy_deg = (float)fovy_deg};
    name_camera(d, name, c->name);
    for (int k = 0; k < 3; k++) {
        c->eye[k] = (float)eye[k];
        c->target[k] = (float)(forward[k] / f); // relative, until prt_draft_place
        c->up[k] = (float)(up[k] / u);
    }
    d->n_camera++;
}

static void turn(float v[3])
{
    float y = v[1];
    v[1] = v[2];
    v[2] = -y;
}

// The target lies as deep as the middle of the model, so that a view may turn about it.
static void place_target(struct prt_mesh_camera *c, const double centre[3], double size)
{
    double depth = 0;
    for (int k = 0; k < 3; k++) depth += (centre[k] - c->eye[k]) * c->target[k];
    if (!(depth > 0.01 * size)) depth = size > 0 ? size : 1;
    for (int k = 0; k < 3; k++) c->target[k] = (float)(c->eye[k] + depth * c->target[k]);
}

void prt_draft_place(struct prt_draft *d, bool up_z)
{
    double low[3] = {0}, high[3] = {0}, centre[3], side[3];
    for (uint32_t v = 0; v < d->n_vertex; v++)
        for (int k = 0; k < 3; k++) {
            if (!v || d->position[v][k] < low[k]) low[k] = d->position[v][k];
            if (!v || d->position[v][k] > high[k]) high[k] = d->position[v][k];
        }
    for (int k = 0; k < 3; k++) centre[k] = (low[k] + high[k]) / 2, side[k] = high[k] - low[k];
    for (uint32_t i = 0; i < d->n_camera; i++) {
        struct prt_mesh_camera *c = &d->camera[i];
        place_target(c, centre, length3(side));
        if (up_z) turn(c->eye), turn(c->target), turn(c->up);
    }
    for (uint32_t v = 0; up_z && v < d->n_vertex; v++) turn(d->position[v]), turn(d->normal[v]);
}
