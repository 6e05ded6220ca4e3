// SPDX-License-Identifier: MIT
// The share of a reflection that the model itself does not hide (METHODS §6, specular
// occlusion), once for a view: it depends neither on the light nor on the medium.
#include "internal.h"

#include <math.h>

// Bands up to l = 3 blur the edges of what is hidden; a mirror sees them sharp. Chosen from the
// errors that prt image --measure-error prints (bunny and dragon, two lights, two roughnesses).
#define CONTRAST 3.0f
#define OFFSET 0.7f

struct job {
    const struct prt_mesh *mesh;
    struct prt_visibility *vis;
};

// The mirror direction of the eye about the point's normal, bent as the shading bends it.
static void mirror(const struct prt_visibility *vis, size_t i, float r[3])
{
    const struct prt_gbuffer *g = &vis->g;
    float *const *normal = g->turned[0] ? g->turned : g->normal;
    float n[3], w[3], l = 0, c = 0;
    for (int k = 0; k < 3; k++) {
        n[k] = normal[k][i];
        w[k] = (float)vis->frame.eye[k] - g->position[k][i];
        l += w[k] * w[k];
    }
    for (int k = 0; k < 3; k++) {
        w[k] /= sqrtf(l + 1e-30f);
        c += w[k] * n[k];
    }
    float least = fmaxf(0.5f * g->facing[i], 1e-3f);
    if (c < least) {
        float keep = sqrtf((1 - least * least) / (1 - c * c + 1e-12f)), add = least - keep * c;
        for (int k = 0; k < 3; k++) n[k] = keep * n[k] + add * w[k];
        c = least;
    }
    for (int k = 0; k < 3; k++) r[k] = 2 * c * n[k] - w[k];
}

static int fill(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct job *job = arg;
    struct prt_gbuffer *g = &job->vis->g;
    for (size_t i = begin; i < end; i++) {
        const int8_t *corner[3];
        float r[3], y[PRT_MESH_BLOCKED], hidden = 0;
        const float b[3] = {1 - g->bary[0][i] - g->bary[1][i], g->bary[0][i], g->bary[1][i]};
        for (int j = 0; j < 3; j++) corner[j] = job->mesh->blocked[g->corner[j][i]];
        mirror(job->vis, i, r);
        prt_sh_eval(4, r, y);
        for (int k = 0; k < PRT_MESH_BLOCKED; k++)
            hidden += y[k] * (b[0] * corner[0][k] + b[1] * corner[1][k] + b[2] * corner[2][k]);
        float open = 1 - hidden * ((float)PRT_MESH_BLOCKED_SCALE / 127);
        g->unblocked[i] = fminf(fmaxf(CONTRAST * open - OFFSET, 0), 1);
    }
    return PRT_OK;
}

int prt_raster_unblocked(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         struct prt_visibility *vis)
{
    struct prt_gbuffer *g = &vis->g;
    struct job job = {mesh, vis};
    if (!mesh->blocked) return PRT_OK;
    if (!(g->unblocked = prt_calloc((size_t)g->n_point + 16, sizeof *g->unblocked)))
        return prt_fail(ctx, PRT_NOMEM, "raster: no memory for %u points", g->n_point);
    return prt_parallel_for(ctx, NULL, g->n_point, 512, fill, &job);
}
