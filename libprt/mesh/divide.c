// SPDX-License-Identifier: MIT
// Objects divided into parts that light does not cross.
#include "internal.h"

#include <string.h>

// The new object of each block into object[n_block]; returns their number.
static uint32_t number_parts(const struct prt_mesh *mesh, const uint32_t part[],
                             uint32_t *object)
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const uint32_t own = mesh->block[i].object;
        object[i] = UINT32_MAX; // blocks of one object follow each other
        for (uint32_t k = i;
             k-- > 0 && mesh->block[k].object == own && object[i] == UINT32_MAX;)
            if (part[k] == part[i]) object[i] = object[k];
        if (object[i] == UINT32_MAX) object[i] = n++;
    }
    return n;
}

int prt_mesh_divide(const struct prt_context *ctx, struct prt_mesh *mesh, const uint32_t part[])
{
    uint32_t *object = prt_alloc(mesh->n_block, sizeof *object);
    uint32_t n = object ? number_parts(mesh, part, object) : 0;
    struct prt_object *names = object ? prt_calloc(n, sizeof *names) : NULL;
    int status = PRT_OK;
    if (!names) status = prt_fail(ctx, PRT_NOMEM, "no memory to divide a model's objects");
    if (status || n == mesh->n_object) goto done;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        if (mesh->object) names[object[i]] = mesh->object[mesh->block[i].object];
        mesh->block[i].object = object[i];
    }
    mesh->n_object = n;
    prt_free(mesh->parts);
    mesh->object = mesh->parts = names;
    names = NULL;
    status = prt_mesh_weld(ctx, "the model", mesh);
done:
    prt_free(names);
    prt_free(object);
    return status;
}
