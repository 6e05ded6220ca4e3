// SPDX-License-Identifier: MIT
// Models from hostile bytes, in the bind pose and in a moment of an animation: any result but a
// crash, a leak or a hang will do.
#include "prt/mesh.h"

#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    struct prt_mesh *mesh = NULL;
    struct prt_mesh_options options = {
        .max_vertices = 100000, .max_triangles = 200000, .in_process = true, .time_s = 0.4};
    char animation[64] = "";
    prt_context_init(&ctx);
    ctx.log = quiet;
    ctx.memory_limit = 64 << 20;
    if (prt_mesh_load_memory(&ctx, "fuzz", bytes, n, NULL, &options, &mesh) == PRT_OK) {
        if (mesh->n_animation) memcpy(animation, mesh->animation[0].name, sizeof animation);
        prt_mesh_destroy(mesh);
    }
    options.animation = animation;
    if (animation[0] &&
        prt_mesh_load_memory(&ctx, "fuzz", bytes, n, NULL, &options, &mesh) == PRT_OK)
        prt_mesh_destroy(mesh);
    return 0;
}
