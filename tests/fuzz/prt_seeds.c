// SPDX-License-Identifier: MIT
// Writes small .prt files of every storage into a folder, for fuzz_prt to start from.
#include <stdio.h>
#include <sys/stat.h>

#include "prt/radial.h"
#include "synthetic.h"

// The same with a name for each object, several media and variants: sections that others lack;
// and with one empty tensor, as the preview of a model has. Where clusters mix objects (they do
// in synthetic tensors of more than one) the file is refused when it is opened, and is not
// written.
static int write_media(const struct prt_context *ctx, const char *folder, size_t i,
                       struct prt_transport *t)
{
    struct prt_context quiet = *ctx;
    const struct prt_material medium[2] = {{.name = "wax", .eta = 1.3f},
                                           {.name = "holder", .eta = 1.5f}};
    uint8_t of_object[64] = {0};
    struct prt_object name[64] = {{"candle"}, {"foot"}};
    struct prt_transport own = *t;
    struct prt_mesh_variant variant[2] = {{"night"}, {"day"}};
    uint32_t surface[3 * 64];
    char path[4096];
    if (t->mesh.n_object > 64 || t->mesh.n_block > 64) return 1;
    for (uint32_t k = 1; k < t->mesh.n_object; k++) of_object[k] = 1;
    own.media = (struct prt_media){2, medium, of_object};
    own.mesh.object = name;
    for (uint32_t k = 0; k < 3 * t->mesh.n_block; k++)
        surface[k] = (k / 3 + (k % 3 == 0)) % t->mesh.n_surface;
    own.mesh.n_variant = 2;
    own.mesh.variant = variant;
    own.mesh.variant_surface = surface;
    snprintf(path, sizeof path, "%s/media-%zu.prt", folder, i);
    int status = prt_file_write(&quiet, path, &own);
    if (status && status != PRT_FORMAT) return 1;
    if (i) return 0;
    uint32_t order[64];
    struct prt_cluster all = {.n_vertex = t->mesh.n_vertex};
    if (t->mesh.n_vertex > 64) return 1;
    for (uint32_t v = 0; v < t->mesh.n_vertex; v++) order[v] = v;
    own.engine = PRT_TRANSPORT_JOINT;
    own.tensor[0] = (struct prt_tensor){.storage = PRT_STORAGE_RADIAL,
                                        .coupling = PRT_COUPLE_FULL,
                                        .n_vertex = t->mesh.n_vertex,
                                        .n_function = 1,
                                        .n_phase = 1,
                                        .n_radial = 1,
                                        .n_cluster = 1,
                                        .order = order,
                                        .cluster = &all};
    snprintf(path, sizeof path, "%s/preview.prt", folder);
    return prt_file_write(&quiet, path, &own);
}

// A tensor of walks in the media of a grid.
static int write_walks(const struct prt_context *ctx, const char *folder)
{
    enum { LEVELS = 5, NODES = 4, FUNCTIONS = 3 };
    static float knot[LEVELS + NODES] = {0.1f, 0.5f, 1, 3, 9, 0, 0.01f, 0.1f, 1};
    static float basis[FUNCTIONS * LEVELS * NODES];
    const struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                        .coupling = PRT_COUPLE_FULL,
                                        .value = PRT_VALUE_I8,
                                        .n_vertex = 21,
                                        .n_cluster = 2,
                                        .rank = 2,
                                        .n_phase = 1,
                                        .n_radial = FUNCTIONS,
                                        .cube = 4,
                                        .coefs = 4,
                                        .seed = 1};
    const struct prt_material medium = {.eta = 1.3f};
    struct prt_transport t = {.cube = 4,
                              .engine = PRT_TRANSPORT_JOINT,
                              .n_tensor = 1,
                              .media = prt_media_one(&medium)};
    char path[4096];
    for (int i = 0; i < FUNCTIONS * LEVELS * NODES; i++) basis[i] = (float)(i % 7) - 3;
    if (synthetic_mesh(o.n_vertex, true, &t.mesh) || synthetic_tensor(&o, &t.tensor[0]))
        return 1;
    struct prt_tensor walks = t.tensor[0];
    walks.basis_kind = PRT_RADIAL_WALK;
    walks.n_knot = LEVELS + NODES;
    walks.knot = knot, walks.basis = basis;
    struct prt_transport written = t;
    written.tensor[0] = walks;
    snprintf(path, sizeof path, "%s/walks.prt", folder);
    int status = prt_file_write(ctx, path, &written);
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_mesh_finish(&t.mesh);
    return status;
}

// A tensor of one function at three nodes of eta.
static int write_etas(const struct prt_context *ctx, const char *folder)
{
    static const float knot[] = {0, 1, 3}, basis[] = {1, 0.5f, 0};
    static const float eta[] = {1.2f, 1.6f, 1.22f, 1.38f, 1.57f};
    const struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                        .coupling = PRT_COUPLE_FULL,
                                        .value = PRT_VALUE_I8,
                                        .n_vertex = 21,
                                        .n_cluster = 2,
                                        .rank = 2,
                                        .n_phase = 1,
                                        .n_radial = 3,
                                        .cube = 4,
                                        .coefs = 4,
                                        .seed = 2};
    const struct prt_material medium = {.eta = 1.3f};
    struct prt_transport t = {.cube = 4,
                              .engine = PRT_TRANSPORT_JOINT,
                              .n_tensor = 1,
                              .media = prt_media_one(&medium)};
    char path[4096];
    if (synthetic_mesh(o.n_vertex, true, &t.mesh) || synthetic_tensor(&o, &t.tensor[0]))
        return 1;
    struct prt_transport written = t;
    struct prt_tensor *any = &written.tensor[0];
    any->n_knot = 3, any->knot = knot, any->basis = basis;
    any->n_eta = 5, any->eta = eta;
    snprintf(path, sizeof path, "%s/any-eta.prt", folder);
    int status = prt_file_write(ctx, path, &written);
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_mesh_finish(&t.mesh);
    return status;
}

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
    if (write_walks(&ctx, argv[1]) || write_etas(&ctx, argv[1])) return 1;
    for (size_t i = 0; i < sizeof kind / sizeof *kind; i++) {
        const struct prt_material medium = {.eta = 1.3f};
        struct prt_transport t = {.cube = 4, .n_tensor = 1, .media = prt_media_one(&medium)};
        struct synthetic_options o = kind[i];
        o.cube = 4;
        o.n_vertex = 21;
        o.seed = 1;
        snprintf(path, sizeof path, "%s/%zu.prt", argv[1], i);
        if (synthetic_mesh(o.n_vertex, true, &t.mesh) || synthetic_tensor(&o, &t.tensor[0]) ||
            prt_file_write(&ctx, path, &t) || write_media(&ctx, argv[1], i, &t))
            return 1;
        synthetic_tensor_finish(&t.tensor[0]);
        synthetic_mesh_finish(&t.mesh);
    }
    return 0;
}
