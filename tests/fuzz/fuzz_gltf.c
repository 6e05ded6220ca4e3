// SPDX-License-Identifier: MIT
// Models from hostile bytes: any result but a crash, a leak or a hang will do.
#include "prt/mesh.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    struct prt_mesh *mesh = NULL;
    const struct prt_mesh_options options = {
        .max_vertices = 100000, .max_triangles = 200000, .in_process = true};
    prt_context_init(&ctx);
    ctx.log = quiet;
    ctx.memory_limit = 64 << 20;
    if (prt_mesh_load_memory(&ctx, "fuzz", bytes, n, NULL, &options, &mesh) == PRT_OK)
        prt_mesh_destroy(mesh);
    return 0;
}
