// SPDX-License-Identifier: MIT
// The look of textured surfaces at the shading points: maps filtered over each point's pixel.
#include "internal.h"

#include <math.h>

struct job {
    const struct prt_mesh *mesh;
    struct prt_visibility *vis;
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// The steps on the triangle's plane [mm] that one pixel to the right and one down make: the
// derivative of eye + t d over pixels, t from the plane. Zero where it is seen edge on.
static void pixel_steps(const struct job *job, uint32_t point, float step[2][3])
{
    const struct prt_visibility *vis = job->vis;
    const struct prt_gbuffer *g = &vis->g;
    const struct camera_frame *f = &vis->frame;
    const uint32_t *v = job->mesh->triangle[g->triangle[point]];
    double e[2][3], face[3], d[3], z = 0;
    for (int k = 0; k < 3; k++) {
        for (int j = 0; j < 2; j++)
            e[j][k] = (double)job->mesh->position[v[j + 1]][k] - job->mesh->position[v[0]][k];
        d[k] = (double)g->position[k][point] - f->eye[k];
        z += d[k] * f->forward[k];
    }
    for (int k = 0; k < 3; k++) {
        int i = (k + 1) % 3, j = (k + 2) % 3;
        face[k] = e[0][i] * e[1][j] - e[0][j] * e[1][i];
    }
    double along = dot(face, d);
    for (int j = 0; j < 2; j++) {
        const double *axis = j ? f->up : f->right, pixels = j ? vis->height : vis->width;
        double move[3];
        for (int k = 0; k < 3; k++) move[k] = axis[k] * 2 * z / pixels;
        double back = dot(face, move) / along;
        // grazing: the anisotropic filter takes 16 probes at most
        bool good = isfinite(back) && fabs(back) < 1e3;
        for (int k = 0; k < 3; k++) step[j][k] = good ? (float)(move[k] - back * d[k]) : 0;
    }
}

static int fill(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct job *job = arg;
    struct prt_gbuffer *g = &job->vis->g;
    for (size_t i = begin; i < end; i++) {
        float step[2][3], d[2][2], n[3];
        struct prt_look look;
        pixel_steps(job, (uint32_t)i, step);
        for (int j = 0; j < 2; j++)
            prt_mesh_footprint(job->mesh, g->triangle[i], step[j], d[j]);
        for (int k = 0; k < 3; k++) n[k] = g->normal[k][i];
        const float da[2] = {d[0][0], d[1][0]}, db[2] = {d[0][1], d[1][1]};
        prt_mesh_look(job->mesh, g->triangle[i], g->block[i], g->bary[0][i], g->bary[1][i], da,
                      db, n, &look);
        float tint = g->opaque[i] ? 1 : prt_mesh_tint(job->mesh, look.base);
        for (int k = 0; k < 3; k++) {
            if (g->base[k]) g->base[k][i] = look.base[k] / tint;
            if (g->turned[k]) g->turned[k][i] = look.normal[k];
            if (g->emission[k]) g->emission[k][i] = look.emission[k];
        }
        if (g->smooth) g->smooth[i] = g->variance[i];
        g->variance[i] = 1 - (1 - g->variance[i]) * (1 - look.variance);
        if (g->roughness) g->roughness[i] = look.roughness;
        if (g->occlusion) g->occlusion[i] = look.occlusion;
    }
    return PRT_OK;
}

// Which parts of a look the mesh has: a part that it lacks costs a picture nothing.
struct parts {
    bool base, normal, roughness, occlusion, emission;
};

static struct parts parts_of(const struct prt_mesh *mesh)
{
    struct parts has = {.base = mesh->color || mesh->gain};
    for (uint32_t b = 0; mesh->maps && b < mesh->n_block; b++) {
        const struct prt_surface_maps *m = &mesh->maps[mesh->block[b].surface];
        has.base |= m->map[PRT_MAP_BASE].image != UINT32_MAX;
        has.normal |= m->map[PRT_MAP_NORMAL].image != UINT32_MAX;
        has.roughness |= m->map[PRT_MAP_ROUGHNESS].image != UINT32_MAX;
        has.occlusion |= m->map[PRT_MAP_OCCLUSION].image != UINT32_MAX;
        for (int c = 0; c < 3; c++) has.emission |= m->emissive[c] > 0;
    }
    return has;
}

int prt_raster_look(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    struct prt_visibility *vis)
{
    struct prt_gbuffer *g = &vis->g;
    struct job job = {mesh, vis};
    const struct parts has = parts_of(mesh);
    const struct {
        bool wanted;
        float **array;
    } row[] = {{has.base, &g->base[0]},         {has.base, &g->base[1]},
               {has.base, &g->base[2]},         {has.normal, &g->turned[0]},
               {has.normal, &g->turned[1]},     {has.normal, &g->turned[2]},
               {has.normal, &g->smooth},        {has.roughness, &g->roughness},
               {has.occlusion, &g->occlusion},  {has.emission, &g->emission[0]},
               {has.emission, &g->emission[1]}, {has.emission, &g->emission[2]}};
    if (!prt_mesh_has_look(mesh)) return PRT_OK;
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        if (row[i].wanted &&
            !(*row[i].array = prt_calloc((size_t)g->n_point + 16, sizeof(float))))
            return prt_fail(ctx, PRT_NOMEM, "raster: no memory for %u points", g->n_point);
    return prt_parallel_for(ctx, NULL, g->n_point, 512, fill, &job);
}

void prt_raster_look_finish(struct prt_gbuffer *g)
{
    for (int k = 0; k < 3; k++) {
        prt_free(g->base[k]);
        prt_free(g->turned[k]);
        prt_free(g->emission[k]);
    }
    prt_free(g->smooth);
    prt_free(g->roughness);
    prt_free(g->occlusion);
}
