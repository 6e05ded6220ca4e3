// SPDX-License-Identifier: MIT
// The bodies of a scene: which triangle bounds which object, volumes, areas.
#include "prt/medium.h"
#include "walk/walk_private.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Twice the area, and six times the volume of the tetrahedron on the origin.
static void triangle_measures(const struct prt_mesh *mesh, uint32_t t, double *area2,
                              double *volume6)
{
    double p[3][3], n[3];
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++) p[j][k] = mesh->position[mesh->triangle[t][j]][k];
    for (int k = 0; k < 3; k++) {
        int a = (k + 1) % 3, b = (k + 2) % 3;
        n[k] = (p[1][a] - p[0][a]) * (p[2][b] - p[0][b]) -
               (p[1][b] - p[0][b]) * (p[2][a] - p[0][a]);
    }
    *area2 = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    *volume6 = n[0] * p[0][0] + n[1] * p[0][1] + n[2] * p[0][2];
}

static void measure(struct prt_walk_space *s, const struct prt_mesh *mesh)
{
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        bool translucent = mesh->surface[block->surface].translucent != 0;
        for (uint32_t t = block->triangle_begin; t < block->triangle_begin + block->n_triangle;
             t++) {
            double area2, volume6;
            s->triangle_object[t] = translucent ? block->object : WALK_OPAQUE;
            triangle_measures(mesh, t, &area2, &volume6);
            s->volume[block->object] += volume6 / 6;
            if (translucent) s->area[block->object] += area2 / 2;
        }
    }
}

// The direction from each vertex that leads away from its faces: against the sum of their unit
// normals.
static void find_inward(struct prt_walk_space *s, const struct prt_mesh *mesh)
{
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        const float *a = mesh->position[mesh->triangle[t][0]];
        const float *b = mesh->position[mesh->triangle[t][1]];
        const float *c = mesh->position[mesh->triangle[t][2]];
        float n[3], length = 0;
        for (int k = 0; k < 3; k++) {
            int i = (k + 1) % 3, j = (k + 2) % 3;
            n[k] = (b[i] - a[i]) * (c[j] - a[j]) - (b[j] - a[j]) * (c[i] - a[i]);
            length += n[k] * n[k];
        }
        if (!(length > 0)) continue;
        for (int v = 0; v < 3; v++)
            for (int k = 0; k < 3; k++)
                s->inward[mesh->weld[mesh->triangle[t][v]]][k] -= n[k] / sqrtf(length);
    }
    for (uint32_t w = 0; w < mesh->n_weld; w++) {
        float *d = s->inward[w], length = sqrtf(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        for (int k = 0; k < 3; k++) d[k] = length > 1e-3f ? d[k] / length : 0;
    }
}

static void box(struct prt_walk_space *s, const struct prt_mesh *mesh)
{
    for (int k = 0; k < 3; k++) s->low[k] = INFINITY, s->high[k] = -INFINITY;
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) {
                float x = mesh->position[mesh->triangle[t][j]][k];
                s->low[k] = fminf(s->low[k], x);
                s->high[k] = fmaxf(s->high[k], x);
            }
    float diagonal2 = 0;
    for (int k = 0; k < 3; k++)
        diagonal2 += (s->high[k] - s->low[k]) * (s->high[k] - s->low[k]);
    // Sixteen steps of a coordinate at the far end of the box.
    s->epsilon = 2e-6f * sqrtf(diagonal2);
}

int prt_walk_space_create(const struct prt_context *ctx, const struct prt_scene *scene,
                          struct prt_walk_space **out)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    struct prt_walk_space *s = calloc(1, sizeof *s);
    int status = s ? PRT_OK : PRT_NOMEM;
    if (s) {
        s->scene = scene;
        s->n_object = mesh->n_object;
        s->triangle_object = prt_alloc(mesh->n_triangle, sizeof *s->triangle_object);
        s->volume = prt_calloc(mesh->n_object, sizeof *s->volume);
        s->area = prt_calloc(mesh->n_object, sizeof *s->area);
        s->inward = prt_calloc(mesh->n_weld + 1u, sizeof *s->inward);
        if (!s->triangle_object || !s->volume || !s->area || !s->inward) status = PRT_NOMEM;
    }
    if (status == PRT_OK) {
        double all = 0;
        measure(s, mesh);
        find_inward(s, mesh);
        for (uint32_t o = 0; o < s->n_object; o++) all += s->area[o];
        if (!(all > 0))
            status =
                prt_fail(ctx, PRT_ARG, "nothing to walk in: no translucent triangle has area");
    }
    if (status == PRT_OK) {
        box(s, mesh);
        status = prt_walk_grid(s, mesh);
    }
    if (status == PRT_OK) *out = s;
    else prt_walk_space_destroy(s);
    return status == PRT_NOMEM ? prt_fail(ctx, status, "no memory for the grid of distances")
                               : status;
}

void prt_walk_space_destroy(struct prt_walk_space *space)
{
    if (!space) return;
    prt_free(space->triangle_object);
    prt_free(space->volume);
    prt_free(space->area);
    prt_free(space->inward);
    prt_free(space->bound);
    free(space);
}

void prt_walk_start_at(const struct prt_walk_space *space, uint32_t vertex, uint32_t object,
                       uint64_t seed, struct prt_walk_start *out)
{
    const struct prt_mesh *mesh = prt_scene_mesh(space->scene);
    *out = (struct prt_walk_start){.object = object, .seed = seed};
    memcpy(out->position, mesh->position[vertex], sizeof out->position);
    memcpy(out->normal, mesh->normal[vertex], sizeof out->normal);
    memcpy(out->inward, space->inward[mesh->weld[vertex]], sizeof out->inward);
}

double prt_walk_volume(const struct prt_walk_space *space, uint32_t object)
{
    return object < space->n_object ? space->volume[object] : 0;
}

double prt_walk_area(const struct prt_walk_space *space, uint32_t object)
{
    return object < space->n_object ? space->area[object] : 0;
}

double prt_walk_mean_length(const struct prt_walk_space *space, uint32_t object, double eta)
{
    double volume = prt_walk_volume(space, object), area = prt_walk_area(space, object);
    if (!(volume > 0) || !(area > 0)) return 0;
    return 4 * volume * eta * eta / (area * prt_fresnel_mean_transmittance(eta));
}
