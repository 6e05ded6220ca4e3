// SPDX-License-Identifier: MIT
// The default scattering of a bake: walks where their errors are within their bounds and they
// are not too slow (METHODS §9).
#include "bake/run.h"
#include "prt/walk.h"

#include <stdio.h>

static const double most_times = 3; // of the dipole's estimated time

// Why the settings rule walks out; NULL: they do not.
static const char *settings_refuse(const struct prt_bake_options *o)
{
    if (o->engine != PRT_TRANSPORT_WAVELET)
        return "bakes of a free medium by walks err by up to 3 %, more than the 2 % they should";
    if (o->storage == PRT_STORAGE_SPARSE)
        return "sparse storage does not smooth the walks' noise";
    if (o->draft) return "a draft is to be quick";
    for (uint32_t i = 0; i < o->media.n; i++)
        if (o->media.medium[i].profile)
            return "a material with a profile of its own has no walks";
    return NULL;
}

// Whether the translucent surface of every object encloses a volume.
static int check_volumes(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         bool *closed)
{
    struct prt_walk_space *space = NULL;
    struct prt_scene *scene;
    *closed = false;
    int status = prt_scene_create(ctx, mesh, &scene);
    if (status) return status;
    status = prt_walk_space_create(ctx, scene, &space);
    *closed = !status;
    for (uint32_t i = 0; i < mesh->n_object && !status; i++)
        if (prt_walk_area(space, i) > 0 && !(prt_walk_volume(space, i) > 0)) *closed = false;
    prt_walk_space_destroy(space);
    prt_scene_destroy(scene);
    return status;
}

static int compare_times(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         const struct prt_bake_options *options, double *times)
{
    struct prt_bake_options o = *options;
    double seconds[2], once;
    int status = PRT_OK;
    for (int k = 0; k < 2 && !status; k++) {
        o.scattering = k ? PRT_SCATTERING_WALK : PRT_SCATTERING_DIPOLE;
        status = prt_bake_seconds(ctx, mesh, &o, &seconds[k], &once);
    }
    if (!status) *times = seconds[1] / seconds[0];
    return status;
}

int prt_bake_choose_scattering(const struct prt_context *ctx, const struct prt_mesh *mesh,
                               const struct prt_bake_options *options, enum prt_scattering *out,
                               char why[PRT_BAKE_WHY])
{
    const char *refuse = settings_refuse(options);
    bool closed = false;
    double times = 0;
    int status = compare_times(ctx, mesh, options, &times);
    if (status) return status;
    *out = PRT_SCATTERING_DIPOLE;
    if (refuse) {
        snprintf(why, PRT_BAKE_WHY, "%s", refuse);
        return PRT_OK;
    }
    if (times > most_times) {
        snprintf(why, PRT_BAKE_WHY,
                 "walks are estimated to take %.2g times its time, more than %g", times,
                 most_times);
        return PRT_OK;
    }
    if (mesh->n_boundary_edge || mesh->n_nonmanifold_edge) {
        snprintf(why, PRT_BAKE_WHY,
                 "the surface is open: it has %u boundary edges, %u edges of "
                 "more than two triangles",
                 mesh->n_boundary_edge, mesh->n_nonmanifold_edge);
        return PRT_OK;
    }
    if ((status = check_volumes(ctx, mesh, &closed))) return status;
    if (closed) *out = PRT_SCATTERING_WALK;
    snprintf(why, PRT_BAKE_WHY,
             closed ? "the bodies are closed, and walks are estimated to take %.2g times the "
                      "dipole's time"
                    : "an object encloses no volume, or its triangles face inwards",
             times);
    return PRT_OK;
}
