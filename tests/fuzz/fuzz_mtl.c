// SPDX-License-Identifier: MIT
// Material libraries of OBJ files from hostile bytes: what is read is in range.
#include "mesh/obj_material.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void quiet(void *user, enum prt_log_level level, const char *line)
{
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = quiet;
    struct prt_draft draft = {.ctx = &ctx, .name = "fuzz", .max_bytes = 1 << 20};
    struct obj_material m;
    struct prt_surface surface;
    struct prt_surface_maps maps;
    char *text = malloc(n + 1);
    if (!text) return 0;
    memcpy(text, bytes, n);
    text[n] = 0;
    prt_obj_material_init(&m);
    prt_obj_material_parse(&draft, text, &m);
    free(text);
    prt_surface_default(&surface, m.name);
    for (int k = 0; k < PRT_N_MAP; k++)
        for (int c = 0; c < 6; c++)
            if (!(fabsf(m.map[k].ref.transform[c]) <= 1e6f)) abort();
    if (prt_obj_material_apply(&draft, &m, &surface, &maps)) abort(); // no folder: no images
    if (!prt_surface_maps_valid(&maps, 0, 1) || !(surface.roughness > 0)) abort();
    prt_draft_finish(&draft);
    return 0;
}
