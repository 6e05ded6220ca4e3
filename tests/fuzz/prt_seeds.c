// SPDX-License-Identifier: MIT
// Writes small .prt files of every storage into a folder, for fuzz_prt to start from.
#include <stdio.h>
#include <sys/stat.h>

#include "synthetic.h"

int main(int argc, char **argv)
{
    static const struct synthetic_options kind[] = {
        {.storage = PRT_STORAGE_FACTORED,
         .value = PRT_VALUE_F16,
         .n_cluster = 2,
         .rank = 3,
         .n_phase = 1,
         .coefs = 6},
        {.storage = PRT_STORAGE_SPARSE, .value = PRT_VALUE_I8, .n_phase = 4, .coefs = 3},
        {.storage = PRT_STORAGE_FACTORED,
         .coupling = PRT_COUPLE_FULL,
         .value = PRT_VALUE_I8,
         .n_cluster = 2,
         .rank = 2,
         .n_phase = 4,
         .n_radial = 3,
         .coefs = 4},
        {.storage = PRT_STORAGE_RADIAL, .n_cluster = 2, .n_phase = 1, .n_radial = 4},
        {.storage = PRT_STORAGE_FACTORED,
         .value = PRT_VALUE_PAIR,
         .n_cluster = 2,
         .rank = 3,
         .n_phase = 1,
         .coefs = 5}};
    struct prt_context ctx;
    char path[4096];
    prt_context_init(&ctx);
    if (argc != 2) return 2;
    mkdir(argv[1], 0777);
    for (size_t i = 0; i < sizeof kind / sizeof *kind; i++) {
        const struct prt_material medium = {.eta = 1.3f};
        struct prt_transport t = {.cube = 4, .n_tensor = 1, .media = prt_media_one(&medium)};
        struct synthetic_options o = kind[i];
        o.cube = 4;
        o.n_vertex = 21;
        o.seed = 1;
        snprintf(path, sizeof path, "%s/%zu.prt", argv[1], i);
        if (synthetic_mesh(o.n_vertex, true, &t.mesh) || synthetic_tensor(&o, &t.tensor[0]) ||
            prt_file_write(&ctx, path, &t))
            return 1;
        synthetic_tensor_finish(&t.tensor[0]);
        synthetic_mesh_finish(&t.mesh);
    }
    return 0;
}
